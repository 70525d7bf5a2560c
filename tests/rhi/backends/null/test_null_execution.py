"""The queue of the null backend: memory read when executed, queries, fences, time."""

import numpy as np
import pytest

from rhi.backends.null import Draw, ExecutionStatistics, NullBackend, create_backend
from rhi.backends.null.null_backend import COMMAND_NANOSECONDS, MAX_INDIRECT_RECORDS
from rhi.commands.ops import Op as OpInOps
from rhi.commands.stream import Op
from rhi.contract import descriptors
from rhi.contract.backend import Backend
from rhi.errors import ValidationError

PLAIN, INDEXED = 100, 101
ARGUMENTS, COUNT, STAGING = 200, 201, 202


@pytest.fixture
def backend():
    created = create_backend()
    created.create_vertex_array(
        PLAIN, descriptors.VertexArrayDescriptor(1, (descriptors.VertexStream(9, 0, 12, False, ()),))
    )
    created.create_vertex_array(INDEXED, descriptors.VertexArrayDescriptor(1, (), index_buffer=8))
    for buffer in (ARGUMENTS, COUNT, STAGING):
        created.create_buffer(buffer, descriptors.BufferDescriptor(256))
    return created


def draw(backend, count=3, instances=1, base_instance=0):
    backend.draw(PLAIN, descriptors.Primitive.TRIANGLES, 0, count, instances, 0, base_instance)


def words(*values):
    return np.array(values, np.int64).astype(np.uint32)


def draw_indirect(
    backend, vertex_array=INDEXED, draws=1, offset=0, stride=20, count_buffer=0, count_offset=0
):
    backend.draw_indirect(
        vertex_array,
        descriptors.Primitive.TRIANGLES,
        ARGUMENTS,
        offset,
        draws,
        stride,
        count_buffer,
        count_offset,
    )


def resolved(backend, index=-1):
    return backend.indirect_draws[index].draws.tolist()


# -- the backend as such ---------------------------------------------------------------------------------


def test_the_backend_says_that_it_runs_no_shaders_and_can_do_all_else(backend):
    able = backend.capabilities
    assert able.backend == "null"
    assert not able.shading
    assert able.sample_counter
    assert able.alpha_test
    assert able.compute
    assert not able.unsupported_formats
    assert not able.unrenderable_formats


def test_it_is_a_backend_for_the_type_checker_and_at_run_time():
    backend: Backend = create_backend(validation=True)
    assert isinstance(backend, NullBackend)
    assert all(callable(getattr(backend, op.method)) for op in Op)
    assert Op is OpInOps


def test_a_closed_backend_has_let_go_of_its_memory(backend):
    backend.close()
    with pytest.raises(KeyError):
        backend.read_buffer(ARGUMENTS, 0, 4)


def test_a_command_that_raises_is_dropped_and_those_after_it_are_executed(backend):
    backend.write_buffer(ARGUMENTS, 0, b"aaaa")
    backend.copy_buffer(999, 0, ARGUMENTS, 0, 4)
    backend.write_buffer(ARGUMENTS, 4, b"bbbb")
    with pytest.raises(KeyError):
        backend.completed()
    assert backend.read_buffer(ARGUMENTS, 0, 8) == b"aaaabbbb"


# -- indirect arguments ----------------------------------------------------------------------------------


def test_indirect_arguments_come_from_an_earlier_write_and_not_from_a_later_one(backend):
    backend.write_buffer(ARGUMENTS, 0, words(6, 2, 3, -4, 5))
    draw_indirect(backend)
    backend.write_buffer(ARGUMENTS, 0, words(9, 9, 9, 9, 9))
    assert resolved(backend) == [(6, 2, 3, -4, 5)]


def test_indirect_arguments_come_from_an_earlier_copy(backend):
    backend.write_buffer(ARGUMENTS, 0, words(1, 1, 1, 1, 1))
    backend.write_buffer(STAGING, 16, words(7, 1, 0, 0, 3))
    backend.copy_buffer(STAGING, 16, ARGUMENTS, 0, 20)
    draw_indirect(backend)
    backend.clear_buffer(ARGUMENTS, 0, 20, 0)
    assert resolved(backend) == [(7, 1, 0, 0, 3)]


