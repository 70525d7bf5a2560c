"""Light-indexed deferred rendering: a texture says which lights reach each pixel, then one forward pass reads it
(Trebilco, Light Indexed Deferred Rendering, ShaderX7, 2009).

1. A depth pass.
2. The volume of each light in view is drawn as the rectangle around it. Where the surface at a pixel's depth is in the
   light, its number is packed into `light indices`.
3. The forward pass, where depth is equal. A fragment unpacks its lights; materials may have any model of lighting.

Numbers are packed by blending, without reading the target. A number has 12 bits, 3 in each channel of RGBA32F, and
blending multiplies what is there by 8 and adds the new bits. A float has 24 bits, so that a pixel holds 8 lights. The
ninth brings at least one channel to 2²⁴, because no number is 0, and so do lights beyond the 4,095 in view that have a
number. Such a pixel says so (`count_overflowing`), and its fragments use the list of their object's lights instead: it
costs more, and looks the same.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame import DEPTH_FORMAT, Frame, Needs, Pass, Target, Targets, TechniquePass
from renderer.lights.rectangles import bound_cones, bound_spheres
from renderer.shaders.lighting import point_incidence, safe_normalize, spot_incidence
from renderer.shaders.pixels import PixelRays, distance_at, nearness_of, place_pixel
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.depth import draw_depth
from renderer.techniques.finish import finish_image
from renderer.techniques.forward import (
    Forward,
    bind_lamps,
    bind_materials,
    explain_lamps,
    find_forward,
    list_lamps,
)
from renderer.techniques.forward_shader import WithPointLights, WithSpotLights, forward_variant
from renderer.techniques.full_screen import bind_rays
from rhi import (
    BlendColor,
    BlendFactor,
    BlendFunction,
    CullMode,
    DepthFunction,
    DepthTest,
    DepthWrite,
    Device,
    Format,
)
from rhi.shading import (
    Shader,
    Storage,
    Struct,
    Texture2D,
    Uniform,
    discard,
    dot,
    fragment_coordinate,
    function,
    instance_index,
    ivec2,
    max,
    uvec4,
    vec2,
    vec3,
    vec4,
    vertex_index,
)

INDICES: Final = "light indices"
"""The contents that hold the numbers of each pixel's lights."""
LIGHT_BITS: Final = 3
"""Bits of a light's number in each of the four channels of a texture of light indices."""
LIGHT_MASK: Final = (1 << LIGHT_BITS) - 1
LIGHTS_PER_PIXEL: Final = 24 // LIGHT_BITS
"""The lights whose numbers a pixel of light indices can hold: a float has 24 bits."""
LIGHTS_FULL: Final = float(1 << 24)
"""A channel of this or more says that a pixel has too many lights."""
MOST_LIGHTS: Final = (1 << 4 * LIGHT_BITS) - 1
"""The lights in view that have a number."""

_SHIFT: Final = float(1 << LIGHT_BITS)
_PACKED: Final = (
    CullMode.NONE,
    DepthTest.OFF,
    DepthWrite.OFF,
    BlendFunction(BlendFactor.ONE, BlendFactor.CONSTANT),
    BlendColor(_SHIFT, _SHIFT, _SHIFT, _SHIFT),
)
_CORNERS: Final = 6  # of the two triangles of a rectangle


class IndexedVolume(Struct):
    """The volume of a light: the rectangle around it in the image, its place relative to the eye, and the value that
    is packed for it. A point light has a cone of -2, which holds all directions."""

    rectangle: vec4
    packed: vec4
    position: vec3
    range: float
    direction: vec3
    cos_outer: float


class IndexVarying(Struct):
    """The varyings of `PackIndices`."""

    clip: vec4
    volume: int


