"""Names that files give to several things, told apart."""

from __future__ import annotations

from collections.abc import Container


class UniqueNames:
    """Names for things of which several may have the same name in a file.

    The second `door` is `door'`, those after it are `door'3`, `door'4`. A name takes as long as it is long,
    however many are alike.
    """

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}

    def choose(self, name: str, taken: Container[str]) -> str:
        """Return the first of `name`, `name'`, `name'3`, … that isn't `taken`."""
        count, free = self._counts.get(name, 1), name
        while free in taken:
            count += 1
            free = f"{name}'" if count == 2 else f"{name}'{count}"
        self._counts[name] = count
        return free
