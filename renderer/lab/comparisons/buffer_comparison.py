"""Compares layouts of the geometry buffer: the renderer's own, and those that works print (`published_buffers`).

All layouts draw the same frame in turn with one renderer, and are lit by the same lists of lights. Errors are those
against forward shading, which stores nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame import DEPTH_FORMAT
from renderer.inspection.frame_cost import settle
from renderer.lab.comparison import Column, Frames, Record, Subject, compare, ratio, time
from renderer.lab.measure.published_buffers import LAYOUTS, PublishedBuffer
from renderer.renderer import Renderer
from renderer.scene import Camera, PathFrame
from renderer.techniques import ClusteredDeferred, Forward, Technique
from renderer.techniques.parts.geometry_buffer import geometry_buffer_formats

OWN: Final = "own"
"""The layout of the renderer itself: as small as the scene allows."""
COLUMNS: Final[dict[str, Column]] = {
    "milliseconds": time(),
    "ratio": ratio(),
    "processor_milliseconds": time(processor=True),
    "processor_ratio": ratio(processor=True),
}


def compare_buffers(
    renderer: Renderer,
    frame: PathFrame,
    *,
    rounds: int = 5,
    progress: Callable[[range], Iterable[int]] = lambda rounds: rounds,
) -> Iterator[Record]:
    """Yield a row for each layout, the renderer's own first: bytes per pixel, times, and errors in levels of 255."""
    exact = _draw(renderer, Forward(), frame)
    techniques: dict[str, Technique] = {
        OWN: ClusteredDeferred(),
        **{name: PublishedBuffer(name) for name in LAYOUTS},
    }
    subjects = [
        Subject(
            {"layout": name, "source": LAYOUTS[name].source if name in LAYOUTS else "here"},
            Frames(renderer, frame),
            partial(_exchange, renderer, technique, frame),
            summarize=partial(_summarize, renderer, technique, frame, exact),
        )
        for name, technique in techniques.items()
    ]
    yield from compare(subjects, COLUMNS, progress(range(rounds)), warm_ups=2)


def _draw(renderer: Renderer, technique: Technique, frame: PathFrame) -> NDArray[np.int64]:
    renderer.technique = technique
    return np.asarray(renderer.render(frame.camera, frame.seconds).image.read()[..., :3], np.int64)


def _exchange(renderer: Renderer, technique: Technique, frame: PathFrame) -> None:
    renderer.technique = technique
    settle(renderer, frame.camera, frame.seconds)  # what this creates isn't timed
    renderer.device.finish()


def _summarize(
    renderer: Renderer, technique: Technique, frame: PathFrame, exact: NDArray[np.int64]
) -> Record:
    errors = np.abs(_draw(renderer, technique, frame) - exact).max(axis=2)
    return {
        "bytes_per_pixel": count_buffer_bytes(renderer, technique, frame.camera),
        "mean_error": round(float(errors.mean()), 3),
        "max_error": int(errors.max()),
    }


def count_buffer_bytes(renderer: Renderer, technique: Technique, camera: Camera) -> int:
    """The bytes of the geometry buffer for a pixel, with depth, and the sum of light of a published layout."""
    if isinstance(technique, PublishedBuffer):
        return technique.layout.bytes_per_pixel
    effects, _ = renderer.plan(camera)
    formats = (*geometry_buffer_formats(effects).values(), DEPTH_FORMAT)
    return sum(format.texel_bytes for format in formats)
