"""Rules of meshes, programs, bindings, draws and dispatches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rhi import (
    DRAW,
    Access,
    Comparison,
    CullMode,
    Device,
    Format,
    IndirectDraws,
    Primitive,
    SamplerDescriptor,
    TextureKind,
    rules,
)
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Bare, Colored, Corner, IntColored, UintColored
from rhi.conformance.shapes import Rows, corners, rectangle
from rhi.conformance.validation.refusal import refuses
from rhi.shading import (
    DepthTexture2D,
    Image2D,
    Shader,
    Storage,
    StorageRW,
    Struct,
    Texture2D,
    Uniform,
    atomic_add,
    image,
    ivec2,
    uint,
    vec2,
    vec4,
)

SIZE = (4, 4)


def loose(device: Device) -> Any:
    """The device without its types: for calls that a type checker refuses before they run."""
    return device


class Tint(Struct):
    """A color."""

    color: vec4


class Shift(Struct):
    """Another struct of the same size."""

    by: vec4


class Everything(Shader):
    """A binding of each kind."""

    tint: Uniform[Tint]
    weights: Storage[float]
    albedo: Texture2D
    shadow: DepthTexture2D
    target: Image2D = image(Format.RGBA8)

    def vertex(self, v: Corner) -> Bare:
        return Bare(clip=v.position)

    def fragment(self) -> vec4:
        self.target.store(ivec2(0, 0), vec4(self.weights[0]))
        lit = self.shadow.sample_compare(vec2(0.5, 0.5), 0.5)
        return self.tint.color * self.albedo.sample(vec2(0.5, 0.5)) * lit


class Kit:
    """A device with all that `Everything` binds."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.program = device.program(Everything)
        self.mesh = device.mesh(rectangle())
        self.image = device.texture(SIZE, Format.RGBA8)
        self.depth = device.texture(SIZE, Format.D32F)
        self.bindings: dict[str, Any] = {
            "tint": device.uniform(Tint(color=(1, 1, 1, 1))),
            "weights": device.storage(float, 4),
            "albedo": device.texture(SIZE, Format.RGBA8),
            "shadow": self.depth.sampled(SamplerDescriptor(compare=Comparison.LESS)),
            "target": device.texture(SIZE, Format.RGBA8).image(),
        }

    def draw(self, **changes: Any) -> None:
        """Draw in a pass with some bindings changed; None leaves one out."""
        bindings = {name: value for name, value in (self.bindings | changes).items() if value is not None}
        self.device.draw(self.program, self.mesh, **bindings)


@pytest.fixture
def kit(recording: Device) -> Any:
    kit = Kit(recording)
    yield kit
    for thing in (
        kit.mesh,
        kit.image,
        kit.depth,
        *(kit.bindings[name] for name in ("tint", "weights", "albedo")),
    ):
        thing.destroy()


# -- bindings ----------------------------------------------------------------------------------------------


def test_the_control_draws(kit: Kit) -> None:
    with kit.device.render_pass(kit.image):
        kit.draw()


@pytest.mark.parametrize("name", ["tint", "weights", "albedo", "shadow", "target"])
def test_a_binding_must_be_given(kit: Kit, name: str) -> None:
    with kit.device.render_pass(kit.image):
        with refuses(rules.BINDING_MISSING, kit.device) as refusal:
            kit.draw(**{name: None})
        assert name in str(refusal.error)
        kit.draw()
        with refuses(rules.BINDING_MISSING, kit.device):  # also when everything is bound already
            kit.draw(**{name: None})


def test_a_binding_must_be_known(kit: Kit) -> None:
    with kit.device.render_pass(kit.image):
        with refuses(rules.BINDING_UNKNOWN, kit.device) as refusal:
            kit.draw(tints=kit.bindings["tint"])
        assert "tints" in str(refusal.error)
        kit.draw()


@pytest.mark.parametrize("name", ["tint", "weights", "albedo", "shadow", "target"])
def test_a_binding_must_be_of_its_kind(kit: Kit, name: str) -> None:
    with kit.device.render_pass(kit.image):
        for other in ("tint", "weights", "albedo", "target"):
            if other != name:
                with refuses(rules.BINDING_TYPE, kit.device) as refusal:
                    kit.draw(**{name: kit.bindings[other]})
                assert name in str(refusal.error)
        for wrong in (3, "text", (1, 2, 3), kit.mesh):
            with refuses(rules.BINDING_TYPE, kit.device):
                kit.draw(**{name: wrong})
        kit.draw()


