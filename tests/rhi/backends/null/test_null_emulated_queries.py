"""Occlusion queries on a GPU whose counter only the CPU can read, as in the thesis (4.4.2, Figure 4.1)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from null_kit import Camera, Object, hand_made_program
from simulated_kit import draw, make_backend

import rhi
from rhi.backends.null import Activity, Lane, SimulatedBackend, Simulation
from rhi.contract.descriptors import QueryKind

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


def test_a_handler_that_comes_to_an_idle_gpu_reads_what_there_is():
    backend = make_backend(interrupt_latency=5000, halts_at_events=False)
    backend.create_query(1, QueryKind.COUNTER)
    draw(backend, 2)
    backend.write_query(1)
    backend.signal(1)
    backend.spend(100_000)
    assert backend.read_query(1) == 2000


def test_what_nobody_counts_stays_unknown():
    backend = make_backend(interrupt_latency=100)
    backend.count_samples(None)
    backend.create_query(1, QueryKind.COUNTER)
    draw(backend)
    backend.write_query(1)
    backend.signal(1)
    backend.spend(100_000)
    with pytest.raises(rhi.ValidationError) as caught:
        backend.read_query(1)
    assert caught.value.rule.id == "null-samples"


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
        program = device.program(hand_made_program())
        mesh = device.mesh({"position": np.array([[-1, -1], [1, -1], [0, 1]], np.float32)})
        image = device.texture((8, 8), rhi.Format.RGBA8)
        camera, objects = device.uniform(Camera(tint=(1, 1, 1, 1))), device.uniform_array(Object, 1)
        queries = [device.occlusion_query(emulated=True) for _ in frames]
        with device.render_pass(image):
            for query, (inside, outside) in zip(queries, frames, strict=True):
                with query:
                    device.draw(program, mesh, inside, camera=camera, object=objects[0])
                device.draw(program, mesh, outside, camera=camera, object=objects[0])
                if waits:
                    query.wait()
        assert [query.wait() for query in queries] == [inside * 100 for inside, _ in frames]
        assert not simulated.hazards
