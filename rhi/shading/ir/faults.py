"""Errors for faults that checked shaders report from the device.

A shader whose `checked` is true tests every index of a buffer, array, vector or matrix, and every
`uniform(x)`, where it is used. On OpenCL its kernel, or the function of a stage that draws, has one more
argument after its bindings: `global int *`, three words that are zero before a launch. The first fault of a
launch writes there its line in the stage's text (`StageText.origins` leads from it to the Python line), the
index, and the limit that the index must be below. A limit of -1 stands for values of `uniform` that differ,
one of -2 for an endless loop. On NumPy the error is raised at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from rhi.errors import ShaderError
from rhi.errors.call_sites import CallSite
from rhi.shading.language import rules
from rhi.shading.language.source import SourceSpan, show

FAULT_WORDS: Final = 3
_NONUNIFORM: Final = -1
ENDLESS: Final = -2


def make_index_error(line: tuple[str, int], value: int, limit: int) -> ShaderError:
    """Return the error for an index that isn't below `limit`, at a (file, line) of the Python source."""
    file, number = line
    call, site = show(file, SourceSpan(number)), CallSite(str(file), number)
    if limit == _NONUNIFORM:
        return ShaderError(rules.NONUNIFORM, call, "different values", "one value", site=site)
    if limit == ENDLESS:
        return ShaderError(rules.ENDLESS, call, f"{value} iterations", "an end", site=site)
    return ShaderError(
        rules.INDEX,
        call,
        f"index {value}",
        f"0 to {limit - 1}" if limit else "nothing: it is empty",
        site=site,
    )


def find_fault(words: Sequence[int], lines: Sequence[tuple[str, int]]) -> ShaderError | None:
    """Return the error for the words that a kernel wrote, or None if they are zero; `lines` are the text's
    origins."""
    number, value, limit = words
    return make_index_error(lines[number - 1], value, limit) if number else None
