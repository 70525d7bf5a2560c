"""Scenes with many lights: how many there are, where they stand, and what stays as it is when there are
more."""

from __future__ import annotations

import numpy as np
import pytest

import rhi
from renderer.content import furniture, load_scene, textures
from renderer.content.buildings import KINDS
from renderer.content.city import PITCH, STREET
from renderer.content.hall import BAY
from renderer.renderer import Renderer
from renderer.scene import MeshGeometry, Scene
from renderer.scene.arrays import Floats

NIGHT = "night:blocks=10,detail=2,lights={}"
COUNTS = [1, 5, 64, 600]


def light_positions(scene: Scene) -> Floats:
    """Return the positions (k, 3) of point and spot lights."""
    return np.concatenate([scene.lights.point["position"], scene.lights.spot["position"]])


def boxes(scene: Scene, *names: str) -> tuple[Floats, Floats]:
    """Return the bounds of the objects whose meshes have these names, numbers aside."""
    mesh_names = np.array([name.rstrip(" 0123456789") for name in scene.meshes.names])
    is_named = np.isin(mesh_names[scene.objects.mesh], names)
    assert is_named.any()
    return scene.objects.lower[is_named], scene.objects.upper[is_named]


def overlap(first: tuple[Floats, Floats], second: tuple[Floats, Floats]) -> np.ndarray:
    """Return whether each of the first boxes (n,) overlaps each of the second (m,): (n, m)."""
    return ((first[0][:, None] < second[1]) & (first[1][:, None] > second[0])).all(-1)


