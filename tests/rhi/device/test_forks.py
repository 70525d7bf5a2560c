"""Processes that are forked after a device was created: refusals by name instead of calls that never
return."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from nightly_reasons import CHEAPER_TEST

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")

PROGRAM = """
import os
import sys
import numpy as np
import rhi

backend, other = sys.argv[1:]
device = rhi.create_device(backend, record=False)
image, buffer = device.texture((4, 4), rhi.Format.RGBA8), device.buffer(np.arange(4))

def refused_rule(use):
    try:
        use()
    except rhi.RhiError as error:
        return error.rule.id
    return "done"

def clear():
    with device.render_pass(image, clear=(1, 0, 0, 1)):
        pass

def make_other():
    with rhi.create_device(other) as made:
        assert made.buffer(np.arange(3)).read().tolist() == [0, 1, 2]

child = os.fork()
if not child:
    uses = (clear, buffer.read, device.finish, lambda: device.texture((4, 4), rhi.Format.R8), make_other, device.close)
    print(*map(refused_rule, uses), flush=True)
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
clear()
assert buffer.read().tolist() == [0, 1, 2, 3]
device.close()
print("parent goes on")
"""


def fork(backend: str, other: str) -> list[str]:
    """The results of a child with a device of its parent, and with another device, by the rules of
    refusals."""
    command = [sys.executable, "-c", PROGRAM, backend, other]
    child, parent = subprocess.run(
        command, capture_output=True, text=True, timeout=60, check=True, encoding="utf-8"
    ).stdout.splitlines()
    assert parent == "parent goes on"
    return child.split()


@pytest.mark.parametrize("backend", ["gl", "cl", "null"])
def test_a_child_may_close_its_parents_device_and_nothing_else(backend: str) -> None:
    *used, _, closed = fork(backend, "null")
    assert used == ["device-forked"] * 4
    assert closed == "done"


@pytest.mark.nightly_cases("null-cl-done", "cl-null-done", reason=CHEAPER_TEST)
@pytest.mark.parametrize(
    ("backend", "other", "expected"),
    [
        ("gl", "gl", "device-forked"),
        ("cl", "cl", "device-forked"),
        ("gl", "null", "done"),
        ("cl", "null", "done"),
        ("null", "null", "done"),
        ("null", "gl", "done"),
        ("null", "cl", "done"),
    ],
)
def test_a_child_has_devices_whose_drivers_its_parent_had_not(
    backend: str, other: str, expected: str
) -> None:
    assert fork(backend, other)[4] == expected
