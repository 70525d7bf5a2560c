"""The output paths of a command are checked before it does any work, and a refused path leaves nothing behind."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from nightly_reasons import CHEAPER_TEST

from renderer import cli
from renderer.cli.options import CommandOption
from renderer.cli.subcommand import Subcommand, SubcommandGroup
from rhi.errors.output_paths import OutputPathError, check_output_file, check_output_folder

READ = {"--settings", "--keep", "--live", "--script", "--write-to", "folder"}
"""Options with paths that a command reads, or a folder that exists."""


def list_commands() -> Iterator[tuple[tuple[str, ...], Subcommand]]:
    for command in cli.COMMANDS:
        if isinstance(command, SubcommandGroup):
            for member in command.members:
                yield (command.name, member.name), member
        else:
            yield (command.name,), command


OUTPUTS = [
    (words, command, option)
    for words, command in list_commands()
    for option in command.options
    if option.output is not None
]


def complete(words: tuple[str, ...], command: Subcommand, option: CommandOption, path: Path) -> list[str]:
    """Arguments of a command with this path, and with all others that it needs."""
    arguments = [*words]
    for command_option in command.options:
        is_positional = not command_option.flag.startswith("-")
        if command_option is option:
            arguments += [str(path)] if is_positional else [command_option.flag, str(path)]
        elif command_option.flag == "scene":
            arguments.append("grid:count=1")
        elif is_positional and command_option.keywords.get("nargs") != "?":
            arguments.append("out.glb")
        elif command_option.keywords.get("required"):
            arguments += [command_option.flag, "out.csv"]
    return arguments


def list_files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.mark.parametrize(
    ("words", "command", "option"),
    OUTPUTS,
    ids=[f"{' '.join(words)} {option.flag}" for words, _, option in OUTPUTS],
)
@pytest.mark.parametrize("kind", ["folder", "below a file", "too long", "zero byte"])
def test_a_command_refuses_a_path_that_it_cannot_write_before_any_work(
    words: tuple[str, ...],
    command: Subcommand,
    option: CommandOption,
    kind: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "file").write_bytes(b"kept")
    is_folder = option.output is check_output_folder
    wrong = {
        "folder": Path("file") if is_folder else Path("folder.png"),
        "below a file": Path("file/out.png"),
        "too long": Path("x" * 300 + ".png"),
        "zero byte": Path("a\0b.png"),
    }[kind]
    before = list_files(tmp_path)
    begun: list[Any] = []
    monkeypatch.setattr("renderer.content.load_scene", lambda *_: begun.append(1))
    with pytest.raises(SystemExit) as ended:
        cli.main(complete(words, command, option, wrong))
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: {option.flag}: ")
    assert error.count("\n") == 1
    assert (list_files(tmp_path), begun) == (before, [])
    assert (tmp_path / "file").read_bytes() == b"kept"


def test_every_path_option_is_an_input_or_a_checked_output() -> None:
    unchecked = {
        f"{' '.join(words)} {option.flag}"
        for words, command in list_commands()
        for option in command.options
        if option.keywords.get("type") is Path and option.output is None and option.flag not in READ
    }
    assert unchecked == set()


def test_writable_output_paths_are_accepted(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    check_output_file(tmp_path / "file", "--output")
    check_output_file(tmp_path / "new/deep/file.png", "--output")
    check_output_folder(tmp_path, "--output")
    check_output_folder(tmp_path / "new/deep", "--output")
    assert list_files(tmp_path) == ["file"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(OutputPathError, match="nothing can be written"):
        check_output_file(tmp_path / "file.png", "--output")


def test_a_frame_is_not_drawn_for_an_image_with_the_name_of_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without --output the scene's name is that of the image."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "grid.png").mkdir()
    with pytest.raises(SystemExit):
        cli.main(["render", "grid:count=1", "--backend", "null", "--size", "8x8"])
    assert "grid.png is a folder" in capsys.readouterr().err


# -- closed streams -------------------------------------------------------------------------------------------------

LINES = {
    "render": "-m renderer render grid:count=1 --backend null --size 8x8",
    "json": "-m renderer scenes --json",
    "report": "-m rhi",
    "new": "-m rhi new tests kite",
    "help": "-m renderer --help",
    "trace help": "-m rhi trace --help",
    "bad argument": "-m renderer render --no-such-option",
    "bad scene": "-m renderer render no-such-scene",
}


@pytest.fixture(scope="module")
def discarded() -> dict[str, tuple[int, object]]:
    """The status and the files of each command whose output is discarded, which runs once for all cases."""
    return {}


def run_command(line: str, streams: str, folder: Path) -> tuple[int, object]:
    """Run a command in a new folder; return its exit status and the files that it leaves."""
    folder.mkdir()
    run = subprocess.run(
        f"{sys.executable} {LINES[line]} {streams}", shell=True, cwd=folder, capture_output=True,
        text=True, encoding="utf-8", check=False, env={**os.environ, "RHI_BACKEND": "null"},
    )  # fmt: skip
    assert "Traceback" not in run.stdout + run.stderr
    return run.returncode, list_files(folder)


@pytest.mark.nightly_cases(
    "*-json", "*-new", "*help*", "*-bad*", "*-report", "*2>&-*", "*<&-*", reason=CHEAPER_TEST
)
@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_a_command_with_closed_streams_behaves_as_with_discarded_output(
    line: str, closed: str, tmp_path: Path, discarded: dict[str, tuple[int, object]]
) -> None:
    if line not in discarded:
        discarded[line] = run_command(line, ">/dev/null 2>/dev/null", tmp_path / "discarded")
    assert run_command(line, closed, tmp_path / "closed") == discarded[line]
