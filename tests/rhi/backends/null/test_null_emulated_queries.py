"""Occlusion queries on a GPU whose counter only the CPU can read, as in the thesis (4.4.2, Figure 4.1)."""

import inspect
import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from null_kit import make_kit
from simulated_kit import PLAIN, STATIC, draw, make_backend

import rhi
from rhi.backends.null import Activity, HazardKind, Lane, SimulatedBackend, Simulation
from rhi.contract.descriptors import Primitive, QueryKind

BEFORE, AFTER = 1, 2


def counted(instances=3, around=5, **times):
    """(counted samples, backend) of a draw between two counters, with other draws before and after it."""
    backend = make_backend(**times)
    for query in (BEFORE, AFTER):
        backend.create_query(query, QueryKind.COUNTER)
    draw(backend, around)
    backend.write_query(BEFORE)
    backend.signal(1)
    draw(backend, instances)
    backend.write_query(AFTER)
    backend.signal(2)
    draw(backend, around)
    backend.signal(3)
    answers = []
    for query in (BEFORE, AFTER):
        while (answer := backend.read_query(query)) is None:
            assert backend.now < 10**8
        answers.append(answer)
    return answers[1] - answers[0], backend


def test_a_counter_taken_by_a_command_is_exact():
    assert counted()[0] == 3000


@pytest.mark.parametrize("latency", [0, 1, 500, 100_000])
def test_a_gpu_that_halts_while_the_counter_is_read_counts_right(latency):
    assert counted(interrupt_latency=latency)[0] == 3000


@pytest.mark.parametrize(
    ("latency", "samples"),
    [
        (500, 3000),  # both handlers come 500 samples too late: luck
        (6000, 2000),  # the second when all is done
        (100_000, 0),  # both when all is done
    ],
)
def test_a_gpu_that_runs_on_has_moved_on_when_the_counter_is_read(latency, samples):
    assert counted(interrupt_latency=latency, halts_at_events=False)[0] == samples


def test_running_on_gives_wrong_counts_and_halting_right_ones_at_the_price_of_a_stop():
    """Unrelated draws follow the end of the query, and none its begin: too many samples are counted."""

    def run(halts):
        backend = make_backend(interrupt_latency=2000, halts_at_events=halts, submission_latency=0)
        for query in (BEFORE, AFTER):
            backend.create_query(query, QueryKind.COUNTER)
        backend.write_query(BEFORE)
        backend.signal(1)
        backend.spend(10_000)
        draw(backend, 1)
        backend.write_query(AFTER)
        draw(backend, 10)
        backend.signal(2)
        backend.wait(2, 1.0)
        backend.spend(10_000)
        return backend.read_query(AFTER) - backend.read_query(BEFORE), backend.timeline

    right, halting = run(True)
    wrong, running = run(False)
    assert (right, wrong) == (1000, 1000 + 2000)
    assert halting.total(Lane.GPU, Activity.HALTED) == 2 * 2000
    assert running.total(Lane.GPU, Activity.HALTED) == 0


def test_an_answer_is_not_there_before_the_handler_has_read_it():
    for halts in (True, False):
        backend = make_backend(interrupt_latency=5000, halts_at_events=halts, submission_latency=0)
        backend.create_query(1, QueryKind.COUNTER)
        for value, answer in ((1, None), (2, 100_000)):  # the second time there is an older answer
            backend.write_query(1)
            draw(backend, 100)  # while it is on its way
            backend.signal(value)
            event = backend.now
            while (got := backend.read_query(1)) is None:
                pass
            assert event + 5000 <= backend.now <= event + 5000 + 20
            assert answer is None or got >= answer
            backend.spend(200_000)


def test_a_handler_on_an_idle_gpu_reads_the_final_count():
    backend = make_backend(interrupt_latency=5000, halts_at_events=False)
    backend.create_query(1, QueryKind.COUNTER)
    draw(backend, 2)
    backend.write_query(1)
    backend.signal(1)
    backend.spend(100_000)
    assert backend.read_query(1) == 2000


