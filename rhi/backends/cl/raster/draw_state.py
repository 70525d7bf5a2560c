"""The state that the next draw is drawn with: render target, program, render states, and the kernels that follow.

Kernels and views are looked up in a memo, whose key is all of this state. Looking it up for every draw would cost more
than the draw, so `ready_for` says whether it has changed since the last draw.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import pyopencl as cl

from rhi.backends.cl.errors import translate_errors
from rhi.backends.cl.memory.planes import TexelPlane
from rhi.backends.cl.memory.textures import Textures
from rhi.backends.cl.raster.batch_state import describe_batch
from rhi.backends.cl.raster.bindings import Bindings
from rhi.backends.cl.raster.builds import Kernel
from rhi.backends.cl.raster.merger import MergerKey, make_key
from rhi.backends.cl.raster.pipelines import Pipeline, VertexKernels
from rhi.backends.cl.raster.states import make_view
from rhi.backends.cl.raster.targets import (
    PassSurfaces,
    RenderSurface,
    color_clear,
    depth_clear,
    stencil_clear,
)
from rhi.contract.descriptors import Attachment, DepthAttachment, PassDescriptor
from rhi.contract.formats import Format
from rhi.contract.states import DEFAULTS, MAX_TARGETS, PER_TARGET, PolygonMode, StateChange

__rhi_internal__ = True

_MAX_MEMO: Final = 4096


class DrawState:
    """The draw state of one device.

    Attributes:
        ready_for: the vertex kernels that the batch and the view column are set up for; None after any change of state.
        pipeline: that of the bound program; None if it doesn't draw.
        target: the render target of the open pass.
        values: the current value of each render state.
    """

    def __init__(self, textures: Textures, bindings: Bindings) -> None:
        self._textures = textures
        self._bindings = bindings
        self.ready_for: VertexKernels | None = None
        self.pipeline: Pipeline | None = None
        self.target: PassSurfaces | None = None
        self.values: dict[type, Any] = {
            state: (value,) * MAX_TARGETS if state in PER_TARGET else value
            for state, value in DEFAULTS.items()
        }
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
                stencil = self._make_surface(attachment, texture.stencil, stencil_clear(attachment), True)
        self.target = PassSurfaces(descriptor.size, descriptor.samples, colors, depth, stencil, drawn)
        self._formats = tuple(formats), depth_format
        self.ready_for = None

    def _make_surface(
        self, attachment: Attachment | DepthAttachment, planes: Sequence[TexelPlane], clear: bytes | None,
        stencil: bool = False,
    ) -> RenderSurface:  # fmt: skip
        """Return the surface of an attachment; `planes`: those of the texture's levels."""
        plane = planes[attachment.level]
        if clear is not None:
            self._textures[attachment.texture].changes += 1
            self.has_clears = True
        address = self._bindings.find_plane(attachment.texture, plane, stencil)
        samples = self._textures[attachment.texture].descriptor.samples
        return RenderSurface(plane, attachment.layer, samples, address, clear)

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
        """Drop what is known of a program that is being destroyed."""
        if self.pipeline is pipeline:
            self.pipeline = None
        for memo in (self._memo, self._tables):
            for key in [key for key in memo if key[0] is pipeline]:
                del memo[key]

    def look_up(
        self, pipeline: Pipeline, target: PassSurfaces
    ) -> tuple[MergerKey, Kernel, bytes, dict[str, float]]:
        """Return the merger's key, the raster kernel, the `VIEW_STRUCT` and the batch table for the current state."""
        colors, depth = self._formats
        key = pipeline, target.size, target.samples, colors, depth, *self.values.values()
        known = self._memo.get(key)
        if known is None:
            if len(self._memo) >= _MAX_MEMO:
                self._memo.clear()
                self._tables.clear()
            merger = make_key(pipeline.descriptor, self.values, colors, depth, target.samples)
            view = make_view(self.values, target.size, colors, depth).tobytes()
            raster = pipeline.find_raster(merger)
            wireframe = self.values[PolygonMode] is PolygonMode.LINE
            shared = pipeline, target.size, raster, wireframe
            table = self._tables.get(shared)
            if table is None:
                table = self._tables[shared] = describe_batch(pipeline, target.size, merger, wireframe)
            known = self._memo[key] = merger, raster, view, table
        return known
