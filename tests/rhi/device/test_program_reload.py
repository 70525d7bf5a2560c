"""Hot reload of a program of one file, `__main__`: it goes on, and what is behind its condition runs once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")

PROGRAM = """
import os, sys, time
from pathlib import Path
import rhi
import rhi.shading as sl

print("loaded", flush=True)

class Plain(sl.FullScreen):
    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0, 0.0, 0.0, 1.0)

def describe(reloader):
    return reloader.reloaded, reloader.exchanged, type(reloader.error).__name__, frames

def save(old, new):
    file = Path(__file__)
    beside = file.with_suffix(".tmp")
    beside.write_text(file.read_text(encoding="utf-8").replace(old, new, 1))
    os.replace(beside, file)
    error = reloader.error
    for _ in range(1000):
        if reloader.update() or reloader.error is not error:
            return
        time.sleep(0.01)

CONDITION:
    frames = 0
    print("began", flush=True)
    with rhi.create_device("null") as device, rhi.Reloader(device, on_error=lambda error: None) as reloader:
        program = device.program(Plain)
        reloader.watch(sys.modules["__main__"])
        save("(1.0, 0.0", "(0.5, 0.0")
        frames += 1
        print(describe(reloader), flush=True)
        save("(0.5, 0.0", "((0.25, 0.0")
        print(describe(reloader), flush=True)
        save("((0.25, 0.0", "(0.25, 0.0")
        print(describe(reloader), flush=True)
"""


def run(folder: Path, condition: str) -> subprocess.CompletedProcess[str]:
    file = folder / "program.py"
    file.write_text(PROGRAM.replace("CONDITION", condition), encoding="utf-8")
    return subprocess.run(
        [sys.executable, file], capture_output=True, text=True, check=False, timeout=300, encoding="utf-8"
    )


@pytest.mark.parametrize("condition", ['if __name__ == "__main__"', 'if "__main__" == __name__'])
def test_a_program_of_one_file_goes_on_with_each_saved_text(tmp_path: Path, condition: str) -> None:
    finished = run(tmp_path, condition)
    assert finished.returncode == 0, finished.stderr
    lines = finished.stdout.splitlines()
    assert lines.count("began") == 1
    assert lines.count("loaded") == 3, "at the start, and for the two texts that are Python"
    assert [line for line in lines if line.startswith("(")] == [
        "(1, 1, 'NoneType', 1)",
        "(1, 1, 'ShaderError', 1)",
        "(2, 2, 'NoneType', 1)",
    ]


def test_a_program_without_the_condition_is_refused_and_does_not_run_in_itself(tmp_path: Path) -> None:
    text = """
import sys, rhi
import rhi.shading as sl

class Plain(sl.FullScreen):
    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0, 0.0, 0.0, 1.0)

print("began")
with rhi.create_device("null") as device:
    reloader = rhi.Reloader(device)
    program = device.program(Plain)
    try:
        reloader.reload(sys.modules["__main__"], open(__file__).read() + "# saved")
    except rhi.ShaderError as error:
        print(error.rule.id, error.tip)
"""
    file = tmp_path / "program.py"
    file.write_text(text, encoding="utf-8")
    finished = subprocess.run(
        [sys.executable, file], capture_output=True, text=True, check=False, timeout=300, encoding="utf-8"
    )
    assert finished.returncode == 0, finished.stderr
    assert finished.stdout.splitlines() == [
        "began",
        'shading-reload put what it runs behind `if __name__ == "__main__":`',
    ]
