"""GLSL 4.30 from the typed tree: types, literals, declarations, built-ins.

Rows of matrices come first in memory. Where a buffer is only read, they are declared as the columns of the
transpose, which is transposed where it is read: compilers load a column at once, and a row number by number.
On llvmpipe a vertex that reads two 3×3 matrices takes half the time so. Native code sees matrices as they
are, so its stages have rows.
"""

from __future__ import annotations

import math
from typing import Final

from rhi.contract import layout
from rhi.contract.descriptors import TextureKind
from rhi.shading.glsl.precise import precise_locals, store_values
from rhi.shading.ir import tree
from rhi.shading.ir.tree import Expression, Operator
from rhi.shading.language.builtins import SideEffect
from rhi.shading.language.source import SourceSpan
from rhi.shading.language.types import ImageType, TextureType, Type, VoidType, scalar_of
from rhi.shading.text.names import Names
from rhi.shading.text.text_writer import TextWriter, int_text, is_plain, is_positive, unknown_indices

_SHAPES: Final = {"2d": "2D", "2d_array": "2DArray", "3d": "3D", "cube": "Cube"}
_PREFIX: Final = {layout.FLOAT: "", layout.INT: "i", layout.UINT: "u"}
_LAYER: Final = "vec3 rhi_layer(vec3 at) { return vec3(at.xy, clamp(floor(at.z + 0.5), 0.0, 65535.0)); }"
_LEVELS: Final = {"sample_bias": 2, "sample_lod": 2, "sample_compare_lod": 3}
"""The argument of a texture's method that is a level of detail, or is added to it."""
_CONVERSIONS: Final = {
    layout.INT: "int rhi_to_int(float x) { return x >= 2147483648.0 ? 2147483647 : x > -2147483648.0 ? int(x) : "
    "isnan(x) ? 0 : (-2147483647 - 1); }",
    layout.UINT: "uint rhi_to_uint(float x) { return x >= 4294967296.0 ? 4294967295u : x > 0.0 ? uint(x) : 0u; }",
}
_FIELDS: Final = {
    "bitfield_extract": "TYPE v, int at, int bits) { uint start = min(uint(at), 32u); "
    "return bitfieldExtract(v, int(start & 31u), int(min(uint(bits), 32u - start))); }",
    "bitfield_insert": "TYPE v, TYPE w, int at, int bits) { uint start = min(uint(at), 32u); "
    "return bitfieldInsert(v, w, int(start & 31u), int(min(uint(bits), 32u - start))); }",
}
"""Parameters and bodies of the functions for bit fields. GLSL defines the result only for fields inside a
word."""
_LONGEST_LIST: Final = 32
"""Arrays of zeros up to this length are initialised with a list, longer ones in a loop."""


