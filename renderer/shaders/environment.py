"""Shaders of environments: the light that surfaces scatter and mirror, and the sky.

`renderer.frame.environment` makes what they read: an octahedral map, whose first layer has the light that is
mirrored, level by level rougher, and whose second one that which is scattered. Directions are turned to those
of the image.
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl
from renderer.shaders.metals import MIN_ROUGHNESS
from renderer.shaders.pixels import PixelRays, pixel_position
from renderer.shaders.structs import Material, SurfacePoint

LEAST_ROUGHNESS: Final = MIN_ROUGHNESS
"""The roughness of the sharpest level."""
RESPONSE_SIZE: Final = 16
"""The rows and columns of the table of the response of lobes."""
SCATTERED_SIZE: Final = 32
"""The width of the map of scattered light, a level of its layer."""
_DECADE: Final = 3.32192809  # log2 of 1 / LEAST_ROUGHNESS


class EnvironmentConstants(sl.Struct):
    """Constants of an environment.

    Attributes:
        response: pairs of shares of the light that a lobe reflects, (x, y) and (z, w): by roughness, and within
            by √(n · v).
        turn: cosine and sine of the angle by which the image is turned.
        strength: multiplies what the textures hold.
        last_level: the index of the last level of mirrored light.
        size: the width of its first level.
    """

    response: sl.Array[sl.vec4] = sl.array(sl.vec4, RESPONSE_SIZE * RESPONSE_SIZE // 2)
    turn: sl.vec2
    strength: float
    last_level: float
    size: float


@sl.function
def decode_octahedral(at: sl.vec2) -> sl.vec3:
    """Return the unit direction of a point of an octahedral map, -1 to 1: +y in the middle, -y at the corners."""
    height = 1.0 - sl.abs(at.x) - sl.abs(at.y)
    fold = sl.max(-height, 0.0)
    x = at.x - fold if at.x >= 0.0 else at.x + fold
    z = at.y - fold if at.y >= 0.0 else at.y + fold
    return sl.normalize(sl.vec3(x, height, z))


@sl.function
def encode_octahedral(direction: sl.vec3) -> sl.vec2:
    """Return the point of an octahedral map, -1 to 1, of a direction."""
    flat = direction.xz / (sl.abs(direction.x) + sl.abs(direction.y) + sl.abs(direction.z))
    if direction.y >= 0.0:
        return flat
    return sl.vec2(
        (1.0 - sl.abs(flat.y)) * (1.0 if flat.x >= 0.0 else -1.0),
        (1.0 - sl.abs(flat.x)) * (1.0 if flat.y >= 0.0 else -1.0),
    )


class EnvironmentReader(sl.Shader):
    """The base of shaders that read an environment."""

    environment_constants: sl.Uniform[EnvironmentConstants]

    def turn_direction(self, direction: sl.vec3) -> sl.vec3:
        """Return the direction in which the image has the light from a direction of the world."""
        turn = self.environment_constants.turn
        return sl.vec3(
            turn.x * direction.x - turn.y * direction.z,
            direction.y,
            turn.y * direction.x + turn.x * direction.z,
        )


class EnvironmentLight(EnvironmentReader):
    """Reflects the light of an environment, if there is any."""

    has_environment = False

    environment: sl.Texture2DArray

    def scattered_light(self, normal: sl.vec3) -> sl.vec3:
        """Return the light that a white surface scatters: its irradiance over π."""
        at = 0.5 + 0.5 * encode_octahedral(self.turn_direction(normal))
        level = sl.log2(self.environment_constants.size / float(SCATTERED_SIZE))
        return self.load_level(at, level, 1.0) * self.environment_constants.strength

    def mirrored_light(self, direction: sl.vec3, roughness: float) -> sl.vec3:
        """Return the light that a lobe of this roughness gathers around a unit direction."""
        level = self.environment_constants.last_level * sl.saturate(
            1.0 + sl.log2(sl.max(roughness, LEAST_ROUGHNESS)) / _DECADE
        )
        at = 0.5 + 0.5 * encode_octahedral(self.turn_direction(direction))
        finer = sl.floor(level)
        light = sl.mix(
            self.load_level(at, finer, 0.0),
            self.load_level(at, sl.min(finer + 1.0, self.environment_constants.last_level), 0.0),
            level - finer,
        )
        return light * self.environment_constants.strength

    def load_level(self, at: sl.vec2, level: float, layer: float) -> sl.vec3:
        """Return the light of a level of a layer, inside its border."""
        texel = sl.exp2(level) / self.environment_constants.size
        return self.environment.sample_lod(sl.vec3(texel + at * (1.0 - 2.0 * texel), layer), level).rgb

    def lobe_response(self, roughness: float, seen: float) -> sl.vec2:
        """Return the shares of even light that a lobe reflects: times the specular colour, and apart from it."""
        last = float(RESPONSE_SIZE - 1)
        row = sl.saturate((roughness - LEAST_ROUGHNESS) / (1.0 - LEAST_ROUGHNESS)) * last
        column = sl.sqrt(sl.saturate(seen)) * last
        first = sl.min(int(row), RESPONSE_SIZE - 2)
        left = sl.min(int(column), RESPONSE_SIZE - 2)
        across = column - float(left)
        above = sl.mix(self.load_response(first, left), self.load_response(first, left + 1), across)
        below = sl.mix(self.load_response(first + 1, left), self.load_response(first + 1, left + 1), across)
        return sl.mix(above, below, row - float(first))

    def load_response(self, row: int, column: int) -> sl.vec2:
        """Return an entry of the table of responses."""
        entry = row * RESPONSE_SIZE + column
        pair = self.environment_constants.response[entry // 2]
        return pair.zw if (entry & 1) == 1 else pair.xy

    def reflect_environment_metallic(self, surface: SurfacePoint) -> sl.vec3:
        """Return the light of the environment that a surface of the metallic-roughness model sends to the
        eye. The lobe is about the mirrored direction; the rougher, the nearer to the normal (Lagarde and de
        Rousiers 2014)."""
        roughness = -surface.shininess
        alpha = roughness * roughness
        smooth = 1.0 - alpha
        beyond = sl.mix(
            surface.normal,
            sl.reflect(-surface.to_eye, surface.normal),
            smooth * (sl.sqrt(smooth) + alpha),
        )
        response = self.lobe_response(roughness, sl.abs(sl.dot(surface.normal, surface.to_eye)))
        mirrored = surface.specular_color * response.x + response.y
        light = surface.base_color * self.scattered_light(surface.normal)
        return (light + mirrored * self.mirrored_light(beyond, roughness)) * surface.occlusion

    def reflect_environment_specular(self, surface: SurfacePoint, material: Material) -> sl.vec3:
        """Return the light of the environment that a surface of the specular model sends to the eye. Its
        highlight is as wide as one of GGX with α² = 2 / (shininess + 2)."""
        mirrored = surface.specular_color
        if material.rim_strength > 0.0:
            grazing = 1.0 - sl.saturate(sl.dot(surface.normal, surface.to_eye))
            mirrored = mirrored + sl.vec3(material.rim_strength * sl.pow(grazing, material.rim_power))
        roughness = sl.sqrt(sl.sqrt(2.0 / (surface.shininess + 2.0)))
        beyond = sl.reflect(-surface.to_eye, surface.normal)
        light = surface.base_color * self.scattered_light(surface.normal)
        return (light + mirrored * self.mirrored_light(beyond, roughness)) * surface.occlusion


class EnvironmentSky(EnvironmentReader):
    """Shows the environment as the background."""

    has_sky_box = False

    environment_image: sl.Texture2D

    def sky_light(self, direction: sl.vec3, level: float) -> sl.vec3:
        """Return the light from a direction of any length, at a level of the image."""
        toward = sl.normalize(self.turn_direction(direction))
        at = sl.vec2(
            0.5 + sl.atan2(toward.x, -toward.z) * 0.15915494,
            sl.acos(sl.clamp(toward.y, -1.0, 1.0)) * 0.31830989,
        )
        return self.environment_image.sample_lod(at, level).rgb * self.environment_constants.strength

    def sky_at(self, rays: PixelRays, pixel: sl.vec2) -> sl.vec3:
        """Return the light of the environment in a pixel, at the level whose texels are as large as pixels."""
        start = pixel_position(rays, pixel, 0.0)
        direction = pixel_position(rays, pixel, 1.0) - start
        next_pixel = pixel + sl.vec2(1.0, 0.0)
        beside = pixel_position(rays, next_pixel, 1.0) - pixel_position(rays, next_pixel, 0.0)
        angle = sl.length(sl.normalize(beside) - sl.normalize(direction))
        height = float(self.environment_image.size().y)
        level = sl.log2(sl.max(angle * height * 0.31830989, 1.0))
        return self.sky_light(direction, level)
