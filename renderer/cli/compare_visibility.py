"""`compare visibility`: print the thesis's tables (chapter 7) for a scene, a camera path and a backend."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from statistics import mean, median
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer.cli.arguments import (
    add_backend,
    add_scene,
    add_settings,
    add_size,
    add_walk,
    load_settings,
    parse_count,
    parse_frame,
)
from renderer.cli.output import draw_chart, note, prepare_image, show_progress
from renderer.cli.subcommand import Parser, Subcommand
from renderer.content import find_path, load_scene
from renderer.measure import format_table, measure_frame
from renderer.renderer import FrameResult, Renderer
from renderer.scene import FRAMES_PER_SECOND, Camera, CameraPath
from renderer.visibility import (
    ALGORITHMS,
    NoCulling,
    VisibilityAlgorithm,
    check_algorithm,
    list_algorithms,
    make_visibility,
)
from renderer.visibility.boxes.cubes import TRIANGLES

_NOTES: Final = """\
  python -m renderer compare visibility city --camera-path ground --frames 60
  python -m renderer compare visibility city --camera-path sky --frames 60 --json
  python -m renderer compare visibility hall --algorithms none,frustum,chc_plus_plus --plot hall.png
  python -m renderer compare visibility city --algorithms none,chc,chc_plus_plus --threshold 10
  python -m renderer compare visibility city --teleport 5

Each frame is first drawn without culling and untimed: this brings the device up to date and makes the image that the
others are compared with. Then every algorithm draws it; each frame starts with another algorithm. The first frame isn't
counted. Times are medians, from the scene's update until the GPU is finished. `ratio` is the median of the frames'
ratios to the first algorithm's time. Counters are means per frame. `triangles` and `draws` include the boxes drawn in
queries, as in the thesis. `wrong pixels` is the largest number, in any frame, of pixels that show something else.
`tied pixels` is the largest number of pixels that show another surface at exactly the same depth: of two such
surfaces the one drawn first stays. `stalled` is how long the CPU waited. Where a scene simulates something,
`simulation steps` counts the steps of what was drawn, and `skipped simulations` what wasn't drawn.
The null device answers no queries. On it `auto` is frustum culling, and algorithms that use queries don't run."""


@dataclass(frozen=True, slots=True)
class AlgorithmRow:
    """The cost of an algorithm in one frame, or in several.

    For several frames, `milliseconds` and `ratio` are medians, `wrong_pixels` and `tied_pixels` maxima, and all else
    means. `wrong_pixels` and `tied_pixels` are None where the device draws nothing.
    """

    algorithm: str
    milliseconds: float
    ratio: float
    triangles: int
    draws: int
    queries: int
    software_state_changes: int
    hardware_state_changes: int
    wrong_pixels: int | None
    tied_pixels: int | None
    stalled_milliseconds: float
    simulation_steps: int
    skipped_simulations: int


@dataclass(frozen=True, eq=False, slots=True)
class Picture:
    """The image of a frame: colour (h, w, 4) and depth (h, w)."""

    color: NDArray[Any]
    depth: NDArray[Any]

    @classmethod
    def of(cls, result: FrameResult) -> Picture:
        """Read the image of a frame whose targets have not been drawn to since."""
        return cls(result.image.read(), result.depth.read().reshape(result.image.size[::-1]))

    def compare(self, other: Picture) -> tuple[int, int]:
        """Count the pixels that differ: those at another depth (wrong), and those that show another surface at
        exactly the same depth (tied)."""
        same = self.depth == other.depth
        differ = (self.color != other.color).any(axis=2)
        return int(np.count_nonzero(differ & ~same)), int(np.count_nonzero(differ & same))


