"""Lamps on a device: where each eye sees them, and what is uploaded when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from renderer.frame.lamps import ExactPlace, Lamps
from renderer.frame.mirrors import split_doubles
from renderer.scene import Lights
from renderer.shaders import ViewConstants
from rhi import Op
from rhi.backends.null import NullBackend

BOTH: Final = (True, True)
PLACE: Final = ExactPlace.dtype.itemsize


def make_lights(at: tuple[float, float, float] = (0.0, 0.0, 0.0), count: int = 70) -> Lights:
    """Return lamps within 50 m of a place."""
    random, lights = np.random.default_rng(3), Lights()
    for add in (lights.add_points, lights.add_spots):
        where = np.add(at, random.uniform(-50.0, 50.0, (count, 3)))
        more = () if add == lights.add_points else ((0.0, -1.0, 0.0),)
        angles = {} if add == lights.add_points else {"inner": 0.1, "outer": 0.3}
        add(where, *more, range=random.uniform(1.0, 9.0, count), color=random.uniform(0, 1, (count, 3)), **angles)
    lights.refresh()
    return lights


class PlacedLamps(Lamps):
    """Lamps with the constants of the views of two eyes."""

    def __init__(self, device: rhi.Device) -> None:
        super().__init__(device)
        self.views = [device.uniform(describe_view(np.zeros(3))) for _ in range(2)]
        for view in self.views:
            self._made.callback(view.destroy)

    def place(self, lights: Lights, eyes: Sequence[NDArray[np.float64]]) -> None:
        for view, eye in zip(self.views, eyes, strict=False):
            view.write(describe_view(eye))
        self.update(lights, BOTH, eyes, self.views)


def describe_view(eye: NDArray[np.float64]) -> ViewConstants:
    high, low = split_doubles(eye)
    return ViewConstants(relative_view_projection=np.eye(4), eye_high=high, eye_low=low)


def read(lamps: Lamps, eye: int) -> list[NDArray[Any]]:
    found = []
    for array in lamps.find(eye):
        assert array.buffer is not None
        found.append(array.buffer.read())
    return found


def check(lamps: Lamps, lights: Lights, eye: int, position: NDArray[np.float64], error: float) -> None:
    """Check what is read of both kinds against float64."""
    want = lights.relative_to(position)
    for found, packed in zip(read(lamps, eye), (want.point, want.spot), strict=True):
        assert np.abs(found["position"] - packed["position"].astype(np.float64)).max() <= error
        for name in ("range", "color", "intensity", *(("cos_outer", "direction") if packed is want.spot else ())):
            assert np.array_equal(found[name], packed[name]), name


def test_each_eye_has_lamps_where_they_are_for_it(drawing_device: rhi.Device) -> None:
    """Also 100 km from the origin, where a float is 8 mm off: a unit in the last place of 50 m is 4e-6 m."""
    lamps = PlacedLamps(drawing_device)
    for origin in ((0.0, 0.0, 0.0), (1e5, 20.0, -1e5)):
        lights = make_lights(origin)
        eyes = [np.add(origin, (side, 1.7, 0.3)) for side in (-0.0315, 0.0315)]
        lamps.place(lights, eyes)
        for eye, position in enumerate(eyes):
            check(lamps, lights, eye, position, 8e-6)
        apart = read(lamps, 0)[0]["position"] - read(lamps, 1)[0]["position"]
        assert np.abs(apart - (0.063, 0.0, 0.0)).max() <= 1.6e-5
    lamps.destroy()


def test_one_eye_sees_lamps_where_the_same_eye_of_two_does(drawing_device: rhi.Device) -> None:
    """To the bit, so pictures don't depend on which of the CPU and a kernel has placed the lamps."""
    alone, both = Lamps(drawing_device), PlacedLamps(drawing_device)
    for origin in ((0.0, 0.0, 0.0), (0.3, 0.1, 700.7), (1e5, 20.0, -1e5)):
        lights = make_lights(origin, count=500)
        eyes = [np.add(origin, (side, 1.7, 0.3)) for side in (-0.0315, 0.0315)]
        both.place(lights, eyes)
        for eye, position in enumerate(eyes):
            alone.update(lights, BOTH, [position])
            for one, two in zip(read(alone, 0), read(both, eye), strict=True):
                assert np.array_equal(one["position"], two["position"])
    alone.destroy()
    both.destroy()


