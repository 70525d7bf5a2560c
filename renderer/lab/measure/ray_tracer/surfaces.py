"""Surfaces: the triangles of a scene in the world, and their properties where a ray meets them.

Vertices are moved and their normals turned by the objects' transforms here, in float64. A normal is turned by
the matrix of cofactors with the sign of the determinant: the front of a triangle stays its front when it is
mirrored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lab.measure.ray_tracer.triangle_tree import Floats, Hits, Indices
from renderer.scene import AlphaMode, ImagePixels, Scene, ShadingModel

_GAP: Final = 1e-6
"""Metres from a surface at which a ray begins; it grows with the position's distance from the origin, by which float64
rounds."""
_ROUNDING: Final = 2.0**-16
"""How far an alpha may be below a mask's cutoff and still pass."""


@dataclass(frozen=True, eq=False, slots=True)
class Surfaces:
    """Points of surfaces, (k,) or (k, 3) each.

    Attributes:
        position: in the world. plane, normal: unit normals of the triangle and of the surface, on the side
            that is seen.
        to_eye: the unit vector to the eye.
        base: the base colour.
        alpha: the opacity.
        emitted: emitted light.
        metallic, roughness, occlusion: with their textures.
        irradiance: that of light maps; NaN where there is none.
        material: (k,) of `MATERIAL`.
    """

    position: Floats
    geometric_normal: Floats
    normal: Floats
    to_eye: Floats
    base: Floats
    alpha: Floats
    emitted: Floats
    metallic: Floats
    roughness: Floats
    occlusion: Floats
    irradiance: Floats
    material: NDArray[Any]


