"""Frames that are drawn smaller or larger than they are shown: pixels, sizes, layers, passes and memory."""

from __future__ import annotations

import numpy as np
import pytest
from frames import list_owned

import rhi
from renderer.content import load_scene
from renderer.frame import Frame, SceneLayer
from renderer.lab.accuracy.float64 import decode_levels, encode_levels
from renderer.layers.particles import Particles
from renderer.renderer import Renderer
from renderer.scene import Scene, StereoRig
from renderer.settings import RenderSettings
from renderer.stereo import Stereo
from renderer.visibility import NoCulling
from rhi import Op

SIZE = (62, 42)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("grid:count=9")


def open_scaled(device: rhi.Device, scene: Scene, scale: float) -> Renderer:
    renderer = Renderer(device, scene, visibility=NoCulling(scene), size=SIZE)
    renderer.scale = scale
    return renderer


def stretch(texels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return texels at another size, interpolated between their middles in light, in float64."""
    light = decode_levels(texels[..., :3].astype(np.float64))
    for axis, size in ((0, height), (1, width)):
        position = np.clip((np.arange(size) + 0.5) * light.shape[axis] / size - 0.5, 0, light.shape[axis] - 1)
        first = np.minimum(position.astype(int), light.shape[axis] - 2)
        part = (position - first).reshape(-1, *[1] * (2 - axis))
        light = light.take(first, axis) * (1.0 - part) + light.take(first + 1, axis) * part
    return encode_levels(light)


@pytest.mark.parametrize(("scale", "drawn"), [(0.5, (31, 21)), (0.7, (44, 30)), (2.0, (124, 84))])
def test_a_scaled_image_is_the_drawn_image_interpolated_in_linear_light(
    drawing_device: rhi.Device, scene: Scene, scale: float, drawn: tuple[int, int]
) -> None:
    with open_scaled(drawing_device, scene, scale) as renderer:
        result = renderer.render(scene.views["overview"])
        output, texels = result.image.read()[..., :3], result.targets["image"].read()
    assert (texels.shape[1], texels.shape[0]) == result.depth.size == drawn
    assert len(np.unique(texels.reshape(-1, 4), axis=0)) > 50, "the scene is seen"
    off = np.abs(output - stretch(texels, *SIZE))
    assert off.max() <= 2.0, "weights of samplers have 8 bits"
    assert off.mean() < 0.3


def test_an_image_of_twice_the_size_is_shown_as_means_of_four_pixels(
    drawing_device: rhi.Device, scene: Scene
) -> None:
    with open_scaled(drawing_device, scene, 2.0) as renderer:
        result = renderer.render(scene.views["overview"])
        output, texels = result.image.read()[..., :3], result.targets["image"].read()[..., :3]
    light = decode_levels(texels.astype(np.float64)).reshape(SIZE[1], 2, SIZE[0], 2, 3).mean(axis=(1, 3))
    assert np.abs(output - encode_levels(light)).max() <= 1.0


def test_scaling_is_one_draw_and_none_at_the_size_that_is_shown(null: rhi.Device, scene: Scene) -> None:
    counts = {}
    for scale in (1.0, 0.5):
        with open_scaled(null, scene, scale) as renderer:
            renderer.render(scene.views["overview"])
            begin = len(null.stream)
            renderer.render(scene.views["overview"])
            frame = null.stream[begin:]
            counts[scale] = len(frame.filter(Op.BEGIN_PASS)), len(frame.filter(Op.DRAW))
    assert counts[0.5] == (counts[1.0][0] + 1, counts[1.0][1] + 1)


class SizesOfTargets:
    """A layer that notes the sizes of the image and of the depth."""

    def __init__(self) -> None:
        self.seen: list[tuple[tuple[int, int], tuple[int, int]]] = []

    def render(self, device: rhi.Device, frame: Frame) -> None:
        self.seen.append((frame.targets.image.size, frame.targets.depth.size))

    def destroy(self) -> None:
        pass


class SceneSizes(SizesOfTargets, SceneLayer):
    """The same of the scene, for which the image is not brought to its size yet."""

    def render(self, device: rhi.Device, frame: Frame) -> None:
        self.seen.append((frame.targets["image"].size, frame.targets.depth.size))


@pytest.mark.parametrize("eyes", [1, 2])
def test_layers_of_the_scene_come_before_the_image_is_scaled_and_others_after_it(
    null: rhi.Device, scene: Scene, eyes: int
) -> None:
    over, inside = SizesOfTargets(), SceneSizes()
    with open_scaled(null, scene, 0.5) as renderer:
        renderer.stereo = Stereo(StereoRig(), "side_by_side") if eyes == 2 else None
        renderer.layers += [over, inside]
        assert renderer.render(scene.views["overview"]).image.size == SIZE
    width = SIZE[0] // eyes
    drawn = (-(-width // 2), SIZE[1] // 2)
    assert (over.seen, inside.seen) == ([((width, SIZE[1]), drawn)] * eyes, [(drawn, drawn)] * eyes)


def test_particles_are_drawn_with_the_depth_of_a_smaller_image(drawing_device: rhi.Device) -> None:
    hall = load_scene("hall:columns=4,rows=2,flags=0,fountains=4")
    with open_scaled(drawing_device, hall, 0.5) as renderer:
        for seconds in (0.0, 0.1):
            without = renderer.render(hall.views["overview"], seconds).image.read()
        renderer.layers.append(Particles(drawing_device))
        assert (renderer.render(hall.views["overview"], 0.1).image.read() != without).any()
        renderer.layers[0].destroy()


def test_a_scale_that_ends_leaves_no_texture(null: rhi.Device, scene: Scene) -> None:
    counts = []
    with open_scaled(null, scene, 1.0) as renderer:
        for renderer.scale in (1.0, 0.5, 1.0):
            renderer.render(scene.views["overview"])
            counts.append(sum(command.op is Op.CREATE_TEXTURE for command in list_owned(null)[1]))
    assert counts == [counts[0], counts[0] + 1, counts[0]]


@pytest.mark.parametrize("scale", [0.1, 2.0])
@pytest.mark.parametrize("beyond", [0.099, 2.01, float("nan"), 0.0, -1.0])
def test_scales_out_of_range_are_refused(null: rhi.Device, scene: Scene, scale: float, beyond: float) -> None:
    with open_scaled(null, scene, scale) as renderer:
        with pytest.raises(rhi.ValidationError, match="render-scale"):
            renderer.scale = beyond
        assert renderer.scale == scale
    with pytest.raises(rhi.ValidationError, match="render-scale"):
        RenderSettings(scale=beyond)
