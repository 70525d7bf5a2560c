"""The vertices of particles on the device: a copy of a mesh for each particle, turned, scaled and moved."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.scene.arrays import Indices
from renderer.scene.deformation.deformation_kernels import LANES, MAX_GROUPS, RestVertex, VertexWriter
from renderer.scene.meshes import MeshGeometry
from rhi import Device, StorageBuffer


class PosedParticle(sl.Struct):
    """A particle in the space of its object: where the mesh's origin is, how many times as large the mesh is, and the
    unit quaternion (x, y, z, w) that turns it."""

    centre: sl.vec3
    size: float
    rotation: sl.vec4


class ParticleLayout(sl.Struct):
    """The vertices of a copy and of a member, the work-groups of a member, the floats from a drawn vertex to the next,
    and from its begin to its tangent: negative without one."""

    copy_vertices: int
    member_vertices: int
    member_groups: int
    stride: int
    tangent: int


class WriteCopies(VertexWriter):
    """Writes positions, normals and tangents of all copies of the members that are due, a lane for each vertex."""

    work_group = (LANES,)
    layout: sl.Uniform[ParticleLayout]
    rest: sl.Storage[RestVertex]
    poses: sl.Storage[PosedParticle]
    begins: sl.Storage[int]

    def compute(self) -> None:
        group = int(sl.group_id().x)
        member = group // self.layout.member_groups
        number = (group - member * self.layout.member_groups) * LANES + int(sl.local_index())
        if number < self.layout.member_vertices:
            copy = number // self.layout.copy_vertices
            at = number - copy * self.layout.copy_vertices
            copies = self.layout.member_vertices // self.layout.copy_vertices
            particle = self.poses[member * copies + copy]
            begin = self.begins[member] + number * self.layout.stride
            turned = self.turn(particle.rotation, self.rest[at].position)
            self.write(begin, particle.centre + turned * particle.size)
            self.write(begin + 3, self.turn(particle.rotation, self.rest[at].normal))
            if self.layout.tangent >= 0:
                along = begin + self.layout.tangent
                self.write(along, self.turn(particle.rotation, self.rest[at].tangent))
                self.vertices[along + 3] = self.rest[at].sign

    def turn(self, rotation: sl.vec4, vector: sl.vec3) -> sl.vec3:
        """Return a vector turned by a unit quaternion."""
        return vector + 2.0 * sl.cross(rotation.xyz, sl.cross(rotation.xyz, vector) + rotation.w * vector)


class ParticleBuffers:
    """The mesh of particles on a device."""

    def __init__(self, device: Device, geometry: MeshGeometry) -> None:
        """Upload a mesh with tangents."""
        self.device = device
        self._copy_vertices = len(geometry.vertices)
        rest: Any = np.zeros(len(geometry.vertices), RestVertex.dtype)
        rest["position"], rest["normal"] = geometry.vertices["position"], geometry.vertices["normal"]
        rest["tangent"], rest["sign"] = (
            geometry.vertices["tangent"][:, :3],
            geometry.vertices["tangent"][:, 3],
        )
        self._rest = device.storage(RestVertex, rest, label="mesh of particles")

    def run(
        self,
        particles: NDArray[Any],
        vertices: StorageBuffer[float],
        first_vertices: Indices,
        stride: int,
        tangent: int,
    ) -> None:
        """Write the vertices of members.

        Args:
            particles: (j, p) of `PosedParticle`, those of each member.
            vertices: what is drawn.
            first_vertices: (j,), the number of each member's first vertex in it.
            stride: floats from vertex to vertex.
            tangent: floats from the begin of a vertex to its tangent; negative if vertices have none.
        """
        member_vertices = particles.shape[1] * self._copy_vertices
        groups = -(-member_vertices // LANES)
        layout = ParticleLayout(
            copy_vertices=self._copy_vertices,
            member_vertices=member_vertices,
            member_groups=groups,
            stride=stride,
            tangent=tangent,
        )
        device, members = self.device, MAX_GROUPS // groups
        for first in range(0, len(particles), members):
            part = slice(first, first + members)
            begins = (stride * first_vertices[part]).astype(np.int32)
            device.dispatch(
                device.program(WriteCopies),
                groups * len(begins),
                layout=layout,
                rest=self._rest,
                poses=device.transient.storage(PosedParticle, particles[part].reshape(-1)),
                begins=device.transient.storage(int, begins),
                vertices=vertices,
            )

    def destroy(self) -> None:
        """Destroy the buffer."""
        self._rest.destroy()
