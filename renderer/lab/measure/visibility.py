"""Comparison of visibility algorithms along a camera path, as in the thesis's chapter 7.

- A *contender* is an algorithm with its settings, and has a row in the table. All contenders draw the same frames of
  the path, in turn in one process, so disturbances of the machine affect all alike.
- Most algorithms use what earlier frames have shown. So each counted frame follows others of the path that are drawn
  and not counted. Without them a frame far from the last one costs CHC++ three times the queries that it costs on a
  path that is drawn frame by frame.
- Every counted image is compared, pixel by pixel, with the one drawn without culling.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from statistics import mean, median
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lab.measure.frames import measure_frame
from renderer.renderer import FrameResult, Renderer
from renderer.scene import FRAMES_PER_SECOND, Camera, CameraPath
from renderer.visibility import NoCulling, VisibilitySettings, make_visibility
from renderer.visibility.boxes.cubes import TRIANGLES

QUERYING: Final = ("stop_and_wait", "chc", "chc_plus_plus")
"""The algorithms that can use native queries or emulated ones."""

FORGETFUL: Final = ("none", "frustum", "stop_and_wait", "software_depth")
"""The algorithms that draw a frame the same whatever was drawn before."""


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


@dataclass(frozen=True, slots=True)
class Contender:
    """An algorithm to compare, with its settings. `name` is that of its row."""

    name: str
    algorithm: str
    settings: VisibilitySettings


@dataclass(frozen=True, slots=True)
class WalkFrame:
    """A frame of a camera path to draw, and whether it is counted."""

    number: int
    is_counted: bool


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


def list_contenders(
    names: Sequence[str],
    settings: VisibilitySettings,
    tuned: VisibilitySettings | None = None,
    emulated: Sequence[bool] = (False,),
) -> list[Contender]:
    """Return a contender for each of the algorithms `names`, with `settings`.

    Args:
        tuned: other settings, with which CHC++ is compared as well, as `optimized_chc_plus_plus`.
        emulated: the kinds of queries to compare. Of the second one, only algorithms that can use either.
    """
    found = []
    for place, kind in enumerate(emulated):
        mark = " (emulated)" if place else ""
        for name in names if not place else [name for name in names if name in QUERYING]:
            found.append(Contender(name + mark, name, replace(settings, emulated=kind)))
            if tuned is not None and name == "chc_plus_plus":
                found.append(Contender(f"optimized_{name}{mark}", name, replace(tuned, emulated=kind)))
    return found


def list_frames(
    first: int, count: int, length: int, *, stride: int = 1, warm_up: int = 1, teleport: int | None = None
) -> list[WalkFrame]:
    """Return the frames to draw of a path of `length` frames, from the frame `first` on.

    `count` of them are counted, each `stride` frames after the last. Before each, the `warm_up` frames before it are
    drawn, unless they have been. With `teleport`, that many frames are followed by as many half a path away, and so
    on in turn; it needs a stride of 1.
    """
    counted = range(first + warm_up, first + warm_up + count * stride, stride)
    frames: list[WalkFrame] = []
    done = first
    for number in counted:
        frames += [WalkFrame(before, False) for before in range(max(done, number - warm_up), number)]
        frames.append(WalkFrame(number, True))
        done = number + 1
    if teleport is None:
        return frames
    return [
        replace(frame, number=(frame.number + length // 2) % length) if turn // teleport % 2 else frame
        for turn, frame in enumerate(frames)
    ]


def compare_algorithms(
    renderer: Renderer, contenders: Sequence[Contender], path: CameraPath, frames: Iterable[WalkFrame]
) -> list[AlgorithmRow]:
    """Return a row for each contender: its cost in the counted frames of the path, of which there must be one."""
    scene, device = renderer.scene, renderer.device
    reference = NoCulling(scene)
    draws_pixels = device.capabilities.shading
    algorithms = {
        each.name: make_visibility(each.algorithm, scene, device, each.settings) for each in contenders
    }
    names = list(algorithms)
    # What was simulated before must have been for all.
    warmed = [each.name for each in contenders if scene.simulated or each.algorithm not in FORGETFUL]
    rows: dict[str, list[AlgorithmRow]] = {name: [] for name in names}
    # Each algorithm has its own simulator, so that none draws what another one has stepped.
    simulators = {name: scene.make_simulator() for name in ("", *names)}
    for frame in frames:
        camera, seconds = path.camera(frame.number), frame.number / FRAMES_PER_SECOND
        renderer.visibility, renderer.simulator = reference, simulators[""]
        expected = None
        if draws_pixels and frame.is_counted:
            expected = Picture.of(renderer.render(camera, seconds))
        start = len(rows[names[0]]) % len(names)
        found: dict[str, AlgorithmRow] = {}
        for name in names[start:] + names[:start]:
            renderer.visibility, renderer.simulator = algorithms[name], simulators[name]
            if frame.is_counted:
                found[name] = _measure_row(name, renderer, camera, seconds, expected)
            elif name in warmed:
                renderer.render(camera, seconds)
                device.finish()
        for name, row in found.items():
            rows[name].append(replace(row, ratio=row.milliseconds / found[names[0]].milliseconds))
        if not draws_pixels:
            device.stream.clear()
    return [_summarize(rows[name]) for name in names]


def _measure_row(
    name: str, renderer: Renderer, camera: Camera, seconds: float, expected: Picture | None
) -> AlgorithmRow:
    """Measure one frame; the algorithm of the row `name` is the renderer's."""
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
