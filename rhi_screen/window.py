"""A canvas of rendercanvas in a window of GLFW, with an OpenGL context of its own, or with none.

- rendercanvas's own GLFW canvas shows images through wgpu. With a context, this one needs OpenGL only, and a
  `gl` device beside it shows images without a copy through the CPU. Without one, a `wgpu` device does so.
- What a frame costs here: a blit to the back buffer and a swap. Bitmaps are uploaded to one texture, once,
  and shown in the same way.
- The size is asked for at each tick, right before the draw, so a frame is drawn in the size that the window
  has then. A frame that the window outran is scaled, and another one is requested.
- A minimised window and one without pixels draw nothing. A closed one ignores what is shown.
- GLFW isn't terminated: devices that outlive their window still have contexts on its connection to the
  display. The system closes it at the process's end.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, ClassVar, Final

import glfw
import numpy as np
from numpy.typing import NDArray
from rendercanvas.asyncio import loop
from rendercanvas.base import BaseCanvasGroup, BaseRenderCanvas
from rendercanvas.contexts import BaseContext
from rendercanvas.glfw import get_glfw_present_info

import rhi
from rhi.errors import DeviceError, Rule
from rhi_screen.glfw_gamepads import GlfwGamepads
from rhi_screen.input import WindowInput
from rhi_screen.monitors import FullScreenState, Monitor
from rhi_screen.rules import SCREEN_DISPLAY, SCREEN_DRIVER

__all__ = ["Window", "WindowFrames", "loop"]

_CALL: Final = "rhi_screen.open_canvas('window')"

CURSORS: Final = {
    "text": glfw.IBEAM_CURSOR,
    "crosshair": glfw.CROSSHAIR_CURSOR,
    "pointer": glfw.POINTING_HAND_CURSOR,
    "ew-resize": glfw.RESIZE_EW_CURSOR,
    "ns-resize": glfw.RESIZE_NS_CURSOR,
    "nesw-resize": glfw.RESIZE_NESW_CURSOR,
    "nwse-resize": glfw.RESIZE_NWSE_CURSOR,
    "not-allowed": glfw.NOT_ALLOWED_CURSOR,
}


class WindowFrames(BaseContext):  # type: ignore[misc]  # rendercanvas has no types
    """Shows what a device beside a window has blitted to it."""

    present_methods: ClassVar = ["screen"]

    def __init__(self, present_info: dict[str, Any]) -> None:
        super().__init__(present_info)
        self._swap = present_info["swap"]
        self._drawn = False

    def show_frame(self) -> None:
        """Note that an image is in the back buffer."""
        self._drawn = True

    def _rc_present(self, *, force_sync: bool = False) -> dict[str, str]:
        if not self._drawn:
            return {"method": "skip"}
        self._drawn = False
        self._swap()
        return {"method": "screen"}

    def _rc_close(self) -> None:
        self._swap = lambda: None


class Window(BaseRenderCanvas):  # type: ignore[misc]
    """A window with OpenGL. Its options are those of `rendercanvas.BaseRenderCanvas`.

    Attributes:
        FRAMES: the class of the context for devices that `open_device` has created.
        gamepad_source: reads the controllers that GLFW knows.
        on_poll: is called whenever the window's events are taken, whether or not it draws.
    """

    _rc_canvas_group = BaseCanvasGroup(loop)
    FRAMES: ClassVar = WindowFrames

    def __init__(self, *arguments: Any, opengl: bool = True, **options: Any) -> None:
        """Open the window.

        Args:
            opengl: whether it has an OpenGL context; without one, it shows what wgpu draws to its surface.

        Raises:
            DeviceError: `screen-display` without a display, `screen-driver` without OpenGL.
        """
        self._window: Any = None
        self._uploads: rhi.Device | None = None
        self._bitmap: rhi.Texture | None = None
        self._cursor: Any = None
        self._opengl = opengl
        window = _open_window(opengl)
        try:
            super().__init__(*arguments, **options)
        except BaseException:
            glfw.destroy_window(window)
            raise
        self._window = window
        self._input = WindowInput(window, self.submit_event, self._measure_pixel)
        self._full_screen = FullScreenState(window, glfw)
        self.gamepad_source = GlfwGamepads()
        self.on_poll: Callable[[], object] | None = None
        for listen in (
            glfw.set_framebuffer_size_callback,
            glfw.set_window_content_scale_callback,
            glfw.set_window_refresh_callback,
        ):
            listen(window, self._on_change)
        glfw.set_window_iconify_callback(window, self._on_iconify)
        self._measure()
        self._final_canvas_init()
        if opengl:
            glfw.make_context_current(window)
            glfw.swap_interval(0)
            glfw.swap_buffers(window)  # while it is hidden: the first back buffer has the size from before
            glfw.swap_interval(1 if self._vsync else 0)
        glfw.show_window(window)
        self._measure()

    def open_device(self, **options: Any) -> rhi.Device:
        """Create a `gl` device beside the window's context, whose `present` shows an image here."""
        glfw.make_context_current(self._window)
        return rhi.create_device("gl", context="current", **options)

    @property
    def is_full_screen(self) -> bool:
        """True if the window fills a monitor. Setting it fills the monitor that shows most of the window; back,
        it has its old position and size."""
        return self.full_screen_monitor is not None

    @is_full_screen.setter
    def is_full_screen(self, full: bool) -> None:
        if self._window is None or full == self.is_full_screen:
            return
        (self._full_screen.enter if full else self._full_screen.leave)()
        self._on_change()

    @property
    def monitors(self) -> list[Monitor]:
        """The connected monitors, the primary one first."""
        return self._full_screen.monitors if self._window is not None else []

    @property
    def full_screen_monitor(self) -> int | None:
        """The number of the monitor that the window fills, an index of `monitors`; None if it fills none."""
        return self._full_screen.monitor if self._window is not None else None

    def fill_monitor(self, number: int) -> None:
        """Fill the monitor `monitors[number]`, also from another one."""
        if self._window is not None:
            self._full_screen.enter(number)
            self._on_change()

    # -- sizes ---------------------------------------------------------------------------------------------

    def _measure(self) -> None:
        """Ask for the window's size and scale now; if they have changed, request a draw."""
        size = glfw.get_framebuffer_size(self._window)
        ratio = glfw.get_window_content_scale(self._window)[0]
        if (size, ratio) != (self._size_info["physical_size"], self._size_info["native_pixel_ratio"]):
            self._size_info.set_physical_size(*size, ratio)
            self.request_draw()

    def _measure_pixel(self) -> float:
        """Return the number of logical pixels in a unit of the window's coordinates: some systems count them,
        others physical ones."""
        units = max(glfw.get_window_size(self._window)[0], 1)
        return float(self._size_info["physical_size"][0] / units / self.get_pixel_ratio())

    def _on_change(self, *_: Any) -> None:
        self._measure()
        self.request_draw()  # also if parts of the window were uncovered

    def _on_iconify(self, _window: Any, minimised: int) -> None:
        self._set_visible(not minimised)

    # -- what rendercanvas calls ---------------------------------------------------------------------------

    def _rc_gui_poll(self) -> None:
        if self._window is None:
            return
        glfw.poll_events()
        if glfw.window_should_close(self._window):
            self.close()
            return
        self._measure()
        if self.on_poll is not None:
            self.on_poll()

    def _rc_get_present_info(self, present_methods: list[str]) -> dict[str, Any] | None:
        if not self._opengl:
            return get_glfw_present_info(self._window) if "screen" in present_methods else None
        if "bitmap" in present_methods:
            return {"method": "bitmap", "formats": ["rgba-u8"]}
        return {"method": "screen", "swap": self._swap}

    def _rc_request_paint(self) -> None:
        self._time_to_paint()

    def _rc_present_bitmap(self, *, data: NDArray[np.uint8], format: str, **_: Any) -> None:
        if self._window is None:
            return
        if self._uploads is None:
            self._uploads = self.open_device()
        height, width = data.shape[:2]
        if self._bitmap is None or self._bitmap.size != (width, height):
            if self._bitmap is not None:
                self._bitmap.destroy()
            self._bitmap = self._uploads.texture((width, height), rhi.Format.RGBA8, label="bitmap")
        self._bitmap.write(data)
        self._uploads.present(self._bitmap)
        self._swap()

    def _swap(self) -> None:
        if self._window is None:
            return
        glfw.make_context_current(self._window)  # GLFW doesn't know that a device made it current
        glfw.swap_buffers(self._window)
        self._measure()

    def _rc_set_logical_size(self, width: float, height: float) -> None:
        if self._window is not None:
            units = [round(length / self._measure_pixel()) for length in (width, height)]
            glfw.set_window_size(self._window, *(max(length, 1) for length in units))
            self._measure()

    def _rc_close(self) -> None:
        if self._window is None:
            return
        if self._uploads is not None:
            self._uploads.close(quiet=True)
        window, self._window = self._window, None
        glfw.destroy_window(window)
        glfw.poll_events()  # or X keeps it on the screen until somebody does

    def _rc_get_closed(self) -> bool:
        return self._window is None

    def _rc_set_title(self, title: str) -> None:
        if self._window is not None:
            glfw.set_window_title(self._window, title)

    def _rc_set_cursor(self, cursor: str) -> None:
        if self._window is None:
            return
        hidden = cursor == "none"
        glfw.set_input_mode(self._window, glfw.CURSOR, glfw.CURSOR_HIDDEN if hidden else glfw.CURSOR_NORMAL)
        created: Any = glfw.create_standard_cursor(CURSORS[cursor]) if cursor in CURSORS else None
        glfw.set_cursor(self._window, created)
        if self._cursor is not None:
            glfw.destroy_cursor(self._cursor)
        self._cursor = created


