"""gl and cl side by side: the same commands produce the same pixels.

Both round window positions to 1/256 pixel, with the same bits. llvmpipe cuts primitives that reach beyond the
viewport at points that it rounds again, so an edge may pass on the other side of a sample that lies within 1/256
pixel of it. In a viewport `WIDER` times as wide, with positions divided by the same factor, window positions are the
same and the cuts lie outside of the target. Coverage is then the same.
"""

from __future__ import annotations

import importlib.util
import itertools
import sys
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import rhi
from rhi import (
    BlendFunction,
    CullMode,
    Device,
    Format,
    Primitive,
    Viewport,
)
from rhi.conformance.shaders import FlatColored
from rhi.conformance.shapes import corners, window_to_clip
from rhi.contract.texels import decode
from rhi.shading import Shader

Devices = tuple[Device, Device]
NUMBERS = itertools.count()


@pytest.fixture(scope="module")
def devices() -> Iterator[Devices]:
    with rhi.create_device("gl") as gl, rhi.create_device("cl") as cl:
        yield gl, cl


# -- random triangles ----------------------------------------------------------------------------------------

SIZE = (512, 512)
WIDER = 8


def random_triangles(count: int, seed: int, reach: float = 4.0) -> NDArray[np.float64]:
    """(count, 3, 4) clip positions, of all sizes, as far as `reach` from the middle, half of them with perspective."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-1.3, 1.3, (count, 1, 2))
    size = 2.0 ** rng.uniform(-7, 1.5, (count, 1, 1))
    places = np.zeros((count, 3, 4))
    places[..., :2] = np.clip(middle + size * rng.uniform(-1, 1, (count, 3, 2)), -reach, reach)
    places[..., 2] = rng.uniform(0.1, 0.9, (count, 3))
    places[..., 3] = 1.0
    places *= np.where(rng.random((count, 1, 1)) < 0.5, 2.0 ** rng.uniform(-2, 2, (count, 3, 1)), 1.0)
    return places.astype(np.float32).astype(np.float64)  # as the device gets them


def beyond_the_eye(count: int, seed: int) -> NDArray[np.float64]:
    """Return triangles of which half have a corner behind the eye, and two thirds one beyond the near or far plane."""
    places = random_triangles(count, seed)
    places[:, 0, 3] -= 2.0 * places[:, 0, 3] * (np.arange(count) % 2)
    places[:, 1, 2] += np.arange(count) % 3 - 1.0
    return places.astype(np.float32).astype(np.float64)


def count_exactly(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the result of `count_coverage` exactly: window positions in float32, rounded to 1/256 pixel, then
    integers and the top-left rule."""
    divided = (
        places[..., :2].astype(np.float32) * (np.float32(1) / places[..., 3:].astype(np.float32))
    ).astype(np.float64)
    window = ((divided * (1, -1) + 1) * np.array(SIZE) / 2).astype(np.float32)
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]] * 256
    counts = np.zeros(SIZE[::-1])
    for triangle in np.rint((window - np.float32(0.5)) * np.float32(256)).astype(np.int64):
        (ax, ay), (bx, by), (cx, cy) = triangle
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        inside = np.full(SIZE[::-1], area != 0)
        for (sx, sy), (ex, ey) in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
            dx, dy = (ex - sx, ey - sy) if area > 0 else (sx - ex, sy - ey)
            edge = dx * (y - sy) - dy * (x - sx)
            inside &= edge >= (0 if dy < 0 or (dy == 0 and dx > 0) else 1)
        counts += inside
    return counts


def widen(rows: NDArray[Any], wider: int) -> tuple[NDArray[Any], Viewport]:
    """Return positions and a viewport with the same window positions as `SIZE`, but with other clipping."""
    rows = rows.copy()
    rows["position"][:, :2] /= wider
    width, height = SIZE
    return rows, Viewport((1 - wider) * width / 2, (1 - wider) * height / 2, wider * width, wider * height)


def count_coverage(device: Device, places: NDArray[np.float64], wider: int = 1) -> NDArray[np.float64]:
    """Return how many of the triangles cover each pixel."""
    rows, viewport = widen(corners(places.reshape(-1, 4)), wider)
    with device.texture(SIZE, Format.R32F) as image, device.mesh(rows) as mesh:
        with device.render_pass(image), device.states(CullMode.NONE, BlendFunction.ADDITIVE, viewport):
            device.draw(device.program(FlatColored), mesh)
        return image.read().astype(np.float64)


def edge_distances(places: NDArray[np.float64], x: float, y: float) -> float:
    """Return the distance in pixels from a window point to the nearest edge of all triangles."""
    window = (places[..., :2] / places[..., 3:] * (1, -1) + 1) * np.array(SIZE) / 2
    start, end = window, np.roll(window, -1, axis=1)
    along = end - start
    t = np.clip((((x, y) - start) * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-30), 0, 1)
    return float(np.hypot(*np.moveaxis(start + t[..., None] * along - (x, y), -1, 0)).min())


