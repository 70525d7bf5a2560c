"""Rectangles and tubes as lights, compared with sums over their parts and with points."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frames import draw, first_view_camera, make_boxes, max_difference
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.content import BUILT_IN
from renderer.frame.lobe_fits import FIT_FILE, read_fits
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.lab.measure.ray_tracer.tracer import inverse_tone_map
from renderer.scene import Camera, Perspective, Scene, scaling, translation
from renderer.shaders.area_lights import FIT_SIZE, LobeFit, gather_rectangle, turn_tube
from renderer.techniques import TECHNIQUES, Deferred, Inferred, ResourceCapture
from rhi.shading import evaluate

SIZE = (24, 16)
MATT = {"base_color": (0.6, 0.5, 0.4), "specular_color": (0.0, 0.0, 0.0)}
SHINY = {"base_color": (0.0, 0.0, 0.0), "specular_color": (0.05, 0.05, 0.05)}
METAL = {"base_color": (0.5, 0.5, 0.5), "metallic": 1.0}
LIGHTS: dict[str, dict[str, Any]] = {
    "rectangle": {"direction": (0.3, -0.5, 1), "width": 1.6, "height": 0.8},
    "edge-on": {"direction": (0.3, 0.0, 1), "width": 1.6, "height": 0.8},
    "strip": {"direction": (0.3, -0.5, 1), "width": 1.6, "height": 0.0},
    "tube": {"direction": (1, 0.2, 0.3), "length": 1.6, "radius": 0.02},
    "line": {"direction": (1, 0.2, 0.3), "length": 1.6},
}
"""Lights above a floor and beside a ball, which cuts them by its horizon."""


def stage(*names: str, strength: float = 2.0, **material: Any) -> Scene:
    """Make a floor and a ball, dark but for these lights."""
    builder = make_boxes(translation((0, -5, 0)) @ scaling((100, 10, 100)), **material)
    builder.add_objects(
        builder.add_node(translation((1.5, 0.6, 0))), builder.add_mesh(BUILT_IN["sphere"]()), 0
    )
    builder.lights.sky = builder.lights.ground = builder.background = (0.0, 0.0, 0.0)
    for name in names:
        values = {**LIGHTS[name], "color": (1.0, 0.8, 0.6), "intensity": strength}
        add = builder.lights.add_tube if "length" in values else builder.lights.add_rectangle
        add((-0.3, 1.0, -0.7), range=30.0, **values)
    builder.views["eye"] = Camera.look_at((0, 2.5, 5), (0, 0.3, 0), projection=Perspective(0.9, 1.5))
    return builder.build()


def measure_light(device: rhi.Device, scene: Scene) -> tuple[NDArray[Any], NDArray[Any]]:
    """The red light (h, w) of the local lights, as drawn and of the reference."""
    capture, eye = ResourceCapture(Deferred(), "light"), first_view_camera(scene)
    draw(device, scene, capture, size=SIZE)
    y, x = np.indices(SIZE[::-1]) + 0.5
    exact = inverse_tone_map(RayTracer(scene).trace(eye, SIZE, np.stack([x.ravel(), y.ravel()], axis=1)))
    return np.asarray(capture.texels)[..., 0], exact[:, 0].reshape(SIZE[::-1])


@pytest.mark.parametrize("name", LIGHTS)
def test_scattered_light_is_that_of_all_parts_of_a_source(gl: rhi.Device, name: str) -> None:
    drawn, exact = measure_light(gl, stage(name, strength=0.2, **MATT))
    assert exact.max() > 0.02
    assert np.abs(drawn - exact).max() <= 0.02 * exact.max()  # R11G11B10F holds 1/64 of it


@pytest.mark.parametrize(
    ("material", "sums", "peaks", "mean"),
    [
        ({**METAL, "roughness": 0.2}, 0.02, 0.03, 0.06),
        ({**METAL, "roughness": 0.7}, 0.05, 0.12, 0.16),
        ({**SHINY, "shininess": 20.0}, 0.08, 0.15, 0.25),
        ({**SHINY, "shininess": 300.0}, 0.08, 0.15, 0.3),
    ],
)
@pytest.mark.parametrize("name", ["rectangle", "tube"])
def test_highlights_have_the_energy_and_about_the_peak_of_those_of_all_parts(
    gl: rhi.Device, name: str, material: dict[str, Any], sums: float, peaks: float, mean: float
) -> None:
    """The specular model falls off faster than any transformed cosine, so a third of its light is elsewhere."""
    drawn, exact = measure_light(gl, stage(name, strength=0.2, **material))
    assert drawn.sum() == pytest.approx(exact.sum(), rel=sums)
    assert drawn.max() == pytest.approx(exact.max(), rel=peaks)
    assert np.abs(drawn - exact).mean() <= mean * exact.mean()


@pytest.mark.nightly_cases("cl*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("technique", [name for name in TECHNIQUES if name != "forward"])
def test_techniques_light_by_areas_points_and_spheres_as_forward_shading(
    drawing_device: rhi.Device, technique: str
) -> None:
    scene = stage("rectangle", "tube", **METAL, roughness=0.3)
    scene.lights.add_point((-1, 0.5, 1), 5.0, (0.2, 1, 0.3), 0.3)
    scene.lights.add_point((-1.5, 0.5, 2.0), 5.0, (0.9, 1, 0.3), 0.3, source_radius=0.2)
    scene.refresh()
    compared = Inferred(scale=1.0) if technique == "inferred" else TECHNIQUES[technique]()
    forward = draw(drawing_device, scene, size=SIZE)
    assert forward.max() > 100
    assert max_difference(forward, draw(drawing_device, scene, compared, size=SIZE)) <= 2


def test_a_point_light_is_the_same_beside_an_area_light(gl: rhi.Device) -> None:
    point, both = (stage(*names, **MATT) for names in ((), ("rectangle",)))
    both.lights.point["intensity"] = 0.0
    for scene in (point, both):
        scene.lights.add_point((0.5, 1.5, 1.0), 5.0)
        scene.refresh()
    assert max_difference(*(draw(gl, scene, size=SIZE) for scene in (point, both))) == 0


def test_a_small_rectangle_is_as_bright_as_a_point_in_front_of_it(gl: rhi.Device) -> None:
    images = []
    for name in ("point", "rectangle"):
        builder = make_boxes(scaling((4, 0.1, 4)), **MATT)
        builder.views["eye"] = Camera.look_at((0, 3, 0.1), (0, 0, 0))
        if name == "point":
            builder.lights.add_point((0, 2, 0), 9.0, intensity=2.0)
        else:
            builder.lights.add_rectangle((0, 2, 0), (0, -1, 0), 9.0, 1e-3, 1e-3, intensity=2.0)
        images.append(draw(gl, builder.build(), size=(9, 9)))
    assert max_difference(images[0][4, 4], images[1][4, 4]) <= 1


def integrate_cosine(center: Any, right: Any, up: Any, count: int = 200) -> float:
    """The share of the cosine around z that a rectangle fills, as the sum over its parts."""
    steps = (2.0 * np.arange(count) + 1.0) / count - 1.0
    parts = center + steps[:, None, None] * right + steps[None, :, None] * up
    squares = (parts**2).sum(axis=-1)
    directions = parts / np.sqrt(squares)[..., None]
    facing = np.maximum(-directions @ np.cross(right, up), 0.0)
    return float((np.maximum(directions[..., 2], 0.0) * facing / squares).mean() * 4.0 / np.pi)


IDENTITY = np.zeros((), LobeFit.dtype)
for number in ("xx", "yy", "zz"):
    IDENTITY[number] = 1.0


def test_a_rectangle_is_cut_exactly_at_the_horizon_at_any_scale() -> None:
    rng, cut = np.random.default_rng(5), 0
    for _ in range(200):
        center, right = rng.normal(size=3), rng.normal(size=3) * 10.0 ** rng.uniform(-2.0, 0.0)
        up = np.cross(right, rng.normal(size=3))
        up *= 10.0 ** rng.uniform(-2.0, 0.0) / np.linalg.norm(up)
        if np.linalg.norm(right) + np.linalg.norm(up) > 0.7 * np.linalg.norm(center):
            continue  # the sum over parts needs more of them next to the point
        right *= -np.sign(np.cross(right, up) @ center)
        scale = 10.0 ** rng.uniform(-4.0, 4.0)
        exact = integrate_cosine(center, right, up)
        light = evaluate(gather_rectangle, *(scale * np.array([center, right, up])), IDENTITY)
        corners = center[2] + np.array([1, 1, -1, -1]) * right[2] + np.array([1, -1, 1, -1]) * up[2]
        cut += int(corners.min() < 0.0 < corners.max())
        assert light["scattered"] == pytest.approx(exact, rel=0.01, abs=1e-5)
        assert light["mirrored"] == pytest.approx(exact, rel=0.01, abs=1e-5)
    assert cut > 10


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e9])
def test_light_is_finite_wherever_the_point_is(scale: float) -> None:
    """In a corner, on a side, in the middle and the plane of a rectangle, and on the axis of a tube."""
    right, up = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.5])
    for center in (
        (1, 0, 0.5),
        (1, 0, 0.2),
        (0, 0, 0),
        (3, 0, 0.5),
        (0, 1e-7, 0),
        (0, -1e-7, 0),
        (0, 1, -0.5),
    ):
        light = evaluate(gather_rectangle, scale * np.array(center), scale * right, scale * up, IDENTITY)
        for name in ("direction", "scattered", "mirrored"):
            assert np.isfinite(light[name]).all(), (center, name)
        assert 0.0 <= light["scattered"] <= 1.0 + 1e-5
        across = evaluate(turn_tube, scale * np.array(center), scale * right, 0.1 * scale)
        assert np.isfinite(across).all()
        assert np.linalg.norm(across) <= 1.001 * scale


def test_the_table_of_lobes_is_finite_and_smooth_metal_mirrors_all_light() -> None:
    table = np.load(FIT_FILE).astype(np.float64)
    assert table.shape == (2, FIT_SIZE, FIT_SIZE, 8)
    assert np.isfinite(table).all()
    assert table[1, 0, 0, 5] == pytest.approx(1.0, abs=0.01)
    assert (table[..., 6] <= table[..., 5] + 1e-3).all()
    determinants = table[..., 0] * table[..., 3] - table[..., 1] * table[..., 2]
    assert (determinants * table[..., 4] > 0.0).all()
    texels = read_fits().astype(np.float64)
    assert np.array_equal(texels[2 * FIT_SIZE + 3, 7], table[1, 3, 7, :4])
    assert np.array_equal(texels[FIT_SIZE + 3, 7], table[0, 3, 7, 4:])


@pytest.mark.nightly
def test_the_script_makes_the_table_again() -> None:
    root = Path(__file__).parents[3]
    command = [sys.executable, "scripts/fit_lobes.py", "--rows", str(FIT_SIZE - 1)]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, encoding="utf-8")
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
