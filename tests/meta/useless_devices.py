"""Devices of no use, and a run of the exam against each of them: what they pass says nothing about drawing.

`python useless_devices.py` prints JSON: for each device the cases that it passes, by what they ask of a
device. All devices share a process, and with it what rays have traced. A case ends at its first failure. Cases
that ask nothing of a device are measured once, on `NoDevice`, which refuses all use: what they measure is the
same on every device.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from faulty_backends import Faulty, replace_gl

import rhi
from renderer.lab.exam import Case, examine, select_cases, stop_at_first_failure
from renderer.lab.exam.case import NOTHING


class Mute(Faulty):
    """Draws do nothing. Dispatches work."""

    def draw(self, *_: object) -> None:
        pass

    def draw_indirect(self, *_: object) -> None:
        pass


class Unread(Faulty):
    """Reads return wrong data."""

    def replace(self, key: tuple[Any, ...], true: bytes) -> bytes:
        """Return other bytes, given those that are there, and where that is."""
        raise NotImplementedError

    def read_buffer(self, buffer: int, offset: int, size: int) -> bytes:
        return self.replace(("buffer", size), self._inner.read_buffer(buffer, offset, size))

    def read_texture(self, *location: Any) -> Any:
        true = self._inner.read_texture(*location)
        other = self.replace(("texture", true.shape, true.dtype), true.tobytes())
        return np.frombuffer(other, true.dtype).reshape(true.shape).copy()


class Black(Unread):
    def replace(self, _: object, true: bytes) -> bytes:
        return bytes(len(true))


class Constant(Unread):
    def replace(self, _: object, true: bytes) -> bytes:
        return b"\x3f" * len(true)  # 0.75 as a float, grey as a colour


class Random(Unread):
    def __init__(self, inner: Any) -> None:
        super().__init__(inner)
        self._rng = np.random.default_rng(0)

    def replace(self, _: object, true: bytes) -> bytes:
        return self._rng.bytes(len(true))


class OneFrameLate(Unread):
    """A read returns the data of the previous read of the same size; at first, zeros."""

    def __init__(self, inner: Any) -> None:
        super().__init__(inner)
        self._last: dict[Any, bytes] = {}

    def replace(self, key: tuple[Any, ...], true: bytes) -> bytes:
        last = self._last.get(key, bytes(len(true)))
        self._last[key] = true
        return last


DEVICES: dict[str, Callable[[Any], Any]] = {
    "none of these faults": Faulty,
    "its draws do nothing": Mute,
    "what is read is 0": Black,
    "what is read is the same everywhere": Constant,
    "what is read is late by a frame": OneFrameLate,
    "what is read is random": Random,
}


class NoDevice:
    """Raises at any use."""

    def __getattr__(self, name: str) -> Any:
        raise AssertionError(f"a case that asks nothing of a device uses its {name}")


def examine_without_device(cases: Iterable[Case]) -> list[int]:
    """Return the cases that pass, and use no device."""
    device: Any = NoDevice()
    return [case.number for case in cases if case.passes(case.measure(device))]


def examine_useless(device: Callable[[Any], Any], cases: Iterable[Case]) -> dict[str, list[int]]:
    """Return the cases that a device passes, by what they ask of it."""
    passed = defaultdict[str, list[int]](list)
    with (
        replace_gl(device),
        rhi.create_device("gl") as opened,
        np.errstate(all="ignore"),
        stop_at_first_failure(),
    ):
        for row in examine(opened, cases):
            if row.passed:
                passed[row.device_use].append(row.case)
    return passed


def examine_all() -> dict[str, dict[str, list[int]]]:
    """Return for each device the cases that it passes, by what they ask of it."""
    cases = select_cases([])
    using = [case for case in cases if case.device_use != NOTHING]
    idle = examine_without_device(case for case in cases if case.device_use == NOTHING)
    none_passed: dict[str, list[int]] = {case.device_use: [] for case in using}
    return {
        name: {**none_passed, **examine_useless(device, using), NOTHING: idle}
        for name, device in DEVICES.items()
    }


if __name__ == "__main__":
    print(json.dumps(examine_all()))
