"""The nodes of a glTF scene: hierarchy, transforms, cameras and lights.

Nodes are listed by depth and then by their number in the file, which is the order of the rows of a scene.
Each node has one parent at most and none is above itself: a file in which that isn't so is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from renderer.content.gltf.document import JsonObject
from renderer.content.gltf.extras import INFINITE, get_extras
from renderer.content.gltf.tracks import compose
from renderer.light_kinds.arrays import WIDEST_SOURCE
from renderer.light_kinds.shapes import turn_sides
from renderer.light_kinds.table import LIGHT_KINDS
from renderer.scene.arrays import Floats, Indices
from renderer.scene.attachments import orthonormalize_axes
from renderer.scene.omissions import Omissions
from renderer.scene.scene_builder import SceneBuilder
from rhi.math import Camera, Orthographic, Perspective, multiply

CANDELA: Final = 1.0 / np.pi
"""Intensity of a light for each candela: a white surface that faces it reflects 1 / π of what it receives in
glTF, and all of it here."""

_FAINT: Final = 1.0 / 512.0  # what a light without a range gives at the range that it gets
_FARTHEST: Final = 1e6  # metres: the greatest of these ranges
_LARGEST_WORLD: Final = 1e60  # in a world transform: float32 vertices times it can be squared
_EXACT: Final = 1e-9  # deviation of a squared length from 1, up to which a quaternion is kept as it is


@dataclass(frozen=True, eq=False, slots=True)
class GltfNode:
    """A node of a file.

    Attributes:
        number: its index in the file.
        fields: the node as it stands there.
        parent: the row of its parent in the list, or -1.
        local: its transform (4, 4).
        parts: translation (3,), rotation (4,) and scale (3,), or None if the file has a matrix.
    """

    number: int
    fields: JsonObject
    parent: int
    local: Floats
    parts: tuple[Floats, Floats, Floats] | None


def list_nodes(root: JsonObject, omissions: Omissions) -> list[GltfNode]:
    """Return the nodes of the file's default scene, or all nodes if it has no scene."""
    nodes = root.children("nodes")
    children = [fields.indices("children", len(nodes)) for fields in nodes]
    above = np.full(len(nodes), -1, np.int64)
    for number, below in enumerate(children):
        for position, child in enumerate(below):
            if above[child] >= 0:
                nodes[number].refuse(
                    f"children[{position}]", f"{child} is also a child of nodes[{above[child]}]"
                )
            above[child] = number
    scenes = root.children("scenes")
    if scenes:
        scene = scenes[max(root.index("scene", len(scenes)), 0)]
        level = scene.indices("nodes", len(nodes))
        for position, number in enumerate(level):
            if above[number] >= 0:
                scene.refuse(f"nodes[{position}]", f"{number} is a child of nodes[{above[number]}]", "roots")
        if len(set(level)) < len(level):
            scene.refuse("nodes", level, "each node once")
        for other in scenes:
            if other is not scene and set(other.indices("nodes", len(nodes))) - set(level):
                omissions.add("other scenes", other.where)
    else:
        level = np.flatnonzero(above < 0).tolist()
        if nodes and not level:
            root.refuse("nodes", "each node is the child of another, in a cycle")
    listed: list[GltfNode] = []
    row_of: dict[int, int] = {}
    while level:
        for number in sorted(level):
            row_of[number] = len(listed)
            listed.append(_read_node(nodes[number], number, row_of.get(int(above[number]), -1)))
        level = [child for number in level for child in children[number]]
    return listed


def compute_world_transforms(nodes: list[GltfNode]) -> Floats:
    """Return the world transforms (n, 4, 4) of nodes, at the beginning."""
    worlds = np.zeros((len(nodes), 4, 4))
    for row, node in enumerate(nodes):
        worlds[row] = node.local if node.parent < 0 else multiply(worlds[node.parent], node.local)
        if np.abs(worlds[row]).max() > _LARGEST_WORLD:
            node.fields.refuse(
                "", f"a world transform up to {np.abs(worlds[row]).max():g}", f"{_LARGEST_WORLD:g}"
            )
    return worlds


def read_camera(fields: JsonObject, world: Floats) -> Camera | None:
    """Return a camera of the file at a node, or None if it looks nowhere; a camera looks along -Z of its
    node."""
    if fields.choice("type", ("perspective", "orthographic")) == "perspective":
        perspective = fields.child("perspective")
        near = perspective.real("znear", low=1e-12)
        far = perspective.real("zfar", low=near * (1.0 + 1e-9)) if "zfar" in perspective else np.inf
        extras = get_extras(fields)
        if extras is not None and extras.values.get(INFINITE) == far:
            far = np.inf
        fov, aspect = (
            perspective.real("yfov", low=1e-6, high=3.14159),
            perspective.real("aspectRatio", 16.0 / 9.0, 1e-6, 1e6),
        )
        projection: Perspective | Orthographic = Perspective(fov, aspect, near, far)
    else:
        perspective = fields.child("orthographic")
        width, height = perspective.real("xmag", low=1e-12), perspective.real("ymag", low=1e-12)
        near = perspective.real("znear")
        far = perspective.real("zfar", low=near + 1e-9)
        projection = Orthographic(2.0 * height, width / height, near, far)
    axes = orthonormalize_axes(world)
    return None if axes is None else Camera(world[:3, 3].copy(), axes, projection)


