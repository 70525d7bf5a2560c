"""Shading: the light that surfaces send to the eye, and how fog dims it. All formulas are written again from
the documents that the renderer's own refer to, in another form where there is one."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lab.measure.ray_tracer.surfaces import (
    Geometry,
    Surfaces,
    dot,
    make_axes,
    measure_gap,
    normalize,
)
from renderer.lab.measure.ray_tracer.surroundings import Surroundings
from renderer.lab.measure.ray_tracer.triangle_tree import Floats, Hits, TriangleTree
from renderer.scene import Fog, Scene, ShadingModel

SMOOTHEST: Final = 0.1
"""The roughness below which the metallic-roughness model uses this value."""
_RINGS: Final = 24
"""Rings of directions to a sphere light, each with twice as many directions."""
_PARTS: Final = 32
"""Parts of a rectangle or a tube along each of its sides."""
_SHADOW_RINGS: Final = 12
"""Rings of rays to a source with a size, each with twice as many rays."""
_RAYS: Final = 1 << 13
"""Rays to sources that are traced together."""
_OCCLUSION_RAYS: Final = 512
"""Rays of ambient occlusion for each surface."""


class LitSurfaces:
    """The lights of a scene, and the shadows that its geometry casts."""

    def __init__(
        self,
        scene: Scene,
        geometry: Geometry,
        tree: TriangleTree,
        *,
        has_shadows: bool = True,
        has_penumbras: bool = False,
    ) -> None:
        self._scene, self._geometry, self._tree, self._has_shadows = scene, geometry, tree, has_shadows
        self._has_penumbras = has_penumbras
        environment = scene.environment
        self._environment = None if environment is None else Surroundings(environment)

    def light(self, surfaces: Surfaces, mirrored: Floats | None = None) -> Floats:
        """The light (k, 3) that surfaces send to the eye, before fog.

        Args:
            mirrored: what they mirror of their surroundings, (k, 3), if rays have found it.
        """
        color = self._reflect_surroundings(surfaces, mirrored) + surfaces.emitted
        lights = self._scene.lights.without_hidden()
        for sun in lights.directional:
            to_light = np.broadcast_to(-sun["direction"].astype(np.float64), surfaces.normal.shape)
            strength = np.full(len(to_light), float(sun["intensity"]))
            color += self._reflect(surfaces, to_light, strength, np.inf, sun)
        for local_light in (*lights.point, *lights.spot):
            color += self._reflect_local_light(surfaces, local_light)
        return color

    def _reflect_local_light(self, seen: Surfaces, local_light: Any) -> Floats:
        away = local_light["position"] - seen.position
        distance = np.linalg.norm(away, axis=1)
        reach = float(local_light["range"])
        to_light = normalize(away)
        window = np.clip(1.0 - (distance / max(reach, 1e-10)) ** 4, 0.0, 1.0)
        if "source_right" in local_light.dtype.names and local_light["source_right"].any():
            return self._reflect_area(seen, local_light, np.where(distance < reach, window**2, 0.0))
        strength = (
            float(local_light["intensity"])
            * window**2
            / np.maximum(distance, max(1e-12, local_light["source_radius"])) ** 2
        )
        if "outer" in local_light.dtype.names:
            chord = to_light + local_light["direction"].astype(np.float64)
            outer, inner = (2.0 * np.sin(0.5 * float(local_light[name])) ** 2 for name in ("outer", "inner"))
            share = (outer - 0.5 * (chord * chord).sum(1)) / max(outer - inner, 1e-14)
            strength *= np.clip(share, 0.0, 1.0) ** 2
        return self._reflect(seen, to_light, np.where(distance < reach, strength, 0.0), distance, local_light)

    def _reflect_area(self, seen: Surfaces, light: Any, strength: Floats) -> Floats:
        """The light of a rectangle or a tube that surfaces reflect: that of all its parts, dimmed by `strength` (k,).
        Its shadow is that of its middle, or of a sphere there."""
        color, lit = np.zeros(seen.normal.shape), np.flatnonzero(strength > 0.0)
        if len(lit) and light["casts_shadow"] and self._has_shadows:
            away = light["position"] - seen.position[lit]
            distance = np.linalg.norm(away, axis=1)
            sine = np.minimum(float(light["source_radius"]) / np.maximum(distance, 1e-9), 1.0)
            lit, strength = self._darken(seen, lit, strength, normalize(away), distance, sine)
        repeated = take_surfaces(seen, np.repeat(lit, _PARTS))
        for position, normal, share in _list_parts(light):
            away = np.tile(light["position"] + position, (len(lit), 1)) - repeated.position
            distance = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
            direction = away / distance[:, None]
            emitted = np.maximum(-dot(direction, np.tile(normal, (len(lit), 1))), 0.0) / distance**2
            facing = np.maximum(dot(repeated.normal, direction), 0.0)
            reflected = reflect(repeated, direction) * (share * emitted * facing)[:, None]
            color[lit] += reflected.reshape(len(lit), _PARTS, 3).sum(axis=1)
        arriving = light["color"].astype(np.float64) * float(light["intensity"])
        return np.asarray(color * arriving * strength[:, None])

    def _reflect(
        self, seen: Surfaces, to_light: Floats, strength: Floats, distance: Any, light: Any
    ) -> Floats:
        """The light of one light, in the direction `to_light` at a distance, that surfaces reflect. Without
        penumbras, shadows of a source are those of its centre."""
        radius = float(light["source_radius"]) if "source_radius" in light.dtype.names else 0.0
        sine = np.minimum(radius / np.broadcast_to(np.maximum(distance, 1e-9), strength.shape), 1.0)
        lit = np.flatnonzero((dot(seen.normal, to_light) > -sine) & (strength > 0.0))
        color = np.zeros(seen.normal.shape)
        if len(lit) and light["casts_shadow"] and self._has_shadows:
            far = np.broadcast_to(distance, strength.shape)[lit]
            source = sine[lit]
            if "angular_diameter" in light.dtype.names:
                source = np.full(len(lit), np.sin(0.5 * float(light["angular_diameter"])))
            lit, strength = self._darken(seen, lit, strength, to_light[lit], far, source)
        if len(lit):
            lit_surfaces = take_surfaces(seen, lit)
            arriving = light["color"].astype(np.float64) * strength[lit, None]
            for direction, share in _list_directions(to_light[lit], sine[lit]):
                facing = np.maximum(dot(lit_surfaces.normal, direction), 0.0)
                color[lit] += reflect(lit_surfaces, direction) * arriving * (share * facing)[:, None]
        return color

    def _darken(
        self,
        seen: Surfaces,
        lit: NDArray[np.int64],
        strength: Floats,
        to_light: Floats,
        distance: Floats,
        sine: Floats,
    ) -> tuple[NDArray[np.int64], Floats]:
        """Those of the surfaces at the indices `lit` that light of a source arrives at, and the strengths of all
        surfaces, dimmed by what blocks it. Other arguments are those of `_measure_visibility`."""
        shares = self._measure_visibility(take_surfaces(seen, lit), to_light, distance, sine)
        arrives = shares > 0.0
        lit, strength = lit[arrives], strength.copy()
        strength[lit] *= shares[arrives]
        return lit, strength

    def _measure_visibility(self, seen: Surfaces, to_light: Floats, distance: Floats, sine: Floats) -> Floats:
        """The share (k,) of the light of sources that nothing blocks, by the cosine to the surface.

        Args:
            to_light, distance: to the middles of the sources, (k, 3) and (k,).
            sine: (k,) of half the angles that sources fill.
        """
        if not self._has_penumbras or not sine.any():
            is_dark = self._are_dark(seen.position, seen.geometric_normal, to_light, distance)
            return np.where(is_dark, 0.0, 1.0)
        directions = [direction for direction, _ in _list_directions(to_light, sine, _SHADOW_RINGS)]
        arriving, all_light = np.zeros(len(sine)), np.zeros(len(sine))
        together = max(_RAYS // len(sine), 1)
        for begin in range(0, len(directions), together):
            rays = np.stack(directions[begin : begin + together])
            origins, normals = (
                np.broadcast_to(array, rays.shape).reshape(-1, 3)
                for array in (seen.position, seen.geometric_normal)
            )
            far = np.broadcast_to(distance, rays.shape[:2]).reshape(-1)
            is_dark = self._are_dark(origins, normals, rays.reshape(-1, 3), far).reshape(rays.shape[:2])
            light = np.maximum((rays * seen.normal).sum(axis=2), 0.0)  # all rays are of equal weight
            all_light += light.sum(axis=0)
            arriving += np.where(is_dark, 0.0, light).sum(axis=0)
        return np.asarray(arriving / np.maximum(all_light, 1e-300))

    def _are_dark(
        self, position: Floats, geometric_normal: Floats, to_light: Floats, distance: Floats
    ) -> NDArray[np.bool_]:
        start = measure_gap(position)
        origins = position + geometric_normal * start[:, None]
        return self._tree.are_occluded(
            origins, to_light, distance - start, lambda hits: self._geometry.block_light(hits, to_light)
        )

    def look_at_surroundings(self, directions: Floats) -> Floats:
        """The light (k, 3) that comes from infinitely far away in unit directions (k, 3)."""
        if self._environment is not None:
            return self._environment.look(directions)
        lights = self._scene.lights.without_hidden()
        sky, ground = (np.asarray(color, np.float64) for color in (lights.sky, lights.ground))
        height = 0.5 * (directions[:, 1:2] + 1.0)
        return np.asarray(sky * height + ground * (1.0 - height))

    def _reflect_surroundings(self, seen: Surfaces, mirrored_light: Floats | None) -> Floats:
        """The reflected light of the sky and the ground, diffuse and specular."""
        is_baked = ~np.isnan(seen.irradiance)

        def arrive(direction: Floats) -> Floats:
            return np.where(is_baked, seen.irradiance, self.look_at_surroundings(direction))

        if mirrored_light is not None:
            left = (seen.occlusion * self._measure_openness(seen))[:, None]
            return np.asarray(self._scatter_surroundings(seen) * left + mirrored_light)
        if self._environment is not None:
            return self._reflect_environment(seen, self._environment)
        material, along = seen.material, dot(seen.normal, seen.to_eye)
        beyond = 2.0 * along[:, None] * seen.normal - seen.to_eye
        is_metal, diffuse, mirror, rough = select_shading_model(seen)
        clipped = np.clip(along, 0.0, 1.0)
        rim = material["rim_strength"] * (1.0 - clipped) ** material["rim_power"].astype(np.float64)
        mirrored = material["specular_color"] + rim[:, None]
        # Karis's fit of the metallic-roughness model over all directions (Physically Based Shading on Mobile,
        # 2014).
        share = (
            np.minimum((1.0 - rough) ** 2, 2.0 ** (-9.28 * clipped)) * (1.0 - rough) + 0.0425 - 0.0275 * rough
        )
        scale = -1.04 * share + 1.04 - 0.572 * rough
        offset = 1.04 * share + 0.022 * rough - 0.04
        mirrored = np.where(is_metal[:, None], mirror * scale[:, None] + offset[:, None], mirrored)
        blunt = np.where(is_metal, rough**2, 0.0)[:, None]
        beyond = beyond * (1.0 - blunt) + seen.normal * blunt
        left = (seen.occlusion * self._measure_openness(seen))[:, None]
        return np.asarray((diffuse * arrive(seen.normal) + mirrored * arrive(beyond)) * left)

    def _scatter_surroundings(self, seen: Surfaces) -> Floats:
        """The light of the sky and the ground, or of an environment, that surfaces scatter."""
        if self._environment is not None:
            arriving = self._environment.scatter(seen.normal)
        else:
            arriving = self.look_at_surroundings(seen.normal)
        diffuse = select_shading_model(seen)[1]
        return np.asarray(diffuse * np.where(np.isnan(seen.irradiance), arriving, seen.irradiance))

    def _reflect_environment(self, seen: Surfaces, environment: Surroundings) -> Floats:
        """The light of an environment that surfaces reflect. The specular model mirrors a lobe of GGX as wide as
        its highlight, seen along the mirrored direction."""
        is_metal, _, _, rough = select_shading_model(seen)
        light = self._scatter_surroundings(seen)
        material, along = seen.material, dot(seen.normal, seen.to_eye)
        if is_metal.any():
            metals = take_surfaces(seen, np.flatnonzero(is_metal))

            def respond(part: slice, directions: Floats, half: Floats) -> Floats:
                count = directions.shape[1]
                repeated = np.repeat(np.arange(len(metals.normal))[part], count)
                surfaces = take_surfaces(metals, repeated)
                mirrored = reflect(surfaces, directions.reshape(-1, 3), is_mirror=True)
                return mirrored.reshape(directions.shape)

            light[is_metal] += environment.mirror(metals.normal, metals.to_eye, rough[is_metal], respond)
        others = np.flatnonzero(~is_metal)
        if len(others):
            shininess = material["shininess"][others].astype(np.float64)
            rim = material["rim_strength"] * (1.0 - np.clip(along, 0.0, 1.0)) ** material["rim_power"]
            mirrored = (material["specular_color"] + rim[:, None])[others]
            beyond = (2.0 * along[:, None] * seen.normal - seen.to_eye)[others]
            light[others] += mirrored * environment.gather(beyond, np.sqrt(2.0 / (shininess + 2.0)))
        return np.asarray(light * (seen.occlusion * self._measure_openness(seen))[:, None])

    def _measure_openness(self, seen: Surfaces) -> Floats:
        """The share (k,) of ambient light that other surfaces leave, by the scene's `AmbientOcclusion`; all of that
        in light maps, which have what is hidden.

        Of all rays within the hemisphere, spread by the cosine to the geometric normal, the share is counted
        that are as long as their lengths without a hit. The lengths' squares are spread evenly from 0 to that
        of the radius: so a surface at the distance d is hit by a share of 1 - (d / radius)².
        """
        ambient_occlusion, normal = self._scene.ambient_occlusion, seen.geometric_normal
        if ambient_occlusion is None:
            return np.ones(len(normal))
        is_baked = ~np.isnan(seen.irradiance[:, 0])
        aside, up = make_axes(normal)
        origins = seen.position + normal * measure_gap(seen.position)[:, None]
        open_rays = np.zeros(len(normal))
        for number in range(_OCCLUSION_RAYS):
            sine = np.sqrt((number + 0.5) / _OCCLUSION_RAYS)
            angle = 2.0 * np.pi * _reverse_digits(number, 2)
            around = aside * np.cos(angle) + up * np.sin(angle)
            direction = around * sine + normal * np.sqrt(1.0 - sine * sine)
            length = ambient_occlusion.radius * np.sqrt(_reverse_digits(number, 3))
            open_rays += ~self._tree.are_occluded(
                origins, direction, np.full(len(normal), length), partial(self._take_light, direction)
            )
        return np.where(is_baked, 1.0, open_rays / _OCCLUSION_RAYS)

    def _take_light(self, directions: Floats, hits: Hits) -> NDArray[np.bool_]:
        """The hits of opaque surfaces that rays see."""
        is_glass = self._geometry.is_glass[self._geometry.objects[hits.triangle]]
        return np.asarray(self._geometry.are_visible(hits, directions) & ~is_glass)


def _reverse_digits(number: int, base: int) -> float:
    """Return 0.abc for the digits cba of a number, and half of the last digit more: Hammersley's points."""
    value, weight = 0.0, 1.0
    while number:
        weight /= base
        number, digit = divmod(number, base)
        value += digit * weight
    return value + 0.5 / _OCCLUSION_RAYS


