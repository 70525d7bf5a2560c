"""A call of every public method, with what each of its parameters takes: laws about all calls are tested over
it.

- `SAMPLES` holds for each method a call that works and, for each parameter, the value of that call and a
  predicate: the values that the documentation allows. The test replaces one value at a time by every value of
  `WRONG`.
- Both follow from the parameter's annotation and default; `EXCEPTIONS` holds what they don't say.
- A predicate may allow a value that the call refuses for another reason (a texture of another format, an
  index beyond the end). What it doesn't allow has to be refused.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import inspect
import math
import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

import rhi
from rhi import Device, Format, Primitive
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored, Corner, Tint, Tinted
from rhi.conformance.shapes import rectangle
from rhi.contract.states import STATE_TYPES
from rhi.shading import Shader, StorageRW, Struct

Takes = Callable[["CallHarness", Any], bool]
NOT_USED: Final = enum.Enum("NOT_USED", "MEMBER").MEMBER  # type: ignore[attr-defined]


class Doubled(Shader):
    """Doubles numbers."""

    numbers: StorageRW[float]

    def compute(self) -> None:
        self.numbers[0] = self.numbers[0] * 2.0


class CallHarness:
    """One object of each kind on one device."""

    def __init__(self, device: Device) -> None:
        self.device = device
        rows = rectangle()
        self.program = device.program(Tinted)
        self.plain = device.program(Colored)
        self.compute = device.program(Doubled)
        self.tint = device.uniform(Tint(color=(1, 1, 1, 1)))
        self.tints = device.uniform_array(Tint, 4)
        self.buffer = device.buffer(np.arange(64, dtype="u4"))
        self.other = device.buffer(np.arange(64, dtype="u4"))
        self.arguments = device.buffer(np.array([1, 1, 1], "u4"))
        self.numbers = device.storage(float, np.ones(64, "f4"))
        self.mesh = device.mesh(rows)
        self.image = device.texture((4, 4), Format.RGBA8, levels=2)
        self.copy = device.texture((4, 4), Format.RGBA8, levels=2)
        self.target = device.texture((4, 4), Format.RGBA8)
        self.depth = device.texture((4, 4), Format.D24S8)
        self.many = device.texture((4, 4), Format.RGBA8, samples=4)
        self.query = device.occlusion_query()
        self.queries = device.query_set(4)
        self.draws = device.buffer(self.mesh.draws())
        self.indirect = rhi.IndirectDraws(self.draws, 1)
        self.sampler = device.sampler(rhi.SamplerDescriptor())
        with device.render_pass(self.target), self.query:
            device.draw(self.plain, self.mesh)
        with device.render_pass(self.target):
            device.draw_counted(self.plain, self.mesh, self.mesh.draws(), self.queries)
        with device.record() as self.commands:
            pass
        self.resources = [
            self.program,
            self.tint,
            self.tints,
            self.buffer,
            self.numbers,
            self.mesh,
            self.image,
            self.depth,
            self.query,
            self.queries,
        ]

    @property
    def transient(self) -> rhi.TransientMemory:
        return self.device.transient

    @property
    def transient_mesh(self) -> rhi.TransientMesh:
        return self.transient.mesh(self.plain, ROWS)

    def owns(self, value: object) -> bool:
        """Return whether a value is an object of this harness."""
        return any(value is member for member in vars(self).values())


CLASSES: Final[list[Any]] = [
    rhi.Device,
    rhi.CommandBuffer,
    rhi.TransientMemory,
    rhi.Buffer,
    rhi.UniformBuffer,
    rhi.UniformArray,
    rhi.StorageBuffer,
    rhi.Texture,
    rhi.Mesh,
    rhi.TransientMesh,
    rhi.Program,
    rhi.OcclusionQuery,
    rhi.QuerySet,
    rhi.Immediate,
    rhi.ColorWrite,
    rhi.BlendFunction,
]
"""The classes whose methods are called."""

VALUES: Final[list[Any]] = [
    rhi.Region,
    rhi.SamplerDescriptor,
    rhi.IndirectDraws,
    rhi.TextureTarget,
    rhi.Sampler,
    rhi.FixedStack,
    rhi.FixedQueue,
    rhi.ProgramDescriptor,
    *(kind for kind in STATE_TYPES if dataclasses.is_dataclass(kind)),
]
"""The classes whose objects are values, which users create."""

OBJECTS: Final = {
    "Device": "device",
    "Buffer": "buffer",
    "UniformBuffer": "tint",
    "UniformArray": "tints",
    "StorageBuffer": "numbers",
    "Texture": "image",
    "Mesh": "mesh",
    "Program": "program",
    "OcclusionQuery": "query",
    "QuerySet": "queries",
    "CommandBuffer": "commands",
    "TransientMemory": "transient",
    "TransientMesh": "transient_mesh",
}
"""The harness's object of each class."""

