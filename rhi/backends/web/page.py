"""The page's WebGPU: its adapter and device, the fence, mapped reads, and the functions of passes.

- A page runs nothing of its own while Python runs. Python can wait for it where the engine has JSPI
  (`can_run_sync`); elsewhere waits are refused as `device-wait`.
- WebGPU reports errors later, to the page. They are raised by the next call that submits or asks for results.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

import js
from pyodide.code import run_js
from pyodide.ffi import JsException, can_run_sync, run_sync, to_js

from rhi.backends.web import pass_commands
from rhi.backends.web.javascript import FUNCTIONS
from rhi.backends.web.js_objects import OBJECTS, TABLE, WebObject
from rhi.backends.web.pass_commands import REPLAY, PassCommands
from rhi.backends.webgpu.implementation import (
    BundleFunctions,
    ColorTarget,
    DepthTarget,
    GpuError,
    GpuObject,
    Handle,
    Host,
    ModuleError,
)
from rhi.backends.webgpu.javascript_names import to_camel_case
from rhi.backends.webgpu.webgpu_limits import CORE_LIMITS
from rhi.contract.formats import IndexFormat
from rhi.contract.interrupts import DeferredInterrupts
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER, DEVICE_WAIT

GpuError.register(JsException)

_CALL: Final = "rhi.create_device('web')"
_TIMESTAMPS: Final = "timestamp-query"
_USED: Final = (
    "depth32float-stencil8",
    "float32-blendable",
    "float32-filterable",
    "indirect-first-instance",
    "rg11b10ufloat-renderable",
    "texture-compression-bc",
    _TIMESTAMPS,
)
"""Features to request, if the adapter has them."""
_TIP: Final = 'await request_device() of rhi.backends.web, and pass it: rhi.create_device("web", device=…)'
_LONGEST_TURN: Final = 0.25
_functions: Any = None
_prepared: list[Any] = []  # devices that were requested, and opened by nobody yet


class PageError(Exception):
    """An error that the page has reported."""


GpuError.register(PageError)


def get_functions() -> Any:
    """Return the functions of `javascript.FUNCTIONS`."""
    global _functions
    if _functions is None:
        _functions = run_js(FUNCTIONS)
    return _functions


def wait_for(promise: Any, call: str) -> Any:
    """Wait for a promise of the page.

    Raises:
        DeviceError: `device-wait` if Python can't wait here.
    """
    check_wait(call)
    return run_sync(promise)


def check_wait(call: str, tip: str = "") -> None:
    """Refuse a wait where Python can't wait for the page.

    Raises:
        DeviceError: `device-wait`.
    """
    if not can_run_sync():
        given = "an engine without JSPI, or a call from a synchronous function"
        raise DeviceError(DEVICE_WAIT, call, given, "", tip)


async def request() -> Any:
    """Return a new `GPUDevice` of the page.

    Raises:
        DeviceError: `device-driver`.
    """
    functions = get_functions()
    gpu = getattr(getattr(js, "navigator", None), "gpu", None)
    if gpu is None:
        tip = "WebGPU needs a browser that has it, and a page from https or localhost"
        raise DeviceError(DEVICE_DRIVER, _CALL, "the page has no WebGPU (navigator.gpu)", "", tip)
    try:
        adapter = await functions.request_adapter(gpu)
    except JsException as error:
        raise DeviceError(DEVICE_DRIVER, _CALL, f"the adapter was refused: {error}") from error
    if adapter is None:
        tip = "the browser blocks this GPU or its driver: chrome://gpu and about:support say why"
        raise DeviceError(DEVICE_DRIVER, _CALL, "the page has WebGPU, but no adapter", "", tip)
    features = [name for name in _USED if functions.has(adapter.features, name)]
    try:
        return await functions.request_device(adapter, to_js(features))
    except JsException as error:
        raise DeviceError(DEVICE_DRIVER, _CALL, f"the device was refused: {error}") from error


async def prepare() -> None:
    """Request a `GPUDevice` that the next `open_host` takes.

    Raises:
        DeviceError: `device-driver`.
    """
    if not _prepared:
        _prepared.append(await request())


def open_host(page: WebPage, device: Any = None) -> Host:
    """Return the host of a `GPUDevice`; without one, take the prepared one, or request it and wait.

    Raises:
        DeviceError: `device-driver`; `device-wait` if Python can't wait here.
    """
    if device is None and _prepared:
        device = _prepared.pop()
    if device is None:
        check_wait(_CALL, _TIP)
        device = run_sync(request())
    info = getattr(device, "adapterInfo", None)
    names = {
        key: str(getattr(info, key, "") or "") for key in ("vendor", "architecture", "device", "description")
    }
    name = names["description"] or " ".join(filter(None, (names["vendor"], names["architecture"])))
    description = " ".join(filter(None, (names["vendor"], names["architecture"], names["device"])))
    limits = {limit: int(getattr(device.limits, _spell_limit(limit))) for limit in CORE_LIMITS}
    features = {feature for feature in _USED if page.functions.has(device.features, feature)}
    if _TIMESTAMPS in features:
        features.add("timestamp-query-inside-encoders")  # by `WebPage.write_timestamp`
    page.device, page.state = device, page.functions.watch(device)
    host_info = {"device": name or "WebGPU", "description": description, "backend_type": "WebGPU"}
    return Host(WebDevice(device, page), host_info, frozenset(features), limits)


def _spell_limit(name: str) -> str:
    """Return a limit's name of WebGPU: `max-texture-dimension-2d` is `maxTextureDimension2D`."""
    return to_camel_case(name.replace("-", "_")).replace("1d", "1D").replace("2d", "2D").replace("3d", "3D")


