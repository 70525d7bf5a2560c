"""Hot reload: what an edit of a module of shaders changes, and that a faulty one changes nothing."""

from __future__ import annotations

import ctypes
import gc
import importlib
import itertools
import logging
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import psutil
import pytest
from nightly_reasons import CHEAPER_TEST

import rhi
from rhi import Format, Op, Reloader, RhiError, ShaderError, ValidationError
from rhi.shading import evaluate, run_compute, run_fragment, run_vertex

TEXT = """
from __future__ import annotations
from rhi.shading import Shader, Storage, StorageRW, Struct, Uniform, function, global_id, vec2, vec3, vec4

SHARE = 1.0

class Corner(Struct):
    position: vec2

class Tint(Struct):
    color: vec4

class Varying(Struct):
    clip: vec4
    color: vec3

@function
def weaken(color: vec3) -> vec3:
    return color * 1.0

class Flat(Shader):
    tint: Uniform[Tint]
    gain = 1.0

    def vertex(self, v: Corner) -> Varying:
        return Varying(clip=vec4(v.position, 0.5, 1.0), color=self.tint.color.xyz)

    def fragment(self, v: Varying) -> vec4:
        return vec4(weaken(v.color) * SHARE * self.gain, 1.0)

class Other(Shader):
    values: StorageRW[float]

    def compute(self) -> None:
        self.values[global_id().x] = 1.0
"""
_numbers = itertools.count()


@pytest.fixture
def import_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], ModuleType]]:
    """Writes a text to a file of its own and imports it."""
    monkeypatch.syspath_prepend(str(tmp_path))
    names: list[str] = []

    def make(text: str) -> ModuleType:
        names.append(f"reloaded_{next(_numbers)}")
        (tmp_path / f"{names[-1]}.py").write_text(text, encoding="utf-8")
        importlib.invalidate_caches()
        return importlib.import_module(names[-1])

    yield make
    for name in names:
        del sys.modules[name]


@pytest.fixture
def shaders(import_text: Callable[[str], ModuleType]) -> Any:
    return import_text(TEXT)


@pytest.fixture
def device() -> Iterator[rhi.Device]:
    with rhi.create_device("null") as opened:
        yield opened


class FlatDrawer:
    """A device that draws the shader `Flat` into an image."""

    def __init__(self, device: rhi.Device, shaders: Any) -> None:
        self.device, self.shaders = device, shaders
        rows = np.zeros(3, shaders.Corner.dtype)
        rows["position"] = [(-3, -1), (1, -1), (1, 3)]
        self.mesh = device.mesh(rows)
        self.image = device.texture((4, 4), Format.RGBA8)
        self.program: Any = device.program(shaders.Flat)
        self.tint = device.uniform(shaders.Tint(color=(1.0, 0.6, 0.2, 1.0)))

    def draw(self, **bindings: Any) -> list[int]:
        """Return the color of a pixel."""
        with self.device.render_pass(self.image, clear=(0, 0, 0, 1)):
            self.device.draw(self.program, self.mesh, **({"tint": self.tint} | bindings))
        self.device.present(self.image)
        return self.image.read()[1, 1, :3].tolist()  # type: ignore[no-any-return]


@pytest.mark.parametrize("backend", ["gl", "cl"])
def test_an_edit_is_seen_and_a_faulty_one_isnt(backend: str, shaders: Any) -> None:
    with rhi.create_device(backend) as device:
        drawer, reloader = FlatDrawer(device, shaders), Reloader(device)
        assert drawer.draw() == [255, 153, 51]
        assert reloader.reload(shaders, TEXT.replace("SHARE = 1.0", "SHARE = 0.4")) == 1
        assert drawer.draw() == [102, 61, 20]
        with pytest.raises(ShaderError):
            reloader.reload(shaders, TEXT.replace("weaken(v.color)", "weaken(v.colour)"))
        assert drawer.draw() == [102, 61, 20]


def glsl(program: Any) -> str:
    return "".join(
        program.descriptor.emit("glsl", stage).text for stage in sorted(program.descriptor.stages, key=str)
    )


