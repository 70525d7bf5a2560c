"""Fonts and the layout of text, against Pillow's own measures and a layout that goes character by
character."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import ImageFont, features

from renderer.layers.canvas import BOX, Font, lay_out
from renderer.layers.canvas.font import LINE, TAB
from rhi import RhiError

PRINTABLE = [*range(32, 127), *range(160, 256)]
FILE = Path(__file__).parents[3] / "renderer" / "canvas" / "DejaVuSans.ttf"
PANGRAM = "AVATAR To. WAVE Yo, LT 'P.' 0123456789 fi ffl Äöüß éñçø ÀÝÞ ÷×"

kerns = pytest.mark.skipif(
    not features.check("raqm"), reason="Pillow has no HarfBuzz: apt install libfribidi0"
)


@pytest.fixture(scope="module")
def font() -> Font:
    return Font.load(13)


def lay_out_one_by_one(font: Font, text: str) -> tuple[list[tuple[int, int, int]], int, int]:
    """Return (glyph, x, y) of the drawn glyphs, the width and the height, measured with Pillow."""
    plain = ImageFont.truetype(FILE, font.size, layout_engine=ImageFont.Layout.BASIC)
    shaped = ImageFont.truetype(FILE, font.size, layout_engine=ImageFont.Layout.RAQM)
    no_ligatures = ["-liga", "-clig"]

    def length(part: str) -> float:
        return shaped.getlength(part, features=no_ligatures)

    glyphs, x, line, width = [], 0, 0, 0
    for number, character in enumerate(text):
        code = ord(character)
        if character == "\t":
            x = (x // font.tab + 1) * font.tab
        elif character == "\n":
            x, line = 0, line + 1
        elif code in PRINTABLE:
            mask, (left, top) = plain.getmask2(character, "L", anchor="la")
            if all(mask.size):
                glyphs.append((code, x + left, line * font.line_height + top))
            x += round(plain.getlength(character))
            following = text[number + 1 : number + 2]
            if following and ord(following) in PRINTABLE:
                x += round(length(character + following) - length(character) - length(following))
        else:
            glyphs.append((BOX, x + 1, line * font.line_height + int(font.bearing[BOX, 1])))
            x += int(font.advance[BOX])
        width = max(width, x)
    return glyphs, width, (line + 1) * font.line_height


def check_layout(font: Font, text: str) -> None:
    layout = lay_out(font, text)
    expected, width, height = lay_out_one_by_one(font, text)
    glyphs = np.column_stack([layout.glyphs, layout.positions]).tolist()
    assert glyphs == [list(glyph) for glyph in expected], text
    assert (layout.width, layout.height) == (width, height), text


@kerns
@pytest.mark.parametrize(
    "text",
    [
        "",
        " ",
        "A",
        PANGRAM,
        "\n",
        "\t",
        "a\n",
        "a\n\nb",
        "\ta",
        "a\tb\tc",
        "iii\tWWWWWW\ti\n\t\tx\ty",
        "four\tMMMM\tnext",
        "tab at the end\t",
        "bell \x07, delete \x7f, C1 \x85, return \r.",
        "€ ∞ 漢 😀 \ud800",
    ],
)
def test_the_layout_of_a_text_equals_a_layout_character_by_character(font: Font, text: str) -> None:
    check_layout(font, text)


@kerns
@pytest.mark.parametrize("size", [9, 13, 32])
def test_the_layout_of_random_texts_equals_a_layout_character_by_character(size: int) -> None:
    rng = np.random.default_rng(size)
    codes = np.array([*PRINTABLE, *[ord("\t"), ord("\n")] * 12, 0, 7, 127, 0x20AC, 0x1F600])
    for _ in range(12):
        check_layout(Font.load(size), "".join(map(chr, rng.choice(codes, rng.integers(1, 80)))))


@kerns
def test_kerning_moves_pairs_together_and_leaves_others_alone(font: Font) -> None:
    assert lay_out(font, "AV").width < lay_out(font, "A").width + lay_out(font, "V").width
    assert lay_out(font, "11").width == 2 * lay_out(font, "1").width


def test_digits_are_equally_wide_so_that_numbers_stay_in_place(font: Font) -> None:
    assert len({lay_out(font, str(digit)).width for digit in range(10)}) == 1


def test_every_printable_character_of_latin_1_has_a_glyph_and_no_other(font: Font) -> None:
    glyphs = font.lookup_glyphs("".join(map(chr, range(300)))).tolist()
    expected = [code if code in PRINTABLE else BOX for code in range(300)]
    expected[9], expected[10] = TAB, LINE
    assert glyphs == expected


def test_glyphs_of_the_atlas_equal_pillow_s_and_do_not_overlap(font: Font) -> None:
    plain = ImageFont.truetype(FILE, 13, layout_engine=ImageFont.Layout.BASIC)
    taken = np.zeros(font.coverage.shape, int)
    taken[:3, :3] += 1
    for code in [*PRINTABLE, BOX]:
        (x, y), (wide, high) = font.atlas_position[code], font.extent[code]
        taken[y : y + high, x : x + wide] += 1
        if code != BOX:
            mask = plain.getmask(chr(code), "L")
            expected = np.frombuffer(bytes(mask), np.uint8).reshape(mask.size[::-1])
            if mask.size != (0, 0) and all(mask.size):
                assert (font.coverage[y : y + high, x : x + wide] == expected).all(), chr(code)
    assert taken.max() == 1
    assert (font.coverage[taken == 0] == 0).all()
    assert (font.coverage[:3, :3] == 255).all()


def test_a_font_that_lacks_characters_draws_boxes_for_them(tmp_path: Path) -> None:
    ascii_only = ImageFont.load_default(14)
    (tmp_path / "small.ttf").write_bytes(ascii_only.font_bytes)
    assert Font.load(14, tmp_path / "small.ttf").lookup_glyphs("Aé").tolist() == [ord("A"), BOX]


@pytest.mark.parametrize(("size", "is_fine"), [(3, False), (4, True), (256, True), (257, False)])
def test_sizes_have_bounds(size: int, is_fine: bool) -> None:
    if is_fine:
        assert Font.load(size).size == size
        return
    with pytest.raises(RhiError, match="canvas-font-size"):
        Font.load(size)


def test_a_file_that_is_no_font_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.ttf").write_text("no font", encoding="utf-8")
    with pytest.raises(RhiError, match="canvas-font-file"):
        Font.load(13, tmp_path / "text.ttf")
