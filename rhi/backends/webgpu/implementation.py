"""The interface of an implementation of WebGPU: wgpu-native, or the objects of a page.

- Objects (`GpuObject`) have the methods of WebGPU's specification under Python's names, as in wgpu-py:
  `device.create_buffer(size=…, usage=…)`. Dictionaries have Python's names too, enumerations are WebGPU's
  strings. `_internal` of an object is its handle.
- Handles (`Handle`) are what the functions of `Implementation` take. These are called often, so they take
  plain arguments in the order of wgpu-native's C interface.
- Whoever stores a handle also stores its object: a handle doesn't keep it alive.
"""

from __future__ import annotations

from abc import ABC
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeAlias

from rhi.contract.descriptors import TextureKind
from rhi.contract.formats import Format, IndexFormat

GpuObject: TypeAlias = Any
"""An object of WebGPU."""
Handle: TypeAlias = Any
"""The handle of an object."""


class GpuError(ABC):  # noqa: B024
    """The base class of the errors that implementations raise; each registers its own."""


class GpuMemoryError(GpuError):
    """The base class of their errors about missing memory."""


class ModuleError(Exception):
    """A text of WGSL that an implementation refuses.

    Attributes:
        messages: the messages, each with its line of the text; 0: no line.
    """

    def __init__(self, messages: Iterable[tuple[str, int]]) -> None:
        self.messages = list(messages)
        super().__init__("\n".join(message for message, _ in self.messages))


@dataclass(frozen=True)
class Host:
    """An open device, with the information, features and limits of its adapter.

    Attributes:
        info: `device`, `description` and `backend_type` of the adapter.
        limits: named as in WebGPU's specification, with hyphens.
    """

    device: GpuObject
    info: Mapping[str, str]
    features: frozenset[str]
    limits: Mapping[str, int]
    rejected_devices: tuple[str, ...] = ()

    @property
    def key(self) -> object:
        """A key that devices with the same adapter, features and limits share."""
        return (*sorted(self.info.items()), self.features, *sorted(self.limits.items()))


class ColorTarget(NamedTuple):
    """A color target of a render pass; without `clear` its contents are loaded."""

    view: GpuObject
    format: str
    clear: Sequence[float] | None
    resolve_target: GpuObject | None = None
    stores: bool = True


class DepthTarget(NamedTuple):
    """The depth target of a render pass; without a clear value its contents are loaded."""

    view: GpuObject
    format: str
    clear: float | None
    clear_stencil: int | None
    has_stencil: bool


class Fence(Protocol):
    """Values that submissions reach, in order.

    Attributes:
        reached: the value of the latest `poll`.
    """

    reached: int

    def submit(self, commands: GpuObject) -> int:
        """Submit a command buffer and return the number of the submission."""

    def signal(self, value: int, submission: int) -> None:
        """Set the value once everything that was submitted is done."""

    def poll(self) -> int:
        """Return the value reached, without waiting."""

    def process(self) -> bool:
        """Run the callbacks of all finished work; return whether all work is finished."""

    def pause(self, seconds: float) -> None:
        """Leave the device this time to work, in seconds."""

    def finish(self, submission: int) -> None:
        """Wait until a submission is done."""

    def finish_all(self) -> None:
        """Wait until everything that was submitted is done."""

    def close(self) -> None:
        """Give back what a device that is released has used."""


class Mappings(Protocol):
    """Buffers that are mapped for reading."""

    def begin(self, buffer: GpuObject, size: int) -> int:
        """Begin to map the first bytes of a buffer after all submitted work; return a ticket."""

    def is_done(self, ticket: int) -> bool:
        """True if the buffer is mapped."""

    def end(self, ticket: int, buffer: GpuObject, offset: int, size: int) -> bytes:
        """Return a range of a mapped buffer, and unmap it. Offset and size are multiples of 8 and 4."""

    def cancel(self, ticket: int, buffer: GpuObject) -> None:
        """Unmap a buffer whose mapping was begun and not ended."""

    def close(self) -> None:
        """Give back what a device that is released has used."""


class FormatUses(Protocol):
    """The uses of formats on a device."""

    def usage(self, format: Format, kind: TextureKind, samples: int) -> int:
        """Return all usages (`GpuTextureUsage`) of textures like this, 0 if they can't exist."""

    def blends(self, format: Format) -> bool:
        """True if draws can blend with a format, and for integers, which never blend."""

    def resolves(self, format: Format) -> bool:
        """True if four samples of a format can be resolved."""

    def is_image(self, format: Format, access: str) -> bool:
        """True if images of a format allow this access (`GPUStorageTextureAccess`)."""


