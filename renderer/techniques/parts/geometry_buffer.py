"""The geometry buffer: the nearest surface of each pixel, for techniques that light it after all geometry is drawn.

| contents | format | bytes | what it holds |
|---|---|---|---|
| `surface` | RG32UI | 8 | the distance along the view, a float32; the normal, octahedral in 2 × 16 bits |
| `surface`, if shadows fall on normal maps | RGBA32UI | 16 | and the normal without maps; a word isn't used |
| `material` | R32UI | 4 | the row of the material |
| `material`, if the scene has images or maps | RG32UI | 8 | and the texel's colour, 3 × 10 bits |
| `details`, if it has roughness or occlusion maps | R32UI | 4 | metallic and occlusion, 8 bits each; roughness, 16 |
| `details`, if it has emissive maps | RG32UI | 8 | and the emissive texel, 3 × 10 bits |
| `depth` | D32F | 4 | depth, for tests only |

Materials stay in the scene's array, so a surface is lit by its own, unrounded numbers. The distance is a float of its
own, because a texture can't be read while it is the target of a depth test. So it doesn't depend on the direction of
depth either: where standard depth is 0.3 m wrong, a position is still exact.

Shadows are looked up by the normal that maps don't bend. Found by the distances of the pixels around, it would be
wrong at edges and take four more loads for each light of a pixel; stored, it is in the texel that is loaded anyway.

Normals may have 2 × 8 bits instead (`normal_bits`). They lie beside the row of the material, in the upper half of its
word, so `surface` has a word less, or two with the normal without maps: R32UI, or RG32UI.

A texel's colour is stored as its square root. Its 10 bits are then 4 times as fine as an image's own 8, which a bright
light on a dark texel needs. What isn't covered keeps what the buffer held: passes over the whole image leave out the
background by a depth test (`draw_full_screen`).
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl
from renderer import rules
from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target
from renderer.shaders.encodings import decode_normal, encode_normal, encode_octahedral
from renderer.shaders.pixels import PixelRays, PixelShader, place_pixel
from renderer.shaders.structs import Material, SurfaceInput, SurfaceParameters, SurfacePoint, SurfaceVarying
from renderer.techniques.parts.scene_shader import ReflectingShader, SceneShader
from renderer.techniques.parts.variants import name_samples, scene_pass
from rhi import Format, refuse

NORMAL_BITS: Final = (8, 16)
"""The bits that each of the two numbers of a normal may have."""
EXACT_NORMAL: Final = 16
"""The bits with which hardly a picture shows that normals were stored: 24 have the same errors."""
MOST_MATERIALS: Final = 1 << 16
"""The number of materials that 16 bits can tell apart."""


def check_materials(frame: Frame) -> None:
    """Refuse a scene with more materials than 16 bits can tell apart."""
    count = len(frame.resources.scene.materials)
    if count > MOST_MATERIALS:
        refuse(rules.MANY_MATERIALS, "render", f"{count:,} materials", f"at most {MOST_MATERIALS:,}")


def find_surface_format(needs: Needs, normal_bits: int = EXACT_NORMAL) -> Format:
    """Return the format of `surface`."""
    if normal_bits == 8:
        return Format.RG32UI if needs.has_planes else Format.R32UI
    return Format.RGBA32UI if needs.has_planes else Format.RG32UI


@sl.function
def find_shrunk(texel: sl.vec2, size: sl.vec2, shrunk: sl.ivec2) -> sl.vec2:
    """Return the center of the pixel of an image of `size` that is stored at the center of a texel of a shrunk one."""
    return sl.floor(texel * size / sl.vec2(shrunk)) + 0.5


@sl.function
def encode_texel(color: sl.vec3) -> sl.uint:
    """Return a colour of 0 to 1 in 3 × 10 bits, as square roots."""
    roots = sl.round(sl.sqrt(sl.saturate(color)) * 1023.0)
    return sl.uint(roots.x) | sl.uint(roots.y) << 10 | sl.uint(roots.z) << 20


@sl.function
def decode_texel(bits: sl.uint) -> sl.vec3:
    """Return the colour that `encode_texel` has stored."""
    roots = sl.vec3(float(bits & 1023), float(bits >> 10 & 1023), float(bits >> 20)) / 1023.0
    return roots * roots


@sl.function
def encode_details(metal: sl.vec2, occlusion: float) -> sl.uint:
    """Return how metallic, rough and occluded a surface is, 0 to 1 each, in 8, 16 and 8 bits.

    Roughness has 16 because the sharpest highlights change with its fourth power.
    """
    shares = sl.round(sl.saturate(sl.vec3(metal, occlusion)) * sl.vec3(255.0, 65535.0, 255.0))
    return sl.uint(shares.x) | sl.uint(shares.z) << 8 | sl.uint(shares.y) << 16


@sl.function
def decode_details(bits: sl.uint) -> sl.vec3:
    """Return how metallic, rough and occluded a surface is, as `encode_details` has stored it."""
    shares = sl.vec3(float(bits & 255), float(bits >> 16), float(bits >> 8 & 255))
    return shares / sl.vec3(255.0, 65535.0, 255.0)


class GeometryTexels(sl.Struct):
    """The texels that `GeometryShader` writes; what a format has no room for is left out."""

    surface: sl.uvec4
    material: sl.uvec4


class DetailedTexels(sl.Struct):
    """The texels that `DetailedGeometry` writes."""

    surface: sl.uvec4
    material: sl.uvec4
    details: sl.uvec4


class SurfaceWriter(SceneShader):
    """The base of shaders that write `surface`."""

    has_small_normals = False
    rays: sl.Uniform[PixelRays]

    def encode_surface(self, at: SurfaceInput, normal: sl.vec3) -> sl.uvec4:
        """Return what `surface` holds; what its format has no room for is left out."""
        distance = sl.float_bits_to_uint(sl.dot(at.position, self.rays.forward))
        plane = sl.uint(0)
        if self.has_planes:
            plane = encode_normal(self.find_plane(at, normal))
        if self.has_small_normals:
            return sl.uvec4(distance, plane, sl.uint(0), sl.uint(0))
        return sl.uvec4(distance, encode_normal(normal), plane, sl.uint(0))


class GeometryShader(SurfaceWriter):
    """Writes the geometry buffer of a scene without maps but those of normals."""

    has_texels = False

    def fragment(self, v: SurfaceVarying) -> GeometryTexels:
        at = self.take(v)
        described = self.see(at)
        surface = self.encode_surface(at, described.normal)
        return GeometryTexels(surface=surface, material=self.encode_material(at.material, described))

    def encode_material(self, row: int, described: SurfaceParameters) -> sl.uvec4:
        """Return what `material` holds."""
        texel = sl.uint(0)
        word = sl.uint(row)
        if self.has_texels:
            texel = encode_texel(described.color.rgb)
        if self.has_small_normals:
            code = sl.uvec2(encode_octahedral(described.normal, 127.0) + 127)
            word = word | code.x << 16 | code.y << 24
        return sl.uvec4(word, texel, sl.uint(0), sl.uint(0))


class DetailedGeometry(GeometryShader):
    """Writes the geometry buffer of a scene with maps of roughness, occlusion or emitted light."""

    def fragment(self, v: SurfaceVarying) -> DetailedTexels:  # type: ignore[override]  # more targets
        at = self.take(v)
        described = self.see(at)
        details = encode_details(sl.vec2(described.metallic, described.roughness), described.occlusion)
        return DetailedTexels(
            surface=self.encode_surface(at, described.normal),
            material=self.encode_material(at.material, described),
            details=sl.uvec4(details, encode_texel(described.emissive), sl.uint(0), sl.uint(0)),
        )


def find_formats(needs: Needs, normal_bits: int = EXACT_NORMAL) -> dict[str, Format]:
    """Return the formats of the geometry buffer's contents but `depth`, which hold what the scene has and no more."""
    effects = needs.effects
    has_own = Effect.MATERIAL_SHADERS in effects  # which may say anything
    has_emissive = has_own or Effect.EMISSIVE_MAPS in effects
    has_details = has_emissive or not effects.isdisjoint((Effect.ROUGHNESS_MAPS, Effect.OCCLUSION_MAPS))
    has_texels = has_details or not effects.isdisjoint((Effect.IMAGES, Effect.VERTEX_COLORS))
    material = Format.RG32UI if has_texels else Format.R32UI
    formats = {"surface": find_surface_format(needs, normal_bits), "material": material}
    return formats | ({"details": Format.RG32UI if has_emissive else Format.R32UI} if has_details else {})


