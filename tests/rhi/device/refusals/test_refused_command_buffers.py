"""Rules of command buffers."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from typing import Any

import pytest

import rhi
from rhi import Access, CommandBuffer, CullMode, Device, Encoder, Format, Mesh, Primitive, Texture
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored, Tint, Tinted
from rhi.conformance.shapes import corners, rectangle
from rhi.conformance.validation.refusal import loose, refuses
from rhi.errors import rules
from rhi.shading import Shader, vec4

SIZE = (4, 4)
TRIANGLE = corners([(-1, -1), (1, -1), (0, 1)])


def clear(encoder: Encoder, image: Texture) -> None:
    """A pass that clears to white."""
    with encoder.render_pass(image, clear=(1, 1, 1, 1)):
        pass


def record(device: Device, image: Texture) -> CommandBuffer:
    """A command buffer that clears."""
    with device.record() as commands:
        clear(commands, image)
    return commands


def line() -> int:
    """The caller's line."""
    return sys._getframe(1).f_lineno


# -- one after the other: recording, submitting ------------------------------------------------------------


def test_commands_outside_of_their_block_are_refused(recording: Device) -> None:
    with recording.texture(SIZE, Format.R8) as image, recording.buffer(4) as buffer:
        commands = recording.record()
        for _ in range(2):
            with refuses(rules.RECORD_STATE, recording):
                commands.render_pass(image)
            with refuses(rules.RECORD_STATE, recording):
                commands.clear(buffer)
            with commands if len(commands) == 0 else refuses(rules.RECORD_STATE, recording):
                clear(commands, image)
        recording.submit(commands)


def test_draws_outside_of_their_block_are_refused(recording: Device, image: rhi.Texture, mesh: Mesh) -> None:
    program = recording.program(Colored)
    with recording.record() as commands:
        with commands.render_pass(image):
            commands.draw(program, mesh)
    with refuses(rules.RECORD_STATE, recording):
        commands.draw(program, mesh)


def test_a_buffer_is_submitted_once_it_is_recorded(recording: Device, image: rhi.Texture) -> None:
    commands = recording.record()
    with refuses(rules.RECORD_STATE, recording):
        recording.submit(commands)
    with commands:
        clear(commands, image)
        with refuses(rules.RECORD_STATE, recording):
            recording.submit(commands)
    recording.submit(commands)
    assert_same(image.read(), 255)


def test_a_buffer_is_recorded_once(recording: Device, image: rhi.Texture) -> None:
    commands = record(recording, image)
    with refuses(rules.RECORD_STATE, recording), commands:
        pass
    recording.submit(commands)


def test_only_command_buffers_are_submitted(recording: Device) -> None:
    with refuses(rules.DEVICE_ARGUMENT, recording):
        loose(recording).submit(3)
    recording.submit()


def test_a_buffer_is_submitted_to_its_own_device(recording: Device, backend: str) -> None:
    with rhi.create_device(backend, record=True) as other, other.texture(SIZE, Format.R8) as image:
        commands = record(other, image)
        with refuses(rules.RESOURCE_FOREIGN, recording):
            recording.submit(commands)
        other.submit(commands)


def test_a_closed_device_records_nothing(backend: str) -> None:
    device = rhi.create_device(backend)
    commands = record(device, device.texture(SIZE, Format.R8))
    device.close()
    with refuses(rules.DEVICE_CLOSED):
        device.record()
    with refuses(rules.DEVICE_CLOSED):
        device.submit(commands)


# -- both ends ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["pass", "states", "event", "condition"])
def test_a_buffer_ends_with_nothing_open(recording: Device, kind: str, image: rhi.Texture) -> None:
    if kind == "condition":
        query = recording.occlusion_query()
        with recording.render_pass(image), query:
            pass

    def open_one(commands: CommandBuffer) -> AbstractContextManager[None]:
        if kind == "pass":
            return commands.render_pass(image)
        if kind == "condition":
            return commands.conditional(query)
        return commands.states(CullMode.NONE) if kind == "states" else commands.event("sun")

    with refuses(rules.RECORD_OPEN, recording) as refusal, recording.record() as commands:
        open_one(commands).__enter__()
    assert kind in str(refusal.error)
    with refuses(rules.RECORD_STATE, recording):
        recording.submit(commands)
    with recording.record() as commands, open_one(commands):
        pass
    recording.submit(commands)


