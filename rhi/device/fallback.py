"""Imports that fall back: a module of shaders that can't be imported is as it was drawn with last.

    rhi.install_fallback()       # before modules of shaders are imported
    import shaders

- Python's own loader runs a module's file. If that fails, modules of shaders that have changed get the texts that
  `Reloader.keep` has kept (`Reloader.put_back`), because the module may miss a name of one of them, and the module is
  run with its own, if one was kept.
- The shading language knows which text is in effect (`text_of`). A `Reloader` that watches the module sees that its
  file has another one, and takes that or says what is wrong with it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType
from typing import Any

from rhi.device.reloading import LOGGER, Reloader, read_texts
from rhi.shading.language.modules import execute
from rhi.shading.language.source import SourceFile, exchange_source


def install_fallback() -> None:
    """Let modules that are imported from now on fall back: one that can't be, because it or a module of shaders that it
    imports has a fault, takes the text that `Reloader.keep` has kept of that, and a warning says so.

    Without such a text the import fails as it would.
    """
    sys.meta_path.insert(sys.meta_path.index(PathFinder), FallbackFinder)


class FallbackFinder(PathFinder):
    """Finds what Python's own finder of files does."""

    @classmethod
    def find_spec(cls, name: str, path: Sequence[str] | None = None, target: Any = None) -> ModuleSpec | None:
        """Return a module's spec, whose loader falls back if it is a file of Python."""
        spec = super().find_spec(name, path, target)
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
            vars(module).clear()
            vars(module).update(names)
            text = read_texts().get(self.path)
            if not Reloader(on_error=repr).put_back(error) and text is None:
                raise
            with suppress(Exception):  # the first error counts
                if text is None:
                    super().exec_module(module)
                else:
                    source = SourceFile(self.path)
                    source.lines, source.spec = text.splitlines(keepends=True), module.__spec__
                    exchange_source(source)
                    execute(f"import of {module.__name__}", source, text, module, module)
                LOGGER.warning("%s: shaders are as they were drawn with last: %r", self.path, error)
                return
            raise