@pytest.mark.parametrize(
    ("old", "new", "seen"),
    [
        ("SHARE = 1.0", "SHARE = 0.375", "0.375"),
        ("color * 1.0", "color * 0.375", "0.375"),
        ("gain = 1.0", "gain = 0.375", "0.375"),
        ("class Flat(Shader):", "class Base(Shader):\n    gain = 0.375\n\nclass Flat(Base):", "1.0"),
        ("return vec4(weaken", "return self.dim() * vec4(weaken", "0.375"),
        ("    color: vec3\n", "    color: vec3\n    more: float\n", "more"),
    ],
    ids=["constant", "function", "attribute", "base", "method", "varying"],
)
def test_an_edited_shader_replaces_its_program(
    device: rhi.Device, shaders: Any, old: str, new: str, seen: str
) -> None:
    program: Any = device.program(shaders.Flat)
    text = TEXT.replace(old, new).replace("xyz)\n", "xyz, more=2.0)\n" if seen == "more" else "xyz)\n")
    text = text.replace("v.color) *", "v.color) * v.more *" if seen == "more" else "v.color) *")
    if "dim()" in text:
        text = text.replace("class Other", "    def dim(self) -> float:\n        return 0.375\n\nclass Other")
    before, number = glsl(program), program.id
    assert Reloader(device).reload(shaders, text) == int(seen != "1.0")
    assert device.program(shaders.Flat) is program
    if seen != "1.0":
        assert program.id != number
        assert seen in glsl(program)
        assert seen not in before


def test_classes_derived_elsewhere_change_too(device: rhi.Device, shaders: Any) -> None:
    class Derived(shaders.Flat):  # type: ignore[misc, name-defined]
        gain = 0.125

    program: Any = device.program(Derived)
    text = TEXT.replace("* SHARE", "* SHARE * 0.375").replace(
        "gain = 1.0", "gain = 4.0\n    more: Uniform[float]"
    )
    text = text.replace("* self.gain", "* self.gain * self.more")
    assert Reloader(device).reload(shaders, text) == 1
    assert "0.375" in glsl(program)
    assert "0.125" in glsl(program)
    assert [binding.name for binding in program.descriptor.bindings] == ["tint", "more"]


def test_modules_that_use_a_module_change_with_it(
    device: rhi.Device, shaders: Any, import_text: Callable[[str], ModuleType]
) -> None:
    user: Any = import_text(f"""
from {shaders.__name__} import Corner, Varying, weaken
import {shaders.__name__} as shaders
from rhi.shading import Shader, vec4

class Weak(Shader):
    def vertex(self, v: Corner) -> Varying:
        return Varying(clip=vec4(v.position, 0.5, 1.0), color=weaken(vec4(1.0).xyz))

class Named(Shader):
    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, shaders.SHARE, 1.0)
""")
    programs: list[Any] = [device.program(user.Weak), device.program(user.Named)]
    text = TEXT.replace("color * 1.0", "color * 0.375").replace("SHARE = 1.0", "SHARE = 0.625")
    assert Reloader(device).reload(shaders, text) == 2
    assert "0.375" in glsl(programs[0])
    assert "0.625" in glsl(programs[1])


def test_programs_whose_shaders_did_not_change_are_not_replaced(device: rhi.Device, shaders: Any) -> None:
    programs: list[Any] = [device.program(shaders.Flat), device.program(shaders.Other)]
    numbers = [program.id for program in programs]
    reloader = Reloader(device)
    assert reloader.reload(shaders, "# a comment\n" + TEXT) == 0
    assert [program.id for program in programs] == numbers
    assert reloader.reload(shaders, TEXT.replace("= 1.0\n\nclass Corner", "= 0.5\n\nclass Corner")) == 1
    assert [program.id == number for program, number in zip(programs, numbers, strict=True)] == [False, True]


def test_new_bindings_are_asked_for_by_the_next_draw(device: rhi.Device, shaders: Any) -> None:
    drawer = FlatDrawer(device, shaders)
    drawer.draw()
    text = TEXT.replace("gain = 1.0", "gain = 1.0\n    more: Uniform[float]").replace(
        "* SHARE", "* self.more"
    )
    Reloader(device).reload(shaders, text)
    with pytest.raises(ValidationError, match=r"^\[binding-missing\]"):
        drawer.draw()
    drawer.draw(more=device.uniform(0.5))


