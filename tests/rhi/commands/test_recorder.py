"""The recorder: true to what was called, from where, and in little memory."""

import gc
import sys
import traceback
from typing import ClassVar

import numpy as np
import pytest

from rhi.backends.null import create_backend
from rhi.commands.ops import WIDTHS
from rhi.commands.recorder import CommandMethods, Recorder
from rhi.commands.stream import Op
from rhi.contract import descriptors
from rhi.contract.formats import Format
from rhi.contract.states import CullMode, StateChange
from rhi.errors import DeviceError
from rhi.errors.call_sites import MARK
from rhi.errors.rules import DEVICE_MEMORY


class Listener(CommandMethods):
    """A backend that notes each call and gives a different answer to each."""

    METHOD = "    self.calls.append(('{method}', ({arguments})))\n    return len(self.calls) + 100"

    def __init__(self):
        self.calls = []
        self.capabilities = create_backend().capabilities

    def completed(self):
        return 5

    def read_query(self, query):
        return query + 1

    def close(self):
        self.calls.append(("close", ()))


class Silent(Listener):
    """A backend that does nothing."""

    METHOD = "    pass"


class Broken(Listener):
    METHOD = "    raise self.error"

    def __init__(self, error):
        super().__init__()
        self.error = error


PROGRAM = descriptors.ProgramDescriptor(
    "P", frozenset({descriptors.Stage.VERTEX}), (), (), (), (1, 1, 1), lambda *_: descriptors.StageText("")
)
CALLS = {
    Op.CREATE_BUFFER: (1, descriptors.BufferDescriptor(4)),
    Op.CREATE_TEXTURE: (2, descriptors.TextureDescriptor((1, 1), Format.R8)),
    Op.CREATE_SAMPLER: (3, descriptors.SamplerDescriptor()),
    Op.CREATE_PROGRAM: (4, PROGRAM),
    Op.CREATE_VERTEX_ARRAY: (5, descriptors.VertexArrayDescriptor(4, ())),
    Op.CREATE_QUERY: (6, descriptors.QueryKind.TIMESTAMP),
    Op.WRITE_BUFFER: (1, 0, b"abcd"),
    Op.WRITE_TEXTURE: (2, 0, descriptors.Region(0, 0, 1, 1), b"x"),
    Op.BEGIN_PASS: (descriptors.PassDescriptor((1, 1)),),
    Op.SET_STATES: ((StateChange(CullMode, CullMode.NONE),),),
    Op.PUSH_LABEL: ("sun",),
    Op.DRAW: (5, descriptors.Primitive.TRIANGLES, 0, 3, 1, 0, 0),
}


@pytest.mark.parametrize("op", list(Op), ids=lambda op: op.method)
def test_every_command_is_written_down_passed_on_and_answered(op):
    arguments = CALLS.get(op, tuple(range(1, 1 + len(op.parameters))))
    inner = Listener()
    recorder = Recorder(inner)
    answer = getattr(recorder, op.method)(*arguments)
    line = sys._getframe().f_lineno - 1
    assert inner.calls == [(op.method, arguments)]
    assert answer == 101
    (command,) = recorder.stream
    assert (command.op, command.values) == (op, arguments)
    assert (command.site.file, command.site.line) == (__file__, line)


def test_calls_that_never_wait_are_passed_on_unrecorded():
    recorder = Recorder(Listener())
    assert recorder.completed() == 5
    assert recorder.read_query(3) == 4
    assert recorder.capabilities is recorder.backend.capabilities
    recorder.close()
    assert recorder.backend.calls == [("close", ())]
    assert len(recorder.stream) == 0


def test_arguments_passed_by_name_are_recorded():
    recorder = Recorder(Listener())
    recorder.copy_buffer(source=1, source_offset=2, target=3, target_offset=4, size=5)
    assert recorder.stream[0].values == (1, 2, 3, 4, 5)


def test_written_memory_is_as_it_was_when_written():
    inner = Listener()
    recorder = Recorder(inner)
    data = np.arange(4, dtype=np.uint16)
    recorder.write_buffer(1, 0, data)
    recorder.write_texture(2, 0, descriptors.Region(0, 0, 4, 1), memoryview(data)[::2])
    data[:] = 9
    written, texels = (command["data"] for command in recorder.stream)
    assert written == np.arange(4, dtype=np.uint16).tobytes()
    assert texels == np.array([0, 2], np.uint16).tobytes()
    assert inner.calls[0][1][2] is written  # one copy serves both


