"""Counting and repeating by arrays of 64 bits, also where NumPy's own indices have 32."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhi.math import indexing
from rhi.math.indexing import count_indices, reduce_runs, repeat_each

COUNTS = st.lists(st.integers(0, 5), max_size=20)
DTYPES = st.sampled_from([np.int64, np.int32, np.uint32, np.uint8])


@given(COUNTS, DTYPES)
def test_each_value_is_repeated_as_often_as_its_count(counts: list[int], dtype: type) -> None:
    values = np.arange(len(counts))
    expected = [value for value, count in zip(values, counts, strict=True) for _ in range(count)]
    assert repeat_each(values, np.array(counts, dtype)).tolist() == expected


@given(COUNTS, DTYPES)
def test_indices_are_counted(indices: list[int], dtype: type) -> None:
    assert count_indices(np.array(indices, dtype), minlength=6).tolist() == [
        indices.count(i) for i in range(6)
    ]


@given(COUNTS)
def test_weights_of_an_index_are_added(indices: list[int]) -> None:
    weights = np.arange(len(indices)) / 4.0
    expected = [sum(w for i, w in zip(indices, weights, strict=True) if i == index) for index in range(6)]
    assert count_indices(np.array(indices, np.int64), weights, minlength=6).tolist() == expected


@given(st.lists(st.integers(1, 4), min_size=1, max_size=8), DTYPES)
def test_a_function_is_applied_to_each_run_of_rows(counts: list[int], dtype: type) -> None:
    rows = np.arange(2 * sum(counts)).reshape(-1, 2)
    starts = np.cumsum([0, *counts[:-1]])
    expected = [
        rows[start : start + count].sum(0).tolist() for start, count in zip(starts, counts, strict=True)
    ]
    assert reduce_runs(np.add, rows, starts.astype(dtype)).tolist() == expected


class NarrowAdd:
    """`numpy.add` where pointers have 32 bits."""

    @staticmethod
    def reduceat(values: Any, starts: Any, axis: int) -> Any:
        assert np.can_cast(starts.dtype, np.int32, "safe")
        return np.add.reduceat(values, starts, axis)


class Narrow:
    """NumPy where pointers have 32 bits: its functions of index arrays refuse integers of 64."""

    intp = np.int32

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    @staticmethod
    def bincount(indices: Any, *rest: Any) -> Any:
        assert np.can_cast(indices.dtype, np.int32, "safe")
        return np.bincount(indices, *rest)

    @staticmethod
    def repeat(values: Any, counts: Any, *rest: Any) -> Any:
        assert np.can_cast(counts.dtype, np.int32, "safe")
        return np.repeat(values, counts, *rest)


@pytest.mark.parametrize("dtype", [np.int64, np.uint32, np.int32])
def test_integers_of_64_bits_are_taken_where_pointers_have_32(
    monkeypatch: pytest.MonkeyPatch, dtype: type
) -> None:
    monkeypatch.setattr(indexing, "np", Narrow())
    assert count_indices(np.array([2, 0, 2], dtype)).tolist() == [1, 0, 2]
    assert repeat_each([5, 6], np.array([2, 1], dtype)).tolist() == [5, 5, 6]
    add: Any = NarrowAdd()
    assert reduce_runs(add, np.array([1, 2, 4]), np.array([0, 2], dtype)).tolist() == [3, 4]
