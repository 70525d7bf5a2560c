"""The device: the platform-independent half of the interface (the thesis's modified PIMPL, 3.6.3).

- `Device` creates resources, opens passes and scopes, draws, and synchronises. It is the only module with
  policy: when resources are destroyed, how many frames the CPU may be ahead, how large rings are.
- A device belongs to one thread, and on some platforms to the context that is current there
  (`Core.check_ready`).
- The other half is a `Backend`; commands are calls of its methods. All checks are made here, before a call
  reaches the backend.
"""

from __future__ import annotations

import logging
import sys
from collections import deque
from collections.abc import Awaitable, Callable, Generator, Sequence
from dataclasses import replace
from functools import wraps
from pathlib import Path
from threading import get_ident
from typing import TYPE_CHECKING, Any, Final, Self, TypeVar, cast, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import ParamSpec

from rhi.commands.recorder import Recorder
from rhi.commands.stream import CommandStream
from rhi.contract.backend import Backend, Capabilities
from rhi.contract.blocks import BLOCK, CompressedFormat
from rhi.contract.descriptors import (
    BufferUsage,
    Primitive,
    ProgramDescriptor,
    SamplerDescriptor,
    TextureDescriptor,
    TextureKind,
)
from rhi.contract.formats import Format
from rhi.contract.layout import repack
from rhi.contract.limits import full_levels
from rhi.contract.states import State
from rhi.contract.texels import add_channel_axis
from rhi.device.capture import FrameCapture
from rhi.device.command_buffer import CommandBuffer, check_submissions
from rhi.device.core.core import FORKED, NO_THREAD, Core, Statistics, ValidatingCore
from rhi.device.core.event_loop import pause_until
from rhi.device.core.memory_ledger import MemoryUse
from rhi.device.core.refusals import RefusalLog
from rhi.device.core.state_cache import StateCache
from rhi.device.encoder import Encoder
from rhi.device.preparation import DrawPlan, Preparation, prepare
from rhi.device.queries.occlusion import OcclusionQuery
from rhi.device.queries.sets import MAX_QUERIES, QuerySet
from rhi.device.queries.timers import TimerNode, Timers
from rhi.device.resources.buffers import (
    Buffer,
    StorageBuffer,
    UniformArray,
    UniformBuffer,
    match_layout,
    storage_dtype,
)
from rhi.device.resources.images import (
    ImageLike,
    as_texels,
    infer_format,
    tip_for_texels,
)
from rhi.device.resources.meshes import Drawable, Mesh, MeshData, VertexSource
from rhi.device.resources.programs import Program, ProgramTable
from rhi.device.resources.texture_tables import TextureTable, create_table
from rhi.device.resources.textures import Sampler, Texture
from rhi.device.transient import TransientMemory
from rhi.errors import rules
from rhi.errors.arguments import ArgumentChecker, little_endian, to_integer
from rhi.shading import Precision, Shader, Struct
from rhi.shading.language.bindings import TextureBinding
from rhi.shading.language.shader import list_bindings

LOGGER: Final = logging.getLogger("rhi.device")
SLOW_WAIT: Final = 0.25
"""A frame is slow if the CPU waits longer than this for the device, in seconds (`_log_precision`)."""
FRAMES_BEFORE_PRECISION_LOG: Final = 3
"""Number of slow frames before `_log_precision` warns. In the first ones a driver may build kernels."""

P = ParamSpec("P")
S = TypeVar("S", bound=Struct)
T = TypeVar("T")
B = TypeVar("B")
F = TypeVar("F", bound=Callable[..., Any])


def _creates(method: F) -> F:
    """Decorate a method to create all of its resources or, if it is refused, fails or is interrupted, none
    (`Creation`)."""

    @wraps(method)
    def create(self: Device, /, *arguments: Any, **named: Any) -> Any:
        with self._core.creation():
            return method(self, *arguments, **named)

    return cast("F", create)


