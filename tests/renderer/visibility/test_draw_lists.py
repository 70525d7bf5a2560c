"""Lists of draws made on the device: their draws, the order of these, and the hidden rows."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import rhi
from renderer.content import BUILT_IN, load_scene
from renderer.frame import SceneResources, View
from renderer.scene import Camera, Scene, SceneBuilder
from renderer.shaders import DRAW_LISTS, ListEntry, MeshPart, Object, ObjectPosition
from renderer.shaders.prefix_sum import PrefixSum
from renderer.visibility import NoCulling, SceneArrays
from renderer.visibility.gpu.draw_lists import (
    KEYS,
    MAX_PARTS,
    CountKeys,
    CountMarks,
    DrawArguments,
    IndirectDrawList,
    WriteDraws,
    WriteObjects,
    make_instance_sets,
)
from renderer.visibility.gpu.occludees import DRAWN, HIDDEN, OUTSIDE, VISIBLE, Occludee, Occludees
from rhi.shading import run_compute, uint

BUCKETS = 31


@dataclass
class Case:
    """The inputs of a list: marks, objects, their boxes and meshes, and the mesh parts."""

    marks: np.ndarray
    objects: np.ndarray
    positions: np.ndarray
    boxes: np.ndarray
    meshes: np.ndarray
    parts: np.ndarray

    def arrays(self, device: rhi.Device, view: View) -> SceneArrays:
        """Upload the case."""
        entries, begins = make_instance_sets(self.meshes, self.positions["draw_list"])
        return SceneArrays(
            view.buffer,
            device.storage(Object, self.objects),
            device.storage(ObjectPosition, self.positions),
            device.storage(MeshPart, self.parts),
            device.storage(int, self.meshes),
            device.storage(ListEntry, entries),
            device.storage(uint, begins),
        )


def make_case(count: int, seed: int, parts: int = 4) -> Case:
    rng = np.random.default_rng(seed)
    objects, positions, boxes, mesh_parts = (
        np.zeros(n, s.dtype)
        for n, s in ((count, Object), (count, ObjectPosition), (count, Occludee), (5, MeshPart))
    )
    objects["linear"][..., :3] = rng.normal(size=(count, 3, 3))
    objects["material"], positions["object_index"] = rng.integers(0, 99, count), np.arange(count)
    positions["draw_list"] = (
        rng.choice(4, count, p=[0.6, 0.2, 0.15, 0.05]) if parts == 4 else rng.integers(0, parts, count)
    )
    # Between the borders of half octaves, so that a logarithm's last bit doesn't matter.
    boxes["depth"] = rng.choice([-3.0, 0.0, 0.1, 1.1, 1.3, 5.0, 77.0, 5000.0, 1e20], count)
    mesh_parts["first"], mesh_parts["count"], mesh_parts["base_vertex"] = rng.integers(0, 999, (3, 5))
    meshes = rng.integers(0, 5, count).astype(np.int32)
    marks = rng.choice([HIDDEN, VISIBLE, OUTSIDE, DRAWN], count).astype(np.uint32)
    if seed % 2:  # meshes of which most objects are not visible
        marks[meshes != 3] = OUTSIDE
    return Case(marks, objects, positions, boxes, meshes, mesh_parts)


def expect(case: Case, part: int, classes: int = BUCKETS) -> list[np.ndarray]:
    """Return the expected objects of the draws of one part in their order: set by set, as the module says."""
    sets = []
    for mesh in range(5):
        is_in_set = (case.positions["draw_list"] == part) & (case.meshes == mesh)
        rows = np.flatnonzero(is_in_set & (case.marks == VISIBLE))
        if len(rows):
            sets.append(rows)
    octaves = np.log2(np.maximum(case.boxes["depth"], 0.125)) + 3.0
    keys = np.floor(octaves * (2.0 * classes / BUCKETS)).clip(0, classes - 1)
    return sorted(sets, key=lambda rows: keys[rows[0]])


def check(case: Case, after: dict[str, np.ndarray], parts: int = 4) -> None:
    marks, count = case.marks, len(case.marks)
    totals, draws = after["totals"], after["listed"]
    for part in range(parts):
        sets = expect(case, part, (KEYS - 2) // max(parts, 4))
        assert totals[part] == len(sets)
        listed = draws[count * part : count * part + len(sets)]
        assert listed["instances"].tolist() == [len(rows) for rows in sets]
        for rows, draw in zip(sets, listed, strict=True):
            mesh = case.parts[case.meshes[rows[0]]]
            assert all(draw[field] == mesh[field] for field in ("count", "first", "base_vertex"))
            instances = slice(draw["base_instance"], draw["base_instance"] + draw["instances"])
            for field in ("object_index", "draw_list"):
                assert after["positions"][field][instances].tolist() == case.positions[field][rows].tolist()
            assert after["objects"]["material"][instances].tolist() == case.objects["material"][rows].tolist()
            linear = after["objects"]["linear"][instances], case.objects["linear"][rows]
            assert np.array_equal(linear[0][..., :3], linear[1][..., :3])
    hidden = np.flatnonzero(marks == HIDDEN)
    assert totals[parts] == after["boxes"][0]["instances"] == len(hidden)
    assert after["hidden"][: len(hidden)].tolist() == hidden.tolist()
    assert after["marks"].tolist() == np.where(marks == VISIBLE, DRAWN, marks).tolist()


@settings(max_examples=15)
@given(st.integers(1, 300), st.integers(0, 999))
@example(64, 0)
@example(65, 1)
def test_lists_are_of_marked_objects_by_mesh(count: int, seed: int) -> None:
    case = make_case(count, seed)
    entries, begins = make_instance_sets(case.meshes, case.positions["draw_list"])
    groups, set_groups = -(-count // 64), -(-(len(begins) - 1) // 64)
    marked = run_compute(CountMarks, groups, entries=entries, marks=case.marks, counts=2 * count + 1)
    sums = run_compute(PrefixSum, 1, counts=marked["counts"])["counts"]
    assert sums.tolist() == np.append(0, np.cumsum(marked["counts"]))[:-1].tolist()
    objects = run_compute(
        WriteObjects,
        groups,
        entries=entries,
        objects=case.objects,
        object_positions=case.positions,
        sums=sums,
        marks=case.marks,
        listed_objects=count,
        listed_positions=count,
        hidden=count,
    )
    counted = run_compute(
        CountKeys,
        set_groups,
        set_begins=begins,
        sums=sums,
        listed_positions=objects["listed_positions"],
        occludees=case.boxes,
        keys=count,
        counts=KEYS * set_groups,
        boxes=np.zeros(1, DrawArguments.dtype),
    )
    written = run_compute(
        WriteDraws,
        set_groups,
        mesh_parts=case.parts,
        entries=entries,
        set_begins=begins,
        sums=sums,
        keys=counted["keys"],
        key_sums=run_compute(PrefixSum, 1, counts=counted["counts"])["counts"],
        listed=4 * count,
        totals=5,
    )
    copies = {"objects": objects["listed_objects"], "positions": objects["listed_positions"]}
    check(case, objects | counted | written | copies)


@pytest.mark.parametrize("listed", [5, 8, 20, MAX_PARTS])
def test_lists_may_have_more_parts(device: rhi.Device, listed: int) -> None:
    """With fewer and wider classes of distances."""
    check_on_device(device, make_case(900, listed, listed), listed)


def aim(device: rhi.Device, scene: Scene, resources: SceneResources) -> View:
    """Look at the scene's middle."""
    camera = Camera.look_at((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
    view = View(device, "eye", NoCulling(scene))
    view.aim(camera)
    resources.update(camera)
    return view


def check_on_device(device: rhi.Device, case: Case, parts: int = DRAW_LISTS) -> None:
    """Make the list of a case twice."""
    occludees = Occludees(device, len(case.marks))
    occludees.marks.write(case.marks)
    occludees.boxes.write(case.boxes)
    lists = IndirectDrawList(device, occludees, parts)
    scene = load_scene("grid:mesh=box,count=1")
    resources = SceneResources(device, scene)
    view = aim(device, scene, resources)
    arrays = case.arrays(device, view)
    readings = []
    for _ in range(2):  # the second time nothing is VISIBLE any more
        lists.list_draws(device, arrays)
        after = {
            "marks": occludees.marks.read(),
            "listed": lists.draws.read(),
            "objects": lists.objects.read(),
            "positions": lists.object_positions.read(),
            "totals": lists.totals.read(),
            "hidden": lists.hidden.read(),
            "boxes": lists.box_draw.read(),
        }
        check(case, after, parts)
        sets = [rows for part in range(parts) for rows in expect(case, part, (KEYS - 2) // max(parts, 4))]
        listed = np.concatenate([np.zeros(0, np.int64), *sets]).tolist()
        assert lists.read_object_indices().tolist() == listed
        readings.append((lists.read_object_indices_async(), listed))
        case.marks = after["marks"]
    assert all(wait().tolist() == listed for wait, listed in readings)
    buffers = [
        getattr(arrays, field.name).owner
        for field in fields(arrays)
        if field.name not in ("view", "detail", "meshlets")
    ]
    for resource in (occludees, lists, resources, view, *buffers):
        resource.destroy()


@settings(max_examples=5)
@given(st.integers(1, 3000), st.integers(0, 999))
@example(20_000, 2)
def test_a_device_makes_the_same_lists(device: rhi.Device, count: int, seed: int) -> None:
    check_on_device(device, make_case(count, seed))


@pytest.mark.parametrize("count", [1, 64, 65, 200])
def test_alike_objects_are_instances_of_one_draw(gl: rhi.Device, count: int) -> None:
    scene = load_scene(f"grid:mesh=box,count={count}")
    resources = SceneResources(gl, scene)
    view = aim(gl, scene, resources)
    for has_instances in (True, False):  # without them, each object is a draw: the control
        occludees = Occludees(gl, count)
        occludees.marks.write(np.full(count, VISIBLE, np.uint32))
        occludees.boxes.write(np.zeros(count, Occludee.dtype))
        lists = IndirectDrawList(gl, occludees, has_instances=has_instances)
        lists.list_draws(gl, resources.scene_arrays(view.buffer))
        total = int(lists.totals.read()[0])
        assert lists.draws.read(0, total)["instances"].tolist() == ([count] if has_instances else [1] * count)
        assert lists.read_object_indices().tolist() == list(range(count))
        lists.destroy()
        occludees.destroy()
    resources.destroy()
    view.destroy()


def test_instance_sets_follow_meshes_and_states(null: rhi.Device) -> None:
    builder = SceneBuilder("boxes")
    nodes = builder.add_nodes(np.stack([np.eye(4)] * 9), dynamic=True)
    builder.add_objects(nodes, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
    scene = builder.build()
    resources = SceneResources(null, scene)
    view = aim(null, scene, resources)
    before = resources.scene_arrays(view.buffer)
    assert resources.scene_arrays(view.buffer) == before  # nothing is written again: the control
    assert before.set_begins.count == 2
    scene.nodes.set_local(scene.objects.node[4:5], np.diag([-1.0, 1.0, 1.0, 1.0])[None])
    scene.refresh()
    resources.update(view.camera)
    assert resources.scene_arrays(view.buffer).set_begins.count == 3
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
