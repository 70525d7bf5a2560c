"""Walking over nodes of the typed tree and of lane code: operands and blocks, found by the types of a node's fields."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from operator import attrgetter
from typing import Any, Final, TypeAlias

_Reader: TypeAlias = Callable[[Any], tuple[Any, ...]]


_readers: Final[dict[tuple[type, str], _Reader]] = {}
"""The function that reads the operands of each class of nodes, chosen once: all that is parsed and lowered is read."""


def _choose_reader(kind: type, of: str) -> _Reader:
    """Return the function that reads the fields of a class of nodes that are declared as `of`, or as a tuple of it."""
    found = [(field.name, str(field.type)) for field in fields(kind) if re.search(rf"\b{of}\b", str(field.type))]
    if not found:
        return lambda node: ()
    read = attrgetter(*(name for name, _ in found))
    if all(type == of for _, type in found):
        return read if len(found) > 1 else lambda node: (read(node),)
    if len(found) == 1 and found[0][1].startswith("tuple"):
        return read

    def read_mixed(node: Any) -> tuple[Any, ...]:
        parts: list[Any] = []
        for name, type in found:
            part = getattr(node, name)
            parts += part if type.startswith("tuple") else () if part is None else (part,)
        return tuple(parts)

    return read_mixed


def operands(node: Any, of: str) -> tuple[Any, ...]:
    """Return the direct operands of a node, in order; `of` is the name of their base class."""
    key = (type(node), of)
    read = _readers.get(key)
    if read is None:
        read = _readers[key] = _choose_reader(*key)
    return read(node)


def within(node: Any, of: str) -> Iterator[Any]:
    """Yield a node and all nodes that it is computed from, in order; `of` is the name of their base class."""
    left = [node]
    while left:
        node = left.pop()
        yield node
        left += operands(node, of)[::-1]


def walk(block: Sequence[Any]) -> Iterator[Any]:
    """Yield all statements of a block; nested ones follow the statement that contains them."""
    for statement in block:
        yield statement
        for inner in operands(statement, "Block"):
            yield from walk(inner)
