"""Leaves of several objects: queried once, drawn as a whole."""

from __future__ import annotations

import numpy as np
import occlusion_scenes
import pytest
from nightly_reasons import ONLY_KERNELS

import rhi
from renderer import visibility
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import Scene
from renderer.visibility.boxes.forest import Forest, Frontier

EYE = occlusion_scenes.make_camera((0.0, 0.0, 30.0), (0.0, 0.0, 0.0), near=0.1)


@pytest.fixture(scope="module")
def cloud() -> Scene:
    return occlusion_scenes.make_cloud(seed=1, motion=lambda seconds: (0.0, 0.0, 0.0), moving=range(20))


@pytest.mark.parametrize("leaf_size", [1, 2, 7, 100])
def test_leaves_hold_all_objects_once_and_no_more_than_their_size(cloud: Scene, leaf_size: int) -> None:
    forest = Forest(cloud, leaf_size)
    forest.update(EYE)
    frontier, leaves = Frontier(forest), []
    frontier.begin()
    while frontier:
        node = frontier.pop()
        if forest.child[node] < 0:
            leaves.append(node)
        else:
            frontier.open(node)
    assert forest.objects(leaves).tolist() == list(range(60))
    assert forest.count[leaves].max() <= leaf_size
    above = [forest.parent[leaf] for leaf in leaves if forest.parent[leaf] >= 0]
    assert all(forest.count[node] > leaf_size for node in above)


def test_a_visible_leaf_is_drawn_as_a_whole_inside_one_query(null: rhi.Device, cloud: Scene) -> None:
    occlusion_scenes.Oracle(null, cloud, "chc", visible_objects=set(range(60)))
    algorithm = visibility.Chc(cloud, null, visibility.VisibilitySettings(leaf_size=4))
    forest = algorithm._forest
    is_leaf = [forest.child[node] < 0 for node in range(len(forest))]
    tops = [node for node, leaf in enumerate(is_leaf) if leaf and not is_leaf[forest.parent[node]]]
    with Renderer(null, cloud, size=(64, 36)) as renderer:
        for _ in range(2):
            result = occlusion_scenes.draw_with(renderer, algorithm, EYE)
    assert occlusion_scenes.visible(result) == set(range(60))
    assert result.statistics.queries == result.visibility.batches == len(tops) < 40


@pytest.mark.parametrize("name", occlusion_scenes.OCCLUSION)
def test_of_a_leaf_across_the_edge_of_the_view_only_objects_in_view_are_drawn(
    null: rhi.Device, cloud: Scene, name: str
) -> None:
    camera = occlusion_scenes.make_camera((0.0, 0.0, 8.0), (3.0, 0.0, 0.0), fov=0.4, near=0.1)
    occlusion_scenes.Oracle(null, cloud, name, visible_objects=set(range(60)))
    inside = set(visibility.list_visible_objects(visibility.FrustumCulling(cloud), camera).tolist())
    assert 0 < len(inside) < 60
    algorithm = visibility.make_visibility(name, cloud, null, visibility.VisibilitySettings(leaf_size=16))
    with Renderer(null, cloud, size=(64, 36)) as renderer:
        for _ in range(3):
            assert occlusion_scenes.visible(occlusion_scenes.draw_with(renderer, algorithm, camera)) == inside


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("leaf_size", [3, 64])
@pytest.mark.parametrize("name", occlusion_scenes.OCCLUSION[1:])
def test_leaves_of_several_objects_change_no_pixel(
    drawing_device: rhi.Device, name: str, leaf_size: int
) -> None:
    occlusion_scenes.require_algorithm(drawing_device, name)
    city = load_scene("city:blocks=8,detail=2")
    with occlusion_scenes.UnculledFrames(
        drawing_device, city, occlusion_scenes.walk(city, "ground", range(600, 640, 8))
    ) as uncut:
        assert uncut.try_algorithm(name, leaf_size=leaf_size) == [0] * 5


@pytest.mark.parametrize("name", ["chc", "chc_plus_plus"])
def test_larger_leaves_ask_less_and_draw_more(
    gl: rhi.Device, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    occlusion_scenes.delay_query_results(monkeypatch, 0)
    city = load_scene("city:blocks=8,detail=2")
    costs = []
    for leaf_size in (1, 4):
        algorithm = visibility.make_visibility(
            name, city, gl, visibility.VisibilitySettings(leaf_size=leaf_size)
        )
        with Renderer(gl, city, size=occlusion_scenes.SIZE) as renderer:
            results = [
                occlusion_scenes.draw_with(renderer, algorithm, camera)
                for camera, _ in occlusion_scenes.walk(city, "sky", range(600, 624, 2))
            ]
        costs.append(
            np.sum([(result.statistics.queries, result.visibility.visible) for result in results[2:]], axis=0)
        )
        algorithm.destroy()
    assert costs[1][0] < 0.6 * costs[0][0]
    assert costs[0][1] < costs[1][1]