class WebDevice(WebObject):
    """A `GPUDevice`. Once it is lost, its methods raise."""

    __slots__ = ("_page",)

    def __init__(self, proxy: Any, page: WebPage) -> None:
        super().__init__(proxy)
        self._page = page

    def __getattr__(self, name: str) -> Any:
        if name.startswith("create_"):
            self._page.check_lost()
        return WebObject.__getattr__(self, name)

    def create_buffer(self, **members: Any) -> WebBuffer:
        """Create a buffer."""
        self._page.check_lost()
        return WebBuffer(WebObject.__getattr__(self, "create_buffer")(**members)._internal, self._page)


class WebBuffer(WebObject):
    """A `GPUBuffer`."""

    __slots__ = ("_page",)

    def __init__(self, proxy: Any, page: WebPage) -> None:
        super().__init__(proxy)
        self._page = page

    def write_mapped(self, data: Any) -> None:
        """Write an array to the buffer, which is mapped."""
        self._page.functions.write_mapped(self._internal, data)


def _leave_to_collector(render: Handle) -> None:
    """Do nothing: JavaScript's collector releases a pass."""


def _refuse_absent(*arguments: object) -> None:
    """Stand for functions that need a feature which a page's device never has. No call reaches it."""
    raise NotImplementedError


class DrawWords:
    """The functions of draws, which add words to those of a pass."""

    def __init__(self) -> None:
        commands: Any = pass_commands
        self.set_pipeline = commands.set_pipeline
        self.set_bind_group = commands.set_bind_group
        self.set_vertex_buffer = commands.set_vertex_buffer
        self.set_index_buffer = commands.set_index_buffer
        self.draw = commands.draw
        self.draw_indexed = commands.draw_indexed


class WebBundles(DrawWords):
    """The functions of bundles; `rhi.backends.webgpu.implementation.BundleFunctions`.

    A bundle is the words of its draws, which are added to those of a pass. Words that come again become the page's
    bundles.
    """

    def begin(
        self, device: GpuObject, colors: Sequence[str], depth: str | None, samples: int
    ) -> PassCommands:
        """Begin a bundle."""
        return PassCommands(TABLE)

    def finish(self, encoder: PassCommands) -> bytes:
        """Return the words of the bundle."""
        return bytes(encoder)

    def execute(self, render: PassCommands, bundle: bytes) -> None:
        """Add the words to those of a pass."""
        render += bundle


