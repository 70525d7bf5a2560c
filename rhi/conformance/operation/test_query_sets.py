"""Query sets: many draws in one call, each counted as if it were alone in an occlusion query."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from rhi import DRAW, AlphaTest, ColorWrite, CullMode, DepthWrite, Device, Format, Mesh, Primitive, QuerySet
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored, Corner, FlatShade, Shade, Smooth
from rhi.conformance.shapes import rectangle, texel_rectangle
from rhi.conformance.waiting import wait_until
from rhi.errors import rules
from rhi.shading import Shader, StorageRW, atomic_add, draw_index, instance_index, uint, vec4

pytestmark = [pytest.mark.recorded_too, pytest.mark.requires("draws", "shading")]

SIZE = (16, 16)
COUNTS = [(1 + i % 16) * (1 + i // 16) for i in range(64)]
BARS = np.concatenate([texel_rectangle(0, 0, 1 + i % 16, 1 + i // 16, SIZE) for i in range(64)])
"""64 rectangles of 6 vertices each; the i-th covers COUNTS[i] texels."""


@pytest.fixture(params=["native", "emulated"])
def emulated(device: Device, request: pytest.FixtureRequest) -> bool:
    """False for native queries and True for emulated ones, as far as the device supports them."""
    emulated: bool = request.param == "emulated"
    capability = "sample_counter" if emulated else "occlusion_queries"
    if not getattr(device.capabilities, capability):
        pytest.skip(f"{device.backend_name} declares no {capability}")
    return emulated


@pytest.fixture
def queries(device: Device, emulated: bool) -> Iterator[QuerySet]:
    """Yield a query set of 64 rows."""
    queries = device.query_set(64, emulated=emulated)
    assert queries.emulated is emulated
    yield queries
    queries.destroy()


@pytest.fixture
def bars(device: Device) -> Iterator[Mesh]:
    """Yield a mesh of the 64 rectangles of `BARS`."""
    with device.mesh(BARS) as bars:
        yield bars


@pytest.fixture
def image(device: Device) -> Iterator[Any]:
    with device.texture(SIZE, Format.RGBA8) as image:
        yield image


def parts(mesh: Mesh, *which: int) -> NDArray[Any]:
    """Return the draws of these rectangles."""
    return mesh.draws(6 * np.array(which, int), 6)


def count(
    device: Device, image: Any, queries: QuerySet, mesh: Mesh, draws: NDArray[Any], rows: Any = None
) -> list[int]:
    """Return the counts of these draws in a pass of their own."""
    with device.render_pass(image):
        device.draw_counted(device.program(Colored), mesh, draws, queries, rows)
    return [int(samples) for samples in queries.wait()]


def test_each_draw_is_counted_by_a_query_of_its_own(
    device: Device, queries: QuerySet, bars: Mesh, image: Any
) -> None:
    assert count(device, image, queries, bars, parts(bars, *range(64))) == COUNTS


def test_counts_of_a_query_set_equal_those_of_single_queries(device: Device, emulated: bool) -> None:
    """Random boxes over a stepped depth buffer, as in visibility algorithms."""
    random = np.random.default_rng(7)
    size, boxes = (64, 48), 100
    low = random.uniform(-1, 0.8, (boxes, 2))
    high = low + random.uniform(0, 0.6, (boxes, 2))
    rows = [
        rectangle(*a, *b, depth=d) for a, b, d in zip(low, high, random.uniform(0, 1, boxes), strict=True)
    ]
    steps = [rectangle(x, -1, x + 0.25, 1, depth=(x + 1) / 2) for x in np.arange(-1, 1, 0.25)]
    with (
        device.texture(size, Format.D32F) as depth,
        device.mesh(np.concatenate(rows)) as mesh,
        device.mesh(np.concatenate(steps)) as wall,
    ):
        program, queries = device.program(Colored), device.query_set(boxes, emulated=emulated)
        with device.render_pass(depth=depth, clear_depth=0.0):
            device.draw(program, wall)
        single = [device.occlusion_query(emulated=emulated) for _ in range(boxes)]
        states = device.states(ColorWrite.OFF, DepthWrite.OFF)
        with device.render_pass(depth=depth), states:
            for i, query in enumerate(single):
                with query:
                    device.draw(program, mesh.view(6 * i, 6))
            device.draw_counted(program, mesh, mesh.draws(6 * np.arange(boxes), 6), queries)
        expected = [query.wait() for query in single]
        assert queries.wait().tolist() == expected
        assert 0 < sum(samples > 0 for samples in expected) < boxes
        queries.destroy()
        for query in single:
            query.destroy()


def test_query_indices_select_the_query_that_counts_each_draw(
    device: Device, queries: QuerySet, bars: Mesh, image: Any
) -> None:
    answers = count(device, image, queries, bars, parts(bars, 5, 9, 2), [40, 0, 63])
    assert [answers[40], answers[0], answers[63]] == [COUNTS[5], COUNTS[9], COUNTS[2]]


def test_a_row_counts_several_draws_together(
    device: Device, queries: QuerySet, bars: Mesh, image: Any
) -> None:
    answers = count(device, image, queries, bars, parts(bars, 1, 2, 3, 10, 20, 30), [7, 7, 7, 2, 5, 5])
    assert answers[7] == COUNTS[1] + COUNTS[2] + COUNTS[3]
    assert (answers[2], answers[5]) == (COUNTS[10], COUNTS[20] + COUNTS[30])


def test_rows_that_were_not_asked_for_say_so(
    device: Device, queries: QuerySet, bars: Mesh, image: Any
) -> None:
    assert count(device, image, queries, bars, parts(bars, 3, 4)) == [COUNTS[3], COUNTS[4], *[-1] * 62]
    assert count(device, image, queries, bars, parts(bars, 3), [9]) == [*[-1] * 9, COUNTS[3], *[-1] * 54]


def test_a_row_whose_draws_cover_nothing_counts_nothing(
    device: Device, queries: QuerySet, bars: Mesh, image: Any
) -> None:
    """Draws without vertices, without instances, and facing away."""
    draws = bars.draws([0, 6, 12], [0, 6, 6], instances=[1, 0, 1])
    with device.states(CullMode.FRONT):
        assert count(device, image, queries, bars, draws)[:4] == [0, 0, 0, -1]


def test_no_draws_ask_for_nothing(device: Device, queries: QuerySet, bars: Mesh, image: Any) -> None:
    count(device, image, queries, bars, parts(bars, 1))
    assert count(device, image, queries, bars, parts(bars)) == [-1] * 64
    assert queries.is_finished


def test_a_set_may_be_empty(device: Device, emulated: bool, bars: Mesh, image: Any) -> None:
    empty = device.query_set(0, emulated=emulated)
    assert len(empty) == 0
    assert count(device, image, empty, bars, parts(bars), []) == []
    empty.destroy()


def test_a_query_set_clears_the_results_of_earlier_calls(
    device: Device, queries: QuerySet, bars: Mesh, image: Any
) -> None:
    for first in (0, 30, 7):
        answers = count(device, image, queries, bars, parts(bars, first, first + 1), [first, 50])
        assert answers == [{first: COUNTS[first], 50: COUNTS[first + 1]}.get(row, -1) for row in range(64)]


def test_results_of_a_query_set_are_read_only_and_do_not_change_later(
    device: Device, queries: QuerySet, bars: Mesh, image: Any
) -> None:
    with device.render_pass(image):
        device.draw_counted(device.program(Colored), bars, parts(bars, 4), queries)
    first = queries.wait()
    with pytest.raises(ValueError, match="read-only"):
        first[0] = 3
    count(device, image, queries, bars, parts(bars, 5))
    assert first[0] == COUNTS[4]


def test_a_set_asked_again_before_it_was_read_answers_for_the_latest(
    device: Device, queries: QuerySet, bars: Mesh, image: Any
) -> None:
    with device.render_pass(image):
        for which in (60, 3, 17):
            device.draw_counted(device.program(Colored), bars, parts(bars, which, 1), queries, [8, which])
    answers = queries.wait()
    assert (answers[8], answers[17], answers[3]) == (COUNTS[17], COUNTS[1], -1)


def test_a_set_asked_again_before_it_was_done_counts_anew(device: Device, emulated: bool, image: Any) -> None:
    """The device may still be executing the draws of the earlier request."""
    layers, queries = 40, device.query_set(2, emulated=emulated)
    with device.texture((512, 512), Format.R8) as large, device.mesh(np.tile(rectangle(), layers)) as mesh:
        for _ in range(5):
            for count in (layers, 1):
                with device.render_pass(large):
                    draws = mesh.draws([0, 0], 6 * count)
                    device.draw_counted(device.program(Colored), mesh, draws, queries)
                device.signal()
            assert queries.wait().tolist() == [512 * 512] * 2
    queries.destroy()


def test_sets_in_several_passes_keep_their_own_counts(
    device: Device, emulated: bool, bars: Mesh, image: Any
) -> None:
    sets = [device.query_set(64, emulated=emulated) for _ in range(4)]
    program = device.program(Colored)
    for turn in (0, 1):
        with device.render_pass(image):
            for set_index in (0, 1):
                draws = parts(bars, *np.roll(range(64), 2 * turn + set_index))
                device.draw_counted(program, bars, draws, sets[2 * turn + set_index])
                device.draw(program, bars)
    for set_index, queries in enumerate(sets):
        assert queries.wait().tolist() == np.roll(COUNTS, set_index).tolist()
        queries.destroy()


def test_queries_beside_a_set_count_their_own(
    device: Device, queries: QuerySet, emulated: bool, bars: Mesh, image: Any
) -> None:
    single = [device.occlusion_query(emulated=is_emulated) for is_emulated in (emulated, False, emulated)]
    program = device.program(Colored)
    with device.render_pass(image):
        with single[0]:
            device.draw(program, bars.view(6 * 5, 6))
        device.draw_counted(program, bars, parts(bars, *range(20)), queries)
        with single[1]:
            device.draw(program, bars.view(6 * 6, 6))
        device.draw_counted(program, bars, parts(bars, *range(30)), queries)
        with single[2]:
            device.draw(program, bars.view(6 * 7, 6))
    assert [query.wait() for query in single] == COUNTS[5:8]
    assert queries.wait().tolist() == COUNTS[:30] + [-1] * 34
    for query in single:
        query.destroy()


@pytest.mark.requires("occlusion_queries", "sample_counter")
def test_native_and_emulated_sets_take_turns(device: Device, bars: Mesh, image: Any) -> None:
    native, emulated = device.query_set(64), device.query_set(64, emulated=True)
    program = device.program(Colored)
    for _ in range(3):
        with device.render_pass(image):
            device.draw_counted(program, bars, parts(bars, *range(64)), native)
            device.draw_counted(program, bars, parts(bars, *range(63, -1, -1)), emulated)
            device.draw_counted(program, bars, parts(bars, *range(32)), native, np.arange(32, 64))
        assert native.wait().tolist() == [-1] * 32 + COUNTS[:32]
        assert emulated.wait().tolist() == COUNTS[::-1]
    emulated.destroy()
    assert count(device, image, native, bars, parts(bars, *range(64))) == COUNTS
    native.destroy()


def test_sets_may_be_large(device: Device, emulated: bool, image: Any) -> None:
    size = 1500
    with device.mesh(
        np.concatenate([texel_rectangle(0, 0, 1 + i % 16, 1, SIZE) for i in range(size)])
    ) as mesh:
        queries = device.query_set(size, emulated=emulated)
        for _ in range(3):
            answers = count(device, image, queries, mesh, parts(mesh, *range(size)))
            assert answers == [1 + i % 16 for i in range(size)]
        queries.destroy()


def test_draws_and_query_indices_may_change_after_the_call(
    device: Device, queries: QuerySet, bars: Mesh, image: Any
) -> None:
    draws, rows = parts(bars, 9, 10), np.array([3, 4])
    with device.render_pass(image):
        device.draw_counted(device.program(Colored), bars, draws, queries, rows)
        draws["count"], rows[:] = 0, 60
    assert queries.wait()[:6].tolist() == [-1, -1, -1, COUNTS[9], COUNTS[10], -1]


def test_an_answer_comes_without_waiting_for_it(
    device: Device, queries: QuerySet, bars: Mesh, image: Any
) -> None:
    with device.render_pass(image):
        device.draw_counted(device.program(Colored), bars, parts(bars, *range(64)), queries)
    assert wait_until(lambda: queries.is_finished)
    assert queries.visible_samples.tolist() == COUNTS


# -- kinds of draws ----------------------------------------------------------------------------------------


class Column(Shader):
    """Draws each instance two texels to the right of the one before it, with the draw index as red, and
    counts all fragments in `total`."""

    total: StorageRW[uint]

    def vertex(self, v: Corner) -> FlatShade:
        shift = vec4(0.25 * float(instance_index()), 0.0, 0.0, 0.0)
        return FlatShade(clip=v.position + shift, color=vec4(float(draw_index()), 0.0, 0.0, 1.0))

    def fragment(self, v: FlatShade) -> vec4:
        atomic_add(self.total[0], uint(1))
        return v.color


@pytest.mark.requires("draw_index")
def test_indexed_draws_have_their_bases_and_instances(device: Device, queries: QuerySet, image: Any) -> None:
    """The draw index is 0 in each of them, as in a command with a single draw."""
    rows = np.concatenate([texel_rectangle(0, 0, 2, 3, SIZE), texel_rectangle(0, 0, 2, 8, SIZE)])
    indices = np.arange(6)
    draws = np.zeros(4, DRAW)
    draws["count"] = 6
    draws["instances"] = [1, 3, 1, 2]
    draws["base_vertex"] = [0, 0, 6, 6]
    draws["base_instance"] = [0, 2, 7, 7]  # the second instance of the last draw is outside of the target
    with device.mesh(rows, indices) as mesh, device.storage(uint, 1) as total:
        with device.render_pass(image, clear=(0.4, 0.4, 0.4, 0.4)):
            device.draw_counted(device.program(Column), mesh, draws, queries, total=total)
        assert queries.wait()[:5].tolist() == [6, 18, 16, 16, -1]
        assert total.read()[0] == 6 + 18 + 16 + 16
        assert image.read()[0, :, 3].tolist() == [255, 255, 102, 102, *[255] * 6, *[102] * 4, 255, 255]
        assert not image.read()[0, :2, 0].any()


@pytest.mark.parametrize("indexed", [False, True])
@pytest.mark.parametrize("primitive", [Primitive.TRIANGLE_STRIP, Primitive.TRIANGLE_FAN, Primitive.QUADS])
def test_draws_may_be_of_any_primitive(
    device: Device, queries: QuerySet, image: Any, primitive: Primitive, indexed: bool
) -> None:
    order = [0, 1, 3, 2] if primitive is Primitive.TRIANGLE_STRIP else [0, 1, 2, 3]
    quads = []
    for width in range(1, 9):
        whole = texel_rectangle(0, 0, width, 4, SIZE)[[0, 1, 2, 5]]
        quads.append(whole[order])
    rows = np.concatenate(quads)
    with device.mesh(rows, np.arange(32) if indexed else None, primitive=primitive) as mesh:
        draws = mesh.draws(4 * np.arange(8), 4)
        assert count(device, image, queries, mesh, draws)[:8] == [4 * width for width in range(1, 9)]


def test_changed_indices_are_those_that_are_counted(device: Device, queries: QuerySet, image: Any) -> None:
    indices = np.arange(12, dtype="u4")
    with device.buffer(indices) as buffer, device.mesh(BARS[: 6 * 8], buffer) as mesh:
        draws = mesh.draws([0, 6], 6)
        assert count(device, image, queries, mesh, draws)[:2] == COUNTS[:2]
        buffer.write(indices + np.uint32(24))
        assert count(device, image, queries, mesh, draws)[:2] == COUNTS[4:6]


@pytest.mark.requires("alpha_test")
def test_samples_that_the_alpha_test_drops_are_not_counted(
    device: Device, queries: QuerySet, bars: Mesh, image: Any
) -> None:
    rows = BARS.copy()
    rows["color"][: 6 * 2, 3] = 0.2
    with (
        device.mesh(rows) as mesh,
        device.states(AlphaTest.ON, rhi.AlphaFunction.GREATER, rhi.AlphaReference(0.5)),
    ):
        assert count(device, image, queries, mesh, parts(mesh, *range(4)))[:4] == [0, 0, *COUNTS[2:4]]
    assert count(device, image, queries, bars, parts(bars, *range(4)))[:4] == COUNTS[:4]


@pytest.mark.requires("occlusion_queries", "conditional_rendering")
def test_draws_that_a_condition_drops_count_nothing(device: Device, bars: Mesh, image: Any) -> None:
    nothing, queries = device.occlusion_query(), device.query_set(64)
    program = device.program(Colored)
    for inverted in (False, True):
        with device.render_pass(image):
            with nothing:
                pass
            with device.conditional(nothing, inverted=inverted):
                device.draw_counted(program, bars, parts(bars, 8, 9), queries)
        assert queries.wait()[:2].tolist() == (COUNTS[8:10] if inverted else [0, 0])
    nothing.destroy()
    queries.destroy()


def test_counted_draws_are_drawn(device: Device, queries: QuerySet, image: Any) -> None:
    """Counted draws leave states and bindings as other draws do."""
    rows = np.concatenate([rectangle(-1, -1, 0, 1, color=(1, 0, 0, 1)), rectangle(0, -1, 1, 1)])
    with device.mesh(rows) as mesh:
        program = device.program(Colored)
        with device.render_pass(image, clear=(0, 0, 0, 1)):
            with device.states(ColorWrite.OFF):
                device.draw_counted(program, mesh, parts(mesh, 1), queries)
            device.draw_counted(program, mesh, parts(mesh, 0), queries)
            device.draw(program, mesh.view(6, 6))
        pixels = image.read()
        assert_same(pixels[:, :8], (255, 0, 0, 255))
        assert_same(pixels[:, 8:], 255)


class Doubled(Smooth):
    """Draws everything at twice the height."""

    def vertex(self, v: Corner) -> Shade:
        p = v.position
        return Shade(clip=vec4(p.x, 1.0 - 2.0 * (1.0 - p.y), p.z, p.w), color=v.color)


def test_each_call_has_its_own_program_and_mesh(
    device: Device, queries: QuerySet, bars: Mesh, image: Any
) -> None:
    other = device.query_set(2, emulated=queries.emulated)
    with device.mesh(BARS[6 * 8 :]) as later:
        with device.render_pass(image):
            device.draw_counted(device.program(Colored), later, parts(later, 0, 1, 2), queries)
            device.draw_counted(device.program(Doubled), bars, parts(bars, 1, 2), other)
        assert queries.wait()[:4].tolist() == [*COUNTS[8:11], -1]
    assert other.wait().tolist() == [2 * COUNTS[1], 2 * COUNTS[2]]
    other.destroy()


def test_queries_and_draws_are_counted(device: Device, queries: QuerySet, bars: Mesh, image: Any) -> None:
    before = device.statistics
    count(device, image, queries, bars, parts(bars, 1, 2, 3, 4), [9, 9, 8, 7])
    after = device.statistics
    assert (after.queries - before.queries, after.draws - before.draws) == (3, 4)


# -- in command buffers --------------------------------------------------------------------------------------


def test_a_recorded_set_answers_for_the_latest_submission(
    device: Device, queries: QuerySet, bars: Mesh, image: Any
) -> None:
    program = device.program(Colored)
    recorded = []
    for first in (0, 20):
        with device.record() as commands, commands.render_pass(image):
            commands.draw_counted(program, bars, parts(bars, *range(first, first + 8)), queries)
            commands.draw(program, bars)
        recorded.append(commands)
    assert not queries.is_finished
    before = device.statistics.queries
    for turn in (0, 1, 1, 0):
        device.submit(recorded[turn])
        assert queries.wait().tolist() == COUNTS[20 * turn : 20 * turn + 8] + [-1] * 56
    assert device.statistics.queries - before == 32
    assert count(device, image, queries, bars, parts(bars, 40), [1])[:3] == [-1, COUNTS[40], -1]
    device.submit(*recorded)
    assert queries.wait().tolist()[:8] == COUNTS[20:28]


@pytest.mark.requires("shading")
def test_an_unfinished_set_has_no_numbers_yet(device: Device) -> None:
    """Either the answers are available, or reading them raises an error."""
    queries = device.query_set(2)
    with device.texture((1024, 1024), Format.RGBA8) as image, device.mesh(np.tile(rectangle(), 30)) as mesh:
        with device.render_pass(image):
            device.draw_counted(device.program(Colored), mesh, mesh.draws([0, 0]), queries)
        try:
            early = queries.visible_samples
        except rhi.ValidationError as error:
            assert error.rule is rules.QUERY_UNFINISHED  # noqa: PT017 (both outcomes are valid)
            early = queries.wait()
        assert early.tolist() == [30 << 20] * 2
    queries.destroy()
