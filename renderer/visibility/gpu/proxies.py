"""Proxies: convex polytopes that are drawn in place of objects' boxes, where boxes are loose (Deferred+, 1.3.1).

Each mesh has a k-DOP (`boxes.polytopes`). All are lists of as many triangles, filled up with empty ones, so all objects
are instances of one draw as their boxes are. `FitProxies` replaces the boxes that `ComputeOccludees` has written by
what maps a polytope's corners to positions relative to the eye.

**Padding.** A polytope Q that contains a ball of radius r about a point contains Q ⊕ ball(m), everything within a
margin of m, once it is scaled by 1 + m / r about that point. Near r is small against the margin, and then the corners
of the polytope move out farther than the box's faces do. So where the factor is above 1 + `_MOST_GROWTH`, and where the
near plane might cut the larger polytope, the box is drawn: as the first of all lists of triangles.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.scene import Scene
from renderer.scene.meshes import Meshes
from renderer.shaders import MeshPart, Object, ObjectPosition, ViewConstants, relative_position
from renderer.visibility.boxes.bounds import ROUNDING
from renderer.visibility.boxes.cubes import CubeCorner
from renderer.visibility.boxes.polytopes import compute_polytope, count_triangles, list_box_corners
from renderer.visibility.gpu.occludees import (
    GROUP,
    MIN_VOLUME,
    BoxVarying,
    ComputeOccludees,
    CullingCamera,
    MarkBoxes,
    Occludee,
    Occludees,
)
from renderer.visibility.scene_drawer import SceneArrays
from rhi import Device, Encoder, Mesh

_MOST_GROWTH: Final = 0.125
_ROUNDED_DOWN: Final = 1.0 - 2.0**-20


class Proxy(sl.Struct):
    """The polytope of a mesh: a point inside, in mesh space; the distance from it, in half sizes of the mesh's box, to
    which it contains a box; and its first corner, 0 if it is the box itself."""

    centre: sl.vec3
    reach: float
    first: int


class ProxyCorner(sl.Struct):
    """A corner of a polytope's triangle, relative to `Proxy.centre`, in half sizes of the mesh's box."""

    position: sl.vec3


class FitProxies(sl.Shader):
    """Replaces the boxes of objects by maps of their meshes' polytopes, and writes each object's first corner: -1 - f
    in place of f for a mirrored object, whose triangles are turned around."""

    work_group = (GROUP,)
    view: sl.Uniform[ViewConstants]
    culling_camera: sl.Uniform[CullingCamera]
    objects: sl.Storage[Object]
    object_positions: sl.Storage[ObjectPosition]
    object_meshes: sl.Storage[int]
    mesh_parts: sl.Storage[MeshPart]
    proxies: sl.Storage[Proxy]
    boxes: sl.StorageRW[Occludee]
    first_corners: sl.StorageRW[int]

    def compute(self) -> None:
        object_index = sl.global_id().x
        if object_index >= len(self.boxes):
            return
        self.first_corners[object_index] = 0
        mesh = self.object_meshes[object_index]
        proxy = self.proxies[mesh]
        part = self.mesh_parts[mesh]
        box = self.boxes[object_index]
        sides = sl.abs(box.x) + sl.abs(box.y) + sl.abs(box.z)
        if proxy.first == 0 or sides.x + sides.y + sides.z == 0.0:
            return
        linear = self.objects[object_index].linear
        columns = sl.transpose(linear)
        half = 0.5 * (part.upper - part.lower)
        x = columns[0] * half.x
        y = columns[1] * half.y
        z = columns[2] * half.z
        x_length = sl.length(x)
        y_length = sl.length(y)
        z_length = sl.length(z)
        shortest = sl.min(x_length, sl.min(y_length, z_length))
        if not shortest > 1e-30:
            return
        volume = sl.dot(x / x_length, sl.cross(y / y_length, z / z_length))
        if not sl.abs(volume) > MIN_VOLUME:
            return

        far = sl.length(box.centre) + sl.length(box.x) + sl.length(box.y) + sl.length(box.z)
        middle = linear @ proxy.centre
        size = sl.length(linear @ (0.5 * (part.lower + part.upper))) + x_length + y_length + z_length
        margin = sl.dot(self.culling_camera.margin, sl.vec3(1.0, far, far * far)) + ROUNDING * (
            sl.length(middle) + size
        )
        growth = margin / (proxy.reach * sl.abs(volume) * shortest)
        if not growth < _MOST_GROWTH:
            return
        grown = sides * (1.0 + 2.0 * growth)  # the polytope's centre may be as far as the box's side
        away = sl.max(sl.abs(box.centre) - grown, sl.vec3(0.0))
        forward = self.culling_camera.forward
        begin = sl.dot(box.centre, forward) - sl.dot(sl.abs(forward), grown)
        if sl.length(away) <= self.culling_camera.near_radius or begin <= self.culling_camera.near_depth:
            return
        scale = 1.0 + growth
        self.boxes[object_index] = Occludee(
            centre=relative_position(self.object_positions[object_index], self.view) + middle,
            depth=box.depth,
            x=x * scale,
            y=y * scale,
            z=z * scale,
        )
        self.first_corners[object_index] = proxy.first if volume > 0.0 else -1 - proxy.first


class MarkProxies(MarkBoxes):
    """Marks as `MarkBoxes` each object of whose polytope a fragment passes the depth test; positions have the numbers
    of corners."""

    first_corners: sl.Storage[int]
    corners: sl.Storage[ProxyCorner]

    def vertex(self, v: CubeCorner) -> BoxVarying:
        object_index = self.object_index()
        box = self.boxes[object_index]
        first = self.first_corners[object_index]
        number = int(v.position.x)
        if first < 0:
            number += 2 - 2 * (number % 3)
            first = -1 - first
        p = self.corners[first + number].position
        corner = box.centre + box.x * p.x + box.y * p.y + box.z * p.z
        return BoxVarying(
            clip=self.camera.relative_view_projection @ sl.vec4(corner, 1.0), object_index=object_index
        )


class MarkListedProxies(MarkProxies):
    """Like `MarkProxies`, for the polytopes of listed rows only."""

    object_indices: sl.Storage[sl.uint]

    def object_index(self) -> int:
        return int(self.object_indices[sl.instance_index()])


class ProxyOccludees(Occludees):
    """Boxes and marks of objects, of which those with a polytope are drawn as that.

    Attributes:
        polytopes: the number of meshes that have a polytope.
    """

    mark_shader = MarkProxies
    mark_listed_shader = MarkListedProxies

    def __init__(
        self, device: Device, scene: Scene, planes: int, shader: type[ComputeOccludees] = ComputeOccludees
    ) -> None:
        """`planes` is the number of each polytope's planes, one of `PLANE_COUNTS`."""
        super().__init__(device, len(scene.objects), shader)
        proxies, corners = _make_proxies(scene.meshes, planes)
        self.polytopes = int((proxies["first"] > 0).sum())
        self._proxies = device.storage(Proxy, proxies, label="proxies")
        self._corners = device.storage(ProxyCorner, corners, label="proxies' corners")
        self._first_corners = device.storage(int, max(self.count, 1), label="first corners")
        count = 3 * count_triangles(planes)
        numbers = np.zeros((count, 3), np.float32)
        numbers[:, 0] = np.arange(count)
        self._mesh = device.mesh(
            {"position": numbers}, np.arange(count, dtype=np.uint16), label="numbers of corners"
        )
        self._fit = device.program(FitProxies)

    @property
    def mesh(self) -> Mesh:
        """The numbers of the corners of a polytope."""
        return self._mesh

    def compute_boxes(self, encoder: Encoder, arrays: SceneArrays, **more: sl.StorageRange[Any]) -> None:
        """Find the boxes, set all first marks, and replace boxes by polytopes."""
        super().compute_boxes(encoder, arrays, **more)
        encoder.dispatch(
            self._fit,
            self.groups,
            view=arrays.view,
            culling_camera=self.culling_camera,
            objects=arrays.objects,
            object_positions=arrays.object_positions,
            object_meshes=arrays.object_meshes,
            mesh_parts=arrays.mesh_parts,
            proxies=self._proxies,
            boxes=self.boxes,
            first_corners=self._first_corners,
        )

    def _shape_bindings(self) -> dict[str, Any]:
        return {"first_corners": self._first_corners, "corners": self._corners}

    def count_polytopes(self) -> int:
        """Return the number of boxes that the last `compute_boxes` replaced. Waits for the device."""
        return int((self._first_corners.read() != 0).sum())

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        super().destroy()
        for resource in (self._proxies, self._corners, self._first_corners, self._mesh):
            resource.destroy()


