"""Sheets: what a cloth is made of, before it moves. Points are a grid; constraints keep distances between
them.

Constraints hold neighbours along rows and columns (stretch), along diagonals (shear), and points with one
between them (bending). No two constraints of a batch share a point.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from renderer.scene.arrays import Floats, Indices
from renderer.scene.meshes import VERTEX, MeshBounds, MeshGeometry, list_grid_triangles
from rhi.errors import refuse

INTERVAL: Final = 1.0 / 60.0
"""The length of a step in seconds, unless a sheet has another one."""
SUB_STEPS: Final = 8
"""The number of sub-steps of a step, unless a sheet has another one."""
MAX_SUB_STEPS: Final = 64
GRAVITY: Final = 9.81
MAX_GUSTS: Final = 4
MAX_POINTS: Final = 16_384
MAX_SPEED: Final = 1000.0
"""The greatest speed of wind in m/s."""

_STRETCH: Final = 1.01  # of the way to a pin, that a point may be away from it
_ROUNDING: Final = 2.0**-20  # of the largest coordinate: points are float32

CONSTRAINT: Final = np.dtype([("a", "<i4"), ("b", "<i4"), ("length", "<f4"), ("softness", "<f4")])
"""A constraint: the points `a` and `b` are `length` metres apart; `softness` is 0 for one that doesn't
give."""


@dataclass(frozen=True, slots=True)
class Fabric:
    """The material of a cloth.

    Attributes:
        density: in kg/m².
        stretch, shear, bend: how far constraints of each kind give, in m/N; 0 is stiff.
        drag: how fast a cloth takes the wind's speed along its normal, per second.
        damping: how fast its speed is lost, per second.
    """

    density: float = 0.25
    stretch: float = 0.0
    shear: float = 2e-3
    bend: float = 0.5
    drag: float = 6.0
    damping: float = 0.4

    def __post_init__(self) -> None:
        for name in ("density", "stretch", "shear", "bend", "drag", "damping"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1e6 or (name == "density" and value < 1e-6):
                allowed = f"from {1e-6 if name == 'density' else 0} to 10⁶"
                refuse(rules.BAD_CLOTH, f"Fabric({name}=...)", value, allowed)


@dataclass(frozen=True, slots=True)
class Gust:
    """A wave of wind that runs over a cloth.

    Attributes:
        velocity: its greatest velocity in m/s.
        along: waves per metre along each axis, in the space of the object.
        period: seconds from wave to wave, rounded to whole steps, one at least. Whole numbers keep the phase
            exact for all times.
    """

    velocity: tuple[float, float, float]
    along: tuple[float, float, float]
    period: float

    def __post_init__(self) -> None:
        _check_vector("Gust(velocity=...)", self.velocity, MAX_SPEED)
        _check_vector("Gust(along=...)", self.along, 100.0)
        if not INTERVAL <= self.period <= 1e6:
            refuse(rules.BAD_CLOTH, "Gust(period=...)", self.period, "seconds from a step to 10⁶")


@dataclass(frozen=True, slots=True)
class Wind:
    """The wind on a cloth, in the space of its object: a constant part in m/s, and up to four gusts."""

    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gusts: tuple[Gust, ...] = ()

    def __post_init__(self) -> None:
        _check_vector("Wind(velocity=...)", self.velocity, MAX_SPEED)
        if len(self.gusts) > MAX_GUSTS:
            refuse(rules.BAD_CLOTH, "Wind(gusts=...)", f"{len(self.gusts)} gusts", f"at most {MAX_GUSTS}")

    def count_steps(self, interval: float) -> Indices:
        """Return the periods (MAX_GUSTS,) in steps of `interval` seconds, 1 where there is no gust."""
        steps = [max(round(gust.period / interval), 1) for gust in self.gusts]
        return np.array([*steps, *[1] * MAX_GUSTS], np.int64)[:MAX_GUSTS]


@dataclass(frozen=True, eq=False, slots=True)
class ClothGrid:
    """A cloth at its start, made by `make_cloth_grid`; n is its number of points, row by row.

    Attributes:
        rows, columns: the size of the grid.
        points: (n, 3) float32, where the points are at first.
        is_free: (n,) bool, whether a point isn't pinned.
        anchors: (n, 3) float32, the nearest pin of each point.
        reaches: (n,) float32, how far it may be away.
        constraints: (k,) of `CONSTRAINT`, batch by batch.
        batches: (b + 1,) int32, where each begins.
        lower, upper: (3,) float32, the corners of its room, which no point ever leaves.
        fabric: what it is made of.
        sub_steps: how many of them a step has.
        interval: the length of a step in seconds.
    """

    rows: int
    columns: int
    points: NDArray[np.float32]
    is_free: NDArray[np.bool_]
    anchors: NDArray[np.float32]
    reaches: NDArray[np.float32]
    constraints: NDArray[Any]
    batches: NDArray[np.int32]
    lower: NDArray[np.float32]
    upper: NDArray[np.float32]
    fabric: Fabric
    sub_steps: int
    interval: float

    @property
    def bounds(self) -> MeshBounds:
        """The lower and the upper corner (3,) of a box that holds it at all times, for
        `SceneBuilder.add_mesh`."""
        return self.lower.astype(np.float64), self.upper.astype(np.float64)

    @property
    def diameter(self) -> float:
        """The greatest distance in metres between two states of a point."""
        return float(min(np.linalg.norm(self.upper - self.lower), 2.0 * self.reaches.max()))

    def make_mesh(self) -> MeshGeometry:
        """Make the mesh of a cloth at its start. Its front is where columns run right as rows run down;
        texture coordinates are 0 to 1 along both. Materials of cloths have two sides."""
        return MeshGeometry(
            self.make_vertices(self.points[None])[0], list_grid_triangles(self.rows, self.columns)
        )

    def make_vertices(self, points: NDArray[np.float32]) -> NDArray[Any]:
        """Return the vertices (k, n) of `VERTEX` of cloths whose points are at `points` (k, n, 3)."""
        vertices = np.zeros(points.shape[:2], VERTEX)
        vertices["position"] = points
        vertices["normal"] = compute_grid_normals(points, self.rows, self.columns)
        row, column = np.divmod(np.arange(self.rows * self.columns), self.columns)
        vertices["uv"] = np.stack([column / (self.columns - 1), row / (self.rows - 1)], axis=1)
        return vertices


def make_cloth_grid(
    points: ArrayLike,
    pinned: ArrayLike,
    *,
    flat: ArrayLike | None = None,
    fabric: Fabric | None = None,
    bounds: tuple[ArrayLike, ArrayLike] | None = None,
    sub_steps: int = SUB_STEPS,
    interval: float = INTERVAL,
) -> ClothGrid:
    """Make a sheet of a grid of points (rows, columns, 3) in metres.

    Args:
        pinned: (rows, columns) bool: the points that stay where they are, one or more.
        flat: (rows, columns, 3), where the points are when the cloth lies flat, if it hangs slack at first:
            distances are taken from there.
        fabric: what it is made of.
        bounds: the lower and the upper corner of a box that the points can't leave; it holds `points`. By
            default it is as large as the distances from pins allow. Choose it as small as the movement
            permits: it is the cloth's bounds.
        sub_steps: so many sub-steps has a step, 1 to 64, and fewer of more than 2,048 points: more of them
            stretch less and keep time better.
        interval: the length of a step in seconds, 0.001 to 0.1. Wind changes from step to step.

    Raises:
        ValidationError `scene-bad-cloth`: a grid of less than 2 × 2 points or of too many, points that aren't
            finite or coincide, no pin, a room that doesn't hold the points, no sub-step or too many, a step
            that is too long or too short.
    """
    call = "make_cloth_grid"
    grid = np.asarray(points, np.float64)
    if grid.ndim != 3 or grid.shape[2] != 3 or min(grid.shape[:2]) < 2 or grid[..., 0].size > MAX_POINTS:
        refuse(
            rules.BAD_CLOTH, call, f"shape {grid.shape}", f"(rows, columns, 3), at most {MAX_POINTS:,} points"
        )
    rest = grid if flat is None else np.asarray(flat, np.float64)
    pins = np.asarray(pinned)
    if rest.shape != grid.shape or pins.shape != grid.shape[:2] or pins.dtype != np.bool_:
        shapes = f"flat {rest.shape}, pinned {pins.shape} {pins.dtype}"
        refuse(rules.BAD_CLOTH, call, shapes, f"{grid.shape} and {grid.shape[:2]} bool")
    for name, values in (("points", grid), ("flat", rest)):
        if not (np.abs(values) <= 1e4).all():
            refuse(rules.BAD_CLOTH, f"{call}({name}=...)", "a coordinate out of range", "-10⁴ to 10⁴ m")
    if pins.all() or not pins.any():
        refuse(
            rules.BAD_CLOTH, f"{call}(pinned=...)", f"{pins.sum()} pins", "one or more, and a point without"
        )
    most = min(MAX_SUB_STEPS, SUB_STEPS * MAX_POINTS // pins.size)  # llvmpipe ends loops that turn too often
    if not 1 <= sub_steps <= most:
        refuse(rules.BAD_CLOTH, f"{call}(sub_steps=...)", sub_steps, f"1 to {most}")
    if not 0.001 <= interval <= 0.1:
        refuse(rules.BAD_CLOTH, f"{call}(interval=...)", interval, "0.001 to 0.1 s")
    rows, columns = pins.shape
    start, at = grid.reshape(-1, 3).astype(np.float32), rest.reshape(-1, 3)
    fabric = fabric or Fabric()
    constraints, batches = _list_constraints(
        at, ~pins.reshape(-1), rows, columns, fabric, interval / sub_steps
    )
    nearest, away = _nearest_pins(at, np.flatnonzero(pins.reshape(-1)))
    slack = _ROUNDING * float(np.abs(start).max())
    begin = np.linalg.norm(start.astype(np.float64) - start[nearest], axis=1)
    reaches = np.maximum(_STRETCH * away, begin + slack * (begin > 0.0)).astype(np.float32)
    wide = reaches[:, None] * (1.0 + _ROUNDING) + slack
    lower, upper = (start[nearest] - wide).min(0), (start[nearest] + wide).max(0)
    if bounds is not None:
        low, high = (np.asarray(corner, np.float64).reshape(-1) for corner in bounds)
        least, most = grid.reshape(-1, 3).min(0), grid.reshape(-1, 3).max(0)
        if not (low.shape == high.shape == (3,) and (low <= least).all() and (most <= high).all()):
            refuse(rules.BAD_CLOTH, f"{call}(bounds=...)", f"{low} to {high}", f"at least {least} to {most}")
        lower = np.minimum(np.maximum(lower, low), start.min(0))
        upper = np.maximum(np.minimum(upper, high), start.max(0))
    return ClothGrid(
        rows,
        columns,
        start,
        ~pins.reshape(-1),
        start[nearest],
        reaches,
        constraints,
        batches,
        _round(lower, -1),
        _round(upper, 1),
        fabric,
        sub_steps,
        interval,
    )


def compute_grid_normals(points: NDArray[np.float32], rows: int, columns: int) -> NDArray[np.float32]:
    """Return the unit normals (k, n, 3) float32 at the points (k, n, 3) of cloths: of the parallelogram that
    its neighbours span, +Z where they span none."""
    grid = points.reshape(len(points), rows, columns, 3)
    row, column = np.arange(rows), np.arange(columns)
    left, right = np.maximum(column - 1, 0), np.minimum(column + 1, columns - 1)
    above, below = np.maximum(row - 1, 0), np.minimum(row + 1, rows - 1)
    across, up = grid[:, :, right] - grid[:, :, left], grid[:, above] - grid[:, below]
    normal = np.cross(across, up).reshape(points.shape)
    size = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.where(size > _FLAT, normal / np.maximum(size, _FLAT), (0.0, 0.0, 1.0)).astype(np.float32)


_FLAT: Final = np.float32(1e-12)


def _list_constraints(
    at: Floats, is_free: NDArray[np.bool_], rows: int, columns: int, fabric: Fabric, seconds: float
) -> tuple[NDArray[Any], NDArray[np.int32]]:
    """List the constraints of a grid, without those between pins, stiff ones last: what is projected last
    holds best. `seconds` are those of a sub-step."""
    mass = fabric.density * _compute_area(at, rows, columns) / (rows * columns)
    parts = []
    for a, b, kind in _list_batches(np.arange(rows * columns).reshape(rows, columns)):
        pulls = is_free[a] | is_free[b]
        part = np.zeros(int(pulls.sum()), CONSTRAINT)
        part["a"], part["b"] = a[pulls], b[pulls]
        part["length"] = np.linalg.norm(at[part["a"]] - at[part["b"]], axis=1)
        part["softness"] = getattr(fabric, kind) * mass * (1.5 / seconds) ** 2
        if len(part):
            parts.append(part)
    constraints = np.concatenate([np.zeros(0, CONSTRAINT), *parts])
    if not (constraints["length"] > 0.0).all():
        refuse(rules.BAD_CLOTH, "make_cloth_grid", "points that coincide", "points apart from each other")
    return constraints, np.cumsum([0, *map(len, parts)]).astype(np.int32)


def _list_batches(corner: Indices) -> Iterator[tuple[Indices, Indices, str]]:
    """Yield the ends of the constraints of each batch, and their kind, given the numbers of the points (r,
    c)."""
    for square in (corner, corner.T):
        for part in range(4):  # from j to j + 2, and from j + 4 to j + 6: these share no point
            yield square[:, part:-2:4], square[:, part + 2 :: 4], "bend"
    for part in range(2):
        yield corner[part:-1:2, :-1], corner[part + 1 :: 2, 1:], "shear"
        yield corner[part:-1:2, 1:], corner[part + 1 :: 2, :-1], "shear"
    for square in (corner, corner.T):
        for part in range(2):
            yield square[:, part:-1:2], square[:, part + 1 :: 2], "stretch"


def _compute_area(at: Floats, rows: int, columns: int) -> float:
    """Return the area of a flat grid in m², both halves of each quad taken together."""
    grid = at.reshape(rows, columns, 3)
    diagonal, antidiagonal = grid[1:, 1:] - grid[:-1, :-1], grid[:-1, 1:] - grid[1:, :-1]
    return float(0.5 * np.linalg.norm(np.cross(diagonal, antidiagonal), axis=-1).sum())


def _nearest_pins(at: Floats, pins: Indices) -> tuple[Indices, Floats]:
    """Return the nearest of the `pins` (p,) for each point (n,), and how far away it is when the cloth lies
    flat."""
    nearest, away = np.full(len(at), pins[0]), np.full(len(at), np.inf)
    for pin in pins.tolist():
        distance = np.linalg.norm(at - at[pin], axis=1)
        nearer = distance < away
        nearest[nearer], away[nearer] = pin, distance[nearer]
    return nearest, away


def _round(corner: Floats, direction: int) -> NDArray[np.float32]:
    """Round (3,) to float32, downwards or upwards."""
    rounded = corner.astype(np.float32)
    off = (rounded > corner) if direction < 0 else (rounded < corner)
    return np.where(off, np.nextafter(rounded, np.float32(direction * np.inf)), rounded).astype(np.float32)


def _check_vector(call: str, value: Sequence[float], maximum: float) -> None:
    if len(value) != 3 or not all(-maximum <= part <= maximum for part in value):
        refuse(rules.BAD_CLOTH, call, value, f"3 numbers from {-maximum:g} to {maximum:g}")
