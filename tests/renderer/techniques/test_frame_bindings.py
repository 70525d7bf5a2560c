"""`FrameBindings`: each name that a frame's shaders bind, what it is refused for, and that nothing else is
made."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from frames import EYE, make_lit_boxes, open_renderer

import rhi
import rhi.shading as sl
from renderer.frame import DEPTH_FORMAT, IMAGE_FORMAT, Frame, FrameEffects, FramePass, Target
from renderer.frame.scene_images import MAX_ARRAYS
from renderer.shaders.materials import MaterialShader
from renderer.shaders.pixels import BackgroundScreen
from renderer.techniques.parts.frame_bindings import BINDINGS, FrameBindings
from renderer.techniques.parts.variants import draw_full_screen


class OnePass:
    """A technique that runs a function in its only pass."""

    name = "one_pass"

    def __init__(self, run: Callable[[Frame], None]) -> None:
        self._run = run

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The only pass."""
        targets = Target("image", IMAGE_FORMAT), Target("depth", DEPTH_FORMAT)
        return (FramePass("test", self._run, "was asked for", writes=targets),)


def run_in_frame(device: rhi.Device, run: Callable[[Frame], None]) -> None:
    """Run a function with a frame of lit boxes without fog, shadows or images."""
    with open_renderer(device, make_lit_boxes(points=1), OnePass(run)) as renderer:
        renderer.render(EYE)


class FogReader(BackgroundScreen):
    """Binds a name that no frame has."""

    fogg: sl.Texture2D

    def fragment(self) -> sl.vec4:
        return self.fogg.load(sl.ivec2(0))


def test_an_unknown_name_is_refused_with_the_nearest_one(null: rhi.Device) -> None:
    def draw(frame: Frame) -> None:
        draw_full_screen(frame, FogReader, frame.targets["image"])

    with pytest.raises(rhi.ValidationError, match="technique-missing-binding") as error:
        run_in_frame(null, draw)
    assert "did you mean 'fog'?" in str(error.value)


@pytest.mark.parametrize("name", ["fog", "surface_samples", "images", "maps_3", "textures", "shadow_atlas"])
def test_a_name_that_this_frame_has_nothing_for_is_refused(null: rhi.Device, name: str) -> None:
    def read(frame: Frame) -> None:
        FrameBindings(frame)[name]

    with pytest.raises(rhi.ValidationError, match="technique-missing-binding") as error:
        run_in_frame(null, read)
    assert name in str(error.value)


def test_a_name_has_the_resource_of_its_attribute(null: rhi.Device) -> None:
    checked = []

    def read(frame: Frame) -> None:
        bindings = FrameBindings(frame)
        assert bindings["view"] is bindings.view is frame.view.buffer
        assert bindings["depth"] is bindings.depth is frame.targets["depth"]
        assert bindings["point_lights"] is frame.resources.local_lights["point"].buffer
        checked.append(True)

    run_in_frame(null, read)
    assert checked


def test_every_binding_of_materials_has_a_name() -> None:
    arrays = {f"{kind}_{i}" if i else kind for kind in ("images", "maps") for i in range(MAX_ARRAYS)}
    assert arrays <= set(BINDINGS)
    assert {binding for binding in MaterialShader.__annotations__ if binding in arrays} == arrays
    assert {"view", "materials", "textures"} <= set(BINDINGS)
