"""Scenes on gl and cl, pixel by pixel: the same renderer code, the same image.

llvmpipe cuts what reaches beyond the viewport, at points that it rounds again; there an edge may pass on the
other side of a sample that lies within 1/256 pixel of it, and another surface shows. In a viewport `WIDER`
times as wide, through a projection as much wider, all has the same place in the window and is cut where
nobody sees it. Levels of images differ as each backend rounds them
(`test_each_mip_level_is_the_mean_of_the_level_before`), so here both have gl's.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES
from nights import rotate_seed
from numpy.typing import NDArray

import rhi
from renderer import shaders
from renderer.content import load_scene, parse_camera_path
from renderer.lab.measure.backend_passes import BackendPasses, BoxDepthShader
from renderer.scene import Scene
from rhi import BlendFunction, DepthFunction, DepthWrite, Device, Format, Viewport
from rhi.shading import vec4

SIZE = (480, 270)
PIXELS = SIZE[0] * SIZE[1]
FRAMES = (0, 900)
WIDER = 8


class WhiteBoxes(BoxDepthShader):
    """Draws boxes in white, so that they can be counted in an image."""

    def fragment(self) -> vec4:  # type: ignore[override]
        return vec4(1.0)


@pytest.fixture(scope="module")
def devices() -> Iterator[tuple[Device, Device]]:
    with rhi.create_device("gl") as gl, rhi.create_device("cl") as cl:
        yield gl, cl


@pytest.fixture(scope="module", params=["city", "hall"])
def scene(request: pytest.FixtureRequest) -> Scene:
    return load_scene(request.param)


def draw(
    device: Device, scene: Scene, path: str, frame: int, name: str, levels: list[NDArray[Any]] | None = None
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return colour as integers, and depth; `levels` are the mip levels of the scene's images below the
    first."""
    passes = BackendPasses(device, scene, parse_camera_path(path, scene).camera(frame), SIZE)
    for level, texels in enumerate(levels or [], 1):
        assert passes.resources.images is not None
        passes.resources.images.textures[0].write(texels, level=level)
    try:
        passes.work(name)(0)
        return passes.targets.image.read().astype(int), passes.targets.depth.read().astype(np.float64)
    finally:
        passes.destroy()


def read_levels(device: Device, scene: Scene) -> list[NDArray[Any]]:
    """Read all layers of each mip level below the first, as the device generated them."""
    passes = BackendPasses(device, scene, parse_camera_path("ground", scene).camera(0), SIZE)
    assert passes.resources.images is not None
    (images,) = passes.resources.images.textures
    levels = [
        np.stack([images.read(level, layer) for layer in range(images.layers)])
        for level in range(1, images.levels)
    ]
    passes.destroy()
    return levels


def draw_depth(
    device: Device, scene: Scene, path: str, frame: int, size: tuple[int, int], wider: int
) -> NDArray[Any]:
    """Draw the depth pass in a viewport several times as wide as the target."""
    passes = BackendPasses(device, scene, parse_camera_path(path, scene).camera(frame), size)
    projection, eye = passes.camera.relative_view_projection.copy(), passes.camera.position
    projection[:2] /= wider
    high = eye.astype(np.float32)
    passes.view.buffer.write(
        shaders.ViewConstants(
            relative_view_projection=projection, eye_high=high, eye_low=(eye - high).astype(np.float32)
        )
    )
    width, height = size
    view = Viewport((1 - wider) * width / 2, (1 - wider) * height / 2, wider * width, wider * height)
    try:
        with device.states(view):
            passes.draw_depth()
        return passes.targets.depth.read().astype(np.float64)
    finally:
        passes.destroy()


def check_depth(
    devices: tuple[Device, Device], scene: Scene, path: str, frame: int, size: tuple[int, int]
) -> None:
    """Check that both cover the same pixels at the same depth, except for a few of slivers thinner than the
    grid."""
    gl, cl = (draw_depth(device, scene, path, frame, size, WIDER) for device in devices)
    np.testing.assert_array_equal(gl > 0, cl > 0)
    assert (gl > 0).mean() > 0.5
    assert (np.abs(gl - cl) > 1e-5).sum() <= 2
    np.testing.assert_array_equal(cl, draw_depth(devices[1], scene, path, frame, size, 1))


