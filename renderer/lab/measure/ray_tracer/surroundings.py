"""The light of an environment, integrated in float64: over the texels of its image, and by the lobe of the shading
model, each direction weighted by how densely both cover it (the balance heuristic; Veach 1997, 9.2.2)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from renderer.lab.measure.ray_tracer.surfaces import make_axes, normalize
from renderer.lab.measure.ray_tracer.triangle_tree import Floats
from renderer.scene import Environment

_LOBE_POINTS: Final = 256
"""Directions of a lobe besides those of the image's texels."""
_TOGETHER: Final = 1 << 21
"""Pairs of a surface and a direction that are evaluated together."""


class Surroundings:
    """An environment, as rays see it."""

    def __init__(self, environment: Environment) -> None:
        height, width = environment.image.shape[:2]
        self._texels = environment.image.astype(np.float64) * environment.intensity
        polar = np.pi * (np.arange(height) + 0.5) / height
        around = 2.0 * np.pi * ((np.arange(width) + 0.5) / width - 0.5) + environment.turn * -1.0
        polar, around = (angles.reshape(-1) for angles in np.meshgrid(polar, around, indexing="ij"))
        ring = np.sin(polar)
        self._directions = np.stack([ring * np.sin(around), np.cos(polar), -ring * np.cos(around)], axis=1)
        self._angles = np.pi / height * 2.0 * np.pi / width * np.maximum(ring, 1e-12)
        self._turn = environment.turn

    def look(self, directions: Floats) -> Floats:
        """The light (k, 3) from directions (k, 3) of any length, between texels their weighted mean."""
        x, y, z = normalize(directions).T
        height, width = self._texels.shape[:2]
        column = ((np.arctan2(x, -z) + self._turn) / (2.0 * np.pi) + 0.5) * width - 0.5
        row = np.arccos(np.clip(y, -1.0, 1.0)) / np.pi * height - 0.5
        left, above = np.floor(column).astype(np.int64), np.floor(row).astype(np.int64)
        light = np.zeros((len(x), 3))
        for i in (0, 1):
            for j in (0, 1):
                weight = np.abs(1 - i - (row - above)) * np.abs(1 - j - (column - left))
                texels = self._texels[np.clip(above + i, 0, height - 1), (left + j) % width]
                light += weight[:, None] * texels
        return light

    def scatter(self, normals: Floats) -> Floats:
        """The light (k, 3) that white surfaces scatter."""
        light = self._texels.reshape(-1, 3) * (self._angles / np.pi)[:, None]
        parts = np.array_split(normals, max(len(normals) * len(light) // _TOGETHER, 1))
        return np.concatenate([np.maximum(part @ self._directions.T, 0.0) @ light for part in parts])

    def gather(self, directions: Floats, alpha: Floats) -> Floats:
        """The mean light (k, 3) in lobes of GGX around unit directions (k, 3), which are those of the normal and
        the eye, too."""
        light, means = self._texels.reshape(-1, 3), []
        parts = max(len(directions) * len(light) // _TOGETHER, 1)
        for axes, part in zip(np.array_split(directions, parts), np.array_split(alpha, parts), strict=True):
            lit = axes @ self._directions.T
            square = (part**2)[:, None]
            weight = np.maximum(lit, 0.0) / (0.5 - 0.5 * lit + square * (0.5 + 0.5 * lit)) ** 2 * self._angles
            means.append(weight @ light / weight.sum(axis=1, keepdims=True))
        return np.concatenate(means)

    def mirror(
        self,
        normals: Floats,
        to_eye: Floats,
        rough: Floats,
        respond: Callable[[slice, Floats, Floats], Floats],
    ) -> Floats:
        """The light (k, 3) that surfaces mirror.

        Args:
            normals, to_eye: unit vectors (k, 3).
            rough: (k,) of GGX.
            respond: for a range of surfaces (j,), unit directions (j, n, 3) and their unit half vectors, how
                much light the surfaces mirror from there, (j, n, 3), without n·l.
        """
        count = len(self._directions)
        step = max(_TOGETHER // count, 1)
        result = np.zeros(normals.shape)
        for begin in range(0, len(normals), step):
            part = slice(begin, begin + step)
            normal, eye, square = normals[part], to_eye[part], rough[part, None] ** 4
            texels = np.broadcast_to(self._directions, (len(normal), count, 3))
            lobe = _spread_by_lobe(normal, eye, square)
            for directions, density in ((texels, 1.0 / self._angles[None, :]), (lobe, None)):
                half = normalize((directions + eye[:, None]).reshape(-1, 3)).reshape(directions.shape)
                towards = np.einsum("jnc,jc->jn", half, normal)
                viewed = np.abs(np.einsum("jnc,jc->jn", half, eye))
                sine = 1.0 - towards**2
                spread = square / (np.pi * np.maximum(sine + square * towards**2, square) ** 2)
                lobe_density = _LOBE_POINTS * spread * np.abs(towards) / np.maximum(4.0 * viewed, 1e-9)
                if density is None:
                    light = self.look(directions.reshape(-1, 3)).reshape(directions.shape)
                    texel_density = self._density_at(directions)
                else:
                    light = np.broadcast_to(self._texels.reshape(-1, 3), directions.shape)
                    texel_density = density
                lit = np.maximum(np.einsum("jnc,jc->jn", directions, normal), 0.0)
                weight = lit / (texel_density + lobe_density) * (towards > 0.0)
                result[part] += (respond(part, directions, half) * light * weight[..., None]).sum(axis=1)
        return result / np.pi

    def _density_at(self, directions: Floats) -> Floats:
        """The texels per solid angle (j, n) in directions."""
        height, width = self._texels.shape[:2]
        ring = np.sqrt(np.maximum(1.0 - directions[..., 1] ** 2, 1e-12))
        return np.asarray(height * width / (2.0 * np.pi**2) / ring)


def _spread_by_lobe(normal: Floats, eye: Floats, square: Floats) -> Floats:
    """Directions (j, n, 3) that the half vectors of GGX mirror the eye to."""
    number = np.arange(_LOBE_POINTS)
    share, angle = (number + 0.5) / _LOBE_POINTS, np.pi * (3.0 - np.sqrt(5.0)) * number
    cosine = np.sqrt((1.0 - share) / (1.0 + (square - 1.0) * share))
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    aside, up = make_axes(normal)
    across = aside[:, None] * np.cos(angle)[:, None] + up[:, None] * np.sin(angle)[:, None]
    half = across * sine[..., None] + normal[:, None] * cosine[..., None]
    return np.asarray(2.0 * np.einsum("jnc,jc->jn", half, eye)[..., None] * half - eye[:, None])
