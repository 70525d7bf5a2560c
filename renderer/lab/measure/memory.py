"""The memory that a renderer uses on a device, from its commands: what was created and not destroyed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from renderer.frame.scene_images import SceneImages
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
        rows: all buffers and textures, the largest first.
        bytes: the memory of all.
        image_bytes: the memory of the arrays that hold the scene's images, with their mip levels.
        single_image_bytes: the memory that the images would take if each were a texture.
    """

    rows: list[MemoryRow]
    bytes: int
    image_bytes: int
    single_image_bytes: int


def describe_memory(commands: Iterable[Command], images: SceneImages | None) -> MemoryReport:
    """The memory that is in use after these commands; `images` are the scene's."""
    allocations: dict[object, tuple[str, str, int]] = {}
    for command in commands:
        if command.op is Op.DESTROY:
            allocations.pop(command["resource"], None)
        elif command.op is Op.CREATE_BUFFER:
            descriptor = command["descriptor"]
            allocations[command["buffer"]] = (descriptor.label, "buffer", descriptor.size)
        elif command.op is Op.CREATE_TEXTURE:
            descriptor = command["descriptor"]
            parts = [
                (*descriptor.level_size(level), descriptor.level_layers(level))
                for level in range(descriptor.levels)
            ]
            texels = sum(width * height * layers for width, height, layers in parts) * descriptor.samples
            numbers = {
                "layers": descriptor.layers,
                "levels": descriptor.levels,
                "samples": descriptor.samples,
            }
            described = [
                "{} × {}".format(*descriptor.size),
                *(f"{count} {noun}" for noun, count in numbers.items() if count > 1),
                descriptor.format.name,
            ]
            allocations[command["texture"]] = (
                descriptor.label,
                ", ".join(described),
                texels * descriptor.format.texel_bytes,
            )
    sizes: Counter[tuple[str, str]] = Counter()
    for name, shape, size in allocations.values():
        sizes[name, shape] += size
    counts = Counter((name, shape) for name, shape, _ in allocations.values())
    rows = [MemoryRow(*key, counts[key], size) for key, size in sizes.most_common()]
    return MemoryReport(
        rows,
        sum(sizes.values()),
        0 if images is None else images.bytes,
        0 if images is None else images.image_bytes,
    )
