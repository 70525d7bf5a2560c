"""Lights of cells: techniques whose pixels are lit by the lights of their tile or cluster.

The lists are made on the device (`renderer.lights.culling`). They have the layout of the lists of objects, so
a shader that is lit by its object's lights becomes one that is lit by its cell's: only where a list begins
and ends is looked up elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import rhi.shading as sl
from renderer import rules
from renderer.frame import Frame, FrameEffects, FramePass
from renderer.light_kinds.bounds import KIND_COUNT, WORD_FIELDS, LightBounds, index_in_kind
from renderer.light_kinds.generation import define
from renderer.lights.culling.cells import ClusterGrid, cell_index
from renderer.lights.culling.kernels import LightMaskSize
from renderer.lights.culling.light_lists import LightLists
from renderer.lights.culling.table import lookup_sphere_test
from renderer.lights.culling.volumes import WORD
from renderer.shaders.pixels import PixelRays, PixelShader
from renderer.shaders.structs import SurfacePoint, SurfaceVarying
from renderer.techniques.parts.scene_shader import ForwardShader, LocalLightShader
from renderer.techniques.parts.variants import Lighting, explain_local_lights
from rhi import Device, refuse


@dataclass(frozen=True, slots=True)
class ClusterSettings:
    """Sizes of the tiles or clusters of a view whose lights are listed. Calling it with a device creates
    the view's `LightLists`.

    Attributes:
        tile: the width and height of a tile in pixels.
        slices: into how many parts its depths are divided.
        sphere_test: the name of the test of lights against cells, of `SPHERE_TESTS`.
    """

    tile: int
    slices: int = 1
    sphere_test: str = "exact"

    def __post_init__(self) -> None:
        for name in ("tile", "slices"):
            value = getattr(self, name)
            if type(value) is not int or value < 1:
                refuse(
                    rules.BAD_TECHNIQUE, f"ClusterSettings({name}=...)", value, "a whole number of 1 or more"
                )
        lookup_sphere_test(self.sphere_test, "ClusterSettings(sphere_test=...)")

    def __call__(self, device: Device) -> LightLists:
        """Create the light lists of a view."""
        return LightLists(device, tile=self.tile, slices=self.slices, sphere_test=self.sphere_test)


@dataclass(frozen=True, slots=True)
class TilesInFront:
    """The part of tiles between the near plane and their farthest opaque surface, where transparent surfaces
    are seen. Calling it with a device creates the view's `LightLists`.

    Attributes:
        tiles: the sizes of the tiles.
    """

    tiles: ClusterSettings

    def __call__(self, device: Device) -> LightLists:
        """Create the light lists of a view."""
        tiles = self.tiles
        return LightLists(
            device, tile=tiles.tile, slices=tiles.slices, sphere_test=tiles.sphere_test, from_near=True
        )


LightListsFactory = Callable[[Device], LightLists]
"""The function that makes the lists of a view: `ClusterSettings`, or another function that is always the same
one."""

LIGHT_LISTS: Final = "light lists"
"""The resource with the light lists of opaque surfaces."""
TILES: Final = ClusterSettings(16)
"""Tiles of 16 × 16 pixels, between the nearest and the farthest surface of each."""
CLUSTERS: Final = ClusterSettings(64, 24)
"""Clusters: tiles of 64 × 64 pixels in 24 depth slices (Olsson, Billeter and Assarsson 2012)."""


class CellReader(LocalLightShader):
    """Base of shaders that read the light lists of tiles or clusters (`LightLists`)."""

    lean = True
    has_gaps = True

    grid: sl.Uniform[ClusterGrid]
    light_list: sl.Storage[int]
    light_masks: sl.Storage[sl.uint]
    light_counts: sl.Uniform[LightMaskSize]


if TYPE_CHECKING:

    class CellBoundsReader(CellReader):
        """The base of shaders that read where the lists of cells begin and end."""

        def cell_light_range(self, cell: int) -> LightBounds:
            """The bounds of the lights of a cell in the light list.

            A list for which there is no room is the cell's bits in the masks. Its bounds are negative,
            counted from the masks' end.
            """

else:
    CellBoundsReader = define(
        f"""
