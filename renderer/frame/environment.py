"""Environments on a device: the light that surfaces mirror, filtered for each roughness, and what they scatter.

- `environment_image`: the image with mip levels, each the mean of the one above by solid angle. All is divided
  by a power of two if a half float couldn't hold the brightest texel; shaders multiply it again.
- `environment`: an octahedral map (Engelhardt and Dachsbacher 2008). Its level k has the light as a lobe of
  the roughness `LEAST_ROUGHNESS` · 10^(k / (levels - 1)) gathers it, normal and eye in the direction of the
  texel (Karis 2013). A border of one texel repeats what is beyond the edge, so filters see no seams.
- Its second layer has the light that surfaces scatter, by their normal, in one level: sums over the image, in
  float64 on the CPU. Spherical harmonics would need less memory, but ring: those of the bands 0 to 4 are off by
  3 % of the sun's light on what the sun doesn't reach, which is bright stripes where it is all there is.
- The sum of a lobe (split-sum, Karis 2013): a table by roughness and √(n · v), as two shares of the light, one
  times the specular colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer import rules
from renderer.scene.environment import Environment, row_weights, texel_directions
from renderer.shaders.environment import (
    LEAST_ROUGHNESS,
    RESPONSE_SIZE,
    SCATTERED_SIZE,
    EnvironmentConstants,
    decode_octahedral,
)
from rhi import (
    BlendFunction,
    CullMode,
    DepthTest,
    DepthWrite,
    Device,
    Format,
    SamplerDescriptor,
    Texture,
    TextureKind,
    UniformBuffer,
    Wrap,
    refuse,
)
from rhi.math.indexing import repeat_each
from rhi.shading import TextureBinding

_SIZES: Final = (64, 128, 256, 512)
MAX_BRIGHT: Final = 64
"""The most texels whose light is added to lobes one by one."""
_BRIGHT: Final = 16.0
"""How many times as bright as the mean of the others such texels are at least."""
_COARSEST: Final = 16
"""The size of the last level, whose lobe is as wide as lobes get."""
_TEXEL_WIDTH: Final = 0.3
"""The width of the lobe of a bright texel, in texels."""
_WIDE: Final = 0.3
"""The roughness from which on lobes sum all texels of a level of the image."""
_COLUMNS: Final = 42.0
"""The most columns of the image that lobes of a roughness of 1 sum; narrower ones sum more."""
_COARSE: Final = 128
"""The most columns of the image from which scattered light is summed: texels of 2.8°."""
_MOST_SAMPLES: Final = 4096
_LARGEST_HALF: Final = 32768.0
"""The brightest texel that is stored: half of what a half float holds."""
_AROUND: Final = SamplerDescriptor(wrap_u=Wrap.REPEAT, wrap_v=Wrap.CLAMP)
_EDGE: Final = SamplerDescriptor(wrap_u=Wrap.CLAMP, wrap_v=Wrap.CLAMP)


@dataclass(frozen=True, slots=True)
class EnvironmentSettings:
    """Settings of the accuracy of light from environments.

    Attributes:
        size: the width of the map of mirrored light in texels: 64, 128, 256 or 512.
        samples: directions that a texel is the mean of, 8 to 4096.
    """

    size: int = 256
    samples: int = 128

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_ENVIRONMENT_SETTINGS)
        if self.size not in _SIZES:
            allowed = f"one of {', '.join(map(str, _SIZES))}"
            refuse(rules.BAD_ENVIRONMENT_SETTINGS, "EnvironmentSettings(size=...)", self.size, allowed)
        if not 8 <= self.samples <= _MOST_SAMPLES:
            allowed = f"a whole number from 8 to {_MOST_SAMPLES}"
            refuse(rules.BAD_ENVIRONMENT_SETTINGS, "EnvironmentSettings(samples=...)", self.samples, allowed)


DEFAULT_ENVIRONMENT: Final = EnvironmentSettings()
"""Light from environments as frames have it unless told otherwise."""


class FilterConstants(sl.Struct):
    """The level that is filtered: its size in texels, roughness² and number of samples; the solid angle of a
    texel at the equator of the image; and the level of the image whose texels are summed.

    `directions` and `light` are those of `count` texels that are far brighter than the rest, their light times
    their solid angle. Their lobes have the roughness² `bright_alpha`, which is as wide as a texel at least.
    """

    size: float
    alpha: float
    samples: int
    texel: float
    source_level: int
    count: int
    bright_alpha: float
    directions: sl.Array[sl.vec4] = sl.array(sl.vec4, MAX_BRIGHT)
    light: sl.Array[sl.vec4] = sl.array(sl.vec4, MAX_BRIGHT)


class LobeShader(sl.FullScreen):
    """The base of shaders that gather light by lobes of GGX around the direction of each texel."""

    level: sl.Uniform[FilterConstants]
    environment_image: sl.Texture2D

    def texel_direction(self) -> sl.vec3:
        """Return the direction of the fragment's texel."""
        inner = self.level.size - 2.0
        at = (sl.fragment_coordinate().xy - 1.0) * (2.0 / inner) - 1.0
        # Beyond an edge the map goes on from the other end of the same edge.
        if sl.abs(at.x) > 1.0:
            at = sl.vec2(2.0 * sl.sign(at.x) - at.x, -at.y)
        if sl.abs(at.y) > 1.0:
            at = sl.vec2(-at.x, 2.0 * sl.sign(at.y) - at.y)
        return decode_octahedral(at)

    def sum_bright_texels(self, normal: sl.vec3) -> sl.vec3:
        """Return the light of the brightest texels in the lobe, times 4 π of its density."""
        square = self.level.bright_alpha * self.level.bright_alpha
        total = sl.vec3(0.0)
        for number in range(self.level.count):
            lit = sl.dot(self.level.directions[number].xyz, normal)
            if lit > 0.0:
                away = normal - self.level.directions[number].xyz  # as 1 - n·l, with all digits
                sine_square = 0.25 * sl.dot(away, away)
                spread = sine_square + square * (1.0 - sine_square)
                total += self.level.light[number].rgb * (square * lit / (spread * spread))
        return total


