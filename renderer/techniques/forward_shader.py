"""The forward shader: each fragment is lit by all lights that reach its object, in one pass.

A feature that a scene lacks costs nothing: `ForwardShader` has no lights and no textures, each of the classes
below and in `scene_shader` adds one feature with its binding, and `forward_variant` combines those that are needed.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Final

from renderer.shaders.lighting import in_range, point_incidence, spot_incidence
from renderer.shaders.structs import Material, PointLight, SpotLight, SurfacePoint, SurfaceVarying
from renderer.shadows import ShadowReceiver
from renderer.techniques.scene_shader import (
    SHADING_PARTS,
    ReflectingShader,
    ShadingShader,
    WithSun,
)
from renderer.techniques.surfaces import SURFACE_PARTS, MaterialShader
from rhi.shading import Shader, Storage, ivec3, vec3, vec4


class LampShader(ReflectingShader, ShadowReceiver):
    """The base of shaders that light surfaces by lists of lamps, point and spot lights: without any."""

    def lamplight(self, surface: SurfacePoint, lights: ivec3) -> vec3:
        """Return the light of the lamps between three places in the light rows: where the point lights begin, where
        they end and the spot lights begin, and where those end."""
        color = self.pointlight(surface, lights.x, lights.y)
        return color + self.spotlight(surface, lights.y, lights.z)

    def pointlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        return vec3(0.0)

    def spotlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        return vec3(0.0)


class ForwardShader(MaterialShader, LampShader, ShadingShader):
    """The base of all variants: ambient light with the rim term."""

    def fragment(self, v: SurfaceVarying) -> vec4:
        return self.light(v, self.materials[v.material])

    def light(self, v: SurfaceVarying, material: Material) -> vec4:
        """Return the pixel of the lit surface."""
        surface = self.find_surface(v, material)
        color = self.shade(surface, material)
        color += self.lamplight(surface, self.find_lights(v))
        return self.finish(color, v.position)

    def find_lights(self, v: SurfaceVarying) -> ivec3:
        """Return the ends of the lists of lamps that light the surface; see `lamplight`."""
        return v.lights


class WithPointLights(LampShader):
    """Adds point lights."""

    point_lights: Storage[PointLight]
    light_rows: Storage[int]

    def pointlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        color = vec3(0.0)
        for i in range(begin, end):
            row = self.light_rows[i]
            if in_range(surface, self.point_lights[row].position, self.point_lights[row].range):
                light = self.reflect_light(surface, point_incidence(surface.position, self.point_lights[row]))
                color += self.unblocked_point(light, surface.position, surface.plane, row)
        return color


class WithSpotLights(LampShader):
    """Adds spot lights."""

    spot_lights: Storage[SpotLight]
    light_rows: Storage[int]

    def spotlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        color = vec3(0.0)
        for i in range(begin, end):
            row = self.light_rows[i]
            if in_range(surface, self.spot_lights[row].position, self.spot_lights[row].range):
                light = self.reflect_light(surface, spot_incidence(surface.position, self.spot_lights[row]))
                color += self.unblocked_spot(light, surface.position, surface.plane, row)
        return color


PARTS: Final[dict[str, type[Shader]]] = {
    **SHADING_PARTS,
    **SURFACE_PARTS,
    "point_lights": WithPointLights,
    "spot_lights": WithSpotLights,
}
"""The features that can be added to the forward shader, by the names of their bindings where they have one."""


def find_parts(parts: Iterable[str], *, has_sun: bool) -> tuple[type[Shader], ...]:
    """Return these of `PARTS`, each once. `has_sun` says that there is exactly one directional light."""
    known = PARTS | {"directional_lights": WithSun} if has_sun else PARTS
    return tuple(known[part] for part in dict.fromkeys(parts))


@cache
def forward_variant(*parts: str, has_sun: bool = False) -> type[ForwardShader]:
    """Return the forward shader with these parts (`find_parts`), and only their bindings."""
    return type("Forward", (*find_parts(parts, has_sun=has_sun), ForwardShader), {"__module__": __name__})
