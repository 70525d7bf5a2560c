"""How long the kit waits for what must come: no result depends on it, only how late a stuck device is found out."""

from __future__ import annotations

import time
from collections.abc import Callable

PATIENCE = 60.0
"""Seconds after which a device is stuck rather than busy."""


def comes_true(condition: Callable[[], bool]) -> bool:
    """Whether polling alone sees `condition` come true."""
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.001)
    return True
