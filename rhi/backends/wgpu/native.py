"""wgpu-native's own functions: what wgpu-py lacks (fences, submissions) or makes slow (draws).

- This is the only module that uses the C interface. wgpu-py gives no guarantees for it, so its version is
  pinned.
- `lib` has the functions as they are. Their errors surface when the encoder is finished.
  `checked` has the same functions, and raises their errors at once.
- Using a released handle aborts the process. So whoever stores a handle also stores its object.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from struct import Struct
from time import sleep
from typing import Any, Final

import wgpu
from wgpu.backends.wgpu_native._api import libf
from wgpu.backends.wgpu_native._ffi import ffi, lib

from rhi.backends.webgpu.implementation import (
    BundleFunctions,
    ColorTarget,
    DepthTarget,
    GpuError,
    GpuMemoryError,
    GpuObject,
    Handle,
    ModuleError,
)
from rhi.contract.formats import IndexFormat
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER

__all__ = [
    "NULL",
    "VERSION",
    "NativeFence",
    "NativeMappings",
    "WgpuNative",
    "check_version",
    "checked",
    "ffi",
    "lib",
    "release",
    "retain_callbacks",
]

VERSION: Final = "0.32"
"""The version of wgpu-py whose C interface this module is written for."""

GpuError.register(wgpu.GPUError)
GpuMemoryError.register(wgpu.GPUOutOfMemoryError)

NULL: Final[Handle] = ffi.NULL
checked: Final = libf
NEVER_SLICED: Final = 0xFFFFFFFF
"""The depth slice of attachments that aren't of 3D textures."""


_FUNCTIONS: Final = (
    "void(WGPUDevice const *, WGPUDeviceLostReason, WGPUStringView, void *, void *)",
    "void(WGPUDevice const *, WGPUErrorType, WGPUStringView, void *, void *)",
    "void(WGPURequestDeviceStatus, WGPUDevice, WGPUStringView, void *, void *)",
    "void(int, WGPUStringView, uintptr_t, uintptr_t)",
)
"""Types of callbacks, as wgpu-py and this module write them."""


def _parse_types() -> None:
    """Make cffi parse all types of the interface at once. Left alone, it parses each type when it is first
    named, and reads all type names again each time: 80 % of the time to the first frame. It caches parsed
    types by their text."""
    parsed = getattr(ffi, "_parsed_types", {})  # if it is renamed, only time is lost
    names = [
        name for name in ffi.list_types()[0] if name.startswith("WGPU") and not name.startswith("WGPUProc")
    ]
    names += ["char", "uint32_t"]
    pointers = ", ".join(f"{name} *, {name}(*)[]" for name in names)
    types = ffi.typeof(f"void(*)({pointers}, {', '.join(_FUNCTIONS)})").args
    for name, pointer, array in zip(names, types[::2], types[1::2], strict=False):
        for text in (f"{name} *", f"{name} * "):
            parsed.setdefault(text, (pointer, False))
        for text in (f"{name}[]", f"{name} []"):
            parsed.setdefault(text, (array.item, False))
    for text, function in zip(_FUNCTIONS, types[2 * len(names) :], strict=True):
        parsed.setdefault(text, (function, True))


_parse_types()


def check_version() -> None:
    """Refuse another wgpu-py than the one whose C interface this module knows.

    Raises:
        DeviceError: `device-driver`.
    """
    if not wgpu.__version__.startswith(f"{VERSION}."):
        given, tip = f"wgpu {wgpu.__version__}", f'pip install "wgpu=={VERSION}.*"'
        raise DeviceError(DEVICE_DRIVER, "rhi.create_device('wgpu')", given, f"wgpu {VERSION}", tip)


_callbacks: Final[deque[Any]] = deque(maxlen=64)
"""Callbacks of the latest devices: a device may call them when it is released."""
_lost_callbacks: Final[list[Any]] = []
"""Callbacks of lost devices, whose unfinished work may call them as late as the end of the process."""


