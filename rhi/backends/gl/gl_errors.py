"""Turns GL's error codes into `DeviceError`s."""

from __future__ import annotations

from typing import Final

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER, DEVICE_LOST, DEVICE_MEMORY

_RULES: Final = {enums.OUT_OF_MEMORY: DEVICE_MEMORY, enums.CONTEXT_LOST: DEVICE_LOST}

NAMES: Final = {
    enums.INVALID_ENUM: "GL_INVALID_ENUM",
    enums.INVALID_VALUE: "GL_INVALID_VALUE",
    enums.INVALID_OPERATION: "GL_INVALID_OPERATION",
    enums.INVALID_FRAMEBUFFER_OPERATION: "GL_INVALID_FRAMEBUFFER_OPERATION",
    enums.OUT_OF_MEMORY: "GL_OUT_OF_MEMORY",
    enums.CONTEXT_LOST: "GL_CONTEXT_LOST",
}


def drain_errors(gl: EntryPoints) -> None:
    """Discard the errors of earlier commands."""
    while gl.GetError() not in (enums.NO_ERROR, enums.CONTEXT_LOST):
        pass


def find_error(gl: EntryPoints, call: str) -> DeviceError | None:
    """Return the first error since `drain_errors`, or None. Used when resources are created, not for
    commands."""
    code = gl.GetError()
    if code == enums.NO_ERROR:
        return None
    drain_errors(gl)
    return DeviceError(_RULES.get(code, DEVICE_DRIVER), call, NAMES.get(code, hex(code)))
