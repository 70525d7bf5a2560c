"""The Python source of shaders: syntax trees of functions, the names they can use, and errors that point into
them.

- `keep_sources` stores the text of a file when one of its classes or functions is created. A later edit
  changes neither the compiled class nor the lines in its errors. The text is parsed when a shader is
  compiled.
- Functions are found in their file by their first line. Notebook cells and interpreters work wherever
  `linecache` knows their lines.
- `NameScope` resolves a name as the function itself would: variables of enclosing functions, globals,
  builtins.
- Annotations may be strings, and closures don't capture names that only annotations use.
  `resolve_annotations` evaluates them when the class or function is defined, while those names still exist.
"""

from __future__ import annotations

import ast
import builtins
import contextlib
import linecache
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from types import FrameType, FunctionType
from typing import Any, ClassVar, Final, NoReturn

from rhi.errors import Rule, ShaderError
from rhi.errors.call_sites import CallSite
from rhi.errors.data_classes import dataclass
from rhi.errors.shared_caches import SHARED
from rhi.shading.language import rules
from rhi.shading.language.tips import FOREIGN
from rhi.shading.language.types import LANGUAGE_NAMES

MISSING: Final = object()
_SOURCE: Final = "_rhi_source"


class SourceFile(str):
    """A Python file: its name, and its lines at the time when one of its classes or functions was created.

    Attributes:
        lines: with their ends.
        spec: the `__spec__` of its module.
        is_pinned: whether these lines hold whatever the file has now.
    """

    lines: list[str]
    spec: object
    is_pinned: bool = False

    def __reduce__(self) -> tuple[Any, ...]:
        return str, (str(self),)

    @cached_property
    def functions(self) -> dict[int, ast.FunctionDef]:
        """The functions of the file by their first line, that of a decorator included. The file is parsed
        here."""
        try:
            tree = ast.parse("".join(self.lines), self)
        except SyntaxError:
            return {}
        mangle_private_names(tree, "".join(self.lines))
        functions: dict[int, ast.FunctionDef] = {}
        stack: list[ast.AST] = [tree]
        while stack:
            node = stack.pop()
            if isinstance(node, ast.FunctionDef):
                first = node.decorator_list[0].lineno if node.decorator_list else node.lineno
                functions[first] = node
            stack.extend(child for child in ast.iter_child_nodes(node) if isinstance(child, ast.stmt))
        return functions


_PRIVATE: Final = re.compile(r"(?<!\w)__(?!\w*__(?!\w))\w")
"""The beginning of a name that Python mangles in classes."""


def mangle_name(name: str, cls: str) -> str:
    """Return the name that Python gives a private name (`__x`) in the body of a class; other names as they
    are."""
    owner = cls.lstrip("_")
    return f"_{owner}{name}" if owner and name.startswith("__") and not name.endswith("__") else name


def mangle_private_names(tree: ast.AST, text: str) -> None:
    """Mangle the private names in all classes of a syntax tree, as Python's compiler does.

    Names of keyword arguments and of functions stay, as in Python's code objects.
    """
    if not _PRIVATE.search(text):
        return
    stack = [(tree, "")]
    while stack:
        node, cls = stack.pop()
        match node:
            case ast.Name():
                node.id = mangle_name(node.id, cls)
            case ast.Attribute():
                node.attr = mangle_name(node.attr, cls)
            case ast.arg():
                node.arg = mangle_name(node.arg, cls)
        for child in ast.iter_child_nodes(node):
            inside = isinstance(node, ast.ClassDef) and child in node.body
            stack.append((child, node.name if inside and isinstance(node, ast.ClassDef) else cls))


INVALIDATION_CALLBACKS: Final[list[Callable[[], object]]] = []
"""Functions that are called when classes or functions have changed, to discard what was derived from them."""

_files: dict[str, SourceFile] = {}
"""The last version read of each file, by name."""


def read_file(name: str, names: Mapping[str, Any]) -> SourceFile:
    """Return a file with its lines, from the cache unless its module was replaced or imported again.

    A class that is created after the import thus has the text that was imported. Scripts and notebook cells
    are compared with the file each time, unless the text is pinned. The text of a module that
    `rhi.shading.language.modules` makes comes with it.

    Args:
        names: the globals of a function in the file.
    """
    spec, cached = names.get("__spec__"), _files.get(name)
    state = getattr(spec, "loader_state", None)
    if isinstance(state, SourceFile) and state == name:
        return state
    if cached is not None and (cached.is_pinned or (spec is not None and cached.spec is spec)):
        return cached
    linecache.checkcache(name)
    lines = linecache.getlines(name, dict(names) if name not in linecache.cache else None)
    if cached is None or spec is not cached.spec or cached.lines != lines:
        cached = SourceFile(name)
        cached.lines, cached.spec = lines, spec
        _files[name] = cached
    return cached


