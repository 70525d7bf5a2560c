"""The geometry buffer: the nearest surface of each pixel, for techniques that light it after all geometry is drawn.

| contents | format | bytes | what it holds |
|---|---|---|---|
| `surface` | RG32UI | 8 | the normal, octahedral in 2 × 16 bits; the distance along the view, a float32 |
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

A texel's colour is stored as its square root. Its 10 bits are then 4 times as fine as an image's own 8, which a bright
light on a dark texel needs. What isn't covered keeps what the buffer held: passes over the whole image leave out the
background by a depth test (`draw_full_screen`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target, TechniquePass
from renderer.shaders.encodings import decode_normal, encode_normal
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.pixels import PixelRays, place_pixel
from renderer.shaders.structs import Material, SurfacePoint, SurfaceVarying
from renderer.techniques.full_screen import bind_rays
from renderer.techniques.scene_shader import SHADING_PARTS, ReflectingShader, SceneShader
from renderer.techniques.surfaces import (
    Aspect,
    MaterialShader,
    bind_surfaces,
    list_models,
    surface_variant,
)
from rhi import Format, Texture
from rhi.shading import (
    Shader,
    Storage,
    Struct,
    UintTexture2D,
    Uniform,
    dot,
    float_bits_to_uint,
    floor,
    function,
    ivec2,
    round,
    saturate,
    sqrt,
    uint,
    uint_bits_to_float,
    uvec2,
    uvec4,
    vec2,
    vec3,
)


def find_surface_format(needs: Needs) -> Format:
    """Return the format of `surface`."""
    return Format.RGBA32UI if needs.has_planes else Format.RG32UI


@function
def find_shrunk(texel: vec2, size: vec2, shrunk: ivec2) -> vec2:
    """Return the center of the pixel of an image of `size` that is stored at the center of a texel of a shrunk one."""
    return floor(texel * size / vec2(shrunk)) + 0.5


@function
def encode_texel(color: vec3) -> uint:
    """Return a colour of 0 to 1 in 3 × 10 bits, as square roots."""
    roots = round(sqrt(saturate(color)) * 1023.0)
    return uint(roots.x) | uint(roots.y) << 10 | uint(roots.z) << 20


@function
def decode_texel(bits: uint) -> vec3:
    """Return the colour that `encode_texel` has stored."""
    roots = vec3(float(bits & 1023), float(bits >> 10 & 1023), float(bits >> 20)) / 1023.0
    return roots * roots


@function
def encode_details(metal: vec2, occlusion: float) -> uint:
    """Return how metallic, rough and occluded a surface is, 0 to 1 each, in 8, 16 and 8 bits.

    Roughness has 16 because the sharpest highlights change with its fourth power.
    """
    shares = round(saturate(vec3(metal, occlusion)) * vec3(255.0, 65535.0, 255.0))
    return uint(shares.x) | uint(shares.z) << 8 | uint(shares.y) << 16


@function
def decode_details(bits: uint) -> vec3:
    """Return how metallic, rough and occluded a surface is, as `encode_details` has stored it."""
    shares = vec3(float(bits & 255), float(bits >> 16), float(bits >> 8 & 255))
    return shares / vec3(255.0, 65535.0, 255.0)


class GeometryTexels(Struct):
    """What `GeometryShader` writes."""

    surface: uvec4
    material: uint


class TexturedTexels(Struct):
    """What `TexturedGeometry` writes."""

    surface: uvec4
    material: uvec2


class DetailedTexels(Struct):
    """What `DetailedGeometry` writes."""

    surface: uvec4
    material: uvec2
    details: uint


class EmissiveTexels(Struct):
    """What `EmissiveGeometry` writes."""

    surface: uvec4
    material: uvec2
    details: uvec2


class SurfaceShader(SceneShader):
    """The base of shaders that write `surface`."""

    rays: Uniform[PixelRays]

    def encode_surface(self, v: SurfaceVarying) -> uvec4:
        """Return what `surface` holds; what its format has no room for is left out."""
        normal = self.find_normal(v)
        distance = dot(v.position, self.rays.forward)
        plane = uint(0)
        if self.has_planes:
            plane = encode_normal(self.find_plane(v, normal))
        return uvec4(encode_normal(normal), float_bits_to_uint(distance), plane, uint(0))


class GeometryShader(SurfaceShader):
    """Writes the geometry buffer of a scene without textures and colours of vertices."""

    def fragment(self, v: SurfaceVarying) -> GeometryTexels:
        _ = self.find_texel(v)  # which leaves out what isn't drawn
        return GeometryTexels(surface=self.encode_surface(v), material=uint(v.material))


class TexturedGeometry(SurfaceShader):
    """Writes the geometry buffer of a scene with texels."""

    def fragment(self, v: SurfaceVarying) -> TexturedTexels:
        texel = encode_texel(self.find_texel(v).rgb)
        return TexturedTexels(surface=self.encode_surface(v), material=uvec2(uint(v.material), texel))


class DetailedGeometry(MaterialShader, SurfaceShader):
    """Writes the geometry buffer of a scene with maps of roughness or occlusion."""

    def fragment(self, v: SurfaceVarying) -> DetailedTexels:
        texel = encode_texel(self.find_texel(v).rgb)
        return DetailedTexels(
            surface=self.encode_surface(v),
            material=uvec2(uint(v.material), texel),
            details=encode_details(self.find_metal(v), self.find_occlusion(v)),
        )


class EmissiveGeometry(MaterialShader, SurfaceShader):
    """Writes the geometry buffer of a scene with emissive maps."""

    def fragment(self, v: SurfaceVarying) -> EmissiveTexels:
        texel = encode_texel(self.find_texel(v).rgb)
        details = encode_details(self.find_metal(v), self.find_occlusion(v))
        return EmissiveTexels(
            surface=self.encode_surface(v),
            material=uvec2(uint(v.material), texel),
            details=uvec2(details, encode_texel(self.find_emissive(v))),
        )


@dataclass(frozen=True, slots=True)
class GeometryLayout:
    """What a geometry buffer holds: the shader that writes it, the aspects of surfaces that it reads, the formats of
    `material` and `details`, and the parts by which a `GeometryReader` reads more than normal and material."""

    shader: type[SceneShader]
    aspects: tuple[Aspect, ...]
    material: Format
    details: Format | None
    parts: tuple[type[Shader], ...]


def find_layout(needs: Needs) -> GeometryLayout:
    """Return the layout that holds what the scene has, and no more."""
    effects = needs.effects
    aspects = (Aspect.COVERAGE, Aspect.NORMAL, Aspect.COLOR, Aspect.METAL, Aspect.AMBIENT)
    if Effect.EMISSIVE_MAPS in effects:
        parts: tuple[type[Shader], ...] = (WithEmissiveTexels, WithDetails, WithTexels)
        return GeometryLayout(EmissiveGeometry, aspects, Format.RG32UI, Format.RG32UI, parts)
    if not effects.isdisjoint((Effect.ROUGHNESS_MAPS, Effect.OCCLUSION_MAPS)):
        return GeometryLayout(DetailedGeometry, aspects, Format.RG32UI, Format.R32UI, (WithDetails, WithTexels))
    if not effects.isdisjoint((Effect.IMAGES, Effect.VERTEX_COLORS)):
        return GeometryLayout(TexturedGeometry, aspects[:3], Format.RG32UI, None, (WithTexels,))
    return GeometryLayout(GeometryShader, aspects[:2], Format.R32UI, None, ())


class SurfaceReader(Shader):
    """The base of shaders that light what is in `surface`. If that `is_shrunk`, it has every so many pixels only."""

    rays: Uniform[PixelRays]
    surface: UintTexture2D
    is_shrunk = False

    def find_place(self, texel: uvec4, place: ivec2) -> vec3:
        """Return the position of the surface whose texel, at `place`, was loaded."""
        pixel = vec2(place) + 0.5
        if self.is_shrunk:
            pixel = find_shrunk(pixel, self.rays.size, self.surface.size())
        return place_pixel(self.rays, pixel, uint_bits_to_float(texel.y))

    def read_plane(self, texel: uvec4, normal: vec3) -> vec3:
        """Return the normal that maps don't bend of the surface whose texel was loaded, given the `normal`."""
        return normal


