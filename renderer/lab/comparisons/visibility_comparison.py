"""Compares visibility algorithms along a camera path, as in the thesis's chapter 7.

- A *contender* is an algorithm with its settings, and has a row in the table. All contenders draw the same
  frames of the path, in turn in one process, so disturbances of the machine affect all alike.
- Most algorithms use what earlier frames have shown. So each counted frame follows others of the path that
  are drawn and not counted. Without them a frame far from the last one costs CHC++ three times the queries
  that it costs on a path that is drawn frame by frame.
- Every counted image is compared, pixel by pixel, with the one drawn without culling.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lab.comparison import Column, Record, Subject, average, compare, max_size, ratio, time
from renderer.renderer import FrameResult, Renderer
from renderer.scene import FRAMES_PER_SECOND, CameraPath, Simulator
from renderer.visibility import NoCulling, VisibilityAlgorithm, VisibilitySettings, make_visibility
from renderer.visibility.boxes.cubes import TRIANGLES

QUERYING: Final = ("stop_and_wait", "chc", "chc_plus_plus")
"""Algorithms that can use native or emulated queries."""

HISTORY_FREE: Final = ("none", "frustum", "stop_and_wait", "software_depth")
"""Algorithms whose frames don't depend on earlier frames."""


COLUMNS: Final[dict[str, Column]] = {
    "milliseconds": time(),
    "ratio": ratio(),
    "triangles": average(),
    "draws": average(),
    "queries": average(),
    "software_state_changes": average(),
    "hardware_state_changes": average(),
    "wrong_pixels": max_size,  # None, like tied pixels, if the device draws nothing
    "tied_pixels": max_size,
    "stalled_milliseconds": average(3),
    "simulation_steps": average(),
    "skipped_simulations": average(),
}


@dataclass(frozen=True, slots=True)
class Contender:
    """An algorithm to compare, with its settings. `name` is its row's."""

    name: str
    algorithm: str
    settings: VisibilitySettings


@dataclass(frozen=True, slots=True)
class ComparedFrame:
    """A frame of a camera path to draw, and whether it is counted."""

    number: int
    is_counted: bool


@dataclass(frozen=True, eq=False, slots=True)
class FrameImage:
    """The image of a frame: colour (h, w, 4) and depth (h, w)."""

    color: NDArray[Any]
    depth: NDArray[Any]

    @classmethod
    def of(cls, result: FrameResult) -> FrameImage:
        """Read the image of a frame. Its targets must not have been drawn to since."""
        return cls(result.image.read(), result.depth.read().reshape(result.image.size[::-1]))

    def compare(self, other: FrameImage) -> tuple[int, int]:
        """Count the pixels that differ: those at another depth (wrong), and those that show another surface
        at exactly the same depth (tied)."""
        same = self.depth == other.depth
        differ = (self.color != other.color).any(axis=2)
        return int(np.count_nonzero(differ & ~same)), int(np.count_nonzero(differ & same))


def list_contenders(
    names: Sequence[str],
    settings: VisibilitySettings,
    tuned: VisibilitySettings | None = None,
    emulated: Sequence[bool] = (False,),
) -> list[Contender]:
    """The contenders: each of the algorithms `names` with `settings`.

    Args:
        tuned: other settings, with which CHC++ is compared as well, as `optimized_chc_plus_plus`.
        emulated: the kinds of queries to compare. The second kind has only the algorithms that can use
            either.
    """
    contenders = []
    for number, kind in enumerate(emulated):
        mark = " (emulated)" if number else ""
        for name in names if not number else [name for name in names if name in QUERYING]:
            contenders.append(Contender(name + mark, name, replace(settings, emulated=kind)))
            if tuned is not None and name == "chc_plus_plus":
                contenders.append(Contender(f"optimized_{name}{mark}", name, replace(tuned, emulated=kind)))
    return contenders


