"""A device belongs to one thread: calls on another are refused, until the device is moved there."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from functools import partial
from typing import Any, TypeAlias, TypeVar

import numpy as np
import pytest

import rhi
from rhi import Access, CullMode, Device, Format, Op, Primitive, SamplerDescriptor, TextureKind
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored, Tint, Tinted
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import check_working, refuses
from rhi.device.transient import TransientMemory
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
        self.commands = device.record()
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


# -- every public member ----------------------------------------------------------------------------------------

SAFE = {
    "Device": "NAME backend_as backend_name capabilities closed conditional event immediate record render_pass states "
    "stream timing transient",
    "Buffer": "bind_uniform core count dtype id label size destroyed lock",
    "UniformBuffer": "buffer kind offset owner size type",
    "UniformArray": "buffer count dtype label lock struct type",
    "StorageBuffer": "buffer count dtype element id lock offset owner size type",
    "Texture": "at compressed core descriptor destroyed format id image kind label layers levels lock owner sampled "
    "sampler samples size texture",
    "Mesh": "base_instance base_vertex buffers core count data draws element_count first index_count indices instances "
    "is_indexed keep_vertex_array place_draws create_vertex_array prepared_draws primitive vertex_arrays vertex_count "
    "vertices view",
    "Program": "core descriptor destroyed draw_code id label name recorded_code",
    "OcclusionQuery": "core destroyed emulated id ids label",
    "QuerySet": "core destroyed emulated id ids label",
    "TransientMemory": "arguments capacity",
}
"""Members that any thread may use: they read what never changes, or create a block, view or recording that is checked
when it is used. (A member that isn't documented for users, such as `bind_uniform`, belongs to the front end.)"""

INNER = {
    "Program": "bind bind_current build check check_can_dispatch check_can_draw check_instances check_names "
    "draw_unprepared draw_with exchange explain find_vertex_array make_current note_retired prepare_draw",
    "OcclusionQuery": "abandon check_ended check_usable complete cut_off describe discard_answer find_block finish "
    "mark_submitted write_begin write_end",
    "QuerySet": "check_conditions check_ended check_rows counted discard_answer draw draw_conditional mark_rows_drawn "
    "mark_rows_submitted mark_submitted",
    "TransientMemory": "mark note_retired place_mesh",
}  # fmt: skip
"""Members by which the front end's parts call each other, after their checks."""


class Everything:
    """An object of each class."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.buffer, self.other = device.buffer(np.zeros(8, "u4")), device.buffer(np.zeros(8, "u4"))
        self.large = device.buffer(4096)
        self.texture, self.second = device.texture(SIZE, Format.RGBA8, levels=None), device.texture(SIZE, Format.RGBA8)
        self.several = device.texture(SIZE, Format.RGBA8, samples=device.capabilities.sample_counts[-1])
        self.layered = device.texture(SIZE, Format.RGBA8, kind=TextureKind.D2_ARRAY, layers=2)
        self.stencil = device.texture(SIZE, Format.D24S8)
        self.uniform = device.uniform(Tint(color=(1, 1, 1, 1)))
        self.array = device.uniform_array(Tint, 2)
        self.storage = device.storage(uint, 4)
        self.mesh, self.unused = device.mesh(rectangle()), device.mesh(rectangle())
        self.program, self.tinted = device.program(Colored), device.program(Tinted)
        self.compute = device.program(Numbered)
        self.draws = device.storage(uint, 5)
        self.query, self.queries = device.occlusion_query(), device.query_set(2)
        self.commands = device.record()
        with self.commands:
            self.commands.clear(self.buffer)
        with device.render_pass(self.texture):
            with self.query:
                device.draw(self.program, self.mesh)
            device.draw_counted(self.program, self.mesh, self.mesh.draws(), self.queries)


def use_device(use: Callable[[Device, Any], object], everything: Everything) -> object:
    """Call one of `USES`."""
    return use(everything.device, everything)


EVERY: dict[str, dict[str, Callable[[Everything], object]]] = {
    "Device": {
        **{name: partial(use_device, use) for name, use in USES.items() if name.isidentifier()},
        "uniform_array": lambda e: e.device.uniform_array(Tint, 1),
        "program": lambda e: e.device.program(Unseen),
        "prepare": lambda e: e.device.prepare(e.program),
        "wait": lambda e: e.device.wait(0),
        "adopt_texture": lambda e: e.device.adopt_texture(1),
        "native_texture": lambda e: e.device.native_texture(e.texture),
        "occlusion_query": lambda e: e.device.occlusion_query(),
        "query_set": lambda e: e.device.query_set(1),
        "timers": lambda e: e.device.timers,
        "statistics": lambda e: e.device.statistics,
        "reset_statistics": lambda e: e.device.reset_statistics(),
        "make_current": lambda e: e.device.make_current(),
        "release_current": lambda e: e.device.release_current(),
        "dispatch": lambda e: e.device.dispatch(e.compute, 1, numbers=e.storage),
        "dispatch_indirect": lambda e: e.device.dispatch_indirect(e.compute, e.draws, numbers=e.storage),
        "draw": lambda e: e.device.draw(e.program, e.unused),
        "draw_many": lambda e: e.device.draw_many(e.program, e.unused, e.unused.draws()),
        "draw_clipped": lambda e: e.device.draw_clipped(e.program, e.unused, e.unused.draws(), [(0, 0, 4, 4)]),
        "draw_counted": lambda e: e.device.draw_counted(e.program, e.unused, e.unused.draws(), e.queries),
        "draw_conditional": lambda e: e.device.draw_conditional(e.program, e.unused, e.unused.draws(), e.queries),
        "draw_indirect": lambda e: e.device.draw_indirect(e.program, e.unused, rhi.IndirectDraws(e.draws, 1)),
    },
    "Buffer": {
        "clear": lambda e: e.buffer.clear(1),
        "copy_to": lambda e: e.buffer.copy_to(e.other),
        "destroy": lambda e: e.buffer.destroy(),
        "read": lambda e: e.buffer.read(),
        "read_async": lambda e: e.buffer.read_async(),
        "write": lambda e: e.buffer.write(np.ones(8, "u4")),
    },
    "UniformBuffer": {
        "write": lambda e: e.uniform.write(Tint(color=(0, 0, 0, 0))),
        "destroy": lambda e: e.uniform.destroy(),
    },
    "UniformArray": {
        "write": lambda e: e.array.write(np.zeros(2, e.array.dtype)),
        "destroy": lambda e: e.array.destroy(),
    },
    "StorageBuffer": {
        "clear": lambda e: e.storage.clear(1),
        "destroy": lambda e: e.storage.destroy(),
        "read": lambda e: e.storage.read(),
        "read_async": lambda e: e.storage.read_async(),
        "write": lambda e: e.storage.write(np.ones(4, "u4")),
    },
    "Texture": {
        "copy_from_buffer": lambda e: e.texture.copy_from_buffer(e.large),
        "copy_to": lambda e: e.texture.copy_to(e.second),
        "copy_to_buffer": lambda e: e.texture.copy_to_buffer(e.large),
        "destroy": lambda e: e.texture.destroy(),
        "generate_mipmaps": lambda e: e.texture.generate_mipmaps(),
        "read": lambda e: e.texture.read(),
        "read_async": lambda e: e.texture.read_async(),
        "read_layers": lambda e: e.layered.read_layers(),
        "read_stencil": lambda e: e.stencil.read_stencil(),
        "resolve_to": lambda e: e.several.resolve_to(e.second),
        "write": lambda e: e.texture.write(np.ones((*SIZE, 4), "u1")),
    },
    "Mesh": {"destroy": lambda e: e.mesh.destroy()},
    "Program": {
        "destroy": lambda e: e.tinted.destroy(),
        "draw": lambda e: e.program.draw(e.unused),
    },
    "OcclusionQuery": {
        "begin": lambda e: e.query.begin(),
        "end": lambda e: e.query.end(),
        "destroy": lambda e: e.query.destroy(),
        "is_finished": lambda e: e.query.is_finished,
        "visible_samples": lambda e: e.query.visible_samples,
        "wait": lambda e: e.query.wait(),
    },
    "QuerySet": {
        "destroy": lambda e: e.queries.destroy(),
        "is_finished": lambda e: e.queries.is_finished,
        "visible_samples": lambda e: e.queries.visible_samples,
        "wait": lambda e: e.queries.wait(),
    },
    "TransientMemory": {
        "mesh": lambda e: e.device.transient.mesh(e.program, rectangle()),
        "storage": lambda e: e.device.transient.storage(uint, 1),
        "uniform": lambda e: e.device.transient.uniform(Tint(color=(1, 1, 1, 1))),
    },
}
"""Calls of all other members, by class. With validation each is refused on another thread."""

KINDS = {
    kind.__name__: kind
    for kind in (
        Device, rhi.Buffer, rhi.UniformBuffer, rhi.UniformArray, rhi.StorageBuffer, rhi.Texture, rhi.Mesh, rhi.Program,
        rhi.OcclusionQuery, rhi.QuerySet, TransientMemory,
    )
}  # fmt: skip


class Unseen(Numbered):
    """A shader that no test has made a program of."""


@pytest.mark.parametrize("name", EVERY)
def test_every_public_member_is_examined(name: str) -> None:
    kind = KINDS[name]
    members = {member for member in dir(kind) if not member.startswith("_") and not member.isupper()}
    known = {*SAFE[name].split(), *INNER.get(name, "").split(), *EVERY[name]}
    assert members <= known, f"{name}: {sorted(members - known)} in no table"


@pytest.mark.needs("draws", "compute", "occlusion_queries")
@pytest.mark.parametrize("kind", EVERY)
def test_every_member_is_refused_on_another_thread(
    fresh_device: Device, elsewhere: Elsewhere[Any], kind: str
) -> None:
    everything = Everything(fresh_device)
    fresh_device.finish()
    image = fresh_device.texture(SIZE, Format.R8)
    for name, call in EVERY[kind].items():
        in_pass = name.startswith("draw") or (kind, name) in {("OcclusionQuery", "begin"), ("OcclusionQuery", "end")}
        with fresh_device.render_pass(image) if in_pass else nullcontext():
            if name == "end":
                everything.query.begin()
            with refuses(rules.DEVICE_THREAD) as refusal:
                elsewhere(partial(call, everything))
            if name == "end":
                everything.query.end()
        assert "elsewhere_0" in refusal.error.given, name
    check_working(fresh_device)


# -- ends of blocks ---------------------------------------------------------------------------------------------

BLOCKS: dict[str, Callable[[Everything], Any]] = {
    "states": lambda e: e.device.states(CullMode.NONE),
    "event": lambda e: e.device.event("here"),
    "pass": lambda e: e.device.render_pass(e.texture),
    "condition": lambda e: e.device.conditional(e.query),
    "lock": lambda e: e.buffer.lock(Access.WRITE),
    "recording": lambda e: e.device.record(),
}


@pytest.mark.needs("draws", "compute", "occlusion_queries", "conditional_rendering")
@pytest.mark.parametrize("kind", BLOCKS)
def test_a_block_ends_on_the_thread_of_its_begin(
    fresh_device: Device, elsewhere: Elsewhere[Any], kind: str
) -> None:
    """A refused end has no effect: the block is left here afterwards."""
    everything = Everything(fresh_device)
    block = BLOCKS[kind](everything)
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
