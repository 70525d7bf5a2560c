"""Command buffers: recorded commands execute at each submission, with the contents that resources have
then."""

from __future__ import annotations

import gc
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import rhi
from rhi.conformance.compare import assert_near, assert_same
from rhi.conformance.formats import require_samples
from rhi.conformance.shaders import Colored, Tint, Tinted, Weighted
from rhi.conformance.shapes import corners, rectangle
from rhi.shading import Shader, StorageRW, Struct, Uniform, global_id, vec4
from rhi.testing import expect

pytestmark = pytest.mark.recorded_too
draws = pytest.mark.requires("draws")
pixels = pytest.mark.requires("draws", "shading")
compute = pytest.mark.requires("shading", "compute")

SIZE = (8, 8)
COLUMNS = np.concatenate([rectangle(-1 + i / 4, -1, -1 + (i + 1) / 4, 1) for i in range(8)])


class Shift(Struct):
    """A number to add."""

    amount: int


class Add(Shader):
    """Adds a constant to every number."""

    shift: Uniform[Shift]
    numbers: StorageRW[int]

    def compute(self) -> None:
        i = global_id().x
        self.numbers[i] = self.numbers[i] + self.shift.amount


class Double(Shader):
    """Doubles every number."""

    numbers: StorageRW[int]

    def compute(self) -> None:
        i = global_id().x
        self.numbers[i] = 2 * self.numbers[i]


@pytest.fixture
def image(device: rhi.Device) -> Iterator[rhi.Texture]:
    with device.texture(SIZE, rhi.Format.R8) as image:
        yield image


def record(device: rhi.Device, give: Callable[[rhi.CommandBuffer], object]) -> rhi.CommandBuffer:
    """Return a command buffer with the commands that the function `give` records."""
    with device.record() as commands:
        give(commands)
    return commands


def line() -> int:
    """Return the line number of the caller."""
    return sys._getframe(1).f_lineno


# -- passes, copies and clears: on every device ------------------------------------------------------------


def test_nothing_is_done_before_the_submission(device: rhi.Device, image: rhi.Texture) -> None:
    commands = record(device, lambda c: clear(c, image))
    assert_same(image.read(), 0)
    device.submit(commands)
    assert_same(image.read(), 255)


def clear(encoder: rhi.Encoder, image: rhi.Texture, value: float = 1.0) -> None:
    """Record a pass that clears."""
    with encoder.render_pass(image, clear=(value, value, value, value)):
        pass


def test_a_buffer_is_carried_out_as_often_as_it_is_submitted(device: rhi.Device, image: rhi.Texture) -> None:
    commands = record(device, lambda c: clear(c, image))
    for _ in range(3):
        clear(device, image, 0.0)
        device.submit(commands)
        assert_same(image.read(), 255)
        device.present(image)


def test_buffers_are_carried_out_in_the_order_of_submission(device: rhi.Device, image: rhi.Texture) -> None:
    half, full = (
        record(device, lambda c: clear(c, image, 0.2)),
        record(device, lambda c: clear(c, image, 1.0)),
    )
    device.submit(full, half)
    assert_same(image.read(), 51)
    device.submit(half, full)
    assert_same(image.read(), 255)
    device.submit(half)
    device.submit(full)
    device.submit(half)
    assert_same(image.read(), 51)


def test_an_empty_buffer_does_nothing(device: rhi.Device) -> None:
    with device.record() as commands:
        pass
    assert len(commands) == 0
    device.submit(commands)
    device.submit()


def test_clears_copies_and_levels_of_memory_can_be_recorded(device: rhi.Device) -> None:
    numbers = np.arange(8, dtype="u4")
    with (
        device.buffer(numbers) as source,
        device.buffer(8, np.dtype("u4")) as target,
        device.texture((4, 4), rhi.Format.RGBA8, levels=2) as image,
        device.texture((4, 4), rhi.Format.RGBA8) as copy,
    ):
        with device.record() as commands:
            commands.clear(target, 7)
            commands.copy_buffer(source, target, size=8, offset=4, target_offset=16)
            commands.generate_mipmaps(image)
            commands.copy_texture(image, copy, level=1, x=1, y=2)
        image.write(np.full((4, 4, 4), 90, "u1"))
        device.submit(commands)
        assert_same(target.read(), [7, 7, 7, 7, 1, 2, 7, 7])
        assert_same(image.read(1), 90)
        expected = np.zeros((4, 4, 4))
        expected[2:4, 1:3] = 90
        assert_same(copy.read(), expected)
        source.write(numbers[::-1].copy())
        device.submit(commands)
        assert_same(target.read(), [7, 7, 7, 7, 6, 5, 7, 7])


