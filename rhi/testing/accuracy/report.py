"""`python -m rhi shading accuracy`: the error and the time of each built-in on each backend of this machine.

- Each built-in is called on the same sample (`rhi.testing.accuracy.probes`, and `sample_probes` for textures)
  and compared with float64.
- Its time is the difference between a kernel that calls it many times and a kernel that only reads the same
  arguments. The two alternate and the shortest run of each counts, since other load on the machine would
  exceed a difference this small. The result is the time of a call with all cores busy; it is close to 0 for
  functions whose cost is hidden by reading the arguments.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi
from rhi.device.device import Device
from rhi.device.resources.programs import Program
from rhi.errors import RhiError
from rhi.shading import Precision
from rhi.shading.language.builtins import BUILTINS
from rhi.testing.accuracy.probes import (
    PASSES,
    WORK_GROUP,
    BoundName,
    Probe,
    all_probes,
    count_units,
    worst_units,
)
from rhi.testing.accuracy.sample_probes import ITERATIONS, SAMPLE_PROBES, SHADERS, SampleProbe

Array = NDArray[Any]

SAMPLES: Final = 1 << 16
REPEATS: Final = 15
MIN_NANOSECONDS: Final = 0.01
_BOUNDS: Final[dict[tuple[str, Precision], BoundName]] = {
    ("gl", Precision.EXACT): "glsl",
    ("cl", Precision.EXACT): "exact",
    ("cl", Precision.FAST): "fast",
    ("numpy", Precision.EXACT): "numpy",
}


@dataclass(frozen=True)
class BuiltinAccuracy:
    """The error and the time of a built-in or operator on a backend.

    Attributes:
        precision: "exact" or "fast" where a shader can choose, else "".
        median_ulp, max_ulp: errors over the sample in units of `rhi.testing.accuracy.probes.count_units`; of
            2^-23 for samples of textures.
        bound_ulp: the error bound that the table of built-ins states.
        is_within_bound: whether the whole sample is within the bound, including OpenGL's absolute bounds.
        worst_input: the arguments whose error is `max_ulp`.
        nanoseconds: the time of a call with all cores busy.
    """

    builtin: str
    backend: str
    precision: str
    median_ulp: float
    max_ulp: float
    bound_ulp: float
    is_within_bound: bool
    worst_input: list[float]
    nanoseconds: float


def measure(
    names: Sequence[str] = (), backends: Sequence[str] = ("gl", "cl", "numpy")
) -> Iterator[BuiltinAccuracy]:
    """Measure the named built-ins and operators, by default all that aren't exact everywhere.

    Backends that don't work on this machine are left out, with a message.
    """
    probes: list[Probe | SampleProbe] = []
    probes += [probe for probe in all_probes() if (probe.name in names if names else _is_inexact(probe))]
    probes += [probe for probe in SAMPLE_PROBES if probe.name in names or not names]
    for backend in backends:
        if backend == "numpy":
            yield from (_accuracy_of(probe, backend, Precision.EXACT, *_on_numpy(probe)) for probe in probes)
            continue
        try:
            device = rhi.create_device(backend)
        except RhiError as error:
            print(f"{backend}: {error.rule.sentence}", file=sys.stderr)
            continue
        with device:
            for probe in probes:
                for precision in Precision:
                    if (backend, precision) in _BOUNDS:
                        yield _accuracy_of(probe, backend, precision, *_on_device(device, probe, precision))


def _is_inexact(probe: Probe) -> bool:
    error = probe.error
    return max(error.glsl, error.exact, error.fast, error.numpy) > 0 and all(
        kind.name == "float" for kind in probe.kinds
    )


def _accuracy_of(
    probe: Probe | SampleProbe,
    backend: str,
    precision: Precision,
    inputs: Array,
    results: Array,
    seconds: float,
) -> BuiltinAccuracy:
    name = _BOUNDS[backend, precision]
    bound = getattr(probe.error, name)
    if isinstance(probe, SampleProbe):
        units = probe.count_units(inputs, results)
        is_within_bound, columns = units <= bound, [inputs[:, :3]]
    else:
        units = count_units(probe, inputs, results).max(axis=1)
        is_within_bound, columns = (
            worst_units(probe, inputs, results, name) <= bound,
            list(probe.columns(inputs).values()),
        )
    worst = int(units.argmax())
    return BuiltinAccuracy(
        str(probe),
        backend,
        precision.value if backend == "cl" else "",
        float(np.median(units)),
        float(units[worst]),
        float(bound),
        bool(is_within_bound.all()),
        [float(number) for column in columns for number in np.ravel(column[worst])],
        1e9 * max(seconds, 0.0) / SAMPLES,
    )


# -- backends ----------------------------------------------------------------------------------------------


def _on_numpy(probe: Probe | SampleProbe) -> tuple[Array, Array, float]:
    inputs = probe.sample(SAMPLES)
    (seconds,) = _shortest_times([lambda: probe.evaluate(inputs, np.float32)])
    return inputs, probe.evaluate(inputs, np.float32), seconds


def _on_device(
    device: Device, probe: Probe | SampleProbe, precision: Precision
) -> tuple[Array, Array, float]:
    if isinstance(probe, SampleProbe):
        return _sample_on_device(device, probe, precision)
    inputs = probe.sample(SAMPLES)
    uint: Any = rhi.shading.uint
    buffer = device.storage(uint, inputs.ravel())
    size = probe.evaluate(inputs[:1], np.float32).shape[1]
    results = device.storage(uint, SAMPLES * size)
    once: Program[...] = device.program(probe.shader("Single", precision))
    device.dispatch(once, SAMPLES // WORK_GROUP, inputs=buffer, results=results)
    words = results.read().reshape(SAMPLES, size)
    sums = device.storage(uint, SAMPLES // ITERATIONS)
    runs = []
    for variant in ("Repeated", "Baseline"):
        program: Program[...] = device.program(probe.shader(variant, precision))

        def run(program: Program[...] = program) -> None:
            device.dispatch(program, SAMPLES // ITERATIONS // WORK_GROUP, inputs=buffer, results=sums)
            device.finish()

        runs.append(run)
    often, idle = _shortest_times(runs)
    return inputs, probe.numbers(words), (often - idle) / PASSES


def _sample_on_device(device: Device, probe: SampleProbe, precision: Precision) -> tuple[Array, Array, float]:
    inputs = probe.sample(SAMPLES)
    levels = probe.texture.levels
    four = rhi.shading.vec4
    height, width = levels[0].shape[1:3]
    with (
        device.texture((width, height), probe.format, levels=len(levels)) as image,
        device.storage(four, inputs) as coordinates,
        device.storage(four, SAMPLES) as results,
    ):
        for level, texels in enumerate(levels):
            image.write(texels, level)
        programs: list[Program[...]] = [device.program(shader) for shader in SHADERS[precision]]
        once, often, idle = programs
        device.dispatch(once, SAMPLES // WORK_GROUP, image=image, coordinates=coordinates, results=results)
        once_results = results.read()

        def run(program: Program[...]) -> None:
            device.dispatch(
                program,
                SAMPLES // ITERATIONS // WORK_GROUP,
                image=image,
                coordinates=coordinates,
                results=results,
            )
            device.finish()

        sampled, read = _shortest_times([partial(run, often), partial(run, idle)])
    return inputs, once_results, sampled - read


def _shortest_times(runs: Sequence[Callable[[], object]]) -> list[float]:
    """Return the shortest time of each function in seconds; they alternate, and the first run, a build, is
    dropped."""
    times: list[list[float]] = [[] for _ in runs]
    for _ in range(REPEATS + 1):
        for run, seconds in zip(runs, times, strict=True):
            started = time.perf_counter()
            run()
            seconds.append(time.perf_counter() - started)
    return [min(seconds[1:]) for seconds in times]


# -- output ------------------------------------------------------------------------------------------------


def write_table(rows: Sequence[BuiltinAccuracy]) -> str:
    """Format measurements as a table in Markdown."""
    lines = ["| | backend | median ulp | max ulp | stated | worst at | ns |", "|---|---|---|---|---|---|---|"]
    for row in rows:
        worst = ", ".join(f"{number:.6g}" for number in row.worst_input[:4]) + (
            " …" if len(row.worst_input) > 4 else ""
        )
        backend = f"{row.backend} {row.precision}".strip()
        mark = "" if row.is_within_bound else " **broken**"
        lines.append(
            f"| `{row.builtin}` | {backend} | {row.median_ulp:.2g} | {row.max_ulp:.3g} | "
            f"{row.bound_ulp:g}{mark} "
            f"| {worst} | {row.nanoseconds:.2f} |"
        )
    return "\n".join(lines)


def plot(rows: Sequence[BuiltinAccuracy], path: str | Path) -> None:
    """Plot error against time of the built-ins that have a FAST form, a point per measurement; needs
    matplotlib.

    An arrow leads from the EXACT to the FAST form of a built-in on OpenCL.
    """
    from matplotlib.figure import Figure

    fast_names = {name for name, row in BUILTINS.items() if row.fast}
    plotted = [row for row in rows if row.builtin.partition("(")[0] in fast_names] or list(rows)
    figure = Figure(figsize=(10, 6.5), layout="constrained")
    axes: Any = figure.add_subplot()
    styles = {
        ("numpy", ""): ("0.6", "x", "NumPy, float32"),
        ("gl", ""): ("tab:green", "s", "OpenGL"),
        ("cl", "exact"): ("tab:blue", "o", "OpenCL, EXACT"),
        ("cl", "fast"): ("tab:red", "o", "OpenCL, FAST"),
    }

    def point(row: BuiltinAccuracy) -> tuple[float, float]:
        return max(row.nanoseconds, MIN_NANOSECONDS), max(row.max_ulp, 0.1)

    for number, name in enumerate(dict.fromkeys(row.builtin for row in plotted)):
        points = {(row.backend, row.precision): point(row) for row in plotted if row.builtin == name}
        if ("cl", "exact") in points and ("cl", "fast") in points:
            arrow = {"arrowstyle": "->", "color": "0.6", "shrinkA": 5, "shrinkB": 5}
            axes.annotate("", points["cl", "fast"], points["cl", "exact"], arrowprops=arrow, zorder=2)
        for at in points.values():
            text, offset = name.partition("(")[0], (5, -9 if number % 2 else 4)
            axes.annotate(text, at, offset, textcoords="offset points", fontsize=7, color="0.3")
    for key, (color, marker, label) in styles.items():
        drawn = [point(row) for row in plotted if (row.backend, row.precision) == key]
        if drawn:
            axes.scatter(*zip(*drawn, strict=True), s=30, color=color, marker=marker, label=label, zorder=3)
    axes.set(xscale="log", yscale="log", ylabel="greatest error, units in the last place")
    hidden = f"{MIN_NANOSECONDS} and less: hidden behind reading the arguments"
    axes.set_xlabel(f"nanoseconds a call, all cores ({hidden})")
    axes.grid(True, which="major", alpha=0.3)
    axes.legend(loc="upper right")
    figure.savefig(path, dpi=110)


def main(arguments: Sequence[str]) -> int:
    """Run `python -m rhi shading accuracy …`; returns 1 if an error exceeds its stated bound."""
    parser = argparse.ArgumentParser(
        prog="python -m rhi shading",
        epilog="examples:\n  python -m rhi shading accuracy --builtin pow --builtin exp\n"
        "  python -m rhi shading accuracy --json --plot accuracy.png",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    accuracy = commands.add_parser("accuracy", help="the error and the time of each built-in on each backend")
    accuracy.add_argument("--json", action="store_true", help="print one JSON object")
    accuracy.add_argument("--plot", metavar="F.png", help="draw error against time")
    accuracy.add_argument(
        "--builtin", action="append", default=[], metavar="NAME", help="only this built-in; repeatable"
    )
    accuracy.add_argument(
        "--backend",
        action="append",
        default=[],
        choices=("gl", "cl", "numpy"),
        help="only this backend; repeatable",
    )
    options = parser.parse_args(arguments)
    rows = []
    for row in measure(options.builtin, options.backend or ("gl", "cl", "numpy")):
        rows.append(row)
        print(f"\r{row.backend:<6} {row.builtin:<40}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    if not rows:
        print("error: no such built-in, or no backend", file=sys.stderr)
        return 2
    if options.plot:
        plot(rows, options.plot)
    if options.json:
        print(json.dumps({"rows": [dataclasses.asdict(row) for row in rows]}, indent=2))
    else:
        print(write_table(rows))
    return 0 if all(row.is_within_bound for row in rows) else 1
