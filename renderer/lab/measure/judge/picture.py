"""Pictures: rays through pixels, surfaces in the order in which a ray meets them, tones and sRGB."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from renderer.lab.measure.judge.light import LitSurfaces, find_thickness
from renderer.lab.measure.judge.rays import Floats, Hits, TriangleTree
from renderer.lab.measure.judge.surfaces import Geometry, encode_srgb
from renderer.scene import Camera, Scene

_CHUNK: Final = 1 << 15
"""Rays that are followed together."""
_SHELLS: Final = 4.0 ** np.arange(-5, 1)
"""Distances to which rays are followed before those that met nothing go on, in the size of the scene."""
_EXPOSURE: Final = 0.6


class Judge:
    """Draws a scene as it stands, in float64; see the package.

    Attributes:
        has_shadows: whether lights that cast shadows do.
    """

    def __init__(self, scene: Scene, *, has_shadows: bool = True) -> None:
        """Raises ValueError for a scene with glow, or with shaders of materials."""
        if scene.glow is not None:
            raise ValueError("what glows can't be judged by single rays")
        if scene.shaders:
            raise ValueError("what materials' own shaders say isn't known here")
        self._scene, self._geometry = scene, Geometry(scene)
        self._tree = TriangleTree(self._geometry.corners)
        self._lighting = LitSurfaces(scene, self._geometry, self._tree, has_shadows=has_shadows)

    def draw(
        self, camera: Camera, size: tuple[int, int], rays: int = 1, every: int = 1,
        at: tuple[float, float] = (0.5, 0.5),
    ) -> Floats:  # fmt: skip
        """Return a picture (h, w, 3) in levels of 255, not rounded.

        Args:
            camera: a perspective or a parallel one, or an eye's.
            size: width and height.
            rays: along each side of a pixel: one, or so many squared, each at random in its part.
            every: of how many pixels along each axis one is looked at; the others are NaN.
            at: where in a pixel a single ray is, from its top left corner.
        """
        width, height = size
        x, y = (some.reshape(-1) for some in np.meshgrid(*(np.arange(side)[every // 2 :: every] for side in size)))
        places = np.stack([x, y], axis=1)
        light = np.zeros((len(places), 3))
        rng = np.random.default_rng(0)
        for row in range(rays):
            for column in range(rays):
                part = rng.uniform(size=places.shape) if rays > 1 else at
                light += self.see(camera, size, places + (np.array([column, row]) + part) / rays)
        picture = np.full((height, width, 3), np.nan)
        picture[y, x] = 255.0 * encode_srgb(light / rays**2)
        return picture

    def see(self, camera: Camera, size: tuple[int, int], places: Floats) -> Floats:
        """Return the linear colours (k, 3) from 0 to 1 that are seen at places (k, 2) of an image, in pixels from its
        top left corner."""
        origins, directions, first, last = aim(camera, size, places)
        colors = np.zeros((len(places), 3))
        for begin in range(0, len(places), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            colors[part] = self._follow(camera, origins[part], directions[part], first, last)
        return colors

    def _find_surfaces(self, origins: Floats, directions: Floats, first: float, last: float) -> Hits:
        """Return all that is seen along rays, the nearest first: glass, and at the end what isn't glass."""
        corners = self._geometry.corners.reshape(-1, 3)
        size = np.linalg.norm(np.ptp(corners, axis=0)) / np.linalg.norm(directions, axis=1).min()
        farthest = float(np.abs(corners - origins[:1]).max()) * 2.0 + size
        open_rays, found = np.arange(len(origins)), []
        begin = first
        for end in (*(first + size * _SHELLS), first + farthest + size):
            if end <= begin or not len(open_rays):
                continue
            far = np.full(len(origins), min(end, last))
            hits = self._tree.meet(origins[open_rays], directions[open_rays], np.full(len(origins), begin), far)
            hits = Hits(open_rays[hits.ray], hits.triangle, hits.distance, hits.second, hits.third)
            hits = hits.take(self._geometry.are_seen(hits, directions))
            hits = hits.take(np.lexsort([hits.distance, hits.ray]))
            is_solid = ~self._geometry.is_glass[self._geometry.objects[hits.triangle]]
            stop = np.full(len(origins), np.inf)
            np.minimum.at(stop, hits.ray[is_solid], hits.distance[is_solid])
            found.append(hits.take(hits.distance <= stop[hits.ray]))
            open_rays, begin = open_rays[np.isinf(stop[open_rays])], min(end, last)
        hits = Hits(*(np.concatenate([getattr(one, name) for one in found]) for name in Hits.__slots__))
        hits = hits.take(np.lexsort([hits.distance, hits.ray]))
        return hits.take(~self._are_repeated(hits))

    def _are_repeated(self, hits: Hits) -> Any:
        """Return which hits are those before them, on an edge that two triangles of an object share."""
        objects = self._geometry.objects[hits.triangle]
        again = (hits.ray[1:] == hits.ray[:-1]) & (objects[1:] == objects[:-1])
        again &= hits.distance[1:] - hits.distance[:-1] <= 1e-9 * np.abs(hits.distance[1:])
        return np.concatenate([[False], again])[: len(hits.ray)]

    def _follow(self, camera: Camera, origins: Floats, directions: Floats, first: float, last: float) -> Floats:
        hits = self._find_surfaces(origins, directions, first, last)
        seen = self._geometry.see(hits, origins, directions)
        color = map_tones(self._pass_fog(camera, self._lighting.light(seen), seen.position))
        color = self._pass_haze(color, np.linalg.norm(seen.position - camera.position, axis=1))
        # Glass lets through what it doesn't cover: each surface is seen through all before it of the same ray.
        clear = 1.0 - seen.alpha
        total = self._draw_background(camera, directions)
        order = np.arange(len(hits.ray))
        begins = np.searchsorted(hits.ray, np.arange(len(origins)), side="left")
        depth = order - begins[hits.ray]
        through, picture = np.ones(len(origins)), np.zeros((len(origins), 3))
        for layer in range(int(depth.max(initial=-1)) + 1):
            some = np.flatnonzero(depth == layer)
            ray = hits.ray[some]
            picture[ray] += (through[ray] * seen.alpha[some])[:, None] * color[some]
            through[ray] *= clear[some]
        return picture + through[:, None] * total

    def _pass_fog(self, camera: Camera, light: Floats, position: Floats) -> Floats:
        fog = self._scene.fog
        if fog is None:
            return light
        away = position - camera.position
        thickness = find_thickness(fog, camera.position[1], away[:, 1], np.linalg.norm(away, axis=1))
        passes = np.exp(-thickness)[:, None]
        return light * passes + unmap_tones(np.asarray(fog.color)) * (1.0 - passes)

    def _pass_haze(self, color: Floats, length: Floats) -> Floats:
        passes = np.exp(-self._scene.haze * length)[:, None]
        return color * passes + np.asarray(self._scene.background) * (1.0 - passes)

    def _draw_background(self, camera: Camera, directions: Floats) -> Floats:
        """Return the background's colours, through all of the fog."""
        background = np.broadcast_to(np.asarray(self._scene.background, np.float64), directions.shape)
        fog = self._scene.fog
        if fog is None:
            return background
        rises = fog.falloff * directions[:, 1] / np.linalg.norm(directions, axis=1)
        here = fog.density * np.exp(np.minimum(-fog.falloff * (camera.position[1] - fog.base), 60.0))
        with np.errstate(divide="ignore"):
            thickness = np.where(rises > 0.0, here / np.maximum(rises, 1e-300), np.inf)
        passes = np.exp(-thickness)[:, None]
        light = unmap_tones(background) * passes + unmap_tones(np.asarray(fog.color)) * (1.0 - passes)
        return map_tones(light)


