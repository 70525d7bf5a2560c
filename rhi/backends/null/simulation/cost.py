"""What commands cost the simulated GPU: a small model of the work in them.

- A command comes down to a `CommandWork`: vertices, covered pixels, bytes, state changes, invocations.
- `CostModel.nanoseconds` turns that into time. It is linear; replace it by a subclass. Nothing measured stands
  behind the numbers: they are of the order of a small GPU's, so that a timeline shows what waits for what.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from rhi.commands.ops import Op
from rhi.contract.descriptors import Primitive

__rhi_internal__ = True


class CommandWork(NamedTuple):
    """What one command makes the GPU do."""

    op: Op
    vertices: int = 0
    pixels: float = 0.0
    """Covered by primitives or cleared."""
    bytes: int = 0
    """Moved by writes, copies, resolves and mip levels."""
    state_changes: int = 0
    invocations: int = 0
    """Of a compute stage."""


@dataclass(frozen=True)
class CostModel:
    """Nanoseconds for one of each. Deterministic: equal work, equal time.

    Attributes:
        command: for each command, whatever it does.
        primitive_pixels: how many pixels a primitive covers where nobody counts samples.
    """

    command: float = 20.0
    vertex: float = 0.5
    pixel: float = 0.05
    byte: float = 0.02
    state_change: float = 100.0
    invocation: float = 0.1
    primitive_pixels: float = 32.0

    def nanoseconds(self, work: CommandWork) -> int:
        """How long the GPU takes. For commands that have no work of their own it is asked once per op."""
        return round(
            self.command
            + self.vertex * work.vertices
            + self.pixel * work.pixels
            + self.byte * work.bytes
            + self.state_change * work.state_changes
            + self.invocation * work.invocations
        )

    def covered_pixels(self, primitives: int, area: int) -> float:
        """An estimate for a draw of so many primitives into `area` pixels (the viewport within the scissor)."""
        return min(float(area), primitives * self.primitive_pixels)


_VERTICES_EACH = {
    Primitive.POINTS: (1, 0), Primitive.LINES: (2, 0), Primitive.LINE_STRIP: (1, 1), Primitive.TRIANGLES: (3, 0),
    Primitive.TRIANGLE_STRIP: (1, 2), Primitive.TRIANGLE_FAN: (1, 2), Primitive.QUADS: (4, 0),
}  # fmt: skip
"""Vertices for each primitive, and those that only open a strip."""


def count_primitives(primitive: Primitive, vertices: int) -> int:
    """Points, lines, triangles or quads that so many vertices make."""
    each, opening = _VERTICES_EACH[primitive]
    return max(0, vertices - opening) // each
