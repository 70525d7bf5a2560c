"""Frames that one function repeats leave out nothing that a technique or a visibility algorithm does by itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rhi
from renderer.content import load_scene
from renderer.frame import Frame, FrameEffects, FramePass
from renderer.renderer import Renderer
from renderer.scene import Camera
from renderer.techniques import Forward
from renderer.visibility import FrustumCulling

FRAMES = 6


class CountingForward:
    """Forward shading whose pass counts its frames, too."""

    name = "counting"
    frame_count = 0

    def declare(self, effects: FrameEffects) -> Sequence[FramePass[Frame]]:
        first, *others = Forward().declare(effects)

        def run(draw: Callable[[Frame], None]) -> Callable[[Frame], None]:
            def count_and_draw(frame: Frame) -> None:
                self.frame_count += 1
                draw(frame)

            return count_and_draw

        return replace(first, run=run(first.run)), *others


class CountingCulling(FrustumCulling):
    """Frustum culling that counts its frames."""

    frame_count = 0

    def render(self, camera: Camera, scene_drawer: Any) -> Any:
        self.frame_count += 1
        return super().render(camera, scene_drawer)


def draw_frames(renderer: Renderer) -> None:
    """Draw frames between which only the camera moves."""
    camera = next(iter(renderer.scene.views.values()))
    for number in range(FRAMES):
        renderer.render(replace(camera, position=camera.position + np.array([0.01 * number, 0.0, 0.0])))


def count_repeats(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> int:
    """Return the number of frames that are drawn by the function that repeats one."""
    repeats: list[bool] = []
    repeat = Renderer._repeat

    def count_and_repeat(self: Renderer, *arguments: Any) -> Any:
        result = repeat(self, *arguments)
        repeats.append(result is not None)
        return result

    monkeypatch.setattr(Renderer, "_repeat", count_and_repeat)
    draw_frames(renderer)
    return sum(repeats)


def test_frames_of_the_renderers_own_parts_are_repeated(
    null: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene("grid:mesh=box,count=9")
    with Renderer(null, scene, technique=Forward(), visibility=FrustumCulling(scene)) as renderer:
        assert count_repeats(renderer, monkeypatch) > 0


def test_a_pass_that_does_more_than_draw_is_run_in_each_frame(null: rhi.Device) -> None:
    scene = load_scene("grid:mesh=box,count=9")
    technique = CountingForward()
    with Renderer(null, scene, technique=technique, visibility=FrustumCulling(scene)) as renderer:
        draw_frames(renderer)
    assert technique.frame_count == FRAMES


def test_an_algorithm_whose_render_is_replaced_is_asked_in_each_frame(null: rhi.Device) -> None:
    scene = load_scene("grid:mesh=box,count=9")
    culling = CountingCulling(scene)
    with Renderer(null, scene, technique=Forward(), visibility=culling) as renderer:
        draw_frames(renderer)
    assert culling.frame_count == FRAMES


def test_an_algorithm_with_another_render_of_its_own_is_asked_in_each_frame(
    null: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene("grid:mesh=box,count=9")
    culling, frames = FrustumCulling(scene), []
    render = culling.render

    def note_and_render(camera: Camera, scene_drawer: Any) -> Any:
        frames.append(camera)
        return render(camera, scene_drawer)

    monkeypatch.setattr(culling, "render", note_and_render)
    with Renderer(null, scene, technique=Forward(), visibility=culling) as renderer:
        draw_frames(renderer)
    assert len(frames) == FRAMES
