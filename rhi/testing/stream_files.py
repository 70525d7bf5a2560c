"""Streams that a test expects, kept in files beside it: golden files."""

from __future__ import annotations

import os
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, Final

from rhi.commands.ops import Op
from rhi.commands.stream import Commands, CommandStream
from rhi.device.device import Device
from rhi.errors import refuse
from rhi.errors.output_paths import OutputPathError, check_output_file
from rhi.errors.rules import ASSERTION_ARGUMENT
from rhi.testing.arguments import checker, read_commands
from rhi.testing.messages import fail
from rhi.trace.diff import diff
from rhi.trace.file import Trace, load, save

UPDATE_VARIABLE: Final = "RHI_UPDATE_STREAMS"
"""The environment variable that has files written; pytest's option `--rhi-update-streams` sets it."""
MAX_DIFFERENCES: Final = 20
"""Maximum number of differences that a failure lists."""

_TIMED: Final = frozenset({Op.WAIT, Op.DESTROY})
"""Commands whose place depends on when the device has finished earlier ones."""

_written: set[Path] = set()


def assert_stream_matches(commands: Commands | Device, file: str | PathLike[str]) -> None:
    """Assert that a device has recorded the stream that a file holds, on whichever backend: operations,
    numbers, bytes and the text of programs, as `assert_same` compares them.

    With pytest's option `--rhi-update-streams` the file is written if it differs. A file that this process has
    written is compared, so that backends of one run must agree. Waits and destructions aren't compared: they
    happen when the device has finished.

    Args:
        commands: a device, or its whole stream.
        file: a trace without the lines of the calls. `python -m rhi trace show FILE` prints it.

    Raises:
        AssertionError: the streams differ, as `rhi.trace.diff` shows it, or there is no such file.
        ValidationError: `assertion-argument` for a part of a stream, an empty stream, a stream that was cleared
            or paused, and what is no path; `trace-…` for a file that is no trace.
    """
    __tracebackhide__ = True
    stream, path = _read_stream(commands), _read_path(file)
    updates = bool(os.environ.get(UPDATE_VARIABLE)) and path.absolute() not in _written
    exists = path.is_file()
    if not exists and not updates:
        fail(
            f"there is no file {str(file)!r} with the stream that is expected",
            "pytest --rhi-update-streams writes it: look at it with python -m rhi trace show, and add it",
        )
    if exists:
        try:
            expected = load(path).stream
        except Exception:
            if not updates:
                raise
        else:
            differences = diff(_comparable(expected), _comparable(stream))
            if differences and not updates:
                more = len(differences) - MAX_DIFFERENCES
                fail(
                    f"the stream differs from {str(file)!r} in {len(differences)} places "
                    f"({len(stream)} commands instead of {len(expected)}):",
                    str(differences[:MAX_DIFFERENCES]),
                    f"… and {more} more" if more > 0 else "",
                    "if it is right, pytest --rhi-update-streams writes the file anew",
                )
            if not differences:
                return
    path.parent.mkdir(parents=True, exist_ok=True)
    save(_drop_sites(stream), path)
    _written.add(path.absolute())


def _comparable(stream: CommandStream) -> Trace:
    """Return the commands and refusals that don't depend on time."""
    return Trace(stream).select([index for index in stream.indices() if stream.op(index) not in _TIMED])


def _read_stream(commands: Any) -> CommandStream:
    """Return a whole stream with at least one command."""
    selected = read_commands("assert_stream_matches", "commands", commands)
    stream = selected.stream
    if selected is not stream:
        refuse(
            ASSERTION_ARGUMENT,
            "assert_stream_matches",
            f"a part of a stream ({len(selected)} of {len(stream)} commands)",
            "a device, or its whole stream",
            "assert_same compares parts, such as frames, of two streams",
        )
    if not stream.is_complete:
        refuse(
            ASSERTION_ARGUMENT,
            "assert_stream_matches",
            "a stream that was cleared, or whose recording was paused",
            "a stream with all commands since the device was created",
        )
    if not len(stream):
        refuse(ASSERTION_ARGUMENT, "assert_stream_matches", "an empty stream", "one or more commands")
    return stream


def _read_path(file: Any) -> Path:
    expected = "the path of a file that can be written"
    if not isinstance(file, (str, PathLike)) or not os.fspath(file):
        checker("assert_stream_matches").fail("file", file, expected)
    try:
        path = Path(os.fspath(file))
        check_output_file(path, "file")
    except (OutputPathError, TypeError) as error:
        refuse(ASSERTION_ARGUMENT, "assert_stream_matches", str(error), expected)
    return path


def _drop_sites(stream: CommandStream) -> Trace:
    """Return the stream without the lines of its calls, which name folders of a machine."""
    plain = CommandStream()
    for refusal in stream.refusals:
        plain.add_refusal(replace(refusal, site=None))
    for index in stream.indices():
        op, values, _, _ = stream.entry(index)
        plain.data.extend((op, *values, None, -1))
    plain.failures.update(stream.failures)
    return Trace(plain)
