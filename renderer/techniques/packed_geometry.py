"""The packed geometry buffer: what a pixel's surface is, before its material is evaluated (Deferred+, 1.3.2).

| word of `packed` | bits | what it holds |
|---|---|---|
| 0 | 32 | the normal, octahedral in 2 × 16 bits |
| 1 | 16 + 16 | the row of the material; the rest of the change of texture coordinates in y |
| 2 | 32 | the fractional parts of the texture coordinates |
| 3 | 24 + 8 | the change of texture coordinates in x; the beginning of that in y |

Its format is RGBA32UI, 16 bytes a pixel; a scene without images has the first two words only, RG32UI. The position
follows from the depth and the ray of the pixel. No texel is read when geometry is drawn: a texture is filtered
later, with the derivatives that are stored, so what is hidden costs no texel.

The encodings are those of `renderer.shaders.encodings`.
"""

from __future__ import annotations

from typing import Any, Final

from renderer import rules
from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target, TechniquePass
from renderer.shaders.encodings import (
    decode_change,
    decode_normal,
    decode_uv,
    encode_change,
    encode_normal,
    encode_uv,
)
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.structs import Material, SurfacePoint, SurfaceVarying, TextureUse
from renderer.techniques.scene_shader import ReflectingShader, SceneShader
from renderer.techniques.surfaces import (
    SURFACE_PARTS,
    Aspect,
    ImageShader,
    bind_images,
    bind_surfaces,
    surface_variant,
)
from rhi import Format, refuse
from rhi.shading import (
    Shader,
    Storage,
    Struct,
    Texture2D,
    UintTexture2D,
    ddx,
    ddy,
    uint,
    uvec2,
    uvec4,
    vec2,
    vec3,
)

__rhi_internal__ = True

MOST_MATERIALS: Final = 1 << 16
"""The number of materials that the buffer can tell apart."""


_UNPACKED: Final = (
    Effect.NORMAL_MAPS,
    Effect.ROUGHNESS_MAPS,
    Effect.OCCLUSION_MAPS,
    Effect.EMISSIVE_MAPS,
    Effect.VERTEX_COLORS,
    Effect.SECOND_UVS,
    Effect.TEXTURE_TRANSFORMS,
)


class PlainWords(Struct):
    """What `PackedShader` writes."""

    packed: uvec2


class TexturedWords(Struct):
    """What `PackedTextures` writes."""

    packed: uvec4


class PackedShader(SceneShader):
    """Writes the packed geometry buffer of a scene without images."""

    def fragment(self, v: SurfaceVarying) -> PlainWords:
        _ = self.find_texel(v)  # which leaves out what isn't drawn
        return PlainWords(packed=uvec2(encode_normal(self.find_normal(v)), uint(v.material)))


class PackedTextures(SceneShader):
    """Writes the packed geometry buffer of a scene with images."""

    def fragment(self, v: SurfaceVarying) -> TexturedWords:
        x = encode_change(ddx(v.uv))
        y = encode_change(ddy(v.uv))
        _ = self.find_texel(v)  # which leaves out what isn't drawn
        words = uvec4(
            encode_normal(self.find_normal(v)),
            uint(v.material) | y >> 8 << 16,
            encode_uv(v.uv),
            x | y << 24,
        )
        return TexturedWords(packed=words)


class PackedReader(ReflectingShader):
    """The base of shaders that evaluate the materials of the packed geometry buffer."""

    packed: UintTexture2D
    depth: Texture2D
    materials: Storage[Material]

    def find_surface(self, words: uvec4, material: Material, position: vec3) -> SurfacePoint:
        """Return the surface at `position` whose words were loaded."""
        surface = SurfacePoint(
            position=position,
            normal=decode_normal(words.x),
            to_eye=safe_normalize(-position),
            base_color=material.base_color.rgb * self.read_texel(material.texture, words),
            specular_color=material.specular_color,
            shininess=material.shininess,
            occlusion=1.0,
            emissive=vec3(1.0),
        )
        return self.with_model(surface, material, vec2(material.metallic, material.roughness))

    def read_texel(self, texture: int, words: uvec4) -> vec3:
        return vec3(1.0)


class PackedImages(PackedReader, ImageShader):
    """Adds images, filtered as they would have been when the geometry was drawn."""

    def read_texel(self, texture: int, words: uvec4) -> vec3:
        if texture < 0:
            return vec3(1.0)
        x = decode_change(words.w & 0xFFFFFF)
        y = decode_change(words.w >> 24 | words.y >> 16 << 8)
        return self.read_image(texture, decode_uv(words.z), x, y)

    def read_image(self, texture: int, uv: vec2, right: vec2, below: vec2) -> vec3:
        """Return the texel of the texture of this row."""
        return self.images.sample_grad(vec3(uv, float(texture)), right, below).rgb


class PackedTable(PackedImages):
    """Finds textures by a table."""

    textures: Storage[TextureUse]

    def read_image(self, texture: int, uv: vec2, right: vec2, below: vec2) -> vec3:
        use = self.textures[texture]
        return self.read_array(use.array, vec3(uv, use.layer), right, below).rgb


def can_pack(needs: Needs) -> bool:
    """Return whether all that the scene's materials read is in the buffer: textures by one set of repeated texture
    coordinates, and no tangents and colours of vertices."""
    return needs.effects.isdisjoint(_UNPACKED)


def packed_pass(needs: Needs) -> Pass[Frame]:
    """Return the pass that draws the packed geometry buffer: `packed` and `depth`."""
    has_images = Effect.IMAGES in needs.effects
    return Pass(
        "geometry",
        draw_packed,
        "stores the nearest surface of each pixel, without its material",
        writes=(
            Target("packed", Format.RGBA32UI if has_images else Format.RG32UI),
            Target("depth", DEPTH_FORMAT),
        ),
    )


def draw_packed(frame: Frame) -> None:
    """Draw the visible objects to the packed geometry buffer."""
    resources = frame.resources
    count = len(resources.scene.materials)
    if count > MOST_MATERIALS:
        refuse(rules.MANY_MATERIALS, "render", f"{count:,} materials", f"at most {MOST_MATERIALS:,}")
    parts, bindings = bind_surfaces(frame, (Aspect.COVERAGE, Aspect.NORMAL), has_materials=False)
    base = PackedTextures if Effect.IMAGES in frame.needs.effects else PackedShader
    frame.draw_visible(
        TechniquePass(
            frame.device,
            resources,
            frame.view,
            frame.device.program(surface_variant(base, parts)),
            bindings,
            color=frame.targets["packed"],
            depth=frame.targets["depth"],
        )
    )


def bind_packed(frame: Frame) -> tuple[tuple[type[Shader], ...], dict[str, Any]]:
    """Return the parts that a `PackedReader` needs for the scene's images, and its bindings."""
    bindings: dict[str, Any] = {
        "packed": frame.targets["packed"],
        "depth": frame.targets["depth"],
        "materials": frame.resources.materials.buffer,
    }
    if Effect.IMAGES not in frame.needs.effects:
        return (), bindings
    names, images = bind_images(frame)
    reader = PackedTable if "textures" in images else PackedImages
    return (*(SURFACE_PARTS[name] for name in names), reader), bindings | images