def test_a_clear_without_a_value_is_to_zeros(device: rhi.Device) -> None:
    with device.buffer(np.arange(1, 5, dtype="u4")) as target:
        with device.record() as commands:
            commands.clear(target)
        device.submit(commands)
        assert_same(target.read(), 0)
        target.write(np.arange(1, 5, dtype="u4"))
        target.clear()
        assert_same(target.read(), 0)


def test_samples_can_be_resolved(device: rhi.Device) -> None:
    require_samples(device, 4)
    with (
        device.texture(SIZE, rhi.Format.RGBA8, samples=4) as source,
        device.texture(SIZE, rhi.Format.RGBA8) as target,
    ):
        with device.record() as commands:
            clear(commands, source, 0.4)
            commands.resolve(source, target)
        device.submit(commands)
        assert_same(target.read(), 102)


@pytest.mark.threads
def test_buffers_can_be_recorded_on_several_threads(device: rhi.Device) -> None:
    buffers: dict[int, rhi.CommandBuffer] = {}
    with device.texture(SIZE, rhi.Format.R8, levels=None) as image:

        def work(number: int) -> None:
            with device.record(label=f"thread {number}") as commands:
                for step in range(100):
                    value = (number + 1) / 255 if step == 99 else 0.0
                    with commands.render_pass(image.at(number), clear=(value, 0, 0, 0)):
                        pass
            buffers[number] = commands

        threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        device.submit(*(buffers[number] for number in range(4)))
        assert [int(image.read(level)[0, 0]) for level in range(4)] == [1, 2, 3, 4]


def test_commands_know_the_line_that_recorded_them(recording: rhi.Device) -> None:
    with recording.texture(SIZE, rhi.Format.R8) as image:
        with recording.record(label="sun") as commands:
            expected = line() + 1
            with commands.render_pass(image, clear=(1, 0, 0, 0)), commands.event("map"):
                pass
        since = len(recording.stream)
        recording.submit(commands)
        for stream in (commands.stream, recording.stream[since:]):
            (begin,) = stream.filter(rhi.Op.BEGIN_PASS)
            assert begin.site is not None
            assert (begin.site.file, begin.site.line) == (__file__, expected)
            assert begin.labels == ("sun",)
            assert [command.labels for command in stream.filter(rhi.Op.PUSH_LABEL)] == [(), ("sun",)]


def test_a_buffer_can_be_submitted_inside_of_labels_and_scopes(recording: rhi.Device) -> None:
    with recording.texture(SIZE, rhi.Format.R8) as image:
        commands = record(recording, lambda c: clear(c, image))
        since = len(recording.stream)
        with recording.event("frame"), recording.states(rhi.ColorWrite.OFF):
            recording.submit(commands)
        (begin,) = recording.stream[since:].filter(rhi.Op.BEGIN_PASS)
        assert begin.labels == ("frame",)
        assert_same(image.read(), 255)


# -- draws -------------------------------------------------------------------------------------------------


def scene(
    encoder: rhi.Encoder, device: rhi.Device, image: rhi.Texture, program: Any, mesh: Any, tints: Any
) -> None:
    """Record a pass of eight columns with changing states."""
    with encoder.render_pass(image, clear=(0.5, 0, 0, 1)), encoder.states(rhi.CullMode.NONE):
        for i in range(8):
            with encoder.states(
                rhi.ColorWrite(red=i != 2), rhi.BlendFunction.ADDITIVE if i % 2 else rhi.BlendFunction.OFF
            ):
                encoder.draw(program, mesh.view(6 * i, 6), tint=tints[i])


def draw_plainly(encoder: rhi.Encoder, image: rhi.Texture, program: Any, mesh: Any, tints: Any) -> None:
    """Draw with the default states."""
    with encoder.render_pass(image):
        encoder.draw(program, mesh, tint=tints[0])


def make_scene(device: rhi.Device) -> tuple[Any, ...]:
    """Return a program, a mesh of eight columns, and a tint for each column."""
    tints = device.uniform_array(Tint, 8)
    rows = np.zeros(8, tints.dtype)
    rows["color"][:, 0] = np.arange(8) / 8
    rows["color"][:, 3] = 1
    tints.write(rows)
    return device.program(Tinted), device.mesh(COLUMNS), tints


