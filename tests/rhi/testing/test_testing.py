"""`rhi.testing`: expectations on commands, and the messages of failures."""

from __future__ import annotations

import re

import pytest
from nightly_reasons import CHEAPER_TEST
from testing_kit import Light, SampleFrame, Shadow

import rhi
from rhi import CullMode, DepthBias, DepthFunction, DepthWrite, Op
from rhi.testing import CallCounts, count_work, expect, frames

pytest_plugins = ["pytester"]


@pytest.fixture
def sample_frame(null_device: rhi.Device) -> SampleFrame:
    return SampleFrame(null_device)


@pytest.fixture
def frame(sample_frame: SampleFrame) -> rhi.CommandStream:
    sample_frame.render()
    return sample_frame.device.stream


def failure(check) -> str:
    with pytest.raises(AssertionError) as caught:
        check()
    return str(caught.value)


# -- counting ------------------------------------------------------------------------------------------------


def test_commands_are_counted(frame) -> None:
    draws = expect(frame).draws(program="Shadow")
    assert [draw.program for draw in draws.exactly(2)] == [draws.matches()[0].program] * 2
    draws.at_least(2)
    draws.at_most(2)


@pytest.mark.parametrize(
    ("verdict", "number"), [("exactly", 1), ("exactly", 3), ("at_least", 3), ("at_most", 1), ("exactly", 0)]
)
def test_a_wrong_number_fails(frame, verdict: str, number: int) -> None:
    message = failure(lambda: getattr(expect(frame).draws(program="Shadow"), verdict)(number))
    assert message.startswith(
        f"expected {verdict.replace('_', ' ')} {number}: draws of program 'Shadow'\nfound 2"
    )


def test_a_program_is_selected_by_object_id_class_or_name(frame, sample_frame) -> None:
    for program in (sample_frame.shadow, sample_frame.shadow.id, Shadow, "Shadow"):
        expect(frame).draws(program=program).exactly(2)
    for program in (sample_frame.lit, sample_frame.lit.id, "Lit"):
        expect(frame).draws(program=program).exactly(1)
    expect(frame).draws(program="shadow").exactly(0)


def test_programs_are_selected_by_name_after_the_stream_was_cleared(sample_frame) -> None:
    sample_frame.device.stream.clear()
    sample_frame.render()
    expect(sample_frame.device).draws(program="Lit").with_bindings(tint="tint").exactly(1)


def test_labels_nest_in_their_order(frame) -> None:
    draws = expect(frame).draws()
    draws.within("sun").exactly(2)
    draws.within("casters").exactly(2)
    draws.within("sun", "casters").exactly(2)
    draws.within("casters", "sun").exactly(0)
    draws.within("view").exactly(1)


def test_arguments_are_compared_with_the_requested_tolerance(frame) -> None:
    expect(frame).draws(instances=4).exactly(1)
    expect(frame).draws(instances=5).exactly(0)
    expect(frame).draws(instances=pytest.approx(5, abs=1)).exactly(1)
    expect(frame).commands(Op.BEGIN_PASS).exactly(2)
    expect(frame).commands(Op.PRESENT, Op.END_PASS).exactly(3)


def test_dispatches_are_none(frame) -> None:
    expect(frame).dispatches().exactly(0)


def test_states_are_those_at_the_command(frame) -> None:
    draws = expect(frame).draws()
    draws.with_states(CullMode.FRONT).exactly(2)
    draws.with_states(CullMode.BACK, DepthFunction.GREATER_EQUAL).exactly(1)
    draws.with_states(CullMode.NONE).exactly(0)
    draws.with_states(DepthBias(-2.1)).exactly(0)
    draws.with_states(DepthBias(-2.1), tolerance=0.2).exactly(2)
    draws.with_states(DepthBias(-2.1), tolerance=0.05).exactly(0)


def test_states_of_one_target_are_compared_with_that_target(sample_frame) -> None:
    device = sample_frame.device
    with device.render_pass(sample_frame.image), device.states(rhi.ColorWrite.OFF.at(1)):
        device.draw(sample_frame.lit, sample_frame.walls, light=sample_frame.light, tint=sample_frame.tint)
    draws = expect(device).draws()
    draws.with_states(rhi.ColorWrite.OFF.at(1)).exactly(1)
    draws.with_states(rhi.ColorWrite.OFF.at(0)).exactly(0)
    draws.with_states(rhi.ColorWrite.ON).exactly(0)


