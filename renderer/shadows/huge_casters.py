"""Casters that are huge beside a map, such as the ground of a whole planet: their triangles are cut to the
map.

Float32 rounds the corners of a triangle of 10⁷ m by a metre, and a device that clips it rounds as much again:
the ground would shade itself. Cut in float64, and relative to the map, the part that the map sees is as exact
as that of any other caster.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Scene
from renderer.scene.arrays import Floats, Indices
from renderer.shaders.depth import PositionVertex
from renderer.shaders.structs import ViewConstants
from renderer.shadows.cascades import Cascade
from rhi.shading import Shader, Uniform, vec4

MAX_ROUNDING: Final = 0.25
"""The greatest error of a caster's corners, in texels of the map, up to which it is drawn as it is."""

MAX_RECEIVER_ROUNDING: Final = 2.0
"""The greatest error of what shadows fall on, in texels of the map, about which nothing is said."""

MAX_TRIANGLES: Final = 65_536
"""Meshes of more triangles are drawn as they are: none of these is as large."""

_CORNER_ERROR: Final = 2.0**-22
"""The greatest error of a corner in float32, in extents of its object."""


class CutCaster(Shader):
    """Draws the depth of triangles whose corners are relative to the eye."""

    lean = True
    view: Uniform[ViewConstants]

    def vertex(self, v: PositionVertex) -> vec4:
        return self.view.relative_view_projection @ vec4(v.position, 1.0)


def largest_extent(cascade: Cascade) -> float:
    """Return the extent of an object in metres up to which its corners are fine enough for a map."""
    return MAX_ROUNDING * cascade.texel / _CORNER_ERROR


def widest_receiver(texel: float) -> float:
    """Return the extent of an object in metres up to which the points that a view shows of it are right to
    `MAX_RECEIVER_ROUNDING` texels of this width in metres."""
    return MAX_RECEIVER_ROUNDING * texel / _CORNER_ERROR


def is_huge(lower: Floats, upper: Floats, cascade: Cascade) -> NDArray[np.bool_]:
    """Return whether the corners of objects with boxes (k, 3) along the light's axes are too coarse for a
    map."""
    return np.asarray((upper - lower).max(1, initial=0.0) > largest_extent(cascade))


def can_be_cut(scene: Scene, rows: Indices) -> NDArray[np.bool_]:
    """Return which objects (k,) have triangles that the CPU knows, and not too many of them."""
    objects = scene.objects
    counts = scene.meshes.ranges["index_count"][objects.mesh[rows]]
    return np.asarray(
        ~objects.simulated[rows] & ~np.isin(rows, list(scene.tessellated)) & (counts <= 3 * MAX_TRIANGLES)
    )


def cut_to_map(scene: Scene, rows: Indices, cascade: Cascade) -> Floats:
    """Return the corners (k, 3, 3) of what a map sees of the triangles of objects, relative to its camera and
    along the world's axes. What is above the map is at its near plane."""
    camera = cascade.camera
    half = 1.0 / camera.projection.matrix[0, 0]
    parts = []
    for row in rows.tolist():
        mesh = scene.meshes.ranges[scene.objects.mesh[row]]
        first, count = int(mesh["first_index"]), int(mesh["index_count"])
        corners = scene.meshes.indices[first : first + count].astype(np.int64) + int(mesh["base_vertex"])
        positions = scene.meshes.vertices["position"][corners].astype(np.float64)
        world = scene.nodes.world[scene.objects.node[row]]
        relative = positions @ world[:3, :3].T + (world[:3, 3] - camera.position)
        triangles = (relative @ camera.rotation.T).reshape(-1, 3, 3)
        for axis, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
            triangles = cut_triangles(triangles, half - sign * triangles[:, :, axis])
        triangles = cut_triangles(triangles, cascade.length + triangles[:, :, 2])
        above, within = (
            cut_triangles(triangles, triangles[:, :, 2]),
            cut_triangles(triangles, -triangles[:, :, 2]),
        )
        above[:, :, 2] = 0.0
        parts += [above @ camera.rotation, within @ camera.rotation]
    return np.concatenate([np.zeros((0, 3, 3)), *parts])


def cut_triangles(triangles: Floats, distances: Floats) -> Floats:
    """Return the part of triangles (t, 3, 3) where the distance is 0 or more, as triangles with the same
    winding.

    Args:
        distances: (t, 3) of the corners from a plane.
    """
    inside = distances >= 0.0
    counts = inside.sum(1)
    results = [triangles[counts == 3]]
    for count in (1, 2):
        # The corner that is alone on its side comes first.
        is_selected = counts == count
        lone = (inside[is_selected] == (count == 1)).argmax(1)
        order = (lone[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(triangles[is_selected], order[:, :, None], 1).transpose(1, 0, 2)
        to_a, to_b, to_c = np.take_along_axis(distances[is_selected], order, 1).T[:, :, None]
        ab, ac = a + (b - a) * (to_a / (to_a - to_b)), a + (c - a) * (to_a / (to_a - to_c))
        if count == 1:
            results.append(np.stack([a, ab, ac], 1))
        else:
            results += [np.stack([ab, b, c], 1), np.stack([ab, c, ac], 1)]
    return np.concatenate(results)