def test_a_list_of_states_may_be_used_again_by_the_caller():
    recorder = Recorder(Listener())
    changes = [StateChange(CullMode, CullMode.NONE)]
    recorder.set_states(changes)
    changes.clear()
    assert recorder.stream[0]["changes"] == (StateChange(CullMode, CullMode.NONE),)


# -- call sites ------------------------------------------------------------------------------------------


def test_the_site_is_the_users_innermost_line_outside_the_package():
    recorder = Recorder(Listener())
    scope = {MARK: True}
    exec("def outer(r): inner(r)\ndef inner(r): r.signal(1)\n", scope)
    scope["outer"](recorder)
    assert recorder.stream[0].site.line == sys._getframe().f_lineno - 1
    assert recorder.stream[0].site.function == sys._getframe().f_code.co_qualname


def test_call_sites_distinguish_calls_in_a_loop_and_calls_of_several_lines():
    recorder = Recorder(Listener())
    first = sys._getframe().f_lineno + 1
    recorder.signal(1)
    recorder.copy_buffer(
        1,
        0,
        2,
        0,
        4,
    )
    for value in range(2):
        recorder.signal(value)
    lines = [command.site.line for command in recorder.stream]
    assert lines == [first, first + 1, first + 9, first + 9]


def test_a_call_from_no_user_code_has_no_site():
    recorder = Recorder(Listener())
    # Make every frame above look internal, as where the package itself is the program.
    frame, marked = sys._getframe(), []
    while frame is not None:
        if MARK not in frame.f_globals:
            marked.append(frame.f_globals)
            frame.f_globals[MARK] = True
        frame = frame.f_back
    try:
        recorder.signal(1)
    finally:
        for scope in marked:
            del scope[MARK]
    assert recorder.stream[0].site is None
    assert str(recorder.stream[0]) == "signal(value=1)"


# -- failures --------------------------------------------------------------------------------------------


def test_a_call_that_fails_stays_in_the_stream_with_its_error():
    recorder = Recorder(Broken(DeviceError(DEVICE_MEMORY, "create_buffer")))
    with pytest.raises(DeviceError):
        recorder.create_buffer(1, descriptors.BufferDescriptor(1 << 60))
    (command,) = recorder.stream
    assert command.failure.error == "device-out-of-memory"
    assert command.failure.message.startswith("[device-out-of-memory]")
    assert str(command).endswith("FAILED [device-out-of-memory]")


def test_an_error_without_a_rule_is_recorded_with_its_type():
    recorder = Recorder(Broken(KeyboardInterrupt()))
    with pytest.raises(KeyboardInterrupt):
        recorder.signal(1)
    assert recorder.stream[0].failure.error == "KeyboardInterrupt"


def test_only_the_call_that_failed_is_marked():
    recorder = Recorder(Listener())
    recorder.signal(1)
    good, recorder.backend = recorder.backend, Broken(ValueError("no"))
    with pytest.raises(ValueError, match="no"):
        recorder.signal(2)
    recorder.backend = good
    recorder.signal(3)
    assert [command.failure is not None for command in recorder.stream] == [False, True, False]
    recorder.stream.clear()
    for value in range(3):
        recorder.signal(value)
    assert not any(command.failure for command in recorder.stream)


def test_states_that_failed_to_be_set_do_not_hold():
    recorder = Recorder(Broken(ValueError("no")))
    with pytest.raises(ValueError, match="no"):
        recorder.set_states([StateChange(CullMode, CullMode.NONE)])
    recorder.backend = Listener()
    recorder.signal(1)
    assert recorder.stream[1].states[CullMode] is CullMode.BACK


def test_a_traceback_through_a_generated_method_shows_its_source():
    recorder = Recorder(Broken(ValueError("no")))
    with pytest.raises(ValueError, match="no") as caught:
        recorder.signal(1)
    text = "".join(traceback.format_tb(caught.value.__traceback__))
    assert "return self.backend.signal(value, )" in text


# -- pausing ---------------------------------------------------------------------------------------------


def test_a_paused_recorder_passes_on_and_writes_nothing():
    recorder = Recorder(Listener())
    recorder.signal(1)
    with recorder.paused():
        assert recorder.signal(2) == 102
        with recorder.paused():
            recorder.signal(3)
        recorder.signal(4)
    recorder.signal(5)
    assert [command["value"] for command in recorder.stream] == [1, 5]
    assert len(recorder.backend.calls) == 5


def test_a_failure_while_paused_marks_nothing():
    recorder = Recorder(Listener())
    recorder.signal(1)
    recorder.backend = Broken(ValueError("no"))
    with pytest.raises(ValueError, match="no"), recorder.paused():
        recorder.signal(2)
    assert recorder.stream[0].failure is None
    recorder.backend = Listener()
    recorder.signal(3)
    assert len(recorder.stream) == 2


