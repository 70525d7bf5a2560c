"""The overlay: frame times, counters, the timer tree and the walk of the culling, drawn over each frame.

Its own cost is part of what it shows: as an event of the timer tree, and as the foot of each bar of the
graph. The counters are those of the frame before the overlay is drawn. Nothing waits for the device: times
are those of the latest frame whose timestamps are available, and what only the device knows isn't shown.

Over a small image there is only what takes a quarter of it: times and counters.
"""

from __future__ import annotations

from time import perf_counter
from typing import Final

from renderer.frame import Frame, ScreenLayer
from renderer.frame.layer import ClearColor
from renderer.layers.canvas import Canvas, Font
from renderer.layers.overlay.history import History
from renderer.layers.overlay.panels import (
    MAX_EVENTS,
    PANEL,
    TEXT,
    Rectangle,
    compute_ground_bounds,
    draw_graph,
    draw_legend,
    draw_map,
    draw_objects,
    draw_timers,
    list_events,
)
from renderer.scene import Scene
from renderer.scene.arrays import Floats
from renderer.visibility import AutoCulling, VisibilityAlgorithm, compute_traversal
from rhi import Device, Statistics, Texture

_FRAMES: Final = 144  # of the graph
_BAR: Final = 2  # width of a frame there
_PAD: Final = 8  # around panels and in them
_GRAPH: Final = 60  # height
_NAMES: Final = 130  # width of the names of counters
_EVENTS: Final = 90  # width of the names of events
_MAP: Final = 280  # width and height
_SMALL: Final = (900, 500)  # images that aren't wider and higher than this have times and counters alone
_MEMORY_FRAMES: Final = 30
_COUNTERS: Final = (
    "draws",
    "queries",
    "upload_bytes",
    "creations",
    "software_state_changes",
    "hardware_state_changes",
)


