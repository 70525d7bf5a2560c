"""Hazards: found at all latencies, with both calls, and without false positives."""

from __future__ import annotations

import inspect
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from null_kit import Camera, Object, hand_made_program, make_kit
from simulated_kit import PLAIN, STATIC, STREAM, draw, make_backend, words

import rhi
from rhi import Access, BufferUsage
from rhi.backends.null import Faults, HazardKind, SimulatedBackend, Simulation
from rhi.backends.null.simulation.streams import StreamMemory
from rhi.contract import descriptors
from rhi.contract.formats import Format, IndexFormat
from rhi.contract.states import ColorWrite, DepthWrite, StateChange, StencilTest
from rhi.device.core.ring import Ring
from rhi.device.core.timeline import Timeline
from rhi.errors import ValidationError

PROGRAM, TEXTURE, SAMPLER, VERTICES = 300, 301, 302, 303
LAYERS = descriptors.Region(0, 0, 1, 2, 0, 3)
KINDS = HazardKind


def kinds(backend):
    return [hazard.kind for hazard in backend.hazards]


@pytest.fixture
def backend():
    return make_backend()


def with_program(backend, *bindings):
    backend.create_program(PROGRAM, hand_made_program("p", *bindings))
    backend.bind_program(PROGRAM)
    return backend


def uniform_backend(**times):
    """A backend whose draws read a uniform range of STREAM."""
    return with_program(
        make_backend(**times), descriptors.Binding("camera", descriptors.BindingKind.UNIFORM, 0)
    )


def finish(backend, value=1):
    backend.signal(value)
    backend.wait(value, 1.0)


# -- memory --------------------------------------------------------------------------------------------------


def test_hazards_distinguish_rewrites_in_place_from_reuse_by_a_ring():
    backend = uniform_backend()
    backend.write_buffer(STREAM, 0, bytes(16))
    backend.bind_uniform(0, STREAM, 0, 16)
    draw(backend)
    backend.write_buffer(STREAM, 0, bytes(16))
    backend.write_buffer(STREAM, 16, bytes(16))
    backend.write_buffer(STREAM, 8, bytes(4))
    assert kinds(backend) == [KINDS.WRITE_IN_USE, KINDS.RING_OVERTAKEN]


@pytest.mark.parametrize(
    ("earlier", "begin"),
    [
        ([], 0),  # the one and only write
        ([(16, 16)], 0),  # another part was written
        ([(16, 16), (32, 8)], 0),
        ([(0, 4), (12, 16)], 4),  # between two parts
        ([(0, 16)], 0),  # in place
    ],
)
def test_a_first_write_of_memory_in_use_overtakes_no_ring(earlier, begin):
    backend = uniform_backend()
    for offset, size in earlier:
        backend.write_buffer(STREAM, offset, bytes(size))
    backend.bind_uniform(0, STREAM, 0, 16)
    draw(backend)
    backend.write_buffer(STREAM, begin, bytes(8))
    assert kinds(backend) == [KINDS.WRITE_IN_USE]


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(1, 12)), max_size=30))
def test_a_ring_is_overtaken_where_a_set_of_written_bytes_says_so(writes):
    memory, written, latest = StreamMemory(64), set(), set()
    for begin, size in writes:
        part = set(range(begin, begin + size))
        assert memory.write(begin, begin + size) == (bool(part & written) and not part & latest)
        written |= part
        latest = part


def test_both_calls_are_named_by_their_lines():
    backend = uniform_backend()
    backend.bind_uniform(0, STREAM, 0, 16)
    line = inspect.currentframe().f_lineno
    backend.draw(PLAIN, descriptors.Primitive.TRIANGLES, 0, 3, 1, 0, 0)
    backend.write_buffer(STREAM, 0, bytes(4))
    (hazard,) = backend.hazards
    assert (hazard.first.line, hazard.second.line) == (line + 1, line + 2)
    assert hazard.first.file == hazard.second.file == __file__
    assert hazard.calls == ("draw", "write_buffer")
    assert f"draw             {__file__}:{line + 1}" in str(hazard)
    assert str(hazard).startswith(f"{hazard.kind.value} (resource {STREAM}, bytes 0 to 4)")


