"""Behaviours: steps of time, messages, numbers, groups in arrays, and functions that are exchanged."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rhi
from renderer.content.shapes import BUILT_IN
from renderer.renderer import Renderer
from renderer.scene import Behaviors, Camera, Entity, Scene, SceneBuilder, translation

STEP = 0.125  # a sum of powers of 2: times are exact


def make_boxes(count: int) -> tuple[Scene, list[int]]:
    """Make boxes at dynamic nodes; return the scene and the nodes."""
    builder = SceneBuilder("boxes")
    mesh, material = builder.add_mesh(BUILT_IN["box"]()), builder.add_material()
    nodes = [builder.add_node(translation((3.0 * number, 0.0, 0.0)), dynamic=True) for number in range(count)]
    for node in nodes:
        builder.add_objects(node, mesh, material)
    return builder.build(), nodes


def drive(entity: Entity, step: float) -> None:
    """Move along z at the speed of the state."""
    entity.transforms[:, 2, 3] += entity.state.speed * step


def read_z(scene: Scene, node: int) -> float:
    """The z of a node."""
    return float(scene.nodes.local[node, 2, 3])


@given(times=st.lists(st.floats(0.0, 20.0), min_size=1, max_size=12))
def test_a_state_follows_from_the_time_however_often_frames_are_drawn(times: list[float]) -> None:
    scene, (node,) = make_boxes(1)
    behaviors = Behaviors(scene, interval=STEP, max_steps=1000)
    behaviors.add(drive, node, speed=2.0)
    steps = sum(behaviors.update(seconds) for seconds in sorted(times))
    assert steps == behaviors.steps == int(max(times) / STEP + 1e-9)
    assert read_z(scene, node) == 2.0 * STEP * steps


def test_a_time_before_a_step_takes_none_and_a_whole_step_takes_one() -> None:
    behaviors = Behaviors(make_boxes(1)[0], interval=STEP)
    assert [behaviors.update(seconds) for seconds in (0.0, 0.99 * STEP, STEP, STEP, 2.5 * STEP)] == [
        0,
        0,
        1,
        0,
        1,
    ]


def test_time_that_goes_back_takes_no_step_and_goes_on_from_there() -> None:
    scene, (node,) = make_boxes(1)
    behaviors = Behaviors(scene, interval=STEP)
    behaviors.add(drive, node, speed=1.0)
    assert behaviors.update(10 * STEP) == 10
    assert behaviors.update(4 * STEP) == 0
    assert behaviors.update(6 * STEP) == 2
    assert read_z(scene, node) == 12 * STEP


def test_a_long_pause_takes_as_many_steps_as_are_allowed_and_says_so(
    caplog: pytest.LogCaptureFixture,
) -> None:
    scene, (node,) = make_boxes(1)
    behaviors = Behaviors(scene, interval=STEP, max_steps=8)
    behaviors.add(drive, node, speed=1.0)
    assert behaviors.update(8 * STEP) == 8
    assert not caplog.records
    assert behaviors.update(100 * STEP) == 8
    assert "84 steps are left out" in caplog.text
    assert behaviors.update(101 * STEP) == 1


def test_a_group_is_one_call_for_all_of_its_nodes() -> None:
    scene, nodes = make_boxes(50)
    calls = []

    def rise(entity: Entity, step: float) -> None:
        calls.append(len(entity.nodes))
        entity.transforms[:, 1, 3] += entity.state.speeds * step

    behaviors = Behaviors(scene, interval=STEP)
    behaviors.add(rise, nodes, speeds=np.arange(50.0))
    behaviors.update(2 * STEP)
    assert calls == [50, 50]
    assert scene.nodes.local[nodes, 1, 3] == pytest.approx(np.arange(50.0) * 2 * STEP)


def test_a_message_is_read_in_the_next_step_whoever_sends_it_first() -> None:
    scene, nodes = make_boxes(2)
    heard: list[tuple[int, str, int | None, Any]] = []

    def talk(entity: Entity, step: float) -> None:
        heard.extend((entity.number, m.name, m.sender, m.values.get("count")) for m in entity.messages)
        if entity.seconds == STEP:
            entity.send(entity.state.other, "hello", count=entity.number)

    behaviors = Behaviors(scene, interval=STEP)
    first = behaviors.add(talk, nodes[0], other=2)
    second = behaviors.add(talk, nodes[1], other=1)
    behaviors.update(STEP)
    assert heard == []
    behaviors.update(2 * STEP)
    assert heard == [(first, "hello", second, second), (second, "hello", first, first)]
    behaviors.send(first, "stop")
    behaviors.update(4 * STEP)
    assert heard[2:] == [(first, "stop", None, None)]


def test_a_number_is_of_one_entity_for_ever_and_that_of_a_removed_one_is_refused() -> None:
    scene, (node, _) = make_boxes(2)
    behaviors = Behaviors(scene, interval=STEP)
    first = behaviors.add(drive, node, speed=1.0)
    behaviors.update(STEP)
    behaviors.remove(first)
    behaviors.update(2 * STEP)
    assert read_z(scene, node) == STEP, "its node stays where it is"
    second = behaviors.add(drive, node, speed=1.0)
    assert first != second
    assert (first in behaviors, second in behaviors, len(behaviors)) == (False, True, 1)
    for call in (
        lambda: behaviors[first],
        lambda: behaviors.send(first, "x"),
        lambda: behaviors.remove(first),
    ):
        with pytest.raises(rhi.ValidationError) as error:
            call()
        assert error.value.rule.id == "scene-unknown-entity"
    assert behaviors[second].nodes.tolist() == [node]


def test_an_entity_that_another_removes_is_not_called_any_more() -> None:
    scene, nodes = make_boxes(2)
    calls: list[int] = []

    def shoot(entity: Entity, step: float) -> None:
        calls.append(entity.number)
        if entity.number == 1:
            behaviors.remove(2)

    behaviors = Behaviors(scene, interval=STEP)
    behaviors.add(shoot, nodes[0])
    behaviors.add(shoot, nodes[1])
    behaviors.update(STEP)
    assert calls == [1]


@pytest.mark.parametrize(
    ("fault", "rule"),
    [
        (lambda behaviors, nodes: behaviors.add("drive", nodes[0]), "scene-bad-behavior"),
        (lambda behaviors, nodes: behaviors.add(drive, [nodes[0], nodes[0]]), "scene-bad-behavior"),
        (lambda behaviors, nodes: behaviors.add(drive, nodes[1]), "scene-bad-behavior"),
        (lambda behaviors, nodes: behaviors.add(drive, 99), "scene-bad-index"),
        (lambda behaviors, nodes: behaviors.update(float("nan")), "scene-not-finite"),
    ],
)
def test_bad_entities_are_refused_and_change_nothing(fault: Any, rule: str) -> None:
    scene, nodes = make_boxes(2)
    behaviors = Behaviors(scene, interval=STEP)
    behaviors.add(drive, nodes[1], speed=1.0)
    with pytest.raises(rhi.ValidationError) as error:
        fault(behaviors, nodes)
    assert error.value.rule.id == rule
    assert len(behaviors) == 1
    behaviors.add(drive, nodes[0], speed=1.0)
    assert behaviors.update(STEP) == 1


def test_a_static_node_is_refused() -> None:
    builder = SceneBuilder("static")
    node = builder.add_node()
    builder.add_objects(node, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
    with pytest.raises(rhi.ValidationError) as error:
        Behaviors(builder.build()).add(drive, node)
    assert error.value.rule.id == "scene-static-node"


@pytest.mark.parametrize("interval", [0.0, -1.0, float("inf"), float("nan")])
def test_an_interval_must_be_above_0(interval: float) -> None:
    with pytest.raises(rhi.ValidationError) as error:
        Behaviors(make_boxes(1)[0], interval=interval)
    assert error.value.rule.id == "scene-bad-behavior"


def test_an_error_leaves_the_nodes_of_its_entity_and_names_it() -> None:
    scene, nodes = make_boxes(2)

    def fail(entity: Entity, step: float) -> None:
        entity.transforms[:] = 7.0
        raise RuntimeError("out of fuel")

    behaviors = Behaviors(scene, interval=STEP)
    behaviors.add(drive, nodes[0], speed=1.0)
    behaviors.add(fail, nodes[1])
    with pytest.raises(RuntimeError, match="out of fuel") as error:
        behaviors.update(2 * STEP)
    assert "entity 2" in error.value.__notes__[0]
    assert read_z(scene, nodes[0]) == STEP
    assert np.array_equal(scene.nodes.local[nodes[1]], translation((3.0, 0.0, 0.0)))
    behaviors.remove(2)
    assert behaviors.update(2 * STEP) == 1


def test_transforms_that_are_not_finite_are_refused() -> None:
    scene, (node,) = make_boxes(1)

    def vanish(entity: Entity, step: float) -> None:
        entity.transforms[:] = np.nan

    behaviors = Behaviors(scene, interval=STEP)
    behaviors.add(vanish, node)
    with pytest.raises(rhi.ValidationError) as error:
        behaviors.update(STEP)
    assert error.value.rule.id == "scene-bad-behavior"
    assert np.isfinite(scene.nodes.local).all()


MODULE = """
def drive(entity, step):
    entity.state.count += 1
    entity.transforms[:, 2, 3] += {speed} * step