def test_a_uniform_must_be_of_the_shader_s_struct(kit: Kit) -> None:
    with kit.device.uniform(Shift(by=(0, 0, 0, 0))) as shift, kit.device.render_pass(kit.image):
        with refuses(rules.BINDING_TYPE, kit.device):
            kit.draw(tint=shift)
        kit.draw()


def test_storage_must_be_of_the_shader_s_element(kit: Kit) -> None:
    with kit.device.storage(uint, 4) as numbers, kit.device.render_pass(kit.image):
        with refuses(rules.BINDING_TYPE, kit.device):
            kit.draw(weights=numbers)
        kit.draw()


def test_a_texture_must_have_the_shader_s_kind_and_type(kit: Kit) -> None:
    device = kit.device
    wrong = [
        device.texture(SIZE, Format.RGBA8, kind=TextureKind.D2_ARRAY, layers=1),
        device.texture(SIZE, Format.RGBA8, kind=TextureKind.CUBE),
        device.texture(SIZE, Format.RGBA8UI),
        device.texture(SIZE, Format.R32I),
        device.texture(SIZE, Format.RGBA8, samples=2),
    ]
    with device.render_pass(kit.image):
        for texture in wrong:
            with refuses(rules.BINDING_TYPE, device):
                kit.draw(albedo=texture)
        kit.draw(albedo=kit.depth)
    for texture in wrong:
        texture.destroy()


def test_a_comparison_needs_a_comparing_sampler_and_depth(kit: Kit) -> None:
    with kit.device.render_pass(kit.image):
        with refuses(rules.BINDING_TYPE, kit.device):
            kit.draw(shadow=kit.depth)
        with refuses(rules.BINDING_TYPE, kit.device):
            kit.draw(shadow=kit.bindings["albedo"].sampled(SamplerDescriptor(compare=Comparison.LESS)))
        with refuses(rules.BINDING_TYPE, kit.device):
            kit.draw(albedo=kit.depth.sampled(SamplerDescriptor(compare=Comparison.LESS)))
        kit.draw()


def test_an_image_must_have_the_shader_s_format_and_kind(kit: Kit) -> None:
    device = kit.device
    other = device.texture(SIZE, Format.RGBA8_SNORM)
    array = device.texture(SIZE, Format.RGBA8, kind=TextureKind.D2_ARRAY, layers=2)
    with device.render_pass(kit.image):
        with refuses(rules.BINDING_TYPE, device):
            kit.draw(target=other.image())
        with refuses(rules.BINDING_TYPE, device):
            kit.draw(target=array.image())
        kit.draw(target=array.image(0, 1))
    other.destroy()
    array.destroy()


@pytest.mark.parametrize("name", ["tint", "weights", "albedo"])
def test_a_destroyed_resource_is_not_bound(kit: Kit, name: str) -> None:
    with kit.device.render_pass(kit.image):
        kit.draw()
        kit.bindings[name].destroy()
        with refuses(rules.RESOURCE_DESTROYED, kit.device):
            kit.draw()


@pytest.mark.parametrize("name", ["weights", "albedo"])
def test_a_locked_resource_is_not_bound(kit: Kit, name: str) -> None:
    with kit.device.render_pass(kit.image):
        kit.draw()
        with kit.bindings[name].lock(Access.WRITE), refuses(rules.LOCK_OPEN, kit.device):
            kit.draw()
        kit.draw()


@pytest.mark.parametrize("name", ["tint", "weights", "albedo", "shadow", "target"])
def test_a_resource_of_another_device_is_not_bound(kit: Kit, device: Device, name: str) -> None:
    other = Kit(device)
    with kit.device.render_pass(kit.image):
        kit.draw()
        with refuses(rules.RESOURCE_FOREIGN, kit.device):
            kit.draw(**{name: other.bindings[name]})
        kit.draw()


