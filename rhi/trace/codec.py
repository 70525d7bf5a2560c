"""Conversion of command arguments to JSON and back.

- The contract is the schema: the types are those of the signatures of `Backend` and of the descriptors'
  fields. Arguments are written without type tags and read back as the declared type only. So a file can't
  create anything but plain values, enums and descriptors. Nothing is imported, and no function called,
  because a file names it: states of one platform are found in a table.
- The sources of a program are text that a driver compiles and runs. Those of a file are only handed out if
  the file is trusted (`Sources`).
- An enum is written as its member's name, a descriptor as an object of its fields, a tuple as an array. A
  missing field gets its default, so descriptors can gain fields without a new version of the format.
"""

from __future__ import annotations

import dataclasses
import enum
import re
import types
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

from rhi.commands.ops import Op
from rhi.contract.backend import Backend
from rhi.contract.descriptors import (
    Attribute,
    Binding,
    BindingKind,
    ProgramDescriptor,
    Stage,
    StageText,
    TextureKind,
)
from rhi.contract.formats import Format
from rhi.contract.layout import FLOAT, INT, UINT
from rhi.contract.states import MAX_TARGETS, PER_TARGET, STATE_TYPES, PlatformState, StateChange
from rhi.errors import RhiError, ShaderError
from rhi.shading.emitters import registered_languages
from rhi.shading.language.texture_tables import TextureTable
from rhi.shading.language.types import VECTORS, ImageType, TextureType
from rhi.trace.rules import TRACE_SOURCE, TRACE_TRUST

NOT_SAVED: Final = frozenset({"numpy", "vulkan", "spirv"})
"""Languages of which a trace has no texts: no device here compiles them, and "numpy" is a Python module."""

_PLATFORM_MODULES: Final = {"gl": "rhi.backends.gl.platform_states"}
"""The modules that are imported for the states of a platform: ours only, whatever a file says."""
_ATTRIBUTE_TYPES: Final[dict[str, object]] = {
    str(type): type for type in (FLOAT, INT, UINT, *VECTORS.values())
}
_TEXTURE_TYPE: Final = re.compile(
    r"(Depth|Int|Uint|)(Texture|Image)(2D|2DArray|3D|Cube)(Samples)?(?:\[(\w+)\])?"
)
_SCALARS: Final = {"": FLOAT, "Depth": FLOAT, "Int": INT, "Uint": UINT}
_STATES: Final = {state_type.__name__: state_type for state_type in STATE_TYPES}


class MismatchError(Exception):
    """A value that was read doesn't have the declared type. The text says where."""


@cache
def argument_types(op: Op) -> dict[str, Any]:
    """Return the declared types of the arguments of an op."""
    hints = get_type_hints(getattr(Backend, op.method))
    return {name: hints[name] for name in op.parameters}


@cache
def field_types(cls: type) -> dict[str, Any]:
    """Return the declared types of the fields of a descriptor."""
    hints = get_type_hints(cls)
    return {field.name: hints[field.name] for field in dataclasses.fields(cls)}


# -- writing -------------------------------------------------------------------------------------------------


