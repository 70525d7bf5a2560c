"""Files of Radiance (`.hdr`): linear light of high range.

Source: Ward, Real Pixels, in Graphics Gems II, 1991; Radiance's file formats.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

SIGNATURES: Final = b"#?RADIANCE", b"#?RGBE"
"""The first bytes of a file, either of them."""
_MAX_TEXELS: Final = 1 << 26


def count_texels(content: bytes) -> int:
    """The number of texels that a file says it has, before they are decoded.

    Raises:
        ValueError: it isn't such a file.
    """
    height, width, _, _ = _split(content)
    return height * width


def _split(content: bytes) -> tuple[int, int, bytes, bytes]:
    """The height, the width, the header and the texels of a file."""
    if not content.startswith(SIGNATURES):
        raise ValueError("it doesn't begin with #?RADIANCE")
    header, _, rest = content.partition(b"\n\n")
    if b"32-bit_rle_xyze" in header:
        raise ValueError("its colors are XYZ, not RGB")
    size, _, data = rest.partition(b"\n")
    words = size.decode("ascii", "replace").split()
    if len(words) != 4 or words[0] != "-Y" or words[2] != "+X":
        raise ValueError(f"its rows are {size[:40]!r}, not -Y height +X width")
    height, width = int(words[1]), int(words[3])
    if not (height > 0 and width > 0 and height * width <= _MAX_TEXELS):
        raise ValueError(f"it has {width} × {height} texels, of at most {_MAX_TEXELS:,}")
    return height, width, header, data


def decode_radiance(content: bytes) -> NDArray[Any]:
    """Decode a file of Radiance: red, green, blue and a shared exponent, plain or in runs.

    Raises:
        ValueError, IndexError: it isn't such a file, or ends too early.
    """
    height, width, header, data = _split(content)
    exposure = 1.0
    for line in header.split(b"\n"):
        if line.startswith(b"EXPOSURE="):
            exposure *= float(line.partition(b"=")[2])
    if not (np.isfinite(exposure) and exposure > 0.0):
        raise ValueError(f"its exposure is {exposure}")
    encoded = np.empty((height, width, 4), np.uint8)
    at = 0
    for row in encoded:
        has_runs = 8 <= width < 32768 and data[at : at + 2] == b"\x02\x02"
        if not has_runs:
            plain = np.frombuffer(data, np.uint8, 4 * width, at).reshape(width, 4)
            if (plain[:, :3] == 1).all(axis=1).any():
                raise ValueError("its rows are in runs of the old kind")
            row[:] = plain
            at += 4 * width
            continue
        if int.from_bytes(data[at + 2 : at + 4], "big") != width:
            raise ValueError("a row has another width")
        at = _decode_row(data, at + 4, row)
    exponent = encoded[..., 3].astype(np.int32)
    scale = np.ldexp(1.0, exponent - 136) * (exponent > 0) / exposure
    return ((encoded[..., :3] + 0.5) * scale[..., None]).astype(np.float32)


def _decode_row(data: bytes, at: int, row: NDArray[np.uint8]) -> int:
    """Decode the runs of a row's four channels (width, 4) from a position on; return where they end."""
    for channel in range(4):
        column = 0
        while column < len(row):
            count = data[at]
            is_run = count > 128
            count = count - 128 if is_run else count
            if not 0 < count <= len(row) - column or at + 1 + (1 if is_run else count) > len(data):
                raise ValueError("a run is longer than its row, or than the file")
            values = data[at + 1] if is_run else np.frombuffer(data, np.uint8, count, at + 1)
            row[column : column + count, channel] = values
            at += 2 if is_run else 1 + count
            column += count
    return at
