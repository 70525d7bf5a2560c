"""Text files are read and written as UTF-8, whatever the locale's encoding is."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from nightly_reasons import CHEAPER_TEST

ROOT = Path(__file__).parents[1]
FOLDERS = ("rhi", "rhi_pytest", "rhi_screen", "renderer", "examples", "scripts", "benchmarks", "tests")
_LINES_OF_TEXT = {"read_text": 0, "write_text": 1}
"""By method, the number of arguments before the encoding."""
_PROCESSES = {"run", "Popen", "check_output", "check_call"}
_OTHER_FILES = {"av", "Image"}
_OPENERS = {"open", "fdopen", "TemporaryFile", "NamedTemporaryFile"}


def find_calls_without_encoding(tree: ast.AST) -> Iterator[int]:
    """Yield the lines of calls that read or write text in the locale's encoding."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        is_method = isinstance(node.func, ast.Attribute)
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        keywords = {keyword.arg: keyword.value for keyword in node.keywords}
        if "encoding" in keywords or None in keywords:
            continue
        if is_method and name in _LINES_OF_TEXT and len(node.args) <= _LINES_OF_TEXT[name]:
            yield node.lineno
        if name in _PROCESSES and not {"text", "universal_newlines"}.isdisjoint(keywords):
            yield node.lineno
        if name in _OPENERS and getattr(getattr(node.func, "value", None), "id", "") not in _OTHER_FILES:
            modes = [keywords.get("mode"), *node.args[:2]]
            texts = [
                mode.value for mode in modes if isinstance(mode, ast.Constant) and isinstance(mode.value, str)
            ]
            in_text = any(set(text) <= set("rwaxt+") and text for text in texts)
            if in_text or (not is_method and len(node.args) == 1 and "mode" not in keywords):
                yield node.lineno


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_text_file_has_an_encoding(folder: str) -> None:
    paths = sorted((ROOT / folder).rglob("*.py"))
    assert [
        f"{path.relative_to(ROOT)}:{line}"
        for path in paths
        for line in find_calls_without_encoding(ast.parse(path.read_text(encoding="utf-8")))
    ] == []


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("path.read_text()", 1), ("path.write_text(text)", 1), ("open(path)", 1), ("path.open('w')", 1),
        ("run(command, text=True)", 1), ("os.fdopen(1, 'w')", 1), ("open(path, mode='a+')", 1),
        ("path.read_text(encoding='utf-8')", 0), ("path.read_text('utf-8')", 0), ("open(path, 'rb')", 0),
        ("path.open(mode='wb')", 0), ("run(command, capture_output=True)", 0), ("Image.open(path)", 0),
        ("open(path, encoding='utf-8')", 0), ("path.write_text(text, 'utf-8')", 0),
    ],
)  # fmt: skip
def test_calls_in_the_encoding_of_the_locale_are_found(text: str, count: int) -> None:
    assert len(list(find_calls_without_encoding(ast.parse(text)))) == count


PROGRAM = """
import logging
import rhi, rhi.shading as sl
logging.getLogger("rhi.kernels").setLevel(logging.ERROR)  # else a slow machine says that it builds kernels
class Red(sl.FullScreen):
    def fragment(self) -> sl.vec4:
        '''Draws × in red, as §.'''
        return sl.vec4(1.0, 0.0, 0.0, 1.0)
with rhi.create_device(BACKEND) as device:
    image = device.texture((4, 4), rhi.Format.RGBA8)
    with device.render_pass(image), device.states(rhi.DepthTest.OFF):
        device.draw(device.program(Red), device.mesh(3))
    print("drawn", image.read()[0, 0].tolist())
"""
LOCALE = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def run_in_ascii(arguments: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **LOCALE, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(folder)}
    environment.pop("PYTHONIOENCODING", None)
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder, env=environment, capture_output=True, encoding="ascii", check=False,
    )  # fmt: skip


@pytest.mark.nightly_cases("gl", "wgpu", "null", reason=CHEAPER_TEST)
@pytest.mark.parametrize("backend", ["cl", "gl", "wgpu", "null"])
def test_a_program_draws_in_an_ascii_locale(backend: str, tmp_path: Path) -> None:
    """The kernels of cl, the shader and its comments have other characters. Nothing that was compiled is
    kept."""
    (tmp_path / "red.py").write_text(PROGRAM.replace("BACKEND", repr(backend)), encoding="utf-8")
    run = run_in_ascii(["red.py"], tmp_path)
    if "[device-driver]" in run.stderr or "[device-unknown]" in run.stderr:
        pytest.skip(run.stderr)
    assert run.stderr == ""
    assert run.stdout == f"drawn {[0, 0, 0, 0] if backend == 'null' else [255, 0, 0, 255]}\n"


@pytest.mark.nightly_cases("*help*", "*shading*", "*plan*", reason=CHEAPER_TEST)
@pytest.mark.parametrize(
    "line",
    [
        "-m rhi", "-m rhi trace --help", "-m rhi shading --help", "-m renderer render --help", "-m renderer plan city",
        "-m renderer accuracy --help",
    ],
)  # fmt: skip
def test_a_command_prints_in_an_ascii_locale(line: str, tmp_path: Path) -> None:
    run = run_in_ascii(line.split(), tmp_path)
    assert "Error" not in run.stderr
    assert run.returncode in (0, 1)
    assert run.stdout
