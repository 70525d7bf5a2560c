"""Executors by name: where films, sweeps, exams and comparisons run their calls.

    with make_executor("processes:4") as executor:
        futures = [executor.submit(work, number) for number in range(100)]

All are `concurrent.futures.Executor`s:

- `serial` runs a call when it is submitted, in this process.
- `threads:N` runs calls on N threads of this process.
- `processes:N` runs calls in N processes. If one ends during a call, another process takes its place and runs
  the call again. A call that ends three processes isn't tried again.
- `dask:ADDRESS` runs calls on the workers of a Dask cluster. Dask runs the calls of a worker that has died on
  the others, up to three times.

Each of several processes gets CPUs of its own, and its drivers as many threads. PoCL and llvmpipe would
otherwise start a thread for every CPU in each process, and PoCL's are pinned
(`rhi.backends.cl.pocl.workers`): those of all processes to the same CPUs. Then N processes would be no faster
than one, and times would be those of waiting for the others.
"""

from __future__ import annotations

import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ThreadPoolExecutor,
)
from concurrent.futures import wait as wait_for
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from threading import RLock
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, ParamSpec, TypeVar

from rhi.errors import DeviceError, refuse
from rhi_screen.rules import EXECUTOR_ENDED, EXECUTOR_MISSING, EXECUTOR_NAME, EXECUTOR_SCHEDULER

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor

P = ParamSpec("P")
R = TypeVar("R")

SERIAL: Final = "serial"
KINDS: Final = "serial, processes, processes:N, threads:N, dask:ADDRESS"
MAX_DEATHS: Final = 3
"""So many processes may end during one call before it isn't tried again."""
NO_WORKER_SECONDS: Final = 60.0
"""A cluster that has lost its last worker is given up after this time."""

_CHECK_SECONDS: Final = 1.0
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


class LostCallError(BrokenExecutor):
    """A call that has ended each process that ran it."""


@dataclass(eq=False, slots=True)
class _SubmittedCall:
    """A call that waits for a process, or runs in one."""

    future: Future[Any]
    run: Callable[[], Any]
    deaths: int = 0


@dataclass(eq=False, slots=True)
class _Worker:
    """A process with CPUs of its own, as a pool of one; None until it is first needed, and after its end."""

    cpus: Sequence[int]
    pool: ProcessPoolExecutor | None = None

    def submit(self, run: Callable[[], Any]) -> Future[Any]:
        """Run a call in the process. Processes are spawned: a driver's state doesn't survive a fork."""
        if self.pool is None:
            from concurrent.futures import ProcessPoolExecutor  # the Python of a page has no processes
            from multiprocessing import get_context

            self.pool = ProcessPoolExecutor(
                1, mp_context=get_context("spawn"), initializer=_begin_worker, initargs=(self.cpus,)
            )
        return self.pool.submit(run)


