"""Hot reload of materials' shaders over many saves: what is shown is always the last good text."""

from __future__ import annotations

import importlib
import itertools
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nightly_reasons import ONLY_KERNELS
from shader_edits import make_saves, replay

from renderer.content.shapes import box
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder
from renderer.shaders import MaterialShader
from rhi import Device, Reloader, RhiError
from rhi.shading import from_source
from tests.renderer.conftest import open_device

_numbers = itertools.count()
EYE = Camera.look_at((0.0, 0.0, 3.0), (0.0, 0.0, 0.0))


def make_text(color: tuple[float, float, float]) -> str:
    return f"""
import rhi.shading as sl
from renderer.shaders import MaterialShader, SurfaceInput, SurfaceParameters

class Mine(MaterialShader):
    def describe(self, at: SurfaceInput) -> SurfaceParameters:
        described = super().describe(at)
        described.color = sl.vec4({color[0]}, {color[1]}, {color[2]}, 1.0)
        return described
"""


@pytest.fixture
def import_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Any]]:
    monkeypatch.syspath_prepend(str(tmp_path))
    names: list[str] = []

    def make(text: str) -> Any:
        names.append(f"saved_material_{next(_numbers)}")
        (tmp_path / f"{names[-1]}.py").write_text(text, encoding="utf-8")
        importlib.invalidate_caches()
        return importlib.import_module(names[-1])

    yield make
    for name in names:
        del sys.modules[name]


def make_scene(shader: type[MaterialShader]) -> Scene:
    builder = SceneBuilder("a box")
    builder.add_objects(builder.add_node(), builder.add_mesh(box()), builder.add_material(shader=shader))
    builder.lights.sky = builder.lights.ground = (1.0, 1.0, 1.0)
    return builder.build()


def draw(renderer: Renderer) -> list[int]:
    pixel = renderer.render(EYE).image.read()[8, 8]
    return [int(value) for value in np.asarray(pixel)]


def draw_afresh(device: Device, text: str) -> list[int] | None:
    """The image of a text in a program that begins with it, by `from_source`, which knows of no reload."""
    try:
        shader = from_source(text, "Mine")
        if not (isinstance(shader, type) and issubclass(shader, MaterialShader)):
            return None
        with Renderer(device, make_scene(shader), size=(16, 16), visibility="none") as renderer:
            return draw(renderer)
    except RhiError:
        return None


def check_saves(backend: str, module: Any, seed: int, count: int, *, is_drawn_first: bool = True) -> None:
    with open_device(backend) as device, Reloader(device) as reloader:
        scene = make_scene(module.Mine)
        with Renderer(device, scene, size=(16, 16), visibility="none") as renderer:
            if is_drawn_first:
                draw(renderer)

            def save(text: str) -> bool:
                try:
                    reloader.reload(module, text)
                except RhiError:
                    return False
                return True

            saves = make_saves(make_text, seed)
            wrong = replay(saves, count, lambda: draw(renderer), save, lambda text: draw_afresh(device, text))
            assert wrong == []


def test_the_last_good_text_of_a_material_is_shown(import_text: Callable[[str], Any]) -> None:
    check_saves("gl", import_text(make_text((1.0, 0.0, 0.0))), 3, 24)


def test_a_material_that_was_not_drawn_yet_outlives_an_empty_save(import_text: Callable[[str], Any]) -> None:
    module = import_text(make_text((1.0, 0.0, 0.0)))
    with open_device("gl") as device, Reloader(device) as reloader:
        scene = make_scene(module.Mine)
        with pytest.raises(RhiError, match="shading-reload"):
            reloader.reload(module, "")
        with Renderer(device, scene, size=(16, 16), visibility="none") as renderer:
            red = draw(renderer)
            reloader.reload(module, make_text((0.0, 0.0, 1.0)))
            blue = draw(renderer)
        assert red[0] > 2 * red[2]
        assert blue[2] > 2 * blue[0]


@pytest.mark.nightly_cases("*", reason=ONLY_KERNELS)
@pytest.mark.parametrize(("backend", "count"), [("gl", 200), ("wgpu", 60), ("cl", 30)])
def test_so_it_is_over_many_saves_on_every_backend(
    import_text: Callable[[str], Any], backend: str, count: int
) -> None:
    check_saves(backend, import_text(make_text((1.0, 0.0, 0.0))), 4, count)
