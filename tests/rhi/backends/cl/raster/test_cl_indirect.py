"""Indirect draws, whose arguments the CPU has to know: they wait for the device only if it may have written
them."""

from __future__ import annotations

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from rhi import Buffer, Device, Format, IndirectDraws, Mesh
from rhi.backends.cl.memory import cl_buffers
from rhi.backends.cl.memory.cl_buffers import Buffers
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.contract.descriptors import Id

COLUMNS = np.concatenate([rectangle(-1 + i / 4, -1, -1 + (i + 1) / 4, 1) for i in range(8)])


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[Id]:
    """The buffers that were read back, each of which waits for the device."""
    read, asked = Buffers.read, list[Id]()

    def note(self: Buffers, buffer: Id, offset: int, size: int) -> bytes:
        asked.append(buffer)
        return read(self, buffer, offset, size)

    monkeypatch.setattr(Buffers, "read", note)
    return asked


class IndirectScene:
    """Draws columns of an image, those that the first draw of a buffer names."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._program = device.program(Colored)
        self._image = device.texture((8, 1), Format.R8)
        self.mesh: Mesh = device.mesh(COLUMNS)

    def draws(self, first: int, count: int) -> NDArray[np.void]:
        return self.mesh.draws(6 * first, 6 * count)

    def draw(self, arguments: Buffer) -> None:
        with self._device.render_pass(self._image, clear=(0, 0, 0, 0)):
            self._device.draw_indirect(self._program, self.mesh, IndirectDraws(arguments, 1))

    def columns(self) -> list[int]:
        return np.flatnonzero(self._image.read().reshape(8)).tolist()


def test_arguments_that_only_the_cpu_writes_are_read_back_once(device: Device, reads: list[Id]) -> None:
    scene = IndirectScene(device)
    arguments = device.buffer(scene.draws(0, 1))
    drawn = []
    for first in range(4):
        scene.draw(arguments)
        drawn.append(scene.columns())
        arguments.write(scene.draws(first + 1, 2))
    assert drawn == [[0], [1, 2], [2, 3], [3, 4]]
    assert reads == [arguments.id]


def test_a_recorded_array_of_draws_is_read_back_once(device: Device, reads: list[Id]) -> None:
    scene = IndirectScene(device)
    image = device.texture((8, 1), Format.R8)
    with device.record() as commands, commands.render_pass(image):
        commands.draw_many(device.program(Colored), scene.mesh, scene.draws(2, 3))
    for _ in range(3):
        device.submit(commands)
    assert len(reads) == 1
    assert np.flatnonzero(image.read().reshape(8)).tolist() == [2, 3, 4]


def test_arguments_that_the_device_writes_are_read_back_each_time(device: Device, reads: list[Id]) -> None:
    scene = IndirectScene(device)
    arguments, source = device.buffer(scene.draws(0, 1)), device.buffer(scene.draws(5, 1))
    scene.draw(arguments)
    assert scene.columns() == [0]
    source.copy_to(arguments)
    scene.draw(arguments)
    assert scene.columns() == [5]
    arguments.write(scene.draws(7, 1))
    scene.draw(arguments)
    assert scene.columns() == [7]
    assert reads == [arguments.id] * 3


def test_large_buffers_are_read_in_part(
    device: Device, reads: list[Id], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their contents aren't kept."""
    monkeypatch.setattr(cl_buffers, "_MAX_CPU_COPY_BYTES", 39)
    scene = IndirectScene(device)
    small = np.concatenate([scene.draws(3, 1)])
    arguments, large = device.buffer(small), device.buffer(np.concatenate([small] * 3))
    for _ in range(2):
        scene.draw(arguments)
        scene.draw(large)
    assert scene.columns() == [3]
    assert reads == [arguments.id, large.id, large.id]


def test_written_arguments_are_read_without_a_command(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A command that copies would wake a thread of the device."""
    scene = IndirectScene(device)
    arguments = device.buffer(scene.draws(0, 1))
    device.buffer(scene.draws(5, 1)).copy_to(arguments)
    monkeypatch.setattr(cl, "enqueue_copy", None)
    scene.draw(arguments)
    monkeypatch.undo()
    assert scene.columns() == [5]
