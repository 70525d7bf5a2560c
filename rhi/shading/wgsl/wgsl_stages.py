"""A complete stage in WGSL: declarations, functions, and the entry point `main`.

- Bindings have a group for each kind, as in `rhi.shading.glsl.vulkan`: slot n of a texture is the texture at
  binding 2n and its sampler at 2n + 1. `read_declarations` finds them in a text.
- WebGPU lacks viewports whose near depth is beyond the far one, and the alpha test. Both are constants that a
  pipeline overrides: `rhi_reversed` in vertex stages; `rhi_alpha_test`, a number of `ALPHA_TESTS`, and
  `rhi_alpha_reference` in fragment stages that write alpha.
"""

from __future__ import annotations

import re
from typing import Final

from rhi.contract.descriptors import BindingKind, FragmentOutput, Stage, StageText
from rhi.contract.layout import INT, UINT, HostType, MatrixType, StructType
from rhi.contract.states import AlphaFunction
from rhi.shading.glsl.vulkan import SETS
from rhi.shading.ir import tree
from rhi.shading.ir.interface import Interface, Varying
from rhi.shading.ir.text import Lines
from rhi.shading.language.annotations import Role
from rhi.shading.language.shader import Declaration, StorageClass
from rhi.shading.language.types import VOID, ImageType, StorageType, TextureType, scalar_of
from rhi.shading.text.names import Names
from rhi.shading.text.stage_names import name_bindings, name_structs
from rhi.shading.text.text_writer import constant_key, output_type
from rhi.shading.wgsl.wgsl_builtins import DERIVING_CALLS, EXTENSIONS, GROUP_INPUTS, INPUTS
from rhi.shading.wgsl.wgsl_memory import UNIFORM
from rhi.shading.wgsl.wgsl_names import RESERVED, texel_format
from rhi.shading.wgsl.wgsl_writer import SHAPES, WgslWriter, sampler_type

ALPHA_TESTS: Final = {
    AlphaFunction.NEVER: ("false", 0),
    AlphaFunction.LESS: ("a < b", 1),
    AlphaFunction.EQUAL: ("a == b", 2),
    AlphaFunction.LESS_EQUAL: ("a <= b", 3),
    AlphaFunction.GREATER: ("a > b", 4),
    AlphaFunction.NOT_EQUAL: ("a != b", 5),
    AlphaFunction.GREATER_EQUAL: ("a >= b", 6),
    AlphaFunction.ALWAYS: ("true", 7),
}
"""Alpha tests as conditions of the alpha a and the reference b, and their numbers in `rhi_alpha_test`."""

_DEPTH_REVERSAL: Final = """\
override rhi_reversed: bool = false;
fn rhi_clip_position(p: vec4<f32>) -> vec4<f32> { return select(p, vec4<f32>(p.xy, p.w - p.z, p.w), rhi_reversed); }"""
_ALPHA_TEST: Final = "\n".join(
    [
        "override rhi_alpha_test: u32 = 7u;",
        "override rhi_alpha_reference: f32 = 0.5;",
        "fn rhi_passes_alpha(a: f32) -> bool {",
        "    let b = rhi_alpha_reference;",
        *(
            f"    if (rhi_alpha_test == {number}u) {{ return {test}; }}"
            for test, number in ALPHA_TESTS.values()
        ),
        "    return true;",
        "}",
    ]
)
_ANY_FLOW: Final = "diagnostic(off, derivative_uniformity);"
"""Without it, compilers refuse differences and texture samples under conditions that may vary. As in GLSL, they are
allowed there, and undefined if a neighbouring fragment takes another path."""
_DIFFERENCES: Final = ("ddx", "ddy", "fwidth")
_ROLES: Final = {Role.FLAT: " @interpolate(flat)", Role.NO_PERSPECTIVE: " @interpolate(linear)"}
_DECLARATION: Final = re.compile(
    r"^@group\((\d)\) @binding\((\d+)\) var(?:<storage, (\w+)>)?([^;]*);", re.MULTILINE
)