class StoredPlanes(SurfaceReader):
    """Normals that maps don't bend are stored."""

    def read_plane(self, texel: uvec4, normal: vec3) -> vec3:
        return decode_normal(texel.z)


class GeometryReader(SurfaceReader, ReflectingShader):
    """The base of shaders that light what is in the geometry buffer."""

    material: UintTexture2D
    materials: Storage[Material]

    def read_surface(self, row: uvec4, texel: uvec4, place: ivec2, position: vec3) -> SurfacePoint:
        """Return the surface at a place of the buffer, whose texels of `material` and `surface` were loaded."""
        material = self.materials[int(row.x)]
        details = self.load_details(place)
        normal = decode_normal(texel.x)
        surface = SurfacePoint(
            position=position,
            normal=normal,
            plane=self.read_plane(texel, normal),
            to_eye=safe_normalize(-position),
            base_color=material.base_color.rgb * self.read_texel(row),
            specular_color=material.specular_color,
            shininess=material.shininess,
            occlusion=self.read_occlusion(details),
            emissive=self.read_emissive(details),
        )
        return self.with_model(surface, material, self.read_metal(material, details))

    def load_details(self, place: ivec2) -> uvec4:
        return uvec4(0)

    def read_texel(self, row: uvec4) -> vec3:
        return vec3(1.0)

    def read_metal(self, material: Material, details: uvec4) -> vec2:
        return vec2(material.metallic, material.roughness)

    def read_occlusion(self, details: uvec4) -> float:
        return 1.0

    def read_emissive(self, details: uvec4) -> vec3:
        return vec3(1.0)


