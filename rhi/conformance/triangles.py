"""Random triangles in clip space, what they must cover, and how deep they are: an exam of clipping and
interpolation.

- The reference is a set of lines in the window: the three edges and the near and far planes' cuts. Weights
  divided by w are linear in the window, also of a corner behind the eye (Olano and Greer 1997), so nothing
  has to be cut. Lines are computed with 64 bits of mantissa where the machine has them, and evaluated in
  float64.
- A sample farther than `MARGIN` from all lines is certain. Devices round window positions to 1/256 pixel, so
  only certain samples are checked.
- Many triangles are drawn into one target, each into a cell of its own, which a viewport and a scissor make.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rhi import BlendFunction, CullMode, DepthFunction, Device, Format, Scissor, Viewport
from rhi.conformance.shaders import Corner
from rhi.conformance.shapes import corners
from rhi.shading import NoPerspective, Shader, Struct, vec4

Floats = NDArray[np.float64]

CELL: Final = 32
"""Texels a side that a triangle is checked in."""
CELLS_PER_ROW: Final = 16
"""Cells a side of the target."""
BATCH: Final = CELLS_PER_ROW * CELLS_PER_ROW
"""Triangles that are drawn at once."""
MARGIN: Final = 1 / 256
"""Pixels that an edge may be off: positions are rounded to 1/256 pixel."""
_CENTRES: Final = np.arange(CELL) + 0.5


# -- families of triangles -----------------------------------------------------------------------------------


def at_the_eye(rng: np.random.Generator, count: int) -> Floats:
    """Corners within 1e-6 to 1 of the eye plane, before and behind it."""
    w = rng.choice([-1.0, 1.0, 1.0], (count, 3)) * 10.0 ** rng.uniform(-6, 0, (count, 3))
    x, y = rng.uniform(-2, 2, (2, count, 3)) * np.abs(w) ** rng.uniform(0, 1, (count, 1))
    z = rng.uniform(-0.5, 1.5, (count, 3)) * w
    return np.stack([x, y, z, w], -1)


def of_all_magnitudes(rng: np.random.Generator, count: int) -> Floats:
    """Corners whose distances from the eye differ by factors up to 1e5, on both sides of it."""
    scale = 10.0 ** rng.uniform(-2.5, 2.5, (count, 3, 1))
    return rng.uniform(-1, 1, (count, 3, 4)) * scale * (3, 3, 1, 1) + scale * (0, 0, 0.3, 0.5)


def through_the_near_plane(rng: np.random.Generator, count: int) -> Floats:
    """Walls and floors around the eye, in a projection with reversed depth and a near plane at 0.1."""
    points = rng.uniform(-1, 1, (count, 3, 3)) * 10.0 ** rng.uniform(-1, 2, (count, 1, 1)) + (0, 0, 0.2)
    return np.stack([points[..., 0], points[..., 1], np.full((count, 3), 0.1), points[..., 2]], -1)


def beyond_the_guard_band(rng: np.random.Generator, count: int) -> Floats:
    """Triangles in front of the eye that reach up to 1e7 times as far as the view."""
    w = 10.0 ** rng.uniform(-2, 2, (count, 3))
    positions = rng.normal(size=(count, 3, 2)) * 10.0 ** rng.uniform(0, 7, (count, 3, 1))
    z = rng.uniform(0.05, 0.95, (count, 3))
    return np.concatenate([positions * w[..., None], (z * w)[..., None], w[..., None]], -1)


def at_infinity(rng: np.random.Generator, count: int) -> Floats:
    """Corners of which some have w = 0, or a w that float32 stores with few bits."""
    triangles = of_all_magnitudes(rng, count)
    tiny = rng.choice([0.0, 1e-45, 1e-41, 1.2e-38, -1e-40], (count, 3))
    triangles[..., 3] = np.where(rng.random((count, 3)) < 0.4, tiny, triangles[..., 3])
    return triangles


def inside(rng: np.random.Generator, count: int) -> Floats:
    """Triangles of all sizes that nothing cuts, half of them with perspective."""
    return _random_positions(rng, count, 2.0 ** rng.uniform(-6, 1, (count, 1, 1)))


def of_a_pixel(rng: np.random.Generator, count: int) -> Floats:
    """Triangles of about a pixel, with steep depth."""
    return _random_positions(rng, count, rng.uniform(0.3, 3, (count, 1, 1)) * (2 / CELL))


def slivers(rng: np.random.Generator, count: int) -> Floats:
    """Triangles from 1/1000 to 1 pixel thin and up to as long as the view."""
    start, along = rng.uniform(-1, 1, (2, count, 2))
    across = np.stack([-along[:, 1], along[:, 0]], -1) / np.hypot(*along.T)[:, None]
    thin = 10.0 ** rng.uniform(-3, 0, (count, 1)) * (2 / CELL)
    flat = np.stack(
        [start, start + along, start + along * rng.uniform(-0.2, 1.2, (count, 1)) + across * thin], 1
    )
    return _finish(rng, flat)


def _random_positions(rng: np.random.Generator, count: int, size: Floats) -> Floats:
    return _finish(rng, rng.uniform(-1, 1, (count, 1, 2)) + size * rng.uniform(-1, 1, (count, 3, 2)))


def _finish(rng: np.random.Generator, flat: Floats) -> Floats:
    """Return clip positions at these places of the window, (count, 3, 2) from -1 to 1, with random depths."""
    count = len(flat)
    w = np.where(rng.random((count, 1)) < 0.5, 2.0 ** rng.uniform(-2, 2, (count, 3)), 1.0)
    z = rng.uniform(0.02, 0.98, (count, 3))
    return np.concatenate([flat * w[..., None], (z * w)[..., None], w[..., None]], -1)


Family = Callable[[np.random.Generator, int], Floats]
CUT: Final[tuple[Family, ...]] = (
    at_the_eye,
    of_all_magnitudes,
    through_the_near_plane,
    beyond_the_guard_band,
    at_infinity,
)
"""Families of triangles that reach beyond the view or the eye."""
WHOLE: Final[tuple[Family, ...]] = (inside, of_a_pixel, slivers)
"""Families of triangles that lie in the view."""


def make_triangles(family: Family, seed: int) -> Floats:
    """Return (BATCH, 3, 4) clip positions that float32 represents."""
    with np.errstate(over="ignore", under="ignore"):
        triangles = family(np.random.default_rng(seed), BATCH).astype(np.float32)
    return triangles.astype(np.float64)


# -- drawing -------------------------------------------------------------------------------------------------


class WeightedCorner(Struct):
    """The weights of three corners, with perspective and without."""

    clip: vec4
    weights: vec4
    straight: NoPerspective[vec4]


class Weights(Shader):
    """Adds one for each time that a texel is drawn, and the weights of the corners, which are their
    colors."""

    def vertex(self, v: Corner) -> WeightedCorner:
        return WeightedCorner(clip=v.position, weights=v.color, straight=v.color)

    def fragment(self, v: WeightedCorner) -> vec4:
        return vec4(1.0, v.weights.y, v.weights.z, v.straight.y)


@dataclass(frozen=True, slots=True)
class TriangleResults:
    """Results of (n,) triangles.

    Attributes:
        counts: (n, CELL, CELL), how often each texel was drawn.
        depth: (n, CELL, CELL).
        weights: (n, CELL, CELL, 3): of corners 1 and 2 with perspective, and of corner 1 without.
    """

    counts: Floats
    depth: Floats
    weights: Floats


def draw_cells(device: Device, triangles: Floats, wide: float = CELL) -> TriangleResults:
    """Draw (BATCH, 3, 4) triangles, each into its cell.

    Args:
        wide: edge length of each triangle's viewport, of which the cell is the middle.
    """
    size = CELLS_PER_ROW * CELL, CELLS_PER_ROW * CELL
    rows = corners(
        triangles.reshape(-1, 4), np.tile([(1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1)], (len(triangles), 1))
    )
    program = device.program(Weights)
    with (
        device.texture(size, Format.RGBA32F) as image,
        device.texture(size, Format.D32F) as depth,
        device.mesh(rows) as mesh,
    ):
        with (
            device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.0),
            device.states(CullMode.NONE, DepthFunction.ALWAYS, BlendFunction.ADDITIVE),
        ):
            for number in range(len(triangles)):
                x, y = number % CELLS_PER_ROW * CELL, number // CELLS_PER_ROW * CELL
                off = (CELL - wide) / 2
                with device.states(Viewport(x + off, y + off, wide, wide), Scissor(x, y, CELL, CELL)):
                    device.draw(program, mesh.view(first=3 * number, count=3))
        pixels, depths = _to_cells(image.read()), _to_cells(depth.read()[..., None])
    return TriangleResults(pixels[..., 0], depths[..., 0], pixels[..., 1:])


def _to_cells(image: NDArray[np.float32]) -> Floats:
    cells = image.reshape(CELLS_PER_ROW, CELL, CELLS_PER_ROW, CELL, -1).swapaxes(1, 2)
    return cells.reshape(BATCH, CELL, CELL, -1).astype(np.float64)


# -- reference -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TriangleReference:
    """The samples, depths and varyings that triangles must give.

    Attributes:
        visible: (n,), the numbers of the triangles that may draw something; the other arrays are about these.
        certain: (n, CELL, CELL), texels that must be drawn.
        possible: (n, CELL, CELL), texels that may be drawn.
        is_inside: (n, CELL, CELL), texels whose centre lies inside.
        depth: (n, CELL, CELL).
        weights: (n, CELL, CELL, 2): of corners 1 and 2 with perspective.
        low, high: (n,), the depths that the triangle has anywhere in the view.
        is_before_eye: (n,), whether all corners lie before the eye.
    """

    visible: NDArray[np.int64]
    certain: NDArray[np.bool_]
    possible: NDArray[np.bool_]
    is_inside: NDArray[np.bool_]
    depth: Floats
    weights: Floats
    low: Floats
    high: Floats
    is_before_eye: NDArray[np.bool_]


def compute_reference(triangles: Floats, wide: float = CELL) -> TriangleReference:
    """The expected result of (n, 3, 4) triangles in the middle of a viewport `wide` texels a side."""
    with np.errstate(all="ignore"):
        rows, near, far = _compute_planes(triangles, wide)
        lines = _measure(np.concatenate([rows, near[:, None], far[:, None]], 1))
        reach = lines[..., :1] * (0, CELL, 0, CELL) + lines[..., 1:2] * (0, 0, CELL, CELL) + lines[..., 2:]
        visible = np.flatnonzero((reach.max(2) >= -MARGIN).all(1))  # NaN is never seen
        shape = len(visible), CELL, CELL
        certain, possible, is_inside = np.ones(shape, bool), np.ones(shape, bool), np.ones(shape, bool)
        for line in np.moveaxis(lines[visible], 1, 0):
            distance = _evaluate(line)
            certain &= distance > MARGIN
            possible &= distance >= -MARGIN
            is_inside &= distance >= 0
        parts = np.stack([_evaluate(row) for row in np.moveaxis(rows[visible], 1, 0)], -1)
        weights = parts[..., 1:] / parts.sum(-1, keepdims=True)
        z, w = np.moveaxis(triangles[visible][..., 2:], -1, 0)
        whole = ((w > 0) & (z >= 0) & (z <= w)).all(1)
        low, high = np.where(whole, (z / w).min(1), 0.0), np.where(whole, (z / w).max(1), 1.0)
    return TriangleReference(
        visible, certain, possible, is_inside, _evaluate(near[visible]), weights, low, high, (w > 0).all(1)
    )


def _compute_planes(triangles: Floats, wide: float) -> tuple[Floats, Floats, Floats]:
    """Return planes in the window: (n, 3, 3) of the corners' weights divided by w, and (n, 3) of the depth,
    and of the distance from the far plane. Those of a triangle without area are NaN."""
    x, y, z, w = np.moveaxis(triangles.astype(np.longdouble), -1, 0)
    half, middle = np.longdouble(wide) / 2, np.longdouble(CELL) / 2
    window = np.stack([x * half + w * middle, -y * half + w * middle, w], -1)
    rows = np.stack([np.cross(window[:, (i + 1) % 3], window[:, (i + 2) % 3]) for i in range(3)], 1)
    area = (window[:, 0] * rows[:, 0]).sum(-1)
    rows = rows / np.where(area == 0, np.nan, area)[:, None, None]
    near, whole = (rows * z[..., None]).sum(1), (rows * w[..., None]).sum(1)
    return rows.astype(np.float64), near.astype(np.float64), (whole - near).astype(np.float64)


def _measure(lines: Floats) -> Floats:
    """Scale lines (…, 3) so that they give distances in texels. One that is parallel to the window is far
    away."""
    length = np.hypot(lines[..., 0], lines[..., 1])
    parallel = length <= np.abs(lines[..., 2]) * 1e-15
    scaled = lines / np.where(parallel, np.abs(lines[..., 2]) / 1e9, length)[..., None]
    return np.asarray(np.where(parallel[..., None] & (lines == 0), 0.0, scaled))


def _evaluate(lines: Floats) -> Floats:
    """Evaluate (n, 3) lines at the texels' centres."""
    along = lines[:, 0, None, None] * _CENTRES
    return np.asarray(along + (lines[:, 1, None, None] * _CENTRES[:, None] + lines[:, 2, None, None]))


