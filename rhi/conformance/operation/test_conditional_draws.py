"""Draws on condition of a query set's rows: the device decides about each, as if it were alone in a
condition."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from rhi.conformance.shaders import Colored, Corner, Flat, FlatShade
from rhi.conformance.shapes import texel_rectangle
from rhi.errors import rules
from rhi.shading import draw_index, instance_index, vec4

pytestmark = [
    pytest.mark.recorded_too,
    pytest.mark.requires("draws", "shading", "occlusion_queries", "conditional_rendering", "draw_index"),
]

COLUMNS = 16
SIZE = (COLUMNS, 4)
HIDDEN = [1, 2, 5, 6, 7, 12]
"""Columns that show nothing at depth 0.25, since a nearer wall covers them."""
VISIBLE = [column for column in range(COLUMNS) if column not in HIDDEN]


class Numbered(Flat):
    """Draws the draw index as red and the instance index as green, in sixteenths."""

    def vertex(self, v: Corner) -> FlatShade:
        color = vec4(float(draw_index()) / 16.0, float(instance_index()) / 16.0, 1.0, 1.0)
        return FlatShade(clip=v.position, color=color)


@pytest.fixture
def columns(device: rhi.Device) -> Iterator[rhi.Mesh]:
    """Yield a mesh of the columns of the image at depth 0.25, then of the same at depth 0.75."""
    rectangles = [
        texel_rectangle(column, 0, 1, SIZE[1], SIZE, depth=depth)
        for depth in (0.25, 0.75)
        for column in range(COLUMNS)
    ]
    with device.mesh(np.concatenate(rectangles)) as mesh:
        yield mesh


@pytest.fixture
def image(device: rhi.Device) -> Iterator[Any]:
    with device.texture(SIZE, rhi.Format.RGBA8) as image:
        yield image


@pytest.fixture
def depth(device: rhi.Device) -> Iterator[Any]:
    with device.texture(SIZE, rhi.Format.D32F) as depth:
        yield depth


@pytest.fixture
def queries(device: rhi.Device) -> Iterator[rhi.QuerySet]:
    """Yield a set with a row for each column."""
    queries = device.query_set(COLUMNS)
    yield queries
    queries.destroy()


def parts(mesh: rhi.Mesh, columns: Any, wall: bool = False) -> NDArray[Any]:
    """Return the draws of these columns."""
    return mesh.draws(6 * (np.asarray(columns, int) + COLUMNS * wall), 6)


def count_columns(
    encoder: rhi.Encoder, program: Any, mesh: rhi.Mesh, queries: rhi.QuerySet, hidden: list[int] = HIDDEN
) -> None:
    """In an open pass, draw the wall and count the samples of each column in its row."""
    with encoder.states(rhi.DepthTest.ON, rhi.DepthFunction.GREATER):
        if hidden:
            encoder.draw_many(program, mesh, parts(mesh, hidden, wall=True))
        encoder.draw_counted(program, mesh, parts(mesh, range(COLUMNS)), queries)


def lit(image: Any) -> list[int]:
    """Return the columns of an image that aren't black."""
    return np.flatnonzero(image.read()[..., :3].any(axis=(0, 2))).tolist()


def test_a_draw_whose_query_counted_no_sample_is_skipped(
    device: rhi.Device, columns: rhi.Mesh, image: Any, depth: Any, queries: rhi.QuerySet
) -> None:
    program = device.program(Colored)
    with device.render_pass(image, depth, clear=(0, 0, 0, 1), clear_depth=0.0):
        count_columns(device, program, columns, queries)
    with device.render_pass(image, clear=(0, 0, 0, 1)):
        device.draw_conditional(program, columns, parts(columns, range(COLUMNS)), queries)
    assert lit(image) == VISIBLE


def test_the_device_decides_within_one_pass(
    device: rhi.Device, columns: rhi.Mesh, image: Any, depth: Any, queries: rhi.QuerySet
) -> None:
    """The draws that count and those that depend on them may have the same program and states."""
    program = device.program(Colored)
    for last in (program, device.program(Numbered)):
        with device.render_pass(image, depth, clear=(0, 0, 0, 1), clear_depth=0.0):
            with device.states(rhi.ColorWrite.OFF):
                count_columns(device, program, columns, queries)
            with device.states(rhi.DepthTest.OFF):
                device.draw_conditional(last, columns, parts(columns, range(COLUMNS)), queries)
        assert lit(image) == VISIBLE


