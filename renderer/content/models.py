"""Model files as scenes: glTF is read by `renderer.content.gltf`, OBJ, PLY and STL by trimesh.

Both are imported on first use: trimesh takes 0.3 s, glTF 0.05 s. Meshes far from their origin would lose
precision in float32: the positions that trimesh has read in float64 are stored relative to the mesh's centre,
and a node moves them back.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from io import BytesIO
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from renderer import rules
from renderer.content.assets import share_geometry, share_image
from renderer.content.file_index import FileIndex
from renderer.content.import_options import ImportOptions, ModelPlacement
from renderer.content.limits import Budget, ModelLimits
from renderer.content.progress import report
from renderer.scene.arrays import Floats
from renderer.scene.meshes import MeshGeometry, join, make_geometry
from renderer.scene.omissions import Omission, Omissions
from renderer.scene.paths import make_path
from renderer.scene.scene import Scene
from renderer.scene.scene_builder import SceneBuilder
from rhi import ValidationError, decode_colors, from_srgb, open_image
from rhi.errors import RhiError, refuse
from rhi.math import Perspective, is_affine, translation

if TYPE_CHECKING:
    from renderer.content.gltf import SceneExtras

FORMATS: Final = (".gltf", ".glb", ".obj", ".ply", ".stl")
"""The extensions of the files that can be read."""

_GLTF: Final = (".gltf", ".glb")

_FAR: Final = (
    64.0  # a mesh farther from its origin than this many times its size is stored relative to its centre
)


@dataclass(frozen=True, slots=True)
class _FileNode:
    """A node of the file, with its parent's index in the list or -1, and its mesh's name or None."""

    name: str
    parent: int
    local: Floats
    mesh: str | None


def load_model(
    path: str | Path, limits: ModelLimits | None = None, options: ImportOptions | None = None
) -> Scene:
    """Load the scene in a model file, and add fitting camera paths, and a sun if it has no light. Its name is
    the path.

    A glTF file with only lights, cameras or empty nodes is a scene with one object that is reserved, and so
    hidden. `Scene.omissions` lists what the file has and the scene hasn't. `limits`: what the file may ask
    for. `options`: how it is scaled and placed, and what is left out or merged. Refused as by `add_model`.
    """
    path = _find_file(path)
    builder = SceneBuilder(path)
    builder.background = (0.30, 0.36, 0.44)
    scene_extras = _add(builder, path, limits, options)
    if scene_extras is not None:
        builder.background, builder.haze = scene_extras.background, scene_extras.haze
        builder.lights.sky, builder.lights.ground = scene_extras.sky, scene_extras.ground
        builder.paths.update(scene_extras.paths)
    elif not len(builder.lights):
        builder.lights.add_directional((-0.45, -0.8, -0.4), (1.0, 0.96, 0.9), 1.9)
        builder.lights.sky, builder.lights.ground = (0.28, 0.32, 0.40), (0.14, 0.13, 0.12)
    if not builder.object_count:
        triangle = make_geometry(np.eye(3), range(3))
        builder.reserve(
            1, builder.add_mesh(triangle), builder.add_material()
        )  # the renderer's arrays have rows
    report("scene")
    scene = builder.build()
    scene.files = tuple(builder.files)
    if scene_extras is None:
        _add_paths(scene, has_view=bool(builder.views))
    return scene


def add_model(
    builder: SceneBuilder,
    path: str | Path,
    limits: ModelLimits | None = None,
    options: ImportOptions | None = None,
) -> None:
    """Add everything in a model file to a scene under construction, or nothing if it is refused. An image or a
    mesh that is there already, from whichever file, is added once.

    Refused, naming the file: `scene-missing-file`, `scene-unknown-format`, `scene-unreadable-model`,
    `scene-empty-model`, `scene-bad-vertices`, `scene-bad-transform`, `scene-model-limit`, `scene-unknown-part`.
    """
    _add(builder, _find_file(path), limits, options)


def save_scene(scene: Scene, path: str | Path) -> tuple[Omission, ...]:
    """Write a scene as glTF: `.glb`, or `.gltf` with a `.bin` beside it. Return what the file can't hold.

    `load_model` reads the same scene from it: the same rows of nodes, objects, meshes, materials, images,
    lights, and the same views and paths. Animations that were read from glTF are written; other simulations
    are left out, and what they move is written as it is now.

    Refused: `scene-unknown-format`.
    """
    from renderer.content.gltf import write_gltf

    return write_gltf(scene, path)


def _add(
    builder: SceneBuilder, path: str, limits: ModelLimits | None, options: ImportOptions | None
) -> SceneExtras | None:
    """Add everything in a model file; return the scene extras of a saved scene."""
    _check_file(path)
    budget, options = Budget(path, limits or ModelLimits()), options or ImportOptions()
    with builder.undo_on_error():
        placement = ModelPlacement(builder, options)
        scene_extras = None
        if Path(path).suffix.lower() in _GLTF:
            from renderer.content.gltf import add_gltf

            scene_extras = add_gltf(builder, path, budget, options, placement.root)
        else:
            _add_by_trimesh(builder, path, budget, options, placement.root)
        placement.finish(budget)
    budget.index.save()
    if scene_extras is not None and options.moves:
        paths = {name: placement.move_path(path) for name, path in scene_extras.paths.items()}
        return replace(scene_extras, haze=scene_extras.haze / options.scale, paths=paths)
    return scene_extras


def _find_file(path: str | Path) -> str:
    """Return the path of a model file, or of where it was moved to."""
    return str(path) if Path(path).exists() else str(FileIndex().find(Path(path), Path(path).parent))


def _add_by_trimesh(
    builder: SceneBuilder, path: str, budget: Budget, options: ImportOptions, root: int
) -> None:
    meshes, nodes, files = _read(path, budget, builder.omissions, splits_objects=bool(options.without))
    builder.files += files
    options.check_names(path, [*meshes, *(node.name for node in nodes)])
    nodes = list(_leave_out(nodes, options))
    used = {node.mesh for node in nodes}
    if used <= {None}:
        refuse(rules.EMPTY_MODEL, f"load_model({path!r})", f"{path} without {', '.join(options.without)}")
    ids: dict[str, tuple[int, int, Floats]] = {}
    for number, (name, mesh) in enumerate(meshes.items()):
        if name in used:
            report("meshes", number, len(meshes))
            budget.spend("vertices", len(mesh.vertices) + 3 * len(mesh.faces))
            geometry, centre = _convert(path, mesh)
            ids[name] = (
                builder.add_mesh(share_geometry(geometry), name),
                _add_material(builder, mesh),
                centre,
            )
    rows: list[int] = []
    for node in nodes:
        parent = root if node.parent < 0 else rows[node.parent]
        rows.append(builder.add_node(node.local, parent, name=node.name))
        if node.mesh is not None:
            mesh_id, material, centre = ids[node.mesh]
            at = builder.add_node(translation(centre), rows[-1]) if centre.any() else rows[-1]
            builder.add_objects(at, mesh_id, material)


def _leave_out(nodes: list[_FileNode], options: ImportOptions) -> Iterator[_FileNode]:
    """Yield the nodes; those that are left out, or below such a node, have no mesh."""
    flags = options.flag_left_out((node.parent, node.name) for node in nodes)
    for node, is_out in zip(nodes, flags, strict=True):
        has_mesh = node.mesh is not None and not is_out and not options.leaves_out(node.mesh)
        yield node if has_mesh else replace(node, mesh=None)


def read_geometry(path: str) -> MeshGeometry:
    """Load all triangles of a model file as one mesh, in the file's world space."""
    builder = SceneBuilder(path)
    add_model(builder, path)
    scene = builder.build()
    parts = [
        scene.meshes.geometry(mesh).transformed(scene.nodes.world[node])
        for mesh, node in zip(scene.objects.mesh.tolist(), scene.objects.node.tolist(), strict=True)
    ]
    return join(parts)


