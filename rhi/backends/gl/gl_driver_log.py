"""Turns an OpenGL driver's log into a `ShaderError` that names the Python lines.

Drivers differ in how they write a line number: Mesa `0:12(5): error: …`, NVIDIA `0(12) : error C1008: …`,
others `ERROR: 0:12: …`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from rhi.contract.descriptors import ProgramDescriptor, Stage, StageText
from rhi.contract.driver_log import make_driver_error
from rhi.errors import ShaderError

_LINE: Final = re.compile(r"^(?:ERROR: |WARNING: )?\d+[:(](\d+)[):(]")


def make_shader_error(
    descriptor: ProgramDescriptor, log: str, stage: Stage | None, source: StageText
) -> ShaderError:
    """Return the error for a program whose `stage` the driver rejected (None: linking failed).

    `source` is the GLSL of the stage.
    """
    return make_driver_error(descriptor, stage, source, _messages(log), "GLSL")


def _messages(log: str) -> Iterator[tuple[str, int]]:
    for message in log.strip("\n\0 ").splitlines():
        if message.strip():
            match = _LINE.match(message)
            yield message.strip(), int(match[1]) if match else 0
