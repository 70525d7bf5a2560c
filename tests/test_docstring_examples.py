"""The examples of docstrings run, each in the names below, on the null device.

A reader of the reference finds these names in the tutorial's sense: a `device`, an `image` that is drawn to, a
`program`, a `mesh`, and a texture `albedo`.
"""

from __future__ import annotations

import doctest
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import rhi
import rhi.math
import rhi.shading as sl
import rhi.testing
import rhi.testing.portability
import rhi.trace
import rhi_screen
from rhi.backends.null import NullBackend

MODULES = (rhi, rhi.math, sl, rhi.testing, rhi.testing.portability, rhi.trace, rhi_screen)
LEAST_EXAMPLES = 80


class Corner(sl.Struct):
    """A vertex of the examples' mesh."""

    position: sl.vec2


class Tint(sl.Struct):
    """A struct of constants."""

    color: sl.vec4


class Flat(sl.Shader):
    """A shader with a number as its constant."""

    tint: sl.Uniform[sl.vec4]

    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position, 0.5, 1.0)

    def fragment(self) -> sl.vec4:
        return self.tint


class Tinted(sl.Shader):
    """A shader with a struct of constants."""

    tint: sl.Uniform[Tint]

    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position, 0.5, 1.0)

    def fragment(self) -> sl.vec4:
        return self.tint.color


class Show(sl.FullScreen):
    """A shader with a texture."""

    albedo: sl.Texture2D

    def fragment(self) -> sl.vec4:
        return self.albedo.sample(sl.vec2(0.5))


class Double(sl.Shader):
    """A compute shader."""

    work_group = (64,)
    numbers: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        if i < len(self.numbers):
            self.numbers[i] *= 2.0


@sl.function
def falloff(distance: float, radius: float) -> float:
    """A function of numbers."""
    return sl.saturate(1.0 - distance / radius)


def list_public(module: ModuleType) -> list[str]:
    """The public names of a module."""
    return list(
        getattr(module, "__all__", None) or [name for name in vars(module) if not name.startswith("_")]
    )


def list_members(owner: type) -> Iterator[tuple[str, object]]:
    """The methods and properties of a public class, those of its bases included."""
    for name in dir(owner):
        member = inspect.getattr_static(owner, name)
        function = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
        if not name.startswith("_") and inspect.isfunction(function):
            yield name, function


def list_documented() -> dict[str, str]:
    """The docstrings with an example, by the public name that has it; each docstring once."""
    documented: dict[str, str] = {}
    for module in MODULES:
        for name in list_public(module):
            entry = getattr(module, name)
            entries = [(f"{module.__name__}.{name}", entry)]
            if inspect.isclass(entry):
                entries += [(f"{entries[0][0]}.{member}", value) for member, value in list_members(entry)]
            for path, value in entries:
                text = getattr(value, "__doc__", None) or ""
                is_ours = (getattr(value, "__module__", None) or "").startswith(("rhi.", "rhi_screen."))
                if is_ours and ">>>" in text and text not in documented.values():
                    documented[path] = text
    return {path: inspect.cleandoc(text) for path, text in documented.items()}


DOCUMENTED = list_documented()


def run_examples(text: str, names: dict[str, Any], path: str) -> list[str]:
    """Run a docstring's examples, and return what is wrong with them."""
    failures: list[str] = []
    example = doctest.DocTestParser().get_doctest(text, names, path, None, 0)
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(example, out=failures.append, clear_globs=False)
    return failures


@pytest.fixture
def names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Any]]:
    """The names that examples use."""
    monkeypatch.chdir(tmp_path)
    with rhi.create_device("null") as device:
        device.backend_as(NullBackend).count_samples(lambda draw: 100)
        corners = {"position": np.array([(-1, -1), (1, -1), (0, 1)], np.float32)}
        public = {name: getattr(module, name) for module in MODULES[1:] for name in list_public(module)}
        yield {
            **{name: value for name, value in public.items() if getattr(sl, name, None) is not value},
            "np": np,
            "rhi": rhi,
            "sl": sl,
            "device": device,
            "image": device.texture((64, 48), rhi.Format.RGBA8, label="image"),
            "albedo": device.texture((4, 4), rhi.Format.RGBA8, label="albedo"),
            "program": device.program(Flat),
            "mesh": device.mesh(corners, label="triangle"),
            **{entry.__name__: entry for entry in (Corner, Tint, Flat, Tinted, Show, Double)},
            "falloff": falloff,
        }


@pytest.mark.parametrize("path", DOCUMENTED)
def test_the_examples_of_a_docstring_run(path: str, names: dict[str, Any]) -> None:
    assert run_examples(DOCUMENTED[path], names, path) == []


def test_the_most_used_names_have_examples() -> None:
    assert len(DOCUMENTED) >= LEAST_EXAMPLES
    for owner in (rhi.Device, rhi.Texture, rhi.Buffer):
        documented = [name for name in DOCUMENTED if name.startswith(f"rhi.{owner.__name__}.")]
        assert len(documented) >= 4, owner


def test_an_example_with_another_result_fails(names: dict[str, Any]) -> None:
    assert run_examples("Size.\n\n>>> image.size\n(64, 48)\n", names, "right") == []
    assert len(run_examples("Size.\n\n>>> image.size\n(64, 49)\n", names, "wrong")) == 1


if __name__ == "__main__":
    print("\n".join(DOCUMENTED))
    sys.exit()
