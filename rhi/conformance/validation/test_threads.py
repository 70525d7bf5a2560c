"""A device belongs to one thread: calls on another are refused, until the device is moved there."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeAlias, TypeVar

import numpy as np
import pytest

import rhi
from rhi import Access, CullMode, Device, Format, Op, Primitive, SamplerDescriptor
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored, Tint, Tinted
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import check_working, refuses
from rhi.errors import rules
from rhi.shading import Shader, StorageRW, global_id, uint

T = TypeVar("T")
Elsewhere: TypeAlias = Callable[[Callable[[], T]], T]

SIZE = (4, 4)


@pytest.fixture
def elsewhere() -> Iterator[Elsewhere[Any]]:
    """A function that runs another on a second thread, always the same, and returns or raises what that one does."""
    with ThreadPoolExecutor(1, "elsewhere") as pool:
        yield lambda call: pool.submit(call).result()


class Numbered(Shader):
    """Stores a number."""

    numbers: StorageRW[uint]

    def compute(self) -> None:
        self.numbers[global_id().x] = uint(7)


class Resources:
    """A resource of each kind, created on the device's thread."""

    def __init__(self, device: Device) -> None:
        self.buffer = device.buffer(np.arange(4))
        self.texture = device.texture(SIZE, Format.RGBA8)
        self.uniform = device.uniform(Tint(color=(1, 1, 1, 1)))
        self.device, self.commands = device, device.record()
        with self.commands:
            self.commands.clear(self.buffer)

    def destroy(self) -> None:
        for resource in (self.buffer, self.texture, self.uniform):
            resource.destroy()


USES: dict[str, Callable[[Device, Resources], object]] = {
    "buffer": lambda d, r: d.buffer(4),
    "storage": lambda d, r: d.storage(uint, 4),
    "uniform": lambda d, r: d.uniform(Tint(color=(0, 0, 0, 0))),
    "texture": lambda d, r: d.texture(SIZE, Format.R8),
    "sampler": lambda d, r: d.sampler(SamplerDescriptor(border=(0.5, 0.25, 0.125, 0.0625))),
    "mesh": lambda d, r: d.mesh(rectangle()),
    "buffer read": lambda d, r: r.buffer.read(),
    "buffer write": lambda d, r: r.buffer.write(np.zeros(4, r.buffer.dtype)),
    "buffer clear": lambda d, r: r.buffer.clear(1),
    "buffer lock": lambda d, r: r.buffer.lock(Access.READ).__enter__(),  # stays locked
    "uniform write": lambda d, r: r.uniform.write(Tint(color=(0, 0, 0, 0))),
    "texture read": lambda d, r: r.texture.read(),
    "texture write": lambda d, r: r.texture.write(np.ones((*SIZE, 4), "u1")),
    "destroy": lambda d, r: r.buffer.destroy(),
    "destroy texture": lambda d, r: r.texture.destroy(),
    "render pass": lambda d, r: d.render_pass(r.texture).__enter__(),
    "event": lambda d, r: d.event("elsewhere").__enter__(),
    "submit": lambda d, r: d.submit(r.commands),
    "signal": lambda d, r: d.signal(),
    "completed": lambda d, r: d.completed,
    "finish": lambda d, r: d.finish(),
    "present": lambda d, r: d.present(),
    "make current": lambda d, r: d.make_current(),
    "release current": lambda d, r: d.release_current(),
    "close": lambda d, r: d.close(),
}


@pytest.mark.parametrize("use", USES)
def test_a_call_on_another_thread_is_refused(recording: Device, elsewhere: Elsewhere[Any], use: str) -> None:
    resources = Resources(recording)
    with refuses(rules.DEVICE_THREAD, recording) as refusal:
        elsewhere(lambda: USES[use](recording, resources))
    assert "elsewhere_0" in refusal.error.given
    assert "MainThread" in refusal.error.allowed
    assert_same(resources.buffer.read(), np.arange(4))
    resources.destroy()


