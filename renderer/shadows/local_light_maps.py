"""The maps of local lights: one for a narrow spot light, otherwise six, the faces of a cube around it.

A map sees a little more than its part of the light, so that filters find what they need at its edges: seams
of a cube don't show.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.light_kinds.kind import LocalLightKind
from renderer.lights.rectangles import bound_spheres
from renderer.scene import Camera, Perspective
from renderer.scene.arrays import Floats, Indices
from rhi.math.indexing import count_indices, repeat_each

NEAR: Final = 1e-6
"""The near plane of maps, in ranges of their light. Reversed depth in floats is as fine wherever it is."""

_BORDER: Final = 3  # texels at each side beyond the light, which filters read

LOCAL_MARGIN: Final = 1 / 8
"""The border of a map at each side beyond the light, in its width, where penumbras are read."""

_DIRECTIONS: Final = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
FACES: Final = tuple(Camera.look_at((0, 0, 0), direction).rotation for direction in _DIRECTIONS)
"""The axes of the faces of a cube, in the order in which shaders number them."""


def is_cube(kind: LocalLightKind, light: Any) -> bool:
    """Return whether a light has six maps, the faces of a cube: a point light, or a wide spot light."""
    return bool(np.isnan(kind.half_angle(light)))


def texels_per_tangent(kind: LocalLightKind, light: Any, size: int, *, has_penumbras: bool = False) -> float:
    """Return the number of texels, in a map of `size`, per unit of the tangent of the angle to its axis. If the
    light `has_penumbras`, filters reach as far as these may be wide."""
    half_angle = kind.half_angle(light)
    tangent = 1.0 if np.isnan(half_angle) else max(float(np.tan(half_angle)), 1e-4)
    border = min(_BORDER, (size - 1) // 4)
    if has_penumbras:
        border = max(border, int(LOCAL_MARGIN * size))
    return 0.5 * (size - 2 * border) / tangent


def map_cameras(kind: LocalLightKind, light: Any, size: int, *, has_penumbras: bool = False) -> list[Camera]:
    """Return the cameras of the maps of a light, each `size` texels wide."""
    texels = texels_per_tangent(kind, light, size, has_penumbras=has_penumbras)
    projection = Perspective(
        fov=2.0 * float(np.arctan(0.5 * size / texels)),
        aspect=1.0,
        near=max(NEAR * float(light["range"]), 1e-30),
    )
    position = light["position"].astype(np.float64)
    if is_cube(kind, light):
        return [Camera(position, axes, projection) for axes in FACES]
    return [Camera(position, Camera.look_at((0, 0, 0), light["direction"]).rotation, projection)]


def quaternion_from_axes(axes: Floats) -> tuple[float, float, float, float]:
    """Return the rotation (x, y, z, w) whose matrix is `axes` (3, 3)."""
    # The largest of the four is found first, so nothing is divided by a small number.
    trace = float(np.trace(axes))
    squares = np.array([*(2.0 * np.diag(axes) - trace), trace]) + 1.0
    max_size = int(squares.argmax())
    root = 2.0 * np.sqrt(squares[max_size])
    differences = np.array(
        [axes[2, 1] - axes[1, 2], axes[0, 2] - axes[2, 0], axes[1, 0] - axes[0, 1]]
    )  # 4 w (x, y, z)
    quaternion = np.empty(4)
    if max_size == 3:
        quaternion[:3] = differences / root
    else:
        quaternion[:3] = (axes[max_size] + axes[:, max_size]) / root
        quaternion[3] = differences[max_size] / root
    quaternion[max_size] = 0.25 * root
    x, y, z, w = quaternion.tolist()
    return x, y, z, w


def compute_map_widths(
    kind: LocalLightKind, cameras: Sequence[Camera], size: tuple[int, int], lights: NDArray[Any]
) -> Floats:
    """Return the widths (l,) that maps of lights of a kind should have: a texel for each pixel across the
    part of the screen that a light lights, in the view in which that is largest. A face of a cube has half of
    it."""
    centers, radii = kind.bounds(lights)
    halves = np.where(np.isnan(kind.half_angle(lights)), 0.5, 1.0)
    width, height = size
    pixels = np.zeros(len(lights))
    for camera in cameras:
        sides = bound_spheres(camera, centers, radii)
        area = (sides[:, 2] - sides[:, 0]) * width * (sides[:, 3] - sides[:, 1]) * height * 0.25
        pixels = np.maximum(pixels, area)
    return np.asarray(halves * np.sqrt(pixels))


def choose_width(required: float, current: int | None, min_size: int, max_size: int) -> int:
    """Return a power of two that is at least as wide as `required`. The width that a map has is kept as long
    as it isn't more than a quarter too small or too large: otherwise a light at the limit would be drawn
    again and again."""
    if current is not None and 0.4 * current < required <= 1.25 * current and min_size <= current <= max_size:
        return current
    width = min_size
    while width < min(required, max_size):
        width *= 2
    return width


def shrink(widths: dict[Any, int], counts: dict[Any, int], room: int, min_size: int) -> dict[Any, int]:
    """Return widths of maps whose squares are at most `room` together: the largest are halved first, and of
    these the last.

    Args:
        widths, counts: the width of each light's maps, and how many there are.
    """
    shrunk = dict(widths)
    area = sum(counts[key] * width**2 for key, width in shrunk.items())
    while area > room and (max_size := max(shrunk.values())) > min_size:
        for key in reversed(widths):
            if area > room and shrunk[key] == max_size:
                shrunk[key] = max_size // 2
                area -= 3 * counts[key] * shrunk[key] ** 2
    return shrunk


def shadow_boxes(lower: Floats, upper: Floats, position: Floats, reach: Floats) -> tuple[Floats, Floats]:
    """Return the bounds (k, 3) of the shadows of boxes, each lit by a light at `position` (k, 3) up to
    `reach` (k,).

    What is farther from the light by a factor lies in the box that is scaled by that factor from the light.
    Where the light is in a box, its shadow may be anywhere in reach.
    """
    low, high = position - reach[:, None], position + reach[:, None]
    nearest = np.linalg.norm(position - np.clip(position, lower, upper), axis=1)
    with np.errstate(divide="ignore"):
        factor = np.maximum(reach / nearest, 1.0)[:, None]
    with np.errstate(invalid="ignore"):
        far_lower, far_upper = position + (lower - position) * factor, position + (upper - position) * factor
    inside = ~np.isfinite(factor)
    far_lower, far_upper = np.where(inside, low, far_lower), np.where(inside, high, far_upper)
    return (
        np.maximum(np.minimum(lower, far_lower), low),
        np.minimum(np.maximum(upper, far_upper), high),
    )


def pair_by_light(ends: Indices, lights: Indices, count: int) -> list[Indices]:
    """Return the indices (k,) of the boxes that each of `count` lights reaches: the lists of
    `renderer.lights.object_lists.list_lights` the other way round."""
    if not count:
        return []
    boxes = repeat_each(np.arange(len(ends) - 1), np.diff(ends))
    cuts = np.cumsum(count_indices(lights, minlength=count))[:-1]
    return np.split(boxes[np.argsort(lights, kind="stable")], cuts)
