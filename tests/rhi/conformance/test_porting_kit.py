"""The porting kit: the table of steps, the template, the scoreboard, and the guide that goes with them."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from conformance_kit import take_the_kit
from nightly_reasons import CHEAPER_TEST

import rhi.conformance
from rhi.__main__ import main
from rhi.conformance.operation import test_compute
from rhi.conformance.plugin import MISSING, Board, describe_next
from rhi.conformance.port_steps import METHODS, STEPS, missing_method, step_of
from rhi.conformance.template import write_package
from rhi.errors import ValidationError

ROOT = Path(__file__).parents[3]
KIT = Path(rhi.conformance.__file__).parent
GUIDE = (ROOT / "docs" / "porting.md").read_text(encoding="utf-8")


def groups() -> Iterator[str]:
    for path in sorted(KIT.glob("*/test_*.py")):
        yield f"{path.parent.name} · {path.stem.removeprefix('test_').replace('_', ' ')}"


# -- the table ---------------------------------------------------------------------------------------------


def test_each_method_of_the_contract_is_written_in_one_step() -> None:
    methods = [method for step in STEPS for method in step.methods]
    assert sorted(methods) == sorted(METHODS)


def test_each_group_of_the_kit_is_taken_in_one_step() -> None:
    assert sorted(group for step in STEPS for group in step.groups) == sorted(groups())


def test_the_guide_goes_through_the_steps_with_their_methods_and_groups() -> None:
    parts = re.split(r"^## (\d): ", GUIDE, flags=re.MULTILINE)[1:]
    assert list(map(int, parts[::2])) == list(range(1, 1 + len(STEPS)))
    for step, part in zip(STEPS, parts[1::2], strict=True):
        text = part.partition("\n## ")[0]  # behind the last step come pages about all of them
        assert text.startswith(step.title)
        table = "\n".join(line.split("|")[1] for line in text.splitlines() if line.startswith("| `"))
        assert set(re.findall(r"`(\w+)`", table)) == set(step.methods), step.title
        listed = re.search(r"Groups: (.*?)\.\n", text, re.DOTALL)
        assert listed is not None
        assert tuple(re.findall(r"`(.*?)`", listed[1])) == step.groups, step.title


# -- the template ------------------------------------------------------------------------------------------


def test_every_failure_of_a_new_backend_names_the_missing_method(tmp_path: Path) -> None:
    root = write_package("half_done", tmp_path)
    _, output = take_the_kit("rhi_half_done:create_backend", root, "rhi.conformance.operation.test_buffers")
    assert re.search(r"^ 1 operation · buffers +0 passed +91 failed$", output, re.MULTILINE), output
    assert "NotImplementedError" not in output  # the scoreboard says it once
    assert len(output) < 2000
    assert output.rstrip().splitlines()[-1].startswith("91 missing")
    assert output.splitlines().count("next: step 1, buffers (python -m rhi docs porting)") == 1
    last = output.rstrip().splitlines()[-2]  # behind it is only pytest's count
    assert last == "  write create_buffer: 91 tests stop there"


def test_a_teardown_that_fails_because_of_a_missing_method_is_no_error(tmp_path: Path) -> None:
    root = write_package("bare", tmp_path)
    _, output = take_the_kit("rhi_bare:create_backend", root, "rhi.conformance.validation.test_scopes")
    assert "ERROR" not in output
    assert not re.search(r"\d errors?\b", output.rstrip().splitlines()[-1])


@pytest.mark.nightly
def test_the_numbers_of_the_guide_are_those_of_an_untouched_package(tmp_path: Path) -> None:
    root = write_package("untouched", tmp_path)
    _, output = take_the_kit("rhi_untouched:create_backend", root, "rhi.conformance")
    assert "ERROR" not in output
    assert not re.search(r"\d (errors?|failed)\b", output.rstrip().splitlines()[-1])
    for line in re.findall(r"^  write \w+: \d+ tests stop there$", GUIDE, re.MULTILINE):
        assert line in output
    for group, failed in re.findall(r"^ \d (operation · \w+) +0 passed +(\d+) failed", GUIDE, re.MULTILINE):
        assert re.search(rf"^ \d {group} +0 passed +{failed} failed", output, re.MULTILINE), group


def test_the_guide_names_the_shaders_that_a_port_compiles_first() -> None:
    """In the order of their classes in the module, which is that of the tests."""
    table = GUIDE.partition("These are the first twelve programs")[2].partition("\n\n`descriptor.bindings`")[
        0
    ]
    listed = re.findall(r"^- `([\w.]+)`: ", table, re.MULTILINE)
    source = Path(test_compute.__file__).read_text(encoding="utf-8")
    declared = re.findall(r"^class (\w+)\(sl\.Shader\)", source, re.MULTILINE)
    assert len(listed) == 12
    assert listed[:-1] == declared[:11]
    assert listed[-1] == "image_copy.Copy"  # made from a text: the format is part of it


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_a_method_that_was_written_is_not_asked_for_any_more(tmp_path: Path) -> None:
    root = write_package("begun", tmp_path)
    file = root / "rhi_begun" / "backend.py"
    file.write_text(
        file.read_text(encoding="utf-8").replace('        raise NotImplementedError("create_buffer")\n', ""),
        encoding="utf-8",
    )
    _, output = take_the_kit("rhi_begun:create_backend", root, "rhi.conformance.operation.test_buffers")
    assert "write create_buffer" not in output
    assert re.search(r"^  write write_buffer: \d+ tests stop there$", output, re.MULTILINE)


def test_a_new_backend_registers_itself_when_it_is_installed(tmp_path: Path) -> None:
    root = write_package("fresh", tmp_path)
    setup = [sys.executable, "-c", "import setuptools; setuptools.setup()", "--quiet", "egg_info"]
    run = subprocess.run(setup, capture_output=True, text=True, check=False, cwd=root, encoding="utf-8")
    assert run.returncode == 0, run.stderr  # what an editable installation writes
    _, output = take_the_kit("fresh", root, "rhi.conformance.operation.test_buffers")
    assert "rhi conformance: fresh" in output
    assert "  write create_buffer: 91 tests stop there" in output


@pytest.mark.nightly
@pytest.mark.slow
def test_a_new_backend_passes_mypy_strict(
    mypy_strict: Callable[..., tuple[str, int]], tmp_path: Path
) -> None:
    right, wrong = (write_package(name, tmp_path) / f"rhi_{name}" for name in ("right", "wrong"))
    out, _ = mypy_strict(right)
    assert [line for line in out.splitlines() if "rhi_right" in line] == []
    file = wrong / "backend.py"
    file.write_text(
        file.read_text(encoding="utf-8").replace(
            "def signal(self, value: int)", "def signal(self, value: str)"
        ),
        encoding="utf-8",
    )
    out, _ = mypy_strict(wrong)
    assert "Incompatible return value type" in out


def test_the_command_writes_the_package_and_says_where(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["new-backend", "metal", "--folder", str(tmp_path)]) == 0
    out, err = capsys.readouterr()
    assert out.strip() == str(tmp_path / "rhi-metal")
    assert "--rhi-backend metal" in err
    assert 'metal = "rhi_metal:create_backend"' in (tmp_path / "rhi-metal" / "pyproject.toml").read_text(
        encoding="utf-8"
    )


@pytest.mark.parametrize("name", ["Metal", "9lives", "a-b", "class", "", "gl"])
def test_a_name_must_be_free_and_a_module_s(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["new-backend", name, "--folder", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith("error: ")
    assert not list(tmp_path.iterdir())


def test_a_package_is_not_written_over_another(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_package("twice", tmp_path)
    assert main(["new-backend", "twice", "--folder", str(tmp_path)]) == 2
    assert "exists" in capsys.readouterr().err


# -- backends by their function ------------------------------------------------------------------------------


def test_a_backend_that_is_not_installed_is_named_by_its_function() -> None:
    with rhi.create_device("rhi.backends.null:create_backend", profile="gles-3") as device:
        assert device.backend_name == "null"
        assert not device.capabilities.compute


@pytest.mark.parametrize("name", ["no_such_module:create_backend", "rhi.backends.null:no_such_function"])
def test_a_function_that_is_not_there_is_an_unknown_backend(name: str) -> None:
    with pytest.raises(rhi.DeviceError, match=r"^\[device-unknown\]"):
        rhi.create_device(name)


def test_a_function_takes_its_own_options_only() -> None:
    with pytest.raises(ValidationError, match=r"^\[device-argument\]"):
        rhi.create_device("rhi.backends.null:create_backend", colour=3)


# -- the scoreboard ------------------------------------------------------------------------------------------


def raised(function: object, *arguments: object) -> BaseException:
    assert callable(function)
    with pytest.raises(Exception) as caught:  # noqa: PT011
        function(*arguments)
    return caught.value


class Unwritten:
    def draw(self) -> None:
        raise NotImplementedError("draw")

    def helper(self) -> None:
        raise NotImplementedError


def test_a_method_that_is_not_written_or_not_there_is_missing() -> None:
    backend = Unwritten()
    assert missing_method(raised(backend.draw)) == "draw"
    assert missing_method(raised(getattr, backend, "dispatch")) == "dispatch"

    def draw_with_care() -> None:
        try:
            backend.draw()
        finally:
            raise ValueError("while cleaning up")

    assert missing_method(raised(draw_with_care)) == "draw"


def test_other_errors_are_no_missing_methods() -> None:
    backend = Unwritten()
    assert missing_method(raised(backend.helper)) == ""
    assert missing_method(raised(getattr, backend, "colour")) == ""
    assert missing_method(None) == ""


def test_a_test_counts_once_also_if_its_teardown_fails_too() -> None:
    board = Board()
    for outcome in ("failed", "error"):
        report = SimpleNamespace(
            failed=True, nodeid="file.py::test_a", user_properties=[(MISSING, "draw")], longrepr=""
        )
        board.add(outcome, "operation · depth", report)  # type: ignore[arg-type]
    assert board.groups["operation · depth"].total() == 1
    assert board.failed["operation · depth"] == ["test_a"]


def test_the_kit_runs_in_the_order_of_the_steps(tmp_path: Path) -> None:
    root = write_package("sorted", tmp_path)
    _, output = take_the_kit("rhi_sorted:create_backend", root, "rhi.conformance.operation", "--collect-only")
    group_names = re.findall(r"^(?:operation/)?test_(\w+)\.py::", output, re.MULTILINE)
    numbers = [step_of(f"operation · {name.replace('_', ' ')}") for name in dict.fromkeys(group_names)]
    assert len(numbers) > 20
    assert numbers == sorted(numbers)


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_after_a_failed_test_the_next_one_gets_a_new_device(tmp_path: Path) -> None:
    """`end_pass` fails, so a pass stays open on the device."""
    root = write_package("broken", tmp_path)
    (root / "rhi_broken" / "__init__.py").write_text(BROKEN, encoding="utf-8")
    _, output = take_the_kit("rhi_broken:create_backend", root, "rhi.conformance.operation.test_time")
    assert "pass-open" not in output
    assert "  write end_pass: 2 tests stop there" in output
    assert re.search(r"3 operation · time +\d\d passed +2 failed", output), output


BROKEN = """
from rhi.backends.null import create_backend as create_null_backend

