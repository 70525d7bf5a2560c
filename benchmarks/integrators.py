"""Integrators of simulations: error against time, beside others that could do the same.

- `chain`: a chain of 8 links that swings from 40° for 2 s. The renderer's steps (BDF2 and projected distances)
  and the same of first order (position-based dynamics), by their sub-steps, against Runge-Kutta of fourth order
  with Lagrange multipliers in float64. Errors: the mean distance of points from theirs, in mm.
- `wave`: a standing wave of 2 m between walls for 5 s, 32 cells, against the analytic wave. Leapfrog steps, as
  pools take them, and steps of Euler, forward and semi-implicit. Errors: the greatest, in % of the height.
- `drop`: the flight of a fountain's drop for .8 s against the parabola. The renderer's steps, and those of Euler.
  Errors: the greatest distance, in mm.

All run on NumPy; times are processor milliseconds for a simulated second, medians over the rounds. Skins and
morph targets are functions of time, and have no integrator.

    python benchmarks/integrators.py [--rounds 5]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from time import process_time
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content.fountains import FountainSimulation
from renderer.lab.comparison import Record
from renderer.scene.cloth import ClothSimulation, Fabric, Wind, make_cloth_grid

Floats = NDArray[np.float64]

GRAVITY: Final = 9.81
LINKS: Final = 8
LINK: Final = 0.125
SWING_SECONDS: Final = 2
RATE: Final = 60
"""Steps a second."""
SUB_STEPS: Final = (1, 2, 4, 8, 16, 32)
WAVE_SECONDS: Final = 5.0
CELLS: Final = 32
FLIGHT: Final = 0.8
EULER: Final = ("semi-implicit Euler", "forward Euler")

Comparison = tuple[Callable[[str, int], float], Sequence[str], Sequence[int], float, float, str]
"""A simulation by integrator and steps, which returns its error; the names and the rates of integrators, the
seconds that are simulated, and the scale and the unit of errors."""


def list_chain_points() -> Floats:
    """Points (n, 2) of a straight chain, 40° from hanging; the first one is pinned."""
    angle = np.radians(40.0)
    direction = np.array([np.sin(angle), -np.cos(angle)])
    return np.asarray(np.arange(LINKS + 1)[:, None] * LINK * direction)


def swing_exactly(steps: int) -> Floats:
    """The points after the swing, by so many steps of Runge-Kutta: links are constraints of the free points, and
    their tensions follow from the second derivative of their lengths."""
    points = list_chain_points()[1:].copy()
    state = np.stack([points, np.zeros_like(points)])
    seconds = SWING_SECONDS / steps

    def derive(state: Floats) -> Floats:
        position, velocity = state
        links = np.diff(position, axis=0, prepend=0.0)
        relative = np.diff(velocity, axis=0, prepend=0.0)
        gravity = np.tile([0.0, -GRAVITY], (LINKS, 1))
        # Tension k pulls point k back along link k and point k − 1 forth: rows of J.
        jacobian = np.zeros((LINKS, LINKS, 2))
        index = np.arange(LINKS)
        jacobian[index, index] = links
        jacobian[index[1:], index[:-1]] = -links[1:]
        flat = jacobian.reshape(LINKS, -1)
        due = -(relative**2).sum(axis=1) - flat @ gravity.reshape(-1)
        tension = np.linalg.solve(flat @ flat.T, due)
        return np.stack([velocity, gravity + (flat.T @ tension).reshape(LINKS, 2)])

    for _ in range(steps):
        a = derive(state)
        b = derive(state + 0.5 * seconds * a)
        c = derive(state + 0.5 * seconds * b)
        d = derive(state + seconds * c)
        state = state + seconds / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return np.concatenate([[[0.0, 0.0]], state[0]])


def swing_cloth(sub_steps: int) -> Floats:
    """The points of the renderer's cloth: a strip of two columns, which swings as the chain does."""
    chain = list_chain_points()
    points = np.zeros((LINKS + 1, 2, 3))
    points[..., 1:] = chain[:, None, ::-1]
    points[:, 1, 0] = LINK
    pinned = np.zeros((LINKS + 1, 2), bool)
    pinned[0] = True
    fabric = Fabric(drag=0.0, damping=0.0, bend=1e6, shear=1e6)
    cloths = ClothSimulation(
        1, make_cloth_grid(points, pinned, fabric=fabric, sub_steps=sub_steps, interval=1.0 / RATE), Wind()
    )
    for number in range(1, SWING_SECONDS * RATE + 1):
        cloths.step(np.arange(1), np.array([number]))
    moved = cloths.vertices(np.arange(1))["position"].reshape(LINKS + 1, 2, 3)
    return np.asarray(moved.mean(axis=1)[:, :0:-1], np.float64)


