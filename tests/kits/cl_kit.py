"""Native OpenCL C programs for the tests of the OpenCL backend, and a backend with helpers."""

from __future__ import annotations

import threading
from contextlib import suppress

import numpy as np
import pyopencl as cl
from backend_kit import BackendKit
from numpy.typing import NDArray

from rhi.backends.cl.cl_backend import ClBackend
from rhi.contract import descriptors

FILL = """
__kernel void fill(__global uint *words, int count) {
    words[get_global_id(0)] = get_global_id(0) + count;
}
"""
STORAGE = (descriptors.Binding("words", descriptors.BindingKind.STORAGE, 0, True, None, 4),)


def describe_program(
    source: str,
    bindings: tuple[descriptors.Binding, ...] = STORAGE,
    work_group: tuple[int, int, int] = (1, 1, 1),
    origins: tuple[tuple[str, int], ...] = (),
) -> descriptors.ProgramDescriptor:
    return descriptors.ProgramDescriptor(
        "Native",
        frozenset({descriptors.Stage.COMPUTE}),
        bindings,
        (),
        (),
        work_group,
        lambda language, stage: descriptors.StageText(source, origins),
    )


class ClKit(BackendKit):
    """The kit on OpenCL: textures of any descriptor, and commands that are held back."""

    backend: ClBackend

    def __init__(self, backend: ClBackend) -> None:
        super().__init__(backend)
        self._timers: dict[cl.UserEvent, threading.Timer] = {}

    def words(self, buffer: descriptors.Id, count: int, offset: int = 0) -> list[int]:
        return np.frombuffer(self.backend.read_buffer(buffer, offset, 4 * count), np.uint32).tolist()

    def texture(self, descriptor: descriptors.TextureDescriptor) -> descriptors.Id:
        texture = self.new_id()
        self.backend.create_texture(texture, descriptor)
        return texture

    def read(self, texture: descriptors.Id, width: int, height: int, level: int = 0) -> NDArray[np.generic]:
        return self.backend.read_texture(texture, level, descriptors.Region(0, 0, width, height), False)[0]

    def hold(self) -> cl.UserEvent:
        """Hold back all further work until the returned event is released. It is released by itself after two
        minutes, so that a wait by mistake ends with a wrong result instead of hanging."""
        event = cl.UserEvent(self.backend.context.context)
        cl.enqueue_barrier(self.backend.context.queue, wait_for=[event])
        timer = self._timers[event] = threading.Timer(120.0, self._complete, [event])
        timer.daemon = True
        timer.start()
        return event

    def release(self, event: cl.UserEvent) -> None:
        self._timers.pop(event).cancel()
        self._complete(event)

    def _complete(self, event: cl.UserEvent) -> None:
        with suppress(cl.LogicError):  # it is complete
            event.set_status(cl.command_execution_status.COMPLETE)

    def close(self) -> None:
        for event in [*self._timers]:
            self.release(event)
        self.backend.close()

    def finish(self) -> None:
        """Wait for all dispatches. Reads of `READBACK` buffers don't: they take what is there."""
        self.backend.context.queue.finish()

    def dispatch(self, program: descriptors.Id, groups: int = 1) -> None:
        self.backend.bind_program(program)
        self.backend.dispatch(groups, 1, 1)
