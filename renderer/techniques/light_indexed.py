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

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.frame import LAMPS, Frame, Needs, Pass, Target, Targets
from renderer.lights.rectangles import bound_cones, bound_spheres
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.pixels import PixelRays, distance_at, nearness_of, place_pixel
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.parts.finish import draw_once, forward_passes
from renderer.techniques.parts.full_screen import bind_rays
from renderer.techniques.parts.scene_shader import ForwardShader
from renderer.techniques.parts.variants import Lighting, explain_lamps, list_lamps
from rhi import (
    BlendColor,
    BlendFactor,
    BlendFunction,
    CullMode,
    DepthTest,
    DepthWrite,
    Device,
    Format,
    Mesh,
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


class IndexedVolume(sl.Struct):
    """The volume of a light: the rectangle around it in the image, its place relative to the eye, and the value that
    is packed for it. A point light has a cone of -2, which holds all directions."""

    rectangle: sl.vec4
    packed: sl.vec4
    position: sl.vec3
    range: float
    direction: sl.vec3
    cos_outer: float


class IndexVarying(sl.Struct):
    """The varyings of `PackIndices`."""

    clip: sl.vec4
    volume: int


class PackIndices(sl.Shader):
    """Writes the numbers of the lights that reach the surface at each pixel; an instance is a light."""

    volumes: sl.Storage[IndexedVolume]
    depth: sl.Texture2D
    rays: sl.Uniform[PixelRays]

    def vertex(self) -> IndexVarying:
        corner = sl.vertex_index()
        volume = sl.instance_index()
        sides = self.volumes[volume].rectangle
        x = sides.z if ((22 >> corner) & 1) == 1 else sides.x  # the corners of the two triangles:
        y = sides.w if ((52 >> corner) & 1) == 1 else sides.y  # 00 10 11, 00 11 01
        return IndexVarying(clip=sl.vec4(sl.vec2(x, y), 0.5, 1.0), volume=volume)

    def fragment(self, v: IndexVarying) -> sl.vec4:
        place = sl.fragment_coordinate().xy
        nearness = nearness_of(self.rays, self.depth.load(sl.ivec2(place)).x)
        if nearness == 0.0:
            sl.discard()
        light = self.volumes[v.volume]
        away = place_pixel(self.rays, place, distance_at(self.rays, nearness)) - light.position
        if sl.dot(away, away) >= light.range * light.range:
            sl.discard()
        if sl.dot(safe_normalize(away), light.direction) <= light.cos_outer:
            sl.discard()
        return light.packed


@sl.function
def next_light(packed: sl.uvec4) -> int:
    """Return the number of the first light of a pixel's packed numbers, 0 if there is none (`light_indexed`)."""
    parts = packed & sl.uvec4(LIGHT_MASK)
    return int(parts.x | (parts.y << LIGHT_BITS) | (parts.z << (2 * LIGHT_BITS)) | (parts.w << (3 * LIGHT_BITS)))


class LitByIndices(ForwardShader):
    """Finds the lights of a pixel in a texture. A pixel with too many lights uses its object's list."""

    light_indices: sl.Texture2D
    numbered: sl.Storage[int]

    def lamplight(self, surface: SurfacePoint, lights: sl.ivec3) -> sl.vec3:
        indices = self.light_indices.load(sl.ivec2(sl.fragment_coordinate().xy))
        if sl.max(sl.max(indices.x, indices.y), sl.max(indices.z, indices.w)) >= LIGHTS_FULL:
            return super().lamplight(surface, lights)
        packed = sl.uvec4(indices)
        color = sl.vec3(0.0)
        number = next_light(packed)
        while number > 0:
            row = self.numbered[number - 1]
            if self.has_point_lights and row >= 0:
                color += self.pointlight(surface, row)
            if self.has_spot_lights and row < 0:
                color += self.spotlight(surface, ~row)
            packed = packed >> sl.uvec4(LIGHT_BITS)
            number = next_light(packed)
        return color


def _make_rectangle(device: Device) -> Mesh:
    return device.mesh(_CORNERS, label="light volume")


class LightIndexed:
    """Draws depth, the lights of each pixel, then the scene lit by them; without lamps in view, as `Forward` does."""

    name: Final = "light_indexed"

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the three passes, and those of transparent surfaces."""
        if not list_lamps(needs):
            return forward_passes(needs)
        because = "draws the visible objects, lit by the lights of each pixel"
        indices = Pass(
            INDICES,
            _pack_indices,
            f"writes the numbers of each pixel's lights; {explain_lamps(needs)}",
            reads=("depth",),
            writes=(Target(INDICES, Format.RGBA32F),),
        )
        first = "finds the surface that lights reach at each pixel"
        return draw_once(needs, BY_INDICES, because, samples=1, depth_first=first, lists=(indices,))


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
            frame.resources.workspace(_make_rectangle),
            len(volumes),
            volumes=device.transient.storage(IndexedVolume, volumes),
            depth=frame.targets["depth"],
            rays=bind_rays(frame),
        )


def list_volumes(frame: Frame) -> NDArray[Any]:
    """Return the volumes (l,) of `IndexedVolume` of the lights in view: point lights, then spot lights."""
    needs, lights, eye = frame.needs, frame.resources.lights, frame.camera.position
    points, spots = (kind.find_rows(lights)[needs.in_view[effect]] for effect, kind in LAMPS.items())
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


def _bind_indices(frame: Frame) -> dict[str, Any]:
    points, spots = (frame.needs.in_view[effect] for effect in LAMPS)
    numbered = np.concatenate([points, ~spots]).astype(np.int32)
    return {"light_indices": frame.targets[INDICES], "numbered": frame.device.transient.storage(int, numbered)}


BY_INDICES: Final = Lighting((LitByIndices,), bind=_bind_indices, reads=(INDICES,))
