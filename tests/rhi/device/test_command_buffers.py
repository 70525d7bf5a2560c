"""Command buffers beyond the conformance kit: faults, traces, threads, and random programs."""

from __future__ import annotations

import gc
import weakref
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testing_kit import Corner, Light, SampleFrame

import rhi
from rhi.backends.null import Faults, NullBackend, SimulatedBackend, Simulation, create_backend
from rhi.commands.recorder import CommandMethods
from rhi.errors.rules import DEVICE_DRIVER
from rhi.testing import count_work, expect
from rhi.trace import load, replay, save

# -- random programs ---------------------------------------------------------------------------------------

STATES = (
    rhi.CullMode.NONE,
    rhi.CullMode.FRONT,
    rhi.DepthBias(-2.0),
    rhi.ColorWrite(red=False),
    rhi.BlendFunction.ADDITIVE,
    rhi.BlendFunction.ALPHA.at(1),
    rhi.DepthFunction.ALWAYS,
)
DRAW = st.tuples(
    st.lists(st.sampled_from(STATES), unique_by=type, max_size=3),
    st.booleans(),
    st.integers(0, 2),
    st.integers(0, 3),
)
PASS = st.tuples(st.booleans(), st.booleans(), st.text("ab", max_size=2), st.lists(DRAW, max_size=6))


def give(encoder: rhi.Encoder, sample_frame: SampleFrame, passes: list[Any]) -> None:
    """A random frame."""
    for clears, shadow, label, draws in passes:
        target = (
            {"depth": sample_frame.map}
            if shadow
            else {"color": sample_frame.image, "depth": sample_frame.depth}
        )
        with encoder.event(label), encoder.render_pass(**target, clear_depth=0 if clears else None):
            for states, roof, first, instances in draws:
                mesh = (sample_frame.roof if roof else sample_frame.walls).view(first)
                with encoder.states(*states, rhi.FrontFace.CLOCKWISE):
                    if shadow:
                        encoder.draw(sample_frame.shadow, mesh, instances, light=sample_frame.light)
                    else:
                        encoder.draw(
                            sample_frame.lit,
                            mesh,
                            instances,
                            light=sample_frame.light,
                            tint=sample_frame.tint,
                        )


@settings(max_examples=60)
@given(passes=st.lists(PASS, max_size=4))
def test_a_submitted_frame_sends_the_commands_of_an_immediate_one(passes: list[Any]) -> None:
    with rhi.create_device("null") as device:
        sample_frame = SampleFrame(device)
        give(device, sample_frame, passes)
        with device.record() as plain, plain.render_pass(depth=sample_frame.map):
            plain.draw(sample_frame.shadow, sample_frame.walls, light=sample_frame.light)
        streams = []
        for later in (False, True):
            device.submit(plain)  # default states
            since = len(device.stream)
            if later:
                with device.record() as commands:
                    give(commands, sample_frame, passes)
                device.submit(commands)
            else:
                give(device, sample_frame, passes)
            streams.append([(command.op, command.values) for command in device.stream[since:]])
        assert streams[0] == streams[1]


# -- faults ------------------------------------------------------------------------------------------------


def shadow_pass(encoder: rhi.Encoder, sample_frame: SampleFrame) -> None:
    with (
        encoder.event("sun"),
        encoder.render_pass(depth=sample_frame.map, clear_depth=0),
        encoder.states(rhi.CullMode.FRONT),
    ):
        encoder.draw(
            sample_frame.shadow,
            sample_frame.walls,
            light=encoder.transient.uniform(Light(offset=(1, 2, 3, 4))),
        )
        with encoder.immediate(
            sample_frame.shadow, rhi.Primitive.TRIANGLES, light=sample_frame.light
        ) as triangles:
            triangles.vertices(np.zeros(3, Corner.dtype))


def count_commands() -> tuple[int, int]:
    """At which command of a clean run a submission begins and ends."""
    with rhi.create_device("null") as device:
        sample_frame = SampleFrame(device)
        with device.record() as commands:
            shadow_pass(commands, sample_frame)
        before = len(device.stream)
        device.submit(commands)
        return before, len(device.stream)


@pytest.mark.parametrize("command", range(*count_commands()))
def test_a_device_lost_in_a_submission_leaves_nothing_open(command: int) -> None:
    device = rhi.create_device("null", faults=Faults(loss=command))
    sample_frame = SampleFrame(device)
    with device.record() as commands:
        shadow_pass(commands, sample_frame)
    with pytest.raises(rhi.DeviceError, match=r"^\[device-lost\]"):
        device.submit(commands)
    assert device._core.render_pass is None
    assert device._core.states.depth == 0
    device.close()


class Flaky(CommandMethods):
    """A backend whose n-th call of some method fails once."""

    METHOD = """\
    self.countdown -= self.fails == '{method}'
    if self.fails == '{method}' and self.countdown < 0:
        self.fails = ''
        raise self.error('{method}')
    return self.backend.{method}({arguments})
"""

    @staticmethod
    def error(method: str) -> rhi.DeviceError:
        return rhi.DeviceError(DEVICE_DRIVER, method)

    def __init__(self) -> None:
        self.backend = create_backend()
        self.fails = ""
        self.countdown = 0

    @property
    def capabilities(self) -> Any:
        return self.backend.capabilities

    def completed(self) -> int:
        return self.backend.completed()

    def read_query(self, query: int) -> int | None:
        return self.backend.read_query(query)

    def close(self) -> None:
        self.backend.close()