@pixels
def test_a_recorded_scene_and_a_scene_drawn_at_once_have_equal_images(device: rhi.Device) -> None:
    parts = make_scene(device)
    with (
        device.texture(SIZE, rhi.Format.RGBA16F) as direct,
        device.texture(SIZE, rhi.Format.RGBA16F) as later,
    ):
        scene(device, device, direct, *parts)
        commands = record(device, lambda c: scene(c, device, later, *parts))
        assert_same(later.read(), 0)
        device.submit(commands)
        assert_same(later.read(), direct.read())
        assert len(np.unique(direct.read()[..., 0])) > 5


@draws
def test_the_same_commands_are_issued_as_directly(recording: rhi.Device) -> None:
    program, mesh, tints = make_scene(recording)
    with recording.texture(SIZE, rhi.Format.RGBA8) as image:
        scene(recording, recording, image, program, mesh, tints)  # creates resources on first use
        plain = record(recording, lambda c: draw_plainly(c, image, program, mesh, tints))
        recording.submit(plain)  # leaves the default states
        since = len(recording.stream)
        commands = record(recording, lambda c: scene(c, recording, image, program, mesh, tints))
        recording.submit(commands)
        later = [(command.op, command.values) for command in recording.stream[since:]]
        recording.submit(plain)
        since = len(recording.stream)
        scene(recording, recording, image, program, mesh, tints)
        assert later == [(command.op, command.values) for command in recording.stream[since:]]
        draw = commands.stream.draws()[5]
        assert draw.program == program.id
        assert draw.bindings["tint"][:2] == (tints.buffer.id, tints[5].offset)
        expect(commands.stream).draws(program="Tinted").with_states(rhi.CullMode.NONE).exactly(8)


@pixels
def test_a_recorded_draw_draws_its_part_so_many_times(device: rhi.Device) -> None:
    with (
        device.texture(SIZE, rhi.Format.R16F) as image,
        device.mesh(COLUMNS, np.arange(6, dtype="u2")) as mesh,
        device.mesh(rectangle()[[0, 1, 2, 5]], primitive=rhi.Primitive.QUADS) as quad,
    ):
        program = device.program(Colored)
        with (
            device.record() as commands,
            commands.render_pass(image),
            commands.states(rhi.BlendFunction.ADDITIVE),
        ):
            for column, instances in ((1, 3), (4, 1), (6, 0), (7, 2)):
                commands.draw(program, mesh.view(base_vertex=6 * column), instances)
            commands.draw(program, quad)
        device.submit(commands)
        assert_same(image.read(), np.broadcast_to([1.0, 4, 1, 1, 2, 1, 1, 3], (8, 8)))


@pixels
def test_states_reach_neither_into_a_buffer_nor_out_of_it(device: rhi.Device, mesh: rhi.Mesh) -> None:
    with device.texture(SIZE, rhi.Format.R8) as inside, device.texture(SIZE, rhi.Format.R8) as outside:
        program = device.program(Colored)
        with device.record() as commands:
            with commands.render_pass(inside, clear=(0, 0, 0, 0)):
                commands.draw(program, mesh)
            with commands.render_pass(inside), commands.states(rhi.Scissor(0, 0, 1, 1)):
                commands.draw(program, mesh)
        for _ in range(2):
            with device.states(rhi.Scissor(2, 2, 4, 4)):
                device.submit(commands)
                with device.render_pass(outside, clear=(0, 0, 0, 0)):
                    device.draw(program, mesh)
            assert_same(inside.read(), 255)
            expected = np.zeros((8, 8))
            expected[2:6, 2:6] = 255
            assert_same(outside.read(), expected)


@pixels
def test_a_draw_after_a_submission_binds_its_own(
    device: rhi.Device, image: rhi.Texture, mesh: rhi.Mesh
) -> None:
    parts = [device.uniform(Tint(color=(value, 0, 0, 1))) for value in (0.2, 1.0)]
    program = device.program(Tinted)

    def draw(encoder: rhi.Encoder, tint: Any) -> None:
        with encoder.render_pass(image):
            encoder.draw(program, mesh, tint=tint)

    commands = record(device, lambda c: draw(c, parts[1]))
    draw(device, parts[0])
    device.submit(commands)
    assert_same(image.read(), 255)
    draw(device, parts[0])
    assert_same(image.read(), 51)
    device.submit(commands)
    assert_same(image.read(), 255)


