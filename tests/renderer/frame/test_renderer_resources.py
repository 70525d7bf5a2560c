"""The buffers of a scene on a device, and when they are written."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

import rhi
from renderer.frame import MirroredArray
from rhi.shading import vec4


def rows(*values: float) -> np.ndarray:
    return np.repeat(np.array(values, np.float32)[:, None], 4, axis=1)


def test_an_empty_array_has_no_buffer(null: rhi.Device) -> None:
    array = MirroredArray(null, vec4, "rows")
    array.write(rows())
    assert array.buffer is None
    assert len(array) == 0


def test_equal_rows_are_not_written_again(null: rhi.Device) -> None:
    array = MirroredArray(null, vec4, "rows")
    array.write(rows(1, 2, 3))
    null.reset_statistics()
    array.write(rows(1, 2, 3))
    assert null.statistics.upload_bytes == 0


def test_rows_are_written_from_the_first_to_the_last_that_differ(null: rhi.Device) -> None:
    array = MirroredArray(null, vec4, "rows")
    array.write(rows(1, 2, 3, 4, 5))
    null.reset_statistics()
    array.write(rows(1, 9, 3, 9, 5))
    assert null.statistics.upload_bytes == 3 * 16


def test_another_number_of_rows_is_another_buffer(null: rhi.Device) -> None:
    array = MirroredArray(null, vec4, "rows")
    array.write(rows(1, 2))
    before = array.buffer
    array.write(rows(1, 2, 3))
    assert before is not None
    assert before.owner.destroyed
    assert len(array) == 3
    array.write(rows())
    assert array.buffer is None


@given(st.lists(st.lists(st.integers(0, 3), max_size=6), min_size=1, max_size=6))
def test_the_buffer_holds_what_was_written_last(history: list[list[int]]) -> None:
    with rhi.create_device("null") as device:
        array = MirroredArray(device, vec4, "rows")
        for values in history:
            array.write(rows(*values))
            held = rows() if array.buffer is None else array.buffer.read()
            assert np.array_equal(held, rows(*values))
