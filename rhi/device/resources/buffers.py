"""Buffers: memory on the device as arrays of a NumPy dtype, and typed buffers for shader bindings.

- A lock provides a NumPy array for a range of elements (`rhi.device.resources.locks`).
- `UniformBuffer`, `UniformArray` and `StorageBuffer` add the type that a shader declares; they are the ranges
  that typed bindings accept.
"""

from __future__ import annotations

from functools import partial
from threading import get_ident
from typing import Any, Generic, NoReturn, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rhi.contract.backend import SupportsFilledBuffers, SupportsHostMemory
from rhi.contract.descriptors import Access, BufferDescriptor, BufferUsage
from rhi.contract.layout import (
    FLOAT,
    INT,
    UINT,
    Layout,
    accepts,
    compare_layouts,
    element_dtype,
    is_host_shareable,
    repack,
)
from rhi.contract.limits import buffer_copy_faults
from rhi.device.core.core import Core, find_optional_part
from rhi.device.resources.cuda import CudaMapping, CudaStream
from rhi.device.resources.exchange import ArrayExchange
from rhi.device.resources.lifetime import Resource, drop, retire
from rhi.device.resources.locks import Lock
from rhi.device.resources.readbacks import Readback
from rhi.errors import ValidationError, rules
from rhi.errors.arguments import ArgumentChecker, little_endian, to_integer
from rhi.errors.shared_caches import cache_once
from rhi.shading import Struct, ivec3, uint, uvec3, value_type_of, vec3
from rhi.shading.language.bindings import StorageRange, UniformRange
from rhi.shading.language.vectors import CLASSES, Composite

T = TypeVar("T")
MAX_BYTES = 1 << 40
_VECTORS_OF_3 = (vec3, ivec3, uvec3)