INTERNAL: Final = {
    "CommandBuffer": {"note_retired"},
    "TransientMemory": {"mark", "note_retired", "upload_mesh"},
    "Buffer": {"cuda"},  # on gl alone, in a file of its own
    "StorageBuffer": {"cuda"},
    "Mesh": {"create_vertex_array", "offset_draws"},
    "TransientMesh": {"create_vertex_array", "offset_draws"},
    "Program": {
        "bind",
        "bind_current",
        "build",
        "check",
        "check_aliases",
        "must_check_aliases",
        "check_can_dispatch",
        "check_can_draw",
        "check_instances",
        "check_names",
        "check_unknown",
        "draw_unprepared",
        "draw_with",
        "exchange",
        "explain",
        "get_vertex_array",
        "make_current",
        "note_retired",
        "pack_value",
        "prepare_draw",
        "take_uniform",
    },
    "OcclusionQuery": {
        "abandon",
        "check_ended",
        "check_usable",
        "complete",
        "cut_off",
        "describe",
        "discard_result",
        "get_block",
        "finish",
        "mark_submitted",
        "write_begin",
        "write_end",
    },
    "Scissor": {"clamp"},
    "QuerySet": {
        "check_conditions",
        "check_ended",
        "check_query_indices",
        "counted",
        "discard_result",
        "draw",
        "draw_conditional",
        "mark_drawn",
        "mark_indices_submitted",
        "mark_submitted",
    },
}
"""Methods that the package's own modules call on each other."""


# -- what parameters take ----------------------------------------------------------------------------------


def integer(minimum: float = -math.inf, maximum: float = math.inf) -> Takes:
    """Whole numbers: int and NumPy's integers, no bool."""
    return lambda harness, value: (
        isinstance(value, (int, np.integer)) and not isinstance(value, bool) and minimum <= value <= maximum
    )


def number(minimum: float = -3.5e38, maximum: float = 3.5e38) -> Takes:
    """Finite numbers, no bool."""
    kinds = (int, float, np.integer, np.floating)
    return lambda harness, value: (
        isinstance(value, kinds) and not isinstance(value, bool) and minimum <= float(value) <= maximum
    )


def instance(*kinds: Any) -> Takes:
    """Values of some classes."""
    return lambda harness, value: isinstance(value, kinds)


def own(*kinds: Any) -> Takes:
    """Living objects of the device."""
    return lambda harness, value: isinstance(value, kinds) and harness.owns(value)


def optional(takes: Takes) -> Takes:
    """The same, or None."""
    return lambda harness, value: value is None or takes(harness, value)


def empty(harness: CallHarness, value: Any) -> bool:
    """A list or tuple without elements."""
    return isinstance(value, (list, tuple)) and not value


def either(*takes: Takes) -> Takes:
    """The values that one of several kinds takes."""
    return lambda harness, value: any(take(harness, value) for take in takes)


def array(*dtypes: Any) -> Takes:
    """Values that NumPy converts to an array of one of these dtypes."""

    def takes(harness: CallHarness, value: Any) -> bool:
        try:
            return np.asarray(value).ndim > 0 and np.asarray(value).dtype in [
                np.dtype(dtype) for dtype in dtypes
            ]
        except (TypeError, ValueError):
            return False

    return takes


flag, text, nothing = instance(bool, np.bool_), instance(str), lambda harness, value: False
natural = integer(0)


ROWS: Final = np.zeros(6, Corner.dtype)
DRAWS: Final = array(rhi.DRAW_UNINDEXED)
MANY: Final = either(
    natural, array("i8"), lambda harness, value: array("f8")(harness, value) and not len(value)
)
ROW: Final = array("f4", "f8", "i8")
UNENDING: Final = lambda harness, value: isinstance(value, float) and not math.isfinite(value)  # noqa: E731
WORD, BYTE, TARGET, PORTION = integer(-(2**31), 2**32 - 1), integer(0, 255), integer(0, 7), number(0, 1)
CONSTANTS: Final = either(instance(Struct, float, np.number), integer(-(2**31), 2**31 - 1), array("f8"))


