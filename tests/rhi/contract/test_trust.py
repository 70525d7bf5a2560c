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


@pytest.mark.parametrize("has_links", [True, False])
def test_the_user_s_key_is_made_once_also_where_files_have_no_links(
    has_links: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv(trust.ENVIRONMENT, raising=False)
    if not has_links:  # as in a page
        monkeypatch.delattr("os.link")
    key = trust.read_key()
    assert len(key) > 8
    assert trust.read_key() == key
    assert [path.name for path in (tmp_path / "rhi").iterdir()] == ["key"]