@pytest.mark.parametrize("use", USES)
def test_the_same_call_is_allowed_on_the_device_s_thread(backend: str, use: str) -> None:
    device = rhi.create_device(backend)
    USES[use](device, Resources(device))
    device.close(quiet=True)


@pytest.mark.needs("compute")
def test_a_dispatch_on_another_thread_is_refused(recording: Device, elsewhere: Elsewhere[Any]) -> None:
    program = recording.program(Numbered)
    with recording.storage(uint, 1) as numbers:
        with refuses(rules.DEVICE_THREAD, recording):
            elsewhere(lambda: recording.dispatch(program, 1, numbers=numbers))
        assert_same(numbers.read(), 0)
        recording.dispatch(program, 1, numbers=numbers)
        assert_same(numbers.read(), 7 if recording.capabilities.shading else 0)


@pytest.mark.needs("draws")
def test_a_program_is_created_on_the_device_s_thread(backend: str, elsewhere: Elsewhere[Any]) -> None:
    with rhi.create_device(backend) as device:
        with refuses(rules.DEVICE_THREAD):
            elsewhere(lambda: device.program(Colored))
        device.program(Colored)
        elsewhere(lambda: device.program(Colored))  # exists


@pytest.mark.needs("draws", "occlusion_queries")
def test_an_answer_is_read_on_the_device_s_thread(recording: Device, elsewhere: Elsewhere[Any]) -> None:
    query, queries = recording.occlusion_query(), recording.query_set(2)
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image), query:
            recording.draw(recording.program(Colored), mesh)
        calls: list[Callable[[], object]] = [
            lambda: query.is_finished, lambda: query.wait(), lambda: query.destroy(), lambda: queries.destroy(),
        ]  # fmt: skip
        for call in calls:
            with refuses(rules.DEVICE_THREAD, recording):
                elsewhere(call)
    query.destroy()
    queries.destroy()


# -- what costs nothing only with validation ------------------------------------------------------------------

COMMANDS: dict[str, Callable[[Device, Any, Any, Any], object]] = {
    "draw": lambda d, program, mesh, tint: d.draw(program, mesh, tint=tint),
    "draw of the program": lambda d, program, mesh, tint: program.draw(mesh, tint=tint),
    "draw many": lambda d, program, mesh, tint: d.draw_many(program, mesh, mesh.draws(), tint=tint),
    "states": lambda d, program, mesh, tint: d.states(CullMode.NONE).__enter__(),
    "transient": lambda d, program, mesh, tint: d.transient.uniform(Tint(color=(1, 1, 1, 1))),
    "immediate": lambda d, program, mesh, tint: d.immediate(program, Primitive.QUADS, tint=tint).__enter__(),
}


@pytest.mark.needs("draws")
@pytest.mark.parametrize("use", COMMANDS)
def test_with_validation_each_command_is_refused(recording: Device, elsewhere: Elsewhere[Any], use: str) -> None:
    program, tint = recording.program(Tinted), recording.uniform(Tint(color=(1, 1, 1, 1)))
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image, clear=(0, 0, 0, 0)):
            recording.draw(program, mesh, 0, tint=tint)
            with refuses(rules.DEVICE_THREAD, recording):
                elsewhere(lambda: COMMANDS[use](recording, program, mesh, tint))
        assert_same(image.read(), 0)
    tint.destroy()


@pytest.mark.needs("draws")
def test_without_validation_a_first_draw_is_refused(backend: str, elsewhere: Elsewhere[Any]) -> None:
    with rhi.create_device(backend) as device:
        program, image, mesh = device.program(Colored), device.texture(SIZE, Format.R8), device.mesh(rectangle())
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            with refuses(rules.DEVICE_THREAD):
                elsewhere(lambda: device.draw(program, mesh))
            device.draw(program, mesh)
        if device.capabilities.shading:
            assert_same(image.read(), 255)


