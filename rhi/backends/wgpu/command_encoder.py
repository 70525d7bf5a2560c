"""The command encoder of a device, its open pass, and submissions.

- A pass of the contract is one or more render passes of WebGPU, its segments: whatever WebGPU forbids inside
  a pass ends the segment, and the next draw begins another, which loads the contents. Clears happen in the
  first one only.
- Writes of the queue happen before the whole next submission, so what the open encoder uses is submitted
  before it is written. Resources note the number of the encoder that uses them (`serial`).
- A compute pass stays open from one dispatch to the next: WebGPU orders dispatches of a pass.
- What belongs together (the begin of a driver's pass and the note of it, its end, a submission) isn't
  interrupted between: an encoder whose pass nobody knows is locked for ever.
- WebGPU can't draw to a slice of a 3D texture. A 2D texture stands in for it during a segment.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Protocol

from rhi.backends.wgpu.native import NEVER_SLICED, NULL, Fence, GpuObject, Handle, ffi, lib
from rhi.backends.wgpu.wgpu_errors import translate_errors
from rhi.contract.descriptors import Attachment, DepthAttachment, Id, PassDescriptor
from rhi.contract.interrupts import DeferredInterrupts


class PassTargets(Protocol):
    """The methods of `Textures` that a `Stream` uses."""

    def attach(self, encoder: GpuObject, texture: Id, level: int, layer: int, loads: bool) -> GpuObject:
        """Return the view of a texture, or of its stand-in, as a target."""

    def detach(self, encoder: GpuObject) -> None:
        """Copy the stand-ins that were drawn to back to their textures."""

    def has_stencil(self, texture: Id) -> bool:
        """Whether a texture has stencil."""

    def dummy(self, size: tuple[int, int], samples: int) -> GpuObject:
        """Return the view of a dummy target, for passes without targets."""


class Stream:
    """The commands of a device.

    Attributes:
        serial: the number of the open encoder.
        render: the handle of the open render pass, or None.
        pass_: the pass of the contract that is open, or None.
        before_submit, after_submit: called around submissions; the latter with the submission's number.
        on_begin, on_end: called when a segment begins and before it ends.
    """

    def __init__(self, device: GpuObject, fence: Fence) -> None:
        self.device = device
        self.fence = fence
        self.serial = 1
        self.render: Handle | None = None
        self.pass_: PassDescriptor | None = None
        self.targets: PassTargets
        self.before_submit: list[Callable[[], None]] = []
        self.after_submit: list[Callable[[int], None]] = []
        self.on_begin: list[Callable[[], None]] = []
        self.on_end: list[Callable[[], None]] = []
        self.query_set: Callable[[], Handle] = lambda: NULL
        self.segments = 0
        self._labels: list[str] = []
        self._encoder: GpuObject | None = None
        self._open: list[Handle] = []  # the driver's open render pass, if any
        self._compute_object: GpuObject | None = None
        self._compute: Handle | None = None
        self._begun = False  # whether the pass has a segment
        self._latest = 0

    # -- encoders ----------------------------------------------------------------------------------------

    @property
    def open_pass(self) -> Handle:
        """The handle of the driver's open render pass, also of one that `render` doesn't know yet."""
        return self._open[0]

    def encoder(self) -> GpuObject:
        """Return the open encoder; it may be inside a pass."""
        if self._encoder is None:
            with translate_errors("device"):
                encoder = self.device.create_command_encoder()
            for label in self._labels:
                encoder.push_debug_group(label)
            self._encoder = encoder
        return self._encoder

    def outside(self) -> GpuObject:
        """Return the open encoder, outside of any pass. The clears of an open pass are done first."""
        self._end_compute()
        if self._open:
            self.end_segment()
        self.settle()
        return self.encoder()

    def settle(self) -> None:
        """Do the clears of the open pass, if they are still to come."""
        if self.pass_ is not None and not self._begun and _clears(self.pass_):
            self.begin_segment()
            self.end_segment()

    def submit(self) -> int:
        """Submit the encoded commands; return the number of the latest submission.

        Raises:
            DeviceError: `device-driver` if wgpu refuses the commands; they are dropped. `device-lost`.
        """
        if self._encoder is None and not self.before_submit:
            return self._latest
        with DeferredInterrupts():
            return self._submit()

    def _submit(self) -> int:
        self.outside()
        for call in self.before_submit:
            call()
        encoder, self._encoder = self._encoder, None
        self.serial += 1
        if encoder is not None:
            with translate_errors("submit"):
                for _ in self._labels:
                    encoder.pop_debug_group()
                self._latest = self.fence.submit(encoder.finish())
                for after in self.after_submit:
                    after(self._latest)
        return self._latest

    def signal(self, value: int) -> None:
        """Submit; the fence reaches `value` once all commands are done."""
        with DeferredInterrupts(), translate_errors("signal"):
            self.encoder()
            self.fence.signal(value, self.submit())

    def abandon(self) -> None:
        """Drop the encoded commands."""
        with DeferredInterrupts():
            self._end_compute()
            if self._open:
                self._end_open()
            self.pass_ = None
            self._encoder = None

    def push_label(self, text: str) -> None:
        """Begin a group of commands."""
        encoder = self.outside()
        with DeferredInterrupts():
            encoder.push_debug_group(text)
            self._labels.append(text)

    def pop_label(self) -> None:
        """End the innermost group."""
        encoder = self.outside()
        with DeferredInterrupts():
            self._labels.pop()
            encoder.pop_debug_group()

    # -- compute -----------------------------------------------------------------------------------------

    def compute(self) -> Handle:
        """Return the handle of the open compute pass."""
        if self._compute is None:
            encoder = self.outside()
            with DeferredInterrupts():
                self._compute_object = encoder.begin_compute_pass()
                self._compute = self._compute_object._internal
        return self._compute

    def _end_compute(self) -> None:
        if self._compute_object is not None:
            with DeferredInterrupts():
                ended, self._compute_object, self._compute = self._compute_object, None, None
                ended.end()

    # -- render passes -----------------------------------------------------------------------------------

    def begin_pass(self, descriptor: PassDescriptor) -> None:
        """Begin a pass of the contract. Its first segment begins with the first command that needs one."""
        if self.pass_ is not None:  # an interrupt came before its end
            self.outside()
        self._end_compute()
        self.pass_, self._begun = descriptor, False

    def end_pass(self) -> None:
        """End the pass and resolve its targets."""
        assert self.pass_ is not None
        resolves = any(color.resolve for color in self.pass_.colors)
        if self.render is None and ((not self._begun and _clears(self.pass_)) or resolves):
            self.begin_segment()
        if self._open:
            self.end_segment()
        self.pass_ = None

    def begin_segment(self) -> None:
        """Begin a render pass with the targets of the pass."""
        assert self.pass_ is not None
        if self._open:  # an interrupt came before its note in `render`
            self._end_open()
        self._end_compute()
        descriptor = self.pass_
        first = not self._begun
        encoder = self.encoder()
        views: list[GpuObject] = []  # handles don't keep them alive
        colors = ffi.new("WGPURenderPassColorAttachment[]", max(1, len(descriptor.colors)))
        for color, target in zip(colors, descriptor.colors, strict=False):
            self._attach_color(color, target, first, encoder, views)
        info = ffi.new("WGPURenderPassDescriptor *")
        info.colorAttachmentCount, info.colorAttachments = len(descriptor.colors), colors
        depth = ffi.new("WGPURenderPassDepthStencilAttachment *")
        if descriptor.depth is not None:
            self._attach_depth(depth, descriptor.depth, first, encoder, views)
            info.depthStencilAttachment = depth
        elif not descriptor.colors:
            views.append(self.targets.dummy(descriptor.size, descriptor.samples))
            colors[0].view, colors[0].depthSlice = views[-1]._internal, NEVER_SLICED
            colors[0].loadOp, colors[0].storeOp = lib.WGPULoadOp_Clear, lib.WGPUStoreOp_Discard
            info.colorAttachmentCount = 1
        info.occlusionQuerySet = self.query_set()
        # The call and the note of its pass are C alone: an interrupt between would lock the encoder for ever.
        self._open.extend(map(lib.wgpuCommandEncoderBeginRenderPass, (encoder._internal,), (info,)))
        self.render, self._begun = self._open[0], True
        self.segments += 1
        for call in self.on_begin:
            call()

    def _attach_color(
        self, color: Handle, target: Attachment, first: bool, encoder: GpuObject, views: list[GpuObject]
    ) -> None:
        clear = target.clear if first else None
        views.append(self.targets.attach(encoder, target.texture, target.level, target.layer, clear is None))
        color.view, color.depthSlice = views[-1]._internal, NEVER_SLICED
        color.loadOp = lib.WGPULoadOp_Load if clear is None else lib.WGPULoadOp_Clear
        color.storeOp = lib.WGPUStoreOp_Store
        if clear is not None:
            color.clearValue.r, color.clearValue.g, color.clearValue.b, color.clearValue.a = clear
        if target.resolve:
            views.append(self.targets.attach(encoder, target.resolve, 0, 0, False))
            color.resolveTarget = views[-1]._internal

    def _attach_depth(
        self, depth: Handle, target: DepthAttachment, first: bool, encoder: GpuObject, views: list[GpuObject]
    ) -> None:
        views.append(self.targets.attach(encoder, target.texture, target.level, target.layer, True))
        depth.view = views[-1]._internal
        clear, clear_stencil = (target.clear, target.clear_stencil) if first else (None, None)
        depth.depthLoadOp = lib.WGPULoadOp_Load if clear is None else lib.WGPULoadOp_Clear
        depth.depthStoreOp = lib.WGPUStoreOp_Store
        depth.depthClearValue = clear or 0.0
        if self.targets.has_stencil(target.texture):
            depth.stencilLoadOp = lib.WGPULoadOp_Load if clear_stencil is None else lib.WGPULoadOp_Clear
            depth.stencilStoreOp = lib.WGPUStoreOp_Store
            depth.stencilClearValue = clear_stencil or 0

    def end_segment(self) -> None:
        """End the open render pass."""
        for call in self.on_end:
            call()
        self._end_open()
        self.targets.detach(self.encoder())

    def _end_open(self) -> None:
        self.render = None
        handle = self._open[0]
        ends = map(lib.wgpuRenderPassEncoderEnd, map(self._open.pop, (0,)))  # C alone, as the begin
        deque(ends, maxlen=0)
        lib.wgpuRenderPassEncoderRelease(handle)


def _clears(descriptor: PassDescriptor) -> bool:
    """Whether a pass without draws changes its targets."""
    depth = descriptor.depth
    return any(color.clear is not None for color in descriptor.colors) or (
        depth is not None and (depth.clear is not None or depth.clear_stencil is not None)
    )
