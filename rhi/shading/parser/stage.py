"""The parser of one stage of a shader, from the class to a `tree.StageTree`.

- Methods are looked up along the MRO of the shader, so a stage in a base calls the override in a subclass.
- The resources that a stage uses are collected from the finished tree, so code that a constant condition
  removes doesn't count.
"""

from __future__ import annotations

import math
from types import FunctionType
from typing import Final

from rhi.contract.descriptors import Stage
from rhi.contract.layout import INT, ArrayType, HostType, StructType
from rhi.shading.ir import tree
from rhi.shading.language import rules
from rhi.shading.language.builtins import Builtin, SideEffect
from rhi.shading.language.shader import Shader, StorageClass, work_group_size
from rhi.shading.language.source import refuse_at, source_of
from rhi.shading.language.types import StorageType, Type, count_scalars, has_array
from rhi.shading.parser.context import StageParser
from rhi.shading.parser.dispatch import PARSERS
from rhi.shading.parser.operand_order import order_operands
from rhi.shading.parser.ranges import prove_indices
from rhi.shading.parser.signatures import Callee, UnsizedArray

PIXELS: Final = 16
"""The invocations of a vertex or fragment stage that run together on a CPU."""
MAX_STACK: Final = 1 << 20
"""The maximum number of scalars in a work-group's local arrays: 4 MiB, half of a thread's stack on Linux."""


def parse_stage(shader: type[Shader], stage: Stage, entry: Callee) -> tree.StageTree:
    """Return the typed tree of the stage whose entry function is `entry`."""
    types = []
    for parameter in entry.signature.parameters:
        if isinstance(parameter.type, UnsizedArray):
            entry.source.refuse(rules.INTERFACE, entry.source.node, f"{parameter.name}: {parameter.type}")
        types.append(parameter.type)
    parser = StageParser(shader, stage, PARSERS)
    function = parser.parse_entry(entry, tuple(types))
    order_operands(parser.finished)
    prove_indices(parser.finished, work_group_size(shader))
    return _collect(stage, function, parser.finished, shader)


def parse_function(function: FunctionType) -> tree.Function:
    """Return the typed tree of a module-level function."""
    callee = Callee(source_of(function), None, False)
    types = []
    for parameter in callee.signature.parameters:
        if not isinstance(parameter.type, HostType):
            callee.source.refuse(rules.ANNOTATION, callee.source.node, f"{parameter.name}: {parameter.type}")
        types.append(parameter.type)
    parser = StageParser(Shader, Stage.COMPUTE, PARSERS)
    parsed = parser.parse_entry(callee, tuple(types))
    order_operands(parser.finished)
    prove_indices(parser.finished)
    return parsed


# -- the resources of a stage --------------------------------------------------------------------------------


def _collect(
    stage: Stage, entry: tree.Function, finished: list[tree.Function], shader: type[Shader]
) -> tree.StageTree:
    """Collect what a stage and the functions that it calls use."""
    uses = _Uses(shader)
    uses.add_function(entry)
    _check_locals(stage, entry, finished, shader)
    tables = [d for d in shader._declared.values() if d.table and d.name in uses.declared]
    uses.declared.update(declaration.table for declaration in tables)  # they are bound together
    bindings = tuple(d for d in shader._declared.values() if d.name in uses.declared)
    for declaration in bindings:
        type = declaration.type
        _add_structs(type.element if isinstance(type, StorageType) else type, uses.structs)
    return tree.StageTree(
        stage,
        entry,
        tuple(function for function in finished if function in uses.functions),
        bindings,
        tuple(uses.structs),
        tuple(uses.constants.values()),
        frozenset(uses.builtins),
        frozenset(uses.stored),
        frozenset(uses.loaded),
        uses.discards,
    )


