"""Lane code: what a stage does, in scalar components with explicit masks; OpenCL C and NumPy are printed from it.

- One value is one component of W invocations ("lanes"). Its `Uniformity` says among whom it is the same; all but
  VARYING are printed as scalars. An `Affine` value is the same plus a multiple of the lane's number, so that
  memory is read with vector loads.
- Control flow whose condition is the same for all lanes is real. Where it varies, a mask (a bool variable) says
  which lanes take part: `Set`, `Store` and `Atomic` have a mask, loops end when no lane is left, and
  `If(any_lane=True)` steps around work that no lane wants.
- Calls are gone: each is lowered in place, so that a function is specialised for the levels of its arguments.
- MemoryRegion is 32-bit words; an access names `index * scale + offset`.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from rhi.contract.descriptors import TextureKind

__rhi_internal__ = True


class ScalarKind(enum.Enum):
    """What a component is; a bool that varies is a mask."""

    FLOAT = "float"
    INT = "int"
    UINT = "uint"
    BOOL = "bool"

    __hash__ = object.__hash__


class Uniformity(enum.IntEnum):
    """Among which invocations a value is the same: a whole dispatch, a work-group, the lanes of one work-item."""

    DISPATCH = 0
    GROUP = 1
    LANES = 2
    VARYING = 3


@dataclass(slots=True, eq=False)
class Variable:
    """A component with a name; `uniformity` is settled when lowering is done."""

    name: str
    kind: ScalarKind
    uniformity: Uniformity


class AddressSpace(enum.Enum):
    """Where memory lies, as far as lane code cares."""

    UNIFORM = "uniform"
    STORAGE = "storage"
    SHARED = "shared"
    PRIVATE = "private"
    CONSTANT = "constant"
    TEXTURE = "texture"
    IMAGE = "image"

    __hash__ = object.__hash__


@dataclass(slots=True, eq=False)
class MemoryRegion:
    """An array of words. `stride`: the words of one element; `length`: words in all, 0 where a buffer decides.

    PRIVATE memory is one such array of `kind` for each lane, and VARYING unless `uniformity` says less; CONSTANT
    memory holds `values`; a TEXTURE or IMAGE has a `shape`.
    """

    name: str
    space: AddressSpace
    stride: int = 1
    length: int = 0
    writable: bool = False
    kind: ScalarKind = ScalarKind.UINT
    uniformity: Uniformity = Uniformity.VARYING
    values: tuple[float, ...] = ()
    shape: TextureKind = TextureKind.D2


# -- values ------------------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class Value:
    """One component; arithmetic on values makes `Apply` values."""

    kind: ScalarKind
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
    value: float


@dataclass(slots=True, eq=False)
class Get(Value):
    variable: Variable


@dataclass(slots=True, eq=False)
class Affine(Value):
    """`base + stride * lane`, the base being the same for all lanes."""

    base: Value
    stride: int


@dataclass(slots=True, eq=False)
class Apply(Value):
    """A primitive of `rhi.shading.ir.primitives`, by name."""

    operation: str
    arguments: tuple[Value, ...]


@dataclass(slots=True, eq=False)
class Load(Value):
    """A word at `index * scale + offset`; lanes outside `mask` read nothing and get anything."""

    memory: MemoryRegion
    index: Value
    scale: int
    offset: int
    mask: Variable | None


@dataclass(slots=True, eq=False)
class ElementCount(Value):
    """How many elements a storage buffer has."""

    memory: MemoryRegion


class DispatchIndex(enum.Enum):
    """What an invocation knows of its place; of the axes, those of `Input.axis`."""

    GROUP_ID = "group_id"
    GROUP_COUNT = "group_count"
    ITEM = "item"
    LOCAL_INDEX = "local_index"

    __hash__ = object.__hash__


@dataclass(slots=True, eq=False)
class Input(Value):
    index: DispatchIndex
    axis: int = 0


@dataclass(slots=True, eq=False)
class Argument(Value):
    """A component that the caller passes in: of a function evaluated on arrays, of a stage's inputs."""

    name: str


# -- statements --------------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class Statement:
    line: tuple[str, int]


@dataclass(slots=True, eq=False)
class Let(Statement):
    """A variable begins, with a value or without one."""

    variable: Variable
    value: Value | None


@dataclass(slots=True, eq=False)
class DeclareMemory(Statement):
    """Private memory begins, filled with zeros if asked for."""

    memory: MemoryRegion
    zeros: bool


