"""Texture and image types in Python, and the table of their methods, built like the table of built-ins.

- In a method's signature COORD, TEXEL, GRAD, SIZE and VALUE stand for the types that belong to the texture's
  dimension and scalar type. In a GLSL spelling `{0}` is the texture itself.
- `rhi.shading.tools.stubs` writes the stub beside this file (`textures.pyi`) from the same table.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from rhi.contract.descriptors import Stage, TextureKind
from rhi.contract.formats import Format
from rhi.contract.layout import FLOAT, INT, UINT
from rhi.errors.shared_caches import cache_once
from rhi.shading.language.builtins import Builtin, BuiltinParameter, Overload, SideEffect, expand
from rhi.shading.language.types import LANGUAGE_NAMES, VECTORS, ImageType, TextureType, Type

_D2 = TextureKind.D2
_ARRAY = TextureKind.D2_ARRAY
_D3 = TextureKind.D3
_CUBE = TextureKind.CUBE
_NOT_3D: Final = frozenset({_D2, _ARRAY, _CUBE})
_NOT_CUBE: Final = frozenset({_D2, _ARRAY, _D3})
_FLAT: Final = frozenset({_D2})
_ALL: Final = frozenset(TextureKind)
_LEVEL_SIZE: Final = "max(textureSize({0}, 0) >> clamp({1}, 0, textureQueryLevels({0}) - 1), 1)"
"""The size of a level, or of the nearest that exists. Drivers return 0 for others, and llvmpipe the size of one
level for all lanes."""
_LEVEL_SIZES: Final = dict.fromkeys(_ALL, _LEVEL_SIZE) | {
    _ARRAY: f"ivec3({_LEVEL_SIZE.replace('0) >>', '0).xy >>')}, textureSize({{0}}, 0).z)"
}
_REFERENCE: Final = {_D2: "vec3({1}, {2})", _ARRAY: "vec4({1}, {2})", _CUBE: "vec4({1}, {2})"}

# (name, kinds, signatures with their spellings, documentation)
_SAMPLED: Final = (
    (
        "sample",
        _ALL,
        {"VALUE(at: COORD)": "texture({0}, {1})"},
        "filtered sample; mip level from the derivatives of `at`",
    ),
    (
        "sample_bias",
        _ALL,
        {"VALUE(at: COORD, bias: float)": "texture({0}, {1}, {2})"},
        "like `sample`, with `bias` added to the mip level",
    ),
    (
        "sample_lod",
        _ALL,
        {"VALUE(at: COORD, lod: float)": "textureLod({0}, {1}, {2})"},
        "filtered sample at mip level `lod`",
    ),
    (
        "sample_grad",
        _ALL,
        {"VALUE(at: COORD, dx: GRAD, dy: GRAD)": "textureGrad({0}, {1}, {2}, {3})"},
        "filtered sample; mip level from the given derivatives",
    ),
    (
        "gather",
        _NOT_3D,
        {
            "VALUE(at: COORD)": "textureGather({0}, {1})",
            "VALUE(at: COORD, component: int)": "textureGather({0}, {1}, {2})",
        },
        "one component of the four texels that bilinear filtering would read",
    ),
    (
        "load",
        _NOT_CUBE,
        {
            "VALUE(texel: TEXEL)": "texelFetch({0}, {1}, 0)",
            "VALUE(texel: TEXEL, level: int)": "texelFetch({0}, {1}, {2})",
        },
        "one texel, unfiltered",
    ),
    (
        "size",
        _ALL,
        {"SIZE()": "textureSize({0}, 0)", "SIZE(level: int)": "LEVEL_SIZE"},
        "in texels",
    ),
    ("levels", _ALL, {"int()": "textureQueryLevels({0})"}, "number of mip levels"),
)
_COMPARED: Final = (
    (
        "sample_compare",
        _NOT_3D,
        {"float(at: COORD, reference: float)": "texture({0}, REFERENCE)"},
        "filtered result of `reference compare texel`: the passing share of the texels, 0…1",
    ),
    (
        "sample_compare_lod",
        _FLAT,
        {"float(at: COORD, reference: float, lod: float)": "textureLod({0}, REFERENCE, {3})"},
        "like `sample_compare`, at mip level `lod`",
    ),
    (
        "gather_compare",
        _NOT_3D,
        {"vec4(at: COORD, reference: float)": "textureGather({0}, {1}, {2})"},
        "the four comparison results, before filtering",
    ),
    (
        "size",
        _ALL,
        {"SIZE()": "textureSize({0}, 0)", "SIZE(level: int)": "LEVEL_SIZE"},
        "in texels",
    ),
)
_SEVERAL: Final = (
    (
        "load",
        _FLAT,
        {"VALUE(texel: TEXEL, sample: int)": "texelFetch({0}, {1}, {2})"},
        "one sample of a texel, from 0 on",
    ),
    ("size", _FLAT, {"SIZE()": "textureSize({0})"}, "in texels"),
)
_STORED: Final = (
    ("load", _NOT_CUBE, {"VALUE(texel: TEXEL)": "imageLoad({0}, {1})"}, "one texel"),
    (
        "store",
        _NOT_CUBE,
        {"None(texel: TEXEL, value: VALUE)": "imageStore({0}, {1}, {2})"},
        "writes one texel",
    ),
    ("size", _NOT_CUBE, {"SIZE()": "imageSize({0})"}, "in texels"),
)

METHOD_NAMES: Final = frozenset(row[0] for table in (_SAMPLED, _COMPARED, _SEVERAL, _STORED) for row in table)
"""The names of all methods of textures and images."""

_FRAGMENT_ONLY: Final = frozenset({"sample_bias"})


@cache_once
def methods_of(type: TextureType | ImageType) -> dict[str, Builtin]:
    """Return the methods of a texture or image type by name. Their first parameter is the texture."""
    if isinstance(type, ImageType):
        rows: Any = _STORED
    else:
        rows = _SEVERAL if type.samples else _COMPARED if type.compare else _SAMPLED
    plane = type.kind is _D2
    names: dict[str, Type] = {
        "COORD": VECTORS[FLOAT, 2 if plane else 3],
        "TEXEL": VECTORS[INT, 2 if plane else 3],
        "GRAD": VECTORS[FLOAT, 2 if type.kind in (_D2, _ARRAY) else 3],
        "SIZE": VECTORS[INT, 2 if type.kind in (_D2, _CUBE) else 3],
        "VALUE": VECTORS[type.scalar, 4],
    }
    reference = _REFERENCE.get(type.kind, "")
    methods = {}
    for name, kinds, signatures, doc in rows:
        if type.kind in kinds:
            overloads = tuple(
                Overload(
                    (BuiltinParameter(type, "self"), *overload.parameters), overload.result, overload.glsl
                )
                for signature, glsl in signatures.items()
                for overload in expand(
                    signature,
                    glsl.replace("REFERENCE", reference).replace("LEVEL_SIZE", _LEVEL_SIZES[type.kind]),
                    names,
                )
            )
            methods[name] = Builtin(
                name,
                overloads,
                doc,
                SideEffect.WRITE if name == "store" else SideEffect.NONE,
                frozenset({Stage.FRAGMENT}) if name in _FRAGMENT_ONLY else frozenset(Stage),
            )
    return methods


class SampledTexture:
    """Base class of the annotations for sampled textures. `shading_type` is the texture's type."""

    shading_type: TextureType


