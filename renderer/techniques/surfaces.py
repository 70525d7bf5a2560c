"""What materials have beside numbers: textures, normal maps, masks, two sides; and vertices with more attributes.

Each class adds one of these to a `SceneShader`. A shader gets only those that its scene has and that it reads
(`bind_surfaces`): a depth pass reads the alpha of masks, and nothing else.

A texture is read in one of two ways. If all images are in one array, and all are read by texture coordinates as they
are, a texture's row is its layer. Otherwise a table of textures (`TextureUse`) leads to an array, a layer and the
transform of texture coordinates. All fragments of a primitive have one material, and so take the same branches: there,
derivatives of texture coordinates are defined, and a device skips the arrays that aren't read. llvmpipe doesn't: it
samples each array that a texture might be in. So colours are looked for in the arrays of colours alone (`images`), and
data, such as normals, in those of data (`maps`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from enum import Enum
from functools import cache
from typing import Any, Final

from renderer.frame import Effect, Frame, Needs
from renderer.scene import AlphaMode
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.structs import (
    Material,
    Object,
    SecondUv,
    SurfacePoint,
    SurfaceVarying,
    Tangent,
    TextureUse,
    Vertex,
    VertexColor,
)
from renderer.techniques.scene_shader import SHADING_PARTS, ReflectingShader, SceneShader
from rhi.shading import (
    Shader,
    Storage,
    Texture2DArray,
    cross,
    ddx,
    ddy,
    determinant,
    discard,
    dot,
    front_facing,
    mix,
    vec2,
    vec3,
    vec4,
)

_MASK: Final = int(AlphaMode.MASK)
_ROUNDING: Final = 2.0**-16
"""How far below the cut an alpha may be and still be at it: filtering rounds."""
_NO_NORMAL: Final = 5e-5
"""The square of a normal's length, below which it has no direction. No number of 8 bits means 0: a vector of length 0
is stored as 127 or 128, 1/255 beside it along each axis, and a diagonal would be made of that."""


class Aspect(Enum):
    """What a shader reads of surfaces."""

    COVERAGE = "what masks cut out"
    COLOR = "the base colour"
    SIDE = "which side is seen"
    NORMAL = "the normal"
    METAL = "how metallic and rough they are"
    AMBIENT = "occlusion and emitted light"


class MaterialShader(SceneShader, ReflectingShader):
    """The base of shaders that draw the scene's geometry with its materials."""

    materials: Storage[Material]

    def find_surface(self, v: SurfaceVarying, material: Material) -> SurfacePoint:
        normal = self.find_normal(v)
        surface = SurfacePoint(
            position=v.position,
            normal=normal,
            plane=self.find_plane(v, normal),
            to_eye=safe_normalize(-v.position),
            base_color=material.base_color.rgb * self.find_texel(v).rgb,
            specular_color=material.specular_color,
            shininess=material.shininess,
            occlusion=self.find_occlusion(v),
            emissive=self.find_emissive(v),
        )
        return self.with_model(surface, material, self.find_metal(v))

    def find_metal(self, v: SurfaceVarying) -> vec2:
        """Return how metallic and how rough the fragment is."""
        material = self.materials[v.material]
        return vec2(material.metallic, material.roughness)

    def find_occlusion(self, v: SurfaceVarying) -> float:
        """Return how much of the ambient light reaches the fragment."""
        return 1.0

    def find_emissive(self, v: SurfaceVarying) -> vec3:
        """Return what multiplies the emissive colour of the fragment's material."""
        return vec3(1.0)