def _add_arguments(parser: Parser) -> None:
    add_scene(parser)
    add_walk(parser, "number of frames to time (default: %(default)s)")
    add_backend(parser)
    parser.add_argument(
        "--algorithms",
        type=_parse_algorithms,
        metavar="A,B,…",
        help=f"some of {', '.join(ALGORITHMS)} (default: all that the device can run)",
    )
    add_settings(parser)
    add_size(parser)
    parser.add_argument(
        "--threshold",
        type=parse_frame,
        metavar="N",
        help="count boxes that pass at most this many samples as hidden (default: the settings', 0)",
    )
    parser.add_argument(
        "--teleport",
        type=parse_count,
        metavar="N",
        help="jump to the other half of the path, or back, after every N frames",
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print the result as JSON")
    form.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    parser.add_argument("--plot", type=Path, metavar="F.png", help="write a chart of times and triangles")


def _run(given: argparse.Namespace) -> None:
    if given.plot is not None:
        prepare_image(given.plot)
    settings = load_settings(given)
    if given.threshold is not None:
        settings = replace(settings, threshold=given.threshold)
    scene = load_scene(given.scene)
    path = find_path(given.camera_path, scene)
    first = max(0, (len(path) - given.frames) // 2) if given.frame is None else given.frame
    path.camera(first + given.frames)  # raises now, not after minutes
    frames = list_frames(first, given.frames, len(path), given.teleport)
    with rhi.create_device(given.backend) as device, Renderer(device, scene, size=given.size) as renderer:
        names = given.algorithms or list_algorithms(device)
        for name in names:
            check_algorithm(name, device, "compare visibility")
        algorithms = {name: make_visibility(name, scene, device, settings) for name in names}
        rows = compare_algorithms(renderer, algorithms, path, frames)
        report = {
            "backend": device.backend_name,
            "device": device.capabilities.device,
            "scene": scene.name,
            "camera_path": given.camera_path,
            "first_frame": first + 1,
            "frames": given.frames,
            "teleport": given.teleport,
            "size": list(given.size),
            "settings": asdict(settings),
            "rows": [asdict(row) for row in rows],
        }
    if given.plot is not None:
        plot_algorithms(rows, f"{scene.name}, {given.camera_path}, {report['device']}", given.plot)
        note(f"wrote {given.plot}")
    print(json.dumps(report) if given.json else show_rows(rows, markdown=given.markdown))


def list_frames(first: int, count: int, length: int, teleport: int | None) -> list[int]:
    """Return the numbers of `first` and the `count` frames after it, of a path of `length` frames.

    With `teleport`, that many frames are followed by as many half a path away, and so on in turn.
    """
    frames = range(first, first + count + 1)
    if teleport is None:
        return list(frames)
    return [
        (frame + length // 2) % length if turn // teleport % 2 else frame for turn, frame in enumerate(frames)
    ]


def compare_algorithms(
    renderer: Renderer, algorithms: dict[str, VisibilityAlgorithm], path: CameraPath, frames: list[int]
) -> list[AlgorithmRow]:
    """Return a row for each of `algorithms` over the `frames` of the path, the first of which isn't counted."""
    scene, device = renderer.scene, renderer.device
    reference = NoCulling(scene)
    draws_pixels = device.capabilities.shading
    names = list(algorithms)
    rows: dict[str, list[AlgorithmRow]] = {name: [] for name in names}
    # Each algorithm has its own simulator, so that none draws what another one has stepped.
    simulators = {name: scene.make_simulator() for name in ("", *names)}
    for turn, frame in enumerate(show_progress(frames, len(frames), "compare")):
        camera, seconds = path.camera(frame), frame / FRAMES_PER_SECOND
        renderer.visibility, renderer.simulator = reference, simulators[""]
        expected = Picture.of(renderer.render(camera, seconds)) if draws_pixels else None
        start = turn % len(names)
        found: dict[str, AlgorithmRow] = {}
        for name in names[start:] + names[:start]:
            renderer.visibility, renderer.simulator = algorithms[name], simulators[name]
            found[name] = _measure_row(name, renderer, camera, seconds, expected)
        if turn:
            base = found[names[0]].milliseconds
            for name, row in found.items():
                rows[name].append(replace(row, ratio=row.milliseconds / base))
        if not draws_pixels:
            device.stream.clear()
    return [_summarize(rows[name]) for name in names]


def _measure_row(
    name: str, renderer: Renderer, camera: Camera, seconds: float, expected: Picture | None
) -> AlgorithmRow:
    """Measure one frame; the algorithm `name` is the renderer's."""
    result, cost = measure_frame(renderer, camera, seconds)
    found, counters = result.visibility, cost.statistics
    assert found is not None
    wrong, tied = (None, None) if expected is None else Picture.of(result).compare(expected)
    return AlgorithmRow(
        algorithm=name,
        milliseconds=cost.milliseconds,
        ratio=1.0,
        triangles=counters.triangles + TRIANGLES * found.boxes,
        draws=counters.draws + found.box_draws,
        queries=counters.queries,
        software_state_changes=counters.software_state_changes,
        hardware_state_changes=counters.hardware_state_changes,
        wrong_pixels=wrong,
        tied_pixels=tied,
        stalled_milliseconds=found.stalled_milliseconds,
        simulation_steps=counters.simulation_steps,
        skipped_simulations=counters.skipped_simulations,
    )


def _summarize(frames: list[AlgorithmRow]) -> AlgorithmRow:
    """Combine the rows of an algorithm's frames into one."""
    found: dict[str, Any] = {}
    for field in fields(AlgorithmRow)[1:]:
        values = [getattr(row, field.name) for row in frames]
        match field.name:
            case "milliseconds" | "ratio":
                found[field.name] = round(median(values), 3)
            case "wrong_pixels" | "tied_pixels":
                found[field.name] = None if None in values else max(values)
            case "stalled_milliseconds":
                found[field.name] = round(float(mean(values)), 3)
            case _:
                found[field.name] = round(mean(values))
    return AlgorithmRow(frames[0].algorithm, **found)


def show_rows(rows: list[AlgorithmRow], *, markdown: bool = False) -> str:
    """Format the rows as a table: aligned text, or Markdown."""
    names = [field.name for field in fields(AlgorithmRow)]
    if not any(row.simulation_steps or row.skipped_simulations for row in rows):
        names = names[:-2]  # nothing is simulated
    header = [name.replace("_", " ").replace("milliseconds", "ms").replace(" changes", "s") for name in names]
    values = [[getattr(row, name) for name in names] for row in rows]
    cells = [["-" if value is None else value for value in row] for row in values]
    return format_table(header, cells, markdown=markdown)


def plot_algorithms(rows: list[AlgorithmRow], title: str, path: Path) -> None:
    """Write a chart of times and triangles, with a bar for each algorithm."""
    with draw_chart(path, title) as figure:
        names = [row.algorithm for row in rows]
        charts: list[tuple[str, list[float], str]] = [
            ("milliseconds a frame", [row.milliseconds for row in rows], "{:,.1f}"),
            ("triangles a frame", [row.triangles for row in rows], "{:,}"),
        ]
        for place, (label, values, form) in enumerate(charts, 1):
            axes = figure.add_subplot(1, len(charts), place)
            bars = axes.barh(names, values, color="#4477aa")
            axes.bar_label(bars, labels=[form.format(value) for value in values], padding=3)
            axes.set_xlabel(label)
            axes.xaxis.set_major_formatter("{x:,.0f}")
            axes.locator_params(axis="x", nbins=5)
            axes.margins(x=0.3)
            axes.invert_yaxis()


def _parse_algorithms(text: str) -> list[str]:
    names = text.split(",")
    for name in names:
        if name not in ALGORITHMS:
            raise argparse.ArgumentTypeError(
                f"{name!r} is not an algorithm; give some of {', '.join(ALGORITHMS)}"
            )
    return list(dict.fromkeys(names))


COMMAND: Final = Subcommand(
    "visibility", "compare visibility algorithms along a camera path", _add_arguments, _run, _NOTES
)
