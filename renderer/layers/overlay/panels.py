"""The panels of the overlay: each draws one thing to a canvas, inside a rectangle.

Times are in milliseconds. All that repeats, bars, boxes and lines of text, is added as one array or one text.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from renderer.layers.canvas import Canvas, srgb
from renderer.scene import Camera, Scene
from renderer.visibility import CullingTraversal, TraversalOutcome
from rhi import TimerNode
from rhi.math.indexing import count_indices

TEXT: Final = srgb("#e8edf2")
DIM: Final = srgb("#93a1ae")
PANEL: Final = srgb("#0a0f14", 0.78)
FIELD: Final = srgb("#000000", 0.45)
RULE: Final = srgb("#ffffff", 0.22)
FAST: Final = srgb("#57c785")
FAIR: Final = srgb("#e8b64c")
SLOW: Final = srgb("#e86a5c")
OWN: Final = srgb("#c77dff")
GPU: Final = srgb("#4ca6e8")
CPU: Final = srgb("#e8b64c")
BUDGET: Final = 1000.0 / 60.0

OUTCOME_COLORS: Final = {
    TraversalOutcome.OUTSIDE: srgb("#6b7785"),
    TraversalOutcome.HIDDEN: srgb("#e86a5c"),
    TraversalOutcome.QUERIED: srgb("#4ca6e8"),
    TraversalOutcome.VISIBLE: srgb("#57c785"),
    TraversalOutcome.UNDECIDED: srgb("#e8b64c"),
}
OUTCOME_NAMES: Final = {
    TraversalOutcome.OUTSIDE: "outside the view",
    TraversalOutcome.HIDDEN: "hidden",
    TraversalOutcome.QUERIED: "queried, visible",
    TraversalOutcome.VISIBLE: "visible",
    TraversalOutcome.UNDECIDED: "the device decides",
}
_SPREAD: Final = 0.05
MAX_BOXES: Final = 2048
"""The largest number of boxes on the map; of more, the largest are shown."""
MAX_EVENTS: Final = 12
"""The largest number of rows of the timer tree."""


class Rectangle(NamedTuple):
    """A rectangle in pixels."""

    x: int
    y: int
    width: int
    height: int

    def inset(self, by: int) -> Rectangle:
        """Return the rectangle without a margin."""
        return Rectangle(self.x + by, self.y + by, self.width - 2 * by, self.height - 2 * by)


def draw_graph(
    canvas: Canvas, box: Rectangle, frames: NDArray[np.float64], python_times: NDArray[np.float64], bar: int
) -> None:
    """Draw a bar for each frame, the latest at the right edge; its foot is the overlay's own time.

    The graph's height is 1/60 s, doubled until the longest time fits; lines stand for 1/60 s and 1/30 s.
    """
    canvas.rects([box], FIELD)
    if not len(frames):
        return
    top = BUDGET
    while top < frames.max():
        top *= 2.0
    x = box.x + box.width - bar * np.arange(len(frames), 0, -1)
    high = np.ceil(frames * (box.height / top))
    foot = np.minimum(np.ceil(python_times * (box.height / top)), high)
    under = box.y + box.height
    kinds = np.stack([FAST, FAIR, SLOW])[np.searchsorted((BUDGET, 2.0 * BUDGET), frames)]
    wide = np.full(len(frames), max(bar - 1, 1))
    canvas.rects(np.stack([x, under - high, wide, high - foot], axis=1), kinds)
    canvas.rects(np.stack([x, under - foot, wide, foot], axis=1), OWN)
    heights = [round(budget * box.height / top) for budget in (BUDGET, 2.0 * BUDGET) if budget <= top]
    canvas.rects([(box.x, under - budget, box.width, 1) for budget in heights], RULE)


def draw_objects(
    canvas: Canvas, x: int, y: int, rows: Sequence[tuple[str, str]], second: int, scale: int
) -> int:
    """Draw names and values in two columns, `second` pixels apart; return the height."""
    canvas.text(x, y, "\n".join(name for name, _ in rows), DIM, scale)
    return canvas.text(x + second, y, "\n".join(value for _, value in rows), TEXT, scale)[1]


def list_events(roots: Sequence[TimerNode], depth: int = 0) -> Iterator[tuple[int, TimerNode]]:
    """Yield all events of a timer tree with their depths, parents before children."""
    for node in roots:
        yield depth, node
        yield from list_events(node.children, depth + 1)


def draw_timers(canvas: Canvas, box: Rectangle, roots: Sequence[TimerNode], second: int, scale: int) -> int:
    """Draw the timer tree, an event a row: its name, two bars (above the time of the GPU, below that of the
    CPU) and both times. Return the height."""
    events = list(list_events(roots))
    listed_events = events[:MAX_EVENTS]
    row = canvas.font.line_height * scale
    longest = max(
        (max(node.gpu_milliseconds, node.cpu_milliseconds) for _, node in listed_events), default=0.0
    )
    names = "\n".join("  " * depth + node.name for depth, node in listed_events)
    more = f"\n... {len(events) - len(listed_events)} more" if len(events) > len(listed_events) else ""
    canvas.text(box.x, box.y, names + more, TEXT, scale)
    if listed_events:
        times = np.array([(node.gpu_milliseconds, node.cpu_milliseconds) for _, node in listed_events])
        left, column = box.x + second, canvas.measure("0000.00 ", scale)[0]
        reach = box.width - second - 2 * column
        for number, side in enumerate(times.T.tolist()):
            text = "\n".join(f"{time:.2f}" for time in side)
            canvas.text(left + reach + number * column + 4 * scale, box.y, text, DIM, scale)
        bar = (row - 5 * scale) // 2
        wide = np.ceil(times * (max(reach, 0) / max(longest, 1e-9)))
        y = box.y + row * np.arange(len(listed_events)) + 2 * scale
        for number, color in enumerate((GPU, CPU)):
            boxes = np.stack(
                [
                    np.full(len(listed_events), left),
                    y + number * bar,
                    wide[:, number],
                    np.full(len(listed_events), bar),
                ],
                axis=1,
            )
            canvas.rects(boxes, color)
    return row * (len(listed_events) + bool(more))


def draw_legend(canvas: Canvas, x: int, y: int, traversal: CullingTraversal, scale: int) -> int:
    """Draw how many boxes of each outcome there are, beside its colour; return the height."""
    counts = count_indices(traversal.outcome, minlength=len(TraversalOutcome)).tolist()
    kinds = [kind for kind in TraversalOutcome if counts[kind]]
    row = canvas.font.line_height * scale
    side = row - 8 * scale
    squares = [(x, y + row * number + 4 * scale, side, side) for number in range(len(kinds))]
    canvas.rects(squares, np.array([OUTCOME_COLORS[kind] for kind in kinds]).reshape(-1, 4))
    text = "\n".join(f"{counts[kind]:,} {OUTCOME_NAMES[kind]}" for kind in kinds)
    canvas.text(x + row, y, text, TEXT, scale)
    return row * len(kinds)


def draw_map(
    canvas: Canvas,
    box: Rectangle,
    bounds: tuple[NDArray[np.float64], NDArray[np.float64]],
    traversal: CullingTraversal,
    camera: Camera,
) -> None:
    """Draw the boxes of a walk from above, x to the right and z down, and the edges of the camera's view.

    The rectangle shows the ground between the corners `bounds`. Small objects are filled; nodes are
    outlines, and objects that cover much of the ground.
    """
    canvas.rects([box], FIELD)
    low, high = bounds
    scale = float(np.min((np.array(box[2:]) - 2) / np.maximum(high - low, 1e-9)))
    origin = np.array(box[:2]) + 0.5 * np.array(box[2:]) - 0.5 * scale * (low + high)
    corner = np.floor(origin + scale * traversal.lower[:, ::2])
    size = np.maximum(np.ceil(origin + scale * traversal.upper[:, ::2]) - corner, 1.0)
    rows = np.argsort(traversal.outcome, kind="stable")
    area = size[:, 0] * size[:, 1]
    if len(rows) > MAX_BOXES:
        rows = rows[np.sort(np.argpartition(-area[rows], MAX_BOXES)[:MAX_BOXES])]
    boxes = np.concatenate([corner, size], axis=1)[rows]
    colors = np.stack([OUTCOME_COLORS[kind] for kind in TraversalOutcome])[traversal.outcome[rows]]
    with canvas.clip(*box):
        is_filled = (area[rows] <= _SPREAD * box.width * box.height) & (not traversal.is_of_nodes)
        canvas.outlines(boxes[~is_filled], 0.8 * colors[~is_filled])
        canvas.rects(boxes[is_filled], 0.5 * colors[is_filled])
        eye = origin + scale * camera.position[[0, 2]]
        edges = view_edges(camera)[:, [0, 2]]
        ends = eye + edges * (2.0 * sum(box[2:]) / np.maximum(np.linalg.norm(edges, axis=1), 1e-9))[:, None]
        canvas.lines(np.stack([np.broadcast_to(eye, ends.shape), ends], axis=1), TEXT)
        canvas.rect(round(eye[0]) - 2, round(eye[1]) - 2, 5, 5, TEXT)


def compute_ground_bounds(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners (2,), x and z, of the ground to show: that of all objects but those that cover more
    than a twentieth of it, such as streets and the land around a city."""
    lower, upper = scene.objects.lower[:, ::2], scene.objects.upper[:, ::2]
    area = np.prod(upper - lower, axis=1)
    rows = np.arange(len(lower))
    while True:
        low, high = lower[rows].min(axis=0), upper[rows].max(axis=0)
        small_rows = rows[area[rows] <= _SPREAD * float(np.prod(high - low))]
        if len(small_rows) == len(rows) or not len(small_rows):
            return low, high
        rows = small_rows


def view_edges(camera: Camera) -> NDArray[np.float64]:
    """Return directions (2, 3) from the eye to the left and the right edge of the image, at half its
    height."""
    inverse = np.linalg.inv(camera.projection.matrix)
    points = np.array([(-1.0, 0.0, 0.5, 1.0), (1.0, 0.0, 0.5, 1.0)]) @ inverse.T
    return np.asarray(points[:, :3] / points[:, 3:] @ camera.rotation)
