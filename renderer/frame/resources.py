"""The buffers of a scene on a device. They are written only where they differ from what the device holds.

- All meshes are one mesh, all images are layers of a few arrays (`images`), and per-object data is one
  element each. So a whole scene can be one `draw_many`, in which an object's index is the base instance of
  its draw.
- An object is an element of two arrays: `object_positions` (32 bytes) has its position and mesh, `objects`
  (112 bytes) all else. Positions are pairs of floats, from which shaders subtract the eye's position: a moved
  eye changes one constant.
- Vertices of what is simulated are uploaded, or computed on the device where they lie
  (`DeviceVertexSimulation`).
- Objects that can't move aren't examined again, and simulated ones only before they are drawn. So a frame
  costs the CPU the same however many there are of them that aren't drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules, shaders
from renderer.frame.decals import DecalBuffers
from renderer.frame.detail import DetailLevels, make_mesh_parts
from renderer.frame.hidden_objects import HiddenObjects
from renderer.frame.instance_sets import InstanceSets
from renderer.frame.local_lights import LocalLightBuffers, Views
from renderer.frame.meshlets import make_meshlets
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
from renderer.frame.scene_images import SAMPLER_DEFAULTS, SceneImages, TextureSettings
from renderer.frame.turned_surfaces import TurnedSurfaces
from renderer.frame.uploads import SceneUploads, UploadSettings
from renderer.frame.view import View
from renderer.light_kinds.bounds import BOUND_FIELDS
from renderer.light_kinds.directional import pack_directional
from renderer.light_kinds.kind import LocalLightKind
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.lights.object_lists import list_lights
from renderer.scene import (
    Camera,
    DeformedObjects,
    DeviceVertexSimulation,
    FacingSimulation,
    Scene,
    Simulator,
    normal_matrices,
)
from renderer.scene.arrays import list_ranges
from renderer.scene.lights import Lights
from renderer.visibility import SceneArrays
from renderer.visibility.boxes.volumes import select_in_view
from renderer.visibility.detail import DetailLimit, make_constants
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
    Texture,
    UniformBuffer,
    refuse,
)
from rhi.math import is_parallel
from rhi.math.indexing import count_indices, repeat_each
from rhi.shading import UniformRange, uint

DRAW_GROUPS: Final[tuple[tuple[State, ...], ...]] = (
    (FrontFace.COUNTER_CLOCKWISE,),
    (FrontFace.CLOCKWISE,),
    (FrontFace.COUNTER_CLOCKWISE, CullMode.NONE),
    (FrontFace.CLOCKWISE, CullMode.NONE),
)
"""The states by which the groups of objects of one shader are drawn, beside those of a pass, which culls
backs. A transform that mirrors objects reverses the winding of their triangles, and of materials with two
sides no faces are culled."""


def draw_group_states(group: int) -> tuple[State, ...]:
    """States with which a group of objects is drawn."""
    return DRAW_GROUPS[group % len(DRAW_GROUPS)]


SIMULATION_EVENT: Final = "simulation"
"""The label of what the device computes of simulations."""


class SceneResources:
    """A scene on a device, shared by techniques.

    Attributes:
        mesh: all meshes in one.
        draws: (n,) of `rhi.DRAW`, one for each object, and behind them those of levels of detail.
        levels: these levels; None if no mesh has any.
        uses_levels: whether any object that is shown has levels.
        uses_meshlets: whether any object that is shown has a mesh that is cut into meshlets.
        detail_limit: the limit of their error in this frame, None for full meshes.
        mirrored: (n,) bool, whether an object's transform mirrors it, which reverses the winding of its
            triangles.
        group: (n,) the number of each object's group: objects of one group are drawn with the same program
            and states. It is the index of the states in `DRAW_GROUPS`, and 4 for each shader before that of
            the object's material.
        groups: the numbers of the groups that have objects, ascending.
        parameters: of each of the scene's shaders of materials, the values that it has for each material.
        tessellated_indices: the indices of the objects with tessellated surfaces, ascending. The device chooses
            their triangles; their `draws` have as many as there can be, and unused ones are empty.
        tessellations: how often triangles were chosen.
        indices: the indices of `mesh`, as shaders write them; only in scenes with tessellated surfaces.
        vertex_floats: the vertices of `mesh`, as shaders read and write them; only in scenes with tessellated
            surfaces, or simulations whose vertices the device computes.
        detail_error: the largest error of levels of detail in pixels, and in texels of shadow maps; 0 for none.
        light_cutoff: the irradiance at which local lights end; 0 for none (`Lights.cut`).
        images: the scene's images; None if no material reads any.
        objects, object_positions, materials, directional, light_list: the arrays that shaders read.
        local_lights: those of the lights of each kind with a position, by its name; empty if none reaches an
            object.
        source_radii: the radii of lights, a channel for each kind.
        decals: those of the scene.
        ambient: the constants of ambient light.
        simulator: runs the simulations of what is drawn.
        hidden: the objects that have been hidden for so long that they are paused.
        turned: the surfaces that may show a view only their backs, and then aren't drawn.
        drawn_in_order: (n,) bool, the objects whose triangles, where they are blended, are in the order in which they
            cover each other.
        resume: brings paused tessellated surfaces to this frame's view, given object indices that include theirs.
    """

    _eye: Camera | None = None
    _has_facing = False
    light_cutoff = 0.0
    detail_error = 0.0
    tessellations = 0
    uses_levels = False
    uses_meshlets = False
    detail_limit: DetailLimit | None = None

    def __init__(
        self,
        device: Device,
        scene: Scene,
        textures: TextureSettings = SAMPLER_DEFAULTS,
        uploads: UploadSettings | None = None,
    ) -> None:
        """Upload a scene, with these settings of its textures, at once or by later frames. If anything can't be
        created, nothing is left on the device."""
        self.upload_settings = uploads
        self.uploads: SceneUploads | None = None
        self.may_simulate = bool(scene.simulated or scene.tessellated)
        with ExitStack() as stack:
            self._stack = stack
            self._make(device, scene, textures)
            self._stack = stack.pop_all()

    def _keep(self, resource: R) -> R:
        """Destroy `resource` together with the others, and return it."""
        self._stack.callback(resource.destroy)
        return resource

    def _make(self, device: Device, scene: Scene, textures: TextureSettings) -> None:
        self.scene = scene
        self._workspaces: Workspaces = self._keep(Workspaces(device))
        self.simulator: Simulator = scene.make_simulator()
        self.hidden = HiddenObjects(scene, self.simulator.deformed)
        self.turned = TurnedSurfaces(scene)
        self.resume: Callable[[NDArray[np.int64]], None] = lambda _: None
        self._prepare_simulations(scene)
        self._device = device
        self._material_version = -1  # that of the materials on the device
        self._chosen_lights: tuple[object, Lights] = (None, scene.lights)  # and what they were chosen from
        objects = scene.objects
        computed = [
            simulated.objects
            for simulated in scene.simulated
            if isinstance(simulated.simulation, DeviceVertexSimulation)
        ]
        self._is_computed: NDArray[np.bool_] | None = (
            None  # by object, whether the device computes its vertices
        )
        self._computing: dict[Simulator, list[DeviceVertexSimulation]] = {}  # what holds memory on the device
        if computed and device.capabilities.compute:
            self._is_computed = np.zeros(len(objects), bool)
            self._is_computed[np.concatenate(computed)] = True
            self._stack.callback(self._release_all)
        self.mesh: Mesh = self._make_mesh(device, scene)
        self.levels = DetailLevels(scene) if len(scene.meshes.level_ranges) else None
        self.draws = self._make_draws()
        self.tessellated_indices: NDArray[np.int64] = np.array(sorted(scene.tessellated), np.int64)
        self.images = self._make_images(device, scene, textures)
        keep = self._keep
        self.objects = keep(MirroredArray(device, shaders.Object, "objects"))
        self.object_positions = keep(MirroredArray(device, shaders.ObjectPosition, "object_positions"))
        self.materials = keep(MirroredArray(device, shaders.Material, "materials"))
        self.parameters = [
            keep(MirroredArray(device, kind.parameters, f"parameters of {kind.shader.__name__}"))
            for kind in scene.shaders
        ]
        self.directional = keep(MirroredArray(device, shaders.DirectionalLight, "directional lights"))
        self._local_lights = keep(LocalLightBuffers(device))
        self.local_lights = self._local_lights.for_eye(0)
        self.source_radii = self._local_lights.radii
        self.light_list = keep(MirroredArray(device, int, "light rows"))
        self.decals = keep(DecalBuffers(device))
        self._listed_from: object = None  # the arrays of the lights that are listed
        self._lit: tuple[NDArray[Any], ...] = ()  # the state that the light lists were made from
        self._listed: NDArray[np.int64] = np.zeros(0, np.int64)  # the light list, as it is on the device
        self._fixed_lists: tuple[NDArray[Any], ...] = ()  # those of the objects with fixed bounds
        self._reaching = (False,) * len(
            LOCAL_LIGHT_KINDS
        )  # for each kind, whether any of its lights is on a list
        self.ambient = keep(MirroredValue(device, _ambient(scene)))
        self._rows: NDArray[Any] = np.zeros(len(objects), shaders.Object.dtype)
        self._object_positions: NDArray[Any] = np.zeros(len(objects), shaders.ObjectPosition.dtype)
        self._instance_sets, self._meshlet_sets = self._make_instance_sets(device, scene)
        self.mirrored: NDArray[np.bool_] = np.zeros(len(objects), bool)
        self.transparent_indices: NDArray[np.int64] = np.zeros(0, np.int64)
        self.is_transparent: NDArray[np.bool_] = np.zeros(len(objects), bool)
        self._has_two_sides: NDArray[np.bool_] = np.zeros(len(objects), bool)
        self._is_shown: NDArray[np.bool_] = np.zeros(len(objects), bool)
        self.group: NDArray[np.int32] = np.zeros(len(objects), np.int32)
        self.groups: tuple[int, ...] = (0,)
        self._shader: NDArray[np.int32] = np.zeros(len(objects), np.int32)
        self._follow_materials()
        self._transform(np.arange(len(objects)))

    def _prepare_simulations(self, scene: Scene) -> None:
        """Note, for each object, what the device has of its vertices, and whether their order follows the eye."""
        self._vertex_states = np.zeros(len(scene.objects))
        self._vertex_versions = np.zeros(len(scene.objects))  # how often vertices were written
        self.drawn_in_order: NDArray[np.bool_] = np.zeros(len(scene.objects), bool)
        for simulated in scene.simulated:
            if isinstance(simulated.simulation, FacingSimulation):
                self._has_facing |= simulated.simulation.faces_eye
                self.drawn_in_order[simulated.objects] = simulated.simulation.is_flat

    def _make_instance_sets(self, device: Device, scene: Scene) -> tuple[InstanceSets, InstanceSets | None]:
        """Create the instance sets of whole meshes, and those with meshlets if any mesh is cut."""
        mesh, level_begins = scene.objects.mesh, scene.meshes.level_begins
        whole = self._keep(InstanceSets(device, mesh, level_begins))
        if not len(scene.meshes.meshlet_ranges):
            return whole, None
        return whole, self._keep(InstanceSets(device, mesh, level_begins, scene.meshes.meshlet_begins))

    def _make_images(self, device: Device, scene: Scene, textures: TextureSettings) -> SceneImages | None:
        """Create the scene's images, and prepare the uploads of later frames if there are any."""
        settings, images = self.upload_settings, None
        if len(scene.textures):
            images = self._keep(SceneImages(device, scene, textures, is_streamed=settings is not None))
        if settings is not None:
            vertices, indices = self.mesh.vertices, self.mesh.indices
            assert vertices is not None
            assert indices is not None
            self.uploads = self._keep(SceneUploads(device, scene, settings, vertices, indices, images))
        return images

    def _make_draws(self) -> NDArray[Any]:
        """Draw arguments of each object."""
        ranges = self.scene.meshes.ranges[self.scene.objects.mesh]
        draws = self.mesh.draws(
            ranges["first_index"],
            ranges["index_count"],
            base_vertex=ranges["base_vertex"],
            base_instance=np.arange(len(ranges)),
        )
        return draws if self.levels is None else self.levels.list_draws(draws)

    def select_draws(self, object_indices: NDArray[np.int64], limit: DetailLimit | None) -> NDArray[np.int64]:
        """The indices in `draws` (k,) of what objects (k,) are drawn as within a limit of the error: all of their
        meshes without one."""
        if limit is None or self.levels is None or not self.uses_levels:
            return object_indices
        return self.levels.select(object_indices, limit)

    def get_draws(self, object_indices: NDArray[np.int64], limit: DetailLimit | None) -> NDArray[Any]:
        """The draws (k,) of objects (k,) within a limit of the error, a copy."""
        return self.draws[self.select_draws(object_indices, limit)]

    def _make_mesh(self, device: Device, scene: Scene) -> Mesh:
        """Create the mesh of all meshes. The device writes indices of tessellated surfaces, and vertices of
        some simulations."""
        meshes = scene.meshes
        vertices: NDArray[Any] | Buffer = meshes.vertices
        every_index: NDArray[np.uint32] = meshes.indices
        if len(meshes.level_ranges):
            every_index = np.concatenate([meshes.indices, meshes.level_indices])
        indices: NDArray[Any] | Buffer = every_index
        is_streamed = self.upload_settings is not None
        if self._is_computed is not None or scene.tessellated or is_streamed:
            vertices = self._keep(_make_buffer(device, meshes.vertices, is_streamed, "vertices"))
        if self._is_computed is not None or scene.tessellated:
            assert isinstance(vertices, Buffer)
            self.vertex_floats = device.storage(float, vertices)
        if scene.tessellated or is_streamed:
            indices = self._keep(_make_buffer(device, every_index, is_streamed, "indices"))
            if is_streamed and len(meshes.level_ranges):
                indices.write(meshes.level_indices, len(meshes.indices))
        if scene.tessellated:
            assert isinstance(indices, Buffer)
            self.indices = device.storage(uint, indices)
        return self._keep(device.mesh(vertices, indices, label="meshes"))

    @cached_property
    def tessellated_draws(self) -> StorageBuffer[DrawArguments]:
        """Draw arguments of the tessellated surfaces, ascending by object; the device writes their numbers
        of triangles."""
        draws = self.draws[self.tessellated_indices].view(DrawArguments.dtype)
        return self._keep(self._device.storage(DrawArguments, draws, label="tessellated draws"))

    def count_triangles(self, object_indices: NDArray[np.int64], limit: DetailLimit | None = None) -> int:
        """Number of triangles of the objects `object_indices` (k,), drawn within a limit of the error. For
        tessellated surfaces it is the last view's, which is read back from the device."""
        is_tessellated = np.isin(object_indices, self.tessellated_indices)
        draws = self.get_draws(object_indices[~is_tessellated], limit)
        count = int(draws["count"].sum(dtype=np.int64)) // 3
        if not is_tessellated.any():
            return count
        counts = self.tessellated_draws.read()["count"][
            np.searchsorted(self.tessellated_indices, object_indices[is_tessellated])
        ]
        return count + int(counts.sum()) // 3

    def draw_objects(
        self,
        device: Device,
        program: Program[...],
        bindings: dict[str, Any],
        object_indices: NDArray[np.int64],
        limit: DetailLimit | None,
    ) -> None:
        """Draw objects in one call within a limit of the error, plus one for each tessellated surface."""
        if len(self.tessellated_indices):
            is_tessellated = np.isin(object_indices, self.tessellated_indices)
            for object_index in object_indices[is_tessellated].tolist():
                self.draw_tessellated(device, program, bindings, object_index)
            object_indices = object_indices[~is_tessellated]
        if len(object_indices):
            device.draw_many(program, self.mesh, self.get_draws(object_indices, limit), **bindings)

    def draw_tessellated(
        self, encoder: Encoder, program: Program[...], bindings: dict[str, Any], object_index: int
    ) -> None:
        """Draw a tessellated surface with the triangles that the device has selected."""
        draw_index = int(np.searchsorted(self.tessellated_indices, object_index))
        draw = IndirectDraws(self.tessellated_draws, 1, draw_index * DRAW.itemsize)
        encoder.draw_indirect(program, self.mesh, draw, **bindings)

    @cached_property
    def mesh_parts(self) -> StorageBuffer[shaders.MeshPart]:
        """Boxes and index ranges of the meshes and of their levels, for shaders that write draws; created on
        first use."""
        mesh_parts = make_mesh_parts(self.scene.meshes)
        return self._keep(self._device.storage(shaders.MeshPart, mesh_parts, label="mesh parts"))

    def mirror(self, value: S) -> UniformBuffer[S]:
        """The uniform buffer for this type of struct, written if the value has changed."""
        return self._workspaces.mirror(value)

    def workspace(self, kind: Callable[[Device], R]) -> R:
        """A technique's state between frames beside the scene: `kind(device)`, created on first use and
        destroyed with the resources. What depends on the camera belongs to its view (`View.workspace`)."""
        return self._workspaces.get_or_create(kind)

    def existing_workspace(self, kind: Callable[[Device], R]) -> R | None:
        """The state that `workspace` created, None if it wasn't."""
        return self._workspaces.get(kind)

    def release(self, kind: Callable[[Device], Releasable]) -> None:
        """Release a workspace, if it exists: it destroys what it can create again."""
        self._workspaces.release(kind)

    @cached_property
    def _meshlets(self) -> StorageBuffer[shaders.Meshlet]:
        """Bounds of the mesh parts, for shaders that cull meshlets; created on first use."""
        bounds = make_meshlets(self.scene.meshes)
        return self._keep(self._device.storage(shaders.Meshlet, bounds, label="meshlets"))

    def scene_arrays(
        self, view: UniformRange[shaders.ViewConstants], *, has_meshlets: bool = False
    ) -> SceneArrays:
        """Buffers of objects and meshes for visibility algorithms on the device, and the constants of a
        view. What they say of levels of detail is this frame's.

        Args:
            has_meshlets: whether lists have meshlets, where meshes are cut, in place of whole meshes.
        """
        objects, object_positions = self.objects.buffer, self.object_positions.buffer
        assert objects is not None, "a scene has at least one object"
        assert object_positions is not None
        instance_sets = self._instance_sets
        if has_meshlets and self._meshlet_sets is not None:
            instance_sets = self._meshlet_sets
        sets = instance_sets.update(self.group, has_levels=self.uses_levels)
        detail = self.mirror(make_constants(self.detail_limit)) if self.uses_levels else None
        meshlets = None if instance_sets is self._instance_sets else self._meshlets
        return SceneArrays(view, objects, object_positions, self.mesh_parts, *sets, detail, meshlets)

    def simulate(
        self,
        object_indices: NDArray[np.int64],
        *,
        is_drawn: bool = True,
        leave: Callable[[], None] | None = None,
    ) -> None:
        """Advance the simulated objects among `object_indices` to the frame's time, before they are drawn.

        Args:
            leave: ends a render pass that may be open; called if the device computes vertices.
        """
        if not self.may_simulate:
            return
        if is_drawn and (paused := object_indices[self.hidden.paused[object_indices]]).size:
            if leave is not None:
                leave()
            self.resume(paused)
        computed = self._is_computed
        if (
            computed is not None
            and leave is not None
            and self.simulator.is_due(object_indices[computed[object_indices]])
        ):
            leave()
        advanced = self.simulator.advance(object_indices, is_drawn=is_drawn)
        if len(advanced.moved):
            self._transform(advanced.moved)
            moved = np.sort(advanced.moved)
            self.objects.write(self._rows, moved)
            self.object_positions.write(self._object_positions, moved)
        for deformed in advanced.deformed:
            self._deform(deformed)

    def _deform(self, deformed: DeformedObjects) -> None:
        """Update the vertices of objects whose state differs from the device's: computed there, or
        uploaded, adjacent meshes together."""
        is_changed = self._vertex_states[deformed.object_indices] != deformed.states
        if isinstance(deformed.simulation, FacingSimulation) and self._eye is not None:
            eyes = self._locate_eye(self._eye, deformed.object_indices)
            is_blended = self.is_transparent[deformed.object_indices]
            is_changed |= deformed.simulation.look_from(deformed.members, eyes, is_blended)
        changed = np.flatnonzero(is_changed)
        self._vertex_versions[deformed.object_indices[changed]] += 1.0
        if not len(changed):
            return
        mesh = self.scene.objects.mesh[deformed.object_indices[changed]]
        begins = self.scene.meshes.ranges["base_vertex"][mesh].astype(np.int64)
        if self._is_computed is not None and isinstance(deformed.simulation, DeviceVertexSimulation):
            self._note_computing(deformed.simulation)
            stride, tangent = _vertex_layout(self.scene.meshes.vertices.dtype)
            with self._device.event(SIMULATION_EVENT):
                deformed.simulation.deform(
                    self._device, deformed.members[changed], self.vertex_floats, begins, stride, tangent
                )
            self._vertex_states[deformed.object_indices] = deformed.states
            return
        order = np.argsort(begins)
        changed = changed[order]
        begins = begins[order]
        sizes = self.scene.meshes.vertex_counts[mesh[order]]
        vertices = deformed.simulation.vertices(deformed.members[changed])
        if len(vertices) != int(sizes.sum()):
            count, call = f"{len(vertices)} vertices", f"{type(deformed.simulation).__name__}.vertices"
            refuse(rules.BAD_SIMULATION, call, count, f"the {sizes.sum()} of the members' meshes")
        buffer, at = self.mesh.vertices, 0
        assert buffer is not None
        for first, end in join_runs(begins, sizes):
            part = self.scene.meshes.vertices[first:end]
            if part.dtype != vertices.dtype:  # what the simulation hasn't got stays as it is
                part = part.copy()
                for name in set(vertices.dtype.names or ()) & set(part.dtype.names or ()):
                    part[name] = vertices[name][at : at + end - first]
            else:
                part = vertices[at : at + end - first]
            buffer.write(part, first)
            at += end - first
        self._vertex_states[deformed.object_indices] = deformed.states

    def face(self, camera: Camera) -> None:
        """Set the eye of simulations that depend on it: that of `camera`."""
        self._eye = camera

    def get_facing_key(self) -> bytes:
        """Return bytes that change when the eye of simulations that face it moves."""
        if not self._has_facing or self._eye is None:
            return b""
        eye = self._eye
        away: NDArray[np.float64] = eye.rotation[2] if is_parallel(eye.projection) else eye.position
        return away.tobytes()

    def _locate_eye(self, camera: Camera, object_indices: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the eye (k, 4) in the spaces of objects: its position and 1, or the direction to it and 0."""
        world = self.scene.nodes.world[self.scene.objects.node[object_indices]]
        inverse = np.linalg.pinv(world[:, :3, :3])
        eyes = np.zeros((len(object_indices), 4))
        if is_parallel(camera.projection):
            eyes[:, :3] = inverse @ camera.rotation[2]
        else:
            eyes[:, :3] = np.einsum("nij,nj->ni", inverse, camera.position - world[:, :3, 3])
            eyes[:, 3] = 1.0
        return eyes

    def _note_computing(self, simulation: DeviceVertexSimulation) -> None:
        """Record a simulation that holds memory on the device, and release those that it replaces after
        time went back."""
        simulations = self._computing.setdefault(self.simulator, [])
        if any(held_simulation is simulation for held_simulation in simulations):
            return
        present = list(map(id, self.simulator.simulations))
        for held_simulation in simulations:
            if id(held_simulation) not in present:
                held_simulation.release(self._device)
        simulations[:] = [
            *(held_simulation for held_simulation in simulations if id(held_simulation) in present),
            simulation,
        ]

    def detach_simulator(self) -> Simulator:
        """Return the simulator, whose simulations keep what they have on the device when all else is
        destroyed. Another renderer of the device may go on with it."""
        self._computing.pop(self.simulator, None)
        return self.simulator

    def _release_all(self) -> None:
        for simulations in self._computing.values():
            for simulation in simulations:
                simulation.release(self._device)

    def simulate_expected(
        self, camera: Camera, object_indices: NDArray[np.int64], others: NDArray[np.int64] | None = None
    ) -> None:
        """Simulate the objects among `object_indices` that `camera` may see, and all shown ones among
        `others`, in one call: steps then don't depend on what was drawn."""
        object_indices = (
            self.select_in_view(camera, object_indices) if len(object_indices) else object_indices
        )
        if others is not None:
            object_indices = np.union1d(object_indices, self.scene.objects.select_shown(others))
        if len(object_indices):
            self.simulate(object_indices, is_drawn=False)

    def select_in_view(self, camera: Camera, object_indices: NDArray[np.int64]) -> NDArray[np.int64]:
        """The objects among `object_indices` whose bounds are not outside the view."""
        return select_in_view(self.scene, camera, object_indices)

    def has_shader(self, number: int) -> bool:
        """True if any object has this material shader: 0 is the renderer's, i + 1 that at index i of the
        scene's `shaders`."""
        return any(group // len(DRAW_GROUPS) == number for group in self.groups)

    @property
    def source_shapes(self) -> Texture | None:
        """The shapes of lights that are rectangles or tubes; None without any."""
        return self._local_lights.shapes.texture

    def select_group(self, object_indices: NDArray[np.int64], number: int) -> slice | NDArray[np.bool_]:
        """Index into `object_indices` of the objects of a group. A scene with one group needs no test."""
        return slice(None) if len(self.groups) == 1 else self.group[object_indices] == number

    def pair_objects_with_lights(
        self, object_indices: NDArray[np.int64], lights: NDArray[np.int64], kind: LocalLightKind
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Pairs of an object and a light of one kind that reaches it: object indices (k,), and entries
        (k,) of the light list. Only the lights `lights`, ascending, are paired, in their order."""
        number = LOCAL_LIGHT_KINDS.index(kind)
        begins = self._rows[BOUND_FIELDS[number]][object_indices].astype(np.int64)
        counts = self._rows[BOUND_FIELDS[number + 1]][object_indices] - begins
        entries = list_ranges(begins, counts)
        lit = self._listed[entries]
        is_requested = np.zeros(len(self.lights.of_kind(kind)), bool)
        is_requested[lights] = True
        requested = np.flatnonzero(is_requested[lit])
        order = requested[np.argsort(lit[requested], kind="stable")]
        return repeat_each(object_indices, counts)[order], entries[order]

    @property
    def object_states(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.float64]]:
        """The objects (n,) and their positions (n,) as the device has them, and how often (n,) their vertices were
        written."""
        return self._rows, self._object_positions, self._vertex_versions

    @property
    def lights(self) -> Lights:
        """The scene's lights that shine; with a `light_cutoff`, they end where their light is fainter."""
        scene = self.scene
        response = scene.strongest_response()
        if response > 0.0 and not scene.lights.has_faint:
            response = 1.0
        key = scene.lights.snapshot, self.light_cutoff, response
        if self._chosen_lights[0] != key:
            lights = scene.lights.without_dark(response)
            self._chosen_lights = key, lights.with_cutoff(self.light_cutoff) if self.light_cutoff else lights
        return self._chosen_lights[1]

    @property
    def reaching(self) -> tuple[bool, ...]:
        """For each kind of lights with a position, whether any of its lights reaches an object."""
        return self._reaching

    def update(self, *eyes: Camera, views: Views = ()) -> None:
        """Update the buffers to the scene, with lights for each of the frame's `eyes`, of which
        `look_from` selects one. With two eyes, `views` are their constants on the device."""
        scene, lights = self.scene, self.lights
        following = scene.objects.following_indices  # others that move are simulated before they are drawn
        self._transform(following)
        if self._listed_from is not lights.snapshot:
            self.directional.write(pack_directional(lights.directional))
        has_others = False
        if self._material_version != scene.material_version:
            self._material_version = scene.material_version
            materials = scene.materials if self.uploads is None else self.uploads.mask(scene.materials)
            self.materials.write(materials)
            for mirrored, values in zip(self.parameters, scene.parameters, strict=True):
                mirrored.write(values)
            has_others = self._follow_materials()
        self.objects.write(self._rows, None if self._list_lights() or has_others else following)
        self.object_positions.write(self._object_positions, None if has_others else following)
        self._local_lights.update(lights, self._reaching, [eye.position for eye in eyes], views)
        self.look_from(0)
        self.ambient.write(_ambient(scene))
        self.decals.update(scene.decals, self.images)

    def follow(self, view: View) -> None:
        """Make lights relative to the eye of a frame's only view, all else being as in the last `update`."""
        self._local_lights.follow(view.camera.position, view.split_eye)

    def look_from(self, eye: int) -> None:
        """Select the eye that `local_lights` are relative to."""
        self.local_lights = self._local_lights.for_eye(eye)

    def _follow_materials(self) -> bool:
        """Update which objects are shown, transparent and two-sided, and their shaders, meshes and
        materials; return whether any changed."""
        scene, objects = self.scene, self.scene.objects
        object_indices, two_sided = (
            scene.list_transparent(),
            scene.materials["double_sided"][objects.material] != 0,
        )
        shader = scene.materials["shader"][objects.material]
        has_others = self._instance_sets.follow(objects.mesh)
        if self._meshlet_sets is not None:
            self._meshlet_sets.follow(objects.mesh)
        if has_others:
            self.draws = self._make_draws()
        if not has_others and all(
            np.array_equal(new, old)
            for new, old in (
                (object_indices, self.transparent_indices),
                (two_sided, self._has_two_sides),
                (shader, self._shader),
                (objects.is_shown, self._is_shown),
                (objects.material, self._rows["material"]),
            )
        ):
            return False
        self._rows["material"] = objects.material
        self.transparent_indices = object_indices
        self._has_two_sides = two_sided
        self._is_shown = objects.is_shown.copy()
        self.uses_levels = self.levels is not None and self.levels.has_any(self._is_shown)
        is_cut = np.diff(scene.meshes.meshlet_begins)[objects.mesh] > 0
        self.uses_meshlets = bool((is_cut & self._is_shown).any())
        self._shader = shader
        self.is_transparent[:] = False
        self.is_transparent[object_indices] = True
        self._group_all()
        self._object_positions["draw_list"] = self._find_lists(slice(None))
        return True

    def _find_lists(self, object_indices: slice | NDArray[np.int64]) -> NDArray[np.int32]:
        """Number of the device's draw list of each object in `object_indices`; -1 for none."""
        is_listed = self._is_shown[object_indices] & ~self.is_transparent[object_indices]
        return np.where(is_listed, self.group[object_indices], -1).astype(np.int32)

    def _group_all(self) -> None:
        """Divide the objects into groups."""
        self.group = (
            self.mirrored + 2 * self._has_two_sides.astype(np.int32) + len(DRAW_GROUPS) * self._shader
        )
        self.groups = tuple(np.unique(self.group).tolist())
        self._instance_sets.forget()
        if self._meshlet_sets is not None:
            self._meshlet_sets.forget()

    def _transform(self, object_indices: NDArray[np.int64]) -> None:
        """Update the elements of the arrays that hold the transforms of the objects `object_indices`."""
        if not len(object_indices):
            return
        world = self.scene.nodes.world[self.scene.objects.node[object_indices]]
        normal = normal_matrices(world)
        largest = np.abs(normal).max(axis=(1, 2), keepdims=True)  # no float32 under- or overflow
        part = self._rows[object_indices]
        part["linear"][:, :, :3] = world[:, :3, :3]
        part["normal"][:, :, :3] = normal / np.where(largest > 0.0, largest, 1.0)
        self._rows[object_indices] = part
        mirrored = np.linalg.det(world[:, :3, :3]) < 0.0
        if (mirrored != self.mirrored[object_indices]).any():
            self.mirrored[object_indices] = mirrored
            self._group_all()
        positions = self._object_positions[object_indices]
        positions["high"], positions["low"] = split_doubles(world[:, :3, 3])
        positions["draw_list"] = self._find_lists(object_indices)
        positions["object_index"] = object_indices
        self._object_positions[object_indices] = positions

    def _list_lights(self) -> bool:
        """List the lights that reach each object; return whether the lists may have changed.

        The lists of objects with fixed bounds come first, so that those of others don't shift them.
        """
        objects, lights = self.scene.objects, self.lights
        is_known, self._listed_from = self._listed_from is lights.snapshot, lights.snapshot
        if is_known and not len(objects.following_indices):
            return False
        by_kind = [kind.bound_lights(lights.of_kind(kind)) for kind in LOCAL_LIGHT_KINDS]
        positions, ranges = (np.concatenate(parts) for parts in zip(*by_kind, strict=True))
        object_indices, light_ends = (
            objects.following_indices,
            np.cumsum([len(radii) for _, radii in by_kind]),
        )
        state = (positions, ranges, light_ends, objects.lower[object_indices], objects.upper[object_indices])
        if self._lit and all(map(np.array_equal, self._lit, state)):
            return False
        fixed = objects.fixed_indices
        if not self._lit or not all(map(np.array_equal, self._lit[:2], state)):
            self._fixed_lists = list_lights(objects.lower[fixed], objects.upper[fixed], positions, ranges)
        self._lit = state
        order = np.concatenate([fixed, object_indices])
        ends, listed = self._fixed_lists
        more, following = list_lights(
            objects.lower[object_indices], objects.upper[object_indices], positions, ranges
        )
        ends, listed = np.concatenate([ends, ends[-1] + more[1:]]), np.concatenate([listed, following])
        self._rows["lights_begin"][order] = ends[:-1]
        for field, light_end in zip(BOUND_FIELDS[1:-1], light_ends, strict=False):
            behind = np.concatenate([[0], np.cumsum(listed >= light_end)])[ends]
            self._rows[field][order] = ends[1:] - np.diff(behind)
        self._rows["lights_end"][order] = ends[1:]
        # A power of two, so that the buffer isn't replaced in each frame.
        room = 1 << (len(listed) - 1).bit_length() if len(listed) else 0
        light_list = np.zeros(room, np.int32)
        light_begins = np.concatenate([[0], light_ends[:-1]])
        kind_of = np.searchsorted(light_ends, listed, side="right")
        light_list[: len(listed)] = self._listed = listed - light_begins[kind_of]
        self.light_list.write(light_list)
        self._reaching = tuple(count_indices(kind_of, minlength=len(by_kind)).astype(bool).tolist())
        return True

    def destroy(self) -> None:
        """Destroy all resources."""
        self._stack.close()


def _make_buffer(device: Device, elements: NDArray[Any], is_streamed: bool, label: str) -> Buffer:
    """Create a buffer with these elements, or with room for them."""
    if is_streamed:
        return device.buffer(len(elements), elements.dtype, label=label)
    return device.buffer(elements, label=label)


def _vertex_layout(format: np.dtype[Any]) -> tuple[int, int]:
    """Return the floats from vertex to vertex, and from a vertex to its tangent: -1 without one."""
    offsets = {name: field[1] // 4 for name, field in (format.fields or {}).items()}
    return format.itemsize // 4, offsets.get("tangent", -1)


def _ambient(scene: Scene) -> shaders.Ambient:
    """Return the light of the sky and the ground: none if an environment is in their place."""
    if scene.environment is not None:
        return shaders.Ambient(sky=(0.0, 0.0, 0.0), ground=(0.0, 0.0, 0.0))
    return shaders.Ambient(sky=scene.lights.sky, ground=scene.lights.ground)
