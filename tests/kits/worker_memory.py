"""A pytest plugin: after each file of tests, the process returns freed memory to the system.

glibc keeps the pages of freed blocks, above all in the middle of its heap. After scenes, images and compiled
shaders that is up to half of what a test worker occupies.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Generator

import pytest


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(
    item: pytest.Item, nextitem: pytest.Item | None
) -> Generator[None, object, object]:
    """Return freed memory after the last test of a file, whose fixtures have ended."""
    result = yield
    if nextitem is None or nextitem.path != item.path:
        return_freed_memory()
    return result


def return_freed_memory() -> bool:
    """Return the pages of freed blocks to the system; False where the C library isn't glibc."""
    if sys.platform != "linux":
        return False
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is None:
        return False
    trim(0)
    return True
