"""The lowering of the methods of textures and images.

- Coordinates always have three components. The third is 0 for a 2D texture and the layer for an array.
- Where GLSL computes the mip level implicitly, the access (`sample_across`) is given the differences between the pixels
  of a quad: the sampler decides which texels a pixel covers. In vertex and compute stages there are no differences, and
  the level is 0.
"""

from __future__ import annotations

from typing import Final

from rhi.contract.descriptors import TextureKind
from rhi.shading.ir import lanes, tree
from rhi.shading.ir.lanes import (
    AddressSpace,
    Get,
    MemoryRegion,
    ScalarKind,
    Uniformity,
    Value,
    literal,
    number,
)
from rhi.shading.language.types import ImageType, TextureType
from rhi.shading.lowering.builtins import BuiltinLowering
from rhi.shading.lowering.components import KINDS, all_kinds

_LEVEL_AXES: Final = {TextureKind.D2: 2, TextureKind.D2_ARRAY: 2, TextureKind.D3: 3, TextureKind.CUBE: 3}
"""The number of coordinate components that differ within a pixel: a layer doesn't."""


class TextureLowering(BuiltinLowering):
    """Lowers the methods of `rhi.shading.language.textures`."""

    has_helpers = False
    """Whether the stage has differences between pixels, for which helper invocations run."""

    def difference(self, name: str, value: Value) -> Value:
        """Return the difference of a value between neighbouring pixels; `name` is "ddx" or "ddy"."""
        raise NotImplementedError

    def texture(self, node: tree.BuiltinCall) -> list[Value]:
        source, rest = self.binding_of(node.arguments[0]), node.arguments[1:]
        type = source.type
        assert isinstance(type, TextureType | ImageType)
        memory = self.texture_memory(source)
        arguments = [self.named(argument) for argument in rest]
        name = node.builtin.name
        if name in ("size", "levels"):
            count = len(all_kinds(node.type))  # type: ignore[arg-type]
            first: list[Value] = [] if name == "levels" else [number(0)]
            return self.access(name, memory, arguments[0] if arguments else first, ScalarKind.INT, count)
        at = arguments[0]
        at = [*at, literal(0, at[0].kind)][:3]
        if isinstance(type, ImageType):
            return self.image(name, memory, type, at, arguments[1:])
        if name == "load":
            level = arguments[1] if len(arguments) > 1 else [number(0)]
            return self.access("load", memory, self.check_texel(memory, at, *level), KINDS[type.scalar], 4)
        if name in ("gather", "gather_compare"):
            component = arguments[1] if len(arguments) > 1 else [number(0)]
            inputs = [*at, *component] if name == "gather_compare" else [*component, *at]
            return self.access(name, memory, inputs, KINDS[type.scalar], 4)
        if type.compare:
            operation, kind, count = "sample_compare", ScalarKind.FLOAT, 1
            given, more = [*at, *arguments[1]], arguments[2:]
        else:
            operation, kind, count = "sample", KINDS[type.scalar], 4
            given, more = at, arguments[1:]
        if name in ("sample_lod", "sample_compare_lod"):
            return self.access(operation, memory, [*given, *more[0]], kind, count)
        bias: Value = literal(0.0)
        if name == "sample_grad":
            steps = more
        elif self.has_helpers:
            axes = at[: _LEVEL_AXES[type.kind]]
            steps = [[self.difference(along, value) for value in axes] for along in ("ddx", "ddy")]
            bias = more[0][0] if more else bias
        else:
            return self.access(operation, memory, [*given, literal(0.0)], kind, count)
        across = [value for step in steps for value in (*step, literal(0.0))[:3]]
        return self.access(f"{operation}_across", memory, [*given, *across, bias], kind, count)

    def binding_of(self, node: tree.Expression) -> tree.BindingRead:
        """Return the binding of a texture or image that an expression names, directly or by a parameter."""
        if isinstance(node, tree.Read):
            return self.frame.textures[node.local]
        assert isinstance(node, tree.BindingRead)
        return node

    def image(
        self, name: str, memory: MemoryRegion, type: ImageType, at: list[Value], rest: list[list[Value]]
    ) -> list[Value]:
        place = self.check_texel(memory, at, number(0))
        if name == "load":
            return self.access("load", memory, place, KINDS[type.scalar], 4)
        (values,), at = rest, place[:3]
        mask = self.effect_mask()
        if mask is None and all(value.uniformity < Uniformity.VARYING for value in at):
            self.check_race(memory, values)
        self.emit(lanes.TextureAccess(self.line, "store", memory, (*at, *values), (), mask))
        return []

    def check_texel(self, memory: MemoryRegion, at: list[Value], level: Value) -> list[Value]:
        """Return a texel's coordinates and its level, checked against the texture's size if the shader is checked.

        If the level varies among lanes, only the level is checked.
        """
        if not self.checked:
            return [*at, level]
        (count,) = self.access("levels", memory, [], ScalarKind.INT, 1)
        level = self.check_index(level, count)
        if level.uniformity is Uniformity.VARYING and self.width != 1:
            return [*at, level]
        axes = 2 if memory.shape is TextureKind.D2 else 3
        sizes = self.access("size", memory, [level], ScalarKind.INT, axes)
        checked = [self.check_index(self.let(axis), size) for axis, size in zip(at, sizes, strict=False)]
        return [*checked, *at[axes:], level]

    def check_race(self, memory: MemoryRegion, values: list[Value]) -> None:
        """Refuse a store of varying values to one address."""
        raise NotImplementedError

    def texture_memory(self, source: tree.BindingRead) -> MemoryRegion:
        """Return the memory region of a texture or image."""
        name = source.declaration.name
        known = self.memories.get(name)
        if known is None:
            assert isinstance(source.type, TextureType | ImageType)
            space = AddressSpace.IMAGE if isinstance(source.type, ImageType) else AddressSpace.TEXTURE
            known = MemoryRegion(name, space, writable=space is AddressSpace.IMAGE, shape=source.type.kind)
            self.memories[name] = known
        return known

    def access(
        self, operation: str, memory: MemoryRegion, arguments: list[Value], kind: ScalarKind, count: int
    ) -> list[Value]:
        """Emit a texture access and return its results."""
        arguments = [self.let(value) for value in arguments]
        uniformity = max([value.uniformity for value in arguments], default=Uniformity.DISPATCH)
        if memory.writable and operation == "load":
            uniformity = max(uniformity, Uniformity.GROUP)
        results = tuple(self.variable(memory.name, kind, uniformity) for _ in range(count))
        mask = self.scope.mask
        self.emit(lanes.TextureAccess(self.line, operation, memory, tuple(arguments), results, mask))
        return [Get(kind, uniformity, result) for result in results]
