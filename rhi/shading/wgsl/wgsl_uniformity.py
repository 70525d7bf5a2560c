"""The conditions of a compute stage that its invocations must agree on before WGSL allows a barrier under them.

`rhi.shading` lets a barrier stand wherever the whole work-group arrives, and so does WGSL. But WGSL proves less:
to it, what is read from memory that the stage may write differs within a work-group, and so do indices inside
a group. Such a condition is stored by one invocation and loaded by all with `workgroupUniformLoad`, whose
result counts as uniform. That takes two barriers, so conditions that WGSL sees to be uniform are left alone:
this analysis errs on the side of agreement.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from types import UnionType

from rhi.errors.data_classes import dataclass
from rhi.shading.ir import tree
from rhi.shading.ir.nodes import within
from rhi.shading.ir.tree import Block, Expression, Operator, Statement
from rhi.shading.language.builtins import SideEffect
from rhi.shading.language.shader import StorageClass
from rhi.shading.language.types import ImageType, StorageType, TextureType
from rhi.shading.wgsl.wgsl_builtins import GROUP_INPUTS, INPUTS


def list_agreed_conditions(stage: tree.StageTree) -> set[Expression]:
    """Return the conditions and loop bounds that reach WGSL as agreed values, of a compute stage.

    A barrier depends on each of them, and WGSL can't see that they are the same in the whole work-group.
    """
    with_barrier = _functions_with_barrier(stage)
    required: set[Expression] = set()
    for function in with_barrier:
        required.update(_RequiredConditions(with_barrier).of_block(function.body, False, False))
    if not required:
        return set()
    uniform = _UniformValues(stage, required)
    return {condition for condition in required if not uniform.is_uniform(condition)}


def _functions_with_barrier(stage: tree.StageTree) -> set[tree.Function]:
    """Return the functions that reach a barrier, themselves or by a call."""
    functions: set[tree.Function] = set()
    for function in stage.functions:  # callees come first
        if any(_is_barrier(node, functions) for node in tree.walk(function.body)):
            functions.add(function)
    return functions


def _is_barrier(node: Statement | Expression, with_barrier: set[tree.Function]) -> bool:
    match node:
        case tree.BuiltinCall(builtin=builtin):
            return builtin.effect is SideEffect.BARRIER
        case tree.Call(function=function):
            return function in with_barrier
    return False


@dataclass
class _RequiredConditions:
    """Yields the conditions on which it depends whether an invocation arrives at a barrier."""

    with_barrier: set[tree.Function]

    def of_block(self, block: Block, returns_matter: bool, jumps_matter: bool) -> Iterator[Expression]:
        """Yield the conditions of a block.

        Args:
            returns_matter: whether a barrier follows the block in the function.
            jumps_matter: whether the innermost loop around it has a barrier.
        """
        for number, statement in enumerate(block):
            after = returns_matter or self.has_barrier(block[number + 1 :])
            yield from self.of_statement(statement, after, jumps_matter)

    def of_statement(
        self, statement: Statement, returns_matter: bool, jumps_matter: bool
    ) -> Iterator[Expression]:
        inside = self.has_barrier([statement])
        for part in tree.parts_of(statement):
            yield from self.of_expression(part)
        match statement:
            case tree.If(condition=condition, then=then, otherwise=otherwise):
                if (
                    inside
                    or (returns_matter and _leaves(statement, tree.Return))
                    or (jumps_matter and _leaves(statement, tree.Break | tree.Continue))
                ):
                    yield condition
                yield from self.of_block(then, returns_matter, jumps_matter)
                yield from self.of_block(otherwise, returns_matter, jumps_matter)
            case tree.For(start=start, stop=stop, step=step, body=body):
                if inside or (returns_matter and _leaves(statement, tree.Return)):
                    yield from (start, stop, step)
                yield from self.of_block(body, returns_matter or inside, inside)
            case tree.While(condition=condition, body=body):
                if inside or (returns_matter and _leaves(statement, tree.Return)):
                    yield condition
                yield from self.of_block(body, returns_matter or inside, inside)

    def of_expression(self, expression: Expression) -> Iterator[Expression]:
        """Yield the conditions of choices whose operands call a function with a barrier."""
        for node in within(expression, "Expression"):
            match node:
                case tree.Select(condition=condition, then=then, otherwise=otherwise):
                    if self.calls_barrier(then) or self.calls_barrier(otherwise):
                        yield condition
                case tree.Binary(operator=Operator.AND | Operator.OR, left=left, right=right):
                    if self.calls_barrier(right):
                        yield left

    def has_barrier(self, block: Block) -> bool:
        return any(_is_barrier(node, self.with_barrier) for node in tree.walk(block))

    def calls_barrier(self, expression: Expression) -> bool:
        return any(_is_barrier(node, self.with_barrier) for node in within(expression, "Expression"))


def _leaves(statement: Statement, jump: type | UnionType) -> bool:
    """Return whether a statement may jump out of itself; a jump of an inner loop stays inside."""
    match statement:
        case tree.If(then=then, otherwise=otherwise):
            return any(_leaves(inner, jump) for inner in (*then, *otherwise))
        case tree.For(body=body) | tree.While(body=body):
            return jump is tree.Return and any(_leaves(inner, jump) for inner in body)
    return isinstance(statement, jump)


@dataclass
class _UniformValues:
    """The locals, parameters and results that WGSL sees to be the same in the whole work-group.

    At first all count as such; those that are computed from others are taken away until none is left to take.
    """

    stage: tree.StageTree
    required: set[Expression]
    varying: set[tree.Local | tree.Function] = field(default_factory=set)

    def __post_init__(self) -> None:
        before = -1
        while len(self.varying) > before:
            before = len(self.varying)
            for function in self.stage.functions:
                is_shared = not self._jumps_apart(function.body, tree.Return)
                self._visit_block(function, function.body, is_shared)

    def is_uniform(self, node: Expression) -> bool:
        """Return whether WGSL sees that an expression is the same in the whole work-group."""
        return all(map(self._is_uniform_node, within(node, "Expression")))

    def _is_uniform_node(self, node: Expression) -> bool:
        """Return whether a node is uniform if its operands are."""
        match node:
            case tree.Read(local=local):
                return local not in self.varying
            case tree.BindingRead(declaration=declaration):
                type = declaration.type
                if isinstance(type, TextureType | ImageType):
                    return False
                if declaration.storage_class is StorageClass.STORAGE:
                    return isinstance(type, StorageType) and not type.writable
                return declaration.storage_class is StorageClass.UNIFORM
            case tree.BuiltinCall(builtin=builtin):
                if builtin.name in INPUTS:
                    return builtin.name in GROUP_INPUTS
                return builtin.effect is SideEffect.NONE
            case tree.Call(function=function):
                return function not in self.varying and not function.native
        return True

    def _is_agreed(self, condition: Expression) -> bool:
        return condition in self.required or self.is_uniform(condition)

    def _visit_block(self, function: tree.Function, block: Block, is_shared: bool) -> None:
        """Take away what a block computes from values that vary, or where part of a work-group may be."""
        for statement in block:
            for part in tree.parts_of(statement):
                self._visit_calls(part)
            match statement:
                case tree.Declare(local=local, value=value):
                    if value is not None and not (is_shared and self.is_uniform(value)):
                        self.varying.add(local)
                case tree.Assign(target=target, value=value):
                    root = tree.root_of(target)
                    indices = [index.index for index in tree.indices_of(target)]
                    if isinstance(root, tree.Read) and not (
                        is_shared and all(map(self.is_uniform, (value, *indices)))
                    ):
                        self.varying.add(root.local)
                case tree.Return(value=Expression() as value):
                    if not (is_shared and self.is_uniform(value)):
                        self.varying.add(function)
                case tree.If(condition=condition, then=then, otherwise=otherwise):
                    inside = is_shared and self._is_agreed(condition)
                    self._visit_block(function, then, inside)
                    self._visit_block(function, otherwise, inside)
                case tree.For(local=local, start=start, stop=stop, step=step, body=body):
                    inside = (
                        is_shared
                        and all(map(self._is_agreed, (start, stop, step)))
                        and not self._jumps_apart(body, tree.Break | tree.Continue)
                    )
                    if not inside:
                        self.varying.add(local)
                    self._visit_block(function, body, inside)
                case tree.While(condition=condition, body=body):
                    inside = (
                        is_shared
                        and self._is_agreed(condition)
                        and not self._jumps_apart(body, tree.Break | tree.Continue)
                    )
                    self._visit_block(function, body, inside)

    def _visit_calls(self, expression: Expression) -> None:
        for node in within(expression, "Expression"):
            if isinstance(node, tree.Call):
                for local, argument in zip(node.function.parameters, node.arguments, strict=True):
                    if not self.is_uniform(argument):
                        self.varying.add(local)

    def _jumps_apart(self, block: Block, jump: type | UnionType) -> bool:
        """Return whether part of a work-group may leave a block by a jump."""
        for statement in block:
            match statement:
                case tree.If(condition=condition, then=then, otherwise=otherwise):
                    if not self._is_agreed(condition) and _leaves(statement, jump):
                        return True
                    if self._jumps_apart(then, jump) or self._jumps_apart(otherwise, jump):
                        return True
                case tree.For(start=start, stop=stop, step=step, body=body) if jump is tree.Return:
                    agreed = all(map(self._is_agreed, (start, stop, step)))
                    if (not agreed and _leaves(statement, jump)) or self._jumps_apart(body, jump):
                        return True
                case tree.While(condition=condition, body=body) if jump is tree.Return:
                    if not self._is_agreed(condition) and _leaves(statement, jump):
                        return True
                    if self._jumps_apart(body, jump):
                        return True
        return False