class Geometry:
    """The triangles of all objects of a scene as it stands.

    Attributes:
        corners: (m, 3, 3), in the world.
        lower, upper: (3,) of the box around all of them.
        objects: (m,) their objects.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        meshes, objects = scene.meshes, scene.objects
        triangles, rows = [], []
        for row in np.flatnonzero(objects.is_shown).tolist():
            first, count, base = (int(value) for value in meshes.ranges[objects.mesh[row]])
            surface = scene.tessellated.get(row)
            indices = (
                meshes.indices[first : first + count].reshape(-1, 3)
                if surface is None
                else surface.list_triangles()
            )
            triangles.append(indices.astype(np.int64) + base)
            rows.append(np.full(len(indices), row))
        self._vertices: Indices = np.concatenate(triangles)
        self.objects: Indices = np.concatenate(rows)
        world = scene.nodes.world[objects.node]
        self._cofactors = _cofactor_matrices(world[:, :3, :3])
        self._linear = world[:, :3, :3]
        local = meshes.vertices["position"].astype(np.float64)[self._vertices]
        self.corners: Floats = local @ self._linear[self.objects].transpose(0, 2, 1)
        self.corners += world[self.objects, None, :3, 3]
        points = self.corners.reshape(-1, 3).T.copy()  # along rows, a minimum is several times as fast
        self.lower: Floats = points.min(axis=1)
        self.upper: Floats = points.max(axis=1)
        sides = np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0])
        self._geometric_normals = normalize(np.einsum("tij,tj->ti", self._cofactors[self.objects], sides))
        materials = scene.materials[objects.material]
        self._two_sided = materials["double_sided"] != 0
        self.is_glass: NDArray[np.bool_] = materials["alpha_mode"] == AlphaMode.BLEND
        self._is_masked = materials["alpha_mode"] == AlphaMode.MASK
        self._casts = objects.casts_shadow & ~self.is_glass

    def block_light(self, hits: Hits, to_light: Floats) -> NDArray[np.bool_]:
        """The hits of rays towards a light that cast a shadow. Glass casts none, and masked materials only where
        they are opaque. One-sided surfaces block light on their front only, so objects may have a light
        inside."""
        rows = self.objects[hits.triangle]
        front = np.einsum("ij,ij->i", self._geometric_normals[hits.triangle], to_light[hits.ray]) > 0.0
        stops = self._casts[rows] & (front | self._two_sided[rows])
        return np.asarray(stops & ~self._are_masked_out(hits, stops))

    def are_visible(
        self, hits: Hits, directions: Floats, *, has_glass_backs: bool = False
    ) -> NDArray[np.bool_]:
        """The hits that are visible: not the holes of masks, and not the backs of one-sided materials, but for those of
        glass with `has_glass_backs`."""
        rows = self.objects[hits.triangle]
        seen = self.are_fronts(hits, directions) | self._two_sided[rows]
        if has_glass_backs:
            seen |= self.is_glass[rows]
        return np.asarray(seen & ~self._are_masked_out(hits, seen))

    def are_fronts(self, hits: Hits, directions: Floats) -> NDArray[np.bool_]:
        """The hits of the sides on which triangles' corners turn counterclockwise."""
        along = np.einsum("ij,ij->i", self._geometric_normals[hits.triangle], directions[hits.ray])
        return np.asarray(along < 0.0)

    def _are_masked_out(self, hits: Hits, among: NDArray[np.bool_]) -> NDArray[np.bool_]:
        holes = np.zeros(len(hits.ray), bool)
        masked = np.flatnonzero(among & self._is_masked[self.objects[hits.triangle]])
        if len(masked):
            masked_hits = hits.take(masked)
            material = self._scene.materials[self._scene.objects.material[self.objects[masked_hits.triangle]]]
            alpha = self._base_color(masked_hits, material)[:, 3]
            holes[masked] = alpha < material["alpha_cutoff"] - _ROUNDING
        return holes

    def _mix(self, hits: Hits, field: str) -> Floats:
        """A vertex attribute, interpolated where triangles are met."""
        shares = np.stack([1.0 - hits.second - hits.third, hits.second, hits.third], axis=1)
        values = self._scene.meshes.vertices[field][self._vertices[hits.triangle]].astype(np.float64)
        return np.asarray(np.einsum("tc,tci->ti", shares, values))

    def _base_color(self, hits: Hits, material: NDArray[Any]) -> Floats:
        base = material["base_color"].astype(np.float64) * self._read(hits, material["texture"])
        if "color" in (self._scene.meshes.vertices.dtype.names or ()):
            base = base * self._mix(hits, "color")
        return base

    def surfaces_at(self, hits: Hits, origins: Floats, directions: Floats) -> Surfaces:
        """The surfaces that rays meet."""
        scene, rows = self._scene, self.objects[hits.triangle]
        material = scene.materials[scene.objects.material[rows]]
        along = normalize(directions[hits.ray])
        geometric_normal = self._geometric_normals[hits.triangle]
        side = np.where(np.einsum("ij,ij->i", geometric_normal, along) < 0.0, 1.0, -1.0)[:, None]
        normal = normalize(np.einsum("tij,tj->ti", self._cofactors[rows], self._mix(hits, "normal")))
        base = self._base_color(hits, material)
        alpha = np.where(material["alpha_mode"] == AlphaMode.BLEND, np.clip(base[:, 3], 0.0, 1.0), 1.0)
        is_metal = material["model"] == ShadingModel.METALLIC_ROUGHNESS
        rough = self._read(hits, material["metallic_roughness_texture"])
        shade = self._read(hits, material["occlusion_texture"])[:, 0]
        emitted = material["emissive"] * self._read(hits, material["emissive_texture"])[:, :3]
        baked = self._read(hits, material["light_map_texture"])[:, :3] * material["light_map_color"]
        emitted = emitted + np.where(is_metal, 0.0, material["emission"])[:, None] * base[:, :3]
        return Surfaces(
            position=origins[hits.ray] + hits.distance[:, None] * directions[hits.ray],
            geometric_normal=geometric_normal * side,
            normal=self._bend(hits, rows, normal, material) * side,
            to_eye=-along,
            base=base[:, :3],
            alpha=alpha,
            emitted=emitted,
            metallic=material["metallic"] * rough[:, 2],
            roughness=material["roughness"] * rough[:, 1],
            occlusion=1.0 + material["occlusion_strength"] * (shade - 1.0),
            irradiance=np.where(material["light_map_texture"][:, None] >= 0, baked, np.nan),
            material=material,
        )

    def _bend(self, hits: Hits, rows: Indices, normal: Floats, material: NDArray[Any]) -> Floats:
        """Normals with their normal maps applied."""
        mapped = np.flatnonzero(material["normal_texture"] >= 0)
        if not len(mapped):
            return normal
        mapped_hits, rows = hits.take(mapped), rows[mapped]
        texel = self._read(mapped_hits, material["normal_texture"][mapped])[:, :3] * 2.0 - 1.0
        tangent = self._turn_tangents(mapped_hits, material["normal_texture"][mapped])
        hand = np.where(tangent[:, 3] < 0.0, -1.0, 1.0) * np.sign(np.linalg.det(self._linear[rows]))
        along = normalize(np.einsum("tij,tj->ti", self._linear[rows], tangent[:, :3]))
        up = np.cross(normal[mapped], along) * hand[:, None]
        flat = (along * texel[:, :1] + up * texel[:, 1:2]) * material["normal_scale"][mapped][:, None]
        bent = flat + normal[mapped] * texel[:, 2:]
        has_direction = np.einsum("ij,ij->i", bent, bent) >= 5e-5  # 8 bits can't store 0
        normal = normal.copy()
        normal[mapped] = np.where(has_direction[:, None], normalize(bent), normal[mapped])
        return normal

    def _turn_tangents(self, hits: Hits, textures: Indices) -> Floats:
        """Tangents (k, 4) along which the coordinates of normal maps grow, in mesh space: the mesh's own,
        turned back by the transform of each texture."""
        tangent = self._mix(hits, "tangent")
        (uu, uv), (vu, vv) = self._scene.textures["transform"][textures][:, :, :2].transpose(1, 2, 0)
        area = uu * vv - uv * vu
        along = normalize(tangent[:, :3])
        rising = np.cross(normalize(self._mix(hits, "normal")), along) * tangent[:, 3:]
        turned = (along * vv[:, None] + rising * vu[:, None]) * np.sign(area)[:, None]
        result = np.column_stack([turned, tangent[:, 3] * np.sign(area)])
        return np.where((area == 0.0)[:, None], tangent, result)

    def _read(self, hits: Hits, textures: Indices) -> Floats:
        """The texels (k, 4) of textures (k,), colours as linear light; 1 where there is no texture."""
        texels = np.ones((len(hits.ray), 4))
        for number in np.unique(textures[textures >= 0]).tolist():
            selected = np.flatnonzero(textures == number)
            use = self._scene.textures[number]
            uv = self._mix(hits.take(selected), "uv2" if use["uv_set"] else "uv")
            uv = np.column_stack([uv, np.ones(len(uv))]) @ use["transform"].astype(np.float64).T
            sampler = self._scene.samplers[use["sampler"]]
            image = self._scene.images[use["image"]]
            texels[selected] = _sample(image, uv, sampler, is_color=bool(use["is_color"]))
        return texels


