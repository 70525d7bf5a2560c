"""Imports with a fallback: if a shader module can't be imported, its last text that drew a frame is used.

    rhi.install_fallback()       # before modules of shaders are imported
    import shaders

- Python's own loader runs a module's file. If that fails, changed shader modules get the texts that
  `Reloader.checkpoint` saved (`Reloader.roll_back`), because the module may miss a name of one of them. Then
  the module runs with its own saved text, if there is one.
- The shading language knows which text is in effect (`text_of`). A `Reloader` that watches the module sees
  that its file has another text, and loads it or reports its error.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType
from typing import Any

from rhi.device.reloading import LOGGER, Reloader, load_checkpoint
from rhi.shading.language.modules import execute
from rhi.shading.language.source import SourceFile, exchange_source


def install_fallback() -> None:
    """Make later imports fall back. If a module can't be imported, because it or a shader module that it
    imports has a fault, the text that `Reloader.checkpoint` saved of the faulty one is used, with a warning.

    Without a saved text the import fails as usual.
    """
    sys.meta_path.insert(sys.meta_path.index(PathFinder), FallbackFinder)


class FallbackFinder(PathFinder):
    """A finder that wraps Python's own file finder."""

    @classmethod
    def find_spec(cls, name: str, path: Sequence[str] | None = None, target: Any = None) -> ModuleSpec | None:
        """Return a module's spec; for a Python file its loader is a `FallbackLoader`."""
        spec = super().find_spec(name, path, target)
        if spec is not None and type(spec.loader) is SourceFileLoader:
            spec.loader = FallbackLoader(spec.loader.name, spec.loader.path)
        return spec


class FallbackLoader(SourceFileLoader):
    """Runs a module's file or, if that fails, its saved text."""

    def exec_module(self, module: ModuleType) -> None:
        """Run the module."""
        names = dict(vars(module))
        try:
            super().exec_module(module)
        except Exception as error:
            saved = load_checkpoint()
            text = saved.get(self.path)
            # Packages look for others that may be missing: such a failure is no shader's.
            concerns_shaders = text is not None or any(file in saved for file in _list_files(module, error))
            vars(module).clear()
            vars(module).update(names)
            if not concerns_shaders or (not Reloader(on_error=repr).roll_back(error) and text is None):
                raise
            with suppress(Exception):  # the first error counts
                if text is None:
                    super().exec_module(module)
                else:
                    source = SourceFile(self.path)
                    source.lines, source.spec = text.splitlines(keepends=True), module.__spec__
                    exchange_source(source)
                    execute(f"import of {module.__name__}", source, text, module, module)
                LOGGER.warning(
                    "%s: the shaders of the last successful draw stay in use: %r", self.path, error
                )
                return
            raise


def _list_files(module: ModuleType, error: Exception) -> Iterator[str]:
    """Yield the files of the modules that a failed import has to do with: the one in which it misses a name, and
    those from which it has names."""
    yield str(getattr(error, "path", None))
    for value in list(vars(module).values()):
        source = (
            value
            if isinstance(value, ModuleType)
            else sys.modules.get(getattr(value, "__module__", None) or "")
        )
        yield str(getattr(source, "__file__", None))
