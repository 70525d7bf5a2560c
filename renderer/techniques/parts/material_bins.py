"""Lists of the pixels of each material, found on the device (Deferred+, 1.3.2, "an alternative rendering
strategy").

The pixels of the packed geometry buffer are sorted by material, and a compute shader lights those of each
shader of materials by one indirect dispatch. It is the chapter's counting sort by atomic counters:

1. `CountPixels` counts the pixels of each material; 2. `PrefixSum` finds where each list begins, in the order
of shaders; 3. `ListDispatches` finds the groups that each shader needs; 4. `ListPixels` writes the pixels to
their places.

The chapter dispatches once for each material. Here materials of one shader share a dispatch, as they share a
program. To rank the materials of 8 × 8 pixels in shared memory, so that they stay together, was tried:
shading then takes 0.8 of the time on cl, but listing 1.5 times, and 6 times on gl.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.frame import Frame, FramePass
from renderer.frame.mirrors import MirroredArray
from renderer.shaders.pixels import PixelRays
from renderer.shaders.prefix_sum import PrefixSum
from renderer.techniques.parts.geometry_buffer import MAX_MATERIALS
from renderer.techniques.parts.variants import bind
from rhi import Device, Program, StorageBuffer

LANES: Final = 256
"""Pixels that a work-group lights."""
_SIDE: Final = 8


class DispatchGroups(sl.Struct):
    """Arguments of an indirect dispatch."""

    x: sl.uint
    y: sl.uint
    z: sl.uint


class PixelRange(sl.Struct):
    """The range of a shader's pixels in the list."""

    begin: sl.uint
    end: sl.uint


class PixelKeys(sl.Shader):
    """Base of shaders that sort pixels by key: the rank of their material in the order of shaders."""

    work_group = (_SIDE, _SIDE)

    rays: sl.Uniform[PixelRays]
    packed: sl.UintTexture2D
    depth: sl.Texture2D
    keys: sl.Storage[sl.uint]
    counts: sl.StorageRW[sl.uint]

    def pixel_key(self) -> int:
        """Key of the invocation's pixel; -1 without a surface."""
        pixel = sl.global_id().xy
        size = self.packed.size()
        if pixel.x >= size.x or pixel.y >= size.y or self.depth.load(pixel).x == self.rays.farthest:
            return -1
        return int(self.keys[int(self.packed.load(pixel).y & sl.uint(MAX_MATERIALS - 1))])


class CountPixels(PixelKeys):
    """Counts the pixels of each key."""

    def compute(self) -> None:
        key = self.pixel_key()
        if key >= 0:
            sl.atomic_add(self.counts[key], sl.uint(1))


class ListDispatches(sl.Shader):
    """Computes each shader's range of pixels and its work-groups."""

    counts: sl.Storage[sl.uint]
    bounds: sl.Storage[sl.uint]
    ranges: sl.StorageRW[PixelRange]
    groups: sl.StorageRW[DispatchGroups]

    def compute(self) -> None:
        shader = sl.global_id().x
        begin = self.counts[int(self.bounds[shader])]
        end = self.counts[int(self.bounds[shader + 1])]
        self.ranges[shader] = PixelRange(begin=begin, end=end)
        count = (end - begin + sl.uint(LANES - 1)) // sl.uint(LANES)
        self.groups[shader] = DispatchGroups(x=count, y=sl.uint(1), z=sl.uint(1))


class ListPixels(PixelKeys):
    """Writes each pixel to the list, in the range of its key."""

    pixels: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        key = self.pixel_key()
        if key >= 0:
            pixel = sl.global_id().xy
            self.pixels[int(sl.atomic_add(self.counts[key], sl.uint(1)))] = (
                sl.uint(pixel.x) | sl.uint(pixel.y) << 16
            )


BIN_SHADERS: Final[tuple[type[sl.Shader], ...]] = (CountPixels, ListDispatches, ListPixels)
"""The shaders of `bins_pass`."""


