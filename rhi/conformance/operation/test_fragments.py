"""Fragments with side effects: discard, early depth test, written depth, atomics, and the order of
effects."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import rhi
import rhi.shading as sl
from rhi.conformance.compare import assert_mask, assert_near, assert_same
from rhi.conformance.formats import require_blendable, require_samples
from rhi.conformance.shaders import Checkered, Colored, Corner, DepthFromColor, Shade, Shaded, Smooth
from rhi.conformance.shapes import centers, corners, rectangle
from rhi.conformance.single_draws import draw_once

pytestmark = [pytest.mark.requires("draws", "shading"), pytest.mark.recorded_too]

SIZE = (8, 8)


BOARD = np.indices((8, 8)).sum(axis=0) % 2 == 0


@pytest.fixture
def image(device: rhi.Device) -> Iterator[rhi.Texture]:
    with device.texture(SIZE, rhi.Format.R8) as image:
        yield image


def test_a_discarded_fragment_writes_neither_color_nor_depth(
    device: rhi.Device, image: rhi.Texture, mesh: rhi.Mesh
) -> None:
    with device.texture(SIZE, rhi.Format.D32F) as depth:
        with device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0):
            device.draw(device.program(Checkered), mesh)
        assert_mask(image.read(), BOARD)
        assert_mask(depth.read(), BOARD)


class CountFragments(Shaded):
    """Counts the fragments that run."""

    total: sl.StorageRW[sl.uint]

    def fragment(self, v: Shade) -> sl.vec4:
        sl.atomic_add(self.total[0], sl.uint(1))
        return v.color


class CountEarly(CountFragments):
    """Counts the fragments that run, with early depth test."""

    early_depth = True


class CountDiscarding(Shaded):
    """Counts before and after it discards half of the fragments."""

    early_depth = True
    total: sl.StorageRW[sl.uint]

    def fragment(self, v: Shade) -> sl.vec4:
        sl.atomic_add(self.total[0], sl.uint(1))
        at = sl.ivec2(sl.fragment_coordinate().xy)
        if (at.x + at.y) % 2 == 1:
            sl.discard()
        sl.atomic_add(self.total[1], sl.uint(1))
        return v.color


def test_every_covered_texel_runs_one_fragment(device: rhi.Device, image: rhi.Texture) -> None:
    with device.mesh(rectangle(-1, 0, 0, 1)) as mesh, device.storage(sl.uint, 1) as total:
        with device.render_pass(image):
            device.draw(device.program(CountFragments), mesh, total=total)
        assert_same(total.read(), 16)


@pytest.mark.parametrize("samples", [4, 8])
@pytest.mark.parametrize("primitive", [rhi.Primitive.POINTS, rhi.Primitive.LINES], ids=lambda p: p.name)
def test_a_texel_runs_one_fragment_however_many_of_its_samples_are_covered(
    device: rhi.Device, primitive: rhi.Primitive, samples: int
) -> None:
    """Of two points at texel centres, or of a line between texels of one row."""
    require_samples(device, samples)
    rows = corners(centers([(2, 3), (6, 3)], SIZE))
    with (
        device.texture(SIZE, rhi.Format.R8, samples=samples) as image,
        device.mesh(rows, primitive=primitive) as mesh,
        device.storage(sl.uint, 1) as total,
    ):
        with device.render_pass(image):
            device.draw(device.program(CountFragments), mesh, total=total)
        texels = (
            2 if primitive is rhi.Primitive.POINTS else 5
        )  # from the middle of texel 2 to that of texel 6
        assert_same(total.read(), texels)


def counted(device: rhi.Device, shader: Any) -> int:
    """Return the number of fragments that run for a rectangle of which three quarters are hidden."""
    hidden = [rectangle(-1, -1, 1, 0, depth=0.9), rectangle(-1, 0, 0, 1, depth=0.9)]
    with (
        device.texture(SIZE, rhi.Format.R8) as image,
        device.texture(SIZE, rhi.Format.D32F) as depth,
        device.mesh(np.concatenate(hidden)) as front,
        device.mesh(rectangle(depth=0.5)) as behind,
        device.storage(sl.uint, 2) as total,
    ):
        with device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0):
            device.draw(device.program(Colored), front)
            device.draw(device.program(shader), behind, total=total)
        return int(total.read()[0])


def test_without_early_depth_hidden_fragments_have_their_effects(device: rhi.Device) -> None:
    """Without early depth the test runs after the shader, so hidden fragments have their effects."""
    assert counted(device, CountFragments) == 64


@pytest.mark.requires("early_depth")
def test_with_early_depth_hidden_fragments_have_none(device: rhi.Device) -> None:
    assert counted(device, CountEarly) == 16


@pytest.mark.requires("early_depth")
def test_with_early_depth_a_discarded_fragment_has_already_written_depth(
    device: rhi.Device, image: rhi.Texture, mesh: rhi.Mesh
) -> None:
    with device.texture(SIZE, rhi.Format.D32F) as depth, device.storage(sl.uint, 2) as total:
        with device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0):
            device.draw(device.program(CountDiscarding), mesh, total=total)
        assert_same(total.read(), [64, 32])
        assert_mask(image.read(), BOARD)
        assert_same(depth.read(), 0.5)


def test_a_fragment_s_own_depth_replaces_the_triangle_s(device: rhi.Device, image: rhi.Texture) -> None:
    rows = rectangle(depth=0.1)
    rows["color"][:, 0] = np.where(rows["position"][:, 0] < 0, 0.0, 1.0)
    with device.texture(SIZE, rhi.Format.D32F) as depth, device.mesh(rows) as mesh:
        with device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.5):
            device.draw(device.program(DepthFromColor), mesh)
        ramp = np.broadcast_to((np.arange(8) + 0.5) / 8, (8, 8))
        assert_near(depth.read(), np.maximum(ramp, 0.5), 1e-6, "interpolation in float32")
        assert_mask(image.read(), ramp > 0.5)


def test_a_fragment_s_own_depth_is_clamped(device: rhi.Device) -> None:
    with device.texture(SIZE, rhi.Format.D32F) as depth, device.texture(SIZE, rhi.Format.R8) as image:
        for value, expected in ((-1.0, 0.0), (2.0, 1.0)):
            with device.mesh(rectangle(color=(value, 0, 0, 0))) as mesh:
                with (
                    device.render_pass(image, depth, clear_depth=0.5),
                    device.states(rhi.DepthFunction.ALWAYS),
                ):
                    device.draw(device.program(DepthFromColor), mesh)
            assert_same(depth.read(), expected)


# -- order of memory accesses, without explicit barriers --------------------------------------------------


class Scale(sl.Shader):
    """Writes the vertices of a rectangle."""

    vertices: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        i = sl.global_id().x
        x = -1.0 if i == 0 or i == 3 else 0.0
        y = 0.0 if i < 2 else 1.0
        self.vertices[2 * i] = sl.vec4(x, y, 0.5, 1.0)
        self.vertices[2 * i + 1] = sl.vec4(1.0)


@pytest.mark.requires("compute")
def test_a_draw_reads_vertices_that_a_dispatch_wrote(device: rhi.Device) -> None:
    with device.buffer(4, Corner.dtype) as vertices, device.texture(SIZE, rhi.Format.R8) as image:
        mesh = device.mesh(vertices, primitive=rhi.Primitive.QUADS)
        device.dispatch(device.program(Scale), 4, vertices=device.storage(sl.vec4, vertices))
        with device.render_pass(image):
            device.draw(device.program(Colored), mesh)
        mask = np.zeros((8, 8), bool)
        mask[:4, :4] = True
        assert_mask(image.read(), mask)
        mesh.destroy()


class Enumerate(sl.Shader):
    """Writes indices."""

    indices: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        i = sl.global_id().x
        self.indices[i] = sl.uint(i)


@pytest.mark.requires("compute")
def test_a_draw_reads_indices_that_a_dispatch_wrote(device: rhi.Device) -> None:
    with device.buffer(6, np.dtype("u4")) as indices, device.texture(SIZE, rhi.Format.R8) as image:
        with device.mesh(rectangle(), indices) as mesh:
            device.dispatch(device.program(Enumerate), 6, indices=device.storage(sl.uint, indices))
            with device.render_pass(image):
                device.draw(device.program(Colored), mesh)
        assert_same(image.read(), 255)


class Choose(sl.Shader):
    """Writes two indirect draws and their count."""

    words: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        for i in range(2):
            self.words[5 * i] = sl.uint(1)
            self.words[5 * i + 1] = sl.uint(1)
            self.words[5 * i + 2] = sl.uint(3 + 2 * i)
            self.words[5 * i + 3] = sl.uint(0)
        self.words[10] = sl.uint(1)


@pytest.mark.requires("compute", "indirect_count")
def test_an_indirect_draw_reads_arguments_and_count_that_a_dispatch_wrote(device: rhi.Device) -> None:
    rows = corners(centers([(i, 0) for i in range(8)], (8, 1)))
    with (
        device.storage(sl.uint, 11) as draws,
        device.texture((8, 1), rhi.Format.R8) as image,
        device.mesh(rows, primitive=rhi.Primitive.POINTS) as mesh,
    ):
        device.dispatch(device.program(Choose), 1, words=draws)
        arguments = rhi.IndirectDraws(draws, 2, count=draws, count_offset=40)
        with device.render_pass(image):
            device.draw_indirect(device.program(Colored), mesh, arguments)
        assert_mask(image.read(), np.arange(8)[None] == 3)
    assert rhi.DRAW_UNINDEXED.itemsize == 20


class Sampled(Shaded):
    """Reads the texel below each fragment."""

    source: sl.Texture2D

    def fragment(self, v: Shade) -> sl.vec4:
        return self.source.load(sl.ivec2(sl.fragment_coordinate().xy)) + v.color


def test_a_pass_reads_the_image_of_the_pass_before(device: rhi.Device) -> None:
    step = corners([(-1, -1), (3, -1), (-1, 3)], (1 / 32, 0, 0, 0))
    with (
        device.texture(SIZE, rhi.Format.RGBA32F) as first,
        device.texture(SIZE, rhi.Format.RGBA32F) as second,
        device.mesh(step) as mesh,
    ):
        for _ in range(10):
            for source, target in ((first, second), (second, first)):
                with device.render_pass(target):
                    device.draw(device.program(Sampled), mesh, source=source)
        assert_same(first.read()[..., 0], 20 / 32)


class Fill(Shaded):
    """Writes each fragment's number to storage."""

    out: sl.StorageRW[sl.uint]

    def fragment(self, v: Shade) -> sl.vec4:
        at = sl.ivec2(sl.fragment_coordinate().xy)
        self.out[at.x + 8 * at.y] = sl.uint(at.x + 8 * at.y + 1)
        return v.color


