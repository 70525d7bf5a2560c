"""Gathering of draws; neither pieces, slices nor lists of tiles affect the image."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES
from numpy.typing import NDArray

import rhi
from rhi.backends.cl import cl_context
from rhi.backends.cl.cl_backend import ClBackend
from rhi.backends.cl.memory import pools as memory
from rhi.backends.cl.raster import draw_tables, launcher
from rhi.conformance.compare import assert_mask
from rhi.conformance.reference import SUBTEXELS, rasterise
from rhi.conformance.shaders import Bare, Colored, Corner, Tint, Tinted
from rhi.conformance.shapes import corners, rectangle, window_to_clip
from rhi.conformance.single_draws import draw_once
from rhi.errors import DeviceError
from rhi.shading import Shader, instance_index, vec2, vec4

SIZE = (200, 150)


@pytest.fixture
def device() -> Iterator[rhi.Device]:
    with rhi.create_device("cl") as created:
        yield created


def random_corners(count: int, seed: int = 0) -> NDArray[Any]:
    """Return triangles of all sizes, each in another color, so that their order is visible."""
    rng = np.random.default_rng(seed)
    middle, size = rng.uniform(-1, 1, (count, 1, 2)), 2.0 ** rng.uniform(-6, 1, (count, 1, 1))
    positions = middle + size * rng.uniform(-1, 1, (count, 3, 2))
    colors = np.repeat(rng.uniform(0, 1, (count, 4)), 3, axis=0)
    return corners(positions.reshape(-1, 2), colors)


def render_triangles(device: rhi.Device, rows: NDArray[Any], parts: int = 1) -> NDArray[Any]:
    """Draw all triangles in `parts` draws; return the image."""
    with device.texture(SIZE, rhi.Format.RGBA8) as image, device.mesh(rows) as mesh:
        ends = np.linspace(0, len(rows) // 3, parts + 1).astype(int) * 3
        with (
            device.render_pass(image, clear=(0, 0, 0, 0)),
            device.states(rhi.CullMode.NONE, rhi.DepthWrite.OFF),
        ):
            for begin, end in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
                device.draw(device.program(Colored), mesh.view(first=begin, count=end - begin))
        return image.read()


def count_survivors(device: rhi.Device) -> int:
    """Return the number of records that set-up made in the last slice."""
    backend = device.backend_as(ClBackend)
    memory, state = (
        backend._rasteriser._launcher._scratch.pools["survivors"]._memory,
        backend._rasteriser._batch.state,
    )
    assert state is not None
    backend.context.queue.finish()
    counts = memory.view(np.uint32)[: int(state.table["chunks"])]
    return int(counts.sum())


# -- what ends a batch ---------------------------------------------------------------------------------------


def test_draws_of_one_program_are_one_batch(device: rhi.Device, launches: list[str]) -> None:
    render_triangles(device, random_corners(60), parts=20)
    assert launches.count("raster") == 1


def test_bindings_of_draws_do_not_end_a_batch(device: rhi.Device, launches: list[str]) -> None:
    """Meshes, viewports and culling don't end a batch either; each draw has its own."""
    tints = [device.uniform(Tint(color=(i / 255, 0, 0, 1))) for i in range(1, 9)]
    meshes = [device.mesh(rectangle()[:: 1 if i % 2 else -1]) for i in range(8)]
    with device.texture((64, 4), rhi.Format.RGBA8) as image:
        with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(rhi.DepthWrite.OFF):
            for i in range(8):
                culled = rhi.CullMode.BACK if i % 2 else rhi.CullMode.FRONT
                with device.states(rhi.Viewport(8 * i, 0, 8, 4), culled):
                    device.draw(device.program(Tinted), meshes[i], tint=tints[i])
        assert image.read()[0, :, 0].tolist() == np.repeat(np.arange(1, 9), 8).tolist()
    assert launches.count("raster") == 1


def test_states_that_are_compiled_end_a_batch(device: rhi.Device, launches: list[str]) -> None:
    rows = random_corners(6)
    with (
        device.texture(SIZE, rhi.Format.RGBA8) as image,
        device.mesh(rows) as mesh,
        device.render_pass(image),
    ):
        device.draw(device.program(Colored), mesh)
        with device.states(rhi.BlendFunction.ADDITIVE):
            device.draw(device.program(Colored), mesh)
    assert launches.count("raster") == 2