def test_a_program_that_is_only_lucky_has_a_hazard_that_did_not_happen():
    for spent, happened in ((0, True), (100_000, False)):
        backend = uniform_backend()
        backend.bind_uniform(0, STREAM, 0, 16)
        draw(backend)
        backend.signal(1)
        backend.spend(spent)  # and nobody asks whether the GPU is done
        backend.write_buffer(STREAM, 0, bytes(4))
        assert [hazard.happened for hazard in backend.hazards] == [happened]


@pytest.mark.parametrize("read", [(STATIC, 0, 4), (STREAM, 0, 16)])
def test_a_read_that_waits_frees_everything_before_it(read):
    """One of the memory itself is a use, too, and is over when the call returns."""
    backend = uniform_backend()
    backend.bind_uniform(0, STREAM, 0, 16)
    draw(backend)
    backend.read_buffer(*read)
    backend.write_buffer(STREAM, 0, bytes(4))
    assert not backend.hazards


@pytest.mark.parametrize(("begin", "size"), [(0, 20), (20, 4), (28, 20), (16, 16), (0, 64)])
def test_a_read_that_overlaps_a_pending_write_by_a_byte_is_a_hazard(backend, begin, size):
    backend.create_buffer(900, descriptors.BufferDescriptor(64, BufferUsage.READBACK))
    backend.copy_buffer(STATIC, 0, 900, 16, 16)
    backend.read_buffer(900, 0, 16)
    backend.read_buffer(900, 32, 32)
    assert not backend.hazards
    backend.read_buffer(900, begin, size)
    (hazard,) = backend.hazards
    assert hazard.kind is KINDS.READ_IN_USE
    assert hazard.bytes == (max(begin, 16), min(begin + size, 32))


def test_a_query_result_proves_that_earlier_commands_have_finished():
    backend = uniform_backend()
    backend.create_query(1, descriptors.QueryKind.TIMESTAMP)
    backend.bind_uniform(0, STREAM, 0, 16)
    draw(backend)
    backend.write_query(1)
    while backend.read_query(1) is None:
        pass
    backend.write_buffer(STREAM, 0, bytes(4))
    assert not backend.hazards


def test_slots_that_the_program_does_not_read_are_in_nobodys_use():
    backend = uniform_backend()
    backend.bind_uniform(1, STREAM, 0, 16)
    backend.bind_storage(0, STREAM, 0, 16)
    draw(backend)
    backend.write_buffer(STREAM, 0, bytes(4))
    assert not backend.hazards


@pytest.mark.parametrize(
    "use",
    [
        lambda b: b.copy_buffer(STREAM, 16, STATIC, 0, 16),
        lambda b: b.copy_buffer(STATIC, 0, STREAM, 16, 16),
        lambda b: b.clear_buffer(STREAM, 16, 16, 0),
        lambda b: b.dispatch_indirect(STREAM, 20),
        lambda b: b.draw_indirect(PLAIN, descriptors.Primitive.TRIANGLES, STREAM, 12, 1, 20, 0, 0),
        lambda b: b.draw_indirect(PLAIN, descriptors.Primitive.TRIANGLES, STATIC, 0, 1, 20, STREAM, 28),
    ],
)
def test_every_command_that_touches_memory_counts(use):
    for begin, hazard_count in ((0, 0), (28, 1), (32, 0)):
        backend = make_backend()
        use(backend)
        backend.write_buffer(STREAM, begin, bytes(4))
        assert len(backend.hazards) == hazard_count


@pytest.mark.parametrize(
    ("use", "expected"),
    [
        (
            lambda b: b.draw_indirect(PLAIN, descriptors.Primitive.TRIANGLES, STREAM, 20, 2, 40, 0, 0),
            [*range(20, 40), *range(60, 80)],
        ),
        (lambda b: b.copy_texture_to_buffer(TEXTURE, 0, LAYERS, STREAM, 16, 4), [*range(16, 40)]),
        (lambda b: b.copy_buffer_to_texture(STREAM, 16, 4, TEXTURE, 0, LAYERS), [*range(16, 40)]),
    ],
    ids=["arguments of two draws", "from layers", "to layers"],
)
def test_all_rows_of_a_command_count(backend, use, expected):
    backend.create_texture(
        TEXTURE,
        descriptors.TextureDescriptor((1, 2), Format.RGBA8, descriptors.TextureKind.D2_ARRAY, layers=3),
    )
    use(backend)
    assert found_bytes(backend) == expected


