"""Kept texts: modules of shaders as they were drawn with last, for a start at which their files are at fault.

    rhi.install_fallback()       # before modules of shaders are imported
    import shaders

- `Reloader.keep` writes the texts that a frame was drawn with to the folder `texts` of the cache, a file for each path
  and content. Those that were used least recently are removed beyond `LIMIT` bytes.
- They are Python, which is run: the folder must be the user's own, and a file's name ends in its keyed checksum
  (`rhi.contract.trust`). A file that it doesn't fit isn't there.
- A module that can't be imported is run with the texts that were kept of it, the latest first. If it misses a name of a
  module of shaders, that one gets its own. What imports but can't be drawn with is exchanged by `Reloader.attempt`.
- The shading language knows which text is in effect (`text_of`). A `Reloader` that watches the module sees that its
  file has another one, and takes that or says what is wrong with it.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from functools import partial
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Final

from rhi.contract import trust
from rhi.shading.compile import is_made_of
from rhi.shading.language.edits import Edit, defines_shaders, file_of, text_of
from rhi.shading.language.modules import execute
from rhi.shading.language.shader import Shader
from rhi.shading.language.source import SourceFile, exchange_source

LIMIT: Final = 8 << 20
"""Bytes of texts that are kept; one that is longer than an eighth of that isn't."""
_TRIED: Final = 4
"""The most texts of a module that are tried: a frame doesn't draw with all shaders of one, so any may have a fault."""
_LOGGER: Final = logging.getLogger("rhi.reload")


def keep_text(module: ModuleType, path: Path, shaders: Collection[type[Shader]]) -> None:
    """Keep the text of a module that is in effect, if one of these compiled shaders is made of it. A folder that can't
    be written to stays as it is."""
    content, folder = text_of(module).encode(), trust.find_cache("texts")
    if folder is None or len(content) > LIMIT // 8:
        return
    kept = folder / f"{_name(path)}.{_name(path, content)}"
    with suppress(OSError):
        if kept.exists():
            os.utime(kept)
        elif any(is_made_of(shader, module) for shader in shaders):
            trust.write_whole(kept, content)
            _trim(folder)


def read_texts(path: Path) -> list[str]:
    """Return the texts that were kept of a module, the latest first."""
    folder, texts = trust.find_cache("texts"), []
    if folder is not None:
        for _, _, file in _list_latest(folder, f"{_name(path)}.*")[:_TRIED]:
            with suppress(OSError):
                content = file.read_bytes()
                if file.suffix == f".{_name(path, content)}":
                    texts.append(content.decode())
    return texts


def install_fallback() -> None:
    """Let modules that are imported from now on fall back: one that can't be, because it or a module of shaders that it
    imports has a fault, takes the text that `Reloader.keep` has kept of that, and a warning says so.

    Without such a text the import fails as it would.
    """
    if not any(isinstance(finder, FallbackFinder) for finder in sys.meta_path):
        sys.meta_path.insert(sys.meta_path.index(PathFinder), FallbackFinder())


class FallbackFinder(MetaPathFinder):
    """Finds what Python's own finder of files does."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return a module's spec, whose loader falls back if it is a file of Python."""
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and type(spec.loader) is SourceFileLoader:
            spec.loader = FallbackLoader(spec.loader.name, spec.loader.path)
        return spec


class FallbackLoader(SourceFileLoader):
    """Runs a module's file, or if that fails, what was kept."""

    def exec_module(self, module: ModuleType) -> None:
        """Run the module."""
        names = dict(vars(module))
        try:
            super().exec_module(module)
        except Exception as error:
            for path, run in self._list_ways(module, error):
                vars(module).clear()
                vars(module).update(names)
                with suppress(Exception):
                    run()
                    _LOGGER.warning("%s is as it was drawn with last: %s: %s", path, type(error).__name__, error)
                    return
            raise

    def _list_ways(self, module: ModuleType, error: Exception) -> Iterator[tuple[str, Callable[[], object]]]:
        """Yield ways to run the module, with the file that each leaves out."""
        for text in read_texts(Path(self.path).resolve()):
            source = SourceFile(self.path)
            source.lines, source.spec = text.splitlines(keepends=True), module.__spec__
            yield self.path, partial(self._run_text, source, text, module)
        blamed = sys.modules.get(error.name or "") if isinstance(error, ImportError) else None
        if blamed is not None and defines_shaders(blamed):
            for text in read_texts(Path(file_of(blamed)).resolve()):
                yield file_of(blamed), partial(self._run_after, blamed, text, module)

    def _run_text(self, source: SourceFile, text: str, module: ModuleType) -> None:
        exchange_source(source)
        execute(f"import of {module.__name__}", source, text, module, module)

    def _run_after(self, blamed: ModuleType, text: str, module: ModuleType) -> None:
        edit = Edit(blamed, text)
        try:
            super().exec_module(module)
        except BaseException:
            edit.undo()
            raise


def _name(path: Path, content: bytes = b"") -> str:
    """Return the checksum of a module's text in its place. Of no text: what the names of all of them begin with."""
    return trust.sign(trust.read_key(), content, str(path))


def _trim(folder: Path) -> None:
    """Remove what was used least recently if there is too much."""
    total = 0
    for _, size, file in _list_latest(folder, "*"):
        total += size
        if total > LIMIT:
            file.unlink(missing_ok=True)


def _list_latest(folder: Path, pattern: str) -> list[tuple[int, int, Path]]:
    """Return when files were used, in ns, their bytes and paths, the latest first."""
    found = []
    for file in folder.glob(pattern):
        with suppress(OSError):  # another process has removed it
            status = file.stat()
            found.append((status.st_mtime_ns, status.st_size, file))
    return sorted(found, reverse=True)