def list_frames(
    first: int, count: int, length: int, *, stride: int = 1, warm_up: int = 1, teleport: int | None = None
) -> list[ComparedFrame]:
    """The frames to draw of a path of `length` frames, starting at frame `first`.

    `count` of them are counted, each `stride` frames after the last. Before each, the `warm_up` frames before
    it are drawn, unless they have been. With `teleport`, that many frames are followed by as many half a path
    away, and so on in turn; it needs a stride of 1.
    """
    counted = range(first + warm_up, first + warm_up + count * stride, stride)
    frames: list[ComparedFrame] = []
    done = first
    for number in counted:
        frames += [ComparedFrame(before, False) for before in range(max(done, number - warm_up), number)]
        frames.append(ComparedFrame(number, True))
        done = number + 1
    if teleport is None:
        return frames
    return [
        replace(frame, number=(frame.number + length // 2) % length) if turn // teleport % 2 else frame
        for turn, frame in enumerate(frames)
    ]


def compare_algorithms(
    renderer: Renderer, contenders: Sequence[Contender], path: CameraPath, frames: Iterable[ComparedFrame]
) -> list[Record]:
    """Measure each contender in the counted frames of the path, at least one, and return its row."""
    walk = _SharedRun(renderer, contenders, path)
    return compare(walk.subjects, COLUMNS, walk.list_counted(frames), warm_ups=0)


class _SharedRun:
    """A walk through a scene that all contenders draw with one renderer.

    `expected` is the image of a frame without culling; None if the device draws nothing.
    """

    expected: FrameImage | None

    def __init__(self, renderer: Renderer, contenders: Sequence[Contender], path: CameraPath) -> None:
        self.renderer, self._path = renderer, path
        scene, device = renderer.scene, renderer.device
        self._reference = _ContenderRun(self, NoCulling(scene), scene.make_simulator())
        self._warmed: list[_ContenderRun] = []
        self.subjects: list[Subject] = []
        for contender in contenders:
            algorithm = make_visibility(contender.algorithm, scene, device, contender.settings)
            # Each has its own simulator, so that no contender's steps change another's frames.
            run = _ContenderRun(self, algorithm, scene.make_simulator())
            self.subjects.append(
                Subject({"algorithm": contender.name}, run.draw, run.prepare, run.count, device)
            )
            if (
                scene.simulated or contender.algorithm not in HISTORY_FREE
            ):  # what was simulated before must have been for all
                self._warmed.append(run)

    def render(self, number: int) -> FrameResult:
        """Draw a frame of the path."""
        return self.renderer.render(self._path.camera(number), number / FRAMES_PER_SECOND)

    def list_counted(self, frames: Iterable[ComparedFrame]) -> Iterator[int]:
        """Yield the numbers of counted frames. Before each, the frames before it are drawn, and then it is
        drawn without culling."""
        draws_pixels = self.renderer.device.capabilities.shading
        for frame in frames:
            if frame.is_counted:
                self._reference.prepare()
                self.expected = FrameImage.of(self.render(frame.number)) if draws_pixels else None
                yield frame.number
            else:
                for run in self._warmed:
                    run.prepare()
                    run.draw(frame.number)


class _ContenderRun:
    """A contender's algorithm and simulator during a walk."""

    _result: FrameResult

    def __init__(self, walk: _SharedRun, algorithm: VisibilityAlgorithm, simulator: Simulator) -> None:
        self._walk, self._algorithm, self._simulator = walk, algorithm, simulator

    def prepare(self) -> None:
        self._walk.renderer.visibility, self._walk.renderer.simulator = self._algorithm, self._simulator

    def draw(self, number: int) -> None:
        self._result = self._walk.render(number)
        self._walk.renderer.device.finish()

    def count(self) -> Record:
        visibility, expected = self._result.visibility, self._walk.expected
        assert visibility is not None
        wrong, tied = (None, None) if expected is None else FrameImage.of(self._result).compare(expected)
        counts = asdict(self._result.statistics)
        return counts | {
            "triangles": counts["triangles"] + TRIANGLES * visibility.boxes,
            "draws": counts["draws"] + visibility.box_draws,
            "wrong_pixels": wrong,
            "tied_pixels": tied,
            "stalled_milliseconds": visibility.stalled_milliseconds,
        }