def test_ordered_writes_are_no_hazard():
    backend = with_program(make_backend(), descriptors.Binding("camera", descriptors.BindingKind.UNIFORM, 0))
    backend.bind_uniform(0, STATIC, 0, 16)
    draw(backend)
    backend.write_buffer(STATIC, 0, bytes(16))
    assert not backend.hazards


def test_many_uses_close_together_are_all_remembered():
    backend = uniform_backend()
    for byte in range(200):
        backend.bind_uniform(0, STREAM, byte, 1)
        draw(backend)
    assert found_bytes(backend) == list(range(200))


# -- vertices ------------------------------------------------------------------------------------------------


def vertex_backend(index_buffer=0, per_instance=False):
    backend = make_backend()
    stream = descriptors.VertexStream(STREAM, 8, 10, per_instance, ())
    array = descriptors.VertexArrayDescriptor(1, (stream,), index_buffer, IndexFormat.UINT16)
    backend.create_vertex_array(VERTICES, array)
    return backend


def found_bytes(backend):
    """Return the bytes of STREAM that are in use, by writing each."""
    conflicting = []
    for byte in range(256):
        before = len(backend.hazards)
        backend.write_buffer(STREAM, byte, b"x")
        conflicting += [byte] * (len(backend.hazards) > before)
    return conflicting


def test_a_draw_reads_the_vertices_it_names():
    backend = vertex_backend()
    backend.draw(VERTICES, descriptors.Primitive.TRIANGLES, 3, 6, 1, 0, 0)
    assert found_bytes(backend) == list(range(38, 98))


def test_a_draw_reads_the_instances_it_names():
    backend = vertex_backend(per_instance=True)
    backend.draw(VERTICES, descriptors.Primitive.TRIANGLES, 0, 3, 2, 0, 5)
    assert found_bytes(backend) == list(range(58, 78))


@pytest.mark.parametrize(("count", "instances"), [(0, 1), (3, 0)])
def test_a_draw_of_nothing_reads_nothing(count, instances):
    backend = vertex_backend()
    backend.draw(VERTICES, descriptors.Primitive.TRIANGLES, 0, count, instances, 0, 0)
    assert found_bytes(backend) == []


def indices(*values):
    return np.array(values, np.uint16).tobytes()


@pytest.mark.parametrize(
    ("primitive", "last"),
    [(descriptors.Primitive.TRIANGLES, 256), (descriptors.Primitive.TRIANGLE_STRIP, 88)],
)
def test_an_indexed_draw_reads_the_vertices_its_indices_name(primitive, last):
    """The largest index restarts only strips."""
    backend = vertex_backend(index_buffer=STATIC)
    backend.write_buffer(STATIC, 4, indices(3, 5, 4, 0xFFFF))
    backend.draw(VERTICES, primitive, 2, 4, 1, 2, 0)
    backend.signal(1)
    backend.spend(1_000_000)
    assert found_bytes(backend) == list(range(58, last))


def test_a_write_before_the_indices_are_read_is_a_hazard_once_they_are_read():
    backend = vertex_backend(index_buffer=STATIC)
    backend.write_buffer(STATIC, 0, indices(3, 4, 5))
    backend.draw(VERTICES, descriptors.Primitive.TRIANGLES, 0, 3, 1, 0, 0)
    backend.write_buffer(STREAM, 0, bytes(38))
    line = inspect.currentframe().f_lineno
    backend.write_buffer(STREAM, 60, bytes(2))
    backend.write_buffer(STREAM, 68, bytes(38))
    assert not backend.hazards
    finish(backend)
    (hazard,) = backend.hazards
    assert hazard.second.line == line + 1
    assert hazard.happened


def test_a_suspect_counts_only_for_the_buffer_it_was_written_to(backend):
    backend.create_buffer(7, descriptors.BufferDescriptor(256, BufferUsage.STREAM))
    streams = tuple(
        descriptors.VertexStream(buffer, offset, 8, False, ()) for buffer, offset in ((STREAM, 0), (7, 128))
    )
    backend.create_vertex_array(
        VERTICES, descriptors.VertexArrayDescriptor(1, streams, STATIC, IndexFormat.UINT16)
    )
    backend.draw(VERTICES, descriptors.Primitive.TRIANGLES, 0, 3, 1, 0, 0)
    backend.write_buffer(7, 0, bytes(8))  # where STREAM is read
    backend.write_buffer(7, 128, bytes(8))
    finish(backend)
    assert [(hazard.resource, hazard.bytes) for hazard in backend.hazards] == [(7, (128, 136))]


