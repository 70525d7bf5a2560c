"""The folder of compiled kernels: its path, its complete entries, and its size limit.

- PoCL writes compiled kernels to a folder and finds them there under a key of source, options, device and
  version. `RHI_CACHE` names the folder, which may be copied to other machines; without it, it lies in the
  user's cache.
- PoCL trusts what it finds: a program that another process is just writing, or a damaged file, ends the
  process. So only one process at a time builds a program for the first time, and a record with the checksums
  of its files says that they are complete. Before a program is taken from the folder, its files are checked;
  damaged ones are removed. The checksums are keyed, and the folder must be the user's own
  (`rhi.contract.trust`).
- If the folder isn't the user's own, or is full, this process uses a temporary one, and a warning says why.
- PoCL reads the variable once in a process. Where another library was first, it uses a folder of its own: its
  mark of use is missing in ours (`KernelCache.watch_use`). Then nothing is taken from ours, which PoCL
  doesn't see.
- PoCL's names of folders can't be computed. So each program contains a function whose name contains its key,
  by which its folder is found (`Request.write`).
- To find a program by its source, PoCL runs its preprocessor: 6 to 20 ms. By LLVM code it finds it in 1 to
  10. So a source is compiled once to code that isn't linked yet, which is kept beside the record, and
  programs are made of it (`context.build_cached`). PoCL has it under a key of its own. Where the driver
  doesn't take code, programs are built from their sources.
- LLVM code is of no use to a program whose machine code is there. So one that draws is made of a binary of
  PoCL's own format that names its kernels and contains no code (`rhi.backends.cl.pocl.binaries`): 1.8 ms
  instead of 11, and 0.3 MB of memory instead of 2.4. Its folder is the process's own with links to the
  machine code, because PoCL reads LLVM code from a folder that has some, and looks for machine code again
  later (`rhi.backends.cl.pocl.leases`).
- When a device is closed that has written any, the programs used least recently are removed beyond `LIMIT`
  bytes, and after a day those without a record. What a living process has built of LLVM code stays, since PoCL
  may be writing machine code there (`KernelCache.hold`).
- Other drivers have no such folder. pyopencl caches their kernels.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import logging
import os
import re
import shutil
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final, NamedTuple, TypeAlias

from rhi.backends.cl.pocl import binaries, leases
from rhi.backends.cl.pocl.declarations import GUARD, declare
from rhi.contract import trust
from rhi.errors.shared_caches import cache_once

LIMIT: Final = 512 << 20
"""Bytes of compiled kernels that are kept."""
_DRIVER_ENVIRONMENT: Final = "POCL_CACHE_DIR"
_RECORDS: Final = "rhi"
_COMMENT: Final = re.compile("//[^\n]*")
_PROGRAM: Final = "program.bc"
_CODE: Final = ".code"
"""Suffix of the files of LLVM code, each of which begins with its checksum."""
_HEADER: Final = ".header"
"""Suffix of the file of the first bytes of the driver's binaries, which begins with its checksum, too."""
_CHECKSUM: Final = 32  # characters
_BUILT: Final = "built"
_FOLDER_PATTERN: Final = "[A-Z][A-Z]/*"
"""Where PoCL's folders of programs lie in the folder of compiled kernels."""
_USE_MARK: Final = "last_accessed"
"""An empty file that PoCL touches whenever it builds a program that it has."""
_USE_LOCK: Final = "use.lock"
_TRIM_LOCK: Final = "trim.lock"
"""Locked while programs are removed, or named as used: so none is removed that a process is about to use."""
_TEMPORARY_FILES: Final = "tempfile_*"
"""Empty files that PoCL leaves in the folder, one a process."""
_TYPICAL: Final = 400_000  # bytes of a program whose record doesn't say
PATIENCE: Final = 20.0
"""Seconds to wait for a lock; a process that holds it for longer may be stopped."""
_IMPATIENCE: Final = 0.5  # once a wait for a lock has timed out
LOGGER: Final = logging.getLogger("rhi.kernels")
_replaced: Final[dict[str, Path]] = {}
"""Temporary folders, by the folder that each replaces."""
_OLD: Final = 86400.0  # seconds after which locks and unfinished records are abandoned


