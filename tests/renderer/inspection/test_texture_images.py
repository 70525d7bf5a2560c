"""Images of what buffers hold."""

from __future__ import annotations

import numpy as np
import pytest

from renderer.inspection.texture_images import color_indices, texture_to_image
from renderer.shaders.encodings import encode_normal
from rhi.shading import evaluate


def test_numbers_are_grey_from_the_least_to_the_greatest() -> None:
    image = texture_to_image("shares", np.array([[-1.0, 0.0, 1.0, 3.0]], np.float32))
    assert image[0, :, 0].tolist() == [0, 64, 128, 255]
    assert (image == image[..., :1]).all()


def test_numbers_of_many_magnitudes_are_shown_by_their_logarithm() -> None:
    image = texture_to_image("depth", np.array([[0.0, 1e-4, 1e-2, 1.0]], np.float32))
    assert image[0, :, 0].tolist() == [0, 0, 128, 255]


@pytest.mark.parametrize("value", [0.0, 0.5, np.inf])
def test_a_flat_buffer_is_black_or_white(value: float) -> None:
    image = texture_to_image("depth", np.full((2, 3), value, np.float32))
    assert image.shape == (2, 3, 3)
    assert len(np.unique(image)) == 1


def test_colours_stay_and_light_is_mapped_to_tones() -> None:
    colors = np.array([[(0.0, 0.5, 1.0, 0.0)]], np.float16)
    assert texture_to_image("light", colors).tolist() == [[[0, 188, 255]]]
    brighter = texture_to_image("light", np.array([[(0.0, 0.5, 60000.0, 0.0)]], np.float16))[0, 0]
    assert brighter[0] == 0
    assert 0 < brighter[1] < 188
    assert brighter[2] == 255
    image = np.array([[(1, 2, 3, 4)]], np.uint8)
    assert texture_to_image("image", image).tolist() == [[[1, 2, 3]]]


@pytest.mark.parametrize("name", ["surface", "small surface", "packed"])
def test_normals_are_decoded(name: str) -> None:
    words = np.zeros((1, 1, 2), np.uint32)
    word_index = 0 if name == "packed" else 1
    words[..., word_index] = evaluate(encode_normal, np.array([[[0.0, 1.0, 0.0]]], np.float32))
    assert np.abs(texture_to_image(name, words)[0, 0].astype(int) - (188, 255, 188)).max() <= 1


def test_a_surface_without_a_normal_is_a_distance() -> None:
    distances = np.array([[1.0, 2.0, 3.0]], np.float32)
    assert (
        texture_to_image("surface", distances.view(np.uint32)).tolist()
        == texture_to_image("depth", distances).tolist()
    )


def test_equal_whole_numbers_have_equal_colours_and_neighbours_others() -> None:
    image = texture_to_image("material", np.array([[3, 3, 4, 2**32 - 1]], np.uint32)).astype(int)
    assert (image[0, 0] == image[0, 1]).all()
    assert np.abs(image[0, 0] - image[0, 2]).max() > 60
    assert color_indices(np.arange(4)).shape == (4, 3)
