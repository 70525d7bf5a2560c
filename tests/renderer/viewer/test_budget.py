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
from renderer.viewer import Viewer, budget
from renderer.viewer.budget import BudgetStep, FrameBudget, load_steps, save_steps

BASE = RenderSettings().change("technique.name", "forward").change("algorithm", "frustum")
STEPS = [
    BudgetStep(BASE.change("technique.samples", samples), milliseconds, error)
    for samples, milliseconds, error in ((1, 10.0, 3.0), (2, 20.0, 2.0), (4, 40.0, 1.0))
]


def run(kept: FrameBudget, times: tuple[float, ...], frames: int = 60) -> list[int]:
    """Return the places of frames, each of which takes the time of its place."""
    places = []
    for _ in range(frames):
        places.append(kept.place)
        kept.note(times[kept.place])
    return places


@pytest.mark.parametrize(("milliseconds", "place"), [(9.0, 0), (10.0, 0), (19.9, 0), (20.0, 1), (39.0, 1), (40.0, 2)])
def test_a_budget_begins_with_the_most_accurate_settings_that_the_front_says_keep_it(
    milliseconds: float, place: int
) -> None:
    assert FrameBudget(STEPS[::-1], milliseconds).place == place


def test_slower_frames_lead_to_faster_settings_and_faster_ones_to_more_accurate_settings() -> None:
    kept = FrameBudget(STEPS, 25.0)
    assert run(kept, (15.0, 30.0, 60.0))[-1] == 0, "a view that takes half as long again"
    assert run(kept, (5.0, 10.0, 20.0))[-1] == 2, "a view that takes half as long"


def test_more_accurate_settings_need_room_in_the_budget() -> None:
    for factor, place in ((0.86, 0), (0.84, 1)):
        kept = FrameBudget(STEPS, 20.0)
        run(kept, (11.0, 22.0, 44.0))
        assert run(kept, tuple(step.milliseconds * factor for step in STEPS))[-1] == place


def test_what_settings_take_here_counts_more_than_the_front() -> None:
    kept = FrameBudget(STEPS, 25.0)
    places = run(kept, (5.0, 26.0, 30.0), 300)  # the second settings take a third more than the front says
    changes = sum(one != other for one, other in pairwise(places))
    assert (places[-1], changes) == (0, 1), "they aren't tried again while the view is the same"


def test_single_slow_frames_change_nothing_but_are_counted() -> None:
    kept = FrameBudget(STEPS, 25.0)
    for number in range(90):
        kept.note(200.0 if number % 3 == 0 else 20.0)
    assert (kept.place, kept.frames, kept.over) == (1, 90, 30)
    assert kept.describe() == "budget 25 ms: 2 of 3, 2 levels off, 33% over"


def test_a_front_is_what_was_saved(tmp_path: Path) -> None:
    save_steps(tmp_path / "front.json", STEPS)
    assert load_steps(tmp_path / "front.json") == STEPS


@pytest.mark.parametrize(
    "text", ["[]", "{}", "[1]", "nothing", '[{"milliseconds": 0.0}]', '[{"milliseconds": "fast"}]']
)
def test_a_file_without_a_front_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "front.json").write_text(text)
    with pytest.raises(rhi.ValidationError, match="visibility-bad-settings"):
        load_steps(tmp_path / "front.json")


def test_a_viewer_draws_with_the_settings_that_keep_the_budget(
    null: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer = Viewer(null, load_scene("grid:count=4"), size=(64, 48))
    stage, taken = viewer.stage, {1: 20.0, 2: 30.0, 4: 40.0}
    monkeypatch.setattr(
        budget.FrameBudget, "note", lambda self, _, note=FrameBudget.note: note(self, taken[stage.look.samples])
    )
    coarse = replace(
        STEPS[0], settings=STEPS[0].settings.change("textures", TextureSettings(filter=rhi.Filter.NEAREST))
    )
    stage.keep_budget(FrameBudget([coarse, *STEPS[1:]], 25.0))
    assert stage.look.samples == 2
    for _ in range(20):
        viewer.draw()
    assert (stage.look.samples, stage.look.settings) == (1, coarse.settings)
    assert "budget 25 ms: 1 of 3" in viewer.run("status")[0]
    viewer.run("samples 4")
    viewer.draw()
    assert (stage.budget, stage.look.samples) == (None, 4), "settings of the user's own end it"
    viewer.close()