class WebPage(DrawWords):
    """The functions of a page; `rhi.backends.webgpu.implementation.Implementation`."""

    name = "web"
    index_formats: Mapping[IndexFormat, Any] = {IndexFormat.UINT16: 0, IndexFormat.UINT32: 1}
    no_offsets = ()
    maps_early = True

    begin_render_pass: Callable[[Handle, Any], Handle]
    pack_group: Callable[[Handle, int, Handle, int], Callable[..., bytes]] | None
    release_render_pass: Callable[[Handle], object]
    end_render_pass: Callable[[Handle], object]
    set_compute_bind_group: Callable[[Handle, int, Handle, int, Any], object]
    multi_draw_indexed_indirect_count: Callable[[Handle, Handle, int, Handle, int, int], object]
    write_pass_timestamp: Callable[[Handle, Handle, int], object]

    def __init__(self) -> None:
        super().__init__()
        functions = self.functions = get_functions()
        self.state: Any = None
        self.version = str(getattr(getattr(js, "navigator", None), "userAgent", "") or "a page")
        self.device: Any = None
        self._replay = run_js(REPLAY)
        self.bundles: BundleFunctions | None = WebBundles()
        commands: Any = pass_commands
        self.multi_draw_indirect = commands.multi_draw_indirect
        self.multi_draw_indexed_indirect = commands.multi_draw_indexed_indirect
        self.set_viewport = commands.set_viewport
        self.set_scissor_rect = commands.set_scissor_rect
        self.set_stencil_reference = commands.set_stencil_reference
        self.set_blend_constant = commands.set_blend_constant
        self.begin_occlusion_query = commands.begin_occlusion_query
        self.end_occlusion_query = commands.end_occlusion_query
        self.begin_render_pass = partial(commands.PassCommands, TABLE)
        self.pack_group = commands.pack_group
        self.end_render_pass = self._end_render_pass
        self.release_render_pass = _leave_to_collector
        self.set_compute_bind_group = self._set_compute_bind_group
        self.multi_draw_indexed_indirect_count = _refuse_absent
        self.write_pass_timestamp = _refuse_absent
        self.set_compute_pipeline = functions.set_compute_pipeline
        self.dispatch_workgroups = functions.dispatch_workgroups
        self.dispatch_workgroups_indirect = functions.dispatch_workgroups_indirect
        self.write_timestamp = functions.write_timestamp

    def _set_compute_bind_group(
        self, compute: Handle, index: int, group: Handle, count: int, offsets: Sequence[int]
    ) -> None:
        """Bind a group of a compute pass."""
        self.functions.set_compute_bind_group(compute, index, group, *offsets)

    def _end_render_pass(self, render: PassCommands) -> None:
        """Begin a pass of the page, make its calls, and end it."""
        with DeferredInterrupts():
            self._replay(self.device, render.encoder, render.description, render, OBJECTS)

    def pack_draw(self, indexed: bool, count: int, first: int, base_vertex: int, base_instance: int) -> bytes:
        """Return the record of a draw of one instance."""
        return pass_commands.pack_draw(indexed, count, first, base_vertex, base_instance)

    def describe_render_pass(
        self, colors: Sequence[ColorTarget], depth: DepthTarget | None, query_set: Handle, samples: int
    ) -> Any:
        """Return the description of a render pass."""
        parts: list[Any] = []
        formats = ",".join(color.format for color in colors)
        for view, _, clear, resolved, stores in colors:
            parts += [view._internal, resolved._internal if resolved is not None else None]
            parts += [clear is not None, stores, *(clear or (0.0, 0.0, 0.0, 0.0))]
        functions, target = self.functions, None
        if depth is not None:
            target = functions.array(
                depth.view._internal,
                depth.clear is not None,
                depth.clear or 0.0,
                depth.has_stencil,
                depth.clear_stencil is not None,
                depth.clear_stencil or 0,
            )
        depth_format = depth.format if depth is not None else ""
        return functions.describe_render_pass(
            functions.array(*parts), target, query_set, formats, depth_format, samples
        )

    def offset_array(self, count: int) -> list[int]:
        """Return an array of this many dynamic offsets."""
        return [0] * count

    def create_fence(self, device: GpuObject) -> PageFence:
        """Return the fence of a device."""
        return PageFence(self, device)

    def create_mappings(self) -> PageMappings:
        """Return the mapped reads of a device."""
        return PageMappings(self)

    def create_module(self, device: GpuObject, label: str, code: str) -> GpuObject:
        """Compile a text of WGSL. Where Python can't wait, errors are raised later.

        Raises:
            ModuleError: if the text is refused.
        """
        self.check_lost()
        if not can_run_sync():
            return WebObject(self.functions.compile(device._internal, label, code))
        compiled = run_sync(self.functions.compile_checked(device._internal, label, code))
        if compiled.refused:
            messages = [(str(message), int(line)) for message, line in compiled.messages.to_py()]
            raise ModuleError(messages or [(str(compiled.text), 0)])
        return WebObject(compiled.module)

    def write_queue(
        self, device: GpuObject, buffer: Handle, offset: int, data: Any, start: int, size: int
    ) -> None:
        """Write a part of `data`, a buffer of Python, before the next submission. Offset and size are
        multiples of 4."""
        self.check_lost()
        self.functions.write_buffer(device._internal.queue, buffer, offset, data, start, size)

    def timestamp_period(self, device: GpuObject) -> float:
        """Return the unit of timestamps, in nanoseconds."""
        return 1.0

    def release(self, device: GpuObject) -> None:
        """Destroy a device."""
        device._internal.destroy()

    def check_lost(self) -> None:
        """Raise if the device is lost."""
        lost = self.state.lost
        if lost:
            raise PageError(lost)

    def check_errors(self) -> None:
        """Raise what the page has reported since the latest check."""
        text = self.functions.take_error(self.state)
        if text:
            raise PageError(text)


