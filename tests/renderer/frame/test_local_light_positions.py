"""Local lights on a device: where each eye sees them, and what is uploaded when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from renderer.frame.local_lights import LocalLightBuffers, SplitPosition
from renderer.frame.mirrors import split_doubles
from renderer.scene import Lights
from renderer.shaders import ViewConstants
from rhi import Op
from rhi.backends.null import NullBackend

BOTH: Final = (True, True)
PLACE: Final = SplitPosition.dtype.itemsize


def make_lights(at: tuple[float, float, float] = (0.0, 0.0, 0.0), count: int = 70) -> Lights:
    """Return local lights within 50 m of a place."""
    random, lights = np.random.default_rng(3), Lights()
    for add in (lights.add_points, lights.add_spots):
        where = np.add(at, random.uniform(-50.0, 50.0, (count, 3)))
        more = () if add == lights.add_points else ((0.0, -1.0, 0.0),)
        angles = {} if add == lights.add_points else {"inner": 0.1, "outer": 0.3}
        add(
            where,
            *more,
            range=random.uniform(1.0, 9.0, count),
            color=random.uniform(0, 1, (count, 3)),
            **angles,
        )
    lights.refresh()
    return lights


class PlacedLocalLights(LocalLightBuffers):
    """Local lights with the constants of the views of two eyes."""

    def __init__(self, device: rhi.Device) -> None:
        super().__init__(device)
        self.views = [device.uniform(describe_view(np.zeros(3))) for _ in range(2)]
        for view in self.views:
            self._resources.callback(view.destroy)

    def position(self, lights: Lights, eyes: Sequence[NDArray[np.float64]]) -> None:
        for view, eye in zip(self.views, eyes, strict=False):
            view.write(describe_view(eye))
        self.update(lights, BOTH, eyes, self.views)


def describe_view(eye: NDArray[np.float64]) -> ViewConstants:
    high, low = split_doubles(eye)
    return ViewConstants(relative_view_projection=np.eye(4), eye_high=high, eye_low=low)


def read(local_lights: LocalLightBuffers, eye: int) -> list[NDArray[Any]]:
    arrays = []
    for array in local_lights.for_eye(eye).values():
        assert array.buffer is not None
        arrays.append(array.buffer.read())
    return arrays


def check(
    local_lights: LocalLightBuffers, lights: Lights, eye: int, position: NDArray[np.float64], error: float
) -> None:
    """Check what is read of both kinds against float64."""
    expected = lights.relative_to(position)
    for array, packed in zip(read(local_lights, eye), expected.values(), strict=True):
        assert np.abs(array["position"] - packed["position"].astype(np.float64)).max() <= error
        own_fields = ("outer_versine", "direction") if packed is expected["spot"] else ()
        for name in ("range", "color", "intensity", *own_fields):
            assert np.array_equal(array[name], packed[name]), name


def test_each_eye_has_local_lights_where_they_are_for_it(drawing_device: rhi.Device) -> None:
    """Also 100 km from the origin, where a float is 8 mm off: a unit in the last place of 50 m is 4e-6 m."""
    local_lights = PlacedLocalLights(drawing_device)
    for origin in ((0.0, 0.0, 0.0), (1e5, 20.0, -1e5)):
        lights = make_lights(origin)
        eyes = [np.add(origin, (side, 1.7, 0.3)) for side in (-0.0315, 0.0315)]
        local_lights.position(lights, eyes)
        for eye, position in enumerate(eyes):
            check(local_lights, lights, eye, position, 8e-6)
        apart = read(local_lights, 0)[0]["position"] - read(local_lights, 1)[0]["position"]
        assert np.abs(apart - (0.063, 0.0, 0.0)).max() <= 1.6e-5
    local_lights.destroy()


def test_one_eye_sees_local_lights_where_the_same_eye_of_two_does(drawing_device: rhi.Device) -> None:
    """To the bit, so images don't depend on which of the CPU and a kernel has placed the local lights."""
    alone, both = LocalLightBuffers(drawing_device), PlacedLocalLights(drawing_device)
    for origin in ((0.0, 0.0, 0.0), (0.3, 0.1, 700.7), (1e5, 20.0, -1e5)):
        lights = make_lights(origin, count=500)
        eyes = [np.add(origin, (side, 1.7, 0.3)) for side in (-0.0315, 0.0315)]
        both.position(lights, eyes)
        for eye, position in enumerate(eyes):
            alone.update(lights, BOTH, [position])
            for first, two in zip(read(alone, 0), read(both, eye), strict=True):
                assert np.array_equal(first["position"], two["position"])
    alone.destroy()
    both.destroy()


