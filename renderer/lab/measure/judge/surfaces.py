"""Surfaces: the triangles of a scene in the world, and what a ray sees where it meets one of them.

Vertices are moved and their normals turned by the objects' transforms here, in float64. A normal is turned by the
matrix of cofactors with the sign of the determinant: the front of a triangle stays its front when it is mirrored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lab.measure.judge.rays import Floats, Hits, Rows
from renderer.scene import AlphaMode, Scene, ShadingModel

_ROUNDING: Final = 2.0**-16
"""The most that an alpha may be below a mask's cut and still be at it."""


@dataclass(frozen=True, eq=False, slots=True)
class Surfaces:
    """Points of surfaces, (k,) or (k, 3) each.

    Attributes:
        position: in the world. plane, normal: unit normals of the triangle and of the surface, on the side that is
            seen. to_eye: the unit vector to the eye.
        base: the base colour. alpha: the share of what is behind that it covers. emitted: light of its own.
        metallic, roughness, occlusion: with their textures.
        material: (k,) of `MATERIAL`.
    """

    position: Floats
    plane: Floats
    normal: Floats
    to_eye: Floats
    base: Floats
    alpha: Floats
    emitted: Floats
    metallic: Floats
    roughness: Floats
    occlusion: Floats
    material: NDArray[Any]


