"""Bounds of a vertex stage's clip positions, where they are an affine function of its inputs.

- Affine means a sum of inputs times values that all vertices of an instance share (uniforms, constants, an
  instance's row of a buffer). If the inputs of vertices lie in a box, their clip positions are then convex
  combinations of the clip positions of the box's corners, except for rounding. The corners therefore bound
  all vertices before any of them is transformed.
- `bound_positions` creates separate lane code. It contains only the computation of positions, so that no
  memory is read at an index that depends on a corner's inputs. For each component it also computes a slack,
  the effect of rounding: how far a vertex may lie outside the corners' hull, and the error of a sum or
  difference of two such components.
- Slacks come from a running error analysis. The magnitude of a component is its value if all terms were
  positive and as large as they can be in the box. Each rounding in the computation of a component adds an
  error of at most 2^-24 of the magnitude. After n roundings a vertex and a corner are each within n 2^-24
  magnitudes of the exact function: 2 n + 1 with a sum of two. The slack is (4 n + 16) 2^-24, more than twice
  that.
- Each term is increased by a thousandth, so that no vertex overflows unless magnitudes do, and then slacks
  are infinite. Each term is at least 2^-64, which covers the losses of denormals. NaN gives NaN.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final, TypeAlias, TypeGuard

from rhi.contract.layout import FLOAT
from rhi.shading.ir import lanes, nodes

_INPUTS: Final = "inputs_"
_REACHES: Final = "reaches_"
_FIXED: Final = (lanes.AddressSpace.UNIFORM, lanes.AddressSpace.STORAGE, lanes.AddressSpace.CONSTANT)
_MARGIN: Final = 1.001
_MIN_TERM: Final = 2.0**-64
_ROUNDING: Final = 2.0**-22

_Magnitude: TypeAlias = "tuple[lanes.Value, int]"
"""The magnitude of a component, and the greatest number of roundings in its computation."""


def bound_positions(stage: lanes.StageCode) -> lanes.PositionBounds | None:
    """Return the bounds of a vertex stage; None if positions aren't affine or the stage has side effects."""
    code = stage.code
    positions = [value for word, value in zip(stage.words, code.results, strict=False) if word < 4]
    if len(positions) < 4 or code.checked or any(map(_has_effect, nodes.walk(code.block))):
        return None
    analysis = _Analysis()
    for statement in code.block:
        analysis.add(statement)
    magnitudes = [analysis.measure(value) for value in positions]
    slacks = [
        size * lanes.literal((roundings + 4) * _ROUNDING) for size, roundings in filter(None, magnitudes)
    ]
    results = (*positions, *slacks)
    block = _slice(analysis.block, results)
    if len(slacks) < 4 or block is None:
        return None
    read = [value for statement in block for value in lanes.parts_of(statement)]
    inputs = sorted({number for value in (*read, *results) for number in _inputs_of(value)})
    if not inputs:
        return None
    code = replace(code, block=block, results=results)
    return lanes.PositionBounds(replace(stage, code=code, words=tuple(range(8))), tuple(inputs))


