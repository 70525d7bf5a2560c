"""The budget of a viewer: settings follow what frames take, and don't alternate."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

import rhi
from renderer.content import load_scene
from renderer.frame import TextureSettings
from renderer.settings import RenderSettings
from renderer.viewer import Viewer, frame_budget
from renderer.viewer.frame_budget import BudgetStep, FrameBudget, load_steps, save_steps

BASE = RenderSettings().change("technique.name", "forward").change("algorithm", "frustum")
STEPS = [
    BudgetStep(BASE.change("technique.samples", samples), milliseconds, error)
    for samples, milliseconds, error in ((1, 10.0, 3.0), (2, 20.0, 2.0), (4, 40.0, 1.0))
]


def run(budget: FrameBudget, times: tuple[float, ...], frames: int = 60) -> list[int]:
    """Return the places of frames, each of which takes the time of its place."""
    step_indices = []
    for _ in range(frames):
        step_indices.append(budget.step_index)
        budget.note(times[budget.step_index])
    return step_indices


@pytest.mark.parametrize(
    ("milliseconds", "step_index"), [(9.0, 0), (10.0, 0), (19.9, 0), (20.0, 1), (39.0, 1), (40.0, 2)]
)
def test_a_budget_begins_with_the_most_accurate_settings_of_the_pareto_front_that_keep_it(
    milliseconds: float, step_index: int
) -> None:
    assert FrameBudget(STEPS[::-1], milliseconds).step_index == step_index


def test_slower_frames_lead_to_faster_settings_and_faster_ones_to_more_accurate_settings() -> None:
    budget = FrameBudget(STEPS, 25.0)
    assert run(budget, (15.0, 30.0, 60.0))[-1] == 0, "a view that takes half as long again"
    assert run(budget, (5.0, 10.0, 20.0))[-1] == 2, "a view that takes half as long"


def test_more_accurate_settings_need_room_in_the_budget() -> None:
    for factor, step_index in ((0.86, 0), (0.84, 1)):
        budget = FrameBudget(STEPS, 20.0)
        run(budget, (11.0, 22.0, 44.0))
        assert run(budget, tuple(step.milliseconds * factor for step in STEPS))[-1] == step_index


def test_times_measured_here_count_more_than_those_of_the_pareto_front() -> None:
    budget = FrameBudget(STEPS, 25.0)
    step_indices = run(
        budget, (5.0, 26.0, 30.0), 300
    )  # the second settings take a third more than the front says
    changes = sum(before != after for before, after in pairwise(step_indices))
    assert (step_indices[-1], changes) == (0, 1), "they aren't tried again while the view is the same"


def test_single_slow_frames_change_nothing_but_are_counted() -> None:
    budget = FrameBudget(STEPS, 25.0)
    for number in range(90):
        budget.note(200.0 if number % 3 == 0 else 20.0)
    assert (budget.step_index, budget.frames, budget.over) == (1, 90, 30)
    assert budget.describe() == "budget 25 ms: 2 of 3, 2 levels off, 33% over"


def test_a_pareto_front_is_loaded_as_it_was_saved(tmp_path: Path) -> None:
    save_steps(tmp_path / "pareto_front.json", STEPS)
    assert load_steps(tmp_path / "pareto_front.json") == STEPS


@pytest.mark.parametrize(
    "text", ["[]", "{}", "[1]", "nothing", '[{"milliseconds": 0.0}]', '[{"milliseconds": "fast"}]']
)
def test_a_file_without_a_pareto_front_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "pareto_front.json").write_text(text, encoding="utf-8")
    with pytest.raises(rhi.ValidationError, match="visibility-bad-settings"):
        load_steps(tmp_path / "pareto_front.json")


def test_a_viewer_draws_with_the_settings_that_keep_the_budget(
    null: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer = Viewer(null, load_scene("grid:count=4"), size=(64, 48))
    session, taken = viewer.session, {1: 20.0, 2: 30.0, 4: 40.0}
    monkeypatch.setattr(
        frame_budget.FrameBudget,
        "note",
        lambda self, _, note=FrameBudget.note: note(self, taken[session.display.samples]),
    )
    coarse = replace(
        STEPS[0], settings=STEPS[0].settings.change("textures", TextureSettings(filter=rhi.Filter.NEAREST))
    )
    session.set_budget(FrameBudget([coarse, *STEPS[1:]], 25.0))
    assert session.display.samples == 2
    for _ in range(20):
        viewer.draw()
    assert (session.display.samples, session.display.settings) == (1, coarse.settings)
    assert "budget 25 ms: 1 of 3" in viewer.run("status")[0]
    viewer.run("samples 4")
    viewer.draw()
    assert (session.budget, session.display.samples) == (None, 4), "settings of the user's own end it"
    viewer.close()