def choose_folder() -> Path | None:
    """Choose the folder of compiled kernels, and tell PoCL, which reads its variable once, with its first
    device.

    Return the folder, or None if it can't be written: the driver's own is used then. One that isn't the
    user's own, or is full, is left alone: a warning says so, and a temporary one takes its place.
    """
    requested, driver_folder = os.environ.get(trust.FOLDER, ""), os.environ.get(_DRIVER_ENVIRONMENT, "")
    if requested or not driver_folder:
        driver_folder = str(trust.cache_folder("pocl"))
    folder = _replaced.get(driver_folder, Path(driver_folder))
    try:
        for part in (folder.parent, folder, folder / _RECORDS):
            part.mkdir(mode=0o700, parents=True, exist_ok=True)
        faults = (trust.distrust_reason(checked) for checked in (folder, folder / _RECORDS))
        fault = next(filter(None, faults), "")
    except OSError:
        return None
    if not os.access(folder, os.W_OK | os.X_OK):
        return None
    if fault:
        instead = Path(tempfile.mkdtemp(prefix="rhi-kernels-"))
        atexit.register(shutil.rmtree, instead, ignore_errors=True)
        folder = _replaced[driver_folder] = instead / "pocl"
        (folder / _RECORDS).mkdir(mode=0o700, parents=True)
        text = (
            f"kernels aren't kept in {driver_folder}: {fault}; "
            f"they are built in {instead}, and removed at the end"
        )
        warnings.warn(text, RuntimeWarning, stacklevel=2)
    os.environ[_DRIVER_ENVIRONMENT] = str(folder)
    return folder


@cache_once
def settle_folder() -> Path | None:
    """Choose this process's folder, once, since PoCL ignores later changes of its variable."""
    return choose_folder()


def strip_comments(source: str) -> str:
    """Return source code without comments, whose lines keep their numbers.

    Comments name shaders; without them, shaders with the same stages share one program."""
    return _COMMENT.sub("", source)


@dataclass(frozen=True, slots=True)
class Request:
    """A program's source, and a key of source, options, device and driver."""

    key: str
    options: tuple[str, ...]
    source: str
    kernels: tuple[str, ...]
    declares: bool
    marked: bool

    def write(self, mark: str = _BUILT) -> tuple[str, tuple[str, ...]]:
        """Return the source code and options for the driver; lines keep their numbers.

        Args:
            mark: part of a function's name by which the program's folder is found, beside its key. One that
                is compiled without being linked has a mark of its own (`make_mark`), so that nothing else is
                ever taken for it.
        """
        source, options = self.source, self.options
        declarations = declare(strip_comments(source)) if self.declares else None
        if declarations is not None:
            source, options = f"{declarations}#line 1\n{source}", (*options, GUARD)
        if self.marked:
            name = f"rhi_{mark}_{self.key}"
            source = f"{source}\nvoid {name}(void);\nvoid {name}(void) {{}}\n"
        return source, options


class CachedProgram(NamedTuple):
    """An undamaged program in the cache.

    Attributes:
        code: its LLVM code; empty: it is built from its source.
        kernels: the kernels that have machine code.
    """

    code: bytes
    kernels: frozenset[str]


