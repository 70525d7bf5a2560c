"""Selection of the OpenCL device, and its context and queue.

- Devices are tried in order. The first that builds a probe kernel, runs it and computes the right numbers is
  used. Names don't suffice: two platforms of the same name may be installed, of which one can't compile for
  this CPU.
- `RHI_CL_DEVICE` selects one device by its number, or by a part of its name or its platform's. No other is
  tried then.
- The queue executes in order, so each command reads the memory that the commands before it wrote.
- The probe also determines whether kernels read host memory in place. If so, memory that the CPU streams to
  the device needs no copy command.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, Final, NoReturn

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from rhi.backends.cl.cl_errors import shorten
from rhi.backends.cl.pocl.driver_loader import DriverLoader
from rhi.backends.cl.pocl.fault_handlers import keep_fault_handlers
from rhi.backends.cl.pocl.kernel_cache import CachedProgram, KernelCache, Request, make_mark, settle_folder
from rhi.backends.cl.pocl.program_residency import EvictableProgram, ProgramResidency
from rhi.backends.cl.pocl.workers import list_python_threads, list_threads, spread_threads
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER
from rhi.errors.shared_caches import make_shared_lock

ENVIRONMENT: Final = "RHI_CL_DEVICE"
KERNELS_ENVIRONMENT: Final = "RHI_KERNELS"
"""Which kernels are built: `quick` or `optimised` ones; see `rhi.backends.cl.builds`."""
_CALL: Final = "rhi.create_device('cl')"
_ALLOWED: Final = "an OpenCL device that compiles and runs a kernel"
_INSTALL: Final = "on Debian: apt install pocl-opencl-icd"
_OUTDATED: Final = "this PoCL's compiler is older than the CPU (the wheel's is from 2022); "
_UNWRITABLE: Final = (
    "PoCL has none if it can't write its cache: set POCL_CACHE_DIR to a folder that can be written"
)
_POCL: Final = "Portable Computing Language"
QUICK: Final = ("-cl-opt-disable", "-Dalways_inline=noinline", "-Dnoinline=noinline,minsize")
"""Build options: compile fast, for kernels that run once or seldom. Clang marks functions as not to be
optimised; with `minsize`, LLVM still improves their code, which runs twice as fast after the same compile
time."""
FLUSHES_DENORMALS: Final = "-cl-denorms-are-zero"
"""Build option: numbers below 2^-126 count as 0. CPUs may take a hundred cycles for a product that small, as
powers of cosines often are."""
SILENT: Final = "-w"
"""Build option: no warnings. PoCL prints their number on standard error, and pyopencl repeats them."""
PAGE: Final = 4096
"""Alignment in bytes of host memory that drivers use in place."""
_COMPILERS: Final = 128 << 20  # bytes of address space
_INCLUDED: Final = str(Path(cl.__file__).parent)
"""Folder of pyopencl's headers, an option of each program that it builds. The driver's cache keys depend on
it."""
EMPTY: Final = np.zeros(0, np.uint8)
"""No data: memory that begins with it is all zeros."""
_COUNT: Final = 64
_WARNINGS: Final = make_shared_lock()
"""Held while filters of warnings are exchanged, which belong to all threads."""
_PROBE: Final = """
__kernel void probe(__global uint *words) {
    uint i = get_global_id(0);
    words[i] = words[i] * 3u + i;
    atomic_add(&words[get_global_size(0)], i);
}
"""


@dataclass(frozen=True, slots=True)
class ClContext:
    """A working device with its context and queue.

    Attributes:
        shares_memory: whether kernels read and write the host memory of a `USE_HOST_PTR` buffer in place.
        rejected_devices: devices that were tried first and can't be used, each with the reason.
        cache: the compiled programs of this device.
        programs: the programs in memory.
        waited: seconds of building the probe kernel; 0 if it was in the cache.
    """

    device: cl.Device
    context: cl.Context
    queue: cl.CommandQueue
    shares_memory: bool
    rejected_devices: tuple[str, ...]
    cache: KernelCache
    programs: ProgramResidency
    waited: float = 0.0

    def compile(self, source: str, options: Sequence[str] = ()) -> EvictableProgram:
        """Build a program, or take it from the cache. It is optimised unless `RHI_KERNELS` is `quick`."""
        if os.environ.get(KERNELS_ENVIRONMENT) == "quick":
            options = (*options, *QUICK)
        request = self.cache.request(source, options)
        return self.make_evictable(self._build(request), request)

    def make_evictable(
        self, program: cl.Program, request: Request, types: Sequence[type] | None = None
    ) -> EvictableProgram:
        """Wrap a program that was built from `request`, and is built again when it has been released.

        Args:
            types: the types of each kernel's arguments, if they are scalars.
        """
        return self.programs.add(
            program, request, self._build, types, partial(self.cache.has_code, request.key)
        )

    def _build(self, request: Request) -> cl.Program:
        np.empty(_COMPILERS, np.uint8)  # without so much, LLVM ends the process; this is a MemoryError
        return build_cached(self.context, self.cache, request, self.cache.find(request.key))


def open_context(loading: DriverLoader | None = None) -> ClContext:
    """Open the first device that works.

    Args:
        loading: the loader, if another thread is loading the drivers.

    Raises:
        DeviceError: `device-driver`, with the reason why each device was rejected, and what to install.
    """
    threads = list_threads() if loading is None else loading.finish()
    folder = settle_folder()
    devices = list_devices()
    name = os.environ.get(ENVIRONMENT, "")
    if name:
        devices = [choose_device(name, devices)]
    rejected_devices: list[str] = []
    for device in devices:
        try:
            context = cl.Context([device])
            queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
            driver = f"{describe(device)} {device.driver_version} {_INCLUDED}"
            cached = caches_kernels(device)
            cache = KernelCache(
                folder if cached else None, driver, declares=cached and declares_kernels(device)
            )
            is_stored, began = cache.contains(_request_probe(cache).key), perf_counter()
            shares_memory = probe(context, queue, cache)
            waited = 0.0 if is_stored else perf_counter() - began
        except (cl.Error, RuntimeError) as error:
            rejected_devices.append(f"{describe(device)}: {shorten(error)}")
        else:
            started = list_threads() - threads - list_python_threads()
            if len(started) == device.max_compute_units:  # PoCL starts workers with its first device
                spread_threads(started)
            programs = ProgramResidency(releases=cache.works)
            return ClContext(
                device, context, queue, shares_memory, tuple(rejected_devices), cache, programs, waited
            )
    if not devices:
        _refuse_no_device()
    given = "\n".join(rejected_devices)
    tip = f"{_OUTDATED}{_INSTALL}" if "unknown target CPU" in given else _INSTALL
    raise DeviceError(DEVICE_DRIVER, _CALL, given, _ALLOWED, tip)


def _refuse_no_device() -> NoReturn:
    """Raise the error for a system without a driver, or whose drivers have no device."""
    empty = ", ".join(platform.name for platform in _list_platforms())
    given = "no OpenCL device" + (f"; there is {empty}, but without a device" if empty else "")
    raise DeviceError(DEVICE_DRIVER, _CALL, given, _ALLOWED, _UNWRITABLE if empty else _INSTALL)


def _list_platforms() -> list[cl.Platform]:
    try:
        platforms: list[cl.Platform] = cl.get_platforms()
    except cl.Error:  # no platform is installed
        return []
    return platforms


def list_devices() -> list[cl.Device]:
    """Return all devices of all platforms, in OpenCL's order."""
    devices: list[cl.Device] = []
    with keep_fault_handlers():
        for platform in _list_platforms():
            try:
                devices += platform.get_devices()
            except cl.Error:  # this platform has no device
                continue
    return devices


