"""The city, the hall and the grid: sizes, measurable properties, paths, and that a seed repeats a scene."""

import numpy as np
import pytest

from renderer.content import IMAGE_SIZE, load_scene
from renderer.content.buildings import KINDS, intersect_windows, make_building
from renderer.content.city import PITCH, STREET
from renderer.content.shapes import BUILT_IN
from renderer.content.textures import WINDOWS

SCENES = [
    "city:blocks=12,detail=3",
    "hall",
    "grid:mesh=cone,count=50",
    "night:blocks=8,detail=2,lights=200",
    "hall:flags=4,lights=40",
    "grid:mesh=cone,count=50,lights=9",
    "glass:panes=7,lights=3",
]


@pytest.fixture(scope="module")
def city():
    return load_scene("city")


@pytest.fixture(scope="module", params=SCENES)
def scene(request):
    return load_scene(request.param)


def test_the_city_is_as_large_as_the_thesis_model(city):
    assert 1_000_000 <= city.triangle_count <= 1_200_000
    assert 1_800 <= len(city.objects) <= 2_000
    assert not city.objects.dynamic.any()


def test_the_city_is_taller_downtown_and_has_many_shapes(city):
    height = city.objects.upper[:, 1]
    names = {city.meshes.names[mesh].split()[0] for mesh in np.unique(city.objects.mesh)}
    assert set(KINDS) <= names
    assert height.max() > 100.0
    assert np.median(height) < 45.0
    tall = 0.5 * (city.objects.lower + city.objects.upper)[height > 80.0]
    assert 10 < len(tall) < 400
    assert np.linalg.norm(tall.std(0)[[0, 2]]) < 0.7 * np.linalg.norm([PITCH * 44 / 12**0.5] * 2)


def test_buildings_stand_on_the_ground_and_not_in_the_streets(city):
    names = np.array([name.split()[0] for name in city.meshes.names])[city.objects.mesh]
    built = np.isin(names, KINDS)
    lower, upper = city.objects.lower[built], city.objects.upper[built]
    assert np.abs(lower[:, 1]).max() < 1e-9
    block = np.floor((0.5 * (lower + upper) + 22 * PITCH) / PITCH)
    edge = block * PITCH - 22 * PITCH
    for axis in (0, 2):
        assert (lower[:, axis] > edge[:, axis] + 0.5 * STREET).all()
        assert (upper[:, axis] < edge[:, axis] + PITCH - 0.5 * STREET).all()


def test_the_ground_path_stays_in_the_streets_at_eye_height(city):
    positions = city.paths["ground"].positions
    assert np.allclose(positions[:, 1], positions[0, 1])
    assert 1.5 < positions[0, 1] < 2.0
    from_middle = np.abs((positions[:, [0, 2]] + 22 * PITCH + 0.5 * PITCH) % PITCH - 0.5 * PITCH)
    assert from_middle.min(1).max() < 0.5 * STREET
    inside = (positions[:, None] > city.objects.lower) & (positions[:, None] < city.objects.upper)
    names = np.array([name.split()[0] for name in city.meshes.names])[city.objects.mesh]
    assert not inside.all(2)[:, np.isin(names, KINDS)].any()


def test_the_sky_path_crosses_the_city_above_its_roofs(city):
    positions = city.paths["sky"].positions
    assert positions[:, 1].min() > city.objects.upper[:, 1].max()
    assert np.ptp(positions[:, 0]) > 0.99 * 44 * PITCH


