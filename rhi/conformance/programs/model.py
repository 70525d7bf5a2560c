"""Programs as data: images, shapes, and the steps that use them.

- Everything is a frozen dataclass of numbers, enums and render states, so a program can be cut down step by
  step, and `to_python` prints the expression that makes it again.
- Images, shapes, queries and buffers are named by their index. Steps that refer to something that a cut has
  removed don't exist: the reducer removes steps and leaves resources alone.
- Corners are in texels of the `frame` that a draw names: window coordinates if the viewport has the frame's
  size.
"""

from __future__ import annotations

import enum
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import TypeAlias

from rhi import Format, Primitive, State, TextureKind

Color: TypeAlias = tuple[float, float, float, float]

CELLS = 64
"""Number of uint32 in each of the buffers that fragments and dispatches write."""


@dataclass(frozen=True, slots=True)
class Image:
    """A texture, zeroed."""

    size: tuple[int, int]
    format: Format
    kind: TextureKind = TextureKind.D2
    layers: int = 1
    levels: int = 1
    samples: int = 1

    def level_size(self, level: int) -> tuple[int, int]:
        """Return the (width, height) of a mip level."""
        return max(1, self.size[0] >> level), max(1, self.size[1] >> level)

    def level_layers(self, level: int) -> int:
        """Return the number of layers of a mip level."""
        return max(1, self.layers >> level) if self.kind is TextureKind.D3 else self.layers


@dataclass(frozen=True, slots=True)
class Subresource:
    """A level and layer of an image."""

    image: int
    level: int = 0
    layer: int = 0


@dataclass(frozen=True, slots=True)
class Shape:
    """A mesh: (x, y, depth, w, red, green, blue, alpha) of each corner, x and y in texels of a frame, y
    down."""

    primitive: Primitive
    corners: tuple[tuple[float, ...], ...]
    indices: tuple[int, ...] | None = None

    @property
    def elements(self) -> int:
        """The number of indices, or of corners without indices."""
        return len(self.corners if self.indices is None else self.indices)


class ShaderKind(enum.Enum):
    """The work of a draw's fragments; `rhi.conformance.programs.shader_kinds` has their shaders."""

    FLAT = "the color of the first corner"
    SMOOTH = "the interpolated color"
    TWO_TARGETS = "the color, and reversed to a second target"
    UINT = "the color as unsigned integers"
    INT = "the color as signed integers"
    DISCARD = "the color; every other texel is discarded"
    WRITTEN_DEPTH = "the color; its alpha is the depth"
    COUNT = "the color; counts fragments, and keeps their largest red in the cell of their column"
    COUNT_EARLY = "as COUNT, with early depth test"
    DISCARD_EARLY = "as DISCARD, with early depth test"
    LOAD = "the color, and the texel of a 2D image at the same place, added"
    LOAD_LAYER = "the color, and the texel of a layer of an array at the same place, added"


class DrawMethod(enum.Enum):
    """The way in which a draw is submitted."""

    DIRECT = "one call"
    MANY = "an array of draws"
    INDIRECT = "arguments in a buffer"
    COUNTED = "an array of draws, each in a query of a set"


@dataclass(frozen=True, slots=True)
class Part:
    """A range of a shape's elements, drawn a number of times."""

    first: int
    count: int
    instances: int = 1
    base_instance: int = 0


@dataclass(frozen=True, slots=True)
class Draw:
    """Parts of a shape, drawn with states.

    Attributes:
        frame: the size that the corners' coordinates refer to.
        step: clip x and y that each instance is moved by.
        query: the number of an occlusion query around it, or None.
        condition: (query, inverted): conditional rendering, or None.
        source: what LOAD reads.
    """

    shader: ShaderKind
    shape: int
    parts: tuple[Part, ...]
    frame: tuple[int, int]
    states: tuple[State, ...] = ()
    step: tuple[float, float] = (0.0, 0.0)
    method: DrawMethod = DrawMethod.DIRECT
    query: int | None = None
    condition: tuple[int, bool] | None = None
    source: Subresource | None = None


@dataclass(frozen=True, slots=True)
class Pass:
    """A render pass. `clear` has one color, or None, for each of `colors`; `resolve` an image, or None."""

    colors: tuple[Subresource, ...]
    depth: Subresource | None
    draws: tuple[Draw, ...]
    clear: tuple[Color | None, ...] = ()
    clear_depth: float | None = None
    clear_stencil: int | None = None
    resolve: tuple[int | None, ...] = ()


@dataclass(frozen=True, slots=True)
class RecordedPasses:
    """Passes that are recorded into a command buffer, which is submitted a number of times."""

    passes: tuple[Pass, ...]
    times: int = 1


@dataclass(frozen=True, slots=True)
class Copy:
    """A copy of a box of texels: (x, y, width, height, layer, layers) of `source`'s image and level."""

    source: Subresource
    box: tuple[int, int, int, int, int, int]
    target: Subresource
    x: int = 0
    y: int = 0


@dataclass(frozen=True, slots=True)
class Write:
    """A write of a rectangle of random texels, which the seed determines."""

    target: Subresource
    x: int
    y: int
    width: int
    height: int
    seed: int


@dataclass(frozen=True, slots=True)
class Mipmaps:
    """The generation of all levels from the first one."""

    image: int


@dataclass(frozen=True, slots=True)
class Resolve:
    """A resolve outside a pass."""

    source: int
    target: int


@dataclass(frozen=True, slots=True)
class Read:
    """A read in the middle of a program, which waits; the texels are part of the result."""

    subresource: Subresource


@dataclass(frozen=True, slots=True)
class Reshape:
    """A write over the first corners of a shape, with those of another one."""

    shape: int
    source: int


@dataclass(frozen=True, slots=True)
class ClearCells:
    """A clear of all cells to one number."""

    value: int


@dataclass(frozen=True, slots=True)
class Dispatch:
    """A compute pass: each cell adds up its column's texels, their first channel times 8, rounded down."""

    source: Subresource


Step: TypeAlias = (
    Pass | RecordedPasses | Copy | Write | Mipmaps | Resolve | Read | Reshape | ClearCells | Dispatch
)


@dataclass(frozen=True, slots=True)
class Program:
    """A whole program. `queries` is the number of occlusion queries that its draws may name."""

    images: tuple[Image, ...]
    shapes: tuple[Shape, ...]
    steps: tuple[Step, ...]
    queries: int = 0


def to_python(value: object) -> str:
    """Return the Python expression of a program or a part of it. Fields that have their default are left
    out."""
    if isinstance(value, enum.Enum):
        return f"{type(value).__name__}.{value.name}"
    if is_dataclass(value):
        parts: list[str] = []
        for subresource, field in enumerate(fields(value)):
            argument = getattr(value, field.name)
            if field.default is MISSING:
                named = len(parts) < subresource
                parts.append(f"{field.name}={to_python(argument)}" if named else to_python(argument))
            elif argument != field.default:
                parts.append(f"{field.name}={to_python(argument)}")
        return f"{type(value).__name__}({', '.join(parts)})"
    if isinstance(value, tuple):
        inner = ", ".join(map(to_python, value))
        return f"({inner},)" if len(value) == 1 else f"({inner})"
    return repr(value)
