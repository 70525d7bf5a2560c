"""The host's last words when a process ends after a device on cl was created."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

END = """
import faulthandler, os, signal, sys
words, name, enabled = sys.argv[1:]
if enabled == "enabled":
    faulthandler.enable(open(words, "w"))
import rhi
with rhi.create_device("cl") as device:
    device.buffer(4).read()
    os.kill(os.getpid(), getattr(signal, name)) if name != "SIGABRT" else os.abort()
"""


def end(words: Path, name: str, enabled: str) -> int:
    command = [sys.executable, "-W", "ignore", "-c", END, str(words), name, enabled]
    return subprocess.run(command, capture_output=True, timeout=120, check=False).returncode


@pytest.mark.parametrize("name", ["SIGABRT", "SIGSEGV", "SIGBUS"])
def test_a_crash_is_reported_where_the_host_enabled_faulthandler(tmp_path: Path, name: str) -> None:
    """In the file that the host chose, with the line; without faulthandler, the process ends all the same."""
    words = tmp_path / "words"
    assert end(words, name, "enabled") < 0
    assert "Fatal Python error" in words.read_text(encoding="utf-8")
    assert 'File "<string>", line 9' in words.read_text(encoding="utf-8")
    assert end(tmp_path / "none", name, "disabled") < 0
    assert not (tmp_path / "none").exists()
