"""The commands of the techniques that collect light in buffers, recorded by the null device."""

from __future__ import annotations

import numpy as np
import pytest

import rhi
from renderer.content import BUILT_IN, load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective, Scene, SceneBuilder
from renderer.techniques import Deferred, Forward, Inferred, LightPrePass, Technique
from renderer.visibility import NoCulling
from rhi import DepthFunction, DepthWrite, Op

SIZE = (32, 16)
DEFERRED = [Deferred(), Deferred(stencil=True)]
PRE_PASS = [LightPrePass(), LightPrePass(stencil=True), LightPrePass(specular_channels=1)]
ALL: list[Technique] = [*DEFERRED, *PRE_PASS, Inferred()]


def boxes(lamps: int = 0, *, narrow: int = 0, wide: int = 0) -> Scene:
    """Make two boxes in front of the eye, with lamps in view."""
    builder = SceneBuilder("boxes")
    mesh, material = builder.add_mesh(BUILT_IN["box"]()), builder.add_material()
    for _ in range(2):
        builder.add_objects(builder.add_node(), mesh, material)
    for number in range(lamps):
        builder.lights.add_point((0.01 * number, 1, 0), 3.0)
    for outer, count in ((0.5, narrow), (2.0, wide)):
        for number in range(count):
            builder.lights.add_spot((0.01 * number, 2, 0), (0, -1, 0), 3.0, 0.2, outer)
    builder.views["eye"] = Camera.look_at((0, 0, 10), (0, 0, 0))
    return builder.build()


def record(
    device: rhi.Device, scene: Scene, technique: Technique, camera: Camera | None = None
) -> rhi.CommandStream:
    """Return the commands of the second of two frames."""
    renderer = Renderer(device, scene, technique=technique, visibility=NoCulling(scene), size=SIZE)
    for _ in range(2):
        device.stream.clear()
        renderer.render(camera or scene.views["eye"])
    return device.stream


def count(device: rhi.Device, scene: Scene, technique: Technique) -> tuple[int, int]:
    """Return the number of render passes and of draw calls in a frame."""
    stream = record(device, scene, technique)
    return len(stream.filter(Op.BEGIN_PASS)), len(stream.draws())


def names(device: rhi.Device, scene: Scene, technique: Technique) -> list[str]:
    """Return the names of the passes of a frame."""
    with Renderer(device, scene, technique=technique, visibility=NoCulling(scene), size=SIZE) as renderer:
        renderer.render(scene.views["eye"])
        _, plan = renderer.plan(scene.views["eye"])
    return [one.name for one in plan.passes]


@pytest.mark.parametrize("technique", DEFERRED)
def test_deferred_without_lamps_draws_geometry_and_one_triangle(null: rhi.Device, technique: Technique) -> None:
    assert names(null, boxes(), technique) == ["geometry", "resolve"]
    assert count(null, boxes(), technique) == (2, 2)


@pytest.mark.parametrize("technique", [LightPrePass(), LightPrePass(specular_channels=1), Inferred()])
def test_a_light_pre_pass_without_lamps_is_forward_shading(null: rhi.Device, technique: Technique) -> None:
    with rhi.create_device("null") as other:
        wanted = record(other, boxes(), Forward())
        stream = record(null, boxes(), technique)
        assert [(c.op, c.values) for c in stream] == [(c.op, c.values) for c in wanted]


def test_a_lamp_adds_its_pass_and_one_draw(null: rhi.Device) -> None:
    assert names(null, boxes(1), Deferred()) == ["geometry", "point lights", "resolve"]
    assert count(null, boxes(1), Deferred()) == (3, 3)
    assert names(null, boxes(1), LightPrePass()) == ["normals", "point lights", "materials"]
    assert count(null, boxes(1), LightPrePass()) == (3, 3)
    assert names(null, boxes(1), Inferred()) == ["normals", "shrink", "point lights", "materials"]
    assert count(null, boxes(1), Inferred()) == (4, 4)


@pytest.mark.parametrize("technique", [Deferred(), LightPrePass()])
def test_lamps_of_a_kind_are_one_draw_and_narrow_and_wide_spots_are_two(
    null: rhi.Device, technique: Technique
) -> None:
    assert count(null, boxes(200), technique) == (3, 3)
    assert count(null, boxes(0, narrow=5), technique) == count(null, boxes(0, wide=5), technique) == (3, 3)
    assert count(null, boxes(0, narrow=5, wide=3), technique) == (3, 4)
    assert count(null, boxes(200, narrow=5, wide=3), technique) == (4, 5)


@pytest.mark.parametrize("technique", [Deferred(), LightPrePass()])
def test_one_draw_has_an_instance_for_each_lamp(null: rhi.Device, technique: Technique) -> None:
    _, volumes, _ = record(null, boxes(200), technique).draws()
    assert volumes["instances"] == 200


@pytest.mark.parametrize("technique", [Deferred(stencil=True), LightPrePass(stencil=True)])
def test_a_masked_lamp_is_drawn_twice(null: rhi.Device, technique: Technique) -> None:
    assert count(null, boxes(7), technique) == (3, 2 + 2 * 7)
    stream = record(null, boxes(7), technique)
    marking, marked = stream.draws()[1:3]
    assert marking.states[rhi.CullMode] is rhi.CullMode.NONE
    assert set(marking.states[rhi.ColorWrite]) == {rhi.ColorWrite.OFF}
    assert marked.states[rhi.CullMode] is rhi.CullMode.FRONT
    assert marked.states[rhi.DepthTest] is rhi.DepthTest.OFF