def test_a_device_without_kernels_is_given_relative_positions() -> None:
    plain = replace(NullBackend().capabilities, compute=False)
    with rhi.create_device("null", profile=plain) as device:
        lamps, lights = Lamps(device), make_lights()
        eye = np.array([1.0, 2.0, 3.0])
        lamps.update(lights, BOTH, [eye])
        check(lamps, lights, 0, eye, 8e-6)
        lamps.update(lights, BOTH, [eye + 1.0])
        check(lamps, lights, 0, eye + 1.0, 8e-6)
        assert not device.stream.filter(Op.DISPATCH)
        lamps.destroy()


def count(null: rhi.Device, lamps: PlacedLamps, lights: Lights, *eyes: tuple[float, float, float]) -> tuple[int, int]:
    """Return the bytes that are uploaded besides the eyes' constants, and the kernels that are run."""
    before, begin = null.statistics.upload_bytes, len(null.stream)
    lights.refresh()
    lamps.place(lights, [np.array(eye) for eye in eyes])
    views = len(eyes) * ViewConstants.uniform_dtype.itemsize
    return null.statistics.upload_bytes - before - views, len(null.stream[begin:].filter(Op.DISPATCH))


def test_lights_are_uploaded_when_they_change_and_placed_when_eyes_move(null: rhi.Device) -> None:
    lamps, lights = PlacedLamps(null), make_lights()
    left, right = (0.0, 1.0, 0.0), (0.1, 1.0, 0.0)
    count(null, lamps, lights, left, right)
    assert count(null, lamps, lights, left, right) == (0, 0)
    assert count(null, lamps, lights, left, (0.2, 1.0, 0.0)) == (0, 2), "a kernel for each kind"
    assert count(null, lamps, lights, (0.1, 1.0, 0.0), right) == (0, 2)
    lights.point["position"][7] += 1.0
    assert count(null, lamps, lights, (0.1, 1.0, 0.0), right) == (PLACE, 2), "its place, once for both"
    lights.point["color"][7] *= 0.5
    assert count(null, lamps, lights, (0.1, 1.0, 0.0), right) == (2 * 32, 2), "its row, for each eye"
    lamps.destroy()


def test_an_eye_that_was_closed_sees_what_has_changed(gl: rhi.Device) -> None:
    lamps, lights = PlacedLamps(gl), make_lights(count=3)
    eyes = [np.zeros(3), np.ones(3)]
    lamps.place(lights, eyes)
    lights.point["position"] += 1.0
    lights.refresh()
    lamps.place(lights, eyes[:1])
    lamps.place(lights, eyes)
    check(lamps, lights, 1, eyes[1], 8e-6)
    lamps.destroy()


def test_lamps_that_reach_nothing_are_left_out(null: rhi.Device) -> None:
    lamps, lights = Lamps(null), make_lights()
    for reaching in ((False, True), (True, False), (False, False), BOTH):
        lamps.update(lights, reaching, [np.zeros(3)])
        assert tuple(array.buffer is not None for array in lamps.find(0)) == reaching
    lamps.destroy()


@pytest.mark.parametrize("count", [1, 64, 65])
def test_every_lamp_is_placed(gl: rhi.Device, count: int) -> None:
    lamps, lights = Lamps(gl), make_lights(count=count)
    lamps.update(lights, BOTH, [np.array([3.0, 2.0, 1.0])])
    check(lamps, lights, 0, np.array([3.0, 2.0, 1.0]), 8e-6)
    lamps.destroy()
