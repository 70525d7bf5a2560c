"""Refused calls: noted in the stream they belong to, saved, shown, compared, reported, reduced."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testing_kit import Corner, Light, SampleFrame
from trace_kit import VERSION_1, VERSION_2, edit_line, rewrite

import rhi
from rhi import Access, CullMode, Device, Format, Op, Refusal, Scissor
from rhi.conformance.validation.refusal import refuses
from rhi.errors.rules import DEVICE_DRIVER
from rhi.shading import Shader, vec4
from rhi.trace import Trace, diff, load, reduce, replay, save
from rhi.trace.cli import main
from rhi.trace.rules import TRACE_COMMAND, TRACE_COUNT


def line() -> int:
    return sys._getframe(1).f_lineno


def refuse_texture(device: Device) -> None:
    with pytest.raises(rhi.ValidationError):
        device.texture((0, 4), Format.R8)


# -- whose call it was -------------------------------------------------------------------------------------


def test_a_refused_call_is_recorded_with_its_position_in_the_stream(null_device: Device) -> None:
    null_device.buffer(4)
    with null_device.event("sun"), null_device.event("map"):
        with pytest.raises(rhi.ValidationError) as caught:
            expected = line() + 1
            null_device.texture((0, 4), Format.R8)
    (refusal,) = null_device.stream.refusals
    assert (refusal.index, refusal.error, refusal.call) == (3, "texture-size", "device.texture")
    assert refusal.labels == ("sun", "map")
    assert refusal.site is not None
    assert (refusal.site.file, refusal.site.line) == (__file__, expected)
    assert refusal.given == caught.value.given
    assert len(null_device.stream) == 5  # the labels, and the buffer


class Unfit(Shader):
    """Doesn't type-check."""

    def vertex(self, v: Corner) -> vec4:
        return v.position  # type: ignore[return-value]


def break_immediate(sample_frame: SampleFrame) -> None:
    with sample_frame.device.immediate(
        sample_frame.shadow, rhi.Primitive.POINTS, light=sample_frame.light
    ) as points:
        points.vertex(nothing=3)


def break_record(sample_frame: SampleFrame) -> None:
    with sample_frame.device.record() as commands:
        commands.render_pass()


CALLS: dict[str, tuple[Callable[[SampleFrame], object], str]] = {
    "device": (lambda sample_frame: sample_frame.device.render_pass(), "pass-empty"),
    "buffer": (
        lambda sample_frame: sample_frame.light.owner.clear() or sample_frame.device.buffer(3).clear(),
        "buffer-alignment",
    ),
    "buffer's view": (lambda sample_frame: sample_frame.light.write(sample_frame.tint), "layout-mismatch"),
    "texture": (lambda sample_frame: sample_frame.image.at(9), "texture-levels"),
    "mesh": (lambda sample_frame: sample_frame.walls.view(9), "mesh-range"),
    "draw": (
        lambda sample_frame: sample_frame.device.draw(
            sample_frame.shadow, sample_frame.walls, light=sample_frame.light
        ),
        "draw-outside-pass",
    ),
    "program's draw": (
        lambda sample_frame: sample_frame.shadow.draw(sample_frame.walls, light=sample_frame.light),
        "draw-outside-pass",
    ),
    "scope": (
        lambda sample_frame: sample_frame.device.states(CullMode.NONE, CullMode.FRONT).__enter__(),
        "state-duplicate",
    ),
    "query": (lambda sample_frame: sample_frame.device.occlusion_query().wait(), "query-state"),
    "query set": (lambda sample_frame: sample_frame.device.query_set(2).wait(), "query-state"),
    "lock": (
        lambda sample_frame: sample_frame.light.owner.lock(Access.WRITE).__exit__(None, None, None),
        "lock-closed",
    ),
    "immediate": (break_immediate, "immediate-vertex"),
    "command buffer": (break_record, "pass-empty"),
    "submission": (
        lambda sample_frame: sample_frame.device.submit(sample_frame.device.record()),
        "record-state",
    ),
    "transient": (
        lambda sample_frame: sample_frame.device.transient.mesh(sample_frame.shadow, np.zeros(3)),
        "immediate-vertex",
    ),
    "compiler": (lambda sample_frame: sample_frame.device.program(Unfit), "shading-type"),
}