# -- two backends ----------------------------------------------------------------------------------------


def test_a_recorder_is_itself_a_backend_that_can_be_recorded():
    inner = Recorder(create_backend())
    outer = Recorder(inner)
    outer.create_buffer(1, descriptors.BufferDescriptor(8, descriptors.BufferUsage.STATIC))
    outer.write_buffer(1, 0, b"12345678")
    assert outer.read_buffer(1, 2, 3) == b"345"
    assert [c.op for c in outer.stream] == [c.op for c in inner.stream]
    assert inner.stream[1].site == outer.stream[1].site


# -- memory ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("op", list(Op), ids=lambda op: op.method)
def test_a_command_takes_at_most_160_bytes_beyond_its_arguments(op):
    arguments = CALLS.get(op, tuple(range(1, 1 + len(op.parameters))))
    recorder = Recorder(Silent())
    call, times = getattr(recorder, op.method), 2000
    for _ in range(times):
        call(*arguments)
    data, width = recorder.stream.data, WIDTHS[op]
    # Arguments are the caller's own objects; what is the recorder's are the list and the instruction offsets.
    offsets = sum(sys.getsizeof(offset) for offset in data[width - 1 :: width])
    assert len(data) == times * width
    assert (sys.getsizeof(data) + offsets) / times <= 160


def test_recording_makes_no_objects_that_the_garbage_collector_must_visit():
    recorder = Recorder(Silent())
    gc.collect()
    before = len(gc.get_objects())
    for index in range(1000):
        recorder.draw(1, descriptors.Primitive.TRIANGLES, 0, index, 1, 0, 0)
    assert len(gc.get_objects()) - before < 20


class Counting(Listener):
    """A backend whose methods use a global name of their own."""

    METHOD = "    self.calls.append(count_of({arguments}))"
    GLOBALS: ClassVar = {"count_of": lambda *arguments: len(arguments)}


class Inheriting(Counting):
    pass


@pytest.mark.parametrize("kind", [Counting, Inheriting])
def test_generated_methods_see_the_names_that_their_class_declares_and_no_others(kind):
    backend = kind()
    backend.dispatch(1, 2, 3)
    assert backend.calls == [3]
    assert set(kind.dispatch.__globals__) == {"__name__", "__builtins__", "count_of"}
    assert kind.dispatch.__module__ == __name__


def test_repeated_commands_are_written_down_and_passed_on_each_time():
    inner = Listener()
    recorder = Recorder(inner)
    commands = [
        recorder.prepare(Op.PUSH_LABEL, ("a",), None, -1),
        recorder.prepare(Op.POP_LABEL, (), None, -1),
    ]
    recorder.repeat(commands)
    recorder.repeat(commands)
    assert [command.op for command in recorder.stream] == [Op.PUSH_LABEL, Op.POP_LABEL] * 2
    assert [name for name, _ in inner.calls] == ["push_label", "pop_label"] * 2


def test_a_repeated_command_without_an_entry_is_only_called():
    inner = Listener()
    recorder = Recorder(inner)
    recorder.repeat([(None, inner.push_label, ("a",))])
    assert len(recorder.stream) == 0
    assert inner.calls == [("push_label", ("a",))]


def test_a_repeated_command_that_fails_is_marked_and_leaves_those_after_it():
    recorder = Recorder(Broken(DeviceError(DEVICE_MEMORY, "push_label", "")))
    commands = iter([recorder.prepare(Op.PUSH_LABEL, (label,), None, -1) for label in "abc"])
    with pytest.raises(DeviceError):
        recorder.repeat(commands)
    assert [command.failure.error for command in recorder.stream] == [DEVICE_MEMORY.id]
    assert len(list(commands)) == 2


def test_the_null_backend_queues_a_repeated_command_as_its_method_does():
    by_method, repeated = create_backend(), create_backend()
    by_method.push_label("a")
    call, arguments = repeated.resolve_command(Op.PUSH_LABEL, ("a",))
    call(*arguments)
    assert repeated._queue == by_method._queue


def test_a_command_that_the_null_backend_does_itself_is_not_queued():
    backend = create_backend()
    backend.create_buffer(1, descriptors.BufferDescriptor(4, descriptors.BufferUsage.STREAM))
    call, arguments = backend.resolve_command(Op.WRITE_BUFFER, (1, 0, b"abcd"))
    call(*arguments)
    assert backend._queue == []
    assert backend.read_buffer(1, 0, 4) == b"abcd"
