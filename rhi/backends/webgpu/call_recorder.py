"""An implementation of WebGPU that writes down its calls instead of executing them.

A page can make the same calls later, on its own WebGPU: `rhi.trace.page`. Nothing can be read back here, so
what needs the contents of a buffer is refused.

A call is `[result, object, method, arguments]`; objects are numbers, 1 is the device and 2 its queue. Among
the arguments, `{"$": number}` is an object and `{"blob": number}` an array of bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from hashlib import sha256
from typing import Any, Final

from rhi.backends.webgpu.implementation import (
    BundleFunctions,
    ColorTarget,
    DepthTarget,
    GpuError,
    GpuObject,
    Handle,
    Host,
)
from rhi.backends.webgpu.javascript_names import prepare, to_camel_case
from rhi.backends.webgpu.specified_formats import SpecifiedFormats
from rhi.backends.webgpu.webgpu_backend import WebGpuBackend
from rhi.backends.webgpu.webgpu_limits import CORE_LIMITS
from rhi.contract.formats import IndexFormat

Call = tuple[int, int, str, list[Any]]

DEVICE: Final = 1
QUEUE: Final = 2
FEATURES: Final = frozenset({"indirect-first-instance"})
"""Features that the calls may need; without them, arguments of indirect draws would be read back."""

_INFO: Final = {"device": "a recorder", "description": "", "backend_type": "WebGPU"}


class ReadError(Exception):
    """A call needs what only a device knows."""


GpuError.register(ReadError)


class RecordedObject:
    """An object that a call will have returned.

    Attributes:
        number: its number in the calls.
    """

    def __init__(self, recorder: CallRecorder, number: int) -> None:
        self._recorder = recorder
        self.number = number

    @property
    def _internal(self) -> RecordedObject:
        return self

    @property
    def queue(self) -> RecordedObject:
        """The device's queue."""
        return self._recorder.queue

    def write_mapped(self, data: Any) -> None:
        """Write an array to a buffer that was mapped at its creation."""
        self._recorder.call(self.number, "writeMapped", bytes(memoryview(data).cast("B")))

    def __getattr__(self, name: str) -> Callable[..., RecordedObject]:
        if name.startswith("__"):
            raise AttributeError(name)
        return partial(self._recorder.call, self.number, to_camel_case(name))


