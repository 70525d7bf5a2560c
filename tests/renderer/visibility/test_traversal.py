"""The walk that an algorithm reports: what became of each node, where an oracle says which objects show."""

from __future__ import annotations

import numpy as np
import pytest
from occlusion_scenes import Oracle, draw_with, make_boxes

import rhi
from renderer import visibility
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective, Scene
from renderer.visibility import (
    AutoCulling,
    CullingTraversal,
    FrustumCulling,
    TraversalOutcome,
    compute_traversal,
    make_visibility,
)

ROWS, COLUMNS = 6, 8


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Boxes in a field before the camera, and behind it."""
    x, z = np.meshgrid(np.arange(COLUMNS) * 4.0, np.arange(-ROWS, ROWS) * 5.0 + 2.5)
    object_positions = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    return make_boxes(object_positions, np.ones_like(object_positions))


def field_camera() -> Camera:
    return Camera.look_at((14, 1, 0), (14, 1, -40), projection=Perspective(1.2, near=0.1))


def object_indices_of(scene: Scene, traversal: CullingTraversal, outcome: TraversalOutcome) -> set[int]:
    """Return the indices of the objects whose boxes are those of nodes of an outcome."""
    indices = set()
    for lower, upper in zip(
        traversal.lower[traversal.outcome == outcome],
        traversal.upper[traversal.outcome == outcome],
        strict=True,
    ):
        same = (scene.objects.lower == lower).all(axis=1) & (scene.objects.upper == upper).all(axis=1)
        indices |= set(np.flatnonzero(same).tolist())
    return indices


def count_inside(
    traversal: CullingTraversal, outcomes: tuple[TraversalOutcome, ...], row: int, scene: Scene
) -> int:
    """Return the number of nodes of these outcomes that hold an object."""
    inside = (traversal.lower <= scene.objects.lower[row]).all(axis=1)
    inside &= (traversal.upper >= scene.objects.upper[row]).all(axis=1)
    return int((inside & np.isin(traversal.outcome, outcomes)).sum())


@pytest.mark.parametrize("name", ["chc", "chc_plus_plus"])
def test_the_node_of_each_object_reports_whether_it_was_drawn(
    null: rhi.Device, scene: Scene, name: str
) -> None:
    oracle = Oracle(null, scene, name)
    camera = field_camera()
    in_view = FrustumCulling(scene)
    algorithm = make_visibility(name, scene, null)
    with Renderer(null, scene, size=(64, 36)) as renderer:
        view = camera.with_aspect(64 / 36)
        reached = set(draw_with(renderer, in_view, camera).visible.tolist())
        oracle.visible_objects = set(sorted(reached)[::7])
        for _ in range(4):
            result = draw_with(renderer, algorithm, camera)
        traversal = compute_traversal(algorithm, scene, view, result.visible)
    everything = set(range(len(scene.objects)))
    assert 0 < len(oracle.visible_objects) < len(reached) < len(everything)
    assert traversal.is_of_nodes
    visible = object_indices_of(scene, traversal, TraversalOutcome.VISIBLE) | object_indices_of(
        scene, traversal, TraversalOutcome.QUERIED
    )
    assert visible == oracle.visible_objects == set(result.visible.tolist())
    for row in everything:
        hidden = count_inside(traversal, (TraversalOutcome.HIDDEN,), row, scene)
        outside = count_inside(traversal, (TraversalOutcome.OUTSIDE,), row, scene)
        if row in oracle.visible_objects:
            assert (hidden, outside) == (0, 0)
        elif row in reached:
            assert hidden >= 1
            assert outside == 0
        else:
            assert hidden + outside >= 1


def test_chc_queries_every_visible_leaf_and_chc_plus_plus_few(null: rhi.Device, scene: Scene) -> None:
    counts = {}
    for name in ("chc", "chc_plus_plus"):
        oracle = Oracle(null, scene, name)
        algorithm = make_visibility(name, scene, null)
        with Renderer(null, scene, size=(64, 36)) as renderer:
            oracle.visible_objects = set(
                draw_with(renderer, FrustumCulling(scene), field_camera()).visible.tolist()
            )
            for _ in range(5):
                draw_with(renderer, algorithm, field_camera())
            traversal = compute_traversal(algorithm, scene, field_camera().with_aspect(64 / 36), None)
        counts[name] = len(object_indices_of(scene, traversal, TraversalOutcome.QUERIED))
        assert counts[name] <= len(oracle.visible_objects)
        if name == "chc":
            assert object_indices_of(scene, traversal, TraversalOutcome.QUERIED) == oracle.visible_objects
    assert counts["chc_plus_plus"] < 0.5 * counts["chc"]


def test_nodes_that_were_not_reached_are_not_part_of_the_traversal(null: rhi.Device, scene: Scene) -> None:
    oracle = Oracle(null, scene, "chc_plus_plus")
    algorithm = make_visibility("chc_plus_plus", scene, null)
    with Renderer(null, scene, size=(64, 36)) as renderer:
        oracle.visible_objects = set()
        for _ in range(3):
            draw_with(renderer, algorithm, field_camera())
        traversal = compute_traversal(algorithm, scene, field_camera().with_aspect(64 / 36), None)
    assert traversal.outcome.tolist() == [TraversalOutcome.HIDDEN]  # the root


def test_boxes_outside_of_an_opened_node_are_reported_even_if_nothing_in_the_node_is_visible(
    null: rhi.Device, scene: Scene
) -> None:
    oracle = Oracle(null, scene, "chc")
    algorithm, view = make_visibility("chc", scene, null), field_camera().with_aspect(64 / 36)
    boxes = []
    with Renderer(null, scene, size=(64, 36)) as renderer:
        for visible_objects in (set(range(len(scene.objects))), set()):
            oracle.visible_objects = visible_objects
            for _ in range(
                3 if visible_objects else 1
            ):  # what was visible is opened, and then found to be hidden
                draw_with(renderer, algorithm, field_camera())
            traversal = compute_traversal(algorithm, scene, view, None)
            outside = np.concatenate([traversal.lower, traversal.upper], axis=1)[
                traversal.outcome == TraversalOutcome.OUTSIDE
            ]
            boxes.append({tuple(box) for box in outside.tolist()})
    assert set(traversal.outcome.tolist()) == {TraversalOutcome.HIDDEN, TraversalOutcome.OUTSIDE}
    assert boxes[0] == boxes[1]


def outcomes(algorithm: visibility.VisibilityAlgorithm, scene: Scene, drawn: np.ndarray | None) -> list[int]:
    traversal = compute_traversal(algorithm, scene, field_camera().with_aspect(64 / 36), drawn)
    assert not traversal.is_of_nodes
    assert (traversal.lower == scene.objects.lower).all()
    return traversal.outcome.tolist()


def test_without_a_hierarchy_the_objects_are_listed(null: rhi.Device, scene: Scene) -> None:
    algorithm = FrustumCulling(scene)
    with Renderer(null, scene, visibility=algorithm, size=(64, 36)) as renderer:
        drawn = renderer.render(field_camera()).visible
    inside = np.isin(np.arange(len(scene.objects)), drawn)
    assert (
        outcomes(algorithm, scene, drawn)
        == np.where(inside, TraversalOutcome.VISIBLE, TraversalOutcome.OUTSIDE).tolist()
    )
    every_second = drawn[::2]
    expected = np.where(inside, TraversalOutcome.HIDDEN, TraversalOutcome.OUTSIDE)
    expected[every_second] = TraversalOutcome.VISIBLE
    assert outcomes(algorithm, scene, every_second) == expected.tolist()
    undecided = np.where(inside, TraversalOutcome.UNDECIDED, TraversalOutcome.OUTSIDE)
    assert outcomes(algorithm, scene, None) == undecided.tolist()


def test_the_traversal_of_auto_is_that_of_its_latest_algorithm(null: rhi.Device, scene: Scene) -> None:
    factories = {"frustum": lambda: FrustumCulling(scene), "none": lambda: visibility.NoCulling(scene)}
    auto = AutoCulling(scene, null, factories)
    assert auto.traversal() is None
    with Renderer(null, scene, visibility=auto, size=(64, 36)) as renderer:
        renderer.render(field_camera())
    assert isinstance(auto.latest, FrustumCulling)
    assert auto.traversal() is None
    Oracle(null, scene, "chc")
    auto = AutoCulling(scene, null, {"chc": lambda: make_visibility("chc", scene, null)})
    with Renderer(null, scene, visibility=auto, size=(64, 36)) as renderer:
        renderer.render(field_camera())
        assert compute_traversal(auto, scene, field_camera(), None).is_of_nodes