def test_a_uniform_in_a_buffer_must_be_aligned_and_large_enough(kit: Kit) -> None:
    from rhi.shading import UniformRange

    buffer = kit.device.buffer(1024)
    alignment = kit.device.capabilities.uniform_alignment
    with kit.device.render_pass(kit.image):
        for offset, size in ((0, 8), (alignment // 2, 16)):
            with refuses(rules.BINDING_SIZE, kit.device):
                kit.draw(tint=UniformRange(buffer.id, offset, size, Tint, buffer))
        kit.draw(tint=UniformRange(buffer.id, alignment, 16, Tint, buffer))
    buffer.destroy()


def test_a_refused_draw_leaves_the_bindings_of_the_one_before(kit: Kit) -> None:
    with kit.device.render_pass(kit.image):
        kit.draw()
        with refuses(rules.BINDING_TYPE, kit.device):
            kit.draw(tint=kit.bindings["tint"], albedo=3)
        since = len(kit.device.stream)
        kit.draw()
        assert [command.op.name for command in kit.device.stream[since:]][-1] == "DRAW"


class BadName(Shader):
    """A binding called like an argument of draw."""

    mesh: Uniform[Tint]

    def vertex(self, v: Corner) -> Bare:
        return Bare(clip=v.position * self.mesh.color)


def test_a_binding_cannot_be_called_like_an_argument(recording: Device) -> None:
    with refuses(rules.BINDING_NAME, recording):
        recording.program(BadName)


# -- meshes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "vertices",
    [
        np.zeros((4, 3), "f4"),
        np.zeros(4, "f4"),
        np.zeros(0, Corner.dtype),
        np.zeros((2, 2), Corner.dtype),
        {},
    ],
    ids=["plain", "flat", "empty", "2d", "no arrays"],
)
def test_vertices_are_named_and_in_a_row(recording: Device, vertices: Any) -> None:
    with refuses(rules.MESH_DATA, recording):
        recording.mesh(vertices)


def test_arrays_of_a_mesh_have_one_length(recording: Device) -> None:
    with refuses(rules.MESH_DATA, recording):
        recording.mesh({"position": np.zeros((4, 4)), "color": np.zeros((3, 4))})
    recording.mesh({"position": np.zeros((4, 4)), "color": np.zeros((4, 4))}).destroy()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_vertices_are_finite(recording: Device, value: float) -> None:
    rows = rectangle()
    rows["position"][3, 1] = value
    with refuses(rules.MESH_DATA, recording) as refusal:
        recording.mesh(rows)
    assert "position[3]" in str(refusal.error)
    recording.mesh(rectangle()).destroy()


@pytest.mark.parametrize("count", [0, -1])
def test_a_mesh_without_attributes_has_vertices(recording: Device, count: int) -> None:
    with refuses(rules.MESH_DATA, recording):
        recording.mesh(count)
    recording.mesh(1).destroy()


def test_a_buffer_of_vertices_has_fields(recording: Device) -> None:
    with recording.buffer(np.zeros(12, "f4")) as buffer, refuses(rules.MESH_DATA, recording):
        recording.mesh(buffer)


@pytest.mark.parametrize(
    "indices",
    [
        np.array([0, 1, 6]),
        np.array([0, 1, -1]),
        np.array([0.0, 1.0, 2.0]),
        np.zeros(0, "u2"),
        np.array([0, 1, 6], "u2"),
    ],
    ids=["beyond", "negative", "float", "empty", "beyond uint16"],
)
def test_indices_point_to_vertices(recording: Device, indices: Any) -> None:
    with refuses(rules.MESH_INDEX, recording):
        recording.mesh(rectangle(), indices)
    recording.mesh(rectangle(), np.array([0, 1, 5])).destroy()
    recording.mesh(rectangle(), np.array([0, 0xFFFF, 5], "u2")).destroy()


def test_a_buffer_of_indices_has_16_or_32_bits(recording: Device) -> None:
    for dtype, fits in (("u1", False), ("i4", False), ("f4", False), ("u2", True), ("u4", True)):
        with recording.buffer(np.zeros(3, dtype)) as buffer:
            if fits:
                recording.mesh(rectangle(), buffer).destroy()
            else:
                with refuses(rules.MESH_INDEX, recording):
                    recording.mesh(rectangle(), buffer)


@pytest.mark.parametrize(("first", "count"), [(0, 7), (6, 1), (-1, 1), (0, -1), (7, 0)])
def test_a_view_lies_in_its_mesh(recording: Device, first: int, count: int) -> None:
    with recording.mesh(rectangle()) as mesh:
        with refuses(rules.MESH_RANGE, recording):
            mesh.view(first, count)
        mesh.view(0, 6)
        mesh.view(6, 0)


def test_a_base_vertex_needs_indices(recording: Device) -> None:
    with recording.mesh(rectangle()) as mesh, refuses(rules.MESH_RANGE, recording):
        mesh.view(base_vertex=1)
    with recording.mesh(rectangle(), np.array([0, 1, 2])) as mesh:
        mesh.view(base_vertex=1)
        with refuses(rules.MESH_RANGE, recording):
            mesh.view(base_instance=-1)


def wrong_meshes() -> dict[str, Rows]:
    missing = np.zeros(6, np.dtype([("position", "f4", 4)]))
    narrow = np.zeros(6, np.dtype([("position", "f4", 3), ("color", "f4", 4)]))
    integer = np.zeros(6, np.dtype([("position", "u4", 4), ("color", "f4", 4)]))
    double = np.zeros(6, np.dtype([("position", "f8", 4), ("color", "f4", 4)]))
    odd = np.zeros(6, np.dtype([("position", "f4", 5), ("color", "f4", 4)]))
    return {"missing": missing, "narrow": narrow, "integer": integer, "double": double, "odd": odd}


@pytest.mark.parametrize("name", ["missing", "narrow", "integer", "double", "odd"])
def test_a_mesh_feeds_the_vertex_stage(recording: Device, name: str) -> None:
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(wrong_meshes()[name]) as mesh:
        with recording.render_pass(image):
            with refuses(rules.MESH_ATTRIBUTE, recording) as refusal:
                recording.draw(recording.program(Colored), mesh)
    assert ("color" if name == "missing" else "position") in str(refusal.error)


def test_a_draw_needs_a_pass(recording: Device) -> None:
    program = recording.program(Colored)
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        with refuses(rules.DRAW_OUTSIDE_PASS, recording):
            recording.draw(program, mesh)
        with recording.render_pass(image):
            recording.draw(program, mesh)
        with refuses(rules.DRAW_OUTSIDE_PASS, recording):
            recording.draw(program, mesh)
        with refuses(rules.DRAW_OUTSIDE_PASS, recording):
            program.draw(mesh)
        with refuses(rules.DRAW_OUTSIDE_PASS, recording):
            recording.draw_many(program, mesh, mesh.draws())
        with recording.buffer(mesh.draws()) as arguments, refuses(rules.DRAW_OUTSIDE_PASS, recording):
            recording.draw_indirect(program, mesh, IndirectDraws(arguments, 1))


@pytest.mark.parametrize("instances", [-1, 1.5, "two", None])
def test_instances_are_counted(recording: Device, instances: Any) -> None:
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image):
            with refuses(rules.DRAW_COUNT, recording):
                recording.draw(recording.program(Colored), mesh, instances)
            recording.draw(recording.program(Colored), mesh, 0)


