"""The node hierarchy: sorting and updates by level, static and dynamic nodes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused_rule

from renderer.scene import Nodes, rotation, translation
from rhi.errors import ValidationError
from rhi.math import multiply


@st.composite
def forests(draw):
    count = draw(st.integers(1, 60))
    parents = [draw(st.integers(-1, max(i - 1, -1))) for i in range(count)]
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    local = multiply(translation(rng.normal(size=(count, 3))), rotation((0, 1, 0), rng.normal(size=count)))
    return np.array(parents), local


def expected_world(parents, local):
    world = []
    for parent, matrix in zip(parents, local, strict=True):
        world.append(matrix if parent < 0 else world[parent] @ matrix)
    return np.array(world)


@given(forest=forests())
@settings(max_examples=60)
def test_world_transforms_are_the_products_along_the_parents(forest):
    parents, local = forest
    nodes = Nodes(parents, local)
    assert np.allclose(nodes.world[nodes.index_of_id], expected_world(parents, local))


@given(forest=forests(), seed=st.integers(0, 1000))
@settings(max_examples=60)
def test_an_update_after_moves_equals_building_anew(forest, seed):
    parents, local = forest
    nodes = Nodes(parents, local, dynamic=True)
    rng = np.random.default_rng(seed)
    moved = np.flatnonzero(rng.random(len(parents)) < 0.3)
    local[moved] = translation(rng.normal(size=(len(moved), 3)))
    nodes.set_local(nodes.index_of_id[moved], local[moved])
    changed = nodes.update()
    assert np.allclose(nodes.world[nodes.index_of_id], expected_world(parents, local))
    below = np.isin(np.arange(len(parents)), moved)
    for node, parent in enumerate(parents):
        below[node] |= parent >= 0 and below[parent]
    assert changed[nodes.index_of_id].tolist() == below.tolist()


def test_nodes_are_sorted_by_level_with_parents_before_children():
    nodes = Nodes([-1, 0, 1, -1, 3, 2], np.tile(np.eye(4), (6, 1, 1)))
    assert nodes.level_starts.tolist() == [0, 2, 4, 5, 6]
    assert nodes.index_of_id.tolist() == [0, 2, 4, 1, 3, 5]
    assert nodes.parents.tolist() == [-1, -1, 0, 1, 2, 4]


def test_a_chain_of_a_thousand_nodes_adds_up():
    count = 1000
    nodes = Nodes(np.arange(count) - 1, np.tile(translation((1.0, 0.0, 0.0)), (count, 1, 1)))
    assert nodes.world[-1][0, 3] == count


def test_an_update_without_moves_changes_nothing():
    nodes = Nodes([-1, 0], np.tile(np.eye(4), (2, 1, 1)), dynamic=True)
    assert not nodes.update().any()


def test_an_update_that_is_refused_changes_nothing_until_the_node_is_mended():
    nodes = Nodes([-1, 0], np.tile(np.eye(4), (2, 1, 1)), dynamic=True)
    before = nodes.world.copy()
    nodes.set_local([0, 1], np.array([np.diag([2.0, 2, 2, 1]), np.diag([1e31, 1, 1, 1])]))
    for _ in range(2):
        assert refused_rule(nodes.update) == "scene-bad-transform"
        assert np.array_equal(nodes.world, before)
    nodes.set_local([1], np.eye(4)[None])
    assert nodes.update().all()
    assert np.array_equal(nodes.world, np.tile(np.diag([2.0, 2, 2, 1]), (2, 1, 1)))


def test_descendants_of_a_dynamic_node_are_dynamic():
    nodes = Nodes([-1, 0, 1, -1], np.tile(np.eye(4), (4, 1, 1)), dynamic=[False, True, False, False])
    assert nodes.dynamic[nodes.index_of_id].tolist() == [False, True, True, False]


def test_a_static_node_refuses_to_move_and_a_dynamic_one_moves():
    nodes = Nodes([-1, -1], np.tile(np.eye(4), (2, 1, 1)), dynamic=[False, True], names=["wall", "door"])
    nodes.set_local(nodes.find("door"), translation((1, 0, 0)))
    with pytest.raises(ValidationError, match="wall") as error:
        nodes.set_local([nodes.find("door"), nodes.find("wall")], translation((2, 0, 0)))
    assert error.value.rule.id == "scene-static-node"
    nodes.update()
    assert nodes.world[nodes.find("door")][0, 3] == 1.0  # nothing of the refused call was done


@pytest.mark.parametrize("rows", [[-1], [2]])
def test_an_index_out_of_range_is_refused(rows):
    nodes = Nodes([-1, -1], np.tile(np.eye(4), (2, 1, 1)), dynamic=True)
    assert refused_rule(lambda: nodes.set_local(rows, np.eye(4))) == "scene-bad-index"


@pytest.mark.parametrize("bad", [np.full((4, 4), np.nan), np.ones((4, 4)), np.eye(3)])
def test_a_matrix_that_is_not_affine_is_refused(bad):
    nodes = Nodes([-1], np.eye(4)[None], dynamic=True)
    assert refused_rule(lambda: nodes.set_local([0], bad)) == "scene-bad-transform"


@pytest.mark.parametrize("parents", [[0], [-2], [1, -1]])
def test_a_parent_that_does_not_come_before_is_refused(parents):
    assert refused_rule(lambda: Nodes(parents, np.tile(np.eye(4), (len(parents), 1, 1)))) == "scene-bad-index"


def test_an_unknown_name_is_refused_with_the_nearest():
    nodes = Nodes([-1], np.eye(4)[None], names=["flag"])
    with pytest.raises(ValidationError, match="did you mean 'flag'"):
        nodes.find("flags")


def test_transforms_cannot_be_written_past_the_checks():
    nodes = Nodes([-1], np.eye(4)[None], dynamic=True)
    with pytest.raises(ValueError, match="read-only"):
        nodes.local[0, 0, 0] = 2.0


@given(st.integers(0, 10_000))
def test_reparented_nodes_equal_nodes_built_with_those_parents(seed: int) -> None:
    random, count = np.random.default_rng(seed), 12
    parents = np.array([random.integers(-1, row) if row else -1 for row in range(count)])
    local = translation(random.normal(size=(count, 3)))
    nodes = Nodes(parents, local, dynamic=True)
    above = nodes.parents.tolist()
    hidden = int(random.integers(count))
    nodes.hide(hidden)
    for _ in range(6):
        row, parent = int(random.integers(count)), int(random.integers(-1, count))
        at = parent
        while at not in (-1, row):
            at = above[at]
        if at == row:  # below itself
            with pytest.raises(ValidationError, match="scene-bad-index"):
                nodes.set_parent(row, parent)
        else:
            nodes.set_parent(row, parent)
            above[row] = parent
        assert nodes.parents.tolist() == above
        nodes.update()
        nodes.update_hidden()
    for row in range(count):
        position, at, is_hidden = np.zeros(3), row, False
        while at >= 0:
            position, is_hidden = position + nodes.local[at, :3, 3], is_hidden or at == hidden
            at = above[at]
        assert np.allclose(nodes.world[row, :3, 3], position)
        assert nodes.hidden[row] == is_hidden


def test_a_static_node_keeps_its_parent() -> None:
    nodes = Nodes([-1, -1], np.tile(np.eye(4), (2, 1, 1)), dynamic=[False, True], names=["wall", "door"])
    with pytest.raises(ValidationError, match="wall"):
        nodes.set_parent(0, 1)
    nodes.set_parent(1, 0)
    assert nodes.parents.tolist() == [-1, 0]
