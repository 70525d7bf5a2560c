"""Hot reload: saved edits of shaders and files take effect between two frames of a running program.

    with rhi.Reloader(device) as reloader:
        reloader.watch(shaders, "city.glb", reload=load_scene)
        while running:
            reloader.update()
            draw_frame()

- A thread watches the files (watchfiles). Everything else happens in `update`, on the thread that draws.
- A module of shaders is executed beside the old one and put into the classes that exist
  (`rhi.shading.language.edits`). Programs that it concerns are compiled; those whose texts have changed are
  created anew, all of them, before the first one is exchanged. A `Program` stays the same object: its id
  changes, and what meshes keep for it is dropped.
- Any failure restores everything, and the error is reported. The last good program goes on.
- An edit that compiles may still fail to draw, such as a new binding that the program doesn't pass.
  `roll_back` undoes the latest update.
- Files whose edits depend on each other are exchanged together, if none can be alone.
- Command buffers that have recorded an exchanged program can't be submitted again, as if it were destroyed.
- `checkpoint` saves the texts of shaders that have drawn a frame in the cache. `roll_back` also goes back to
  these, so that a start that fails is tried again. `rhi.device.fallback` imports them where a module fails.
"""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from importlib.util import decode_source
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any, Final, Self

from rhi.contract.descriptors import Id, ProgramDescriptor
from rhi.contract.interrupts import DeferredInterrupts
from rhi.contract.persistence import PersistentDict
from rhi.device.device import Device
from rhi.device.resources.programs import Program, ProgramTable
from rhi.errors import ShaderError, refuse
from rhi.errors.rules import DEVICE_ARGUMENT, PASS_OPEN, RELOAD_WATCH
from rhi.errors.shared_caches import SHARED
from rhi.shading.compile import (
    compile_shader,
    depends_on_module,
    forget_compiled,
    is_compiled,
    is_same,
    restore_compiled,
)
from rhi.shading.language import rules
from rhi.shading.language.edits import Edit, defines_shaders, file_of, pin_program, text_of
from rhi.shading.language.shader import Shader

LOGGER: Final = logging.getLogger("rhi.reload")
_SETTLE: Final = 20
"""Milliseconds without a further change after which changes are taken: editors write a file in several
steps."""