def test_a_draw_wants_a_program_and_a_mesh(recording: Device) -> None:
    program = recording.program(Colored)
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image):
            ways: list[Callable[[], None]] = [
                lambda: recording.draw(Colored, mesh),  # type: ignore[arg-type]
                lambda: recording.draw(program, rectangle()),  # type: ignore[arg-type]
                lambda: recording.draw(mesh, program),  # type: ignore[arg-type]
                lambda: recording.draw_many(program, None, mesh.draws()),  # type: ignore[arg-type]
                lambda: recording.dispatch(None, 1),  # type: ignore[arg-type]
            ]
            for wrong in ways:
                with refuses(rules.DEVICE_ARGUMENT, recording):
                    wrong()


def test_a_destroyed_mesh_is_not_drawn(recording: Device) -> None:
    program = recording.program(Colored)
    mesh, other = recording.mesh(rectangle()), recording.mesh(rectangle())
    view = mesh.view(0, 3)
    with recording.texture(SIZE, Format.R8) as image, recording.render_pass(image):
        for each in (mesh, view, other):
            recording.draw(program, each)
        mesh.destroy()
        recording.draw(program, other)
        for each in (mesh, view):
            with refuses(rules.RESOURCE_DESTROYED, recording):
                recording.draw(program, each)
    other.destroy()


