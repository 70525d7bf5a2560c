"""The state that all draws of a batch have in common: target, kernels, and the fields of the batch table."""

from __future__ import annotations

from array import array
from typing import Final

from rhi.backends.cl.raster.builds import Kernel
from rhi.backends.cl.raster.merger import MergerKey
from rhi.backends.cl.raster.pipelines import Pipeline, VertexKernels
from rhi.backends.cl.raster.rows import FIXED_COLUMNS
from rhi.backends.cl.raster.tables import EMPTY_BATCH, MAX_PLANES, TILE, point_size_word, varying_words
from rhi.backends.cl.raster.targets import PassSurfaces
from rhi.contract.descriptors import Interpolation

__rhi_internal__ = True

_EDGES: Final = 3  # of a triangle
_FIRST_GREATER: Final = 4  # the first comparison that greater depths pass, see merger.py


class BatchState:
    """The state of one batch.

    Attributes:
        streams: number of vertex streams.
        width: number of columns of the draws' rows.
        table: fields of the batch table, without what the launcher fills in.
        surfaces: the surfaces that the raster kernel draws into; `addresses`: those of their memory.
        places: bytes that tell kernels the merger's key, where the surfaces begin in their memory and what they are
            cleared to.
        bounds_depth: whether the key permits bounds of depth.
    """

    __slots__ = (
        "addresses", "bounds_depth", "pipeline", "places", "raster", "streams", "surfaces", "table", "target", "vertex",
        "width",
    )  # fmt: skip

    def __init__(
        self, pipeline: Pipeline, target: PassSurfaces, vertex: VertexKernels, streams: int, raster: Kernel,
        key: MergerKey, table: dict[str, float],
    ) -> None:  # fmt: skip
        """`table` is a result of `describe_batch`."""
        self.pipeline, self.target, self.vertex, self.streams = pipeline, target, vertex, streams
        self.raster = raster
        self.width = FIXED_COLUMNS + pipeline.starts[-1]
        surfaces = self.surfaces = target.surfaces_of(key)
        self.addresses = [surface.address for surface in surfaces] + [0] * (MAX_PLANES - len(surfaces))
        places = array("Q", [word for surface in surfaces for word in surface.place])
        self.places = key.words + places.tobytes() + b"".join([surface.pattern for surface in surfaces])
        self.bounds_depth = key.bounds_depth
        self.table = table.copy()
        self.table["row_words"] = pipeline.starts[-1] + streams

    @property
    def leaves_bounds(self) -> bool:
        """Whether the kernel that was launched last left bounds of depth in memory; general ones don't."""
        return self.bounds_depth and not self.raster.is_quick

    def identify_bounds(self) -> tuple[object, ...]:
        """Return what the bounds of depth in memory depend on: surface, comparison, and changes other than draws."""
        texture, depth = self.target.texture, self.target.depth
        surface = depth and (depth.address, depth.place)
        return surface, bool(self.table["near_is_less"]), texture, texture and texture.changes


def describe_batch(
    pipeline: Pipeline, size: tuple[int, int], key: MergerKey, wireframe: bool
) -> dict[str, float]:
    """Return the batch table's fields that follow from the pipeline, the size (width, height) of the target, and
    `wireframe`: whether triangles are drawn as lines."""
    tiles_x, tiles_y = (-(-length // TILE) for length in size)
    interpolations = {varying.interpolation for varying in pipeline.descriptor.varyings}
    return EMPTY_BATCH | {
        "width": size[0],
        "height": size[1],
        "tiles_x": tiles_x,
        "tiles": tiles_x * tiles_y,
        "edges": _EDGES if wireframe else 0,
        "samples": key.samples,
        "shades": key.shades,
        "linear": Interpolation.NO_PERSPECTIVE in interpolations,
        "near_is_less": key.depth_passes < _FIRST_GREATER,
        "depth_step": key.depth_step,
        "varying_words": varying_words(pipeline.descriptor),
        "point_size": point_size_word(pipeline.descriptor),
    }