class Reloader:
    """Exchanges shaders and files of a running program when they are saved. Use it in a `with` block, or call
    `close`.

    Attributes:
        devices: the devices whose programs are exchanged.
        reloaded: how many modules and files were exchanged.
        exchanged: how many programs were exchanged.
        errors: the errors of faulty files, the latest last; a file that is exchanged leaves the list.
    """

    def __init__(
        self,
        *devices: Device,
        on_error: Callable[[Exception], object] | None = None,
        on_save: Callable[[], object] | None = None,
    ) -> None:
        """Exchange programs of these devices.

        Args:
            devices: devices of the calling thread.
            on_error: called by `update` with each error. A `ShaderError` has the line in `site`, its text
                says all of it. None: errors go to the logger `rhi.reload`.
            on_save: called when a file was saved, by the thread that watches: to wake a loop that waits for
                events.
        """
        self.devices = devices
        self.reloaded = self.exchanged = 0
        self.errors: dict[Path, Exception] = {}
        self._on_error = on_error or (lambda error: LOGGER.error("%s", error))
        self._on_save = on_save or (lambda: None)
        self._reloads: dict[Path, Callable[[Path], object]] = {}
        self._modules: dict[Path, ModuleType] = {}
        self._latest: dict[ModuleType, str] = {}  # the texts before the latest update
        self._has_untried_edits = False
        self._checkpointed: tuple[int, set[type]] = (0, set())
        self._folders: frozenset[Path] = frozenset()
        self._imported_names: set[str] | None = (
            None  # the names of imported modules, if all of these are watched
        )
        self._imported = 0
        self._lock = threading.Lock()
        self._changed: dict[Path, None] = {}
        self._links: dict[Path, Path] = {}  # from the names of files, which may become links, to the files
        self._stop: threading.Event | None = None
        self._thread: threading.Thread | None = None

    @property
    def error(self) -> Exception | None:
        """The latest error of a file that is still faulty."""
        return next(reversed(self.errors.values()), None)

    def watch(
        self,
        *sources: ModuleType | str | Path,
        reload: Callable[[Path], object] | None = None,
        missing_ok: bool = False,
    ) -> None:
        """Watch modules of shaders, and files for which `reload(path)` is called, by `update`, when they were
        saved.

        An error that `reload` raises is reported like those of shaders. With `missing_ok`, a file may be
        missing as long as its folder is there; it is reloaded when it appears.

        Raises:
            ValidationError: `reload-watch`: watchfiles is missing, or something isn't a file. Then nothing of
                it is watched.
        """
        call = "Reloader.watch"
        reloads, modules, links = dict(self._reloads), dict(self._modules), dict(self._links)
        for source in sources:
            name = Path(file_of(source) if isinstance(source, ModuleType) else source)
            path = links[_unlinked(name)] = name.resolve()
            if not path.is_file() and not (missing_ok and not path.exists() and path.parent.is_dir()):
                refuse(RELOAD_WATCH, call, f"{source!r}, which is no file")
            if isinstance(source, ModuleType):
                pin_program(source)
                reloads[path], modules[path] = partial(self._reload_saved, source), source
            elif reload is None:
                refuse(
                    DEVICE_ARGUMENT,
                    call,
                    f"{source!r} without reload=…",
                    "a module, or a file and a function",
                )
            else:
                reloads[path] = reload
        self._start(
            call, frozenset(path.parent for path in (*reloads, *links))
        )  # editors replace files: folders are watched
        fresh = modules.items() - self._modules.items()
        self._reloads, self._modules, self._links = reloads, modules, links
        if fresh:
            with self._lock:
                self._changed |= {path: None for path, module in fresh if _has_changed(module)}
            self._has_untried_edits = bool(_list_untried_edits())

    def watch_shaders(self) -> None:
        """Watch all modules that define shaders, structs or shader functions, also modules that are imported
        later. It leaves out `rhi` and `__main__`, whose text does more than define things.

        Raises:
            ValidationError: `reload-watch`: watchfiles is missing.
        """
        self._imported_names = set()
        self._watch_imported(self._imported_names)

    def _watch_imported(self, names: set[str]) -> None:
        self._imported = len(sys.modules)
        fresh = {name: module for name, module in list(sys.modules.items()) if name not in names}
        for name, module in list(fresh.items()):
            if getattr(getattr(module, "__spec__", None), "_initializing", False):  # on another thread
                del fresh[name]
                self._imported = -1  # look again
        names.update(fresh)
        modules = [
            module
            for name, module in fresh.items()
            if name.partition(".")[0] not in ("__main__", "rhi") and isinstance(module, ModuleType)
            if defines_shaders(module)
        ]
        self.watch(*(module for module in modules if Path(file_of(module)).is_file()))

    def update(self) -> bool:
        """Exchange what was saved since the last call; return whether anything is new. Call it between two
        frames.

        New is an exchanged module or file, and after `watch` a module that differs from the text of the last
        frame (`checkpoint`), maybe of an earlier process.

        Raises:
            ValidationError: `pass-open` inside a render pass of a device.
        """
        if self._imported_names is not None and len(sys.modules) != self._imported:
            self._watch_imported(self._imported_names)
        is_untried, self._has_untried_edits = self._has_untried_edits, False
        if not self._changed:  # a file that is noted just now is exchanged next time
            return is_untried
        with self._lock:
            changed, self._changed = self._changed, {}
        before = self.reloaded
        self._latest = {}
        for path in changed:
            try:
                self._reloads[path](path)
            except Exception as error:
                self._report(path, error)
            else:
                self.errors.pop(path, None)
                if path.suffix != ".py":
                    self.reloaded += 1
        self._reload_together()
        return is_untried or self.reloaded != before

    def checkpoint(self) -> None:
        """Save the texts of the watched modules that the devices' programs are made of. Call it after a frame
        was drawn with them; it is free while nothing has changed."""
        shaders = {
            shader
            for shader in _programmed_shaders(device._programs for device in self.devices)
            if isinstance(shader, type)
        }
        if (self.reloaded, shaders) != self._checkpointed:
            self._checkpointed = self.reloaded, shaders
            saved = load_checkpoint()
            for module in self._modules.values():
                is_kept = saved.get(file_of(module)) == text_of(module)
                if not is_kept and any(depends_on_module(shader, module) for shader in shaders):
                    saved[file_of(module)] = text_of(module)
            saved.save()

    def roll_back(self, error: Exception) -> bool:
        """Restore the earlier texts of modules; return whether there were any, and they compile.

        It restores the modules that the latest `update` exchanged, and all shader modules that have changed
        since they last drew a frame (`checkpoint`), watched or not. Call it with the `error` of a program
        that compiles, but can't draw the next frame or can't start; the error is reported as theirs.

        Raises:
            ValidationError: `pass-open` inside a render pass of a device.
        """
        self._tables()
        texts, self._latest = _list_untried_edits() | self._latest, {}
        with suppress(Exception):  # `error` counts
            self._exchange(texts)
            for module in texts:
                self._report(Path(file_of(module)).resolve(), error)
            return bool(texts)
        return False

    def reload(self, module: ModuleType, text: str) -> int:
        """Give a module of shaders a new text; return how many programs were exchanged.

        Raises:
            ShaderError: what is wrong with the text. Then nothing has changed.
            ValidationError: `pass-open` inside a render pass of a device.
        """
        return self._exchange({module: text})

    def _exchange(self, texts: Mapping[ModuleType, str]) -> int:
        """Give modules new texts, all or none; return how many programs were exchanged.

        Threads that compile wait until the classes are whole again."""
        with SHARED:
            return self._exchange_alone(texts)

    def _exchange_alone(self, texts: Mapping[ModuleType, str]) -> int:
        tables = self._tables()
        numbers = {
            name: number for number, name in enumerate(list(sys.modules))
        }  # a module comes after those it imports
        edits: list[Edit] = []
        replacements: dict[Any, Any] = {}
        built: list[tuple[ProgramTable, object, Program[...], Id, ProgramDescriptor]] = []

        def is_used(shader: type[Shader]) -> bool:
            return is_compiled(shader) or shader in replacements

        try:
            for module in sorted(texts, key=lambda each: numbers.get(each.__name__, 0)):
                edits.append(Edit(module, texts[module], is_used))
                replacements |= forget_compiled(edits[-1])
            with ExitStack() as creations:
                for device in self.devices:
                    creations.enter_context(device._core.creation())
                for table in tables:
                    for shader, program in table.items():
                        if not isinstance(shader, type) or shader not in replacements:
                            continue
                        if not is_same(compile_shader(shader), replacements, shader):
                            descriptor = table.compile(shader)
                            built.append((table, shader, program, program.build(descriptor), descriptor))
        except BaseException:
            for edit in reversed(edits):
                forget_compiled(edit)
                edit.undo()
            restore_compiled(replacements)
            raise
        changed = {shader for _, shader, *_ in built}
        restore_compiled(
            {
                shader: each
                for shader, each in replacements.items()
                if shader in _programmed_shaders(tables) - changed
            }
        )
        with DeferredInterrupts():
            for table, shader, program, number, descriptor in built:
                program.exchange(number, descriptor)
                table.add(shader, program)
        self.reloaded += len(texts)
        self.exchanged += len(built)
        return len(built)

    def close(self) -> None:
        """Stop watching."""
        self._imported_names = None
        self._end_thread()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _tables(self) -> list[ProgramTable]:
        for device in self.devices:
            device._core.check_ready()
            if device._core.has_open_pass():
                device._core.refuse(PASS_OPEN, "Reloader.reload", "an open render pass")
        return [device._programs for device in self.devices]

    def _reload_saved(self, module: ModuleType, path: Path) -> None:
        text, before = _read(module), text_of(module)
        if text != before:
            self.reload(module, text)
            self._latest[module] = before

    def _reload_together(self) -> None:
        """Exchange all faulty modules at once, if they work together."""
        faulty = {path: module for path, module in self._modules.items() if path in self.errors}
        if len(faulty) > 1:
            before = {module: text_of(module) for module in faulty.values()}
            with suppress(Exception):  # which each has reported
                self._exchange({module: _read(module) for module in faulty.values()})
                self._latest |= before
                self.errors = {path: error for path, error in self.errors.items() if path not in faulty}

    def _report(self, path: Path, error: Exception) -> None:
        self.errors.pop(path, None)
        self.errors[path] = error
        self._on_error(error)

    def _start(self, call: str, folders: frozenset[Path]) -> None:
        """Watch folders, if others are watched now."""
        try:
            import watchfiles
        except ImportError:
            refuse(RELOAD_WATCH, call, "watchfiles is missing", tip='pip install "rhi[viewer]"')
        if folders == self._folders:
            return
        stop = threading.Event()
        changes = watchfiles.watch(
            *sorted(folders),
            stop_event=stop,
            recursive=False,
            step=_SETTLE,
            rust_timeout=100,
            raise_interrupt=False,
            yield_on_timeout=True,
        )
        try:
            next(changes)  # from now on nothing is missed
        except (OSError, RuntimeError) as error:
            refuse(RELOAD_WATCH, call, f"{type(error).__name__}: {error}")
        self._end_thread()  # which has watched other folders until now
        self._folders, self._stop = folders, stop
        self._thread = threading.Thread(target=self._note, args=(changes,), name="rhi reload", daemon=True)
        self._thread.start()

    def _end_thread(self) -> None:
        if self._stop is not None and self._thread is not None:
            self._stop.set()
            self._thread.join()
        self._stop = self._thread = None
        self._folders = frozenset()

    def _note(self, changes: Iterable[set[tuple[Any, str]]]) -> None:
        for lot in changes:
            saved = {_unlinked(Path(name)): Path(name).resolve() for _, name in lot}
            named = [path for link, path in self._links.items() if link in saved or link.resolve() in saved]
            watched = [path for path in (*saved.values(), *named) if path in self._reloads]
            if watched:
                with self._lock:
                    self._changed |= dict.fromkeys(path for path in watched if path.is_file())
                self._on_save()