# -- judgement -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TriangleErrors:
    """The largest distances of results from the reference.

    Attributes:
        drawn: the number of texels drawn.
        wrong: (n,), texels of each triangle that are drawn though farther than `MARGIN` outside, or not drawn
            though farther than that inside, or drawn twice.
        depth_error: of depth, at texels whose centre lies inside.
        depth_beyond: how far a depth of a drawn texel lies outside of the corners' depths.
        weight_error: of a weight with perspective, at texels whose centre lies inside.
        weight_beyond: how far a weight of a drawn texel lies outside of 0 to 1.
    """

    drawn: int
    wrong: NDArray[np.int64]
    depth_error: float
    depth_beyond: float
    weight_error: float
    weight_beyond: float


def examine(device: Device, family: Family, seed: int, wide: float = CELL) -> TriangleErrors:
    """Draw BATCH triangles of a family and compare the results with the reference; `wide` as for
    `draw_cells`."""
    triangles = make_triangles(family, seed)
    results, reference = draw_cells(device, triangles, wide), compute_reference(triangles, wide)
    wrong = (results.counts != 0).sum((1, 2))  # of those that must draw nothing
    counts, depth, weights = (
        array[reference.visible] for array in (results.counts, results.depth, results.weights)
    )
    drawn, once = counts != 0, counts == 1
    wrong[reference.visible] = (
        (drawn & ~reference.possible) | (reference.certain & ~drawn) | (drawn & ~once)
    ).sum((1, 2))
    inside, texels = once & reference.is_inside, np.nonzero(once)
    beyond = np.maximum(reference.low[texels[0]] - depth[texels], depth[texels] - reference.high[texels[0]])
    first, second, straight = weights[texels].T
    straight = np.where(
        reference.is_before_eye[texels[0]], straight, 0.5
    )  # behind the eye it may be anything
    sums = np.stack([first, second, 1 - first - second, straight])

    def worst(errors: Floats) -> float:
        return float(np.nan_to_num(errors, nan=np.inf).max(initial=0.0))

    return TriangleErrors(
        int(drawn.sum()),
        wrong,
        worst(np.abs(depth - reference.depth)[inside]),
        worst(beyond),
        worst(np.abs(weights[..., :2] - reference.weights)[inside]),
        worst(np.maximum(-sums, sums - 1)),
    )
