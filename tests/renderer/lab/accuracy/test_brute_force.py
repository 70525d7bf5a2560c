"""The choice is near the best of all combinations, each of which is drawn, compared and timed."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from time import process_time

import numpy as np
import pytest

from renderer.content import load_scene
from renderer.lab.accuracy import SweepSetup, compute_pareto_front, sweep_setting
from renderer.lab.accuracy.choice import CombinationBench, combine, make_plain
from renderer.lab.accuracy.sweep import list_views
from renderer.settings import RenderSettings
from tests.renderer.conftest import open_device

SUN = {
    "scale": ("0.5", "0.75", "1.0", "2.0"),
    "fxaa": ("off", "on"),
    "shadow_size": ("256", "512", "1024", "2048"),
    "shadow_cascades": ("2", "3", "4"),
    "texture_filter": ("bilinear, no mip levels", "trilinear"),
}
LOCAL_LIGHTS = {
    **{setting: SUN[setting] for setting in ("scale", "fxaa", "texture_filter")},
    "local_shadow_size": ("64", "128", "256", "512"),
    "shadow_filter": ("hard", "hardware", "smooth"),
}
SCENES = {
    "city:blocks=2,shadows=1": SUN,
    "hall:columns=4,rows=2,shadows=1,lights=8": LOCAL_LIGHTS,
    "night:blocks=2,shadows=1,lights=8": SUN,
}
"""Scenes, and the values of 192 combinations for each: the hall has no sun."""
_ROUNDS = 6
_MORE = 1.1
"""Times the least error."""


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["gl", "cl"])
@pytest.mark.parametrize("name", SCENES)
def test_a_choice_is_as_accurate_as_any_combination_that_is_as_fast(name: str, backend: str) -> None:
    """Times are of the processor, in the median of all combinations' in the same round. A combination is as
    fast as a budget if its slowest round is, and one that the search has kept if its median is, or noise
    would be compared."""
    setup = SweepSetup(name, backend=backend, size=(96, 54), views=2, rounds=5, settings=RenderSettings())
    values = SCENES[name]
    with open_device(backend):
        pass
    sweeps = {setting: sweep_setting(setup, setting) for setting in values}
    reports = [
        replace(sweep, rows=tuple(row for row in sweep.rows if row.value in values[setting]))
        for setting, sweep in sweeps.items()
    ]
    front = compute_pareto_front(setup, reports)
    base, scene = make_plain(setup.settings), load_scene(setup.scene)
    everything = {
        combination: combine(base, dict(zip(values, combination, strict=True)))
        for combination in product(*values.values())
    }
    front_keys = [tuple(point.values[setting] for setting in values) for point in front]
    errors, times = {}, dict[tuple[str, ...], list[float]]()
    frames = list_views(scene, setup)
    with open_device(backend) as device, CombinationBench(device, scene, setup, list(values)) as bench:
        for turn in range(_ROUNDS):
            for combination, settings in everything.items():
                if not turn:
                    errors[combination] = max(error.total for error in bench.compare(settings, frames))
                renderer = bench.exchange(settings)
                bench.draw(renderer, settings, frames[0])
                began = process_time()
                for frame in frames[::-1]:
                    bench.draw(renderer, settings, frame)
                times.setdefault(combination, []).append(process_time() - began)
    by_round = np.array(list(times.values()))
    taken = dict(zip(times, by_round / np.median(by_round, axis=0), strict=True))
    assert len(everything) == 192
    for budget in np.quantile([np.median(samples) for samples in taken.values()], (0.25, 0.5, 0.75, 1.0)):
        sure = [errors[combination] for combination, samples in taken.items() if samples.max() <= budget]
        errors_within = [
            errors[combination] for combination in front_keys if np.median(taken[combination]) <= budget
        ]
        if sure:
            best = min(sure)
            assert errors_within, f"{budget:.2f}: nothing, where {best:.2f} levels are to be had"
            assert min(errors_within) <= _MORE * best, (
                f"{budget:.2f}: {min(errors_within):.2f} levels, where {best:.2f} are to be had"
            )
