"""Files that others may have written: regular ones only, of a limited size, and JSON of a limited depth.

Pipes and devices would be waited for, or never end. Whatever is refused is an `OSError` or a `ValueError`, as
of a file that can't be read.
"""

from __future__ import annotations

import errno
import json
import os
import stat
from pathlib import Path
from typing import Any, Final

MAX_TEXT_BYTES: Final = 64 << 20
"""The most bytes of a file of settings, of cameras or of commands."""

_UNKNOWN: Final = 1 << 20  # bytes that are read of a file that doesn't say how many it has


def read_file(path: str | Path, max_bytes: int) -> bytes:
    """Return the bytes of a regular file.

    Raises:
        OSError: it can't be read, isn't a regular file, or has more than `max_bytes` bytes.
        ValueError: `path` can't be the name of a file.
    """
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with open(handle, "rb") as file:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it isn't a regular file", str(path))
        content = (
            b"" if status.st_size > max_bytes else file.read(min(max_bytes, status.st_size or _UNKNOWN) + 1)
        )
        if max(status.st_size, len(content)) > max_bytes:  # it grows, or its size isn't known
            raise OSError(errno.EFBIG, f"it has more than {max_bytes:,} bytes", str(path))
        return content


def read_text(path: str | Path) -> str:
    """Return the text of a regular file of at most `MAX_TEXT_BYTES`; raises as `read_file` does."""
    return read_file(path, MAX_TEXT_BYTES).decode()


def read_json(path: str | Path) -> Any:
    """Return the value of a JSON file; raises as `read_text` does."""
    try:
        return json.loads(read_text(path))
    except RecursionError:
        raise ValueError("its JSON is too deep") from None


def parse_path(text: str) -> Path:
    """Return a path, or raise ValueError if no file can have this name."""
    if "\0" in text or not text:
        raise ValueError(text)
    os.fsencode(text)
    return Path(text)
