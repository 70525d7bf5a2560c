"""The rules of descriptors, states and commands' arguments, each stated once.

A function yields the faults of its arguments. Callers take only the first fault, since a rule may rely on
earlier ones. The front end refuses a call with it (`Core.require`). The same functions check traces, whose
commands no front end has seen: with unlimited capabilities (`ANY_DEVICE`) when a trace is loaded, and with a
device's limits before it is replayed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from math import isfinite, prod
from typing import Any, Final

from rhi.contract import states
from rhi.contract.alternatives import ALTERNATIVES
from rhi.contract.backend import Capabilities
from rhi.contract.blocks import CompressedFormat
from rhi.contract.descriptors import (
    ALL_LAYERS,
    DRAW,
    Attachment,
    Binding,
    BindingKind,
    BufferId,
    DepthAttachment,
    Id,
    PassDescriptor,
    ProgramDescriptor,
    QueryKind,
    Region,
    SamplerDescriptor,
    Stage,
    TextureDescriptor,
    TextureKind,
    Vec4,
    VertexArrayDescriptor,
    VertexStream,
    Wrap,
)
from rhi.contract.formats import ChannelKind, Format
from rhi.errors import Rule, rules
from rhi.errors.named_tuples import NamedTuple


class Fault(NamedTuple):
    """A broken rule, with the parts of its message."""

    rule: Rule
    given: str
    allowed: str = ""
    tip: str = ""


Faults = Iterator[Fault]


def lack(given: str, capability: str, allowed: str = "", rule: Rule = rules.DEVICE_CAPABILITY) -> Fault:
    """Return the fault of a call that needs a capability which the device lacks; the tip says what to use
    instead.

    Args:
        capability: a field of `Capabilities`.
        allowed: what is allowed; by default this names the capability.
    """
    needed = "not among" if capability.endswith("_formats") else "needs"
    return Fault(rule, given, allowed or f"{needed} capabilities.{capability}", ALTERNATIVES[capability])


_MANY: Final = 1 << 16
_CHANNELS: Final = ("red", "green", "blue", "alpha")
MAX_ROW_BYTES: Final = (1 << 31) - 1
"""Largest row pitch of a copy in bytes: drivers take 32 bits. A copy of one row may have any pitch, whatever
the buffer's size."""

ANY_DEVICE: Final = Capabilities(
    "any",
    "",
    "",
    max_texture_size=_MANY,
    max_texture_layers=_MANY,
    max_volume_size=_MANY,
    sample_counts=(1, 2, 4, 8, 16, 32),
    max_vertex_attributes=_MANY,
    max_vertex_stride=1 << 14,
    max_varyings=_MANY,
    max_uniform_bytes=1 << 40,
    max_storage_bytes=1 << 40,
    max_uniform_slots=1 << 10,
    max_storage_slots=1 << 10,
    max_texture_slots=1 << 10,
    max_image_slots=1 << 10,
    max_work_group=(_MANY,) * 3,
    max_work_group_invocations=1 << 40,
    max_dispatch=((1 << 32) - 1,) * 3,
    max_shared_bytes=1 << 40,
    max_anisotropy=float("inf"),
    max_point_size=float("inf"),
    max_line_width=float("inf"),
    uniform_alignment=1,
    storage_alignment=1,
    copy_offset_alignment=1,
    sample_counter=True,
    alpha_test=True,
    layered_rendering=True,
    wireframe=True,
    texture_buffer_copies=True,
    compressed_formats=frozenset(CompressedFormat),
)
"""Capabilities without limits and without platform states, for checks before a device is known."""


# -- textures ------------------------------------------------------------------------------------------------


def show_texture(texture: TextureDescriptor) -> str:
    """Return a texture's text for messages."""
    width, height = texture.size
    return f"Texture({texture.label!r}, {width}×{height}, {(texture.compressed or texture.format).name})"


def full_levels(width: int, height: int, depth: int = 1) -> int:
    """Return the number of mip levels down to 1×1."""
    return max(width, height, depth).bit_length()


