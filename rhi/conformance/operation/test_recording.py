"""The command stream: every call with its arguments, its labels and its call site."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from rhi import CullMode, Device, Format, IndirectDraws, Op, Primitive
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle


def line() -> int:
    """Return the line number of the caller."""
    return sys._getframe(1).f_lineno


@pytest.mark.requires("draws")
def test_a_draw_is_one_command_with_its_arguments(recording: Device) -> None:
    since = len(recording.stream)
    with recording.texture((4, 4), Format.RGBA8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image):
            recording.draw(recording.program(Colored), mesh.view(3, 3), 7)
    (draw,) = recording.stream[since:].filter(Op.DRAW)
    assert (draw["first"], draw["count"], draw["instances"]) == (3, 3, 7)


@pytest.mark.requires("draws")
def test_a_command_knows_the_line_of_the_user(recording: Device) -> None:
    with recording.texture((4, 4), Format.RGBA8) as image, recording.mesh(rectangle()) as mesh:
        program = recording.program(Colored)
        with recording.render_pass(image):
            expected = line() + 1
            recording.draw(program, mesh)
    draw = recording.stream.filter(Op.DRAW)[-1]
    assert draw.site is not None
    assert (draw.site.file, draw.site.line) == (__file__, expected)


@pytest.mark.requires("draws")
def test_commands_keep_their_order(recording: Device) -> None:
    since = len(recording.stream)
    with recording.texture((4, 4), Format.RGBA8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image), recording.states(CullMode.NONE):
            recording.draw(recording.program(Colored), mesh)
        image.read()
    order = [
        command.op
        for command in recording.stream[since:]
        if command.op in (Op.BEGIN_PASS, Op.SET_STATES, Op.DRAW, Op.END_PASS, Op.READ_TEXTURE)
    ]
    assert order == [Op.BEGIN_PASS, Op.SET_STATES, Op.DRAW, Op.END_PASS, Op.READ_TEXTURE]


def test_written_bytes_are_kept_as_they_were(recording: Device) -> None:
    data = np.arange(4, dtype="u4")
    with recording.buffer(4, np.dtype("u4")) as buffer:
        buffer.write(data)
        data[:] = 9
    write = recording.stream.filter(Op.WRITE_BUFFER)[-1]
    assert bytes(write["data"]) == np.arange(4, dtype="u4").tobytes()


def test_labels_enclose_their_commands(recording: Device) -> None:
    since = len(recording.stream)
    with recording.event("outer"), recording.event("inner"), recording.buffer(4) as buffer:
        buffer.clear(1)
    (clear,) = recording.stream[since:].filter(Op.CLEAR_BUFFER)
    assert clear.labels == ("outer", "inner")
    assert list(recording.stream[since:].filter(Op.CLEAR_BUFFER, label="outer"))
    assert not list(recording.stream[since:].filter(Op.CLEAR_BUFFER, label="other"))


def test_a_stream_prints(recording: Device) -> None:
    since = len(recording.stream)
    with recording.buffer(np.arange(4, dtype="u4"), label="numbers"):
        pass
    text = str(recording.stream[since:])
    assert "create_buffer" in text
    assert "test_recording.py" in text


@pytest.mark.requires("draws")
def test_a_redundant_bind_is_not_sent_again(recording: Device) -> None:
    with recording.texture((4, 4), Format.RGBA8) as image, recording.mesh(rectangle()) as mesh:
        program = recording.program(Colored)
        with recording.render_pass(image):
            recording.draw(program, mesh)
            since = len(recording.stream)
            recording.draw(program, mesh)
    after = [command.op for command in recording.stream[since:]]
    assert after[0] is Op.DRAW


@pytest.mark.requires("draws")
def test_each_call_that_draws_counts_as_one_draw(device: Device) -> None:
    with (
        device.texture((4, 4), Format.R8) as image,
        device.mesh(rectangle()) as mesh,
        device.buffer(mesh.draws([0, 3], 3)) as arguments,
        device.render_pass(image),
    ):
        program = device.program(Colored)
        before = device.statistics
        device.draw(program, mesh)
        program.draw(mesh, 5)
        device.draw_many(program, mesh, mesh.draws([0, 3], 3))
        device.draw_indirect(program, mesh, IndirectDraws(arguments, 2))
        with device.immediate(program, Primitive.TRIANGLES) as triangles:
            triangles.vertices(rectangle())
        after = device.statistics
        assert after.draws - before.draws == 5
        device.reset_statistics()
        assert device.statistics.draws == 0