def of(name: str) -> Callable[[CallHarness], Any]:
    """The object of this name."""
    return lambda harness: getattr(harness, name)


KINDS: Final[dict[str, tuple[Any, Takes]]] = {
    "bool": (False, flag),
    "int": (1, natural),
    "float": (0.5, number()),
    "str": ("name", text),
    "Path": (Path("capture"), instance(Path)),
    "None": (None, lambda harness, value: value is None),
    **dict.fromkeys(("NDArray", "ArrayLike"), (np.arange(6, dtype="u2"), array("i8"))),
    "Sequence": ((), empty),
    "Clear": ((0, 0, 0, 1), optional(either(array("f8", "i8", "f4"), instance(tuple)))),
    "Region": (rhi.Region(0, 0, 1, 1), instance(rhi.Region)),
    "Drawable": (of("mesh"), own(rhi.Mesh)),
    "RenderTarget": (of("target"), own(rhi.Texture)),
    "IndirectDraws": (of("indirect"), instance(rhi.IndirectDraws)),
    "Sampler": (of("sampler"), instance(rhi.Sampler)),
    "SamplerDescriptor": (rhi.SamplerDescriptor(), instance(rhi.SamplerDescriptor)),
    **{kind: (of(name), own(getattr(rhi, kind))) for kind, name in OBJECTS.items()},
}
"""For each annotation a value, and what it takes. Those of an enum are its members."""


def each(names: str, value: Any = ..., takes: Any = ...) -> dict[str, tuple[Any, Any]]:
    """The same for several parameters."""
    return dict.fromkeys(names.split(), (value, takes))


