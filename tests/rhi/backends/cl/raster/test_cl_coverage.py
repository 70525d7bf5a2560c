"""Coverage and sample counts of triangles that nothing clips, in whole numbers; the kit examines those that
are cut.

A window position is float32, rounded to 1/256 pixel; from there on coverage is exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from rhi import BlendFunction, ColorWrite, CullMode, DepthFunction, DepthWrite, Device, Format, Mesh
from rhi.conformance.programs.coverage import SAMPLES, SUBTEXELS
from rhi.conformance.reference import rasterise
from rhi.conformance.shaders import FlatColored
from rhi.conformance.shapes import corners, rectangle

Floats = NDArray[np.float64]
SIZE = (256, 256)  # powers of two: window positions are rounded once
NEAR = 0.1
FACES = np.array([(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)])


def project(points: Floats) -> Floats:
    """Return clip positions in float32 of points (…, 3) seen from the origin along -z; depth is near 1, far
    0."""
    clip = np.stack(
        [1.5 * points[..., 0], 1.5 * points[..., 1], np.full(points.shape[:-1], NEAR), -points[..., 2]], -1
    )
    return clip.astype(np.float32).astype(np.float64)


def random_boxes(count: int, seed: int, nearest: float) -> Floats:
    """(count, 12, 3, 4) clip positions of boxes' triangles, of which the nearest begins so far from the eye;
    they are turned as the camera is."""
    rng = np.random.default_rng(seed)
    size = 2.0 ** rng.uniform(-3, 1.5, (count, 1, 3))
    low = np.stack(
        [*rng.uniform(-3, 3, (2, count)), -nearest - size[:, 0, 2] - 2.0 ** rng.uniform(-3, 3, count)], -1
    )
    if nearest < 0:  # through the near plane, or behind it
        low[:, 2] = -rng.uniform(0, 1, count) * size[:, 0, 2]
        low[:, :2] = -rng.uniform(-0.2, 1.2, (count, 2)) * size[:, 0, :2]
    unit = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)])
    points = low[:, None] + unit * size
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if nearest > 4 else np.eye(3)
    middle = np.array([0, 0, -nearest])
    triangles = FACES[:, [0, 1, 2, 0, 2, 3]].reshape(12, 3)
    return project((points - middle) @ turn.T + middle)[:, triangles]


def cover_exactly(
    triangle: Floats, sample: tuple[int, int] = (0, 0), *, back: bool = False
) -> NDArray[np.bool_]:
    """(h, w): which samples, so many subtexels from the centres, a triangle (3, 4) in front of the eye
    covers, by its front or also by its `back`: whole numbers and the top-left rule."""
    single = triangle.astype(np.float32)
    divided = (single[:, :2] * (np.float32(1) / single[:, 3:])).astype(np.float64)
    window = ((divided * (1, -1) + 1) * np.array(SIZE) / 2).astype(np.float32)
    fixed = np.rint((window - np.float32(0.5)) * np.float32(SUBTEXELS)).astype(np.int64)
    if not back and np.linalg.det(fixed[1:] - fixed[:1]) > 0:  # y counts downwards
        return np.zeros(SIZE[::-1], bool)
    return rasterise(fixed + SUBTEXELS // 2 - sample, *SIZE, SUBTEXELS)


def draw_alone(device: Device, mesh: Mesh, depth: rhi.Texture, *states: Any) -> NDArray[np.int64]:
    """(h, w): how many samples of a mesh pass at each pixel."""
    with device.texture(SIZE, Format.R32F) as image:
        with (
            device.render_pass(image, depth, clear=(0, 0, 0, 0)),
            device.states(DepthFunction.GREATER, DepthWrite.OFF, BlendFunction.ADDITIVE, *states),
        ):
            device.draw(device.program(FlatColored), mesh)
        return image.read().astype(np.int64)


def draw_counted(device: Device, meshes: list[Mesh], depth: rhi.Texture, waits: bool) -> list[int]:
    """Count the samples of each mesh that pass, in one batch or one by one."""
    program, queries = device.program(FlatColored), [device.occlusion_query() for _ in meshes]
    counts = []
    with (
        device.render_pass(depth=depth),
        device.states(DepthFunction.GREATER, DepthWrite.OFF, ColorWrite.OFF),
    ):
        for query, mesh in zip(queries, meshes, strict=True):
            with query:
                device.draw(program, mesh)
            if waits:
                counts.append(query.wait())
    counts = counts or [query.wait() for query in queries]
    for query in queries:
        query.destroy()
    return counts


def draw_set(device: Device, boxes: Floats, depth: rhi.Texture) -> list[int]:
    """Count the samples of each of the boxes (count, 12, 3, 4) that pass, by a query set."""
    count = len(boxes)
    queries = device.query_set(count)
    with (
        device.mesh(corners(boxes.reshape(-1, 4))) as mesh,
        device.render_pass(depth=depth),
        device.states(DepthFunction.GREATER, DepthWrite.OFF, ColorWrite.OFF),
    ):
        draws = mesh.draws(36 * np.arange(count), 36)
        device.draw_counted(device.program(FlatColored), mesh, draws, queries)
        counts: list[int] = queries.wait().tolist()
    queries.destroy()
    return counts


@pytest.mark.parametrize("nearest", [1.0, 6.0, -1.0])
def test_counts_are_those_of_boxes_drawn_alone(device: Device, nearest: float) -> None:
    """Counts in one batch, one by one, by a query set, and by pixels agree, for whole boxes, rotated boxes
    and boxes that the near plane cuts, in front of and behind a wall."""
    boxes = random_boxes(60, 1, nearest)
    meshes = [device.mesh(corners(box.reshape(-1, 4))) for box in boxes]
    for wall in (0.0, NEAR / (abs(nearest) + 2)):
        with device.texture(SIZE, Format.D32F) as depth:
            with device.render_pass(depth=depth, clear_depth=wall):
                pass
            alone = [int(draw_alone(device, mesh, depth).sum()) for mesh in meshes]
            assert draw_counted(device, meshes, depth, waits=False) == alone
            assert draw_counted(device, meshes, depth, waits=True) == alone
            assert draw_set(device, boxes, depth) == alone
        assert sum(count > 0 for count in alone) > 15
        if wall == 0.0 and nearest > 0:
            exact = [sum(int(cover_exactly(triangle).sum()) for triangle in box) for box in boxes]
            assert alone == exact


def test_counts_of_random_triangles_are_whole_numbers(device: Device) -> None:
    """Triangles in a batch each, some of them behind others."""
    rng = np.random.default_rng(3)
    middle, size = rng.uniform(-1, 1, (80, 1, 2)), 2.0 ** rng.uniform(-6, 1, (80, 1, 1))
    flat = middle + size * rng.uniform(-1, 1, (80, 3, 2))
    sides = flat[:, 1:] - flat[:, :1]
    turned = np.linalg.det(sides) < 0
    flat[turned] = flat[turned][:, ::-1]
    clip = np.concatenate([flat, np.full((80, 3, 1), 0.5), np.ones((80, 3, 1))], -1).astype(np.float32)
    triangles = clip.astype(np.float64)
    meshes = [device.mesh(corners(triangle)) for triangle in triangles]
    wall = np.zeros(SIZE[::-1], bool)
    wall[:, : SIZE[0] // 2] = True
    with device.texture(SIZE, Format.D32F) as depth:
        with (
            device.render_pass(depth=depth, clear_depth=0.0),
            device.states(DepthFunction.ALWAYS),
            device.mesh(rectangle(-1, -1, 0, 1, depth=0.75)) as nearer,
        ):
            device.draw(device.program(FlatColored), nearer)
        counts = draw_counted(device, meshes, depth, waits=False)
    assert counts == [int((cover_exactly(triangle) & ~wall).sum()) for triangle in triangles]
    assert sum(count > 0 for count in counts) > 20


@pytest.mark.parametrize("samples", [1, 4, 8])
def test_triangles_beyond_the_target_cover_the_texels_that_whole_numbers_compute(
    device: Device, samples: int
) -> None:
    """Of all sizes and in any order, half of them with perspective: only what a fixed-point grid can't hold
    is cut."""
    rng = np.random.default_rng(samples)
    middle, size = rng.uniform(-1.3, 1.3, (480, 1, 2)), 2.0 ** rng.uniform(-7, 1.5, (480, 1, 1))
    flat = np.clip(middle + size * rng.uniform(-1, 1, (480, 3, 2)), -4.0, 4.0)
    triangles = np.concatenate([flat, rng.uniform(0.1, 0.9, (480, 3, 1)), np.ones((480, 3, 1))], -1)
    triangles *= np.where(rng.random((480, 1, 1)) < 0.5, 2.0 ** rng.uniform(-2, 2, (480, 3, 1)), 1.0)
    triangles = triangles.astype(np.float32).astype(np.float64)
    with (
        device.texture(SIZE, Format.R32F, samples=samples) as image,
        device.texture(SIZE, Format.R32F) as mean,
        device.mesh(corners(triangles.reshape(-1, 4))) as mesh,
    ):
        with device.render_pass(image), device.states(CullMode.NONE, BlendFunction.ADDITIVE):
            device.draw(device.program(FlatColored), mesh)
        if samples > 1:
            image.resolve_to(mean)
        drawn = (mean if samples > 1 else image).read() * samples
    offsets = SAMPLES[samples]
    expected = sum(
        cover_exactly(triangle, offset, back=True).astype(int) for triangle in triangles for offset in offsets
    )
    np.testing.assert_array_equal(drawn, expected)
    assert drawn.sum() > 400_000 * samples
