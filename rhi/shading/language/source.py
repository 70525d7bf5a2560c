"""The Python source of shaders: a function's syntax tree, the names it can see, and errors that point into it.

- `keep_sources` keeps the text of a file when a class or function of it is made, so that a later edit changes neither
  what the class compiles to nor the lines that its errors show. The text is parsed when something is compiled.
- Functions are found in their file by their first line. Notebook cells and interpreters work wherever `linecache`
  knows their lines.
- `NameScope` resolves a name as the function itself would: variables of enclosing functions, globals, builtins.
- Annotations may be strings, and closures don't keep the names that only they use. `resolve_annotations` evaluates
  them when the class or function is defined, while those names still exist.
"""

from __future__ import annotations

import ast
import builtins
import contextlib
import linecache
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import FrameType, FunctionType
from typing import Any, ClassVar, Final, NoReturn

from rhi.errors import CallSite, Rule, ShaderError
from rhi.shading.language import rules
from rhi.shading.language.tips import FOREIGN
from rhi.shading.language.types import LANGUAGE_NAMES

MISSING: Final = object()
_SOURCE: Final = "_rhi_source"


class SourceFile(str):
    """The name of a Python file, together with its lines as they were when a class or function of it was made."""

    lines: list[str]
    spec: object

    def __reduce__(self) -> tuple[Any, ...]:
        return str, (str(self),)

    @cached_property
    def functions(self) -> dict[int, ast.FunctionDef]:
        """The functions of the file by their first line, that of a decorator included. The file is parsed here."""
        try:
            tree = ast.parse("".join(self.lines), self)
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
        return functions


FORGOTTEN: Final[list[Callable[[], object]]] = []
"""Called when classes and functions have changed: what others keep for them is no longer true."""

_files: dict[str, SourceFile] = {}
"""The file of each name, as it was read last."""


def read_file(name: str, names: Mapping[str, Any]) -> SourceFile:
    """Return a file with its lines: as read before, unless its module is another or was imported again since.

    A class that a function of an imported module makes later thus has the text that was imported. What isn't a
    module (a script, a notebook's cell) is compared with the file each time. The text of a module that
    `rhi.shading.language.modules` makes comes with it.

    Args:
        names: the globals of a function in the file.
    """
    spec, known = names.get("__spec__"), _files.get(name)
    given = getattr(spec, "loader_state", None)
    if isinstance(given, SourceFile) and given == name:
        return given
    if known is not None and spec is not None and known.spec is spec:
        return known
    linecache.checkcache(name)
    lines = linecache.getlines(name, dict(names) if name not in linecache.cache else None)
    if known is None or spec is not known.spec or known.lines != lines:
        known = _files[name] = SourceFile(name)
        known.lines, known.spec = lines, spec
    return known


@dataclass(frozen=True, slots=True)
class SourceSpan:
    """A span of a source line. Lines count from 1, columns from 0 in UTF-8 bytes; `end_column` 0 is the line's end."""

    line: int
    column: int = 0
    end_column: int = 0


def header_of(node: ast.stmt) -> SourceSpan:
    """Return the span of a statement's first line."""
    return SourceSpan(node.lineno, node.col_offset, 0)


def span_of(node: ast.AST) -> SourceSpan:
    """Return the source span of a node; for a node of several lines, the part on its first line."""
    line, column = getattr(node, "lineno", 1), getattr(node, "col_offset", 0)
    end = getattr(node, "end_col_offset", 0) if getattr(node, "end_lineno", line) == line else 0
    return SourceSpan(line, column, end)


class Source:
    """The file, syntax tree and name scope of a Python function.

    Attributes:
        reading: counts how often the annotations of all functions have changed.
    """

    __slots__ = ("_node", "file", "function", "name", "scope", "signature")

    reading: ClassVar[int] = 0

    def __init__(self, function: FunctionType, file: SourceFile) -> None:
        self.signature: Any = None  # kept here by rhi.shading.parser.signatures, with `reading`
        self.function = function
        self.file = file
        self.name = function.__qualname__.replace("<locals>.", "")
        self.scope = NameScope(function)
        self._node: ast.FunctionDef | None = None

    @property
    def node(self) -> ast.FunctionDef:
        """The function's syntax tree.

        Raises:
            ShaderError: `shading-no-source`: the file has no text, or another one than Python ran.
        """
        if self._node is None:
            code = self.function.__code__
            found = self.file.functions.get(code.co_firstlineno)
            if found is None or found.name != code.co_name:
                given = f"{self.file}, without `{code.co_name}` on line {code.co_firstlineno}"
                raise ShaderError(rules.NO_SOURCE, self.name, given if self.file.lines else str(self.file))
            self._node = found
        return self._node

    def refuse(
        self, rule: Rule, at: ast.AST | SourceSpan, given: str = "", allowed: str = "", tip: str = ""
    ) -> NoReturn:
        """Raise a `ShaderError` that shows the source line of `at` with carets below it."""
        span = at if isinstance(at, SourceSpan) else span_of(at)
        refuse_at(rule, self.name, self.file, span, given, allowed, tip)


