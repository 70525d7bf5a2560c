"""The report of a frame's plan."""

from __future__ import annotations

import pytest

from renderer.content import BUILT_IN, load_scene
from renderer.measure.plans import describe_plan
from renderer.scene import Camera, SceneBuilder, scaling, translation
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


@pytest.mark.parametrize(("mirrored", "draws"), [(1, 1), (-1, 2)])
def test_the_report_counts_the_draws_of_a_pass(mirrored: int, draws: int) -> None:
    builder = SceneBuilder("boxes")
    mesh, material = builder.add_mesh(BUILT_IN["box"]()), builder.add_material()
    for x, side in ((-1, 1), (1, mirrored)):
        builder.add_objects(builder.add_node(translation((x, 0, 0)) @ scaling((side, 1, 1))), mesh, material)
    camera = Camera.look_at((0, 0, 10), (0, 0, 0))
    (one,) = describe_plan(builder.build(), Forward(), camera, (64, 36)).passes
    assert (one.draws, one.dispatches) == (draws, 0)
