"""The bounding volume hierarchy: both builders give valid trees for any boxes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_culling import make_boxes

from renderer.visibility import build_by_area, build_by_middle
from rhi.errors import ValidationError

BUILDERS = [build_by_area, build_by_middle]


@st.composite
def any_boxes(draw):
    """Draw boxes of difficult kinds: equal, flat, huge, tiny and far ones."""
    count = draw(st.integers(0, 60))
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    scale = 10.0 ** draw(st.sampled_from([-200, -12, 0, 6, 150, 299]))
    centre = rng.uniform(-1.0, 1.0, (count, 3)) * scale
    centre[rng.random(count) < 0.3] = draw(st.sampled_from([0.0, 0.5 * scale]))
    centre *= rng.random((1, 3)) < 0.8  # all in a plane, on a line or at a point
    extent = rng.uniform(0.0, 1.0, (count, 3)) * scale * 10.0 ** rng.integers(-8, 1, (count, 1))
    extent[rng.random((count, 3)) < 0.2] = 0.0
    return centre - 0.5 * extent, centre + 0.5 * extent


def boxes_of(tree, node):
    return tree.order[tree.first[node] : tree.first[node] + tree.count[node]]


def check_tree(tree, lower, upper, leaf_size):
    count = len(lower)
    assert sorted(tree.order.tolist()) == list(range(count))
    assert len(tree) == 0 if count == 0 else tree.parent[0] == -1
    for node in range(len(tree)):
        rows = boxes_of(tree, node)
        assert (tree.lower[node] == lower[rows].min(0)).all()
        assert (tree.upper[node] == upper[rows].max(0)).all()
        child = tree.child[node]
        if child < 0:
            assert 1 <= len(rows) <= leaf_size
        else:
            assert len(rows) > leaf_size
            assert tree.parent[child] == tree.parent[child + 1] == node
            assert tree.first[child] == tree.first[node]
            assert tree.first[child + 1] == tree.first[node] + tree.count[child]
            assert tree.count[child] + tree.count[child + 1] == tree.count[node]
            assert min(tree.count[child], tree.count[child + 1]) > 0


@pytest.mark.parametrize("build", BUILDERS)
@pytest.mark.parametrize("count", [0, 1, 4, 5, 300])
def test_a_tree_covers_every_box_once_with_exact_bounds(build, count):
    lower, upper = make_boxes(count)
    check_tree(build(lower, upper), lower, upper, 4)


@pytest.mark.parametrize("build", BUILDERS)
@given(boxes=any_boxes(), leaf_size=st.integers(1, 9))
@settings(max_examples=60)
def test_a_tree_is_valid_for_hard_boxes(build, boxes, leaf_size):
    check_tree(build(*boxes, leaf_size=leaf_size), *boxes, leaf_size)


def test_depth_is_bounded_when_the_area_heuristic_would_peel_one_box_at_a_time():
    centre = np.zeros((400, 3))
    centre[:, 0] = 2.0 ** -np.arange(400)
    tree = build_by_area(centre, centre, leaf_size=1)
    assert len(tree.level_starts) - 1 <= 2 * 9 + 4 + 10


def test_the_area_heuristic_separates_two_clusters():
    lower, upper = make_boxes(40, spread=1.0)
    lower[10:] += 1000.0
    upper[10:] += 1000.0
    tree = build_by_area(lower, upper)
    assert sorted(boxes_of(tree, tree.child[0]).tolist()) == list(range(10))


def test_the_area_heuristic_costs_less_than_the_middle():
    rng = np.random.default_rng(3)
    lower, upper = make_boxes(2000)
    upper[rng.random(2000) < 0.05] += 60.0  # a few large boxes among many small ones
    cost = []
    for build in BUILDERS:
        tree = build(lower, upper)
        size = tree.upper - tree.lower
        area = size[:, 0] * size[:, 1] + size[:, 1] * size[:, 2] + size[:, 2] * size[:, 0]
        cost.append((area * np.where(tree.child < 0, tree.count, 1)).sum() / area[0])
    assert cost[0] < 0.95 * cost[1]


def test_a_split_in_the_middle_separates_centres_at_half_of_the_longest_axis():
    lower, upper = make_boxes(1000)
    tree = build_by_middle(lower, upper)
    centre = 0.5 * (lower + upper)
    for node in np.flatnonzero(tree.child >= 0)[:40]:
        among = centre[boxes_of(tree, node)]
        axis = np.ptp(among, axis=0).argmax()
        middle = 0.5 * (among[:, axis].min() + among[:, axis].max())
        assert (centre[boxes_of(tree, tree.child[node]), axis] <= middle).all()
        assert (centre[boxes_of(tree, tree.child[node] + 1), axis] > middle).all()


def test_splits_in_the_middle_have_limited_depth():
    # Each box lies at half the distance of the one before: middles alone would cut them off one by one.
    lower = np.zeros((200, 3))
    lower[:, 0] = 0.5 ** np.arange(200)
    tree = build_by_middle(lower, lower, leaf_size=1)
    assert len(tree.level_starts) - 1 <= 2 * 8 + 4 + 8 + 1
    assert len(tree) == 399


@pytest.mark.parametrize("size", [1, 4, 16, 1000])
def test_a_cut_covers_the_order_in_runs_of_at_most_its_size(size):
    lower, upper = make_boxes(700)
    tree = build_by_area(lower, upper)
    cut = tree.cut(size)
    ends = tree.first[cut] + tree.count[cut]
    assert tree.first[cut][0] == 0
    assert (ends[:-1] == tree.first[cut][1:]).all()
    assert ends[-1] == 700
    assert (tree.count[cut] <= max(size, 4)).all()
    parents = tree.parent[cut][tree.parent[cut] >= 0]
    assert (tree.count[parents] > size).all()


@pytest.mark.parametrize("build", BUILDERS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1.1e300])
def test_bounds_that_are_not_finite_or_too_large_are_refused(build, bad):
    lower, upper = make_boxes(9)
    upper[4, 1] = bad
    with pytest.raises(ValidationError, match=r"^\[visibility-bad-bounds\]"):
        build(lower, upper)


@pytest.mark.parametrize("build", BUILDERS)
def test_a_box_inside_out_is_refused_and_a_flat_one_is_not(build):
    lower, upper = make_boxes(9)
    upper[3, 0] = lower[3, 0]
    build(lower, upper)
    upper[3, 0] = np.nextafter(lower[3, 0], -np.inf)
    with pytest.raises(ValidationError, match="box 3 inside out"):
        build(lower, upper)
