"""Culling of meshlets on the device: of the objects that are visible, the parts that aren't.

Each entry of a scene's lists has a state: it is a meshlet of an object, or an object or level of detail that is whole.

1. `CullMeshlets` computes the box of each entry of an object that isn't OUTSIDE. Entries outside the frustum are
   OUTSIDE, meshlets whose triangles all face away are TURNED_AWAY, and of the others those of visible objects VISIBLE
   that were visible in the last frame, and the rest HIDDEN.
2. `CountMeshlets` lists the entries that are VISIBLE, and marks them DRAWN.
3. The depth of these shows which entries of visible objects aren't hidden. `depth_pyramid` compares their boxes with
   its pyramid (`CompareMeshlets`); `two_pass` draws them, as it does those of objects (`PickMeshlets`, `MarkBoxes`,
   `ShowMeshlets`). Those that are not yet drawn are the second list. All are what was visible in the next frame.

Boxes are those along the world's axes around the meshlet's transformed box, padded as those of objects.

**Facing away.** Triangles are seen from their backs where the eye is behind all their planes. An affine map keeps
sides of planes, so the test is in mesh space, with the eye transformed there: it holds for any scale, and for mirrored
objects, whose winding is taken the other way round. With v the vector from the middle of the meshlet to the eye, r its
radius and n any normal in the cone, the eye is behind all planes if |v| max(n · v/|v|) < -r; for parallel projections
v is the direction to the eye and r is 0. The limit is lower by the rounding of the transformed eye, and by `_SLACK`:
within that, snapping to parts of a pixel may turn a triangle around. Objects with two sides have no such test.
"""

from __future__ import annotations

from typing import Any, Final

import rhi.shading as sl
from renderer.shaders import (
    ListEntry,
    Meshlet,
    Object,
    ObjectPosition,
    relative_position,
)
from renderer.visibility.boxes.bounds import ROUNDING, TOO_FAR
from renderer.visibility.gpu.occludees import (
    DRAWN,
    GROUP,
    HIDDEN,
    OUTSIDE,
    VISIBLE,
    CullingCamera,
    FrustumShader,
    Occludee,
    Occludees,
)
from renderer.visibility.scene_drawer import SceneArrays
from rhi import Device, Encoder, Program, StorageBuffer

TURNED_AWAY: Final = 4
"""The state of a meshlet whose triangles all face away."""
UNUSED: Final = 5
"""The state of an entry whose object is outside the frustum, or drawn as another level of detail."""
WAS_VISIBLE: Final = 8
"""Added to the state of an entry that the depth of its frame didn't hide."""
ALWAYS_VISIBLE: Final = -1.0
"""The `depth` of a box that is too near or too far for a test."""
_SLACK: Final = 0.005
_ROUNDING: Final = 1e-6


