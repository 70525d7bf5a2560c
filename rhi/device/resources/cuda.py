"""Buffers as CUDA memory: kernels of CuPy, Numba, PyTorch or CUDA itself write where draws read, without a copy.

- The device's OpenGL buffer is registered with CUDA once, and mapped for each `with` block. Draws and
  dispatches before the block end before CUDA's work in its stream begins; CUDA's work in the stream ends
  before draws after the block begin. Neither waits on the CPU.
- NVIDIA's `cuda.core` does both. It is imported by the first block.
- A mapped buffer counts as locked: the device refuses to use it until the block ends.
- Textures aren't mapped: CUDA gives access to them as opaque arrays. Copy through a buffer.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

import numpy as np

from rhi.device.core.core import Core, Owner, describe_object, find_optional_part
from rhi.errors import DeviceError, rules
from rhi.errors.device_objects import DeviceObject

if TYPE_CHECKING:
    from rhi.contract.backend import SupportsBufferNames

_CALL: Final = "Buffer.cuda"
_LEGACY_STREAM: Final = 1
"""The number of CUDA's legacy default stream in `__cuda_array_interface__`, where 0 isn't allowed."""


class TypedBuffer(Owner, Protocol):
    """A buffer of the device: `count` elements of `dtype`."""

    id: int
    dtype: np.dtype[Any]
    count: int


class CudaStream(Protocol):
    """A stream of another library, such as `cupy.cuda.Stream` or a stream of `cuda.core`."""

    def __cuda_stream__(self) -> tuple[int, int]:
        """Return the protocol's version and the stream's address."""


class CudaArray:
    """The elements of a mapped buffer, for `cupy.asarray`, `torch.as_tensor` and `numba.cuda.as_cuda_array`.

    Structs have no type that all of these know: their elements are rows of bytes.

    Attributes:
        shape: as that of `buffer.read()`.
        dtype: the type of one number.
        address: of the first byte, in CUDA's memory. It is valid until the `with` block ends.
    """

    __slots__ = ("_stream", "address", "dtype", "shape")

    def __init__(self, address: int, shape: tuple[int, ...], dtype: np.dtype[Any], stream: int) -> None:
        self.address = address
        self.shape = shape
        self.dtype = dtype
        self._stream = stream

    def __repr__(self) -> str:
        return f"CudaArray({self.shape}, {self.dtype})"

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        """The array as version 3 of Numba's CUDA array interface describes it."""
        return {
            "shape": self.shape,
            "typestr": self.dtype.str,
            "data": (self.address, False),
            "strides": None,
            "version": 3,
            "stream": self._stream or _LEGACY_STREAM,
        }


class CudaMapping(DeviceObject):
    """A `with buffer.cuda() as array:` block. Keep it and enter it for each frame: the buffer is registered
    with CUDA at the first entry, which takes longer than a mapping."""

    __slots__ = ("__weakref__", "_backend", "_buffer", "_mapped", "_resource", "_stream", "_stream_owner")

    def __init__(self, buffer: TypedBuffer, stream: CudaStream | None) -> None:
        core = buffer.core
        core.check_ready()
        core.check_usable(buffer, _CALL)
        if stream is not None and not hasattr(stream, "__cuda_stream__"):
            allowed = "a stream with __cuda_stream__, or None for CUDA's default stream"
            core.refuse(rules.DEVICE_ARGUMENT, _CALL, f"stream={stream!r}", allowed)
        backend = find_optional_part(core.backend, "name_buffer")
        if backend is None:
            given = f"a {core.capabilities.backend} device"
            tip = 'create the device on OpenGL, rhi.create_device("gl"), or copy: buffer.read()'
            core.refuse(rules.DEVICE_CAPABILITY, _CALL, given, "a gl device on a GPU of NVIDIA", tip)
        self._buffer = buffer
        self._backend = cast("SupportsBufferNames", backend)
        self._stream_owner = stream
        self._resource: Any = None
        self._stream: Any = None
        self._mapped: Any = None

    def __enter__(self) -> CudaArray:
        buffer, core = self._buffer, self._buffer.core
        core.check_ready()
        core.check_usable(buffer, _CALL)  # also where it is mapped already
        if core.has_open_pass():
            core.refuse(rules.PASS_OPEN, _CALL, describe_object(buffer))
        name = self._backend.name_buffer(buffer.id)  # each time, as CUDA changes what the buffer has
        if not name:
            tip = "keep a STATIC buffer for CUDA, and copy_to between both"
            core.refuse(rules.DEVICE_ARGUMENT, _CALL, "a STREAM buffer", "a STATIC buffer", tip)
        cuda = _import_cuda(core)
        try:
            if self._resource is None:
                device = cuda.Device()
                device.set_current()
                owner = self._stream_owner
                self._stream = device.default_stream if owner is None else device.create_stream(owner)
                self._resource = cuda.GraphicsResource.from_gl_buffer(name)
            mapped = self._resource.map(stream=self._stream)
        except Exception as error:  # CUDA's, and those of the loader of its driver: they have no base
            tip = "CUDA needs NVIDIA's driver, and the device of OpenGL on the same GPU"
            core.refusals.fail(DeviceError(rules.DEVICE_DRIVER, _CALL, str(error), tip=tip))
        self._mapped = mapped
        core.program = None  # from now on every draw checks whether it uses a locked resource
        try:
            core.lock(buffer, self)
            return self._make_array(int(mapped.handle), int(self._stream.handle))
        except BaseException:  # an interrupt; nobody will end the mapping
            core.unlock(self)
            self._unmap()
            raise

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        core = self._buffer.core
        core.check_thread("the end of a CUDA mapping")
        if self._mapped is None:
            core.refuse(rules.LOCK_CLOSED, _CALL, "a mapping that is not open")
        core.unlock(self)
        if not core.closed:
            core.check_ready()  # CUDA needs the context of OpenGL
        self._unmap()

    def close(self) -> None:
        """End the registration with CUDA. Entering the block registers the buffer again."""
        resource, self._resource = self._resource, None
        if resource is not None:
            resource.close()

    def _unmap(self) -> None:
        mapped, self._mapped = self._mapped, None
        mapped.close()

    def _make_array(self, address: int, stream: int) -> CudaArray:
        buffer = self._buffer
        base, shape = buffer.dtype.subdtype or (buffer.dtype, ())
        if base.names is not None:
            base, shape = np.dtype(np.uint8), (buffer.dtype.itemsize,)
        return CudaArray(address, (buffer.count, *shape), base, stream)


def _import_cuda(core: Core) -> ModuleType:
    try:
        import cuda.core
    except ImportError as error:
        tip = 'pip install "rhi[cuda]"'
        core.refusals.fail(DeviceError(rules.DEVICE_DRIVER, _CALL, str(error), tip=tip))
    return cast("ModuleType", cuda.core)
