"""Row 0 is the top row, everywhere: clears, draws, reads, copies, samples, loads, stores, coordinates."""

from __future__ import annotations

import numpy as np
import pytest

import rhi.shading as sl
from rhi import Device, Format, Region, Viewport
from rhi.conformance.compare import assert_mask, assert_near, assert_same
from rhi.conformance.shaders import Colored, Corner, Shade, Shaded, Smooth
from rhi.conformance.shapes import WHITE, corners, rectangle
from rhi.conformance.single_draws import draw_once

pytestmark = [pytest.mark.requires("shading"), pytest.mark.recorded_too]


@pytest.mark.requires("draws")
def test_plus_y_is_up_and_row_0_is_the_top(device: Device) -> None:
    mask = np.zeros((4, 4), bool)
    mask[0] = True
    assert_mask(draw_once(device, (4, 4), Format.R8, rectangle(-1, 0.5, 1, 1)), mask)


@pytest.mark.requires("draws")
def test_plus_x_is_right(device: Device) -> None:
    mask = np.zeros((4, 4), bool)
    mask[:, 3] = True
    assert_mask(draw_once(device, (4, 4), Format.R8, rectangle(0.5, -1, 1, 1)), mask)


@pytest.mark.requires("draws")
def test_depth_has_its_top_row_first_too(device: Device) -> None:
    with device.texture((4, 4), Format.D32F) as target, device.mesh(rectangle(-1, 0.5, 1, 1)) as mesh:
        with device.render_pass(depth=target, clear_depth=0.0):
            device.draw(device.program(Colored), mesh)
        expected = np.zeros((4, 4))
        expected[0] = 0.5
        assert_same(target.read(), expected)
        assert_same(target.read(region=Region(0, 0, 4, 1)), 0.5)


@pytest.mark.requires("draws")
def test_a_drawn_texture_is_copied_as_it_is(device: Device) -> None:
    with (
        device.texture((4, 4), Format.RGBA8) as drawn,
        device.texture((4, 4), Format.RGBA8) as target,
        device.mesh(rectangle(-1, 0.5, -0.5, 1)) as corner,
    ):
        with device.render_pass(drawn, clear=(0, 0, 0, 0)):
            device.draw(device.program(Colored), corner)
        drawn.copy_to(target, region=Region(0, 0, 2, 2), x=2, y=1)
        mask = np.zeros((4, 4), bool)
        mask[1, 2] = True
        assert_mask(target.read(), mask)


class FragmentPosition(Shaded):
    """Writes the coordinates of the fragment."""

    def fragment(self, v: Shade) -> sl.vec4:
        return sl.fragment_coordinate()


@pytest.mark.requires("draws")
def test_fragment_coordinates_count_from_the_top_left(device: Device) -> None:
    rows = rectangle(depth=0.25)
    rows["position"] *= 2.0
    y, x = np.mgrid[0:3, 0:5] + 0.5
    drawn = draw_once(device, (5, 3), Format.RGBA32F, rows, shader=FragmentPosition)
    assert_same(drawn, np.stack([x, y, 0 * x + 0.25, 0 * x + 0.5], axis=-1))


@pytest.mark.requires("draws")
def test_fragment_coordinates_do_not_depend_on_the_viewport(device: Device) -> None:
    pixels = draw_once(
        device, (8, 8), Format.RGBA32F, rectangle(), Viewport(4, 2, 4, 4), shader=FragmentPosition
    )
    assert_same(pixels[2, 4, :2], (4.5, 2.5))
    assert_same(pixels[5, 7, :2], (7.5, 5.5))


class Derivatives(Shaded):
    """Writes the derivatives of the color, to the right and downwards."""

    def fragment(self, v: Shade) -> sl.vec4:
        return sl.vec4(sl.ddx(v.color.xy), sl.ddy(v.color.xy))


@pytest.mark.requires("draws")
def test_derivatives_point_right_and_down(device: Device) -> None:
    rows = rectangle()
    rows["color"][:, 0] = (rows["position"][:, 0] + 1) / 2 * 8  # grows to the right, by 1 a texel
    rows["color"][:, 1] = (1 - rows["position"][:, 1]) / 2 * 16  # grows downwards, by 2 a texel
    drawn = draw_once(device, (8, 8), Format.RGBA32F, rows, shader=Derivatives)
    assert_near(drawn, (1, 0, 0, 2), 1e-4, "differences of interpolated float32 values")


class Marks(sl.Shader):
    """Writes its own coordinates into an image."""

    target: sl.Image2D = sl.image(Format.RGBA32F)

    def compute(self) -> None:
        at = sl.global_id().xy
        self.target.store(at, sl.vec4(sl.vec2(at), 0.0, 1.0))


