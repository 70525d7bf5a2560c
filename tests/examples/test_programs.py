"""The small programs of examples/programs: the same image on gl and cl, and the commands that each one
sends."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nightly_reasons import CHEAPER_TEST, FEWER_CASES

import rhi
from rhi import Op

FOLDER = Path(__file__).parents[2] / "examples" / "programs"
PROGRAMS = sorted(path.stem for path in FOLDER.glob("*.py"))
PACKAGES = ("rhi", "rhi_screen", "renderer")
SIZE = (200, 150)

FAR_APART = {
    "curves": 0.002,  # a point of a line on the edge between two pixels
    "deferred": 0.008,  # sums of many lights in 8 bits; 6/255 at most
    "draw_lists": 0.0,
    "instanced_crates": 0.0001,  # the corner of a far crate
    "julia": 0.03,  # next to the set, the last bit of a coordinate decides
    "shadow_map": 0.001,  # the edge of a shadow
    "sprites": 0.0001,  # twenty layers of 8 bits
    "textured_cube": 0.005,  # levels between two mip levels have 8 bits
}
"""Largest part of the pixels in which a channel may differ by more than 3/255; nothing for the other
programs."""

FEW_COLORS = {"engine_test": 5, "life": 1}
"""The programs with few colors, which have more than so many; the others have more than 20."""

COSTS = {  # draws, dispatches, render passes
    "batch": (1, 0, 1),
    "beside_moderngl": (1, 0, 1),
    "bloom": (5, 0, 5),
    "boids": (88, 30, 59),
    "curves": (9, 0, 1),
    "deferred": (2, 0, 2),
    "draw_lists": (3, 0, 1),
    "engine_test": (4, 0, 1),
    "film": (1, 0, 1),
    "instanced_crates": (1, 0, 1),
    "julia": (1, 0, 1),
    "life": (1, 100, 1),
    "occlusion": (2001, 0, 1),  # a counted draw for each box
    "particles": (2, 90, 2),
    "picking": (2, 0, 2),
    "raymarching": (1, 0, 1),
    "shadow_map": (2, 0, 2),
    "sprites": (1, 0, 1),
    "terrain": (1, 0, 1),
    "text": (3, 0, 1),
    "textured_cube": (1, 0, 1),
    "triangle": (1, 0, 1),
}


@pytest.fixture(autouse=True)
def on_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(FOLDER))


@pytest.fixture(scope="module")
def devices() -> Iterator[list[rhi.Device]]:
    with rhi.create_device("gl", validation=True) as gl, rhi.create_device("cl", validation=True) as cl:
        yield [gl, cl]


def test_each_example_needs_only_installed_packages() -> None:
    imported = {
        name.partition(".")[0]
        for program in PROGRAMS
        for node in ast.walk(ast.parse((FOLDER / f"{program}.py").read_text(encoding="utf-8")))
        for name in ([node.module or ""] if isinstance(node, ast.ImportFrom) else [])
        + ([alias.name for alias in node.names] if isinstance(node, ast.Import) else [])
    }
    assert imported & set(PROGRAMS) == set()
    assert imported <= {
        *sys.stdlib_module_names,
        "numpy",
        "PIL",
        "moderngl",
        "pytest",
        "imgui_bundle",
        *PACKAGES,
    }


def test_each_is_on_the_page_and_in_the_table() -> None:
    page = (FOLDER.parents[1] / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert sorted(COSTS) == PROGRAMS
    assert [
        name for name in PROGRAMS if f"programs/{name}.py" not in page or f"gallery/{name}.webp" not in page
    ] == []


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_has_less_than_120_lines(name: str) -> None:
    lines = (FOLDER / f"{name}.py").read_text(encoding="utf-8").splitlines()
    assert sum(bool(line.strip()) for line in lines) < 120


@pytest.mark.nightly_cases(
    "bloom",
    "boids",
    "deferred",
    "draw_lists",
    "instanced_crates",
    "julia",
    "occlusion",
    "picking",
    "shadow_map",
    "sprites",
    "terrain",
    "textured_cube",
    reason=FEWER_CASES,
)
@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_draws_the_same_image_on_gl_and_cl(name: str, devices: list[rhi.Device]) -> None:
    program = importlib.import_module(name)
    first, second = (program.render(device, SIZE).read()[..., :3].astype(int) for device in devices)
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > FEW_COLORS.get(name, 20)
    apart = np.abs(first - second).max(axis=-1) > 3
    assert apart.mean() <= FAR_APART.get(name, 0.0)


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_draws_as_often_as_it_must(
    name: str, command_stream: rhi.CommandStream, null_device: rhi.Device
) -> None:
    importlib.import_module(name).render(null_device, SIZE)
    counts = tuple(len(command_stream.filter(op)) for op in (Op.DRAW, Op.DISPATCH, Op.BEGIN_PASS))
    assert counts == COSTS[name]


def test_the_game_of_life_lives_as_on_the_cpu(devices: list[rhi.Device]) -> None:
    life = importlib.import_module("life")
    cells = life.make_cells()
    for _ in range(life.GENERATIONS):
        cells = life.step(cells)
    assert cells.any()
    for device in devices:
        assert np.array_equal(life.simulate(device).read(), cells)


def test_particles_fall_as_on_the_cpu(devices: list[rhi.Device]) -> None:
    """Within 1e-4 of float64: 90 sums of numbers up to 7 in float32 round by 4e-7 each, at most."""
    particles = importlib.import_module("particles")
    rows = particles.make_particles()
    position, velocity, age = (rows[name].astype(float) for name in ("position", "velocity", "age"))
    seconds = np.float64(np.float32(1 / 60))
    for _ in range(particles.STEPS):
        age += seconds
        moved = np.where(age > 0, seconds, 0.0)[:, None]
        velocity -= np.array((0, particles.GRAVITY, 0)) * moved
        position += velocity * moved
    steady = (position[:, 1] > 0.01) & (np.abs(age % seconds) > 1e-4)  # neither bounced nor about to start
    assert steady.mean() > 0.5
    for device in devices:
        moved_rows = particles.simulate(device).read()
        assert np.abs(moved_rows["position"] - position)[steady].max() < 1e-4


def test_a_click_finds_the_box_that_is_nearest_along_its_ray(devices: list[rhi.Device]) -> None:
    picking = importlib.import_module("picking")
    rng = np.random.default_rng(0)
    for device in devices:
        scene = picking.Scene(device, SIZE)
        scene.draw()
        for x, y in rng.integers(0, SIZE, (30, 2)).tolist():
            assert scene.pick(x, y) == nearest_box(scene, x, y)


def nearest_box(scene: Any, x: int, y: int) -> int | None:
    """Return the box that a ray through the center of a pixel meets first (slabs, float64), or None."""
    ends = [(2 * (x + 0.5) / SIZE[0] - 1, 1 - 2 * (y + 0.5) / SIZE[1], depth, 1) for depth in (1.0, 1e-3)]
    near, far = (np.linalg.inv(scene.view_projection) @ end for end in ends)
    start, direction = near[:3] / near[3], far[:3] / far[3] - near[:3] / near[3]
    slabs = (scene.rows["center"].astype(float)[..., None] + (-0.4, 0.4) - start[:, None]) / direction[
        :, None
    ]
    enters, leaves = slabs.min(-1).max(-1), slabs.max(-1).min(-1)
    hit = np.flatnonzero(enters < leaves)
    return int(hit[np.argmin(enters[hit])]) if len(hit) else None


def test_spheres_are_drawn_where_their_boxes_are_visible(devices: list[rhi.Device]) -> None:
    """A sphere that is seen lies in a box that is seen: what isn't drawn wouldn't have changed a pixel."""
    occlusion = importlib.import_module("occlusion")
    for device in devices:
        _, queries = occlusion.draw(device, SIZE)
        seen = queries.wait()[: occlusion.COUNT] > 0
        assert 0.2 < seen.mean() < 0.5


def test_frames_of_several_processes_are_those_of_one(devices: list[rhi.Device], tmp_path: Path) -> None:
    batch = importlib.import_module("batch")
    times = [0.0, 0.5, 1.0, 1.5, 2.0]
    worker = batch.Worker(devices[0], (32, 24))
    expected = [worker.draw(seconds).read() for seconds in times]
    paths = [tmp_path / f"{seconds}.png" for seconds in times]
    frames = [rhi.load_image(path) for path in batch.save_frames(times, paths, (32, 24), "gl", 2)]
    assert all(np.array_equal(frame, other) for frame, other in zip(frames, expected, strict=True))


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_the_tests_of_the_engine_and_of_the_batch_pass() -> None:
    programs = (FOLDER / "engine_test.py", FOLDER / "batch.py")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-n",
        "0",
        "-p",
        "no:cacheprovider",
        "--rhi-backend",
        "gl",
        *programs,
    ]
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=FOLDER, encoding="utf-8")
    assert run.returncode == 0, run.stdout
    assert run.stdout.startswith("......")
