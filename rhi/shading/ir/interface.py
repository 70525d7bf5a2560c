"""The inputs, outputs and varyings of a shader's stages."""

from __future__ import annotations

from dataclasses import dataclass

from rhi.contract.descriptors import Attribute, FragmentOutput
from rhi.contract.layout import HostType
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
    """The inputs, outputs and varyings of a shader's graphics stages.

    `position` is the name of the vertex stage's position field, "" if it returns a plain vec4. `depth` is the name of
    the fragment stage's depth field, `point_size` that of the vertex stage's point size; "" if there is none.
    """

    attributes: tuple[Attribute, ...] = ()
    varyings: tuple[Varying, ...] = ()
    position: str = ""
    outputs: tuple[FragmentOutput, ...] = ()
    depth: str = ""
    point_size: str = ""
