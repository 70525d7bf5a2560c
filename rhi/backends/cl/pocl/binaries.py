"""Binaries of PoCL 3.1's format (version 9) that name kernels and contain no code.

- PoCL creates a program from such a binary without LLVM: it reads the kernels' names and arguments, and finds
  their machine code in the folder that the binary names. It ends the process if machine code isn't there, so
  this is for kernels whose machine code was just checked, launched as it was compiled for (`SMALL_GRID`).
- All binaries begin with the same mark, the same number of the device and the same version, which are taken
  from one that the driver has written.
- Integers have the least significant byte first; a text is its length in 4 bytes, then its characters.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final

SMALL_GRID: Final = "1-1-1-goffs0-smallgrid"
"""The folder of a kernel's machine code for work-groups of one item, of which there are fewer than
`LARGE_GRID`."""
LARGE_GRID: Final = 65535
LINKS: Final = "RH"
"""The folder of all processes' links. PoCL's own names have letters up to P."""
PROCESS_CHARACTERS: Final = 12
_FOLDER_CHARACTERS: Final = 40
_HEADER: Final = 20  # bytes: "poclbin" and a zero, the device's number, the version
_VERSION: Final = 9
_EXECUTABLE: Final = 4 << 32
_ARGUMENT: Final = struct.pack("<IIQII", 0x11A3, 0x119E, 0, 0, 8)
"""An argument: no image, private memory, no qualifier, a scalar of 8 bytes."""
_ALL_ARGUMENT_INFO: Final = 0x1F  # of an argument: qualifiers, type, name


def read_header(binary: bytes) -> bytes:
    """Return the bytes that all binaries of a device begin with; `binary` is one of them."""
    return binary[:_HEADER]


def folder_name(key: str, process: str) -> str:
    """Return the folder of a binary's machine code, which belongs to a process (`leases`): 40 characters."""
    return f"{LINKS}/{process}/{key.upper():_<{_FOLDER_CHARACTERS - len(LINKS) - len(process) - 2}}"


def write(header: bytes, folder: str, kernels: Sequence[str]) -> bytes | None:
    """Return a binary of kernels with one argument, an address; None for a driver of another version."""
    if len(header) != _HEADER or header[-4:] != struct.pack("<I", _VERSION):
        return None
    files = _write_text("/rhi") + _write_text("-")  # PoCL refuses binaries without files
    parts = [header, struct.pack("<IQI", len(kernels), _EXECUTABLE, 1), folder.encode(), b"\0"]
    parts += struct.pack("<Q", len(files)), files
    for kernel in kernels:
        argument = _ARGUMENT + _write_text("address") + _write_text("ulong")
        rest = _write_text(kernel) + struct.pack("<IIQQQ", 1, 0, 1, 1, 1) + _write_text("")
        rest += struct.pack("<Q", _ALL_ARGUMENT_INFO) + argument
        parts += struct.pack("<QQI", 20 + len(rest), 0, len(argument)), rest
    return b"".join(parts)


def _write_text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()
