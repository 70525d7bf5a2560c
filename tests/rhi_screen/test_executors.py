"""Executors: each of several processes has CPUs and drivers' threads of its own."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from rhi.errors import DeviceError, ValidationError
from rhi_screen import executors
from rhi_screen.executors import list_cpus, make_executor, partition_cpus

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
        (tmp_path / str(cpu)).write_text(f"{cpu % 4},{cpu % 4 + 4}\n")
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