class PackIndices(Shader):
    """Writes the numbers of the lights that reach the surface at each pixel; an instance is a light."""

    volumes: Storage[IndexedVolume]
    depth: Texture2D
    rays: Uniform[PixelRays]

    def vertex(self) -> IndexVarying:
        corner = vertex_index()
        volume = instance_index()
        sides = self.volumes[volume].rectangle
        x = sides.z if ((22 >> corner) & 1) == 1 else sides.x  # the corners of the two triangles:
        y = sides.w if ((52 >> corner) & 1) == 1 else sides.y  # 00 10 11, 00 11 01
        return IndexVarying(clip=vec4(vec2(x, y), 0.5, 1.0), volume=volume)

    def fragment(self, v: IndexVarying) -> vec4:
        place = fragment_coordinate().xy
        nearness = nearness_of(self.rays, self.depth.load(ivec2(place)).x)
        if nearness == 0.0:
            discard()
        light = self.volumes[v.volume]
        away = place_pixel(self.rays, place, distance_at(self.rays, nearness)) - light.position
        if dot(away, away) >= light.range * light.range:
            discard()
        if dot(safe_normalize(away), light.direction) <= light.cos_outer:
            discard()
        return light.packed


@function
def next_light(packed: uvec4) -> int:
    """Return the number of the first light of a pixel's packed numbers, 0 if there is none (`light_indexed`)."""
    parts = packed & uvec4(LIGHT_MASK)
    return int(
        parts.x | (parts.y << LIGHT_BITS) | (parts.z << (2 * LIGHT_BITS)) | (parts.w << (3 * LIGHT_BITS))
    )


class WithIndexedPointLights(WithPointLights):
    """Finds the point lights of a pixel in a texture. A pixel with too many lights uses its object's list."""

    light_indices: Texture2D
    numbered: Storage[int]

    def pointlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        indices = self.light_indices.load(ivec2(fragment_coordinate().xy))
        if max(max(indices.x, indices.y), max(indices.z, indices.w)) >= LIGHTS_FULL:
            return super().pointlight(surface, begin, end)
        packed = uvec4(indices)
        color = vec3(0.0)
        number = next_light(packed)
        while number > 0:
            row = self.numbered[number - 1]
            if row >= 0:
                light = self.reflect_light(surface, point_incidence(surface.position, self.point_lights[row]))
                color += self.unblocked_point(light, surface.position, surface.plane, row)
            packed = packed >> uvec4(LIGHT_BITS)
            number = next_light(packed)
        return color


class WithIndexedSpotLights(WithSpotLights):
    """Finds the spot lights of a pixel in a texture. A pixel with too many lights uses its object's list."""

    light_indices: Texture2D
    numbered: Storage[int]

    def spotlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        indices = self.light_indices.load(ivec2(fragment_coordinate().xy))
        if max(max(indices.x, indices.y), max(indices.z, indices.w)) >= LIGHTS_FULL:
            return super().spotlight(surface, begin, end)
        packed = uvec4(indices)
        color = vec3(0.0)
        number = next_light(packed)
        while number > 0:
            row = self.numbered[number - 1]
            if row < 0:
                light = self.reflect_light(surface, spot_incidence(surface.position, self.spot_lights[~row]))
                color += self.unblocked_spot(light, surface.position, surface.plane, ~row)
            packed = packed >> uvec4(LIGHT_BITS)
            number = next_light(packed)
        return color


class RectangleMesh:
    """Keeps the corners of a light's rectangle."""

    def __init__(self, device: Device) -> None:
        self.mesh = device.mesh(_CORNERS, label="light volume")

    def destroy(self) -> None:
        """Destroy the mesh."""
        self.mesh.destroy()


