"""The island: its ground is a height field, and it is the same from the same seed."""

import numpy as np
import pytest

from renderer.content import load_scene, parse_camera

SMALL = "terrain:cells=64,trees=40"


@pytest.fixture(scope="module")
def island():
    return load_scene(SMALL)


def test_its_ground_is_a_height_field_of_as_many_cells_as_asked_for(island):
    (field,) = island.tessellated.values()
    assert field.heights.shape == (65, 65)
    assert field.limit == 2 * 64 * 64
    assert island.meshes.names[island.objects.mesh[next(iter(island.tessellated))]] == "island"


def test_cells_that_are_no_power_of_two_are_interpolated():
    (field,) = load_scene("terrain:cells=48,trees=0").tessellated.values()
    assert field.heights.shape == (65, 65)


def test_it_is_an_island_with_a_mountain(island):
    heights = island.tessellated[0].heights
    border = np.concatenate([heights[0], heights[-1], heights[:, 0], heights[:, -1]])
    assert border.max() < 0.0
    assert 0.4 < (heights > 0.0).mean() < 0.85
    assert 300.0 < heights.max() < 1500.0


def test_firs_stand_on_the_ground_above_the_sea(island):
    firs = island.objects.mesh == island.meshes.names.index("fir")
    assert firs.sum() == 40
    feet = island.nodes.world[island.objects.node[firs]][:, :3, 3]
    sunk = island.tessellated[0].sample_heights(feet[:, 0], feet[:, 2]) - feet[:, 1]
    assert ((sunk > 0.0) & (sunk < 1.0)).all()
    assert feet[:, 1].min() > 10.0


def test_the_same_seed_gives_the_same_island_and_another_one_another(island):
    heights = island.tessellated[0].heights
    assert (load_scene(SMALL).tessellated[0].heights == heights).all()
    assert (load_scene(f"{SMALL},seed=1").tessellated[0].heights != heights).any()


def test_walks_stay_above_the_ground(island):
    positions = np.array([parse_camera("ground", island, frame).position for frame in range(0, 1800, 50)])
    ground = island.tessellated[0].sample_heights(positions[:, 0], positions[:, 2])
    assert (positions[:, 1] - ground).min() > 5.0