class StorageImage:
    """Base class of the annotations for images. The texel format comes from `image(Format…)`."""

    kind: TextureKind
    scalar: Any


class ImageFormat:
    """Marker that `image(format)` returns: the texel format of an image binding."""

    __slots__ = ("format",)

    def __init__(self, format: Format) -> None:
        self.format = format


def image(format: Format) -> Any:
    """Give an image binding its texel format: `target: Image2D = image(Format.RGBA8)`."""
    return ImageFormat(format)


_SHAPES: Final = {_D2: "2D", _ARRAY: "2DArray", _D3: "3D", _CUBE: "Cube"}
_PREFIXES: Final = {FLOAT: "", INT: "Int", UINT: "Uint"}


def _create_classes() -> Iterator[type]:
    """Yield the class of each kind of texture and image."""
    for kind, shape in _SHAPES.items():
        for scalar, prefix in _PREFIXES.items():
            doc = f"A {shape} texture, read as {scalar.name}s through a sampler."
            space: dict[str, Any] = {"shading_type": TextureType(kind, scalar), "__doc__": doc}
            yield type(f"{prefix}Texture{shape}", (SampledTexture,), space)
            if kind is _D2:
                doc = f"A 2D texture of several samples, each read as {scalar.name}s."
                space = {"shading_type": TextureType(kind, scalar, samples=True), "__doc__": doc}
                yield type(f"{prefix}Texture2DSamples", (SampledTexture,), space)
            if kind in _NOT_CUBE:
                doc = f"One mip level of a {shape} texture, loaded and stored as {scalar.name}s."
                space = {"kind": kind, "scalar": scalar, "__doc__": doc}
                yield type(f"{prefix}Image{shape}", (StorageImage,), space)
        if kind in _NOT_3D:
            doc = f"A {shape} depth texture; reading it compares its texels with a reference."
            space = {"shading_type": TextureType(kind, FLOAT, True), "__doc__": doc}
            yield type(f"DepthTexture{shape}", (SampledTexture,), space)


_CLASSES: Final = {cls.__name__: cls for cls in _create_classes()}
globals().update(_CLASSES)

__all__ = sorted(["image", *_CLASSES])
LANGUAGE_NAMES.update(__all__)
