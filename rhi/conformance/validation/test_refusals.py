"""Refused calls on a real device: one of each kind, with the nearest call that must pass.

The front end refuses a call before the backend sees it, so the rules themselves are tested once, on the null
device (`tests/rhi/device/refusals`). These tests show what needs each backend: a refused call leaves nothing
behind on the device, and a device may be closed at any time.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import CullMode, Device, Format, Op, Scissor
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Bare, Colored, Corner, Tint, Tinted
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import loose, refuses
from rhi.errors import rules
from rhi.shading import Shader, Storage, StorageRW, Uniform

SIZE = (4, 4)


def test_a_refused_write_leaves_the_buffer_as_it_was(recording: Device) -> None:
    with recording.buffer(8, np.dtype("u4")) as buffer:
        with refuses(rules.BUFFER_RANGE, recording):
            buffer.write(np.ones(8, "u4"), 1)
        assert_same(buffer.read(), 0)
        buffer.write(np.ones(8, "u4"), 0)
        assert_same(buffer.read(), 1)


def test_refused_texels_leave_the_texture_as_it_was(recording: Device) -> None:
    with recording.texture(SIZE, Format.RGBA8) as texture:
        with refuses(rules.TEXTURE_DATA, recording):
            texture.write(np.ones((4, 4, 2), "u1"))
        assert_same(texture.read(), 0)
        texture.write(np.ones((4, 4, 4), "u1"))
        assert_same(texture.read(), 1)


def test_a_refused_mesh_creates_nothing(recording: Device) -> None:
    with refuses(rules.MESH_INDEX, recording):
        recording.mesh(rectangle(), np.array([0, 1, 6]))
    recording.mesh(rectangle(), np.array([0, 1, 5])).destroy()


@pytest.mark.requires("compute")
def test_a_refused_dispatch_writes_nothing(recording: Device) -> None:
    tint = recording.uniform(Tint(color=(1, 1, 1, 1)))
    with recording.storage(float, 1) as values:
        program = recording.program(Dispatched)
        with refuses(rules.DISPATCH_SIZE, recording):
            recording.dispatch(program, -1, groups=tint, buffer=values, offset=tint)
        assert_same(values.read(), 0)
        recording.dispatch(program, 1, groups=tint, buffer=values, offset=tint)
    tint.destroy()


@pytest.mark.requires("draws")
def test_a_refused_pass_leaves_the_open_one_open(recording: Device) -> None:
    with recording.texture(SIZE, Format.R8) as first, recording.texture(SIZE, Format.R8) as second:
        with recording.render_pass(first, clear=(0, 0, 0, 0)):
            with refuses(rules.PASS_NESTED, recording), recording.render_pass(second, clear=(1, 1, 1, 1)):
                pass
            with recording.mesh(rectangle()) as mesh:
                recording.draw(recording.program(Colored), mesh)
        assert_same(second.read(), 0)
        if recording.capabilities.shading:
            assert_same(first.read(), 255)


@pytest.mark.requires("draws")
def test_a_refused_scope_changes_no_state(recording: Device) -> None:
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image):
            with (
                refuses(rules.STATE_DUPLICATE, recording),
                recording.states(Scissor(0, 0, 1, 1), CullMode.NONE, CullMode.NONE),
            ):
                pass
            recording.draw(recording.program(Colored), mesh)
        if recording.capabilities.shading:
            assert_same(image.read(), 255)


@pytest.mark.requires("draws")
def test_a_refused_draw_keeps_the_bindings_of_the_one_before(recording: Device) -> None:
    tint = recording.uniform(Tint(color=(1, 1, 1, 1)))
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        program = recording.program(Tinted)
        with recording.render_pass(image):
            recording.draw(program, mesh, 0, tint=tint)
            with refuses(rules.BINDING_TYPE, recording):
                loose(recording).draw(program, mesh, tint=3)
            with refuses(rules.BINDING_MISSING, recording):
                loose(recording).draw(program, mesh)
            with refuses(rules.DRAW_COUNT, recording):
                recording.draw(program, mesh, -1, tint=tint)
            recording.draw(program, mesh, tint=tint)
        if recording.capabilities.shading:
            assert_same(image.read(), 255)
    tint.destroy()


def test_a_refused_submission_executes_nothing(recording: Device) -> None:
    with recording.texture(SIZE, Format.R8) as image:
        with recording.record() as whole, whole.render_pass(image, clear=(1, 1, 1, 1)):
            pass
        with pytest.raises(ZeroDivisionError), recording.record() as broken:
            _ = 1 / 0
        with refuses(rules.RECORD_STATE, recording):
            recording.submit(whole, broken)
        assert_same(image.read(), 0)
        recording.submit(whole)
        if recording.capabilities.renders:
            assert_same(image.read(), 255)


@pytest.mark.requires("draws", "occlusion_queries", "shading")
def test_a_refused_call_keeps_the_answers_of_a_query_set(recording: Device) -> None:
    program, queries = recording.program(Colored), recording.query_set(4)
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image):
            recording.draw_counted(program, mesh, mesh.draws(), queries)
            assert queries.wait()[0] == 16
            with refuses(rules.QUERY_INDICES, recording):
                recording.draw_counted(program, mesh, mesh.draws(), queries, [9])
        assert queries.is_finished
        assert queries.visible_samples[0] == 16
    queries.destroy()


# -- names that shaders give their bindings ------------------------------------------------------------------


class Plainly(Shader):
    """Bindings called like arguments of draws, and like what is generated for them might be."""

    instances: Storage[Tint]
    mesh: Uniform[Tint]
    program: Uniform[Tint]
    draws: Uniform[Tint]
    len: Uniform[Tint]

    def vertex(self, v: Corner) -> Bare:
        rest = self.program.color * self.draws.color * self.len.color
        return Bare(clip=v.position * self.mesh.color * self.instances[0].color * rest)


class Dispatched(Shader):
    """The same of a dispatch."""

    work_group = (1,)
    groups: Uniform[Tint]
    buffer: StorageRW[float]
    offset: Uniform[Tint]

    def compute(self) -> None:
        self.buffer[0] = self.groups.color.x + self.offset.color.x


@pytest.mark.requires("draws")
def test_a_binding_can_be_called_like_an_argument(recording: Device) -> None:
    tint, rows = recording.uniform(Tint(color=(1, 1, 1, 1))), recording.storage(Tint, 1)
    plainly = recording.program(Plainly)
    named: dict[str, Any] = {"instances": rows, "mesh": tint, "program": tint, "draws": tint, "len": tint}
    with recording.texture(SIZE, Format.RGBA8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image):
            recording.draw(plainly, mesh, **named)
            plainly.draw(mesh, 2, **named)
            recording.draw_many(plainly, mesh, mesh.draws([0, 0]), **named)
    drawn = recording.stream.filter(Op.DRAW)[-2:]
    assert [draw["instances"] for draw in drawn] == [1, 2]
    for resource in (tint, rows):
        resource.destroy()


@pytest.mark.requires("compute")
def test_a_binding_can_be_called_like_an_argument_of_a_dispatch(recording: Device) -> None:
    tint, values = recording.uniform(Tint(color=(1, 1, 1, 1))), recording.storage(float, 1)
    recording.dispatch(recording.program(Dispatched), 1, groups=tint, buffer=values, offset=tint)
    assert values.read().tolist() == ([2] if recording.capabilities.shading else [0])
    for resource in (tint, values):
        resource.destroy()


# -- closing ----------------------------------------------------------------------------------------------


def test_resources_may_be_destroyed_after_their_device(backend: str) -> None:
    device = rhi.create_device(backend)
    resources: list[Any] = [device.buffer(4), device.texture(SIZE, Format.R8), device.mesh(rectangle())]
    device.close()
    for resource in resources:
        resource.destroy()


@pytest.mark.requires("draws")
@pytest.mark.parametrize("quiet", [False, True])
def test_a_device_may_be_closed_in_the_middle_of_everything(backend: str, quiet: bool) -> None:
    """It is closed nevertheless, and blocks that are still open end quietly."""
    with rhi.create_device(backend) as device:
        image, mesh, program = (
            device.texture(SIZE, Format.R8),
            device.mesh(rectangle()),
            device.program(Colored),
        )
        with ExitStack() as stack:
            stack.enter_context(device.event("frame"))
            stack.enter_context(device.render_pass(image))
            stack.enter_context(device.states(CullMode.NONE))
            if device.capabilities.occlusion_queries:
                stack.enter_context(device.occlusion_query())
            device.draw(program, mesh)
            if quiet:
                device.close(quiet=True)
            else:
                with refuses(rules.SCOPE_OPEN):
                    device.close()
            assert device.closed
        assert device.closed
