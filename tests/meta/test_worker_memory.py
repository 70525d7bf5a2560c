"""Test workers return the memory that a file of tests has freed."""

from __future__ import annotations

from pathlib import Path

import pytest
import worker_memory
from worker_memory import return_freed_memory

pytest_plugins = ["pytester"]

BLOCK = 32 * 1024
COUNT = 2048


def measure_resident() -> int:
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * 4096


def test_freed_blocks_below_one_in_use_are_returned() -> None:
    blocks = [bytearray(b"x" * BLOCK) for _ in range(COUNT)]
    in_use = bytearray(b"x" * BLOCK)  # above them in the heap, so free() leaves their pages to the process
    blocks.clear()
    before = measure_resident()
    if not return_freed_memory():
        pytest.skip("the C library isn't glibc")
    assert before - measure_resident() > 0.5 * COUNT * BLOCK
    assert in_use == b"x" * BLOCK


def test_memory_is_returned_once_after_each_file(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    events: list[str] = []
    monkeypatch.setattr(worker_memory, "return_freed_memory", lambda: events.append("returned"))

    class Names:
        def pytest_runtest_logstart(self, nodeid: str) -> None:
            events.append(nodeid)

    pytester.makepyfile(
        test_first="def test_a(): pass\ndef test_b(): pass", test_second="def test_c(): assert 0"
    )
    pytester.inline_run("-p", "no:cacheprovider", plugins=[worker_memory, Names()])
    assert events == [
        "test_first.py::test_a",
        "test_first.py::test_b",
        "returned",
        "test_second.py::test_c",
        "returned",
    ]
