"""The layout of text: from an array of characters to an array of glyphs with positions, without a loop over
them.

A tab or a line end closes a segment. Each tab stop is a multiple of one width, and so is what a segment with
its tab advances by, because it begins at a stop. So the segments of a line begin at a running sum, and no
segment has to wait for the one before it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from renderer.layers.canvas.font import LINE, TAB, Font
from rhi.math.indexing import repeat_each


class TextLayout(NamedTuple):
    """A text laid out, in pixels from its top left.

    Attributes:
        glyphs: (k,) the glyphs that cover anything. places: (k, 2) their top left.
        width: the width of the longest line, tabs included.
        height: that of all lines.
    """

    glyphs: NDArray[np.int32]
    positions: NDArray[np.int32]
    width: int
    height: int


def lay_out(font: Font, text: str) -> TextLayout:
    """Lay out lines of text, which a line feed separates."""
    glyphs = font.lookup_glyphs(text)
    advance = font.advance.take(glyphs)
    if len(glyphs) > 1:
        advance[:-1] += font.kern(glyphs[:-1], glyphs[1:])
    after = advance.cumsum(dtype=np.int32)
    positions = np.empty((len(glyphs), 2), np.int32)
    np.subtract(after, advance, out=positions[:, 0])
    ends = (glyphs >= TAB).nonzero()[0]
    if len(ends):
        width, lines = _place_segments(font, glyphs, positions, ends, int(after[-1]))
    else:
        positions[:, 1] = 0
        width, lines = int(after[-1]) if len(after) else 0, 1
    extent = font.extent.take(glyphs, axis=0)
    positions += font.bearing.take(glyphs, axis=0)
    drawn = extent[:, 0].nonzero()[0]
    return TextLayout(glyphs.take(drawn), positions.take(drawn, axis=0), width, lines * font.line_height)


def _place_segments(
    font: Font, glyphs: NDArray[np.int32], positions: NDArray[np.int32], ends: NDArray[np.int64], total: int
) -> tuple[int, int]:
    """Move the pens (n, 2) of a single line to those of its segments, which end before the characters `ends`.

    Returns:
        The width of the longest line, and the number of lines.
    """
    pens = positions[:, 0]
    bounds = np.concatenate([[0], pens.take(ends), [total]])
    is_line = np.zeros(len(ends) + 1, bool)
    is_line[:-1] = glyphs.take(ends) == LINE
    widths = np.diff(bounds)
    steps = (widths // font.tab + 1) * font.tab
    starts = steps.cumsum() - steps
    line = is_line.cumsum() - is_line
    first = np.concatenate([[0], is_line.nonzero()[0] + 1])  # the segment that each line begins with
    starts -= starts.take(first).take(line)
    segment = repeat_each(np.arange(len(widths)), np.diff(np.concatenate([[0], ends + 1, [len(pens)]])))
    positions[:, 1] = line.take(segment) * font.line_height
    pens += (starts - bounds[:-1]).take(segment)
    return int((starts + widths).max()), int(line[-1]) + 1
