"""Hot reload in a viewer: what is saved while it runs takes effect between two of its frames.

- **Modules of shaders**, the renderer's and the program's, are exchanged by `rhi.Reloader`. A frame is tried
  after it, which isn't shown: if it can't be drawn, the texts before come back. At a start these are from the
  cache, and if no viewer can be made, they come back as well (`open_viewer`).
- **The scene's files**, if it is a model file with its buffers, materials and textures: the scene is read and
  uploaded beside the old one, and takes its place once a frame of it could be drawn. A texture that is
  missing is waited for.
- **The settings** that were read last.

Scenes that a line names are loaded by a thread (`renderer.viewer.scene_loading`); one whose files were saved is read
between two frames.

A failure is shown in the frame for as long as the file is faulty, and the last good version keeps drawing.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from traceback import extract_tb
from typing import Final

from renderer import rules
from renderer.content import GENERATORS, BackgroundLoad, change_options, load_scene
from renderer.light_kinds import LIGHT_KINDS
from renderer.scene import Scene
from renderer.scene.files import parse_path
from renderer.settings import RenderSettings
from renderer.viewer.command_table import Parameter, ViewerCommand
from renderer.viewer.commands import output_path, parse_number, switch
from renderer.viewer.scene_loading import SceneLoading
from renderer.viewer.session import ViewerSession
from rhi import Reloader, RhiError, ShaderError

_COUNTS: Final = {
    "bazaar": "instances",
    "glass": "panes",
    "terrain": "trees",
}  # other generators have `count`
LOGGER: Final = logging.getLogger("rhi.reload")


class FileReloader:
    """Exchanges what a session draws with when its files are saved.

    Attributes:
        wake: called by another thread when a file was saved, so that a frame is drawn soon.
        loading: the scene that `open_scene` loads.
        patience: the seconds that `open_scene` waits for it; None: until it is loaded.
    """

    def __init__(self, session: ViewerSession, show_message: Callable[[str, bool], None]) -> None:
        """`show_message` is told what is exchanged, and what is wrong."""
        self.wake: Callable[[], object] = lambda: None
        self.loading = SceneLoading()
        self.patience: float | None = None
        self._session = session
        self._say = show_message
        self._settings: Path | None = None
        self._reloader: Reloader | None = None

    @property
    def is_watching(self) -> bool:
        """True if files are watched."""
        return self._reloader is not None

    @property
    def faults(self) -> list[str]:
        """Lines about the files that are at fault."""
        errors = () if self._reloader is None else self._reloader.errors.values()
        return [line for error in errors for line in describe_fault(error).splitlines()]

    def watch(self, on: bool) -> None:
        """Watch the files, or don't.

        Raises:
            ValidationError: `reload-watch`: watchfiles is missing.
        """
        if not on:
            self._stop_watching()
        elif self._reloader is None:
            device = self._session.renderer.device
            reloader = Reloader(device, on_error=self._report, on_save=lambda: self.wake())
            try:
                reloader.watch_shaders()
                self._reloader = reloader
                self._watch_files()
            except BaseException:
                self._stop_watching()
                raise

    def open_scene(self, text: str) -> str:
        """Load and show the scene that a text names, or the present one with other options (`lights=300`), as
        `show_scene` does; return its whole text, or what is being loaded if that takes longer than `patience`.
        `update` then shows it.

        Raises:
            RhiError: what is wrong with it. Then the present one stays.
        """
        self.loading.follow(BackgroundLoad(change_options(self._session.scene.name, text)), self.show_scene)
        return self.loading.wait(self.patience)

    def change_scene(self, text: str) -> str:
        """Do what `open_scene` does, before this returns.

        Raises:
            RhiError: what is wrong with it. Then the present one stays.
        """
        return self.show_scene(load_scene(change_options(self._session.scene.name, text)))

    def show_scene(self, scene: Scene) -> str:
        """Show a scene, from its first view, or from here if it is the present one with other options; return its
        whole text.

        Raises:
            RhiError: what refuses to draw it. Then the present one stays.
        """
        session, before = self._session, self._session.scene.name
        session.exchange(scene)
        if scene.name.partition(":")[0] != before.partition(":")[0]:
            session.begin_at(next(iter(scene.views.values())))
        self._watch_files()
        return scene.name

    def read_settings(self, path: Path) -> None:
        """Draw with the settings of a file, and with what is saved to it later.

        Raises:
            ValidationError: what is wrong with it. Then all stays.
        """
        self._session.change(settings=RenderSettings.load(path))
        self._settings = path.resolve()
        self._watch_files()

    def note_settings(self, path: Path) -> None:
        """Draw with what is saved to a file of settings later; they are those of now."""
        self._settings = path.resolve()
        self._watch_files()

    def update(self) -> None:
        """Show the scene that has been loaded, and exchange what was saved. Call it between two frames."""
        try:
            message, is_error = self.loading.update(), False
        except Exception as error:  # also of a library that reads files
            message, is_error = describe_fault(error), True
        if message:
            self._say(message, is_error)
        reloader = self._reloader
        if reloader is None:
            return
        before = reloader.exchanged
        try:
            is_changed = reloader.update()
        except RhiError as error:  # a module that was imported can't be watched
            self._report(error)
            return
        if not is_changed:
            return
        try:
            self._session.draw_hidden_frame()
        except Exception as error:  # also of Python that has read a constant of a module of shaders
            if reloader.roll_back(error):
                return
        if reloader.exchanged > before:
            self._say(f"exchanged {reloader.exchanged - before} programs", False)

    def roll_back(self, error: Exception) -> bool:
        """Use the texts of shaders of the last checkpoint again, if these are watched and `error` may be theirs;
        return whether any were exchanged (`Reloader.roll_back`)."""
        return self._reloader is not None and self._reloader.roll_back(error)

    def remember_shaders(self) -> None:
        """Keep the texts of shaders that a frame was just drawn with, for a start at which they are at
        fault."""
        if self._reloader is not None:
            self._reloader.checkpoint()

    def close(self) -> None:
        """Stop loading and watching."""
        self.loading.cancel()
        self._stop_watching()

    def _stop_watching(self) -> None:
        if self._reloader is not None:
            self._reloader.close()
            self._reloader = None

    def _watch_files(self) -> None:
        reloader = self._reloader
        if reloader is None:
            return
        files = [path for path in self._session.scene.files if path.parent.is_dir()]
        reloader.watch(*files, reload=self._read_scene, missing_ok=True)
        if self._settings is not None:
            reloader.watch(self._settings, reload=self._read_saved_settings)

    def _read_scene(self, path: Path) -> None:
        if path in (
            scene_file.resolve() for scene_file in self._session.scene.files
        ):  # which may be those of another scene by now
            self.change_scene(self._session.scene.name)
            self._say(f"read {path.name} again", False)

    def _read_saved_settings(self, path: Path) -> None:
        if path == self._settings:
            self._session.change(settings=RenderSettings.load(path))
            self._say(f"read {path.name} again", False)

    def _report(self, error: Exception) -> None:
        text = describe_fault(error)
        LOGGER.error("%s", text)
        self._say(text, True)


def describe_fault(error: Exception) -> str:
    """Describe an error: of a shader with its file and line, of Python with the line that has failed."""
    if isinstance(error, ShaderError):
        return str(error)
    if isinstance(error, RhiError):
        return rules.describe(error)
    lines = [f"{type(error).__name__}: {error}"]
    lines += [
        f"  {frame.filename}:{frame.lineno}\n    {frame.line}"
        for frame in extract_tb(error.__traceback__)[-1:]
    ]
    return "\n".join(lines)


def make_commands(file_reloader: FileReloader, session: ViewerSession) -> Iterator[ViewerCommand]:
    """Yield the commands for files that may change."""
    summary = "reload shaders, the scene and settings when their files are saved"
    yield switch("reload", summary, lambda: file_reloader.is_watching, file_reloader.watch)

    summary = "show another scene, or this one with other options: lights=300"
    yield ViewerCommand(
        "scene", summary, file_reloader.open_scene, (Parameter("TEXT", words=lambda: GENERATORS),)
    )

    def lights(number: int | None = None) -> str:
        if number is not None:
            file_reloader.change_scene(f"lights={number}")
        session.draw_hidden_frame()  # which finds what reaches objects
        lights, (effects, _) = session.scene.lights, session.renderer.plan(session.camera)
        kinds = ", ".join(f"{len(lights.of_kind(kind))} {kind.name}" for kind in LIGHT_KINDS)
        in_view = f"of the last two {effects.local_lights_in_view} reach what is in view"
        return f"{len(lights)} lights: {kinds}; {in_view}"

    numbers = (Parameter("NUMBER", parse_number, is_optional=True),)
    yield ViewerCommand("lights", "show the scene with this many lights, or count them", lights, numbers)

    def show_objects(number: int | None = None) -> str:
        if number is not None:
            option = _COUNTS.get(session.scene.name.partition(":")[0], "count")
            file_reloader.change_scene(f"{option}={number}")
        objects = session.scene.objects
        return f"{len(objects.node)} objects, {int(objects.is_shown.sum())} of them not hidden"

    yield ViewerCommand(
        "objects", "show the scene with this many objects, or count them", show_objects, numbers
    )

    def settings(path: Path) -> str:
        file_reloader.read_settings(path)
        return f"read {path}: {session.display.describe()}"

    yield ViewerCommand(
        "settings", "draw with the settings of a file", settings, (Parameter("FILE.json", parse_path),)
    )

    def save(_: str, path: Path) -> str:
        path = output_path(session, "save settings", path, ".json")
        session.display.settings.save(path)
        file_reloader.note_settings(path)
        return f"wrote {path}"

    parameter = Parameter("settings", words=lambda: ("settings",), is_exhaustive=True)
    yield ViewerCommand(
        "save", "write the settings to a file", save, (parameter, Parameter("FILE.json", parse_path))
    )