def describe(device: cl.Device) -> str:
    """Return a device's name and driver version on one line."""
    return f"{device.name} ({' '.join(device.platform.version.split())})"


def choose_device(selector: str, devices: Sequence[cl.Device]) -> cl.Device:
    """Return the device with the number `selector`, or the first whose description contains it."""
    names = [describe(device) for device in devices]
    if selector.isdecimal():
        matching = devices[int(selector) :]
    else:
        matching = [
            device
            for name, device in zip(names, devices, strict=True)
            if selector.lower() in f"{device.platform.name} {name}".lower()
        ]
    if matching:
        return matching[0]
    if not names:
        _refuse_no_device()
    rows = "".join(f"\n{number}: {name}" for number, name in enumerate(names))
    tip = f"unset {ENVIRONMENT}, or set it to a device's number or a part of its name"
    raise DeviceError(DEVICE_DRIVER, _CALL, f"{ENVIRONMENT}={selector!r}; the devices are{rows}", tip=tip)


def caches_kernels(device: cl.Device) -> bool:
    """Return whether the driver keeps compiled kernels in a folder (`rhi.backends.cl.pocl.kernel_cache`)."""
    return device.platform.name == _POCL and os.environ.get("POCL_KERNEL_CACHE", "1") != "0"


def declares_kernels(device: cl.Device) -> bool:
    """Return whether programs can do without the driver's header (`rhi.backends.cl.pocl.declarations`).

    That takes a device with doubles, since the declarations include functions of doubles."""
    return "cl_khr_fp64" in device.extensions.split()