def test_indirect_arguments_come_from_an_earlier_clear(backend):
    backend.write_buffer(ARGUMENTS, 0, words(1, 1, 1, 1, 1))
    backend.clear_buffer(ARGUMENTS, 0, 20, 2)
    draw_indirect(backend)
    assert resolved(backend) == [(2, 2, 2, 2, 2)]


def test_without_indices_there_is_no_base_vertex(backend):
    backend.write_buffer(ARGUMENTS, 0, words(6, 2, 3, 4, 77))
    draw_indirect(backend, PLAIN)
    assert resolved(backend) == [(6, 2, 3, 0, 4)]
    assert backend.indirect_draws[0].vertex_array == PLAIN


def test_several_draws_lie_a_stride_apart(backend):
    for index, argument_offset in enumerate((8, 40, 72)):
        backend.write_buffer(ARGUMENTS, argument_offset, words(index + 1, 1, 0, 0, index))
    draw_indirect(backend, draws=3, offset=8, stride=32)
    assert resolved(backend) == [(1, 1, 0, 0, 0), (2, 1, 0, 0, 1), (3, 1, 0, 0, 2)]
    assert backend.indirect_draws[0].draws["count"].tolist() == [1, 2, 3]


@pytest.mark.parametrize(("count", "drawn"), [(0, 0), (1, 1), (3, 3), (4, 3), (0xFFFFFFFF, 3)])
def test_the_number_of_draws_is_the_minimum_of_the_argument_and_the_count_buffer(backend, count, drawn):
    backend.clear_buffer(ARGUMENTS, 0, 256, 3)
    backend.write_buffer(COUNT, 12, words(count))
    draw_indirect(backend, draws=3, count_buffer=COUNT, count_offset=12)
    backend.clear_buffer(COUNT, 0, 256, 2)
    assert len(resolved(backend)) == drawn
    assert backend.statistics.draws == drawn


def test_indirect_dispatches_are_read_when_executed(backend):
    backend.write_buffer(ARGUMENTS, 4, words(2, 3, 4))
    backend.dispatch_indirect(ARGUMENTS, 4)
    backend.clear_buffer(ARGUMENTS, 0, 256, 0)
    backend.dispatch(1, 1, 1)
    assert backend.indirect_dispatches == ((2, 3, 4),)
    assert backend.statistics.dispatches == 2


def test_only_the_latest_indirect_commands_are_kept(backend):
    for index in range(MAX_INDIRECT_RECORDS + 1):
        backend.write_buffer(ARGUMENTS, 0, words(index))
        draw_indirect(backend)
    assert len(backend.indirect_draws) == MAX_INDIRECT_RECORDS
    assert resolved(backend, 0)[0][0] == 1
    assert resolved(backend)[0][0] == MAX_INDIRECT_RECORDS


# -- fences and time -------------------------------------------------------------------------------------


def test_a_fence_is_complete_once_signalled(backend):
    assert backend.completed() == 0
    backend.signal(3)
    assert backend.completed() == 3
    assert backend.wait(3, 0.0)
    assert not backend.wait(4, 0.0)


def test_time_goes_on_with_every_executed_command_and_only_with_them(backend):
    for query in (1, 2, 3):
        backend.create_query(query, descriptors.QueryKind.TIMESTAMP)
    backend.write_query(1)
    backend.write_query(2)
    for _ in range(8):
        draw(backend)
    backend.completed()
    backend.read_query(1)
    backend.write_query(3)
    times = [backend.read_query(query) for query in (1, 2, 3)]
    assert np.diff(times).tolist() == [COMMAND_NANOSECONDS, 9 * COMMAND_NANOSECONDS]
    assert backend.statistics.nanoseconds == times[2]


def test_the_same_commands_take_the_same_time():
    def frame():
        backend = create_backend()
        backend.create_query(1, descriptors.QueryKind.TIMESTAMP)
        for count in range(5):
            draw(backend, count)
        backend.write_query(1)
        return backend.read_query(1), backend.statistics

    assert frame() == frame()


def test_statistics_count_executed_commands(backend):
    draw(backend)
    backend.begin_pass(descriptors.PassDescriptor((1, 1)))
    backend.write_buffer(ARGUMENTS, 0, words(3, 1, 0, 0, 0, 3, 1, 0, 0, 0))
    draw_indirect(backend, draws=2)
    backend.end_pass()
    backend.dispatch(1, 1, 1)
    assert backend.statistics == ExecutionStatistics(6, 3, 0, 0, 1, 6 * COMMAND_NANOSECONDS)


