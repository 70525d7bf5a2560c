"""Cut and thin triangles on cl, beyond what the conformance kit asks of all backends: many more of them,
samples under scissors, depth bias, and bounds of depth."""

from __future__ import annotations

import numpy as np
import pytest

import rhi
from rhi import CullMode, DepthBias, DepthFunction, DepthWrite, Device, Format, PolygonOffset, Scissor
from rhi.conformance import triangles as exam
from rhi.conformance.shaders import FlatColored
from rhi.conformance.shapes import corners, rectangle
from rhi.conformance.single_draws import draw_once
from rhi.conformance.triangles import CUT, WHOLE, Family, examine, make_triangles

SIZE = (64, 64)


@pytest.mark.nightly
@pytest.mark.parametrize("family", [*CUT, *WHOLE], ids=lambda family: family.__name__)
def test_thousands_of_triangles_are_those_of_float64(device: Device, family: Family) -> None:
    """5,120 of each family; `benchmarks/triangles.py` examines a million."""
    for seed in range(100, 120):
        result = examine(device, family, seed)
        assert not result.wrong.any()
        assert result.depth_error <= 2e-5
        assert result.depth_beyond <= 2.0**-23
        assert result.weight_beyond <= 1e-6


@pytest.mark.parametrize("scale", [1e-34, 1e30])
@pytest.mark.parametrize("family", [exam.of_all_magnitudes, exam.through_the_near_plane])
def test_the_magnitude_of_w_changes_nothing(device: Device, family: Family, scale: float) -> None:
    result = examine(device, lambda rng, count: family(rng, count) * scale, 3)
    assert not result.wrong.any()
    assert result.depth_error <= 2e-5
    assert result.weight_error <= 1e-3


def draw(device: Device, rows: np.ndarray, format: Format, *states: rhi.State) -> np.ndarray:
    """Return the depth that triangles leave; the largest one passes."""
    return draw_once(device, SIZE, format, rows, CullMode.NONE, *states, shader=FlatColored).astype(
        np.float64
    )


@pytest.mark.parametrize("family", [exam.slivers, exam.through_the_near_plane])
def test_every_sample_has_the_same_depth_under_any_scissor(device: Device, family: Family) -> None:
    """The same triangle drawn again, in four windows, passes EQUAL in all samples."""
    program, query, seen = device.program(FlatColored), device.occlusion_query(), 0
    windows = [Scissor(0, 0, 23, 31), Scissor(23, 0, 41, 31), Scissor(0, 31, 23, 33), Scissor(23, 31, 41, 33)]
    with device.texture(SIZE, Format.D32F, samples=8) as depth:
        for triangle in make_triangles(family, 8)[:48]:
            with device.mesh(corners(triangle)) as mesh, device.render_pass(depth=depth, clear_depth=0.0):
                with device.states(CullMode.NONE, DepthFunction.ALWAYS), query:
                    device.draw(program, mesh)
                drawn, again = query.wait(), 0
                for window in windows:
                    with device.states(CullMode.NONE, DepthFunction.EQUAL, DepthWrite.OFF, window), query:
                        device.draw(program, mesh)
                    again += query.wait()
            assert again == drawn, triangle.tolist()
            seen += drawn
    assert seen > 100


@pytest.mark.parametrize("family", [exam.slivers, exam.of_a_pixel, exam.through_the_near_plane])
@pytest.mark.parametrize(
    ("states", "offset"),
    [((DepthBias(-100),), -100 / 65535), ((PolygonOffset(-1e6, -0.01),), -0.01)],
    ids=["units", "slope"],
)
def test_a_bias_moves_thin_and_cut_triangles(
    device: Device, family: Family, states: tuple[rhi.State, ...], offset: float
) -> None:
    """Also the range that their depths are held in."""
    seen = 0
    for triangle in make_triangles(family, 3)[:60]:
        depth = draw(device, corners(triangle), Format.D16)
        drawn = depth > 0.02
        moved = draw(device, corners(triangle), Format.D16, *states)
        assert np.abs(moved - depth - offset)[drawn].max(initial=0.0) <= 1.01 / 65535, triangle.tolist()
        seen += int(drawn.sum())
    assert seen > 20


@pytest.mark.parametrize("family", [exam.slivers, exam.at_the_eye, exam.of_all_magnitudes])
def test_bounds_of_depth_cull_nothing_that_passes(device: Device, family: Family) -> None:
    """Behind and before a wall, the samples that pass are those that are nearer than it."""
    program, query, seen = device.program(FlatColored), device.occlusion_query(), 0
    wall = rectangle(depth=0.4)
    with device.texture(SIZE, Format.D32F) as depth, device.mesh(wall) as before:
        for triangle in make_triangles(family, 4)[:80]:
            nearer = int((draw(device, corners(triangle), Format.D32F) > np.float32(0.4)).sum())
            with (
                device.mesh(corners(triangle)) as mesh,
                device.render_pass(depth=depth, clear_depth=0.0),
                device.states(CullMode.NONE, DepthFunction.GREATER),
            ):
                device.draw(program, before)
                with query:
                    device.draw(program, mesh)
            assert query.wait() == nearer, triangle.tolist()
            seen += nearer
    assert seen > 20
