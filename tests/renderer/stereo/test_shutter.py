"""Eyes that take turns, for shutter glasses: each frame is that of one eye."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
import pytest
from frames import open_renderer as open_any

import rhi
from renderer.content.shapes import BUILT_IN
from renderer.frame import TemporalSettings
from renderer.scene import Camera, Scene, SceneBuilder, StereoRig, translation
from renderer.stereo import OUTPUTS, SHUTTER, Stereo
from rhi import Op

SIZE: Final = (96, 54)
RIG: Final = StereoRig(0.3, 6.0)
TURNS: Final = Stereo(RIG, SHUTTER)
BOTH: Final = Stereo(RIG, "interlaced")
open_renderer = partial(open_any, size=SIZE, visibility="frustum")


def test_each_frame_is_that_of_one_eye_in_turn(drawing_device: rhi.Device, city: Scene) -> None:
    camera = city.paths["ground"].camera(600)
    with open_renderer(drawing_device, city) as renderer:
        renderer.stereo = BOTH
        eyes = [image.read() for image in renderer.render(camera, 10.0).eye_images]
        assert not np.array_equal(*eyes)
        renderer.stereo = TURNS
        for turn in (0, 1, 0, 1):
            result = renderer.render(camera, 10.0)
            assert result.eye == turn
            assert np.array_equal(result.image.read(), eyes[turn])
            assert len(result.eye_images) == 1


def test_frames_with_both_eyes_or_with_one_are_shown_to_no_eye_alone(device: rhi.Device, city: Scene) -> None:
    camera = city.paths["ground"].camera(600)
    with open_renderer(device, city) as renderer:
        for stereo, eye in ((None, None), (BOTH, None), (TURNS, 0)):
            renderer.stereo = stereo
            assert renderer.render(camera).eye == eye


def test_swapped_eyes_take_each_other_s_turns(gl: rhi.Device, city: Scene) -> None:
    camera = city.paths["ground"].camera(600)
    with open_renderer(gl, city) as renderer:
        renderer.stereo = BOTH
        left, right = (image.read() for image in renderer.render(camera, 10.0).eye_images)
        renderer.stereo = replace(TURNS, is_swapped=True)
        for eye, expected in enumerate((right, left)):
            result = renderer.render(camera, 10.0)
            assert result.eye == eye
            assert np.array_equal(result.image.read(), expected)


@pytest.mark.parametrize("algorithm", ["frustum", "two_pass"])
def test_a_frame_issues_the_commands_of_one_eye(null: rhi.Device, city: Scene, algorithm: str) -> None:
    camera = city.paths["ground"].camera(600)
    counts = {}
    with open_any(null, city, visibility=algorithm, size=SIZE) as renderer:
        for stereo in (None, TURNS, BOTH):
            renderer.stereo = stereo
            for _ in range(4):  # what is created at first isn't counted
                renderer.render(camera, 10.0)
            null.stream.clear()
            renderer.render(camera, 10.0)
            ops = [command.op for command in null.stream]
            counts[stereo] = [ops.count(op) for op in (Op.BEGIN_PASS, Op.DRAW, Op.DRAW_INDIRECT, Op.DISPATCH)]
    assert counts[TURNS] == counts[None]
    assert sum(counts[BOTH]) > sum(counts[None])


def make_slide() -> tuple[Scene, int]:
    """Make a box at a node that moves, before a wall that doesn't; return the scene and the node."""
    builder = SceneBuilder("slide")
    mesh = builder.add_mesh(BUILT_IN["box"]())
    bright = builder.add_material(base_color=(0.9, 0.9, 0.9, 1.0))
    dark = builder.add_material(base_color=(0.03, 0.05, 0.1, 1.0))
    node = builder.add_node(dynamic=True)
    builder.add_objects(node, mesh, bright)
    builder.add_objects(
        builder.add_nodes(translation(np.array([[x, 0.0, -3.0] for x in range(-4, 5)]))), mesh, dark
    )
    builder.lights.sky = builder.lights.ground = (1.0, 1.0, 1.0)
    return builder.build(), node


def test_histories_of_eyes_that_take_turns_are_their_own(gl: rhi.Device) -> None:
    """Each eye shows what a camera of its own shows that is drawn in every second frame: also the trail of a box
    that moves, which a history of the other eye's frame would leave."""
    camera = Camera.look_at((0.0, 0.8, 5.0), (0.0, 0.0, 0.0))
    settings = TemporalSettings(is_on=True)

    def move(scene: Scene, node: int, number: int) -> None:
        scene.nodes.set_local([node], translation((0.08 * number - 0.6, 0.0, 0.0))[None])

    scene, node = make_slide()
    with open_renderer(gl, scene, temporal=settings) as renderer:
        renderer.stereo = TURNS
        in_turn = []
        for number in range(12):
            move(scene, node, number)
            in_turn.append(renderer.render(camera, number / 120.0).image.read())
    for eye in (0, 1):
        scene, node = make_slide()
        with open_renderer(gl, scene, temporal=settings) as renderer:
            renderer._sample_index = eye
            for number in range(eye, 12, 2):
                move(scene, node, number)
                eye_camera = RIG.place_eyes(camera.with_aspect(SIZE[0] / SIZE[1]))[eye]
                image = renderer.render(eye_camera, number / 120.0).image.read()
                renderer._sample_index += 1  # the other eye's frame has the sample between
                assert np.array_equal(in_turn[number], image), number
    assert not np.array_equal(in_turn[-1], in_turn[-3]), "the box moves"


def test_an_eye_that_takes_turns_is_not_reprojected() -> None:
    with pytest.raises(rhi.ValidationError) as error:
        replace(TURNS, is_reprojected=True)
    assert error.value.rule.id == "stereo-bad-value"
    for output in OUTPUTS:
        if output != SHUTTER:
            assert Stereo(RIG, output, is_reprojected=True).takes_turns is False
