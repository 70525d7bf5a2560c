"""The simulated GPU: two clocks, submission, order, and waits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from null_kit import hand_made_program
from simulated_kit import PLAIN, STATIC, STREAM, draw, make_backend, words

import rhi
from rhi.backends import null
from rhi.backends.null import (
    Activity,
    CommandWork,
    CostModel,
    Lane,
    NullBackend,
    SimulatedBackend,
    Simulation,
)
from rhi.backends.null.simulation.cost import count_primitives
from rhi.commands.ops import Op
from rhi.contract import descriptors
from rhi.contract.descriptors import (
    BufferDescriptor,
    PassDescriptor,
    Primitive,
    QueryKind,
    Region,
    TextureDescriptor,
)
from rhi.contract.formats import Format
from rhi.contract.states import CullMode, Scissor, StateChange, Viewport

CPU, GPU = Lane.CPU, Lane.GPU


@pytest.fixture
def backend():
    return make_backend()


# -- clocks and submission -------------------------------------------------------------------------------


def test_without_a_simulation_the_null_backend_has_no_clock():
    assert type(null.create_backend()) is NullBackend
    assert type(null.create_backend(simulation=Simulation())) is SimulatedBackend


def test_a_device_takes_the_simulation_as_an_option():
    with rhi.create_device("null", simulation=Simulation(call=3)) as device:
        assert device.backend_as(SimulatedBackend).simulation.call == 3
        assert device.backend_as(NullBackend) is device.backend_as(SimulatedBackend)


@pytest.mark.parametrize(
    ("name", "least"),
    [("call", 1), ("batch", 1), ("submission_latency", 0), ("wake_latency", 0), ("interrupt_latency", 0)],
)
def test_times_that_would_never_pass_are_refused(name, least):
    assert getattr(Simulation(**{name: least}), name) == least
    with pytest.raises(rhi.ValidationError, match=r"^\[device-argument\]"):
        Simulation(**{name: least - 1})


@pytest.mark.parametrize("option", [{"simulation": 5}, {"faults": "all"}])
def test_options_of_the_wrong_type_are_refused(option):
    with pytest.raises(rhi.ValidationError, match=r"^\[device-argument\]"):
        rhi.create_device("null", **option)


def test_each_call_costs_cpu_time_and_spend_adds_the_time_of_other_work(backend):
    before = backend.now
    draw(backend)
    draw(backend)
    backend.spend(1000)
    assert backend.now - before == 2 * 10 + 1000


CREATIONS = {
    "buffer": lambda backend: backend.create_buffer(900, BufferDescriptor(16)),
    "texture": lambda backend: backend.create_texture(900, TextureDescriptor((4, 4), Format.RGBA8)),
    "sampler": lambda backend: backend.create_sampler(900, descriptors.SamplerDescriptor()),
    "program": lambda backend: backend.create_program(900, hand_made_program("p")),
    "vertex array": lambda backend: backend.create_vertex_array(
        900, descriptors.VertexArrayDescriptor(PLAIN, ())
    ),
    "query": lambda backend: backend.create_query(900, QueryKind.TIMESTAMP),
}


@pytest.mark.parametrize("create", CREATIONS.values(), ids=CREATIONS)
def test_making_anything_takes_a_call(backend, create):
    before = backend.now
    create(backend)
    assert backend.now - before == 10


def test_a_read_of_readback_memory_takes_a_call_and_does_not_wait_for_the_gpu(backend):
    backend.create_buffer(900, BufferDescriptor(16, descriptors.BufferUsage.READBACK))
    backend.copy_buffer(STATIC, 0, 900, 0, 16)
    backend.signal(1)
    before = backend.now
    assert backend.read_buffer(900, 0, 4) == bytes(4)
    assert backend.now - before == 10
    before = backend.now
    backend.read_buffer(STATIC, 0, 4)
    assert backend.now - before > 10  # a read of other memory waits


def test_a_fence_completes_when_the_work_before_it_is_done_and_not_earlier(backend):
    draw(backend)
    backend.signal(1)
    submitted = backend.now
    backend.spend(100 + 1000 - 11)  # latency and draw, less this and the next call
    assert backend.completed() == 0
    assert backend.now == submitted + 1099
    assert backend.completed() == 1


def test_commands_do_not_start_before_they_are_submitted(backend):
    draw(backend)
    backend.spend(1_000_000)
    assert backend.statistics.draws == 0
    backend.signal(1)
    backend.spend(101)
    assert backend.statistics.draws == 1


def test_a_full_batch_is_submitted_by_itself():
    backend = make_backend(batch=4)
    for _ in range(3):
        draw(backend)
    backend.spend(1_000_000)
    assert backend.statistics.draws == 0
    draw(backend)
    backend.spend(1_000_000)
    assert backend.statistics.draws == 4


def test_a_wait_stalls_the_cpu_until_the_gpu_is_there(backend):
    draw(backend, 5)
    backend.signal(1)
    submitted = backend.now
    assert backend.wait(1, 1.0)
    assert backend.now == submitted + 100 + 5000 + 7
    timeline = backend.timeline
    (stall,) = [span for span in timeline.lane(CPU) if span.activity is Activity.STALLED]
    assert (stall.start, stall.end, stall.name) == (submitted + 10, backend.now, "wait(1)")


def test_a_wait_for_a_reached_fence_does_not_stall(backend):
    draw(backend)
    backend.signal(1)
    backend.spend(5000)
    assert backend.wait(1, 1.0)
    assert backend.timeline.total(CPU, Activity.STALLED) == 0


def test_a_wait_that_is_too_short_says_so_and_has_taken_its_time(backend):
    draw(backend, 5)
    backend.signal(1)
    before = backend.now
    assert not backend.wait(1, 2e-6)
    assert backend.now == before + 10 + 2000
    assert backend.completed() == 0
    assert backend.wait(1, 4e-6)


def test_a_read_waits_for_everything_before_it(backend):
    backend.write_buffer(STATIC, 0, b"abcd")
    draw(backend, 3)
    before = backend.now
    assert backend.read_buffer(STATIC, 0, 4) == b"abcd"
    assert backend.now == before + 10 + 100 + 3000 + 7


def test_the_gpu_starves_between_two_submissions(backend):
    draw(backend)
    backend.signal(1)
    backend.wait(1, 1.0)
    idle_from = backend.now - 7
    draw(backend)
    backend.signal(2)
    starts = backend.now + 100
    backend.wait(2, 1.0)
    rests = [span for span in backend.timeline.lane(GPU) if span.activity is Activity.STARVED]
    assert (rests[1].start, rests[1].end) == (idle_from, starts)


def test_stop_and_wait_alternates_and_asking_later_overlaps():
    """As in the thesis, 6.1.1 and Figure 6.2."""

    def run(stop: bool):
        backend = make_backend(batch=8)
        for value in range(1, 6):
            draw(backend, 2)
            backend.signal(value)
            if stop:
                backend.wait(value, 1.0)
            backend.spend(2000)
        backend.wait(5, 1.0)
        return backend.timeline

    waiting, asking_later = run(True), run(False)
    for timeline in (waiting, asking_later):
        assert timeline.total(GPU, Activity.BUSY) == 5 * 2000
    assert waiting.total(CPU, Activity.STALLED) == 5 * (100 + 2000 + 7 - 10)
    assert waiting.total(GPU, Activity.STARVED) > 4 * 2000
    assert asking_later.total(CPU, Activity.STALLED) < 100  # for the last one
    assert asking_later.end < waiting.end * 0.6


def test_timestamps_are_of_the_gpus_clock(backend):
    for query in (1, 2):
        backend.create_query(query, QueryKind.TIMESTAMP)
    backend.write_query(1)
    draw(backend, 4)
    backend.write_query(2)
    backend.signal(1)
    backend.wait(1, 1.0)
    assert backend.read_query(2) - backend.read_query(1) == 4000


def test_a_query_has_no_answer_before_its_time_and_never_an_older_one(backend):
    backend.create_query(1, QueryKind.OCCLUSION)
    for instances in (1, 2):
        backend.begin_query(1)
        draw(backend, instances)
        backend.end_query(1)
        assert backend.read_query(1) is None
        backend.spend(10_000)
        assert backend.read_query(1) == instances * 1000


def test_reading_a_query_submits_pending_commands(backend):
    backend.create_query(1, QueryKind.TIMESTAMP)
    backend.write_query(1)
    while backend.read_query(1) is None:
        assert backend.now < 10_000


@pytest.mark.parametrize(("spent", "drawn"), [(0, 9), (1000, 3)])
def test_memory_of_a_stream_buffer_is_free_only_when_the_gpu_has_read_it(backend, spent, drawn):
    backend.write_buffer(STREAM, 0, words(3, 1, 0, 0, 0))
    backend.draw_indirect(PLAIN, Primitive.TRIANGLES, STREAM, 0, 1, 20, 0, 0)
    backend.signal(1)
    backend.spend(spent)
    backend.write_buffer(STREAM, 0, words(9, 1, 0, 0, 0))
    backend.wait(1, 1.0)
    assert backend.indirect_draws[-1].draws["count"].tolist() == [drawn]


def test_a_command_that_raises_is_taken_out_and_those_after_it_are_executed(backend):
    backend.copy_buffer(999, 0, STATIC, 0, 4)
    backend.write_buffer(STATIC, 4, b"bbbb")
    backend.signal(1)
    with pytest.raises(KeyError):
        backend.wait(1, 1.0)
    assert backend.wait(1, 1.0)
    assert backend.read_buffer(STATIC, 4, 4) == b"bbbb"


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("draw"), st.integers(0, 4)),
        st.tuples(st.just("signal"), st.just(0)),
        st.tuples(st.just("spend"), st.integers(0, 5000)),
        st.tuples(st.just("wait"), st.integers(0, 3)),
        st.tuples(st.just("read"), st.just(0)),
    ),
    max_size=40,
)


def play(steps, batch, latency):
    backend = make_backend(batch=batch, submission_latency=latency)
    value, seen = 0, []
    for what, number in steps:
        if what == "draw":
            draw(backend, number)
        elif what == "signal":
            value += 1
            backend.signal(value)
        elif what == "spend":
            backend.spend(number)
        elif what == "wait":
            seen.append(backend.wait(max(0, value - number), 1.0))
        else:
            backend.read_buffer(STATIC, 0, 4)
        seen.append((backend.completed(), backend.now))
    return backend, seen


@settings(max_examples=60)
@given(STEPS, st.integers(1, 6), st.integers(0, 3000))
def test_the_same_calls_give_the_same_timeline_and_time_is_accounted_for(steps, batch, latency):
    backend, seen = play(steps, batch, latency)
    again, seen_again = play(steps, batch, latency)
    timeline = backend.timeline
    assert (seen, timeline) == (seen_again, again.timeline)
    fences = [entry[0] for entry in seen if isinstance(entry, tuple)]
    assert fences == sorted(fences)
    for lane in Lane:
        spans = timeline.lane(lane)
        assert [span.start for span in spans[1:]] == [span.end for span in spans[:-1]]
        assert sum(span.nanoseconds for span in spans) == timeline.end
        assert all(span.nanoseconds > 0 for span in spans)


# -- frames ------------------------------------------------------------------------------------------------


def frames(in_flight: int):
    with rhi.create_device("null", simulation=Simulation(), frames_in_flight=in_flight) as device:
        simulated = device.backend_as(SimulatedBackend)
        image = device.texture((2048, 2048), Format.RGBA8)
        for _ in range(6):
            with device.render_pass(image, clear=(0, 0, 0, 1), label="sky"):
                pass
            simulated.spend(50_000)
            device.present(image)
        device.finish()
        return simulated.timeline


def test_frames_have_a_latency_that_grows_with_those_in_flight_and_the_cpu_is_held_back():
    short, long = frames(1), frames(3)
    assert max(frame.in_flight for frame in short.frames) == 2
    assert max(frame.in_flight for frame in long.frames) == 4
    assert long.frames[4].latency > short.frames[4].latency > 0
    assert short.total(CPU, Activity.STALLED) > 0
    assert [label.name for label in long.labels] == ["sky"] * 6


# -- cost ----------------------------------------------------------------------------------------------------


class Watched(CostModel):
    """A cost model that remembers the work it was called with."""

    def nanoseconds(self, work: CommandWork) -> int:
        if not hasattr(self, "asked"):
            object.__setattr__(self, "asked", [])
        self.asked.append(work)
        return 5


def works(call, **options):
    """Return the work that calls cause."""
    cost = Watched()
    backend = make_backend(cost)
    backend.create_texture(
        1,
        TextureDescriptor(
            (64, 32), Format.RGBA8, levels=options.pop("levels", 1), samples=options.pop("samples", 1)
        ),
    )
    backend.create_texture(2, TextureDescriptor((64, 32), Format.RGBA8))
    cost.asked.clear()
    call(backend)
    backend.signal(1)
    backend.wait(1, 1.0)
    return cost.asked


@pytest.mark.parametrize(
    ("call", "work"),
    [
        (lambda b: b.write_buffer(STATIC, 0, bytes(12)), CommandWork(Op.WRITE_BUFFER, bytes=12)),
        (lambda b: b.copy_buffer(STATIC, 0, STATIC, 64, 12), CommandWork(Op.COPY_BUFFER, bytes=24)),
        (lambda b: b.clear_buffer(STATIC, 0, 64, 0), CommandWork(Op.CLEAR_BUFFER, bytes=64)),
        (
            lambda b: b.write_texture(1, 0, Region(0, 0, 4, 4), bytes(64)),
            CommandWork(Op.WRITE_TEXTURE, bytes=64),
        ),
        (
            lambda b: b.copy_texture(1, 0, Region(0, 0, 4, 4), 2, 0, 0, 0, 0),
            CommandWork(Op.COPY_TEXTURE, bytes=128),
        ),
        (lambda b: b.resolve_texture(1, 2), CommandWork(Op.RESOLVE_TEXTURE, bytes=64 * 32 * 4 * 2)),
        (lambda b: b.dispatch(2, 3, 4), CommandWork(Op.DISPATCH, invocations=24)),
        (lambda b: b.dispatch_indirect(STATIC, 0), CommandWork(Op.DISPATCH_INDIRECT, bytes=12)),
        (lambda b: b.bind_program(7), CommandWork(Op.BIND_PROGRAM, state_changes=1)),
        (
            lambda b: b.set_states([StateChange(CullMode, CullMode.NONE)]),
            CommandWork(Op.SET_STATES, state_changes=1),
        ),
        (lambda b: draw(b, 2), CommandWork(Op.DRAW, 6, 2000)),
    ],
)
def test_the_work_of_a_command_follows_from_its_arguments(call, work):
    assert works(call) == [work]


def test_generating_mip_levels_costs_the_bytes_read_and_written():
    (work,) = works(lambda b: b.generate_mipmaps(1), levels=3)
    assert work.bytes == 5 * 4 * (32 * 16 + 16 * 8)


def test_clears_and_resolves_cost_by_pass():
    target = descriptors.Attachment(1, clear=(0, 0, 0, 0), resolve=2)

    def run(backend):
        backend.begin_pass(PassDescriptor((64, 32), (target,), samples=4))
        backend.end_pass()

    begin, end = works(run, samples=4)
    assert begin.pixels == 64 * 32 * 4
    assert end.bytes == 64 * 32 * 4 * 5


@pytest.mark.parametrize(
    ("states", "area"),
    [
        ([], 64 * 32),
        ([(Viewport, Viewport(32, 0, 64, 32))], 32 * 32),
        ([(Scissor, Scissor(0, 0, 4, 4))], 16),
        ([(Viewport, Viewport(32, 0, 64, 32)), (Scissor, Scissor(0, 0, 32, 32))], 0),
    ],
)
def test_uncounted_draws_cover_at_most_the_viewport_and_scissor(states, area):
    def run(backend):
        backend.count_samples(None)
        backend.begin_pass(PassDescriptor((64, 32)))
        backend.set_states([StateChange(*state) for state in states])
        backend.draw(PLAIN, Primitive.TRIANGLES, 0, 3000, 1, 0, 0)

    assert works(run)[-1].pixels == area


def test_the_area_follows_pass_viewport_and_scissor():
    def run(backend):
        backend.count_samples(None)

        def fill(*change):
            backend.set_states([StateChange(*change)] if change else [])
            backend.draw(PLAIN, Primitive.TRIANGLES, 0, 30_000, 1, 0, 0)

        backend.begin_pass(PassDescriptor((64, 32)))
        fill()
        fill(Viewport, Viewport(0, 0, 32, 32))
        fill(Scissor, Scissor(0, 0, 8, 8))
        backend.end_pass()
        backend.begin_pass(PassDescriptor((4, 4)))
        fill()

    assert [work.pixels for work in works(run) if work.op is Op.DRAW] == [64 * 32, 32 * 32, 8 * 8, 4 * 4]


def test_the_work_of_indirect_draws_follows_from_the_buffer_of_arguments():
    def run(backend):
        backend.write_buffer(STATIC, 0, words(3, 2, 0, 0, 0, 6, 1, 0, 0, 0))
        backend.draw_indirect(PLAIN, Primitive.TRIANGLES, STATIC, 0, 2, 20, 0, 0)

    assert works(run)[-1] == CommandWork(Op.DRAW_INDIRECT, 12, 3000, 40)


@pytest.mark.parametrize(
    ("primitive", "vertices", "count"),
    [
        (Primitive.POINTS, 5, 5),
        (Primitive.LINES, 5, 2),
        (Primitive.LINE_STRIP, 5, 4),
        (Primitive.TRIANGLES, 5, 1),
        (Primitive.TRIANGLE_STRIP, 5, 3),
        (Primitive.TRIANGLE_FAN, 2, 0),
        (Primitive.QUADS, 9, 2),
    ],
)
def test_primitives_are_counted_by_their_kind(primitive, vertices, count):
    assert count_primitives(primitive, vertices) == count


def test_default_costs_of_work_are_those_of_the_page():
    assert (
        CostModel().nanoseconds(CommandWork(Op.DRAW, 1000, 2000, 3000, 1, 4000))
        == 20 + 500 + 100 + 60 + 100 + 400
    )


def test_the_model_is_linear_and_replaceable():
    model = CostModel(command=1, vertex=2, pixel=3, byte=4, state_change=5, invocation=6)
    assert model.nanoseconds(CommandWork(Op.DRAW, 10, 10, 10, 10, 10)) == 201
    backend = make_backend(CostModel(command=500, vertex=0, pixel=0))
    draw(backend)
    backend.signal(1)
    backend.wait(1, 1.0)
    backend.spend(10_000)
    assert backend.timeline.total(GPU, Activity.BUSY) == 2 * 500


def test_memory_written_lies_in_the_queue_up_to_a_limit(backend):
    backend.create_buffer(5, BufferDescriptor(1 << 23))
    for _ in range(4):
        backend.write_buffer(5, 0, np.zeros(1 << 23, np.uint8))
    backend.spend(10_000)
    assert backend.statistics.commands == 3
