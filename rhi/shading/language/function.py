"""Decorators of functions: `@function` outside shader classes, `@native` for bodies in a device language.

- `@function` marks a module-level function as part of the shading language: shaders may call it.
- `@native("glsl", body)` gives a stage, helper or function a body in one device language (OpenCL C for stages
  only). Its signature stays Python, so bindings, structs, vertex inputs and varyings stay typed and are
  declared as for other functions. The Python body, if there is one, is used for the other languages.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FunctionType
from typing import Any, Generic, ParamSpec, TypeVar, cast

from rhi.errors import refuse
from rhi.errors.data_classes import dataclass
from rhi.shading.language import rules
from rhi.shading.language.source import locals_of, resolve_annotations, source_of
from rhi.shading.language.types import LANGUAGE_NAMES

LANGUAGE_NAMES.update(("function", "native"))

P = ParamSpec("P")
R = TypeVar("R")
F = TypeVar("F", bound=Callable[..., Any])

NATIVE = "_rhi_native"


@dataclass(frozen=True, slots=True)
class Native:
    """A function's body in a device language, and the declarations at file level that it needs.

    `line` is the Python line on which the body's text starts, or 0 if the text isn't a literal in the Python
    file.
    """

    body: str
    declarations: str = ""
    line: int = 0


class ShadingFunction(Generic[P, R]):
    """A module-level function of the shading language. Shaders call it; `rhi.shading.evaluate` runs it on the
    CPU."""

    def __init__(self, function: FunctionType) -> None:
        self.python = function
        self.__name__ = function.__name__
        self.__doc__ = function.__doc__
        self.__wrapped__ = function

    def __call__(self, *arguments: P.args, **named: P.kwargs) -> R:
        refuse(
            rules.DEVICE_ONLY,
            f"{self.__name__}(…)",
            tip=f"on the CPU: rhi.shading.evaluate({self.__name__}, …) with arrays",
        )


def function(python: Callable[P, R]) -> ShadingFunction[P, R]:
    """Make a Python function callable from shaders. It is parsed when a shader that calls it is compiled."""
    plain = cast(FunctionType, python)
    resolve_annotations(plain, locals_of(sys._getframe(1)))
    source_of(plain)  # stores its text
    return ShadingFunction(plain)


def native(language: str, body: str, declarations: str = "") -> Callable[[F], F]:
    """Give a function a body in `language`: "glsl", or for a stage "opencl" with its number of lanes
    ("opencl16").

    `body` is the text between the braces, or a whole GLSL stage with its own `main`
    (`rhi.shading.glsl.native`). It may use the parameters, bindings and struct types by their Python names.
    `declarations` is inserted at file level before the function; its `#extension` lines go to the top of the
    file. In OpenCL C, bindings and parameters are those of the stage function that
    `rhi.shading.opencl.opencl_stages` describes, or of the kernel (`rhi.shading.opencl.opencl_writer`).
    """

    def attach(python: F) -> F:
        bodies = dict(getattr(python, NATIVE, {}))
        bodies[language] = Native(body, declarations)
        setattr(python, NATIVE, bodies)
        return python

    return attach