def test_a_device_without_compute_gets_relative_positions() -> None:
    plain = replace(NullBackend().capabilities, compute=False)
    with rhi.create_device("null", profile=plain) as device:
        local_lights, lights = LocalLightBuffers(device), make_lights()
        eye = np.array([1.0, 2.0, 3.0])
        local_lights.update(lights, BOTH, [eye])
        check(local_lights, lights, 0, eye, 8e-6)
        local_lights.update(lights, BOTH, [eye + 1.0])
        check(local_lights, lights, 0, eye + 1.0, 8e-6)
        assert not device.stream.filter(Op.DISPATCH)
        local_lights.destroy()


def count(
    null: rhi.Device, local_lights: PlacedLocalLights, lights: Lights, *eyes: tuple[float, float, float]
) -> tuple[int, int]:
    """Return the bytes that are uploaded besides the eyes' constants, and the kernels that are run."""
    before, begin = null.statistics.upload_bytes, len(null.stream)
    lights.refresh()
    local_lights.position(lights, [np.array(eye) for eye in eyes])
    views = len(eyes) * ViewConstants.uniform_dtype.itemsize
    return null.statistics.upload_bytes - before - views, len(null.stream[begin:].filter(Op.DISPATCH))


def test_lights_are_uploaded_when_they_change_and_placed_when_eyes_move(null: rhi.Device) -> None:
    local_lights, lights = PlacedLocalLights(null), make_lights()
    left, right = (0.0, 1.0, 0.0), (0.1, 1.0, 0.0)
    count(null, local_lights, lights, left, right)
    assert count(null, local_lights, lights, left, right) == (0, 0)
    assert count(null, local_lights, lights, left, (0.2, 1.0, 0.0)) == (0, 2), "a kernel for each kind"
    assert count(null, local_lights, lights, (0.1, 1.0, 0.0), right) == (0, 2)
    lights.point["position"][7] += 1.0
    assert count(null, local_lights, lights, (0.1, 1.0, 0.0), right) == (PLACE, 2), "its place, once for both"
    lights.point["color"][7] *= 0.5
    assert count(null, local_lights, lights, (0.1, 1.0, 0.0), right) == (2 * 32, 2), "its row, for each eye"
    local_lights.destroy()


def test_an_eye_that_was_closed_sees_changed_lights(gl: rhi.Device) -> None:
    local_lights, lights = PlacedLocalLights(gl), make_lights(count=3)
    eyes = [np.zeros(3), np.ones(3)]
    local_lights.position(lights, eyes)
    lights.point["position"] += 1.0
    lights.refresh()
    local_lights.position(lights, eyes[:1])
    local_lights.position(lights, eyes)
    check(local_lights, lights, 1, eyes[1], 8e-6)
    local_lights.destroy()


def test_local_lights_that_reach_nothing_are_left_out(null: rhi.Device) -> None:
    local_lights, lights = LocalLightBuffers(null), make_lights()
    for reaching in ((False, True), (True, False), (False, False), BOTH):
        local_lights.update(lights, reaching, [np.zeros(3)])
        assert tuple(array.buffer is not None for array in local_lights.for_eye(0).values()) == reaching
    local_lights.destroy()


@pytest.mark.parametrize("count", [1, 64, 65])
def test_every_local_light_is_placed(gl: rhi.Device, count: int) -> None:
    local_lights, lights = LocalLightBuffers(gl), make_lights(count=count)
    local_lights.update(lights, BOTH, [np.array([3.0, 2.0, 1.0])])
    check(local_lights, lights, 0, np.array([3.0, 2.0, 1.0]), 8e-6)
    local_lights.destroy()
