"""Boxes of all objects, computed, tested and marked on the device: the CPU's work doesn't depend on their
number.

- A box is the mesh's own box under the object's transform: an oriented box, which fits rotated objects
  tightly too.
- It is padded as for queries (`bounds`): each face moves outwards by the margin. Boxes too flat or too skewed
  for that are replaced by the boxes along the world's axes around them.
- What the near plane may cut counts as visible, and what is outside the frustum doesn't count at all. Neither
  kind of box is drawn: it is stored with zero extent.
- Boxes that are drawn mark their object where a fragment passes the depth test. All fragments write the same
  value, so no atomics are needed (Deferred+, Listing 1.2).
"""

from __future__ import annotations

from typing import Any, Final

import rhi.shading as sl
from renderer.scene import Camera, Depth, FrustumPlane
from renderer.shaders import MeshPart, Object, ObjectPosition, ViewConstants, relative_position
from renderer.visibility.boxes.bounds import ROUNDING, TOO_FAR, UNKNOWN_SIZE, margin_terms, near_radius
from renderer.visibility.boxes.cubes import BoxCamera, CubeCorner, make_cube
from renderer.visibility.scene_drawer import SceneArrays
from rhi import (
    CullMode,
    DepthFunction,
    DepthTest,
    DepthWrite,
    Device,
    Encoder,
    FrontFace,
    IndirectDraws,
    Mesh,
    Program,
    StateScope,
    StorageBuffer,
    UniformBuffer,
)
from rhi.math import is_parallel

HIDDEN: Final = 0
"""The mark of an object that is hidden, as far as is known."""
VISIBLE: Final = 1
"""The mark of an object for the next list."""
OUTSIDE: Final = 2
"""The mark of an object outside the frustum, or on no list."""
DRAWN: Final = 3
"""The mark of an object that a list of this frame holds."""

GROUP: Final = 64
"""Number of objects per work-group."""
MIN_VOLUME: Final = 0.5
"""A box is replaced if the volume spanned by its unit axes is less than this."""

_RADIUS_MARGIN: Final = 1.0001
_NEARER: Final = {
    Depth.REVERSED: DepthFunction.GREATER_EQUAL,
    Depth.STANDARD: DepthFunction.LESS_EQUAL,
}


class Occludee(sl.Struct):
    """A box relative to the eye: its centre, half of each edge, and the view depth of its farthest corner."""

    centre: sl.vec3
    depth: float
    x: sl.vec3
    y: sl.vec3
    z: sl.vec3


class CullingCamera(sl.Struct):
    """The properties of a camera that are not in its matrix.

    The margin of a box whose farthest point is f metres away is dot(margin, (1, f, f²)). Boxes within
    `near_radius` of the eye, or not beyond `near_depth` along `forward`, count as visible; the other limit is
    set to have no effect.
    """

    forward: sl.vec3
    near_radius: float
    margin: sl.vec3
    near_depth: float


@sl.function
def is_behind(plane: sl.vec4, box: Occludee) -> bool:
    """Return whether a box is completely behind a plane."""
    n = plane.xyz
    reach = sl.abs(sl.dot(n, box.x)) + sl.abs(sl.dot(n, box.y)) + sl.abs(sl.dot(n, box.z))
    return sl.dot(n, box.centre) + plane.w + reach < 0.0


class FrustumShader(sl.Shader):
    """Base of shaders that test boxes against the frustum."""

    view: sl.Uniform[ViewConstants]

    def is_outside(self, box: Occludee) -> bool:
        m = self.view.relative_view_projection
        return (
            is_behind(m[3] + m[0], box)
            or is_behind(m[3] - m[0], box)
            or is_behind(m[3] + m[1], box)
            or is_behind(m[3] - m[1], box)
            or is_behind(m[2], box)
            or is_behind(m[3] - m[2], box)
        )


