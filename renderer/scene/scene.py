"""The scene: nodes, objects, meshes, materials, images, lights and cameras, all as arrays.

A `SceneBuilder` collects and checks the parts, one by one or as arrays, and `build` makes a `Scene` of them.
The arrays then keep their sizes: transforms of dynamic nodes, lights and materials may change, nodes may be
hidden, objects may get other meshes and materials, and objects that were reserved come and go. An object is a
mesh with a material at a node. `Scene.update` is the only call that a frame needs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from renderer.light_kinds.arrays import check_lights
from renderer.light_kinds.kind import LightKind
from renderer.light_kinds.table import LIGHT_KINDS
from renderer.scene.ambient_occlusion import AmbientOcclusion
from renderer.scene.arrays import Floats, Indices, read_ids
from renderer.scene.attachments import AttachedLights, AttachedView, Attachments
from renderer.scene.clips import Clip, Clips, make_clips
from renderer.scene.depth_of_field import DepthOfField
from renderer.scene.environment import Environment
from renderer.scene.features import MaterialFeatures
from renderer.scene.finite import FiniteArrays, check_finite
from renderer.scene.fog_and_bloom import Bloom, Fog
from renderer.scene.height_fields import HeightField
from renderer.scene.lights import KIND_NAMES, Lights
from renderer.scene.material_instances import (
    CustomShader,
    MaterialTable,
    list_textures,
    needs_tangents,
    read_custom_shader,
)
from renderer.scene.materials import (
    TEXTURE,
    TEXTURES,
    AlphaMode,
    ImagePixels,
    TextureList,
    TextureMap,
    check_image,
)
from renderer.scene.merging import NodeAnchors, group_equal, merge_group
from renderer.scene.meshes import MeshBounds, Meshes, MeshGeometry
from renderer.scene.negligible import (
    SurfaceBounds,
    flag_blended,
    flag_cut,
    flag_points,
    flag_unseen_materials,
    select_placed,
    strongest_response,
)
from renderer.scene.nodes import Nodes
from renderer.scene.objects import Objects, make_objects
from renderer.scene.omissions import Omission, Omissions
from renderer.scene.paths import CameraPath
from renderer.scene.simplification import simplify
from renderer.scene.simulation import (
    FunctionOfTime,
    ObjectSimulation,
    SceneSimulation,
    Simulator,
    check_simulation,
)
from renderer.scene.tangents import add_stretch, add_tangents
from renderer.scene.unique_names import UniqueNames
from rhi import FixedStack, SamplerDescriptor
from rhi.errors import refuse
from rhi.math import Camera, is_affine, relative_to, transform_bounds, translation
from rhi.math.arguments import read_floats

_PATIENCE: Final = 60
"""So many refreshes pass before objects that have lost their size are sought, and after each search."""


class ObjectHandle(NamedTuple):
    """A handle of an object that `Scene.add_object` has added: its row, and how often that was used
    before."""

    object_index: int
    generation: int


class Scene:
    """A scene, made by `SceneBuilder.build`, `load_scene` or a generator.

    Attributes:
        name: the text that it was made from.
        nodes, objects, meshes, lights: see their classes.
        materials: (k,) of `MATERIAL`.
        textures: (t,) of `TEXTURE`, which materials refer to by index.
        shaders: those that materials have of their own.
        parameters: of each of them, its values for all materials (k,), (0,) if it has none; they may be
            written to between frames.
        images, samplers: what textures refer to by index.
        background: linear colour of pixels that show nothing.
        haze: density of the air per metre: after a metre, e^-haze of the light is left; the rest is the
            background.
        fog, bloom, ambient_occlusion, depth_of_field: effects of the air, of the camera, of surfaces nearby and of
            the aperture, None for none; they may be exchanged between frames.
        environment: the light from all around, in place of the sky's and the ground's; None for none. It may be
            exchanged between frames.
        simulated: the simulations in their initial state, and what they change; a renderer's `Simulator` runs
            copies.
        seconds: the time of the last update or frame.
        clips: the animations of models by name, which can be played, sought and blended.
        views: named cameras, the first of which is the default. Those at nodes are as of the last update.
        attachments: the lights and views that follow nodes.
        paths: named camera paths.
        omissions: what the file that it was loaded from has and the scene hasn't.
        files: those that `load_model` has read it from or looked for, and would again; none of other scenes.
        height_fields: by the rows of their objects; the triangles of these are chosen for each view.
    """

    environment: Environment | None = None
    _response: tuple[bytes | None, float] = (None, 0.0)  # the strongest, and the materials that have it

    def __init__(
        self,
        name: str,
        nodes: Nodes,
        objects: Objects,
        meshes: Meshes,
        materials: NDArray[Any],
        images: tuple[ImagePixels, ...],
        lights: Lights,
        views: Mapping[str, Camera],
        paths: Mapping[str, CameraPath],
        background: tuple[float, float, float] = (0.02, 0.02, 0.03),
        haze: float = 0.0,
        simulated: tuple[SceneSimulation, ...] = (),
        clips: Mapping[str, Clip] = MappingProxyType({}),
        textures: NDArray[Any] | None = None,
        samplers: tuple[SamplerDescriptor, ...] = (),
        omissions: tuple[Omission, ...] = (),
        height_fields: Mapping[int, HeightField] | None = None,
        reserved: Indices | None = None,
        table: MaterialTable | None = None,
        parameters: tuple[NDArray[Any], ...] = (),
        attachments: Attachments | None = None,
    ) -> None:
        self.name = name
        self.attachments = attachments or Attachments()
        self.simulated = simulated
        self.clips = clips
        self.background = background
        self.haze = haze
        self.fog: Fog | None = None
        self.bloom: Bloom | None = None
        self.ambient_occlusion: AmbientOcclusion | None = None
        self.depth_of_field: DepthOfField | None = None
        self.nodes = nodes
        self.objects = objects
        self.meshes = meshes
        self.materials = materials
        self.images = images
        self.textures: NDArray[Any] = np.zeros(0, TEXTURE) if textures is None else textures
        self.samplers = samplers
        self.lights = lights
        self.views = dict(views)
        self.paths = dict(paths)
        self.omissions = omissions
        self.files: tuple[Path, ...] = ()
        self.height_fields: dict[int, HeightField] = dict(height_fields or {})
        self._finite = FiniteArrays()
        self._table = MaterialTable() if table is None else table
        self.shaders: tuple[CustomShader, ...] = tuple(self._table.shaders)
        self.parameters = parameters
        self._last_parameters = [
            array.tobytes() for array in parameters
        ]  # copies of arrays have other padding
        colors = meshes.vertices["color"] if "color" in (meshes.vertices.dtype.names or ()) else None
        self._has_colors = colors is not None and bool((colors != 1.0).any())
        self._bounds = SurfaceBounds(self.textures, images, colors)
        self._features = MaterialFeatures(materials, self.textures, samplers, self.shaders, self._bounds)
        self._last_material = int(objects.material.max(initial=-1))
        self._edits = 0  # how often other objects were shown, or objects got other meshes or materials
        spare = [] if reserved is None else reserved.tolist()
        self._spare: FixedStack[int] = FixedStack(max(len(spare), 1))
        for row in reversed(spare):
            self._spare.push(row)
        self._generations = dict.fromkeys(spare, 0)  # how often each of these was removed
        self._transparent: tuple[int, Indices] = (
            -1,
            np.zeros(0, np.int64),
        )  # as of a version of the materials
        self._emitters: tuple[int, Indices] = (-1, np.zeros(0, np.int64))  # the same
        self._unseen: NDArray[np.bool_] = np.zeros(len(objects), bool)  # which cover nothing
        self._unseen_from = -1  # the version of the materials of which that is
        self._waiting: NDArray[np.bool_] = np.zeros(len(objects), bool)  # which aren't on the device yet
        self._is_waiting_new = False
        self._static, self._movable = select_placed(objects)
        self._static_nodes = np.unique(objects.node[self._static])
        self._points: NDArray[np.bool_] = np.zeros(len(objects), bool)  # which have no size
        self._refreshes = 0
        self._next_points = _PATIENCE  # the refresh in which movable objects that have lost theirs are sought
        self._simulator = self.make_simulator()
        self.update()
        if not self.views:
            self.views["overview"] = self._make_overview_camera()

    def update(self, seconds: float = 0.0) -> Indices:
        """Apply all animations for the time `seconds`, drawn or not, then update transforms and bounds.

        Return the indices of the objects whose transform was computed again. A renderer applies only the
        animations of what it draws.
        """
        check_finite("Scene.update", seconds=seconds)
        self.seconds = seconds
        self._simulator.begin_frame(seconds)
        self._simulator.pose_all()
        return self.refresh()

    def refresh(self) -> Indices:
        """Update transforms and bounds to nodes that have moved, and find materials and lights that have
        changed; return the indices of the objects whose transform was computed again.

        Raises:
            ValidationError `scene-bad-index`: `materials` was replaced by fewer than objects have.
        """
        if len(self.materials) <= self._last_material:
            count, allowed = f"{len(self.materials)} materials", f"at least {self._last_material + 1}"
            refuse(rules.BAD_INDEX, "Scene.refresh", count, allowed)
        self._features.refresh(self.materials)
        values_now = [values.tobytes() for values in self.parameters]
        if values_now != self._last_parameters:
            self._last_parameters = values_now
            self._edits += 1
        moved = self.nodes.update()
        has_moved = bool(moved.any())
        is_waiting_new, self._is_waiting_new = self._is_waiting_new, False
        if self._flag_unseen(moved if has_moved else None) | self.nodes.update_hidden() | is_waiting_new:
            hidden = self.nodes.hidden[self.objects.node]
            self.objects.is_shown[:] = ~hidden & ~self._unseen & ~self._waiting
            self._edits += 1
        self.attachments.follow(self.nodes, self.lights, self.views)
        self.lights.refresh()
        if not has_moved:
            return np.zeros(0, np.int64)
        boxes = self.objects.boxes.node
        self.objects.refresh_bounds(self.nodes, np.flatnonzero(moved[boxes] & (boxes >= 0)))
        return np.flatnonzero(moved[self.objects.node])

    def snapshot(self) -> tuple[object, ...]:
        """Return all values of the scene that frames depend on, as of now: equal ones look the same. Moves that
        aren't updated yet aren't among them (`Nodes.is_current`)."""
        lights, objects = self.lights, self.objects
        arrays = [
            np.array([*lights.sky, *lights.ground, *self.background, self.haze], np.float64),
            self.materials,
            *self.parameters,
            *map(lights.__getattribute__, KIND_NAMES),
        ]
        return (
            self.nodes.version,
            self._features.version,
            self._edits,
            *map(np.ndarray.tobytes, arrays),
            objects.casts_shadow.tobytes(),
            self.fog,
            self.bloom,
            self.ambient_occlusion,
            self.depth_of_field,
            self.environment,
            tuple(self.height_fields),
        )

    def set_waiting(self, waiting: NDArray[np.bool_]) -> None:
        """Hide the objects that are `waiting` (n,) for their uploads, until a later call; the others are shown unless
        their nodes are hidden. Textures of all materials count as changed."""
        self._waiting, self._is_waiting_new = waiting.copy(), True
        self._edits += 1

    def skip_refresh(self) -> None:
        """Count a `refresh` that would change nothing."""
        self._refreshes += 1

    def _flag_unseen(self, moved: NDArray[np.bool_] | None) -> bool:
        """Find the objects that cover nothing, whatever the view, and return whether others may than before.

        Args:
            moved: which nodes (n,) have moved; None if none has.
        """
        objects, version = self.objects, self.material_version
        have_points_changed = self._flag_points(moved)
        if self._unseen_from == version and not have_points_changed:
            return False
        self._unseen_from = version
        unseen = flag_unseen_materials(self.materials, self._bounds)[objects.material] | self._points
        has_changed = not np.array_equal(unseen, self._unseen)
        self._unseen = unseen
        return has_changed

    def _flag_points(self, moved: NDArray[np.bool_] | None) -> bool:
        """Find the objects that have no size, and return whether others may than before.

        Each change makes lists again. So an object that moves is seen in the frame in which it gets a size,
        but those that lose theirs are sought only from time to time, ever more rarely.
        """
        objects, world, points = self.objects, self.nodes.world, self._points
        is_first = self._refreshes == 0
        self._refreshes += 1
        before = points.copy()
        if is_first or (moved is not None and moved[self._static_nodes].any()):
            points[self._static] = flag_points(world[objects.node[self._static]])
        if is_first or (moved is not None and self._refreshes >= self._next_points):
            points[self._movable] = flag_points(world[objects.node[self._movable]])
            if self._refreshes >= self._next_points:
                is_new = bool((points & ~before).any())
                self._next_points = self._refreshes + _PATIENCE
                self._next_points += self._refreshes if is_new else 0
        elif moved is not None and (hidden := self._movable[points[self._movable]]).size:
            points[hidden] = flag_points(world[objects.node[hidden]])
        return not np.array_equal(points, before)

    def flag_cut(self) -> NDArray[np.bool_]:
        """Return which materials (k,) are cut somewhere."""
        return flag_cut(self.materials, self._bounds)

    def strongest_response(self) -> float:
        """Return more light than any surface sends to the eye for each unit of irradiance."""
        if self.shaders:
            return np.inf
        content = self.materials.tobytes()  # every frame asks
        if content != self._response[0]:
            self._response = content, strongest_response(self.materials, self._bounds)
        return self._response[1]

    def count_features(self) -> Mapping[str, int]:
        """Return the number of materials, images, textures or meshes with each feature that a scene may lack, as
        of the last `refresh`."""
        return {**self._features.counts, "vertex colors": len(self.meshes) if self._has_colors else 0}

    def replace(
        self, indices: ArrayLike, *, mesh: ArrayLike | None = None, material: ArrayLike | None = None
    ) -> None:
        """Give the objects `indices` (k,) other meshes or materials, (k,) or one for all, by their ids.

        Raises:
            ValidationError: `scene-bad-index`; `scene-fixed-mesh` for objects on static nodes or within declared
                bounds, and for meshes that are simulated or height fields; `scene-no-tangents` for a normal map
                on a mesh that was built without one.
        """
        objects = self.objects
        object_indices = read_ids("replace(indices=...)", indices, len(objects))
        meshes, materials = (
            column[object_indices].astype(np.int64) for column in (objects.mesh, objects.material)
        )
        if material is not None:
            materials = np.broadcast_to(
                read_ids("replace(material=...)", material, len(self.materials)), object_indices.shape
            )
        if mesh is not None:
            meshes = np.broadcast_to(
                read_ids("replace(mesh=...)", mesh, len(self.meshes)), object_indices.shape
            )
            changing = [
                *self.height_fields,
                *(int(row) for simulated in self.simulated for row in simulated.objects),
            ]
            changing_meshes = objects.mesh[np.array(changing, np.int64)]
            anchor, node = objects.boxes.node[object_indices], objects.node[object_indices]
            is_declared = anchor != node  # bounds that hold at all times, of the mesh that it was built with
            is_fixed = (
                np.isin(objects.mesh[object_indices], changing_meshes)
                | is_declared
                | ~self.nodes.dynamic[node]
            )
            if (is_fixed | np.isin(meshes, changing_meshes)).any():
                refuse(rules.FIXED_MESH, "replace(mesh=...)", f"objects {indices!r}, meshes {mesh!r}")
        mapped = set(meshes[needs_tangents(self.materials, self.shaders)[materials]].tolist())
        if not mapped <= self.meshes.with_tangents:
            refuse(rules.NO_TANGENTS, "replace", f"meshes {sorted(mapped - self.meshes.with_tangents)}")
        objects.mesh[object_indices], objects.material[object_indices] = meshes, materials
        self._last_material = int(objects.material.max())
        if mesh is not None:
            boxes, mesh_bounds = objects.boxes, self.meshes
            boxes.lower[object_indices], boxes.upper[object_indices] = (
                mesh_bounds.lower[meshes],
                mesh_bounds.upper[meshes],
            )
            objects.refresh_bounds(self.nodes, object_indices)
        self._edits += 1

    def add_object(self, mesh: int, material: int, local: ArrayLike | None = None) -> ObjectHandle:
        """Show one of the reserved objects with a mesh and a material, by their ids, and return its handle.

        Args:
            local: its transform (4, 4), by default the identity.

        Raises:
            ValidationError: `scene-no-room`, or what `replace` and `Nodes.set_local` refuse; nothing is added
                then.
        """
        if not self._spare:
            refuse(rules.NO_ROOM, "add_object", f"{len(self._generations)} objects in use")
        row = self._spare.top
        node = self.objects.node[row]
        self.nodes.set_local(node, np.eye(4) if local is None else local)
        self.replace(row, mesh=mesh, material=material)
        if self.nodes.parents[node] >= 0:  # that of an object that was removed
            self.nodes.set_parent(node, -1)
        self.nodes.show(node)
        self._spare.pop()
        return ObjectHandle(row, self._generations[row])

    def remove_object(self, handle: ObjectHandle) -> None:
        """Remove an object that `add_object` has added. Its handle names nothing from then on."""
        row = self.get_object_index(handle)
        self.nodes.hide(self.objects.node[row])
        self._generations[row] += 1
        self._spare.push(row)

    def get_object_index(self, handle: ObjectHandle) -> int:
        """Return the index of an object that `add_object` has added; `objects.node` has its node, which may
        be moved.

        Raises:
            ValidationError: `scene-removed-object`.
        """
        if self._generations.get(handle.object_index) != handle.generation:
            refuse(rules.REMOVED_OBJECT, "get_object_index", handle)
        return handle.object_index

    def set_material(self, material: int, **values: Any) -> None:
        """Give a material other values of its own, which its instances inherit unless they have their own:
        arguments of `make_material`, textures by their rows, and parameters of its shader.

        Raises:
            ValidationError: `scene-bad-index`; `scene-bad-material`; `scene-no-tangents`. Nothing is changed
                then.
        """
        material_values = self.get_material_values(material) | values
        for name, is_color in list_textures(self._table.get_shader(material)).items():
            row = values.get(name, -1)
            if row != -1 and not (
                row in range(len(self.textures)) and self.textures["is_color"][row] == is_color
            ):
                kind = "colors" if is_color else "data"
                refuse(rules.BAD_INDEX, f"set_material({name}=...)", row, f"the row of a texture of {kind}")
        if values.get("normal_texture", -1) != -1:
            instances = self._table.list_instances(material)
            meshes = set(self.objects.mesh[np.isin(self.objects.material, instances)].tolist())
            if not meshes <= self.meshes.with_tangents:
                refuse(
                    rules.NO_TANGENTS, "set_material", f"meshes {sorted(meshes - self.meshes.with_tangents)}"
                )
        self._table.change(material, material_values, self.materials, self.parameters, "set_material")

    def unset_material(self, material: int, *names: str) -> None:
        """Remove a material's own values of these names; it inherits them, or has the defaults if it has no
        parent.

        Raises:
            ValidationError: `scene-bad-index`; `scene-bad-material` for a name that the material doesn't set
                itself. Nothing is changed then.
        """
        material_values = self.get_material_values(material)
        for name in names:
            if name not in material_values:
                rules.refuse_name(rules.BAD_MATERIAL, "unset_material", name, material_values)
        remaining = {name: value for name, value in material_values.items() if name not in names}
        self._table.change(material, remaining, self.materials, self.parameters, "unset_material")

    def get_material_values(self, material: int) -> dict[str, Any]:
        """Return the values that a material sets itself."""
        (row,) = read_ids("get_material_values", [material], len(self._table)).tolist()
        return self._table.get_own_values(row)

    @property
    def material_version(self) -> int:
        """A number that grows when a `refresh` finds that materials have changed, or that objects are hidden
        or shown, and when objects get other meshes or materials."""
        return self._features.version + self._edits

    @property
    def material_kinds(self) -> Indices:
        """A number (k,) for each material: those with the same one have the same features, as of the last
        `refresh`."""
        return self._features.kinds

    def check_numbers(self, call: str) -> None:
        """Refuse numbers of lights, materials and the air that aren't finite, and lights whose values are out
        of range; they may be written to at any time."""
        lights = self.lights
        air = np.array([*lights.sky, *lights.ground, *self.background, self.haze], np.float64)
        checked = {name: getattr(lights, name) for name in KIND_NAMES}
        others = {"materials": self.materials, "sky, ground, background, haze": air}
        self._finite.check(call, checked | others, dict.fromkeys(checked, check_lights))

    def make_simulator(self) -> Simulator:
        """Create a simulator of the scene, in which nothing has been run yet."""
        return Simulator(self.simulated, self.nodes, self.objects, self.meshes, self.attachments.nodes)

    def view_at(self, name: str, seconds: float) -> Camera:
        """Return the view `name` at the time `seconds`, also if its node moves. The scene is then updated to that
        time; that of a view without a node stays as it is.

        Raises:
            ValidationError: `camera-unknown-name` for a name that isn't in `views`.
        """
        if name not in self.views:
            rules.refuse_name(rules.UNKNOWN_CAMERA, "view_at", name, self.views)
        if name in self.attachments.views:
            self.update(seconds)
        return self.views[name]

    def check_bounds(self, times: ArrayLike) -> None:
        """Run all simulations through the `times` (t,) in seconds, ascending, and refuse one that leaves its
        bounds."""
        simulator = self.make_simulator()
        for seconds in np.atleast_1d(np.asarray(times, np.float64)).tolist():
            simulator.begin_frame(seconds)
            self.refresh()
            simulator.advance(simulator.objects)
            for row in simulator.objects.tolist():
                simulator.check_bounds(row)

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """The lower and the upper corner (3,) of the bounds of all objects that are shown, of all if none
        is."""
        selected = self.objects.is_shown if self.objects.is_shown.any() else slice(None)
        return self.objects.lower[selected].min(0), self.objects.upper[selected].max(0)

    @property
    def triangle_count(self) -> int:
        """The number of triangles of all objects."""
        return self.count_triangles(np.arange(len(self.objects)))

    def count_triangles(self, objects: NDArray[np.int64]) -> int:
        """Return the number of triangles of the objects with these indices."""
        return int(self.meshes.triangle_counts[self.objects.mesh[objects]].sum())

    def list_transparent(self) -> Indices:
        """Return the indices of shown objects with blended materials, as of the last `refresh`."""
        if self._transparent[0] != self.material_version:
            blended = flag_blended(self.materials, self._bounds)
            rows = np.flatnonzero(blended[self.objects.material]) if blended.any() else np.zeros(0, np.int64)
            self._transparent = self.material_version, self.objects.select_shown(rows)
        return self._transparent[1]

    def list_by_feature(self) -> dict[str, Indices]:
        """Return the indices of the shown objects whose materials have each feature of `count_features`, and
        as `bloom` those of `list_emitters`."""
        flags, material = self._features.compute_flags(), self.objects.material
        featured = {
            name: self.objects.select_shown(np.flatnonzero(has[material]))
            for name, has in flags.items()
            if has.any()
        }
        return featured | {"bloom": self.list_emitters()}

    def list_emitters(self) -> Indices:
        """Return the indices of objects that may emit more than a white surface reflects of light of strength
        1, as of the last `refresh`."""
        if self._emitters[0] != self.material_version:
            materials = self.materials
            emitted = materials["base_color"][:, :3] * materials["emission"][:, None] + materials["emissive"]
            emits = (emitted > 1.0).any(axis=1)
            self._emitters = (
                self.material_version,
                self.objects.select_shown(np.flatnonzero(emits[self.objects.material])),
            )
        return self._emitters[1]

    def relative_transforms(
        self, eye: ArrayLike, objects: NDArray[np.int64] | None = None
    ) -> NDArray[np.float32]:
        """Return the transforms (k, 4, 4) float32 of `objects`, or of all, from mesh space to the eye's axes.

        These are the world's axes with `eye` (3,) as origin, subtracted in float64. Multiply the transforms
        with the camera's `relative_view_projection`.
        """
        nodes = self.objects.node if objects is None else self.objects.node[objects]
        return relative_to(self.nodes.world[nodes], eye)

    def _make_overview_camera(self) -> Camera:
        lower, upper = self.bounds
        centre, size = 0.5 * (lower + upper), max(float(np.linalg.norm(upper - lower)), 1e-6)
        return Camera.look_at(centre + size * np.array([0.5, 0.4, 0.8]), centre)


class SceneBuilder:
    """Collects the parts of a scene. Later calls refer to parts by the ids returned; `build` may be called
    once."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.lights = Lights()
        self.background = (0.02, 0.02, 0.03)
        self.haze = 0.0
        self.fog: Fog | None = None
        self.bloom: Bloom | None = None
        self.ambient_occlusion: AmbientOcclusion | None = None
        self.depth_of_field: DepthOfField | None = None
        self.environment: Environment | None = None
        self.views: dict[str, Camera] = {}
        self.paths: dict[str, CameraPath] = {}
        self.omissions = Omissions()
        self.files: list[Path] = []
        self._geometries: list[MeshGeometry] = []
        self._bounds: list[MeshBounds | None] = []
        self._level_counts: list[int] = []
        self._height_fields: dict[int, HeightField] = {}  # by mesh
        self._mesh_names: list[str] = []
        self._table = MaterialTable()
        self._mesh_ids: dict[int, int] = {}
        self._images: list[ImagePixels] = []
        self._image_ids: dict[int, int] = {}
        self._keep_alive: list[object] = []
        self._textures = TextureList()
        self._parents: list[NDArray[np.int64]] = []
        self._locals: list[Floats] = []
        self._dynamic: list[NDArray[np.bool_]] = []
        self._node_names: list[str] = []
        self._objects: list[NDArray[np.int64]] = []
        self._object_count = 0
        self._reserved: list[NDArray[np.int64]] = []
        self._hidden: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
        self.clips = Clips()
        self._simulated: list[SceneSimulation] = []
        self._animated: list[tuple[NDArray[np.int64], ObjectSimulation, tuple[Floats, Floats] | None]] = []
        self._attached_lights: list[tuple[LightKind, Indices, Indices]] = []
        self._attached_views: dict[str, int] = {}

    def add_mesh(
        self, geometry: MeshGeometry, name: str = "", bounds: MeshBounds | None = None, *, levels: int = 0
    ) -> int:
        """Add a mesh and return its id: the same as before for a mesh without `bounds` that was added before.

        Args:
            bounds: the vertices of a simulated mesh must never leave them.
            levels: up to so many simplified versions are made (`simplify`), which renderers draw where
                their error is small enough (`Renderer.detail_error`). A mesh with `bounds` has none.
        """
        levels = rules.check_count(rules.BAD_MESH, "add_mesh(levels=...)", levels, 0)
        if bounds is not None and levels:
            refuse(
                rules.BAD_MESH, "add_mesh(levels=...)", levels, "0, since the mesh has bounds: it may change"
            )
        if bounds is None and (mesh_id := self._mesh_ids.get(id(geometry))) is not None:
            self._level_counts[mesh_id] = max(self._level_counts[mesh_id], levels)
            return mesh_id
        if bounds is not None:
            lower, upper = geometry.bounds
            check_finite("add_mesh(bounds=...)", lower=bounds[0], upper=bounds[1])
            if not ((bounds[0] <= lower) & (upper <= bounds[1])).all():
                declared = f"{bounds[0]} to {bounds[1]}"
                refuse(rules.SMALL_BOUNDS, "add_mesh(bounds=...)", declared, f"at least {lower} to {upper}")
        elif id(geometry) not in self._mesh_ids:
            self._mesh_ids[id(geometry)] = len(self._geometries)
        self._bounds.append(bounds)
        self._level_counts.append(levels)
        self._geometries.append(geometry)
        self._mesh_names.append(name)
        return len(self._geometries) - 1

    def simplify_meshes(self, first: int, levels: int) -> None:
        """Make up to so many simplified versions of the meshes from the id `first` on, but of those with bounds, which
        may change."""
        levels = rules.check_count(rules.BAD_MESH, "simplify_meshes(levels=...)", levels, 0)
        for mesh in range(first, len(self._geometries)):
            if self._bounds[mesh] is None:
                self._level_counts[mesh] = levels

    def add_height_field(self, field: HeightField, name: str = "") -> int:
        """Add a height field and return the id of its mesh, for one object, whose triangles are chosen for
        each view."""
        geometry = field.make_mesh()
        mesh = self.add_mesh(geometry, name, geometry.bounds)
        self._height_fields[mesh] = field
        return mesh

    @property
    def object_count(self) -> int:
        """The number of objects that have been added."""
        return self._object_count

    @property
    def attached_views(self) -> frozenset[str]:
        """The names of the views that follow nodes."""
        return frozenset(self._attached_views)

    def list_attached_lights(self, kind: LightKind) -> Indices:
        """Return the indices of the lights of a kind that follow nodes."""
        rows = [lights for attached_kind, lights, _ in self._attached_lights if attached_kind is kind]
        return np.concatenate([np.zeros(0, np.int64), *rows])

    def set_local(self, node: int, local: Floats) -> None:
        """Give the node of this id another local transform (4, 4)."""
        for locals in self._locals:
            if node < len(locals):
                locals[node] = local
                return
            node -= len(locals)

    def compute_bounds(self, first: int = 0) -> MeshBounds:
        """Return the bounding box of the objects from the index `first` on, with all nodes as they are added."""
        table = np.concatenate(self._objects)[first:]
        parents, locals = np.concatenate(self._parents), np.concatenate(self._locals)
        worlds = NodeAnchors.make(parents, locals, np.zeros(len(parents), bool)).transforms
        corners = np.array([self.mesh_bounds(mesh) for mesh in table[:, 1].tolist()])
        lower, upper = transform_bounds(worlds[table[:, 0]], corners[:, 0], corners[:, 1])
        return lower.min(axis=0), upper.max(axis=0)

    @contextmanager
    def undo_on_error(self) -> Iterator[None]:
        """Restore the builder as it was if the block raises an error."""
        restores = _snapshot(self)
        try:
            yield
        except BaseException:
            for restore in restores:
                restore()
            raise

    @property
    def mesh_count(self) -> int:
        """The number of meshes that have been added."""
        return len(self._geometries)

    def merge_objects(
        self, first: int, first_mesh: int, spend: Callable[[int], None] = lambda count: None
    ) -> None:
        """Merge the objects from the index `first` on that have equal materials, where they never move apart.

        Simulated, reserved and blended objects stay as they are, and so do meshes with declared bounds. Meshes from
        the id `first_mesh` on that no object has any more are dropped. Ids from these on no longer hold.

        Args:
            spend: called with the number of vertices and indices of all merged meshes before they are created,
                which it may refuse.
        """
        table = np.concatenate(self._objects)
        parents, locals = np.concatenate(self._parents), np.concatenate(self._locals)
        is_anchor = np.concatenate(self._dynamic)
        is_anchor[np.concatenate(self._hidden)] = True
        nodes = NodeAnchors.make(parents, locals, is_anchor)
        materials, parameters = self._table.make_arrays()
        values = [
            b"".join(
                [materials[row].tobytes(), *(array[row].tobytes() for array in parameters if len(array))]
            )
            for row in range(len(materials))
        ]
        is_mergeable = np.arange(len(table)) >= first
        for rows in (*self._reserved, *(moved.objects for moved in self._simulated)):
            is_mergeable[rows] = False
        is_mergeable &= (materials["alpha_mode"] != AlphaMode.BLEND)[table[:, 2]]
        is_mergeable &= np.array([bounds is None for bounds in self._bounds])[table[:, 1]]
        is_mergeable &= np.array(self._level_counts)[table[:, 1]] == 0
        is_mergeable &= np.linalg.det(nodes.transforms[table[:, 0], :3, :3]) != 0.0
        keys = [
            (
                int(nodes.anchors[node]),
                values[material],
                casts,
                "tangent" in self._geometries[mesh].attributes,
            )
            for node, mesh, material, casts in table.tolist()
        ]
        groups = group_equal(keys, is_mergeable)
        geometries = [[self._geometries[mesh] for mesh in table[group, 1].tolist()] for group in groups]
        spend(sum(len(part.vertices) + len(part.indices) for parts in geometries for part in parts))
        remaining = np.ones(len(table), bool)
        for group, parts in zip(groups, geometries, strict=True):
            merged = merge_group(group, keys[group[0]][0], nodes.transforms[table[group, 0]], parts)
            node = self.add_node(translation(merged.centre), merged.anchor)
            mesh = self.add_mesh(merged.geometry, self._mesh_names[table[group[0], 1]])
            table[group[0], :2] = node, mesh
            remaining[group[1:]] = False
        self._keep_objects(table, remaining)
        self._drop_unused_meshes(first_mesh)

    def _keep_objects(self, table: NDArray[np.int64], remaining: NDArray[np.bool_]) -> None:
        """Replace the objects by the rows of `table` (n, 4) that are `remaining`."""
        rows = np.cumsum(remaining) - 1
        self._objects, self._object_count = [table[remaining]], int(remaining.sum())
        self._reserved = [rows[reserved] for reserved in self._reserved]
        self._simulated = [
            SceneSimulation(moved.simulation, rows[moved.objects]) for moved in self._simulated
        ]

    def _drop_unused_meshes(self, first: int) -> None:
        """Drop the meshes from the id `first` on that no object has."""
        table = np.concatenate(self._objects)
        used = np.union1d(np.arange(first), table[:, 1])
        table[:, 1] = np.searchsorted(used, table[:, 1])
        self._objects = [table]
        ids = {int(mesh): number for number, mesh in enumerate(used)}
        self._geometries = [self._geometries[mesh] for mesh in ids]
        self._bounds = [self._bounds[mesh] for mesh in ids]
        self._level_counts = [self._level_counts[mesh] for mesh in ids]
        self._mesh_names = [self._mesh_names[mesh] for mesh in ids]
        self._mesh_ids = {key: ids[mesh] for key, mesh in self._mesh_ids.items() if mesh in ids}
        self._height_fields = {ids[mesh]: field for mesh, field in self._height_fields.items() if mesh in ids}

    def mesh_name(self, mesh: int) -> str:
        """Return the name of a mesh."""
        return self._mesh_names[mesh]

    def mesh_bounds(self, mesh: int) -> MeshBounds:
        """Return the bounds that a mesh was added with, or else the bounds of its vertices."""
        return self._bounds[mesh] or self._geometries[mesh].bounds

    def add_image(self, image: NDArray[Any]) -> int:
        """Add a texture's pixels (height, width, 4) uint8 and return its id; the same array is added once."""
        if id(image) not in self._image_ids:
            self._images.append(check_image(image))
            self._image_ids[id(image)] = len(self._images) - 1
            self._keep_alive.append(
                image
            )  # as long as the builder lives, so that its id isn't given to another
        return self._image_ids[id(image)]

    def add_material(self, *, parent: int = -1, shader: type[Any] | None = None, **values: Any) -> int:
        """Add a material from the arguments of `make_material`, and the parameters of its shader; return its
        id.

        A texture is the id of an image, which is then filtered linearly and repeated, or a `TextureMap`.

        Args:
            parent: the id of a material whose shader it has, and whose values where it isn't given its own.
                These follow the parent's (`Scene.set_material`).
            shader: a class derived from `renderer.shaders.MaterialShader`; by default the parent's, or the
                renderer's.
                Textures are then read as they are: repeated, by the first texture coordinates.
        """
        if parent != -1:
            read_ids("add_material(parent=...)", [parent], len(self._table))
        custom_shader = None if shader is None else read_custom_shader(shader, "add_material")
        custom = custom_shader or (self._table.get_shader(parent) if parent >= 0 else None)
        maps: dict[str, tuple[TextureMap, bool]] = {}
        for name, is_color in list_textures(custom).items():
            value = values.get(name, -1)
            if value == -1:
                continue
            texture = value if isinstance(value, TextureMap) else TextureMap(value)
            maps[name] = texture, is_color
            if not -1 <= texture.image < len(self._images):
                refuse(rules.BAD_INDEX, f"add_material({name}=...)", texture.image, "an image's id")
            if custom is not None and texture != TextureMap(texture.image, sampler=texture.sampler):
                refuse(
                    rules.BAD_MATERIAL,
                    f"add_material({name}=...)",
                    "a transform or a second set of coordinates",
                    "textures as they are, in a material with a shader of its own",
                )
        number, shaders = self._table.check({**values, **dict.fromkeys(maps, 0)}, parent, custom_shader)
        for name, (texture, is_color) in maps.items():
            values[name] = self._textures.add(texture, is_color=is_color)
        return self._table.add(values, parent, number, shaders)

    def add_node(
        self, local: ArrayLike | None = None, parent: int = -1, dynamic: bool = False, name: str = ""
    ) -> int:
        """Add one node with a local transform (4, 4), by default the identity, and return its id."""
        matrix = (
            np.eye(4)
            if local is None
            else read_floats("add_node(local=...)", local, 4, 4, rule=rules.BAD_TRANSFORM)
        )
        first = self.add_nodes(matrix[None], parent, dynamic)[0]
        self._node_names[-1] = name
        return int(first)

    def add_nodes(
        self, locals: ArrayLike, parents: ArrayLike = -1, dynamic: ArrayLike = False
    ) -> NDArray[np.int64]:
        """Add nodes with local transforms (k, 4, 4) under `parents` (k,) or one parent; return their ids
        (k,)."""
        matrices = read_floats("add_nodes(locals=...)", locals, rule=rules.BAD_TRANSFORM)
        if matrices.ndim != 3 or matrices.shape[1:] != (4, 4) or not is_affine(matrices):
            refuse(rules.BAD_TRANSFORM, "add_nodes(locals=...)", f"shape {matrices.shape}", "(k, 4, 4)")
        first, count = len(self._node_names), len(matrices)
        above = np.broadcast_to(np.asarray(parents, np.int64), count)
        if count and (above.min() < -1 or above.max() >= first):
            refuse(rules.BAD_INDEX, "add_nodes(parents=...)", parents, f"-1 to {first - 1}")
        self._parents.append(above.copy())
        self._locals.append(matrices.copy())
        self._dynamic.append(np.broadcast_to(np.asarray(dynamic, bool), count).copy())
        self._node_names.extend([""] * count)
        return np.arange(first, first + count)

    def add_objects(
        self, nodes: ArrayLike, meshes: ArrayLike, materials: ArrayLike, casts_shadow: bool = True
    ) -> NDArray[np.int64]:
        """Add objects, given ids of nodes, meshes and materials, (k,) or one for all; return their indices
        (k,).

        They cast shadows of the lights that do, unless `casts_shadow` is False: a ground, below which nothing
        is seen, costs shadow maps time.
        """
        columns = np.broadcast_arrays(
            read_ids("add_objects(nodes=...)", nodes, len(self._node_names)),
            read_ids("add_objects(meshes=...)", meshes, len(self._geometries)),
            read_ids("add_objects(materials=...)", materials, len(self._table)),
        )
        self._objects.append(np.stack([*columns, np.full_like(columns[0], casts_shadow)], axis=1))
        first = self._object_count
        self._object_count += len(columns[0])
        return np.arange(first, self._object_count)

    def reserve(self, count: int, mesh: int, material: int, casts_shadow: bool = True) -> None:
        """Reserve so many objects for `Scene.add_object`; they are hidden until then, with this mesh and
        material."""
        nodes = self.add_nodes(np.broadcast_to(np.eye(4), (count, 4, 4)), dynamic=True)
        self._reserved.append(self.add_objects(nodes, mesh, material, casts_shadow))
        self.hide(nodes)

    def hide(self, nodes: ArrayLike) -> None:
        """Hide what is at the nodes (k,), given by their ids, and below them, until `Nodes.show` shows it."""
        self._hidden.append(read_ids("hide(nodes=...)", nodes, len(self._node_names)))

    def attach_lights(self, kind: str, indices: ArrayLike, nodes: ArrayLike) -> None:
        """Attach lights to `nodes` (k,), or to one node, which they follow: headlights of a car, the light of a torch.

        Their positions and directions are from now on in the space of the node. Their ranges aren't scaled. Lights
        at hidden nodes are off.

        Args:
            kind: the name of their array in `Lights`, such as `point`.
            indices: what `lights.add_…` returned, (k,) or one.

        Raises:
            ValidationError: `scene-unknown-light-kind`, `scene-bad-index`; `scene-shared-light` for a light that is
                at a node already.
        """
        kinds = {light_kind.name: light_kind for light_kind in LIGHT_KINDS}
        if kind not in kinds:
            rules.refuse_name(rules.UNKNOWN_LIGHT_KIND, "attach_lights(kind=...)", kind, kinds)
        light_kind = kinds[kind]
        lights = read_ids("attach_lights(indices=...)", indices, len(self.lights.of_kind(light_kind)))
        rows = read_ids("attach_lights(nodes=...)", nodes, len(self._node_names))
        if len(rows) not in (1, len(lights)):
            refuse(
                rules.BAD_INDEX, "attach_lights(nodes=...)", f"shape {rows.shape}", f"one, or {len(lights)}"
            )
        earlier = [other for attached_kind, other, _ in self._attached_lights if attached_kind is light_kind]
        numbers = np.concatenate([*earlier, lights])
        if len(np.unique(numbers)) < len(numbers):
            refuse(rules.SHARED_LIGHT, "attach_lights(indices=...)", "a light twice", "each light once")
        self._attached_lights.append((light_kind, lights, np.broadcast_to(rows, lights.shape).copy()))

    def attach_view(self, name: str, node: int) -> None:
        """Attach the view `name` to a node, which it follows: its camera is from now on in the space of the node.

        Raises:
            ValidationError: `camera-unknown-name`, `scene-bad-index`.
        """
        if name not in self.views:
            rules.refuse_name(rules.UNKNOWN_CAMERA, "attach_view", name, self.views)
        rows = read_ids("attach_view(node=...)", [node], len(self._node_names))
        self._attached_views[name] = int(rows[0])

    def animate(
        self,
        nodes: ArrayLike,
        motion: ObjectSimulation | Callable[[float], Floats],
        bounds: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> None:
        """Animate dynamic `nodes` (k,): `motion` computes their local transforms.

        Args:
            motion: a simulation with `transforms`, whose members are the nodes in this order; or a function
                that maps seconds to all transforms (k, 4, 4).
            bounds: the lower and the upper corner, (k, 3) or (3,), of boxes that hold at all times what is at
                the nodes and below them, down to the next animated nodes. They are in the space of the first
                node above that isn't animated. So an object that isn't drawn needn't be animated. Without
                bounds, the nodes are animated in every frame, and the bounds of objects follow.
        """
        rows = read_ids("animate(nodes=...)", nodes, len(self._node_names))
        simulation: object = motion
        if callable(motion) and not hasattr(motion, "catch_up"):
            simulation = FunctionOfTime(motion)
        checked = check_simulation("animate(motion=...)", simulation, "transforms")
        self._animated.append((rows, checked, None if bounds is None else _check_boxes(bounds, len(rows))))

    def simulate(self, objects: ArrayLike, simulation: ObjectSimulation) -> None:
        """Simulate the vertices of `objects` (k,), the members of `simulation` in this order.

        Each object has a mesh of its own, added with bounds that hold at all times. The simulation begins at
        the scene's time 0, with the vertices of the meshes.
        """
        rows = read_ids("simulate(objects=...)", objects, self._object_count)
        check_simulation("simulate(simulation=...)", simulation, "vertices")
        self._simulated.append(SceneSimulation(simulation, rows))

    def _check_simulated(self, mesh: NDArray[np.int64]) -> None:
        """Refuse objects that share a mesh or have two simulations; `mesh` (n,) is the mesh of each
        object."""
        rows = np.concatenate([np.zeros(0, np.int64), *(simulated.objects for simulated in self._simulated)])
        meshes, uses = np.unique(mesh, return_counts=True)
        shared = uses[np.searchsorted(meshes, mesh[rows])] > 1
        if len(np.unique(rows)) < len(rows) or shared.any():
            problem = "an object twice" if len(np.unique(rows)) < len(rows) else f"object {rows[shared][0]}"
            refuse(rules.SHARED_MESH, "simulate(objects=...)", problem)
        for row in rows.tolist():
            if self._bounds[mesh[row]] is None:
                refuse(rules.UNBOUNDED_MESH, "simulate(objects=...)", f"object {row}")

    def _match_height_fields(self, mesh: NDArray[np.int64]) -> dict[int, HeightField]:
        """Return the height fields by the rows of their objects, and refuse one that several objects have;
        `mesh` (n,) is the mesh of each object."""
        fields: dict[int, HeightField] = {}
        for number, field in self._height_fields.items():
            rows = np.flatnonzero(mesh == number).tolist()
            if len(rows) > 1:
                problem = f"objects {rows[0]} and {rows[1]} with mesh {number}"
                refuse(rules.SHARED_HEIGHTS, "add_objects(meshes=...)", problem)
            fields.update((row, field) for row in rows)
        return fields

    def build(self) -> Scene:
        """Create the scene. It must have at least one object."""
        if not self._object_count:
            refuse(rules.EMPTY_MODEL, "build", f"{self.name!r} without an object")
        nodes = Nodes(
            np.concatenate(self._parents),
            np.concatenate(self._locals),
            np.concatenate(self._dynamic),
            self._node_names,
        )
        nodes.hide(nodes.index_of_id[np.concatenate(self._hidden)])
        clips = make_clips(self.clips, nodes.index_of_id)
        table = np.concatenate(self._objects)
        self._check_simulated(table[:, 1])
        (materials, parameters), textures = self._table.make_arrays(), self._textures.make()
        geometries = self._complete_vertices(table, materials, textures)
        levels = [
            simplify(geometry, count) if count else ()
            for geometry, count in zip(geometries, self._level_counts, strict=True)
        ]
        meshes = Meshes(geometries, self._mesh_names, self._bounds, levels)
        animated = nodes.index_of_id[
            np.concatenate([np.zeros(0, np.int64), *(ids for ids, _, _ in self._animated)])
        ]
        if len(np.unique(animated)) < len(animated):
            refuse(rules.SHARED_NODE, "animate(nodes=...)", "a node twice")
        boxes = [
            box or (np.full((len(ids), 3), np.nan), np.full((len(ids), 3), np.nan))
            for ids, _, box in self._animated
        ]
        lower, upper = (
            np.concatenate([np.zeros((0, 3)), *(box[corner] for box in boxes)]) for corner in (0, 1)
        )
        objects = make_objects(
            nodes,
            meshes,
            (nodes.index_of_id[table[:, 0]], table[:, 1], table[:, 2], table[:, 3]),
            np.concatenate([np.zeros(0, np.int64), *(member.objects for member in self._simulated)]),
            animated,
            (lower, upper),
        )
        simulated = (
            *(
                SceneSimulation(simulation, nodes=nodes.index_of_id[ids], is_bounded=box is not None)
                for ids, simulation, box in self._animated
            ),
            *self._simulated,
        )
        scene = Scene(
            self.name,
            nodes,
            objects,
            meshes,
            materials,
            tuple(self._images),
            self.lights,
            self.views,
            self.paths,
            self.background,
            self.haze,
            simulated,
            clips,
            textures,
            tuple(self._textures.samplers),
            omissions=tuple(self.omissions),
            height_fields=self._match_height_fields(table[:, 1]),
            reserved=np.concatenate([np.zeros(0, np.int64), *self._reserved]),
            table=self._table,
            parameters=parameters,
            attachments=self._make_attachments(nodes),
        )
        scene.fog, scene.bloom, scene.ambient_occlusion = self.fog, self.bloom, self.ambient_occlusion
        scene.depth_of_field, scene.environment = self.depth_of_field, self.environment
        return scene

    def _make_attachments(self, nodes: Nodes) -> Attachments:
        """Return the lights and views that follow nodes, in whose space they are now."""
        lights = []
        for kind in LIGHT_KINDS:
            parts = [
                (rows, ids) for attached_kind, rows, ids in self._attached_lights if attached_kind is kind
            ]
            if parts:
                rows, ids = (np.concatenate(columns) for columns in zip(*parts, strict=True))
                lights.append(AttachedLights.read(kind, self.lights, rows, nodes.index_of_id[ids]))
        views = {
            name: AttachedView(int(nodes.index_of_id[node]), self.views[name])
            for name, node in self._attached_views.items()
            if name in self.views
        }
        return Attachments(tuple(lights), views)

    def _complete_vertices(
        self, table: NDArray[np.int64], materials: NDArray[Any], textures: NDArray[Any]
    ) -> list[MeshGeometry]:
        """Return the meshes with the attributes that the scene's materials read, and no others; `table` (n,
        4) begins with the node, mesh and material of each object."""
        read = np.unique(np.concatenate([materials[name] for name in TEXTURES]))
        attributes = {"color"}
        if textures["uv_set"][read[read >= 0]].any():
            attributes.add("uv2")
        normals = materials["normal_texture"]
        mapped = table[needs_tangents(materials, self._table.shaders)[table[:, 2]]]
        if len(mapped):
            attributes.add("tangent")
        geometries = list(self._geometries)
        simulated = {int(table[row, 1]) for geometry in self._simulated for row in geometry.objects}
        turned = set(mapped[_turns_tangents(normals[mapped[:, 2]], textures), 1].tolist())
        meshes, first = np.unique(mapped[:, 1], return_index=True)
        for mesh, material in zip(meshes.tolist(), mapped[first, 2].tolist(), strict=True):
            row = normals[material]
            uv = "uv2" if row >= 0 and textures["uv_set"][row] else "uv"
            if "tangent" not in geometries[mesh].attributes:
                geometries[mesh] = add_tangents(geometries[mesh], uv, splits=mesh not in simulated)
            if mesh in turned:
                geometries[mesh] = add_stretch(geometries[mesh], uv)
        return [geometry.with_attributes(geometry.attributes & attributes) for geometry in geometries]


_BUILDER_PARTS: Final = (Lights, MaterialTable, TextureList, Clips, Omissions, UniqueNames)
"""The parts of a builder that have attributes of their own."""


def _snapshot(part: Any) -> list[Callable[[], None]]:
    """Return functions that restore a part of a builder, and the lists and dictionaries in it, as they are now."""

    def restore_items(items: Any) -> None:
        part.clear()
        (part.extend if isinstance(part, list) else part.update)(items)

    def restore_attributes(items: dict[str, Any]) -> None:
        for name, value in items.items():
            setattr(part, name, value)

    if isinstance(part, list | dict):
        items = part.copy()
        values = items if isinstance(items, list) else list(items.values())
        restores = [partial(restore_items, items)]
    else:
        names = getattr(type(part), "__slots__", None) or vars(part)
        attributes = {name: getattr(part, name) for name in names}
        values = list(attributes.values())
        restores = [partial(restore_attributes, attributes)]
    inner = [value for value in values if isinstance(value, (list, dict, *_BUILDER_PARTS))]
    return restores + [restore for value in inner for restore in _snapshot(value)]


def _turns_tangents(rows: NDArray[Any], textures: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which of the textures `rows` (k,), or -1, rotate texture coordinates."""
    transforms = np.concatenate([textures["transform"], np.eye(2, 3, dtype=np.float32)[None]])[rows]
    rotates: NDArray[np.bool_] = (transforms[:, 0, 1] != 0.0) | (transforms[:, 1, 0] != 0.0)
    return rotates


def _check_boxes(bounds: tuple[ArrayLike, ArrayLike], count: int) -> tuple[Floats, Floats]:
    corners = [np.asarray(corner, np.float64) for corner in bounds]
    if len(corners) != 2 or any(corner.shape not in ((3,), (count, 3)) for corner in corners):
        shapes = ", ".join(str(corner.shape) for corner in corners)
        refuse(rules.BAD_BOUNDS, "animate(bounds=...)", f"shapes {shapes}", f"two of (3,) or ({count}, 3)")
    lower, upper = (np.broadcast_to(corner, (count, 3)) for corner in corners)
    if not (np.isfinite(lower) & np.isfinite(upper) & (lower <= upper)).all():
        refuse(rules.BAD_BOUNDS, "animate(bounds=...)", f"{lower} to {upper}")
    return lower, upper
