"""Proofs that indices are inside. Writers of code bound all other indices (`tree.Index.inside`).

- Each int has a range: constants, counters of loops, `% n`, masks, `min`, `clamp`, the index in a work-group.
  A range that leaves 32 bits becomes the full range, since ints wrap.
- A condition narrows the range of a value that stays the same while it holds (a variable that is assigned
  once, an input of the stage): in the branches of `if`, of `x if c else y`, of `and` and `or`, and behind a
  branch that leaves the block.
- The length of a buffer isn't known, but an index less than `len(…)` is inside.
- Callers come before what they call, so the range of a parameter is that of all its arguments.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final, TypeAlias

from rhi.contract.layout import BOOL, INT, UINT
from rhi.shading.ir import tree
from rhi.shading.ir.tree import Expression, Local, Operator
from rhi.shading.language.types import StorageType, Type, count_elements

Range: TypeAlias = tuple[int, int]
"""The minimum and maximum of a value."""

_MAX_INT: Final = 2**31 - 1
_ALL: Final[dict[Type, Range]] = {INT: (-(2**31), _MAX_INT), UINT: (0, 2**32 - 1), BOOL: (0, 1)}
_INDEX_BUILTINS: Final = frozenset(
    {"global_id", "group_id", "group_count", "instance_index", "draw_index", "primitive_index"}
)
_IDENTITIES: Final = frozenset({"uniform", "unchecked"})
_JUMPS: Final = (tree.Return, tree.Break, tree.Continue, tree.Discard)
_NEGATED: Final = {
    Operator.LESS: Operator.GREATER_EQUAL,
    Operator.LESS_EQUAL: Operator.GREATER,
    Operator.GREATER: Operator.LESS_EQUAL,
    Operator.GREATER_EQUAL: Operator.LESS,
    Operator.EQUAL: Operator.NOT_EQUAL,
    Operator.NOT_EQUAL: Operator.EQUAL,
}


def prove_indices(functions: Sequence[tree.Function], work_group: tuple[int, int, int] = (1, 1, 1)) -> None:
    """Mark the indices of functions that are proven to be inside; callees come first."""
    prover = _Prover(work_group)
    for function in reversed(functions):
        prover.block(function.body)


class _Prover:
    """Visits functions with the facts that hold at the current statement.

    Attributes:
        values: the value of each variable that is assigned once.
        ranges: the ranges of these variables, of counters and of parameters.
        narrowed: the ranges that conditions imply, by the value's key.
        below: the buffers whose length a value is less than, by the value's key.
    """

    def __init__(self, work_group: tuple[int, int, int]) -> None:
        self.work_group = work_group
        self.values: dict[Local, Expression] = {}
        self.ranges: dict[Local, Range] = {}
        self.narrowed: dict[Hashable, Range] = {}
        self.below: dict[Hashable, frozenset[str]] = {}
        self.visited: set[tree.Index] = set()

    # -- statements

    @contextmanager
    def scope(self) -> Iterator[None]:
        """Drop the facts that conditions imply inside, at the end."""
        outer = dict(self.narrowed), dict(self.below)
        yield
        self.narrowed, self.below = outer

    def block(self, block: tree.Block) -> None:
        with self.scope():
            for statement in block:
                self.statement(statement)

    def statement(self, node: tree.Statement) -> None:
        match node:
            case (
                tree.Declare(local=local, value=value)
                | tree.Assign(target=tree.Read(local=local), value=value)
            ):
                if value is not None:
                    values = self.range(value)
                    if local.writes == 1 and not local.is_parameter:
                        self.values[local] = value
                        self.ranges[local] = values
            case tree.If(condition=condition, then=then, otherwise=otherwise):
                self.range(condition)
                for holds, branch in ((True, then), (False, otherwise)):
                    with self.scope():
                        self.assume(condition, holds)
                        self.block(branch)
                for holds, branch in ((True, then), (False, otherwise)):
                    if branch and isinstance(branch[-1], _JUMPS):
                        self.assume(condition, not holds)
            case tree.While(condition=condition, body=body):
                self.range(condition)
                with self.scope():
                    self.assume(condition, True)
                    self.block(body)
            case tree.For(local=local, start=start, stop=stop, step=step, body=body):
                first, end, by = self.range(start), self.range(stop), self.range(step)
                low, high = _ALL[INT]
                if by[0] > 0:
                    low, high = first[0], end[1] - 1
                elif by[1] < 0:
                    low, high = end[0] + 1, first[1]
                self.ranges[local] = (low, max(low, high))
                with self.scope():
                    if by[0] > 0:
                        self.below[local] = self.lengths(stop)
                    self.block(body)
            case _:
                for part in tree.parts_of(node):
                    self.range(part)

    # -- conditions

    def assume(self, node: Expression, holds: bool) -> None:
        """Record the ranges that a condition implies if it holds, or if it doesn't."""
        match node:
            case tree.Unary(operator=Operator.NOT, operand=operand):
                self.assume(operand, not holds)
            case tree.Binary(operator=Operator.AND | Operator.OR as operator):
                if holds == (operator is Operator.AND):
                    parts: list[Expression] = [node]
                    while isinstance(first := parts[-1], tree.Binary) and first.operator is operator:
                        parts[-1:] = [first.right, first.left]
                    for part in reversed(parts):
                        self.assume(part, holds)
            case tree.Binary(operator=operator, left=left, right=right) if operator in _NEGATED:
                operator = operator if holds else _NEGATED[operator]
                if operator in (Operator.GREATER, Operator.GREATER_EQUAL):
                    left, right = right, left
                strict = operator in (Operator.LESS, Operator.GREATER)
                if left.type not in (INT, UINT) or operator is Operator.NOT_EQUAL:
                    return
                (low, high), (least, most) = self.range(left), self.range(right)
                self.narrow(left, (low, min(high, most - strict)))
                self.narrow(right, (max(least, low + strict), most))
                if operator is Operator.EQUAL:
                    self.narrow(left, (max(low, least), high))
                    self.narrow(right, (least, min(most, high)))
                key = self.key(left)
                if strict and key is not None:
                    self.below[key] = self.below.get(key, frozenset()) | self.lengths(right)

    def narrow(self, node: Expression, range: Range) -> None:
        key = self.key(node)
        if key is not None:
            low, high = self.narrowed.get(key, range)
            self.narrowed[key] = max(low, range[0]), min(high, range[1])

    def key(self, node: Expression) -> Hashable | None:
        """Return a key for a value that can't change within the current block, or None for other values."""
        match node:
            case tree.Read(local=local) if local in self.ranges or (local.is_parameter and not local.writes):
                return local
            case tree.BuiltinCall(builtin=builtin, arguments=()):
                return builtin.name
            case tree.Swizzle(base=base, components=(component,)):
                inner = self.key(base)
                return (inner, component) if inner is not None else None
        return None

    def lengths(self, node: Expression) -> frozenset[str]:
        """Return the buffers whose length is at least this value."""
        match node:
            case tree.Length(base=tree.BindingRead(declaration=declaration)):
                return frozenset({declaration.name})
            case tree.Convert(value=tree.Length() as value):
                return self.lengths(value)
            case tree.Read(local=local) if local in self.values:
                return self.lengths(self.values[local])
        return self.shorter(node)

    def shorter(self, node: Expression) -> frozenset[str]:
        """Return the buffers whose length exceeds this value, unless they are empty."""
        buffers: frozenset[str] = self.below.get(self.key(node), frozenset())
        match node:
            case tree.Binary(operator=Operator.SUBTRACT, left=left, right=right) if self.range(right)[0] > 0:
                return self.lengths(left) if isinstance(left, tree.Length) else buffers
            case tree.BuiltinCall(builtin=builtin, arguments=(value,)) if builtin.name in _IDENTITIES:
                return self.shorter(value)
            case tree.BuiltinCall(builtin=builtin, arguments=arguments) if builtin.name in ("min", "clamp"):
                return buffers.union(
                    *(
                        self.shorter(argument)
                        for argument in (arguments[0], arguments[-1])[builtin.name == "clamp" :]
                    )
                )
            case tree.Convert(type=type, value=value) if {type, value.type} == {INT, UINT} and self.range(
                value
            )[0] >= 0:
                return self.shorter(value)
            case tree.Read(local=local) if local in self.values and isinstance(
                self.values[local], tree.BuiltinCall
            ):
                return buffers | self.shorter(self.values[local])
        return buffers

    # -- values

    def range(self, node: Expression) -> Range:
        """Return the range of an int value, and mark the indices in it. Ranges of other values are
        meaningless."""
        values = self.visit(node)
        low, high = _ALL.get(node.type, (0, 0))
        if values is None or values[0] < low or values[1] > high:
            values = low, high
        key = self.key(node)
        if key in self.narrowed:
            low, high = self.narrowed[key]
            values = max(low, values[0]), min(high, values[1])
        return values if values[0] <= values[1] else (low, high)  # unreachable

    def visit(self, node: Expression) -> Range | None:
        match node:
            case tree.Constant(value=value):
                return (int(value), int(value)) if node.type in _ALL else None
            case tree.Read(local=local):
                return self.ranges.get(local)
            case tree.Length():
                return 1, _MAX_INT  # no buffer is empty
            case tree.Index():
                self.index(node)
                return None
            case tree.Swizzle(base=base, components=components):
                self.range(base)
                return self.component(base, components[0]) if len(components) == 1 else None
            case tree.Binary():
                return self.binary(node)
            case tree.Select(condition=condition, then=then, otherwise=otherwise):
                self.range(condition)
                ranges = []
                for holds, branch in ((True, then), (False, otherwise)):
                    with self.scope():
                        self.assume(condition, holds)
                        ranges.append(self.range(branch))
                return _join(*ranges)
            case tree.Convert(value=value):
                values = self.range(value)
                return values if value.type in _ALL else None
            case tree.Call(function=function, arguments=arguments):
                for parameter, argument in zip(function.parameters, arguments, strict=True):
                    values = self.range(argument)
                    if not parameter.writes:
                        self.ranges[parameter] = _join(values, self.ranges.get(parameter, values))
                return None
            case tree.BuiltinCall(builtin=builtin, arguments=arguments):
                return self.builtin(builtin.name, [self.range(argument) for argument in arguments])
        for part in tree.parts_of(node):
            self.range(part)
        return None

    def index(self, node: tree.Index) -> None:
        self.range(node.base)
        (low, high), base = self.range(node.index), node.base
        if isinstance(node.index, tree.BuiltinCall) and node.index.builtin.name == "unchecked":
            inside = True
        elif isinstance(base, tree.BindingRead) and isinstance(base.type, StorageType):
            inside = low == high == 0 or (low >= 0 and base.declaration.name in self.shorter(node.index))
        else:
            inside = low >= 0 and high < count_elements(base.type)
        # An expression may be in several places (`a[i] += 1`, `0 < a[i] < 5`), and must be inside in each.
        node.inside = inside and (node.inside or node not in self.visited)
        self.visited.add(node)

    def component(self, base: Expression, index: int) -> Range | None:
        """Return the range of a component of an input of the stage."""
        if isinstance(base, tree.Read) and base.local in self.values:
            base = self.values[base.local]
        if isinstance(base, tree.BuiltinCall) and base.builtin.name == "local_id":
            return 0, self.work_group[index] - 1
        return (
            (0, _MAX_INT)
            if isinstance(base, tree.BuiltinCall) and base.builtin.name in _INDEX_BUILTINS
            else None
        )

    def builtin(self, name: str, arguments: list[Range]) -> Range | None:
        if name in _INDEX_BUILTINS:
            return 0, _MAX_INT
        match name, arguments:
            case "local_index", _:
                return 0, self.work_group[0] * self.work_group[1] * self.work_group[2] - 1
            case (("uniform" | "unchecked"), [argument]):
                return argument
            case "min", [a, b]:
                return min(a[0], b[0]), min(a[1], b[1])
            case "max", [a, b]:
                return max(a[0], b[0]), max(a[1], b[1])
            case "clamp", [a, b, c]:
                return min(max(a[0], b[0]), c[0]), min(max(a[1], b[1]), c[1])
            case "abs", [a] if a[0] > -(2**31):
                return 0, max(-a[0], a[1])
            case "bit_count", _:
                return 0, 32
            case (("find_lsb" | "find_msb"), _):
                return -1, 31
        return None

    def binary(self, node: tree.Binary) -> Range | None:
        chain = tree.left_chain(node)  # may be longer than Python's recursion limit
        left = self.range(chain[0].left)
        for link in chain:
            if link.operator in (Operator.AND, Operator.OR):
                with self.scope():
                    self.assume(link.left, link.operator is Operator.AND)
                    self.range(link.right)
                continue
            result = _operate(link.operator, left, self.range(link.right))
            low, high = _ALL.get(link.type, (0, 0))
            left = (low, high) if result is None or result[0] < low or result[1] > high else result
        return left


