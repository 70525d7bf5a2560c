"""Ray-traced images: rays through pixels, surfaces in the order in which a ray meets them, tone mapping and
sRGB."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lab.measure.ray_tracer.bounces import are_blurred, bend_rays, mirror_rays
from renderer.lab.measure.ray_tracer.shading import (
    LitSurfaces,
    optical_depth,
    take_surfaces,
)
from renderer.lab.measure.ray_tracer.surfaces import Geometry, Surfaces, encode_srgb, measure_gap, normalize
from renderer.lab.measure.ray_tracer.triangle_tree import Floats, Hits, TriangleTree
from renderer.scene import Camera, Scene

_CHUNK: Final = 1 << 15
"""Rays that are traced together."""
_MOST_BOUNCES: Final = 16
_MIRRORED_RAYS: Final = 16
"""Rays that go on from a surface that the eye sees, if it blurs what it mirrors. All others are single rays."""
_DISTANCE_SHELLS: Final = 4.0 ** np.arange(-5, 1)
"""Distances, relative to the scene's size, to which rays are traced in turn; only rays that met nothing
opaque continue."""
_EXPOSURE: Final = 0.6
APERTURE_POINTS: Final = 128
"""Points of the aperture that light is traced through, spread evenly, if the scene has depth of field."""
_GOLDEN_ANGLE: Final = np.pi * (3.0 - np.sqrt(5.0))


@dataclass(frozen=True, slots=True)
class RayKind:
    """Rays that are followed together.

    Attributes:
        bounces: how many times they may still go on from a surface.
        brings_light: True if they bring light; else colours from 0 to 1, and haze fades to the background's.
        is_mirrored: True if a surface has mirrored them. Then they don't end in the background, which only the eye
            sees, but in the light of the sky and the ground.
    """

    bounces: int
    brings_light: bool
    is_mirrored: bool = False


class RayTracer:
    """Renders a scene as it stands, in float64; see the package.

    With depth of field, a pixel's light is the mean of rays through `APERTURE_POINTS` points of the aperture, which
    meet in the plane of the focus; tones are mapped after that.

    Surfaces reflect the sky and the ground, or an environment, but not each other, as in the renderer's images. With
    `bounces`, rays go on from surfaces: see `bounces.py`.

    Attributes:
        has_shadows: whether lights that cast shadows do.
        has_penumbras: whether shadows are of the whole source instead of its centre.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        has_shadows: bool = True,
        has_penumbras: bool = False,
        earlier: RayTracer | None = None,
        bounces: int = 0,
        refraction_index: float = 1.0,
    ) -> None:
        """Prepare to render the scene as it stands.

        Args:
            bounces: how many times rays go on from surfaces that mirror or bend them, 0 to 16. Surfaces that aren't
                smooth mirror to random sides, so few rays a pixel make noise.
            refraction_index: of transparent objects, relative to what is around them, 0.25 to 4. Unless it is 1 or
                nothing bounces, they are bodies with closed surfaces, which bend rays.
            earlier: rendered the scene in an earlier state. If only objects have moved since, its order of
                triangles is used again: preparing takes a third of the time.

        Raises:
            ValueError: the scene has no visible object, or bloom, or material shaders; or bounces or the index of
                refraction are out of range.
        """
        if not 0 <= bounces <= _MOST_BOUNCES:
            raise ValueError(f"bounces={bounces}: expected 0 to {_MOST_BOUNCES}")
        if not 0.25 <= refraction_index <= 4.0:
            raise ValueError(
                f"refraction_index={refraction_index}: expected 0.25 to 4 (water has 1.33, glass 1.5)"
            )
        if not scene.objects.is_shown.any():
            raise ValueError("the scene has no visible object")
        if scene.bloom is not None:
            raise ValueError("bloom can't be rendered by single rays")
        if scene.shaders:
            raise ValueError("the reference ray tracer can't evaluate custom material shaders")
        self._scene, self._geometry = scene, Geometry(scene)
        self._bounces, self._refraction_index = bounces, refraction_index
        self._rng = np.random.default_rng(0)
        order = None
        if earlier is not None and np.array_equal(earlier._geometry.objects, self._geometry.objects):
            order = earlier._tree.order
        self._tree: TriangleTree = TriangleTree(self._geometry.corners, order)
        self._lighting = LitSurfaces(
            scene, self._geometry, self._tree, has_shadows=has_shadows, has_penumbras=has_penumbras
        )

    def draw(
        self,
        camera: Camera,
        size: tuple[int, int],
        rays: int = 1,
        every: int = 1,
        at: tuple[float, float] = (0.5, 0.5),
    ) -> Floats:
        """Render an image (h, w, 3) in levels of 255, not rounded.

        Args:
            camera: a perspective or a parallel one, or an eye's.
            size: width and height.
            rays: rays along each side of a pixel, each at a random position in its part.
            every: one in so many pixels along each axis is traced; the others are NaN.
            at: where in a pixel a single ray is, from its top left corner.
        """
        width, height = size
        x, y = (
            coordinates.reshape(-1)
            for coordinates in np.meshgrid(*(np.arange(side)[every // 2 :: every] for side in size))
        )
        pixel_positions = np.stack([x, y], axis=1)
        rng = np.random.default_rng(0)
        positions = np.empty((len(pixel_positions), rays**2, 2))  # the rays of a pixel beside each other
        for number, (row, column) in enumerate(np.ndindex(rays, rays)):
            part = rng.uniform(size=pixel_positions.shape) if rays > 1 else at
            positions[:, number] = pixel_positions + (np.array([column, row]) + part) / rays
        light = self.trace(camera, size, positions.reshape(-1, 2)).reshape(-1, rays**2, 3).sum(axis=1)
        image = np.full((height, width, 3), np.nan)
        image[y, x] = 255.0 * encode_srgb(light / rays**2)
        return image

    def trace(self, camera: Camera, size: tuple[int, int], pixel_positions: Floats) -> Floats:
        """The linear colours (k, 3) from 0 to 1 at positions (k, 2) of an image, in pixels from its top left
        corner."""
        origins, directions, first, last = aim(camera, size, pixel_positions)
        self._rng = np.random.default_rng(0)
        depth_of_field = self._scene.depth_of_field
        kind = RayKind(self._bounces, brings_light=depth_of_field is not None)
        if depth_of_field is None:
            return self._follow_all(origins, directions, first, last, kind)
        light = np.zeros((len(pixel_positions), 3))
        for number in range(APERTURE_POINTS):
            radius = depth_of_field.aperture_radius * np.sqrt((number + 0.5) / APERTURE_POINTS)
            angle = number * _GOLDEN_ANGLE
            point = radius * (np.cos(angle) * camera.rotation[0] + np.sin(angle) * camera.rotation[1])
            towards = directions - point / depth_of_field.focus_distance
            light += self._follow_all(origins + point, towards, first, last, kind)
        return tone_map(light / APERTURE_POINTS)

    def _follow_all(
        self, origins: Floats, directions: Floats, first: float, last: float, kind: RayKind
    ) -> Floats:
        colors = np.zeros(origins.shape)
        for begin in range(0, len(origins), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            colors[part] = self._follow(origins[part], directions[part], first, last, kind)
        return colors

    def _collect_surfaces(
        self, origins: Floats, directions: Floats, first: float, last: float, *, bends: bool
    ) -> Hits:
        """All hits that are visible along rays, the nearest first: glass, and at the end an opaque surface, or the
        first glass if it `bends` rays."""
        lower, upper = self._geometry.lower, self._geometry.upper
        size = np.linalg.norm(upper - lower) / np.linalg.norm(directions, axis=1).min()
        farthest = (
            float(np.maximum(np.abs(lower - origins[:1]), np.abs(upper - origins[:1])).max()) * 2.0 + size
        )
        open_rays, hit_batches = np.arange(len(origins)), []
        begin = first
        for end in (*(first + size * _DISTANCE_SHELLS), first + farthest + size):
            if end <= begin or not len(open_rays):
                continue
            far = np.full(len(origins), min(end, last))
            hits = self._tree.intersect(
                origins[open_rays], directions[open_rays], np.full(len(origins), begin), far
            )
            hits = Hits(open_rays[hits.ray], hits.triangle, hits.distance, hits.second, hits.third)
            hits = hits.take(self._geometry.are_visible(hits, directions, has_glass_backs=bends))
            hits = hits.take(np.lexsort([hits.distance, hits.ray]))
            is_solid = ~self._geometry.is_glass[self._geometry.objects[hits.triangle]] | bends
            stop = np.full(len(origins), np.inf)
            np.minimum.at(stop, hits.ray[is_solid], hits.distance[is_solid])
            hit_batches.append(hits.take(hits.distance <= stop[hits.ray]))
            open_rays, begin = open_rays[np.isinf(stop[open_rays])], min(end, last)
        hits = Hits(
            *(np.concatenate([getattr(batch, name) for batch in hit_batches]) for name in Hits.__slots__)
        )
        hits = hits.take(np.lexsort([hits.distance, hits.ray]))
        return hits.take(~self._are_repeated(hits))

    def _are_repeated(self, hits: Hits) -> Any:
        """The hits that repeat the hit before them, on an edge that two triangles of an object share."""
        objects = self._geometry.objects[hits.triangle]
        again = (hits.ray[1:] == hits.ray[:-1]) & (objects[1:] == objects[:-1])
        again &= hits.distance[1:] - hits.distance[:-1] <= 1e-9 * np.abs(hits.distance[1:])
        return np.concatenate([[False], again])[: len(hits.ray)]

    def _follow(
        self, origins: Floats, directions: Floats, first: float, last: float, kind: RayKind
    ) -> Floats:
        """The colours (k, 3) that rays bring, or their light."""
        bends = kind.bounces > 0 and self._refraction_index != 1.0
        hits = self._collect_surfaces(origins, directions, first, last, bends=bends)
        seen = self._geometry.surfaces_at(hits, origins, directions)
        # Light is seen where its ray leaves the eye, or the eye's plane; air behind that isn't seen through.
        start = np.where(hits.distance[:, None] > 0.0, origins[hits.ray], seen.position)
        mirrored = self._follow_mirrored(seen, kind) if kind.bounces else None
        color = self._pass_air(self._lighting.light(seen, mirrored), start, seen.position, kind)
        total = self._draw_background(origins, directions, kind)
        if bends:
            glass = np.flatnonzero(self._geometry.is_glass[self._geometry.objects[hits.triangle]])
            is_leaving = ~self._geometry.are_fronts(hits.take(glass), directions)
            beyond = self._follow_bent(take_surfaces(seen, glass), is_leaving, kind)
            total[hits.ray[glass]] = self._pass_air(beyond, start[glass], seen.position[glass], kind)
        # Glass lets through what it doesn't cover: each surface is seen through all before it of the same
        # ray.
        clear = 1.0 - seen.alpha
        order = np.arange(len(hits.ray))
        begins = np.searchsorted(hits.ray, np.arange(len(origins)), side="left")
        depth = order - begins[hits.ray]
        through, color_sum = np.ones(len(origins)), np.zeros((len(origins), 3))
        for layer in range(int(depth.max(initial=-1)) + 1):
            selected = np.flatnonzero(depth == layer)
            ray = hits.ray[selected]
            color_sum[ray] += (through[ray] * seen.alpha[selected])[:, None] * color[selected]
            through[ray] *= clear[selected]
        return color_sum + through[:, None] * total

    def _follow_mirrored(self, seen: Surfaces, kind: RayKind) -> Floats:
        """The light (k, 3) of their surroundings that surfaces mirror to where rays come from."""
        is_blurred = are_blurred(seen) & (kind.bounces == self._bounces)
        indices = np.repeat(np.arange(len(seen.position)), np.where(is_blurred, _MIRRORED_RAYS, 1))
        surfaces = take_surfaces(seen, indices)
        directions, share = mirror_rays(surfaces, self._rng)
        mirrors = np.flatnonzero(share.max(axis=1, initial=0.0) > 0.0)
        light = np.zeros(seen.position.shape)
        if len(mirrors):
            origins = _move_off(surfaces.position[mirrors], surfaces.geometric_normal[mirrors])
            mirrored = RayKind(kind.bounces - 1, brings_light=True, is_mirrored=True)
            arriving = self._follow_all(origins, directions[mirrors], 0.0, np.inf, mirrored) * share[mirrors]
            np.add.at(light, indices[mirrors], arriving)
        return light / np.where(is_blurred, _MIRRORED_RAYS, 1)[:, None]

    def _follow_bent(self, seen: Surfaces, is_leaving: NDArray[np.bool_], kind: RayKind) -> Floats:
        """The light (k, 3) from beyond the surfaces of transparent bodies, and what these mirror of it."""
        directions = -seen.to_eye
        bent, mirrored = bend_rays(directions, seen.normal, is_leaving, self._refraction_index)
        inwards = np.flatnonzero(mirrored < 1.0)
        light = np.zeros(seen.position.shape)
        if len(inwards):
            origins = _move_off(seen.position[inwards], -seen.geometric_normal[inwards])
            beyond = RayKind(kind.bounces - 1, brings_light=True, is_mirrored=kind.is_mirrored)
            weight = (1.0 - mirrored[inwards])[:, None]
            light[inwards] = weight * self._follow(origins, bent[inwards], 0.0, np.inf, beyond)
        across = np.einsum("ij,ij->i", directions, seen.normal)
        origins = _move_off(seen.position, seen.geometric_normal)
        back = RayKind(kind.bounces - 1, brings_light=True, is_mirrored=True)
        turned = directions - 2.0 * across[:, None] * seen.normal
        if len(turned):
            light += mirrored[:, None] * self._follow(origins, turned, 0.0, np.inf, back)
        return light

    def _pass_air(self, light: Floats, start: Floats, position: Floats, kind: RayKind) -> Floats:
        """The colours, or the light, of `light` from a position, seen from `start` through fog and haze."""
        color = self._pass_fog(light, start, position)
        color = color if kind.brings_light else tone_map(color)
        return self._pass_haze(color, np.linalg.norm(position - start, axis=1), kind)

    def _pass_fog(self, light: Floats, start: Floats, position: Floats) -> Floats:
        fog = self._scene.fog
        if fog is None:
            return light
        away = position - start
        thickness = optical_depth(fog, start[:, 1], away[:, 1], np.linalg.norm(away, axis=1))
        passes = np.exp(-thickness)[:, None]
        return light * passes + inverse_tone_map(np.asarray(fog.color)) * (1.0 - passes)

    def _pass_haze(self, color: Floats, length: Floats, kind: RayKind) -> Floats:
        passes = np.exp(-self._scene.haze * length)[:, None]
        air = np.asarray(self._scene.background, np.float64)
        return color * passes + (inverse_tone_map(air) if kind.brings_light else air) * (1.0 - passes)

    def _draw_background(self, origins: Floats, directions: Floats, kind: RayKind) -> Floats:
        """The background's colours, or light, seen through all of the fog."""
        environment = self._scene.environment
        if kind.is_mirrored or (environment is not None and environment.is_visible):
            light = self._lighting.look_at_surroundings(normalize(directions))
            light = self._pass_endless_fog(light, origins, directions)
            return light if kind.brings_light else tone_map(light)
        color = np.asarray(self._scene.background, np.float64)
        fog = self._scene.fog
        if fog is None:
            color = inverse_tone_map(color) if kind.brings_light else color
            return np.tile(color, (len(directions), 1))
        light = self._pass_endless_fog(
            np.broadcast_to(inverse_tone_map(color), directions.shape), origins, directions
        )
        return light if kind.brings_light else tone_map(light)

    def _pass_endless_fog(self, light: Floats, origins: Floats, directions: Floats) -> Floats:
        """The light (k, 3) that comes from infinitely far away through the fog."""
        fog = self._scene.fog
        if fog is None:
            return light
        rises = fog.falloff * directions[:, 1] / np.linalg.norm(directions, axis=1)
        here = fog.density * np.exp(np.minimum(-fog.falloff * (origins[:, 1] - fog.base), 60.0))
        with np.errstate(divide="ignore"):
            thickness = np.where(rises > 0.0, here / np.maximum(rises, 1e-300), np.inf)
        passes = np.exp(-thickness)[:, None]
        return np.asarray(light * passes + inverse_tone_map(np.asarray(fog.color)) * (1.0 - passes))


def _move_off(position: Floats, normal: Floats) -> Floats:
    """Positions a little off a surface, on the side of `normal`, so that rays from there don't meet it again."""
    return np.asarray(position + normal * measure_gap(position)[:, None])


def aim(
    camera: Camera, size: tuple[int, int], pixel_positions: Floats
) -> tuple[Floats, Floats, float, float]:
    """The origins and the directions (k, 3) of the rays through positions (k, 2) of an image, and the
    distances at which they begin and end. A direction advances 1 metre along the view."""
    projection: Any = camera.projection
    skew, projection = getattr(projection, "skew", 0.0), getattr(projection, "projection", projection)
    right, up, back = camera.rotation
    first, last = float(projection.near), float(projection.far)
    x = (pixel_positions[:, 0] / size[0] * 2.0 - 1.0)[:, None] * projection.aspect
    y = (1.0 - pixel_positions[:, 1] / size[1] * 2.0)[:, None]
    origins = np.broadcast_to(camera.position, (len(pixel_positions), 3))
    if hasattr(projection, "fov"):
        half = np.tan(0.5 * projection.fov)
        return origins, (x * half + skew) * right + y * half * up - back, first, last
    half = 0.5 * projection.height
    directions = np.zeros((len(pixel_positions), 3)) + skew * right - back
    return origins + x * half * right + y * half * up, directions, first, last


def tone_map(light: Floats) -> Floats:
    """Map light to colours from 0 to 1 by Narkowicz's curve (ACES Filmic Tone Mapping Curve, 2016)."""
    x = np.minimum(light * _EXPOSURE, 1e4)
    return np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)


def inverse_tone_map(color: Floats) -> Floats:
    """The light that is mapped to a colour from 0 to 1, found by bisection."""
    low, high = np.zeros(color.shape), np.full(color.shape, 1e4)
    for _ in range(200):
        median_of = 0.5 * (low + high)
        is_less = tone_map(median_of) < color
        low, high = np.where(is_less, median_of, low), np.where(is_less, high, median_of)
    return np.asarray(0.5 * (low + high))
