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

from rhi.backends.webgpu.implementation import (
    ColorTarget,
    DepthTarget,
    Fence,
    GpuObject,
    Handle,
    Implementation,
)
from rhi.backends.webgpu.webgpu_errors import translate_errors
from rhi.backends.webgpu.webgpu_formats import DUMMY_FORMAT, FORMATS
from rhi.contract.descriptors import Attachment, DepthAttachment, Id, PassDescriptor
from rhi.contract.interrupts import DeferredInterrupts


class PassTargets(Protocol):
    """The methods of `Textures` that a `Stream` uses."""

    def attach(self, encoder: GpuObject, texture: Id, level: int, layer: int, loads: bool) -> GpuObject:
        """Return the view of a texture, or of its stand-in, as a target."""

    def detach(self, encoder: GpuObject) -> None:
        """Copy the stand-ins that were drawn to back to their textures."""

    def name_format(self, texture: Id) -> str:
        """Return WebGPU's name of a texture's format."""

    def has_stencil(self, texture: Id) -> bool:
        """True if a texture has stencil."""

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
        retained: while a bundle is recorded, the objects that its draws use.
    """

    def __init__(self, implementation: Implementation, device: GpuObject, fence: Fence) -> None:
        self.implementation = implementation
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
        self.query_set: Callable[[], Handle]
        self.retained: list[GpuObject] | None = None
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
            DeviceError: `device-driver` if WebGPU refuses the commands; they are dropped. `device-lost`.
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
        if self.pass_ is None:  # an interrupt came before its begin, or after its end
            return
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
        implementation = self.implementation
        # The views live until the pass has begun: handles don't keep them alive.
        colors = [self._attach_color(target, first, encoder) for target in descriptor.colors]
        depth = None
        if descriptor.depth is not None:
            depth = self._attach_depth(descriptor.depth, first, encoder)
        elif not descriptor.colors:
            dummy = self.targets.dummy(descriptor.size, descriptor.samples)
            colors.append(ColorTarget(dummy, FORMATS[DUMMY_FORMAT], (0.0, 0.0, 0.0, 0.0), None, False))
        info = implementation.describe_render_pass(colors, depth, self.query_set(), descriptor.samples)
        # The call and the note of its pass are C alone: an interrupt between would lock the encoder for ever.
        self._open.extend(map(implementation.begin_render_pass, (encoder._internal,), (info,)))
        self.render, self._begun = self._open[0], True
        self.segments += 1
        for call in self.on_begin:
            call()

    def _attach_color(self, target: Attachment, first: bool, encoder: GpuObject) -> ColorTarget:
        clear = target.clear if first else None
        view = self.targets.attach(encoder, target.texture, target.level, target.layer, clear is None)
        resolved = self.targets.attach(encoder, target.resolve, 0, 0, False) if target.resolve else None
        return ColorTarget(view, self.targets.name_format(target.texture), clear, resolved)

    def _attach_depth(self, target: DepthAttachment, first: bool, encoder: GpuObject) -> DepthTarget:
        view = self.targets.attach(encoder, target.texture, target.level, target.layer, True)
        clear, clear_stencil = (target.clear, target.clear_stencil) if first else (None, None)
        name = self.targets.name_format(target.texture)
        return DepthTarget(view, name, clear, clear_stencil, self.targets.has_stencil(target.texture))

    def end_segment(self) -> None:
        """End the open render pass."""
        for call in self.on_end:
            call()
        self._end_open()
        self.targets.detach(self.encoder())

    def _end_open(self) -> None:
        self.render = None
        handle = self._open[0]
        ends = map(self.implementation.end_render_pass, map(self._open.pop, (0,)))  # C alone, as the begin
        deque(ends, maxlen=0)
        self.implementation.release_render_pass(handle)


def _clears(descriptor: PassDescriptor) -> bool:
    """True if a pass without draws changes its targets."""
    depth = descriptor.depth
    return any(color.clear is not None for color in descriptor.colors) or (
        depth is not None and (depth.clear is not None or depth.clear_stencil is not None)
    )