@pixels
def test_data_are_those_at_the_submission(device: rhi.Device, image: rhi.Texture, mesh: rhi.Mesh) -> None:
    with device.uniform(Tint(color=(0, 0, 0, 1))) as tint, device.storage(vec4, 1) as weights:
        with device.record() as commands:
            with commands.render_pass(image, clear=(0, 0, 0, 0)), commands.states(rhi.BlendFunction.ADDITIVE):
                commands.draw(device.program(Tinted), mesh, tint=tint)
                commands.draw(device.program(Weighted), mesh, weights=weights)
        for a, b in ((0.2, 0.4), (0.6, 0.2)):
            tint.write(Tint(color=(a, 0, 0, 1)))
            weights.write(np.array([[b, 0, 0, 0]], "f4"))
            device.submit(commands)
            assert_near(image.read(), round(255 * a) + round(255 * b), 1, "two roundings")


@pixels
def test_transient_constants_of_a_buffer_live_as_long_as_it_does(device: rhi.Device) -> None:
    with device.texture(SIZE, rhi.Format.R32F) as image, device.mesh(COLUMNS) as mesh:
        program = device.program(Tinted)
        with device.record() as commands, commands.render_pass(image, clear=(-1, 0, 0, 0)):
            for i in range(8):
                tint = commands.transient.uniform(Tint(color=(i, 0, 0, 1)))
                commands.draw(program, mesh.view(6 * i, 6), tint=tint)
        for frame in range(4):
            with device.render_pass(image, clear=(9, 0, 0, 0)):  # meanwhile the device's own ring wraps
                for _ in range(64):
                    other = device.transient.uniform(Tint(color=(frame, 0, 0, 1)))
                    device.draw(program, mesh, tint=other)
            device.submit(commands)
            assert_same(image.read(), np.broadcast_to(np.arange(8.0), (8, 8)))
            device.present(image)


@pixels
def test_ad_hoc_geometry_can_be_recorded(device: rhi.Device, image: rhi.Texture) -> None:
    left, right = rectangle(-1, -1, 0, 1), rectangle(0, -1, 1, 1, color=(0.4, 0, 0, 1))
    program = device.program(Colored)
    with device.record() as commands, commands.render_pass(image, clear=(0, 0, 0, 0)):
        with commands.immediate(program, rhi.Primitive.TRIANGLES) as triangles:
            triangles.vertices(left)
        indexed = commands.transient.mesh(program, right[[0, 1, 2, 5]], np.array([0, 1, 2, 0, 2, 3], "u2"))
        commands.draw(program, indexed)
    for _ in range(3):
        device.submit(commands)
        assert_same(image.read(), np.where(np.arange(8) < 4, 255, 102)[None])
        device.present(image)


@pixels
def test_transient_things_of_all_kinds_lie_side_by_side(device: rhi.Device) -> None:
    """The size of each kind of allocation isn't a multiple of the alignment of the other kinds."""
    with device.texture(SIZE, rhi.Format.R32F) as image, device.mesh(COLUMNS) as mesh:
        program, colored = device.program(Tinted), device.program(Colored)
        with device.record() as commands, commands.render_pass(image, clear=(-1, 0, 0, 0)):
            for i in range(0, 8, 2):
                commands.draw_many(
                    program,
                    mesh,
                    mesh.draws(6 * i, 6),
                    tint=commands.transient.uniform(Tint(color=(i, 0, 0, 1))),
                )
                corner = rectangle(-1 + (i + 1) / 4, -1, -1 + (i + 2) / 4, 1, color=(i + 1, 0, 0, 1))[
                    [0, 1, 2, 5]
                ]
                for indices in ([0, 1, 2], [0, 2, 3]):
                    half = commands.transient.mesh(colored, corner, np.array(indices, "u2"))
                    commands.draw(colored, half)
        device.submit(commands)
        assert_same(image.read(), np.broadcast_to(np.arange(8.0), (8, 8)))