def test_indices_and_vertices_in_the_ring_are_tracked_at_once():
    backend = vertex_backend(index_buffer=STREAM)
    backend.write_buffer(STREAM, 200, indices(3, 4))
    backend.draw(VERTICES, descriptors.Primitive.LINES, 100, 2, 1, 0, 0)
    assert found_bytes(backend) == [*range(38, 58), *range(200, 204)]


@pytest.mark.parametrize(
    ("index_buffer", "first", "expected"),
    [(0, 4, [*range(48, 68)]), (STREAM, 100, [*range(38, 58), *range(200, 204)])],
)
def test_an_indirect_draw_reads_the_indices_and_vertices_that_its_arguments_name(
    index_buffer, first, expected
):
    backend = vertex_backend(index_buffer=index_buffer)
    backend.write_buffer(STREAM, 200, indices(3, 4))
    backend.write_buffer(STATIC, 0, words(2, 1, first, 0, 0))
    backend.draw_indirect(VERTICES, descriptors.Primitive.LINES, STATIC, 0, 1, 20, 0, 0)
    backend.signal(1)
    backend.spend(1_000_000)
    assert found_bytes(backend) == expected


def test_indirect_draws_read_the_indices_of_each_that_has_any():
    """Also while the indices that they name aren't known: a write meanwhile is found when they are."""
    backend = vertex_backend(index_buffer=STREAM)
    backend.write_buffer(STREAM, 200, indices(3, 4, 9, 9, 7))
    backend.write_buffer(STATIC, 0, words(2, 1, 100, 0, 0, 0, 1, 102, 0, 0, 1, 1, 104, 1, 0))
    backend.draw_indirect(VERTICES, descriptors.Primitive.POINTS, STATIC, 0, 3, 20, 0, 0)
    for byte in (199, 200, 203, 204, 207, 208, 209, 210, 37, 38, 57, 58, 87, 88, 97, 98):
        backend.write_buffer(STREAM, byte, bytes(indices(3, 4, 9, 9, 7)[byte - 200 : byte - 199]) or b"x")
    assert not backend.hazards
    finish(backend)
    assert {hazard.bytes[0] for hazard in backend.hazards} == {200, 203, 208, 209, 38, 57, 88, 97}
    assert all(hazard.happened for hazard in backend.hazards)
    assert found_bytes(backend) == []


@pytest.mark.parametrize(("count", "instances"), [(0, 1), (2, 0)])
def test_an_indirect_draw_of_nothing_reads_nothing(count, instances):
    backend = vertex_backend(index_buffer=STREAM)
    backend.write_buffer(STATIC, 0, words(count, instances, 100, 0, 0))
    backend.draw_indirect(VERTICES, descriptors.Primitive.LINES, STATIC, 0, 1, 20, 0, 0)
    backend.signal(1)
    backend.spend(1_000_000)
    backend.write_buffer(STREAM, 0, bytes(256))
    assert not backend.hazards


# -- queries and resources -----------------------------------------------------------------------------------


def test_a_query_that_is_open_or_never_begun_is_not_to_be_read(backend):
    backend.create_query(1, descriptors.QueryKind.OCCLUSION)
    assert backend.read_query(1) is None
    backend.begin_query(1)
    assert backend.read_query(1) is None
    assert kinds(backend) == [KINDS.QUERY_UNFINISHED] * 2
    assert [hazard.calls for hazard in backend.hazards] == [("", "read_query"), ("begin_query", "read_query")]
    assert backend.hazards[0].first is None
    backend.end_query(1)
    assert backend.read_query(1) is None  # asked in vain, but it will come
    assert len(backend.hazards) == 2


def test_a_query_whose_answer_is_there_can_be_destroyed():
    for asks in (False, True):
        backend = make_backend()
        backend.create_query(1, descriptors.QueryKind.OCCLUSION)
        backend.begin_query(1)
        backend.end_query(1)
        backend.signal(1)
        backend.spend(1_000_000)
        assert not asks or backend.read_query(1) is not None
        backend.destroy(1)
        assert kinds(backend) == [KINDS.DESTROYED_IN_USE] * (not asks)


