"""Identifiers in a text: unique, legal, and equal to the Python names wherever possible."""

from __future__ import annotations

from collections.abc import Collection, Hashable


class Names:
    """The names of a scope, unique and stored by key. A child scope avoids the names of its parent."""

    __slots__ = ("_by_key", "_parent", "_taken", "reserved")

    def __init__(self, parent: Names | None = None, reserved: Collection[str] = ()) -> None:
        self.reserved: Collection[str] = parent.reserved if parent is not None else reserved
        self._by_key: dict[Hashable, str] = {}
        self._taken: set[str] = set()
        self._parent = parent

    def get(self, key: Hashable, preferred: str) -> str:
        """Return the name of `key`. If it has none yet, derive one from `preferred`, made legal and
        unique."""
        name = self.find(key)
        if name is None:
            base = self.legal(preferred)
            name, count = base, 1
            while self._is_taken(name):
                count += 1
                name = f"{base.rstrip('_')}_{count}"
            self._by_key[key] = name
            self._taken.add(name)
        return name

    def find(self, key: Hashable) -> str | None:
        """Return the name of `key`, or None."""
        name = self._by_key.get(key)
        return name if name is not None or self._parent is None else self._parent.find(key)

    def _is_taken(self, name: str) -> bool:
        return name in self._taken or (self._parent is not None and self._parent._is_taken(name))

    def legal(self, name: str) -> str:
        """Return the name itself if the language allows it, else a similar legal one."""
        plain = name.encode("ascii", "backslashreplace").decode().replace("\\", "x").strip("_") or "name"
        while "__" in plain:
            plain = plain.replace("__", "_")
        if plain[0].isdigit() or plain.startswith(("gl_", "GL_", "rhi_")):
            return f"x_{plain}"
        return f"{plain}_" if plain in self.reserved else plain