@pixels
def test_many_draws_and_indirect_draws_can_be_recorded(device: rhi.Device, image: rhi.Texture) -> None:
    with device.mesh(COLUMNS) as mesh, device.buffer(np.zeros(5, "u4")) as arguments:
        program = device.program(Colored)
        with device.record() as commands, commands.render_pass(image, clear=(0, 0, 0, 0)):
            commands.draw_many(program, mesh, mesh.draws([6, 18], 6))
            commands.draw_indirect(program, mesh, rhi.IndirectDraws(arguments, 1))
        for column in (0, 6):
            arguments.write(np.array([6, 1, 6 * column, 0, 0], "u4"))
            device.submit(commands)
            assert_same(image.read(), np.isin(np.arange(8), (1, 3, column))[None] * 255)


@pytest.mark.threads
@pixels
def test_threads_record_draws_of_the_same_mesh_and_program(device: rhi.Device) -> None:
    buffers: dict[int, rhi.CommandBuffer] = {}
    with device.texture(SIZE, rhi.Format.R16F) as image, device.mesh(COLUMNS) as mesh:
        program, start = device.program(Tinted), threading.Barrier(4)

        def work(number: int) -> None:
            start.wait(10)
            with (
                device.record() as commands,
                commands.render_pass(image),
                commands.states(rhi.BlendFunction.ADDITIVE),
            ):
                for i in (2 * number, 2 * number + 1):
                    tint = commands.transient.uniform(Tint(color=(i + 1, 0, 0, 1)))
                    commands.draw(program, mesh.view(6 * i, 6), tint=tint)
            buffers[number] = commands

        threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        device.submit(*buffers.values())
        assert_same(image.read(), np.broadcast_to(np.arange(1.0, 9.0), (8, 8)))
        device.submit(*buffers.values())
        assert_same(image.read(), np.broadcast_to(2 * np.arange(1.0, 9.0), (8, 8)))
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            # The device can use the vertex arrays that the command buffers created for the mesh.
            device.draw(program, mesh, tint=device.transient.uniform(Tint(color=(3, 0, 0, 1))))
        assert_same(image.read(), 3)


@pixels
@pytest.mark.requires("alpha_test")
def test_the_alpha_test_holds_where_it_was_recorded(device: rhi.Device) -> None:
    faint = (1.0, 1.0, 1.0, 0.25)
    with device.texture(SIZE, rhi.Format.R8) as image, device.mesh(rectangle(color=faint)) as mesh:
        program = device.program(Colored)
        tested = (rhi.AlphaTest.ON, rhi.AlphaFunction.GREATER, rhi.AlphaReference(0.5))
        with device.record() as passing, passing.render_pass(image, clear=(0, 0, 0, 0)):
            passing.draw(program, mesh)
        with (
            device.record() as failing,
            failing.render_pass(image, clear=(0, 0, 0, 0)),
            failing.states(*tested),
        ):
            failing.draw(program, mesh)
        for commands, expected in ((passing, 255), (failing, 0), (passing, 255)):
            device.submit(commands)
            assert_same(image.read(), expected)
        device.submit(failing)
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, mesh)
        assert_same(image.read(), 255)


@draws
def test_draws_are_counted_at_each_submission(device: rhi.Device, image: rhi.Texture, mesh: rhi.Mesh) -> None:
    program = device.program(Colored)
    device.reset_statistics()
    with device.record() as commands, commands.render_pass(image), commands.states(rhi.CullMode.NONE):
        commands.draw(program, mesh)
        commands.draw_many(program, mesh, mesh.draws(0, 3))
    assert device.statistics.draws == 0
    device.submit(commands)
    device.submit(commands)
    statistics = device.statistics
    assert statistics.draws == 4
    assert statistics.software_state_changes == 2


OPAQUE = (rhi.CullMode.NONE, rhi.DepthWrite.OFF)


@pytest.fixture
def record_draws(device: rhi.Device, image: rhi.Texture, mesh: rhi.Mesh) -> Callable[..., rhi.CommandBuffer]:
    """Records a pass with a draw for each tuple of states."""
    program = device.program(Colored)

    def record(*states_of_draws: tuple[Any, ...]) -> rhi.CommandBuffer:
        with device.record() as commands, commands.render_pass(image, clear=(0, 0, 0, 0)):
            for states in states_of_draws:
                with commands.states(*states):
                    commands.draw(program, mesh)
        return commands

    device.submit(record(()))  # from here on, the hardware states are the defaults
    return record


