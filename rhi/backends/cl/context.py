"""Which OpenCL device is used, and the queue on it.

- A device is chosen by trying: the first that builds a probe kernel, runs it and gives the right numbers. Names
  tell nothing: two platforms of one name may be installed, of which one can't compile for this CPU.
- `RHI_CL_DEVICE` names one device: its number, or a part of its name or its platform's. No other is tried then.
- The queue executes in order, so that memory written by one command is what the next one reads.
- The probe also finds out whether kernels read the host's memory in place. Where they do, memory that the CPU
  streams to the device needs no command.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NoReturn

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from rhi.backends.cl.errors import shorten
from rhi.backends.cl.workers import list_threads, spread_threads
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER

__rhi_internal__ = True

ENVIRONMENT: Final = "RHI_CL_DEVICE"
_CALL: Final = "rhi.create_device('cl')"
_ALLOWED: Final = "an OpenCL device that compiles and runs a kernel"
_INSTALL: Final = "on Debian: apt install pocl-opencl-icd"
_OUTDATED: Final = "this PoCL's compiler is older than the CPU (the wheel's is from 2022); "
_UNWRITABLE: Final = "PoCL has none if it can't write its cache: set POCL_CACHE_DIR to a folder that can be written"
PAGE: Final = 4096
"""Bytes: drivers use host memory in place only where it begins at a multiple of so many."""
_COUNT: Final = 64
_PROBE: Final = """
__kernel void probe(__global uint *words) {
    uint i = get_global_id(0);
    words[i] = words[i] * 3u + i;
    atomic_add(&words[get_global_size(0)], i);
}
// Where memory lies, and what is read there by a kernel that is given nothing else (rhi.backends.cl.pools).
__kernel void find(__global uchar *memory, __global ulong *answer) { *answer = (ulong)memory; }
__kernel void read(ulong address, __global ulong *answer) { *answer = *(__global ulong *)address; }
"""


@dataclass(frozen=True, slots=True)
class ClContext:
    """A device that works.

    Attributes:
        probe: the program of the probe kernel, and of those that find memory.
        shares_memory: whether kernels read and write a `USE_HOST_PTR` buffer's host memory in place.
        passed_over: the devices tried before, each with why it can't be used.
    """

    device: cl.Device
    context: cl.Context
    queue: cl.CommandQueue
    probe: cl.Program
    shares_memory: bool
    passed_over: tuple[str, ...]


def open_context() -> ClContext:
    """A queue on the first device that works.

    Raises:
        DeviceError: `device-driver`, with why each device was passed over and what to install.
    """
    threads = list_threads()
    devices = find_devices()
    wanted = os.environ.get(ENVIRONMENT, "")
    if wanted:
        devices = [choose_device(wanted, devices)]
    passed_over: list[str] = []
    for device in devices:
        try:
            context = cl.Context([device])
            queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
            program, shares_memory = probe(context, queue)
        except (cl.Error, RuntimeError) as error:
            passed_over.append(f"{describe(device)}: {shorten(error)}")
        else:
            begun = list_threads() - threads
            if len(begun) == device.max_compute_units:  # workers, begun with the process's first device
                spread_threads(begun)
            return ClContext(device, context, queue, program, shares_memory, tuple(passed_over))
    if not devices:
        _refuse_nothing()
    given = "\n".join(passed_over)
    tip = f"{_OUTDATED}{_INSTALL}" if "unknown target CPU" in given else _INSTALL
    raise DeviceError(DEVICE_DRIVER, _CALL, given, _ALLOWED, tip)


def _refuse_nothing() -> NoReturn:
    """There is no device: no driver, or one that has none."""
    empty = ", ".join(platform.name for platform in _find_platforms())
    given = "no OpenCL device" + (f"; there is {empty}, but without a device" if empty else "")
    raise DeviceError(DEVICE_DRIVER, _CALL, given, _ALLOWED, _UNWRITABLE if empty else _INSTALL)


def _find_platforms() -> list[cl.Platform]:
    try:
        platforms: list[cl.Platform] = cl.get_platforms()
    except cl.Error:  # there are none
        return []
    return platforms


def find_devices() -> list[cl.Device]:
    """All devices of all platforms, in OpenCL's order."""
    devices: list[cl.Device] = []
    for platform in _find_platforms():
        try:
            devices += platform.get_devices()
        except cl.Error:  # a platform without any
            continue
    return devices


def describe(device: cl.Device) -> str:
    """A device's name and driver in a line; two versions of one driver differ in it."""
    return f"{device.name} ({' '.join(device.platform.version.split())})"


def choose_device(wanted: str, devices: Sequence[cl.Device]) -> cl.Device:
    """The device of this number, or the first whose description contains `wanted`."""
    names = [describe(device) for device in devices]
    if wanted.isdecimal():
        meant = devices[int(wanted) :]
    else:
        meant = [
            device
            for name, device in zip(names, devices, strict=True)
            if wanted.lower() in f"{device.platform.name} {name}".lower()
        ]
    if meant:
        return meant[0]
    if not names:
        _refuse_nothing()
    rows = "".join(f"\n{number}: {name}" for number, name in enumerate(names))
    tip = f"unset {ENVIRONMENT}, or set it to a device's number or a part of its name"
    raise DeviceError(DEVICE_DRIVER, _CALL, f"{ENVIRONMENT}={wanted!r}; the devices are{rows}", tip=tip)


def probe(context: cl.Context, queue: cl.CommandQueue) -> tuple[cl.Program, bool]:
    """Build and run a kernel twice, on memory that the host changes in between; the program, and whether it saw the
    change.

    Raises:
        pyopencl.Error: it can't be built or run.
        RuntimeError: it computes wrong numbers.
    """
    program = build(context, _PROBE)
    kernel = cl.Kernel(program, "probe")
    words = allocate_pages(_COUNT * 4 + 4).view(np.uint32)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR
    memory = cl.Buffer(context, flags, hostbuf=words)
    kernel.set_arg(0, memory)
    ramp = np.arange(_COUNT, dtype=np.uint32)
    seen = np.empty_like(words)

    def run() -> None:
        cl.enqueue_nd_range_kernel(queue, kernel, (_COUNT,), None)
        cl.enqueue_copy(queue, seen, memory)

    run()
    if not (np.array_equal(seen[:_COUNT], ramp) and seen[_COUNT] == ramp.sum()):
        raise RuntimeError("a probe kernel computed wrong numbers")
    shows = np.array_equal(words, seen)
    words[:] = 7
    run()
    return program, shows and np.array_equal(seen[:_COUNT], 21 + ramp) and np.array_equal(words, seen)


def build(context: cl.Context, source: str, flushes_denormals: bool = False) -> cl.Program:
    """A built program. Built once: PoCL keeps kernels on disk, and for drivers that don't pyopencl does, both
    under a key of source, options, device and driver. What a compiler says about what it accepts is dropped.

    `flushes_denormals`: CPUs may take a hundred cycles for a product below 2^-126, as powers of cosines often are.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cl.CompilerWarning)
        return build_again(context, source, flushes_denormals)


def build_again(context: cl.Context, source: str, flushes_denormals: bool) -> cl.Program:
    """The same of what was accepted before, in any thread: filters of warnings are the whole process's."""
    built: cl.Program = cl.Program(context, source).build(
        ["-cl-denorms-are-zero"] if flushes_denormals else []
    )
    return built


def allocate_pages(size: int) -> NDArray[np.uint8]:
    """Zeroed host memory that begins at a page, (size,)."""
    memory = np.zeros(size + PAGE, np.uint8)
    start = -memory.ctypes.data % PAGE
    return memory[start : start + size]