class WithTexels(GeometryReader):
    """Base colours are multiplied with texels."""

    def read_texel(self, row: uvec4) -> vec3:
        return decode_texel(row.y)


class WithDetails(GeometryReader):
    """How metallic, rough and occluded a surface is comes from the buffer."""

    details: UintTexture2D

    def load_details(self, place: ivec2) -> uvec4:
        return self.details.load(place)

    def read_metal(self, material: Material, details: uvec4) -> vec2:
        return decode_details(details.x).xy

    def read_occlusion(self, details: uvec4) -> float:
        return decode_details(details.x).z


class WithEmissiveTexels(GeometryReader):
    """Emissive colours are multiplied with texels."""

    def read_emissive(self, details: uvec4) -> vec3:
        return decode_texel(details.y)


def geometry_pass(needs: Needs, depth_format: Format = DEPTH_FORMAT) -> Pass[Frame]:
    """Return the pass that draws the geometry buffer: `surface`, `material`, `details` if it has any, and `depth`."""
    layout = find_layout(needs)
    details = [] if layout.details is None else [Target("details", layout.details)]
    return Pass(
        "geometry",
        draw_geometry,
        "stores the nearest surface of each pixel",
        writes=(
            Target("surface", find_surface_format(needs)),
            Target("material", layout.material),
            *details,
            Target("depth", depth_format),
        ),
    )


def list_contents(needs: Needs) -> tuple[str, ...]:
    """Return the names of the geometry buffer's contents."""
    return "surface", "material", *(["details"] if find_layout(needs).details is not None else []), "depth"


def list_planes(needs: Needs) -> tuple[type[SurfaceReader], ...]:
    """Return the parts by which a `SurfaceReader` reads normals that maps don't bend."""
    return (StoredPlanes,) if needs.has_planes else ()


def list_readers(needs: Needs) -> tuple[type[Shader], ...]:
    """Return the parts by which a `GeometryReader` reads and reflects what the scene has."""
    return (*list_planes(needs), *find_layout(needs).parts, *(SHADING_PARTS[name] for name in list_models(needs)))


def draw_geometry(frame: Frame) -> None:
    """Draw the visible objects to the geometry buffer."""
    layout, targets = find_layout(frame.needs), frame.targets
    draw_surfaces(
        frame,
        layout.shader,
        layout.aspects,
        [targets[name] for name in list_contents(frame.needs)[:-1]],
    )


def draw_surfaces(
    frame: Frame,
    base: type[SceneShader],
    aspects: tuple[Aspect, ...],
    color: list[Texture],
    models: Sequence[str] = (),
) -> None:
    """Draw the visible objects to textures and `depth` by a `SurfaceShader`, with parts for what it reads and for the
    `models` of materials."""
    has_materials = issubclass(base, MaterialShader)
    parts, scene = bind_surfaces(frame, aspects, has_materials=has_materials)
    frame.draw_visible(
        TechniquePass(
            frame.device,
            frame.resources,
            frame.view,
            frame.program(surface_variant(base, [*models, *parts])),
            bind_rays(frame) | scene,
            color=color,
            depth=frame.targets["depth"],
        )
    )


def bind_surface(frame: Frame, surface: str = "surface") -> dict[str, Any]:
    """Return the bindings of a `SurfaceReader`; `surface` is the name of its contents."""
    return bind_rays(frame) | {"surface": frame.targets[surface]}


def bind_geometry(frame: Frame) -> dict[str, Any]:
    """Return the bindings of a `GeometryReader`."""
    contents = {name: frame.targets[name] for name in list_contents(frame.needs)[1:-1]}
    return bind_surface(frame) | contents | {"materials": frame.resources.materials.buffer}
