"""Lights and views at nodes: they are in the space of a node, and follow it.

The arrays of `Lights` and the cameras of `Scene.views` are always in the world. An attachment keeps the position of a
light or a view in the space of its node, and `follow` writes where that is in the world now. So whatever reads
lights and views needn't know about nodes.

A node with a light or a view is animated in every frame, whatever is drawn: its light may reach what is in view.
A node's scale moves what is attached to it, but changes neither the range of a light nor the projection of a view.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.light_kinds.kind import LightKind
from renderer.light_kinds.shapes import turn_sides
from renderer.scene.arrays import Floats, Indices
from renderer.scene.lights import Lights
from renderer.scene.nodes import Nodes
from rhi.math import Camera

_ORTHONORMAL: Final = 1e-6  # of products of axes, up to which axes are kept as they are: they may be float32
_SHORTEST: Final = 1e-30  # of an axis that has a direction


def orthonormalize_axes(world: Floats) -> Floats | None:
    """Return the axes (3, 3) of a transform (4, 4) as rows: right, up and back, of unit length and at right
    angles; None if they have no direction."""
    axes: Floats = world[:3, :3].T.copy()
    if np.abs(axes @ axes.T - np.eye(3)).max() <= _ORTHONORMAL:
        return axes
    back, up = axes[2], axes[1]
    length = float(np.linalg.norm(back))
    right = np.cross(up, back)
    across = float(np.linalg.norm(right))
    if not np.isfinite([length, across]).all() or length < _SHORTEST or across < _SHORTEST:
        return None
    back, right = back / length, right / across
    return np.stack([right, np.cross(back, right), back])


@dataclass(frozen=True, eq=False, slots=True)
class AttachedLights:
    """Lights `indices` (k,) of the kind named `kind_name` at the rows `nodes` (k,).

    `positions` and `directions` (k, 3), and `sides` (k, 2, 3) of sources that are rectangles or tubes, are in the
    space of the node; zeros where the kind has none.
    """

    kind_name: str  # scenes travel between processes, kinds don't
    indices: Indices
    nodes: Indices
    positions: Floats
    directions: Floats
    sides: Floats

    @classmethod
    def read(cls, kind: LightKind, lights: Lights, indices: Indices, nodes: Indices) -> AttachedLights:
        """Attach lights to nodes, in whose space their positions and directions are now."""
        rows = lights.of_kind(kind)[indices]
        nowhere = np.zeros((len(indices), 3))
        return cls(
            kind.name,
            indices,
            nodes,
            rows["position"].astype(np.float64) if kind.has_range else nowhere,
            rows["direction"].astype(np.float64) if kind.has_direction else nowhere,
            np.stack([rows["source_right"], rows["source_up"]], axis=1).astype(np.float64)
            if kind.has_shapes
            else np.zeros((len(indices), 2, 3)),
        )

    def follow(self, nodes: Nodes, lights: Lights) -> None:
        """Write where the lights are. A light whose node has no extent along it keeps its direction."""
        array = self._read_array(lights)
        names = array.dtype.names or ()
        is_there = self.indices < len(array)
        indices, worlds = self.indices[is_there], nodes.world[self.nodes[is_there]]
        if "position" in names:
            turned = np.einsum("kij,kj->ki", worlds[:, :3, :3], self.positions[is_there])
            array["position"][indices] = turned + worlds[:, :3, 3]
        if "direction" in names:
            directions = np.einsum("kij,kj->ki", worlds[:, :3, :3], self.directions[is_there])
            lengths = np.linalg.norm(directions, axis=1)
            is_long = lengths >= _SHORTEST
            array["direction"][indices[is_long]] = directions[is_long] / lengths[is_long, None]
        if self.sides.any():
            right, up = turn_sides(worlds[:, :3, :3], self.sides[is_there])
            array["source_right"][indices], array["source_up"][indices] = right, up

    def _read_array(self, lights: Lights) -> NDArray[Any]:
        array: NDArray[Any] = getattr(lights, self.kind_name)
        return array

    def flag_hidden(self, nodes: Nodes, lights: Lights) -> NDArray[np.bool_]:
        """Return which of all lights of the kind are at hidden nodes."""
        hidden = np.zeros(len(self._read_array(lights)), bool)
        is_there = self.indices < len(hidden)
        hidden[self.indices[is_there]] = nodes.hidden[self.nodes[is_there]]
        return hidden


@dataclass(frozen=True, eq=False, slots=True)
class AttachedView:
    """A view at the row `node`, in whose space `camera` is."""

    node: int
    camera: Camera

    def follow(self, nodes: Nodes, current: Camera) -> Camera:
        """Return the camera in the world. At a node whose axes have no direction it keeps that of `current`."""
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = self.camera.rotation.T, self.camera.position
        world = nodes.world[self.node] @ local
        axes = orthonormalize_axes(world)
        return replace(
            self.camera, position=world[:3, 3].copy(), rotation=current.rotation if axes is None else axes
        )


@dataclass(frozen=True, slots=True)
class MovingView:
    """The view `name` of a scene, as its node moves it: the camera of a frame is `Scene.view_at`."""

    name: str


class Attachments:
    """The lights and views of a scene that follow nodes.

    Attributes:
        lights: those of each kind.
        views: by name.
        nodes: (n,) the rows of their nodes, ascending.
    """

    def __init__(
        self, lights: tuple[AttachedLights, ...] = (), views: Mapping[str, AttachedView] | None = None
    ) -> None:
        self.lights = lights
        self.views = dict(views or {})
        rows = [attached.nodes for attached in lights] + [
            np.array([view.node]) for view in self.views.values()
        ]
        self.nodes: Indices = np.unique(np.concatenate([np.zeros(0, np.int64), *rows]))
        self._worlds: Floats = np.full((len(self.nodes), 4, 4), np.nan)  # that everything has followed

    def follow(self, nodes: Nodes, lights: Lights, views: dict[str, Camera]) -> None:
        """Bring lights and views to where their nodes are as of their last update.

        A view that was removed from `views`, or lights that were removed, stay away.
        """
        if not len(self.nodes):
            return
        lights.hidden = {
            attached.kind_name: hidden
            for attached in self.lights
            if (hidden := attached.flag_hidden(nodes, lights)).any()
        }
        worlds = nodes.world[self.nodes]
        if np.array_equal(worlds, self._worlds):
            return
        self._worlds = worlds
        for attached in self.lights:
            attached.follow(nodes, lights)
        for name, view in self.views.items():
            if name in views:
                views[name] = view.follow(nodes, views[name])
