"""Python's order of evaluation: operands whose order can be observed become variables, from left to right.

GLSL and C leave open in which order operands are evaluated, and drivers read memory late: on Mesa, `a[0] +
f()` reads what `f` has written. Where operands conflict (`rhi.shading.ir.effects`), each is therefore
evaluated in a statement of its own before the later ones. Expressions without such operands stay as they are.
What must only be evaluated under a condition (the right operand of `and` and `or`, the operands of a
selection) gets its statements inside a branch.

In Python's order a value precedes the indices of the target that it is assigned to. The target of an
augmented assignment precedes the value, and its indices are evaluated once.
"""

from __future__ import annotations

from collections.abc import Sequence

from rhi.contract.layout import BOOL
from rhi.shading.ir import nodes, tree
from rhi.shading.ir.effects import NONE, EffectAnalysis
from rhi.shading.ir.tree import Block, Expression, Local, Operator
from rhi.shading.language.types import ImageType, TextureType


def order_operands(functions: Sequence[tree.Function]) -> None:
    """Bring the operands in the bodies of these functions into Python's order."""
    ordering = _Ordering()
    for function in functions:
        if function.evaluates_effects:
            function.body = ordering.block(function.body)


class _Ordering:
    """Rewrites trees in place. `before` is the block to which statements are added that precede the current
    one."""

    def __init__(self) -> None:
        self._effects = EffectAnalysis()

    # -- statements

    def block(self, block: Block) -> Block:
        """Return a block with the statements that its expressions need."""
        result: Block = []
        for statement in block:
            result.append(self._statement(statement, result))
        return result

    def _statement(self, node: tree.Statement, before: Block) -> tree.Statement:
        match node:
            case tree.Declare(value=value) | tree.Return(value=value) if value is not None:
                node.value = self._expression(value, before)
            case tree.Evaluate(value=value):
                node.value = self._expression(value, before)
            case tree.Assign():
                self._assign(node, before)
            case tree.If(condition=condition):
                node.condition = self._expression(condition, before)
                node.then, node.otherwise = self.block(node.then), self.block(node.otherwise)
            case tree.For():
                node.start, node.stop, node.step = self._sequence([node.start, node.stop, node.step], before)
                node.body = self.block(node.body)
            case tree.While():
                return self._while(node)
        return node

    def _assign(self, node: tree.Assign, before: Block) -> None:
        if not tree.has_effect(node.value) and not tree.has_effect(node.target):
            return
        indices = tree.indices_of(node.target)
        if any(part is node.target for part in nodes.within(node.value, "Expression")):
            value = self._effects.of(node.value)
            for index in indices:
                if self._effects.of(index.index).conflicts_with(value):
                    index.index = _hoist(index.index, before)
            node.value = self._expression(node.value, before)
            return
        operands = self._sequence([node.value, *(index.index for index in indices)], before, "value")
        node.value = operands[0]
        _set_indices(indices, operands[1:])

    def _while(self, node: tree.While) -> tree.Statement:
        inside: Block = []
        condition = self._expression(node.condition, inside)
        body = self.block(node.body)
        if not inside:
            node.condition, node.body = condition, body
            return node
        span = node.span
        ends = tree.Unary(BOOL, span, Operator.NOT, condition)
        leave = tree.If(span, ends, [tree.Break(span)], [])
        return tree.While(span, tree.Constant(BOOL, span, True), [*inside, leave, *body])

    # -- expressions

    def _expression(self, node: Expression, before: Block) -> Expression:
        """Return an expression whose operands may be evaluated in any order."""
        if not tree.has_effect(node):
            return node
        match node:
            case tree.Binary():
                return self._binary(node, before)
            case tree.Select():
                return self._select(node, before)
            case tree.Unary():
                node.operand = self._expression(node.operand, before)
            case tree.Convert():
                node.value = self._expression(node.value, before)
            case tree.Member() | tree.Swizzle() | tree.Index():
                self._access(node, before)
            case tree.Construct():
                node.parts = tuple(self._sequence(node.parts, before))
            case tree.Call():
                node.arguments = tuple(self._sequence(node.arguments, before))
            case tree.BuiltinCall():
                self._builtin(node, before)
        return node

    def _sequence(
        self, operands: Sequence[Expression], before: Block, first_name: str = "operand"
    ) -> list[Expression]:
        """Return operands in Python's order; those that conflict with later ones are read from variables."""
        effects = [self._effects.of(operand) for operand in operands]
        results = []
        for number, operand in enumerate(operands):
            result = self._expression(operand, before)
            result_effects = self._effects.of(result)
            if any(result_effects.conflicts_with(later) for later in effects[number + 1 :]):
                result = _hoist(result, before, "operand" if number else first_name)
            results.append(result)
        return results

    def _binary(self, node: tree.Binary, before: Block) -> Expression:
        """Return an operation with the chain of operations on its left, which may be long."""
        chain = tree.left_chain(node)
        left = self._expression(chain[0].left, before)
        effects = self._effects.of(left)
        for link in chain:
            if link.operator in (Operator.AND, Operator.OR):
                inside: Block = []
                right = self._expression(link.right, inside)
                if inside:
                    left, effects = _decide(link, left, right, inside, before), NONE
                    continue
            else:
                if effects.conflicts_with(self._effects.of(link.right)):
                    left, effects = _hoist(left, before), NONE
                right = self._expression(link.right, before)
            link.left, link.right = left, right
            left, effects = link, effects | self._effects.of(right)
        return left

    def _select(self, node: tree.Select, before: Block) -> Expression:
        condition = self._expression(node.condition, before)
        then_block: Block = []
        else_block: Block = []
        then, otherwise = (
            self._expression(node.then, then_block),
            self._expression(node.otherwise, else_block),
        )
        if then_block or else_block:
            span = node.span
            selected = Local("selected", node.type, writes=2)
            then_block.append(tree.Assign(span, tree.Read(node.type, span, selected), then))
            else_block.append(tree.Assign(span, tree.Read(node.type, span, selected), otherwise))
            before.append(tree.Declare(span, selected, None))
            before.append(tree.If(span, condition, then_block, else_block))
            return tree.Read(node.type, span, selected)
        if not self._effects.of(condition).writes.isdisjoint(self._effects.of(then, otherwise).reads):
            condition = _hoist(condition, before)  # WGSL's `select` evaluates it last
        node.condition, node.then, node.otherwise = condition, then, otherwise
        return node

    def _access(self, node: Expression, before: Block) -> None:
        """Bring the indices of an access into order, behind the value that they are taken of."""
        indices, holder, root = tree.indices_of(node), node, node
        while isinstance(root, tree.Member | tree.Swizzle | tree.Index):
            holder, root = root, root.base
        positions = [index.index for index in indices]
        if isinstance(root, tree.Read | tree.BindingRead | tree.ConstantArray):
            _set_indices(indices, self._sequence(positions, before))
            return
        assert isinstance(holder, tree.Member | tree.Swizzle | tree.Index)
        holder.base, *positions = self._sequence([root, *positions], before)
        _set_indices(indices, positions)

    def _builtin(self, node: tree.BuiltinCall, before: Block) -> None:
        if node.builtin.name.startswith("atomic_"):
            target, *values = node.arguments
            indices = tree.indices_of(target)
            operands = self._sequence([*(index.index for index in indices), *values], before)
            _set_indices(indices, operands[: len(indices)])
            node.arguments = (target, *operands[len(indices) :])
        elif node.arguments and isinstance(node.arguments[0].type, TextureType | ImageType):
            node.arguments = (node.arguments[0], *self._sequence(node.arguments[1:], before))
        else:
            node.arguments = tuple(self._sequence(node.arguments, before))


def _decide(
    node: tree.Binary, left: Expression, right: Expression, inside: Block, before: Block
) -> Expression:
    """Write `and` or `or` as a branch, which has the statements of the right operand, and return its
    value."""
    span = node.span
    decided = Local("selected", BOOL, writes=2)
    read = tree.Read(BOOL, span, decided)
    inside.append(tree.Assign(span, tree.Read(BOOL, span, decided), right))
    is_open = read if node.operator is Operator.AND else tree.Unary(BOOL, span, Operator.NOT, read)
    before.append(tree.Declare(span, decided, left))
    before.append(tree.If(span, is_open, inside, []))
    return tree.Read(BOOL, span, decided)


def _hoist(node: Expression, before: Block, name: str = "operand") -> Expression:
    """Evaluate an expression before the current statement, and return a read of its value."""
    operand = Local(name, node.type, writes=1)
    before.append(tree.Declare(node.span, operand, node))
    return tree.Read(node.type, node.span, operand)


def _set_indices(indices: Sequence[tree.Index], values: Sequence[Expression]) -> None:
    for index, value in zip(indices, values, strict=True):
        index.index = value