def _read(
    path: str, budget: Budget, omissions: Omissions, *, splits_objects: bool
) -> tuple[dict[str, Any], list[_FileNode], list[Path]]:
    """Read the file's triangle meshes by name, its nodes, parents before children, and which files that
    took. Objects of an OBJ file are joined by material, unless `splits_objects`."""
    file, call = Path(path), f"load_model({path!r})"
    with _quiet():
        import trimesh

        try:
            noted = _make_resolver(file, budget)
            content = BytesIO(budget.read(file))
            kind = file.suffix.lower().lstrip(".")
            split: dict[str, Any] = {"split_objects": True, "group_material": False} if splits_objects else {}
            loaded = trimesh.load_scene(content, file_type=kind, process=False, resolver=noted, **split)
            if noted.refusal is not None:
                raise noted.refusal
            for name, reason in noted.unreadable:
                omissions.add(f"an image that can't be read ({reason})", name)
        except RhiError:
            raise
        except Exception as error:
            refuse(rules.UNREADABLE_MODEL, call, f"{path}: {type(error).__name__}: {error}")
        meshes = {
            name: mesh
            for name, mesh in loaded.geometry.items()
            if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)
        }
        nodes = _list_nodes(loaded.graph, meshes)
    if not any(node.mesh is not None for node in nodes):
        refuse(rules.EMPTY_MODEL, call, path)
    for node in nodes:
        if not is_affine(node.local):
            refuse(rules.BAD_TRANSFORM, call, f"{path}: node {node.name!r}")
    return meshes, nodes, noted.files


