"""Streams of a command: closed from the start (`>&-`), without a reader any more (`… | head`), or in an
encoding that lacks characters.

Python reports a closed pipe at a write, or when the interpreter flushes its buffers at exit, too late to be
caught. So buffers are flushed here, and their remaining bytes are dropped.
"""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Final, TextIO

BROKEN_PIPE_STATUS: Final = 141
"""The exit status of a program whose reader has gone away: 128 + SIGPIPE, as shells report it."""


def open_standard_streams() -> None:
    """Make all three standard streams usable. One that the process was started without reads or writes
    nothing, and characters that the locale's encoding lacks are written as escapes.

    Python sets the stream of a closed descriptor to None, and the next file that is opened gets that
    descriptor: what a driver's library prints would be written into it.
    """
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        stream = getattr(sys, name)
        if stream is None:
            with suppress(OSError):
                _occupy(number)
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
        elif mode == "w" and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _occupy(number: int) -> None:
    """Point a closed descriptor at the null device."""
    try:
        os.fstat(number)
    except OSError:
        opened = os.open(os.devnull, os.O_RDWR)
        if opened != number:
            os.dup2(opened, number)
            os.close(opened)


def run_until_pipe_closes(main: Callable[[], int]) -> int:
    """Run a command and return its exit status; `BROKEN_PIPE_STATUS`, without a word, if the reader of stdout
    or stderr goes away.

    `main` must let a `BrokenPipeError` through.
    """
    open_standard_streams()
    try:
        try:
            return main()
        finally:  # also when it exits, as `--help` does
            sys.stdout.flush()
            sys.stderr.flush()
    except BrokenPipeError as error:
        broken = [stream for stream in (sys.stdout, sys.stderr) if _is_broken_pipe(stream)]
        for stream in broken:
            with open(os.devnull, "w", encoding="utf-8") as nowhere:
                os.dup2(nowhere.fileno(), stream.fileno())  # the interpreter flushes what is left
        if broken:
            return BROKEN_PIPE_STATUS
        print(f"error: {error}", file=sys.stderr)  # another pipe
        return 2


def _is_broken_pipe(stream: TextIO) -> bool:
    """True if the reader of a stream has gone away. Another write wouldn't tell, since Python may have
    dropped the buffer."""
    if not hasattr(select, "poll"):
        return True  # Windows doesn't tell
    poll = select.poll()
    poll.register(stream.fileno(), 0)
    return bool(poll.poll(0))
