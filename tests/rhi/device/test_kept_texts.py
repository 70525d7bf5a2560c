"""Modules of shaders that are at fault at a start are as they were drawn with last, until their files are right."""

from __future__ import annotations

import importlib
import itertools
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")

import rhi
from rhi import Format, Op, Reloader
from rhi.device import kept_texts
from rhi.device.kept_texts import FallbackFinder
from rhi.shading.language.edits import text_of

COLORS = """
from rhi.shading import function, vec4

@function
def paint(red: float) -> vec4:
    return vec4(red, 0.0, 1.0, 1.0)
"""
SHADERS = """
from rhi.shading import FullScreen, Struct, Uniform, vec4
from colors_{} import paint

class Plain(FullScreen):
    def fragment(self) -> vec4:
        return paint(1.0)

class Other(FullScreen):
    def fragment(self) -> vec4:
        return paint(0.5)
"""
_numbers = itertools.count()
FAULTS = {
    "syntax": ("return paint(1.0)", "return paint(1.0"),
    "exception": ("class Plain", "1 / 0\n\nclass Plain"),
    "struct": ("class Plain", "class Bad(Struct):\n    field: str\n\nclass Plain"),
    "shader": ("return paint(1.0)", "return paint(one)"),
    "binding": ("        return paint(1.0)", "        return paint(self.more)\n\n    more: Uniform[float]"),
}