def _programmed_shaders(tables: Iterable[ProgramTable]) -> set[object]:
    return {shader for table in tables for shader, _ in table.items()}


def _unlinked(name: Path) -> Path:
    """Return the name of a file in the real folder; a file that is a link isn't followed."""
    return name.parent.resolve() / name.name


def _read(module: ModuleType) -> str:
    """Return the text of a module's file as `text_of` does: it ends with the end of a line.

    Raises:
        ShaderError: `shading-text` if the file has bytes that its encoding hasn't.
    """
    content = Path(file_of(module)).read_bytes()
    try:
        text = decode_source(content)
    except (UnicodeDecodeError, SyntaxError) as error:
        call = f"reload of {module.__name__}({file_of(module)})"
        raise ShaderError(rules.TEXT, call, f"{type(error).__name__}: {error}") from error
    return text if text.endswith("\n") else f"{text}\n"


def _has_changed(module: ModuleType) -> bool:
    """Return whether a module's file has another text than the module; `update` says what is wrong with
    one that can't be read."""
    try:
        return _read(module) != text_of(module)
    except (ShaderError, OSError):
        return True


def load_checkpoint() -> PersistentDict:
    """Return the saved texts of shader modules (`Reloader.checkpoint`), by file name."""
    return PersistentDict("texts", 500)


def _list_untried_edits() -> dict[ModuleType, str]:
    """Return the shader modules that differ from their saved texts, with these texts."""
    saved = load_checkpoint()
    return {
        module: saved[file_of(module)]
        for name, module in list(sys.modules.items())
        if name != "__main__" and isinstance(module, ModuleType)
        if file_of(module) in saved and defines_shaders(module) and text_of(module) != saved[file_of(module)]
    }
