"""glTF 2.0 files as scenes.

A file is read in this order: materials with their images, meshes, nodes with objects, cameras and lights,
animations. What is broken is refused in one line that names the place in the file
(`renderer.content.gltf.document`). What is whole but has no place in a scene is left out and listed
(`Scene.omissions`).

Meshes have the order of their accessors, nodes that of their depth and then of the file, objects that of
their nodes. So a scene that `save_scene` has written is read back row by row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from renderer import rules
from renderer.content.assets import share_geometry
from renderer.content.gltf import deformations
from renderer.content.gltf.accessors import Accessors
from renderer.content.gltf.animations import Tracks, make_motion, read_tracks
from renderer.content.gltf.container import EXTENSIONS, LISTED_WHERE_USED, GltfFile, list_unread_extensions
from renderer.content.gltf.document import JsonObject
from renderer.content.gltf.extras import SceneExtras, get_extras, is_holder, primitive_name, read_scene_extras
from renderer.content.gltf.materials import Materials
from renderer.content.gltf.nodes import (
    GltfNode,
    LightCollector,
    compute_world_transforms,
    list_nodes,
    read_camera,
)
from renderer.content.gltf.primitives import Primitives
from renderer.content.gltf.tracks import ROTATION, SCALE, TRANSLATION, WEIGHTS
from renderer.content.import_options import ImportOptions
from renderer.content.limits import Budget
from renderer.content.progress import report
from renderer.scene.arrays import Floats
from renderer.scene.attachments import orthonormalize_axes
from renderer.scene.meshes import MeshGeometry
from renderer.scene.scene_builder import SceneBuilder
from renderer.scene.unique_names import UniqueNames
from rhi.errors import ValidationError, refuse

_EVERYTHING: Final = ImportOptions()


def add_gltf(
    builder: SceneBuilder,
    path: str,
    budget: Budget | None = None,
    options: ImportOptions = _EVERYTHING,
    root: int = -1,
) -> SceneExtras | None:
    """Add everything in a glTF file, except what the options leave out, to a scene under construction, below its
    node `root`; return the scene extras of a scene that `save_scene` has written, or None.

    Cameras become views, named after their nodes. Refused, naming the file: `scene-unreadable-model`,
    `scene-empty-model`, `scene-bad-vertices`.
    """
    file = GltfFile(path, budget)
    reader = _GltfReader(builder, file, options, root)
    before = builder.object_count
    reader.add_all()
    if builder.object_count == before and (reason := reader.explain_emptiness()):
        others = "; ".join(map(str, builder.omissions))
        problem = f"{path}: {reason}"
        refuse(rules.EMPTY_MODEL, f"load_model({path!r})", f"{problem}, with {others}" if others else problem)
    builder.files += file.files
    return reader.scene_extras


@dataclass(frozen=True, slots=True)
class _GltfPart:
    """A primitive of a mesh `holder` of the file, its mesh in the scene, and its material in the file or
    -1."""

    holder: JsonObject
    primitive: JsonObject
    mesh: int
    material: int


class _GltfReader:
    """Adds one file to a builder."""

    def __init__(self, builder: SceneBuilder, file: GltfFile, options: ImportOptions, root: int) -> None:
        self._builder = builder
        self._options, self._root_id = options, root
        self._unread: frozenset[int] = frozenset()  # numbers of meshes
        self._left_out: frozenset[int] = frozenset()  # numbers of nodes, and of all below them
        self._file = file
        self._omissions = builder.omissions
        self._root = file.root
        scenes = file.root.children("scenes")
        scene_fields = get_extras(scenes[max(file.root.index("scene", len(scenes)), 0)]) if scenes else None
        self._private = JsonObject(file.path, "", {}) if scene_fields is None else scene_fields
        self.scene_extras = None if scene_fields is None else read_scene_extras(scene_fields)
        self._accessors = Accessors(file)
        self._materials = Materials(file, builder, builder.omissions)
        self._primitives = Primitives(self._accessors, builder.omissions)
        self._meshes: list[list[_GltfPart]] = []  # of each mesh of the file
        self._part_counts: list[int] = []  # of each mesh of the file, the number of its parts
        self._has_nodes = False
        self._dynamic = frozenset(self._private.indices("dynamic", file.root.length("nodes")))
        self._view_names = UniqueNames()

    def add_all(self) -> None:
        used = list(list_unread_extensions(self._root))
        for name in self._file.names("extensionsUsed"):
            is_listed = name.startswith(LISTED_WHERE_USED) or name in dict(used)
            if name not in EXTENSIONS and not is_listed:
                self._omissions.add(name, "extensionsUsed")
        for name, where in used:
            if where or name not in {other for other, path in used if path}:  # else the file only lists parts
                self._omissions.add(name, where or "the file")
        nodes = list_nodes(self._root, self._omissions)
        self._has_nodes = bool(nodes)
        self._leave_out(nodes)
        self._add_meshes()
        tracks = read_tracks(self._root, self._accessors, self._omissions, self._builder.clips)
        worlds = compute_world_transforms(nodes)
        tree = deformations.NodeTree.make(
            nodes, make_motion(nodes, tracks, self._omissions, self._builder.clips)
        )
        ids = self._add_nodes(tree, tracks)
        anchors = [self._anchor(row, tree, ids, worlds) for row in range(len(nodes))]
        self._add_cameras(nodes, worlds, anchors)
        self._add_lights(nodes, worlds, anchors)

    def _leave_out(self, nodes: list[GltfNode]) -> None:
        """Find the nodes that the options leave out, and refuse patterns that match nothing."""
        if not self._options.without:
            return
        names = [node.fields.text("name", "") for node in nodes]
        meshes = [mesh.text("name", "") for mesh in self._root.children("meshes")]
        self._options.check_names(self._file.path, [*names, *meshes])
        parents = [node.parent for node in nodes]
        is_out = self._options.flag_left_out(zip(parents, names, strict=True))
        self._left_out = frozenset(node.number for node, out in zip(nodes, is_out, strict=True) if out)
        used = {node.fields.index("mesh", len(meshes)) for node in nodes if node.number not in self._left_out}
        self._unread = frozenset(
            number
            for number, name in enumerate(meshes)
            if number not in used or self._options.leaves_out(name)
        )

    def explain_emptiness(self) -> str:
        """Return why nothing of the file is drawn; an empty text if it has only lights, cameras or empty
        nodes."""
        if self._options.without and any("mesh" in node for node in self._root.children("nodes")):
            return f"nothing is left without {', '.join(self._options.without)}"
        nodes, scenes = self._root.children("nodes"), self._root.children("scenes")
        if not self._meshes:
            return "" if self._has_nodes else "it has no meshes, and its scene has no nodes"
        if not any(self._meshes):
            return f"none of its {len(self._meshes)} meshes has a triangle, a line or a point"
        users = [node.where for node in nodes if "mesh" in node]
        if not users:
            return f"none of its {len(nodes)} nodes has one of its {len(self._meshes)} meshes"
        drawn = f"scenes[{max(self._root.index('scene', len(scenes)), 0)}]" if scenes else "its scene"
        return f"{users[0]} has a mesh, but {drawn} has no node whose mesh is drawn"

    def _add_meshes(self) -> None:
        """Add the materials and the meshes of the file, a mesh for each set of accessors."""
        count = self._root.length("materials")
        reader = self._primitives
        meshes = self._root.children("meshes")
        parts = [
            [
                primitive
                for primitive in mesh.children("primitives")
                if number not in self._unread and reader.has_positions(primitive)
            ]
            for number, mesh in enumerate(meshes)
        ]
        used = {primitive.index("material", count) for primitives in parts for primitive in primitives}
        self._materials.add_all(used if self._options.without else None)
        firsts: dict[object, tuple[int, int, JsonObject, str]] = {}
        for number, (mesh, primitives) in enumerate(zip(meshes, parts, strict=True)):
            name = mesh.text("name", "")
            for primitive in primitives:
                attributes = primitive.child("attributes")
                first = attributes.index("POSITION", len(self._accessors))
                firsts.setdefault(
                    reader.key(primitive), (first, number, primitive, primitive_name(primitive, name))
                )
        mesh_ids: dict[object, int] = {}
        is_saved = self.scene_extras is not None  # then equal meshes were several in the scene, and stay so
        added: set[int] = set()
        ordered = sorted(firsts.items(), key=lambda item: item[1][:2])
        for number, (key, (_, _, primitive, name)) in enumerate(ordered):
            report("meshes", number, len(ordered))
            shape = reader.read(primitive)
            if shape is None:
                continue
            geometry = share_geometry(shape.geometry)
            if is_saved and id(geometry) in added:
                geometry = shape.geometry
            added.add(id(geometry))
            mesh_ids[key] = self._builder.add_mesh(geometry, name)
        for mesh, primitives in zip(meshes, parts, strict=True):
            mesh_parts = []
            for primitive in primitives:
                material = primitive.index("material", count)
                if (mesh_id := mesh_ids.get(reader.key(primitive), -1)) >= 0:
                    mesh_parts.append(_GltfPart(mesh, primitive, mesh_id, material))
            self._meshes.append(mesh_parts)
            self._part_counts.append(len(mesh_parts) or mesh.length("primitives"))

    def _anchor(
        self, row: int, tree: deformations.NodeTree, ids: list[int], worlds: Floats
    ) -> tuple[Floats, int]:
        """Return where the node `row` is: its transform to the world and -1, or, if it may move, to a node of the
        scene and that node's id."""
        local, at = np.eye(4), row
        while at >= 0 and ids[at] < 0:  # nodes that only hold a light or a camera
            local, at = tree.nodes[at].local @ local, tree.nodes[at].parent
        if at >= 0 and any(self._may_move(tree, above) for above in tree.chain(at)):
            return local, ids[at]
        return worlds[row], -1

    def _may_move(self, tree: deformations.NodeTree, row: int) -> bool:
        return bool(tree.member[row] >= 0) or tree.nodes[row].number in self._dynamic

    def _add_nodes(self, tree: deformations.NodeTree, tracks: Tracks) -> list[int]:
        """Add nodes, objects and their animations; return the id of each node, -1 for one that only holds a light
        or a camera."""
        skeletons = deformations.read_skins(self._root, self._accessors, tree)
        deformed: list[tuple[int, deformations.DeformedMesh]] = []  # objects, and how they change
        hidden = frozenset(self._private.indices("hidden", self._root.length("nodes")))
        ids: list[int] = []
        objects: list[tuple[int, int, int]] = []
        numbers: list[int] = []  # of these objects in the file
        file_count = 0
        bounds: dict[int, tuple[Floats, Floats]] = {}
        contents: list[tuple[int, tuple[Floats, Floats]]] = []
        for row, node in enumerate(tree.nodes):
            is_animated = bool(tree.member[row] >= 0)
            if not is_animated and is_holder(node.fields):
                ids.append(-1)
                continue
            above = self._root_id if node.parent < 0 else ids[node.parent]
            name = node.fields.text("name", "")
            is_dynamic = is_animated or node.number in self._dynamic
            ids.append(self._builder.add_node(node.local, above, dynamic=is_dynamic, name=name))
            if node.number in hidden:
                self._builder.hide(ids[-1])
            mesh = node.fields.index("mesh", len(self._meshes))
            is_drawn, first = mesh >= 0 and self._is_read(node), len(numbers)
            for part in self._meshes[mesh] if is_drawn else ():
                change = self._read_deformed(node, part, tracks, skeletons)
                geometry, at = part.mesh, row
                if change is not None:
                    geometry = self._add_deformed(change, self._builder.mesh_name(part.mesh))
                    at = row if change.skeleton is None else change.skeleton.anchor
                    if change.is_animated:
                        deformed.append((len(objects), change))
                material = self._materials.get(part.material, self._primitives.is_unlit(part.primitive))
                objects.append((at, geometry, material))
                numbers.append(file_count + len(numbers) - first)
                if tree.motion is not None and geometry not in bounds:
                    bounds[geometry] = self._builder.mesh_bounds(geometry)
                if tree.motion is not None and at >= 0:
                    contents.append((at, bounds[geometry]))
            file_count += self._part_counts[mesh] if mesh >= 0 else 0
        if any(at < 0 for at, _, _ in objects):
            ids.append(
                self._builder.add_node(parent=self._root_id, name="skins")
            )  # for skins without a node above all joints
        before = self._builder.object_count
        self._add_objects(
            [(ids[at], geometry, material) for at, geometry, material in objects], numbers, file_count
        )
        if deformed:
            uv_gradients = deformations.Deformations([change for _, change in deformed], self._builder.clips)
            self._builder.simulate([before + number for number, _ in deformed], uv_gradients)
        if tree.motion is not None:
            rows = np.flatnonzero(tree.member >= 0)
            self._builder.animate(np.array(ids)[rows], tree.motion, tree.compute_bounds(contents))
        for row, node in enumerate(tree.nodes):
            targets = (TRANSLATION, ROTATION, SCALE, WEIGHTS) if ids[row] >= 0 else ()
            moving = {track.clip for target in targets for track in tracks.get((node.number, target), ())}
            for clip in moving:
                self._builder.clips.nodes[clip].append(ids[row])
        return ids

    def _read_deformed(
        self,
        node: GltfNode,
        part: _GltfPart,
        tracks: Tracks,
        skeletons: list[deformations.Skeleton | None],
    ) -> deformations.DeformedMesh | None:
        """Return the deformation of a part of a mesh at a node, or None if it isn't deformed."""
        skin = node.fields.index("skin", len(skeletons))
        skeleton = skeletons[skin] if skin >= 0 else None
        if skin >= 0 and (skeleton is None or "JOINTS_0" not in part.primitive.child("attributes")):
            self._omissions.add("skins without joints in the scene or in the mesh", node.fields.where)
            skeleton = None
        count = part.primitive.length("targets")
        if not count and skeleton is None:
            return None
        weights_fields = node.fields if "weights" in node.fields else part.holder
        weights = weights_fields.reals("weights", count) if "weights" in weights_fields else np.zeros(count)
        moved = tracks.get((node.number, WEIGHTS), []) if count else []
        shape = self._primitives.read(part.primitive)
        if shape is None or (skeleton is None and not moved and not weights.any()):
            return None
        for target in part.primitive.children("targets"):
            for name in sorted(target.values.keys() - deformations.TARGET_ATTRIBUTES):
                self._omissions.add(f"offsets of {name} in a morph target", target.where)
        uv = "" if self._primitives.is_unlit(part.primitive) else self._materials.normal_map_uv(part.material)
        return deformations.read_deformed(
            part.primitive, shape, self._accessors, weights, moved, self._builder.clips, skeleton, uv
        )

    def _add_deformed(self, change: deformations.DeformedMesh, name: str) -> int:
        """Add the mesh of a deformed object as it is at the beginning."""
        vertices = change.geometry.vertices.copy()
        deformed = change.vertices(0.0)
        for field in deformed.dtype.names or ():
            vertices[field] = deformed[field]
        geometry = MeshGeometry(vertices, change.geometry.indices)
        return self._builder.add_mesh(geometry, name, change.bounds() if change.is_animated else None)

    def _add_objects(self, objects: list[tuple[int, int, int]], numbers: list[int], file_count: int) -> None:
        """Add objects (node, mesh, material); objects of a saved scene keep their order.

        Args:
            numbers: those of the objects in the file, which has `file_count`.
        """
        if not objects:
            return
        table, rows = np.array(objects, np.int64), np.array(numbers)
        if self._private.length("objects") == file_count:  # else another program has changed them
            order = self._private.indices("objects", file_count)
            if len(set(order)) < file_count:
                self._private.refuse("objects", "a row twice", "each row once")
            rows = np.array(order)[rows]
            table, rows = table[np.argsort(rows)], np.sort(rows)
        casts = ~np.isin(rows, self._private.indices("shadowless", file_count))
        ends = [*(np.flatnonzero(np.diff(casts)) + 1).tolist(), len(table)]
        for start, end in zip([0, *ends], ends, strict=False):
            nodes, meshes, materials = table[start:end].T
            self._builder.add_objects(nodes, meshes, materials, bool(casts[start]))

    def _is_read(self, node: GltfNode) -> bool:
        return node.number not in self._left_out

    def _add_cameras(self, nodes: list[GltfNode], worlds: Floats, anchors: list[tuple[Floats, int]]) -> None:
        cameras = self._root.children("cameras")
        used = [
            (number, node, world, anchor)
            for node, world, anchor in zip(nodes, worlds, anchors, strict=True)
            if (number := node.fields.index("camera", len(cameras))) >= 0 and self._is_read(node)
        ]
        if self.scene_extras is not None:  # views of a saved scene keep their order
            used.sort(key=lambda camera_and_anchor: camera_and_anchor[0])
        for number, node, world, (transform, followed) in used:
            try:
                camera = read_camera(cameras[number], transform)
            except ValidationError as error:  # the rest of the file can still be seen
                problem = error.given.removeprefix(f"{self._file.path}: ")
                self._omissions.add(f"a camera that can't be read ({problem})", cameras[number].where)
                continue
            if camera is None or orthonormalize_axes(world) is None:
                self._omissions.add("cameras without a direction", node.fields.where)
                continue
            name = node.fields.text("name", "") or cameras[number].text("name", "") or f"camera {number}"
            view = self._view_names.choose(name, self._builder.views)
            self._builder.views[view] = camera
            if followed >= 0:
                self._builder.attach_view(view, followed)

    def _add_lights(self, nodes: list[GltfNode], worlds: Floats, anchors: list[tuple[Floats, int]]) -> None:
        extension = self._root.extension("KHR_lights_punctual")
        lights = [] if extension is None else extension.children("lights")
        used = [
            (fields.index("light", len(lights), required=True), anchor)
            for node, anchor in zip(nodes, anchors, strict=True)
            if (fields := node.fields.extension("KHR_lights_punctual")) is not None and self._is_read(node)
        ]
        if self.scene_extras is not None:  # lights of a saved scene keep their order
            used.sort(key=lambda light_and_anchor: light_and_anchor[0])
        collector = LightCollector()
        for number, (transform, followed) in used:
            collector.add(lights[number], transform, self._omissions, followed)
        collector.add_to(self._builder)
