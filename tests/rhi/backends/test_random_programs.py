"""Random programs of passes, draws, queries, copies and writes: cl has the results of gl, and those of cl itself
without all its culling and caching.

Most of them stress depth: it is kept between passes, copied, cleared and drawn to in other ways, and queries count the
visible samples of draws in front of and behind one another.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from rhi import (
    ColorWrite,
    CullMode,
    DepthFunction,
    DepthWrite,
    Device,
    Format,
    Mesh,
    OcclusionQuery,
    QuerySet,
    Region,
    State,
    TextureKind,
)
from rhi.backends.cl.backend import ClBackend
from rhi.backends.cl.raster import batches, launcher, pieces
from rhi.backends.cl.raster.draw_state import DrawState
from rhi.backends.cl.raster.merger import MergerKey
from rhi.conformance.shaders import Corner, FlatColored, FlatShade
from rhi.conformance.shapes import corners, window_to_clip
from rhi.shading import Shader, discard, fragment_coordinate, ivec2, vec4

SIZE = WIDTH, HEIGHT = 70, 45
SHEETS = 40
STATES: list[tuple[State, ...]] = [
    (DepthFunction.LESS,),
    (DepthFunction.LESS,),
    (DepthFunction.LESS, DepthWrite.OFF),
    (DepthFunction.LESS, ColorWrite.OFF),
    (DepthFunction.ALWAYS,),
]


class Holes(Shader):
    """Discards every other texel."""

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=v.color)

    def fragment(self, v: FlatShade) -> vec4:
        place = ivec2(fragment_coordinate().xy)
        if (place.x + place.y) % 2 == 0:
            discard()
        return v.color


def sheets(rng: np.random.Generator, wild: bool) -> NDArray[Any]:
    """Return rectangles of all sizes, some of which cover the target. Without `wild` they lie inside the target on a
    grid of 1/16 texel and face the eye; with it they reach beyond it, lean, and cross the near plane."""
    low = rng.uniform(-0.3, 0.9, (SHEETS, 2))
    high = low + 2.0 ** rng.uniform(-4, 1, (SHEETS, 2))
    all_over = rng.random(SHEETS) < 0.2
    low[all_over], high[all_over] = -0.1, 1.1
    if not wild:
        low, high = (np.round(np.clip(edge, 0, 1) * SIZE * 16) / (np.array(SIZE) * 16) for edge in (low, high))
    pick = np.array([(0, 0), (1, 0), (1, 1), (0, 0), (1, 1), (0, 1)])[None]
    places = np.where(pick == 0, low[:, None], high[:, None]) * SIZE
    color = np.repeat(rng.integers(0, 256, (SHEETS, 4)) / 255, 6, axis=0)
    depth = np.repeat(rng.integers(1, 64, SHEETS) / 64, 6)
    rows = corners(window_to_clip(places.reshape(-1, 2), SIZE), color, depth)
    if wild:
        lean = np.repeat(rng.choice([0, 0, 0.02, 0.5], SHEETS), 6) * rng.choice([-1, 1])
        rows["position"][:, 2] += lean * rows["position"][:, rng.integers(2)]
        rows["position"] *= np.repeat(2.0 ** rng.uniform(-2, 2, SHEETS), 6)[:, None].astype(np.float32)
    return rows


def indices(rng: np.random.Generator) -> NDArray[np.uint16]:
    return (6 * rng.integers(0, SHEETS, SHEETS)[:, None] + np.arange(6)).ravel().astype(np.uint16)


class Run:
    """One run of a program on one device; its commands depend on the seed alone.

    Attributes:
        results: the data read, the counts, and the final contents of the targets.
    """

    def __init__(self, device: Device, seed: int, wild: bool) -> None:
        self.results: list[NDArray[Any]] = []
        self._device, self._wild = device, wild
        self._rng = np.random.default_rng(seed)
        self._queries: list[OcclusionQuery] = []
        self._sets: list[QuerySet] = []
        kind = TextureKind.D2_ARRAY
        with ExitStack() as stack:
            self._image = stack.enter_context(device.texture(SIZE, Format.RGBA8))
            self._depths = [
                stack.enter_context(device.texture(SIZE, Format.D32F, kind=kind, layers=2)) for _ in range(2)
            ]
            self._meshes = [self._make_mesh(False), self._make_mesh(True)]
            for depth in self._depths:
                for layer in range(2):
                    with device.render_pass(depth=depth.at(layer=layer), clear_depth=1.0):
                        pass
            for _ in range(8):
                if self._rng.random() < 0.3:
                    self._copy()
                else:
                    self._draw_pass()
            self.results += [np.array([query.wait() for query in self._queries])]
            self.results += [queries.wait() for queries in self._sets]
            self.results += [self._image.read(), *[depth.read_layers() for depth in self._depths]]
            made: list[Mesh | OcclusionQuery | QuerySet] = [*self._meshes, *self._queries, *self._sets]
            for thing in made:
                thing.destroy()

    def _choose(self, *chances: float) -> int:
        """Return the index of a random choice with these chances, or their number if none is chosen."""
        return int(np.searchsorted(np.cumsum(chances), self._rng.random(), "right"))

    def _make_mesh(self, indexed: bool) -> Mesh:
        return self._device.mesh(sheets(self._rng, self._wild), indices(self._rng) if indexed else None)

    def _copy(self) -> None:
        """Copy depth, all of it or a part, between textures or their layers."""
        rng = self._rng
        source, target = (self._depths[i] for i in rng.permutation(2))
        layer, to = (int(i) for i in rng.integers(0, 2, 2))
        x, y = (int(rng.integers(0, n)) if rng.random() < 0.5 else 0 for n in SIZE)
        if layer != to and rng.random() < 0.3:
            target = source
        source.copy_to(target, region=Region(x, y, WIDTH - x, HEIGHT - y, layer, 1), layer=to)

    def _draw_pass(self) -> None:
        rng, device = self._rng, self._device
        depth = self._depths[self._choose(0.8)].at(layer=self._choose(0.8))
        clear = (0.2, 0.4, 0.6, 1) if rng.random() < 0.3 else None
        clear_depth = [1.0, 0.5, None][self._choose(0.15, 0.05)]
        color = self._image if clear or rng.random() < 0.7 else None
        with device.render_pass(color, depth, clear=clear, clear_depth=clear_depth):
            for _ in range(rng.integers(0, 4)):
                with device.states(CullMode.NONE, *STATES[rng.integers(len(STATES))]), ExitStack() as around:
                    if self._queries and rng.random() < 0.2:
                        query = self._queries[rng.integers(len(self._queries))]
                        around.enter_context(device.conditional(query, inverted=bool(rng.random() < 0.5)))
                    self._draw(around)
                self._write()
        if color and rng.random() < 0.2:
            self.results.append(color.read())

    def _draw(self, around: ExitStack) -> None:
        """Draw some sheets of a mesh: as one draw, in a query or not, or as an array, counted or not."""
        rng, device = self._rng, self._device
        mesh = self._meshes[rng.integers(2)]
        program = device.program(FlatColored if rng.random() < 0.7 else Holes)
        first, end = np.sort(rng.integers(0, SHEETS + 1, (2, int(rng.integers(1, 9)))), axis=0) * 6
        parts = mesh.draws(first, end - first, instances=rng.integers(0, 3, len(first)))
        match self._choose(0.3, 0.3, 0.2):
            case 0:
                device.draw(program, mesh.view(int(first[0]), int(end[0] - first[0])))
            case 1:
                query = around.enter_context(device.occlusion_query())
                device.draw(program, mesh.view(int(first[0]), int(end[0] - first[0])), 2)
                self._queries.append(query)
            case 2:
                device.draw_many(program, mesh, parts)
            case _:
                self._sets.append(device.query_set(len(parts)))
                device.draw_counted(program, mesh, parts, self._sets[-1])

    def _write(self) -> None:
        """Write buffers that earlier draws have read, or destroy them."""
        rng = self._rng
        match self._choose(0.1, 0.1, 0.1):
            case 0:
                vertices = self._meshes[rng.integers(2)].vertices
                assert vertices is not None
                vertices.write(sheets(rng, self._wild)[: 6 * int(rng.integers(1, SHEETS))])
            case 1:
                listed = self._meshes[1].indices
                assert listed is not None
                listed.write(indices(rng)[: 6 * int(rng.integers(1, SHEETS))])
            case 2:
                i = int(rng.integers(2))
                self._meshes[i].destroy()
                self._meshes[i] = self._make_mesh(i == 1)


SEEDS = [
    pytest.param(range(5), id="few"),
    pytest.param(range(5, 200), id="many", marks=pytest.mark.nightly),
]


@pytest.fixture(scope="module")
def cl() -> Iterator[Device]:
    with rhi.create_device("cl") as device:
        yield device


@pytest.mark.parametrize("seeds", SEEDS)
def test_random_programs_do_on_cl_what_they_do_on_gl(cl: Device, seeds: range) -> None:
    seen = 0
    with rhi.create_device("gl") as gl:
        for seed in seeds:
            wanted, given = (Run(device, seed, wild=False).results for device in (gl, cl))
            for one, other in zip(wanted, given, strict=True):
                assert np.abs(one.astype(float) - other).max(initial=0) <= (1e-5 if one.dtype.kind == "f" else 0)
                seen += one.size
    assert seen > len(seeds) * 4 * WIDTH * HEIGHT


@pytest.mark.parametrize("seeds", SEEDS)
def test_what_is_left_out_is_not_seen(cl: Device, monkeypatch: pytest.MonkeyPatch, seeds: range) -> None:
    """Without bounds of depth, pieces, deferred clears and cached tables, results are the same bits."""
    hidden = 0
    with rhi.create_device("cl") as plain:
        for seed in seeds:
            with monkeypatch.context() as patch:
                begin_pass, gather = DrawState.begin_pass, batches.Batch.gather

                def begin_cleared(self: Any, descriptor: Any, begin: Any = begin_pass) -> None:
                    begin(self, descriptor)
                    self.fill_cleared(plain.backend_as(ClBackend).context.queue)

                def gather_mixed(self: Any, *given: Any, gather: Any = gather) -> None:
                    gather(self, *given)
                    self.spread()

                patch.setattr(MergerKey, "bounds_depth", property(lambda _: False))
                patch.setattr(DrawState, "begin_pass", begin_cleared)
                patch.setattr(batches.Batch, "gather", gather_mixed)
                wanted = Run(plain, seed, wild=True).results
            with monkeypatch.context() as patch:
                if seed % 2:
                    patch.setattr(pieces, "_FIRST_PIECE_GROUPS", 2)
                    patch.setattr(pieces, "_PIECE_GROUPS", 8)
                    patch.setattr(launcher, "_SLICE_GROUPS", 16)
                    patch.setattr(launcher, "_FEW_GROUPS", 1)
                given = Run(cl, seed, wild=True).results
            for one, other in zip(wanted, given, strict=True):
                np.testing.assert_array_equal(one, other)
            hidden += sum(int((counts == 0).sum()) for counts in wanted[: -3 or None] if counts.ndim == 1)
    assert hidden > len(seeds)
