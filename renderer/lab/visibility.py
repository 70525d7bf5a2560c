"""Comparison of visibility algorithms along a camera path, as in the thesis's chapter 7.

- A *contender* is an algorithm with its settings, and has a row in the table. All contenders draw the same frames of
  the path, in turn in one process, so disturbances of the machine affect all alike.
- Most algorithms use what earlier frames have shown. So each counted frame follows others of the path that are drawn
  and not counted. Without them a frame far from the last one costs CHC++ three times the queries that it costs on a
  path that is drawn frame by frame.
- Every counted image is compared, pixel by pixel, with the one drawn without culling.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lab.comparison import Column, Record, Subject, average, compare, largest, ratio, time
from renderer.renderer import FrameResult, Renderer
from renderer.scene import FRAMES_PER_SECOND, CameraPath, Simulator
from renderer.visibility import NoCulling, VisibilityAlgorithm, VisibilitySettings, make_visibility
from renderer.visibility.boxes.cubes import TRIANGLES

QUERYING: Final = ("stop_and_wait", "chc", "chc_plus_plus")
"""The algorithms that can use native queries or emulated ones."""

FORGETFUL: Final = ("none", "frustum", "stop_and_wait", "software_depth")
"""The algorithms that draw a frame the same whatever was drawn before."""


COLUMNS: Final[dict[str, Column]] = {
    "milliseconds": time(),
    "ratio": ratio(),
    "triangles": average(),
    "draws": average(),
    "queries": average(),
    "software_state_changes": average(),
    "hardware_state_changes": average(),
    "wrong_pixels": largest,  # and tied ones: None where the device draws nothing
    "tied_pixels": largest,
    "stalled_milliseconds": average(3),
    "simulation_steps": average(),
    "skipped_simulations": average(),
}


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
) -> list[Record]:
    """Return a row for each contender: its cost in the counted frames of the path, of which there must be one."""
    walk = _SharedWalk(renderer, contenders, path)
    return compare(walk.subjects, COLUMNS, walk.list_counted(frames), warm_ups=0)


class _SharedWalk:
    """A walk through a scene, which all contenders draw with one renderer.

    `expected` is the picture of a frame without culling; None where the device draws nothing.
    """

    expected: Picture | None

    def __init__(self, renderer: Renderer, contenders: Sequence[Contender], path: CameraPath) -> None:
        self.renderer, self._path = renderer, path
        scene, device = renderer.scene, renderer.device
        self._reference = _Walker(self, NoCulling(scene), scene.make_simulator())
        self._warmed: list[_Walker] = []
        self.subjects: list[Subject] = []
        for each in contenders:
            algorithm = make_visibility(each.algorithm, scene, device, each.settings)
            # Each has its own simulator, so that none draws what another one has stepped.
            one = _Walker(self, algorithm, scene.make_simulator())
            self.subjects.append(Subject({"algorithm": each.name}, one.draw, one.prepare, one.count, device))
            if scene.simulated or each.algorithm not in FORGETFUL:  # what was simulated before must have been for all
                self._warmed.append(one)

    def render(self, number: int) -> FrameResult:
        """Draw a frame of the path."""
        return self.renderer.render(self._path.camera(number), number / FRAMES_PER_SECOND)

    def list_counted(self, frames: Iterable[WalkFrame]) -> Iterator[int]:
        """Yield the numbers of counted frames: each after those before it were drawn, and itself without culling."""
        draws_pixels = self.renderer.device.capabilities.shading
        for frame in frames:
            if frame.is_counted:
                self._reference.prepare()
                self.expected = Picture.of(self.render(frame.number)) if draws_pixels else None
                yield frame.number
            else:
                for one in self._warmed:
                    one.prepare()
                    one.draw(frame.number)


class _Walker:
    """An algorithm and its simulator in a walk."""

    _result: FrameResult

    def __init__(self, walk: _SharedWalk, algorithm: VisibilityAlgorithm, simulator: Simulator) -> None:
        self._walk, self._algorithm, self._simulator = walk, algorithm, simulator

    def prepare(self) -> None:
        self._walk.renderer.visibility, self._walk.renderer.simulator = self._algorithm, self._simulator

    def draw(self, number: int) -> None:
        self._result = self._walk.render(number)
        self._walk.renderer.device.finish()

    def count(self) -> Record:
        found, expected = self._result.visibility, self._walk.expected
        assert found is not None
        wrong, tied = (None, None) if expected is None else Picture.of(self._result).compare(expected)
        counts = asdict(self._result.statistics)
        return counts | {
            "triangles": counts["triangles"] + TRIANGLES * found.boxes,
            "draws": counts["draws"] + found.box_draws,
            "wrong_pixels": wrong,
            "tied_pixels": tied,
            "stalled_milliseconds": found.stalled_milliseconds,
        }
