"""A screen: a canvas, and the device whose images it shows."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Final, Self
from weakref import WeakSet

import rhi
from rhi.errors import refuse
from rhi.errors.arguments import ArgumentChecker
from rhi_screen.canvases import Canvas, choose_default_canvas, get_loop, open_canvas
from rhi_screen.gamepads import Gamepads
from rhi_screen.monitors import Monitor
from rhi_screen.rules import SCREEN_ERRORS, SCREEN_IMAGE, SCREEN_WINDOW
from rhi_screen.statistics import FrameCounter
from rhi_screen.surfaces import can_show_on_surface, open_surface
from rhi_screen.targets import ScreenTargets
from rhi_screen.video import VideoWriter

DISPLAY_FORMATS: Final = (rhi.Format.RGBA8, rhi.Format.RGBA8_SRGB)
"""Formats of images that every canvas shows, bit for bit."""

DEFAULT_BACKEND: Final = "web" if sys.platform == "emscripten" else "gl"


class Screen:
    """A canvas with a device whose images it shows. Use it in a `with` block, or call `close`.

    Attributes:
        canvas: a canvas of rendercanvas: `add_event_handler`, `request_draw`, `get_pixel_ratio` and so on.
        device: the device.
        counter: statistics of the frames that were shown.
        gamepads: the game controllers; only a window has some by itself (`Gamepads.source`).
    """

    def __init__(self, canvas: Canvas, device: str | rhi.Device | None = None, **options: Any) -> None:
        """Show images on `canvas`.

        Args:
            canvas: any canvas of rendercanvas.
            device: a backend's name: the device is created, and closed with the screen. "gl" in a window
                draws beside the window's context, "wgpu" to its surface, "web" to that of a canvas element.
                None: "gl", and "web" in a page. Or a device: its images are copied through the CPU, and it
                stays open.
            options: `rhi.create_device`'s.
        """
        device = DEFAULT_BACKEND if device is None else device
        self.canvas = canvas
        self.counter = FrameCounter()
        self.gamepads = Gamepads(getattr(canvas, "gamepad_source", None))
        if hasattr(canvas, "on_poll"):
            canvas.on_poll = self.gamepads.poll
        self._targets: WeakSet[ScreenTargets] = WeakSet()
        self._screenshot_paths: list[Path] = []
        self._video: VideoWriter | None = None
        self._update_mode = "ondemand"
        open_beside = getattr(canvas, "open_device", None)
        self._owned = isinstance(device, str)
        self._beside = device == "gl" and open_beside is not None
        if isinstance(device, rhi.Device):
            self.device = device
        elif self._beside and open_beside is not None:
            self.device = open_beside(**options)
        else:
            self.device = rhi.create_device(device, **options)
        self._on_surface = isinstance(device, str) and can_show_on_surface(canvas, device)
        if self._on_surface:
            open_surface(canvas, self.device)
        else:
            self._context = canvas.get_context(canvas.FRAMES if self._beside else "bitmap")

    @property
    def size(self) -> tuple[int, int]:
        """The (width, height) in physical pixels that the next image should have; at least 1×1."""
        width, height = self.canvas.get_physical_size()
        return max(width, 1), max(height, 1)

    @property
    def pixel_ratio(self) -> float:
        """Physical pixels in a logical one: 2 on a dense display. Positions of events are logical."""
        return float(self.canvas.get_pixel_ratio())

    @property
    def is_full_screen(self) -> bool:
        """True if the window fills a monitor. Setting it fills the monitor that shows most of the window, or
        returns to the window's old position and size.

        Raises:
            ValidationError: `screen-window` for a canvas that is no window.
        """
        return bool(getattr(self.canvas, "is_full_screen", False))

    @is_full_screen.setter
    def is_full_screen(self, full: bool) -> None:
        self._check_window("screen.is_full_screen")
        self.canvas.is_full_screen = full

    @property
    def monitors(self) -> list[Monitor]:
        """The connected monitors, the primary one first; none for a canvas that is no window."""
        return list(getattr(self.canvas, "monitors", ()))

    def fill_monitor(self, number: int) -> None:
        """Fill `monitors[number]` with the window. `is_full_screen = False` returns to its old rectangle.

        Raises:
            ValidationError: `screen-window` for a canvas that is no window, `device-argument` for the number
                of no monitor.
        """
        self._check_window("screen.fill_monitor")
        check = ArgumentChecker("screen.fill_monitor")
        self.canvas.fill_monitor(check.integer("number", number, 0, max(len(self.monitors) - 1, 0)))

    def _check_window(self, call: str) -> None:
        if not hasattr(self.canvas, "is_full_screen"):
            refuse(SCREEN_WINDOW, call, type(self.canvas).__name__, "a window")

    def targets(
        self,
        color: rhi.Format | Sequence[rhi.Format] = rhi.Format.RGBA8,
        depth: rhi.Format | None = None,
        samples: int = 1,
    ) -> ScreenTargets:
        """Return render targets that always have the screen's size (`ScreenTargets`); they are destroyed with
        it."""
        screen_targets = ScreenTargets(self, color, depth, samples)
        self._targets.add(screen_targets)
        return screen_targets

    def screenshot(self, path: str | Path) -> None:
        """Write the next image that is shown to a file (`rhi.Texture.save`), and request a draw."""
        self._screenshot_paths.append(Path(path))
        self.canvas.request_draw()

    def record(self, path: str | Path, fps: float = 30.0) -> VideoWriter:
        """Add all images that are shown from now on to a video, a frame each, until that is closed.

        Meanwhile `run` draws all frames on a canvas without a loop, too, such as offscreen.

        Raises:
            DeviceError: `screen-missing` without PyAV.
        """
        self._video = VideoWriter(path, fps)
        return self._video

    def send(self, kind: str, **fields: Any) -> None:
        """Give the handlers an event now, as if a person had caused it: for tests, and replays.

        Args:
            kind: such as "pointer_down" or "key_down".
            fields: those of rendercanvas's events, such as `x`, `y` in logical pixels, or `key`; others are 0
                or empty.
        """
        rest = {"x": 0.0, "y": 0.0, "button": 0, "buttons": (), "modifiers": (), "touches": {}}
        self.canvas._events.emit({"event_type": kind, **rest, **fields})

    def show(self, image: rhi.Texture) -> None:
        """End the device's frame and show `image`: call it in the canvas's draw function, once.

        The image is shown opaque, and scaled if the canvas has another size. It may be changed or destroyed
        afterwards. On a canvas that was closed nothing is shown.

        Raises:
            ValidationError: `screen-image` if the image isn't a plain 2D texture of `RGBA8` or `RGBA8_SRGB`;
                what `Device.present` refuses.
        """
        if image.format not in DISPLAY_FORMATS or image.kind is not rhi.TextureKind.D2 or image.samples > 1:
            allowed = " or ".join(format.name for format in DISPLAY_FORMATS)
            refuse(SCREEN_IMAGE, "screen.show", repr(image), f"2D, one sample, {allowed}")
        self.counter.add(perf_counter(), process_time())
        paths, self._screenshot_paths = self._screenshot_paths, []
        for path in paths:
            image.save(path)
        if self._video is not None and not self._video.is_closed:
            self._video.add(image)
        if self._beside:
            self.device.present(image)
            self._context.show_frame()
            return
        if self._on_surface:
            self.device.present(None if self.canvas.get_closed() else image)
            return
        texels = image.read()
        self.device.present(image)
        texels[..., 3] = 255
        self._context.set_bitmap(texels)

    def run(
        self, draw: Callable[[], None] | None = None, *, frames: int | None = None, on_error: str = "raise"
    ) -> None:
        """Run the canvas's loop until it is closed; `draw` is called for each frame.

        In a notebook, whose loop runs already, this returns at once; so it does in a page whose Python can't
        wait (no JSPI). A canvas without a loop, such as
        offscreen, draws one frame. While a video is recorded (`record`) it draws as a window would: until it is
        closed, or with the update mode "ondemand" until `draw` requests no further frame.

        Args:
            draw: a function that shows an image; None: the one that was given to the canvas.
            frames: the number of frames that a canvas without a loop draws, recorded or not; others ignore
                it. None: as many as above.
            on_error: "raise": an exception of `draw` ends the loop, and is raised here; "log": rendercanvas
                logs it, and the loop goes on. In a notebook errors are logged.

        Raises:
            ValidationError: `screen-errors` for another `on_error`, `device-argument` for less than 1 frame.
        """
        frames = ArgumentChecker("screen.run").integer_or_none("frames", frames, 1)
        if on_error not in ("raise", "log"):
            refuse(SCREEN_ERRORS, "screen.run(on_error=...)", repr(on_error), '"raise" or "log"')
        loop = get_loop(self.canvas)
        errors: list[Exception] = []
        running = True

        def draw_or_stop() -> None:
            assert draw is not None
            try:
                draw()
            except Exception as error:
                if not running or type(error).__name__ == "DrawCancelled":
                    raise
                errors.append(error)
                if loop is not None:
                    loop.stop()

        self.canvas.request_draw(draw if draw is None or on_error == "log" else draw_or_stop)
        try:
            if loop is None:
                self._draw_without_loop(frames, errors)
            else:
                loop.run()
                wait_until_closed = getattr(self.canvas, "wait_until_closed", None)
                if wait_until_closed is not None:
                    wait_until_closed(errors)
        finally:
            running = False
        if errors:
            raise errors[0]

    def _draw_without_loop(self, frames: int | None, errors: list[Exception]) -> None:
        """Draw so many frames, or those that a window would draw while a video is recorded."""
        canvas, requests = self.canvas, [True]
        request_draw = canvas.request_draw

        def note_request(draw: Callable[[], None] | None = None) -> None:
            requests.append(True)
            request_draw(draw)

        is_steady = self._update_mode != "ondemand"
        canvas.request_draw = note_request
        try:
            drawn = 0
            while not canvas.get_closed() and not errors:
                requests.clear()
                canvas.force_draw()
                drawn += 1
                is_recording = self._video is not None and not self._video.is_closed
                goes_on = is_recording and (is_steady or len(requests) > 0)
                if drawn >= frames if frames is not None else not goes_on:
                    break
        finally:
            del canvas.request_draw

    def close(self) -> None:
        """Close the device, if the screen has created it, and the canvas. A second call does nothing."""
        if self._video is not None:
            self._video.close()
        if self._owned:
            self.device.close()
        for targets in () if self.device.closed else self._targets:
            targets.destroy()
        self.canvas.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if self._owned:
            self.device.close(quiet=kind is not None)
        self.close()


def open_screen(
    device: str | rhi.Device | None = None,
    *,
    canvas: str | None = None,
    title: str = "rhi",
    size: tuple[float, float] | None = None,
    update_mode: str = "ondemand",
    max_fps: float = 60.0,
    vsync: bool = True,
    **options: Any,
) -> Screen:
    """Open a canvas and a device for it.

    Args:
        device: a backend's name, or a device; None: "gl", and "web" in a page.
        canvas: a name of `CANVASES`; None: "html" in a page, "jupyter" in a notebook, else "window".
        title: may contain `$fps` and `$ms`.
        size: in logical pixels, (width, height). None: 960 × 540; in a page, the size of the element.
        update_mode: "ondemand": frames are drawn after `canvas.request_draw()`, resizes and exposures;
            "continuous": `max_fps` times a second; "fastest": without a pause.
        max_fps: the most frames a second, but for "fastest".
        vsync: whether a window's frames wait for the display's refresh.
        options: `rhi.create_device`'s.

    Raises:
        DeviceError: `screen-missing`, `screen-display`, `screen-driver` or `device-driver`, with what to
            install.

    Examples:
        >>> with open_screen("null", canvas="offscreen", size=(64, 48)) as screen:
        ...     screen.show(screen.targets().image)
    """
    kind = canvas or choose_default_canvas()
    window_options = {"opengl": False} if device == "wgpu" and kind == "window" else {}
    opened = open_canvas(
        kind, title=title, size=size, update_mode=update_mode, max_fps=max_fps, vsync=vsync, **window_options
    )
    try:
        screen = Screen(opened, device, **options)
    except BaseException:
        opened.close()
        raise
    screen._update_mode = update_mode
    return screen
