"""Techniques, texture filters, shadow filters and sample counts at equal error and in equal time.

Each value of a setting is drawn at several scales of the image, so that it has a curve of error over time. A
row compares its curve with the default value at the size of the image: `time` is the time in which it has the
same error, `error` the error that it has in the same time, both as ratios with their 95 % intervals. `never`:
no scale of the curve is as accurate, or as fast. Errors are distances from ray-traced images, times processor
time. The chart has the front of all combinations for each scene and backend.

    python benchmarks/equal_error.py --plot equal-error.png
    python benchmarks/equal_error.py --scene city:blocks=4,shadows=1 --backend gl --rounds 9
    python -m renderer convert bazaar bazaar.glb && python benchmarks/equal_error.py --scene bazaar.glb
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any, Final

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import load_scene, save_scene
from renderer.lab.accuracy.choice import CombinationBench, make_plain
from renderer.lab.accuracy.equal_error import Curve, compare_curves
from renderer.lab.accuracy.quality_settings import QUALITY_SETTINGS
from renderer.lab.accuracy.sweep import SweepSetup, find_missing_capability, list_views
from renderer.lab.comparison import Record
from renderer.lab.measure.measurement import Interval
from renderer.settings import RenderSettings

SCALES: Final = (0.5, 1.0, 2.0)
FULL: Final = SCALES.index(1.0)
TECHNIQUES: Final = ("forward", "forward_plus", "clustered", "deferred", "deferred_plus")
QUALITY: Final = ("samples", "fxaa", "texture_filter", "shadow_filter")
SCENES: Final = (
    "city:blocks=2,shadows=1",
    "hall:columns=4,rows=2,shadows=1,lights=8",
    "night:blocks=2,shadows=1,lights=8",
    "bazaar.glb",
    "glass.glb",
)
"""Generated scenes, and two model files, which are written first unless they exist."""


def list_values(device: rhi.Device) -> dict[tuple[str, str], RenderSettings]:
    """The settings of each value, by the names of the setting and the value; defaults first."""
    plain = make_plain(RenderSettings())
    values = {("technique", name): plain.change("technique.name", name) for name in TECHNIQUES}
    for name in QUALITY:
        setting = QUALITY_SETTINGS[name]
        ordered = sorted(setting.values, key=lambda value: value != setting.default)
        values |= {(name, value): plain.change(setting.path, setting.values[value]) for value in ordered}
    return {
        key: settings for key, settings in values.items() if not find_missing_capability(device, settings)
    }


def measure_curves(
    scene_name: str, backend: str, size: tuple[int, int], views: int, rounds: int
) -> dict[tuple[str, str], Curve]:
    """The curve of each value."""
    scene = load_scene(scene_name)
    scene.bloom = None  # rays have none
    setup = SweepSetup(scene_name, backend=backend, size=size, views=views, rounds=rounds, flicker_weight=0.0)
    frames = list_views(scene, setup)
    with (
        rhi.create_device(backend) as device,
        CombinationBench(device, scene, setup, ["samples"]) as bench,
    ):
        combinations = {
            (*key, scale): settings.change("scale", scale)
            for key, settings in list_values(device).items()
            for scale in SCALES
        }
        distinct = list(dict.fromkeys(combinations.values()))  # defaults are the same settings
        errors = {settings: bench.measure_pixels(settings, frames) for settings in distinct}
        seconds: dict[RenderSettings, list[float]] = {settings: [] for settings in distinct}
        for number in range(rounds):
            for settings in distinct:
                renderer = bench.exchange(settings)
                bench.draw(renderer, settings, frames[(number + 1) % len(frames)])
                began = process_time()
                bench.draw(renderer, settings, frames[number % len(frames)])
                seconds[settings].append(process_time() - began)
    return {
        key: Curve(
            np.stack([errors[combinations[*key, scale]] for scale in SCALES], axis=1),
            np.stack([seconds[combinations[*key, scale]] for scale in SCALES], axis=1),
        )
        for key in dict.fromkeys((name, value) for name, value, _ in combinations)
    }


def format_interval(interval: Interval) -> str:
    """A ratio with its interval; "never" if it is infinite."""
    if np.isinf(interval.median):
        return "never"
    high = "∞" if np.isinf(interval.high) else f"{interval.high:.2f}"
    return f"{interval.median:.2f} ({interval.low:.2f} to {high})"


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield a row for each value that isn't the default, and a row for each point of the charts."""
    with TemporaryDirectory() as folder:
        for name in arguments.scene or SCENES:
            path = name
            if name in SCENES and name.endswith(".glb") and not Path(name).exists():
                path = str(Path(folder) / name)
                save_scene(load_scene(Path(name).stem), path)
            for backend in arguments.backend or ("gl", "cl"):
                curves = measure_curves(path, backend, arguments.size, arguments.views, arguments.rounds)
                yield from _list_rows(name, backend, curves)


