"""Query sets on the null device: the commands they become, and the answers that an oracle gives."""

from __future__ import annotations

import numpy as np
import pytest
from null_kit import Kit

import rhi
from rhi import Op
from rhi.backends.null import NullBackend
from rhi.backends.null.answers import AnswerLog

QUERY_INDICES = [2, 0, 0, 3]


def ask(kit: Kit, queries: rhi.QuerySet, encoder: rhi.Encoder | None = None) -> None:
    """Four draws for three queries."""
    draws = kit.mesh.draws(np.zeros(4, int), 3)
    encoder = kit.device if encoder is None else encoder  # an empty command buffer is false
    with encoder.render_pass(kit.image):
        encoder.draw_counted(kit.program, kit.mesh, draws, queries, QUERY_INDICES, **kit.bindings)


def test_queries_are_begun_and_ended_one_after_the_other(kit: Kit) -> None:
    queries = kit.device.query_set(5)
    ask(kit, queries)
    commands = kit.ops(Op.BEGIN_QUERY, Op.END_QUERY, Op.DRAW)
    begin, draw, end = Op.BEGIN_QUERY, Op.DRAW, Op.END_QUERY
    assert [c.op for c in commands] == [begin, draw, end, begin, draw, draw, end, begin, draw, end]
    assert [c["query"] for c in commands if c.op is begin] == [
        queries.ids[query_index] for query_index in (2, 0, 3)
    ]
    assert all(command.site is not None and command.site.file == __file__ for command in commands)
    assert len(queries.ids) == len(queries) == 5


def test_an_emulated_set_takes_one_counter_more_and_signals_once(kit: Kit) -> None:
    queries = kit.device.query_set(5, emulated=True)
    ask(kit, queries)
    commands = kit.ops(Op.WRITE_QUERY, Op.SIGNAL, Op.DRAW)
    take, draw = Op.WRITE_QUERY, Op.DRAW
    assert [c.op for c in commands] == [take, draw, take, draw, draw, take, draw, take, Op.SIGNAL]
    assert [c["query"] for c in commands if c.op is take] == list(queries.ids[:4])
    assert len(queries.ids) == len(queries) + 1 == 6


def test_an_empty_array_of_draws_sends_no_commands(kit: Kit) -> None:
    for emulated in (False, True):
        queries = kit.device.query_set(2, emulated=emulated)
        with kit.device.render_pass(kit.image):
            draws = kit.mesh.draws([], [])
            before = len(kit.device.stream)
            kit.device.draw_counted(kit.program, kit.mesh, draws, queries, **kit.bindings)
            done = kit.device.stream[before:].filter(
                frozenset({Op.DRAW, Op.BEGIN_QUERY, Op.WRITE_QUERY, Op.SIGNAL})
            )
            assert not len(done)
        assert queries.wait().tolist() == [-1, -1]


def test_an_oracle_answers_queries_in_the_order_of_their_draws(kit: Kit) -> None:
    null = kit.device.backend_as(NullBackend)
    null.answer_queries([7, 8, 9])
    queries = kit.device.query_set(5)
    ask(kit, queries)
    assert queries.wait().tolist() == [8, -1, 7, 9, -1]


@pytest.mark.parametrize("emulated", [False, True])
def test_counted_samples_of_draws_add_up_by_query(kit: Kit, emulated: bool) -> None:
    samples = iter([1, 10, 100, 1000])
    kit.device.backend_as(NullBackend).count_samples(lambda draw: next(samples))
    queries = kit.device.query_set(5, emulated=emulated)
    ask(kit, queries)
    assert queries.wait().tolist() == [110, -1, 1, 1000, -1]


def test_answers_that_were_never_supplied_are_unknown(kit: Kit) -> None:
    queries = kit.device.query_set(5)
    ask(kit, queries)
    with pytest.raises(rhi.ValidationError, match=r"^\[null-samples\]"):
        queries.wait()
    kit.device.backend_as(NullBackend).answer_queries(3)
    assert queries.wait().tolist() == [3, -1, 3, 3, -1]


def test_a_log_of_answers_knows_those_of_sets() -> None:
    backend = NullBackend()
    log = AnswerLog(backend)
    with rhi.Device(log) as device:
        queries = device.query_set(3)
        for query_index in (0, 2):
            log.begin_query(queries.ids[query_index])
            log.end_query(queries.ids[query_index])
        queries.mark_drawn(np.array([0, 2]))
        backend.answer_queries({queries.ids[0]: 4, queries.ids[2]: 6})
        assert queries.wait().tolist() == [4, -1, 6]
        assert log.answers.samples == {(queries.ids[0], 0): 4, (queries.ids[2], 0): 6}


