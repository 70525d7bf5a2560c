"""The geometry buffer: the nearest surface of each pixel, for techniques that light it after all geometry is
drawn.

| resource | format | bytes | what it holds |
|---|---|---|---|
| `surface` | RG32UI | 8 | the distance along the view, a float32; the normal, octahedral in 2 × 16 bits |
| `surface`, if shadows fall on normal maps | RGBA32UI | 16 | and the normal without maps; a word isn't used |
| `material` | R32UI | 4 | the index of the material |
| `material`, if the scene has images or maps | RG32UI | 8 | and the texel's colour, 3 × 10 bits |
| `surface`, if the scene has light maps | RGBA32UI | 16 | and the irradiance of the light map, 3 × 10 bits |
| `details`, if it has roughness or occlusion maps | R32UI | 4 | 8 bits metallic, 8 occlusion, 16 roughness |
| `details`, if it has emissive maps | RG32UI | 8 | and the emissive texel, 3 × 10 bits |
| `depth` | D32F | 4 | depth, for tests only |

Materials stay in the scene's array, so a surface is lit by its own, unrounded numbers. The distance is a
float of its own, because a texture can't be read while it is the target of a depth test. So it doesn't depend
on the direction of depth either: where standard depth is 0.3 m wrong, a position is still exact.

Shadows are looked up by the normal that maps don't bend. Found by the distances of the pixels around, it
would be wrong at edges and take four more loads for each light of a pixel; stored, it is in the texel that is
loaded anyway.

Normals may have 2 × 8 bits instead (`normal_bits`). They lie beside the index of the material, in the upper
half of its word, so `surface` has a word less, or two with the normal without maps: R32UI, or RG32UI.

A texel's colour is stored as its square root. Its 10 bits are then 4 times as fine as an image's own 8, which
a bright light on a dark texel needs. What isn't covered keeps what the buffer held: passes over the whole
image leave out the background by a depth test (`draw_full_screen`). Where images have texels above 1, the emissive
texel's 10 bits are logarithms: 32 steps to a factor of 2 are within 1.1 % from 2⁻¹⁶ to 2¹⁶. So are those of light
maps. These take the last word of `surface`, so normals have 16 bits beside them, whatever `normal_bits` says.
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl
from renderer import rules
from renderer.frame import DEPTH_FORMAT, Effect, Frame, FrameEffects, FramePass, Target
from renderer.shaders.encodings import decode_normal, encode_normal, encode_octahedral
from renderer.shaders.pixels import PixelRays, PixelShader, pixel_position
from renderer.shaders.structs import Material, SurfaceInput, SurfaceParameters, SurfacePoint, SurfaceVarying
from renderer.techniques.parts.scene_shader import ReflectingShader, SceneShader
from renderer.techniques.parts.variants import make_scene_drawer, name_samples
from rhi import Format, refuse

NORMAL_BITS: Final = (8, 16)
"""The bits that each of the two numbers of a normal may have."""
DEFAULT_NORMAL_BITS: Final = 16
"""The bits with which hardly an image shows that normals were stored: 24 have the same errors."""
MAX_MATERIALS: Final = 1 << 16
"""The number of materials that 16 bits can tell apart."""


def check_materials(frame: Frame) -> None:
    """Refuse a scene with more materials than 16 bits can number."""
    count = len(frame.resources.scene.materials)
    if count > MAX_MATERIALS:
        refuse(rules.TOO_MANY_MATERIALS, "render", f"{count:,} materials", f"at most {MAX_MATERIALS:,}")


def surface_format(effects: FrameEffects, normal_bits: int = DEFAULT_NORMAL_BITS) -> Format:
    """Texel format of `surface`, without light maps."""
    if normal_bits == 8:
        return Format.RG32UI if effects.has_geometric_normals else Format.R32UI
    return Format.RGBA32UI if effects.has_geometric_normals else Format.RG32UI


@sl.function
def full_size_pixel(texel: sl.vec2, size: sl.vec2, downscaled: sl.ivec2) -> sl.vec2:
    """Centre of the full-size pixel whose surface is stored at a texel of the downscaled buffer."""
    return sl.floor(texel * size / sl.vec2(downscaled)) + 0.5


@sl.function
def encode_texel(color: sl.vec3) -> sl.uint:
    """Encode a colour of 0 to 1 in 3 × 10 bits, as square roots."""
    roots = sl.round(sl.sqrt(sl.saturate(color)) * 1023.0)
    return sl.uint(roots.x) | sl.uint(roots.y) << 10 | sl.uint(roots.z) << 20


@sl.function
def decode_texel(bits: sl.uint) -> sl.vec3:
    """Decode a colour that `encode_texel` encoded."""
    roots = sl.vec3(float(bits & 1023), float(bits >> 10 & 1023), float(bits >> 20)) / 1023.0
    return roots * roots


@sl.function
def encode_bright_texel(color: sl.vec3) -> sl.uint:
    """Encode light from 0 to 65,504 in 3 × 10 bits, as logarithms; what is below 2⁻¹⁶ is 0."""
    octaves = sl.log2(sl.max(color, sl.vec3(1e-9))) + 16.0
    codes = sl.clamp(sl.round(octaves * 32.0), 0.0, 1023.0)
    return sl.uint(codes.x) | sl.uint(codes.y) << 10 | sl.uint(codes.z) << 20


@sl.function
def decode_bright_texel(bits: sl.uint) -> sl.vec3:
    """Decode light that `encode_bright_texel` encoded."""
    codes = sl.vec3(float(bits & 1023), float(bits >> 10 & 1023), float(bits >> 20))
    return sl.exp2(codes / 32.0 - 16.0) * sl.min(codes, sl.vec3(1.0))


@sl.function
def encode_details(metal: sl.vec2, occlusion: float) -> sl.uint:
    """Encode metallic, roughness and occlusion, 0 to 1 each, in 8, 16 and 8 bits.

    Roughness has 16 because the sharpest highlights change with its fourth power.
    """
    shares = sl.round(sl.saturate(sl.vec3(metal, occlusion)) * sl.vec3(255.0, 65535.0, 255.0))
    return sl.uint(shares.x) | sl.uint(shares.z) << 8 | sl.uint(shares.y) << 16


@sl.function
def decode_details(bits: sl.uint) -> sl.vec3:
    """Decode metallic, roughness and occlusion from `encode_details`."""
    shares = sl.vec3(float(bits & 255), float(bits >> 16), float(bits >> 8 & 255))
    return shares / sl.vec3(255.0, 65535.0, 255.0)


_NO_LIGHT_MAP: Final = 1 << 30
"""A word of `surface` that no irradiance has."""


@sl.function
def encode_irradiance(irradiance: sl.vec3) -> sl.uint:
    """Encode the irradiance of a light map, negative without one."""
    if irradiance.x < 0.0:
        return sl.uint(_NO_LIGHT_MAP)
    return encode_bright_texel(irradiance)


@sl.function
def decode_irradiance(bits: sl.uint) -> sl.vec3:
    """Decode an irradiance that `encode_irradiance` encoded."""
    if bits == sl.uint(_NO_LIGHT_MAP):
        return sl.vec3(-1.0)
    return decode_bright_texel(bits)


class GeometryTexels(sl.Struct):
    """Output of `GeometryShader`; channels that a target's format lacks are dropped."""

    surface: sl.uvec4
    material: sl.uvec4


