"""Validation of traces: whether each command is valid where it stands, and whether a device can execute it.

A device validates calls before they reach its backend, and backends rely on that. A trace may come from
anybody, so the same is checked here again, on plain data.

- `SequenceValidator` follows the commands while a file is loaded: resources exist and are what the contract's
  annotations say, passes, labels and queries are paired, and arguments obey the rules of
  `rhi.contract.limits`, as far as they are those of every device. Not checked is what only a driver knows
  (whether a shader compiles) and what only the GPU sees: indices, which devices clamp, and indirect
  arguments, which `replay` reads.
- `check_capabilities` checks a loaded trace by the same rules with the limits of the device that is to replay
  it, before the first command is issued; and that what draws and dispatches read exists and is as large as
  their program says. (A part of a trace, with bindings left out, still loads: it may be replayed where no
  shader runs.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, TypeAlias, TypeVar

from rhi.commands.context import StreamContext
from rhi.commands.ops import CREATIONS, DISPATCHES, DRAWS, WIDTHS, Descriptor, Op
from rhi.commands.stream import CommandStream
from rhi.contract import limits
from rhi.contract.backend import Capabilities
from rhi.contract.blocks import BLOCK
from rhi.contract.descriptors import (
    ALL_LAYERS,
    BindingKind,
    BufferDescriptor,
    Id,
    PassDescriptor,
    Primitive,
    ProgramDescriptor,
    QueryKind,
    Region,
    Stage,
    TextureDescriptor,
    TextureKind,
    VertexArrayDescriptor,
)
from rhi.contract.formats import Format
from rhi.contract.layout import VectorType
from rhi.contract.limits import ANY_DEVICE, Fault, Faults
from rhi.contract.states import PER_TARGET, PlatformState, StateChange
from rhi.device.resources.programs import shader_kind
from rhi.errors import refuse, rules
from rhi.shading.language.types import ImageType, TextureType
from rhi.trace.archive import ArchiveReader
from rhi.trace.ids import kinds_of
from rhi.trace.rules import TRACE_CAPABILITY, TRACE_REFERENCE, TRACE_SIZE

T = TypeVar("T")

MAX_MEMORY: Final = 4 << 30
"""Limit of the memory that resources of a trace occupy at the same time, in bytes."""
MAX_WORK: Final = 1 << 28
"""Limit of the vertices of a draw, all instances together, and of the invocations of a dispatch."""
MAX_LABELS: Final = 1 << 10


class InvalidCommandError(Exception):
    """The command is invalid at this point; the text gives the reason."""


class TooLargeError(Exception):
    """The command would exceed the memory that a trace may use."""


_INSIDE_PASS: Final = dict.fromkeys(DRAWS | {Op.END_PASS}, True) | dict.fromkeys(
    DISPATCHES | {Op.BEGIN_PASS, Op.PRESENT}, False
)
"""Whether a command belongs inside a pass, by op. Others belong everywhere."""
_CHANGES_BINDINGS: Final = CREATIONS | {
    Op.DESTROY,
    Op.BIND_PROGRAM,
    Op.BIND_UNIFORM,
    Op.BIND_STORAGE,
    Op.BIND_TEXTURE,
    Op.BIND_IMAGE,
}
_STAGES: Final = dict.fromkeys(DRAWS, Stage.VERTEX) | dict.fromkeys(DISPATCHES, Stage.COMPUTE)
"""The stage that a command executes, by op."""


def _count_bytes(descriptor: object) -> int:
    """Return at least the memory of a resource."""
    if isinstance(descriptor, BufferDescriptor):
        return descriptor.size
    if not isinstance(descriptor, TextureDescriptor):
        return 0
    width, height = descriptor.size
    texels = max(descriptor.format.texel_bytes, descriptor.format.transfer_bytes)
    return 2 * width * height * descriptor.layers * descriptor.samples * texels  # twice: levels


class SequenceValidator:
    """Validates the commands of a trace in order.

    Attributes:
        context: states, labels, bindings and resources after the commands so far.
    """

    def __init__(self) -> None:
        self.context = StreamContext()
        self._used: set[Id] = set()
        self._valid: set[tuple[Any, ...]] = set()
        self._memory: dict[Id, int] = {}
        self._total = 0
        self._signalled = 0

    def check(self, op: Op, values: Sequence[Any], failed: bool, where: str, reader: ArchiveReader) -> None:
        """Refuse the file if this command isn't valid next. A command that `failed` when it was recorded has
        no effect, and may have requested more memory than there was."""
        before = self._total, self._signalled
        rule = _RULES[op]
        try:
            self._check_scope(op)
            command = (op, *values) if op in _RECURRING else ()
            if command not in self._valid:
                self._check_arguments(op, values)
                if command:
                    self._valid.add(command)
            if rule is not None:
                rule(self, *values)
            if op in CREATIONS:
                self._create(values[0], _count_bytes(values[1]))
        except InvalidCommandError as error:
            reader.refuse(
                TRACE_REFERENCE,
                f"{where}: {op.method}: {error}",
                "a command that a device can issue at this point",
            )
        except TooLargeError as error:
            if not failed:
                reader.refuse(TRACE_SIZE, f"{where}: {op.method}: {error}", f"{MAX_MEMORY:,} bytes")
        if failed:
            self._total, self._signalled = before
        else:
            self.context.apply(op, values)

    # -- every command ---------------------------------------------------------------------------------------

    def _check_scope(self, op: Op) -> None:
        """Check that a command belongs inside or outside a pass, and that a program of its kind is bound."""
        if op in _INSIDE_PASS:
            is_open = self.context.render_pass is not None
            _require(
                is_open is _INSIDE_PASS[op], "inside a render pass" if is_open else "outside a render pass"
            )
        if op in _STAGES:
            bound = self._lookup(self.context.program, ProgramDescriptor)
            _require(_STAGES[op] in bound.stages, "a program of another kind is bound")

    def _check_arguments(self, op: Op, values: Sequence[Any]) -> None:
        """Check that the resources exist and are what the contract says, that a new one has a new id, and the
        arguments by the rules of `rhi.contract.limits`."""
        for value in values:
            if type(value) is int and abs(value) > 1 << 53:
                raise InvalidCommandError(f"{value} is out of range")
        kinds = kinds_of(op, values)
        if op in CREATIONS:
            new, _ = next(kinds)
            _require(new > 0 and new not in self._used, f"id {new} was used before")
        for resource, kind in kinds:
            self._lookup(resource, kind)
        if op in _ALL_FAULTS:
            for fault in _ALL_FAULTS[op](self.context.resources, ANY_DEVICE, *values):
                raise InvalidCommandError(f"{fault.given}, allowed: {fault.allowed or fault.rule.sentence}")

    def _lookup(self, resource: Id, kind: type[T]) -> T:
        descriptor: Any = self.context.resources.get(resource)
        if descriptor is None:
            raise InvalidCommandError(f"no resource has the id {resource}")
        if not isinstance(descriptor, kind):
            raise InvalidCommandError(
                f"id {resource} is a {type(descriptor).__name__}, not a {kind.__name__}"
            )
        return descriptor

    def _create(self, resource: Id, size: int) -> None:
        self._total += size
        if self._total > MAX_MEMORY:
            raise TooLargeError(f"resources of {self._total:,} bytes")
        self._used.add(resource)
        self._memory[resource] = size

    # -- commands whose rules depend on earlier ones ---------------------------------------------------------

    def draw(self, vertex_array: Id, *_: object) -> None:
        resources = self._lookup(vertex_array, VertexArrayDescriptor)
        _require(resources.program == self.context.program, "the vertex array of another program")
        buffers = {stream.buffer for stream in resources.streams} | ({resources.index_buffer} - {0})
        _require(buffers <= self.context.resources.keys(), "a buffer of the vertex array was destroyed")

    def draw_indirect(self, vertex_array: Id, primitive: Primitive, *_: object) -> None:
        self.draw(vertex_array)
        _require(primitive is not Primitive.QUADS, "an indirect draw of quads")

    def dispatch(self, *groups: int) -> None:
        program = self._lookup(self.context.program, ProgramDescriptor)
        for fault in excessive_work_faults(math.prod(groups) * math.prod(program.work_group)):
            raise InvalidCommandError(f"{fault.given}, allowed: {fault.allowed}")

    def destroy(self, resource: Id) -> None:
        self._valid.clear()
        open_pass = self.context.render_pass
        if open_pass is not None:
            _require(
                resource not in {id for id, _ in kinds_of(Op.BEGIN_PASS, (open_pass,))},
                "a target of the open pass",
            )
        _require(resource not in (self.context.open_query, self.context.condition), "a query that is open")
        self._total -= self._memory[resource]

    def signal(self, value: int) -> None:
        _require(value > self._signalled, f"{value} after {self._signalled}")
        self._signalled = value

    def wait(self, value: int, seconds: float) -> None:
        _require(0 <= value <= self._signalled, f"for {value}, signalled is {self._signalled}")

    def begin_query(self, query: Id) -> None:
        _require(self._lookup(query, QueryKind) is QueryKind.OCCLUSION, "not an occlusion query")
        _require(not self.context.open_query, "another query is open")

    def end_query(self, query: Id) -> None:
        _require(query == self.context.open_query, "the query isn't open")

    def write_query(self, query: Id) -> None:
        _require(self._lookup(query, QueryKind) is not QueryKind.OCCLUSION, "an occlusion query")

    def begin_conditional(self, query: Id, inverted: bool) -> None:
        _require(self._lookup(query, QueryKind) is QueryKind.OCCLUSION, "not an occlusion query")
        _require(not self.context.condition, "another condition is open")

    def end_conditional(self) -> None:
        _require(bool(self.context.condition), "no condition is open")

    def push_label(self, text: str) -> None:
        _require(len(self.context.labels) < MAX_LABELS, "too many labels")

    def pop_label(self) -> None:
        _require(bool(self.context.labels), "no label is open")


def _require(condition: bool, otherwise: str) -> None:
    if not condition:
        raise InvalidCommandError(otherwise)


_RULES: Final[tuple[Callable[..., None] | None, ...]] = tuple(
    getattr(SequenceValidator, op.method, None) for op in Op
)


# -- commands whose rules depend on their arguments only, and the limits of a device -------------------------

_Resources: TypeAlias = Mapping[Id, Any]
"""The descriptors of the resources that were created so far."""


def _buffer_range(resources: _Resources, buffer: Id, offset: int, size: int) -> Faults:
    whole = resources[buffer].size
    if offset < 0 or size < 0 or offset + size > whole:
        yield Fault(rules.BUFFER_RANGE, f"bytes {offset} to {offset + size}", f"within {whole} bytes")


def _create_buffer(
    resources: _Resources, device: Capabilities, buffer: Id, descriptor: BufferDescriptor
) -> Faults:
    if descriptor.size <= 0:
        yield Fault(rules.BUFFER_SIZE, f"{descriptor.size} bytes", "1 or more")


def _create_program(
    resources: _Resources, device: Capabilities, program: Id, descriptor: ProgramDescriptor
) -> Faults:
    stages = descriptor.stages
    if stages != {Stage.COMPUTE} and (Stage.VERTEX not in stages or Stage.COMPUTE in stages):
        yield Fault(
            rules.PROGRAM_STAGE, limits.show_stages(descriptor), "a vertex stage, or a compute stage alone"
        )
    yield from limits.program_faults(descriptor, device)


def _create_vertex_array(
    resources: _Resources, device: Capabilities, vertex_array: Id, descriptor: VertexArrayDescriptor
) -> Faults:
    yield from limits.vertex_array_faults(descriptor, lambda buffer: int(resources[buffer].size))
    attributes = [attribute for stream in descriptor.streams for attribute in stream.attributes]
    inputs = {attribute.location: attribute.type for attribute in resources[descriptor.program].attributes}
    if sorted(attribute.location for attribute in attributes) != sorted(inputs):
        yield Fault(rules.MESH_ATTRIBUTE, f"{attributes}", f"each of the locations {sorted(inputs)} once")
    if not all(stream.attributes for stream in descriptor.streams):
        yield Fault(rules.MESH_DATA, "a stream without attributes", "one or more in each")
    for attribute in attributes:
        input_type = inputs[attribute.location]
        size, scalar = (
            (input_type.size, input_type.scalar) if isinstance(input_type, VectorType) else (1, input_type)
        )
        if attribute.format.components < size or attribute.format.kind != str(scalar):
            yield Fault(rules.MESH_ATTRIBUTE, f"{attribute}", f"as {input_type}")


def _clear_buffer(
    resources: _Resources, device: Capabilities, buffer: Id, offset: int, size: int, value: int
) -> Faults:
    yield from _buffer_range(resources, buffer, offset, size)
    if offset % 4 or size % 4:
        yield Fault(rules.BUFFER_ALIGNMENT, f"{size} bytes at {offset}", "whole words")


def _copy_buffer(
    resources: _Resources,
    device: Capabilities,
    source: Id,
    offset: int,
    target: Id,
    target_offset: int,
    size: int,
) -> Faults:
    sizes = (resources[source].size, offset, resources[target].size, target_offset, size)
    return limits.buffer_copy_faults(*sizes, source == target, device)


def _write_texture(
    resources: _Resources, device: Capabilities, texture: Id, level: int, region: Region, data: bytes
) -> Faults:
    descriptor: TextureDescriptor = resources[texture]
    yield from limits.written_faults(descriptor)
    yield from limits.region_faults(descriptor, level, region)
    yield from limits.single_sample_faults(descriptor)
    byte_count = region.width * region.height * region.layers * descriptor.format.transfer_bytes
    if descriptor.compressed is not None:
        columns, rows = -(-region.width // BLOCK), -(-region.height // BLOCK)
        byte_count = columns * rows * region.layers * descriptor.compressed.block_bytes
        width, height = descriptor.level_size(level)
        right, bottom = region.x + region.width, region.y + region.height
        inner = [
            region.x,
            region.y,
            *([right] if right < width else []),
            *([bottom] if bottom < height else []),
        ]
        if any(edge % BLOCK for edge in inner):
            yield Fault(rules.TEXTURE_REGION, f"{region}", f"whole blocks of {width}×{height} texels")
    if len(data) != byte_count:
        yield Fault(rules.TEXTURE_DATA, f"{len(data)} bytes", f"{byte_count}")


def _copy_texture(
    resources: _Resources,
    device: Capabilities,
    source: Id,
    level: int,
    region: Region,
    target: Id,
    target_level: int,
    x: int,
    y: int,
    layer: int,
) -> Faults:
    end = Region(x, y, region.width, region.height, layer, region.layers)
    return limits.texture_copy_faults(
        resources[source], level, region, resources[target], target_level, end, source == target
    )


def _copy_texture_to_buffer(
    resources: _Resources,
    device: Capabilities,
    source: Id,
    level: int,
    region: Region,
    target: Id,
    offset: int,
    row_bytes: int,
) -> Faults:
    return limits.row_faults(
        resources[source], level, region, offset, row_bytes, resources[target].size, device
    )


def _copy_buffer_to_texture(
    resources: _Resources,
    device: Capabilities,
    source: Id,
    offset: int,
    row_bytes: int,
    target: Id,
    level: int,
    region: Region,
) -> Faults:
    yield from limits.written_faults(resources[target])
    yield from limits.row_faults(
        resources[target], level, region, offset, row_bytes, resources[source].size, device
    )


def _begin_pass(resources: _Resources, device: Capabilities, descriptor: PassDescriptor) -> Faults:
    targets = [target for target in (*descriptor.colors, descriptor.depth) if target is not None]
    if not targets:
        yield Fault(rules.PASS_EMPTY, "no color and no depth", "a target")
    for target in targets:
        yield from limits.level_faults(
            resources[target.texture], target.level, 0 if target.layer == ALL_LAYERS else target.layer
        )
    yield from limits.pass_faults(descriptor, resources, device)


def _set_states(resources: _Resources, device: Capabilities, changes: Sequence[StateChange]) -> Faults:
    for kind, value in changes:
        if kind is PlatformState and device is ANY_DEVICE:
            continue  # the file's reader knows this state, so some device has it
        states: Any = value if isinstance(value, tuple) else (value,)
        if kind in PER_TARGET and len(set(states)) > 1:
            states = [state.at(target) for target, state in enumerate(states)]
        for state in states:
            yield from limits.state_faults(state, device)


def _slot(slots: str, resources: _Resources, device: Capabilities, slot: int, *_: int) -> Faults:
    most = getattr(device, slots)
    if not 0 <= slot < most:
        yield Fault(rules.DEVICE_CAPABILITY, f"slot {slot}", f"{most} slots")


def _bind_range(
    kind: BindingKind,
    slots: str,
    resources: _Resources,
    device: Capabilities,
    slot: int,
    buffer: Id,
    offset: int,
    size: int,
) -> Faults:
    yield from _slot(slots, resources, device, slot)
    yield from _buffer_range(resources, buffer, offset, size)
    yield from limits.range_faults(kind, offset, size, 0, device)


def _bind_image(
    resources: _Resources, device: Capabilities, slot: int, texture: Id, level: int, layer: int
) -> Faults:
    yield from _slot("max_image_slots", resources, device, slot)
    yield from limits.plain_faults(resources[texture])
    yield from limits.level_faults(resources[texture], level, max(layer, 0))


def _draw(
    resources: _Resources,
    device: Capabilities,
    vertex_array: Id,
    primitive: object,
    first: int,
    count: int,
    instances: int,
    base_vertex: int,
    base_instance: int,
) -> Faults:
    descriptor: VertexArrayDescriptor = resources[vertex_array]
    elements = count_vertex_array_elements(resources, descriptor)
    numbers = (first, count, instances, base_vertex, base_instance)
    yield from limits.draw_faults(elements, bool(descriptor.index_buffer), *numbers)
    yield from excessive_work_faults(count * instances)


def count_vertex_array_elements(
    resources: Mapping[Id, Any], descriptor: VertexArrayDescriptor
) -> limits.ElementCounts:
    """Return the number of elements in the buffers of a vertex array; one that was destroyed holds none."""
    return limits.count_elements(
        descriptor, lambda buffer: resources[buffer].size if buffer in resources else 0
    )


def excessive_work_faults(elements: int) -> Faults:
    """Yield that a command would run for very long."""
    if elements > MAX_WORK:
        yield Fault(
            rules.DRAW_COUNT, f"{elements:,} vertices or invocations", f"up to {MAX_WORK:,} in one command"
        )


def _draw_indirect(
    resources: _Resources,
    device: Capabilities,
    vertex_array: Id,
    primitive: object,
    buffer: Id,
    offset: int,
    draws: int,
    stride: int,
    count_buffer: Id,
    count_offset: int,
) -> Faults:
    yield from limits.indirect_faults(draws, offset, stride, count_offset, resources[buffer].size)
    if count_buffer:
        yield from limits.count_faults(count_offset, resources[count_buffer].size, device)


def _dispatch(resources: _Resources, device: Capabilities, *groups: int) -> Faults:
    if 0 in groups:
        yield Fault(rules.DISPATCH_SIZE, f"{groups}", "no empty dispatch")
    yield from limits.dispatch_faults(groups, f"{groups}", device)


_FAULTS: Final[dict[Op, Callable[..., Faults]]] = {
    Op.CREATE_BUFFER: _create_buffer,
    Op.CREATE_VERTEX_ARRAY: _create_vertex_array,
    Op.WRITE_BUFFER: lambda resources, device, buffer, offset, data: _buffer_range(
        resources, buffer, offset, len(data)
    ),
    Op.READ_BUFFER: lambda resources, device, *range_of_bytes: _buffer_range(resources, *range_of_bytes),
    Op.CLEAR_BUFFER: _clear_buffer,
    Op.WRITE_TEXTURE: _write_texture,
    Op.READ_TEXTURE: lambda resources, device, texture, *region: limits.read_faults(
        resources[texture], *region
    ),
    Op.COPY_TEXTURE: _copy_texture,
    Op.RESOLVE_TEXTURE: lambda resources, device, source, target: limits.resolve_faults(
        resources[source], resources[target], device
    ),
    Op.GENERATE_MIPMAPS: lambda resources, device, texture: limits.mipmap_faults(resources[texture]),
    Op.DRAW: _draw,
    Op.DISPATCH_INDIRECT: lambda resources, device, buffer, at: limits.indirect_dispatch_faults(
        at, resources[buffer].size
    ),
}
"""By op, the function of existing resources, device and the op's arguments that yields the faults: here on
any device."""
_LIMIT_FAULTS: Final[dict[Op, Callable[..., Faults]]] = {
    Op.CREATE_TEXTURE: lambda resources, device, texture, descriptor: limits.texture_faults(
        descriptor, device
    ),
    Op.CREATE_SAMPLER: lambda resources, device, sampler, descriptor: limits.sampler_faults(
        descriptor, device
    ),
    Op.CREATE_PROGRAM: _create_program,
    Op.CREATE_QUERY: lambda resources, device, query, kind: limits.query_faults(kind, device),
    Op.COPY_BUFFER: _copy_buffer,
    Op.COPY_TEXTURE_TO_BUFFER: _copy_texture_to_buffer,
    Op.COPY_BUFFER_TO_TEXTURE: _copy_buffer_to_texture,
    Op.BEGIN_PASS: _begin_pass,
    Op.SET_STATES: _set_states,
    Op.BIND_UNIFORM: partial(_bind_range, BindingKind.UNIFORM, "max_uniform_slots"),
    Op.BIND_STORAGE: partial(_bind_range, BindingKind.STORAGE, "max_storage_slots"),
    Op.BIND_TEXTURE: partial(_slot, "max_texture_slots"),
    Op.BIND_IMAGE: _bind_image,
    Op.DRAW_INDIRECT: _draw_indirect,
    Op.DISPATCH: _dispatch,
    Op.BEGIN_CONDITIONAL: lambda resources, device, query, inverted: limits.condition_faults(device),
}
"""Here on a device with these limits."""
_ALL_FAULTS: Final = _FAULTS | _LIMIT_FAULTS
_RECURRING: Final = frozenset(_LIMIT_FAULTS.keys() - CREATIONS | {Op.DRAW, Op.BIND_PROGRAM})
"""Commands that a trace repeats with equal arguments. They stay valid until a resource is destroyed."""


def binding_faults(context: StreamContext) -> Faults:
    """Yield bindings of the program that are missing, destroyed or too small."""
    program = context.resources.get(context.program)
    for binding in program.bindings if isinstance(program, ProgramDescriptor) else ():
        bound = context.slots.get((binding.kind, binding.slot))
        if bound is None or bound[0] not in context.resources:
            yield Fault(
                rules.BINDING_MISSING, f"nothing in {binding.kind.value} slot {binding.slot}", binding.name
            )
            return
        resources: Any = context.resources[bound[0]]
        if isinstance(resources, TextureDescriptor):
            layered = binding.kind is BindingKind.TEXTURE or bound[2] < 0
            kind = resources.kind if layered else TextureKind.D2
            if not _fits_type(binding.type, kind, resources.format):
                yield Fault(
                    rules.BINDING_TYPE,
                    f"{kind.value} of {resources.format.name}",
                    f"{binding.name}: {binding.type}",
                )
            several = isinstance(binding.type, TextureType) and binding.type.samples
            if (resources.samples > 1) != several:
                allowed = f"{binding.name}: {'several' if several else 1}"
                yield Fault(rules.BINDING_TYPE, f"{resources.samples} samples", allowed)
        elif binding.kind is BindingKind.UNIFORM and bound[2] < binding.size:
            yield Fault(rules.BINDING_SIZE, f"{bound[2]} bytes", f"{binding.name}: {binding.size}")


def _fits_type(type: object, kind: TextureKind, format: Format) -> bool:
    """True if a texture of this kind and format fits a binding of this type. Old files name some types by
    texts that say nothing of formats; anything fits those."""
    if isinstance(type, TextureType):
        return type.kind is kind and str(type.scalar) == shader_kind(format)
    if isinstance(type, ImageType):
        return type.kind is kind and type.format is format
    return True


def check_capabilities(stream: CommandStream, device: Capabilities) -> None:
    """Refuse a trace that a device can't replay, and name the first command that it doesn't support.

    Raises:
        ValidationError: `trace-capability`; `trace-reference` for a draw or dispatch whose bindings aren't
            there, on a device that runs shaders.
    """
    resources: dict[Id, Descriptor] = {}
    checked: set[tuple[Any, ...]] = set()
    context, bound = StreamContext(), False
    offset, index, data, failures = 0, 0, stream.data, stream.failures
    while offset < len(data):
        op = data[offset]
        end = offset + WIDTHS[op] - 2
        if op in CREATIONS:
            resources[data[offset + 1]] = data[offset + 2]
        if op in _LIMIT_FAULTS:
            entry = tuple(data[offset:end])
            if entry not in checked:
                checked.add(entry)
                for fault in _LIMIT_FAULTS[op](resources, device, *entry[1:]):
                    given = f"command {index}: {stream[index]}: {fault.given}"
                    refuse(TRACE_CAPABILITY, f"rhi.trace.replay on {device.backend}", given, fault.allowed)
        if device.shading and index not in failures:
            if op in _CHANGES_BINDINGS:
                context.apply(op, data[offset + 1 : end])
                bound = False
            elif op in _STAGES and not bound:
                for fault in binding_faults(context):
                    given = f"command {index}: {stream[index]}: {fault.given}"
                    refuse(TRACE_REFERENCE, f"rhi.trace.replay on {device.backend}", given, fault.allowed)
                bound = True
        offset, index = end + 2, index + 1
