"""A call of every public method, with what each of its parameters takes: laws about all calls are tested over it.

- `SAMPLES` holds for each method a call that works and, for each parameter, the value of that call and a predicate: the
  values that the documentation allows. The test replaces one value at a time by every value of `WRONG`.
- A predicate may allow a value that the call refuses for another reason (a texture of another format, an index beyond
  the end). What it doesn't allow has to be refused.
"""

from __future__ import annotations

import enum
import inspect
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

import rhi
from rhi import Access, BufferUsage, Device, Filter, Format, Primitive, Region, TextureKind, Wrap
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored, Corner, Tint, Tinted
from rhi.conformance.shapes import rectangle
from rhi.contract.states import BlendFactor, BlendOperation, Comparison, StencilOperation
from rhi.shading import Shader, StorageRW, Struct

Takes = Callable[["House", Any], bool]
NOT_USED: Final = enum.Enum("NOT_USED", "MEMBER").MEMBER  # type: ignore[attr-defined]


class Doubled(Shader):
    """Doubles numbers."""

    numbers: StorageRW[float]

    def compute(self) -> None:
        self.numbers[0] = self.numbers[0] * 2.0


class House:
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
            self.program, self.tint, self.tints, self.buffer, self.numbers, self.mesh, self.image, self.depth,
            self.query, self.queries,
        ]  # fmt: skip

    def owns(self, value: object) -> bool:
        """Return whether a value is one of this house's objects."""
        return any(value is each for each in vars(self).values())


CLASSES: Final[list[Any]] = [
    rhi.Device, rhi.CommandBuffer, rhi.TransientMemory, rhi.Buffer, rhi.UniformBuffer, rhi.UniformArray,
    rhi.StorageBuffer, rhi.Texture, rhi.Mesh, rhi.TransientMesh, rhi.Program, rhi.OcclusionQuery, rhi.QuerySet,
    rhi.Immediate, rhi.ColorWrite, rhi.BlendFunction,
]  # fmt: skip
"""The classes whose methods are called."""

INTERNAL: Final = {
    "CommandBuffer": {"note_retired"},
    "TransientMemory": {"mark", "note_retired", "place_mesh"},
    "Mesh": {"create_vertex_array", "place_draws"},
    "TransientMesh": {"create_vertex_array", "place_draws"},
    "Program": {
        "bind", "bind_current", "build", "check", "check_can_dispatch", "check_can_draw", "check_instances",
        "check_names", "draw_unprepared", "draw_with", "exchange", "explain", "find_vertex_array", "make_current",
        "note_retired", "prepare_draw",
    },
    "OcclusionQuery": {
        "abandon", "check_ended", "check_usable", "complete", "cut_off", "describe", "discard_answer", "find_block",
        "finish", "mark_submitted", "write_begin", "write_end",
    },
    "QuerySet": {
        "check_conditions", "check_ended", "check_rows", "counted", "discard_answer", "draw", "draw_conditional",
        "mark_rows_drawn", "mark_rows_submitted", "mark_submitted",
    },
}  # fmt: skip
"""Methods that the package's own modules call on each other."""


# -- what parameters take ----------------------------------------------------------------------------------


def whole(least: float = -math.inf, most: float = math.inf) -> Takes:
    """Whole numbers: int and NumPy's integers, no bool."""
    return lambda house, value: (
        isinstance(value, (int, np.integer)) and not isinstance(value, bool) and least <= value <= most
    )


def number(least: float = -3.5e38, most: float = 3.5e38) -> Takes:
    """Finite numbers, no bool."""
    kinds = (int, float, np.integer, np.floating)
    return lambda house, value: (
        isinstance(value, kinds) and not isinstance(value, bool) and least <= float(value) <= most
    )


def instance(*kinds: Any) -> Takes:
    """Values of some classes."""
    return lambda house, value: isinstance(value, kinds)


def own(*kinds: Any) -> Takes:
    """Living objects of the device."""
    return lambda house, value: isinstance(value, kinds) and house.owns(value)


