"""NumPy's functions of index arrays, for indices of 64 bits on every platform.

Where a pointer has 32 bits, as in Pyodide, `numpy.bincount`, `numpy.repeat` and `reduceat` of functions refuse
indices and counts of 64 bits. Ours take both. Ruff refuses NumPy's first two (`pyproject.toml`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def count_indices(indices: ArrayLike, weights: ArrayLike | None = None, minlength: int = 0) -> NDArray[Any]:
    """The number of occurrences of each index, or the sum of its weights; at least `minlength` numbers."""
    return np.bincount(np.asarray(indices, np.intp), weights, minlength)


def repeat_each(values: ArrayLike, counts: ArrayLike, axis: int | None = None) -> NDArray[Any]:
    """The values (n,), each repeated by its count."""
    return np.repeat(values, np.asarray(counts, np.intp), axis)


def reduce_runs(function: np.ufunc, values: NDArray[Any], starts: ArrayLike) -> NDArray[Any]:
    """The results of a function over rows (n, …), from each start to the next, as `function.reduceat`."""
    return np.asarray(function.reduceat(values, np.asarray(starts, np.intp), axis=0))