def test_an_emulated_query_without_a_sample_count_raises():
    backend = make_backend(interrupt_latency=100)
    backend.count_samples(None)
    backend.create_query(1, QueryKind.COUNTER)
    draw(backend)
    backend.write_query(1)
    backend.signal(1)
    backend.spend(100_000)
    with pytest.raises(rhi.ValidationError, match=r"^\[null-samples\]"):
        backend.read_query(1)


def test_timestamps_need_no_interrupt():
    backend = make_backend(interrupt_latency=10**6)
    backend.create_query(1, QueryKind.TIMESTAMP)
    backend.write_query(1)
    backend.signal(1)
    backend.wait(1, 1.0)
    assert backend.read_query(1) is not None


@settings(max_examples=50)
@given(
    st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=8),
    st.integers(0, 20_000),
    st.integers(0, 20_000),
    st.booleans(),
)
def test_emulated_queries_of_a_device_are_right_whatever_the_latencies(frames, interrupt, submission, waits):
    simulation = Simulation(interrupt_latency=interrupt, submission_latency=submission)
    with rhi.create_device("null", simulation=simulation) as device:
        simulated = device.backend_as(SimulatedBackend)
        simulated.count_samples(lambda draw: draw.instances * 100)
        kit = make_kit(device)
        queries = [device.occlusion_query(emulated=True) for _ in frames]
        with device.render_pass(kit.image):
            for query, (inside, outside) in zip(queries, frames, strict=True):
                with query:
                    device.draw(kit.program, kit.mesh, inside, **kit.bindings)
                device.draw(kit.program, kit.mesh, outside, **kit.bindings)
                if waits:
                    query.wait()
        assert [query.wait() for query in queries] == [inside * 100 for inside, _ in frames]
        assert not simulated.hazards


# -- the race ------------------------------------------------------------------------------------------------


def race(spent=(50_000, 0), waits=False, **times):
    """(counted samples, backend) of a query around one draw of 1,000 samples, which ten like it follow.

    The CPU spends time after the query's begin and after its end, or waits until it knows that the counter
    was read.
    """
    backend = make_backend(submission_latency=0, **times)
    for query in (BEFORE, AFTER):
        backend.create_query(query, QueryKind.COUNTER)
        backend.write_query(query)
        backend.signal(query)
        backend.spend(spent[query - 1])
        while waits and backend.read_query(query) is None:
            pass
        draw(backend, 1 if query == BEFORE else 10)
    backend.signal(3)
    backend.spend(10**6)
    return backend.read_query(AFTER) - backend.read_query(BEFORE), backend


RUNS_ON = {"interrupt_latency": 30_000, "halts_at_events": False}


def test_a_counter_that_is_read_while_the_gpu_runs_on_is_wrong_and_a_hazard():
    for spent, counted, happened in (
        ((50_000, 0), 11_000, (False, True)),  # the end is read when the draws after it are done
        ((0, 0), 0, (True, True)),  # the begin too
        ((0, 50_000), 0, (True, False)),
        ((50_000, 50_000), 1000, (False, False)),  # luck
    ):
        samples, backend = race(spent, **RUNS_ON)
        assert samples == counted
        assert [(h.kind, h.resource, h.happened) for h in backend.hazards] == [
            (HazardKind.COUNTER_RACE, BEFORE, happened[0]),
            (HazardKind.COUNTER_RACE, AFTER, happened[1]),
        ]


def test_two_counters_that_the_gpu_writes_and_a_gpu_that_halts_are_exact_and_no_hazard():
    for times in ({}, {"interrupt_latency": 30_000}):
        for spent in ((0, 0), (50_000, 0), (50_000, 50_000)):
            samples, backend = race(spent, **times)
            assert samples == 1000
            assert not backend.hazards