def texture_faults(descriptor: TextureDescriptor, limits: Capabilities) -> Faults:
    """Yield the faults of a texture to be created."""
    width, height = descriptor.size
    kind = descriptor.kind
    layers = descriptor.layers
    samples = descriptor.samples
    if not (0 < width <= limits.max_texture_size and 0 < height <= limits.max_texture_size):
        yield Fault(rules.TEXTURE_SIZE, f"{width}×{height}", f"1 to {limits.max_texture_size} each way")
    if kind is TextureKind.D3 and max(width, height, layers) > limits.max_volume_size:
        allowed = f"up to capabilities.max_volume_size, {limits.max_volume_size}, each way"
        yield Fault(rules.TEXTURE_SIZE, f"a 3D texture of {width}×{height}×{layers}", allowed)
    if descriptor.format in limits.unsupported_formats:
        yield lack(descriptor.format.name, "unsupported_formats")
    minimum, maximum = {TextureKind.D2: (1, 1), TextureKind.CUBE: (6, 6)}.get(
        kind, (1, limits.max_texture_layers)
    )
    if not minimum <= layers <= maximum:
        yield Fault(rules.TEXTURE_SIZE, f"{layers} layers of {kind.name}", f"{minimum} to {maximum}")
    if layers > limits.max_texture_layers:
        allowed = f"up to capabilities.max_texture_layers, {limits.max_texture_layers}"
        yield lack(f"{layers} layers of {kind.name}", "max_texture_layers", allowed)
    if kind is TextureKind.CUBE and width != height:
        yield Fault(rules.TEXTURE_SIZE, f"a cube of {width}×{height}", "square faces")
    maximum = full_levels(width, height, layers if kind is TextureKind.D3 else 1)
    if not 1 <= descriptor.levels <= maximum:
        yield Fault(rules.TEXTURE_LEVELS, f"{descriptor.levels} levels", f"1 to {maximum}")
    if samples not in limits.sample_counts:
        yield Fault(
            rules.TEXTURE_SAMPLES,
            f"{samples} samples",
            f"{', '.join(map(str, limits.sample_counts))} samples",
        )
    if samples > 1 and descriptor.format in limits.single_sampled_formats:
        given = f"{samples} samples of {descriptor.format.name}"
        yield lack(given, "single_sampled_formats")
    if samples > 1 and (descriptor.levels > 1 or kind is not TextureKind.D2):
        yield Fault(
            rules.TEXTURE_SAMPLES,
            f"{samples} samples, {descriptor.levels} levels, {kind.name}",
            "2D, one level",
        )
    if descriptor.format.is_depth and kind is TextureKind.D3:
        yield Fault(rules.TEXTURE_FORMAT, "a 3D depth texture", "2D, 2D array or cube")
    yield from compressed_faults(descriptor)
    if descriptor.compressed is not None and descriptor.compressed not in limits.compressed_formats:
        given = descriptor.compressed.name
        yield lack(given, "compressed_formats", "a format among capabilities.compressed_formats")


def compressed_faults(descriptor: TextureDescriptor) -> Faults:
    """Yield why a texture can't be made of blocks, whether or not the device stores them as they are."""
    if descriptor.compressed is None:
        return
    name = descriptor.compressed.name
    if descriptor.kind is TextureKind.D3:
        yield Fault(rules.TEXTURE_FORMAT, f"a 3D texture of {name}", "2D, 2D array or cube")
    if descriptor.samples != 1:
        yield Fault(rules.TEXTURE_SAMPLES, f"{descriptor.samples} samples of {name}", "1")


def sampler_faults(descriptor: SamplerDescriptor, limits: Capabilities) -> Faults:
    """Yield the capabilities that a device lacks for a sampler."""
    if descriptor.max_anisotropy > limits.max_anisotropy:
        maximum = f"up to capabilities.max_anisotropy, {limits.max_anisotropy:g}"
        yield lack(f"max_anisotropy={descriptor.max_anisotropy:g}", "max_anisotropy", maximum)
    if descriptor.uses_border and not limits.border_colors:
        yield lack(str(Wrap.BORDER), "border_colors")


def level_faults(texture: TextureDescriptor, level: int, layer: int = 0) -> Faults:
    """Yield a level or layer that a texture doesn't have."""
    if not 0 <= level < texture.levels:
        yield Fault(rules.TEXTURE_LEVELS, f"level {level}", f"0 to {texture.levels - 1}")
    layers = texture.level_layers(level)
    if not 0 <= layer < layers:
        yield Fault(rules.TEXTURE_LEVELS, f"layer {layer}", f"0 to {layers - 1}")


def region_faults(texture: TextureDescriptor, level: int, region: Region) -> Faults:
    """Yield the parts of a region that lie outside a level."""
    yield from level_faults(texture, level, region.layer)
    width, height = texture.level_size(level)
    layers = texture.level_layers(level)
    inside = (
        region.x >= 0
        and region.y >= 0
        and min(region.width, region.height, region.layers) > 0
        and region.x + region.width <= width
        and region.y + region.height <= height
        and region.layer + region.layers <= layers
    )
    if not inside:
        yield Fault(rules.TEXTURE_REGION, str(region), f"inside {width}×{height}, {layers} layers")


def plain_faults(texture: TextureDescriptor) -> Faults:
    """Yield a fault if a texture is compressed: such textures are only written and sampled."""
    if texture.compressed is not None:
        yield Fault(
            rules.TEXTURE_FORMAT,
            texture.compressed.name,
            "a format without compression",
            "sample it in a shader",
        )


