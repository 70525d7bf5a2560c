"""The stream of commands: looked at, filtered, printed, and what is derived from it."""

import inspect
import os
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhi.backends.null import create_backend
from rhi.commands.ops import DRAWS, WIDTHS
from rhi.commands.recorder import Recorder
from rhi.commands.stream import CommandStream, Op
from rhi.commands.text import describe, describe_call
from rhi.contract import descriptors, states
from rhi.contract.backend import Backend
from rhi.contract.states import DEFAULTS, ColorWrite, CullMode, DepthWrite, Scissor, StateChange, Viewport
from rhi.errors import ValidationError

NOT_COMMANDS = {"capabilities", "close", "completed", "read_query"}


@pytest.fixture
def recorder():
    return Recorder(create_backend())


def draw(recorder, count=3, instances=1):
    recorder.draw(1, descriptors.Primitive.TRIANGLES, 0, count, instances, 0, 0)


# -- ops -------------------------------------------------------------------------------------------------


def test_every_method_of_the_contract_is_a_command_or_listed_as_none():
    methods = {name for name in vars(Backend) if not name.startswith("_")}
    assert {op.method for op in Op} == methods - NOT_COMMANDS
    assert methods >= NOT_COMMANDS


@pytest.mark.parametrize("op", list(Op), ids=lambda op: op.method)
def test_an_ops_arguments_are_those_of_its_method(op):
    assert list(op.parameters) == list(inspect.signature(getattr(Backend, op.method)).parameters)[1:]
    assert WIDTHS[op] == len(op.parameters) + 3


def test_ops_count_from_zero_without_a_gap():
    assert [int(op) for op in Op] == list(range(len(Op)))


# -- sequence --------------------------------------------------------------------------------------------


def test_a_stream_is_a_sequence_of_commands(recorder):
    for count in range(5):
        draw(recorder, count)
    stream = recorder.stream
    assert len(stream) == 5
    assert [command["count"] for command in stream] == [0, 1, 2, 3, 4]
    assert [command.index for command in stream] == [0, 1, 2, 3, 4]
    assert stream[-1]["count"] == 4
    assert [command["count"] for command in stream[1:4:2]] == [1, 3]
    assert [command["count"] for command in stream[::-1]] == [4, 3, 2, 1, 0]
    assert [command["count"] for command in stream[1:][1:][:1]] == [2]
    with pytest.raises(IndexError):
        stream[5]


def test_a_stream_grows_and_a_slice_of_it_does_not(recorder):
    draw(recorder)
    part = recorder.stream[:]
    draw(recorder)
    assert (len(recorder.stream), len(part)) == (2, 1)


def test_an_empty_stream_is_false_and_prints_nothing():
    stream = CommandStream()
    assert not stream
    assert str(stream) == ""


def test_a_command_gives_its_arguments_by_name(recorder):
    recorder.draw(7, descriptors.Primitive.LINES, 1, 2, 3, 4, 5)
    command = recorder.stream[0]
    assert command.op is Op.DRAW
    assert command.values == (7, descriptors.Primitive.LINES, 1, 2, 3, 4, 5)
    assert command.arguments == {
        "vertex_array": 7,
        "primitive": descriptors.Primitive.LINES,
        "first": 1,
        "count": 2,
        "instances": 3,
        "base_vertex": 4,
        "base_instance": 5,
    }
    assert command["base_instance"] == 5


# -- filters ---------------------------------------------------------------------------------------------


@pytest.fixture
def labelled(recorder):
    recorder.push_label("shadows")
    recorder.push_label("sun")
    draw(recorder, 10)
    recorder.pop_label()
    draw(recorder, 20)
    recorder.pop_label()
    draw(recorder, 30, instances=2)
    recorder.dispatch(1, 2, 3)
    return recorder.stream