class WorkerProcesses(Executor):
    """An executor with a process for each group of CPUs, each of which runs one call at a time.

    A process that ends during a call is replaced, and its call runs again. After `MAX_DEATHS` ends, the
    call's future raises `LostCallError`; other calls aren't affected.
    """

    def __init__(self, cpu_groups: Sequence[Sequence[int]]) -> None:
        """Begin a process for each group of CPUs, when there is a call for it."""
        self._idle = [_Worker(cpus) for cpus in reversed(cpu_groups)]
        self._workers = tuple(self._idle)
        self._waiting: deque[_SubmittedCall] = deque()
        self._unfinished: set[Future[Any]] = set()
        self._lock = RLock()
        self._is_closed = self._is_killed = False

    def __len__(self) -> int:
        return len(self._workers)

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Run the call in the next process that is idle."""
        future: Future[R] = Future()
        with self._lock:
            if self._is_closed:
                raise RuntimeError("cannot schedule new futures after shutdown")
            self._waiting.append(_SubmittedCall(future, partial(fn, *args, **kwargs)))
            self._unfinished.add(future)
        self._feed()
        return future

    def _feed(self) -> None:
        """Give waiting calls to idle processes."""
        while True:
            with self._lock:
                if not self._waiting or not self._idle:
                    return
                call = self._waiting.popleft()
                if not call.deaths and not call.future.set_running_or_notify_cancel():
                    self._unfinished.discard(call.future)
                    continue
                worker = self._idle.pop()
                try:
                    inner = worker.submit(call.run)
                except BrokenExecutor:  # it ended while it was idle
                    worker.pool = None
                    inner = worker.submit(call.run)
            inner.add_done_callback(partial(self._finish, worker, call))

    def _finish(self, worker: _Worker, call: _SubmittedCall, inner: Future[Any]) -> None:
        """Hand over the result of a call, or run it again if its process has ended."""
        error = inner.exception()
        has_died = isinstance(error, BrokenExecutor)
        with self._lock:
            if has_died:
                call.deaths += 1
                worker.pool = (
                    None  # it mends nothing, and it can't be shut down on this thread, which is its own
                )
            self._idle.append(worker)
            is_repeated = has_died and call.deaths < MAX_DEATHS and not self._is_killed
            if is_repeated:
                self._waiting.appendleft(call)
            else:
                self._unfinished.discard(call.future)
        if error is None:
            call.future.set_result(inner.result())
        elif not has_died:
            call.future.set_exception(error)
        elif not is_repeated:
            call.future.set_exception(LostCallError(f"{call.deaths} processes ended during one call"))
        self._feed()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes once they have run the calls that were submitted.

        Args:
            wait: whether to wait for the calls; otherwise those that wait for a process are cancelled, too.
            cancel_futures: whether calls that wait for a process are cancelled.
        """
        with self._lock:
            self._is_closed = True
            if cancel_futures or not wait:
                for call in self._waiting:
                    if call.future.cancel():
                        self._unfinished.discard(call.future)
            unfinished = set(self._unfinished)
        if wait:
            wait_for(unfinished)
        for worker in self._workers:
            if (pool := worker.pool) is not None:
                pool.shutdown(wait=wait)

    def kill(self) -> None:
        """End the processes now; their calls are lost."""
        with self._lock:
            self._is_closed = self._is_killed = True
            for call in self._waiting:
                call.future.cancel()
            self._unfinished.difference_update([call.future for call in self._waiting])
            self._waiting.clear()
            pools = [worker.pool for worker in self._workers if worker.pool is not None]
        for pool in pools:
            for process in list((getattr(pool, "_processes", None) or {}).values()):
                process.kill()


@contextmanager
def make_executor(text: str, call: str = "--executor") -> Iterator[Executor]:
    """Yield the executor that a text names, one of `KINDS`. After an exception, running calls are ended.

    Args:
        call: named in errors.

    Raises:
        ValidationError: `executor-name`.
        DeviceError: `executor-missing` without Dask, `executor-scheduler`, and `executor-ended` if a call has
            ended the processes that ran it.
    """
    kind, _, rest = text.partition(":")
    is_count = not rest or (rest.isascii() and rest.isdigit() and int(rest) > 0)
    try:
        if kind == SERIAL and not rest:
            yield SerialExecutor()
        elif kind == "processes" and is_count:
            with open_processes(partition_cpus(int(rest) if rest else len(list_cpus()))) as pool:
                yield pool
        elif kind == "threads" and is_count:
            with ThreadPoolExecutor(int(rest) if rest else None) as threads:
                yield threads
        elif kind == "dask" and rest:
            with _open_client(rest, call) as client:
                yield DaskExecutor(client)
        else:
            refuse(EXECUTOR_NAME, call, f"{text!r} is none of {KINDS}")
    except Exception as error:
        if is_lost(error):
            raise DeviceError(EXECUTOR_ENDED, call, f"a process of {text} was ended") from None
        raise