class ColorReader(Shader):
    """The base of shaders that read images of colours: the layers of one array."""

    images: Texture2DArray

    def read_images(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        """Return a texel of an array, given the changes of texture coordinates to the pixels on the right and below."""
        return self.images.sample_grad(place, right, below)


class DataReader(Shader):
    """The base of shaders that read images of data, normals for example: the layers of one array."""

    maps: Texture2DArray

    def read_maps(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        """Return a texel of an array, given the changes of texture coordinates to the pixels on the right and below."""
        return self.maps.sample_grad(place, right, below)


class ColorShader(SceneShader, ColorReader):
    """The base of shaders that read textures of colours of the surfaces that they draw."""

    materials: Storage[Material]

    def read_color(self, texture: int, v: SurfaceVarying) -> vec4:
        """Return the texel of the texture of this row."""
        return self.images.sample(vec3(v.uv, float(texture)))


class DataShader(SceneShader, DataReader):
    """The base of shaders that read textures of data of the surfaces that they draw."""

    materials: Storage[Material]

    def read_data(self, texture: int, v: SurfaceVarying) -> vec4:
        """Return the texel of the texture of this row."""
        return self.maps.sample(vec3(v.uv, float(texture)))


class TableShader(SceneShader):
    """The base of shaders that find textures by a table.

    Texture coordinates are then numbers of a buffer, from which a fragment that failed a test may have read zeros
    (llvmpipe), so its neighbours would derive nonsense. Derivatives are those of the varying, transformed alike.
    """

    textures: Storage[TextureUse]

    def place_texture(self, use: TextureUse, v: SurfaceVarying) -> vec3:
        """Return the texture coordinates and the layer at which a texture is read."""
        place = vec3(self.find_uv(use.uv_set, v), 1.0)
        return vec3(dot(use.u, place), dot(use.v, place), use.layer)

    def change_right(self, use: TextureUse, v: SurfaceVarying) -> vec2:
        """Return the change of texture coordinates to the next pixel on the right."""
        right = vec3(self.find_uv_right(use.uv_set, v), 0.0)
        return vec2(dot(use.u, right), dot(use.v, right))

    def change_below(self, use: TextureUse, v: SurfaceVarying) -> vec2:
        """Return the change of texture coordinates to the next pixel below."""
        below = vec3(self.find_uv_below(use.uv_set, v), 0.0)
        return vec2(dot(use.u, below), dot(use.v, below))

    def find_uv(self, uv_set: int, v: SurfaceVarying) -> vec2:
        """Return a set of texture coordinates."""
        return v.uv

    def find_uv_right(self, uv_set: int, v: SurfaceVarying) -> vec2:
        """Return the change of a set to the next pixel on the right."""
        return ddx(v.uv)

    def find_uv_below(self, uv_set: int, v: SurfaceVarying) -> vec2:
        """Return the change of a set to the next pixel below."""
        return ddy(v.uv)


class WithColorTable(TableShader, ColorShader):
    """Textures of colours are found by a table."""

    def read_color(self, texture: int, v: SurfaceVarying) -> vec4:
        use = self.textures[texture]
        right = self.change_right(use, v)
        below = self.change_below(use, v)
        return self.read_images(use.array, self.place_texture(use, v), right, below)


class WithDataTable(TableShader, DataShader):
    """Textures of data are found by a table."""

    def read_data(self, texture: int, v: SurfaceVarying) -> vec4:
        use = self.textures[texture]
        right = self.change_right(use, v)
        below = self.change_below(use, v)
        return self.read_maps(use.array, self.place_texture(use, v), right, below)


class WithSecondUv(TableShader):
    """Some textures are read by the second set of texture coordinates."""

    def find_uv(self, uv_set: int, v: SurfaceVarying) -> vec2:
        return v.uv if uv_set == 0 else v.uv2

    def find_uv_right(self, uv_set: int, v: SurfaceVarying) -> vec2:
        first = ddx(v.uv)
        second = ddx(v.uv2)
        return first if uv_set == 0 else second

    def find_uv_below(self, uv_set: int, v: SurfaceVarying) -> vec2:
        first = ddy(v.uv)
        second = ddy(v.uv2)
        return first if uv_set == 0 else second


class WithImages1(ColorReader):
    """Adds a second array of colours."""

    images_1: Texture2DArray

    def read_images(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 1:
            return self.images_1.sample_grad(place, right, below)
        return super().read_images(array, place, right, below)


class WithImages2(ColorReader):
    """Adds a third array of colours."""

    images_2: Texture2DArray

    def read_images(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 2:
            return self.images_2.sample_grad(place, right, below)
        return super().read_images(array, place, right, below)


class WithImages3(ColorReader):
    """Adds a fourth array of colours."""

    images_3: Texture2DArray

    def read_images(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 3:
            return self.images_3.sample_grad(place, right, below)
        return super().read_images(array, place, right, below)


class WithImages4(ColorReader):
    """Adds a fifth array of colours."""

    images_4: Texture2DArray

    def read_images(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 4:
            return self.images_4.sample_grad(place, right, below)
        return super().read_images(array, place, right, below)


class WithImages5(ColorReader):
    """Adds a sixth array of colours."""

    images_5: Texture2DArray

    def read_images(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 5:
            return self.images_5.sample_grad(place, right, below)
        return super().read_images(array, place, right, below)


class WithImages6(ColorReader):
    """Adds a seventh array of colours."""

    images_6: Texture2DArray

    def read_images(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 6:
            return self.images_6.sample_grad(place, right, below)
        return super().read_images(array, place, right, below)


class WithImages7(ColorReader):
    """Adds an eighth array of colours."""

    images_7: Texture2DArray

    def read_images(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 7:
            return self.images_7.sample_grad(place, right, below)
        return super().read_images(array, place, right, below)


class WithMaps1(DataReader):
    """Adds a second array of data."""

    maps_1: Texture2DArray

    def read_maps(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 1:
            return self.maps_1.sample_grad(place, right, below)
        return super().read_maps(array, place, right, below)


class WithMaps2(DataReader):
    """Adds a third array of data."""

    maps_2: Texture2DArray

    def read_maps(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 2:
            return self.maps_2.sample_grad(place, right, below)
        return super().read_maps(array, place, right, below)


class WithMaps3(DataReader):
    """Adds a fourth array of data."""

    maps_3: Texture2DArray

    def read_maps(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 3:
            return self.maps_3.sample_grad(place, right, below)
        return super().read_maps(array, place, right, below)


class WithMaps4(DataReader):
    """Adds a fifth array of data."""

    maps_4: Texture2DArray

    def read_maps(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 4:
            return self.maps_4.sample_grad(place, right, below)
        return super().read_maps(array, place, right, below)


class WithMaps5(DataReader):
    """Adds a sixth array of data."""

    maps_5: Texture2DArray

    def read_maps(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 5:
            return self.maps_5.sample_grad(place, right, below)
        return super().read_maps(array, place, right, below)


class WithMaps6(DataReader):
    """Adds a seventh array of data."""

    maps_6: Texture2DArray

    def read_maps(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 6:
            return self.maps_6.sample_grad(place, right, below)
        return super().read_maps(array, place, right, below)


class WithMaps7(DataReader):
    """Adds an eighth array of data."""

    maps_7: Texture2DArray

    def read_maps(self, array: int, place: vec3, right: vec2, below: vec2) -> vec4:
        if array == 7:
            return self.maps_7.sample_grad(place, right, below)
        return super().read_maps(array, place, right, below)


class WithBaseMaps(ColorShader):
    """Base colours are multiplied with textures."""

    def find_texel(self, v: SurfaceVarying) -> vec4:
        texture = self.materials[v.material].texture
        if texture < 0:
            return super().find_texel(v)
        return super().find_texel(v) * self.read_color(texture, v)


class WithVertexColors(SceneShader):
    """Base colours are multiplied with those of vertices."""

    def find_texel(self, v: SurfaceVarying) -> vec4:
        return super().find_texel(v) * v.color


class WithMasks(SceneShader):
    """Nothing is drawn where the alpha of a mask is below its cut."""

    materials: Storage[Material]

    def find_texel(self, v: SurfaceVarying) -> vec4:
        texel = super().find_texel(v)
        material = self.materials[v.material]
        if material.alpha_mode == _MASK and material.base_color.a * texel.a < material.alpha_cutoff - _ROUNDING:
            discard()
        return texel


class WithNormalMaps(DataShader):
    """Normals are bent by textures. Where a texture has no direction, they are as they were."""

    def bend(self, normal: vec3, v: SurfaceVarying) -> vec3:
        material = self.materials[v.material]
        if material.normal_texture < 0:
            return normal
        texel = self.read_data(material.normal_texture, v).xyz * 2.0 - 1.0
        tangent = safe_normalize(v.tangent.xyz)
        up = cross(normal, tangent) * (-1.0 if v.tangent.w < 0.0 else 1.0)
        bent = (tangent * texel.x + up * texel.y) * material.normal_scale + normal * texel.z
        if dot(bent, bent) < _NO_NORMAL:
            return normal
        return safe_normalize(bent)


class WithPlanes(SceneShader):
    """Surfaces have the normal that maps don't bend, too: shadow maps hold these surfaces."""

    has_planes = True

    def find_plane(self, v: SurfaceVarying, normal: vec3) -> vec3:
        return self.turn_side(safe_normalize(v.normal))


class WithTwoSides(SceneShader):
    """Backs have the opposite normal. They are drawn of materials with two sides only (`DRAW_GROUPS`)."""

    def turn_side(self, normal: vec3) -> vec3:
        return normal if front_facing() else -normal


class WithRoughnessMaps(DataShader, MaterialShader):
    """How metallic and rough a surface is comes from textures: blue and green."""

    def find_metal(self, v: SurfaceVarying) -> vec2:
        texture = self.materials[v.material].metallic_roughness_texture
        if texture < 0:
            return super().find_metal(v)
        return super().find_metal(v) * self.read_data(texture, v).zy


class WithOcclusionMaps(DataShader, MaterialShader):
    """How much ambient light reaches a surface comes from textures: red."""

    def find_occlusion(self, v: SurfaceVarying) -> float:
        material = self.materials[v.material]
        if material.occlusion_texture < 0:
            return 1.0
        return mix(1.0, self.read_data(material.occlusion_texture, v).x, material.occlusion_strength)


class WithEmissiveMaps(ColorShader, MaterialShader):
    """Emissive colours are multiplied with textures."""

    def find_emissive(self, v: SurfaceVarying) -> vec3:
        texture = self.materials[v.material].emissive_texture
        if texture < 0:
            return vec3(1.0)
        return self.read_color(texture, v).rgb


class TangentShader(SceneShader):
    """The base of shaders that read tangents."""

    def turn_tangent(self, thing: Object, tangent: vec4) -> vec4:
        # A transform that mirrors an object turns its bitangents, but not the product of its normals and tangents.
        mirrors = determinant(thing.linear) < 0.0
        return vec4(thing.linear @ tangent.xyz, -tangent.w if mirrors else tangent.w)


# The vertex stages of the following parts read more attributes than that of `SceneShader`. To mypy, what overrides a
# method can be called as that is; but stages aren't called, a device runs them.


class WithUv2(SceneShader):
    """Vertices have a second set of texture coordinates."""

    def vertex(self, v: Vertex, a: SecondUv) -> SurfaceVarying:  # type: ignore[override]
        return self.transform(v, a.uv2, vec4(1.0, 0.0, 0.0, 1.0), vec4(1.0))


class WithTangents(TangentShader):
    """Vertices have tangents."""

    def vertex(self, v: Vertex, a: Tangent) -> SurfaceVarying:  # type: ignore[override]
        return self.transform(v, vec2(0.0), a.tangent, vec4(1.0))


class WithColors(SceneShader):
    """Vertices have colours."""

    def vertex(self, v: Vertex, a: VertexColor) -> SurfaceVarying:  # type: ignore[override]
        return self.transform(v, vec2(0.0), vec4(1.0, 0.0, 0.0, 1.0), a.color)


class WithUv2Tangents(TangentShader):
    """Vertices have a second set of texture coordinates and tangents."""

    def vertex(self, v: Vertex, a: SecondUv, b: Tangent) -> SurfaceVarying:  # type: ignore[override]
        return self.transform(v, a.uv2, b.tangent, vec4(1.0))


class WithUv2Colors(SceneShader):
    """Vertices have a second set of texture coordinates and colours."""

    def vertex(self, v: Vertex, a: SecondUv, b: VertexColor) -> SurfaceVarying:  # type: ignore[override]
        return self.transform(v, a.uv2, vec4(1.0, 0.0, 0.0, 1.0), b.color)


class WithTangentsColors(TangentShader):
    """Vertices have tangents and colours."""

    def vertex(self, v: Vertex, a: Tangent, b: VertexColor) -> SurfaceVarying:  # type: ignore[override]
        return self.transform(v, vec2(0.0), a.tangent, b.color)


class WithUv2TangentsColors(TangentShader):
    """Vertices have all of these."""

    def vertex(self, v: Vertex, a: SecondUv, b: Tangent, c: VertexColor) -> SurfaceVarying:  # type: ignore[override]
        return self.transform(v, a.uv2, b.tangent, c.color)


SURFACE_PARTS: Final[dict[str, type[Shader]]] = {
    "masks": WithMasks,
    "two_sides": WithTwoSides,
    "normal_maps": WithNormalMaps,
    "planes": WithPlanes,
    "roughness_maps": WithRoughnessMaps,
    "occlusion_maps": WithOcclusionMaps,
    "emissive_maps": WithEmissiveMaps,
    "vertex_colors": WithVertexColors,
    "base_maps": WithBaseMaps,
    "images_1": WithImages1,
    "images_2": WithImages2,
    "images_3": WithImages3,
    "images_4": WithImages4,
    "images_5": WithImages5,
    "images_6": WithImages6,
    "images_7": WithImages7,
    "maps_1": WithMaps1,
    "maps_2": WithMaps2,
    "maps_3": WithMaps3,
    "maps_4": WithMaps4,
    "maps_5": WithMaps5,
    "maps_6": WithMaps6,
    "maps_7": WithMaps7,
    "second_uv": WithSecondUv,
    "images_table": WithColorTable,
    "maps_table": WithDataTable,
    "uv2": WithUv2,
    "tangent": WithTangents,
    "color": WithColors,
    "uv2_tangent": WithUv2Tangents,
    "uv2_color": WithUv2Colors,
    "tangent_color": WithTangentsColors,
    "uv2_tangent_color": WithUv2TangentsColors,
}
"""The parts that can be added to a `SceneShader`, in an order in which they can be bases of one class."""

_KINDS: Final[dict[str, type[Shader]]] = {"images": ColorShader, "maps": DataShader}
"""The kinds of arrays of images, and the bases of the shaders that read them."""

_ASPECTS: Final[dict[str, tuple[Effect, frozenset[Aspect]]]] = {
    "masks": (Effect.MASKS, frozenset([Aspect.COVERAGE])),
    "two_sides": (Effect.TWO_SIDES, frozenset([Aspect.SIDE, Aspect.NORMAL])),
    "normal_maps": (Effect.NORMAL_MAPS, frozenset([Aspect.NORMAL])),
    "roughness_maps": (Effect.ROUGHNESS_MAPS, frozenset([Aspect.METAL])),
    "occlusion_maps": (Effect.OCCLUSION_MAPS, frozenset([Aspect.AMBIENT])),
    "emissive_maps": (Effect.EMISSIVE_MAPS, frozenset([Aspect.AMBIENT])),
    "vertex_colors": (Effect.VERTEX_COLORS, frozenset([Aspect.COLOR])),
    "base_maps": (Effect.IMAGES, frozenset([Aspect.COLOR])),
}
"""The effects that call for parts, and what they are about."""


def bind_surfaces(
    frame: Frame,
    aspects: Collection[Aspect] = tuple(Aspect),
    *,
    has_materials: bool = True,
    has_tangents: bool = False,
) -> tuple[list[str], dict[str, Any]]:
    """Return the names of the parts by which a `SceneShader` reads these aspects of surfaces, and its bindings.

    Args:
        has_materials: whether the shader reads materials whatever its parts are. has_tangents: likewise tangents.
    """
    resources, effects = frame.resources, frame.needs.effects
    wanted = set(aspects)
    if Aspect.COVERAGE in wanted and Effect.MASKS in effects:
        wanted.add(Aspect.COLOR)
    parts = [name for name, (effect, about) in _ASPECTS.items() if effect in effects and about & wanted]
    bindings: dict[str, Any] = {
        "view": frame.view.buffer,
        "objects": resources.objects.buffer,
        "places": resources.places.buffer,
    }
    attributes = {"tangent": has_tangents or "normal_maps" in parts, "color": "vertex_colors" in parts}
    if "normal_maps" in parts and frame.needs.has_planes:
        parts.append("planes")
    kinds = [
        kind
        for kind, base in _KINDS.items()
        if any(issubclass(SURFACE_PARTS[name], base) for name in parts)
    ]
    if kinds:
        arrays, images = bind_images(frame, kinds)
        parts, bindings = [*parts, *arrays], bindings | images
        if "textures" in images:
            attributes["uv2"] = Effect.SECOND_UVS in effects
            parts += ["second_uv"] if attributes["uv2"] else []
            parts += [f"{kind}_table" for kind in kinds]
    if has_materials or any(_reads_materials(SURFACE_PARTS[name]) for name in parts):
        bindings["materials"] = resources.materials.buffer
    present = [name for name in ("uv2", "tangent", "color") if attributes.get(name)]
    return [*parts, *(["_".join(present)] if present else [])], bindings


def bind_images(frame: Frame, kinds: Sequence[str] = tuple(_KINDS)) -> tuple[list[str], dict[str, Any]]:
    """Return the names of the parts that a `ColorReader`, a `DataReader` or both need for the arrays of the scene's
    images but the first of each kind, and its bindings: `textures` is among them if textures are found by a table."""
    images = frame.resources.images
    assert images is not None, "a texture is read"
    parts: list[str] = []
    bindings: dict[str, Any] = {}
    for kind in kinds:
        arrays = images.colors if kind == "images" else images.data
        names = [f"{kind}_{number}" if number else kind for number in range(len(arrays))]
        parts += names[1:]
        bindings |= dict(zip(names, arrays, strict=True))
    return parts, bindings | ({} if images.table is None else {"textures": images.table})


def _reads_materials(part: type[Shader]) -> bool:
    return any("materials" in vars(base).get("__annotations__", {}) for base in part.__mro__)


def surface_variant(base: type[SceneShader], parts: Sequence[str]) -> type[Shader]:
    """Return a shader that draws the scene's geometry, with these of `SHADING_PARTS` and `SURFACE_PARTS`."""
    known = SHADING_PARTS | SURFACE_PARTS
    return _combine((*(known[part] for part in parts), base))


@cache
def _combine(bases: tuple[type[Shader], ...]) -> type[Shader]:
    return type(bases[-1].__name__, bases, {"__module__": __name__})


def list_models(needs: Needs) -> list[str]:
    """Return the names of the parts that a `ReflectingShader` needs for the models of the scene's materials."""
    if Effect.METALS not in needs.effects:
        return []
    return ["both_models" if needs.has_both_models else "metals"]