def find_contents(frame: Frame) -> dict[str, bool]:
    """Return the switches of a `GeometryReader` that say what the geometry buffer of a frame holds."""
    formats, surface = find_formats(frame.needs), frame.targets.find("surface") or frame.targets["surface samples"]
    texels, details = formats["material"] is Format.RG32UI, formats.get("details")
    emissive = details is Format.RG32UI
    contents = {"has_texels": texels, "has_details": details is not None, "has_emissive_texels": emissive}
    return contents | {"has_small_normals": surface.format is find_surface_format(frame.needs, 8)}


class SurfaceReader(PixelShader):
    """The base of shaders that light what is in `surface`. If that `is_shrunk`, it has every so many pixels only."""

    lean = True
    is_shrunk = False
    has_planes = False
    has_small_normals = False

    rays: sl.Uniform[PixelRays]
    surface: sl.UintTexture2D

    def load_surface(self, place: sl.ivec2, sample: int) -> sl.uvec4:
        """Return the texel of `surface`: of a sample, if pixels have several."""
        return self.surface.load(place)

    def find_place(self, texel: sl.uvec4, place: sl.ivec2) -> sl.vec3:
        """Return the position of the surface whose texel, at `place`, was loaded."""
        pixel = sl.vec2(place) + 0.5
        if self.is_shrunk:
            pixel = find_shrunk(pixel, self.rays.size, self.surface.size())
        return place_pixel(self.rays, pixel, sl.uint_bits_to_float(texel.x))

    def read_plane(self, texel: sl.uvec4, normal: sl.vec3) -> sl.vec3:
        """Return the normal that maps don't bend of the surface whose texel was loaded, given the `normal`."""
        word = texel.y if self.has_small_normals else texel.z
        return decode_normal(word) if self.has_planes else normal


