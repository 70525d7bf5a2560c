"""The packages for programs in node are fetched once, and each download is said."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from web_kit import run_in_node


@pytest.fixture
def downloads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The requirements that were asked for; each download has other bytes than the pinned ones."""
    requirements: list[str] = []

    def run(command: list[str], *, cwd: Path | None = None, check: bool) -> None:
        requirements.append(command[-1])
        folder = cwd if cwd is not None else Path(command[command.index("--dest") + 1])
        (folder / "archive").write_bytes(b"")

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(run_in_node, "FOLDER", tmp_path)
    return requirements


def test_packages_that_are_there_are_not_fetched_again(
    downloads: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for package in run_in_node.PACKAGES:
        (tmp_path / package.folder).mkdir()
    run_in_node.fetch()
    assert downloads == []
    assert capsys.readouterr().err == ""


def test_a_download_is_said_and_its_hash_is_checked(
    downloads: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, *others = run_in_node.PACKAGES
    for package in others:
        (tmp_path / package.folder).mkdir()
    with pytest.raises(SystemExit, match="another hash"):
        run_in_node.fetch()
    assert downloads == [first.requirement]
    assert capsys.readouterr().err == (
        f"fetching {first.requirement} from {first.registry} to {tmp_path / first.folder}\n"
    )
    assert not (tmp_path / first.folder).exists()
