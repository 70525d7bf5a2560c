"""The state of the next draw: render target, program, render states, and the kernels that these determine.

- Kernels and views are looked up in a memo, whose key is all of this state. Looking it up for every draw
  would cost more than the draw, so `ready_for` says whether it has changed since the last draw.
- A view holds the render states that kernels read, as a `VIEW_STRUCT`: viewport, scissor, culling, depth
  bias, line width, and the output merger's words. Window y counts from the top. So the scale of y is
  negative, and a triangle that is counter-clockwise with +Y up has a negative area.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from rhi.backends.cl.builds import Kernel
from rhi.backends.cl.cl_errors import translate_errors
from rhi.backends.cl.memory.cl_textures import Textures
from rhi.backends.cl.memory.planes import TexelPlane
from rhi.backends.cl.raster.batches import describe_batch
from rhi.backends.cl.raster.cl_pipelines import Pipeline, VertexKernels
from rhi.backends.cl.raster.kernel_structs import VIEW_STRUCT
from rhi.backends.cl.raster.merger import MergerKey, make_key, make_state
from rhi.backends.cl.raster.pass_surfaces import (
    PassSurfaces,
    RenderSurface,
    color_clear,
    depth_clear,
    stencil_clear,
)
from rhi.contract.descriptors import Attachment, DepthAttachment, PassDescriptor
from rhi.contract.formats import Format
from rhi.contract.states import (
    STATE_TYPES,
    CullMode,
    DepthBias,
    FrontFace,
    LineWidth,
    PolygonMode,
    PolygonOffset,
    Scissor,
    StateChange,
    Viewport,
    default_values,
)

_MAX_MEMO: Final = 4096
_FAR: Final = 1 << 20


class DrawState:
    """The draw state of one device.

    Attributes:
        ready_for: the vertex kernels that the batch and the view column are set up for; None after any change
            of state.
        pipeline: that of the bound program; None if it doesn't draw.
        target: the render target of the open pass.
        values: the current value of each render state.
    """

    def __init__(self, textures: Textures) -> None:
        self._textures = textures
        self.ready_for: VertexKernels | None = None
        self.pipeline: Pipeline | None = None
        self.target: PassSurfaces | None = None
        self.values: dict[type, Any] = dict(zip(STATE_TYPES, default_values(), strict=True))
        self.has_clears = False  # whether some of the target may still have to be cleared
        self._formats: tuple[tuple[Format, ...], Format | None] = ((), None)
        self._memo: dict[tuple[object, ...], tuple[MergerKey, Kernel, bytes, dict[str, float]]] = {}
        # The tables of the memo, shared by entries that differ only in their views.
        self._tables: dict[tuple[object, ...], dict[str, float]] = {}

    def begin_pass(self, descriptor: PassDescriptor) -> None:
        textures = self._textures
        colors, formats = [], []
        for color in descriptor.colors:
            texture = textures[color.texture]
            format = texture.descriptor.format
            colors.append(self._make_surface(color, texture.levels, color_clear(color, format)))
            formats.append(format)
        depth = stencil = drawn = None
        depth_format = None
        attachment = descriptor.depth
        if attachment is not None:
            texture = drawn = textures[attachment.texture]
            depth_format = texture.descriptor.format
            depth = self._make_surface(attachment, texture.levels, depth_clear(attachment, depth_format))
            if texture.stencil:
                stencil = self._make_surface(attachment, texture.stencil, stencil_clear(attachment))
        layers = self._count_layers(descriptor) if descriptor.is_layered else 0
        self.target = PassSurfaces(descriptor.size, descriptor.samples, colors, depth, stencil, drawn, layers)
        self._formats = tuple(formats), depth_format
        self.ready_for = None
        surfaces = (*colors, depth, stencil)  # last, since what clears needs the target
        self.has_clears = any(surface is not None and surface.clear is not None for surface in surfaces)

    def _count_layers(self, descriptor: PassDescriptor) -> int:
        attachment = descriptor.colors[0] if descriptor.colors else descriptor.depth
        assert attachment is not None
        return self._textures[attachment.texture].levels[attachment.level].layers

    def _make_surface(
        self,
        attachment: Attachment | DepthAttachment,
        planes: Sequence[TexelPlane],
        clear: bytes | None,
    ) -> RenderSurface:
        """Return the surface of an attachment; `planes`: those of the texture's levels."""
        plane = planes[attachment.level]
        if clear is not None:
            self._textures[attachment.texture].changes += 1
        samples = self._textures[attachment.texture].descriptor.samples
        return RenderSurface(plane, attachment.layer, samples, plane.address, clear)

    def fill_cleared(self, queue: cl.CommandQueue) -> None:
        """Perform the clears of the pass that no draw has performed."""
        assert self.target is not None
        with translate_errors("device.render_pass"):
            self.target.fill_cleared(queue)
        self.has_clears = False

    def set(self, changes: Sequence[StateChange]) -> None:
        """Change render states."""
        self.values.update(changes)
        self.ready_for = None

    def bind_program(self, pipeline: Pipeline | None) -> None:
        self.pipeline = pipeline
        self.ready_for = None

    def forget(self, pipeline: Pipeline) -> None:
        """Drop the state of a program that is being destroyed."""
        if self.pipeline is pipeline:
            self.pipeline = None
        for memo in (self._memo, self._tables):
            for key in [key for key in memo if key[0] is pipeline]:
                del memo[key]

    def look_up(
        self, pipeline: Pipeline, target: PassSurfaces
    ) -> tuple[MergerKey, Kernel, bytes, dict[str, float]]:
        """Return the merger's key, the raster kernel, the `VIEW_STRUCT` and the batch table for the current
        state."""
        colors, depth = self._formats
        key = pipeline, target.size, target.samples, colors, depth, *self.values.values()
        entry = self._memo.get(key)
        if entry is None:
            if len(self._memo) >= _MAX_MEMO:
                self._memo.clear()
                self._tables.clear()
            merger = make_key(pipeline.descriptor, self.values, colors, depth, target.samples)
            view = make_view(self.values, target.size, colors, depth).tobytes()
            raster = pipeline.get_raster_kernel(merger)
            wireframe = self.values[PolygonMode] is PolygonMode.LINE
            shared = pipeline, target.size, raster, wireframe
            table = self._tables.get(shared)
            if table is None:
                table = self._tables[shared] = describe_batch(pipeline, target.size, merger, wireframe)
            entry = self._memo[key] = merger, raster, view, table
        return entry


