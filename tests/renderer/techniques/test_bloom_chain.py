"""The filters of bloom: what they do to any image, compared with NumPy in float64."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bloom_reference import Floats, add_bloom
from frames import draw, make_boxes
from lighting_reference import encode, tone_map
from nightly_reasons import FEWER_CASES

import rhi
from renderer.frame import BloomSettings, FrameEffects, FramePass, Target
from renderer.frame.frame import Frame
from renderer.scene import Bloom, Scene
from renderer.techniques.parts.bloom import bloom_passes
from rhi import Format


class GivenLight:
    """A technique that draws nothing: its light is an array."""

    name = "given"

    def __init__(self, light: Floats) -> None:
        self.light = np.concatenate([light, np.ones((*light.shape[:2], 1))], axis=2).astype(np.float16)
        self.levels: list[Floats] = []

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        write = FramePass(
            "write", self._write, "is given", writes=(effects.image, Target("depth", Format.D32F))
        )
        read = FramePass("read", self._read, "is compared", reads=("bloom 1",), has_side_effects=True)
        return write, *bloom_passes(effects, effects.image.name), read

    def _write(self, frame: Frame) -> None:
        frame.image.write(self.light)

    def _read(self, frame: Frame) -> None:
        self.spread = frame.targets["bloom 1"].read()[..., :3].astype(float)


def blooming(share: float = 0.5) -> Scene:
    builder = make_boxes((0, 0, 0), name="box", emission=4.0)
    builder.bloom = Bloom(share)
    return builder.build()


def show(device: rhi.Device, light: Floats, share: float = 0.5, **settings: object) -> tuple[Floats, Floats]:
    """Return the image (h, w, 3) of light, 0…255, and the largest level of the spread light."""
    scene, technique = blooming(share), GivenLight(light)
    height, width, _ = light.shape
    bloom = replace(BloomSettings(), **settings)  # type: ignore[arg-type]
    return draw(device, scene, technique, size=(width, height), bloom=bloom), technique.spread


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
        ((37, 53), {"karis_average": True}),
        ((135, 240), {}),
    ],
)
def test_bloom_is_within_a_level_of_float64(
    drawing_device: rhi.Device, size: tuple[int, int], settings: dict[str, object]
) -> None:
    """Levels are half floats, whose steps are 2^-11 of the number, and 4 levels are rounded before a texel is
    shown."""
    light = make_lights(*size)
    exact = replace(BloomSettings(), **settings)  # type: ignore[arg-type]
    expected = encode(tone_map(add_bloom(light, 0.5, exact.levels, karis_average=exact.karis_average)))
    image, _ = show(drawing_device, light, **settings)
    assert np.abs(image - expected).max() <= 1.0


def test_pixels_that_are_not_finite_are_black_and_do_not_spread(drawing_device: rhi.Device) -> None:
    light = make_lights(21, 34)
    clean, _ = show(drawing_device, light)
    for number, wrong in enumerate((np.nan, np.inf, -np.inf)):
        light[5 + number, 9 + 6 * number, number] = wrong
    image, spread = show(drawing_device, light)
    assert np.isfinite(spread).all()
    far = np.ones(light.shape[:2], bool)
    far[0:14, 3:28] = False
    # Four texels around each of them are black, to one of the thirteen samples: that little bloom is missing.
    assert np.abs(image - clean)[far].max() <= 12
    dark = ~np.isfinite(light).all(axis=2)
    assert (image[dark] <= clean[dark]).all()


@pytest.mark.parametrize("position", [(32, 48), (33, 48), (32, 49), (35, 51)])
def test_no_light_is_lost_or_made_wherever_it_is(gl: rhi.Device, position: tuple[int, int]) -> None:
    light = np.zeros((64, 96, 3))
    light[position] = 1000.0
    _, spread = show(gl, light, levels=3)  # a fourth one reaches the edges
    assert 4.0 * spread.sum(axis=(0, 1)) == pytest.approx([1000.0] * 3, rel=3e-3)


def test_light_that_moves_by_a_pixel_blooms_as_before(gl: rhi.Device) -> None:
    blooms = []
    for x in range(8):
        light = np.zeros((64, 96, 3))
        light[30:33, 44 + x : 47 + x] = 200.0
        image, _ = show(gl, light, 0.2, levels=4)
        around = image[31, 44 + x - 8 : 47 + x + 8, 1]
        blooms.append(np.delete(around, slice(7, 12)))
    change = np.abs(np.array(blooms) - np.mean(blooms, axis=0)).max()
    assert np.min(blooms) > 30
    assert change <= 14, change


def test_an_even_image_stays_as_it_is(gl: rhi.Device) -> None:
    light = np.full((19, 31, 3), (0.25, 1.0, 3.0))
    image, _ = show(gl, light, 1.0)
    assert np.abs(image - encode(tone_map(light))).max() <= 0.6


def test_sparks_bloom_less_with_the_karis_average(gl: rhi.Device) -> None:
    spark, light_image = np.zeros((2, 48, 64, 3))
    spark[24, 32] = 1000.0
    light_image[12:36, 16:48] = 2.0
    for light, least, most in ((spark, 0.0, 0.35), (light_image, 0.85, 1.0)):
        tamed, full = (show(gl, light, karis_average=tames)[1].sum() for tames in (True, False))
        assert least < tamed / full < most


REFUSED: dict[str, Callable[[], object]] = {
    "BloomSettings(levels=...)": lambda: BloomSettings(0),
    "BloomSettings(bits=...)": lambda: BloomSettings(bits=10),
    "Bloom(strength=...)": lambda: Bloom(0.0),
}


@pytest.mark.parametrize("call", REFUSED)
def test_a_setting_of_bloom_that_is_out_of_range_is_refused(call: str) -> None:
    with pytest.raises(rhi.ValidationError) as error:
        REFUSED[call]()
    assert error.value.rule.id in {"bloom-bad-settings", "scene-bad-effect"}
    assert error.value.call == call
