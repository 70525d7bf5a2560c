"""The buffers of a scene on a device. They are written only where they differ from what the device holds.

- All meshes are one mesh, all images are layers of a few arrays (`images`), and per-object data is one row each. So a
  whole scene can be one `draw_many`, in which an object's row is the base instance of its draw.
- An object is a row of two arrays: `places` (32 bytes) has its position and mesh, `objects` (112 bytes) all else.
  Positions are pairs of floats, from which shaders subtract the eye's position: a moved eye changes one constant.
- Vertices of what is simulated are uploaded, or computed on the device where they lie (`DeformingOnDevice`).
- Objects that can't move aren't examined again, and simulated ones only before they are drawn. So a frame costs the
  CPU the same however many there are of them that aren't drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules, shaders
from renderer.frame.hidden import HiddenObjects
from renderer.frame.images import AS_GIVEN, SceneImages, TextureSettings
from renderer.frame.lamps import Lamps, Views
from renderer.frame.mirrors import (
    MirroredArray,
    MirroredValue,
    R,
    Releasable,
    S,
    Workspaces,
    join_runs,
    split_doubles,
)
from renderer.lights.lists import list_lights
from renderer.scene import Camera, Deformed, DeformingOnDevice, Scene, Simulator, normal_matrices
from renderer.scene.arrays import list_ranges
from renderer.scene.lights import Lights
from renderer.visibility import SceneArrays
from renderer.visibility.boxes.volumes import find_in_view
from renderer.visibility.gpu.draw_lists import DrawArguments
from rhi import (
    DRAW,
    Buffer,
    CullMode,
    Device,
    Encoder,
    FrontFace,
    IndirectDraws,
    Mesh,
    Program,
    State,
    StorageBuffer,
    UniformBuffer,
    refuse,
)
from rhi.shading import UniformRange, uint

DRAW_GROUPS: Final[tuple[tuple[State, ...], ...]] = (
    (FrontFace.COUNTER_CLOCKWISE,),
    (FrontFace.CLOCKWISE,),
    (FrontFace.COUNTER_CLOCKWISE, CullMode.NONE),
    (FrontFace.CLOCKWISE, CullMode.NONE),
)
"""The states by which the groups of objects of one shader are drawn, beside those of a pass, which culls backs. A
transform that mirrors objects reverses the winding of their triangles, and of materials with two sides no faces are
culled."""


def find_states(group: int) -> tuple[State, ...]:
    """Return the states by which a group of objects is drawn."""
    return DRAW_GROUPS[group % len(DRAW_GROUPS)]


SIMULATION_EVENT: Final = "simulation"
"""The label of what the device computes of simulations."""


class SceneResources:
    """A scene on a device, shared by techniques.

    Attributes:
        mesh: all meshes in one. draws: (n,) of `rhi.DRAW`, one for each object.
        mirrored: (n,) bool, whether an object's transform mirrors it, which reverses the winding of its triangles.
        group: (n,) the number of each object's group: objects of one group are drawn with the same program and states.
            It is the place of the states in `DRAW_GROUPS`, and 4 for each shader before that of the object's material.
        groups: the numbers of the groups that have objects, ascending.
        parameters: of each of the scene's shaders of materials, the values that it has for each material.
        is_transparent: (n,) bool, whether an object is transparent. transparent_rows: the rows of those that are.
        tessellated_rows: the rows of the height fields, ascending. The device chooses their triangles; their `draws`
            have as many as there can be, of which those that aren't used are empty.
        tessellations: how often triangles were chosen.
        indices: the indices of `mesh`, as shaders write them; only in scenes with height fields.
        light_cutoff: the light of a lamp that is too faint to matter, 0 for none (`Lights.cut`).
        images: the scene's images; None if no material reads any.
        objects, places, materials, directional, point, spot, light_rows: the arrays that shaders read; point and spot
            lights are left out if none of them reaches an object.
        source_radii: the radii of lamps' sources, two channels: point lights, spot lights.
        ambient: the constants of ambient light.
        simulator: runs the simulations of what is drawn.
        hidden: the objects that have been hidden for so long that they rest.
        wake: brings height fields that rest to this frame's view, given rows among which they are.
    """

    def __init__(self, device: Device, scene: Scene, textures: TextureSettings = AS_GIVEN) -> None:
        """Upload a scene, whose textures are read as well as these settings say. If anything can't be created, nothing
        is left on the device."""
        with ExitStack() as made:
            self._made = made
            self._make(device, scene, textures)
            self._made = made.pop_all()

    def _keep(self, resource: R) -> R:
        """Destroy the resource together with the others; return it."""
        self._made.callback(resource.destroy)
        return resource

    def _make(self, device: Device, scene: Scene, textures: TextureSettings) -> None:
        self.scene = scene
        self._workspaces: Workspaces = self._keep(Workspaces(device))
        self.simulator: Simulator = scene.make_simulator()
        self.hidden = HiddenObjects(scene, self.simulator.deformed)
        self.wake: Callable[[NDArray[np.int64]], None] = lambda _: None
        self._held = np.zeros(len(scene.objects))  # by object, the state of the vertices on the device
        self._device = device
        self._material_version = -1  # that of the materials on the device
        self.light_cutoff = 0.0
        self._cut: tuple[object, Lights] = (None, scene.lights)
        objects = scene.objects
        computed = [one.objects for one in scene.simulated if isinstance(one.simulation, DeformingOnDevice)]
        self._is_computed: NDArray[np.bool_] | None = None  # by object, whether the device computes its vertices
        self._computing: dict[Simulator, list[DeformingOnDevice]] = {}  # what holds memory on the device
        if computed and device.capabilities.compute:
            self._is_computed = np.zeros(len(objects), bool)
            self._is_computed[np.concatenate(computed)] = True
            self._made.callback(self._release_all)
        self.mesh: Mesh = self._make_mesh(device, scene)
        self.tessellations = 0
        self.draws = self._make_draws()
        self.tessellated_rows: NDArray[np.int64] = np.array(sorted(scene.height_fields), np.int64)
        has_images = len(scene.textures) > 0
        self.images = self._keep(SceneImages(device, scene, textures)) if has_images else None
        keep = self._keep
        self.objects = keep(MirroredArray(device, shaders.Object, "objects"))
        self.places = keep(MirroredArray(device, shaders.ObjectPosition, "places"))
        self.materials = keep(MirroredArray(device, shaders.Material, "materials"))
        self.parameters = [
            keep(MirroredArray(device, kind.parameters, f"parameters of {kind.shader.__name__}"))
            for kind in scene.shaders
        ]
        self.directional = keep(MirroredArray(device, shaders.DirectionalLight, "directional lights"))
        self._lamps = keep(Lamps(device))
        self.point, self.spot = self._lamps.find(0)
        self.source_radii = self._lamps.radii
        self.light_rows = keep(MirroredArray(device, int, "light rows"))
        self._listed_from: object = None  # the contents of the lights that are listed
        self._lit: tuple[NDArray[Any], ...] = ()  # the state that the light lists were made from
        self._listed: NDArray[np.int64] = np.zeros(0, np.int64)  # the light rows, as they are on the device
        self._fixed_lists: tuple[NDArray[Any], ...] = ()  # those of the objects with fixed bounds
        self._reaching = (False, False)  # whether any point light is on a list, and any spot light
        self.ambient = keep(MirroredValue(device, _ambient(scene)))
        self._rows: NDArray[Any] = np.zeros(len(objects), shaders.Object.dtype)
        self._places: NDArray[Any] = np.zeros(len(objects), shaders.ObjectPosition.dtype)
        self._places["mesh"] = objects.mesh
        self.mirrored: NDArray[np.bool_] = np.zeros(len(objects), bool)
        self.transparent_rows: NDArray[np.int64] = np.zeros(0, np.int64)
        self.is_transparent: NDArray[np.bool_] = np.zeros(len(objects), bool)
        self._has_two_sides: NDArray[np.bool_] = np.zeros(len(objects), bool)
        self._shown: NDArray[np.bool_] = np.zeros(len(objects), bool)
        self.group: NDArray[np.int32] = np.zeros(len(objects), np.int32)
        self.groups: tuple[int, ...] = (0,)
        self._shader: NDArray[np.int32] = np.zeros(len(objects), np.int32)
        self._follow_materials()
        self._transform(np.arange(len(objects)))

    def _make_draws(self) -> NDArray[Any]:
        """Return the draw of each object."""
        ranges = self.scene.meshes.ranges[self.scene.objects.mesh]
        return self.mesh.draws(
            ranges["first_index"],
            ranges["index_count"],
            base_vertex=ranges["base_vertex"],
            base_instance=np.arange(len(ranges)),
        )

    def _make_mesh(self, device: Device, scene: Scene) -> Mesh:
        """Make the mesh of all meshes. Indices of height fields are written on the device, and so are vertices of some
        simulations."""
        meshes = scene.meshes
        vertices: NDArray[Any] | Buffer = meshes.vertices
        indices: NDArray[Any] | Buffer = meshes.indices
        if self._is_computed is not None:
            vertices = self._keep(device.buffer(meshes.vertices, label="vertices"))
            self._vertex_floats = device.storage(float, vertices)
        if scene.height_fields:
            indices = self._keep(device.buffer(meshes.indices, label="indices"))
            self.indices = device.storage(uint, indices)
        return self._keep(device.mesh(vertices, indices, label="meshes"))

    @cached_property
    def tessellated_draws(self) -> StorageBuffer[DrawArguments]:
        """The draws of the height fields in the order of their rows, whose number of triangles the device writes."""
        draws = self.draws[self.tessellated_rows].view(DrawArguments.dtype)
        return self._keep(self._device.storage(DrawArguments, draws, label="height field draws"))

    def count_triangles(self, rows: NDArray[np.int64]) -> int:
        """Return the number of triangles of the objects `rows` (k,), of height fields that of the last view. Where
        there are some, this waits for the device."""
        own = np.isin(rows, self.tessellated_rows)
        if not own.any():
            return self.scene.count_triangles(rows)
        counts = self.tessellated_draws.read()["count"][np.searchsorted(self.tessellated_rows, rows[own])]
        return self.scene.count_triangles(rows[~own]) + int(counts.sum()) // 3

    def draw_rows(
        self, device: Device, program: Program[...], bindings: dict[str, Any], rows: NDArray[np.int64]
    ) -> None:
        """Draw objects in one call, and each height field in one more."""
        if len(self.tessellated_rows):
            is_tessellated = np.isin(rows, self.tessellated_rows)
            for row in rows[is_tessellated].tolist():
                self.draw_tessellated(device, program, bindings, row)
            rows = rows[~is_tessellated]
        if len(rows):
            device.draw_many(program, self.mesh, self.draws[rows], **bindings)

    def draw_tessellated(self, encoder: Encoder, program: Program[...], bindings: dict[str, Any], row: int) -> None:
        """Draw a height field with as many triangles as the device has chosen."""
        place = int(np.searchsorted(self.tessellated_rows, row))
        draw = IndirectDraws(self.tessellated_draws, 1, place * DRAW.itemsize)
        encoder.draw_indirect(program, self.mesh, draw, **bindings)

    @cached_property
    def parts(self) -> StorageBuffer[shaders.MeshPart]:
        """The meshes' boxes and index ranges, for shaders that make draws; created on first use."""
        meshes = self.scene.meshes
        parts = np.zeros(len(meshes), shaders.MeshPart.dtype)
        parts["lower"], parts["upper"] = meshes.lower, meshes.upper
        parts["first"], parts["count"] = meshes.ranges["first_index"], meshes.ranges["index_count"]
        parts["base_vertex"] = meshes.ranges["base_vertex"]
        return self._keep(self._device.storage(shaders.MeshPart, parts, label="mesh parts"))

    def mirror(self, value: S) -> UniformBuffer[S]:
        """Return a uniform buffer with this value, the same one for each type of struct."""
        return self._workspaces.mirror(value)

    def workspace(self, kind: Callable[[Device], R]) -> R:
        """Return what a technique keeps between frames beside the scene: `kind(device)`, which is made on first use and
        destroyed with the resources. What depends on the camera is kept by its view (`View.workspace`)."""
        return self._workspaces.find(kind)

    def release(self, kind: Callable[[Device], Releasable]) -> None:
        """Let a workspace, if it was made, destroy what it can make again."""
        kept = self._workspaces.peek(kind)
        if kept is not None:
            kept.release()

    def list_arrays(self, view: UniformRange[shaders.ViewConstants]) -> SceneArrays:
        """Return the buffers of objects and meshes, as visibility algorithms on the device read them, and the constants
        of a view."""
        objects, places = self.objects.buffer, self.places.buffer
        assert objects is not None, "a scene has at least one object"
        assert places is not None
        return SceneArrays(view, objects, places, self.parts)

    def simulate(
        self, rows: NDArray[np.int64], *, is_drawn: bool = True, leave: Callable[[], None] | None = None
    ) -> None:
        """Bring the simulated ones of the objects `rows` to the frame's time. Call it before they are drawn.

        Args:
            leave: ends a render pass that may be open; called if the device computes vertices.
        """
        if is_drawn and (resting := rows[self.hidden.rests[rows]]).size:
            if leave is not None:
                leave()
            self.wake(resting)
        computed = self._is_computed
        if computed is not None and leave is not None and self.simulator.is_due(rows[computed[rows]]):
            leave()
        advanced = self.simulator.advance(rows, is_drawn=is_drawn)
        if len(advanced.moved):
            self._transform(advanced.moved)
            moved = np.sort(advanced.moved)
            self.objects.write(self._rows, moved)
            self.places.write(self._places, moved)
        for one in advanced.deformed:
            self._deform(one)

    def _deform(self, deformed: Deformed) -> None:
        """Bring the vertices of objects that have another state than those on the device there: they are computed
        there, or uploaded, adjacent meshes together."""
        changed = np.flatnonzero(self._held[deformed.rows] != deformed.states)
        if not len(changed):
            return
        mesh = self.scene.objects.mesh[deformed.rows[changed]]
        begins = self.scene.meshes.ranges["base_vertex"][mesh].astype(np.int64)
        if self._is_computed is not None and isinstance(deformed.simulation, DeformingOnDevice):
            self._note_computing(deformed.simulation)
            stride = self.scene.meshes.vertices.itemsize // 4
            with self._device.event(SIMULATION_EVENT):
                deformed.simulation.deform(self._device, deformed.members[changed], self._vertex_floats, begins, stride)
            self._held[deformed.rows] = deformed.states
            return
        order = np.argsort(begins)
        changed, begins, sizes = changed[order], begins[order], self.scene.meshes.vertex_counts[mesh[order]]
        vertices = deformed.simulation.vertices(deformed.members[changed])
        if len(vertices) != int(sizes.sum()):
            given, call = f"{len(vertices)} vertices", f"{type(deformed.simulation).__name__}.vertices"
            refuse(rules.BAD_SIMULATION, call, given, f"the {sizes.sum()} of the members' meshes")
        buffer, at = self.mesh.vertices, 0
        assert buffer is not None
        for first, end in join_runs(begins, sizes):
            part = self.scene.meshes.vertices[first:end]
            if part.dtype != vertices.dtype:  # a second uv, tangents and colours stay as they are
                part = part.copy()
                for name in vertices.dtype.names or ():
                    part[name] = vertices[name][at : at + end - first]
            else:
                part = vertices[at : at + end - first]
            buffer.write(part, first)
            at += end - first
        self._held[deformed.rows] = deformed.states

    def _note_computing(self, simulation: DeformingOnDevice) -> None:
        """Note that a simulation of the simulator holds memory on the device, and release those that it has replaced,
        because time went back."""
        held = self._computing.setdefault(self.simulator, [])
        if any(one is simulation for one in held):
            return
        present = list(map(id, self.simulator.simulations))
        for one in held:
            if id(one) not in present:
                one.release(self._device)
        held[:] = [*(one for one in held if id(one) in present), simulation]

    def _release_all(self) -> None:
        for held in self._computing.values():
            for one in held:
                one.release(self._device)

    def expect(self, camera: Camera, rows: NDArray[np.int64], others: NDArray[np.int64] | None = None) -> None:
        """Simulate those of the objects `rows` that `camera` may see, because they will probably be drawn, and all
        `others` that are shown. It is one call, so that steps aren't divided by what was drawn."""
        rows = self.find_in_view(camera, rows) if len(rows) else rows
        if others is not None:
            rows = np.union1d(rows, self.scene.objects.find_shown(others))
        if len(rows):
            self.simulate(rows, is_drawn=False)

    def find_in_view(self, camera: Camera, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return those of the objects `rows` whose bounds are not outside the view."""
        return find_in_view(self.scene, camera, rows)

    def has_shader(self, number: int) -> bool:
        """Return whether any object has this shader of its material: 0 for the renderer's, or 1 more than the place of
        its own in the scene's `shaders`."""
        return any(group // len(DRAW_GROUPS) == number for group in self.groups)

    def find_group(self, rows: NDArray[np.int64], number: int) -> slice | NDArray[np.bool_]:
        """Return the index of those of `rows` whose objects are in a group. In a scene with one group this takes no
        test."""
        return slice(None) if len(self.groups) == 1 else self.group[rows] == number

    def pair_lights(
        self, rows: NDArray[np.int64], lights: NDArray[np.int64], *, spots: bool
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the objects (k,) and the entries (k,) of `light_rows` that are the pairs of one of the objects `rows`
        and a light that reaches it. Only the point or spot lights `lights`, ascending, are paired. Pairs are in the
        order of their lights."""
        begins = self._rows["points_end" if spots else "lights_begin"][rows].astype(np.int64)
        counts = self._rows["lights_end" if spots else "points_end"][rows] - begins
        entries = list_ranges(begins, counts)
        lit = self._listed[entries]
        chosen = np.zeros(len(self.scene.lights.spot if spots else self.scene.lights.point), bool)
        chosen[lights] = True
        kept = np.flatnonzero(chosen[lit])
        order = kept[np.argsort(lit[kept], kind="stable")]
        return np.repeat(rows, counts)[order], entries[order]

    @property
    def lights(self) -> Lights:
        """The scene's lights; with a `light_cutoff`, they end where their light is fainter."""
        lights = self.scene.lights
        if not self.light_cutoff:
            return lights
        key = lights.contents, self.light_cutoff
        if self._cut[0] != key:
            self._cut = key, lights.cut(self.light_cutoff)
        return self._cut[1]

    @property
    def reaching(self) -> tuple[bool, bool]:
        """Whether any point light reaches an object, and whether any spot light does."""
        return self._reaching

    def update(self, *eyes: Camera, views: Views = ()) -> None:
        """Update the buffers to the scene, with lights for each of a frame's `eyes`; `look_from` chooses one. Of two
        eyes, `views` are the constants on the device."""
        scene, lights = self.scene, self.lights
        following = scene.objects.following_rows  # others that move are simulated before they are drawn
        self._transform(following)
        if self._listed_from is not lights.contents:
            self.directional.write(scene.lights.directional)
        has_others = False
        if self._material_version != scene.material_version:
            self._material_version = scene.material_version
            self.materials.write(scene.materials)
            for mirrored, values in zip(self.parameters, scene.parameters, strict=True):
                mirrored.write(values)
            has_others = self._follow_materials()
        self.objects.write(self._rows, None if self._list_lights() or has_others else following)
        self.places.write(self._places, None if has_others else following)
        self._lamps.update(lights, self._reaching, [eye.position for eye in eyes], views)
        self.look_from(0)
        self.ambient.write(_ambient(scene))

    def look_from(self, eye: int) -> None:
        """Let `point` and `spot` be the lights relative to one of the frame's eyes."""
        self.point, self.spot = self._lamps.find(eye)

    def _follow_materials(self) -> bool:
        """Find the objects that are shown, transparent, with two sides, their shaders, meshes and materials, and return
        whether they are others than before."""
        scene, objects = self.scene, self.scene.objects
        rows, two_sided = scene.find_transparent(), scene.materials["double_sided"][objects.material] != 0
        shader = scene.materials["shader"][objects.material]
        has_others = not np.array_equal(objects.mesh, self._places["mesh"])
        if has_others:
            self._places["mesh"] = objects.mesh
            self.draws = self._make_draws()
        if not has_others and all(
            np.array_equal(new, old)
            for new, old in (
                (rows, self.transparent_rows),
                (two_sided, self._has_two_sides),
                (shader, self._shader),
                (objects.shown, self._shown),
                (objects.material, self._rows["material"]),
            )
        ):
            return False
        self._rows["material"] = objects.material
        self.transparent_rows, self._has_two_sides, self._shown = rows, two_sided, objects.shown.copy()
        self._shader = shader
        self.is_transparent[:] = False
        self.is_transparent[rows] = True
        self._group_all()
        self._places["draw_list"] = self._find_lists(slice(None))
        return True

    def _find_lists(self, rows: slice | NDArray[np.int64]) -> NDArray[np.int32]:
        """Return on which of the device's lists the objects `rows` are; -1 for none."""
        is_listed = self._shown[rows] & ~self.is_transparent[rows]
        return np.where(is_listed, self.group[rows], -1).astype(np.int32)

    def _group_all(self) -> None:
        """Divide the objects into groups."""
        self.group = self.mirrored + 2 * self._has_two_sides.astype(np.int32) + len(DRAW_GROUPS) * self._shader
        self.groups = tuple(np.unique(self.group).tolist())

    def _transform(self, rows: NDArray[np.int64]) -> None:
        """Update the rows of the arrays that hold the transforms of the objects `rows`."""
        if not len(rows):
            return
        world = self.scene.nodes.world[self.scene.objects.node[rows]]
        normal = normal_matrices(world)
        largest = np.abs(normal).max(axis=(1, 2), keepdims=True)  # no float32 under- or overflow
        part = self._rows[rows]
        part["linear"][:, :, :3] = world[:, :3, :3]
        part["normal"][:, :, :3] = normal / np.where(largest > 0.0, largest, 1.0)
        self._rows[rows] = part
        mirrored = np.linalg.det(world[:, :3, :3]) < 0.0
        if (mirrored != self.mirrored[rows]).any():
            self.mirrored[rows] = mirrored
            self._group_all()
        place = self._places[rows]
        place["high"], place["low"] = split_doubles(world[:, :3, 3])
        place["draw_list"] = self._find_lists(rows)
        self._places[rows] = place

    def _list_lights(self) -> bool:
        """List the lights that reach each object, and return whether the lists may have changed.

        The lists of objects with fixed bounds come first, so that those of others don't shift them.
        """
        objects, lights = self.scene.objects, self.lights
        is_known, self._listed_from = self._listed_from is lights.contents, lights.contents
        if is_known and not len(objects.following_rows):
            return False
        positions = np.concatenate([lights.point["position"], lights.spot["position"]])
        ranges = np.concatenate([lights.point["range"], lights.spot["range"]]).astype(np.float64)
        rows, points = objects.following_rows, len(lights.point)
        state = (positions, ranges, np.array([points]), objects.lower[rows], objects.upper[rows])
        if self._lit and all(map(np.array_equal, self._lit, state)):
            return False
        fixed = objects.fixed_rows
        if not self._lit or not all(map(np.array_equal, self._lit[:2], state)):
            self._fixed_lists = list_lights(objects.lower[fixed], objects.upper[fixed], positions, ranges)
        self._lit = state
        order = np.concatenate([fixed, rows])
        ends, listed = self._fixed_lists
        more, following = list_lights(objects.lower[rows], objects.upper[rows], positions, ranges)
        ends, listed = np.concatenate([ends, ends[-1] + more[1:]]), np.concatenate([listed, following])
        is_spot = listed >= points
        spots = np.concatenate([[0], np.cumsum(is_spot)])[ends]
        self._rows["lights_begin"][order] = ends[:-1]
        self._rows["points_end"][order] = ends[1:] - np.diff(spots)
        self._rows["lights_end"][order] = ends[1:]
        # A power of two, so that the buffer isn't replaced in each frame.
        room = 1 << (len(listed) - 1).bit_length() if len(listed) else 0
        light_rows = np.zeros(room, np.int32)
        light_rows[: len(listed)] = self._listed = np.where(is_spot, listed - points, listed)
        self.light_rows.write(light_rows)
        self._reaching = (not is_spot.all(), bool(is_spot.any()))
        return True

    def destroy(self) -> None:
        """Destroy all resources."""
        self._made.close()


def _ambient(scene: Scene) -> shaders.Ambient:
    return shaders.Ambient(sky=scene.lights.sky, ground=scene.lights.ground)
