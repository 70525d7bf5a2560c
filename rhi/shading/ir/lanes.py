"""Lane code: stages in scalar components with explicit masks. OpenCL C and NumPy are written from it.

- One value is one component of W invocations ("lanes"). Its `Uniformity` says which invocations share the
  value; all but VARYING values are written as scalars. An `Affine` value is a uniform value plus a multiple
  of the lane index, so that memory is read with vector loads.
- A branch whose condition is the same for all lanes is a real branch. Where the condition varies, a mask (a
  bool variable) says which lanes take part: `Set`, `Store` and `Atomic` have a mask, loops end when no lane
  is active, and `If(any_lane=True)` skips work that no lane needs.
- There are no calls: each is inlined, so that a function is specialised for the uniformity of its arguments.
- Memory consists of 32-bit words; an access addresses the word `index * scale + offset`.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from typing import Final, TypeAlias

from rhi.contract.descriptors import TextureKind
from rhi.contract.layout import BOOL, FLOAT, INT, UINT, ScalarType
from rhi.errors.choices import Choice
from rhi.errors.data_classes import dataclass
from rhi.shading.ir import nodes


class Uniformity(enum.IntEnum):
    """The invocations that share a value: the whole dispatch, a work-group, the lanes of a work-item, or
    none."""

    DISPATCH = 0
    GROUP = 1
    LANES = 2
    VARYING = 3


@dataclass(slots=True, eq=False)
class Variable:
    """A named component. Its `uniformity` is final when lowering is done."""

    name: str
    kind: ScalarType
    uniformity: Uniformity


class AddressSpace(Choice):
    """The kind of memory that a region lies in."""

    UNIFORM = "uniform"
    STORAGE = "storage"
    SHARED = "shared"
    PRIVATE = "private"
    CONSTANT = "constant"
    TEXTURE = "texture"
    IMAGE = "image"


@dataclass(slots=True, eq=False)
class MemoryRegion:
    """An array of words.

    PRIVATE memory is one array of `kind` for each lane; a `uniformity` below VARYING means that all lanes
    share one.

    Attributes:
        stride: words of one element.
        length: words of the whole region; 0 if the size of the bound buffer decides.
        values: the contents of CONSTANT memory.
        shape: the kind of a TEXTURE or IMAGE.
    """

    name: str
    space: AddressSpace
    stride: int = 1
    length: int = 0
    writable: bool = False
    kind: ScalarType = UINT
    uniformity: Uniformity = Uniformity.VARYING
    values: tuple[float, ...] = ()
    shape: TextureKind = TextureKind.D2


# -- values ------------------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class Value:
    """A component of a value; a varying bool is a mask. Arithmetic on values creates `Apply` values."""

    kind: ScalarType
    uniformity: Uniformity

    def __add__(self, other: Value) -> Value:
        return apply("add", self, other)

    def __sub__(self, other: Value) -> Value:
        return apply("subtract", self, other)

    def __mul__(self, other: Value) -> Value:
        return apply("multiply", self, other)

    def __truediv__(self, other: Value) -> Value:
        return apply("divide", self, other)

    def __neg__(self) -> Value:
        return apply("negate", self)

    def __and__(self, other: Value) -> Value:
        return apply("and", self, other)

    def __or__(self, other: Value) -> Value:
        return apply("or", self, other)


@dataclass(slots=True, eq=False)
class Literal(Value):
    """A constant."""

    value: float


@dataclass(slots=True, eq=False)
class Get(Value):
    """The current value of a variable."""

    variable: Variable


@dataclass(slots=True, eq=False)
class Affine(Value):
    """`base + stride * lane`, where all lanes share the base."""

    base: Value
    stride: int


@dataclass(slots=True, eq=False)
class Apply(Value):
    """A primitive operation, by its name in `rhi.shading.ir.primitives`; `depth` operations nest in it."""

    operation: str
    arguments: tuple[Value, ...]
    depth: int = 0


@dataclass(slots=True, eq=False)
class Load(Value):
    """The word at `index * scale + offset`. Lanes outside `mask` read nothing; their value is undefined.

    With a `limit`, which only an affine index has, lanes whose index isn't below it read the nearest element.
    """

    memory: MemoryRegion
    index: Value
    scale: int
    offset: int
    mask: Variable | None
    limit: Value | None = None


@dataclass(slots=True, eq=False)
class ElementCount(Value):
    """The number of elements of a storage buffer."""

    memory: MemoryRegion


class DispatchIndex(Choice):
    """A built-in index of an invocation or its work-group. Those with several axes are read one axis at a
    time."""

    GROUP_ID = "group_id"
    GROUP_COUNT = "group_count"
    ITEM = "item"
    LOCAL_INDEX = "local_index"


@dataclass(slots=True, eq=False)
class Input(Value):
    """A component of a `DispatchIndex`."""

    index: DispatchIndex
    axis: int = 0


@dataclass(slots=True, eq=False)
class Argument(Value):
    """A component passed in by the caller: of a function evaluated on arrays, or of a stage's inputs."""

    name: str


