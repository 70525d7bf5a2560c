"""Dictionaries on disk, for values that outlive the process.

Each is a file in the folder `dictionaries` of the cache, which `RHI_CACHE` names: its keyed checksum
(`rhi.contract.trust`) and JSON. It is read and written whole, so processes may share it; of those that write
at once, the last one counts.
"""

from __future__ import annotations

from contextlib import suppress
from itertools import islice
from typing import Any

from rhi.contract import trust


class PersistentDict(dict[str, Any]):
    """A dictionary of JSON values in a file of the cache. Its last entries are those that were set last.

    It is empty if there is no file, if other users could have written the file, or if it is damaged.
    """

    def __init__(self, name: str, max_entries: int) -> None:
        """Read the dictionary of this name. `save` writes at most `max_entries` entries."""
        import json  # seldom: most programs keep nothing

        super().__init__()
        folder = trust.cache_folder("dictionaries")
        self._file = folder / f"{name}.json"
        self._max_entries = max_entries
        self._key = b""
        with suppress(OSError):  # nothing was kept, or nothing can be
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._key = b"" if trust.distrust_reason(folder) else trust.read_key()
            checksum, _, content = self._file.read_bytes().partition(b"\n")
            if self._key and checksum == self._sign(content):
                self.update(json.loads(content))

    def __setitem__(self, key: str, value: Any) -> None:
        self.pop(key, None)
        super().__setitem__(key, value)

    def save(self) -> None:
        """Write the entries that were set last, if the cache can be written to."""
        import json

        content = json.dumps(dict(islice(self.items(), max(0, len(self) - self._max_entries), None))).encode()
        if self._key:
            with suppress(OSError):
                trust.write_atomically(self._file, self._sign(content) + b"\n" + content)

    def _sign(self, content: bytes) -> bytes:
        return trust.sign(self._key, content, self._file.name).encode()
