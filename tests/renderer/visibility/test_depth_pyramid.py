"""The pyramid of farthest depths, and tests of boxes against it."""

from __future__ import annotations

import numpy as np
import pytest
from depth_textures import create_depth_texture
from occlusion_scenes import draw_with, make_boxes, make_camera

from renderer.renderer import Renderer
from renderer.scene import Depth
from renderer.shaders import ViewConstants
from renderer.visibility import DepthPyramidCulling
from renderer.visibility.gpu.depth_pyramid import CompareBoxes, make_levels
from renderer.visibility.gpu.farthest_depth import DepthPyramid, depth_variant
from renderer.visibility.gpu.occludees import Occludee
from rhi import Device
from rhi.shading import uint


def reduce_once(depths: np.ndarray, direction: Depth) -> np.ndarray:
    """Compute the farthest of each 4 x 4 in NumPy; what is missing at the edges counts as nearest."""
    far = np.minimum if direction is Depth.REVERSED else np.maximum
    height, width = depths.shape
    padded = np.full((-(-height // 4) * 4, -(-width // 4) * 4), 1.0 if direction is Depth.REVERSED else 0.0)
    padded[:height, :width] = depths
    return far.reduce(far.reduce(padded.reshape(len(padded) // 4, 4, -1, 4), axis=3), axis=1)


@pytest.mark.parametrize("direction", Depth)
@pytest.mark.parametrize("size", [(1, 1), (3, 2), (4, 4), (5, 4), (16, 17), (65, 3), (255, 131), (1023, 767)])
def test_each_level_holds_the_farthest_of_its_pixels(
    device: Device, size: tuple[int, int], direction: Depth
) -> None:
    depths = np.random.default_rng(sum(size)).random(size[::-1], np.float32)
    pyramid = DepthPyramid(device, size)
    pyramid.build(device, create_depth_texture(device, depths), direction)
    farthest = pyramid.farthest.read()
    expected = depths
    for (width, height), begin in zip(pyramid.sizes[1:], pyramid.offsets, strict=True):
        expected = reduce_once(expected, direction)
        assert expected.shape == (height, width)
        assert (farthest[begin : begin + width * height].reshape(height, width) == expected).all()
    assert max(pyramid.sizes[-1]) <= 16
    pyramid.destroy()


def test_a_pixel_of_sky_is_sky_on_every_level(device: Device) -> None:
    depths = np.full((23, 41), 0.7, np.float32)
    depths[22, 40] = 0.0
    pyramid = DepthPyramid(device, (41, 23))
    pyramid.build(device, create_depth_texture(device, depths), Depth.REVERSED)
    farthest = pyramid.farthest.read()
    ends = [*pyramid.offsets[1:], len(farthest)]
    assert [farthest[end - 1] for end in ends] == [0.0] * len(ends)
    assert (farthest == 0.0).sum() == len(ends)
    pyramid.destroy()


def test_a_depth_pyramid_has_at_least_one_level_and_as_many_as_requested(null: Device) -> None:
    assert DepthPyramid(null, (960, 540), levels=1).sizes == [(960, 540), (240, 135)]
    assert DepthPyramid(null, (3, 3)).sizes == [(3, 3), (1, 1)]
    assert DepthPyramid(null, (1, 1)).sizes == [(1, 1), (1, 1)]


def test_the_last_level_of_a_depth_pyramid_has_at_most_16_texels_a_side(null: Device) -> None:
    assert DepthPyramid(null, (64, 40)).sizes[1:] == [(16, 10)]
    assert DepthPyramid(null, (65, 40)).sizes[1:] == [(17, 10), (5, 3)]
    assert DepthPyramid(null, (40, 65)).sizes[1:] == [(10, 17), (3, 5)]


@pytest.mark.parametrize("direction", Depth)
@pytest.mark.parametrize("size", [(1, 1), (63, 34), (1023, 767)])
def test_a_box_shows_if_it_shows_at_full_resolution(
    device: Device, size: tuple[int, int], direction: Depth
) -> None:
    rng, count = np.random.default_rng(5), 400
    width, height = size
    coarse = rng.random((height // 30 + 1, width // 30 + 1), np.float32)
    depths = np.kron(coarse, np.ones((30, 30), np.float32))[:height, :width]
    boxes = np.zeros(count, Occludee.dtype)
    boxes["centre"] = np.column_stack([rng.uniform(-1.1, 1.1, (count, 2)), rng.random(count)])
    for axis, name in enumerate("xyz"):
        boxes[name][:, axis] = rng.choice([0.0, 0.001, 0.01, 0.3], count) * rng.random(count)
    view = ViewConstants(relative_view_projection=np.eye(4), eye_high=(0, 0, 0), eye_low=(0, 0, 0))
    pyramid = DepthPyramid(device, size)
    texture = create_depth_texture(device, depths)
    pyramid.build(device, texture, direction)
    hidden, was_visible = device.storage(uint, np.zeros(count, np.uint32)), device.storage(uint, count)
    device.dispatch(
        device.program(depth_variant(CompareBoxes, direction)),
        -(-count // 64),
        view=device.uniform(view),
        pyramid=device.uniform(make_levels(pyramid)),
        depth=texture,
        farthest=pyramid.farthest,
        boxes=device.storage(Occludee, boxes),
        marks=hidden,
        was_visible=was_visible,
    )
    is_visible = was_visible.read().astype(bool)
    assert (hidden.read() == is_visible).all()

    half = np.abs(boxes["x"]) + np.abs(boxes["y"]) + np.abs(boxes["z"])
    low, high = boxes["centre"] - half, boxes["centre"] + half
    left, right = ((edge[:, 0] + 1.0) * 0.5 * width for edge in (low, high))
    top, bottom = ((1.0 - edge[:, 1]) * 0.5 * height for edge in (high, low))
    small = exact = 0
    for row in range(count):
        area = depths[
            max(int(np.floor(top[row])), 0) : max(int(np.floor(bottom[row])) + 1, 0),
            max(int(np.floor(left[row])), 0) : max(int(np.floor(right[row])) + 1, 0),
        ]
        shows = (high[row, 2] > area) if direction is Depth.REVERSED else (low[row, 2] < area)
        assert is_visible[row] or not shows.any()
        if area.size and max(area.shape) < 8 and (left[row] % 1 > 0.02 and right[row] % 1 < 0.98):
            small += 1
            exact += is_visible[row] == shows.any()
    assert size == (1, 1) or (small > 50 and exact > 0.95 * small)
    assert size == (1, 1) or 0.1 < is_visible.mean() < 0.9
    for resource in (pyramid, texture):
        resource.destroy()


def test_an_object_visible_in_the_last_frame_is_on_the_first_list(device: Device) -> None:
    scene = make_boxes([(0.0, 0.0, -5.0), (0.0, 0.0, -9.0)], [(1.0, 1.0, 1.0), (6.0, 6.0, 1.0)])
    algorithm, camera = DepthPyramidCulling(scene, device), make_camera((0.0, 0.0, 0.0), (0.0, 0.0, -5.0))
    lists = []
    with Renderer(device, scene, size=(64, 36)) as renderer:
        for _ in range(2):
            draw_with(renderer, algorithm, camera)
            lists.append(
                [sorted(part.read_object_indices().tolist()) for part in (algorithm.first, algorithm.second)]
            )
    assert lists == [[[], [0, 1]], [[0, 1], []]]
