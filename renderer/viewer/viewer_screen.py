"""A viewer on a screen: in a window, a notebook, a browser page.

Frames are drawn only while something moves, and after each event. While lines may come over a socket, or a scene is
being loaded, ten a second are drawn at least.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from renderer import rules
from renderer.content import BackgroundLoad, load_scene
from renderer.frame import UploadSettings
from renderer.scene import Camera, Scene
from renderer.settings import RenderSettings
from renderer.viewer.command_table import Parameter, ViewerCommand
from renderer.viewer.commands import switch
from renderer.viewer.display_settings import DisplaySettings
from renderer.viewer.scene_loading import make_placeholder
from renderer.viewer.viewer import Viewer
from rhi import Reloader, RhiError, Texture
from rhi.errors import DeviceError
from rhi_screen import Screen, open_screen
from rhi_screen.canvases import get_loop
from rhi_screen.gestures import Event
from rhi_screen.rules import INSTALL, SCREEN_MISSING

if TYPE_CHECKING:
    from renderer.viewer.panel import Panel

_WAITING: Final = 10.0
"""Frames a second, at least, while lines may come over a socket or a scene is being loaded."""
_PATIENCE: Final = 0.1
"""Seconds without a frame in which a scene may be loaded."""


class ViewerScreen:
    """A viewer and the screen that shows it.

    Attributes:
        viewer, screen: these.
        frames: how many frames were shown.
        end_after: how many there are to be, None for no end.
        panel: the panel of settings, scene, statistics and times, while it is open.
    """

    def __init__(self, viewer: Viewer, screen: Screen) -> None:
        """Draw `viewer` to `screen`, which has the same device, and pass it the events of the screen's
        canvas."""
        self.viewer = viewer
        self.screen = screen
        self.frames = 0
        self.end_after: int | None = None
        self.panel: Panel | None = None
        self._is_closed = False
        self._is_listening = False
        self._rate = 0.0
        self._error: Exception | None = None
        viewer.file_reloader.patience = _PATIENCE
        viewer.session.uploads = UploadSettings()
        viewer.session.renderer.show = self._show
        viewer.set_size = self._set_size
        viewer.gamepads = screen.gamepads
        self._add_commands()
        loop = get_loop(screen.canvas)
        if loop is not None:

            def wake() -> None:
                with suppress(AttributeError, RuntimeError):  # of a loop that has ended by now
                    loop.call_soon_threadsafe(screen.canvas.request_draw)

            viewer.file_reloader.wake = wake
        screen.canvas.add_event_handler(self._handle, "*")
        screen.gamepads.add_handler(self._handle)
        screen.canvas.request_draw(self.draw)

    def run(self) -> None:
        """Run the screen's loop until its canvas is closed; an error of `draw` ends it and is raised."""
        self.screen.run(self.draw)

    def follow_load(
        self,
        load: BackgroundLoad,
        begin: Callable[[ViewerScreen], object] | None = None,
        camera: Camera | None = None,
    ) -> None:
        """Show a scene, once it is loaded, from a camera, by default its first view, at the beginning of its time,
        and call `begin` before its first frame. If anything fails, `draw` raises it."""
        reloader, session = self.viewer.file_reloader, self.viewer.session

        def show(scene: Scene) -> str:
            try:
                reloader.show_scene(scene)
            except Exception as error:  # maybe of a shader
                if not reloader.roll_back(error):
                    raise
                reloader.show_scene(scene)
            session.begin_at(camera or next(iter(scene.views.values())))
            session.restart()
            if begin is not None:
                begin(self)
            return ""

        def fail(error: Exception) -> None:
            self._error = error

        reloader.loading.follow(load, show, fail)
        self._request_next()

    def listen(self, port: int, folder: Path | None = None) -> int:
        """Run the lines that come over a socket (`Viewer.listen`); return the port."""
        port = self.viewer.listen(port, folder)
        self._is_listening = True
        self._request_next()
        return port

    def draw(self) -> None:
        """Draw and show a frame; the canvas calls this.

        Raises:
            Exception: why the scene of `follow_load` can't be shown.
        """
        viewer, canvas = self.viewer, self.screen.canvas
        viewer.resize(self.screen.size, canvas.get_pixel_ratio())
        self.screen.gamepads.poll()
        if self.panel is not None:
            self.panel.apply_changes()
        viewer.draw()
        if self._error is not None:
            raise self._error
        self.frames += 1
        if viewer.is_over or self.frames == self.end_after:
            canvas.close()
        else:
            self._request_next()

    def _request_next(self) -> None:
        """Request the next frame if it may differ, and set how long the canvas waits for another reason."""
        viewer, canvas = self.viewer, self.screen.canvas
        rate = _WAITING if self._is_listening or viewer.is_loading else 0.0
        if rate != self._rate:
            self._rate = rate
            canvas.set_update_mode("ondemand", min_fps=rate)
        needs_frame = self.panel is not None and self.panel.needs_frame
        if viewer.is_moving or needs_frame or self.end_after is not None:
            canvas.request_draw()

    def _show(self, image: Texture) -> None:
        """Draw the panel over a frame's image, and show it."""
        if self.panel is not None:
            self.panel.draw(image)
        self.screen.show(image)

    def open_panel(self, on: bool = True) -> None:
        """Open the panel, or close it.

        Raises:
            DeviceError: `screen-missing` without imgui-bundle.
        """
        if on == (self.panel is not None):
            return
        if self.panel is not None:
            panel, self.panel = self.panel, None
            panel.close()
            return
        try:
            from renderer.viewer.panel import Panel
        except ImportError as error:
            raise DeviceError(SCREEN_MISSING, "panel", "imgui-bundle is missing", "", INSTALL) from error
        self.panel = Panel(self.screen, self.viewer)

    def _add_commands(self) -> None:
        """Add the commands that need a screen."""
        add, screen = self.viewer.commands.add, self.screen
        add(
            switch(
                "panel",
                "open a panel with settings, the scene, statistics and times",
                lambda: self.panel is not None,
                self.open_panel,
                is_silent=True,
            )
        )

        def fill(word: str | None = None) -> str:
            if word is not None and word not in _SWITCH:
                screen.fill_monitor(int(word) - 1)
            else:
                screen.is_full_screen = _SWITCH.get(word or "", not screen.is_full_screen)
            return ""

        def list_words() -> list[str]:
            return [*_SWITCH, *(str(number + 1) for number in range(len(screen.monitors)))]

        words = Parameter("on|off|MONITOR", words=list_words, is_exhaustive=True, is_optional=True)
        add(
            ViewerCommand(
                "fullscreen", "fill the monitor of the window or another one, or go back", fill, (words,)
            )
        )

    def _set_size(self, size: tuple[int, int]) -> None:
        """Request so many physical pixels from the canvas. The next frames have the size that it grants."""
        ratio = self.screen.canvas.get_pixel_ratio()
        self.screen.canvas.set_logical_size(*(side / ratio for side in size))

    def close(self) -> None:
        """Destroy the viewer and close the screen. A second call does nothing."""
        if not self._is_closed:
            self._is_closed = True
            self.open_panel(False)
            self.viewer.close()
            self.screen.close()

    def _handle(self, event: Event) -> None:
        self.viewer.handle(event)
        if event["event_type"] not in _SILENT:
            self.screen.canvas.request_draw()


