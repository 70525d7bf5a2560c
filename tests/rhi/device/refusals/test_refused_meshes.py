"""Rules of meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rhi import Device, Mesh
from rhi.conformance.shaders import Colored, Corner
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import refuses
from rhi.errors import rules

SIZE = (4, 4)


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


PACKED = np.dtype([("tag", "u1"), ("position", "f4", 3), ("tint", "u1", 3)])  # floats between words
HALVES = np.dtype([("position", "f2", 2)])
DOUBLES = np.dtype([("weight", "f8"), ("position", "f4", 3), ("tint", "u1", 4)])


@pytest.mark.parametrize(
    "layout", [PACKED, HALVES, DOUBLES, Corner.dtype], ids=["packed", "half", "double", "plain"]
)
@pytest.mark.parametrize(("step", "others"), [(1, 0), (1, 0xFF), (2, 0)])
def test_vertices_are_finite_in_any_layout(
    recording: Device, layout: np.dtype[Any], step: int, others: int
) -> None:
    rows = np.zeros(60_000, layout)
    rows.view("u1")[:] = others  # what isn't a float may look like NaN, and isn't
    floats = [name for name in layout.names or () if layout[name].base.kind == "f"]
    for name in floats:
        rows[name] = 1.5
    recording.mesh(rows[::step]).destroy()
    for name in floats:
        for row, value in ((0, np.nan), (-step, -np.inf)):  # in the first of the blocks, in the last
            rows[name][row] = value
            with refuses(rules.MESH_DATA, recording) as refusal:
                recording.mesh(rows[::step])
            assert f"{name}[{len(rows[::step]) - 1 if row else 0}]" in refusal.error.given
            rows[name][row] = 1.5


@pytest.mark.parametrize("count", [0, -1])
def test_a_mesh_without_attributes_has_vertices(recording: Device, count: int) -> None:
    with refuses(rules.MESH_DATA, recording):
        recording.mesh(count)
    recording.mesh(1).destroy()


def test_a_buffer_of_vertices_was_not_destroyed(recording: Device) -> None:
    buffer = recording.buffer(rectangle())
    recording.mesh(buffer).destroy()
    buffer.destroy()
    with refuses(rules.RESOURCE_DESTROYED, recording):
        recording.mesh(buffer)


def test_a_buffer_of_vertices_has_fields(recording: Device) -> None:
    with recording.buffer(np.zeros(12, "f4")) as buffer, refuses(rules.MESH_DATA, recording):
        recording.mesh(buffer)


OUTSIDE = pytest.mark.parametrize(
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


@OUTSIDE
def test_indices_point_to_vertices(recording: Device, indices: Any) -> None:
    with refuses(rules.MESH_INDEX, recording):
        recording.mesh(rectangle(), indices)
    recording.mesh(rectangle(), np.array([0, 1, 5])).destroy()
    recording.mesh(rectangle(), np.array([0, 0xFFFF, 5], "u2")).destroy()


@OUTSIDE
def test_transient_indices_point_to_vertices(recording: Device, indices: Any) -> None:
    program, memory = recording.program(Colored), recording.transient
    with refuses(rules.MESH_INDEX, recording):
        memory.mesh(program, rectangle(), indices)
    memory.mesh(program, rectangle(), np.array([0, 1, 5]))


def test_a_buffer_of_indices_has_16_or_32_bits(recording: Device) -> None:
    for dtype, fits in (("u1", False), ("i4", False), ("f4", False), ("u2", True), ("u4", True)):
        with recording.buffer(np.zeros(3, dtype)) as buffer:
            if fits:
                recording.mesh(rectangle(), buffer).destroy()
            else:
                with refuses(rules.MESH_INDEX, recording):
                    recording.mesh(rectangle(), buffer)


@pytest.mark.parametrize(("first", "count"), [(0, 7), (6, 1), (-1, 1), (0, -1), (7, 0)])
def test_a_view_lies_in_its_mesh(recording: Device, first: int, count: int, mesh: Mesh) -> None:
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
