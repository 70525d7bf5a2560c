"""Annotations of values: the value type that an annotation denotes, and the role that it gives a struct's
field."""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias, TypeVar, get_args, get_origin

from rhi.contract.layout import BOOL, FLOAT, INT, ArrayType, HostType
from rhi.errors.choices import Choice
from rhi.shading.language.types import LANGUAGE_NAMES
from rhi.shading.language.vectors import Array, ArrayLength, ReadOnlyArray

LANGUAGE_NAMES.update(("Flat", "FragmentDepth", "NoPerspective", "PointSize", "TargetLayer"))

T = TypeVar("T")


class Role(Choice):
    """The special treatment of a struct's field as a varying or a fragment output."""

    FLAT = "flat"
    NO_PERSPECTIVE = "noperspective"
    FRAGMENT_DEPTH = "fragment depth"
    POINT_SIZE = "point size"
    TARGET_LAYER = "target layer"


Flat = Annotated[T, Role.FLAT]
"""A varying that isn't interpolated: fragments get the first vertex's value. Integers are always flat."""

NoPerspective = Annotated[T, Role.NO_PERSPECTIVE]
"""A varying interpolated linearly in screen space, without perspective correction."""

FragmentDepth: TypeAlias = Annotated[float, Role.FRAGMENT_DEPTH]
"""A fragment output that replaces the interpolated depth."""

PointSize: TypeAlias = Annotated[float, Role.POINT_SIZE]
"""A field of the vertex stage's result: the side in texels of the square that a point is drawn as."""

TargetLayer: TypeAlias = Annotated[int, Role.TARGET_LAYER]
"""A field of the vertex stage's result: the layer that a primitive is drawn to, in a pass on all layers
(`texture.at(layer=None)`). All its vertices have the same; outside of the target's layers, nothing is drawn."""

_SCALARS: dict[Any, HostType] = {float: FLOAT, int: INT, bool: BOOL}


def role_of(annotation: Any) -> Role | None:
    """Return the role that an `Annotated` annotation carries, or None."""
    if get_origin(annotation) is Annotated:
        return next((part for part in get_args(annotation)[1:] if isinstance(part, Role)), None)
    return None


def value_type_of(annotation: Any) -> HostType:
    """Return the value type for `float`, `int`, `uint`, `bool`, a vector or matrix class, or a `Struct`
    class.

    Raises:
        TypeError: the annotation is none of these.
    """
    type = value_type(annotation)
    if type is None:
        raise TypeError(f"{annotation!r} is not a value type of the shading language")
    return type


def value_type(annotation: Any, default: object = None) -> HostType | None:
    """Return the value type that an annotation denotes, or None. An array takes its length from `default`."""
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
    except (TypeError, ValueError):  # not hashable; a memoryview raises the latter
        return None
    named = getattr(annotation, "shading_type", None) if isinstance(annotation, type) else None
    return named if isinstance(named, HostType) else None
