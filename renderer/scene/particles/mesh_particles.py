"""Particles as copies of a mesh: the base of simulations that say where the copies are.

All copies of a member are one mesh, whose vertices are written where it is drawn. Copies may turn their front (+z) to
the eye, and those of blended materials are put in order, the farthest first. Both follow from the eye's position alone,
so a head that turns changes no vertex, and both eyes of a pair see the same ones.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import copy, deepcopy
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.scene.arrays import Floats, Indices
from renderer.scene.catch_up import CatchUp
from renderer.scene.deformation.deformation_kernels import LANES, MAX_GROUPS
from renderer.scene.meshes import MeshGeometry, make_geometry
from renderer.scene.particles.particle_kernels import ParticleBuffers, PosedParticle
from renderer.scene.tangents import add_tangents
from rhi import Device, StorageBuffer
from rhi.errors import refuse

_NO_EYE: Final = (0.0, 0.0, 1.0, 0.0)
"""Of members that no eye has seen: from far along +z."""
_UNCOPIED: Final = ("geometry", "_buffers")


class ParticlePoses(NamedTuple):
    """The particles of members, in the spaces of their objects.

    Attributes:
        position: (j, p, 3) in metres, where the origin of the mesh is.
        size: (j, p), how many times as large the mesh is; 0 where there is no particle.
        rotation: (j, p, 4), unit quaternions (x, y, z, w) that turn the mesh, before it faces the eye.
    """

    position: Floats
    size: Floats
    rotation: Floats


def make_quad(width: float = 1.0, height: float = 1.0) -> MeshGeometry:
    """Make a rectangle around the origin whose front is +z, for leaves, smoke and sparks."""
    x, y = 0.5 * width, 0.5 * height
    corners = [(-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)]
    uv = [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)]
    return make_geometry(corners, [0, 1, 2, 0, 2, 3], np.tile((0.0, 0.0, 1.0), (4, 1)), uv)


class MeshParticles(ABC):
    """The base of simulations of `count` members with `copies` particles each, the copies of a mesh.

    A subclass has `catch_up`, the methods of that policy, and `pose`. Nodes of its objects should be scaled evenly.

    Attributes:
        geometry: the mesh of a particle, with tangents.
        copies: the number of particles of a member.
        faces_eye: whether copies turn their front to the eye.
        is_flat: whether the mesh lies in a plane.
    """

    catch_up: CatchUp

    def __init__(self, count: int, copies: int, geometry: MeshGeometry, *, faces_eye: bool = False) -> None:
        """Begin with members that no eye has seen.

        Raises:
            ValidationError `scene-bad-particles`: no member or no particle, or more vertices than a dispatch writes.
        """
        call = type(self).__name__
        rules.check_count(rules.BAD_PARTICLES, f"{call}(count=...)", count, 1)
        rules.check_count(rules.BAD_PARTICLES, f"{call}(copies=...)", copies, 1)
        if "tangent" not in geometry.attributes:
            geometry = add_tangents(geometry, splits=False)
        most = LANES * MAX_GROUPS // len(geometry.vertices)
        if copies > most:
            allowed = f"at most {most:,} copies of {len(geometry.vertices)} vertices"
            refuse(rules.BAD_PARTICLES, f"{call}(copies=...)", copies, allowed)
        self.geometry = geometry
        self.copies = copies
        self.faces_eye = faces_eye
        points = geometry.vertices["position"].astype(np.float64)
        self.is_flat = bool(np.linalg.matrix_rank(points - points[0], tol=1e-6 * np.abs(points).max()) <= 2)
        self._eyes: Floats = np.tile(_NO_EYE, (count, 1))
        self._is_sorted: NDArray[np.bool_] = np.zeros(count, bool)
        self._buffers: ParticleBuffers | None = None

    def __len__(self) -> int:
        return len(self._eyes)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return a copy with a state of its own, and nothing on a device."""
        duplicate = copy(self)
        for name, value in vars(self).items():
            if name not in _UNCOPIED:
                setattr(duplicate, name, deepcopy(value, memo))
        duplicate._buffers = None
        return duplicate

    @abstractmethod
    def pose(self, members: Indices) -> ParticlePoses:
        """Return the present particles of `members` (j,)."""

    def make_mesh(self, member: int = 0) -> MeshGeometry:
        """Make the mesh of all particles of a member as they are now, for `SceneBuilder.add_mesh`, with bounds."""
        firsts = np.arange(self.copies, dtype=np.uint32)[:, None] * np.uint32(len(self.geometry.vertices))
        return MeshGeometry(
            self.vertices(np.array([member])), (firsts + self.geometry.indices[None]).reshape(-1)
        )

    def look_from(self, members: Indices, eyes: Floats, is_sorted: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Take the eye's position for `members` (j,); return which of them (j,) it may change.

        Args:
            eyes: (j, 4), the position in the space of each object and 1, or the direction to the eye and 0.
            is_sorted: (j,), whether particles are put in order, the farthest first.
        """
        depends = is_sorted | self.faces_eye
        changed: NDArray[np.bool_] = depends & (self._eyes[members] != eyes).any(axis=1)
        changed |= self._is_sorted[members] != is_sorted
        self._eyes[members], self._is_sorted[members] = eyes, is_sorted
        return changed

    def vertices(self, members: Indices) -> NDArray[Any]:
        """Return the present vertices of `members` (j,), one after another."""
        posed = self._pose_for_eye(members)
        rest = self.geometry.vertices
        vertices = np.zeros((*posed.size.shape, len(rest)), rest.dtype)
        vertices[...] = rest
        rotation = posed.rotation[:, :, None]
        turned = _turn(rotation, rest["position"].astype(np.float64))
        vertices["position"] = posed.position[:, :, None] + turned * posed.size[:, :, None, None]
        vertices["normal"] = _turn(rotation, rest["normal"].astype(np.float64))
        vertices["tangent"][..., :3] = _turn(rotation, rest["tangent"][:, :3].astype(np.float64))
        return vertices.reshape(-1)

    def deform(
        self,
        device: Device,
        members: Indices,
        vertices: StorageBuffer[float],
        first_vertices: Indices,
        stride: int,
        tangent: int = -1,
    ) -> None:
        """Write the present vertices of `members` (j,) on a device."""
        if self._buffers is None or self._buffers.device is not device:
            if self._buffers is not None:
                self._buffers.destroy()
            self._buffers = ParticleBuffers(device, self.geometry)
        posed = self._pose_for_eye(members)
        packed: Any = np.zeros(posed.size.shape, PosedParticle.dtype)
        packed["centre"], packed["size"], packed["rotation"] = posed
        self._buffers.run(packed, vertices, first_vertices, stride, tangent)

    def release(self, device: Device) -> None:
        """Destroy the mesh on a device."""
        if self._buffers is not None and self._buffers.device is device:
            self._buffers.destroy()
            self._buffers = None

    def _pose_for_eye(self, members: Indices) -> ParticlePoses:
        """Return the particles of `members` (j,), in order and with their fronts to the eye where they should be."""
        posed, eyes = self.pose(members), self._eyes[members]
        away = eyes[:, None, :3] - posed.position * eyes[:, None, 3:]
        if self._is_sorted[members].any():
            far = np.where(
                eyes[:, None, 3] > 0.0, (away**2).sum(axis=2), -(posed.position * away).sum(axis=2)
            )
            order = np.argsort(-far, axis=1, kind="stable")
            order = np.where(self._is_sorted[members][:, None], order, np.arange(order.shape[1]))
            rows = np.arange(len(order))[:, None]
            posed, away = ParticlePoses(*(values[rows, order] for values in posed)), away[rows, order]
        if not self.faces_eye:
            return posed
        return posed._replace(rotation=_multiply(_face(away), posed.rotation))


def _turn(rotation: Floats, vector: Floats) -> Floats:
    """Return vectors (…, 3) turned by unit quaternions (…, 4)."""
    axis, cosine = rotation[..., :3], rotation[..., 3:]
    return np.asarray(vector + 2.0 * np.cross(axis, np.cross(axis, vector) + cosine * vector))


def _multiply(left: Floats, right: Floats) -> Floats:
    """Return the quaternions (…, 4) that turn by `right`, and then by `left`."""
    a, b, c, d = left[..., :3], right[..., :3], left[..., 3:], right[..., 3:]
    return np.concatenate([c * b + d * a + np.cross(a, b), c * d - (a * b).sum(-1, keepdims=True)], axis=-1)


def _face(away: Floats) -> Floats:
    """Return the quaternions (…, 4) that turn +z along `away` (…, 3): around x, and then around y."""
    x, y, z = np.moveaxis(away, -1, 0)
    yaw, pitch = 0.5 * np.arctan2(x, z), -0.5 * np.arctan2(y, np.hypot(x, z))
    zero = np.zeros_like(yaw)
    around_y = np.stack([zero, np.sin(yaw), zero, np.cos(yaw)], axis=-1)
    around_x = np.stack([np.sin(pitch), zero, zero, np.cos(pitch)], axis=-1)
    return _multiply(around_y, around_x)
