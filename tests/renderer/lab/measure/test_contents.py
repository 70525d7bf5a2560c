"""Pictures of what buffers hold."""

from __future__ import annotations

import numpy as np
import pytest

from renderer.lab.measure.contents import color_rows, picture_contents
from renderer.shaders.encodings import encode_normal
from rhi.shading import evaluate


def test_numbers_are_grey_from_the_least_to_the_greatest() -> None:
    picture = picture_contents("shares", np.array([[-1.0, 0.0, 1.0, 3.0]], np.float32))
    assert picture[0, :, 0].tolist() == [0, 64, 128, 255]
    assert (picture == picture[..., :1]).all()


def test_numbers_of_many_magnitudes_are_shown_by_their_logarithm() -> None:
    picture = picture_contents("depth", np.array([[0.0, 1e-4, 1e-2, 1.0]], np.float32))
    assert picture[0, :, 0].tolist() == [0, 0, 128, 255]


@pytest.mark.parametrize("value", [0.0, 0.5, np.inf])
def test_a_flat_buffer_is_black_or_white(value: float) -> None:
    picture = picture_contents("depth", np.full((2, 3), value, np.float32))
    assert picture.shape == (2, 3, 3)
    assert len(np.unique(picture)) == 1


def test_colours_stay_and_light_is_mapped_to_tones() -> None:
    colors = np.array([[(0.0, 0.5, 1.0, 0.0)]], np.float16)
    assert picture_contents("light", colors).tolist() == [[[0, 188, 255]]]
    brighter = picture_contents("light", np.array([[(0.0, 0.5, 60000.0, 0.0)]], np.float16))[0, 0]
    assert brighter[0] == 0
    assert 0 < brighter[1] < 188
    assert brighter[2] == 255
    image = np.array([[(1, 2, 3, 4)]], np.uint8)
    assert picture_contents("image", image).tolist() == [[[1, 2, 3]]]


@pytest.mark.parametrize("name", ["surface", "small surface", "packed"])
def test_normals_are_decoded(name: str) -> None:
    words = np.zeros((1, 1, 2), np.uint32)
    place = 0 if name == "packed" else 1
    words[..., place] = evaluate(encode_normal, np.array([[[0.0, 1.0, 0.0]]], np.float32))
    assert np.abs(picture_contents(name, words)[0, 0].astype(int) - (188, 255, 188)).max() <= 1


def test_a_surface_without_a_normal_is_a_distance() -> None:
    distances = np.array([[1.0, 2.0, 3.0]], np.float32)
    assert (
        picture_contents("surface", distances.view(np.uint32)).tolist() == picture_contents("depth", distances).tolist()
    )


def test_equal_whole_numbers_have_equal_colours_and_neighbours_others() -> None:
    picture = picture_contents("material", np.array([[3, 3, 4, 2**32 - 1]], np.uint32)).astype(int)
    assert (picture[0, 0] == picture[0, 1]).all()
    assert np.abs(picture[0, 0] - picture[0, 2]).max() > 60
    assert color_rows(np.arange(4)).shape == (4, 3)