@pytest.mark.parametrize("wrong", [1.0, None, "1", -1, 1 << 64], ids=repr)
@pytest.mark.parametrize("prepared", [True, False], ids=["prepared", "by the contract"])
def test_a_draw_that_fails_leaves_its_batch_as_it_was(device: rhi.Device, wrong: Any, prepared: bool) -> None:
    """Part of a row would shift all rows behind it, whose words would then be read as others: as
    addresses."""
    program, colors = device.program(Tinted), np.arange(1, 8) / 8
    with device.texture((8, 1), rhi.Format.R32F) as image, device.mesh(rectangle()) as mesh:
        tints = [device.uniform(Tint(color=(color, 0, 0, 0))) for color in colors]
        with device.render_pass(image):
            for i, tint in enumerate(tints):
                with device.states(rhi.Scissor(i, 0, 1, 1)):
                    device.draw(program, mesh, tint=tint)
                with pytest.raises((TypeError, OverflowError)):  # what the front end refuses
                    if prepared:
                        mesh.prepared_draws[program](wrong)
                    else:
                        program.draw_unprepared(mesh, wrong)
        assert image.read()[0].tolist() == [*colors, 0]


def test_indices_that_change_between_draws_name_other_vertices(device: rhi.Device) -> None:
    rows = np.concatenate([rectangle(-1, -1, 0, 1), rectangle(0, -1, 1, 1)])
    with (
        device.texture((2, 1), rhi.Format.RGBA8) as image,
        device.mesh(rows, np.arange(6, dtype="u4")) as mesh,
    ):
        for first, expected in ((0, [255, 0]), (6, [0, 255])):
            mesh.data.index_buffer.write(np.arange(first, first + 6, dtype="u4"))
            with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(rhi.DepthWrite.OFF):
                device.draw(device.program(Colored), mesh)
            assert image.read()[0, :, 0].tolist() == expected


# -- pieces, slices, lists -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "limits",
    [
        {"_SLICE_GROUPS": 16},
        {"_PIECE_GROUPS": 16},
        {"_LIST_WORDS": 16, "_LISTED_PER_RECORD": 0},
        {"_FEW_GROUPS": 1 << 20},
        {"_CHUNKS": 2},
        {"_MIN_CHUNK": 1, "_VERTEX_CHUNK": 1},
    ],
    ids=lambda limits: next(iter(limits)),
)
def test_limits_of_memory_do_not_show(
    device: rhi.Device, monkeypatch: pytest.MonkeyPatch, launches: list[str], limits: dict[str, int]
) -> None:
    rows = random_corners(900)
    usual = render_triangles(device, rows, parts=3)
    before = len(launches)
    for name, value in limits.items():
        monkeypatch.setattr(draw_tables if name == "_PIECE_GROUPS" else launcher, name, value)
    assert (render_triangles(device, rows, parts=3) == usual).all()
    assert (usual[..., 3] > 0).mean() > 0.9
    if set(limits) & {"_SLICE_GROUPS", "_PIECE_GROUPS"}:
        assert len(launches) - before > before
    if "_FEW_GROUPS" in limits:
        assert "scatter" in launches[:before]
        assert "scatter" not in launches[before:]


def test_a_triangle_in_flight_takes_at_most_200_bytes(device: rhi.Device) -> None:
    """Beyond a slice, memory grows with the vertices but not with the triangles."""
    grid = 500
    y, x = np.mgrid[0:grid, 0:grid] / (grid - 1) * 2 - 1
    rows = corners(np.stack([x.ravel(), y.ravel()], axis=1))
    a = (np.arange(grid - 1)[:, None] * grid + np.arange(grid - 1)).ravel()
    indices = np.stack([a, a + 1, a + grid, a + 1, a + grid + 1, a + grid], axis=1).astype("u4")
    assert (
        draw_once(device, (64, 64), rhi.Format.RGBA8, rows, rhi.CullMode.NONE, indices=indices.ravel()) > 0
    ).any()
    pools = device.backend_as(ClBackend)._rasteriser._launcher._scratch.pools
    assert sum(pool.size for pool in pools.values()) <= 200 * 2 * (grid - 1) ** 2