def _make_resolver(file: Path, budget: Budget) -> Any:
    """Return trimesh's reader of materials and images beside a file, which notes in `files` what it looks
    for."""
    from trimesh.resolvers import FilePathResolver

    class Noting(FilePathResolver):
        def __init__(self, source: str) -> None:
            super().__init__(source)
            self.files = [Path(source)]
            self.refusal: RhiError | None = None
            self.unreadable: list[tuple[str, str]] = []  # names of images, and the reasons
            self._is_image = file.suffix.lower() != ".obj"  # of which the materials are read first

        def get(self, name: str) -> Any:
            is_image, self._is_image = self._is_image, True
            beside = [
                Path(self.parent) / relative for relative in (name.strip().lstrip("/"), Path(name).name)
            ]
            file = budget.find(([path for path in beside if path.is_file()] or beside)[0])
            self.files.append(file)
            if not budget.allows(file):
                raise FileNotFoundError(f"{name} isn't in the folder of {file}")
            try:
                content = budget.read(file)
                if is_image:
                    budget.spend_image(content)
            except RhiError as error:  # which trimesh goes on after
                self.refusal = error
                raise
            if is_image:
                self._check_image(name, content)
            return content

        def _check_image(self, name: str, content: bytes) -> None:
            """Refuse what `rhi` doesn't open as an image, before any other reader of Pillow sees it."""
            try:
                open_image(content, max_pixels=inf).close()
            except ValidationError as error:
                self.unreadable.append((name, error.given.partition(": ")[2]))
                raise

    return Noting(str(file))


def _check_file(path: str) -> None:
    file, call = Path(path), f"load_model({path!r})"
    if not file.exists():
        moved = (
            "if it was moved after it was loaded, `python -m renderer assets FOLDER` finds it in that folder"
        )
        refuse(rules.MISSING_FILE, call, path, tip=f"relative paths are resolved in {Path.cwd()}; {moved}")
    if file.suffix.lower() not in FORMATS:
        refuse(rules.UNKNOWN_FORMAT, call, file.suffix or file.name, ", ".join(FORMATS))
    if not file.is_file():
        refuse(rules.UNREADABLE_MODEL, call, f"{path} isn't a regular file")
    if not file.stat().st_size:
        refuse(rules.EMPTY_MODEL, call, f"{path}, 0 bytes")


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress warnings about trimesh's own use of NumPy and pillow."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _list_nodes(graph: Any, meshes: dict[str, Any]) -> list[_FileNode]:
    forest = graph.transforms
    order = [graph.base_frame]
    nodes = [_FileNode(str(graph.base_frame), -1, np.eye(4), _mesh_at(forest, graph.base_frame, meshes))]
    for parent, above in enumerate(order):  # grows during the iteration: breadth first
        for name in forest.children.get(above, ()):
            matrix = forest.edge_data[(above, name)].get("matrix")
            local = np.eye(4) if matrix is None else np.array(matrix, np.float64)
            order.append(name)
            nodes.append(_FileNode(str(name), parent, local, _mesh_at(forest, name, meshes)))
    return nodes


def _mesh_at(forest: Any, name: Any, meshes: dict[str, Any]) -> str | None:
    mesh = forest.node_data.get(name, {}).get("geometry")
    return mesh if mesh in meshes else None


