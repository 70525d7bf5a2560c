"""A hand-made program and a kit around it, so that tests need the interface alone, not the shading
language."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import rhi
from rhi.contract import descriptors
from rhi.contract.layout import FLOAT, VectorType
from rhi.shading import Struct
from rhi.shading.language.vectors import vec4


class Camera(Struct):
    tint: vec4


class Object(Struct):
    offset: vec4


def hand_made_program(name: str = "flat", *bindings: descriptors.Binding) -> descriptors.ProgramDescriptor:
    """Two uniforms and a vertex position; for the null device, which never looks at the source."""
    return descriptors.ProgramDescriptor(
        name,
        frozenset({descriptors.Stage.VERTEX, descriptors.Stage.FRAGMENT}),
        bindings
        or (
            descriptors.Binding("camera", descriptors.BindingKind.UNIFORM, 0, False, Camera, 16),
            descriptors.Binding("object", descriptors.BindingKind.UNIFORM, 1, False, Object, 16),
        ),
        (descriptors.Attribute("position", 0, VectorType(FLOAT, 2)),),
        (descriptors.FragmentOutput("color", 0, "float", 4),),
        (1, 1, 1),
        lambda language, stage: descriptors.StageText(f"// {language} {stage.value}"),
    )


@dataclass
class Kit:
    """A null device with the objects that a draw needs."""

    device: rhi.Device
    program: Any
    mesh: rhi.Mesh
    image: rhi.Texture
    camera: Any
    objects: Any

    @property
    def bindings(self) -> dict[str, Any]:
        """The bindings of the program."""
        return {"camera": self.camera, "object": self.objects[0]}

    def ops(self, *ops: rhi.Op) -> list[rhi.Command]:
        """The recorded commands of these kinds."""
        return [command for command in self.device.stream if command.op in ops]


def make_kit(device: rhi.Device, indices: Any = None) -> Kit:
    """Make a program, a triangle, a target, and what the program binds."""
    positions = np.array([[-1, -1], [1, -1], [0, 1]], np.float32)
    return Kit(
        device,
        device.program(hand_made_program()),
        device.mesh({"position": positions}, indices),
        device.texture((8, 8), rhi.Format.RGBA8),
        device.uniform(Camera(tint=(1, 1, 1, 1))),
        device.uniform_array(Object, 4),
    )