def test_a_query_ends_in_its_pass(recording: Device) -> None:
    query = recording.occlusion_query()
    with recording.texture(SIZE, Format.R8) as image:
        with refuses(rules.QUERY_STATE, recording), recording.record() as commands:
            with commands.render_pass(image):
                commands.query(query).__enter__()
        with recording.record() as commands, commands.render_pass(image), commands.query(query):
            pass
        recording.submit(commands)
        assert query.wait() == 0
    query.destroy()


# -- what it uses must be there ----------------------------------------------------------------------------


def test_a_submission_after_a_used_texture_was_destroyed_is_refused(recording: Device) -> None:
    image = recording.texture(SIZE, Format.R8, label="map")
    with recording.record() as commands:
        used = line() + 1
        with commands.render_pass(image, clear=(1, 1, 1, 1)):
            pass
    recording.submit(commands)
    destroyed = line() + 1
    image.destroy()
    with refuses(rules.RESOURCE_DESTROYED, recording) as refusal:
        recording.submit(commands)
    for expected in ("'map'", f"{__file__}:{used}", f"{__file__}:{destroyed}"):
        assert expected in refusal.error.given


def test_a_first_submission_after_a_used_buffer_was_destroyed_is_refused(recording: Device) -> None:
    with recording.buffer(4) as buffer, recording.record() as commands:
        commands.clear(buffer)
    with refuses(rules.RESOURCE_DESTROYED, recording):
        recording.submit(commands)
    with recording.buffer(4) as other, recording.record() as commands:
        with refuses(rules.RESOURCE_DESTROYED, recording):
            commands.clear(buffer)
        commands.clear(other)


@pytest.mark.parametrize("gone", ["mesh", "program", "tint"])
def test_a_submission_after_a_resource_of_a_draw_was_destroyed_is_refused(
    recording: Device, gone: str
) -> None:
    with recording.texture(SIZE, Format.RGBA8) as image:
        parts: dict[str, Any] = {
            "mesh": recording.mesh(rectangle(), label="house"),
            "program": recording.program(Tinted),
            "tint": recording.uniform(Tint(color=(1, 1, 1, 1))),
        }
        with recording.record() as commands, commands.render_pass(image):
            loose(commands).draw(parts["program"], parts["mesh"], tint=parts["tint"])
        recording.submit(commands)
        parts.pop(gone).destroy()
        with refuses(rules.RESOURCE_DESTROYED, recording):
            recording.submit(commands)
        for part in parts.values():
            part.destroy()


def test_a_mesh_s_own_part_lives_though_its_buffers_do(recording: Device) -> None:
    vertices = recording.buffer(rectangle())
    with recording.texture(SIZE, Format.R8) as image:
        mesh, program = recording.mesh(vertices), recording.program(Colored)
        with recording.record() as commands, commands.render_pass(image):
            commands.draw(program, mesh)
        recording.submit(commands)
        mesh.destroy()
        with refuses(rules.RESOURCE_DESTROYED, recording):
            recording.submit(commands)
    vertices.destroy()


class Fixed(Shader):
    """Reads no vertices."""

    def vertex(self) -> vec4:
        return vec4(0.0, 0.0, 0.5, 1.0)

    def fragment(self) -> vec4:
        return vec4(1.0)


def test_a_mesh_without_attributes_lives_as_long(recording: Device, image: rhi.Texture) -> None:
    mesh, program = recording.mesh(3, label="points"), recording.program(Fixed)
    with recording.record() as commands, commands.render_pass(image):
        commands.draw(program, mesh)
    recording.submit(commands)
    mesh.destroy()
    with refuses(rules.RESOURCE_DESTROYED, recording) as refusal:
        recording.submit(commands)
    assert "Mesh('points')" in refusal.error.given


def test_a_submission_that_uses_a_locked_buffer_is_refused(recording: Device) -> None:
    with recording.buffer(4) as buffer, recording.buffer(4) as other:
        with recording.record() as commands:
            commands.clear(buffer)
        with buffer.lock(Access.WRITE), refuses(rules.LOCK_OPEN, recording):
            recording.submit(commands)
        with other.lock(Access.WRITE):
            recording.submit(commands)


