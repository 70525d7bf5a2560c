"""Rules of query sets."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import Device, Mesh, QuerySet
from rhi.conformance.shaders import Colored, Tint, Tinted
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import loose, refuses
from rhi.errors import rules


@pytest.fixture
def queries(recording: Device) -> Iterator[QuerySet]:
    """A set of 4."""
    queries = recording.query_set(4)
    yield queries
    queries.destroy()


@pytest.mark.parametrize(
    ("query_indices", "right"),
    [
        ([0, 4], [0, 3]),
        ([-1, 0], [1, 0]),
        ([2, 1, 2], [2, 2, 1]),
        ([0], [0, 0]),
        ([[0], [1]], [0, 1]),
        ([0.0, 1.0], np.array([0, 1], np.uint16)),
        ([True, False], [1, 0]),
        (np.array([2**63, 0], np.uint64), np.array([3, 0], np.uint64)),
    ],
    ids=["past the last", "below 0", "come again", "too few", "nested", "floats", "flags", "huge"],
)
def test_query_indices_fit_the_draws_and_the_set(
    recording: Device, queries: QuerySet, mesh: Mesh, image: Any, query_indices: Any, right: Any
) -> None:
    program = recording.program(Colored)
    draws = mesh.draws(np.zeros(3 if len(right) == 3 else 2, int), 3)
    with recording.render_pass(image):
        with refuses(rules.QUERY_INDICES, recording):
            recording.draw_counted(program, mesh, draws, queries, query_indices)
        recording.draw_counted(program, mesh, draws, queries, right)


def test_a_set_has_a_query_for_each_draw(
    recording: Device, queries: QuerySet, mesh: Mesh, image: Any
) -> None:
    program = recording.program(Colored)
    with recording.render_pass(image):
        with refuses(rules.QUERY_INDICES, recording):
            recording.draw_counted(program, mesh, mesh.draws(np.zeros(5, int), 3), queries)
        recording.draw_counted(program, mesh, mesh.draws(np.zeros(5, int), 3), queries, [1, 1, 1, 1, 1])
        recording.draw_counted(program, mesh, mesh.draws(np.zeros(4, int), 3), queries)


def test_draws_are_an_array_within_the_mesh(
    recording: Device, queries: QuerySet, mesh: Mesh, image: Any
) -> None:
    program, draws = recording.program(Colored), mesh.draws([0, 3], 3)
    with recording.render_pass(image):
        with refuses(rules.DRAW_ARRAY, recording):
            recording.draw_counted(program, mesh, np.zeros(2, rhi.DRAW), queries)
        beyond = draws.copy()
        beyond["first"] = 4
        with refuses(rules.MESH_RANGE, recording):
            recording.draw_counted(program, mesh, beyond, queries)
        recording.draw_counted(program, mesh, draws, queries)


def test_draws_are_counted_inside_a_pass(
    recording: Device, queries: QuerySet, mesh: Mesh, image: Any
) -> None:
    program, draws = recording.program(Colored), mesh.draws()
    with refuses(rules.DRAW_OUTSIDE_PASS, recording):
        recording.draw_counted(program, mesh, draws, queries)
    with recording.render_pass(image):
        recording.draw_counted(program, mesh, draws, queries)


def test_bindings_are_those_of_any_draw(recording: Device, queries: QuerySet, mesh: Mesh, image: Any) -> None:
    program, draws, tint = recording.program(Tinted), mesh.draws(), Tint(color=(1, 1, 1, 1))
    with recording.render_pass(image):
        with refuses(rules.BINDING_MISSING, recording):
            loose(recording).draw_counted(program, mesh, draws, queries)
        with recording.uniform(tint) as buffer:
            recording.draw_counted(program, mesh, draws, queries, tint=buffer)


def test_queries_do_not_nest(recording: Device, queries: QuerySet, mesh: Mesh, image: Any) -> None:
    program, draws, query = recording.program(Colored), mesh.draws(), recording.occlusion_query()
    with recording.render_pass(image):
        with query, refuses(rules.QUERY_NESTED, recording):
            recording.draw_counted(program, mesh, draws, queries)
        recording.draw_counted(program, mesh, draws, queries)
        with query:
            pass
    query.destroy()


def test_draws_are_counted_by_a_set(recording: Device, mesh: Mesh, image: Any) -> None:
    program, draws, query = recording.program(Colored), mesh.draws(), recording.occlusion_query()
    with recording.render_pass(image), refuses(rules.DEVICE_ARGUMENT, recording):
        loose(recording).draw_counted(program, mesh, draws, query)
    query.destroy()


def test_a_set_is_its_own_device_s(recording: Device, backend: str, mesh: Mesh, image: Any) -> None:
    program, draws = recording.program(Colored), mesh.draws()
    with rhi.create_device(backend) as other, recording.render_pass(image):
        with refuses(rules.RESOURCE_FOREIGN, recording):
            recording.draw_counted(program, mesh, draws, other.query_set(1))


def test_a_destroyed_set_counts_nothing(recording: Device, mesh: Mesh, image: Any) -> None:
    program, draws, queries = recording.program(Colored), mesh.draws(), recording.query_set(1)
    with recording.render_pass(image):
        recording.draw_counted(program, mesh, draws, queries)
        queries.destroy()
        queries.destroy()
        with refuses(rules.RESOURCE_DESTROYED, recording):
            recording.draw_counted(program, mesh, draws, queries)
    with refuses(rules.QUERY_STATE, recording):
        queries.wait()


def test_a_closed_device_counts_nothing(backend: str) -> None:
    with rhi.create_device(backend) as device:
        program, mesh, queries = device.program(Colored), device.mesh(rectangle()), device.query_set(1)
    with refuses(rules.DEVICE_CLOSED):
        device.draw_counted(program, mesh, mesh.draws(), queries)


def test_a_set_has_answers_once_it_was_asked(
    recording: Device, queries: QuerySet, mesh: Mesh, image: Any
) -> None:
    with refuses(rules.QUERY_STATE, recording):
        queries.wait()
    with refuses(rules.QUERY_STATE, recording):
        _ = queries.visible_samples
    assert not queries.is_finished
    with recording.render_pass(image):
        recording.draw_counted(recording.program(Colored), mesh, mesh.draws([], []), queries)
    assert queries.wait().tolist() == [-1] * 4


@pytest.mark.parametrize("size", [-1, 1.5, "2"])
def test_a_set_has_a_number_of_queries(recording: Device, size: Any) -> None:
    with refuses(rules.DEVICE_ARGUMENT, recording):
        recording.query_set(size)
    assert len(recording.query_set(3)) == 3


# -- in command buffers ------------------------------------------------------------------------------------


def test_a_command_buffer_asks_a_set_once(
    recording: Device, queries: QuerySet, mesh: Mesh, image: Any
) -> None:
    program, draws, other = recording.program(Colored), mesh.draws(), recording.query_set(1)
    with recording.record() as commands, commands.render_pass(image):
        commands.draw_counted(program, mesh, draws, queries)
        before = len(commands)
        with refuses(rules.QUERY_STATE, recording):
            commands.draw_counted(program, mesh, draws, queries)
        assert len(commands) == before
        commands.draw_counted(program, mesh, draws, other)
    recording.submit(commands)
    other.destroy()


def test_a_set_lives_until_the_last_submission(recording: Device, mesh: Mesh, image: Any) -> None:
    queries = recording.query_set(2)
    with recording.record() as commands, commands.render_pass(image):
        commands.draw_counted(recording.program(Colored), mesh, mesh.draws(), queries)
    recording.submit(commands)
    queries.destroy()
    with refuses(rules.RESOURCE_DESTROYED, recording):
        recording.submit(commands)


def test_a_command_buffer_counts_by_its_device_s_sets(
    recording: Device, backend: str, mesh: Mesh, image: Any
) -> None:
    program, draws = recording.program(Colored), mesh.draws()
    with rhi.create_device(backend) as other, recording.record() as commands, commands.render_pass(image):
        with refuses(rules.RESOURCE_FOREIGN, recording):
            commands.draw_counted(program, mesh, draws, other.query_set(1))


# -- conditions --------------------------------------------------------------------------------------------


def draw_on_condition(
    encoder: rhi.Encoder, program: Any, mesh: Mesh, queries: QuerySet, query_indices: Any = None
) -> None:
    encoder.draw_conditional(program, mesh, mesh.draws([0, 3], 3), queries, query_indices)


def test_queries_that_counted_decide(recording: Device, queries: QuerySet, mesh: Mesh, image: Any) -> None:
    program = recording.program(Colored)
    with recording.render_pass(image):
        with refuses(rules.QUERY_STATE, recording):
            draw_on_condition(recording, program, mesh, queries)
        recording.draw_counted(program, mesh, mesh.draws([0, 3], 3), queries, [1, 3])
        for wrong in (None, [1, 2], [1], [1, 4], [1.0, 3.0]):
            with refuses(rules.QUERY_INDICES, recording):
                draw_on_condition(recording, program, mesh, queries, wrong)
        draw_on_condition(recording, program, mesh, queries, [1, 3])
        draw_on_condition(recording, program, mesh, queries, [3, 3])


def test_a_condition_of_a_set_is_alone(recording: Device, queries: QuerySet, mesh: Mesh, image: Any) -> None:
    program, query = recording.program(Colored), recording.occlusion_query()
    with recording.render_pass(image):
        with query:
            pass
        recording.draw_counted(program, mesh, mesh.draws([0, 3], 3), queries)
        with recording.conditional(query), refuses(rules.CONDITION_NESTED, recording):
            draw_on_condition(recording, program, mesh, queries)
        draw_on_condition(recording, program, mesh, queries)
    query.destroy()


def test_an_emulated_set_decides_nothing(recording: Device, mesh: Mesh, image: Any) -> None:
    if not recording.capabilities.sample_counter:
        pytest.skip("the device declares no sample_counter")
    program, queries = recording.program(Colored), recording.query_set(2, emulated=True)
    with recording.render_pass(image):
        recording.draw_counted(program, mesh, mesh.draws([0, 3], 3), queries)
        with refuses(rules.DEVICE_CAPABILITY, recording):
            draw_on_condition(recording, program, mesh, queries)
    queries.destroy()


def test_a_conditional_draw_needs_a_query_counted_in_the_same_command_buffer(
    recording: Device, queries: QuerySet, mesh: Mesh, image: Any
) -> None:
    program = recording.program(Colored)
    with recording.render_pass(image):
        recording.draw_counted(program, mesh, mesh.draws([0, 3], 3), queries)
    with recording.record() as commands, commands.render_pass(image):
        with refuses(rules.QUERY_STATE, recording):
            draw_on_condition(commands, program, mesh, queries)
        commands.draw_counted(program, mesh, mesh.draws([0, 3], 3), queries, [2, 3])
        with refuses(rules.QUERY_INDICES, recording):
            draw_on_condition(commands, program, mesh, queries)
        draw_on_condition(commands, program, mesh, queries, [2, 3])
    recording.submit(commands)
