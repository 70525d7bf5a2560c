"""Occlusion queries, native and emulated, and draws that depend on them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import rhi
from rhi.conformance.compare import assert_same
from rhi.conformance.formats import require_point_sizes, require_samples
from rhi.conformance.reference import SUBTEXELS, rasterise
from rhi.conformance.shaders import Checkered, Colored, DepthFromColor, Sized
from rhi.conformance.shapes import corners, point_vertices, rectangle, texel_rectangle, window_to_clip
from rhi.conformance.waiting import wait_until
from rhi.errors import rules
from rhi.shading import Shader, Struct, TargetLayer, vec4

pytestmark = pytest.mark.requires("draws", "shading")

SIZE = (16, 16)


@pytest.fixture(params=["native", "emulated"])
def query(device: rhi.Device, request: pytest.FixtureRequest) -> Iterator[rhi.OcclusionQuery]:
    """Yield a native and an emulated query, of those that the device supports."""
    emulated = request.param == "emulated"
    capability = "sample_counter" if emulated else "occlusion_queries"
    if not getattr(device.capabilities, capability):
        pytest.skip(f"{device.backend_name} declares no {capability}")
    query = device.occlusion_query(emulated=emulated)
    assert query.emulated is emulated
    yield query
    query.destroy()


def count(device: rhi.Device, query: rhi.OcclusionQuery, rows: Any, *states: Any, **clears: Any) -> int:
    """Return the visible samples of one draw over a depth buffer cleared to 0.5."""
    with (
        device.texture(SIZE, rhi.Format.R8) as image,
        device.texture(SIZE, rhi.Format.D24S8) as depth,
        device.mesh(rows) as mesh,
    ):
        with (
            device.render_pass(image, depth, **{"clear_depth": 0.5, "clear_stencil": 0, **clears}),
            device.states(*states or (rhi.CullMode.BACK,)),
            query,
        ):
            device.draw(device.program(Colored), mesh)
        return query.wait()


def draw_counted(
    device: rhi.Device,
    query: rhi.OcclusionQuery,
    rows: Any,
    shader: Any = Colored,
    samples: int = 1,
    **more: Any,
) -> rhi.OcclusionQuery:
    """Count one draw without a depth buffer; return the query."""
    with device.texture(SIZE, rhi.Format.R8, samples=samples) as image, device.mesh(rows, **more) as mesh:
        with device.render_pass(image), query:
            device.draw(device.program(shader), mesh)
    return query


def test_a_query_counts_the_texels_that_pass(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    assert count(device, query, texel_rectangle(2, 3, 5, 4, SIZE, depth=0.75)) == 20


def test_a_query_counts_nothing_where_everything_is_hidden(
    device: rhi.Device, query: rhi.OcclusionQuery
) -> None:
    assert count(device, query, rectangle(depth=0.25)) == 0


def test_a_query_without_draws_counts_nothing(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    with device.texture(SIZE, rhi.Format.R8) as image:
        with device.render_pass(image), query:
            pass
    assert query.wait() == 0


def test_a_query_counts_fragments_drawn_over_each_other(
    device: rhi.Device, query: rhi.OcclusionQuery
) -> None:
    rows = np.concatenate([rectangle(depth=d) for d in (0.6, 0.7, 0.8, 0.7)])
    assert count(device, query, rows) == 3 * 256


POSITION = st.tuples(st.integers(0, 256), st.integers(0, 256))


@settings(max_examples=15, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(points=st.lists(POSITION, min_size=3, max_size=9))
def test_counts_of_queries_equal_those_of_an_exact_rasteriser(
    device: rhi.Device, query: rhi.OcclusionQuery, points: Any
) -> None:
    triangles = np.array(points[: len(points) // 3 * 3]).reshape(-1, 3, 2)
    rows = corners(window_to_clip(triangles.reshape(-1, 2) / SUBTEXELS, SIZE), depth=0.75)
    expected = sum(int(rasterise(triangle, *SIZE).sum()) for triangle in triangles)
    assert count(device, query, rows, rhi.CullMode.NONE, rhi.DepthWrite.OFF) == expected


@pytest.mark.parametrize(
    "function", [rhi.DepthFunction.NEVER, rhi.DepthFunction.ALWAYS, rhi.DepthFunction.EQUAL]
)
def test_a_query_counts_by_the_depth_function(
    device: rhi.Device, query: rhi.OcclusionQuery, function: rhi.DepthFunction
) -> None:
    expected = {rhi.DepthFunction.NEVER: 0, rhi.DepthFunction.ALWAYS: 256, rhi.DepthFunction.EQUAL: 256}[
        function
    ]
    assert count(device, query, rectangle(depth=0.5), function) == expected


def test_a_query_counts_without_color_and_depth_writes(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    """Visibility algorithms draw boxes this way, without changing color or depth."""
    assert count(device, query, rectangle(depth=0.75), rhi.ColorWrite.OFF, rhi.DepthWrite.OFF) == 256


def test_a_query_counts_inside_the_scissor(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    assert count(device, query, rectangle(depth=0.75), rhi.Scissor(3, 3, 5, 2)) == 10


def test_a_query_counts_after_the_stencil_test(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    states = (rhi.StencilTest.ON, rhi.StencilFront(rhi.Comparison.NEVER))
    assert count(device, query, rectangle(depth=0.75), *states) == 0


def test_a_query_does_not_count_discarded_fragments(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    assert draw_counted(device, query, rectangle(), Checkered).wait() == 128


def test_a_query_does_not_count_clears(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    """Other operations between the begin and the end of a query aren't counted either."""
    with device.texture(SIZE, rhi.Format.R8, levels=2) as other, device.texture(SIZE, rhi.Format.R8) as image:
        with device.render_pass(image, clear=(1, 1, 1, 1)), query:
            other.generate_mipmaps()
            other.write(np.ones((16, 16), "u1"))
        assert query.wait() == 0