class Writer(TextWriter):
    """Writer of the functions of one stage."""

    language = "glsl"
    precise_parameters = True
    """Whether parameters may be `precise`, so that what a call computes for them is exact."""

    def __init__(self, names: Names) -> None:
        super().__init__(names)
        self.by_columns: set[str] = set()  # storage buffers whose matrices are declared as their transposes
        self.exact = False  # whether each operation of floats is rounded by itself
        self._precise: set[tree.Local] = set()  # the variables of the current function that say so

    def expression(self, node: Expression) -> str:
        """Return an expression as text that needs no parentheses around it."""
        root = tree.root_of(node)
        if not (isinstance(root, tree.BindingRead) and root.declaration.name in self.by_columns):
            return super().expression(node)
        text = self.path(node)
        match node.type:
            case layout.MatrixType():
                return f"transpose({text})"
            case layout.StructType(fields=fields):
                names = [
                    self.field(node.type, field.name)
                    for field in fields
                    if isinstance(field.type, layout.MatrixType)
                ]
                body = " ".join(f"x.{name} = transpose(x.{name});" for name in names)
                return f"{self.helper('rhi_rows', self.type(node.type), 'x', f'{body} return x;')}({text})"
        return text

    def path(self, node: Expression) -> str:
        """Return the path to a part of a binding, a local or a value."""
        match node:
            case tree.Member(base=base, name=name):
                return f"{self.path(base)}.{self.member(base, name)}"
            case tree.Index(base=base):
                return f"{self.path(base)}[{self.index_text(node)}]"
        return super().expression(node)

    def type(self, type: Type) -> str:
        """Return a type's GLSL name."""
        match type:
            case VoidType():
                return "void"
            case layout.StructType(name=name):
                return self.globals.get(type, name)
            case layout.ArrayType():
                lengths = ""
                element: layout.HostType = type
                while isinstance(element, layout.ArrayType):
                    lengths += f"[{element.length}]"
                    element = element.element
                return self.type(element) + lengths
            case TextureType(kind=kind, scalar=scalar, compare=compare, samples=samples):
                end = "Shadow" if compare else "MS" if samples else ""
                return f"{_PREFIX[scalar]}sampler{_SHAPES[kind.value]}{end}"
            case ImageType(kind=kind):
                return f"{_PREFIX[type.scalar]}image{_SHAPES[kind.value]}"
        return str(type)

    def zero(self, type: layout.HostType) -> str:
        """Return a value of this type whose components are all zero."""
        match type:
            case layout.ScalarType():
                return {"bool": "false", "int": "0", "uint": "0u", "float": "0.0"}[type.name]
            case layout.VectorType() | layout.MatrixType():
                return f"{type}({self.zero(scalar_of(type) or layout.FLOAT)})"
            case layout.ArrayType(element=element, length=length):
                return f"{self.type(type)}({', '.join([self.zero(element)] * length)})"
            case layout.StructType(fields=fields):
                return f"{self.type(type)}({', '.join(self.zero(field.type) for field in fields)})"

    def builtin(self, node: tree.BuiltinCall) -> str:
        """Return a call of a built-in."""
        overload, arguments, name = node.overload, node.arguments, node.builtin.name
        unknown = unknown_indices(arguments[0]) if node.builtin.effect is SideEffect.WRITE else []
        if unknown and name.startswith("atomic_"):
            return self.atomic(node, unknown)
        texts = [self.expression(argument) for argument in arguments]
        if arguments and isinstance(arguments[0].type, TextureType):
            self.bound_sample(node, texts)
        if name in _FIELDS:
            type = self.type(node.type)
            self.helpers[f"{name} {type}"] = f"{type} rhi_{name}({_FIELDS[name].replace('TYPE', type)}"
            return f"rhi_{name}({', '.join(texts)})"
        if name == "pow":
            return self.float_power(node.type, texts[0], texts[1], arguments[1])
        if name == "atan2":
            return f"{self.angle(node.type)}({', '.join(texts)})"
        if overload.glsl == "transpose" and isinstance(arguments[0], tree.Construct):
            return self.columns(arguments[0])
        if not overload.glsl.isidentifier() or overload.glsl.startswith("gl_"):
            return overload.glsl.format(*texts)
        return f"{overload.glsl}({', '.join(texts)})"

    def bound_sample(self, node: tree.BuiltinCall, texts: list[str]) -> None:
        """Bound what drivers convert to integers when they sample: the layer of a position, and the level of
        detail.

        They round layers as they like, and llvmpipe takes the first layer or level for numbers beyond 2³¹.
        """
        name, type = node.builtin.name, node.arguments[0].type
        if not name.startswith(("sample", "gather")):
            return
        if isinstance(type, TextureType) and type.kind is TextureKind.D2_ARRAY:
            self.helpers["rhi_layer"] = _LAYER
            texts[1] = f"rhi_layer({texts[1]})"
        if name == "sample_grad":
            texts[2:4] = (f"clamp({text}, -1e9, 1e9)" for text in texts[2:4])
        level = _LEVELS.get(name)
        if level is not None and not isinstance(node.arguments[level], tree.Constant):
            texts[level] = f"min({texts[level]}, 1000.0)"

    def atomic(self, node: tree.BuiltinCall, unknown: list[tree.Index]) -> str:
        """Return a call of an atomic under the condition that its indices are inside, else 0.

        Values that are evaluated once, also where an index is outside, are stored in variables outside all
        functions."""
        before, conditions, texts = "", [], []
        for index_node in unknown:
            index = self.expression(index_node.index)
            self.hoisted[index_node] = index if is_plain(index_node.index) else self.outside(index_node.index)
            index_text = index if is_plain(index_node.index) else f"{self.hoisted[index_node]} = {index}"
            conditions.append(self.bounds_test(index_node, index_text))
        for argument in node.arguments[1:]:
            text = self.expression(argument)
            if tree.has_effect(argument):
                name = self.outside(argument)
                before, text = f"{before}{name} = {text}, ", name
            texts.append(text)
        call = f"{node.overload.glsl}({', '.join([self.expression(node.arguments[0]), *texts])})"
        for index_node in unknown:
            del self.hoisted[index_node]
        return f"({before}{' && '.join(conditions)} ? {call} : {self.zero(node.type)})"  # type: ignore[arg-type]

    def outside(self, node: Expression) -> str:
        """Declare a variable of an expression's type outside all functions, and return its name."""
        name = self.names.get_outer((node, "hoisted"), "rhi_hoisted")
        self.helpers[name] = f"{self.type(node.type)} {name};"
        return name

    def conversion(self, type: Type, source: Type) -> str:
        scalar = scalar_of(type)
        assert scalar is not None
        name = f"rhi_to_{scalar}"
        self.helpers[name] = _CONVERSIONS[scalar]
        if isinstance(type, layout.VectorType):
            parts = ", ".join(f"{name}(x.{axis})" for axis in "xyzw"[: type.size])
            self.helpers[f"{name}({type})"] = f"{type} {name}({source} x) {{ return {type}({parts}); }}"
        return name

    def texture(self, node: tree.Read | tree.BindingRead) -> str:
        """Return the text of a texture as an argument of a built-in."""
        if isinstance(node, tree.Read):
            return self.names.get(node.local, node.local.name)
        return self.globals.get(("binding", node.declaration.name), node.declaration.name)

    def parameter(self, local: tree.Local) -> str:
        """Return a parameter's declaration."""
        is_precise = self.exact and self.precise_parameters and scalar_of(local.type) is layout.FLOAT
        precise = "precise " if is_precise else ""
        return f"{precise}{self.type(local.type)} {self.names.get(local, local.name)}"

    def prepare(self, node: tree.Function) -> tree.Block:
        """Return the statements to write for a function, and note which variables are precise."""
        body = store_values(node.body) if self.exact else node.body
        self._precise = precise_locals(body) if self.exact else set()
        return body

    def local_type(self, local: tree.Local) -> str:
        """Return the type of a local variable, with qualifiers."""
        return f"{'precise ' if local in self._precise else ''}{self.type(local.type)}"

    def constant(self, node: tree.Constant) -> str:
        """Return a scalar literal."""
        value = node.value
        if node.type is layout.BOOL:
            return "true" if value else "false"
        if node.type is layout.UINT:
            return f"{int(value)}u"
        if node.type is layout.INT:
            return int_text(int(value))
        number = float(value)
        if math.isnan(number):
            return "uintBitsToFloat(0x7FC00000u)"
        if math.isinf(number) or abs(number) > 3.4028235677973366e38:
            return f"uintBitsToFloat({'0x7F800000u' if number > 0 else '0xFF800000u'})"
        text = repr(number)
        return text if math.copysign(1.0, number) > 0 else f"({text})"

    def float_power(self, type: Type, base: str, text: str, exponent: Expression) -> str:
        """Return a power, which GLSL leaves open for a base of 0 and an exponent up to 0."""
        if is_positive(exponent):
            return f"pow({base}, {text})"
        body = "return y == 0.0 ? 1.0 : x == 0.0 && y < 0.0 ? uintBitsToFloat(0x7F800000u) : pow(x, y);"
        name = self.helper("rhi_pow", "float", "x y", body)
        return f"{self.of_components(name, type, 'x y')}({base}, {text})"

    def of_components(self, name: str, type: Type, parameters: str) -> str:
        """Return the name of a helper of floats, or of one that calls it for each component of vectors."""
        if isinstance(type, layout.VectorType):
            calls = (
                f"{name}({', '.join(f'{parameter}.{axis}' for parameter in parameters.split())})"
                for axis in "xyzw"[: type.size]
            )
            self.helper(name, self.type(type), parameters, f"return {self.type(type)}({', '.join(calls)});")
        return name

    def angle(self, type: Type) -> str:
        """Return the name of the function that computes the angle of (y, x), as C does for two zeros."""
        body = (
            "return x == 0.0 && y == 0.0 ? uintBitsToFloat((floatBitsToUint(y) & 0x80000000u) | "
            "(floatBitsToUint(x) >> 31) * 0x40490FDBu) : atan(y, x);"
        )
        name = self.helper("rhi_atan2", "float", "y x", body)
        return self.of_components(name, type, "y x")

    def integer_helper(self, node: tree.Binary, divide: bool) -> str:
        name = "rhi_floor_divide" if divide else "rhi_modulo"
        type = self.type(node.type)
        zero = self.zero(node.type)  # type: ignore[arg-type]
        if isinstance(node.type, layout.ScalarType):
            # However `/` rounds negative operands, |r| < |b| holds, and r's sign tells whether to correct the
            # result.
            wrong = "r != 0 && (r < 0) != (b < 0)"
            result = f"{wrong} ? q - 1 : q" if divide else f"{wrong} ? r + b : r"
        else:
            wrong = (
                f"{type}(notEqual(r, {zero})) * {type}(notEqual(lessThan(r, {zero}), lessThan(b, {zero})))"
            )
            result = f"q - {wrong}" if divide else f"r + b * {wrong}"
        # A division by 0 is one by 1, and so is that of the least int by -1.
        least = "a == (-2147483647 - 1)"
        divisor = f"if (b == 0 || (b == -1 && {least})) b = 1;"
        if not isinstance(node.type, layout.ScalarType):
            least = f"{type}(equal(b, {type}(-1))) * {type}(equal(a, {type}(-2147483647 - 1)))"
            divisor = f"b += {type}(equal(b, {zero})) + 2 * {least};"
        body = f"{divisor} {type} q = a / b; {type} r = a - q * b; return {result};"
        return self.helper(name, type, "a b", body)

    def float_modulo(self, node: tree.Binary, left: str, right: str) -> str:
        """Return `%` of floats. GLSL's mod is x - y floor(x / y), which has the sign of y as in Python."""
        if isinstance(node.left.type, layout.ScalarType) and isinstance(node.type, layout.VectorType):
            left = f"{node.type}({left})"
        return f"mod({left}, {right})"

    def store(self, target: Expression, value: str, span: SourceSpan) -> None:
        """Write the assignment of a value."""
        match target:
            case tree.Index(base=tree.Index(base=matrix) as row, index=column) if (
                isinstance(matrix.type, layout.MatrixType)
                and _is_bound(matrix)
                and not isinstance(column, tree.Constant)
            ):
                # NVIDIA's compiler refuses to store through an unknown column of a matrix in memory.
                with self.lines.braces(f"switch ({self.index_text(target)})", self.file, span.line):
                    for i in range(matrix.type.size):
                        element = f"{self.expression(matrix)}[{i}][{self.index_text(row)}]"
                        self.line(f"case {i}: {element} = {value}; break;", span)
            case _:
                super().store(target, value, span)

    def declare(self, local: tree.Local, value: Expression | None, span: SourceSpan) -> None:
        """Write the declaration of a local variable."""
        name, type = self.names.get(local, local.name), self.local_type(local)
        if (
            isinstance(value, tree.Zeros)
            and isinstance(local.type, layout.ArrayType)
            and local.type.length > _LONGEST_LIST
        ):
            self.line(f"{type} {name};", span)
            index = self.names.get((local, "zero"), f"{name}_index")
            zero = self.zero(local.type.element)
            loop = f"for (int {index} = 0; {index} < {local.type.length}; {index}++)"
            self.line(f"{loop} {name}[{index}] = {zero};", span)
        else:
            super().declare(local, value, span)

    def variable(self, type: str, name: str, value: str = "") -> str:
        return f"{type} {name} = {value}" if value else f"{type} {name}"

    def header(self, node: tree.Function) -> str:
        parameters = ", ".join(map(self.parameter, node.parameters))
        return f"{self.type(node.result)} {self.globals.get(node, node.name)}({parameters})"

    def helper(self, name: str, type: str, parameters: str, body: str) -> str:
        declarations = ", ".join(f"{type} {parameter}" for parameter in parameters.split())
        self.helpers[f"{name}({type})"] = f"{type} {name}({declarations}) {{ {body} }}"
        return name

    def choice(self, condition: str, then: str, otherwise: str) -> str:
        return f"{condition} ? {then} : {otherwise}"

    def length(self, base: str) -> str:
        return f"int({base}.length())"

    def operation(self, node: tree.Binary, left: str) -> str:
        are_matrices = isinstance(node.type, layout.MatrixType) and node.left.type == node.right.type
        if are_matrices and node.operator is Operator.MULTIPLY:
            return f"matrixCompMult({left}, {self.expression(node.right)})"
        return super().operation(node, left)


def has_plain_matrices(type: layout.HostType) -> bool:
    """Return whether a type is a matrix, or a struct with matrices as fields but none in arrays or nested
    structs."""
    if isinstance(type, layout.StructType):
        kinds = [field.type for field in type.fields]
        nested = any(isinstance(kind, layout.ArrayType | layout.StructType) for kind in kinds)
        return any(isinstance(kind, layout.MatrixType) for kind in kinds) and not nested
    return isinstance(type, layout.MatrixType)


def _is_bound(node: tree.Expression) -> bool:
    """Return whether an lvalue is a part of a binding or of shared memory."""
    return isinstance(tree.root_of(node), tree.BindingRead)