class DrawFunctions(Protocol):
    """The functions of draws, of a pass or a bundle. They take its handle first."""

    set_pipeline: Callable[[Handle, Handle], object]
    set_bind_group: Callable[[Handle, int, Handle, int, Any], object]
    set_vertex_buffer: Callable[[Handle, int, Handle, int, int], object]
    set_index_buffer: Callable[[Handle, Handle, Any, int, int], object]
    draw: Callable[[Handle, int, int, int, int], object]
    draw_indexed: Callable[[Handle, int, int, int, int, int], object]


class BundleFunctions(DrawFunctions, Protocol):
    """The functions of bundles: draws that are recorded once, and executed by one call in each pass."""

    def begin(self, device: GpuObject, colors: Sequence[str], depth: str | None, samples: int) -> GpuObject:
        """Begin a bundle for passes with targets of these formats; return an object with the bundle's handle."""

    def finish(self, encoder: GpuObject) -> GpuObject:
        """Return the bundle. Its user keeps the objects alive that its draws use."""

    def execute(self, render: Handle, bundle: GpuObject) -> None:
        """Execute a bundle in a pass, of which nothing that draws need is set afterwards."""


class Implementation(DrawFunctions, Protocol):
    """The functions of an implementation. Those of passes take the pass's handle first.

    Attributes:
        name: the backend's name.
        version: the name and version of the implementation, for `Capabilities.driver`.
        index_formats: the constants of index formats.
        no_offsets: the offsets of a bind group without dynamic ones.
        maps_early: whether READBACK buffers are mapped when they are written, since their reader may not be
            able to wait.
        bundles: the functions of bundles; None if there are none.
    """

    name: str
    version: str
    index_formats: Mapping[IndexFormat, Any]
    no_offsets: Any
    maps_early: bool
    bundles: BundleFunctions | None

    multi_draw_indirect: Callable[[Handle, Handle, int, int], object]
    multi_draw_indexed_indirect: Callable[[Handle, Handle, int, int], object]
    multi_draw_indexed_indirect_count: Callable[[Handle, Handle, int, Handle, int, int], object]
    set_viewport: Callable[[Handle, float, float, float, float, float, float], object]
    set_scissor_rect: Callable[[Handle, int, int, int, int], object]
    set_stencil_reference: Callable[[Handle, int], object]
    begin_occlusion_query: Callable[[Handle, int], object]
    end_occlusion_query: Callable[[Handle], object]
    write_timestamp: Callable[[Handle, Handle, int], object]
    write_pass_timestamp: Callable[[Handle, Handle, int], object]
    set_compute_pipeline: Callable[[Handle, Handle], object]
    set_compute_bind_group: Callable[[Handle, int, Handle, int, Any], object]
    dispatch_workgroups: Callable[[Handle, int, int, int], object]
    dispatch_workgroups_indirect: Callable[[Handle, Handle, int], object]
    pack_group: Callable[[Handle, int, Handle, int], Callable[..., bytes]] | None
    """Returns a function of a group's dynamic offsets that returns its bytes, which are added to a pass's handle
    instead of a call of `set_bind_group`, in any pass; None if calls are made at once. What other functions add to
    a pass's handle may then be added to another one's, too."""
    begin_render_pass: Callable[[Handle, Any], Handle]
    """Begins a pass of an encoder's handle. Runs no Python function, so nothing interrupts it."""
    end_render_pass: Callable[[Handle], object]
    """Ends a pass; like its begin."""
    release_render_pass: Callable[[Handle], object]

    def set_blend_constant(self, render: Handle, color: tuple[float, float, float, float]) -> None:
        """Set the blend constant of a pass."""

    def pack_draw(
        self, indexed: bool, count: int, first: int, base_vertex: int, base_instance: int
    ) -> bytes | None:
        """Return the bytes of a draw of one instance, which are added to a pass's handle instead of a call of
        `draw` or `draw_indexed`; None if calls are made at once."""

    def describe_render_pass(
        self, colors: Sequence[ColorTarget], depth: DepthTarget | None, query_set: Handle, samples: int
    ) -> Any:
        """Return the description of a render pass, for `begin_render_pass`."""

    def offset_array(self, count: int) -> Any:
        """Return an array of this many dynamic offsets, which a slice can be assigned to."""

    def create_fence(self, device: GpuObject) -> Fence:
        """Return the fence of a device."""

    def create_mappings(self) -> Mappings:
        """Return the mapped reads of a device."""

    def create_module(self, device: GpuObject, label: str, code: str) -> GpuObject:
        """Compile a text of WGSL.

        Raises:
            ModuleError: if the text is refused.
        """

    def write_queue(
        self, device: GpuObject, buffer: Handle, offset: int, data: Any, start: int, size: int
    ) -> None:
        """Write a part of `data`, a buffer of Python, before the next submission. Offset and size are
        multiples of 4."""

    def timestamp_period(self, device: GpuObject) -> float:
        """Return the unit of timestamps, in nanoseconds."""

    def release(self, device: GpuObject) -> None:
        """Destroy a device, once it has done its work."""
