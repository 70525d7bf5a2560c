"""Shaders of materials: parallax, brushed metal, marble, a checkerboard, and three with lighting models of their own:
toon, cloth and skin. They show how materials get shaders of their own, and the scene `yard` has the first but brushed
metal."""

from __future__ import annotations

from typing import ClassVar, Final

import rhi.shading as sl
from renderer.light_kinds.incidence import Incidence
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.lighting_models import surface_roughness
from renderer.shaders.materials import MaterialShader
from renderer.shaders.structs import SurfaceInput, SurfaceParameters, SurfacePoint

_FLAT: Final = 0.05
"""The least cosine to a surface's normal with which parallax reckons: below it, rays would go on and on."""


class ParallaxParameters(sl.Struct):
    """Parameters of `Parallax`: the texture of heights (red, 1 at the surface), the depth of height 0 in
    texture coordinates, and the number of steps in which a ray looks for the heights."""

    height_texture: int
    depth: float
    steps: int


class Parallax(MaterialShader):
    """Relief below a surface: what is seen is where the ray meets a map of heights (Tatarchuk 2006, steep
    parallax with a linear last step). All textures are read there."""

    parameter_defaults: ClassVar = {"depth": 0.04, "steps": 24}
    parameter_textures: ClassVar = {"height_texture": False}
    reads_tangents = True

    parameters: sl.Storage[ParallaxParameters]

    def describe(self, at: SurfaceInput) -> SurfaceParameters:
        relief = self.parameters[at.material]
        met = at
        if relief.height_texture >= 0:
            met.uv = self.intersect_relief(at, relief)
        return super().describe(met)

    def intersect_relief(self, at: SurfaceInput, relief: ParallaxParameters) -> sl.vec2:
        """Return the texture coordinates at which the ray from the eye meets the heights."""
        tangent = safe_normalize(at.tangent.xyz)
        up = sl.cross(at.normal, tangent) * (-1.0 if at.tangent.w < 0.0 else 1.0)
        to_eye = self.direction_to_eye(at.position)
        steepness = sl.max(sl.dot(to_eye, at.normal), _FLAT)
        # The v of images counts down, so it falls along the bitangent.
        along = sl.vec2(-sl.dot(to_eye, tangent), sl.dot(to_eye, up)) / steepness
        step = along * relief.depth / float(relief.steps)
        probe = at
        below = 0.0
        gap = 1.0 - self.read_data(relief.height_texture, at).x
        before = gap
        for _ in range(relief.steps):
            if gap <= 0.0:
                break
            before = gap
            below += 1.0 / float(relief.steps)
            probe.uv = probe.uv + step
            gap = 1.0 - below - self.read_data(relief.height_texture, probe).x
        if gap > 0.0:
            return probe.uv
        return probe.uv + step * (gap / sl.max(before - gap, 1e-6))


class BrushedParameters(sl.Struct):
    """Parameters of `Brushed`: how anisotropic it is, from 0 to 1; the angle in radians, counter-clockwise, from the
    tangent to the direction along which highlights are drawn out; and the texture that turns and weakens them (red
    and green: a direction of -1 to 1; blue: a factor of 0 to 1)."""

    anisotropy: float
    anisotropy_rotation: float
    anisotropy_texture: int


class Brushed(MaterialShader):
    """Metal, or anything of the metallic-roughness model, whose highlights are longer in one direction, as scratches
    across it make them (glTF's KHR_materials_anisotropy)."""

    parameter_defaults: ClassVar = {"anisotropy": 0.8, "anisotropy_rotation": 0.0}
    parameter_textures: ClassVar = {"anisotropy_texture": False}
    reads_tangents = True
    has_anisotropy = True

    parameters: sl.Storage[BrushedParameters]

    def describe_anisotropy(self, at: SurfaceInput) -> sl.vec3:
        brushed = self.parameters[at.material]
        tangent = safe_normalize(at.tangent.xyz)
        up = sl.cross(at.normal, tangent) * (-1.0 if at.tangent.w < 0.0 else 1.0)
        cosine = sl.cos(brushed.anisotropy_rotation)
        sine = sl.sin(brushed.anisotropy_rotation)
        direction = sl.vec2(cosine, sine)
        strength = brushed.anisotropy
        if self.map_arrays != 0 and brushed.anisotropy_texture >= 0:
            texel = self.read_data(brushed.anisotropy_texture, at).xyz
            read = texel.xy * 2.0 - 1.0
            strength *= texel.z
            direction = sl.vec2(cosine * read.x - sine * read.y, sine * read.x + cosine * read.y)
        return safe_normalize(tangent * direction.x + up * direction.y) * sl.saturate(strength)