class Buffer(ArrayExchange, Resource):
    """Memory on the device: `count` elements of `dtype`. `np.asarray(buffer)` and `from_dlpack(buffer)` of other
    libraries read it, without a copy on cl.

    Attributes:
        id: the buffer's id in the command stream.
        dtype: the dtype of its elements, always little-endian.
        size: size in bytes.
        bind_uniform: a function of slot, offset and size that binds a range of the buffer.
    """

    __slots__ = ("bind_uniform", "core", "count", "destroyed", "dtype", "id", "label", "size")

    def __init__(
        self,
        core: Core,
        count: int,
        dtype: np.dtype[Any],
        usage: BufferUsage = BufferUsage.STATIC,
        label: str = "",
        data: NDArray[Any] | None = None,
    ) -> None:
        """Create a buffer of zeros, or of an array's elements, which are of `dtype`."""
        check = ArgumentChecker("device.buffer", core.refuse)
        check.choice("usage", usage, BufferUsage)
        check.text("label", label)
        dtype = little_endian(dtype)
        if (dtype.kind not in "biuf" and not _is_plain(dtype)) or dtype.itemsize == 0:
            core.refuse(rules.BUFFER_DTYPE, "device.buffer", f"dtype {dtype}", "a dtype of plain numbers")
        size = count * dtype.itemsize
        if not 0 < size < MAX_BYTES:
            core.refuse(
                rules.BUFFER_SIZE,
                "device.buffer",
                f"{count} elements of {dtype.itemsize} bytes",
                f"1 to {MAX_BYTES - 1} bytes",
            )
        self.core = core
        self.dtype = dtype
        self.count = count
        self.size = size
        self.label = label
        self.id = core.create_id()
        backend, descriptor = core.backend, BufferDescriptor(size, usage, label)
        if data is not None and usage is BufferUsage.STATIC and hasattr(backend, "create_filled_buffer"):
            fill = partial(cast("SupportsFilledBuffers", backend).create_filled_buffer, data=_bytes_of(data))
            core.create(fill, self.id, descriptor, size)
            core.upload_bytes += size
            data = None
        else:
            core.create(backend.create_buffer, self.id, descriptor, size)
        self.destroyed = False
        self.bind_uniform = core.prepare_uniform(self.id)
        if data is not None:
            self._upload(data, 0)

    def __del__(self) -> None:
        if not getattr(self, "destroyed", True):  # it isn't there if creation failed
            drop(self, self.id)

    def __len__(self) -> int:
        return self.count

    def __repr__(self) -> str:
        return f"Buffer({self.label!r}, {self.count} × {self.dtype})"

    def destroy(self) -> None:
        """Destroy the buffer once the GPU no longer uses it. A second call does nothing."""
        if not self.destroyed:
            self.core.check_thread("destroy")
            self.core.program = None
            retire(self)

    def read(self, first: int = 0, count: int | None = None) -> NDArray[Any]:
        """Return a copy of `count` elements from `first` on; waits for work that may write them.

        Examples:
            >>> buffer = device.buffer(np.arange(8))
            >>> buffer.read(2, 3).tolist()
            [2, 3, 4]
        """
        first, count = self._range("Buffer.read", first, count)
        return self._download(first, count)

    def read_async(self, first: int = 0, count: int | None = None) -> Readback:
        """Begin to read `count` elements from `first` on, as `read` does, and return their future at once.

        Elements that aren't aligned to `capabilities.copy_alignment` are read now, and the future is done.
        """
        first, count = self._range("Buffer.read_async", first, count)
        base, shape = self.dtype.subdtype or (self.dtype, ())
        size, alignment = self.dtype.itemsize, self.core.capabilities.copy_alignment
        readback = Readback(self.core, base, (count, *shape), 1, count * size)
        self.core.check_ready()
        if first * size % alignment or count * size % alignment:
            readback.complete(self._download(first, count))
        elif count:
            memory = readback.take_memory()
            self.core.backend.copy_buffer(self.id, first * size, memory, 0, count * size)
            readback.begin()
        else:
            readback.complete(np.zeros(0, base))
        return readback

    def write(self, data: NDArray[Any], first: int = 0) -> None:
        """Replace elements from `first` on, ordered after the work submitted before.

        Raises:
            ValidationError: `buffer-dtype` for another dtype, `buffer-range` beyond the end.

        Examples:
            >>> buffer = device.buffer(4, np.float32)
            >>> buffer.write(np.array([7, 8], np.float32), first=2)
            >>> buffer.read().tolist()
            [0.0, 0.0, 7.0, 8.0]
        """
        if (  # the usual case, in a quarter of the calls that `_match` and `_range` take
            data.__class__ is np.ndarray
            and (data.dtype == self.dtype or has_layout(data, self.dtype))
            and data.flags.c_contiguous
            and first.__class__ is int
            and 0 <= first <= self.count - data.nbytes // self.dtype.itemsize
        ):
            core = self.core
            if core.closed or core._context is not None or get_ident() != core.thread:  # seldom
                core.check_ready()
            if self.destroyed or core.locked:
                core.check_usable(self, "Buffer.write")
            if size := data.nbytes:
                core.upload_bytes += size
                contents = np.frombuffer(data, np.uint8).data
                core.backend.write_buffer(self.id, first * self.dtype.itemsize, contents)
            return
        array = self._match(data, "Buffer.write")
        first, _ = self._range("Buffer.write", first, len(array))
        self._upload(array, first)

    def lock(self, access: Access, first: int = 0, count: int | None = None) -> Lock:
        """Create a lock: `with buffer.lock(Access.WRITE, first, count) as array:`; offsets in elements.

        Examples:
            >>> buffer = device.buffer(np.arange(4))
            >>> with buffer.lock(rhi.Access.READ_WRITE, first=1, count=2) as numbers:
            ...     numbers *= 10
            >>> buffer.read().tolist()
            [0, 10, 20, 3]
        """
        ArgumentChecker("Buffer.lock", self.core.refuse).choice("access", access, Access)
        first, count = self._range("Buffer.lock", first, count)
        return Lock(
            self,
            access,
            read=lambda: self._download(first, count),
            make=lambda: self._array(None, count),
            write=lambda array: self._upload(array, first),
        )

    def cuda(self, stream: CudaStream | None = None) -> CudaMapping:
        """Create a mapping for CUDA: in `with buffer.cuda() as array:` kernels of CuPy, PyTorch or Numba
        read and write the buffer's own memory.

        It needs a gl device on a GPU of NVIDIA and `pip install "rhi[cuda]"`. Recordings don't see CUDA's work.

        Args:
            stream: the CUDA stream in which the buffer is used. The GPU orders its work after earlier draws
                and before later ones. None is CUDA's default stream.

        Raises:
            ValidationError: `device-capability` on other backends, `device-argument` for STREAM buffers,
                `pass-open` inside a render pass, `lock-open` for a locked or mapped buffer.
            DeviceError: `device-driver` if CUDA or its package is missing, or can't share the buffer.
        """
        return CudaMapping(self, stream)

    def clear(self, value: int = 0) -> None:
        """Fill the buffer with a 32-bit pattern; the size must be a multiple of 4 bytes.

        Examples:
            >>> buffer = device.buffer(np.arange(3, dtype=np.uint32))
            >>> buffer.clear(9)
            >>> buffer.read().tolist()
            [9, 9, 9]
        """
        self._clear(self.core, value)

    def copy_to(
        self,
        target: Buffer | StorageBuffer[Any],
        *,
        size: int | None = None,
        offset: int = 0,
        target_offset: int = 0,
    ) -> None:
        """Copy `size` bytes (None: all from `offset` on) on the device; offsets in bytes."""
        self._copy(self.core, target, size, offset, target_offset)

    def _clear(self, core: Core, value: int) -> None:
        """Send a `clear` to `core`: the buffer's own, or a command buffer's."""
        value = ArgumentChecker("Buffer.clear", self.core.refuse).integer(
            "value", value, -(1 << 31), (1 << 32) - 1
        )
        core.check_ready()
        core.check_usable(self, "Buffer.clear")
        if self.size % 4:
            self.core.refuse(
                rules.BUFFER_ALIGNMENT, "Buffer.clear", f"{self.size} bytes", "a multiple of 4 bytes"
            )
        core.backend.clear_buffer(self.id, 0, self.size, value & 0xFFFFFFFF)

    def _copy(
        self,
        core: Core,
        target: Buffer | StorageBuffer[Any],
        size: int | None,
        offset: int,
        target_offset: int,
    ) -> None:
        """Send a `copy_to` to `core`."""
        call = "Buffer.copy_to"
        check = ArgumentChecker(call, self.core.refuse)
        other = check_buffer(check, "target", target)
        offset = check.integer("offset", offset)
        target_offset = check.integer("target_offset", target_offset)
        size = self.size - offset if size is None else check.integer("size", size)
        core.check_ready()
        core.check_usable(self, call)
        core.check_usable(other, call)
        same, limits = other is self, core.capabilities
        self.core.require(
            call, buffer_copy_faults(self.size, offset, other.size, target_offset, size, same, limits)
        )
        core.backend.copy_buffer(self.id, offset, other.id, target_offset, size)

    def _view(self) -> NDArray[Any] | None:
        self._check("Buffer")
        backend = find_optional_part(self.core.backend, "host_memory")
        memory = cast("SupportsHostMemory", backend).host_memory(self.id) if backend is not None else None
        if memory is None:
            return None
        base, shape = self.dtype.subdtype or (self.dtype, ())
        view = memory[: self.size].view(base).reshape(self.count, *shape)
        view.flags.writeable = False
        return view

    def _read_array(self) -> NDArray[Any]:
        return self.read()

    def _check(self, call: str) -> None:
        self.core.check_ready()
        self.core.check_usable(self, call)

    def _match(self, data: NDArray[Any], call: str) -> NDArray[Any]:
        array = ArgumentChecker(call, self.core.refuse).array("data", data)
        base, shape = self.dtype.subdtype or (self.dtype, ())
        if array.dtype != base or (shape and array.shape[-len(shape) :] != shape):
            if array.dtype != base and (repacked := repack(base, array)) is not None:
                return repacked.reshape(-1)
            given, tip = f"shape {array.shape} of {array.dtype}", ""
            if base.names:
                given = compare_layouts(base, array.dtype)
            elif array.dtype != base and array.dtype.names is None:
                tip = f"array.astype(np.{base.name}) converts it"
            self.core.refuse(rules.BUFFER_DTYPE, call, given, str(self.dtype), tip)
        return np.ascontiguousarray(array).reshape(-1, *shape)

    def _range(self, call: str, first: int, count: int | None) -> tuple[int, int]:
        check = ArgumentChecker(call, self.core.refuse)
        first = check.integer("first", first)
        count = self.count - first if count is None else check.integer("count", count)
        self._check(call)
        if first < 0 or count < 0 or first + count > self.count:
            self.core.refuse(
                rules.BUFFER_RANGE, call, f"{count} elements from {first}", f"0 to {self.count} elements"
            )
        return first, count

    def _upload(self, array: NDArray[Any], first: int) -> None:
        if array.size:
            self._upload_bytes(_bytes_of(array), first * self.dtype.itemsize)

    def _upload_bytes(self, data: bytes | memoryview, offset: int) -> None:
        self.core.upload_bytes += len(data)
        self.core.backend.write_buffer(self.id, offset, data)

    def _download(self, first: int, count: int) -> NDArray[Any]:
        size = self.dtype.itemsize
        data = self.core.backend.read_buffer(self.id, first * size, count * size) if count else b""
        return self._array(data, count)

    def _array(self, data: bytes | None, count: int) -> NDArray[Any]:
        """Return `count` elements as an array; a subarray dtype adds its shape as trailing dimensions."""
        base, shape = self.dtype.subdtype or (self.dtype, ())
        if data is None:
            return np.zeros((count, *shape), base)
        return np.frombuffer(bytearray(data), base).reshape(count, *shape)


