"""Materials, textures, images and samplers of a glTF file.

Images are collected first and decoded together, in threads. One that is missing or can't be decoded is left
out, and materials go without it: the rest of the file can still be seen, and the report says what is missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.content.assets import decode_images
from renderer.content.gltf.container import GltfFile
from renderer.content.gltf.document import JsonObject
from renderer.content.gltf.extras import SPECULAR, get_extras
from renderer.content.gltf.nodes import CANDELA
from renderer.content.material_shaders import Brushed
from renderer.scene.images import ImagePixels, check_image
from renderer.scene.materials import RANGES, AlphaMode, TextureMap
from renderer.scene.omissions import Omissions
from renderer.scene.scene_builder import SceneBuilder
from rhi import Filter, SamplerDescriptor, Wrap
from rhi.errors import RhiError

ALPHA_MODES: Final = {"OPAQUE": AlphaMode.OPAQUE, "MASK": AlphaMode.MASK, "BLEND": AlphaMode.BLEND}
MAGNIFY: Final = {9728: Filter.NEAREST, 9729: Filter.LINEAR}
MINIFY: Final = {
    9728: (Filter.NEAREST, None),
    9729: (Filter.LINEAR, None),
    9984: (Filter.NEAREST, Filter.NEAREST),
    9985: (Filter.LINEAR, Filter.NEAREST),
    9986: (Filter.NEAREST, Filter.LINEAR),
    9987: (Filter.LINEAR, Filter.LINEAR),
}
WRAPS: Final = {10497: Wrap.REPEAT, 33071: Wrap.CLAMP, 33648: Wrap.MIRROR}

_STRONGEST: Final = 1e6  # of emitted light
_UNLIT: Final = (
    2.0**19
)  # times what an unlit material reflects of light, it emits; a power of two rounds nothing
_DEFAULT: Final = {"base_color": (1.0, 1.0, 1.0), "metallic": 1.0, "roughness": 1.0}


class Materials:
    """Reads materials into a builder.

    Attributes:
        builder: the scene under construction.
        omissions: what was left out.
    """

    def __init__(self, file: GltfFile, builder: SceneBuilder, omissions: Omissions) -> None:
        self.builder, self.omissions = builder, omissions
        self._file = file
        self._images = file.root.children("images")
        self._textures = file.root.children("textures")
        self._samplers = [_read_sampler(fields) for fields in file.root.children("samplers")]
        self._ids: dict[int, int] = {}
        self._read_values: dict[int, tuple[dict[str, Any], dict[str, Any]]] = {-1: (_DEFAULT, {})}
        self._material_ids: dict[tuple[int, bool], int] = {}

    def add_all(self, selected: Set[int] | None = None) -> None:
        """Add all materials of the file, or those with the numbers `selected`, and the images that they use."""
        read = {
            number: self._read(fields)
            for number, fields in enumerate(self._file.root.children("materials"))
            if selected is None or number in selected
        }
        self._add_images({use[0] for _, maps in read.values() for use in maps.values()})
        for number, (values, maps) in read.items():
            used = {name: (image, rest) for name, (image, rest) in maps.items() if image in self._ids}
            textures = {name: TextureMap(self._ids[image], **rest) for name, (image, rest) in used.items()}
            self._read_values[number] = values, textures
            self.get(number)

    def get(self, number: int, is_unlit: bool = False) -> int:
        """Return the id of a material of the file, or of the default one for -1; or of its unlit likeness.
        What isn't there yet is added."""
        key = number, is_unlit
        if key not in self._material_ids:
            values, textures = self._read_values[number]
            if is_unlit:
                values, textures = (
                    _make_unlit(values),
                    {name: textures[name] for name in textures.keys() & {"texture"}},
                )
            self._material_ids[key] = self.builder.add_material(**values, **textures)
        return self._material_ids[key]

    def normal_map_uv(self, number: int) -> str:
        """Return the set of texture coordinates by which a material needs tangents, `uv` or `uv2`; "" if it needs none,
        which is without a normal map and anisotropy."""
        values, textures = self._read_values[number]
        texture = textures.get("normal_texture")
        if texture is None:
            return "uv" if "shader" in values else ""
        return "uv2" if texture.uv_set else "uv"

    def _read_anisotropy(
        self, values: dict[str, Any], maps: dict[str, tuple[int, dict[str, Any]]], fields: JsonObject
    ) -> None:
        """Note the shader of an anisotropic material. It reads its textures as they are."""
        anisotropy = fields.extension("KHR_materials_anisotropy")
        if anisotropy is None:
            return
        strength = anisotropy.real("anisotropyStrength", 0.0, 0.0, 1.0)
        rotation = anisotropy.real("anisotropyRotation", 0.0)
        turned: dict[str, tuple[int, dict[str, Any]]] = {}
        self._read_map(turned, "anisotropy_texture", anisotropy, "anisotropyTexture")
        if strength == 0.0:
            return
        if not all(_is_plain(rest) for _, rest in (maps | turned).values()):
            self.omissions.add("anisotropy beside textures that are transformed or clamped", fields.where)
            return
        maps |= turned
        values |= {"shader": Brushed, "anisotropy": strength, "anisotropy_rotation": rotation}

    def _read(self, fields: JsonObject) -> tuple[dict[str, Any], dict[str, tuple[int, dict[str, Any]]]]:
        """Return the arguments of `add_material`, and for each texture the image and how it is read."""
        fields.child("extensions")  # what isn't read of them is noted for the whole file
        pbr = fields.child("pbrMetallicRoughness")
        mode = ALPHA_MODES[fields.choice("alphaMode", ALPHA_MODES, "OPAQUE")]
        values: dict[str, Any] = {
            "base_color": _colors(pbr, "baseColorFactor", 4),
            "alpha_mode": mode,
            "alpha_cutoff": fields.real("alphaCutoff", 0.5, 0.0, 1e4),
            "double_sided": fields.flag("doubleSided"),
        }
        maps: dict[str, tuple[int, dict[str, Any]]] = {}
        self._read_map(maps, "texture", pbr, "baseColorTexture")
        light_map = fields.extension("MOZ_lightmap")
        if fields.extension("KHR_materials_unlit") is not None:
            if light_map is not None:
                self.omissions.add("light maps of unlit materials", fields.where)
            return _make_unlit(values), maps
        values["metallic"] = pbr.real("metallicFactor", 1.0, 0.0, 1.0)
        values["roughness"] = pbr.real("roughnessFactor", 1.0, 0.0, 1.0)
        self._read_map(maps, "metallic_roughness_texture", pbr, "metallicRoughnessTexture")
        scale = fields.child("normalTexture").real("scale", 1.0, -1e4, 1e4)
        occlusion = fields.child("occlusionTexture").real("strength", 1.0, 0.0, 1.0)
        if self._read_map(maps, "normal_texture", fields, "normalTexture"):
            values["normal_scale"] = scale
        if self._read_map(maps, "occlusion_texture", fields, "occlusionTexture"):
            values["occlusion_strength"] = occlusion
        strength = fields.extension("KHR_materials_emissive_strength")
        factor = 1.0 if strength is None else strength.real("emissiveStrength", 1.0, 0.0, _STRONGEST)
        emissive = np.minimum(_colors(fields, "emissiveFactor", 3, 0.0) * factor, _STRONGEST)
        values["emissive"] = tuple(emissive.tolist())
        self._read_map(maps, "emissive_texture", fields, "emissiveTexture")
        self._read_anisotropy(values, maps, fields)
        if light_map is not None and self._read_texture(maps, "light_map_texture", light_map, uv_set=1):
            intensity = light_map.real("intensity", 1.0, 0.0, _STRONGEST)
            values["light_map_color"] = (intensity * CANDELA,) * 3
        extras = get_extras(fields)
        return (values if extras is None else _restore(extras, values, maps)), maps

    def _read_map(
        self, maps: dict[str, tuple[int, dict[str, Any]]], name: str, holder: JsonObject, field: str
    ) -> bool:
        """Note the texture that a field of `holder` describes under `name`, if it has that field."""
        return field in holder and self._read_texture(maps, name, holder.child(field))

    def _read_texture(
        self, maps: dict[str, tuple[int, dict[str, Any]]], name: str, fields: JsonObject, uv_set: int = 0
    ) -> bool:
        """Note the texture that `fields` describe under `name`, and return whether it can be read; `uv_set` is the set
        of texture coordinates if they say none."""
        number = fields.index("index", len(self._textures), required=True)
        texture = self._textures[number]
        holder = texture.extension("EXT_texture_webp") or texture
        image = holder.index("source", len(self._images))
        blocks = texture.extension("KHR_texture_basisu")
        if image < 0 and blocks is not None:
            image = blocks.index("source", len(self._images))
        if image < 0:
            others = ", ".join(texture.child("extensions").values) or "no source"
            self.omissions.add(f"textures with {others}", texture.where)
            return False
        rest: dict[str, Any] = {}
        sampler = texture.index("sampler", len(self._samplers))
        if sampler >= 0:
            rest["sampler"] = self._samplers[sampler]
        uv_set = fields.whole("texCoord", uv_set)
        transform = fields.extension("KHR_texture_transform")
        if transform is not None:
            uv_set = transform.whole("texCoord", uv_set)
            rest["offset"] = tuple(transform.reals("offset", 2, (0.0, 0.0)).tolist())
            rest["rotation"] = transform.real("rotation", 0.0)
            rest["scale"] = tuple(transform.reals("scale", 2, (1.0, 1.0)).tolist())
        if uv_set > 1:
            self.omissions.add(f"texture coordinates {uv_set}: set 0 is used", fields.where)
        rest["uv_set"] = uv_set if uv_set < 2 else 0
        maps[name] = (image, rest)
        return True

    def _add_images(self, numbers: set[int]) -> None:
        """Decode the images `numbers`, and add the readable ones."""
        contents: dict[int, NDArray[np.uint8]] = {}
        for number in sorted(numbers):
            fields = self._images[number]
            extras = get_extras(fields)
            if extras is not None:
                self._ids[number] = self.builder.add_image(self._read_high_range(extras))
                continue
            try:
                view = fields.index("bufferView", len(self._file.views))
                contents[number] = self._file.view(view) if view >= 0 else self._file.read(fields)
                self._file.budget.spend_image(contents[number].tobytes())
            except RhiError as error:
                if "bufferView" in fields or error.rule is rules.MODEL_LIMIT:
                    raise
                self.omissions.add(f"an image that can't be read ({error.given})", fields.where)
        for number, pixels in zip(contents, decode_images(contents.values()), strict=True):
            if isinstance(pixels, str):
                self.omissions.add(f"an image that can't be read ({pixels})", self._images[number].where)
                continue
            try:
                self._ids[number] = self.builder.add_image(pixels)
            except RhiError as error:  # blocks that decode to infinity
                where = self._images[number].where
                self.omissions.add(f"an image that can't be read ({error.given})", where)

    def _read_high_range(self, extras: JsonObject) -> ImagePixels:
        """Return the texels that `save_scene` has written beside an image."""
        view = extras.index("texels", len(self._file.views), required=True)
        height, width = (int(side) for side in extras.reals("size", 2, (0.0, 0.0), 0.0, float(1 << 24)))
        self._file.budget.spend_pixels(height * width)
        content = self._file.view(view)
        if not height * width or content.nbytes != 8 * height * width:
            extras.refuse("size", f"{height} × {width} of {content.nbytes} bytes", "8 bytes a texel")
        texels = np.frombuffer(content.tobytes(), "<f2").reshape(height, width, 4)
        try:
            return check_image(texels)
        except RhiError as error:
            extras.refuse("texels", error.given, error.allowed)


