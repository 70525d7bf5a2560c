"""Buffers.

- Sizes are rounded up to 16 bytes. A write of other than whole words reads the words around it first.
- STREAM buffers have a copy on the CPU; what was written of it is uploaded before each submission. Once the
  device writes one, it has no copy any longer.
- READBACK buffers are mapped to be read.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from typing_extensions import Buffer as BytesLike

from rhi.backends.webgpu.command_encoder import Stream
from rhi.backends.webgpu.implementation import GpuObject, Mappings
from rhi.backends.webgpu.webgpu_errors import translate_errors
from rhi.backends.webgpu.webgpu_flags import GpuBufferUsage as Usage
from rhi.contract.descriptors import BufferDescriptor, BufferUsage, Id
from rhi.contract.formats import IndexFormat
from rhi.contract.interrupts import DeferredInterrupts

ALL_USES: Final = (
    Usage.COPY_SRC
    | Usage.COPY_DST
    | Usage.VERTEX
    | Usage.INDEX
    | Usage.UNIFORM
    | Usage.STORAGE
    | Usage.INDIRECT
)
READ: Final = Usage.COPY_DST | Usage.MAP_READ
GAP: Final = 256
"""Ranges of a STREAM buffer closer than this many bytes are uploaded together."""
_MAX_STAGING: Final = 1 << 22
"""Read buffers of more bytes than this aren't kept for reuse."""
RESTART_BITS: Final = {IndexFormat.UINT16: 1, IndexFormat.UINT32: 2}
ANY_RESTART: Final = 3


class GpuBuffer:
    """A buffer: its object, its handle, the encoder that uses it, and the copy of a STREAM buffer.

    - `version` counts the commands that may have changed it.
    - `restarts` says which restart indices may have been written: `RESTART_BITS`. Those that the CPU writes
      to a STREAM buffer are in its copy.
    - `ticket` is that of a READBACK buffer whose mapping was begun when it was written.
    """

    __slots__ = (
        "descriptor",
        "device_wrote",
        "dirty",
        "handle",
        "object",
        "restarts",
        "serial",
        "shadow",
        "size",
        "ticket",
        "version",
    )

    def __init__(self, gpu_buffer: GpuObject, descriptor: BufferDescriptor, size: int) -> None:
        self.object = gpu_buffer
        self.handle = gpu_buffer._internal
        self.descriptor = descriptor
        self.size = size
        self.serial = self.version = self.restarts = 0
        self.shadow = bytearray(size) if descriptor.usage is BufferUsage.STREAM else None
        self.ticket = 0
        self.device_wrote = False  # so the copy isn't what the buffer holds, and goes with the submission
        self.dirty: list[list[int]] = []  # [start, stop] of the written bytes of the copy

    @property
    def copy(self) -> bytearray | None:
        """The content of a STREAM buffer, as long as only the CPU writes it."""
        return None if self.device_wrote else self.shadow


def restart_bits(data: BytesLike, offset: int) -> int:
    """Return which restart indices may be among contiguous bytes at an offset of a buffer: bits of
    `RESTART_BITS`."""
    values = np.frombuffer(memoryview(data), np.uint8)
    if not values.size:
        return 0
    if offset % 2 or values.size % 2:
        return ANY_RESTART
    if values.view(np.uint16).max() != 0xFFFF:
        return 0
    if offset % 4 or values.size % 4:
        return ANY_RESTART
    return ANY_RESTART if values.view(np.uint32).max() == 0xFFFFFFFF else 1


