"""The interface: a layer that draws what the viewer says over its frames, in text and lines.

Text is monospaced: errors mark columns of source lines, and help and console are tables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from textwrap import wrap
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame import Frame
from renderer.layers.canvas import MONOSPACED, Canvas, Font, srgb
from renderer.scene import Camera
from renderer.scene.arrays import Floats
from rhi import Device

_TEXT: Final = srgb("#e8edf2")
_DIM: Final = srgb("#93a1ae")
_ERROR: Final = srgb("#ff8a7a")
_PANEL: Final = srgb("#0a0f14", 0.95)
_CURSOR: Final = srgb("#57c785")
_BOX: Final = srgb("#e8b64c")
_TRIANGLE: Final = srgb("#ffffff")
_PAD: Final = 8
_CONSOLE_LINES: Final = 16  # of the console
_CONSOLE_LINES_WITH_HELP: Final = 6  # of it, while the keys are shown above it
_EDGES: Final = [(a, b) for a in range(8) for b in range(8) if a < b and (a ^ b).bit_count() == 1]


@dataclass(slots=True)
class InterfaceState:
    """The contents of the interface in the next frame.

    Attributes:
        corner: a line at the top in the middle.
        notes: lines at the bottom left, each with whether it is an error.
        help: rows of keys and what they do, or None.
        console: the lines of the console, or None if it is closed.
        line, cursor, choices: its line, where that is edited, and the words that could follow.
        box: (8, 3) corners of a box in the world, numbered by bits.
        triangle: (3, 3), a triangle there.
    """

    corner: str = ""
    notes: Sequence[tuple[str, bool]] = ()
    help: Sequence[tuple[str, str]] | None = None
    console: Sequence[tuple[str, bool]] | None = None
    line: str = ""
    cursor: int = 0
    choices: Sequence[str] = ()
    box: Floats | None = None
    triangle: Floats | None = None


@dataclass(frozen=True, slots=True)
class ScreenRectangle:
    """A rectangle of the image, in pixels."""

    x: int
    y: int
    width: int
    height: int


class InterfaceLayer:
    """Draws what is `state`.

    Attributes:
        state: what the next frame shows; replace it between frames.
        scale: pixels of a texel of the text.
        is_hidden: whether nothing is drawn.
    """

    def __init__(self, device: Device, font: Font | None = None) -> None:
        self._canvas = Canvas(device, font or Font.load(file=MONOSPACED))
        self.state = InterfaceState()
        self.scale = 1
        self.is_hidden = False

    def render(self, device: Device, frame: Frame) -> None:
        """Draw to the frame's image, of each eye."""
        if self.is_hidden:
            return
        canvas, image = self._canvas, frame.targets.image
        width, height = image.size
        state = self.state
        self._mark(frame.camera, (width, height))
        top, above = 0, height
        if state.corner:
            if state.console is not None:  # the room is scarce: help begins below this line
                top = self._line_height + 2 * _PAD * self.scale
            wide = canvas.measure(state.corner, self.scale)[0]
            self._add_text((width - wide) // 2, _PAD * self.scale, [(state.corner, False)])
        bottom = height - _PAD * self.scale
        if state.console is not None:
            above = self._add_console(ScreenRectangle(0, 0, width, bottom))
        elif state.notes and state.help is None:
            notes = self._wrap(state.notes, width - 4 * _PAD * self.scale)
            self._add_text(
                2 * _PAD * self.scale, bottom - self._line_height * len(notes) - _PAD * self.scale, notes
            )
        if state.help is not None:
            self._add_help(ScreenRectangle(0, top, width, above - top))
        if not len(canvas):
            return
        with device.event("interface"), device.render_pass(image):
            canvas.draw(image.size)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._canvas.destroy()

    @property
    def _line_height(self) -> int:
        return self._canvas.font.line_height * self.scale

    def _add_text(self, x: int, y: int, lines: Sequence[tuple[str, bool]]) -> None:
        """Add lines on a panel; the text's top left is at (x, y)."""
        canvas, scale, pad = self._canvas, self.scale, _PAD * self.scale
        wide = canvas.measure("\n".join(text for text, _ in lines), scale)[0]
        canvas.rect(x - pad, y - pad // 2, wide + 2 * pad, self._line_height * len(lines) + pad, _PANEL)
        self._add_lines(x, y, lines, _TEXT)

    def _add_lines(
        self, x: int, y: int, lines: Sequence[tuple[str, bool]], color: NDArray[np.float32]
    ) -> None:
        """Add lines, those of a colour that follow each other as one text; errors have their own colour."""
        for is_error, run in groupby(lines, lambda line: line[1]):
            texts = [text for text, _ in run]
            self._canvas.text(x, y, "\n".join(texts), _ERROR if is_error else color, self.scale)
            y += self._line_height * len(texts)

    def _wrap(self, lines: Sequence[tuple[str, bool]], width: int) -> list[tuple[str, bool]]:
        """Return the lines broken to a width in pixels, about: a character is as wide as an n."""
        most = max(width // self._canvas.measure("n", self.scale)[0], 1)
        return [
            (part, is_error)
            for text, is_error in lines
            for part in ([text] if len(text) <= most else wrap(text, most) or [""])
        ]

    def _add_help(self, room: ScreenRectangle) -> None:
        """Add the keys in the middle of a part of the image, in as many columns as it takes. Rows for which there
        is no room are left out, and the last line says so."""
        canvas, scale, pad = self._canvas, self.scale, _PAD * self.scale
        rows = self.state.help or ()
        lines = min((room.height - 2 * pad) // self._line_height, len(rows))
        if lines < 1:
            return
        columns: list[tuple[str, str, int, int]] = []
        wide = 0
        for first in range(0, len(rows), lines):
            keys, texts = ("\n".join(words) for words in zip(*rows[first : first + lines], strict=True))
            left, right = canvas.measure(keys, scale)[0], canvas.measure(texts, scale)[0]
            more = left + right + (4 if columns else 2) * pad
            if columns and wide + more + 2 * pad > room.width:
                break
            columns.append((keys, texts, left, right))
            wide += more
        x, high = max((room.width - wide) // 2, pad), self._line_height * lines
        y = max(room.y + (room.height - high) // 2, pad)
        canvas.rect(x - pad, y - pad, wide + 2 * pad, high + 2 * pad, _PANEL)
        if len(columns) * lines < len(rows):
            keys, texts, left, right = columns[-1]
            keys, texts = (column.rpartition("\n")[0] for column in (keys, texts))
            columns[-1] = f"{keys}\n...", f"{texts}\nmore in a larger window", left, right
        for keys, texts, left, right in columns:
            canvas.text(x, y, keys, _TEXT, scale)
            canvas.text(x + left + 2 * pad, y, texts, _DIM, scale)
            x += left + right + 4 * pad

    def _add_console(self, box: ScreenRectangle) -> int:
        """Add the console at the bottom of a part of the image, and return the row of its upper edge."""
        canvas = self._canvas
        scale = self.scale
        pad = _PAD * self.scale
        row = self._line_height
        state = self.state
        lines = (
            [*(state.console or ()), ("  ".join(state.choices), False)]
            if state.choices
            else state.console or ()
        )
        most = _CONSOLE_LINES if state.help is None else _CONSOLE_LINES_WITH_HELP
        room = max(min(most, (box.height - 2 * pad) // row - 1), 0)
        lines = self._wrap(lines[max(len(lines) - room, 0) :], box.width - 2 * pad)
        lines = lines[max(len(lines) - room, 0) :]
        top = box.y + box.height - row * (len(lines) + 1) - pad
        canvas.rect(box.x, top - pad, box.width, row * (len(lines) + 1) + 2 * pad, _PANEL)
        self._add_lines(box.x + pad, top, lines, _DIM)
        below = top + len(lines) * row
        canvas.text(box.x + pad, below, f"> {state.line}", _TEXT, scale)
        before = canvas.measure(f"> {state.line[: state.cursor]}", scale)[0]
        canvas.rect(box.x + pad + before, below, 2 * scale, row, _CURSOR)
        return top - pad

    def _mark(self, camera: Camera, size: tuple[int, int]) -> None:
        """Add the edges of the box and of the triangle, as the camera sees them."""
        for points, edges, color in (
            (self.state.box, _EDGES, _BOX),
            (self.state.triangle, [(0, 1), (1, 2), (2, 0)], _TRIANGLE),
        ):
            if points is not None:
                lines = project_lines(camera, size, points[np.array(edges)])
                if len(lines):
                    self._canvas.lines(lines, color, 2.0 * self.scale)


def project_lines(camera: Camera, size: tuple[int, int], lines: Floats) -> Floats:
    """Return the lines (k, 2, 2), in pixels, as which lines (n, 2, 3) in the world are seen. They are cut off
    where they are before the near plane, or outside the image by more than its size."""
    ends = (lines - camera.position) @ camera.rotation.T
    clip = np.concatenate([ends, np.ones((*ends.shape[:2], 1))], axis=2) @ camera.projection.matrix.T
    w = clip[..., 3:]
    nearest = getattr(camera.projection, "near", 0.0)
    inside = np.concatenate(
        [3.0 * w - clip[..., :2], 3.0 * w + clip[..., :2], -ends[..., 2:] - nearest], axis=2
    )
    begin, end = np.zeros(len(lines)), np.ones(len(lines))
    for number in range(inside.shape[2]):  # Liang and Barsky, 1984
        first, last = inside[:, 0, number], inside[:, 1, number]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = first / (first - last)
        begin = np.where((first < 0.0) & (last >= 0.0), np.maximum(begin, at), begin)
        end = np.where((first >= 0.0) & (last < 0.0), np.minimum(end, at), end)
        end = np.where((first < 0.0) & (last < 0.0), -1.0, end)
    is_visible = begin < end
    parts = np.stack([begin, end], axis=1)[is_visible][:, :, None]
    cut = clip[is_visible][:, :1] + parts * (clip[is_visible][:, 1:] - clip[is_visible][:, :1])
    ndc = cut[..., :2] / np.maximum(cut[..., 3:], 1e-12)
    return np.asarray((ndc * (0.5, -0.5) + 0.5) * size)
