"""The buffers of a scene on a device, and when they are written."""

from __future__ import annotations

import numpy as np
import pytest
from frames import make_boxes
from hypothesis import given
from hypothesis import strategies as st

import rhi
from renderer.frame import MirroredArray, SceneResources
from renderer.lights.object_lists import list_lights
from renderer.scene import Camera, Scene, translation
from rhi.shading import vec4


def rows(*values: float) -> np.ndarray:
    return np.repeat(np.array(values, np.float32)[:, None], 4, axis=1)


def test_an_empty_array_has_no_buffer(null: rhi.Device) -> None:
    array = MirroredArray(null, vec4, "rows")
    array.write(rows())
    assert array.buffer is None
    assert len(array) == 0


def test_equal_rows_are_not_written_again(null: rhi.Device) -> None:
    array = MirroredArray(null, vec4, "rows")
    array.write(rows(1, 2, 3))
    null.reset_statistics()
    array.write(rows(1, 2, 3))
    assert null.statistics.upload_bytes == 0


def test_rows_are_written_from_the_first_to_the_last_that_differ(null: rhi.Device) -> None:
    array = MirroredArray(null, vec4, "rows")
    array.write(rows(1, 2, 3, 4, 5))
    null.reset_statistics()
    array.write(rows(1, 9, 3, 9, 5))
    assert null.statistics.upload_bytes == 3 * 16


def test_another_number_of_rows_is_another_buffer(null: rhi.Device) -> None:
    array = MirroredArray(null, vec4, "rows")
    array.write(rows(1, 2))
    before = array.buffer
    array.write(rows(1, 2, 3))
    assert before is not None
    assert before.owner.destroyed
    assert len(array) == 3
    array.write(rows())
    assert array.buffer is None


@given(st.lists(st.lists(st.integers(0, 3), max_size=6), min_size=1, max_size=6))
def test_the_buffer_has_the_latest_written_values(history: list[list[int]]) -> None:
    with rhi.create_device("null") as device:
        array = MirroredArray(device, vec4, "rows")
        for values in history:
            array.write(rows(*values))
            content = rows() if array.buffer is None else array.buffer.read()
            assert np.array_equal(content, rows(*values))


def lit_boxes() -> Scene:
    """Make 6 fixed and 6 moving boxes a metre apart in two lines, along which 5 lights of a range of 2 m
    stand."""
    builder = make_boxes()
    object_positions = np.stack([np.tile(np.arange(6.0), 2), np.zeros(12), np.repeat([0.0, 3.0], 6)], axis=1)
    nodes = builder.add_nodes(translation(object_positions), dynamic=np.arange(12) % 2 == 0)
    builder.add_objects(nodes, 0, 0)
    builder.lights.add_points(object_positions[:5:2], 2.0)
    builder.lights.add_spots(object_positions[7:10:2], (0, -1, 0), 2.0, 0.1, 0.2)
    return builder.build()


def lights_of(resources: SceneResources) -> list[tuple[list[int], list[int]]]:
    """Return for each object the rows of its point and of its spot lights."""
    rows, lists = resources.objects.buffer, resources.light_list.buffer
    assert rows is not None
    assert lists is not None
    table, listed = rows.read(), lists.read()
    return [
        (
            listed[row["lights_begin"] : row["point_lights_end"]].tolist(),
            listed[row["point_lights_end"] : row["lights_end"]].tolist(),
        )
        for row in table
    ]


def test_lists_follow_objects_and_lights_that_move(null: rhi.Device) -> None:
    scene = lit_boxes()
    camera = Camera.look_at((0, 0, 10), (0, 0, 0))
    resources = SceneResources(null, scene)

    def move_objects() -> None:
        scene.nodes.set_local(
            scene.objects.node[scene.objects.following_indices], translation((0.0, 0.0, 1.5))
        )
        scene.refresh()

    def move_lights() -> None:
        scene.lights.point["position"][:, 2] += 2.0

    lists = []
    for change in (None, move_objects, move_lights):
        if change is not None:
            change()
        resources.update(camera)
        fresh = SceneResources(null, scene)
        fresh.update(camera)
        lists.append(lights_of(resources))
        assert lists[-1] == lights_of(fresh)
        fresh.destroy()
    assert lists[0] != lists[1] != lists[2]


def test_objects_that_move_do_not_list_the_lights_of_others_again(
    null: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, counts = lit_boxes(), []

    def list_counted(lower: np.ndarray, *others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        counts.append(len(lower))
        return list_lights(lower, *others)

    monkeypatch.setattr("renderer.frame.resources.list_lights", list_counted)
    camera = Camera.look_at((0, 0, 10), (0, 0, 0))
    resources = SceneResources(null, scene)
    resources.update(camera)
    assert counts == [6, 6]
    scene.nodes.set_local(
        scene.objects.node[scene.objects.following_indices[:1]], translation((0.0, 5.0, 0.0))[None]
    )
    scene.refresh()
    resources.update(camera)
    assert counts == [6, 6, 6]
    scene.lights.spot["range"] *= 2.0
    resources.update(camera)
    assert counts == [6, 6, 6, 6, 6]
    resources.update(camera)
    assert len(counts) == 5