class UniformBuffer(UniformRange[T], Resource):
    """A buffer of constants, one struct or a single value, bound as `Uniform[T]`."""

    __slots__ = ()
    owner: Buffer

    def __init__(self, core: Core, value: Any, label: str = "") -> None:
        with core.refusals:  # also of structs, which may have no layout in memory
            check = ArgumentChecker("device.uniform")
            check.text("label", label)
            layout, constants = as_constants(check, value)
            data, dtype = constants.to_bytes(), type(constants).uniform_dtype
        owner = Buffer(core, 1, dtype, label=label or layout.__name__)
        super().__init__(owner.id, 0, owner.size, layout, owner)
        owner._upload_bytes(data, 0)

    def __repr__(self) -> str:
        return f"UniformBuffer({self.owner.label!r}, {_name(self.type)})"

    def write(self, value: T | None = None, /, **fields: Any) -> None:
        """Replace the constants, or some fields of a struct (`sun.write(power=3)`), ordered after the draws
        before.

        Raises:
            ValidationError: `layout-mismatch` for a value of another type, `shading-struct-value` for a field
                that the struct doesn't have or that doesn't take its value; then nothing is written.

        Examples:
            >>> tint = device.uniform(Tint(color=(1, 0, 0, 1)))
            >>> tint.write(Tint(color=(0, 1, 0, 1)))
            >>> tint.write(color=(0, 0, 1, 1))  # one field; others stay as they are
        """
        core, call = self.owner.core, "UniformBuffer.write"
        if value.__class__ is self.type and isinstance(value, Struct) and not fields:
            if core.closed or core._context is not None or get_ident() != core.thread:  # seldom
                core.check_ready()
            if self.owner.destroyed or core.locked:
                core.check_usable(self.owner, call)
            data = value.__dict__.get("_bytes") or value.to_bytes()
            core.upload_bytes += len(data)
            core.backend.write_buffer(self.buffer, 0, data)
            return
        if fields:
            if value is not None or not issubclass(self.type, Struct):  # type: ignore[arg-type]
                given = f"{', '.join(fields)} beside a value" if value is not None else ", ".join(fields)
                core.refuse(
                    rules.LAYOUT_MISMATCH, call, given, f"a {_name(self.type)}, or fields of a struct"
                )
            with core.refusals:
                parts = [self.type.pack_field(name, part) for name, part in fields.items()]  # type: ignore[attr-defined]
            self.owner._check(call)
            for offset, data in parts:
                self.owner._upload_bytes(data, offset)
            return
        with core.refusals:
            layout, constants = as_constants(ArgumentChecker(call, rule=rules.LAYOUT_MISMATCH), value)
            if layout is int and self.type in (float, uint):  # as an int is converted in a field of a struct
                layout, constants = self.type, _wrapper(self.type)(value=value)
        if layout is not self.type:
            core.refuse(
                rules.LAYOUT_MISMATCH, call, f"{value!r}, a {type(value).__name__}", f"a {_name(self.type)}"
            )
        self.owner._check(call)
        self.owner._upload_bytes(constants.to_bytes(), 0)

    def destroy(self) -> None:
        """Destroy the buffer once the GPU no longer uses it."""
        self.owner.destroy()


