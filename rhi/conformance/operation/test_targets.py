"""Targets: every renderable format, several at once, masks and blends of each, layers, samples and
resolves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rhi
from rhi.conformance.compare import assert_mask, assert_near, assert_same
from rhi.conformance.formats import require_point_sizes, require_renderable, require_samples
from rhi.conformance.reference import channels_of, compare, encode, rounding
from rhi.conformance.shaders import (
    Bare,
    Colored,
    Corner,
    FlatShade,
    IntColored,
    Located,
    Shade,
    Sized,
    UintColored,
)
from rhi.conformance.shapes import centers, corners, point_square, point_vertices, rectangle
from rhi.conformance.single_draws import draw_once
from rhi.conformance.waiting import TIMEOUT
from rhi.contract.formats import COLOR_FORMATS, ChannelKind
from rhi.contract.limits import target_bytes
from rhi.shading import Shader, Struct, uvec4, vec2, vec4

pytestmark = pytest.mark.requires("draws", "shading")

SIZE = (4, 4)


def identity(value: Any) -> str:
    return value.name if isinstance(value, rhi.Format | rhi.TextureKind) else str(value)


@pytest.mark.parametrize("format", [f for f in COLOR_FORMATS if not f.is_integer], ids=identity)
@pytest.mark.parametrize("color", [(0.2, 0.4, 0.6, 0.8), (-0.5, 1.5, 0.0, 0.3)], ids=str)
def test_a_fragment_s_color_is_converted_to_the_format(
    device: rhi.Device, format: rhi.Format, color: tuple[float, float, float, float]
) -> None:
    require_renderable(device, format)
    back = channels_of(format, draw_once(device, SIZE, format, rectangle(color=color))).reshape(16, -1)
    expected = encode(format, np.array(color, "f4"))
    assert_near(back, expected, *rounding(format, expected))


@pytest.mark.parametrize("format", [f for f in COLOR_FORMATS if f.is_integer], ids=identity)
def test_integers_are_stored_as_they_are(device: rhi.Device, format: rhi.Format) -> None:
    require_renderable(device, format)
    top = min(2.0 ** format.channel_bits[0] - 1, 2.0**24)
    last = min(100.0, 2.0 ** format.channel_bits[-1] - 1)
    color = (1.0, top, 0.0, last) if format.kind is ChannelKind.UINT else (-1.0, top, -(2.0**24), last)
    shader: type[Shader] = UintColored if format.kind is ChannelKind.UINT else IntColored
    drawn = draw_once(device, SIZE, format, rectangle(color=color), shader=shader)
    assert_same(channels_of(format, drawn).reshape(16, -1), color[: format.channels])


class SignedOutput(Shader):
    """Writes the color to a signed normalised target."""

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)

    def fragment(self, v: Shade) -> vec4:
        return v.color


@pytest.mark.parametrize("format", [f for f in COLOR_FORMATS if f.kind is ChannelKind.SNORM], ids=identity)
@pytest.mark.parametrize(
    "value", [-1.0, -1.003, -1.004, -2.0, -1e10, -3e38, 1.0, 1.01, 3.0, 1e10, 3e38], ids=str
)
def test_signed_normalised_targets_clamp_to_one_number_each_way(
    device: rhi.Device, format: rhi.Format, value: float
) -> None:
    """Both encodings of −1 are read as −127, whichever of the two a driver stores."""
    require_renderable(device, format)
    drawn = draw_once(device, SIZE, format, rectangle(color=(value,) * 4), shader=SignedOutput)
    assert_same(drawn, np.sign(value) * 127)


@pytest.mark.parametrize("format", [f for f in COLOR_FORMATS if f.kind is ChannelKind.SNORM], ids=identity)
def test_the_lowest_integer_of_a_signed_normalised_format_reads_as_minus_one(
    device: rhi.Device, format: rhi.Format
) -> None:
    texels = np.full((*SIZE, format.channels), -128, np.int8)
    texels[0] = 100
    with device.texture(SIZE, format) as texture:
        texture.write(texels)
        expected = np.maximum(texels, -127)
        for read in (texture.read(), texture.read_layers()[0], texture.read_async().result()):
            assert_same(read.reshape(expected.shape), expected)


class Three(Struct):
    """Outputs of three kinds."""

    first: vec4
    second: uvec4
    third: vec2


class ToThree(Shader):
    """Writes the color to a float, an unsigned and a two-channel target."""

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=v.color)

    def fragment(self, v: FlatShade) -> Three:
        return Three(first=v.color * 0.4, second=uvec4(v.color * 100.0), third=v.color.zw)


def test_each_output_goes_to_its_target(device: rhi.Device) -> None:
    targets = [device.texture(SIZE, f) for f in (rhi.Format.RGBA8, rhi.Format.RGBA16UI, rhi.Format.RG32F)]
    with device.mesh(rectangle(color=(1, 0, 0.25, 2))) as mesh, device.render_pass(targets):
        device.draw(device.program(ToThree), mesh)
    assert_same(targets[0].read()[..., [0, 1, 3]], (102, 0, 204))
    assert_same(targets[1].read(), (100, 0, 25, 200))
    assert_same(targets[2].read(), (0.25, 2.0))
    for target in targets:
        target.destroy()


class Two(Struct):
    """Two colors."""

    first: vec4
    second: vec4


class ToTwo(Shader):
    """Writes the color to the first target, and the color with its channels reversed to the second."""

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)

    def fragment(self, v: Shade) -> Two:
        return Two(first=v.color, second=v.color.wzyx)


def two_after(device: rhi.Device, *states: Any) -> tuple[Any, Any]:
    with (
        device.texture(SIZE, rhi.Format.RGBA8) as first,
        device.texture(SIZE, rhi.Format.RGBA16F) as second,
        device.mesh(rectangle(color=(1.0, 0.0, 0.0, 0.0))) as mesh,
    ):
        with device.render_pass([first, second], clear=(0, 0, 0, 1)), device.states(*states):
            device.draw(device.program(ToTwo), mesh)
        return first.read()[0, 0], second.read()[0, 0]


def test_color_write_of_all_targets(device: rhi.Device) -> None:
    first, second = two_after(device, rhi.ColorWrite.OFF)
    assert_same(first, (0, 0, 0, 255))
    assert_same(second, (0, 0, 0, 1))


def test_color_write_of_one_target(device: rhi.Device) -> None:
    first, second = two_after(device, rhi.ColorWrite.OFF.at(0))
    assert_same(first, (0, 0, 0, 255))
    assert_same(second, (0, 0, 0, 1))  # the second output, (1, 0, 0, 0) reversed, equals the clear color
    first, second = two_after(device, rhi.ColorWrite(alpha=False).at(0), rhi.ColorWrite(alpha=False).at(1))
    assert_same(first, (255, 0, 0, 255))
    assert_same(second, (0, 0, 0, 1))


@pytest.mark.requires("blend_per_target")
def test_each_target_blends_by_its_own_function(device: rhi.Device) -> None:
    first, second = two_after(device, rhi.BlendFunction.ADDITIVE.at(1))
    assert_same(first, (255, 0, 0, 0))
    assert_same(second, (0, 0, 0, 2))
    first, second = two_after(device, rhi.BlendFunction.ADDITIVE.at(0))
    assert_same(first, (255, 0, 0, 255))
    assert_same(second, (0, 0, 0, 1))


class First(Struct):
    """A color."""

    first: vec4


class Four(Struct):
    """Four colors."""

    first: vec4
    second: vec4
    third: vec4
    fourth: vec4


class ToNone(Shader):
    """Has a fragment stage without outputs."""

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)

    def fragment(self, v: Shade) -> None:
        pass


class WithoutFragments(Shader):
    """Has no fragment stage."""

    def vertex(self, v: Corner) -> Bare:
        return Bare(clip=v.position)


class ToOne(Shader):
    """Writes the color to the first target."""

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)

    def fragment(self, v: Shade) -> First:
        return First(first=v.color)


class ToFour(Shader):
    """Writes the color to four targets."""

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)

    def fragment(self, v: Shade) -> Four:
        return Four(first=v.color, second=v.color, third=v.color, fourth=v.color)


OUTPUTS: dict[type[Shader], int] = {WithoutFragments: 0, ToNone: 0, ToOne: 1, ToTwo: 2, ToFour: 4}


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("targets", [1, 2, 3, 4])
def test_targets_without_an_output_keep_their_contents_and_outputs_without_a_target_are_dropped(
    device: rhi.Device, targets: int, samples: int
) -> None:
    """Programs with more and fewer outputs take turns in one pass, with masks and clears between them."""
    require_samples(device, samples)
    random = np.random.default_rng([targets, samples])
    resolved = [device.texture(SIZE, rhi.Format.RGBA8) for _ in range(targets)]
    images = (
        resolved if samples == 1 else [device.texture(SIZE, rhi.Format.RGBA8, samples=4) for _ in resolved]
    )
    shaders, expected = list(OUTPUTS), np.zeros((targets, 4))
    for _ in range(6):
        clears = [(n, 51, 0, 255) if random.random() < 0.5 else None for n in range(targets)]
        values = [None if clear is None else tuple(np.array(clear) / 255) for clear in clears]
        expected = np.array([old if new is None else new for old, new in zip(expected, clears, strict=True)])
        ends = resolved if samples > 1 else None
        with device.render_pass(images, clear=values, resolve=ends), device.states(rhi.DepthTest.OFF):
            for number in random.integers(0, len(shaders), 4):
                color, masked = random.integers(0, 256, 4), int(random.integers(0, 5))
                write = () if masked == 4 else (rhi.ColorWrite.OFF.at(masked),)
                with device.mesh(rectangle(color=tuple(color / 255))) as mesh, device.states(*write):
                    device.draw(device.program(shaders[number]), mesh)
                outputs = [n for n in range(min(targets, OUTPUTS[shaders[number]])) if n != masked]
                for output in outputs:
                    swaps = shaders[number] is ToTwo and output == 1
                    expected[output] = color[::-1] if swaps else color
        for number, image in enumerate(resolved):
            assert_same(image.read(), expected[number])
    for image in {*images, *resolved}:
        image.destroy()


def test_blending_leaves_a_target_without_an_output(device: rhi.Device, mesh: rhi.Mesh) -> None:
    with device.texture(SIZE, rhi.Format.RGBA8) as first, device.texture(SIZE, rhi.Format.RGBA8) as second:
        with (
            device.render_pass([first, second], clear=(0.2, 0.4, 0, 0)),
            device.states(rhi.BlendFunction.ADDITIVE),
        ):
            device.draw(device.program(ToOne), mesh)
        assert_same(first.read(), 255)
        assert_same(second.read(), (51, 102, 0, 0))


def test_a_pass_with_depth_alone_draws_depth(device: rhi.Device) -> None:
    assert_same(draw_once(device, SIZE, rhi.Format.D32F, rectangle()), 0.5)


@pytest.mark.parametrize(
    ("kind", "layers"),
    [(rhi.TextureKind.D2_ARRAY, 3), (rhi.TextureKind.D3, 3), (rhi.TextureKind.CUBE, 6)],
    ids=identity,
)
def test_a_layer_is_drawn_to_alone(device: rhi.Device, kind: rhi.TextureKind, layers: int) -> None:
    with (
        device.texture(SIZE, rhi.Format.R8, kind=kind, layers=layers) as image,
        device.mesh(rectangle(0, 0, 1, 1)) as mesh,
    ):
        with device.render_pass(image.at(layer=2)):
            device.draw(device.program(Colored), mesh)
        expected = np.zeros((layers, 4, 4, 1))
        expected[2, :2, 2:] = 255
        assert_same(image.read_layers(), expected)


def test_layers_of_one_texture_are_targets_side_by_side(device: rhi.Device) -> None:
    with (
        device.texture(SIZE, rhi.Format.RGBA8, kind=rhi.TextureKind.D2_ARRAY, layers=2) as image,
        device.mesh(rectangle(color=(1, 0, 0, 0))) as mesh,
    ):
        with device.render_pass([image.at(layer=1), image.at(layer=0)]):
            device.draw(device.program(ToTwo), mesh)
        assert_same(image.read_layers()[1], (255, 0, 0, 0))
        assert_same(image.read_layers()[0], (0, 0, 0, 255))


def test_a_depth_layer_is_drawn_to_alone(device: rhi.Device, mesh: rhi.Mesh) -> None:
    with device.texture(SIZE, rhi.Format.D32F, kind=rhi.TextureKind.D2_ARRAY, layers=3) as depth:
        with device.render_pass(depth=depth.at(layer=1)):
            device.draw(device.program(Colored), mesh)
        assert_same(depth.read_layers()[..., 0], np.array([0, 0.5, 0])[:, None, None])


def test_eight_targets_are_drawn_at_once(device: rhi.Device) -> None:
    count = device.capabilities.max_color_targets
    assert count >= 4
    fits = target_bytes([rhi.Format.RGBA8] * count) <= device.capabilities.max_target_bytes
    format = rhi.Format.RGBA8 if fits else rhi.Format.R8
    targets = [device.texture(SIZE, format) for _ in range(count)]
    with device.mesh(rectangle(color=(1, 1, 1, 1))) as mesh:
        with device.render_pass(targets, clear=[(i / 255, 0, 0, 0) for i in range(count)]):
            device.draw(device.program(ToTwo), mesh, 0)
    for index, target in enumerate(targets):
        assert_same(target.read(), (index, 0, 0, 0)[: format.channels])
        target.destroy()


# -- multisampling -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("samples", [2, 4, 8])
def test_inside_a_triangle_all_samples_are_covered(device: rhi.Device, samples: int) -> None:
    require_samples(device, samples)
    drawn = draw_once(device, SIZE, rhi.Format.RGBA8, rectangle(color=(0.2, 0.4, 0.6, 0.8)), samples=samples)
    assert_same(drawn, (51, 102, 153, 204))


@pytest.mark.parametrize("samples", [2, 4, 8])
def test_an_edge_covers_a_part_of_the_samples_of_its_texels(device: rhi.Device, samples: int) -> None:
    """An edge through the middle of a column: its texels are covered in part, those beside it fully or
    not."""
    require_samples(device, samples)
    rows = rectangle(right=4.5 / 8 * 2 - 1)
    covered = draw_once(device, (8, 8), rhi.Format.R16F, rows, samples=samples).astype(np.float64)
    assert_same(covered[:, :4], 1)
    assert_same(covered[:, 5:], 0)
    middle = covered[:, 4]
    assert ((middle > 0) & (middle < 1)).all(), middle
    assert_same(middle * samples, np.rint(middle * samples))


@pytest.mark.parametrize("samples", [2, 4, 8])
def test_a_resolve_averages_the_samples(device: rhi.Device, samples: int) -> None:
    """Two triangles that share a diagonal leave no gap: the average is the mix of both colors."""
    require_samples(device, samples)
    rows = np.concatenate(
        [
            corners([(-1, 1), (-1, -1), (1, -1)], (1, 0, 0, 1)),
            corners([(-1, 1), (1, -1), (1, 1)], (0, 1, 0, 1)),
        ]
    )
    resolved = draw_once(device, (8, 8), rhi.Format.RGBA16F, rows, samples=samples)
    assert_near(resolved[..., 0] + resolved[..., 1], 1, 1e-6, "an average in float32")
    assert_near(resolved[..., 3], 1, 1e-6, "an average in float32")
    assert_same(resolved[7, 0], (1, 0, 0, 1))
    assert_same(resolved[0, 7], (0, 1, 0, 1))


def test_a_resolve_keeps_row_0_on_top(device: rhi.Device) -> None:
    require_samples(device, 4)
    expected = np.zeros((4, 4), bool)
    expected[0] = True
    assert_mask(draw_once(device, SIZE, rhi.Format.R8, rectangle(-1, 0.5, 1, 1), samples=4), expected)


@pytest.mark.parametrize("at_end", [True, False], ids=["end of pass", "command"])
def test_a_clear_reaches_all_samples_and_their_mean(device: rhi.Device, at_end: bool) -> None:
    require_samples(device, 4)
    with (
        device.texture((3, 2), rhi.Format.RGBA8, samples=4) as source,
        device.texture((3, 2), rhi.Format.RGBA8) as target,
    ):
        with device.render_pass(source, clear=(0.2, 0.4, 0.6, 0.8), resolve=target if at_end else None):
            pass
        if not at_end:
            assert_same(target.read(), 0)
            source.resolve_to(target)
        assert_same(target.read(), (51, 102, 153, 204))


@pytest.mark.parametrize("samples", [4, 8])
def test_depth_is_tested_for_each_sample(device: rhi.Device, samples: int) -> None:
    """A triangle covers half of each texel on the diagonal; the other samples show the surface behind it."""
    require_samples(device, samples)
    with (
        device.texture((8, 8), rhi.Format.R16F, samples=samples) as image,
        device.texture((8, 8), rhi.Format.D32F, samples=samples) as depth,
        device.texture((8, 8), rhi.Format.R16F) as target,
        device.mesh(corners([(-1, 1), (-1, -1), (1, -1)], (0, 0, 0, 1), 0.75)) as front,
        device.mesh(rectangle(depth=0.25)) as behind,
    ):
        with device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0, resolve=target):
            device.draw(device.program(Colored), front)
            device.draw(device.program(Colored), behind)
        diagonal = target.read().diagonal()
    assert ((diagonal > 0) & (diagonal < 1)).all(), diagonal


def test_each_of_several_targets_is_resolved_to_its_own(device: rhi.Device) -> None:
    require_samples(device, 4)
    sources = [device.texture(SIZE, rhi.Format.RGBA8, samples=4) for _ in range(2)]
    targets = [device.texture(SIZE, rhi.Format.RGBA8) for _ in range(2)]
    with device.mesh(rectangle(color=(1, 0, 0, 0))) as mesh:
        with device.render_pass(sources, clear=(0, 0, 0, 0), resolve=targets):
            device.draw(device.program(ToTwo), mesh)
    assert_same(targets[0].read(), (255, 0, 0, 0))
    assert_same(targets[1].read(), (0, 0, 0, 255))
    for texture in sources + targets:
        texture.destroy()


@pytest.mark.requires("alpha_to_coverage")
@pytest.mark.parametrize("samples", [4, 8])
@pytest.mark.parametrize("alpha", [0.0, 0.5, 1.0])
def test_alpha_becomes_coverage(device: rhi.Device, alpha: float, samples: int) -> None:
    require_samples(device, samples)
    rows = rectangle(color=(1, 1, 1, alpha))
    drawn = draw_once(device, (8, 8), rhi.Format.RGBA16F, rows, rhi.AlphaToCoverage.ON, samples=samples)
    assert_near(
        drawn[..., 0].mean(),
        alpha,
        0.25 if alpha == 0.5 else 0.0,
        "which samples are covered is left to the device",
    )


@pytest.mark.requires("alpha_to_coverage")
def test_without_the_state_alpha_covers_nothing_less(device: rhi.Device) -> None:
    require_samples(device, 4)
    assert_same(
        draw_once(device, SIZE, rhi.Format.RGBA16F, rectangle(color=(1, 1, 1, 0.5)), samples=4)[..., 0], 1
    )


@pytest.mark.requires("alpha_test")
@pytest.mark.parametrize("reference", [0.5, 0.25])
@pytest.mark.parametrize("function", list(rhi.AlphaFunction), ids=lambda f: f.name)
def test_an_alpha_function_compares_alpha_with_the_reference(
    device: rhi.Device, function: rhi.AlphaFunction, reference: float
) -> None:
    alphas = np.array([0.25, 0.5, 0.75])
    rows = corners(
        centers([(0, 0), (1, 0), (2, 0)], (3, 1)), np.stack([alphas * 0 + 1] * 3 + [alphas], axis=1)
    )
    drawn = draw_once(
        device,
        (3, 1),
        rhi.Format.R8,
        rows,
        rhi.AlphaTest.ON,
        function,
        rhi.AlphaReference(reference),
        primitive=rhi.Primitive.POINTS,
    )
    assert_same(drawn[0], compare(function, alphas, reference) * 255)


def test_points_and_lines_ignore_culling(device: rhi.Device) -> None:
    rows = corners(centers([(0, 0), (2, 2)], SIZE))
    with (
        device.texture(SIZE, rhi.Format.R8) as image,
        device.mesh(rows, primitive=rhi.Primitive.POINTS) as mesh,
    ):
        for cull in rhi.CullMode:
            with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(cull, rhi.DepthFunction.ALWAYS):
                device.draw(device.program(Colored), mesh)
            assert image.read()[0, 0] == 255
            assert image.read()[2, 2] == 255


class Nothing(Shader):
    """A program without fragment outputs."""

    def vertex(self, v: Corner) -> Bare:
        return Bare(clip=v.position)

    def fragment(self, v: Bare) -> None:
        pass


def test_a_program_without_outputs_draws_depth(device: rhi.Device) -> None:
    assert_same(draw_once(device, SIZE, rhi.Format.D32F, rectangle(), shader=Nothing), 0.5)


@pytest.mark.parametrize("samples", [4, 8])
def test_a_point_with_a_size_covers_samples(device: rhi.Device, samples: int) -> None:
    require_samples(device, samples)
    require_point_sizes(device)
    size = (24, 20)
    rows = point_vertices([(12.0, 10.0)], size, 5.0)
    back = draw_once(
        device, size, rhi.Format.R8, rows, shader=Sized, primitive=rhi.Primitive.POINTS, samples=samples
    )
    whole, touched = point_square(12.0, 10.0, 4.0, size), point_square(12.0, 10.0, 6.0, size)
    assert_same(back[whole], 255)
    assert ((back[touched & ~whole] > 0) & (back[touched & ~whole] < 255)).all()
    assert_same(back[~touched], 0)


def test_a_fragment_of_several_samples_reads_its_position_in_the_point(device: rhi.Device) -> None:
    require_point_sizes(device)
    require_samples(device, 4)
    size = (32, 24)
    rows = point_vertices([(12.0, 10.0)], size, 8.0, (0.625, 0, 0, 1), w=3.0)
    back = draw_once(
        device, size, rhi.Format.RGBA16F, rows, shader=Located, primitive=rhi.Primitive.POINTS, samples=4
    )
    rows, columns = np.nonzero(point_square(12.0, 10.0, 8.0, size))  # whole texels
    expected = np.stack([columns - 7.5, rows - 5.5], -1) / 8
    assert_near(
        back[rows, columns, :2], expected, 1 / 16 + 2e-3, "anywhere in the texel, and as with one sample"
    )
    assert_same(back[rows, columns, 2], 0.625)


# -- preparation -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("names_targets", [True, False])
def test_prepared_draws_draw_the_same_image_as_others(device: rhi.Device, names_targets: bool) -> None:
    """`device.prepare` builds ahead what a draw needs, on platforms that can, and changes nothing else."""
    states = rhi.BlendFunction.ADDITIVE, rhi.CullMode.NONE
    images = []
    for prepares in (False, True):
        with (
            device.texture(SIZE, rhi.Format.RGBA8) as image,
            device.mesh(rectangle(color=(0.2, 0.4, 0.6, 0.8))) as mesh,
        ):
            program = device.program(Colored)
            if prepares:
                targets = (image,) if names_targets else ()
                preparation = device.prepare(program, mesh, targets=targets, states=states)
                assert not preparation.cancel()
                assert preparation.result(TIMEOUT * 60) is None
                finished, total = preparation.progress
                assert finished == total
            with device.render_pass(image, clear=(0.25, 0.5, 0, 0)), device.states(*states):
                device.draw(program, mesh)
            images.append(image.read())
    assert_same(*images)


def test_many_plans_are_prepared_at_once(device: rhi.Device) -> None:
    program = device.program(Colored)
    with device.mesh(rectangle()) as mesh, device.texture(SIZE, rhi.Format.RGBA8) as image:
        plans = [
            rhi.DrawPlan(program, mesh, (image,)),
            rhi.DrawPlan(program, mesh, (rhi.Format.RGBA8, rhi.Format.D32F), (rhi.DepthFunction.GREATER,)),
            rhi.DrawPlan(program),
        ]
        preparation = device.prepare(plans)
        preparation.result(TIMEOUT * 60)
        assert preparation.done()
        assert device.prepare([]).done()


def test_a_preparation_may_be_left_alone(device: rhi.Device) -> None:
    """Draws needn't wait for it, and what it names may be destroyed."""
    program = device.program(Colored)
    with (
        device.mesh(rectangle(color=(1, 0, 0, 1))) as mesh,
        device.texture(SIZE, rhi.Format.RGBA16F) as image,
    ):
        device.prepare(program, mesh, targets=(image,), states=(rhi.BlendFunction.ALPHA,))
        with device.render_pass(image):
            device.draw(program, mesh)
        assert_same(image.read().reshape(16, 4), (1, 0, 0, 1))
