"""Windows in a virtual X server: the screen's pixels are the frame's, in every size and with every kind of
context."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from nightly_reasons import FEWER_CASES
from screens_kit import Display

EXAMPLE = Path(__file__).parents[2] / "examples" / "orbit_viewer.py"
FRAMES = """
import ctypes, struct, sys, time
from pathlib import Path
import glfw
import numpy as np
import rhi

api, version, file = sys.argv[1:]
assert glfw.init()
kinds = {"egl": glfw.EGL_CONTEXT_API, "glx": glfw.NATIVE_CONTEXT_API}
glfw.window_hint(glfw.CONTEXT_CREATION_API, kinds[api])
if version != "any":
    glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, int(version[0]))
    glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, int(version[2]))
    glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
window = glfw.create_window(64, 48, "test", None, None)
assert window
glfw.make_context_current(window)


def look(width, height):
    "Return the window's pixels on the screen, which the X server keeps in a file."
    content = Path(file).read_bytes()
    head = struct.unpack(">25I", content[:100])
    start, rows, stride = head[0] + 12 * head[19], head[5], head[12]
    screen = np.frombuffer(content[start:start + rows * stride], np.uint8).reshape(rows, -1, 4)[..., 2::-1]
    x, y = glfw.get_window_pos(window)
    return screen[y:y + height, x:x + width]


def wait_for(condition):
    for _ in range(200):
        glfw.poll_events()
        if condition():
            return True
        time.sleep(0.05)
    return False


with rhi.create_device("gl", context="current", validation=True) as device:
    for size in ((64, 48), (101, 67), (40, 90)):
        glfw.set_window_size(window, *size)
        assert wait_for(lambda: glfw.get_framebuffer_size(window) == size)
        texels = np.random.default_rng(1).integers(0, 256, (size[1], size[0], 4), np.uint8)
        with device.texture(texels, rhi.Format.RGBA8) as image:
            def shows():
                device.present(image)
                glfw.swap_buffers(window)
                seen = look(*size)
                return seen.shape == texels[..., :3].shape and (seen == texels[..., :3]).all()
            assert wait_for(shows), size
    other = glfw.create_window(30, 20, "other", None, window)
    glfw.make_context_current(other)
    device.buffer(4)
    glfw.make_context_current(window)
    glfw.destroy_window(other)
    device.present()
    assert glfw.get_current_context()
glfw.terminate()
print("done")
"""


def run(display: Display, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, **display.environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


@pytest.mark.parametrize(
    ("api", "version"),
    [
        ("glx", "any"),
        ("egl", "3.3"),
        *(
            pytest.param(api, version, marks=pytest.mark.nightly)
            for api, version in (("glx", "3.3"), ("egl", "any"), ("glx", "4.5"))
        ),
    ],
)
def test_the_screens_pixels_are_the_frames(display: Display, api: str, version: str) -> None:
    assert run(display, "-c", FRAMES, api, version, str(display.pixels)).strip() == "done"


@pytest.mark.nightly_cases("cl", reason=FEWER_CASES)
@pytest.mark.parametrize("backend", ["gl", "cl"])
def test_the_example_draws_its_frames(display: Display, backend: str) -> None:
    output = run(display, str(EXAMPLE), "--backend", backend, "--frames", "3", "--immediate")
    assert output.startswith("3 frames")


def test_without_a_display_the_example_says_so_in_one_line() -> None:
    pytest.importorskip("glfw", reason="no GLFW: pip install rhi[viewer]")
    environment = {
        name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")
    }
    done = subprocess.run(
        [sys.executable, str(EXAMPLE)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        encoding="utf-8",
    )
    assert done.returncode == 1
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("no window can be opened here: ")
    assert "set DISPLAY or WAYLAND_DISPLAY" in line
