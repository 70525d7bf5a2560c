"""The small programs of examples/programs: the same picture on gl and cl, and the commands that each one sends."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import Op

FOLDER = Path(__file__).parents[2] / "examples" / "programs"
PROGRAMS = sorted(path.stem for path in FOLDER.glob("*.py") if path.stem != "frame")
SIZE = (200, 150)

FAR_APART = {
    "curves": 0.002,  # a point of a line on the edge between two pixels
    "draw_lists": 0.0,
    "instanced_crates": 0.0001,  # the corner of a far crate
    "julia": 0.03,  # next to the set, the last bit of a coordinate decides
    "shadow_map": 0.001,  # the edge of a shadow
    "textured_cube": 0.005,  # levels between two mip levels have 8 bits
}
"""Largest part of the pixels in which a channel may differ by more than 3/255; nothing for the other programs."""

COSTS = {  # draws, dispatches, render passes
    "bloom": (5, 0, 5),
    "curves": (9, 0, 1),
    "draw_lists": (3, 0, 1),
    "instanced_crates": (1, 0, 1),
    "julia": (1, 0, 1),
    "life": (1, 100, 1),
    "particles": (2, 90, 2),
    "raymarching": (1, 0, 1),
    "shadow_map": (2, 0, 2),
    "terrain": (1, 0, 1),
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


def test_there_are_twelve() -> None:
    assert len(PROGRAMS) == 12


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_draws_the_same_picture_on_gl_and_cl(name: str, devices: list[rhi.Device]) -> None:
    program = importlib.import_module(name)
    first, second = (program.render(device, SIZE).read()[..., :3].astype(int) for device in devices)
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > (1 if name == "life" else 20)
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
    place, velocity, age = (rows[name].astype(float) for name in ("place", "velocity", "age"))
    seconds = np.float64(np.float32(1 / 60))
    for _ in range(particles.STEPS):
        age += seconds
        moved = np.where(age > 0, seconds, 0.0)[:, None]
        velocity -= np.array((0, particles.GRAVITY, 0)) * moved
        place += velocity * moved
    steady = (place[:, 1] > 0.01) & (np.abs(age % seconds) > 1e-4)  # neither bounced nor about to start
    assert steady.mean() > 0.5
    for device in devices:
        moved_rows = particles.simulate(device).read()
        assert np.abs(moved_rows["place"] - place)[steady].max() < 1e-4


@pytest.mark.slow
def test_the_programs_pass_mypy_strict(mypy_strict: Callable[..., tuple[str, int]], monkeypatch: Any) -> None:
    monkeypatch.setenv("MYPYPATH", str(FOLDER))
    out, status = mypy_strict(*(FOLDER / f"{name}.py" for name in PROGRAMS))
    assert status == 0, out
