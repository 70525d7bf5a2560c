"""Hot reload of the renderer's own shaders, whose variants are made while it draws."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import renderer.content.material_shaders as material_shaders
import renderer.shaders.lighting as lighting
import rhi
from renderer.content import load_scene, parse_camera
from renderer.renderer import Renderer
from renderer.techniques import ClusteredDeferred, Forward, Technique
from renderer.visibility import make_visibility
from rhi import ShaderError

TEXT = Path(lighting.__file__).read_text(encoding="utf-8")
EDITED = TEXT.replace("(surface.base_color + specular) *", "(surface.base_color.zyx + specular) *")


@pytest.fixture
def reloaders() -> Iterator[list[rhi.Reloader]]:
    """Reloaders, the first of which puts the module back."""
    created: list[rhi.Reloader] = []
    yield created
    rhi.Reloader().reload(lighting, TEXT)


@pytest.mark.parametrize(
    ("backend", "technique"),
    [
        ("null", Forward()),
        ("gl", Forward()),
        pytest.param("gl", ClusteredDeferred(), marks=pytest.mark.nightly),
        pytest.param("cl", Forward(), marks=pytest.mark.nightly),
    ],
)
def test_an_edit_of_the_lighting_shows_and_can_be_taken_back(
    backend: str, technique: Technique, reloaders: list[rhi.Reloader]
) -> None:
    scene = load_scene("hall")
    camera = parse_camera("ground", scene)
    assert EDITED != TEXT
    with rhi.create_device(backend) as device:
        visibility = make_visibility("frustum", scene, device)
        with Renderer(device, scene, size=(64, 36), technique=technique, visibility=visibility) as renderer:

            def draw() -> np.ndarray:
                for _ in range(3):  # at the third its commands are recorded
                    image = renderer.render(camera).image
                    device.present(image)
                return image.read()

            before, reloader = draw(), rhi.Reloader(device)
            assert reloader.reload(lighting, EDITED) >= 1
            edited = draw()
            with pytest.raises(ShaderError) as error:
                reloader.reload(lighting, TEXT.replace("+ specular)", "+ speculr)"))
            assert error.value.site is not None
            assert error.value.site.file == lighting.__file__
            assert np.array_equal(draw(), edited)
            assert reloader.reload(lighting, TEXT) >= 1
            assert np.array_equal(draw(), before)
            assert backend == "null" or not np.array_equal(edited, before)


def test_an_edit_of_a_materials_own_shader_shows_and_can_be_taken_back(gl: rhi.Device) -> None:
    text = Path(material_shaders.__file__).read_text(encoding="utf-8")
    edited = text.replace("share = 0.5 - 0.5 * mean.x * mean.y", "share = 0.5 - 0.5 * mean.x")
    assert edited != text
    scene = load_scene("yard:columns=0,lights=0")
    camera = parse_camera("overview", scene)
    with Renderer(gl, scene, size=(64, 36), visibility=make_visibility("frustum", scene, gl)) as renderer:
        images = [renderer.render(camera).image.read()]
        reloader = rhi.Reloader(gl)
        for now in (edited, text):
            assert reloader.reload(material_shaders, now) >= 1
            images.append(renderer.render(camera).image.read())
        with pytest.raises(ShaderError):
            reloader.reload(material_shaders, text.replace("mean.x * mean.y", "mean.x * mean.z"))
    assert np.array_equal(images[0], images[2])
    assert np.count_nonzero((images[0] != images[1]).any(axis=2)) > 200
