"""Full screen: which monitor a window fills, and the rectangle to which it returns, with a stand-in for GLFW."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rhi import ValidationError
from rhi_screen.monitors import FullScreenState, Monitor

LEFT, MIDDLE, SMALL = (
    Monitor("left", -1920, 0, 1920, 1080),
    Monitor("middle", 0, 0, 1280, 1024),
    Monitor("small", 1280, 200, 800, 600),
)


class FakeGlfw:
    """A desktop with a window, as far as full screen needs it.

    Attributes:
        handles: the connected monitors, the primary one first.
        bounds: the window's rectangle.
        monitor: the one that the window fills.
    """

    MAXIMIZED, DONT_CARE = 7, -1

    def __init__(self, *monitors: Monitor) -> None:
        self.handles = list(monitors)
        self.bounds = (10, 20, 300, 200)
        self.before = self.bounds
        self.monitor: Monitor | None = None
        self.is_maximized = False

    def get_monitors(self) -> list[Monitor]:
        return list(self.handles)

    def get_monitor_name(self, handle: Monitor) -> bytes:
        return handle.name.encode()

    def get_monitor_pos(self, handle: Monitor) -> tuple[int, int]:
        return handle.x, handle.y

    def get_video_mode(self, handle: Monitor) -> Any:
        return SimpleNamespace(size=(handle.width, handle.height), refresh_rate=60)

    def get_window_monitor(self, _window: object) -> Monitor | None:
        return self.monitor

    def get_window_attrib(self, _window: object, name: int) -> int:
        assert name == self.MAXIMIZED
        return int(self.is_maximized)

    def get_window_pos(self, _window: object) -> tuple[int, ...]:
        return self.bounds[:2]

    def get_window_size(self, _window: object) -> tuple[int, ...]:
        return self.bounds[2:]

    def restore_window(self, _window: object) -> None:
        self.is_maximized, self.bounds = False, self.before

    def maximize_window(self, _window: object) -> None:
        self.is_maximized, self.before, self.bounds = True, self.bounds, (0, 0, 1280, 1024)

    def set_window_monitor(
        self, _window: object, monitor: Monitor | None, x: int, y: int, width: int, height: int, rate: int
    ) -> None:
        assert monitor is None or monitor in self.handles
        self.monitor = monitor
        self.bounds = (x, y, width, height) if monitor is None else (monitor.x, monitor.y, width, height)
        assert rate == (self.DONT_CARE if monitor is None else 60)

    def unplug(self, monitor: Monitor) -> None:
        """Disconnect a monitor: GLFW takes a window off it."""
        self.handles.remove(monitor)
        if self.monitor == monitor:
            self.monitor = None


@pytest.mark.parametrize(
    ("bounds", "nearest"),
    [
        ((10, 20, 300, 200), MIDDLE),
        ((-1900, 20, 300, 200), LEFT),
        ((1400, 300, 300, 200), SMALL),
        ((-200, 20, 300, 200), LEFT),
        ((1180, 300, 300, 200), SMALL),
        ((5000, 5000, 300, 200), MIDDLE),
    ],
)
def test_a_window_fills_the_monitor_that_shows_most_of_it(
    bounds: tuple[int, int, int, int], nearest: Monitor
) -> None:
    glfw = FakeGlfw(MIDDLE, LEFT, SMALL)
    glfw.bounds = bounds
    full_screen = FullScreenState(object(), glfw)
    full_screen.enter()
    assert glfw.monitor == nearest
    assert full_screen.monitors[full_screen.monitor or 0] == nearest
    full_screen.leave()
    assert glfw.monitor is None
    x, y, width, height = glfw.bounds
    if bounds[0] < 5000:
        assert glfw.bounds == bounds
    else:
        assert full_screen.monitors[0].overlap(x, y, width, height), (
            "a window that nobody sees is brought back"
        )


@pytest.mark.parametrize("seed", range(20))
def test_a_window_returns_to_its_rectangle_from_any_walk_over_monitors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    glfw = FakeGlfw(MIDDLE, LEFT, SMALL)
    full_screen = FullScreenState(object(), glfw)
    windowed, maximized = glfw.bounds, False
    for _ in range(60):
        action = rng.choice(["enter", "number", "leave", "move", "maximize"])
        was_full = full_screen.monitor is not None
        if action == "enter":
            full_screen.enter()
            assert glfw.monitor is not None
        elif action == "number":
            number = int(rng.integers(3))
            full_screen.enter(number)
            assert full_screen.monitor == number
            assert glfw.monitor == glfw.handles[number]
            assert glfw.bounds[2:] == (glfw.handles[number].width, glfw.handles[number].height)
        elif action == "leave":
            full_screen.leave()
            assert full_screen.monitor is None
            assert glfw.is_maximized == maximized
            assert (glfw.before if maximized else glfw.bounds) == windowed
        elif not was_full and action == "move":
            if glfw.is_maximized:
                glfw.restore_window(None)
            glfw.bounds = (*rng.integers(0, 700, 2).tolist(), *rng.integers(50, 500, 2).tolist())
            windowed, maximized = glfw.bounds, False
        elif not was_full and not glfw.is_maximized:
            glfw.maximize_window(None)
            maximized = True


def test_a_monitor_that_is_unplugged_ends_full_screen() -> None:
    glfw = FakeGlfw(MIDDLE, LEFT)
    glfw.bounds = (-1000, 100, 300, 200)
    full_screen = FullScreenState(object(), glfw)
    full_screen.enter()
    assert full_screen.monitor == 1
    glfw.unplug(LEFT)
    assert full_screen.monitor is None
    full_screen.enter()
    assert glfw.monitor == MIDDLE
    full_screen.leave()
    assert full_screen.monitors[0].overlap(*glfw.bounds)


def test_canvases_without_a_window_have_no_monitors_and_refuse_to_fill_them() -> None:
    pytest.importorskip("rendercanvas", reason="no rendercanvas: pip install rhi[viewer]")
    from rhi_screen import open_screen

    with open_screen("null", canvas="offscreen", size=(8, 8)) as screen:
        assert (screen.monitors, screen.is_full_screen) == ([], False)
        for misuse in (lambda: screen.fill_monitor(0), lambda: setattr(screen, "is_full_screen", True)):
            with pytest.raises(ValidationError) as caught:
                misuse()
            assert caught.value.rule.id == "screen-window"
