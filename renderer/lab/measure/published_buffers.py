"""Geometry buffers with the layouts that the works print, to compare with the renderer's own.

| layout | attachments | bytes per pixel, with depth |
|---|---|---|
| Wilks 2019, Figure 5.1 | diffuse, normal, position and the sum of light in 4 × 16-bit floats; depth and stencil | 36 |
| Wilks 2019, Figure 5.2 | the same, without stencil | 36 |
| Russell 2011, Figure 2.2.2 (Placeres) | position and normal | 20 |
| Russell 2011, Figure 2.2.3 (Hargreaves) | normal, diffuse and emission, specular in 4 × 8 bits; a distance | 20 |

Three channels of 16 bits aren't a format that can be drawn to everywhere, so there are four. Placeres' formats aren't
given; they are taken to be Wilks's. Wilks adds up light in an attachment of the buffer: it is counted, and written by
no pass here, because all layouts are lit alike, by the light lists of clusters. What a layout doesn't store is lost: of
Wilks's the highlights, of Placeres' the colors, too; all have one lighting model, and no material of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import rhi.shading as sl
from renderer.frame import DEPTH_FORMAT, Frame, FrameEffects, FramePass, Target
from renderer.shaders.lighting import ambient_light
from renderer.shaders.pixels import PixelRays, pixel_position
from renderer.shaders.structs import (
    SurfaceInput,
    SurfaceParameters,
    SurfacePoint,
    SurfaceVarying,
    ViewConstants,
)
from renderer.techniques.parts.deferred_lighting import LitByLists
from renderer.techniques.parts.finish import finish_image
from renderer.techniques.parts.light_list_reader import CLUSTERS, bind_light_lists, light_list_pass
from renderer.techniques.parts.resolve import resolve_pass
from renderer.techniques.parts.scene_shader import SceneShader
from renderer.techniques.parts.variants import FORWARD, draw_full_screen, make_scene_drawer
from rhi import Format

_UNKNOWN_COLOR: Final = 0.8
"""The color of surfaces whose layout stores none."""
_SHARPEST: Final = 255.0
"""The largest exponent of a highlight in 8 bits."""
_ONE_MODEL: Final = {"has_metals": False, "has_both_models": False, "has_anisotropy": False}


class ThreeTexels(sl.Struct):
    """Output of layouts with three colors."""

    first: sl.vec4
    second: sl.vec4
    third: sl.vec4


class FourTexels(sl.Struct):
    """Output of layouts with four."""

    first: sl.vec4
    second: sl.vec4
    third: sl.vec4
    fourth: sl.vec4


class LayoutWriter(SceneShader):
    """Base of shaders that write a layout."""

    rays: sl.Uniform[PixelRays]

    def diffuse(self, at: SurfaceInput, described: SurfaceParameters) -> sl.vec3:
        """The diffuse color of a surface."""
        return self.materials[at.material].base_color.rgb * described.color.rgb

    def encode_position(self, at: SurfaceInput) -> sl.vec4:
        """The position of a surface in the world."""
        return sl.vec4(at.position + self.view.eye_high + self.view.eye_low, 1.0)


class LayoutReader(LitByLists):
    """Base of shaders that light the surfaces of a layout by ambient and directional light, and by the light lists of
    clusters."""

    view: sl.Uniform[ViewConstants]

    def load_point(self, pixel: sl.ivec2) -> SurfacePoint:
        """The surface of a pixel."""
        return self.make_point(sl.vec3(0.0), sl.vec3(0.0), sl.vec3(0.0))

    def make_point(self, position: sl.vec3, normal: sl.vec3, diffuse: sl.vec3) -> SurfacePoint:
        """A surface without highlights, at a position relative to the eye."""
        return SurfacePoint(
            position=position,
            normal=normal,
            geometric_normal=normal,
            to_eye=self.direction_to_eye(position),
            base_color=diffuse,
            specular_color=sl.vec3(0.0),
            shininess=1.0,
            occlusion=1.0,
            emissive=sl.vec3(0.0),
            irradiance=sl.vec3(-1.0),
            stretch=sl.vec3(0.0),
        )

    def read_position(self, texel: sl.vec4) -> sl.vec3:
        """The position relative to the eye of a texel that has it in the world."""
        return texel.xyz - self.view.eye_high - self.view.eye_low

    def fragment(self) -> sl.vec4:
        pixel = self.get_pixel()
        surface = self.load_point(pixel)
        color = ambient_light(surface, self.ambient, 0.0, 1.0) + surface.emissive
        if self.has_single_directional_light:
            color += self.shade_directional_light(surface, 0)
        elif self.has_directional_lights:
            for i in range(len(self.directional_lights)):
                color += self.shade_directional_light(surface, i)
        color += self.local_light(surface, pixel, sl.dot(surface.position, self.rays.forward))
        return self.finish(color, surface.position)


class WilksWriter(LayoutWriter):
    """Writes diffuse color, normal and position."""

    def fragment(self, v: SurfaceVarying) -> ThreeTexels:
        at = self.surface_input(v)
        described = self.evaluate(at)
        return ThreeTexels(
            first=sl.vec4(self.diffuse(at, described), 1.0),
            second=sl.vec4(described.normal, 0.0),
            third=self.encode_position(at),
        )


class WilksReader(LayoutReader):
    """Lights what `WilksWriter` has written."""

    first: sl.Texture2D
    second: sl.Texture2D
    third: sl.Texture2D

    def load_point(self, pixel: sl.ivec2) -> SurfacePoint:
        return self.make_point(
            self.read_position(self.third.load(pixel)),
            sl.normalize(self.second.load(pixel).xyz),
            self.first.load(pixel).rgb,
        )


class PlaceresWriter(LayoutWriter):
    """Writes position and normal."""

    def fragment(self, v: SurfaceVarying) -> ThreeTexels:
        at = self.surface_input(v)
        described = self.evaluate(at)
        return ThreeTexels(
            first=self.encode_position(at), second=sl.vec4(described.normal, 0.0), third=sl.vec4(0.0)
        )


class PlaceresReader(LayoutReader):
    """Lights what `PlaceresWriter` has written."""

    first: sl.Texture2D
    second: sl.Texture2D

    def load_point(self, pixel: sl.ivec2) -> SurfacePoint:
        return self.make_point(
            self.read_position(self.first.load(pixel)),
            sl.normalize(self.second.load(pixel).xyz),
            sl.vec3(_UNKNOWN_COLOR),
        )


class HargreavesWriter(LayoutWriter):
    """Writes normal, diffuse color and emission, the highlight and occlusion, and the distance along the view."""

    def fragment(self, v: SurfaceVarying) -> FourTexels:
        at = self.surface_input(v)
        described = self.evaluate(at)
        material = self.materials[at.material]
        specular = material.specular_color
        intensity = sl.max(specular.x, sl.max(specular.y, specular.z))
        distance = sl.dot(self.rays.forward, at.position)
        return FourTexels(
            first=sl.vec4(0.5 + 0.5 * described.normal, 0.0),
            second=sl.vec4(self.diffuse(at, described), material.emission),
            third=sl.vec4(intensity, material.shininess / _SHARPEST, described.occlusion, 1.0),
            fourth=sl.vec4(distance, 0.0, 0.0, 0.0),
        )


class HargreavesReader(LayoutReader):
    """Lights what `HargreavesWriter` has written."""

    first: sl.Texture2D
    second: sl.Texture2D
    third: sl.Texture2D
    fourth: sl.Texture2D

    def load_point(self, pixel: sl.ivec2) -> SurfacePoint:
        color = self.second.load(pixel)
        specular = self.third.load(pixel)
        position = pixel_position(self.rays, sl.vec2(pixel) + 0.5, self.fourth.load(pixel).x)
        normal = sl.normalize(2.0 * self.first.load(pixel).xyz - 1.0)
        return SurfacePoint(
            position=position,
            normal=normal,
            geometric_normal=normal,
            to_eye=self.direction_to_eye(position),
            base_color=color.rgb,
            specular_color=sl.vec3(specular.x),
            shininess=sl.max(specular.y * _SHARPEST, 1.0),
            occlusion=specular.z,
            emissive=color.rgb * color.w,
            irradiance=sl.vec3(-1.0),
            stretch=sl.vec3(0.0),
        )


@dataclass(frozen=True, slots=True)
class PublishedLayout:
    """A layout of a geometry buffer.

    Attributes:
        source: the work and the figure.
        formats: those of the attachments that the geometry is drawn to, in the order of its shader's output.
        depth: the format of depth.
        light_bytes: bytes per pixel of an attachment for the sum of light.
        writer, reader: the shaders that write it and light it.
    """

    source: str
    formats: tuple[Format, ...]
    depth: Format
    writer: type[LayoutWriter]
    reader: type[LayoutReader]
    light_bytes: int = 0

    @property
    def bytes_per_pixel(self) -> int:
        """Bytes of all attachments for a pixel."""
        return sum(format.texel_bytes for format in (*self.formats, self.depth)) + self.light_bytes


_HALVES: Final = Format.RGBA16F
LAYOUTS: Final = {
    "wilks_deferred": PublishedLayout(
        "Wilks 2019, Figure 5.1", (_HALVES,) * 3, Format.D24S8, WilksWriter, WilksReader, _HALVES.texel_bytes
    ),
    "wilks_tiled": PublishedLayout(
        "Wilks 2019, Figure 5.2", (_HALVES,) * 3, DEPTH_FORMAT, WilksWriter, WilksReader, _HALVES.texel_bytes
    ),
    "placeres": PublishedLayout(
        "Russell 2011, Figure 2.2.2", (_HALVES,) * 2, DEPTH_FORMAT, PlaceresWriter, PlaceresReader
    ),
    "hargreaves": PublishedLayout(
        "Russell 2011, Figure 2.2.3",
        (Format.RGBA8,) * 3 + (Format.R32F,),
        DEPTH_FORMAT,
        HargreavesWriter,
        HargreavesReader,
    ),
}
"""The layouts by name."""
_NAMES: Final = ("first", "second", "third", "fourth")


class PublishedBuffer:
    """Clustered deferred shading from a geometry buffer with a published layout. For scenes of the specular model
    without shadows of local lights, transparent surfaces or effects of the camera; others are drawn with errors."""

    def __init__(self, name: str) -> None:
        """`name` is one of `LAYOUTS`."""
        self.name = name
        self.layout = LAYOUTS[name]

    def declare(self, effects: FrameEffects) -> Sequence[FramePass[Frame]]:
        """The passes `geometry`, `light lists`, `resolve`, and those of transparent surfaces."""
        layout = self.layout
        names = _NAMES[: len(layout.formats)]
        targets = [Target(name, format) for name, format in zip(names, layout.formats, strict=True)]
        geometry = FramePass(
            "geometry",
            partial(_draw_layout, layout=layout, names=names),
            "stores the nearest surface of each pixel",
            writes=(*targets, Target("depth", layout.depth)),
        )
        resolve = resolve_pass(
            effects,
            partial(_light_layout, layout=layout, names=names),
            "lights surfaces by their clusters' lights",
            (*names, "depth", "light lists", *effects.shading_reads),
        )
        return geometry, light_list_pass(effects, CLUSTERS), resolve, *finish_image(effects, FORWARD)


def _draw_layout(frame: Frame, *, layout: PublishedLayout, names: Sequence[str]) -> None:
    color = [frame.targets[name] for name in names]
    frame.draw_visible(make_scene_drawer(frame, layout.writer, color=color, switches=_ONE_MODEL))


def _light_layout(frame: Frame, *, layout: PublishedLayout, names: Sequence[str]) -> None:
    bindings: dict[str, Any] = {name: frame.targets[name] for name in names}
    bindings |= bind_light_lists(frame, CLUSTERS)
    draw_full_screen(
        frame,
        layout.reader,
        frame.image,
        bindings,
        depth=frame.targets["depth"],
        clear=frame.background,
        switches=_ONE_MODEL,
    )
