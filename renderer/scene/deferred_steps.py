"""Simulations whose steps are noted, and taken when somebody wants to see what has come of them.

Their state is in arrays as long as nobody draws it, and then on the device that does: all steps that were
noted since are one dispatch there (`Stepping`). To see it elsewhere, it is read back.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import copy
from typing import Final, Generic, Protocol, Self, TypeVar

import numpy as np

from renderer.scene.arrays import Indices
from rhi import Device, StorageBuffer
from rhi.errors import Rule, refuse

MAX_MEMBERS: Final = 65_535
"""The most members of one simulation: each is a work-group of a dispatch."""


class DeviceState(Protocol):
    """The state of all members, on a device."""

    device: Device

    def destroy(self) -> None:
        """Destroy what it has on the device."""


H = TypeVar("H")
D = TypeVar("D", bound=DeviceState)


class DeferredSteps(ABC, Generic[H, D]):
    """The base of simulations whose state is an `H` on NumPy or a `D` on a device."""

    def __init__(self, count: int, rule: Rule) -> None:
        """Begin with `count` members; refuse by `rule` a number outside 1 to 65,535."""
        if not 1 <= count <= MAX_MEMBERS:
            refuse(rule, f"{type(self).__name__}(count=...)", count, f"1 to {MAX_MEMBERS:,}")
        self._number: Indices = np.zeros(count, np.int64)  # of the last step that was asked for
        self._due: Indices = np.zeros(count, np.int64)  # how many of the last ones weren't taken yet
        self._arrays: H = self._make_initial_state()
        self._buffers: D | None = None

    def __len__(self) -> int:
        return len(self._number)

    def __deepcopy__(self, memo: object) -> Self:
        """Return a copy with a state of its own; where this one's is on a device, that waits for it."""
        duplicate = copy(self)
        duplicate._number, duplicate._due = self._number.copy(), self._due.copy()
        duplicate._arrays, duplicate._buffers = self._read(), None
        return duplicate

    def step(self, members: Indices, numbers: Indices) -> None:
        """Note one more step for `members` (j,)."""
        self._number[members] = numbers
        self._due[members] += 1

    def deform(
        self,
        device: Device,
        members: Indices,
        vertices: StorageBuffer[float],
        first_vertices: Indices,
        stride: int,
        tangent: int = -1,
    ) -> None:
        """Take the steps that are due of `members` (j,) on a device, and write their vertices. What a frame
        takes is one dispatch.

        Args:
            vertices: what is drawn.
            first_vertices: (j,), the number of each member's first vertex in it.
            stride: floats from vertex to vertex.
            tangent: where a vertex's tangent begins; these simulations have none.
        """
        before = self._buffers
        if before is None or before.device is not device:
            self._buffers = self._upload(device, self._read())
            if before is not None:
                before.destroy()
        self._run(members, first_vertices, vertices, stride)
        self._due[members] = 0

    def release(self, device: Device) -> None:
        """Destroy what is on this device, if anything is: the members then are as they were at first."""
        if self._buffers is not None and self._buffers.device is device:
            self._buffers.destroy()
            self._arrays, self._buffers = self._make_initial_state(), None

    def _take_due_steps(self, members: Indices) -> None:
        """Take the steps that are due, where the state is."""
        members = members[self._due[members] > 0]
        if not len(members):
            return
        if self._buffers is not None:
            self._run(members, np.zeros(len(members), np.int64), None, 0)
        else:
            due, first = self._due[members], self._first_due_steps(members)
            for number in range(int(due.max())):
                going = due > number
                self._step(members[going], first[going] + number)
        self._due[members] = 0

    def _first_due_steps(self, members: Indices) -> Indices:
        """Return the number (j,) of the first step that is due."""
        first: Indices = self._number[members] - self._due[members] + 1
        return first

    @abstractmethod
    def _make_initial_state(self) -> H:
        """Return the state at first."""

    @abstractmethod
    def _read(self) -> H:
        """Return a copy of the state after the steps taken so far. Waits for the device that has it."""

    @abstractmethod
    def _upload(self, device: Device, state: H) -> D:
        """Return a state on a device."""

    @abstractmethod
    def _step(self, members: Indices, numbers: Indices) -> None:
        """Take the steps `numbers` (j,) of `members` (j,) in the arrays."""

    @abstractmethod
    def _run(
        self, members: Indices, first_vertices: Indices, vertices: StorageBuffer[float] | None, stride: int
    ) -> None:
        """Take the steps that are due on the device, and write `vertices` if they are given."""