EXCEPTIONS: Final[dict[str, tuple[Any, Any]]] = {
    # of any call
    **each("label", "name"),
    **each("tint", of("tint"), own(rhi.UniformBuffer)),
    **each("numbers", of("numbers"), own(rhi.StorageBuffer)),
    **each("first", 1),
    **each("count", 2),
    **each("size", 8),
    **each("format", Format.RGBA8),
    **each("row_bytes depth", None),
    **each("clear_depth", None, optional(PORTION)),
    **each("clear_stencil", None, optional(BYTE)),
    **each("draws", lambda harness: harness.mesh.draws([0, 3], 3), DRAWS),
    **each("query_indices", [0, 1], optional(array("i8"))),
    **each("clips", [(0, 0, 2, 2), (1, 0, 0, 1)], nothing),
    **each("element", float, lambda harness, value: value is int),
    **each("capacity", 4, integer(1, 1 << 40)),
    **each("front back", 1, BYTE),
    # of a method of any class
    **each("at.target", 0, optional(TARGET)),
    **each("clear.value", ..., WORD),
    **each("copy_buffer.target", of("other")),
    **each("copy_texture.target", of("copy")),
    **each("dispatch.groups", 1, either(natural, array("i8"))),
    **each("dispatch.program dispatch_indirect.program", of("compute")),
    **each("dispatch_indirect.buffer", of("arguments")),
    **each("draw.instances", ..., integer(0, 2**31 - 1)),
    **each("draws.first draws.base_instance", 0, MANY),
    **each("draws.count", 3, optional(MANY)),
    **each("draws.instances", 1, MANY),
    **each("draws.base_vertex", 0, either(integer(), MANY)),
    **each("immediate.primitive", Primitive.POINTS),
    **each("instances.arrays", {"color": np.zeros((2, 4), "f4")}, nothing),
    **each("render_pass.color resolve.source", of("many")),
    **each("render_pass.resolve resolve.target resolve_to.target", of("target")),
    **each("states.states", rhi.CullMode.NONE, nothing),
    **each("uniform.value", Tint(color=(1, 1, 1, 1)), CONSTANTS),
    **each("vertex.position vertex.color", (0, 0, 0, 1), nothing),
    **each("vertices.arrays", ROWS, nothing),
    **each("view.first", 0),
    **each("view.count", 3),
    **each("view.base_vertex", 0, integer()),
    # of one call
    **each("create_device.name", "null"),
    **each("create_device.frames_in_flight", ..., integer(1)),
    **each("Device.adopt_texture.native", 1, natural),
    **each("Device.backend_as.kind", object, instance(type)),
    **each("Device.buffer.dtype", "u4", optional(instance(type, str))),
    **each("Device.buffer.source", 8, either(natural, array("f8", "i8"))),
    **each("Device.mesh.vertices", ROWS, either(natural, own(rhi.Buffer))),
    **each("Device.mesh.instances", None, optional(own(rhi.Buffer))),
    **each("Device.prepare.program", of("plain"), either(own(rhi.Program), empty)),
    **each("Device.prepare.states", (rhi.CullMode.NONE,)),
    **each("Device.prepare.targets", (Format.RGBA8,)),
    **each("Device.program.shader", Colored, nothing),
    **each("Device.query_set.size", 2, integer(0, 1 << 20)),
    **each("Device.storage.source", 4, either(natural, own(rhi.Buffer), ROW)),
    **each("Device.texture.source", (4, 4), nothing),
    **each("Device.texture_table.images", [np.zeros((4, 4, 4), "u1")], nothing),
    **each("Device.uniform_array.struct", Tint, lambda harness, value: value is Tint),
    **each("Device.wait.seconds", 0.01, optional(number(0))),
    **each("Device.wait.value", 0),
    **each("TransientMemory.mesh.instances", None, optional(nothing)),
    **each("TransientMemory.mesh.program", of("plain")),
    **each("TransientMemory.mesh.vertices", ROWS, nothing),
    **each("TransientMemory.storage.source", 4, either(natural, ROW)),
    **each("Buffer.copy_to.target", of("other")),
    **each("Buffer.write.data", np.zeros(4, "u4"), array("u4")),
    **each("UniformBuffer.write.value", Tint(color=(1, 1, 1, 1)), instance(Tint)),
    **each("UniformArray.write.values", lambda harness: np.zeros(2, harness.tints.dtype), nothing),
    **each("StorageBuffer.write.values", np.zeros(4, "f4"), either(ROW, number(), UNENDING)),
    **each("Texture.copy_to.target", of("copy")),
    **each("Texture.image.layer", 0),
    **each("Texture.save.path", f"{tempfile.gettempdir()}/rhi_calls.png", nothing),
    **each("Texture.write.texels", np.zeros((2, 2, 4), "u1"), nothing),
    **each("Region.x Region.y Region.width Region.height Region.layer Region.layers", 1, integer()),
    **each("SamplerDescriptor.border", (0, 0, 0, 1), nothing),
    **each("SamplerDescriptor.max_anisotropy", ..., number(1)),
    **each("IndirectDraws.buffer", of("draws"), instance(rhi.Buffer, rhi.StorageBuffer)),  # checked in draws
    **each("IndirectDraws.count", None, optional(instance(rhi.Buffer, rhi.StorageBuffer))),
    **each("IndirectDraws.draws", 1, integer()),
    **each("IndirectDraws.offset IndirectDraws.stride IndirectDraws.count_offset", ..., integer()),
    **each("Sampler.id", lambda harness: harness.sampler.id, integer(1)),  # the descriptor decides
    **each("Sampler.descriptor", lambda harness: harness.sampler.descriptor),
    **each("ProgramDescriptor.stages", frozenset({rhi.Stage.COMPUTE}), nothing),
    **each("ProgramDescriptor.bindings ProgramDescriptor.attributes ProgramDescriptor.outputs", (), nothing),
    **each("ProgramDescriptor.varyings", (), nothing),
    **each("ProgramDescriptor.work_group", (1, 1, 1), nothing),
    **each("ProgramDescriptor.emit", len, lambda harness, value: callable(value)),
    **each("AlphaReference.value Viewport.near Viewport.far", ..., PORTION),
    **each("ColorWrite.target BlendFunction.target", 0, optional(TARGET)),
    **each("Viewport.x Viewport.y", ..., number(-32_767, 32_767)),
    **each("Viewport.width Viewport.height", ..., number(0, 16_384)),
    **each("Scissor.x Scissor.y", ..., integer(-(2**30), 2**30)),
    **each("Scissor.width Scissor.height", ..., integer(0, 2**30)),
    **each("LineWidth.width", ..., number(1)),
}
"""Values and what is taken where the annotation and the default don't say it (`...`: they do), by parameter,
by method and parameter, or by class too: the longest name that is found counts."""


def describe(call: str, parameter: inspect.Parameter) -> tuple[Any, Takes]:
    """Return a parameter's value in a call that works, and what it takes."""
    name = parameter.name
    keys = f"{call}.{name}", f"{call.rpartition('.')[2]}.{name}", name
    value, takes = next((EXCEPTIONS[key] for key in keys if key in EXCEPTIONS), (..., ...))
    if value is ... or takes is ...:
        annotation = str(parameter.annotation)
        while (plain := re.sub(r"\[[^][]*\]", "", annotation)) != annotation:
            annotation = plain
        kinds = [get_kind(part) for part in annotation.split(" | ")]
        if takes is ...:
            takes = either(*(take for _, take in kinds))
        if value is ...:
            has_default = parameter.default not in (None, inspect.Parameter.empty)
            value = parameter.default if has_default else kinds[0][0]
    return value, takes


