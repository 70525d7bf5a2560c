"""What a driver says of a program's text, as a `ShaderError` that names the Python lines; for backends.

A backend knows how its driver writes a message and its line. Where that line came from, the descriptor knows.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from typing import Final

from rhi.contract.descriptors import ProgramDescriptor, Stage, StageText
from rhi.errors import CallSite, ShaderError
from rhi.errors.rules import SHADER_DRIVER

__rhi_internal__ = True

SHOWN: Final = 10
"""Messages that are shown, the first ones."""


def make_driver_error(
    descriptor: ProgramDescriptor, stage: Stage | None, source: StageText, messages: Iterable[tuple[str, int]],
    language: str,
) -> ShaderError:  # fmt: skip
    """The error for a program whose text a driver refused.

    Args:
        stage: the one that was refused; None: linking.
        source: the whole text that the driver was given, with the origins of its lines.
        messages: what it said, each with the line of the text that it is about, from 1; 0: of none.
        language: what the text is written in, as users call it.

    Returns:
        `shader-driver`; its site is the Python line of the first message whose origin is known.
    """
    lines = source.text.split("\n")
    rows: list[str] = []
    site = None
    for message, number in islice(messages, SHOWN):
        rows.append(message)
        if not 1 <= number <= len(lines):
            continue
        rows.append(f"  {language} line {number}: {lines[number - 1].strip()}")
        file, line = source.origins[number - 1] if number <= len(source.origins) else ("", 0)
        if file:
            origin = CallSite(file, line)
            rows.append(f"  from {origin}")
            site = site or origin
    where = "linking its stages" if stage is None else f"its {stage.value} stage"
    return ShaderError(
        SHADER_DRIVER, f"device.program({descriptor.name}), {where}", "\n".join(rows), site=site
    )
