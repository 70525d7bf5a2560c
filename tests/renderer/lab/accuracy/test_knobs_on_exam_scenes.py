"""Every knob on the exam's scenes: errors fall, or stay, from each value to the next more accurate one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from itertools import pairwise

import pytest

import rhi
from renderer.content import load_scene
from renderer.lab.accuracy import KNOBS, Knob, Situation, Unit, sweep_knob
from renderer.lab.accuracy.sweep import KnobBench, list_left_out, prepare_scene
from renderer.lab.exam.scenes import IMAGES, SIZE, Shots, along
from renderer.scene import Scene, Shot
from tests.renderer.conftest import open_device

SITUATION = Situation("", size=SIZE, rounds=1)
SCENES: dict[str, tuple[Callable[[], Scene], Callable[[Scene], Shots]]] = {
    title: (image.scene, image.shots) for title, image in IMAGES.items() if image.size == SIZE
} | {
    "city:blocks=6": (lambda: load_scene("city:blocks=6"), along("ground", 600, 606, 612)),
    "hall:columns=6,flags=4,fountains=0": (
        lambda: load_scene("hall:columns=6,flags=4,fountains=0"), along("ground", 300, 301, 302),
    ),
    "glass": (lambda: load_scene("glass"), lambda scene: [(camera, 0.0) for camera in list(scene.views.values())[:2]]),
    "terrain:cells=64,trees=8": (
        lambda: load_scene("terrain:cells=64,trees=8"),
        lambda scene: [(camera, 0.0) for camera in list(scene.views.values())[:2]],
    ),
}  # fmt: skip
"""The exam's scenes at its usual size, and those that its scenes lack: lamps, motion, glass and a ground."""
ALIKE = {Unit.LEVELS: 5e-3}
"""What counts as staying: of pictures half a level in a hundredth of the pixels."""
EDGES = "a smaller picture is enlarged by bilinear samples, which smooth the edges of what has nothing else to show"
FACETS = "maps with texels larger than a ball's facets cast no shadow there; finer ones shade facets at grazing angles"
EXCEPTIONS: Mapping[tuple[str, str], str] = {
    **{
        (knob, title): FACETS
        for knob in ("shadow_size", "shadow_cascades")
        for title in (
            "spheres that touch the near plane, to an ulp",
            "slit of a pixel",
            "what was seen is behind the camera",
            "a parallel projection whose near plane cuts boxes",
        )
    },
    ("scale", "everything hidden but a wall"): "a picture of twice the size is rounded twice",
    ("scale", "corners where w is negative"): EDGES,
    ("scale", "two faces in one plane"): EDGES,
    ("mip_bias", "terrain:cells=64,trees=8"): "from -1 on, what is sharper flickers more",
    ("light_cutoff", "teleports"): "0.007 of a level, where filters of textures lose 5.6",
    ("light_test", "teleports"): "planes leave out lights beside large clusters that vertices keep; hybrid asks both",
    ("light_test", "glass"): "the same",
    ("depth", "a parallel projection whose near plane cuts boxes"): (
        "its depth is linear, and reversed floats are dense where it is far, not where digits of a distance are lost"
    ),
}


def find_rises(knob: Knob, errors: Mapping[str, float]) -> list[str]:
    """Return the values whose error is greater than that of the one before."""
    values, alike = list(errors), ALIKE.get(knob.unit, 0.0)
    pairs = pairwise(values)
    return [f"{other}: {errors[other]:.4g} after {errors[one]:.4g}" for one, other in pairs
            if errors[other] > errors[one] + alike]  # fmt: skip


def measure(device: rhi.Device, title: str, knob: Knob) -> dict[str, float]:
    """Return the mean error of each value that the device has; nothing if the scene has no use for the knob."""
    make, shots = SCENES[title]
    scene = deepcopy(make())  # the exam makes each once, and knobs change it
    if prepare_scene(scene, knob) is not None:
        return {}
    left_out = list_left_out(device, SITUATION.settings, knob)
    values = [value for value in knob.values if value not in left_out]
    if len(values) < 2:
        return {}
    frames = [Shot(number, camera) for number, (camera, _) in enumerate(shots(scene))]
    with KnobBench(device, scene, SITUATION, knob, values) as bench:
        return {value: some.summarize()[1] for value, some in bench.find_errors(frames).items()}


@pytest.mark.nightly
@pytest.mark.parametrize("title", SCENES)
def test_no_error_rises_on_a_scene_of_the_exam(title: str) -> None:
    found, swept = {}, 0
    with open_device("gl") as device:
        for knob in KNOBS.values():
            if knob.is_encoding or knob.exception or knob.option:
                continue
            errors = measure(device, title, knob)
            swept += bool(errors)
            rises = find_rises(knob, errors)
            if rises and (knob.name, title) not in EXCEPTIONS:
                found[knob.name] = rises
    assert swept >= 8  # of what is simulated, rays judge nothing
    assert found == {}


def test_a_drawn_second_eye_is_what_the_judge_sees() -> None:
    """But for rounding: the greatest error of three channels is .375 of a level in the mean."""
    with open_device("gl") as device:
        errors = measure(device, "slit of a pixel", KNOBS["second_eye"])
    assert errors["drawn"] < 0.45
    assert errors["reprojected"] > 0.8


@pytest.mark.parametrize("knob", [knob for knob in KNOBS.values() if knob.is_encoding], ids=lambda knob: knob.name)
@pytest.mark.usefixtures("gl")
def test_no_error_of_an_encoding_rises(knob: Knob) -> None:
    report = sweep_knob(Situation("", backend="gl", rounds=1), knob.name)
    assert find_rises(knob, {row.value: row.mean_error for row in report.rows}) == []


def test_a_rise_is_found_and_a_small_difference_of_pictures_is_none() -> None:
    fxaa, tile = KNOBS["fxaa"], KNOBS["tile"]
    assert find_rises(fxaa, {"off": 1.0, "on": 1.004}) == []
    assert find_rises(fxaa, {"off": 1.0, "on": 1.006}) == ["on: 1.006 after 1"]
    assert find_rises(tile, {"64": 2.0, "32": 2.0, "16": 2.001, "8": 1.0}) == ["16: 2.001 after 2"]


def test_an_exception_is_of_a_knob_and_a_scene_that_there_are() -> None:
    assert all(knob in KNOBS and title in SCENES and why for (knob, title), why in EXCEPTIONS.items())
