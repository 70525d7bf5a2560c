"""The ladder of scenes: each effect that a scene lacks costs nothing, and removing it takes exactly what it added."""

from __future__ import annotations

import gc
from collections import Counter
from functools import cache

import pytest

import rhi
from renderer.lab.need import LADDER, Ascent, compare, count_need, count_rung, find_rungs, remove_rung
from renderer.lab.need.counting import CountedFrame, count_calls, count_frame, watch_calls
from rhi import Op
from rhi.testing import assert_free, assert_same, expect

NAMES = [rung.name for rung in LADDER]
POOLS = {
    "draw arguments", "readback", "transient constants", "PixelRays", "Haze", "FogConstants", "Background", "Share",
    "SunTable",
}  # fmt: skip
"""What stays for what may come next: rings of the device, and constants of less than a kilobyte."""


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
    assert left.calls == 0, (never.called - removed.called, removed.called - never.called)
    made = removed.commands.stream.filter(Op.CREATE_PROGRAM)
    assert left.device_calls <= 4 * len(made)  # two for each program that was compiled, twice a frame
    assert count_calls(number, removed) == 0, "functions of the effect's modules still run"
    assert set(left.held) <= POOLS, left.held


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


def test_an_empty_scene_draws_nothing_and_clears_its_image() -> None:
    counted = count_rung(0)
    assert (counted.costs.draws, counted.costs.dispatches, counted.costs.bindings) == (0, 0, 0)
    expect(counted.commands).commands(Op.BEGIN_PASS).exactly(1)