@pytest.mark.parametrize("part", ["vertices", "indices", "instances"])
def test_a_mesh_with_a_destroyed_buffer_is_not_drawn(recording: Device, part: str) -> None:
    program = recording.program(Colored)
    split = {name: np.ascontiguousarray(rectangle()[[name]]) for name in ("position", "color")}
    buffers = {
        "vertices": recording.buffer(split["position"]),
        "indices": recording.buffer(np.arange(6, dtype="u2")),
        "instances": recording.buffer(split["color"]),
    }
    mesh = recording.mesh(buffers["vertices"], buffers["indices"], instances=buffers["instances"])
    other = recording.mesh(rectangle())
    with recording.texture(SIZE, Format.R8) as image, recording.render_pass(image):
        recording.draw(program, mesh)
        buffers[part].destroy()
        recording.draw(program, other)
        with refuses(rules.RESOURCE_DESTROYED, recording):
            recording.draw(program, mesh)
    other.destroy()
    mesh.destroy()


def test_a_mesh_with_a_locked_buffer_is_not_drawn(recording: Device) -> None:
    program = recording.program(Colored)
    with recording.mesh(rectangle()) as mesh, recording.mesh(rectangle()) as other:
        with recording.texture(SIZE, Format.R8) as image, recording.render_pass(image):
            recording.draw(program, mesh)
            assert mesh.vertices is not None
            with mesh.vertices.lock(Access.WRITE) as rows:
                rows[:] = rectangle()
                recording.draw(program, other)
                with refuses(rules.LOCK_OPEN, recording):
                    recording.draw(program, mesh)
            recording.draw(program, mesh)


def test_a_mesh_of_another_device_is_not_drawn(recording: Device, device: Device) -> None:
    program = recording.program(Colored)
    theirs = device.mesh(rectangle())
    with device.texture(SIZE, Format.R8) as image, device.render_pass(image):
        device.draw(device.program(Colored), theirs)
    with recording.mesh(rectangle()) as mesh, recording.texture(SIZE, Format.R8) as image:
        with recording.render_pass(image):
            recording.draw(program, mesh)
            with refuses(rules.RESOURCE_FOREIGN, recording):
                recording.draw(program, theirs)
    theirs.destroy()


@pytest.mark.parametrize("way", ["draw", "draw_many", "draw_indirect", "immediate"])
def test_programs_are_not_shared_between_devices(recording: Device, device: Device, way: str) -> None:
    """Also not where the other device has a pass open, and the draw could go there."""
    theirs = device.program(Colored)
    with (
        recording.texture(SIZE, Format.R8) as image,
        device.texture(SIZE, Format.R8) as other,
        recording.mesh(rectangle()) as mesh,
        recording.buffer(mesh.draws()) as buffer,
    ):
        draws = mesh.draws()

        def draw(program: Any) -> None:
            if way == "draw":
                recording.draw(program, mesh)
            elif way == "draw_many":
                recording.draw_many(program, mesh, draws)
            elif way == "draw_indirect":
                recording.draw_indirect(program, mesh, IndirectDraws(buffer, 1))
            else:
                with recording.immediate(program, Primitive.TRIANGLES) as triangles:
                    triangles.vertices(rectangle())

        with recording.render_pass(image), device.render_pass(other):
            before = device.statistics.draws
            with refuses(rules.RESOURCE_FOREIGN, recording):
                draw(theirs)
            assert device.statistics.draws == before
            draw(recording.program(Colored))


class Passing(Shader):
    """A program of its own, to be destroyed."""

    def vertex(self, v: Corner) -> Bare:
        return Bare(clip=v.position)

    def fragment(self) -> vec4:
        return vec4(1.0)


def test_a_destroyed_program_is_not_drawn_with(recording: Device) -> None:
    program = recording.program(Passing)
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image):
            recording.draw(program, mesh)
            program.destroy()
            with refuses(rules.RESOURCE_DESTROYED, recording):
                recording.draw(program, mesh)
            recording.draw(recording.program(Passing), mesh)


@pytest.mark.parametrize(
    ("format", "shader"),
    [
        (Format.RGBA8UI, Colored),
        (Format.RGBA8, UintColored),
        (Format.RGBA32I, UintColored),
        (Format.R32UI, IntColored),
    ],
)
def test_an_output_is_of_its_target_s_kind(recording: Device, format: Format, shader: Any) -> None:
    program = recording.program(shader)
    with recording.texture(SIZE, format) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image), refuses(rules.PROGRAM_OUTPUT, recording):
            recording.draw(program, mesh)


# -- many draws and indirect ones --------------------------------------------------------------------------