def test_bindings_are_those_at_the_command(frame, sample_frame) -> None:
    draws = expect(frame).draws(program="Lit")
    for light in (sample_frame.light, "light", sample_frame.light.buffer):
        draws.with_bindings(light=light, tint=sample_frame.tint).exactly(1)
    for light in (sample_frame.tint, "tint", sample_frame.tint.buffer):
        draws.with_bindings(light=light).exactly(0)
    expect(frame).draws().with_bindings(tint=sample_frame.tint).exactly(1)  # the others have no tint


def test_bindings_and_resources_are_those_at_the_command(sample_frame) -> None:
    device, stream = sample_frame.device, sample_frame.device.stream
    sample_frame.render()
    draw = stream.draws()[-1]
    assert draw.bindings == {
        "light": (sample_frame.light.buffer, 0, 16),
        "tint": (sample_frame.tint.buffer, 0, 16),
    }
    assert draw.resource(sample_frame.image.id).label == "image"
    sample_frame.image.destroy()
    device.finish()
    device.buffer(4)
    assert stream[-1].resource(sample_frame.image.id) is None
    assert draw.resource(sample_frame.image.id).label == "image"
    assert stream[0].bindings == {}


def test_a_predicate_has_a_name(frame) -> None:
    wide = expect(frame).draws().where("wide", lambda draw: draw.render_pass.size[0] > 32)
    wide.exactly(1)
    assert "draws wide" in failure(lambda: wide.exactly(2))


def test_draws_that_come_later_are_not_before(frame) -> None:
    shadow, lit = expect(frame).draws(program="Shadow"), expect(frame).draws(program="Lit")
    shadow.before(lit)
    message = failure(lambda: lit.before(shadow))
    assert "of program 'Lit'" in message
    assert "comes after" in message
    assert "testing_kit.py" in message
    failure(lambda: shadow.before(expect(frame).dispatches()))


# -- messages ------------------------------------------------------------------------------------------------


def test_a_failure_shows_the_matching_and_the_nearest_commands(frame) -> None:
    message = failure(lambda: expect(frame).draws(program="Shadow").within("view").exactly(1))
    nearest = message.partition("nearest:")[2].splitlines()
    assert "matching:" not in message
    assert any("its labels are sun / casters" in line for line in nearest)
    assert any("its program is Lit" in line for line in nearest)
    assert re.search(r"draw\(.*\)  .*testing_kit\.py:\d+", message)
    assert "create_buffer" not in message


def test_a_failure_with_too_many_matches_shows_them(frame) -> None:
    message = failure(lambda: expect(frame).draws(program="Shadow").exactly(1))
    assert message.partition("matching:")[2].partition("nearest:")[0].count("draw(") == 2


@pytest.mark.parametrize(
    ("narrow", "message"),
    [
        (lambda e: e.with_states(CullMode.NONE), "CullMode is CullMode.FRONT"),
        (lambda e: e.with_bindings(light="tint"), "light is 'light' (id"),
        (lambda e: e.with_bindings(sky="tint"), "the program's bindings: light"),
        (lambda e: e.draws(instances=9), "instances is 1"),
    ],
)
def test_a_failed_expectation_names_the_actual_value(frame, narrow, message: str) -> None:
    assert message in failure(lambda: narrow(expect(frame).draws(program="Shadow")).exactly(1))


def test_long_lists_are_cut(sample_frame) -> None:
    for _ in range(20):
        sample_frame.render()
    message = failure(lambda: expect(sample_frame.device).draws(program="Shadow").exactly(1))
    assert "… and 35 more" in message
    assert len(message.splitlines()) < 30


# -- budgets, frames, caching --------------------------------------------------------------------------------


def test_frames_end_with_present(sample_frame) -> None:
    sample_frame.device.stream.clear()
    sample_frame.render()
    sample_frame.render()
    sample_frame.device.signal()
    first, second = frames(sample_frame.device)
    assert first[-1].op is second[-1].op is Op.PRESENT
    expect(first).draws().exactly(3)
    expect(second).draws().exactly(3)
    expect(second).commands(Op.CREATE_VERTEX_ARRAY).exactly(0)