@contextmanager
def _open_client(address: str, call: str) -> Iterator[Any]:
    """Yield a client of the Dask scheduler at an address."""
    try:
        distributed: Any = import_module("distributed")
    except ModuleNotFoundError:
        raise DeviceError(EXECUTOR_MISSING, call, "dask is missing") from None
    try:
        client = distributed.Client(address, timeout=30, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise DeviceError(EXECUTOR_SCHEDULER, call, f"no scheduler at {address}: {error}") from None
    with client:
        yield client


class DaskExecutor(Executor):
    """Runs calls on the workers of a Dask cluster.

    Dask's own executor leaves a future unfinished for ever if its result is lost with the worker that held it,
    and the calls that compute it again end their workers too: the error is raised where nobody waits. So this
    executor asks for each result on Dask's thread of callbacks.
    """

    def __init__(self, client: Any) -> None:
        self._client = client

    def submit(self, function: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Run a call on a worker. A cancelled future cancels the call, too."""
        future: Future[R] = Future()
        remote = self._client.submit(function, *args, pure=False, **kwargs)
        future.add_done_callback(lambda done: remote.cancel() if done.cancelled() else None)
        remote.add_done_callback(partial(_settle, future))
        return future


def _settle(future: Future[Any], remote: Any) -> None:
    """Give a future the outcome of a call that a cluster has run."""
    try:
        result, error = remote.result(), None
    except BaseException as raised:
        result, error = None, raised
    if not future.set_running_or_notify_cancel():
        return
    if error is None:
        future.set_result(result)
    else:
        future.set_exception(error)


def get_client(executor: Executor) -> Any | None:
    """Return the Dask client of an executor, or None if it has none."""
    return getattr(executor, "_client", None)


def replace_dask_executor(executor: Any) -> Executor:
    """Return an executor that finishes all of its futures, for a Dask client and for Dask's own executor; any
    other executor is returned as it is."""
    if isinstance(executor, DaskExecutor):
        return executor
    client = executor if hasattr(executor, "get_executor") else get_client(executor)
    return executor if client is None else DaskExecutor(client)


def is_lost(error: BaseException) -> bool:
    """True if a call raised this because the processes that ran it have ended."""
    return isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker"


def count_workers(executor: Executor) -> int:
    """Return the number of calls that an executor runs at a time, now."""
    if isinstance(executor, SerialExecutor):
        return 1
    if isinstance(executor, WorkerProcesses):
        return len(executor)
    client = get_client(executor)
    if client is not None:
        return sum(client.nthreads().values())
    return int(getattr(executor, "_max_workers", 0)) or len(list_cpus())


class WorkerWatch:
    """Notices that an executor has lost its last worker, so that nobody waits for it for ever.

    Attributes:
        count: the calls that the executor ran at a time when it was last asked.
    """

    def __init__(self, executor: Executor, call: str) -> None:
        self.count = 0
        self._executor, self._call = executor, call
        self._asked = -_CHECK_SECONDS
        self._lost: float | None = None
        self.ask()

    def ask(self) -> None:
        """Ask the executor for its workers, at most once a second.

        Raises:
            DeviceError: `executor-ended` if it has had none for `NO_WORKER_SECONDS`, `executor-scheduler` if
                the scheduler doesn't answer.
        """
        now = monotonic()
        if now - self._asked < _CHECK_SECONDS:
            return
        self._asked = now
        try:
            count = count_workers(self._executor)
        except (OSError, TimeoutError) as error:
            raise DeviceError(EXECUTOR_SCHEDULER, self._call, str(error)) from None
        if count:
            self.count, self._lost = count, None
        elif self.count:
            self._lost = now if self._lost is None else self._lost
            if now - self._lost > NO_WORKER_SECONDS:
                raise DeviceError(EXECUTOR_ENDED, self._call, "the cluster has no worker any more")


def as_completed(
    executor: Executor, futures: Iterable[Future[R]], call: str = "--executor"
) -> Iterator[Future[R]]:
    """Yield futures as they finish, as `concurrent.futures.as_completed` does.

    Raises:
        DeviceError: `executor-ended` if the executor has lost all of its workers.
    """
    watch = WorkerWatch(executor, call)
    running = set(futures)
    while running:
        done, running = wait_for(running, timeout=_CHECK_SECONDS, return_when=FIRST_COMPLETED)
        watch.ask()
        yield from done


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
    share = max(len(cpus) // count, 1)
    return [[cpus[(number * share + i) % len(cpus)] for i in range(share)] for number in range(count)]


@contextmanager
def open_processes(cpu_groups: Sequence[Sequence[int]]) -> Iterator[WorkerProcesses]:
    """Yield an executor with a process for each group of CPUs. After an exception the processes are killed."""
    processes = WorkerProcesses(cpu_groups)
    try:
        yield processes
    except BaseException:
        processes.kill()
        raise
    finally:
        processes.shutdown()


def _begin_worker(cpus: Sequence[int]) -> None:
    """Use these CPUs in a process, before any driver has started its threads. Ctrl-C is for the process that
    waits for this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    use_cpus(cpus)


def use_cpus(cpus: Sequence[int]) -> None:
    """Restrict this process to these CPUs. Drivers that start later have as many threads, unless the user has
    set their number."""
    for name in _THREAD_COUNTS:
        os.environ.setdefault(name, str(len(cpus)))
    if hasattr(os, "sched_setaffinity"):
        for task in _TASKS.iterdir():  # NumPy has started threads already
            with suppress(OSError):  # the thread has ended
                os.sched_setaffinity(int(task.name), cpus)