def encode(value: Any) -> Any:
    """Return a value of the contract as JSON. Memory and program sources are stored separately."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, PlatformState):
        return value.full_name
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, StateChange):
        return {"type": value.type.__name__, "value": encode(value.value)}
    if isinstance(value, (tuple, list)):
        return [encode(part) for part in value]
    if isinstance(value, (frozenset, set)):
        return sorted(encode(part) for part in value)
    if isinstance(value, ProgramDescriptor):
        fields = [field.name for field in dataclasses.fields(value) if field.name != "emit"]
        return {name: encode(getattr(value, name)) for name in fields}
    if isinstance(value, (Binding, Attribute)):
        fields = [field.name for field in dataclasses.fields(value) if field.name != "type"]
        name = getattr(value.type, "__name__", None) or str(value.type)
        if isinstance(value.type, ImageType):
            name = f"{name}[{value.type.format.name}]"
        return {field: encode(getattr(value, field)) for field in fields} | {"type": name}
    if dataclasses.is_dataclass(value):
        return {field.name: encode(getattr(value, field.name)) for field in dataclasses.fields(value)}
    return value.item()  # a NumPy number


# -- reading -------------------------------------------------------------------------------------------------


def decode(expected_type: Any, json_value: Any, where: str) -> Any:
    """Return `json_value`, parsed from JSON, as the type `expected_type`.

    Raises:
        MismatchError: the value doesn't have this type.
    """
    origin = get_origin(expected_type)
    if origin in (Union, types.UnionType):
        return _decode_optional(expected_type, json_value, where)
    if origin in (tuple, frozenset, Sequence):
        return _decode_sequence(origin, get_args(expected_type), json_value, where)
    if expected_type is StateChange:
        return _decode_change(json_value, where)
    if expected_type is ProgramDescriptor:
        return _decode_program(json_value, where)
    if isinstance(expected_type, type) and issubclass(expected_type, enum.Enum):
        if not isinstance(json_value, str) or json_value not in expected_type.__members__:
            raise MismatchError(f"{where}: {_show(json_value)} is no {expected_type.__name__}")
        return expected_type[json_value]
    if expected_type is Binding:
        return _decode_binding(json_value, where)
    if expected_type is Attribute:
        return _decode_attribute(json_value, where)
    if dataclasses.is_dataclass(expected_type):
        return _decode_dataclass(expected_type, json_value, where)  # type: ignore[arg-type]
    if expected_type is float:
        fits = isinstance(json_value, (int, float)) and not isinstance(json_value, bool)
    elif expected_type is int:
        fits = isinstance(json_value, int) and not isinstance(json_value, bool) and abs(json_value) < 1 << 63
    elif expected_type is object:
        fits = isinstance(json_value, str)
    else:
        fits = isinstance(json_value, expected_type)
    if not fits:
        raise MismatchError(
            f"{where}: {_show(json_value)} is no {getattr(expected_type, '__name__', expected_type)}"
        )
    return json_value


def _decode_optional(expected_type: Any, json_value: Any, where: str) -> Any:
    options = get_args(expected_type)
    if json_value is None and type(None) in options:
        return None
    rest = [option for option in options if option is not type(None)]
    return decode(rest[0], json_value, where)


def _decode_sequence(origin: Any, parts: tuple[Any, ...], json_value: Any, where: str) -> Any:
    if not isinstance(json_value, list):
        raise MismatchError(f"{where}: {_show(json_value)} is no array")
    if origin is tuple and not (len(parts) == 2 and parts[1] is Ellipsis):
        if len(json_value) != len(parts):
            raise MismatchError(f"{where}: {len(json_value)} values instead of {len(parts)}")
        return tuple(decode(part, value, where) for part, value in zip(parts, json_value, strict=True))
    values = [decode(parts[0], value, f"{where}[{index}]") for index, value in enumerate(json_value)]
    return frozenset(values) if origin is frozenset else tuple(values)


def _decode_dataclass(cls: type, json_value: Any, where: str) -> Any:
    hints = field_types(cls)
    if not isinstance(json_value, dict):
        raise MismatchError(f"{where}: {_show(json_value)} is no {cls.__name__}")
    for name in json_value:
        if name not in hints:
            raise MismatchError(f"{where}: a {cls.__name__} has no {name!r}")
    values = {name: decode(hints[name], value, f"{where}.{name}") for name, value in json_value.items()}
    try:
        return cls(**values)
    except (TypeError, RhiError) as error:
        raise MismatchError(f"{where}: {str(error).splitlines()[0]}") from None


def _decode_attribute(json_value: Any, where: str) -> Attribute:
    attribute: Attribute = _decode_dataclass(Attribute, json_value, where)
    attribute_type = _ATTRIBUTE_TYPES.get(str(attribute.type))
    if attribute_type is None:
        raise MismatchError(f"{where}: {_show(attribute.type)} is no scalar or vector")
    return dataclasses.replace(attribute, type=attribute_type)


def _decode_binding(json_value: Any, where: str) -> Binding:
    """Return a binding; backends need the types of textures and images, not their names."""
    binding: Binding = _decode_dataclass(Binding, json_value, where)
    if binding.kind in (BindingKind.TEXTURE, BindingKind.IMAGE):
        type = _parse_texture_type(str(binding.type))
        if isinstance(type, TextureType) is not (binding.kind is BindingKind.TEXTURE) and type is not None:
            raise MismatchError(f"{where}: a {binding.kind.value} of type {_show(binding.type)}")
        binding = dataclasses.replace(binding, type=type or binding.type)
    return binding


def _parse_texture_type(text: str) -> TextureType | ImageType | None:
    """Return the texture or image type of this name, None if there is none. The images of old files, which
    don't say their format, are none."""
    if text == str(TextureTable.shading_type):
        return TextureTable.shading_type
    match = _TEXTURE_TYPE.fullmatch(text)
    if match is None:
        return None
    prefix, noun, shape, samples, format = match.groups()
    kind = TextureKind(shape.lower().replace("array", "_array"))
    if noun == "Texture":
        return TextureType(kind, _SCALARS[prefix], prefix == "Depth", bool(samples))
    return ImageType(kind, Format[format]) if format in Format.__members__ else None


