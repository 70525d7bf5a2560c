"""What users hold: the platform-independent half of the interface (the thesis's modified PIMPL, 3.6.3).

- `Device` makes resources, opens passes and scopes, draws, and keeps time. It is the only place with policy:
  when resources are freed, how far the CPU may run ahead, how large rings are.
- The other half is a `Backend`; commands are calls of its methods. Whatever is refused is refused here,
  before the backend hears of it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar, overload

import numpy as np
from numpy.typing import NDArray
from typing_extensions import ParamSpec

from rhi.commands.recorder import Recorder
from rhi.commands.stream import CommandStream
from rhi.contract.backend import Backend, Capabilities
from rhi.contract.descriptors import (
    BufferUsage,
    Primitive,
    ProgramDescriptor,
    SamplerDescriptor,
    TextureDescriptor,
    TextureKind,
)
from rhi.contract.formats import Format
from rhi.contract.layout import Layout, element_dtype
from rhi.contract.states import (
    AlphaFunction,
    AlphaReference,
    AlphaTest,
    AlphaToCoverage,
    BlendFunction,
    PolygonOffset,
    StencilTest,
)
from rhi.device.command_buffer import CommandBuffer, check_submissions
from rhi.device.core.core import Core, Statistics
from rhi.device.core.state_cache import StateCache
from rhi.device.encoder import Encoder
from rhi.device.queries.occlusion import OcclusionQuery
from rhi.device.queries.sets import QuerySet
from rhi.device.queries.timers import TimerNode, Timers
from rhi.device.refusals import RefusalLog
from rhi.device.resources.buffers import Buffer, StorageBuffer, UniformArray, UniformBuffer, match_layout
from rhi.device.resources.lifetime import kept_if_filled
from rhi.device.resources.meshes import Mesh, MeshData, VertexSource
from rhi.device.resources.programs import Program
from rhi.device.resources.textures import Sampler, Texture, full_levels
from rhi.device.transient import TransientMemory
from rhi.errors import listen, refuse
from rhi.errors.rules import (
    BUFFER_DTYPE,
    DEVICE_ARGUMENT,
    DEVICE_CAPABILITY,
    DEVICE_NOT_RECORDING,
    LOCK_OPEN,
    PASS_OPEN,
    RESOURCE_FOREIGN,
    TEXTURE_DATA,
    TEXTURE_SIZE,
)
from rhi.shading import Shader, Struct, compile_shader, value_type_of

__rhi_internal__ = True

P = ParamSpec("P")
S = TypeVar("S", bound=Struct)
T = TypeVar("T")
B = TypeVar("B")


class Device(Encoder):
    """One device. `rhi.create_device` makes it; use it in a `with` block, or call `close`."""

    def __init__(self, backend: Backend, *, timing: bool = False, frames_in_flight: int = 2) -> None:
        """`backend` may be a `Recorder` in front of another."""
        capabilities = backend.capabilities
        self._backend = backend
        core = Core(backend, StateCache(_unsupported_states(capabilities)))
        super().__init__(core, Timers(core, timing and capabilities.timestamps), TransientMemory(core))
        self._programs: dict[object, Program[Any]] = {}
        self._refusals = RefusalLog(core, backend) if isinstance(backend, Recorder) else None
        if self._refusals is not None:
            listen(self._refusals)
        self._frames: deque[int] = deque()
        self._frames_in_flight = max(1, frames_in_flight)

    # -- life --------------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close(quiet=kind is not None)

    def close(self, *, quiet: bool = False) -> None:
        """Let go of the device and of everything made with it; a second call does nothing.

        Raises:
            ValidationError: `lock-open` when a lock was never released (unless `quiet`); the device is
                closed all the same.
        """
        core = self._core
        if core.closed:
            return
        core.closed = True
        core.program = None
        self._backend.close()
        if core.locked and not quiet:
            shown = ", ".join(repr(owner) for owner in core.locked)
            refuse(LOCK_OPEN, "device.close", f"open locks of {shown}", "none", "lock in a `with` block")

    @property
    def closed(self) -> bool:
        """Whether `close` was called; nothing else can be, then."""
        return self._core.closed

    @property
    def capabilities(self) -> Capabilities:
        """What the device can do, and its limits."""
        return self._core.capabilities

    @property
    def backend_name(self) -> str:
        """The backend's name: "gl", "null"…"""
        return self._core.capabilities.backend

    @property
    def statistics(self) -> Statistics:
        """Counters since creation or `reset_statistics`: a snapshot."""
        return self._core.statistics()

    def reset_statistics(self) -> None:
        """Count from zero again."""
        self._core.reset_statistics()

    @property
    def stream(self) -> CommandStream:
        """The recorded commands.

        Raises:
            ValidationError: `device-not-recording` without a recorder.
        """
        if isinstance(self._backend, Recorder):
            return self._backend.stream
        refuse(DEVICE_NOT_RECORDING, "device.stream", f"a {self.backend_name} device that doesn't record")

    def backend_as(self, kind: type[B]) -> B:
        """The backend itself, for what only it can do; also below a recorder or whatever else is in front of it.

        Raises:
            ValidationError: `device-capability` if it is another backend.
        """
        backend: object = self._backend
        while not isinstance(backend, kind) and hasattr(backend, "backend"):
            backend = backend.backend
        if isinstance(backend, kind):
            return backend
        refuse(
            DEVICE_CAPABILITY, f"device.backend_as({kind.__name__})", type(backend).__name__, kind.__name__
        )

    def __repr__(self) -> str:
        return f"Device({self.backend_name!r}, {self.capabilities.device!r})"

    # -- resources ---------------------------------------------------------------------------------------

    def buffer(
        self,
        source: int | NDArray[Any],
        dtype: np.dtype[Any] | type | str | None = None,
        *,
        usage: BufferUsage = BufferUsage.STATIC,
        label: str = "",
    ) -> Buffer:
        """Memory on the device: a number of elements of `dtype` (default: bytes), zeroed, or an array's copy."""
        if isinstance(source, (int, np.integer)):
            return Buffer(self._core, int(source), np.dtype(dtype or np.uint8), usage, label)
        array = np.asarray(source)
        if dtype is not None and array.dtype != np.dtype(dtype):
            refuse(BUFFER_DTYPE, "device.buffer", str(array.dtype), str(np.dtype(dtype)))
        buffer = Buffer(self._core, array.size, array.dtype, usage, label)
        with kept_if_filled(buffer):
            buffer.write(array)
        return buffer

    def uniform(self, value: S, *, label: str = "") -> UniformBuffer[S]:
        """Constants: one struct, bound as `Uniform[S]`."""
        if not isinstance(value, Struct):
            refuse(
                DEVICE_ARGUMENT, "device.uniform", repr(value), "a Struct's value, e.g. Tint(scale=(1, 1, 1))"
            )
        return UniformBuffer(self._core, value, label)

    def uniform_array(self, struct: type[S], count: int, *, label: str = "") -> UniformArray[S]:
        """Constants of `count` objects, written as one array, bound one by one as `array[i]`."""
        return UniformArray(self._core, struct, count, label)

    def storage(
        self, element: type[T], source: int | NDArray[Any] | Buffer, *, label: str = ""
    ) -> StorageBuffer[T]:
        """An array for `Storage[T]` and `StorageRW[T]`: a number of zeroed elements, an array's copy, or a
        view of a buffer.

        Raises:
            ValidationError: `layout-mismatch` when the array isn't of the element's std430 dtype.
        """
        shading_type = value_type_of(element)
        dtype = element_dtype(shading_type, Layout.STD430)
        if isinstance(source, Buffer):
            if source.core is not self._core:
                refuse(RESOURCE_FOREIGN, "device.storage", repr(source))
            return StorageBuffer(source, element, dtype)
        count = int(source) if isinstance(source, (int, np.integer)) else 0
        name = label or f"{getattr(element, '__name__', element)}[]"
        if not isinstance(source, (int, np.integer)):
            array = match_layout(source, dtype, "device.storage")
            count = array.size // int(np.prod(dtype.shape, initial=1))
        storage: StorageBuffer[T] = StorageBuffer(
            Buffer(self._core, count, dtype, label=name), element, dtype
        )
        if not isinstance(source, (int, np.integer)):
            with kept_if_filled(storage):
                storage.write(array)
        return storage

    def texture(
        self,
        source: tuple[int, int] | NDArray[Any],
        format: Format,
        *,
        kind: TextureKind = TextureKind.D2,
        layers: int | None = None,
        levels: int | None = 1,
        samples: int = 1,
        label: str = "",
    ) -> Texture:
        """A texture of (width, height), zeroed, or of an array's texels.

        An array is (height, width, channels), (height, width) for one channel, or (layers, height, width,
        channels), top row first, of the format's dtype. `levels` None means all down to 1×1; they are
        filled from an array's texels if the format can be filtered.
        """
        if not isinstance(format, Format):
            refuse(DEVICE_ARGUMENT, "device.texture", f"format={format!r}", "a rhi.Format, such as Format.RGBA8")
        data = None
        if isinstance(source, np.ndarray):
            data = source
            if data.ndim not in (2, 3, 4) or (data.ndim == 2) > (format.channels == 1):
                refuse(TEXTURE_DATA, "device.texture", f"shape {data.shape}", "(height, width, channels), or with "
                       "layers in front")  # fmt: skip
            height, width = data.shape[1:3] if data.ndim == 4 else data.shape[:2]
            layers = (data.shape[0] if data.ndim == 4 else 1) if layers is None else layers
        else:
            if len(source) != 2 or not all(isinstance(n, (int, np.integer)) for n in source):
                refuse(TEXTURE_SIZE, "device.texture", repr(source), "(width, height), two whole numbers")
            width, height = source
        if layers is None:
            layers = 6 if kind is TextureKind.CUBE else 1
        if levels is None:
            levels = full_levels(width, height, layers if kind is TextureKind.D3 else 1)
        descriptor = TextureDescriptor(
            (int(width), int(height)), format, kind, layers, levels, samples, label
        )
        texture = Texture(self._core, descriptor)
        if data is not None:
            with kept_if_filled(texture):
                texture.write(data)
                if levels > 1 and not format.is_integer:
                    texture.generate_mipmaps()
        return texture

    def sampler(self, descriptor: SamplerDescriptor) -> Sampler:
        """How textures are read: `texture.sampled(sampler)`."""
        self._core.check_open()
        return Sampler(self._core.sampler(descriptor), descriptor)

    def mesh(
        self,
        vertices: VertexSource | int,
        indices: NDArray[Any] | Buffer | None = None,
        *,
        instances: VertexSource | None = None,
        primitive: Primitive = Primitive.TRIANGLES,
        label: str = "",
    ) -> Mesh:
        """Vertices, and optionally indices and per-instance data, that draws read.

        Args:
            vertices: a structured array, a dict of arrays by attribute name, a buffer with a structured
                dtype, or a number of vertices without attributes.
            indices: integers into `vertices`; the largest uint16 or uint32 restarts a strip.
            instances: as `vertices`, one element per instance.

        Raises:
            ValidationError: `mesh-data` (not structured, empty, NaN), `mesh-index` (out of range).
        """
        data = MeshData(self._core, vertices, indices, instances, label)
        return Mesh(data, primitive, 0, data.vertex_count if data.index_count is None else data.index_count)

    @overload
    def program(self, shader: Callable[P, Shader]) -> Program[P]: ...

    @overload
    def program(self, shader: ProgramDescriptor) -> Program[...]: ...

    def program(self, shader: Any) -> Program[Any]:
        """A shader class (or a native program's descriptor) on the device; the same for the same class.

        Raises:
            ShaderError: it doesn't type-check, or the driver refuses it.
        """
        self._core.check_open()
        program = self._programs.get(shader)
        if program is None or program.destroyed:
            descriptor = shader if isinstance(shader, ProgramDescriptor) else compile_shader(shader)
            program = self._programs[shader] = Program(self._core, descriptor)
        return program

    # -- work --------------------------------------------------------------------------------------------

    if not TYPE_CHECKING:
        # Without *args, which cost 80 ns; there are none, a type checker only wants them named.
        def draw(self, program, mesh, instances=1, /, **bindings):
            """Draw `mesh` with `program`; a value for each of the program's bindings by name.

            Raises:
                ValidationError: `draw-outside-pass`, `binding-*`, `mesh-attribute`, `resource-destroyed`,
                    `lock-open`, `pass-feedback`; nothing was drawn or bound then.
            """
            try:
                if program.core is not self._core:
                    self._own(program, "device.draw")
                program.draw_with(mesh, instances, bindings)
            except AttributeError:
                self._own(program, "device.draw")
                raise

    def record(self, *, label: str = "") -> CommandBuffer:
        """`with device.record() as commands:` commands that are written down now and carried out by `submit`.

        It takes what a device takes (passes, states, draws, dispatches, …), on any thread, one thread a buffer.
        `label` lies on all of its commands.
        """
        self._core.check_open()
        return CommandBuffer(self._core, label)

    def submit(self, *buffers: CommandBuffer) -> None:
        """Carry out command buffers, in order, on the device's own thread; as often as you like.

        What they read (buffers, textures) is what it is then. The device's state scopes don't reach into them,
        nor theirs out.

        Raises:
            ValidationError: `record-state` for one that isn't whole, `resource-destroyed` for one that uses what
                is gone, `lock-open`, `query-state`, `pass-open` inside a render pass, `condition-nested` for one with
                a condition inside another; nothing was carried out.
        """
        core = self._core
        core.check_open()
        if core.render_pass is not None:
            refuse(PASS_OPEN, "device.submit", "an open render pass")
        check_submissions(buffers, core, self._desk.conditional)
        for buffer in buffers:
            buffer.execute()

    # -- time --------------------------------------------------------------------------------------------

    def signal(self) -> int:
        """Mark this point of the command stream; the value to compare `completed` with or to `wait` for."""
        self._core.check_open()
        return self._core.signal()

    @property
    def completed(self) -> int:
        """The last signalled value that the GPU has reached; never waits."""
        self._core.check_open()
        return self._core.timeline.completed

    def wait(self, value: int, seconds: float | None = None) -> bool:
        """Block until the GPU has reached `value`, at most `seconds`; whether it has."""
        self._core.check_open()
        reached = self._core.timeline.wait(value, seconds)
        self._core.timeline.collect()
        return reached

    def finish(self) -> None:
        """Block until everything submitted is done."""
        self.wait(self.signal())
        self._timers.collect()

    def occlusion_query(self, *, emulated: bool = False) -> OcclusionQuery:
        """A counter of visible samples; `emulated` asks for the thesis's emulation (4.4.2) where it can be had."""
        return OcclusionQuery(self._core, self._desk, emulated)

    def query_set(self, size: int, *, emulated: bool = False) -> QuerySet:
        """So many counters of visible samples, to be asked in one call: `device.draw_counted(…, queries)`."""
        return QuerySet(self._core, size, emulated)

    @property
    def timing(self) -> bool:
        """Whether events take timestamps."""
        return self._timers.enabled

    @timing.setter
    def timing(self, on: bool) -> None:
        if on and not self._core.capabilities.timestamps:
            refuse(DEVICE_CAPABILITY, "device.timing", "True", "needs capabilities.timestamps")
        self._timers.enabled = on

    @property
    def timers(self) -> list[TimerNode]:
        """The events of the latest frame whose times are known."""
        if not self._core.closed:
            self._timers.collect()
        return self._timers.latest

    def present(self, image: Texture | None = None) -> None:
        """End the frame; `image` is what it shows.

        Waits only if the CPU is more than `frames_in_flight` frames ahead. Transient memory of the frame
        is free once the GPU is done with it.
        """
        core = self._core
        core.check_open()
        if core.render_pass is not None:
            refuse(PASS_OPEN, "device.present", "an open render pass")
        if image is not None:
            core.check_usable(image, "device.present")
        core.backend.present(image.id if image is not None else 0)
        self._timers.end_frame()
        self._frames.append(core.end_frame())
        if len(self._frames) > self._frames_in_flight:
            core.timeline.wait(self._frames.popleft())
            core.timeline.collect()


def _unsupported_states(capabilities: Capabilities) -> dict[type, str]:
    lacking: dict[type, str] = {}
    if not capabilities.alpha_test:
        lacking |= dict.fromkeys((AlphaTest, AlphaFunction, AlphaReference), "alpha_test")
    if not capabilities.stencil:
        lacking[StencilTest] = "stencil"
    if not capabilities.alpha_to_coverage:
        lacking[AlphaToCoverage] = "alpha_to_coverage"
    if not capabilities.blend_per_target:
        lacking[BlendFunction] = "blend_per_target"
    if not capabilities.depth_bias_clamp:
        lacking[PolygonOffset] = "depth_bias_clamp"
    return lacking
