"""A builder for the text of a stage in a C-like language (GLSL, OpenCL C) that records the origin of each
line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class Lines:
    """A stage's text under construction. `origins` holds each line's Python (file, line), ("", 0) if it has
    none."""

    __slots__ = ("indent", "origins", "text")

    def __init__(self) -> None:
        self.text: list[str] = []
        self.origins: list[tuple[str, int]] = []
        self.indent = 0

    def add(self, text: str, file: str = "", line: int = 0) -> None:
        """Append a line at the current indentation."""
        self.text.append("    " * self.indent + text)
        self.origins.append((file, line))

    @contextmanager
    def braces(self, header: str, file: str = "", line: int = 0, end: str = "}") -> Iterator[None]:
        """Write `header {`, indent the lines that are added in the context, and write `end`."""
        self.add(header + " {", file, line)
        self.indent += 1
        yield
        self.indent -= 1
        self.add(end, file, line)


def power_steps(exponent: int) -> str:
    """Return C statements that raise r, initially x, to a power by square and multiply, from the highest bit
    down."""
    return " ".join("r *= r; r *= x;" if bit == "1" else "r *= r;" for bit in f"{exponent:b}"[1:])