def _decode_change(json_value: Any, where: str) -> StateChange:
    if (
        not isinstance(json_value, dict)
        or json_value.keys() != {"type", "value"}
        or json_value["type"] not in _STATES
    ):
        raise MismatchError(f"{where}: {_show(json_value)} is no change of a state")
    state_type = _STATES[json_value["type"]]
    if state_type is PlatformState:
        names = decode(tuple[str, ...], json_value["value"], f"{where}.value")
        return StateChange(state_type, tuple(_lookup_platform_state(name, where) for name in names))
    if state_type in PER_TARGET:
        value_type: Any = tuple.__class_getitem__((state_type,) * MAX_TARGETS)
    else:
        value_type = state_type
    return StateChange(state_type, decode(value_type, json_value["value"], f"{where}.value"))


def _lookup_platform_state(name: str, where: str) -> PlatformState:
    """Return a platform's state by its full name. Those of other packages are known once these are
    imported."""
    platform, _, _ = name.partition(".")
    if platform in _PLATFORM_MODULES:
        import_module(_PLATFORM_MODULES[platform])
    for state_type in PlatformState.__subclasses__():
        for state in state_type:
            if state.full_name == name:
                return state
    raise MismatchError(f"{where}: no backend that is imported has the state {_show(name)}")


def _decode_program(json_value: Any, where: str) -> ProgramDescriptor:
    if not isinstance(json_value, dict):
        raise MismatchError(f"{where}: {_show(json_value)} is no program")
    hints = {name: hint for name, hint in field_types(ProgramDescriptor).items() if name != "emit"}
    required = {
        field.name
        for field in dataclasses.fields(ProgramDescriptor)
        if field.name in hints and field.default is dataclasses.MISSING
    }
    if not required <= json_value.keys() <= hints.keys():
        raise MismatchError(f"{where}: a program has {', '.join(hints)}")
    values = {name: decode(hints[name], value, f"{where}.{name}") for name, value in json_value.items()}
    return ProgramDescriptor(**values, emit=Sources(values["name"]).emit)


def _show(value: Any) -> str:
    text = repr(value)
    return text if len(text) < 60 else f"{text[:57]}…"


class Sources:
    """The sources of a loaded program, in place of the shader class that emitted them.

    Attributes:
        texts: the sources by language and stage.
        trusted: whether whoever loaded the file trusts its author: a driver compiles the sources and runs
            them as they are.
    """

    def __init__(self, name: str, trusted: bool = False) -> None:
        self.name = name
        self.trusted = trusted
        self.texts: dict[tuple[str, Stage], str] = {}

    def emit(self, language: str, stage: Stage) -> StageText:
        """Return the source of a stage; see `ProgramDescriptor.emit`.

        Raises:
            ShaderError: `trace-source` if the trace has no source in this language, `trace-trust` if the file
                isn't trusted.
        """
        call = f"program {self.name!r}, {stage.value} stage"
        text = self.texts.get((language, stage))
        if text is None:
            had = ", ".join(sorted({language for language, _ in self.texts})) or "none"
            raise ShaderError(TRACE_SOURCE, call, language, had)
        if not self.trusted:
            raise ShaderError(TRACE_TRUST, call, f"its {language} of an untrusted file")
        return StageText(text)


def sources_of(descriptor: ProgramDescriptor) -> dict[tuple[str, Stage], str]:
    """Return the sources of a program in each language that a device compiles and that has its stages."""
    owner = getattr(descriptor.emit, "__self__", None)
    if isinstance(owner, Sources):
        return owner.texts
    sources: dict[tuple[str, Stage], str] = {}
    for language in registered_languages():
        if language in NOT_SAVED:
            continue
        for stage in Stage:  # in their order: equal traces are equal files
            if stage not in descriptor.stages:
                continue
            try:
                sources[language, stage] = descriptor.emit(language, stage).text
            except RhiError:  # there is none, such as an OpenCL kernel of a vertex stage
                continue
    return sources


__all__ = [
    "NOT_SAVED",
    "MismatchError",
    "Sources",
    "argument_types",
    "decode",
    "encode",
    "sources_of",
]
