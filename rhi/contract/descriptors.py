"""Descriptors of resources, passes and programs: plain frozen values, validated before a backend sees them.

- The device names resources by integers, so a command is plain data: a stream of commands can be printed,
  saved, compared and replayed without translating object references.
- Defaults serve the most common use: a 2D texture with one level, a linear sampler that repeats.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np

from rhi.contract.blocks import CompressedFormat
from rhi.contract.formats import Format, IndexFormat
from rhi.contract.states import Comparison
from rhi.errors.arguments import FieldChecker
from rhi.errors.choices import Choice
from rhi.errors.data_classes import dataclass

Id: TypeAlias = int
"""The name of a resource. The device assigns it and never uses it again; 0 means none."""
# Traces are checked by these annotations, which say what an id stands for.
BufferId: TypeAlias = Id
"""The `Id` of a buffer."""
TextureId: TypeAlias = Id
"""The `Id` of a texture."""
SamplerId: TypeAlias = Id
"""The `Id` of a sampler."""
ProgramId: TypeAlias = Id
"""The `Id` of a program."""
VertexArrayId: TypeAlias = Id
"""The `Id` of a vertex array."""
QueryId: TypeAlias = Id
"""The `Id` of a query."""

Vec4: TypeAlias = tuple[float, float, float, float]

WHOLE: Final = -1
"""As a size: everything from the offset to the end."""


class Primitive(Choice):
    """Primitive topology. Each of the QUADS is drawn as two triangles (0 1 2, 0 2 3)."""

    POINTS = "points"
    LINES = "lines"
    LINE_STRIP = "line_strip"
    TRIANGLES = "triangles"
    TRIANGLE_STRIP = "triangle_strip"
    TRIANGLE_FAN = "triangle_fan"
    QUADS = "quads"


class Access(Choice):
    """Access to locked memory. READ copies from the device when the lock begins, WRITE copies to it when the
    lock ends, READ_WRITE does both."""

    READ = "read"
    WRITE = "write"
    READ_WRITE = "read_write"

    reads: bool
    writes: bool

    def __init__(self, name: str) -> None:
        self.reads = "read" in name
        self.writes = "write" in name


class BufferUsage(Choice):
    """The way in which a buffer's contents change.

    STATIC: written rarely. STREAM: ring memory. The CPU writes it only where the ring's fences guarantee that
    the GPU has finished reading, so a backend may map it and write without synchronisation. READBACK: the
    target of copies, which the CPU reads only where a fence guarantees that the GPU has finished writing. A
    backend may treat both like STATIC.
    """

    STATIC = "static"
    STREAM = "stream"
    READBACK = "readback"


@dataclass(frozen=True, slots=True)
class BufferDescriptor:
    """The size of a buffer in bytes, and how it is used."""

    size: int
    usage: BufferUsage = BufferUsage.STATIC
    label: str = ""


class TextureKind(Choice):
    """The dimensions of a texture. A cube has 6 layers: +X −X +Y −Y +Z −Z."""

    D2 = "2d"
    D2_ARRAY = "2d_array"
    D3 = "3d"
    CUBE = "cube"


@dataclass(frozen=True, slots=True)
class TextureDescriptor:
    """The shape and format of a texture. `size` is (width, height); `layers` are array layers, cube faces (6)
    or the depth of a 3D texture. A texture that is stored as blocks names their format as `compressed`; then
    `format` is that of its texels, and it is only written and sampled."""

    size: tuple[int, int]
    format: Format
    kind: TextureKind = TextureKind.D2
    layers: int = 1
    levels: int = 1
    samples: int = 1
    label: str = ""
    compressed: CompressedFormat | None = None

    def level_size(self, level: int) -> tuple[int, int]:
        """Return the (width, height) of a mip level."""
        return max(1, self.size[0] >> level), max(1, self.size[1] >> level)

    def level_layers(self, level: int) -> int:
        """Return the number of layers of a mip level: the depth of a 3D texture shrinks, the layers of an
        array don't."""
        return max(1, self.layers >> level) if self.kind is TextureKind.D3 else self.layers


class Filter(Choice):
    """Texture filter: NEAREST reads one texel, LINEAR interpolates between the nearest ones."""

    NEAREST = "nearest"
    LINEAR = "linear"


