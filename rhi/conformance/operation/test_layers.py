"""Passes on all layers of their targets: the layer that each primitive is drawn to, clears, depth, queries and
mip levels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import (
    AlphaFunction,
    AlphaReference,
    AlphaTest,
    BlendFactor,
    BlendFunction,
    CullMode,
    DepthTest,
    Device,
    Format,
    PolygonMode,
    Primitive,
    Region,
    Scissor,
    StencilFront,
    StencilOperation,
    StencilTest,
    Texture,
    TextureKind,
    Viewport,
)
from rhi.conformance.compare import assert_same
from rhi.shading import Shader, Struct, TargetLayer, Uniform, instance_index, vec4

pytestmark = pytest.mark.requires("draws", "shading", "layered_rendering")

SIZE = 16
LAYERS = 6
KINDS = [TextureKind.D2_ARRAY, TextureKind.CUBE, TextureKind.D3]
DEPTH_KINDS = KINDS[:2]


class Corner(Struct):
    """A vertex in clip space, with its layer."""

    position: vec4
    color: vec4
    layer: int


class Chosen(Struct):
    """The clip position and the layer."""

    clip: vec4
    color: vec4
    layer: TargetLayer


class Layered(Shader):
    """Draws each primitive to the layer of its vertices."""

    def vertex(self, v: Corner) -> Chosen:
        return Chosen(clip=v.position, color=v.color, layer=v.layer)

    def fragment(self, s: Chosen) -> vec4:
        return s.color


class Flat(Shader):
    """Chooses no layer."""

    def vertex(self, v: Corner) -> vec4:
        return v.position

    def fragment(self) -> vec4:
        return vec4(1.0)


class DepthOnly(Shader):
    """Writes depth to the layer of the vertices."""

    def vertex(self, v: Corner) -> Chosen:
        return Chosen(clip=v.position, color=v.color, layer=v.layer)


class Colors(Struct):
    """Two targets."""

    first: vec4
    second: vec4


class Twice(Shader):
    """Draws to two targets."""

    def vertex(self, v: Corner) -> Chosen:
        return Chosen(clip=v.position, color=v.color, layer=v.layer)

    def fragment(self, s: Chosen) -> Colors:
        return Colors(first=s.color, second=vec4(0.0, 1.0, 0.0, 1.0))


class Instanced(Shader):
    """Draws each instance to a layer of its own, in its number."""

    start: Uniform[int]

    def vertex(self, v: Corner) -> Chosen:
        layer = self.start + instance_index()
        return Chosen(clip=v.position, color=vec4(float(layer)), layer=layer)

    def fragment(self, s: Chosen) -> vec4:
        return vec4(float(s.layer))


def target_of(
    device: Device, kind: TextureKind, format: Format = Format.RGBA32F, levels: int = 1, size: int = SIZE
) -> Texture:
    """Return a texture of six layers."""
    return device.texture((size, size), format, kind=kind, layers=LAYERS, levels=levels)


def corners(layers: Any, positions: Any = ((-1, -1), (3, -1), (-1, 3)), depth: float = 0.5) -> NDArray[Any]:
    """Return the vertices of primitives of the same shape, one for each layer, in the color 1 + layer."""
    layers = np.atleast_1d(layers)
    rows = np.zeros((len(layers), len(positions)), Corner.dtype)
    rows["position"][..., :2] = positions
    rows["position"][..., 2:] = depth, 1
    rows["color"] = (1.0 + layers)[:, None, None]
    rows["layer"] = layers[:, None]
    return rows.reshape(-1)


def random_corners(count: int, seed: int) -> NDArray[Any]:
    """Return triangles in random layers, of which some are cut by the near plane and some lie in no layer."""
    random = np.random.default_rng(seed)
    rows = np.zeros((count, 3), Corner.dtype)
    rows["position"][..., :3] = random.uniform(-1.2, 1.2, (count, 3, 3))
    rows["position"][..., 2] = random.uniform(0.0, 1.0, (count, 3))
    rows["position"][..., 3] = random.uniform(0.5, 2.0, (count, 3))
    rows["position"][: count // 8, 0, 2:] = -0.3, 0.2
    rows["color"] = random.uniform(0.0, 1.0, (count, 1, 4))
    rows["layer"] = random.integers(-1, LAYERS + 1, (count, 1))
    return rows.reshape(-1)


def draw_layers(
    device: Device, target: Texture, vertices: NDArray[Any], *states: Any, depth: Texture | None = None
) -> NDArray[Any]:
    """Draw in one pass to all layers, and return them."""
    clear_depth = None if depth is None else 0.0
    with (
        device.mesh(vertices) as mesh,
        device.render_pass(
            target.at(layer=None),
            None if depth is None else depth.at(layer=None),
            clear=(0, 0, 0, 0),
            clear_depth=clear_depth,
        ),
        device.states(*states or [CullMode.NONE]),
    ):
        device.draw(device.program(Layered), mesh)
    return target.read_layers()


def draw_in_loop(
    device: Device, target: Texture, vertices: NDArray[Any], *states: Any, depth: Texture | None = None
) -> NDArray[Any]:
    """Draw the same in a pass for each layer, and return all layers."""
    triangles = vertices.reshape(-1, 3)
    for layer in range(LAYERS):
        own = triangles[triangles["layer"][:, 0] == layer].reshape(-1)
        with (
            device.mesh(own) as mesh,
            device.render_pass(
                target.at(layer=layer),
                None if depth is None else depth.at(layer=layer),
                clear=(0, 0, 0, 0),
                clear_depth=None if depth is None else 0.0,
            ),
            device.states(*states or [CullMode.NONE]),
        ):
            device.draw(device.program(Layered), mesh)
    return target.read_layers()


@pytest.mark.parametrize("kind", KINDS)
def test_each_triangle_is_drawn_to_the_layer_that_its_vertices_choose(
    device: Device, kind: TextureKind
) -> None:
    layers = draw_layers(device, target_of(device, kind), corners([4, 1, 5]))
    assert_same(layers[:, 3, 3, 0], [0, 2, 0, 0, 5, 6])
    assert_same(layers, np.broadcast_to(layers[:, :1, :1], layers.shape))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("layer", [-1, LAYERS, 1 << 20, -(1 << 31), (1 << 31) - 1])
def test_triangles_in_no_layer_of_the_target_are_not_drawn(
    device: Device, kind: TextureKind, layer: int
) -> None:
    layers = draw_layers(device, target_of(device, kind), corners([layer, 2]))
    assert_same(layers[:, 3, 3, 0], [0, 0, 3, 0, 0, 0])


def test_the_last_layer_of_a_mip_level_of_a_volume_is_that_of_the_level(device: Device) -> None:
    volume = target_of(device, TextureKind.D3, levels=2)
    with (
        device.mesh(corners([2, 3])) as mesh,
        device.render_pass(volume.at(1, layer=None), clear=(0, 0, 0, 0)),
    ):
        device.draw(device.program(Layered), mesh)
    assert_same(volume.read_layers(1)[:, 3, 3, 0], [0, 0, 3])


@pytest.mark.parametrize("kind", KINDS)
def test_a_clear_reaches_all_layers_of_its_level_alone(device: Device, kind: TextureKind) -> None:
    target = target_of(device, kind, levels=3)
    for level in range(3):
        with device.render_pass(target.at(level, layer=None), clear=(level + 1, 2, 3, 4)):
            pass
    with device.render_pass(target.at(1, layer=None), clear=(9, 8, 7, 6)):
        pass
    for level, red in enumerate([1, 9, 3]):
        assert np.unique(target.read_layers(level)[..., 0]).tolist() == [red]


def test_a_pass_without_a_clear_keeps_the_contents_of_layers(device: Device) -> None:
    target = target_of(device, TextureKind.CUBE)
    draw_layers(device, target, corners([0, 3]))
    with device.mesh(corners([1])) as mesh, device.render_pass(target.at(layer=None)):
        device.draw(device.program(Layered), mesh)
    assert_same(target.read_layers()[:, 3, 3, 0], [1, 2, 0, 4, 0, 0])


@pytest.mark.parametrize("kind", DEPTH_KINDS)
@pytest.mark.parametrize("level", [0, 1])
def test_each_layer_has_its_own_depth(device: Device, kind: TextureKind, level: int) -> None:
    depth = target_of(device, kind, Format.D32F, 2)
    vertices = np.concatenate([corners([0, 1], depth=0.75), corners([0, 1, 2], depth=0.25)])
    with (
        device.mesh(vertices) as mesh,
        device.render_pass(depth=depth.at(level, layer=None), clear_depth=0.0),
        device.states(DepthTest.ON),
    ):
        device.draw(device.program(DepthOnly), mesh)
    assert_same(depth.read_layers(level)[:, 2, 2, 0], [0.75, 0.75, 0.25, 0, 0, 0])


@pytest.mark.requires("stencil")
def test_each_layer_has_its_own_stencil(device: Device) -> None:
    depth = target_of(device, TextureKind.D2_ARRAY, Format.D24S8)
    with (
        device.mesh(corners([1, 1, 4])) as mesh,
        device.render_pass(depth=depth.at(layer=None), clear_depth=0.0, clear_stencil=7),
        device.states(DepthTest.OFF, StencilTest.ON, StencilFront(both_pass=StencilOperation.INCREMENT)),
    ):
        device.draw(device.program(DepthOnly), mesh)
    stencils = [depth.read_stencil(layer=layer)[2, 2] for layer in range(LAYERS)]
    assert stencils == [7, 9, 7, 7, 8, 7]


@pytest.mark.parametrize("kind", KINDS)
def test_random_triangles_in_one_pass_equal_those_of_a_pass_for_each_layer(
    device: Device, kind: TextureKind
) -> None:
    """1,000 triangles, some of them cut by the view, in any order of layers: blended, so their order counts."""
    vertices = random_corners(1000, 5)
    blend = BlendFunction(BlendFactor.SOURCE_ALPHA, BlendFactor.ONE_MINUS_SOURCE_ALPHA)
    at_once = draw_layers(device, target_of(device, kind, size=40), vertices, blend, CullMode.NONE)
    in_loop = draw_in_loop(device, target_of(device, kind, size=40), vertices, blend, CullMode.NONE)
    assert len(np.unique(in_loop)) > 1000
    assert_same(at_once, in_loop)


@pytest.mark.parametrize("kind", DEPTH_KINDS)
@pytest.mark.parametrize(
    "states",
    [
        (DepthTest.ON,),
        (DepthTest.ON, CullMode.NONE, Scissor(5, 3, 22, 90)),
        (DepthTest.ON, CullMode.FRONT, Viewport(20, 30, 70, 50, 0.2, 0.8)),
    ],
    ids=["culled", "scissor", "viewport"],
)
def test_random_triangles_with_depth_equal_those_of_a_pass_for_each_layer(
    device: Device, kind: TextureKind, states: tuple[Any, ...]
) -> None:
    """Targets of four tiles on `cl`."""
    vertices, images = random_corners(300, 11), []
    for draw in (draw_layers, draw_in_loop):
        depth = target_of(device, kind, Format.D32F, size=100)
        images.append(draw(device, target_of(device, kind, size=100), vertices, *states, depth=depth))
        images.append(depth.read_layers())
    assert len(np.unique(images[3])) > 1000
    assert_same(images[0], images[2])
    assert_same(images[1], images[3])


@pytest.mark.requires("wireframe")
def test_the_edges_of_a_triangle_are_drawn_to_its_layer(device: Device) -> None:
    """Triangles that the view doesn't cut: llvmpipe draws edges of others to the last layer."""
    vertices, states = random_corners(60, 3)[24:], (CullMode.NONE, PolygonMode.LINE)
    vertices["position"][:, 2] *= vertices["position"][:, 3] * 0.9
    vertices["position"][:, :2] *= 0.4
    at_once = draw_layers(device, target_of(device, TextureKind.CUBE, size=40), vertices, *states)
    in_loop = draw_in_loop(device, target_of(device, TextureKind.CUBE, size=40), vertices, *states)
    assert in_loop.any()
    assert_same(at_once, in_loop)


