"""The resource ids in a command, found by the contract's annotations (`Id`)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

from rhi.commands.ops import Op
from rhi.contract.descriptors import Id

__rhi_internal__ = True

ID_ARGUMENTS: Final = {
    op: tuple(i for i, annotation in enumerate(op.parameters.values()) if annotation == "Id") for op in Op
}
"""The indices of the arguments that are resource ids, by op."""


def map_ids(value: Any, translate: Callable[[Id], Id]) -> Any:
    """Return a value with all resource ids in it translated; 0 stays 0."""
    if type(value) is tuple:
        parts = tuple(map_ids(part, translate) for part in value)
        return parts if any(new is not old for new, old in zip(parts, value, strict=True)) else value
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        return value
    changes: dict[str, Any] = {}
    for each in dataclasses.fields(value):
        part = getattr(value, each.name)
        if each.type == "Id" and not part:
            continue
        new = translate(part) if each.type == "Id" else map_ids(part, translate)
        if new is not part:
            changes[each.name] = new
    return dataclasses.replace(value, **changes) if changes else value


def ids_of(op: Op, values: Sequence[Any]) -> Iterator[Id]:
    """Yield all resource ids in a command."""
    for place in ID_ARGUMENTS[op]:
        if values[place]:
            yield values[place]
    found: list[Id] = []

    def note(resource: Id) -> Id:
        found.append(resource)
        return resource

    for value in values:
        map_ids(value, note)
    yield from found