def retain_callbacks(device: GpuObject) -> None:
    """Keep the callbacks of wgpu-py alive beyond their device, which calls them when it is lost or
    released."""
    _callbacks.append((device._uncaptured_error_callback, device._device_lost_callback))


def release(device: GpuObject) -> None:
    """Destroy a device, and release its handle while its callbacks exist."""
    if _is_lost(device):
        _lost_callbacks.append((device._uncaptured_error_callback, device._device_lost_callback))
    device.destroy()
    device._release()


def _is_lost(device: GpuObject) -> bool:
    try:
        device.create_buffer(size=16, usage=wgpu.BufferUsage.COPY_DST)
    except wgpu.GPUError:
        return True
    return False


class CallbackRecord:
    """A callback of wgpu-native that notes its arguments.

    It is C code of Python's own: while it runs, no Python function does, so no handler of a signal can be
    called inside it. What a handler raised there would be lost.
    """

    __slots__ = ("_memory", "callback")
    _ARGUMENTS: Final = Struct("=i?QQ")  # status, whether there is a message, and the user's two numbers

    def __init__(self) -> None:
        self._memory = bytearray(self._ARGUMENTS.size)
        write = partial(self._ARGUMENTS.pack_into, self._memory, 0)
        self.callback = ffi.callback("void(int, WGPUStringView, uintptr_t, uintptr_t)", write)

    @property
    def status(self) -> int:
        """The status of the latest call."""
        return int(self._ARGUMENTS.unpack(self._memory)[0])

    @property
    def number(self) -> int:
        """The user's number in the latest call; 0 before the first."""
        return int(self._ARGUMENTS.unpack(self._memory)[2])

    def install(self, info: Any, number: int) -> None:
        """Register this callback for the call that takes `info`, with `number`."""
        info.mode = lib.WGPUCallbackMode_AllowProcessEvents
        info.callback = ffi.cast(ffi.typeof(info.callback), self.callback)
        info.userdata1 = ffi.cast("void *", number)

    def reset(self) -> None:
        """Forget the latest call."""
        self._memory[:] = bytes(len(self._memory))


_spare_records: Final[list[CallbackRecord]] = []
_records_in_use: Final[set[CallbackRecord]] = set()
"""Records that wgpu-native may still write to. They outlive their devices."""


def take_record() -> CallbackRecord:
    """Return a record for calls to come."""
    try:
        record = _spare_records.pop()
    except IndexError:
        record = CallbackRecord()
    record.reset()
    _records_in_use.add(record)
    return record


def give_record(record: CallbackRecord) -> None:
    """Give back a record whose callback won't be called any more."""
    if record in _records_in_use:
        _records_in_use.remove(record)
        _spare_records.append(record)


class NativeFence:
    """Values that submissions reach, in order."""

    def __init__(self, device: GpuObject) -> None:
        self._device = device._internal
        self._queue = device.queue._internal
        self.reached = 0
        self._pending: deque[tuple[int, int]] = deque()  # values, and the submissions that reach them
        self._info = ffi.new("WGPUQueueWorkDoneCallbackInfo *")
        self._done = take_record()

    def submit(self, commands: GpuObject) -> int:
        """Submit a command buffer and return the number of the submission."""
        number: int = checked.wgpuQueueSubmitForIndex(
            self._queue, 1, ffi.new("WGPUCommandBuffer *", commands._internal)
        )
        return number

    def signal(self, value: int, submission: int) -> None:
        """Set the value once everything that was submitted is done."""
        self._done.install(self._info, value)
        self._pending.append((value, submission))
        checked.wgpuQueueOnSubmittedWorkDone(self._queue, self._info[0])

    def poll(self) -> int:
        """Return the value reached, without waiting."""
        pending = self._pending
        if pending:
            is_empty = self.process()
            self.reached = max(self.reached, self._done.number)
            if is_empty:  # also if a callback was never called
                self.reached = max(self.reached, pending[-1][0])
            while pending and pending[0][0] <= self.reached:
                pending.popleft()
        return self.reached

    def process(self) -> bool:
        """Run the callbacks of all finished work; return whether all work is finished."""
        return bool(lib.wgpuDevicePoll(self._device, False, NULL))

    def pause(self, seconds: float) -> None:
        """Leave the device this time to work, in seconds."""
        sleep(seconds)

    def finish(self, submission: int) -> None:
        """Wait until a submission is done."""
        lib.wgpuDevicePoll(self._device, True, ffi.new("WGPUSubmissionIndex *", submission))

    def finish_all(self) -> None:
        """Wait until everything that was submitted is done."""
        lib.wgpuDevicePoll(self._device, True, NULL)

    def close(self) -> None:
        """Give back the record of a device that is released."""
        if not self._pending or self._done.number == self._pending[-1][0]:
            give_record(self._done)


