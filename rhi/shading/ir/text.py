"""A stage's text in C's words, be it GLSL or OpenCL C: its lines, and the Python line behind each of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

__rhi_internal__ = True


class Lines:
    """A stage's text under construction; `origins` are (file, line), ("", 0) of what no Python line stands for."""

    __slots__ = ("indent", "origins", "text")

    def __init__(self) -> None:
        self.text: list[str] = []
        self.origins: list[tuple[str, int]] = []
        self.indent = 0

    def add(self, text: str, file: str = "", line: int = 0) -> None:
        """One line, indented."""
        self.text.append("    " * self.indent + text)
        self.origins.append((file, line))

    @contextmanager
    def braces(self, header: str, file: str = "", line: int = 0, end: str = "}") -> Iterator[None]:
        """An indented block."""
        self.add(header + " {", file, line)
        self.indent += 1
        yield
        self.indent -= 1
        self.add(end, file, line)


def power_steps(exponent: int) -> str:
    """What makes of r = x the power `exponent` of x, in C's words: square and multiply, from the highest bit down."""
    return " ".join("r *= r; r *= x;" if bit == "1" else "r *= r;" for bit in f"{exponent:b}"[1:])