class Device(Encoder):
    """A device, created by `rhi.create_device`. Use it in a `with` block, or call `close`."""

    def __init__(
        self,
        backend: Backend,
        *,
        validation: bool = False,
        timing: bool = False,
        frames_in_flight: int = 2,
        precision: Precision = Precision.EXACT,
    ) -> None:
        """Create a device on `backend`, which may be a `Recorder` in front of another backend.

        It belongs to the calling thread. With `validation` each draw checks this, too.
        """
        capabilities = backend.capabilities
        self._backend = backend
        refusals = RefusalLog(backend)
        states = StateCache(capabilities, refusals=refusals)
        core = (ValidatingCore if validation else Core)(backend, states, refusals)
        super().__init__(core, Timers(core, timing and capabilities.timestamps), TransientMemory(core))
        self._programs = ProgramTable(core.timeline, precision)
        self._frames_until_precision_log = FRAMES_BEFORE_PRECISION_LOG
        self._frames: deque[int] = deque()
        self._frames_in_flight = frames_in_flight
        core.scopes.records_lines = validation

    # -- life --------------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        """Close the device at the end of the block. A device without a thread first becomes this thread's
        (`make_current`)."""
        if self._core.thread == NO_THREAD:
            self.make_current()
        self._core.check_open()
        self._core.check_thread()
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.close(quiet=kind is not None)

    def close(self, *, quiet: bool = False) -> None:
        """Release the device and all of its resources; a second call does nothing.

        Raises:
            ValidationError: `scope-open` inside a scope, `lock-open` if a lock was never released; the device
                is closed nevertheless. Neither is raised if `quiet`, nor while an exception is being handled,
                which it would hide. `device-thread` on another thread; the device stays open.
        """
        core = self._core
        quiet = ArgumentChecker("device.close", core.refuse).flag("quiet", quiet)
        if core.closed or core.thread == FORKED:  # then it is the parent's
            return
        if core.thread == NO_THREAD:
            core.make_current()
        core.check_thread("device.close")
        core.resume()
        core.closed = True
        core.program = None
        core.scopes.end_unreferenced()
        surrounding = core.scopes.describe_open()
        core.scopes.close()
        self._backend.close()
        core.timeline.memory.clear()
        if quiet or sys.exc_info()[0] is not None:
            return
        if surrounding:
            core.refuse(rules.SCOPE_OPEN, "device.close", f"a call inside {surrounding}", "no open scope")
        if core.locked:
            names = ", ".join(repr(owner) for owner in core.locked)
            core.refuse(
                rules.LOCK_OPEN, "device.close", f"open locks of {names}", "none", "lock in a `with` block"
            )

    def make_current(self) -> None:
        """Make the device ready for calls on this thread, after other code may have used the platform.

        - On OpenGL: makes the device's context current and sets all of its states anew, whatever other code
          did to them. Between passes the device finds out by itself that another context is current; inside a
          pass, call this after such code. See `python -m rhi docs threads`.
        - A device that no thread owns (`release_current`) belongs to the calling thread from now on.

        Raises:
            ValidationError: `device-thread` if the device belongs to another thread.
            DeviceError: `device-context` if the platform refuses, as OpenGL does while a context of GLX is
                current.
        """
        self._core.check_open()
        self._core.make_current()

    def release_current(self) -> None:
        """Detach the device from its thread, so that another thread can call `make_current`. Until then every
        call of the device is refused. On OpenGL no context is current on this thread afterwards, unless it
        was another's.

        Raises:
            ValidationError: `device-thread` on another thread than the device's, `pass-open` inside a render
                pass.
        """
        core = self._core
        core.check_open()
        core.check_thread("device.release_current")
        if core.render_pass is not None:
            core.refuse(rules.PASS_OPEN, "device.release_current", "an open render pass")
        core.release_current()

    @property
    def closed(self) -> bool:
        """True if the device was closed; then every other call is refused."""
        return self._core.closed

    @property
    def capabilities(self) -> Capabilities:
        """The device's features and limits."""
        return self._core.capabilities

    @property
    def precision(self) -> Precision:
        """The precision of shaders that don't state one, where the platform has a choice."""
        return self._programs.precision

    @property
    def backend_name(self) -> str:
        """The name of the backend: "gl", "null", …"""
        return self._core.capabilities.backend

    @property
    def statistics(self) -> Statistics:
        """A snapshot of the counters since creation or the last `reset_statistics`.

        Examples:
            >>> device.reset_statistics()
            >>> with device.render_pass(image), device.states(rhi.CullMode.NONE):
            ...     device.draw(program, mesh, tint=(1, 0, 0, 1))
            >>> device.statistics.software_state_changes
            1
        """
        core = self._core
        if get_ident() != core.thread:
            core.check_thread("device.statistics")
        return core.statistics()

    def memory(self) -> MemoryUse:
        """Return the memory of the buffers and textures on this device, in bytes by kind and label, and the
        peak; `print(device.memory())` shows it.

        These are the bytes of their elements and texels, the device's own rings included. What a driver adds for
        alignment, and what programs take, isn't known.

        Examples:
            >>> positions = device.buffer(256, np.float32, label="positions")
            >>> device.memory().labels["buffers", "positions"]
            1024
        """
        core = self._core
        core.check_ready()
        core.timeline.collect()
        return core.timeline.memory.report(self.backend_name, core.timeline.retired_bytes)

    def reset_statistics(self) -> None:
        """Set all counters to zero, and the peak of `memory` to what is in use."""
        self._core.check_thread("device.reset_statistics")
        self._core.reset_statistics()

    @property
    def stream(self) -> CommandStream:
        """The recorded commands.

        Raises:
            ValidationError: `device-not-recording` without a recorder.

        Examples:
            >>> device.stream.clear()
            >>> with device.render_pass(image):
            ...     device.draw(program, mesh, tint=(1, 0, 0, 1))
            >>> device.stream.draws()[0]["count"]
            3
        """
        if isinstance(self._backend, Recorder):
            return self._backend.stream
        self._core.refuse(
            rules.DEVICE_NOT_RECORDING, "device.stream", f"a {self.backend_name} device that doesn't record"
        )

    def backend_as(self, kind: type[B]) -> B:
        """Return the backend itself, for features that only it has; a recorder or other wrapper is skipped.

        Raises:
            ValidationError: `device-capability` if the backend is not a `kind`.

        Examples:
            >>> from rhi.backends.null import NullBackend
            >>> device.backend_as(NullBackend).statistics.dispatches
            0
        """
        if not isinstance(kind, type):
            ArgumentChecker("device.backend_as", self._core.refuse).fail(
                "kind", kind, "the class of a backend"
            )
        backend: object = self._backend
        while not isinstance(backend, kind) and hasattr(backend, "backend"):
            backend = backend.backend
        if isinstance(backend, kind):
            return backend
        self._core.refuse(
            rules.DEVICE_CAPABILITY,
            f"device.backend_as({kind.__name__})",
            type(backend).__name__,
            kind.__name__,
        )

    def __repr__(self) -> str:
        return f"Device({self.backend_name!r}, {self.capabilities.device!r})"

    # -- resources ---------------------------------------------------------------------------------------

    @_creates
    def buffer(
        self,
        source: int | NDArray[Any],
        dtype: np.dtype[Any] | type | str | None = None,
        *,
        usage: BufferUsage = BufferUsage.STATIC,
        label: str = "",
    ) -> Buffer:
        """Create a buffer: a number of zeroed elements of `dtype` (default: bytes), or a copy of an array.

        Numbers are little-endian on every device: an array of the other byte order is converted, and the
        buffer's dtype says so.

        Examples:
            >>> buffer = device.buffer(np.arange(4, dtype=np.float32), label="numbers")
            >>> buffer.read().tolist()
            [0.0, 1.0, 2.0, 3.0]
        """
        check = ArgumentChecker("device.buffer", self._core.refuse)
        if usage is BufferUsage.READBACK:
            check.fail("usage", usage, "STATIC or STREAM", "use read_async")
        requested = None
        if dtype is not None:
            try:  # NumPy takes the dtype of any object that has one
                kinds: Any = (np.dtype, type, str, list, tuple, dict)
                requested = little_endian(np.dtype(check.instance("dtype", dtype, kinds, "a NumPy dtype")))
            except (TypeError, ValueError) as error:
                self._core.refuse(
                    rules.BUFFER_DTYPE, check.call, f"dtype={dtype!r}", f"a NumPy dtype ({error})"
                )
        count = to_integer(source)
        if count is not None:
            return Buffer(self._core, count, requested or np.dtype(np.uint8), usage, label)
        array = check.array("source", source)
        if not array.ndim and array.dtype.names is None:
            check.fail("source", source, "a number of elements, or an array")
        if requested is not None and array.dtype != requested:
            repacked = repack(requested, array)
            if repacked is None:
                tip = f"array.astype(np.{requested.name}) converts it" if not requested.names else ""
                self._core.refuse(rules.BUFFER_DTYPE, check.call, str(array.dtype), str(requested), tip)
            array = repacked
        return Buffer(self._core, array.size, array.dtype, usage, label, array)

    @overload
    def uniform(self, value: NDArray[Any], *, label: str = "") -> UniformBuffer[Any]: ...

    @overload
    def uniform(self, value: T, *, label: str = "") -> UniformBuffer[T]: ...

    @_creates
    def uniform(self, value: Any, *, label: str = "") -> UniformBuffer[Any]:
        """Create a buffer of constants, bound as `Uniform[T]`: a struct, or a single number, vector or
        matrix.

        The value says what it is bound as: `uniform(0.5)` as `Uniform[float]`, `uniform(1)` as
        `Uniform[int]`, an array of 4×4 floats as `Uniform[mat4]`, one of 3 floats as `Uniform[vec3]`.

        Examples:
            >>> tint = device.uniform(np.array([1.0, 0.0, 0.0, 1.0]))
            >>> with device.render_pass(image):
            ...     device.draw(program, mesh, tint=tint)
        """
        return UniformBuffer(self._core, value, label)

    @_creates
    def uniform_array(self, struct: type[S], count: int, *, label: str = "") -> UniformArray[S]:
        """Create constants for `count` objects, written as one array and bound one by one as `array[i]`.

        Examples:
            >>> tints = device.uniform_array(Tint, 2)
            >>> rows = np.zeros(2, tints.dtype)
            >>> rows["color"] = (1, 0, 0, 1), (0, 1, 0, 1)
            >>> tints.write(rows)  # then pass tints[0] and tints[1] to draws
        """
        return UniformArray(self._core, struct, count, label)

    @_creates
    def storage(
        self, element: type[T], source: int | ArrayLike | Buffer, *, label: str = ""
    ) -> StorageBuffer[T]:
        """Create an array for `Storage[T]` and `StorageRW[T]`: a number of zeroed elements, a copy of an
        array, or a view of a buffer. An array of vectors of three components may be (n, 3): memory has a
        fourth, which is 0.

        Raises:
            ValidationError: `layout-mismatch` if the array's dtype is not a struct's std430 dtype, or if
                numbers don't
                fit: whole ones are never rounded, floats never become whole.

        Examples:
            >>> numbers = device.storage(float, np.arange(100, dtype=np.float32))
            >>> len(numbers)
            100
        """
        core = self._core
        check = ArgumentChecker("device.storage", core.refuse)
        dtype = storage_dtype(check, element)
        check.text("label", label)
        if isinstance(source, Buffer):
            core.check_open()
            core.check_usable(source, check.call)
            if source.size < dtype.itemsize:
                core.refuse(rules.BUFFER_SIZE, check.call, f"{source!r}", f"at least {dtype.itemsize} bytes")
            return StorageBuffer(source, element, dtype)
        count, array = to_integer(source), None
        if count is None:
            array = match_layout(core, check.array("source", source), dtype, check.call, element)
            if not array.ndim and array.dtype.names is None:
                check.fail("source", source, "a number of elements, an array, or a Buffer")
            count = array.size // int(np.prod(dtype.shape, initial=1))
        name = label or f"{getattr(element, '__name__', element)}[]"
        return StorageBuffer(Buffer(core, count, dtype, label=name, data=array), element, dtype)

    @_creates
    def texture(
        self,
        source: tuple[int, int] | NDArray[Any] | ImageLike,
        format: Format | CompressedFormat | None = None,
        *,
        kind: TextureKind = TextureKind.D2,
        layers: int | None = None,
        levels: int | None = 1,
        samples: int = 1,
        label: str = "",
    ) -> Texture:
        """Create a texture: zeroed, of (width, height), or with the texels of an array.

        An array is (height, width, channels), (height, width) for one channel, or (layers, height, width,
        channels), top row first, of the format's dtype; alpha may be missing, and float64 becomes the
        format's floats, see `Texture.write`. A volume of one channel may be (depth, height, width), and so may
        layers; the depth isn't 1 to 4 then, or the format is named. `levels`
        None means all mip levels down to 1×1; they are generated from an array's texels if the format can be
        filtered. Images of Pillow are arrays, too.

        The format None follows from an array's dtype and channels: uint8 becomes `R8`, `RG8` or `RGBA8`,
        uint16 `R16` to `RGBA16`, float16 and float32 `R16F` to `RGBA32F`, uint32 and int32 `R32UI` to
        `RGBA32I`. Colors that are lit need `RGBA8_SRGB`, by name.

        An array for a compressed format is (rows, columns, bytes), or with layers in front: blocks of 4×4
        texels. A device that lacks the format (`capabilities.compressed_formats`) gets them decoded, in 2 to
        8 times the memory.

        Examples:
            >>> target = device.texture((64, 48), rhi.Format.RGBA16F, label="hdr")
            >>> albedo = device.texture(np.zeros((32, 32, 4), np.uint8), rhi.Format.RGBA8_SRGB, levels=None)
            >>> albedo.levels
            6
        """
        check = ArgumentChecker("device.texture", self._core.refuse)
        if not isinstance(source, (tuple, list, np.ndarray)) and hasattr(source, "__array_interface__"):
            source = as_texels(source)
        if isinstance(source, np.ndarray):
            source = check.array("source", source)
        has_layers = kind is not TextureKind.D2
        if format is None and isinstance(source, np.ndarray):
            format = infer_format(source, has_layers)
            if format is None:
                given = f"shape {source.shape} of {source.dtype}"
                allowed = "1 to 4 channels of uint8, uint16, float16, float32, uint32 or int32, or a format"
                tip = tip_for_texels(source, None, has_layers)
                self._core.refuse(rules.TEXTURE_DATA, "device.texture", given, allowed, tip)
        compressed = format if isinstance(format, CompressedFormat) else None
        format = compressed.decoded if compressed is not None else check.choice("format", format, Format)
        check.choice("kind", kind, TextureKind)
        layers = check.integer_or_none("layers", layers)
        levels = check.integer_or_none("levels", levels)
        samples = check.integer("samples", samples)
        check.text("label", label)
        data = None
        if isinstance(source, np.ndarray):
            data = (
                source if compressed is not None else add_channel_axis(source, format.components, has_layers)
            )
            plain = compressed is None and format.components == 1
            if data.ndim not in (2, 3, 4) or (data.ndim == 2) > plain:
                allowed = "(height, width, channels), or with layers in front"
                self._core.refuse(rules.TEXTURE_DATA, "device.texture", f"shape {data.shape}", allowed)
            height, width = data.shape[1:3] if data.ndim == 4 else data.shape[:2]
            if compressed is not None:
                height, width = BLOCK * height, BLOCK * width
            layers = (data.shape[0] if data.ndim == 4 else 1) if layers is None else layers
        else:
            size = tuple(to_integer(n) for n in source) if isinstance(source, (tuple, list)) else ()
            if len(size) != 2 or None in size:
                self._core.refuse(
                    rules.TEXTURE_SIZE,
                    "device.texture",
                    repr(source),
                    "(width, height), two whole numbers, or an array",
                )
            width, height = cast("tuple[int, int]", size)
        if layers is None:
            layers = 6 if kind is TextureKind.CUBE else 1
        if levels is None:
            levels = full_levels(width, height, layers if kind is TextureKind.D3 else 1)
        descriptor = TextureDescriptor((width, height), format, kind, layers, levels, samples, label)
        texture = Texture(self._core, descriptor, compressed)
        if data is not None:
            texture.write(data)
            if levels > 1 and not format.is_integer and compressed is None:
                texture.generate_mipmaps()
        return texture

    @_creates
    def texture_table(
        self,
        images: Sequence[Texture | TextureBinding | NDArray[Any] | ImageLike | tuple[int, int]],
        format: Format | None = None,
        *,
        samplers: Sampler | SamplerDescriptor | Sequence[Sampler | SamplerDescriptor] | None = None,
        levels: int | None = None,
        label: str = "",
    ) -> TextureTable:
        """Create a table of 2D images of different sizes, which a shader reads by their numbers in one draw:
        `images: sl.TextureTable`, `self.images[index].sample(uv)`.

        Each image keeps its own size, mip levels, and wrap modes; a table takes about as much memory as its
        images. All have one format of colors. The images are copied: later changes of a source don't change
        the table, `copy_from` does.

        Args:
            images: arrays and images of Pillow as for `texture`, or 2D textures with their levels. One that is
                bound with a sampler (`texture.sampled(…)`) is read through that. A (width, height) makes room
                for an image, zeroed, for `copy_from`.
            format: None follows from the first image.
            samplers: how images are read: one for all, or one for each; None for the default sampler. The
                device needs no capability for anisotropy and borders; samplers that compare are refused.
            levels: the mip levels of arrays, which are generated; None for all down to 1×1.
            label: the table's name in messages and tools.

        Raises:
            ValidationError: `texture-size` for images that are larger than a page, or too many of them;
                `texture-format` for integers, depth, compressed textures, and formats that differ;
                `device-capability` for a format that the device can't filter.

        Examples:
            >>> images = [np.zeros((height, width, 4), np.uint8) for width, height in ((30, 20), (5, 9))]
            >>> device.texture_table(images, rhi.Format.RGBA8).sizes
            ((30, 20), (5, 9))
        """
        return create_table(
            self._core,
            images,
            format,
            samplers,
            levels,
            label,
            make_texture=self.texture,
        )

    @_creates
    def adopt_texture(self, native: Any, *, label: str = "") -> Texture:
        """Adopt a texture that other code has created: the device reads it and draws to it, the other code
        still owns it.

        Both use the same memory. The other code's device must be the one that this device was created beside
        (`rhi.create_device("gl", context=…)`).

        Args:
            native: OpenGL's name of the texture, or an object with the name in `glo`, such as moderngl's
                textures.

        Raises:
            ValidationError: `device-capability` if this device stands alone, `device-argument` if `native` is
                no texture of a known format.
        """
        check = ArgumentChecker("device.adopt_texture", self._core.refuse)
        sharing = self._core.require_texture_sharing(check.call)
        name = check.integer("native", getattr(native, "glo", native), 1, (1 << 32) - 1)
        check.text("label", label)
        descriptor = sharing.describe_texture(name)
        if isinstance(descriptor, str):
            check.fail("native", descriptor, "a texture with one sample, of a format of rhi.Format")
        with sharing.adopting_texture(name):
            return Texture(self._core, replace(descriptor, label=label))

    def native_texture(self, texture: Texture) -> int:
        """Return OpenGL's name of a texture, for the code that this device was created beside.

        Its first row is the top one. It may be used after `device.present`, until the texture is destroyed.
        """
        check = ArgumentChecker("device.native_texture", self._core.refuse)
        sharing = self._core.require_texture_sharing(check.call)
        check.instance("texture", texture, Texture, "a Texture")
        self._core.check_usable(texture, check.call)
        return sharing.name_texture(texture.id)

    def sampler(self, descriptor: SamplerDescriptor) -> Sampler:
        """Create a sampler, to read textures through: `texture.sampled(sampler)`.

        Examples:
            >>> nearest = device.sampler(rhi.SamplerDescriptor(rhi.Filter.NEAREST, rhi.Filter.NEAREST))
            >>> binding = image.sampled(nearest)
        """
        self._core.check_open()
        check = ArgumentChecker("device.sampler", self._core.refuse)
        check.instance("descriptor", descriptor, SamplerDescriptor, "an rhi.SamplerDescriptor")
        return Sampler(self._core.sampler(descriptor), descriptor)

    @_creates
    def mesh(
        self,
        vertices: VertexSource | int,
        indices: ArrayLike | Buffer | None = None,
        *,
        instances: VertexSource | None = None,
        primitive: Primitive = Primitive.TRIANGLES,
        label: str = "",
    ) -> Mesh:
        """Create a mesh: vertices, and optionally indices and per-instance data.

        Args:
            vertices: a structured array, a dict of arrays by attribute name, a buffer with a structured
                dtype, or a number of vertices without attributes.
            indices: integers into `vertices`; the largest uint16 or uint32 restarts a
                strip, a fan or quads.
            instances: as for `vertices`, with one element per instance.

        Raises:
            ValidationError: `mesh-data` (not structured, empty, NaN), `mesh-index` (out of range).

        Examples:
            >>> corners = {"position": np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)}
            >>> device.mesh(corners, np.array([0, 1, 2, 0, 2, 3], np.uint16)).count
            6
        """
        check = ArgumentChecker("device.mesh", self._core.refuse)
        check.choice("primitive", primitive, Primitive)
        check.text("label", label)
        data = MeshData(self._core, vertices, indices, instances, label)
        return Mesh(data, primitive, 0, data.element_count)

    @overload
    def program(self, shader: Callable[P, Shader]) -> Program[P]: ...

    @overload
    def program(self, shader: ProgramDescriptor) -> Program[...]: ...

    def program(self, shader: Any) -> Program[...]:
        """Create the program of a shader class or of a native program's descriptor; equal arguments share
        one.

        Raises:
            ShaderError: the shader does not type-check, or the driver refuses it.

        Examples:
            >>> device.program(Flat) is device.program(Flat)
            True
        """
        self._core.check_open()
        if not isinstance(shader, ProgramDescriptor) and not (
            isinstance(shader, type) and issubclass(shader, Shader)
        ):
            ArgumentChecker("device.program", self._core.refuse).fail(
                "shader", shader, "a class derived from Shader, or a ProgramDescriptor"
            )
        program = self._programs.find(shader)
        return self._create_program(shader) if program is None else program

    @_creates
    def _create_program(self, shader: Any) -> Program[...]:
        if isinstance(shader, ProgramDescriptor):
            program: Program[...] = Program(self._core, self._transient.uniforms, shader)
        else:
            with self._core.refusals:
                descriptor = self._programs.compile(shader)
            program = Program(self._core, self._transient.uniforms, descriptor, list_bindings(shader))
        self._programs.add(shader, program)
        return program

    # -- work --------------------------------------------------------------------------------------------

    def _draw(self, program: Program[...], mesh: Drawable, instances: int = 1, /, **bindings: Any) -> None:
        """Draw `mesh` with `program`; see `Encoder.draw`."""
        if program.__class__ is not Program or program.core is not self._core:
            self._resolve_program(program, "device.draw")
        program.draw_with(mesh, instances, bindings)

    if not TYPE_CHECKING:
        draw = _draw  # typed by `Encoder.draw`; its *args, always empty, would cost 80 ns a call

    @overload
    def prepare(
        self,
        program: Program[...],
        mesh: Mesh | None = None,
        *,
        targets: Sequence[Texture | Format] = (),
        states: Sequence[State] = (),
    ) -> Preparation: ...

    @overload
    def prepare(self, program: Sequence[DrawPlan]) -> Preparation: ...

    def prepare(
        self,
        program: Any,
        mesh: Mesh | None = None,
        *,
        targets: Sequence[Texture | Format] = (),
        states: Sequence[State] = (),
    ) -> Preparation:
        """Begin to compile the platform's code for draws and dispatches, so that no frame waits for it or
        runs slower.

        Args:
            program: the program, or a list of `DrawPlan`s, which replace all arguments.
            mesh: a mesh with the vertex layout of the later draws.
            targets: the targets of the later draws, or their formats.
            states: the states of the later draws, on top of the scopes that are open now.

        Returns:
            A future with `progress`; `result()` waits. Draws needn't wait for it.

        Raises:
            ValidationError: as the draw would; nothing was begun then.

        Examples:
            >>> prepared = device.prepare(program, mesh, targets=[rhi.Format.RGBA8])
            >>> prepared.result()
        """
        plans = [DrawPlan(program, mesh, targets, states)] if isinstance(program, Program) else program
        self._core.check_ready()
        check = ArgumentChecker("device.prepare", self._core.refuse)
        allowed = "a Program from device.program(…), or a list of rhi.DrawPlan"
        return prepare(self._core, check.instance("program", plans, (list, tuple), allowed))

    @property
    def is_building(self) -> bool:
        """True if the platform is compiling code in the background. Until then draws and dispatches are
        slower, and measured times aren't representative."""
        return bool(getattr(self._core.backend, "is_building", False))

    def record(self, *, label: str = "") -> CommandBuffer:
        """Create a command buffer: `with device.record() as commands:` records commands, `submit` executes
        them.

        It records passes, states, draws, dispatches and so on with the methods of a device, on any thread,
        one thread per buffer. `label` is put on all of its commands.

        Examples:
            >>> with device.record(label="background") as commands:
            ...     with commands.render_pass(image, clear=(0, 0, 0, 1)):
            ...         commands.draw(program, mesh, tint=(1, 0, 0, 1))
            >>> device.submit(commands)
        """
        self._core.check_open()
        ArgumentChecker("device.record", self._core.refuse).text("label", label)
        return CommandBuffer(self._core, label)

    def submit(self, *buffers: CommandBuffer) -> None:
        """Execute command buffers, in order, on the device's own thread; they may be submitted any number of
        times.

        Buffers and textures are read as they are at that time. The device's state scopes don't apply to the
        commands inside, nor the other way round.

        It may lie inside events and conditions, which then apply to the commands, but not inside a pass.

        Raises:
            ValidationError: `record-state` for an incomplete command buffer, `resource-destroyed` for one
                that uses a destroyed resource, `lock-open`, `query-state`, `pass-open` inside a render pass,
                `condition-nested` for a condition inside another; nothing was executed then.
        """
        core = self._core
        if core.closed or core._context is not None or get_ident() != core.thread:  # seldom
            core.check_ready()
        if core.render_pass is not None and core.has_open_pass():
            core.refuse(rules.PASS_OPEN, "device.submit", "an open render pass")
        check_submissions(buffers, core)
        for buffer in buffers:
            buffer.execute()

    # -- time --------------------------------------------------------------------------------------------

    def signal(self) -> int:
        """Signal the fence at this point of the command stream; return the value to `wait` for.

        Examples:
            >>> value = device.signal()
            >>> device.wait(value)
            True
            >>> device.completed >= value
            True
        """
        self._core.check_ready()
        return self._core.signal()

    @property
    def completed(self) -> int:
        """The last signalled value that the GPU has reached; never blocks."""
        self._core.check_ready()
        return self._core.timeline.completed

    def wait(self, value: int, seconds: float | None = None) -> bool:
        """Block until the GPU has reached `value`, for at most `seconds`; return whether it has."""
        self._core.check_ready()
        check = ArgumentChecker("device.wait", self._core.refuse)
        value = check.integer("value", value)
        if seconds is not None:
            seconds = check.number("seconds", seconds, 0)
        reached = self._core.timeline.wait(value, seconds)
        self._core.timeline.collect()
        return reached

    def finish(self) -> None:
        """Block until the GPU has executed everything submitted."""
        self.wait(self.signal())
        self._timers.collect()

    def capture(self, path: str | Path | None = None) -> FrameCapture:
        """Create a block that RenderDoc captures: `with device.capture() as capture:` around one or several
        frames; `capture.file` is what it has written.

        RenderDoc must be loaded into the process: `renderdoccmd capture python app.py`. If it isn't, nothing is
        captured, and a warning is logged once a block. It captures OpenGL and Vulkan, so gl and wgpu; traces
        (`rhi.trace.save`) capture any backend.

        Args:
            path: the beginning of the file's name, to which RenderDoc adds the frame and ".rdc"; None: where
                RenderDoc is set to write.
        """
        check = ArgumentChecker("device.capture", self._core.refuse)
        if path is not None:
            check.instance("path", path, (str, Path), "a str or a Path")
        self._core.check_ready()
        return FrameCapture(self._core, None if path is None else Path(path))

    def finish_async(self) -> Awaitable[None]:
        """Return an awaitable that is done once the GPU has executed everything submitted until now. Other
        tasks of asyncio run meanwhile: `await device.finish_async()`.

        In a page this waits where `finish` can't (the backend `web` without JSPI). Without asyncio's loop it
        blocks as `finish` does.
        """
        return _Completion(self, self.signal())

    @_creates
    def occlusion_query(self, *, emulated: bool = False) -> OcclusionQuery:
        """Create a counter of visible samples; `emulated` requests the thesis's emulation (4.4.2).

        Examples:
            >>> query = device.occlusion_query()
            >>> with device.render_pass(image), query:
            ...     device.draw(program, mesh, tint=(1, 1, 1, 1))
            >>> query.wait()  # of a device that draws: the samples
            100
        """
        check = ArgumentChecker("device.occlusion_query", self._core.refuse)
        return OcclusionQuery(self._core, check.flag("emulated", emulated))

    @_creates
    def query_set(self, size: int, *, emulated: bool = False) -> QuerySet:
        """Create `size` counters of visible samples, used together in one call: `device.draw_counted(…,
        queries)`.

        Examples:
            >>> queries = device.query_set(8)
            >>> with device.render_pass(image):
            ...     device.draw_counted(program, mesh, mesh.draws([0, 0], 3), queries, tint=(1, 1, 1, 1))
            >>> queries.wait()[:3].tolist()  # -1: not used
            [100, 100, -1]
        """
        check = ArgumentChecker("device.query_set", self._core.refuse)
        return QuerySet(
            self._core, check.integer("size", size, 0, MAX_QUERIES), check.flag("emulated", emulated)
        )

    @property
    def timing(self) -> bool:
        """True if events take timestamps."""
        return self._timers.enabled

    @timing.setter
    def timing(self, on: bool) -> None:
        self._core.check_thread("device.timing")
        on = ArgumentChecker("device.timing", self._core.refuse).flag("on", on)
        if on and not self._core.capabilities.timestamps:
            self._core.refuse(
                rules.DEVICE_CAPABILITY, "device.timing", "True", "needs capabilities.timestamps"
            )
        self._timers.enabled = on

    @property
    def timers(self) -> list[TimerNode]:
        """The event tree of the latest frame whose timestamps are available.

        Examples:
            >>> with rhi.create_device("null", timing=True) as timed:
            ...     with timed.event("frame"):
            ...         pass
            ...     timed.present()
            ...     timed.finish()
            ...     [node.name for node in timed.timers]
            ['frame']
        """
        if not self._core.closed:
            self._core.check_ready()
            self._timers.collect()
        return self._timers.latest

    def present(self, image: Texture | None = None) -> None:
        """End the frame and show `image`.

        Blocks only if the CPU is more than `frames_in_flight` frames ahead. Transient memory of the frame is
        reused once the GPU has executed the frame. A device that was created beside the context of other code
        shows the image in its window or framebuffer, and that context is current afterwards
        (`python -m rhi docs windows`).

        Raises:
            ValidationError: `pass-open` inside a render pass, `scope-open` inside any other scope, whose end
                would belong to another frame.

        Examples:
            >>> with device.render_pass(image, clear=(0, 0, 0, 1)):
            ...     device.draw(program, mesh, tint=(1, 0, 0, 1))
            >>> device.present(image)
        """
        core = self._core
        if core.closed or core._context is not None or get_ident() != core.thread:  # seldom
            core.check_ready()
        if core.render_pass is not None and core.has_open_pass():
            core.refuse(rules.PASS_OPEN, "device.present", "an open render pass")
        scopes = core.scopes
        if scopes._index or scopes._cut:  # seldom
            scopes.refuse_open("device.present")
        if image is not None:
            if image.__class__ is not Texture:
                ArgumentChecker("device.present", core.refuse).instance(
                    "image", image, Texture, "a Texture, or None"
                )
            if image.destroyed or image.core is not core or core.locked:  # seldom
                core.check_usable(image, "device.present")
        core.backend.present(image.id if image is not None else 0)
        self._timers.end_frame()
        self._frames.append(core.end_frame())
        if len(self._frames) > self._frames_in_flight:
            core.timeline.wait(self._frames.popleft())
            if core.timeline._retired:
                core.timeline.collect()
        if core._context is not None:
            core.hand_back()
        waited, core.timeline.waited = core.timeline.waited, 0.0
        if waited > SLOW_WAIT and self._frames_until_precision_log:
            self._log_precision(waited)

    def _log_precision(self, seconds: float) -> None:
        """Warn once, after some slow frames, which shaders would need fewer instructions with
        `Precision.FAST`. Only drawing the frame with both precisions shows how much faster they would be."""
        self._frames_until_precision_log -= 1
        shaders = [shader for shader, _ in self._programs.items() if isinstance(shader, type)]
        exact = {
            shader.__qualname__: names
            for shader in shaders
            if (names := self._programs.list_exact_functions(shader))
        }
        if exact and not self._frames_until_precision_log:
            function_names = "; ".join(f"{name} ({', '.join(names)})" for name, names in exact.items())
            LOGGER.warning(
                "the CPU waited %.2f s for the device in a frame. Shaders that compute with Precision.EXACT "
                "what FAST "
                "computes with fewer instructions: %s. RHI_PRECISION=fast shows what that saves",
                seconds,
                function_names,
            )


class _Completion:
    """Awaits a value of a device's fence."""

    __slots__ = ("_device", "_value")

    def __init__(self, device: Device, value: int) -> None:
        self._device = device
        self._value = value

    def __await__(self) -> Generator[Any]:
        yield from pause_until(lambda: self._device.completed >= self._value)
        self._device.wait(self._value)
        self._device._timers.collect()
