"""Primitive assembly: topologies as lists, ranges of vertices, the host's copies of index buffers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rhi.backends.cl.raster import assembly
from rhi.backends.cl.raster.assembly import Assembler, Assembly
from rhi.contract.descriptors import Primitive
from rhi.contract.formats import IndexFormat
from rhi.contract.topology import list_primitives

Lists = NDArray[np.uint32]


class Host:
    """Buffers on the host, and an assembler whose reads and uploads are counted."""

    def __init__(self) -> None:
        self.data: dict[int, bytearray] = {}
        self.reads = 0
        self.uploads = 0
        self.assembler: Assembler[Lists] = Assembler(self._read, self._upload)

    def buffer(self, number: int, indices: NDArray[Any]) -> int:
        self.data[number] = bytearray(indices.tobytes())
        self.assembler.watch(number, indices.nbytes)
        return number

    def _read(self, buffer: int, offset: int, size: int) -> bytes:
        self.reads += 1
        return bytes(self.data[buffer][offset : offset + size])

    def _upload(self, listed: Lists) -> Lists:
        self.uploads += 1
        return listed

    def write(self, buffer: int, offset: int, data: bytes) -> None:
        self.data[buffer][offset : offset + len(data)] = data
        self.assembler.write(buffer, offset, data)

    def vertices(
        self, assembly: Assembly[Lists], buffer: int = 0, format: IndexFormat = IndexFormat.UINT32
    ) -> list[int]:
        """Return the vertices that a kernel would read."""
        positions = assembly.start + np.arange(assembly.count)
        if assembly.indexed:
            vertices = (
                np.frombuffer(self.data[buffer], format.dtype) if assembly.memory is None else assembly.memory
            )
            positions = vertices[positions].astype(np.int64)
        return (positions + assembly.base).tolist()


def listed(primitive: Primitive, indices: list[int], restart: int) -> list[tuple[int, ...]]:
    """Assemble by OpenGL's definitions, one primitive after the other."""
    runs: list[list[int]] = [[]]
    for index in indices:
        if index == restart:
            runs.append([])
        else:
            runs[-1].append(index)
    result: list[tuple[int, ...]] = []
    for run in runs:
        n = len(run)
        if primitive is Primitive.POINTS:
            result += [(v,) for v in run]
        elif primitive is Primitive.LINES:
            result += [(run[i], run[i + 1]) for i in range(0, n - 1, 2)]
        elif primitive is Primitive.LINE_STRIP:
            result += [(run[i], run[i + 1]) for i in range(n - 1)]
        elif primitive is Primitive.TRIANGLES:
            result += [(run[i], run[i + 1], run[i + 2]) for i in range(0, n - 2, 3)]
        elif primitive is Primitive.TRIANGLE_STRIP:
            result += [
                (run[i], run[i + 2], run[i + 1]) if i % 2 else (run[i], run[i + 1], run[i + 2])
                for i in range(n - 2)
            ]
        elif primitive is Primitive.TRIANGLE_FAN:
            result += [(run[i], run[i + 1], run[0]) for i in range(1, n - 1)]
        else:
            for i in range(0, n - 3, 4):
                a, b, c, d = run[i : i + 4]
                result += [(a, b, c), (a, c, d)]
    return result


PRIMITIVES = st.sampled_from(Primitive)


@settings(max_examples=300)
@given(PRIMITIVES, st.lists(st.integers(0, 9), max_size=40))
def test_every_topology_becomes_the_list_that_its_definition_gives(
    primitive: Primitive, indices: list[int]
) -> None:
    expected = [corner for corners in listed(primitive, indices, 9) for corner in corners]
    assert list_primitives(primitive, np.array(indices, np.uint16), 9).tolist() == expected