def count_state_changes(device: rhi.Device, *buffers: rhi.CommandBuffer) -> list[int]:
    """Submit command buffers and count the hardware state changes of each."""
    counts = []
    for buffer in buffers:
        before = device.statistics.hardware_state_changes
        device.submit(buffer)
        counts.append(device.statistics.hardware_state_changes - before)
    return counts


@draws
def test_a_submission_that_ends_with_the_states_it_begins_with_changes_none_when_it_comes_again(
    device: rhi.Device, record_draws: Callable[..., rhi.CommandBuffer]
) -> None:
    opaque = record_draws(OPAQUE, OPAQUE)
    assert count_state_changes(device, opaque, opaque, opaque) == [2, 0, 0]


@draws
def test_a_submission_without_draws_changes_no_states(
    device: rhi.Device, record_draws: Callable[..., rhi.CommandBuffer]
) -> None:
    opaque, empty = record_draws(OPAQUE, OPAQUE), record_draws()
    assert count_state_changes(device, opaque, empty, opaque) == [2, 0, 0]


@draws
def test_a_submission_changes_only_the_states_that_differ_from_those_before_it(
    device: rhi.Device, record_draws: Callable[..., rhi.CommandBuffer]
) -> None:
    opaque, front = record_draws(OPAQUE, OPAQUE), record_draws((rhi.CullMode.FRONT, rhi.DepthWrite.OFF))
    plain = record_draws(())
    assert count_state_changes(device, plain, plain, opaque) == [0, 0, 2]
    assert count_state_changes(device, front, front, opaque) == [1, 0, 1]


@draws
def test_a_submission_whose_first_draw_needs_other_states_than_its_last_changes_them_twice(
    device: rhi.Device, record_draws: Callable[..., rhi.CommandBuffer]
) -> None:
    opaque, mixed, plain = record_draws(OPAQUE), record_draws((), OPAQUE), record_draws(())
    assert count_state_changes(device, opaque, mixed, mixed, plain) == [2, 4, 4, 2]


@draws
def test_a_draw_after_a_submission_changes_no_state_that_the_submission_left(
    device: rhi.Device, image: rhi.Texture, mesh: rhi.Mesh, record_draws: Callable[..., rhi.CommandBuffer]
) -> None:
    device.submit(record_draws(OPAQUE, OPAQUE))
    with device.render_pass(image), device.states(*OPAQUE):
        before = device.statistics.hardware_state_changes
        device.draw(device.program(Colored), mesh)
    assert device.statistics.hardware_state_changes == before


# -- queries -----------------------------------------------------------------------------------------------


@pixels
@pytest.mark.requires("occlusion_queries")
def test_a_recorded_query_answers_for_the_latest_submission(device: rhi.Device) -> None:
    query = device.occlusion_query()
    with (
        device.texture(SIZE, rhi.Format.R8) as image,
        device.mesh(COLUMNS) as mesh,
        device.buffer(5, np.dtype("u4")) as arguments,
    ):
        program = device.program(Colored)
        with device.record() as commands, commands.render_pass(image), commands.query(query):
            commands.draw_indirect(program, mesh, rhi.IndirectDraws(arguments, 1))
        assert not query.is_finished
        for count in (6, 18, 0):
            arguments.write(np.array([count, 1, 0, 0, 0], "u4"))
            device.submit(commands)
            assert query.wait() == 64 * count // 48
    query.destroy()


@pixels
@pytest.mark.requires("sample_counter")
def test_a_recorded_query_may_be_emulated(device: rhi.Device) -> None:
    query = device.occlusion_query(emulated=True)
    with device.texture(SIZE, rhi.Format.R8) as image, device.mesh(COLUMNS) as mesh:
        program = device.program(Colored)
        with device.record() as commands, commands.render_pass(image):
            with commands.query(query):
                commands.draw(program, mesh.view(0, 12))
            commands.draw(program, mesh)
        for _ in range(2):
            device.submit(commands)
            assert query.wait() == 16
    query.destroy()


