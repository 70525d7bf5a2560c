"""Arrays of draws find their prepared draws, whichever draws they contain in whichever order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi.backends.cl.raster import draw_lists
from rhi.backends.cl.raster.draw_lists import DrawListCache
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

    def find(self, draws: NDArray[Any], key: Key = KEY) -> NDArray[np.int64]:
        def fill(place: DrawSlot, *draw: int) -> None:
            if self.fails:
                raise MemoryError
            self.filled[place.number] = draw

        found = self._lists.find(*key, draws, None, True, fill)
        assert [self.filled[number] for number in found.places.tolist()] == [told(draw) for draw in draws]
        return found.places


def told(draw: Any) -> tuple[int, ...]:
    return int(draw["first"]), int(draw["count"]), int(draw["base_vertex"]), int(draw["base_instance"])


@pytest.fixture
def draws() -> NDArray[Any]:
    """Return draws that differ in more than their instances; base vertices may be negative."""
    rng = np.random.default_rng(0)
    made = np.zeros(300, DRAW)
    made["count"], made["first"] = rng.integers(1, 9, 300), 3 * np.arange(300)
    made["base_vertex"], made["base_instance"] = rng.integers(-5, 5, 300), rng.integers(0, 3, 300)
    made["instances"] = 1
    return made


def test_draws_have_their_places_in_any_array(draws: NDArray[Any]) -> None:
    lists, rng = Lists(), np.random.default_rng(1)
    known: dict[tuple[int, ...], int] = {}
    for size in (0, 1, 40, 299, 300, 7):
        chosen = draws[rng.permutation(300)[:size]]
        for draw, place in zip(chosen, lists.find(chosen).tolist(), strict=True):
            assert known.setdefault(told(draw), place) == place
    assert len(set(known.values())) == len(known) == 300


def test_the_number_of_instances_makes_no_other_place(draws: NDArray[Any]) -> None:
    lists, more = Lists(), draws.copy()
    more["instances"] = 7
    np.testing.assert_array_equal(lists.find(draws), lists.find(more))


@pytest.mark.parametrize("other", [OTHER, (1, Primitive.LINES, 0), (1, Primitive.TRIANGLES, 1)])
def test_another_key_makes_other_places(draws: NDArray[Any], other: Key) -> None:
    lists = Lists()
    assert not np.intersect1d(lists.find(draws), lists.find(draws, other)).size


def test_a_draw_that_stands_twice_in_an_array_has_one_place(draws: NDArray[Any]) -> None:
    twice = np.concatenate([draws, draws[::-1]])
    places = Lists().find(twice)
    np.testing.assert_array_equal(places, places[::-1])
    assert len(np.unique(places)) == 300


def test_draws_of_equal_hashes_have_places_of_their_own(draws: NDArray[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(draw_lists, "_FACTORS", np.array([1, 0, 0, 0], np.uint64))
    lists = Lists()
    places = lists.find(draws)
    assert len(np.unique(places)) == 300
    np.testing.assert_array_equal(lists.find(draws[::-1]), places[::-1])


def test_what_could_not_be_filled_is_filled_the_next_time(draws: NDArray[Any]) -> None:
    lists = Lists()
    lists.find(draws[:100])
    lists.fails = True
    with pytest.raises(MemoryError):
        lists.find(draws)
    lists.fails = False
    assert len(np.unique(lists.find(draws))) == 300


def test_an_array_keeps_its_places_when_others_are_forgotten(
    draws: NDArray[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(draw_lists, "_MAX_KNOWN", 310)
    prepared = PreparedDraws()
    lists = DrawListCache(prepared)
    first = lists.find(*KEY, draws, None, True, lambda *_: None)
    other = lists.find(*OTHER, draws[:50], None, True, lambda *_: None)  # too many: all is forgotten
    prepared.recycle()
    assert not np.intersect1d(first.places, other.places).size


def in_use(prepared: PreparedDraws) -> int:
    prepared.recycle()
    return len(prepared.draws) - len(prepared._free)


def test_the_draws_of_old_indices_are_dropped_with_the_first_of_new_ones(draws: NDArray[Any]) -> None:
    prepared = PreparedDraws()
    lists = DrawListCache(prepared)
    for version in range(5):
        lists.find(1, Primitive.TRIANGLES, version, draws, None, True, lambda *_: None)
        assert in_use(prepared) == 300


def test_the_draws_of_a_destroyed_vertex_array_are_dropped_and_others_stay(draws: NDArray[Any]) -> None:
    prepared = PreparedDraws()
    lists = DrawListCache(prepared)
    lists.find(*KEY, draws, None, True, lambda *_: None)
    kept = lists.find(*OTHER, draws[:50], None, True, lambda *_: None)
    lists.forget(KEY[0])
    assert in_use(prepared) == 50
    assert lists.find(*OTHER, draws[:50], None, True, lambda *_: None) is kept
    lists.forget(KEY[0])  # it has none any more
    lists.forget(OTHER[0])
    del kept
    assert in_use(prepared) == 0