def test_a_draw_that_fails_leaves_no_query_open_and_no_answer(kit: Kit) -> None:
    queries = kit.device.query_set(5)
    null = kit.device.backend_as(NullBackend)
    null.answer_queries(1)
    ask(kit, queries)
    queries.wait()
    draws = iter([None, None, rhi.DeviceError(rhi.errors.rules.DEVICE_LOST, "draw")])

    def fail(*arguments: object) -> None:
        error = next(draws)
        if error is not None:
            raise error

    null.draw = fail  # type: ignore[method-assign]
    before = len(kit.device.stream)
    with pytest.raises(rhi.DeviceError):
        ask(kit, queries)
    begin, end = (len(kit.device.stream[before:].filter(op)) for op in (Op.BEGIN_QUERY, Op.END_QUERY))
    assert begin == end == 2
    assert not queries.is_finished


def test_a_command_buffer_writes_plain_commands(kit: Kit) -> None:
    queries = kit.device.query_set(5)
    with kit.device.record() as commands:
        ask(kit, queries, commands)
    ops = [c.op for c in commands.stream.filter(frozenset({Op.BEGIN_QUERY, Op.DRAW, Op.END_QUERY}))]
    begin, draw, end = Op.BEGIN_QUERY, Op.DRAW, Op.END_QUERY
    assert ops == [begin, draw, end, begin, draw, draw, end, begin, draw, end]
    kit.device.backend_as(NullBackend).answer_queries([5, 6, 7])
    assert kit.device.statistics.queries == 0
    kit.device.submit(commands)
    assert queries.wait().tolist() == [6, -1, 5, 7, -1]
    assert (kit.device.statistics.queries, kit.device.statistics.draws) == (3, 4)


def test_a_set_that_cannot_be_made_leaves_nothing_behind(kit: Kit) -> None:
    null = kit.device.backend_as(NullBackend)
    create, successes = null.create_query, iter(range(3))

    def fail(*arguments: object) -> None:
        if next(successes, None) is None:
            raise rhi.DeviceError(rhi.errors.rules.DEVICE_MEMORY, "create_query")
        create(*arguments)  # type: ignore[arg-type]

    null.create_query = fail  # type: ignore[method-assign]
    with pytest.raises(rhi.DeviceError):
        kit.device.query_set(5)
    kit.device.finish()
    kit.device.signal()
    assert len(kit.ops(Op.DESTROY)) == 3


def test_conditional_draws_are_one_condition_for_each_run_of_a_query(kit: Kit) -> None:
    queries = kit.device.query_set(5)
    kit.device.backend_as(NullBackend).answer_queries(1)
    ask(kit, queries)
    before, counted = len(kit.device.stream), kit.device.statistics
    draws = kit.mesh.draws(np.zeros(5, int), 3)
    with kit.device.render_pass(kit.image):
        kit.device.draw_conditional(kit.program, kit.mesh, draws, queries, [3, 3, 0, 2, 2], **kit.bindings)
    begin, draw, end = Op.BEGIN_CONDITIONAL, Op.DRAW_INDIRECT, Op.END_CONDITIONAL
    commands = kit.device.stream[before:].filter(frozenset({begin, draw, end}))
    assert [c.op for c in commands] == [begin, draw, end] * 3
    assert [c["query"] for c in commands if c.op is begin] == [
        queries.ids[query_index] for query_index in (3, 0, 2)
    ]
    assert [c["draws"] for c in commands if c.op is draw] == [2, 1, 2]
    assert all(command.site is not None and command.site.file == __file__ for command in commands)
    assert kit.device.statistics.draws == counted.draws + 3
    assert kit.device.statistics.upload_bytes == counted.upload_bytes + draws.nbytes


def test_arguments_of_conditional_draws_lie_at_multiples_of_a_word(kit: Kit) -> None:
    queries = kit.device.query_set(5)
    kit.device.backend_as(NullBackend).answer_queries(1)
    ask(kit, queries)
    with kit.device.render_pass(kit.image):
        for count in (1, 2, 1, 3):
            kit.device.draw_conditional(
                kit.program,
                kit.mesh,
                kit.mesh.draws(np.zeros(count, int), 3),
                queries,
                [0] * count,
                **kit.bindings,
            )
    offsets = [command["offset"] for command in kit.ops(Op.DRAW_INDIRECT)]
    assert len(offsets) == 4
    assert [offset % 4 for offset in offsets] == [0] * 4