def optional(takes: Takes) -> Takes:
    """The same, or None."""
    return lambda house, value: value is None or takes(house, value)


def empty(house: House, value: Any) -> bool:
    """A list or tuple without elements."""
    return isinstance(value, (list, tuple)) and not value


def either(*takes: Takes) -> Takes:
    """What one of several takes."""
    return lambda house, value: any(each(house, value) for each in takes)


def array(*dtypes: Any) -> Takes:
    """What NumPy makes an array of one of these dtypes of."""

    def takes(house: House, value: Any) -> bool:
        try:
            return np.asarray(value).ndim > 0 and np.asarray(value).dtype in [np.dtype(each) for each in dtypes]
        except (TypeError, ValueError):
            return False

    return takes


flag, text, nothing = instance(bool, np.bool_), instance(str), lambda house, value: False
natural = whole(0)


# -- the calls ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sample:
    """A call that works.

    Attributes:
        call: makes the call, given a house and the arguments by name.
        parameters: for each parameter its value, or a function of the house that returns it, and what it takes.
        within: opens what the call needs to be open.
        enters: whether the result is a context manager, which the test enters.
    """

    call: Callable[..., Any]
    parameters: dict[str, tuple[Any, Takes]]
    within: Callable[[House, ExitStack], None] = lambda house, stack: None
    enters: bool = False
    needs: tuple[str, ...] = field(default=())


def method(of: str, name: str) -> Callable[..., Any]:
    """A call of a method by keywords."""
    return lambda house, **given: getattr(getattr(house, of), name)(**given)


def in_pass(house: House, stack: ExitStack) -> None:
    stack.enter_context(house.device.render_pass(house.target))


def of(name: str) -> Callable[[House], Any]:
    """The object of this name."""
    return lambda house: getattr(house, name)


@contextmanager
def recording(house: House) -> Iterator[rhi.CommandBuffer]:
    with house.device.record() as commands:
        yield commands


RANGE: Final = {"first": (1, natural), "count": (2, optional(natural))}
LAYER: Final = {"level": (0, natural), "layer": (0, natural)}
REGION: Final = (None, optional(instance(Region)))
COLOR: Final = either(array("f8", "i8", "f4"), instance(tuple))
ROWS: Final = np.zeros(6, Corner.dtype)

BUFFER_COPY: Final = {
    "target": (of("other"), own(rhi.Buffer, rhi.StorageBuffer)),
    "size": (8, optional(natural)),
    "offset": (0, natural),
    "target_offset": (0, natural),
}
TEXTURE_COPY: Final = {
    "target": (of("copy"), own(rhi.Texture)),
    "level": (0, natural),
    "region": REGION,
    "target_level": (0, natural),
    "x": (0, natural),
    "y": (0, natural),
    "layer": (0, natural),
}
ROWS_COPY: Final = {
    "level": (0, natural),
    "region": REGION,
    "offset": (0, natural),
    "row_bytes": (None, optional(natural)),
}
BUFFER: Final = (of("buffer"), own(rhi.Buffer, rhi.StorageBuffer))
PROGRAM: Final = (of("program"), own(rhi.Program))
MESH: Final = (of("mesh"), own(rhi.Mesh))
TINT: Final = (of("tint"), own(rhi.UniformBuffer))
LABEL: Final = ("name", text)
PART: Final = {"first": (0, natural), "count": (3, optional(natural))}
DRAWS: Final = (lambda house: house.mesh.draws([0, 3], 3), array(rhi.DRAW_UNINDEXED))
DRAWS_BY_ROW: Final = {
    "program": PROGRAM,
    "mesh": MESH,
    "draws": DRAWS,
    "queries": (of("queries"), own(rhi.QuerySet)),
    "rows": ([0, 1], optional(array("i8"))),
    "tint": TINT,
}
ELEMENT: Final = (float, lambda house, value: value is int)
CONSTANTS: Final = either(instance(Struct, float, np.number), whole(-(2**31), 2**31 - 1), array("f8"))


