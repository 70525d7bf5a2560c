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

Materials are evaluated by the `MaterialShader` that other techniques draw geometry with, given a point of the buffer
instead of a fragment's.

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
from renderer.shaders.materials import MaterialShader
from renderer.shaders.pixels import BackgroundScreen
from renderer.shaders.structs import SurfaceInput, SurfaceVarying
from renderer.techniques.parts.scene_shader import SceneShader
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

    is_coverage = True

    def fragment(self, v: SurfaceVarying) -> PlainWords:
        at = self.take(v)
        self.cut(at)
        return PlainWords(packed=sl.uvec2(encode_normal(at.normal), sl.uint(v.material)))


class PackedTextures(SceneShader):
    """Writes the packed geometry buffer of a scene with images."""

    is_coverage = True
    has_texture_transforms = False

    def fragment(self, v: SurfaceVarying) -> TexturedWords:
        x = encode_change(self.put(v, sl.vec3(sl.ddx(v.uv), 0.0)))
        y = encode_change(self.put(v, sl.vec3(sl.ddy(v.uv), 0.0)))
        at = self.take(v)
        self.cut(at)
        words = sl.uvec4(
            self.encode_directions(at),
            sl.uint(v.material) | y >> 8 << 16,
            encode_uv(self.put(v, sl.vec3(v.uv, 1.0))),
            x | y << 24,
        )
        return TexturedWords(packed=words)

    def encode_directions(self, at: SurfaceInput) -> sl.uint:
        if not self.has_normal_maps:
            return encode_normal(at.normal)
        side = away_from_zero(at.tangent.w)
        return encode_frame(TangentFrame(normal=at.normal, tangent=safe_normalize(at.tangent.xyz), side=side))

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


class PackedReader(BackgroundScreen, MaterialShader):
    """The base of shaders that evaluate the materials of the packed geometry buffer, pixel by pixel. Textures are
    filtered as they would have been when the geometry was drawn."""

    packed: sl.UintTexture2D
    depth: sl.Texture2D

    def read_input(self, position: sl.vec3) -> SurfaceInput:
        """Return the point of the pixel's surface, which is at `position`."""
        words = self.packed.load(sl.ivec2(sl.fragment_coordinate().xy))
        frame = self.decode_directions(words.x)
        right = decode_change(words.w & 0xFFFFFF)
        below = decode_change(words.w >> 24 | words.y >> 16 << 8)
        return SurfaceInput(
            position=position,
            normal=frame.normal,
            uv=decode_uv(words.z),
            uv2=sl.vec2(0.0),
            changes=sl.vec4(right, below),
            changes2=sl.vec4(0.0),
            tangent=sl.vec4(frame.tangent, frame.side),
            color=sl.vec4(1.0),
            material=int(words.y & 65535),
        )

    def decode_directions(self, bits: sl.uint) -> TangentFrame:
        if self.has_normal_maps:
            return decode_frame(bits)
        return TangentFrame(normal=decode_normal(bits), tangent=sl.vec3(1.0, 0.0, 0.0), side=1.0)


def can_pack(needs: Needs) -> bool:
    """Return whether all that the scene's materials read is in the buffer: repeated textures, all of a material at the
    same place, and no colours of vertices."""
    return needs.effects.isdisjoint(_UNPACKED)


def _has_textures(needs: Needs) -> bool:
    own = Effect.MATERIAL_SHADERS
    maps = Effect.IMAGES, Effect.NORMAL_MAPS, Effect.ROUGHNESS_MAPS, Effect.OCCLUSION_MAPS, Effect.EMISSIVE_MAPS
    return not needs.effects.isdisjoint((own, *maps))


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


UNPACKED: Final = {"has_masks": False, "has_vertex_colors": False, "has_changes": True, "is_placed": True}
"""Switches of shaders that read the buffer: what was cut is left out, and textures are read by what is stored."""