@settings(max_examples=200)
@given(
    PRIMITIVES, st.sampled_from(IndexFormat), st.lists(st.integers(0, 40), min_size=1, max_size=60), st.data()
)
def test_indexed_draws_read_the_vertices_of_their_topology(
    primitive: Primitive, format: IndexFormat, numbers: list[int], data: st.DataObject
) -> None:
    restart = 256**format.size - 1
    indices = [restart if number == 40 else number for number in numbers]
    first = data.draw(st.integers(0, len(indices)))
    count = data.draw(st.integers(0, len(indices) - first + 2))  # beyond the end, too
    host = Host()
    buffer = host.buffer(7, np.array(indices, format.dtype))
    assembly = host.assembler.assemble(primitive, first, count, buffer, format)
    expected = [v for corners in listed(primitive, indices[first : first + count], restart) for v in corners]
    assert host.vertices(assembly, buffer, format) == expected
    assert assembly.count % assembly.corners == 0
    if expected:
        assert assembly.lowest is not None
        assert assembly.highest is not None
        assert assembly.lowest <= min(expected)
        assert max(expected) <= assembly.highest
        assert assembly.highest < 40, "a range without the restart index"


@settings(max_examples=100)
@given(PRIMITIVES, st.integers(0, 5000), st.integers(0, 3000))
def test_draws_without_indices_read_the_vertices_of_their_topology(
    primitive: Primitive, first: int, count: int
) -> None:
    host = Host()
    assembly = host.assembler.assemble(primitive, first, count)
    expected = [v for corners in listed(primitive, list(range(first, first + count)), -1) for v in corners]
    assert host.vertices(assembly) == expected
    if expected:
        assert assembly.lowest == min(expected) - assembly.base
        assert assembly.highest is not None
        assert assembly.highest + assembly.base >= max(expected)


@settings(max_examples=100)
@given(st.integers(0, 5000), st.integers(1, 5000))
def test_a_range_is_exact_wherever_it_begins_and_ends(first: int, count: int) -> None:
    indices = np.random.default_rng(0).integers(0, 1 << 30, 10_000).astype(np.uint32)
    host = Host()
    buffer = host.buffer(1, indices)
    assembly = host.assembler.assemble(Primitive.POINTS, first, count, buffer)
    used = indices[first : first + count]
    assert (assembly.lowest, assembly.highest) == (used.min(), used.max())


