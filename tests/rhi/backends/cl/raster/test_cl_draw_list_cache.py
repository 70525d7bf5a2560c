"""Arrays of draws find their prepared draws, whichever draws they contain in whichever order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi.backends.cl.raster import draw_list_cache
from rhi.backends.cl.raster.draw_list_cache import DrawListCache
from rhi.backends.cl.raster.draw_tables import DrawSlot, PreparedDraws
from rhi.contract.descriptors import DRAW, Primitive

Key = tuple[int, Primitive, int]
KEY: Key = (1, Primitive.TRIANGLES, 0)
OTHER: Key = (2, Primitive.TRIANGLES, 0)


class Lists:
    """A draw list cache, and the prepared draws: (first, count, base_vertex, base_instance) by number."""

    def __init__(self) -> None:
        self._lists = DrawListCache(PreparedDraws())
        self.filled: dict[int, tuple[int, ...]] = {}
        self.fails = False

    def lookup(self, draws: NDArray[Any], key: Key = KEY) -> NDArray[np.int64]:
        def fill(slot: DrawSlot, *draw: int) -> None:
            if self.fails:
                raise MemoryError
            self.filled[slot.number] = draw

        draw_list = self._lists.lookup(*key, draws, None, True, fill)
        assert [self.filled[number] for number in draw_list.prepared_indices.tolist()] == [
            draw_key(draw) for draw in draws
        ]
        return draw_list.prepared_indices


def draw_key(draw: Any) -> tuple[int, ...]:
    return int(draw["first"]), int(draw["count"]), int(draw["base_vertex"]), int(draw["base_instance"])


@pytest.fixture
def draws() -> NDArray[Any]:
    """Return draws that differ in more than their instances; base vertices may be negative."""
    rng = np.random.default_rng(0)
    rows = np.zeros(300, DRAW)
    rows["count"], rows["first"] = rng.integers(1, 9, 300), 3 * np.arange(300)
    rows["base_vertex"], rows["base_instance"] = rng.integers(-5, 5, 300), rng.integers(0, 3, 300)
    rows["instances"] = 1
    return rows


def test_draws_have_the_same_slots_in_any_array(draws: NDArray[Any]) -> None:
    lists, rng = Lists(), np.random.default_rng(1)
    slots: dict[tuple[int, ...], int] = {}
    for size in (0, 1, 40, 299, 300, 7):
        sample = draws[rng.permutation(300)[:size]]
        for draw, index in zip(sample, lists.lookup(sample).tolist(), strict=True):
            assert slots.setdefault(draw_key(draw), index) == index
    assert len(set(slots.values())) == len(slots) == 300


def test_the_number_of_instances_does_not_change_the_slot(draws: NDArray[Any]) -> None:
    lists, more = Lists(), draws.copy()
    more["instances"] = 7
    np.testing.assert_array_equal(lists.lookup(draws), lists.lookup(more))


@pytest.mark.parametrize("other", [OTHER, (1, Primitive.LINES, 0), (1, Primitive.TRIANGLES, 1)])
def test_another_key_has_other_slots(draws: NDArray[Any], other: Key) -> None:
    lists = Lists()
    assert not np.intersect1d(lists.lookup(draws), lists.lookup(draws, other)).size


def test_a_draw_that_occurs_twice_in_an_array_has_one_slot(draws: NDArray[Any]) -> None:
    twice = np.concatenate([draws, draws[::-1]])
    indices = Lists().lookup(twice)
    np.testing.assert_array_equal(indices, indices[::-1])
    assert len(np.unique(indices)) == 300


def test_draws_of_equal_hashes_have_slots_of_their_own(
    draws: NDArray[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(draw_list_cache, "_FACTORS", np.array([1, 0, 0, 0], np.uint64))
    lists = Lists()
    indices = lists.lookup(draws)
    assert len(np.unique(indices)) == 300
    np.testing.assert_array_equal(lists.lookup(draws[::-1]), indices[::-1])


def test_a_draw_list_that_failed_to_be_filled_is_filled_the_next_time(draws: NDArray[Any]) -> None:
    lists = Lists()
    lists.lookup(draws[:100])
    lists.fails = True
    with pytest.raises(MemoryError):
        lists.lookup(draws)
    lists.fails = False
    assert len(np.unique(lists.lookup(draws))) == 300


def test_an_array_keeps_its_slots_when_others_are_forgotten(
    draws: NDArray[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(draw_list_cache, "_MAX_CACHED", 310)
    prepared = PreparedDraws()
    lists = DrawListCache(prepared)
    first = lists.lookup(*KEY, draws, None, True, lambda *_: None)
    other = lists.lookup(*OTHER, draws[:50], None, True, lambda *_: None)  # too many: all is forgotten
    prepared.recycle()
    assert not np.intersect1d(first.prepared_indices, other.prepared_indices).size


@pytest.mark.parametrize("limit", [10, 310, 599, 600, 10_000])
def test_long_arrays_that_change_each_time_prepare_each_draw_once(
    draws: NDArray[Any], monkeypatch: pytest.MonkeyPatch, limit: int
) -> None:
    monkeypatch.setattr(draw_list_cache, "_MAX_CACHED", limit)
    lists = Lists()
    for hidden in range(6):
        lists.lookup(np.delete(draws, hidden))
    assert len(lists.filled) == 300


@pytest.mark.parametrize(("vertex_arrays", "count"), [(3, 900), (4, 300)])
def test_draws_of_many_vertex_arrays_are_dropped_beyond_the_limit(
    draws: NDArray[Any], monkeypatch: pytest.MonkeyPatch, vertex_arrays: int, count: int
) -> None:
    monkeypatch.setattr(draw_list_cache, "_MAX_CACHED", 310)
    prepared = PreparedDraws()
    lists = DrawListCache(prepared)
    for vertex_array in range(vertex_arrays):
        lists.lookup(vertex_array, Primitive.TRIANGLES, 0, draws, None, True, lambda *_: None)
    assert in_use(prepared) == count


def in_use(prepared: PreparedDraws) -> int:
    prepared.recycle()
    return len(prepared.draws) - len(prepared._free)


def test_prepared_draws_of_old_indices_are_dropped_by_the_first_draws_of_new_indices(
    draws: NDArray[Any],
) -> None:
    prepared = PreparedDraws()
    lists = DrawListCache(prepared)
    for version in range(5):
        lists.lookup(1, Primitive.TRIANGLES, version, draws, None, True, lambda *_: None)
        assert in_use(prepared) == 300


def test_the_draws_of_a_destroyed_vertex_array_are_dropped_and_others_stay(draws: NDArray[Any]) -> None:
    prepared = PreparedDraws()
    lists = DrawListCache(prepared)
    lists.lookup(*KEY, draws, None, True, lambda *_: None)
    remaining = lists.lookup(*OTHER, draws[:50], None, True, lambda *_: None)
    lists.forget(KEY[0])
    assert in_use(prepared) == 50
    assert lists.lookup(*OTHER, draws[:50], None, True, lambda *_: None) is remaining
    lists.forget(KEY[0])  # it has none any more
    lists.forget(OTHER[0])
    del remaining
    assert in_use(prepared) == 0