def _make_unlit(values: dict[str, Any]) -> dict[str, Any]:
    """Return a material that emits its base colour. Textures and colours of vertices multiply the base
    colour, so it is a small one that is emitted many times; what it reflects can't be seen."""
    if values.get("emission"):
        return values
    *color, alpha = (float(value) for value in values["base_color"])
    return {
        name: values[name] for name in ("alpha_mode", "alpha_cutoff", "double_sided") if name in values
    } | {
        "base_color": (*(value / _UNLIT for value in color), alpha),
        "specular_color": (0.0, 0.0, 0.0),
        "emission": _UNLIT,
    }


def _is_plain(rest: Mapping[str, Any]) -> bool:
    """Test whether a texture is repeated, as the first set of texture coordinates says."""
    texture = TextureMap(0, **rest)
    wraps = {texture.sampler.wrap_u, texture.sampler.wrap_v}
    return texture == TextureMap(0, sampler=texture.sampler) and wraps == {Wrap.REPEAT}


def _restore(
    extras: JsonObject, values: dict[str, Any], maps: dict[str, tuple[int, dict[str, Any]]]
) -> dict[str, Any]:
    """Return a material's values, with the saved originals of values that glTF can only approximate."""
    restored = dict(values)
    if "emission" in extras:
        if "shininess" not in extras:
            extras.refuse("shininess", None, "a number beside emission, which only the specular model has")
        restored["emission"] = extras.real("emission", low=0.0, high=_STRONGEST)
        restored["emissive"] = tuple(_colors(extras, "emissive", 3, high=_STRONGEST).tolist())
        if not extras.flag("has_emissive_texture", True):
            maps.pop("emissive_texture", None)
    if "light_map_color" in extras:
        restored["light_map_color"] = tuple(_colors(extras, "light_map_color", 3, high=_STRONGEST).tolist())
    if "shininess" in extras:
        for name in ("metallic", "roughness"):
            del restored[name]
        maps.pop("metallic_roughness_texture", None)
        restored["specular_color"] = tuple(_colors(extras, "specular_color", 3).tolist())
        for name in SPECULAR:
            if name != "specular_color":
                low, high = RANGES[name]
                restored[name] = extras.real(name, low=low, high=high)
    return restored


def _colors(
    fields: JsonObject, name: str, size: int, default: float = 1.0, high: float = 1e4
) -> NDArray[np.float64]:
    return fields.reals(name, size, (default,) * size, 0.0, high)


def _read_sampler(fields: JsonObject) -> SamplerDescriptor:
    def code(name: str, allowed: dict[int, Any], default: int) -> Any:
        value = fields.whole(name, default)
        if value not in allowed:
            fields.refuse(name, value, ", ".join(map(str, allowed)))
        return allowed[value]

    minify, mip = code("minFilter", MINIFY, 9987)
    return SamplerDescriptor(
        minify,
        code("magFilter", MAGNIFY, 9729),
        mip,
        code("wrapS", WRAPS, 10497),
        code("wrapT", WRAPS, 10497),
    )
