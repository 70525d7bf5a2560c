"""Buffers and textures as arrays of other libraries: `__array__` and DLPack."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from testing_kit import backend_works

import rhi
import rhi.shading as sl
from rhi import BufferUsage, Device, Format, TextureKind


class Doubling(sl.Shader):
    work_group = (4,)
    numbers: sl.StorageRW[float]

    def compute(self) -> None:
        self.numbers[sl.global_id().x] *= 2.0


class Point(sl.Struct):
    position: sl.vec3
    index: int


@pytest.fixture(params=["null", "gl", "cl", "wgpu"])
def device(request: pytest.FixtureRequest) -> Iterator[Device]:
    if not backend_works(request.param):
        pytest.skip(f"no device of {request.param} here")
    with rhi.create_device(request.param, record=request.param == "null") as opened:
        yield opened


@pytest.fixture
def cl_device() -> Iterator[Device]:
    if not backend_works("cl"):
        pytest.skip("no device of cl here")
    with rhi.create_device("cl", record=True) as opened:
        yield opened


DTYPES = ["u1", "i2", "u4", "i4", "f2", "f4", "f8"]


@pytest.mark.parametrize("usage", [BufferUsage.STATIC, BufferUsage.STREAM])
@pytest.mark.parametrize("dtype", DTYPES)
def test_a_buffer_is_an_array(device: Device, dtype: str, usage: BufferUsage) -> None:
    expected = np.arange(24).astype(dtype)
    buffer = device.buffer(expected, usage=usage)
    for array in (np.asarray(buffer), np.array(buffer), np.from_dlpack(buffer), np.array(buffer, copy=True)):
        assert array.dtype == dtype
        assert np.array_equal(array, expected)
    assert np.asarray(buffer, np.float64).tolist() == expected.tolist()
    assert buffer.__dlpack_device__() == (1, 0)
    assert (2 * np.asarray(buffer)).sum() == 2 * expected.sum()


def test_storage_of_vectors_and_structs_keeps_its_shape(device: Device) -> None:
    vectors = np.arange(12, dtype=np.float32).reshape(3, 4)
    storage = device.storage(sl.vec4, vectors)
    assert np.array_equal(np.asarray(storage), vectors)
    assert np.array_equal(np.from_dlpack(storage), vectors)
    points = np.zeros(5, Point.dtype)
    points["index"] = range(5)
    structs = device.storage(Point, points)
    assert np.asarray(structs)["index"].tolist() == [0, 1, 2, 3, 4]
    with pytest.raises(BufferError, match="no structs"):
        np.from_dlpack(structs)


@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 4), (3, 4, 5, 1), (2, 4, 5, 4)])
def test_a_texture_is_an_array_of_its_first_level(device: Device, shape: tuple[int, ...]) -> None:
    texels = np.arange(np.prod(shape)).reshape(shape).astype(np.uint8)
    kind = TextureKind.D2_ARRAY if len(shape) == 4 else TextureKind.D2
    texture = device.texture(texels, Format.R8 if shape[-1] in (1, 5) else Format.RGBA8, kind=kind)
    expected = texels[..., 0] if shape[-1] == 1 else texels
    assert np.array_equal(np.asarray(texture), expected)
    assert np.array_equal(np.from_dlpack(texture), expected)
    with pytest.raises(ValueError, match="without a copy"):
        texture.__array__(copy=False)  # as `np.asarray(texture, copy=False)` of NumPy 2 does


def test_work_before_is_in_the_array(device: Device) -> None:
    if not device.capabilities.compute:
        pytest.skip("needs compute")
    if device.backend_name == "null":
        pytest.skip("null runs no shaders by itself")
    numbers = device.storage(float, np.arange(4, dtype=np.float32))
    device.dispatch(device.program(Doubling), 1, numbers=numbers)
    assert np.asarray(numbers).tolist() == [0, 2, 4, 6]
    numbers.write(np.float32([5, 6, 7, 8]))
    assert np.from_dlpack(numbers).tolist() == [5, 6, 7, 8]


def test_other_memory_than_the_cpus_is_copied(device: Device) -> None:
    buffer = device.buffer(np.arange(4, dtype=np.float32))
    shares = device.backend_name == "cl"
    array = np.asarray(buffer)
    assert array.flags.writeable != shares
    if not shares:
        with pytest.raises(ValueError, match="without a copy"):
            buffer.__array__(copy=False)
        with pytest.raises(BufferError, match="without a copy"):
            buffer.__dlpack__(max_version=(1, 0), copy=False)
        array[:] = 9
        assert buffer.read().tolist() == [0, 1, 2, 3]


def test_memory_of_the_cpu_is_shared_and_read_only(cl_device: Device) -> None:
    numbers = cl_device.storage(float, np.arange(4, dtype=np.float32))
    array = numbers.__array__(copy=False)
    exchanged = np.from_dlpack(numbers)
    assert np.shares_memory(array, np.asarray(numbers))
    if np.lib.NumpyVersion(np.__version__) >= "2.1.0":  # before, NumPy takes no memory that can't be written
        assert np.shares_memory(array, exchanged)
    copy = np.array(numbers)
    assert not np.shares_memory(array, copy)
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 3
    cl_device.dispatch(cl_device.program(Doubling), 1, numbers=numbers)
    cl_device.finish()
    assert array.tolist() == [0, 2, 4, 6]
    assert exchanged.tolist() == ([0, 2, 4, 6] if np.shares_memory(array, exchanged) else [0, 1, 2, 3])
    assert copy.tolist() == [0, 1, 2, 3]


def test_shared_memory_outlives_its_buffer_and_the_device() -> None:
    if not backend_works("cl"):
        pytest.skip("no device of cl here")
    with rhi.create_device("cl") as device:
        arrays = [np.asarray(device.buffer(np.full(5000, i, np.float32))) for i in range(5)]
        device.finish()
    assert [set(array.tolist()) for array in arrays] == [{float(i)} for i in range(5)]


def test_old_consumers_of_dlpack_get_a_copy(cl_device: Device) -> None:
    """They know no read-only arrays."""

    class Old:
        def __init__(self, buffer: Any) -> None:
            self.buffer = buffer

        def __dlpack__(self, **arguments: Any) -> Any:
            return self.buffer.__dlpack__()

        def __dlpack_device__(self) -> tuple[int, int]:
            return (1, 0)

    buffer = cl_device.buffer(np.arange(4, dtype=np.float32))
    array = np.from_dlpack(Old(buffer))
    assert array.tolist() == [0, 1, 2, 3]
    assert not np.shares_memory(array, np.asarray(buffer))
    with pytest.raises(BufferError, match="copy"):
        buffer.__dlpack__(copy=False)


def test_another_device_is_refused(device: Device) -> None:
    buffer = device.buffer(np.zeros(4, np.float32))
    with pytest.raises(BufferError, match="device"):
        buffer.__dlpack__(dl_device=(2, 0))


@pytest.mark.parametrize("use", [np.asarray, np.from_dlpack])
def test_destroyed_objects_are_refused(device: Device, use: Any) -> None:
    resources = [
        device.buffer(np.zeros(4, np.float32)),
        device.storage(float, 4),
        device.texture((4, 4), Format.RGBA8),
    ]
    for resource in resources:
        resource.destroy()
        with pytest.raises(rhi.ValidationError, match="resource-destroyed"):
            use(resource)


def test_torch_reads_buffers_and_textures(device: Device) -> None:
    torch = pytest.importorskip("torch")
    buffer = device.buffer(np.arange(4, dtype=np.float32))
    assert torch.from_dlpack(buffer).tolist() == [0, 1, 2, 3]
    assert torch.from_dlpack(device.texture(np.zeros((4, 5, 4), np.uint8))).shape == (4, 5, 4)


def test_arrays_of_a_device_are_data_of_another(device: Device) -> None:
    with rhi.create_device("null") as other:
        buffer = device.buffer(np.arange(4, dtype=np.float32))
        assert other.buffer(np.asarray(buffer)).read().tolist() == [0, 1, 2, 3]
