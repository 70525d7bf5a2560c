"""A virtual X server: what its screen shows, and what a window manager would tell a window."""

from __future__ import annotations

import ctypes
import os
import shutil
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray


@dataclass(frozen=True)
class Display:
    """An X server's number, and the file in which it keeps the screen's pixels."""

    name: str
    pixels: Path

    @property
    def environment(self) -> dict[str, str]:
        """The environment variables that make a process open its windows there."""
        return {"DISPLAY": self.name, "XDG_SESSION_TYPE": "x11", "WAYLAND_DISPLAY": ""}

    def look(self, x: int, y: int, width: int, height: int) -> NDArray[np.uint8]:
        """Return a part of the screen, (height, width, RGB)."""
        content = self.pixels.read_bytes()
        head = struct.unpack(">25I", content[:100])
        start, rows, stride = head[0] + 12 * head[19], head[5], head[12]
        texels = np.frombuffer(content[start : start + rows * stride], np.uint8).reshape(rows, -1, 4)
        return texels[y : y + height, x : x + width, 2::-1]


@contextmanager
def open_display(folder: Path) -> Iterator[Display]:
    """Run an X server of 640×480 pixels; skip the test if there is none."""
    pytest.importorskip("glfw", reason="no GLFW: pip install rhi[viewer]")
    if shutil.which("Xvfb") is None:
        pytest.skip("no X server: apt install xvfb")
    read, write = os.pipe()
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "640x480x24", "-fbdir", str(folder)]
    server = subprocess.Popen(
        command, pass_fds=(write,), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    os.close(write)
    with os.fdopen(read) as answer:
        number = answer.readline().strip()
    if not number:
        server.wait()
        pytest.skip("the X server doesn't start")
    yield Display(f":{number}", folder / "Xvfb_screen0")
    server.terminate()
    server.wait()


class _ClientMessage(ctypes.Structure):
    _fields_ = (
        ("type", ctypes.c_int),
        ("serial", ctypes.c_ulong),
        ("sent", ctypes.c_int),
        ("display", ctypes.c_void_p),
        ("window", ctypes.c_ulong),
        ("kind", ctypes.c_ulong),
        ("format", ctypes.c_int),
        ("data", ctypes.c_long * 5),
        ("rest", ctypes.c_long * 24),
    )


class WindowManager:
    """Says to windows what a window manager says, through a connection of its own to `DISPLAY`."""

    def __init__(self) -> None:
        self._x = ctypes.CDLL("libX11.so.6")
        for name in ("XOpenDisplay", "XInternAtom", "XDefaultRootWindow"):
            getattr(self._x, name).restype = ctypes.c_void_p
        self._display = ctypes.c_void_p(self._x.XOpenDisplay(None))

    def _atom(self, name: str) -> ctypes.c_ulong:
        return ctypes.c_ulong(self._x.XInternAtom(self._display, name.encode(), 0))

    def _sync(self) -> None:
        self._x.XSync(self._display, 0)

    def minimise(self, window: int, minimised: bool) -> None:
        """Mark a window as minimised, or as shown again."""
        state, value = self._atom("WM_STATE"), (ctypes.c_long * 2)(3 if minimised else 1, 0)
        self._x.XChangeProperty(self._display, ctypes.c_ulong(window), state, state, 32, 0, value, 2)
        self._sync()

    def ask_to_close(self, window: int) -> None:
        """Do what the button for closing does."""
        message = _ClientMessage(type=33, window=window, format=32, kind=self._atom("WM_PROTOCOLS").value)
        message.data[0] = self._atom("WM_DELETE_WINDOW").value
        self._x.XSendEvent(self._display, ctypes.c_ulong(window), 0, ctypes.c_long(0), ctypes.byref(message))
        self._sync()

    def set_density(self, dots_per_inch: int) -> None:
        """Set the density that windows opened from now on scale by; 96 is 1."""
        text = f"Xft.dpi:\t{dots_per_inch}\n".encode()
        root = ctypes.c_ulong(self._x.XDefaultRootWindow(self._display))
        string = ctypes.c_ulong(31)
        manager: Any = self._atom("RESOURCE_MANAGER")
        self._x.XChangeProperty(self._display, root, manager, string, 8, 0, text, len(text))
        self._sync()
