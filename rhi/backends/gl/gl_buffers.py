"""Buffers: moderngl's own, and persistently mapped STREAM and READBACK buffers.

- Tables are dictionaries by id. The two that a draw uses hold moderngl's bound C methods, which cost a tenth
  of a ctypes call with as many arguments.
- A STREAM buffer is mapped once, persistently and coherently. Writing it is a copy into that memory,
  unordered as the contract allows. A READBACK buffer is mapped in the same way to be read.
- NVIDIA's driver (580) executes a clear after a `BufferSubData` that follows it, unless the clear has
  finished. Copies, reads and draws keep their order. So new buffers get zeros as their data, and a write
  waits for a buffer's clears.
- llvmpipe lets a write wait for the fragments that read a buffer only if the buffer was made for storage,
  which moderngl's buffers aren't (Mesa 22.3). So the backend allocates such a buffer's memory again. It does
  so for each write of a whole storage buffer, such as a frame's lights: the write waits for nothing, and
  frames overlap.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import partial
from typing import Any, Final, TypeAlias

import moderngl
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.gl_errors import drain_errors, find_error
from rhi.contract.descriptors import BufferDescriptor, BufferUsage, Id
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_MEMORY

BindRange: TypeAlias = Callable[[int, int, int], object]
"""(slot, offset, size)"""

_PERSISTENT: Final = enums.MAP_PERSISTENT_BIT | enums.MAP_COHERENT_BIT
_MAP_FLAGS: Final = {
    BufferUsage.STREAM: enums.MAP_WRITE_BIT | _PERSISTENT,
    BufferUsage.READBACK: enums.MAP_READ_BIT | _PERSISTENT,
}
_MAX_RENEWED_BYTES: Final = (
    1 << 20
)  # bytes; a write to a larger buffer waits instead of allocating as much memory again
_MODERNGL_MAX_SIZE: Final = (1 << 31) - 1  # of an external buffer; binding its ranges is 64-bit


class Buffers:
    """The buffers of one context.

    Attributes:
        bind_uniform, bind_storage: by id, the functions that bind a range of a buffer to a slot.
        objects: by id, moderngl's buffers.
    """

    def __init__(self, context: moderngl.Context, gl: EntryPoints, keeps_order: bool) -> None:
        """`keeps_order`: whether the driver's writes wait for draws that read the buffer, whatever its
        usage."""
        self._context = context
        self._gl = gl
        self._keeps_order = keeps_order
        self._hints: dict[Id, int] = {}  # the latest usage hint of buffers that whole writes renew
        self.objects: dict[Id, moderngl.Buffer] = {}
        self.bind_uniform: dict[Id, BindRange] = {}
        self.bind_storage: dict[Id, BindRange] = {}
        self._mappings: dict[Id, memoryview] = {}
        self._readable: dict[Id, memoryview] = {}
        self._cleared: set[Id] = set()
        self._names: set[int] = set()  # GL's, of buffers that moderngl didn't make and doesn't delete
        self._stored: set[Id] = set()  # that were bound as storage, so that shaders may write them
        self._watchers: dict[Id, Callable[[Id], None]] = {}

    def create(self, buffer: Id, descriptor: BufferDescriptor, data: BytesLike | None = None) -> None:
        """Create a buffer of zeros, or a STATIC one of `data`."""
        drain_errors(self._gl)
        call, flags = f"device.buffer(size={descriptor.size})", _MAP_FLAGS.get(descriptor.usage)
        try:  # zeros are pages that don't exist before the driver reads them
            contents = np.zeros(descriptor.size if data is None else 0, np.uint8)
        except MemoryError as failure:
            raise DeviceError(DEVICE_MEMORY, call, str(failure)) from None
        if data is not None:
            contents = np.frombuffer(memoryview(data), np.uint8)
        if flags is None:
            created, mapping = self._create_static(contents), None
        else:
            created, mapping = self._create_mapped(contents, flags)
        error = find_error(self._gl, call)
        if error is not None:
            self._release(created)
            raise error
        if mapping is not None:
            readable = descriptor.usage is BufferUsage.READBACK
            (self._readable if readable else self._mappings)[buffer] = mapping
        if descriptor.label:
            self._gl.ObjectLabel(enums.BUFFER, created.glo, -1, descriptor.label.encode())
        self.objects[buffer] = created
        self.bind_uniform[buffer] = created.mglo.bind_to_uniform_block
        self.bind_storage[buffer] = partial(self._begin_storage, buffer)

    def _begin_storage(self, buffer: Id, slot: int, offset: int, size: int) -> None:
        """Note that shaders may write a buffer from now on, since it is bound as storage for the first
        time."""
        self.note_change(buffer)
        self._stored.add(buffer)
        is_mapped = buffer in self._mappings or buffer in self._readable
        if not self._keeps_order and not is_mapped and self.objects[buffer].size <= _MAX_RENEWED_BYTES:
            self._hints[buffer] = enums.DYNAMIC_DRAW
        bind = self.bind_storage[buffer] = self.objects[buffer].mglo.bind_to_storage_buffer
        bind(slot, offset, size)

    def _create_static(self, contents: NDArray[np.uint8]) -> moderngl.Buffer:
        if self._keeps_order:
            return self._context.buffer(contents)
        if len(contents) <= _MODERNGL_MAX_SIZE:  # moderngl's own allocation would be thrown away
            created = self._wrap(self._gl.create(self._gl.CreateBuffers), len(contents))
        else:
            created = self._context.buffer(reserve=len(contents))
        self._renew(created, contents, enums.DYNAMIC_DRAW)
        return created

    def _renew(self, buffer: moderngl.Buffer, data: NDArray[Any], hint: int) -> None:
        """Replace a buffer's memory; draws in flight use the old one.

        Mesa allocates new memory only if the usage hint differs from the one before."""
        gl, target = self._gl, enums.SHADER_STORAGE_BUFFER
        gl.BindBuffer(target, buffer.glo)
        gl.BufferData(target, data.nbytes, ctypes.c_void_p(data.ctypes.data), hint)
        gl.BindBuffer(target, 0)

    def _create_mapped(
        self, zeros: NDArray[np.uint8], flags: int
    ) -> tuple[moderngl.Buffer, memoryview | None]:
        gl, size = self._gl, len(zeros)
        name = gl.create(gl.CreateBuffers)
        gl.NamedBufferStorage(name, size, zeros.ctypes.data_as(ctypes.c_void_p), flags)
        address = gl.MapNamedBufferRange(name, 0, size, flags)
        created = self._wrap(name, min(size, _MODERNGL_MAX_SIZE))
        if not address:
            return created, None
        return created, memoryview((ctypes.c_char * size).from_address(address)).cast("B")

    def watch(self, buffer: Id, call: Callable[[Id], None]) -> bool:
        """Call `call` once, before a buffer's data next changes. Return False if changes can't be
        observed."""
        if buffer in self._mappings or buffer in self._readable or buffer in self._stored:
            return False
        self._watchers[buffer] = call
        return True

    def note_change(self, buffer: Id) -> None:
        """Call what `watch` registered for a buffer, since its data changes."""
        watcher = self._watchers.pop(buffer, None)
        if watcher is not None:
            watcher(buffer)

    def share(self, buffer: Id) -> int:
        """Return GL's name of a buffer that other interfaces write from now on, so that its memory stays
        where it is; 0 if the CPU has its memory mapped."""
        if buffer in self._mappings or buffer in self._readable:
            return 0
        self.note_change(buffer)
        self._stored.add(buffer)
        self._hints.pop(buffer, None)
        created = self.objects[buffer]
        self.bind_storage[buffer] = created.mglo.bind_to_storage_buffer
        return created.glo

    def destroy(self, buffer: Id) -> None:
        self.note_change(buffer)
        self._stored.discard(buffer)
        del self.bind_uniform[buffer], self.bind_storage[buffer]
        self._mappings.pop(buffer, None)
        self._readable.pop(buffer, None)
        self._cleared.discard(buffer)
        self._hints.pop(buffer, None)
        self._release(self.objects.pop(buffer))

    def _wrap(self, name: int, size: int) -> moderngl.Buffer:
        """Return a moderngl buffer for an existing GL buffer, which moderngl doesn't delete."""
        self._names.add(name)
        return self._context.external_buffer(name, size)

    def _release(self, created: moderngl.Buffer) -> None:
        name = created.glo
        created.release()
        if name in self._names:
            self._names.discard(name)
            self._gl.delete(self._gl.DeleteBuffers, name)

    def write(self, buffer: Id, offset: int, data: BytesLike) -> None:
        mapping = self._mappings.get(buffer)
        if mapping is None:
            if self._watchers:
                self.note_change(buffer)
            if buffer in self._cleared:
                self._gl.Finish()
                self._cleared.clear()
            written, hint = self.objects[buffer], self._hints.get(buffer)
            if hint is None or memoryview(data).nbytes < written.size:
                written.mglo.write(data, offset)
                return
            hint = enums.DYNAMIC_DRAW if hint == enums.DYNAMIC_COPY else enums.DYNAMIC_COPY
            self._hints[buffer] = hint
            self._renew(written, np.frombuffer(memoryview(data), np.uint8), hint)
            return
        try:
            mapping[offset : offset + len(data)] = data  # type: ignore[arg-type]
        except (ValueError, TypeError, NotImplementedError):  # no flat bytes; nothing was copied
            source = np.frombuffer(memoryview(data), np.uint8)
            mapping[offset : offset + len(source)] = source.data

    def read(self, buffer: Id, offset: int, size: int) -> bytes:
        readable = self._readable.get(buffer)
        if readable is not None:
            return bytes(readable[offset : offset + size])
        if buffer not in self._mappings:
            return bytes(self.objects[buffer].mglo.read(size, offset))
        data = ctypes.create_string_buffer(size)
        self._gl.GetNamedBufferSubData(self.objects[buffer].glo, offset, size, data)
        return data.raw

    def peek(self, buffer: Id, offset: int, size: int) -> bytes:
        """Return bytes as `read` does, on drivers whose mapped memory is the CPU's own."""
        mapping = self._mappings.get(buffer)
        return self.read(buffer, offset, size) if mapping is None else bytes(mapping[offset : offset + size])

    def copy(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        self.note_change(target)
        self._gl.CopyNamedBufferSubData(
            self.objects[source].glo, self.objects[target].glo, source_offset, target_offset, size
        )

    def clear(self, buffer: Id, offset: int, size: int, value: int) -> None:
        self.note_change(buffer)
        self._cleared.add(buffer)
        self._gl.ClearNamedBufferSubData(
            self.objects[buffer].glo,
            enums.R32UI,
            offset,
            size,
            enums.RED_INTEGER,
            enums.UNSIGNED_INT,
            ctypes.byref(ctypes.c_uint(value)),
        )
