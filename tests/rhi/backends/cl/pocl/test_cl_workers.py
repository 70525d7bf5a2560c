"""PoCL's worker threads are pinned to CPUs of their own."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from rhi.backends.cl.pocl.workers import list_threads, spread_threads

CPUS = sorted(os.sched_getaffinity(0)) if sys.platform == "linux" else []
pytestmark = pytest.mark.skipif(len(CPUS) < 2, reason="needs two CPUs of a Linux machine")

WHERE = """
import os, rhi
from rhi.backends.cl.pocl.workers import list_threads
before = list_threads()
rhi.create_device("cl").close()
print(sorted(sorted(os.sched_getaffinity(thread)) for thread in list_threads() - before))
"""


@pytest.fixture
def threads() -> Iterator[list[int]]:
    """The ids of two idle threads."""
    done = threading.Event()
    started = [threading.Thread(target=done.wait) for _ in range(2)]
    for thread in started:
        thread.start()
    yield [thread.native_id or 0 for thread in started]
    done.set()
    for thread in started:
        thread.join()


def affinities(threads: list[int]) -> list[set[int]]:
    return [os.sched_getaffinity(thread) for thread in threads]


def test_list_threads_includes_started_threads(threads: list[int]) -> None:
    assert set(threads) <= list_threads()


def test_each_thread_stays_on_a_cpu_of_its_own(threads: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("POCL_AFFINITY", raising=False)
    spread_threads(set(threads))
    first, second = affinities(threads)
    assert len(first) == len(second) == 1
    assert first != second


def test_the_users_own_choice_goes_before(threads: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POCL_AFFINITY", "0")
    spread_threads(set(threads))
    assert affinities(threads) == [os.sched_getaffinity(0)] * 2


def test_more_threads_than_cpus_are_left_alone(threads: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("POCL_AFFINITY", raising=False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    spread_threads(set(threads))
    monkeypatch.undo()
    assert affinities(threads) == [os.sched_getaffinity(0)] * 2


@pytest.mark.skipif(os.cpu_count() != len(CPUS), reason="PoCL has a worker for each CPU of the machine")
@pytest.mark.parametrize("choice", [None, "0"])
def test_a_device_pins_its_workers_unless_pocl_affinity_says_otherwise(choice: str | None) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "POCL_AFFINITY"}
    environment |= {} if choice is None else {"POCL_AFFINITY": choice}
    run = subprocess.run(
        [sys.executable, "-c", WHERE],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
        encoding="utf-8",
    )
    assert run.stdout.strip() == str([[cpu] for cpu in CPUS] if choice is None else [CPUS] * len(CPUS))
