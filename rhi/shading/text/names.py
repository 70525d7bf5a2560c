"""Identifiers in a text: unique, legal, and equal to the Python names wherever possible."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping
from typing import Any


class Names:
    """The names of a scope, unique and stored by key. A child scope avoids the names of its parent."""

    __slots__ = ("_by_key", "_legal", "_parent", "_taken", "reserved")

    def __init__(self, parent: Names | None = None, reserved: Collection[str] = ()) -> None:
        self.reserved: Collection[str] = parent.reserved if parent is not None else reserved
        self._legal: dict[str, str] = parent._legal if parent is not None else {}
        self._by_key: dict[Hashable, str] = {}
        self._taken: set[str] = set()
        self._parent = parent

    def apart(self) -> Names:
        """Return an empty namespace of the same language, such as that of a struct's fields."""
        names = Names(reserved=self.reserved)
        names._legal = self._legal
        return names

    def get(self, key: Hashable, preferred: str) -> str:
        """Return the name of `key`. If it has none yet, derive one from `preferred`, made legal and
        unique."""
        name = self.find(key)
        return name if name is not None else self._reserve(key, self.legal(preferred))

    def get_all(self, preferred: Mapping[Any, str]) -> list[str]:
        """Return the names of several keys. Names that are legal as they are come first, so that none of them
        is taken by a similar one."""
        legal = [self.legal(name) for name in preferred.values()]
        if legal != list(preferred.values()):
            for key, name, text in zip(preferred, preferred.values(), legal, strict=True):
                if name == text:
                    self.get_legal(key, text)
        return list(map(self.get_legal, preferred, legal))

    def get_outer(self, key: Hashable, preferred: str) -> str:
        """Return the name of `key` in the outermost scope; no scope from there to this one has it already."""
        name = self.find(key)
        return name if name is not None else self._reserve(key, self.legal(preferred), is_outer=True)

    def get_legal(self, key: Hashable, legal: str) -> str:
        """Return the name of `key`. If it has none yet, derive a unique one from a legal one."""
        name = self.find(key)
        return name if name is not None else self._reserve(key, legal)

    def _reserve(self, key: Hashable, base: str, is_outer: bool = False) -> str:
        """Store a unique name for a key in this scope, or in the outermost one, and return it."""
        name, count = base, 1
        while self._is_taken(name):
            count += 1
            name = f"{base.rstrip('_')}_{count}"
        scope = self
        while is_outer and scope._parent is not None:
            scope = scope._parent
        scope._by_key[key] = name
        scope._taken.add(name)
        return name

    def find(self, key: Hashable) -> str | None:
        """Return the name of `key`, or None."""
        name = self._by_key.get(key)
        return name if name is not None or self._parent is None else self._parent.find(key)

    def _is_taken(self, name: str) -> bool:
        return name in self._taken or (self._parent is not None and self._parent._is_taken(name))

    def legal(self, name: str) -> str:
        """Return the name itself if the language allows it, else a similar legal one."""
        legal = self._legal.get(name)
        if legal is None:
            legal = self._legal[name] = self._make_legal(name)
        return legal

    def _make_legal(self, name: str) -> str:
        plain = name.encode("ascii", "backslashreplace").decode().replace("\\", "x").strip("_") or "name"
        while "__" in plain:
            plain = plain.replace("__", "_")
        if plain[0].isdigit() or plain.startswith(("gl_", "GL_", "rhi_")):
            return f"x_{plain}"
        return f"{plain}_" if plain in self.reserved else plain