@settings(max_examples=100)
@given(st.data(), st.sampled_from([IndexFormat.UINT16, IndexFormat.UINT32]))
def test_a_range_is_exact_after_any_writes(data: st.DataObject, format: IndexFormat) -> None:
    numbers = np.random.default_rng(1)
    host = Host()
    buffer = host.buffer(1, numbers.integers(0, 1 << 15, 9000).astype(format.dtype))
    size = len(host.data[buffer])
    for offset in data.draw(st.lists(st.integers(0, size - 1), min_size=1, max_size=4)):
        host.assembler.assemble(Primitive.POINTS, 0, 8000, buffer, format)
        length = data.draw(st.integers(0, size - offset))
        written = numbers.integers(0, 1 << 14, length // 2 + 1).astype(np.uint16).tobytes()[:length]
        host.write(buffer, offset, written)
        first, count = data.draw(st.integers(0, 4000)), data.draw(st.integers(1, 5000))
        assembly = host.assembler.assemble(Primitive.POINTS, first, count, buffer, format)
        used = np.frombuffer(host.data[buffer], format.dtype)[first : first + count]
        assert (assembly.lowest, assembly.highest) == (used.min(), used.max())


# -- what is kept --------------------------------------------------------------------------------------------

STRIP = np.array([0, 1, 2, 3, 0xFFFF, 4, 5, 6], np.uint16)


def assemble_strip(host: Host, buffer: int) -> list[int]:
    assembly = host.assembler.assemble(Primitive.TRIANGLE_STRIP, 0, 8, buffer, IndexFormat.UINT16)
    return host.vertices(assembly, buffer)


def test_a_draw_is_assembled_once() -> None:
    host = Host()
    buffer = host.buffer(1, STRIP)
    before = host.assembler.assemble(Primitive.TRIANGLE_STRIP, 0, 8, buffer, IndexFormat.UINT16)
    assert host.assembler.assemble(Primitive.TRIANGLE_STRIP, 0, 8, buffer, IndexFormat.UINT16) is before
    assert host.assembler.assemble(Primitive.TRIANGLE_STRIP, 1, 7, buffer, IndexFormat.UINT16) is not before
    assert (host.reads, host.uploads) == (1, 2)


def test_one_list_serves_all_draws_of_a_topology_without_indices() -> None:
    host = Host()
    for first, count in ((0, 8), (100, 1024), (5, 3)):
        host.assembler.assemble(Primitive.QUADS, first, count)
    assert host.uploads == 1
    host.assembler.assemble(Primitive.QUADS, 0, 1025)
    assert host.uploads == 2


def test_cpu_writes_update_the_host_s_copy_of_an_index_buffer_without_a_read() -> None:
    host = Host()
    buffer = host.buffer(1, STRIP)
    assert max(assemble_strip(host, buffer)) == 6
    host.write(buffer, 6, np.array([9], np.uint16).tobytes())
    assert assemble_strip(host, buffer) == [0, 1, 2, 1, 9, 2, 4, 5, 6]
    assert host.reads == 1


def test_a_write_before_the_first_draw_is_seen() -> None:
    host = Host()
    buffer = host.buffer(1, STRIP)
    host.write(buffer, 6, np.array([9], np.uint16).tobytes())
    assert assemble_strip(host, buffer) == [0, 1, 2, 1, 9, 2, 4, 5, 6]


def test_lists_that_a_shader_wrote_are_not_read_back() -> None:
    host = Host()
    buffer = host.buffer(1, np.arange(9, dtype=np.uint32))
    assert host.assembler.assemble(Primitive.TRIANGLES, 0, 9, buffer).highest == 8
    host.assembler.change(buffer, shader_wrote=True)
    assembly = host.assembler.assemble(Primitive.TRIANGLES, 2, 7, buffer)
    assert assembly == Assembly(3, 6, 2, indexed=True)
    assert host.reads == 1


def test_lists_that_a_copy_wrote_are_read_back_because_of_restarts() -> None:
    host = Host()
    buffer = host.buffer(1, np.arange(9, dtype=np.uint32))
    assert host.assembler.assemble(Primitive.TRIANGLES, 0, 9, buffer).highest == 8
    host.data[buffer][4:8] = b"\xff" * 4
    host.assembler.change(buffer)
    assembly = host.assembler.assemble(Primitive.TRIANGLES, 0, 9, buffer)
    assert (assembly.count, assembly.lowest, assembly.highest) == (6, 2, 7)
    assert host.reads == 2


def test_strips_that_the_device_wrote_are_read_back_after_each_change() -> None:
    host = Host()
    buffer = host.buffer(1, STRIP)
    for value in (7, 8):
        host.data[buffer][6] = value
        host.assembler.change(buffer)
        assert assemble_strip(host, buffer) == [0, 1, 2, 1, value, 2, 4, 5, 6]
        assert assemble_strip(host, buffer) == [0, 1, 2, 1, value, 2, 4, 5, 6]
    assert host.reads == 2


def test_buffers_without_indices_and_destroyed_buffers_are_ignored() -> None:
    host = Host()
    buffer = host.buffer(1, STRIP)
    host.assembler.write(99, 0, b"abcd")
    host.assembler.change(99)
    host.assembler.forget(99)
    host.assembler.forget(buffer)
    with pytest.raises(KeyError):
        assemble_strip(host, buffer)


def test_the_number_of_cached_assemblies_of_a_buffer_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assembly, "_MAX_ASSEMBLIES", 3)
    host = Host()
    buffer = host.buffer(1, np.arange(100, dtype=np.uint32))
    for first in range(20):
        assert host.assembler.assemble(Primitive.POINTS, first, 5, buffer).lowest == first
        assert len(host.assembler._buffers[buffer].assemblies) <= 3


def test_a_restart_in_a_list_ends_its_primitive() -> None:
    host = Host()
    buffer = host.buffer(1, np.array([0, 1, 2, 3, 0xFFFFFFFF, 4, 5, 6], np.uint32))
    assembly = host.assembler.assemble(Primitive.TRIANGLES, 0, 8, buffer)
    assert host.vertices(assembly, buffer) == [0, 1, 2, 4, 5, 6]
    assert (assembly.lowest, assembly.highest) == (0, 6)
