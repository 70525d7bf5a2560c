"""Limits of model files: files that a stranger wrote shouldn't fill memory, wait for ever, or read others.

Limits are generous, and said by `load_model(…, limits=…)`, or in a scene's text: `model.gltf:outside`,
`model.gltf:unlimited`. They are counted while the file is read, before memory is taken.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Final

from renderer import rules
from renderer.content import ktx2
from renderer.content.file_index import FileIndex
from renderer.content.progress import report
from renderer.content.radiance import SIGNATURES, count_texels
from renderer.scene.files import read_file
from rhi import ValidationError, open_image
from rhi.errors import refuse

_ZEROS: Final = 1 << 20
_ZEROS_PER_BYTE: Final = 16
_IMAGE_PART: Final = 8


@dataclass(frozen=True, slots=True)
class ModelLimits:
    """The limits of a model file.

    Attributes:
        bytes: of the file, and of all that it names.
        pixels: of all its images together; a single one has at most an eighth.
        vertices: and indices, of all its meshes together.
        seconds: until it is read.
        outside: whether it may name files that aren't in its folder.
    """

    bytes: float = 4 << 30
    pixels: float = 1 << 29
    vertices: float = 1 << 25
    seconds: float = 600.0
    outside: bool = False

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_LIMIT)
        for name in ("bytes", "pixels", "vertices", "seconds"):
            if not getattr(self, name) >= 0:
                refuse(
                    rules.BAD_LIMIT, f"ModelLimits({name}=...)", getattr(self, name), "0 or more; may be inf"
                )


@dataclass(slots=True)
class Budget:
    """The remaining limits of a file that is being read."""

    path: str
    limits: ModelLimits = field(default_factory=ModelLimits)
    start_time: float = field(default_factory=time.monotonic)
    used: dict[str, int] = field(default_factory=dict)
    index: FileIndex = field(default_factory=FileIndex)
    used_files: set[str] = field(default_factory=set)

    def spend(self, kind: str, amount: int, maximum: float | None = None) -> None:
        """Count `amount` of a kind: a field of the limits, or what has at most `maximum`.

        Raises:
            ValidationError: `scene-model-limit`: it is too much, or has taken too long.
        """
        whole = self.used[kind] = self.used.get(kind, 0) + amount
        maximum = getattr(self.limits, kind) if maximum is None else maximum
        if whole > maximum:
            self._refuse(f"{whole:,} {kind}", f"{maximum:,.0f}")
        if time.monotonic() - self.start_time > self.limits.seconds:
            self._refuse(f"more than {self.limits.seconds:g} s", f"{self.limits.seconds:g} s")

    def spend_zeros(self, count: int) -> None:
        """Count elements without bytes in the file, and refuse more than its size suggests."""
        most = inf if self.limits.vertices == inf else _ZEROS + _ZEROS_PER_BYTE * self.used.get("bytes", 0)
        self.spend("elements without bytes", count, most)

    def spend_image(self, content: bytes) -> None:
        """Count the pixels of an encoded image, which is decoded only then."""
        try:
            if content.startswith(SIGNATURES):
                pixels = count_texels(content)
            elif content.startswith(ktx2.SIGNATURE):
                pixels = ktx2.count_texels(content)
            else:
                with open_image(content, max_pixels=inf) as image:
                    pixels = image.width * image.height
        except (ValidationError, ValueError):  # decoding says what is wrong
            return
        self.spend_pixels(pixels)

    def spend_pixels(self, pixels: int) -> None:
        """Count the pixels of an image before it is decoded."""
        if pixels > self.limits.pixels / _IMAGE_PART:
            self._refuse(f"an image of {pixels:,} pixels", f"{self.limits.pixels / _IMAGE_PART:,.0f}")
        self.spend("pixels", pixels)

    def read(self, file: str | Path) -> bytes:
        """Return the bytes of a regular file, and count them.

        Raises:
            OSError, ValueError: as of `read_file`.
        """
        left = min(self.limits.bytes, 1 << 62) - self.used.get("bytes", 0)
        report("files", len(self.used_files), len(self.used_files) + 1)
        content = read_file(file, int(max(left, 0)))
        self.used_files.add(str(file))
        self.spend("bytes", len(content))
        self.index.note(file, content, self.path)
        return content

    def find(self, file: Path) -> Path:
        """Return a file that this one names, or where it was moved to, if that may be read."""
        return self.index.find(file, Path(self.path).parent, self.allows)

    def allows(self, file: Path) -> bool:
        """Return whether a file may be read: if it isn't in the folder of this one, only if that was asked
        for."""
        return self.limits.outside or file.resolve().is_relative_to(Path(self.path).parent.resolve())

    def _refuse(self, value: str, allowed: str) -> None:
        refuse(rules.MODEL_LIMIT, f"load_model({self.path!r})", f"{self.path}: {value}", f"at most {allowed}")