def single_sample_faults(texture: TextureDescriptor) -> Faults:
    """Yield a fault if a texture is multi-sampled."""
    if texture.samples != 1:
        yield Fault(
            rules.TEXTURE_SAMPLES,
            f"{texture.samples} samples",
            "1",
            "resolve it first: texture.resolve_to(…)",
        )


def written_faults(texture: TextureDescriptor) -> Faults:
    """Yield why texels of a texture can't be written by the CPU or by copies."""
    if texture.format.is_depth:
        yield Fault(
            rules.TEXTURE_FORMAT, texture.format.name, "a color format", "depth is written by a render pass"
        )


def read_faults(texture: TextureDescriptor, level: int, region: Region, stencil: bool) -> Faults:
    """Yield why texels, or with `stencil` their stencil part, can't be read."""
    yield from region_faults(texture, level, region)
    yield from plain_faults(texture)
    yield from single_sample_faults(texture)
    if stencil and not texture.format.has_stencil:
        yield Fault(rules.TEXTURE_FORMAT, texture.format.name, "a format with stencil")


def texture_copy_faults(
    source: TextureDescriptor,
    level: int,
    region: Region,
    target: TextureDescriptor,
    target_level: int,
    end: Region,
    same: bool,
) -> Faults:
    """Yield the faults of a copy between textures, or within one (`same`)."""
    yield from plain_faults(source)
    yield from plain_faults(target)
    yield from region_faults(source, level, region)
    if source.format is not target.format:
        yield Fault(rules.TEXTURE_FORMAT, f"{source.format.name} to {target.format.name}", "equal formats")
    if target.samples != 1 or source.samples != 1:
        yield Fault(
            rules.TEXTURE_SAMPLES, f"{source.samples} to {target.samples} samples", "1", "use resolve_to"
        )
    yield from region_faults(target, target_level, end)
    if same and level == target_level and _overlap(region, end):
        yield Fault(rules.TEXTURE_REGION, f"{region} to {end}", "regions that don't overlap")


def row_faults(
    texture: TextureDescriptor,
    level: int,
    region: Region,
    offset: int,
    row_bytes: int,
    size: int,
    limits: Capabilities,
) -> Faults:
    """Yield the faults of the offset and pitch of a region's rows in a buffer of `size` bytes."""
    texel = texture.format.transfer_bytes
    yield from plain_faults(texture)
    if not limits.texture_buffer_copies:
        yield lack(texture.format.name, "texture_buffer_copies")
    yield from region_faults(texture, level, region)
    yield from single_sample_faults(texture)
    minimum, step = region.width * texel, max(texel, limits.copy_row_alignment)
    if row_bytes < minimum or row_bytes % step:
        yield Fault(
            rules.BUFFER_ALIGNMENT, f"row_bytes={row_bytes}", f"a multiple of {step}, {minimum} or more"
        )
    if row_bytes > MAX_ROW_BYTES:
        yield Fault(rules.BUFFER_ALIGNMENT, f"row_bytes={row_bytes}", f"at most {MAX_ROW_BYTES}")
    step = max(texel, limits.copy_offset_alignment)
    if offset % step:
        yield Fault(rules.BUFFER_ALIGNMENT, f"offset={offset}", f"a multiple of {step}")
    used = (region.height * region.layers - 1) * row_bytes + minimum
    if offset < 0 or offset + used > size:
        yield Fault(rules.BUFFER_RANGE, f"{used} bytes at {offset}", f"within {size} bytes")


def resolve_faults(source: TextureDescriptor, target: TextureDescriptor, limits: Capabilities) -> Faults:
    """Yield why a texture can't be resolved to another."""
    if source.format in limits.unresolvable_formats:
        yield lack(source.format.name, "unresolvable_formats")
    if source.samples == 1 or target.samples != 1:
        yield Fault(
            rules.TEXTURE_SAMPLES, f"{source.samples} to {target.samples} samples", "several samples to 1"
        )
    has_average = not (source.format.is_depth or source.format.is_integer)
    if source.format is not target.format or source.size != target.size or not has_average:
        given = f"{show_texture(source)} to {show_texture(target)}"
        yield Fault(rules.TEXTURE_FORMAT, given, "equal sizes and equal color formats, not of integers")


def mipmap_faults(texture: TextureDescriptor) -> Faults:
    """Yield why levels can't be generated."""
    yield from plain_faults(texture)
    if texture.format.is_depth or texture.format.is_integer:
        yield Fault(rules.TEXTURE_FORMAT, texture.format.name, "a color format that can be filtered")


