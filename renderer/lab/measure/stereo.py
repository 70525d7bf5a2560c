"""The benchmark matrix of stereo: what a frame costs with one eye and with two, with and without shadows (Russell).

All ways to draw a frame of one size take turns in one process, frame by frame along a path. So a ratio compares the
same frame in the same round, and disturbances of the machine affect all alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from renderer import rules
from renderer.lab.measure.alternate import alternate
from renderer.renderer import FrameResult, Renderer
from renderer.scene import FRAMES_PER_SECOND, CameraPath, Scene, StereoRig
from renderer.stereo import OUTPUTS, Stereo
from renderer.techniques import Technique
from renderer.visibility import FrustumCulling
from rhi import Device

MONO: Final = "mono"
"""The row that others are compared with: one eye."""
REPROJECTED: Final = "_reprojected"
"""The end of the name of an output whose right picture is made from the left one's."""
_SETTLES: Final = 3  # frames that aren't counted


@dataclass(frozen=True, slots=True)
class StereoRow:
    """The cost of a frame.

    Attributes:
        stereo: `mono`, or how two eyes are shown. shadows: whether lights cast them. size: of the image in pixels.
        milliseconds, processor_milliseconds: median times from the scene's update until the device is finished, by the
            clock and of the processor in all threads.
        ratio, processor_ratio: to mono, medians over the frames.
        draws, maps_drawn: objects drawn for eyes, and shadow maps, means of a frame.
        calls: calls of the device that draw or dispatch. upload_bytes: bytes written to it. Both are means of a frame.
    """

    stereo: str
    shadows: bool
    size: tuple[int, int]
    milliseconds: float
    ratio: float
    processor_milliseconds: float
    processor_ratio: float
    draws: float
    maps_drawn: float
    calls: float
    upload_bytes: int


def list_stereos() -> list[str]:
    """Return the names of all rows but `MONO`: each output, drawn and reprojected."""
    return [*OUTPUTS, *(f"{name}{REPROJECTED}" for name in OUTPUTS)]


def make_stereo(name: str, rig: StereoRig) -> Stereo | None:
    """Return the stereo of a row's name, None for `MONO`."""
    if name == MONO:
        return None
    if name not in list_stereos():
        rules.refuse_name(rules.UNKNOWN_STEREO, f"make_stereo({name!r})", name, [MONO, *list_stereos()])
    return Stereo(rig, name.removesuffix(REPROJECTED), is_reprojected=name.endswith(REPROJECTED))


def compare_stereo(
    device: Device,
    scenes: dict[bool, Scene],
    path: CameraPath,
    rig: StereoRig,
    sizes: Sequence[tuple[int, int]],
    stereos: Sequence[str],
    frames: range,
    technique: Callable[[], Technique],
    progress: Callable[[range], Iterable[int]] = lambda frames: frames,
) -> list[StereoRow]:
    """Return a row for each size, with and without shadows, for one eye and each way to show two.

    Args:
        scenes: the scene without shadows (False), with them (True), or both.
        stereos: names of `list_stereos`. frames: those of the path; the one before them is drawn first.
        technique: makes a technique for each way.
    """
    rows = []
    for size in sizes:
        for has_shadows, scene in scenes.items():
            names = [MONO, *stereos]
            made = {name: _open(device, scene, size, make_stereo(name, rig), technique()) for name in names}
            try:
                rounds = progress(range(1, len(frames) + 1))
                rows += _compare(made, has_shadows, path, max(frames.start - 1, 0), rounds)
            finally:
                for one in made.values():
                    one.destroy()
    return rows


def _open(
    device: Device, scene: Scene, size: tuple[int, int], stereo: Stereo | None, technique: Technique
) -> Renderer:
    renderer = Renderer(device, scene, technique=technique, visibility=FrustumCulling(scene), size=size)
    renderer.stereo = stereo
    return renderer


def _compare(
    made: dict[str, Renderer], has_shadows: bool, path: CameraPath, start: int, rounds: Iterable[int]
) -> list[StereoRow]:
    results: dict[str, list[tuple[int, int, int, int]]] = {name: [] for name in made}

    def work(name: str) -> Callable[[int], None]:
        renderer = made[name]

        def draw(number: int) -> None:
            frame, device = start + number, renderer.device
            before = device.statistics
            result: FrameResult = renderer.render(path.camera(frame), frame / FRAMES_PER_SECOND)
            after = device.statistics
            device.finish()
            calls = after.draws - before.draws + after.dispatches - before.dispatches
            uploads = after.upload_bytes - before.upload_bytes
            results[name].append((result.statistics.draws, renderer.shadows.count("drawn"), calls, uploads))

        return draw

    times = alternate({name: work(name) for name in made}, rounds, _SETTLES)
    mono, rows = times[MONO], []
    for name, time in times.items():
        counts = list(zip(*results[name][_SETTLES:], strict=True))
        draws, maps, calls, uploads = (sum(some) / len(some) for some in counts)
        rows.append(
            StereoRow(
                stereo=name,
                shadows=has_shadows,
                size=made[name].size,
                milliseconds=round(1e3 * time.median, 3),
                ratio=round(time.compare_to(mono).median, 3),
                processor_milliseconds=round(1e3 * time.processor_median, 3),
                processor_ratio=round(time.compare_to(mono, processor=True).median, 3),
                draws=round(draws, 1),
                maps_drawn=round(maps, 1),
                calls=round(calls, 1),
                upload_bytes=round(uploads),
            )
        )
    return rows
