"""The maps of point and spot lights: one for a narrow spot light, otherwise six, the faces of a cube around it.

A map sees a little more than its part of the light, so that filters find what they need at its edges: seams of a cube
don't show.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lights.rectangles import bound_cones, bound_spheres
from renderer.scene import Camera, Perspective
from renderer.scene.arrays import Floats, Rows

NEAR: Final = 1e-6
"""The near plane of maps, in ranges of their light. Reversed depth in floats is as fine wherever it is."""

WIDEST: Final = np.pi / 3
"""The largest outer half angle of a spot light that has a single map."""

_BORDER: Final = 3  # texels at each side beyond the light, which filters read
_DIRECTIONS: Final = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
FACES: Final = tuple(Camera.look_at((0, 0, 0), direction).rotation for direction in _DIRECTIONS)
"""The axes of the faces of a cube, in the order in which shaders number them."""


def is_cube(light: Any) -> bool:
    """Return whether a point or spot light has the faces of a cube for maps."""
    return "outer" not in light.dtype.names or bool(light["outer"] > WIDEST)


def find_scale(light: Any, size: int) -> float:
    """Return the texels of maps of `size` in a unit of the tangent of the angle to their axis."""
    tangent = 1.0 if is_cube(light) else max(float(np.tan(light["outer"])), 1e-4)
    return 0.5 * (size - 2 * min(_BORDER, (size - 1) // 4)) / tangent


def aim_maps(light: Any, size: int) -> list[Camera]:
    """Return the cameras of the maps of a light, each `size` texels wide."""
    lens = Perspective(
        fov=2.0 * float(np.arctan(0.5 * size / find_scale(light, size))),
        aspect=1.0,
        near=max(NEAR * float(light["range"]), 1e-30),
    )
    position = light["position"].astype(np.float64)
    if is_cube(light):
        return [Camera(position, axes, lens) for axes in FACES]
    return [Camera(position, Camera.look_at((0, 0, 0), light["direction"]).rotation, lens)]


def turn_into_quaternion(axes: Floats) -> tuple[float, float, float, float]:
    """Return the rotation (x, y, z, w) whose matrix is `axes` (3, 3)."""
    # The largest of the four is found first, so nothing is divided by a small number.
    trace = float(np.trace(axes))
    squares = np.array([*(2.0 * np.diag(axes) - trace), trace]) + 1.0
    largest = int(squares.argmax())
    root = 2.0 * np.sqrt(squares[largest])
    differences = np.array([axes[2, 1] - axes[1, 2], axes[0, 2] - axes[2, 0], axes[1, 0] - axes[0, 1]])  # 4 w (x, y, z)
    found = np.empty(4)
    if largest == 3:
        found[:3] = differences / root
    else:
        found[:3] = (axes[largest] + axes[:, largest]) / root
        found[3] = differences[largest] / root
    found[largest] = 0.25 * root
    x, y, z, w = found.tolist()
    return x, y, z, w


def find_widths(cameras: Sequence[Camera], size: tuple[int, int], lights: NDArray[Any]) -> Floats:
    """Return the widths (l,) that maps of point or spot lights should have: a texel for each pixel across the part of
    the screen that a light lights, in the view in which that is largest. A face of a cube has half of it."""
    ranges = lights["range"].astype(np.float64)
    centers, radii = lights["position"], ranges
    halves = np.full(len(lights), 0.5)
    if "outer" in (lights.dtype.names or ()):
        outer = lights["outer"].astype(np.float64)
        centers, radii = bound_cones(centers, lights["direction"].astype(np.float64), ranges, outer)
        halves = np.where(outer > WIDEST, 0.5, 1.0)
    width, height = size
    pixels = np.zeros(len(lights))
    for camera in cameras:
        sides = bound_spheres(camera, centers, radii)
        area = (sides[:, 2] - sides[:, 0]) * width * (sides[:, 3] - sides[:, 1]) * height * 0.25
        pixels = np.maximum(pixels, area)
    return np.asarray(halves * np.sqrt(pixels))


def choose_width(wanted: float, held: int | None, smallest: int, largest: int) -> int:
    """Return a power of two that is at least as wide as `wanted`. The width that a map has is kept as long as it isn't
    more than a quarter too small or too large: otherwise a light at the limit would be drawn again and again."""
    if held is not None and 0.4 * held < wanted <= 1.25 * held and smallest <= held <= largest:
        return held
    width = smallest
    while width < min(wanted, largest):
        width *= 2
    return width


def shrink(widths: dict[Any, int], counts: dict[Any, int], room: int, smallest: int) -> dict[Any, int]:
    """Return widths of maps whose squares are at most `room` together: the largest are halved first, and of these the
    last.

    Args:
        widths, counts: the width of each light's maps, and how many there are.
    """
    chosen = dict(widths)
    area = sum(counts[key] * width**2 for key, width in chosen.items())
    while area > room and (largest := max(chosen.values())) > smallest:
        for key in reversed(widths):
            if area > room and chosen[key] == largest:
                chosen[key] = largest // 2
                area -= 3 * counts[key] * chosen[key] ** 2
    return chosen


def find_shadow_boxes(lower: Floats, upper: Floats, position: Floats, reach: Floats) -> tuple[Floats, Floats]:
    """Return the boxes (k, 3) around the shadows that what is in boxes casts, each of a light at `position` (k, 3) with
    `reach` (k,).

    What is farther from the light by a factor lies in the box that is scaled by that factor from the light. Where the
    light is in a box, its shadow may be anywhere in reach.
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


def pair_by_light(ends: Rows, lights: Rows, count: int) -> list[Rows]:
    """Return, for each of `count` lights, the boxes (k,) that it reaches, given the lights of each box as
    `renderer.lights.lists.list_lights` lists them."""
    if not count:
        return []
    boxes = np.repeat(np.arange(len(ends) - 1), np.diff(ends))
    cuts = np.cumsum(np.bincount(lights, minlength=count))[:-1]
    return np.split(boxes[np.argsort(lights, kind="stable")], cuts)
