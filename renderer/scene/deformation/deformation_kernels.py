"""Vertices of skins and morph targets on the device: a work-group for 64 vertices of a member.

All vertices of a group have the same active targets and the same table of joints, so its lanes run through
the same loops. Positions are relative to the middle of the mesh, and matrices move from there: rounding then
is that of the mesh's size, wherever it was bound. Matrices are scaled by their largest element before
cofactors are formed, so that tiny and huge joints have directions too.
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl
from renderer.scene.deformation.deformable_mesh import MIRROR_TOLERANCE

LANES: Final = 64
MAX_GROUPS: Final = 65_535
"""The most work-groups of a dispatch."""
_SHORTEST: Final = 1e-20
_FLOATS: Final = 3  # of an offset's position, and of its normal and tangent


class RestVertex(sl.Struct):
    """A vertex before targets and joints move it; `sign` is the tangent's fourth component."""

    position: sl.vec3
    sign: float
    normal: sl.vec3
    tangent: sl.vec3


class Influence(sl.Struct):
    """A joint of a vertex, and its weight. Those of a vertex follow each other, the largest first."""

    joint: int
    weight: float


class ActiveTarget(sl.Struct):
    """A target with a weight that isn't 0, and the first float of its offsets."""

    first: int
    weight: float


class DeformedMember(sl.Struct):
    """A member that is due.

    Attributes:
        rest, count: its first vertex at rest, and their number.
        influence: its first influence, negative without a skin.
        influence_stride: the most influences of a vertex.
        matrix: the first row of its first joint's matrix.
        targets_begin, targets_end: its active targets.
        offset_stride: the floats of an offset: those of position and normal, with those of a tangent if
            its vertices have one.
        mirrors: 1 if any of its joints mirrors.
        vertex: the first float of its vertices where they are drawn.
    """

    rest: int
    count: int
    influence: int
    influence_stride: int
    matrix: int
    targets_begin: int
    targets_end: int
    offset_stride: int
    mirrors: int
    vertex: int


class DeformationGroup(sl.Struct):
    """The work of a group: a member's vertices from `first` on, which have `influences` joints at most."""

    member: int
    first: int
    influences: int


class DeformationLayout(sl.Struct):
    """The floats from a drawn vertex to the next, and from its begin to its tangent: negative without one."""

    stride: int
    tangent: int


class VertexWriter(sl.Shader):
    """Base of shaders that write vertices which are drawn."""

    vertices: sl.StorageRW[float]

    def write(self, at: int, value: sl.vec3) -> None:
        """Write three floats of a vertex."""
        self.vertices[at] = value.x
        self.vertices[at + 1] = value.y
        self.vertices[at + 2] = value.z


class DeformVertices(VertexWriter):
    """Writes positions, normals and tangents of the members that are due."""

    work_group = (LANES,)
    layout: sl.Uniform[DeformationLayout]
    rest: sl.Storage[RestVertex]
    influences: sl.Storage[Influence]
    offsets: sl.Storage[float]
    targets: sl.Storage[ActiveTarget]
    matrices: sl.Storage[sl.vec4]
    members: sl.Storage[DeformedMember]
    groups: sl.Storage[DeformationGroup]

    def compute(self) -> None:
        group = self.groups[sl.group_id().x]
        member = self.members[group.member]
        number = group.first + int(sl.local_index())
        if number < member.count:
            at = member.rest + number
            has_tangent = member.offset_stride > 2 * _FLOATS
            position = self.rest[at].position
            rest_normal = self.rest[at].normal
            normal = rest_normal
            tangent = sl.vec3(0.0)
            sign = 1.0
            if has_tangent:
                tangent = self.rest[at].tangent
                sign = self.rest[at].sign
            for target in range(member.targets_begin, member.targets_end):
                weight = self.targets[target].weight
                offset = self.targets[target].first + number * member.offset_stride
                position += self.offset_at(offset) * weight
                normal += self.offset_at(offset + _FLOATS) * weight
                if has_tangent:
                    tangent += self.offset_at(offset + 2 * _FLOATS) * weight
            if member.targets_end > member.targets_begin:
                normal = self.unit(normal, rest_normal)
            if member.influence >= 0:
                first = sl.vec4(0.0)
                second = sl.vec4(0.0)
                third = sl.vec4(0.0)
                begin = member.influence + number * member.influence_stride
                for influence in range(begin, begin + group.influences):
                    share = self.influences[influence].weight
                    row = member.matrix + 3 * self.influences[influence].joint
                    first += self.matrices[row] * share
                    second += self.matrices[row + 1] * share
                    third += self.matrices[row + 2] * share
                point = sl.vec4(position, 1.0)
                position = sl.vec3(sl.dot(first, point), sl.dot(second, point), sl.dot(third, point))
                size = sl.max(
                    self.largest(first.xyz), sl.max(self.largest(second.xyz), self.largest(third.xyz))
                )
                inverse = 1.0 / size if size > _SHORTEST else 0.0
                a = sl.vec3(first.x, second.x, third.x) * inverse
                b = sl.vec3(first.y, second.y, third.y) * inverse
                c = sl.vec3(first.z, second.z, third.z) * inverse
                normal = self.unit(self.turn(normal, a, b, c), normal)
                if has_tangent:
                    along = a * tangent.x + b * tangent.y + c * tangent.z
                    tangent = along if self.largest(along) > 0.0 else self.rest[at].tangent
                    if member.mirrors == 1 and sl.dot(a, sl.cross(b, c)) < 0.0:
                        sign = -sign
            begin = member.vertex + number * self.layout.stride
            self.write(begin, position)
            self.write(begin + _FLOATS, normal)
            if has_tangent and self.layout.tangent >= 0:
                self.write(begin + self.layout.tangent, self.unit(tangent, sl.vec3(1.0, 0.0, 0.0)))
                self.vertices[begin + self.layout.tangent + _FLOATS] = sign

    def turn(self, normal: sl.vec3, a: sl.vec3, b: sl.vec3, c: sl.vec3) -> sl.vec3:
        """Return a normal turned by the cofactors of the matrix with the columns a, b and c."""
        across = sl.cross(b, c)
        turned = across * normal.x + sl.cross(c, a) * normal.y + sl.cross(a, b) * normal.z
        spread = sl.abs(b).yzx * sl.abs(c).zxy + sl.abs(b).zxy * sl.abs(c).yzx
        is_mirrored = sl.dot(a, across) < -MIRROR_TOLERANCE * sl.dot(sl.abs(a), spread)
        return -turned if is_mirrored else turned

    def offset_at(self, at: int) -> sl.vec3:
        """Return three floats of an offset."""
        return sl.vec3(self.offsets[at], self.offsets[at + 1], self.offsets[at + 2])

    def largest(self, vector: sl.vec3) -> float:
        """Return the largest size of a component."""
        size = sl.abs(vector)
        return sl.max(size.x, sl.max(size.y, size.z))

    def unit(self, vector: sl.vec3, otherwise: sl.vec3) -> sl.vec3:
        """Return a vector with length 1, that of `otherwise` if it has no direction; or upwards."""
        size = self.largest(vector)
        other_size = self.largest(otherwise)
        result = sl.vec3(0.0, 1.0, 0.0)
        if size > _SHORTEST:
            result = sl.normalize(vector / size)
        elif other_size > _SHORTEST:
            result = sl.normalize(otherwise / other_size)
        return result
