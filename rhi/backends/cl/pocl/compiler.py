"""Compiles kernels in another process, into the driver's cache on disk.

PoCL has one compiler per process, and while it generates machine code, no kernel can be launched. The other
process runs this file as a script: it imports nothing of rhi, which would take longer than a kernel.

- Machine code is generated at a kernel's first launch. So the process launches a work-group of each kernel,
  with memory of zeros: with these a draw has nothing to do, and a dispatch little. A kernel that they harm
  ends the process, and the device goes on with the kernel that it has.
- Otherwise the process isn't killed, since a half-written file in the cache would harm those who read it:
  when its device is closed, it finishes its kernels and ends. Until then it holds the lock of what it writes.
"""

from __future__ import annotations

import os
import pickle
import select
import subprocess
import sys
import threading
from contextlib import suppress
from typing import IO, Any, Final, NamedTuple

_NICE: Final = 5  # frames have priority, but optimised kernels shorten them to a quarter
_PATIENCE: Final = 0.02  # seconds that closing a device waits at most
_LOCKED: Final = 20  # seconds that a lock is waited for
_LONGEST: Final = 60.0  # processor seconds of a program; a loop may not end if its data are zeros
_ZEROS: Final = 1 << 16  # bytes of zeros


class Job(NamedTuple):
    """Kernels to compile.

    Attributes:
        source: OpenCL C, or the driver's LLVM code of a program.
        names, arguments: those of `rhi.backends.cl.builds.Launch`. Without names, the program is compiled and
            not linked.
        lock: a file to lock meanwhile; empty for none.
    """

    source: str | bytes
    options: tuple[str, ...]
    names: tuple[str, ...]
    arguments: tuple[Any, ...]
    lock: str


class Compiler:
    """A process that compiles kernels."""

    def __init__(self, device: Any) -> None:
        """Start the process.

        Args:
            device: an OpenCL device.

        Raises:
            OSError: it can't be started.
        """
        devices = device.platform.get_devices()
        device_name = device.platform.name, device.platform.version, str(devices.index(device))
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
            "POCL_MAX_PTHREAD_COUNT": "1",
        }
        self._process = subprocess.Popen(
            [sys.executable, "-W", "ignore", __file__, *device_name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        self._closed = False

    def compile(self, job: Job) -> None:
        """Compile kernels, and wait for the result.

        Raises:
            OSError, EOFError: the process has ended, or `close` was called.
            ValueError: the driver refused.
        """
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        pickle.dump(tuple(job), stdin)
        stdin.flush()
        while not select.select([stdout], [], [], _PATIENCE)[0]:
            if self._closed:
                raise EOFError("the device was closed")
        if not pickle.load(stdout):
            raise ValueError("the driver refused kernels")

    def stop(self) -> None:
        """Make `compile` return at once; may be called from any thread."""
        self._closed = True

    def close(self) -> None:
        """End the process when it has finished its kernels. No thread may be in `compile`."""
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with suppress(OSError):
                pipe.close()
        threading.Thread(target=self._process.wait, name="rhi kernels' end", daemon=True).start()


def _serve(platform_name: str, version: str, index: int, jobs: IO[bytes], answers: IO[bytes]) -> None:
    import pyopencl as cl

    platforms = [
        platform
        for platform in cl.get_platforms()
        if (platform.name, platform.version) == (platform_name, version)
    ]
    context = cl.Context([platforms[0].get_devices()[index]])
    queue = cl.CommandQueue(context)
    while True:
        source, options, names, arguments, path = pickle.load(jobs)
        lock = None
        try:
            lock = _lock(path)
            _limit_time()
            program = cl.Program(
                context, *((source,) if isinstance(source, str) else (context.devices, [source]))
            )
            program = program.build(["-w", *options]) if names else program.compile(["-w", *options])
            for name in names:
                kernel = cl.Kernel(program, name)
                values = [_make_argument(context, argument) for argument in arguments]
                kernel.set_args(*[value for value, _ in values])
                items = kernel.get_work_group_info(
                    cl.kernel_work_group_info.COMPILE_WORK_GROUP_SIZE, queue.device
                )
                group = tuple(items) if any(items) else (1,)
                cl.enqueue_nd_range_kernel(queue, kernel, group, group).wait()
        except (cl.Error, TimeoutError):
            pickle.dump(False, answers)
        else:
            pickle.dump(True, answers)
        finally:
            if lock is not None:
                lock.close()
        answers.flush()


def _make_argument(context: Any, argument: int | bytes | tuple[bytes, tuple[int, ...]]) -> tuple[Any, object]:
    """Return an argument of `rhi.backends.cl.builds.Launch` as kernels take it, and the memory that it
    needs."""
    import numpy as np
    import pyopencl as cl

    if isinstance(argument, int):
        return np.int32(argument), None
    contents, addresses = (argument, None) if isinstance(argument, bytes) else argument
    zeros = len(contents) // 64 * 64 + 64  # where they begin
    memory = np.zeros((zeros + _ZEROS) // 8, np.uint64)
    memory[: len(contents) // 8] = np.frombuffer(contents, np.uint64)
    if addresses is None:
        return cl.Buffer(context, cl.mem_flags.USE_HOST_PTR, hostbuf=memory), memory
    memory[np.array(addresses, int) // 8] = memory.ctypes.data + zeros
    return np.uint64(memory.ctypes.data), memory


def _limit_time() -> None:
    """End the process if it takes longer than `_LONGEST` from now on."""
    import signal

    with suppress(AttributeError):  # a system without such timers
        signal.setitimer(signal.ITIMER_VIRTUAL, _LONGEST)


def _lock(path: str) -> IO[bytes] | None:
    """Lock a file; return it, or None where there are no locks.

    Raises:
        TimeoutError: another process holds it for longer than `_LOCKED`; it may be stopped.
    """
    if not path:
        return None
    try:
        import fcntl
        import signal
    except ImportError:
        return None
    signal.signal(signal.SIGALRM, _give_up)
    signal.alarm(_LOCKED)
    lock: IO[bytes] | None = None
    try:
        while True:
            try:
                lock = open(path, "wb")  # noqa: SIM115
            except OSError:
                return None
            fcntl.flock(lock, fcntl.LOCK_EX)
            with suppress(OSError):  # as in `rhi.contract.trust.lock`: another process has removed the file
                if os.path.samestat(os.fstat(lock.fileno()), os.stat(path)):
                    return lock
            lock.close()
    except TimeoutError:
        if lock is not None:
            lock.close()
        raise
    finally:
        signal.alarm(0)


def _give_up(*_: object) -> None:
    raise TimeoutError


def _main() -> None:
    import signal

    signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # the terminal sends it to all processes; the parent handles it
    with suppress(OSError):
        os.nice(_NICE)
    answers = os.fdopen(os.dup(1), "wb")
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    with suppress(EOFError, BrokenPipeError):
        _serve(sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.stdin.buffer, answers)
    os._exit(0)  # drivers take their time to end


if __name__ == "__main__":
    _main()
