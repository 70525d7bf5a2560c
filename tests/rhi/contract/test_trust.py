"""The folder of what is cached for the user."""

from __future__ import annotations

from pathlib import Path

import pytest

from rhi.contract import trust


@pytest.mark.parametrize("folder", ["cache", "./cache", "../x", "~/cache", ""])
def test_a_relative_folder_of_caches_is_ignored(
    folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for variable in ("HOME", "USERPROFILE"):  # of POSIX and of Windows
        monkeypatch.setenv(variable, str(tmp_path / "home"))
    monkeypatch.setenv("XDG_CACHE_HOME", folder)
    assert trust.user_cache() == tmp_path / "home" / ".cache" / "rhi"


def test_an_absolute_folder_of_caches_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert trust.user_cache() == tmp_path / "rhi"
