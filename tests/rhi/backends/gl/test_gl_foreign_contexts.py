"""Other code makes its own OpenGL context current, or changes the state of ours: the device draws as
before."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator
from typing import Any

import moderngl
import numpy as np
import pytest
from nightly_reasons import SAME_ON_EACH_BACKEND

import rhi
from rhi.backends.gl.gl_backend import GlBackend
from rhi.conformance.shaders import Colored, Tint, Tinted
from rhi.conformance.shapes import rectangle
from rhi.conformance.waiting import wait_until
from rhi.shading import Shader, StorageRW, global_id, uint

SIZE = (64, 64)
PIXELS = SIZE[0] * SIZE[1]
EGL: dict[str, Any] = {"backend": "egl", "libgl": "libEGL.so.1", "libegl": "libEGL.so.1"}


class Counted(Shader):
    """Adds 1 to each number."""

    work_group = (4,)
    numbers: StorageRW[uint]

    def compute(self) -> None:
        self.numbers[global_id().x] = self.numbers[global_id().x] + uint(1)


@pytest.fixture
def foreign() -> Iterator[moderngl.Context]:
    """Another context of this thread, older than the device's."""
    context = moderngl.create_context(450, standalone=True, **EGL)
    yield context
    context.release()


@pytest.fixture(params=["direct", "recorded"])
def device(request: pytest.FixtureRequest, foreign: moderngl.Context) -> Iterator[rhi.Device]:
    with rhi.create_device("gl", record=request.param == "recorded") as device:
        yield device


TAKE_OVER: dict[str, Callable[[moderngl.Context], None]] = {
    "another context": lambda context: context.mglo.__enter__(),
    "no context": lambda context: (context.mglo.__enter__(), context.mglo.__exit__())[0],
    "a new context": lambda context: moderngl.create_context(450, standalone=True, **EGL).release(),
}


@pytest.fixture(params=TAKE_OVER)
def take_over(request: pytest.FixtureRequest, foreign: moderngl.Context) -> Callable[[], None]:
    """A function that takes the thread from the device's context."""
    return lambda: TAKE_OVER[request.param](foreign)


def count_filled(image: rhi.Texture) -> int:
    return int((image.read()[..., 0] == 255).sum())


def draw_all(device: rhi.Device, image: rhi.Texture) -> None:
    with device.render_pass(image, clear=(0, 0, 0, 0)):
        device.draw(device.program(Colored), device.mesh(rectangle()))


# -- between passes: made current again ----------------------------------------------------------------------


def test_a_pass_draws_after_another_context_was_current(
    device: rhi.Device, take_over: Callable[[], None]
) -> None:
    image, mesh, program = (
        device.texture(SIZE, rhi.Format.RGBA8),
        device.mesh(rectangle()),
        device.program(Colored),
    )
    for _ in range(2):
        take_over()
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, mesh)
        take_over()
        assert count_filled(image) == PIXELS


USES: dict[str, Callable[[rhi.Device, dict[str, Any]], object]] = {
    "buffer": lambda d, r: d.buffer(np.arange(4)).read().tolist() == [0, 1, 2, 3],
    "texture": lambda d, r: d.texture(np.full((2, 2, 4), 7, "u1"), rhi.Format.RGBA8).read().min() == 7,
    "mesh": lambda d, r: d.mesh(rectangle()),
    "program": lambda d, r: d.program(Counted),
    "query": lambda d, r: d.occlusion_query(),
    "query set": lambda d, r: d.query_set(4),
    "buffer read": lambda d, r: r["buffer"].read().tolist() == [1, 2, 3, 4],
    "buffer write": lambda d, r: r["buffer"].write(np.array([1, 2, 3, 4])),
    "buffer clear": lambda d, r: r["zeros"].clear(),
    "buffer copy": lambda d, r: r["buffer"].copy_to(r["zeros"]),
    "texture read": lambda d, r: r["texture"].read().min() == 5,
    "texture write": lambda d, r: r["texture"].write(np.full((4, 4, 4), 5, "u1")),
    "mipmaps": lambda d, r: r["texture"].generate_mipmaps(),
    "signal": lambda d, r: d.wait(d.signal(), 5.0),
    "destroy": lambda d, r: (d.buffer(4).destroy(), d.finish()),
    "present": lambda d, r: d.present(r["texture"]),
    "event": lambda d, r: d.event("late").__enter__(),
    "transient": lambda d, r: d.transient.uniform(Tint(color=(1, 1, 1, 1))),
}


