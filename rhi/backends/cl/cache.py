"""The folder of compiled kernels: where it is, what of it is complete, and how large it may get.

- PoCL writes compiled kernels to a folder and finds them there under a key of source, options, device and version.
  `RHI_CACHE` names the folder, which may be copied to other machines; without it, it lies in the user's cache.
- PoCL trusts what it finds: a program that another process is just writing, or a damaged file, ends the process. So
  only one process at a time builds a program for the first time, and a record with the checksums of its files says that
  they are complete. Before a program is taken from the folder, its files are checked; damaged ones are removed.
- PoCL's names of folders can't be computed. So each program contains a function whose name is its key, by which its
  folder is found (`KernelCache.request`).
- When a device is closed that has written any, the programs used least recently are removed beyond `LIMIT` bytes.
- Other drivers have no such folder. pyopencl caches their kernels.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Final, NamedTuple

try:
    import fcntl
except ImportError:  # not on Windows, where PoCL's users are few
    fcntl = None  # type: ignore[assignment]

from rhi.backends.cl.declarations import GUARD, declare

__rhi_internal__ = True

ENVIRONMENT: Final = "RHI_CACHE"
LIMIT: Final = 512 << 20
"""Bytes of compiled kernels that are kept."""
_DRIVER_ENVIRONMENT: Final = "POCL_CACHE_DIR"
_RECORDS: Final = "rhi"
_COMMENT: Final = re.compile("//[^\n]*")
_PROGRAM: Final = "program.bc"
_PLACES: Final = "[A-Z][A-Z]/*"
"""Where PoCL's folders of programs lie in the folder of compiled kernels."""
_TYPICAL: Final = 400_000  # bytes of a program whose record doesn't say
_OLD: Final = 86400.0  # seconds after which locks and unfinished records are nobody's


def choose_folder() -> Path | None:
    """Choose the folder of compiled kernels, and tell PoCL, which reads its variable once, with its first device.

    Return the folder, or None if it can't be written: the driver's own is used then.
    """
    wanted, given = os.environ.get(ENVIRONMENT, ""), os.environ.get(_DRIVER_ENVIRONMENT, "")
    if wanted or not given:
        user = os.environ.get("XDG_CACHE_HOME", "") or os.path.expanduser("~/.cache")
        given = str(Path(wanted or os.path.join(user, "rhi")).absolute() / "pocl")
    folder = Path(given)
    try:
        (folder / _RECORDS).mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    if not os.access(folder, os.W_OK | os.X_OK):
        return None
    os.environ[_DRIVER_ENVIRONMENT] = given
    return folder


def strip_comments(source: str) -> str:
    """Return a program without comments, which may name a shader whose stages are those of another. No line moves."""
    return _COMMENT.sub("", source)


class Request(NamedTuple):
    """A program as the driver is given it, and its key."""

    key: str
    source: str
    options: tuple[str, ...]


def _read(source: str, declares: bool) -> tuple[str, str | None]:
    """Return a program without comments, and its declarations if it has some."""
    text = strip_comments(source)
    return text, declare(text) if declares else None


