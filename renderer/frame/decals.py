"""The decals of a scene on a device, and the grid of cells by which pixels find those around them.

A cell lists the decals whose bounds overlap it, in the order in which they are projected. So a pixel looks at few of
them, however many there are, and passes that know no objects find them as well.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.frame.mirrors import MirroredArray, MirroredTable, MirroredValue, split_doubles
from renderer.frame.scene_images import SceneImages
from renderer.scene.arrays import Floats, Indices
from renderer.scene.decals import Decals
from renderer.shaders.decals import Decal, DecalGrid
from rhi import Device, Format, UniformBuffer
from rhi.math.indexing import count_indices, repeat_each

_MOST_CELLS: Final = 32
"""Along an axis."""
_PAIRS: Final = 64
"""The most cells, in the mean, that list a decal."""
_SLACK: Final = 1e-3
"""Of its extents, by which a decal's bounds are too large: positions of pixels are rounded."""
_MOST_FADE: Final = 1e6


class DecalBuffers:
    """The decals that may cover something, on a device.

    Attributes:
        decals: the array that shaders read.
        cells: a table of where the list of each cell begins, and then of the lists.
    """

    def __init__(self, device: Device) -> None:
        self.decals = MirroredArray(device, Decal, "decals")
        self.cells = MirroredTable(device, Format.R32UI, "decal cells")
        self._device = device
        self._grid: MirroredValue[DecalGrid] | None = None
        self._version = -1, 0

    @property
    def grid(self) -> UniformBuffer[DecalGrid] | None:
        """The constants of the grid; None without any decal."""
        return None if self._grid is None else self._grid.buffer

    def update(self, decals: Decals, images: SceneImages | None) -> None:
        """Make the device have the decals of a scene; nothing is left there of a scene without any."""
        version = decals.version, 0 if images is None else images.version
        if self._version == version:
            return
        self._version = version
        if not len(decals.seen):
            self.destroy()
            return
        assert images is not None, "a decal has an image"
        array = decals.array[decals.seen]
        rows = np.zeros(len(array), Decal.dtype)
        rows["to_box"][:, :, :3] = decals.to_boxes
        rows["high"], rows["low"] = split_doubles(decals.centers)
        rows["array"], rows["layer"] = images.arrays_and_layers(array["texture"])
        axes = decals.to_boxes[:, 2]
        rows["axis"] = axes / np.sqrt((axes**2).sum(axis=1, keepdims=True))
        inner, outer = np.cos(array["inner_angle"]), np.cos(array["outer_angle"])
        rows["outer"], rows["fade"] = outer, 1.0 / np.maximum(inner - outer, 1.0 / _MOST_FADE)
        rows["color"], rows["strength"] = array["color"], array["strength"]
        self.decals.write(rows)
        margin = decals.extents * (1.0 + _SLACK)
        corner, density, counts, table = list_cells(decals.centers - margin, decals.centers + margin)
        high, low = split_doubles(corner)
        grid = DecalGrid(high=high, low=low, density=density, counts=counts)
        if self._grid is None:
            self._grid = MirroredValue(self._device, grid)
        self._grid.write(grid)
        self.cells.write(table)

    def destroy(self) -> None:
        """Destroy the buffers."""
        self.decals.destroy()
        self.cells.destroy()
        if self._grid is not None:
            self._grid.destroy()
            self._grid = None


def list_cells(lower: Floats, upper: Floats) -> tuple[Floats, Floats, Indices, Indices]:
    """List, for each cell of a grid around boxes (k, 3), the boxes that overlap it, ascending.

    Returns:
        The corner (3,) of the grid, its cells per metre (3,), their number (3,) and the table: where the list of each
        cell begins in it, where the last one ends, and the lists.
    """
    corner = lower.min(axis=0)
    span = np.maximum(upper.max(axis=0) - corner, 1e-30)
    typical = np.maximum(np.median(upper - lower, axis=0), 1e-30)
    counts: Indices = np.clip(np.ceil(span / typical), 1, _MOST_CELLS).astype(np.int64)
    while True:
        density = counts / span
        first = np.clip(np.floor((lower - corner) * density), 0, counts - 1).astype(np.int64)
        last = np.clip(np.floor((upper - corner) * density), 0, counts - 1).astype(np.int64)
        sizes = last - first + 1
        pairs = sizes.prod(axis=1)
        if pairs.sum() <= _PAIRS * len(lower) or counts.max() == 1:
            break
        counts = np.maximum(counts // 2, 1)
    box = repeat_each(np.arange(len(lower)), pairs)
    local = np.arange(len(box)) - repeat_each(np.cumsum(pairs) - pairs, pairs)
    x, y = local % sizes[box, 0], local // sizes[box, 0] % sizes[box, 1]
    z = local // (sizes[box, 0] * sizes[box, 1])
    cell = ((first[box, 2] + z) * counts[1] + first[box, 1] + y) * counts[0] + first[box, 0] + x
    order = np.argsort(cell, kind="stable")
    cell_count = int(counts.prod())
    begins = np.concatenate([[0], np.cumsum(count_indices(cell, minlength=cell_count))]) + cell_count + 1
    return corner, density, counts, np.concatenate([begins, box[order]]).astype(np.uint32)