class CullMeshlets(FrustumShader):
    """Writes the box and the first state of each entry."""

    work_group = (GROUP,)
    culling_camera: sl.Uniform[CullingCamera]
    objects: sl.Storage[Object]
    object_positions: sl.Storage[ObjectPosition]
    entries: sl.Storage[ListEntry]
    meshlets: sl.Storage[Meshlet]
    marks: sl.Storage[sl.uint]
    boxes: sl.StorageRW[Occludee]
    states: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        index = sl.global_id().x
        if index >= len(self.entries):
            return
        entry = self.entries[index]
        meshlet = self.meshlets[entry.mesh_part]
        mark = self.marks[entry.object]
        if mark == sl.uint(OUTSIDE) or not self.is_drawn(entry, meshlet):
            self.states[index] = sl.uint(UNUSED)
            return
        was_visible = self.states[index] >= sl.uint(WAS_VISIBLE)
        linear = self.objects[entry.object].linear
        columns = sl.transpose(linear)
        position = self.object_positions[entry.object]
        relative = relative_position(position, self.view)
        middle = linear @ (0.5 * (meshlet.lower + meshlet.upper))
        half = 0.5 * (meshlet.upper - meshlet.lower)
        sides = sl.abs(columns[0]) * half.x + sl.abs(columns[1]) * half.y + sl.abs(columns[2]) * half.z
        size = sides.x + sides.y + sides.z
        far = sl.length(relative + middle) + size
        sides += sl.dot(self.culling_camera.margin, sl.vec3(1.0, far, far * far)) + ROUNDING * (
            sl.length(middle) + size
        )
        box = Occludee(
            centre=relative + middle,
            depth=0.0,
            x=sl.vec3(sides.x, 0.0, 0.0),
            y=sl.vec3(0.0, sides.y, 0.0),
            z=sl.vec3(0.0, 0.0, sides.z),
        )
        forward = self.culling_camera.forward
        away = sl.max(sl.abs(box.centre) - sides, sl.vec3(0.0))
        begin = sl.dot(box.centre, forward) - sl.dot(sl.abs(forward), sides)
        is_near = (
            sl.length(away) <= self.culling_camera.near_radius or begin <= self.culling_camera.near_depth
        )
        state = HIDDEN
        is_far = not far < TOO_FAR
        if is_near or is_far:
            box.depth = ALWAYS_VISIBLE
        if not is_far and self.is_outside(box):
            state = OUTSIDE
        elif not is_far and position.draw_list // 2 % 2 == 0 and self.faces_away(meshlet, entry, relative):
            state = TURNED_AWAY
        if state == HIDDEN and mark == sl.uint(VISIBLE) and was_visible:
            state = VISIBLE
        self.boxes[index] = box
        self.states[index] = sl.uint(state)

    def is_drawn(self, entry: ListEntry, meshlet: Meshlet) -> bool:
        return True

    def faces_away(self, meshlet: Meshlet, entry: ListEntry, relative: sl.vec3) -> bool:
        if not meshlet.cosine > 0.0:
            return False
        linear = sl.transpose(self.objects[entry.object].linear)
        normal = sl.transpose(self.objects[entry.object].normal)  # the rows of the inverse, times `scale`
        is_parallel = self.culling_camera.near_radius < 0.0
        to_eye = -self.culling_camera.forward if is_parallel else -relative
        reach = 0.0 if is_parallel else 1.0
        scale = sl.dot(linear[0], normal[0])
        if not sl.abs(scale) > 0.0:
            return False
        eye = sl.vec3(sl.dot(normal[0], to_eye), sl.dot(normal[1], to_eye), sl.dot(normal[2], to_eye)) / scale
        v = eye - reach * 0.5 * (meshlet.lower + meshlet.upper)
        terms = sl.length(normal[0]) + sl.length(normal[1]) + sl.length(normal[2])
        skew = sl.length(linear[0]) * sl.length(normal[0]) / sl.abs(scale)
        rounding = _ROUNDING * sl.length(to_eye) * terms / sl.abs(scale) * (1.0 + skew)
        distance = sl.length(v)
        cosine = sl.dot(meshlet.axis, v) / distance
        if not cosine < meshlet.cosine:
            return False
        sine = sl.sqrt(sl.max(1.0 - cosine * cosine, 0.0))
        spread = sl.sqrt(sl.max(1.0 - meshlet.cosine * meshlet.cosine, 0.0))
        largest = cosine * meshlet.cosine + sine * spread
        return largest * distance < -(reach * meshlet.radius + rounding + _SLACK * distance)


class CullMeshletsOfLevels(CullMeshlets):
    """Culls as `CullMeshlets` those entries that belong to what their object is drawn as."""

    drawn_parts: sl.Storage[int]

    def is_drawn(self, entry: ListEntry, meshlet: Meshlet) -> bool:
        return self.drawn_parts[entry.object] == meshlet.drawn_as


class CountMeshlets(sl.Shader):
    """Counts 1 for each entry that is VISIBLE, and behind those 1 for each object marked HIDDEN; what is counted is
    DRAWN, and so are all VISIBLE objects."""

    work_group = (GROUP,)
    marks: sl.StorageRW[sl.uint]
    states: sl.StorageRW[sl.uint]
    counts: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        index = sl.global_id().x
        if index < len(self.states):
            is_visible = self.states[index] % sl.uint(WAS_VISIBLE) == sl.uint(VISIBLE)
            self.counts[index] = sl.uint(1) if is_visible else sl.uint(0)
            if is_visible:
                self.states[index] += sl.uint(DRAWN - VISIBLE)
            if index == 0:
                self.counts[len(self.states) + len(self.marks)] = sl.uint(0)
        if index < len(self.marks):
            mark = self.marks[index]
            self.counts[len(self.states) + index] = sl.uint(1) if mark == sl.uint(HIDDEN) else sl.uint(0)
            if mark == sl.uint(VISIBLE):
                self.marks[index] = sl.uint(DRAWN)


class PickMeshlets(sl.Shader):
    """Gives a zero extent to the boxes that needn't be drawn, and records those entries of visible objects as seen that
    are too near or too far for a test."""

    work_group = (GROUP,)
    entries: sl.Storage[ListEntry]
    marks: sl.Storage[sl.uint]
    states: sl.Storage[sl.uint]
    boxes: sl.StorageRW[Occludee]
    seen: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        index = sl.global_id().x
        if index >= len(self.states):
            return
        mark = self.marks[self.entries[index].object]
        state = self.states[index]
        is_shown = mark == sl.uint(VISIBLE) or mark == sl.uint(DRAWN)
        is_candidate = is_shown and (state == sl.uint(HIDDEN) or state == sl.uint(DRAWN))
        is_sure = self.boxes[index].depth == ALWAYS_VISIBLE
        self.seen[index] = sl.uint(VISIBLE if is_candidate and is_sure else HIDDEN)
        if is_sure or not is_candidate:
            none = sl.vec3(0.0)
            self.boxes[index] = Occludee(centre=none, depth=0.0, x=none, y=none, z=none)


