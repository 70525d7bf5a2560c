"""The volumes of lights in shaders: cones, and the corners of meshes drawn around lights."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from rhi.shading import Shader, Struct, function, max, sqrt, vec3, vec4

FARTHEST_CORNER: Final = 1.5
"""More than the distance of any corner from the light, in ranges or in the widths of a cone's base."""


class Cone(Struct):
    """A cone in eye space: points within `range` of `apex`, and within the angle from the unit vector `axis`
    whose cosine is `cosine`."""

    apex: vec3
    range: float
    axis: vec3
    cosine: float


@function
def cone_sine(cone: Cone) -> float:
    """The sine of a cone's half angle."""
    return sqrt(max((1.0 - cone.cosine) * (1.0 + cone.cosine), 0.0))


@function
def bounding_sphere(cone: Cone) -> vec4:
    """The smallest sphere around a cone: centre, radius."""
    if cone.cosine <= 0.0:
        return vec4(cone.apex, cone.range)
    if cone.cosine * cone.cosine < 0.5:
        return vec4(cone.apex + cone.axis * (cone.range * cone.cosine), cone.range * cone_sine(cone))
    radius = cone.range / (2.0 * cone.cosine)
    return vec4(cone.apex + cone.axis * radius, radius)


class VolumeCorner(Struct):
    """A corner of a volume, whose `z` is along the axis; `cone` is 1 for cones, whose width follows from
    their angle, and 0 for spheres."""

    position: vec3
    cone: float


class VolumeVarying(Struct):
    """The varyings of light volumes."""

    clip: vec4
    light: int


class LightVolume(Shader):
    """The base of a kind's volume. It has the vertex stage, and `volume_shader` in the techniques all
    else."""

    lean = True

    if TYPE_CHECKING:  # declared by the shader that it is combined with
        view: Any
        rays: Any
        volume_lights: Any

        def volume_range(self, position: vec3, range: float) -> float:
            """The range in metres, of a light at `position`, that its volume needs to hold all that the view
            shows of it."""
            raise NotImplementedError

        @staticmethod
        def project_volume(center: vec3, offset: vec3, reach: float, view: Any, rays: Any) -> vec4:
            """The clip position of a corner, `offset` from the light, of a volume that reaches at most
            `reach` far."""
            raise NotImplementedError
