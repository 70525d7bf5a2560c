"""Image files of every kind, for tests: written byte by byte, or by Pillow."""

from __future__ import annotations

import io
import os
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

LISTED = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "DDS", "TGA")
"""The formats that the documentation names."""

POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\n%%EndProlog\nshowpage\n%%EOF\n"
POSTSCRIPT_IN_DOS = (
    struct.pack("<IIIIIII", 0xC6D3D0C5, 32, len(POSTSCRIPT), 0, 0, 0, 0) + bytes(4) + POSTSCRIPT
)
"""The same with the head that files for DOS have."""

WAYS_TO_RUN_A_PROGRAM = {"postscript": POSTSCRIPT, "postscript in DOS": POSTSCRIPT_IN_DOS}


def make_png(
    width: int,
    height: int,
    rows: bytes,
    *,
    depth: int = 8,
    color_type: int = 6,
    transparent: bytes = b"",
    interlace: int = 0,
) -> bytes:
    """Return a PNG of rows that aren't filtered; no rows are a file without pixels. With `interlace` 1 they are
    the rows of its seven passes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, color_type, 0, 0, interlace))
    more = chunk(b"tRNS", transparent) if transparent else b""
    return b"\x89PNG\r\n\x1a\n" + head + more + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def make_deep_png(channels: NDArray[np.uint16], transparent: Any = None) -> bytes:
    """Return a PNG of 16 bits a channel: (height, width, 1 to 4), grey to RGBA. `transparent` is one
    colour."""
    height, width, count = channels.shape
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in channels)
    mark = b"" if transparent is None else np.asarray(transparent, ">u2").tobytes()
    color_type = {1: 0, 2: 4, 3: 2, 4: 6}[count]
    return make_png(width, height, rows, depth=16, color_type=color_type, transparent=mark)


def save(format: str, texels: NDArray[np.uint8]) -> bytes:
    """Return the bytes of an image file as Pillow writes it."""
    library = pytest.importorskip("PIL.Image", reason="no Pillow: pip install rhi[images]")
    file = io.BytesIO()
    library.fromarray(texels).save(file, format)
    return file.getvalue()


class ProgramWatch:
    """Notes the calls of programs that Pillow starts for a file. Stand-ins in the search path write them
    down."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._log = folder / "calls.txt"
        folder.mkdir()
        for name in ("gs", "gswin32c", "gswin64c", "djpeg", "cjpeg", "ppmquant", "ppmtogif", "xv"):
            program = folder / name
            program.write_text(
                f'#!/bin/sh\necho "{name} $@" >> {self._log}\n[ "$1" = --version ] && echo 10.0\n',
                encoding="utf-8",
            )
            program.chmod(0o755)
        monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")

    @property
    def calls(self) -> list[str]:
        """The command lines so far."""
        return self._log.read_text(encoding="utf-8").splitlines() if self._log.exists() else []
