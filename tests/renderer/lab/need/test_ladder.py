"""The ladder of scenes: each effect that a scene lacks costs nothing, and removing it takes exactly what it added."""

from __future__ import annotations

import gc
from collections import Counter
from dataclasses import replace
from functools import cache
from typing import Any

import pytest

import rhi
from renderer.frame import Effect, Needs, find_needs
from renderer.lab.need import LADDER, Ascent, compare, count_need, count_rung, find_rungs, remove_rung
from renderer.lab.need.counting import POOLS, CountedFrame, count_calls, count_frame, find_faults, watch_calls
from rhi import Op
from rhi.testing import assert_free, assert_same, expect

NAMES = [rung.name for rung in LADDER]


@cache
def remove(number: int) -> tuple[CountedFrame, CountedFrame]:
    return remove_rung(number)


@pytest.mark.parametrize("name", [rung.name for rung in LADDER if rung.footprint is not None])
def test_a_scene_without_an_effect_has_no_command_of_it(name: str) -> None:
    number = NAMES.index(name)
    never, removed = remove(number)
    effect = LADDER[number].footprint
    assert effect is not None
    assert_free(effect, never.commands.stream, control=removed.commands.stream)
    assert_free(effect, removed.commands)


@pytest.mark.parametrize("name", NAMES[1:])
def test_a_frame_without_an_effect_is_that_of_a_scene_that_never_had_it(name: str) -> None:
    number = NAMES.index(name)
    never, removed = remove(number)
    assert_same(never.commands, removed.commands, what=f"frames that never had {name} and that have it no more")
    left, _ = compare(never, removed)
    assert find_faults(number, never, removed, left) == []
    made = removed.commands.stream.filter(Op.CREATE_PROGRAM)
    assert left.device_calls <= 4 * len(made)  # two for each program that was compiled, twice a frame


LATER = [rung.name for rung in LADDER if rung.switch is not None and rung.name not in ("msaa", "overlay")]
SWITCHED = [name for name in LATER if name != "fxaa"]
"""What is switched at run time by itself: several samples take the place of FXAA, and the overlay shows what was drawn
in frames before."""


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "other"), [(one, two) for one in SWITCHED for two in LATER if NAMES.index(one) < NAMES.index(two)]
)
def test_an_effect_that_is_removed_beside_a_later_one_leaves_nothing_behind(name: str, other: str) -> None:
    """A later effect may have parts of the footprint, so the two frames are compared alone; shadow maps that are left
    may lie elsewhere in their atlas."""
    number = NAMES.index(name)
    never, removed = remove_rung(number, NAMES.index(other) + 1)
    left, _ = compare(never, removed)
    assert Counter(one.op for one in never.commands) == Counter(one.op for one in removed.commands)
    assert left.calls == 0, (never.called - removed.called, removed.called - never.called)
    assert set(left.held) <= POOLS, left.held


def test_haze_that_is_drawn_without_being_asked_for_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    def find_more(*given: Any, **options: Any) -> Needs:
        needs = find_needs(*given, **options)
        return replace(needs, effects=needs.effects | {Effect.HAZE})

    monkeypatch.setattr("renderer.renderer.find_needs", find_more)
    number = NAMES.index("haze")
    never, removed = remove_rung(number)
    faults = find_faults(number, never, removed, compare(never, removed)[0])
    assert [fault.partition(":")[0] for fault in faults] == [
        "a scene that never had it has commands of it",
        "a scene from which it was removed has commands of it",
    ]


@pytest.mark.parametrize("name", [NAMES[-1], "fxaa"])
def test_functions_of_an_effect_run_where_it_is(name: str) -> None:
    """With the last rung all run, but for FXAA, which several samples replace."""
    with rhi.create_device("null") as device:
        ascent = Ascent(device, NAMES.index(name) + 1)
        ascent.render(2)
        counted = count_frame(ascent)
    numbers = [number for number, rung in enumerate(LADDER) if rung.modules and rung.name != "fxaa"]
    for number in [NAMES.index(name)] if name == "fxaa" else numbers:
        assert count_calls(number, counted) > 0, NAMES[number]


def test_counts_are_the_same_each_time() -> None:
    one, other = count_rung(NAMES.index("shadow")), count_rung(NAMES.index("shadow"))
    assert one.costs == other.costs
    assert one.called == other.called
    assert_same(one.commands, other.commands)


def test_calls_are_counted_without_those_of_the_garbage_collector() -> None:
    told: list[str] = []
    called = Counter[tuple[str, str]]()

    def note(phase: str, _: dict[str, int]) -> None:
        told.append(phase)

    gc.callbacks.append(note)
    try:
        with watch_calls(called):
            kept: list[list[int]] = [[] for _ in range(100_000)]
        told.clear()
        kept += [[] for _ in range(100_000)]
    finally:
        gc.callbacks.remove(note)
    assert not [name for _, name in called if "note" in name]
    assert told, "the control: outside of the block, garbage is collected"


def test_a_row_says_what_a_rung_adds_to_the_one_before() -> None:
    assert find_rungs([]) == list(range(len(LADDER)))
    (glass,) = count_need(find_rungs(["glass"]))
    assert glass.passes == ("transparency",)
    assert glass.replaced == ()
    assert glass.added["draws"] == 1
    assert glass.added["images"] == 0
    assert glass.left is not None
    (shadow,) = count_need(find_rungs(["shadow"]))
    assert shadow.passes == ("shadow maps",)
    assert shadow.added["images"] == 2048**2 * 4
    (marble,) = count_need(find_rungs(["marble"]))
    assert marble.added["draws"] == 1, "shadow maps draw it with the others"


def test_an_empty_scene_draws_nothing_and_clears_its_image() -> None:
    counted = count_rung(0)
    assert (counted.costs.draws, counted.costs.dispatches, counted.costs.bindings) == (0, 0, 0)
    expect(counted.commands).commands(Op.BEGIN_PASS).exactly(1)
