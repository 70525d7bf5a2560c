"""The commands of the forward technique, recorded by the null device."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from frames import make_boxes, open_renderer
from frames import record as record_any

import rhi
from renderer.content import BUILT_IN as MESHES
from renderer.content import load_scene
from renderer.scene import Camera, Depth, Perspective, SceneBuilder, scaling, translation
from renderer.techniques import TECHNIQUES
from rhi import Op
from rhi.backends.null import NullBackend


def boxes(*object_positions: tuple[float, float, float], mirrored: int = 0) -> SceneBuilder:
    """Make a box at each position, the first `mirrored` of them mirrored; no lights."""
    sides = [scaling((-1 if number < mirrored else 1, 1, 1)) for number in range(len(object_positions))]
    return make_boxes(
        *(translation(position) @ side for position, side in zip(object_positions, sides, strict=True))
    )


record = partial(record_any, visibility="auto")


def count(stream: rhi.CommandStream, op: Op) -> int:
    return len(stream.filter(op))


def list_rows(stream: rhi.CommandStream, draw: rhi.Command) -> list[int]:
    """Return the rows of the objects that an indirect draw draws, without the draws of nothing that fill it
    up."""
    written = [c for c in stream.filter(Op.WRITE_BUFFER) if c["buffer"] == draw["buffer"]]
    draws = np.frombuffer(written[-1]["data"], rhi.DRAW)[draw["offset"] // rhi.DRAW.itemsize :][
        : draw["draws"]
    ]
    return draws["base_instance"][draws["instances"] > 0].tolist()


def test_a_whole_scene_is_one_draw_call(null: rhi.Device) -> None:
    stream = record(null, load_scene("city:blocks=6"))
    assert len(stream.draws()) == 1
    assert stream.draws()[0]["draws"] > 20


def test_mirrored_objects_are_a_second_call_of_the_other_winding(null: rhi.Device) -> None:
    stream = record(null, boxes((-2, 0, 0), (0, 0, 0), (2, 0, 0), mirrored=1).build(), frames=1)
    first, second = stream.draws()
    assert (sorted(list_rows(stream, first)), list_rows(stream, second)) == ([1, 2], [0])
    assert first.states[rhi.FrontFace] is rhi.FrontFace.COUNTER_CLOCKWISE
    assert second.states[rhi.FrontFace] is rhi.FrontFace.CLOCKWISE


def leaves(*, of_each: int = 2) -> SceneBuilder:
    """Make boxes of all four groups, one after the other, and each of them `of_each` times."""
    builder = SceneBuilder("leaves")
    mesh, materials = (
        builder.add_mesh(MESHES["box"]()),
        [builder.add_material(double_sided=two) for two in (0, 1)],
    )
    for number in range(4 * of_each):
        turned = scaling((-1 if number % 2 else 1, 1, 1))
        node = builder.add_node(translation((number - 2 * of_each, 0, 0)) @ turned)
        builder.add_objects(node, mesh, materials[number // 2 % 2])
    builder.views["eye"] = Camera.look_at((0, 0, 20), (0, 0, 0))
    return builder


GROUPS = [
    (rhi.FrontFace.COUNTER_CLOCKWISE, rhi.CullMode.BACK),
    (rhi.FrontFace.CLOCKWISE, rhi.CullMode.BACK),
    (rhi.FrontFace.COUNTER_CLOCKWISE, rhi.CullMode.NONE),
    (rhi.FrontFace.CLOCKWISE, rhi.CullMode.NONE),
]


def list_groups(draws: rhi.Commands) -> list[tuple[object, object]]:
    return [(draw.states[rhi.FrontFace], draw.states[rhi.CullMode]) for draw in draws]


def test_objects_that_need_other_states_are_a_call_each_and_no_more(null: rhi.Device) -> None:
    stream = record(null, leaves(of_each=5).build(), frames=1)
    draws = stream.draws()
    rows = [sorted(list_rows(stream, draw)) for draw in draws]
    assert rows == [list(range(group, 20, 4)) for group in range(4)]
    assert list_groups(draws) == GROUPS


@pytest.mark.parametrize("name", ["chc_plus_plus", "stop_and_wait", "two_pass", "depth_pyramid"])
def test_every_algorithm_culls_the_backs_of_materials_with_one_side(null: rhi.Device, name: str) -> None:
    null.backend_as(NullBackend).answer_queries(100)
    scene = leaves().build()
    with open_renderer(null, scene, visibility=name) as renderer:
        null.stream.clear()
        renderer.render(scene.views["eye"])
        groups = list_groups(null.stream.draws().filter(where=lambda draw: "materials" in draw.bindings))
    assert set(groups) == set(GROUPS)


def test_a_scene_without_two_sides_culls_all_backs(null: rhi.Device) -> None:
    (draw,) = record(null, boxes((-2, 0, 0), (0, 0, 0)).build()).draws()
    assert list_groups([draw]) == GROUPS[:1]


def test_a_depth_pass_of_materials_with_two_sides_has_no_fragment_to_discard(null: rhi.Device) -> None:
    builder = leaves()
    builder.lights.add_point((0, 0, 2), 50.0)
    scene = builder.build()
    with open_renderer(null, scene, TECHNIQUES["forward_plus"]()) as renderer:
        null.stream.clear()
        renderer.render(scene.views["eye"])
        depth = null.stream.filter(label="depth").draws()
        assert len(depth) == 4
        assert {name for draw in depth for name in draw.bindings} == {"view", "objects", "object_positions"}


def test_nothing_in_view_is_a_pass_without_a_draw(null: rhi.Device) -> None:
    away = Camera.look_at((0, 0, 10), (0, 0, 20))
    stream = record(null, boxes((0, 0, 0)).build(), camera=away)
    assert count(stream, Op.BEGIN_PASS) == 1
    assert not len(stream.draws())


def test_objects_are_drawn_front_to_back(null: rhi.Device) -> None:
    scene = boxes((0, 0, -4), (0, 0, 4), (0, 0, 0)).build()
    (draw,) = record(null, scene, frames=1).draws()
    rows = list_rows(null.stream, draw)
    assert [scene.nodes.world[scene.objects.node[row], 2, 3] for row in rows] == [4, 0, -4]


def test_an_object_on_a_wide_ground_is_drawn_before_the_ground(null: rhi.Device) -> None:
    # The ground's middle is the nearer; its far edge is the farther.
    builder = boxes((0, 0, -4))
    ground = builder.add_node(translation((0, -2, 0)) @ scaling((20, 1, 20)))
    builder.add_objects(ground, 0, 0)
    scene = builder.build()
    (draw,) = record(null, scene, frames=1).draws()
    assert list_rows(null.stream, draw) == [0, 1]


@pytest.mark.parametrize(
    ("kind", "storages", "uniforms", "textures"),
    [
        ("nothing", 3, 2, 0),
        ("directional", 4, 2, 0),
        ("point", 5, 2, 0),
        ("spot", 5, 2, 0),
        ("texture", 3, 2, 1),
        ("haze", 3, 3, 0),
        ("a point light out of reach", 3, 2, 0),
        ("everything", 7, 3, 1),
    ],
)
def test_resources_that_a_scene_does_not_need_are_not_bound(
    null: rhi.Device, kind: str, storages: int, uniforms: int, textures: int
) -> None:
    builder = boxes((0, 0, 0))
    every = kind == "everything"
    if kind == "directional" or every:
        builder.lights.add_directional((0, -1, 0))
    if kind == "point" or every:
        builder.lights.add_point((0, 5, 0), 9.0)
    if kind == "a point light out of reach":
        builder.lights.add_point((0, 5, 0), 4.4)
    if kind == "spot" or every:
        builder.lights.add_spot((0, 5, 0), (0, -1, 0), 9.0, 0.3, 0.5)
    if kind == "texture" or every:
        material = builder.add_material(texture=builder.add_image(np.zeros((4, 4, 4), np.uint8)))
        builder.add_objects(builder.add_node(np.eye(4)), 0, material)
    if kind == "haze" or every:
        builder.haze = 0.1
    stream = record(null, builder.build())
    bound: Any = (
        count(stream, Op.BIND_STORAGE),
        count(stream, Op.BIND_UNIFORM),
        count(stream, Op.BIND_TEXTURE),
    )
    assert bound == (storages, uniforms, textures)


@pytest.mark.parametrize(
    ("depth", "far", "function"),
    [
        (Depth.REVERSED, 0.0, rhi.DepthFunction.GREATER_EQUAL),
        (Depth.STANDARD, 1.0, rhi.DepthFunction.LESS_EQUAL),
    ],
)
def test_the_camera_says_which_way_depth_runs(
    null: rhi.Device, depth: Depth, far: float, function: rhi.DepthFunction
) -> None:
    camera = Camera.look_at((0, 0, 10), (0, 0, 0), projection=Perspective(depth=depth))
    stream = record(null, boxes((0, 0, 0)).build(), camera=camera)
    (begin,) = stream.filter(Op.BEGIN_PASS)
    assert begin["descriptor"].depth.clear == far
    assert stream.draws()[0].states[rhi.DepthFunction] is function