class SampledLobes(LobeShader):
    """Gathers light of narrow lobes, by samples that each have the mean light of their solid angle (Krivanek and
    Colbert 2008)."""

    def fragment(self) -> sl.vec4:
        normal = self.texel_direction()
        aside = sl.vec3(1.0, 0.0, 0.0) if sl.abs(normal.x) < 0.6 else sl.vec3(0.0, 0.0, 1.0)
        right = sl.normalize(sl.cross(aside, normal))
        up = sl.cross(normal, right)
        square = self.level.alpha * self.level.alpha
        total = sl.vec3(0.0)
        weights = 0.0
        for number in range(self.level.samples):
            # A lattice: even in the lobe's share, and turned by the golden angle.
            share = (float(number) + 0.5) / float(self.level.samples)
            angle = 6.2831853 * sl.fract(float(number) * 0.61803399)
            # sin² of the angle between normal and half vector; 1 - cos² would lose its digits.
            lower = 1.0 + (square - 1.0) * share
            sine_square = square * share / lower
            cosine_square = (1.0 - share) / lower
            sine = sl.sqrt(sine_square)
            cosine = sl.sqrt(cosine_square)
            half_vector = (right * sl.cos(angle) + up * sl.sin(angle)) * sine + normal * cosine
            lit = cosine_square - sine_square  # the eye is along the normal
            if lit > 0.0:
                toward = half_vector * (2.0 * cosine) - normal
                spread = sine_square + square * cosine_square
                density = square / (3.14159265 * spread * spread) * 0.25
                solid_angle = 1.0 / (float(self.level.samples) * density)
                total += self.sample_light(toward, solid_angle) * lit
                weights += lit
        total += self.sum_bright_texels(normal) * (float(self.level.samples) * 0.079577472)
        return sl.vec4(total / weights, 1.0)

    def sample_light(self, toward: sl.vec3, solid_angle: float) -> sl.vec3:
        """Return the mean light of about a solid angle."""
        ring = sl.sqrt(sl.max(toward.x * toward.x + toward.z * toward.z, 1e-6))
        level = 0.5 * sl.log2(sl.max(solid_angle / (self.level.texel * ring), 1.0)) + 0.5
        at = sl.vec2(
            0.5 + sl.atan2(toward.x, -toward.z) * 0.15915494,
            sl.acos(sl.clamp(toward.y, -1.0, 1.0)) * 0.31830989,
        )
        return self.environment_image.sample_lod(at, level).rgb


