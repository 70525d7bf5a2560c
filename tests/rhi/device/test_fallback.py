"""Modules of shaders that are at fault at a start are as they were drawn with last, until their files are
right."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")

import rhi
from rhi import Format, PersistentDict, Reloader
from rhi.device import fallback
from rhi.shading import FullScreen, vec4
from rhi.shading.language.edits import text_of

NAMES = ("kept_colors", "kept_shaders")
COLORS = """
from rhi.shading import function, vec4

@function
def paint(red: float) -> vec4:
    return vec4(red, 0.0, 1.0, 1.0)
"""
TEXT = """
from rhi.shading import FullScreen, Uniform, vec4
from kept_colors import paint

class Plain(FullScreen):
    def fragment(self) -> vec4:
        return paint(1.0)
"""
STRUCT = """
from rhi.shading import Struct, vec4

class Paint(Struct):
    color: vec4
"""
TEXT_OF_STRUCT = TEXT.replace("import paint", "import Paint").replace(
    "paint(1.0)", "Paint(color=vec4(1.0)).color"
)
FAULTS = {
    "syntax": TEXT.replace("paint(1.0)", "paint(1.0"),
    "shader": TEXT.replace("paint(1.0)", "paint(one)"),
    "binding": TEXT.replace("paint(1.0)", "paint(self.more)\n\n    more: Uniform[float]"),
}


class Unconcerned(FullScreen):
    def fragment(self) -> vec4:
        return vec4(1.0)


@pytest.fixture
def begin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., tuple[Reloader, int]]]:
    """Draws a frame with these files, as a new process does; returns what watches them, and how red a pixel
    is."""
    monkeypatch.setenv("RHI_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # files are changed within a second
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    rhi.install_fallback()

    def begin(
        text: str = TEXT, colors: str = COLORS, keeps: bool = True, device: rhi.Device | None = None
    ) -> tuple[Reloader, int]:
        device = device or null
        for name, content in zip(NAMES, (colors, text), strict=True):
            (tmp_path / f"{name}.py").write_text(content, encoding="utf-8")
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        module, reloader = importlib.import_module(NAMES[1]), Reloader(device)

        def draw() -> int:
            program, image = device.program(module.Plain), device.texture((4, 4), Format.RGBA8)
            with device.render_pass(image):
                device.draw(program, device.mesh(3))
            return int(image.read()[1, 1, 0])

        try:
            red = draw()
        except Exception as error:
            if not reloader.roll_back(error):
                raise
            red = draw()
        reloader.watch(*(sys.modules[name] for name in NAMES))
        if keeps:
            reloader.checkpoint()
        reloader.close()
        return reloader, red

    with rhi.create_device("null") as null:
        yield begin
    for name in NAMES:
        sys.modules.pop(name, None)


def save(reloader: Reloader, path: Path, text: str) -> bool:
    """Save a file, and exchange it."""
    path.write_text(text, encoding="utf-8")
    reloader._note([{(None, str(path))}])
    return reloader.update()


@pytest.mark.parametrize("backend", ["gl", "cl"])
def test_a_faulty_module_is_drawn_with_as_it_was_last(begin: Any, backend: str) -> None:
    texts = (TEXT, FAULTS["syntax"], FAULTS["shader"], TEXT.replace("1.0", "0.0"), FAULTS["binding"])
    with rhi.create_device(backend) as device:
        assert [begin(text, device=device)[1] for text in texts] == [255, 255, 255, 0, 0]


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_reported_until_the_file_is_right(begin: Any, tmp_path: Path, fault: str) -> None:
    begin()
    reloader, _ = begin(FAULTS[fault])
    assert reloader.reloaded == (fault != "syntax"), "which the import has replaced"
    path = tmp_path / "kept_shaders.py"
    if fault == "binding":  # which only a frame finds
        assert reloader.update()
        assert reloader.roll_back(ValueError("nothing is bound"))
    else:
        assert not reloader.update()
    assert list(reloader.errors) == [path]
    assert save(reloader, path, TEXT.replace("1.0", "0.25"))
    assert reloader.errors == {}
    assert "paint(0.25)" in text_of(sys.modules[path.stem])


@pytest.mark.parametrize("fault", FAULTS)
def test_without_a_saved_text_a_start_fails(begin: Any, tmp_path: Path, fault: str) -> None:
    begin(keeps=False)
    with pytest.raises((SyntaxError, rhi.RhiError)):
        begin(FAULTS[fault])


def test_if_the_saved_texts_fail_too_the_first_error_is_raised(
    begin: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin()
    begin(FAULTS["syntax"])
    monkeypatch.setattr(fallback, "execute", lambda *_: 1 / 0)
    with pytest.raises(SyntaxError):
        begin(FAULTS["syntax"])


@pytest.mark.parametrize(
    ("text", "colors"), [(TEXT, COLORS), (TEXT_OF_STRUCT, STRUCT)], ids=["function", "struct"]
)
def test_only_modules_that_a_program_uses_are_saved(begin: Any, text: str, colors: str) -> None:
    begin(text, colors, keeps=False)
    with rhi.create_device("null") as device, Reloader(device) as reloader:
        reloader.watch(*(sys.modules[name] for name in NAMES))
        for shader, count in ((Unconcerned, 0), (sys.modules[NAMES[1]].Plain, 2)):
            device.program(shader)
            reloader.checkpoint()
            assert len(PersistentDict("texts", 9)) == count


def test_the_last_good_text_returns_if_another_module_misses_a_name(begin: Any, tmp_path: Path) -> None:
    begin()
    begin(colors=COLORS.replace("paint", "tint"))
    assert text_of(sys.modules["kept_colors"]) == COLORS


def test_modules_that_only_go_together_do(begin: Any, tmp_path: Path) -> None:
    """At a start, and when both are right again."""
    begin()
    text = TEXT.replace("paint(", "paint(HALF, ").replace("import paint", "import HALF, paint")
    colors = COLORS.replace("(red: float)", "(green: float, red: float)") + "\nHALF = 0.5\n"
    reloader, _ = begin(text.replace("HALF, 1.0", "HALF, one"), colors)
    paths = {tmp_path / f"{name}.py" for name in NAMES}
    assert not reloader.update()
    assert set(reloader.errors) == paths
    assert save(reloader, tmp_path / "kept_shaders.py", text)
    assert reloader.errors == {}
    (tmp_path / "cache/dictionaries/texts.json").unlink()
    assert reloader.roll_back(ValueError("drawn with neither"))
    assert set(reloader.errors) == paths


def test_the_first_update_says_whether_a_module_is_not_as_it_was_drawn_with(
    begin: Any, tmp_path: Path
) -> None:
    seen = []
    for red in ("1.0", "1.0", "0.0", "0.0"):
        reloader, _ = begin(TEXT.replace("1.0", red))
        seen.append([reloader.update(), reloader.update()])
    assert seen == [[False, False], [False, False], [True, False], [False, False]]


def test_a_file_that_is_saved_while_the_program_begins_is_taken(begin: Any, tmp_path: Path) -> None:
    begin()
    (tmp_path / "kept_shaders.py").write_text(TEXT.replace("1.0", "0.75"), encoding="utf-8")
    with Reloader() as reloader:
        reloader.watch(sys.modules["kept_shaders"])
        assert [reloader.update(), reloader.update()] == [True, False]


def test_an_import_of_a_missing_package_changes_no_shader(begin: Any, tmp_path: Path) -> None:
    begin()
    (tmp_path / "needs_more.py").write_text("import a_package_that_is_missing", encoding="utf-8")
    optional = "import contextlib\nwith contextlib.suppress(ImportError):\n    import needs_more\n"
    text = TEXT.replace("1.0", "0.5")
    begin(text, keeps=False)
    importlib.invalidate_caches()
    exec(optional, {})
    assert text_of(sys.modules["kept_shaders"]) == text
