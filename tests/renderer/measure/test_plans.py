"""The report of a frame's plan."""

from __future__ import annotations

import numpy as np
import pytest

import rhi
from renderer.content import BUILT_IN, load_scene
from renderer.measure.memory import describe_memory
from renderer.measure.plans import describe_plan
from renderer.scene import MATERIAL, Camera, SceneBuilder, scaling, translation
from renderer.techniques import Forward


def test_the_report_names_passes_textures_and_what_is_left_out() -> None:
    scene = load_scene("grid:mesh=box,count=9")
    report = describe_plan(scene, Forward(), scene.views["overview"], (64, 36))
    (one,) = report.passes
    assert (one.name, one.writes, one.reads) == ("forward", ["image", "depth"], [])
    assert one.bytes == report.texture_bytes == 64 * 36 * (4 + 4)
    assert report.textures == [["image"], ["depth"]]
    assert report.effects == {
        "directional lights": "the scene has 1 directional light",
        "point lights": "1 of 1 point light reaches what is in view",
    }
    assert {left.name: left.because for left in report.left_out}[
        "spot lights"
    ] == "the scene has no spot light"


def test_the_report_lists_the_memory_of_images_and_of_the_rest() -> None:
    builder = SceneBuilder("pictures")
    mesh, node = builder.add_mesh(BUILT_IN["box"]()), builder.add_node()
    for size in (4, 4, 8):
        image = builder.add_image(np.full((size, size, 4), size + len(builder._images), np.uint8))
        builder.add_objects(node, mesh, builder.add_material(texture=image))
    scene = builder.build()
    camera = Camera.look_at((0, 0, 10), (0, 0, 0))
    memory = describe_plan(scene, Forward(), camera, (64, 36)).memory
    rows = {(one.name, one.shape): (one.count, one.bytes) for one in memory.rows}
    four, eight = 4 * (16 + 4 + 1), 4 * (64 + 16 + 4 + 1)
    assert rows["images", "4 × 4, 2 layers, 3 levels, RGBA8_SRGB"] == (1, 2 * four)
    assert rows["images", "8 × 8, 4 levels, RGBA8_SRGB"] == (1, eight)
    assert memory.image_bytes == memory.single_image_bytes == 2 * four + eight
    assert rows["image", "64 × 36, RGBA8_SRGB"] == rows["depth", "64 × 36, D32F"] == (1, 4 * 64 * 36)
    assert rows["meshes vertices", "buffer"] == (1, 32 * len(scene.meshes.vertices))
    assert rows["materials", "buffer"] == (1, 3 * MATERIAL.itemsize)
    assert memory.bytes == sum(size for _, size in rows.values())


def test_what_was_destroyed_is_not_in_memory() -> None:
    with rhi.create_device("null") as device:
        kept, gone = (device.buffer(number, label=str(number)) for number in (48, 64))
        gone.destroy()
        device.finish()
        rows = describe_memory(device.stream, None).rows
    assert [(one.name, one.bytes) for one in rows if one.name in ("48", "64")] == [("48", 48)]
    assert kept.size == 48


@pytest.mark.parametrize(("mirrored", "draws"), [(1, 1), (-1, 2)])
def test_the_report_counts_the_draws_of_a_pass(mirrored: int, draws: int) -> None:
    builder = SceneBuilder("boxes")
    mesh, material = builder.add_mesh(BUILT_IN["box"]()), builder.add_material()
    for x, side in ((-1, 1), (1, mirrored)):
        builder.add_objects(builder.add_node(translation((x, 0, 0)) @ scaling((side, 1, 1))), mesh, material)
    camera = Camera.look_at((0, 0, 10), (0, 0, 0))
    (one,) = describe_plan(builder.build(), Forward(), camera, (64, 36)).passes
    assert (one.draws, one.dispatches) == (draws, 0)