class SummedLobes(LobeShader):
    """Gathers light of wide lobes: sums all texels of a level of the image, so that nothing is missed."""

    def fragment(self) -> sl.vec4:
        normal = self.texel_direction()
        square = self.level.alpha * self.level.alpha
        size = self.environment_image.size(self.level.source_level)
        total = sl.vec3(0.0)
        weights = 0.0
        for row in range(size.y):
            polar = (float(row) + 0.5) * (3.14159265 / float(size.y))
            ring = sl.sin(polar)
            height = sl.cos(polar) * normal.y
            for column in range(size.x):
                around = ((float(column) + 0.5) / float(size.x) - 0.5) * 6.2831853
                lit = ring * (sl.sin(around) * normal.x - sl.cos(around) * normal.z) + height
                if lit > 0.0:
                    # sin² and cos² of half the angle: of that to the half vector
                    spread = 0.5 - 0.5 * lit + square * (0.5 + 0.5 * lit)
                    weight = ring * lit / (spread * spread)
                    total += (
                        self.environment_image.load(sl.ivec2(column, row), self.level.source_level).rgb
                        * weight
                    )
                    weights += weight
        total += self.sum_bright_texels(normal) * (
            float(size.x * size.y) * 0.050660592 / (self.level.alpha * self.level.alpha)
        )
        return sl.vec4(total / weights, 1.0)


def split_bright_texels(
    image: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.float64]]:
    """Return an image (h, w, 3) without what its brightest texels have more than the others; the directions (k, 3)
    of these; and the light (k, 3) that they have more, times their solid angles. Samples would miss them."""
    height, width = image.shape[:2]
    strength = image.max(axis=2).reshape(-1)
    angles = repeat_each(row_weights(height) / width, width)
    most = min(MAX_BRIGHT + 1, strength.size)
    dimmest = float(np.partition(strength, -most)[-most])
    limit = max(dimmest, _BRIGHT * float(angles @ np.minimum(strength, dimmest)) / (4.0 * np.pi))
    bright = np.flatnonzero(strength > limit)
    if limit <= 0.0 or not len(bright):
        return image, np.zeros((0, 3)), np.zeros((0, 3))
    rest = image.reshape(-1, 3).copy()
    rest[bright] *= (limit / strength[bright])[:, None]
    light = (image.reshape(-1, 3)[bright].astype(np.float64) - rest[bright]) * angles[bright, None]
    return rest.reshape(image.shape), texel_directions(height, width).reshape(-1, 3)[bright], light


