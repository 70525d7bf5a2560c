"""Lists of the lights that reach each cell of a view, made on the device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.lights.culling.cells import ClusterGrid
from renderer.lights.culling.kernels import (
    BLOCK,
    GROUP,
    CollectByDepth,
    CollectByMask,
    CollectCones,
    CollectCounted,
    CollectLights,
    ReduceTileDepths,
    ReduceTileEnds,
    ReduceTileMasks,
    TileDepths,
    WriteLists,
    collect_variant,
)
from renderer.lights.culling.table import CONE_TESTS, lookup_cone_test, lookup_sphere_test
from renderer.lights.culling.uploads import BufferSet, LightUploads, round_up
from renderer.lights.culling.volumes import WORD
from renderer.scene import Camera, Lights
from renderer.shaders.prefix_sum import PrefixSum
from rhi import Device, Encoder, Program, Readback, StorageBuffer, Texture, UniformBuffer
from rhi.shading import Shader, uint

_START: Final = 64
"""Number of lights for each cell that lists have room for at first."""


@dataclass(frozen=True, eq=False, slots=True)
class LightListData:
    """The lists of all cells, read back. Cells are counted row by row, then slice by slice.

    Attributes:
        bounds: (c, k + 1) of each cell: its lights of kind n of `LOCAL_LIGHT_KINDS` are
            `lights[bounds[i, n]:bounds[i, n + 1]]`.
        lights: indices among the lights of a kind, ascending for each kind of each list.
        full: (c,) whether there was no room for a cell's list, and its lights are those of the masks.
        tests: number of tests of lights against cells and blocks; None if they weren't counted.
    """

    bounds: NDArray[np.int64]
    lights: NDArray[np.int64]
    full: NDArray[np.bool_]
    tests: int | None

    @property
    def begins(self) -> NDArray[np.int64]:
        """The index (c,) in `lights` where the list of each cell begins."""
        return self.bounds[:, 0]

    @property
    def ends(self) -> NDArray[np.int64]:
        """The index (c,) in `lights` behind the list of each cell."""
        return self.bounds[:, -1]

    @property
    def pairs(self) -> int:
        """The number of pairs of a cell and a light."""
        return len(self.lights)


class LightLists:
    """Lists the local lights that reach each tile or cluster of a view, on the device.

    `collect` issues the commands that make the lists of a frame; shaders then read `lists` with the index
    that `cell_index` gives: for cell c and k kinds of lights, `lists[k c]` is the index in `lists` where its
    lights begin, and `lists[k c + n]` where those of the nth kind end.

    The lists have room for 64 lights a cell, or for as many as earlier frames needed. If a frame needs more,
    shaders read the lights of the cells that are left over from bits in `light_masks`: they miss none, but
    look at a bit for each light of the scene. A later `collect` learns the need without waiting, and enlarges
    the lists.

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
        from_near: bool = False,
        counted: bool = False,
        capacity: int | None = None,
    ) -> None:
        """Cells are tiles of `tile` × `tile` pixels, divided into `slices` by depth (see `make_grid`).

        Args:
            sphere_test, cone_test: names of the tests of cells, of `SPHERE_TESTS` and `CONE_TESTS`. With the
                exact test, collecting takes 17 % more processor time than with the hybrid one on cl, 22 %
                more on gl, and the lists are up to a fifth shorter.
            block_test: the name of the test of blocks of cells; with "none" all cells are tested against all
                lights.
            depth_mask: whether, with a depth texture, 32 slices of a tile's depths are told apart.
            from_near: whether, with a depth texture, cells begin at the near plane instead of the nearest surface
                of their tile: for what is lit in front of it. There is no mask then.
            counted: whether to count tests, for `read`.
            capacity: number of lights for which lists have room at first; by default 64 for each cell, also
                of later frames with more cells.

        Raises:
            ValidationError `lights-unknown-test`: a test has another name.
        """
        call = "LightLists"
        self._uploads = LightUploads(device, tile=tile, slices=slices, first_slice=first_slice)
        self.capacity = capacity or 0
        self._start = 0 if capacity else _START
        self.overflows = 0
        self.device = device
        self._tests = (
            lookup_sphere_test(sphere_test, f"{call}(sphere_test=...)"),
            lookup_cone_test(cone_test, f"{call}(cone_test=...)"),
            lookup_sphere_test(block_test, f"{call}(block_test=...)"),
        )
        has_mask = depth_mask and not from_near
        self._by_depth: tuple[type[CollectLights], ...] = (CollectByMask if has_mask else CollectByDepth,)
        self._reduce: type[ReduceTileDepths] = (
            ReduceTileEnds if from_near else ReduceTileMasks if has_mask else ReduceTileDepths
        )
        self._counted: tuple[type[CollectLights], ...] = (CollectCounted,) if counted else ()
        self._buffers = BufferSet(device, "light grid")
        self._pending: Readback | None = None
        self._room = 0  # the capacity of the frame whose need is pending
        self._unasked: int | None = None  # that of the last frame, if its need isn't asked for yet
        self._programs: dict[type[Shader], Program[...]] = {}

    @property
    def layout(self) -> ClusterGrid:
        """The grid of the last frame."""
        return self._uploads.layout

    @property
    def parameters(self) -> UniformBuffer[ClusterGrid]:
        """The grid of the last frame for shaders."""
        return self._uploads.parameters

    @property
    def bindings(self) -> dict[str, Any]:
        """The lists of the last frame for shaders: `grid`, `light_list`, `light_masks` and `light_counts`.
        Another `collect` may replace them."""
        return {
            "grid": self.parameters,
            "light_list": self.lists,
            "light_masks": self._buffers["masks"],
            "light_counts": self._uploads.counts,
        }

    @property
    def cells(self) -> int:
        """The number of cells in the last frame."""
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
        """List the lights that reach each cell of an image of `size` pixels. Must be called outside of
        passes.

        Args:
            depth: the depth of all that is lit through the lists; cells then end at the surfaces of their
                tile.
        """
        for program, groups, bindings in self.prepare(camera, size, lights, depth):
            encoder.dispatch(program, groups, **bindings)

    def prepare(
        self, camera: Camera, size: tuple[int, int], lights: Lights, depth: Texture | None = None
    ) -> list[tuple[Program[...], int | tuple[int, ...], dict[str, Any]]]:
        """Upload the grid and the lights of a frame. Return the dispatches that make the lists, to be run
        once: compute programs, the numbers of their groups, and bindings."""
        self._learn()
        self._uploads.write(camera, size, lights)
        self._make_room()
        columns, rows, slices = self._uploads.count
        buffers, blocks = self._buffers, (-(-columns // BLOCK), -(-rows // BLOCK))
        features: tuple[type[CollectLights], ...] = self._counted
        program_buffers: dict[str, Any] = {name: buffers[name] for name in ("masks", "counts")}
        uploads = self._uploads.bindings
        work: list[tuple[Any, Any, dict[str, Any]]] = []
        if depth is not None:
            features += self._by_depth
            program_buffers["depths"] = buffers["depths"]
            reduced = {"grid": self.parameters, "depth": depth, "depths": buffers["depths"]}
            work.append((self._reduce, blocks, reduced))
        if self._counted:
            buffers["tests"].write(np.zeros(1, np.uint32))
            program_buffers["tests"] = buffers["tests"]
        sphere_test, cone_test, block_test = self._tests
        if self._uploads.has_cones and cone_test is not CONE_TESTS["sphere"]:
            features += (CollectCones,)
            program_buffers |= self._uploads.cones
        variant = collect_variant(sphere_test, cone_test, block_test, features)
        results = {"lights": uploads["lights"], "masks": buffers["masks"], "lists": buffers["lists"]}
        work += [
            (variant, (*blocks, slices), {**uploads, **program_buffers}),
            (PrefixSum, 1, {"counts": buffers["counts"]}),
            (WriteLists, self.cells // GROUP + 1, {**results, "sums": buffers["counts"]}),
        ]
        self._unasked = self.capacity
        programs = self._programs
        for shader, _, _ in work:
            if shader not in programs or programs[shader].destroyed:
                programs[shader] = self.device.program(shader)
        return [(programs[shader], groups, bindings) for shader, groups, bindings in work]

    def read(self) -> LightListData:
        """Return the lists of the last frame. Waits for the device."""
        cells = self.cells
        lists = self.lists.read().astype(np.int64)
        kinds = len(LOCAL_LIGHT_KINDS)
        header = kinds * cells + 1
        bounds = (
            np.stack([lists[number : number + header : kinds][:cells] for number in range(kinds + 1)], 1)
            - header
        )
        lights = lists[header:]
        begins, ends = bounds[:, 0], bounds[:, -1]
        full = ends > len(lights)
        if full.any():
            lights = np.concatenate([lights[: begins[full][0]], self._read_masked(full)])
        return LightListData(
            bounds=bounds,
            lights=lights[: int(ends[-1])],
            full=full,
            tests=int(self._buffers["tests"].read()[0]) if self._counted else None,
        )

    def _read_masked(self, cells: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the indices of the lights of these cells, one cell after the other, from the masks."""
        words, ends = self._uploads.words, WORD * np.array(self._uploads.word_ends)
        masks: NDArray[np.uint32] = (
            self._buffers["masks"].read(0, self.cells * words).reshape(-1, words)[cells]
        )
        bits = np.unpackbits(masks.astype("<u4").view(np.uint8), axis=1, bitorder="little").nonzero()[1]
        begins = np.concatenate([[0], ends[:-1]])
        return np.asarray(bits - begins[np.searchsorted(ends, bits, side="right")])

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._buffers.destroy()
        self._uploads.destroy()

    def _learn(self) -> None:
        """Read how many lights the lists of an earlier frame needed, if the device has finished it, and
        enlarge them."""
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
        self._buffers.fit("lists", int, len(LOCAL_LIGHT_KINDS) * cells + 1 + self.capacity)
        self._buffers.fit("tests", uint, 1)
