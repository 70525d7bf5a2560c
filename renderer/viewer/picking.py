"""Picking: the surface in the middle of a pixel, found by a ray in float64 against the scene's triangles.

A ray is exact where an id buffer would have to be drawn and read back, which waits for the device and costs
each technique a target. It says which triangle, where and how far, also on a device that draws nothing. Boxes
come first, then the triangles of the objects whose boxes are hit, the nearest first, until no box is nearer
than the best hit. What isn't drawn can't be hit: backs of one-sided surfaces, holes of masks, what is before
the near plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Orthographic, Perspective, Scene, Simulator
from renderer.scene.arrays import Floats, Indices
from renderer.scene.images import read_values
from renderer.scene.materials import AlphaMode

_EDGE: Final = 1e-9  # of barycentric coordinates, so that no ray passes between neighbours


@dataclass(frozen=True, eq=False, slots=True)
class Ray:
    """A ray: `origin` (3,), `direction` (3,) of unit length, and the distance `max_distance` at which it
    ends. `eye_distance` is that from the eye to its origin."""

    origin: Floats
    direction: Floats
    max_distance: float
    eye_distance: float

    @classmethod
    def through(cls, camera: Camera, size: tuple[int, int], x: int, y: int) -> Ray:
        """The ray through the centre of a pixel of an image of `size`, from the near plane to the far plane.
        The image has the projection's aspect, or is squeezed to a half, as one of two eyes."""
        projection = camera.projection
        assert isinstance(projection, Perspective | Orthographic)
        across, up = 2.0 * (x + 0.5) / size[0] - 1.0, 1.0 - 2.0 * (y + 0.5) / size[1]
        high = (
            projection.height / 2.0
            if isinstance(projection, Orthographic)
            else projection.near * np.tan(0.5 * projection.fov)
        )
        start = np.array((across * high * projection.aspect, up * high, -projection.near))
        along = (
            np.array((0.0, 0.0, -1.0))
            if isinstance(projection, Orthographic)
            else start / np.linalg.norm(start)
        )
        eye_distance = 0.0 if isinstance(projection, Orthographic) else float(np.linalg.norm(start))
        max_distance = (projection.far - projection.near) / -float(along[2])
        turned = start @ camera.rotation
        return cls(camera.position + turned, along @ camera.rotation, max_distance, eye_distance)


@dataclass(frozen=True, eq=False, slots=True)
class Hit:
    """A hit of a ray with a surface.

    Attributes:
        object_index: the object.
        triangle: its number in the mesh.
        distance: from the eye, in metres.
        point: (3,) in the world.
        corners: (3, 3) of the triangle, in the world.
    """

    object_index: int
    triangle: int
    distance: float
    point: Floats
    corners: Floats


def find_hit(scene: Scene, simulator: Simulator, ray: Ray, object_indices: Indices) -> Hit | None:
    """The first hit of a ray with the objects `object_indices` (k,), None without one."""
    entries = intersect_boxes(ray, scene.objects.lower[object_indices], scene.objects.upper[object_indices])
    order = np.argsort(entries, kind="stable")
    best: Hit | None = None
    max_distance = ray.max_distance
    for number in order.tolist():
        if entries[number] > max_distance or not entries[number] < np.inf:
            break
        hit = _intersect_object(scene, simulator, ray, int(object_indices[number]), max_distance)
        if hit is not None and (best is None or hit.distance < best.distance):
            best, max_distance = hit, hit.distance - ray.eye_distance
    return best


def intersect_boxes(ray: Ray, lower: Floats, upper: Floats) -> Floats:
    """The distances (n,) from the ray's origin at which it enters boxes; infinite if it doesn't."""
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (lower - ray.origin) / ray.direction, (upper - ray.origin) / ray.direction
    along = (lower <= ray.origin) & (
        ray.origin <= upper
    )  # decides where the ray is parallel to a pair of faces
    moves = ray.direction != 0.0
    enter = np.where(moves, np.minimum(first, second), np.where(along, -np.inf, np.inf)).max(axis=1)
    leave = np.where(moves, np.maximum(first, second), np.where(along, np.inf, -np.inf)).min(axis=1)
    enter = np.maximum(enter, 0.0)
    with np.errstate(invalid="ignore"):
        return np.where(enter <= leave + 1e-12 * (1.0 + enter), enter, np.inf)


