"""The scene: nodes, objects, meshes, materials, images, lights and cameras, all as arrays.

`SceneBuilder` collects the parts and makes a `Scene` of them. The arrays then keep their sizes: transforms of dynamic
nodes, lights and materials may change, nodes may be hidden, objects may get other meshes and materials, and objects
that were reserved come and go. An object is a mesh with a material at a node. `Scene.update` is the only call that a
frame needs.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from renderer.light_kinds.arrays import check_lights
from renderer.scene.ambient_occlusion import AmbientOcclusion
from renderer.scene.arrays import Floats, Indices, read_ids
from renderer.scene.attachments import Attachments
from renderer.scene.clips import Clip
from renderer.scene.decals import Decals, check_decals
from renderer.scene.depth_of_field import DepthOfField
from renderer.scene.environment import Environment
from renderer.scene.features import MaterialFeatures
from renderer.scene.finite import FiniteArrays, check_finite
from renderer.scene.fog_and_bloom import Bloom, Fog
from renderer.scene.images import ImageBlocks, ImagePixels
from renderer.scene.lights import KIND_NAMES, Lights
from renderer.scene.material_instances import (
    CustomShader,
    MaterialTable,
    list_textures,
    needs_tangents,
)
from renderer.scene.materials import TEXTURE
from renderer.scene.meshes import Meshes
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
from renderer.scene.objects import Objects
from renderer.scene.omissions import Omission
from renderer.scene.paths import CameraPath
from renderer.scene.simulation import (
    SceneSimulation,
    Simulator,
)
from renderer.scene.tessellated_surfaces import TessellatedSurface
from rhi import FixedStack, SamplerDescriptor
from rhi.errors import refuse
from rhi.math import Camera, relative_to

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
        blocks: by the indices of images, the same in a compressed format.
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
        decals: images that are projected on surfaces.
        paths: named camera paths.
        omissions: what the file that it was loaded from has and the scene hasn't.
        files: those that `load_model` has read it from or looked for, and would again; none of other scenes.
        tessellated: the surfaces whose triangles are chosen for each view, by the rows of their objects.
    """

    environment: Environment | None = None
    fog: Fog | None = None
    blocks: Mapping[int, ImageBlocks] = MappingProxyType({})
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
        tessellated: Mapping[int, TessellatedSurface] | None = None,
        reserved: Indices | None = None,
        table: MaterialTable | None = None,
        parameters: tuple[NDArray[Any], ...] = (),
        attachments: Attachments | None = None,
        decals: Decals | None = None,
    ) -> None:
        self.name = name
        self.decals = decals or Decals()
        self.attachments = attachments or Attachments()
        self.simulated = simulated
        self.clips = clips
        self.background = background
        self.haze = haze
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
        self.tessellated: dict[int, TessellatedSurface] = dict(tessellated or {})
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
        self.decals.follow(self.nodes)
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
            self.materials,
            *self.parameters,
            *map(lights.__getattribute__, KIND_NAMES),
        ]
        return (
            self.nodes.version,
            self._features.version,
            self._edits,
            (*lights.sky, *lights.ground, *self.background, self.haze),
            *map(np.ndarray.tobytes, arrays),
            self.decals.array.tobytes(),
            objects.casts_shadow.tobytes(),
            self.fog,
            self.bloom,
            self.ambient_occlusion,
            self.depth_of_field,
            self.environment,
            tuple(self.tessellated),
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
        # Where decals cover them, colors are at most 1.
        return self._response[1] + (1.0 if len(self.decals.seen) else 0.0)

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
                bounds, and for meshes that are simulated or tessellated; `scene-no-tangents` for a normal map
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
                *self.tessellated,
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
        if len(self.decals):
            self._finite.check(call, {"decals": self.decals.array}, {"decals": check_decals})

    def make_simulator(self) -> Simulator:
        """Create a simulator of the scene, in which nothing has been run yet."""
        followed = np.union1d(self.attachments.nodes, self.decals.nodes)
        return Simulator(self.simulated, self.nodes, self.objects, self.meshes, followed)

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
            materials, peaks = self.materials, self._bounds.peaks
            emissive = materials["emissive"] * peaks[materials["emissive_texture"]][:, None]
            emitted = materials["base_color"][:, :3] * materials["emission"][:, None] + emissive
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