@pytest.mark.nightly_cases("recorded-a* context-*", reason=SAME_ON_EACH_BACKEND)
@pytest.mark.parametrize("use", USES)
@pytest.mark.parametrize("take_over", TAKE_OVER, indirect=True)
@pytest.mark.parametrize("device", ["direct", "recorded"], indirect=True)
def test_each_call_finds_its_context_again(
    device: rhi.Device, take_over: Callable[[], None], use: str
) -> None:
    texture = device.texture(np.full((4, 4, 4), 5, "u1"), rhi.Format.RGBA8, levels=None)
    resources = {
        "buffer": device.buffer(np.array([1, 2, 3, 4])),
        "zeros": device.buffer(32),
        "texture": texture,
    }
    take_over()
    assert USES[use](device, resources) is not False
    assert resources["buffer"].read().tolist() == [1, 2, 3, 4]
    assert (texture.read() == 5).all()


def test_an_asynchronous_read_is_seen_to_be_done(device: rhi.Device, take_over: Callable[[], None]) -> None:
    def is_done() -> bool:
        take_over()
        return read.done

    image = device.texture(SIZE, rhi.Format.RGBA8)
    draw_all(device, image)
    read = image.read_async()
    assert wait_until(is_done)
    assert (read.result()[..., 0] > 0).all()


def test_a_lock_is_written_to_its_own_context(device: rhi.Device, take_over: Callable[[], None]) -> None:
    buffer = device.buffer(np.zeros(4))
    with buffer.lock(rhi.Access.WRITE) as array:
        array[:] = 3
        take_over()
    assert buffer.read().tolist() == [3] * 4


def test_a_dispatch_keeps_its_bindings(device: rhi.Device, take_over: Callable[[], None]) -> None:
    program = device.program(Counted)
    first, second = device.storage(uint, 4), device.storage(uint, 4)
    device.dispatch(program, 1, numbers=first)
    take_over()
    device.dispatch(program, 1, numbers=second)
    take_over()
    device.dispatch(program, 1, numbers=second)
    assert (first.read().tolist(), second.read().tolist()) == ([1] * 4, [2] * 4)


def test_a_command_buffer_is_executed_in_its_own_context(
    device: rhi.Device, take_over: Callable[[], None]
) -> None:
    image, mesh, program = (
        device.texture(SIZE, rhi.Format.RGBA8),
        device.mesh(rectangle()),
        device.program(Colored),
    )
    with device.record() as commands, commands.render_pass(image, clear=(0, 0, 0, 0)):
        commands.draw(program, mesh)
    for _ in range(2):
        take_over()
        device.submit(commands)
        take_over()
        assert count_filled(image) == PIXELS


def test_answers_come_from_the_device_s_own_queries(device: rhi.Device, foreign: moderngl.Context) -> None:
    """The foreign context has queries of the same names, with other answers."""
    image, mesh, program = (
        device.texture(SIZE, rhi.Format.RGBA8),
        device.mesh(rectangle()),
        device.program(Colored),
    )
    queries = [device.occlusion_query() for _ in range(4)]
    with device.render_pass(image, clear=(0, 0, 0, 0)):
        for query in queries:
            with query:
                device.draw(program, mesh)
    device.finish()
    foreign.mglo.__enter__()
    foreign.simple_framebuffer((4, 4)).use()
    for _ in range(8):
        with foreign.query(samples=True):
            foreign.clear()
    assert [query.wait() for query in queries] == [PIXELS] * 4


def test_states_hold_across_another_context(device: rhi.Device, take_over: Callable[[], None]) -> None:
    image, mesh, program = (
        device.texture(SIZE, rhi.Format.RGBA8),
        device.mesh(rectangle()),
        device.program(Colored),
    )
    with device.states(rhi.Scissor(0, 0, 8, 8), rhi.CullMode.NONE):
        for _ in range(2):
            with device.render_pass(image, clear=(0, 0, 0, 0)):
                device.draw(program, mesh)
            take_over()
            assert count_filled(image) == 64


