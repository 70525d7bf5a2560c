"""`demo`: a table of what each way to render a scene along its paths costs, and pictures by the fastest device."""

from __future__ import annotations

import argparse
import os
from contextlib import ExitStack
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import rhi
from renderer.cli.arguments import add_command, add_size, parse_count
from renderer.cli.output import name_of, note, prepare_image, show_progress, write_image
from renderer.content import load_scene
from renderer.measure import Measurement, alternate, format_table
from renderer.renderer import FrameResult, FrameStatistics, Renderer
from renderer.scene import FRAME_COUNT, FRAMES_PER_SECOND
from renderer.visibility import make_visibility

_EXAMPLES = """\
  python -m renderer demo
  python -m renderer demo hall --output pictures
  python -m renderer demo city:blocks=12 --frames 20

All backends that work here are compared, or the one that RHI_BACKEND names; the fastest makes the pictures.
The frames lie evenly along each path. In turn, each is rendered in all ways; the times are medians until the
GPU is done, `vs none` is the median of the ratios to no culling, and the counters are means per frame. The
null device records the same commands and draws nothing: its time is the CPU's."""

_PICTURED = {"ground": 900, "sky": 700}
"""The frame of a path that is pictured."""

_WAYS = ("none", "frustum")
"""What the null device can tell, too: it has no answers to queries. `compare visibility` compares all."""


@dataclass(eq=False, slots=True)
class Way:
    """One row of the table: a path, and the renderer that draws it; `statistics` are by frame."""

    path: str
    visibility: str
    renderer: Renderer
    statistics: dict[int, FrameStatistics] = field(default_factory=dict)

    @property
    def backend(self) -> str:
        return self.renderer.device.backend_name

    @property
    def name(self) -> str:
        return _name(self.path, self.visibility, self.backend)

    def render(self, frame: int) -> FrameResult:
        """Draw one frame of the path and wait for it."""
        renderer = self.renderer
        camera = renderer.scene.paths[self.path].camera(frame)
        result = renderer.render(camera, frame / FRAMES_PER_SECOND)
        renderer.device.finish()
        if self.backend == "null":
            renderer.device.stream.clear()
        self.statistics[frame] = result.statistics
        return result

    def mean(self, name: str) -> int:
        """The mean of a counter over the frames, in whole numbers."""
        counts: list[int] = [getattr(one, name) for one in self.statistics.values()]
        return round(sum(counts) / len(counts))


def add_to(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "demo",
        run,
        "picture a scene along its paths and print what each way to render it costs",
        _EXAMPLES,
    )
    parser.add_argument(
        "scene",
        metavar="SCENE",
        nargs="?",
        default="city",
        help="a generator or a model file (default: city)",
    )
    parser.add_argument(
        "--output", type=Path, default=Path("out"), metavar="DIR", help="where pictures go (default: out)"
    )
    parser.add_argument(
        "--frames", type=parse_count, default=9, metavar="N", help="frames of each path (default: 9)"
    )
    add_size(parser, what="of the images")


def run(given: argparse.Namespace) -> None:
    """Measure, render the pictures on the device that was fastest, and print the table."""
    scene = load_scene(given.scene)
    with ExitStack() as stack:
        devices = open_devices(stack)
        ways = [
            Way(
                path,
                name,
                stack.enter_context(
                    Renderer(device, scene, visibility=make_visibility(name, scene, device), size=given.size)
                ),
            )
            for path in scene.paths
            for device in devices
            for name in _WAYS
        ]
        times = measure(ways, given.frames)
        table = tabulate(ways, times)  # before the pictures, which are frames of their own
        for path in scene.paths:
            seen = [way for way in ways if way.path == path and way.renderer.device.capabilities.renders]
            if seen:
                write_picture(min(seen, key=lambda way: times[way.name].median), given.output)
        if not any(device.capabilities.renders for device in devices):
            note(f"the {devices[0].backend_name} device records and draws nothing: there is no image")
        print(table)


def open_devices(stack: ExitStack) -> list[rhi.Device]:
    """The device that RHI_BACKEND names, else one on each backend that works here; the null device is the last."""
    chosen = os.environ.get("RHI_BACKEND")
    devices: list[rhi.Device] = []
    errors: list[tuple[str, rhi.RhiError]] = []
    for name in (chosen,) if chosen else rhi.backend_names():
        try:
            devices.append(stack.enter_context(rhi.create_device(name)))
        except rhi.RhiError as error:
            errors.append((name, error))
    if not devices:
        raise errors[0][1]
    for name, reason in errors:
        note(f"{name} is left out: {reason.given or reason.rule.sentence}")
    if all(device.backend_name != "null" for device in devices):
        devices.append(stack.enter_context(rhi.create_device("null")))
    return devices


def write_picture(way: Way, folder: Path) -> None:
    """One picture of the way's path."""
    scene = way.renderer.scene
    suffix = "" if way.path == next(iter(scene.paths)) else f"-{way.path}"
    result = way.render(_PICTURED.get(way.path, FRAME_COUNT // 2))
    path = prepare_image(folder / f"{name_of(scene)}{suffix}.png")
    write_image(path, result.image.read())
    note(f"wrote {path}, drawn by {way.backend}")


def _name(path: str, visibility: str, backend: str) -> str:
    return f"{path}, {visibility}, {backend}"


def measure(ways: list[Way], count: int) -> dict[str, Measurement]:
    """The times of all ways over `count` frames, by the ways' names."""
    frames = [(2 * number + 1) * FRAME_COUNT // (2 * count) for number in range(count)]
    work = {way.name: lambda number, way=way: way.render(frames[number]) for way in ways}
    for way in ways:
        way.statistics.clear()
    return alternate(work, show_progress(range(count), count, "measure"))


def tabulate(ways: list[Way], times: dict[str, Measurement]) -> str:
    """The table: times, and the counters of the frames that were measured."""
    is_simulated = bool(ways[0].renderer.scene.simulated)
    counters = [
        counter.name
        for counter in fields(FrameStatistics)
        if is_simulated or counter.name not in ("simulation_steps", "skipped_simulations")
    ]
    rows = []
    for way in ways:
        time, base = times[way.name], times[_name(way.path, "none", way.backend)]
        rows.append(
            (
                way.path,
                way.visibility,
                way.backend,
                1e3 * time.median,
                time.ratio_to(base),
                *(way.mean(counter) for counter in counters),
            )
        )
    names = [counter.replace("_", " ").replace(" changes", "s") for counter in counters]
    return format_table(["path", "visibility", "backend", "ms", "vs none", *names], rows)
