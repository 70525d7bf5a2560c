"""Writes lane code as OpenCL C: scalars for uniform values, vectors for varying ones.

- A kernel's parameters are the shader's bindings in order: `constant uint *` for a uniform block, `global
  uint *` and the number of elements for a buffer. It has a work-item for every `width` invocations of a
  work-group, in one dimension; the groups may have three.
- Memory consists of words, which `as_float` and `as_int` cast. A mask is an int vector of 0 and -1.
- With a width of 1 there are no masks: loops, branches and returns are those of C.
"""

from __future__ import annotations

import math
import struct
from typing import Final

from rhi.contract.descriptors import Binding, BindingKind, StageText, TextureKind
from rhi.contract.layout import BOOL, FLOAT, INT, UINT, ScalarType
from rhi.shading.ir import lanes, tree
from rhi.shading.ir.lanes import (
    AddressSpace,
    Affine,
    Code,
    Literal,
    MemoryRegion,
    Uniformity,
    Value,
    apply,
    number,
)
from rhi.shading.ir.primitives import spelling
from rhi.shading.ir.text import Lines, power_steps
from rhi.shading.language.builtins import Precision
from rhi.shading.opencl import prelude
from rhi.shading.opencl.opencl_textures import textures_text

_NAMES: Final = {FLOAT: "float", INT: "int", UINT: "uint", BOOL: "int"}
_ATOMICS: Final = {"exchange": "xchg", "compare_exchange": "cmpxchg"}
_SPACES: Final = {
    AddressSpace.STORAGE: "global",
    AddressSpace.SHARED: "local",
    AddressSpace.UNIFORM: "constant",
    AddressSpace.PRIVATE: "private",
    AddressSpace.CONSTANT: "constant",
}
_WRAPPING: Final = {"add", "subtract", "multiply", "negate"}
"""The operations on ints that wrap. C's signed ints may not: compilers take `y + x < y` for `x < 0`."""
_LONGEST_STRIDE: Final = 8
_LARGEST_POWER: Final = 64
"""The largest exponent for which multiplications are faster than a logarithm, and more exact."""


def write_opencl_kernel(
    code: Code, bindings: tuple[Binding, ...], precision: Precision, native: tree.Function | None = None
) -> StageText:
    """Return a compute stage as OpenCL C 1.2, a kernel named `compute`.

    Args:
        native: the function whose body is written in OpenCL C, if there is one; `code` is empty then.
    """
    return OpenCLWriter(code, precision, native).kernel(bindings)