class _Uses:
    """The names that the functions of a stage use.

    Attributes:
        functions: those that the entry point calls, and itself.
        structs, constants, builtins: that they mention.
        declared: the names of the bindings that they mention.
        stored, loaded: the names of the bindings that they write and read.
        discards: whether a fragment may be discarded.
    """

    def __init__(self, shader: type[Shader]) -> None:
        self._shader = shader
        self.functions: set[tree.Function] = set()
        self.structs: dict[StructType, None] = {}
        self.constants: dict[tuple[str, int], tree.ConstantArray] = {}
        self.builtins: set[Builtin] = set()
        self.declared: set[str] = set()
        self.stored: set[str] = set()
        self.loaded: set[str] = set()
        self.discards = False

    def add_function(self, entry: tree.Function) -> None:
        """Add a function and all that it calls, each once."""
        queue = [entry]
        while queue:
            function = queue.pop()
            if function in self.functions:
                continue
            self.functions.add(function)
            for type in (function.result, *(parameter.type for parameter in function.parameters)):
                _add_structs(type, self.structs)
            if function.native:
                self._add_all_bindings()
            for node in tree.walk(function.body):
                if isinstance(node, tree.Call):
                    queue.append(node.function)
                elif isinstance(node, tree.Constant):
                    _check_constant(node, function)
                else:
                    self._add_node(node)

    def _add_all_bindings(self) -> None:
        """Count all bindings as used: which declarations a native text uses isn't known."""
        for declaration in self._shader._declared.values():
            self.declared.add(declaration.name)
            self.loaded.add(declaration.name)
            writable = isinstance(declaration.type, StorageType) and declaration.type.writable
            if writable or declaration.storage_class is StorageClass.IMAGE:
                self.stored.add(declaration.name)

    def _add_node(self, node: tree.Statement | tree.Expression) -> None:
        match node:
            case tree.Discard():
                self.discards = True
            case tree.Declare(local=local):
                _add_structs(local.type, self.structs)
            case tree.Assign(target=target):
                root = tree.root_of(target)
                if isinstance(root, tree.BindingRead):
                    self.stored.add(root.declaration.name)
                    self.declared.add(root.declaration.name)
            case tree.Construct(type=type):
                _add_structs(type, self.structs)
            case tree.BindingRead(declaration=declaration):
                self.declared.add(declaration.name)
                if declaration.storage_class is not StorageClass.IMAGE:
                    self.loaded.add(declaration.name)
            case tree.ConstantArray():
                self.constants.setdefault((node.name, id(node)), node)
            case tree.BuiltinCall():
                self._add_builtin_call(node)

    def _add_builtin_call(self, node: tree.BuiltinCall) -> None:
        self.builtins.add(node.builtin)
        source = tree.root_of(node.arguments[0]) if node.arguments else None
        if isinstance(source, tree.BindingRead):
            if node.builtin.effect is SideEffect.WRITE:
                self.stored.add(source.declaration.name)
            elif (
                node.builtin.name == "load"
            ):  # naming an image isn't loading from it: `store` and `size` name it, too
                self.loaded.add(source.declaration.name)


def _check_constant(node: tree.Constant, function: tree.Function) -> None:
    """Refuse a number that an int of 32 bits can't hold."""
    if node.type is INT and not -(2**31) <= node.value < 2**31:
        allowed, tip = "an int of 32 bits", "write uint(…) for numbers above 2147483647"
        refuse_at(rules.OUT_OF_RANGE, function.name, function.file, node.span, str(node.value), allowed, tip)


def _check_locals(
    stage: Stage, entry: tree.Function, finished: list[tree.Function], shader: type[Shader]
) -> None:
    """Refuse a stage whose local arrays, including those of calls, exceed the stack of a CPU's work-group."""
    words: dict[tree.Function, int] = {}
    for function in finished:  # callees come first
        types = [parameter.type for parameter in function.parameters]
        total = 0
        for node in tree.walk(function.body):
            if isinstance(node, tree.Declare):
                types.append(node.local.type)
            elif isinstance(node, tree.Call):
                total += words[node.function]
        total += sum(
            count_scalars(t) for t in types if isinstance(t, ArrayType | StructType) and has_array(t)
        )
        words[function] = total
    invocations = math.prod(work_group_size(shader)) if stage is Stage.COMPUTE else PIXELS
    if words[entry] * invocations > MAX_STACK:
        actual = (
            f"arrays of {words[entry]} numbers, those of every call included, "
            f"for each of {invocations} invocations"
        )
        allowed, tip = (
            f"up to {MAX_STACK} numbers together",
            "use smaller work-groups, or a buffer: StorageRW[…]",
        )
        refuse_at(rules.TOO_LARGE, entry.name, entry.file, entry.span, actual, allowed, tip)


def _add_structs(type: Type, structs: dict[StructType, None]) -> None:
    """Add the structs of a type, nested ones before those that contain them."""
    if isinstance(type, ArrayType):
        _add_structs(type.element, structs)
    elif isinstance(type, StructType) and type not in structs:
        for field in type.fields:
            _add_structs(field.type, structs)
        structs[type] = None
