"""Writes lane code as Python that computes on NumPy arrays, one array element per invocation.

- Values broadcast. A value that is uniform over the dispatch is one number, a value that is uniform over a
  work-group has the shape (groups, 1), and a varying one (groups, invocations). A function evaluated on
  arrays takes any shapes that broadcast.
- In the text, `R` is `rhi.shading.numpy.runtime` and `F` the dtype of floats.
"""

from __future__ import annotations

import math
from typing import Final

from rhi.contract.layout import BOOL, FLOAT, INT, UINT, ScalarType
from rhi.shading.ir import lanes
from rhi.shading.ir.lanes import AddressSpace, Code, MemoryRegion, Value
from rhi.shading.ir.primitives import spelling

_ZEROS: Final = {
    FLOAT: "F(0)",
    INT: "np.int32(0)",
    UINT: "np.uint32(0)",
    BOOL: "False",
}
_DTYPES: Final = {
    FLOAT: "F",
    INT: "np.int32",
    UINT: "np.uint32",
    BOOL: "np.bool_",
}


def write_numpy_function(code: Code) -> str:
    """Return the text of a function `run(F, M, P, arguments)`.

    `M` maps names to memory, `P` is the `WorkGroups` of a dispatch or the `Invocations` of another stage. The
    function returns the tuple of results.
    """
    return _NumpyWriter(code).write()