def write_wgsl_stage(stage: tree.StageTree, interface: Interface) -> StageText:
    """Return the stage's complete source in WGSL.

    Raises:
        ShaderError: `shading-native`: the stage needs something that WGSL lacks.
    """
    return _WgslStageWriter(stage, interface).write()


def read_declarations(text: str) -> dict[tuple[int, int], str]:
    """Return the access to each binding that a text declares, by group and binding.

    It is "read", "write" or "read_write" for storage buffers and images, "" for other bindings."""
    declarations = {}
    for group, binding, access, rest in _DECLARATION.findall(text):
        image = re.search(r"texture_storage_\w+<\w+, (\w+)>", rest)
        declarations[int(group), int(binding)] = access or (image[1] if image else "")
    return declarations


def _needs_derivatives(stage: tree.StageTree) -> bool:
    """Return whether a stage computes differences between neighbouring fragments, or samples at their level."""
    return any(row.name in _DIFFERENCES for row in stage.builtins) or any(
        isinstance(node, tree.BuiltinCall)
        and bool(node.arguments)
        and isinstance(node.arguments[0].type, TextureType)
        and node.builtin.name in DERIVING_CALLS
        for function in stage.functions
        for node in tree.walk(function.body)
    )


class _WgslStageWriter:
    def __init__(self, stage: tree.StageTree, interface: Interface) -> None:
        self.stage = stage
        self.interface = interface
        self.names = Names(reserved=RESERVED)
        name_bindings(self.names, stage, interface)
        self.main_names = Names(self.names)
        self.writer = WgslWriter(self.names, stage, self._image_form)
        self.lines = Lines()
        self.inputs = sorted(row.name for row in stage.builtins if row.name in INPUTS)

    def write(self) -> StageText:
        stage, writer = self.stage, self.writer
        # Names of modules are assigned before those inside functions, which must not hide them.
        name_structs(self.names, stage, self.interface)
        for constant in stage.constants:
            writer.expression(constant)
        self.names.get_all({function: function.name for function in stage.functions})
        bindings = [self._binding(declaration) for declaration in stage.bindings]
        for function in stage.functions:
            writer.function(function)
        if "rhi_agree" in writer.helpers and "local_index" not in self.inputs:
            self.inputs = sorted([*self.inputs, "local_index"])
        add = self.lines.add
        for name in self.inputs:
            if name in EXTENSIONS:
                add(f"enable {name};")
        if stage.stage is Stage.FRAGMENT and _needs_derivatives(stage):
            add(_ANY_FLOW)
        add(f"// {self.interface.name}, {stage.stage.value} stage")
        for struct in stage.structs:
            with self.lines.braces(f"struct {writer.type(struct)}"):
                for field in struct.fields:
                    add(f"{writer.field(struct, field.name)}: {writer.type(field.type)},")
        for name, fields in writer.memory.structs.items():
            with self.lines.braces(f"struct {name}"):
                for line in fields:
                    add(line)
        for lines in bindings:
            for line in lines:
                add(line)
        for constant in {constant_key(array): array for array in stage.constants}.values():
            name, type = writer.expression(constant), writer.type(constant.type)
            add(f"const {name} = {type}({', '.join(map(writer.expression, constant.elements))});")
        for name in self.inputs:
            if name not in GROUP_INPUTS:
                add(f"var<private> rhi_{name}: {INPUTS[name][0]};")
        for text in writer.helpers.values():
            add(text)
        self.lines.text += writer.lines.text
        self.lines.origins += writer.lines.origins
        self._main()
        return StageText("\n".join(self.lines.text) + "\n", tuple(self.lines.origins))

    # -- declarations

    def _binding(self, declaration: Declaration) -> list[str]:
        """Return the declaration of a binding or of shared memory."""
        writer, name = self.writer, self.names.get(("binding", declaration.name), declaration.name)
        type, memory, space = declaration.type, self.writer.memory, declaration.name
        words = memory.is_atomic(space, None, "")
        if declaration.storage_class is StorageClass.SHARED:
            return [f"var<workgroup> {name}: {memory.type(type, space, words)};"]  # type: ignore[arg-type]
        binding = self.interface.bindings[declaration.name]
        number = 2 * binding.slot if binding.kind is BindingKind.UNIFORM else binding.slot
        group, slot = f"@group({SETS[binding.kind]})", f"@binding({number})"
        match type:
            case StorageType(element=element, writable=writable):
                access = "read_write" if writable else "read"
                return [
                    f"{group} {slot} var<storage, {access}> {name}: "
                    f"array<{memory.type(element, space, words)}>;"
                ]
            case TextureType():
                texture, sampler = writer.texture_and_sampler_names(
                    declaration.name, ("binding", declaration.name), self.names
                )
                return [
                    f"{group} @binding({2 * binding.slot}) var {texture}: {writer.type(type)};",
                    f"{group} @binding({2 * binding.slot + 1}) var {sampler}: {sampler_type(type)};",
                ]
            case ImageType():
                return [f"{group} {slot} var {name}: {self._image_form(declaration)};"]
        assert binding.kind is BindingKind.UNIFORM
        return [f"{group} {slot} var<uniform> {name}: {memory.type(type, UNIFORM)};"]  # type: ignore[arg-type]

    def _image_form(self, declaration: Declaration) -> str:
        """Return the type of a storage image, with the access that the stage has."""
        type, stored, loaded = declaration.type, self.stage.stored, self.stage.loaded
        assert isinstance(type, ImageType)
        access = "read"
        if declaration.name in stored:
            access = "read_write" if declaration.name in loaded else "write"
        return f"texture_storage_{SHAPES[type.kind]}<{texel_format(type.format)}, {access}>"

    # -- the entry point

    def _main(self) -> None:
        stage, entry, lines = self.stage.stage, self.stage.entry, self.lines
        parameters, starts = [], []
        for name in self.inputs:
            _, passed, builtin, conversion = INPUTS[name]
            parameter = self.main_names.get_legal(("built-in", name), f"in_{name}")
            parameters.append(f"@builtin({builtin}) {parameter}: {passed}")
            start = "let " if name in GROUP_INPUTS else ""
            starts.append(f"{start}rhi_{name} = {conversion.format(parameter)};")
        arguments = self._arguments(parameters)
        outputs = self._outputs()
        tested = self._alpha_tested_output()
        if stage is Stage.VERTEX:
            lines.add(_DEPTH_REVERSAL)
        if tested is not None:
            lines.add(_ALPHA_TEST)
        if outputs:
            with lines.braces("struct RhiOutputs"):
                for number, (marks, form, _) in enumerate(outputs):
                    lines.add(f"{marks} o{number}: {form},")
        early = "@early_depth_test(force) " if self.interface.early_depth and stage is Stage.FRAGMENT else ""
        x, y, z = self.interface.work_group
        head = (
            f"@compute @workgroup_size({x}, {y}, {z})" if stage is Stage.COMPUTE else f"{early}@{stage.value}"
        )
        with lines.braces(f"{head} fn main({', '.join(parameters)}){' -> RhiOutputs' if outputs else ''}"):
            for start in starts:
                lines.add(start)
            arguments += [f"rhi_{name}" for name in self.writer.group_inputs[entry]]
            call = f"{self.names.get(entry, entry.name)}({', '.join(arguments)})"
            if entry.result == VOID:
                lines.add(f"{call};")
                return
            lines.add(f"let rhi_result = {call};")
            if tested is not None:
                lines.add(f"if (!rhi_passes_alpha({self._result(tested.name)}.w)) {{ discard; }}")
            if outputs:
                lines.add(f"return RhiOutputs({', '.join(value for _, _, value in outputs)});")

    def _result(self, name: str) -> str:
        type = self.stage.entry.result
        return f"rhi_result.{self.writer.field(type, name)}" if isinstance(type, StructType) else "rhi_result"

    def _arguments(self, parameters: list[str]) -> list[str]:
        """Return the arguments of the stage's function, and add the parameters of `main` that they need."""
        stage, interface, writer = self.stage.stage, self.interface, self.writer
        attributes = {attribute.name: attribute for attribute in interface.attributes}
        varyings = {varying.name: varying for varying in interface.varyings}
        arguments = []
        for parameter in self.stage.entry.parameters:
            assert isinstance(parameter.type, StructType)
            parts = []
            for field in parameter.type.fields:
                name, type = f"in_{writer.field(parameter.type, field.name)}", writer.type(field.type)
                if stage is Stage.VERTEX and field.name in attributes:
                    name = self.main_names.get_legal(field.name, name)
                    parameters.append(f"@location({attributes[field.name].location}) {name}: {type}")
                    parts.append(name)
                elif stage is Stage.FRAGMENT:
                    rows = list(self._varying_locations(varyings[field.name], name))
                    parameters += [f"{marks} {row}: {form}" for marks, row, form in rows]
                    texts = ", ".join(row for _, row, _ in rows)
                    parts.append(f"{type}({texts})" if isinstance(field.type, MatrixType) else texts)
                else:  # a lean vertex stage lacks attributes that nothing reads
                    parts.append(f"{type}()")
            arguments.append(f"{writer.type(parameter.type)}({', '.join(parts)})")
        return arguments

    def _varying_locations(self, varying: Varying, name: str) -> list[tuple[str, str, str]]:
        """Return the attributes, the name and the type of each location of a varying; a matrix has one for
        each row."""
        type: HostType = varying.type
        marks = _ROLES.get(varying.role, "") if varying.role else ""
        if not marks and scalar_of(type) in (INT, UINT):
            marks = _ROLES[Role.FLAT]
        if isinstance(type, MatrixType):
            form = f"vec{type.size}<f32>"
            names = [self.main_names.get_legal((varying.name, i), f"{name}_{i}") for i in range(type.size)]
            return [(f"@location({varying.location + i}){marks}", row, form) for i, row in enumerate(names)]
        name = self.main_names.get_legal(varying.name, name)
        return [(f"@location({varying.location}){marks}", name, self.writer.type(type))]

    def _outputs(self) -> list[tuple[str, str, str]]:
        """Return the attributes, the type and the value of each output."""
        interface, outputs = self.interface, []
        if self.stage.stage is Stage.VERTEX:
            # The same position code in two programs must give the same depth: a depth pre-pass relies on it.
            value = f"rhi_clip_position({self._result(interface.position)})"
            outputs.append(("@builtin(position) @invariant", "vec4<f32>", value))
            for varying in interface.varyings:
                rows, value = self._varying_locations(varying, ""), self._result(varying.name)
                many = isinstance(varying.type, MatrixType)
                outputs += [
                    (marks, form, f"{value}[{i}]" if many else value)
                    for i, (marks, _, form) in enumerate(rows)
                ]
        elif self.stage.stage is Stage.FRAGMENT:
            for output in interface.outputs:
                form = self.writer.type(output_type(output))
                outputs.append((f"@location({output.location})", form, self._result(output.name)))
            if interface.depth:
                outputs.append(("@builtin(frag_depth)", "f32", self._result(interface.depth)))
        return outputs

    def _alpha_tested_output(self) -> FragmentOutput | None:
        """Return the output whose alpha is tested."""
        if self.stage.stage is not Stage.FRAGMENT:
            return None
        outputs = self.interface.outputs
        return next((o for o in outputs if (o.location, o.kind, o.components) == (0, "float", 4)), None)
