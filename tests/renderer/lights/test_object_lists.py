"""The lists of lights that reach each object, compared with a test of every pair."""

from __future__ import annotations

import tracemalloc
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from renderer.lights import object_lists
from renderer.lights.object_lists import list_lights
from renderer.scene.arrays import Floats

coordinates = st.integers(-6, 6).map(float)


@given(st.data(), st.integers(0, 6), st.integers(0, 5), st.sampled_from([1, 7, 1 << 20]))
def test_lists_hold_the_lights_whose_range_reaches_into_a_box(
    data: st.DataObject, boxes: int, lights: int, pairs: int
) -> None:
    corners = data.draw(arrays(float, (2, boxes, 3), elements=coordinates))
    positions = data.draw(arrays(float, (lights, 3), elements=coordinates))
    ranges = data.draw(arrays(float, (lights,), elements=st.integers(0, 8).map(float)))
    lower, upper = corners.min(0), corners.max(0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(object_lists, "_PAIRS", pairs)
        ends, listed = list_lights(lower, upper, positions, ranges)
    expected = [
        [
            light
            for light in range(lights)
            if sum(max(lower[box, i] - p, p - upper[box, i], 0) ** 2 for i, p in enumerate(positions[light]))
            < ranges[light] ** 2
        ]
        for box in range(boxes)
    ]
    assert [listed[a:b].tolist() for a, b in pairwise(ends)] == expected


def test_a_light_at_its_range_from_a_box_does_not_reach_it() -> None:
    box = np.zeros((1, 3)), np.ones((1, 3))
    for distance, reached in ((2.0, []), (2.0 - 1e-9, [0])):
        _, listed = list_lights(*box, np.array([[1.0 + distance, 0.5, 0.5]]), np.array([2.0]))
        assert listed.tolist() == reached


def list_by_pairs(lower: Floats, upper: Floats, positions: Floats, ranges: Floats) -> list[list[int]]:
    away = positions - np.clip(positions, lower[:, None], upper[:, None])
    return [np.flatnonzero(row).tolist() for row in (away * away).sum(-1) < ranges * ranges]


@pytest.mark.parametrize("lights", [15, 16, 17, 400])
@pytest.mark.parametrize("origin", [0.0, 1e7])
@pytest.mark.parametrize("flat", [1.0, 0.0])
def test_lists_of_groups_of_lights_are_those_of_a_test_of_all_pairs(
    lights: int, origin: float, flat: float
) -> None:
    rng = np.random.default_rng(lights)
    size = 60.0 * np.array([1.0, flat, 1.0])
    lower = rng.uniform(0.0, 1.0, (300, 3)) * size + origin
    upper = lower + rng.uniform(0.0, 9.0, (300, 3))
    lower[0], upper[0] = origin - 1e4, origin + 1e4
    positions, ranges = rng.uniform(0.0, 1.0, (lights, 3)) * size + origin, rng.uniform(0.0, 12.0, lights)
    # Half of the lights end exactly where a box begins.
    touching = rng.integers(0, 300, lights // 2)
    positions[: lights // 2] = upper[touching]
    positions[: lights // 2, 0] += np.nextafter(ranges[: lights // 2], rng.choice([0.0, 99.0], lights // 2))
    ends, listed = list_lights(lower, upper, positions, ranges)
    assert [listed[a:b].tolist() for a, b in pairwise(ends)] == list_by_pairs(lower, upper, positions, ranges)


@pytest.mark.parametrize("broken", [("positions", np.nan), ("ranges", np.nan), ("ranges", np.inf)])
def test_a_light_that_is_not_finite_hides_no_other_light(broken: tuple[str, float]) -> None:
    rng = np.random.default_rng(5)
    lower = rng.uniform(0.0, 9.0, (20, 3))
    values = {"positions": rng.uniform(0.0, 9.0, (40, 3)), "ranges": rng.uniform(0.0, 4.0, 40)}
    values[broken[0]][7] = broken[1]
    ends, listed = list_lights(lower, lower + 1.0, **values)
    assert [listed[a:b].tolist() for a, b in pairwise(ends)] == list_by_pairs(lower, lower + 1.0, **values)


def test_many_lights_are_tested_against_few_boxes_each() -> None:
    """Memory and time grow with what lights reach, not with objects times lights."""
    rng = np.random.default_rng(2)
    lower = rng.uniform(0.0, 2000.0, (2000, 3)) * (1, 0, 1)
    positions = rng.uniform(0.0, 2000.0, (2048, 3)) * (1, 0, 1)
    tracemalloc.start()
    ends, _ = list_lights(lower, lower + 5.0, positions, np.full(2048, 10.0))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert ends[-1] > 100
    assert peak < 8e6  # a test of a million pairs at a time takes 80 MB
