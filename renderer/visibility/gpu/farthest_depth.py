"""The farthest depth of ever larger blocks of pixels: a quarter of the resolution at each level.

Level k has a texel for each 4ᵏ × 4ᵏ pixels from the image's top left corner on. Sizes are rounded up, so a pixel (x, y)
is in texel (x >> 2k, y >> 2k) of each level, whatever the image's size; the last texels are of fewer pixels. (A mip's
size is rounded down, and its texels miss an edge of an odd size.) Level 0 is the depth texture itself.
"""

from __future__ import annotations

from typing import Final

from renderer.scene import Depth
from rhi import Device, StorageBuffer, Texture, UniformBuffer
from rhi.shading import (
    Shader,
    StorageRW,
    Struct,
    Texture2D,
    Uniform,
    global_id,
    ivec2,
    max,
    min,
)

__rhi_internal__ = True

SCALE: Final = 4
"""Texels of a level, each way, to one of the next."""
_GROUP: Final = 8

FAR: Final = {Depth.REVERSED: 0.0, Depth.STANDARD: 1.0}
"""Where nothing is."""


class ReductionStep(Struct):
    """From one level to the next: their sizes, and where in the buffer they begin."""

    source: ivec2
    target: ivec2
    source_begin: int
    target_begin: int


class DownSample(Shader):
    """The farthest of 4 × 4 texels, or of as many as there are."""

    work_group = (_GROUP, _GROUP)
    step: Uniform[ReductionStep]
    farthest: StorageRW[float]
    is_reversed = True

    def compute(self) -> None:
        at = global_id().xy
        size = self.step.target
        if at.x >= size.x or at.y >= size.y:
            return
        last = self.step.source - 1
        found = 1.0 if self.is_reversed else 0.0
        for y in range(SCALE):
            for x in range(SCALE):
                depth = self.fetch(min(SCALE * at + ivec2(x, y), last))
                found = min(found, depth) if self.is_reversed else max(found, depth)
        self.farthest[self.step.target_begin + at.y * size.x + at.x] = found

    def fetch(self, at: ivec2) -> float:
        return self.farthest[self.step.source_begin + at.y * self.step.source.x + at.x]


class DownSampleStandard(DownSample):
    """For depth that grows with distance."""

    is_reversed = False


class DownSampleTexture(DownSample):
    """The same of the image's depth."""

    depth: Texture2D

    def fetch(self, at: ivec2) -> float:
        return self.depth.load(at).r


class DownSampleTextureStandard(DownSampleTexture):
    """For depth that grows with distance."""

    is_reversed = False


_SHADERS: Final = {
    Depth.REVERSED: (DownSampleTexture, DownSample),
    Depth.STANDARD: (DownSampleTextureStandard, DownSampleStandard),
}


class FarthestDepth:
    """Levels 1 and up of an image of `size` pixels.

    Attributes:
        size: of the image. sizes: (width, height) of each level, the image's first.
        begins: where each level begins in `farthest`, -1 for the image.
        farthest: all levels' depths, row by row.
    """

    def __init__(self, device: Device, size: tuple[int, int], levels: int | None = None) -> None:
        """`levels` besides the image; without, as many as it takes to get to one texel, 1 or more."""
        self.size = size
        self.sizes = [size]
        while len(self.sizes) - 1 < (levels or 1) or (levels is None and self.sizes[-1] != (1, 1)):
            width, height = self.sizes[-1]
            self.sizes.append((-(-width // SCALE), -(-height // SCALE)))
        self.begins, total = [-1], 0
        for width, height in self.sizes[1:]:
            self.begins.append(total)
            total += width * height
        self.farthest: StorageBuffer[float] = device.storage(float, total, label="farthest depths")
        self._device = device
        self._steps: list[UniformBuffer[ReductionStep]] = [
            device.uniform(
                ReductionStep(
                    source=self.sizes[level - 1],
                    target=self.sizes[level],
                    source_begin=self.begins[level - 1],
                    target_begin=self.begins[level],
                )
            )
            for level in range(1, len(self.sizes))
        ]

    def build(self, depth: Texture, direction: Depth) -> None:
        """Find the farthest depths of the image's; outside of passes."""
        device = self._device
        from_texture, from_level = _SHADERS[direction]
        for level, step in enumerate(self._steps, 1):
            groups = tuple(-(-length // _GROUP) for length in self.sizes[level])
            if level == 1:
                program = device.program(from_texture)
                device.dispatch(program, groups, step=step, farthest=self.farthest, depth=depth)
            else:
                device.dispatch(device.program(from_level), groups, step=step, farthest=self.farthest)

    def destroy(self) -> None:
        """Give everything back that was made on the device."""
        self.farthest.destroy()
        for step in self._steps:
            step.destroy()
