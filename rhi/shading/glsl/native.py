"""Whole stages in GLSL: the text of a `@native("glsl", …)` that has a `main` of its own.

The class declares the interface: structs, bindings, inputs and outputs, under the names of their fields.
Existing text keeps its `main` and its functions; its own declarations of these names are left out once they
agree with the class. No line is removed, so that the driver's messages lead to the Python lines.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Final, NoReturn

from rhi.shading.ir import tree
from rhi.shading.language import rules
from rhi.shading.language.source import SourceSpan, refuse_at, suggest

# Patterns are compiled on first use, which most programs never make.
_MAIN: Final = r"(?m)^\s*void\s+main\s*\("
_QUALIFIERS: Final = (
    r"(?:(?:flat|smooth|noperspective|centroid|highp|mediump|lowp|readonly|writeonly|coherent)\s+)*"
)
_DECLARATION: Final = (
    rf"^\s*(?:layout\s*\([^)]*\)\s*)?{_QUALIFIERS}(in|out|uniform)\s+"
    rf"{_QUALIFIERS}(\w+)\s+(\w+)\s*(\[\s*\w*\s*\])?\s*;"
)
_BLOCK: Final = r"^\s*(?:layout\s*\([^)]*\)\s*)?(?:\w+\s+)*(uniform|buffer|struct)\s+(\w+)\s*(?:\{|$)"
_GROUP: Final = r"^\s*layout\s*\(([^)]*local_size[^)]*)\)\s*in\s*;"
_SIZE: Final = r"local_size_([xyz])\s*=\s*(\d+)"


def is_whole(function: tree.Function) -> bool:
    """Return whether a function's native GLSL is a stage with a `main` of its own."""
    native = function.native.get("glsl")
    return native is not None and re.search(_MAIN, native.body) is not None


def lines_of(
    function: tree.Function,
    declared: Mapping[tuple[str, str], str],
    structs: set[str],
    work_group: tuple[int, int, int],
) -> Iterator[tuple[str, int]]:
    """Yield the lines of a whole stage with their Python lines, without the declarations that the class
    makes.

    Args:
        declared: the GLSL types of inputs, outputs and bindings, by ("in", "out" or "uniform", name).
        structs: the names of the structs that the class declares.

    Raises:
        ShaderError: `shading-native`: a declaration differs from the class.
    """
    native = function.native["glsl"]

    def refuse(line: int, actual: str, allowed: str, tip: str = "") -> NoReturn:
        refuse_at(rules.NATIVE, function.name, function.file, SourceSpan(line), actual, allowed, tip)

    for offset, line in enumerate(native.body.splitlines()):
        number = native.line + offset if native.line else function.span.line
        text = line
        if line.lstrip().startswith(("#version", "#extension")):
            text = ""
        elif group := re.match(_GROUP, line):
            sizes = {"x": 1, "y": 1, "z": 1} | {axis: int(size) for axis, size in re.findall(_SIZE, group[1])}
            if tuple(sizes.values()) != work_group:
                refuse(number, f"a work-group of {tuple(sizes.values())}", f"work_group = {work_group}")
            text = ""
        elif match := re.match(_DECLARATION, line):
            direction, type, name = match[1], match[2] + (match[4] or ""), match[3]
            expected_type = declared.get((direction, name))
            if expected_type != type:
                declarations = [
                    f"{way} {kind} {key}" for (way, key), kind in declared.items() if way == direction
                ]
                tip = (
                    suggest(name, [key for way, key in declared if way == direction])
                    if expected_type is None
                    else ""
                )
                refuse(
                    number, f"{direction} {type} {name}", ", ".join(declarations) or f"no {direction}", tip
                )
            text = line[: match.start()] + line[match.end() :]
        elif (block := re.match(_BLOCK, line)) and (block[1] != "struct" or block[2] in structs):
            tip = "remove it: the class declares it; a uniform's fields are read as `camera.view`"
            refuse(number, f"{block[1]} {block[2]}", "declarations of the class", tip)
        yield text, number if native.line else 0
