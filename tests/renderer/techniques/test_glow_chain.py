"""The filters of glow: what they do to any image, compared with NumPy in float64."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from frames import draw, make_boxes
from glow_reference import Floats, add_glow
from lighting_reference import encode, tone_map
from nightly_reasons import FEWER_CASES

import rhi
from renderer.frame import GlowSettings, Needs, Pass, Target
from renderer.frame.frame import Frame
from renderer.scene import Glow, Scene
from renderer.techniques.parts.glow import glow_passes
from rhi import Format


class Given:
    """A technique that draws nothing: its light is an array."""

    name = "given"

    def __init__(self, light: Floats) -> None:
        self.light = np.concatenate([light, np.ones((*light.shape[:2], 1))], axis=2).astype(np.float16)
        self.levels: list[Floats] = []

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        write = Pass("write", self._write, "is given", writes=(needs.image, Target("depth", Format.D32F)))
        read = Pass("read", self._read, "is compared", reads=("glow 1",), has_side_effects=True)
        return write, *glow_passes(needs, needs.image.name), read

    def _write(self, frame: Frame) -> None:
        frame.image.write(self.light)

    def _read(self, frame: Frame) -> None:
        self.spread = frame.targets["glow 1"].read()[..., :3].astype(float)


def glowing(share: float = 0.5) -> Scene:
    builder = make_boxes((0, 0, 0), name="lamp", emission=4.0)
    builder.glow = Glow(share)
    return builder.build()


def show(device: rhi.Device, light: Floats, share: float = 0.5, **settings: object) -> tuple[Floats, Floats]:
    """Return the image (h, w, 3) of light, 0…255, and the largest level of the spread light."""
    scene, technique = glowing(share), Given(light)
    height, width, _ = light.shape
    glow = replace(GlowSettings(), **settings)  # type: ignore[arg-type]
    return draw(device, scene, technique, size=(width, height), glow=glow), technique.spread


def make_lights(height: int, width: int) -> Floats:
    """Make an image with light of all strengths, and a few very bright texels."""
    random = np.random.default_rng([height, width])
    light = 10.0 ** random.uniform(-3.0, 0.5, (height, width, 3))
    light[random.random((height, width)) < 0.02] *= 300.0
    return light.astype(np.float16).astype(float)


@pytest.mark.nightly_cases("*-size[45]-*", reason=FEWER_CASES)
@pytest.mark.parametrize(
    ("size", "settings"),
    [
        ((37, 53), {}),
        ((1, 1), {}),
        ((1, 20), {"levels": 12}),
        ((16, 2), {"levels": 1}),
        ((37, 53), {"tames_sparks": True}),
        ((135, 240), {}),
    ],
)
def test_glow_is_within_a_level_of_float64(
    drawing_device: rhi.Device, size: tuple[int, int], settings: dict[str, object]
) -> None:
    """Levels are half floats, whose steps are 2^-11 of the number, and 4 levels are rounded before a texel is shown."""
    light = make_lights(*size)
    exact = replace(GlowSettings(), **settings)  # type: ignore[arg-type]
    expected = encode(tone_map(add_glow(light, 0.5, exact.levels, tames_sparks=exact.tames_sparks)))
    image, _ = show(drawing_device, light, **settings)
    assert np.abs(image - expected).max() <= 1.0


def test_what_is_no_light_is_black_and_spreads_nowhere(drawing_device: rhi.Device) -> None:
    light = make_lights(21, 34)
    clean, _ = show(drawing_device, light)
    for number, wrong in enumerate((np.nan, np.inf, -np.inf)):
        light[5 + number, 9 + 6 * number, number] = wrong
    image, spread = show(drawing_device, light)
    assert np.isfinite(spread).all()
    far = np.ones(light.shape[:2], bool)
    far[0:14, 3:28] = False
    # Four texels around each of them are black, to one of the thirteen samples: that little glow is missing.
    assert np.abs(image - clean)[far].max() <= 12
    dark = ~np.isfinite(light).all(axis=2)
    assert (image[dark] <= clean[dark]).all()


@pytest.mark.parametrize("place", [(32, 48), (33, 48), (32, 49), (35, 51)])
def test_no_light_is_lost_or_made_wherever_it_is(gl: rhi.Device, place: tuple[int, int]) -> None:
    light = np.zeros((64, 96, 3))
    light[place] = 1000.0
    _, spread = show(gl, light, levels=3)  # a fourth one reaches the edges
    assert 4.0 * spread.sum(axis=(0, 1)) == pytest.approx([1000.0] * 3, rel=3e-3)


def test_light_that_moves_by_a_pixel_glows_as_before(gl: rhi.Device) -> None:
    glows = []
    for x in range(8):
        light = np.zeros((64, 96, 3))
        light[30:33, 44 + x : 47 + x] = 200.0
        image, _ = show(gl, light, 0.2, levels=4)
        around = image[31, 44 + x - 8 : 47 + x + 8, 1]
        glows.append(np.delete(around, slice(7, 12)))
    change = np.abs(np.array(glows) - np.mean(glows, axis=0)).max()
    assert np.min(glows) > 30
    assert change <= 14, change


def test_an_even_image_stays_as_it_is(gl: rhi.Device) -> None:
    light = np.full((19, 31, 3), (0.25, 1.0, 3.0))
    image, _ = show(gl, light, 1.0)
    assert np.abs(image - encode(tone_map(light))).max() <= 0.6


def test_sparks_glow_less_if_they_are_tamed(gl: rhi.Device) -> None:
    spark, lamp = np.zeros((2, 48, 64, 3))
    spark[24, 32] = 1000.0
    lamp[12:36, 16:48] = 2.0
    for light, least, most in ((spark, 0.0, 0.35), (lamp, 0.85, 1.0)):
        tamed, full = (show(gl, light, tames_sparks=tames)[1].sum() for tames in (True, False))
        assert least < tamed / full < most


REFUSED: dict[str, Callable[[], object]] = {
    "GlowSettings(levels=...)": lambda: GlowSettings(0),
    "GlowSettings(bits=...)": lambda: GlowSettings(bits=10),
    "Glow(share=...)": lambda: Glow(0.0),
}


@pytest.mark.parametrize("call", REFUSED)
def test_a_setting_of_glow_that_is_out_of_range_is_refused(call: str) -> None:
    with pytest.raises(rhi.ValidationError) as error:
        REFUSED[call]()
    assert error.value.rule.id in {"glow-bad-settings", "scene-bad-air"}
    assert error.value.call == call