@pytest.mark.parametrize(
    ("conditions", "counts"),
    [
        ({"op": Op.DRAW}, [10, 20, 30]),
        ({"op": Op.DRAW, "label": "sun"}, [10]),
        ({"op": Op.DRAW, "label": "shadows"}, [10, 20]),
        ({"op": Op.DRAW, "label": "moon"}, []),
        ({"op": DRAWS, "instances": 2}, None),
        ({"op": Op.DRAW, "instances": 2}, [30]),
        ({"op": Op.DRAW, "instances": 1, "count": 20}, [20]),
        ({"op": {Op.DRAW}, "where": lambda command: command["count"] > 10}, [20, 30]),
        ({"op": Op.DRAW, "where": lambda command: "sun" not in command.labels, "label": "shadows"}, [20]),
    ],
)
def test_a_filter_selects_the_commands_that_meet_all_its_conditions(labelled, conditions, counts):
    if counts is None:  # draw_indirect has no `instances`
        with pytest.raises(ValidationError):
            labelled.filter(**conditions)
    else:
        assert [command["count"] for command in labelled.filter(**conditions)] == counts


def test_filters_can_be_chained_and_keep_indices_in_the_stream(labelled):
    draws = labelled.draws().filter(label="shadows").filter(Op.DRAW, count=20)
    assert [command.index for command in draws] == [4]
    assert draws[0]["count"] == 20


def test_draws_include_indirect_ones(recorder):
    draw(recorder)
    recorder.draw_indirect(1, descriptors.Primitive.TRIANGLES, 2, 0, 1, 20, 0, 0)
    recorder.dispatch(1, 1, 1)
    assert [command.op for command in recorder.stream.draws()] == [Op.DRAW, Op.DRAW_INDIRECT]


# -- what holds at a command -----------------------------------------------------------------------------


def test_a_command_knows_the_labels_around_it(labelled):
    assert [command.labels for command in labelled] == [
        (),
        ("shadows",),
        ("shadows", "sun"),
        ("shadows",),
        ("shadows",),
        (),
        (),
        (),
    ]


def test_a_command_knows_its_states_program_and_pass(recorder):
    draw(recorder)
    recorder.set_states([StateChange(CullMode, CullMode.NONE)])
    recorder.bind_program(9)
    recorder.begin_pass(descriptors.PassDescriptor((4, 4)))
    draw(recorder)
    recorder.end_pass()
    recorder.set_states((StateChange(CullMode, CullMode.FRONT), StateChange(DepthWrite, DepthWrite.OFF)))
    draw(recorder)
    first, second, third = recorder.stream.draws()
    assert (first.states[CullMode], first.program, first.render_pass) == (DEFAULTS[CullMode], 0, None)
    assert (third.states[CullMode], third.states[DepthWrite]) == (CullMode.FRONT, DepthWrite.OFF)
    assert third.render_pass is None
    # Earlier ones can be asked for after later ones.
    assert (second.states[CullMode], second.states[DepthWrite]) == (CullMode.NONE, DepthWrite.ON)
    assert (second.program, second.render_pass) == (9, descriptors.PassDescriptor((4, 4)))


def test_the_states_of_a_command_are_a_copy(recorder):
    draw(recorder)
    draw(recorder)
    recorder.stream[0].states[CullMode] = CullMode.FRONT
    assert recorder.stream[1].states[CullMode] is CullMode.BACK


def test_a_command_of_a_cleared_stream_keeps_its_arguments_and_refuses_derived_values(recorder):
    draw(recorder, 12)
    command = recorder.stream[0]
    assert command.labels == ()
    recorder.stream.clear()
    draw(recorder, 99)
    assert command["count"] == 12
    assert command.site is not None
    for name in ("labels", "states", "program", "render_pass"):
        with pytest.raises(ValidationError, match=r"^\[command-cleared\]"):
            getattr(command, name)


STEPS = st.lists(
    st.sampled_from(["push", "pop", "cull", "draw", "clear", "pause", "resume", "look"]), max_size=60
)


@given(STEPS, st.randoms(use_true_random=False))
@settings(max_examples=100)
def test_labels_and_states_of_commands_equal_those_of_a_model_after_clears_and_pauses(steps, random):
    recorder = Recorder(create_backend())
    labels, cull, pauses, expected = [], CullMode.BACK, [], []
    for number, step in enumerate(steps):
        if step == "push":
            labels.append(str(number))
            recorder.push_label(str(number))
        elif step == "pop" and labels:
            recorder.pop_label()
            labels.pop()
        elif step == "cull":
            cull = random.choice(list(CullMode))
            recorder.set_states([StateChange(CullMode, cull)])
        elif step == "draw":
            draw(recorder, number)
            if not pauses:
                expected.append((number, tuple(labels), cull))
        elif step == "clear":
            recorder.stream.clear()
            expected.clear()
        elif step == "pause":
            pauses.append(recorder.paused())
            pauses[-1].__enter__()
        elif step == "resume" and pauses:
            pauses.pop().__exit__(None, None, None)
        elif step == "look" and expected:
            index = random.randrange(len(expected))
            command = recorder.stream.draws()[index]
            assert (command["count"], command.labels, command.states[CullMode]) == expected[index]
    draws = recorder.stream.draws()
    assert [(d["count"], d.labels, d.states[CullMode]) for d in draws] == expected


