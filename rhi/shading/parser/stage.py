"""The parser of one stage of a shader, from the class to a `tree.StageTree`.

- Methods are looked up along the MRO of the shader, so a stage in a base calls the override in a subclass.
- The resources that a stage uses are collected from the finished tree, so code that a constant condition removes
  doesn't count.
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
from rhi.shading.language.shader import Shader, StorageClass, find_work_group
from rhi.shading.language.source import refuse_at, source_of
from rhi.shading.language.types import StorageType, Type, count_scalars, has_array
from rhi.shading.parser import calls as calls  # what they parse
from rhi.shading.parser import expressions as expressions
from rhi.shading.parser import statements as statements
from rhi.shading.parser.context import StageParser
from rhi.shading.parser.ranges import prove_indices
from rhi.shading.parser.signatures import Callee, UnsizedArray

PIXELS: Final = 16
"""The invocations of a vertex or fragment stage that run together on a CPU."""
MAX_STACK: Final = 1 << 20
"""The greatest number of scalars in the local arrays of a work-group: 4 MiB, half of a thread's stack on Linux."""


def parse_stage(shader: type[Shader], stage: Stage, entry: Callee) -> tree.StageTree:
    """Return the typed tree of the stage whose entry function is `entry`."""
    types = []
    for parameter in entry.signature.parameters:
        if isinstance(parameter.type, UnsizedArray):
            entry.source.refuse(rules.INTERFACE, entry.source.node, f"{parameter.name}: {parameter.type}")
        types.append(parameter.type)
    parser = StageParser(shader, stage)
    function = parser.parse_entry(entry, tuple(types))
    prove_indices(parser.finished, find_work_group(shader))
    return _collect(stage, function, parser.finished, shader)


def parse_function(function: FunctionType) -> tree.Function:
    """Return the typed tree of a function that belongs to no shader."""
    callee = Callee(source_of(function), None, False)
    types = []
    for parameter in callee.signature.parameters:
        if not isinstance(parameter.type, HostType):
            callee.source.refuse(rules.ANNOTATION, callee.source.node, f"{parameter.name}: {parameter.type}")
        types.append(parameter.type)
    parser = StageParser(Shader, Stage.COMPUTE)
    parsed = parser.parse_entry(callee, tuple(types))
    prove_indices(parser.finished)
    return parsed


# -- the resources of a stage ---------------------------------------------------------------------------------------


def _collect(stage: Stage, entry: tree.Function, finished: list[tree.Function], shader: type[Shader]) -> tree.StageTree:
    used: set[tree.Function] = set()
    structs: dict[StructType, None] = {}
    declared: set[str] = set()
    constants: dict[tuple[str, int], tree.ConstantArray] = {}
    builtins: set[Builtin] = set()
    stored: set[str] = set()
    loaded: set[str] = set()
    discards = False
    queue = [entry]
    while queue:
        function = queue.pop()
        if function in used:
            continue
        used.add(function)
        for type in (function.result, *(parameter.type for parameter in function.parameters)):
            _add_structs(type, structs)
        if function.native:
            # The declarations that a native text uses aren't known, so all of them count as used.
            for declaration in shader._declared.values():
                declared.add(declaration.name)
                loaded.add(declaration.name)
                writable = isinstance(declaration.type, StorageType) and declaration.type.writable
                if writable or declaration.storage_class is StorageClass.IMAGE:
                    stored.add(declaration.name)
        for node in tree.walk(function.body):
            match node:
                case tree.Discard():
                    discards = True
                case tree.Declare(local=local):
                    _add_structs(local.type, structs)
                case tree.Assign(target=target):
                    root = tree.root_of(target)
                    if isinstance(root, tree.BindingRead):
                        stored.add(root.declaration.name)
                        declared.add(root.declaration.name)
                case tree.Construct(type=type):
                    _add_structs(type, structs)
                case tree.BindingRead(declaration=declaration):
                    declared.add(declaration.name)
                    if declaration.storage_class is not StorageClass.IMAGE:
                        loaded.add(declaration.name)
                case tree.ConstantArray():
                    constants.setdefault((node.name, id(node)), node)
                case tree.Call(function=callee):
                    queue.append(callee)
                case tree.BuiltinCall(builtin=builtin, arguments=arguments):
                    builtins.add(builtin)
                    source = tree.root_of(arguments[0]) if arguments else None
                    if isinstance(source, tree.BindingRead):
                        if builtin.effect is SideEffect.WRITE:
                            stored.add(source.declaration.name)
                        elif builtin.name == "load":  # images are only named by what reads, stores or asks for a size
                            loaded.add(source.declaration.name)
                case tree.Constant(type=type, value=value) if type is INT and not -(2**31) <= value < 2**31:
                    allowed, tip = "an int of 32 bits", "write uint(…) for numbers above 2147483647"
                    refuse_at(rules.OUT_OF_RANGE, function.name, function.file, node.span, str(value), allowed, tip)
    _check_locals(stage, entry, finished, shader)
    bindings = tuple(d for d in shader._declared.values() if d.name in declared)
    for declaration in bindings:
        type = declaration.type
        _add_structs(type.element if isinstance(type, StorageType) else type, structs)
    return tree.StageTree(
        stage,
        entry,
        tuple(function for function in finished if function in used),
        bindings,
        tuple(structs),
        tuple(constants.values()),
        frozenset(builtins),
        frozenset(stored),
        frozenset(loaded),
        discards,
    )


def _check_locals(stage: Stage, entry: tree.Function, finished: list[tree.Function], shader: type[Shader]) -> None:
    """Refuse a stage whose local arrays, those of every call included, don't fit the stack of a CPU's work-group."""
    words: dict[tree.Function, int] = {}
    for function in finished:  # those that are called come first
        types = [parameter.type for parameter in function.parameters]
        total = 0
        for node in tree.walk(function.body):
            if isinstance(node, tree.Declare):
                types.append(node.local.type)
            elif isinstance(node, tree.Call):
                total += words[node.function]
        total += sum(count_scalars(t) for t in types if isinstance(t, ArrayType | StructType) and has_array(t))
        words[function] = total
    invocations = math.prod(find_work_group(shader)) if stage is Stage.COMPUTE else PIXELS
    if words[entry] * invocations > MAX_STACK:
        given = f"arrays of {words[entry]} numbers, those of every call included, for each of {invocations} invocations"
        allowed, tip = f"up to {MAX_STACK} numbers together", "use smaller work-groups, or a buffer: StorageRW[…]"
        refuse_at(rules.TOO_LARGE, entry.name, entry.file, entry.span, given, allowed, tip)


def _add_structs(type: Type, structs: dict[StructType, None]) -> None:
    """Add the structs of a type, nested ones before those that contain them."""
    if isinstance(type, ArrayType):
        _add_structs(type.element, structs)
    elif isinstance(type, StructType) and type not in structs:
        for field in type.fields:
            _add_structs(field.type, structs)
        structs[type] = None
