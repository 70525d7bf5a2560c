"""Signatures: the parameters and results of functions, read from their annotations."""

from __future__ import annotations

import ast
from types import FunctionType
from typing import Any, NoReturn, get_args, get_origin

from rhi.contract.layout import ArrayType
from rhi.errors.data_classes import dataclass
from rhi.shading.language import rules
from rhi.shading.language.annotations import value_type
from rhi.shading.language.bindings import Storage, StorageRW, Uniform
from rhi.shading.language.shader import Shader
from rhi.shading.language.source import MISSING, Source, source_of, suggest_name
from rhi.shading.language.structs import Struct
from rhi.shading.language.texture_tables import TextureTable
from rhi.shading.language.textures import SampledTexture
from rhi.shading.language.types import VOID, Type
from rhi.shading.language.vectors import Array, ReadOnlyArray


@dataclass(frozen=True, slots=True)
class UnsizedArray:
    """The type of an array parameter without a length; the function is compiled for each length."""

    element: Type

    def __str__(self) -> str:
        return f"Array[{self.element}]"


@dataclass(frozen=True, slots=True)
class FunctionParameter:
    """A parameter of a function. `host` is its annotation, `default` its default value or `MISSING`."""

    name: str
    type: Type | UnsizedArray
    host: Any
    default: Any


@dataclass(frozen=True, slots=True)
class Signature:
    """The parameters of a function without `self`, the name of `self`, and the result with its annotation."""

    parameters: tuple[FunctionParameter, ...]
    result: Type
    result_host: Any
    self_name: str | None


def signature_of(source: Source, is_method: bool) -> Signature:
    """Return the signature of a function, or refuse its first invalid parameter."""
    arguments = source.node.args
    for extra in (arguments.vararg, arguments.kwarg):
        if extra is not None:
            source.refuse(rules.SYNTAX, extra, f"*{extra.arg}", "named parameters")
    positional = [*arguments.posonlyargs, *arguments.args]
    own_defaults = source.function.__defaults__ or ()
    defaults: list[Any] = [*[MISSING] * (len(positional) - len(own_defaults)), *own_defaults]
    named = [*positional, *arguments.kwonlyargs]
    by_name = source.function.__kwdefaults__ or {}
    defaults += [by_name.get(argument.arg, MISSING) for argument in arguments.kwonlyargs]
    self_name = None
    if is_method:
        if not positional:
            source.refuse(rules.ANNOTATION, source.node, "no self", "a method's first parameter is self")
        self_name, named, defaults = named[0].arg, named[1:], defaults[1:]
    parameters = []
    for argument, default in zip(named, defaults, strict=True):
        host = _annotation(source, argument.arg, argument, argument.annotation)
        parameter_type = _parameter_type(host)
        if parameter_type is None:
            _refuse(source, argument.annotation or argument, host)
        parameters.append(FunctionParameter(argument.arg, parameter_type, host, default))
    node = source.node
    host = _annotation(source, "return", node, node.returns)
    result: Type | None = VOID if host is None or host is type(None) else value_type(host)
    if result is None:
        _refuse(source, node.returns or node, host)
    return Signature(tuple(parameters), result, host, self_name)


def _annotation(source: Source, name: str, at: ast.AST, node: ast.expr | None) -> Any:
    if node is None:
        missing = "a return annotation (`-> None` for none)" if name == "return" else f"a type for {name!r}"
        source.refuse(rules.ANNOTATION, at, "none", missing)
    return evaluate_annotation(source, node, source.function.__annotations__.get(name, MISSING))


def evaluate_annotation(source: Source, node: ast.expr, annotation: Any = MISSING) -> Any:
    """Return the object that an annotation names: `annotation` unless that is a string or missing."""
    if annotation is not MISSING and not isinstance(annotation, str):
        return annotation
    try:
        return source.scope.evaluate(annotation if isinstance(annotation, str) else ast.unparse(node))
    except NameError as error:
        source.refuse(
            rules.UNKNOWN_NAME,
            node,
            repr(error.name),
            tip=suggest_name(error.name or "", source.scope.names()),
        )
    except Exception as error:
        source.refuse(rules.ANNOTATION, node, f"{type(error).__name__}: {error}")


def _parameter_type(host: Any) -> Type | UnsizedArray | None:
    if isinstance(host, type) and issubclass(host, SampledTexture):
        return None if host.shading_type.table else host.shading_type
    if get_origin(host) in (Array, ReadOnlyArray):
        element = value_type(get_args(host)[0])
        return UnsizedArray(element) if element is not None else None
    return value_type(host)


def _refuse(source: Source, at: ast.AST, host: Any) -> NoReturn:
    allowed = "float, int, uint, bool, vectors, matrices, Struct classes, textures"
    tip = ""
    if get_origin(host) in (Array, ReadOnlyArray):
        tip = "arrays can't be returned; return a Struct with an array field"
    elif host is TextureTable:
        tip = "tables are read through self: make the function a method, or pass what it reads"
    elif get_origin(host) in (Uniform, Storage, StorageRW):
        tip = "bindings are read through self: make the function a method, or pass an element"
    source.refuse(rules.ANNOTATION, at, getattr(host, "__name__", repr(host)), allowed, tip)


def fits(parameter: Type | UnsizedArray, argument: Type) -> bool:
    """Return whether an array parameter accepts an argument of this type."""
    return (
        isinstance(parameter, UnsizedArray)
        and isinstance(argument, ArrayType)
        and argument.element == parameter.element
    )


def struct_class(host: Any) -> type[Struct] | None:
    """Return the Struct class that an annotation names, or None."""
    return host if isinstance(host, type) and issubclass(host, Struct) else None


@dataclass(frozen=True, slots=True)
class Callee:
    """A Python function that is called. `owner` is the class that defines it, None for a module-level
    function."""

    source: Source
    owner: type | None
    has_self: bool

    @property
    def signature(self) -> Signature:
        """The function's signature. Its annotations are read once, unless a struct changes."""
        source = self.source
        if source.signature is None or source.signature[1] != source.generation:
            source.signature = (
                signature_of(source, self.owner is not None and self.has_self),
                source.generation,
            )
        cached: Signature = source.signature[0]
        return cached


def find_method(shader: type[Shader], name: str, after: type | None = None) -> Callee | None:
    """Return a method from the first class of the shader's MRO (after `after`) that defines it, or None."""
    classes = shader.__mro__
    start = classes.index(after) + 1 if after is not None else 0
    for cls in classes[start:]:
        method = cls.__dict__.get(name)
        has_self = not isinstance(method, staticmethod)
        python = method.__func__ if isinstance(method, staticmethod) else method
        if isinstance(python, FunctionType) and cls is not Shader:
            return Callee(source_of(python), cls, has_self)
    return None
