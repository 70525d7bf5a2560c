"""Hot reload over many saves, whole and faulty: what is shown is always the last good text."""

from __future__ import annotations

import importlib
import itertools
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from nightly_reasons import ONLY_KERNELS
from shader_edits import DAMAGES, make_saves, replay

import rhi
from rhi import Format, Reloader, RhiError, ShaderError
from rhi.shading import Shader, from_source

_numbers = itertools.count()


def make_text(color: tuple[float, float, float]) -> str:
    """A module with a part of everything; the color is in a function, a constant and the class."""
    red, green, blue = color
    return f"""
from __future__ import annotations
from rhi.shading import FullScreen, Struct, function, vec3, vec4

GREEN = {green}

class Light(Struct):
    color: vec3

@function
def shine(blue: float) -> Light:
    return Light(color=vec3({red}, GREEN, blue))

class Base(FullScreen):
    def fragment(self) -> vec4:
        return vec4(0.0, 0.0, 0.0, 1.0)

class Mine(Base):
    blue = {blue}

    def fragment(self) -> vec4:
        return vec4(shine(self.blue).color, 1.0)

class Unused(Base):
    pass
"""


@pytest.fixture
def import_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Any]]:
    """Writes a text to a file of its own and imports it."""
    monkeypatch.syspath_prepend(str(tmp_path))
    names: list[str] = []

    def make(text: str) -> ModuleType:
        names.append(f"saved_{next(_numbers)}")
        (tmp_path / f"{names[-1]}.py").write_text(text, encoding="utf-8")
        importlib.invalidate_caches()
        return importlib.import_module(names[-1])

    yield make
    for name in names:
        del sys.modules[name]


class Canvas:
    """A device that draws one program."""

    def __init__(self, device: rhi.Device, shader: type[Shader]) -> None:
        self.device = device
        self.image, self.mesh = device.texture((4, 4), Format.RGBA8), device.mesh(3)
        self.program: Any = device.program(shader)

    def draw(self, program: Any = None) -> list[int]:
        with self.device.render_pass(self.image, clear=(0, 0, 0, 0)):
            self.device.draw(program or self.program, self.mesh)
        return self.image.read()[1, 1].tolist()  # type: ignore[no-any-return]

    def draw_afresh(self, text: str) -> list[int] | None:
        """The image of a text in a program that begins with it, by `from_source`, which knows of no reload."""
        try:
            shader = from_source(text, "Mine")
            if not (isinstance(shader, type) and issubclass(shader, Shader)):
                return None
            program: Any = self.device.program(shader)
        except RhiError:
            return None
        return self.draw(program)


def reloads(reloader: Reloader, module: ModuleType) -> Callable[[str], bool]:
    def save(text: str) -> bool:
        try:
            reloader.reload(module, text)
        except RhiError:
            return False
        return True

    return save


def check_saves(backend: str, module: Any, seed: int, count: int) -> None:
    with rhi.create_device(backend) as device, Reloader(device) as reloader:
        canvas = Canvas(device, module.Mine)
        saves = make_saves(make_text, seed)
        assert replay(saves, count, canvas.draw, reloads(reloader, module), canvas.draw_afresh) == []


@pytest.mark.parametrize("seed", range(4))
def test_the_last_good_text_is_shown_whatever_was_saved(import_text: Callable[[str], Any], seed: int) -> None:
    check_saves("gl", import_text(make_text((1.0, 0.4, 0.2))), seed, 60)


@pytest.mark.parametrize("backend", ["cl", "wgpu"])
def test_so_it_is_on_other_backends(import_text: Callable[[str], Any], backend: str) -> None:
    check_saves(backend, import_text(make_text((1.0, 0.4, 0.2))), 9, 3 if backend == "cl" else 8)


