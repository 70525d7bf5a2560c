"""Transient memory and immediate mode: allocations stay intact for their frame, even when the ring wraps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
import rhi.shading as sl
from rhi import BlendFunction, CullMode, Device, Format, Primitive, ValidationError
from rhi.conformance import shaders
from rhi.conformance.compare import assert_mask, assert_near, assert_same
from rhi.conformance.reference import SUBTEXELS, rasterise
from rhi.conformance.shapes import centers, corners, rectangle, window_to_clip
from rhi.conformance.single_draws import draw_once

pytestmark = [pytest.mark.requires("draws", "shading"), pytest.mark.recorded_too]


def points(count: int, size: tuple[int, int]) -> NDArray[Any]:
    """Return points on the first `count` texels of a target, row by row, with their numbers as colors."""
    number = np.arange(count)
    rows = corners(centers(np.stack([number % size[0], number // size[0]], axis=1), size))
    rows["color"][:, 0] = number
    return rows


# -- constants ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("way", ["transient", "value", "fields"])
def test_each_draw_of_a_frame_has_its_own_constants(device: Device, way: str) -> None:
    size = (64, 32)
    count = size[0] * size[1]  # far more than the initial size of the ring
    rows = points(count, size)
    with device.texture(size, Format.R32F) as image, device.mesh(rows, primitive=Primitive.POINTS) as mesh:
        with device.render_pass(image):
            for index in range(count):
                color = (index, 0, 0, 0)
                value = {"color": color} if way == "fields" else shaders.Tint(color=color)
                tint: Any = device.transient.uniform(value) if way == "transient" else value
                device.draw(device.program(shaders.Tinted), mesh.view(index, 1), tint=tint)
        device.present()
        assert_same(image.read().reshape(-1), np.arange(count))


def test_a_value_is_read_when_it_is_drawn_with(device: Device) -> None:
    """One struct changes between draws, takes turns with a buffer, and is given to each kind of draw."""
    size, tint = (8, 1), shaders.Tint(color=(0, 0, 0, 0))
    buffer, program = device.uniform(shaders.Tint(color=(100, 0, 0, 0))), device.program(shaders.Tinted)
    with (
        device.texture(size, Format.R32F) as image,
        device.mesh(points(8, size), primitive=Primitive.POINTS) as mesh,
    ):
        with device.render_pass(image):
            for index in range(6):
                tint.color = sl.vec4(index + 1, 0, 0, 0)
                device.draw(program, mesh.view(index, 1), tint=buffer if index in (2, 3) else tint)
            part = mesh.draws()
            part["first"], part["count"] = 6, 1
            device.draw_many(program, mesh, part, tint=shaders.Tint(color=(7, 0, 0, 0)))
            with device.immediate(
                program, Primitive.POINTS, tint=shaders.Tint(color=(8, 0, 0, 0))
            ) as immediate:
                immediate.vertices(points(8, size)[7:])
        device.present()
        assert_same(image.read().reshape(-1), [1, 2, 100, 100, 5, 6, 7, 8])
    buffer.destroy()


def test_constants_made_first_and_drawn_later_are_intact(device: Device) -> None:
    """The ring grows during the frame; earlier allocations stay intact."""
    size = (32, 32)
    rows = points(1024, size)
    with device.texture(size, Format.R32F) as image, device.mesh(rows, primitive=Primitive.POINTS) as mesh:
        tints = [device.transient.uniform(shaders.Tint(color=(index, 0, 0, 0))) for index in range(1024)]
        with device.render_pass(image):
            for index in reversed(range(1024)):
                device.draw(device.program(shaders.Tinted), mesh.view(index, 1), tint=tints[index])
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
                    tint = device.transient.uniform(shaders.Tint(color=(value, 0, 0, 0)))
                    device.draw(device.program(shaders.Tinted), mesh.view(index, 1), tint=tint)
            device.present(image)
        for image, values in zip(images, expected, strict=True):
            assert_same(image.read().reshape(-1), values)


def test_a_fence_in_mid_frame_frees_nothing_of_the_frame(fresh_device: Device) -> None:
    """Transient memory lives until present(): waiting for the GPU within a frame must not allow its reuse."""
    device = fresh_device
    with device.texture((2, 2), Format.R32F) as image, device.mesh(rectangle()) as mesh:
        tint = device.transient.uniform(shaders.Tint(color=(7, 0, 0, 0)))
        device.finish()
        for index in range(2000):
            device.transient.uniform(shaders.Tint(color=(1000 + index, 0, 0, 0)))
        with device.render_pass(image):
            device.draw(device.program(shaders.Tinted), mesh, tint=tint)
        assert_same(image.read(), 7)


def test_a_ring_that_grows_keeps_earlier_allocations_alive(fresh_device: Device) -> None:
    device = fresh_device
    with device.texture((2, 2), Format.R32F) as image, device.mesh(rectangle()) as mesh:
        tint = device.transient.uniform(shaders.Tint(color=(7, 0, 0, 0)))
        capacity = device.transient.capacity
        while device.transient.capacity == capacity:
            device.transient.uniform(shaders.Tint(color=(1, 0, 0, 0)))
        device.finish()
        device.signal()
        with device.render_pass(image):
            device.draw(device.program(shaders.Tinted), mesh, tint=tint)
        assert_same(image.read(), 7)


def test_rings_settle_at_the_size_that_their_frames_need(fresh_device: Device) -> None:
    device = fresh_device
    for _ in range(100):
        for index in range(300):
            device.transient.uniform(shaders.Tint(color=(index, 0, 0, 0)))
        device.present()
    # Two frames in flight and the one being recorded. A ring grows by doubling and may leave its end unused.
    frame = 300 * max(16, device.capabilities.uniform_alignment)
    assert device.transient.capacity <= 4 * max(3 * frame, 1 << 16)


# -- vertices ----------------------------------------------------------------------------------------------


def test_transient_meshes_are_drawn_as_they_were_made(device: Device) -> None:
    size = (64, 16)
    program = device.program(shaders.Colored)
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
    program = device.program(shaders.Colored)
    rows = points(8, (8, 1))
    with device.texture((8, 1), Format.R32F) as image:
        with device.render_pass(image, clear=(-1, 0, 0, 0)):
            for indices in ([1, 3], [0], [7, 6]):
                mesh = device.transient.mesh(program, rows, np.array(indices, dtype), Primitive.POINTS)
                device.draw(program, mesh)
        assert_same(image.read()[0], [0, 1, -1, 3, -1, -1, 6, 7])


def test_frames_of_transient_vertices_around_the_wrap_are_intact(fresh_device: Device) -> None:
    device = fresh_device
    program = device.program(shaders.Colored)
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


class Flagged(sl.Struct):
    """A color of the whole primitive, and a number that integers feed."""

    position: sl.vec2
    number: int


class FlaggedShader(shaders.Flat):
    """Draws vertices in the color of their number."""

    def vertex(self, v: Flagged) -> shaders.FlatShade:
        return shaders.FlatShade(clip=sl.vec4(v.position, 0.5, 1.0), color=sl.vec4(float(v.number)))


PACKED = np.dtype([("position", "<f4", 2), ("uv", "<f4", 2), ("color", "u1", 4)])
"""The vertices of an interface's draw lists, with a field that the program doesn't read."""


def packed_points(count: int) -> NDArray[Any]:
    """Return points on the first texels of a row, with a quarter of their numbers as color."""
    rows = np.zeros(count, PACKED)
    rows["position"] = centers(np.stack([np.arange(count), np.zeros(count)], axis=1), (count, 1))
    rows["color"][:, 0] = np.arange(count) * 4
    return rows


@pytest.mark.parametrize("code", ["u1", "i1", "u2", "i2"])
@pytest.mark.parametrize("way", ["transient", "immediate"])
def test_integers_that_feed_floats_are_normalised(device: Device, way: str, code: str) -> None:
    """A transient vertex array with a vec4 of bytes draws what a mesh of it draws, not 255 times as much."""
    components = 4 if code[1] == "1" else 2
    values = np.array([0, 1, 100, np.iinfo(code).max, np.iinfo(code).min])
    rows = np.zeros(5, np.dtype([("position", "<f4", 2), ("color", code, components)]))
    rows["position"] = centers(np.stack([np.arange(5), np.zeros(5)], axis=1), (5, 1))
    rows["color"][:, 0] = values
    program = device.program(shaders.PaintedShader if components == 4 else shaders.PaintedTwice)
    with device.texture((5, 1), Format.R32F) as image:
        with device.render_pass(image, clear=(9, 0, 0, 0)):
            if way == "immediate":
                with device.immediate(program, Primitive.POINTS) as points_block:
                    points_block.vertices(rows)
            else:
                device.draw(program, device.transient.mesh(program, rows, primitive=Primitive.POINTS))
        device.present()
        expected = np.maximum(values / np.iinfo(code).max, -1)
        assert_near(image.read()[0], expected, 1e-6, "a division in float32")


@pytest.mark.parametrize("way", ["transient", "immediate"])
def test_arrays_by_name_make_transient_vertices(device: Device, way: str) -> None:
    """NumPy's float64 becomes float32, as in a mesh."""
    rows = points(6, (6, 1))
    arrays = {"position": rows["position"].astype(np.float64), "color": rows["color"]}
    program = device.program(shaders.Colored)
    with device.texture((6, 1), Format.R32F) as image:
        with device.render_pass(image, clear=(9, 0, 0, 0)):
            if way == "immediate":
                with device.immediate(program, Primitive.POINTS) as block:
                    block.vertices(arrays)
            else:
                device.draw(program, device.transient.mesh(program, arrays, primitive=Primitive.POINTS))
        device.present()
        assert_same(image.read()[0], np.arange(6))