def halve(image: NDArray[np.float32], weights: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return an equirectangular image (h, w, 3) of half the size, rounded down, whose texels have the mean
    light of what they cover.

    Args:
        weights: the solid angles (h,) of the rows.
    """
    height, width = image.shape[:2]
    if width > 1:
        across = _cover(width, width // 2)
        image = np.einsum("ij,hjc->hic", across / across.sum(axis=1, keepdims=True), image, optimize=True)
    if height > 1:
        down = _cover(height, height // 2) * weights
        image = np.einsum("ij,jwc->iwc", down / down.sum(axis=1, keepdims=True), image, optimize=True)
    return np.ascontiguousarray(image, np.float32)


def _cover(size: int, smaller: int) -> NDArray[np.float64]:
    """Return the share (smaller, size) of each texel of a row that each texel of a smaller row covers."""
    edges = np.arange(smaller + 1) * (size / smaller)
    texels = np.arange(size)
    begins, ends = np.maximum(edges[:-1, None], texels), np.minimum(edges[1:, None], texels + 1.0)
    return np.asarray(np.maximum(ends - begins, 0.0))


def make_levels(image: NDArray[np.float32], largest: int) -> list[NDArray[np.float32]]:
    """Return an image's mip levels down to one texel, from the first that fits in `largest` texels on."""
    levels = [image]
    while max(levels[-1].shape[:2]) > 1:
        levels.append(halve(levels[-1], row_weights(levels[-1].shape[0])))
    return [level for level in levels if max(level.shape[:2]) <= largest]


def compute_scattered(image: NDArray[np.float32], size: int) -> NDArray[np.float64]:
    """Return the light (size, size, 3) that a white surface scatters, by its normal, as an octahedral map with a
    border of one texel: the irradiance over π.

    Args:
        image: an equirectangular image, of at most some hundred columns.
    """
    height, width = image.shape[:2]
    directions = texel_directions(height, width).reshape(-1, 3)
    light = image.reshape(-1, 3) * repeat_each(row_weights(height) / (width * np.pi), width)[:, None]
    rows = [np.maximum(row @ directions.T, 0.0) @ light for row in map_directions(size)]
    return np.stack(rows)


def map_directions(size: int) -> NDArray[np.float64]:
    """Return the unit directions (size, size, 3) of the texels of an octahedral map with a border."""
    texels = (np.arange(size) - 0.5) * (2.0 / (size - 2)) - 1.0
    x, z = np.meshgrid(texels, texels)
    for _ in range(2):  # beyond an edge the map goes on from the other end of the same edge
        is_beyond = np.abs(x) > 1.0
        x, z = np.where(is_beyond, 2.0 * np.sign(x) - x, x), np.where(is_beyond, -z, z)
        x, z = z, x
    height = 1.0 - np.abs(x) - np.abs(z)
    fold = np.maximum(-height, 0.0)
    x, z = (axis - np.where(axis >= 0.0, fold, -fold) for axis in (x, z))
    directions = np.stack([x, height, z], axis=-1)
    return np.asarray(directions / np.linalg.norm(directions, axis=-1, keepdims=True))


@cache
def compute_response() -> NDArray[np.float64]:
    """Return the share of even light that a lobe of the metallic-roughness model reflects, (RESPONSE_SIZE,
    RESPONSE_SIZE, 2) by roughness, `LEAST_ROUGHNESS` to 1, and √(n · v), 0 to 1: times the specular colour,
    and apart from it.

    Half vectors are spread by the lobe, so each counts 4 V n·l v·h / n·h (Karis, Real Shading in Unreal
    Engine 4, 2013).
    """
    count = 128
    share, turn = np.meshgrid((np.arange(count) + 0.5) / count, (np.arange(count) + 0.5) / count * np.pi)
    table = np.zeros((RESPONSE_SIZE, RESPONSE_SIZE, 2))
    for i, roughness in enumerate(np.linspace(LEAST_ROUGHNESS, 1.0, RESPONSE_SIZE)):
        square = roughness**4
        cosine = np.sqrt((1.0 - share) / (1.0 + (square - 1.0) * share))
        sine = np.sqrt(1.0 - cosine**2)
        for j, root in enumerate(np.linspace(0.0, 1.0, RESPONSE_SIZE)):
            seen = max(root * root, 1e-4)
            along = sine * np.cos(turn) * np.sqrt(1.0 - seen * seen) + cosine * seen
            lit = 2.0 * along * cosine - seen
            is_lit = (lit > 0.0) & (along > 0.0)
            lit = np.where(is_lit, lit, 1.0)
            masks = (lit + np.sqrt(square + (1.0 - square) * lit * lit)) * (
                seen + np.sqrt(square + (1.0 - square) * seen * seen)
            )
            weight = np.where(is_lit, 4.0 * lit * along / (masks * cosine), 0.0)
            grazing = (1.0 - np.clip(along, 0.0, 1.0)) ** 5
            table[i, j] = (weight * (1.0 - grazing)).mean(), (weight * grazing).mean()
    return table


class EnvironmentMaps:
    """The textures and constants of an environment, made again when the environment or its settings change.

    Attributes:
        image: the image with its levels, as it is sampled.
        filtered: the map of mirrored light, as it is sampled.
        constants: the rest.
        textures: what of this is textures: the image, and the map.
        updates: how often the maps were made.
    """

    image: TextureBinding
    filtered: TextureBinding
    constants: UniformBuffer[EnvironmentConstants]

    def __init__(self, device: Device) -> None:
        self._device = device
        self.textures: list[Texture] = []
        self._last: tuple[object, ...] = ()
        self._scale = 1.0
        self._is_written = False
        self.updates = 0

    def update(self, environment: Environment, settings: EnvironmentSettings) -> bool:
        """Make the maps of an environment unless they exist; return whether textures were made."""
        state = environment.image, settings
        is_new = not self._last or self._last[0] is not state[0] or self._last[1] != state[1]
        if is_new:
            self.release()
            self._make(environment.image, settings)
            self._last = state
            self.updates += 1
        constants = self._make_constants(environment, settings)
        if not self._is_written:
            self.constants = self._device.uniform(constants)
            self._is_written = True
            self._constants_of = environment, settings
        elif self._constants_of != (environment, settings):
            self.constants.write(constants)
            self._constants_of = environment, settings
        return is_new

    def _make(self, image: NDArray[np.float32], settings: EnvironmentSettings) -> None:
        """Upload the image, and filter it for each level of roughness."""
        device, brightest = self._device, float(image.max())
        self._scale = 2.0 ** max(np.ceil(np.log2(max(brightest, 1.0) / _LARGEST_HALF)), 0.0)
        levels = make_levels(image, device.capabilities.max_texture_size)
        height, width = levels[0].shape[:2]
        source = self._upload(levels)
        self.image = source.sampled(_AROUND)
        count = count_levels(settings.size)
        size = settings.size
        filtered = device.texture(
            (size, size),
            Format.RGBA16F,
            kind=TextureKind.D2_ARRAY,
            layers=2,
            levels=count,
            label="environment",
        )
        self.textures.append(filtered)
        coarse = next(level for level in levels if max(level.shape[:2]) <= _COARSE)
        scattered = np.ones((SCATTERED_SIZE, SCATTERED_SIZE, 4), np.float16)
        scattered[..., :3] = compute_scattered(coarse, SCATTERED_SIZE) / self._scale
        filtered.write(scattered, level=(size // SCATTERED_SIZE).bit_length() - 1, layer=1)
        sampled, summed = device.program(SampledLobes), device.program(SummedLobes)
        triangle = device.mesh(3, label="whole target")
        rest, directions, light = split_bright_texels(levels[0])
        dim = self._upload(make_levels(rest, max(width, height))) if len(directions) else source
        bright = np.zeros((2, MAX_BRIGHT, 4))
        bright[0, : len(directions), :3], bright[1, : len(light), :3] = directions, light / self._scale
        states = CullMode.NONE, DepthTest.OFF, DepthWrite.OFF, BlendFunction.OFF
        for number in range(count):
            roughness = LEAST_ROUGHNESS * (1.0 / LEAST_ROUGHNESS) ** (number / (count - 1))
            constants = FilterConstants(
                size=float(size >> number),
                alpha=roughness * roughness,
                samples=settings.samples,
                texel=2.0 * np.pi * np.pi / (width * height),
                source_level=count_finer_levels(levels, roughness),
                count=len(directions),
                bright_alpha=float(np.hypot(roughness * roughness, _TEXEL_WIDTH * np.pi / height)),
                directions=bright[0],
                light=bright[1],
            )
            program = sampled if roughness < _WIDE else summed
            with device.render_pass(filtered.at(number, 0)), device.states(*states):
                device.draw(program, triangle, level=constants, environment_image=dim.sampled(_AROUND))
        triangle.destroy()
        if dim is not source:
            self.textures.remove(dim)
            dim.destroy()
        self.filtered = filtered.sampled(_EDGE)

    def _upload(self, levels: Sequence[NDArray[np.float32]]) -> Texture:
        """Create a texture of an image's levels, over the scale."""
        height, width = levels[0].shape[:2]
        texture = self._device.texture(
            (width, height), Format.RGBA16F, levels=len(levels), label="environment image"
        )
        self.textures.append(texture)
        for number, level in enumerate(levels):
            texels = np.ones((*level.shape[:2], 4), np.float16)
            texels[..., :3] = level / self._scale
            texture.write(texels, level=number)
        return texture

    def _make_constants(
        self, environment: Environment, settings: EnvironmentSettings
    ) -> EnvironmentConstants:
        return EnvironmentConstants(
            response=compute_response().reshape(-1, 4),
            turn=(np.cos(environment.turn), np.sin(environment.turn)),
            strength=environment.intensity * self._scale,
            last_level=float(count_levels(settings.size) - 1),
            size=float(settings.size),
        )

    def release(self) -> None:
        """Destroy all resources; they are made again by the next `update`."""
        for texture in self.textures:
            texture.destroy()
        self.textures.clear()
        if self._is_written:
            self.constants.destroy()
        self._last, self._is_written = (), False

    def destroy(self) -> None:
        """Destroy all resources."""
        self.release()


def count_finer_levels(levels: Sequence[NDArray[np.float32]], roughness: float) -> int:
    """Return the index of the first level of an image with few enough texels for a lobe of this roughness."""
    most = _COLUMNS / roughness**1.15
    return next(number for number, level in enumerate(levels) if max(level.shape[:2]) <= most)


def count_levels(size: int) -> int:
    """Return the number of levels of a map of this size: the last one has `_COARSEST` texels."""
    return (size // _COARSEST).bit_length()
