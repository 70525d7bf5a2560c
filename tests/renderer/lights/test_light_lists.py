"""The lists of lights that reach each object, compared with a test of every pair."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from renderer.lights import lists
from renderer.lights.lists import list_lights

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
        patch.setattr(lists, "_PAIRS", pairs)
        ends, listed = list_lights(lower, upper, positions, ranges)
    wanted = [
        [
            light
            for light in range(lights)
            if sum(max(lower[box, i] - p, p - upper[box, i], 0) ** 2 for i, p in enumerate(positions[light]))
            < ranges[light] ** 2
        ]
        for box in range(boxes)
    ]
    assert [listed[a:b].tolist() for a, b in pairwise(ends)] == wanted


def test_a_light_at_its_range_from_a_box_does_not_reach_it() -> None:
    box = np.zeros((1, 3)), np.ones((1, 3))
    for distance, reached in ((2.0, []), (2.0 - 1e-9, [0])):
        _, listed = list_lights(*box, np.array([[1.0 + distance, 0.5, 0.5]]), np.array([2.0]))
        assert listed.tolist() == reached
