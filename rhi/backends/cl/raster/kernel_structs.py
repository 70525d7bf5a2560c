"""The tables that kernels read, and the macros that they are compiled with.

- The dtypes `BATCH_STRUCT`, `DRAW_STRUCT` and `VIEW_STRUCT` are the structs `Batch`, `Draw` and `View` of the
  kernels, whose declarations are made of them.
- The macros hold what a program and the layout of its vertices determine: how attributes become words, how
  bindings become arguments, how each varying is interpolated.
- A draw's row of bound words: for each binding its address (and the number of elements of storage, or the
  address of the description of a texture or image), then the addresses of the vertex streams.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from struct import Struct
from typing import Final

import numpy as np

from rhi.backends.cl.raster.kernel_text import declare_struct
from rhi.backends.cl.raster.merger import STATE_WORDS
from rhi.contract.descriptors import (
    Attribute,
    Binding,
    BindingKind,
    Interpolation,
    ProgramDescriptor,
    VertexAttribute,
    VertexFormat,
    VertexStream,
)
from rhi.contract.layout import VectorType

MAX_STREAMS: Final = 16
MAX_PLANES: Final = 10
GROUP: Final = 16
_TILE_BITS: Final = 6
_PART_BITS: Final = 4
TILE: Final = 1 << _TILE_BITS
PART: Final = 1 << _PART_BITS
RECORD_BYTES: Final = 64
EXTENT_BYTES: Final = 32


def _fields(text: str, code: str) -> list[tuple[str, str]]:
    return [(name, code) for name in text.split()]


BATCH_STRUCT: Final = np.dtype(
    [
        ("surfaces", "u8", (MAX_PLANES,)),  # color targets, depth, stencil
        *_fields(
            "draws views bindings positions clips varyings records planes boxes counts starts list", "u8"
        ),
        *_fields("survivors scratch extents bounds counters", "u8"),
        # The surfaces' offsets in their memory and pitches; then their clear values, each repeated to 4
        # words.
        ("merger", "u8"),
        ("stage", "u8"),  # address of the fragment stage, for kernels that many programs share
        *_fields("draw_count binding_words", "i4"),
        *_fields("vertex_groups vertex_chunk", "i4"),  # of the batch, and per work-item
        # Of primitives: of the slice, and per work-item.
        *_fields("first_group end_group chunk_groups chunks", "i4"),
        ("chunk_records", "i4"),  # records that a work-item has room for
        ("edges", "i4"),  # records of a triangle that is drawn as lines; 0: triangles are filled
        *_fields("tiles_x tiles list_size listed samples shades linear width height", "i4"),
        ("near_is_less", "i4"),  # direction of the depth test
        ("bounded", "i4"),  # whether raster kernels left valid bounds of depth
        ("cleared", "i4"),  # surfaces with pending clears, as bits
        # Words of a vertex's varyings; which of them is its point size and its target's layer, -1: none.
        *_fields("varying_words point_size target_layer", "i4"),
        ("layer", "i4"),  # the one that primitives are drawn to; -1: whatever theirs is
        ("depth_step", "f4"),  # difference between depths of the target's format; 0 for floats
    ],
    align=True,
)
EMPTY_BATCH: Final[dict[str, float]] = dict.fromkeys((BATCH_STRUCT.names or ())[1:], 0)
"""The fields of a batch table without its surfaces, in the order of `pack_batch`, all 0."""
_CODES: Final = {"u8": "Q", "i4": "i", "f4": "f"}
_BATCH_WORDS: Final = Struct(
    f"={MAX_PLANES}Q" + "".join(_CODES[BATCH_STRUCT[name].str[1:]] for name in EMPTY_BATCH)
)
DRAW_STRUCT: Final = np.dtype(
    [
        ("indices", "u8"),  # address of the first corner's index; 0: vertices in order
        ("vertex_indices", "u8"),  # address of the first vertex's index; 0: vertices from first_vertex on
        ("samples", "u8"),  # its counter, relative to the batch's `counters`; 0: none
        ("condition", "u8"),  # address of a counter; 0: none
        ("box", "u8"),  # address of its attributes' box; 0: none, odd: to be measured
        *_fields("vertex_group primitive_group", "i4"),  # numbers of its first groups in the batch
        *_fields("vertex_groups primitive_groups", "i4"),  # for one instance
        *_fields(
            "first_vertex vertices", "i4"
        ),  # added to a vertex's number; number of vertices to transform
        ("lowest", "i4"),  # index of the first of them
        *_fields("primitives primitive", "i4"),  # their number, and corners of each
        *_fields("index_bytes vertex_index_bytes base_instance number binding_index view inverted", "i4"),
        *_fields(
            "last_vertex last_instance", "i4"
        ),  # that lie in the buffers: what is read is clamped to them
    ],
    align=True,
)
VIEW_STRUCT: Final = np.dtype(
    [
        # Window position = clip / w * scale + shift, in texels; then depth.
        ("scale", "f4", 4),
        ("shift", "f4", 4),
        ("box", "i4", 4),  # first and last texel that may be drawn: viewport and scissor
        ("culled", "i4"),  # 1: positive area in the window, 2: negative, 3: both
        ("front", "i4"),  # 1: positive area is front-facing
        *_fields("bias_units bias_slope bias_clamp bias_step", "f4"),  # step 0: floats
        ("line_width", "f4"),  # texels, a whole number
        ("state", "u4", STATE_WORDS),  # see merger.cl
    ],
    align=True,
)

_BINDING_WORDS: Final = {
    BindingKind.UNIFORM: 1,
    BindingKind.STORAGE: 2,
    BindingKind.TEXTURE: 2,
    BindingKind.IMAGE: 2,
}
_WORDS: Final = {"f4": 1, "u4": 1, "i4": 1, "f2": 0.5, "u2": 0.5, "i2": 0.5, "u1": 0.25, "i1": 0.25}
_INTERPOLATION: Final = {
    Interpolation.SMOOTH: "SMOOTH",
    Interpolation.FLAT: "FLAT",
    Interpolation.NO_PERSPECTIVE: "LINEAR",
}


def pack_batch(surfaces: Sequence[int], batch: Mapping[str, float]) -> bytes:
    """Return a batch table as bytes: the addresses of MAX_PLANES surfaces, then the fields of `EMPTY_BATCH`
    in order. For single fields plain Python is several times as fast as NumPy."""
    return _BATCH_WORDS.pack(*surfaces, *batch.values())


def binding_offsets(bindings: Sequence[Binding]) -> list[int]:
    """Return the offset of each binding's words in a draw's row of bound words, and at the end their
    total."""
    starts = [0]
    for binding in bindings:
        starts.append(starts[-1] + _BINDING_WORDS[binding.kind])
    return starts


def varying_words(descriptor: ProgramDescriptor) -> int:
    """Return the number of words of a vertex's varyings in memory, rounded up to groups of four."""
    words = max((varying.word + varying.words for varying in descriptor.varyings), default=0)
    return -(-words // 4) * 4


def varying_word(descriptor: ProgramDescriptor, name: str) -> int:
    """Return the first word of a varying among a vertex's varyings, -1 if there is none of this name."""
    return next((varying.word for varying in descriptor.varyings if varying.name == name), -1)


@cache
def common_structs() -> str:
    """Return the sizes and structs that every kernel's text begins with."""
    sizes = {"GROUP": GROUP, "TILE_BITS": _TILE_BITS, "PART_BITS": _PART_BITS}
    structs = {"Batch": BATCH_STRUCT, "Draw": DRAW_STRUCT, "View": VIEW_STRUCT}
    defines = "".join(f"#define {name} {size}\n" for name, size in sizes.items())
    return defines + "".join(declare_struct(*item) for item in structs.items())


def vertex_macros(
    descriptor: ProgramDescriptor, streams: Sequence[VertexStream], faults: int = 0, line: int = 1
) -> str:
    """Return the macros of kernels/vertex.cl; `faults`: the address that a checked program reports faults at,
    and `line`: the line of the stage's text to which faults of its inputs belong."""
    starts, words = {}, 0
    for attribute in sorted(descriptor.attributes, key=lambda item: item.location):
        starts[attribute.location] = words
        words += _components(attribute)
    sizes = {attribute.location: _components(attribute) for attribute in descriptor.attributes}
    first = binding_offsets(descriptor.bindings)[-1]
    fetches = [
        line
        for index, stream in enumerate(streams)
        for attribute in stream.attributes
        for line in _fetch(
            stream, attribute, first + index, starts[attribute.location], sizes[attribute.location]
        )
    ]
    vertex_words = sum(
        ((1 << sizes[attribute.location]) - 1) << starts[attribute.location]
        for stream in streams
        for attribute in stream.attributes
        if not stream.per_instance
    )
    return (
        f"#define INPUT_WORDS {words}\n#define VARYING_WORDS {varying_words(descriptor)}\n"
        f"#define VERTEX_WORDS 0x{vertex_words:x}ul\n"
        f"#define BINDINGS {_arguments(descriptor.bindings, faults)}\n#define FETCH {' '.join(fetches)}\n"
        + (
            f"#define VERTEX_FAULTS AT(int, {faults}ul)\n#define VERTEX_LINE {line}\n"
            if faults and fetches
            else ""
        )
    )


def raster_macros(
    descriptor: ProgramDescriptor, fragment: bool, caches_depth: bool, bounds_depth: bool, faults: int = 0
) -> str:
    """Return the macros of the raster kernel besides those of the merger.

    Args:
        fragment: whether the fragment stage's text precedes the kernel's.
        faults: as for `vertex_macros`.
    """
    return (
        f"{stage_macros(descriptor, faults)}#define FRAGMENT {int(fragment)}\n"
        f"#define CACHES_DEPTH {int(caches_depth)}\n#define BOUNDS_DEPTH {int(bounds_depth)}\n"
    )


def stage_macros(descriptor: ProgramDescriptor, faults: int = 0) -> str:
    """Return the macros of kernels/varyings.cl and stage.cl; `faults`: as for `vertex_macros`."""
    varyings = " ".join(
        f"{_INTERPOLATION[varying.interpolation]}({word})"
        for varying in descriptor.varyings
        for word in range(varying.word, varying.word + varying.words)
    )
    return (
        f"#define VARYING_WORDS {varying_words(descriptor)}\n"
        f"#define BINDINGS {_arguments(descriptor.bindings, faults)}\n"
        f"#define VARYINGS(SMOOTH, FLAT, LINEAR) {varyings}\n"
    )


def _components(attribute: Attribute) -> int:
    return attribute.type.size if isinstance(attribute.type, VectorType) else 1


def _arguments(bindings: Sequence[Binding], faults: int) -> str:
    """Return the arguments of a stage's function, taken from a row of bound words."""
    arguments = []
    for binding, at in zip(bindings, binding_offsets(bindings), strict=False):
        match binding.kind:
            case BindingKind.UNIFORM:
                arguments.append(f"AT(const uint, row[{at}]),")
            case BindingKind.STORAGE:
                arguments.append(f"AT(uint, row[{at}]), (int)row[{at + 1}],")
            case BindingKind.TEXTURE:
                arguments.append(f"AT(const uchar, row[{at}]), AT(const int, row[{at + 1}]),")
            case BindingKind.IMAGE:
                arguments.append(f"AT(uchar, row[{at}]), AT(const int, row[{at + 1}]),")
    if faults:
        arguments.append(f"AT(int, {faults}ul),")
    return " ".join(arguments)


def _fetch(stream: VertexStream, attribute: VertexAttribute, at: int, start: int, size: int) -> Iterator[str]:
    """Yield the statements that load an attribute's components into the words of `inputs` from `start` on."""
    form = attribute.format
    count = -(-form.components * _WORDS[form.code] // 1)
    yield "{ uint16 raw[4];"
    address = f"AT(const uchar, row[{at}]) + {attribute.offset}"
    if stream.per_instance:
        yield f"spread({address} + (long)clamp(numbered, 0, draw->last_instance) * {stream.stride}, raw);"
    else:
        words = f"{stream.stride}, {count:.0f}, raw)"
        yield f"if (consecutive) gather_consecutive({address} + (long)vertices[0] * {stream.stride}, {words};"
        yield f"else gather({address}, vertices, {words};"
    for component in range(size):
        yield f"inputs[{start + component}] = {_component(form, component)};"
    yield "}"


def _component(form: VertexFormat, component: int) -> str:
    """Return the expression of a component as a word, extracted from the words of its format."""
    bits = 8 * np.dtype(form.code).itemsize
    if bits == 32:
        return f"raw[{component}]"
    word, shift = divmod(component * bits, 32)
    if form.code == "f2":
        return f"read_half_bits(raw[{word}], {shift})"
    kind = "FIELD" if not form.normalized else "UNORM" if form.code[0] == "u" else "SNORM"
    return f"{kind}(raw[{word}], {shift}, {bits})"


def _describe_empty_table() -> tuple[bytes, tuple[int, ...]]:
    """Return a batch table without draws, and the offsets of its addresses
    (`rhi.backends.cl.builds.Launch`)."""
    table = np.zeros((), BATCH_STRUCT)
    table["tiles"] = table["tiles_x"] = table["bounded"] = 1
    addresses: list[int] = []
    for name in BATCH_STRUCT.names or ():
        assert BATCH_STRUCT.fields is not None
        dtype, offset, *_ = BATCH_STRUCT.fields[name]
        if dtype.base == np.uint64:
            addresses += range(offset, offset + dtype.itemsize, 8)
    return table.tobytes(), tuple(addresses)


EMPTY_TABLE: Final = _describe_empty_table()
"""The argument of launches that only generate machine code."""