class NativeMappings:
    """Maps buffers for reading, without the threads that wgpu-py would start for it."""

    def __init__(self) -> None:
        self._records: dict[int, CallbackRecord] = {}  # by ticket
        self._latest = 0

    def begin(self, buffer: GpuObject, size: int) -> int:
        """Begin to map the first bytes of a buffer after all submitted work; return a ticket."""
        self._latest += 1
        info = ffi.new("WGPUBufferMapCallbackInfo *")
        record = self._records[self._latest] = take_record()
        record.install(info, self._latest)
        checked.wgpuBufferMapAsync(buffer._internal, lib.WGPUMapMode_Read, 0, size, info[0])
        return self._latest

    def is_done(self, ticket: int) -> bool:
        """True if the buffer is mapped."""
        return bool(self._records[ticket].number)

    def end(self, ticket: int, buffer: GpuObject, offset: int, size: int) -> bytes:
        """Return a range of a mapped buffer, and unmap it. Offset and size are multiples of 8 and 4."""
        record = self._records.pop(ticket)
        status = record.status
        give_record(record)
        if status != lib.WGPUMapAsyncStatus_Success:
            raise wgpu.GPUError("a buffer could not be mapped")
        address = lib.wgpuBufferGetConstMappedRange(buffer._internal, offset, size)
        data = bytes(ffi.buffer(address, size))
        lib.wgpuBufferUnmap(buffer._internal)
        return data

    def cancel(self, ticket: int, buffer: GpuObject) -> None:
        """Unmap a buffer whose mapping was begun and not ended."""
        record = self._records.pop(ticket, None)
        lib.wgpuBufferUnmap(buffer._internal)  # which calls a callback that is still to come
        if record is not None and record.number:
            give_record(record)

    def close(self) -> None:
        """Give back the records of a device that is released."""
        for record in self._records.values():
            if record.number:
                give_record(record)
        self._records.clear()


_LOCATION: Final = re.compile(r"wgsl:(\d+):\d+")


def _read_messages(log: str) -> Iterator[tuple[str, int]]:
    """Yield naga's message, with the line of the text that it points at."""
    lines = [line.strip() for line in log.splitlines() if line.strip()]
    start = next((i for i, line in enumerate(lines) if line.startswith("Shader '")), 0)
    location = _LOCATION.search(log)
    message = " ".join(line for line in lines[start:] if not re.match(r"[┌│=\d]", line))
    yield re.sub(r"^Shader '[^']*' ", "", message) or log.strip(), int(location[1]) if location else 0