class UniformArray(Resource, Generic[T]):
    """Constants of many objects in one buffer, written as one array and bound one by one.

    `array[i]` is the range of element i, created once. `dtype` has the struct's std140 fields and an item
    size aligned for the device, so columns can be written at once: `rows = np.zeros(len(objects),
    objects.dtype); rows["model"] = models; objects.write(rows)`.
    """

    __slots__ = ("_ranges", "buffer", "dtype", "type")

    def __init__(self, core: Core, struct: Any, count: int, label: str = "") -> None:
        check = ArgumentChecker("device.uniform_array", core.refuse)
        if not isinstance(struct, type) or not issubclass(struct, Struct):
            check.fail("struct", struct, "a Struct class")
        count = check.integer("count", count)
        check.text("label", label)
        self.type = struct
        with core.refusals:  # a struct may have no layout in memory
            uniform_dtype = struct.uniform_dtype
        self.dtype = aligned_dtype(uniform_dtype, core.capabilities.uniform_alignment)
        self.buffer = Buffer(core, count, self.dtype, label=label or f"{struct.__name__}[]")
        stride, size = self.dtype.itemsize, uniform_dtype.itemsize
        self._ranges: list[UniformRange[T]] = [
            UniformRange(self.buffer.id, offset, size, struct, self.buffer)
            for offset in range(0, count * stride, stride)
        ]

    def __len__(self) -> int:
        return len(self._ranges)

    def __repr__(self) -> str:
        return f"UniformArray({self.buffer.label!r}, {len(self)} × {_name(self.type)})"

    def __getitem__(self, index: int) -> UniformRange[T]:
        return self._ranges[index]

    def write(self, values: NDArray[Any], first: int = 0) -> None:
        """Replace elements from `first` on.

        Raises:
            ValidationError: `layout-mismatch` with both layouts if the dtype is not `dtype`.
        """
        self.buffer.write(match_layout(self.buffer.core, values, self.dtype, "UniformArray.write"), first)

    def lock(self, access: Access, first: int = 0, count: int | None = None) -> Lock:
        """Create a lock: `with array.lock(Access.WRITE, first, count) as rows:`; offsets in elements."""
        return self.buffer.lock(access, first, count)

    def destroy(self) -> None:
        """Destroy the buffer once the GPU no longer uses it."""
        self.buffer.destroy()


