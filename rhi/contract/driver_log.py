"""What a driver says of a program's text, as a `ShaderError` that names the Python lines; for backends.

A backend knows how its driver writes a message and its line. Where that line came from, the descriptor knows.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from typing import Final

from rhi.contract.descriptors import ProgramDescriptor, Stage
from rhi.errors import CallSite, ShaderError
from rhi.errors.rules import SHADER_DRIVER

__rhi_internal__ = True

SHOWN: Final = 10
"""Messages that are shown, the first ones."""


def make_driver_error(
    descriptor: ProgramDescriptor, stage: Stage | None, source: str, messages: Iterable[tuple[str, int]],
    language: str, before: int = 0,
) -> ShaderError:  # fmt: skip
    """The error for a program whose text a driver refused.

    Args:
        stage: the one that was refused; None: linking.
        source: the whole text that the driver was given.
        messages: what it said, each with the line of `source` that it is about, from 1; 0: of none.
        language: what the text is written in, as users call it.
        before: lines of `source` in front of the stage's.

    Returns:
        `shader-driver`; its site is the Python line of the first message whose origin `descriptor.lines` knows.
    """
    lines = source.split("\n")
    origins = descriptor.lines.get(stage, ()) if stage is not None else ()
    rows: list[str] = []
    site = None
    for message, number in islice(messages, SHOWN):
        rows.append(message)
        if not 1 <= number <= len(lines):
            continue
        rows.append(f"  {language} line {number}: {lines[number - 1].strip()}")
        if 1 <= number - before <= len(origins):
            origin = CallSite(*origins[number - before - 1])
            rows.append(f"  from {origin}")
            site = site or origin
    where = "linking its stages" if stage is None else f"its {stage.value} stage"
    return ShaderError(
        SHADER_DRIVER, f"device.program({descriptor.name}), {where}", "\n".join(rows), site=site
    )