class DetailedTexels(sl.Struct):
    """Output of `DetailedGeometry`."""

    surface: sl.uvec4
    material: sl.uvec4
    details: sl.uvec4


class SurfaceWriter(SceneShader):
    """Base of shaders that write `surface`."""

    has_small_normals = False
    rays: sl.Uniform[PixelRays]

    def encode_surface(self, at: SurfaceInput, normal: sl.vec3) -> sl.uvec4:
        """The texel of `surface`; channels that its format lacks are dropped."""
        distance = sl.float_bits_to_uint(sl.dot(at.position, self.rays.forward))
        plane = sl.uint(0)
        if self.has_geometric_normals:
            plane = encode_normal(self.geometric_normal_of(at, normal))
        if self.has_small_normals:
            return sl.uvec4(distance, plane, sl.uint(0), sl.uint(0))
        return sl.uvec4(distance, encode_normal(normal), plane, sl.uint(0))


class GeometryShader(SurfaceWriter):
    """Writes the geometry buffer of a scene with no maps but colour, normal and light maps."""

    has_color_texels = False

    def fragment(self, v: SurfaceVarying) -> GeometryTexels:
        at = self.surface_input(v)
        described = self.evaluate(at)
        surface = self.encode_lit_surface(at, described.normal)
        return GeometryTexels(surface=surface, material=self.encode_material(at.material, described))

    def encode_lit_surface(self, at: SurfaceInput, normal: sl.vec3) -> sl.uvec4:
        """The texel of `surface`, with the irradiance of the light map."""
        surface = self.encode_surface(at, normal)
        if self.has_light_maps:
            surface.w = encode_irradiance(self.sample_light_map(at))
        return surface

    def encode_material(self, material_index: int, described: SurfaceParameters) -> sl.uvec4:
        """The texel of `material`."""
        texel = sl.uint(0)
        word = sl.uint(material_index)
        if self.has_color_texels:
            texel = encode_texel(described.color.rgb)
        if self.has_small_normals:
            code = sl.uvec2(encode_octahedral(described.normal, 127.0) + 127)
            word = word | code.x << 16 | code.y << 24
        return sl.uvec4(word, texel, sl.uint(0), sl.uint(0))