def get_kind(annotation: str) -> tuple[Any, Takes]:
    """Return a value of one annotation, and what it takes."""
    if annotation not in KINDS:
        kind = getattr(rhi, annotation)
        assert issubclass(kind, enum.Enum), f"{annotation} isn't among the kinds"
        return next(iter(kind)), instance(kind)
    return KINDS[annotation]


# -- the calls ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sample:
    """A call that works.

    Attributes:
        call: makes the call, given a harness and the arguments by name.
        parameters: for each parameter its value, or a function of the harness that returns it, and what it
            takes.
        within: opens what the call needs to be open.
        enters: whether the result is a context manager, which the test enters.
        needs: the capabilities that the device needs for it.
    """

    call: Callable[..., Any]
    parameters: dict[str, tuple[Any, Takes]]
    within: Callable[[CallHarness, ExitStack], None] = lambda harness, stack: None
    enters: bool = False
    needs: tuple[str, ...] = ()


def in_pass(harness: CallHarness, stack: ExitStack) -> None:
    stack.enter_context(harness.device.render_pass(harness.target))


def call_method(name: str, positional: list[str], harness: CallHarness, **arguments: Any) -> Any:
    """Call a method of an object of the harness."""
    kind, _, method = name.partition(".")
    called = getattr(getattr(harness, RECEIVERS.get(name, OBJECTS[kind])), method)
    first = [arguments.pop(parameter_name) for parameter_name in positional]
    return called(*first, **arguments)


def call_encoder(name: str, positional: list[str], harness: CallHarness, **arguments: Any) -> None:
    """Call a method that devices and command buffers share, or one of a command buffer, where it may be
    called."""
    kind, _, method = name.partition(".")
    is_recorded = kind == "CommandBuffer"
    with (
        harness.device.record() if is_recorded else nullcontext(harness.device) as encoder,
        ExitStack() as stack,
    ):
        if method.startswith(("draw", "immediate", "query")) and harness.device._core.render_pass is None:
            stack.enter_context(encoder.render_pass(harness.target))
        if method == "draw_conditional":
            draws = harness.mesh.draws([0, 3], 3)
            encoder.draw_counted(harness.program, harness.mesh, draws, harness.queries, tint=harness.tint)
        first = [arguments.pop(parameter_name) for parameter_name in positional]
        result = getattr(encoder, method)(*first, **arguments)
        if hasattr(result, "__enter__"):
            with result:
                if method == "immediate":  # a block without vertices draws nothing
                    result.vertex(position=(0, 0, 0, 1), color=(0, 0, 0, 1))


def call_immediate(name: str, positional: list[str], harness: CallHarness, **arguments: Any) -> None:
    """Call a method of an immediate-mode block."""
    with (
        harness.device.render_pass(harness.target),
        harness.device.immediate(harness.plain, Primitive.POINTS) as block,
    ):
        getattr(block, name.partition(".")[2])(**arguments)
        if name == "Immediate.instances":
            block.vertex(position=(0, 0, 0, 1))


RECEIVERS: Final = {"Texture.read_stencil": "depth", "Texture.resolve_to": "many"}
"""The names of other objects of the harness whose methods are called."""

CALLS: Final[dict[str, Callable[..., Any]]] = {
    "create_device": lambda harness, **arguments: rhi.create_device(**arguments).close(),
    "Device.backend_as": lambda harness, kind: bool(harness.device.backend_as(kind)),
    "Device.close": lambda harness, quiet: Device(rhi.backends.null.NullBackend()).close(quiet=quiet),
    "Device.program": lambda harness, shader: bool(harness.device.program(shader)),
    "Device.timing": lambda harness, on: setattr(harness.device, "timing", on),
    "ColorWrite.at": lambda harness, target: rhi.ColorWrite.OFF.at(target),
    "BlendFunction.at": lambda harness, target: rhi.BlendFunction.ALPHA.at(target),
    "TextureTarget": lambda harness, **arguments: harness.device.render_pass(rhi.TextureTarget(**arguments)),
    "Sampler": lambda harness, **arguments: harness.image.sampled(rhi.Sampler(**arguments)),
}
"""How what isn't a method of the harness's object is called, or what becomes of the result."""

