"""The memory that a renderer holds on a device, as its commands say: what it has created and not destroyed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from renderer.frame.images import SceneImages
from rhi import Command, Op


@dataclass(frozen=True, slots=True)
class MemoryRow:
    """Buffers or textures of one name and shape: `count` of them take `bytes` together.

    Attributes:
        shape: of textures the texels, the layers, the mip levels and the format; `buffer` of buffers.
    """

    name: str
    shape: str
    count: int
    bytes: int


@dataclass(frozen=True, slots=True)
class MemoryReport:
    """The memory of a renderer.

    Attributes:
        rows: all buffers and textures, the largest first. bytes: the memory of all.
        image_bytes: the memory of the arrays that hold the scene's images, with their mip levels.
        single_image_bytes: that of the images if each were a texture of its own.
    """

    rows: list[MemoryRow]
    bytes: int
    image_bytes: int
    single_image_bytes: int


def describe_memory(commands: Iterable[Command], images: SceneImages | None) -> MemoryReport:
    """Return what is left on a device after these commands; `images` are those of the scene."""
    held: dict[object, tuple[str, str, int]] = {}
    for command in commands:
        if command.op is Op.DESTROY:
            held.pop(command["resource"], None)
        elif command.op is Op.CREATE_BUFFER:
            made = command["descriptor"]
            held[command["buffer"]] = (made.label, "buffer", made.size)
        elif command.op is Op.CREATE_TEXTURE:
            made = command["descriptor"]
            parts = [(*made.level_size(level), made.level_layers(level)) for level in range(made.levels)]
            texels = sum(width * height * layers for width, height, layers in parts) * made.samples
            numbers = {"layers": made.layers, "levels": made.levels, "samples": made.samples}
            described = [
                "{} × {}".format(*made.size),
                *(f"{count} {what}" for what, count in numbers.items() if count > 1),
                made.format.name,
            ]
            held[command["texture"]] = (made.label, ", ".join(described), texels * made.format.texel_bytes)
    sizes: Counter[tuple[str, str]] = Counter()
    for name, shape, size in held.values():
        sizes[name, shape] += size
    counts = Counter((name, shape) for name, shape, _ in held.values())
    rows = [MemoryRow(*key, counts[key], size) for key, size in sizes.most_common()]
    return MemoryReport(
        rows, sum(sizes.values()), 0 if images is None else images.bytes, 0 if images is None else images.image_bytes
    )