class MarbleParameters(sl.Struct):
    """Parameters of `Marble`: the colour of its veins, their number in a metre, and how much noise bends
    them."""

    vein_color: sl.vec3
    frequency: float
    turbulence: float


@sl.function
def value_noise(position: sl.vec3) -> float:
    """Return smooth noise of -1 to 1, which changes over lengths of 1: a number for each corner of a grid,
    mixed."""
    cell = sl.floor(position)
    part = position - cell
    weight = part * part * part * (part * (part * 6.0 - 15.0) + 10.0)
    corner = sl.ivec3(cell)
    sum = 0.0
    for i in range(8):
        offset = sl.ivec3(i & 1, i >> 1 & 1, i >> 2)
        share = sl.mix(1.0 - weight, weight, sl.vec3(offset))
        sum += hash_corner(corner + offset) * share.x * share.y * share.z
    return sum


@sl.function
def hash_corner(corner: sl.ivec3) -> float:
    """Return a number of -1 to 1 for a corner of the grid (PCG, O'Neill 2014)."""
    word = sl.uint(corner.x) * sl.uint(73856093) ^ sl.uint(corner.y) * sl.uint(19349663)
    word = (word ^ sl.uint(corner.z) * sl.uint(83492791)) * sl.uint(747796405) + sl.uint(2891336453)
    word = (word >> ((word >> 28) + sl.uint(4)) ^ word) * sl.uint(277803737)
    return float((word >> 22 ^ word) >> 8) / 8388608.0 - 1.0


class Marble(MaterialShader):
    """Stone with veins through the whole of it: waves in the world's space, bent by noise (Perlin 1985,
    turbulence). Objects that move move through it."""

    parameter_defaults: ClassVar = {"vein_color": (0.2, 0.18, 0.16), "frequency": 1.6, "turbulence": 1.2}

    parameters: sl.Storage[MarbleParameters]

    def describe(self, at: SurfaceInput) -> SurfaceParameters:
        stone = self.parameters[at.material]
        position = self.world_position(at) * stone.frequency
        bend = 0.0
        size = 1.0
        for _ in range(4):
            bend += size * sl.abs(value_noise(position / size))
            size *= 0.5
        wave = 0.5 + 0.5 * sl.sin(6.2831853 * (position.x + position.y + stone.turbulence * bend))
        vein = wave * wave * wave
        described = super().describe(at)
        described.color = described.color * sl.vec4(sl.mix(sl.vec3(1.0), stone.vein_color, vein), 1.0)
        described.roughness = sl.saturate(described.roughness + 0.3 * vein)
        return described


class CheckerParameters(sl.Struct):
    """Parameters of `Checker`: the number of squares along u and v, and the colour of every second one."""

    squares: sl.vec2
    second_color: sl.vec3


class Checker(MaterialShader):
    """A checkerboard that doesn't alias: the mean over a pixel's box, in closed form (Quílez 2017). Its
    numbers of squares are even, so that it goes on where texture coordinates begin again."""

    parameter_defaults: ClassVar = {"squares": (8.0, 8.0), "second_color": (0.1, 0.1, 0.1)}

    parameters: sl.Storage[CheckerParameters]

    def describe(self, at: SurfaceInput) -> SurfaceParameters:
        board = self.parameters[at.material]
        position = at.uv * board.squares
        width = sl.max(
            (sl.abs(at.uv_gradients.xy) + sl.abs(at.uv_gradients.zw)) * board.squares, sl.vec2(1e-4)
        )
        # The integral of a square wave of +1 and -1 is a triangle wave; their differences over a box are its
        # mean.
        ahead = sl.abs(sl.fract((position + 0.5 * width) * 0.5) - 0.5)
        behind = sl.abs(sl.fract((position - 0.5 * width) * 0.5) - 0.5)
        mean = 2.0 * (behind - ahead) / width
        share = 0.5 - 0.5 * mean.x * mean.y
        described = super().describe(at)
        described.color = described.color * sl.vec4(sl.mix(sl.vec3(1.0), board.second_color, share), 1.0)
        return described


