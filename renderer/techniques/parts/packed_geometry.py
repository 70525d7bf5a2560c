"""The packed geometry buffer: what a pixel's surface is, before its material is evaluated (Deferred+, 1.3.2).

| word of `packed` | bits | what it holds |
|---|---|---|
| 0 | 32 | the normal, octahedral in 2 × 16 bits; if the scene has normal maps the normal and the tangent |
| 1 | 16 + 16 | the index of the material; the rest of the gradient of texture coordinates in y |
| 2 | 32 | the fractional parts of the texture coordinates |
| 3 | 24 + 8 | the change of texture coordinates in x; the beginning of that in y |

Its format is RGBA32UI, 16 bytes a pixel; a scene without images has the first two words only, RG32UI. A scene
with colours of vertices has a further buffer, `vertex_colors`: R32UI, 3 × 10 bits. The position follows from
the depth and the ray of the pixel. Texture coordinates are stored as the material's textures are read: those
of their set, a transform applied. Texels are read when geometry is drawn only where masks cut it: a texture
is filtered later, with the derivatives that are stored, so what is hidden costs no texel.

Materials are evaluated by the `MaterialShader` that other techniques draw geometry with, given a point of the
buffer instead of a fragment's.

The encodings are those of `renderer.shaders.encodings`.
"""

from __future__ import annotations

from functools import partial
from typing import Final

import rhi.shading as sl
from renderer.frame import DEPTH_FORMAT, Effect, Frame, FrameEffects, FramePass, Target
from renderer.shaders.encodings import (
    TangentFrame,
    decode_frame,
    decode_gradient,
    decode_normal,
    decode_uv,
    encode_frame,
    encode_gradient,
    encode_normal,
    encode_uv,
    sign_or_one,
)
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.materials import MaterialShader
from renderer.shaders.pixels import PixelRays, PixelShader, depth_to_nearness, nearness_to_distance
from renderer.shaders.structs import SurfaceInput, SurfaceVarying
from renderer.techniques.parts.geometry_buffer import check_materials, decode_texel, encode_texel
from renderer.techniques.parts.scene_shader import SceneShader
from renderer.techniques.parts.variants import make_scene_drawer, name_samples
from rhi import Format


class PlainWords(sl.Struct):
    """Output of `PackedPlain`."""

    packed: sl.uvec2


class TexturedWords(sl.Struct):
    """Output of `PackedTextures`."""

    packed: sl.uvec4


class ColoredWords(sl.Struct):
    """Output of `PackedColors`."""

    packed: sl.uvec4
    vertex_colors: sl.uvec4


class SampledWords(sl.Struct):
    """Output of `PackedDistances`."""

    packed: sl.uvec4
    distances: float
    vertex_colors: sl.uvec4


class PackedPlain(SceneShader):
    """Writes the packed geometry buffer of a scene without images."""

    is_coverage = True

    def fragment(self, v: SurfaceVarying) -> PlainWords:
        at = self.surface_input(v)
        self.discard_masked(at)
        return PlainWords(packed=sl.uvec2(encode_normal(at.normal), sl.uint(v.material)))


