"""wgpu-native's own functions: what wgpu-py lacks (fences, submissions) or makes slow (draws).

- This is the only module that uses the C interface. wgpu-py gives no guarantees for it, so its version is
  pinned.
- `lib` has the functions as they are. Their errors surface when the encoder is finished.
  `checked` has the same functions, and raises their errors at once.
- Using a released handle aborts the process. So whoever stores a handle also stores its object.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Final, TypeAlias

import wgpu
import wgpu.backends.wgpu_native
from wgpu.backends.wgpu_native._api import libf
from wgpu.backends.wgpu_native._ffi import ffi, lib

from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER

__all__ = [
    "NEVER_SLICED",
    "NULL",
    "VERSION",
    "Fence",
    "GpuObject",
    "Handle",
    "Mappings",
    "check_version",
    "checked",
    "ffi",
    "lib",
    "release",
    "retain_callbacks",
    "timestamp_period",
    "write_queue",
]

VERSION: Final = "0.32"
"""The version of wgpu-py whose C interface this module is written for."""

GpuObject: TypeAlias = Any
"""An object of wgpu-py."""
Handle: TypeAlias = Any
"""A pointer to an object of wgpu-native."""

NULL: Final[Handle] = ffi.NULL
checked: Final = libf
NEVER_SLICED: Final = 0xFFFFFFFF
"""The depth slice of attachments that aren't of 3D textures."""


_FUNCTIONS: Final = (
    "void(WGPUDevice const *, WGPUDeviceLostReason, WGPUStringView, void *, void *)",
    "void(WGPUDevice const *, WGPUErrorType, WGPUStringView, void *, void *)",
    "void(WGPURequestDeviceStatus, WGPUDevice, WGPUStringView, void *, void *)",
    "void(WGPUQueueWorkDoneStatus, WGPUStringView, void *, void *)",
    "void(WGPUMapAsyncStatus, WGPUStringView, void *, void *)",
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


_callbacks: Final[list[Any]] = []
"""Callbacks of all devices. The unfinished work of a lost device may call them as late as the end of the
process."""


def retain_callbacks(device: GpuObject) -> None:
    """Keep the callbacks of wgpu-py alive beyond their device, which calls them when it is lost or
    released."""
    _callbacks.extend((device._uncaptured_error_callback, device._device_lost_callback))


def release(device: GpuObject) -> None:
    """Destroy a device, and release its handle while its callbacks exist."""
    device.destroy()
    device._release()


class Fence:
    """Values that submissions reach, in order."""

    def __init__(self, device: GpuObject) -> None:
        self._device = device._internal
        self._queue = device.queue._internal
        self.reached = 0
        self._pending: deque[tuple[int, int]] = deque()  # values, and the submissions that reach them
        self._info = ffi.new("WGPUQueueWorkDoneCallbackInfo *")
        self._info.mode = lib.WGPUCallbackMode_AllowProcessEvents
        callback = self._info.callback = _make_done_callback(self)
        _callbacks.append(callback)

    def submit(self, commands: GpuObject) -> int:
        """Submit a command buffer and return the number of the submission."""
        number: int = checked.wgpuQueueSubmitForIndex(
            self._queue, 1, ffi.new("WGPUCommandBuffer *", commands._internal)
        )
        return number

    def signal(self, value: int, submission: int) -> None:
        """Set the value once everything that was submitted is done."""
        self._info.userdata1 = ffi.cast("void *", value)
        checked.wgpuQueueOnSubmittedWorkDone(self._queue, self._info[0])
        self._pending.append((value, submission))

    def poll(self) -> int:
        """Return the value reached, without waiting."""
        if self._pending:
            self.process()
            while self._pending and self._pending[0][0] <= self.reached:
                self._pending.popleft()
        return self.reached

    def process(self) -> None:
        """Run the callbacks of all finished work."""
        lib.wgpuDevicePoll(self._device, False, NULL)

    def finish(self, submission: int) -> None:
        """Wait until a submission is done."""
        lib.wgpuDevicePoll(self._device, True, ffi.new("WGPUSubmissionIndex *", submission))

    def finish_all(self) -> None:
        """Wait until everything that was submitted is done."""
        lib.wgpuDevicePoll(self._device, True, NULL)


def _make_done_callback(fence: Fence) -> Any:
    @ffi.callback("void(WGPUQueueWorkDoneStatus, WGPUStringView, void *, void *)")  # type: ignore[untyped-decorator]
    def done(status: int, message: Any, user: Any, other: Any) -> None:
        fence.reached = max(fence.reached, int(ffi.cast("uintptr_t", user)))

    return done


class Mappings:
    """Maps buffers for reading, without the threads that wgpu-py would start for it."""

    def __init__(self) -> None:
        self._status: dict[int, int] = {}
        self._latest = 0
        status = self._status

        @ffi.callback("void(WGPUMapAsyncStatus, WGPUStringView, void *, void *)")  # type: ignore[untyped-decorator]
        def mapped(result: int, message: Any, user: Any, other: Any) -> None:
            status[int(ffi.cast("uintptr_t", user))] = int(result)

        self._callback = mapped
        _callbacks.append(mapped)

    def begin(self, buffer: GpuObject, size: int) -> int:
        """Begin to map the first bytes of a buffer after all submitted work; return a ticket."""
        self._latest += 1
        info = ffi.new("WGPUBufferMapCallbackInfo *")
        info.mode = lib.WGPUCallbackMode_AllowProcessEvents
        info.callback = self._callback
        info.userdata1 = ffi.cast("void *", self._latest)
        checked.wgpuBufferMapAsync(buffer._internal, lib.WGPUMapMode_Read, 0, size, info[0])
        return self._latest

    def is_done(self, ticket: int) -> bool:
        """Whether the buffer is mapped."""
        return ticket in self._status

    def end(self, ticket: int, buffer: GpuObject, offset: int, size: int) -> bytes:
        """Return a range of a mapped buffer, and unmap it. Offset and size are multiples of 8 and 4."""
        if self._status.pop(ticket) != lib.WGPUMapAsyncStatus_Success:
            raise wgpu.GPUError("a buffer could not be mapped")
        address = lib.wgpuBufferGetConstMappedRange(buffer._internal, offset, size)
        data = bytes(ffi.buffer(address, size))
        lib.wgpuBufferUnmap(buffer._internal)
        return data


def write_queue(device: GpuObject, buffer: Handle, offset: int, data: Any, start: int, size: int) -> None:
    """Write a part of `data`, a buffer of Python, before the next submission. Offset and size are multiples
    of 4."""
    with ffi.from_buffer("uint8_t[]", data) as source:  # released at once: else an error keeps it in a cycle
        checked.wgpuQueueWriteBuffer(device.queue._internal, buffer, offset, source + start, size)


def timestamp_period(device: GpuObject) -> float:
    """The unit of timestamps, in nanoseconds."""
    return float(lib.wgpuQueueGetTimestampPeriod(device.queue._internal))
