"""Closed pipes: a command whose reader goes away, as in `python -m rhi trace show F.zip | head`.

Python reports a closed pipe at a write, or when the interpreter flushes its buffers at exit, too late to be
caught. So buffers are flushed here, and their remaining bytes are dropped.
"""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable
from typing import Final, TextIO

BROKEN_PIPE_STATUS: Final = 141
"""The exit status of a program whose reader has gone away: 128 + SIGPIPE, as shells report it."""


def run_until_pipe_closes(main: Callable[[], int]) -> int:
    """Run a command and return its exit status; `BROKEN_PIPE_STATUS`, without a word, if the reader of stdout
    or stderr goes away.

    `main` must let a `BrokenPipeError` through.
    """
    try:
        try:
            return main()
        finally:  # also when it exits, as `--help` does
            sys.stdout.flush()
            sys.stderr.flush()
    except BrokenPipeError as error:
        gone = [stream for stream in (sys.stdout, sys.stderr) if _is_broken_pipe(stream)]
        for stream in gone:
            with open(os.devnull, "w") as nowhere:
                os.dup2(nowhere.fileno(), stream.fileno())  # the interpreter flushes what is left
        if gone:
            return BROKEN_PIPE_STATUS
        print(f"error: {error}", file=sys.stderr)  # another pipe
        return 2


def _is_broken_pipe(stream: TextIO) -> bool:
    """Whether the reader of a stream has gone away. Another write wouldn't tell, since Python may have
    dropped the buffer."""
    if not hasattr(select, "poll"):
        return True  # Windows doesn't tell
    poll = select.poll()
    poll.register(stream.fileno(), 0)
    return bool(poll.poll(0))