class Wrap(Choice):
    """Texture address mode outside 0 to 1: REPEAT the image, MIRROR it at each repetition, CLAMP to its edge
    texels, or use the sampler's BORDER color."""

    REPEAT = "repeat"
    MIRROR = "mirror"
    CLAMP = "clamp"
    BORDER = "border"


@dataclass(frozen=True, slots=True)
class SamplerDescriptor:
    """Filters, addressing and comparison with which a shader samples a texture.

    With `mip` None only level 0 is sampled; loads of single texels may still name any level. With `compare`
    it is a depth comparison sampler, which returns 1 where `reference compare texel` is true. A `border` is
    clamped to the range of the texture's format. With `max_anisotropy` above 1 a pixel that covers up to so
    many times as much of the texture in one direction as in the other is an average along the longer one.
    Integers are never averaged.
    """

    minify: Filter = Filter.LINEAR
    magnify: Filter = Filter.LINEAR
    mip: Filter | None = Filter.LINEAR
    wrap_u: Wrap = Wrap.REPEAT
    wrap_v: Wrap = Wrap.REPEAT
    wrap_w: Wrap = Wrap.REPEAT
    border: Vec4 = (0.0, 0.0, 0.0, 0.0)
    compare: Comparison | None = None
    max_anisotropy: float = 1.0

    def __post_init__(self) -> None:
        fields = FieldChecker(self)
        fields.choices(Filter, "minify", "magnify")
        fields.choices_or_none(Filter, "mip")
        fields.choices(Wrap, "wrap_u", "wrap_v", "wrap_w")
        fields.colors("border")
        fields.choices_or_none(Comparison, "compare")
        fields.numbers("max_anisotropy", minimum=1)

    @property
    def uses_border(self) -> bool:
        """True if any axis wraps to the border color."""
        return Wrap.BORDER in (self.wrap_u, self.wrap_v, self.wrap_w)


@dataclass(frozen=True, slots=True)
class Region:
    """A box of texels of one level. x and y count from the top left; `layer` is the first of `layers`."""

    x: int
    y: int
    width: int
    height: int
    layer: int = 0
    layers: int = 1

    def __post_init__(self) -> None:
        FieldChecker(self).integers("x", "y", "width", "height", "layer", "layers")


# -- vertex arrays ---------------------------------------------------------------------------------------


class VertexFormat(Choice):
    """The format of a vertex attribute: (NumPy code, components, normalised, scalar type in the shader)."""

    FLOAT = ("f4", 1, False, "float")
    FLOAT2 = ("f4", 2, False, "float")
    FLOAT3 = ("f4", 3, False, "float")
    FLOAT4 = ("f4", 4, False, "float")
    HALF2 = ("f2", 2, False, "float")
    HALF4 = ("f2", 4, False, "float")
    UINT = ("u4", 1, False, "uint")
    UINT2 = ("u4", 2, False, "uint")
    UINT3 = ("u4", 3, False, "uint")
    UINT4 = ("u4", 4, False, "uint")
    INT = ("i4", 1, False, "int")
    INT2 = ("i4", 2, False, "int")
    INT3 = ("i4", 3, False, "int")
    INT4 = ("i4", 4, False, "int")
    UNORM8X4 = ("u1", 4, True, "float")
    SNORM8X4 = ("i1", 4, True, "float")
    UNORM16X2 = ("u2", 2, True, "float")
    SNORM16X2 = ("i2", 2, True, "float")
    UINT8X4 = ("u1", 4, False, "uint")
    UINT16X2 = ("u2", 2, False, "uint")

    code: str
    components: int
    normalized: bool
    kind: str

    def __init__(self, code: str, components: int, normalized: bool, kind: str) -> None:
        self.code = code
        self.components = components
        self.normalized = normalized
        self.kind = kind

    @property
    def size(self) -> int:
        """The number of bytes that an attribute takes."""
        return self.components * int(self.code[1:])


@dataclass(frozen=True, slots=True)
class VertexAttribute:
    """The attribute `location` of a vertex: `offset` bytes into each element of its stream, in this
    `format`."""

    location: int
    format: VertexFormat
    offset: int


@dataclass(frozen=True, slots=True)
class VertexStream:
    """A buffer of vertices or, with `per_instance`, of instances. Offset and stride are in bytes."""

    buffer: BufferId
    offset: int
    stride: int
    per_instance: bool
    attributes: tuple[VertexAttribute, ...]