def encoder_samples(open_encoder: Callable[[House], Any]) -> dict[str, Sample]:
    """The methods that devices and command buffers share."""

    def call(name: str, *positional: str, bare: bool = False) -> Callable[..., Any]:
        def make(house: House, **given: Any) -> Any:
            with open_encoder(house) as encoder:
                with ExitStack() as stack:
                    if name.startswith(("draw", "immediate")) and house.device._core.render_pass is None:
                        stack.enter_context(encoder.render_pass(house.target))
                    if name == "draw_conditional":
                        draws = house.mesh.draws([0, 3], 3)
                        encoder.draw_counted(house.program, house.mesh, draws, house.queries, tint=house.tint)
                    first = [given.pop(each) for each in positional]
                    made = getattr(encoder, name)(*first, **given)
                    if hasattr(made, "__enter__"):
                        with made:
                            if name == "immediate":  # a block without vertices draws nothing
                                made.vertex(position=(0, 0, 0, 1), color=(0, 0, 0, 1))

        return make

    return {
        "render_pass": Sample(
            call("render_pass"),
            {
                "color": (of("many"), optional(either(own(rhi.Texture), instance(list)))),
                "depth": (None, optional(own(rhi.Texture))),
                "clear": ((0, 0, 0, 1), optional(COLOR)),
                "clear_depth": (None, optional(number(0, 1))),
                "clear_stencil": (None, optional(whole(0, 255))),
                "resolve": (of("target"), optional(either(own(rhi.Texture), instance(list)))),
                "label": LABEL,
            },
        ),
        "states": Sample(call("states", "states"), {"states": (rhi.CullMode.NONE, nothing)}),
        "event": Sample(call("event"), {"label": LABEL}),
        "conditional": Sample(
            call("conditional"),
            {"query": (of("query"), own(rhi.OcclusionQuery)), "inverted": (False, flag)},
            needs=("conditional_rendering",),
        ),
        "draw": Sample(
            call("draw", "program", "mesh", "instances"),
            {"program": PROGRAM, "mesh": MESH, "instances": (1, whole(0, 2**31 - 1)), "tint": TINT},
        ),
        "draw_many": Sample(
            call("draw_many", "program", "mesh", "draws"),
            {"program": PROGRAM, "mesh": MESH, "draws": DRAWS, "tint": TINT},
        ),
        "draw_clipped": Sample(
            call("draw_clipped", "program", "mesh", "draws", "clips"),
            {
                "program": PROGRAM,
                "mesh": MESH,
                "draws": DRAWS,
                "clips": ([(0, 0, 2, 2), (1, 0, 0, 1)], nothing),
                "tint": TINT,
            },
        ),
        "draw_counted": Sample(
            call("draw_counted", "program", "mesh", "draws", "queries", "rows"),
            DRAWS_BY_ROW,
        ),
        "draw_conditional": Sample(
            call("draw_conditional", "program", "mesh", "draws", "queries", "rows"),
            DRAWS_BY_ROW,
            needs=("conditional_rendering",),
        ),
        "draw_indirect": Sample(
            call("draw_indirect", "program", "mesh", "arguments"),
            {
                "program": PROGRAM,
                "mesh": MESH,
                "arguments": (of("indirect"), instance(rhi.IndirectDraws)),
                "tint": TINT,
            },
        ),
        "dispatch": Sample(
            call("dispatch", "program", "groups"),
            {
                "program": (of("compute"), own(rhi.Program)),
                "groups": (1, either(natural, array("i8"))),
                "numbers": (of("numbers"), own(rhi.StorageBuffer)),
            },
        ),
        "dispatch_indirect": Sample(
            call("dispatch_indirect", "program", "buffer", "offset"),
            {
                "program": (of("compute"), own(rhi.Program)),
                "buffer": (of("arguments"), own(rhi.Buffer, rhi.StorageBuffer)),
                "offset": (0, natural),
                "numbers": (of("numbers"), own(rhi.StorageBuffer)),
            },
        ),
        "immediate": Sample(
            call("immediate", "program", "primitive"),
            {"program": PROGRAM, "primitive": (Primitive.POINTS, instance(Primitive)), "tint": TINT},
        ),
    }