class LightIndexed:
    """Draws depth, the lights of each pixel, then the scene lit by them; without lamps in view, as `Forward` does."""

    name: Final = "light_indexed"

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the three passes, and those of transparent surfaces."""
        if not list_lamps(needs):
            return Forward().declare(needs)
        because = explain_lamps(needs)
        return (
            Pass(
                "depth",
                draw_depth,
                "finds the surface that lights reach at each pixel",
                writes=(Target("depth", DEPTH_FORMAT),),
            ),
            Pass(
                INDICES,
                _pack_indices,
                f"writes the numbers of each pixel's lights; {because}",
                reads=("depth",),
                writes=(Target(INDICES, Format.RGBA32F),),
            ),
            Pass(
                "forward",
                _draw_lit,
                "draws the visible objects, lit by the lights of each pixel",
                reads=(INDICES, "depth"),
                writes=(needs.image,),
            ),
            *finish_image(needs, find_forward),
        )


def count_overflowing(targets: Targets) -> int | None:
    """Return the number of pixels of the last frame that more lights reach than can be packed; None if its plan has no
    light indices. Waits for the device."""
    indices = targets.find(INDICES)
    return None if indices is None else int((indices.read() >= LIGHTS_FULL).any(-1).sum())


def _pack_indices(frame: Frame) -> None:
    device = frame.device
    volumes = list_volumes(frame)
    with (
        device.render_pass(frame.targets[INDICES], clear=(0.0, 0.0, 0.0, 0.0)),
        device.states(*_PACKED),
    ):
        device.draw(
            device.program(PackIndices),
            frame.resources.workspace(RectangleMesh).mesh,
            len(volumes),
            volumes=device.transient.storage(IndexedVolume, volumes),
            depth=frame.targets["depth"],
            **bind_rays(frame),
        )


def list_volumes(frame: Frame) -> NDArray[Any]:
    """Return the volumes (l,) of `IndexedVolume` of the lights in view: point lights, then spot lights."""
    needs, lights, eye = frame.needs, frame.resources.scene.lights, frame.camera.position
    points, spots = lights.point[needs.point_rows], lights.spot[needs.spot_rows]
    volumes: Any = np.zeros(len(points) + len(spots), IndexedVolume.dtype)
    first, last = volumes[: len(points)], volumes[len(points) :]
    first["cos_outer"] = -2.0
    last["cos_outer"], last["direction"] = np.cos(spots["outer"]), spots["direction"]
    for part, some in ((first, points), (last, spots)):
        part["position"], part["range"] = some["position"] - eye, some["range"]
    ranges, outer = spots["range"].astype(np.float64), spots["outer"].astype(np.float64)
    centers, radii = bound_cones(spots["position"], spots["direction"].astype(np.float64), ranges, outer)
    volumes["rectangle"] = bound_spheres(
        frame.camera,
        np.concatenate([points["position"], centers]),
        np.concatenate([points["range"].astype(np.float64), radii]),
    )
    volumes["packed"] = pack_numbers(np.arange(1, len(volumes) + 1))
    made: NDArray[Any] = volumes
    return made


def pack_numbers(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return what is packed (l, 4) for lights with these numbers; those that are too large fill a pixel."""
    packed: NDArray[np.int64] = numbers[:, None] >> LIGHT_BITS * np.arange(4) & LIGHT_MASK
    packed[numbers > MOST_LIGHTS] = int(LIGHTS_FULL)
    return packed


@cache
def indexed_variant(parts: tuple[str, ...], *, has_sun: bool) -> type[Shader]:
    """Return the forward shader with these parts, which finds the lamps of a pixel by its indices."""
    found = {"point_lights": WithIndexedPointLights, "spot_lights": WithIndexedSpotLights}
    bases = (shader for part, shader in found.items() if part in parts)
    return type("Indexed", (*bases, forward_variant(*parts, has_sun=has_sun)), {"__module__": __name__})


def _draw_lit(frame: Frame) -> None:
    needs, targets = frame.needs, frame.targets
    (features, bindings), (more, lamps) = bind_materials(frame), bind_lamps(frame)
    numbered = np.concatenate([needs.point_rows, ~needs.spot_rows]).astype(np.int32)
    indices = {"light_indices": targets[INDICES], "numbered": frame.device.transient.storage(int, numbered)}
    shader = indexed_variant((*features, *more), has_sun=needs.has_sun)
    frame.draw_visible(
        TechniquePass(
            frame.device,
            frame.resources,
            frame.view,
            frame.program(shader),
            bindings | lamps | indices,
            color=frame.image,
            depth=targets["depth"],
            clear=frame.background,
            states=(DepthFunction.EQUAL, DepthWrite.OFF),
            clears=False,
        )
    )
