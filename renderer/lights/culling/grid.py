"""Lists of the lights that reach each cell of a view, made on the device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lights.culling.cells import CellGrid
from renderer.lights.culling.kernels import (
    BLOCK,
    GROUP,
    CollectByDepth,
    CollectByMask,
    CollectCounted,
    CollectLights,
    CollectSpots,
    FindTileDepths,
    FindTileMasks,
    TileDepths,
    WriteLists,
    collect_variant,
)
from renderer.lights.culling.table import CONE_TESTS, find_cone_test, find_sphere_test
from renderer.lights.culling.uploads import BufferSet, LightUploads, round_up
from renderer.lights.culling.volumes import WORD
from renderer.scene import Camera, Lights
from renderer.shaders.prefix_sum import PrefixSum
from rhi import Device, Encoder, Program, Readback, StorageBuffer, Texture, UniformBuffer
from rhi.shading import uint

_START: Final = 64
"""Number of lights for each cell that lists have room for at first."""


@dataclass(frozen=True, eq=False, slots=True)
class CellLists:
    """The lists of all cells, read back. Cells are counted row by row, then slice by slice.

    Attributes:
        begins, points_ends, ends: (c,) of each cell: its point lights are `lights[begins[i]:points_ends[i]]`, its spot
            lights `lights[points_ends[i]:ends[i]]`.
        lights: rows of the point or spot lights, ascending in each list.
        full: (c,) whether there was no room for a cell's list, and its lights are those of the masks.
        tests: number of tests of lights against cells and blocks; None if they weren't counted.
    """

    begins: NDArray[np.int64]
    points_ends: NDArray[np.int64]
    ends: NDArray[np.int64]
    lights: NDArray[np.int64]
    full: NDArray[np.bool_]
    tests: int | None

    @property
    def pairs(self) -> int:
        """The number of pairs of a cell and a light."""
        return len(self.lights)


class LightGrid:
    """Lists, for each tile or cluster of a view, the point and spot lights that reach it.

    `collect` issues the commands that make the lists of a frame; shaders then read `lists` with the index that
    `cell_index` gives: for cell c, `lists[2 c]`, `lists[2 c + 1]` and `lists[2 c + 2]` are the places in `lists` where
    its point lights begin, where they end and its spot lights begin, and where those end.

    The lists have room for 64 lights a cell, or for as many as earlier frames needed. If a frame needs more, shaders
    find the lights of the cells that are left over by their bits in `masks`: they miss none, but look at a bit for each
    light of the scene. A later `collect` learns the need without waiting, and enlarges the lists.

    Attributes:
        capacity: number of lights that fit in all lists together.
        overflows: number of frames whose lists were full, as far as the CPU knows by now.
    """

    def __init__(
        self,
        device: Device,
        *,
        tile: int = 16,
        slices: int = 1,
        first_slice: float | None = None,
        sphere_test: str = "exact",
        cone_test: str = "tight",
        block_test: str = "planes",
        depth_mask: bool = True,
        counted: bool = False,
        capacity: int | None = None,
    ) -> None:
        """Cells are tiles of `tile` × `tile` pixels, divided into `slices` by depth (see `make_grid`).

        Args:
            sphere_test, cone_test: names of the tests of cells, of `SPHERE_TESTS` and `CONE_TESTS`. With the exact
                test, collecting takes 17 % more processor time than with the hybrid one on cl, 22 % more on gl, and
                the lists are up to a fifth shorter.
            block_test: the name of the test of blocks of cells; with "none" all cells are tested against all lights.
            depth_mask: whether, with a depth texture, 32 slices of a tile's depths are told apart.
            counted: whether to count tests, for `read`.
            capacity: number of lights for which lists have room at first; by default 64 for each cell, also of later
                frames with more cells.

        Raises:
            ValidationError `lights-unknown-test`: a test has another name.
        """
        call = "LightGrid"
        self._uploads = LightUploads(device, tile=tile, slices=slices, first_slice=first_slice)
        self.capacity = capacity or 0
        self._start = 0 if capacity else _START
        self.overflows = 0
        self.device = device
        self._tests = (
            find_sphere_test(sphere_test, f"{call}(sphere_test=...)"),
            find_cone_test(cone_test, f"{call}(cone_test=...)"),
            find_sphere_test(block_test, f"{call}(block_test=...)"),
        )
        self._by_depth: tuple[type[CollectLights], ...] = (CollectByMask if depth_mask else CollectByDepth,)
        self._counted: tuple[type[CollectLights], ...] = (CollectCounted,) if counted else ()
        self._buffers = BufferSet(device, "light grid")
        self._pending: Readback | None = None
        self._room = 0  # the capacity of the frame whose need is pending
        self._unasked: int | None = None  # that of the last frame, if its need isn't asked for yet

    @property
    def layout(self) -> CellGrid:
        """The grid of the last frame."""
        return self._uploads.layout

    @property
    def parameters(self) -> UniformBuffer[CellGrid]:
        """The grid of the last frame for shaders."""
        return self._uploads.parameters

    @property
    def bindings(self) -> dict[str, Any]:
        """The lists of the last frame for shaders: `grid`, `light_rows`, `light_masks` and `light_counts`. Another
        `collect` may replace them."""
        return {
            "grid": self.parameters,
            "light_rows": self.lists,
            "light_masks": self._buffers["masks"],
            "light_counts": self._uploads.counts,
        }

    @property
    def cells(self) -> int:
        """The number of cells of the last frame."""
        columns, rows, slices = self._uploads.count
        return columns * rows * slices

    @property
    def lists(self) -> StorageBuffer[int]:
        """The lists of the last frame. Another `collect` may replace the buffer."""
        return self._buffers["lists"]

    def collect(
        self,
        encoder: Encoder,
        camera: Camera,
        size: tuple[int, int],
        lights: Lights,
        depth: Texture | None = None,
    ) -> None:
        """List the lights that reach each cell of an image of `size` pixels. Must be called outside of passes.

        Args:
            depth: the depth of all that is lit through the lists; cells then end at the surfaces of their tile.
        """
        for program, groups, bindings in self.prepare(camera, size, lights, depth):
            encoder.dispatch(program, groups, **bindings)

    def prepare(
        self, camera: Camera, size: tuple[int, int], lights: Lights, depth: Texture | None = None
    ) -> list[tuple[Program[...], int | tuple[int, ...], dict[str, Any]]]:
        """Upload what the device needs to list the lights of a frame. Return the dispatches that do so, once: compute
        programs, the numbers of their groups, and bindings."""
        self._learn()
        self._uploads.write(camera, size, lights)
        self._make_room()
        columns, rows, slices = self._uploads.count
        buffers, blocks = self._buffers, (-(-columns // BLOCK), -(-rows // BLOCK))
        features: tuple[type[CollectLights], ...] = self._counted
        given: dict[str, Any] = {name: buffers[name] for name in ("masks", "counts")}
        uploads = self._uploads.bindings
        find: Any = FindTileMasks if CollectByMask in self._by_depth else FindTileDepths
        work: list[tuple[Any, Any, dict[str, Any]]] = []
        if depth is not None:
            features += self._by_depth
            given["depths"] = buffers["depths"]
            work.append((find, blocks, {"grid": self.parameters, "depth": depth, "depths": buffers["depths"]}))
        if self._counted:
            buffers["tests"].write(np.zeros(1, np.uint32))
            given["tests"] = buffers["tests"]
        sphere_test, cone_test, block_test = self._tests
        if len(lights.spot) and cone_test is not CONE_TESTS["sphere"]:
            features += (CollectSpots,)
            given |= self._uploads.cones
        variant = collect_variant(sphere_test, cone_test, block_test, features)
        results = {"lights": uploads["lights"], "masks": buffers["masks"], "lists": buffers["lists"]}
        work += [
            (variant, (*blocks, slices), {**uploads, **given}),
            (PrefixSum, 1, {"counts": buffers["counts"]}),
            (WriteLists, self.cells // GROUP + 1, {**results, "sums": buffers["counts"]}),
        ]
        self._unasked = self.capacity
        return [(self.device.program(shader), groups, bindings) for shader, groups, bindings in work]

    def read(self) -> CellLists:
        """Return the lists of the last frame. Waits for the device."""
        cells, lists = self.cells, self.lists.read().astype(np.int64)
        header = 2 * cells + 1
        begins, points_ends, ends = (lists[first:header:2] - header for first in range(3))
        begins, lights = begins[:-1], lists[header:]
        total = int(ends[-1])
        full = ends > len(lights)
        if full.any():
            lights = np.concatenate([lights[: begins[full][0]], self._read_masked(full)])
        return CellLists(
            begins=begins,
            points_ends=points_ends,
            ends=ends,
            lights=lights[:total],
            full=full,
            tests=int(self._buffers["tests"].read()[0]) if self._counted else None,
        )

    def _read_masked(self, cells: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the rows of the lights of these cells, one cell after the other, from the masks."""
        words, points = self._uploads.words, WORD * self._uploads.point_words
        masks: NDArray[np.uint32] = self._buffers["masks"].read(0, self.cells * words).reshape(-1, words)[cells]
        bits = np.unpackbits(masks.astype("<u4").view(np.uint8), axis=1, bitorder="little").nonzero()[1]
        return np.where(bits < points, bits, bits - points)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._buffers.destroy()
        self._uploads.destroy()

    def _learn(self) -> None:
        """Note how many lights the lists of an earlier frame needed, if the device has finished it, and enlarge
        them."""
        if self._pending is not None and self._pending.done:
            needed = int(self._pending.result()[0])
            self._pending = None
            if needed > self._room:
                self.overflows += 1
                self.capacity = max(self.capacity, round_up(needed))
        if self._pending is None and self._unasked is not None:
            self._room, self._unasked = self._unasked, None
            self._pending = self._buffers["counts"].read_async(self.cells, 1)

    def _make_room(self) -> None:
        """Make room for the results."""
        cells, (columns, rows, _) = self.cells, self._uploads.count
        self.capacity = max(self.capacity, self._start * cells)
        self._buffers.fit("masks", uint, round_up(cells * self._uploads.words))
        self._buffers.fit("counts", uint, cells + 1)
        self._buffers.fit("depths", TileDepths, columns * rows)
        self._buffers.fit("lists", int, 2 * cells + 1 + self.capacity)
        self._buffers.fit("tests", uint, 1)
