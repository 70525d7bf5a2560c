"""Transient memory and immediate mode: allocations stay intact for their frame, even when the ring wraps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from rhi import BlendFunction, CullMode, Device, Format, Primitive
from rhi.conformance.compare import assert_mask, assert_near, assert_same
from rhi.conformance.reference import SUBTEXELS, rasterise
from rhi.conformance.shaders import Colored, Tint, Tinted
from rhi.conformance.shapes import centers, corners, rectangle, window_to_clip

pytestmark = [pytest.mark.needs("draws", "shading"), pytest.mark.recorded_too]


def points(count: int, size: tuple[int, int]) -> NDArray[Any]:
    """Return points on the first `count` texels of a target, row by row, with their numbers as colors."""
    number = np.arange(count)
    rows = corners(centers(np.stack([number % size[0], number // size[0]], axis=1), size))
    rows["color"][:, 0] = number
    return rows


# -- constants ---------------------------------------------------------------------------------------------


def test_each_draw_of_a_frame_has_its_own_constants(device: Device) -> None:
    size = (64, 32)
    count = size[0] * size[1]  # far more than the initial size of the ring
    rows = points(count, size)
    with device.texture(size, Format.R32F) as image, device.mesh(rows, primitive=Primitive.POINTS) as mesh:
        with device.render_pass(image):
            for index in range(count):
                tint = device.transient.uniform(Tint(color=(index, 0, 0, 0)))
                device.draw(device.program(Tinted), mesh.view(index, 1), tint=tint)
        device.present()
        assert_same(image.read().reshape(-1), np.arange(count))


def test_constants_made_first_and_drawn_later_are_intact(device: Device) -> None:
    """The ring grows during the frame; earlier allocations stay intact."""
    size = (32, 32)
    rows = points(1024, size)
    with device.texture(size, Format.R32F) as image, device.mesh(rows, primitive=Primitive.POINTS) as mesh:
        tints = [device.transient.uniform(Tint(color=(index, 0, 0, 0))) for index in range(1024)]
        with device.render_pass(image):
            for index in reversed(range(1024)):
                device.draw(device.program(Tinted), mesh.view(index, 1), tint=tints[index])
        device.present()
        assert_same(image.read().reshape(-1), np.arange(1024))


def test_constants_of_frames_in_flight_do_not_disturb_each_other(backend: str) -> None:
    """Many frames are drawn while the ring wraps, and none is read before the end."""
    with rhi.create_device(backend, validation=True, frames_in_flight=3) as device:
        rng = np.random.default_rng(0)
        frames, per_frame, size = 40, 60, (10, 6)
        images = [device.texture(size, Format.R32F) for _ in range(frames)]
        expected = rng.integers(0, 1000, (frames, per_frame))
        mesh = device.mesh(points(per_frame, size), primitive=Primitive.POINTS)
        for image, values in zip(images, expected, strict=True):
            with device.render_pass(image):
                for index, value in enumerate(values):
                    tint = device.transient.uniform(Tint(color=(value, 0, 0, 0)))
                    device.draw(device.program(Tinted), mesh.view(index, 1), tint=tint)
            device.present(image)
        for image, values in zip(images, expected, strict=True):
            assert_same(image.read().reshape(-1), values)


def test_a_fence_in_mid_frame_frees_nothing_of_the_frame(fresh_device: Device) -> None:
    """Transient memory lives until present(): waiting for the GPU within a frame must not allow its reuse."""
    device = fresh_device
    with device.texture((2, 2), Format.R32F) as image, device.mesh(rectangle()) as mesh:
        tint = device.transient.uniform(Tint(color=(7, 0, 0, 0)))
        device.finish()
        for index in range(2000):
            device.transient.uniform(Tint(color=(1000 + index, 0, 0, 0)))
        with device.render_pass(image):
            device.draw(device.program(Tinted), mesh, tint=tint)
        assert_same(image.read(), 7)


def test_a_ring_that_grows_keeps_what_was_given_out_alive(fresh_device: Device) -> None:
    device = fresh_device
    with device.texture((2, 2), Format.R32F) as image, device.mesh(rectangle()) as mesh:
        tint = device.transient.uniform(Tint(color=(7, 0, 0, 0)))
        capacity = device.transient.capacity
        while device.transient.capacity == capacity:
            device.transient.uniform(Tint(color=(1, 0, 0, 0)))
        device.finish()
        device.signal()
        with device.render_pass(image):
            device.draw(device.program(Tinted), mesh, tint=tint)
        assert_same(image.read(), 7)


def test_rings_settle_at_what_their_frames_need(fresh_device: Device) -> None:
    device = fresh_device
    for _ in range(100):
        for index in range(300):
            device.transient.uniform(Tint(color=(index, 0, 0, 0)))
        device.present()
    # Two frames in flight and the one being recorded. A ring grows by doubling and may leave its end unused.
    frame = 300 * max(16, device.capabilities.uniform_alignment)
    assert device.transient.capacity <= 4 * max(3 * frame, 1 << 16)


# -- vertices ----------------------------------------------------------------------------------------------


def test_transient_meshes_are_drawn_as_they_were_made(device: Device) -> None:
    size = (64, 16)
    program = device.program(Colored)
    rng = np.random.default_rng(1)
    rows = points(1024, size)
    with device.texture(size, Format.R32F) as image:
        with device.render_pass(image, clear=(-1, 0, 0, 0)):
            start = 0
            while start < 1024:
                stop = min(1024, start + int(rng.integers(1, 40)))
                mesh = device.transient.mesh(program, rows[start:stop], primitive=Primitive.POINTS)
                device.draw(program, mesh)
                start = stop
        device.present()
        assert_same(image.read().reshape(-1), np.arange(1024))


@pytest.mark.parametrize("dtype", ["u2", "u4", "u1", "i8"])
def test_transient_meshes_may_have_indices(device: Device, dtype: str) -> None:
    program = device.program(Colored)
    rows = points(8, (8, 1))
    with device.texture((8, 1), Format.R32F) as image:
        with device.render_pass(image, clear=(-1, 0, 0, 0)):
            for chosen in ([1, 3], [0], [7, 6]):
                mesh = device.transient.mesh(program, rows, np.array(chosen, dtype), Primitive.POINTS)
                device.draw(program, mesh)
        assert_same(image.read()[0], [0, 1, -1, 3, -1, -1, 6, 7])


def test_frames_of_transient_vertices_around_the_wrap_are_intact(fresh_device: Device) -> None:
    device = fresh_device
    program = device.program(Colored)
    rng = np.random.default_rng(2)
    size = (64, 8)
    rows = points(512, size)
    images = [device.texture(size, Format.R32F) for _ in range(25)]
    for frame, image in enumerate(images):
        with device.render_pass(image):
            start = 0
            while start < 512:
                stop = min(512, start + int(rng.integers(1, 200)))
                part = rows[start:stop].copy()
                part["color"][:, 0] += 1000 * frame
                device.draw(program, device.transient.mesh(program, part, primitive=Primitive.POINTS))
                start = stop
        device.present(image)
    for frame, image in enumerate(images):
        assert_same(image.read().reshape(-1), np.arange(512) + 1000 * frame)


# -- immediate mode ----------------------------------------------------------------------------------------


SIZE = (16, 16)
QUAD = [(2, 3), (2, 12), (9, 12), (9, 3)]


def covered(*triangles: Any) -> NDArray[np.bool_]:
    mask = np.zeros((16, 16), bool)
    for triangle in triangles:
        mask |= rasterise(np.array(triangle) * SUBTEXELS, *SIZE)
    return mask


def test_vertices_one_by_one_make_quads(device: Device) -> None:
    with device.texture(SIZE, Format.R8) as image:
        with device.render_pass(image), device.immediate(device.program(Colored), Primitive.QUADS) as quads:
            for x, y in window_to_clip(QUAD, SIZE):
                quads.vertex(position=(x, y, 0.5, 1.0), color=(1, 1, 1, 1))
        assert_mask(image.read(), covered(QUAD[:3], [QUAD[0], QUAD[2], QUAD[3]]))


@pytest.mark.parametrize("primitive", list(Primitive), ids=lambda p: p.name)
def test_immediate_vertices_draw_what_a_mesh_of_them_draws(device: Device, primitive: Primitive) -> None:
    rows = corners(centers([(1, 1), (3, 13), (14, 12), (12, 2), (5, 5), (6, 9), (10, 8), (9, 4)], SIZE))
    program = device.program(Colored)
    with (
        device.texture(SIZE, Format.R8) as one,
        device.texture(SIZE, Format.R8) as two,
        device.mesh(rows, primitive=primitive) as mesh,
        device.states(CullMode.NONE),
    ):
        with device.render_pass(one), device.immediate(program, primitive) as immediate:
            immediate.vertices(rows[:3])
            for row in rows[3:5]:
                immediate.vertex(position=row["position"], color=row["color"])
            immediate.vertices(rows[5:])
        with device.render_pass(two):
            device.draw(program, mesh)
        assert two.read().any()
        assert_same(one.read(), two.read())


def test_an_immediate_block_without_vertices_draws_nothing(device: Device) -> None:
    with device.texture(SIZE, Format.R8) as image:
        before = device.statistics.draws
        with device.render_pass(image), device.immediate(device.program(Colored), Primitive.TRIANGLES):
            pass
        assert device.statistics.draws == before
        assert_same(image.read(), 0)


def test_an_immediate_block_is_one_draw(device: Device) -> None:
    with device.texture(SIZE, Format.R8) as image:
        before = device.statistics.draws
        with (
            device.render_pass(image),
            device.immediate(device.program(Colored), Primitive.TRIANGLES) as triangles,
        ):
            for _ in range(10):
                triangles.vertices(rectangle())
        assert device.statistics.draws - before == 1


def test_an_exception_in_an_immediate_block_draws_nothing(device: Device) -> None:
    with device.texture(SIZE, Format.R8) as image:
        with pytest.raises(ZeroDivisionError), device.render_pass(image):
            with device.immediate(device.program(Colored), Primitive.TRIANGLES) as triangles:
                triangles.vertices(rectangle())
                raise ZeroDivisionError
        assert_same(image.read(), 0)


def test_an_immediate_block_takes_bindings_and_states(device: Device) -> None:
    tint = device.uniform(Tint(color=(0.2, 0, 0, 0)))
    with device.texture(SIZE, Format.R32F) as image:
        with device.render_pass(image, clear=(1, 0, 0, 0)), device.states(BlendFunction.ADDITIVE):
            with device.immediate(device.program(Tinted), Primitive.TRIANGLES, tint=tint) as triangles:
                triangles.vertices(rectangle())
        assert_near(image.read(), 1.2, 1e-6, "an addition in float32")
    tint.destroy()


def test_immediate_blocks_and_other_draws_keep_their_order(device: Device) -> None:
    program = device.program(Colored)
    with device.texture(SIZE, Format.R32F) as image, device.mesh(rectangle(color=(2, 0, 0, 0))) as mesh:
        with device.render_pass(image):
            for value in (1, 3):
                device.draw(program, mesh)
                with device.immediate(program, Primitive.TRIANGLES) as triangles:
                    triangles.vertices(rectangle(color=(value, 0, 0, 0)))
        assert_same(image.read(), 3)


def test_a_great_many_immediate_vertices_fit(device: Device) -> None:
    """20,000 vertices of 32 bytes don't fit into the initial size of the ring."""
    size = (200, 100)
    with device.texture(size, Format.R32F) as image:
        with device.render_pass(image), device.immediate(device.program(Colored), Primitive.POINTS) as many:
            many.vertices(points(20_000, size))
        device.present()
        assert_same(image.read().reshape(-1), np.arange(20_000))