@pytest.mark.nightly_cases("*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
@pytest.mark.parametrize("seed", range(100, 103))
def test_hundreds_of_saves_end_in_the_last_good_text(
    import_text: Callable[[str], Any], backend: str, seed: int
) -> None:
    check_saves(backend, import_text(make_text((1.0, 0.4, 0.2))), seed, 400 if backend == "gl" else 60)


@pytest.mark.parametrize("name", DAMAGES)
def test_after_each_damage_the_next_good_text_is_shown(import_text: Callable[[str], Any], name: str) -> None:
    import random

    first = make_text((1.0, 0.4, 0.2))
    module = import_text(first)
    with rhi.create_device("gl") as device, Reloader(device) as reloader:
        canvas, save = Canvas(device, module.Mine), reloads(reloader, module)
        assert canvas.draw() == [255, 102, 51, 255]
        save(DAMAGES[name](first, random.Random(1)))
        assert save(make_text((0.2, 0.0, 1.0)))
        assert canvas.draw() == [51, 0, 255, 255]
        assert device.program(module.Mine) is canvas.program


def test_a_text_that_lacks_a_used_name_is_refused_at_its_end(import_text: Callable[[str], Any]) -> None:
    text = make_text((1.0, 0.4, 0.2))
    module = import_text(text)
    with rhi.create_device("null") as device, Reloader(device) as reloader:
        device.program(module.Mine)
        for cut, what in (("", "the text"), (text[: text.index("class Mine")], "Mine")):
            with pytest.raises(ShaderError, match=r"^\[shading-reload\]") as error:
                reloader.reload(module, cut)
            assert what in str(error.value)
            assert error.value.site is not None
            assert error.value.site.file == module.__file__
            assert "save the complete file again" in error.value.tip
        assert reloader.reload(module, text[: text.index("class Unused")]) == 0  # which nothing uses


def test_names_that_other_modules_use_are_not_removed(import_text: Callable[[str], Any]) -> None:
    """A function or a struct that was imported, and a class that another is derived from."""
    text = make_text((1.0, 0.4, 0.2))
    module = import_text(text)
    with rhi.create_device("null") as device, Reloader(device) as reloader:
        without = text.replace("def shine", "def glare").replace("shine(self.blue)", "glare(self.blue)")
        assert reloader.reload(module, without) == 0
        assert reloader.reload(module, text) == 0
        user = import_text(f"from {module.__name__} import shine, Base\nclass Derived(Base): pass\n")
        for cut in (without, text.replace("class Base", "class Bottom").replace("(Base)", "(Bottom)")):
            with pytest.raises(ShaderError, match=user.__name__):
                reloader.reload(module, cut)


@pytest.mark.parametrize("name", ["Unused", "Light", "shine"])
def test_a_definition_that_returns_is_the_same_object(import_text: Callable[[str], Any], name: str) -> None:
    text = make_text((1.0, 0.4, 0.2))
    module = import_text(text)
    before = getattr(module, name)
    with rhi.create_device("null") as device, Reloader(device) as reloader:
        for _ in range(3):
            reloader.reload(module, text.replace(name, f"Other{name}"))
            assert not hasattr(module, name)
            reloader.reload(module, text)
            assert getattr(module, name) is before


def test_a_refused_text_leaves_no_use_of_a_struct_behind(import_text: Callable[[str], Any]) -> None:
    """A text binds a struct and is refused; what it has bound was never there, so the struct may change."""
    text = make_text((1.0, 0.4, 0.2))
    module = import_text(text)
    binding = text.replace("    blue =", "    light: Uniform[Light]\n    blue =").replace(
        "Struct,", "Struct, Uniform,"
    )
    with rhi.create_device("null") as device, Reloader(device) as reloader:
        device.program(module.Mine)
        with pytest.raises(ShaderError):
            reloader.reload(module, binding.replace("shine(self.blue)", "nothing"))
        more = text.replace("    color: vec3\n", "    color: vec3\n    more: float\n")
        assert reloader.reload(module, more.replace("GREEN, blue)", "GREEN, blue), more=1.0")) == 1


def test_an_import_that_is_gone_is_missed_unless_python_uses_it(import_text: Callable[[str], Any]) -> None:
    """A name that a program with the new text would miss is reported; a name that a function that stays needs,
    stays."""
    text = make_text((1.0, 0.4, 0.2)).replace(
        "GREEN =", "from rhi.shading import cos\nimport cmath\n\nGREEN ="
    )
    text = text.replace("GREEN, blue", "GREEN * cos(0.0), blue")
    module = import_text(f"{text}\ndef phase():\n    return cmath.phase(1.0)\n")
    with rhi.create_device("null") as device, Reloader(device) as reloader:
        device.program(module.Mine)
        without = f"{text}\ndef phase():\n    return 0.0\n".replace("import cmath\n", "")
        assert reloader.reload(module, without) == 0
        assert module.phase() == 0.0
        with pytest.raises(ShaderError, match="cos"):
            reloader.reload(module, without.replace("from rhi.shading import cos\n", ""))
        assert hasattr(module, "cos")