class DetailedGeometry(GeometryShader):
    """Writes the geometry buffer of a scene with roughness, occlusion or emissive maps."""

    has_bright_texels = False

    def fragment(self, v: SurfaceVarying) -> DetailedTexels:  # type: ignore[override]  # more targets
        at = self.surface_input(v)
        described = self.evaluate(at)
        details = encode_details(sl.vec2(described.metallic, described.roughness), described.occlusion)
        if self.has_bright_texels:
            return DetailedTexels(
                surface=self.encode_lit_surface(at, described.normal),
                material=self.encode_material(at.material, described),
                details=sl.uvec4(details, encode_bright_texel(described.emissive), sl.uint(0), sl.uint(0)),
            )
        return DetailedTexels(
            surface=self.encode_lit_surface(at, described.normal),
            material=self.encode_material(at.material, described),
            details=sl.uvec4(details, encode_texel(described.emissive), sl.uint(0), sl.uint(0)),
        )


GEOMETRY_SHADERS: Final[tuple[type[sl.Shader], ...]] = (GeometryShader, DetailedGeometry)
"""The shaders of `geometry_pass`."""


def geometry_buffer_formats(
    effects: FrameEffects, normal_bits: int = DEFAULT_NORMAL_BITS
) -> dict[str, Format]:
    """Texel formats of the geometry buffer's resources without `depth`, as small as the scene allows."""
    enabled = effects.enabled
    has_own = Effect.MATERIAL_SHADERS in enabled  # which may say anything
    has_emissive = has_own or Effect.EMISSIVE_MAPS in enabled
    has_details = has_emissive or not enabled.isdisjoint((Effect.ROUGHNESS_MAPS, Effect.OCCLUSION_MAPS))
    colors = Effect.IMAGES, Effect.VERTEX_COLORS, Effect.DECALS
    has_color_texels = has_details or not enabled.isdisjoint(colors)
    material = Format.RG32UI if has_color_texels else Format.R32UI
    has_light_maps = Effect.LIGHT_MAPS in enabled
    surface = Format.RGBA32UI if has_light_maps else surface_format(effects, normal_bits)
    formats = {"surface": surface, "material": material}
    return formats | ({"details": Format.RG32UI if has_emissive else Format.R32UI} if has_details else {})


def geometry_buffer_switches(frame: Frame) -> dict[str, bool]:
    """Switches of a `GeometryReader` for what a frame's geometry buffer holds."""
    formats, surface = (
        geometry_buffer_formats(frame.effects),
        frame.targets.get("surface") or frame.targets["surface_samples"],
    )
    texels, details = formats["material"] is Format.RG32UI, formats.get("details")
    emissive = details is Format.RG32UI
    switches = {
        "has_color_texels": texels,
        "has_details": details is not None,
        "has_emissive_texels": emissive,
    }
    is_small = Effect.LIGHT_MAPS not in frame.effects.enabled and surface.format is surface_format(
        frame.effects, 8
    )
    return switches | {"has_small_normals": is_small}


class SurfaceReader(PixelShader):
    """Base of shaders that light the surfaces in `surface`, which may be downscaled (`is_downscaled`)."""

    lean = True
    is_downscaled = False
    has_geometric_normals = False
    has_small_normals = False

    rays: sl.Uniform[PixelRays]
    surface: sl.UintTexture2D

    def load_surface(self, pixel: sl.ivec2, sample: int) -> sl.uvec4:
        """Load the texel of `surface` at a pixel, or of one of its samples."""
        return self.surface.load(pixel)

    def surface_position(self, texel: sl.uvec4, texel_position: sl.ivec2) -> sl.vec3:
        """Position of the surface whose texel at `texel_position` is `texel`."""
        pixel = sl.vec2(texel_position) + 0.5
        if self.is_downscaled:
            pixel = full_size_pixel(pixel, self.rays.size, self.surface.size())
        return pixel_position(self.rays, pixel, sl.uint_bits_to_float(texel.x))

    def read_geometric_normal(self, texel: sl.uvec4, normal: sl.vec3) -> sl.vec3:
        """Geometric normal of the surface in a texel; `normal` if the buffer stores none."""
        word = texel.y if self.has_small_normals else texel.z
        return decode_normal(word) if self.has_geometric_normals else normal