_KINDS: Final = {kind.gltf.type: kind for kind in LIGHT_KINDS if kind.gltf is not None}
"""The kinds of lights that glTF has, by their type in files."""


class LightCollector:
    """Lights of KHR_lights_punctual at nodes, collected so that they are added as arrays."""

    def __init__(self) -> None:
        self._rows: dict[str, list[dict[str, Any]]] = {name: [] for name in _KINDS}
        self._nodes: dict[str, list[int]] = {name: [] for name in _KINDS}

    def add(self, fields: JsonObject, world: Floats, omissions: Omissions, node: int = -1) -> None:
        """Add a light at a node, along whose -Z it shines.

        Args:
            world: the node's transform to the world, or to the space of the scene's node `node`, which the light
                follows unless that is -1.
        """
        kind = _KINDS[fields.choice("type", self._rows)]
        color = fields.reals("color", 3, (1.0, 1.0, 1.0), 0.0)
        extras = get_extras(fields)
        row: dict[str, Any] = {
            "color": color,
            "intensity": fields.real("intensity", 1.0, 0.0) * CANDELA,
            "casts_shadow": extras is not None and extras.flag("casts_shadow"),
        }
        if kind.has_direction:
            axes = orthonormalize_axes(world)
            if axes is None:
                omissions.add("lights without a direction", fields.where)
                return
            row["direction"] = -axes[2]
        if kind.has_range:
            faint = float(np.sqrt(row["intensity"] * color.max() / _FAINT))
            row["position"] = world[:3, 3]
            row["range"] = fields.real("range", min(max(faint, 1e-3), _FARTHEST), 1e-30)
            row["source_radius"] = (
                0.0 if extras is None else extras.real("source_radius", 0.0, 0.0, row["range"])
            )
            if kind.has_shapes:
                row |= _read_sides(extras, world)
        else:
            row["angular_diameter"] = (
                0.0 if extras is None else extras.real("angular_diameter", 0.0, 0.0, WIDEST_SOURCE)
            )
        assert kind.gltf is not None
        row |= kind.gltf.read(fields)
        self._rows[kind.gltf.type].append(row)
        self._nodes[kind.gltf.type].append(node)

    def add_to(self, builder: SceneBuilder) -> None:
        """Add all lights, each kind in the order in which they were collected."""
        lights = builder.lights
        for type, kind in _KINDS.items():
            rows, nodes = self._rows[type], np.array(self._nodes[type], np.int64)
            added: Indices = np.zeros(0, np.int64)
            if not kind.has_range:
                added = np.array([getattr(lights, f"add_{kind.name}")(**row) for row in rows], np.int64)
            elif rows:
                columns: dict[str, Any] = {name: np.array([row[name] for row in rows]) for name in rows[0]}
                shadows = columns.pop("casts_shadow")
                added = getattr(lights, f"add_{kind.name}s")(**columns)
                lights.of_kind(kind)["casts_shadow"][added] = shadows
            follows = nodes >= 0
            if follows.any():
                builder.attach_lights(kind.name, added[follows], nodes[follows])


def _read_sides(extras: JsonObject | None, world: Floats) -> dict[str, Floats]:
    """The sides of a light's source, from the space of its node."""
    names = ("source_right", "source_up")
    zero = (0.0, 0.0, 0.0)
    sides = np.array([zero if extras is None else extras.reals(name, 3, zero) for name in names])
    right, up = turn_sides(world[None, :3, :3], sides[None])
    return {"source_right": right[0], "source_up": up[0]}


def _read_node(fields: JsonObject, number: int, parent: int) -> GltfNode:
    if "matrix" in fields:
        local = fields.reals("matrix", 16).reshape(4, 4).T
        if not (local[3] == (0.0, 0.0, 0.0, 1.0)).all():
            fields.refuse("matrix", f"last row {local[3].tolist()}", "0 0 0 1")
        return GltfNode(number, fields, parent, local, None)
    rotation = fields.reals("rotation", 4, (0.0, 0.0, 0.0, 1.0))
    squared = float(rotation @ rotation)
    if not 1e-12 < squared < 1e12:
        fields.refuse("rotation", rotation.tolist(), "a quaternion of length 1")
    if abs(squared - 1.0) > _EXACT:
        rotation = rotation / np.sqrt(squared)
    parts = (
        fields.reals("translation", 3, (0.0, 0.0, 0.0)),
        rotation,
        fields.reals("scale", 3, (1.0, 1.0, 1.0)),
    )
    return GltfNode(number, fields, parent, compose(*parts), parts)
