"""Water from below: what shows a view only its back costs nothing, and the image is the same."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from frames import open_renderer
from nightly_reasons import ONLY_KERNELS
from tested_devices import open_device

import rhi
from renderer.content import BUILT_IN
from renderer.frame.turned_surfaces import TurnedSurfaces
from renderer.scene import Camera, Orthographic, Scene, SceneBuilder, rotation, scaling, translation
from renderer.scene.water import WaterPool, WaterSimulation
from rhi import Op
from rhi.math import multiply

POOL = WaterPool(size=(6.0, 4.0), cells=(12, 8), depth=0.2, rain=20.0, max_height=0.05)
"""Its triangles have slopes of 0.1 along x and z at most."""
HEIGHT = 6.0
BELOW = Camera.look_at((0.5, 0.5, 3.0), (0.0, HEIGHT, 0.0))
"""The farthest corner is 6.1 m away along the ground, and 5.45 m above the eye at least."""
ABOVE = Camera.look_at((0.5, HEIGHT + 3.0, 4.0), (0.0, HEIGHT, 0.0))
STEEP = WaterPool(size=(6.0, 4.0), cells=(96, 64), depth=0.2, rain=20.0, max_height=0.05)
"""Its triangles may have slopes of 0.8 along both, so that some may face the eye."""


def make_pool(
    pool: WaterPool = POOL,
    *,
    transform: Any = None,
    double_sided: bool = False,
    has_sun: bool = False,
    is_hidden: bool = False,
) -> Scene:
    builder = SceneBuilder("water")
    builder.lights.sky = builder.lights.ground = (0.5, 0.5, 0.5)
    grey = builder.add_material(base_color=(0.4, 0.6, 0.5))
    box = builder.add_mesh(BUILT_IN["box"]())
    builder.add_objects(builder.add_node(translation((0.0, HEIGHT + 0.8, 0.0))), box, grey)
    water = builder.add_material(base_color=(0.1, 0.3, 0.8), double_sided=double_sided)
    node = builder.add_node(translation((0.0, HEIGHT, 0.0)) if transform is None else transform)
    objects = builder.add_objects(node, builder.add_mesh(pool.make_mesh(), bounds=pool.bounds), water)
    builder.simulate(objects, WaterSimulation(1, pool, seed=2))
    if is_hidden:
        builder.hide(node)
    if has_sun:
        builder.add_objects(
            builder.add_node(multiply(translation((0.0, 3.0, 0.0)), scaling((20.0, 0.1, 20.0)))), box, grey
        )
        builder.lights.add_directional((0.0, -1.0, 0.1), casts_shadow=True)
    return builder.build()


def count_work(device: rhi.Device, scene: Scene, camera: Camera, visibility: str = "frustum") -> Counter[Op]:
    """Count the draws and dispatches of the fourth frame."""
    with open_renderer(device, scene, visibility=visibility) as renderer:
        for number in range(4):
            begin = len(device.stream)
            renderer.render(camera, number / 60)
        counts = Counter(command.op for command in device.stream[begin:])
    return Counter({op: counts[op] for op in (Op.DRAW, Op.DRAW_INDIRECT, Op.DISPATCH) if counts[op]})


@pytest.mark.parametrize("visibility", ["none", "frustum"])
def test_water_from_below_costs_nothing(null: rhi.Device, visibility: str) -> None:
    scene, without = make_pool(), make_pool(is_hidden=True)
    assert count_work(null, scene, BELOW, visibility) == count_work(null, without, BELOW, visibility)
    above = count_work(null, scene, ABOVE, visibility) - count_work(null, without, ABOVE, visibility)
    assert above[Op.DISPATCH] == 1, "control: from above it moves"


@pytest.mark.parametrize("pool", [POOL, STEEP])
def test_water_is_drawn_where_a_slope_may_face_the_eye(null: rhi.Device, pool: WaterPool) -> None:
    drawn = count_work(null, make_pool(pool), BELOW)[Op.DISPATCH] > 0
    assert drawn is (pool is STEEP)


def test_a_fine_grid_from_steeply_below_costs_nothing(null: rhi.Device) -> None:
    """Cells of 36 mm and waves of 100 mm: seen at 78 degrees, only slopes of 4 would face the eye."""
    pool = WaterPool(size=(2.6, 1.4), cells=(72, 40), depth=0.06, damping=0.6, rain=5.0)
    camera = Camera.look_at((0.9, -22.3, 6.0), (0.9, -14.0, 0.0))
    assert count_work(null, make_pool(pool), camera)[Op.DISPATCH] == 0
    nearer = Camera.look_at((0.9, -12.3, 6.0), (0.9, -4.0, 0.0))
    assert count_work(null, make_pool(pool), nearer)[Op.DISPATCH] == 1, "control: 60 degrees"


def test_water_with_two_sides_is_drawn_from_below(null: rhi.Device) -> None:
    assert count_work(null, make_pool(double_sided=True), BELOW)[Op.DISPATCH] == 1


def test_water_that_is_not_drawn_casts_its_shadow(null: rhi.Device) -> None:
    scene = make_pool(has_sun=True)
    assert count_work(null, scene, BELOW)[Op.DISPATCH] == 1


def test_water_is_drawn_again_when_the_eye_rises(null: rhi.Device) -> None:
    with open_renderer(null, make_pool(), visibility="frustum") as renderer:
        steps = [
            renderer.render(camera, number / 60).statistics.simulation_steps
            for number, camera in enumerate([ABOVE, ABOVE, BELOW, BELOW, BELOW, ABOVE])
        ]
    assert steps[3:5] == [0, 0]
    assert steps[5] > 0


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
def test_the_image_from_below_is_that_with_all_triangles(
    backend: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_device(backend) as device:
        images = []
        for is_selected in (True, False):
            if not is_selected:
                monkeypatch.setattr(TurnedSurfaces, "select_facing", lambda _, camera, indices: indices)
            for camera in (BELOW, ABOVE):
                with open_renderer(device, make_pool(), visibility="frustum") as renderer:
                    for number in range(3):
                        image = renderer.render(camera, 0.5 * number).image.read()
                    images.append(image)
        np.testing.assert_array_equal(images[0], images[2])
        np.testing.assert_array_equal(images[1], images[3])
        assert (images[1][..., 2] > images[1][..., 0] + 50).mean() > 0.1, "control: water from above"


@pytest.mark.parametrize("seed", range(20))
def test_no_triangle_of_a_turned_surface_faces_the_eye(seed: int) -> None:
    """Any heights within the pool's bounds, in float64, for any transform."""
    rng = np.random.default_rng(seed)
    width, length, height = rng.uniform((1.0, 1.0, 0.005), (9.0, 9.0, 0.1)).tolist()
    pool = WaterPool((width, length), cells=(7, 5), depth=0.01, drop=0.0, max_height=height)
    turn = rotation(rng.normal(size=3), float(rng.uniform(0.0, 6.0)))
    size = scaling(rng.uniform(0.3, 3.0, 3) * rng.choice([-1.0, 1.0], 3))
    world = multiply(translation(rng.uniform(-3.0, 3.0, 3)), multiply(turn, size))
    scene = make_pool(pool, transform=world)
    surfaces, row = TurnedSurfaces(scene), len(scene.objects) - 1
    corners = pool.make_vertices(rng.choice([-1.0, 1.0], (1, *pool.shape)) * pool.max_height)["position"]
    corners = corners.astype(np.float64) @ world[:3, :3].T + world[:3, 3]
    a, b, c = (corners[pool.make_mesh().indices.reshape(-1, 3)[:, number]] for number in range(3))
    normals = np.cross(b - a, c - a) * np.sign(np.linalg.det(world[:3, :3]))
    counts = Counter[bool]()
    for _ in range(60):
        eye = world[:3, 3] + rng.normal(size=3) * rng.uniform(0.2, 30.0)
        parallel = Camera.look_at(eye, world[:3, 3], projection=Orthographic(4.0))
        for camera, towards in (
            (Camera.look_at(eye, world[:3, 3]), eye - a),
            (parallel, np.broadcast_to(-parallel.forward, a.shape)),
        ):
            is_turned = not len(surfaces.select_facing(camera, np.array([row])))
            counts[is_turned] += 1
            if is_turned:
                assert (np.einsum("ij,ij->i", normals, towards) < 0.0).all()
    assert counts[False]
    assert counts[True]