def measure_exactly(triangle: NDArray[np.float64], x: float, y: float) -> float:
    """Return how many pixels a window point lies inside of the nearest edge, near or far cut of a triangle (3, 4), or
    as a negative number outside: in fractions, but for the length of a line's normal."""
    half = [Fraction(side, 2) for side in SIZE]
    corner = [[Fraction(float(value)) for value in place] for place in triangle]
    window = [((cx + cw) * half[0], (cw - cy) * half[1], cw) for cx, cy, _, cw in corner]
    rows = [cross(window[(i + 1) % 3], window[(i + 2) % 3]) for i in range(3)]
    area = sum(a * b for a, b in zip(window[0], rows[0], strict=True))
    rows = [tuple(value / area for value in row) for row in rows]
    near = tuple(sum(corner[i][2] * rows[i][k] for i in range(3)) for k in range(3))
    far = (-near[0], -near[1], 1 - near[2])
    place = Fraction(x), Fraction(y), 1
    return min(
        float(sum(a * b for a, b in zip(line, place, strict=True))) / np.hypot(float(line[0]), float(line[1]))
        for line in (*rows, near, far)
    )


def cross(a: Sequence[Fraction], b: Sequence[Fraction]) -> tuple[Fraction, ...]:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def test_random_triangles_cover_the_same_pixels(devices: Devices) -> None:
    """Triangles inside the target and beyond it."""
    pixels = 0
    for seed in range(12):
        places = random_triangles(60, seed)
        gl, cl = (count_coverage(device, places, WIDER) for device in devices)
        np.testing.assert_array_equal(gl, cl)
        pixels += int(gl.sum())
    assert pixels > 2_000_000


def test_triangles_through_the_eye_differ_only_where_rounding_decides(devices: Devices) -> None:
    """llvmpipe cuts in float32 and rounds the ends of cuts; cl cuts nothing and rounds only what has a window position.
    In the few pixels in a million that differ, fractions say that an edge lies within 1/256 pixel."""
    pixels = different = 0
    for seed in range(12):
        places = beyond_the_eye(60, seed)
        gl, cl = (count_coverage(device, places, WIDER) for device in devices)
        pixels += int(gl.sum())
        for y, x in np.argwhere(gl != cl):
            distances = sorted(abs(measure_exactly(triangle, x + 0.5, y + 0.5)) for triangle in places)
            assert abs(gl[y, x] - cl[y, x]) == 1
            assert distances[0] <= 1 / 256
            different += 1
    assert pixels > 2_000_000
    assert different <= pixels / 50_000


def test_triangles_beyond_the_target_cover_what_whole_numbers_say(devices: Devices) -> None:
    """cl cuts only what its fixed-point grid can't hold, so it is exact; gl differs, next to edges, for its cuts."""
    pixels = different = 0
    for seed in range(6):
        places = random_triangles(60, seed)
        gl, cl = (count_coverage(device, places) for device in devices)
        np.testing.assert_array_equal(cl, count_exactly(places))
        pixels += int(cl.sum())
        for y, x in np.argwhere(gl != cl):
            different += 1
            assert edge_distances(places, x + 0.5, y + 0.5) <= 1 / 256, (seed, x, y, gl[y, x], cl[y, x])
    assert pixels > 1_000_000
    assert different <= pixels / 50_000, (different, pixels)


@pytest.mark.parametrize("samples", [4])
def test_samples_of_random_triangles_agree(devices: Devices, samples: int) -> None:
    """Both have the same sample positions, so the covered share of each pixel is the same."""
    pixels = 0
    for seed in range(6):
        rows, viewport = widen(corners(random_triangles(60, seed).reshape(-1, 4)), WIDER)
        images = []
        for device in devices:
            with (
                device.texture(SIZE, Format.R32F, samples=samples) as image,
                device.texture(SIZE, Format.R32F) as target,
                device.mesh(rows) as mesh,
            ):
                with (
                    device.render_pass(image, clear=(0, 0, 0, 0), resolve=target),
                    device.states(CullMode.NONE, viewport),
                ):
                    device.draw(device.program(FlatColored), mesh)
                images.append(target.read())
        np.testing.assert_array_equal(*images)
        pixels += int((images[0] > 0).sum())
    assert pixels > 100_000


@pytest.mark.parametrize("primitive", [Primitive.LINES, Primitive.LINE_STRIP, Primitive.POINTS])
def test_lines_and_points_cover_the_same_pixels(devices: Devices, primitive: Primitive) -> None:
    """They may differ in pixels in which a line ends, and in some where a line passes between two centres."""
    points = np.random.default_rng(5).random((200, 2)) * 100
    rows = corners(window_to_clip(points, (100, 100)))
    images = []
    for device in devices:
        with (
            device.texture((100, 100), Format.R32F) as image,
            device.mesh(rows, primitive=primitive) as mesh,
        ):
            with device.render_pass(image), device.states(BlendFunction.ADDITIVE):
                device.draw(device.program(FlatColored), mesh)
            images.append(image.read())
    different = images[0] != images[1]
    if primitive is not Primitive.POINTS:
        x, y = np.floor(points).astype(int).T
        different[y, x] = False
    assert images[0].sum() > 190
    assert different.sum() <= images[0].sum() / (1e9 if primitive is Primitive.POINTS else 400)