def test_many_draws_come_as_an_array_of_their_dtype(recording: Device) -> None:
    program = recording.program(Colored)
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image):
            for wrong in (np.zeros(3, DRAW), np.zeros((3, 5), "u4"), np.zeros((2, 2), mesh.draws().dtype)):
                with refuses(rules.DRAW_ARRAY, recording):
                    recording.draw_many(program, mesh, wrong)
            recording.draw_many(program, mesh, mesh.draws())


def test_many_draws_stay_in_the_mesh(recording: Device) -> None:
    program = recording.program(Colored)
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        draws = mesh.draws([0, 3], 3)
        with refuses(rules.MESH_RANGE, recording):
            mesh.draws([0, 4], 3)
        with recording.render_pass(image):
            draws["first"][1] = 4
            with refuses(rules.MESH_RANGE, recording):
                recording.draw_many(program, mesh, draws)
            draws["first"][1], draws["count"][1] = 0xFFFFFFFF, 2
            with refuses(rules.MESH_RANGE, recording):
                recording.draw_many(program, mesh, draws)


def test_many_draws_check_their_bindings(recording: Device) -> None:
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image):
            with refuses(rules.BINDING_UNKNOWN, recording):
                loose(recording).draw_many(recording.program(Colored), mesh, mesh.draws(), nothing=3)
            with refuses(rules.BINDING_MISSING, recording):
                loose(recording).draw_many(recording.program(Everything), mesh, mesh.draws())