def _overlap(a: Region, b: Region) -> bool:
    return (
        a.x < b.x + b.width
        and b.x < a.x + a.width
        and a.y < b.y + b.height
        and b.y < a.y + a.height
        and a.layer < b.layer + b.layers
        and b.layer < a.layer + a.layers
    )


# -- buffers and arguments -----------------------------------------------------------------------------------


def buffer_copy_faults(
    source_size: int,
    offset: int,
    target_size: int,
    target_offset: int,
    size: int,
    same: bool,
    limits: Capabilities,
) -> Faults:
    """Yield the faults of a copy between buffers, or within one (`same`)."""
    alignment = limits.copy_alignment
    if (
        size <= 0 or not 0 <= offset <= source_size - size
    ):  # no loop over the two: renderers copy in each frame
        yield Fault(rules.BUFFER_RANGE, f"{size} bytes at {offset}", f"1 or more within {source_size} bytes")
    if offset % alignment or size % alignment:
        yield Fault(rules.BUFFER_ALIGNMENT, f"{size} bytes at {offset}", f"multiples of {alignment} bytes")
    if not 0 <= target_offset <= target_size - size:
        yield Fault(
            rules.BUFFER_RANGE, f"{size} bytes at {target_offset}", f"1 or more within {target_size} bytes"
        )
    if target_offset % alignment:
        yield Fault(
            rules.BUFFER_ALIGNMENT, f"{size} bytes at {target_offset}", f"multiples of {alignment} bytes"
        )
    if same and abs(offset - target_offset) < size:
        yield Fault(rules.BUFFER_OVERLAP, f"{offset} to {target_offset}, {size} bytes")


def range_faults(kind: BindingKind, offset: int, size: int, minimum: int, limits: Capabilities) -> Faults:
    """Yield why a range of a buffer can't be bound as uniform or storage of `minimum` bytes."""
    uniform = kind is BindingKind.UNIFORM
    maximum = limits.max_uniform_bytes if uniform else limits.max_storage_bytes
    alignment = limits.uniform_alignment if uniform else limits.storage_alignment
    if not minimum <= size <= maximum or offset % alignment:
        yield Fault(
            rules.BINDING_SIZE,
            f"{size} bytes at {offset}",
            f"{minimum} to {maximum} bytes at a multiple of {alignment}",
        )


MAX_ELEMENTS: Final = (1 << 31) - 1
"""Largest number of vertices, instances or indices of a draw."""
MAX_STRIDE: Final = 1 << 14


class ElementCounts(NamedTuple):
    """Numbers of elements that a draw can read from a vertex array's buffers; `MAX_ELEMENTS` where it reads
    no buffer."""

    vertices: int
    instances: int
    indices: int


def count_elements(descriptor: VertexArrayDescriptor, sizes: Callable[[BufferId], int]) -> ElementCounts:
    """Count the vertices, instances and indices in the buffers of a vertex array, given the buffers' `sizes`
    in bytes."""
    minimum = {False: MAX_ELEMENTS, True: MAX_ELEMENTS}
    for stream in descriptor.streams:
        room = sizes(stream.buffer) - stream.offset
        for attribute in stream.attributes:
            rest = room - attribute.offset - attribute.format.size
            count = 0 if rest < 0 else rest // stream.stride + 1 if stream.stride else MAX_ELEMENTS
            minimum[stream.per_instance] = min(minimum[stream.per_instance], count)
    indices = MAX_ELEMENTS
    if descriptor.index_buffer:
        indices = sizes(descriptor.index_buffer) // descriptor.index_format.size
    return ElementCounts(minimum[False], minimum[True], indices)


def vertex_array_faults(descriptor: VertexArrayDescriptor, sizes: Callable[[BufferId], int]) -> Faults:
    """Yield the faults of the offsets of attributes in buffers of these `sizes`, in bytes."""
    for stream in descriptor.streams:
        if not 0 <= stream.stride <= MAX_STRIDE:
            yield Fault(rules.MESH_DATA, f"stride {stream.stride}", f"0 to {MAX_STRIDE}")
        if not 0 <= stream.offset <= sizes(stream.buffer):
            yield Fault(
                rules.BUFFER_RANGE,
                f"vertices from byte {stream.offset}",
                f"within {sizes(stream.buffer)} bytes",
            )
        for attribute in stream.attributes:
            end = attribute.offset + attribute.format.size
            if attribute.offset < 0 or (stream.stride and end > stream.stride):
                yield Fault(
                    rules.MESH_ATTRIBUTE, f"{attribute}", f"inside an element of {stream.stride} bytes"
                )
            if stream.offset + end > sizes(stream.buffer):
                allowed = f"one element or more within {sizes(stream.buffer)} bytes"
                yield Fault(rules.BUFFER_RANGE, f"{attribute} from byte {stream.offset}", allowed)


