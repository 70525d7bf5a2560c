"""Volumes of lights that are added to a lit image: the same image, by as many draws as there are kinds of lights."""

from __future__ import annotations

import numpy as np
import pytest
from frames import make_boxes, make_lit_boxes, open_renderer
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.content import load_scene
from renderer.content.material_shaders import Brushed
from renderer.renderer import Renderer
from renderer.scene import AmbientOcclusion, Bloom, Camera, Fog, Scene
from renderer.techniques import Forward, ForwardMultipass, Technique

SIZE = (96, 54)
EYE = Camera.look_at((1.5, 1.5, 3.0), (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def hall() -> Scene:
    return load_scene("hall:columns=4,rows=2,flags=2,lights=24")


def draw(device: rhi.Device, scene: Scene, technique: Technique, camera: Camera) -> NDArray[np.int64]:
    with open_renderer(device, scene, technique, visibility="frustum", size=SIZE) as renderer:
        return np.asarray(renderer.render(camera, 10.0).image.read(), np.int64)


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("bits", [16, 32])
def test_lights_added_as_volumes_give_the_image_of_forward_shading(
    drawing_device: rhi.Device, hall: Scene, bits: int
) -> None:
    camera = hall.paths["ground"].camera(600)
    forward = draw(drawing_device, hall, Forward(), camera)
    volumes = draw(drawing_device, hall, ForwardMultipass(light_volumes=True, light_bits=bits), camera)
    assert np.abs(volumes - forward).max() <= 2
    hall.lights.point["intensity"] *= 0.0
    dark = draw(drawing_device, hall, Forward(), camera)
    hall.lights.point["intensity"] = load_scene("hall:columns=4,rows=2,flags=2,lights=24").lights.point[
        "intensity"
    ]
    assert (np.abs(forward - dark).max(axis=2) > 20).mean() > 0.1, "point lights are seen"


@pytest.mark.parametrize(
    "changes",
    [
        {"fog": Fog(0.2, (0.5, 0.5, 0.6)), "haze": 0.05},
        {"ambient_occlusion": AmbientOcclusion(0.5), "bloom": Bloom(0.2)},
    ],
    ids=["air", "screen"],
)
def test_air_bloom_and_occlusion_are_those_of_forward_shading(
    gl: rhi.Device, changes: dict[str, object]
) -> None:
    images = []
    for technique in (Forward(), ForwardMultipass(light_volumes=True)):
        scene = make_lit_boxes(3, 2)
        for name, value in changes.items():
            setattr(scene, name, value)
        images.append(draw(gl, scene, technique, EYE))
    assert np.abs(images[0] - images[1]).max() <= 2
    assert np.ptp(images[0][..., 0]) > 50


def count(device: rhi.Device, scene: Scene, technique: Technique) -> tuple[list[str], int]:
    """The passes of the plan, and the draws of a frame."""
    with Renderer(device, scene, technique=technique, visibility="none", size=SIZE) as renderer:
        renderer.render(EYE)
        device.stream.clear()
        renderer.render(EYE)
        return [frame_pass.name for frame_pass in renderer.plan(EYE)[1].passes], len(device.stream.draws())


@pytest.mark.parametrize("objects", [1, 20])
def test_a_light_draws_no_object_again(null: rhi.Device, objects: int) -> None:
    names, draws = count(null, make_lit_boxes(9, 5, boxes=objects), ForwardMultipass(light_volumes=True))
    assert names == ["geometry", "base", "point lights", "spot lights", "resolve"]
    more, same = count(null, make_lit_boxes(1, 1, boxes=objects), ForwardMultipass(light_volumes=True))
    assert (more, same) == (names, draws)


def test_without_local_lights_it_is_forward_shading(null: rhi.Device) -> None:
    names, draws = count(null, make_lit_boxes(), ForwardMultipass(light_volumes=True))
    assert (names, draws) == count(null, make_lit_boxes(), Forward())


def test_materials_that_no_geometry_buffer_has_room_for_are_drawn_again_for_each_light(
    null: rhi.Device,
) -> None:
    def make(is_brushed: bool) -> Scene:
        values = {"shader": Brushed, "anisotropy": 0.5, "metallic": 1.0} if is_brushed else {}
        builder = make_boxes((0, 0, 0), **values)
        builder.lights.add_point((0.0, 1.5, 0.0), 3.0)
        return builder.build()

    technique = ForwardMultipass(light_volumes=True)
    assert [count(null, make(is_brushed), technique)[0][0] for is_brushed in (False, True)] == [
        "geometry",
        "base",
    ]