def test_a_device_closes_after_another_context_was_current(take_over: Callable[[], None]) -> None:
    other = rhi.create_device("gl")
    buffer = other.buffer(np.arange(4))
    take_over()
    other.close()
    assert other.closed
    buffer.destroy()


# -- inside a pass: refused by name, unless the device was made current --------------------------------------


def test_draws_into_another_context_are_refused_at_the_end_of_the_pass(
    device: rhi.Device, take_over: Callable[[], None]
) -> None:
    image, mesh, program = (
        device.texture(SIZE, rhi.Format.RGBA8),
        device.mesh(rectangle()),
        device.program(Colored),
    )
    with pytest.raises(rhi.DeviceError) as caught, device.render_pass(image, clear=(0, 0, 0, 0)):
        take_over()
        device.draw(program, mesh)
    assert caught.value.rule.id == "device-context"
    assert "make_current" in caught.value.tip
    draw_all(device, image)
    assert count_filled(image) == PIXELS


def test_they_are_refused_at_the_next_call_that_creates_something(
    device: rhi.Device, take_over: Callable[[], None]
) -> None:
    image, mesh, program = (
        device.texture(SIZE, rhi.Format.RGBA8),
        device.mesh(rectangle()),
        device.program(Colored),
    )
    with device.render_pass(image, clear=(0, 0, 0, 0)):
        device.draw(program, mesh)
        take_over()
        with pytest.raises(rhi.DeviceError, match=r"^\[device-context\]"):
            device.buffer(4)
        device.draw(program, mesh)  # the pass goes on
    assert count_filled(image) == PIXELS


def test_a_device_made_current_inside_a_pass_goes_on_drawing(
    device: rhi.Device, take_over: Callable[[], None]
) -> None:
    image, mesh, program = (
        device.texture(SIZE, rhi.Format.RGBA8),
        device.mesh(rectangle()),
        device.program(Tinted),
    )
    tint = device.uniform(Tint(color=(1, 1, 1, 1)))
    with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(rhi.CullMode.NONE):
        with device.states(rhi.Scissor(0, 0, 64, 32)):
            device.draw(program, mesh, tint=tint)
        take_over()
        device.make_current()
        with device.states(rhi.Scissor(0, 32, 64, 16)):
            device.draw(program, mesh, tint=tint)
    assert count_filled(image) == PIXELS * 3 // 4


def test_a_foreign_context_that_is_restored_in_time_is_allowed(
    device: rhi.Device, foreign: moderngl.Context
) -> None:
    image, mesh, program = (
        device.texture(SIZE, rhi.Format.RGBA8),
        device.mesh(rectangle()),
        device.program(Colored),
    )
    context = device.backend_as(GlBackend).context
    with device.render_pass(image, clear=(0, 0, 0, 0)):
        foreign.mglo.__enter__()
        foreign.clear()
        context.mglo.__enter__()
        device.draw(program, mesh)
    assert count_filled(image) == PIXELS


def test_with_validation_the_draw_itself_is_refused() -> None:
    with rhi.create_device("gl", validation=True) as device:
        image, mesh = device.texture(SIZE, rhi.Format.RGBA8), device.mesh(rectangle())
        program = device.program(Colored)
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, mesh)
            context = moderngl.create_context(450, standalone=True, **EGL)
            with pytest.raises(rhi.DeviceError, match=r"^\[device-context\]") as caught:
                device.draw(program, mesh)
            assert caught.value.site is not None
            assert caught.value.site.file == __file__
            device.draw(program, mesh)
        context.release()
        assert count_filled(image) == PIXELS