def refuse_at(
    rule: Rule, function: str, file: str, span: SourceSpan, given: str, allowed: str = "", tip: str = ""
) -> NoReturn:
    """Raise a `ShaderError` that shows the source line of a span of a function."""
    site = CallSite(str(file), span.line, function)
    raise ShaderError(rule, f"{function}\n{show(file, span)}", given, allowed, tip, site)


def show(file: str, span: SourceSpan) -> str:
    """Return file, line and column of a span, then its source line, then carets below the span."""
    text = _line(file, span.line).rstrip("\n")
    # Columns of syntax trees count UTF-8 bytes.
    encoded = text.encode()
    start = max(len(encoded[: span.column].decode(errors="ignore")), len(text) - len(text.lstrip()))
    end = len(encoded[: span.end_column].decode(errors="ignore")) if span.end_column else len(text)
    indent = len(text) - len(text.lstrip())
    carets = " " * max(0, start - indent) + "^" * max(1, end - start)
    return f"{file}:{span.line}:{start + 1}\n    {text.strip()}\n    {carets}"


def _line(file: str, number: int) -> str:
    """Return a line of a file, as it was when a shader in it was made if that is known."""
    known = file if isinstance(file, SourceFile) else _files.get(file)
    if known is None:
        return linecache.getline(file, number)
    return known.lines[number - 1] if 0 < number <= len(known.lines) else ""


class NameScope:
    """The names that a function can use from outside its own body."""

    __slots__ = ("closure", "globals")

    def __init__(self, function: FunctionType) -> None:
        self.closure = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
        self.globals = function.__globals__

    def find(self, name: str) -> Any:
        """Return the object with this name, or `MISSING`."""
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
        """Return all names that `find` resolves, except builtins."""
        return [*self.closure, *self.globals]

    def evaluate(self, annotation: str) -> Any:
        """Return the object that an annotation's text denotes.

        Raises:
            NameError: a name in it is not defined. Evaluating the text may raise other errors too.
        """
        return eval(annotation, self.globals, {name: self.find(name) for name in self.closure})


def locals_of(frame: FrameType | None) -> Mapping[str, Any]:
    """Return the local variables of a frame that defines a class or function, or {} for a module's frame."""
    if frame is None or frame.f_locals is frame.f_globals:
        return {}
    return dict(frame.f_locals)


def globals_of(cls: type, frame: FrameType) -> dict[str, Any]:
    """Return the globals of a class's module, or of the frame that makes the class if the module isn't imported."""
    module = sys.modules.get(cls.__module__)
    return vars(module) if module is not None else frame.f_globals


def resolve_annotations(function: FunctionType, names: Mapping[str, Any]) -> None:
    """Evaluate a function's string annotations with the names around it. Annotations that fail stay strings."""
    for name, annotation in function.__annotations__.items():
        if isinstance(annotation, str):
            with contextlib.suppress(Exception):
                function.__annotations__[name] = eval(annotation, function.__globals__, dict(names))


def keep_sources(members: Mapping[str, object]) -> None:
    """Keep the text of the files in which the functions among a class's members are defined."""
    for name, member in members.items():
        function = member.__func__ if isinstance(member, staticmethod) else member
        if isinstance(function, FunctionType) and not name.startswith("__"):
            source_of(function)


def source_of(function: FunctionType) -> Source:
    """Return a function's source. It is kept on the function, so it lives as long."""
    source: Source | None = getattr(function, _SOURCE, None)
    if source is None:
        file = read_file(function.__code__.co_filename, function.__globals__)
        source = Source(function, file)
        setattr(function, _SOURCE, source)
    return source


def take_source(function: FunctionType, file: SourceFile) -> None:
    """Let a function's source be that of a file."""
    setattr(function, _SOURCE, Source(function, file))


def exchange_source(file: SourceFile | None, name: str = "") -> SourceFile | None:
    """Let later classes and functions of a file, and errors, have this text; return what they had."""
    name = str(file) if file is not None else name
    before = _files.pop(name, None)
    if file is not None:
        _files[name] = file
    linecache.checkcache(name)
    return before


def forget_signatures() -> None:
    """Let all annotations be read again, since the structs that they name may have changed, and forget what was
    compiled to run on the CPU."""
    Source.reading += 1
    for forget in FORGOTTEN:
        forget()


def suggest(name: str, known: Iterable[str]) -> str:
    """Return a did-you-mean tip for an unknown name, or "" if no known name is close."""
    from difflib import get_close_matches  # which only errors need

    close = get_close_matches(name, list(known), 1, 0.6)
    return f"did you mean {close[0]!r}?" if close else ""


def suggest_name(name: str, known: Iterable[str]) -> str:
    """Return a tip for an undefined name: to import it if it belongs to the language, what the language has for a name
    of another language, or a did-you-mean."""
    if name in LANGUAGE_NAMES:
        return f"import it: from rhi.shading import {name}"
    if name in FOREIGN:
        return "; ".join(filter(None, (FOREIGN[name], suggest(name, known))))
    return suggest(name, [*known, *LANGUAGE_NAMES])
