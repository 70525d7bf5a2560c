"""Every quality setting on the exam's scenes: errors fall, or stay, from each value to the next more accurate
one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from itertools import pairwise

import pytest

import rhi
from renderer.content import load_scene
from renderer.lab.accuracy import QUALITY_SETTINGS, ErrorUnit, QualitySetting, SweepSetup, sweep_setting
from renderer.lab.accuracy.sweep import SettingBench, list_unsupported_values, prepare_scene
from renderer.lab.exam.scenes import CULLING_SCENARIOS, SIZE, Shots, along
from renderer.scene import PathFrame, Scene
from tests.renderer.conftest import open_device

SETUP = SweepSetup("", size=SIZE, rounds=1)
SCENES: dict[str, tuple[Callable[[], Scene], Callable[[Scene], Shots]]] = {
    title: (scenario.scene, scenario.shots)
    for title, scenario in CULLING_SCENARIOS.items()
    if scenario.size == SIZE
} | {
    "city:blocks=6": (lambda: load_scene("city:blocks=6"), along("ground", 600, 606, 612)),
    "hall:columns=6,flags=4,fountains=0": (
        lambda: load_scene("hall:columns=6,flags=4,fountains=0"),
        along("ground", 300, 301, 302),
    ),
    "glass": (
        lambda: load_scene("glass"),
        lambda scene: [(camera, 0.0) for camera in list(scene.views.values())[:2]],
    ),
    "terrain:cells=64,trees=8": (
        lambda: load_scene("terrain:cells=64,trees=8"),
        lambda scene: [(camera, 0.0) for camera in list(scene.views.values())[:2]],
    ),
}
"""The exam's scenes at its usual size, and those that its scenes lack: local lights, motion, glass and a
ground."""
ALIKE = {ErrorUnit.LEVELS: 5e-3}
"""What counts as staying: of images half a level in a hundredth of the pixels."""
EDGES = (
    "a smaller image is enlarged by bilinear samples, which smooth the edges of what has nothing else to show"
)
FACETS = (
    "maps with texels larger than a ball's facets cast no shadow there; "
    "finer ones shade facets at grazing angles"
)
EXCEPTIONS: Mapping[tuple[str, str], str] = {
    **{
        (setting, title): FACETS
        for setting in ("shadow_size", "shadow_cascades")
        for title in (
            "spheres that touch the near plane, to an ulp",
            "slit of a pixel",
            "objects that were visible are behind the camera",
            "a parallel projection whose near plane cuts boxes",
        )
    },
    ("scale", "everything hidden but a wall"): "an image of twice the size is rounded twice",
    ("scale", "corners where w is negative"): EDGES,
    ("scale", "two faces in one plane"): EDGES,
    ("mip_bias", "terrain:cells=64,trees=8"): "from -1 on, what is sharper flickers more",
    ("light_cutoff", "teleports"): "0.007 of a level, where filters of textures lose 5.6",
    (
        "light_test",
        "teleports",
    ): "planes leave out lights beside large clusters that vertices keep; hybrid asks both",
    ("light_test", "glass"): "the same",
    ("depth", "a parallel projection whose near plane cuts boxes"): (
        "its depth is linear, and reversed floats are dense where it is far, not where digits of a distance "
        "are lost"
    ),
}


def list_error_rises(setting: QualitySetting, errors: Mapping[str, float]) -> list[str]:
    """Return the values whose error is greater than that of the one before."""
    values, alike = list(errors), ALIKE.get(setting.unit, 0.0)
    pairs = pairwise(values)
    return [
        f"{after}: {errors[after]:.4g} after {errors[before]:.4g}"
        for before, after in pairs
        if errors[after] > errors[before] + alike
    ]


def measure(device: rhi.Device, title: str, setting: QualitySetting) -> dict[str, float]:
    """The mean error of each supported value; empty if the quality setting doesn't matter in the scene."""
    make, shots = SCENES[title]
    scene = deepcopy(make())  # the exam makes each once, and quality settings change it
    if prepare_scene(scene, setting) is not None:
        return {}
    left_out = list_unsupported_values(device, SETUP.settings, setting)
    values = [value for value in setting.values if value not in left_out]
    if len(values) < 2:
        return {}
    frames = [PathFrame(number, camera) for number, (camera, _) in enumerate(shots(scene))]
    with SettingBench(device, scene, SETUP, setting, values) as bench:
        return {value: errors.summarize()[1] for value, errors in bench.measure_errors(frames).items()}


@pytest.mark.nightly
@pytest.mark.parametrize("title", SCENES)
def test_no_error_rises_on_a_scene_of_the_exam(title: str) -> None:
    rises_by_setting, swept = {}, 0
    with open_device("gl") as device:
        for setting in QUALITY_SETTINGS.values():
            if setting.is_encoding or setting.non_monotonic_reason or setting.option:
                continue
            errors = measure(device, title, setting)
            swept += bool(errors)
            rises = list_error_rises(setting, errors)
            if rises and (setting.name, title) not in EXCEPTIONS:
                rises_by_setting[setting.name] = rises
    assert swept >= 8  # simulated objects have no reference by rays
    assert rises_by_setting == {}


def test_a_rendered_second_eye_equals_that_of_the_ray_tracer() -> None:
    """But for rounding: the greatest error of three channels is .375 of a level in the mean."""
    with open_device("gl") as device:
        errors = measure(device, "slit of a pixel", QUALITY_SETTINGS["second_eye"])
    assert errors["drawn"] < 0.45
    assert errors["reprojected"] > 0.8


@pytest.mark.parametrize(
    "setting",
    [setting for setting in QUALITY_SETTINGS.values() if setting.is_encoding],
    ids=lambda setting: setting.name,
)
@pytest.mark.usefixtures("gl")
def test_no_error_of_an_encoding_rises(setting: QualitySetting) -> None:
    report = sweep_setting(SweepSetup("", backend="gl", rounds=1), setting.name)
    assert list_error_rises(setting, {row.value: row.mean_error for row in report.rows}) == []


def test_a_rise_is_listed_and_a_small_difference_of_images_is_none() -> None:
    fxaa, tile = QUALITY_SETTINGS["fxaa"], QUALITY_SETTINGS["tile"]
    assert list_error_rises(fxaa, {"off": 1.0, "on": 1.004}) == []
    assert list_error_rises(fxaa, {"off": 1.0, "on": 1.006}) == ["on: 1.006 after 1"]
    assert list_error_rises(tile, {"64": 2.0, "32": 2.0, "16": 2.001, "8": 1.0}) == ["16: 2.001 after 2"]


def test_exceptions_name_existing_settings_and_scenes() -> None:
    assert all(
        setting in QUALITY_SETTINGS and title in SCENES and why
        for (setting, title), why in EXCEPTIONS.items()
    )