def draw_faults(
    elements: ElementCounts,
    indexed: bool,
    first: int,
    count: int,
    instances: int,
    base_vertex: int,
    base_instance: int,
) -> Faults:
    """Yield why a draw can't read its elements. Of an indexed draw, the indices aren't known here: devices
    clamp them."""
    numbers = (first, count, instances, base_instance)
    if min(numbers) < 0 or max(numbers) > MAX_ELEMENTS or abs(base_vertex) > MAX_ELEMENTS:
        given = (
            f"first {first}, count {count}, instances {instances}, bases {base_vertex} and {base_instance}"
        )
        yield Fault(
            rules.DRAW_COUNT, given, f"numbers from 0 to {MAX_ELEMENTS}, a base vertex up to {MAX_ELEMENTS}"
        )
    if not (count and instances):
        return
    maximum = elements.indices if indexed else elements.vertices
    if first + count > maximum:
        yield Fault(rules.MESH_RANGE, f"first {first}, count {count}", f"within {maximum} elements")
    if base_instance + instances > elements.instances:
        given = f"{instances} instances from {base_instance}"
        yield Fault(rules.MESH_RANGE, given, f"within {elements.instances} of the mesh's data per instance")
    if base_vertex and (not indexed or base_vertex >= elements.vertices):
        allowed = f"below {elements.vertices}" if indexed else "0 for a mesh without indices"
        yield Fault(rules.MESH_RANGE, f"base vertex {base_vertex}", allowed)


def indirect_faults(draws: int, offset: int, stride: int, count_offset: int, size: int) -> Faults:
    """Yield the faults of the offset and stride of indirect draws in a buffer of `size` bytes."""
    if stride > MAX_ELEMENTS or not 0 <= count_offset <= MAX_ELEMENTS:
        given = f"stride {stride}, count_offset {count_offset}"
        yield Fault(rules.INDIRECT_RANGE, given, f"numbers up to {MAX_ELEMENTS}")
    if draws < 1 or offset < 0 or offset + (draws - 1) * stride + DRAW.itemsize > size:
        given = f"{draws} draws from byte {offset}, {stride} apart"
        yield Fault(rules.INDIRECT_RANGE, given, f"1 draw or more within {size} bytes")
    if stride < DRAW.itemsize or stride % 4 or offset % 4 or count_offset % 4:
        allowed = f"a stride of {DRAW.itemsize} or more and offsets, all multiples of 4"
        yield Fault(rules.INDIRECT_RANGE, f"stride {stride}, offset {offset}", allowed)


def count_faults(offset: int, size: int, limits: Capabilities) -> Faults:
    """Yield why the number of draws can't be read at an offset of a buffer of `size` bytes."""
    if not limits.indirect_count:
        yield lack("a count from a buffer", "indirect_count")
    if not 0 <= offset <= size - 4:
        yield Fault(rules.INDIRECT_RANGE, f"count at byte {offset}", f"within {size} bytes")


def indirect_dispatch_faults(offset: int, size: int) -> Faults:
    """Yield the faults of the offset of an indirect dispatch's arguments in a buffer of `size` bytes."""
    if offset < 0 or offset % 4 or offset + 12 > size:
        yield Fault(rules.INDIRECT_RANGE, f"byte {offset}", f"a multiple of 4 up to {size - 12}")


def dispatch_faults(groups: Sequence[int | None], groups_text: str, limits: Capabilities) -> Faults:
    """Yield why a dispatch can't have these groups; None is no whole number."""
    maximum = limits.max_dispatch
    fits = len(groups) == 3 and all(
        n is not None and 0 <= n <= m for n, m in zip(groups, maximum, strict=True)
    )
    if not fits:
        yield Fault(rules.DISPATCH_SIZE, groups_text, f"1 to 3 whole numbers from 0 to {maximum}")
    if prod(n or 0 for n in groups) > limits.max_dispatch_groups:
        yield Fault(rules.DISPATCH_SIZE, groups_text, f"at most {limits.max_dispatch_groups} in all")


def query_faults(kind: QueryKind, limits: Capabilities) -> Faults:
    """Yield the capabilities that a device lacks for a query."""
    needed = {QueryKind.OCCLUSION: "occlusion_queries", QueryKind.COUNTER: "sample_counter"}.get(
        kind, "timestamps"
    )
    if not getattr(limits, needed):
        yield lack(f"a {kind.value} query", needed)


def condition_faults(limits: Capabilities) -> Faults:
    """Yield the capabilities that a device lacks for conditions."""
    if not limits.conditional_rendering:
        yield lack("conditional rendering", "conditional_rendering")


# -- programs, states, passes --------------------------------------------------------------------------------


