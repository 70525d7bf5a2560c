"""Buffers as CUDA memory. The driver's part is played by a module that records its calls and writes into the
OpenGL buffer; a last test runs NVIDIA's package itself, up to the driver that is missing here."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from testing_kit import backend_works

import rhi
import rhi.shading as sl
from rhi import BufferUsage, Device, DeviceError, Format, ValidationError
from rhi.errors import rules

COUNT = 6


class Doubling(sl.Shader):
    work_group = (6,)
    numbers: sl.StorageRW[float]

    def compute(self) -> None:
        self.numbers[sl.global_id().x] *= 2.0


class Point(sl.Struct):
    position: sl.vec3
    index: int


class Stream:
    """A stream of another library."""

    def __cuda_stream__(self) -> tuple[int, int]:
        return 0, 4242


class CUDAError(Exception):
    """An error of CUDA, as `cuda.core` raises it."""


class Driver:
    """CUDA as `cuda.core` shows it: `calls` are those that were made, `fault` the next one's error."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.memory = (ctypes.c_float * COUNT)()
        self.fault: Exception | None = None

    def call(self, *call: Any) -> None:
        self.calls.append(call)
        fault, self.fault = self.fault, None
        if fault is not None:
            raise fault

    def module(self) -> ModuleType:
        driver = self

        class StreamHandle:
            def __init__(self, handle: int) -> None:
                self.handle = handle

        class CudaDevice:
            def set_current(self) -> None:
                driver.call("set_current")

            default_stream = StreamHandle(0)

            def create_stream(self, owner: Stream) -> StreamHandle:
                return StreamHandle(owner.__cuda_stream__()[1])

        class Mapped:
            handle = ctypes.addressof(driver.memory)

            def close(self) -> None:
                driver.call("unmap")

        class GraphicsResource:
            @classmethod
            def from_gl_buffer(cls, name: int) -> GraphicsResource:
                driver.call("register", name)
                return cls()

            def map(self, *, stream: StreamHandle) -> Mapped:
                driver.call("map", stream.handle)
                return Mapped()

            def close(self) -> None:
                driver.call("unregister")

        module = ModuleType("cuda.core")
        vars(module).update(Device=CudaDevice, GraphicsResource=GraphicsResource)
        return module


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Driver:
    driver, package = Driver(), ModuleType("cuda")
    core = vars(package)["core"] = driver.module()
    monkeypatch.setitem(sys.modules, "cuda", package)
    monkeypatch.setitem(sys.modules, "cuda.core", core)
    return driver


@pytest.fixture
def gl() -> Iterator[Device]:
    if not backend_works("gl"):
        pytest.skip("no device of gl here")
    with rhi.create_device("gl") as device:
        yield device


def test_a_block_maps_the_buffer_s_own_name(gl: Device, driver: Driver) -> None:
    buffer = gl.buffer(np.zeros(COUNT, np.float32))
    backend = gl.backend_as(rhi.backends.gl.gl_backend.GlBackend)
    with buffer.cuda() as array:
        assert driver.calls == [
            ("set_current",),
            ("register", backend._buffers.objects[buffer.id].glo),
            ("map", 0),
        ]
        assert array.__cuda_array_interface__ == {
            "shape": (COUNT,),
            "typestr": "<f4",
            "data": (ctypes.addressof(driver.memory), False),
            "strides": None,
            "version": 3,
            "stream": 1,
        }
    assert driver.calls[3:] == [("unmap",)]


def test_a_mapping_that_is_kept_registers_once(gl: Device, driver: Driver) -> None:
    mapping = gl.buffer(COUNT, np.float32).cuda(Stream())
    for _ in range(3):
        with mapping as array:
            assert array.__cuda_array_interface__["stream"] == 4242
    mapping.close()
    mapping.close()
    with mapping:
        pass
    names = [call[0] for call in driver.calls]
    assert names == [
        "set_current",
        "register",
        *("map", "unmap") * 3,
        "unregister",
        "set_current",
        "register",
        "map",
        "unmap",
    ]


@pytest.mark.parametrize(
    ("dtype", "shape", "typestr"),
    [
        (np.dtype("f8"), (COUNT,), "<f8"),
        (np.dtype("u2"), (COUNT,), "<u2"),
        (np.dtype(("f4", (3,))), (COUNT, 3), "<f4"),
        (np.dtype([("a", "f4"), ("b", "u4")]), (COUNT, 8), "|u1"),
    ],
    ids=str,
)
def test_elements_keep_their_shape_and_structs_are_bytes(
    gl: Device, driver: Driver, dtype: np.dtype[Any], shape: tuple[int, ...], typestr: str
) -> None:
    with gl.buffer(COUNT, dtype).cuda() as array:
        interface = array.__cuda_array_interface__
    assert (interface["shape"], interface["typestr"]) == (shape, typestr)


def test_storage_is_mapped_too(gl: Device, driver: Driver) -> None:
    storage = gl.storage(Point, 3)
    with storage.cuda() as array:
        assert array.shape == (3, storage.dtype.itemsize)
    assert [call[0] for call in driver.calls] == ["set_current", "register", "map", "unmap"]


def test_the_device_refuses_a_mapped_buffer_until_the_block_ends(gl: Device, driver: Driver) -> None:
    numbers, program = gl.storage(float, np.ones(COUNT)), gl.program(Doubling)
    gl.dispatch(program, 1, numbers=numbers)
    mapping = numbers.cuda()
    with mapping:
        for use in (
            lambda: gl.dispatch(program, 1, numbers=numbers),
            lambda: numbers.write([1.0]),
            lambda: numbers.read(),
            numbers.cuda,
            mapping.__enter__,
        ):
            with pytest.raises(ValidationError) as refusal:
                use()
            assert refusal.value.rule is rules.LOCK_OPEN
    gl.dispatch(program, 1, numbers=numbers)
    assert numbers.read().tolist() == [4.0] * COUNT
    assert [call[0] for call in driver.calls] == ["set_current", "register", "map", "unmap"]