def test_destroying_a_buffer_that_the_gpu_may_still_use_is_a_hazard():
    for waits in (False, True):
        backend = uniform_backend()
        backend.create_buffer(7, descriptors.BufferDescriptor(64))
        backend.bind_uniform(0, 7, 0, 16)
        draw(backend)
        if waits:
            finish(backend)
        backend.destroy(7)
        assert kinds(backend) == [KINDS.DESTROYED_IN_USE] * (not waits)


def test_writing_to_a_destroyed_buffer_is_a_hazard(backend):
    backend.destroy(STREAM)
    backend.write_buffer(STREAM, 0, bytes(16))
    (hazard,) = backend.hazards
    assert (hazard.kind, hazard.calls) == (KINDS.USED_DESTROYED, ("destroy", "write_buffer"))
    assert hazard.happened


def test_memory_that_only_the_cpu_has_touched_is_in_nobodys_use(backend):
    draw(backend)
    backend.write_buffer(STREAM, 0, bytes(16))
    backend.destroy(STREAM)
    assert not backend.hazards


@pytest.mark.parametrize("resource", [PROGRAM, PLAIN, STATIC, TEXTURE])
def test_all_that_a_draw_uses_is_in_use(resource):
    backend = with_program(make_backend(), descriptors.Binding("t", descriptors.BindingKind.TEXTURE, 0))
    backend.create_texture(TEXTURE, descriptors.TextureDescriptor((4, 4), Format.RGBA8))
    backend.bind_texture(0, TEXTURE, SAMPLER)
    draw(backend)
    backend.destroy(resource)
    assert [(h.kind, h.resource) for h in backend.hazards] == [(KINDS.DESTROYED_IN_USE, resource)]


def test_a_target_is_in_use_until_its_pass_has_ended(backend):
    backend.create_texture(TEXTURE, descriptors.TextureDescriptor((4, 4), Format.RGBA8))
    backend.begin_pass(descriptors.PassDescriptor((4, 4), (descriptors.Attachment(TEXTURE),)))
    finish(backend)
    backend.end_pass()
    backend.destroy(TEXTURE)
    assert [hazard.calls for hazard in backend.hazards] == [("end_pass", "destroy")]


def test_drawing_with_a_destroyed_buffer_is_a_hazard():
    backend = uniform_backend()
    backend.create_buffer(7, descriptors.BufferDescriptor(64))
    backend.bind_uniform(0, 7, 0, 16)
    backend.destroy(7)
    assert not backend.hazards
    draw(backend)
    assert [(h.kind, h.resource, h.calls) for h in backend.hazards] == [
        (KINDS.USED_DESTROYED, 7, ("destroy", "draw"))
    ]


def test_indices_that_were_destroyed_are_one_hazard_and_no_crash():
    backend = vertex_backend(index_buffer=STATIC)
    backend.destroy(STATIC)
    backend.draw(VERTICES, descriptors.Primitive.TRIANGLES, 0, 3, 1, 0, 0)
    finish(backend)
    assert kinds(backend) == [KINDS.USED_DESTROYED]


def test_hazards_can_be_asked_for_after_the_device_is_closed():
    backend = uniform_backend()
    backend.create_buffer(7, descriptors.BufferDescriptor(64))
    backend.bind_uniform(0, 7, 0, 16)
    draw(backend)
    backend.destroy(7)
    backend.close()
    assert kinds(backend) == [KINDS.DESTROYED_IN_USE]
    assert backend.timeline.end == backend.now > 0


# -- passes --------------------------------------------------------------------------------------------------


def feedback(descriptor, changes=(), image=None, form=Format.RGBA8):
    kind = descriptors.BindingKind.TEXTURE if image is None else descriptors.BindingKind.IMAGE
    backend = with_program(make_backend(), descriptors.Binding("t", kind, 0))
    backend.create_texture(TEXTURE, descriptors.TextureDescriptor((4, 4), form, layers=2, levels=2))
    backend.create_sampler(SAMPLER, descriptors.SamplerDescriptor())
    if image is None:
        backend.bind_texture(0, TEXTURE, SAMPLER)
    else:
        backend.bind_image(0, TEXTURE, *image)
    backend.set_states([StateChange(*change) for change in changes])
    backend.begin_pass(descriptor)
    draw(backend)
    return kinds(backend)