@dataclass(slots=True, eq=False)
class Set(Statement):
    """A new value for the lanes in `mask`, for all where that is None."""

    variable: Variable
    value: Value
    mask: Variable | None


@dataclass(slots=True, eq=False)
class Store(Statement):
    """Consecutive words from `index * scale + offset` on.

    Where lanes that take part store different values to one address, the last of them wins. `padding`: words
    behind the values that nobody reads and that may be overwritten.
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
    """`result` (None: nobody wants it) gets the old word; `values` is one, or expected and new for an exchange."""

    result: Variable | None
    operation: str
    kind: ScalarKind
    memory: MemoryRegion
    index: Value
    scale: int
    offset: int
    values: tuple[Value, ...]
    mask: Variable | None


@dataclass(slots=True, eq=False)
class TextureAccess(Statement):
    """A texture or image is read, measured or written; `results` get the components.

    Coordinates have three components. The operations and their arguments: sample (at, level), sample_compare
    (at, reference, level), level_of_detail (at, step right, step down, bias), gather (component, at), gather_compare
    (at, reference), load (texel, level), store (texel, four values), size (level), levels. Nothing is read outside
    the texture; `mask` says who stores.
    """

    operation: str
    memory: MemoryRegion
    arguments: tuple[Value, ...]
    results: tuple[Variable, ...]
    mask: Variable | None


@dataclass(slots=True, eq=False)
class Barrier(Statement):
    """The whole work-group meets (`waits`), or only memory is ordered."""

    waits: bool


@dataclass(slots=True, eq=False)
class Check(Statement):
    """Report the statement's line where a lane in `mask` has `wrong`: `given` isn't below `limit`."""

    wrong: Value
    given: Value
    limit: Value
    mask: Variable | None


@dataclass(slots=True, eq=False)
class If(Statement):
    """A real branch: on a condition that is the same for all lanes, or on whether `any_lane` has it."""

    condition: Value
    then: Block
    otherwise: Block
    any_lane: bool = False


@dataclass(slots=True, eq=False)
class Loop(Statement):
    """Turns without end; `advance` follows each turn, ended early or not."""

    body: Block
    advance: Block


@dataclass(slots=True, eq=False)
class Break(Statement):
    """Return the loop: always, or if `none` of the lanes has the mask."""

    when_empty: Variable | None = None


@dataclass(slots=True, eq=False)
class Continue(Statement):
    when_empty: Variable | None = None


@dataclass(slots=True, eq=False)
class InlinedCall(Statement):
    """The body of a function that was called; `Return` ends it early."""

    label: str
    block: Block
    returns_early: bool = False


@dataclass(slots=True, eq=False)
class Return(Statement):
    call: InlinedCall
    when_empty: Variable | None = None


Block: TypeAlias = list[Statement]


@dataclass(slots=True, eq=False)
class Code:
    """A stage or function in lane code: what it is given, what it does, and the variables with its results."""

    name: str
    width: int
    block: Block
    memories: tuple[MemoryRegion, ...]
    arguments: tuple[Argument, ...] = ()
    results: tuple[Value, ...] = ()
    work_group: tuple[int, int, int] = (1, 1, 1)
    checked: bool = False
    operations: frozenset[tuple[str, tuple[ScalarKind, ...]]] = field(default_factory=frozenset)


# -- making values -----------------------------------------------------------------------------------------

_COMPARISONS: Final = frozenset({"equal", "not_equal", "less", "less_equal", "greater", "greater_equal"})
_FIXED: Final = {
    "to_float": ScalarKind.FLOAT,
    "to_int": ScalarKind.INT,
    "to_uint": ScalarKind.UINT,
    "as_float": ScalarKind.FLOAT,
    "as_int": ScalarKind.INT,
    "as_uint": ScalarKind.UINT,
    "half_bits": ScalarKind.UINT,
    "half_value": ScalarKind.FLOAT,
}


def literal(value: float, kind: ScalarKind = ScalarKind.FLOAT) -> Literal:
    """A constant."""
    return Literal(kind, Uniformity.DISPATCH, value)


def number(value: int) -> Literal:
    """An int constant."""
    return Literal(ScalarKind.INT, Uniformity.DISPATCH, value)


TRUE: Final = literal(True, ScalarKind.BOOL)
FALSE: Final = literal(False, ScalarKind.BOOL)


def apply(operation: str, *arguments: Value) -> Value:
    """A primitive applied: of the arguments' kind or its own, and of their highest level."""
    simple = _simplify(operation, arguments)
    if simple is not None:
        return simple
    kind = _FIXED.get(operation, ScalarKind.BOOL if operation in _COMPARISONS else arguments[-1].kind)
    return Apply(kind, max(argument.uniformity for argument in arguments), operation, arguments)


