"""Files by content: a model, buffer or image that was moved is found where it is now.

- The index remembers files that were loaded: path, size and id, a hash of the content as in
  `renderer.content.assets`, and the models that use them.
- A file that isn't where it was is looked for at the other paths that are remembered for its content, then in
  the folder and below. Only a file of the same size is read, and only the same content is taken.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple

from renderer.content.assets import hash_content
from renderer.scene.files import read_file
from rhi import PersistentDict

MAX_FILES: Final = 10_000
"""The most files that are remembered, and that are looked at in a folder and below."""
_LOGGER: Final = logging.getLogger("renderer.content")


class FileRecord(NamedTuple):
    """A record of a file: its size in bytes, its id, and the models that use it."""

    bytes: int
    id: str
    users: list[str]


class FileIndex(PersistentDict):
    """The records of files by their absolute paths, those that were used last at the end."""

    def __init__(self) -> None:
        super().__init__("files", MAX_FILES)
        self.update({path: FileRecord(*fields) for path, fields in self.items()})

    def note(self, file: str | Path, content: bytes, model: str | Path) -> None:
        """Remember a file with its content, and the model that uses it, which may be the file itself."""
        path, user = os.path.abspath(file), os.path.abspath(model)
        users = self[path].users if path in self else []
        more = [] if user in (path, *users) else [user]
        self[path] = FileRecord(len(content), hash_content(content).hex(), [*users, *more])

    def find(self, file: Path, folder: Path, allows: Callable[[Path], bool] = lambda path: True) -> Path:
        """Return a file, or if it is missing, a file with the content that it had: from a remembered path, or
        from `folder` or below. A warning names both paths.

        Args:
            allows: which paths may be read.
        """
        listed = self.get(os.path.abspath(file))
        if listed is None or file.exists():
            return file
        remembered = [Path(path) for path, record in reversed(self.items()) if record.id == listed.id]
        for candidate in (*remembered, *list_files(folder)):
            with suppress(OSError, ValueError):
                is_alike = candidate.stat().st_size == listed.bytes and allows(candidate)
                if is_alike and hash_content(read_file(candidate, listed.bytes)).hex() == listed.id:
                    _LOGGER.warning(
                        "%s isn't there; %s has its content, and is read instead", file, candidate
                    )
                    return candidate
        return file


def list_files(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder and below, at most `MAX_FILES`, without links."""
    files = (Path(directory, name) for directory, _, names in os.walk(folder) for name in sorted(names))
    yield from (file for file in islice(files, MAX_FILES) if not file.is_symlink())
