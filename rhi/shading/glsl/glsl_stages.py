"""A complete stage in GLSL: the declarations that it needs, its functions, and `main`."""

from __future__ import annotations

import re
from typing import Final

from rhi.contract.descriptors import Stage, StageText
from rhi.contract.formats import ChannelKind, Format
from rhi.contract.layout import StructType
from rhi.shading.glsl.glsl_names import RESERVED
from rhi.shading.glsl.glsl_writer import Writer, has_plain_matrices
from rhi.shading.glsl.native import is_whole, lines_of
from rhi.shading.ir import tree
from rhi.shading.ir.interface import Interface, Varying
from rhi.shading.ir.text import Lines
from rhi.shading.language.annotations import Role
from rhi.shading.language.builtins import Builtin, SideEffect
from rhi.shading.language.shader import Declaration, StorageClass
from rhi.shading.language.types import VOID, ImageType, StorageType
from rhi.shading.text.names import Names
from rhi.shading.text.stage_names import name_bindings, name_structs
from rhi.shading.text.text_writer import constant_key, output_type

_PACKED_IMAGES: Final = {
    Format.RGB10A2: "rgb10_a2",
    Format.RGB10A2UI: "rgb10_a2ui",
    Format.R11G11B10F: "r11f_g11f_b10f",
}
_LAYER_EXTENSION: Final = "GL_ARB_shader_viewport_layer_array"


def write_stage(stage: tree.StageTree, interface: Interface, exact: bool = False) -> StageText:
    """Return the stage's complete GLSL 4.30 source.

    Args:
        exact: whether each operation of floats is rounded by itself (`rhi.shading.glsl.precise`).
    """
    return StageWriter(stage, interface, exact).write()


