"""The tests by name: one row for each, which benchmarks, the command line and the docs read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from renderer import rules
from renderer.light_kinds.volumes import Cone
from renderer.lights.culling import cone_tests, sphere_tests
from renderer.lights.culling.cells import Cell
from rhi.shading import vec3
from rhi.shading.language.function import ShadingFunction


@dataclass(frozen=True, slots=True)
class SphereTest:
    """A test of a light's sphere against a cell.

    Attributes:
        function: given a cell that isn't empty, the sphere's centre in eye space and its radius.
        is_exact: whether it keeps overlapping pairs only. None ever drops one.
        description: the test in one sentence.
    """

    name: str
    function: ShadingFunction[[Cell, vec3, float], bool]
    is_exact: bool
    description: str


@dataclass(frozen=True, slots=True)
class ConeTest:
    """A test of a spot light's cone against a cell, made where the sphere around the cone overlaps it. It may
    keep pairs that don't overlap, and never drops one that does."""

    name: str
    function: ShadingFunction[[Cell, Cone, float], bool]
    description: str


_SPHERE_TESTS: Final = (
    SphereTest("none", sphere_tests.overlaps_always, False, "keeps every light"),
    SphereTest("planes", sphere_tests.overlaps_planes, False, "drops what is behind one of six planes"),
    SphereTest("faces", sphere_tests.overlaps_faces, False, "separating axes: five face normals"),
    SphereTest("edges", sphere_tests.overlaps_edges, False, "separating axes: from twelve edges"),
    SphereTest("vertices", sphere_tests.overlaps_vertices, False, "separating axes: from eight vertices"),
    SphereTest("faces_edges", sphere_tests.overlaps_faces_edges, False, "separating axes: faces, edges"),
    SphereTest(
        "faces_vertices", sphere_tests.overlaps_faces_vertices, False, "separating axes: faces, vertices"
    ),
    SphereTest(
        "edges_vertices", sphere_tests.overlaps_edges_vertices, False, "separating axes: edges, vertices"
    ),
    SphereTest("all_axes", sphere_tests.overlaps_all_axes, True, "separating axes: all 25"),
    SphereTest(
        "nearest_vertex", sphere_tests.overlaps_nearest_vertex, False, "the axis from the nearest vertex"
    ),
    SphereTest(
        "hybrid", sphere_tests.overlaps_hybrid, False, "planes, then the axis from the nearest vertex"
    ),
    SphereTest("box", sphere_tests.overlaps_box, False, "the distance to the box around the cell"),
    SphereTest("planes_box", sphere_tests.overlaps_planes_box, False, "planes, then the box"),
    SphereTest("exact", sphere_tests.overlaps_exactly, True, "the distance to the cell"),
)
_CONE_TESTS: Final = (
    ConeTest("sphere", cone_tests.cone_overlaps_always, "keeps what the sphere around the cone overlaps"),
    ConeTest("cone_sphere", cone_tests.cone_overlaps_sphere, "the cone against the sphere around the cell"),
    ConeTest("planes", cone_tests.cone_overlaps_planes, "drops what is behind one of six planes"),
    ConeTest(
        "tight", cone_tests.cone_overlaps_tightly, "planes, tangent planes of the cone, the nearest vertex"
    ),
)

SPHERE_TESTS: Final[dict[str, SphereTest]] = {test.name: test for test in _SPHERE_TESTS}
CONE_TESTS: Final[dict[str, ConeTest]] = {test.name: test for test in _CONE_TESTS}


def lookup_sphere_test(name: str, call: str) -> SphereTest:
    """Return a test of spheres by its name."""
    _check(name, SPHERE_TESTS, call)
    return SPHERE_TESTS[name]


def lookup_cone_test(name: str, call: str) -> ConeTest:
    """Return a test of cones by its name."""
    _check(name, CONE_TESTS, call)
    return CONE_TESTS[name]


def _check(name: str, names: Iterable[str], call: str) -> None:
    if name not in names:
        rules.refuse_name(rules.UNKNOWN_LIGHT_TEST, call, name, names)