class PageFence:
    """Values that submissions reach; `rhi.backends.webgpu.implementation.Fence`."""

    def __init__(self, page: WebPage, device: GpuObject) -> None:
        self._page = page
        self._queue = device._internal.queue
        self._latest = 0
        self._signalled = 0
        self.reached = 0

    def submit(self, commands: GpuObject) -> int:
        """Submit a command buffer and return the number of the submission."""
        self._page.check_errors()
        self._page.functions.submit(self._queue, commands._internal)
        self._latest += 1
        return self._latest

    def signal(self, value: int, submission: int) -> None:
        """Set the value once everything that was submitted is done."""
        self._page.functions.signal(self._queue, self._page.state, value)
        self._signalled = value

    def poll(self) -> int:
        """Return the value reached. Where Python can wait, the page gets a turn: else nothing would
        change."""
        if self.reached < self._signalled:
            self.process()
            self.reached = int(self._page.state.reached)
        return self.reached

    def process(self) -> bool:
        """Give the page a turn to note what is finished; return whether all work is."""
        if can_run_sync():
            run_sync(self._page.functions.turn())
        return int(self._page.state.reached) >= self._signalled

    def pause(self, seconds: float) -> None:
        """Wait for the device, at most this long."""
        wait_for(self._page.functions.wait_for(self._queue, max(seconds, _LONGEST_TURN / 50)), "device.wait")

    def finish(self, submission: int) -> None:
        """Do nothing: who waits for a mapping calls `finish_all` until it is there."""

    def finish_all(self) -> None:
        """Wait until everything that was submitted is done."""
        self._page.check_lost()
        wait_for(self._page.functions.work_done(self._queue), "a read")
        self._page.check_errors()

    def close(self) -> None:
        """Do nothing: JavaScript's collector frees what a device used."""


class PageMappings:
    """Buffers that are mapped for reading; `rhi.backends.webgpu.implementation.Mappings`."""

    def __init__(self, page: WebPage) -> None:
        self._page = page
        self._mappings: dict[int, Any] = {}
        self._latest = 0

    def begin(self, buffer: GpuObject, size: int) -> int:
        """Begin to map the first bytes of a buffer after all submitted work; return a ticket."""
        self._latest += 1
        self._mappings[self._latest] = self._page.functions.map(self._page.state, buffer._internal, size)
        return self._latest

    def is_done(self, ticket: int) -> bool:
        """True if the buffer is mapped."""
        return bool(self._mappings[ticket].done)

    def end(self, ticket: int, buffer: GpuObject, offset: int, size: int) -> bytes:
        """Return a range of a mapped buffer, and unmap it. Offset and size are multiples of 8 and 4."""
        error = self._mappings.pop(ticket).error
        if error:
            self._page.check_errors()
            raise PageError(f"a buffer could not be mapped: {error}")
        return bytes(self._page.functions.read_mapped(buffer._internal, offset, size).to_bytes())

    def cancel(self, ticket: int, buffer: GpuObject) -> None:
        """Unmap a buffer whose mapping was begun and not ended."""
        self._mappings.pop(ticket, None)
        buffer._internal.unmap()

    def close(self) -> None:
        """Forget the mappings of a device that is released."""
        self._mappings.clear()
