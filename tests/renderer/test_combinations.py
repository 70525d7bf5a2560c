"""Effects, techniques and visibility algorithms in combination: the image is that of forward shading with
frustum culling, whatever else is switched on.

The scene has everything that the steps of `effect-costs` add. Rows of a covering array switch effects on at run
time, so each pair of effects, techniques, algorithms, settings and outputs is drawn together.
"""

from __future__ import annotations

import inspect
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from combinations import Row, cover_pairs, list_pairs
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from nights import rotate_seed
from numpy.typing import NDArray
from tested_devices import open_device

import rhi
from renderer.frame import Blending
from renderer.lab.effect_costs.effect_steps import EFFECT_STEPS, build_scene, move_eye
from renderer.renderer import Renderer
from renderer.scene import Depth, StereoRig
from renderer.stereo import Stereo
from renderer.techniques import TECHNIQUES, FxaaTechnique, Technique
from rhi import Precision

SIZE = (80, 48)
FRAMES = 5
FREE_FACTORS = {"fxaa", "msaa", "stereo", "overlay"}
"""Steps that are factors of their own, and the overlay, whose text has times."""
NEEDED_EARLIER = {
    "shadow": "sun",
    "local shadows": "point light",
    "sphere": "point light",
    "rectangle": "point light",
}
"""Steps that change lights of an earlier step."""
EFFECTS = [step.name for step in EFFECT_STEPS if step.switch is not None and step.name not in FREE_FACTORS]
FACTORS: dict[str, list[Any]] = {
    "technique": list(TECHNIQUES),
    "visibility": ["frustum", "none", "two_pass", "depth_pyramid", "chc_plus_plus", "software_depth"],
    "samples": [1, 4],
    "fxaa": [False, True],
    "output": ["", "dubois", "side_by_side", "interlaced"],
    "blending": [Blending.SORTED, Blending.WEIGHTED],
    "precision": [Precision.FAST, Precision.EXACT],
    "depth": [Depth.REVERSED, Depth.STANDARD],
    "scale": [1.0, 0.5, 2.0],
    **{name: [False, True] for name in EFFECTS},
}
BY_DAY = 3


def make_technique(name: str, row: Row) -> Technique:
    """The technique of a name with as many samples as the row says, where it has any."""
    parameters = inspect.signature(TECHNIQUES[name]).parameters
    options = {"samples": row["samples"]} if "samples" in parameters else {}
    if "scale" in parameters:
        options["scale"] = 1.0
    technique = TECHNIQUES[name](**options)
    return FxaaTechnique(technique) if row["fxaa"] else technique


def draw(device: rhi.Device, row: Row, technique: str, visibility: str) -> NDArray[np.int64]:
    """Draw the last of some frames in which the camera moves, after the row's effects were switched on."""
    scene, materials = build_scene(len(EFFECT_STEPS))
    with Renderer(
        device,
        scene,
        size=SIZE,
        technique=make_technique(technique, row),
        visibility=visibility,
        blending=row["blending"],
        precision=row["precision"],
    ) as renderer:
        renderer.scale = row["scale"]
        if row["output"]:
            renderer.stereo = Stereo(StereoRig(0.063, 7.0), row["output"])
        for step, material in zip(EFFECT_STEPS, materials, strict=True):
            if step.name in EFFECTS and row[step.name] and row[NEEDED_EARLIER.get(step.name, step.name)]:
                assert step.switch is not None
                step.switch(renderer, material, True)
        for frame in range(FRAMES):
            eye = move_eye(frame)
            camera = replace(eye, projection=replace(eye.projection, depth=row["depth"]))
            image = renderer.render(camera, frame / 60.0).image
        texels: NDArray[np.int64] = image.read()[..., :3].astype(np.int64)
        return texels


def compare(device: rhi.Device, row: Row) -> None:
    """Compare the row's image with that of forward shading and frustum culling.

    Techniques round light differently, and those with lists of draws draw edges a frame later. Several samples of
    a deferred technique are averaged after tone mapping, those of light pre-pass share their light.
    """
    if "samples" not in inspect.signature(TECHNIQUES[row["technique"]]).parameters:
        row = {**row, "samples": 1}
    expected = draw(device, row, "forward", "frustum")
    image = draw(device, row, row["technique"], row["visibility"])
    differences = np.abs(image - expected).max(axis=-1)
    assert expected.std() > 8.0, "control: there is something to see"
    assert (differences > 4).mean() <= (0.01 if row["samples"] == 1 else 0.04), row
    assert differences.mean() <= (0.1 if row["samples"] == 1 else 0.6), row


ROWS = cover_pairs(FACTORS, 7)


@pytest.mark.parametrize("number", range(BY_DAY))
def test_some_combinations_draw_the_image_of_forward_shading(number: int) -> None:
    with open_device("gl") as device:
        compare(device, ROWS[-1 - number])


@pytest.mark.nightly_cases(reason=FEWER_CASES)
@pytest.mark.parametrize("number", range(len(ROWS)))
@pytest.mark.parametrize("backend", ["gl", "wgpu"])
def test_each_pair_of_effects_draws_the_image_of_forward_shading(backend: str, number: int) -> None:
    with open_device(backend) as device:
        compare(device, ROWS[number])


@pytest.mark.nightly_cases(reason=ONLY_KERNELS)
@pytest.mark.parametrize("number", range(6))
def test_random_combinations_draw_the_image_of_forward_shading_on_cl(number: int) -> None:
    rows = cover_pairs(FACTORS, rotate_seed(number))
    with open_device("cl") as device:
        compare(device, rows[0])


def test_each_pair_of_values_is_in_some_row() -> None:
    names = list(FACTORS)
    pairs = set()
    for row in ROWS:
        pairs |= list_pairs([FACTORS[name].index(row[name]) for name in names])
    sizes = [len(values) for values in FACTORS.values()]
    assert len(pairs) == (sum(sizes) ** 2 - sum(size**2 for size in sizes)) // 2
    assert len(ROWS) < 2 * max(sizes) * sorted(sizes)[-2]


def test_each_effect_that_can_be_switched_is_a_factor() -> None:
    switched = {step.name for step in EFFECT_STEPS if step.switch is not None}
    assert switched >= FREE_FACTORS
    assert set(EFFECTS) == switched - FREE_FACTORS
    assert set(NEEDED_EARLIER) | set(NEEDED_EARLIER.values()) <= switched