@pytest.mark.parametrize(("primitive", "count"), [(Primitive.POINTS, 1), (Primitive.LINES, 2)])
def test_points_and_lines_are_drawn_to_the_layer_that_they_choose(
    device: Device, primitive: Primitive, count: int
) -> None:
    target = target_of(device, TextureKind.D2_ARRAY)
    vertices = corners(np.arange(-1, LAYERS + 1)[::-1], [(0.03, 0.03), (0.9, 0.03)][:count])
    with (
        device.mesh(vertices, primitive=primitive) as mesh,
        device.render_pass(target.at(layer=None), clear=(0, 0, 0, 0)),
    ):
        device.draw(device.program(Layered), mesh)
    assert_same(target.read_layers().max(axis=(1, 2))[:, 0], np.arange(1, LAYERS + 1))


def test_several_targets_have_the_same_layer(device: Device) -> None:
    targets = [target_of(device, TextureKind.CUBE, format) for format in (Format.RGBA32F, Format.RGBA8)]
    with (
        device.mesh(corners([0, 3])) as mesh,
        device.render_pass([target.at(layer=None) for target in targets], clear=(0, 0, 0, 0)),
    ):
        device.draw(device.program(Twice), mesh)
    assert_same(targets[0].read_layers()[:, 4, 4, 0], [1, 0, 0, 4, 0, 0])
    assert_same(targets[1].read_layers()[:, 4, 4, 1], [255, 0, 0, 255, 0, 0])


