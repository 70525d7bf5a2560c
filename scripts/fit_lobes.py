"""Fits linearly transformed cosines to the specular lobes of both lighting models, and writes the table that area
lights are lit by.

    python scripts/fit_lobes.py              # writes renderer/frame/lobe_fits.npy, in some minutes
    python scripts/fit_lobes.py --rows 3     # compares every third row of the table with a fit of it instead

A lobe is what a surface of a roughness mirrors to the eye, seen at an angle: a function of the direction to the
light, times n·l. It is replaced by a clamped cosine that a matrix M has stretched (Heitz, Dupuy, Hill and Neubelt,
Real-Time Polygonal-Light Shading with Linearly Transformed Cosines, 2016). M has the columns `m11 X`, `m22 Y` and
`m13 X + Z`, where Z is the lobe's mean direction, and Y is across the plane of normal and eye. Its three numbers
minimise the cube of the error, summed over directions that both functions were asked for (multiple importance
sampling), by the downhill simplex of Nelder and Mead (1965).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

ROOT: Final = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from renderer.frame.lobe_fits import FIT_FILE  # noqa: E402
from renderer.shaders.area_lights import (  # noqa: E402
    FIT_SIZE,
    FLATTEST_VIEW,
    fit_roughness,
    fit_view_cosine,
)

Floats = NDArray[np.float64]

_SAMPLES: Final = 32
"""The square root of the directions of each of the two functions."""
_FINE: Final = 128
"""The same, for the sums that aren't fitted."""
_STEPS: Final = 150
_ENOUGH: Final = 1e-6


class Lobe(NamedTuple):
    """A specular lobe for light of all directions.

    Attributes:
        evaluate: of directions (k, 3) to the light, the lobe times n·l (k,), the part of it that Schlick's term
            makes white, and the density (k,) with which `sample` makes these directions.
        sample: directions (k, 3) of points (k, 2) of the unit square.
    """

    evaluate: Callable[[Floats], tuple[Floats, Floats, Floats]]
    sample: Callable[[Floats], Floats]


def make_grid(size: int) -> Floats:
    """The middles (size², 2) of the cells of the unit square."""
    middles = (np.arange(size) + 0.5) / size
    return np.stack(np.meshgrid(middles, middles, indexing="ij"), axis=-1).reshape(-1, 2)


def make_direction(cosine: Floats, angle: Floats) -> Floats:
    """Unit vectors (k, 3) by the cosine to z and the angle around it."""
    sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
    return np.stack([sine * np.cos(angle), sine * np.sin(angle), cosine], axis=-1)


def make_lobe(roughness: float, view_cosine: float, *, is_metallic: bool) -> Lobe:
    """The lobe of the metallic-roughness model, GGX without Fresnel's term, or that of Blinn and Phong whose
    shininess has this roughness."""
    eye = make_direction(np.array(view_cosine), np.array(0.0))
    alpha = roughness**2
    shininess = 2.0 / alpha**2 - 2.0

    def density(half: Floats) -> Floats:
        along = np.clip(half[:, 2], 0.0, 1.0)
        if not is_metallic:
            return np.asarray((shininess + 1.0) / (2.0 * np.pi) * along**shininess)
        across = half[:, 0] ** 2 + half[:, 1] ** 2
        return np.asarray(alpha**2 / (np.pi * (across + alpha**2 * along**2) ** 2) * along)

    def evaluate(to_light: Floats) -> tuple[Floats, Floats, Floats]:
        half = to_light + eye
        half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-300)
        lit, toward = np.maximum(to_light[:, 2], 0.0), np.clip(half @ eye, 1e-9, 1.0)
        chance = density(half)
        if is_metallic:
            masks = [c + np.sqrt(alpha**2 + (1.0 - alpha**2) * c**2) for c in (lit, view_cosine)]
            light = chance / np.maximum(half[:, 2], 1e-9) * lit / (masks[0] * masks[1])
        else:
            light = (shininess + 8.0) / (4.0 * (shininess + 1.0)) * chance * lit
        return light, light * (1.0 - toward) ** 5, chance / (4.0 * toward)

    def sample(points: Floats) -> Floats:
        if is_metallic:
            cosine = 1.0 / np.sqrt(1.0 + alpha**2 * points[:, 0] / (1.0 - points[:, 0]))
        else:
            cosine = (1.0 - points[:, 0]) ** (1.0 / (shininess + 1.0))
        half = make_direction(cosine, 2.0 * np.pi * points[:, 1])
        return 2.0 * (half @ eye)[:, None] * half - eye

    return Lobe(evaluate, sample)


def integrate(lobe: Lobe) -> tuple[float, float, Floats]:
    """The lobe's integral, that of its white part, and its mean direction (3,) in the plane of the eye."""
    to_light = lobe.sample(make_grid(_FINE))
    light, white, chance = lobe.evaluate(to_light)
    weights = np.where(chance > 0.0, light / np.maximum(chance, 1e-300), 0.0) / len(chance)
    whites = np.where(chance > 0.0, white / np.maximum(chance, 1e-300), 0.0) / len(chance)
    mean = (weights[:, None] * to_light).sum(axis=0)
    mean[1] = 0.0
    return float(weights.sum()), float(whites.sum()), mean / np.linalg.norm(mean)


def make_matrix(numbers: Floats, mean: Floats) -> Floats:
    """The matrix M (3, 3) of `m11`, `m22` and `m13`, with the axis Z along the mean direction."""
    side = np.array([mean[2], 0.0, -mean[0]])
    axes = np.stack([side, (0.0, 1.0, 0.0), mean], axis=1)
    m11, m22 = np.maximum(numbers[:2], 1e-7)
    return np.asarray(axes @ np.array([[m11, 0.0, numbers[2]], [0.0, m22, 0.0], [0.0, 0.0, 1.0]]))


