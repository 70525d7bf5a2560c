"""Objects that are tested as polytopes in place of boxes, compared with rays in float64 to all triangles.

Bodies that emit light in colours of their own are in a wall, behind pillars, stretched, and every other one mirrored:
balls, cones, rods along the diagonal of their box, and tetrahedra without the middle of theirs. Only a cap of each
sticks out of the wall, so a polytope that is too small, elsewhere or inside out is behind what hides it.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.content.shapes import BUILT_IN, bumpy_sphere
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.lab.exam.meshlet_cases import flag_wrong, name_colors
from renderer.lab.exam.scenes import shows_something
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic, Perspective, Projection, Scene, SceneBuilder
from renderer.scene.meshes import VERTEX, MeshGeometry
from renderer.visibility import VisibilitySettings, find_missing_feature, make_visibility
from renderer.visibility.boxes.polytopes import PLANE_COUNTS
from renderer.visibility.gpu.device_culling import DeviceCulling
from rhi import Device
from rhi.math import multiply, rotation, scaling, translation

_SIZE: Final = (160, 90)
_COLUMNS, _ROWS = 8, 4
_COLORS: Final = tuple(tuple(float(number >> bit & 1) for bit in range(3)) for number in range(1, 7))
_VIEWS: Final[dict[str, tuple[tuple[float, ...], tuple[float, ...], Projection]]] = {
    "from the front": ((0.0, 0.0, 9.0), (0.0, 0.0, 0.0), Perspective(0.8, 16 / 9, near=0.1)),
    "from the side": ((11.0, 2.0, 3.0), (2.0, 0.0, 0.0), Perspective(0.7, 16 / 9, near=0.1)),
    "parallel": ((-4.0, 3.0, 6.0), (0.0, 0.0, 0.0), Orthographic(8.0, 16 / 9, 0.1, 40.0)),
}


@cache
def make_wall() -> Scene:
    """Make a wall with bodies halfway in it, and pillars before it."""
    builder = SceneBuilder("proxies")
    builder.lights.sky = builder.lights.ground = builder.background = (0.0, 0.0, 0.0)
    along_diagonal = multiply(rotation((0.0, 0.0, 1.0), 0.785), rotation((0.0, 1.0, 0.0), 0.615))
    rod = multiply(along_diagonal, scaling(np.array([2.4, 0.5, 0.5])))
    tetrahedron = np.zeros(4, VERTEX)
    tetrahedron["position"][1:] = 1.6 * np.eye(3)
    sides = np.array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3], np.uint32)
    geometries = [
        bumpy_sphere(16, 0.05),
        MeshGeometry(tetrahedron, sides),
        BUILT_IN["cone"](),
        BUILT_IN["box"]().transformed(rod),
        MeshGeometry(tetrahedron, sides),
    ]
    meshes = [builder.add_mesh(geometry) for geometry in geometries]
    box = builder.add_mesh(BUILT_IN["box"]())
    materials = [builder.add_material(base_color=color, emission=1.0) for color in _COLORS]
    for number in range(_COLUMNS * _ROWS):
        column, row = number % _COLUMNS, number // _COLUMNS
        mirrored = -1.0 if (column + row) % 2 else 1.0
        stretch = scaling(np.array([0.7, mirrored * (0.5 + 0.05 * column), 0.6 + 0.1 * row]))
        turned = multiply(rotation((0.2, 1.0, 0.5), 0.9 * number), stretch)
        z = geometries[number % len(meshes)].vertices["position"] @ turned[2, :3]
        sunk = 0.8 * z.max() + 0.2 * z.min()  # a fifth sticks out of the wall
        at = (1.7 * (column - 0.5 * (_COLUMNS - 1)), 1.7 * (row - 0.5 * (_ROWS - 1)), -sunk)
        node = builder.add_node(multiply(translation(at), turned))
        builder.add_objects(node, meshes[number % len(meshes)], materials[number % len(materials)])
    white = builder.add_material(base_color=(1.0, 1.0, 1.0), emission=1.0)
    for at, size in [((0.0, 0.0, -0.5), (18.0, 10.0, 1.0))] + [
        ((x, 0.0, 2.0), (0.7, 10.0, 0.3)) for x in (-4.0, -1.2, 2.1, 4.6)
    ]:
        node = builder.add_node(multiply(translation(at), scaling(np.array(size))))
        builder.add_objects(node, box, white)
    return builder.build()


def make_view(title: str) -> Camera:
    """Return the camera of a view."""
    eye, target, projection = _VIEWS[title]
    return Camera.look_at(eye, target, projection=projection)


@cache  # the same for each device
def trace_wall(title: str) -> NDArray[np.int64]:
    """The colours (h, w) that rays to all triangles meet."""
    return name_colors(RayTracer(make_wall()).draw(make_view(title), _SIZE))


def measure_proxies(device: Device) -> CaseResult:
    """Draw the views with polytopes of each kind, each after another view and three times, and count wrong pixels."""
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error, scene = 0.0, make_wall()
    if find_missing_feature("two_pass", device) is not None:
        return CaseResult(error, numbers, holds, lambda: images)
    for planes in PLANE_COUNTS:
        algorithm = make_visibility("two_pass", scene, device, VisibilitySettings(proxy_planes=planes))
        assert isinstance(algorithm, DeviceCulling)
        with Renderer(device, scene, size=_SIZE, visibility=algorithm, technique="forward") as renderer:
            for title in _VIEWS:
                part = f"{title}, {planes} planes"
                drawn = [renderer.render(make_view(title)).image.read() for _ in range(3)]
                wrong = [flag_wrong(image, trace_wall(title)) for image in drawn]
                error = largest_error(error, float(max(flags.sum() for flags in wrong)))
                numbers[f"{part}: polytopes"] = algorithm.count_polytopes()
                holds[f"{part}: most bodies are tested as polytopes"] = (
                    2 * algorithm.count_polytopes() > _COLUMNS * _ROWS
                )
                holds |= {f"{part}: {text}": value for text, value in shows_something(drawn).items()}
                images |= {part: drawn[0], f"{part}, wrong": wrong[0].astype(np.float64)}
        algorithm.destroy()
    return CaseResult(error, numbers, holds, lambda: images)


MEASURES: Final[Measures] = {95: measure_proxies}
