"""The farthest depths of blocks of pixels: each level has a quarter of the resolution of the level before.

A texel of level k covers 4ᵏ × 4ᵏ pixels, counted from the image's top left corner. Sizes are rounded up, so pixel (x,
y) is in texel (x >> 2k, y >> 2k) of each level, whatever the image's size; the last texels cover fewer pixels. (The
size of a mip level is rounded down, so its texels miss an edge of an image of odd size.) Level 0 is the depth texture
itself.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import rhi.shading as sl
from renderer.scene import Depth
from rhi import Device, Encoder, StorageBuffer, Texture, UniformBuffer

SCALE: Final = 4
"""Number of texels of a level, in each direction, that one texel of the next level covers."""
_GROUP: Final = 8

FAR: Final = {Depth.REVERSED: 0.0, Depth.STANDARD: 1.0}
"""The farthest depth: that of a pixel where nothing is drawn."""


class ReductionStep(sl.Struct):
    """The step from one level to the next: their sizes, and their first elements in the buffer."""

    source: sl.ivec2
    target: sl.ivec2
    source_begin: int
    target_begin: int


class DownSample(sl.Shader):
    """Computes the farthest of 4 × 4 texels, or of fewer at an edge, from a level in the buffer."""

    work_group = (_GROUP, _GROUP)
    step: sl.Uniform[ReductionStep]
    farthest: sl.StorageRW[float]
    is_reversed = True

    def compute(self) -> None:
        at = sl.global_id().xy
        size = self.step.target
        if at.x >= size.x or at.y >= size.y:
            return
        last = self.step.source - 1
        found = 1.0 if self.is_reversed else 0.0
        for y in range(SCALE):
            for x in range(SCALE):
                depth = self.fetch(sl.min(SCALE * at + sl.ivec2(x, y), last))
                found = sl.min(found, depth) if self.is_reversed else sl.max(found, depth)
        self.farthest[self.step.target_begin + at.y * size.x + at.x] = found

    def fetch(self, at: sl.ivec2) -> float:
        return self.farthest[self.step.source_begin + at.y * self.step.source.x + at.x]


class DownSampleTexture(DownSample):
    """Computes the farthest of 4 × 4 pixels of the depth texture."""

    depth: sl.Texture2D

    def fetch(self, at: sl.ivec2) -> float:
        return self.depth.load(at).r


@cache
def of_direction(shader: type[Any], direction: Depth) -> type[Any]:
    """Return the variant of a shader with a constant `is_reversed` for a direction of depth."""
    if direction is Depth.REVERSED:
        return shader
    names = {"__module__": shader.__module__, "is_reversed": False}
    return type(f"{shader.__name__}Standard", (shader,), names)


class FarthestDepth:
    """The levels from 1 on of an image of `size` pixels.

    Attributes:
        size: (width, height) of the image. sizes: (width, height) of each level, from the image on.
        begins: the first element of each level in `farthest`, -1 for the image.
        farthest: the depths of all levels, row by row.
    """

    def __init__(self, device: Device, size: tuple[int, int], levels: int | None = None) -> None:
        """There are `levels` besides the image, or by default as many as it takes to reach one texel, at least 1."""
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

    def build(self, encoder: Encoder, depth: Texture, direction: Depth) -> None:
        """Compute all levels from the image's depth. Must be called outside of passes."""
        device = self._device
        for level, step in enumerate(self._steps, 1):
            groups = tuple(-(-length // _GROUP) for length in self.sizes[level])
            reads: dict[str, Any] = {"depth": depth} if level == 1 else {}
            shader = of_direction(DownSampleTexture if level == 1 else DownSample, direction)
            encoder.dispatch(device.program(shader), groups, step=step, farthest=self.farthest, **reads)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self.farthest.destroy()
        for step in self._steps:
            step.destroy()
