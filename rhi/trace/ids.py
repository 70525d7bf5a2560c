"""The resource ids in a command, and what they stand for, found by the contract's annotations (`Id`,
`BufferId`, …)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, NamedTuple

from rhi.commands.ops import ID_KINDS, Op
from rhi.contract.descriptors import Id

_PLAIN: Final = frozenset({"int", "float", "bool", "str", "bytes", "BytesLike", "Primitive"})
_OPTIONAL: Final = frozenset({(Op.PRESENT, "texture"), (Op.DRAW_INDIRECT, "count_buffer")})
"""Arguments that are 0 for no resource. Of a descriptor's fields, those with a default may be."""


class _IdField(NamedTuple):
    """A part of a command or descriptor that is an id (`kind`: what of) or that may contain ids (None)."""

    key: Any  # the argument's index, or the field's name
    kind: type | None
    optional: bool


_ARGUMENTS: Final = {
    op: tuple(
        _IdField(i, ID_KINDS.get(annotation), (op, name) in _OPTIONAL)
        for i, (name, annotation) in enumerate(op.parameters.items())
        if annotation not in _PLAIN
    )
    for op in Op
}


_FIELDS: Final[dict[type, tuple[_IdField, ...]]] = {}


def _parts_of(value: object) -> tuple[_IdField, ...]:
    parts = _FIELDS.get(type(value))
    if parts is None:
        fields = dataclasses.fields(value) if dataclasses.is_dataclass(value) else ()
        parts = _FIELDS[type(value)] = tuple(
            _IdField(field.name, ID_KINDS.get(str(field.type)), field.default is not dataclasses.MISSING)
            for field in fields
            if field.type not in _PLAIN
        )
    return parts


def map_ids(value: Any, translate: Callable[[Id], Id]) -> Any:
    """Return a value with all resource ids in it translated; 0 stays 0."""
    if type(value) is tuple:
        parts = tuple(map_ids(part, translate) for part in value)
        return parts if any(new is not old for new, old in zip(parts, value, strict=True)) else value
    changes: dict[str, Any] = {}
    for name, kind, _ in _parts_of(value):
        part = getattr(value, name)
        new = map_ids(part, translate) if kind is None else part and translate(part)
        if new is not part:
            changes[name] = new
    return dataclasses.replace(value, **changes) if changes else value


def kinds_of(op: Op, values: Sequence[Any]) -> Iterator[tuple[Id, type]]:
    """Yield the resource ids in a command, each with what it stands for. An id that stands for none (0) is
    left out where the contract allows it."""
    for key, kind, optional in _ARGUMENTS[op]:
        value = values[key]
        if kind is None:
            yield from _kinds_in(value)
        elif value or not optional:
            yield value, kind


def _kinds_in(value: Any) -> Iterator[tuple[Id, type]]:
    if type(value) is tuple:
        for element in value:
            yield from _kinds_in(element)
        return
    for name, kind, optional in _parts_of(value):
        part = getattr(value, name)
        if kind is None:
            yield from _kinds_in(part)
        elif part or not optional:
            yield part, kind


def ids_of(op: Op, values: Sequence[Any]) -> Iterator[Id]:
    """Yield all resource ids in a command."""
    return (resource for resource, _ in kinds_of(op, values) if resource)