@contextmanager
def device_of(house: House) -> Iterator[Device]:
    yield house.device


def commands(name: str, parameters: dict[str, tuple[Any, Takes]]) -> Sample:
    """A call of a command buffer."""

    def call(house: House, **given: Any) -> None:
        with recording(house) as encoder, ExitStack() as stack:
            if name == "query":
                stack.enter_context(encoder.render_pass(house.target))
            made = getattr(encoder, name)(**given)
            if made is not None:
                with made:
                    pass

    return Sample(call, parameters)


def immediate(name: str, parameters: dict[str, tuple[Any, Takes]]) -> Sample:
    """A call of an immediate-mode block."""

    def call(house: House, **given: Any) -> None:
        with house.device.render_pass(house.target):
            with house.device.immediate(house.plain, Primitive.POINTS) as block:
                getattr(block, name)(**given)
                if name == "instances":
                    block.vertex(position=(0, 0, 0, 1))

    return Sample(call, parameters)


def fields(kind: Any, parameters: dict[str, tuple[Any, Takes]]) -> Sample:
    """The creation of a value."""
    return Sample(lambda house, **given: kind(**given), parameters)


def transient_mesh(house: House) -> rhi.TransientMesh:
    return house.device.transient.mesh(house.plain, ROWS)


PARTS: Final = {
    **PART,
    "base_vertex": (0, whole()),
    "base_instance": (0, natural),
}
MANY: Final = either(natural, array("i8"), lambda house, value: array("f8")(house, value) and not len(value))
MANY_DRAWS: Final = {
    "first": (0, MANY),
    "count": (3, optional(MANY)),
    "instances": (1, MANY),
    "base_vertex": (0, either(whole(), MANY)),
    "base_instance": (0, MANY),
}
VIEW: Final = {**PARTS, "primitive": (None, optional(instance(Primitive)))}
BYTE, TARGET = whole(0, 255), (0, optional(whole(0, 7)))
FACE: Final = {
    "function": (Comparison.ALWAYS, instance(Comparison)),
    **{
        name: (StencilOperation.KEEP, instance(StencilOperation))
        for name in ("stencil_fail", "depth_fail", "both_pass")
    },
}