COLOR = descriptors.PassDescriptor((2, 2), (descriptors.Attachment(TEXTURE, 1, 1),))
DEPTH = descriptors.PassDescriptor((4, 4), (), descriptors.DepthAttachment(TEXTURE))
CLEARED = descriptors.PassDescriptor((2, 2), (descriptors.Attachment(TEXTURE, 1, 1, clear=(0, 0, 0, 0)),))
NO_COLOR = (ColorWrite, (ColorWrite.OFF,) * 8)


@pytest.mark.parametrize(
    ("descriptor", "changes", "image", "has_feedback"),
    [
        (COLOR, [], None, True),
        (COLOR, [NO_COLOR], None, False),
        (CLEARED, [NO_COLOR], None, True),
        (COLOR, [], (1, 1), True),
        (COLOR, [], (1, -1), True),
        (COLOR, [], (1, 0), False),
        (COLOR, [], (0, 1), False),
        (DEPTH, [], None, True),
        (DEPTH, [(DepthWrite, DepthWrite.OFF)], None, False),
        (descriptors.PassDescriptor((4, 4), (descriptors.Attachment(99),)), [], None, False),
    ],
)
def test_a_pass_that_reads_its_own_target_is_a_hazard(descriptor, changes, image, has_feedback):
    assert feedback(descriptor, changes, image) == [KINDS.PASS_FEEDBACK] * has_feedback


@pytest.mark.parametrize(("form", "has_feedback"), [(Format.D24S8, True), (Format.D24, False)])
def test_a_stencil_test_writes_only_a_target_that_has_stencil(form, has_feedback):
    changes = [(DepthWrite, DepthWrite.OFF), (StencilTest, StencilTest.ON)]
    assert feedback(DEPTH, changes, form=form) == [KINDS.PASS_FEEDBACK] * has_feedback


# -- any program, any latency --------------------------------------------------------------------------------


@dataclass
class Model:
    """Finds hazards by brute force: a list of all uses, and how far the CPU knows the GPU to be."""

    uses: list[tuple[int, int, int]]
    fences: dict[int, int]
    reached: int = 0
    calls: int = 0


ACTIONS = st.lists(
    st.one_of(
        st.tuples(st.just("write"), st.integers(0, 255), st.integers(1, 80)),
        st.tuples(st.just("draw"), st.integers(0, 255), st.integers(1, 80)),
        st.tuples(st.just("signal"), st.just(0), st.just(0)),
        st.tuples(st.just("ask"), st.just(0), st.just(0)),
        st.tuples(st.just("wait"), st.integers(0, 5), st.just(0)),
        st.tuples(st.just("read"), st.just(0), st.just(0)),
        st.tuples(st.just("spend"), st.integers(0, 5000), st.just(0)),
    ),
    max_size=60,
)


USED, ASKED = ("draw", 0, 16), [("ask", 0, 0), ("write", 0, 4)]


@settings(max_examples=150)
@example([USED, ("signal", 0, 0), ("wait", 0, 0), ("write", 0, 4)], 100, 20, 1000)
@example([("signal", 0, 0), USED, ("wait", 0, 0), ("write", 0, 4)], 100, 20, 1000)  # a fence before the use
@example(
    [USED, ("signal", 0, 0), *ASKED, ("spend", 5000, 0), *ASKED], 100, 20, 1000
)  # one that isn't reached, first
@given(ACTIONS, st.integers(0, 20_000), st.integers(1, 20), st.integers(0, 3000))
def test_no_hazard_escapes_and_none_is_invented(actions, latency, batch, pixels):
    backend = uniform_backend(submission_latency=latency, batch=batch)
    backend.count_samples(lambda draw: pixels)
    model = Model([], {})
    value, expected = 0, []
    for what, number, size in actions:
        end = min(256, number + size)
        if what == "write":
            met = [u for u in model.uses if u[0] > model.reached and u[1] < end and number < u[2]]
            expected.append(bool(met))
            before = len(backend.hazards)
            backend.write_buffer(STREAM, number, bytes(end - number))
            hazards = backend.hazards[before:]
            assert [bool(hazards)] == [bool(met)]
            if met:
                latest = max(met)
                assert hazards[0].bytes == (max(number, latest[1]), min(end, latest[2]))
        elif what == "draw":
            backend.bind_uniform(0, STREAM, number, end - number)
            draw(backend)
            model.calls += 2
            model.uses.append((model.calls, number, end))
        elif what == "signal":
            value += 1
            model.calls += 1
            model.fences[value] = model.calls
            backend.signal(value)
        elif what == "ask":
            model.reached = max(model.reached, model.fences.get(backend.completed(), 0))
        elif what == "wait":
            asked = max(0, value - number)
            assert backend.wait(asked, 1.0)
            model.reached = max(model.reached, model.fences.get(asked, 0))
        elif what == "read":
            backend.read_buffer(STATIC, 0, 4)
            model.calls += 1
            model.reached = model.calls
        else:
            backend.spend(number)
    assert len(backend.hazards) == sum(expected)