class SquareGrid(Shader):
    """A square for each instance, row by row from the top left, 512 per row."""

    def vertex(self, v: Corner) -> Bare:
        i = instance_index()
        position = vec2(float(i % 512), float(i // 512)) / 256.0 - 1.0
        return Bare(clip=vec4(position + (v.position.xy + 1.0) / 512.0, 0.5, 1.0))

    def fragment(self, v: Bare) -> vec4:
        return vec4(1.0)


@pytest.mark.parametrize("before", [0, 1], ids=["alone", "behind_another"])
def test_many_instances_take_no_more_memory_than_many_draws(device: rhi.Device, before: int) -> None:
    """Instances are processed in pieces: at most 200 bytes per triangle, and each instance in its place."""
    instances, program = 512 * 480, device.program(SquareGrid)
    draws_of = [(512 * 500, 512 * 12), (512, instances)][1 - before :]
    queries = [device.occlusion_query() for _ in draws_of]
    with device.texture((512, 512), rhi.Format.R8) as image, device.mesh(rectangle()) as mesh:
        with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(rhi.CullMode.NONE):
            for query, (first, count) in zip(queries, draws_of, strict=True):
                with query:
                    device.draw(program, mesh.view(base_instance=first), count)
        rows = (image.read()[::-1] > 0).all(axis=1)
    assert np.flatnonzero(rows).tolist() == [*range(1, 481), *range(500, 512)][: 480 + 12 * before]
    assert [query.wait() for query in queries] == [count for _, count in draws_of]
    pools = device.backend_as(ClBackend)._rasteriser._launcher._scratch.pools
    assert sum(pool.size for pool in pools.values()) <= 200 * 2 * instances


@pytest.mark.parametrize("instances", [1 << 20, (1 << 31) - 1])
def test_draws_split_into_pieces_are_each_instance_once(
    monkeypatch: pytest.MonkeyPatch, instances: int
) -> None:
    monkeypatch.setattr(draw_tables, "_FIRST_PIECE_GROUPS", 1 << 19)
    groups, counts = np.array([1, 3, 1 << 20, 0, 7], np.int32), np.array([instances, 0, 3, 5, 1])
    which, parts, done = draw_tables.split_instances(groups, counts)
    assert np.array_equal(np.bincount(which, parts), counts)
    assert (parts * groups[which] <= np.maximum(1 << 19, groups[which])).all()
    ends = np.cumsum(parts) - np.repeat(np.cumsum(counts) - counts, np.bincount(which))
    assert np.array_equal(done, ends - parts)


def test_tables_of_many_pages_draw_the_same(device: rhi.Device, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = random_corners(200)
    usual = render_triangles(device, rows)
    monkeypatch.setattr(memory, "_PAGE_BYTES", 1 << 12)
    with rhi.create_device("cl") as small_pages:
        for parts in (1, 40):
            assert (render_triangles(small_pages, rows, parts) == usual).all()


def test_a_device_that_does_not_read_host_memory_in_place_has_no_draws(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(cl_context, "probe", lambda *_: False)
    with rhi.create_device("cl") as device:
        assert not device.capabilities.draws
        with pytest.raises(rhi.ValidationError, match=r"^\[device-capability\]"):
            device.program(Colored)


# -- errors --------------------------------------------------------------------------------------------------


def test_out_of_memory_names_the_draw_and_the_device_goes_on(
    device: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = random_corners(50)
    usual = render_triangles(device, rows)

    def fail(*_: object) -> None:
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(memory.Pool, "reserve", fail)
        with pytest.raises(DeviceError, match=r"^\[device-out-of-memory\]"):
            render_triangles(device, random_corners(500))  # more than there is memory for
    assert (render_triangles(device, rows) == usual).all()


# -- queries -------------------------------------------------------------------------------------------------


def test_each_draw_of_a_batch_counts_for_its_own_query(device: rhi.Device, launches: list[str]) -> None:
    queries = [device.occlusion_query() for _ in range(600)]  # more than a page of counters
    meshes = [device.mesh(rectangle(-1, -1, -1 + (i + 1) / 8, 1)) for i in range(16)]
    with device.texture((16, 4), rhi.Format.R8) as image:
        with (
            device.render_pass(image),
            device.states(rhi.CullMode.NONE, rhi.ColorWrite.OFF, rhi.DepthWrite.OFF),
        ):
            for i, query in enumerate(queries):
                with query:
                    device.draw(device.program(Colored), meshes[i % 16])
        assert [query.wait() for query in queries] == [4 * (i % 16 + 1) for i in range(600)]
    assert launches.count("raster") == 1


@pytest.fixture
def bars(device: rhi.Device) -> Iterator[rhi.Mesh]:
    """16 rectangles; of a target of 16 x 4 texels the i-th covers 4 (i + 1)."""
    with device.mesh(np.concatenate([rectangle(-1, -1, -1 + (i + 1) / 8, 1) for i in range(16)])) as bars:
        yield bars


def test_an_array_of_draws_that_comes_again_brings_its_table(
    device: rhi.Device, bars: rhi.Mesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    table_rows: list[int] = []
    number = draw_tables.number_groups

    def note(*args: Any) -> Any:
        table_rows.append(len(args[0]))
        return number(*args)

    monkeypatch.setattr(draw_tables, "number_groups", note)
    queries = device.query_set(16)
    array = bars.draws(6 * np.arange(16), 6)
    with (
        device.texture((16, 4), rhi.Format.R8) as image,
        device.states(rhi.ColorWrite.OFF, rhi.DepthWrite.OFF),
    ):
        for rows in (range(16), range(16), range(15, -1, -1)):
            with device.render_pass(image):
                device.draw_counted(device.program(Colored), bars, array.copy(), queries, list(rows))
            assert queries.wait().tolist() == [4 * (rows[i] + 1) for i in range(16)]
    assert table_rows == [16, 16]


@pytest.mark.parametrize("order", ["array first", "array last", "two arrays"])
def test_an_array_of_draws_and_others_are_one_batch(
    device: rhi.Device, bars: rhi.Mesh, launches: list[str], order: str
) -> None:
    queries, more, query = device.query_set(16), device.query_set(2), device.occlusion_query()
    program = device.program(Colored)
    with device.texture((16, 4), rhi.Format.R8) as image:
        with device.render_pass(image), device.states(rhi.ColorWrite.OFF, rhi.DepthWrite.OFF):
            if order == "array last":
                with query:
                    device.draw(program, bars.view(6 * 3, 6))
            device.draw_counted(program, bars, bars.draws(6 * np.arange(16), 6), queries)
            if order == "two arrays":
                device.draw_counted(program, bars, bars.draws(6 * np.array([9, 2]), 6), more, [1, 0])
            if order != "array last":
                with query:
                    device.draw(program, bars.view(6 * 3, 6))
        assert query.wait() == 16
        assert queries.wait().tolist() == [4 * (i + 1) for i in range(16)]
        if order == "two arrays":
            assert more.wait().tolist() == [12, 40]
    assert launches.count("raster") == 1


def test_counters_are_used_again(device: rhi.Device) -> None:
    """Pages of counters are reused once their results aren't needed, and count from zero."""
    queries = device.backend_as(ClBackend)._rasteriser.queries
    with device.texture((4, 4), rhi.Format.R8) as image, device.mesh(rectangle()) as mesh:
        query = device.occlusion_query()
        for _ in range(4):
            for _ in range(500):
                with device.render_pass(image), query:
                    device.draw(device.program(Colored), mesh)
            assert query.wait() == 16
    assert 1 <= len(queries._free) <= 2


# -- lines and points ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("primitive", [rhi.Primitive.LINES, rhi.Primitive.POINTS], ids=lambda p: p.name)
def test_lines_and_points_keep_their_order_among_triangles(
    device: rhi.Device, primitive: rhi.Primitive
) -> None:
    """Lines and points keep their place in the order of draws."""
    rows = corners(
        [(-0.9, 0.1), (0.9, 0.1)] if primitive is rhi.Primitive.LINES else [(0.05, 0.1)], (0, 1, 0, 1)
    )
    below, above = rectangle(-1, -1, 1, 1), rectangle(0.5, -1, 1, 1)
    below["color"], above["color"] = (1, 0, 0, 1), (0, 0, 1, 1)
    program = device.program(Colored)
    with (
        device.texture((16, 16), rhi.Format.RGBA8) as image,
        device.mesh(below) as first,
        device.mesh(rows, primitive=primitive) as thin,
        device.mesh(above) as last,
    ):
        with device.render_pass(image), device.states(rhi.DepthWrite.OFF, rhi.CullMode.NONE):
            for mesh in (first, thin, last):
                device.draw(program, mesh)
        pixels = image.read()
    assert pixels[7, 8].tolist() == [0, 255, 0, 255]
    assert (pixels[:, 12:] == (0, 0, 255, 255)).all()
    assert pixels[3, 3].tolist() == [255, 0, 0, 255]


# -- clipping ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("nearest", [10.0, -5.0], ids=["behind_the_eye", "before_it"])
def test_a_plane_to_the_horizon_has_its_depth(device: rhi.Device, nearest: float) -> None:
    """The far corners lie a fraction of a pixel below the horizon. Their rounding must not tilt the plane."""
    width, height, below, near, scale = 256, 144, 2.3, 0.2, 1.7320508
    x, z = (
        np.array([-900.0, 900, 900, -900, 900, -900]),
        np.array([nearest, nearest, -3000, nearest, -3000, -3000]),
    )
    if nearest < 0:
        x[z == nearest] /= 300  # no guard band cuts it
    clip = np.stack([x * scale * height / width, np.full(6, -below * scale), np.full(6, near), -z], axis=1)
    drawn = draw_once(
        device, (width, height), rhi.Format.D32F, corners(clip), rhi.CullMode.NONE, rhi.ColorWrite.OFF
    )
    assert (drawn[: height // 2] == 0).all()
    rows, columns = np.nonzero(drawn)
    assert len(rows) > (width * height / 3 if nearest > 0 else 1000)
    expected = near * (rows + 0.5 - height / 2) / (height / 2) / scale / below
    np.testing.assert_allclose(drawn[rows, columns], expected, atol=1e-6)


@pytest.mark.parametrize("size", [(8192, 16), (16, 8192), (8192, 1024)], ids=str)
def test_edges_across_the_largest_targets_are_exact(device: rhi.Device, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(4)
    extent = np.array(size) * SUBTEXELS
    for _ in range(3):
        triangle = rng.integers(-extent // 2, extent * 3 // 2, (3, 2))
        clip = window_to_clip(triangle / SUBTEXELS, size)
        assert_mask(
            draw_once(device, size, rhi.Format.R8, corners(clip), rhi.CullMode.NONE),
            rasterise(triangle, *size),
        )


# -- depth bounds --------------------------------------------------------------------------------------------


FLOAT, FIXED = (rhi.Format.D32F, rhi.Format.D32FS8), (rhi.Format.D24, rhi.Format.D24S8)


@pytest.mark.nightly_cases(
    "ALWAYS-24", "EQUAL-24", "GREATER-24", "LESS_EQUAL-24", "NEVER-24", "NOT_EQUAL-24", reason=FEWER_CASES
)
@pytest.mark.parametrize("depth_format", [FLOAT, FIXED], ids=["float", "24"])
@pytest.mark.parametrize("function", rhi.DepthFunction, ids=lambda function: function.name)
def test_culling_by_the_depth_bounds_of_tiles_drops_only_fragments_that_fail_the_depth_test(
    device: rhi.Device, function: rhi.DepthFunction, depth_format: tuple[rhi.Format, rhi.Format]
) -> None:
    """With a stencil test, depth isn't staged and has no bounds."""
    rows = random_corners(6000)
    rng = np.random.default_rng(5)
    # Most depths are near their triangle's, some slopes are steep, some triangles face the eye and meet
    # others.
    depths = rng.uniform(0, 1, (6000, 1)) + rng.choice([0, 0.01, 0.5], (6000, 1)) * rng.uniform(
        -1, 1, (6000, 3)
    )
    depths[::7] = np.round(depths[::7, :1] * 8) / 8
    rows["position"][:, 2] = np.clip(depths, 0, 1).ravel()
    results = []
    for stencil, form in enumerate(depth_format):
        with (
            device.texture(SIZE, rhi.Format.RGBA8) as image,
            device.texture(SIZE, form) as depth,
            device.mesh(rows) as mesh,
        ):
            states = (
                rhi.CullMode.NONE,
                function,
                rhi.StencilTest.ON if stencil else rhi.StencilTest.OFF,
                rhi.PolygonOffset(0.5),
            )
            with (
                device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.5),
                device.states(*states),
            ):
                device.draw(device.program(Colored), mesh)
            results.append((image.read(), depth.read()))
    (image, depth_values), (plain_image, plain_depths) = results
    assert (depth_values == plain_depths).all()
    assert (image == plain_image).all()
    assert (image > 0).any() or function in (rhi.DepthFunction.NEVER, rhi.DepthFunction.EQUAL)


@pytest.mark.parametrize(
    "depth_format",
    [(rhi.Format.D32F, rhi.Format.D32FS8), (rhi.Format.D24, rhi.Format.D24S8)],
    ids=["float", "24"],
)
@pytest.mark.parametrize(
    "function", [rhi.DepthFunction.LESS, rhi.DepthFunction.GREATER_EQUAL], ids=lambda f: f.name
)
@pytest.mark.parametrize("offset", [0.0, 0.5])
def test_culling_by_earlier_slices_drops_only_primitives_that_fail_the_depth_test(
    device: rhi.Device,
    monkeypatch: pytest.MonkeyPatch,
    function: rhi.DepthFunction,
    depth_format: tuple[rhi.Format, rhi.Format],
    offset: float,
) -> None:
    """Whole draws and single primitives are culled; with a stencil test there are no bounds from earlier
    slices."""
    count, each = 120, 24
    rng = np.random.default_rng(7)
    middle, size = rng.uniform(-1.1, 1.1, (count, 1, 1, 2)), 2.0 ** rng.uniform(-7, 0, (count, each, 1, 1))
    positions = middle + size * rng.uniform(-1, 1, (count, each, 3, 2))
    colors = np.repeat(rng.uniform(0, 1, (count * each, 4)), 3, axis=0)
    away = rng.uniform(0, 1, (count, 1, 1)) + 0.05 * rng.uniform(-1, 1, (count, each, 3))
    rows = corners(positions.reshape(-1, 2), colors, np.clip(away, 0, 1).ravel())
    results, survivors = [], []
    for form, groups in ((depth_format[1], 1 << 15), (depth_format[0], 1 << 15), (depth_format[0], 32)):
        monkeypatch.setattr(launcher, "_SLICE_GROUPS", groups)
        with (
            device.texture(SIZE, rhi.Format.RGBA8) as image,
            device.texture(SIZE, form) as depth,
            device.mesh(rows) as mesh,
        ):
            stencil = rhi.StencilTest.ON if form.has_stencil else rhi.StencilTest.OFF
            states = rhi.CullMode.NONE, function, stencil, rhi.PolygonOffset(offset)
            with (
                device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.5),
                device.states(*states),
            ):
                for part in range(count):
                    device.draw(device.program(Colored), mesh.view(first=3 * each * part, count=3 * each))
            results.append((image.read(), depth.read()))
            survivors.append(count_survivors(device))
    for image_values, depth_values in results[1:]:
        assert (image_values == results[0][0]).all()
        assert (depth_values == results[0][1]).all()
    assert survivors[0] > 0


@pytest.mark.usefixtures("optimised_kernels")
def test_draws_that_are_hidden_or_beside_the_view_are_not_set_up(
    device: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(launcher, "_SLICE_GROUPS", 1)  # each draw is a slice
    left = []
    for x in (0.5, 5.0):  # what is drawn last lies in the view, or not
        for last in (0.25, 0.75):  # before the wall, or behind it
            rows = np.concatenate([rectangle(depth=0.5), rectangle(x - 0.1, 0.4, x + 0.1, 0.6, depth=last)])
            with device.texture(SIZE, rhi.Format.D32F) as depth, device.mesh(rows) as mesh:
                with device.render_pass(depth=depth, clear_depth=1.0), device.states(rhi.DepthFunction.LESS):
                    for first in (0, 6):
                        device.draw(device.program(Colored), mesh.view(first=first, count=6))
                left.append(count_survivors(device))
    assert left == [2, 0, 0, 0]


def _leave(depth: rhi.Texture, other: rhi.Texture, device: rhi.Device) -> None:
    """The depth doesn't change."""


def _copy(depth: rhi.Texture, other: rhi.Texture, device: rhi.Device) -> None:
    other.copy_to(depth)


def _clear(depth: rhi.Texture, other: rhi.Texture, device: rhi.Device) -> None:
    with device.render_pass(depth=depth, clear_depth=1.0):
        pass


def _draw_elsewhere(depth: rhi.Texture, other: rhi.Texture, device: rhi.Device) -> None:
    """The bounds in memory are overwritten with those of another depth target."""
    with (
        device.mesh(rectangle(depth=0.9)) as mesh,
        device.render_pass(depth=other),
        device.states(rhi.DepthFunction.LESS),
    ):
        device.draw(device.program(Colored), mesh)


def _draw_unbounded(depth: rhi.Texture, other: rhi.Texture, device: rhi.Device) -> None:
    """Draws that keep no bounds move the depth away."""
    with (
        device.mesh(rectangle(depth=1.0)) as mesh,
        device.render_pass(depth=depth),
        device.states(rhi.DepthFunction.ALWAYS),
    ):
        device.draw(device.program(Colored), mesh)


@pytest.mark.usefixtures("optimised_kernels")
@pytest.mark.parametrize(
    ("change", "hides", "samples"),
    [
        (_leave, True, 0),
        (_copy, False, 64),
        (_clear, False, 64),
        (_draw_elsewhere, False, 0),
        (_draw_unbounded, False, 64),
    ],
)
def test_a_pass_reuses_the_depth_bounds_of_the_pass_before_unless_depth_changed(
    device: rhi.Device,
    change: Callable[[rhi.Texture, rhi.Texture, rhi.Device], None],
    hides: bool,
    samples: int,
) -> None:
    program, size = device.program(Colored), (8, 8)
    with (
        device.texture(size, rhi.Format.D32F) as depth,
        device.texture(size, rhi.Format.D32F) as other,
        device.mesh(rectangle(depth=0.5)) as wall,
        device.mesh(rectangle(depth=0.75)) as behind,
    ):
        _clear(other, depth, device)
        with device.render_pass(depth=depth, clear_depth=1.0), device.states(rhi.DepthFunction.LESS):
            device.draw(program, wall)
        change(depth, other, device)
        query = device.occlusion_query()
        states = rhi.DepthFunction.LESS, rhi.DepthWrite.OFF
        with device.render_pass(depth=depth), device.states(*states), query:
            device.draw(program, behind)
        assert query.wait() == samples
        assert (count_survivors(device) == 0) == hides


def test_depth_tested_the_other_way_is_bounded_anew(device: rhi.Device) -> None:
    with device.texture((8, 8), rhi.Format.D32F) as depth, device.mesh(rectangle(depth=0.75)) as mesh:
        for function, samples in (
            (rhi.DepthFunction.LESS, 64),
            (rhi.DepthFunction.GREATER, 0),
            (rhi.DepthFunction.LESS, 0),
        ):
            query = device.occlusion_query()
            with device.render_pass(depth=depth, clear_depth=1.0 if samples else None):
                with device.states(function), query:
                    device.draw(device.program(Colored), mesh)
            assert query.wait() == samples


def test_small_triangles_between_texel_centres_are_not_set_up(device: rhi.Device) -> None:
    size = 4
    boxes = [(1.6, 1.6, 1.9, 1.9), (1.6, 0.7, 2.4, 1.2), (1.4, 1.2, 1.8, 1.7), (0.9, 0.9, 2.6, 1.6)]
    inside = []
    for left, top, right, bottom in boxes:
        corner = np.array([(left, top), (left, bottom), (right, bottom)]) * 2 / size - 1
        rows = corners(corner * (1, -1))
        drawn = draw_once(device, (size, size), rhi.Format.R8, rows, rhi.CullMode.NONE)
        inside.append(((drawn > 0).sum(), count_survivors(device)))
    assert inside == [(0, 0), (0, 0), (1, 1), (1, 1)]