class KernelCache:
    """The compiled programs of one driver's version and device.

    Attributes:
        takes_code: whether the driver accepts LLVM code; True until it refuses some.
        declares: whether programs declare the functions that they use, instead of the driver's header
            (`rhi.backends.cl.pocl.declarations`).
    """

    def __init__(self, folder: Path | None, driver: str, declares: bool = False) -> None:
        """`folder`: None if the driver has none; nothing is known then. `driver`: what compiled kernels
        depend on."""
        self._folder = folder
        self._driver = driver
        self._written: set[str] = set()
        self._links: dict[tuple[str, str], str] = {}  # by key and kernel, of bare binaries
        self._patience = PATIENCE
        self._secret = b"" if folder is None else trust.read_key()
        self.takes_code = folder is not None
        self.declares = declares

    @property
    def works(self) -> bool:
        """True if compiled programs are found again."""
        return self._folder is not None

    def request(self, source: str, options: Sequence[str], kernels: Sequence[str] = ()) -> Request:
        """Return a program's request. Its key doesn't depend on comments, nor on how functions are
        declared."""
        whole = "\0".join((self._driver, *options, strip_comments(source)))
        key = hashlib.sha256(whole.encode()).hexdigest()[:24]
        return Request(key, tuple(options), source, tuple(kernels), self.declares, self.works)

    def find(self, key: str) -> CachedProgram | None:
        """Look up an undamaged program. Damaged files are removed."""
        if self._folder is None:
            return None
        record = self._folder / _RECORDS / key
        if not record.exists():  # another process may be about to write it, and has kept the code
            return None
        entry = program, files, checksum, _ = _read_record(self._folder, record)
        damaged = [] if program is None else self._list_damaged(key, program, files)
        complete = program is not None and not damaged
        code = self.read_code(key) if complete and checksum is not None else None
        if not complete or (
            checksum is not None and (code is None or self._sign(key, _CODE, code) != checksum)
        ):
            self._remove_damaged(key, entry, damaged)
            return None
        with suppress(OSError):
            os.utime(record)
        return CachedProgram(code or b"", frozenset(name.split("/")[0] for name in files if "/" in name))

    def _list_damaged(self, key: str, program: Path, files: dict[str, str]) -> list[Path]:
        """Return the files of a program that aren't there, or have another checksum than recorded."""
        damaged = []
        for name, expected in files.items():
            path = program / name
            try:
                is_whole = self._sign(key, name, path.read_bytes()) == expected
            except OSError:
                is_whole = False
            if not is_whole:
                damaged.append(path)
        return damaged

    @contextmanager
    def watch_use(self, key: str) -> Iterator[None]:
        """Check whether the driver uses the folder: whether it marks a program that is built inside.

        If not, the folder isn't used from then on. One process at a time checks, since each removes the mark
        first."""
        if self._folder is None:
            yield
            return
        try:
            lock = trust.lock(str(self._folder / _RECORDS / _USE_LOCK), self._patience)
        except TimeoutError:  # a process that is stopped holds it; nearly always the driver uses the folder
            yield
            return
        with lock or nullcontext():
            with suppress(OSError):
                self._mark_path(key).unlink()
            yield
            is_used = self._mark_path(key).exists()
        if not is_used:
            LOGGER.info("PoCL keeps kernels in another folder than %s: it was begun before rhi", self._folder)
            self._folder, self.takes_code = None, False

    def _mark_path(self, key: str) -> Path:
        assert self._folder is not None
        program, *_ = _read_record(self._folder, self._folder / _RECORDS / key)
        return (self._folder if program is None else program) / _USE_MARK

    def contains(self, key: str, kernels: Sequence[str] = ()) -> bool:
        """Return whether an undamaged program with machine code of these kernels is in the cache."""
        stored = self.find(key)
        return stored is not None and stored.kernels.issuperset(kernels)

    def choose(self, request: Request) -> tuple[str | bytes, tuple[str, ...]]:
        """Return a program's LLVM code, or its source if there is none, and the options to build it."""
        code = self.read_code(request.key)
        return (code, request.options) if code is not None else request.write()

    def read_code(self, key: str) -> bytes | None:
        """Return a program's LLVM code, or None if there is none. It is removed if it is damaged."""
        if self._folder is None:
            return None
        path = self._code_path(key)
        try:
            content = path.read_bytes()
        except OSError:
            return None
        code = self._unseal(key, content)
        if code is not None:
            return code
        with suppress(OSError):
            path.unlink()
        return None

    def store_code(self, key: str, mark: str) -> bytes | None:
        """Store the LLVM code of a program that was compiled with this mark, and return it; None if there is
        none."""
        if self._folder is None:
            return None
        program = self._search(f"rhi_{mark}_{key}".encode())
        if program is None:
            self.takes_code = False  # a version of the driver that keeps it elsewhere
            return None
        try:
            code = (program / _PROGRAM).read_bytes()
            if self.read_code(key) is None:  # no other process was first
                trust.write_atomically(self._code_path(key), self.seal(key, code))
            shutil.rmtree(program)
        except OSError:
            return None
        return self.read_code(key)

    def store_header(self, binary: bytes) -> None:
        """Store the bytes that all binaries of the driver begin with."""
        if self._folder is not None and self._read_header() is None:
            header = binaries.read_header(binary)
            with suppress(OSError):
                trust.write_atomically(self._header_path(), self.seal("", header, _HEADER))

    def _read_header(self) -> bytes | None:
        try:
            return self._unseal("", self._header_path().read_bytes(), _HEADER)
        except OSError:
            return None

    def _header_path(self) -> Path:
        assert self._folder is not None
        return self._folder / _RECORDS / (hashlib.sha256(self._driver.encode()).hexdigest()[:24] + _HEADER)

    def make_binary(self, request: Request) -> bytes | None:
        """Return a binary of a program's kernels that have machine code; None without any, or for an unknown
        driver.

        The program was just looked up. Its kernels take an address, and are launched with work-groups of one
        item."""
        if self._folder is None or not request.kernels or (header := self._read_header()) is None:
            return None
        program, *_ = _read_record(self._folder, self._folder / _RECORDS / request.key)
        codes = {kernel: Path(kernel, binaries.SMALL_GRID, f"{kernel}.so") for kernel in request.kernels}
        built = [
            kernel for kernel, code in codes.items() if program is not None and (program / code).is_file()
        ]
        if program is None or not built:
            return None
        process = leases.take(self._folder)
        if process is None:
            return None
        name = binaries.folder_name(request.key, process)
        try:
            for kernel in built:
                link, target = self._folder / name / codes[kernel], program / codes[kernel]
                link.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                if not link.exists() or not link.samefile(target):  # it was built again
                    new = link.with_suffix(f".{make_mark()}")
                    new.hardlink_to(target)
                    new.replace(link)  # at once, since PoCL may be looking for it
                self._links[request.key, kernel] = str(link)
        except OSError:  # no links there
            return None
        return binaries.write(header, name, built)

    def has_code(self, key: str, kernel: str) -> bool:
        """True if the driver finds machine code of a kernel that it may look for; True if it needs none.

        A kernel of a bare binary (`make_binary`) needs it, and ends the process without. Somebody may have
        emptied the folder. Then the folder is made again, so that the driver can write there.
        """
        link = self._links.get((key, kernel))
        if link is None or os.path.isfile(link):
            return True
        if self._folder is not None:
            with suppress(OSError):
                (self._folder / _RECORDS).mkdir(mode=0o700, parents=True, exist_ok=True)
        return False

    def drop_code(self, key: str) -> None:
        """Remove LLVM code that the driver doesn't take."""
        self.takes_code = False
        if self._folder is not None:
            with suppress(OSError):
                self._code_path(key).unlink()

    def is_recorded(self, key: str) -> bool:
        """True if a program that was looked up is still there. Once it is leased, it stays."""
        return self._folder is not None and (self._folder / _RECORDS / key).exists()

    def forget(self, key: str) -> None:
        """Remove the record of a program that the driver doesn't take.

        Its folder stays for a day, like others without a record: processes that use it may be writing
        there."""
        if self._folder is not None:
            with self._removing():
                self._remove(key, None)

    def seal(self, key: str, content: bytes, name: str = _CODE) -> bytes:
        """Return data to be stored under this name, such as LLVM code, behind its checksum."""
        return self._sign(key, name, content).encode() + content

    def _unseal(self, key: str, sealed: bytes, name: str = _CODE) -> bytes | None:
        """Return the data that `seal` was given; None if they are empty or damaged."""
        content = sealed[_CHECKSUM:]
        return content if content and sealed == self.seal(key, content, name) else None

    def _sign(self, key: str, name: str, content: bytes) -> str:
        return trust.sign(self._secret, content, key, name)

    def _code_path(self, key: str) -> Path:
        assert self._folder is not None
        return self._folder / _RECORDS / f"{key}{_CODE}"

    def hold(self, key: str) -> None:
        """Keep other processes from removing a program that is going to be built of its code, until this one
        ends."""
        if self._folder is None or leases.is_held(self._folder, key):
            return
        with self._removing():
            leases.hold(self._folder, key)

    @contextmanager
    def _removing(self) -> Iterator[bool]:
        """Lock out the removal of programs in other processes; yield whether that succeeded."""
        assert self._folder is not None
        try:
            lock = trust.lock(str(self._folder / _RECORDS / _TRIM_LOCK), self._patience)
        except TimeoutError:  # a process that is stopped holds it
            self._patience = _IMPATIENCE
            yield False
            return
        with lock or nullcontext():
            yield True

    def _remove_damaged(self, key: str, entry: _Entry, damaged: Sequence[Path]) -> None:
        """Remove a damaged program, unless another process has built it again meanwhile.

        Of a program in use only the damaged files are removed: the driver may be writing in its folder, and
        generates what is missing."""
        assert self._folder is not None
        with self._removing() as is_safe:
            if _read_record(self._folder, self._folder / _RECORDS / key) != entry:
                return
            stays = not is_safe or key in leases.list_held(self._folder)
            for path in damaged if stays else ():
                with suppress(OSError):
                    path.unlink()
            self._remove(key, None if stays else entry[0])

    def _remove(self, key: str, program_folder: Path | None) -> None:
        """Remove a program's record and files."""
        assert self._folder is not None
        for path in (self._folder / _RECORDS / key, self._code_path(key)):
            with suppress(OSError):
                path.unlink()
        if program_folder is not None:
            shutil.rmtree(program_folder, ignore_errors=True)

    def lock_path(self, key: str) -> str:
        """Return the path of the file that is locked while a program is built for the first time; empty for
        none."""
        return "" if self._folder is None else str(self._folder / _RECORDS / f"{key}.lock")

    @contextmanager
    def writing(self, key: str) -> Iterator[bool]:
        """Lock a program's build against other processes; yield whether that succeeded.

        It fails if a process has held the lock for so long that it may be stopped. Files that it writes
        mustn't be written then."""
        try:
            lock = trust.lock(self.lock_path(key), self._patience)
        except TimeoutError:
            self._patience = _IMPATIENCE
            yield False
            return
        with lock or nullcontext():
            yield True

    def record(self, key: str) -> None:
        """Record that a program's files are complete. Nothing is recorded of files that vanish meanwhile."""
        if self._folder is None:
            return
        code = self.read_code(key)
        program, *_ = _read_record(self._folder, self._folder / _RECORDS / key)
        name = _mark_name(key, code)
        if program is None or not _contains(program, name):  # one of code that isn't there any more
            program = self._search(name, code)
        if program is None:
            return
        with suppress(OSError):
            described = self._describe(key, program, code)
            trust.write_atomically(self._folder / _RECORDS / key, json.dumps(described).encode())
        self._written.add(key)

    def _describe(self, key: str, program: Path, code: bytes | None) -> dict[str, object]:
        """Return a program's record. Raises an `OSError` if another process removes files meanwhile."""
        assert self._folder is not None
        files = {
            str(path.relative_to(program)): self._sign(key, str(path.relative_to(program)), path.read_bytes())
            for path in (program / _PROGRAM, *program.glob("*/*/*.so"))
        }
        size = sum(path.stat().st_size for path in program.rglob("*") if path.is_file()) + len(code or b"")
        described: dict[str, object] = {
            "folder": str(program.relative_to(self._folder)),
            "files": files,
            "bytes": size,
        }
        if code is not None:
            described["code"] = self._sign(key, _CODE, code)
        return described

    def _search(self, name: bytes, code: bytes | None = None) -> Path | None:
        """Return the driver's folder of the program that has a function of this name and isn't `code`."""
        assert self._folder is not None
        # Nearly always it was written just now. Older ones were left by a process that ended before it
        # recorded them.
        for candidate in (
            candidate for upper in _list_newest(self._folder) for candidate in _list_newest(upper)
        ):
            with suppress(OSError):
                content = (candidate / _PROGRAM).read_bytes()
                if name in content and content != code:
                    return candidate
        return None

    def finish(self) -> None:
        """Record machine code that was generated since, and remove the least recently used programs beyond
        `LIMIT`."""
        if self._folder is None or not self._written:
            return
        for key in list(self._written):
            with suppress(TimeoutError), trust.lock(self.lock_path(key), 0.0) or nullcontext():
                self.record(key)  # unless another process is just writing, which records it, too
        self._written.clear()
        with suppress(OSError), self._removing() as is_safe:
            if is_safe:
                self._trim(self._folder)

    def _trim(self, folder: Path) -> None:
        entries: list[tuple[float, int, Path, Path]] = []
        for record in (folder / _RECORDS).iterdir():
            with suppress(OSError):
                used = record.stat().st_mtime
                program, _, _, size = _read_record(folder, record)
                if program is not None:
                    entries.append((used, size, record, program))
                elif used < time.time() - _OLD and not (
                    record.suffix == _CODE and record.with_suffix("").exists()
                ):
                    record.unlink()
        recorded = {program for *_, program in entries}
        leases.remove_stale(folder)
        leased = leases.list_held(folder)
        abandoned = min(time.time() - _OLD, leases.oldest_begin(folder))  # older than all who may use it
        recorded.update((folder / binaries.LINKS).glob("*"))  # which belong to processes
        for program in (
            set(folder.glob(_FOLDER_PATTERN)) - recorded
        ):  # nobody finds these: processes ended before they recorded them
            touched = program / _USE_MARK if (program / _USE_MARK).exists() else program
            with suppress(OSError):
                if touched.stat().st_mtime < abandoned:
                    shutil.rmtree(program, ignore_errors=True)
        total = sum(size for _, size, _, _ in entries)
        for _, size, record, program in sorted(entries):
            if total <= LIMIT:
                break
            if record.name in leased:
                continue
            self._remove(record.name, program)
            total -= size
        for path in folder.glob(_TEMPORARY_FILES):
            with suppress(OSError):
                status = path.stat()
                if status.st_size == 0 and status.st_mtime < time.time() - _OLD:
                    path.unlink()