class StorageBuffer(StorageRange[T], ArrayExchange, Resource):
    """A buffer of structs, scalars or vectors, bound as `Storage[T]` or `StorageRW[T]`. Other libraries read it
    as they do a `Buffer`."""

    __slots__ = ("dtype",)
    owner: Buffer

    def __init__(self, owner: Buffer, element: Any, dtype: np.dtype[Any]) -> None:
        count = owner.size // dtype.itemsize
        super().__init__(owner.id, 0, count * dtype.itemsize, element, count, owner)
        self.dtype = owner.dtype if owner.dtype == dtype else dtype  # the same object is compared faster

    def __repr__(self) -> str:
        return f"StorageBuffer({self.owner.label!r}, {self.count} × {_name(self.type)})"

    def __len__(self) -> int:
        return self.count

    def _view(self) -> NDArray[Any] | None:
        return self._typed()._view()

    def _read_array(self) -> NDArray[Any]:
        return self.read()

    def read(self, first: int = 0, count: int | None = None) -> NDArray[Any]:
        """Return a copy of elements; waits for work that may write them.

        Examples:
            >>> device.storage(int, [1, 2, 3]).read(1).tolist()
            [2, 3]
        """
        return self._typed().read(first, count)

    def read_async(self, first: int = 0, count: int | None = None) -> Readback:
        """Begin to read elements, as `read` does, and return their future at once."""
        return self._typed().read_async(first, count)

    def write(self, values: ArrayLike, first: int = 0) -> None:
        """Replace elements from `first` on. `values` is an array as for `Device.storage`; `layout-mismatch`
        for anything else.

        Examples:
            >>> numbers = device.storage(int, 4)
            >>> numbers.write([7, 8], first=2)
            >>> numbers.read().tolist()
            [0, 0, 7, 8]
        """
        owner, dtype = self.owner, self.dtype
        if owner.dtype != dtype:
            self._refuse_type()
        if values.__class__ is not np.ndarray or not (values.dtype == dtype or has_layout(values, dtype)):
            values = match_layout(owner.core, values, dtype, "StorageBuffer.write", self.type)
        owner.write(values, first)

    def lock(self, access: Access, first: int = 0, count: int | None = None) -> Lock:
        """Create a lock: `with array.lock(Access.WRITE, first, count) as rows:`; offsets in elements."""
        return self._typed().lock(access, first, count)

    def cuda(self, stream: CudaStream | None = None) -> CudaMapping:
        """Create a mapping for CUDA, as `Buffer.cuda` does."""
        return self._typed().cuda(stream)

    def clear(self, value: int = 0) -> None:
        """Fill the buffer with a 32-bit pattern."""
        self.owner.clear(value)

    def destroy(self) -> None:
        """Destroy the buffer once the GPU no longer uses it."""
        self.owner.destroy()

    def _typed(self) -> Buffer:
        if self.owner.dtype != self.dtype:
            self._refuse_type()
        return self.owner

    def _refuse_type(self) -> NoReturn:
        """Refuse to read or write the elements of a buffer of another dtype."""
        self.owner.core.refuse(
            rules.BUFFER_DTYPE,
            "StorageBuffer",
            str(self.owner.dtype),
            f"a buffer of {self.dtype}, or its own methods",
        )