def test_the_race_names_the_event_and_the_first_draw_after_it():
    backend = make_backend(**RUNS_ON)
    backend.create_query(BEFORE, QueryKind.COUNTER)
    line = inspect.currentframe().f_lineno
    backend.write_query(BEFORE)
    backend.draw(PLAIN, Primitive.TRIANGLES, 0, 3, 0, 0, 0)  # of no instance: it passes no sample
    backend.draw(PLAIN, Primitive.TRIANGLES, 0, 3, 1, 0, 0)
    backend.draw(PLAIN, Primitive.TRIANGLES, 0, 3, 1, 0, 0)
    (hazard,) = backend.hazards
    assert hazard.calls == ("write_query", "draw")
    assert (hazard.first.line, hazard.second.line) == (line + 1, line + 3)


@pytest.mark.parametrize("latency", [0, 30_000])
def test_a_counter_that_is_written_twice_has_the_answer_of_the_second_write(latency):
    backend = make_backend(halts_at_events=False, interrupt_latency=latency)
    backend.create_query(BEFORE, QueryKind.COUNTER)
    backend.write_query(BEFORE)
    draw(backend)
    backend.write_query(BEFORE)
    while (samples := backend.read_query(BEFORE)) is None:
        backend.spend(1000)
    draw(backend)  # known to be after the second write: no race with it
    backend.signal(1)
    backend.spend(10**6)
    backend.completed()
    assert samples == backend.read_query(BEFORE) == 1000
    assert len(backend.hazards) == 1  # of the first write


def test_indirect_draws_race_with_the_counter_too():
    backend = make_backend(**RUNS_ON)
    backend.create_query(BEFORE, QueryKind.COUNTER)
    backend.write_query(BEFORE)
    backend.draw_indirect(PLAIN, Primitive.TRIANGLES, STATIC, 0, 1, 20, 0, 0)
    assert [hazard.kind for hazard in backend.hazards] == [HazardKind.COUNTER_RACE]


def test_a_cpu_that_knows_the_counter_to_be_read_races_with_nothing():
    samples, backend = race(waits=True, **RUNS_ON)
    assert samples == 1000
    assert not backend.hazards


def test_a_fence_behind_the_event_says_nothing_of_its_interrupt():
    backend = make_backend(**RUNS_ON)
    backend.create_query(BEFORE, QueryKind.COUNTER)
    backend.write_query(BEFORE)
    backend.signal(1)
    assert backend.wait(1, 1.0)
    draw(backend)
    assert [hazard.kind for hazard in backend.hazards] == [HazardKind.COUNTER_RACE]


@settings(max_examples=40)
@given(
    st.lists(st.sampled_from(["begin", "end", "draw", "read", "signal"]), max_size=20),
    st.integers(0, 20_000),
    st.integers(0, 20_000),
)
def test_the_same_program_has_the_same_races_at_every_latency_and_only_they_count_wrongly(
    calls, interrupt, submission
):
    """`read` asks until there is an answer, so what the CPU knows doesn't depend on the time."""

    def run(**times):
        backend = make_backend(halts_at_events=False, **times)
        values = itertools.count(1)
        exact, read, written = 0, [], {}
        for query in (BEFORE, AFTER):
            backend.create_query(query, QueryKind.COUNTER)
        for call in calls:
            if call in ("begin", "end"):
                query = BEFORE if call == "begin" else AFTER
                backend.write_query(query)
                written[query] = exact
            elif call == "draw":
                draw(backend)
                exact += 1000
            elif call == "signal":
                backend.signal(next(values))
            else:
                for query, expected in written.items():
                    while (answer := backend.read_query(query)) is None:
                        backend.spend(1000)
                    read.append((query, answer - expected))
        backend.signal(next(values))
        backend.spend(10**6)
        backend.completed()
        read += [(query, backend.read_query(query) - expected) for query, expected in written.items()]
        races = [(h.kind, h.resource, h.first.line, h.second.line) for h in backend.hazards]
        happened = {h.resource for h in backend.hazards if h.happened}
        assert {query for query, late in read if late} <= happened
        return races

    assert run(interrupt_latency=interrupt, submission_latency=submission) == run(interrupt_latency=10**5)
