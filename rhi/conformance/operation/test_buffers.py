"""Buffers: contents, ranges, locks, copies and clears. No shader runs, so every device runs these tests."""

from __future__ import annotations

import gc
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import Access, BufferUsage, Device, ValidationError
from rhi.conformance.compare import assert_same
from rhi.shading import Array, Struct, array, mat3, uvec2, vec3

POINT = np.dtype([("position", "<f4", (3,)), ("color", "u1", (4,)), ("id", "<u2"), ("pad", "<u2")])


def numbers(count: int, dtype: str = "u4") -> NDArray[Any]:
    """Return numbers without equal neighbours and without runs of equal bytes."""
    return (np.arange(count, dtype=np.uint64) * 2654435761 % (1 << 32)).astype(dtype)


@pytest.mark.parametrize("usage", [BufferUsage.STATIC, BufferUsage.STREAM])
@pytest.mark.parametrize("size", [1, 3, 4, 127, 128, 129, 255, 4096, 1 << 20])
def test_a_new_buffer_holds_zeros(device: Device, size: int, usage: BufferUsage) -> None:
    """Also one that may get the memory of another that was destroyed."""
    for _ in range(2):
        with device.buffer(size, usage=usage) as buffer:
            assert_same(buffer.read(), np.zeros(size))
            buffer.write(np.full(size, 0xFF, np.uint8))
        device.finish()


@pytest.mark.parametrize("usage", [BufferUsage.STATIC, BufferUsage.STREAM])
def test_a_buffer_made_from_an_array_holds_it(device: Device, usage: BufferUsage) -> None:
    with device.buffer(numbers(100), usage=usage) as buffer:
        assert buffer.dtype == np.uint32
        assert len(buffer) == 100
        assert buffer.size == 400
        assert_same(buffer.read(), numbers(100))


@pytest.mark.parametrize("dtype", ["u1", "i1", "u2", "i2", "f2", "u4", "i4", "f4", "f8", "u8"])
def test_every_dtype_reads_back_as_written(device: Device, dtype: str) -> None:
    values = np.arange(-7, 9).astype(dtype)
    with device.buffer(values) as buffer:
        assert buffer.read().dtype == np.dtype(dtype)
        assert_same(buffer.read(), values)


def test_structured_elements_read_back_with_their_fields(device: Device) -> None:
    rows = np.zeros(5, POINT)
    rows["position"] = np.arange(15).reshape(5, 3) / 8
    rows["color"] = 7
    rows["id"] = [1, 2, 3, 4, 65535]
    with device.buffer(rows) as buffer:
        back = buffer.read()
    assert back.dtype == POINT
    for name in ("position", "color", "id"):
        assert_same(back[name], rows[name])


def test_bits_of_a_float_are_kept(device: Device) -> None:
    odd = np.array([0x7FC00001, 0x80000000, 0x00000001, 0xFF800000], "u4").view("f4")
    with device.buffer(odd) as buffer:
        assert_same(buffer.read().view("u4"), odd.view("u4"))


def test_an_element_count_and_a_dtype_give_the_size(device: Device) -> None:
    with device.buffer(7, np.dtype("f8")) as buffer:
        assert buffer.size == 56
        assert buffer.read().shape == (7,)


@pytest.mark.parametrize(("first", "count"), [(0, 16), (0, 1), (15, 1), (5, 3), (0, 0), (16, 0)])
def test_a_read_of_a_range_gives_that_range(device: Device, first: int, count: int) -> None:
    with device.buffer(numbers(16)) as buffer:
        assert_same(buffer.read(first, count), numbers(16)[first : first + count])


def test_a_read_from_an_element_on_goes_to_the_end(device: Device) -> None:
    with device.buffer(numbers(16)) as buffer:
        assert_same(buffer.read(10), numbers(16)[10:])


def test_a_read_is_a_copy(device: Device) -> None:
    with device.buffer(numbers(4)) as buffer:
        buffer.read()[:] = 0
        assert_same(buffer.read(), numbers(4))