_SWITCH: Final = {"on": True, "off": False}
_SILENT: Final = frozenset({"before_draw", "animate", "close", "pointer_enter"})


def open_viewer(
    scene: Scene | str,
    backend: str | None = None,
    *,
    canvas: str | None = None,
    size: tuple[int, int] = (960, 540),
    display: DisplaySettings | None = None,
    camera: Camera | None = None,
    settings: str | Path | None = None,
    reload: bool = True,
    begin: Callable[[ViewerScreen], object] | None = None,
    **options: Any,
) -> ViewerScreen:
    """Open a screen that shows a scene.

    Args:
        scene: a scene, or the text that names one.
        backend: by default `RHI_BACKEND`, or `gl`.
        canvas: one of `rhi_screen.CANVASES`; by default a widget in a notebook, and else a window.
        size: in logical pixels.
        display, camera: the initial display settings and camera.
        settings: a file of settings instead of the display's (`RenderSettings.load`).
        reload: whether shaders, a scene that was loaded from files, and settings are exchanged when these are
            saved, and shaders that can't be drawn with at the beginning are as they were when a viewer has
            drawn last.
        begin: called before the scene's first frame. With it, a scene that takes long to load is loaded while
            frames show the progress (`ViewerScreen.follow_load`).
        options: those of `rhi_screen.open_screen`.

    Raises:
        DeviceError: what is missing, and what to install.
        RhiError: what is wrong with the scene, if that is known before the first frame.
    """
    load: BackgroundLoad | None = None
    if isinstance(scene, str) and begin is None:
        scene = load_scene(scene)
    elif isinstance(scene, str):
        load = BackgroundLoad(scene)
        loaded = load.wait(_PATIENCE)
        scene, load = (make_placeholder(scene), load) if loaded is None else (loaded, None)
    with ExitStack() as undo:
        if load is not None:
            undo.callback(load.cancel)
        display = display or DisplaySettings()
        if settings is not None:
            display = display.change(settings=RenderSettings.load(Path(settings)))
        backend = backend or os.environ.get("RHI_BACKEND") or "gl"
        title = f"{scene.name} - $fps frames/s"
        screen = open_screen(backend, canvas=canvas, title=title, size=size, **options)
        undo.callback(screen.close)
        make_viewer = partial(Viewer, screen.device, scene, size=screen.size, display=display, camera=camera)
        try:
            viewer = make_viewer()
        except Exception as error:  # maybe of a shader
            if not reload or not Reloader(screen.device).roll_back(error):
                raise
            viewer = make_viewer()
        if settings is not None:
            viewer.file_reloader.note_settings(Path(settings))
        if reload:
            try:
                viewer.file_reloader.watch(True)
            except RhiError as error:  # the image is shown without it
                viewer.show_message(rules.describe(error))
        viewer_screen = ViewerScreen(viewer, screen)
        if load is not None:
            viewer_screen.follow_load(load, begin, camera)
        elif begin is not None:
            begin(viewer_screen)
        undo.pop_all()
    return viewer_screen


def view(scene: Scene | str, backend: str | None = None, **options: Any) -> Any:
    """Show a scene: in a notebook return the widget, else open a window and return when it is closed.

    The arguments are those of `open_viewer`. The device lives as long as the widget.
    """
    viewer_screen = open_viewer(scene, backend, **options)
    canvas = viewer_screen.screen.canvas
    if type(canvas).__name__ == "JupyterRenderCanvas":
        canvas.add_event_handler(lambda _: viewer_screen.close(), "close")
        return canvas
    try:
        viewer_screen.run()
    finally:
        viewer_screen.close()
    return None
