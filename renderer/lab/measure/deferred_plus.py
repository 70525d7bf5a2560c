"""Deferred+ compared with clustered forward shading, with and without culling (Deferred+, Tables 1.1 to 1.4).

All techniques draw the same frames of a walk in turn, each with an algorithm of its own that knows its last frame. The
walk is drawn twice: first for the times of whole frames, then for those of their steps, between timestamps, for the
numbers of objects, and for pictures that are compared with those of frustum culling.

Processor time is that of all threads, which other programs disturb less than the clock; of a device that isn't the
processor it says nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Final

import numpy as np

from renderer.lab.measure.alternate import alternate
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Rows
from renderer.techniques import Clustered, DeferredPlus, Technique
from renderer.visibility import FrustumCulling, TwoPassCulling, find_visible_objects
from rhi import Device, TimerNode

TECHNIQUES: Final[dict[str, Callable[[], Technique]]] = {
    "deferred+": DeferredPlus,
    "deferred+, multi-pass": lambda: DeferredPlus(multi_pass=True),
    "clustered forward": Clustered,
    "clustered forward, depth first": lambda: Clustered(depth_first=True),
}
"""The techniques that are compared; the last one is the chapter's."""

STEPS: Final = ("depth", "light lists", "geometry", "forward", "material ids", "rectangles", "shading")
"""The passes of all of them."""
CULLING_STEPS: Final = ("likely", "missed", "remember")
"""The parts of two-pass culling, each with steps of its own."""

Key = tuple[str, bool]
"""The name of a technique, and whether objects are culled."""

_SETTLES: Final = 4
"""Frames before those that count: lists of lights learn how much room they need, and commands are recorded."""


@dataclass(frozen=True, slots=True)
class StepsRow:
    """The cost of a frame of one technique, with two-pass culling or with frustum culling only: medians of a walk.

    Attributes:
        milliseconds: from the scene's update until the device is finished. processor_milliseconds: likewise, processor
            time of all threads.
        steps: by pass, the device's time between timestamps in milliseconds; empty on a device without them.
        wrong_pixels: in all frames, pixels that are not those of the same technique without culling.
    """

    technique: str
    culling: bool
    milliseconds: float
    processor_milliseconds: float
    steps: dict[str, float]
    wrong_pixels: int


@dataclass(frozen=True, slots=True)
class CullingRow:
    """What two-pass culling draws of the objects, and what it costs: means of a walk.

    Attributes:
        instances: those in the view's frustum.
        first, second: those that the first pass draws, and those that only the second pass finds. visible: both.
        culled: percentage of the instances that neither draws. missed: percentage that the second pass adds.
        steps: by step, the device's median time in milliseconds.
    """

    instances: float
    first: float
    second: float
    visible: float
    culled: float
    missed: float
    steps: dict[str, float]


@dataclass(frozen=True, slots=True)
class DeferredPlusReport:
    """All that is compared."""

    rows: list[StepsRow]
    culling: CullingRow


def compare_deferred_plus(
    device: Device,
    scene: Scene,
    cameras: Sequence[Camera],
    size: tuple[int, int],
    *,
    progress: Callable[[int], Iterable[int]] = range,
) -> DeferredPlusReport:
    """Draw a walk with all techniques, with and without culling.

    Args:
        progress: returns the numbers below one, and may show how many are done.
    """
    with ExitStack() as made:
        renderers: dict[Key, Renderer] = {}
        culling: dict[str, TwoPassCulling] = {}
        for name, make in TECHNIQUES.items():
            culling[name] = TwoPassCulling(scene, device)
            made.callback(culling[name].destroy)
            for is_culled, algorithm in ((True, culling[name]), (False, FrustumCulling(scene))):
                renderer = Renderer(device, scene, technique=make(), visibility=algorithm, size=size)
                renderers[name, is_culled] = made.enter_context(renderer)
        work = {str(key): partial(_draw, renderer, cameras) for key, renderer in renderers.items()}
        times = alternate(work, progress(len(cameras)), _SETTLES)
        walk = _walk(device, renderers, culling["deferred+"], cameras, progress)
        in_view = [len(find_visible_rows(scene, camera, size)) for camera in cameras]
    rows = []
    for key in renderers:
        time = times[str(key)]
        milliseconds, processor = 1e3 * time.median, 1e3 * time.processor_median
        rows.append(StepsRow(*key, milliseconds, processor, _find_medians(walk.steps[key]), walk.wrong[key]))
    first, second, instances = (float(np.mean(some)) for some in (walk.first, walk.second, in_view))
    steps = _find_medians(walk.culling)
    visible = first + second
    share = 100.0 / max(instances, 1.0)
    return DeferredPlusReport(
        rows,
        CullingRow(instances, first, second, visible, 100.0 - share * visible, share * second, steps),
    )


@dataclass
class _WalkFindings:
    """What was found in all frames: milliseconds of steps, numbers of objects, and wrong pixels."""

    steps: dict[Key, dict[str, list[float]]]
    culling: dict[str, list[float]]
    wrong: dict[Key, int]
    first: list[int]
    second: list[int]


def _draw(renderer: Renderer, cameras: Sequence[Camera], number: int) -> None:
    renderer.render(cameras[number])
    renderer.device.finish()


def _walk(
    device: Device,
    renderers: dict[Key, Renderer],
    culling: TwoPassCulling,
    cameras: Sequence[Camera],
    progress: Callable[[int], Iterable[int]],
) -> _WalkFindings:
    walk = _WalkFindings({key: {} for key in renderers}, {}, dict.fromkeys(renderers, 0), [], [])
    before, device.timing = device.timing, device.capabilities.timestamps
    try:
        for number in progress(len(cameras)):
            images = {}
            for key, renderer in renderers.items():
                result = renderer.render(cameras[number])
                device.finish()
                for node in device.timers if device.timing else []:
                    walk.steps[key].setdefault(node.name, []).append(node.gpu_milliseconds)
                    if renderer.visibility is culling:
                        _add_culling(walk.culling, node)
                images[key] = result.image.read()
            for name, is_culled in renderers:
                if is_culled:
                    off = (images[name, True] != images[name, False]).any(2)
                    walk.wrong[name, True] += int(np.count_nonzero(off))
            walk.first.append(len(culling.first.read_rows()))
            walk.second.append(len(culling.second.read_rows()))
    finally:
        device.timing = before
    return walk


def _add_culling(steps: dict[str, list[float]], node: TimerNode) -> None:
    """Add the times of the steps of culling, which are in the pass that finds the objects."""
    for part in node.children:
        if part.name in CULLING_STEPS:
            steps.setdefault(part.name, []).append(part.gpu_milliseconds)
            for step in part.children:
                steps.setdefault(f"{part.name}: {step.name}", []).append(step.gpu_milliseconds)


def _find_medians(steps: dict[str, list[float]]) -> dict[str, float]:
    return {name: round(median(some), 3) for name, some in steps.items()}


def find_visible_rows(scene: Scene, camera: Camera, size: tuple[int, int]) -> Rows:
    """Return the rows of the objects whose bounds are not outside the view."""
    return find_visible_objects(FrustumCulling(scene), camera.with_aspect(size[0] / size[1]))