class PixelBins:
    """Lists of a frame's pixels by material.

    Attributes:
        pixels: x and y in 16 bits each, those of a material side by side.
        ranges: the places of each shader's pixels.
        groups: the work-groups of each shader.
    """

    def __init__(self, device: Device) -> None:
        self.pixels: StorageBuffer[sl.uint] = device.storage(sl.uint, 1, label="binned pixels")
        self.ranges: StorageBuffer[PixelRange] = device.storage(PixelRange, 1, label="ranges of bins")
        self.groups: StorageBuffer[DispatchGroups] = device.storage(DispatchGroups, 1, label="groups of bins")
        self._counts: StorageBuffer[sl.uint] = device.storage(sl.uint, 1, label="counts of bins")
        self._keys = MirroredArray(device, sl.uint, "keys of materials")
        self._bounds = MirroredArray(device, sl.uint, "bounds of shaders")
        self._device = device

    def sort_pixels(self, frame: Frame) -> None:
        """List the pixels of the packed geometry buffer."""
        device, shaders = self._device, frame.resources.scene.materials["shader"]
        width, height = frame.targets["packed"].size
        self._reserve(width * height, len(shaders), 1 + int(shaders.max()))
        order = np.argsort(shaders, kind="stable")
        keys = np.zeros(len(order), np.uint32)
        keys[order] = np.arange(len(order))
        self._keys.write(keys)
        bounds: NDArray[Any] = np.searchsorted(shaders[order], np.arange(self.ranges.count + 1)).astype(
            np.uint32
        )
        self._bounds.write(bounds)
        self._counts.clear()
        shader_bindings = {
            "keys": self._keys.buffer,
            "counts": self._counts,
            "pixels": self.pixels,
            "bounds": self._bounds.buffer,
            "ranges": self.ranges,
            "groups": self.groups,
        }
        tiles = -(-width // _SIDE), -(-height // _SIDE)
        steps: tuple[tuple[type[sl.Shader], Any], ...] = (
            (CountPixels, tiles),
            (PrefixSum, 1),
            (ListDispatches, self.ranges.count),
            (ListPixels, tiles),
        )
        for shader, groups in steps:
            program: Program[...] = device.program(shader)
            device.dispatch(program, groups, **bind(frame, program, shader_bindings))

    def _reserve(self, pixels: int, materials: int, shaders: int) -> None:
        """Allocate buffers for as many pixels, materials and shaders."""
        if self.pixels.count < pixels:
            old, self.pixels = self.pixels, self._device.storage(sl.uint, pixels, label="binned pixels")
            old.destroy()
        if self._counts.count != materials + 1:
            counts = self._device.storage(sl.uint, materials + 1, label="counts of bins")
            old, self._counts = self._counts, counts
            old.destroy()
        if self.ranges.count != shaders:
            ranges = self._device.storage(PixelRange, shaders, label="ranges of bins")
            groups = self._device.storage(DispatchGroups, shaders, label="groups of bins")
            before = (self.ranges, self.groups)
            self.groups, self.ranges = (
                groups,
                ranges,
            )  # `ranges` last, whose length tells whether both are made
            for resource in before:
                resource.destroy()

    def read(self) -> list[NDArray[np.int64]]:
        """Pixels (k, 2), x and y, of each shader, in the order of their materials. Waits for the device."""
        pixels, ranges = self.pixels.read(), self.ranges.read()
        packed = [pixels[int(span["begin"]) : int(span["end"])] for span in ranges]
        return [np.stack([bits & 0xFFFF, bits >> 16], axis=1).astype(np.int64) for bits in packed]

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for resource in (self.pixels, self.ranges, self.groups, self._counts, self._keys, self._bounds):
            resource.destroy()


def bins_pass() -> FramePass[Frame]:
    """The pass that lists the pixels of materials, as the resource `bins`."""

    def sort_pixels(frame: Frame) -> None:
        frame.view.workspace(PixelBins).sort_pixels(frame)

    return FramePass(
        "bins",
        sort_pixels,
        "a shader is run for the pixels that have it",
        reads=("packed", "depth"),
        writes=("bins",),
    )