# -- ends of blocks ---------------------------------------------------------------------------------------------


def answered(device: Device) -> rhi.OcclusionQuery:
    """Return a query that was ended."""
    query = device.occlusion_query()
    with device.render_pass(device.texture(SIZE, Format.RGBA8)), query:
        pass
    return query


BLOCKS: dict[str, Callable[[Resources], Any]] = {
    "states": lambda e: e.device.states(CullMode.NONE),
    "event": lambda e: e.device.event("here"),
    "pass": lambda e: e.device.render_pass(e.texture),
    "condition": lambda e: e.device.conditional(answered(e.device)),
    "lock": lambda e: e.buffer.lock(Access.WRITE),
    "recording": lambda e: e.device.record(),
}


@pytest.mark.needs("draws", "compute", "occlusion_queries", "conditional_rendering")
@pytest.mark.parametrize("kind", BLOCKS)
def test_a_block_ends_on_the_thread_of_its_begin(fresh_device: Device, elsewhere: Elsewhere[Any], kind: str) -> None:
    """A refused end has no effect: the block is left here afterwards."""
    block = BLOCKS[kind](Resources(fresh_device))
    with block:
        with refuses(rules.DEVICE_THREAD) as refusal:
            elsewhere(lambda: block.__exit__(None, None, None))
        assert "end" in refusal.error.call
    check_working(fresh_device)


def test_a_buffer_created_here_may_be_recorded_elsewhere(fresh_device: Device, elsewhere: Elsewhere[Any]) -> None:
    image = fresh_device.texture(SIZE, Format.R8)
    commands = fresh_device.record()

    def record() -> None:
        with commands, commands.render_pass(image, clear=(1, 0, 0, 0)):
            pass

    elsewhere(record)
    fresh_device.submit(commands)
    if fresh_device.capabilities.renders:
        assert_same(image.read(), 255)


def test_a_recording_has_one_thread(fresh_device: Device, elsewhere: Elsewhere[Any]) -> None:
    buffer = fresh_device.buffer(8)
    with fresh_device.record() as commands:
        with refuses(rules.DEVICE_THREAD):
            elsewhere(lambda: commands.clear(buffer))
        commands.clear(buffer)
    assert len(commands) == 1


# -- moving a device --------------------------------------------------------------------------------------------


def test_a_released_device_moves_to_the_thread_that_makes_it_current(
    fresh_device: Device, elsewhere: Elsewhere[Any]
) -> None:
    device = fresh_device
    check_working(device)
    buffer = device.buffer(np.arange(4))
    device.release_current()
    elsewhere(device.make_current)
    elsewhere(lambda: check_working(device))
    assert_same(elsewhere(buffer.read), np.arange(4))
    with refuses(rules.DEVICE_THREAD):
        buffer.read()
    elsewhere(device.release_current)
    device.make_current()
    assert_same(buffer.read(), np.arange(4))
    check_working(device)


@pytest.mark.needs("draws", "shading")
def test_states_and_bindings_move_with_a_device(fresh_device: Device, elsewhere: Elsewhere[Any]) -> None:
    device = fresh_device
    image, mesh, program = device.texture(SIZE, Format.R8), device.mesh(rectangle()), device.program(Tinted)
    tint = device.uniform(Tint(color=(1, 1, 1, 1)))

    def draw() -> Any:
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, mesh, tint=tint)
        return image.read()

    def draw_and_return() -> Any:
        device.make_current()
        pixels = draw()
        device.release_current()
        return pixels

    with device.states(rhi.Scissor(0, 0, 2, 4)):
        here = draw()
        device.release_current()
        there = elsewhere(draw_and_return)
        device.make_current()
        again = draw()
    assert_same(here[:, :2], 255)
    assert_same(here[:, 2:], 0)
    assert_same(there, here)
    assert_same(again, here)


