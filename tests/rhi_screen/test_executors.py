"""Executors: each of several processes has CPUs and drivers' threads of its own."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from rhi.errors import DeviceError, ValidationError
from rhi_screen import executors
from rhi_screen.executors import (
    DaskExecutor,
    SerialExecutor,
    get_client,
    is_lost,
    list_cpus,
    make_executor,
    partition_cpus,
    replace_dask_executor,
)

VARIABLES = ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT", "LP_NUM_THREADS")


def look() -> tuple[list[int], list[str | None]]:
    """Return the CPUs that this process may use, and the numbers of drivers' threads."""
    return sorted(os.sched_getaffinity(0)), [os.environ.get(name) for name in VARIABLES]


def test_cpu_groups_are_equal_and_disjoint(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "list_cpus", lambda: list(range(3, 20)))  # 17 of them
    assert partition_cpus(4) == [[3, 4, 5, 6], [7, 8, 9, 10], [11, 12, 13, 14], [15, 16, 17, 18]]
    assert partition_cpus(1) == [list(range(3, 20))]


def test_more_processes_than_cpus_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "list_cpus", lambda: [5, 6])
    assert partition_cpus(2) == [[5], [6]]
    assert partition_cpus(3) == [[5], [6], [5]]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems don't tell")
def test_cpus_of_a_core_follow_each_other(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for cpu in range(8):
        (tmp_path / str(cpu)).write_text(f"{cpu % 4},{cpu % 4 + 4}\n", encoding="utf-8")
    monkeypatch.setattr(executors, "_SIBLINGS", f"{tmp_path}/{{}}")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3, 4, 5, 6, 7})
    assert list_cpus() == [0, 4, 1, 5, 2, 6, 3, 7]
    monkeypatch.setattr(executors, "_SIBLINGS", f"{tmp_path}/none/{{}}")
    assert list_cpus() == list(range(8))


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no affinity")
def test_each_process_has_cpus_and_threads_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    cpus = sorted(os.sched_getaffinity(0))
    if len(cpus) < 2:
        pytest.skip("one CPU")
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    half = len(cpus) // 2
    monkeypatch.setenv("LP_NUM_THREADS", "7")  # what the user has set stays
    with make_executor("processes:2") as pool:
        shares, counts = zip(*(pool.submit(look).result() for _ in range(2)), strict=True)
    assert all(len(share) == half and set(share) <= set(cpus) for share in shares)
    assert counts == ([str(half), str(half), "7"],) * 2
    assert look() == (cpus, [None, None, "7"])  # this process is as it was


def test_a_process_that_is_ended_is_an_error_of_one_line() -> None:
    with (
        pytest.raises(DeviceError, match="a process of processes:1 was ended"),
        make_executor("processes:1") as pool,
    ):
        assert pool.submit(abs, -1).result() == 1
        pool.submit(os._exit, 1).result()


def test_an_executor_of_an_unknown_kind_is_refused() -> None:
    for text in ("process", "processes:0", "threads:x", "dask", "serial:2"):
        with pytest.raises(ValidationError, match="is none of serial, processes"), make_executor(text):
            pass


class Remote:
    """A call on a cluster, as Dask shows it."""

    def __init__(self, outcome: object) -> None:
        self.outcome = outcome
        self.is_cancelled = False
        self.callbacks: list[Callable[[Remote], object]] = []

    def add_done_callback(self, callback: Callable[[Remote], object]) -> None:
        self.callbacks.append(callback)

    def result(self) -> object:
        if isinstance(self.outcome, BaseException):
            raise self.outcome
        return self.outcome

    def cancel(self) -> None:
        self.is_cancelled = True

    def finish(self) -> None:
        for callback in self.callbacks:
            callback(self)


class Cluster:
    """A Dask client whose calls end with these outcomes."""

    def __init__(self, *outcomes: object) -> None:
        self.remotes = [Remote(outcome) for outcome in outcomes]
        self.calls: list[tuple[object, ...]] = []

    def get_executor(self) -> object:
        raise NotImplementedError

    def submit(self, *call: object, pure: bool) -> Remote:
        assert not pure
        self.calls.append(call)
        return self.remotes[len(self.calls) - 1]


class KilledWorker(Exception):  # noqa: N818 (Dask's name)
    """Dask's error of a call that has ended its workers."""


def test_a_call_on_a_cluster_has_the_result_of_its_worker() -> None:
    cluster = Cluster(7)
    future = DaskExecutor(cluster).submit(abs, -7)
    assert cluster.calls == [(abs, -7)]
    assert not future.done()
    cluster.remotes[0].finish()
    assert future.result(timeout=0) == 7


def test_a_result_that_is_lost_while_it_is_fetched_ends_its_future_with_the_error() -> None:
    cluster = Cluster(KilledWorker("4 workers died"))
    future = DaskExecutor(cluster).submit(abs, -7)
    cluster.remotes[0].finish()
    error = future.exception(timeout=0)
    assert isinstance(error, KilledWorker)
    assert is_lost(error)


def test_a_cancelled_future_cancels_its_call_and_takes_no_late_result() -> None:
    cluster = Cluster(7)
    future = DaskExecutor(cluster).submit(abs, -7)
    assert future.cancel()
    assert cluster.remotes[0].is_cancelled
    cluster.remotes[0].finish()
    assert future.cancelled()


def test_clients_and_executors_of_dask_are_replaced_and_no_others() -> None:
    cluster = Cluster()
    of_client = replace_dask_executor(cluster)
    assert isinstance(of_client, DaskExecutor)
    assert get_client(of_client) is cluster
    assert replace_dask_executor(of_client) is of_client
    with SerialExecutor() as serial:
        assert replace_dask_executor(serial) is serial
    theirs = SerialExecutor()
    theirs._client = cluster  # type: ignore[attr-defined] # as Dask's own executor has it
    assert isinstance(replace_dask_executor(theirs), DaskExecutor)