class PackedTextures(SceneShader):
    """Writes the packed geometry buffer of a scene with images."""

    is_coverage = True

    def fragment(self, v: SurfaceVarying) -> TexturedWords:
        return TexturedWords(packed=self.pack(v))

    def pack(self, v: SurfaceVarying) -> sl.uvec4:
        """The fields packed as `packed` describes."""
        second = v.uv2 if self.has_second_uvs else v.uv
        x = encode_gradient(self.transform_uv(v, sl.vec3(sl.ddx(v.uv), 0.0), sl.vec3(sl.ddx(second), 0.0)))
        y = encode_gradient(self.transform_uv(v, sl.vec3(sl.ddy(v.uv), 0.0), sl.vec3(sl.ddy(second), 0.0)))
        at = self.surface_input(v)
        self.discard_masked(at)
        return sl.uvec4(
            self.encode_directions(at),
            sl.uint(v.material) | y >> 8 << 16,
            encode_uv(self.transform_uv(v, sl.vec3(v.uv, 1.0), sl.vec3(second, 1.0))),
            x | y << 24,
        )

    def encode_directions(self, at: SurfaceInput) -> sl.uint:
        if not self.has_normal_maps:
            return encode_normal(at.normal)
        side = sign_or_one(at.tangent.w)
        return encode_frame(TangentFrame(normal=at.normal, tangent=safe_normalize(at.tangent.xyz), side=side))

    def transform_uv(self, v: SurfaceVarying, first: sl.vec3, second: sl.vec3) -> sl.vec2:
        """Return texture coordinates (u, v, 1) of one of both sets, or changes of them (u, v, 0), as the
        material's textures are read: all of a material have the same set and transform."""
        if not self.has_texture_transforms and not self.has_second_uvs:
            return first.xy
        material = self.materials[v.material]
        maps = sl.max(sl.max(material.texture, material.normal_texture), material.metallic_roughness_texture)
        texture_index = sl.max(maps, sl.max(material.occlusion_texture, material.emissive_texture))
        if self.has_light_maps:
            texture_index = sl.max(texture_index, material.light_map_texture)
        if texture_index < 0:
            return first.xy
        use = self.textures[texture_index]
        uv = first if use.uv_set == 0 else second
        return sl.vec2(sl.dot(use.u, uv), sl.dot(use.v, uv))


class PackedColors(PackedTextures):
    """Writes the packed geometry buffer of a scene with vertex colours."""

    def fragment(self, v: SurfaceVarying) -> ColoredWords:  # type: ignore[override]  # more targets
        colors = sl.uvec4(encode_texel(v.color.rgb), sl.uint(0), sl.uint(0), sl.uint(0))
        return ColoredWords(packed=self.pack(v), vertex_colors=colors)


class PackedDistances(PackedTextures):
    """Writes the packed geometry buffer of several samples, with distances: depth is each sample's, not
    the pixel centre's."""

    rays: sl.Uniform[PixelRays]

    def fragment(self, v: SurfaceVarying) -> SampledWords:  # type: ignore[override]  # more targets
        color = encode_texel(v.color.rgb) if self.has_vertex_colors else sl.uint(0)
        return SampledWords(
            packed=self.pack(v),
            distances=sl.dot(v.position, self.rays.forward),
            vertex_colors=sl.uvec4(color, sl.uint(0), sl.uint(0), sl.uint(0)),
        )


class PackedReader(MaterialShader, PixelShader):
    """Base of shaders that evaluate the materials of the packed geometry buffer, pixel by pixel. Textures
    are filtered by the stored gradients."""

    rays: sl.Uniform[PixelRays]
    packed: sl.UintTexture2D
    vertex_colors: sl.UintTexture2D
    depth: sl.Texture2D

    def load_words(self, sample: int) -> sl.uvec4:
        """Load the texel of `packed` at the pixel, or of one of its samples."""
        return self.packed.load(self.get_pixel())

    def load_vertex_color(self, sample: int) -> sl.uint:
        """Load the texel of `vertex_colors` at the pixel, or of one of its samples."""
        return self.vertex_colors.load(self.get_pixel()).x

    def surface_distance(self, sample: int) -> float:
        """Distance of the surface of the pixel, or of one of its samples, along the view."""
        return nearness_to_distance(
            self.rays, depth_to_nearness(self.rays, self.depth.load(self.get_pixel()).x)
        )

    def read_input(self, position: sl.vec3, sample: int) -> SurfaceInput:
        """Input of the material's shader for the surface of the pixel, or of one of its samples, at
        `position`."""
        words = self.load_words(sample)
        frame = self.decode_directions(words.x)
        right = decode_gradient(words.w & 0xFFFFFF)
        below = decode_gradient(words.w >> 24 | words.y >> 16 << 8)
        return SurfaceInput(
            position=position,
            normal=frame.normal,
            uv=decode_uv(words.z),
            uv2=sl.vec2(0.0),
            uv_gradients=sl.vec4(right, below),
            uv2_gradients=sl.vec4(0.0),
            tangent=sl.vec4(frame.tangent, frame.side),
            color=self.decode_vertex_color(sample),
            material=int(words.y & 65535),
        )

    def decode_vertex_color(self, sample: int) -> sl.vec4:
        if self.has_vertex_colors:
            return sl.vec4(decode_texel(self.load_vertex_color(sample)), 1.0)
        return sl.vec4(1.0)

    def decode_directions(self, bits: sl.uint) -> TangentFrame:
        if self.has_normal_maps:
            return decode_frame(bits)
        return TangentFrame(normal=decode_normal(bits), tangent=sl.vec3(1.0, 0.0, 0.0), side=1.0)


