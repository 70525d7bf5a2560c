"""Fonts: the glyphs of Latin-1 at one size, in an atlas of coverage that Pillow has rasterised.

- All measures are whole pixels: glyphs are hinted, and their advances with them. So text is crisp wherever it
  is drawn at whole pixels and at a whole scale, and its layout at scale 2 is that of scale 1, doubled.
- Characters are numbered by their code. What a font has no glyph for, control characters included, is `BOX`,
  which is drawn here and not by the font.
- Kerning is asked for when a pair is first used, since a font has 36,481 pairs and a text few of them. Pillow
  kerns by HarfBuzz; a Pillow without it doesn't kern.
- The default font is DejaVu Sans, cut down to Latin-1, which lies beside this file with its licence:
  `pyftsubset DejaVuSans.ttf --unicodes=20-7E,A0-FF,FFFD --legacy-kern --layout-features=kern
  --notdef-outline`.
- DejaVu Sans Mono, cut down in the same way without kerning, is for text whose columns mean something: source
  code with marks below it, tables of errors.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from rhi import refuse

BOX: Final = 256
"""The glyph of characters that a font can't draw."""
TAB: Final = 257
"""The glyph of a tab: nothing, without an advance."""
LINE: Final = 258
"""The glyph of a line feed: nothing, without an advance."""
GLYPHS: Final = 259
"""The number of glyphs."""
WHITE: Final = 1
"""The texel, in both directions, in the middle of the atlas's corner of full coverage."""

_CORNER: Final = (
    3  # width and height of that corner: interpolation that rounds to a neighbour finds it white, too
)
_GAP: Final = 1  # texels between glyphs
_WIDTH: Final = 256  # of the atlas
_UNKNOWN: Final = 127  # kerning of a pair that wasn't asked for
_FILE: Final = Path(__file__).with_name("DejaVuSans.ttf")
MONOSPACED: Final = Path(__file__).with_name("DejaVuSansMono.ttf")
"""The file of a font all of whose characters are equally wide: `Font.load(file=MONOSPACED)`."""