def _list_directions(to_light: Floats, sine: Floats, rings: int = _RINGS) -> Iterator[tuple[Floats, Any]]:
    """Yield directions (k, 3) that stand for equal solid angles of spheres with centres in the directions
    `to_light`, and the weights of their light: a part of the sphere's radiance, which is 1 / (π sine²) of a
    point light's."""
    if not sine.any():
        yield to_light, 1.0
        return
    cosine = np.sqrt(1.0 - sine**2)
    aside, up = make_axes(to_light)
    for i, turn in np.ndindex(rings, 2 * rings):
        along = (1.0 - (1.0 - cosine) * (i + 0.5) / rings)[:, None]
        angle = np.pi * (turn + 0.5) / rings
        around = aside * np.cos(angle) + up * np.sin(angle)
        yield to_light * along + around * np.sqrt(1.0 - along**2), 1.0 / (1.0 + cosine) / rings**2


def _list_parts(light: Any) -> Iterator[tuple[Floats, Floats, float]]:
    """Yield rows of parts of a rectangle or a tube, of equal area: positions (n, 3) from its middle, unit normals (n,
    3), and the share of the light of each part that a surface in front of the source would get, seen from afar."""
    right, up = (light[name].astype(np.float64) for name in ("source_right", "source_up"))
    steps = (2.0 * np.arange(_PARTS) + 1.0) / _PARTS - 1.0
    if up.any():
        normal = np.cross(right / np.linalg.norm(right), up / np.linalg.norm(up))
        for y in steps:
            yield steps[:, None] * right + y * up, np.tile(normal, (_PARTS, 1)), 1.0 / _PARTS**2
        return
    axis = right / np.linalg.norm(right)
    first, second = make_axes(axis[None])
    angles = np.pi * steps[:, None]
    normals = np.cos(angles) * first + np.sin(angles) * second
    for x in steps:
        yield x * right + float(light["source_radius"]) * normals, normals, np.pi / _PARTS**2


