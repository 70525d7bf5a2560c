"""The tutorials beyond that they run: an engine's tests pass and detect faults, and a port passes the kit."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from conformance_kit import take_the_kit
from nightly_reasons import CHEAPER_TEST
from testing_kit import backend_works

import rhi.testing.portability
import rhi_screen

FOLDER = Path(__file__).parents[1] / "docs" / "tutorials"
GROUPS = ["buffers", "time", "compute"]

pytest_plugins = ["pytester"]
IMPORTED = (rhi.testing.portability, rhi.Reloader, rhi_screen.OrbitCamera, rhi_screen.open_screen)
"""Runs of pytest in this process share the modules of these."""


def read_program(page: str) -> str:
    """The Python of a page as one file."""
    text = (FOLDER / f"{page}.md").read_text(encoding="utf-8")
    return "\n\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))


# -- an engine -----------------------------------------------------------------------------------------------


@pytest.fixture
def engine(pytester: pytest.Pytester) -> Path:
    """The file of the tutorial on an engine."""
    file = pytester.path / "test_engine.py"
    file.write_text(read_program("engine-in-an-afternoon"), encoding="utf-8")
    return file


@pytest.mark.parametrize("backend", ["null", "gl"])
def test_the_tests_of_the_engine_pass(pytester: pytest.Pytester, engine: Path, backend: str) -> None:
    if not backend_works(backend):
        pytest.skip(f"no device of {backend} here")
    count = len(re.findall(r"^def test_", engine.read_text(encoding="utf-8"), re.MULTILINE))
    assert count >= 9
    pytester.runpytest("-p", "no:cacheprovider", "--rhi-backend", backend).assert_outcomes(passed=count)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('self.device.event("forward"),', 'self.device.event("backward"),'),
        ("if self.uploaded != self.scene.version:", "if True:"),
        ("if self.uploaded != self.scene.version:", "if self.uploaded is None:"),
        ("max(self.rows, default=0) + 1, color", "len(self.rows) or 1, color"),
        ("self.device.states(CullMode.NONE, PolygonOffset(slope=-2))", "self.device.states(CullMode.NONE)"),
        (
            "        super().draw_passes(view)\n",
            "        for _ in 1, 2:\n            super().draw_passes(view)\n",
        ),
    ],
)
def test_a_fault_of_the_engine_fails_a_test(
    pytester: pytest.Pytester, engine: Path, old: str, new: str
) -> None:
    source = engine.read_text(encoding="utf-8")
    assert source.count(old) == 1
    engine.write_text(source.replace(old, new), encoding="utf-8")
    outcomes = pytester.runpytest("-p", "no:cacheprovider", "--rhi-backend", "null").parseoutcomes()
    assert outcomes.get("failed", 0) >= 1


@pytest.mark.skipif(not backend_works("gl"), reason="no device of gl here")
def test_the_engine_draws_on_a_screen(pytester: pytest.Pytester, engine: Path) -> None:
    source = engine.read_text(encoding="utf-8")
    engine.write_text(source + '\n\ndef test_screen():\n    run("offscreen")\n', encoding="utf-8")
    pytester.runpytest("-p", "no:cacheprovider", "-k", "test_screen").assert_outcomes(
        passed=1, deselected=source.count("\ndef test_")
    )


# -- a port --------------------------------------------------------------------------------------------------


@pytest.fixture
def port(tmp_path: Path) -> Path:
    """The folder with the module of the tutorial on a port."""
    (tmp_path / "toy_port.py").write_text(read_program("port-in-a-day"), encoding="utf-8")
    return tmp_path


def count_passed(output: str) -> dict[str, int]:
    """The tests that passed by group of the scoreboard."""
    return {
        name: int(passed)
        for name, passed in re.findall(r"^ \d (\w+ · [\w ]+?) +(\d+) passed", output, re.MULTILINE)
    }


def test_the_port_passes_the_groups_of_its_steps(port: Path) -> None:
    groups = [f"rhi.conformance.operation.test_{group}" for group in GROUPS]
    status, output = take_the_kit("toy_port:create_backend", port, *groups)
    assert status == 0, output
    passed = count_passed(output)
    assert all(passed[f"operation · {group.replace('_', ' ')}"] > 10 for group in GROUPS), output


def test_the_kit_detects_a_fault_of_the_port(port: Path) -> None:
    source = (port / "toy_port.py").read_text(encoding="utf-8")
    copied = "        self.buffers[target][target_offset : target_offset + size] = copied\n"
    assert source.count(copied) == 1
    (port / "toy_port.py").write_text(source.replace(copied, "        pass\n"), encoding="utf-8")
    status, output = take_the_kit("toy_port:create_backend", port, "rhi.conformance.operation.test_buffers")
    assert status == 1
    assert "step 1, buffers" in output


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
@pytest.mark.slow
def test_the_port_passes_the_whole_kit(port: Path) -> None:
    status, output = take_the_kit("toy_port:create_backend", port, "rhi.conformance")
    assert status == 0, output
    assert "toy declares no draws" in output
