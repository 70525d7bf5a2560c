"""The types of the two kinds of arrays that are used throughout the renderer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rhi.math import Floats as Floats

Rows = NDArray[np.int64]
"""Row numbers: of objects, nodes, boxes or members, as the signature says."""