class Buffers:
    """The buffers of a device, by id."""

    def __init__(self, device: GpuObject, stream: Stream, mappings: Mappings) -> None:
        self.objects: dict[Id, GpuBuffer] = {}
        self._device = device
        self._stream = stream
        self._mappings = mappings
        self._write_queue = stream.implementation.write_queue
        self._dirty: dict[int, GpuBuffer] = {}
        self._written: list[GpuBuffer] = []  # STREAM buffers that the open encoder writes
        self._readbacks: dict[int, GpuBuffer] = {}  # READBACK buffers that the open encoder writes
        self._maps_early = stream.implementation.maps_early
        self._staging: dict[int, list[GpuObject]] = {}
        stream.before_submit.append(self.upload)
        stream.after_submit.append(self._map_readbacks)

    def __getitem__(self, buffer: Id) -> GpuBuffer:
        return self.objects[buffer]

    def create(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        size = max(16, -(-descriptor.size // 16) * 16)
        usage = READ if descriptor.usage is BufferUsage.READBACK else ALL_USES
        with translate_errors(f"device.buffer({descriptor.size} bytes)", memory=True):
            created = self._device.create_buffer(label=descriptor.label, size=size, usage=usage)
        self.objects[buffer] = GpuBuffer(created, descriptor, size)

    def destroy(self, buffer: Id) -> None:
        removed = self.objects.pop(buffer)
        self._readbacks.pop(id(removed), None)
        self._drop_mapping(removed)
        self._dirty.pop(id(removed), None)
        removed.object.destroy()

    def use(self, buffer: Id) -> GpuBuffer:
        """Return a buffer that the open encoder will use."""
        gpu_buffer = self.objects[buffer]
        gpu_buffer.serial = self._stream.serial
        return gpu_buffer

    def temporary(self, size: int, usage: int = ALL_USES) -> GpuObject:
        """Create a buffer that lives as long as its object or the commands that use it."""
        with translate_errors(f"{size} bytes for a copy", memory=True):
            return self._device.create_buffer(size=max(16, -(-size // 16) * 16), usage=usage)

    def filled(self, data: np.ndarray, usage: int) -> GpuObject:
        """Return a new buffer with these contents."""
        data = np.ascontiguousarray(data)
        size = max(16, -(-data.nbytes // 16) * 16)
        with translate_errors(f"{size} bytes for a command", memory=True):
            created = self._device.create_buffer(size=size, usage=usage, mapped_at_creation=True)
            created.write_mapped(data)
            created.unmap()
        return created

    # -- writes ------------------------------------------------------------------------------------------

    def write(self, buffer: Id, offset: int, data: BytesLike) -> None:
        target = self.objects[buffer]
        target.version += 1
        if data.__class__ is bytes and data and target.shadow is not None and not target.device_wrote:
            self._write_shadow(target, offset, data)  # the usual case: constants
            return
        view = memoryview(data)
        size = view.nbytes
        if not size:
            return
        if target.device_wrote:
            self._stream.submit()  # the copy goes
        if target.shadow is not None:
            self._write_shadow(
                target, offset, view.cast("B") if view.format != "B" or view.ndim != 1 else view
            )
            return
        bytes_ = view.tobytes() if not view.contiguous else view
        restarts = restart_bits(bytes_, offset)
        whole = not offset and size >= target.descriptor.size
        target.restarts = restarts if whole else target.restarts | restarts
        if offset % 4 or size % 4:
            start, stop = offset // 4 * 4, -(-(offset + size) // 4) * 4
            around = bytearray(stop - start)
            around[:4] = self.read(buffer, start, 4)
            around[-4:] = self.read(buffer, stop - 4, 4)
            around[offset - start : offset - start + size] = view.tobytes()
            offset, size, bytes_ = start, stop - start, around  # type: ignore[assignment]
        self.before_write(target)
        with translate_errors("write_buffer"):
            self._write_queue(self._device, target.handle, offset, bytes_, 0, size)

    def _write_shadow(self, target: GpuBuffer, offset: int, view: memoryview | bytes) -> None:
        assert target.shadow is not None
        end, dirty = offset + len(view), target.dirty
        if dirty and dirty[-1][0] <= offset <= dirty[-1][1] + GAP:
            if end > dirty[-1][1]:
                dirty[-1][1] = end
        else:
            self._dirty[id(target)] = target
            dirty.append([offset, end])
        target.shadow[offset:end] = view  # last: after an interrupt before it, only more is uploaded

    def note_device_write(self, target: GpuBuffer) -> None:
        """Note that the open encoder writes a buffer. A STREAM buffer then becomes one like others."""
        target.version += 1
        if self._maps_early and target.descriptor.usage is BufferUsage.READBACK:
            self._drop_mapping(target)
            self._readbacks[id(target)] = target
        if target.shadow is not None and not target.device_wrote:
            target.restarts = ANY_RESTART
            self._written.append(target)
            target.device_wrote = True

    def _map_readbacks(self, submission: int) -> None:
        """Begin to map the READBACK buffers that a submission wrote."""
        for target in self._readbacks.values():
            target.ticket = self._mappings.begin(target.object, target.size)
        self._readbacks.clear()

    def _drop_mapping(self, target: GpuBuffer) -> None:
        if target.ticket:
            self._mappings.cancel(target.ticket, target.object)
            target.ticket = 0

    def before_write(self, resource: object) -> None:
        """Submit if the open encoder uses a buffer that the queue is about to write."""
        if resource.serial == self._stream.serial:  # type: ignore[attr-defined]
            self._stream.submit()

    def upload(self) -> None:
        """Upload the written ranges of STREAM buffers."""
        with translate_errors("write_buffer"):
            for target in self._dirty.values():
                for start, stop in target.dirty:
                    start, stop = start // 4 * 4, -(-stop // 4) * 4
                    self._write_queue(self._device, target.handle, start, target.shadow, start, stop - start)
                target.dirty.clear()
        self._dirty.clear()
        while self._written:
            self._written[-1].shadow, self._written[-1].device_wrote = None, False
            self._written.pop()

    # -- reads -------------------------------------------------------------------------------------------

    def stage(self, size: int) -> GpuObject:
        """Return a buffer of at least this size that copies can go to and that is read by `collect`."""
        rounded = max(256, 1 << (size - 1).bit_length())
        free = self._staging.get(rounded)
        return free.pop() if free else self.temporary(rounded, READ)

    def collect(self, staging: GpuObject, size: int) -> bytes:
        """Submit, wait, and return the first bytes of a buffer that `stage` has returned."""
        whole = -(-size // 4) * 4
        submission = self._stream.submit()
        with translate_errors("read"):
            data = self._map(staging, submission, 0, whole)
        if staging.size <= _MAX_STAGING:
            self._staging.setdefault(staging.size, []).append(staging)
        return data[:size]

    def _map(self, staging: GpuObject, submission: int, offset: int, size: int) -> bytes:
        with DeferredInterrupts():  # an interrupt between would leave the buffer mapped
            ticket = self._mappings.begin(staging, offset + size)
            try:
                if submission:
                    self._stream.fence.finish(submission)
                while not self._mappings.is_done(ticket):
                    self._stream.fence.finish_all()
                return self._mappings.end(ticket, staging, offset, size)
            except BaseException:
                self._mappings.cancel(ticket, staging)
                raise

    def read(self, buffer: Id, offset: int, size: int) -> bytes:
        source = self.objects[buffer]
        if source.device_wrote:
            self._stream.submit()  # the copy goes
        if source.shadow is not None:  # only the CPU writes it
            return bytes(source.shadow[offset : offset + size])
        start, stop = offset // 8 * 8, -(-(offset + size) // 4) * 4
        if source.descriptor.usage is BufferUsage.READBACK:
            if source.serial == self._stream.serial:
                self._stream.submit()
            with translate_errors("read_buffer"):
                if source.ticket and self._mappings.is_done(source.ticket):
                    ticket, source.ticket = source.ticket, 0
                    data = self._mappings.end(ticket, source.object, start, stop - start)
                    return data[offset - start : offset - start + size]
                self._drop_mapping(source)
                data = self._map(source.object, 0, start, stop - start)
            return data[offset - start : offset - start + size]
        staging = self.stage(stop - start)
        self._stream.outside().copy_buffer_to_buffer(source.object, start, staging, 0, stop - start)
        return self.collect(staging, stop - start)[offset - start : offset - start + size]

    # -- copies ------------------------------------------------------------------------------------------

    def copy(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        encoder = self._stream.outside()
        old, new = self.use(source), self.use(target)
        self.note_device_write(new)
        new.restarts |= old.restarts if old.shadow is None else ANY_RESTART
        if old is new:
            between = self.temporary(size)
            encoder.copy_buffer_to_buffer(old.object, source_offset, between, 0, size)
            encoder.copy_buffer_to_buffer(between, 0, new.object, target_offset, size)
        else:
            encoder.copy_buffer_to_buffer(old.object, source_offset, new.object, target_offset, size)

    def clear(self, buffer: Id, offset: int, size: int, value: int) -> None:
        if not size:
            return
        encoder, target = self._stream.outside(), self.use(buffer)
        self.note_device_write(target)
        target.restarts |= ANY_RESTART if value else 0
        if not value:
            encoder.clear_buffer(target.object, offset, size)
            return
        pattern = self.filled(np.full(size // 4, value, np.uint32), Usage.COPY_SRC)
        encoder.copy_buffer_to_buffer(pattern, 0, target.object, offset, size)
