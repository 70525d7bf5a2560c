"""Dictionaries that are kept on disk, for what a program knows again when it is begun anew.

Each is a file in the folder `kept` of the cache, which `RHI_CACHE` names: its keyed checksum (`rhi.contract.trust`) and
JSON. It is read and written whole, so processes may share it; of those that write at once, the last one counts.
"""

from __future__ import annotations

from contextlib import suppress
from itertools import islice
from typing import Any

from rhi.contract import trust


class PersistentDict(dict[str, Any]):
    """A dictionary of JSON values that is kept in the cache. What was set last is at its end.

    It is empty if nothing was kept, if others could have written it, or if it is damaged.
    """

    def __init__(self, name: str, most: int) -> None:
        """Read what was kept under a name. `most`: how many entries `save` keeps."""
        import json  # seldom: most programs keep nothing

        super().__init__()
        folder = trust.find_folder("kept")
        self._file, self._most, self._key = folder / f"{name}.json", most, b""
        with suppress(OSError):  # nothing was kept, or nothing can be
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._key = b"" if trust.find_fault(folder) else trust.read_key()
            checksum, _, content = self._file.read_bytes().partition(b"\n")
            if self._key and checksum == self._sign(content):
                self.update(json.loads(content))

    def __setitem__(self, key: str, value: Any) -> None:
        self.pop(key, None)
        super().__setitem__(key, value)

    def save(self) -> None:
        """Write the entries that were set last, if the cache can be written to."""
        import json

        content = json.dumps(dict(islice(self.items(), max(0, len(self) - self._most), None))).encode()
        if self._key:
            with suppress(OSError):
                trust.write_whole(self._file, self._sign(content) + b"\n" + content)

    def _sign(self, content: bytes) -> bytes:
        return trust.sign(self._key, content, self._file.name).encode()