def test_a_released_device_refuses_calls(fresh_device: Device) -> None:
    buffer = fresh_device.buffer(4)
    fresh_device.release_current()
    for call in (buffer.read, lambda: fresh_device.buffer(4), fresh_device.release_current):
        with refuses(rules.DEVICE_THREAD) as refusal:
            call()
        assert "make_current" in refusal.error.allowed
    fresh_device.make_current()
    assert_same(buffer.read(), 0)


def test_a_released_device_may_be_closed_anywhere(backend: str, elsewhere: Elsewhere[Any]) -> None:
    device = rhi.create_device(backend)
    device.buffer(4)
    device.release_current()
    elsewhere(device.close)
    assert device.closed
    with refuses(rules.DEVICE_CLOSED):
        device.make_current()


def test_a_with_block_makes_its_device_current(backend: str, elsewhere: Elsewhere[Any]) -> None:
    device = rhi.create_device(backend)
    device.release_current()

    def use() -> None:
        with device:
            check_working(device)

    elsewhere(use)
    assert device.closed


def test_a_pass_does_not_move(recording: Device, elsewhere: Elsewhere[Any]) -> None:
    with recording.texture(SIZE, Format.R8) as image, recording.render_pass(image):
        with refuses(rules.DEVICE_THREAD, recording):
            elsewhere(lambda: recording.release_current())
        with refuses(rules.PASS_OPEN, recording):
            recording.release_current()


@pytest.mark.needs("draws")
@pytest.mark.recorded_too
def test_a_device_made_current_again_goes_on(device: Device) -> None:
    """Between two draws, with states, a condition's query and constants in place."""
    tint = device.uniform(Tint(color=(1, 1, 1, 1)))
    with device.texture(SIZE, Format.R8) as image, device.mesh(rectangle()) as mesh:
        program = device.program(Tinted)
        with device.event("frame"), device.states(CullMode.BACK, rhi.Scissor(0, 0, 4, 2)):
            with device.render_pass(image, clear=(0, 0, 0, 0)):
                device.draw(program, mesh, 0, tint=tint)
                device.make_current()
                device.draw(program, mesh, tint=tint)
            device.make_current()
        if device.capabilities.shading:
            assert_same(image.read()[:2], 255)
            assert_same(image.read()[2:], 0)
    tint.destroy()


@pytest.mark.needs("draws", "occlusion_queries", "shading")
@pytest.mark.parametrize("emulated", [False, True])
def test_a_query_counts_on_when_the_device_is_made_current(device: Device, emulated: bool) -> None:
    if emulated and not device.capabilities.sample_counter:
        pytest.skip("the device has no sample_counter")
    query = device.occlusion_query(emulated=emulated)
    with device.texture(SIZE, Format.R8) as image, device.mesh(rectangle()) as mesh:
        with device.render_pass(image), query:
            device.draw(device.program(Colored), mesh)
            device.make_current()
            device.draw(device.program(Colored), mesh)
        device.make_current()
        assert query.wait() == 32
    query.destroy()


def test_making_a_device_current_is_no_command(recording: Device) -> None:
    since = len(recording.stream)
    recording.make_current()
    recording.release_current()
    recording.make_current()
    assert len(recording.stream) == since


# -- what other threads may do ------------------------------------------------------------------------------------


@pytest.mark.needs("draws")
def test_commands_recorded_elsewhere_are_submitted_here(recording: Device, elsewhere: Elsewhere[Any]) -> None:
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        program = recording.program(Colored)

        def record() -> rhi.CommandBuffer:
            with recording.record() as commands, commands.render_pass(image, clear=(0, 0, 0, 0)):
                commands.draw(program, mesh)
            return commands

        commands = elsewhere(record)
        with refuses(rules.DEVICE_THREAD, recording):
            elsewhere(lambda: recording.submit(commands))
        recording.submit(commands)
        assert recording.stream[-1].op is Op.END_PASS
        if recording.capabilities.shading:
            assert_same(image.read(), 255)
