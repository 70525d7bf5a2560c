"""The scene as a tree of lines: nodes below their parents, lights by kind, cameras and materials.

Lines are made for what is open alone, so that a scene of many thousands of nodes costs nothing while it is
closed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from renderer.light_kinds import LIGHT_KINDS
from renderer.scene import Scene
from renderer.scene.arrays import Indices

SECTIONS: Final = ("nodes", "lights", "cameras", "materials")
"""The names of the tree's roots."""

Key = tuple[Any, ...]
"""What a line stands for: a section and, below it, what tells its entries apart, such as `("nodes", 5)`."""


@dataclass(frozen=True, slots=True)
class TreeLine:
    """A line of the tree.

    Attributes:
        key: what it stands for.
        label: its text.
        depth: how deep it is in the tree, 0 for sections.
        has_children: whether it can be opened.
        is_visible: whether it is shown by itself; None for what can't be hidden.
    """

    key: Key
    label: str
    depth: int
    has_children: bool = False
    is_visible: bool | None = None


class SceneTree:
    """The lines of a scene.

    Attributes:
        scene: the scene.
        opened: the keys of the lines that are open.
        selected: the key of the selected line, if any.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.opened: set[Key] = set()
        self.selected: Key | None = None
        parents = np.asarray(scene.nodes.parents)
        self._children: Indices = np.argsort(parents, kind="stable")
        self._starts = np.searchsorted(parents[self._children], np.arange(-1, len(parents) + 1))
        self._light_intensities: dict[tuple[str, int], float] = {}
        self._node_parents = parents

    @property
    def is_outdated(self) -> bool:
        """True if nodes have other parents than when the tree was made."""
        return not np.array_equal(self.scene.nodes.parents, self._node_parents)

    def children(self, node: int) -> Indices:
        """The nodes below a node; those without a parent for -1."""
        return self._children[self._starts[node + 1] : self._starts[node + 2]]

    def list_lines(self) -> list[TreeLine]:
        """All lines that are visible with what is open, from top to bottom."""
        lines: list[TreeLine] = []
        for section, count in self._count_entries().items():
            key: Key = (section,)
            lines.append(TreeLine(key, f"{section} ({count:,})", 0, count > 0))
            if key in self.opened:
                getattr(self, f"_add_{section}")(lines)
        return lines

    def toggle_open(self, key: Key) -> None:
        """Open a line, or close it."""
        self.opened ^= {key}

    def set_visible(self, key: Key, on: bool) -> None:
        """Show or hide a node and all below it, or a light; the next frame has it so."""
        if key[0] == "nodes":
            (self.scene.nodes.show if on else self.scene.nodes.hide)([key[1]])
            return
        _, kind, index = key
        lights = self._lights(kind)
        is_on = lights["intensity"][index] != 0.0
        if on and not is_on:
            lights["intensity"][index] = self._light_intensities.pop((kind, index), 1.0)
        elif is_on and not on:
            self._light_intensities[kind, index] = float(lights["intensity"][index])
            lights["intensity"][index] = 0.0

    def describe(self, key: Key) -> list[tuple[str, str]]:
        """The names and values of what a line stands for."""
        section = key[0]
        if len(key) == 1:
            return [("entries", f"{self._count_entries()[section]:,}")]
        if section == "nodes":
            return self._describe_node(key[1])
        if section == "cameras":
            return self._describe_camera(key[1], key[2])
        if section == "materials":
            record = self.scene.materials[key[1]]
        elif len(key) == 2:
            return [("lights", f"{len(self._lights(key[1])):,}")]
        else:
            record = self._lights(key[1])[key[2]]
        return [(name, format_value(record[name])) for name in record.dtype.names or ()]

    def _count_entries(self) -> dict[str, int]:
        scene = self.scene
        counts = (
            len(scene.nodes),
            sum(len(scene.lights.of_kind(kind)) for kind in LIGHT_KINDS),
            len(scene.views) + len(scene.paths),
            len(scene.materials),
        )
        return dict(zip(SECTIONS, counts, strict=True))

    def _lights(self, kind: str) -> Any:
        return self.scene.lights.of_kind(next(entry for entry in LIGHT_KINDS if entry.name == kind))

    def _add_nodes(self, lines: list[TreeLine]) -> None:
        nodes = self.scene.nodes
        pending = [(int(node), 1) for node in self.children(-1)[::-1]]
        while pending:
            node, depth = pending.pop()
            key: Key = ("nodes", node)
            below = self.children(node)
            name = nodes.names[node] or f"node {node}"
            lines.append(TreeLine(key, name, depth, len(below) > 0, not nodes.hidden_itself[node]))
            if key in self.opened:
                pending += [(int(child), depth + 1) for child in below[::-1]]

    def _add_lights(self, lines: list[TreeLine]) -> None:
        for kind in LIGHT_KINDS:
            lights = self.scene.lights.of_kind(kind)
            key: Key = ("lights", kind.name)
            lines.append(TreeLine(key, f"{kind.noun} ({len(lights):,})", 1, len(lights) > 0))
            if key in self.opened:
                lines += [
                    TreeLine((*key, index), f"{kind.noun} {index}", 2, False, bool(intensity))
                    for index, intensity in enumerate(lights["intensity"].tolist())
                ]

    def _add_cameras(self, lines: list[TreeLine]) -> None:
        lines += [TreeLine(("cameras", "view", name), name, 1) for name in self.scene.views]
        lines += [TreeLine(("cameras", "path", name), f"path {name}", 1) for name in self.scene.paths]

    def _add_materials(self, lines: list[TreeLine]) -> None:
        lines += [
            TreeLine(("materials", index), f"material {index}", 1)
            for index in range(len(self.scene.materials))
        ]

    def _describe_node(self, node: int) -> list[tuple[str, str]]:
        scene, nodes = self.scene, self.scene.nodes
        parent = int(nodes.parents[node])
        rows = [
            ("node", f"{node}"),
            ("parent", "none" if parent < 0 else f"{nodes.names[parent] or 'node'} [{parent}]"),
            ("position", format_value(nodes.local[node, :3, 3])),
            ("in the world", format_value(nodes.world[node, :3, 3])),
            ("moves", "yes" if nodes.dynamic[node] else "no"),
            ("shown", "no" if nodes.hidden[node] else "yes"),
        ]
        for index in np.flatnonzero(scene.objects.node == node)[:8].tolist():
            mesh, material = int(scene.objects.mesh[index]), int(scene.objects.material[index])
            triangles = int(scene.meshes.triangle_counts[mesh])
            text = f"mesh {scene.meshes.names[mesh] or mesh}, {triangles:,} triangles, material {material}"
            rows.append((f"object {index}", text))
        return rows

    def _describe_camera(self, kind: str, name: str) -> list[tuple[str, str]]:
        if kind == "path":
            return [("frames", f"{len(self.scene.paths[name]):,}")]
        camera = self.scene.views[name]
        return [
            ("position", format_value(camera.position)),
            ("direction", format_value(camera.forward)),
            ("projection", type(camera.projection).__name__),
        ]


def format_value(value: Any) -> str:
    """A number, a flag or an array in few digits."""
    values = np.asarray(value)
    if values.ndim:
        return ", ".join(format_value(element) for element in values.reshape(-1))
    if values.dtype == bool:
        return "yes" if values else "no"
    return f"{values.item():.4g}" if values.dtype.kind == "f" else str(values.item())