@dataclass(frozen=True, slots=True)
class VertexArrayDescriptor:
    """The vertex streams and the index buffer that draws of one program read."""

    program: ProgramId
    streams: tuple[VertexStream, ...]
    index_buffer: BufferId = 0
    index_format: IndexFormat = IndexFormat.UINT32


# -- passes ----------------------------------------------------------------------------------------------


ALL_LAYERS: Final = -1
"""The layer of an attachment, or an image binding, that is all layers of a level."""


@dataclass(frozen=True, slots=True)
class Attachment:
    """A color target: one level and layer of a texture, or all its layers: −1. `clear` None loads its
    contents. `resolve` names the texture that receives the resolved samples at the end of the pass, in its
    level and layer 0."""

    texture: TextureId
    level: int = 0
    layer: int = 0
    clear: Vec4 | None = None
    resolve: TextureId = 0


@dataclass(frozen=True, slots=True)
class DepthAttachment:
    """A depth target, with or without stencil, of one layer or of all: −1. A clear value of None loads the
    contents."""

    texture: TextureId
    level: int = 0
    layer: int = 0
    clear: float | None = None
    clear_stencil: int | None = None


@dataclass(frozen=True, slots=True)
class PassDescriptor:
    """The targets of a render pass. All of them have `size` (width, height)."""

    size: tuple[int, int]
    colors: tuple[Attachment, ...] = ()
    depth: DepthAttachment | None = None
    samples: int = 1
    label: str = ""

    @property
    def is_layered(self) -> bool:
        """True if the pass draws to all layers of its targets."""
        targets = self.colors or (self.depth,)
        return targets[0] is not None and targets[0].layer == ALL_LAYERS


# -- queries ---------------------------------------------------------------------------------------------


class QueryKind(Choice):
    """Type of a query. OCCLUSION counts the samples that pass between begin and end. COUNTER reads the
    running samples-passed counter and TIMESTAMP the time in nanoseconds, both at one point of the stream."""

    OCCLUSION = "occlusion"
    COUNTER = "counter"
    TIMESTAMP = "timestamp"


# -- programs --------------------------------------------------------------------------------------------


class Stage(Choice):
    """A shader stage of a program."""

    VERTEX = "vertex"
    FRAGMENT = "fragment"
    COMPUTE = "compute"


class BindingKind(Choice):
    """Type of a binding slot."""

    UNIFORM = "uniform"
    STORAGE = "storage"
    TEXTURE = "texture"
    IMAGE = "image"


@dataclass(frozen=True, slots=True)
class Binding:
    """A binding of a program. `slot` counts from 0 for each kind.

    `type` is the type that must be bound: the host type of a uniform or storage element, or a texture or
    image type. `size` is the size of one element in bytes. `writes` and `reads` say what the program does
    with its memory; `reads` may be True for memory that isn't read. `table` is the name of the texture
    table whose images the texture describes; a draw passes both as one value.
    """

    name: str
    kind: BindingKind
    slot: int
    writes: bool = False
    type: object = None
    size: int = 0
    reads: bool = True
    table: str = ""


@dataclass(frozen=True, slots=True)
class Attribute:
    """An input of a vertex stage. `type` is a scalar or vector of `rhi.contract.layout`."""

    name: str
    location: int
    type: object


@dataclass(frozen=True, slots=True)
class FragmentOutput:
    """An output of a fragment stage. `kind` is "float", "int" or "uint"."""

    name: str
    location: int
    kind: str
    components: int


class Interpolation(Choice):
    """The interpolation of a varying: SMOOTH with perspective correction, FLAT from the first vertex, or
    NO_PERSPECTIVE, linearly in screen space."""

    SMOOTH = "smooth"
    FLAT = "flat"
    NO_PERSPECTIVE = "no_perspective"


@dataclass(frozen=True, slots=True)
class StageVarying:
    """An output of the vertex stage that the fragment stage reads. It occupies `words` 32-bit words from
    `word` on; a matrix is stored row by row. `kind` is "float", "int" or "uint"."""

    name: str
    word: int
    words: int
    kind: str
    interpolation: Interpolation = Interpolation.SMOOTH