@pytest.mark.parametrize(
    ("name", "spent"), [("draws", 3), ("hardware_state_changes", 6), ("upload_bytes", 16), ("creations", 0)]
)
def test_a_budget_holds_at_its_limit_and_not_below(sample_frame, name: str, spent: int) -> None:
    sample_frame.render()
    sample_frame.device.stream.clear()
    with sample_frame.device.event("set-up"):
        sample_frame.light.write(Light(offset=(1, 0, 0, 0)))
    sample_frame.render()
    (frame,) = frames(sample_frame.device)
    counts = expect(frame).costs(**{f"max_{name}": spent})
    assert getattr(counts, name) == spent
    if spent:
        message = failure(lambda: expect(frame).costs(**{f"max_{name}": spent - 1}))
        assert f"{name.replace('_', ' ')}: {spent}, allowed {spent - 1}" in message
        assert ".py:" in message


def test_a_budget_may_be_a_labels(frame) -> None:
    assert expect(frame).within("sun").costs(max_draws=2, max_dispatches=0).draws == 2
    failure(lambda: expect(frame).within("sun").costs(max_draws=1))


def test_requested_and_issued_calls_are_counted_separately(sample_frame) -> None:
    device = sample_frame.device
    sample_frame.render()
    with count_work(device) as work:
        with device.render_pass(sample_frame.image):
            for _ in range(10):
                with device.states(DepthWrite.OFF, CullMode.NONE):
                    device.draw(
                        sample_frame.lit, sample_frame.walls, light=sample_frame.light, tint=sample_frame.tint
                    )
    assert work.requested == CallCounts(states=20, programs=10, bindings=20)
    assert (work.issued.programs, work.issued.bindings) == (1, 2)
    assert work.issued.states == 3  # the two, and DepthFunction, which the frame before had left
    expect(work.commands).draws().exactly(10)


def test_a_draw_that_failed_costs_nothing(sample_frame) -> None:
    stream = sample_frame.device.stream
    sample_frame.render()
    with pytest.raises(rhi.ValidationError):
        sample_frame.device.draw(
            sample_frame.lit, sample_frame.walls, light=sample_frame.light, tint=sample_frame.tint
        )  # outside a pass
    expect(stream).costs(max_draws=3)


# -- the plugin ----------------------------------------------------------------------------------------------


def test_the_plugin_gives_fixtures(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        def test_null(null_device, command_stream):
            null_device.buffer(4)
            assert len(command_stream) == 1

        def test_any(rhi_device):
            rhi_device.buffer(4)
            assert len(rhi_device.stream) >= 1
            assert rhi_device.backend_name == "null"
        """
    )
    result = pytester.runpytest("-p", "no:cacheprovider", "-v")
    result.assert_outcomes(passed=2)
    result.stdout.fnmatch_lines(["*test_any?null?*"])


def test_rhi_device_runs_on_each_backend_asked_for(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_it(rhi_device): print('on', rhi_device.backend_name)")
    function = "rhi.backends.null:create_backend"
    result = pytester.runpytest(
        "--rhi-backend", "null", "--rhi-backend", function, "-p", "no:cacheprovider", "-s"
    )
    result.assert_outcomes(passed=2)
    result.stdout.fnmatch_lines(["*on null*", "*on null*"])


def test_an_unknown_backend_stops_a_run_at_once_with_one_line(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_it(rhi_device): pass\ndef test_that(rhi_device): pass")
    result = pytester.runpytest_subprocess("--rhi-backend", "null", "--rhi-backend", "nul")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    lines = [line for line in (*result.outlines, *result.errlines) if line]
    assert len(lines) == 1, lines
    assert re.fullmatch(r"ERROR: --rhi-backend: there is no backend 'nul' .*did you mean 'null'\?", lines[0])


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_an_unknown_backend_in_the_environment_stops_only_tests_that_need_it(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RHI_BACKEND", "nul")
    pytester.makepyfile("def test_it(rhi_device): pass")
    result = pytester.runpytest_subprocess("-q")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["ERROR: RHI_BACKEND: there is no backend 'nul' *"])
    pytester.makepyfile("def test_it(null_device): pass")
    assert pytester.runpytest_subprocess("-q").ret == 0
