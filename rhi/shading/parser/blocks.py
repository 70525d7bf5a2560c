"""Blocks under construction, in which declarations of variables are placed at the end of the function.

Python's variables belong to the function; in the tree each is declared in the innermost block that contains
all its uses.
"""

from __future__ import annotations

from dataclasses import field

from rhi.contract.layout import INT
from rhi.errors.data_classes import dataclass
from rhi.shading.ir import tree
from rhi.shading.ir.tree import Local


class BlockBuilder(list[tree.Statement]):
    """A block under construction.

    Attributes:
        declares: the locals to declare in front of the statement at an index.
        prologue: statements that precede all others.
    """

    def __init__(self) -> None:
        super().__init__()
        self.declares: dict[int, list[Local]] = {}
        self.prologue: tree.Block = []


@dataclass(slots=True, eq=False)
class Splice(tree.Statement):
    """The taken branch of a condition that is known at compile time; its statements are inserted into the
    parent."""

    block: BlockBuilder


@dataclass(slots=True, eq=False)
class TrackedLocal:
    """The uses of a local found so far: its first assignment, and the innermost block that contains all uses.

    Attributes:
        path: the blocks around all uses, from the function's body inwards.
        indices: for each block of the path, the index of the statement that contains the first use.
        first: the first assignment, statement `first_index` of `first_block`.
        loops: the `for` loops that have the local as their variable.
    """

    local: Local
    path: list[BlockBuilder]
    indices: list[int]
    first: tree.Statement | None = None
    first_block: BlockBuilder | None = None
    first_index: int = 0
    loops: list[tree.For] = field(default_factory=list)


def place_declaration(variable: TrackedLocal) -> None:
    """Place the variable's declaration in the innermost block that contains all its uses."""
    if variable.local.is_parameter or not variable.path:
        return
    home, index = variable.path[-1], variable.indices[len(variable.path) - 1]
    if variable.loops:
        loop = variable.loops[0]
        is_own_loop = len(variable.loops) == 1 and home is loop.body
        if is_own_loop and variable.local.writes == 1:
            return  # the `For` declares it
        for loop in variable.loops:
            # The body assigns the variable, or it outlives the loop: the loop gets a counter of its own.
            loop.local = Local(f"{variable.local.name}_count", INT, writes=1)
            count = tree.Read(INT, loop.span, loop.local)
            assert isinstance(loop.body, BlockBuilder)
            loop.body.prologue.append(
                tree.Declare(loop.span, variable.local, count)
                if home is loop.body
                else tree.Assign(loop.span, tree.Read(INT, loop.span, variable.local), count)
            )
        if any(home is loop.body for loop in variable.loops):
            return
    if variable.first is not None and variable.first_block is home:
        assert isinstance(variable.first, tree.Assign)
        home[variable.first_index] = tree.Declare(variable.first.span, variable.local, variable.first.value)
        return
    home.declares.setdefault(index, []).append(variable.local)


def finish(block: BlockBuilder) -> tree.Block:
    """Return the block with its declarations placed and the known branches inserted."""
    result: tree.Block = list(block.prologue)
    for index, statement in enumerate(block):
        result.extend(tree.Declare(statement.span, local, None) for local in block.declares.get(index, ()))
        match statement:
            case Splice(block=inner):
                result.extend(finish(inner))
            case tree.If(then=BlockBuilder() as then, otherwise=BlockBuilder() as otherwise):
                statement.then, statement.otherwise = finish(then), finish(otherwise)
            case tree.For(body=BlockBuilder() as body) | tree.While(body=BlockBuilder() as body):
                statement.body = finish(body)
        if not isinstance(statement, Splice):
            result.append(statement)
        if result and tree.is_left(result[-1]):
            break  # the statements behind it are unreachable
    return result