@pytest.mark.parametrize("name", CALLS)
def test_every_kind_of_object_leads_to_its_device(name: str, null_device: Device) -> None:
    break_it, rule = CALLS[name]
    with rhi.create_device("null") as other, rhi.create_device("null", record=False):
        SampleFrame(other)
        sample_frame = SampleFrame(null_device)
        with pytest.raises(rhi.RhiError, match=rf"^\[{rule}\]"):
            break_it(sample_frame)
        (refusal,) = null_device.stream.refusals
        assert refusal.error == rule
        assert other.stream.refusals == ()


def test_an_error_of_a_backend_is_the_failure_of_its_command() -> None:
    from rhi.backends.null import Faults

    with rhi.create_device("null", faults=Faults(memory=0)) as device:
        with pytest.raises(rhi.DeviceError):
            device.buffer(4)
        assert device.stream.refusals == ()
        assert device.stream[0].failure is not None


def test_refusals_without_a_device_are_not_recorded(null_device: Device) -> None:
    for call in (lambda: Scissor(0, 0, -1, 0), lambda: rhi.create_device("nul"), lambda: rhi.FixedStack(0)):
        with pytest.raises(rhi.RhiError):
            call()
    rhi.DeviceError(DEVICE_DRIVER, "here")
    assert null_device.stream.refusals == ()


def test_a_paused_recorder_notes_no_refusal(null_device: Device) -> None:
    recorder = null_device.backend_as(rhi.Recorder)
    with recorder.paused():
        refuse_texture(null_device)
    assert null_device.stream.refusals == ()
    refuse_texture(null_device)
    assert len(null_device.stream.refusals) == 1
    null_device.stream.clear()
    assert null_device.stream.refusals == ()


def test_refused_calls_stand_between_the_commands_as_text(null_device: Device) -> None:
    refuse_texture(null_device)
    null_device.buffer(4)
    with null_device.event("sun"):
        refuse_texture(null_device)
    lines = str(null_device.stream).splitlines()
    assert [line.split()[1] for line in lines] == [
        "device.texture:",
        "create_buffer(buffer=1,",
        "push_label(text='sun')",
        "device.texture:",
        "pop_label()",
    ]
    assert lines[0].endswith("REFUSED [texture-size]")
    assert lines[3].startswith("     ×    device.texture")
    assert "REFUSED" not in str(null_device.stream[:2])
    assert "REFUSED" in str(null_device.stream[1:])
    assert null_device.stream[:2].refusals == ()


# -- files -------------------------------------------------------------------------------------------------


def record(device: Device, *positions: int) -> None:
    """A frame of the house, with refusals before some of its three steps."""
    sample_frame = SampleFrame(device)
    for step in range(3):
        if step in positions:
            refuse_texture(device)
        with device.event(f"step {step}"):
            if step + 10 in positions:
                refuse_texture(device)
            sample_frame.light.write(Light(offset=(0, 0, 0, step)))
    sample_frame.render()
    if 3 in positions:
        refuse_texture(device)


@settings(max_examples=20)
@given(positions=st.sets(st.sampled_from([0, 1, 2, 3, 10, 11, 12])))
def test_refusals_come_back_from_a_file_as_they_were(positions: set[int], tmp_path_factory: Any) -> None:
    file = tmp_path_factory.mktemp("traces") / "t.zip"
    with rhi.create_device("null") as device:
        record(device, *positions)
        save(device, file)
        trace = load(file)
        assert trace.refusals == device.stream.refusals
        assert len(trace.refusals) == len(positions)
        assert not diff(device, trace)
        again = file.with_name("again.zip")
        save(trace, again)
    assert again.read_bytes() == file.read_bytes()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    with rhi.create_device("null") as device:
        record(device, 1, 12, 3)
        save(device, tmp_path / "t.zip")
    return tmp_path / "t.zip"


def test_a_trace_of_version_1_has_no_refusals() -> None:
    trace = load(VERSION_1)
    assert trace.refusals == ()
    assert len(trace) > 50