class NativeBundles:
    """The functions of bundles; `rhi.backends.webgpu.implementation.BundleFunctions`."""

    def __init__(self) -> None:
        self.set_pipeline = lib.wgpuRenderBundleEncoderSetPipeline
        self.set_bind_group = lib.wgpuRenderBundleEncoderSetBindGroup
        self.set_vertex_buffer = lib.wgpuRenderBundleEncoderSetVertexBuffer
        self.set_index_buffer = lib.wgpuRenderBundleEncoderSetIndexBuffer
        self.draw = lib.wgpuRenderBundleEncoderDraw
        self.draw_indexed = lib.wgpuRenderBundleEncoderDrawIndexed

    def begin(self, device: GpuObject, colors: Sequence[str], depth: str | None, samples: int) -> GpuObject:
        """Begin a bundle for passes with targets of these formats."""
        return device.create_render_bundle_encoder(
            color_formats=colors, depth_stencil_format=depth, sample_count=samples
        )

    def finish(self, encoder: GpuObject) -> GpuObject:
        """Return the bundle."""
        return encoder.finish()

    def execute(self, render: Handle, bundle: GpuObject) -> None:
        """Execute a bundle in a pass."""
        lib.wgpuRenderPassEncoderExecuteBundles(render, 1, ffi.new("WGPURenderBundle *", bundle._internal))


