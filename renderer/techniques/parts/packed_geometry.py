"""The packed geometry buffer: what a pixel's surface is, before its material is evaluated (Deferred+, 1.3.2).

| word of `packed` | bits | what it holds |
|---|---|---|
| 0 | 32 | the normal, octahedral in 2 × 16 bits; if the scene has normal maps the normal and the tangent |
| 1 | 16 + 16 | the row of the material; the rest of the change of texture coordinates in y |
| 2 | 32 | the fractional parts of the texture coordinates |
| 3 | 24 + 8 | the change of texture coordinates in x; the beginning of that in y |

Its format is RGBA32UI, 16 bytes a pixel; a scene without images has the first two words only, RG32UI. The position
follows from the depth and the ray of the pixel. Texture coordinates are stored as the material's textures are read, a
transform applied. Texels are read when geometry is drawn only where masks cut it: a
texture is filtered later, with the derivatives that are stored, so what is hidden costs no texel.

Materials are evaluated by the parts that draw geometry in other techniques (`surfaces`), given a surface of the buffer
instead of varyings. Only where texture coordinates and their derivatives come from is another matter.

The encodings are those of `renderer.shaders.encodings`.
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl
from renderer import rules
from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target
from renderer.shaders.encodings import (
    TangentFrame,
    away_from_zero,
    decode_change,
    decode_frame,
    decode_normal,
    decode_uv,
    encode_change,
    encode_frame,
    encode_normal,
    encode_uv,
)
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.pixels import BackgroundScreen
from renderer.shaders.structs import SurfaceVarying, TextureUse
from renderer.techniques.parts.scene_shader import MaterialShader, SceneShader
from renderer.techniques.parts.variants import scene_pass
from rhi import Format, refuse

MOST_MATERIALS: Final = 1 << 16
"""The number of materials that the buffer can tell apart."""

_UNPACKED: Final = (Effect.VERTEX_COLORS, Effect.SECOND_UVS, Effect.MIXED_COORDINATES)


class PlainWords(sl.Struct):
    """The texels that `PackedPlain` writes."""

    packed: sl.uvec2


class TexturedWords(sl.Struct):
    """The texels that `PackedTextures` writes."""

    packed: sl.uvec4


class PackedPlain(SceneShader):
    """Writes the packed geometry buffer of a scene without images."""

    def fragment(self, v: SurfaceVarying) -> PlainWords:
        self.cut(v)
        return PlainWords(packed=sl.uvec2(encode_normal(self.find_side(v)), sl.uint(v.material)))

    def find_side(self, v: SurfaceVarying) -> sl.vec3:
        """Return the normal of the side that is seen, not bent."""
        return self.turn_side(safe_normalize(v.normal))


class PackedTextures(PackedPlain):
    """Writes the packed geometry buffer of a scene with images."""

    has_texture_transforms = False

    def fragment(self, v: SurfaceVarying) -> TexturedWords:  # type: ignore[override]  # more words
        x = encode_change(self.put(v, sl.vec3(sl.ddx(v.uv), 0.0)))
        y = encode_change(self.put(v, sl.vec3(sl.ddy(v.uv), 0.0)))
        self.cut(v)
        words = sl.uvec4(
            self.encode_directions(v),
            sl.uint(v.material) | y >> 8 << 16,
            encode_uv(self.put(v, sl.vec3(v.uv, 1.0))),
            x | y << 24,
        )
        return TexturedWords(packed=words)

    def encode_directions(self, v: SurfaceVarying) -> sl.uint:
        normal = self.find_side(v)
        if not self.has_normal_maps:
            return encode_normal(normal)
        # Of a back the bent normal is turned, and so are all vectors that it is made of.
        turned = away_from_zero(sl.dot(normal, v.normal))
        tangent = safe_normalize(v.tangent.xyz) * turned
        return encode_frame(TangentFrame(normal=normal, tangent=tangent, side=away_from_zero(v.tangent.w) * turned))

    def put(self, v: SurfaceVarying, uv: sl.vec3) -> sl.vec2:
        """Return texture coordinates (u, v, 1), or changes of them (u, v, 0), as the material's textures are read: all
        of a material have the same transform."""
        if not self.has_texture_transforms:
            return uv.xy
        material = self.materials[v.material]
        maps = sl.max(sl.max(material.texture, material.normal_texture), material.metallic_roughness_texture)
        row = sl.max(maps, sl.max(material.occlusion_texture, material.emissive_texture))
        if row < 0:
            return uv.xy
        use = self.textures[row]
        return sl.vec2(sl.dot(use.u, uv), sl.dot(use.v, uv))


# Where `PackedReader` is a base, mypy finds two vertex stages of different types: that of `BackgroundScreen`, which it
# has, and that of `SceneShader`, from which the parts of materials are derived.
class PackedReader(BackgroundScreen, MaterialShader):  # type: ignore[misc]
    """The base of shaders that evaluate the materials of the packed geometry buffer, pixel by pixel."""

    packed: sl.UintTexture2D
    depth: sl.Texture2D

    def read_words(self) -> sl.uvec4:
        """Return what is stored of the pixel."""
        return self.packed.load(sl.ivec2(sl.fragment_coordinate().xy))

    def read_varying(self, position: sl.vec3) -> SurfaceVarying:
        """Return the varyings of the pixel's surface, which is at `position`."""
        words = self.read_words()
        frame = self.decode_directions(words.x)
        return SurfaceVarying(
            clip=sl.vec4(0.0),
            position=position,
            normal=frame.normal,
            uv=decode_uv(words.z),
            uv2=sl.vec2(0.0),
            tangent=sl.vec4(frame.tangent, frame.side),
            color=sl.vec4(1.0),
            material=int(words.y & 65535),
            lights=sl.ivec3(0),
        )

    def decode_directions(self, bits: sl.uint) -> TangentFrame:
        if self.has_normal_maps:
            return decode_frame(bits)
        return TangentFrame(normal=decode_normal(bits), tangent=sl.vec3(1.0, 0.0, 0.0), side=1.0)

    def turn_side(self, normal: sl.vec3) -> sl.vec3:
        return normal  # which side is seen was found when the geometry was drawn

    def find_change(self) -> sl.vec4:
        """Return the changes of texture coordinates to the next pixel on the right, and to that below."""
        words = self.read_words()
        x = decode_change(words.w & 0xFFFFFF)
        y = decode_change(words.w >> 24 | words.y >> 16 << 8)
        return sl.vec4(x, y)

    # Textures are filtered as they would have been when the geometry was drawn, at the coordinates that are stored.

    def read_color(self, texture: int, v: SurfaceVarying) -> sl.vec4:
        if self.has_table:
            return super().read_color(texture, v)
        change = self.find_change()
        return self.images.sample_grad(sl.vec3(v.uv, float(texture)), change.xy, change.zw)

    def read_data(self, texture: int, v: SurfaceVarying) -> sl.vec4:
        if self.has_table:
            return super().read_data(texture, v)
        change = self.find_change()
        return self.maps.sample_grad(sl.vec3(v.uv, float(texture)), change.xy, change.zw)

    def place(self, use: TextureUse, v: SurfaceVarying) -> sl.vec3:
        return sl.vec3(v.uv, use.layer)

    def change_right(self, use: TextureUse, v: SurfaceVarying) -> sl.vec2:
        return self.find_change().xy

    def change_below(self, use: TextureUse, v: SurfaceVarying) -> sl.vec2:
        return self.find_change().zw


