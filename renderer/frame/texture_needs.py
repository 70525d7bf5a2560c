"""The finest mip levels of a scene's images that a view reads, as bounds that hold for every pixel.

A mesh's density is the least change of texture coordinates per metre, over its triangles: a pixel that covers a length
on the surface covers at least that much of a texture. The nearest point of an object's box and the projection say how
short that length is. So no pixel of the object reads a level finer than the bound, which is exact for a surface that
faces the eye there. What isn't bounded by that reads all levels: deformed and simulated objects, masks (shadow maps
read them, too), decals, and materials with shaders of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene import AlphaMode, Camera, Scene
from renderer.scene.arrays import Floats, Indices
from renderer.scene.material_instances import list_textures
from renderer.scene.materials import TEXTURES
from renderer.visibility.boxes.volumes import Containment, classify
from rhi.math import is_parallel

_MARGIN: Final = 0.5 + 1.0 / 16.0
"""Levels by which a bound is finer than it need be: devices may take the longest component of a derivative for its
length, and round the logarithm."""


@dataclass(frozen=True, slots=True)
class ViewNeeds:
    """The needs of a view.

    Attributes:
        levels: (e,) the finest level of each image that is read; a large number for images that aren't in view.
        sizes: (e,) the size on the screen of the largest object with the image; 0 out of view.
    """

    levels: NDArray[np.int64]
    sizes: Floats


OUT_OF_VIEW: Final = 1 << 20
"""The level of an image that no pixel reads."""


class TextureNeeds:
    """The objects that read each image of a scene, and how densely."""

    def __init__(self, scene: Scene, entries: Indices, scales: Floats) -> None:
        """`entries` (t,) are the images' numbers by texture, and `scales` (t,) the fewest texels of a texture's image
        that a unit of texture coordinates is, 0 if all levels are read in any case."""
        self._scene, self._entries, self._scales = scene, entries, scales
        self._count = int(entries.max(initial=-1)) + 1
        self._densities = _measure_densities(scene)
        self._version: tuple[object, ...] = ()
        self._always: NDArray[np.bool_] = np.zeros(self._count, bool)
        self._objects: Indices = np.zeros(0, np.int64)
        self._pairs: Indices = np.zeros(0, np.int64)
        self._density: Floats = np.zeros(0)

    def measure(self, cameras: Sequence[Camera], size: tuple[int, int]) -> ViewNeeds:
        """Return the levels that images of this size read through these cameras."""
        self._follow()
        objects = self._scene.objects
        levels: NDArray[np.int64] = np.full(self._count, OUT_OF_VIEW)
        sizes: Floats = np.zeros(self._count)
        world = self._scene.nodes.world[objects.node][:, :3, :3]
        stretch = np.sqrt(np.abs(world.transpose(0, 2, 1) @ world).sum(axis=2).max(axis=1))
        for camera in cameras:
            side = classify(camera.frustum.planes, objects.lower, objects.upper)
            in_view = ((side != Containment.OUTSIDE) & objects.is_shown)[self._objects]
            rows, pairs = self._objects[in_view], self._pairs[in_view]
            lengths = _measure_pixels(camera, size, objects.lower, objects.upper) / np.maximum(stretch, 1e-30)
            texels = np.maximum(lengths[rows] * self._density[in_view], 1e-30)
            finest = np.clip(np.floor(np.log2(texels) - _MARGIN), 0, OUT_OF_VIEW).astype(np.int64)
            np.minimum.at(levels, pairs, finest)
            radius = 0.5 * np.linalg.norm(objects.upper - objects.lower, axis=1)
            middle = 0.5 * (objects.upper + objects.lower)
            away = np.maximum(np.linalg.norm(middle - camera.position, axis=1), np.maximum(radius, 1e-30))
            np.maximum.at(sizes, pairs, (radius / away)[rows])
        levels[self._always] = 0
        sizes[self._always] = np.maximum(sizes[self._always], 1e-30)
        return ViewNeeds(levels, sizes)

    def _follow(self) -> None:
        """List the pairs of objects and images anew if materials or meshes have changed."""
        scene, objects = self._scene, self._scene.objects
        version = (scene.material_version, objects.mesh.tobytes(), objects.material.tobytes())
        if version == self._version:
            return
        self._version = version
        materials = scene.materials
        fixed = np.ones(len(objects), bool)
        fixed[objects.simulated_indices] = False
        fixed[sorted(scene.tessellated)] = False
        self._always = np.zeros(self._count, bool)
        lists: list[tuple[Indices, Indices, Floats]] = []
        reads_all = (materials["alpha_mode"] == AlphaMode.MASK) | (materials["shader"] > 0)
        for name in TEXTURES:
            texture = materials[name][objects.material].astype(np.int64)
            rows = np.flatnonzero(texture >= 0)
            texture = texture[rows]
            uv_set = scene.textures["uv_set"][texture]
            density = self._densities[objects.mesh[rows], uv_set] * self._scales[texture]
            lists.append((rows, self._entries[texture], np.where(fixed[rows], density, 0.0)))
            self._always[self._entries[texture[reads_all[objects.material[rows]]]]] = True
        for shader, values in zip(scene.shaders, scene.parameters, strict=True):
            for name in list_textures(shader).keys() - TEXTURES.keys():
                if len(values):
                    texture = values[name].astype(np.int64)
                    self._always[self._entries[texture[texture >= 0]]] = True
        if len(scene.decals.seen):
            self._always[self._entries[scene.decals.array["texture"]]] = True
        self._objects = np.concatenate([rows for rows, _, _ in lists])
        self._pairs = np.concatenate([entries for _, entries, _ in lists])
        self._density = np.concatenate([density for _, _, density in lists])


def _measure_pixels(camera: Camera, size: tuple[int, int], lower: Floats, upper: Floats) -> Floats:
    """Return the shortest length (n,) that a pixel covers on a surface in each of the boxes (n, 3)."""
    matrix = camera.projection.matrix
    scale = 0.5 * max(abs(matrix[0, 0]) * size[0], abs(matrix[1, 1]) * size[1])
    if is_parallel(camera.projection):
        return np.full(len(lower), 1.0 / scale)
    tangents = [(1.0 + abs(matrix[axis, 2])) / abs(matrix[axis, axis]) for axis in (0, 1)]
    cosine = 1.0 / np.sqrt(1.0 + tangents[0] ** 2 + tangents[1] ** 2)
    forward = camera.forward
    middle, half = 0.5 * (lower + upper) - camera.position, 0.5 * (upper - lower)
    depth: Floats = np.maximum(middle @ forward - half @ np.abs(forward), 0.0)
    lengths: Floats = depth * (cosine / scale)
    return lengths


def _measure_densities(scene: Scene) -> Floats:
    """Return the least change of texture coordinates per metre (m, 2), of each mesh and set."""
    meshes = scene.meshes
    densities: Floats = np.zeros((len(meshes), 2))
    names = [name for name in ("uv", "uv2") if name in (meshes.vertices.dtype.names or ())]
    for mesh in range(len(meshes)):
        first, count, base = (int(value) for value in meshes.ranges[mesh])
        corners = meshes.vertices[meshes.indices[first : first + count // 3 * 3].astype(np.int64) + base]
        position = corners["position"].astype(np.float64).reshape(-1, 3, 3)
        edges = position[:, 1:] - position[:, :1]
        metric = edges @ edges.transpose(0, 2, 1)
        area = metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1] ** 2
        seen = area > 0.0
        if not seen.any():
            continue
        for number, name in enumerate(names):
            uv = corners[name].astype(np.float64).reshape(-1, 3, 2)
            steps = (uv[:, 1:] - uv[:, :1])[seen]
            # The squared norm of the gradient, trace(G⁻¹ S) with the products G of edges and S of steps, is that
            # of both axes. The longer of two steps at right angles has half of it at least.
            products = steps @ steps.transpose(0, 2, 1)
            inside = metric[seen]
            trace = (
                inside[:, 1, 1] * products[:, 0, 0]
                + inside[:, 0, 0] * products[:, 1, 1]
                - 2.0 * inside[:, 0, 1] * products[:, 0, 1]
            ) / area[seen]
            densities[mesh, number] = np.sqrt(max(0.5 * float(trace.min()), 0.0))
    return densities