class ShowMeshlets(sl.Shader):
    """Shows the entries that are seen, and records them for the next frame."""

    work_group = (GROUP,)
    seen: sl.Storage[sl.uint]
    states: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        index = sl.global_id().x
        if index < len(self.states) and self.seen[index] == sl.uint(VISIBLE):
            state = self.states[index]
            self.states[index] = sl.uint(WAS_VISIBLE) + (
                sl.uint(VISIBLE) if state == sl.uint(HIDDEN) else state
            )


class MeshletCulling:
    """The states of all entries of a scene's lists, for one algorithm.

    Attributes:
        states: (entries,) the states, created by the first `cull`.
    """

    def __init__(self, device: Device) -> None:
        self.boxes: StorageBuffer[Occludee] | None = None
        self.states: StorageBuffer[sl.uint] | None = None
        self._seen: StorageBuffer[sl.uint] | None = None  # created by the first `pick`
        self._device = device

    def cull(
        self,
        encoder: Encoder,
        arrays: SceneArrays,
        occludees: Occludees,
        drawn_parts: StorageBuffer[int] | None,
    ) -> None:
        """Compute the boxes and first states of all entries; objects are drawn as `drawn_parts`, if there are levels
        of detail."""
        boxes, states = self._fit(arrays.list_entries.count)
        levels = {} if drawn_parts is None else {"drawn_parts": drawn_parts}
        shader: type[Any] = CullMeshlets if drawn_parts is None else CullMeshletsOfLevels
        program: Program[...] = self._device.program(shader)
        encoder.dispatch(
            program,
            -(-states.count // GROUP),
            view=arrays.view,
            culling_camera=occludees.culling_camera,
            objects=arrays.objects,
            object_positions=arrays.object_positions,
            entries=arrays.list_entries,
            meshlets=arrays.meshlets,
            marks=occludees.marks,
            boxes=boxes,
            states=states,
            **levels,
        )

    def count(self, encoder: Encoder, occludees: Occludees, counts: StorageBuffer[sl.uint]) -> None:
        """Count the visible entries and the hidden objects, and mark what is visible DRAWN."""
        assert self.states is not None
        encoder.dispatch(
            self._device.program(CountMeshlets),
            -(-max(self.states.count, occludees.count) // GROUP),
            marks=occludees.marks,
            states=self.states,
            counts=counts,
        )

    def pick(
        self, encoder: Encoder, arrays: SceneArrays, occludees: Occludees
    ) -> tuple[StorageBuffer[Occludee], StorageBuffer[sl.uint]]:
        """Pick the boxes to draw; return them, and the marks that their fragments set."""
        assert self.boxes is not None
        assert self.states is not None
        if self._seen is None:
            self._seen = self._device.storage(sl.uint, self.states.count, label="seen meshlets")
        encoder.dispatch(
            self._device.program(PickMeshlets),
            -(-self.states.count // GROUP),
            entries=arrays.list_entries,
            marks=occludees.marks,
            states=self.states,
            boxes=self.boxes,
            seen=self._seen,
        )
        return self.boxes, self._seen

    def show(self, encoder: Encoder) -> None:
        """Show the meshlets of which fragments were seen since `pick`."""
        assert self.states is not None
        assert self._seen is not None
        encoder.dispatch(
            self._device.program(ShowMeshlets),
            -(-self.states.count // GROUP),
            seen=self._seen,
            states=self.states,
        )

    def compare(
        self, encoder: Encoder, arrays: SceneArrays, occludees: Occludees, shader: type[Any], **pyramid: Any
    ) -> None:
        """Show the meshlets that a depth pyramid doesn't hide; `shader` is `CompareMeshlets` or a variant of it."""
        assert self.states is not None
        encoder.dispatch(
            self._device.program(shader),
            -(-self.states.count // GROUP),
            view=arrays.view,
            boxes=self.boxes,
            entries=arrays.list_entries,
            marks=occludees.marks,
            states=self.states,
            **pyramid,
        )

    def _fit(self, count: int) -> tuple[StorageBuffer[Occludee], StorageBuffer[sl.uint]]:
        """Return the boxes and states of so many entries, new ones if their number has changed."""
        if self.boxes is None or self.states is None or self.states.count != count:
            self.destroy()
            self.boxes = self._device.storage(Occludee, count, label="meshlet boxes")
            self.states = self._device.storage(sl.uint, count, label="meshlet states")
        return self.boxes, self.states

    def destroy(self) -> None:
        """Destroy the buffers on the device."""
        for resource in (self.boxes, self.states, self._seen):
            if resource is not None:
                resource.destroy()
        self.boxes = self.states = self._seen = None
