"""The cells of pairs as shaders have them, in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.lab.exam.cell_pairs import Pairs
from renderer.lab.exam.cone_pairs import ConePairs
from renderer.lights.culling.cells import block_cell
from rhi.shading import evaluate


def evaluate_cells(pairs: Pairs | ConePairs) -> NDArray[Any]:
    """Return the cell of each pair."""
    cells: NDArray[Any] = evaluate(
        block_cell, pairs.grid, pairs.tiles, 1, pairs.near, pairs.far, dtype=np.float64
    )
    return cells