class Overlay(ScreenLayer):
    """A layer that shows what frames cost. It turns on the device's timing where there are timestamps.

    Attributes:
        draws: the number of draws of the latest frame's overlay.
        milliseconds: what it cost the CPU.
    """

    def __init__(
        self, device: Device, *, scale: int = 1, font: Font | None = None, is_timed: bool = True
    ) -> None:
        """
        Args:
            scale: the number of pixels of each texel of the text, in both directions.
            is_timed: whether to show times, and counters that depend on earlier frames. Without them the
                overlay follows from the frame alone, as films need it.
        """
        self._canvas = Canvas(device, font or Font.load())
        self._scale = scale
        self._frames, self._own = History(_FRAMES), History(_FRAMES)
        self._began: float | None = None
        self._ground: tuple[Scene, tuple[Floats, Floats]] | None = None
        self._before: Statistics = device.statistics
        self._counted = self._after = self._before
        self.draws = 0
        self.milliseconds = 0.0
        self._memory = ("memory", "")
        self._memory_frames = 0  # until it is asked for again, which takes a microsecond a resource
        self._is_timed = is_timed
        self._device, self._was_timing = device, device.timing
        if is_timed and device.capabilities.timestamps:
            device.timing = True

    def draw(self, device: Device, frame: Frame, image: Texture, clear: ClearColor | None = None) -> None:
        """Draw the overlay of a frame. With two eyes, it is about the left one's."""
        began = perf_counter()
        self._begin_frame(began, device.statistics)
        with device.event("overlay"):
            is_small = any(side <= self._scale * most for side, most in zip(image.size, _SMALL, strict=True))
            self._add_left(device, frame, is_small)
            if frame.statistics is not None and not is_small:
                self._add_right(frame, image.size[0])
            with device.render_pass(image, clear=clear):
                self.draws = self._canvas.draw(image.size)
        self._after = device.statistics
        self.milliseconds = 1e3 * (perf_counter() - began)

    def _begin_frame(self, began: float, counted: Statistics) -> None:
        """Record the last frame's time, and the counters as they stand before this frame."""
        if self._began is not None:
            self._frames.add(1e3 * (began - self._began))
            self._own.add(self.milliseconds)
        self._began, self._before, self._counted = began, self._after, counted

    def destroy(self) -> None:
        """Destroy the resources on the device, and stop its timing if the overlay has begun it."""
        self._canvas.destroy()
        if not self._was_timing and self._device.timing:
            self._device.timing = False

    def _add_left(self, device: Device, frame: Frame, is_small: bool) -> None:
        """Add the panel of times and counters; if it isn't small, with the graph and the timers."""
        canvas, scale = self._canvas, self._scale
        counters = {name: getattr(self._counted, name) - getattr(self._before, name) for name in _COUNTERS}
        rows = _list_counters(frame, counters if self._is_timed else None)
        is_small = is_small or not self._is_timed
        if not is_small:
            rows.append(self._list_memory(device))
        timers = [] if is_small else device.timers
        line, pad = canvas.font.line_height * scale, _PAD * scale
        events = min(sum(1 for _ in list_events(timers)), MAX_EVENTS + 1)
        width = _FRAMES * _BAR * scale
        graph_height = 0 if is_small else _GRAPH * scale + pad
        height = line * (1 + len(rows) + events) + graph_height + (0 if is_small else 2 * pad)
        outside = Rectangle(pad, pad, width + 2 * pad, height + 2 * pad)
        canvas.rects([outside], PANEL)
        inside = outside.inset(pad)
        title = (
            self._describe_times() if self._is_timed else f"frame at {frame.resources.scene.seconds:.3f} s"
        )
        canvas.text(inside.x, inside.y, title, TEXT, scale)
        y = inside.y + line
        if not is_small:
            graph = Rectangle(inside.x, y, width, _GRAPH * scale)
            draw_graph(canvas, graph, self._frames.values, self._own.values, _BAR * scale)
        y += graph_height
        y += draw_objects(canvas, inside.x, y, rows, _NAMES * scale, scale) + pad
        draw_timers(canvas, Rectangle(inside.x, y, width, height), timers, _EVENTS * scale, scale)

    def _list_memory(self, device: Device) -> tuple[str, str]:
        """Return the row of the memory, of one in 30 frames."""
        if not self._memory_frames:
            self._memory_frames = _MEMORY_FRAMES
            memory = device.memory()
            megabytes = f"{memory.total / 2**20:,.1f}, at most {memory.peak / 2**20:,.1f} MiB"
            self._memory = ("memory", megabytes)
        self._memory_frames -= 1
        return self._memory

    def _describe_times(self) -> str:
        times = self._frames.values
        if not len(times):
            return "frame: -"
        ordered = sorted(times.tolist())
        milliseconds = times[-1], ordered[len(ordered) // 2], ordered[-1]
        latest, middle, worst = (f"{time:.1f}" if time < 100.0 else f"{time:.0f}" for time in milliseconds)
        return f"frame {latest} ms   median {middle}   worst {worst}"

    def _add_right(self, frame: Frame, width: int) -> None:
        """Add the panel of the culling, to an image of this width."""
        canvas, scale = self._canvas, self._scale
        scene, camera = frame.resources.scene, frame.camera
        draw_result = frame.draw_result.object_indices if frame.draw_result.is_on_cpu else None
        traversal = compute_traversal(frame.visibility, scene, camera, draw_result)
        pad, line = _PAD * scale, canvas.font.line_height * scale
        side = _MAP * scale
        x = width - side - 3 * pad
        rows = len(set(traversal.outcome.tolist()))
        outside = Rectangle(x, pad, side + 2 * pad, line * (1 + rows) + side + 3 * pad)
        canvas.rects([outside], PANEL)
        inside = outside.inset(pad)
        kind = "nodes" if traversal.is_of_nodes else "objects"
        title = f"{name_algorithm(frame.visibility)}: {kind} from above"
        canvas.text(inside.x, inside.y, title, TEXT, scale)
        y = inside.y + line
        y += draw_legend(canvas, inside.x, y, traversal, scale) + pad
        if self._ground is None or self._ground[0] is not scene:
            self._ground = (scene, compute_ground_bounds(scene))
        draw_map(canvas, Rectangle(inside.x, y, side, side), self._ground[1], traversal, camera)


def name_algorithm(algorithm: VisibilityAlgorithm) -> str:
    """Return the name of an algorithm's class; of `auto`, that of the algorithm it has chosen."""
    if isinstance(algorithm, AutoCulling):
        return f"auto, {type(algorithm.latest).__name__}"
    return type(algorithm).__name__


def _list_counters(frame: Frame, counters: dict[str, int] | None) -> list[tuple[str, str]]:
    """Return the names and values of the counters; without `counters` those that follow from the frame."""
    rows: list[tuple[str, str]] = []
    culling = frame.statistics
    if culling is not None and frame.draw_result.is_on_cpu:
        rows += [
            ("objects drawn", f"{len(frame.draw_result.object_indices):,} of {culling.objects:,}"),
            ("triangles", f"{frame.draw_result.triangles:,}"),
        ]
    if counters is not None:
        rows += [
            ("draw calls", f"{counters['draws']:,}"),
            (
                "states set / sent",
                f"{counters['software_state_changes']:,} / {counters['hardware_state_changes']:,}",
            ),
            ("uploaded", f"{counters['upload_bytes'] / 1024:,.1f} KiB"),
            ("resources made", f"{counters['creations']:,}"),
        ]
    if culling is not None:
        rows += [
            ("nodes tested", f"{culling.nodes_tested:,}"),
            ("queries", f"{culling.queries:,} of {culling.boxes:,} boxes"),
        ]
        if counters is not None:
            rows.append(("stalled", f"{culling.stalled_milliseconds:.2f} ms"))
    return rows