class StageWriter:
    """A writer of stages for OpenGL; `rhi.shading.glsl.vulkan` derives the one for Vulkan from it."""

    version = "#version 430 core"
    writer_type = Writer
    reserved = RESERVED

    def __init__(self, stage: tree.StageTree, interface: Interface, exact: bool = False) -> None:
        self.stage = stage
        self.interface = interface
        self.names = Names(reserved=self.reserved)
        # Bindings are named first, because native code uses their Python names.
        name_bindings(self.names, stage, interface)
        self.writer = self.writer_type(self.names)
        for declaration in stage.bindings:
            self.name_parts(declaration)
        self.writer.exact = exact
        if not any("glsl" in function.native for function in stage.functions):
            buffers = [
                (binding.name, binding.type)
                for binding in stage.bindings
                if isinstance(binding.type, StorageType)
            ]
            self.writer.by_columns = {
                name for name, type in buffers if not type.writable and has_plain_matrices(type.element)
            }
        self.lines = Lines()
        self.whole = is_whole(stage.entry)

    def write(self) -> StageText:
        """Return the stage's source."""
        stage, writer, add = self.stage, self.writer, self.lines.add
        # File-level names are assigned before those inside functions, which must not hide them.
        name_structs(self.names, stage, self.interface)
        for constant in stage.constants:
            writer.expression(constant)
        self.names.get_all({function: function.name for function in stage.functions})
        for function in stage.functions:
            if function is not stage.entry or not self.whole:
                writer.function(function)
        add(self.version)
        add(f"// {self.interface.name}, {stage.stage.value} stage")
        declarations = self._extensions()
        self._layout_qualifiers()
        for struct in stage.structs:
            self._struct(struct)
        for declaration in stage.bindings:
            self.binding(declaration)
        self._constants()
        for line in declarations:
            add(line)
        for text in writer.helpers.values():
            add(text)
        inputs = self._inputs()
        outputs = self._outputs()
        self.lines.text += writer.lines.text
        self.lines.origins += writer.lines.origins
        if self.whole:
            self._native_stage(inputs, outputs)
        else:
            self._main(inputs, outputs)
        return StageText("\n".join(self.lines.text) + "\n", tuple(self.lines.origins))

    # -- declarations

    def _extensions(self) -> list[str]:
        """Write the `#extension` lines, and return the other lines of native declarations."""
        extensions = dict.fromkeys(
            f"#extension {self.extension_of(row)} : require"
            for row in sorted(self.stage.builtins, key=lambda row: row.name)
            if self.extension_of(row)
        )
        if self.stage.stage is Stage.VERTEX and self.interface.target_layer and not self.whole:
            extensions[f"#extension {_LAYER_EXTENSION} : require"] = None
        rest: list[str] = []
        for function in self.stage.functions:
            native = function.native.get("glsl")
            texts = [native.declarations] if native is not None else []
            if native is not None and self.whole and function is self.stage.entry:
                extensions |= dict.fromkeys(
                    re.findall(r"^\s*(#extension .*?)\s*$", native.body, re.MULTILINE)
                )
            for line in "\n".join(texts).splitlines():
                if line.lstrip().startswith("#extension"):
                    extensions[line.strip()] = None
                else:
                    rest.append(line)
        for line in extensions:
            self.lines.add(line)
        return rest

    def _layout_qualifiers(self) -> None:
        if self.stage.stage is Stage.COMPUTE:
            x, y, z = self.interface.work_group
            self.lines.add(f"layout(local_size_x = {x}, local_size_y = {y}, local_size_z = {z}) in;")
        if self.stage.stage is Stage.FRAGMENT and self.interface.early_depth:
            self.lines.add("layout(early_fragment_tests) in;")

    def _struct(self, struct: StructType) -> None:
        with self.lines.braces(f"struct {self.writer.type(struct)}", end="};"):
            for field in struct.fields:
                self.lines.add(f"{self.writer.type(field.type)} {self.writer.field(struct, field.name)};")

    def extension_of(self, builtin: Builtin) -> str:
        """Return the extension that a built-in needs, or ""."""
        return builtin.extension

    def location(self, declaration: Declaration) -> str:
        """Return the layout qualifier with a binding's location."""
        return f"binding = {self.interface.bindings[declaration.name].slot}"

    def name_parts(self, declaration: Declaration) -> None:
        """Name what a binding consists of besides its name."""
        if declaration.storage_class in (StorageClass.UNIFORM, StorageClass.STORAGE):
            name = self.names.get(("binding", declaration.name), declaration.name)
            self.names.get(("block", name), f"{name}_block")

    def binding(self, declaration: Declaration) -> None:
        """Write the declaration of a binding or of shared memory."""
        name = self.names.get(("binding", declaration.name), declaration.name)
        shared = declaration.storage_class is StorageClass.SHARED
        slot = self.location(declaration) if not shared else ""
        type = declaration.type
        match declaration.storage_class:
            case StorageClass.SHARED:
                self.lines.add(f"shared {self.writer.type(type)} {name};")
            case StorageClass.UNIFORM:
                block = self.names.get(("block", name), f"{name}_block")
                header = f"layout(std140, row_major, {slot}) uniform {block}"
                self.lines.add(f"{header} {{ {self.writer.type(type)} {name}; }};")
            case StorageClass.STORAGE:
                assert isinstance(type, StorageType)
                block = self.names.get(("block", name), f"{name}_block")
                # Writes of other invocations are only visible through `coherent` memory.
                barriers = any(row.effect is SideEffect.BARRIER for row in self.stage.builtins)
                access = ("coherent " if barriers else "") if type.writable else "readonly "
                order = "" if declaration.name in self.writer.by_columns else "row_major, "
                header = f"layout(std430, {order}{slot}) {access}buffer {block}"
                self.lines.add(f"{header} {{ {self.writer.type(type.element)} {name}[]; }};")
            case StorageClass.TEXTURE:
                self.lines.add(f"layout({slot}) uniform {self.writer.type(type)} {name};")
            case StorageClass.IMAGE:
                assert isinstance(type, ImageType)
                stored = declaration.name in self.stage.stored
                access = (
                    "readonly "
                    if not stored
                    else ""
                    if declaration.name in self.stage.loaded
                    else "writeonly "
                )
                layout = f"layout({image_format(type)}, {slot})"
                self.lines.add(f"{layout} {access}uniform {self.writer.type(type)} {name};")

    def _constants(self) -> None:
        for constant in {constant_key(array): array for array in self.stage.constants}.values():
            name, type = self.writer.expression(constant), self.writer.type(constant.type)
            self.lines.add(
                f"const {type} {name} = {type}({', '.join(map(self.writer.expression, constant.elements))});"
            )

    # -- inputs, outputs, main

    def _inputs(self) -> dict[str, str]:
        """Declare the stage's inputs. Return their GLSL names by field."""
        names: dict[str, str] = {}
        if self.stage.stage is Stage.VERTEX:
            self.name_interface("in", "in_", [attribute.name for attribute in self.interface.attributes])
            for attribute in self.interface.attributes:
                name = names[attribute.name] = self.interface_name("in", "in_", attribute.name)
                self.lines.add(f"layout(location = {attribute.location}) in {attribute.type} {name};")
        elif self.stage.stage is Stage.FRAGMENT:
            used = {
                field.name
                for parameter in self.stage.entry.parameters
                if isinstance(parameter.type, StructType)
                for field in parameter.type.fields
            }
            self.name_interface("in", "v_", [varying.name for varying in self.interface.varyings])
            for varying in self.interface.varyings:
                if varying.name in used:
                    name = names[varying.name] = self.interface_name("in", "v_", varying.name)
                    self._varying(varying, "in", name)
        return names

    def _outputs(self) -> dict[str, str]:
        """Declare the stage's outputs. Return their GLSL names by field."""
        names: dict[str, str] = {}
        interface = self.interface
        if self.stage.stage is Stage.VERTEX:
            # The same position code in two programs must give the same depth: a depth pre-pass relies on it.
            self.lines.add("invariant gl_Position;")
            self.name_interface("out", "v_", [varying.name for varying in interface.varyings])
            for varying in interface.varyings:
                name = names[varying.name] = self.interface_name("out", "v_", varying.name)
                self._varying(varying, "out", name)
        elif self.stage.stage is Stage.FRAGMENT:
            self.name_interface("out", "out_", [output.name for output in interface.outputs])
            for output in interface.outputs:
                name = names[output.name] = self.interface_name("out", "out_", output.name)
                self.lines.add(f"layout(location = {output.location}) out {output_type(output)} {name};")
        return names

    def _varying(self, varying: Varying, direction: str, name: str) -> None:
        role = f"{varying.role.value} " if varying.role in (Role.FLAT, Role.NO_PERSPECTIVE) else ""
        type = self.writer.type(varying.type)
        self.lines.add(f"layout(location = {varying.location}) {role}{direction} {type} {name};")

    def name_interface(self, direction: str, prefix: str, names: list[str]) -> None:
        """Name all inputs or outputs, so that varyings have the same names in both stages."""
        prefix = "" if self.whole else prefix
        self.names.get_all({(direction, name): f"{prefix}{name}" for name in names})

    def interface_name(self, direction: str, prefix: str, name: str) -> str:
        """Return the GLSL name of an input or output. A whole native stage uses the names of the fields."""
        return self.names.get((direction, name), name if self.whole else f"{prefix}{name}")

    def _native_stage(self, inputs: dict[str, str], outputs: dict[str, str]) -> None:
        """Write the text of a whole native stage."""
        interface, type = self.interface, self.writer.type
        fields = {varying.name: type(varying.type) for varying in interface.varyings}
        attributes = {attribute.name: str(attribute.type) for attribute in interface.attributes}
        targets = {output.name: str(output_type(output)) for output in interface.outputs}
        is_vertex = self.stage.stage is Stage.VERTEX
        declared = {("in", inputs[name]): (attributes if is_vertex else fields)[name] for name in inputs}
        declared |= {("out", outputs[name]): (fields if is_vertex else targets)[name] for name in outputs}
        for binding in self.stage.bindings:
            if binding.storage_class is not StorageClass.SHARED and not isinstance(binding.type, StorageType):
                name = self.names.get(("binding", binding.name), binding.name)
                declared["uniform", name] = type(binding.type)
        structs = {type(struct) for struct in self.stage.structs}
        entry = self.stage.entry
        for text, line in lines_of(entry, declared, structs, self.interface.work_group):
            self.lines.add(text, entry.file if line else "", line)

    def _main(self, inputs: dict[str, str], outputs: dict[str, str]) -> None:
        entry, interface = self.stage.entry, self.interface
        arguments = []
        for parameter in entry.parameters:
            assert isinstance(parameter.type, StructType)
            # A lean vertex stage lacks attributes that nothing reads.
            parts = ", ".join(
                inputs.get(field.name) or f"{self.writer.type(field.type)}(0)"
                for field in parameter.type.fields
            )
            arguments.append(f"{self.writer.type(parameter.type)}({parts})")
        call = f"{self.names.get(entry, entry.name)}({', '.join(arguments)})"
        with self.lines.braces("void main()"):
            if entry.result == VOID:
                self.lines.add(f"{call};")
                return
            result = self.names.get("result", "result")
            self.lines.add(f"{self.writer.type(entry.result)} {result} = {call};")
            if self.stage.stage is Stage.VERTEX:
                self.lines.add(f"gl_Position = {self._part(result, interface.position)};")
                if interface.point_size:
                    self.lines.add(f"gl_PointSize = max(1.0, {self._part(result, interface.point_size)});")
                if interface.target_layer:
                    self.lines.add(f"gl_Layer = {self._part(result, interface.target_layer)};")
            elif interface.depth:
                self.lines.add(f"gl_FragDepth = {self._part(result, interface.depth)};")
            for name, output in outputs.items():
                self.lines.add(f"{output} = {self._part(result, name)};")

    def _part(self, result: str, name: str) -> str:
        """Return a field of the stage's result, or the result itself if it is no struct."""
        type = self.stage.entry.result
        return f"{result}.{self.writer.field(type, name)}" if isinstance(type, StructType) else result


def image_format(type: ImageType) -> str:
    """Return GLSL's name of an image's texel format."""
    if type.format in _PACKED_IMAGES:
        return _PACKED_IMAGES[type.format]
    name = type.format.name.lower()
    return name.replace("_snorm", "") + ("_snorm" if type.format.kind is ChannelKind.SNORM else "")