class _NumpyWriter:
    def __init__(self, code: Code) -> None:
        self.code = code
        self.lines: list[str] = []
        self.constants: dict[str, str] = {}
        self.advances: list[lanes.Block] = []

    def write(self) -> str:
        self.block(self.code.block, 1)
        results = "".join(f"{self.value(value)}, " for value in self.code.results)
        head = ["def run(F, M, P, arguments):"]
        names = "".join(f"{argument.name}, " for argument in self.code.arguments)
        if names:
            head.append(f"    {names}= arguments")
        for memory in self.code.memories:
            if memory.space is AddressSpace.CONSTANT:
                numbers = (
                    ", ".join(map(repr, memory.values)).replace("inf", "np.inf").replace("nan", "np.nan")
                )
                head.append(f"    {self.name(memory)} = R.constants([{numbers}], {_DTYPES[memory.kind]})")
            else:
                head.append(f"    {self.name(memory)} = M[{memory.name!r}]")
        head.extend(f"    {name} = {text}" for text, name in self.constants.items())
        return "\n".join([*head, *self.lines, f"    return ({results})"]) + "\n"

    def name(self, memory: MemoryRegion) -> str:
        """Return the name of a memory region; a name from the shader's class gets a "_", so that it can't
        clash."""
        is_local = memory.space in (AddressSpace.PRIVATE, AddressSpace.CONSTANT)
        return memory.name if is_local else f"{memory.name}_"

    def add(self, depth: int, text: str) -> None:
        self.lines.append("    " * depth + text)

    # -- values

    def value(self, node: Value) -> str:
        """Return a value as an expression."""
        match node:
            case lanes.Literal(kind=kind, value=value):
                return self.literal(kind, value)
            case lanes.Get(variable=variable):
                return variable.name
            case lanes.Argument(name=name):
                return name
            case lanes.ElementCount(memory=memory):
                return f"np.int32({self.name(memory)}.size // {memory.stride})"
            case lanes.Input(index=lanes.DispatchIndex.LOCAL_INDEX):
                return "P.local_index"
            case lanes.Input(index=dispatch_index, axis=axis):
                return f"P.{dispatch_index.value}[{axis}]"
            case lanes.Apply(operation=operation, arguments=arguments):
                return spelling(operation).numpy.format(*map(self.value, arguments))
            case lanes.Load():
                return self.load(node)
        raise TypeError(f"no NumPy for {node}")

    def literal(self, kind: ScalarType, value: float) -> str:
        if kind is BOOL:
            return repr(bool(value))
        if kind is FLOAT:
            number = float(value)
            text = repr(number) if math.isfinite(number) else f'float("{number}")'
            text = f"F({text})"
        else:
            text = f"{_DTYPES[kind]}({int(value)})"
        return self.constants.setdefault(text, f"C{len(self.constants)}")

    def address(self, index: Value, scale: int, offset: int) -> str:
        text = self.value(index)
        text = f"{text} * {scale}" if scale != 1 else text
        return f"{text} + {offset}" if offset else text

    def mask(self, mask: lanes.Variable | None) -> str:
        return mask.name if mask is not None else "None"

    def load(self, node: lanes.Load) -> str:
        memory = node.memory
        address = self.address(node.index, node.scale, node.offset)
        mask = self.mask(node.mask)
        if memory.space is AddressSpace.PRIVATE:
            return f"R.load_private({self.name(memory)}, {address}, {mask})"
        if memory.space is AddressSpace.CONSTANT:
            return f"R.load({self.name(memory)}, {address}, {mask})"
        if memory.space is AddressSpace.SHARED:
            return f"R.load_shared({self.name(memory)}, {address}, {mask}, P, {_DTYPES[node.kind]})"
        return f"R.load_words({self.name(memory)}, {address}, {mask}, {_DTYPES[node.kind]})"

    # -- statements

    def block(self, block: lanes.Block, depth: int) -> None:
        """Write a block, `pass` if none of its statements has a text, such as a barrier alone."""
        count = len(self.lines)
        for statement in block:
            self.statement(statement, depth)
        if len(self.lines) == count:
            self.add(depth, "pass")

    def statement(self, node: lanes.Statement, depth: int) -> None:
        match node:
            case lanes.Let(variable=variable, value=value):
                text = self.value(value) if value is not None else _ZEROS[variable.kind]
                self.add(depth, f"{variable.name} = {text}")
            case lanes.DeclareMemory(memory=memory):
                kind = _DTYPES[memory.kind]
                self.add(depth, f"{self.name(memory)} = R.private({memory.length}, {kind})")
            case lanes.Set(variable=variable, value=value, mask=mask):
                text = self.value(value)
                if mask is not None:
                    text = f"np.where({mask.name}, {text}, {variable.name})"
                self.add(depth, f"{variable.name} = {text}")
            case lanes.Store():
                self.store(node, depth)
            case lanes.Atomic():
                self.atomic(node, depth)
            case lanes.TextureAccess():
                self.texture(node, depth)
            case lanes.Check(wrong=wrong, value=checked, limit=limit, mask=mask):
                values = f"{self.value(wrong)}, {self.value(checked)}, {self.value(limit)}"
                self.add(depth, f"R.check({values}, {self.mask(mask)}, {node.line!r})")
            case lanes.Barrier():
                pass
            case lanes.If(condition=condition, then=then, otherwise=otherwise, any_lane=any_lane):
                text = self.value(condition)
                self.add(depth, f"if np.any({text}):" if any_lane else f"if {text}:")
                self.block(then, depth + 1)
                if otherwise:
                    self.add(depth, "else:")
                    self.block(otherwise, depth + 1)
            case lanes.Loop(body=body, advance=advance):
                self.add(depth, "while True:")
                self.advances.append(advance)
                self.block([*body, *advance], depth + 1)
                self.advances.pop()
            case lanes.Break(when_empty=mask):
                self.jump("break", mask, depth)
            case lanes.Continue(when_empty=mask):
                self.jump("continue", mask, depth)
            case lanes.InlinedCall(block=inner):
                self.block(inner, depth)
            case _:
                raise TypeError(f"no NumPy for {node}")

    def jump(self, word: str, mask: lanes.Variable | None, depth: int) -> None:
        if mask is not None:
            self.add(depth, f"if not np.any({mask.name}):")
            depth += 1
        if word == "continue":
            for statement in self.advances[-1]:
                self.statement(statement, depth)
        self.add(depth, word)

    def target(self, memory: MemoryRegion, index: Value, scale: int, offset: int) -> str:
        return f"{self.name(memory)}, {self.address(index, scale, offset)}"

    def store(self, node: lanes.Store, depth: int) -> None:
        mask = self.mask(node.mask)
        names = {AddressSpace.PRIVATE: "store_private", AddressSpace.SHARED: "store_shared"}
        function, groups = (
            names.get(node.memory.space, "store"),
            ", P" * (node.memory.space is AddressSpace.SHARED),
        )
        for i, value in enumerate(node.values):
            target = self.target(node.memory, node.index, node.scale, node.offset + i)
            self.add(depth, f"R.{function}({target}, {self.value(value)}, {mask}{groups})")

    def atomic(self, node: lanes.Atomic, depth: int) -> None:
        mask = self.mask(node.mask)
        target = self.target(node.memory, node.index, node.scale, node.offset)
        shared = node.memory.space is AddressSpace.SHARED
        values = ", ".join(map(self.value, node.values))
        result = f"{node.result.name} = " if node.result is not None else ""
        needs_result = node.result is not None
        self.add(
            depth,
            f"{result}R.atomic({node.operation!r}, {target}, ({values},), {mask}, P, {shared}, "
            f"{_DTYPES[node.kind]}, {needs_result})",
        )

    def texture(self, node: lanes.TextureAccess, depth: int) -> None:
        """Write the call of a method of `rhi.shading.numpy.host_textures.HostTexture`."""
        name, values = self.name(node.memory), [self.value(value) for value in node.arguments]
        if node.operation == "store":
            mask, (x, y, z, *components) = self.mask(node.mask), values
            self.add(depth, f"{name}.store({x}, {y}, {z}, ({', '.join(components)}), {mask}, P.shape)")
            return
        results = ", ".join(result.name for result in node.results)
        match node.operation:
            case "levels":
                call = "count_levels()"
            case "size":
                call = f"size({values[0]}, {len(node.results)})"
            case operation:
                call = f"{operation}(F, {', '.join(values)})"
        self.add(depth, f"{results}, = {name}.{call}")
