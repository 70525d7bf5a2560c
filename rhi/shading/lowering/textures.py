"""The lowering of the methods of textures and images.

- Coordinates always have three components. The third is 0 for a 2D texture and the layer for an array. A
  texture of several samples is an array whose layers are the samples.
- Where GLSL computes the mip level implicitly, the access (`sample_grad`) is given the differences between
  the pixels of a quad: the sampler decides which texels a pixel covers. In vertex and compute stages there
  are no differences, and the level is 0.
"""

from __future__ import annotations

from typing import Final

from rhi.contract.descriptors import TextureKind
from rhi.contract.layout import FLOAT, INT, ScalarType
from rhi.shading.ir import lanes, tree
from rhi.shading.ir.lanes import (
    AddressSpace,
    Get,
    MemoryRegion,
    Uniformity,
    Value,
    apply,
    literal,
    number,
)
from rhi.shading.language.types import ImageType, TextureType, stored_kind
from rhi.shading.lowering.components import all_kinds
from rhi.shading.lowering.context import Lowering
from rhi.shading.lowering.memory import check_index, check_race

_LEVEL_AXES: Final = {TextureKind.D2: 2, TextureKind.D2_ARRAY: 2, TextureKind.D3: 3, TextureKind.CUBE: 3}
"""The number of coordinates that select the level: all but a layer."""


def lower_texture(lowering: Lowering, node: tree.BuiltinCall) -> list[Value]:
    source, rest = binding_of(lowering, node.arguments[0]), node.arguments[1:]
    type = source.type
    assert isinstance(type, TextureType | ImageType)
    memory = texture_region(lowering, source)
    arguments = [lowering.lower_named(argument) for argument in rest]
    name = node.builtin.name
    if name in ("size", "levels"):
        count = len(all_kinds(node.type))  # type: ignore[arg-type]
        first: list[Value] = [] if name == "levels" else [number(0)]
        return access(lowering, name, memory, arguments[0] if arguments else first, INT, count)
    at = arguments[0]
    at = [*at, literal(0, at[0].kind)][:3]
    if isinstance(type, ImageType):
        return lower_image(lowering, name, memory, type, at, arguments[1:])
    if type.samples:
        texel = check_texel(lowering, memory, [*at[:2], *arguments[1]], number(0))
        return access(lowering, "load", memory, texel, type.scalar, 4)
    if name == "load":
        level = arguments[1] if len(arguments) > 1 else [number(0)]
        return access(lowering, "load", memory, check_texel(lowering, memory, at, *level), type.scalar, 4)
    if name in ("gather", "gather_compare"):
        component = arguments[1] if len(arguments) > 1 else [number(0)]
        inputs = [*at, *component] if name == "gather_compare" else [*component, *at]
        return access(lowering, name, memory, inputs, type.scalar, 4)
    if type.compare:
        operation, kind, count = "sample_compare", FLOAT, 1
        coordinates, more = [*at, *arguments[1]], arguments[2:]
    else:
        operation, kind, count = "sample", type.scalar, 4
        coordinates, more = at, arguments[1:]
    if name in ("sample_lod", "sample_compare_lod"):
        return access(lowering, operation, memory, [*coordinates, *more[0]], kind, count)
    bias: Value = literal(0.0)
    if name == "sample_grad":
        steps = more
    elif lowering.has_helpers:
        axes = at[: _LEVEL_AXES[type.kind]]
        steps = [[difference(along, value) for value in axes] for along in ("ddx", "ddy")]
        bias = more[0][0] if more else bias
    else:
        return access(lowering, operation, memory, [*coordinates, literal(0.0)], kind, count)
    across = [value for step in steps for value in (*step, literal(0.0))[:3]]
    return access(lowering, f"{operation}_grad", memory, [*coordinates, *across, bias], kind, count)


def binding_of(lowering: Lowering, node: tree.Expression) -> tree.BindingRead:
    """Return the binding of a texture or image that an expression names, directly or by a parameter."""
    if isinstance(node, tree.Read):
        return lowering.frame.textures[node.local]
    assert isinstance(node, tree.BindingRead)
    return node


def lower_image(
    lowering: Lowering,
    name: str,
    memory: MemoryRegion,
    type: ImageType,
    at: list[Value],
    rest: list[list[Value]],
) -> list[Value]:
    texel = check_texel(lowering, memory, at, number(0))
    if name == "load":
        return access(lowering, "load", memory, texel, type.scalar, 4)
    (values,), at = rest, texel[:3]
    mask = lowering.effect_mask()
    if mask is None and all(value.uniformity < Uniformity.VARYING for value in at):
        check_race(lowering, memory, values)
    lowering.emit(lanes.TextureAccess(lowering.line, "store", memory, (*at, *values), (), mask))
    return []


def check_texel(lowering: Lowering, memory: MemoryRegion, at: list[Value], level: Value) -> list[Value]:
    """Return a texel's coordinates and its level, checked against the texture's size if the shader is
    checked.

    If the level varies among lanes, only the level is checked.
    """
    if not lowering.checked:
        return [*at, level]
    (count,) = access(lowering, "levels", memory, [], INT, 1)
    level = check_index(lowering, level, count)
    if level.uniformity is Uniformity.VARYING and lowering.width != 1:
        return [*at, level]
    axes = 2 if memory.shape is TextureKind.D2 else 3
    sizes = access(lowering, "size", memory, [level], INT, axes)
    checked = [check_index(lowering, lowering.let(axis), size) for axis, size in zip(at, sizes, strict=False)]
    return [*checked, *at[axes:], level]


def texture_region(lowering: Lowering, source: tree.BindingRead) -> MemoryRegion:
    """Return the memory region of a texture or image."""
    name = source.declaration.name
    region = lowering.memories.get(name)
    if region is None:
        assert isinstance(source.type, TextureType | ImageType)
        space = AddressSpace.IMAGE if isinstance(source.type, ImageType) else AddressSpace.TEXTURE
        shape = stored_kind(source.type)
        region = MemoryRegion(name, space, writable=space is AddressSpace.IMAGE, shape=shape)
        lowering.memories[name] = region
    return region


def access(
    lowering: Lowering,
    operation: str,
    memory: MemoryRegion,
    arguments: list[Value],
    kind: ScalarType,
    count: int,
) -> list[Value]:
    """Emit a texture access and return its results."""
    arguments = [lowering.let(value) for value in arguments]
    uniformity = max([value.uniformity for value in arguments], default=Uniformity.DISPATCH)
    if memory.writable and operation == "load":
        uniformity = max(uniformity, Uniformity.GROUP)
    results = tuple(lowering.variable(memory.name, kind, uniformity) for _ in range(count))
    mask = lowering.scope.mask
    lowering.emit(lanes.TextureAccess(lowering.line, operation, memory, tuple(arguments), results, mask))
    return [Get(kind, uniformity, result) for result in results]


def difference(name: str, value: Value) -> Value:
    """Return `ddx` or `ddy` of a component."""
    return apply(name, value) if value.uniformity is Uniformity.VARYING else literal(0.0)
