"""The state of cloths on a device, and the dispatches that advance them.

A dispatch takes as many steps as a group has turns for: llvmpipe ends the loops of a shader after 65,535 turns,
without an error, and other drivers end dispatches that take seconds. These are a hundred steps of a cloth of a few
hundred points. What a frame takes is one dispatch; only after an absence it is more.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Rows
from renderer.scene.cloth.kernels import (
    LANES,
    ClothConstants,
    ClothConstraint,
    ClothGust,
    ClothJob,
    ClothPoint,
    StepCloths,
)
from renderer.scene.cloth.reference import find_share
from renderer.scene.cloth.sheets import GRAVITY, MOST_GUSTS, Sheet, Wind
from rhi import Device, StorageBuffer
from rhi.shading import vec4

_MOST_TURNS: Final = 40_000


class ClothBuffers:
    """The state of cloths of one sheet in one wind, on a device."""

    def __init__(
        self, device: Device, sheet: Sheet, wind: Wind, points: NDArray[np.float32], speeds: NDArray[np.float32]
    ) -> None:
        """Upload the state: points and speeds (2, count, n, 3), as those of `ClothArrays`."""
        self.device = device
        self._shape = points.shape
        self._most_steps = max(_MOST_TURNS // count_turns(sheet), 1)
        self._constants = device.uniform(_make_constants(sheet, wind))
        at: Any = np.zeros(len(sheet.points), ClothPoint.dtype)
        at["start"], at["free"] = sheet.points, sheet.is_free
        at["anchor"], at["reach"] = sheet.anchors, sheet.reaches
        self._points = device.storage(ClothPoint, at, label="cloth points")
        held: Any = np.zeros(len(sheet.constraints), ClothConstraint.dtype)
        for name, value in (("a", "a"), ("b", "b"), ("distance", "length"), ("softness", "softness")):
            held[name] = sheet.constraints[value]
        self._constraints = device.storage(ClothConstraint, held, label="cloth constraints")
        self._batches = device.storage(int, sheet.batches, label="cloth batches")
        self._places = device.storage(vec4, _pad(points), label="cloth places")
        self._speeds = device.storage(vec4, _pad(speeds), label="cloth speeds")
        self._winds = device.storage(vec4, self._places.count // 2, label="cloth winds")
        self._nothing = device.storage(float, 1, label="no vertices")

    def run(
        self,
        members: Rows,
        steps: Rows,
        phases: Rows,
        begins: Rows,
        vertices: StorageBuffer[float] | None,
        stride: int,
    ) -> None:
        """Advance `members` (j,) by `steps` (j,), and write their vertices.

        Args:
            phases: those of the gusts in the first of the steps, (j, MOST_GUSTS).
            begins: (j,), the number of each member's first vertex; without `vertices` nothing is written.
            stride: floats from vertex to vertex.
        """
        jobs: Any = np.zeros(len(members), ClothJob.dtype)
        jobs["member"], jobs["first"] = members, -1
        end = int(steps.max())
        for begin in range(0, max(end, 1), self._most_steps):
            jobs["steps"] = np.clip(steps - begin, 0, self._most_steps)
            jobs["phases"] = phases + begin
            if vertices is not None and begin + self._most_steps >= end:
                jobs["first"], jobs["stride"] = stride * begins, stride
            self._dispatch(jobs, self._nothing if vertices is None else vertices)

    def _dispatch(self, jobs: NDArray[Any], vertices: StorageBuffer[float]) -> None:
        self.device.dispatch(
            self.device.program(StepCloths),
            len(jobs),
            cloth=self._constants,
            points=self._points,
            constraints=self._constraints,
            batches=self._batches,
            jobs=self.device.transient.storage(ClothJob, jobs),
            places=self._places,
            speeds=self._speeds,
            winds=self._winds,
            vertices=vertices,
        )

    def read(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return points and speeds (2, count, n, 3). Waits for the device."""
        return self._read(self._places), self._read(self._speeds)

    def read_points(self) -> NDArray[np.float32]:
        """Return the present points (count, n, 3). Waits for the device."""
        present: NDArray[np.float32] = self._read(self._places, self._places.count // 2)[0]
        return present

    def _read(self, buffer: StorageBuffer[vec4], count: int | None = None) -> NDArray[np.float32]:
        return buffer.read(0, count).reshape(-1, 4)[:, :3].reshape(-1, *self._shape[1:]).copy()

    def destroy(self) -> None:
        """Destroy the buffers."""
        self._constants.destroy()
        for one in (self._points, self._constraints, self._batches, self._places, self._speeds, self._winds):
            one.destroy()
        self._nothing.destroy()


def count_turns(sheet: Sheet) -> int:
    """Return how many turns the loops of a lane make in a step."""
    points = -(-len(sheet.points) // LANES)
    batches: int = sum(1 + -(-size // LANES) for size in np.diff(sheet.batches).tolist())
    return 1 + points * (1 + MOST_GUSTS) + sheet.sub_steps * (1 + 3 * points + batches)


def _pad(values: NDArray[np.float32]) -> NDArray[np.float32]:
    padded = np.zeros((values.size // 3, 4), np.float32)
    padded[:, :3] = values.reshape(-1, 3)
    return padded


def _make_constants(sheet: Sheet, wind: Wind) -> ClothConstants:
    length = sheet.interval / sheet.sub_steps
    calm = ClothGust(velocity=(0.0, 0.0, 0.0), along=(0.0, 0.0, 0.0))
    gusts = [ClothGust(velocity=gust.velocity, along=gust.along) for gust in wind.gusts]
    return ClothConstants(
        rows=sheet.rows,
        columns=sheet.columns,
        batches=len(sheet.batches) - 1,
        substeps=sheet.sub_steps,
        lower=sheet.lower,
        upper=sheet.upper,
        fall=(0.0, -GRAVITY * length, 0.0),
        velocity=wind.velocity,
        seconds=length * (2.0 / 3.0),
        rate=1.0 / length,
        share=float(find_share(sheet.fabric.drag, length)),
        kept=float(np.float32(1.0) - find_share(sheet.fabric.damping, length)),
        periods=wind.count_steps(sheet.interval),
        gusts=[*gusts, *[calm] * (MOST_GUSTS - len(gusts))],
    )