_Entry: TypeAlias = tuple[Path | None, dict[str, str], str | None, int]
"""What a record says: see `_read_record`."""


def _list_newest(folder: Path) -> list[Path]:
    """Return the folders in a folder, the most recently changed first."""
    dated: list[tuple[float, str]] = []
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            with suppress(OSError):
                if entry.is_dir() and entry.name != _RECORDS:
                    dated.append((entry.stat().st_mtime, entry.path))
    return [Path(path) for _, path in sorted(dated, reverse=True)]


def _contains(program: Path, name: bytes) -> bool:
    """True if a program in the driver's folder has a function of this name."""
    try:
        return name in (program / _PROGRAM).read_bytes()
    except OSError:
        return False


def make_mark() -> str:
    """Return a mark that is unique among all processes."""
    return os.urandom(8).hex()


def _mark_name(key: str, code: bytes | None) -> bytes:
    """Return the name of the function by which a program's folder is found; `code`: its LLVM code, or
    None."""
    match = None if code is None else re.search(rf"rhi_[0-9a-f]+_{key}".encode(), code)
    return f"rhi_{_BUILT}_{key}".encode() if match is None else match[0]


def _read_record(folder: Path, record: Path) -> _Entry:
    """Return a record's folder, the checksums of its files by name, that of its LLVM code if it has any, and
    its bytes.

    The folder is None for a record that is damaged or unfinished, or that names a folder outside of PoCL's:
    records may come from other machines, and the folders that they name may be removed.
    """
    if record.suffix:  # code, which isn't read, or a lock
        return None, {}, None, 0
    try:
        fields = json.loads(record.read_bytes())
        name = PurePosixPath(fields["folder"])
        files = {str(path): str(checksum) for path, checksum in fields["files"].items()}
        code, size = fields.get("code"), int(fields.get("bytes", _TYPICAL))
        checksum = None if code is None else str(code)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None, {}, None, 0
    is_program = name.match(_FOLDER_PATTERN) and name.parts[0] != binaries.LINKS
    inside = all(".." not in PurePosixPath(file).parts and not file.startswith("/") for file in files)
    if ".." in name.parts or not is_program or len(name.parts) != 2 or not inside:
        return None, {}, None, 0
    return folder / name, files, checksum, size
