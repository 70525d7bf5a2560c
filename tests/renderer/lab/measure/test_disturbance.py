"""The time that threads wait for a processor, and clocks that are corrected for it."""

from __future__ import annotations

from os import cpu_count
from pathlib import Path
from time import process_time

import pytest
from busy_kit import busy_processes

from renderer.lab.measure import disturbance
from renderer.lab.measure.disturbance import DISTURBED, Instant, read_waiting_seconds

HAS_COUNTERS = Path("/proc/self/schedstat").exists()


def measure_work(seconds: float) -> Instant:
    began = Instant.now()
    while process_time() - began.processor < seconds:
        pass
    return Instant.now() - began


def test_the_clock_is_corrected_by_the_time_that_threads_waited() -> None:
    taken = Instant(3.0, 2.0, 4.0) - Instant(1.0, 1.0, 1.0)
    assert (taken.slowdown, taken.undisturbed) == (4.0, 0.5)


def test_a_device_that_computes_while_the_processor_rests_keeps_its_time() -> None:
    taken = Instant(5.0, 0.1, 0.0)
    assert (taken.slowdown, taken.undisturbed) == (1.0, 5.0)
    assert Instant(5.0, 0.0, 0.1).undisturbed == 5.0


def test_threads_that_end_take_their_waiting_with_them() -> None:
    assert (Instant(2.0, 2.0, 1.0) - Instant(1.0, 1.0, 3.0)).waiting == 0.0


def test_a_system_without_counters_says_nothing_of_disturbance(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disturbance, "_TASKS", Path("/nothing/here"))
    assert read_waiting_seconds() == 0.0


@pytest.mark.skipif(not HAS_COUNTERS, reason="the system doesn't count how long threads wait")
def test_busy_processes_show_as_a_slowdown_that_is_corrected() -> None:
    with busy_processes(2 * (cpu_count() or 1)):
        busy = measure_work(0.5)
    assert busy.slowdown > 1.5 > DISTURBED
    assert busy.undisturbed == pytest.approx(busy.processor, rel=0.25)
