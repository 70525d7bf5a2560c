"""Where rays go on: mirrored by surfaces, or bent by what is transparent (Whitted 1980).

- The metallic-roughness model mirrors a ray about a half vector that is spread as GGX is, so that many rays of a pixel
  give its blurred image (Walter et al. 2007, section 5). The specular model mirrors it about the normal, and spreads it
  as GGX would that is as wide as its highlight, seen along the mirrored direction.
- A transparent body bends rays by Snell's law, and mirrors the share that Fresnel's equations say: all of it where no
  direction inside is steep enough.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.lab.measure.ray_tracer.shading import SMOOTHEST, select_shading_model
from renderer.lab.measure.ray_tracer.surfaces import Surfaces, dot, make_axes, normalize
from renderer.lab.measure.ray_tracer.triangle_tree import Floats

_COSINE_STEPS: Final = 64


def are_blurred(surfaces: Surfaces) -> NDArray[np.bool_]:
    """Return which surfaces mirror a ray to random directions (k,)."""
    return np.asarray(_lobe_widths(surfaces) > SMOOTHEST**4)


def mirror_rays(surfaces: Surfaces, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Mirror a ray from the eye at each surface.

    Args:
        rng: chooses a half vector for each surface.

    Returns:
        unit directions (k, 3), and the share (k, 3) of the light from there that goes to the eye. It is 0 where the
        direction leads into the surface.
    """
    normal, to_eye, material = surfaces.normal, surfaces.to_eye, surfaces.material
    is_metal, _, base, _ = select_shading_model(surfaces)
    square, across = _lobe_widths(surfaces), dot(normal, to_eye)
    mirrored = 2.0 * across[:, None] * normal - to_eye
    half = _spread_half_vectors(np.where(is_metal[:, None], normal, mirrored), square, rng)
    seen_from = np.where(is_metal[:, None], to_eye, mirrored)
    viewed = dot(seen_from, half)
    direction = 2.0 * viewed[:, None] * half - seen_from
    lit = dot(normal, direction)
    # The share is F V 4 (v·h) (n·l) / (n·h): the model divided by how densely such directions lie.
    masks = [
        cosine + np.sqrt(square + (1.0 - square) * cosine**2)
        for cosine in (np.maximum(lit, 0.0), np.abs(across))
    ]
    towards = np.maximum(dot(normal, half), 1e-9)
    weight = 4.0 * np.maximum(viewed, 0.0) * lit / (towards * np.maximum(masks[0] * masks[1], 1e-12))
    fresnel = base + (1.0 - base) * ((1.0 - np.clip(viewed, 0.0, 1.0)) ** 5)[:, None]
    rim = material["rim_strength"] * (1.0 - np.clip(np.abs(across), 0.0, 1.0)) ** material[
        "rim_power"
    ].astype(float)
    specular = (material["specular_color"] + rim[:, None]) * (
        np.maximum(dot(mirrored, direction), 0.0) / _mean_cosines(square)
    )[:, None]
    share = np.where(is_metal[:, None], fresnel * weight[:, None], specular)
    leaves = (dot(surfaces.geometric_normal, direction) > 0.0) & (~is_metal | (lit > 0.0))
    return direction, np.where(leaves[:, None], share, 0.0)


def bend_rays(
    directions: Floats, normals: Floats, is_leaving: NDArray[np.bool_], refraction_index: float
) -> tuple[Floats, Floats]:
    """Bend rays at the surfaces of transparent bodies.

    Args:
        directions: unit directions (k, 3).
        normals: unit normals (k, 3) on the side that rays come from.
        is_leaving: (k,) the rays that come from inside.
        refraction_index: of the bodies, relative to what is around them.

    Returns:
        unit directions (k, 3), and the share (k,) of light that is mirrored instead: 1, and any direction, where
        nothing leaves the body.
    """
    ratio = np.where(is_leaving, refraction_index, 1.0 / refraction_index)
    cosine = -dot(directions, normals)
    square = 1.0 - ratio**2 * (1.0 - cosine**2)  # of the cosine on the other side
    beyond = np.sqrt(np.maximum(square, 0.0))
    bent = ratio[:, None] * directions + (ratio * cosine - beyond)[:, None] * normals
    with np.errstate(invalid="ignore", divide="ignore"):
        parallel = (cosine - ratio * beyond) / (cosine + ratio * beyond)
        perpendicular = (ratio * cosine - beyond) / (ratio * cosine + beyond)
    mirrored = 0.5 * (parallel**2 + perpendicular**2)
    return normalize(bent), np.where(square > 0.0, mirrored, 1.0)


def _lobe_widths(surfaces: Surfaces) -> Floats:
    """The squares (k,) of GGX's α."""
    is_metal, _, _, roughness = select_shading_model(surfaces)
    shininess = surfaces.material["shininess"].astype(np.float64)
    return np.where(is_metal, roughness**4, 2.0 / (shininess + 2.0))


def _mean_cosines(square: Floats) -> Floats:
    """The mean (k,) of the cosines, at least 0, between the axis of a lobe of GGX and the directions in it."""
    share = (np.arange(_COSINE_STEPS) + 0.5)[:, None] / _COSINE_STEPS
    squared_cosine = (1.0 - share) / (1.0 + (square - 1.0) * share)
    return np.asarray(np.maximum(2.0 * squared_cosine - 1.0, 0.0).mean(axis=0))


def _spread_half_vectors(normal: Floats, square: Floats, rng: np.random.Generator) -> Floats:
    """Half vectors (k, 3), spread as densely as GGX of α² = `square` (k,) times the cosine to the normal."""
    share, angle = rng.uniform(size=len(normal)), 2.0 * np.pi * rng.uniform(size=len(normal))
    cosine = np.sqrt((1.0 - share) / (1.0 + (square - 1.0) * share))
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    aside, up = make_axes(normal)
    across = aside * (sine * np.cos(angle))[:, None] + up * (sine * np.sin(angle))[:, None]
    return np.asarray(across + normal * cosine[:, None])
