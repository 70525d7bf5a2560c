"""The geometry buffer: the nearest surface of each pixel, for techniques that light it after all geometry is drawn.

| contents | format | bytes | what it holds |
|---|---|---|---|
| `surface` | RG32UI | 8 | the normal, octahedral in 2 × 16 bits; the distance along the view, a float32 |
| `material` | R32UI | 4 | the row of the material |
| `material`, if the scene has images | RG32UI | 8 | and the texel's colour, 3 × 10 bits |
| `depth` | D32F | 4 | depth, for tests only |

Materials stay in the scene's array, so a surface is lit by its own, unrounded numbers. The distance is a float of its
own, because a texture can't be read while it is the target of a depth test. So it doesn't depend on the direction of
depth either: where standard depth is 0.3 m wrong, a position is still exact.

A texel's colour is stored as its square root. Its 10 bits are then 4 times as fine as an image's own 8, which a bright
light on a dark texel needs. What isn't covered keeps what the buffer held: passes over the whole image leave out the
background by a depth test (`draw_full_screen`).
"""

from __future__ import annotations

from typing import Any, Final

from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target, TechniquePass
from renderer.shaders.encodings import decode_normal, encode_normal
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.pixels import PixelRays, place_pixel
from renderer.shaders.structs import Material, SurfacePoint, SurfaceVarying
from renderer.techniques.full_screen import bind_rays
from renderer.techniques.scene_shader import SceneShader, Textured
from rhi import Format
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

SURFACE_FORMAT: Final = Format.RG32UI
"""The format of normals and distances."""


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


class GeometryTexels(Struct):
    """What `GeometryShader` writes."""

    surface: uvec2
    material: uint


class TexturedTexels(Struct):
    """What `TexturedGeometry` writes."""

    surface: uvec2
    material: uvec2


class SurfaceShader(SceneShader):
    """The base of shaders that write `surface`."""

    rays: Uniform[PixelRays]

    def encode_surface(self, v: SurfaceVarying) -> uvec2:
        distance = dot(v.position, self.rays.forward)
        return uvec2(encode_normal(safe_normalize(v.normal)), float_bits_to_uint(distance))


class GeometryShader(SurfaceShader):
    """Writes the geometry buffer of a scene without images."""

    def fragment(self, v: SurfaceVarying) -> GeometryTexels:
        return GeometryTexels(surface=self.encode_surface(v), material=uint(v.material))


class TexturedGeometry(Textured, SurfaceShader):
    """Writes the geometry buffer of a scene with images."""

    materials: Storage[Material]

    def fragment(self, v: SurfaceVarying) -> TexturedTexels:
        texel = encode_texel(self.texel(self.materials[v.material].texture, v.uv).rgb)
        return TexturedTexels(surface=self.encode_surface(v), material=uvec2(uint(v.material), texel))


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


class GeometryReader(SurfaceReader):
    """The base of shaders that light what is in the geometry buffer."""

    material: UintTexture2D
    materials: Storage[Material]
    has_images = False

    def read_surface(self, material: Material, row: uvec4, texel: uvec4, position: vec3) -> SurfacePoint:
        """Return the surface whose texels of `material` and `surface` were loaded, and its material."""
        base = material.base_color.rgb
        if self.has_images:
            base *= decode_texel(row.y)
        return SurfacePoint(
            position=position,
            normal=decode_normal(texel.x),
            to_eye=safe_normalize(-position),
            base_color=base,
            specular_color=material.specular_color,
            shininess=material.shininess,
        )


def geometry_pass(needs: Needs, depth_format: Format = DEPTH_FORMAT) -> Pass[Frame]:
    """Return the pass that draws the geometry buffer: `surface`, `material` and `depth`."""
    return Pass(
        "geometry",
        draw_geometry,
        "stores the nearest surface of each pixel",
        writes=(
            Target("surface", SURFACE_FORMAT),
            Target("material", Format.RG32UI if Effect.IMAGES in needs.effects else Format.R32UI),
            Target("depth", depth_format),
        ),
    )


def draw_geometry(frame: Frame) -> None:
    """Draw the visible objects to the geometry buffer."""
    resources, targets = frame.resources, frame.targets
    bindings = bind_scene(frame)
    shader: type[Shader] = GeometryShader
    if Effect.IMAGES in frame.needs.effects:
        shader = TexturedGeometry
        bindings |= {"images": resources.images, "materials": resources.materials.buffer}
    frame.draw_visible(
        TechniquePass(
            frame.device,
            resources,
            frame.view,
            frame.device.program(shader),
            bindings,
            color=[targets["surface"], targets["material"]],
            depth=targets["depth"],
        )
    )


def bind_scene(frame: Frame) -> dict[str, Any]:
    """Return the bindings of a `SurfaceShader`."""
    resources = frame.resources
    return {
        **bind_rays(frame),
        "view": frame.view.buffer,
        "objects": resources.objects.buffer,
        "places": resources.places.buffer,
    }


def bind_surface(frame: Frame, surface: str = "surface") -> dict[str, Any]:
    """Return the bindings of a `SurfaceReader`; `surface` is the name of its contents."""
    return bind_rays(frame) | {"surface": frame.targets[surface]}


def bind_geometry(frame: Frame) -> dict[str, Any]:
    """Return the bindings of a `GeometryReader`."""
    return bind_surface(frame) | {
        "material": frame.targets["material"],
        "materials": frame.resources.materials.buffer,
    }
