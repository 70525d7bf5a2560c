"""The end of a command whose reader goes away: `python -m rhi trace show F.zip | head`.

Python reports the closed pipe where something is written, or, as the interpreter ends, where what is left of a buffer
is: then too late to be caught. So buffers are flushed here, and what is still in them goes nowhere.
"""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable
from typing import Final, TextIO

GONE: Final = 141
"""The exit status of a program whose reader has gone away: that of one ended by SIGPIPE, as shells report it."""


def run_for_reader(main: Callable[[], int]) -> int:
    """Run a command and return its exit status; `GONE`, without a word, if what reads stdout or stderr goes away.

    `main` must let a `BrokenPipeError` through.
    """
    try:
        try:
            return main()
        finally:  # also when it exits, as `--help` does
            sys.stdout.flush()
            sys.stderr.flush()
    except BrokenPipeError as error:
        gone = [stream for stream in (sys.stdout, sys.stderr) if _lacks_reader(stream)]
        for stream in gone:
            with open(os.devnull, "w") as nowhere:
                os.dup2(nowhere.fileno(), stream.fileno())  # the interpreter flushes what is left
        if gone:
            return GONE
        print(f"error: {error}", file=sys.stderr)  # another pipe
        return 2


def _lacks_reader(stream: TextIO) -> bool:
    """Return whether what reads a stream has gone away. To write to it once more doesn't tell: a buffer that can't be
    written may be empty then."""
    if not hasattr(select, "poll"):
        return True  # Windows doesn't tell
    poll = select.poll()
    poll.register(stream.fileno(), 0)
    return bool(poll.poll(0))