class WgpuNative:
    """The functions of wgpu-native; `rhi.backends.webgpu.implementation.Implementation`.

    Its functions are C's own: a draw calls no function of Python between.
    """

    name = "wgpu"
    version = f"wgpu {wgpu.__version__}"
    index_formats: Mapping[IndexFormat, Any] = {
        IndexFormat.UINT16: lib.WGPUIndexFormat_Uint16,
        IndexFormat.UINT32: lib.WGPUIndexFormat_Uint32,
    }
    no_offsets = NULL
    maps_early = False
    pack_group: Callable[[Handle, int, Handle, int], Callable[..., bytes]] | None = None

    def __init__(self) -> None:
        self.bundles: BundleFunctions | None = NativeBundles()
        self.set_pipeline = lib.wgpuRenderPassEncoderSetPipeline
        self.set_bind_group = lib.wgpuRenderPassEncoderSetBindGroup
        self.set_vertex_buffer = lib.wgpuRenderPassEncoderSetVertexBuffer
        self.set_index_buffer = lib.wgpuRenderPassEncoderSetIndexBuffer
        self.draw = lib.wgpuRenderPassEncoderDraw
        self.draw_indexed = lib.wgpuRenderPassEncoderDrawIndexed
        self.multi_draw_indirect = lib.wgpuRenderPassEncoderMultiDrawIndirect
        self.multi_draw_indexed_indirect = lib.wgpuRenderPassEncoderMultiDrawIndexedIndirect
        self.multi_draw_indexed_indirect_count = lib.wgpuRenderPassEncoderMultiDrawIndexedIndirectCount
        self.set_viewport = lib.wgpuRenderPassEncoderSetViewport
        self.set_scissor_rect = lib.wgpuRenderPassEncoderSetScissorRect
        self.set_stencil_reference = lib.wgpuRenderPassEncoderSetStencilReference
        self.begin_occlusion_query = lib.wgpuRenderPassEncoderBeginOcclusionQuery
        self.end_occlusion_query = lib.wgpuRenderPassEncoderEndOcclusionQuery
        self.write_timestamp = lib.wgpuCommandEncoderWriteTimestamp
        self.write_pass_timestamp = lib.wgpuRenderPassEncoderWriteTimestamp
        self.set_compute_pipeline = lib.wgpuComputePassEncoderSetPipeline
        self.set_compute_bind_group = lib.wgpuComputePassEncoderSetBindGroup
        self.dispatch_workgroups = lib.wgpuComputePassEncoderDispatchWorkgroups
        self.dispatch_workgroups_indirect = lib.wgpuComputePassEncoderDispatchWorkgroupsIndirect
        self.begin_render_pass = lib.wgpuCommandEncoderBeginRenderPass
        self.end_render_pass = lib.wgpuRenderPassEncoderEnd
        self.release_render_pass = lib.wgpuRenderPassEncoderRelease

    def set_blend_constant(self, render: Handle, color: tuple[float, float, float, float]) -> None:
        """Set the blend constant of a pass."""
        lib.wgpuRenderPassEncoderSetBlendConstant(render, ffi.new("WGPUColor *", color))

    def pack_draw(self, indexed: bool, count: int, first: int, base_vertex: int, base_instance: int) -> None:
        """Return None: calls are made at once."""

    def describe_render_pass(
        self, colors: Sequence[ColorTarget], depth: DepthTarget | None, query_set: Handle, samples: int
    ) -> Any:
        """Return the description of a render pass. It keeps the structures and views that it points to."""
        attachments = ffi.new("WGPURenderPassColorAttachment[]", max(1, len(colors)))
        for attachment, (view, _, clear, resolve_target, stores) in zip(attachments, colors, strict=False):
            attachment.view, attachment.depthSlice = view._internal, NEVER_SLICED
            attachment.loadOp = lib.WGPULoadOp_Load if clear is None else lib.WGPULoadOp_Clear
            attachment.storeOp = lib.WGPUStoreOp_Store if stores else lib.WGPUStoreOp_Discard
            if clear is not None:
                value = attachment.clearValue
                value.r, value.g, value.b, value.a = clear
            if resolve_target is not None:
                attachment.resolveTarget = resolve_target._internal
        info = ffi.new("WGPURenderPassDescriptor *")
        info.colorAttachmentCount, info.colorAttachments = len(colors), attachments
        structures = [attachments]
        if depth is not None:
            attachment = ffi.new("WGPURenderPassDepthStencilAttachment *")
            structures.append(attachment)
            attachment.view = depth.view._internal
            attachment.depthLoadOp = lib.WGPULoadOp_Load if depth.clear is None else lib.WGPULoadOp_Clear
            attachment.depthStoreOp = lib.WGPUStoreOp_Store
            attachment.depthClearValue = depth.clear or 0.0
            if depth.has_stencil:
                loads = depth.clear_stencil is None
                attachment.stencilLoadOp = lib.WGPULoadOp_Load if loads else lib.WGPULoadOp_Clear
                attachment.stencilStoreOp = lib.WGPUStoreOp_Store
                attachment.stencilClearValue = depth.clear_stencil or 0
            info.depthStencilAttachment = attachment
        info.occlusionQuerySet = query_set
        self._structures = structures, info
        return info

    def offset_array(self, count: int) -> Any:
        """Return an array of this many dynamic offsets."""
        return ffi.new("uint32_t[]", max(1, count))

    def create_fence(self, device: GpuObject) -> NativeFence:
        """Return the fence of a device."""
        return NativeFence(device)

    def create_mappings(self) -> NativeMappings:
        """Return the mapped reads of a device."""
        return NativeMappings()

    def create_module(self, device: GpuObject, label: str, code: str) -> GpuObject:
        """Compile a text of WGSL by naga.

        Raises:
            ModuleError: if the text is refused.
        """
        try:
            return device.create_shader_module(label=label, code=code)
        except wgpu.GPUValidationError as error:
            raise ModuleError(_read_messages(str(error))) from None

    def write_queue(
        self, device: GpuObject, buffer: Handle, offset: int, data: Any, start: int, size: int
    ) -> None:
        """Write a part of `data`, a buffer of Python, before the next submission. Offset and size are
        multiples of 4."""
        with ffi.from_buffer("uint8_t[]", data) as source:  # released at once: else an error keeps it
            checked.wgpuQueueWriteBuffer(device.queue._internal, buffer, offset, source + start, size)

    def timestamp_period(self, device: GpuObject) -> float:
        """Return the unit of timestamps, in nanoseconds."""
        return float(lib.wgpuQueueGetTimestampPeriod(device.queue._internal))

    def release(self, device: GpuObject) -> None:
        """Wait for a device's work and destroy it; release its handle while its callbacks exist."""
        lib.wgpuDevicePoll(device._internal, True, NULL)
        release(device)