@pytest.mark.parametrize("start", [-2, 0, 3])
def test_each_instance_has_its_layer(device: Device, start: int) -> None:
    target = target_of(device, TextureKind.CUBE)
    with device.mesh(corners([0])) as mesh, device.render_pass(target.at(layer=None), clear=(-1, 0, 0, 0)):
        device.draw(device.program(Instanced), mesh, LAYERS, start=start)
    expected = [layer if start <= layer < start + LAYERS else -1 for layer in range(LAYERS)]
    assert_same(target.read_layers()[:, 3, 3, 0], expected)


def test_an_array_of_draws_and_a_command_buffer_draw_to_layers(device: Device) -> None:
    target = target_of(device, TextureKind.D2_ARRAY)
    with device.mesh(corners([5, 0, 2, 3])) as mesh:
        with device.record() as commands, commands.render_pass(target.at(layer=None), clear=(0, 0, 0, 0)):
            commands.draw_many(device.program(Layered), mesh, mesh.draws([0, 3, 9], 3))
        device.submit(commands)
    assert_same(target.read_layers()[:, 3, 3, 0], [1, 0, 0, 4, 0, 6])


@pytest.mark.requires("alpha_test")
def test_an_alpha_test_applies_in_each_layer(device: Device) -> None:
    vertices = corners([1, LAYERS, 4])
    vertices["color"][6:] = 0.25
    states = AlphaTest.ON, AlphaFunction.GREATER, AlphaReference(0.5)
    layers = draw_layers(device, target_of(device, TextureKind.D2_ARRAY), vertices, *states)
    assert_same(layers[:, 3, 3, 0], [0, 2, 0, 0, 0, 0])


