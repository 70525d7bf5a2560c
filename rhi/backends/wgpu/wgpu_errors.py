"""Turns the errors of wgpu into `DeviceError`s, and naga's messages into `ShaderError`s with Python lines."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import wgpu

from rhi.contract.descriptors import ProgramDescriptor, Stage, StageText
from rhi.contract.driver_log import make_driver_error
from rhi.errors import DeviceError, ShaderError
from rhi.errors.rules import DEVICE_DRIVER, DEVICE_LOST, DEVICE_MEMORY

_LOST: Final = re.compile(r"device is lost|Device lost|device lost", re.IGNORECASE)
_MEMORY: Final = re.compile(r"not enough memory|out of memory", re.IGNORECASE)
_LOCATION: Final = re.compile(r"wgsl:(\d+):\d+")


@contextmanager
def translate_errors(call: str, memory: bool = False) -> Iterator[None]:
    """Raise errors of wgpu as `DeviceError`s; with `memory`, a size that is too large counts as missing
    memory."""
    try:
        yield
    except (wgpu.GPUError, OverflowError) as error:
        raise make_error(call, error, memory) from error


def make_error(call: str, error: Exception, memory: bool = False) -> DeviceError:
    """Return the `DeviceError` for an error of wgpu."""
    text = " ".join(str(error).split())
    if _LOST.search(text):
        return DeviceError(DEVICE_LOST, call, text)
    if memory or isinstance(error, wgpu.GPUOutOfMemoryError) or _MEMORY.search(text):
        return DeviceError(DEVICE_MEMORY, call, text)
    return DeviceError(DEVICE_DRIVER, call, text)


def make_shader_error(
    descriptor: ProgramDescriptor, stage: Stage, text: StageText, error: Exception
) -> ShaderError:
    """Return the error for a stage whose text naga refuses."""
    return make_driver_error(descriptor, stage, text, _messages(str(error)), "WGSL")


def _messages(log: str) -> Iterator[tuple[str, int]]:
    """Yield naga's message, with the line of the text that it points at."""
    lines = [line.strip() for line in log.splitlines() if line.strip()]
    start = next((i for i, line in enumerate(lines) if line.startswith("Shader '")), 0)
    location = _LOCATION.search(log)
    message = " ".join(line for line in lines[start:] if not re.match(r"[┌│=\d]", line))
    yield re.sub(r"^Shader '[^']*' ", "", message) or log.strip(), int(location[1]) if location else 0
