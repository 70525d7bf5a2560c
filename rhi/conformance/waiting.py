"""The time for which the kit waits for a device. No result depends on it, only how soon a stuck device is
reported."""

from __future__ import annotations

import time
from collections.abc import Callable

TIMEOUT = 60.0
"""Seconds after which a device counts as stuck rather than busy."""


def wait_until(condition: Callable[[], bool]) -> bool:
    """Poll until `condition` is true; return False if it isn't within `TIMEOUT` seconds."""
    end = time.monotonic() + TIMEOUT
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.001)
    return True
