"""`compare backends`: measure what the same passes of a scene cost on each backend.

  python -m renderer compare backends city --passes depth,lit,textured,queries --size 1280x720
  python -m renderer compare backends city --camera-path sky --passes depth --json
  python -m renderer compare backends hall --passes depth,lit --plot hall.png

All objects are drawn without culling, front to back, with one camera. A round runs a pass once on each
backend; each round starts with another backend. Times are medians over the rounds, from the first command
until the device is finished. `ratio to gl` says how many times as fast as gl a backend is: the median of the
rounds' ratios. `queries` queries up to 1,000 boxes and then reads all results; `waited` reads each result
before it issues the next query. `kernels` says which kernels cl ran in the rounds: a long run has `optimised`
ones, so figures of `quick` ones hold for a first run only; RHI_KERNELS=optimised measures a long run.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from renderer.cli import options
from renderer.cli.arguments import open_scene
from renderer.cli.comparison import ComparisonProgram, Report, repeat
from renderer.cli.output import show_progress
from renderer.content import parse_camera_path
from renderer.lab.comparison import Record
from renderer.lab.comparisons.backend_comparison import compare_backends
from renderer.lab.measure.backend_passes import PASSES

_BASE = "gl"


_OPTIONS: Final = (
    options.SCENE,
    options.names("--passes", PASSES, "is not a pass", ["depth", "lit", "queries"]),
    options.values("--backends", f"backends to compare with {_BASE}", str, ["cl"], "cl", "A,B,…"),
    options.PATH,
    options.frame("frame whose camera is used", None, "the path's middle"),
    options.rounds("rounds of each pass", 15),
    options.size((1280, 720), "size of the targets in pixels"),
    options.chart(),
    *options.form(),
)


def _measure(arguments: argparse.Namespace) -> Report:
    scene = open_scene(arguments.scene)
    path = parse_camera_path(arguments.camera_path, scene)
    arguments.frame = len(path) // 2 if arguments.frame is None else arguments.frame
    backends = [_BASE, *(name for name in arguments.backends if name != _BASE)]

    def rounds(name: str) -> Iterable[int]:
        return show_progress(range(arguments.rounds), name)

    devices: dict[str, str] = {}
    camera = path.camera(arguments.frame)
    rows = list(compare_backends(scene, camera, backends, arguments.passes, arguments.size, rounds, devices))
    triangles = scene.count_triangles(np.arange(len(scene.objects)))
    metadata = {"scene": scene.name, "triangles": triangles} | repeat(
        arguments, "camera_path", "frame", "size", "rounds"
    )
    title = f"{scene.name}, {arguments.camera_path}, {arguments.size[0]}×{arguments.size[1]}"
    return Report(metadata | {"devices": devices}, rows, title, scene)


def plot_backends(figure: Any, rows: Sequence[Record]) -> None:
    """Draw the times: a group of bars for each pass, a bar for each backend."""
    axes = figure.subplots()
    names = list(dict.fromkeys(row["pass"] for row in rows))
    backends = list(dict.fromkeys(row["backend"] for row in rows))
    height = 0.8 / len(backends)
    for backend_index, backend in enumerate(backends):
        backend_rows = [row for row in rows if row["backend"] == backend]
        bars = axes.barh(
            [names.index(row["pass"]) + backend_index * height for row in backend_rows],
            [row["milliseconds"] for row in backend_rows],
            height,
            label=backend,
        )
        axes.bar_label(
            bars, [f" {row['milliseconds']:,.1f} ms, ×{row['ratio_to_gl']:,.1f}" for row in backend_rows]
        )
    axes.set(xlabel="milliseconds", yticks=range(len(names)), yticklabels=names)
    axes.invert_yaxis()
    axes.margins(x=0.2)
    axes.legend()


COMMAND: Final = ComparisonProgram(
    "backends",
    "compare what a scene's passes cost on each backend",
    __doc__,
    _OPTIONS,
    _measure,
    plot=plot_backends,
).command