@pixels
@pytest.mark.requires("occlusion_queries", "conditional_rendering")
def test_a_recorded_condition_asks_its_query_anew(device: rhi.Device) -> None:
    query = device.occlusion_query()
    with (
        device.texture(SIZE, rhi.Format.R8) as first,
        device.texture(SIZE, rhi.Format.R8) as second,
        device.mesh(rectangle()) as mesh,
        device.buffer(5, np.dtype("u4")) as arguments,
    ):
        program = device.program(Colored)
        with device.record() as commands:
            with commands.render_pass(first), commands.query(query):
                commands.draw_indirect(program, mesh, rhi.IndirectDraws(arguments, 1))
            with commands.render_pass(second, clear=(0, 0, 0, 0)), commands.conditional(query):
                commands.draw(program, mesh)
        for count, expected in ((0, 0), (6, 255), (0, 0)):
            arguments.write(np.array([count, 1, 0, 0, 0], "u4"))
            device.submit(commands)
            assert_same(second.read(), expected)
    query.destroy()


# -- compute -----------------------------------------------------------------------------------------------


@compute
def test_dispatches_can_be_recorded(device: rhi.Device) -> None:
    numbers = np.arange(4, dtype=np.int32)
    with device.storage(int, numbers) as rows, device.buffer(np.array([4, 1, 1], "u4")) as groups:
        with device.record() as commands:
            commands.dispatch(
                device.program(Add), 4, shift=commands.transient.uniform(Shift(amount=3)), numbers=rows
            )
            commands.dispatch(device.program(Double), 4, numbers=rows)
            commands.dispatch_indirect(device.program(Double), groups, 0, numbers=rows)
        assert_same(rows.read(), numbers)
        device.submit(commands)
        assert_same(rows.read(), 4 * (numbers + 3))
        groups.write(np.array([1, 1, 1], "u4"))
        device.submit(commands)
        again = 2 * (4 * (numbers + 3) + 3)
        assert_same(rows.read(), np.where(numbers < 1, 2 * again, again))
        assert device.statistics.dispatches >= 6


@compute
def test_a_dispatch_after_a_submission_binds_its_own(device: rhi.Device) -> None:
    with (
        device.storage(int, 4) as mine,
        device.storage(int, 4) as others,
        device.uniform(Shift(amount=2)) as shift,
    ):
        add, double = device.program(Add), device.program(Double)
        with device.record() as commands:
            commands.dispatch(add, 4, shift=shift, numbers=others)
            commands.dispatch(double, 4, numbers=others)
        device.dispatch(add, 4, shift=shift, numbers=mine)
        device.submit(commands)
        device.dispatch(add, 4, shift=shift, numbers=mine)
        assert_same(mine.read(), 4)
        assert_same(others.read(), 4)


@compute
def test_a_clear_stays_in_order_among_dispatches(device: rhi.Device) -> None:
    with device.storage(int, 4) as rows, device.uniform(Shift(amount=5)) as shift:
        with device.record() as commands:
            commands.dispatch(device.program(Add), 4, shift=shift, numbers=rows)
            commands.clear(rows, 1)
            commands.dispatch(device.program(Add), 4, shift=shift, numbers=rows)
        device.submit(commands, commands)
        assert_same(rows.read(), 6)
        shift.write(Shift(amount=8))
        device.submit(commands)
        assert_same(rows.read(), 9)


# -- lifetime ----------------------------------------------------------------------------------------------


@draws
def test_a_buffer_gives_back_its_memory_with_the_last_reference(recording: rhi.Device) -> None:
    with recording.texture(SIZE, rhi.Format.R8) as image:
        program = recording.program(Colored)
        with recording.record() as commands, commands.render_pass(image):
            with commands.immediate(program, rhi.Primitive.TRIANGLES) as triangles:
                triangles.vertices(corners([(-1, -1), (1, -1), (0, 1)]))
        since = len(recording.stream)
        recording.submit(commands)
        created = {
            command.values[0]
            for command in recording.stream[since:].filter([rhi.Op.CREATE_BUFFER, rhi.Op.CREATE_VERTEX_ARRAY])
        }
        assert len(created) == 2
        del commands
        gc.collect()
        recording.finish()
        gone = {command.values[0] for command in recording.stream[since:].filter(rhi.Op.DESTROY)}
        assert created <= gone


def test_memory_that_is_streamed_can_be_used(device: rhi.Device) -> None:
    data = np.arange(4, dtype="u4")
    with (
        device.buffer(4, data.dtype, usage=rhi.BufferUsage.STREAM) as source,
        device.buffer(4, data.dtype) as target,
    ):
        commands = record(device, lambda c: c.copy_buffer(source, target))
        for step in range(3):
            source.write(data + step)
            device.submit(commands)
            device.finish()
            assert_same(target.read(), data + step)
