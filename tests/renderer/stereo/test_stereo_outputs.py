"""Two images in one image: which pixel comes from which image, and the colours that glasses let through."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pytest
from frames import open_renderer
from numpy.typing import NDArray

import rhi
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Scene, StereoRig
from renderer.stereo import (
    GLASSES,
    OUTPUTS,
    Stereo,
    compute_brightness,
    compute_rivalry,
    mix_anaglyph,
    view_through_glasses,
)

SIZE: Final = (97, 55)  # odd: neither halves evenly
RIG: Final = StereoRig(0.3, 6.0)


@dataclass
class Eyes:
    """A renderer with two eyes that look at a street."""

    renderer: Renderer
    camera: Camera

    def show(
        self, output: str, rig: StereoRig = RIG, **options: Any
    ) -> tuple[NDArray[Any], list[NDArray[Any]]]:
        """Return the image, and the images of both eyes."""
        self.renderer.stereo = Stereo(rig, output, **options)
        result = self.render()
        return result.image.read(), [image.read() for image in result.eye_images]

    def render(self) -> FrameResult:
        return self.renderer.render(self.camera, 10.0)


@pytest.fixture(scope="module")
def eyes(drawing_device: rhi.Device, city: Scene) -> Iterator[Eyes]:
    with open_renderer(drawing_device, city, visibility="frustum", size=SIZE) as renderer:
        yield Eyes(renderer, city.paths["ground"].camera(600))


def test_each_glass_lets_one_image_through() -> None:
    white, black = np.ones(3), np.zeros(3)
    for name in ("grey", "color", "half_color"):
        assert mix_anaglyph(name, white, black) == pytest.approx([1.0, 0.0, 0.0])
        assert mix_anaglyph(name, black, white) == pytest.approx([0.0, 1.0, 1.0])
    for image, seen in ((0, [1.0, 0.0, 0.0]), (1, [0.0, 1.0, 1.0])):
        mixed = mix_anaglyph("dubois", *((white, black) if image == 0 else (black, white)))
        assert mixed == pytest.approx(seen, abs=0.14)


def test_colors_differ_where_they_should() -> None:
    red = np.array([1.0, 0.0, 0.0])
    assert mix_anaglyph("grey", red, red) == pytest.approx([0.2126] * 3)
    assert mix_anaglyph("color", red, red) == pytest.approx(red)
    assert mix_anaglyph("half_color", red, red) == pytest.approx([0.2126, 0.0, 0.0])


def test_even_rows_are_the_left_eye_s(eyes: Eyes) -> None:
    image, (left, right) = eyes.show("interlaced")
    assert np.array_equal(image[::2], left[::2])
    assert np.array_equal(image[1::2], right[1::2])
    assert not np.array_equal(left[1::2], right[1::2])


def test_halves_are_whole_images_of_both_eyes(eyes: Eyes) -> None:
    image, (left, right) = eyes.show("side_by_side")
    assert image.shape == (55, 97, 4)
    assert left.shape == right.shape == (55, 49, 4)
    assert np.array_equal(image, np.concatenate([left, right], axis=1)[:, :97])
    image, (left, right) = eyes.show("over_under")
    assert left.shape == right.shape == (28, 97, 4)
    assert np.array_equal(image, np.concatenate([left, right], axis=0)[:55])
    full = eyes.show("interlaced")[1][0]
    # Squeezed, not cut: each half has the whole field of view.
    assert np.abs(full[::2].mean(axis=(0, 1)) - left.mean(axis=(0, 1))).max() < 4.0


def test_swapped_eyes_exchange_their_images(eyes: Eyes) -> None:
    image, (left, right) = eyes.show("side_by_side")
    swapped, eye_images = eyes.show("side_by_side", is_swapped=True)
    assert np.array_equal(eye_images, [left, right]), "the eyes stay where they are"
    assert np.array_equal(swapped, np.concatenate([right, left], axis=1)[:, :97])
    assert not np.array_equal(swapped, image)
    grey, swapped = (eyes.show("grey", is_swapped=turned)[0] for turned in (False, True))
    assert np.array_equal(swapped[..., 0], grey[..., 1])
    assert np.array_equal(swapped[..., 1:3], grey[..., [0, 0]])


def test_unknown_outputs_are_refused() -> None:
    assert Stereo(RIG, OUTPUTS[0]).output == "grey"
    with pytest.raises(rhi.ValidationError) as error:
        Stereo(RIG, "duboys")
    assert error.value.rule.id == "stereo-unknown-output"
    assert "'dubois'" in str(error.value)


def test_both_glasses_together_let_all_of_an_anaglyph_through() -> None:
    anaglyph = np.random.default_rng(1).random((5, 7, 3))
    red, cyan = view_through_glasses(anaglyph)
    assert np.array_equal(red + cyan, anaglyph)
    assert red[..., 1:].max() == cyan[..., 0].max() == 0.0


def test_eyes_do_not_compete_about_grey_anaglyphs_and_do_about_colors() -> None:
    """A red object is bright to one eye and black to the other, unless it is made grey first (Russell 2011, appendices
    E and F)."""
    flag = np.tile([0.9, 0.05, 0.0], (4, 4, 1))
    assert compute_rivalry(mix_anaglyph("grey", flag, flag)) == pytest.approx(0.0, abs=1e-12)
    expected = 0.9 - (0.7152 * 0.05) / (0.7152 + 0.0722)
    assert compute_rivalry(mix_anaglyph("color", flag, flag)) == pytest.approx(expected)
    assert 0.0 < compute_rivalry(mix_anaglyph("half_color", flag, flag)) < expected


def test_white_is_as_bright_through_each_glass() -> None:
    white = np.ones((2, 3))
    for light, glass in zip(view_through_glasses(white), GLASSES.values(), strict=True):
        assert compute_brightness(light, glass) == pytest.approx([1.0, 1.0])
        assert compute_brightness(0.25 * light, glass) == pytest.approx([0.25, 0.25])
