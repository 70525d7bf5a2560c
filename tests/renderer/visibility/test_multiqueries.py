"""The number of hidden nodes that share a query (CHC++, section 5)."""

from __future__ import annotations

from math import exp, prod

import pytest
from hypothesis import given
from hypothesis import strategies as st

from renderer.visibility.queries.chc_plus_plus import STAY_HIDDEN_PROBABILITIES, choose_group_size


@pytest.mark.parametrize(("frames", "size"), [(1, 3), (2, 4), (3, 5), (4, 7), (5, 9), (15, 11), (100, 11)])
def test_nodes_hidden_for_so_many_frames_are_asked_for_so_many_at_a_time(frames: int, size: int) -> None:
    keep = STAY_HIDDEN_PROBABILITIES[min(frames, len(STAY_HIDDEN_PROBABILITIES) - 1)]
    assert keep == pytest.approx(0.99 - 0.7 * exp(-frames), abs=1e-6)
    assert choose_group_size([keep] * 40) == size


def test_a_node_that_has_just_become_hidden_is_asked_for_alone() -> None:
    assert choose_group_size([STAY_HIDDEN_PROBABILITIES[0]] * 40) == 1


def test_unlikely_nodes_are_not_added_to_likely_ones() -> None:
    assert choose_group_size([STAY_HIDDEN_PROBABILITIES[15]] * 3 + [STAY_HIDDEN_PROBABILITIES[0]] * 3) == 3


@given(st.lists(st.sampled_from(STAY_HIDDEN_PROBABILITIES), min_size=1, max_size=30))
def test_one_node_more_or_less_is_never_worth_more(keeps: list[float]) -> None:
    keeps.sort(reverse=True)

    def value(size: int) -> float:
        return 1.0 if size == 1 else size / (1.0 + (1.0 - prod(keeps[:size])) * size)

    size = choose_group_size(keeps)
    assert 1 <= size <= len(keeps)
    assert all(value(other) <= value(size) + 1e-12 for other in range(1, min(size + 2, len(keeps) + 1)))
