"""The public names of a package: the names that its `__init__` imports."""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType


def list_public(namespace: Mapping[str, object]) -> list[str]:
    """Return the names for `__all__` of a package, sorted: all in its namespace but modules and private ones.

    Type checkers don't read such a list. For them a package imports its public names as themselves
    (`from m import A as A`), by which they are exported, too.
    """
    return sorted(
        name
        for name, value in namespace.items()
        if not name.startswith("_") and not isinstance(value, ModuleType)
    )
