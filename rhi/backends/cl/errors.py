"""OpenCL's errors as `DeviceError`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import pyopencl as cl

from rhi.errors import DeviceError, Rule
from rhi.rules import DEVICE_DRIVER, DEVICE_LOST, DEVICE_MEMORY

__rhi_internal__ = True

_codes = cl.status_code
_RULES: Final[dict[int, Rule]] = {
    _codes.MEM_OBJECT_ALLOCATION_FAILURE: DEVICE_MEMORY,
    _codes.OUT_OF_RESOURCES: DEVICE_MEMORY,
    _codes.OUT_OF_HOST_MEMORY: DEVICE_MEMORY,
    _codes.INVALID_BUFFER_SIZE: DEVICE_MEMORY,
    _codes.DEVICE_NOT_AVAILABLE: DEVICE_LOST,
}


@contextmanager
def translate_errors(call: str, given: str = "") -> Iterator[None]:
    """Raise what OpenCL or NumPy refuse inside as a `DeviceError` of `call`."""
    try:
        yield
    except cl.Error as error:
        told = f"{given}: {shorten(error)}" if given else shorten(error)
        raise DeviceError(_RULES.get(error.code, DEVICE_DRIVER), call, told) from error
    except MemoryError as error:
        raise DeviceError(DEVICE_MEMORY, call, given) from error


def shorten(error: Exception) -> str:
    """The line of an error's text that says why: a compiler's first error, else the first line."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    told = [line for line in lines if "error:" in line]
    return (told or lines or [type(error).__name__])[0]