@dataclass(frozen=True, slots=True)
class SourceSpan:
    """A span of a source line. Lines count from 1, columns from 0 in UTF-8 bytes; `end_column` 0 is the
    line's end."""

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
        generation: how often the annotations of functions have changed; older signatures are read again.
    """

    __slots__ = ("_node", "file", "function", "name", "scope", "signature")

    generation: ClassVar[int] = 0

    def __init__(self, function: FunctionType, file: SourceFile) -> None:
        self.signature: Any = None  # kept here by rhi.shading.parser.signatures, with `generation`
        self.function = function
        self.file = file
        self.name = function.__qualname__.replace("<locals>.", "")
        self.scope = NameScope(function)
        self._node: ast.FunctionDef | None = None

    @property
    def node(self) -> ast.FunctionDef:
        """The function's syntax tree.

        Raises:
            ShaderError: `shading-no-source`: the file has no text, or its text isn't the one that Python ran.
        """
        if self._node is None:
            code = self.function.__code__
            parsed = self.file.functions.get(code.co_firstlineno)
            if parsed is None or parsed.name != code.co_name:
                actual = f"{self.file}, without `{code.co_name}` on line {code.co_firstlineno}"
                raise ShaderError(rules.NO_SOURCE, self.name, actual if self.file.lines else str(self.file))
            self._node = parsed
        return self._node

    def refuse(
        self, rule: Rule, at: ast.AST | SourceSpan, actual: str = "", allowed: str = "", tip: str = ""
    ) -> NoReturn:
        """Raise a `ShaderError` that shows the source line of `at` with carets below it."""
        span = at if isinstance(at, SourceSpan) else span_of(at)
        refuse_at(rule, self.name, self.file, span, actual, allowed, tip)


def refuse_at(
    rule: Rule, function: str, file: str, span: SourceSpan, actual: str, allowed: str = "", tip: str = ""
) -> NoReturn:
    """Raise a `ShaderError` that shows the source line of a span of a function."""
    site = CallSite(str(file), span.line, function)
    raise ShaderError(rule, f"{function}\n{show(file, span)}", actual, allowed, tip, site)


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
    """Return a line of a file, from the stored text if a shader in it has been created."""
    source_file = file if isinstance(file, SourceFile) else _files.get(file)
    if source_file is None:
        return linecache.getline(file, number)
    return source_file.lines[number - 1] if 0 < number <= len(source_file.lines) else ""


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
    """Return the globals of a class's module, or of the frame that defines the class if the module isn't
    imported."""
    module = sys.modules.get(cls.__module__)
    return vars(module) if module is not None else frame.f_globals


def resolve_annotations(function: FunctionType, names: Mapping[str, Any]) -> None:
    """Evaluate a function's string annotations with the names around it. Annotations that fail stay
    strings."""
    for name, annotation in function.__annotations__.items():
        if isinstance(annotation, str):
            with contextlib.suppress(Exception):
                function.__annotations__[name] = eval(annotation, function.__globals__, dict(names))


def keep_sources(members: Mapping[str, object]) -> None:
    """Store the text of the files that define the functions among a class's members."""
    for name, member in members.items():
        function = member.__func__ if isinstance(member, staticmethod) else member
        if isinstance(function, FunctionType) and not name.startswith("__"):
            source_of(function)


def source_of(function: FunctionType) -> Source:
    """Return a function's source, which is stored on the function."""
    source: Source | None = getattr(function, _SOURCE, None)
    if source is None:
        with SHARED:
            source = getattr(function, _SOURCE, None)
            if source is None:
                file = read_file(function.__code__.co_filename, function.__globals__)
                source = Source(function, file)
                setattr(function, _SOURCE, source)
    return source


def set_source(function: FunctionType, file: SourceFile) -> None:
    """Set the file from which a function's source is read."""
    setattr(function, _SOURCE, Source(function, file))


def pin_source(name: str, names: Mapping[str, Any]) -> None:
    """Keep the text of a script as it is now, whatever is saved, until `exchange_source` replaces it."""
    with SHARED:
        read_file(name, names).is_pinned = True


def exchange_source(file: SourceFile | None, name: str = "") -> SourceFile | None:
    """Replace the stored text of a file, for later classes, functions and errors; return the earlier one."""
    name = str(file) if file is not None else name
    with SHARED:
        before = _files.pop(name, None)
        if file is not None:
            _files[name] = file
        linecache.checkcache(name)
    return before


def forget_signatures() -> None:
    """Discard all signatures, since the structs in them may have changed, and all code compiled for the
    CPU."""
    with SHARED:
        Source.generation += 1
        for forget in INVALIDATION_CALLBACKS:
            forget()


def suggest(name: str, candidates: Iterable[str]) -> str:
    """Return a did-you-mean tip for an unknown name, or "" if no known name is close."""
    from difflib import get_close_matches  # imported only for errors

    close = get_close_matches(name, list(candidates), 1, 0.6)
    return f"did you mean {close[0]!r}?" if close else ""


def suggest_name(name: str, candidates: Iterable[str]) -> str:
    """Return a tip for an undefined name: an import, the equivalent of another language's name, or a
    did-you-mean."""
    if name in LANGUAGE_NAMES:
        return f"import it: from rhi.shading import {name}"
    if name in FOREIGN:
        return "; ".join(filter(None, (FOREIGN[name], suggest(name, candidates))))
    return suggest(name, [*candidates, *LANGUAGE_NAMES])
