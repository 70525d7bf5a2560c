"""Answers of queries: scripts, and answers recorded on another backend."""

import pytest
from null_kit import make_kit
from simulated_kit import make_backend

import rhi
from rhi.backends.null import AnswerLog, NullBackend, RecordedAnswers, create_backend
from rhi.contract.descriptors import Primitive, QueryKind
from rhi.errors import ValidationError


def ask(backend, *queries):
    """Use each query once, with a draw inside, and return the answers."""
    for query in queries:
        backend.begin_query(query)
        backend.draw(1, Primitive.TRIANGLES, 0, 3, 1, 0, 0)
        backend.end_query(query)
    return [read(backend, query) for query in queries]


def read(backend, query):
    try:
        return backend.read_query(query)
    except ValidationError as error:
        return error.rule.id


@pytest.fixture
def backend():
    created = create_backend()
    for query in (1, 2, 3):
        created.create_query(query, QueryKind.OCCLUSION)
    return created


def test_a_script_answers_in_the_order_in_which_queries_end(backend):
    backend.answer_queries([5, 0, 7, 9])
    assert ask(backend, 2, 1) == [5, 0]
    assert ask(backend, 2) == [7]
    assert read(backend, 1) == 0  # an answer stays


def test_a_query_without_a_scripted_result_raises_or_is_counted(backend):
    backend.answer_queries([None, 3])
    assert ask(backend, 1, 2, 3) == ["null-samples", 3, "null-samples"]
    backend.count_samples(lambda draw: 8)
    backend.answer_queries([])
    assert ask(backend, 1) == [8]


def test_a_query_that_a_mapping_or_function_does_not_answer_raises_instead_of_returning_zero(backend):
    for answers in ({2: 64}, lambda query: 64 if query == 2 else None):
        backend.answer_queries(answers)
        assert ask(backend, 1, 2) == ["null-samples", 64]


def test_a_script_may_hold_no_nonsense(backend):
    backend.answer_queries([-1])
    assert ask(backend, 1) == ["null-answer"]
    with pytest.raises(ValidationError):
        backend.answer_queries(-1)


def test_an_answer_log_notes_each_use_of_a_query_and_omits_unread_results(backend):
    log = AnswerLog(backend)
    backend.answer_queries([5, 6, 7])
    ask(log, 1)
    log.begin_query(1)
    log.end_query(1)
    ask(log, 1)
    assert log.answers == RecordedAnswers({(1, 0): 5, (1, 2): 7})


def test_recorded_answers_are_returned_use_by_use(backend):
    backend.answer_queries(RecordedAnswers({(1, 0): 5, (1, 2): 7}))
    assert [ask(backend, 1), ask(backend, 1), ask(backend, 1)] == [[5], ["null-samples"], [7]]


def test_a_simulated_gpu_takes_the_same_answers():
    backend = make_backend()
    backend.count_samples(None)
    backend.create_query(1, QueryKind.OCCLUSION)
    backend.create_query(2, QueryKind.COUNTER)
    backend.answer_queries(RecordedAnswers({(1, 1): 5, (2, 1): 9}))
    for expected in ("null-samples", 5):
        ask(backend, 1)
        backend.spend(10_000)
        assert read(backend, 1) == expected
    for expected in ("null-samples", 9):
        backend.write_query(2)
        read(backend, 2)
        backend.spend(10_000)
        assert read(backend, 2) == expected


def test_answers_are_saved_and_loaded(tmp_path):
    answers = RecordedAnswers({(12, 0): 5, (3, 2): 0})
    answers.save(tmp_path / "answers.json")
    assert RecordedAnswers.load(tmp_path / "answers.json") == answers


def frame(device):
    """Render three frames with three queries each, and return their answers by frame."""
    kit = make_kit(device)
    queries = [device.occlusion_query(emulated=emulated) for emulated in (False, False, True)]
    drawn = []
    for _ in range(3):
        with device.render_pass(kit.image):
            for query in queries:
                with query:
                    device.draw(kit.program, kit.mesh, **kit.bindings)
        drawn.append([query.wait() for query in queries])
    return drawn


def test_a_run_on_another_backend_is_played_to_the_null_device():
    other = create_backend()
    numbers = iter(range(0, 1000, 7))
    other.count_samples(lambda draw: next(numbers))
    log = AnswerLog(other)
    with rhi.Device(log) as device:
        seen = frame(device)
    with rhi.create_device("null") as device:
        device.backend_as(NullBackend).answer_queries(log.answers)
        assert frame(device) == seen
    assert seen[0] != seen[1]
