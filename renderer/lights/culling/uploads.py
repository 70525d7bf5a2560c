"""Uploads of a frame that let the device cull its lights: the grid of cells, and the volumes of the lights."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from renderer.lights.culling.cells import CellGrid
from renderer.lights.culling.cone_tests import Cone
from renderer.lights.culling.kernels import LightCounts
from renderer.lights.culling.projections import make_grid
from renderer.lights.culling.volumes import find_volumes
from renderer.scene import Camera, Lights, Perspective
from rhi import Device, StorageBuffer, UniformBuffer
from rhi.shading import vec4


class BufferSet:
    """Storage buffers by name, each of the size that a frame needs."""

    def __init__(self, device: Device, label: str) -> None:
        self._device = device
        self._label = label
        self._buffers: dict[str, StorageBuffer[Any]] = {}

    def __getitem__(self, name: str) -> StorageBuffer[Any]:
        """Return a buffer."""
        return self._buffers[name]

    def fit(self, name: str, element: type[Any], count: int) -> StorageBuffer[Any]:
        """Return a buffer with `count` elements; it is created again if it has another number."""
        buffer = self._buffers.get(name)
        if buffer is None or len(buffer) != count:
            if buffer is not None:
                buffer.destroy()
            buffer = self._buffers[name] = self._device.storage(element, count, label=f"{self._label}: {name}")
        return buffer

    def destroy(self) -> None:
        """Destroy the buffers."""
        for buffer in self._buffers.values():
            buffer.destroy()
        self._buffers = {}


class LightUploads:
    """The grid of cells and the volumes of the lights of one frame at a time, on the device.

    Attributes:
        layout: the grid.
        words, point_words: the number of words with a bit for each light, and of those before the spot lights'.
    """

    def __init__(self, device: Device, *, tile: int, slices: int = 1, first_slice: float | None = None) -> None:
        """Cells are tiles of `tile` × `tile` pixels, divided into `slices` by depth (see `make_grid`)."""
        self.tile, self.slices, self.first_slice = tile, slices, first_slice
        self.layout: CellGrid = make_grid(Perspective(), (1, 1), tile, slices=slices)
        self.words = self.point_words = 0
        self.parameters: UniformBuffer[CellGrid] = device.uniform(self.layout)
        self.counts: UniformBuffer[LightCounts] = device.uniform(LightCounts(words=0, point_words=0))
        self._buffers: Final = BufferSet(device, "light volumes")

    @property
    def count(self) -> tuple[int, int, int]:
        """The columns, rows and slices of the grid."""
        columns, rows, slices = self.layout.count
        return columns, rows, slices

    def write(self, camera: Camera, size: tuple[int, int], lights: Lights) -> None:
        """Upload an image's grid, of `size` pixels, and the volumes of all point and spot lights."""
        volumes = find_volumes(lights, camera)
        words = volumes.words, volumes.point_words
        if words != (self.words, self.point_words):
            self.words, self.point_words = words
            self.counts.write(LightCounts(words=self.words, point_words=self.point_words))
        self.layout = make_grid(
            camera.projection,
            size,
            self.tile,
            slices=self.slices,
            first_slice=self.first_slice,
            reach=volumes.reach,
        )
        self.parameters.write(self.layout)
        spheres = self._buffers.fit("spheres", vec4, round_up(len(volumes.spheres)))
        if len(volumes.spheres):
            spheres.write(volumes.spheres.astype(np.float32))
        if len(volumes.cones):
            self._buffers.fit("cones", Cone, round_up(len(volumes.cones))).write(volumes.cones)

    @property
    def bindings(self) -> dict[str, Any]:
        """The bindings of shaders that test lights: `grid`, `lights` and `spheres`."""
        return {"grid": self.parameters, "lights": self.counts, "spheres": self._buffers["spheres"]}

    @property
    def cones(self) -> dict[str, Any]:
        """The binding `cones` of shaders that test spot lights, of which there must be some."""
        return {"cones": self._buffers["cones"]}

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self.parameters.destroy()
        self.counts.destroy()
        self._buffers.destroy()


def round_up(count: int) -> int:
    """Return the next power of two, so that a changing count seldom changes a buffer's size."""
    return 1 << max(count - 1, 0).bit_length()