def swing_first_order(sub_steps: int) -> Floats:
    """The points by position-based dynamics (Müller and others, Position Based Dynamics, 2007), with as many
    projections in a sub-step: links of even number, then of odd."""
    points = list_chain_points()
    velocities = np.zeros_like(points)
    seconds = 1.0 / RATE / sub_steps
    free = np.ones((LINKS + 1, 1))
    free[0] = 0.0
    for _ in range(SWING_SECONDS * RATE * sub_steps):
        before = points
        points = points + free * seconds * (velocities + seconds * np.array([0.0, -GRAVITY]))
        for first in (0, 1):
            a, b = np.arange(first, LINKS, 2), np.arange(first, LINKS, 2) + 1
            way = points[b] - points[a]
            size = np.linalg.norm(way, axis=1, keepdims=True)
            way *= (size - LINK) / (size * (free[a] + free[b]))
            points[a] += way * free[a]
            points[b] -= way * free[b]
        velocities = (points - before) / seconds
    return points


def roll_wave(integrator: str, steps: int) -> float:
    """The greatest error of a standing wave, as a fraction of its height."""
    start = np.cos(np.pi * np.linspace(0.0, 1.0, CELLS + 1))
    depth, spacing, seconds = 0.1, 2.0 / CELLS, WAVE_SECONDS / steps
    speed = GRAVITY * depth / spacing**2
    heights, rates, worst = start.copy(), np.zeros(CELLS + 1), 0.0

    def bend(values: Floats) -> Floats:
        padded = np.concatenate([values[1:2], values, values[-2:-1]])
        return np.asarray(speed * (padded[2:] + padded[:-2] - 2.0 * values))

    if integrator == "leapfrog":
        rates = 0.5 * seconds * bend(heights)
    frequency = np.sqrt(GRAVITY * depth) * np.pi / 2.0
    for number in range(1, steps + 1):
        match integrator:
            case "forward Euler":
                heights, rates = heights + seconds * rates, rates + seconds * bend(heights)
            case "semi-implicit Euler":
                rates = rates + seconds * bend(heights)
                heights = heights + seconds * rates
            case _:
                heights = heights + seconds * rates
                rates = rates + seconds * bend(heights)
        exact = start * np.cos(frequency * seconds * number)
        worst = max(worst, float(np.abs(heights - exact).max()))
    return worst


def throw_drop(integrator: str, steps: int) -> float:
    """The greatest distance of a drop from its parabola, in metres."""
    seconds = FLIGHT / steps
    if integrator == "renderer":
        fountain = FountainSimulation(1, 1, max(round(1.5 / seconds), 1))
        fountain.step(np.arange(1), np.array([0]))
        thrown, worst = fountain.velocity[0, 0].copy(), 0.0
        for number in range(1, round(FLIGHT / fountain.interval) + 1):
            fountain.step(np.arange(1), np.array([number]))
            time = number * fountain.interval
            exact = thrown * time - np.array([0.0, 0.5 * GRAVITY * time**2, 0.0])
            if number < len(fountain.position[0]):
                worst = max(worst, float(np.linalg.norm(fountain.position[0, 0] - exact)))
        return worst
    height, velocity, worst = 0.0, 6.0, 0.0
    for number in range(1, steps + 1):
        if integrator == "semi-implicit Euler":
            velocity -= GRAVITY * seconds
            height += velocity * seconds
        else:
            height += velocity * seconds
            velocity -= GRAVITY * seconds
        time = number * seconds
        worst = max(worst, abs(height - (6.0 * time - 0.5 * GRAVITY * time**2)))
    return worst


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the error and the time of each integrator with each number of steps."""
    exact = swing_exactly(SWING_SECONDS * 2000)

    def time(work: Callable[[], object], simulated: float) -> float:
        taken = []
        for _ in range(arguments.rounds):
            began = process_time()
            work()
            taken.append(process_time() - began)
        return round(1e3 * float(np.median(taken)) / simulated, 3)

    chains: dict[str, Callable[[int], Floats]] = {
        "renderer (BDF2)": swing_cloth,
        "first order": swing_first_order,
        "Runge-Kutta, multipliers": lambda sub_steps: swing_exactly(SWING_SECONDS * RATE * sub_steps),
    }
    for name, swing in chains.items():
        for sub_steps in SUB_STEPS:
            error = float(np.linalg.norm(swing(sub_steps) - exact, axis=1).mean())
            taken = time(partial(swing, sub_steps), SWING_SECONDS)
            yield _make_row("chain", name, RATE * sub_steps, f"{1e3 * error:.3g} mm", taken)
    others: dict[str, Comparison] = {
        "wave": (roll_wave, ("leapfrog", *EULER), (60, 120, 240), WAVE_SECONDS, 100.0, "%"),
        "drop": (throw_drop, ("renderer", *EULER), (10, 20, 60), FLIGHT, 1e3, "mm"),
    }
    for simulation, (simulate, names, rates, seconds, scale, unit) in others.items():
        for name in names:
            for rate in rates:
                work = partial(simulate, name, round(seconds * rate))
                error = f"{scale * work():.3g} {unit}"
                yield _make_row(simulation, name, rate, error, time(work, seconds))


def _make_row(simulation: str, integrator: str, rate: int, error: str, milliseconds: float) -> Record:
    return {
        "simulation": simulation,
        "integrator": integrator,
        "steps a second": rate,
        "error": error,
        "milliseconds": milliseconds,
    }


OPTIONS: Final = (options.rounds("rounds that are timed", 5),)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