def test_lines_that_are_commented_out_are_a_warning_once(device: rhi.Device, import_text: Any) -> None:
    """First what reads a binding, then its declaration too: the same draws go on, by the device and by the
    program."""
    text = TEXT.replace("gain = 1.0", "gain = 1.0\n    more: Uniform[float]").replace(
        "* SHARE", "* self.more"
    )
    shaders = import_text(text)
    drawer, reloader = FlatDrawer(device, shaders), Reloader(device)
    drawer.draw(more=0.5)
    text = text.replace("* self.more", "")
    with pytest.warns(rhi.ShaderWarning, match="more is never used"):
        reloader.reload(shaders, text)
    drawer.draw(more=0.5)
    reloader.reload(shaders, text.replace("    more:", "    # more:"))
    with pytest.warns(rhi.ShaderWarning, match="'Flat' doesn't read 'more', which a draw passes") as caught:
        drawer.draw(more=0.5)
    assert [warning.filename for warning in caught] == [__file__]
    drawer.draw(more=0.5)
    with device.render_pass(drawer.image):
        drawer.program.draw(drawer.mesh, tint=drawer.tint, more=0.5)
    assert len(device.stream.filter(Op.DRAW)) == 5
    for bindings in ({"tint": drawer.tint, "moer": 0.5}, {"more": 0.5}):
        with (
            device.render_pass(drawer.image),
            pytest.raises(ValidationError, match=r"binding-(unknown|missing)"),
        ):
            drawer.program.draw(drawer.mesh, **bindings)


def test_functions_are_evaluated_as_edited(device: rhi.Device, shaders: Any) -> None:
    color = np.ones((1, 3), np.float32)
    assert np.array_equal(evaluate(shaders.weaken, color), color)
    Reloader(device).reload(shaders, TEXT.replace("color * 1.0", "color * 0.5"))
    assert np.array_equal(evaluate(shaders.weaken, color), 0.5 * color)


def test_shaders_that_ran_on_the_cpu_run_as_edited(device: rhi.Device, shaders: Any) -> None:
    """Kernels, stages, and functions and stages that call what was edited."""
    text = TEXT.replace("return color * 1.0", "return halve(color)").replace(
        "@function\ndef weaken",
        "@function\ndef halve(color: vec3) -> vec3:\n    return color * 1.0\n\n@function\ndef weaken",
    )
    reloader = Reloader(device)
    reloader.reload(shaders, text)
    tint, corners = shaders.Tint(color=(1.0, 1.0, 1.0, 1.0)), np.zeros((3, 2), np.float32)
    varying = {"clip": np.zeros((2, 2, 4), np.float32), "color": np.ones((2, 2, 3), np.float32)}

    def run() -> list[float]:
        return [
            float(evaluate(shaders.weaken, np.ones((1, 3), np.float32))[0, 0]),
            float(run_compute(shaders.Other, values=1)["values"][0]),
            float(run_vertex(shaders.Flat, {"position": corners}, tint=tint).varyings["clip"][0, 2]),
            float(run_fragment(shaders.Flat, varying, tint=tint).outputs["color"][0, 0, 0]),
        ]

    assert run() == [1.0, 1.0, 0.5, 1.0]
    text = (
        text.replace("color * 1.0", "color * 0.5")
        .replace("0.5, 1.0)", "0.25, 1.0)")
        .replace("x] = 1.0", "x] = 2.0")
    )
    reloader.reload(shaders, text)
    assert run() == [0.5, 2.0, 0.25, 0.5]


def test_methods_name_the_class_that_they_are_put_into(device: rhi.Device, shaders: Any) -> None:
    """`__class__`, at which `super()` begins, is the class that exists, not the one that the text made."""
    cls = shaders.Flat
    text = TEXT.replace(
        "gain = 1.0\n", "gain = 2.0\n\n    @staticmethod\n    def whose():\n        return __class__\n"
    )
    Reloader(device).reload(shaders, text)
    assert shaders.Flat is cls
    assert cls.whose() is cls


