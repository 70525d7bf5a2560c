"""Files of a film's frames: their names, and their contents as image files.

A file of a frame is complete or isn't there: it is written under another name and then renamed. In a PNG the
film's identity is a text chunk, so frames of another film are noticed.
"""

from __future__ import annotations

import io
import re
import zlib
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.errors import DeviceError, refuse
from rhi_screen.rules import FILM_OUTPUT, SCREEN_MISSING

PNG: Final = ".png"
FAST: Final = 1
"""The compression of frames that a video is made of, which are deleted when it is complete."""
SMALL: Final = 6
"""The compression of frames that stay."""

_NUMBER: Final = re.compile(r"%0?\d*d")
_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_END: Final = b"\0\0\0\0IEND\xaeB`\x82"
_KEY: Final = b"film"
_PART: Final = ".part"


@dataclass(frozen=True, slots=True)
class FrameFiles:
    """The files of a film's frames.

    Attributes:
        folder: the folder of all frames.
        pattern: their name, with `%d` or such as `%05d` in place of the frame's number.
    """

    folder: Path
    pattern: str

    @property
    def suffix(self) -> str:
        """The ending, in lower case: `.png`."""
        return Path(self.pattern).suffix.lower()

    def path(self, number: int) -> Path:
        """Return the file of a frame."""
        return self.folder / (self.pattern % number)

    def write(self, number: int, content: bytes) -> None:
        """Write the file of a frame, completely or not at all."""
        path = self.path(number)
        part = path.with_name(path.name + _PART)
        part.write_bytes(content)
        part.replace(path)

    def read_identity(self, number: int) -> str | None:
        """Return the identity of the film that the file of a frame is of, "" if it doesn't say; None if there
        is no such file, or an incomplete one."""
        path = self.path(number)
        try:
            content = path.read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None
        if self.suffix != PNG:
            return "" if content else None
        if not (content.startswith(_SIGNATURE) and content.endswith(_END)):
            return None
        return _read_text(content)


def parse_output(output: Path, call: str) -> tuple[FrameFiles, Path | None]:
    """Return the files of frames that an output names, and the video to make of them, if it is one. The
    frames of a video are in a folder beside it until it is complete.

    Raises:
        ValidationError: `film-output` for a name that is neither.
    """
    if "%" not in output.name:
        if output.suffix.lower() in ("", *_list_image_suffixes(call)):
            refuse(FILM_OUTPUT, call, repr(str(output)), "NAME.mp4, or an image's name with %d or %05d in it")
        return FrameFiles(output.with_name(f"{output.name}.frames"), f"%05d{PNG}"), output
    rest = _NUMBER.sub("", output.name)
    if len(_NUMBER.findall(output.name)) != 1 or "%" in rest:
        refuse(FILM_OUTPUT, call, repr(output.name), "one %d, or such as %05d, and no other %")
    files = FrameFiles(output.parent, output.name)
    if files.suffix not in _list_image_suffixes(call):
        refuse(FILM_OUTPUT, call, repr(output.name), "a known ending of an image, such as .png")
    return files, None


def encode(pixels: NDArray[np.uint8], suffix: str, identity: str, compression: int) -> bytes:
    """Return pixels (height, width, 3 or 4) as an image file without their alpha.

    Args:
        suffix: the ending of the file's name, which says what it is.
        identity: a text that a PNG holds, too.
        compression: of a PNG, 0 to 9.
    """
    library = _import_pillow("rhi_screen.film")
    file = io.BytesIO()
    image = library.fromarray(np.ascontiguousarray(pixels[:, :, :3]))
    if suffix != PNG:
        image.save(file, library.registered_extensions()[suffix])
        return file.getvalue()
    image.save(file, "PNG", compress_level=compression)
    content = file.getvalue()
    if not identity:
        return content
    chunk = b"tEXt" + _KEY + b"\0" + identity.encode("latin-1", "replace")
    text = (len(chunk) - 4).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
    header = len(_SIGNATURE) + 25  # IHDR, with its length, its name and its checksum
    return content[:header] + text + content[header:]


def decode(content: bytes) -> NDArray[np.uint8]:
    """Return the pixels (height, width, 3) of an image file."""
    image = _import_pillow("rhi_screen.film").open(io.BytesIO(content)).convert("RGB")
    return np.array(image, np.uint8)


def _read_text(content: bytes) -> str:
    """Return the identity in a PNG, "" if there is none."""
    position = len(_SIGNATURE)
    while position + 12 <= len(content):
        length = int.from_bytes(content[position : position + 4], "big")
        kind, data = content[position + 4 : position + 8], content[position + 8 : position + 8 + length]
        if kind == b"tEXt" and data.startswith(_KEY + b"\0"):
            return data[len(_KEY) + 1 :].decode("latin-1")
        if kind == b"IDAT":
            break
        position += 12 + length
    return ""


def _list_image_suffixes(call: str) -> list[str]:
    """Return the endings of image files that can be written."""
    library = _import_pillow(call)
    library.init()
    return [suffix for suffix, kind in library.registered_extensions().items() if kind in library.SAVE]


def _import_pillow(call: str) -> Any:
    try:
        return import_module("PIL.Image")
    except ModuleNotFoundError as error:
        raise DeviceError(
            SCREEN_MISSING, call, "Pillow is missing", "", 'pip install "rhi[images]"'
        ) from error
