"""Lists of draws made on the device: their draws, the order of these, and the hidden rows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import rhi
from renderer.content import load_scene
from renderer.frame import SceneResources, View
from renderer.scene import Camera, Scene
from renderer.scene.arrays import list_ranges
from renderer.shaders import DRAW_LISTS, MeshPart, ObjectPosition
from renderer.shaders.prefix_sum import PrefixSum
from renderer.visibility import NoCulling
from renderer.visibility.gpu.draw_lists import (
    KEYS,
    MAX_PARTS,
    CountKeys,
    DrawArguments,
    IndirectDrawList,
    WriteDraws,
)
from renderer.visibility.gpu.occludees import DRAWN, HIDDEN, OUTSIDE, VISIBLE, Occludee, Occludees
from rhi.shading import run_compute

BUCKETS = 31


def buckets(depth: np.ndarray) -> np.ndarray:
    """Return the half octaves, counted from 1/8 m."""
    return np.clip(np.floor(2.0 * np.log2(np.maximum(depth, 0.125))).astype(int) + 6, 0, BUCKETS - 1)


def make_objects(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    marks = rng.choice([HIDDEN, VISIBLE, OUTSIDE, DRAWN], count).astype(np.uint32)
    object_positions, boxes, parts = (
        np.zeros(n, s.dtype) for n, s in ((count, ObjectPosition), (count, Occludee), (5, MeshPart))
    )
    object_positions["mesh"], object_positions["draw_list"] = (
        rng.integers(0, 5, count),
        rng.choice(4, count, p=[0.6, 0.2, 0.15, 0.05]),
    )
    # Between the borders of half octaves, so that a logarithm's last bit doesn't matter.
    boxes["depth"] = rng.choice([-3.0, 0.0, 0.1, 1.1, 1.3, 5.0, 77.0, 5000.0, 1e20], count)
    parts["first"], parts["count"], parts["base_vertex"] = rng.integers(0, 999, (3, 5))
    if seed % 2:  # runs of equal rows, which become instances
        runs = np.arange(count) // rng.integers(1, 150)
        marks, object_positions, boxes = marks[runs], object_positions[runs], boxes[runs]
    return marks, object_positions, boxes, parts


def expect(marks: np.ndarray, object_positions: np.ndarray, boxes: np.ndarray, part: int) -> np.ndarray:
    """Return the expected rows of one part in the order of their draws."""
    rows = np.flatnonzero((marks == VISIBLE) & (object_positions["draw_list"] == part))
    return rows[np.argsort(buckets(boxes["depth"][rows]), kind="stable")]


def count_instances(rows: np.ndarray, object_positions: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Return the numbers of instances of the draws of rows in order: row by row, as the module says."""
    counts: list[int] = []
    before = -2
    for row in rows.tolist():
        alike = [
            (index // 64, int(object_positions["mesh"][index]), int(buckets(boxes["depth"][index])))
            for index in (before, row)
        ]
        if row == before + 1 and alike[0] == alike[1]:
            counts[-1] += 1
        else:
            counts.append(1)
        before = row
    return np.array(counts, np.int64)


def check(
    marks: np.ndarray,
    object_positions: np.ndarray,
    boxes: np.ndarray,
    parts: np.ndarray,
    after: dict[str, np.ndarray],
) -> None:
    count, totals, draws = len(marks), after["totals"], after["listed"]
    for part in range(4):
        rows, begin = expect(marks, object_positions, boxes, part), part * count
        instances = count_instances(rows, object_positions, boxes)
        assert totals[part] == len(instances)
        heads = rows[np.cumsum(instances) - instances]
        listed, mesh = draws[begin : begin + len(heads)], parts[object_positions["mesh"][heads]]
        assert listed["base_instance"].tolist() == heads.tolist()
        assert listed["instances"].tolist() == instances.tolist()
        for field in ("count", "first", "base_vertex"):
            assert listed[field].tolist() == mesh[field].tolist()
    hidden = np.flatnonzero(marks == HIDDEN)
    assert totals[4] == after["boxes"][0]["instances"] == len(hidden)
    assert after["hidden"][: len(hidden)].tolist() == hidden.tolist()
    assert after["marks"].tolist() == np.where(marks == VISIBLE, DRAWN, marks).tolist()


@settings(max_examples=15)
@given(st.integers(1, 300), st.integers(0, 999))
@example(64, 0)
@example(65, 1)
def test_lists_are_of_marked_rows_near_first(count: int, seed: int) -> None:
    marks, object_positions, boxes, parts = make_objects(count, seed)
    groups = -(-count // 64)
    counted = run_compute(
        CountKeys,
        groups,
        object_positions=object_positions,
        occludees=boxes,
        marks=marks,
        keys=count,
        counts=KEYS * groups,
    )
    sums = run_compute(PrefixSum, 1, counts=counted["counts"])["counts"]
    assert sums.tolist() == np.append(0, np.cumsum(counted["counts"]))[:-1].tolist()
    written = run_compute(
        WriteDraws,
        groups,
        object_positions=object_positions,
        mesh_parts=parts,
        keys=counted["keys"],
        sums=sums,
        listed=4 * count,
        hidden=count,
        totals=5,
        boxes=np.zeros(1, DrawArguments.dtype),
    )
    check(marks, object_positions, boxes, parts, counted | written)


@pytest.mark.parametrize("listed", [5, 8, 20, MAX_PARTS])
def test_lists_may_have_more_parts(device: rhi.Device, listed: int) -> None:
    """With fewer and wider classes of distances."""
    count, rng = 900, np.random.default_rng(listed)
    marks, object_positions, boxes, parts = make_objects(count, listed)
    object_positions["draw_list"] = rng.integers(0, listed, count)
    occludees = Occludees(device, count)
    occludees.marks.write(marks)
    occludees.boxes.write(boxes)
    lists = IndirectDrawList(device, occludees, listed)
    scene = load_scene("grid:mesh=box,count=1")
    resources = SceneResources(device, scene)
    view = aim(device, scene, resources)
    arrays = resources.scene_arrays(view.buffer)
    given_places, given_parts = (
        device.storage(ObjectPosition, object_positions),
        device.storage(MeshPart, parts),
    )
    lists.list_draws(device, type(arrays)(arrays.view, arrays.objects, given_places, given_parts))
    totals, draws, classes = lists.totals.read(), lists.draws.read(), (KEYS - 2) // listed
    octaves = np.log2(np.maximum(boxes["depth"], 0.125)) + 3.0
    order = np.argsort(np.floor(octaves * (2.0 * classes / BUCKETS)).clip(0, classes - 1), kind="stable")
    for part in range(listed):
        expected = order[((marks == VISIBLE) & (object_positions["draw_list"] == part))[order]]
        drawn = draws[part * count : part * count + totals[part]]
        assert list_ranges(drawn["base_instance"], drawn["instances"]).tolist() == expected.tolist()
    assert totals[listed] == (marks == HIDDEN).sum()
    for resource in (occludees, lists, resources, view, given_places, given_parts):
        resource.destroy()


def aim(device: rhi.Device, scene: Scene, resources: SceneResources) -> View:
    """Look at the scene's middle."""
    camera = Camera.look_at((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
    view = View(device, "eye", NoCulling(scene))
    view.aim(camera)
    resources.update(camera)
    return view


@settings(max_examples=5)
@given(st.integers(1, 3000), st.integers(0, 999))
@example(20_000, 2)
def test_a_device_makes_the_same_lists(device: rhi.Device, count: int, seed: int) -> None:
    marks, object_positions, boxes, parts = make_objects(count, seed)
    occludees = Occludees(device, count)
    occludees.marks.write(marks)
    occludees.boxes.write(boxes)
    lists = IndirectDrawList(device, occludees)
    scene = load_scene("grid:mesh=box,count=1")
    resources = SceneResources(device, scene)
    view = aim(device, scene, resources)
    arrays = resources.scene_arrays(view.buffer)
    given_arrays = type(arrays)(
        arrays.view,
        arrays.objects,
        device.storage(ObjectPosition, object_positions),
        device.storage(MeshPart, parts),
    )
    readings = []
    for _ in range(2):  # the second time nothing is VISIBLE any more
        lists.list_draws(device, given_arrays)
        after = {
            "marks": occludees.marks.read(),
            "listed": lists.draws.read(),
            "totals": lists.totals.read(),
            "hidden": lists.hidden.read(),
            "boxes": lists.box_draw.read(),
        }
        check(marks, object_positions, boxes, parts, after)
        rows = [expect(marks, object_positions, boxes, part) for part in range(4)]
        listed = np.concatenate(rows).tolist()
        assert lists.read_object_indices().tolist() == listed
        readings.append((lists.read_object_indices_async(), listed))
        marks = after["marks"]
    assert all(wait().tolist() == listed for wait, listed in readings)
    for resource in (
        occludees,
        lists,
        resources,
        view,
        given_arrays.object_positions.owner,
        given_arrays.mesh_parts.owner,
    ):
        resource.destroy()


@pytest.mark.parametrize(
    ("count", "draws"), [(1, [1]), (63, [63]), (64, [64]), (65, [64, 1]), (200, [64, 64, 64, 8])]
)
def test_alike_rows_are_instances_of_a_draw_for_each_group(
    gl: rhi.Device, count: int, draws: list[int]
) -> None:
    scene = load_scene(f"grid:mesh=box,count={count}")
    resources = SceneResources(gl, scene)
    view = aim(gl, scene, resources)
    for has_instances in (True, False):  # without them, each row is a draw: the control
        occludees = Occludees(gl, count)
        occludees.marks.write(np.full(count, VISIBLE, np.uint32))
        occludees.boxes.write(np.zeros(count, Occludee.dtype))
        lists = IndirectDrawList(gl, occludees, has_instances=has_instances)
        lists.list_draws(gl, resources.scene_arrays(view.buffer))
        total = int(lists.totals.read()[0])
        assert lists.draws.read(0, total)["instances"].tolist() == (draws if has_instances else [1] * count)
        assert lists.read_object_indices().tolist() == list(range(count))
        lists.destroy()
        occludees.destroy()
    resources.destroy()
    view.destroy()


def test_arguments_lie_where_indirect_draws_look_for_them(null: rhi.Device) -> None:
    lists = IndirectDrawList(null, Occludees(null, 10))
    parts = [lists.arguments(part) for part in range(DRAW_LISTS)]
    assert DrawArguments.dtype.itemsize == rhi.DRAW.itemsize == parts[0].stride
    assert [DrawArguments.dtype.fields[name][1] for name in rhi.DRAW.names or ()] == [0, 4, 8, 12, 16]
    assert [draws.offset for draws in parts] == [10 * part * rhi.DRAW.itemsize for part in range(4)]
    assert [draws.count_offset for draws in parts] == [0, 4, 8, 12]


@pytest.mark.parametrize("count", [1, 64, 65])
def test_each_list_is_another_generation(null: rhi.Device, count: int) -> None:
    scene = load_scene(f"grid:mesh=box,count={count}")
    lists, resources = IndirectDrawList(null, Occludees(null, count)), SceneResources(null, scene)
    view = aim(null, scene, resources)
    before = lists.generation
    lists.renew()
    lists.list_draws(null, resources.scene_arrays(view.buffer))
    assert lists.generation == before + 1
