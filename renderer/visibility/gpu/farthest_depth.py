"""The farthest depths of blocks of pixels: each level has a quarter of the resolution of the level before.

A texel of level k covers 4ᵏ × 4ᵏ pixels, counted from the image's top left corner. Sizes are rounded up, so
pixel (x, y) is in texel (x >> 2k, y >> 2k) of each level, whatever the image's size; the last texels cover
fewer pixels. (The size of a mip level is rounded down, so its texels miss an edge of an image of odd size.)
Level 0 is the depth texture itself.

Level 1 takes two steps, four rows to one and then four columns to one: the first reads most, and reads whole
rows in their order, which vector machines do several times as fast as every fourth pixel.
"""

from __future__ import annotations

from typing import Any, Final

import rhi.shading as sl
from renderer.scene import Depth
from rhi import Device, Encoder, Program, StorageBuffer, Texture, UniformBuffer
from rhi.errors.shared_caches import cache_once

SCALE: Final = 4
"""Number of texels of a level, in each direction, that one texel of the next level covers."""
COARSEST: Final = 16
"""No level follows one of this many texels a side: comparing with all of them costs less than another
dispatch."""
_GROUP: Final = 8

FAR: Final = {Depth.REVERSED: 0.0, Depth.STANDARD: 1.0}
"""The farthest depth: that of a pixel where nothing is drawn."""


class ReductionStep(sl.Struct):
    """The step from one level to the next: their sizes, and their first elements in the buffer."""

    source: sl.ivec2
    target: sl.ivec2
    source_offset: int
    target_offset: int


class DownSample(sl.Shader):
    """Computes the farthest of `across` × `down` texels, or of fewer at an edge, from a level in the
    buffer."""

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
        farthest_depth = 1.0 if self.is_reversed else 0.0
        for y in range(self.down):
            for x in range(self.across):
                depth = self.fetch(sl.min(sl.ivec2(self.across * at.x + x, self.down * at.y + y), last))
                farthest_depth = (
                    sl.min(farthest_depth, depth) if self.is_reversed else sl.max(farthest_depth, depth)
                )
        self.farthest[self.step.target_offset + at.y * size.x + at.x] = farthest_depth

    def fetch(self, at: sl.ivec2) -> float:
        return self.farthest[self.step.source_offset + at.y * self.step.source.x + at.x]


class DownSampleTexture(DownSample):
    """Computes the farthest of four pixels of each column of the depth texture."""

    depth: sl.Texture2D
    across = 1

    def fetch(self, at: sl.ivec2) -> float:
        return self.depth.load(at).r


class DownSampleRows(DownSample):
    """Computes the farthest of four texels of each row of `rows`, which `DownSampleTexture` has written."""

    rows: sl.Storage[float]
    down = 1

    def fetch(self, at: sl.ivec2) -> float:
        return self.rows[at.y * self.step.source.x + at.x]


STEPS: Final = (DownSampleTexture, DownSampleRows, DownSample)
"""The shaders of the first step, of the second, and of each later one."""


@cache_once
def depth_variant(shader: type[Any], direction: Depth) -> type[Any]:
    """Return the variant of a shader with a constant `is_reversed` for a direction of depth."""
    if direction is Depth.REVERSED:
        return shader
    names = {"__module__": shader.__module__, "is_reversed": False}
    return type(f"{shader.__name__}Standard", (shader,), names)


class DepthPyramid:
    """The levels from 1 on of an image of `size` pixels.

    Attributes:
        size: (width, height) of the image.
        sizes: (width, height) of each level; level 0 is the image.
        offsets: the first element in `farthest` of each level from 1 on.
        farthest: the depths of all levels from 1 on, row by row.
    """

    def __init__(self, device: Device, size: tuple[int, int], levels: int | None = None) -> None:
        """Create the buffers of `levels` levels besides the image; by default as many as it takes to reach
        `COARSEST` texels a side, at least 1."""
        self.size = size
        self.sizes = [size]
        while len(self.sizes) - 1 < (levels or 1) or (levels is None and max(self.sizes[-1]) > COARSEST):
            width, height = self.sizes[-1]
            self.sizes.append((-(-width // SCALE), -(-height // SCALE)))
        self.offsets: list[int] = []
        total = 0
        for width, height in self.sizes[1:]:
            self.offsets.append(total)
            total += width * height
        self._device = device
        self.farthest: StorageBuffer[float] = device.storage(float, total, label="farthest depths")
        rows_size = (size[0], self.sizes[1][1])
        self._rows: StorageBuffer[float] = device.storage(
            float, rows_size[0] * rows_size[1], label="farthest depths of rows"
        )
        self._targets = [rows_size, *self.sizes[1:]]
        sources = [size, *self._targets[:-1]]
        # The first step writes `_rows` and the second reads it: both begin at its first element.
        target_offsets = [0, *self.offsets]
        source_offsets = [0, 0, *self.offsets[:-1]]
        self._steps: list[UniformBuffer[ReductionStep]] = [
            device.uniform(
                ReductionStep(
                    source=source, target=target, source_offset=source_offset, target_offset=target_offset
                )
            )
            for source, target, source_offset, target_offset in zip(
                sources, self._targets, source_offsets, target_offsets, strict=True
            )
        ]

    def build(self, encoder: Encoder, depth: Texture, direction: Depth) -> None:
        """Compute all levels from the image's depth. Must be called outside of passes."""
        first: dict[str, Any] = {"depth": depth, "farthest": self._rows}
        second: dict[str, Any] = {"rows": self._rows, "farthest": self.farthest}
        later: dict[str, Any] = {"farthest": self.farthest}
        for number, (step, target) in enumerate(zip(self._steps, self._targets, strict=True)):
            kind = min(number, len(STEPS) - 1)
            program: Program[...] = self._device.program(depth_variant(STEPS[kind], direction))
            groups = tuple(-(-length // _GROUP) for length in target)
            encoder.dispatch(program, groups, step=step, **(first, second, later)[kind])

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for resource in (self.farthest, self._rows, *self._steps):
            resource.destroy()