def test_a_read_outlives_later_writes(device: Device) -> None:
    with device.buffer(numbers(4)) as buffer:
        before = buffer.read()
        buffer.write(np.zeros(4, "u4"))
        assert_same(before, numbers(4))


@pytest.mark.parametrize(("first", "count"), [(0, 16), (0, 1), (15, 1), (5, 3), (16, 0)])
def test_a_write_changes_its_range_only(device: Device, first: int, count: int) -> None:
    expected = numbers(16)
    expected[first : first + count] = 99
    with device.buffer(numbers(16)) as buffer:
        buffer.write(np.full(count, 99, "u4"), first)
        assert_same(buffer.read(), expected)


@pytest.mark.parametrize("size", [4097, 65_536, 1_000_003])
def test_large_arrays_are_written_whole(device: Device, size: int) -> None:
    data = numbers(size, "u1")
    with device.buffer(data) as buffer, device.buffer(size) as other:
        assert_same(buffer.read(), data)
        other.write(data[: size // 2], size - size // 2)
        assert_same(other.read(size - size // 2), data[: size // 2])
        assert_same(other.read(0, size - size // 2), 0)


def test_an_array_that_is_not_contiguous_is_written_in_its_order(device: Device) -> None:
    with device.buffer(8, np.dtype("u4")) as buffer:
        buffer.write(numbers(16)[::-2])
        assert_same(buffer.read(), numbers(16)[::-2])


def test_the_array_may_change_right_after_a_write(device: Device) -> None:
    values = numbers(64)
    with device.buffer(64, np.dtype("u4")) as buffer:
        buffer.write(values)
        values[:] = 0
        assert_same(buffer.read(), numbers(64))


def test_the_last_of_two_writes_wins(device: Device) -> None:
    with device.buffer(4, np.dtype("u4")) as buffer:
        buffer.write(np.full(4, 1, "u4"))
        buffer.write(np.full(2, 2, "u4"), 1)
        assert_same(buffer.read(), [1, 2, 2, 1])


# -- locks -------------------------------------------------------------------------------------------------


def test_a_read_lock_exposes_the_data(device: Device) -> None:
    with device.buffer(numbers(8)) as buffer, buffer.lock(Access.READ) as array:
        assert_same(array, numbers(8))


def test_a_read_lock_cannot_be_written_to(device: Device) -> None:
    with device.buffer(numbers(8)) as buffer:
        with buffer.lock(Access.READ) as array, pytest.raises(ValueError, match="read-only"):
            array[0] = 1
        assert_same(buffer.read(), numbers(8))


def test_a_write_lock_replaces_its_range_at_its_end(device: Device) -> None:
    with device.buffer(numbers(8)) as buffer:
        with buffer.lock(Access.WRITE, 2, 3) as array:
            array[:] = [1, 2, 3]
        assert_same(buffer.read(), [*numbers(8)[:2], 1, 2, 3, *numbers(8)[5:]])


def test_changes_to_the_array_of_a_read_write_lock_are_written_back(device: Device) -> None:
    with device.buffer(np.arange(8, dtype="u4")) as buffer:
        with buffer.lock(Access.READ_WRITE, 4) as array:
            assert_same(array, [4, 5, 6, 7])
            array *= 10
        assert_same(buffer.read(), [0, 1, 2, 3, 40, 50, 60, 70])


def test_an_exception_inside_a_lock_writes_nothing(device: Device) -> None:
    with device.buffer(numbers(8)) as buffer:
        with pytest.raises(ZeroDivisionError), buffer.lock(Access.WRITE) as array:
            array[:] = 0
            raise ZeroDivisionError
        assert_same(buffer.read(), numbers(8))


def test_a_lock_of_structs_gives_fields(device: Device) -> None:
    with device.buffer(np.zeros(3, POINT)) as buffer:
        with buffer.lock(Access.READ_WRITE) as rows:
            rows["id"] = [4, 5, 6]
        assert_same(buffer.read()["id"], [4, 5, 6])


def test_two_buffers_may_be_locked_at_once(device: Device) -> None:
    with device.buffer(4, np.dtype("u4")) as first, device.buffer(4, np.dtype("u4")) as second:
        with first.lock(Access.WRITE) as a, second.lock(Access.WRITE) as b:
            a[:], b[:] = 1, 2
        assert_same(first.read(), 1)
        assert_same(second.read(), 2)


# -- copies and clears -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("offset", "target_offset", "size"), [(0, 0, 64), (0, 60, 4), (60, 0, 4), (4, 8, 32), (1, 3, 5)]
)
def test_a_copy_moves_its_bytes_only(device: Device, offset: int, target_offset: int, size: int) -> None:
    if any(number % device.capabilities.copy_alignment for number in (offset, target_offset, size)):
        pytest.skip(f"{device.backend_name} declares copy_alignment {device.capabilities.copy_alignment}")
    source, old = numbers(64, "u1"), np.arange(64, dtype="u1")
    expected = old.copy()
    expected[target_offset : target_offset + size] = source[offset : offset + size]
    with device.buffer(source) as a, device.buffer(old) as b:
        a.copy_to(b, size=size, offset=offset, target_offset=target_offset)
        assert_same(b.read(), expected)
        assert_same(a.read(), source)


def test_a_copy_within_a_buffer_moves_to_where_nothing_overlaps(device: Device) -> None:
    with device.buffer(np.arange(16, dtype="u1")) as buffer:
        buffer.copy_to(buffer, size=8, offset=0, target_offset=8)
        assert_same(buffer.read(), [*range(8), *range(8)])


@pytest.mark.parametrize("usage", [BufferUsage.STATIC, BufferUsage.STREAM])
def test_writes_of_cpu_and_device_take_turns(device: Device, usage: BufferUsage) -> None:
    """In random order, with reads between some of them, of a buffer of either usage."""
    random = np.random.default_rng(20)
    source = numbers(32)
    expected = np.zeros(32, "u4")
    with device.buffer(32, "u4", usage=usage) as buffer, device.buffer(source) as other:
        for step in range(60):
            first, count = int(random.integers(24)), int(random.integers(1, 9))
            kind = random.integers(4)
            if kind == 0:
                device.finish()  # ring memory is written where nothing uses it
                values = random.integers(1 << 32, size=count, dtype="u4")
                buffer.write(values, first)
                expected[first : first + count] = values
            elif kind == 1:
                other.copy_to(buffer, size=4 * count, offset=4 * first, target_offset=4 * first)
                expected[first : first + count] = source[first : first + count]
            elif kind == 2:
                buffer.clear(step)
                expected[:] = step
            else:
                assert_same(buffer.read(first, count), expected[first : first + count])
        assert_same(buffer.read(), expected)


def test_a_copy_reads_earlier_writes_and_not_later_ones(device: Device) -> None:
    with device.buffer(4, np.dtype("u4")) as a, device.buffer(4, np.dtype("u4")) as b:
        a.write(np.full(4, 1, "u4"))
        a.copy_to(b)
        a.write(np.full(4, 2, "u4"))
        assert_same(b.read(), 1)


@pytest.mark.parametrize("value", [0, 1, 0xDEADBEEF, 0xFFFFFFFF])
def test_a_clear_fills_with_its_pattern(device: Device, value: int) -> None:
    with device.buffer(numbers(17)) as buffer:
        buffer.clear(value)
        assert_same(buffer.read(), value)


def test_a_clear_stays_in_order_among_writes(device: Device) -> None:
    with device.buffer(numbers(4)) as buffer:
        buffer.clear(5)
        buffer.write(np.array([6], "u4"), 2)
        assert_same(buffer.read(), [5, 5, 6, 5])


# -- lifetime --------------------------------------------------------------------------------------------


def test_a_buffer_ends_with_its_with_block(device: Device) -> None:
    with device.buffer(4) as buffer:
        assert not buffer.destroyed
    assert buffer.destroyed
    buffer.destroy()


def test_many_buffers_hold_their_own_data(device: Device) -> None:
    buffers = [device.buffer(np.full(9, i, "u4")) for i in range(100)]
    for index, buffer in enumerate(buffers):
        assert_same(buffer.read(), index)
        buffer.destroy()
    gc.collect()
    with device.buffer(9, np.dtype("u4")) as fresh:
        assert_same(fresh.read(), 0)


def test_uploads_and_creations_are_counted(device: Device) -> None:
    before = device.statistics
    with device.buffer(numbers(25)) as buffer:
        buffer.write(numbers(5))
    after = device.statistics
    assert after.creations - before.creations == 1
    assert after.upload_bytes - before.upload_bytes == 120


class Bloom(Struct):
    """A field."""

    color: vec3
    reach: float


class Scene(Struct):
    """One field of each kind, with neighbours in the same 16 bytes."""

    power: float
    ids: uvec2
    position: vec3
    time: float
    rotation: mat3
    weights: Array[float] = array(float, 3)
    bloom: Bloom
    count: int


FIRST: dict[str, Any] = {
    "power": 1.0,
    "ids": (2, 3),
    "position": (4, 5, 6),
    "time": 7.0,
    "rotation": np.arange(9.0).reshape(3, 3),
    "weights": [1, 2, 3],
    "bloom": Bloom(color=(8, 9, 10), reach=11),
    "count": -12,
}
SECOND: dict[str, Any] = {
    "power": 2.5,
    "ids": (7, 8),
    "position": (-4, -5, -6),
    "time": 3,
    "rotation": np.eye(3),
    "weights": [4, 5, 6],
    "bloom": Bloom(color=(1, 0, 1), reach=2),
    "count": 99,
}


@pytest.mark.parametrize("name", FIRST)
def test_a_field_of_a_uniform_is_written_alone(device: Device, name: str) -> None:
    with device.uniform(Scene(**FIRST)) as scene:
        scene.write(**{name: SECOND[name]})
        expected = Scene(**(FIRST | {name: SECOND[name]})).to_bytes()
        assert scene.owner.read().tobytes() == expected


def test_two_fields_of_a_uniform_are_written_together(device: Device) -> None:
    with device.uniform(Scene(**FIRST)) as scene:
        scene.write(time=3, count=99)
        assert scene.owner.read().tobytes() == Scene(**(FIRST | {"time": 3, "count": 99})).to_bytes()


@pytest.mark.parametrize(
    "fields",
    [{"time": 4, "tiem": 5}, {"time": 4, "position": (1, 2)}],
    ids=["unknown name", "too few numbers"],
)
def test_a_write_of_a_wrong_field_is_refused_and_writes_none(device: Device, fields: dict[str, Any]) -> None:
    with device.uniform(Scene(**FIRST)) as scene:
        with pytest.raises(ValidationError, match=r"^\[shading-struct-value\]"):
            scene.write(**fields)
        assert scene.owner.read().tobytes() == Scene(**FIRST).to_bytes()


def test_a_write_of_a_struct_and_of_fields_is_refused_and_writes_nothing(device: Device) -> None:
    with device.uniform(Scene(**FIRST)) as scene:
        with pytest.raises(ValidationError):
            scene.write(Scene(**SECOND), time=4)
        assert scene.owner.read().tobytes() == Scene(**FIRST).to_bytes()


def test_a_uniform_that_is_a_number_has_no_fields_to_write(device: Device) -> None:
    with device.uniform(0.5) as single, pytest.raises(ValidationError):
        single.write(value=1.0)


def test_rows_of_a_struct_have_its_fields_as_attributes(device: Device) -> None:
    blooms = Bloom.array(4)
    blooms.reach[:] = [1, 2, 3, 4]
    blooms.color[1:3] = (5, 6, 7)
    blooms[0].color = (8, 9, 10)
    with device.storage(Bloom, blooms) as storage:
        blooms.reach[2] = 9
        storage.write(blooms[2:3], 2)
        back = storage.read()
    assert_same(back["color"], [(8, 9, 10), (5, 6, 7), (5, 6, 7), (0, 0, 0)])
    assert_same(back["reach"], [1, 2, 9, 4])
