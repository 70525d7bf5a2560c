"""`reduce`: what is left is small, whole and still shows the fault."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nightly_reasons import CHEAPER_TEST
from trace_kit import VERSION_1

import rhi
from rhi import Op
from rhi.conformance.validation.refusal import refuses
from rhi.testing import expect
from rhi.trace import Trace, load, reduce, replay, save, write_test
from rhi.trace.reduce import _Parts
from rhi.trace.rules import TRACE_PREDICATE


@pytest.fixture(scope="module")
def trace() -> Trace:
    return load(VERSION_1)


def has_scissored_draw(trace: Trace) -> bool:
    """A fault: something is drawn under a scissor."""
    scissored = expect(trace.stream).draws().with_states(rhi.Scissor(0, 0, 32, 48))
    return len(scissored.matches()) > 0


def ops(trace: Trace) -> list[str]:
    return [command.op.method for command in trace.stream]


def test_a_reduced_trace_keeps_only_commands_that_the_fault_needs(trace: Trace) -> None:
    small = reduce(trace, has_scissored_draw)
    assert has_scissored_draw(small)
    assert len(small) <= 12
    assert ops(small).count("begin_pass") == ops(small).count("end_pass") == 1
    assert ops(small).count("set_states") == 1
    assert "dispatch" not in ops(small)
    assert len(small.stream.draws()) == 1


def test_nothing_more_can_be_left_out(trace: Trace) -> None:
    small = reduce(trace, has_scissored_draw)
    parts = _Parts(small.stream)
    for index in range(len(small)):
        remaining = parts.complete([other for other in range(len(small)) if other != index])
        assert not has_scissored_draw(small.select(remaining))


def test_a_reduced_trace_loads_and_replays(trace: Trace, tmp_path: Path, null_device: rhi.Device) -> None:
    small = reduce(trace, has_scissored_draw)
    save(small, tmp_path / "small.zip")
    again = load(tmp_path / "small.zip")
    assert str(again.stream) == str(small.stream)
    assert replay(again, on=null_device).commands == len(small)


@settings(max_examples=60)
@given(data=st.data())
def test_any_selection_of_commands_is_completed_to_a_valid_trace(
    trace: Trace, tmp_path: Path, data: st.DataObject
) -> None:
    selected = [
        i
        for i, is_selected in enumerate(data.draw(st.lists(st.booleans(), min_size=87, max_size=87)))
        if is_selected
    ]
    remaining = _Parts(trace.stream).complete(selected)
    assert set(remaining) <= set(selected)
    save(trace.select(remaining), tmp_path / "part.zip")
    load(tmp_path / "part.zip")  # which checks that each command can be issued


def test_a_wait_goes_with_its_signal() -> None:
    with rhi.create_device("null") as device:
        device.wait(device.signal())
        device._backend.wait(1, 1.0)  # whether or not the device found that it needn't
        parts, last = _Parts(device.stream), len(device.stream) - 1
        signal = device.stream.filter(Op.SIGNAL)[0].index
        assert parts.complete([signal, last]) == [signal, last]
        assert parts.complete([last]) == []


def test_a_whole_trace_stays_whole(trace: Trace) -> None:
    everything = list(range(len(trace)))
    assert _Parts(trace.stream).complete(everything) == everything


def test_a_predicate_that_does_not_hold_is_refused(trace: Trace) -> None:
    with refuses(TRACE_PREDICATE):
        reduce(trace, lambda trace: False)


def test_attempts_are_limited(trace: Trace) -> None:
    calls = []

    def holds(trace: Trace) -> bool:
        calls.append(len(trace))
        return True

    assert len(reduce(trace, holds)) == 0
    calls.clear()
    reduce(trace, holds, attempts=1)
    assert len(calls) == 2


def test_an_error_of_the_library_means_that_the_fault_is_not_there(trace: Trace) -> None:
    def needs_presents(trace: Trace) -> bool:
        if not len(trace.stream.filter(Op.PRESENT)):
            rhi.refuse(TRACE_PREDICATE, "test")
        return True

    assert ops(reduce(trace, needs_presents)).count("present") == 1


def run_pytest(folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "--color=no", "-p", "no:cacheprovider", "."],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_the_written_test_fails_alone_until_the_fault_is_gone(trace: Trace, tmp_path: Path) -> None:
    small = reduce(trace, has_scissored_draw)
    file = tmp_path / "test_scissor.py"
    write_test(small, file, has_scissored_draw)
    text = file.read_text(encoding="utf-8")
    assert "draw(vertex_array=" in text
    run = run_pytest(tmp_path)
    assert run.returncode == 1, run.stdout
    assert "1 failed" in run.stdout
    assert "has_scissored_draw" in run.stdout
    file.write_text(text.replace("Scissor(0, 0, 32, 48)", "Scissor(0, 0, 33, 48)"), encoding="utf-8")
    assert run_pytest(tmp_path).returncode == 0, text


def test_a_predicate_without_a_source_is_refused(trace: Trace, tmp_path: Path) -> None:
    with refuses(TRACE_PREDICATE):
        write_test(trace, tmp_path / "test_x.py", lambda trace: True)
    assert not list(tmp_path.iterdir())
