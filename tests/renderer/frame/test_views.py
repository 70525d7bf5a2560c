"""Views: several passes of one view, and several views in one frame."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import numpy as np
import pytest
from frames import open_renderer as open_any
from frames import require_algorithm
from nightly_reasons import FEWER_CASES

import rhi
from renderer.frame import (
    DEPTH_FORMAT,
    IMAGE_FORMAT,
    BoundProgram,
    Frame,
    FrameEffects,
    FramePass,
    SceneResources,
    Target,
    TechniqueDrawer,
    View,
)
from renderer.scene import Camera, Scene
from renderer.shaders import ViewConstants
from renderer.shaders.depth import DepthOnly
from renderer.techniques import Forward
from renderer.techniques.parts.scene_shader import ForwardShader
from renderer.techniques.parts.variants import bind, shader_variant
from renderer.visibility import FrustumCulling
from rhi import DepthFunction, DepthWrite, Format
from rhi.backends.null import NullBackend

SIZE: Final = (96, 54)
open_renderer = partial(open_any, size=SIZE)
FRAMES: Final = (600, 601, 602)


def draw_depth(frame: Frame, view: View, depth: rhi.Texture) -> None:
    arrays = frame.resources.scene_arrays(view.buffer)
    bindings: dict[str, Any] = {
        "view": arrays.view,
        "objects": arrays.objects,
        "object_positions": arrays.object_positions,
    }
    program: Any = frame.device.program(DepthOnly)
    drawer = TechniqueDrawer(
        frame.device, frame.resources, view, [BoundProgram(program, bindings)], color=None, depth=depth
    )
    frame.draw_visible(drawer, view)


class DepthFirst:
    """Draws depth, then what is at that depth."""

    name = "depth first"

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        return (
            FramePass(
                "depth", self._draw_depth, "hides what isn't seen", writes=(Target("depth", DEPTH_FORMAT),)
            ),
            FramePass(
                "lit", self._draw_lit, "lights what is seen", ("depth",), (Target("image", IMAGE_FORMAT),)
            ),
        )

    def _draw_depth(self, frame: Frame) -> None:
        draw_depth(frame, frame.view, frame.targets.depth)

    def _draw_lit(self, frame: Frame) -> None:
        program = frame.program(shader_variant(frame, ForwardShader))
        bindings = bind(frame, program, {})
        frame.draw_visible(
            TechniqueDrawer(
                frame.device,
                frame.resources,
                frame.view,
                [BoundProgram(program, bindings)],
                color=frame.targets.image,
                depth=frame.targets.depth,
                clears=False,
                clear=(*frame.resources.scene.background, 1.0),
                states=(DepthFunction.EQUAL, DepthWrite.OFF),
            )
        )


@pytest.mark.nightly_cases(
    "cl-frustum", "cl-chc_plus_plus", "cl-depth_pyramid", "cl-two_pass", "cl-conditional", reason=FEWER_CASES
)
@pytest.mark.parametrize(
    "name", ["none", "frustum", "chc_plus_plus", "conditional", "depth_pyramid", "two_pass"]
)
def test_two_passes_of_a_view_draw_the_same_image_as_one(
    drawing_device: rhi.Device, city: Scene, name: str
) -> None:
    require_algorithm(drawing_device, name)
    images = []
    for technique in (Forward(), DepthFirst()):
        with open_renderer(drawing_device, city, technique, visibility=name) as renderer:
            for frame in FRAMES:
                result = renderer.render(city.paths["ground"].camera(frame), frame / 60)
            images.append((result.image.read(), result.depth.read()))
    (lit, depth), (later, first) = images
    assert np.array_equal(depth, first)
    assert np.abs(lit.astype(int) - later).max() <= 0
    assert lit[:, :, :3].std() > 20


@pytest.mark.parametrize("name", ["frustum", "chc", "chc_plus_plus"])
def test_a_view_asks_once_however_many_passes_draw_it(null: rhi.Device, city: Scene, name: str) -> None:
    null.backend_as(NullBackend).answer_queries(100)
    counts = []
    for technique in (Forward(), DepthFirst()):
        with open_renderer(null, city, technique, visibility=name) as renderer:
            statistics = [renderer.render(city.paths["ground"].camera(frame)).statistics for frame in FRAMES]
        counts.append([(counted.queries, counted.draws, counted.triangles) for counted in statistics])
    assert counts[0] == counts[1]
    assert name == "frustum" or sum(queries for queries, _, _ in counts[0]) > 0


def test_a_second_pass_of_a_view_is_one_draw_of_all_batches(null: rhi.Device, city: Scene) -> None:
    null.backend_as(NullBackend).answer_queries(100)
    with open_renderer(null, city, DepthFirst(), visibility="chc") as renderer:
        null.stream.clear()
        result = renderer.render(city.paths["ground"].camera(600))
        lit = [draw for draw in null.stream.draws() if draw.labels[0] == "lit"]
        batches = [draw for draw in null.stream.draws() if draw.labels[0] == "depth"]
    assert len(lit) == 1
    assert len(batches) > 1
    assert lit[0]["draws"] == len(result.visible) > 1


class FromAbove:
    """Draws the image, and depth as it is seen from above."""

    name = "from above"

    def __init__(self) -> None:
        self.above: View | None = None
        self.rows: np.ndarray = np.zeros(0, np.int64)

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        map_depth = Target("map", Format.D32F, 0.5)
        above = FramePass(
            "above", self._draw_above, "shows a map", writes=(map_depth,), has_side_effects=True
        )
        return (above, *Forward().declare(effects))

    def _draw_above(self, frame: Frame) -> None:
        assert self.above is not None
        draw_depth(frame, self.above, frame.targets["map"])
        self.rows = frame._seen[self.above].draw_result.object_indices


def test_each_view_culls_for_its_own_camera(null: rhi.Device, city: Scene) -> None:
    technique = FromAbove()
    street = city.paths["ground"].camera(600).with_aspect(SIZE[0] / SIZE[1])
    down = Camera.look_at(street.position + np.array([0, 60, 0]), street.position).with_aspect(
        SIZE[0] / SIZE[1]
    )
    technique.above = View(null, "above", FrustumCulling(city))
    technique.above.aim(down)
    with open_renderer(null, city, technique, visibility="frustum") as renderer:
        result = renderer.render(street)
    expected = [sees(null, city, camera) for camera in (street, down)]
    assert result.visible.tolist() == expected[0]
    assert technique.rows.tolist() == expected[1]
    assert expected[0] != expected[1]
    assert len(null.stream.draws()) == 2
    technique.above.destroy()


def sees(device: rhi.Device, scene: Scene, camera: Camera) -> list[int]:
    with rhi.create_device("null") as other, open_renderer(other, scene, visibility="frustum") as renderer:
        rows: list[int] = renderer.render(camera).visible.tolist()
        return rows


def test_a_view_uploads_its_constants_when_its_camera_moves(null: rhi.Device, city: Scene) -> None:
    view = View(null, "eye", FrustumCulling(city))
    camera = city.views["overview"]
    view.aim(camera)
    before = null.statistics.upload_bytes
    view.aim(camera)
    assert null.statistics.upload_bytes == before
    view.aim(city.views["street"])
    assert null.statistics.upload_bytes == before + ViewConstants.uniform_dtype.itemsize
    view.destroy()


def test_scene_resources_keep_a_technique_s_workspace_between_frames(null: rhi.Device, city: Scene) -> None:
    resources = SceneResources(null, city)

    class Kept:
        def __init__(self, device: rhi.Device) -> None:
            self.buffer = device.storage(int, 4)
            self.destroyed = False

        def destroy(self) -> None:
            self.buffer.destroy()
            self.destroyed = True

    workspace = resources.workspace(Kept)
    assert resources.workspace(Kept) is workspace
    assert not workspace.destroyed
    resources.destroy()
    assert workspace.destroyed