def test_a_program_that_chooses_no_layer_draws_to_the_first(device: Device) -> None:
    target = target_of(device, TextureKind.D2_ARRAY)
    with device.mesh(corners([4])) as mesh, device.render_pass(target.at(layer=None), clear=(0, 0, 0, 0)):
        device.draw(device.program(Layered), mesh)
        device.draw(device.program(Flat), mesh)
    assert_same(target.read_layers()[:, 3, 3, 0], [1, 0, 0, 0, 5, 0])


@pytest.mark.parametrize("layer", [-1, 0, 3, 99])
def test_a_pass_on_one_layer_ignores_the_choice(device: Device, layer: int) -> None:
    target, flat = target_of(device, TextureKind.CUBE), device.texture((SIZE, SIZE), Format.RGBA32F)
    program = device.program(Layered)
    with device.mesh(corners([layer])) as mesh:
        for image in (target.at(layer=2), flat):
            with device.render_pass(image, clear=(0, 0, 0, 0)):
                device.draw(program, mesh)
    assert_same(target.read_layers()[:, 3, 3, 0], [0, 0, 1 + layer, 0, 0, 0])
    assert_same(flat.read()[3, 3, 0], 1 + layer)


def test_passes_with_and_without_layers_follow_each_other(device: Device) -> None:
    """The number of layers is that of the pass, not that of the one before."""
    cube = target_of(device, TextureKind.CUBE)
    pair = device.texture((SIZE, SIZE), Format.RGBA32F, kind=TextureKind.D2_ARRAY, layers=2)
    flat = device.texture((SIZE, SIZE), Format.RGBA32F)
    program = device.program(Layered)
    with device.mesh(corners([1, 2])) as mesh:
        for target in (
            cube.at(layer=None),
            pair.at(layer=None),
            flat,
            cube.at(layer=None),
            pair.at(layer=None),
        ):
            with device.render_pass(target, clear=(0, 0, 0, 0)):
                device.draw(program, mesh)
    assert_same(cube.read_layers()[:, 3, 3, 0], [0, 2, 3, 0, 0, 0])
    assert_same(pair.read_layers()[:, 3, 3, 0], [0, 2])


def test_layers_that_were_drawn_are_sampled_and_their_mip_levels_generated(device: Device) -> None:
    target = target_of(device, TextureKind.D2_ARRAY, levels=2)
    draw_layers(device, target, corners([1, 3]))
    target.generate_mipmaps()
    assert_same(target.read_layers(1)[:, 1, 1, 0], [0, 2, 0, 4, 0, 0])
    assert_same(target.read(region=Region(2, 2, 1, 1, 3))[0, 0, 0], 4)
