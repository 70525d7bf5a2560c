"""What an annotation means: a value type with a role, or a binding's type."""

from __future__ import annotations

import enum
from typing import Annotated, Any, TypeAlias, TypeVar, get_args, get_origin

from rhi.contract.layout import BOOL, FLOAT, INT, ArrayType, HostType
from rhi.shading.language.types import LANGUAGE_NAMES
from rhi.shading.language.vectors import Array, ArrayLength, ReadOnlyArray

__rhi_internal__ = True

LANGUAGE_NAMES.update(("Flat", "FragmentDepth", "NoPerspective"))

T = TypeVar("T")


class Role(enum.Enum):
    """What a struct's field is for, besides holding a value."""

    FLAT = "flat"
    NO_PERSPECTIVE = "noperspective"
    FRAGMENT_DEPTH = "fragment depth"

    __hash__ = object.__hash__


Flat = Annotated[T, Role.FLAT]
"""A varying that isn't interpolated: the value of the first vertex. Integers always are flat."""

NoPerspective = Annotated[T, Role.NO_PERSPECTIVE]
"""A varying interpolated in the image, not in the world."""

FragmentDepth: TypeAlias = Annotated[float, Role.FRAGMENT_DEPTH]
"""A fragment output that replaces the depth."""

_SCALARS: dict[Any, HostType] = {float: FLOAT, int: INT, bool: BOOL}


def role_of(annotation: Any) -> Role | None:
    """The role that `Annotated` carries, or None."""
    if get_origin(annotation) is Annotated:
        return next((part for part in get_args(annotation)[1:] if isinstance(part, Role)), None)
    return None


def value_type_of(annotation: Any) -> HostType:
    """The value type of `float`, `int`, `uint`, `bool`, a vector or matrix class, or a `Struct` class.

    Raises:
        TypeError: it is none of these.
    """
    found = value_type(annotation)
    if found is None:
        raise TypeError(f"{annotation!r} is not a value type of the shading language")
    return found


def value_type(annotation: Any, default: object = None) -> HostType | None:
    """The value type that an annotation names, or None; `default` gives an array its length."""
    if get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) in (Array, ReadOnlyArray):
        if not isinstance(default, ArrayLength):
            return None
        element = value_type(get_args(annotation)[0])
        return ArrayType(element, default.length) if element is not None else None
    try:
        if annotation in _SCALARS:
            return _SCALARS[annotation]
    except TypeError:  # not hashable
        return None
    named = getattr(annotation, "shading_type", None) if isinstance(annotation, type) else None
    return named if isinstance(named, HostType) else None
