"""Uploads of a frame for light culling on the device: the grid of cells, and the volumes of the lights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from renderer.light_kinds.bounds import WORD_FIELDS
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.light_kinds.volumes import Cone
from renderer.lights.culling.cells import ClusterGrid
from renderer.lights.culling.grid_projection import make_grid
from renderer.lights.culling.kernels import LightMaskSize
from renderer.lights.culling.volumes import compute_light_volumes
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
        if buffer is None or buffer.count != count:
            old = buffer
            buffer = self._device.storage(element, count, label=f"{self._label}: {name}")
            self._buffers[name] = buffer
            if old is not None:
                old.destroy()
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
        count: the columns, rows and slices of the grid.
        has_cones: whether some lights have a cone.
        word_ends: the words with a bit for each light: behind which those of each kind end.
    """

    def __init__(
        self, device: Device, *, tile: int, slices: int = 1, first_slice: float | None = None
    ) -> None:
        """Cells are tiles of `tile` × `tile` pixels, divided into `slices` by depth (see `make_grid`)."""
        self.tile, self.slices, self.first_slice = tile, slices, first_slice
        self.layout: ClusterGrid = make_grid(Perspective(), (1, 1), tile, slices=slices)
        self.count = (1, 1, slices)
        self.word_ends = (0,) * len(LOCAL_LIGHT_KINDS)
        self.parameters: UniformBuffer[ClusterGrid] = device.uniform(self.layout)
        self.counts: UniformBuffer[LightMaskSize] = device.uniform(_mask_size(self.word_ends))
        self.has_cones = False
        self._buffers: Final = BufferSet(device, "light volumes")

    @property
    def words(self) -> int:
        """The number of words with a bit for each light."""
        return self.word_ends[-1]

    def write(self, camera: Camera, size: tuple[int, int], lights: Lights) -> None:
        """Upload an image's grid, of `size` pixels, and the volumes of all lights with a position."""
        volumes = compute_light_volumes(lights, camera)
        if volumes.word_ends != self.word_ends:
            self.word_ends = volumes.word_ends
            self.counts.write(_mask_size(self.word_ends))
        self.layout = make_grid(
            camera.projection,
            size,
            self.tile,
            slices=self.slices,
            first_slice=self.first_slice,
            reach=volumes.reach,
        )
        width, height = size
        self.count = -(-width // self.tile), -(-height // self.tile), self.slices
        self.parameters.write(self.layout)
        spheres = self._buffers.fit("spheres", vec4, round_up(len(volumes.spheres)))
        if len(volumes.spheres):
            spheres.write(volumes.spheres.astype(np.float32))
        self.has_cones = len(volumes.cones) > 0
        if self.has_cones:
            self._buffers.fit("cones", Cone, round_up(len(volumes.cones))).write(volumes.cones)

    @property
    def bindings(self) -> dict[str, Any]:
        """The bindings of shaders that test lights: `grid`, `lights` and `spheres`."""
        return {"grid": self.parameters, "lights": self.counts, "spheres": self._buffers["spheres"]}

    @property
    def cones(self) -> dict[str, Any]:
        """The binding `cones` of shaders that test the cones of lights; some lights must have one."""
        return {"cones": self._buffers["cones"]}

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self.parameters.destroy()
        self.counts.destroy()
        self._buffers.destroy()


def _mask_size(word_ends: Sequence[int]) -> LightMaskSize:
    return LightMaskSize(words=word_ends[-1], **dict(zip(WORD_FIELDS, word_ends, strict=False)))


def round_up(count: int) -> int:
    """Return the next power of two, so that a changing count seldom changes a buffer's size."""
    return 1 << max(count - 1, 0).bit_length()
