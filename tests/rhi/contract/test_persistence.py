"""Dictionaries that are kept in the cache: what comes back, in which order, and what isn't trusted."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rhi import PersistentDict
from rhi.contract import trust


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("RHI_CACHE", str(tmp_path))
    return tmp_path / "dictionaries"


def save_entries(entries: dict[str, int], max_entries: int = 3) -> list[tuple[str, int]]:
    """Set entries, and return what comes back."""
    saved = PersistentDict("numbers", max_entries)
    for name, number in entries.items():
        saved[name] = number
    saved.save()
    return list(PersistentDict("numbers", max_entries).items())


def test_the_entries_that_were_set_last_are_loaded(folder: Path) -> None:
    assert save_entries({"a": 1, "b": 2}) == [("a", 1), ("b", 2)]
    assert save_entries({"a": 3, "c": 4}) == [("b", 2), ("a", 3), ("c", 4)]
    assert save_entries({"d": 5}) == [("a", 3), ("c", 4), ("d", 5)]


def test_entries_without_a_valid_signature_are_not_loaded(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_entries({"a": 1})
    whole = (folder / "numbers.json").read_bytes()
    for name, content in (("numbers", whole.replace(b"1}", b"2}")), ("numbers", b""), ("others", whole)):
        (folder / f"{name}.json").write_bytes(content)
        assert PersistentDict(name, 3) == {}
    assert save_entries({"a": 1}) == [("a", 1)]
    monkeypatch.setenv("RHI_CACHE_KEY", "another")
    assert PersistentDict("numbers", 3) == {}


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no users")
@pytest.mark.parametrize(("mode", "is_used"), [(0o700, True), (0o770, False)])
def test_a_folder_that_others_may_write_to_is_not_used(folder: Path, mode: int, is_used: bool) -> None:
    save_entries({"a": 1})
    folder.chmod(mode)
    assert save_entries({"b": 2}) == ([("a", 1), ("b", 2)] if is_used else [])


def test_a_failed_save_leaves_the_file_as_it_was(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_entries({"a": 1})
    monkeypatch.setattr(trust, "write_atomically", lambda *_: os.stat("not there"))
    assert save_entries({"b": 2}) == [("a", 1)]
