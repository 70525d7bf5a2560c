"""Draws as they are executed, and the arguments that indirect commands read from memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rhi.backends.null.null_buffers import Buffers
from rhi.contract.descriptors import DRAW, DRAW_UNINDEXED, Id, Primitive
from rhi.errors.data_classes import dataclass


@dataclass(frozen=True, slots=True)
class Draw:
    """An executed draw; an indirect command gives one for each of its draws.

    Attributes:
        labels: the open labels, outermost first.
    """

    program: Id
    vertex_array: Id
    primitive: Primitive
    first: int
    count: int
    instances: int
    base_vertex: int
    base_instance: int
    labels: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ExecutedIndirectDraws:
    """An indirect draw command with the arguments that it read when it was executed.

    Attributes:
        draws: an array of `rhi.DRAW`, with or without indices, as long as the number of draws; empty if
            conditional rendering dropped them.
    """

    vertex_array: Id
    primitive: Primitive
    draws: NDArray[np.void]


def read_indirect_draws(
    buffers: Buffers,
    buffer: Id,
    offset: int,
    draws: int,
    stride: int,
    count_buffer: Id,
    count_offset: int,
    indexed: bool,
) -> NDArray[np.void]:
    """Return the draws of an indirect command as an array of `rhi.DRAW`, from the present contents of the
    buffers."""
    if count_buffer:
        draws = min(draws, int(buffers.words(count_buffer, count_offset, 1)[0]))
    if indexed and stride == DRAW.itemsize:
        return (
            np.frombuffer(buffers.memory[buffer], DRAW, draws, offset).copy() if draws else np.zeros(0, DRAW)
        )
    result = np.zeros(draws, DRAW)
    if draws:
        layout = DRAW if indexed else DRAW_UNINDEXED
        records: NDArray[np.void] = np.ndarray(draws, layout, buffers.memory[buffer], offset, stride)
        for name in DRAW.names or ():
            if name in (layout.names or ()):
                result[name] = records[name]
    return result


def has_vertices(draws: NDArray[np.void]) -> bool:
    """Return whether any of `draws` (of `rhi.DRAW`) has vertices. Mostly the first has."""
    counts, instances = draws["count"], draws["instances"]
    if len(draws) and counts[0] and instances[0]:
        return True
    return bool(((counts > 0) & (instances > 0)).any())
