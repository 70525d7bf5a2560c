"""The state of lowering a stage or function, which the modules beside this one share: `Lowering`.

- Each module beside this one has functions of a `Lowering` and a node. The table
  `rhi.shading.lowering.functions.EXPRESSIONS` selects those of expressions by the node's type: an operand may
  be a call, whose body has statements, which have expressions again.
- A `MaskScope` is a part of the stage under one condition: a branch, a loop, an iteration of a loop, the body
  of an inlined call. Where its condition varies among lanes, it owns a mask. A variable that is assigned
  inside scopes that don't hold its declaration varies at least as they do, and the assignment is blended if
  one of them owns a mask.
- The uniformity of a variable, of a loop's exits and of a function's returns is found by iteration to a
  fixpoint: each run joins its results with earlier ones, so that values only rise in the semilattice of
  `Uniformity`. Lowering runs again until all assumptions of a run hold at its end. The last run therefore
  knows at a loop's beginning what its end implies.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import field
from typing import Any, Final, NoReturn, TypeAlias, TypeVar

from rhi.contract.layout import BOOL, ScalarType
from rhi.errors import Rule
from rhi.errors.data_classes import dataclass
from rhi.shading.ir import lanes, nodes, tree
from rhi.shading.language.source import SourceSpan, refuse_at
from rhi.shading.lowering.lvalues import Home, Slot

R = TypeVar("R")

_UNKNOWN: Final = (lanes.Uniformity.DISPATCH, 0)

_MACROS: Final = (
    "M_PI_2",
    "M_PI_4",
    "M_SQRT1_2",
    *(f"CL_VERSION_{n}" for n in ("1_0", "1_1", "1_2", "2_0", "3_0")),
)
"""Macros of OpenCL C whose names end like those of variables."""
_HELPER: Final = re.compile(r"rhi_(power|(load|store|scatter)_(global|local|constant|private)(_\d+|_of)*)")
"""The beginnings of the names of helper functions in OpenCL C that end like those of variables."""

HEAVY: Final = 24
"""A masked block with more statements than this is skipped if no lane is active, even if it accesses no
memory."""


@dataclass(slots=True, eq=False)
class MaskScope:
    """A part of a stage under one condition (see the head of this module).

    `kind` is "branch", "loop", "iteration" or "function". `mask` is the innermost mask; it belongs to an
    outer scope unless `owns_mask` is true.
    """

    kind: str
    parent: MaskScope | None
    uniformity: lanes.Uniformity
    mask: lanes.Variable | None
    owns_mask: bool
    key: object = None


@dataclass(slots=True, eq=False)
class InlinedFrame:
    """A function whose body is being inlined.

    Attributes:
        path: the calls that lead to it, outermost first.
        return_uniformity: how much the returns found so far vary, those of callers included.
        inlined_call: the statement that holds the body.
        results: the slots that a `return` assigns, if the function returns early.
        textures: the bindings that its texture parameters stand for.
        slots: the storage of its locals.
    """

    function: tree.Function
    path: tuple[int, ...]
    caller: InlinedFrame | None = None
    return_uniformity: lanes.Uniformity = lanes.Uniformity.DISPATCH
    inlined_call: lanes.InlinedCall | None = None
    results: list[Slot] = field(default_factory=list)
    textures: dict[tree.Local, tree.BindingRead] = field(default_factory=dict)
    slots: dict[tree.Local, list[Home]] = field(default_factory=dict)


ExpressionLowering: TypeAlias = Callable[["Lowering", Any], list[lanes.Value]]
"""A function that lowers an expression, its second argument, to its scalars in order."""


class Lowering:
    """Emits statements into the current block, under the current scope.

    Attributes:
        joined: for each key (a local, a loop's exits, a function's returns), the join of the uniformities and
            strides found so far, in all runs.
        memories: the memory that the code accesses, by the names of bindings; constant arrays by a key.
        reserved: names that variables must not have.
        assumptions: the first assumption of this run about each key. Later ones, and the result, are never
            below it.
    """

    def __init__(
        self,
        expressions: Mapping[type[tree.Expression], ExpressionLowering],
        width: int,
        work_group: tuple[int, int, int] = (1, 1, 1),
        *,
        checked: bool = False,
        inputs: Mapping[str, Sequence[lanes.Value]] | None = None,
        has_helpers: bool = False,
        may_discard: bool = False,
    ) -> None:
        """Prepare to lower for `width` lanes, or for whole arrays of any shape with 0.

        Args:
            expressions: the function that lowers each type of expression.
            checked: whether to test every index.
            inputs: the components of the built-in inputs of a vertex or fragment stage, by the built-in's
                name.
            has_helpers: whether the stage has differences between pixels, for which helper invocations run.
            may_discard: whether the stage discards fragments.
        """
        self.expressions = expressions
        self.width = width
        self.work_group = work_group
        self.checked = checked
        self.inputs = inputs or {}
        self.has_helpers = has_helpers
        self.may_discard = may_discard
        self.joined: dict[object, tuple[lanes.Uniformity, int]] = {}
        self.memories: dict[object, lanes.MemoryRegion] = {}
        self.reserved = set(_MACROS)
        self.start()

    def run_to_fixpoint(self, run: Callable[[], R]) -> R:
        """Repeat a run until all its assumptions hold at its end, and return the last result."""
        while True:
            self.start()
            result = run()
            if all(
                self.joined.get(key, _UNKNOWN) == assumption for key, assumption in self.assumptions.items()
            ):
                return result

    def start(self) -> None:
        """Start a run."""
        self.assumptions: dict[object, tuple[lanes.Uniformity, int]] = {}
        self.block: lanes.Block = []
        self.count = 0
        self.names: set[str] = set()  # of variables and private memory
        self.span = SourceSpan(0)
        self.jump_pending = False  # a jump narrowed masks: test whether a lane is still active
        self.returns = 0  # the number of returns that narrowed masks
        self.private: dict[int, tuple[object, MaskScope]] = {}
        self.scope = MaskScope("function", None, lanes.Uniformity.DISPATCH, None, False)
        self.frame: InlinedFrame
        self.discards = 0  # the number of masked discards
        self.discarded = lanes.Uniformity.DISPATCH  # how much they vary
        self.covered: lanes.Variable  # the mask of lanes that aren't helpers
        self.result_mask: lanes.Value  # the mask of covered lanes that weren't discarded

    def code(
        self, name: str, arguments: tuple[lanes.Argument, ...] = (), results: Iterable[lanes.Value] = ()
    ) -> lanes.Code:
        """Return the lane code that the last run has emitted."""
        memories = tuple(self.memories.values())
        return lanes.Code(
            name, self.width, self.block, memories, arguments, tuple(results), self.work_group, self.checked
        )

    # -- expressions

    def lower(self, node: tree.Expression) -> list[lanes.Value]:
        """Lower an expression of the current frame to its scalars, in order."""
        return self.expressions[type(node)](self, node)

    def lower_scalar(self, node: tree.Expression) -> lanes.Value:
        """Lower a scalar expression."""
        (value,) = self.lower(node)
        return value

    def lower_named(self, node: tree.Expression) -> list[lanes.Value]:
        """Lower an expression whose components are used more than once."""
        return [self.let(value) for value in self.lower(node)]

    # -- the target

    def branches(self, uniformity: lanes.Uniformity) -> bool:
        """Return whether a condition of this uniformity is a real branch: a scalar in OpenCL, a single value
        in NumPy."""
        return uniformity <= lanes.Uniformity.LANES if self.width else uniformity is lanes.Uniformity.DISPATCH

    @property
    def own_uniformity(self) -> lanes.Uniformity:
        """The uniformity of a value that is private to each invocation."""
        return lanes.Uniformity.LANES if self.width == 1 else lanes.Uniformity.VARYING

    # -- uniformities

    def assume_uniformity(self, key: object) -> lanes.Uniformity:
        """Return the uniformity known so far."""
        return self.assume(key)[0]

    def assume(self, key: object) -> tuple[lanes.Uniformity, int]:
        """Return the uniformity and stride known so far."""
        assumption = self.joined.get(key, _UNKNOWN)
        self.assumptions.setdefault(key, assumption)
        return assumption

    def join(
        self, key: object, uniformity: lanes.Uniformity, stride: int = 0
    ) -> tuple[lanes.Uniformity, int]:
        """Join a uniformity and stride with those known for a key, and return the join.

        Its stride is 0 unless both pairs are equal.
        """
        joined = self.joined.get(key)
        now = (uniformity, stride)
        if joined is not None and joined != now:
            now = (max(joined[0], uniformity), 0)
        self.joined[key] = now
        return self.assume(key)

    # -- emitting

    @property
    def line(self) -> tuple[str, int]:
        return self.frame.function.file, self.span.line

    def emit(self, statement: lanes.Statement) -> None:
        self.block.append(statement)

    @contextmanager
    def emit_into(self, block: lanes.Block) -> Iterator[lanes.Block]:
        """Emit into another block."""
        before, self.block = self.block, block
        yield block
        self.block = before

    def variable(self, name: str, kind: ScalarType, uniformity: lanes.Uniformity) -> lanes.Variable:
        """Return a new variable with a unique name."""
        return lanes.Variable(self.new_name(name), kind, uniformity)

    def new_name(self, name: str) -> str:
        """Return a unique name for a variable or for private memory."""
        name = f"x_{name}" if _HELPER.fullmatch(name) else name
        self.count += 1
        while f"{name}_{self.count}" in self.reserved:
            self.count += 1
        self.names.add(f"{name}_{self.count}")
        return f"{name}_{self.count}"

    def let(self, value: lanes.Value, name: str = "t") -> lanes.Value:
        """Return the value as a named variable, unless it is a constant or a name already."""
        if isinstance(value, lanes.Literal | lanes.Get | lanes.Affine | lanes.Argument):
            return value
        variable = self.variable(name, value.kind, value.uniformity)
        self.emit(lanes.Let(self.line, variable, value))
        return lanes.Get(value.kind, value.uniformity, variable)

    def refuse(self, rule: Rule, actual: str, allowed: str = "", tip: str = "") -> NoReturn:
        """Refuse the statement at the current span."""
        function = self.frame.function
        refuse_at(rule, function.name, function.file, self.span, actual, allowed, tip)

    # -- masks

    def mask_value(self) -> lanes.Value:
        """Return the mask of the lanes that are active now."""
        mask = self.scope.mask
        return lanes.get(mask) if mask is not None else lanes.TRUE

    def effect_mask(self) -> lanes.Variable | None:
        """Return the mask of the lanes that may write to memory which other invocations see."""
        if not self.has_helpers:
            return self.scope.mask
        return self.new_mask(self.mask_value() & lanes.get(self.covered), "covered")

    def scopes_up_to(self, end: object, inclusive: bool = False) -> Iterator[MaskScope]:
        """Yield the scopes from the current one outwards, up to `end`."""
        scope: MaskScope | None = self.scope
        while scope is not None and scope is not end:
            yield scope
            scope = scope.parent
        if inclusive and scope is not None:
            yield scope

    def new_mask(
        self, value: lanes.Value, name: str, uniformity: lanes.Uniformity = lanes.Uniformity.DISPATCH
    ) -> lanes.Variable:
        """Return a new mask with the initial value `value`; with lanes, masks always vary."""
        uniformity = lanes.Uniformity.VARYING if self.width else max(uniformity, value.uniformity)
        mask = self.variable(name, BOOL, uniformity)
        self.emit(lanes.Let(self.line, mask, value))
        return mask

    def narrow(self, end: MaskScope) -> None:
        """Remove the active lanes from all masks up to and including that of `end`."""
        mask = self.scope.mask
        assert mask is not None
        current = lanes.get(mask)
        remaining = self.let(lanes.apply("not", current))
        for scope in self.scopes_up_to(end, inclusive=True):
            other = scope.mask
            if scope.owns_mask and other is not None and other is not mask:
                narrowed = lanes.apply("and", lanes.get(other), remaining)
                self.emit(lanes.Set(self.line, other, narrowed, None))
        self.emit(lanes.Set(self.line, mask, lanes.FALSE, None))

    def emit_pending_jump(self) -> None:
        """After a masked jump, leave the enclosing loop or function if no lane is active any more."""
        mask = self.scope.mask
        if not self.jump_pending or mask is None:
            return
        for scope in self.scopes_up_to(None):
            if scope.kind == "branch" and scope.owns_mask:
                return
            self.jump_pending = False
            if scope.kind in ("loop", "iteration"):
                self.emit((lanes.Continue if scope.owns_mask else lanes.Break)(self.line, mask))
                return
            if scope.kind == "function":
                if scope.owns_mask and self.frame.inlined_call is not None and self.width:
                    self.frame.inlined_call.returns_early = True
                    self.emit(lanes.Return(self.line, self.frame.inlined_call, mask))
                return

    @contextmanager
    def branch(self, condition: lanes.Value) -> Iterator[None]:
        """Emit the context's statements under a condition: as a real branch, or under a mask."""
        outer = self.scope
        if self.branches(condition.uniformity):
            self.scope = MaskScope("branch", outer, condition.uniformity, outer.mask, False)
            with self.emit_into([]) as block:
                yield
            self.scope = outer
            if block:
                self.emit(lanes.If(self.line, condition, block, []))
            return
        mask = self.new_mask(lanes.apply("and", self.mask_value(), condition), "mask")
        self.scope = MaskScope("branch", outer, condition.uniformity, mask, True)
        with self.emit_into([]) as block:
            yield
        self.scope = outer
        if is_heavy(block):
            taken = lanes.get(mask)
            self.emit(lanes.If(self.line, taken, block, [], any_lane=True))
        else:
            self.block.extend(block)

    def condition_and_negation(self, condition: lanes.Value) -> tuple[lanes.Value, lanes.Value]:
        """Return a condition, evaluated once, and its negation."""
        condition = self.let(condition, "condition")
        return condition, lanes.apply("not", condition)


def is_heavy(block: lanes.Block) -> bool:
    """Return whether skipping a block if no lane is active is faster than executing it, or needed for
    safety."""
    statements = list(nodes.walk(block))
    if len(statements) > HEAVY:
        return True
    return any(
        isinstance(statement, lanes.Store | lanes.Atomic | lanes.TextureAccess | lanes.Loop)
        or any(
            isinstance(part, lanes.Load)
            for value in lanes.parts_of(statement)
            for part in lanes.within(value)
        )
        for statement in statements
    )