class _Analysis:
    """Computes the magnitudes of variables, statement by statement.

    Attributes:
        block: the statements, with those that compute magnitudes inserted.
    """

    def __init__(self) -> None:
        self.block: lanes.Block = []
        self._magnitudes: dict[int, _Magnitude] = {}  # the current magnitudes of varying variables

    def add(self, statement: lanes.Statement) -> None:
        """Append the next statement of the stage."""
        self.block.append(statement)
        value = statement.value if _is_assignment(statement) else None
        magnitude = self.measure(value) if value is not None else None
        for variable in _written_variables(statement):
            self._magnitudes.pop(id(variable), None)
            if magnitude is not None and variable.uniformity is lanes.Uniformity.VARYING:
                self._magnitudes[id(variable)] = self._name(magnitude, variable.name, statement.line)

    def measure(self, value: lanes.Value) -> _Magnitude | None:
        """Return the magnitude of a component; None if it isn't affine."""
        if value.kind is not FLOAT:
            return None
        if _is_fixed(value):
            size = (
                lanes.literal(abs(value.value))
                if isinstance(value, lanes.Literal)
                else lanes.apply("abs", value)
            )
            return _extend(size), 0
        match value:
            case lanes.Argument(name=name) if name.startswith(_INPUTS):
                reach = lanes.Argument(FLOAT, lanes.Uniformity.LANES, f"{_REACHES}{name[len(_INPUTS) :]}")
                return _extend(reach), 0
            case lanes.Get(variable=variable):
                return self._magnitudes.get(id(variable))
            case lanes.Apply(operation="negate", arguments=(operand,)):
                return self.measure(operand)
            case lanes.Apply(operation="add" | "subtract" | "multiply" as operation, arguments=(a, b)):
                scales = operation == "multiply"
                left, right = self.measure(a), self.measure(b)
                if left is None or right is None or (scales and not (_is_fixed(a) or _is_fixed(b))):
                    return None
                size = left[0] * right[0] + lanes.literal(_MIN_TERM) if scales else left[0] + right[0]
                return size, max(left[1], right[1]) + 1
        return None

    def _name(self, magnitude: _Magnitude, name: str, line: tuple[str, int]) -> _Magnitude:
        value, roundings = magnitude
        variable = lanes.Variable(f"reach_{len(self.block)}_{name}", FLOAT, lanes.Uniformity.LANES)
        self.block.append(lanes.Let(line, variable, value))
        return lanes.Get(FLOAT, lanes.Uniformity.LANES, variable), roundings


def _extend(value: lanes.Value) -> lanes.Value:
    if isinstance(value, lanes.Literal):
        return lanes.literal(value.value * _MARGIN + _MIN_TERM)
    return value * lanes.literal(_MARGIN) + lanes.literal(_MIN_TERM)


def _inputs_of(value: lanes.Value) -> Iterator[int]:
    """Yield the inputs that a value reads."""
    for part in lanes.within(value):
        if isinstance(part, lanes.Argument) and part.name.startswith(_INPUTS):
            yield int(part.name[len(_INPUTS) :])


def _is_fixed(value: lanes.Value) -> bool:
    """Return whether all vertices of an instance share a value."""
    return not any(
        part.uniformity is lanes.Uniformity.VARYING
        or (isinstance(part, lanes.Get) and part.variable.uniformity is lanes.Uniformity.VARYING)
        or (isinstance(part, lanes.Load) and part.memory.space not in _FIXED)
        for part in lanes.within(value)
    )


def _has_effect(statement: lanes.Statement) -> bool:
    """Return whether a statement has side effects beyond variables and private memory."""
    match statement:
        case lanes.Store(memory=memory):
            return memory.space is not lanes.AddressSpace.PRIVATE
        case lanes.TextureAccess(operation=operation):
            return operation == "store"
    return isinstance(statement, lanes.Atomic | lanes.Barrier)


def _written_variables(statement: lanes.Statement) -> Iterator[lanes.Variable]:
    """Yield the variables that a statement and its nested statements write."""
    for inner in nodes.walk([statement]):
        match inner:
            case lanes.Let(variable=variable) | lanes.Set(variable=variable):
                yield variable
            case lanes.TextureAccess(results=results):
                yield from results
            case lanes.Atomic(result=lanes.Variable() as result):
                yield result


def _is_assignment(statement: lanes.Statement) -> TypeGuard[lanes.Let | lanes.Set]:
    """Return whether a statement assigns a variable in all lanes."""
    return isinstance(statement, lanes.Let) or (isinstance(statement, lanes.Set) and statement.mask is None)


def _slice(block: lanes.Block, results: tuple[lanes.Value, ...]) -> lanes.Block | None:
    """Return the statements that results depend on; None unless all are plain assignments of fixed or affine
    values."""
    needed = {id(variable) for value in results for variable in lanes.variables_of(value)}
    slice: lanes.Block = []
    for statement in reversed(block):
        if needed.isdisjoint(map(id, _written_variables(statement))):
            continue
        if not _is_assignment(statement):
            return None
        slice.append(statement)
        if isinstance(statement, lanes.Let):
            needed.discard(id(statement.variable))
        if statement.value is not None:
            if not _is_plain(statement.value):
                return None
            needed.update(id(variable) for variable in lanes.variables_of(statement.value))
    return slice[::-1]


def _is_plain(value: lanes.Value) -> bool:
    """Return whether a value reads memory at fixed indices only."""
    return all(_is_fixed(part) for part in lanes.within(value) if isinstance(part, lanes.Load))