FAULTS = {
    "syntax": (
        "def fragment(self, v: Varying) -> vec4:",
        "def fragment(self, v: Varying -> vec4:",
        "shading-text",
    ),
    "exit": ("SHARE = 1.0", "raise SystemExit(3)", "shading-text"),
    "exception": ("SHARE = 1.0", "SHARE = 1.0 / 0", "shading-text"),
    "name": ("weaken(v.color)", "waeken(v.color)", "shading-unknown-name"),
    "type": ("* SHARE", "+ self.tint", "shading-type"),
    "binding": ("tint: Uniform[Tint]", "tint: Uniform[Tin]", "shading-binding"),
    "uniform": ("    color: vec4\n", "    color: vec4\n    more: vec4\n", "shading-reload"),
    "vertices": ("    position: vec2\n", "    position: vec3\n", "shading-reload"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_edit_names_its_line_and_changes_nothing(
    device: rhi.Device, shaders: Any, fault: str
) -> None:
    old, new, rule = FAULTS[fault]
    drawer, reloader = FlatDrawer(device, shaders), Reloader(device)
    drawer.draw()
    number, declared = drawer.program.id, dict(shaders.Flat._declared)
    text = (
        TEXT.replace(old, new).replace("gain = 1.0", "gain = 0.375").replace("color * 1.0", "color * 0.375")
    )
    with pytest.raises(RhiError, match=rf"^\[{rule}\]") as error:
        reloader.reload(shaders, text)
    site = error.value.site
    assert site is not None
    if fault != "binding":  # whose line is not known before the class exists
        assert site.file == shaders.__file__
        expected = next(
            n for n, line in enumerate(text.splitlines(), 1) if new.split("\n")[0].strip() in line
        )
        assert abs(site.line - expected) <= 1
    assert drawer.program.id == number
    assert shaders.Flat._declared == declared
    assert (shaders.SHARE, shaders.Flat.gain) == (1.0, 1.0)
    drawer.draw()


@pytest.mark.parametrize("fault", FAULTS)
def test_a_module_can_be_edited_after_a_faulty_edit(device: rhi.Device, shaders: Any, fault: str) -> None:
    old, new, rule = FAULTS[fault]
    drawer, reloader = FlatDrawer(device, shaders), Reloader(device)
    drawer.draw()
    with pytest.raises(RhiError, match=rf"^\[{rule}\]"):
        reloader.reload(shaders, TEXT.replace(old, new))
    assert reloader.reload(shaders, TEXT) == 0, "what is there is the first text"
    assert reloader.reload(shaders, TEXT.replace("* SHARE", "* 0.375")) == 1, "and can be edited again"
    assert "0.375" in glsl(drawer.program)


def test_a_program_that_the_device_refuses_changes_nothing(shaders: Any) -> None:
    with rhi.create_device("null") as device:
        programs: list[Any] = [device.program(shaders.Other), device.program(shaders.Flat)]
        more = "".join(f"    u{i}: Uniform[float]\n" for i in range(40))
        text = TEXT.replace("    gain = 1.0\n", f"    gain = 1.0\n{more}").replace(
            "* SHARE", "* (" + " + ".join(f"self.u{i}" for i in range(40)) + ")"
        )
        numbers = [program.id for program in programs]
        with pytest.raises(ValidationError, match=r"^\[device-capability\]"):
            Reloader(device).reload(shaders, text.replace("x] = 1.0", "x] = 2.0"))
        assert [program.id for program in programs] == numbers
        device.finish()
        created = {command["program"] for command in device.stream.filter(Op.CREATE_PROGRAM)}
        assert created - {command["resource"] for command in device.stream.filter(Op.DESTROY)} == set(numbers)


def test_inside_a_pass_nothing_is_exchanged(device: rhi.Device, shaders: Any) -> None:
    drawer = FlatDrawer(device, shaders)
    with device.render_pass(drawer.image):
        with pytest.raises(ValidationError, match=r"^\[pass-open\]"):
            Reloader(device).reload(shaders, TEXT.replace("SHARE = 1.0", "SHARE = 0.5"))
    assert shaders.SHARE == 1.0


def test_programs_of_several_devices_are_exchanged_together(device: rhi.Device, shaders: Any) -> None:
    with rhi.create_device("null") as second:
        programs: list[Any] = [open_device.program(shaders.Flat) for open_device in (device, second)]
        assert Reloader(device, second).reload(shaders, TEXT.replace("SHARE = 1.0", "SHARE = 0.375")) == 2
        assert all("0.375" in glsl(program) for program in programs)


def test_command_buffers_of_an_exchanged_program_are_stale(device: rhi.Device, shaders: Any) -> None:
    drawer = FlatDrawer(device, shaders)

    def record() -> rhi.CommandBuffer:
        with device.record() as commands, commands.render_pass(drawer.image):
            commands.draw(drawer.program, drawer.mesh, tint=drawer.tint)
        return commands

    commands = record()
    device.submit(commands)
    assert not commands.is_stale
    Reloader(device).reload(shaders, TEXT.replace("SHARE = 1.0", "SHARE = 0.5"))
    assert commands.is_stale
    with pytest.raises(ValidationError, match=r"^\[resource-destroyed\]"):
        device.submit(commands)
    device.submit(record())
    assert (
        device.stream.filter(Op.DRAW)[-1]["vertex_array"] != device.stream.filter(Op.DRAW)[0]["vertex_array"]
    )


def test_replaced_programs_are_destroyed(device: rhi.Device, shaders: Any) -> None:
    drawer, reloader = FlatDrawer(device, shaders), Reloader(device)
    for number in range(5):
        drawer.draw()
        reloader.reload(shaders, TEXT.replace("SHARE = 1.0", f"SHARE = 0.{number + 1}"))
    drawer.draw()
    device.finish()
    creations = device.stream.filter(Op.CREATE_PROGRAM)
    gone = {command["resource"] for command in device.stream.filter(Op.DESTROY)}
    assert [command["program"] for command in creations if command["program"] not in gone] == [
        drawer.program.id
    ]
    arrays = {command["vertex_array"] for command in device.stream.filter(Op.CREATE_VERTEX_ARRAY)}
    assert len(arrays - gone) == 1
    assert device.statistics.draws == 6


# -- files ---------------------------------------------------------------------------------------------------


def update(reloader: Reloader) -> bool:
    """Update until something was exchanged or an error reported."""
    error = reloader.error
    for _ in range(500):
        if reloader.update() or reloader.error is not error:
            return True
        time.sleep(0.01)
    return False


def save(path: Path, text: str, replaces: bool) -> None:
    if replaces:  # as most editors do
        beside = path.with_suffix(".tmp")
        beside.write_text(text, encoding="utf-8")
        os.replace(beside, path)
    else:
        path.write_text(text, encoding="utf-8")


@pytest.mark.parametrize("replaces", [True, False])
def test_a_saved_module_is_exchanged_by_update(device: rhi.Device, shaders: Any, replaces: bool) -> None:
    pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")
    program: Any = device.program(shaders.Flat)
    path = Path(shaders.__file__)
    with Reloader(device) as reloader:
        reloader.watch(shaders)
        assert not reloader.update()
        save(path, TEXT.replace("SHARE = 1.0", "SHARE = 0.375"), replaces)
        assert update(reloader)
        assert (reloader.reloaded, reloader.exchanged) == (1, 1)
        assert "0.375" in glsl(program)


@pytest.mark.parametrize("watched_as_link", [False, True])
def test_a_module_that_is_a_link_shows_its_target(
    device: rhi.Device, shaders: Any, tmp_path: Path, watched_as_link: bool
) -> None:
    """A file that becomes a link, a link that leads elsewhere, and an edit behind a link are saves."""
    pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")
    path, folder = Path(shaders.__file__), tmp_path / "versions"
    device.program(shaders.Flat)

    def link(version: str) -> None:
        (folder / version).write_text(TEXT.replace("SHARE = 1.0", f"SHARE = {version}"), encoding="utf-8")
        (tmp_path / "new").symlink_to(folder / version)
        (tmp_path / "new").replace(path)

    folder.mkdir()
    if watched_as_link:
        (folder / "first").write_text(TEXT, encoding="utf-8")
        path.unlink()
        path.symlink_to(folder / "first")
    with Reloader(device) as reloader:
        reloader.watch(shaders)
        for version in ("0.375", "0.625"):
            link(version)
            assert update(reloader)
            assert float(version) == shaders.SHARE
        if watched_as_link:
            (folder / "0.625").write_text(TEXT.replace("SHARE = 1.0", "SHARE = 0.75"), encoding="utf-8")
            assert update(reloader)
            assert shaders.SHARE == 0.75


@pytest.mark.parametrize(
    ("content", "share"),
    [
        (b"# -*- coding: latin-1 -*-\n# \xe9\n", 0.375),
        (b"\xef\xbb\xbf# \xc3\xa9\n", 0.375),
        (b"# \xe9\n", 1.0),
        (b"# -*- coding: nothing -*-\n", 1.0),
        (b"\xff\xfe", 1.0),
        (b"\x00", 1.0),
    ],
)
def test_a_saved_module_is_decoded_as_python_decodes_it(
    device: rhi.Device, shaders: Any, content: bytes, share: float
) -> None:
    pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")
    device.program(shaders.Flat)
    with Reloader(device) as reloader:
        Path(shaders.__file__).write_bytes(content + TEXT.replace("SHARE = 1.0", "SHARE = 0.375").encode())
        reloader.watch(shaders)
        reloader.update()
        assert share == shaders.SHARE
        if share == 1.0:
            assert isinstance(reloader.error, ShaderError)
            assert reloader.error.rule.id == "shading-text"


@pytest.mark.parametrize("replaces", [True, False])
def test_an_error_of_a_saved_module_lasts_until_it_is_mended(
    device: rhi.Device, shaders: Any, replaces: bool
) -> None:
    pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")
    device.program(shaders.Flat)
    errors: list[Exception] = []
    path = Path(shaders.__file__)
    with Reloader(device, on_error=errors.append) as reloader:
        reloader.watch(shaders)
        save(path, TEXT.replace("SHARE = 1.0", "SHARE = 0.375"), replaces)
        assert update(reloader)
        save(path, TEXT.replace("SHARE = 1.0", "SHARE = 0.5 +"), replaces)
        assert update(reloader)
        assert reloader.error is errors[-1]
        assert shaders.SHARE == 0.375
        save(path, TEXT.replace("SHARE = 1.0", "SHARE = 0.625"), replaces)
        assert update(reloader)
        assert reloader.error is None
        assert shaders.SHARE == 0.625
    assert len(errors) == 1


def test_changes_of_other_files_call_the_reload_function(
    device: rhi.Device, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")
    path = tmp_path / "scene.txt"
    path.write_text("1", encoding="utf-8")
    seen: list[int] = []
    with Reloader(device) as reloader, caplog.at_level(logging.ERROR, "rhi.reload"):
        reloader.watch(path, reload=lambda path: seen.append(int(path.read_text(encoding="utf-8"))))
        save(path, "2", replaces=True)
        assert update(reloader)
        assert seen == [2]
        save(path, "two", replaces=True)
        assert update(reloader)
        assert isinstance(reloader.error, ValueError)
        assert "invalid literal" in caplog.text


def test_the_reload_function_is_called_when_an_optional_file_appears(
    device: rhi.Device, tmp_path: Path
) -> None:
    pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")
    path = tmp_path.resolve() / "late.txt"
    seen: list[Path] = []
    with Reloader(device) as reloader:
        reloader.watch(path, reload=seen.append, missing_ok=True)
        for wrong in (tmp_path, tmp_path / "no folder" / "late.txt"):
            with pytest.raises(ValidationError, match=r"^\[reload-watch\]"):
                reloader.watch(wrong, reload=seen.append, missing_ok=True)
        path.write_text("1", encoding="utf-8")
        assert update(reloader)
    assert seen == [path]


def test_files_that_cannot_be_watched_are_refused(
    device: rhi.Device, shaders: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reloader = Reloader(device)
    with pytest.raises(ValidationError, match=r"^\[reload-watch\]"):
        reloader.watch(tmp_path / "missing.glb", reload=print)
    with pytest.raises(ValidationError, match=r"^\[device-argument\]"):
        reloader.watch(shaders.__file__)
    monkeypatch.setitem(sys.modules, "watchfiles", None)
    with pytest.raises(ValidationError) as error:
        reloader.watch(shaders)
    assert (error.value.rule.id, error.value.tip) == ("reload-watch", 'pip install "rhi[viewer]"')


def test_a_refused_watch_watches_nothing_of_it(device: rhi.Device, shaders: Any, tmp_path: Path) -> None:
    pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")
    path = tmp_path / "scene.txt"
    path.write_text("1", encoding="utf-8")
    seen: list[str] = []
    with Reloader(device) as reloader:
        for bad in (tmp_path / "missing.glb", tmp_path):
            with pytest.raises(ValidationError, match=r"^\[reload-watch\]"):
                reloader.watch(path, shaders, bad, reload=lambda path: seen.append("first"))
            assert (reloader._thread, reloader._reloads, reloader._modules) == (None, {}, {})
        reloader.watch(path, reload=lambda path: seen.append("second"))
        with pytest.raises(ValidationError):
            reloader.watch(path, tmp_path / "missing.glb", reload=lambda path: seen.append("first"))
        save(path, "2", replaces=True)
        assert update(reloader)
    assert seen == ["second"]


def test_all_shaders_are_watched_also_those_that_are_imported_later(
    device: rhi.Device, shaders: Any, import_text: Callable[[str], ModuleType]
) -> None:
    pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")
    woken: list[bool] = []
    with Reloader(device, on_save=lambda: woken.append(True)) as reloader:
        reloader.watch_shaders()
        reloader.update()  # modules of other tests may have been drawn with as they were before an edit
        later: Any = import_text(TEXT)
        import_text("VALUE = 1.0")
        assert not reloader.update()
        watched = {path.name for path in reloader._reloads}
        assert {f"{shaders.__name__}.py", f"{later.__name__}.py"} <= watched
        assert not any(Path(rhi.__file__).parent in path.parents for path in reloader._reloads)
        assert f"reloaded_{int(later.__name__.split('_')[1]) + 1}.py" not in watched, "it defines no shader"
        for module in (shaders, later):
            program: Any = device.program(module.Flat)
            save(Path(module.__file__), TEXT.replace("SHARE = 1.0", "SHARE = 0.375"), replaces=True)
            assert update(reloader)
            assert "0.375" in glsl(program)
        assert woken


def test_a_shader_that_fails_to_draw_is_rolled_back(device: rhi.Device, shaders: Any) -> None:
    pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")
    drawer, path, errors = FlatDrawer(device, shaders), Path(shaders.__file__), []
    drawer.draw()
    with Reloader(device, on_error=errors.append) as reloader:
        reloader.watch(shaders)
        assert not reloader.roll_back(ValueError("of something else"))
        text = TEXT.replace("gain = 1.0", "gain = 1.0\n    more: Uniform[float]").replace(
            "* SHARE", "* self.more"
        )
        save(path, text, replaces=True)
        assert update(reloader)
        with pytest.raises(ValidationError) as error:
            drawer.draw()
        assert reloader.roll_back(error.value)
        assert errors == [error.value] == [reloader.error]
        drawer.draw()
        save(path, TEXT.replace("SHARE = 1.0", "SHARE = 0.375"), replaces=True)
        assert update(reloader)
        assert reloader.error is None
        assert "0.375" in glsl(drawer.program)


def test_each_file_at_fault_has_its_error(
    device: rhi.Device, shaders: Any, import_text: Callable[[str], ModuleType]
) -> None:
    pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")
    modules = [shaders, import_text(TEXT)]
    with Reloader(device, on_error=lambda error: None) as reloader:
        reloader.watch(*modules)
        for module in modules:
            save(Path(module.__file__), TEXT.replace("SHARE = 1.0", "SHARE = 1.0 +"), replaces=True)
            assert update(reloader)
        assert len(reloader.errors) == 2
        for module, left in zip(reversed(modules), (1, 0), strict=True):
            save(Path(module.__file__), f"{TEXT}# right", replaces=True)
            assert update(reloader)
            assert len(reloader.errors) == left
            assert (reloader.error is None) == (left == 0)


# -- growth --------------------------------------------------------------------------------------------------


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_fifty_edits_leave_memory_where_it_was(shaders: Any) -> None:
    with rhi.create_device("null", record=False) as device:
        drawer, reloader = FlatDrawer(device, shaders), Reloader(device)

        def edit(count: int) -> int:
            for number in range(count):
                assert reloader.reload(shaders, TEXT.replace("SHARE = 1.0", f"SHARE = 0.{number + 1}")) == 1
                drawer.draw()
            device.finish()
            gc.collect()
            return sys.getallocatedblocks()

        edit(20)
        before = edit(20)
        assert edit(50) - before < 50 * 20, "fewer than 20 objects an edit; a program has thousands"


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["gl", "cl"])
def test_500_edits_leave_memory_where_it_was(shaders: Any, backend: str) -> None:
    """On cl PoCL keeps some memory for each kernel that it compiles: docs/reload.md."""
    bound = {"gl": 10_000, "cl": 250_000}[backend]
    trim = ctypes.CDLL(None).malloc_trim
    with rhi.create_device(backend) as device:
        drawer, reloader = FlatDrawer(device, shaders), Reloader(device)

        def edit(first: int, count: int) -> int:
            for number in range(first, first + count):
                assert (
                    reloader.reload(shaders, TEXT.replace("SHARE = 1.0", f"SHARE = {number}.0 / 1000.0")) == 1
                )
                assert abs(drawer.draw()[0] - 0.255 * number) < 1
            device.finish()
            gc.collect()
            trim(0)
            return psutil.Process().memory_info().rss

        before = edit(0, 100)
        assert (edit(100, 500) - before) / 500 < bound
