"""Files by content: a model, buffer or image that was moved is found where it is now.

- The index remembers files that were loaded: path, size, time of change and id, a hash of the content as in
  `renderer.content.assets`, and the models that use them. It lies in the folder `files` of the cache.
- A file that isn't where it was is looked for at the other paths that are remembered for its content, then in the
  folder and below. Only a file of the same size is read, and only the same content is taken.
- What is loaded again unchanged (size and time) isn't hashed again. The files that were used least recently are
  forgotten beyond `MOST`. Of processes that write at once, the last one counts.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final

from renderer.content.assets import hash_content
from renderer.scene.files import read_file, read_json
from rhi import find_cache

MOST: Final = 10_000
"""The most files that are remembered, and that are looked at in a folder and below."""
_LOGGER: Final = logging.getLogger("renderer.content")


@dataclass(frozen=True, slots=True)
class FileRecord:
    """What is remembered of a file: its bytes, when it was changed, in ns, its id, and the models that use it."""

    path: str
    bytes: int
    changed: int
    id: str
    users: tuple[str, ...] = ()


class FileIndex:
    """The files that are remembered.

    Attributes:
        records: by their absolute paths, those that were used last at the end.
    """

    def __init__(self) -> None:
        folder = find_cache("files")
        self._file = None if folder is None else folder / "index.json"
        self.records: dict[str, FileRecord] = {}
        with suppress(OSError, ValueError, TypeError, KeyError):  # none yet, or it is damaged
            if self._file is not None:
                read = [_parse_record(fields) for fields in read_json(self._file)]
                self.records = {record.path: record for record in read}

    def note(self, file: Path, content: bytes | None = None, user: str | Path = "") -> FileRecord:
        """Remember a file, and the model that uses it, if any.

        Raises:
            OSError: it can't be read.
        """
        path, status = os.path.abspath(file), os.stat(file)
        record = self.records.pop(path, None)
        if record is None or (record.bytes, record.changed) != (status.st_size, status.st_mtime_ns):
            content = read_file(file, status.st_size) if content is None else content
            users = () if record is None else record.users
            record = FileRecord(path, status.st_size, status.st_mtime_ns, hash_content(content).hex(), users)
        model = os.path.abspath(user) if user else path
        if model != path and model not in record.users:
            record = replace(record, users=(*record.users, model))
        self.records[path] = record
        return record

    def save(self) -> None:
        """Write the index, if there is a folder for it that can be written to."""
        if self._file is not None:
            latest = list(self.records.values())[-MOST:]
            fresh = self._file.with_suffix(f".{os.getpid()}")
            with suppress(OSError):
                fresh.write_text(json.dumps([asdict(record) for record in latest]), encoding="utf-8")
                fresh.replace(self._file)

    def find(self, file: Path, folder: Path, allows: Callable[[Path], bool] = lambda path: True) -> Path:
        """Return a file, or if it is missing, one with the content that it had: from a remembered path, or from
        `folder` or below. A warning names both paths.

        Args:
            allows: which paths may be read.
        """
        known = self.records.get(os.path.abspath(file))
        if known is None or file.exists():
            return file
        remembered = [Path(each.path) for each in reversed(self.records.values()) if each.id == known.id]
        for found in (*remembered, *walk(folder)):
            with suppress(OSError, ValueError):
                is_alike = found.stat().st_size == known.bytes and allows(found)
                if is_alike and hash_content(read_file(found, known.bytes)).hex() == known.id:
                    _LOGGER.warning("%s isn't there; %s has its content, and is read instead", file, found)
                    return found
        return file


def _parse_record(fields: Any) -> FileRecord:
    users = tuple(map(str, fields["users"]))
    return FileRecord(str(fields["path"]), int(fields["bytes"]), int(fields["changed"]), str(fields["id"]), users)


def walk(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder and below, at most `MOST`, without links."""
    files = (Path(place, name) for place, _, names in os.walk(folder) for name in sorted(names))
    yield from (file for file in islice(files, MOST) if not file.is_symlink())
