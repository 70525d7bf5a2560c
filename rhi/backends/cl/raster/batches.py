"""The batch that draws are gathered in until they are flushed.

- A draw is a row of 64-bit words in one flat array (`rhi.backends.cl.raster.rows`). Consecutive draws of one pass and
  pipeline form a batch, whatever they bind; what they have in common is a `BatchState`.
- An array of draws that is alone in its batch is kept as it is: its tables are made once (`pieces.DrawList`).
- `Batch.take` turns the rows into tables (`pieces`); `launcher.Launcher` runs the kernels on them.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.raster.batch_state import BatchState
from rhi.backends.cl.raster.boxes import AttributeBoxes
from rhi.backends.cl.raster.pieces import DrawList, Piece, bind_words, tabulate, tabulate_one
from rhi.backends.cl.raster.prepared import PreparedDraws
from rhi.backends.cl.raster.rows import CONDITION, FIXED_COLUMNS, INSTANCES, PREPARED, SAMPLES, VIEW

__rhi_internal__ = True


class GatheredDraws(NamedTuple):
    """The draws of a batch, ready to be launched.

    Attributes:
        pieces: their tables; they may be computed while earlier pieces run.
        views: the `VIEW_STRUCT`s that the tables refer to.
        counters: the address that the tables' counter offsets are relative to; 0 if they hold addresses.
    """

    state: BatchState
    pieces: Iterable[Piece]
    views: bytes
    counters: int


class Batch:
    """The draws gathered and not yet flushed.

    Attributes:
        state: what they have in common. It is replaced only while the batch is empty.
        rows: their rows, one after the other, `state.width` words each; empty while a draw list is alone.
        views: the `VIEW_STRUCT`s that the rows' VIEW columns number.
    """

    def __init__(self, prepared: PreparedDraws, boxes: AttributeBoxes) -> None:
        self._prepared = prepared
        self._boxes = boxes
        self.state: BatchState | None = None
        self.rows = array("Q")
        self.views: list[bytes] = []
        self._alone: tuple[DrawList, Sequence[int], int] | None = None  # the arguments of `gather`

    def __bool__(self) -> bool:
        """Return whether any draws are gathered."""
        return bool(self.rows) or self._alone is not None

    def gather(self, draws: DrawList, row: Sequence[int], counters: int = 0) -> None:
        """Add the draws of an array. They have `row` in common; `counters`: the address that their counter offsets are
        relative to."""
        if self or row[VIEW] or row[CONDITION] or (row[SAMPLES] and draws.samples is None):
            self.spread()
            self.rows.frombytes(draws.spread(row, counters).tobytes())
        else:
            self._alone = draws, row, counters

    def spread(self) -> None:
        """Turn a draw list that is alone into rows, since other draws follow."""
        if self._alone is not None:
            draws, row, counters = self._alone
            self._alone = None
            self.rows.frombytes(draws.spread(row, counters).tobytes())

    def drop_partial_row(self) -> None:
        """Remove the words of a row that could not be written to its end: they would shift all rows behind them."""
        assert self.state is not None
        del self.rows[len(self.rows) - len(self.rows) % self.state.width :]

    def take(self) -> GatheredDraws:
        """Remove and return the gathered draws, of which there are some.

        Raises:
            pyopencl.Error: out of memory for boxes; the draws are lost.
        """
        state, alone, words = self.state, self._alone, self.rows[:]
        assert state is not None
        views = b"".join(self.views)
        self._alone = None
        del self.rows[:]
        self.views.clear()
        if alone is None:
            return GatheredDraws(state, self._tabulate(state, words), views, 0)
        draws, row, counters = alone
        if draws.boxed != self._prepared.version and not self._choose_boxes(
            state, draws.places, draws.instances
        ):
            draws.boxed = self._prepared.version
        bound = bind_words(state, row[FIXED_COLUMNS:], draws.list_streams(state.streams))
        return GatheredDraws(state, [(table, bound) for table in draws.tables], views, counters)

    def _tabulate(self, state: BatchState, words: array[int]) -> Iterable[Piece]:
        if len(words) == state.width:
            piece = tabulate_one(state, self._prepared, words)
            if piece is not None:
                return (piece,)
        rows = np.frombuffer(words.tobytes(), np.uint64).reshape(-1, state.width)
        numbers = rows[:, PREPARED].astype(np.int64)
        instances = rows.view(np.uint32)[:, 2 * INSTANCES : 2 * INSTANCES + 2].astype(np.int64)
        self._choose_boxes(state, numbers, instances[:, 0])
        return tabulate(state, self._prepared, rows, numbers, instances)

    def _choose_boxes(
        self, state: BatchState, numbers: NDArray[np.int64], instances: NDArray[np.int64]
    ) -> bool:
        """Have boxes measured for draws that were drawn before; return whether some draws still lack theirs."""
        return state.vertex.measure is not None and self._boxes.choose(numbers, instances)
