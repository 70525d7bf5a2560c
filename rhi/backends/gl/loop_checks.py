"""Detection of loops that llvmpipe has cut short; part of validation.

llvmpipe ends the loops of 8 invocations, without an error, after 65,535 iterations of all their loops
together. Where a loop has ended without a `break` its condition is false, unless it was cut short. So with
validation, a test of the condition follows each loop, and counts failures in an atomic counter of the loop.
Counters are read where the CPU has waited for the GPU anyway. The loops themselves stay as they are, so Mesa
unrolls the same ones. Atomic counters have slots of their own: no program loses one of its storage slots. Not
tested are conditions that call functions.
"""

from __future__ import annotations

import re
from typing import Final

import moderngl
import numpy as np

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.contract.descriptors import StageText
from rhi.errors import ShaderError
from rhi.shading.ir.faults import ENDLESS, make_index_error

_MAX_ITERATIONS: Final = 65535
_MAX_LOOPS: Final = 4096  # counters, as many as a stage may have; loops of later programs aren't tested
_LOOP: Final = re.compile(r"( *)(?:for \(([^;]*;)([^;]*)(;[^;]*)\)|while \((.*)\)) \{")
_BREAK: Final = re.compile(r"\bbreak;")
_FIRST: Final = re.compile(r"^(?=[^#/\s])", re.MULTILINE)
_FUNCTION: Final = re.compile(r"^\w+ (\w+)\(.*\) \{$", re.MULTILINE)


class LoopChecks:
    """The loop tests of all programs of a context."""

    def __init__(self, context: moderngl.Context, gl: EntryPoints) -> None:
        self._gl = gl
        self._lines: list[tuple[str, int]] = []  # file and line of the Python source, by counter
        self._counters = context.buffer(np.zeros(_MAX_LOOPS, np.uint32))
        gl.BindBufferBase(enums.ATOMIC_COUNTER_BUFFER, 0, self._counters.glo)

    def add(self, source: StageText) -> StageText:
        """Return a stage's text with tests behind its loops; its line numbers don't change."""
        first, lines = len(self._lines), source.text.split("\n")
        calls = re.compile(r"\b(?:atomic|image|" + "|".join(_FUNCTION.findall(source.text)) + r")\w*\(")
        opened: list[tuple[str, int, str]] = []  # indentation, counter, condition of the loops around a line
        for number, (line, origin) in enumerate(zip(lines, source.origins, strict=False)):
            loop = _LOOP.fullmatch(line)
            if loop and len(self._lines) < _MAX_LOOPS:
                indentation, start, test, advance, condition = (part or "" for part in loop.groups())
                left = f"rhi_break_{len(self._lines)}"
                again = f"for (;{test}{advance})" if start else f"while ({condition})"
                lines[number] = f"{indentation}{{ bool {left} = false; {start} {again} {{"
                opened.append((indentation, len(self._lines), test or condition))
                self._lines.append(origin)
            elif opened and line == opened[-1][0] + "}":
                _, counter, test = opened.pop()
                note = f"atomicCounterIncrement(rhi_cut_short_{first}[{counter - first}]);"
                lines[number] += (
                    "" if calls.search(test) else f" if (!rhi_break_{counter} && ({test})) {note}"
                )
                lines[number] += " }"
            elif opened and not line.lstrip().startswith("case "):
                lines[number] = _BREAK.sub(f"{{ rhi_break_{opened[-1][1]} = true; break; }}", line)
        count = len(self._lines) - first
        if not count or opened or "#if" in source.text:
            del self._lines[first:]
            return source
        declared = (
            f"layout(binding = 0, offset = {4 * first}) uniform atomic_uint rhi_cut_short_{first}[{count}]; "
        )
        return StageText(_FIRST.sub(declared, "\n".join(lines), count=1), source.origins)

    def take(self) -> ShaderError | None:
        """Return an error for a loop that was cut short since the last call, None if none was."""
        if not self._lines:
            return None
        self._gl.MemoryBarrier(enums.ALL_BARRIER_BITS)
        cut = np.flatnonzero(np.frombuffer(self._counters.read(4 * len(self._lines)), np.uint32))
        if not len(cut):
            return None
        self._counters.clear()
        return make_index_error(self._lines[cut[0]], _MAX_ITERATIONS, ENDLESS)