SAMPLES: Final[dict[str, Sample]] = {
    **{f"Device.{name}": sample for name, sample in encoder_samples(device_of).items()},
    **{f"CommandBuffer.{name}": sample for name, sample in encoder_samples(recording).items()},
    "Device.backend_as": Sample(
        lambda house, kind: bool(house.device.backend_as(kind)), {"kind": (object, instance(type))}
    ),
    "Device.buffer": Sample(
        method("device", "buffer"),
        {
            "source": (8, either(natural, array("f8", "i8"))),
            "dtype": ("u4", optional(instance(type, str))),
            "usage": (BufferUsage.STATIC, instance(BufferUsage)),
            "label": LABEL,
        },
    ),
    "Device.close": Sample(
        lambda house, quiet: Device(rhi.backends.null.NullBackend()).close(quiet=quiet), {"quiet": (False, flag)}
    ),
    "Device.mesh": Sample(
        method("device", "mesh"),
        {
            "vertices": (ROWS, either(natural, own(rhi.Buffer))),
            "indices": (np.arange(6, dtype="u2"), optional(either(own(rhi.Buffer), array("i8")))),
            "instances": (None, optional(own(rhi.Buffer))),
            "primitive": (Primitive.TRIANGLES, instance(Primitive)),
            "label": LABEL,
        },
    ),
    "Device.occlusion_query": Sample(method("device", "occlusion_query"), {"emulated": (False, flag)}),
    "Device.prepare": Sample(
        method("device", "prepare"),
        {
            "program": (of("plain"), either(own(rhi.Program), empty)),
            "mesh": (of("mesh"), optional(own(rhi.Mesh))),
            "targets": ((Format.RGBA8,), empty),
            "states": ((rhi.CullMode.NONE,), empty),
        },
    ),
    "Device.present": Sample(method("device", "present"), {"image": (of("target"), optional(own(rhi.Texture)))}),
    "Device.program": Sample(
        lambda house, shader: bool(house.device.program(shader)), {"shader": (Colored, nothing)}
    ),
    "Device.query_set": Sample(
        method("device", "query_set"), {"size": (2, whole(0, 1 << 20)), "emulated": (False, flag)}
    ),
    "Device.record": Sample(method("device", "record"), {"label": LABEL}),
    "Device.sampler": Sample(
        method("device", "sampler"), {"descriptor": (rhi.SamplerDescriptor(), instance(rhi.SamplerDescriptor))}
    ),
    "Device.storage": Sample(
        method("device", "storage"),
        {
            "element": ELEMENT,
            "source": (4, either(natural, own(rhi.Buffer), array("f4"))),
            "label": LABEL,
        },
    ),
    "Device.submit": Sample(
        lambda house, buffers: house.device.submit(buffers), {"buffers": (of("commands"), own(rhi.CommandBuffer))}
    ),
    "Device.adopt_texture": Sample(
        method("device", "adopt_texture"), {"native": (1, natural), "label": LABEL}, needs=("shares_textures",)
    ),
    "Device.native_texture": Sample(
        method("device", "native_texture"), {"texture": (of("image"), own(rhi.Texture))}, needs=("shares_textures",)
    ),
    "Device.texture": Sample(
        method("device", "texture"),
        {
            "source": ((4, 4), nothing),
            "format": (Format.RGBA8, instance(Format)),
            "kind": (TextureKind.D2, instance(TextureKind)),
            "layers": (1, optional(natural)),
            "levels": (1, optional(natural)),
            "samples": (1, natural),
            "label": LABEL,
        },
    ),
    "Device.timing": Sample(lambda house, on: setattr(house.device, "timing", on), {"on": (False, flag)}),
    "Device.uniform": Sample(
        method("device", "uniform"), {"value": (Tint(color=(1, 1, 1, 1)), CONSTANTS), "label": LABEL}
    ),
    "Device.uniform_array": Sample(
        method("device", "uniform_array"),
        {"struct": (Tint, lambda house, value: value is Tint), "count": (4, natural), "label": LABEL},
    ),
    "Device.wait": Sample(
        method("device", "wait"), {"value": (0, natural), "seconds": (0.01, optional(number(0)))}
    ),
    "create_device": Sample(
        lambda house, **given: rhi.create_device(**given).close(),
        {
            "name": ("null", optional(text)),
            "validation": (False, flag),
            "record": (None, optional(flag)),
            "timing": (False, flag),
            "frames_in_flight": (2, whole(1)),
        },
    ),
    "CommandBuffer.clear": commands(
        "clear",
        {"buffer": (of("buffer"), own(rhi.Buffer, rhi.StorageBuffer)), "value": (0, whole(-(2**31), 2**32 - 1))},
    ),
    "CommandBuffer.copy_buffer": commands(
        "copy_buffer", {"source": (of("buffer"), own(rhi.Buffer, rhi.StorageBuffer)), **BUFFER_COPY}
    ),
    "CommandBuffer.copy_texture_to_buffer": commands(
        "copy_texture_to_buffer", {"source": (of("image"), own(rhi.Texture)), "target": BUFFER, **ROWS_COPY}
    ),
    "CommandBuffer.copy_buffer_to_texture": commands(
        "copy_buffer_to_texture", {"source": BUFFER, "target": (of("image"), own(rhi.Texture)), **ROWS_COPY}
    ),
    "CommandBuffer.copy_texture": commands(
        "copy_texture", {"source": (of("image"), own(rhi.Texture)), **TEXTURE_COPY}
    ),
    "CommandBuffer.generate_mipmaps": commands("generate_mipmaps", {"texture": (of("image"), own(rhi.Texture))}),
    "CommandBuffer.query": commands("query", {"query": (of("query"), own(rhi.OcclusionQuery))}),
    "CommandBuffer.resolve": commands(
        "resolve", {"source": (of("many"), own(rhi.Texture)), "target": (of("target"), own(rhi.Texture))}
    ),
    "TransientMemory.uniform": Sample(
        lambda house, value: house.device.transient.uniform(value), {"value": (Tint(color=(1, 1, 1, 1)), CONSTANTS)}
    ),
    "TransientMemory.storage": Sample(
        lambda house, **given: house.device.transient.storage(**given),
        {"element": ELEMENT, "source": (4, either(natural, array("f4")))},
    ),
    "TransientMemory.mesh": Sample(
        lambda house, **given: house.device.transient.mesh(**given),
        {
            "program": (of("plain"), own(rhi.Program)),
            "vertices": (ROWS, nothing),
            "indices": (np.arange(6, dtype="u2"), optional(array("i8"))),
            "primitive": (Primitive.TRIANGLES, instance(Primitive)),
            "instances": (None, optional(nothing)),
        },
    ),
    "Buffer.clear": Sample(method("buffer", "clear"), {"value": (0, whole(-(2**31), 2**32 - 1))}),
    "Buffer.copy_to": Sample(method("buffer", "copy_to"), BUFFER_COPY),
    "Buffer.lock": Sample(
        method("buffer", "lock"), {"access": (Access.READ, instance(Access)), **RANGE}, enters=True
    ),
    "Buffer.read_async": Sample(method("buffer", "read_async"), RANGE),
    "Buffer.read": Sample(method("buffer", "read"), RANGE),
    "Buffer.write": Sample(
        method("buffer", "write"), {"data": (np.zeros(4, "u4"), array("u4")), "first": (1, natural)}
    ),
    "UniformBuffer.write": Sample(method("tint", "write"), {"value": (Tint(color=(1, 1, 1, 1)), instance(Tint))}),
    "UniformArray.lock": Sample(
        method("tints", "lock"), {"access": (Access.READ, instance(Access)), **RANGE}, enters=True
    ),
    "UniformArray.write": Sample(
        method("tints", "write"),
        {"rows": (lambda house: np.zeros(2, house.tints.dtype), nothing), "first": (1, natural)},
    ),
    "StorageBuffer.clear": Sample(method("numbers", "clear"), {"value": (0, whole(-(2**31), 2**32 - 1))}),
    "StorageBuffer.lock": Sample(
        method("numbers", "lock"), {"access": (Access.READ, instance(Access)), **RANGE}, enters=True
    ),
    "StorageBuffer.read_async": Sample(method("numbers", "read_async"), RANGE),
    "StorageBuffer.read": Sample(method("numbers", "read"), RANGE),
    "StorageBuffer.write": Sample(
        method("numbers", "write"),
        {"rows": (np.zeros(4, "f4"), either(array("f4"), instance(np.float32))), "first": (1, natural)},
    ),
    "Texture.at": Sample(method("image", "at"), LAYER),
    "Texture.copy_to": Sample(method("image", "copy_to"), TEXTURE_COPY),
    "Texture.image": Sample(method("image", "image"), {"level": (0, natural), "layer": (0, optional(natural))}),
    "Texture.lock": Sample(
        method("image", "lock"),
        {"access": (Access.READ, instance(Access)), **LAYER, "region": REGION},
        enters=True,
    ),
    "Texture.copy_to_buffer": Sample(method("image", "copy_to_buffer"), {"target": BUFFER, **ROWS_COPY}),
    "Texture.copy_from_buffer": Sample(method("image", "copy_from_buffer"), {"source": BUFFER, **ROWS_COPY}),
    "Texture.read_async": Sample(method("image", "read_async"), {**LAYER, "region": REGION}),
    "Texture.read": Sample(method("image", "read"), {**LAYER, "region": REGION}),
    "Texture.read_layers": Sample(method("image", "read_layers"), {"level": (0, natural)}),
    "Texture.read_stencil": Sample(method("depth", "read_stencil"), {**LAYER, "region": REGION}),
    "Texture.resolve_to": Sample(method("many", "resolve_to"), {"target": (of("target"), own(rhi.Texture))}),
    "Texture.sampled": Sample(
        method("image", "sampled"), {"sampler": (of("sampler"), instance(rhi.Sampler, rhi.SamplerDescriptor))}
    ),
    "Texture.write": Sample(
        method("image", "write"),
        {"texels": (np.zeros((2, 2, 4), "u1"), nothing), **LAYER, "x": (0, natural), "y": (0, natural)},
    ),
    "Mesh.draws": Sample(method("mesh", "draws"), MANY_DRAWS),
    "Mesh.view": Sample(method("mesh", "view"), VIEW),
    "TransientMesh.draws": Sample(lambda house, **given: transient_mesh(house).draws(**given), MANY_DRAWS),
    "TransientMesh.view": Sample(lambda house, **given: transient_mesh(house).view(**given), VIEW),
    "Immediate.instances": immediate("instances", {"arrays": ({"color": np.zeros((2, 4), "f4")}, nothing)}),
    "Immediate.vertex": immediate(
        "vertex", {"position": ((0, 0, 0, 1), nothing), "color": ((0, 0, 0, 1), nothing)}
    ),
    "Immediate.vertices": immediate("vertices", {"arrays": (ROWS, nothing)}),
    "Program.draw": Sample(
        lambda house, mesh, instances, tint: house.program.draw(mesh, instances, tint=tint),
        {"mesh": MESH, "instances": (1, whole(0, 2**31 - 1)), "tint": TINT},
        within=in_pass,
    ),
    "Region": fields(Region, dict.fromkeys(("x", "y", "width", "height", "layer", "layers"), (1, whole()))),
    "SamplerDescriptor": fields(
        rhi.SamplerDescriptor,
        {
            "minify": (Filter.LINEAR, instance(Filter)),
            "magnify": (Filter.LINEAR, instance(Filter)),
            "mip": (Filter.LINEAR, optional(instance(Filter))),
            **{name: (Wrap.CLAMP, instance(Wrap)) for name in ("wrap_u", "wrap_v", "wrap_w")},
            "border": ((0, 0, 0, 1), nothing),
            "compare": (None, optional(instance(Comparison))),
            "max_anisotropy": (1, number(1)),
        },
    ),
    "IndirectDraws": fields(
        rhi.IndirectDraws,
        {
            "buffer": (of("draws"), instance(rhi.Buffer, rhi.StorageBuffer)),  # checked when they are drawn
            "draws": (1, whole()),
            "offset": (0, whole()),
            "stride": (20, whole()),
            "count": (None, optional(instance(rhi.Buffer, rhi.StorageBuffer))),
            "count_offset": (0, whole()),
        },
    ),
    "TextureTarget": Sample(
        lambda house, **given: house.device.render_pass(rhi.TextureTarget(**given)),
        {"texture": (of("image"), own(rhi.Texture)), **LAYER},
    ),
    "Sampler": Sample(
        lambda house, **given: house.image.sampled(rhi.Sampler(**given)),
        {
            "id": (lambda house: house.sampler.id, whole(1)),  # the descriptor decides
            "descriptor": (lambda house: house.sampler.descriptor, instance(rhi.SamplerDescriptor)),
        },
    ),
    "ProgramDescriptor": fields(
        rhi.ProgramDescriptor,
        {
            "name": LABEL,
            "stages": (frozenset({rhi.Stage.COMPUTE}), nothing),
            **dict.fromkeys(("bindings", "attributes", "outputs", "varyings"), ((), nothing)),
            "work_group": ((1, 1, 1), nothing),
            "emit": (len, lambda house, value: callable(value)),
            **dict.fromkeys(
                ("writes_memory", "discards", "early_depth", "writes_depth", "checked", "flushes_denormals",
                 "reads_point_coordinates"),
                (False, flag),
            ),
            "point_size": ("", LABEL[1]),
            "shared_bytes": (0, natural),
        },
    ),
    "FixedStack": fields(rhi.FixedStack, {"capacity": (4, whole(1, 1 << 40))}),
    "FixedQueue": fields(rhi.FixedQueue, {"capacity": (4, whole(1, 1 << 40))}),
    "AlphaReference": fields(rhi.AlphaReference, {"value": (0.5, number(0, 1))}),
    "ColorWrite": fields(
        rhi.ColorWrite, {**dict.fromkeys(("red", "green", "blue", "alpha"), (True, flag)), "target": TARGET}
    ),
    "ColorWrite.at": Sample(lambda house, target: rhi.ColorWrite.OFF.at(target), {"target": TARGET}),
    "BlendFunction": fields(
        rhi.BlendFunction,
        {
            "source": (BlendFactor.ONE, instance(BlendFactor)),
            "destination": (BlendFactor.ONE, instance(BlendFactor)),
            "operation": (BlendOperation.ADD, instance(BlendOperation)),
            "source_alpha": (None, optional(instance(BlendFactor))),
            "destination_alpha": (None, optional(instance(BlendFactor))),
            "operation_alpha": (None, optional(instance(BlendOperation))),
            "target": TARGET,
        },
    ),
    "BlendFunction.at": Sample(lambda house, target: rhi.BlendFunction.ALPHA.at(target), {"target": TARGET}),
    "BlendColor": fields(rhi.BlendColor, dict.fromkeys(("red", "green", "blue", "alpha"), (0.5, number()))),
    "StencilFront": fields(rhi.StencilFront, FACE),
    "StencilBack": fields(rhi.StencilBack, FACE),
    **{
        kind.__name__: fields(kind, {"front": (1, BYTE), "back": (1, BYTE)})
        for kind in (rhi.StencilReference, rhi.StencilReadMask, rhi.StencilWriteMask)
    },
    "Viewport": fields(
        rhi.Viewport,
        {
            **dict.fromkeys(("x", "y"), (1, number(-32_767, 32_767))),
            **dict.fromkeys(("width", "height"), (1, number(0, 16_384))),
            **dict.fromkeys(("near", "far"), (1, number(0, 1))),
        },
    ),
    "Scissor": fields(
        rhi.Scissor,
        {
            **dict.fromkeys(("x", "y"), (1, whole(-(2**30), 2**30))),
            **dict.fromkeys(("width", "height"), (1, whole(0, 2**30))),
        },
    ),
    "DepthBias": fields(rhi.DepthBias, {"units": (0.5, number())}),
    "LineWidth": fields(rhi.LineWidth, {"width": (1.5, number(1))}),
    "PolygonOffset": fields(rhi.PolygonOffset, {"slope": (0.5, number()), "clamp": (0.5, number())}),
}