@dataclass(frozen=True, slots=True)
class StageText:
    """The source text of one stage, and where each of its lines came from.

    `origins[i]` is the (file, line) of the Python source of line i of the text, counted from 0; ("", 0) where
    no Python line stands behind it. Lines without an entry have no known origin. `binary` is what the text
    was compiled to, in a language that isn't text ("spirv"). `generated`: whether nobody wrote any of it, so
    drivers accept it.
    """

    text: str
    origins: tuple[tuple[str, int], ...] = ()
    binary: bytes = b""
    generated: bool = False


@dataclass(frozen=True, eq=False)
class ProgramDescriptor:
    """A program with its stages, bindings, inputs and outputs.

    Attributes:
        emit: a function of (language, stage) that returns the `StageText` of a stage. Languages are "glsl"
            (4.30); "opencl16" (OpenCL C for 16 lanes, see `rhi.shading.opencl.opencl_stages`), for compute
            stages also "opencl1", "opencl4" and "opencl8"; for compute stages "numpy", a Python module;
            "vulkan" (GLSL 4.50 for Vulkan) and "spirv", its `binary`; "wgsl"; and those of
            `rhi.shading.register_language`.
        work_group: size of a work-group in invocations.
        varyings: the varyings that the fragment stage reads, the point size and the target's layer, in the
            order of their words.
        shared_bytes: memory that a work-group shares, in bytes.
        checked: whether the stages report faults on OpenCL and NumPy (`rhi.shading.ir.faults`).
        flushes_denormals: whether numbers below 2^-126 may be treated as 0, which OpenGL may always do.
        point_size: the name of the varying that is the size of points, "" if there is none.
        target_layer: the name of the varying that is the target's layer, "" if there is none.
        reads_point_coordinates: whether the fragment stage reads its coordinates inside a point.
        reads_draw_index: whether the vertex stage reads the index of the draw.
        vertex_writes: whether the vertex stage writes memory.
    """

    name: str
    stages: frozenset[Stage]
    bindings: tuple[Binding, ...]
    attributes: tuple[Attribute, ...]
    outputs: tuple[FragmentOutput, ...]
    work_group: tuple[int, int, int]
    emit: Callable[[str, Stage], StageText]
    writes_memory: bool = False
    discards: bool = False
    early_depth: bool = False
    writes_depth: bool = False
    varyings: tuple[StageVarying, ...] = ()
    shared_bytes: int = 0
    checked: bool = False
    flushes_denormals: bool = False
    point_size: str = ""
    target_layer: str = ""
    reads_point_coordinates: bool = False
    reads_draw_index: bool = False
    vertex_writes: bool = False

    def __post_init__(self) -> None:
        fields = FieldChecker(self)
        fields.text("name", self.name)
        fields.text("point_size", self.point_size)
        fields.text("target_layer", self.target_layer)
        fields.members("stages", self.stages, frozenset, Stage)
        fields.members("bindings", self.bindings, tuple, Binding)
        fields.members("attributes", self.attributes, tuple, Attribute)
        fields.members("outputs", self.outputs, tuple, FragmentOutput)
        fields.members("varyings", self.varyings, tuple, StageVarying)
        sizes = fields.members("work_group", self.work_group, tuple, int)
        if len(sizes) != 3 or min(sizes) < 1:
            fields.fail("work_group", sizes, "3 whole numbers, 1 or more")
        if not callable(self.emit):
            fields.fail("emit", self.emit, "a function of language and stage that returns a StageText")
        fields.flags(
            "writes_memory",
            "discards",
            "early_depth",
            "writes_depth",
            "checked",
            "flushes_denormals",
            "reads_point_coordinates",
            "reads_draw_index",
            "vertex_writes",
        )
        fields.integers("shared_bytes", minimum=0)


DRAW: Final = np.dtype(
    [
        ("count", "<u4"),
        ("instances", "<u4"),
        ("first", "<u4"),
        ("base_vertex", "<i4"),
        ("base_instance", "<u4"),
    ]
)
"""One draw of an indexed mesh, as `draw_many` and indirect draws read it (20 bytes)."""

DRAW_UNINDEXED: Final = np.dtype(
    [("count", "<u4"), ("instances", "<u4"), ("first", "<u4"), ("base_instance", "<u4"), ("unused", "<u4")]
)
"""One draw of a mesh without indices (20 bytes)."""
