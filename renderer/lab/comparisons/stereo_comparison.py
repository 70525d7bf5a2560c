"""Compares stereo output: the cost of a frame with one eye and with two, with and without shadows (Russell).

All outputs of one size take turns in one process, frame by frame along a path. So a ratio compares the
same frame in the same round, and disturbances of the machine affect all alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from typing import Final

from renderer import rules
from renderer.lab.comparison import Column, Frames, Record, Subject, average, compare, ratio, time
from renderer.renderer import Renderer
from renderer.scene import CameraPath, Scene, StereoRig
from renderer.stereo import OUTPUTS, SHUTTER, Stereo
from renderer.techniques import Technique
from rhi import Device

MONO: Final = "mono"
"""The row that others are compared with: one eye."""
REPROJECTED: Final = "_reprojected"
"""The suffix of outputs whose right eye's image is reprojected from the left one's."""
FAR_ONCE: Final = "_far_once"
"""The suffix of outputs whose far objects are drawn once for both eyes."""
FAR_ERROR: Final = 0.25
"""The largest error of their parallax, in pixels."""
COLUMNS: Final[dict[str, Column]] = {
    "milliseconds": time(),
    "ratio": ratio(),
    "processor_milliseconds": time(processor=True),
    "processor_ratio": ratio(processor=True),
    "draws": average(1),  # objects, once for each eye
    "maps_drawn": average(1),  # shadow maps
    "calls": average(1),  # draws and dispatches of the device
    "upload_bytes": average(),
}
_WARM_UP_FRAMES: Final = 3  # frames that aren't counted


def list_stereos() -> list[str]:
    """The names of all rows but `MONO`: each output, drawn, and reprojected or with far objects drawn once
    where a frame shows both eyes."""
    both = [name for name in OUTPUTS if name != SHUTTER]
    return [*OUTPUTS, *(f"{name}{suffix}" for suffix in (REPROJECTED, FAR_ONCE) for name in both)]


def make_stereo(name: str, rig: StereoRig) -> Stereo | None:
    """The stereo settings of a row, None for `MONO`."""
    if name == MONO:
        return None
    if name not in list_stereos():
        rules.refuse_name(rules.UNKNOWN_STEREO, f"make_stereo({name!r})", name, [MONO, *list_stereos()])
    output = name.removesuffix(REPROJECTED).removesuffix(FAR_ONCE)
    far_error = FAR_ERROR if name.endswith(FAR_ONCE) else 0.0
    return Stereo(rig, output, is_reprojected=name.endswith(REPROJECTED), far_error=far_error)


def compare_stereo(
    device: Device,
    scenes: Mapping[bool, Scene],
    path: CameraPath,
    rig: StereoRig,
    sizes: Sequence[tuple[int, int]],
    stereos: Sequence[str],
    frames: range,
    technique: Callable[[], Technique],
    progress: Callable[[range], Iterable[int]] = lambda frames: frames,
) -> Iterator[Record]:
    """Yield a row for each size, with and without shadows, for one eye and for each stereo output.

    Args:
        scenes: the scene without shadows (False), with them (True), or both.
        stereos: names of `list_stereos`.
        frames: numbers of frames of the path; the one before them is drawn first.
        technique: makes a technique for each row.
    """
    start = max(frames.start - 1, 0)
    path_frames = [path.path_frame(start + frame) for frame in range(len(frames) + 1)]
    for size in sizes:
        for has_shadows, scene in scenes.items():
            with ExitStack() as opened:
                subjects = []
                for name in [MONO, *stereos]:
                    renderer = opened.enter_context(
                        Renderer(device, scene, technique=technique(), visibility="frustum", size=size)
                    )
                    renderer.stereo = make_stereo(name, rig)
                    way = _StereoFrames(renderer, *path_frames)
                    labels = {"stereo": name, "shadows": has_shadows, "size": size}
                    subjects.append(Subject(labels, way, way.prepare, way.count))
                yield from compare(
                    subjects, COLUMNS, progress(range(1, len(frames) + 1)), warm_ups=_WARM_UP_FRAMES
                )


class _StereoFrames(Frames):
    """The frames of one row, with counters of the latest frame."""

    def prepare(self) -> None:
        self._before = self.renderer.device.statistics

    def count(self) -> Record:
        before, after = self._before, self.renderer.device.statistics
        return {
            "draws": self.result.statistics.draws,
            "maps_drawn": self.renderer.shadows.count("drawn"),
            "calls": after.draws - before.draws + after.dispatches - before.dispatches,
            "upload_bytes": after.upload_bytes - before.upload_bytes,
        }