def make_view(
    values: Mapping[type, Any], size: tuple[int, int], colors: Sequence[Format], depth: Format | None
) -> NDArray[Any]:
    """Return a `VIEW_STRUCT`, shape ().

    Args:
        values: the value of each state type; a tuple of `MAX_TARGETS` for those of `PER_TARGET`.
        size: (width, height) of the pass.
        colors, depth: the formats of the pass's targets.
    """
    view = np.zeros((), VIEW_STRUCT)
    viewport, scissor = values[Viewport], values[Scissor]
    x, y, width, height = _viewport_rectangle(viewport, size)
    view["scale"] = width / 2, -height / 2, viewport.far - viewport.near, 0
    view["shift"] = x + width / 2, y + height / 2, viewport.near, 0
    left, top, right, bottom = _viewport_box(viewport, size)
    view["box"] = (
        max(scissor.x, left),
        max(scissor.y, top),
        min(scissor.x + scissor.width - 1, right),
        min(scissor.y + scissor.height - 1, bottom),
    )
    front = values[FrontFace] is FrontFace.CLOCKWISE
    view["front"] = front
    if values[CullMode] is not CullMode.NONE:
        view["culled"] = 1 if (values[CullMode] is CullMode.FRONT) is front else 2
    offset = values[PolygonOffset]
    view["bias_units"], view["bias_slope"] = values[DepthBias].units, offset.slope
    view["bias_clamp"] = offset.clamp
    view["line_width"] = math.floor(values[LineWidth].width + 0.5)
    if depth is not None and depth.depth_steps:
        view["bias_step"] = 1 / depth.depth_steps
    view["state"] = make_state(values, colors)
    return view


def scissor_views(
    view: bytes, viewport: Viewport, size: tuple[int, int], clips: NDArray[np.int64]
) -> list[bytes]:
    """Return a `VIEW_STRUCT` for each of some scissors (n, 4): x, y, width and height; `view` is that of
    another."""
    views = np.frombuffer(view * len(clips), np.uint8).reshape(len(clips), -1).copy()
    at, width = VIEW_STRUCT.fields["box"][1], 16  # type: ignore[index]
    boxes = views[:, at : at + width].view(np.int32)
    box = np.array(_viewport_box(viewport, size))
    boxes[:, :2] = np.maximum(clips[:, :2], box[:2])
    boxes[:, 2:] = np.minimum(clips[:, :2] + clips[:, 2:] - 1, box[2:])
    cut, step = views.tobytes(), views.shape[1]
    return [cut[begin : begin + step] for begin in range(0, len(cut), step)]


def _viewport_rectangle(viewport: Viewport, size: tuple[int, int]) -> tuple[float, float, float, float]:
    if viewport is Viewport.TARGET:
        return viewport.x, viewport.y, *size
    return viewport.x, viewport.y, viewport.width, viewport.height


def _viewport_box(viewport: Viewport, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return the first and the last column and row of texels in a viewport: a texel is in it if its centre
    is."""
    x, y, width, height = _viewport_rectangle(viewport, size)
    return (
        max(0, _first_centre(x)),
        max(0, _first_centre(y)),
        min(size[0], _first_centre(x + width)) - 1,
        min(size[1], _first_centre(y + height)) - 1,
    )


def _first_centre(edge: float) -> int:
    """Return the first texel whose centre lies at `edge` or beyond it."""
    return math.ceil(min(max(edge, -_FAR), _FAR) - 0.5)