class ComputeOccludees(FrustumShader):
    """Writes the box and the first mark of each object."""

    work_group = (GROUP,)
    culling_camera: sl.Uniform[CullingCamera]
    objects: sl.Storage[Object]
    object_positions: sl.Storage[ObjectPosition]
    object_meshes: sl.Storage[int]
    mesh_parts: sl.Storage[MeshPart]
    boxes: sl.StorageRW[Occludee]
    marks: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        object_index = sl.global_id().x
        if object_index >= len(self.marks):
            return
        object_position = self.object_positions[object_index]
        part = self.mesh_parts[self.object_meshes[object_index]]
        linear = self.objects[object_index].linear
        middle = linear @ (0.5 * (part.lower + part.upper))
        half = 0.5 * (part.upper - part.lower)
        columns = sl.transpose(linear)
        box = Occludee(
            centre=relative_position(object_position, self.view) + middle,
            depth=0.0,
            x=columns[0] * half.x,
            y=columns[1] * half.y,
            z=columns[2] * half.z,
        )
        size = sl.length(box.x) + sl.length(box.y) + sl.length(box.z)
        far = sl.length(box.centre) + size
        margin = sl.dot(self.culling_camera.margin, sl.vec3(1.0, far, far * far)) + ROUNDING * (
            sl.length(middle) + size
        )

        x = columns[0] / sl.max(sl.length(columns[0]), 1e-30)
        y = columns[1] / sl.max(sl.length(columns[1]), 1e-30)
        z = columns[2] / sl.max(sl.length(columns[2]), 1e-30)
        volume = sl.dot(x, sl.cross(y, z))
        sides = sl.abs(box.x) + sl.abs(box.y) + sl.abs(box.z) + margin
        if sl.abs(volume) > MIN_VOLUME:
            padding = margin / sl.abs(volume)
            box.x += x * padding
            box.y += y * padding
            box.z += z * padding
            sides = sl.abs(box.x) + sl.abs(box.y) + sl.abs(box.z)
            if volume < 0.0:  # mirrored: its faces must face outwards all the same
                box.z = -box.z
        else:
            box.x = sl.vec3(sides.x, 0.0, 0.0)
            box.y = sl.vec3(0.0, sides.y, 0.0)
            box.z = sl.vec3(0.0, 0.0, sides.z)

        forward = self.culling_camera.forward
        middle_depth = sl.dot(box.centre, forward)
        box.depth = (
            middle_depth
            + sl.abs(sl.dot(forward, box.x))
            + sl.abs(sl.dot(forward, box.y))
            + sl.abs(sl.dot(forward, box.z))
        )
        away = sl.max(sl.abs(box.centre) - sides, sl.vec3(0.0))
        begin = middle_depth - sl.dot(sl.abs(forward), sides)
        mark = self.initial_mark(object_index)
        is_near = (
            sl.length(away) <= self.culling_camera.near_radius or begin <= self.culling_camera.near_depth
        )
        if is_near or not far < TOO_FAR:
            mark = VISIBLE
        elif self.is_outside(box):
            mark = OUTSIDE
        if object_position.draw_list < 0:  # it is on no list
            mark = OUTSIDE
        if is_near or mark == OUTSIDE or not far < TOO_FAR:
            box.x = sl.vec3(0.0)
            box.y = sl.vec3(0.0)
            box.z = sl.vec3(0.0)
        self.boxes[object_index] = box
        self.marks[object_index] = sl.uint(mark)

    def initial_mark(self, object_index: int) -> int:
        return HIDDEN


class BoxVarying(sl.Struct):
    """The varyings of `MarkBoxes`."""

    clip: sl.vec4
    object_index: int


class MarkBoxes(sl.Shader):
    """Marks each object of whose box a fragment passes the depth test."""

    early_depth = True
    camera: sl.Uniform[BoxCamera]
    boxes: sl.Storage[Occludee]
    marks: sl.StorageRW[sl.uint]

    def vertex(self, v: CubeCorner) -> BoxVarying:
        object_index = self.object_index()
        box = self.boxes[object_index]
        p = v.position
        corner = box.centre + box.x * p.x + box.y * p.y + box.z * p.z
        return BoxVarying(
            clip=self.camera.relative_view_projection @ sl.vec4(corner, 1.0), object_index=object_index
        )

    def object_index(self) -> int:
        return sl.instance_index()

    def fragment(self, v: BoxVarying) -> None:
        self.marks[v.object_index] = sl.uint(VISIBLE)


class MarkListedBoxes(MarkBoxes):
    """Like `MarkBoxes`, for the boxes of listed rows only."""

    object_indices: sl.Storage[sl.uint]

    def object_index(self) -> int:
        return int(self.object_indices[sl.instance_index()])