# -- statements --------------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class Statement:
    """A statement, with the (file, line) of the Python source it was lowered from."""

    line: tuple[str, int]


@dataclass(slots=True, eq=False)
class Let(Statement):
    """Declare a variable, with or without an initial value."""

    variable: Variable
    value: Value | None


@dataclass(slots=True, eq=False)
class DeclareMemory(Statement):
    """Declare private memory, filled with zeros if `zeros` is true."""

    memory: MemoryRegion
    zeros: bool


@dataclass(slots=True, eq=False)
class Set(Statement):
    """Assign a value to a variable in the lanes of `mask`, or in all lanes if it is None."""

    variable: Variable
    value: Value
    mask: Variable | None


@dataclass(slots=True, eq=False)
class Store(Statement):
    """Store consecutive words, starting at `index * scale + offset`.

    If several lanes store different values to one address, the last active lane wins. `padding` is the number
    of words behind the values that are never read and may be overwritten.
    """

    memory: MemoryRegion
    index: Value
    scale: int
    offset: int
    values: tuple[Value, ...]
    mask: Variable | None
    padding: int = 0


@dataclass(slots=True, eq=False)
class Atomic(Statement):
    """Perform an atomic operation on one word.

    `result` receives the old word, unless it is None because the result is unused. `values` has one element;
    a compare and exchange has two, the expected and the new word.
    """

    result: Variable | None
    operation: str
    kind: ScalarType
    memory: MemoryRegion
    index: Value
    scale: int
    offset: int
    values: tuple[Value, ...]
    mask: Variable | None


@dataclass(slots=True, eq=False)
class TextureAccess(Statement):
    """Read, query or write a texture or image; `results` receive the components.

    Coordinates have three components. The operations and their arguments are: sample (at, level),
    sample_compare (at, reference, level), sample_grad (at, step right, step down, bias), sample_compare_grad
    (at, reference, step right, step down, bias), gather (component, at), gather_compare (at, reference), load
    (texel, level), store (texel, four values), size (level), levels. Steps are the differences of coordinates
    to the next pixels, which bound the pixel's area. Nothing is read outside the texture. `mask` says which
    lanes store.
    """

    operation: str
    memory: MemoryRegion
    arguments: tuple[Value, ...]
    results: tuple[Variable, ...]
    mask: Variable | None


@dataclass(slots=True, eq=False)
class Barrier(Statement):
    """Synchronise the work-group if `waits` is true; otherwise only order its memory accesses."""

    waits: bool


@dataclass(slots=True, eq=False)
class Check(Statement):
    """Report a fault on this line if `wrong` is true in a lane of `mask`: `value` isn't below `limit`."""

    wrong: Value
    value: Value
    limit: Value
    mask: Variable | None