def distance_from_street(lower: Floats, upper: Floats) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the greatest distance of boxes from the middle of the nearest street of ten
    blocks."""
    ends = np.stack([lower, upper])[..., [0, 2]]
    away = np.abs((ends + 0.5 * PITCH) % PITCH - 0.5 * PITCH)
    nearest = away.min(0).argmin(1)
    distances = away[:, np.arange(len(lower)), nearest]
    return distances.min(0), distances.max(0)


@pytest.fixture(scope="module")
def night() -> Scene:
    return load_scene(NIGHT.format(600))


@pytest.mark.parametrize("count", [0, *COUNTS])
@pytest.mark.parametrize("spec", [NIGHT, "hall:columns=8,flags=0,lights={}", "grid:count=9,lights={}"])
def test_there_are_as_many_lights_as_asked(spec: str, count: int) -> None:
    if count or "night" in spec:
        assert len(light_positions(load_scene(spec.format(count)))) == count


def test_a_hall_and_a_grid_with_the_option_lights_at_0_are_the_plain_scenes() -> None:
    for spec in ("hall:columns=8", "grid:count=9"):
        plain, zero = load_scene(spec), load_scene(f"{spec},lights=0")
        assert plain.name == zero.name
        assert np.array_equal(plain.lights.point, zero.lights.point)
        assert len(plain.lights.point)


@pytest.mark.parametrize("spec", [NIGHT, "hall:columns=8,flags=0,lights={}", "grid:count=9,lights={}"])
def test_the_same_text_gives_the_same_lights_and_another_seed_others(spec: str) -> None:
    text = spec.format(64)
    first, again, other = load_scene(text), load_scene(text), load_scene(f"{text},seed=5")
    assert np.array_equal(first.lights.point, again.lights.point)
    assert np.array_equal(first.lights.spot, again.lights.spot)
    assert not np.array_equal(light_positions(first), light_positions(other))


@pytest.mark.parametrize("spec", [NIGHT, "grid:count=9,lights={}"])
def test_more_lights_leave_the_first_ones_where_they_are(spec: str) -> None:
    few, more = (
        set(map(tuple, light_positions(load_scene(spec.format(count))).tolist())) for count in (60, 600)
    )
    assert few < more


def test_more_lights_light_a_larger_part_of_the_city_as_densely() -> None:
    within = []
    for count in (192, 384, 768):
        away = np.hypot(*light_positions(load_scene(NIGHT.format(count)))[:, [0, 2]].T)
        within.append((np.sum(away < PITCH), np.percentile(away, 95)))
    assert within[0][0] == within[1][0] == within[2][0] > 20
    radius = [far for _, far in within]
    assert radius[1] / radius[0] == pytest.approx(2**0.5, rel=0.1)
    assert radius[2] / radius[1] == pytest.approx(2**0.5, rel=0.1)


def test_a_city_without_room_for_all_lights_has_more_windows() -> None:
    full, fuller = (
        load_scene("night:blocks=2,detail=2,lights=48"),
        load_scene("night:blocks=2,detail=2,lights=900"),
    )
    assert len(light_positions(fuller)) == 900
    for name, ratio in (("post", 1), ("car", 1)):
        assert len(boxes(fuller, name)[0]) == ratio * len(boxes(full, name)[0])
    assert len(boxes(fuller, "lit window")[0]) > 10 * len(boxes(full, "lit window")[0])


def test_lights_of_the_city_at_night_have_plausible_ranges(night: Scene) -> None:
    lights = night.lights
    assert 0.2 * 600 < len(lights.spot) < 0.5 * 600
    assert ((lights.point["range"] >= 5.0) & (lights.point["range"] <= 20.0)).all()
    assert ((lights.spot["range"] >= 10.0) & (lights.spot["range"] <= 20.0)).all()
    assert len(lights.directional) == 1  # the moon
    assert lights.directional["intensity"][0] < 0.2
    for name in (
        "post",
        "street light cover",
        "lit window",
        "lantern",
        "lantern post",
        "car",
        "car trim",
        "headlights",
        "tail lights",
    ):
        boxes(night, name)


def test_street_lights_stand_on_the_pavement_beside_the_street(night: Scene) -> None:
    lower, upper = boxes(night, "post")
    assert np.abs(lower[:, 1]).max() < 1e-9
    near, far = distance_from_street(lower, upper)
    assert near.min() > 0.5 * STREET - furniture.STREET_LIGHT_REACH  # the arms reach over the street
    assert far.max() < 0.5 * STREET + 1.5
    assert not overlap((lower, upper), boxes(night, *KINDS)).any()
    # All arms point at the street: what they carry is nearer to its middle than the post.
    cover_near, cover_far = distance_from_street(*boxes(night, "street light cover"))
    assert ((cover_near < near + 0.5) & (cover_far < far - 0.5)).all()


def test_cars_stand_in_the_street_apart_from_each_other(night: Scene) -> None:
    lower, upper = boxes(night, "car", "car trim", "headlights", "tail lights")
    assert lower[:, 1].min() == pytest.approx(0.0, abs=1e-6)
    assert upper[:, 1].max() < 1.6
    near, far = distance_from_street(lower, upper)
    assert near.min() > 1.0
    assert far.max() < 0.5 * STREET
    bodies = boxes(night, "car")
    assert overlap(bodies, bodies).sum() == len(bodies[0])
    assert not overlap(bodies, boxes(night, "post", *KINDS)).any()


def test_cars_light_the_street_before_them_and_keep_to_the_right(night: Scene) -> None:
    spot = night.lights.spot
    heads = spot[spot["position"][:, 1] < 1.0]
    lower, upper = boxes(night, "car")
    assert len(heads) == 2 * len(lower)
    tails = night.lights.point[night.lights.point["range"] == 5.0]
    assert len(tails) == 2 * len(lower)
    for middle in 0.5 * (lower + upper):
        mine = heads[np.linalg.norm(heads["position"] - middle, axis=1) < 3.0]
        red = tails[np.linalg.norm(tails["position"] - middle, axis=1) < 3.0]
        assert len(mine) == len(red) == 2
        ahead = mine["direction"][0].astype(float)
        assert ((mine["position"] - middle) @ ahead > 2.0).all()
        assert ((red["position"] - middle) @ ahead < -2.0).all()
        right = np.cross(ahead, (0.0, 1.0, 0.0))
        street = np.round(middle / PITCH) * PITCH
        assert 2.0 < (middle - street) @ right < 2.5


def test_lit_windows_are_at_walls_and_shine_outwards(night: Scene) -> None:
    panes = boxes(night, "lit window")
    lower, upper = boxes(night, *KINDS)
    at_wall = overlap((panes[0] - 0.3, panes[1] + 0.3), (lower, upper))
    assert at_wall.any(1).all()
    assert (panes[0][:, 1] > 1.0).all()
    middle = 0.5 * (panes[0] + panes[1])
    lights = night.lights.point["position"]
    away = np.linalg.norm(lights[:, None] - middle, axis=-1).min(0)
    assert (away < 1.1).all()


def test_by_day_the_same_streets_are_lit_by_the_sun_alone(night: Scene) -> None:
    day = load_scene(f"{NIGHT.format(600)},sun=1")
    assert len(light_positions(day)) == 0
    assert len(day.lights.directional) == 1
    assert day.lights.directional["intensity"][0] > 1.0
    assert np.array_equal(day.objects.lower, night.objects.lower)
    assert np.array_equal(day.materials, night.materials)


def test_no_object_meets_most_of_the_lights(night: Scene) -> None:
    from renderer.lights.object_lists import list_lights

    ends, _ = list_lights(
        night.objects.lower,
        night.objects.upper,
        light_positions(night),
        np.concatenate([night.lights.point["range"], night.lights.spot["range"]]).astype(float),
    )
    assert np.diff(ends).max() < 0.4 * 600


def test_a_third_of_the_windows_of_a_night_facade_are_lit() -> None:
    for style in ("punched", "ribbon", "glass"):
        pixels = textures.paint_lit_facade(style, 0)
        cell = textures.IMAGE_SIZE // textures.NIGHT_WINDOWS
        middles = pixels[cell // 2 :: cell, cell // 3 :: cell, :3].astype(float).mean(-1)
        assert 0.15 < (middles > 120.0).mean() < 0.6
        assert middles[0, 0] < 60.0  # the shutter that paints roofs


@pytest.mark.parametrize(
    "mesh",
    [
        furniture.make_post(5),
        furniture.make_street_light_cover(5),
        furniture.make_lantern_post(5),
        furniture.make_lantern(5),
        furniture.make_car_body(),
        furniture.make_car_trim(5),
        furniture.make_headlights(),
        furniture.make_tail_lights(),
    ],
)
def test_furniture_has_outward_normals_and_few_triangles(mesh: MeshGeometry) -> None:
    corners = mesh.vertices[mesh.indices].reshape(-1, 3)
    position = corners["position"].astype(np.float64)
    face = np.cross(position[:, 1] - position[:, 0], position[:, 2] - position[:, 0])
    assert ((face[:, None] * corners["normal"]).sum(2) > 0.0).all()
    assert mesh.triangle_count < 400


@pytest.mark.parametrize("count", [64, 1024])
def test_coloured_lights_hang_in_the_hall_and_not_in_its_columns(count: int) -> None:
    hall = load_scene(f"hall:columns=12,rows=3,flags=0,lights={count}")
    at = light_positions(hall)
    assert (np.abs(at[:, 0]) < 6 * BAY - 0.4).all()
    assert (np.abs(at[:, 2]) < 2 * BAY - 0.4).all()
    assert ((at[:, 1] > 0.2) & (at[:, 1] < 9.0)).all()
    assert min((at[:, 1] < 0.5).sum(), (at[:, 1] > 8.5).sum()) >= count // 8
    lower, upper = boxes(hall, "column")
    middle = 0.5 * (lower + upper)[:, [0, 2]]
    assert np.linalg.norm(at[:, None, [0, 2]] - middle, axis=-1).min() > 0.9
    assert np.abs((at[:, 0] + 6 * BAY) % (6 * BAY)).min() > 0.3  # the cross walls
    assert len(hall.lights.spot) == count // 8


def test_ranges_in_the_hall_shrink_as_lights_get_denser() -> None:
    few, more = (load_scene(f"hall:lights={count}").lights.point for count in (256, 4096))
    assert few["range"][0] / more["range"][0] == pytest.approx(4.0, rel=0.01)
    assert few["intensity"][0] / more["intensity"][0] == pytest.approx(16.0, rel=0.01)


@pytest.mark.parametrize("aspect", [16 / 9, 4 / 3])
def test_the_view_of_the_grid_sees_all_lights_and_stays_where_it_is(aspect: float) -> None:
    views = []
    for count, lights in ((1, 1), (256, 128), (64, 128)):
        grid = load_scene(f"grid:count={count},lights={lights}")
        assert next(iter(grid.views)) == "field"
        camera = grid.views["field"].with_aspect(aspect)
        views.append(camera.view_projection.tolist())
        points = np.append(light_positions(grid), np.ones((lights, 1)), axis=1)
        assert (points @ camera.frustum.planes.T > 0.0).all()
        assert len(grid.lights.directional) == 0
    assert views[0] == views[1] == views[2]


def test_the_first_light_of_the_grid_reaches_its_middle() -> None:
    light = load_scene("grid:count=1,lights=1").lights.point[0]
    assert np.linalg.norm(light["position"]) < 0.6 * light["range"]


@pytest.mark.parametrize(
    ("spec", "least", "most"),
    [
        ("night:blocks=6,detail=2,lights=256", 25.0, 90.0),
        ("hall:columns=8,lights=128", 20.0, 90.0),
        ("grid:mesh=sphere,count=256,lights=64", 15.0, 90.0),
    ],
)
def test_frames_are_neither_black_nor_burnt_out(gl: rhi.Device, spec: str, least: float, most: float) -> None:
    lit, dark = load_scene(spec), load_scene(spec)
    for name in ("point", "spot"):
        getattr(dark.lights, name)["intensity"] = 0.0
    levels = []
    for scene in (lit, dark):
        with Renderer(gl, scene, size=(128, 72)) as renderer:
            image = renderer.render(next(iter(scene.views.values()))).image.read()[..., :3]
            levels.append(image.astype(float).mean(-1))
    assert least < levels[0].mean() < most
    assert (levels[0] < 3.0).mean() < 0.2
    assert (levels[0] > 250.0).mean() < 0.02
    assert levels[0].mean() > 1.1 * levels[1].mean()
    assert levels[0].std() > 10.0
