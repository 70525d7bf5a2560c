"""Recorded commands and errors name the line of the user's program, whatever stands between it and the
call."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nightly_reasons import CHEAPER_TEST

import rhi
from renderer.content import load_scene
from renderer.renderer import Renderer
from rhi import CullMode, Device, Format, Op
from rhi.errors.call_sites import MARK


@pytest.fixture
def device() -> Iterator[Device]:
    with rhi.create_device("null") as created:
        yield created


def here(offset: int = 0) -> tuple[str, int]:
    """Return the caller's file and line, or a line before or after it."""
    return __file__, sys._getframe(1).f_lineno + offset


def lines(device: Device, *ops: Op) -> list[tuple[str, int]]:
    """Return the files and lines of a device's commands of some kinds."""
    sites = [command.site for command in device.stream if command.op in ops]
    return [(site.file, site.line) for site in sites if site is not None]


def test_a_scope_that_an_exit_stack_enters_and_leaves_is_at_the_lines_of_the_stack(device: Device) -> None:
    image = device.texture((4, 4), Format.RGBA8)
    with contextlib.ExitStack() as stack:
        stack.enter_context(device.render_pass(image, clear=(0, 0, 0, 1)))
        began = here(-1)
        stack.close()
        ended = here(-1)
    assert lines(device, Op.BEGIN_PASS, Op.END_PASS) == [began, ended]


def test_a_refusal_inside_an_exit_stack_names_the_line_of_the_stack(device: Device) -> None:
    with pytest.raises(rhi.ValidationError) as caught, contextlib.ExitStack() as stack:
        stack.enter_context(device.render_pass())
    assert caught.value.site is not None
    assert (caught.value.site.file, caught.value.site.line) == here(-2)


def test_a_generator_of_the_user_that_is_a_scope_has_its_own_lines(device: Device) -> None:
    image = device.texture((4, 4), Format.RGBA8)

    @contextlib.contextmanager
    def drawing() -> Iterator[None]:
        with device.render_pass(image), device.states(CullMode.NONE):
            yield

    began = here(-3)
    with drawing():
        pass
    assert lines(device, Op.BEGIN_PASS) == [began]


def test_a_decorator_has_its_own_lines(device: Device) -> None:
    buffer = device.buffer(4)

    def twice(function: Callable[[], object]) -> Callable[[], None]:
        def call() -> None:
            function()
            buffer.clear(1)

        return call

    wrapped = twice(lambda: buffer.clear(2))
    wrapped()
    assert lines(device, Op.CLEAR_BUFFER) == [here(-2), here(-6)]


def test_a_comprehension_and_a_generator_expression_are_at_their_lines(device: Device) -> None:
    buffers = [device.buffer(4) for _ in range(2)]
    created = here(-1)
    assert all(buffer.clear(1) is None for buffer in buffers)
    cleared = here(-1)
    assert lines(device, Op.CREATE_BUFFER, Op.CLEAR_BUFFER)[-4:] == [created, created, cleared, cleared]


def test_calls_of_another_library_name_its_line(device: Device) -> None:
    buffer = device.buffer(np.arange(4))
    assert list(map(buffer.clear, [1])) == [None]
    assert lines(device, Op.CLEAR_BUFFER) == [here(-1)]


def test_commands_of_the_renderer_are_recorded_at_the_line_that_calls_render(device: Device) -> None:
    scene = load_scene("grid:count=2")
    with Renderer(device, scene, size=(8, 8)) as renderer:
        device.stream.clear()
        renderer.render(scene.views["overview"])
        rendered = here(-1)
        drawn = lines(device, Op.BEGIN_PASS, Op.DRAW, Op.DRAW_INDIRECT, Op.WRITE_BUFFER, Op.SET_STATES)
    assert len(drawn) > 4
    assert set(drawn) == {rendered}


def test_a_layer_of_the_user_that_the_renderer_calls_has_its_own_lines(device: Device) -> None:
    buffer = device.buffer(4)

    class Clearing:
        def render(self, *arguments: Any) -> None:
            buffer.clear(1)

        def destroy(self) -> None: ...

    scene = load_scene("grid:count=2")
    with Renderer(device, scene, size=(8, 8)) as renderer:
        renderer.layers.append(Clearing())
        renderer.render(scene.views["overview"])
    assert lines(device, Op.CLEAR_BUFFER) == [(__file__, Clearing.render.__code__.co_firstlineno + 1)]


PROGRAM = """
import rhi
with rhi.create_device("null") as device:
    device.buffer(4).clear(1)
    sites = {(command.site.file, command.site.line) for command in device.stream}
    print(*sorted(sites), sep="\\n")
"""


@pytest.mark.nightly_cases("contextlib_user", "renderer", reason=CHEAPER_TEST)
@pytest.mark.parametrize("name", ["renderer", "frames", "contextlib_user"])
def test_a_module_that_users_run_is_theirs_whatever_its_name(tmp_path: Path, name: str) -> None:
    file = tmp_path / f"{name}.py"
    file.write_text(PROGRAM, encoding="utf-8")
    for command in ([sys.executable, "-m", name], [sys.executable, str(file)]):
        output = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=True, encoding="utf-8"
        ).stdout
        assert output.splitlines() == [str((str(file), 4))], command


def test_globals_of_the_user_are_left_as_they_are(device: Device) -> None:
    device.buffer(4).clear(1)
    with pytest.raises(rhi.ValidationError):
        device.buffer(-1)
    assert MARK not in globals()


class Loading:
    """Stands for a module of another library that loads when it is asked anything."""

    def __getattribute__(self, name: str) -> object:
        raise AssertionError(f"asked for {name}")


def test_modules_of_other_libraries_are_left_alone(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: Any = sys.modules
    monkeypatch.setitem(loaded, "neighbour", Loading())
    monkeypatch.setitem(loaded, "renderer.neighbour", None)  # a module that may not be imported
    device.buffer(4).clear(1)
    assert lines(device, Op.CLEAR_BUFFER) == [here(-1)]
