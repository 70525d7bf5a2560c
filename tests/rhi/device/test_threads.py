"""Work that other threads may do for a device: type-check shaders, record commands, decode what it uploads."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import rhi
from rhi import Device, Format, Op
from rhi.backends.null import NullBackend
from rhi.conformance.shaders import Bare, Corner, Positions
from rhi.conformance.shapes import rectangle
from rhi.shading import Shader, compile_shader, vec4


class WithContext(NullBackend):
    """A null backend that keeps the calls about its context."""

    def __init__(self, calls: list[str]) -> None:
        super().__init__()
        self._calls = calls

    def resume(self) -> bool:
        self._calls.append("resume")
        return False

    def make_current(self) -> None:
        self._calls.append("make_current")

    def release_current(self) -> None:
        self._calls.append("release_current")


def on_threads(count: int, work: Callable[[int], object]) -> None:
    """Run `work` on several threads that begin together; raise what any of them raises."""
    start = threading.Barrier(count)

    def begin(number: int) -> None:
        start.wait()
        work(number)

    with ThreadPoolExecutor(count) as pool:
        for done in [pool.submit(begin, number) for number in range(count)]:
            done.result()


def test_a_shader_is_type_checked_on_any_thread() -> None:
    class Fresh(Shader):
        """A class that nothing has compiled yet."""

        def vertex(self, v: Corner) -> Bare:
            return Bare(clip=v.position)

        def fragment(self) -> vec4:
            return vec4(1.0, 1.0, 1.0, 1.0)

    on_threads(4, lambda number: compile_shader(Fresh))
    with rhi.create_device("null") as device:
        program, image = device.program(Fresh), device.texture((4, 4), Format.R8)
        with device.render_pass(image):
            device.draw(program, device.mesh(rectangle()))
        assert program.descriptor is compile_shader(Fresh)
        assert len(device.stream.draws()) == 1


def test_devices_on_several_threads_are_independent() -> None:
    def work(number: int) -> None:
        with rhi.create_device("null") as device:
            buffer = device.buffer(np.full(8, number))
            assert buffer.read().tolist() == [number] * 8
            assert device.stream.filter(Op.READ_BUFFER)[-1]["size"] == 64

    on_threads(4, work)


def test_an_ended_thread_is_called_ended() -> None:
    devices: list[Device] = []
    on_threads(1, lambda number: devices.append(rhi.create_device("null")))
    with pytest.raises(rhi.ValidationError, match="device-thread") as caught:
        devices[0].make_current()
    assert caught.value.allowed == "a thread that has ended"


def test_a_context_is_looked_for_behind_recorders_and_wrappers() -> None:
    calls: list[str] = []

    inner = WithContext(calls)
    for backend in (inner, rhi.Recorder(inner), rhi.Recorder(rhi.Recorder(inner))):
        calls.clear()
        device = Device(backend)
        device.buffer(4)
        assert set(calls) == {"resume"}
        device.release_current()
        device.make_current()
        assert calls[-2:] == ["release_current", "make_current"]
        device.close()


def test_a_draw_asks_for_no_context_but_a_pass_does() -> None:
    calls: list[str] = []

    device = Device(WithContext(calls))
    program, mesh, image = device.program(White), device.mesh(rectangle()), device.texture((4, 4), Format.R8)
    with device.render_pass(image):
        device.draw(program, mesh)
        calls.clear()
        with device.states(rhi.CullMode.NONE):
            for _ in range(5):
                device.draw(program, mesh)
        assert not calls
    assert calls == ["resume"]
    device.close()


class White(Positions):
    """White wherever something is drawn."""

    def fragment(self) -> vec4:
        return vec4(1.0, 1.0, 1.0, 1.0)