def _bytes_of(array: NDArray[Any]) -> memoryview:
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data


def check_buffer(check: ArgumentChecker, name: str, buffer: Buffer | StorageBuffer[Any]) -> Buffer:
    """Return a buffer, or the buffer behind a `StorageBuffer`; refuse anything else."""
    owner = buffer.owner if isinstance(buffer, StorageBuffer) else buffer
    return check.instance(name, owner, Buffer, "a Buffer or StorageBuffer")


def storage_dtype(check: ArgumentChecker, element: Any) -> np.dtype[Any]:
    """Return the std430 dtype of a storage buffer's element; refuse a type that has none."""
    try:
        return element_dtype(value_type_of(element), Layout.STD430)
    except TypeError as error:
        allowed = "float, int, uint, a vector or matrix class, or a Struct class, without bools"
        check.fail("element", element, allowed, str(error))


def as_storage(
    check: ArgumentChecker,
    core: Core,
    element: Any,
    source: int | ArrayLike,
    dtype: np.dtype[Any],
    max_bytes: int,
) -> NDArray[Any]:
    """Return the first data of storage of these elements, 1 to `max_bytes` bytes: a number of zeros, or an
    array."""
    count = to_integer(source)
    array = None
    if count is None:
        array = match_layout(core, check.array("source", source), dtype, check.call, element)
    if array is not None and not array.ndim and array.dtype.names is None:
        check.fail("source", source, "a number of elements, or an array")
    size = array.nbytes if array is not None else (count or 0) * dtype.itemsize
    if not 0 < size <= max_bytes:
        core.refuse(rules.BUFFER_SIZE, check.call, f"{size} bytes", f"1 to {max_bytes} bytes")
    return np.zeros(count or 0, dtype) if array is None else np.ascontiguousarray(array)


def _name(kind: object) -> str:
    """Return the name of a type of the shading language."""
    return getattr(kind, "__name__", str(kind))


def _is_plain(dtype: np.dtype[Any]) -> bool:
    """True if a dtype consists of numbers alone, at any depth."""
    if dtype.subdtype is not None:
        return _is_plain(dtype.subdtype[0])
    if dtype.fields is not None:
        return all(_is_plain(field[0]) for field in dtype.fields.values())
    return dtype.kind in "biufcV"


