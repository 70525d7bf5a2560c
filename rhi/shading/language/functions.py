"""The built-in functions as names to import; `functions.pyi` beside this file has their types."""

from __future__ import annotations

from rhi.shading.language.builtins import BUILTINS
from rhi.shading.language.types import LANGUAGE_NAMES

__rhi_internal__ = True

__all__ = list(BUILTINS)
LANGUAGE_NAMES.update(__all__)

globals().update(BUILTINS)
