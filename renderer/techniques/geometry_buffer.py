"""The geometry buffer: the nearest surface of each pixel, for techniques that light it after all geometry is drawn.

| contents | format | bytes | what it holds |
|---|---|---|---|
| `surface` | RG32UI | 8 | the normal, octahedral in 2 × 16 bits; the distance along the view, a float32 |
| `material` | R32UI | 4 | the row of the material |
| `material`, if the scene has images | RG32UI | 8 | and the texel's colour, 3 × 10 bits |
| `depth` | D32F | 4 | depth, for tests only |

Materials stay in the scene's array, so a surface is lit by its own, unrounded numbers. The distance is a float of its
own, because a texture can't be read while it is the target of a depth test. So it doesn't depend on the direction of
depth either: where standard depth is 0.3 m wrong, a position is still exact. A position is the distance times the ray
of its pixel, relative to the eye (`PixelRays`); nothing is inverted in float32, wherever the eye is in the world.

A texel's colour is stored as its square root. Its 10 bits are then 4 times as fine as an image's own 8, which a bright
light on a dark texel needs. What isn't covered keeps what the buffer held: passes over the whole image leave out the
background by a depth test (`cover_geometry`).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target, TechniquePass
from renderer.frame.passes import FARTHEST
from renderer.frame.resources import MirroredValue
from renderer.scene import Camera, Depth
from renderer.shaders.encodings import decode_normal, encode_normal
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.structs import Material, SurfacePoint, SurfaceVarying
from renderer.techniques.scene_shader import SceneShader, Textured
from rhi import CullMode, DepthFunction, DepthWrite, Device, Format, State, UniformBuffer
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
    mat3,
    round,
    saturate,
    sqrt,
    uint,
    uint_bits_to_float,
    uvec2,
    uvec4,
    vec2,
    vec3,
    vec4,
    vertex_index,
)

SURFACE_FORMAT: Final = Format.RG32UI
"""The format of normals and distances."""

BEHIND: Final = {Depth.REVERSED: DepthFunction.LESS, Depth.STANDARD: DepthFunction.GREATER}
"""The depth function that is passed behind the geometry, and never in front of the background."""


class PixelRays(Struct):
    """Where the pixels of a view are: what is `distance` along the view in the pixel at (x, y) is at
    `direction @ (x, y, 1) * distance + origin @ (x, y, 1)`, relative to the eye. With a perspective lens `origin` is 0.

    `size` is that of the image in pixels, `forward` the direction of the view, `far` the distance of its far plane, and
    `farthest` its depth.
    """

    direction: mat3
    origin: mat3
    size: vec2
    forward: vec3
    far: float
    farthest: float


@function
def place_pixel(rays: PixelRays, pixel: vec2, distance: float) -> vec3:
    """Return the position, relative to the eye, of what is `distance` along the view in a pixel."""
    at = vec3(pixel, 1.0)
    return rays.direction @ at * distance + rays.origin @ at


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
        texel = encode_texel(self.texel(self.materials[v.material].texture, v.uv))
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


class CoverShader(Shader):
    """The base of shaders that are run for each pixel of the image, by a triangle at the depth of the background."""

    rays: Uniform[PixelRays]

    def vertex(self) -> vec4:
        corner = vec2(float(vertex_index() & 1), float(vertex_index() >> 1))
        return vec4(corner * 4.0 - 1.0, self.rays.farthest, 1.0)


class Screen:
    """What a technique keeps to run shaders for each pixel: a triangle that covers the image, and the rays of the view.

    Attributes:
        triangle: the mesh for a `CoverShader`.
    """

    def __init__(self, device: Device) -> None:
        self.triangle = device.mesh(3, label="screen")
        zeros = np.zeros((3, 3))
        self._rays = MirroredValue(
            device,
            PixelRays(direction=zeros, origin=zeros, size=(0, 0), forward=(0, 0, 0), far=0.0, farthest=0.0),
        )

    def find_rays(self, frame: Frame) -> UniformBuffer[PixelRays]:
        """Return the rays of the frame's view; they are uploaded if they have changed."""
        self._rays.write(find_rays(frame.camera, frame.targets.size))
        return self._rays.buffer

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self.triangle.destroy()
        self._rays.destroy()


def find_rays(camera: Camera, size: tuple[int, int]) -> PixelRays:
    """Return the rays through the pixels of an image of `size`, computed in float64."""
    (width, height), matrix = size, camera.projection.matrix
    # A lens maps (x, y, -distance) to clip coordinates. Its rows are solved for x and y, as functions of the pixel.
    by_distance, constant = -matrix[3, 2], matrix[3, 3]  # w = by_distance * distance + constant
    pixel_x, pixel_y = np.array([2.0 / width, 0.0, -1.0]), np.array([0.0, -2.0 / height, 1.0])
    last = np.array([0.0, 0.0, 1.0])
    direction = np.stack(
        [
            (pixel_x * by_distance + matrix[0, 2] * last) / matrix[0, 0],
            (pixel_y * by_distance + matrix[1, 2] * last) / matrix[1, 1],
            -last,
        ]
    )
    origin = np.stack(
        [
            (pixel_x * constant - matrix[0, 3] * last) / matrix[0, 0],
            (pixel_y * constant - matrix[1, 3] * last) / matrix[1, 1],
            0.0 * last,
        ]
    )
    depth = camera.projection.depth
    return PixelRays(
        direction=camera.rotation.T @ direction,
        origin=camera.rotation.T @ origin,
        size=size,
        forward=camera.forward,
        far=find_far(camera),
        farthest=FARTHEST[depth],
    )


def find_far(camera: Camera) -> float:
    """Return the distance of the far plane, or the largest float if there is none."""
    planes = camera.frustum.planes
    if len(planes) < 6:
        return float(np.finfo(np.float32).max)
    return float(planes[5] @ np.array([*camera.position, 1.0]))


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
        "rays": resources.workspace(Screen).find_rays(frame),
        "view": frame.view.buffer,
        "objects": resources.objects.buffer,
        "places": resources.places.buffer,
    }


def bind_surface(frame: Frame, surface: str = "surface") -> dict[str, Any]:
    """Return the bindings of a `SurfaceReader`; `surface` is the name of its contents."""
    rays = frame.resources.workspace(Screen).find_rays(frame)
    return {"rays": rays, "surface": frame.targets[surface]}


def bind_geometry(frame: Frame) -> dict[str, Any]:
    """Return the bindings of a `GeometryReader`."""
    return bind_surface(frame) | {
        "material": frame.targets["material"],
        "materials": frame.resources.materials.buffer,
    }


def cover_geometry(frame: Frame) -> tuple[State, ...]:
    """Return the states in which a `CoverShader` is run where geometry was drawn, and not for the background."""
    return CullMode.NONE, DepthWrite.OFF, BEHIND[frame.camera.projection.depth]
