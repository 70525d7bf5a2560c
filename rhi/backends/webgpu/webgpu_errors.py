"""Turns the errors of implementations into `DeviceError`s."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from rhi.backends.webgpu.implementation import GpuError, GpuMemoryError
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER, DEVICE_LOST, DEVICE_MEMORY

_LOST: Final = re.compile(r"device is lost|Device lost|device lost", re.IGNORECASE)
_MEMORY: Final = re.compile(r"not enough memory|out of memory", re.IGNORECASE)


@contextmanager
def translate_errors(call: str, memory: bool = False) -> Iterator[None]:
    """Raise errors of the implementation as `DeviceError`s; with `memory`, a size that is too large counts as
    missing memory."""
    try:
        yield
    except Exception as error:
        if not isinstance(error, (GpuError, OverflowError)):  # `except` asks no `ABC` what it registered
            raise
        raise make_error(call, error, memory) from error


def make_error(call: str, error: Exception, memory: bool = False) -> DeviceError:
    """Return the `DeviceError` for an error of the implementation."""
    text = " ".join(str(error).split())
    if _LOST.search(text):
        return DeviceError(DEVICE_LOST, call, text)
    if memory or isinstance(error, GpuMemoryError) or _MEMORY.search(text):
        return DeviceError(DEVICE_MEMORY, call, text)
    return DeviceError(DEVICE_DRIVER, call, text)