def _make_proxies(meshes: Meshes, planes: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the polytope of each mesh, (m,) of `Proxy`, and the corners of all, of `ProxyCorner`: first those of the
    box, which meshes that change have, or that no plane cuts."""
    count = 3 * count_triangles(planes)
    proxies = np.zeros(len(meshes), Proxy.dtype)
    lists = [list_box_corners()]
    ends = meshes.ranges["base_vertex"].astype(np.int64) + meshes.vertex_counts
    for mesh in np.flatnonzero(~meshes.may_change).tolist():
        points = meshes.vertices["position"][meshes.ranges["base_vertex"][mesh] : ends[mesh]]
        lower, upper = meshes.lower[mesh], meshes.upper[mesh]
        polytope = compute_polytope(points.astype(np.float64), lower, upper, planes)
        if polytope is not None:
            centre = 0.5 * (lower + upper) + 0.5 * (upper - lower) * polytope.centre
            proxies[mesh] = (centre, polytope.reach * _ROUNDED_DOWN, count * len(lists))
            lists.append(polytope.corners)
    corners = np.zeros(count * len(lists), ProxyCorner.dtype)
    for number, triangles in enumerate(lists):
        begin = count * number
        corners["position"][begin : begin + 3 * len(triangles), :3] = triangles.reshape(-1, 3)
    return proxies, corners