def test_a_first_draw_creates_no_driver_objects_in_another_context(
    device: rhi.Device, take_over: Callable[[], None]
) -> None:
    """The variant of a program with an alpha test."""
    image, mesh, program = (
        device.texture(SIZE, rhi.Format.RGBA8),
        device.mesh(rectangle()),
        device.program(Colored),
    )
    tested = rhi.AlphaTest.ON, rhi.AlphaFunction.GREATER, rhi.AlphaReference(0.5), rhi.Scissor(0, 0, 32, 64)
    for _ in range(2):
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, mesh, 0)
            take_over()
            with device.states(*tested), pytest.raises(rhi.DeviceError, match=r"^\[device-context\]"):
                device.draw(program, mesh)
            with device.states(*tested):
                device.draw(program, mesh)
        assert count_filled(image) == PIXELS // 2
        tested = (
            rhi.AlphaTest.ON,
            rhi.AlphaFunction.LESS_EQUAL,
            rhi.AlphaReference(1.0),
            rhi.Scissor(0, 0, 32, 64),
        )


@pytest.mark.parametrize("indexed", [False, True])
def test_quads_are_not_expanded_in_another_context(
    device: rhi.Device, take_over: Callable[[], None], indexed: bool
) -> None:
    image, program = device.texture(SIZE, rhi.Format.RGBA8), device.program(Colored)
    rows = rectangle()[[0, 1, 2, 5]]
    mesh = device.mesh(rows, np.arange(4, dtype="u2") if indexed else None, primitive=rhi.Primitive.QUADS)
    with device.render_pass(image, clear=(0, 0, 0, 0)):
        device.draw(program, mesh, 0)
    many = device.mesh(
        np.tile(rows, 2000), np.arange(8000, dtype="u2") if indexed else None, primitive=rhi.Primitive.QUADS
    )
    with device.render_pass(image, clear=(0, 0, 0, 0)):
        device.draw(program, many.view(0, 4))
        take_over()
        with pytest.raises(rhi.DeviceError, match=r"^\[device-context\]"):
            device.draw(program, many.view(1))  # other quads than those that were expanded
    draw_all(device, image)
    for first in (0, 1):
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, many.view(first))
        assert count_filled(image) == PIXELS


@pytest.mark.parametrize("emulated", [False, True])
def test_queries_count_again_after_a_pass_that_was_lost(
    device: rhi.Device, foreign: moderngl.Context, emulated: bool
) -> None:
    image, mesh, program = (
        device.texture(SIZE, rhi.Format.RGBA8),
        device.mesh(rectangle()),
        device.program(Colored),
    )
    query, lost = device.occlusion_query(emulated=emulated), device.occlusion_query(emulated=emulated)
    with pytest.raises(rhi.DeviceError), device.render_pass(image, clear=(0, 0, 0, 0)):
        with lost:
            device.draw(program, mesh)
            foreign.mglo.__enter__()
        with lost:
            device.draw(program, mesh)
    for _ in range(2):
        with device.render_pass(image, clear=(0, 0, 0, 0)), query:
            device.draw(program, mesh)
        assert query.wait() == PIXELS


def test_labels_stay_paired_after_a_pass_that_was_lost(device: rhi.Device, foreign: moderngl.Context) -> None:
    gl = device.backend_as(GlBackend).gl
    image = device.texture(SIZE, rhi.Format.RGBA8)
    before = gl.get_integer(0x826D)  # GL_DEBUG_GROUP_STACK_DEPTH
    for _ in range(2):
        with device.event("frame"):
            with pytest.raises(rhi.DeviceError), device.render_pass(image), device.event("lost"):
                foreign.mglo.__enter__()
            assert gl.get_integer(0x826D) == before + 1
    assert gl.get_integer(0x826D) == before


# -- other code changes the state of the device's context ----------------------------------------------------