class ToonParameters(sl.Struct):
    """Parameters of `Toon`: the number of steps of light below the brightest one, and the part of a step, from 0 to 1,
    in which one turns into the next."""

    steps: float
    softness: float


@sl.function
def toon(surface: SurfacePoint, light: Incidence, own: ToonParameters) -> sl.vec3:
    """Return light that falls off in steps, and no highlight."""
    facing = sl.saturate(sl.dot(surface.normal, light.direction)) * own.steps
    step = sl.floor(facing)
    width = sl.max(own.softness, 1e-4)
    level = step + sl.smoothstep(1.0 - width, 1.0, facing - step)
    return surface.base_color * light.irradiance * (level / own.steps)


class Toon(MaterialShader):
    """Surfaces that are lit in steps, as in drawn cartoons."""

    parameter_defaults: ClassVar = {"steps": 3.0, "softness": 0.1}
    lighting_model: ClassVar = toon

    parameters: sl.Storage[ToonParameters]


class ClothParameters(sl.Struct):
    """Parameters of `Cloth`: the colour of the fibres that stand out of it."""

    sheen_color: sl.vec3


@sl.function
def cloth(surface: SurfacePoint, light: Incidence, own: ClothParameters) -> sl.vec3:
    """Return scattered light and the sheen of fibres: the "Charlie" lobe (Estevez and Kulla 2017), with the masking of
    Neubelt and Pettineo (2013)."""
    facing = sl.dot(surface.normal, light.direction)
    if facing <= 0.0:
        return sl.vec3(0.0)
    roughness = surface_roughness(surface)
    halfway = safe_normalize(light.direction + surface.to_eye)
    along = sl.dot(surface.normal, halfway)
    inverse = 1.0 / sl.max(roughness * roughness, 1e-2)
    lobe = (2.0 + inverse) * 0.5 * sl.pow(sl.max(1.0 - along * along, 1e-6), 0.5 * inverse)  # times π
    seen = sl.abs(sl.dot(surface.normal, surface.to_eye))
    masked = 4.0 * (facing + seen - facing * seen)
    return (surface.base_color + own.sheen_color * (lobe / masked)) * light.irradiance * facing


class Cloth(MaterialShader):
    """Velvet and other cloth: bright where fibres stand against the light."""

    parameter_defaults: ClassVar = {"sheen_color": (0.3, 0.3, 0.3)}
    lighting_model: ClassVar = cloth

    parameters: sl.Storage[ClothParameters]


class SkinParameters(sl.Struct):
    """Parameters of `Skin`: how far light wraps around it, from 0 to 1, for red, green and blue."""

    wrap: sl.vec3


@sl.function
def skin(surface: SurfacePoint, light: Incidence, own: SkinParameters) -> sl.vec3:
    """Return light that wraps around the surface, as if it were scattered below it; all of it together stays as much
    (wrapped diffuse lighting, d'Eon and Luebke 2007)."""
    wrap = sl.saturate(own.wrap)
    facing = (sl.dot(surface.normal, light.direction) + wrap) / ((1.0 + wrap) * (1.0 + wrap))
    return surface.base_color * light.irradiance * sl.max(facing, 0.0)


class Skin(MaterialShader):
    """Skin, wax or leaves: light reaches round into the shade, red the farthest."""

    parameter_defaults: ClassVar = {"wrap": (0.5, 0.25, 0.15)}
    lighting_model: ClassVar = skin

    parameters: sl.Storage[SkinParameters]
