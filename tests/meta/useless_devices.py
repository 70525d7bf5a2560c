"""Devices of no use, and a run of the exam against each of them: what they pass says nothing about drawing.

`python useless_devices.py` prints JSON: for each device the cases that it passes, by what they ask of a
device.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
from faulty_backends import Faulty, replace_gl

import rhi
from renderer.lab.exam import examine, select_cases


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


def examine_useless(device: Callable[[Any], Any]) -> dict[str, list[int]]:
    """Return the cases that a device passes, by what they ask of it."""
    cases = select_cases([])
    passed: dict[str, list[int]] = {case.device_use: [] for case in cases}
    with replace_gl(device), rhi.create_device("gl") as opened, np.errstate(all="ignore"):
        for case, row in zip(cases, examine(opened, cases), strict=True):
            if row.passed:
                passed[case.device_use].append(case.number)
    return passed


if __name__ == "__main__":
    print(json.dumps({name: examine_useless(device) for name, device in DEVICES.items()}))
