"""Deferred+ compared with clustered forward shading, with and without culling (Deferred+, Tables 1.1 to 1.4).

All techniques draw the same frames of a walk in turn, each with an algorithm of its own that knows its last
frame. The walk is drawn twice: first for the times of whole frames, then for those of their steps, between
timestamps, for the numbers of objects, and for images that are compared with those of frustum culling.

Processor time is that of all threads, which other programs disturb less than the clock; of a device that
isn't the processor it says nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from statistics import median
from typing import Any, Final

import numpy as np

from renderer.lab.comparison import Column, Frames, Record, Result, Subject, compare, time
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.techniques import Clustered, DeferredPlus, Technique
from renderer.visibility import FrustumCulling, TwoPassCulling, list_visible_objects
from rhi import Device

TECHNIQUES: Final[dict[str, Callable[[], Technique]]] = {
    "deferred+": DeferredPlus,
    "deferred+, multi-pass": lambda: DeferredPlus(multi_pass=True),
    "deferred+, binned": lambda: DeferredPlus(binned=True),
    "clustered forward": Clustered,
    "clustered forward, depth first": lambda: Clustered(depth_first=True),
}
"""The techniques that are compared; the last one is the chapter's."""

STEPS: Final = (
    "depth",
    "light lists",
    "geometry",
    "forward",
    "material ids",
    "rectangles",
    "bins",
    "shading",
    "resolve",
)
"""The passes of all these techniques."""
CULLING_STEPS: Final = ("likely", "missed", "remember")
"""The parts of two-pass culling, each with steps of its own."""

_WARM_UP_FRAMES: Final = 4
"""Frames before the counted ones: light lists grow to their size, and commands are recorded."""


TIMES: Final[dict[str, Column]] = {
    "milliseconds": time(),
    "processor_milliseconds": time(processor=True),
}


def median_step_times(result: Result, name: str) -> dict[str, float]:
    """A column of the median milliseconds of each step."""
    times: dict[str, list[float]] = {}
    for steps in result.counts[name]:
        for step, milliseconds in steps.items():
            times.setdefault(step, []).append(milliseconds)
    return {step: round(median(samples), 3) for step, samples in times.items()}


def compare_deferred_plus(
    device: Device,
    scene: Scene,
    cameras: Sequence[Camera],
    size: tuple[int, int],
    *,
    progress: Callable[[range], Iterable[int]] = lambda rounds: rounds,
) -> dict[str, Any]:
    """Draw a walk with all techniques, with and without culling.

    Returns `rows` with, for each technique with two-pass culling and with frustum culling only, median times
    of frames; `steps`, the median milliseconds of each pass between timestamps, empty on a device without
    them; and `wrong_pixels`: in all frames, those that are not as without culling. And `culling`, means of
    the walk: `instances` are the objects in the view's frustum; `first` those that the first pass draws,
    `second` those that only the second one finds, and `visible` both; `culled` is the percentage of the
    instances that neither draws, `missed` the one that the second pass adds; `steps` as those of rows.

    Args:
        progress: wraps the numbers of cameras, and may show how many are done.
    """
    with ExitStack() as opened:
        drawn = []
        for name, make in TECHNIQUES.items():
            culling = TwoPassCulling(scene, device)
            opened.callback(culling.destroy)
            for algorithm in (culling, FrustumCulling(scene)):
                renderer = Renderer(device, scene, technique=make(), visibility=algorithm, size=size)
                drawn.append(_TechniqueVariant(name, opened.enter_context(renderer), cameras))
        rows = compare(
            [variant.timed for variant in drawn],
            TIMES,
            progress(range(len(cameras))),
            warm_ups=_WARM_UP_FRAMES,
        )
        first_culling, frustum = drawn[0].renderer.visibility, FrustumCulling(scene)
        assert isinstance(first_culling, TwoPassCulling)
        counts: list[tuple[int, int, int]] = []

        def walk() -> Iterator[int]:
            for number in progress(range(len(cameras))):
                yield number
                for culled, other in zip(drawn[::2], drawn[1::2], strict=True):
                    culled.wrong_pixels += int(np.count_nonzero((culled.image != other.image).any(2)))
                in_view = list_visible_objects(frustum, cameras[number].with_aspect(size[0] / size[1]))
                likely, missed = (
                    first_culling.first.read_object_indices(),
                    first_culling.second.read_object_indices(),
                )
                counts.append((len(in_view), len(likely), len(missed)))

        before, device.timing = device.timing, device.capabilities.timestamps
        try:
            columns: dict[str, Column] = {"steps": median_step_times, "culling_steps": median_step_times}
            steps = compare([variant.stepped for variant in drawn], columns, walk(), warm_ups=0)
        finally:
            device.timing = before
    for row, parts, variant in zip(rows, steps, drawn, strict=True):
        row |= {"steps": parts["steps"], "wrong_pixels": variant.wrong_pixels}
    instances, first, second = np.mean(counts, axis=0).tolist()
    share = 100.0 / max(instances, 1.0)
    return {
        "rows": rows,
        "culling": {
            "instances": instances,
            "first": first,
            "second": second,
            "visible": first + second,
            "culled": 100.0 - share * (first + second),
            "missed": share * second,
            "steps": steps[0]["culling_steps"],
        },
    }


class _TechniqueVariant:
    """A technique with a visibility algorithm, drawn twice: `timed` for whole frames, `stepped` for steps and
    images."""

    def __init__(self, name: str, renderer: Renderer, cameras: Sequence[Camera]) -> None:
        self.renderer, self.wrong_pixels = renderer, 0
        self._is_culled = isinstance(renderer.visibility, TwoPassCulling)
        self._draw = Frames(renderer, *cameras)
        labels = {"technique": name, "culling": self._is_culled}
        self.timed = Subject(labels, self._draw)
        self.stepped = Subject(labels, self._draw, count=self._count)

    def _count(self) -> Record:
        """Store the image; return the milliseconds of the passes and of the steps of culling, which lie
        within one pass."""
        device = self.renderer.device
        self.image = self._draw.result.image.read()
        nodes = device.timers if device.timing else []
        parts = [
            part for node in nodes for part in node.children if self._is_culled and part.name in CULLING_STEPS
        ]
        steps = {part.name: part.gpu_milliseconds for part in parts}
        steps |= {
            f"{part.name}: {step.name}": step.gpu_milliseconds for part in parts for step in part.children
        }
        return {"steps": {node.name: node.gpu_milliseconds for node in nodes}, "culling_steps": steps}
