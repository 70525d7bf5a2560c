"""GLSL 4.50 with Vulkan's semantics, for ports whose platform takes SPIR-V, or such text itself.

- Each kind of binding has a set of its own (`SETS`), and its slots are the bindings of the set. A texture and
  its sampler are two: slot n is the texture at binding 2n and the sampler at 2n + 1. Every platform has four
  sets.
- Where a built-in reads a texture, it is combined with its sampler. A function whose parameter is a texture
  has two parameters. In a stage with native code, a macro has the texture's name and combines them.
- Everything else is as in OpenGL's text: std140 and std430, rows first, the same locations.
"""

from __future__ import annotations

from typing import Final

from rhi.contract.descriptors import BindingKind, StageText
from rhi.shading.glsl.glsl_names import VULKAN_RESERVED
from rhi.shading.glsl.glsl_stages import StageWriter
from rhi.shading.glsl.glsl_writer import Writer
from rhi.shading.ir import tree
from rhi.shading.ir.interface import Interface
from rhi.shading.ir.tree import Expression
from rhi.shading.language.builtins import Builtin
from rhi.shading.language.shader import Declaration, StorageClass
from rhi.shading.language.types import TextureType

SETS: Final = {
    BindingKind.UNIFORM: 0,
    BindingKind.STORAGE: 1,
    BindingKind.TEXTURE: 2,
    BindingKind.IMAGE: 3,
}
"""The descriptor set of each kind of binding."""

_INDICES: Final = {"vertex_index": "gl_VertexIndex", "instance_index": "gl_InstanceIndex"}


def write_vulkan_stage(stage: tree.StageTree, interface: Interface, exact: bool = False) -> StageText:
    """Return the stage's complete source in GLSL 4.50 for Vulkan; see `write_stage`."""
    return _VulkanStageWriter(stage, interface, exact).write()


class _VulkanWriter(Writer):
    precise_parameters = False  # glslang warns that it has no effect

    def builtin(self, node: tree.BuiltinCall) -> str:
        return _INDICES.get(node.builtin.name) or super().builtin(node)

    def texture(self, node: tree.Read | tree.BindingRead) -> str:
        return f"{self.combined(node.type)}({self.texture_and_sampler(node)})"

    def argument(self, node: Expression) -> str:
        return (
            self.texture_and_sampler(node) if isinstance(node.type, TextureType) else super().argument(node)
        )

    def parameter(self, local: tree.Local) -> str:
        if not isinstance(local.type, TextureType):
            return super().parameter(local)
        texture, sampler = self.texture_and_sampler_names(self.names.get(local, local.name), local)
        return f"{self.separate_texture_type(local.type)} {texture}, {_sampler(local.type)} {sampler}"

    def combined(self, type: object) -> str:
        """Return the type that combines a texture with a sampler."""
        assert isinstance(type, TextureType)
        return super().type(type)

    def separate_texture_type(self, type: TextureType) -> str:
        """Return the type of a texture without its sampler."""
        return self.combined(type).removesuffix("Shadow").replace("sampler", "texture")

    def texture_and_sampler(self, node: Expression) -> str:
        """Return a texture and its sampler as two arguments."""
        if isinstance(node, tree.BindingRead):
            return ", ".join(
                self.texture_and_sampler_names(node.declaration.name, ("binding", node.declaration.name))
            )
        assert isinstance(node, tree.Read)
        return ", ".join(
            self.texture_and_sampler_names(self.names.get(node.local, node.local.name), node.local)
        )

    def texture_and_sampler_names(self, name: str, key: object) -> tuple[str, str]:
        names = self.globals if isinstance(key, tuple) else self.names
        return names.get((key, "texture"), f"{name}_texture"), names.get((key, "sampler"), f"{name}_sampler")


class _VulkanStageWriter(StageWriter):
    version = "#version 450"
    writer_type = _VulkanWriter
    reserved = VULKAN_RESERVED
    writer: _VulkanWriter

    def name_parts(self, declaration: Declaration) -> None:
        super().name_parts(declaration)
        if declaration.storage_class is StorageClass.TEXTURE:
            self.writer.texture_and_sampler_names(declaration.name, ("binding", declaration.name))

    def extension_of(self, builtin: Builtin) -> str:
        return "" if builtin.name in _INDICES else builtin.extension

    def location(self, declaration: Declaration) -> str:
        binding = self.interface.bindings[declaration.name]
        return f"set = {SETS[binding.kind]}, binding = {binding.slot}"

    def binding(self, declaration: Declaration) -> None:
        if declaration.storage_class is not StorageClass.TEXTURE:
            super().binding(declaration)
            return
        type, name = declaration.type, self.names.get(("binding", declaration.name), declaration.name)
        assert isinstance(type, TextureType)
        set, slot = SETS[BindingKind.TEXTURE], self.interface.bindings[declaration.name].slot
        texture, sampler = self.writer.texture_and_sampler_names(
            declaration.name, ("binding", declaration.name)
        )
        add = self.lines.add
        add(
            f"layout(set = {set}, binding = {2 * slot}) uniform {self.writer.separate_texture_type(type)} "
            f"{texture};"
        )
        add(f"layout(set = {set}, binding = {2 * slot + 1}) uniform {_sampler(type)} {sampler};")
        if any(function.native for function in self.stage.functions):
            add(f"#define {name} {self.writer.combined(type)}({texture}, {sampler})")


def _sampler(type: TextureType) -> str:
    return "samplerShadow" if type.compare else "sampler"
