"""Values of a JSON document, read with their place in the file, so that every refusal names it.

`JsonObject` is one object of the document. Its methods return a value of the wanted kind, or refuse the file with one
line: what stands where, and what is allowed there. So no reader checks a type or a range by itself.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final, NoReturn, TypeGuard

import numpy as np

from renderer import rules
from renderer.scene.arrays import Floats
from rhi.errors import refuse

_LARGEST: Final = 1e30  # of a number: products of a few don't overflow
_SHOWN: Final = 60  # characters of a value that a refusal shows


@dataclass(frozen=True, slots=True)
class JsonObject:
    """An object of a document.

    Attributes:
        file: the path as the user gave it.
        where: the object's place in the document, such as `meshes[3].primitives[0]`; empty for the document itself.
        values: the object.
    """

    file: str
    where: str
    values: dict[str, Any]

    def place(self, name: str) -> str:
        """Return the place of the field `name` in the document."""
        return f"{self.where}.{name}" if self.where else name

    def refuse(self, name: str, given: object, allowed: str = "", tip: str = "") -> NoReturn:
        """Refuse the file for what the field `name` holds; an empty name means the object itself. `tip` takes the place
        of the rule's."""
        shown = given if isinstance(given, str) else repr(given)
        shown = shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}…"
        place = self.place(name) if name else self.where
        refuse(
            rules.UNREADABLE_MODEL,
            f"load_model({self.file!r})",
            f"{self.file}: {place}: {shown}" if place else f"{self.file}: {shown}",
            allowed,
            tip=tip,
        )

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def real(self, name: str, default: float | None = None, low: float = -np.inf, high: float = np.inf) -> float:
        """Return a finite number from `low` to `high`; without a default it must be there."""
        given = self.values.get(name, default)
        if not _is_number(given) or not low <= given <= high:
            self.refuse(name, _shown(given), _range("a number", low, high))
        return float(given)

    def whole(self, name: str, default: int | None = None, low: int = 0, high: int = 2**53) -> int:
        """Return a whole number from `low` to `high`; without a default it must be there."""
        given = self.values.get(name, default)
        if isinstance(given, float) and given.is_integer():
            given = int(given)
        if not isinstance(given, int) or isinstance(given, bool) or not low <= given <= high:
            self.refuse(name, _shown(given), _range("a whole number", low, high))
        return given

    def index(self, name: str, count: int, *, needed: bool = False) -> int:
        """Return the index of one of `count` things, or -1 if there is none and it isn't `needed`."""
        if name not in self.values and not needed:
            return -1
        given = self.values.get(name)
        if not isinstance(given, int) or isinstance(given, bool) or not 0 <= given < count:
            self.refuse(name, _shown(given), f"0 to {count - 1}" if count else "nothing: the file has none")
        return given

    def indices(self, name: str, count: int) -> list[int]:
        """Return a list of indices of `count` things; empty if it is missing."""
        given = self._list(name)
        for number, index in enumerate(given):
            if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < count:
                self.refuse(f"{name}[{number}]", index, f"0 to {count - 1}" if count else "nothing")
        return given

    def reals(self, name: str, size: int, default: Iterable[float] | None = None) -> Floats:
        """Return `size` finite numbers (size,); without a default they must be there."""
        given = self.values.get(name, default)
        if given is None:
            self.refuse(name, "missing", f"{size} numbers")
        fits = isinstance(given, list | tuple) and len(given) == size
        if not fits or not all(_is_number(value) for value in given):
            self.refuse(name, given, f"{size} numbers")
        return np.array(given, np.float64)

    def flag(self, name: str, default: bool = False) -> bool:
        """Return true or false."""
        given = self.values.get(name, default)
        if not isinstance(given, bool):
            self.refuse(name, given, "true or false")
        return given

    def text(self, name: str, default: str | None = None) -> str:
        """Return a text; without a default it must be there."""
        given = self.values.get(name, default)
        if not isinstance(given, str):
            self.refuse(name, _shown(given), "a text")
        return given

    def choice(self, name: str, allowed: Iterable[str], default: str | None = None) -> str:
        """Return one of the `allowed` texts; without a default it must be there."""
        given = self.text(name, default)
        if given not in (names := list(allowed)):
            self.refuse(name, given, ", ".join(names))
        return given

    def length(self, name: str) -> int:
        """Return the length of the list `name`; 0 if it is missing."""
        return len(self._list(name))

    def child(self, name: str) -> JsonObject:
        """Return the object in the field `name`; one without fields if it is missing."""
        given = self.values.get(name, {})
        if not isinstance(given, dict):
            self.refuse(name, given, "an object")
        return JsonObject(self.file, self.place(name), given)

    def children(self, name: str) -> list[JsonObject]:
        """Return the objects in the list `name`; none if it is missing."""
        place = self.place(name)
        found = self._list(name)
        for number, given in enumerate(found):
            if not isinstance(given, dict):
                self.refuse(f"{name}[{number}]", given, "an object")
        return [JsonObject(self.file, f"{place}[{number}]", given) for number, given in enumerate(found)]

    def extension(self, name: str) -> JsonObject | None:
        """Return the object of the extension `name`, or None if this object hasn't got it."""
        held = self.child("extensions")
        return held.child(name) if name in held.values else None

    def _list(self, name: str) -> list[Any]:
        given = self.values.get(name, [])
        if not isinstance(given, list):
            self.refuse(name, given, "a list")
        return given


def _is_number(given: Any) -> TypeGuard[float]:
    return isinstance(given, int | float) and not isinstance(given, bool) and abs(given) <= _LARGEST


def _shown(given: object) -> object:
    return "missing" if given is None else given


def _range(kind: str, low: float, high: float) -> str:
    if np.isinf(high) or high == 2**53:
        return kind if np.isinf(low) else f"{kind}, {low:g} or more"
    return f"{kind} from {low:g} to {high:g}"