@dataclass(slots=True, eq=False)
class If(Statement):
    """A real branch on a condition that all lanes share or, with `any_lane`, on whether it is true in any
    lane."""

    condition: Value
    then: Block
    otherwise: Block
    any_lane: bool = False


@dataclass(slots=True, eq=False)
class Loop(Statement):
    """Repeat the body until a `Break`. `advance` runs after each iteration, also after a `Continue`."""

    body: Block
    advance: Block


@dataclass(slots=True, eq=False)
class Break(Statement):
    """Leave the loop: always, or only if no lane is set in the mask `when_empty`."""

    when_empty: Variable | None = None


@dataclass(slots=True, eq=False)
class Continue(Statement):
    """Start the next iteration: always, or only if no lane is set in the mask `when_empty`."""

    when_empty: Variable | None = None


@dataclass(slots=True, eq=False)
class InlinedCall(Statement):
    """The inlined body of a called function. `returns_early` is true if a `Return` ends it early."""

    label: str
    block: Block
    returns_early: bool = False


@dataclass(slots=True, eq=False)
class Return(Statement):
    """Leave an inlined call: always, or only if no lane is set in the mask `when_empty`."""

    call: InlinedCall
    when_empty: Variable | None = None


Block: TypeAlias = list[Statement]


@dataclass(slots=True, eq=False)
class Code:
    """A stage or function in lane code: its arguments, memory, statements and results.

    `width` is the number of lanes, 0 for whole arrays.
    """

    name: str
    width: int
    block: Block
    memories: tuple[MemoryRegion, ...]
    arguments: tuple[Argument, ...] = ()
    results: tuple[Value, ...] = ()
    work_group: tuple[int, int, int] = (1, 1, 1)
    checked: bool = False


# -- creating values -----------------------------------------------------------------------------------------

_COMPARISONS: Final = frozenset({"equal", "not_equal", "less", "less_equal", "greater", "greater_equal"})
_FIXED: Final = {
    "to_float": FLOAT,
    "to_int": INT,
    "to_uint": UINT,
    "as_float": FLOAT,
    "as_int": INT,
    "as_uint": UINT,
    "half_bits": UINT,
    "half_value": FLOAT,
}


def literal(value: float, kind: ScalarType = FLOAT) -> Literal:
    """Return a constant."""
    return Literal(kind, Uniformity.DISPATCH, value)


def number(value: int) -> Literal:
    """Return an int constant."""
    return Literal(INT, Uniformity.DISPATCH, value)


def get(variable: Variable) -> Get:
    """Return the current value of a variable."""
    return Get(variable.kind, variable.uniformity, variable)


TRUE: Final = literal(True, BOOL)
FALSE: Final = literal(False, BOOL)


def apply(operation: str, *arguments: Value) -> Value:
    """Return a primitive operation applied to arguments, simplified where possible.

    Its kind is the arguments' kind or fixed by the operation; it varies as much as the most varying argument.
    """
    simple = _simplify(operation, arguments)
    if simple is not None:
        return simple
    kind = _FIXED.get(operation, BOOL if operation in _COMPARISONS else arguments[-1].kind)
    depth = 1 + max(argument.depth if isinstance(argument, Apply) else 0 for argument in arguments)
    return Apply(kind, max(argument.uniformity for argument in arguments), operation, arguments, depth)