def _sample(image: ImagePixels, uv: Floats, sampler: Any, *, is_color: bool) -> Floats:
    """The texels (k, 4) at texture coordinates, interpolated unless the sampler takes the nearest one."""
    size = np.array([image.shape[1], image.shape[0]])
    position = uv * size - 0.5
    if sampler.magnify.name == "NEAREST":
        position = np.round(position)
    first = np.floor(position).astype(np.int64)
    part = position - first
    mixed = np.zeros((len(uv), 4))
    for right in (0, 1):
        for down in (0, 1):
            x, has_x = _wrap(first[:, 0] + right, size[0], sampler.wrap_u.name)
            y, has_y = _wrap(first[:, 1] + down, size[1], sampler.wrap_v.name)
            texels = image[y, x].astype(np.float64)
            if image.dtype == np.uint8:
                texels /= 255.0
                if is_color:
                    texels[:, :3] = decode_srgb(texels[:, :3])
            texels = np.where((has_x & has_y)[:, None], texels, sampler.border)
            share = np.abs(1 - right - part[:, 0]) * np.abs(1 - down - part[:, 1])
            mixed += share[:, None] * texels
    return mixed


def _wrap(texel: Indices, size: int, how: str) -> tuple[Indices, NDArray[np.bool_]]:
    """The texels at positions along an axis, and whether there are any."""
    inside = np.ones(len(texel), bool)
    if how == "REPEAT":
        return texel % size, inside
    if how == "MIRROR":
        turned = texel % (2 * size)
        return np.minimum(turned, 2 * size - 1 - turned), inside
    if how == "BORDER":
        inside = (texel >= 0) & (texel < size)
    return np.clip(texel, 0, size - 1), inside


def _cofactor_matrices(linear: Floats) -> Floats:
    """The matrices (n, 3, 3) that transform normals: cofactors, negated where `linear` mirrors."""
    x_axis, y_axis, z_axis = np.moveaxis(linear, 1, 0)
    cofactors = np.stack(
        [np.cross(y_axis, z_axis), np.cross(z_axis, x_axis), np.cross(x_axis, y_axis)], axis=1
    )
    return (
        cofactors * np.where(np.einsum("ij,ij->i", x_axis, cofactors[:, 0]) < 0.0, -1.0, 1.0)[:, None, None]
    )


def normalize(vectors: Floats) -> Floats:
    """Vectors (k, 3) scaled to a length of 1; those of length 0 stay."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))


def dot(a: Floats, b: Floats) -> Floats:
    """The products (k,) of vectors (k, 3)."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


def make_axes(vectors: Floats) -> tuple[Floats, Floats]:
    """Unit vectors (k, 3) at right angles to unit vectors (k, 3), and others at right angles to both."""
    aside = normalize(np.cross(vectors, np.eye(3)[np.abs(vectors).argmin(axis=1)]))
    return aside, np.cross(vectors, aside)


def measure_gap(position: Floats) -> Floats:
    """Metres (k,) from surfaces at positions (k, 3) at which rays begin, so that they don't meet the surface again."""
    return np.asarray(_GAP + 1e-13 * np.abs(position).max(axis=1, initial=0.0))


def decode_srgb(color: Floats) -> Floats:
    """Decode sRGB from 0 to 1 to linear light (IEC 61966-2-1)."""
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def encode_srgb(light: Floats) -> Floats:
    """Encode linear light as sRGB from 0 to 1 (IEC 61966-2-1)."""
    light = np.clip(light, 0.0, 1.0)
    return np.where(
        light <= 0.0031308, light * 12.92, 1.055 * np.maximum(light, 1e-12) ** (1.0 / 2.4) - 0.055
    )
