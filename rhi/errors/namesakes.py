"""Namesakes: files in the user's folder that hide one of our packages.

`python -m` looks into the working folder first, and runs a file of that name there. That may be intended, so
it causes a warning, no error. The commands `rhi` and `rhi-renderer` don't look there.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Final

_OURS: Final = Path(__file__).parents[2]


def find_namesake(name: str) -> Path | None:
    """Return the file that `python -m NAME` has run in place of our package of that name, None if there is
    none."""
    spec = getattr(sys.modules.get("__main__"), "__spec__", None)
    if spec is None or spec.origin is None or spec.name.partition(".")[0] != name:
        return None
    path = Path(spec.origin)
    return None if path.is_relative_to(_OURS / name) else path


def warn_of_namesake(name: str, command: str) -> None:
    """Warn if `python -m NAME` has run another file; `command` runs our package wherever it is called."""
    path = find_namesake(name)
    if path is not None:
        text = (
            f"python -m {name} runs {path}, which hides the package {name}: "
            f"{command}, or python -P -m {name}, runs it"
        )
        warnings.warn(text, stacklevel=2)
