"""Translation of OpenCL's errors into `DeviceError`."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Final

import pyopencl as cl

from rhi.errors import DeviceError, Rule
from rhi.errors.rules import DEVICE_DRIVER, DEVICE_LOST, DEVICE_MEMORY

_codes = cl.status_code
_RULES: Final[dict[int, Rule]] = {
    _codes.MEM_OBJECT_ALLOCATION_FAILURE: DEVICE_MEMORY,
    _codes.OUT_OF_RESOURCES: DEVICE_MEMORY,
    _codes.OUT_OF_HOST_MEMORY: DEVICE_MEMORY,
    _codes.INVALID_BUFFER_SIZE: DEVICE_MEMORY,
    _codes.DEVICE_NOT_AVAILABLE: DEVICE_LOST,
}


DRIVER_ERRORS: Final = (cl.Error, MemoryError)
"""The errors that OpenCL and NumPy raise."""


def make_error(error: Exception, call: str, given: str = "") -> DeviceError:
    """Return the `DeviceError` of `call` for one of `DRIVER_ERRORS`."""
    if not isinstance(error, cl.Error):
        return DeviceError(DEVICE_MEMORY, call, given)
    value = f"{given}: {shorten(error)}" if given else shorten(error)
    return DeviceError(_RULES.get(error.code, DEVICE_DRIVER), call, value)


class _Translation:
    """The context manager of `translate_errors`. A generator's frame would be taken for the user's call
    site."""

    def __init__(self, call: str, given: str) -> None:
        self._call = call
        self._subject = given

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, DRIVER_ERRORS):
            raise make_error(error, self._call, self._subject) from error


def translate_errors(call: str, given: str = "") -> AbstractContextManager[None]:
    """Return a context manager that turns errors of OpenCL and NumPy inside it into a `DeviceError` of
    `call`."""
    return _Translation(call, given)


def shorten(error: Exception) -> str:
    """Return the line of an error's text that gives the cause: a compiler's first error, else the first
    line."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    errors = [line for line in lines if "error:" in line]
    return (errors or lines or [type(error).__name__])[0]
