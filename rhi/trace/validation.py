"""Validation of traces: whether each command is valid where it stands, and whether a device can execute it.

A device validates calls before they reach its backend, and backends rely on that. A trace may come from anybody, so the
same is checked here again, on plain data.

- `SequenceValidator` follows the commands while a file is loaded: resources exist and have the right type, ranges lie
  inside them, passes, labels and queries are paired, and descriptors are possible. Not checked is what only a driver
  knows (whether a shader compiles) and what only the GPU sees (the values of indices and indirect arguments).
- `check_capabilities` compares a loaded trace with the limits of the device that is to replay it, before the first
  command is issued.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, TypeVar

from rhi.commands.context import StreamContext
from rhi.commands.ops import WIDTHS, Op
from rhi.commands.stream import CommandStream
from rhi.contract.backend import Capabilities
from rhi.contract.blocks import BLOCK
from rhi.contract.descriptors import (
    DRAW,
    BufferDescriptor,
    Id,
    PassDescriptor,
    ProgramDescriptor,
    QueryKind,
    Region,
    SamplerDescriptor,
    Stage,
    TextureDescriptor,
    TextureKind,
    VertexArrayDescriptor,
)
from rhi.contract.states import AlphaTest, AlphaToCoverage, LineWidth, PlatformState, PolygonMode, StencilTest
from rhi.errors import refuse
from rhi.trace.archive import ArchiveReader
from rhi.trace.rules import TRACE_CAPABILITY, TRACE_REFERENCE, TRACE_SIZE

__rhi_internal__ = True

T = TypeVar("T")

MAX_MEMORY: Final = 16 << 30
"""Limit of the memory that resources of a trace occupy at the same time, in bytes."""
MAX_TEXTURE: Final = 1 << 16
MAX_SLOT: Final = 1 << 10
MAX_COUNT: Final = 1 << 32
MAX_LABELS: Final = 1 << 10

_QUERY_CAPABILITIES: Final = {
    QueryKind.OCCLUSION: "occlusion_queries",
    QueryKind.COUNTER: "sample_counter",
    QueryKind.TIMESTAMP: "timestamps",
}
_STATE_CAPABILITIES: Final = {
    AlphaTest.ON: "alpha_test",
    StencilTest.ON: "stencil",
    AlphaToCoverage.ON: "alpha_to_coverage",
    PolygonMode.LINE: "wireframe",
}


class InvalidCommandError(Exception):
    """The command is invalid at this point; the text gives the reason."""


class TooLargeError(Exception):
    """The command would exceed the memory that a trace may use."""


class SequenceValidator:
    """Validates the commands of a trace in order.

    Attributes:
        context: states, labels, bindings and resources after the commands so far.
    """

    def __init__(self) -> None:
        self.context = StreamContext()
        self._used: set[Id] = set()
        self._memory: dict[Id, int] = {}
        self._total = 0
        self._query: Id = 0
        self._conditional = False
        self._signalled = 0

    def check(self, op: Op, values: Sequence[Any], failed: bool, where: str, reader: ArchiveReader) -> None:
        """Refuse the file if this command isn't valid next. A command that `failed` when it was recorded has no effect,
        and may have requested more memory than there was."""
        before = self._total, self._query, self._conditional, self._signalled
        rule = getattr(self, f"_{op.method}", None)
        try:
            for value in values:
                if type(value) is int and abs(value) > 1 << 53:
                    raise InvalidCommandError(f"{value} is out of range")
            if rule is not None:
                rule(*values)
        except InvalidCommandError as error:
            reader.refuse(TRACE_REFERENCE, f"{where}: {op.method}: {error}", "what a device would have issued")
        except TooLargeError as error:
            if not failed:
                reader.refuse(TRACE_SIZE, f"{where}: {op.method}: {error}", f"{MAX_MEMORY:,} bytes")
        if failed:
            self._total, self._query, self._conditional, self._signalled = before
        else:
            self.context.follow(op, values)

    # -- conditions -------------------------------------------------------------------------------------

    def _find(self, resource: Id, kind: type[T]) -> T:
        found = self.context.resources.get(resource)
        if not isinstance(found, kind):
            what = "nothing" if found is None else f"a {type(found).__name__}"
            raise InvalidCommandError(f"id {resource} is {what}, not a {kind.__name__}")
        return found

    def _need(self, condition: bool, otherwise: str) -> None:
        if not condition:
            raise InvalidCommandError(otherwise)

    def _create(self, resource: Id, size: int = 0) -> None:
        self._need(resource > 0 and resource not in self._used, f"id {resource} was used before")
        self._total += size
        if self._total > MAX_MEMORY:
            raise TooLargeError(f"resources of {self._total:,} bytes")
        self._used.add(resource)
        self._memory[resource] = size

    def _range(self, buffer: Id, offset: int, size: int) -> None:
        descriptor = self._find(buffer, BufferDescriptor)
        if not (offset >= 0 and size >= 0 and offset + size <= descriptor.size):
            raise InvalidCommandError(f"bytes {offset} to {offset + size} of a buffer of {descriptor.size}")

    def _region(self, texture: Id, level: int, region: Region) -> TextureDescriptor:
        descriptor = self._find(texture, TextureDescriptor)
        self._level(descriptor, level, region.layer, region.layers)
        width, height = descriptor.level_size(level)
        fits = (
            region.x >= 0 and region.y >= 0 and region.width > 0 and region.height > 0
            and region.x + region.width <= width and region.y + region.height <= height
        )  # fmt: skip
        self._need(fits, f"{region} of a level of {width}×{height}")
        return descriptor

    def _level(self, descriptor: TextureDescriptor, level: int, layer: int, layers: int = 1) -> None:
        self._need(0 <= level < descriptor.levels, f"level {level} of {descriptor.levels}")
        most = descriptor.level_layers(level)
        self._need(layer >= 0 and layers > 0 and layer + layers <= most, f"layer {layer} of {most}")

    def _outside(self) -> None:
        self._need(self.context.render_pass is None, "inside a render pass")

    def _inside(self) -> None:
        self._need(self.context.render_pass is not None, "outside a render pass")

    # -- creation ------------------------------------------------------------------------------------------

    def _create_buffer(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        self._need(descriptor.size > 0, f"{descriptor.size} bytes")
        self._create(buffer, descriptor.size)

    def _create_texture(self, texture: Id, descriptor: TextureDescriptor) -> None:
        width, height = descriptor.size
        layers, levels, samples = descriptor.layers, descriptor.levels, descriptor.samples
        sizes = (width, height, layers)
        self._need(all(0 < size <= MAX_TEXTURE for size in sizes), f"{width}×{height}, {layers} layers")
        longest = max(width, height, layers if descriptor.kind is TextureKind.D3 else 1)
        self._need(0 < levels <= longest.bit_length(), f"{levels} levels")
        self._need(samples in (1, 2, 4, 8, 16, 32), f"{samples} samples")
        if descriptor.kind is TextureKind.D2:
            self._need(layers == 1, f"{layers} layers of a 2D texture")
        if descriptor.kind is TextureKind.CUBE:
            self._need(layers == 6 and width == height, f"a cube of {width}×{height}, {layers} layers")
        texels = max(descriptor.format.texel_bytes, descriptor.format.transfer_bytes)
        self._create(texture, 2 * width * height * layers * samples * texels)  # twice: levels

    def _create_sampler(self, sampler: Id, descriptor: SamplerDescriptor) -> None:
        self._create(sampler)

    def _create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        stages = descriptor.stages
        graphics = Stage.VERTEX in stages and Stage.COMPUTE not in stages
        self._need(graphics or stages == {Stage.COMPUTE}, f"stages {sorted(stage.value for stage in stages)}")
        self._create(program)

    def _create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        self._find(descriptor.program, ProgramDescriptor)
        for stream in descriptor.streams:
            self._range(stream.buffer, stream.offset, 0)
            self._need(0 <= stream.stride < MAX_SLOT * 16, f"stride {stream.stride}")
            for attribute in stream.attributes:
                self._need(0 <= attribute.location < MAX_SLOT and attribute.offset >= 0, f"{attribute}")
        if descriptor.index_buffer:
            self._find(descriptor.index_buffer, BufferDescriptor)
        self._create(vertex_array)

    def _create_query(self, query: Id, kind: QueryKind) -> None:
        self._create(query)

    def _destroy(self, resource: Id) -> None:
        self._need(resource in self.context.resources, f"id {resource} doesn't exist")
        self._total -= self._memory.pop(resource)

    # -- memory --------------------------------------------------------------------------------------------

    def _write_buffer(self, buffer: Id, offset: int, data: bytes) -> None:
        self._range(buffer, offset, len(data))

    def _read_buffer(self, buffer: Id, offset: int, size: int) -> None:
        self._range(buffer, offset, size)

    def _copy_buffer(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        self._range(source, source_offset, size)
        self._range(target, target_offset, size)

    def _clear_buffer(self, buffer: Id, offset: int, size: int, value: int) -> None:
        self._range(buffer, offset, size)
        self._need(offset % 4 == 0 and size % 4 == 0, "not in whole words")

    def _write_texture(self, texture: Id, level: int, region: Region, data: bytes) -> None:
        descriptor = self._region(texture, level, region)
        self._need(not descriptor.format.is_depth and descriptor.samples == 1, f"{descriptor.format.name}")
        wanted = region.width * region.height * region.layers * descriptor.format.transfer_bytes
        if descriptor.compressed is not None:
            columns, rows = -(-region.width // BLOCK), -(-region.height // BLOCK)
            wanted = columns * rows * region.layers * descriptor.compressed.block_bytes
            self._need(region.x % BLOCK == 0 and region.y % BLOCK == 0, f"{region} of blocks")
        self._need(len(data) == wanted, f"{len(data)} bytes instead of {wanted}")

    def _read_texture(self, texture: Id, level: int, region: Region, stencil: bool) -> None:
        descriptor = self._region(texture, level, region)
        self._need(descriptor.samples == 1, "several samples")
        self._need(not stencil or descriptor.format.has_stencil, "no stencil")

    def _copy_texture(
        self, source: Id, source_level: int, source_region: Region, target: Id, target_level: int, x: int, y: int,
        layer: int,
    ) -> None:  # fmt: skip
        region = source_region
        taken = self._region(source, source_level, region)
        target_region = Region(x, y, region.width, region.height, layer, region.layers)
        given = self._region(target, target_level, target_region)
        self._need(taken.format is given.format and taken.samples == given.samples, "different formats")

    def _copy_texture_to_buffer(
        self, source: Id, level: int, region: Region, target: Id, offset: int, row_bytes: int
    ) -> None:
        self._rows(self._region(source, level, region), region, target, offset, row_bytes)

    def _copy_buffer_to_texture(
        self, source: Id, offset: int, row_bytes: int, target: Id, level: int, region: Region
    ) -> None:
        descriptor = self._region(target, level, region)
        self._need(not descriptor.format.is_depth, descriptor.format.name)
        self._rows(descriptor, region, source, offset, row_bytes)

    def _rows(
        self, texture: TextureDescriptor, region: Region, buffer: Id, offset: int, row_bytes: int
    ) -> None:
        texel = texture.format.transfer_bytes
        self._need(texture.samples == 1, "several samples")
        fits = row_bytes >= region.width * texel and row_bytes % texel == 0 and offset % texel == 0
        self._need(fits, f"rows of {row_bytes} bytes at {offset}")
        rows = region.height * region.layers
        self._range(buffer, offset, (rows - 1) * row_bytes + region.width * texel)

    def _resolve_texture(self, source: Id, target: Id) -> None:
        taken, given = self._find(source, TextureDescriptor), self._find(target, TextureDescriptor)
        fits = taken.size == given.size and taken.format is given.format and given.samples == 1
        self._need(fits, "different sizes or formats")

    def _generate_mipmaps(self, texture: Id) -> None:
        self._find(texture, TextureDescriptor)

    # -- passes and bindings ---------------------------------------------------------------------------------

    def _begin_pass(self, descriptor: PassDescriptor) -> None:
        self._outside()
        attachments: list[Any] = [*descriptor.colors, *([descriptor.depth] if descriptor.depth is not None else [])]
        self._need(bool(attachments), "no target")
        for attachment in attachments:
            texture = self._find(attachment.texture, TextureDescriptor)
            self._level(texture, attachment.level, attachment.layer)
            self._need(texture.level_size(attachment.level) == descriptor.size, f"targets of {descriptor.size}")
            is_depth = attachment is descriptor.depth
            self._need(texture.format.is_depth is is_depth, f"{texture.format.name} as target")
            resolve = getattr(attachment, "resolve", 0)
            if resolve:
                fits = self._find(resolve, TextureDescriptor).size == descriptor.size
                self._need(fits, "resolved to another size")

    def _end_pass(self) -> None:
        self._inside()

    def _bind_program(self, program: Id) -> None:
        self._find(program, ProgramDescriptor)

    def _slot(self, slot: int) -> None:
        self._need(0 <= slot < MAX_SLOT, f"slot {slot}")

    def _bind_uniform(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self._slot(slot)
        self._range(buffer, offset, size)

    _bind_storage = _bind_uniform

    def _bind_texture(self, slot: int, texture: Id, sampler: Id) -> None:
        self._slot(slot)
        self._find(texture, TextureDescriptor)
        self._find(sampler, SamplerDescriptor)

    def _bind_image(self, slot: int, texture: Id, level: int, layer: int) -> None:
        self._slot(slot)
        self._level(self._find(texture, TextureDescriptor), level, max(layer, 0))

    # -- work ------------------------------------------------------------------------------------------------

    def _drawable(self, vertex_array: Id) -> None:
        self._inside()
        self._find(vertex_array, VertexArrayDescriptor)
        program = self._find(self.context.program, ProgramDescriptor)
        self._need(Stage.VERTEX in program.stages, "a compute program is bound")

    def _draw(
        self, vertex_array: Id, primitive: object, first: int, count: int, instances: int, base_vertex: int,
        base_instance: int,
    ) -> None:  # fmt: skip
        self._drawable(vertex_array)
        numbers = (first, count, instances, base_instance)
        self._need(all(0 <= number < MAX_COUNT for number in numbers), f"{numbers}")

    def _draw_indirect(
        self, vertex_array: Id, primitive: object, buffer: Id, offset: int, draws: int, stride: int,
        count_buffer: Id, count_offset: int,
    ) -> None:  # fmt: skip
        self._drawable(vertex_array)
        fits = draws > 0 and stride >= DRAW.itemsize and stride % 4 == 0 and offset % 4 == 0
        self._need(fits, f"{draws} draws, {stride} apart")
        self._range(buffer, offset, (draws - 1) * stride + DRAW.itemsize)
        if count_buffer:
            self._range(count_buffer, count_offset, 4)

    def _dispatchable(self) -> None:
        self._outside()
        program = self._find(self.context.program, ProgramDescriptor)
        self._need(Stage.COMPUTE in program.stages, "a graphics program is bound")

    def _dispatch(self, x: int, y: int, z: int) -> None:
        self._dispatchable()
        self._need(min(x, y, z) > 0, f"{x}×{y}×{z} groups")

    def _dispatch_indirect(self, buffer: Id, offset: int) -> None:
        self._dispatchable()
        self._range(buffer, offset, 12)

    # -- time ------------------------------------------------------------------------------------------------

    def _signal(self, value: int) -> None:
        self._need(value > self._signalled, f"{value} after {self._signalled}")
        self._signalled = value

    def _wait(self, value: int, seconds: float) -> None:
        self._need(0 <= value <= self._signalled, f"for {value}, signalled is {self._signalled}")

    def _begin_query(self, query: Id) -> None:
        self._need(self._find(query, QueryKind) is QueryKind.OCCLUSION, "not an occlusion query")
        self._need(not self._query, "another query is open")
        self._query = query

    def _end_query(self, query: Id) -> None:
        self._need(query == self._query and query != 0, "it isn't open")
        self._query = 0

    def _write_query(self, query: Id) -> None:
        self._need(self._find(query, QueryKind) is not QueryKind.OCCLUSION, "an occlusion query")

    def _begin_conditional(self, query: Id, inverted: bool) -> None:
        self._find(query, QueryKind)
        self._need(not self._conditional, "another condition is open")
        self._conditional = True

    def _end_conditional(self) -> None:
        self._need(self._conditional, "no condition is open")
        self._conditional = False

    def _push_label(self, text: str) -> None:
        self._need(len(self.context.labels) < MAX_LABELS, "too many labels")

    def _pop_label(self) -> None:
        self._need(bool(self.context.labels), "no label is open")

    def _present(self, texture: Id) -> None:
        self._outside()
        if texture:
            self._find(texture, TextureDescriptor)


# -- a device's capabilities ---------------------------------------------------------------------------------


def check_capabilities(stream: CommandStream, limits: Capabilities) -> None:
    """Refuse a trace that a device can't replay, and name the first command that it doesn't support.

    Raises:
        ValidationError: `trace-capability`.
    """
    checks: dict[Op, Callable[[Capabilities, Any], Iterator[str]]] = {
        Op.CREATE_TEXTURE: _limit_texture,
        Op.CREATE_SAMPLER: _limit_sampler,
        Op.COPY_TEXTURE_TO_BUFFER: _limit_copy_to_buffer,
        Op.COPY_BUFFER_TO_TEXTURE: _limit_copy_to_texture,
        Op.CREATE_QUERY: _limit_query,
        Op.CREATE_PROGRAM: _limit_program,
        Op.BEGIN_PASS: _limit_pass,
        Op.SET_STATES: _limit_states,
        Op.BIND_UNIFORM: _limit_uniform,
        Op.BIND_STORAGE: _limit_storage,
        Op.BIND_TEXTURE: _limit_sampled,
        Op.BIND_IMAGE: _limit_image,
        Op.DRAW_INDIRECT: _limit_indirect,
        Op.DISPATCH: _limit_dispatch,
        Op.BEGIN_CONDITIONAL: _limit_conditional,
    }
    checked: set[tuple[Any, ...]] = set()
    place, index, data = 0, 0, stream.data
    while place < len(data):
        op = data[place]
        end = place + WIDTHS[op] - 2
        if op in checks:
            entry = tuple(data[place:end])
            if entry not in checked:
                checked.add(entry)
                for reason in checks[op](limits, entry[1:]):
                    given = f"command {index}: {stream[index]}"
                    refuse(TRACE_CAPABILITY, f"rhi.trace.replay on {limits.backend}", given, reason)
        place, index = end + 2, index + 1


def _limit_texture(limits: Capabilities, values: Any) -> Iterator[str]:
    descriptor = values[1]
    if max(descriptor.size) > limits.max_texture_size:
        yield f"textures up to {limits.max_texture_size}"
    if descriptor.layers > limits.max_texture_layers:
        yield f"up to {limits.max_texture_layers} layers"
    if descriptor.samples not in limits.sample_counts:
        yield f"{', '.join(map(str, limits.sample_counts))} samples"
    if descriptor.compressed is not None and descriptor.compressed not in limits.compressed_formats:
        yield f"formats other than {descriptor.compressed.name}"
    if descriptor.format in limits.unsupported_formats:
        yield f"formats other than {descriptor.format.name}"


def _limit_sampler(limits: Capabilities, values: Any) -> Iterator[str]:
    if values[1].max_anisotropy > limits.max_anisotropy:
        yield f"anisotropy up to {limits.max_anisotropy:g}"
    if values[1].uses_border and not limits.border_colors:
        yield "needs capabilities.border_colors"


def _limit_copy_to_buffer(limits: Capabilities, values: Any) -> Iterator[str]:
    return _limit_copy(limits, values[4], values[5])


def _limit_copy_to_texture(limits: Capabilities, values: Any) -> Iterator[str]:
    return _limit_copy(limits, values[1], values[2])


def _limit_copy(limits: Capabilities, offset: int, row_bytes: int) -> Iterator[str]:
    if not limits.texture_buffer_copies:
        yield "needs capabilities.texture_buffer_copies"
    if offset % limits.copy_offset_alignment or row_bytes % limits.copy_row_alignment:
        yield f"offsets at {limits.copy_offset_alignment}, rows at multiples of {limits.copy_row_alignment} bytes"


def _limit_query(limits: Capabilities, values: Any) -> Iterator[str]:
    if not getattr(limits, _QUERY_CAPABILITIES[values[1]]):
        yield f"needs capabilities.{_QUERY_CAPABILITIES[values[1]]}"


def _limit_program(limits: Capabilities, values: Any) -> Iterator[str]:
    descriptor = values[1]
    if Stage.COMPUTE in descriptor.stages:
        x, y, z = descriptor.work_group
        fits = all(0 < n <= most for n, most in zip((x, y, z), limits.max_work_group, strict=True))
        if not limits.compute or not fits or x * y * z > limits.max_work_group_invocations:
            yield f"work-groups up to {limits.max_work_group}, {limits.max_work_group_invocations} in all"
        if descriptor.shared_bytes > limits.max_shared_bytes:
            yield f"up to {limits.max_shared_bytes} bytes of shared memory"
    if (descriptor.point_size or descriptor.reads_point_coordinates) and limits.max_point_size <= 1.0:
        yield "points of one texel, without sizes and coordinates"
    if len(descriptor.attributes) > limits.max_vertex_attributes:
        yield f"up to {limits.max_vertex_attributes} attributes"


def _limit_pass(limits: Capabilities, values: Any) -> Iterator[str]:
    if len(values[0].colors) > limits.max_color_targets:
        yield f"up to {limits.max_color_targets} color targets"


def _limit_states(limits: Capabilities, values: Any) -> Iterator[str]:
    for change in values[0]:
        value = change.value
        for state in value if change.type is PlatformState else ():
            if type(state) not in limits.platform_states:
                yield f"needs capabilities.platform_states with {state.full_name}"
        if isinstance(value, AlphaTest | StencilTest | AlphaToCoverage | PolygonMode) and value in _STATE_CAPABILITIES:
            name = _STATE_CAPABILITIES[value]
            if not getattr(limits, name):
                yield f"needs capabilities.{name}"
        if isinstance(value, LineWidth) and value.width > limits.max_line_width:
            yield f"lines up to {limits.max_line_width:g} texels wide"


def _limit_uniform(limits: Capabilities, values: Any) -> Iterator[str]:
    slots, most, step = limits.max_uniform_slots, limits.max_uniform_bytes, limits.uniform_alignment
    return _limit_range(values, slots, most, step)


def _limit_storage(limits: Capabilities, values: Any) -> Iterator[str]:
    slots, most, step = limits.max_storage_slots, limits.max_storage_bytes, limits.storage_alignment
    return _limit_range(values, slots, most, step)


def _limit_range(values: Any, slots: int, most: int, step: int) -> Iterator[str]:
    slot, _, offset, size = values
    if slot >= slots or size > most or offset % step:
        yield f"{slots} slots of up to {most} bytes at multiples of {step}"


def _limit_sampled(limits: Capabilities, values: Any) -> Iterator[str]:
    if values[0] >= limits.max_texture_slots:
        yield f"{limits.max_texture_slots} slots"


def _limit_image(limits: Capabilities, values: Any) -> Iterator[str]:
    if values[0] >= limits.max_image_slots:
        yield f"{limits.max_image_slots} slots"


def _limit_indirect(limits: Capabilities, values: Any) -> Iterator[str]:
    if values[6] and not limits.indirect_count:
        yield "needs capabilities.indirect_count"


def _limit_dispatch(limits: Capabilities, values: Any) -> Iterator[str]:
    if not limits.compute or any(n > most for n, most in zip(values, limits.max_dispatch, strict=True)):
        yield f"up to {limits.max_dispatch} work-groups"


def _limit_conditional(limits: Capabilities, values: Any) -> Iterator[str]:
    if not limits.conditional_rendering:
        yield "needs capabilities.conditional_rendering"