def test_draws_that_count_may_have_the_same_program_and_states(
    device: rhi.Device, columns: rhi.Mesh, image: Any, queries: rhi.QuerySet
) -> None:
    program = device.program(Colored)
    counted = columns.draws(6 * np.arange(COLUMNS), np.where(np.isin(np.arange(COLUMNS), HIDDEN), 0, 6))
    for rows in (np.arange(COLUMNS), (np.arange(COLUMNS) + 1) % COLUMNS):
        with device.render_pass(image, clear=(0, 0, 0, 1)):
            device.draw_counted(program, columns, counted, queries)
            device.draw_conditional(program, columns, parts(columns, range(COLUMNS)), queries, rows)
        assert lit(image) == sorted({*VISIBLE, *(i for i in range(COLUMNS) if rows[i] in VISIBLE)})


def test_query_indices_select_the_condition_of_each_draw(
    device: rhi.Device, columns: rhi.Mesh, image: Any, depth: Any, queries: rhi.QuerySet
) -> None:
    program = device.program(Colored)
    with device.render_pass(image, depth, clear_depth=0.0):
        count_columns(device, program, columns, queries)
    with device.render_pass(image, clear=(0, 0, 0, 1)):
        # Rows may repeat, also after others; 0 and 3 count samples, 1 and 5 don't.
        rows = np.array([1, 0, 0, 5, 5, 5, 3, 1, 0])
        device.draw_conditional(program, columns, parts(columns, range(4, 13)), queries, rows)
    assert lit(image) == [5, 6, 10, 12]


def test_a_set_may_decide_often_and_count_anew(
    device: rhi.Device, columns: rhi.Mesh, image: Any, depth: Any, queries: rhi.QuerySet
) -> None:
    program = device.program(Colored)
    for hidden in (HIDDEN, [0, 3], [], list(range(COLUMNS)), HIDDEN):
        with device.render_pass(image, depth, clear=(0, 0, 0, 1), clear_depth=0.0):
            count_columns(device, program, columns, queries, hidden)
        for _ in range(2):
            with device.render_pass(image, clear=(0, 0, 0, 1)):
                device.draw_conditional(program, columns, parts(columns, range(COLUMNS)), queries)
            assert lit(image) == [column for column in range(COLUMNS) if column not in hidden]
        assert (queries.wait() > 0).tolist() == [column not in hidden for column in range(COLUMNS)]


def test_several_sets_decide_side_by_side(
    device: rhi.Device, columns: rhi.Mesh, image: Any, depth: Any
) -> None:
    program, sets = device.program(Colored), [device.query_set(COLUMNS) for _ in range(3)]
    hidden = [[0, 1], [2, 3, 4], [5]]
    for queries, wall in zip(sets, hidden, strict=True):
        with device.render_pass(image, depth, clear_depth=0.0):
            count_columns(device, program, columns, queries, wall)
    with device.render_pass(image, clear=(0, 0, 0, 1)):
        for set_index, queries in enumerate(sets):
            columns_of_set = range(2 * set_index, 2 * set_index + 2)
            device.draw_conditional(
                program, columns, parts(columns, columns_of_set), queries, list(columns_of_set)
            )
    assert lit(image) == [
        2 * set_index + i
        for set_index in range(3)
        for i in (0, 1)
        if 2 * set_index + i not in hidden[set_index]
    ]
    for queries in sets:
        queries.destroy()


def test_draws_of_a_row_are_numbered_from_0(
    device: rhi.Device, columns: rhi.Mesh, image: Any, depth: Any, queries: rhi.QuerySet
) -> None:
    with device.render_pass(image, depth, clear_depth=0.0):
        count_columns(device, device.program(Colored), columns, queries)
    draws = columns.draws(6 * np.arange(7), 6, base_instance=[9, 8, 7, 6, 5, 4, 3])
    with device.render_pass(image, clear=(0, 0, 0, 1)):
        device.draw_conditional(device.program(Numbered), columns, draws, queries, [0, 0, 0, 1, 3, 3, 0])
    pixels = image.read()[0, :7].astype(float)
    assert np.rint(pixels[:, 0] * 16 / 255).tolist() == [0, 1, 2, 0, 0, 1, 0]
    assert np.rint(pixels[:, 1] * 16 / 255).tolist() == [9, 8, 7, 0, 5, 4, 3]
    assert pixels[:, 2].tolist() == [255, 255, 255, 0, 255, 255, 255]


def test_conditions_end_with_the_call(
    device: rhi.Device, columns: rhi.Mesh, image: Any, depth: Any, queries: rhi.QuerySet
) -> None:
    """Draws behind them, queries in them and the states are as after other draws."""
    program, query = device.program(Colored), device.occlusion_query()
    with device.render_pass(image, depth, clear_depth=0.0):
        count_columns(device, program, columns, queries)
    with device.render_pass(image, clear=(0, 0, 0, 1)):
        with query:
            device.draw_conditional(program, columns, parts(columns, [0, 1, 2, 3]), queries)
        device.draw_many(program, columns, parts(columns, [1]))
        device.draw(program, columns.view(6 * 5, 6))
    assert query.wait() == 2 * SIZE[1]
    assert lit(image) == [0, 1, 3, 5]
    query.destroy()


