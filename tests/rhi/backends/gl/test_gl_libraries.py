"""Devices beside contexts of well-known libraries: the image shows in their windows, and their context stays
current.

Each runs in a process of its own, in a virtual X server (nightly).
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from typing import Final

import pytest
from screens_kit import Display

CHECK: Final = """
import moderngl, numpy as np, rhi
from rhi.backends.gl.gl_host import _get_current

def check(read, context="current"):
    "An image of noise, which the size of the place needn't scale."
    texels = np.random.default_rng(1).integers(0, 256, (48, 64, 4), np.uint8)
    before, there = read(), _get_current()[1]
    with rhi.create_device("gl", context=context) as device:
        assert (read(), _get_current()[1]) == (before, there), "the library's context is current, as it was"
        device.present(device.texture(texels))
        seen = np.frombuffer(read(), np.uint8).reshape(48, 64, -1)[::-1, :, :3]
        assert (seen == texels[..., :3]).all()
    assert read() != before
    print("shown")
"""
LIBRARIES: Final = {
    "pygame": """
import pygame
pygame.display.init()
pygame.display.set_mode((64, 48), pygame.OPENGL | pygame.DOUBLEBUF)
check(moderngl.create_context().screen.read)
""",
    "pyglet": """
import pyglet
window = pyglet.window.Window(64, 48)
window.switch_to()
check(moderngl.create_context().screen.read)
""",
    "glfw": """
import glfw
glfw.init()
window = glfw.create_window(64, 48, "host", None, None)
glfw.make_context_current(window)
check(moderngl.create_context().screen.read)
""",
    "moderngl_window": """
from moderngl_window.context.headless import Window
window = Window(size=(64, 48))
check(window.fbo.read, window.ctx)
""",
    "PySide6": """
from PySide6.QtGui import QGuiApplication, QOffscreenSurface, QOpenGLContext
application, surface, context = QGuiApplication([]), QOffscreenSurface(), QOpenGLContext()
surface.create()
assert context.create() and context.makeCurrent(surface)
framebuffer = moderngl.create_context().simple_framebuffer((64, 48))
framebuffer.use()
check(framebuffer.read)
""",
}


@pytest.mark.nightly
@pytest.mark.parametrize("library", LIBRARIES)
def test_an_image_appears_in_the_framebuffer_of_a_library(library: str, display: Display) -> None:
    if importlib.util.find_spec(library) is None:
        pytest.skip(f"no {library}: pip install rhi[hosts]")
    environment = os.environ | display.environment | {"QT_QPA_PLATFORM": "offscreen"}
    command = [sys.executable, "-c", CHECK + LIBRARIES[library]]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=120, check=False, encoding="utf-8"
    )
    assert done.stdout.splitlines()[-1:] == ["shown"], done.stderr[-3000:]