class Geometry:
    """The triangles of all objects of a scene as it stands.

    Attributes:
        corners: (m, 3, 3), in the world. objects: (m,) their objects.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        meshes, objects = scene.meshes, scene.objects
        triangles, rows = [], []
        for row in np.flatnonzero(objects.shown).tolist():
            first, count, base = (int(value) for value in meshes.ranges[objects.mesh[row]])
            field = scene.height_fields.get(row)
            indices = meshes.indices[first : first + count].reshape(-1, 3) if field is None else _divide(field.heights)
            triangles.append(indices.astype(np.int64) + base)
            rows.append(np.full(len(indices), row))
        self._vertices: Rows = np.concatenate(triangles)
        self.objects: Rows = np.concatenate(rows)
        world = scene.nodes.world[objects.node]
        self._cofactors = _find_cofactors(world[:, :3, :3])
        self._linear = world[:, :3, :3]
        local = meshes.vertices["position"].astype(np.float64)[self._vertices]
        self.corners: Floats = np.einsum("tij,tcj->tci", self._linear[self.objects], local)
        self.corners += world[self.objects, None, :3, 3]
        sides = np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0])
        self._planes = normalize(np.einsum("tij,tj->ti", self._cofactors[self.objects], sides))
        materials = scene.materials[objects.material]
        self._two_sided = materials["double_sided"] != 0
        self.is_glass: NDArray[np.bool_] = materials["alpha_mode"] == AlphaMode.BLEND
        self._is_masked = materials["alpha_mode"] == AlphaMode.MASK
        self._casts = objects.casts_shadow & ~self.is_glass

    def stop_light(self, hits: Hits, to_light: Floats) -> NDArray[np.bool_]:
        """Return at which hits of rays towards a light a shadow is cast. Glass casts none, and masks only where there
        is something; what has one side stops light that falls on its front, so a lamp may be inside of what shines."""
        rows = self.objects[hits.triangle]
        front = np.einsum("ij,ij->i", self._planes[hits.triangle], to_light[hits.ray]) > 0.0
        stops = self._casts[rows] & (front | self._two_sided[rows])
        return np.asarray(stops & ~self._find_holes(hits, stops))

    def are_seen(self, hits: Hits, directions: Floats) -> NDArray[np.bool_]:
        """Return at which hits there is something to see: no back of what has one side, no hole of a mask."""
        rows = self.objects[hits.triangle]
        front = np.einsum("ij,ij->i", self._planes[hits.triangle], directions[hits.ray]) < 0.0
        seen = front | self._two_sided[rows]
        return np.asarray(seen & ~self._find_holes(hits, seen))

    def _find_holes(self, hits: Hits, among: NDArray[np.bool_]) -> NDArray[np.bool_]:
        holes = np.zeros(len(hits.ray), bool)
        some = np.flatnonzero(among & self._is_masked[self.objects[hits.triangle]])
        if len(some):
            chosen = hits.take(some)
            material = self._scene.materials[self._scene.objects.material[self.objects[chosen.triangle]]]
            alpha = self._find_base(chosen, material)[:, 3]
            holes[some] = alpha < material["alpha_cutoff"] - _ROUNDING
        return holes

    def _mix(self, hits: Hits, field: str) -> Floats:
        """Return an attribute of vertices where triangles are met."""
        shares = np.stack([1.0 - hits.second - hits.third, hits.second, hits.third], axis=1)
        values = self._scene.meshes.vertices[field][self._vertices[hits.triangle]].astype(np.float64)
        return np.asarray(np.einsum("tc,tci->ti", shares, values))

    def _find_base(self, hits: Hits, material: NDArray[Any]) -> Floats:
        base = material["base_color"].astype(np.float64) * self._read(hits, material["texture"])
        if "color" in (self._scene.meshes.vertices.dtype.names or ()):
            base = base * self._mix(hits, "color")
        return base

    def see(self, hits: Hits, origins: Floats, directions: Floats) -> Surfaces:
        """Return the surfaces that rays meet."""
        scene, rows = self._scene, self.objects[hits.triangle]
        material = scene.materials[scene.objects.material[rows]]
        along = normalize(directions[hits.ray])
        plane = self._planes[hits.triangle]
        side = np.where(np.einsum("ij,ij->i", plane, along) < 0.0, 1.0, -1.0)[:, None]
        normal = normalize(np.einsum("tij,tj->ti", self._cofactors[rows], self._mix(hits, "normal")))
        base = self._find_base(hits, material)
        alpha = np.where(material["alpha_mode"] == AlphaMode.BLEND, np.clip(base[:, 3], 0.0, 1.0), 1.0)
        is_metal = material["model"] == ShadingModel.METALLIC_ROUGHNESS
        rough = self._read(hits, material["metallic_roughness_texture"])
        shade = self._read(hits, material["occlusion_texture"])[:, 0]
        emitted = material["emissive"] * self._read(hits, material["emissive_texture"])[:, :3]
        emitted = emitted + np.where(is_metal, 0.0, material["emission"])[:, None] * base[:, :3]
        return Surfaces(
            position=origins[hits.ray] + hits.distance[:, None] * directions[hits.ray],
            plane=plane * side,
            normal=self._bend(hits, rows, normal, material) * side,
            to_eye=-along,
            base=base[:, :3],
            alpha=alpha,
            emitted=emitted,
            metallic=material["metallic"] * rough[:, 2],
            roughness=material["roughness"] * rough[:, 1],
            occlusion=1.0 + material["occlusion_strength"] * (shade - 1.0),
            material=material,
        )

    def _bend(self, hits: Hits, rows: Rows, normal: Floats, material: NDArray[Any]) -> Floats:
        """Return normals as maps bend them."""
        some = np.flatnonzero(material["normal_texture"] >= 0)
        if not len(some):
            return normal
        chosen, rows = hits.take(some), rows[some]
        texel = self._read(chosen, material["normal_texture"][some])[:, :3] * 2.0 - 1.0
        tangent = self._mix(chosen, "tangent")
        hand = np.where(tangent[:, 3] < 0.0, -1.0, 1.0) * np.sign(np.linalg.det(self._linear[rows]))
        along = normalize(np.einsum("tij,tj->ti", self._linear[rows], tangent[:, :3]))
        up = np.cross(normal[some], along) * hand[:, None]
        flat = (along * texel[:, :1] + up * texel[:, 1:2]) * material["normal_scale"][some][:, None]
        bent = flat + normal[some] * texel[:, 2:]
        has_direction = np.einsum("ij,ij->i", bent, bent) >= 5e-5  # 8 bits have no 0
        normal = normal.copy()
        normal[some] = np.where(has_direction[:, None], normalize(bent), normal[some])
        return normal

    def _read(self, hits: Hits, textures: Rows) -> Floats:
        """Return the texels (k, 4) of textures (k,), colours as linear light; 1 where there is none."""
        texels = np.ones((len(hits.ray), 4))
        for number in np.unique(textures[textures >= 0]).tolist():
            some = np.flatnonzero(textures == number)
            use = self._scene.textures[number]
            uv = self._mix(hits.take(some), "uv2" if use["uv_set"] else "uv")
            uv = np.column_stack([uv, np.ones(len(uv))]) @ use["transform"].astype(np.float64).T
            sampler = self._scene.samplers[use["sampler"]]
            image = self._scene.images[use["image"]]
            texels[some] = _sample(image, uv, sampler, is_color=bool(use["is_color"]))
        return texels


def _sample(image: NDArray[np.uint8], uv: Floats, sampler: Any, *, is_color: bool) -> Floats:
    """Return texels (k, 4), between which it is interpolated unless the sampler takes the nearest one."""
    size = np.array([image.shape[1], image.shape[0]])
    place = uv * size - 0.5
    if sampler.magnify.name == "NEAREST":
        place = np.round(place)
    first = np.floor(place).astype(np.int64)
    part = place - first
    mixed = np.zeros((len(uv), 4))
    for right in (0, 1):
        for down in (0, 1):
            x, has_x = _wrap(first[:, 0] + right, size[0], sampler.wrap_u.name)
            y, has_y = _wrap(first[:, 1] + down, size[1], sampler.wrap_v.name)
            texels = image[y, x] / 255.0
            if is_color:
                texels[:, :3] = decode_srgb(texels[:, :3])
            texels = np.where((has_x & has_y)[:, None], texels, sampler.border)
            share = np.abs(1 - right - part[:, 0]) * np.abs(1 - down - part[:, 1])
            mixed += share[:, None] * texels
    return mixed


def _wrap(place: Rows, size: int, how: str) -> tuple[Rows, NDArray[np.bool_]]:
    """Return the texels at places of an axis, and whether there are any."""
    inside = np.ones(len(place), bool)
    if how == "REPEAT":
        return place % size, inside
    if how == "MIRROR":
        turned = place % (2 * size)
        return np.minimum(turned, 2 * size - 1 - turned), inside
    if how == "BORDER":
        inside = (place >= 0) & (place < size)
    return np.clip(place, 0, size - 1), inside


def _divide(heights: NDArray[np.float32]) -> Rows:
    """Return the triangles of a height field, row by row: diagonals end where row and column are both odd."""
    rows, columns = (some.reshape(-1) for some in np.indices((len(heights) - 1, len(heights) - 1)))
    width = len(heights)
    a = rows * width + columns
    b, c, d = a + 1, a + width, a + width + 1
    even = ((rows + columns) % 2 == 0)[:, None]
    one = np.where(even, np.stack([a, c, d], 1), np.stack([a, c, b], 1))
    other = np.where(even, np.stack([a, d, b], 1), np.stack([b, c, d], 1))
    return np.concatenate([one, other])


def _find_cofactors(linear: Floats) -> Floats:
    """Return the matrices (n, 3, 3) that turn normals: of cofactors, negative where `linear` mirrors."""
    one, two, three = np.moveaxis(linear, 1, 0)
    cofactors = np.stack([np.cross(two, three), np.cross(three, one), np.cross(one, two)], axis=1)
    return cofactors * np.where(np.einsum("ij,ij->i", one, cofactors[:, 0]) < 0.0, -1.0, 1.0)[:, None, None]


def normalize(vectors: Floats) -> Floats:
    """Return vectors (k, 3) with a length of 1; those of length 0 stay."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))


def decode_srgb(color: Floats) -> Floats:
    """Return the linear light of sRGB from 0 to 1 (IEC 61966-2-1)."""
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def encode_srgb(light: Floats) -> Floats:
    """Return linear light as sRGB from 0 to 1 (IEC 61966-2-1)."""
    light = np.clip(light, 0.0, 1.0)
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * np.maximum(light, 1e-12) ** (1.0 / 2.4) - 0.055)
