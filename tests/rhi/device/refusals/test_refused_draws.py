"""Rules of draws: one, many, indirect, immediate."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refused_shaders import Everything, Passing

from rhi import (
    DRAW,
    Access,
    CullMode,
    Device,
    Format,
    IndirectDraws,
    Mesh,
    Primitive,
    Texture,
    ValidationError,
)
from rhi.conformance.shaders import Colored, IntColored, UintColored
from rhi.conformance.shapes import VertexRows, corners, rectangle
from rhi.conformance.validation.refusal import loose, refuses
from rhi.errors import rules

SIZE = (4, 4)


def wrong_meshes() -> dict[str, VertexRows]:
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
    assert "position" in str(refusal.error)  # what is missing is named beside what is there
    assert name != "missing" or "color" in str(refusal.error)


def test_a_draw_needs_a_pass(recording: Device, image: Texture, mesh: Mesh) -> None:
    program = recording.program(Colored)
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


@pytest.mark.parametrize("name", ["missing", "narrow"])
def test_a_refused_draw_shows_the_user_s_frames(recording: Device, name: str) -> None:
    """Beside them two frames, and no Python error that led to the refusal."""
    program, wrong = recording.program(Colored), wrong_meshes()[name]
    with (
        recording.texture(SIZE, Format.R8) as image,
        recording.mesh(wrong) as mesh,
        recording.render_pass(image),
    ):
        draws: list[Callable[[], None]] = [
            lambda: recording.draw(program, mesh),
            lambda: program.draw(mesh),
            lambda: loose(recording).draw(program, None),
            lambda: loose(recording).draw(program, mesh, tint=1),
        ]
        for draw in draws:
            with pytest.raises(ValidationError) as caught:
                draw()
            text = "".join(traceback.format_exception(caught.value))
            assert "During handling" not in text
            frames = [
                frame
                for frame in traceback.extract_tb(caught.value.__traceback__)
                if frame.filename != __file__
            ]
            assert len(frames) <= 2


@pytest.mark.parametrize("instances", [-1, 1 << 31, 1.5, 1.0, True, "two", None])
def test_instances_are_counted(recording: Device, instances: Any, image: Texture, mesh: Mesh) -> None:
    with recording.render_pass(image):
        with refuses(rules.DRAW_COUNT, recording):
            recording.draw(recording.program(Colored), mesh, instances)
        recording.draw(recording.program(Colored), mesh, 0)


def test_a_draw_wants_a_program_and_a_mesh(recording: Device, image: Texture, mesh: Mesh) -> None:
    program = recording.program(Colored)
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
        for drawable in (mesh, view, other):
            recording.draw(program, drawable)
        mesh.destroy()
        recording.draw(program, other)
        for drawable in (mesh, view):
            with refuses(rules.RESOURCE_DESTROYED, recording):
                recording.draw(program, drawable)
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
def test_programs_are_not_shared_between_devices(
    recording: Device, device: Device, way: str, image: Texture, mesh: Mesh
) -> None:
    """Also not where the other device has a pass open, and the draw could go there."""
    theirs = device.program(Colored)
    with device.texture(SIZE, Format.R8) as other, recording.buffer(mesh.draws()) as buffer:
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


def test_a_destroyed_program_is_not_drawn_with(recording: Device, image: Texture, mesh: Mesh) -> None:
    program = recording.program(Passing)
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


def test_many_draws_come_as_an_array_of_their_dtype(recording: Device, image: Texture, mesh: Mesh) -> None:
    program = recording.program(Colored)
    with recording.render_pass(image):
        for wrong in (np.zeros(3, DRAW), np.zeros((3, 5), "u4"), np.zeros((2, 2), mesh.draws().dtype)):
            with refuses(rules.DRAW_ARRAY, recording):
                recording.draw_many(program, mesh, wrong)
        recording.draw_many(program, mesh, mesh.draws())


WRONG_CLIPS = {
    "too few": [(0, 0, 1, 1)],
    "three numbers": np.zeros((2, 3), int),
    "fractions": np.zeros((2, 4)),
    "a negative width": [(0, 0, 1, 1), (0, 0, -1, 1)],
    "a negative height": [(0, 0, 1, 1), (0, 0, 1, -1)],
    "too far": [(0, 0, 1, 1), ((1 << 30) + 1, 0, 1, 1)],
    "unequal rows": [(0, 0, 1, 1), (0, 0)],
}


@pytest.mark.parametrize("name", WRONG_CLIPS)
def test_clips_are_a_rectangle_for_each_draw(
    recording: Device, name: str, image: Texture, mesh: Mesh
) -> None:
    program = recording.program(Colored)
    with recording.render_pass(image):
        with refuses(rules.DEVICE_ARGUMENT, recording):
            loose(recording).draw_clipped(program, mesh, mesh.draws([0, 3], 3), WRONG_CLIPS[name])
        recording.draw_clipped(
            program, mesh, mesh.draws([0, 3], 3), [(0, 0, 0, 0), (-(1 << 30), 0, 1 << 30, 1)]
        )


def test_many_draws_stay_in_the_mesh(recording: Device, image: Texture, mesh: Mesh) -> None:
    program = recording.program(Colored)
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


def test_many_draws_check_their_bindings(recording: Device, image: Texture, mesh: Mesh) -> None:
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
    recording: Device, draws: int, offset: int, stride: int, image: Texture, mesh: Mesh
) -> None:
    program = recording.program(Colored)
    with recording.buffer(np.zeros(10, "u4")) as buffer:
        with recording.render_pass(image):
            with refuses(rules.INDIRECT_RANGE, recording):
                recording.draw_indirect(program, mesh, IndirectDraws(buffer, draws, offset, stride))
            recording.draw_indirect(program, mesh, IndirectDraws(buffer, 2))
            recording.draw_indirect(program, mesh, IndirectDraws(buffer, 1, 20))


@pytest.mark.parametrize("offset", [-4, 2, 8])
def test_an_indirect_count_lies_in_its_buffer(
    recording: Device, offset: int, image: Texture, mesh: Mesh
) -> None:
    program = recording.program(Colored)
    with recording.buffer(np.zeros(10, "u4")) as buffer, recording.buffer(np.zeros(2, "u4")) as count:
        with recording.render_pass(image):
            with refuses(rules.INDIRECT_RANGE, recording):
                recording.draw_indirect(
                    program, mesh, IndirectDraws(buffer, 2, count=count, count_offset=offset)
                )
            recording.draw_indirect(program, mesh, IndirectDraws(buffer, 2, count=count, count_offset=4))


def test_an_indirect_draw_refuses_dead_and_foreign_buffers(
    recording: Device, device: Device, image: Texture, mesh: Mesh
) -> None:
    program = recording.program(Colored)
    dead, fine = recording.buffer(np.zeros(10, "u4")), recording.buffer(np.zeros(10, "u4"))
    dead.destroy()
    theirs = device.buffer(np.zeros(10, "u4"))
    with recording.render_pass(image):
        with refuses(rules.RESOURCE_DESTROYED, recording):
            recording.draw_indirect(program, mesh, IndirectDraws(dead, 1))
        with refuses(rules.RESOURCE_FOREIGN, recording):
            recording.draw_indirect(program, mesh, IndirectDraws(theirs, 1))
        with refuses(rules.RESOURCE_DESTROYED, recording):
            recording.draw_indirect(program, mesh, IndirectDraws(fine, 1, count=dead))
    fine.destroy()
    theirs.destroy()


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


def test_states_are_not_bindings(recording: Device, image: Texture, mesh: Mesh) -> None:
    """A mistake that reads well: states go into a scope."""
    with recording.render_pass(image), refuses(rules.BINDING_UNKNOWN, recording):
        loose(recording).draw(recording.program(Colored), mesh, cull=CullMode.NONE)
