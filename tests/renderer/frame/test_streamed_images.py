"""Images within a budget of memory: exact bytes, what is released, and frames equal to those with all levels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from nightly_reasons import ONLY_KERNELS

from renderer.content import BUILT_IN
from renderer.frame import TextureSettings
from renderer.frame.scene_images import SceneImages, count_bytes
from renderer.frame.streamed_images import ImageStream
from renderer.renderer import Renderer
from renderer.scene import AlphaMode, Camera, Scene, SceneBuilder, TextureMap, translation
from rhi import Device, Op
from tests.renderer.refusals import refused_rule

MIB = 1 << 20
SIDE = 64
FULL = count_bytes((SIDE, SIDE))
COARSEST = count_bytes((SIDE >> 6, SIDE >> 6))
"""An array for each of 7 sizes can be bound, so that the coarsest level is a texel."""
SIZE = (96, 64)


def paint(seed: int, side: int = SIDE) -> Any:
    image = np.random.default_rng(seed).integers(0, 255, (side, side, 4), np.uint8)
    image[..., 3] = 255
    return image


def make_shelf(count: int = 4, spacing: float = 6.0, **material: Any) -> Scene:
    """Boxes behind each other along -z, each with an image of its own, lit from everywhere."""
    builder = SceneBuilder("shelf")
    box = builder.add_mesh(BUILT_IN["box"](), "box")
    for number in range(count):
        texture = TextureMap(builder.add_image(paint(number)), scale=(1.0, 1.0))
        node = builder.add_node(translation((1.5 * number, 0.0, -spacing * number)))
        builder.add_objects(node, box, builder.add_material(texture=texture, **material))
    builder.lights.sky = builder.lights.ground = (1.0, 1.0, 1.0)
    return builder.build()


NEAR = Camera.look_at((0.0, 0.0, 1.2), (0.0, 0.0, 0.0))
FAR = Camera.look_at((4.0, 3.0, 40.0), (2.0, 0.0, -6.0))
AWAY = Camera.look_at((0.0, 0.0, 9.0), (0.0, 0.0, 20.0))


def within(budget: float, frame_bytes: float = 0.0) -> TextureSettings:
    return TextureSettings(memory=budget / MIB, memory_per_frame=frame_bytes / MIB)


def get_stream(renderer: Renderer) -> ImageStream:
    images = renderer.images
    assert images is not None
    assert images.stream is not None
    return images.stream


def list_bytes(commands: Iterable[Any]) -> list[int]:
    """The bytes of arrays of images after each command that creates or destroys one, without empty arrays."""
    textures: dict[object, int] = {}
    totals = []
    for command in commands:
        if command.op is Op.CREATE_TEXTURE and command["descriptor"].label == "images":
            descriptor = command["descriptor"]
            if descriptor.levels > 1 or descriptor.layers > 1:
                sizes = [descriptor.level_size(level) for level in range(descriptor.levels)]
                textures[command["texture"]] = (
                    4 * descriptor.layers * sum(width * height for width, height in sizes)
                )
                totals.append(sum(textures.values()))
        elif command.op is Op.DESTROY and textures.pop(command["resource"], None) is not None:
            totals.append(sum(textures.values()))
    return totals


def test_without_a_budget_nothing_is_streamed(null: Device) -> None:
    images = SceneImages(null, make_shelf())
    assert images.stream is None
    assert images.bytes == 4 * FULL


def test_images_begin_with_their_coarsest_level(null: Device) -> None:
    images = SceneImages(null, make_shelf(), within(MIB))
    assert images.stream is not None
    assert images.bytes == images.stream.bytes == 4 * COARSEST
    assert images.stream.report.full_bytes == 4 * (FULL + COARSEST)


def test_a_frame_uploads_no_more_bytes_than_it_may(null: Device) -> None:
    budget = 1024
    with Renderer(null, make_shelf(), size=SIZE, textures=within(MIB, budget)) as renderer:
        stream = get_stream(renderer)
        written, frames = 0, 0
        while not frames or not stream.is_done:
            start = len(null.stream)
            renderer.render(NEAR)
            sizes = [len(c.arguments["data"]) for c in null.stream[start:] if c.op.name == "WRITE_TEXTURE"]
            assert 0 < sum(sizes) <= budget
            written, frames = written + sum(sizes), frames + 1
        levels = stream.level.tolist()
        assert levels[0] == 0
        expected = sum(4 * (SIDE >> level) ** 2 for image in levels for level in range(image, 6))
        assert written == expected
        assert frames >= expected / budget


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("camera", [NEAR, FAR])
def test_levels_that_fit_make_the_image_of_all_levels(drawing_device: Device, camera: Camera) -> None:
    scene = make_shelf()
    with Renderer(drawing_device, scene, size=SIZE, textures=TextureSettings()) as renderer:
        expected = renderer.render(camera).image.read()
    with Renderer(drawing_device, make_shelf(), size=SIZE, textures=within(MIB)) as renderer:
        renderer.render(AWAY)
        image = renderer.render(camera).image.read()
        assert get_stream(renderer).bytes < 4 * FULL
    assert np.array_equal(image, expected)
    assert expected[..., :3].std() > 5


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
def test_frames_become_the_image_of_all_levels(drawing_device: Device) -> None:
    with Renderer(drawing_device, make_shelf(), size=SIZE) as renderer:
        expected = renderer.render(NEAR).image.read()
    with Renderer(drawing_device, make_shelf(), size=SIZE, textures=within(MIB, 2048)) as renderer:
        errors = []
        while not errors or not get_stream(renderer).is_done:
            image = renderer.render(NEAR).image.read().astype(float)
            errors.append(np.abs(image - expected).max())
        assert len(errors) > 4
        assert errors[0] > 20
        assert errors[-1] == 0


def test_levels_are_released_when_memory_is_short_those_first_that_were_needed_longest_ago(
    null: Device,
) -> None:
    budget = 2 * FULL + count_bytes((32, 32)) + 4 * COARSEST
    with Renderer(null, make_shelf(spacing=20.0), size=SIZE, textures=within(budget)) as renderer:
        stream, seen = get_stream(renderer), []
        for number in (0, 1, 2):
            side = 1.5 * number, -20.0 * number
            renderer.render(Camera.look_at((side[0], 0.0, side[1] + 1.2), (side[0], 0.0, side[1])))
            seen.append(stream.level.tolist())
            assert stream.bytes <= budget
            assert stream.report.lost_levels == 0
        assert seen[0][0] == seen[1][1] == seen[2][2] == 0
        assert seen[1][0] == 0
        assert seen[2][0] > seen[2][1]


def test_with_too_little_memory_all_images_lose_a_level_before_any_loses_two(null: Device) -> None:
    scene = make_shelf(alpha_mode=AlphaMode.MASK)  # which shadow maps read, too: all levels of all images
    half, quarter = count_bytes((32, 32)), count_bytes((16, 16))
    for budget, levels, lost in (
        (4 * FULL, [0, 0, 0, 0], 0),
        (FULL + 3 * half, [0, 1, 1, 1], 1),
        (4 * half, [1, 1, 1, 1], 1),
        (half + 3 * quarter, [1, 2, 2, 2], 2),
    ):
        settings = within(budget + 4 * COARSEST)
        with Renderer(null, scene, size=SIZE, textures=settings) as renderer:
            renderer.render(NEAR)
            report = get_stream(renderer).report
            assert get_stream(renderer).level.tolist() == levels
            assert (report.reduced, report.lost_levels, report.waiting) == (sum(map(bool, levels)), lost, 0)
            assert report.bytes == budget + 4 * COARSEST


def test_no_moment_has_more_bytes_than_the_budget_and_nothing_grows(null: Device) -> None:
    budget = 2 * FULL
    with Renderer(null, make_shelf(6), size=SIZE, textures=within(budget, 3000)) as renderer:
        stream = get_stream(renderer)
        for frame in range(2000):
            along = 3.75 + 3.75 * np.sin(frame * 0.02)  # past the boxes, and back
            eye = np.array((along, 0.4, 1.2 - 4.0 * along))
            renderer.render(Camera.look_at(eye, eye - (0.0, 0.0, 1.0)))
            assert stream.bytes <= budget
            if frame == 999:
                half = len(null.stream)
        first, totals = list_bytes(null.stream[:half]), list_bytes(null.stream[:])
        assert max(totals) <= budget
        assert max(totals) > 0.7 * budget
        assert len(totals) > len(first) > 100  # arrays are exchanged, and those before are destroyed


def test_settings_out_of_their_range_are_refused() -> None:
    assert refused_rule(lambda: TextureSettings(memory=-1.0)) == "texture-settings"
    assert refused_rule(lambda: TextureSettings(memory_per_frame=float("nan"))) == "texture-settings"
    assert replace(TextureSettings(), memory=0.5).memory == 0.5