def test_a_condition_needs_a_query_that_was_ended(recording: Device) -> None:
    query = recording.occlusion_query()
    with recording.texture(SIZE, Format.R8) as image:
        with recording.record() as asking, asking.render_pass(image), asking.conditional(query):
            pass
        with recording.record() as counting, counting.render_pass(image), counting.query(query):
            pass
        with refuses(rules.QUERY_STATE, recording):
            recording.submit(asking)
        with refuses(rules.QUERY_STATE, recording):
            recording.submit(asking, counting)
        recording.submit(counting, asking)
        recording.submit(asking)
    query.destroy()


def test_conditions_of_buffer_and_device_do_not_nest(recording: Device) -> None:
    query = recording.occlusion_query()
    with recording.texture(SIZE, Format.R8) as image:
        with recording.render_pass(image), query:
            pass
        with recording.record() as plain:
            clear(plain, image)
        with recording.record() as commands, commands.render_pass(image), commands.conditional(query):
            with refuses(rules.CONDITION_NESTED, recording), commands.conditional(query):
                pass
        with recording.conditional(query):
            with refuses(rules.CONDITION_NESTED, recording):
                recording.submit(plain, commands)
            recording.submit(plain)
        recording.submit(plain, commands)
    query.destroy()


# -- encoders are told apart -------------------------------------------------------------------------------


def test_transient_memory_belongs_to_its_frame_or_buffer(recording: Device) -> None:
    with recording.texture(SIZE, Format.RGBA8) as image, recording.mesh(rectangle()) as mesh:
        program, white = recording.program(Tinted), Tint(color=(1, 1, 1, 1))
        frame = recording.transient.uniform(white)
        with recording.record() as first, first.render_pass(image):
            transient = first.transient.uniform(white)
            with refuses(rules.RECORD_TRANSIENT, recording):
                first.draw(program, mesh, tint=frame)
            first.draw(program, mesh, tint=transient)
        with recording.record() as second, second.render_pass(image):
            with refuses(rules.RECORD_TRANSIENT, recording):
                second.draw(program, mesh, tint=transient)
        with recording.render_pass(image):
            with refuses(rules.RECORD_TRANSIENT, recording):
                recording.draw(program, mesh, tint=transient)
            recording.draw(program, mesh, tint=frame)
        recording.submit(first, second)


def test_transient_meshes_belong_to_their_frame_or_buffer(recording: Device) -> None:
    with recording.texture(SIZE, Format.RGBA8) as image:
        program = recording.program(Colored)
        frame = recording.transient.mesh(program, TRIANGLE)
        with recording.record() as commands, commands.render_pass(image):
            mesh = commands.transient.mesh(program, TRIANGLE, primitive=Primitive.TRIANGLES)
            with refuses(rules.RECORD_TRANSIENT, recording):
                commands.draw(program, frame)
            commands.draw(program, mesh)
        with recording.render_pass(image):
            with refuses(rules.RECORD_TRANSIENT, recording):
                recording.draw(program, mesh)
            recording.draw(program, frame)
        recording.submit(commands)


def test_passes_do_not_nest_in_a_buffer_either(recording: Device) -> None:
    with recording.texture(SIZE, Format.R8) as first, recording.texture(SIZE, Format.R8) as second:
        with recording.record() as commands, commands.render_pass(first):
            with refuses(rules.PASS_NESTED, recording), commands.render_pass(second):
                pass
        with recording.render_pass(second):  # the device's pass and a buffer's are different things
            with recording.record() as commands, commands.render_pass(first):
                pass
        recording.submit(commands)


def test_a_refused_draw_leaves_the_buffer_as_it_was(recording: Device) -> None:
    with recording.texture(SIZE, Format.RGBA8) as image, recording.mesh(rectangle()) as mesh:
        program, tint = recording.program(Tinted), recording.uniform(Tint(color=(1, 1, 1, 1)))
        with recording.record() as commands:
            with refuses(rules.DRAW_OUTSIDE_PASS, recording):
                commands.draw(program, mesh, tint=tint)
            with commands.render_pass(image):
                before = len(commands)
                with refuses(rules.BINDING_MISSING, recording):
                    loose(commands).draw(program, mesh)
                with refuses(rules.DEVICE_ARGUMENT, recording):
                    loose(commands).draw(program, image, tint=tint)
                with refuses(rules.DEVICE_ARGUMENT, recording):
                    loose(commands).draw(mesh, mesh, tint=tint)
                assert len(commands) == before
                commands.draw(program, mesh, tint=tint)
        recording.submit(commands)
        tint.destroy()
