"""Structs: one class is a type in shaders, a layout in memory and a value on the CPU.

- `class Light(Struct)` declares annotated fields. `Light.dtype` is its NumPy dtype in storage and vertex
  buffers (std430), `Light.uniform_dtype` the one in uniform blocks (std140); both include the padding.
- `Light(position=(0, 1, 0), …)` is a value on the CPU. Its fields are checked when they are set, and
  `to_bytes` lays them out in memory. For many values, prefer an array of `Light.dtype`. Constructors are
  generated (`struct_code`).
- A struct may inherit from another; the fields of the base come first.
"""

from __future__ import annotations

import inspect
import math
import struct
import sys
from collections.abc import Callable, Mapping
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Final, NoReturn, get_args, get_origin

import numpy as np
from numpy.typing import NDArray
from typing_extensions import dataclass_transform

from rhi.contract.layout import (
    BOOL,
    FLOAT,
    INT,
    UINT,
    ArrayType,
    Field,
    HostType,
    Layout,
    MatrixType,
    ScalarType,
    StructType,
    VectorType,
    dtype_of,
    is_host_shareable,
    memory_layout,
    scalar_offsets,
    shape_of,
)
from rhi.errors import RhiError, ShaderError, describe_value, refuse
from rhi.errors.array_likes import TOO_LARGE, check_order, to_real, to_real_array
from rhi.errors.call_sites import find_call_site
from rhi.errors.shared_caches import SHARED
from rhi.shading.language import rules
from rhi.shading.language.annotations import Role, role_of, value_type
from rhi.shading.language.source import globals_of, locals_of, suggest, suggest_name
from rhi.shading.language.struct_code import MISSING, make_constructor, split_numbers
from rhi.shading.language.types import LANGUAGE_NAMES, scalar_of
from rhi.shading.language.vectors import CLASSES, ArrayLength, array, uint

LANGUAGE_NAMES.add("Struct")

_MAX_TEXT: Final = 80
"""Characters of a refused value in a message."""

MAX_DEPTH: Final = 32
"""The maximum nesting of structs."""
MAX_FIELDS: Final = 1024
"""The maximum number of fields of a struct, including those of nested structs."""


class LayoutDtype:
    """Class attribute that returns the struct's dtype in one memory layout."""

    __slots__ = ("layout",)

    def __init__(self, layout: Layout) -> None:
        self.layout = layout

    def __get__(self, instance: object, owner: type[Struct]) -> np.dtype[Any]:
        _check_shareable(owner.shading_type, f"{owner.__name__}.dtype")
        return dtype_of(owner.shading_type, self.layout)


class FieldAccess:
    """Descriptor that reads one field of a struct's value, and checks and converts what is assigned to it."""

    __slots__ = ("field",)

    def __init__(self, field: Field) -> None:
        self.field = field

    def __get__(self, instance: Struct | None, owner: type[Struct]) -> Any:
        return self if instance is None else instance._values[self.field.name]

    def __set__(self, instance: Struct, value: object) -> None:
        instance._values[self.field.name] = _convert_field(type(instance).__name__, self.field, value)