def test_quads_are_not_drawn_many_at_once(recording: Device) -> None:
    quad = corners([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    program = recording.program(Colored)
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(quad, primitive=Primitive.QUADS) as mesh:
        with recording.render_pass(image), recording.buffer(mesh.draws()) as buffer:
            with refuses(rules.DEVICE_CAPABILITY, recording):
                recording.draw_many(program, mesh, mesh.draws())
            with refuses(rules.DEVICE_CAPABILITY, recording):
                recording.draw_indirect(program, mesh, IndirectDraws(buffer, 1))
            recording.draw(program, mesh)


@pytest.mark.parametrize(
    ("draws", "offset", "stride"),
    [
        (0, 0, 20),
        (3, 0, 20),
        (2, 4, 20),
        (1, -4, 20),
        (1, 24, 20),
        (2, 0, 24),
        (1, 2, 20),
        (1, 0, 16),
        (1, 0, 22),
    ],
)
def test_indirect_arguments_lie_in_their_buffer(
    recording: Device, draws: int, offset: int, stride: int
) -> None:
    program = recording.program(Colored)
    with (
        recording.texture(SIZE, Format.R8) as image,
        recording.mesh(rectangle()) as mesh,
        recording.buffer(np.zeros(10, "u4")) as buffer,
    ):
        with recording.render_pass(image):
            with refuses(rules.INDIRECT_RANGE, recording):
                recording.draw_indirect(program, mesh, IndirectDraws(buffer, draws, offset, stride))
            recording.draw_indirect(program, mesh, IndirectDraws(buffer, 2))
            recording.draw_indirect(program, mesh, IndirectDraws(buffer, 1, 20))


@pytest.mark.needs("indirect_count")
@pytest.mark.parametrize("offset", [-4, 2, 8])
def test_an_indirect_count_lies_in_its_buffer(recording: Device, offset: int) -> None:
    program = recording.program(Colored)
    with (
        recording.texture(SIZE, Format.R8) as image,
        recording.mesh(rectangle()) as mesh,
        recording.buffer(np.zeros(10, "u4")) as buffer,
        recording.buffer(np.zeros(2, "u4")) as count,
    ):
        with recording.render_pass(image):
            with refuses(rules.INDIRECT_RANGE, recording):
                recording.draw_indirect(
                    program, mesh, IndirectDraws(buffer, 2, count=count, count_offset=offset)
                )
            recording.draw_indirect(program, mesh, IndirectDraws(buffer, 2, count=count, count_offset=4))


def test_an_indirect_draw_refuses_dead_and_foreign_buffers(recording: Device, device: Device) -> None:
    program = recording.program(Colored)
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        dead, fine = recording.buffer(np.zeros(10, "u4")), recording.buffer(np.zeros(10, "u4"))
        dead.destroy()
        theirs = device.buffer(np.zeros(10, "u4"))
        with recording.render_pass(image):
            with refuses(rules.RESOURCE_DESTROYED, recording):
                recording.draw_indirect(program, mesh, IndirectDraws(dead, 1))
            with refuses(rules.RESOURCE_FOREIGN, recording):
                recording.draw_indirect(program, mesh, IndirectDraws(theirs, 1))
            if recording.capabilities.indirect_count:
                with refuses(rules.RESOURCE_DESTROYED, recording):
                    recording.draw_indirect(program, mesh, IndirectDraws(fine, 1, count=dead))
        fine.destroy()
        theirs.destroy()


# -- compute -----------------------------------------------------------------------------------------------


class Count(Shader):
    """Counts its invocations."""

    total: StorageRW[uint]

    def compute(self) -> None:
        atomic_add(self.total[0], uint(1))


@pytest.mark.needs("compute")
def test_a_dispatch_needs_a_compute_stage(recording: Device) -> None:
    with refuses(rules.PROGRAM_STAGE, recording):
        recording.dispatch(recording.program(Colored), 1)
    with recording.storage(uint, 1) as total:
        recording.dispatch(recording.program(Count), 1, total=total)


@pytest.mark.needs("compute")
def test_a_draw_needs_a_vertex_stage(recording: Device) -> None:
    with (
        recording.texture(SIZE, Format.R8) as image,
        recording.mesh(rectangle()) as mesh,
        recording.storage(uint, 1) as total,
    ):
        with recording.render_pass(image), refuses(rules.PROGRAM_STAGE, recording):
            recording.draw(recording.program(Count), mesh, total=total)


@pytest.mark.needs("compute")
def test_a_dispatch_lies_outside_of_passes(recording: Device) -> None:
    program = recording.program(Count)
    with recording.texture(SIZE, Format.R8) as image, recording.storage(uint, 1) as total:
        with recording.buffer(np.ones(3, "u4")) as arguments, recording.render_pass(image):
            with refuses(rules.PASS_OPEN, recording):
                recording.dispatch(program, 1, total=total)
            with refuses(rules.PASS_OPEN, recording):
                recording.dispatch_indirect(program, arguments, 0, total=total)
            with refuses(rules.PASS_OPEN, recording):
                recording.present()
        assert_same(total.read(), 0)


@pytest.mark.needs("compute")
@pytest.mark.parametrize("groups", [-1, (1, -1), (1, 1, 1, 1), (), (0, 0, -1)], ids=str)
def test_groups_are_one_to_three_numbers(recording: Device, groups: Any) -> None:
    with recording.storage(uint, 1) as total:
        with refuses(rules.DISPATCH_SIZE, recording):
            recording.dispatch(recording.program(Count), groups, total=total)
        recording.dispatch(recording.program(Count), (1, 1, 1), total=total)


@pytest.mark.needs("compute")
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_groups_are_no_more_than_the_device_says(recording: Device, axis: int) -> None:
    groups = [1, 1, 1]
    groups[axis] = recording.capabilities.max_dispatch[axis] + 1
    with recording.storage(uint, 1) as total, refuses(rules.DISPATCH_SIZE, recording):
        recording.dispatch(recording.program(Count), groups, total=total)


@pytest.mark.needs("compute")
@pytest.mark.parametrize("offset", [-4, 2, 8])
def test_indirect_groups_lie_in_their_buffer(recording: Device, offset: int) -> None:
    with recording.storage(uint, 1) as total, recording.buffer(np.ones(4, "u4")) as arguments:
        with refuses(rules.INDIRECT_RANGE, recording):
            recording.dispatch_indirect(recording.program(Count), arguments, offset, total=total)
        recording.dispatch_indirect(recording.program(Count), arguments, 4, total=total)


@pytest.mark.needs("compute")
def test_a_dispatch_checks_its_bindings(recording: Device, device: Device) -> None:
    program = recording.program(Count)
    with (
        recording.storage(uint, 1) as total,
        recording.storage(float, 1) as wrong,
        device.storage(uint, 1) as theirs,
    ):
        with refuses(rules.BINDING_MISSING, recording):
            loose(recording).dispatch(program, 1)
        with refuses(rules.BINDING_UNKNOWN, recording):
            loose(recording).dispatch(program, 1, totals=total)
        with refuses(rules.BINDING_TYPE, recording):
            loose(recording).dispatch(program, 1, total=wrong)
        with refuses(rules.RESOURCE_FOREIGN, recording):
            recording.dispatch(program, 1, total=theirs)
        foreign = device.program(Count)
        with refuses(rules.RESOURCE_FOREIGN, recording):
            recording.dispatch(foreign, 1, total=total)
        with total.lock(Access.READ), refuses(rules.LOCK_OPEN, recording):
            recording.dispatch(program, 1, total=total)
        recording.dispatch(program, 1, total=total)


@pytest.mark.parametrize(
    ("annotation", "limit"),
    [
        (Uniform[Tint], "max_uniform_slots"),
        (Storage[float], "max_storage_slots"),
        (Texture2D, "max_texture_slots"),
    ],
    ids=["uniform", "storage", "texture"],
)
def test_bindings_are_no_more_than_the_device_says(recording: Device, annotation: Any, limit: str) -> None:
    def shader(count: int) -> Any:
        return type(
            f"With{count}", (Passing,), {"__annotations__": {f"b{i}": annotation for i in range(count)}}
        )

    most = getattr(recording.capabilities, limit)
    with refuses(rules.DEVICE_CAPABILITY, recording):
        recording.program(shader(most + 1))
    recording.program(shader(most)).destroy()


# -- immediate mode ----------------------------------------------------------------------------------------


def test_an_immediate_vertex_has_all_attributes(recording: Device) -> None:
    with recording.texture(SIZE, Format.R8) as image, recording.render_pass(image):
        with recording.immediate(recording.program(Colored), Primitive.TRIANGLES) as block:
            with refuses(rules.IMMEDIATE_VERTEX, recording):
                block.vertex(position=(0, 0, 0, 1))
            with refuses(rules.IMMEDIATE_VERTEX, recording):
                block.vertex(position=(0, 0, 0, 1), colour=(0, 0, 0, 1))
            with refuses(rules.IMMEDIATE_VERTEX, recording):
                block.vertex(position=(0, 0, 0, 1), color=(0, 0, 0, 1), uv=(0, 0))
            with refuses(rules.IMMEDIATE_VERTEX, recording):
                block.vertices(np.zeros(3, np.dtype([("position", "f4", 3), ("color", "f4", 4)])))
            block.vertices(rectangle())


@pytest.mark.parametrize("position", [(0, 0, 0), (0, 0, 0, 0, 0), "text"], ids=str)
def test_an_immediate_vertex_of_a_wrong_shape_is_refused(recording: Device, position: Any) -> None:
    with recording.texture(SIZE, Format.R8) as image, recording.render_pass(image):
        with refuses(rules.IMMEDIATE_VERTEX, recording):
            with recording.immediate(recording.program(Colored), Primitive.TRIANGLES) as block:
                block.vertex(position=position, color=(0, 0, 0, 1))


def test_an_immediate_block_ends(recording: Device) -> None:
    block = recording.immediate(recording.program(Colored), Primitive.TRIANGLES)
    ways: list[Callable[[], None]] = [
        lambda: block.vertex(position=(0, 0, 0, 1), color=(0, 0, 0, 1)),
        lambda: block.vertices(rectangle()),
    ]
    for add in ways:
        with refuses(rules.IMMEDIATE_VERTEX, recording):
            add()
    with recording.texture(SIZE, Format.R8) as image, recording.render_pass(image), block:
        block.vertices(rectangle())
    with refuses(rules.IMMEDIATE_VERTEX, recording):
        block.vertices(rectangle())


def test_an_immediate_block_draws_inside_a_pass(recording: Device) -> None:
    with refuses(rules.DRAW_OUTSIDE_PASS, recording):
        with recording.immediate(recording.program(Colored), Primitive.TRIANGLES) as block:
            block.vertices(rectangle())


def test_an_immediate_block_knows_its_bindings_from_the_start(recording: Device) -> None:
    with refuses(rules.BINDING_MISSING, recording):
        loose(recording).immediate(recording.program(Everything), Primitive.TRIANGLES)
    with refuses(rules.BINDING_UNKNOWN, recording):
        loose(recording).immediate(recording.program(Colored), Primitive.TRIANGLES, tint=3)


def test_states_are_not_bindings(recording: Device) -> None:
    """A mistake that reads well: states go into a scope."""
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image), refuses(rules.BINDING_UNKNOWN, recording):
            loose(recording).draw(recording.program(Colored), mesh, cull=CullMode.NONE)