REQUIREMENTS: Final = {
    "adopt_texture": ("shares_textures",),
    "native_texture": ("shares_textures",),
    "conditional": ("conditional_rendering",),
    "draw_conditional": ("conditional_rendering",),
}
"""The capabilities that methods need."""


def list_signatures() -> Iterator[tuple[str, inspect.Signature]]:
    """Yield each public method and property that can be set, and each value's class, with its parameters."""
    yield "create_device", inspect.signature(rhi.create_device)
    for kind in CLASSES:
        for name, member in inspect.getmembers(kind):
            if not name.startswith("_") and name not in INTERNAL.get(kind.__name__, ()):
                function = member.fset if isinstance(member, property) else member
                if inspect.isfunction(function):
                    yield f"{kind.__name__}.{name}", inspect.signature(function)
    for kind in VALUES:
        yield kind.__name__, inspect.signature(kind.__init__)
    draw = inspect.signature(Device.draw)  # that of a program is generated
    yield (
        "Program.draw",
        draw.replace(
            parameters=[parameter for parameter in draw.parameters.values() if parameter.name != "program"]
        ),
    )


def make_sample(name: str, signature: inspect.Signature) -> Sample | None:
    """Return a call of a method or a class, None if it has no parameters."""
    kind, _, method = name.partition(".")
    parameters = [
        parameter
        for parameter in signature.parameters.values()
        if parameter.name not in ("self", "args", "options")
    ]
    positional = [
        parameter.name
        for parameter in parameters
        if parameter.kind in (parameter.POSITIONAL_ONLY, parameter.VAR_POSITIONAL)
    ]
    for rest in [parameter for parameter in parameters if parameter.kind is parameter.VAR_KEYWORD]:
        names = (
            ["position", "color"] if rest.name == "fields" else ["numbers" if "dispatch" in name else "tint"]
        )
        parameters.remove(rest)
        if name == "UniformBuffer.write":  # fields are given instead of a value; the conformance kit does so
            continue
        parameters += [rest.replace(name=parameter, kind=rest.KEYWORD_ONLY) for parameter in names]
    if not parameters:
        return None
    if name in CALLS:
        call = CALLS[name]
    elif not method:
        call = functools.partial(lambda kind, harness, /, **arguments: kind(**arguments), getattr(rhi, name))
    elif kind == "CommandBuffer" or (kind == "Device" and hasattr(rhi.CommandBuffer, method)):
        call = functools.partial(call_encoder, name, positional)
    else:
        call = functools.partial(call_immediate if kind == "Immediate" else call_method, name, positional)
    return Sample(
        call,
        {parameter.name: describe(name, parameter) for parameter in parameters},
        within=in_pass if name == "Program.draw" else Sample.within,
        enters=method == "lock",
        needs=REQUIREMENTS.get(method, ()),
    )


SAMPLES: Final = {
    name: sample
    for name, signature in list_signatures()
    if (sample := make_sample(name, signature)) is not None
}


# -- making a call -----------------------------------------------------------------------------------------


def run(harness: CallHarness, sample: Sample, arguments: dict[str, Any]) -> None:
    """Make a call, and enter and leave the scope that it returns; destroy what it creates, but no view."""
    with ExitStack() as stack:
        sample.within(harness, stack)
        result = sample.call(harness, **arguments)
        if sample.enters:
            with result:
                pass
        viewed = getattr(result, "owner", None) or getattr(getattr(result, "data", None), "vertices", None)
        if hasattr(result, "destroy") and not harness.owns(viewed) and viewed is not harness.mesh.vertices:
            result.destroy()


def make_arguments(harness: CallHarness, sample: Sample) -> dict[str, Any]:
    """Return the arguments of a call that works, by name."""
    values = {name: value for name, (value, _) in sample.parameters.items()}
    return {name: value(harness) if inspect.isfunction(value) else value for name, value in values.items()}


def check_drawing(harness: CallHarness) -> None:
    """Check that the device draws, and that no draw before it left anything that shifts or hides this one."""
    device = harness.device
    assert not device.transient._core.locked
    with device.render_pass(harness.target, clear=(0, 0, 0, 0)):
        device.draw(harness.program, harness.mesh, tint=harness.tint)
        device.draw(harness.plain, harness.mesh)
    if device.capabilities.renders:
        assert_same(harness.target.read(), 255)