class Occludees:
    """The boxes and marks of `count` objects, and the draws that test the boxes.

    Attributes:
        boxes, marks: buffers with a row for each object.
        cube: the mesh that boxes are drawn as.
        mark_shader, mark_listed_shader: the shaders that mark the objects that are tested as `mesh`.
    """

    mark_shader: type[MarkBoxes] = MarkBoxes
    mark_listed_shader: type[MarkBoxes] = MarkListedBoxes

    def __init__(self, device: Device, count: int, shader: type[ComputeOccludees] = ComputeOccludees) -> None:
        """`shader` is the shader that finds the boxes and decides their first marks."""
        self.count = count
        self.boxes = device.storage(Occludee, count, label="boxes")
        self.marks = device.storage(sl.uint, count, label="marks")
        self.cube = make_cube(device)
        self._culling_camera = device.uniform(
            _culling_camera(Camera.look_at((0.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
        )
        self._device = device
        self._shader: Program[...] = device.program(shader)

    @property
    def groups(self) -> int:
        """Number of work-groups of `GROUP` that have an invocation for each row."""
        return -(-self.count // GROUP)

    @property
    def mesh(self) -> Mesh:
        """The mesh that objects are tested as."""
        return self.cube

    @property
    def culling_camera(self) -> UniformBuffer[CullingCamera]:
        """The camera that boxes are found for."""
        return self._culling_camera

    def aim(self, camera: Camera, size: tuple[int, int]) -> None:
        """Write the camera that boxes are found for, in an image of `size`."""
        self._culling_camera.write(_culling_camera(camera, size))

    def compute_boxes(self, encoder: Encoder, arrays: SceneArrays, **more: sl.StorageRange[Any]) -> None:
        """Find the boxes as the camera sees them, and set all first marks; `more` are further bindings."""
        encoder.dispatch(
            self._shader,
            self.groups,
            view=arrays.view,
            culling_camera=self._culling_camera,
            objects=arrays.objects,
            object_positions=arrays.object_positions,
            object_meshes=arrays.object_meshes,
            mesh_parts=arrays.mesh_parts,
            boxes=self.boxes,
            marks=self.marks,
            **more,
        )

    def mark_all(self, encoder: Encoder, camera: UniformBuffer[BoxCamera], depth: Depth) -> None:
        """Mark the objects whose boxes are visible in the open pass; `camera` leads to its clip space."""
        with self._states(encoder, depth):
            encoder.draw(
                self._device.program(self.mark_shader),
                self.mesh,
                self.count,
                camera=camera,
                boxes=self.boxes,
                marks=self.marks,
                **self._shape_bindings(),
            )

    def mark_boxes(
        self,
        encoder: Encoder,
        camera: UniformBuffer[BoxCamera],
        depth: Depth,
        boxes: StorageBuffer[Occludee],
        marks: StorageBuffer[sl.uint],
    ) -> None:
        """Mark like `mark_all`, for boxes of anything, with a mark for each."""
        with self._states(encoder, depth):
            mark = self._device.program(MarkBoxes)
            encoder.draw(mark, self.cube, boxes.count, camera=camera, boxes=boxes, marks=marks)

    def mark_listed(
        self,
        encoder: Encoder,
        camera: UniformBuffer[BoxCamera],
        depth: Depth,
        object_indices: StorageBuffer[sl.uint],
        draw: StorageBuffer[Any],
    ) -> None:
        """Mark like `mark_all`, for the boxes of `object_indices` only, whose number `draw` holds."""
        with self._states(encoder, depth):
            encoder.draw_indirect(
                self._device.program(self.mark_listed_shader),
                self.mesh,
                IndirectDraws(draw, 1),
                camera=camera,
                boxes=self.boxes,
                marks=self.marks,
                object_indices=object_indices,
                **self._shape_bindings(),
            )

    def _shape_bindings(self) -> dict[str, Any]:
        """The bindings of the marking shaders that say what each object's shape is."""
        return {}

    def _states(self, encoder: Encoder, depth: Depth) -> StateScope:
        return encoder.states(
            DepthTest.ON, DepthWrite.OFF, _NEARER[depth], CullMode.BACK, FrontFace.COUNTER_CLOCKWISE
        )

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for resource in (self.boxes, self.marks, self.cube, self._culling_camera):
            resource.destroy()


def _culling_camera(camera: Camera, size: tuple[int, int] = UNKNOWN_SIZE) -> CullingCamera:
    if is_parallel(camera.projection):
        *normal, d = camera.frustum.planes[FrustumPlane.NEAR].tolist()
        radius, near = -1.0, -(float(camera.position @ normal) + d)
    else:
        radius, near = _RADIUS_MARGIN * near_radius(camera), -1e30
    return CullingCamera(
        forward=camera.forward, near_radius=radius, margin=margin_terms(camera, size), near_depth=near
    )
