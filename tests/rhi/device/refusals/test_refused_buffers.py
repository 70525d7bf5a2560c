"""Rules of buffers and locks."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rhi import Access, Device
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Corner
from rhi.conformance.validation.refusal import refuses
from rhi.errors import rules
from rhi.shading import Struct, ivec2, uint, vec3, vec4

U4 = np.dtype("u4")


@pytest.mark.parametrize("count", [0, -1])
def test_a_buffer_needs_room(recording: Device, count: int) -> None:
    with refuses(rules.BUFFER_SIZE, recording):
        recording.buffer(count)
    recording.buffer(1).destroy()


def test_an_empty_array_makes_no_buffer(recording: Device) -> None:
    with refuses(rules.BUFFER_SIZE, recording):
        recording.buffer(np.zeros(0, U4))


def test_python_objects_make_no_buffer(recording: Device) -> None:
    with refuses(rules.BUFFER_DTYPE, recording):
        recording.buffer(np.array([None, "text"], object))


def test_a_source_array_must_have_the_dtype_asked_for(recording: Device) -> None:
    with refuses(rules.BUFFER_DTYPE, recording):
        recording.buffer(np.zeros(4, "f4"), U4)
    recording.buffer(np.zeros(4, "u4"), U4).destroy()


@pytest.mark.parametrize(("first", "count"), [(0, 9), (8, 1), (9, 0), (-1, 1), (0, -1), (4, 5)])
def test_a_range_must_lie_in_the_buffer(recording: Device, first: int, count: int) -> None:
    with recording.buffer(8, U4) as buffer:
        with refuses(rules.BUFFER_RANGE, recording):
            buffer.read(first, count)
        with refuses(rules.BUFFER_RANGE, recording):
            buffer.lock(Access.READ, first, count)
        assert_same(buffer.read(0, 8), 0)
        assert_same(buffer.read(7, 1), 0)


@pytest.mark.parametrize("first", [1, 8, -1])
def test_a_write_must_end_in_the_buffer(recording: Device, first: int) -> None:
    with recording.buffer(8, U4) as buffer:
        with refuses(rules.BUFFER_RANGE, recording):
            buffer.write(np.ones(8, U4), first)
        assert_same(buffer.read(), 0)
        buffer.write(np.ones(8, U4), 0)


@pytest.mark.parametrize("dtype", ["i4", "u2", "f4", "u8"])
def test_an_array_must_have_the_buffer_s_dtype(recording: Device, dtype: str) -> None:
    with recording.buffer(8, U4) as buffer:
        with refuses(rules.BUFFER_DTYPE, recording):
            buffer.write(np.ones(4, dtype))
        assert_same(buffer.read(), 0)


def test_the_refusal_of_a_dtype_shows_both_layouts(recording: Device) -> None:
    buffer_dtype = np.dtype([("a", "f4"), ("b", "f4", 3)])
    data_dtype = np.dtype([("a", "f4"), ("b", "f8", 3)])
    with recording.buffer(2, buffer_dtype) as buffer, refuses(rules.BUFFER_DTYPE, recording) as refusal:
        buffer.write(np.zeros(2, data_dtype))
    assert "float32[3]" in str(refusal.error)
    assert "float64[3]" in str(refusal.error)


@pytest.mark.parametrize(
    ("offset", "target", "size"),
    [(0, 0, 17), (8, 0, 9), (0, 8, 9), (-1, 0, 4), (0, -4, 4), (0, 0, 0), (16, 0, None)],
)
def test_a_copy_must_lie_in_both_buffers(
    recording: Device, offset: int, target: int, size: int | None
) -> None:
    with recording.buffer(16) as first, recording.buffer(16) as second:
        with refuses(rules.BUFFER_RANGE, recording):
            first.copy_to(second, size=size, offset=offset, target_offset=target)
        first.copy_to(second, size=16)
        first.copy_to(second, offset=15, target_offset=15)


@pytest.mark.parametrize(("target", "overlaps"), [(0, True), (7, True), (-7, True), (8, False), (-8, False)])
def test_a_copy_within_a_buffer_must_not_overlap(recording: Device, target: int, overlaps: bool) -> None:
    with recording.buffer(32) as buffer:
        if overlaps:
            with refuses(rules.BUFFER_OVERLAP, recording):
                buffer.copy_to(buffer, size=8, offset=8, target_offset=8 + target)
        else:
            buffer.copy_to(buffer, size=8, offset=8, target_offset=8 + target)


@pytest.mark.parametrize("size", [1, 3, 5])
def test_a_clear_needs_whole_words(recording: Device, size: int) -> None:
    with recording.buffer(size) as buffer, refuses(rules.BUFFER_ALIGNMENT, recording):
        buffer.clear()
    with recording.buffer(4) as buffer:
        buffer.clear()


# -- typed buffers -----------------------------------------------------------------------------------------


class Light(Struct):
    """A struct with padding: std430 places `color` at 16."""

    position: vec3
    color: vec3
    power: float


class Sun(Struct):
    """Another struct of the same size."""

    position: vec3
    color: vec3
    power: float


def test_storage_keeps_its_layout_when_written(recording: Device) -> None:
    with recording.storage(Light, 2) as lights:
        with refuses(rules.LAYOUT_MISMATCH, recording):
            lights.write(np.zeros(2, Corner.dtype))
        lights.write(np.zeros(2, Light.dtype))


def test_storage_of_numbers_wants_their_type(recording: Device) -> None:
    with refuses(rules.LAYOUT_MISMATCH, recording):
        recording.storage(uint, np.zeros(4, "f4"))
    recording.storage(uint, np.zeros(4, "u4")).destroy()
    recording.storage(vec4, np.zeros((4, 4), "f4")).destroy()


HOLDS = [  # what is stored as given, then what isn't, both next to the bound
    (int, [-(2**31), 2**31 - 1], [0, 2**31], "2147483648 of int64"),
    (int, [-(2**31)], [-(2**31) - 1], "-2147483649 of int64"),
    (uint, [0, 2**32 - 1], [-1], "-1 of int64"),
    (uint, np.array([0, 127], "i1"), np.array([1, -1], "i1"), "-1 of int8"),
    (int, np.array([2**31 - 1], "u8"), np.array([2**64 - 1], "u8"), "18446744073709551615 of uint64"),
    (float, [2**24], [2**24 + 1], "16777217 of int64"),
    (float, [0.5, -math.inf, math.inf], [1e300], "1e+300 of float64"),
    (ivec2, [(1, 2), (3, 4)], [(1, 2), (3, 2**40)], "1099511627776 of int64"),
]


@pytest.mark.parametrize(("element", "accepted", "refused", "refusal_text"), HOLDS)
def test_storage_of_numbers_accepts_values_of_its_element_type(
    recording: Device, element, accepted, refused, refusal_text: str
) -> None:
    with recording.storage(element, accepted) as storage:
        assert (storage.read() == np.asarray(accepted)).all()
        for call in (lambda: recording.storage(element, refused), lambda: storage.write(refused)):
            with refuses(rules.LAYOUT_MISMATCH, recording) as refusal:
                call()
            assert refusal.error.given == refusal_text
        storage.write(accepted)
        assert (storage.read() == np.asarray(accepted)).all()


def test_storage_needs_room(recording: Device) -> None:
    with refuses(rules.BUFFER_SIZE, recording):
        recording.storage(uint, 0)


def test_a_uniform_array_wants_its_own_dtype(recording: Device) -> None:
    with recording.uniform_array(Light, 3) as lights:
        with refuses(rules.LAYOUT_MISMATCH, recording):
            lights.write(np.zeros(3, Corner.dtype))
        lights.write(np.zeros(3, lights.dtype))


def test_a_uniform_takes_values_of_its_own_struct(recording: Device) -> None:
    zero: dict[str, Any] = {"position": (0, 0, 0), "color": (0, 0, 0), "power": 0.0}
    with recording.uniform(Light(**zero)) as light:
        with refuses(rules.LAYOUT_MISMATCH, recording):
            light.write(Sun(**zero))  # type: ignore[arg-type]
        light.write(Light(**zero))


def test_a_uniform_is_made_from_a_struct_s_value(recording: Device) -> None:
    with refuses(rules.DEVICE_ARGUMENT, recording):
        recording.uniform((1.0, 2.0))  # type: ignore[type-var]


def test_a_view_of_a_buffer_of_another_dtype_is_read_through_the_buffer(recording: Device) -> None:
    with recording.buffer(np.zeros(4, "f4")) as buffer:
        storage = recording.storage(uint, buffer)
        with refuses(rules.BUFFER_DTYPE, recording):
            storage.read()
        buffer.read()


# -- locks -------------------------------------------------------------------------------------------------


def test_a_buffer_is_locked_once_at_a_time(recording: Device) -> None:
    with recording.buffer(8, U4) as buffer:
        with buffer.lock(Access.WRITE) as array:
            with refuses(rules.LOCK_OPEN, recording), buffer.lock(Access.WRITE):
                pass
            array[:] = 3
        assert_same(buffer.read(), 3)
        with buffer.lock(Access.READ):
            pass


def test_a_lock_made_twice_is_entered_once(recording: Device) -> None:
    with recording.buffer(8, U4) as buffer:
        first, second = buffer.lock(Access.WRITE), buffer.lock(Access.WRITE)
        with first, refuses(rules.LOCK_TWICE, recording), second:
            pass
        with second as array:
            array[:] = 5
        assert_same(buffer.read(), 5)


@pytest.mark.parametrize("use", ["read", "write", "clear", "copy from", "copy to"])
def test_a_locked_buffer_is_not_used(recording: Device, use: str) -> None:
    with recording.buffer(8, U4) as buffer, recording.buffer(8, U4) as other:
        uses: dict[str, Callable[[], Any]] = {
            "read": buffer.read,
            "write": lambda: buffer.write(np.ones(8, U4)),
            "clear": lambda: buffer.clear(1),
            "copy from": lambda: buffer.copy_to(other),
            "copy to": lambda: other.copy_to(buffer),
        }
        with buffer.lock(Access.READ), refuses(rules.LOCK_OPEN, recording):
            uses[use]()
        uses[use]()


def test_the_end_of_a_lock_needs_its_beginning(recording: Device) -> None:
    with recording.buffer(8, U4) as buffer:
        lock = buffer.lock(Access.WRITE)
        with refuses(rules.LOCK_CLOSED, recording):
            lock.__exit__(None, None, None)
        with lock:
            pass
        with refuses(rules.LOCK_CLOSED, recording):
            lock.__exit__(None, None, None)


def test_the_array_of_a_closed_lock_is_dead(recording: Device) -> None:
    with recording.buffer(8, U4) as buffer:
        with buffer.lock(Access.WRITE) as array:
            array[:] = 1
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 2
        assert_same(buffer.read(), 1)


def test_an_open_lock_is_named_when_the_device_closes(fresh_device: Device) -> None:
    buffer = fresh_device.buffer(8, U4, label="forgotten")
    buffer.lock(Access.WRITE).__enter__()
    with refuses(rules.LOCK_OPEN) as refusal:
        fresh_device.close()
    assert "forgotten" in str(refusal.error)
    assert fresh_device.closed


# -- life --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("use", ["read", "write", "lock", "clear", "copy from", "copy to"])
def test_a_destroyed_buffer_is_not_used(recording: Device, use: str) -> None:
    buffer, other = recording.buffer(8, U4), recording.buffer(8, U4)
    uses: dict[str, Callable[[], Any]] = {
        "read": buffer.read,
        "write": lambda: buffer.write(np.ones(8, U4)),
        "lock": lambda: buffer.lock(Access.READ).__enter__(),
        "clear": lambda: buffer.clear(1),
        "copy from": lambda: buffer.copy_to(other),
        "copy to": lambda: other.copy_to(buffer),
    }
    if use != "lock":
        uses[use]()
    buffer.destroy()
    with refuses(rules.RESOURCE_DESTROYED, recording):
        uses[use]()
    other.destroy()


def test_a_buffer_of_another_device_is_not_used(recording: Device, device: Device) -> None:
    with recording.buffer(8, U4) as mine, device.buffer(8, U4) as theirs:
        with refuses(rules.RESOURCE_FOREIGN, recording):
            mine.copy_to(theirs)
        with refuses(rules.RESOURCE_FOREIGN, recording):
            recording.storage(uint, theirs)