class Sum(sl.Shader):
    """Sums all numbers."""

    values: sl.Storage[sl.uint]
    total: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        total = sl.uint(0)
        for i in range(len(self.values)):
            total += self.values[i]
        self.total[0] = total


@pytest.mark.requires("compute")
def test_a_dispatch_reads_the_writes_of_fragments(
    device: rhi.Device, image: rhi.Texture, mesh: rhi.Mesh
) -> None:
    with device.storage(sl.uint, 64) as values, device.storage(sl.uint, 1) as total:
        with device.render_pass(image), device.states(rhi.ColorWrite.OFF):
            device.draw(device.program(Fill), mesh, out=values)
        device.dispatch(device.program(Sum), 1, values=values, total=total)
        assert_same(total.read(), 64 * 65 // 2)


class WaterfallAtEdges(Shaded):
    """Goes through the columns that are shaded together, of which some are shaded for derivatives only."""

    def fragment(self, v: Shade) -> sl.vec4:
        column = int(sl.fragment_coordinate().x)
        value = 0.0
        while True:
            shared = sl.broadcast_first(column)
            if column == shared:
                value = float(shared)
                break
        return sl.vec4(value, sl.ddx(value), 0.0, 1.0)


def test_a_loop_over_values_that_fragments_broadcast_ends_at_the_edges_of_triangles(
    device: rhi.Device,
) -> None:
    """Quads at edges have helper invocations, which wait for their value as well."""
    slim = {
        "position": np.array([[-1, -1, 0.5, 1], [0.8, -0.9, 0.5, 1], [-0.7, 0.9, 0.5, 1]], "f4"),
        "color": np.ones((3, 4), "f4"),
    }
    drawn = draw_once(
        device,
        SIZE,
        rhi.Format.RGBA32F,
        slim,
        shader=WaterfallAtEdges,
        indices=np.arange(3),
        clear=(-1, -1, -1, -1),
    )
    covered = drawn[..., 3] == 1
    assert 8 < covered.sum() < 50
    columns = np.broadcast_to(np.arange(8.0), (8, 8))
    assert_same(drawn[covered, 0], columns[covered])
    assert_same(drawn[covered, 1], np.ones(covered.sum()))


class FromMemory(Smooth):
    """Reads positions from storage by vertex index."""

    points: sl.Storage[sl.vec4]

    def vertex(self) -> Shade:
        return Shade(clip=self.points[sl.vertex_index()], color=sl.vec4(1.0))


def test_a_vertex_stage_reads_storage(device: rhi.Device) -> None:
    rows = np.zeros((8, 4), "f4")
    rows[:, :2], rows[:, 2], rows[:, 3] = centers([(i, 0) for i in range(8)], (8, 1)), 0.5, 1.0
    rows[3] = (9, 9, 9, 1)
    with device.storage(sl.vec4, rows) as points:
        back = draw_once(
            device, (8, 1), rhi.Format.R8, 8, shader=FromMemory, primitive=rhi.Primitive.POINTS, points=points
        )
    assert_mask(back, np.arange(8)[None] != 3)


class Digit(sl.Struct):
    """A digit that is 0 or 1, behind 16 other bytes."""

    before: sl.vec4
    is_one: float


@sl.function
def read_digit(digit: Digit, worth: float, zero: float) -> float:
    """The value of a digit, after enough work that a compiler keeps a branch around it."""
    if digit.is_one + zero > 0.5:
        exponent = zero
        for _ in range(16):
            exponent = sl.exp2(exponent) - 1.0
        return worth + exponent
    return zero


class SixConditions(Shaded):
    """Shows a number of six binary digits, each in a uniform buffer of its own. Red must be 0."""

    d0: sl.Uniform[Digit]
    d1: sl.Uniform[Digit]
    d2: sl.Uniform[Digit]
    d3: sl.Uniform[Digit]
    d4: sl.Uniform[Digit]
    d5: sl.Uniform[Digit]

    def fragment(self, v: Shade) -> sl.vec4:
        zero = v.color.x
        number = (
            read_digit(self.d0, 1.0, zero) + read_digit(self.d1, 2.0, zero) + read_digit(self.d2, 4.0, zero)
        )
        number += (
            read_digit(self.d3, 8.0, zero) + read_digit(self.d4, 16.0, zero) + read_digit(self.d5, 32.0, zero)
        )
        return sl.vec4(number / 255.0)


def test_a_condition_reads_any_uniform_buffer_of_its_stage(device: rhi.Device) -> None:
    for number in (*(1 << digit for digit in range(6)), 0b101101):
        digits: dict[str, Any] = {
            f"d{i}": Digit(before=(0.0,) * 4, is_one=float(number >> i & 1)) for i in range(6)
        }
        back = draw_once(
            device, SIZE, rhi.Format.R8, rectangle(color=(0, 0, 0, 0)), shader=SixConditions, **digits
        )
        assert (back == number).all()


def test_draws_of_one_pass_see_their_effects_in_order(device: rhi.Device) -> None:
    """Repeated blending shows that no fragment of a later draw overtakes one of an earlier draw."""
    require_blendable(device, rhi.Format.R32F)
    with device.texture(SIZE, rhi.Format.R32F) as image:
        meshes = [device.mesh(rectangle(color=(i % 2, 0, 0, 0.5))) for i in range(12)]
        with device.render_pass(image), device.states(rhi.BlendFunction.ALPHA):
            for mesh in meshes:
                device.draw(device.program(Colored), mesh)
        value = 0.0
        for i in range(12):
            value = 0.5 * value + 0.5 * (i % 2)
        assert_near(image.read(), value, 1e-6, "12 roundings in float32")
        for mesh in meshes:
            mesh.destroy()


class AlikeCorner(sl.Struct):
    """Attributes with similar names."""

    position: sl.vec4
    a: float
    a_: float


class AlikeVaryings(sl.Struct):
    """Varyings with similar names; a matrix has a location for each row."""

    clip: sl.vec4
    m: sl.mat2
    m_: float
    m_0: float


class AlikeColors(sl.Struct):
    """Targets with similar names."""

    color: sl.vec4
    color_: sl.vec4


class NamesAlike(sl.Shader):
    """One uniform is read by the vertex stage, and one with a similar name by the fragment stage."""

    u: sl.Uniform[float]
    u_: sl.Uniform[float]

    def vertex(self, v: AlikeCorner) -> AlikeVaryings:
        rows = sl.mat2(sl.vec2(v.a, 1.0), sl.vec2(2.0, 3.0))
        return AlikeVaryings(clip=v.position, m=rows, m_=v.a_, m_0=self.u)

    def fragment(self, v: AlikeVaryings) -> AlikeColors:
        return AlikeColors(
            color=sl.vec4(v.m[0], v.m[1]),
            color_=sl.vec4(v.m_, v.m_0, self.u_, 1.0),
        )


def test_names_that_differ_in_underscores_are_two(device: rhi.Device) -> None:
    rows = np.zeros(3, AlikeCorner.dtype)
    rows["position"] = corners([(-1, -1), (3, -1), (-1, 3)])["position"]
    rows["a"], rows["a_"] = 7.0, 8.0
    with (
        device.texture((1, 1), rhi.Format.RGBA32F) as first,
        device.texture((1, 1), rhi.Format.RGBA32F) as second,
        device.mesh(rows) as mesh,
    ):
        with device.render_pass([first, second], clear=(0, 0, 0, 0)):
            device.draw(device.program(NamesAlike), mesh, u=5.0, u_=6.0)
        assert_near(first.read().reshape(4), [7, 1, 2, 3], 1e-5, "interpolated")
        assert_near(second.read().reshape(4), [8, 5, 6, 1], 1e-5, "interpolated")