# -- queries ---------------------------------------------------------------------------------------------


def occlusion(backend, query=1, draws=1):
    backend.create_query(query, descriptors.QueryKind.OCCLUSION)
    backend.begin_query(query)
    for index in range(draws):
        draw(backend, base_instance=index)
    backend.end_query(query)


def counter(backend, query):
    backend.create_query(query, descriptors.QueryKind.COUNTER)
    backend.write_query(query)


def refused(backend, query):
    with pytest.raises(ValidationError) as caught:
        backend.read_query(query)
    return caught.value.rule.id


def test_a_query_that_nobody_can_answer_is_refused_and_never_zero(backend):
    occlusion(backend, 1)
    counter(backend, 2)
    assert refused(backend, 1) == "null-samples"
    assert refused(backend, 2) == "null-samples"


def test_queries_around_empty_draws_count_zero(backend):
    counter(backend, 1)
    occlusion(backend, 2, draws=0)
    assert (backend.read_query(1), backend.read_query(2)) == (0, 0)
    backend.create_query(3, descriptors.QueryKind.OCCLUSION)
    backend.begin_query(3)
    draw(backend, count=0)
    draw(backend, instances=0)
    backend.end_query(3)
    assert backend.read_query(3) == 0


def test_a_query_has_no_answer_before_its_end(backend):
    backend.count_samples(lambda draw: 1)
    backend.create_query(1, descriptors.QueryKind.OCCLUSION)
    backend.create_query(2, descriptors.QueryKind.TIMESTAMP)
    assert backend.read_query(1) is None
    assert backend.read_query(2) is None
    backend.begin_query(1)
    draw(backend)
    assert backend.read_query(1) is None
    backend.end_query(1)
    assert backend.read_query(1) == 1
    backend.begin_query(1)
    assert backend.read_query(1) is None


def test_samples_of_each_draw_are_added_up(backend):
    seen = []
    backend.count_samples(lambda draw: seen.append(draw) or draw.base_instance * 10)
    backend.bind_program(5)
    backend.push_label("box")
    counter(backend, 1)
    occlusion(backend, 2, draws=3)
    backend.pop_label()
    counter(backend, 3)
    assert backend.read_query(2) == 30
    assert backend.read_query(3) - backend.read_query(1) == 30
    assert seen[2] == Draw(5, PLAIN, descriptors.Primitive.TRIANGLES, 0, 3, 1, 0, 2, ("box",))


def test_draws_outside_a_query_count_for_the_running_counter_only(backend):
    backend.count_samples(lambda draw: 7)
    draw(backend)
    occlusion(backend, 1)
    draw(backend)
    counter(backend, 2)
    assert (backend.read_query(1), backend.read_query(2)) == (7, 21)


def test_indirect_draws_are_counted_one_by_one(backend):
    backend.count_samples(lambda draw: draw.count * 100 + draw.base_instance)
    backend.write_buffer(ARGUMENTS, 0, words(3, 1, 0, 0, 1, 6, 1, 0, 0, 2, 0, 1, 0, 0, 9))
    backend.create_query(1, descriptors.QueryKind.OCCLUSION)
    backend.begin_query(1)
    draw_indirect(backend, draws=3)
    backend.end_query(1)
    assert backend.read_query(1) == 903
    assert backend.statistics.draws == 3


def test_an_indirect_draw_that_nobody_counts_makes_the_answer_unknown(backend):
    backend.write_buffer(ARGUMENTS, 0, words(3, 1, 0, 0, 1))
    backend.create_query(1, descriptors.QueryKind.OCCLUSION)
    backend.begin_query(1)
    draw_indirect(backend)
    backend.end_query(1)
    assert refused(backend, 1) == "null-samples"


def test_one_unknown_draw_makes_the_answer_unknown_but_not_the_next_ones(backend):
    backend.count_samples(lambda draw: None if draw.base_instance == 1 else 4)
    occlusion(backend, 1, draws=3)
    occlusion(backend, 2, draws=1)
    assert refused(backend, 1) == "null-samples"
    assert backend.read_query(2) == 4