def test_an_exception_in_the_block_ends_the_mapping(gl: Device, driver: Driver) -> None:
    buffer = gl.buffer(COUNT, np.float32)
    with pytest.raises(KeyError), buffer.cuda():
        raise KeyError
    assert driver.calls[-1] == ("unmap",)
    assert buffer.read().tolist() == [0.0] * COUNT


def test_the_memory_of_a_shared_buffer_stays_where_it_is(
    gl: Device, driver: Driver, monkeypatch: pytest.MonkeyPatch
) -> None:
    storage, program = gl.storage(float, np.ones(COUNT)), gl.program(Doubling)
    gl.dispatch(program, 1, numbers=storage)
    buffers = gl.backend_as(rhi.backends.gl.gl_backend.GlBackend)._buffers
    renewed = buffers._renew
    renewals: list[Any] = []

    def renew(*arguments: Any) -> None:
        renewals.append(arguments)
        renewed(*arguments)

    monkeypatch.setattr(buffers, "_renew", renew)
    storage.write(np.full(COUNT, 2.0, np.float32))
    before = len(renewals)
    with storage.cuda():
        pass
    gl.dispatch(program, 1, numbers=storage)
    storage.write(np.full(COUNT, 3.0, np.float32))
    assert len(renewals) == before
    gl.dispatch(program, 1, numbers=storage)
    assert storage.read().tolist() == [6.0] * COUNT


def test_a_block_inside_a_pass_is_refused(gl: Device, driver: Driver) -> None:
    buffer = gl.buffer(COUNT, np.float32)
    with gl.render_pass(gl.texture((4, 4), Format.RGBA8)), pytest.raises(ValidationError) as refusal:
        buffer.cuda().__enter__()
    assert refusal.value.rule is rules.PASS_OPEN
    assert driver.calls == []


def test_a_buffer_that_the_cpu_has_mapped_is_refused(gl: Device, driver: Driver) -> None:
    with pytest.raises(ValidationError, match="copy_to between both") as refusal:
        gl.buffer(COUNT, np.float32, usage=BufferUsage.STREAM).cuda().__enter__()
    assert refusal.value.rule is rules.DEVICE_ARGUMENT
    assert driver.calls == []


def test_wrong_streams_and_destroyed_buffers_are_refused(gl: Device, driver: Driver) -> None:
    buffer = gl.buffer(COUNT, np.float32)
    with pytest.raises(ValidationError, match="__cuda_stream__") as refusal:
        buffer.cuda(7)  # type: ignore[arg-type]
    assert refusal.value.rule is rules.DEVICE_ARGUMENT
    mapping = buffer.cuda()
    with pytest.raises(ValidationError) as refusal:
        mapping.__exit__(None, None, None)
    assert refusal.value.rule is rules.LOCK_CLOSED
    buffer.destroy()
    with pytest.raises(ValidationError) as refusal:
        mapping.__enter__()
    assert refusal.value.rule is rules.RESOURCE_DESTROYED
    assert driver.calls == []


@pytest.mark.parametrize("step", ["register", "map"])
def test_a_fault_of_the_driver_is_named_and_leaves_nothing_locked(
    gl: Device, driver: Driver, step: str
) -> None:
    buffer = gl.buffer(COUNT, np.float32)
    mapping = buffer.cuda()
    if step == "map":
        with mapping:
            pass
    driver.fault = CUDAError("CUDA_ERROR_INVALID_GRAPHICS_CONTEXT")
    with pytest.raises(DeviceError, match="INVALID_GRAPHICS_CONTEXT") as failure:
        mapping.__enter__()
    assert failure.value.rule is rules.DEVICE_DRIVER
    assert "same GPU" in failure.value.tip
    buffer.write(np.ones(COUNT, np.float32))
    with mapping:
        pass


@pytest.mark.parametrize("backend", ["null", "cl", "wgpu"])
def test_other_backends_name_the_copy_to_use(backend: str, driver: Driver) -> None:
    if not backend_works(backend):
        pytest.skip(f"no device of {backend} here")
    with (
        rhi.create_device(backend) as device,
        pytest.raises(ValidationError, match="or copy: ") as refusal,
    ):
        device.buffer(COUNT, np.float32).cuda()
    assert refusal.value.rule is rules.DEVICE_CAPABILITY


def test_without_its_package_the_extra_is_named(gl: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cuda", None)
    with pytest.raises(DeviceError, match=r"rhi\[cuda\]") as failure:
        gl.buffer(COUNT, np.float32).cuda().__enter__()
    assert failure.value.rule is rules.DEVICE_DRIVER


def test_nvidia_s_own_package_shares_the_buffer_or_says_why_not(gl: Device) -> None:
    core = pytest.importorskip("cuda.core", reason="no cuda.core: pip install rhi[cuda]")
    buffer = gl.buffer(np.zeros(COUNT, np.float32))
    try:
        with buffer.cuda() as array:
            assert array.address
            mapped = core.Buffer.from_handle(array.address, COUNT * 4)
            mapped.fill(1, stream=core.Device().default_stream)
    except DeviceError as error:
        assert error.rule is rules.DEVICE_DRIVER  # noqa: PT017 (a computer without CUDA raises it)
        assert buffer.read().tolist() == [0.0] * COUNT
        return
    assert buffer.read().view(np.uint8).tolist() == [1] * COUNT * 4