DISTURBANCES: dict[str, Callable[[Any], object]] = {
    "clip control": lambda gl: gl.ClipControl(0x8CA2, 0x935E),
    "provoking vertex": lambda gl: gl.ProvokingVertex(0x8E4E),
    "scissor": lambda gl: (gl.Enable(0x0C11), gl.Scissor(0, 0, 3, 3)),
    "viewport": lambda gl: gl.Viewport(0, 0, 5, 5),
    "depth range": lambda gl: gl.DepthRangef(0.9, 1.0),
    "color mask": lambda gl: gl.ColorMask(0, 0, 0, 0),
    "blending": lambda gl: gl.Enable(0x0BE2),
    "culling": lambda gl: (gl.Enable(0x0B44), gl.CullFace(0x0408)),
    "winding": lambda gl: gl.FrontFace(0x0901),
    "depth": lambda gl: (gl.Disable(0x0B71), gl.DepthMask(0)),
    "comparison": lambda gl: gl.DepthFunc(0x0200),
    "stencil": lambda gl: (gl.Enable(0x0B90), gl.StencilFuncSeparate(0x0408, 0x0200, 1, 1)),
    "bias": lambda gl: (gl.Enable(0x8037), gl.PolygonOffset(1.0, 1.0)),
    "rasteriser": lambda gl: gl.Enable(0x8C89),
    "logic": lambda gl: gl.Enable(0x0BF2),
    "samples": lambda gl: (gl.Enable(0x80A0), gl.Enable(0x8E51), gl.Enable(0x8C36)),
    "clamped depth": lambda gl: gl.Enable(0x864F),
    "clip planes": lambda gl: gl.Enable(0x3007),
    "sRGB": lambda gl: gl.Disable(0x8DB9),
    "dither": lambda gl: gl.Enable(0x0BD0),
    "point size": lambda gl: gl.Disable(0x8642),
    "fill": lambda gl: gl.PolygonMode(0x0408, 0x1B00),
    "edges": lambda gl: (gl.PolygonMode(0x0408, 0x1B01), gl.Enable(0x2A02)),
    "line width": lambda gl: gl.LineWidth(3.0),
    "framebuffer": lambda gl: gl.BindFramebuffer(0x8D40, 0),
    "primitive restart": lambda gl: (gl.Disable(0x8D69), gl.Enable(0x8F9D)),
    "pixels that are skipped": lambda gl: (gl.PixelStorei(0x0CF4, 1), gl.PixelStorei(0x0D04, 1)),
    "rows of pixels": lambda gl: (gl.PixelStorei(0x0CF2, 7), gl.PixelStorei(0x0D02, 7)),
    "alignment": lambda gl: (gl.PixelStorei(0x0CF5, 8), gl.PixelStorei(0x0D05, 8)),
    "bytes in another order": lambda gl: (gl.PixelStorei(0x0CF0, 1), gl.PixelStorei(0x0D00, 1)),
    "pixel buffer": lambda gl: gl.BindBuffer(0x88EC, gl.create(gl.CreateBuffers)),
    "label": lambda gl: gl.PushDebugGroup(0x824A, 0, -1, b"foreign"),
    "query": lambda gl: gl.BeginQuery(0x8914, gl.create(gl.CreateQueries, 0x8914)),
}
SWITCHES = (
    0x0B44, 0x0B71, 0x0B90, 0x0BD0, 0x0BE2, 0x0BF2, 0x0C11, 0x2A02, 0x3007, 0x8037, 0x809E, 0x80A0, 0x8642, 0x864F,
    0x8C36, 0x8C89, 0x8D69, 0x8DB9, 0x8E51, 0x8F9D,
)  # fmt: skip
NUMBERS = (
    0x0B40, 0x0B45, 0x0B46, 0x0B72, 0x0B74, 0x0B92, 0x0B93, 0x0B97, 0x0C23, 0x0CF0, 0x0CF2, 0x0CF4, 0x0CF5, 0x0D00,
    0x0D02, 0x0D04, 0x0D05, 0x826D, 0x88EF, 0x8CA6, 0x8E4F, 0x935C, 0x935D,
)  # fmt: skip
"""Polygon mode, face, winding, depth mask and comparison, stencil, color mask, transfers, labels,
framebuffer, …"""


def read_state(gl: Any) -> dict[str, Any]:
    integers, reals, query = (ctypes.c_int64 * 4)(), (ctypes.c_float * 4)(), ctypes.c_int()
    state: dict[str, Any] = {}
    for name in SWITCHES + NUMBERS:
        gl.GetInteger64v(name, integers)
        state[hex(name)] = list(integers)
    for name in (0x0BA2, 0x0B70, 0x0B21):  # viewport, depth range, line width
        gl.GetFloatv(name, reals)
        state[hex(name)] = list(reals)
    gl.GetQueryiv(0x8914, 0x8865, ctypes.byref(query))
    return {**state, "query": query.value}