@pytest.mark.nightly_cases("*-900", "city-sky-0", reason=FEWER_CASES)
@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("path", ["ground", "sky"])
def test_gl_and_cl_cover_the_same_pixels_of_a_scene(
    devices: tuple[Device, Device], scene: Scene, path: str, frame: int
) -> None:
    check_depth(devices, scene, path, frame, SIZE)


@pytest.mark.nightly
@pytest.mark.parametrize("frame", range(0, 1800, 450))
@pytest.mark.parametrize("path", ["ground", "sky"])
def test_gl_and_cl_cover_the_same_pixels_along_all_paths(
    devices: tuple[Device, Device], scene: Scene, path: str, frame: int
) -> None:
    """Seven nights draw every 64th frame."""
    turn = rotate_seed(0) % 7
    check_depth(
        devices, scene, path, frame + 64 * turn, (1024, 576)
    )  # WIDER times as wide is the most that PoCL draws


@pytest.mark.nightly_cases("*-900", "city-sky-0", reason=FEWER_CASES)
@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("path", ["ground", "sky"])
def test_gl_and_cl_draw_the_same_scene(
    devices: tuple[Device, Device], scene: Scene, path: str, frame: int
) -> None:
    (gl_color, gl_depth), (cl_color, cl_depth) = (draw(d, scene, path, frame, "lit") for d in devices)
    assert (gl_depth > 0).mean() > 0.5
    assert ((gl_depth > 0) != (cl_depth > 0)).sum() <= 1
    assert (np.abs(gl_depth - cl_depth) > 1e-5).sum() <= PIXELS / 50_000
    apart = np.abs(gl_color - cl_color).max(axis=2)
    assert (apart > 2).sum() <= PIXELS / 5000
    if scene.images:
        levels = read_levels(devices[0], scene)
        (gl_color, _), (cl_color, _) = (draw(d, scene, path, frame, "textured", levels) for d in devices)
        assert (np.abs(gl_color - cl_color).max(axis=2) > 2).sum() <= PIXELS / 5000


@pytest.mark.nightly_cases("city-sky", reason=FEWER_CASES)
@pytest.mark.parametrize("path", ["ground", "sky"])
def test_cl_draws_in_its_depth_pass_the_depth_of_its_lit_pass(
    devices: tuple[Device, Device], scene: Scene, path: str
) -> None:
    np.testing.assert_array_equal(
        draw(devices[1], scene, path, 900, "depth")[1], draw(devices[1], scene, path, 900, "lit")[1]
    )


@pytest.mark.nightly_cases("city-sky", reason=FEWER_CASES)
@pytest.mark.parametrize("path", ["ground", "sky"])
def test_gl_and_cl_count_the_same_samples(devices: tuple[Device, Device], scene: Scene, path: str) -> None:
    """For 1,000 boxes against the scene's depth; at an edge a sample more or less may be counted."""
    counts = []
    for device in devices:
        passes = BackendPasses(device, scene, parse_camera_path(path, scene).camera(900), SIZE)
        passes.work("queries")(0)
        counts.append(np.array(passes.count_boxes()))
        passes.destroy()
    gl, cl = counts
    assert (gl > 0).sum() > 20
    np.testing.assert_array_equal(gl > 0, cl > 0)
    assert np.abs(gl - cl).max() <= 2
    assert (gl != cl).sum() <= 10


@pytest.mark.nightly_cases("city-*", "hall-sky", reason=FEWER_CASES)
@pytest.mark.parametrize("path", ["ground", "sky"])
def test_cl_counts_the_samples_that_its_boxes_cover(
    devices: tuple[Device, Device], scene: Scene, path: str
) -> None:
    """Of up to 1,000 boxes, all at once and one by one; compared with each box drawn alone, every sample that
    passes adding one to its pixel."""
    device = devices[1]
    passes = BackendPasses(device, scene, parse_camera_path(path, scene).camera(900), SIZE)
    passes.work("queries")
    together, one_by_one = passes.count_boxes(), passes.wait_for_boxes()
    alone = []
    with device.texture(SIZE, Format.R32F) as image:
        program = device.program(WhiteBoxes)
        for box in passes._parts:
            with (
                device.render_pass(image, passes.targets.depth, clear=(0, 0, 0, 0)),
                device.states(DepthFunction.GREATER, DepthWrite.OFF, BlendFunction.ADDITIVE),
            ):
                device.draw(program, box, view=passes.view.buffer)
            alone.append(int(image.read().sum(dtype=np.float64)))
    passes.destroy()
    assert together == one_by_one == alone
    assert sum(count > 0 for count in alone) > 20