def show_stages(descriptor: ProgramDescriptor) -> str:
    """Return a program's stages for a message."""
    return "a program with " + ", ".join(sorted(stage.value for stage in descriptor.stages))


def program_faults(descriptor: ProgramDescriptor, limits: Capabilities) -> Faults:
    """Yield the capabilities that a device lacks for a program."""
    room = {
        BindingKind.UNIFORM: limits.max_uniform_slots,
        BindingKind.STORAGE: limits.max_storage_slots,
        BindingKind.TEXTURE: limits.max_texture_slots,
        BindingKind.IMAGE: limits.max_image_slots,
    }
    for kind, maximum in room.items():
        used = sum(binding.kind is kind for binding in descriptor.bindings)
        if used > maximum:
            yield lack(f"{used} {kind.value} bindings", f"max_{kind.value}_slots", f"at most {maximum}")
    if (descriptor.point_size or descriptor.reads_point_coordinates) and limits.max_point_size <= 1.0:
        given = "a point size" if descriptor.point_size else "point_coordinate()"
        yield lack(given, "max_point_size")
    if descriptor.target_layer and not limits.layered_rendering:
        yield lack(f"{descriptor.target_layer}: TargetLayer", "layered_rendering")
    if descriptor.reads_draw_index and not limits.draw_index:
        yield lack("draw_index()", "draw_index")
    if descriptor.early_depth and not limits.early_depth:
        yield lack("early_depth = True", "early_depth")
    if descriptor.vertex_writes and not limits.vertex_writes:
        yield lack("a vertex stage that writes memory", "vertex_writes")
    for binding in descriptor.bindings:
        if binding.kind is BindingKind.IMAGE:
            yield from _image_faults(binding, limits)
    vectors = sum(_count_vectors(varying.words) for varying in descriptor.varyings)
    if vectors > limits.max_varyings:
        allowed = f"up to capabilities.max_varyings, {limits.max_varyings}"
        yield lack(f"{vectors} vectors from the vertex stage", "max_varyings", allowed)
    if len(descriptor.attributes) > limits.max_vertex_attributes:
        given = f"{len(descriptor.attributes)} attributes"
        yield lack(given, "max_vertex_attributes", f"at most {limits.max_vertex_attributes}")
    if Stage.VERTEX in descriptor.stages and not limits.draws:
        yield lack(show_stages(descriptor), "draws", "a compute program: needs capabilities.draws")
    if Stage.COMPUTE in descriptor.stages:
        x, y, z = group = descriptor.work_group
        total = limits.max_work_group_invocations
        fits = all(0 < n <= maximum for n, maximum in zip(group, limits.max_work_group, strict=True))
        if not limits.compute or not fits or x * y * z > total:
            allowed = f"{limits.max_work_group}, {total} in all" if limits.compute else ""
            yield lack(f"work-group {x}×{y}×{z}", "max_work_group" if limits.compute else "compute", allowed)
        if descriptor.shared_bytes > limits.max_shared_bytes:
            allowed = f"up to capabilities.max_shared_bytes, {limits.max_shared_bytes}"
            yield lack(f"{descriptor.shared_bytes} bytes of shared memory", "max_shared_bytes", allowed)


def _count_vectors(words: int) -> int:
    """Return the number of vectors that a varying takes: a matrix of 9 or 16 words has 3 or 4 columns."""
    return {9: 3, 16: 4}.get(words, 1)


def _image_faults(binding: Binding, limits: Capabilities) -> Faults:
    """Yield the capabilities that a device lacks for an image of a program."""
    format = getattr(binding.type, "format", None)  # descriptors that are made by hand may have no types
    given = f"{binding.name}, an image of {format.name}" if isinstance(format, Format) else ""
    if format in limits.unstorable_formats:
        yield lack(given, "unstorable_formats")
    if binding.writes and binding.reads and format in limits.unloadable_formats:
        yield lack(f"{given} that is loaded from", "unloadable_formats")


def vertex_faults(streams: Sequence[VertexStream], limits: Capabilities) -> Faults:
    """Yield why vertices can't be read as they lie in memory."""
    step = limits.vertex_alignment
    for stream in streams:
        if stream.stride > limits.max_vertex_stride:
            allowed = f"up to capabilities.max_vertex_stride, {limits.max_vertex_stride}"
            yield lack(f"vertices of {stream.stride} bytes", "max_vertex_stride", allowed)
        offsets = [stream.stride, stream.offset, *(attribute.offset for attribute in stream.attributes)]
        if any(offset % step for offset in offsets):
            given = f"vertices of {stream.stride} bytes, with fields at {', '.join(map(str, offsets[2:]))}"
            yield lack(given, "vertex_alignment", f"multiples of capabilities.vertex_alignment, {step}")