class CellBoundsReader(CellReader):
    def cell_light_range(self, cell: int) -> LightBounds:
        entries = LightBounds(self.light_list[{KIND_COUNT} * cell], {
            ", ".join(f"self.light_list[{KIND_COUNT} * cell + {number + 1}]" for number in range(KIND_COUNT))
        })
        if entries.{"xyzw"[KIND_COUNT]} > len(self.light_list):
            counts = self.light_counts
            begin = WORD * (cell * counts.words - len(self.light_masks))
            return LightBounds(begin, {
            ", ".join(f"begin + WORD * counts.{name}" for name in (*WORD_FIELDS, "words"))
        })
        return entries

    def get_light_index(self, entry: int) -> int:
        if entry >= 0:
            return self.light_list[entry]
        bit = entry + WORD * len(self.light_masks)
        if ((self.light_masks[bit // WORD] >> sl.uint(bit % WORD)) & sl.uint(1)) == sl.uint(0):
            return -1
        light = bit % (WORD * self.light_counts.words)
"""
        + "".join(f"        {name} = WORD * self.light_counts.{name}\n" for name in WORD_FIELDS)
        + f"        return {index_in_kind('light', WORD_FIELDS)}\n",
        "CellBoundsReader",
        __name__,
        CellReader=CellReader,
        LightBounds=LightBounds,
        WORD=WORD,
        sl=sl,
    )


class LightListReader(PixelShader, CellBoundsReader):
    """Base of shaders that light a surface by the light list of its tile or cluster.

    Pixels that a device shades together, such as the lanes of a work-item, go through their cells, one after
    the other (a "waterfall loop"): a list is then the same for all of them, and its lights are read once.
    Mostly they have one cell.
    """

    lean = True

    def shade_cell_lights(self, surface: SurfacePoint, distance: float) -> sl.vec3:
        """Return the light of the local lights of the pixel's cell at this distance along the view."""
        cell = self.cell_index_at(distance)
        color = sl.vec3(0.0)
        while True:
            shared = sl.broadcast_first(cell)
            if cell == shared:
                color = self.shade_local_lights(surface, self.cell_light_range(shared))
                break
        return color

    def cell_index_at(self, distance: float) -> int:
        """Return the pixel's cell at this distance along the view."""
        return cell_index(self.grid, self.get_pixel(), distance)


def light_list_pass(
    effects: FrameEffects, cells: LightListsFactory, *, depth: str | None = None, name: str = LIGHT_LISTS
) -> FramePass[Frame]:
    """The pass that lists the lights of tiles or clusters.

    Args:
        name: the name of the pass and of the resource that it writes.
        depth: the resource with the depth of all that is lit; cells then end at the surfaces of their tile.
    """

    def collect(frame: Frame) -> None:
        texture = None if depth is None else frame.targets[depth]
        grid = frame.view.workspace(cells)
        work = grid.prepare(frame.camera, frame.targets.size, frame.resources.lights, texture)
        frame.view.commands.next().dispatch(work)

    reads = () if depth is None else (depth,)
    return FramePass(name, collect, explain_local_lights(effects), reads=reads, writes=(name,))


def bind_light_lists(frame: Frame, cells: LightListsFactory) -> dict[str, Any]:
    """Bindings of a `LightListReader`, after `light_list_pass`."""
    return frame.view.workspace(cells).bindings


class ForwardByCells(LightListReader, ForwardShader):
    """Lights a fragment by the light list of its tile or cluster instead of its object's."""

    rays: sl.Uniform[PixelRays]

    def shade_local_lights_at(self, surface: SurfacePoint, v: SurfaceVarying) -> sl.vec3:
        return self.shade_cell_lights(surface, sl.dot(v.position, self.rays.forward))


def lit_by_cells(cells: LightListsFactory, name: str = LIGHT_LISTS) -> Lighting:
    """Lighting by the light lists of tiles or clusters, which are the resource `name`."""
    return Lighting((ForwardByCells,), bind=partial(bind_light_lists, cells=cells), reads=(name,))
