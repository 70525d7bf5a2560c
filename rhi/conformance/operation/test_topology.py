"""The texels that each topology covers, with and without indices, and the restart of strips."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import (
    BlendFunction,
    Buffer,
    BufferUsage,
    CullMode,
    Device,
    Format,
    IndirectDraws,
    Mesh,
    Primitive,
    StorageBuffer,
    Texture,
)
from rhi.conformance.compare import assert_mask, assert_same
from rhi.conformance.reference import SUBTEXELS, rasterise
from rhi.conformance.shaders import Colored, FlatColored
from rhi.conformance.shapes import centers, corners, window_to_clip
from rhi.conformance.single_draws import draw_once
from rhi.shading import Shader, StorageRW, global_id, uint

pytestmark = [pytest.mark.requires("draws", "shading"), pytest.mark.recorded_too]

SIZE = (16, 16)


@pytest.fixture
def image(device: Device) -> Iterator[Texture]:
    with device.texture(SIZE, Format.R8) as image:
        yield image


def draw_image(
    device: Device, primitive: Primitive, positions: Any, indices: Any = None, color: Any = (1, 1, 1, 1)
) -> NDArray[Any]:
    """Return the image of one draw without culling."""
    rows = corners(positions, color)
    return draw_once(
        device,
        SIZE,
        Format.RGBA8,
        rows,
        CullMode.NONE,
        shader=FlatColored,
        indices=indices,
        primitive=primitive,
    )


def covered(*triangles: Any) -> NDArray[np.bool_]:
    """Return the texels that triangles in window coordinates cover together."""
    mask = np.zeros(SIZE[::-1], bool)
    for triangle in triangles:
        mask |= rasterise(np.asarray(triangle) * SUBTEXELS, *SIZE)
    return mask


def test_points_cover_one_texel_each(device: Device) -> None:
    texels = np.array([(0, 0), (15, 0), (0, 15), (15, 15), (7, 3), (8, 12)])
    expected = np.zeros((16, 16), bool)
    expected[texels[:, 1], texels[:, 0]] = True
    assert_mask(draw_image(device, Primitive.POINTS, centers(texels, SIZE)), expected)


def test_points_outside_the_target_draw_nothing(device: Device) -> None:
    texels = np.array([(-1, 3), (16, 3), (3, -1), (3, 16)])
    assert_mask(draw_image(device, Primitive.POINTS, centers(texels, SIZE)), np.zeros((16, 16), bool))


@pytest.mark.requires("precise_lines")
@pytest.mark.parametrize(
    ("start", "end"),
    [((2, 5), (12, 5)), ((12, 5), (2, 5)), ((4, 1), (4, 14)), ((2, 2), (12, 12)), ((12, 2), (2, 12))],
)
def test_a_line_covers_the_texels_between_its_ends(
    device: Device, start: tuple[int, int], end: tuple[int, int]
) -> None:
    image = draw_image(device, Primitive.LINES, centers([start, end], SIZE))
    count = max(abs(end[0] - start[0]), abs(end[1] - start[1]))
    steps = np.arange(count + 1)
    x = start[0] + steps * (end[0] - start[0]) // count
    y = start[1] + steps * (end[1] - start[1]) // count
    expected = np.zeros((16, 16), bool)
    expected[y, x] = True
    # A device may include the last texel of the line or not (the diamond-exit rule excludes it).
    image[end[1], end[0]] = 255
    assert_mask(image, expected)


def test_lines_are_separate(device: Device) -> None:
    image = draw_image(device, Primitive.LINES, centers([(1, 1), (6, 1), (1, 9), (6, 9)], SIZE))
    assert_same(image[2:9], 0)
    assert image[1, 2:6].all()
    assert image[9, 2:6].all()


@pytest.mark.requires("precise_lines")
def test_a_line_strip_joins_its_vertices(device: Device) -> None:
    path = [(1, 1), (10, 1), (10, 10), (1, 10)]
    image = draw_image(device, Primitive.LINE_STRIP, centers(path, SIZE))[..., 0] > 0
    assert image[1, 1:11].all()
    assert image[1:11, 10].all()
    assert image[10, 2:11].all()
    assert not image[2:10, 1].any(), "a strip is not closed"
    assert not image[3:9, 3:9].any()


TRIANGLE_POINTS = [(1, 1), (13, 3), (5, 14), (2, 15), (15, 15), (9, 8)]


def test_triangles_take_three_vertices_each(device: Device) -> None:
    image = draw_image(device, Primitive.TRIANGLES, window_to_clip(TRIANGLE_POINTS, SIZE))
    assert_mask(image, covered(TRIANGLE_POINTS[:3], TRIANGLE_POINTS[3:]))


def test_vertices_left_over_draw_nothing(device: Device) -> None:
    image = draw_image(device, Primitive.TRIANGLES, window_to_clip(TRIANGLE_POINTS[:5], SIZE))
    assert_mask(image, covered(TRIANGLE_POINTS[:3]))


STRIP = [(1, 1), (2, 8), (7, 2), (8, 9), (14, 1), (15, 12)]


def test_a_triangle_strip_takes_each_vertex_with_the_two_before(device: Device) -> None:
    image = draw_image(device, Primitive.TRIANGLE_STRIP, window_to_clip(STRIP, SIZE))
    assert_mask(image, covered(*(STRIP[i : i + 3] for i in range(4))))


def test_the_triangles_of_a_strip_have_one_winding(device: Device) -> None:
    rows = corners(window_to_clip(STRIP, SIZE))
    with (
        device.texture(SIZE, Format.RGBA8) as image,
        device.mesh(rows, primitive=Primitive.TRIANGLE_STRIP) as mesh,
    ):
        for culled, expected in (
            (CullMode.BACK, covered(*(STRIP[i : i + 3] for i in range(4)))),
            (CullMode.FRONT, covered()),
        ):
            with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(culled):
                device.draw(device.program(FlatColored), mesh)
            assert_mask(image.read(), expected)


def draw_sum(
    device: Device, primitive: Primitive, positions: NDArray[Any], indices: NDArray[Any]
) -> NDArray[Any]:
    """Return the number of draws of each texel."""
    states = (CullMode.NONE, BlendFunction.ADDITIVE)
    rows, clear = corners(positions), (0, 0, 0, 0)
    return draw_once(
        device,
        SIZE,
        Format.R16F,
        rows,
        *states,
        shader=FlatColored,
        indices=indices,
        primitive=primitive,
        clear=clear,
    )


FAN = [(8, 8), (15, 8), (12, 1), (5, 1), (1, 7), (4, 15)]


def test_a_triangle_fan_turns_around_its_first_vertex(device: Device) -> None:
    image = draw_image(device, Primitive.TRIANGLE_FAN, window_to_clip(FAN, SIZE))
    assert_mask(image, covered(*([FAN[0], FAN[i], FAN[i + 1]] for i in range(1, 5))))


QUADS = [(1, 7), (7, 6), (6, 1), (2, 2), (9, 15), (15, 15), (14, 8), (9, 9)]


def test_quads_are_two_triangles_each(device: Device) -> None:
    image = draw_image(device, Primitive.QUADS, window_to_clip(QUADS, SIZE))
    q = QUADS
    assert_mask(image, covered(q[:3], [q[0], q[2], q[3]], q[4:7], [q[4], q[6], q[7]]))


def test_quads_that_are_not_convex_show_which_diagonal_is_used(device: Device) -> None:
    quad = [(1, 1), (3, 14), (6, 6), (14, 3)]
    image = draw_image(device, Primitive.QUADS, window_to_clip(quad, SIZE))
    assert_mask(image, covered(quad[:3], [quad[0], quad[2], quad[3]]))


@pytest.mark.parametrize("dtype", ["u2", "u4"])
@pytest.mark.parametrize("primitive", list(Primitive), ids=lambda p: p.name)
def test_indexed_vertices_draw_the_same_texels_as_consecutive_vertices(
    device: Device, primitive: Primitive, dtype: str
) -> None:
    order = np.array([3, 0, 4, 1, 5, 2, 7, 6])
    points = np.array([(1, 2), (14, 1), (9, 6), (3, 13), (12, 14), (6, 8), (2, 9), (15, 9)])
    positions = centers(points, SIZE)
    indexed = draw_image(device, primitive, positions, order.astype(dtype))
    assert indexed.any()
    assert_same(indexed, draw_image(device, primitive, positions[order]))


@pytest.mark.parametrize(("dtype", "restart"), [("u2", 0xFFFF), ("u4", 0xFFFFFFFF)], ids=["uint16", "uint32"])
@pytest.mark.parametrize(
    "primitive", [Primitive.TRIANGLE_STRIP, Primitive.TRIANGLE_FAN], ids=lambda p: p.name
)
def test_the_last_index_restarts(device: Device, primitive: Primitive, dtype: str, restart: int) -> None:
    points = [(1, 1), (1, 6), (6, 1), (9, 9), (9, 15), (15, 9)]
    indices = np.array([0, 1, 2, restart, 3, 4, 5], dtype)
    image = draw_image(device, primitive, window_to_clip(points, SIZE), indices)
    assert_mask(image, covered(points[:3], points[3:]))


def split_runs(indices: list[int], restart: int) -> list[list[int]]:
    """Return the indices between restarts."""
    runs: list[list[int]] = [[]]
    for index in indices:
        if index == restart:
            runs.append([])
        else:
            runs[-1].append(index)
    return runs


def list_corners(primitive: Primitive, run: list[int]) -> list[int]:
    """Return the corners of the points, lines or triangles of indices without restarts, one after the
    other."""
    count = len(run)
    if primitive is Primitive.QUADS:
        starts = range(0, count - 3, 4)
        return [run[i + corner] for i in starts for corner in (0, 1, 2, 0, 2, 3)]
    if primitive is Primitive.TRIANGLE_FAN:
        return [corner for i in range(1, count - 1) for corner in (run[i], run[i + 1], run[0])]
    if primitive is Primitive.TRIANGLE_STRIP:
        swap = [(0, 1, 2), (0, 2, 1)]
        return [run[i + corner] for i in range(count - 2) for corner in swap[i % 2]]
    if primitive is Primitive.LINE_STRIP:
        return [corner for i in range(count - 1) for corner in (run[i], run[i + 1])]
    size = {Primitive.POINTS: 1, Primitive.LINES: 2, Primitive.TRIANGLES: 3}[primitive]
    return run[: count // size * size]


LISTED = {
    Primitive.POINTS: Primitive.POINTS,
    Primitive.LINES: Primitive.LINES,
    Primitive.LINE_STRIP: Primitive.LINES,
}
RESTARTED = {
    "begins": [-1, 0, 1, 2, 3],
    "inside": [0, 1, -1, 0, 1, 2, 3],
    "ends": [0, 1, 2, 3, -1],
    "the last corner": [0, 1, 2, -1],
    "the last corner, and more": [0, 1, 2, -1, 0, 1, 2, 3],
    "several": [0, -1, -1, -1, 0, 1, 2, 3],
    "nothing else": [-1, -1, -1, -1, -1],
    "incomplete": [0, 1, 2, 3, 4, 5],
    "incomplete twice": [4, 5, 6, 7, 1, -1, 0, 1, 2, 3, 0],
}


@pytest.mark.parametrize("dtype", ["u2", "u4"])
@pytest.mark.parametrize("primitive", list(Primitive), ids=lambda p: p.name)
def test_the_restart_index_drops_an_incomplete_primitive_and_begins_a_new_one(
    device: Device, primitive: Primitive, dtype: str
) -> None:
    """Of lists of points, lines and triangles, on devices that declare it; incomplete ones are dropped on
    all."""
    restart = int(np.iinfo(dtype).max)
    random = np.random.default_rng([8, list(Primitive).index(primitive)])
    cases = [*RESTARTED.values()]
    cases += [random.choice([*range(8), -1], size).tolist() for size in (1, 7, 12, 23, 40)]
    rows = centers([(1, 2), (14, 1), (13, 13), (2, 14), (8, 1), (15, 8), (7, 15), (1, 9)], SIZE)
    may_restart = device.capabilities.list_restart or primitive not in (
        Primitive.POINTS,
        Primitive.LINES,
        Primitive.TRIANGLES,
    )
    for case in cases:
        if -1 in case and not may_restart:
            continue
        indices = np.array([restart if index < 0 else index for index in case], dtype)
        listed = [
            corner for run in split_runs(indices.tolist(), restart) for corner in list_corners(primitive, run)
        ]
        image = draw_sum(device, primitive, rows, indices)
        if listed:
            kind = LISTED.get(primitive, Primitive.TRIANGLES)
            assert_same(image, draw_sum(device, kind, rows, np.array(listed, "u4")))
        else:
            assert_same(image, 0)


@pytest.mark.parametrize("dtype", ["u2", "u4"])
def test_a_range_of_quads_restarts_for_itself(device: Device, dtype: str) -> None:
    """Draws of parts of the indices, and after they were written anew."""
    restart = int(np.iinfo(dtype).max)
    random = np.random.default_rng(9)
    rows = corners(centers([(1, 2), (14, 1), (13, 13), (2, 14), (8, 1), (15, 8), (7, 15), (1, 9)], SIZE))
    with device.texture(SIZE, Format.R16F) as image, device.buffer(24, dtype) as buffer:
        program = device.program(FlatColored)
        with device.mesh(rows, buffer, primitive=Primitive.QUADS) as mesh:
            for _ in range(6):
                indices = random.choice([*range(8), restart], 24).astype(dtype)
                buffer.write(indices)
                for first, count in ((0, 24), (3, 9), (5, 18), (8, 4), (20, 3)):
                    part = indices[first : first + count].tolist()
                    runs = split_runs(part, restart)
                    listed = [corner for run in runs for corner in list_corners(Primitive.QUADS, run)]
                    with device.render_pass(image, clear=(0, 0, 0, 0)):
                        with device.states(CullMode.NONE, BlendFunction.ADDITIVE):
                            device.draw(program, mesh.view(first, count))
                    drawn = image.read()
                    with device.render_pass(image, clear=(0, 0, 0, 0)):
                        if listed:
                            with (
                                device.states(CullMode.NONE, BlendFunction.ADDITIVE),
                                device.mesh(rows, np.array(listed, "u4")) as triangles,
                            ):
                                device.draw(program, triangles)
                    assert_same(drawn, image.read())


LISTS = [Primitive.POINTS, Primitive.LINES, Primitive.TRIANGLES]
RANGES = [(0, 24), (3, 9), (5, 18), (8, 4), (20, 3), (11, 1)]


def written(device: Device, buffer: Buffer, values: NDArray[Any]) -> None:
    buffer.write(values)


def written_in_halves(device: Device, buffer: Buffer, values: NDArray[Any]) -> None:
    buffer.write(values[12:], 12)
    buffer.write(values[:12])


def copied(device: Device, buffer: Buffer, values: NDArray[Any]) -> None:
    with device.buffer(values) as source:
        source.copy_to(buffer)


def drawn_directly(device: Device, mesh: Mesh) -> None:
    for first, count in RANGES:
        device.draw(device.program(FlatColored), mesh.view(first, count))


def drawn_at_once(device: Device, mesh: Mesh) -> None:
    firsts, counts = zip(*RANGES, strict=True)
    device.draw_many(device.program(FlatColored), mesh, mesh.draws(firsts, counts))


def drawn_indirectly(device: Device, mesh: Mesh) -> None:
    firsts, counts = zip(*RANGES, strict=True)
    with device.buffer(mesh.draws(firsts, counts)) as arguments:
        device.draw_indirect(device.program(FlatColored), mesh, IndirectDraws(arguments, len(RANGES)))


def drawn_by_a_count(device: Device, mesh: Mesh) -> None:
    firsts, counts = zip(*RANGES, strict=True)
    draws = mesh.draws([*firsts, 0], [*counts, 24])
    with device.buffer(draws) as arguments, device.buffer(np.array([len(RANGES)], "u4")) as count:
        indirect = IndirectDraws(arguments, len(draws), count=count)
        device.draw_indirect(device.program(FlatColored), mesh, indirect)


def drawn_clipped(device: Device, mesh: Mesh) -> None:
    firsts, counts = zip(*RANGES, strict=True)
    whole = [(0, 0, *SIZE)] * len(RANGES)
    device.draw_clipped(device.program(FlatColored), mesh, mesh.draws(firsts, counts), whole)


@pytest.mark.parametrize("dtype", ["u2", "u4"])
@pytest.mark.parametrize("usage", [BufferUsage.STATIC, BufferUsage.STREAM], ids=["static", "stream"])
@pytest.mark.parametrize("write", [written, written_in_halves, copied])
@pytest.mark.parametrize(
    "draw", [drawn_directly, drawn_at_once, drawn_indirectly, drawn_by_a_count, drawn_clipped]
)
def test_lists_restart_however_they_are_written_and_drawn(
    device: Device,
    draw: Callable[[Device, Mesh], None],
    write: Callable[[Device, Buffer, NDArray[Any]], None],
    usage: BufferUsage,
    dtype: str,
) -> None:
    """Each version of the indices, without restarts in between, by ranges that begin anywhere."""
    if not device.capabilities.list_restart:
        pytest.skip(f"{device.backend_name} declares no list_restart")
    restart = int(np.iinfo(dtype).max)
    random = np.random.default_rng(10)
    positions = centers([(1, 2), (14, 1), (13, 13), (2, 14), (8, 1), (15, 8), (7, 15), (1, 9)], SIZE)
    rows = corners(positions)
    states = (CullMode.NONE, BlendFunction.ADDITIVE)
    with device.texture(SIZE, Format.R16F) as image, device.buffer(24, dtype, usage=usage) as buffer:
        for primitive in LISTS:
            with device.mesh(rows, buffer, primitive=primitive) as mesh:
                for choices in ([*range(8), restart], [*range(8)], [0, 5, restart]):
                    indices = random.choice(choices, 24).astype(dtype)
                    write(device, buffer, indices)
                    with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(*states):
                        draw(device, mesh)
                    listed = [
                        corner
                        for first, count in RANGES
                        for run in split_runs(indices[first : first + count].tolist(), restart)
                        for corner in list_corners(primitive, run)
                    ]
                    assert_same(image.read(), draw_sum(device, primitive, positions, np.array(listed, "u4")))


def test_a_line_strip_restarts(device: Device) -> None:
    indices = np.array([0, 1, 0xFFFF, 2, 3], "u2")
    image = draw_image(device, Primitive.LINE_STRIP, centers([(1, 1), (6, 1), (1, 9), (6, 9)], SIZE), indices)
    assert_same(image[2:9], 0)
    assert image[1, 2:6].all()
    assert image[9, 2:6].all()


def test_65535_is_an_index_like_any_other_among_uint32(device: Device) -> None:
    positions = np.zeros((65536, 2)) - 2.0
    positions[[0, 1, 65535]] = window_to_clip([(0, 0), (0, 16), (16, 0)], SIZE)
    image = draw_image(device, Primitive.TRIANGLES, positions, np.array([0, 1, 65535], "u4"))
    assert_mask(image, covered([(0, 0), (0, 16), (16, 0)]))


def test_primitives_are_drawn_in_order(device: Device) -> None:
    color = np.repeat([(1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1)], 3, axis=0)
    positions = np.tile(window_to_clip([(0, 0), (0, 32), (32, 0)], SIZE), (3, 1))
    rows = corners(positions, color)
    assert_same(draw_once(device, SIZE, Format.RGBA8, rows), (0, 0, 255, 255))


FLAT = np.array([(1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1), (1, 1, 0, 1)], float)


@pytest.mark.parametrize(
    ("primitive", "positions", "areas"),
    [
        (Primitive.TRIANGLES, [(0, 0), (0, 32), (32, 0)], {0: [(0, 0), (0, 32), (32, 0)]}),
        (Primitive.QUADS, [(0, 0), (0, 16), (16, 16), (16, 0)], {0: [(0, 0), (0, 32), (32, 0)]}),
        # The second triangle of a strip begins with its second vertex, and is drawn with the other winding.
        (Primitive.TRIANGLE_STRIP, [(0, 0), (0, 16), (16, 0), (16, 16)],
         {0: [(0, 0), (0, 16), (16, 0)], 1: [(0, 16), (16, 16), (16, 0)]}),
    ],
    ids=["triangles", "quads", "strip"],
)  # fmt: skip
def test_a_flat_value_is_that_of_the_first_vertex(
    device: Device,
    primitive: Primitive,
    positions: list[tuple[int, int]],
    areas: dict[int, list[tuple[int, int]]],
) -> None:
    image = draw_image(device, primitive, window_to_clip(positions, SIZE), color=FLAT[: len(positions)])
    expected = sum(covered(area)[..., None] * FLAT[vertex] * 255 for vertex, area in areas.items())
    assert_same(image, expected)


# -- quads -------------------------------------------------------------------------------------------------

BOXES = [
    [(4 * i, y), (4 * i, y + 3), (4 * i + 3, y + 3), (4 * i + 3, y)] for y in (0, 4, 8, 12) for i in range(4)
]


def boxes(quad_numbers: Any) -> NDArray[np.bool_]:
    """Return the texels covered by the quads with these numbers, out of 16 side by side."""
    return covered(*(part for i in quad_numbers for part in (BOXES[i][:3], [BOXES[i][0], *BOXES[i][2:]])))


@pytest.mark.parametrize("indexed", [None, "u2", "u4"])
@pytest.mark.parametrize(("first", "count"), [(0, 16), (0, 1), (3, 5), (15, 1), (4, 0)])
def test_a_view_of_quads_draws_its_quads_only(
    device: Device, first: int, count: int, indexed: str | None, image: Texture
) -> None:
    rows = corners(window_to_clip(np.reshape(BOXES, (-1, 2)), SIZE))
    indices = None if indexed is None else np.arange(64, dtype=indexed)
    with device.mesh(rows, indices, primitive=Primitive.QUADS) as mesh:
        with device.render_pass(image), device.states(CullMode.NONE):
            device.draw(device.program(Colored), mesh.view(4 * first, 4 * count))
        assert_mask(image.read(), boxes(range(first, first + count)))


def test_indexed_quads_take_their_corners_from_anywhere(device: Device, image: Texture) -> None:
    rows = corners(window_to_clip(np.reshape(BOXES, (-1, 2)), SIZE))
    order = np.arange(64).reshape(16, 4)[[9, 2, 14]].reshape(-1)
    shuffled = np.random.default_rng(0).permutation(64)
    with device.mesh(
        rows[shuffled], np.argsort(shuffled)[order].astype("u2"), primitive=Primitive.QUADS
    ) as mesh:
        with device.render_pass(image), device.states(CullMode.NONE):
            device.draw(device.program(Colored), mesh)
        assert_mask(image.read(), boxes((9, 2, 14)))


def test_indexed_quads_add_their_base_vertex(device: Device, image: Texture) -> None:
    rows = corners(window_to_clip(np.reshape(BOXES, (-1, 2)), SIZE))
    with device.mesh(rows, np.arange(8, dtype="u2"), primitive=Primitive.QUADS) as mesh:
        with device.render_pass(image), device.states(CullMode.NONE):
            device.draw(device.program(Colored), mesh.view(4, 4, base_vertex=20))
        assert_mask(image.read(), boxes((6,)))


class Shifted(Shader):
    """Moves the indices of quads on by 24, to the quads 6 further."""

    indices: StorageRW[uint]

    def compute(self) -> None:
        self.indices[global_id().x] += uint(24)


CHANGES: dict[str, Callable[[Device, StorageBuffer[Any], NDArray[Any]], object]] = {
    "written": lambda device, indices, later: indices.owner.write(later),
    "written in part": lambda device, indices, later: indices.owner.write(later[4:], 4),
    "copied": lambda device, indices, later: device.buffer(later).copy_to(indices.owner),
    "cleared": lambda device, indices, later: indices.owner.clear(),
    "computed": lambda device, indices, later: device.dispatch(device.program(Shifted), 8, indices=indices),
}


@pytest.mark.parametrize(
    "change", [*list(CHANGES)[:-1], pytest.param("computed", marks=pytest.mark.requires("compute"))]
)
@pytest.mark.parametrize("first", [0, 4])
def test_indexed_quads_follow_their_indices(device: Device, change: str, first: int, image: Texture) -> None:
    """A draw of quads doesn't reuse cached indices after they have changed."""
    rows = corners(window_to_clip(np.reshape(BOXES, (-1, 2)), SIZE))
    now = np.arange(8, dtype="u4") + 4
    expected = {"cleared": (), "written in part": (1, 8)}.get(change, (7, 8))
    with (
        device.storage(uint, now) as indices,
        device.mesh(rows, indices.owner, primitive=Primitive.QUADS) as mesh,
    ):
        for _ in range(2):
            with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(CullMode.NONE):
                device.draw(device.program(Colored), mesh.view(first))
            assert_mask(image.read(), boxes((1, 2)[first // 4 :]))
        CHANGES[change](device, indices, now + 24)
        for _ in range(2):
            with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(CullMode.NONE):
                device.draw(device.program(Colored), mesh.view(first))
            assert_mask(image.read(), boxes(expected[first // 4 :]))


def test_a_view_of_indexed_quads_begins_at_any_index(device: Device, image: Texture) -> None:
    rows = corners(window_to_clip(np.reshape(BOXES, (-1, 2)), SIZE))
    indices = np.array([*range(8), 0, *range(20, 28)], "u2")
    with device.mesh(rows, indices, primitive=Primitive.QUADS) as mesh:
        for view, expected in ((mesh.view(0, 8), (0, 1)), (mesh.view(9), (5, 6)), (mesh.view(13), (6,))):
            with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(CullMode.NONE):
                device.draw(device.program(Colored), view)
            assert_mask(image.read(), boxes(expected))


def test_corners_left_over_make_no_quad(device: Device) -> None:
    rows = corners(window_to_clip(np.reshape(BOXES, (-1, 2))[:11], SIZE))
    assert_mask(
        draw_once(device, SIZE, Format.R8, rows, CullMode.NONE, primitive=Primitive.QUADS), boxes((0, 1))
    )


def test_quads_are_drawn_once_per_instance(device: Device) -> None:
    rows = corners(window_to_clip(np.reshape(BOXES, (-1, 2)), SIZE))
    with device.texture(SIZE, Format.R16F) as image, device.mesh(rows, primitive=Primitive.QUADS) as mesh:
        with device.render_pass(image), device.states(CullMode.NONE, BlendFunction.ADDITIVE):
            device.draw(device.program(Colored), mesh.view(8, 4), 3)
        assert_same(image.read(), boxes((2,)) * 3)


def test_more_quads_than_16_bits_can_count(device: Device, image: Texture) -> None:
    """The last of 20,000 quads with 80,000 vertices are drawn at the right place."""
    positions = np.full((20_000, 4, 2), -3.0)
    for quad, box in ((0, 3), (16_384, 5), (19_999, 12)):
        positions[quad] = window_to_clip(BOXES[box], SIZE)
    with device.mesh(corners(positions.reshape(-1, 2)), primitive=Primitive.QUADS) as mesh:
        with device.render_pass(image), device.states(CullMode.NONE):
            device.draw(device.program(Colored), mesh)
        assert_mask(image.read(), boxes((3, 5, 12)))


def test_a_strip_with_a_base_vertex_restarts_at_the_last_index(device: Device, image: Texture) -> None:
    """The restart index is compared before the base vertex is added."""
    points = [(0, 0), (1, 1), (1, 6), (6, 1), (9, 9), (9, 15), (15, 9)]
    indices = np.array([0, 1, 2, 0xFFFF, 3, 4, 5], "u2")
    rows = corners(window_to_clip(points, SIZE))
    with device.mesh(rows, indices, primitive=Primitive.TRIANGLE_STRIP) as mesh:
        with device.render_pass(image), device.states(CullMode.NONE):
            device.draw(device.program(Colored), mesh.view(base_vertex=1))
        assert_mask(image.read(), covered(points[1:4], points[4:]))
