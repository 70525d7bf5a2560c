"""Pools, and the simulation of their surfaces: which steps are due, and where they are taken.

A step that is asked for is only noted. It is taken when somebody wants to see the water: on the device
together with all that was noted since, or on NumPy as long as there is no device. Where and when drops fall
is a hash of the pool and the step, so a pool's surface follows from the number of its step alone, once it has
forgotten how it began.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.scene.arrays import Floats, Indices, hash_to_unit
from renderer.scene.catch_up import Stepwise
from renderer.scene.deferred_steps import DeferredSteps
from renderer.scene.meshes import VERTEX, MeshBounds, MeshGeometry, list_grid_triangles
from renderer.scene.water.water_kernels import PoolBuffers, PoolConstants
from rhi import Device, StorageBuffer
from rhi.errors import refuse
from rhi.math.indexing import repeat_each

INTERVAL: Final = 1.0 / 60.0
"""The length of a step in seconds."""
GRAVITY: Final = 9.81
MAX_POINTS: Final = 16_384
FORGOTTEN_FRACTION: Final = 1e-3
"""A wave is forgotten when this fraction of it is left."""
_STEPS_PER_FRAME: Final = 2048


@dataclass(frozen=True, eq=False, slots=True)
class WaterPool:
    """A rectangular pool, whose surface at rest is y = 0, from -size / 2 to size / 2 along x and z.

    Attributes:
        size: metres along x and z.
        cells: of the grid along x and z. The error of a wave's speed falls with their squares
            (`docs/scene.md`).
        depth: of the water in metres: waves go √(9.81 depth) metres a second.
        damping: a wave is exp(-damping t / 2) of itself after t seconds. Without any, nothing is ever
            forgotten, and each missed step is taken.
        rain: drops a second.
        drop: the height in metres by which one lifts the water.
        radius: of a drop in metres.
        max_height: metres: no point is ever higher, nor lower than minus as much. Two neighbours are drawn
            with a difference of at most this: a steeper wave breaks.
        start: (rows + 1, columns + 1), the heights at first, in metres; None is flat.

    Raises:
        ValidationError `scene-bad-water`: a number that is out of range; cells so small that a wave goes
            farther than one in a step; heights of another shape or above the limit.
    """

    size: tuple[float, float] = (2.0, 2.0)
    cells: tuple[int, int] = (48, 48)
    depth: float = 0.1
    damping: float = 1.5
    rain: float = 3.0
    drop: float = 0.02
    radius: float = 0.08
    max_height: float = 0.1
    start: NDArray[Any] | None = None

    def __post_init__(self) -> None:
        for name, least, most in (
            ("size", 1e-3, 1e4),
            ("depth", 1e-6, 1e4),
            ("damping", 0.0, 1e3),
            ("rain", 0.0, 1.0 / INTERVAL),
            ("drop", 0.0, self.max_height),
            ("radius", 1e-4, 1e4),
            ("max_height", 1e-6, 1e4),
        ):
            if not (
                np.greater_equal(getattr(self, name), least) & np.less_equal(getattr(self, name), most)
            ).all():
                refuse(
                    rules.BAD_WATER, f"WaterPool({name}=...)", getattr(self, name), f"{least:g} to {most:g}"
                )
        columns, rows = self.cells
        if min(self.cells) < 2 or (columns + 1) * (rows + 1) > MAX_POINTS:
            refuse(
                rules.BAD_WATER,
                "WaterPool(cells=...)",
                self.cells,
                f"2 or more, at most {MAX_POINTS:,} points",
            )
        if self.courant_squared.sum() > 1.0:
            allowed = "cells that a wave doesn't cross in a step"
            refuse(
                rules.BAD_WATER, "WaterPool(cells=...)", self.cells, allowed, tip="take fewer, or less depth"
            )
        start = self.heights
        if start.shape != self.shape or not (np.abs(start) <= self.max_height).all():
            refuse(
                rules.BAD_WATER,
                "WaterPool(start=...)",
                f"shape {start.shape}",
                f"{self.shape}, within the limit",
            )

    @property
    def shape(self) -> tuple[int, int]:
        """The number of points along z and along x."""
        return self.cells[1] + 1, self.cells[0] + 1

    @property
    def heights(self) -> NDArray[Any]:
        """The initial heights: `start`, or flat water."""
        return np.zeros(self.shape) if self.start is None else np.asarray(self.start)

    @property
    def spacing(self) -> Floats:
        """The metres between two points along x and z: (2,)."""
        return np.divide(self.size, self.cells)

    @property
    def courant_squared(self) -> Floats:
        """The squared Courant numbers along x and z (2,): (fraction of a cell that a wave crosses in a
        step)²."""
        return GRAVITY * self.depth * (INTERVAL / self.spacing) ** 2

    @property
    def damping_factor(self) -> float:
        """The fraction of a wave that is left after a step."""
        return float(np.exp(-0.5 * self.damping * INTERVAL))

    @property
    def memory(self) -> int | None:
        """The steps after which a wave is forgotten, None for never."""
        return (
            None
            if self.damping == 0.0
            else max(int(np.ceil(np.log(FORGOTTEN_FRACTION) / np.log(self.damping_factor))), 1)
        )

    @property
    def bounds(self) -> MeshBounds:
        """The lower and the upper corner (3,) of a box that holds it at all times, for
        `SceneBuilder.add_mesh`."""
        upper = np.array([0.5 * self.size[0], self.max_height, 0.5 * self.size[1]])
        upper = np.maximum(upper, upper.astype(np.float32))  # vertices are rounded
        return -upper, upper

    def make_mesh(self) -> MeshGeometry:
        """Make the mesh of the surface at first. Texture coordinates are 0 to 1 along x and z."""
        return MeshGeometry(self.make_vertices(self.heights[None]), list_grid_triangles(*self.shape))

    def break_waves(self, heights: NDArray[Any]) -> NDArray[Any]:
        """Return `heights` (k, rows + 1, columns + 1), nearer to rest where neighbours differ by more than
        `max_height`.

        A point is at most this far from each neighbour. As heights are within the limit on both sides of
        rest, no point moves beyond rest, so a neighbour that moves as well only comes nearer.
        """
        wide = np.pad(heights, ((0, 0), (1, 1), (1, 1)), "edge")
        neighbours = (wide[:, 1:-1, :-2], wide[:, 1:-1, 2:], wide[:, :-2, 1:-1], wide[:, 2:, 1:-1])
        lowest = np.minimum.reduce(neighbours) + self.max_height
        highest = np.maximum.reduce(neighbours) - self.max_height
        limited: NDArray[Any] = np.clip(heights, highest, lowest)
        return limited

    def make_vertices(self, heights: NDArray[Any]) -> NDArray[Any]:
        """Return the vertices (k * n,) of `VERTEX` of surfaces with `heights` (k, rows + 1, columns + 1)."""
        z, x = np.meshgrid(*(np.linspace(0.0, 1.0, count) for count in self.shape), indexing="ij")
        vertices = np.zeros(heights.shape, VERTEX)
        vertices["uv"] = np.stack([x, z], axis=-1)
        vertices["position"][..., ::2] = (vertices["uv"] - 0.5) * self.size
        vertices["position"][..., 1] = self.break_waves(heights)
        slope = np.zeros((2, *heights.shape))
        slope[0, :, :, 1:-1] = (heights[:, :, 2:] - heights[:, :, :-2]) * (0.5 * self.cells[0] / self.size[0])
        slope[1, :, 1:-1] = (heights[:, 2:] - heights[:, :-2]) * (0.5 * self.cells[1] / self.size[1])
        normal = np.stack([-slope[0], np.ones(heights.shape), -slope[1]], axis=-1)
        vertices["normal"] = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        return vertices.reshape(-1)


class WaterSimulation(DeferredSteps[NDArray[np.float32], PoolBuffers]):
    """A simulation of the surfaces of `count` pools of one kind.

    A pool that wasn't seen for longer than its memory begins flat that long ago, and takes the steps since
    then: from one that was seen always it differs by at most `FORGOTTEN_FRACTION` of the highest wave. Steps
    that a frame has no time for follow in the next ones.

    Attributes:
        pool: what they are.
    """

    interval = INTERVAL

    def __init__(
        self, count: int, pool: WaterPool, *, seed: int = 0, steps_per_frame: int = _STEPS_PER_FRAME
    ) -> None:
        """Begin with all surfaces as the pool's is at first.

        Args:
            seed: drops follow from it.
            steps_per_frame: the most steps that all pools take in a frame together, at least one each.

        Raises:
            ValidationError `scene-bad-water`: a count outside 1 to 65,535.
        """
        self.pool = pool
        self._seed = seed
        super().__init__(count, rules.BAD_WATER)
        self.catch_up = Stepwise(max(steps_per_frame, count), pool.memory)
        self._is_reset: Indices = np.zeros(
            count, np.int64
        )  # 1: the first of the steps that are due begins flat

    def __deepcopy__(self, memo: object) -> Self:
        duplicate = super().__deepcopy__(memo)
        duplicate._is_reset = self._is_reset.copy()
        return duplicate

    @property
    def max_slopes(self) -> Floats:
        """The greatest slopes of a triangle along x and z (2,): neighbours differ by `max_height` at most."""
        return self.pool.max_height / self.pool.spacing

    def _make_initial_state(self) -> NDArray[np.float32]:
        """Return the heights (count, 2, rows + 1, columns + 1) at first, when the water is still: of the last
        step that was taken and the one before it, the even one first. With damping undone, the step before
        mirrors the next one."""
        heights = np.asarray(self.pool.heights, np.float64)
        before = (heights + 0.5 * self._curvature(heights[None])[0]) / self.pool.damping_factor
        is_odd = (self._number - self._due)[:, None] % 2
        layers: NDArray[Any] = np.stack([heights, before]).astype(np.float32)[(is_odd + np.arange(2)) % 2]
        return layers

    def step(self, members: Indices, numbers: Indices) -> None:
        """Note one more step for `members` (j,); one that isn't the next of a member begins flat."""
        jumped = members[numbers != self._number[members] + 1]
        self._due[jumped], self._is_reset[jumped] = 0, 1
        super().step(members, numbers)

    def vertices(self, members: Indices) -> NDArray[Any]:
        """Return the vertices of `members` (j,), one after another. Waits for the device that has them."""
        return self.pool.make_vertices(self.read()[members])

    def read(self) -> NDArray[np.float32]:
        """Return the heights (count, rows + 1, columns + 1) after all steps so far. Waits for the device that
        has them."""
        self._take_due_steps(np.arange(len(self)))
        return self._read()[np.arange(len(self)), self._number % 2]

    def _read(self) -> NDArray[np.float32]:
        heights = self._arrays.copy() if self._buffers is None else self._buffers.read()
        return heights.reshape(len(self), 2, *self.pool.shape)

    def _upload(self, device: Device, state: NDArray[np.float32]) -> PoolBuffers:
        return PoolBuffers(device, self._make_constants(), state.reshape(len(self), 2, -1))

    def _run(
        self, members: Indices, first_vertices: Indices, vertices: StorageBuffer[float] | None, stride: int
    ) -> None:
        assert self._buffers is not None
        due, numbers = self._due[members], self._number[members]
        steps = self._first_due_steps(members)[:, None] + np.arange(int(due.max(initial=0)))
        drops = self._make_drops(repeat_each(members, steps.shape[1]), steps.reshape(-1)).reshape(
            *steps.shape, 4
        )
        self._buffers.run(
            members, numbers, due, self._is_reset[members], drops, first_vertices, vertices, stride
        )
        self._is_reset[members] = 0

    def _step(self, members: Indices, numbers: Indices) -> None:
        state = self._arrays
        state[members[self._is_reset[members] == 1]] = 0.0
        self._is_reset[members] = 0
        pool, after = self.pool, numbers % 2
        bumps = self._lift(self._make_drops(members, numbers))
        now, before = state[members, 1 - after] + bumps, state[members, after] + bumps
        damping_factor = np.float32(pool.damping_factor)
        heights = (
            damping_factor * (2.0 * now + self._curvature(now)) - damping_factor * damping_factor * before
        )
        state[members, 1 - after], state[members, after] = (
            now,
            np.clip(heights, -pool.max_height, pool.max_height),
        )

    def _curvature(self, heights: NDArray[Any]) -> NDArray[Any]:
        """Return the curvature of surfaces (j, rows + 1, columns + 1), times `courant_squared`; walls
        reflect."""
        x, z = self.pool.courant_squared.astype(heights.dtype)
        wide = np.pad(heights, ((0, 0), (1, 1), (1, 1)), "reflect")
        here = 2.0 * heights
        curvature: NDArray[Any] = x * (wide[:, 1:-1, :-2] + wide[:, 1:-1, 2:] - here)
        curvature += z * (wide[:, :-2, 1:-1] + wide[:, 2:, 1:-1] - here)
        return curvature

    def _make_drops(self, members: Indices, numbers: Indices) -> NDArray[np.float32]:
        """Return the drops (j, 4) of steps: x and z from the pool's first corner, by how much they lift, and
        0."""
        key = (members.astype(np.uint64) << np.uint64(40)) + numbers.astype(np.uint64) + np.uint64(self._seed)
        falls, x, z = (hash_to_unit(key * np.uint64(3) + np.uint64(part)) for part in range(3))
        pool = self.pool
        height = np.where(falls < pool.rain * INTERVAL, pool.drop, 0.0)
        return np.stack([x * pool.size[0], z * pool.size[1], height, 0.0 * x], axis=1).astype(np.float32)

    def _lift(self, drops: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return by how much drops (j, 4) lift each point."""
        rows, columns = self.pool.shape
        spacing = self.pool.spacing.astype(np.float32)
        x, z = (
            np.arange(columns, dtype=np.float32) * spacing[0],
            np.arange(rows, dtype=np.float32)[:, None] * spacing[1],
        )
        middle = drops[:, :, None, None]
        square = ((x - middle[:, 0]) ** 2 + (z - middle[:, 1]) ** 2) / np.float32(self.pool.radius**2)
        lifted: NDArray[np.float32] = middle[:, 2] * (1.0 - square) * np.exp(-square)
        return lifted

    def _make_constants(self) -> PoolConstants:
        pool = self.pool
        rows, columns = pool.shape
        return PoolConstants(
            columns=columns,
            rows=rows,
            spacing=pool.spacing,
            courant_squared=pool.courant_squared,
            damping_factor=pool.damping_factor,
            radius=pool.radius,
            max_height=pool.max_height,
        )
