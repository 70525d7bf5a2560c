"""What the text of the rasteriser's kernels must be like."""

from __future__ import annotations

import re
from importlib.resources import files

import pytest

from rhi.backends.cl.cache import strip_comments

_HEADER = re.compile(r"^(?!typedef\b|struct\b)(\w[^;{}#=]*\)) *\{", re.M)


def find_structs_by_value(text: str) -> list[str]:
    """Return the heads of functions that take or return a struct, instead of the address of one."""
    text = strip_comments(text)
    structs = "|".join(re.findall(r"^\} *(\w+);", text, re.M))
    by_value = re.compile(rf"\b(?:{structs})\s+\w")
    return [head for head in _HEADER.findall(text) if by_value.search(head)]


def test_kernels_give_structs_by_address() -> None:
    """PoCL never frees the types of a function's structs, so programs that come and go would make a process grow."""
    kernels = files("rhi.backends.cl.raster").joinpath("kernels")
    text = "\n".join(each.read_text() for each in kernels.iterdir() if each.name.endswith(".cl"))
    assert len(_HEADER.findall(text)) > 100
    assert not find_structs_by_value(text)


@pytest.mark.parametrize(
    ("head", "found"),
    [
        ("INLINE Pair split(int a)", True),
        ("bool holds(global const int *a, const Pair pair)", True),
        ("SEPARATE void split(\n    int a, Pair b\n)", True),
        ("INLINE void split(int a, Pair *pair)", False),
        ("bool holds(global const Pair *pairs, int pair)", False),
    ],
)
def test_structs_by_value_are_found(head: str, found: bool) -> None:
    text = f"typedef struct {{\n    int a, b;\n}} Pair;\n\n{head} {{\n    Pair c, d;\n    use(c, d);\n}}\n"
    assert find_structs_by_value(text) == ([head] if found else [])