class Project:
    """Two modules in a folder, of which a program is begun again and again, as by new processes.

    Attributes:
        path: the file of the shaders, which import what `colors` defines.
    """

    def __init__(self, folder: Path, number: int) -> None:
        self.colors, self.path = folder / f"colors_{number}.py", folder / f"shaders_{number}.py"
        self.text = SHADERS.format(number)
        self.colors.write_text(COLORS)
        self.path.write_text(self.text)

    def change(self, old: str, new: str, path: Path | None = None) -> None:
        """Save an edit of the text as it was first."""
        text = COLORS if path == self.colors else self.text
        assert old in text
        (path or self.path).write_text(text.replace(old, new))

    def forget(self) -> None:
        for path in (self.colors, self.path):
            sys.modules.pop(path.stem, None)
        importlib.invalidate_caches()

    def load(self) -> Any:
        """Import the modules as a new process does, which has no old bytecode of files that were changed just now."""
        self.forget()
        return importlib.import_module(self.path.stem)

    def begin(self, device: rhi.Device, shader: str = "Plain", keeps: bool = True) -> tuple[Reloader, list[int]]:
        """Draw a first frame; return what watches the modules, and a pixel."""
        module = self.load()
        reloader = Reloader(device)

        def draw() -> list[int]:
            program, mesh = device.program(getattr(module, shader)), device.mesh(3)
            image = device.texture((4, 4), Format.RGBA8)
            with device.render_pass(image, clear=(0, 0, 0, 1)):
                device.draw(program, mesh)
            device.present(image)
            return image.read()[1, 1].tolist() if device.capabilities.shading else []

        pixel = reloader.attempt(draw)
        reloader.watch(sys.modules[self.colors.stem], module)
        if keeps:
            reloader.keep()
        reloader.close()
        return reloader, pixel


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of kept texts."""
    monkeypatch.setenv("RHI_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "texts"


@pytest.fixture
def project(kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Project]:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    rhi.install_fallback()
    made = Project(tmp_path, next(_numbers))
    yield made
    made.forget()


def begin(project: Project, **options: Any) -> tuple[Reloader, int]:
    """Begin the program on null; return what watches its modules, and how many programs were created."""
    with rhi.create_device("null") as device:
        reloader = project.begin(device, **options)[0]
        return reloader, sum(command.op is Op.CREATE_PROGRAM for command in device.stream)


def save(reloader: Reloader, path: Path) -> bool:
    """Exchange a file that was saved just now."""
    reloader._note([{(None, str(path))}])
    return reloader.update()


@pytest.mark.parametrize("backend", ["gl", "cl"])
def test_a_faulty_module_is_drawn_with_as_it_was_last(backend: str, project: Project) -> None:
    seen = []
    with rhi.create_device(backend) as device:
        for old, new in (("", ""), FAULTS["syntax"], FAULTS["shader"], ("paint(1.0)", "paint(0.0)"), FAULTS["syntax"]):
            project.change(old, new)
            seen.append(project.begin(device)[1][0])
    assert seen == [255, 255, 255, 0, 0]


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_reported_until_the_file_is_right(project: Project, fault: str) -> None:
    assert begin(project)[1] == 1
    project.change(*FAULTS[fault])
    with rhi.create_device("null") as device:
        reloader, _ = project.begin(device)
        if fault == "binding":  # which only a frame finds
            assert reloader.update()
            assert reloader.put_back(ValueError("nothing is bound"))
        else:
            assert not reloader.update()
        assert list(reloader.errors) == [project.path]
        project.change("paint(1.0)", "paint(0.25)")
        assert save(reloader, project.path)
        assert reloader.errors == {}
        assert "paint(0.25)" in reloader._texts[project.path.stem]


@pytest.mark.parametrize("fault", FAULTS)
def test_without_a_kept_text_a_start_fails_as_ever(project: Project, fault: str) -> None:
    begin(project, keeps=False)
    project.change(*FAULTS[fault])
    with pytest.raises(Exception) as falling:  # noqa: PT011
        begin(project)
    sys.meta_path[:] = [finder for finder in sys.meta_path if not isinstance(finder, FallbackFinder)]
    with rhi.create_device("null") as device, pytest.raises(type(falling.value)) as plain:
        image = device.texture((4, 4), Format.RGBA8)
        program = device.program(project.load().Plain)
        with device.render_pass(image):
            device.draw(program, device.mesh(3))
    assert str(plain.value).splitlines()[0] == str(falling.value).splitlines()[0]


def test_a_start_without_faults_compiles_what_it_draws_with(project: Project) -> None:
    """So does one with a fault of Python, and one of a shader, which is found before its program is created."""
    for name in ("syntax", "struct", "shader"):
        project.path.write_text(project.text)
        assert begin(project)[1] == 1
        project.change(*FAULTS[name])
        assert begin(project)[1] == 1


def test_what_no_frame_has_drawn_with_is_not_kept(project: Project, kept: Path) -> None:
    begin(project, keeps=False)
    assert list(kept.glob("*")) == []
    begin(project)
    assert len(list(kept.glob("*"))) == 2
    project.change(*FAULTS["syntax"])
    begin(project)
    assert len(list(kept.glob("*"))) == 2


def test_a_module_of_which_nothing_is_drawn_is_not_kept(project: Project, kept: Path) -> None:
    project.colors.write_text(
        "from rhi.shading import function\n\n@function\ndef unused(x: float) -> float:\n    return x\n"
    )
    project.text = project.text.replace(f"from {project.colors.stem} import paint", f"import {project.colors.stem}")
    project.change("paint(1.0)", "vec4(1.0)")
    begin(project, keeps=False)
    reloader = Reloader()
    reloader.watch(sys.modules[project.colors.stem])
    reloader.keep()
    reloader.close()
    assert not kept.exists() or not list(kept.glob("*"))


def test_a_fault_that_no_frame_has_met_goes_back_further(project: Project) -> None:
    begin(project)
    for text in ("paint(half)", "paint(haf)"):
        project.change("paint(0.5)", text)
        begin(project)
    reloader, programs = begin(project, shader="Other")
    assert programs == 1
    assert "paint(0.5)" in reloader._texts[project.path.stem]
    project.change("paint(0.5)", "paint(hal)")
    assert begin(project)[1] == 1, "the control draws with another one"


def test_what_another_module_misses_comes_back(project: Project) -> None:
    begin(project)
    project.change("def paint", "def tint", project.colors)
    reloader, programs = begin(project)
    assert programs == 1
    assert "def paint" in reloader._texts[project.colors.stem]


def test_modules_that_only_go_together_do(project: Project) -> None:
    """At a start, and when both are right again."""
    begin(project)
    project.colors.write_text(COLORS.replace("(red: float)", "(green: float, red: float)") + "\nHALF = 0.5\n")
    text = project.text.replace("paint(", "paint(HALF, ").replace("import paint", "import HALF, paint")
    project.path.write_text(text.replace("HALF, 1.0", "HALF, one"))
    with rhi.create_device("null") as device:
        reloader, _ = project.begin(device)
        assert not reloader.update()
        assert set(reloader.errors) == {project.colors, project.path}
        project.path.write_text(text)
        assert save(reloader, project.path)
        assert reloader.errors == {}
        assert reloader.put_back(ValueError("drawn with neither"))
        assert set(reloader.errors) == {project.colors, project.path}


def test_a_start_that_fails_with_all_texts_keeps_the_present_one(project: Project) -> None:
    begin(project)
    project.change("paint(1.0)", "paint(0.0)")
    module, reds = project.load(), []

    def fail() -> None:
        reds.append([red for red in ("(0.0)", "(1.0)") if f"paint{red}" in text_of(module)])
        raise ValueError(f"start {len(reds)}")

    with pytest.raises(ValueError, match="start 1"):
        Reloader().attempt(fail)
    assert reds == [["(0.0)"], ["(1.0)"]]
    assert "paint(0.0)" in text_of(module)


def test_modules_that_are_watched_before_a_start_are_looked_at_after_it(project: Project) -> None:
    begin(project)
    project.change("paint(1.0)", "paint(0.0)")
    module = project.load()
    with Reloader() as reloader:
        reloader.watch(module)
        assert reloader.attempt(lambda: 1 / ("paint(1.0)" in text_of(module))) == 1.0
        assert reloader.update()
        assert "paint(0.0)" in text_of(module)


def test_the_text_that_was_drawn_with_last_comes_back(project: Project) -> None:
    for red in (1.0, 0.25, 1.0):
        project.change("paint(1.0)", f"paint({red})")
        begin(project)
    project.change(*FAULTS["syntax"])
    begin(project)
    assert "paint(1.0)" in text_of(sys.modules[project.path.stem])


def test_a_file_that_is_saved_while_the_program_begins_is_taken(project: Project) -> None:
    with rhi.create_device("null") as device, Reloader(device) as reloader:
        device.program(project.load().Plain)
        project.change("paint(1.0)", "paint(0.75)")
        reloader.watch(sys.modules[project.path.stem])
        assert reloader.update()
        assert not reloader.update()
        assert reloader.exchanged == 1


def test_it_is_untried_until_a_frame_was_drawn(project: Project) -> None:
    seen = []
    for new in ("paint(1.0)", "paint(1.0)", "paint(0.0)", "paint(0.0)"):
        project.change("paint(1.0)", new)
        project.load()
        seen.append(Reloader().is_untried)
        begin(project)
    assert seen == [False, False, True, False]


# -- the folder ----------------------------------------------------------------------------------------------------


def test_a_text_that_others_have_written_is_not_run(project: Project, kept: Path) -> None:
    begin(project)
    project.change(*FAULTS["syntax"])
    begin(project)
    for file in kept.glob("*"):
        file.write_bytes(file.read_bytes() + b"# more\n")
    with pytest.raises(SyntaxError):
        begin(project)


def test_a_text_serves_its_own_path(project: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two versions of a package lie side by side."""
    begin(project)
    (tmp_path / "second").mkdir()
    monkeypatch.syspath_prepend(str(tmp_path / "second"))
    second = tmp_path / "second" / project.path.name
    second.write_text(project.text + "def x(:")
    with pytest.raises(SyntaxError):
        begin(project)
    second.unlink()
    project.change(*FAULTS["syntax"])
    begin(project)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no users")