PACKED_SHADERS: Final[tuple[type[sl.Shader], ...]] = (
    PackedPlain,
    PackedTextures,
    PackedColors,
    PackedDistances,
)
"""The shaders of `packed_pass`."""


def can_pack(effects: FrameEffects) -> bool:
    """True if the packed buffer has room for all texture coordinates: one set and transform per material,
    and repeated textures."""
    return Effect.MIXED_COORDINATES not in effects.enabled


def _has_textures(effects: FrameEffects) -> bool:
    shaders = Effect.MATERIAL_SHADERS
    maps = (
        Effect.IMAGES,
        Effect.NORMAL_MAPS,
        Effect.ROUGHNESS_MAPS,
        Effect.OCCLUSION_MAPS,
        Effect.EMISSIVE_MAPS,
        Effect.LIGHT_MAPS,
    )
    return not effects.enabled.isdisjoint((shaders, *maps))


def packed_pass(effects: FrameEffects, *, samples: int = 1) -> FramePass[Frame]:
    """The pass that draws the packed geometry buffer: `packed`, `vertex_colors` if there are any, and
    `depth`; with several samples also `distances`, under the names of `name_samples`."""
    formats = packed_formats(effects, samples) | {"depth": DEPTH_FORMAT}
    return FramePass(
        "geometry",
        partial(draw_packed, samples=samples),
        f"stores the nearest surface of each {'pixel' if samples == 1 else 'sample'}, without its material",
        reads=("depth",) if samples > 1 else (),
        writes=tuple(
            Target(name_samples(name, samples), format, samples=samples) for name, format in formats.items()
        ),
    )


def packed_formats(effects: FrameEffects, samples: int) -> dict[str, Format]:
    """Texel formats of the packed geometry buffer's resources without `depth`."""
    has_colors = Effect.VERTEX_COLORS in effects.enabled
    formats = {"packed": Format.RGBA32UI if has_colors or _has_textures(effects) else Format.RG32UI}
    formats |= {"distances": Format.R32F} if samples > 1 else {}
    return formats | ({"vertex_colors": Format.R32UI} if has_colors else {})


def draw_packed(frame: Frame, *, samples: int = 1) -> None:
    """Draw the visible objects to the packed geometry buffer."""
    check_materials(frame)
    shader: type[SceneShader] = PackedTextures if _has_textures(frame.effects) else PackedPlain
    if samples > 1:
        shader = PackedDistances
    elif Effect.VERTEX_COLORS in frame.effects.enabled:
        shader = PackedColors
    color = [frame.targets[name_samples(name, samples)] for name in packed_formats(frame.effects, samples)]
    depth = frame.targets[name_samples("depth", samples)]
    frame.draw_visible(make_scene_drawer(frame, shader, color=color, depth=depth))


PACKED_READER_SWITCHES: Final = {
    "has_masks": False,
    "has_second_uvs": False,
    "has_gradients": True,
    "has_transformed_uvs": True,
}
"""Switches of shaders that read the buffer: what was cut is left out, and textures are read by what is
stored."""
