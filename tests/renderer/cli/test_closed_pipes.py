"""The commands of both packages end quietly if their output isn't read to the end."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from types import ModuleType

import pytest
from pipe_kit import stream_to_pipe

import renderer
import rhi
from renderer import cli
from renderer.cli.subcommand import Subcommand
from rhi.errors.pipes import BROKEN_PIPE_STATUS

VERSION_1 = Path(__file__).parents[2] / "rhi/trace/version-1.zip"


def write_much() -> None:
    for _ in range(1000):
        print("a line that fills the buffer, so that it is written before the end")


@pytest.mark.parametrize(
    ("package", "arguments"),
    [
        (renderer, ["much"]),
        (renderer, ["accuracy", "--help"]),
        (rhi, ["trace", "--help"]),
        (rhi, ["trace", "show", str(VERSION_1)]),
    ],
)
def test_commands_of_both_packages_end_quietly(
    package: ModuleType,
    arguments: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    much = Subcommand("much", "print much", (), lambda _: write_much(), "")
    monkeypatch.setattr(cli, "COMMANDS", (*cli.COMMANDS, much))
    monkeypatch.setattr(sys, "argv", [package.__name__, *arguments])
    with stream_to_pipe(monkeypatch, "stdout", is_read=False), pytest.raises(SystemExit) as ended:
        runpy.run_path(str(Path(str(package.__file__)).parent / "__main__.py"), run_name="__main__")
    assert ended.value.code == BROKEN_PIPE_STATUS
    assert capfd.readouterr().err == ""
