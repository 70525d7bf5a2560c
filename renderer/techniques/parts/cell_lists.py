"""Lights of cells: techniques whose pixels are lit by the lights of their tile or cluster.

The lists are made on the device (`renderer.lights.culling`). They have the layout of the lists of objects, so a
shader that is lit by its object's lights becomes one that is lit by its cell's: only where a list begins and ends is
looked up elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import rhi.shading as sl
from renderer import rules
from renderer.frame import Frame, Needs, Pass
from renderer.lights.culling.cells import CellGrid, cell_index
from renderer.lights.culling.grid import LightGrid
from renderer.lights.culling.kernels import LightCounts
from renderer.lights.culling.table import find_sphere_test
from renderer.lights.culling.volumes import WORD
from renderer.shaders.pixels import PixelRays, PixelShader
from renderer.shaders.structs import SurfacePoint, SurfaceVarying
from renderer.techniques.parts.scene_shader import ForwardShader, LampShader
from renderer.techniques.parts.variants import Lighting, explain_lamps
from rhi import Device, refuse


@dataclass(frozen=True, slots=True)
class LightCells:
    """Cells of a view whose lights are listed: tiles of the image, divided by depth. It is called with a device to make
    what a view keeps for them.

    Attributes:
        tile: the width and height of a tile in pixels. slices: into how many parts its depths are divided.
        sphere_test: the name of the test of lights against cells, of `SPHERE_TESTS`.
    """

    tile: int
    slices: int = 1
    sphere_test: str = "exact"

    def __post_init__(self) -> None:
        for name in ("tile", "slices"):
            given = getattr(self, name)
            if type(given) is not int or given < 1:
                refuse(rules.BAD_TECHNIQUE, f"LightCells({name}=...)", given, "a whole number of 1 or more")
        find_sphere_test(self.sphere_test, "LightCells(sphere_test=...)")

    def __call__(self, device: Device) -> LightGrid:
        """Return new lists."""
        return LightGrid(device, tile=self.tile, slices=self.slices, sphere_test=self.sphere_test)


LightLists = Callable[[Device], LightGrid]
"""The function that makes the lists of a view: `LightCells`, or another function that is always the same one."""

TILES: Final = LightCells(16)
"""Tiles of 16 × 16 pixels, between the nearest and the farthest surface of each."""
CLUSTERS: Final = LightCells(64, 24)
"""Clusters: tiles of 64 × 64 pixels in 24 depth slices (Olsson, Billeter and Assarsson 2012)."""


class CellReader(PixelShader, LampShader):
    """The base of shaders that are lit by the lights of a cell.

    Pixels that a device shades together, such as the lanes of a work-item, go through their cells, one after
    the other (a "waterfall loop"): a list is then the same for all of them, and its lights are read once. Mostly they
    have one cell.
    """

    lean = True
    has_gaps = True

    grid: sl.Uniform[CellGrid]
    light_rows: sl.Storage[int]
    light_masks: sl.Storage[sl.uint]
    light_counts: sl.Uniform[LightCounts]

    def celllight(self, surface: SurfacePoint, distance: float) -> sl.vec3:
        """Return the light of the lamps of the pixel's cell at this distance along the view."""
        cell = self.find_cell(distance)
        color = sl.vec3(0.0)
        while True:
            shared = sl.broadcast_first(cell)
            if cell == shared:
                color = self.lamplight(surface, self.find_cell_lights(shared))
                break
        return color

    def find_cell(self, distance: float) -> int:
        """Return the pixel's cell at this distance along the view."""
        return cell_index(self.grid, self.find_pixel(), distance)

    def find_cell_lights(self, cell: int) -> sl.ivec3:
        """Return where the point lights of a cell begin in the light rows, where they end and the spot lights begin,
        and where those end.

        A list for which there is no room is the cell's bits in the masks. Their places are negative, counted from the
        masks' end.
        """
        places = sl.ivec3(self.light_rows[2 * cell], self.light_rows[2 * cell + 1], self.light_rows[2 * cell + 2])
        if places.z > len(self.light_rows):
            counts = self.light_counts
            begin = WORD * (cell * counts.words - len(self.light_masks))
            return sl.ivec3(begin, begin + WORD * counts.point_words, begin + WORD * counts.words)
        return places

    def find_row(self, place: int) -> int:
        """Return the row of the light at a place, or -1 if its bit says that it doesn't reach the cell."""
        if place >= 0:
            return self.light_rows[place]
        bit = place + WORD * len(self.light_masks)
        if ((self.light_masks[bit // WORD] >> sl.uint(bit % WORD)) & sl.uint(1)) == sl.uint(0):
            return -1
        light = bit % (WORD * self.light_counts.words)
        points = WORD * self.light_counts.point_words
        return light if light < points else light - points


def list_pass(needs: Needs, cells: LightLists, *, depth: str | None = None) -> Pass[Frame]:
    """Return the pass that lists the lights of cells, as the contents `light lists`.

    Args:
        depth: contents with the depth of all that is lit; cells then end at the surfaces of their tile.
    """

    def collect(frame: Frame) -> None:
        texture = None if depth is None else frame.targets[depth]
        grid = frame.view.workspace(cells)
        work = grid.prepare(frame.camera, frame.targets.size, frame.resources.lights, texture)
        frame.view.commands.next().dispatch(work)

    reads = () if depth is None else (depth,)
    return Pass("light lists", collect, explain_lamps(needs), reads=reads, writes=("light lists",))


def bind_lists(frame: Frame, cells: LightLists) -> dict[str, Any]:
    """Return the bindings of a `CellReader`, after the lists were made."""
    return frame.view.workspace(cells).bindings


class LitByCells(CellReader, ForwardShader):
    """Lights a fragment by the lights of its cell instead of those of its object."""

    rays: sl.Uniform[PixelRays]

    def lamplight_at(self, surface: SurfacePoint, v: SurfaceVarying) -> sl.vec3:
        return self.celllight(surface, sl.dot(v.position, self.rays.forward))


def by_cells(cells: LightLists) -> Lighting:
    """Return the lighting by the lights of cells."""
    return Lighting((LitByCells,), bind=partial(bind_lists, cells=cells), reads=("light lists",))