def _differs(state: Any) -> bool:
    return bool(state != states.DEFAULTS[type(state)])


def _per_face(state: Any) -> bool:
    return bool(state.front != state.back)


_REQUIRED_CAPABILITIES: Final[dict[type, tuple[str, Callable[[Any], bool]]]] = {
    states.AlphaTest: ("alpha_test", _differs),
    states.AlphaFunction: ("alpha_test", _differs),
    states.AlphaReference: ("alpha_test", _differs),
    states.StencilTest: ("stencil", _differs),
    states.StencilReference: ("stencil_per_face", _per_face),
    states.StencilReadMask: ("stencil_per_face", _per_face),
    states.StencilWriteMask: ("stencil_per_face", _per_face),
    states.AlphaToCoverage: ("alpha_to_coverage", _differs),
    states.BlendFunction: ("blend_per_target", lambda state: state.target is not None),
    states.PolygonOffset: ("depth_bias_clamp", lambda state: state.clamp != 0.0),
    states.PolygonMode: ("wireframe", _differs),
}
"""For each state type, the capability that it needs, and which of its values need it."""


def state_faults(state: Any, limits: Capabilities) -> Faults:
    """Yield the capabilities that a device lacks for a state."""
    if isinstance(state, states.PlatformState) and type(state) not in limits.platform_states:
        have = ", ".join(sorted(kind.__name__ for kind in limits.platform_states)) or "none"
        yield Fault(
            rules.PLATFORM_STATE, f"{state.full_name} of {state.platform()!r}", f"this device's own: {have}"
        )
    needs = _REQUIRED_CAPABILITIES.get(type(state))
    if needs is not None and not getattr(limits, needs[0]) and needs[1](state):
        yield lack(repr(state), needs[0], rule=rules.STATE_CAPABILITY)
    if isinstance(state, states.Viewport):
        yield from _viewport_faults(state, limits)
    if isinstance(state, states.LineWidth) and state.width > limits.max_line_width:
        maximum = f"up to capabilities.max_line_width, {limits.max_line_width:g}"
        yield lack(repr(state), "max_line_width", maximum, rules.STATE_CAPABILITY)


def _viewport_faults(view: states.Viewport, limits: Capabilities) -> Faults:
    """Yield why a viewport is too large. Source: WebGPU, `setViewport`, which also refuses those far from the
    target; backends draw nothing in these."""
    size = limits.max_texture_size
    if max(view.width, view.height) > size:
        allowed = f"width and height up to {size} (capabilities.max_texture_size)"
        yield lack(repr(view), "max_texture_size", allowed, rules.STATE_CAPABILITY)