def test_a_query_counts_a_fragment_s_own_depth(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    rows = rectangle(depth=0.9)
    rows["color"][:, 0] = np.where(rows["position"][:, 0] < 0, 0.0, 1.0)
    with (
        device.texture(SIZE, rhi.Format.R8) as image,
        device.texture(SIZE, rhi.Format.D32F) as depth,
        device.mesh(rows) as mesh,
    ):
        with device.render_pass(image, depth, clear_depth=0.5), query:
            device.draw(device.program(DepthFromColor), mesh)
        assert query.wait() == 128


def test_a_query_counts_without_a_depth_buffer(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    assert draw_counted(device, query, rectangle(-1, -1, 0, 0)).wait() == 64


def test_a_query_counts_only_the_draws_inside_it(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    with device.texture(SIZE, rhi.Format.R8) as image, device.mesh(rectangle()) as mesh:
        program = device.program(Colored)
        with device.render_pass(image):
            device.draw(program, mesh)
            query.begin()
            device.draw(program, mesh)
            device.draw(program, mesh)
            query.end()
            device.draw(program, mesh)
        assert query.wait() == 512


def test_a_query_may_be_used_again(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    for size in (1, 4, 9, 2):
        assert count(device, query, texel_rectangle(0, 0, size, 1, SIZE, depth=0.75)) == size


def test_a_query_begun_before_its_answer_was_there_counts_anew(
    device: rhi.Device, query: rhi.OcclusionQuery
) -> None:
    """The device may still be executing the draws of the earlier begin."""
    size, layers = (512, 512), 40
    with device.texture(size, rhi.Format.R8) as image, device.mesh(np.tile(rectangle(), layers)) as mesh:
        for _ in range(5):
            for count in (layers, 1):
                with device.render_pass(image), query:
                    device.draw(device.program(Colored), mesh.view(0, 6 * count))
                device.signal()
            assert query.wait() == 512 * 512


def test_many_queries_keep_their_own_counts(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    queries = [device.occlusion_query(emulated=query.emulated) for _ in range(50)]
    with device.texture(SIZE, rhi.Format.R8) as image:
        meshes = [device.mesh(texel_rectangle(0, 0, i % 16, 1 + i // 16, SIZE)) for i in range(50)]
        with device.render_pass(image):
            for single_query, mesh in zip(queries, meshes, strict=True):
                with single_query:
                    device.draw(device.program(Colored), mesh)
        for index, single_query in enumerate(queries):
            assert single_query.wait() == (index % 16) * (1 + index // 16)
            single_query.destroy()
        for mesh in meshes:
            mesh.destroy()


def test_an_answer_comes_without_waiting_for_it(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    """Polling is enough for the query to finish: `end` submits its work."""
    draw_counted(device, query, rectangle())
    assert wait_until(lambda: query.is_finished)
    assert query.visible_samples == 256


def test_polling_does_not_block(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    """The work of the query grows until two polls find it unfinished. If polls wait only one of them can,
    although the fence was unfinished before. A device that executes commands at once can't fail this test.
    Another program may have the processor between two polls, so further amounts of work are tried: what a
    driver has left of each when its query ends differs."""
    with device.texture((1024, 1024), rhi.Format.RGBA8) as image, device.mesh(rectangle()) as mesh:
        program = device.program(Colored)
        for instances in (*(4**n for n in range(6)), *range(300, 1100, 100)):
            with device.render_pass(image), query:
                device.draw(program, mesh, instances)
            value = device.signal()
            unfinished = device.completed < value
            polls = 0
            while not query.is_finished:
                polls += 1
            assert query.visible_samples == instances * 1024 * 1024
            if polls > 1:
                break
        else:
            assert not unfinished, f"{polls} polls during {instances} full screens: each of them blocked"


def test_an_answer_stays_until_the_next_begin(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    assert count(device, query, rectangle(depth=0.75)) == 256
    assert query.visible_samples == query.visible_samples == query.wait() == 256
    with device.texture(SIZE, rhi.Format.R8) as image, device.render_pass(image):
        query.begin()
        assert not query.is_finished
        query.end()
    assert query.wait() == 0


@pytest.mark.parametrize("samples", [2, 4, 8])
def test_multi_sampled_targets_count_samples(
    device: rhi.Device, query: rhi.OcclusionQuery, samples: int
) -> None:
    """A device that declares a number of samples has as many, not more."""
    require_samples(device, samples)
    assert draw_counted(device, query, rectangle(-1, -1, 0, 0), samples=samples).wait() == samples * 64


def test_queries_are_counted(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    before = device.statistics.queries
    count(device, query, rectangle())
    count(device, query, rectangle())
    assert device.statistics.queries - before == 2


@pytest.mark.requires("occlusion_queries", "sample_counter")
@settings(max_examples=10, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(points=st.lists(POSITION, min_size=3, max_size=12))
def test_native_and_emulated_queries_agree(device: rhi.Device, points: Any) -> None:
    rows = corners(window_to_clip(np.array(points[: len(points) // 3 * 3]) / SUBTEXELS, SIZE), depth=0.75)
    native, emulated = device.occlusion_query(), device.occlusion_query(emulated=True)
    assert count(device, native, rows, rhi.CullMode.NONE) == count(device, emulated, rows, rhi.CullMode.NONE)
    native.destroy()
    emulated.destroy()


# -- conditional rendering ---------------------------------------------------------------------------------


@pytest.mark.requires("occlusion_queries", "conditional_rendering")
@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("depth", [0.25, 0.75], ids=["hidden", "visible"])
def test_draws_depend_on_the_answer(device: rhi.Device, depth: float, inverted: bool) -> None:
    query = device.occlusion_query()
    seen = (depth == 0.75) is not inverted
    with (
        device.texture(SIZE, rhi.Format.R8) as image,
        device.texture(SIZE, rhi.Format.D32F) as target,
        device.mesh(rectangle(depth=depth)) as box,
        device.mesh(rectangle(depth=0.9)) as thing,
    ):
        program = device.program(Colored)
        with device.render_pass(image, target, clear=(0, 0, 0, 0), clear_depth=0.5):
            with device.states(rhi.ColorWrite.OFF, rhi.DepthWrite.OFF), query:
                device.draw(program, box)
            with device.conditional(query, inverted=inverted):
                device.draw(program, thing)
        assert_same(image.read(), 255 if seen else 0)
    query.destroy()


@pytest.mark.requires("occlusion_queries", "conditional_rendering")
def test_draws_after_a_condition_do_not_depend_on_it(device: rhi.Device) -> None:
    query = device.occlusion_query()
    with device.texture(SIZE, rhi.Format.R8) as image, device.mesh(rectangle()) as mesh:
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            with query:
                pass
            with device.conditional(query):
                device.draw(device.program(Colored), mesh)
            assert query.wait() == 0
            device.draw(device.program(Colored), mesh.view(0, 3))
        covered = (image.read() > 0).sum()
    assert covered == rasterise(np.array([(0, 16), (16, 16), (16, 0)]) * SUBTEXELS, *SIZE).sum()
    query.destroy()


@pytest.mark.requires("occlusion_queries", "shading")
@pytest.mark.requires("draws")
def test_an_unfinished_query_has_no_number_yet(device: rhi.Device) -> None:
    """Either the answer is available, or reading it raises an error: a 0 never means 'not yet'."""
    query = device.occlusion_query()
    with (
        device.texture((1024, 1024), rhi.Format.RGBA8) as image,
        device.mesh(np.tile(rectangle(), 60)) as mesh,
    ):
        with device.render_pass(image), query:
            device.draw(device.program(Colored), mesh)
        try:
            early = query.visible_samples
        except rhi.ValidationError as error:
            rule = error.rule
            early = query.wait()
        else:
            rule = rules.QUERY_UNFINISHED
        assert (early, rule) == (60 << 20, rules.QUERY_UNFINISHED)
        assert query.visible_samples == 60 << 20
    query.destroy()


def test_the_samples_of_large_points_are_counted(device: rhi.Device, query: rhi.OcclusionQuery) -> None:
    require_point_sizes(device)
    rows = point_vertices([(4.5, 8.5), (12.5, 8.5)], SIZE, [5.0, 3.0])
    assert draw_counted(device, query, rows, Sized, primitive=rhi.Primitive.POINTS).wait() == 25 + 9


class LayeredCorner(Struct):
    """A vertex in clip space, with its layer."""

    position: vec4
    layer: int


class LayeredPoint(Struct):
    """The varyings of `InLayer`."""

    clip: vec4
    layer: TargetLayer


class InLayer(Shader):
    """Draws each primitive to the layer of its vertices."""

    def vertex(self, v: LayeredCorner) -> LayeredPoint:
        return LayeredPoint(clip=v.position, layer=v.layer)

    def fragment(self, s: LayeredPoint) -> vec4:
        return vec4(1.0)


@pytest.mark.requires("layered_rendering", "occlusion_queries")
def test_a_query_counts_the_samples_of_all_layers(device: rhi.Device) -> None:
    target = device.texture(SIZE, rhi.Format.RGBA8, kind=rhi.TextureKind.CUBE, layers=6)
    vertices = np.zeros((5, 3), LayeredCorner.dtype)
    vertices["position"] = [(-1, -1, 0.5, 1), (3, -1, 0.5, 1), (-1, 3, 0.5, 1)]
    vertices["layer"] = np.array([0, 2, 4, 9, -1])[:, None]  # the last two are no layers
    query = device.occlusion_query()
    with (
        device.mesh(vertices.reshape(-1)) as mesh,
        device.render_pass(target.at(layer=None), clear=(0, 0, 0, 0)),
        device.states(rhi.CullMode.NONE),
        query,
    ):
        device.draw(device.program(InLayer), mesh)
    assert query.wait() == 3 * SIZE[0] * SIZE[1]
