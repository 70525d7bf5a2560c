"""The farthest depths of blocks of pixels: each level has a quarter of the resolution of the level before.

A texel of level k covers 4ᵏ × 4ᵏ pixels, counted from the image's top left corner. Sizes are rounded up, so pixel (x,
y) is in texel (x >> 2k, y >> 2k) of each level, whatever the image's size; the last texels cover fewer pixels. (The
size of a mip level is rounded down, so its texels miss an edge of an image of odd size.) Level 0 is the depth texture
itself.

Level 1 takes two steps, four rows to one and then four columns to one: the first reads most, and reads whole rows in
their order, which vector machines do several times as fast as every fourth pixel.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import rhi.shading as sl
from renderer.scene import Depth
from rhi import Device, Encoder, Texture, UniformBuffer

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
    """Computes the farthest of `across` × `down` texels, or of fewer at an edge, from a level in the buffer."""

    work_group = (_GROUP, _GROUP)
    step: sl.Uniform[ReductionStep]
    farthest: sl.StorageRW[float]
    is_reversed = True
    across = SCALE
    down = SCALE

    def compute(self) -> None:
        at = sl.global_id().xy
        size = self.step.target
        if at.x >= size.x or at.y >= size.y:
            return
        last = self.step.source - 1
        found = 1.0 if self.is_reversed else 0.0
        for y in range(self.down):
            for x in range(self.across):
                depth = self.fetch(sl.min(sl.ivec2(self.across * at.x + x, self.down * at.y + y), last))
                found = sl.min(found, depth) if self.is_reversed else sl.max(found, depth)
        self.farthest[self.step.target_begin + at.y * size.x + at.x] = found

    def fetch(self, at: sl.ivec2) -> float:
        return self.farthest[self.step.source_begin + at.y * self.step.source.x + at.x]


class DownSampleTexture(DownSample):
    """Computes the farthest of four pixels of each column of the depth texture."""

    depth: sl.Texture2D
    across = 1

    def fetch(self, at: sl.ivec2) -> float:
        return self.depth.load(at).r


class DownSampleRows(DownSample):
    """Computes the farthest of four texels of each row of what `DownSampleTexture` has found."""

    down = 1


STEPS: Final = (DownSampleTexture, DownSampleRows, DownSample)
"""The shaders of the first step, of the second, and of each later one."""


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
        farthest: the depths of all levels, row by row, and behind them those of the first step.
    """

    def __init__(self, device: Device, size: tuple[int, int], levels: int | None = None) -> None:
        """There are `levels` besides the image, or by default as many as it takes to reach 16 texels a side, at least
        1."""
        self.size = size
        self.sizes = [size]
        # No level follows one of 16 texels a side: comparing with all of them costs less than another dispatch.
        while len(self.sizes) - 1 < (levels or 1) or (levels is None and max(self.sizes[-1]) > SCALE**2):
            width, height = self.sizes[-1]
            self.sizes.append((-(-width // SCALE), -(-height // SCALE)))
        self.begins, total = [-1], 0
        for width, height in self.sizes[1:]:
            self.begins.append(total)
            total += width * height
        self._targets = [(size[0], self.sizes[1][1]), *self.sizes[1:]]
        begins, sources = [-1, total, *self.begins[1:]], [size, *self._targets]
        self.farthest = device.storage(float, total + size[0] * self.sizes[1][1], label="farthest depths")
        self._device = device
        self._steps: list[UniformBuffer[ReductionStep]] = [
            device.uniform(ReductionStep(source=source, target=target, source_begin=begin, target_begin=target_begin))
            for source, target, begin, target_begin in zip(sources, self._targets, begins, begins[1:], strict=False)
        ]

    def build(self, encoder: Encoder, depth: Texture, direction: Depth) -> None:
        """Compute all levels from the image's depth. Must be called outside of passes."""
        for number, (step, target) in enumerate(zip(self._steps, self._targets, strict=True)):
            groups = tuple(-(-length // _GROUP) for length in target)
            reads: dict[str, Any] = {} if number else {"depth": depth}
            shader = of_direction(STEPS[min(number, len(STEPS) - 1)], direction)
            encoder.dispatch(self._device.program(shader), groups, step=step, farthest=self.farthest, **reads)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for resource in (self.farthest, *self._steps):
            resource.destroy()
