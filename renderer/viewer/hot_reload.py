"""Hot reload in a viewer: what is saved while it runs takes effect between two of its frames.

- **Modules of shaders**, the renderer's and the program's, are exchanged by `rhi.Reloader`. A frame is tried after it,
  which isn't shown: if it can't be drawn, the texts before come back. At a start these are from the cache, and if no
  viewer can be made, they come back as well (`open_viewer`).
- **The scene's files**, if it is a model file with its buffers, materials and textures: the scene is read and uploaded
  beside the old one, and takes its place once a frame of it could be drawn. A texture that is missing is waited for.
- **The settings** that were read last.

Whatever fails is said, stays in the picture for as long as the file is at fault, and what was drawn before goes on.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from traceback import extract_tb
from typing import Final

from renderer import rules
from renderer.content import GENERATORS, change_options, load_scene
from renderer.scene.files import parse_path
from renderer.settings import RenderSettings
from renderer.viewer.command_table import Parameter, ViewerCommand
from renderer.viewer.commands import find_file, parse_number, switch
from renderer.viewer.stage import ViewerStage
from rhi import Reloader, RhiError, ShaderError

_COUNTS: Final = {"bazaar": "instances", "glass": "panes", "terrain": "trees"}  # other generators have `count`
LOGGER: Final = logging.getLogger("rhi.reload")


class SavedFiles:
    """Exchanges what a stage draws with when its files are saved.

    Attributes:
        wake: called by another thread when a file was saved, so that a frame is drawn soon.
    """

    def __init__(self, stage: ViewerStage, say: Callable[[str, bool], None]) -> None:
        """`say` is told what is exchanged, and what is wrong."""
        self.wake: Callable[[], object] = lambda: None
        self._stage = stage
        self._say = say
        self._settings: Path | None = None
        self._reloader: Reloader | None = None

    @property
    def is_watching(self) -> bool:
        """Whether files are watched."""
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
            self.close()
        elif self._reloader is None:
            device = self._stage.renderer.device
            reloader = Reloader(device, on_error=self._report, on_save=lambda: self.wake())
            try:
                reloader.watch_shaders()
                self._reloader = reloader
                self._watch_files()
            except BaseException:
                self.close()
                raise

    def show_scene(self, text: str) -> str:
        """Show the scene that a text names, from its first view, or the present one with other options (`lights=300`),
        from here; return its whole text.

        Raises:
            RhiError: what is wrong with it. Then the present one stays.
        """
        stage, before = self._stage, self._stage.scene.name
        stage.exchange(load_scene(change_options(before, text)))
        if stage.scene.name.partition(":")[0] != before.partition(":")[0]:
            stage.camera = next(iter(stage.scene.views.values()))
        self._watch_files()
        return stage.scene.name

    def read_settings(self, path: Path) -> None:
        """Draw with the settings of a file, and with what is saved to it later.

        Raises:
            ValidationError: what is wrong with it. Then all stays.
        """
        self._stage.change(settings=RenderSettings.load(path))
        self._settings = path.resolve()
        self._watch_files()

    def note_settings(self, path: Path) -> None:
        """Draw with what is saved to a file of settings later; they are those of now."""
        self._settings = path.resolve()
        self._watch_files()

    def update(self) -> None:
        """Exchange what was saved. Call it between two frames."""
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
            self._stage.try_frame()
        except Exception as error:  # also of Python that has read a constant of a module of shaders
            if reloader.put_back(error):
                return
        if reloader.exchanged > before:
            self._say(f"exchanged {reloader.exchanged - before} programs", False)

    def keep(self) -> None:
        """Keep the texts of shaders that a frame was just drawn with, for a start at which they are at fault."""
        if self._reloader is not None:
            self._reloader.keep()

    def close(self) -> None:
        """Stop watching."""
        if self._reloader is not None:
            self._reloader.close()
            self._reloader = None

    def _watch_files(self) -> None:
        reloader = self._reloader
        if reloader is None:
            return
        files = [path for path in self._stage.scene.files if path.parent.is_dir()]
        reloader.watch(*files, reload=self._read_scene, missing_ok=True)
        if self._settings is not None:
            reloader.watch(self._settings, reload=self._read_saved_settings)

    def _read_scene(self, path: Path) -> None:
        if path in (one.resolve() for one in self._stage.scene.files):  # which may be those of another scene by now
            self.show_scene(self._stage.scene.name)
            self._say(f"read {path.name} again", False)

    def _read_saved_settings(self, path: Path) -> None:
        if path == self._settings:
            self._stage.change(settings=RenderSettings.load(path))
            self._say(f"read {path.name} again", False)

    def _report(self, error: Exception) -> None:
        text = describe_fault(error)
        LOGGER.error("%s", text)
        self._say(text, True)


def describe_fault(error: Exception) -> str:
    """Return what is wrong: of a shader with its file and line, of Python with the line that has failed."""
    if isinstance(error, ShaderError):
        return str(error)
    if isinstance(error, RhiError):
        return rules.describe(error)
    lines = [f"{type(error).__name__}: {error}"]
    lines += [f"  {one.filename}:{one.lineno}\n    {one.line}" for one in extract_tb(error.__traceback__)[-1:]]
    return "\n".join(lines)


def make_commands(saved: SavedFiles, stage: ViewerStage) -> Iterator[ViewerCommand]:
    """Yield the commands for files that may change."""
    summary = "exchange shaders, the scene and settings when their files are saved"
    yield switch("reload", summary, lambda: saved.is_watching, saved.watch)

    summary = "show another scene, or this one with other options: lights=300"
    yield ViewerCommand("scene", summary, saved.show_scene, (Parameter("TEXT", words=lambda: GENERATORS),))

    def lights(number: int | None = None) -> str:
        if number is not None:
            saved.show_scene(f"lights={number}")
        stage.try_frame()  # which finds what reaches objects
        lights, (needs, _) = stage.scene.lights, stage.renderer.plan(stage.camera)
        kinds = f"{len(lights.directional)} directional, {len(lights.point)} point, {len(lights.spot)} spot"
        return f"{len(lights)} lights: {kinds}; of the last two {needs.lamps_in_view} reach what is in view"

    numbers = (Parameter("NUMBER", parse_number, is_optional=True),)
    yield ViewerCommand("lights", "show the scene with so many lights, or count them", lights, numbers)

    def objects(number: int | None = None) -> str:
        if number is not None:
            saved.show_scene(f"{_COUNTS.get(stage.scene.name.partition(':')[0], 'count')}={number}")
        return f"{len(stage.scene.objects.node)} objects, {int(stage.scene.objects.shown.sum())} of them not hidden"

    yield ViewerCommand("objects", "show the scene with so many objects, or count them", objects, numbers)

    def settings(path: Path) -> str:
        saved.read_settings(path)
        return f"read {path}: {stage.look.describe()}"

    yield ViewerCommand("settings", "draw with the settings of a file", settings, (Parameter("FILE.json", parse_path),))

    def save(_: str, path: Path) -> str:
        path = find_file(stage, "save settings", path, ".json")
        stage.look.settings.save(path)
        saved.note_settings(path)
        return f"wrote {path}"

    what = Parameter("settings", words=lambda: ("settings",), is_closed=True)
    yield ViewerCommand("save", "write the settings to a file", save, (what, Parameter("FILE.json", parse_path)))
