"""Paths that a command will write to, checked before it does any work."""

from __future__ import annotations

import os
from pathlib import Path


class OutputPathError(OSError):
    """Nothing can be written to a path; the message names the option that gave it."""

    def __str__(self) -> str:
        return str(self.args[0])


def check_output_file(path: Path, option: str) -> None:
    """Check that a file can be written, as far as that can be known. Its folder may not exist yet.

    Raises:
        OutputPathError: it can't.
    """
    if _is_folder(path, option):
        raise OutputPathError(f"{option}: {path} is a folder; name a file in it")
    if os.path.lexists(path) and not os.access(path, os.W_OK):
        raise OutputPathError(f"{option}: {path} can't be written")
    _check_parents(path.parent, option)


def check_output_folder(path: Path, option: str) -> None:
    """Check that files can be written to a folder, which may not exist yet.

    Raises:
        OutputPathError: they can't.
    """
    _is_folder(path, option)
    _check_parents(path, option)


def _is_folder(path: Path, option: str) -> bool:
    try:
        path.lstat()
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:  # too long a name, a zero byte
        if not isinstance(error, NotADirectoryError):
            raise OutputPathError(f"{option}: {str(path)!r} is no path: {error}") from None
    return path.is_dir()


def _check_parents(folder: Path, option: str) -> None:
    """Check that a folder can be made, or written to if it exists."""
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir():
        raise OutputPathError(f"{option}: {folder} is no folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputPathError(f"{option}: nothing can be written to {folder}")