"""


def test_a_reloaded_function_goes_on_with_the_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    path = tmp_path / "driving_of_a_test.py"
    path.write_text(MODULE.format(speed=1.0), encoding="utf-8")
    module = importlib.import_module("driving_of_a_test")
    scene, (node, other) = make_boxes(2)
    behaviors = Behaviors(scene, interval=STEP)
    number = behaviors.add(module.drive, node, count=0)
    behaviors.add(drive, other, speed=1.0)
    behaviors.update(STEP)
    path.write_text(MODULE.format(speed=100.0), encoding="utf-8")
    assert behaviors.reload(module) == 1
    behaviors.update(2 * STEP)
    assert read_z(scene, node) == 101.0 * STEP
    assert read_z(scene, other) == 2 * STEP
    for text in ("def drive(entity, step:\n", "speed = 2.0\n", "raise ValueError('no')\n"):
        path.write_text(text, encoding="utf-8")
        with pytest.raises((SyntaxError, ValueError, rhi.ValidationError)):
            behaviors.reload(module)
    behaviors.update(3 * STEP)
    assert read_z(scene, node) == 201.0 * STEP, "the last good function keeps moving it"
    assert behaviors[number].state.count == 3


def test_a_frame_shows_where_behaviours_have_moved_objects(gl: rhi.Device) -> None:
    scene, (node,) = make_boxes(1)
    behaviors = Behaviors(scene)
    behaviors.add(drive, node, speed=3.0)
    camera = Camera.look_at((0.0, 0.5, 6.0), (0.0, 0.0, 0.0))
    with Renderer(gl, scene, visibility="frustum", size=(64, 48)) as renderer:
        images = []
        for seconds in (0.0, 1.0, 1.0):
            behaviors.update(seconds)
            images.append(renderer.render(camera, seconds).image.read())
    assert not np.array_equal(images[0], images[1])
    assert np.array_equal(images[1], images[2])
    sizes = [(image != image[0, 0]).any(-1).sum() for image in images]
    assert sizes[1] > 1.5 * sizes[0], "it has come 3 m nearer"