def aim(camera: Camera, size: tuple[int, int], places: Floats) -> tuple[Floats, Floats, float, float]:
    """Return the origins and the directions (k, 3) of the rays through places (k, 2) of an image, and the distances at
    which they begin and end. A direction is as long as what it leads ahead is 1 metre."""
    lens: Any = camera.projection
    skew, lens = getattr(lens, "skew", 0.0), getattr(lens, "lens", lens)
    right, up, back = camera.rotation
    x = (places[:, 0] / size[0] * 2.0 - 1.0)[:, None] * lens.aspect
    y = (1.0 - places[:, 1] / size[1] * 2.0)[:, None]
    origins = np.broadcast_to(camera.position, (len(places), 3))
    if hasattr(lens, "fov"):
        half = np.tan(0.5 * lens.fov)
        return origins, (x * half + skew) * right + y * half * up - back, lens.near, lens.far
    half = 0.5 * lens.height
    return origins + x * half * right + y * half * up, np.zeros((len(places), 3)) + skew * right - back, lens.near, \
        lens.far  # fmt: skip


def map_tones(light: Floats) -> Floats:
    """Return light as colours from 0 to 1, by Narkowicz's curve (ACES Filmic Tone Mapping Curve, 2016)."""
    x = np.minimum(light * _EXPOSURE, 1e4)
    return np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)


def unmap_tones(color: Floats) -> Floats:
    """Return the light that looks like a colour from 0 to 1, by halving."""
    low, high = np.zeros(color.shape), np.full(color.shape, 1e4)
    for _ in range(200):
        middle = 0.5 * (low + high)
        is_less = map_tones(middle) < color
        low, high = np.where(is_less, middle, low), np.where(is_less, high, middle)
    return np.asarray(0.5 * (low + high))