def target_bytes(formats: Iterable[Format]) -> int:
    """Return the bytes that the texels of color targets take on a chip which keeps them there while it draws.

    Source: WebGPU, "calculating color attachment bytes per sample": texels of four normalised bytes, or
    packed ones, count 8.
    """
    total = 0
    for form in formats:
        wide = form.texel_bytes == 4 and form.channels > 2 and (form.is_packed or not form.is_integer)
        step = form.dtype.itemsize
        total = -(-total // step) * step + (8 if wide else form.texel_bytes)
    return total


def pass_faults(
    descriptor: PassDescriptor, textures: Mapping[Id, TextureDescriptor], limits: Capabilities
) -> Faults:
    """Yield the faults of a render pass. Its attachments name existing levels and layers of
    `textures`."""
    colors, depth = descriptor.colors, descriptor.depth
    targets: list[Attachment | DepthAttachment] = [*colors, *([] if depth is None else [depth])]
    used = [textures[target.texture] for target in targets]
    if len(colors) > limits.max_color_targets:
        yield lack(f"{len(colors)} color targets", "max_color_targets", f"{limits.max_color_targets}")
    if 16 * len(colors) > limits.max_target_bytes:  # no texel has more
        taken = target_bytes(texture.format for texture in used[: len(colors)])
        if taken > limits.max_target_bytes:
            allowed = f"up to capabilities.max_target_bytes, {limits.max_target_bytes}"
            yield lack(f"texels of {taken} bytes in {len(colors)} color targets", "max_target_bytes", allowed)
    yield from _layer_faults(targets, used, limits)
    if len({(t.texture, t.level, t.layer) for t in targets}) < len(targets):
        yield Fault(rules.PASS_TARGET, "the same texture twice", "each level and layer once")
    ends = [color.resolve for color in colors if color.resolve]
    if len(set(ends)) < len(ends):
        yield Fault(rules.PASS_TARGET, "two targets resolved to the same texture", "a texture for each")
    for texture in used[: len(colors)]:
        form, compressed = texture.format, texture.compressed
        if form.is_depth or form in limits.unrenderable_formats or compressed is not None:
            given = f"{(compressed or form).name} as color target"
            yield Fault(rules.PASS_TARGET, given, "a color format the device can render to")
    if depth is not None and not used[-1].format.is_depth:
        yield Fault(rules.PASS_TARGET, f"{used[-1].format.name} as depth target", "a depth format")
    sizes = {texture.level_size(target.level) for texture, target in zip(used, targets, strict=True)}
    if sizes != {descriptor.size}:
        size_list = ", ".join(f"{w}×{h}" for w, h in sorted({*sizes, descriptor.size}))
        yield Fault(rules.PASS_SIZE, size_list, "one size")
    samples = {texture.samples for texture in used}
    if samples != {descriptor.samples}:
        yield Fault(
            rules.PASS_SAMPLES, f"samples {sorted({*samples, descriptor.samples})}", "one number of samples"
        )
    for color, source in zip(colors, used, strict=False):  # a depth target is the last one
        if not color.resolve:
            continue
        end = textures[color.resolve]
        if source.format in limits.unresolvable_formats:
            yield lack(source.format.name, "unresolvable_formats")
        fits = (
            source.samples > 1
            and end.samples == 1
            and end.format is source.format
            and end.size == descriptor.size
            and end.layers == 1
        )
        if not fits or source.format.is_integer:  # integers have no average
            allowed = "from several samples to 1, equal size and format, one layer, no integers"
            yield Fault(rules.PASS_TARGET, f"{show_texture(source)} resolved to {show_texture(end)}", allowed)
    for color, texture in zip(colors, used, strict=False):
        if color.clear is not None:
            fault = _color_clear_fault(texture.format, color.clear, len(colors) > 1)
            if fault is not None:
                yield fault
    if depth is not None:
        yield from _clear_faults(depth, used[-1])


def _layer_faults(
    targets: Sequence[Attachment | DepthAttachment],
    textures: Sequence[TextureDescriptor],
    limits: Capabilities,
) -> Faults:
    """Yield the faults of a pass that draws to all layers. Source: OpenGL 4.6, 9.4.2, "framebuffer
    completeness"."""
    if all(target.layer != ALL_LAYERS for target in targets):
        return
    if not limits.layered_rendering:
        yield lack("all layers of a texture as target", "layered_rendering")
    kinds = {texture.kind for texture in textures}
    if TextureKind.D2 in kinds:
        yield Fault(rules.PASS_TARGET, "all layers of a 2D texture", "an array, cube or 3D texture")
    counts = {
        texture.level_layers(target.level) if target.layer == ALL_LAYERS else 1
        for texture, target in zip(textures, targets, strict=True)
    }
    if len(kinds) > 1 or len(counts) > 1 or any(target.layer != ALL_LAYERS for target in targets):
        attachments = ", ".join(
            f"{'all layers' if target.layer == ALL_LAYERS else f'layer {target.layer}'} of {show_texture(texture)}"
            for texture, target in zip(textures, targets, strict=True)
        )
        yield Fault(
            rules.PASS_TARGET, attachments, "all layers of all targets, as many, of one kind of texture"
        )


@lru_cache(1024)
def _color_clear_fault(format: Format, clear: Vec4, has_others: bool) -> Fault | None:
    """Return why a format can't hold a clear value. Normalised formats clamp, and channels that a format
    lacks are ignored. `has_others` tells that the pass has several color targets."""
    if not all(map(isfinite, clear)):
        return Fault(rules.PASS_CLEAR, f"clear={clear}", "4 finite numbers: red, green, blue, alpha")
    if not (format.is_integer or format.kind is ChannelKind.FLOAT):
        return None
    numbers = "whole numbers" if format.is_integer else "numbers"
    tip = "give each target a value of its own: clear=[…, …]" if has_others else ""
    for name, value, (low, high) in zip(_CHANNELS, clear, format.channel_bounds, strict=False):
        if not low <= value <= high or (format.is_integer and value % 1):
            allowed = f"{numbers} from {low:.10g} to {high:.10g}, which {format.name} holds"
            return Fault(rules.PASS_CLEAR, f"clear={clear}, {name} is {value}", allowed, tip)
    return None


def _clear_faults(depth: DepthAttachment, texture: TextureDescriptor) -> Faults:
    if depth.clear is not None and not 0.0 <= depth.clear <= 1.0:
        yield Fault(rules.PASS_CLEAR, f"clear_depth={depth.clear}", "0 to 1")
    stencil = depth.clear_stencil
    if stencil is not None and not (texture.format.has_stencil and 0 <= stencil <= 255):
        yield Fault(rules.PASS_CLEAR, f"clear_stencil={stencil}", "0 to 255, with a target that has stencil")