def aligned_dtype(dtype: np.dtype[Any], alignment: int) -> np.dtype[Any]:
    """Return a dtype with the same fields and its item size rounded up to `alignment` bytes."""
    fields: Any = dtype.fields or {}
    names = list(dtype.names or ())
    return np.dtype(
        {
            "names": names,
            "formats": [fields[name][0] for name in names],
            "offsets": [fields[name][1] for name in names],
            "itemsize": -(-dtype.itemsize // alignment) * alignment,
        }
    )


def has_layout(array: NDArray[Any], expected: np.dtype[Any]) -> bool:
    """True if an array's elements are of the expected dtype; those of a subarray dtype are its last axes."""
    if expected.subdtype is None:
        return array.dtype == expected
    base, shape = expected.subdtype
    return array.dtype == base and array.shape[-len(shape) :] == shape


def match_layout(
    core: Core, array: ArrayLike, expected: np.dtype[Any], call: str, element: Any = None
) -> NDArray[Any]:
    """Return an array as one of the expected dtype; refuse another layout, showing both side by side.

    Numbers outside of structs are converted: whole ones exactly or not at all, floats rounded as a mesh's
    are. Vectors of three components take the place of four: if these are the `element`s, (n, 3) becomes
    (n, 4). Structs whose padding NumPy has dropped are padded again.
    """
    if array.__class__ is np.ndarray and has_layout(array, expected):  # the usual case, and the fastest
        return array
    values = ArgumentChecker(call, core.refuse).array("array", array)
    base, shape = expected.subdtype or (expected, ())
    kind = values.dtype.kind
    if base.names is None and values.dtype != base and (kind in "iu" or kind == base.kind == "f"):
        values = _convert(core, values, base, call)
    if shape == (4,) and values.shape[-1:] == (3,) and values.dtype == base and element in _VECTORS_OF_3:
        values = np.concatenate([values, np.zeros_like(values[..., :1])], axis=-1)
    if not accepts(base, values.dtype):
        repacked = repack(base, values)
        if repacked is not None:
            return repacked
        core.refuse(
            rules.LAYOUT_MISMATCH,
            call,
            f"shape {values.shape} of\n{compare_layouts(base, values.dtype)}",
            str(shape or ""),
        )
    if shape and values.shape[-len(shape) :] != shape:
        allowed = f"(n, {', '.join(map(str, shape))}) of {base}"
        core.refuse(
            rules.LAYOUT_MISMATCH,
            call,
            f"shape {values.shape} of {values.dtype}",
            allowed,
            "give an array of this shape",
        )
    return values if values.dtype == base else np.ascontiguousarray(values).view(base)


def _convert(core: Core, numbers: NDArray[Any], dtype: np.dtype[Any], call: str) -> NDArray[Any]:
    """Convert numbers to another dtype; refuse numbers that it can't hold."""
    with np.errstate(invalid="ignore", over="ignore"):
        converted = numbers.astype(dtype)
        if numbers.dtype.kind == "f":
            fits = np.isfinite(converted) | ~np.isfinite(numbers)
        else:  # back and forth is exact, unless the sign was lost on the way
            fits = (converted.astype(numbers.dtype) == numbers) & ((converted < 0) == (numbers < 0))
    if not fits.all():
        core.refuse(
            rules.LAYOUT_MISMATCH, call, f"{numbers[~fits][0]} of {numbers.dtype}", f"what {dtype} holds", ""
        )
    return converted


def as_constants(check: ArgumentChecker, value: Any) -> tuple[Any, Struct]:
    """Return the type as which a value is bound to a `Uniform`, and the value as a struct.

    A single value is laid out like a struct with one field. A number is a float, an int or a uint, an array
    of 2 to 4 numbers a vector, one of 2×2 to 4×4 floats a matrix; vectors and matrices of the shading
    language keep their type.
    """
    if isinstance(value, Struct):
        return type(value), value
    kind: Any = None
    if isinstance(value, (Composite, uint)):
        kind = type(value)
    elif isinstance(value, (int, float, np.number, np.ndarray)) and not isinstance(value, bool):
        array = check.array("value", value)
        scalar = {"f": FLOAT, "i": INT, "u": UINT}.get(array.dtype.kind)
        if not array.ndim:
            kind = {FLOAT: float, INT: int, UINT: uint}.get(scalar) if scalar is not None else None
        elif array.ndim == 1:
            kind = CLASSES.get((scalar, len(array)))
        elif array.shape == (len(array), len(array)) and scalar is FLOAT:
            kind = CLASSES.get(len(array))
    if kind is None or not is_host_shareable(value_type_of(kind)):
        allowed = (
            "a struct, e.g. Tint(scale=(1, 1, 1)), a number, "
            "or an array: 2 to 4 numbers, or 2×2 to 4×4 floats"
        )
        check.fail("value", value, allowed)
    return kind, _wrapper(kind)(value=value)


def pack_single(kind: Any, value: Any) -> bytes | None:
    """Return a number, vector or matrix as a uniform block of this type, None if it isn't one."""
    try:
        return _wrapper(kind)(value=value).to_bytes()
    except ValidationError:
        return None


@cache_once
def _wrapper(kind: Any) -> type[Struct]:
    """Return a struct class with one field, `value`, of a type of the shading language."""
    return type(kind.__name__, (Struct,), {"__annotations__": {"value": kind}})