@pytest.mark.requires("compute")
@pytest.mark.requires("max_image_slots")
def test_image_stores_count_from_the_top_left(device: Device) -> None:
    with device.texture((5, 3), Format.RGBA32F) as target:
        device.dispatch(device.program(Marks), (5, 3), target=target.image())
        y, x = np.mgrid[0:3, 0:5]
        assert_same(target.read()[..., :2], np.stack([x, y], axis=-1))


class ImageLoads(sl.Shader):
    """Copies an image texel by texel."""

    source: sl.Image2D = sl.image(Format.RGBA8)
    target: sl.Image2D = sl.image(Format.RGBA8)

    def compute(self) -> None:
        at = sl.global_id().xy
        self.target.store(at, self.source.load(at))


@pytest.mark.requires("compute")
@pytest.mark.requires("draws", "max_image_slots")
def test_image_loads_see_drawn_texels_from_the_top_left(device: Device) -> None:
    with (
        device.texture((4, 4), Format.RGBA8) as drawn,
        device.texture((4, 4), Format.RGBA8) as target,
        device.mesh(rectangle(-1, 0.5, -0.5, 1)) as corner,
    ):
        with device.render_pass(drawn, clear=(0, 0, 0, 0)):
            device.draw(device.program(Colored), corner)
        device.dispatch(device.program(ImageLoads), (4, 4), source=drawn.image(), target=target.image())
        mask = np.zeros((4, 4), bool)
        mask[0, 0] = True
        assert_mask(target.read(), mask)


# -- matrices ----------------------------------------------------------------------------------------------


class Camera(sl.Struct):
    """Matrices of three sizes, and a number after them that reveals a wrong layout."""

    world: sl.mat4
    rotation: sl.mat3
    flat: sl.mat2
    scale: float


class Moved(Smooth):
    """Transforms positions by a matrix."""

    camera: sl.Uniform[Camera]

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=self.camera.world @ v.position, color=v.color)


ROTATION = np.array([(1, 2, 3), (4, 5, 6), (7, 8, 10)], float)
FLAT = np.array([(1, 2), (3, 4)], float)


@pytest.mark.requires("draws")
def test_a_matrix_is_applied_as_numpy_does(device: Device) -> None:
    """`matrix @ vector`, uploaded without a transposition by the user: a translation is in the last
    column."""
    world = np.eye(4)
    world[:3, 3] = (1.0, 0.5, 0.0)
    rows = rectangle(-1, 0, -0.5, 0.5)
    with device.uniform(Camera(world=world, rotation=ROTATION, flat=FLAT, scale=1.0)) as camera:
        mask = np.zeros((4, 4), bool)
        mask[0, 2] = True
        assert_mask(draw_once(device, (4, 4), Format.R8, rows, shader=Moved, camera=camera), mask)


class Products(sl.Shader):
    """Every product of matrix and vector, and single elements."""

    camera: sl.Uniform[Camera]
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        v = sl.vec3(1.0, 10.0, 100.0)
        self.results[0] = sl.vec4(self.camera.rotation @ v, self.camera.scale)
        self.results[1] = sl.vec4(v @ self.camera.rotation, 0.0)
        self.results[2] = sl.vec4(
            self.camera.flat @ sl.vec2(1.0, 10.0), sl.vec2(1.0, 10.0) @ self.camera.flat
        )
        self.results[3] = self.camera.world @ sl.vec4(v, 1000.0)
        self.results[4] = sl.vec4((self.camera.rotation @ self.camera.rotation) @ v, 0.0)


@pytest.mark.requires("compute")
def test_products_of_matrices_are_those_of_numpy(device: Device) -> None:
    world = np.arange(16.0).reshape(4, 4)
    v = np.array([1.0, 10.0, 100.0])
    with (
        device.uniform(Camera(world=world, rotation=ROTATION, flat=FLAT, scale=7.0)) as camera,
        device.storage(sl.vec4, 5) as results,
    ):
        device.dispatch(device.program(Products), 1, camera=camera, results=results)
        back = results.read()
    assert_same(back[0], (*(ROTATION @ v), 7.0))
    assert_same(back[1, :3], v @ ROTATION)
    assert_same(back[2], (*(FLAT @ v[:2]), *(v[:2] @ FLAT)))
    assert_same(back[3], world @ (*v, 1000.0))
    assert_same(back[4, :3], ROTATION @ ROTATION @ v)


@pytest.mark.requires("draws")
def test_white_is_white(device: Device) -> None:
    """A control for these tests: a white triangle over the whole target makes every texel white."""
    whole = corners([(-1, -1), (3, -1), (-1, 3)], WHITE)
    assert_same(draw_once(device, (2, 2), Format.RGBA8, whole), 255)
