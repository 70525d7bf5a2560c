"""Full screen windows of GLFW: which monitor a window fills, and the rectangle to which it returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

_MARGIN: Final = 64  # units from a monitor's corner, if the monitor of the old rectangle is gone


@dataclass(frozen=True, slots=True)
class Monitor:
    """A monitor of the desktop.

    Attributes:
        name: as the system calls it.
        x, y: its top left corner on the desktop, in the units of window positions.
        width, height: its size in these units.
    """

    name: str
    x: int
    y: int
    width: int
    height: int

    def overlap(self, x: int, y: int, width: int, height: int) -> int:
        """The area that it shares with a rectangle of the desktop."""
        across = min(self.x + self.width, x + width) - max(self.x, x)
        down = min(self.y + self.height, y + height) - max(self.y, y)
        return max(across, 0) * max(down, 0)


class FullScreenState:
    """The full screen state of a window. From one monitor to another, the window keeps its old rectangle."""

    def __init__(self, window: Any, glfw: Any) -> None:
        """`glfw` is the module, or what stands for it in tests."""
        self._window, self._glfw = window, glfw
        self._bounds: tuple[int, int, int, int] = (0, 0, 64, 64)
        self._was_maximized = False
        self._monitor: int | None = None

    @property
    def monitors(self) -> list[Monitor]:
        """The connected monitors, the primary one first."""
        monitors = []
        for handle in self._glfw.get_monitors():
            name, position = self._glfw.get_monitor_name(handle), self._glfw.get_monitor_pos(handle)
            text = name.decode(errors="replace") if isinstance(name, bytes) else str(name)
            monitors.append(Monitor(text, *position, *self._glfw.get_video_mode(handle).size))
        return monitors

    @property
    def monitor(self) -> int | None:
        """The number of the monitor that the window fills, from 0; None if it fills none."""
        if not self._glfw.get_window_monitor(self._window):  # also if its monitor was unplugged
            self._monitor = None
        return self._monitor

    def enter(self, monitor: int | None = None) -> None:
        """Fill a monitor: by its number, or the one that shows most of the window."""
        glfw, window = self._glfw, self._window
        if self.monitor is None:
            self._was_maximized = bool(glfw.get_window_attrib(window, glfw.MAXIMIZED))
            if self._was_maximized:
                glfw.restore_window(window)
            self._bounds = (*glfw.get_window_pos(window), *glfw.get_window_size(window))
        elif monitor is None:
            return
        number = self._nearest_monitor() if monitor is None else monitor
        if number == self._monitor:
            return
        handle = glfw.get_monitors()[number]
        mode = glfw.get_video_mode(handle)
        glfw.set_window_monitor(window, handle, 0, 0, *mode.size, mode.refresh_rate)
        self._monitor = number

    def leave(self) -> None:
        """Return to the rectangle that the window had before it filled a monitor."""
        if self.monitor is None:
            return
        x, y, width, height = self._bounds
        monitors = self.monitors
        if monitors and not any(monitor.overlap(x, y, width, height) for monitor in monitors):
            x, y = monitors[0].x + _MARGIN, monitors[0].y + _MARGIN
        windowed: Any = None
        self._glfw.set_window_monitor(self._window, windowed, x, y, width, height, self._glfw.DONT_CARE)
        self._monitor = None
        if self._was_maximized:
            self._glfw.maximize_window(self._window)

    def _nearest_monitor(self) -> int:
        """The number of the monitor that shows most of the window; the primary one if none does."""
        areas = [monitor.overlap(*self._bounds) for monitor in self.monitors]
        return max(range(len(areas)), key=areas.__getitem__, default=0)
