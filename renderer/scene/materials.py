"""Materials and the textures that they refer to: structured arrays in std430 layout, which are uploaded as
they are.

A material has one of two models. The **specular** one is Blinn-Phong with a rim term. The
**metallic-roughness** one is that of glTF 2.0 (GGX), and a material has it if `metallic`, `roughness` or
their texture is given. What both have in common means the same in both: base colour, normal, occlusion,
emitted light, alpha and sides.

A *texture* is an image with the way to read it: a set of texture coordinates, their transform, and a sampler
(`TextureMap`). Whether an image holds colours (sRGB) or data (linear) follows from what a material uses it
for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from rhi import SamplerDescriptor
from rhi.errors import refuse
from rhi.errors.choices import ChoiceType
from rhi.math.arguments import read_floats

MATERIAL: Final = np.dtype(
    [
        ("base_color", "<f4", 4),  # linear, alpha last; multiplies the texture
        ("specular_color", "<f4", 3),  # linear
        ("shininess", "<f4"),  # Blinn-Phong exponent
        ("rim_strength", "<f4"),  # Fresnel rim term: strength * (1 - n.v) ** power
        ("rim_power", "<f4"),
        ("texture", "<i4"),  # of the base colour: index into the scene's textures, or -1, as all textures
        ("emission", "<f4"),  # emitted light, as a multiple of the base colour
        ("emissive", "<f4", 3),  # emitted light, linear and of any strength; multiplies its texture
        ("emissive_texture", "<i4"),
        ("metallic", "<f4"),  # multiplies the blue channel of its texture
        ("roughness", "<f4"),  # multiplies the green channel
        ("metallic_roughness_texture", "<i4"),
        ("model", "<i4"),  # a `ShadingModel`
        ("normal_texture", "<i4"),
        ("normal_scale", "<f4"),  # multiplies x and y of the texture's normal
        ("occlusion_texture", "<i4"),
        (
            "occlusion_strength",
            "<f4",
        ),  # of the red channel: 1 + strength * (texel - 1) of ambient light is left
        ("alpha_mode", "<i4"),  # an `AlphaMode`
        ("alpha_cutoff", "<f4"),  # with `MASK`: below this alpha nothing is drawn
        ("double_sided", "<i4"),  # 1 if the back is drawn, too
        (
            "shader",
            "<i4",
        ),  # 0 for the renderer's, or 1 more than the place of its own in the scene's `shaders`
        ("light_map_color", "<f4", 3),  # linear and of any strength; multiplies the light map
        ("light_map_texture", "<i4"),
    ]
)
"""128 bytes: a std430 struct whose alignment is that of a vec4."""

TEXTURE: Final = np.dtype(
    [
        ("image", "<i4"),  # index into the scene's images
        ("sampler", "<i4"),  # index into the scene's samplers
        ("is_color", "<i4"),  # 1 if the image holds sRGB colours, 0 if it holds data
        ("uv_set", "<i4"),  # 0 or 1
        ("transform", "<f4", (2, 3)),  # of texture coordinates: transform @ (u, v, 1)
    ]
)
"""A texture that materials refer to by its row."""

TEXTURES: Final = {
    "texture": True,
    "emissive_texture": True,
    "metallic_roughness_texture": False,
    "normal_texture": False,
    "occlusion_texture": False,
    "light_map_texture": False,
}
"""The fields of a material that refer to textures, and whether these hold colours."""

LIGHT_TEXTURES: Final = {"emissive_texture", "light_map_texture"}
"""Those whose texels may be brighter than 1."""


class ShadingModel(IntEnum, metaclass=ChoiceType):
    """The model by which a material reflects light."""

    SPECULAR = 0
    METALLIC_ROUGHNESS = 1


class AlphaMode(IntEnum, metaclass=ChoiceType):
    """The meaning of a material's alpha: nothing, a mask that is cut at `alpha_cutoff`, or the share by which
    the surface covers what is behind it."""

    OPAQUE = 0
    MASK = 1
    BLEND = 2


DEFAULT_SAMPLER: Final = SamplerDescriptor()
"""The sampler of textures that name none: linear, with mip levels, repeated."""


@dataclass(frozen=True, slots=True)
class TextureMap:
    """An image as a material reads it.

    Texture coordinates are scaled, then rotated, then moved, as by glTF's KHR_texture_transform. They rotate
    counter-clockwise on the image, whose v counts down; so the image seems to rotate clockwise.

    Attributes:
        image: the id of an image.
        uv_set: 0 for the vertices' `uv`, 1 for `uv2`.
        offset, rotation, scale: the transform; the rotation is in radians.
        sampler: how texels are filtered, and what lies outside 0 to 1.
    """

    image: int
    uv_set: int = 0
    offset: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)
    sampler: SamplerDescriptor = DEFAULT_SAMPLER

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_MATERIAL)
        if self.uv_set not in (0, 1):
            refuse(rules.BAD_MATERIAL, "TextureMap(uv_set=...)", self.uv_set, "0 or 1")
        if self.sampler.compare is not None:
            refuse(
                rules.BAD_MATERIAL, "TextureMap(sampler=...)", "a comparison", "a sampler that filters texels"
            )
        for name in ("offset", "rotation", "scale"):
            if not np.isfinite(getattr(self, name)).all():
                refuse(rules.BAD_MATERIAL, f"TextureMap({name}=...)", getattr(self, name), "finite numbers")

    @property
    def transform(self) -> NDArray[np.float32]:
        """The transform of texture coordinates: (2, 3), to be multiplied with (u, v, 1)."""
        sine, cosine = np.sin(self.rotation), np.cos(self.rotation)
        (x, y), (u, v) = self.scale, self.offset
        return np.array([[cosine * x, sine * y, u], [-sine * x, cosine * y, v]], np.float32)


RANGES: Final = {
    "base_color": (0.0, 1e4),
    "specular_color": (0.0, 1e4),
    "shininess": (1.0, 1e5),
    "rim_strength": (0.0, 1e4),
    "rim_power": (0.1, 100.0),
    "emission": (0.0, 1e6),
    "emissive": (0.0, 1e6),
    "metallic": (0.0, 1.0),
    "roughness": (0.0, 1.0),
    "normal_scale": (-1e4, 1e4),
    "occlusion_strength": (0.0, 1.0),
    "alpha_cutoff": (0.0, 1e4),
    "light_map_color": (0.0, 1e6),
}
"""The least and the greatest value of each number of a material."""

_SPECULAR: Final[dict[str, Any]] = {
    "specular_color": (0.04, 0.04, 0.04),
    "shininess": 32.0,
    "rim_strength": 0.0,
    "rim_power": 4.0,
    "emission": 0.0,
}
"""The parameters that only the specular model has, and what they are by default."""


def make_material(
    base_color: Sequence[float] = (0.8, 0.8, 0.8, 1.0),
    specular_color: Sequence[float] | None = None,
    shininess: float | None = None,
    rim_strength: float | None = None,
    rim_power: float | None = None,
    texture: int = -1,
    emission: float | None = None,
    *,
    metallic: float | None = None,
    roughness: float | None = None,
    metallic_roughness_texture: int = -1,
    normal_texture: int = -1,
    normal_scale: float = 1.0,
    occlusion_texture: int = -1,
    occlusion_strength: float = 1.0,
    emissive: Sequence[float] = (0.0, 0.0, 0.0),
    emissive_texture: int = -1,
    light_map_texture: int = -1,
    light_map_color: Sequence[float] = (1.0, 1.0, 1.0),
    alpha_mode: AlphaMode = AlphaMode.OPAQUE,
    alpha_cutoff: float = 0.5,
    double_sided: bool = False,
) -> NDArray[Any]:
    """Create one material, () of `MATERIAL`; a base colour of three numbers gets alpha 1.

    With `metallic`, `roughness` or a `metallic_roughness_texture` it is of the metallic-roughness model, in
    which the first two are 1 by default. Otherwise it is of the specular model: `specular_color` (0.04 by
    default), `shininess` (32), `rim_strength` (0), `rim_power` (4) and `emission` (0). The parameters of both
    can't be mixed.

    Args:
        texture: that of the base colour. Textures are rows of the scene's textures, or -1.
        emission: emitted light, as a multiple of the base colour.
        emissive: emitted light of a colour of its own, of any strength; multiplied with its texture.
        light_map_texture: the irradiance of the surface, linear, in the unit of the ambient light that it replaces.
        light_map_color: multiplies the light map.
    """
    arguments = dict(locals())
    is_metallic = metallic is not None or roughness is not None or metallic_roughness_texture != -1
    mixed = [name for name in _SPECULAR if arguments[name] is not None]
    if is_metallic and mixed:
        refused = f"{mixed[0]} of the specular model beside the metallic-roughness model"
        refuse(rules.BAD_MATERIAL, "make_material", refused, "parameters of one model")
    color = read_floats("make_material(base_color=...)", base_color, rule=rules.BAD_MATERIAL)
    arguments["base_color"] = np.append(color, 1.0) if color.shape == (3,) else color
    material = np.zeros((), MATERIAL)
    for name, (low, high) in RANGES.items():
        value = arguments[name]
        if value is None:
            value = float(is_metallic) if name == "metallic" else _SPECULAR.get(name, 1.0)
        array = read_floats(f"make_material({name}=...)", value, rule=rules.BAD_MATERIAL)
        if array.shape != MATERIAL[name].shape or not ((array >= low) & (array <= high)).all():
            refuse(rules.BAD_MATERIAL, f"make_material({name}=...)", value, f"{low:g} to {high:g}")
        material[name] = array
    for name in TEXTURES:
        row = arguments[name]
        if row < -1:
            refuse(rules.BAD_MATERIAL, f"make_material({name}=...)", row, "-1 or a texture's row")
        material[name] = row
    if alpha_mode not in list(AlphaMode):
        refuse(rules.BAD_MATERIAL, "make_material(alpha_mode=...)", alpha_mode, "an AlphaMode")
    material["alpha_mode"] = alpha_mode
    material["double_sided"] = bool(double_sided)
    material["model"] = ShadingModel.METALLIC_ROUGHNESS if is_metallic else ShadingModel.SPECULAR
    return material


class TextureList:
    """Collects the textures of a scene: each way to read an image is one row.

    Attributes:
        samplers: those that textures refer to by index.
    """

    def __init__(self) -> None:
        self.samplers: list[SamplerDescriptor] = []
        self._rows: dict[tuple[TextureMap, bool], int] = {}

    def add(self, texture: TextureMap, *, is_color: bool) -> int:
        """Return the row of a texture; it is added unless it is there."""
        if texture.sampler not in self.samplers:
            self.samplers.append(texture.sampler)
        return self._rows.setdefault((texture, is_color), len(self._rows))

    def make(self) -> NDArray[Any]:
        """Create the array (t,) of `TEXTURE`."""
        textures = np.zeros(len(self._rows), TEXTURE)
        for (texture, is_color), texture_index in self._rows.items():
            textures[texture_index] = (
                texture.image,
                self.samplers.index(texture.sampler),
                is_color,
                texture.uv_set,
                texture.transform,
            )
        return textures
