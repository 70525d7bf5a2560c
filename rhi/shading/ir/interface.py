"""The interface of a shader: inputs, outputs, varyings, bindings and the work-group, which stage trees don't
hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

from rhi.contract.descriptors import Attribute, Binding, FragmentOutput
from rhi.contract.layout import HostType
from rhi.errors.data_classes import dataclass
from rhi.shading.language.annotations import Role


@dataclass(frozen=True, slots=True)
class Varying:
    """A value that the vertex stage passes to the fragment stage."""

    name: str
    type: HostType
    role: Role | None
    location: int


@dataclass(frozen=True, slots=True)
class Interface:
    """A shader's name, bindings and work-group, and the inputs, outputs and varyings of its graphics stages.

    `bindings` holds their slots, by name and in order. `position` is the name of the vertex stage's position
    field, "" if it returns a plain vec4. `depth` is the name of the fragment stage's depth field,
    `point_size` that of the vertex stage's point size, `target_layer` that of the target's layer; "" if there
    is none.
    """

    name: str
    work_group: tuple[int, int, int]
    early_depth: bool
    bindings: Mapping[str, Binding] = field(default_factory=dict)
    attributes: tuple[Attribute, ...] = ()
    varyings: tuple[Varying, ...] = ()
    position: str = ""
    outputs: tuple[FragmentOutput, ...] = ()
    depth: str = ""
    point_size: str = ""
    target_layer: str = ""
