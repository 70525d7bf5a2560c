"""Where shaders come from: the syntax tree of a function, the names it sees, and errors that point at it.

- A file is read and parsed once; a function is found in it by its first line. Notebook cells and
  interpreters work wherever `linecache` knows their lines.
- `NameScope` resolves a name as the function itself would: enclosing functions' variables, globals, builtins.
- Annotations may be strings whose names closures don't keep: `resolve_annotations` evaluates those when the
  class or function is defined, where the names still exist.
"""

from __future__ import annotations

import ast
import builtins
import contextlib
import difflib
import linecache
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import FrameType, FunctionType
from typing import Any, Final, NoReturn

from rhi.errors import CallSite, Rule, ShaderError
from rhi.shading.language import rules
from rhi.shading.language.types import LANGUAGE_NAMES

__rhi_internal__ = True

MISSING: Final = object()
_SOURCE: Final = "_rhi_source"

_files: dict[str, tuple[list[str], dict[int, ast.FunctionDef]]] = {}


@dataclass(frozen=True, slots=True)
class SourceSpan:
    """A span of a source line; lines count from 1, columns from 0."""

    line: int
    column: int = 0
    end_column: int = 0


def span_of(node: ast.AST) -> SourceSpan:
    """Where a node is; of one on several lines, its first line."""
    line, column = getattr(node, "lineno", 1), getattr(node, "col_offset", 0)
    end = getattr(node, "end_col_offset", 0) if getattr(node, "end_lineno", line) == line else 0
    return SourceSpan(line, column, end)


class Source:
    """A Python function's syntax tree, file and scope."""

    __slots__ = ("file", "function", "name", "node", "scope", "signature")

    def __init__(self, function: FunctionType) -> None:
        self.signature: Any = None  # kept here by rhi.shading.parser.signatures
        self.function = function
        self.file = function.__code__.co_filename
        self.name = function.__qualname__.replace("<locals>.", "")
        self.scope = NameScope(function)
        found = _functions_of(self.file).get(function.__code__.co_firstlineno)
        if found is None:
            raise ShaderError(rules.NO_SOURCE, self.name, given=self.file)
        self.node = found

    def refuse(
        self, rule: Rule, at: ast.AST | SourceSpan, given: str = "", allowed: str = "", tip: str = ""
    ) -> NoReturn:
        """Raise a `ShaderError` that shows the line of `at` with a caret below it."""
        place = at if isinstance(at, SourceSpan) else span_of(at)
        raise ShaderError(
            rule,
            f"{self.name}\n{show(self.file, place)}",
            given,
            allowed,
            tip,
            CallSite(self.file, place.line, self.name),
        )


def show(file: str, place: SourceSpan) -> str:
    """File, line and column, the line, and carets below what is meant."""
    text = linecache.getline(file, place.line).rstrip("\n")
    # Columns of syntax trees count UTF-8 bytes.
    encoded = text.encode()
    start = len(encoded[: place.column].decode(errors="ignore"))
    end = len(encoded[: place.end_column].decode(errors="ignore")) if place.end_column else len(text)
    cut = len(text) - len(text.lstrip())
    carets = " " * max(0, start - cut) + "^" * max(1, end - start)
    return f"{file}:{place.line}:{start + 1}\n    {text.strip()}\n    {carets}"


def _functions_of(file: str) -> dict[int, ast.FunctionDef]:
    linecache.checkcache(file)
    lines = linecache.getlines(file)
    known = _files.get(file)
    if known is not None and known[0] is lines:
        return known[1]
    try:
        tree = ast.parse("".join(lines), file)
    except SyntaxError:
        return {}
    functions: dict[int, ast.FunctionDef] = {}
    stack: list[ast.AST] = [tree]
    while stack:
        node = stack.pop()
        if isinstance(node, ast.FunctionDef):
            first = node.decorator_list[0].lineno if node.decorator_list else node.lineno
            functions[first] = node
        stack.extend(child for child in ast.iter_child_nodes(node) if isinstance(child, ast.stmt))
    _files[file] = (lines, functions)
    return functions


class NameScope:
    """The names that a function sees outside itself."""

    __slots__ = ("closure", "globals")

    def __init__(self, function: FunctionType) -> None:
        self.closure = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
        self.globals = function.__globals__

    def find(self, name: str) -> Any:
        """The object of that name, or `MISSING`."""
        cell = self.closure.get(name)
        if cell is not None:
            try:
                return cell.cell_contents
            except ValueError:  # not assigned yet
                return MISSING
        for names in (self.globals, vars(builtins)):
            if name in names:
                return names[name]
        return MISSING

    def names(self) -> list[str]:
        """All names that `find` knows, builtins aside."""
        return [*self.closure, *self.globals]

    def evaluate(self, annotation: str) -> Any:
        """The object that an annotation's text means.

        Raises:
            NameError and whatever else the text raises.
        """
        return eval(annotation, self.globals, {name: self.find(name) for name in self.closure})


def locals_of(frame: FrameType | None) -> Mapping[str, Any]:
    """The local variables of a frame that defines a class or function; {} for a module's."""
    if frame is None or frame.f_locals is frame.f_globals:
        return {}
    return dict(frame.f_locals)


def resolve_annotations(function: FunctionType, names: Mapping[str, Any]) -> None:
    """Evaluate a function's annotations that are text, with the names around it; what fails stays text."""
    for name, annotation in function.__annotations__.items():
        if isinstance(annotation, str):
            with contextlib.suppress(Exception):
                function.__annotations__[name] = eval(annotation, function.__globals__, dict(names))


def source_of(function: FunctionType) -> Source:
    """A function's source, read once; it lives as long as the function."""
    source: Source | None = getattr(function, _SOURCE, None)
    if source is None:
        source = Source(function)
        setattr(function, _SOURCE, source)
    return source


def suggest(name: str, known: Iterable[str]) -> str:
    """A did-you-mean for a name that isn't known, or ""."""
    close = difflib.get_close_matches(name, list(known), 1, 0.6)
    return f"did you mean {close[0]!r}?" if close else ""


def suggest_name(name: str, known: Iterable[str]) -> str:
    """A tip for a name that is defined nowhere: to import it if it is one of the language's, or a did-you-mean."""
    if name in LANGUAGE_NAMES:
        return f"import it: from rhi.shading import {name}"
    return suggest(name, [*known, *LANGUAGE_NAMES])
