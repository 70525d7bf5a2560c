"""The image of a highlight from normals of few bits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from renderer.cli import main
from renderer.lab.measure.normal_patches import SIDE, NormalPatches, draw_patches
from tests.renderer.conftest import open_device


@pytest.fixture(scope="module")
def patches() -> NormalPatches:
    with open_device("gl") as device:
        return draw_patches(device)


def test_a_highlight_from_8_bits_breaks_into_patches_and_one_from_16_does_not(patches: NormalPatches) -> None:
    errors = patches.measure_errors()
    assert errors[8] > 15
    assert errors[16] <= 2


def test_patches_have_edges_that_the_exact_highlight_lacks(patches: NormalPatches) -> None:
    """A patch is constant, and its edge a jump: second differences along a row are small without patches."""

    def jump(image: np.ndarray) -> float:
        green = image[SIDE // 4 : 3 * SIDE // 4, SIDE // 4 : 3 * SIDE // 4, 1].astype(float)
        return float(np.abs(np.diff(green, n=2, axis=1)).mean())

    assert jump(patches.by_bits[8]) > 3.0 * jump(patches.exact) > 0.0
    assert jump(patches.by_bits[16]) < 1.5 * jump(patches.exact)


def test_the_image_shows_few_bits_first_and_the_exact_one_last(patches: NormalPatches) -> None:
    image = patches.join()
    assert image.shape == (SIDE, 3 * SIDE, 3)
    assert np.array_equal(image[:, :SIDE], patches.by_bits[8])
    assert np.array_equal(image[:, 2 * SIDE :], patches.exact)
    assert patches.exact.max() == 255, "the highlight is seen"


def test_compare_encodings_writes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "patches.png"
    arguments = ["--backend", "gl", "--count", "256", "--rounds", "1", "--image", str(path)]
    assert main(["compare", "encodings", *arguments]) == 0
    assert path.stat().st_size > 0
    assert "of 255 with 8 bits" in capsys.readouterr().err
