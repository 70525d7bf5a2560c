"""Attributes whose values are checked when they are set, such as those of a renderer.

Engine authors and their configuration files set them by hand. A value that isn't of the attribute's type is refused
before a frame is drawn with it.

`CheckedAttribute` has no `__get__`, and keeps values in the instance's `__dict__`. So frames read them at the speed of
plain attributes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from renderer import rules

Value = TypeVar("Value")
Accepted = TypeVar("Accepted")


class CheckedAttribute(Generic[Value, Accepted]):
    """An attribute that holds a `Value`, and accepts what `convert` makes one of.

    Args:
        convert: takes the instance, the call for an error, and the value that was set.
    """

    def __init__(self, convert: Callable[[Any, str, Accepted], Value]) -> None:
        self._convert = convert

    def __set_name__(self, owner: type, name: str) -> None:
        self._owner, self._name = owner.__name__, name

    def __set__(self, instance: Any, value: Accepted) -> None:
        attributes = instance.__dict__
        is_new = self._name not in attributes
        call = f"{self._owner}({self._name}=...)" if is_new else f"{self._owner}.{self._name} = …"
        attributes[self._name] = self._convert(instance, call, value)

    if TYPE_CHECKING:  # the value is in the instance's dictionary

        def __get__(self, instance: Any, owner: type) -> Value: ...


class TypedAttribute(CheckedAttribute[Value, Value]):
    """A `CheckedAttribute` whose values are of one class."""

    def __init__(self, kind: type[Value]) -> None:
        super().__init__(lambda _, call, value: rules.check_type(call, value, kind))