def can_pack(needs: Needs) -> bool:
    """Return whether all that the scene's materials read is in the buffer: repeated textures, all of a material at the
    same place, and no colours of vertices."""
    return needs.effects.isdisjoint(_UNPACKED)


def _has_textures(needs: Needs) -> bool:
    maps = Effect.IMAGES, Effect.NORMAL_MAPS, Effect.ROUGHNESS_MAPS, Effect.OCCLUSION_MAPS, Effect.EMISSIVE_MAPS
    return not needs.effects.isdisjoint(maps)


def packed_pass(needs: Needs) -> Pass[Frame]:
    """Return the pass that draws the packed geometry buffer: `packed` and `depth`."""
    return Pass(
        "geometry",
        draw_packed,
        "stores the nearest surface of each pixel, without its material",
        writes=(
            Target("packed", Format.RGBA32UI if _has_textures(needs) else Format.RG32UI),
            Target("depth", DEPTH_FORMAT),
        ),
    )


def draw_packed(frame: Frame) -> None:
    """Draw the visible objects to the packed geometry buffer."""
    count = len(frame.resources.scene.materials)
    if count > MOST_MATERIALS:
        refuse(rules.MANY_MATERIALS, "render", f"{count:,} materials", f"at most {MOST_MATERIALS:,}")
    shader = PackedTextures if _has_textures(frame.needs) else PackedPlain
    frame.draw_visible(scene_pass(frame, shader, color=frame.targets["packed"]))


UNPACKED: Final = {"has_masks": False, "has_vertex_colors": False}
"""Switches of shaders that read the buffer: what was cut is left out."""