def _simplify(operation: str, arguments: tuple[Value, ...]) -> Value | None:
    """Fold addresses (sums, products of int constants and affine values), selects, masks; None if nothing
    folds."""
    a = arguments[0]
    match operation:
        case "select" if isinstance(a, Literal):
            return arguments[1] if a.value else arguments[2]
        case "not" if isinstance(a, Literal):
            return FALSE if a.value else TRUE
        case "and" | "or" if a.kind is BOOL:
            for factor, rest in (arguments, arguments[::-1]):
                if isinstance(factor, Literal):
                    return rest if bool(factor.value) == (operation == "and") else factor
            return None
        case "to_int" | "to_uint" if isinstance(a, Affine):
            base = apply(operation, a.base)
            return Affine(base.kind, Uniformity.VARYING, base, a.stride)
        case "to_int" if a.kind is INT:
            return a
    if a.kind not in (INT, UINT) or len(arguments) != 2:
        return None
    b = arguments[1]
    match operation:
        case "add" | "subtract":
            if _is(b, 0):
                return a
            if operation == "add" and _is(a, 0):
                return b
            folded = _fold(operation, a, b)
            if folded is not None:
                return folded
            return _affine_sum(operation, a, b)
        case "multiply":
            for factor, rest in ((a, b), (b, a)):
                if _is(factor, 1):
                    return rest
                if isinstance(factor, Literal) and isinstance(rest, Affine) and factor.value:
                    base = apply("multiply", rest.base, factor)
                    return Affine(rest.kind, Uniformity.VARYING, base, rest.stride * int(factor.value))
            return _fold(operation, a, b)
    return None


def _is(value: Value, number: int) -> bool:
    return isinstance(value, Literal) and value.value == number


def _fold(operation: str, a: Value, b: Value) -> Value | None:
    if not (isinstance(a, Literal) and isinstance(b, Literal)):
        return None
    x, y = int(a.value), int(b.value)
    result = x + y if operation == "add" else x - y if operation == "subtract" else x * y
    return literal(result, a.kind) if 0 <= result < 2**31 else None


def _affine_sum(operation: str, a: Value, b: Value) -> Value | None:
    sign = 1 if operation == "add" else -1
    (base_a, stride_a), (base_b, stride_b) = _split(a), _split(b)
    if base_a is None or base_b is None or not (stride_a or stride_b):
        return None
    base, stride = apply(operation, base_a, base_b), stride_a + sign * stride_b
    return Affine(a.kind, Uniformity.VARYING, base, stride) if stride else base


def _split(value: Value) -> tuple[Value | None, int]:
    if isinstance(value, Affine):
        return value.base, value.stride
    return (value, 0) if value.uniformity < Uniformity.VARYING else (None, 0)


# -- walking -----------------------------------------------------------------------------------------------


def parts_of(node: Value | Statement) -> tuple[Value, ...]:
    """Return the direct operands of a value or statement."""
    return nodes.operands(node, "Value")


def within(node: Value) -> Iterator[Value]:
    """Yield a value and all values that it is computed from."""
    return nodes.within(node, "Value")


def variables_of(value: Value) -> Iterator[Variable]:
    """Yield the variables that a value reads."""
    return (part.variable for part in within(value) if isinstance(part, Get))


WIDTH: Final = 16
"""The number of lanes of a draw's stages on OpenCL: 16 vertices, or 4 by 4 pixels with lane = x + 4 y."""

FIRST_VERTEX: Final = "vertex"
"""Name of the argument with the first lane's vertex. The others are consecutive unless the writer says
otherwise."""


@dataclass(frozen=True, slots=True)
class StageCode:
    """A stage in lane code.

    `code.arguments` are the parameters' components that are read, the built-in inputs in the order of the
    table of built-ins, and the mask. `code.results` are the outputs, one for each word of `words`; then the
    depth, if the stage writes one; and, for a fragment stage, the mask of the lanes that were not discarded.
    """

    code: Code
    words: tuple[int, ...]
    has_depth: bool


@dataclass(frozen=True, slots=True)
class PositionBounds:
    """Lane code that computes clip positions and their slacks.

    Attributes:
        stage: computes the position in words 0 to 3 and the slacks in words 4 to 7. Its argument `reaches_k`
            is the greatest magnitude of input k.
        inputs: the inputs that positions depend on.
    """

    stage: StageCode
    inputs: tuple[int, ...]
