"""The effect steps: an effect that a scene lacks costs nothing, and removing it takes away exactly what it
added."""

from __future__ import annotations

import gc
from collections import Counter
from dataclasses import replace
from functools import cache
from typing import Any

import pytest

import rhi
from renderer.frame import Effect, FrameEffects, collect_frame_effects
from renderer.lab.effect_costs import (
    EFFECT_STEPS,
    StepRenderer,
    compare_frames,
    count_effect_costs,
    count_step,
    list_steps_named,
    remove_step,
)
from renderer.lab.effect_costs.counting import (
    ALLOWED_LEFTOVERS,
    CountedFrame,
    count_calls,
    count_frame,
    count_python_calls,
    list_faults,
)
from rhi import Op
from rhi.testing import assert_free, assert_same, expect

NAMES = [step.name for step in EFFECT_STEPS]


@cache
def remove(number: int) -> tuple[CountedFrame, CountedFrame]:
    return remove_step(number)


@pytest.mark.parametrize("name", [step.name for step in EFFECT_STEPS if step.markers is not None])
def test_a_scene_without_an_effect_has_no_command_of_it(name: str) -> None:
    number = NAMES.index(name)
    never, removed = remove(number)
    effect = EFFECT_STEPS[number].markers
    assert effect is not None
    assert_free(effect, never.commands.stream, control=removed.commands.stream)
    assert_free(effect, removed.commands)


@pytest.mark.parametrize("name", NAMES[1:])
def test_a_frame_without_an_effect_is_that_of_a_scene_that_never_had_it(name: str) -> None:
    number = NAMES.index(name)
    never, removed = remove(number)
    assert_same(
        never.commands, removed.commands, description=f"frames that never had {name} and that have it no more"
    )
    leftovers, _ = compare_frames(never, removed)
    assert list_faults(number, never, removed, leftovers) == []
    created = removed.commands.stream.filter(Op.CREATE_PROGRAM)
    assert leftovers.device_calls <= 4 * len(created)  # two for each program that was compiled, twice a frame


LATER = [
    step.name for step in EFFECT_STEPS if step.switch is not None and step.name not in ("msaa", "overlay")
]
SWITCHED = [name for name in LATER if name != "fxaa"]
"""What is switched at run time by itself: several samples take the place of FXAA, and the overlay shows what
was drawn in frames before."""


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "other"),
    [(first, second) for first in SWITCHED for second in LATER if NAMES.index(first) < NAMES.index(second)],
)
def test_removing_an_effect_beside_a_later_effect_leaves_nothing_behind(name: str, other: str) -> None:
    """A later effect may match the effect pattern, so only the two frames are compared; shadow maps that are
    left may lie elsewhere in their atlas."""
    number = NAMES.index(name)
    never, removed = remove_step(number, NAMES.index(other) + 1)
    leftovers, _ = compare_frames(never, removed)
    assert Counter(command.op for command in never.commands) == Counter(
        command.op for command in removed.commands
    )
    assert leftovers.calls == 0, (
        never.call_counts - removed.call_counts,
        removed.call_counts - never.call_counts,
    )
    assert set(leftovers.allocated_bytes) <= ALLOWED_LEFTOVERS, leftovers.allocated_bytes


def test_haze_that_is_drawn_without_being_asked_for_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    def find_more(*arguments: Any, **options: Any) -> FrameEffects:
        effects = collect_frame_effects(*arguments, **options)
        return replace(effects, enabled=effects.enabled | {Effect.HAZE})

    monkeypatch.setattr("renderer.renderer.collect_frame_effects", find_more)
    number = NAMES.index("haze")
    never, removed = remove_step(number)
    faults = list_faults(number, never, removed, compare_frames(never, removed)[0])
    assert [fault.partition(":")[0] for fault in faults] == [
        "a scene that never had it has commands of it",
        "a scene from which it was removed has commands of it",
    ]


@pytest.mark.parametrize("name", [NAMES[-1], "fxaa"])
def test_functions_of_an_effect_run_where_it_is(name: str) -> None:
    """With the last effect step all run, but for FXAA, which several samples replace."""
    with rhi.create_device("null") as device:
        step_renderer = StepRenderer(device, NAMES.index(name) + 1)
        step_renderer.render(2)
        counted = count_frame(step_renderer)
    numbers = [number for number, step in enumerate(EFFECT_STEPS) if step.modules and step.name != "fxaa"]
    for number in [NAMES.index(name)] if name == "fxaa" else numbers:
        assert count_calls(number, counted) > 0, NAMES[number]


def test_counts_are_the_same_each_time() -> None:
    first, second = count_step(NAMES.index("shadow")), count_step(NAMES.index("shadow"))
    assert first.costs == second.costs
    assert first.call_counts == second.call_counts
    assert_same(first.commands, second.commands)


def test_calls_are_counted_without_those_of_the_garbage_collector() -> None:
    phases: list[str] = []
    call_counts = Counter[tuple[str, str]]()

    def note(phase: str, _: dict[str, int]) -> None:
        phases.append(phase)

    gc.callbacks.append(note)
    try:
        with count_python_calls(call_counts):
            garbage: list[list[int]] = [[] for _ in range(100_000)]
        phases.clear()
        garbage += [[] for _ in range(100_000)]
    finally:
        gc.callbacks.remove(note)
    assert not [name for _, name in call_counts if "note" in name]
    assert phases, "the control: outside of the block, garbage is collected"


def test_without_names_all_steps_are_listed() -> None:
    assert list_steps_named([]) == list(range(len(EFFECT_STEPS)))


def test_glass_adds_one_pass_and_one_draw() -> None:
    (glass,) = count_effect_costs(list_steps_named(["glass"]))
    assert (glass.passes, glass.replaced) == (("transparency",), ())
    assert (glass.added["draws"], glass.added["images"]) == (1, 0)
    assert glass.leftovers is not None


def test_a_shadow_adds_a_pass_and_the_bytes_of_its_map() -> None:
    (shadow,) = count_effect_costs(list_steps_named(["shadow"]))
    assert shadow.passes == ("shadow maps",)
    assert shadow.added["images"] == 2048**2 * 4


def test_marble_adds_one_draw_because_shadow_maps_draw_it_with_other_objects() -> None:
    (marble,) = count_effect_costs(list_steps_named(["marble"]))
    assert marble.added["draws"] == 1


def test_an_empty_scene_draws_nothing_and_clears_its_image() -> None:
    counted = count_step(0)
    assert (counted.costs.draws, counted.costs.dispatches, counted.costs.bindings) == (0, 0, 0)
    expect(counted.commands).commands(Op.BEGIN_PASS).exactly(1)
