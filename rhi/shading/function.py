"""Functions outside shader classes, and functions whose body is native code.

- `@function` marks a module-level function as part of the shading language: shaders may call it.
- `@native("glsl", body)` gives a stage, helper or function a body in one device language, OpenCL C for stages
  only. Its signature stays Python, so bindings, structs, vertex inputs and varyings stay typed and are declared
  as ever; the Python body, if there is one, serves the other languages.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from types import FunctionType
from typing import Any, Generic, ParamSpec, TypeVar, cast

import numpy as np

from rhi.errors import refuse
from rhi.shading import rules
from rhi.shading.source import locals_of, resolve_annotations

__rhi_internal__ = True

P = ParamSpec("P")
R = TypeVar("R")
F = TypeVar("F", bound=Callable[..., Any])

NATIVE = "_rhi_native"


@dataclass(frozen=True, slots=True)
class Native:
    """A function's body in a device language, and what must stand at file level before it.

    `line` is that of the text's first line in the Python file, 0 where it isn't written there as it is.
    """

    body: str
    declarations: str = ""
    line: int = 0


class Function(Generic[P, R]):
    """A module-level function of the shading language; shaders call it, `evaluate` runs it on the CPU."""

    def __init__(self, function: FunctionType) -> None:
        self.python = function
        self.__name__ = function.__name__
        self.__doc__ = function.__doc__
        self.__wrapped__ = function

    def __call__(self, *arguments: P.args, **named: P.kwargs) -> R:
        refuse(
            rules.DEVICE_ONLY,
            f"{self.__name__}(…)",
            tip=f"on the CPU: {self.__name__}.evaluate(…) with arrays",
        )

    def evaluate(
        self,
        *arguments: Any,
        dtype: type[np.float32] | type[np.float64] = np.float32,
        **named: Any,
    ) -> Any:
        """Run the function on whole arrays with NumPy.

        Args:
            arguments, named: an array for each parameter: `(…)` for a number, `(…, 3)` for a `vec3`, `(…, 3, 3)` for
                a `mat3`, a structured array or `Struct` for a struct. What stands for `…` broadcasts.
            dtype: of floats, and of the result.

        Returns:
            The results in the same form; a struct's as a structured array.

        Raises:
            ValidationError `shading-arguments`: an argument is missing, unknown or has the wrong shape.
            ShaderError: the function breaks a rule of the language.
        """
        from rhi.shading.evaluate import evaluate  # the compiler needs this module

        return evaluate(self.python, arguments, named, dtype)


def function(python: Callable[P, R]) -> Function[P, R]:
    """Make a Python function callable from shaders. It is parsed when a shader that calls it is compiled."""
    plain = cast(FunctionType, python)
    resolve_annotations(plain, locals_of(sys._getframe(1)))
    return Function(plain)


def native(language: str, body: str, declarations: str = "") -> Callable[[F], F]:
    """Give a function its body in `language`: "glsl"; of a stage also "opencl" and a number of lanes ("opencl16").

    `body` is the text between the braces and may use the parameters, bindings and struct types by their
    Python names; `declarations` is put at file level before it (`#extension` lines go to the top). In OpenCL C,
    bindings and parameters are those of the function that `rhi.shading.opencl_stages` describes, or of the kernel
    (`rhi.shading.opencl`).
    """

    def attach(python: F) -> F:
        bodies = dict(getattr(python, NATIVE, {}))
        bodies[language] = Native(body, declarations)
        setattr(python, NATIVE, bodies)
        return python

    return attach