@settings(max_examples=60)
@example([("signal", 0, 0), ("draw", 0, 1), ("wait", 0, 0), ("signal", 0, 0), ("write", 0, 1)], 0, 0)
@given(ACTIONS, st.integers(0, 20_000), st.integers(0, 3000))
def test_every_reported_hazard_happens_on_a_gpu_that_is_slow_enough(actions, latency, pixels):
    """Run the same program again on a GPU that is never done before the CPU waits for it."""

    def run(latency, pixels):
        backend = uniform_backend(submission_latency=latency)
        backend.count_samples(lambda draw: pixels)
        value = 0
        for what, number, size in actions:
            end = min(256, number + size)
            if what == "write":
                backend.write_buffer(STREAM, number, bytes(end - number))
            elif what == "draw":
                backend.bind_uniform(0, STREAM, number, end - number)
                draw(backend)
            elif what == "signal":
                backend.signal(value := value + 1)
            elif what == "wait":
                backend.wait(max(0, value - number), 1000.0)
            elif what == "spend":
                backend.spend(number)
        return backend.hazards

    # Slow to start, and slow at each draw: one that takes no time is over before the CPU wakes from a wait.
    here, slow = run(latency, pixels), run(10**8, 10**9)
    assert [(h.kind, h.bytes) for h in here] == [(h.kind, h.bytes) for h in slow]
    assert all(h.happened for h in slow)


@settings(max_examples=60)
@given(
    st.lists(
        st.one_of(
            st.tuples(st.just("write"), st.integers(1, 300), st.sampled_from([1, 4, 12, 256])),
            st.tuples(st.just("frame"), st.integers(0, 20_000), st.just(0)),
        ),
        max_size=80,
    ),
    st.integers(0, 50_000),
    st.integers(256, 2048),
)
def test_a_ring_never_overtakes_itself_whatever_the_latency(steps, latency, limit):
    backend = uniform_backend(submission_latency=latency)
    timeline, ids = Timeline(backend), iter(range(1000, 9999))
    ring = Ring(backend, timeline, lambda: next(ids), 256, "test", limit)
    for what, number, alignment in steps:
        if what == "frame":
            ring.mark(timeline.signal())
            timeline.collect()
            backend.spend(number)
            continue
        try:
            offset = ring.write(bytes(number), number, alignment)
        except ValidationError:  # the frame needs more than the limit
            continue
        backend.bind_uniform(0, ring.buffer, offset, number)
        draw(backend)
    finish(backend, timeline.signalled + 1)
    assert not backend.hazards


def test_a_ring_that_trusts_no_fence_overtakes_itself():
    """As a control of the test above: the same ring, with a fence that always claims to be done."""
    backend = uniform_backend()
    timeline, ids = Timeline(backend), iter(range(1000, 9999))
    ring = Ring(backend, timeline, lambda: next(ids), 256, "test", 256)
    backend.bind_uniform(0, 1000, 0, 100)
    for _ in range(3):
        ring.write(bytes(100), 100, 1)
        draw(backend)
        ring.mark(0)
    assert KINDS.RING_OVERTAKEN in kinds(backend)


FRAME = st.lists(
    st.tuples(
        st.sampled_from(["own", "transient", "immediate", "lock", "query", "emulated", "temporary", "many"]),
        st.integers(0, 3),
    ),
    max_size=12,
)