@pytest.mark.parametrize(("scale", "size"), [(1.0, (32, 16)), (0.6, (20, 10)), (0.4, (13, 7))])
def test_inferred_light_is_collected_in_smaller_buffers(
    null: rhi.Device, scale: float, size: tuple[int, int]
) -> None:
    stream = record(null, boxes(1), Inferred(scale=scale))
    sizes = [begin["descriptor"].size for begin in stream.filter(Op.BEGIN_PASS)]
    assert sizes == [SIZE, size, size, SIZE]


def test_a_lamp_that_a_far_plane_cuts_is_not_masked(null: rhi.Device) -> None:
    scene = boxes(7)
    near = scene.views["eye"].with_projection(Perspective(far=10.5))
    far = scene.views["eye"].with_projection(Perspective(far=100.0))
    assert len(record(null, scene, Deferred(stencil=True), near).draws()) == 3
    assert len(record(null, scene, Deferred(stencil=True), far).draws()) == 2 + 2 * 7


@pytest.mark.parametrize("technique", ALL)
def test_a_lamp_out_of_view_costs_nothing(null: rhi.Device, technique: Technique) -> None:
    scene, dark = boxes(0), boxes(0)
    scene.lights.add_point((0, 1, 40), 3.0)
    with rhi.create_device("null") as other:
        wanted = record(other, dark, technique)
        assert [(c.op, c.values) for c in record(null, scene, technique)] == [(c.op, c.values) for c in wanted]


def test_the_second_pass_of_a_light_pre_pass_draws_what_the_first_has_drawn_and_keeps_its_depth(
    null: rhi.Device,
) -> None:
    first, _, second = record(null, boxes(1), LightPrePass()).draws()
    assert first["draws"] == second["draws"] == 32  # two, and draws of nothing
    assert second.states[DepthFunction] is DepthFunction.EQUAL
    assert second.states[DepthWrite] is DepthWrite.OFF


@pytest.mark.parametrize(
    ("technique", "text", "lamps", "bytes_per_pixel"),
    [
        (Forward(), "boxes", 1, 4 + 4),
        (Deferred(), "boxes", 0, 8 + 4 + 4 + 4),
        (Deferred(), "boxes", 1, 8 + 4 + 4 + 8 + 4),
        (Deferred(), "city:blocks=4", 1, 8 + 8 + 4 + 8 + 4),
        (Deferred(stencil=True), "boxes", 1, 8 + 4 + 8 + 8 + 4),
        (LightPrePass(), "boxes", 0, 4 + 4),
        (LightPrePass(), "boxes", 1, 8 + 2 + 4 + 16 + 4),
        (LightPrePass(specular_channels=1), "boxes", 1, 8 + 2 + 4 + 8 + 4),
    ],
)
def test_a_pixel_takes_so_many_bytes(
    null: rhi.Device, technique: Technique, text: str, lamps: int, bytes_per_pixel: int
) -> None:
    scene = boxes(lamps) if text == "boxes" else load_scene(text)
    view = next(iter(scene.views.values()))
    with Renderer(null, scene, technique=technique, visibility=NoCulling(scene), size=SIZE) as renderer:
        renderer.render(view)
        _, plan = renderer.plan(view)
    assert plan.count_bytes(SIZE) == bytes_per_pixel * SIZE[0] * SIZE[1]


@pytest.mark.parametrize("technique", [Deferred(), LightPrePass()])
def test_a_second_frame_uploads_the_rows_of_its_lamps(
    null: rhi.Device, technique: Technique
) -> None:
    scene = boxes(50)
    with Renderer(null, scene, technique=technique, visibility=NoCulling(scene), size=SIZE) as renderer:
        renderer.render(scene.views["eye"])
        again = renderer.render(scene.views["eye"]).statistics
    # Passes over the geometry are recorded with their draws.
    assert again.upload_bytes == 50 * np.dtype(np.int32).itemsize


@pytest.mark.parametrize("scale", [0.0, -0.5, 1.001, float("nan")])
def test_a_scale_out_of_range_is_refused(scale: float) -> None:
    with pytest.raises(rhi.ValidationError, match="technique-parameter"):
        Inferred(scale=scale)
    assert Inferred(scale=1e-3).scale == 1e-3


@pytest.mark.parametrize("channels", [0, 2, 4])
def test_a_number_of_specular_channels_other_than_1_and_3_is_refused(channels: int) -> None:
    with pytest.raises(rhi.ValidationError, match="technique-parameter"):
        LightPrePass(specular_channels=channels)


@pytest.mark.parametrize("technique", ALL)
def test_everything_is_given_back(null: rhi.Device, technique: Technique) -> None:
    scene = boxes(3, narrow=2, wide=1)
    with Renderer(null, scene, technique=technique, visibility=NoCulling(scene), size=SIZE) as renderer:
        renderer.render(scene.views["eye"])
    null.finish()
    made = null.stream.filter(
        (Op.CREATE_TEXTURE, Op.CREATE_BUFFER),
        where=lambda c: getattr(c["descriptor"], "usage", None) is not rhi.BufferUsage.STREAM,
    )
    gone = {command.values[0] for command in null.stream.filter(Op.DESTROY)}
    assert len(made) > 10
    assert {command.values[0] for command in made} <= gone