def _join(first: Range, second: Range) -> Range:
    return min(first[0], second[0]), max(first[1], second[1])


def _operate(operator: Operator, a: Range, b: Range) -> Range | None:
    """Return the range of the exact result of an operator on ints."""
    match operator:
        case Operator.ADD:
            return a[0] + b[0], a[1] + b[1]
        case Operator.SUBTRACT:
            return a[0] - b[1], a[1] - b[0]
        case Operator.MULTIPLY:
            corners = [x * y for x in a for y in b]
            return min(corners), max(corners)
        case Operator.FLOOR_DIVIDE if b[0] > 0:
            corners = [x // y for x in a for y in b]
            return min(corners), max(corners)
        case Operator.MODULO if b[0] >= 0:
            return 0, min(max(b[1] - 1, 0), a[1] if a[0] >= 0 else b[1])
        case Operator.BIT_AND if a[0] >= 0 or b[0] >= 0:
            return 0, min(factor[1] for factor in (a, b) if factor[0] >= 0)
        case Operator.BIT_OR | Operator.BIT_XOR if a[0] >= 0 and b[0] >= 0:
            return 0, 2 ** max(a[1].bit_length(), b[1].bit_length()) - 1
        case Operator.SHIFT_LEFT if 0 <= b[0] == b[1] < 32:
            return a[0] << b[0], a[1] << b[0]
        case Operator.SHIFT_RIGHT if 0 <= b[0] <= b[1] < 32:
            return min(a[0] >> b[0], a[0] >> b[1]), max(a[1] >> b[0], a[1] >> b[1])
    return None
