"""Growth of a frame's time with objects, lights, textures and pixels: exponents, costs of one more, and crossings.

- objects: boxes on a plain (`grid:mesh=box`), most of them in view, with the visibility algorithms
  that the device can run.
- lights: the hall with coloured lights, with several techniques.
- textures: the bazaar, whose materials have three textures each.
- pixels: the hall with 256 lights, from 64×36 to 2048×1152 pixels.

Variants of a series take turns, frame by frame, while the eye moves; times are medians of processor time. Behind the
rows are the fits, of the larger half of the sizes: a slope is the exponent p in `time = c · n^p`, and `one more` is
what one more costs at the largest size, p · time / n. The last rows are the crossings: the size at which another
variant becomes the fastest, on straight lines between the sizes in a log-log chart.

    python benchmarks/scaling.py [--json] [--plot scaling.png] [--rounds 5] [--only objects,lights] [--backend cl]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import load_scene
from renderer.lab.comparison import Frames, Record, Subject, compare, time
from renderer.settings import RenderSettings
from renderer.visibility import list_algorithms

SMALL: Final = (160, 90)
COLUMNS: Final = {"ms": time(digits=4, processor=True)}
FITTED: Final = 2  # at least so many sizes
STEP: Final = 0.25  # metres that the eye moves from frame to frame


@dataclass(frozen=True, slots=True)
class Series:
    """Frames of growing size.

    Attributes:
        scene: the scene's name with `{n}`; without it, `n` is a number of pixels.
        sizes: the values of `n`.
        setting: the setting whose values are the variants.
        variants: those values, each with the largest `n` at which it takes part.
        settings: the settings of all variants.
    """

    scene: str
    sizes: tuple[int, ...]
    setting: str
    variants: Mapping[str, int]
    settings: Mapping[str, Any]

    def limit(self, largest: int) -> tuple[int, ...]:
        """The sizes up to a largest one, or the smallest alone."""
        return tuple(n for n in self.sizes if n <= largest) or self.sizes[:1]


MILLION: Final = 1_000_000
FORWARD: Final = {"technique.name": "forward"}
FRUSTUM: Final = {"algorithm": "frustum"}
SERIES: Final = {
    "objects": Series(
        "grid:mesh=box,count={n}",
        (100, 1_000, 10_000, 100_000, MILLION),
        "algorithm",
        {
            "none": MILLION,
            "frustum": MILLION,
            "two_pass": MILLION,
            "depth_pyramid": MILLION,
            "chc_plus_plus": 10_000,
        },
        FORWARD,
    ),
    "lights": Series(
        "hall:columns=8,flags=4,lights={n}",
        (4, 16, 64, 256, 1_024, 4_096, 16_384, 65_536),
        "technique.name",
        {"forward": 65_536, "clustered": 65_536, "tiled_deferred": 1_024, "deferred_plus": 65_536},
        FRUSTUM,
    ),
    "textures": Series(
        "bazaar:instances=2000,meshes=20,lights=8,materials={n}",
        (10, 100, 1_000, 10_000),
        "technique.name",
        {"forward": 10_000, "deferred_plus": 10_000},
        FRUSTUM,
    ),
    "pixels": Series(
        "hall:lights=256",
        tuple(64 * 36 * 4**k for k in range(6)),
        "technique.name",
        {"forward": MILLION * 10, "clustered": MILLION * 10, "deferred_plus": MILLION * 10},
        FRUSTUM,
    ),
}


def measure_size(backend: str | None, name: str, n: int, rounds: int) -> Iterator[Record]:
    """Yield the rows of one size of a series, one for each variant, which has a device of its own: so it shares no
    cache."""
    series = SERIES[name]
    scene = load_scene(series.scene.format(n=n))
    grows = "{n}" in series.scene
    width = round((n * 16 / 9) ** 0.5)
    size = SMALL if grows else (width, n // width)
    with ExitStack() as opened:
        subjects = []
        for variant in (key for key, largest in series.variants.items() if n <= largest):
            device = opened.enter_context(rhi.create_device(backend))
            if series.setting == "algorithm" and variant not in list_algorithms(device):
                continue
            settings = RenderSettings().change_all({**series.settings, series.setting: variant})
            renderer = opened.enter_context(settings.open(device, scene, size))
            eye = settings.adapt_camera(next(iter(scene.views.values())))
            steps = np.arange(rounds)[:, None] * (STEP, 0.0, 0.0)
            cameras = (replace(eye, position=position) for position in eye.position + steps)
            subjects.append(Subject({"series": name, "n": n, "variant": variant}, Frames(renderer, *cameras)))
        yield from compare(subjects, COLUMNS, range(rounds), warm_ups=2)


def fit(rows: Sequence[Record]) -> tuple[float, float]:
    """Fit the larger half of the sizes; return the exponent, and the microseconds of one more at the largest size.

    Both are NaN for fewer than two sizes.
    """
    upper = rows[min(len(rows) // 2, max(len(rows) - FITTED, 0)) :]
    if len(upper) < FITTED:
        return float("nan"), float("nan")
    n, times = (np.log([row[key] for row in upper]) for key in ("n", "ms"))
    slope = float(np.polyfit(n, times, 1)[0])
    return slope, 1e3 * slope * rows[-1]["ms"] / rows[-1]["n"]


def list_crossings(times: Mapping[str, Mapping[int, float]]) -> list[tuple[float, str, str]]:
    """List where the fastest variant changes: the size, the variant before and the one from there on.

    Between two sizes, each time is a straight line in a log-log chart. A variant that isn't measured at a size takes
    part only up to the one before.

    Args:
        times: of each variant, the milliseconds by size.
    """
    sizes = sorted({n for by_size in times.values() for n in by_size})
    crossings: list[tuple[float, str, str]] = []
    for low, high in pairwise(sizes):
        names = [name for name, by_size in times.items() if low in by_size and high in by_size]
        lines = {name: np.log([times[name][low], times[name][high]]) for name in names}
        at = 0.0
        fastest = min(names, key=lambda name: tuple(lines[name]), default="")
        while names:
            before = lines[fastest]
            meetings = []
            for name in names:
                gap, end = lines[name] - before
                if end < 0.0 and gap >= 0.0 and (position := gap / (gap - end)) >= at:
                    meetings.append((position, end, name))
            if not meetings:
                break
            at, _, taking_over = min(meetings)
            crossings.append((low * (high / low) ** at, fastest, taking_over))
            fastest = taking_over
    return crossings


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the times of all series, then the fits, and then the crossings."""
    rows: list[Record] = []
    for name in arguments.only:
        for n in SERIES[name].limit(arguments.largest):
            for row in measure_size(arguments.backend, name, n, arguments.rounds):
                rows.append(row)
                yield row
    for name in arguments.only:
        rows_by_variant = {
            variant: [row for row in rows if (row["series"], row["variant"]) == (name, variant)]
            for variant in SERIES[name].variants
        }
        rows_by_variant = {
            variant: of_variant for variant, of_variant in rows_by_variant.items() if of_variant
        }
        for variant, of_variant in rows_by_variant.items():
            slope, one_more = fit(of_variant)
            yield {"fit of": name, "variant": variant, "exponent": round(slope, 2), "one more (µs)": one_more}
        times = {
            variant: {row["n"]: row["ms"] for row in of_variant}
            for variant, of_variant in rows_by_variant.items()
        }
        for at, before, after in list_crossings(times):
            yield {"crossing of": name, "at": round(at), "fastest before": before, "from there on": after}


def plot(figure: Any, rows: Sequence[Record]) -> None:
    """Draw the times of each series, with the exponents."""
    exponents = {(row["fit of"], row["variant"]): row["exponent"] for row in rows if "fit of" in row}
    names = list(dict.fromkeys(name for name, _ in exponents))
    for axes, name in zip(figure.subplots(1, len(names), squeeze=False)[0], names, strict=True):
        for variant in (variant for series, variant in exponents if series == name):
            of_variant = [row for row in rows if (row.get("series"), row.get("variant")) == (name, variant)]
            label = f"{variant}: n^{exponents[name, variant]:.2f}"
            axes.loglog(
                [row["n"] for row in of_variant], [row["ms"] for row in of_variant], "o-", label=label
            )
        axes.set(xlabel=name, ylabel="milliseconds of processor time")
        axes.grid(alpha=0.3)
        axes.legend()


OPTIONS: Final = (
    options.BACKEND,
    options.rounds("rounds for each size", 5),
    options.count("--largest", "sizes beyond this are left out", 100_000_000),
    options.names("--only", SERIES, "is not a series", list(SERIES), "all", "series to measure: "),
    options.chart(),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure, plot)
