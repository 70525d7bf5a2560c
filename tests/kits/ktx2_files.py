"""Files of KTX 2, written for tests."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

SIGNATURE = b"\xabKTX 20\xbb\r\n\x1a\n"
NUMBERS = {"BC1": 131, "BC3": 137, "BC4": 139, "BC5": 141, "BC6H": 143, "BC7": 145, "BC7_SRGB": 146}


def encode_ktx2(
    number: int,
    size: tuple[int, int],
    levels: Sequence[NDArray[np.uint8] | bytes],
    *,
    scheme: int = 0,
    faces: int = 1,
    layers: int = 0,
    depth: int = 0,
    metadata: bytes = b"",
) -> bytes:
    """Encode levels of blocks; the smallest comes first in the file, as the specification wants it."""
    raw = [bytes(level) if isinstance(level, bytes) else level.tobytes() for level in levels]
    packed = [
        zlib.compress(data) if scheme == 3 else _compress(data) if scheme == 2 else data for data in raw
    ]
    start = 80 + 24 * len(levels) + len(metadata)
    index = {}
    body = b""
    for level in reversed(range(len(levels))):
        body += bytes(-(start + len(body)) % 16)
        index[level] = struct.pack("<3Q", start + len(body), len(packed[level]), len(raw[level]))
        body += packed[level]
    header = struct.pack("<9I", number, 1, *size, depth, layers, faces, len(levels), scheme)
    header += struct.pack("<4I2Q", 0, 0, 80 + 24 * len(levels), len(metadata), 0, 0)
    return SIGNATURE + header + b"".join(index[level] for level in range(len(levels))) + metadata + body


def _compress(data: bytes) -> bytes:
    import zstandard  # optional

    return zstandard.ZstdCompressor().compress(data)


def make_blocks(
    size: tuple[int, int], block_bytes: int, levels: int, seed: int = 1
) -> list[NDArray[np.uint8]]:
    """Make levels of random blocks."""
    rng, width, height = np.random.default_rng(seed), *size
    return [
        rng.integers(
            0, 256, (-(-max(height >> level, 1) // 4), -(-max(width >> level, 1) // 4), block_bytes)
        ).astype(np.uint8)
        for level in range(levels)
    ]
