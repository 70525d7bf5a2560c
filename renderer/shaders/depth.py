"""The shader that draws depth alone: first passes of techniques, and shadow maps."""

from __future__ import annotations

from renderer.shaders.structs import Object, ObjectPosition, ViewConstants, relative_position
from rhi.shading import Shader, Storage, Struct, Uniform, instance_index, vec3, vec4


class PositionVertex(Struct):
    """The part of a vertex that depth depends on."""

    position: vec3


class DepthOnly(Shader):
    """Draws depth, bit for bit that of the forward shader."""

    view: Uniform[ViewConstants]
    objects: Storage[Object]
    object_positions: Storage[ObjectPosition]

    def vertex(self, v: PositionVertex) -> vec4:
        row = instance_index()
        position = self.objects[row].linear @ v.position + relative_position(
            self.object_positions[row], self.view
        )
        return self.view.relative_view_projection @ vec4(position, 1.0)
