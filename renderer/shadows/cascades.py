"""Cascades of a directional light: maps for slices of the view, one behind the other.

- **Splits** are practical (Zhang, Sun, Xu and Lun 2006): a mix of equal ratios and equal distances.
- A slice is enclosed by a **sphere**. Its radius depends on the projection alone, so that a turn of the eye
  changes neither the size of a texel nor, but for whole texels, the position of a map.
- The middle of a map is moved to **whole texels**, and its depth to whole steps, in float64 and in the world.
  So texels are at fixed places of the world, and edges of shadows don't crawl while the eye moves.
- Several views of a frame, such as two eyes, share their cascades: spheres enclose the slices of all views.
- A map's **depth range** is bounded: rounding of depth stays a small part of a texel. What reaches above the
  range is drawn at its near plane ("pancaking", Lauritzen, Salvi and Lefohn 2011): nothing that is looked up
  is above it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from renderer.scene import Camera, Depth, Orthographic
from renderer.scene.arrays import Floats
from renderer.shadows.shadow_settings import ShadowSettings

_BORDER = 4
"""The border in texels at each side of a map, where no point is looked up: filters read it, and the middle is
moved by up to one texel."""

CASCADE_MARGIN: Final = 1 / 16
"""The border of a map at each side, in its width, where penumbras are read."""

_MAX_ROUNDING = 0.02
"""The greatest error of depths in a map, in texels. It bounds the depth range of the map."""

_DEPTH_ERROR = 2.0**-22
"""The greatest error of a depth in float32, in depth ranges: a few roundings of numbers up to 1."""

_SLICE_STEPS = 3
"""The depth range that always holds a slice, in radii: two, and one more since its lower end is at a whole
radius."""

_STEPS = 64.0
"""A radius is rounded up to this part of a power of two, so that rounding doesn't change it from frame to
frame."""


@dataclass(frozen=True, eq=False, slots=True)
class Cascade:
    """A map of a directional light.

    Attributes:
        camera: what the map is drawn with: parallel rays, from above the slice to below it.
        texel: the width of a texel in metres.
        length: the depth of the map in metres.
        inner: how far from the middle, in metres to each side, points may be that are looked up.
        shelf: a coordinate along the axis towards the light, in metres from the world's origin: above the
            slice, and far below the near plane.
        source: the tangent of half the angle that the light's source fills, of which penumbras are filtered.
    """

    camera: Camera
    texel: float
    length: float
    inner: float
    shelf: float
    source: float = 0.0

    @property
    def top(self) -> float:
        """The coordinate of the near plane along the axis towards the light, in metres from the world's
        origin."""
        return float(self.camera.rotation[2] @ self.camera.position)

    def upper_camera(self, top: float) -> Camera:
        """Return the camera for casters that reach above the map, up to `top`. What it sees is drawn at the
        near plane. It sees down to the shelf: its range may be long, and the lower end of that is coarse."""
        position = self.camera.rotation @ self.camera.position
        position[2] = top + (top - self.shelf) / 1024.0
        square = self.camera.projection
        assert isinstance(square, Orthographic)
        projection = replace(square, far=float(position[2] - self.shelf))
        return Camera(position @ self.camera.rotation, self.camera.rotation, projection)


def split_distances(near: float, far: float, count: int, split: float) -> Floats:
    """Return the distances (count + 1,) along the view between which the slices lie. With `near` at 0 or
    behind the eye, they are equally deep: there are no ratios."""
    share = np.arange(count + 1) / count
    even = near + (far - near) * share
    if near <= 0.0:
        return even
    splits: Floats = split * near * (far / near) ** share + (1.0 - split) * even
    return splits


def near_and_far(camera: Camera) -> tuple[float, float]:
    """Return the distances of the near and the far plane along the view; the latter may be infinite."""
    matrix = camera.projection.matrix
    to_near, to_far = matrix[3] - matrix[2], matrix[2]
    if camera.projection.depth is Depth.STANDARD:
        to_near, to_far = to_far, to_near
    near = to_near[3] / to_near[2]
    far = to_far[3] / to_far[2] if to_far[2] != 0.0 else np.inf
    return float(near), float(far)


def slice_corners(camera: Camera, distances: Floats) -> Floats:
    """Return the corners (d, 4, 3) of the view at distances (d,) along it, in view space."""
    matrix = camera.projection.matrix
    w = matrix[3, 3] - matrix[3, 2] * distances
    corners = np.empty((len(distances), 4, 3))
    for corner, (x, y) in enumerate(((-1, -1), (1, -1), (-1, 1), (1, 1))):
        corners[:, corner, 0] = (x * w + matrix[0, 2] * distances - matrix[0, 3]) / matrix[0, 0]
        corners[:, corner, 1] = (y * w + matrix[1, 2] * distances - matrix[1, 3]) / matrix[1, 1]
        corners[:, corner, 2] = -distances
    return corners


def enclose_slices(camera: Camera, distances: Floats) -> tuple[Floats, Floats]:
    """Return spheres around the slices between distances (d,): centres (d - 1, 3) in the world, and radii (d
    - 1,).

    A centre is on the line between the middles of the slice's two ends, where the farthest corners of both
    are equally far, or else at one of the ends.
    """
    corners = slice_corners(camera, distances)
    middles = corners.mean(1)
    squares = ((corners - middles[:, None]) ** 2).sum(2).max(1)
    first, last = middles[:-1], middles[1:]
    along = last - first
    length = (along * along).sum(1)
    share = np.clip(0.5 + 0.5 * (squares[1:] - squares[:-1]) / length, 0.0, 1.0)
    centres = first + along * share[:, None]
    ends = np.concatenate([corners[:-1], corners[1:]], axis=1)
    radii: Floats = np.sqrt(((ends - centres[:, None]) ** 2).sum(2).max(1))
    return camera.position + centres @ camera.rotation, radii


def fit_cascades(
    cameras: Sequence[Camera],
    direction: Floats,
    settings: ShadowSettings,
    top: float,
    depth: tuple[float, float],
    *,
    source: float = 0.0,
) -> list[Cascade]:
    """Return the cascades of a light along `direction` for the views of a frame.

    Args:
        top: how far against `direction` from the world's origin casters reach, in metres.
        depth: the least and the greatest distance of what parallel views may show.
        source: the tangent of half the angle that the light's source fills, of which penumbras are filtered.
    """
    spheres = []
    for camera in cameras:
        near, far = near_and_far(camera)
        if isinstance(camera.projection, Orthographic):
            near, far = max(near, depth[0]), max(min(far, depth[1]), max(near, depth[0]) + 1.0)
        else:
            far = min(far, near + settings.distance)
        distances = split_distances(near, far, settings.cascades, settings.split)
        spheres.append(enclose_slices(camera, distances))
    centres, radii = (np.stack(arrays) for arrays in zip(*spheres, strict=True))
    middle = centres.mean(0)
    radius = (np.linalg.norm(centres - middle, axis=2) + radii).max(0)
    axes = Camera.look_at((0, 0, 0), direction).rotation
    size = settings.cascade_size
    border = min(_BORDER, (size - 1) // 4)
    if source > 0.0:
        border = max(border, int(CASCADE_MARGIN * size))
    return [
        replace(_fit_cascade(centre, axes, float(slice_radius), size, border, top), source=source)
        for centre, slice_radius in zip(middle, radius, strict=True)
    ]


def _fit_cascade(centre: Floats, axes: Floats, radius: float, size: int, border: int, top: float) -> Cascade:
    step = 2.0 ** np.floor(np.log2(radius)) / _STEPS
    radius = float(np.ceil(radius / step * (1.0 + 1e-9)) * step)
    texel = 2.0 * radius / (size - 2 * border)
    position = axes @ centre
    position[:2] = np.floor(position[:2] / texel) * texel
    bottom = np.floor((position[2] - radius) / radius) * radius
    steps = max(_SLICE_STEPS + 1, np.floor(_MAX_ROUNDING * texel / (_DEPTH_ERROR * radius)))
    above = max(np.ceil(top / radius + 1e-6) * radius, bottom + radius)
    position[2] = above = min(above, bottom + steps * radius)
    length = float(above - bottom)
    projection = Orthographic(height=size * texel, aspect=1.0, near=0.0, far=length)
    inner = 0.5 * size * texel - max(border - 1, 0) * texel
    shelf = float(bottom + max(_SLICE_STEPS, steps // 2) * radius)
    return Cascade(Camera(position @ axes, axes, projection), texel, length, inner, shelf)