class GeometryReader(SurfaceReader, ReflectingShader):
    """The base of shaders that light what is in the geometry buffer."""

    has_texels = False
    has_details = False
    has_emissive_texels = False

    material: sl.UintTexture2D
    details: sl.UintTexture2D
    materials: sl.Storage[Material]

    def load_material(self, place: sl.ivec2, sample: int) -> sl.uvec4:
        """Return the texel of `material`: of a sample, if pixels have several."""
        return self.separate(self.material.load(place))

    def separate(self, texel: sl.uvec4) -> sl.uvec4:
        """Return a texel of `material` whose third word is a normal of 8 bits, as `encode_normal` stores it."""
        if self.has_small_normals:
            code = sl.uvec2(texel.x >> 16 & 255, texel.x >> 24) * 258 + 1  # 127 of 254 is 32,767 of 65,534
            return sl.uvec4(texel.x & 65535, texel.y, code.x | code.y << 16, sl.uint(0))
        return texel

    def load_details(self, place: sl.ivec2, sample: int) -> sl.uvec4:
        """Return the texel of `details`: of a sample, if pixels have several."""
        return self.details.load(place)

    def read_surface(
        self, row: sl.uvec4, texel: sl.uvec4, place: sl.ivec2, sample: int, position: sl.vec3
    ) -> SurfacePoint:
        """Return the surface at a place of the buffer, whose texels of `material` and `surface` were loaded."""
        material = self.materials[int(row.x)]
        normal = decode_normal(row.z if self.has_small_normals else texel.y)
        color = sl.vec3(1.0)
        metal = sl.vec2(material.metallic, material.roughness)
        occlusion = 1.0
        emissive = sl.vec3(1.0)
        if self.has_texels:
            color = decode_texel(row.y)
        if self.has_details:
            bits = self.load_details(place, sample)
            details = decode_details(bits.x)
            metal = details.xy
            occlusion = details.z
            if self.has_emissive_texels:
                emissive = decode_texel(bits.y)
        described = SurfaceParameters(
            color=sl.vec4(color, 1.0),
            normal=normal,
            metallic=metal.x,
            roughness=metal.y,
            occlusion=occlusion,
            emissive=emissive,
        )
        return self.make_surface(position, self.read_plane(texel, normal), described, material)


def geometry_pass(needs: Needs, depth: Format = DEPTH_FORMAT, *, samples: int = 1, normal_bits: int) -> Pass[Frame]:
    """Return the pass that draws the geometry buffer: `surface`, `material`, `details` if it has any, and `depth`. With
    several samples, `name_samples` names them."""
    formats = find_formats(needs, normal_bits)
    names = [name_samples(name, samples) for name in formats]
    target = Target(name_samples("depth", samples), depth, samples=samples)

    def draw(frame: Frame) -> None:
        if normal_bits == 8:
            check_materials(frame)
        shader = DetailedGeometry if "details" in formats else GeometryShader
        color, switches = [frame.targets[name] for name in names], find_contents(frame)
        frame.draw_visible(scene_pass(frame, shader, color=color, depth=frame.targets[target.name], switches=switches))

    targets = (Target(name, format, samples=samples) for name, format in zip(names, formats.values(), strict=True))
    because = f"stores the nearest surface of each {'pixel' if samples == 1 else 'sample'}"
    reads = ("depth",) if samples > 1 else ()
    return Pass("geometry", draw, because, reads=reads, writes=(*targets, target))


def list_contents(needs: Needs) -> tuple[str, ...]:
    """Return the names of the geometry buffer's contents."""
    return *find_formats(needs), "depth"