class OpenCLWriter:
    """A writer of compute kernels; `rhi.shading.opencl.opencl_stages` derives the writer of a draw's stages
    from it."""

    uniform_space = "constant"
    steps = ""
    """The variable with each lane's distance from the first, in a stage whose lanes may not be
    consecutive."""

    def __init__(self, code: Code, precision: Precision, native: tree.Function | None = None) -> None:
        self.code = code
        self.native = native.native[f"opencl{code.width}"] if native is not None else None
        self.native_file = native.file if native is not None else ""
        self.width = code.width
        self.suffix = str(code.width) if code.width > 1 else ""
        self.precision = precision
        self.lines = Lines()
        self.helpers: dict[str, str] = {}
        self.textures: set[TextureKind] = set()

    def kernel(self, bindings: tuple[Binding, ...]) -> StageText:
        size = math.prod(self.code.work_group)
        items = -(-size // self.width)
        parameters = [text for binding in bindings for text in self.parameters(binding)]
        parameters += ["global int *rhi_faults"] if self.code.checked else []
        self.lines.add(f"__attribute__((reqd_work_group_size({items}, 1, 1)))")
        with self.lines.braces(f"kernel void compute({', '.join(parameters)})"):
            self.lines.add("const int rhi_item = (int)get_local_id(0);")
            for memory in self.code.memories:
                if memory.space is AddressSpace.SHARED:
                    self.lines.add(f"local uint {self.name(memory)}[{memory.length}];")
            self.body()
        return self.finish()

    def body(self) -> None:
        """Write the body of the stage."""
        self.block(self.code.block)
        if self.native is not None:
            for number, line in enumerate(self.native.body.splitlines()):
                first = self.native.line
                self.lines.add(line, self.native_file if first else "", first + number if first else 0)

    def finish(self) -> StageText:
        """Return the written text, preceded by the functions that it calls."""
        head = self.head()
        lines = [*head, *self.lines.text]
        if self.code.checked:  # __LINE__ would count the text that a rasteriser inserts before this one
            lines = [line.replace("RHI_HERE", str(number)) for number, line in enumerate(lines, 1)]
        text = "\n".join(lines) + "\n"
        origins = (("", 0),) * len(head) + tuple(self.lines.origins)
        return StageText(text, origins, generated=self.native is None)

    def head(self) -> list[str]:
        body = "\n".join(self.lines.text)
        texts = [f"// {self.code.name}, {self.width} lanes", prelude.SCALAR_SELECT]
        if self.width > 1:
            texts += [prelude.any_text(self.width), prelude.lanes_text(self.width)]
            texts += [
                prelude.gather_text(space, self.width) for space in ("global", "local", "constant", "private")
            ]
            texts.append(prelude.last_text(self.width))
            texts += [prelude.QUADS] if any(name in body for name in prelude.QUAD_NAMES) else []
        textures = textures_text(self.width, self.textures, self.precision) if self.textures else ""
        called = prelude.functions_in(body + textures)
        texts += [prelude.function_text(name, self.width, body.count(f"{name}(")) for name in called]
        texts += [textures] * bool(textures)
        for memory in self.code.memories:
            if memory.space is AddressSpace.CONSTANT:
                words = ", ".join(self.word(memory.kind, value) for value in memory.values)
                texts.append(f"constant uint {self.name(memory)}[{memory.length}] = {{{words}}};")
        if self.native is not None:
            texts.append(self.native.declarations)
        return "\n".join([*texts, *self.helpers.values()]).split("\n")

    def word(self, kind: ScalarType, value: float) -> str:
        if kind is FLOAT:
            return f"0x{struct.unpack('<I', struct.pack('<f', value))[0]:08x}u"
        return f"{int(value) & 0xFFFFFFFF}u"

    def parameters(self, binding: Binding) -> list[str]:
        if binding.kind is BindingKind.UNIFORM:
            return [f"{self.uniform_space} uint *{binding.name}_"]
        if binding.kind is BindingKind.STORAGE:
            access = "global uint *" if binding.writes else "global const uint *restrict "
            return [f"{access}{binding.name}_", f"int {binding.name}__count"]
        access = "global uchar *" if binding.kind is BindingKind.IMAGE else "global const uchar *"
        return [f"{access}{binding.name}_", f"global const int *{binding.name}__words"]

    # -- types and values

    def type(self, kind: ScalarType, vector: bool) -> str:
        return _NAMES[kind] + (self.suffix if vector else "")

    def is_vector(self, value: Value) -> bool:
        return value.uniformity is Uniformity.VARYING and self.width > 1

    def wide(self, value: Value, vector: bool = True) -> str:
        """Return a value as an expression, as a vector unless `vector` is false."""
        text = self.value(value)
        if not vector or self.is_vector(value) or self.width == 1:
            return text
        if value.kind is BOOL:
            text = f"-({text})"
        return f"({self.type(value.kind, True)})({text})"

    def value(self, node: Value) -> str:
        """Return a value as an expression that needs no parentheses."""
        match node:
            case Literal():
                return self.literal(node)
            case lanes.Get(variable=variable):
                return variable.name
            case lanes.Argument():
                return self.argument(node)
            case Affine(kind=kind, base=base, stride=stride):
                steps = self.steps or "RHI_LANES"
                steps = steps if stride == 1 else f"{steps} * {stride}"
                text = f"({self.bits(base, False)} + as_uint{self.width}({steps}))"
                return self.cast(kind, True, text)
            case lanes.ElementCount(memory=memory):
                return f"{self.name(memory)}_count"
            case lanes.Input(index=lanes.DispatchIndex.ITEM):
                return "rhi_item"
            case lanes.Input(index=dispatch_index, axis=axis):
                function = (
                    "get_group_id" if dispatch_index is lanes.DispatchIndex.GROUP_ID else "get_num_groups"
                )
                return f"((int){function}({axis}))"
            case lanes.Apply():
                return self.apply(node)
            case lanes.Load():
                return self.load(node)
        raise TypeError(f"no OpenCL C for {node}")

    def argument(self, node: lanes.Argument) -> str:
        """Return the expression of an argument that the caller passes."""
        return node.name

    def literal(self, node: Literal) -> str:
        value = node.value
        if node.kind is BOOL:
            return "1" if value else "0"
        if node.kind is UINT:
            return f"{int(value) & 0xFFFFFFFF}u"
        if node.kind is INT:
            return (
                "((int)0x80000000)"
                if value == -(2**31)
                else f"({int(value)})"
                if value < 0
                else str(int(value))
            )
        number = float(value)
        if math.isnan(number):
            return "NAN"
        if abs(number) > 3.4028235677973366e38:
            return "INFINITY" if number > 0 else "(-INFINITY)"
        text = repr(number)
        text = text if "." in text or "e" in text else f"{text}.0"
        return f"{text}f" if math.copysign(1.0, number) > 0 else f"({text}f)"

    def apply(self, node: lanes.Apply) -> str:
        if self.precision is Precision.FAST and node.operation == "pow":
            base, exponent = node.arguments
            if isinstance(exponent, Literal) and exponent.value in range(1, _LARGEST_POWER + 1):
                return self.whole_power(base, int(exponent.value))
        row, vector = spelling(node.operation, self.precision), self.is_vector(node)
        template = row.vector if vector and row.vector else row.opencl
        if node.kind is INT and node.operation in _WRAPPING:
            words = [self.bits(argument, self.is_vector(argument)) for argument in node.arguments]
            return self.cast(INT, vector, template.format(*words))
        texts = [
            self.wide(argument, vector and (not row.infix or argument.kind is BOOL))
            for argument in node.arguments
        ]
        return template.format(*texts, type=self.type(node.kind, vector))

    def whole_power(self, base: Value, exponent: int) -> str:
        """Return a power by repeated squaring, from the exponent's highest bit down."""
        name = f"rhi_power_{exponent}"
        type = self.type(FLOAT, self.is_vector(base))
        head = f"inline __attribute__((overloadable, always_inline)) {type} {name}({type} x)"
        self.helper(f"{name} {type}", f"{head} {{ {type} r = x; {power_steps(exponent)} return r; }}")
        return f"{name}({self.value(base)})"

    # -- memory

    def name(self, memory: MemoryRegion) -> str:
        """Return the name of memory; a name from the shader's class gets a "_", since C has names like
        `signed`."""
        named = memory.space not in (AddressSpace.PRIVATE, AddressSpace.CONSTANT)
        return f"{memory.name}_" if named else memory.name

    def pointer(self, memory: MemoryRegion) -> str:
        if memory.space is AddressSpace.PRIVATE:
            return f"(private uint *){self.name(memory)}"
        return self.name(memory)

    def words(self, memory: MemoryRegion) -> str:
        if memory.space is AddressSpace.STORAGE:
            return (
                f"{self.name(memory)}_count * {memory.stride}"
                if memory.stride > 1
                else f"{self.name(memory)}_count"
            )
        return str(memory.length)

    def address(self, index: Value, scale: int, offset: int) -> Value:
        return index * number(scale) + number(offset)

    def cast(self, kind: ScalarType, vector: bool, text: str) -> str:
        if kind is UINT:
            return text
        return f"as_{self.type(kind, vector)}({text})"

    def load(self, node: lanes.Load) -> str:
        memory, index = node.memory, node.index
        if memory.space is AddressSpace.PRIVATE:
            return self.load_private(node)
        if not self.is_vector(index):
            return self.cast(
                node.kind,
                False,
                f"{self.name(memory)}[{self.value(self.address(index, node.scale, node.offset))}]",
            )
        space = _SPACES[memory.space]
        if isinstance(index, Affine) and memory.space in (AddressSpace.STORAGE, AddressSpace.SHARED):
            stride, scale = index.stride * node.scale, node.scale
            if 0 < stride <= _LONGEST_STRIDE:
                first, offset = index.base, node.offset
                if node.limit is not None:
                    count = self.value(node.limit)
                else:
                    first, scale, count = first * number(scale), 1, self.words(memory)
                    if offset >= stride:
                        first, offset = first + number(offset), 0
                name = f"rhi_load_{space}_{stride}_{offset}" + (f"_of_{scale}" if scale > 1 else "")
                self.helper(
                    name, prelude.load_text(name, space, self.width, stride, offset, scale, bool(self.steps))
                )
                steps = f", {self.steps}" if self.steps else ""
                text = f"{name}({self.name(memory)}, {self.value(first)}, {count}{steps})"
                return self.cast(node.kind, True, text)
        if node.limit is not None:
            index = apply("max", apply("min", index, node.limit - number(1)), number(0))
        address = self.wide(self.address(index, node.scale, node.offset))
        if node.mask is not None:
            address = f"{address} & {self.mask(node.mask)}"
        return self.cast(node.kind, True, f"rhi_gather({self.name(memory)}, {address})")

    def load_private(self, node: lanes.Load) -> str:
        memory, index = node.memory, node.index
        if not self.is_vector(index):
            return f"{self.name(memory)}[{self.value(index)}]"
        address = self.wide(index)
        if node.mask is not None:
            address = f"({address} & {self.mask(node.mask)})"
        varying = memory.uniformity is Uniformity.VARYING
        if varying:
            address = f"{address} * {self.width} + RHI_LANES"
        text = self.cast(node.kind, True, f"rhi_gather({self.pointer(memory)}, {address})")
        return text if varying or node.kind is not BOOL else f"(-{text})"

    def mask(self, mask: lanes.Variable | None) -> str:
        return mask.name if mask is not None else f"(int{self.width})(-1)"

    def helper(self, name: str, text: str) -> None:
        self.helpers.setdefault(name, text)

    # -- statements

    def block(self, block: lanes.Block) -> None:
        for statement in block:
            self.statement(statement)

    def add(self, node: lanes.Statement, text: str) -> None:
        self.lines.add(text, *node.line)

    def statement(self, node: lanes.Statement) -> None:
        match node:
            case lanes.Let(variable=variable, value=value):
                vector = variable.uniformity is Uniformity.VARYING
                name = f"{self.type(variable.kind, vector)} {variable.name}"
                text = self.wide(value, vector) if value is not None else "0"
                self.add(node, f"{name} = {text};")
            case lanes.DeclareMemory(memory=memory, zeros=zeros):
                self.begin(node, memory, zeros)
            case lanes.Set():
                self.add(node, f"{self.set(node)};")
            case lanes.Store():
                self.store(node)
            case lanes.Atomic():
                self.atomic(node)
            case lanes.TextureAccess():
                self.texture(node)
            case lanes.Barrier(waits=waits):
                word = "barrier" if waits else "mem_fence"
                self.add(node, f"{word}(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);")
            case lanes.Check(wrong=wrong, value=checked, limit=limit, mask=mask):
                self.check(node, wrong, checked, limit, mask)
            case lanes.If():
                self.if_(node)
            case lanes.Loop(body=body, advance=advance):
                steps = ", ".join(self.set(step) for step in advance if isinstance(step, lanes.Set))
                with self.lines.braces(f"for (;; {steps})", *node.line):
                    self.block(body)
            case lanes.Break(when_empty=mask):
                self.jump(node, "break", mask)
            case lanes.Continue(when_empty=mask):
                self.jump(node, "continue", mask)
            case lanes.Return(call=body, when_empty=mask):
                self.jump(node, f"goto end_{body.label}", mask)
            case lanes.InlinedCall(label=label, block=inner, returns_early=returns_early):
                with self.lines.braces("", *node.line):
                    self.block(inner)
                    if returns_early:
                        self.add(node, f"end_{label}: ;")
            case _:
                raise TypeError(f"no OpenCL C for {node}")

    def check(
        self, node: lanes.Statement, wrong: Value, value: Value, limit: Value, mask: lanes.Variable | None
    ) -> None:
        """Write a check that records its line number in the text, which the host maps to the line in
        Python."""
        bad = self.wide(wrong) if mask is None else f"{self.wide(wrong)} & {self.mask(mask)}"
        self.add(node, f"rhi_check({bad}, {self.wide(value)}, {self.value(limit)}, rhi_faults, RHI_HERE);")

    def begin(self, node: lanes.Statement, memory: MemoryRegion, zeros: bool) -> None:
        vector = memory.uniformity is Uniformity.VARYING
        self.add(node, f"{self.type(memory.kind, vector)} {self.name(memory)}[{memory.length}];")
        if zeros:
            fill = f"{self.name(memory)}[i] = 0"
            self.add(node, f"for (int i = 0; i < {memory.length}; i++) {fill};")

    def set(self, node: lanes.Set) -> str:
        variable = node.variable
        text = self.wide(node.value, variable.uniformity is Uniformity.VARYING)
        if node.mask is not None:
            text = f"select({variable.name}, {text}, {node.mask.name})"
        return f"{variable.name} = {text}"

    def jump(self, node: lanes.Statement, text: str, mask: lanes.Variable | None) -> None:
        condition = f"if (!rhi_any({mask.name})) " if mask is not None else ""
        self.add(node, f"{condition}{text};")

    def if_(self, node: lanes.If) -> None:
        condition = self.value(node.condition)
        condition = f"rhi_any({condition})" if node.any_lane else condition
        with self.lines.braces(f"if ({condition})", *node.line):
            self.block(node.then)
        if node.otherwise:
            with self.lines.braces("else", *node.line):
                self.block(node.otherwise)

    def bits(self, value: Value, vector: bool) -> str:
        text = self.wide(value, vector)
        return text if value.kind is UINT else f"as_{self.type(UINT, vector)}({text})"

    def store(self, node: lanes.Store) -> None:
        memory, index = node.memory, node.index
        if memory.space is AddressSpace.PRIVATE:
            self.store_private(node)
            return
        if not self.is_vector(index):
            self.store_scalar(node)
            return
        space, count = _SPACES[memory.space], len(node.values)
        values = [self.bits(value, True) for value in node.values]
        mask = self.mask(node.mask)
        if isinstance(index, Affine) and index.stride * node.scale == count + node.padding and not self.steps:
            values += [f"(uint{self.width})(0)"] * node.padding
            name = f"rhi_store_{space}_{len(values)}"
            self.helper(name, prelude.store_text(name, space, self.width, len(values)))
            first = self.value(self.address(index.base, node.scale, node.offset))
            self.add(node, f"{name}({self.name(memory)}, {first}, {mask}, {', '.join(values)});")
            return
        name = f"rhi_scatter_{space}_{count}"
        self.helper(name, prelude.scatter_text(name, space, self.width, count))
        address = self.wide(self.address(index, node.scale, node.offset))
        self.add(node, f"{name}({self.name(memory)}, {address}, {mask}, {', '.join(values)});")

    def store_scalar(self, node: lanes.Store) -> None:
        """Write a store of all lanes to one address; the last active lane wins."""
        sets = []
        for k, value in enumerate(node.values):
            text = self.bits(value, self.is_vector(value))
            if self.is_vector(value):
                text = f"rhi_last({text}, {self.mask(node.mask)})"
            address = self.value(self.address(node.index, node.scale, node.offset + k))
            sets.append(f"{self.name(node.memory)}[{address}] = {text};")
        if node.mask is None:
            self.add(node, " ".join(sets))
        else:
            self.add(node, f"if (rhi_any({node.mask.name})) {{ {' '.join(sets)} }}")

    def store_private(self, node: lanes.Store) -> None:
        memory, index, (value,) = node.memory, node.index, node.values
        vector = memory.uniformity is Uniformity.VARYING
        if not self.is_vector(index):
            element = f"{self.name(memory)}[{self.value(index)}]"
            text = self.wide(value, vector)
            if node.mask is not None and self.width > 1:
                text = f"select({element}, {text}, {node.mask.name})"
            self.add(node, f"{element} = {text};")
            return
        name = "rhi_scatter_private_1"
        self.helper(name, prelude.scatter_text(name, "private", self.width, 1))
        address = f"{self.wide(index)} * {self.width} + RHI_LANES"
        bits = self.bits(value, True)
        self.add(node, f"{name}({self.pointer(memory)}, {address}, {self.mask(node.mask)}, {bits});")

    def atomic(self, node: lanes.Atomic) -> None:
        memory, space, kind = node.memory, _SPACES[node.memory.space], _NAMES[node.kind]
        operation = _ATOMICS.get(node.operation, node.operation)
        address = self.address(node.index, node.scale, node.offset)
        result = (
            f"{self.type(node.kind, self.width > 1)} {node.result.name} = " if node.result is not None else ""
        )
        if self.width == 1:
            values = ", ".join(self.value(value) for value in node.values)
            pointer = f"(volatile {space} {kind} *){self.name(memory)} + {self.value(address)}"
            self.add(node, f"{result}atomic_{operation}({pointer}, {values});")
            return
        values = ", ".join(self.wide(value) for value in node.values)
        mask = self.mask(node.mask)
        if operation == "add" and not self.is_vector(address):
            name = f"rhi_atomic_add_all_{space}_{kind}"
            self.helper(name, prelude.atomic_add_text(name, space, self.width, kind))
            target = self.value(address)
        else:
            name = f"rhi_atomic_{operation}_{space}_{kind}"
            self.helper(name, prelude.atomic_text(name, space, self.width, operation, kind))
            target = self.wide(address)
        call = f"{name}({self.name(memory)}, {target}, {mask}, {values});"
        self.add(node, result + call)

    def texture(self, node: lanes.TextureAccess) -> None:
        """Write a call of the function in `textures.cl` that has the operation's name.

        Functions that read texels exist for vectors only: a uniform result is that of the first lane.
        """
        operation, name, results = node.operation, node.memory.name, node.results
        self.textures.add(node.memory.shape)
        is_wide = self.width > 1
        varies = is_wide and bool(results) and results[0].uniformity is Uniformity.VARYING
        first = ".s0" if is_wide and not varies else ""
        texts = [self.wide(value, is_wide) for value in node.arguments]
        if operation in ("size", "levels"):
            texts = [self.wide(value, varies) for value in node.arguments]
            function, first = f"rhi_{operation}{'_each' * varies}", ""
        elif operation == "store":
            mask, values = self.mask(node.mask) if is_wide else "1", node.arguments[3:]
            texts = [*texts[:3], *(self.bits(value, is_wide) for value in values)]
            self.add(node, f"rhi_store({name}_, {mask}, {name}__words, {', '.join(texts)});")
            return
        elif operation == "load" and self.is_vector(node.arguments[-1]):
            function = "rhi_load_each"
        else:
            function, scalar = f"rhi_{operation}", {"gather": 0, "load": 3}.get(operation)
            if scalar is not None:
                texts[scalar] = self.value(node.arguments[scalar])
        arguments = ", ".join([f"{name}__words", *texts])
        if operation in ("size", "levels"):
            axes = [f", {axis}" if operation == "size" else "" for axis in range(len(results))]
            words = [f"{function}({arguments}{axis}){first}" for axis in axes]
        else:
            kind, whole = self.type(UINT, is_wide), f"{results[0].name}_words"
            self.add(node, f"{kind} {whole}[4]; {function}({name}_, {arguments}, {whole});")
            words = [
                self.cast(result.kind, varies, f"{whole}[{i}]{first}") for i, result in enumerate(results)
            ]
        for result, word in zip(results, words, strict=True):
            self.add(node, f"{self.type(result.kind, varies)} {result.name} = {word};")
