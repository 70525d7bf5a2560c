"""`demo`: measure several variants to render a scene along its paths, and write pictures made by the fastest device."""

from __future__ import annotations

import argparse
import os
from contextlib import ExitStack
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Final

import rhi
from renderer.cli.arguments import add_frames, add_size, open_scene
from renderer.cli.output import name_of, note, prepare_image, show_progress, write_image
from renderer.cli.subcommand import Parser, Subcommand
from renderer.lab.measure import Measurement, alternate, format_table, title_of
from renderer.renderer import FrameResult, FrameStatistics, Renderer
from renderer.scene import FRAME_COUNT, FRAMES_PER_SECOND
from renderer.visibility import make_visibility

_NOTES: Final = """\
  python -m renderer demo
  python -m renderer demo hall --output pictures
  python -m renderer demo city:blocks=12 --frames 20

All backends that work here are compared, or only the one that RHI_BACKEND names; the fastest writes the pictures.
The frames are spread evenly along each path, and each is rendered in all ways in turn. Times are medians, until the
GPU is finished. `vs none` is the median of the frames' ratios to no culling. Counters are means per frame. The null
device records the same commands and draws nothing: its time is that of the CPU."""

_PICTURED = {"ground": 900, "sky": 700}
"""The frame of each path that is written as a picture."""

_ALGORITHMS = ("none", "frustum")
"""The algorithms compared: those that also run on the null device, which answers no queries. `compare visibility`
compares all."""


@dataclass(eq=False, slots=True)
class RenderVariant:
    """One row of the table: a path, an algorithm, and the renderer that draws it; `statistics` are kept by frame."""

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
        """Draw one frame of the path and wait for the device."""
        renderer = self.renderer
        camera = renderer.scene.paths[self.path].camera(frame)
        result = renderer.render(camera, frame / FRAMES_PER_SECOND)
        renderer.device.finish()
        if self.backend == "null":
            renderer.device.stream.clear()
        self.statistics[frame] = result.statistics
        return result

    def mean(self, name: str) -> int:
        """Return the mean of a counter over the frames, rounded."""
        counts: list[int] = [getattr(one, name) for one in self.statistics.values()]
        return round(sum(counts) / len(counts))


def _add_arguments(parser: Parser) -> None:
    parser.add_argument(
        "scene",
        metavar="SCENE",
        nargs="?",
        default="city",
        help="a scene generator (see `scenes`) or a model file (default: city)",
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("out"),
        metavar="DIR",
        help="folder for the pictures (default: out)",
    )
    add_frames(parser, 9, "number of frames of each path")
    add_size(parser, what="size of the images in pixels")


def _run(given: argparse.Namespace) -> None:
    scene = open_scene(given.scene)
    with ExitStack() as stack:
        devices = open_devices(stack)
        variants = [
            RenderVariant(
                path,
                name,
                stack.enter_context(
                    Renderer(device, scene, visibility=make_visibility(name, scene, device), size=given.size)
                ),
            )
            for path in scene.paths
            for device in devices
            for name in _ALGORITHMS
        ]
        times = measure_variants(variants, given.frames)
        table = tabulate(variants, times)  # before the pictures, which are frames of their own
        for path in scene.paths:
            seen = [
                variant
                for variant in variants
                if variant.path == path and variant.renderer.device.capabilities.renders
            ]
            if seen:
                write_picture(min(seen, key=lambda variant: times[variant.name].median), given.output)
        if not any(device.capabilities.renders for device in devices):
            note(f"the {devices[0].backend_name} device records and draws nothing: there is no image")
        print(table)


def open_devices(stack: ExitStack) -> list[rhi.Device]:
    """Open the device that RHI_BACKEND names, or one on each backend that works here; the null device is the last."""
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


def write_picture(variant: RenderVariant, folder: Path) -> None:
    """Write one picture of the variant's path."""
    scene = variant.renderer.scene
    suffix = "" if variant.path == next(iter(scene.paths)) else f"-{variant.path}"
    result = variant.render(_PICTURED.get(variant.path, FRAME_COUNT // 2))
    path = prepare_image(folder / f"{name_of(scene)}{suffix}.png")
    write_image(path, result.image.read())
    note(f"wrote {path}, drawn by {variant.backend}")


def _name(path: str, visibility: str, backend: str) -> str:
    return f"{path}, {visibility}, {backend}"


def measure_variants(variants: list[RenderVariant], count: int) -> dict[str, Measurement]:
    """Measure all variants over `count` frames; return their times by name."""
    frames = [(2 * number + 1) * FRAME_COUNT // (2 * count) for number in range(count)]
    work = {
        variant.name: lambda number, variant=variant: variant.render(frames[number]) for variant in variants
    }
    for variant in variants:
        variant.statistics.clear()
    return alternate(work, show_progress(range(count), count, "measure"))


def tabulate(variants: list[RenderVariant], times: dict[str, Measurement]) -> str:
    """Format the table: times, and the counters of the measured frames."""
    is_simulated = bool(len(variants[0].renderer.simulator))
    counters = [
        counter.name
        for counter in fields(FrameStatistics)
        if is_simulated or counter.name not in ("simulation_steps", "skipped_simulations")
    ]
    rows = []
    for variant in variants:
        time, base = times[variant.name], times[_name(variant.path, "none", variant.backend)]
        rows.append(
            (
                variant.path,
                variant.visibility,
                variant.backend,
                1e3 * time.median,
                time.compare_to(base).median,
                *(variant.mean(counter) for counter in counters),
            )
        )
    titles = [title_of(counter) for counter in counters]
    return format_table(["path", "visibility", "backend", "ms", "vs none", *titles], rows)


COMMAND: Final = Subcommand(
    "demo",
    "render a scene along its paths in several ways and print what each costs",
    _add_arguments,
    _run,
    _NOTES,
)
