"""The conformance kit passes on gl while other code takes the thread before every line of a test."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import foreign_code
import pytest
from nightly_reasons import CHEAPER_TEST

OPERATION = foreign_code.KIT / "operation"
SAME_COMMANDS = {
    "test_a_redundant_bind_is_not_sent_again[gl]",
    "test_the_same_commands_are_issued_as_directly[gl]",
}
"""Tests that count commands: there are more, since a device that was made current binds everything anew."""


def run(*arguments: object) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, foreign_code.__file__, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_devices_go_on_between_foreign_lines() -> None:
    result = run(OPERATION / "test_interplay.py")
    assert result["failed"] == []
    assert result["passed"] > 30
    assert result["taken"] > 1000


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_a_device_that_does_not_look_fails() -> None:
    """The control: the runs above would see a context that isn't found again.

    A test that creates, fails and destroys leaves its device in the other context, where all that follow
    pass.
    """
    options = ("-k", "not holds_zeros", "--maxfail=5")
    assert run("--blind", OPERATION / "test_buffers.py", *options)["failed"] != []


@pytest.mark.nightly
def test_the_whole_kit_passes_between_foreign_lines() -> None:
    result = run(OPERATION)
    assert set(result["failed"]) == SAME_COMMANDS
    assert result["passed"] > 1600
