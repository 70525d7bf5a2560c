"""Two passes: the first guesses by the last frame's depth, the second corrects the guess."""

from __future__ import annotations

import numpy as np
import pytest
from occlusion_scenes import draw_with, make_boxes, make_camera, visible

import rhi
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.visibility import FrustumCulling, NoCulling, TwoPassCulling, list_visible_objects
from rhi import Op

SIZE = (96, 54)
EYE, AIM = (0.0, 0.0, 0.0), (0.0, 0.0, -5.0)
WALL_POSITION = ((0.0, 0.0, -40.0), (200.0, 200.0, 1.0))


def follow(
    device: rhi.Device, scene: Scene, cameras: list[Camera], size: tuple[int, int] = SIZE
) -> list[tuple[set[int], set[int]]]:
    """Return both lists of each frame."""
    algorithm, lists = TwoPassCulling(scene, device), []
    with Renderer(device, scene, size=size) as renderer:
        for camera in cameras:
            visible(draw_with(renderer, algorithm, camera))
            lists.append(
                (set(algorithm.first.read_object_indices()), set(algorithm.second.read_object_indices()))
            )
    algorithm.destroy()
    return lists


def position_on_screen(x: float, y: float, distance: float, camera: Camera) -> tuple[float, float, float]:
    """Return the point at pixel (x, y) of the image at a given distance."""
    matrix = camera.with_aspect(SIZE[0] / SIZE[1]).projection.matrix
    right = (2.0 * x / SIZE[0] - 1.0) / matrix[0, 0]
    up = (1.0 - 2.0 * y / SIZE[1]) / matrix[1, 1]
    return (right * distance, up * distance, -distance)


@pytest.mark.parametrize(("x", "list_number"), [(42.0, 0), (44.0, 1)])
def test_a_box_that_covers_no_texels_centre_is_on_the_second_list(
    device: rhi.Device, x: float, list_number: int
) -> None:
    # Centres of texels of 4 x 4 pixels are at 2, 6, 10 …; the box covers 2 pixels around x, and 26 is such a
    # row.
    camera = make_camera(EYE, AIM)
    scene = make_boxes(
        [WALL_POSITION[0], position_on_screen(x, 26.0, 10.0, camera)], [WALL_POSITION[1], (0.5, 0.5, 0.1)]
    )
    scene.objects.mesh[:] = 0
    with Renderer(device, scene, size=SIZE) as renderer:
        covered = draw_with(renderer, NoCulling(scene), camera).depth.read() > 0.1 / 11.0
        assert 0 < covered.sum() <= 16
    for lists in follow(device, scene, [camera] * 3)[1:]:
        assert lists[list_number] >= {1}
        assert lists[1 - list_number] <= {0}


def test_while_nothing_moves_the_second_list_is_empty(device: rhi.Device) -> None:
    rng = np.random.default_rng(2)
    scene = make_boxes(rng.uniform(-9.0, 9.0, (40, 3)), rng.uniform(1.5, 3.0, (40, 3)))
    lists = follow(device, scene, [make_camera((0.0, 0.0, 20.0), (0.0, 0.0, 0.0))] * 4, (320, 180))
    assert lists[3][1] == set()
    assert 3 < len(lists[3][0]) < 40


def test_little_is_missed_on_a_walk_and_less_is_drawn(device: rhi.Device) -> None:
    city = load_scene("city:blocks=16,detail=2")
    aspect = 320 / 180
    cameras = [city.paths["ground"].camera(frame).with_aspect(aspect) for frame in range(300, 320)]
    lists = follow(device, city, cameras, (320, 180))
    in_view = sum(len(list_visible_objects(FrustumCulling(city), camera)) for camera in cameras[1:])
    assert sum(len(second) for _, second in lists[1:]) < 0.1 * in_view
    assert sum(len(first) + len(second) for first, second in lists[1:]) < 0.5 * in_view


def test_boxes_are_drawn_in_one_call_each_at_a_quarter_and_at_full_resolution(null: rhi.Device) -> None:
    scene = make_boxes(np.random.default_rng(1).uniform(-5, 5, (30, 3)), np.ones((30, 3)))
    algorithm, camera = TwoPassCulling(scene, null), make_camera((0.0, 0.0, 12.0), (0.0, 0.0, 0.0))
    with Renderer(null, scene, size=(99, 55)) as renderer:
        draw_with(renderer, algorithm, camera)
        null.stream.clear()
        draw_with(renderer, algorithm, camera)
        passes = [command["descriptor"] for command in null.stream.filter(Op.BEGIN_PASS)]
        boxes = [
            command
            for command in null.stream.draws()
            if command.resource(command.program).name.startswith("Mark")
        ]
    # Reprojected depth, the scene, the boxes that were left, the scene again.
    assert [(render_pass.size, len(render_pass.colors)) for render_pass in passes] == [
        ((25, 14), 0), ((99, 55), 1), ((99, 55), 0), ((99, 55), 1),
    ]  # fmt: skip
    assert passes[1].depth.clear == 0.0
    assert [render_pass.depth.clear for render_pass in passes[2:]] == [None, None]
    assert [command.op for command in boxes] == [Op.DRAW, Op.DRAW_INDIRECT]
    assert boxes[0]["instances"] == 30
    for command in boxes:
        assert command.states[rhi.DepthWrite] is rhi.DepthWrite.OFF
        assert command.states[rhi.DepthFunction] is rhi.DepthFunction.GREATER_EQUAL


class SingleDraws(TwoPassCulling):
    """Culling whose lists have a draw for each object."""

    has_instances = False


def test_instances_are_drawn_as_objects_one_by_one_are(device: rhi.Device) -> None:
    """To the last bit, in one draw for each list."""
    scene, images, depths, draws = load_scene("grid:mesh=box,count=100"), [], [], []
    camera = (
        scene.views["overview"]
        if "overview" in scene.views
        else make_camera((9.0, 9.0, 14.0), (0.0, 0.0, 0.0))
    )
    for kind in (SingleDraws, TwoPassCulling):
        algorithm = kind(scene, device)
        with Renderer(device, scene, size=SIZE) as renderer:
            for _ in range(2):
                result = draw_with(renderer, algorithm, camera)
            images.append(result.image.read())
            depths.append(result.depth.read())
            listed = len(algorithm.first.read_object_indices())
            draws.append((listed, int(algorithm.first.totals.read()[:-1].sum())))
        algorithm.destroy()
    assert images[0].std() > 5.0
    assert np.array_equal(images[0], images[1])
    assert np.array_equal(depths[0], depths[1])
    assert draws[0][0] == draws[0][1] == draws[1][0] > 50
    assert draws[1][1] == 1


def test_passes_that_write_the_index_of_an_object_write_that_of_listed_ones(gl: rhi.Device) -> None:
    """`forward_multipass` pairs the objects that it sees with their lights."""
    scene, images = load_scene("city:blocks=4,detail=2"), []
    for visibility in ("frustum", "two_pass"):
        with Renderer(gl, scene, size=SIZE, visibility=visibility, technique="forward_multipass") as renderer:
            images.append(renderer.render(scene.paths["ground"].camera(100), 1.0).image.read())
    assert images[0].std() > 5.0
    assert np.array_equal(images[0], images[1])