# -- text ------------------------------------------------------------------------------------------------


def test_a_line_shows_the_call_and_where_it_came_from(recorder):
    draw(recorder, 36)
    line = sys._getframe().f_lineno - 1
    # The call itself stands in the helper above: that is the user's innermost line.
    helper = inspect.getsourcelines(draw)[1] + 1
    assert str(recorder.stream[0]) == (
        "draw(vertex_array=1, primitive=Primitive.TRIANGLES, first=0, count=36, instances=1, base_vertex=0, "
        f"base_instance=0)  {__file__}:{helper}"
    )
    assert helper < line


def test_a_printed_stream_is_indented_by_its_labels(labelled):
    lines = str(labelled).splitlines()
    assert len(lines) == 8
    assert lines[0].startswith("     0  push_label(text='shadows')")
    assert lines[1].startswith("     1    push_label(text='sun')")
    assert lines[2].startswith("     2      draw(")
    assert lines[3].startswith("     3    pop_label()")
    assert lines[6].startswith("     6  draw(")
    assert all(f"{os.path.basename(__file__)}:" in line for line in lines)


def test_a_limited_listing_ends_with_the_number_of_omitted_commands(labelled):
    lines = labelled.format(3).splitlines()
    assert len(lines) == 4
    assert lines[-1] == "… and 5 more"
    assert labelled.format(8) == labelled.format() == str(labelled)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (3, "3"),
        (descriptors.Primitive.QUADS, "Primitive.QUADS"),
        (b"abcd", "<4 bytes>"),
        ("sun", "'sun'"),
        (descriptors.Region(1, 2, 3, 4), "Region(1, 2, 3, 4)"),
        (descriptors.Region(1, 2, 3, 4, 0, 6), "Region(1, 2, 3, 4, layers=6)"),
        (
            descriptors.BufferDescriptor(16, descriptors.BufferUsage.STREAM, "ring"),
            "BufferDescriptor(16, BufferUsage.STREAM, 'ring')",
        ),
        (Viewport.TARGET, "Viewport.TARGET"),
        (Scissor.OFF, "Scissor.OFF"),
        (Viewport(0, 0, 64, 32), "Viewport(width=64, height=32)"),
        (states.BlendFunction.ALPHA, "BlendFunction.ALPHA"),
        (StateChange(CullMode, CullMode.NONE), "CullMode.NONE"),
        (StateChange(ColorWrite, (ColorWrite.OFF,) * 8), "ColorWrite.OFF"),
        ((StateChange(CullMode, CullMode.NONE), 2), "(CullMode.NONE, 2)"),
        ((descriptors.WHOLE,), "(-1,)"),
        (
            descriptors.PassDescriptor((8, 4), (descriptors.Attachment(3, clear=(0.0, 0.0, 0.0, 1.0)),)),
            "PassDescriptor((8, 4), (Attachment(3, clear=(0.0, 0.0, 0.0, 1.0)),))",
        ),
    ],
)
def test_arguments_of_commands_are_printed_as_python_expressions(value, text):
    assert describe(value) == text


def test_states_that_differ_by_target_are_shown_by_target():
    row = (ColorWrite.OFF,) + (ColorWrite.ON,) * 7
    assert describe(StateChange(ColorWrite, row)).startswith(
        "ColorWrite per target (ColorWrite.OFF, ColorWrite.ON,"
    )


def test_a_program_is_shown_by_its_name():
    program = descriptors.ProgramDescriptor(
        "Lit",
        frozenset({descriptors.Stage.VERTEX}),
        (),
        (),
        (),
        (1, 1, 1),
        lambda *_: descriptors.StageText(""),
    )
    assert describe_call("create_program", {"program": 1, "descriptor": program}) == (
        "create_program(program=1, descriptor=ProgramDescriptor('Lit'))"
    )