@dataclass_transform(kw_only_default=True, field_specifiers=(array,))
class Struct:
    """Base class of structs. Fields are annotated; the constructor takes them by name.

    Raises (constructor): ValidationError `shading-struct-value`: a field is missing or unknown, or a value
        doesn't match its type.
    """

    shading_type: ClassVar[StructType] = StructType("Struct", ())
    dtype = LayoutDtype(Layout.STD430)
    uniform_dtype = LayoutDtype(Layout.STD140)
    _roles: ClassVar[Mapping[str, Role]] = {}
    _defaults: ClassVar[Mapping[str, Any]] = {}
    _depth: ClassVar[int] = 0
    _leaves: ClassVar[int] = 0

    # A value of which no field was read or set since it was constructed by a generated constructor has,
    # instead of `_values`: its scalars in order, with the bytes of matrices among them, and the bytes of a
    # uniform block.
    _numbers: tuple[Any, ...]
    _bytes: bytes

    def __init_subclass__(cls) -> None:
        annotations = inspect.get_annotations(cls)
        names = {**locals_of(sys._getframe(1)), cls.__name__: cls}
        module = globals_of(cls, sys._getframe(1))
        fields = {field.name: field for field in cls.shading_type.fields}
        roles, defaults = dict(cls._roles), dict(cls._defaults)
        depth, leaves = max(cls._depth, 1), cls._leaves
        for name, annotation in annotations.items():
            if isinstance(annotation, str):
                try:
                    annotation = eval(annotation, module, names)
                except NameError as error:
                    _refuse_field(cls, name, annotation, suggest_name(error.name or "", [*names, *module]))
            if (hasattr(Struct, name) and name != "array") or name.startswith("_"):
                _refuse_field(cls, name, "a name that Struct itself uses", "choose another name")
            default = cls.__dict__.get(name)
            type = value_type(annotation, default)
            if type is None:
                tip = "give an array its length: `name: Array[float] = array(float, 4)`"
                _refuse_field(cls, name, repr(annotation), tip if "Array" in repr(annotation) else "")
            fields[name] = Field(name, type)
            inner = struct_of(annotation)
            depth = max(depth, 1 + inner._depth) if inner is not None else depth
            leaves += inner._leaves if inner is not None else 1
            role = role_of(annotation)
            if role is not None:
                roles[name] = role
            if default is not None and not isinstance(default, ArrayLength):
                defaults[name] = _convert_field(cls.__name__, fields[name], default)
        cls._depth, cls._leaves = depth, leaves
        if depth > MAX_DEPTH or leaves > MAX_FIELDS:
            actual = f"{depth} structs in each other" if depth > MAX_DEPTH else f"{leaves} fields"
            allowed = f"up to {MAX_DEPTH} structs in each other, up to {MAX_FIELDS} fields with those inside"
            raise ShaderError(rules.TOO_DEEP, f"class {cls.__name__}", actual, allowed, site=find_call_site())
        cls.shading_type = StructType(cls.__name__, tuple(fields.values()))
        cls._roles, cls._defaults = roles, defaults
        for name in annotations:
            setattr(cls, name, FieldAccess(fields[name]))
        if "__init__" not in cls.__dict__:
            cls.__init__ = _make_first_constructor(cls)  # type: ignore[method-assign]

    def __init__(self, **values: Any) -> None:
        self._set_fields(values)

    def _set_fields(self, values: Mapping[str, Any]) -> None:
        """Check and convert the values of all fields one by one; `MISSING` ones weren't passed."""
        cls = type(self)
        values = {name: value for name, value in values.items() if value is not MISSING}
        names = [field.name for field in cls.shading_type.fields]
        for name in values:
            if name not in names:
                refuse(
                    rules.STRUCT_VALUE,
                    f"{cls.__name__}({name}=…)",
                    "a field that the struct doesn't have",
                    ", ".join(names),
                    suggest(name, names),
                )
        missing = [name for name in names if name not in values and name not in cls._defaults]
        if missing:
            actual = f"no {', '.join(missing)}"
            refuse(
                rules.STRUCT_VALUE, f"{cls.__name__}(…)", actual, "a value for each field without a default"
            )
        self._values = dict(cls._defaults)
        for name, value in values.items():
            setattr(self, name, value)

    @cached_property
    def _values(self) -> dict[str, Any]:
        """The fields by name. After a generated constructor, they are created when the first is read or
        set."""
        parts = split_numbers(self.shading_type, self._numbers)
        values = {field.name: _converted(field.type, part) for field, part in parts}
        del self._numbers, self._bytes
        return values

    def to_bytes(self, layout: Layout = Layout.STD140) -> bytes:
        """Return the value's bytes in a memory layout. Uniform blocks need the default, std140."""
        if layout is Layout.STD140 and "_bytes" in self.__dict__:
            return self._bytes
        numbers: list[Any] = []
        _flatten(self.shading_type, self, numbers)
        return _packer(self.shading_type, layout).pack(*numbers)

    @classmethod
    def pack_field(cls, name: str, value: Any) -> tuple[int, bytes]:
        """Return the byte offset of a field in a uniform block, and the field's bytes for a value.

        Raises:
            ValidationError: `shading-struct-value`: there is no such field, or the value doesn't match its
                type.
        """
        field = cls.shading_type.field(name)
        if field is None:
            names = [field.name for field in cls.shading_type.fields]
            call, actual = f"{cls.__name__}({name}=…)", "a field that the struct doesn't have"
            refuse(rules.STRUCT_VALUE, call, actual, ", ".join(names), suggest(name, names))
        numbers: list[Any] = []
        _flatten(field.type, _convert_field(cls.__name__, field, value), numbers)
        data = _packer(StructType(name, (field,)), Layout.STD140).pack(*numbers)
        offset: int = cls.uniform_dtype.fields[name][1]  # type: ignore[index]
        return offset, data[: memory_layout(field.type, Layout.STD140).size]

    @classmethod
    def array(cls, count: int) -> np.recarray[Any, Any]:
        """Return `count` zeroed values as an array of `dtype` whose fields are attributes: `lights.power[:] =
        2`.

        A field that is called like an attribute of arrays, such as `size`, is `lights["size"]`.
        """
        return np.zeros(count, cls.dtype).view(np.recarray)

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and all(
            np.array_equal(value, other._values[name]) for name, value in self._values.items()
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        fields = self.shading_type.fields
        return f"{type(self).__name__}({', '.join(f'{f.name}={self._values[f.name]!r}' for f in fields)})"


def _make_first_constructor(owner: type[Struct]) -> Callable[..., None]:
    """Return a constructor that generates the one of a struct class with its first value, and calls it."""

    def construct_first(self: Struct, /, **values: Any) -> None:
        cls: Any = owner
        with SHARED:
            if cls.__dict__["__init__"] is construct_first:  # no other thread was first
                cls.__init__ = make_constructor(cls, cls.shading_type, cls._defaults) or Struct.__init__
        cls.__init__(self, **values)

    return construct_first


def struct_of(annotation: Any) -> type[Struct] | None:
    """Return the Struct class that an annotation names, also as the element of an array, or None."""
    while get_origin(annotation) is not None:
        annotation = get_args(annotation)[0]
    return annotation if isinstance(annotation, type) and issubclass(annotation, Struct) else None


def _check_shareable(type: StructType, call: str) -> None:
    if type.fields and not is_host_shareable(type):
        tip = "bools have no layout in memory; use a uint"
        raise ShaderError(rules.STRUCT, call, "a bool field", tip=tip)


def _refuse_field(cls: type, name: str, actual: str, tip: str) -> NoReturn:
    allowed = "float, int, uint, bool, vectors, matrices, Struct classes, Array[…] with array(…)"
    raise ShaderError(rules.STRUCT, f"class {cls.__name__}: {name}", actual, allowed, tip, find_call_site())


def _convert_field(owner: str, field: Field, value: Any) -> Any:
    """Return a value in the form that a struct stores for this field, or refuse it."""
    try:
        return _converted(field.type, value)
    except (TypeError, ValueError, OverflowError) as error:
        if isinstance(error, RhiError):
            raise
        allowed = f"{field.type}, shape {shape_of(field.type)}: {error}"
        refuse(rules.STRUCT_VALUE, f"{owner}({field.name}=…)", _describe(value), allowed)


def _describe(value: Any) -> str:
    """Describe a refused value by its shape, or by what it is."""
    if isinstance(value, np.ndarray):
        return f"{type(value).__name__} of {value.dtype}, shape {value.shape}"
    text = describe_value(value)
    return text if len(text) <= _MAX_TEXT else f"{type(value).__name__} {text[:_MAX_TEXT]}…"


def _converted(type: HostType, value: Any) -> Any:
    match type:
        case ScalarType(name=name):
            value = value if value.__class__ is str else to_real(value)  # float parses text
            if name in ("int", "uint"):
                number = int(value)
                if number != value:
                    raise ValueError("expected a whole number")
                limits = np.iinfo(type.code)
                if not limits.min <= number <= limits.max:  # NumPy before 2.0 would keep 32 bits of it
                    raise OverflowError(f"Python integer {number} out of bounds for {limits.dtype}")
                return uint(number) if name == "uint" else number
            if type is BOOL:
                return bool(value)
            real = float(value)
            if math.isfinite(real) and abs(real) >= TOO_LARGE:
                raise OverflowError("out of range for a 32-bit float")
            return real
        case VectorType(scalar=scalar, size=size):
            check_order(value)
            if isinstance(value, (str, bytes, bytearray)):
                raise TypeError("text has no numbers")
            if len(value) != size:
                raise ValueError("wrong shape")
            return CLASSES[scalar, size](*[_converted(scalar, to_real(component)) for component in value])
        case MatrixType(size=size):
            matrix = to_real_array(value)
            if matrix.shape != (size, size):
                raise ValueError("wrong shape")
            return CLASSES[size](_convert_numbers(matrix, FLOAT))
        case StructType():
            if not isinstance(value, Struct) or value.shading_type != type:
                raise TypeError(f"expected a {type.name}")
            return value
        case ArrayType(element=element, length=length):
            check_order(value)
            if isinstance(_innermost(type), StructType):
                if len(value) != length:
                    raise ValueError("wrong length")
                return tuple(_converted(element, part) for part in value)
            array = to_real_array(value)
            if array.shape != shape_of(type):
                raise ValueError("wrong shape")
            inner = _innermost(type)
            return _convert_numbers(array, FLOAT if isinstance(inner, MatrixType) else scalar_of(inner))


def _convert_numbers(array: NDArray[Any], scalar: ScalarType | None) -> NDArray[Any]:
    """Convert real numbers to a scalar type, whole ones exactly; raise OverflowError or ValueError if it
    can't hold one."""
    with np.errstate(invalid="ignore", over="ignore"):
        numbers = np.array(array, (scalar.code if scalar is not None else "") or "?")
        if scalar is FLOAT and (np.isinf(numbers) & np.isfinite(array)).any():
            raise OverflowError("out of range for a 32-bit float")
        if (
            scalar in (INT, UINT)
            and not (
                (numbers == array) & ((numbers < 0) == (array < 0))  # a sign may be lost on the way
            ).all()
        ):
            raise ValueError(f"expected whole numbers in the range of {scalar}")
    return numbers


def _innermost(type: HostType) -> HostType:
    while isinstance(type, ArrayType):
        type = type.element
    return type


def _flatten(type: HostType, value: Any, numbers: list[Any]) -> None:
    """Append the scalars of a converted value to `numbers`, in order."""
    match type:
        case StructType(fields=fields):
            for field in fields:
                _flatten(field.type, value._values[field.name], numbers)
        case VectorType() | MatrixType():
            numbers.extend(value.components)
        case ArrayType(element=element) if isinstance(_innermost(type), StructType):
            for part in value:
                _flatten(element, part, numbers)
        case ArrayType():
            numbers.extend(value.ravel().tolist())
        case _:
            numbers.append(value)


@lru_cache(maxsize=1024)
def _packer(type: StructType, layout: Layout) -> struct.Struct:
    """Return a packer that turns a struct's scalars, given in order, into its bytes."""
    _check_shareable(type, f"{type}.to_bytes(…)")
    text, end = "<", 0
    for offset, code in scalar_offsets(type, layout):
        text += f"{offset - end}x" * (offset > end) + {"f4": "f", "i4": "i", "u4": "I"}[code]
        end = offset + 4
    return struct.Struct(text + f"{memory_layout(type, layout).size - end}x")
