"""Conversion of a driver's messages about a program into a `ShaderError` that names Python lines.

A backend parses the messages of its driver, whose lines are lines of the emitted text. The text knows the
Python line that each of them came from.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from typing import Final

from rhi.contract.descriptors import ProgramDescriptor, Stage, StageText
from rhi.errors import ShaderError
from rhi.errors.call_sites import CallSite
from rhi.errors.rules import SHADER_DRIVER

MAX_MESSAGES: Final = 10
"""Number of messages that are shown."""


def make_driver_error(
    descriptor: ProgramDescriptor,
    stage: Stage | None,
    source: StageText,
    messages: Iterable[tuple[str, int]],
    language: str,
) -> ShaderError:
    """Return the error for a program that a driver rejected.

    Args:
        stage: the rejected stage, or None for an error in linking.
        source: the whole text that the driver compiled, with the origins of its lines.
        messages: the driver's messages, each with a line of the text, counted from 1; 0 for none.
        language: name of the text's language, for the message.

    Returns:
        An error with the rule `shader-driver`. Its site is the Python line of the first message whose origin
        is known.
    """
    lines = source.text.split("\n")
    rows: list[str] = []
    site = None
    for message, number in islice(messages, MAX_MESSAGES):
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
