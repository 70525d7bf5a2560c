"""Trust in cached files: whether a folder is the user's own, and checksums that only the user can make.

Compiled kernels are machine code, and texts of shaders are Python: whoever can write them, or have others'
taken for them, runs code as the user. So a folder that belongs to somebody else, or that others may write,
isn't used; and the checksums of its files are made with a key that only the user can read. It lies beside the
default folder, in the user's cache, so that a folder from elsewhere doesn't bring its own. A program that
ships its kernels says its key in `RHI_CACHE_KEY`, when they are made and when they are used.
"""

from __future__ import annotations

import os
import stat
import time
from contextlib import suppress
from pathlib import Path
from threading import get_ident
from typing import IO, Final

try:
    import fcntl
except ImportError:  # not on Windows, where PoCL's users are few
    fcntl = None  # type: ignore[assignment]

ENVIRONMENT: Final = "RHI_CACHE_KEY"
FOLDER: Final = "RHI_CACHE"
MIN_FREE_BYTES: Final = 32 << 20
"""Bytes that must be free: PoCL fails to build where its folder is full."""
_KEY_BYTES: Final = 32


def user_cache() -> Path:
    """Return the folder of all that this package caches for the user.

    A relative `XDG_CACHE_HOME` is ignored, as its specification demands: each working folder would have a cache
    and a key of its own, which others might have put there."""
    folder = os.environ.get("XDG_CACHE_HOME", "")
    return Path(folder if os.path.isabs(folder) else os.path.expanduser("~/.cache")) / "rhi"


def cache_folder(name: str) -> Path:
    """Return the folder of this name in the one that `RHI_CACHE` names, or in the user's cache. It may not
    exist."""
    return Path(os.environ.get(FOLDER, "") or user_cache()).absolute() / name


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file that others never see in part.

    Raises:
        OSError: it can't be written.
    """
    fresh = path.with_suffix(f".{os.getpid()}.{get_ident()}{time.monotonic_ns()}")
    fresh.write_bytes(content)
    fresh.replace(path)


def distrust_reason(folder: Path) -> str:
    """The reason why an existing folder isn't used; "" if it is the user's own and has room."""
    status = folder.stat()
    if hasattr(os, "geteuid"):
        if status.st_uid not in (os.geteuid(), 0):
            return "it belongs to another user"
        if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            return "other users may write to it"
    from shutil import disk_usage  # seldom, as below: most programs keep nothing

    free = disk_usage(folder).free
    if free < MIN_FREE_BYTES:
        return f"only {free / 1e6:.1f} MB are free there"
    return "" if read_key() else f"no key can be stored in {user_cache()}"


def read_key() -> bytes:
    """Return the user's key, which is made if there is none; empty if it can't be kept."""
    given = os.environ.get(ENVIRONMENT, "")
    if given:
        from hashlib import blake2b

        return blake2b(given.encode(), digest_size=_KEY_BYTES).digest()
    path = user_cache() / "key"
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not path.exists():
            from tempfile import mkstemp

            handle, fresh = mkstemp(dir=path.parent)  # which only the user can read
            with os.fdopen(handle, "wb") as file:
                file.write(os.urandom(_KEY_BYTES))
            if hasattr(os, "link"):
                with suppress(FileExistsError):  # another process was first
                    os.link(fresh, path)
                os.unlink(fresh)
            else:  # a page, which is one process
                os.replace(fresh, path)
        status, key = path.stat(), path.read_bytes()
    except OSError:
        return b""
    is_own = not hasattr(os, "geteuid") or (status.st_uid == os.geteuid() and not status.st_mode & 0o077)
    return key if is_own and len(key) == _KEY_BYTES else b""


def sign(secret: bytes, content: bytes, *names: str) -> str:
    """Return the keyed checksum of a file's content, for the names under which it may be used."""
    from hashlib import blake2b

    digest = blake2b(digest_size=16, key=secret)
    for part in (*(name.encode() for name in names), content):
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.hexdigest()


def lock(path: str, patience: float) -> IO[bytes] | None:
    """Lock a file; None where there are no locks, or it can't be written.

    Others may remove the file before it is locked. A lock on a file that has no name any more would keep nobody
    out, so the file of that name is locked then.

    Raises:
        TimeoutError: another process holds it for longer than `patience`, in seconds.
    """
    if not path or fcntl is None:
        return None
    until = time.monotonic() + patience
    while True:
        try:
            file = open(path, "wb")  # noqa: SIM115
        except OSError:  # the folder has been removed or can't be written
            return None
        _wait_for_lock(file, path, until)
        with suppress(OSError):
            if os.path.samestat(os.fstat(file.fileno()), os.stat(path)):
                return file
        file.close()
        if time.monotonic() >= until:
            raise TimeoutError(f"{path} is removed again and again")


def _wait_for_lock(file: IO[bytes], path: str, until: float) -> None:
    """Lock an open file. It is closed if that fails."""
    assert fcntl is not None
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() >= until:
                file.close()
                raise TimeoutError(f"{path} is locked") from None
        except BaseException:
            file.close()
            raise
        time.sleep(0.01)
