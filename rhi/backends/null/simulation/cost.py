"""The cost of commands on the simulated GPU: a small model of the work in them.

- A command is reduced to a `CommandWork`: vertices, covered pixels, bytes, state changes, invocations.
- `CostModel.nanoseconds` turns that into time. It is linear; a subclass can replace it. The numbers aren't
  measured. They have the order of magnitude of a small GPU, so that a timeline shows what waits for what.
"""

from __future__ import annotations

from typing import NamedTuple

from rhi.commands.ops import Op
from rhi.contract.descriptors import Primitive
from rhi.errors.data_classes import dataclass


class CommandWork(NamedTuple):
    """The work of the GPU for one command."""

    op: Op
    vertices: int = 0
    pixels: float = 0.0
    """Pixels covered by primitives, or cleared."""
    bytes: int = 0
    """Bytes moved by writes, copies, resolves and mip level generation."""
    state_changes: int = 0
    invocations: int = 0
    """Invocations of a compute stage."""


@dataclass(frozen=True)
class CostModel:
    """The cost of each unit of work, in nanoseconds. Equal work takes equal time.

    Attributes:
        command: the cost of each command, in addition to its work.
        primitive_pixels: the number of pixels that a primitive is assumed to cover if its samples aren't
            counted.
    """

    command: float = 20.0
    vertex: float = 0.5
    pixel: float = 0.05
    byte: float = 0.02
    state_change: float = 100.0
    invocation: float = 0.1
    primitive_pixels: float = 32.0

    def nanoseconds(self, work: CommandWork) -> int:
        """Return the time that the GPU takes, in nanoseconds. For commands without work of their own this is
        called once per op."""
        return round(
            self.command
            + self.vertex * work.vertices
            + self.pixel * work.pixels
            + self.byte * work.bytes
            + self.state_change * work.state_changes
            + self.invocation * work.invocations
        )

    def covered_pixels(self, primitives: int, area: int) -> float:
        """Estimate the pixels covered by a draw of `primitives` into `area` pixels (viewport and scissor
        intersected)."""
        return min(float(area), primitives * self.primitive_pixels)


_VERTICES_EACH = {
    Primitive.POINTS: (1, 0),
    Primitive.LINES: (2, 0),
    Primitive.LINE_STRIP: (1, 1),
    Primitive.TRIANGLES: (3, 0),
    Primitive.TRIANGLE_STRIP: (1, 2),
    Primitive.TRIANGLE_FAN: (1, 2),
    Primitive.QUADS: (4, 0),
}
"""Vertices per primitive, and additional vertices at the start of a strip."""


def count_primitives(primitive: Primitive, vertices: int) -> int:
    """Return the number of points, lines, triangles or quads that `vertices` vertices form."""
    vertices_each, opening = _VERTICES_EACH[primitive]
    return max(0, vertices - opening) // vertices_each