class GeometryReader(SurfaceReader, ReflectingShader):
    """Base of shaders that light the surfaces in the geometry buffer."""

    has_any_material = True
    has_color_texels = False
    has_details = False
    has_emissive_texels = False
    has_bright_texels = False
    has_light_maps = False

    material: sl.UintTexture2D
    details: sl.UintTexture2D
    materials: sl.Storage[Material]

    def load_material(self, pixel: sl.ivec2, sample: int) -> sl.uvec4:
        """Load the texel of `material` at a pixel, or of one of its samples."""
        return self.split_material_texel(self.material.load(pixel))

    def split_material_texel(self, texel: sl.uvec4) -> sl.uvec4:
        """A texel of `material` whose 8-bit normal, if it has one, is moved to the third word and encoded
        as by `encode_normal`."""
        if self.has_small_normals:
            code = sl.uvec2(texel.x >> 16 & 255, texel.x >> 24) * 258 + 1  # 127 of 254 is 32,767 of 65,534
            return sl.uvec4(texel.x & 65535, texel.y, code.x | code.y << 16, sl.uint(0))
        return texel

    def load_details(self, pixel: sl.ivec2, sample: int) -> sl.uvec4:
        """Load the texel of `details` at a pixel, or of one of its samples."""
        return self.details.load(pixel)

    def read_surface(
        self, material_texel: sl.uvec4, texel: sl.uvec4, pixel: sl.ivec2, sample: int, position: sl.vec3
    ) -> SurfacePoint:
        """The surface at a pixel, from its loaded texels of `material` and `surface`."""
        material = self.materials[int(material_texel.x)]
        normal = decode_normal(material_texel.z if self.has_small_normals else texel.y)
        color = sl.vec3(1.0)
        metal = sl.vec2(material.metallic, material.roughness)
        occlusion = 1.0
        emissive = sl.vec3(1.0)
        if self.has_color_texels:
            color = decode_texel(material_texel.y)
        if self.has_details:
            bits = self.load_details(pixel, sample)
            details = decode_details(bits.x)
            metal = details.xy
            occlusion = details.z
            if self.has_emissive_texels:
                emissive = decode_bright_texel(bits.y) if self.has_bright_texels else decode_texel(bits.y)
        described = SurfaceParameters(
            color=sl.vec4(color, 1.0),
            normal=normal,
            metallic=metal.x,
            roughness=metal.y,
            occlusion=occlusion,
            emissive=emissive,
        )
        surface = self.make_surface(position, self.read_geometric_normal(texel, normal), described, material)
        if self.has_lighting_models:
            surface = self.note_material(surface, int(material_texel.x), material.shader)
        if self.has_light_maps:
            surface.irradiance = decode_irradiance(texel.w)
        return surface


def geometry_pass(
    effects: FrameEffects, depth: Format = DEPTH_FORMAT, *, samples: int = 1, normal_bits: int
) -> FramePass[Frame]:
    """The pass that draws the geometry buffer: `surface`, `material`, `details` if the scene needs it, and
    `depth`; with several samples, under the names of `name_samples`."""
    formats = geometry_buffer_formats(effects, normal_bits)
    names = [name_samples(name, samples) for name in formats]
    target = Target(name_samples("depth", samples), depth, samples=samples)

    def draw(frame: Frame) -> None:
        if normal_bits == 8:
            check_materials(frame)
        shader = DetailedGeometry if "details" in formats else GeometryShader
        color, switches = [frame.targets[name] for name in names], geometry_buffer_switches(frame)
        frame.draw_visible(
            make_scene_drawer(frame, shader, color=color, depth=frame.targets[target.name], switches=switches)
        )

    targets = (
        Target(name, format, samples=samples) for name, format in zip(names, formats.values(), strict=True)
    )
    reason = f"stores the nearest surface of each {'pixel' if samples == 1 else 'sample'}"
    reads = ("depth",) if samples > 1 else ()
    return FramePass("geometry", draw, reason, reads=reads, writes=(*targets, target), draws_objects=True)


def geometry_buffer_names(effects: FrameEffects) -> tuple[str, ...]:
    """Names of the geometry buffer's resources."""
    return *geometry_buffer_formats(effects), "depth"