def _list_rows(scene: str, backend: str, curves: dict[tuple[str, str], Curve]) -> Iterator[Record]:
    defaults: dict[str, tuple[str, Curve]] = {}
    for (setting, value), curve in curves.items():
        default_name, default = defaults.setdefault(setting, (value, curve))
        if curve is not default:
            result = compare_curves(curve, default, FULL)
            yield {
                "scene": scene,
                "backend": backend,
                "setting": setting,
                "value": value,
                "instead of": default_name,
                "time": format_interval(result.time),
                "error": format_interval(result.error),
            }
    for (setting, value), curve in curves.items():
        points = curve.average()
        for scale, error, seconds in zip(SCALES, points.errors, points.seconds, strict=True):
            yield {
                "scene": scene,
                "backend": backend,
                "setting": setting,
                "value": value,
                "scale": scale,
                "levels": round(float(error), 3),
                "milliseconds": round(1e3 * float(seconds), 2),
            }


def plot(figure: Any, rows: Sequence[Record]) -> None:
    """Draw all points of each scene and backend, a colour for each setting, and their front."""
    points = [row for row in rows if "levels" in row]
    scenes, backends = (list(dict.fromkeys(row[key] for row in points)) for key in ("scene", "backend"))
    figure.set_size_inches(3.2 * len(scenes), 2.8 * len(backends))
    axes = figure.subplots(len(backends), len(scenes), squeeze=False)
    settings = list(dict.fromkeys(row["setting"] for row in points))
    for line, backend in zip(axes, backends, strict=True):
        for axis, scene in zip(line, scenes, strict=True):
            own = [row for row in points if (row["scene"], row["backend"]) == (scene, backend)]
            if not own:
                axis.set_visible(False)
                continue
            for number, setting in enumerate(settings):
                selection = [row for row in own if row["setting"] == setting]
                axis.plot(
                    [row["milliseconds"] for row in selection],
                    [row["levels"] for row in selection],
                    "o",
                    ms=4,
                    mec="none",
                    alpha=0.7,
                    color=f"C{number}",
                    label=setting,
                )
            front: list[Record] = []
            for row in sorted(own, key=lambda row: (row["milliseconds"], row["levels"])):
                if not front or row["levels"] < front[-1]["levels"]:
                    front.append(row)
            axis.step(
                [row["milliseconds"] for row in front],
                [row["levels"] for row in front],
                where="post",
                color="0.4",
                lw=1,
                zorder=0,
            )
            axis.set_xscale("log")
            for ticks in (axis.xaxis.set_major_formatter, axis.xaxis.set_minor_formatter):
                ticks("{x:g}")
            axis.set_title(f"{scene.partition(':')[0]}, {backend}", fontsize=9)
            axis.tick_params(labelsize=7, which="both")
    for axis in axes[:, 0]:
        axis.set_ylabel("error in levels", fontsize=8)
    figure.supxlabel("milliseconds of processor time", fontsize=8)
    axes[0, 0].legend(fontsize=6, loc="upper right")


OPTIONS: Final = (
    options.option("--scene", "repeatable", None, "three generated scenes and two models", action="append"),
    options.option("--backend", "repeatable", None, "gl, cl", action="append", choices=rhi.backend_names()),
    options.size((96, 54)),
    options.count("--views", "frames that are compared", 2),
    options.rounds("frames that are timed", 5),
    options.chart("all errors and times"),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure, plot)