def test_the_ground_path_goes_from_end_to_end_with_turns(city):
    path = city.paths["ground"]
    step = np.diff(path.positions, axis=0)
    assert np.ptp(path.positions[:, 0]) > 0.99 * 44 * PITCH
    along_z = np.abs(step[:, 2]) > np.abs(step[:, 0])
    assert (np.diff(along_z.astype(int)) != 0).sum() == 6  # three times into a side street and out again


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("detail", [2, 7, 12])
def test_building_meshes_are_sound(kind, detail):
    mesh = make_building(kind, 10, detail)
    corners = mesh.vertices[mesh.indices].reshape(-1, 3)
    position = corners["position"].astype(np.float64)
    face = np.cross(position[:, 1] - position[:, 0], position[:, 2] - position[:, 0])
    agree = (face[:, None] * corners["normal"]).sum(2) > 0.0
    assert agree.all()
    lower, upper = mesh.bounds
    assert lower[1] == 0.0
    assert 1.0 <= upper[1] < 1.05
    assert max(upper[0] - lower[0], upper[2] - lower[2]) < 1.06
    assert np.allclose(np.linalg.norm(mesh.vertices["normal"], axis=1), 1.0, atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("detail", [2, 7, 32])
def test_rays_from_all_sides_find_the_middles_of_windows(kind, detail):
    mesh = make_building(kind, 10, detail)
    aside, height = (grid.ravel() for grid in np.meshgrid(np.linspace(-0.29, 0.29, 9), [0.06, 0.3, 0.52]))
    for out in ((1.0, 0, 0), (-1.0, 0, 0), (0, 0, 1.0), (0, 0, -1.0)):
        start = 2.0 * np.array(out) + np.outer(aside, out[::-1]) + np.outer(height, (0.0, 1.0, 0.0))
        middle, across, up = intersect_windows(mesh, WINDOWS, start, np.tile(np.negative(out), (27, 1)))
        moved = middle - start
        assert (moved @ out < -1.3).all()  # a wall on this side of the lot
        assert (np.abs(moved[:, 1]) <= 0.5 * np.abs(up[:, 1]) + 1e-6).all()  # less than half a window away
        assert np.allclose(up[:, [0, 2]], 0.0, atol=1e-6)
        assert np.allclose(np.abs(up[:, 1]), 0.1 * (0.62 if kind == "house" else 1.0))  # ten storeys
        across = np.linalg.norm(across, axis=1)
        assert (np.linalg.norm(moved - np.outer(moved @ out, out), axis=1) < np.hypot(across, 0.1)).all()


def test_more_detail_is_more_triangles():
    for kind in KINDS:
        counts = [make_building(kind, 10, detail).triangle_count for detail in (2, 7, 12)]
        assert counts[0] < counts[1] < counts[2]


@pytest.mark.parametrize(("name", "sines"), [("box", 0), ("cylinder", 3), ("cone", 1)])
def test_solids_are_closed_and_face_outwards(name, sines):
    """Cylinders and cones have 24 sides, so their volume is that of triangles with an angle of 15°."""
    mesh = BUILT_IN[name]()
    a, b, c = (mesh.vertices["position"][mesh.indices[corner::3]].astype(float) for corner in range(3))
    assert (a * np.cross(b, c)).sum() / 6 == pytest.approx(sines * np.sin(np.pi / 12) if sines else 1.0)
    assert ((np.cross(b - a, c - a) * mesh.vertices["normal"][mesh.indices[::3]]).sum(1) > 0).all()


def test_the_hall_has_moving_flags_on_a_deep_hierarchy_and_three_kinds_of_things():
    hall = load_scene("hall:flags=10")
    assert len(hall.nodes.level_starts) - 1 >= 5
    assert len(hall.objects.dynamic_indices) == 60
    assert len(hall.lights.point) > 2
    assert len(hall.lights.spot) > 2
    moved = hall.update(0.4)
    assert moved.tolist() == hall.objects.dynamic_indices.tolist()


def test_options_of_the_hall_reach_its_simulations_and_its_name():
    hall = load_scene(
        "hall:columns=6,flags=0,fountains=1,cloths=1,drops=30,cloth_detail=1,cloth_rate=30,sub_steps=2"
    )
    fountains, cloths = (load_scene(hall.name).simulated[number].simulation for number in (0, 1))
    assert fountains.position.shape == (1, 30, 3)
    grid = cloths.cloth_grid
    assert (grid.rows, grid.columns, grid.sub_steps, cloths.interval) == (7, 5, 2, 1 / 30)
    assert "drops" not in load_scene("hall:fountains=1").name


def test_flags_stay_on_their_poles_and_near_them():
    hall = load_scene("hall:flags=10,seed=4")
    first_cloth = hall.objects.dynamic_indices[:10]
    hinge = hall.nodes.world[hall.objects.node[first_cloth], :3, 3].copy()
    for seconds in (0.7, 5.3):
        hall.update(seconds)
        assert np.allclose(hall.nodes.world[hall.objects.node[first_cloth], :3, 3], hinge)
        last = hall.nodes.world[hall.objects.node[hall.objects.dynamic_indices[-10:]], :3, 3]
        assert (np.linalg.norm(last - hinge, axis=1) < 6 * 0.34).all()


def test_a_hall_without_flags_stands_still():
    hall = load_scene("hall:flags=0,columns=4,rows=2")
    assert len(hall.objects.dynamic_indices) == 0
    assert hall.update(1.0).size == 0


@pytest.mark.parametrize("panes", [1, 2, 25])
def test_glass_has_panes_and_half_as_many_balls_before_opaque_columns(panes):
    glass = load_scene(f"glass:panes={panes},lights=2")
    transparent = glass.list_transparent()
    assert len(transparent) == panes + panes // 2
    assert len(glass.objects) > len(transparent)
    assert (glass.objects.lower[transparent][:, 1] > -1e-6).all()
    assert len(glass.lights.point) == 2


def test_a_grid_holds_as_many_copies_as_asked_on_the_ground():
    grid = load_scene("grid:mesh=torus,count=37,spacing=2")
    assert len(grid.objects) == 37
    assert len(grid.meshes) == 1
    assert np.allclose(grid.objects.lower[:, 1], 0.0, atol=1e-6)
    centre = 0.5 * (grid.objects.lower + grid.objects.upper)
    gaps = np.linalg.norm(centre[:, None] - centre[None], axis=2) + 10 * np.eye(37)
    assert gaps.min() == pytest.approx(2.0, abs=0.05)


def test_the_same_text_gives_the_same_scene_and_another_seed_another(scene):
    again, other = load_scene(scene.name), load_scene(f"{scene.name.rpartition('=')[0]}=9")
    assert np.array_equal(scene.objects.lower, again.objects.lower)
    assert np.array_equal(scene.materials, again.materials)
    assert np.array_equal(scene.meshes.vertices, again.meshes.vertices)
    assert not np.array_equal(scene.nodes.world, other.nodes.world)


@pytest.mark.parametrize("name", ["ground", "sky"])
def test_paths_last_thirty_seconds_and_are_smooth(scene, name):
    path = scene.paths[name]
    assert len(path) == 1800
    speed = np.linalg.norm(np.diff(path.positions, axis=0), axis=1)
    assert speed.max() < 1.05 * speed.mean()
    forward = np.array([path.camera(frame).forward for frame in range(1800)])
    turn = np.degrees(np.arccos(np.clip((forward[1:] * forward[:-1]).sum(1), -1.0, 1.0)))
    assert turn.max() < 5.0


def test_every_view_sees_something(scene):
    from renderer.visibility import select_visible

    assert "overview" in scene.views
    for view in scene.views.values():
        assert select_visible(view.frustum.planes, scene.objects.lower, scene.objects.upper).any()


def test_generated_images_have_one_size_and_materials_name_them(scene):
    assert {image.shape for image in scene.images} <= {(IMAGE_SIZE, IMAGE_SIZE, 4)}
    assert (scene.materials["texture"] < len(scene.images)).all()
    assert len(scene.lights) > 0
