"""A driver's log as a `ShaderError` that names the Python lines.

Drivers differ in how they write a line number: Mesa `0:12(5): error: …`, NVIDIA `0(12) : error C1008: …`,
others `ERROR: 0:12: …`.
"""

from __future__ import annotations

import re
from typing import Final

from rhi.descriptors import ProgramDescriptor, Stage
from rhi.errors import CallSite, ShaderError
from rhi.rules import SHADER_DRIVER

__rhi_internal__ = True

_LINE: Final = re.compile(r"^(?:ERROR: |WARNING: )?\d+[:(](\d+)[):(]")
_SHOWN_ERRORS: Final = 10


def make_shader_error(
    descriptor: ProgramDescriptor, log: str, stage: Stage | None, source: str
) -> ShaderError:
    """The error for a program of which `stage` (None: linking) was refused; `source` is the stage's GLSL.

    `site` is the Python line of the first error, if `descriptor.lines` knows it.
    """
    lines = source.split("\n")
    origins = descriptor.lines.get(stage, ()) if stage is not None else ()
    rows: list[str] = []
    site = None
    for message in [row for row in log.strip("\n\0 ").splitlines() if row.strip()][:_SHOWN_ERRORS]:
        rows.append(message.strip())
        match = _LINE.match(message)
        number = int(match[1]) if match else 0
        if not 1 <= number <= len(lines):
            continue
        rows.append(f"  GLSL line {number}: {lines[number - 1].strip()}")
        if number <= len(origins):
            origin = CallSite(*origins[number - 1])
            rows.append(f"  from {origin}")
            site = site or origin
    where = "linking its stages" if stage is None else f"its {stage.value} stage"
    return ShaderError(
        SHADER_DRIVER, f"device.program({descriptor.name}), {where}", "\n".join(rows), site=site
    )