# -- making a call -----------------------------------------------------------------------------------------


def run(house: House, sample: Sample, arguments: dict[str, Any]) -> None:
    """Make a call, and enter and leave the scope that it returns; destroy what it creates, but no view."""
    with ExitStack() as stack:
        sample.within(house, stack)
        made = sample.call(house, **arguments)
        if sample.enters:
            with made:
                pass
        viewed = getattr(made, "owner", None) or getattr(getattr(made, "data", None), "vertices", None)
        if hasattr(made, "destroy") and not house.owns(viewed) and viewed is not house.mesh.vertices:
            made.destroy()


def given_arguments(house: House, sample: Sample) -> dict[str, Any]:
    """Return the arguments of a call that works, by name."""
    made = {name: value for name, (value, _) in sample.parameters.items()}
    return {name: value(house) if inspect.isfunction(value) else value for name, value in made.items()}


def check_drawing(house: House) -> None:
    """Check that the device draws, and that no draw before it left anything that shifts or hides this one."""
    device = house.device
    assert not device.transient._core.locked
    with device.render_pass(house.target, clear=(0, 0, 0, 0)):
        device.draw(house.program, house.mesh, tint=house.tint)
        device.draw(house.plain, house.mesh)
    if device.capabilities.renders:
        assert_same(house.target.read(), 255)
