"""Zensical's command line, for which mkdocstrings inspects only modules that the reference documents.

    python scripts/zensical_pages.py build --strict --config-file mkdocs.yml

mkdocstrings inspects all modules of a package, and looks up the lines of each class and function in their files.
The reference shows no lines of source, and its names come from a few dozen modules. Without the others, and
without lines, the site builds in half the processor time.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import itertools
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

import griffe
from zensical.main import cli

sys.path.insert(0, str(Path(__file__).resolve().parent))

from build_site import MODULES


def list_documented_modules(modules: Iterable[str] = MODULES) -> frozenset[str]:
    """Return the modules of the reference, those that define its public names, and their parents.

    Public names whose modules are imported on first use become attributes, which mkdocstrings finds.
    """
    names = set(modules)
    for module in modules:
        imported = importlib.import_module(module)
        for name in getattr(imported, "__all__", ()):
            value = getattr(imported, name)
            setattr(imported, name, value)
            defined_in = value.__name__ if inspect.ismodule(value) else getattr(value, "__module__", None)
            names.add(str(defined_in or module))
    parents = {name.rsplit(".", depth)[0] for name in names for depth in range(name.count(".") + 1)}
    return frozenset(name for name in names | parents if name.partition(".")[0] == "rhi")


DOCUMENTED: Final = list_documented_modules()


class DocumentedModules(griffe.ModuleFinder):
    """A finder of submodules that leaves out those without a documented name."""

    def submodules(self, module: griffe.Module) -> list[tuple[tuple[str, ...], Path]]:
        """Return the parts of the name and the path of each documented module below a top module."""
        return [
            (parts, path)
            for parts, path in super().submodules(module)
            if ".".join((module.path, *parts)) in DOCUMENTED
        ]


def read_attribute_docstrings(tree: ast.Module) -> dict[str, str]:
    """Return the strings below assignments of a module and its classes, by `NAME` or `Class.name`."""
    docstrings: dict[str, str] = {}
    scopes = [("", tree.body)]
    scopes += [(f"{node.name}.", node.body) for node in tree.body if isinstance(node, ast.ClassDef)]
    for prefix, body in scopes:
        for statement, following in itertools.pairwise(body):
            text = following.value if isinstance(following, ast.Expr) else None
            targets: list[ast.expr] = [statement.target] if isinstance(statement, ast.AnnAssign) else []
            targets += statement.targets if isinstance(statement, ast.Assign) else []
            if isinstance(text, ast.Constant) and isinstance(text.value, str):
                names = [target.id for target in targets if isinstance(target, ast.Name)]
                docstrings.update((prefix + name, inspect.cleandoc(text.value)) for name in names)
    return docstrings


def read_annotations(tree: ast.Module) -> dict[str, dict[str, str]]:
    """Return the annotations of parameters of a module's functions, by `function` or `Class.method`."""
    scopes = [("", tree.body)]
    scopes += [(f"{node.name}.", node.body) for node in tree.body if isinstance(node, ast.ClassDef)]
    return {
        prefix + node.name: {
            argument.arg: ast.unparse(argument.annotation)
            for argument in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            if argument.annotation is not None
        }
        for prefix, body in scopes
        for node in body
        if isinstance(node, ast.FunctionDef)
    }


class SourceTexts(griffe.Extension):
    """Corrects objects by their source: docstrings of attributes, and annotations.

    Inspection alone shows the docstring of a value's type instead of the attribute's.
    """

    def __init__(self) -> None:
        types = (bool, bytes, dict, float, frozenset, int, list, set, str, tuple)
        self.of_types = {inspect.getdoc(kind) for kind in types}
        self.in_source: dict[str, str] = {}
        self.annotations: dict[str, dict[str, str]] = {}
        for name in sorted(DOCUMENTED):
            file = importlib.import_module(name).__file__
            if file is not None and file.endswith(".py"):
                tree = ast.parse(Path(file).read_text(encoding="utf-8"))
                self.in_source |= read_attribute_docstrings(tree)
                self.annotations |= read_annotations(tree)

    def on_attribute_instance(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Set the docstring of an attribute, or remove that of its type."""
        parent = f"{attr.parent.name}." if attr.parent is not None and attr.parent.is_class else ""
        text = self.in_source.get(parent + attr.name)
        if text is not None:
            attr.docstring = griffe.Docstring(text, parent=attr, parser="google")
        elif attr.docstring is not None and attr.docstring.value in self.of_types:
            attr.docstring = None

    def on_function_instance(self, *, func: griffe.Function, **_: Any) -> None:
        """Set annotations with `ArrayLike` to those of the source; inspection takes it for any union."""
        parent = f"{func.parent.name}." if func.parent is not None and func.parent.is_class else ""
        texts = self.annotations.get(parent + func.name, {})
        for parameter in func.parameters:
            if "ArrayLike" in str(parameter.annotation):
                parameter.annotation = texts.get(parameter.name, parameter.annotation)


class ReferenceLoader(griffe.GriffeLoader):
    """A loader of the documented modules that keeps no lines of source."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{**options, "store_source": False})
        self.extensions.add(SourceTexts())
        self.finder = DocumentedModules(options.get("search_paths"))


def main() -> None:
    """Run Zensical."""
    from mkdocstrings_handlers.python._internal import handler

    with patch.object(handler, "GriffeLoader", ReferenceLoader):
        cli()


if __name__ == "__main__":
    main()