def test_a_counter_stays_unknown_after_an_unknown_draw(backend):
    draw(backend)
    backend.count_samples(lambda draw: 4)
    counter(backend, 1)
    draw(backend)
    counter(backend, 2)
    assert refused(backend, 1) == refused(backend, 2) == "null-samples"


def test_a_function_counts_from_the_next_command_on(backend):
    occlusion(backend, 1)
    backend.count_samples(lambda draw: 4)
    occlusion(backend, 2)
    backend.count_samples(None)
    occlusion(backend, 3)
    assert refused(backend, 1) == "null-samples"
    assert backend.read_query(2) == 4
    assert refused(backend, 3) == "null-samples"


@pytest.mark.parametrize(
    "answers", [12, {1: 12}, lambda query: 12 if query == 1 else None, np.int64(12), {1: np.uint32(12)}]
)
def test_scripted_answers_are_a_number_a_mapping_or_a_function(backend, answers):
    occlusion(backend, 1)
    backend.answer_queries(answers)
    assert backend.read_query(1) == 12
    assert type(backend.read_query(1)) is int


def test_a_scripted_answer_overrides_a_count_and_a_missing_answer_keeps_it(backend):
    backend.count_samples(lambda draw: 5)
    backend.answer_queries({1: 99})
    occlusion(backend, 1)
    occlusion(backend, 2)
    assert (backend.read_query(1), backend.read_query(2)) == (99, 5)


@pytest.mark.parametrize("answer", [-1, "12", 1.5])
def test_an_answer_that_is_no_number_of_samples_is_refused(backend, answer):
    occlusion(backend, 1)
    backend.answer_queries({1: answer})
    with pytest.raises(ValidationError, match=r"^\[null-answer\]"):
        backend.read_query(1)
    backend.answer_queries({1: 0})
    assert backend.read_query(1) == 0


def test_a_counting_function_that_raises_leaves_the_count_unknown(backend):
    def fail(draw):
        raise RuntimeError("no idea")

    backend.count_samples(fail)
    occlusion(backend, 1)
    with pytest.raises(RuntimeError, match="no idea"):
        backend.completed()
    assert refused(backend, 1) == "null-samples"


def test_a_timestamp_needs_no_answer(backend):
    backend.answer_queries(5)
    backend.create_query(1, descriptors.QueryKind.TIMESTAMP)
    backend.write_query(1)
    assert backend.read_query(1) == COMMAND_NANOSECONDS


# -- conditional rendering -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("samples", "inverted", "executed"), [(0, False, 0), (1, False, 1), (0, True, 1), (1, True, 0)]
)
def test_conditional_draws_are_executed_or_dropped_by_the_querys_answer(backend, samples, inverted, executed):
    backend.count_samples(lambda draw: samples)
    occlusion(backend, 1)
    backend.begin_conditional(1, inverted)
    draw(backend)
    backend.end_conditional()
    draw(backend)
    statistics = backend.statistics
    assert (statistics.draws, statistics.dropped_draws) == (2 + executed, 1 - executed)
    assert statistics.undecided_draws == 0


def test_dropped_draws_pass_no_samples(backend):
    backend.count_samples(lambda draw: 3)
    occlusion(backend, 1, draws=0)
    counter(backend, 2)
    backend.begin_conditional(1, False)
    draw(backend)
    backend.write_buffer(ARGUMENTS, 0, words(3, 1, 0, 0, 1))
    draw_indirect(backend)
    backend.end_conditional()
    counter(backend, 3)
    assert backend.read_query(3) == backend.read_query(2) == 0
    assert resolved(backend) == []
    assert backend.statistics.dropped_draws == 2


def test_draws_under_an_unknown_condition_are_undecided_and_make_counts_unknown(backend):
    occlusion(backend, 1)
    backend.count_samples(lambda draw: 3)
    backend.begin_conditional(1, False)
    occlusion(backend, 2)
    backend.end_conditional()
    assert (backend.statistics.draws, backend.statistics.undecided_draws) == (1, 1)
    assert refused(backend, 2) == "null-samples"


def test_stream_buffers_are_forgotten_when_destroyed(backend):
    backend.create_buffer(1, descriptors.BufferDescriptor(4, descriptors.BufferUsage.STREAM))
    backend.destroy(1)
    backend.signal(1)
    with pytest.raises(KeyError):
        backend.read_buffer(1, 0, 4)
