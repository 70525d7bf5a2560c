"""A fourth kind of lights is a leaf and a row: a copy of the renderer with both draws it by every
technique."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tokenize
from pathlib import Path

import numpy as np
import pytest
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import renderer
from renderer.techniques import TECHNIQUES
from tests.renderer.light_kinds.tube_scene import COLOR, EYE, SIZE, TUBES, make_floor
from tests.renderer.techniques.lighting_reference import (
    compute_pixel_rays,
    encode,
    reference_plane_light,
    tone_map,
)

HERE = Path(__file__).parent
PRODUCT = Path(renderer.__file__).parent


@pytest.fixture(scope="module")
def extended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of the renderer that has tube lights: one more leaf, and one more row."""
    folder = tmp_path_factory.mktemp("extended")
    shutil.copytree(PRODUCT, folder / "renderer", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(HERE / "tube.py", folder / "renderer/light_kinds/tube.py")
    table = folder / "renderer/light_kinds/table.py"
    text = table.read_text(encoding="utf-8")
    text = text.replace("import directional, point, spot", "import directional, point, spot, tube")
    table.write_text(
        text.replace("    spot.SpotLights,\n", "    tube.TubeLights,\n    spot.SpotLights,\n"),
        encoding="utf-8",
    )
    return folder


def draw_extended(folder: Path, backend: str, *techniques: str) -> dict[str, NDArray[np.float64]]:
    """Draw the scene with tubes by the copy of the renderer, in a process of its own."""
    out = folder / f"{backend}.npz"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), str(PRODUCT.parent)])}
    command = [sys.executable, str(HERE / "draw_tubes.py"), backend, str(out), *techniques]
    result = subprocess.run(
        command, capture_output=True, text=True, env=environment, cwd=folder, encoding="utf-8"
    )
    assert result.returncode == 0, result.stderr[-3000:]
    return dict(np.load(out))


def expected_image(*, tubes: bool = True) -> NDArray[np.float64]:
    """The image (h, w, 3) of the floor, 0 to 255, in float64: the lights that the reference knows, and the
    tubes."""
    up, scene = np.array([0.0, 1.0, 0.0]), make_floor().build()
    mapped, _ = reference_plane_light(scene, EYE, SIZE, np.zeros(3), up, np.array(COLOR))
    if not tubes:
        return encode(mapped)
    rays = compute_pixel_rays(EYE, SIZE)
    hit = EYE.position + rays * (-EYE.position[1] / rays[..., 1:2])
    light = invert_tone_map(mapped)
    for tube in TUBES:
        light = light + reflect_tube(hit, up, **tube)
    return encode(tone_map(light))


def invert_tone_map(mapped: NDArray[np.float64]) -> NDArray[np.float64]:
    """The linear light that is mapped to values below white, by bisection."""
    low, high = np.zeros_like(mapped), np.full_like(mapped, 1e3)
    for _ in range(80):
        middle = 0.5 * (low + high)
        is_below = tone_map(middle) < mapped
        low, high = np.where(is_below, middle, low), np.where(is_below, high, middle)
    return 0.5 * (low + high)


def reflect_tube(
    hit: NDArray[np.float64],
    normal: NDArray[np.float64],
    position: tuple[float, ...],
    direction: tuple[float, ...],
    half_length: float,
    range: float,
    intensity: float,
    color: tuple[float, ...] = (1.0, 1.0, 1.0),
) -> NDArray[np.float64]:
    """The light of a tube that the floor's material reflects to the eye: that of the nearest point of its
    segment."""
    axis = np.array(direction) / np.linalg.norm(direction)
    along = np.clip((hit - position) @ axis, -half_length, half_length)
    to_light = position + along[..., None] * axis - hit
    distance = np.linalg.norm(to_light, axis=-1, keepdims=True)
    middle = np.linalg.norm(position - hit, axis=-1, keepdims=True)
    window = np.clip(1.0 - (middle / range) ** 4, 0.0, 1.0) ** 2
    irradiance = np.array(color) * intensity * window / distance**2
    to_light, to_eye = to_light / distance, EYE.position - hit
    to_eye = to_eye / np.linalg.norm(to_eye, axis=-1, keepdims=True)
    halfway = to_light + to_eye
    halfway = halfway / np.linalg.norm(halfway, axis=-1, keepdims=True)
    lobe = np.clip((halfway @ normal)[..., None], 0.0, 1.0) ** 20.0 * (20.0 + 8.0) / 8.0
    facing = np.maximum((to_light @ normal)[..., None], 0.0)
    return np.asarray((np.array(COLOR) + np.array((0.3, 0.2, 0.1)) * lobe) * irradiance * facing)


def test_every_technique_draws_a_kind_of_lights_that_is_a_leaf_and_a_row(extended: Path) -> None:
    expected = expected_image()
    assert np.abs(expected - expected_image(tubes=False)).max() > 60.0, "tubes are plainly visible"
    images = draw_extended(extended, "gl", *TECHNIQUES)
    errors = {name: float(np.abs(image - expected).max()) for name, image in images.items()}
    assert {name: error for name, error in errors.items() if error > 1.5} == {}
    assert list(images) == list(TECHNIQUES)


@pytest.mark.nightly_cases(reason=ONLY_KERNELS)
def test_cl_draws_a_kind_of_lights_that_is_a_leaf_and_a_row(extended: Path) -> None:
    pytest.importorskip("pyopencl")
    (image,) = draw_extended(extended, "cl", "clustered").values()
    assert np.abs(image - expected_image()).max() <= 1.5


def list_mentions(name: str) -> set[str]:
    """The files of the renderer that mention a kind of lights in code: `spot`, `spot_lights`, `SpotLight`,
    `"spot"`."""
    word = re.compile(
        rf"\b{name}\b|\b{name}_|_{name}_|\b{name.capitalize()}[A-Z]|\b{name.upper()}_|\badd_{name}"
    )
    paths = set()
    for path in sorted(PRODUCT.rglob("*.py")):
        with path.open("rb") as file:
            tokens = [
                token
                for token in tokenize.tokenize(file.readline)
                if token.type == tokenize.NAME or (token.type == tokenize.STRING and " " not in token.string)
            ]
        if any(word.search(token.string) for token in tokens):
            paths.add(path.relative_to(PRODUCT).as_posix())
    return paths


def test_only_its_leaf_the_table_and_scene_builders_name_a_kind_of_lights() -> None:
    """Code that adds lights of the kind to a scene (content, the lab's scenes) names it, and none that draws
    them."""
    drawing = {path for path in list_mentions("spot") if not path.startswith(("content/", "lab/"))}
    assert drawing == {
        "light_kinds/spot.py",
        "light_kinds/table.py",
        "scene/__init__.py",
        "shaders/__init__.py",
    }