@pytest.mark.parametrize("recorded", [False, True], ids=["direct", "recorded"])
@pytest.mark.parametrize(
    ("method", "after"),
    [
        ("create_buffer", 0),
        ("create_vertex_array", 0),
        ("create_vertex_array", 1),
        ("write_buffer", 0),
        ("bind_uniform", 0),
        ("draw", 0),
        ("draw", 1),
        ("end_pass", 0),
        ("set_states", 0),
    ],
)
def test_after_a_call_that_failed_the_device_and_the_buffer_go_on(
    method: str, after: int, recorded: bool
) -> None:
    flaky = Flaky()
    with rhi.Device(rhi.Recorder(flaky) if recorded else flaky) as device:
        sample_frame = SampleFrame(device)
        null = device.backend_as(NullBackend)
        with device.record() as commands:
            shadow_pass(commands, sample_frame)
        flaky.fails, flaky.countdown = method, after
        with pytest.raises(rhi.DeviceError):
            device.submit(commands)
        draws = null.statistics.draws
        device.submit(commands)
        sample_frame.render()
        device.submit(commands)
        assert null.statistics.draws == draws + 2 + 3 + 2
        arena = commands._arena
        assert bytes(null._buffers.memory[arena.buffer]) == bytes(arena.data)
        state = null._state
        assert state.labels == ()
        assert state.render_pass is None
        values = dict(zip(rhi.contract.states.STATE_TYPES, device._core.states.hardware.values, strict=True))
        assert state.states == values  # the device knows what the hardware has


# -- instruments -------------------------------------------------------------------------------------------


def test_a_submission_is_part_of_a_trace(tmp_path: Any) -> None:
    with rhi.create_device("null") as device:
        sample_frame = SampleFrame(device)
        with device.record(label="shadows") as commands:
            shadow_pass(commands, sample_frame)
        for _ in range(2):
            device.submit(commands)
        device.present(sample_frame.image)
        save(device, tmp_path / "trace.zip")
    trace = load(tmp_path / "trace.zip")
    expect(trace.stream).draws().within("shadows", "sun").exactly(4)
    with rhi.create_device("null") as device:
        replay(trace, on=device)
        assert device.backend_as(NullBackend).statistics.draws == 4


def test_count_work_sees_the_work_of_a_submission(null_device: rhi.Device) -> None:
    sample_frame = SampleFrame(null_device)
    with null_device.record() as commands, commands.render_pass(depth=sample_frame.map):
        for _ in range(5):
            with commands.states(rhi.CullMode.NONE, rhi.DepthBias(-1.0)):
                commands.draw(sample_frame.shadow, sample_frame.walls, light=sample_frame.light)
    with count_work(null_device) as work:
        null_device.submit(commands)
    assert (work.requested.states, work.issued.states) == (10, 2)
    assert (work.requested.bindings, work.issued.bindings) == (5, 1)


def test_a_simulated_gpu_takes_submissions_without_a_hazard() -> None:
    with rhi.create_device("null", simulation=Simulation()) as device:
        sample_frame = SampleFrame(device)
        with device.record() as commands:
            shadow_pass(commands, sample_frame)
        for _ in range(5):
            device.submit(commands)
            device.present(sample_frame.image)
        device.finish()
        assert not device.backend_as(SimulatedBackend).hazards


def test_recorded_commands_can_be_asserted_on_before_submission(null_device: rhi.Device) -> None:
    sample_frame = SampleFrame(null_device)
    with null_device.record(label="sun") as commands:
        shadow_pass(commands, sample_frame)
    assert len(commands) == len(commands.stream) > 5
    expect(commands.stream).draws(program="Shadow").within("sun").with_states(rhi.CullMode.FRONT).exactly(2)
    assert "sun" in repr(null_device.record(label="sun"))


# -- life --------------------------------------------------------------------------------------------------


def test_a_buffer_keeps_no_mesh_and_meshes_keep_no_buffer(null_device: rhi.Device) -> None:
    sample_frame = SampleFrame(null_device)
    with null_device.record() as commands, commands.render_pass(depth=sample_frame.map):
        view = sample_frame.walls.view(0, 3)
        commands.draw(sample_frame.shadow, view, light=sample_frame.light)
    view_reference, commands_reference = weakref.ref(view), weakref.ref(commands)
    del view
    gc.collect()
    assert view_reference() is None
    null_device.submit(commands)
    del commands
    gc.collect()
    assert commands_reference() is None


def test_a_buffer_that_was_never_submitted_leaves_nothing_behind(null_device: rhi.Device) -> None:
    sample_frame = SampleFrame(null_device)
    before = len(null_device.stream)
    with null_device.record() as commands:
        shadow_pass(commands, sample_frame)
    del commands
    gc.collect()
    null_device.finish()
    assert not null_device.stream[before:].filter(
        [rhi.Op.CREATE_BUFFER, rhi.Op.CREATE_VERTEX_ARRAY, rhi.Op.DESTROY]
    )


def test_two_buffers_made_before_the_first_submission_serve_one_mesh(null_device: rhi.Device) -> None:
    sample_frame = SampleFrame(null_device)

    def draw(encoder: rhi.Encoder) -> None:
        with encoder.render_pass(depth=sample_frame.map):
            encoder.draw(sample_frame.shadow, sample_frame.walls, light=sample_frame.light)

    buffers = []
    for _ in range(2):
        with null_device.record() as commands:
            draw(commands)
        buffers.append(commands)
    before = len(null_device.stream)
    null_device.submit(*buffers, *buffers)
    draw(null_device)
    creations = null_device.stream[before:].filter(rhi.Op.CREATE_VERTEX_ARRAY)
    assert len(creations) == 2  # one for each, made before they knew of each other
    sample_frame.walls.destroy()
    null_device.finish()
    gone = {command.values[0] for command in null_device.stream.filter(rhi.Op.DESTROY)}
    assert {command.values[0] for command in creations} <= gone
