"""Shaders from strings, for editors, notebooks and generators: a text is executed like a module of its own.

- The text is stored with the module, where `rhi.shading.language.source` reads it, so that errors show its
  lines. Nothing is written to a file or to `linecache`, and nothing stays in `sys.modules`.
- Names that are passed in become globals of the module before the text runs.
"""

from __future__ import annotations

import ast
import itertools
import sys
from collections.abc import Mapping
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, Final, overload

from rhi.errors import RhiError, ShaderError
from rhi.errors.call_sites import CallSite, find_call_site
from rhi.shading.language import rules
from rhi.shading.language.function import ShadingFunction
from rhi.shading.language.shader import Shader
from rhi.shading.language.source import SourceFile, SourceSpan, show, suggest, suggest_name

_numbers: Final = itertools.count(1)


@overload
def from_source(text: str, *, file: str = ..., scope: Mapping[str, object] | None = ...) -> type[Shader]: ...
@overload
def from_source(
    text: str, name: str, /, *, file: str = ..., scope: Mapping[str, object] | None = ...
) -> Any: ...
@overload
def from_source(
    text: str,
    name: str,
    second: str,
    /,
    *more: str,
    file: str = ...,
    scope: Mapping[str, object] | None = ...,
) -> tuple[Any, ...]: ...
def from_source(
    text: str, *names: str, file: str = "<shader>", scope: Mapping[str, object] | None = None
) -> Any:
    """Execute Python text that defines shaders, and return the last shader class that it defines at its top
    level.

    The text runs as Python, with everything that Python may do: never pass text from a source that you don't
    trust.

    Args:
        text: a module's text, with its imports.
        names: the names to return instead: classes, structs or functions. One name returns one object,
            several names return a tuple in their order.
        file: the name that errors show for the text, such as the path of an editor's buffer.
        scope: names that the text may use without importing them.

    Raises:
        ShaderError: `shading-text`: the text isn't Python, raises an exception or doesn't define the names;
            the error shows the line. Errors of the shading language are raised as they are.

    Examples:
        >>> Grey = sl.from_source('''
        ... from rhi.shading import FullScreen, vec4
        ...
        ... class Grey(FullScreen):
        ...     def fragment(self) -> vec4:
        ...         return vec4(0.5)
        ... ''')
        >>> Grey.__name__
        'Grey'
    """
    source = SourceFile(file)
    source.lines, source.spec = text.splitlines(keepends=True), None
    module = ModuleType(f"shader_text_{next(_numbers)}")
    module.__spec__ = ModuleSpec(module.__name__, None, loader_state=source)
    vars(module).update(scope or {})
    execute("from_source", source, text, module)
    shaders = [_find(source, module, name) for name in names]
    if not names:
        return _last_shader(source, module)
    return shaders[0] if len(shaders) == 1 else tuple(shaders)


def execute(
    call: str, source: SourceFile, text: str, module: ModuleType, registered: ModuleType | None = None
) -> None:
    """Run a text in a module, which is in `sys.modules` meanwhile because the creation of classes looks it
    up.

    Afterwards `sys.modules` has the module `registered` under the name, or none. Of a program, `__main__`, what
    is behind `if __name__ == "__main__":` doesn't run.

    Raises:
        ShaderError: `shading-text`: the text isn't Python or raises an exception; the error shows the line.
            `shading-reload`: a program has no such line.
    """
    sys.modules[module.__name__] = module
    try:
        program: str | ast.Module = text
        if module.__name__ == "__main__":
            program = ast.parse(text, str(source))
            _leave_out_program(program, call, source)
        exec(compile(program, str(source), "exec", dont_inherit=True), vars(module))
    except RhiError:
        raise
    except (Exception, SystemExit) as error:
        raise _describe_failure(call, source, error, module) from error
    finally:
        if registered is None:
            del sys.modules[module.__name__]
        else:
            sys.modules[module.__name__] = registered


def _leave_out_program(tree: ast.Module, call: str, source: SourceFile) -> None:
    """Make the conditions `__name__ == "__main__"` of a program false, so that it doesn't begin again."""
    conditions = [
        statement
        for statement in tree.body
        if isinstance(statement, ast.If)
        and ast.unparse(statement.test) in ("__name__ == '__main__'", "'__main__' == __name__")
    ]
    if not conditions:
        raise ShaderError(
            rules.RELOAD,
            call,
            "a program that would run again inside itself",
            tip='put what it runs behind `if __name__ == "__main__":`',
            site=CallSite(str(source), len(source.lines)),
        )
    for statement in conditions:
        statement.test = ast.copy_location(ast.Constant(False), statement.test)


def _last_shader(source: SourceFile, module: ModuleType) -> type[Shader]:
    shaders = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, Shader) and is_own(value, module)
    ]
    if not shaders:
        actual, allowed = "no shader", "a class derived from Shader"
        raise ShaderError(rules.TEXT, f"from_source({source})", actual, allowed, site=find_call_site())
    return shaders[-1]


def _find(source: SourceFile, module: ModuleType, name: str) -> Any:
    if name not in vars(module):
        own_names = [key for key, value in vars(module).items() if is_own(value, module)]
        call, allowed = f"from_source({source})", ", ".join(own_names)
        raise ShaderError(rules.TEXT, call, repr(name), allowed, suggest(name, own_names), find_call_site())
    return vars(module)[name]


def is_own(value: object, module: ModuleType) -> bool:
    """Return whether a text itself defines a value of its module: a class or a function."""
    value = value.python if isinstance(value, ShadingFunction) else value
    return getattr(value, "__module__", "") == module.__name__


def _describe_failure(call: str, source: SourceFile, error: BaseException, module: ModuleType) -> ShaderError:
    """Return the error for an exception that executing a text has raised, at the text's innermost line."""
    line, actual = 0, f"{type(error).__name__}: {error}"
    if isinstance(error, SyntaxError) and error.filename == source:
        line, actual = error.lineno or 0, f"SyntaxError: {error.msg}"
    trace = error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == source:
            line = trace.tb_lineno
        trace = trace.tb_next
    text = f"{call}\n{show(source, SourceSpan(line))}" if line else f"{call}({source})"
    site = CallSite(str(source), line) if line else find_call_site()
    unknown = error.name if isinstance(error, NameError) and error.name else ""
    tip = suggest_name(unknown, vars(module)) if unknown else ""
    return ShaderError(rules.TEXT, text, actual, tip=tip, site=site)


__all__ = ["from_source"]
