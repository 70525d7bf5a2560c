"""The builder of scenes: collects and checks the parts of a scene, one by one or as arrays, and makes it of them.

What is added gets an id at once, so that later parts can refer to it: nodes to nodes, objects to nodes, meshes and
materials. `build` turns the lists into the arrays of a `Scene`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from renderer.light_kinds.kind import LightKind
from renderer.light_kinds.table import LIGHT_KINDS
from renderer.scene.ambient_occlusion import AmbientOcclusion
from renderer.scene.arrays import Floats, Indices, read_ids
from renderer.scene.attachments import AttachedLights, AttachedView, Attachments
from renderer.scene.clips import Clips, make_clips
from renderer.scene.decals import CLAMPED, Decals, make_decal
from renderer.scene.depth_of_field import DepthOfField
from renderer.scene.environment import Environment
from renderer.scene.finite import check_finite
from renderer.scene.fog_and_bloom import Bloom, Fog
from renderer.scene.height_fields import HeightField
from renderer.scene.images import ImageBlocks, ImagePixels, check_image, has_high_range
from renderer.scene.lights import Lights
from renderer.scene.material_instances import (
    MaterialTable,
    collect_normal_images,
    list_textures,
    needs_tangents,
    read_custom_shader,
)
from renderer.scene.materials import (
    LIGHT_TEXTURES,
    TEXTURES,
    AlphaMode,
    TextureList,
    TextureMap,
)
from renderer.scene.merging import NodeAnchors, group_equal, merge_group
from renderer.scene.meshes import MeshBounds, Meshes, MeshGeometry
from renderer.scene.meshlets import check_meshlet_size, cut_into_meshlets
from renderer.scene.nodes import Nodes
from renderer.scene.objects import make_objects
from renderer.scene.omissions import Omissions
from renderer.scene.paths import CameraPath
from renderer.scene.scene import Scene
from renderer.scene.simplification import simplify
from renderer.scene.simulation import (
    FunctionOfTime,
    ObjectSimulation,
    SceneSimulation,
    check_simulation,
)
from renderer.scene.tangents import add_stretch, add_tangents
from renderer.scene.tessellated_meshes import TessellatedMesh
from renderer.scene.tessellated_surfaces import TessellatedSurface
from renderer.scene.unique_names import UniqueNames
from rhi.errors import refuse
from rhi.math import Camera, is_affine, transform_bounds, translation
from rhi.math.arguments import read_floats


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
        self._meshlet_sizes: list[int] = []
        self._tessellated: dict[int, TessellatedSurface] = {}  # by mesh
        self._mesh_names: list[str] = []
        self._table = MaterialTable()
        self._mesh_ids: dict[int, int] = {}
        self._images: list[ImagePixels] = []
        self.blocks: dict[int, ImageBlocks] = {}
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
        self._decals: list[NDArray[Any]] = []

    def add_mesh(
        self,
        geometry: MeshGeometry,
        name: str = "",
        bounds: MeshBounds | None = None,
        *,
        levels: int = 0,
        meshlet_size: int = 0,
    ) -> int:
        """Add a mesh and return its id: the same as before for a mesh without `bounds` that was added before.

        Args:
            bounds: the vertices of a simulated mesh must never leave them.
            levels: up to so many simplified versions are made (`simplify`), which renderers draw where
                their error is small enough (`Renderer.detail_error`). A mesh with `bounds` has none.
            meshlet_size: a mesh of more triangles is cut into meshlets of at most so many, 8 to 4,096, which
                algorithms that run on the device cull one by one; 0 for none. Its triangles get another order.
                A mesh with `bounds` is never cut.
        """
        levels = rules.check_count(rules.BAD_MESH, "add_mesh(levels=...)", levels, 0)
        if bounds is not None and levels:
            refuse(
                rules.BAD_MESH, "add_mesh(levels=...)", levels, "0, since the mesh has bounds: it may change"
            )
        meshlet_size = check_meshlet_size(rules.BAD_MESH, "add_mesh", meshlet_size)
        if bounds is not None and meshlet_size:
            call, allowed = "add_mesh(meshlet_size=...)", "0, since the mesh has bounds: it may change"
            refuse(rules.BAD_MESH, call, meshlet_size, allowed)
        if bounds is None and (mesh_id := self._mesh_ids.get(id(geometry))) is not None:
            self._level_counts[mesh_id] = max(self._level_counts[mesh_id], levels)
            self._meshlet_sizes[mesh_id] = meshlet_size or self._meshlet_sizes[mesh_id]
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
        self._meshlet_sizes.append(meshlet_size)
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

    def cut_meshes(self, first: int, meshlet_size: int) -> None:
        """Cut the meshes from the id `first` on into meshlets of at most so many triangles, but those with bounds,
        which may change."""
        meshlet_size = check_meshlet_size(rules.BAD_MESH, "cut_meshes", meshlet_size)
        for mesh in range(first, len(self._geometries)):
            if self._bounds[mesh] is None:
                self._meshlet_sizes[mesh] = meshlet_size

    def add_height_field(self, field: HeightField, name: str = "") -> int:
        """Add a height field and return the id of its mesh, for one object, whose triangles are chosen for
        each view."""
        return self._add_tessellated(field, name)

    def add_tessellated_mesh(self, mesh: TessellatedMesh, name: str = "") -> int:
        """Add a tessellated mesh and return its id, for one object, whose triangles are chosen for each
        view."""
        return self._add_tessellated(mesh, name)

    def _add_tessellated(self, surface: TessellatedSurface, name: str) -> int:
        geometry = surface.make_mesh()
        mesh = self.add_mesh(geometry, name, geometry.bounds)
        self._tessellated[mesh] = surface
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
        is_mergeable &= np.array(self._meshlet_sizes)[table[:, 1]] == 0
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
        self._meshlet_sizes = [self._meshlet_sizes[mesh] for mesh in ids]
        self._mesh_names = [self._mesh_names[mesh] for mesh in ids]
        self._mesh_ids = {key: ids[mesh] for key, mesh in self._mesh_ids.items() if mesh in ids}
        self._tessellated = {ids[mesh]: field for mesh, field in self._tessellated.items() if mesh in ids}

    def mesh_name(self, mesh: int) -> str:
        """Return the name of a mesh."""
        return self._mesh_names[mesh]

    def mesh_bounds(self, mesh: int) -> MeshBounds:
        """Return the bounds that a mesh was added with, or else the bounds of its vertices."""
        return self._bounds[mesh] or self._geometries[mesh].bounds

    @property
    def image_count(self) -> int:
        """The number of images so far."""
        return len(self._images)

    def add_image(self, image: NDArray[Any] | ImageBlocks) -> int:
        """Add a texture's pixels and return its id; the same array is added once.

        Args:
            image: (height, width, 4) of uint8; or of high range, float16 or float32, 0 to 65,504 and linear, where
                alpha may be left out. It is stored as float16. Or blocks, which are stored as they are.
        """
        if id(image) not in self._image_ids:
            if isinstance(image, ImageBlocks):
                self._images.append(check_image(image.decode()))
                self.blocks[len(self._images) - 1] = image
            else:
                self._images.append(check_image(image))
            self._image_ids[id(image)] = len(self._images) - 1
            self._keep_alive.append(
                image
            )  # as long as the builder lives, so that its id isn't given to another
        return self._image_ids[id(image)]

    def list_image_uses(self, first: int = 0) -> list[tuple[int, ImagePixels, bool, bool]]:
        """Return the images from the id `first` on: id, pixels, whether a texture reads it as colours, and whether
        normal maps read it, and no other map that holds data."""
        if not self._images[first:]:
            return []
        (materials, parameters), textures = self._table.make_arrays(), self._textures.make()
        normals = collect_normal_images(textures, materials, self._table.shaders, parameters)
        colors = set(textures["image"][textures["is_color"] == 1].tolist())
        return [
            (image, pixels, image in colors, image in normals)
            for image, pixels in enumerate(self._images[first:], first)
        ]

    def _is_bright(self, image: int) -> bool:
        """True if an image has texels above 1."""
        return image >= 0 and has_high_range(self._images[image]) and bool((self._images[image] > 1.0).any())

    def add_material(self, *, parent: int = -1, shader: type[Any] | None = None, **values: Any) -> int:
        """Add a material from the arguments of `make_material`, and the parameters of its shader; return its
        id.

        A texture is the id of an image, which is then filtered linearly and repeated, or a `TextureMap`.

        Args:
            parent: the id of a material whose shader it has, and whose values where it isn't given its own.
                These follow the parent's (`Scene.set_material`).
            shader: a class derived from `renderer.shaders.MaterialShader`; by default the parent's, or the
                renderer's.
                Textures but light maps are then read as they are: repeated, by the first texture coordinates.
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
            if name in TEXTURES.keys() - LIGHT_TEXTURES and self._is_bright(texture.image):
                allowed = "texels of at most 1: only emitted light and light maps are brighter"
                refuse(rules.BAD_MATERIAL, f"add_material({name}=...)", "an image of high range", allowed)
            is_plain = texture == TextureMap(texture.image, sampler=texture.sampler)
            if custom is not None and not is_plain and name != "light_map_texture":
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

    def add_decal(
        self,
        node: int,
        image: int,
        size: ArrayLike = (1.0, 1.0, 1.0),
        *,
        color: ArrayLike = (1.0, 1.0, 1.0),
        strength: float = 1.0,
        inner_angle: float = 1.0,
        outer_angle: float = 1.4,
        order: int = 0,
    ) -> int:
        """Add a decal, which projects an image on the opaque surfaces in a box at a node, along the node's -z axis;
        return its index in `Scene.decals`.

        Args:
            image: its id; where its alpha is 0, the surface stays as it is.
            size: the width, the height and the depth of the box in the space of the node, in metres.
            color: multiplies the image's colour, 0 to 1, linear.
            strength: multiplies its alpha, 0 to 1.
            inner_angle, outer_angle: in radians, the angles to the node's z axis between which it fades out on
                surfaces that are turned away.
            order: decals of a higher order lie over others, and of the same those that were added later.

        Raises:
            ValidationError: `scene-bad-index`, `scene-bad-decal`.
        """
        (row,) = read_ids("add_decal(node=...)", [node], len(self._node_names)).tolist()
        (pixels,) = read_ids("add_decal(image=...)", [image], len(self._images)).tolist()
        if self._is_bright(pixels):
            refuse(rules.BAD_DECAL, "add_decal(image=...)", "texels above 1", "texels of at most 1")
        if order not in range(-(2**31), 2**31):
            refuse(rules.BAD_DECAL, "add_decal(order=...)", order, "a whole number of 32 bits")
        values: dict[str, ArrayLike] = {
            "order": order,
            "size": size,
            "color": color,
            "strength": strength,
            "inner_angle": inner_angle,
            "outer_angle": outer_angle,
        }
        decal = make_decal("add_decal", values)
        decal["node"] = row
        decal["texture"] = self._textures.add(TextureMap(pixels, sampler=CLAMPED), is_color=True)
        self._decals.append(decal)
        return len(self._decals) - 1

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

    def _match_tessellated(self, mesh: NDArray[np.int64]) -> dict[int, TessellatedSurface]:
        """Return the tessellated surfaces by the rows of their objects, and refuse one that several objects
        have; `mesh` (n,) is the mesh of each object."""
        surfaces: dict[int, TessellatedSurface] = {}
        for number, surface in self._tessellated.items():
            rows = np.flatnonzero(mesh == number).tolist()
            if len(rows) > 1:
                problem = f"objects {rows[0]} and {rows[1]} with mesh {number}"
                refuse(rules.SHARED_HEIGHTS, "add_objects(meshes=...)", problem)
            surfaces.update((row, surface) for row in rows)
        return surfaces

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
        meshlets: list[Indices] = []
        for mesh, size in enumerate(self._meshlet_sizes):
            geometries[mesh], sizes = cut_into_meshlets(geometries[mesh], size)
            meshlets.append(sizes)
        meshes = Meshes(geometries, self._mesh_names, self._bounds, levels, meshlets)
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
            tessellated=self._match_tessellated(table[:, 1]),
            reserved=np.concatenate([np.zeros(0, np.int64), *self._reserved]),
            table=self._table,
            parameters=parameters,
            attachments=self._make_attachments(nodes),
            decals=Decals.make(self._decals, nodes.index_of_id),
        )
        scene.blocks = dict(self.blocks)
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