def test_no_draws_decide_nothing(
    device: rhi.Device, columns: rhi.Mesh, image: Any, queries: rhi.QuerySet
) -> None:
    program = device.program(Colored)
    with device.render_pass(image):
        device.draw_counted(program, columns, parts(columns, [0]), queries)
    before = device.statistics
    with device.render_pass(image, clear=(0, 0, 0, 1)):
        device.draw_conditional(program, columns, parts(columns, []), queries, [])
    assert device.statistics.draws == before.draws
    assert not lit(image)


def test_indexed_draws_are_dropped_too(
    device: rhi.Device, image: Any, depth: Any, queries: rhi.QuerySet
) -> None:
    corners = [texel_rectangle(column, 0, 1, SIZE[1], SIZE) for column in range(COLUMNS)]
    with device.mesh(np.concatenate(corners), np.arange(6)) as mesh:
        program = device.program(Colored)
        draws = mesh.draws(0, 6, base_vertex=6 * np.arange(COLUMNS))
        none = mesh.draws(
            0, np.where(np.isin(np.arange(COLUMNS), HIDDEN), 0, 6), base_vertex=6 * np.arange(COLUMNS)
        )
        with device.render_pass(image, depth):
            device.draw_counted(program, mesh, none, queries)
        with device.render_pass(image, clear=(0, 0, 0, 1)):
            device.draw_conditional(program, mesh, draws, queries)
    assert lit(image) == VISIBLE


def test_a_command_buffer_decides_at_each_submission(
    device: rhi.Device, columns: rhi.Mesh, image: Any, depth: Any, queries: rhi.QuerySet
) -> None:
    program = device.program(Colored)
    with device.record() as commands:
        with commands.render_pass(image, depth):
            with commands.states(rhi.DepthTest.ON, rhi.DepthFunction.GREATER):
                commands.draw_counted(program, columns, parts(columns, range(COLUMNS)), queries)
        with commands.render_pass(image, clear=(0, 0, 0, 1)):
            commands.draw_conditional(program, columns, parts(columns, range(COLUMNS)), queries)
    for hidden in (HIDDEN, [4], HIDDEN):
        with (
            device.render_pass(image, depth, clear_depth=0.0),
            device.states(rhi.DepthTest.ON, rhi.DepthFunction.GREATER),
        ):
            device.draw_many(program, columns, parts(columns, hidden, wall=True))
        device.submit(commands)
        assert lit(image) == [column for column in range(COLUMNS) if column not in hidden]
    # The answers of a submission also decide about draws of the device.
    with device.render_pass(image, clear=(0, 0, 0, 1)):
        device.draw_conditional(program, columns, parts(columns, range(COLUMNS)), queries)
    assert lit(image) == VISIBLE


@pytest.mark.parametrize("wrong", ["never counted", "another row", "quads"])
def test_only_rows_that_counted_decide(device: rhi.Device, columns: rhi.Mesh, image: Any, wrong: str) -> None:
    program, queries = device.program(Colored), device.query_set(4)
    draws = parts(columns, [0, 1])
    quads = device.mesh(
        np.concatenate([texel_rectangle(0, 0, 1, 1, SIZE)] * 4), primitive=rhi.Primitive.QUADS
    )
    mesh, rows = (
        (quads, [1, 2]) if wrong == "quads" else (columns, [1, 0] if wrong == "another row" else [1, 2])
    )
    rule = {
        "never counted": rules.QUERY_STATE,
        "another row": rules.QUERY_INDICES,
        "quads": rules.DEVICE_CAPABILITY,
    }
    with device.render_pass(image, clear=(0, 0, 0, 1)):
        if wrong != "never counted":
            device.draw_counted(program, columns, parts(columns, [8, 9]), queries, [1, 2])
        before = device.statistics
        with pytest.raises(rhi.ValidationError, match=rf"^\[{rule[wrong].id}\]"):
            device.draw_conditional(
                program, mesh, quads.draws([0, 4], 4) if mesh is quads else draws, queries, rows
            )
        assert device.statistics.draws == before.draws
        device.draw_counted(program, columns, parts(columns, [8, 9]), queries, [1, 2])
        device.draw_conditional(program, columns, draws, queries, [1, 2])
    assert lit(image) == [0, 1, 8, 9]
    queries.destroy()
    quads.destroy()