class Font:
    """Glyphs at one size, all measures in pixels. A glyph is a code of Latin-1, `BOX`, `TAB` or `LINE`.

    Attributes:
        size: the height of the font as its designer means it.
        line_height: from one line's top to the next.
        tab: the width between tab stops.
        coverage: (h, w) uint8, the atlas; its corner at the top left is full.
        advance: (GLYPHS,) from a glyph to the next.
        bearing: (GLYPHS, 2) from the pen, at the line's top, to a glyph's top left.
        extent: (GLYPHS, 2) its size.
        atlas_position: (GLYPHS, 2) its top left in the atlas.
        is_kerned: whether pairs are kerned, for which Pillow needs HarfBuzz (on Debian `libfribidi0`).
    """

    def __init__(self, file: Path, size: int) -> None:
        """Rasterise all glyphs of the font in `file`; `Font.load` keeps fonts."""
        if not 4 <= size <= 256:
            refuse(rules.FONT_SIZE, "Font.load", size, "4 to 256")
        from PIL import ImageFont, features  # optional

        try:
            self._font = ImageFont.truetype(file, size, layout_engine=ImageFont.Layout.BASIC)
            self.is_kerned = bool(features.check("raqm"))
            self._kerned = (
                ImageFont.truetype(file, size, layout_engine=ImageFont.Layout.RAQM)
                if self.is_kerned
                else self._font
            )
        except (OSError, ImportError) as error:  # of a file that is no font, or a Pillow without FreeType
            refuse(
                rules.FONT_FILE, "Font.load", f"{file.name}: {error}", "a file that Pillow reads as a font"
            )
        self._pair_options: dict[str, Any] = {"features": ["-liga", "-clig"]} if self.is_kerned else {}
        self.size = size
        ascender, descent = self._font.getmetrics()
        self.line_height = ascender + descent
        self.advance: NDArray[np.int32] = np.zeros(GLYPHS, np.int32)
        self.bearing: NDArray[np.int32] = np.zeros((GLYPHS, 2), np.int32)
        self.extent: NDArray[np.int32] = np.zeros((GLYPHS, 2), np.int32)
        self.atlas_position: NDArray[np.int32] = np.zeros((GLYPHS, 2), np.int32)
        self._glyph_of: NDArray[np.int32] = np.full(257, BOX, np.int32)  # by code; the last is any other
        self._glyph_of[[ord("\t"), ord("\n")]] = TAB, LINE
        self._kerning = np.full((GLYPHS, GLYPHS), _UNKNOWN, np.int8)
        self._kerning[BOX:] = self._kerning[:, BOX:] = 0
        masks = self._rasterise(ascender)
        self.tab = 4 * int(self.advance[ord("0")])
        self.coverage: NDArray[np.uint8] = self._pack(masks)

    @staticmethod
    def load(size: int = 13, file: Path | None = None) -> Font:
        """Return the font of a file, or DejaVu Sans, at a size of 4 to 256 pixels. Eight fonts are kept.

        Raises:
            RhiError: `canvas-font-file`, `canvas-font-size`.
        """
        return _load(file or _FILE, size)

    def lookup_glyphs(self, text: str) -> NDArray[np.int32]:
        """Return the glyphs (n,) of a text's characters."""
        codes = np.frombuffer(text.encode("utf-32-le", "surrogatepass"), "<u4")
        glyphs: NDArray[np.int32] = self._glyph_of[np.minimum(codes, 256)]
        return glyphs

    def kern(self, first: NDArray[np.int32], second: NDArray[np.int32]) -> NDArray[np.int8]:
        """Return by how much less or more (k,) each glyph of `first` advances before the one of `second`."""
        pairs = first * GLYPHS
        pairs += second
        table = self._kerning.reshape(-1)
        kerning = table.take(pairs)
        if len(kerning) and kerning.max() == _UNKNOWN:
            for pair in np.unique(pairs[kerning == _UNKNOWN]).tolist():
                table[pair] = self._measure_pair(chr(pair // GLYPHS), chr(pair % GLYPHS))
            kerning = table.take(pairs)
        return kerning

    def _measure_pair(self, first: str, second: str) -> int:
        length, options = self._kerned.getlength, self._pair_options
        kerning = length(first + second, **options) - length(first, **options) - length(second, **options)
        return max(-_UNKNOWN, min(round(kerning), _UNKNOWN - 1))

    def _rasterise(self, ascender: int) -> dict[int, NDArray[np.uint8]]:
        """Measure all glyphs and return the coverage of those that have any."""
        masks: dict[int, NDArray[np.uint8]] = {}
        missing = self._font.getmask("\uffff", "L")
        for code in (*range(32, 127), *range(160, 256)):
            mask, (left, top) = self._font.getmask2(chr(code), "L", anchor="la")
            if mask.size == missing.size and bytes(mask) == bytes(missing):
                continue
            self._glyph_of[code] = code
            self.advance[code] = round(self._font.getlength(chr(code)))
            if all(mask.size):
                masks[code] = np.frombuffer(bytes(mask), np.uint8).reshape(mask.size[::-1])
                self.bearing[code] = left, top
        high = max(ascender - int(self.bearing[ord("H"), 1]), 3)
        box = np.full((high, max(high * 2 // 3, 3)), 255, np.uint8)
        box[1:-1, 1:-1] = 0
        masks[BOX] = box
        self.bearing[BOX] = 1, ascender - high
        self.advance[BOX] = box.shape[1] + 2
        return masks

    def _pack(self, masks: dict[int, NDArray[np.uint8]]) -> NDArray[np.uint8]:
        """Return the atlas: rows of glyphs, the highest first."""
        width = max(_WIDTH, *(_GAP + mask.shape[1] for mask in masks.values()))
        x, y, high = _CORNER + _GAP, 0, _CORNER
        for glyph, mask in sorted(masks.items(), key=lambda item: -item[1].shape[0]):
            if x + mask.shape[1] > width:
                x, y, high = 0, y + high + _GAP, 0
            self.atlas_position[glyph], self.extent[glyph] = (x, y), mask.shape[::-1]
            x, high = x + mask.shape[1] + _GAP, max(high, mask.shape[0])
        atlas = np.zeros((y + high, width), np.uint8)
        atlas[:_CORNER, :_CORNER] = 255
        for glyph, mask in masks.items():
            (x, y), (wide, high) = self.atlas_position[glyph], self.extent[glyph]
            atlas[y : y + high, x : x + wide] = mask
        return atlas


@lru_cache(8)
def _load(file: Path, size: int) -> Font:
    return Font(file, size)
