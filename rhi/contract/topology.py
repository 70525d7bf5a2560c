"""Topologies as lists of points, lines or triangles, for backends that have to write them out.

The largest index of its type restarts: it ends a primitive, an incomplete one is dropped, and the next index
begins another. The first vertex of a primitive gives flat values; the order of corners keeps it, and the
winding.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import Primitive

CORNERS: Final = {
    Primitive.POINTS: 1,
    Primitive.LINES: 2,
    Primitive.LINE_STRIP: 2,
    Primitive.TRIANGLES: 3,
    Primitive.TRIANGLE_STRIP: 3,
    Primitive.TRIANGLE_FAN: 3,
    Primitive.QUADS: 3,
}
"""Corners of the listed primitives: quads become triangles."""

LISTS: Final = frozenset({Primitive.POINTS, Primitive.LINES, Primitive.TRIANGLES})
"""The topologies whose primitives share no vertices by their order."""


def list_primitives(primitive: Primitive, indices: NDArray[np.integer], restart: int) -> NDArray[np.uint32]:
    """Return the corners of all primitives, one after the other. An index equal to `restart` ends a
    primitive."""
    positions = np.arange(len(indices))
    restarts = indices == restart
    begins = np.maximum.accumulate(
        np.where(restarts, positions + 1, 0)
    )  # the first position of each index's run
    size = 4 if primitive is Primitive.QUADS else CORNERS[primitive]
    ends = np.flatnonzero(restarts)
    stops = np.append(ends, len(indices))[
        np.searchsorted(ends, positions)
    ]  # one past the last position of its run
    if primitive is Primitive.TRIANGLE_FAN:
        a = positions[(positions > begins) & (positions + 1 < stops)]
        corners = np.stack([a, a + 1, begins[a]], axis=1)
    elif primitive in (Primitive.TRIANGLE_STRIP, Primitive.LINE_STRIP):
        a = positions[(positions >= begins) & (positions + size <= stops)]
        if primitive is Primitive.LINE_STRIP:
            corners = np.stack([a, a + 1], axis=1)
        else:
            odd = (a - begins[a]) & 1
            corners = np.stack([a, a + 1 + odd, a + 2 - odd], axis=1)
    else:
        a = positions[
            ((positions - begins) % size == 0) & (positions >= begins) & (positions + size <= stops)
        ]
        order = (0, 1, 2, 0, 2, 3) if primitive is Primitive.QUADS else range(size)
        corners = a[:, None] + np.array(order)
    listed: NDArray[np.uint32] = indices[corners.reshape(-1)].astype(np.uint32)
    return listed