def _convert(path: str, mesh: Any) -> tuple[MeshGeometry, Floats]:
    """Convert a mesh of trimesh; return it and the centre (3,) that was subtracted from its positions."""
    call = f"load_model({path!r})"
    positions = np.array(mesh.vertices, np.float64)
    with np.errstate(over="ignore"):
        finite = np.isfinite(positions.astype(np.float32)).all(1)
    if not finite.all():
        worst = int(np.flatnonzero(~finite)[0])
        refuse(rules.BAD_VERTICES, call, f"{path}: vertex {worst} is {positions[worst]}", "finite float32")
    lower, upper = positions.min(0), positions.max(0)
    centre = 0.5 * (lower + upper)
    if np.abs(centre).max() <= _FAR * (upper - lower).max():
        centre = np.zeros(3)
    faces = np.asarray(mesh.faces, np.int64)
    if faces.min() < 0 or faces.max() >= len(positions):
        refuse(
            rules.UNREADABLE_MODEL,
            call,
            f"{path}: a face refers to vertex {faces.max()}",
            f"0 to {len(positions) - 1}",
        )
    uv = _texture_coordinates(mesh, len(positions))
    return make_geometry(positions - centre, faces, _stored_normals(mesh, len(positions)), uv), centre


def _stored_normals(mesh: Any, count: int) -> Floats | None:
    """Return the unit normals of the file, or None if there are none or any is invalid."""
    if "vertex_normals" not in mesh._cache:  # reading the property would compute them
        return None
    normals = np.array(mesh.vertex_normals, np.float64)
    if normals.shape != (count, 3) or not np.isfinite(normals).all():
        return None
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / length if (length > 1e-6).all() else None


def _texture_coordinates(mesh: Any, count: int) -> Floats | None:
    uv = getattr(mesh.visual, "uv", None)
    if uv is None or np.shape(uv) != (count, 2):
        return None
    flipped = np.array(uv, np.float64) * (1.0, -1.0) + (0.0, 1.0)  # trimesh's v = 0 is an image's last row
    return np.where(np.isfinite(flipped), flipped, 0.0)


def _add_material(builder: SceneBuilder, mesh: Any) -> int:
    """Add a material with the colour and the texture of a mesh."""
    visual = mesh.visual
    material = getattr(visual, "material", None)
    image = getattr(material, "image", None)
    texture = -1
    if image is not None:
        try:
            texture = builder.add_image(share_image(decode_colors(image)))
        except ValidationError as error:
            builder.omissions.add(
                f"an image that can't be read ({error.given})", mesh.metadata.get("name", "")
            )
    diffuse = (
        getattr(material, "diffuse", None) if material is not None else getattr(visual, "main_color", None)
    )
    color = np.ones(4) if diffuse is None or texture >= 0 else _unit_range(diffuse)
    return builder.add_material(
        base_color=(*from_srgb(color[:3]), color[3]), texture=texture, rim_strength=0.1
    )


def _unit_range(color: Any) -> Floats:
    """Convert a colour of three or four numbers to RGBA from 0 to 1."""
    channels = np.asarray(color)
    values = channels.astype(np.float64) / (255.0 if channels.dtype.kind in "ui" else 1.0)
    return np.clip(np.append(values, 1.0)[:4] if len(values) == 3 else values, 0.0, 1.0)


def _add_paths(scene: Scene, has_view: bool) -> None:
    """Add the paths `ground`, low through the model, and `sky`, above it, along its longer side."""
    lower, upper = scene.bounds
    size = np.maximum(upper - lower, 1e-3 * max(float((upper - lower).max()), 1e-6))
    middle = 0.5 * (lower + upper)
    along = np.array([1.0, 0.0, 0.0]) if size[0] >= size[2] else np.array([0.0, 0.0, 1.0])
    reach = 0.6 * float(size @ along)
    near = max(1e-4 * float(size.max()), 1e-6)
    projection = Perspective(near=near)
    for name, height in (("ground", 0.15), ("sky", 1.25)):
        level = middle * (1.0, 0.0, 1.0) + np.array([0.0, lower[1] + height * size[1], 0.0])
        sink = 0.0 if name == "ground" else 0.75 * float(size[1])
        ends = np.stack([level - reach * along, level + reach * along])
        scene.paths[name] = make_path(ends, projection, rounding=0.1 * reach, ahead=0.5 * reach, sink=sink)
    if has_view:
        return
    scene.views = {name: view.with_projection(projection) for name, view in scene.views.items()}