def reflect(surfaces: Surfaces, to_light: Floats, *, is_mirror: bool = False) -> Floats:
    """The fraction (k, 3) of a light's illuminance that surfaces send to the eye: Blinn and Phong's model
    with an energy-conserving highlight, or that of glTF 2.0, appendix B. With `is_mirror` it is what surfaces of
    the latter mirror."""
    half = normalize(to_light + surfaces.to_eye)
    towards = dot(surfaces.normal, half)
    is_metal, _, mirror, rough = select_shading_model(surfaces)
    shininess = surfaces.material["shininess"].astype(np.float64)
    with np.errstate(under="ignore"):
        lobe = np.clip(towards, 0.0, 1.0) ** shininess * (shininess + 8.0) / 8.0
    specular = surfaces.base + surfaces.material["specular_color"] * lobe[:, None]
    # D, V and F of glTF; (n·h)² (α² - 1) + 1 is the same as sin² + α² cos² of the angle between n and h.
    square = rough**4
    sine = np.linalg.norm(np.cross(surfaces.normal, half), axis=1)
    spread = square / np.maximum(sine**2 + square * towards**2, square) ** 2
    lit, viewed = (
        np.clip(dot(surfaces.normal, to_light), 0.0, 1.0),
        np.abs(dot(surfaces.normal, surfaces.to_eye)),
    )
    masks = [cosine + np.sqrt(square + (1.0 - square) * cosine**2) for cosine in (lit, viewed)]
    fresnel = mirror + (1.0 - mirror) * ((1.0 - np.clip(dot(surfaces.to_eye, half), 0.0, 1.0)) ** 5)[:, None]
    if is_mirror:
        return np.asarray(fresnel * (spread / (masks[0] * masks[1]))[:, None])
    scattered = surfaces.base * (1.0 - surfaces.metallic)[:, None] * (1.0 - fresnel)
    metal = scattered + fresnel * (spread / (masks[0] * masks[1]))[:, None]
    return np.where(is_metal[:, None], metal, specular)