@settings(max_examples=40)
@given(st.lists(FRAME, max_size=5), st.integers(0, 200_000), st.integers(1, 3), st.integers(1, 2000))
def test_a_device_has_no_hazards_whatever_is_done_with_it(frames, latency, in_flight, batch):
    simulation = Simulation(submission_latency=latency, batch=batch)
    with rhi.create_device("null", simulation=simulation, frames_in_flight=in_flight) as device:
        simulated = device.backend_as(SimulatedBackend)
        simulated.count_samples(lambda draw: 100)
        kit = make_kit(device, np.array([0, 1, 2]))
        program, mesh, image, camera, objects = kit.program, kit.mesh, kit.image, kit.camera, kit.objects
        queries = {emulated: device.occlusion_query(emulated=emulated) for emulated in (False, True)}
        for frame in frames:
            with device.render_pass(image, clear=(0, 0, 0, 1)):
                for what, number in frame:
                    if what == "own":
                        device.draw(program, mesh, camera=camera, object=objects[number])
                    elif what == "transient":
                        moved = device.transient.uniform(Object(offset=(number, 0, 0, 0)))
                        device.draw(program, mesh, camera=camera, object=moved)
                    elif what == "immediate":
                        with device.immediate(program, rhi.Primitive.QUADS, **kit.bindings) as quads:
                            for _ in range(4 * 200 * number):
                                quads.vertex(position=(0, 0))
                    elif what == "lock":
                        with objects.lock(Access.READ_WRITE if number else Access.WRITE) as rows:
                            rows["offset"] = number
                    elif what == "temporary":
                        with device.uniform(Camera(tint=(1, 1, 1, 1))) as uniform:
                            device.draw(program, mesh, camera=uniform, object=objects[0])
                    elif what == "many":
                        draws = mesh.draws(np.zeros(number, int), 3)
                        device.draw_many(program, mesh, draws, **kit.bindings)
                    else:
                        query = queries[what == "emulated"]
                        with query:
                            device.draw(program, mesh, **kit.bindings)
                        if number == 1:
                            query.wait()
            device.present(image)
        device.finish()
        assert not simulated.hazards


def test_a_lock_on_stream_memory_in_use_is_found_through_a_device():
    with rhi.create_device("null", simulation=Simulation()) as device:
        simulated = device.backend_as(SimulatedBackend)
        dtype = np.dtype([("position", "f4", 2)])
        vertices = device.buffer(6, dtype, usage=BufferUsage.STREAM)
        mesh = device.mesh(vertices)
        program = device.program(hand_made_program())
        image = device.texture((8, 8), Format.RGBA8)
        camera, objects = device.uniform(Camera(tint=(1, 1, 1, 1))), device.uniform_array(Object, 1)
        for wait in (True, False):
            with device.render_pass(image):
                device.draw(program, mesh.view(0, 3), camera=camera, object=objects[0])
            if wait:
                device.finish()
            with vertices.lock(Access.WRITE, 0, 3):
                pass
            assert len(simulated.hazards) == (not wait)
        assert simulated.hazards[0].first.file == __file__


@pytest.mark.parametrize("faults", [None, Faults()], ids=["alone", "behind faults"])
def test_a_hazard_of_a_command_buffer_names_the_line_that_recorded_it(faults):
    with rhi.create_device("null", simulation=Simulation(), faults=faults) as device:
        simulated = device.backend_as(SimulatedBackend)
        vertices = device.buffer(6, np.dtype([("position", "f4", 2)]), usage=BufferUsage.STREAM)
        mesh, program = device.mesh(vertices), device.program(hand_made_program())
        image = device.texture((8, 8), Format.RGBA8)
        bindings = {
            "camera": device.uniform(Camera(tint=(1, 1, 1, 1))),
            "object": device.uniform_array(Object, 1)[0],
        }
        with device.record() as commands, commands.render_pass(image):
            recorded = inspect.currentframe().f_lineno + 1
            commands.draw(program, mesh, **bindings)
        device.submit(commands)
        device.finish()
        device.submit(commands)
        vertices.write(np.zeros(6, vertices.dtype))
        written = inspect.currentframe().f_lineno - 1
        with device.render_pass(image):
            drawn = inspect.currentframe().f_lineno + 1
            device.draw(program, mesh, **bindings)
        vertices.write(np.zeros(6, vertices.dtype))
        lines = [(hazard.first.line, hazard.second.line) for hazard in simulated.hazards]
        assert (recorded, written) in lines
        assert (drawn, written + 5) in lines
        assert {hazard.first.file for hazard in simulated.hazards} == {__file__}
