"""Native GLSL programs and shapes for the tests of the GL backend itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from backend_kit import BackendKit
from numpy.typing import ArrayLike

from rhi.backends.gl.gl_backend import GlBackend
from rhi.contract import descriptors
from rhi.contract.formats import Format
from rhi.contract.states import PER_TARGET, State, StateChange

VERTEX = """#version 430
layout(location = 0) in vec2 position;
void main() { gl_Position = vec4(position, 0.5, 1.0); }
"""
FRAGMENT = """#version 430
layout(location = 0) out vec4 color;
void main() { color = vec4(1.0, 0.0, 0.0, 0.5); }
"""
FULL = [(-1, 1), (-1, -3), (3, 1)]
"""A triangle that covers everything."""
SIZE = 8


def describe_program(
    vertex: str = VERTEX, fragment: str = FRAGMENT, origins: tuple[tuple[str, int], ...] = ()
) -> descriptors.ProgramDescriptor:
    """Describe a program of GLSL; `origins` are those of the fragment stage."""
    sources = {
        descriptors.Stage.VERTEX: descriptors.StageText(vertex),
        descriptors.Stage.FRAGMENT: descriptors.StageText(fragment, origins),
    }
    outputs = (descriptors.FragmentOutput("color", 0, "float", 4),)
    return descriptors.ProgramDescriptor(
        "Native",
        frozenset(sources),
        (),
        (),
        outputs,
        (1, 1, 1),
        lambda language, stage: sources[stage],
    )


class GlKit(BackendKit):
    """The kit on OpenGL, which draws."""

    backend: GlBackend

    def texture(self, texel: Format = Format.RGBA8, samples: int = 1) -> descriptors.Id:
        texture = self.new_id()
        self.backend.create_texture(
            texture, descriptors.TextureDescriptor((SIZE, SIZE), texel, samples=samples)
        )
        return texture

    def shape(self, program: descriptors.Id, corners: ArrayLike) -> descriptors.Id:
        buffer = self.buffer(np.asarray(corners, np.float32).tobytes())
        stream = descriptors.VertexStream(
            buffer, 0, 8, False, (descriptors.VertexAttribute(0, descriptors.VertexFormat.FLOAT2, 0),)
        )
        shape = self.new_id()
        self.backend.create_vertex_array(shape, descriptors.VertexArrayDescriptor(program, (stream,)))
        return shape

    def answer(self, query: descriptors.Id) -> int:
        while (answer := self.backend.read_query(query)) is None:
            pass
        return answer

    def set(self, *states: State) -> None:
        self.backend.set_states(
            [StateChange(type(s), (s,) * 8 if type(s) in PER_TARGET else s) for s in states]
        )

    def begin(
        self, target: descriptors.Id, clear: Sequence[float] | None = (0, 0, 0, 0), **parts: object
    ) -> None:
        color = descriptors.Attachment(target, clear=tuple(clear) if clear is not None else None)  # type: ignore[arg-type]
        self.backend.begin_pass(descriptors.PassDescriptor((SIZE, SIZE), (color,), **parts))  # type: ignore[arg-type]

    def draw(self, shape: descriptors.Id, count: int = 3) -> None:
        self.backend.draw(shape, descriptors.Primitive.TRIANGLES, 0, count, 1, 0, 0)

    def read(self, texture: descriptors.Id, stencil: bool = False) -> np.ndarray:
        return self.backend.read_texture(texture, 0, descriptors.Region(0, 0, SIZE, SIZE), stencil)[0]
