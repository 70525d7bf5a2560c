"""Points with a size: the texels that they cover, their varyings and depth, and the place of a fragment
inside."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import CullMode, DepthFunction, DepthTest, Device, Format, Primitive, Scissor
from rhi.conformance.compare import assert_mask, assert_near, assert_same
from rhi.conformance.formats import require_point_sizes
from rhi.conformance.shaders import Located, Sized
from rhi.conformance.shapes import point_square, point_vertices
from rhi.conformance.single_draws import draw_once
from rhi.shading import Shader, Struct, point_coordinate, vec2, vec4

pytestmark = pytest.mark.requires("draws", "shading")

SIZE = (32, 24)


class ClipVertex(Struct):
    """A vertex in clip space."""

    position: vec4


class Unsized(Shader):
    """Writes the place inside a point of the default size."""

    def vertex(self, v: ClipVertex) -> vec4:
        return v.position

    def fragment(self) -> vec4:
        return vec4(point_coordinate(), vec2(0.0, 1.0))


@pytest.fixture(autouse=True)
def with_sizes(device: Device) -> None:
    require_point_sizes(device)


def dots(
    positions: Any, sizes: Any, colors: Any = (1, 1, 1, 1), depth: float = 0.5, w: float = 1.0
) -> NDArray[Any]:
    """Return vertices at window positions, in texels."""
    return point_vertices(positions, SIZE, sizes, colors, depth, w)


def square(x: float, y: float, size: float) -> NDArray[np.bool_]:
    """Return the texels that a point covers."""
    return point_square(x, y, size, SIZE)


def draw_image(device: Device, rows: NDArray[Any], shader: Any = Sized, *states: Any) -> NDArray[Any]:
    """Return the image of these points."""
    return draw_once(
        device,
        SIZE,
        Format.RGBA32F,
        rows,
        *states or [CullMode.NONE],
        shader=shader,
        primitive=Primitive.POINTS,
    )


@pytest.mark.parametrize("size", [1.0, 2.0, 3.0, 4.5, 7.0, 12.0])
@pytest.mark.parametrize("position", [(10.5, 9.5), (10.0, 9.0), (10.25, 9.75), (10.8125, 9.0625)], ids=str)
def test_a_point_covers_the_square_around_it(
    device: Device, size: float, position: tuple[float, float]
) -> None:
    if size > device.capabilities.max_point_size:
        pytest.skip(f"{device.backend_name} declares max_point_size {device.capabilities.max_point_size:g}")
    image = draw_image(device, dots([position], size))
    assert_mask(image[..., 0] > 0, square(*position, size))


def test_each_point_has_its_own_size(device: Device) -> None:
    positions, sizes = [(4.5, 4.5), (14.5, 6.5), (24.5, 12.5)], [1.0, 3.0, 5.0]
    colors = [(0.25, 0, 0, 1), (0.5, 0, 0, 1), (0.75, 0, 0, 1)]
    expected = np.zeros(SIZE[::-1])
    for position, size, color in zip(positions, sizes, colors, strict=True):
        expected[square(*position, size)] = color[0]
    assert_same(draw_image(device, dots(positions, sizes, colors))[..., 0], expected)


@pytest.mark.parametrize("size", [0.0, 0.25, -3.0, 0.999])
def test_no_point_is_smaller_than_a_texel(device: Device, size: float) -> None:
    assert_mask(draw_image(device, dots([(7.5, 3.5)], size))[..., 0] > 0, square(7.5, 3.5, 1.0))


def test_no_point_is_larger_than_the_device_says(device: Device) -> None:
    most = device.capabilities.max_point_size
    side = int(most) + 40
    with (
        device.texture((side, 4), Format.R8) as image,
        device.mesh(np.zeros(1, dots([(0, 0)], 1).dtype), primitive=Primitive.POINTS) as mesh,
    ):
        rows = dots([(0, 0)], 4 * most)
        rows["position"] = (0, 0, 0.5, 1)
        mesh.data.buffers[0].write(rows)
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(device.program(Sized), mesh)
        assert abs(int((image.read()[2] > 0).sum()) - most) <= 1


@pytest.mark.requires("precise_clipping")
@pytest.mark.parametrize(("x", "seen"), [(-0.5, False), (0.5, True), (31.5, True), (32.5, False)])
def test_a_point_is_clipped_by_its_centre(device: Device, x: float, seen: bool) -> None:
    expected = square(x, 10.5, 5.0) if seen else np.zeros(SIZE[::-1], bool)
    assert_mask(draw_image(device, dots([(x, 10.5)], 5.0))[..., 0] > 0, expected)


@pytest.mark.parametrize("w", [1.0, 3.0])
def test_a_fragment_reads_its_position_in_the_point(device: Device, w: float) -> None:
    x, y, size = 12.25, 10.5, 8.0
    image = draw_image(device, dots([(x, y)], size, (0.625, 0, 0, 1), w=w), Located)
    rows, columns = np.nonzero(square(x, y, size))
    expected = np.stack([(columns + 0.5 - x) / size + 0.5, (rows + 0.5 - y) / size + 0.5], -1)
    assert_near(
        image[rows, columns, :2], expected, 2e-3, "8 fraction bits of the window position in a square of 8"
    )
    assert_same(image[rows, columns, 2], 0.625)


def test_a_point_without_a_size_is_one_texel_with_its_centre_in_the_middle(device: Device) -> None:
    rows = dots([(5.5, 7.5)], 1)
    with device.texture(SIZE, Format.RGBA32F) as image:
        with device.mesh({"position": rows["position"]}, primitive=Primitive.POINTS) as mesh:
            with device.render_pass(image, clear=(0, 0, 0, 0)):
                device.draw(device.program(Unsized), mesh)
        back = image.read()
    assert_mask(back[..., 3] > 0, square(5.5, 7.5, 1.0))
    assert_near(back[7, 5, :2], 0.5, 1 / 128, "8 fraction bits of the window position")


def test_a_point_has_one_color_and_one_depth(device: Device) -> None:
    rows = dots([(10.5, 9.5), (14.5, 9.5)], 9.0, [(0.3, 0.6, 0.9, 1), (1, 0, 0, 1)])
    rows["position"][:, 2] = 0.75, 0.25
    with device.texture(SIZE, Format.RGBA32F) as image, device.texture(SIZE, Format.D32F) as depth:
        with device.mesh(rows, primitive=Primitive.POINTS) as mesh:
            with (
                device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.0),
                device.states(DepthTest.ON, DepthFunction.GREATER),
            ):
                device.draw(device.program(Sized), mesh)
        color, stored = image.read(), depth.read()
    near, far = square(10.5, 9.5, 9.0), square(14.5, 9.5, 9.0)
    assert_near(color[near], (0.3, 0.6, 0.9, 1), 1e-6, "interpolation in float32")
    assert_near(color[far & ~near], (1, 0, 0, 1), 1e-6, "interpolation in float32")
    assert_near(stored[near], 0.75, 1e-6, "depth in float32")
    assert_near(stored[far & ~near], 0.25, 1e-6, "depth in float32")


def test_a_point_is_cut_by_the_scissor(device: Device) -> None:
    image = draw_image(device, dots([(10.5, 9.5)], 9.0), Sized, Scissor(8, 7, 4, 30))
    expected = square(10.5, 9.5, 9.0)
    expected[:, :8] = expected[:, 12:] = False
    expected[:7] = False
    assert_mask(image[..., 0] > 0, expected)


def test_a_point_is_never_culled(device: Device) -> None:
    for mode in CullMode:
        assert_mask(
            draw_image(device, dots([(9.5, 9.5)], 3.0), Sized, mode)[..., 0] > 0, square(9.5, 9.5, 3.0)
        )


def test_triangles_ignore_the_size(device: Device) -> None:
    rows = dots([(4, 4), (20, 4), (4, 20)], 9.0)
    back = draw_once(device, SIZE, Format.R8, rows, CullMode.NONE, shader=Sized) > 0
    x, y = np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1])[:, None] + 0.5
    assert_mask(back, (x >= 4) & (y >= 4) & (x + y < 24))
