"""The report of a frame's plan."""

from __future__ import annotations

import numpy as np
import pytest
from frames import EYE, make_boxes

import rhi
from renderer.content import BUILT_IN, load_scene
from renderer.lab.measure.memory import describe_memory
from renderer.lab.measure.plan_report import describe_plan
from renderer.scene import MATERIAL, Camera, Scene, SceneBuilder, scaling, translation
from renderer.techniques import Forward


def test_the_report_names_passes_textures_and_omitted_passes() -> None:
    scene = load_scene("grid:mesh=box,count=9")
    report = describe_plan(scene, Forward(), scene.views["overview"], (64, 36))
    (pass_row,) = report.passes
    assert (pass_row.name, pass_row.writes, pass_row.reads) == ("forward", ["image", "depth"], [])
    assert pass_row.bytes == report.texture_bytes == 64 * 36 * (4 + 4)
    assert report.textures == [["image"], ["depth"]]
    assert report.effects == {
        "directional lights": "the scene has 1 directional light",
        "point lights": "1 of 1 point light reaches what is in view",
    }
    assert {left.name: left.reason for left in report.left_out}[
        "spot lights"
    ] == "the scene has no spot light"


def test_the_report_lists_the_memory_of_images_and_of_the_rest() -> None:
    builder = SceneBuilder("textures")
    mesh, node = builder.add_mesh(BUILT_IN["box"]()), builder.add_node()
    for size in (4, 4, 8):
        image = builder.add_image(np.full((size, size, 4), size + len(builder._images), np.uint8))
        builder.add_objects(node, mesh, builder.add_material(texture=image))
    scene = builder.build()
    memory = describe_plan(scene, Forward(), EYE, (64, 36)).memory
    rows = {(row.name, row.shape): (row.count, row.bytes) for row in memory.rows}
    four, eight = 4 * (16 + 4 + 1), 4 * (64 + 16 + 4 + 1)
    assert rows["images", "4 × 4, 2 layers, 3 levels, RGBA8_SRGB"] == (1, 2 * four)
    assert rows["images", "8 × 8, 4 levels, RGBA8_SRGB"] == (1, eight)
    assert memory.image_bytes == memory.single_image_bytes == 2 * four + eight
    assert rows["image", "64 × 36, RGBA8_SRGB"] == rows["depth", "64 × 36, D32F"] == (1, 4 * 64 * 36)
    assert rows["meshes vertices", "buffer"] == (1, 32 * len(scene.meshes.vertices))
    assert rows["materials", "buffer"] == (1, 3 * MATERIAL.itemsize)
    assert memory.bytes == sum(size for _, size in rows.values())


def test_a_destroyed_buffer_is_not_in_the_memory_report() -> None:
    with rhi.create_device("null") as device:
        live, destroyed = (device.buffer(number, label=str(number)) for number in (48, 64))
        destroyed.destroy()
        device.finish()
        rows = describe_memory(device.stream, None).rows
    assert [(row.name, row.bytes) for row in rows if row.name in ("48", "64")] == [("48", 48)]
    assert live.size == 48


def checkered(*, two_sides: bool = False) -> Scene:
    """Make sixteen objects in a row of four materials and two meshes in turn; a half of the materials are
    metals, and the fourth may have two sides."""
    builder = SceneBuilder("checkered")
    meshes = [builder.add_mesh(BUILT_IN[name]()) for name in ("box", "sphere")]
    shared = [{}, {"roughness": 0.5}, {"shininess": 9.0}, {"roughness": 0.1, "double_sided": two_sides}]
    materials = [builder.add_material(**values) for values in shared]
    for i in range(16):
        builder.add_objects(
            builder.add_node(translation((i - 8, 0, 0))), meshes[i // 4 % 2], materials[i % 4]
        )
    return builder.build()


@pytest.mark.parametrize(("two_sides", "kinds", "draws"), [(False, 2, 1), (True, 3, 2)])
def test_the_report_counts_kinds_of_materials_and_draws(two_sides: bool, kinds: int, draws: int) -> None:
    """Four materials, each with two meshes; in a group of its own, one with two sides is drawn by a second
    draw."""
    camera = Camera.look_at((-40, 0, 40), (0, 0, 0))
    report = describe_plan(checkered(two_sides=two_sides), Forward(), camera, (64, 36))
    rows = {row.order: (row.programs, row.materials, row.meshes, row.draws) for row in report.orders}
    listed, near, sorted_, drawn = rows.values()
    assert listed == near == (16, 16, 4, 16)
    assert sorted_ == (kinds, 4, 8, 16)
    assert drawn == (1, 1, 1, draws)
    (row,) = report.passes
    assert (row.changes.programs, row.changes.meshes) == (1, 1)
    assert row.changes.bindings == 5  # the view, objects, places, materials and ambient light


@pytest.mark.parametrize(("mirrored", "draws"), [(1, 1), (-1, 2)])
def test_the_report_counts_the_draws_of_a_pass(mirrored: int, draws: int) -> None:
    scene = make_boxes((-1, 0, 0), translation((1, 0, 0)) @ scaling((mirrored, 1, 1))).build()
    (pass_row,) = describe_plan(scene, Forward(), EYE, (64, 36)).passes
    assert (pass_row.draws, pass_row.dispatches) == (draws, 0)
