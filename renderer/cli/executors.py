"""Makes the executors that `--executor` names.

Each of several processes gets CPUs of its own, and its drivers as many threads. PoCL and llvmpipe would
otherwise start a thread for every CPU in each process, and PoCL's are pinned
(`rhi.backends.cl.pocl.workers`): those of all processes to the same CPUs. Then N processes would be no faster
than one, and times would be those of waiting for the others.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing import get_context
from multiprocessing.queues import SimpleQueue
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

from renderer.cli.output import OutputError
from renderer.rules import describe_missing

P = ParamSpec("P")
R = TypeVar("R")

KINDS: Final = "serial, processes, processes:N, threads:N, dask:ADDRESS"
_THREAD_COUNTS: Final = ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT", "LP_NUM_THREADS")
"""The variables that drivers take the number of their threads from: PoCL up to version 4, PoCL since,
llvmpipe."""
_TASKS: Final = Path("/proc/self/task")
_SIBLINGS: Final = "/sys/devices/system/cpu/cpu{}/topology/thread_siblings_list"


class SerialExecutor(Executor):
    """An executor that runs each call in this process, when it is submitted."""

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Run the call and return a finished future."""
        future: Future[R] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def make_executor(text: str) -> Iterator[Executor]:
    """Yield the executor that `--executor` names."""
    kind, _, rest = text.partition(":")
    is_count = not rest or (rest.isascii() and rest.isdigit() and int(rest) > 0)
    if kind == "serial" and not rest:
        yield SerialExecutor()
    elif kind == "processes" and is_count:
        try:
            with open_processes(partition_cpus(int(rest) if rest else len(list_cpus()))) as pool:
                yield pool
        except BrokenExecutor:
            raise OutputError(
                f"--executor: a process of {text} was killed; results of the other processes are saved"
            ) from None
    elif kind == "threads" and is_count:
        with ThreadPoolExecutor(int(rest) if rest else None) as threads:
            yield threads
    elif kind == "dask" and rest:
        try:
            distributed: Any = import_module("distributed")
        except ModuleNotFoundError:
            raise OutputError(f"--executor: {describe_missing('dask', 'dask')}") from None
        try:
            client = distributed.Client(rest, timeout=30)
        except (OSError, TimeoutError, ValueError) as error:
            raise OutputError(f"--executor: no scheduler at {rest}: {error}") from None
        with client:
            yield client.get_executor()
    else:
        raise OutputError(f"--executor: {text!r} is none of {KINDS}")


def list_cpus() -> list[int]:
    """The CPUs that this process may use; those of a core follow each other."""
    if not hasattr(os, "sched_getaffinity"):
        return list(range(os.cpu_count() or 1))

    def find_core(cpu: int) -> int:
        try:
            siblings = Path(_SIBLINGS.format(cpu)).read_text(encoding="utf-8")
        except OSError:
            return cpu
        return int(siblings.replace("-", ",").partition(",")[0])

    return sorted(os.sched_getaffinity(0), key=lambda cpu: (find_core(cpu), cpu))


def partition_cpus(count: int) -> list[list[int]]:
    """The CPUs of each of `count` processes: as many for each, none twice unless there are fewer."""
    cpus = list_cpus()
    each = max(len(cpus) // count, 1)
    return [[cpus[(number * each + i) % len(cpus)] for i in range(each)] for number in range(count)]


def open_processes(cpu_groups: Sequence[Sequence[int]]) -> ProcessPoolExecutor:
    """Open an executor with a process for each group of CPUs. Processes are spawned: a driver's state doesn't
    survive a fork."""
    context = get_context("spawn")
    remaining: SimpleQueue[Sequence[int]] = context.SimpleQueue()
    for cpus in cpu_groups:
        remaining.put(cpus)
    return ProcessPoolExecutor(
        len(cpu_groups), mp_context=context, initializer=_use_next_cpus, initargs=(remaining,)
    )


def _use_next_cpus(remaining: SimpleQueue[Sequence[int]]) -> None:
    """Use one of the groups of CPUs in this process, before any driver has started its threads."""
    use_cpus(remaining.get())


def use_cpus(cpus: Sequence[int]) -> None:
    """Restrict this process to these CPUs. Drivers that start later have as many threads, unless the user has
    set their number."""
    for name in _THREAD_COUNTS:
        os.environ.setdefault(name, str(len(cpus)))
    if hasattr(os, "sched_setaffinity"):
        for task in _TASKS.iterdir():  # NumPy has started threads already
            with suppress(OSError):  # the thread has ended
                os.sched_setaffinity(int(task.name), cpus)
