"""The types of the two kinds of arrays that are used throughout the renderer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""Coordinates, sizes and matrices in float64."""

Rows = NDArray[np.int64]
"""Row numbers: of objects, nodes, boxes or members, as the signature says."""