def test_floats_for_integer_attributes_are_refused(device: Device) -> None:
    program = device.program(FlaggedShader)
    rows = np.zeros(2, [("position", "<f4", 2), ("number", "<f4")])
    right = np.zeros(2, [("position", "<f4", 2), ("number", "<i4")])
    with device.texture((4, 4), Format.R32F) as image, device.render_pass(image):
        with pytest.raises(ValidationError, match="immediate-vertex"):
            device.transient.mesh(program, rows)
        device.transient.mesh(program, right)
        with device.immediate(program, Primitive.POINTS) as block:
            with pytest.raises(ValidationError, match="immediate-vertex"):
                block.vertices(rows)
            block.vertices(right)
        with pytest.raises(ValidationError, match="immediate-vertex"):
            with device.immediate(program, Primitive.POINTS) as block:
                block.vertex(position=(0, 0), number=1.5)
        with device.immediate(program, Primitive.POINTS) as block:
            block.vertex(position=(0, 0), number=np.int64(1))


def test_views_of_a_transient_mesh_draw_its_parts(device: Device) -> None:
    """The draw lists of an interface: one upload of vertices and indices a frame, and a view for each
    command."""
    count, program = 48, device.program(shaders.PaintedShader)
    rows = packed_points(count)
    with device.texture((count, 1), Format.R32F) as image:
        for _ in range(3):  # frames, so that the mesh lies at other places in its ring
            with device.render_pass(image, clear=(9, 0, 0, 0)):
                indices = np.arange(count // 2, dtype="u2")
                mesh = device.transient.mesh(program, rows, indices, Primitive.POINTS)
                for first, base in ((0, 0), (5, 24), (20, 1), (20, 24)):
                    device.draw(program, mesh.view(first, 4, base_vertex=base))
                plain = device.transient.mesh(program, rows, primitive=Primitive.TRIANGLES)
                device.draw(program, plain.view(12, 3).view(13, 2, primitive=Primitive.POINTS))
            device.present()
            drawn = np.full(count, 9.0)
            for texel in (*range(4), *range(29, 33), *range(21, 25), *range(44, 48), 13, 14):
                drawn[texel] = texel * 4 / 255
            assert_near(image.read()[0], drawn, 1e-6, "a division in float32")


def test_draws_of_a_transient_mesh_count_from_its_own_start(device: Device) -> None:
    count, program = 16, device.program(shaders.PaintedShader)
    rows = packed_points(count)
    with device.texture((count, 1), Format.R32F) as image:
        with device.render_pass(image, clear=(9, 0, 0, 0)):
            device.transient.mesh(program, rows[:3])  # so that the next ones don't lie at 0
            plain = device.transient.mesh(program, rows, primitive=Primitive.POINTS)
            device.draw_many(program, plain, plain.draws([0, 4], [1, 2]))
            device.transient.mesh(program, rows[:3], np.arange(3))
            indexed = device.transient.mesh(program, rows, np.arange(8, dtype="u2"), Primitive.POINTS)
            device.draw_many(program, indexed, indexed.draws([2, 0], 2, base_vertex=[8, 7]))
        device.present()
        drawn = np.full(count, 9.0)
        drawn[[0, 4, 5, 10, 11, 7, 8]] = np.array([0, 4, 5, 10, 11, 7, 8]) * 4 / 255
        assert_near(image.read()[0], drawn, 1e-6, "a division in float32")


class Instance(sl.Struct):
    """A point, moved by its instance and in the color of its number."""

    position: sl.vec2
    shift: sl.vec2


class Instanced(shaders.Flat):
    """Draws the number of each instance."""

    def vertex(self, v: Instance) -> shaders.FlatShade:
        return shaders.FlatShade(
            clip=sl.vec4(v.position + v.shift, 0.5, 1.0), color=sl.vec4(float(sl.instance_index()))
        )


@pytest.mark.parametrize("way", ["transient", "immediate"])
def test_transient_instances_are_counted_from_their_first(device: Device, way: str) -> None:
    count, program = 12, device.program(Instanced)
    shifts = np.zeros(count, [("shift", "<f4", 2)])
    shifts["shift"][:, 0] = np.arange(count) * 2 / count
    first_point = centers(np.zeros((1, 2)), (count, 1)).astype(np.float32)
    with device.texture((count, 1), Format.R32F) as image:
        for _ in range(2):
            with device.render_pass(image, clear=(99, 0, 0, 0)):
                if way == "immediate":
                    with device.immediate(program, Primitive.POINTS) as block:
                        block.instances(shifts[:7])
                        block.vertex(position=first_point[0])
                else:
                    whole = device.transient.mesh(
                        program, {"position": first_point}, primitive=Primitive.POINTS, instances=shifts
                    )
                    device.draw(program, whole, 3)
                    device.draw(program, whole.view(base_instance=3), 4)
            device.present()
            assert_same(image.read()[0], [*range(7), *[99] * 5])


def test_vertices_follow_their_instances(device: Device) -> None:
    program = device.program(Instanced)
    shifts = {"shift": np.zeros((1, 2))}
    with device.texture((4, 4), Format.R32F) as image, device.render_pass(image):
        with device.immediate(program, Primitive.POINTS) as block:
            with pytest.raises(ValidationError, match="immediate-vertex"):
                block.instances({"tint": np.zeros((1, 2))})
            block.instances(shifts)
            with pytest.raises(ValidationError, match="immediate-vertex"):
                block.instances(shifts)
            with pytest.raises(ValidationError, match="immediate-vertex"):
                block.vertex(position=(0, 0), shift=(0, 0))
            block.vertex(position=(0, 0))
        with device.immediate(program, Primitive.POINTS) as block:
            block.vertex(position=(0, 0), shift=(0, 0))
            with pytest.raises(ValidationError, match="immediate-vertex"):
                block.instances(shifts)


def test_a_mesh_made_before_its_ring_grew_is_drawn_after_it(fresh_device: Device) -> None:
    """The memory that the ring has outgrown lives until the end of the frame, also when the GPU has caught up
    meanwhile."""
    device = fresh_device
    program = device.program(shaders.Colored)
    rows = points(4, (4, 1))
    with device.texture((4, 1), Format.R32F) as image:
        early = device.transient.mesh(program, rows, np.arange(4), Primitive.POINTS)
        capacity = device.transient.capacity
        while device.transient.capacity == capacity:
            device.transient.mesh(program, points(512, (512, 1)), primitive=Primitive.POINTS)
        device.transient.mesh(program, rows, np.arange(4))
        device.finish()
        device.signal()
        device.finish()
        with device.render_pass(image, clear=(9, 0, 0, 0)):
            device.draw(program, early)
        assert_same(image.read()[0], np.arange(4))


class Weighed(shaders.Flat):
    """Draws instances in colors from storage, scaled by one number."""

    scale: sl.Uniform[float]
    weights: sl.Storage[sl.vec4]

    def vertex(self, v: Instance) -> shaders.FlatShade:
        position = sl.vec4(v.position + v.shift, 0.5, 1.0)
        return shaders.FlatShade(clip=position, color=self.weights[sl.instance_index()] * self.scale)


def test_a_command_buffer_has_transient_geometry_of_its_own(device: Device) -> None:
    """It lives as long as the buffer, so later frames may submit it again."""
    count, program = 8, device.program(Weighed)
    shifts = np.zeros(count, [("shift", "<f4", 2)])
    shifts["shift"][:, 0] = np.arange(count) * 2 / count
    first_point = centers(np.zeros((1, 2)), (count, 1)).astype(np.float32)
    weights = np.repeat(np.arange(count, dtype="<f4")[:, None], 4, 1)
    with device.texture((count, 1), Format.R32F) as image:
        with device.record() as commands, commands.render_pass(image, clear=(99, 0, 0, 0)):
            memory = commands.transient
            bound: Any = {"scale": memory.uniform(2.0), "weights": memory.storage(sl.vec4, weights)}
            mesh = memory.mesh(
                program,
                {"position": np.repeat(first_point, 3, 0)},
                primitive=Primitive.POINTS,
                instances=shifts,
            )
            commands.draw(program, mesh.view(1, 1), 2, **bound)
            commands.draw(program, mesh.view(2, 1, base_instance=2), 3, **bound)
            with commands.immediate(program, Primitive.POINTS, **bound) as block:
                block.instances(shifts[:1])
                block.vertex(position=first_point[0] + (2 * 6 / count, 0))
        for _ in range(2):
            device.submit(commands)
            device.present()
            assert_same(image.read()[0], [0, 2, 4, 6, 8, 99, 0, 99])


# -- storage -----------------------------------------------------------------------------------------------


class Accumulate(sl.Shader):
    """Adds to storage."""

    sums: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        self.sums[0] = self.sums[0] + sl.vec4(1.0)


def test_each_draw_of_a_frame_reads_its_own_storage(device: Device) -> None:
    size = (32, 8)
    rows = points(256, size)
    program = device.program(shaders.Weighted)
    with device.texture(size, Format.R32F) as image, device.mesh(rows, primitive=Primitive.POINTS) as mesh:
        with device.render_pass(image):
            for index in range(256):
                weights = np.full((1 + index % 3, 4), index, "<f4")
                device.draw(program, mesh.view(index, 1), weights=device.transient.storage(sl.vec4, weights))
        device.present()
        assert_same(image.read().reshape(-1), np.arange(256))


@pytest.mark.requires("compute")
def test_transient_storage_is_read_only(device: Device) -> None:
    program = device.program(Accumulate)
    with pytest.raises(ValidationError, match="binding-type"):
        device.dispatch(program, 1, sums=device.transient.storage(sl.vec4, 4))
    with device.storage(sl.vec4, 1) as sums:
        device.dispatch(program, 1, sums=sums)
        assert_same(sums.read(), [[1, 1, 1, 1]])


def test_transient_storage_of_a_number_is_zeroed(device: Device) -> None:
    with device.texture((2, 2), Format.R32F) as image, device.mesh(rectangle()) as mesh:
        for _ in range(3):
            device.transient.storage(sl.vec4, np.full((64, 4), 7, "<f4"))
            device.present()
        with device.render_pass(image, clear=(9, 0, 0, 0)):
            device.draw(device.program(shaders.Weighted), mesh, weights=device.transient.storage(sl.vec4, 64))
        assert_same(image.read(), 0)


# -- single values -----------------------------------------------------------------------------------------


class Values(shaders.Flat):
    """Sums single values of each kind, so that each lies where the layout says."""

    scale: sl.Uniform[float]
    number: sl.Uniform[int]
    bits: sl.Uniform[sl.uint]
    offset: sl.Uniform[sl.vec3]
    rotation: sl.Uniform[sl.mat3]
    view: sl.Uniform[sl.mat4]

    def vertex(self, v: shaders.Corner) -> shaders.FlatShade:
        turned = self.rotation @ self.offset
        seen = self.view @ sl.vec4(turned, self.scale)
        return shaders.FlatShade(
            clip=v.position, color=seen + sl.vec4(float(self.number), float(self.bits), 0.0, 0.0)
        )


@pytest.mark.parametrize("way", ["uniform", "transient", "write", "value"])
def test_numbers_vectors_and_matrices_are_bound_as_they_are(device: Device, way: str) -> None:
    rng = np.random.default_rng(3)
    rotation, view = rng.integers(-4, 5, (3, 3)).astype("f4"), rng.integers(-4, 5, (4, 4)).astype("f4")
    values: dict[str, Any] = {
        "scale": 0.5,
        "number": -3,
        "bits": np.uint32(7),
        "offset": np.array([1.0, 2, 3]),
        "rotation": rotation,
        "view": view,
    }
    make: Any = device.transient.uniform if way == "transient" else device.uniform
    bound = values if way == "value" else {name: make(value) for name, value in values.items()}
    if way == "write":
        for name, value in values.items():
            bound[name].write(value * 0)
            bound[name].write(value)
    expected = view @ np.array([*(rotation @ [1, 2, 3]), 0.5]) + [-3, 7, 0, 0]
    assert_same(
        draw_once(device, (1, 1), Format.RGBA32F, rectangle(), shader=Values, **bound)[0, 0], expected
    )


def test_a_single_value_is_bound_as_its_own_class(device: Device) -> None:
    program = device.program(Values)
    with device.texture((1, 1), Format.RGBA32F) as image, device.mesh(rectangle()) as mesh:
        right: dict[str, Any] = {
            "scale": device.transient.uniform(0.5),
            "number": device.transient.uniform(1),
            "bits": device.transient.uniform(sl.uint(1)),
            "offset": device.transient.uniform(sl.vec3(0)),
            "rotation": device.transient.uniform(sl.mat3(1)),
            "view": device.transient.uniform(sl.mat4(1)),
        }
        with device.render_pass(image):
            device.draw(program, mesh, **right)
            for name, wrong in (("scale", 1), ("number", 1.0), ("bits", 1), ("view", sl.mat3(1))):
                with pytest.raises(ValidationError, match="binding-type"):
                    device.draw(program, mesh, **right | {name: device.transient.uniform(wrong)})


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
        with (
            device.render_pass(image),
            device.immediate(device.program(shaders.Colored), Primitive.QUADS) as quads,
        ):
            for x, y in window_to_clip(QUAD, SIZE):
                quads.vertex(position=(x, y, 0.5, 1.0), color=(1, 1, 1, 1))
        assert_mask(image.read(), covered(QUAD[:3], [QUAD[0], QUAD[2], QUAD[3]]))


@pytest.mark.parametrize("primitive", list(Primitive), ids=lambda p: p.name)
def test_immediate_vertices_draw_the_same_image_as_a_mesh(device: Device, primitive: Primitive) -> None:
    rows = corners(centers([(1, 1), (3, 13), (14, 12), (12, 2), (5, 5), (6, 9), (10, 8), (9, 4)], SIZE))
    program = device.program(shaders.Colored)
    with (
        device.texture(SIZE, Format.R8) as drawn_at_once,
        device.texture(SIZE, Format.R8) as drawn_by_mesh,
        device.mesh(rows, primitive=primitive) as mesh,
        device.states(CullMode.NONE),
    ):
        with device.render_pass(drawn_at_once), device.immediate(program, primitive) as immediate:
            immediate.vertices(rows[:3])
            for row in rows[3:5]:
                immediate.vertex(position=row["position"], color=row["color"])
            immediate.vertices(rows[5:])
        with device.render_pass(drawn_by_mesh):
            device.draw(program, mesh)
        assert drawn_by_mesh.read().any()
        assert_same(drawn_at_once.read(), drawn_by_mesh.read())


def test_an_immediate_block_without_vertices_draws_nothing(device: Device) -> None:
    with device.texture(SIZE, Format.R8) as image:
        before = device.statistics.draws
        with (
            device.render_pass(image),
            device.immediate(device.program(shaders.Colored), Primitive.TRIANGLES),
        ):
            pass
        assert device.statistics.draws == before
        assert_same(image.read(), 0)


def test_an_immediate_block_is_one_draw(device: Device) -> None:
    with device.texture(SIZE, Format.R8) as image:
        before = device.statistics.draws
        with (
            device.render_pass(image),
            device.immediate(device.program(shaders.Colored), Primitive.TRIANGLES) as triangles,
        ):
            for _ in range(10):
                triangles.vertices(rectangle())
        assert device.statistics.draws - before == 1


def test_an_exception_in_an_immediate_block_draws_nothing(device: Device) -> None:
    with device.texture(SIZE, Format.R8) as image:
        with pytest.raises(ZeroDivisionError), device.render_pass(image):
            with device.immediate(device.program(shaders.Colored), Primitive.TRIANGLES) as triangles:
                triangles.vertices(rectangle())
                raise ZeroDivisionError
        assert_same(image.read(), 0)


def test_an_immediate_block_takes_bindings_and_states(device: Device) -> None:
    tint = device.uniform(shaders.Tint(color=(0.25, 0, 0, 0)))
    with device.texture(SIZE, Format.R16F) as image:
        with device.render_pass(image, clear=(1, 0, 0, 0)), device.states(BlendFunction.ADDITIVE):
            with device.immediate(
                device.program(shaders.Tinted), Primitive.TRIANGLES, tint=tint
            ) as triangles:
                triangles.vertices(rectangle())
        assert_same(image.read(), 1.25)
    tint.destroy()


def test_immediate_blocks_and_other_draws_keep_their_order(device: Device) -> None:
    program = device.program(shaders.Colored)
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
        with (
            device.render_pass(image),
            device.immediate(device.program(shaders.Colored), Primitive.POINTS) as many,
        ):
            many.vertices(points(20_000, size))
        device.present()
        assert_same(image.read().reshape(-1), np.arange(20_000))