class KernelCache:
    """The compiled programs of one driver's version and device.

    Attributes:
        declares: whether programs declare the functions that they use, instead of the driver's header
            (`rhi.backends.cl.declarations`).
    """

    def __init__(self, folder: Path | None, driver: str, declares: bool = False) -> None:
        """`folder`: None if the driver has none; nothing is known then. `driver`: what compiled kernels depend on."""
        self._folder = folder
        self._driver = driver
        self._written: set[str] = set()
        self._read = lru_cache(maxsize=4)(_read)  # a program is looked up and then built, once or twice
        self.declares = declares

    @property
    def works(self) -> bool:
        """Whether compiled programs are found again."""
        return self._folder is not None

    def request(self, source: str, options: Sequence[str]) -> Request:
        """Return what the driver is given for a program: its key is in it, and the driver counts its lines as here."""
        text, declarations = self._read(source, self.declares)
        if declarations is not None:
            options = (*options, GUARD)
        whole = "\0".join((self._driver, *options, declarations or "", text))
        key = hashlib.sha256(whole.encode()).hexdigest()[:24]
        if declarations is not None:
            source = f"{declarations}#line 1\n{source}"
        if self._folder is not None:
            source = f"{source}\nvoid rhi_{key}(void);\nvoid rhi_{key}(void) {{}}\n"
        return Request(key, source, tuple(options))

    def knows(self, key: str, kernels: Sequence[str] = ()) -> bool:
        """Return whether a program is there and undamaged, with machine code of these kernels."""
        if self._folder is None:
            return False
        record = self._folder / _RECORDS / key
        place, files, _ = _read_record(self._folder, record)
        try:
            complete = place is not None and all(
                zlib.crc32((place / name).read_bytes()) == checksum for name, checksum in files.items()
            )
        except OSError:
            complete, place = False, None
        if not complete:
            with suppress(OSError):
                record.unlink()
            if place is not None:
                shutil.rmtree(place, ignore_errors=True)
            return False
        with suppress(OSError):
            os.utime(record)
        return {name.split("/")[0] for name in files}.issuperset(kernels)

    def find_lock(self, key: str) -> str:
        """Return the path of the file that is locked while a program is built for the first time; empty for none."""
        return "" if self._folder is None else str(self._folder / _RECORDS / f"{key}.lock")

    @contextmanager
    def writing(self, key: str) -> Iterator[None]:
        """Keep other processes from building this program."""
        path = self.find_lock(key)
        if not path or fcntl is None:
            yield
            return
        try:
            lock = open(path, "wb")  # noqa: SIM115
        except OSError:  # the folder has been removed or can't be written
            yield
            return
        with lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def record(self, key: str) -> None:
        """Record that a program's files are complete."""
        if self._folder is None:
            return
        place = self._find(key)
        if place is None:
            return
        files = {
            str(path.relative_to(place)): zlib.crc32(path.read_bytes())
            for path in (place / _PROGRAM, *place.glob("*/*/*.so"))
        }
        record = self._folder / _RECORDS / key
        size = sum(path.stat().st_size for path in place.rglob("*") if path.is_file())
        text = json.dumps({"folder": str(place.relative_to(self._folder)), "files": files, "bytes": size})
        fresh = record.with_suffix(f".{os.getpid()}.{time.monotonic_ns()}")
        with suppress(OSError):
            fresh.write_text(text)
            fresh.replace(record)
        self._written.add(key)

    def _find(self, key: str) -> Path | None:
        """Return the folder of a program."""
        assert self._folder is not None
        known, *_ = _read_record(self._folder, self._folder / _RECORDS / key)
        if known is not None and (known / _PROGRAM).is_file():
            return known
        name = f"rhi_{key}".encode()
        places: list[tuple[float, Path]] = []
        for place in self._folder.glob(_PLACES):
            with suppress(OSError):
                places.append((place.stat().st_mtime, place))
        # Nearly always it was written just now. Older ones were left by a process that ended before it recorded them.
        for _, place in sorted(places, reverse=True):
            with suppress(OSError):
                if name in (place / _PROGRAM).read_bytes():
                    return place
        return None

    def finish(self) -> None:
        """Record the machine code that was generated since, and remove what was used least recently if there is too
        much."""
        if self._folder is None or not self._written:
            return
        for key in list(self._written):
            self.record(key)
        self._written.clear()
        with suppress(OSError):
            self._trim(self._folder)

    def _trim(self, folder: Path) -> None:
        found: list[tuple[float, int, Path, Path]] = []
        for record in (folder / _RECORDS).iterdir():
            with suppress(OSError):
                used = record.stat().st_mtime
                place, _, size = _read_record(folder, record)
                if place is not None:
                    found.append((used, size, record, place))
                elif used < time.time() - _OLD:
                    record.unlink()
        total = sum(size for _, size, _, _ in found)
        for _, size, record, place in sorted(found):
            if total <= LIMIT:
                break
            with suppress(OSError):
                record.unlink()
            shutil.rmtree(place, ignore_errors=True)
            total -= size


def _read_record(folder: Path, record: Path) -> tuple[Path | None, dict[str, int], int]:
    """Return the folder of a record's program, the checksums of its files by their names, and the bytes of the folder.

    The folder is None for a record that is damaged or unfinished, or that names another place than PoCL's folders: what
    it names may be removed, and records can come from elsewhere.
    """
    try:
        known = json.loads(record.read_bytes())
        name = PurePosixPath(known["folder"])
        files = {str(path): int(checksum) for path, checksum in known["files"].items()}
        size = int(known.get("bytes", _TYPICAL))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None, {}, 0
    if record.suffix or name.is_absolute() or ".." in name.parts or not name.match(_PLACES) or len(name.parts) != 2:
        return None, {}, 0
    return folder / name, files, size