def intersect_triangles(
    origin: Floats, direction: Floats, corners: Floats, *, both_sides: bool = False
) -> tuple[Floats, Floats]:
    """For triangles (t, 3, 3), the multiple (t,) of `direction` at which a ray meets them, infinite if it
    doesn't, and the weights (t, 2) of the second and the third corner there (Möller and Trumbore, 1997)."""
    first = corners[:, 0]
    edge_1, edge_2 = corners[:, 1] - first, corners[:, 2] - first
    across = np.cross(direction, edge_2)
    facing = np.einsum("ij,ij->i", edge_1, across)  # positive: the ray sees the counter-clockwise side
    away = origin - first
    turned = np.cross(away, edge_1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ij,ij->i", away, across) / facing
        v = turned @ direction / facing
        distance = np.einsum("ij,ij->i", edge_2, turned) / facing
        faces = facing != 0.0 if both_sides else facing > 0.0
        fits = faces & (u >= -_EDGE) & (v >= -_EDGE) & (u + v <= 1.0 + _EDGE)
    return np.where(fits & (distance >= 0.0), distance, np.inf), np.stack([u, v], axis=1)


def _intersect_object(
    scene: Scene, simulator: Simulator, ray: Ray, object_index: int, max_distance: float
) -> Hit | None:
    objects, meshes = scene.objects, scene.meshes
    part = meshes.ranges[objects.mesh[object_index]]
    indices = meshes.indices[part["first_index"] :][: part["index_count"]].reshape(-1, 3)
    count = int(meshes.vertex_counts[objects.mesh[object_index]])
    vertices = simulator.read_vertices(object_index)
    if vertices is None:
        vertices = meshes.vertices[part["base_vertex"] :][:count]
    world = scene.nodes.world[objects.node[object_index]]
    linear = world[:3, :3]
    if np.linalg.det(linear) == 0.0:
        return None
    inverse = np.linalg.inv(linear)  # a mirroring one keeps the mesh's outside out, as the renderer does
    origin, direction = inverse @ (ray.origin - world[:3, 3]), inverse @ ray.direction
    material = scene.materials[objects.material[object_index]]
    corners = vertices["position"].astype(np.float64)[indices]
    both_sides = bool(material["double_sided"])
    distance, weights = intersect_triangles(origin, direction, corners, both_sides=both_sides)
    met = np.flatnonzero((distance <= max_distance) & (distance < np.inf))
    for triangle in met[np.argsort(distance[met], kind="stable")].tolist():
        u, v = weights[triangle].tolist()
        if _is_masked_out(scene, material, vertices[indices[triangle]], np.array((1.0 - u - v, u, v))):
            continue
        far = float(distance[triangle])
        placed = corners[triangle] @ linear.T + world[:3, 3]
        return Hit(object_index, triangle, ray.eye_distance + far, ray.origin + far * ray.direction, placed)
    return None


def _is_masked_out(scene: Scene, material: Any, corners: NDArray[Any], weights: Floats) -> bool:
    """True if a mask leaves out a point of a triangle: the nearest texel says so, of the largest image."""
    if material["alpha_mode"] != AlphaMode.MASK:
        return False
    alpha = float(material["base_color"][3])
    if "color" in (corners.dtype.names or ()):
        alpha *= float(weights @ corners["color"][:, 3])
    if material["texture"] >= 0:
        texture = scene.textures[material["texture"]]
        image = scene.images[texture["image"]]
        uv = weights @ corners["uv2" if texture["uv_set"] else "uv"].astype(np.float64)
        u, v = (texture["transform"] @ np.append(uv, 1.0)).tolist()
        height, width = image.shape[:2]
        texel = image[int(np.floor(v * height)) % height, int(np.floor(u * width)) % width]
        alpha *= float(read_values(texel, is_color=False)[3])
    return alpha < float(material["alpha_cutoff"])