def measure_error(lobe: Lobe, total: float, matrix: Floats, grid: Floats, directions: Floats) -> float:
    """The sum of the cubes of the differences between the lobe and `total` times the transformed cosine."""
    inverse, determinant = np.linalg.inv(matrix), abs(np.linalg.det(matrix))
    cosine = make_direction(np.sqrt(grid[:, 0]), 2.0 * np.pi * grid[:, 1]) @ matrix.T
    both = np.concatenate([cosine / np.linalg.norm(cosine, axis=1, keepdims=True), directions])
    light, _, chance = lobe.evaluate(both)
    back = both @ inverse.T
    length = np.linalg.norm(back, axis=1)
    fit = np.maximum(back[:, 2], 0.0) / (np.pi * length**4 * determinant)
    weight = chance + fit
    errors = np.abs(light - total * fit) ** 3 / np.maximum(weight, 1e-30)
    return float(np.where(weight > 0.0, errors, 0.0).sum() / len(grid))


def minimize(function: Callable[[Floats], float], start: Floats, size: float) -> Floats:
    """The point (n,) near `start` at which a function is least."""
    count = len(start)
    corners = [start, *(start + size * step for step in np.eye(count))]
    values = [function(corner) for corner in corners]
    for _ in range(_STEPS):
        order = np.argsort(values, kind="stable")
        corners, values = [corners[i] for i in order], [values[i] for i in order]
        if abs(values[-1] - values[0]) <= _ENOUGH * abs(values[0]) + 1e-300:
            break
        center = np.mean(corners[:-1], axis=0)
        reflected = 2.0 * center - corners[-1]
        value = function(reflected)
        if value < values[0]:
            farther = 3.0 * center - 2.0 * corners[-1]
            far_value = function(farther)
            corners[-1], values[-1] = (farther, far_value) if far_value < value else (reflected, value)
        elif value < values[-2]:
            corners[-1], values[-1] = reflected, value
        else:
            nearer = 0.5 * (center + (reflected if value < values[-1] else corners[-1]))
            near_value = function(nearer)
            if near_value < min(value, values[-1]):
                corners[-1], values[-1] = nearer, near_value
            else:
                corners[1:] = [0.5 * (corner + corners[0]) for corner in corners[1:]]
                values[1:] = [function(corner) for corner in corners[1:]]
    return corners[int(np.argmin(values))]


def fit_row(roughness: float, *, is_metallic: bool) -> Floats:
    """The row (`FIT_SIZE`, 8) of the table for a roughness, by the angle of view: the numbers xx, xz, zx, zz and yy of
    M⁻¹, scaled so that half floats hold them, the integrals of the lobe and of its white part, and 0."""
    grid, row = make_grid(_SAMPLES), np.zeros((FIT_SIZE, 8))
    numbers = np.array([roughness**2, roughness**2, 0.0])
    for column in range(FIT_SIZE):
        view_cosine = max(float(fit_view_cosine(column)), FLATTEST_VIEW)
        lobe = make_lobe(roughness, view_cosine, is_metallic=is_metallic)
        total, white, mean = integrate(lobe)
        directions = lobe.sample(grid)

        def error(guess: Floats, *, around: Floats = mean, lobe: Lobe = lobe, total: float = total,
                  directions: Floats = directions, is_upright: bool = column == 0) -> float:  # fmt: skip
            if is_upright:
                guess = np.array([guess[0], guess[0], 0.0])
            return measure_error(lobe, total, make_matrix(guess, around), grid, directions)

        if column == 0:
            mean = np.array([0.0, 0.0, 1.0])
            width = minimize(partial(error, around=mean), numbers[:1], 0.3 * float(numbers[0]))[0]
            numbers = np.array([width, width, 0.0])
        else:
            numbers = minimize(error, numbers, 0.1 * float(numbers[:2].min()))
        inverse = np.linalg.inv(make_matrix(numbers, mean))
        inverse /= np.sqrt(inverse[1, 1] * inverse[2, 2])
        row[column, :4] = inverse[0, 0], inverse[0, 2], inverse[2, 0], inverse[2, 2]
        row[column, 4:] = inverse[1, 1], total, white, 0.0
    return row


def fit_table(step: int = 1) -> Floats:
    """The table (2, `FIT_SIZE`, `FIT_SIZE`, 8) of both models, by roughness and angle; of each `step`th roughness."""
    table = np.full((2, FIT_SIZE, FIT_SIZE, 8), np.nan)
    with ProcessPoolExecutor() as pool:
        rows = {
            (model, number): pool.submit(
                fit_row, float(fit_roughness(number, is_metallic=bool(model))), is_metallic=bool(model)
            )
            for model in range(2)
            for number in range(0, FIT_SIZE, step)
        }
        for index, row in rows.items():
            table[index] = row.result()
    return table


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--rows", type=int, metavar="N", help="compare every Nth row, and write nothing")
    options = parser.parse_args()
    table = fit_table(options.rows or 1)
    if not options.rows:
        np.save(FIT_FILE, table.astype(np.float16))
        print(f"{FIT_FILE.relative_to(ROOT)}: {table.shape}")
        return 0
    stored = np.load(FIT_FILE).astype(np.float64)
    difference = float(np.nanmax(np.abs(stored - table) / np.maximum(np.abs(table), 0.01)))
    print(f"differs by at most {100.0 * difference:.2f} %")
    return int(difference > 0.01)


if __name__ == "__main__":
    sys.exit(main())
