"""The check for unused bindings, which every draw would have to bind and which occupy slots of the device.

It warns, since a line that is commented out for a moment must not stop a program whose shaders are reloaded;
a test requests a refusal (`compile_shader(…, strict=True)`).

A binding counts as used if any method of the shader or of its bases names it, even in a branch that a
constant condition removes: a variant of a shader keeps the bindings of the whole. Only bindings that the
class itself declares are checked, so that a base may declare bindings for its subclasses.
"""

from __future__ import annotations

import ast
import warnings
from collections.abc import Iterable
from types import FunctionType
from typing import Any

from rhi.errors import ShaderError, ShaderWarning
from rhi.errors.call_sites import CallSite
from rhi.shading.language import rules
from rhi.shading.language.function import NATIVE
from rhi.shading.language.shader import Shader
from rhi.shading.language.source import SourceSpan, mangle_name, show, source_of, span_of

_warned: dict[Any, Any] = {}
"""The registry in which `warnings` records the lines that it has warned of."""


def collect_unused_bindings(shader: type[Shader], used: frozenset[str]) -> tuple[ShaderError, ...]:
    """Return an error `shading-unused-binding`, with the line of the declaration, for each binding that no
    method names.

    `used` are the bindings that the shader's stages read or write."""
    names = [
        name
        for name in shader._declared
        if name in vars(shader).get("__annotations__", {}) or name in vars(shader)
    ]
    unused = [name for name in names if name not in used]
    if not unused:
        return ()
    methods = [
        value
        for base in shader.__mro__
        if issubclass(base, Shader) and base is not Shader
        for value in vars(base).values()
        if isinstance(value, FunctionType)
    ]
    if any(hasattr(method, NATIVE) for method in methods):
        return ()  # the bindings that a native text uses aren't known
    named = {name for method in methods for name in _named(method)}
    errors = []
    for name in unused:
        if name not in named:
            file, span = _declaration(shader, methods[0], name)
            call = f"class {shader.__name__}: {name}\n{show(file, span)}"
            site = CallSite(str(file), span.line, shader.__qualname__)
            errors.append(ShaderError(rules.UNUSED_BINDING, call, f"{name} is never used", site=site))
    return tuple(errors)


def warn_of_unused(unused: Iterable[ShaderError]) -> None:
    """Warn of each unused binding, once for each line."""
    for error in unused:
        assert error.site is not None
        warnings.warn_explicit(str(error), ShaderWarning, error.site.file, error.site.line, registry=_warned)


def _named(method: FunctionType) -> set[str]:
    """Return the names of the attributes that a method reads from its first parameter."""
    node = source_of(method).node
    self_name = node.args.args[0].arg if node.args.args else "self"
    return {
        part.attr
        for part in ast.walk(node)
        if isinstance(part, ast.Attribute) and isinstance(part.value, ast.Name) and part.value.id == self_name
    }


def _declaration(shader: type[Shader], method: FunctionType, name: str) -> tuple[str, SourceSpan]:
    """Return the file of a class's methods and the span of a binding's declaration in it (`name: …`, `name =
    …`)."""
    file = source_of(method).file
    for node in ast.walk(ast.parse("".join(file.lines))):
        if isinstance(node, ast.ClassDef) and node.name == shader.__name__:
            for statement in node.body:
                targets = (
                    statement.targets
                    if isinstance(statement, ast.Assign)
                    else [getattr(statement, "target", None)]
                )
                if any(isinstance(t, ast.Name) and mangle_name(t.id, node.name) == name for t in targets):
                    return file, span_of(statement)
    return file, SourceSpan(method.__code__.co_firstlineno)
