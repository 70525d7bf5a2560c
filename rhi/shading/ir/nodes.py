"""Traversal of the typed tree and of lane code: operands and blocks, recognised by the types of a node's
fields."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from operator import attrgetter
from typing import Any, Final, TypeAlias

_Reader: TypeAlias = Callable[[Any], tuple[Any, ...]]


_readers: Final[dict[tuple[type, str], _Reader]] = {}
"""The function that reads the operands of each class of nodes, selected once, since every node is read
often."""


def _choose_reader(kind: type, class_name: str) -> _Reader:
    """Return the function that reads a node's fields declared as `class_name`, or as a tuple of it."""
    typed_fields = [
        (field.name, str(field.type))
        for field in fields(kind)
        if re.search(rf"\b{class_name}\b", str(field.type))
    ]
    if not typed_fields:
        return lambda node: ()
    read = attrgetter(*(name for name, _ in typed_fields))
    if all(type == class_name for _, type in typed_fields):
        return read if len(typed_fields) > 1 else lambda node: (read(node),)
    if len(typed_fields) == 1 and typed_fields[0][1].startswith("tuple"):
        return read

    def read_mixed(node: Any) -> tuple[Any, ...]:
        parts: list[Any] = []
        for name, type in typed_fields:
            part = getattr(node, name)
            parts += part if type.startswith("tuple") else () if part is None else (part,)
        return tuple(parts)

    return read_mixed


def operands(node: Any, class_name: str) -> tuple[Any, ...]:
    """Return the direct operands of a node, in order; `class_name` is the name of their base class."""
    key = (type(node), class_name)
    read = _readers.get(key)
    if read is None:
        read = _readers[key] = _choose_reader(*key)
    return read(node)


def within(node: Any, class_name: str) -> Iterator[Any]:
    """Yield a node and all nodes that it is computed from, in order; `class_name` is the name of their base
    class."""
    left = [node]
    while left:
        node = left.pop()
        yield node
        left += operands(node, class_name)[::-1]


def walk(block: Sequence[Any]) -> Iterator[Any]:
    """Yield all statements of a block; nested ones follow the statement that contains them."""
    for statement in block:
        yield statement
        for inner in operands(statement, "Block"):
            yield from walk(inner)