def _open_window(opengl: bool) -> Any:
    """Open a hidden window with a context of EGL, or else of the system's other interface; or without one.

    EGL first: a process that has used EGL on a thread, as devices without a window do, can't use GLX there.
    """
    with warnings.catch_warnings(record=True) as messages:
        warnings.simplefilter("always")  # GLFW's errors
        if not glfw.init():
            raise _unavailable(SCREEN_DISPLAY, messages)
        for interface in (glfw.EGL_CONTEXT_API, glfw.NATIVE_CONTEXT_API) if opengl else (None,):
            glfw.default_window_hints()
            glfw.window_hint(glfw.VISIBLE, False)
            glfw.window_hint(glfw.DEPTH_BITS, 0)
            glfw.window_hint(glfw.STENCIL_BITS, 0)
            if interface is None:
                glfw.window_hint(glfw.CLIENT_API, glfw.NO_API)
            else:
                glfw.window_hint(glfw.CONTEXT_CREATION_API, interface)
            window = glfw.create_window(64, 64, "rhi", None, None)
            if window:
                return window
        raise _unavailable(SCREEN_DRIVER, messages)


def _unavailable(rule: Rule, message: list[warnings.WarningMessage]) -> DeviceError:
    reasons = dict.fromkeys(str(warning.message).strip() for warning in message)
    return DeviceError(rule, _CALL, "; ".join(reasons))
