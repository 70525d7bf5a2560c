"""A device belongs to one thread: calls on another are refused, until the device is moved there."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeAlias, TypeVar

import numpy as np
import pytest

import rhi
from rhi import Access, CullMode, Device, Format, Op
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored, Tint, Tinted
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import check_working, refuses
from rhi.errors import rules

T = TypeVar("T")
Elsewhere: TypeAlias = Callable[[Callable[[], T]], T]

SIZE = (4, 4)
pytestmark = pytest.mark.threads


@pytest.fixture
def elsewhere() -> Iterator[Elsewhere[Any]]:
    """A function that runs another on a second thread, always the same, and returns or raises what that one
    does."""
    with ThreadPoolExecutor(1, "elsewhere") as pool:
        yield lambda call: pool.submit(call).result()


class Resources:
    """A buffer and a texture, created on the device's thread."""

    def __init__(self, device: Device) -> None:
        self.buffer = device.buffer(np.arange(4))
        self.texture = device.texture(SIZE, Format.RGBA8)
        self.device = device


USES: dict[str, Callable[[Device, Resources], object]] = {
    "buffer read": lambda d, r: r.buffer.read(),
    "buffer lock": lambda d, r: r.buffer.lock(Access.READ).__enter__(),  # stays locked
    "texture write": lambda d, r: r.texture.write(np.ones((*SIZE, 4), "u1")),
    "render pass": lambda d, r: d.render_pass(r.texture).__enter__(),
    "states": lambda d, r: d.states(CullMode.NONE).__enter__(),
    "close": lambda d, r: d.close(),
}
"""A call of each kind: that all others are refused, too, `tests/rhi/device/test_calls_on_threads.py` shows
once."""


@pytest.mark.parametrize("use", USES)
def test_a_call_on_another_thread_is_refused(recording: Device, elsewhere: Elsewhere[Any], use: str) -> None:
    resources = Resources(recording)
    with refuses(rules.DEVICE_THREAD, recording) as refusal:
        elsewhere(lambda: USES[use](recording, resources))
    assert "elsewhere_0" in refusal.error.given
    assert "MainThread" in refusal.error.allowed
    assert_same(resources.buffer.read(), np.arange(4))


@pytest.mark.parametrize("use", USES)
def test_the_same_call_is_allowed_on_the_device_s_thread(backend: str, use: str) -> None:
    device = rhi.create_device(backend)
    USES[use](device, Resources(device))
    device.close(quiet=True)


@pytest.mark.requires("draws")
def test_a_program_is_created_on_the_device_s_thread(backend: str, elsewhere: Elsewhere[Any]) -> None:
    with rhi.create_device(backend) as device:
        with refuses(rules.DEVICE_THREAD):
            elsewhere(lambda: device.program(Colored))
        device.program(Colored)
        elsewhere(lambda: device.program(Colored))  # exists


@pytest.mark.requires("draws")
def test_without_validation_a_first_draw_is_refused(backend: str, elsewhere: Elsewhere[Any]) -> None:
    with rhi.create_device(backend) as device:
        program, image, mesh = (
            device.program(Colored),
            device.texture(SIZE, Format.R8),
            device.mesh(rectangle()),
        )
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            with refuses(rules.DEVICE_THREAD):
                elsewhere(lambda: device.draw(program, mesh))
            device.draw(program, mesh)
        if device.capabilities.shading:
            assert_same(image.read(), 255)


# -- ends of blocks ------------------------------------------------------------------------------------------


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


@pytest.mark.requires("draws", "compute", "occlusion_queries", "conditional_rendering")
@pytest.mark.parametrize("kind", BLOCKS)
def test_a_block_ends_on_the_thread_of_its_begin(
    fresh_device: Device, elsewhere: Elsewhere[Any], kind: str
) -> None:
    """A refused end has no effect: the block is left here afterwards."""
    block = BLOCKS[kind](Resources(fresh_device))
    with block:
        with refuses(rules.DEVICE_THREAD) as refusal:
            elsewhere(lambda: block.__exit__(None, None, None))
        assert "end" in refusal.error.call
    check_working(fresh_device)


def test_a_buffer_created_here_may_be_recorded_elsewhere(
    fresh_device: Device, elsewhere: Elsewhere[Any]
) -> None:
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


# -- moving a device -----------------------------------------------------------------------------------------


@pytest.fixture
def moved_buffer(fresh_device: Device, elsewhere: Elsewhere[Any]) -> rhi.Buffer:
    """A buffer of a device that has moved to another thread."""
    check_working(fresh_device)
    buffer = fresh_device.buffer(np.arange(4))
    fresh_device.release_current()
    elsewhere(fresh_device.make_current)
    return buffer


def test_a_released_device_works_on_the_thread_that_makes_it_current(
    fresh_device: Device, moved_buffer: rhi.Buffer, elsewhere: Elsewhere[Any]
) -> None:
    elsewhere(lambda: check_working(fresh_device))
    assert_same(elsewhere(moved_buffer.read), np.arange(4))
    elsewhere(fresh_device.release_current)
    fresh_device.make_current()


def test_a_device_that_has_moved_refuses_the_thread_that_it_left(
    fresh_device: Device, moved_buffer: rhi.Buffer, elsewhere: Elsewhere[Any]
) -> None:
    with refuses(rules.DEVICE_THREAD):
        moved_buffer.read()
    elsewhere(fresh_device.release_current)
    fresh_device.make_current()


def test_a_device_that_has_moved_can_move_back(
    fresh_device: Device, moved_buffer: rhi.Buffer, elsewhere: Elsewhere[Any]
) -> None:
    elsewhere(fresh_device.release_current)
    fresh_device.make_current()
    assert_same(moved_buffer.read(), np.arange(4))
    check_working(fresh_device)


@pytest.mark.requires("draws", "shading")
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


@pytest.mark.requires("draws")
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


@pytest.mark.requires("draws", "occlusion_queries", "shading")
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


# -- what other threads may do -------------------------------------------------------------------------------


@pytest.mark.requires("draws")
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