@pytest.mark.parametrize("mode", [0o700, 0o770])
def test_a_folder_that_others_may_write_is_not_used(project: Project, kept: Path, mode: int) -> None:
    kept.mkdir(parents=True)
    kept.chmod(mode)
    begin(project)
    assert len(list(kept.glob("*"))) == (2 if mode == 0o700 else 0)


def test_a_folder_that_cannot_be_written_to_keeps_what_it_has(
    project: Project, kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin(project)
    before = set(kept.glob("*"))
    for owner, name in ((Path, "write_bytes"), (os, "utime")):
        monkeypatch.setattr(owner, name, lambda *_: os.stat("not there"))
    project.change("paint(1.0)", "paint(0.125)")
    assert begin(project)[1] == 1
    assert set(kept.glob("*")) == before


def test_what_was_used_least_recently_is_removed_beyond_the_limit(
    project: Project, kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = len(project.text) + 4
    begin(project)
    monkeypatch.setattr(kept_texts, "LIMIT", 8 * size)
    for number in range(10, 30):
        project.change("paint(1.0)", f"paint(0.{number})  ")
        begin(project)
    files = list(kept.glob("*"))
    assert 6 * size < sum(file.stat().st_size for file in files) <= 8 * size
    assert [any(text in file.read_bytes() for file in files) for text in (b"0.11", b"0.29")] == [False, True]
    for length, is_kept in ((size + 1, False), (size, True)):
        text = project.text.replace("paint(1.0)", "paint(0.30)")
        project.path.write_text(text + "#".ljust(length - len(text) - 1) + "\n")
        begin(project)
        assert any(b"0.30" in file.read_bytes() for file in kept.glob("*")) is is_kept