@pytest.mark.parametrize("validation", [False, True])
@pytest.mark.parametrize("kind", DISTURBANCES)
def test_make_current_restores_the_state_that_other_code_changed(kind: str, validation: bool) -> None:
    with rhi.create_device("gl", validation=validation) as device:
        image, depth = device.texture(SIZE, rhi.Format.RGBA8), device.texture(SIZE, rhi.Format.D24S8)
        program, mesh = device.program(Colored), device.mesh(rectangle())
        gl = device.backend_as(GlBackend).gl
        with device.render_pass(image, depth, clear_depth=0.25):
            device.draw(program, mesh)
            before = read_state(gl)
            DISTURBANCES[kind](gl)
            assert read_state(gl) != before
            device.make_current()
            assert read_state(gl) == before
            device.draw(program, mesh)
        assert count_filled(image) == PIXELS


def test_make_current_restores_lines_that_are_wide_and_edges_with_an_offset() -> None:
    with rhi.create_device("gl") as device:
        gl = device.backend_as(GlBackend).gl
        image, program, mesh = (
            device.texture(SIZE, rhi.Format.RGBA8),
            device.program(Colored),
            device.mesh(rectangle()),
        )
        with (
            device.render_pass(image),
            device.states(rhi.PolygonMode.LINE, rhi.LineWidth(5.0), rhi.DepthBias(2.0)),
        ):
            device.draw(program, mesh)
            before = read_state(gl)
            assert (before["0x2a02"][0], before["0xb40"][0], before["0xb21"][0]) == (1, 0x1B01, 5.0)
            gl.PolygonMode(0x0408, 0x1B02)
            gl.LineWidth(1.0)
            gl.Disable(0x2A02)
            device.make_current()
            assert read_state(gl) == before


def test_make_current_restores_the_bindings_that_other_code_changed(device: rhi.Device) -> None:
    backend = device.backend_as(GlBackend)
    image, mesh, program = (
        device.texture(SIZE, rhi.Format.RGBA8),
        device.mesh(rectangle()),
        device.program(Tinted),
    )
    tint, other = device.uniform(Tint(color=(1, 1, 1, 1))), backend.context.buffer(reserve=256)
    counts = []
    for restored in (False, True):
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, mesh, 0, tint=tint)
            other.bind_to_uniform_block(0)
            if restored:
                device.make_current()
            device.draw(program, mesh, tint=tint)
        counts.append(count_filled(image))
    assert counts == [0, PIXELS]


# -- where the context can't be made current -----------------------------------------------------------------


def test_a_context_that_another_thread_holds_is_named() -> None:
    with rhi.create_device("gl") as device:
        context = device.backend_as(GlBackend).context
        image = device.texture(SIZE, rhi.Format.RGBA8)
        context.mglo.__exit__()
        taken, released = threading.Event(), threading.Event()

        def hold() -> None:
            context.mglo.__enter__()
            taken.set()
            released.wait(10)
            context.mglo.__exit__()

        thread = threading.Thread(target=hold)
        thread.start()
        taken.wait(10)
        try:
            for use in (lambda: draw_all(device, image), lambda: device.buffer(4), device.make_current):
                with pytest.raises(rhi.DeviceError, match=r"^\[device-context\]"):
                    use()
        finally:
            released.set()
            thread.join()
        draw_all(device, image)
        assert count_filled(image) == PIXELS


def test_devices_on_two_threads_draw_at_the_same_time() -> None:
    """Neither takes the other's context: each is current on its own thread."""
    failures: list[str] = []

    def work(color: int) -> None:
        with rhi.create_device("gl") as device:
            image, mesh, program = (
                device.texture(SIZE, rhi.Format.RGBA8),
                device.mesh(rectangle()),
                device.program(Tinted),
            )
            tint = device.uniform(Tint(color=(color / 255, 0, 0, 1)))
            for _ in range(50):
                with device.render_pass(image, clear=(0, 0, 0, 0)):
                    for _ in range(4):
                        device.draw(program, mesh, tint=tint)
                if not (image.read()[..., 0] == color).all():
                    failures.append(f"color {color}")

    threads = [threading.Thread(target=work, args=(color,)) for color in (50, 150, 250)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
