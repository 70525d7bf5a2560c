"""Layers on the screen, drawn once for both eyes; and particles, uploaded once."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import numpy as np
import pytest
from frames import open_renderer as open_any
from numpy.typing import NDArray

import rhi
from renderer.content import load_scene
from renderer.frame import Frame, ScreenLayer
from renderer.frame.layer import ClearColor
from renderer.layers.canvas import Canvas, Font, srgb
from renderer.layers.overlay import Overlay
from renderer.layers.particles import Particles
from renderer.scene import Scene, StereoRig
from renderer.stereo import ANAGLYPHS, OUTPUTS, SHUTTER, Stereo, eye_image_size, mix_anaglyph
from rhi import Op, Texture

SIZE: Final = (97, 55)  # odd: neither halves evenly
RIG: Final = StereoRig(0.3, 6.0)
open_renderer = partial(open_any, visibility="frustum")


class Badge(ScreenLayer):
    """A rectangle that covers half of what is behind it, and one that covers all of it."""

    def __init__(self, device: rhi.Device) -> None:
        self._canvas = Canvas(device, Font.load())
        self.sizes: list[tuple[int, int]] = []

    def draw(self, device: rhi.Device, frame: Frame, image: Texture, clear: ClearColor | None = None) -> None:
        self.sizes.append(image.size)
        self._canvas.rect(3, 5, 30, 20, srgb("#40a0e0", 0.5))
        self._canvas.rect(10, 30, 12, 9, srgb("#e0c020"))
        with device.render_pass(image, clear=clear):
            self._canvas.draw(image.size)

    def destroy(self) -> None:
        self._canvas.destroy()


def cover(image: NDArray[Any], output: str) -> NDArray[np.float64]:
    """An image (h, w, 4) in levels with the badge over it, computed in float64: for the halves of two eyes, on both."""
    light = _to_linear(image[..., :3])
    width, height = eye_image_size(output, (image.shape[1], image.shape[0]))
    for x, y, w, h, color, alpha in ((3, 5, 30, 20, "#40a0e0", 0.5), (10, 30, 12, 9, "#e0c020", 1.0)):
        shade = srgb(color)[:3].astype(np.float64)
        if output in ANAGLYPHS:
            left, right = ANAGLYPHS[output]
            shade = (left + right) @ shade
        for top in range(0, image.shape[0], height):
            for start in range(0, image.shape[1], width):
                part = light[top : top + height, start : start + width][y : y + h, x : x + w]
                part[:] = part * (1.0 - alpha) + shade * alpha
    return np.asarray(np.round(_to_levels(np.clip(light, 0.0, 1.0))))


def _to_linear(levels: NDArray[Any]) -> NDArray[np.float64]:
    share = levels / 255.0
    return np.asarray(np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4))


def _to_levels(light: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(255.0 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055))


@pytest.mark.parametrize("output", [name for name in OUTPUTS if name != SHUTTER])
def test_a_layer_of_the_screen_covers_the_image_of_both_eyes(
    drawing_device: rhi.Device, city: Scene, output: str
) -> None:
    camera = city.paths["ground"].camera(600)
    with open_renderer(drawing_device, city, size=SIZE) as renderer:
        renderer.stereo = Stereo(RIG, output)
        first = renderer.render(camera, 10.0)
        plain, eyes_before = first.image.read(), [eye.read() for eye in first.eye_images]
        renderer.layers.append(badge := Badge(drawing_device))
        result = renderer.render(camera, 10.0)
        image, eyes = result.image.read(), [eye.read() for eye in result.eye_images]
        badge.destroy()
    expected = cover(plain, output)
    assert np.abs(expected - plain[..., :3]).max() > 50
    assert np.abs(image[..., :3] - expected).max() <= 1.0
    assert np.array_equal(eyes, eyes_before), "none is on an eye's"
    if output in ANAGLYPHS:
        mixed = np.round(_to_levels(mix_anaglyph(output, *(_to_linear(eye[..., :3]) for eye in eyes))))
        assert np.abs(mixed - plain[..., :3]).max() <= 1.0


@pytest.mark.parametrize(
    ("output", "passes", "draws"),
    [("color", 1, 1), ("interlaced", 1, 1), ("dubois", 2, 2), ("side_by_side", 2, 2)],
)
def test_a_layer_of_the_screen_is_drawn_once(
    null: rhi.Device, city: Scene, output: str, passes: int, draws: int
) -> None:
    """Where it needs a texture of its own, that is drawn over both halves by one draw."""
    streams = []
    for layers in (False, True):
        with open_renderer(null, city, size=SIZE) as renderer:
            renderer.stereo = Stereo(RIG, output)
            badge = Badge(null)
            if layers:
                renderer.layers.append(badge)
            camera = city.paths["ground"].camera(600)
            for _ in range(3):
                begin = len(null.stream)
                renderer.render(camera, 10.0)
            streams.append(null.stream[begin:])
            badge.destroy()
    plain, covered = streams
    assert len(covered.filter(Op.BEGIN_PASS)) - len(plain.filter(Op.BEGIN_PASS)) == passes
    assert len(covered.filter(Op.DRAW)) - len(plain.filter(Op.DRAW)) == draws
    assert badge.sizes == [eye_image_size(output, SIZE) if passes == 2 else SIZE] * 3


def test_the_overlay_of_two_eyes_uploads_and_draws_as_much_as_that_of_one(
    null: rhi.Device, city: Scene
) -> None:
    counts = []
    for stereo in (None, Stereo(RIG, "color")):
        with open_renderer(null, city, size=(960, 540)) as renderer:
            renderer.stereo = stereo
            overlay = Overlay(null, is_timed=False)
            renderer.layers.append(overlay)
            camera = city.paths["ground"].camera(600)
            for _ in range(3):
                before = null.statistics
                counted = renderer.render(camera, 10.0).statistics.upload_bytes
            counts.append((overlay.draws, null.statistics.upload_bytes - before.upload_bytes - counted))
            overlay.destroy()
    assert counts[0][1] > 1000
    assert counts[0] == counts[1]


def test_a_reprojected_eye_moves_depth_for_layers_in_the_scene_alone(null: rhi.Device, city: Scene) -> None:
    passes = []
    for kind in (None, Badge, Particles):
        with open_renderer(null, city, size=SIZE) as renderer:
            renderer.stereo = Stereo(RIG, "color", is_reprojected=True)
            layer: Any = kind and kind(null)
            renderer.layers += [layer] if layer else []
            begin = len(null.stream)
            renderer.render(city.paths["ground"].camera(600))
            passes.append(len(null.stream[begin:].filter(Op.BEGIN_PASS)))
            if layer:
                layer.destroy()
    assert passes == [1, 2, 2], "the badge's own, or that of the moved depth"


@pytest.fixture(scope="module")
def fountains() -> Scene:
    return load_scene("hall:columns=6,rows=2,flags=0,fountains=4")


def test_particles_are_uploaded_once_for_both_eyes(null: rhi.Device, fountains: Scene) -> None:
    counts = []
    for stereo in (None, Stereo(RIG, "color")):
        with open_renderer(null, fountains, size=SIZE) as renderer:
            renderer.stereo = stereo
            layer = Particles(null)
            renderer.layers.append(layer)
            renderer.render(fountains.views["overview"], 1.0)
            before = null.statistics
            counted = renderer.render(fountains.views["overview"], 1.1).statistics.upload_bytes
            counts.append((layer.count, null.statistics.upload_bytes - before.upload_bytes - counted))
            layer.destroy()
    assert counts[0][0] > 50
    assert all(uploaded == 32 * count for count, uploaded in counts)


def test_each_eye_sees_particles_where_it_would_alone(drawing_device: rhi.Device, fountains: Scene) -> None:
    """To a rounding of their positions relative to the left eye."""
    camera = fountains.views["overview"]
    with open_renderer(drawing_device, fountains, size=(192, 108)) as renderer:
        layer = Particles(drawing_device)
        renderer.stereo = Stereo(RIG, "color")
        without = [image.read().astype(int) for image in renderer.render(camera, 1.0).eye_images]
        renderer.layers.append(layer)
        together = [image.read().astype(int) for image in renderer.render(camera, 1.0).eye_images]
        renderer.stereo = None
        alone = [renderer.render(eye, 1.0).image.read().astype(int) for eye in RIG.place_eyes(camera)]
        layer.destroy()
    assert all((with_ != plain).any(2).sum() > 50 for with_, plain in zip(together, without, strict=True))
    assert np.array_equal(together[0], alone[0])
    assert np.abs(together[1] - alone[1]).max() <= 1