def select_shading_model(seen: Surfaces) -> tuple[NDArray[np.bool_], Floats, Floats, Floats]:
    """The mask of surfaces with the metallic-roughness model, the diffuse colour of all, and the specular colour at
    normal incidence and the roughness of those of that model."""
    is_metal = np.asarray(seen.material["model"] == ShadingModel.METALLIC_ROUGHNESS)
    mirror = 0.04 + seen.metallic[:, None] * (seen.base - 0.04)
    diffuse = np.where(
        is_metal[:, None], seen.base * (1.0 - seen.metallic)[:, None] * (1.0 - mirror), seen.base
    )
    return is_metal, diffuse, mirror, np.maximum(seen.roughness, SMOOTHEST)


def optical_depth(fog: Fog, eye: Floats, height: Floats, length: Floats) -> Floats:
    """The integral of a fog's density along rays (k,) from the heights `eye` that rise by `height` on their
    `length`, which may be infinite."""
    thins = fog.falloff * height
    # Seen from the end at which the air is denser: from the other one, 0 may be multiplied by infinity.
    exponent = np.minimum(-fog.falloff * (eye - fog.base), 60.0) + np.maximum(-thins, 0.0)
    densest = fog.density * np.exp(np.minimum(exponent, 700.0))
    thins = np.abs(thins)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = np.where(thins < 1e-12, 1.0, -np.expm1(-thins) / thins)
        return np.asarray(densest * length * share)


def take_surfaces(seen: Surfaces, rows: NDArray[Any]) -> Surfaces:
    """The surfaces at some indices."""
    return Surfaces(*(getattr(seen, name)[rows] for name in seen.__slots__))
