"""Values of a JSON document, read with their path in the file, so that every refusal names it.

`JsonObject` is one object of the document. Its methods return a value of the wanted kind, or refuse the file
with one line: what stands where, and what is allowed there. So no reader checks a type or a range by itself.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final, NoReturn, TypeGuard

import numpy as np

from renderer import rules
from renderer.scene.arrays import Floats
from rhi.errors import refuse

LARGEST: Final = 1e30
"""The largest number of a document: products of a few don't overflow."""

_MAX_SHOWN_LENGTH: Final = 60  # characters of a value that a refusal shows


@dataclass(frozen=True, slots=True)
class JsonObject:
    """An object of a document.

    Attributes:
        file: the path as the user gave it.
        where: the object's place in the document, such as `meshes[3].primitives[0]`; empty for the document
            itself.
        values: the object.
    """

    file: str
    where: str
    values: dict[str, Any]

    def path_of(self, name: str) -> str:
        """Return the path of the field `name` in the document."""
        return f"{self.where}.{name}" if self.where else name

    def refuse(self, name: str, value: object, allowed: str = "", tip: str = "") -> NoReturn:
        """Refuse the file because of the field `name`; an empty name means the object itself. `tip` takes the
        place of the rule's."""
        text = value if isinstance(value, str) else _as_json(value)
        text = text if len(text) <= _MAX_SHOWN_LENGTH else f"{text[:_MAX_SHOWN_LENGTH]}…"
        path_of = self.path_of(name) if name else self.where
        refuse(
            rules.UNREADABLE_MODEL,
            f"load_model({self.file!r})",
            f"{self.file}: {path_of}: {text}" if path_of else f"{self.file}: {text}",
            allowed,
            tip=tip,
        )

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def real(
        self, name: str, default: float | None = None, low: float = -LARGEST, high: float = LARGEST
    ) -> float:
        """Return a number from `low` to `high`, both finite; without a default it must be there."""
        value = self.values.get(name, default)
        if not is_number(value) or not low <= value <= high:
            self.refuse(name, self._describe(name, value), f"a number from {low:.12g} to {high:.12g}")
        return float(value)

    def whole(self, name: str, default: int | None = None, low: int = 0, high: int = 2**53) -> int:
        """Return a whole number from `low` to `high`; without a default it must be there."""
        value = self.values.get(name, default)
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            self.refuse(name, self._describe(name, value), f"a whole number from {low} to {high}")
        return value

    def index(self, name: str, count: int, *, required: bool = False) -> int:
        """Return the index of one of `count` things, or -1 if there is none and it isn't `required`."""
        if name not in self.values and not required:
            return -1
        value = self.values.get(name)
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < count:
            allowed = f"0 to {count - 1}" if count else "nothing: the file has none"
            self.refuse(name, self._describe(name, value), allowed)
        return value

    def indices(self, name: str, count: int) -> list[int]:
        """Return a list of indices of `count` things; empty if it is missing."""
        values = self._list(name)
        for number, index in enumerate(values):
            if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < count:
                self.refuse(f"{name}[{number}]", index, f"0 to {count - 1}" if count else "nothing")
        return values

    def reals(
        self,
        name: str,
        size: int,
        default: Iterable[float] | None = None,
        low: float = -LARGEST,
        high: float = LARGEST,
    ) -> Floats:
        """Return `size` numbers (size,) from `low` to `high`, both finite; without a default they must be
        there."""
        values: Any = self.values.get(name, default)
        fits = isinstance(values, list | tuple) and len(values) == size
        if not fits or not all(is_number(value) and low <= value <= high for value in values):
            self.refuse(name, self._describe(name, values), f"{size} numbers from {low:.12g} to {high:.12g}")
        return np.array(values, np.float64)

    def flag(self, name: str, default: bool = False) -> bool:
        """Return true or false."""
        value = self.values.get(name, default)
        if not isinstance(value, bool):
            self.refuse(name, value, "true or false")
        return value

    def text(self, name: str, default: str | None = None) -> str:
        """Return a text; without a default it must be there."""
        value = self.values.get(name, default)
        if not isinstance(value, str):
            self.refuse(name, self._describe(name, value), "a string")
        return value

    def choice(self, name: str, allowed: Iterable[str], default: str | None = None) -> str:
        """Return one of the `allowed` texts; without a default it must be there."""
        value = self.text(name, default)
        if value not in (names := list(allowed)):
            self.refuse(name, value, ", ".join(names))
        return value

    def length(self, name: str) -> int:
        """Return the length of the list `name`; 0 if it is missing."""
        return len(self._list(name))

    def child(self, name: str) -> JsonObject:
        """Return the object in the field `name`; one without fields if it is missing."""
        values = self.values.get(name, {})
        if not isinstance(values, dict):
            self.refuse(name, values, "an object")
        return JsonObject(self.file, self.path_of(name), values)

    def children(self, name: str) -> list[JsonObject]:
        """Return the objects in the list `name`; none if it is missing."""
        path_of = self.path_of(name)
        elements = self._list(name)
        for number, values in enumerate(elements):
            if not isinstance(values, dict):
                self.refuse(f"{name}[{number}]", values, "an object")
        return [
            JsonObject(self.file, f"{path_of}[{number}]", values) for number, values in enumerate(elements)
        ]

    def extension(self, name: str) -> JsonObject | None:
        """Return the object of the extension `name`, or None if this object hasn't got it."""
        extensions = self.child("extensions")
        return extensions.child(name) if name in extensions.values else None

    def _describe(self, name: str, value: object) -> object:
        return value if name in self.values else "missing"

    def _list(self, name: str) -> list[Any]:
        elements = self.values.get(name, [])
        if not isinstance(elements, list):
            self.refuse(name, elements, "a list")
        return elements


def is_number(value: Any) -> TypeGuard[float]:
    """True if a value of a document is a number that is finite, with room for products of a few."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST


def _as_json(value: object) -> str:
    """Return a value as it stands in a document."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return repr(value)
