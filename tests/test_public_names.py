"""Every public name says what it is."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

import renderer.frame
import renderer.lab.accuracy
import renderer.lab.measure
import renderer.scene
import renderer.techniques
import renderer.visibility
import rhi
import rhi.contract
import rhi.math
import rhi.shading
import rhi_screen

DERIVED = [rhi, rhi.contract]  # whose `__all__` follows from their imports
MODULES = [
    rhi,
    rhi.contract,
    rhi.math,
    rhi.shading,
    rhi_screen,
    renderer.scene,
    renderer.visibility,
    renderer.frame,
    renderer.techniques,
    renderer.lab.measure,
    renderer.lab.accuracy,
]


def undocumented(module: ModuleType) -> Iterator[str]:
    for name in module.__all__:
        thing = getattr(module, name)
        if inspect.isfunction(thing) and not thing.__doc__:
            yield name
        if not inspect.isclass(thing):
            continue
        docstring = thing.__dict__.get("__doc__")
        if not docstring or docstring.startswith(f"{name}("):  # what dataclass makes up is no description
            yield name
        for attribute, value in vars(thing).items():
            function = value.fget if isinstance(value, property) else getattr(value, "__func__", value)
            if not attribute.startswith("_") and inspect.isfunction(function) and not function.__doc__:
                yield f"{name}.{attribute}"


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_every_public_name_has_a_docstring(module: ModuleType) -> None:
    assert list(undocumented(module)) == []


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_public_names_are_listed_once_and_exist(module: ModuleType) -> None:
    assert len(set(module.__all__)) == len(module.__all__)
    assert all(hasattr(module, name) for name in module.__all__)


@pytest.mark.parametrize("module", DERIVED, ids=lambda module: module.__name__)
def test_a_derived_list_has_the_names_that_a_star_imports(module: ModuleType) -> None:
    scope: dict[str, object] = {}
    exec(f"from {module.__name__} import *", scope)
    del scope["__builtins__"]
    assert sorted(scope) == sorted(module.__all__)
    assert {"Device", "Backend"} & scope.keys()
    modules = {name for name, value in scope.items() if inspect.ismodule(value)}
    assert modules == ({"rules"} if module is rhi.contract else set())


@pytest.mark.slow
@pytest.mark.parametrize("module", DERIVED, ids=lambda module: module.__name__)
def test_type_checkers_resolve_the_names_of_a_derived_list(
    mypy_strict: Callable[..., tuple[str, int]], tmp_path: Path, module: ModuleType
) -> None:
    def check(names: list[str]) -> list[str]:
        file = tmp_path / "uses.py"
        file.write_text(
            "".join(f"from {module.__name__} import {name} as {name}\n" for name in names), encoding="utf-8"
        )
        return [line for line in mypy_strict(file)[0].splitlines() if "uses.py" in line]

    assert check(module.__all__) == []
    (error,) = check(["_list_public"])
    assert "does not explicitly export" in error