# -- levels ----------------------------------------------------------------------------------------------------


def test_levels_are_means_of_the_ones_before(devices: Devices) -> None:
    """Averages in linear light are rounded to nearest on cl; llvmpipe's curve is off by up to 0.4 more."""
    texels = np.random.default_rng(3).integers(0, 256, (64, 64, 4), np.uint8)
    for device, most in zip(devices, (0.9, 0.501), strict=True):
        with device.texture(texels, Format.RGBA8_SRGB, levels=None) as image:
            image.generate_mipmaps()
            for level in range(1, image.levels):
                linear = decode(Format.RGBA8_SRGB, image.read(level - 1)).astype(np.float64)
                means = linear.reshape(len(linear) // 2, 2, -1, 2, 4).mean(axis=(1, 3))
                curve = np.where(means <= 0.0031308, 12.92 * means, 1.055 * means ** (1 / 2.4) - 0.055)
                wanted = 255 * np.concatenate([curve[..., :3], means[..., 3:]], axis=-1)
                assert np.abs(image.read(level) - wanted).max() <= most


# -- random shaders ------------------------------------------------------------------------------------------

SOURCE = """
from rhi.shading import *

class Corner(Struct):
    position: vec4
    color: vec4

class Shade(Struct):
    clip: vec4
    color: vec4
    straight: NoPerspective[vec4]
    first: Flat[vec4]

class Test(Shader):
    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color, straight=v.color, first=v.color)

    def fragment(self, v: Shade) -> vec4:
        if {condition}:
            {dropped}
        return vec4({values})
"""
LEAVES = [f"v.{name}.{axis}" for name in ("color", "straight", "first") for axis in "xyzw"] + [
    "0.5",
    "-0.25",
    "2.0",
]


@st.composite
def expressions(draw: st.DrawFn, depth: int = 3) -> str:
    if depth == 0 or draw(st.integers(0, 4)) == 0:
        return draw(st.sampled_from(LEAVES))
    left, right = draw(expressions(depth - 1)), draw(expressions(depth - 1))
    form = draw(st.sampled_from([
        "({0} + {1})", "({0} - {1})", "({0} * {1})", "min({0}, {1})", "max({0}, {1})", "abs({0} - {1})",
        "mix({0}, {1}, 0.75)", "clamp({0}, 0.0, 1.0)", "sqrt(abs({0}))", "({0} if {1} < 0.5 else {1})",
        "dot(vec2({0}, {1}), vec2(0.6, -0.8))", "sin({0} * 3.0)", "exp(-abs({1}))",
    ]))  # fmt: skip
    return str(form.format(left, right))


@st.composite
def sources(draw: st.DrawFn) -> str:
    return SOURCE.format(
        condition=f"{draw(expressions(1))} > {draw(expressions(1))}",
        dropped=draw(st.sampled_from(["discard()", "return v.first", "return v.color * 0.5"])),
        values=", ".join(draw(expressions()) for _ in range(4)),
    )


def load_shader(source: str, folder: Path) -> type[Shader]:
    """Load a shader from a file, since the shading language reads its source."""
    path = folder / f"made_up_{next(NUMBERS)}.py"
    path.write_text(source)
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    try:
        spec.loader.exec_module(module)
    finally:
        del sys.modules[path.stem]
    shader: type[Shader] = module.Test
    return shader


@settings(max_examples=3)
@given(source=sources())
def test_random_shaders_give_the_same_colors(
    devices: Devices, source: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Results agree to 1e-4, except for one pixel in a thousand, where rounding may decide a condition or the
    argument of a root is almost 0. Of 110 shaders none needed the exception, and no number was off by 2e-5."""
    shader = load_shader(source, tmp_path_factory.mktemp("shaders"))
    places = random_triangles(12, 7, reach=1.0)
    color = np.random.default_rng(1).random((36, 4))
    images = []
    for device in devices:
        with (
            device.texture((64, 64), Format.RGBA32F) as image,
            device.mesh(corners(places.reshape(-1, 4), color)) as mesh,
        ):
            with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(CullMode.NONE):
                device.draw(device.program(shader), mesh)
            images.append(image.read().astype(np.float64))
    gl, cl = images
    apart = (np.abs(gl - cl) > 1e-4 * np.maximum(1.0, np.abs(gl))).any(axis=2)
    assert apart.sum() <= 1e-3 * apart.size, source