def _simplify(operation: str, arguments: tuple[Value, ...]) -> Value | None:
    """Addresses fold: sums and products of int constants and affine values; so do selects and masks."""
    a = arguments[0]
    match operation:
        case "select" if isinstance(a, Literal):
            return arguments[1] if a.value else arguments[2]
        case "not" if isinstance(a, Literal):
            return FALSE if a.value else TRUE
        case "and" | "or" if a.kind is ScalarKind.BOOL:
            for one, other in (arguments, arguments[::-1]):
                if isinstance(one, Literal):
                    return other if bool(one.value) == (operation == "and") else one
            return None
        case "to_int" | "to_uint" if isinstance(a, Affine):
            base = apply(operation, a.base)
            return Affine(base.kind, Uniformity.VARYING, base, a.stride)
        case "to_int" if a.kind is ScalarKind.INT:
            return a
    if a.kind not in (ScalarKind.INT, ScalarKind.UINT) or len(arguments) != 2:
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
            for one, other in ((a, b), (b, a)):
                if _is(one, 1):
                    return other
                if isinstance(one, Literal) and isinstance(other, Affine) and one.value:
                    base = apply("multiply", other.base, one)
                    return Affine(other.kind, Uniformity.VARYING, base, other.stride * int(one.value))
            return _fold(operation, a, b)
    return None


def _is(value: Value, wanted: int) -> bool:
    return isinstance(value, Literal) and value.value == wanted


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


def parts_of(value: Value) -> tuple[Value, ...]:
    """The values directly inside a value."""
    match value:
        case Apply(arguments=arguments):
            return arguments
        case Affine(base=base):
            return (base,)
        case Load(index=index):
            return (index,)
        case _:
            return ()


def variables_of(value: Value) -> Iterator[Variable]:
    """The variables that a value reads."""
    if isinstance(value, Get):
        yield value.variable
    for part in parts_of(value):
        yield from variables_of(part)


def loads(value: Value) -> bool:
    """Whether a value reads memory."""
    return isinstance(value, Load) or any(loads(part) for part in parts_of(value))


def walk(block: Block) -> Iterator[Statement]:
    """All statements of a block, those inside behind the one that holds them."""
    for statement in block:
        yield statement
        match statement:
            case If(then=then, otherwise=otherwise):
                yield from walk(then)
                yield from walk(otherwise)
            case Loop(body=body, advance=advance):
                yield from walk(body)
                yield from walk(advance)
            case InlinedCall(block=inner):
                yield from walk(inner)


def values_of(statement: Statement) -> tuple[Value, ...]:
    """The values directly in a statement."""
    match statement:
        case Let(value=value):
            return (value,) if value is not None else ()
        case Set(value=value):
            return (value,)
        case Store(index=index, values=values) | Atomic(index=index, values=values):
            return (index, *values)
        case TextureAccess(arguments=arguments):
            return arguments
        case If(condition=condition):
            return (condition,)
        case Check(wrong=wrong, given=given, limit=limit):
            return (wrong, given, limit)
        case _:
            return ()


WIDTH: Final = 16
"""Lanes of a draw's stages on OpenCL: 16 vertices, or 4 by 4 pixels, lane = x + 4 y."""

FIRST_VERTEX: Final = "vertex"
"""The argument with the first lane's vertex; others lie behind it, side by side unless the writer says otherwise."""


@dataclass(frozen=True, slots=True)
class StageCode:
    """A stage in lane code.

    `code.arguments` are the parameters' components that are read, the built-in inputs in the order of the table of
    built-ins, and the mask. `code.results` are the outputs, each for its word of `words`; then the depth, if the stage
    writes one; and of a fragment stage the lanes that remain.
    """

    code: Code
    words: tuple[int, ...]
    has_depth: bool


@dataclass(frozen=True, slots=True)
class PositionBounds:
    """Lane code of clip positions and their slacks.

    Attributes:
        stage: gives position and slacks in words 0 to 3 and 4 to 7. Argument `reaches_k`: how large input k gets.
        inputs: those that positions depend on.
    """

    stage: StageCode
    inputs: tuple[int, ...]