class RecordedFence:
    """A fence that all submissions have reached; `rhi.backends.webgpu.implementation.Fence`."""

    def __init__(self, recorder: CallRecorder) -> None:
        self._recorder = recorder
        self._latest = 0
        self.reached = 0

    def submit(self, commands: GpuObject) -> int:
        """Write a submission down and return its number."""
        self._recorder.call(QUEUE, "submit", [commands])
        self._latest += 1
        return self._latest

    def signal(self, value: int, submission: int) -> None:
        """Reach a value."""
        self.reached = value

    def poll(self) -> int:
        """Return the value reached."""
        return self.reached

    def process(self) -> bool:
        """Return True: nothing is left to do."""
        return True

    def pause(self, seconds: float) -> None:
        """Do nothing."""

    def finish(self, submission: int) -> None:
        """Do nothing."""

    def finish_all(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class RefusedMappings:
    """Mapped reads, which are refused; `rhi.backends.webgpu.implementation.Mappings`."""

    def begin(self, buffer: GpuObject, size: int) -> int:
        """Return a ticket."""
        return 0

    def is_done(self, ticket: int) -> bool:
        """Return True, so that nobody waits."""
        return True

    def end(self, ticket: int, buffer: GpuObject, offset: int, size: int) -> bytes:
        """Refuse the read.

        Raises:
            ReadError: always.
        """
        raise ReadError("a call needs the contents of a buffer, which only a device knows")

    def cancel(self, ticket: int, buffer: GpuObject) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


def _leave_to_collector(render: Handle) -> None:
    """Do nothing: JavaScript's collector releases a pass."""


def _refuse_absent(*arguments: object) -> None:
    """Stand for functions that need a feature which a recorder doesn't have. No call reaches it."""
    raise NotImplementedError


class CallRecorder:
    """Writes calls down; `rhi.backends.webgpu.implementation.Implementation`.

    Attributes:
        calls: the calls, in order.
        blobs: arrays of bytes, each of them once.
    """

    name = "recorder"
    version = "calls of WebGPU"
    index_formats: Mapping[IndexFormat, Any] = {IndexFormat.UINT16: "uint16", IndexFormat.UINT32: "uint32"}
    no_offsets = None
    maps_early = False
    bundles: BundleFunctions | None = None
    pack_group: Callable[[Handle, int, Handle, int], Callable[..., bytes]] | None = None

    def __init__(self) -> None:
        self.calls: list[Call] = []
        self.blobs: list[bytes] = []
        self._blobs_by_digest: dict[bytes, int] = {}
        self._latest = QUEUE
        self.device = RecordedObject(self, DEVICE)
        self.queue = RecordedObject(self, QUEUE)
        for name in (
            "set_pipeline", "set_vertex_buffer", "set_index_buffer", "draw", "draw_indexed", "set_viewport",
            "set_scissor_rect", "set_stencil_reference", "begin_occlusion_query", "end_occlusion_query",
            "dispatch_workgroups", "dispatch_workgroups_indirect", "begin_render_pass",
        ):  # fmt: skip
            setattr(self, name, partial(self._call_object, to_camel_case(name)))
        self.set_compute_pipeline = partial(self._call_object, "setPipeline")
        self.set_bind_group = self.set_compute_bind_group = self._set_bind_group
        self.release_render_pass = _leave_to_collector
        self.multi_draw_indexed_indirect_count = _refuse_absent
        self.write_timestamp = self.write_pass_timestamp = _refuse_absent
        self.end_render_pass = partial(self._call_object, "end")
        self.multi_draw_indirect = partial(self._call_indirect, "drawIndirect", 16)
        self.multi_draw_indexed_indirect = partial(self._call_indirect, "drawIndexedIndirect", 20)

    set_pipeline: Callable[[Handle, Handle], object]
    set_vertex_buffer: Callable[[Handle, int, Handle, int, int], object]
    set_index_buffer: Callable[[Handle, Handle, Any, int, int], object]
    draw: Callable[[Handle, int, int, int, int], object]
    draw_indexed: Callable[[Handle, int, int, int, int, int], object]
    set_viewport: Callable[[Handle, float, float, float, float, float, float], object]
    set_scissor_rect: Callable[[Handle, int, int, int, int], object]
    set_stencil_reference: Callable[[Handle, int], object]
    begin_occlusion_query: Callable[[Handle, int], object]
    end_occlusion_query: Callable[[Handle], object]
    dispatch_workgroups: Callable[[Handle, int, int, int], object]
    dispatch_workgroups_indirect: Callable[[Handle, Handle, int], object]
    begin_render_pass: Callable[[Handle, Any], Handle]
    end_render_pass: Callable[[Handle], object]
    release_render_pass: Callable[[Handle], object]
    set_compute_pipeline: Callable[[Handle, Handle], object]
    set_bind_group: Callable[[Handle, int, Handle, int, Any], object]
    set_compute_bind_group: Callable[[Handle, int, Handle, int, Any], object]
    multi_draw_indirect: Callable[[Handle, Handle, int, int], object]
    multi_draw_indexed_indirect: Callable[[Handle, Handle, int, int], object]
    multi_draw_indexed_indirect_count: Callable[[Handle, Handle, int, Handle, int, int], object]
    write_timestamp: Callable[[Handle, Handle, int], object]
    write_pass_timestamp: Callable[[Handle, Handle, int], object]

    def call(self, target: int, method: str, *arguments: Any, **members: Any) -> RecordedObject:
        """Write a call down; return the object that it will return."""
        values = [prepare(argument, self._encode) for argument in arguments]
        if members:
            values.append(prepare(members, self._encode))
        self._latest += 1
        self.calls.append((self._latest, target, method, values))
        return RecordedObject(self, self._latest)

    def _encode(self, value: Any) -> Any:
        if isinstance(value, RecordedObject):
            return {"$": value.number}
        if value is None or isinstance(value, (bool, float, str)):
            return value
        data = bytes(memoryview(value).cast("B"))
        number = self._blobs_by_digest.setdefault(sha256(data).digest(), len(self.blobs))
        if number == len(self.blobs):
            self.blobs.append(data)
        return {"blob": number}

    def _call_object(self, method: str, target: RecordedObject, *arguments: Any) -> RecordedObject:
        return self.call(target.number, method, *arguments)

    def _call_indirect(
        self, method: str, stride: int, render: RecordedObject, buffer: Handle, offset: int, draws: int
    ) -> None:
        for draw in range(draws):
            self.call(render.number, method, buffer, offset + stride * draw)

    def _set_bind_group(self, target: Handle, index: int, group: Handle, count: int, offsets: Any) -> None:
        arguments = [[int(offset) for offset in offsets]] if count else []
        self.call(target.number, "setBindGroup", index, group, *arguments)

    def set_blend_constant(self, render: Handle, color: tuple[float, float, float, float]) -> None:
        """Set the blend constant of a pass."""
        self.call(render.number, "setBlendConstant", list(color))

    def pack_draw(self, indexed: bool, count: int, first: int, base_vertex: int, base_instance: int) -> None:
        """Return None: calls are made at once."""

    def describe_render_pass(
        self, colors: Sequence[ColorTarget], depth: DepthTarget | None, query_set: Handle, samples: int
    ) -> Any:
        """Return the description of a render pass."""
        attachments = [
            {
                "view": view,
                "resolve_target": resolved,
                "clear_value": None if clear is None else list(clear),
                "load_op": "load" if clear is None else "clear",
                "store_op": "store" if stores else "discard",
            }
            for view, _, clear, resolved, stores in colors
        ]
        target: dict[str, Any] | None = None
        if depth is not None:
            target = {
                "view": depth.view,
                "depth_load_op": "load" if depth.clear is None else "clear",
                "depth_store_op": "store",
                "depth_clear_value": depth.clear or 0.0,
            }
            if depth.has_stencil:
                target |= {
                    "stencil_load_op": "load" if depth.clear_stencil is None else "clear",
                    "stencil_store_op": "store",
                    "stencil_clear_value": depth.clear_stencil or 0,
                }
        return {
            "color_attachments": attachments,
            "depth_stencil_attachment": target,
            "occlusion_query_set": query_set,
        }

    def offset_array(self, count: int) -> list[int]:
        """Return an array of this many dynamic offsets."""
        return [0] * count

    def create_fence(self, device: GpuObject) -> RecordedFence:
        """Return the fence of a device."""
        return RecordedFence(self)

    def create_mappings(self) -> RefusedMappings:
        """Return the mapped reads of a device."""
        return RefusedMappings()

    def create_module(self, device: GpuObject, label: str, code: str) -> RecordedObject:
        """Write down that a text of WGSL is compiled."""
        return self.call(DEVICE, "createShaderModule", label=label, code=code)

    def write_queue(
        self, device: GpuObject, buffer: Handle, offset: int, data: Any, start: int, size: int
    ) -> None:
        """Write down that a part of an array is written."""
        part = bytes(memoryview(data).cast("B")[start : start + size])
        self.call(QUEUE, "writeBuffer", buffer, offset, part)

    def timestamp_period(self, device: GpuObject) -> float:
        """Return the unit of timestamps, in nanoseconds."""
        return 1.0

    def release(self, device: GpuObject) -> None:
        """Do nothing: the page keeps its device."""


class RecordingBackend(WebGpuBackend):
    """A backend with what every WebGPU has, whose calls are written down.

    Attributes:
        recorder: has the calls.
    """

    def __init__(self) -> None:
        self.recorder = CallRecorder()
        host = Host(self.recorder.device, _INFO, FEATURES, CORE_LIMITS)
        super().__init__(self.recorder, host, SpecifiedFormats(FEATURES))

    def locate_view(self, texture: int, level: int, layer: int) -> tuple[int, dict[str, int]]:
        """Return the number of a texture's object, and the members of a view of a level and a layer."""
        gpu_texture = self._textures.objects[texture].object
        members = {"baseMipLevel": level, "mipLevelCount": 1, "baseArrayLayer": layer, "arrayLayerCount": 1}
        return gpu_texture.number, members

    def settle(self) -> None:
        """Clear the targets of the open pass now, rather than with its first draw."""
        self._stream.settle()