def _request_probe(cache: KernelCache) -> Request:
    return cache.request(_PROBE, QUICK)


def probe(context: cl.Context, queue: cl.CommandQueue, cache: KernelCache) -> bool:
    """Build a kernel and run it twice, on host memory that changes in between. Return whether kernel
    and host saw each other's writes.

    Raises:
        pyopencl.Error: the kernel can't be built or run.
        RuntimeError: the kernel computes wrong numbers.
    """
    request = _request_probe(cache)
    stored = cache.find(request.key)
    with cache.watch_use(request.key):
        try:
            program = build_cached(context, cache, request, stored)
        except cl.Error:
            if not cache.declares:
                raise
            cache.declares = False  # a version of the driver that can't do without its header
            program = build_cached(context, cache, _request_probe(cache), stored)
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
    return shows and np.array_equal(seen[:_COUNT], 21 + ramp) and np.array_equal(words, seen)


def build_cached(
    context: cl.Context, cache: KernelCache, request: Request, stored: CachedProgram | None
) -> cl.Program:
    """Build a program from the driver's LLVM code or from its source. `stored`: its entry in the cache, or
    None; it is then added."""
    binary = cache.make_binary(request) if stored is not None and stored.code else None
    if binary is None:  # the driver may write machine code beside its LLVM code at any launch
        cache.hold(request.key)
        if not cache.is_recorded(request.key):  # another process has removed it just before
            stored = None
    if stored is not None and not stored.code:
        return build(context, *request.write())
    if stored is not None:
        with suppress(cl.Error):
            return build_again(context, binary or stored.code, request.options)
        cache.hold(request.key)
        cache.forget(request.key)
    with cache.writing(request.key) as is_safe:
        if not is_safe:
            return build(context, *request.write(make_mark()))
        code = cache.read_code(request.key)
        if code is None and cache.takes_code:
            with suppress(cl.Error):  # the build reports the error
                mark = make_mark()
                compiled = compile_only(context, *request.write(mark))
                binaries: Any = compiled.get_info(
                    cl.program_info.BINARIES
                )  # nothing is generated: it isn't linked
                cache.store_header(binaries[0])
                code = cache.store_code(request.key, mark)
        try:
            program = build_again(context, code, request.options) if code else None
        except cl.Error:
            cache.drop_code(request.key)
            program = None
        if program is None:
            program = build(context, *request.write())
        cache.record(request.key)
    return program


def compile_only(context: cl.Context, source: str, options: Sequence[str]) -> cl.Program:
    """Compile a program, which isn't linked. Warnings are suppressed."""
    with _WARNINGS, warnings.catch_warnings():  # pyopencl's own, too, which has no cache for that
        warnings.simplefilter("ignore")
        compiled: cl.Program = cl.Program(context, source).compile([SILENT, *options])
        return compiled


def build(context: cl.Context, source: str, options: Sequence[str]) -> cl.Program:
    """Build a program. Compiler warnings are suppressed."""
    with _WARNINGS, warnings.catch_warnings():  # some drivers warn in spite of the option
        warnings.simplefilter("ignore", cl.CompilerWarning)
        return build_again(context, source, options)


def build_again(context: cl.Context, text: str | bytes, options: Sequence[str]) -> cl.Program:
    """Build a program that built before, from its source or from the driver's LLVM code. Unlike `build` safe
    in any thread, since warning filters are process-wide."""
    program = (
        cl.Program(context, text) if isinstance(text, str) else cl.Program(context, context.devices, [text])
    )
    built: cl.Program = program.build([SILENT, *options])
    return built


def allocate_pages(size: int, data: NDArray[Any] = EMPTY) -> NDArray[np.uint8]:
    """Return page-aligned host memory, shape (size,): the bytes of `data`, shape (n,), then zeros."""
    memory = np.zeros(size + PAGE, np.uint8)
    start = -memory.ctypes.data % PAGE
    memory = memory[start : start + size]
    memory[: data.nbytes] = data.view(np.uint8)
    return memory
