"""The built-in functions as importable names. Their types are in the stub beside this file,
`functions.pyi`."""

from __future__ import annotations

from rhi.shading.language.builtins import BUILTINS
from rhi.shading.language.types import LANGUAGE_NAMES

__all__ = list(BUILTINS)
LANGUAGE_NAMES.update(__all__)

globals().update(BUILTINS)
