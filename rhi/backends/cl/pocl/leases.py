"""Links to machine code that belong to a process, and that no other process removes.

- PoCL reads a kernel's machine code from disk at its first launch, and again whenever a launch has more items
  than all before. If the file is gone, PoCL ends the process. Another process may remove it meanwhile: one
  that keeps the folder of compiled kernels within its limit.
- So each process has a folder of its own for the links that its binaries name (`binaries.folder_name`). In it
  lies a file that the process locks for as long as it lives.
- The system releases the lock when the process ends, in whatever way. The next process that begins or trims
  removes the folder then (`remove_stale`).
- PoCL also writes machine code beside a program's LLVM code at any launch, and ends the process if the folder
  vanishes meanwhile. So a process names the programs that it has built of code (`hold`). Nobody trims these.
"""

from __future__ import annotations

import os
import shutil
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Final

from rhi.backends.cl.pocl import binaries
from rhi.contract import trust

_LOCK: Final = "lease"
_BEGUN: Final = "begun"
"""An empty file that is as old as the process's folder; attempts to lock change the age of the other one."""
_HELD: Final = ".held"
"""Suffix of the empty files that name the programs which a process has built of LLVM code."""
_ATTEMPTS: Final = 4
_OLD: Final = 86400.0
"""Seconds after which a folder that nobody can lock is removed: links of older versions."""
_guard: Final = threading.RLock()  # threads take one name together
_leases: Final[dict[Path, tuple[int, str, int]]] = {}
"""By folder of compiled kernels: the process, its name there, and a descriptor of its locked file.

Nothing closes the descriptor: the driver may need the links until the process has ended."""


def take(folder: Path) -> str | None:
    """Return this process's name in a folder of compiled kernels; None if it can't have one.

    Without locks there is none, since nobody could tell when the process has ended.
    """
    with _guard:
        lease = _leases.get(folder)
        if lease is not None and lease[0] == os.getpid() and _lock_path(folder, lease[1]).exists():
            return lease[1]
        return _take_new(folder)


def _take_new(folder: Path) -> str | None:
    remove_stale(folder)
    for _ in range(_ATTEMPTS):  # another process may take a folder that isn't locked yet for a stale one
        name = os.urandom(binaries.PROCESS_CHARACTERS // 2).hex().upper()
        path = _lock_path(folder, name)
        try:
            path.parent.mkdir(mode=0o700, parents=True)
            file = trust.lock(str(path), 0.0)
        except TimeoutError:
            continue
        except OSError:
            return None
        if file is None:
            if not path.parent.exists():  # the other process has removed it
                continue
            shutil.rmtree(path.parent, ignore_errors=True)
            return None
        with file:
            with suppress(OSError):
                path.with_name(_BEGUN).touch(mode=0o600)
            _leases[folder] = os.getpid(), name, os.dup(file.fileno())
            return name
    return None


def hold(folder: Path, key: str) -> None:
    """Note that this process uses the program of this key until it ends."""
    process = take(folder)
    if process is not None:
        with suppress(OSError):
            _lock_path(folder, process).with_name(key + _HELD).touch(mode=0o600)


def is_held(folder: Path, key: str) -> bool:
    """True if this process has named the program of this key as used, and nobody has removed that since."""
    lease = _leases.get(folder)
    if lease is None or lease[0] != os.getpid():
        return False
    return _lock_path(folder, lease[1]).with_name(key + _HELD).exists()


def list_held(folder: Path) -> set[str]:
    """Return the keys of the programs that processes use."""
    return {path.stem for path in (folder / binaries.LINKS).glob(f"*/*{_HELD}")}


def oldest_begin(folder: Path) -> float:
    """Return when the oldest of the processes that live took its folder, in seconds since the epoch."""
    times = [time.time()]
    for path in (folder / binaries.LINKS).glob(f"*/{_BEGUN}"):
        with suppress(OSError):
            times.append(path.stat().st_mtime)
    return min(times)


def _lock_path(folder: Path, name: str) -> Path:
    return folder / binaries.LINKS / name / _LOCK


def remove_stale(folder: Path) -> None:
    """Remove the links of processes that have ended."""
    lease = _leases.get(folder)
    own_name = lease[1] if lease is not None and lease[0] == os.getpid() else ""
    with suppress(OSError), os.scandir(folder / binaries.LINKS) as entries:
        for entry in entries:
            if entry.name == own_name:
                continue
            path = Path(entry.path)
            if not (path / _LOCK).exists():  # just being made, or of an older version
                with suppress(OSError):
                    if entry.stat().st_mtime < time.time() - _OLD:
                        shutil.rmtree(path, ignore_errors=True)
                continue
            with suppress(TimeoutError):  # its process lives
                file = trust.lock(str(path / _LOCK), 0.0)
                if file is not None:
                    with file:
                        shutil.rmtree(path, ignore_errors=True)