def test_the_trace_of_version_2_loads_and_replays(null_device: Device) -> None:
    trace = load(VERSION_2)
    (refusal,) = trace.refusals
    assert (refusal.error, refusal.labels) == ("texture-size", ("sun",))
    assert replay(trace, on=null_device).refusals == (refusal,)


@pytest.mark.parametrize(
    "change",
    [
        lambda refusal: refusal.pop("call"),
        lambda refusal: refusal.update(extra=1),
        lambda refusal: refusal.update(refused=3),
        lambda refusal: refusal.update(labels="sun"),
        lambda refusal: refusal.update(labels=[3]),
        lambda refusal: refusal.update(site=99),
        lambda refusal: refusal.update(op="draw"),
    ],
)
def test_a_spoilt_refusal_is_refused(file: Path, change: Callable[[dict[str, Any]], object]) -> None:
    with refuses(TRACE_COMMAND):
        load(edit_line(file, "", change, kind="refused"))
    load(edit_line(file, "", lambda refusal: None, kind="refused"))


def test_there_are_as_many_refusals_as_the_header_says(file: Path) -> None:
    def drop(members: dict[str, bytes]) -> None:
        lines = members["commands.jsonl"].splitlines(keepends=True)
        members["commands.jsonl"] = b"".join(line for line in lines if b'"refused"' not in line)

    with refuses(TRACE_COUNT):
        load(rewrite(file, drop))


# -- what is done with them ----------------------------------------------------------------------------------


def test_a_replay_reports_refused_calls(file: Path, null_device: Device) -> None:
    trace = load(file)
    result = replay(trace, on=null_device)
    assert result.refusals == trace.refusals
    assert [refusal.error for refusal in result.refusals] == ["texture-size"] * 3
    assert result.commands == len(trace)


def streams(*positions: set[int]) -> list[Trace]:
    result = []
    for position in positions:
        with rhi.create_device("null") as device:
            record(device, *position)
            result.append(Trace(device.stream, "null"))
    return result


def test_a_diff_tells_which_calls_are_refused_in_one_trace_only() -> None:
    a, b = streams({1, 12}, {12, 3})
    removed, added = diff(a, b)
    assert isinstance(removed.a, Refusal)
    assert (removed.labels, removed.b) == ((), None)
    assert isinstance(added.b, Refusal)
    assert added.a is None
    assert "REFUSED [texture-size]" in str(removed)
    inside = diff(*streams({12}, set()))
    assert [difference.labels for difference in inside] == [("step 2",)]
    assert not diff(*streams({1, 12, 3}, {1, 12, 3}))


def test_a_call_that_is_refused_for_something_else_is_one_difference() -> None:
    sides = []
    for size in ((0, 4), (0, 5)):
        with rhi.create_device("null") as device:
            device.buffer(4)
            with pytest.raises(rhi.ValidationError):
                device.texture(size, Format.R8)
            sides.append(device.stream)
    (difference,) = diff(*sides)
    assert difference.changes == ("given: 0×4 → 0×5",)
    assert "device.texture" in str(difference)


def test_reduce_drops_refusals_that_the_fault_does_not_need(file: Path) -> None:
    trace = load(file)
    small = reduce(trace, lambda trace_part: len(trace_part.stream.filter(Op.CREATE_PROGRAM)) > 0)
    assert small.refusals == ()


def test_reduce_keeps_refusals_that_the_fault_needs(file: Path) -> None:
    trace = load(file)
    small = reduce(
        trace, lambda trace_part: any(refusal.labels == ("step 2",) for refusal in trace_part.refusals)
    )
    assert len(small) == 0
    assert [refusal.index for refusal in small.refusals] == [0, 0, 0]


def test_the_command_line_shows_and_reports_them(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", str(file)]) == 0
    out, err = capsys.readouterr()
    assert out.count("REFUSED [texture-size]") == 3
    assert "3 refused" in err
    assert main(["show", str(file), "--label", "step 2"]) == 0
    assert capsys.readouterr().out.count("REFUSED") == 1
    assert main(["replay", str(file), "--backend", "null"]) == 0
    assert capsys.readouterr().err.count("refused before command") == 3