__rhi_internal__ = True


def end_pass():
    raise NotImplementedError("end_pass")


def create_backend(*, validation=False):
    backend = create_null_backend()
    backend.end_pass = end_pass
    return backend
"""


def board(*failures: tuple[str, str, str]) -> Board:
    """A board of failed tests: group, test, missing method."""
    board = Board()
    for group, test, method in failures:
        report = SimpleNamespace(
            failed=True, nodeid=f"file.py::{test}", user_properties=[(MISSING, method)], longrepr=""
        )
        board.add("failed", group, report)  # type: ignore[arg-type]
    return board


def test_the_earliest_step_is_next_with_the_methods_that_stop_most() -> None:
    group_names = describe_next(
        board(
            ("operation · depth", "test_a", "set_states"),
            ("operation · time", "test_b", "signal"),
            ("operation · time", "test_c", "write_query"),
            ("operation · recording", "test_d", "write_query"),
        )
    )
    assert group_names == [
        "next: step 3, time and labels (python -m rhi docs porting)",
        "  write write_query: 2 tests stop there",
        "  write signal: 1 tests stop there",
    ]


def test_without_a_missing_method_the_failed_tests_are_next() -> None:
    failures = [("operation · buffers", f"test_{i}", "") for i in range(7)]
    group_names = describe_next(board(*failures, ("operation · time", "test_b", "present")))
    assert group_names[1] == "  operation · buffers: test_0"
    assert group_names[-1] == "  … and 2 more"
    assert len(group_names) == 7


def test_without_a_failure_nothing_is_next() -> None:
    assert describe_next(Board()) == []
    assert describe_next(board(("a group of no step", "test_a", ""))) == []
