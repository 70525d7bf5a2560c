"""Meshlets that the device culls, compared with rays in float64 to all triangles.

Bodies that emit light in colours of their own, stretched, mirrored and partly behind each other, are in a room
that is seen from within. A pixel is wrong if no ray through it or through a neighbour meets a body of its colour: then
a part is missing of what covers it.
"""

from __future__ import annotations

from collections import Counter
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.content.shapes import BUILT_IN, bumpy_sphere
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.lab.exam.scenes import shows_something
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic, Perspective, Projection, Scene, SceneBuilder
from renderer.scene.meshes import MeshGeometry
from renderer.visibility import VisibilitySettings, find_missing_feature, make_visibility
from renderer.visibility.gpu.device_culling import DeviceCulling
from renderer.visibility.gpu.meshlet_culling import TURNED_AWAY, WAS_VISIBLE
from renderer.visibility.gpu.occludees import DRAWN, HIDDEN, OUTSIDE
from rhi import Device
from rhi.math import multiply, rotation, scaling, translation

_SIZE: Final = (160, 90)
_MESHLET_SIZE: Final = 24
_ALGORITHMS: Final = ("two_pass", "depth_pyramid")
_COLORS: Final = tuple(tuple(float(number >> bit & 1) for bit in range(3)) for number in range(1, 7))
_CAUSES: Final = {DRAWN: "drawn", OUTSIDE: "outside", TURNED_AWAY: "turned away", HIDDEN: "hidden"}
_VIEWS: Final[dict[str, tuple[tuple[float, ...], tuple[float, ...], Projection]]] = {
    "along a row": ((-0.6, 0.5, 4.0), (0.0, 0.3, -9.0), Perspective(0.6, 16 / 9, near=0.1)),
    "beside a body": ((1.5, 0.2, 0.6), (-1.0, 0.0, -3.0), Perspective(1.1, 16 / 9, near=0.05)),
    "parallel": ((4.0, 5.0, 5.0), (0.5, 0.0, -5.0), Orthographic(7.0, 16 / 9, 0.1, 60.0)),
}


@cache
def make_room() -> Scene:
    """Make a room of bodies whose meshes are cut."""
    builder = SceneBuilder("meshlets")
    builder.lights.sky = builder.lights.ground = builder.background = (0.0, 0.0, 0.0)
    ball = BUILT_IN["sphere"]()
    walls = MeshGeometry(ball.vertices, ball.indices.reshape(-1, 3)[:, ::-1].reshape(-1))
    meshes = [
        builder.add_mesh(geometry, meshlet_size=_MESHLET_SIZE)
        for geometry in (bumpy_sphere(20, 0.12), BUILT_IN["torus"](), walls)
    ]
    for number, color in enumerate(_COLORS):
        material = builder.add_material(base_color=color, emission=1.0)
        stretch = scaling(np.array([1.0 + 0.1 * number, 0.8 if number % 3 else -0.8, 1.3]))
        turned = multiply(rotation((0.3, 1.0, 0.1), 0.7 * number), stretch)
        at = (1.6 * (number % 2) - 0.8, 0.1 * number, 1.0 - 1.7 * number)
        builder.add_objects(builder.add_node(multiply(translation(at), turned)), meshes[number % 2], material)
    room = builder.add_node(multiply(translation((0.0, 0.0, -4.0)), scaling(np.full(3, 60.0))))
    builder.add_objects(room, meshes[2], builder.add_material(base_color=(1.0, 1.0, 1.0), emission=1.0))
    return builder.build()


def make_view(title: str) -> Camera:
    """Return the camera of a view."""
    eye, target, projection = _VIEWS[title]
    return Camera.look_at(eye, target, projection=projection)


def name_colors(image: NDArray[np.generic]) -> NDArray[np.int64]:
    """Return for each pixel (h, w) the number of its colour, 0 for black: a bit for each channel that is lit."""
    channels = image[..., :3].astype(np.float64)
    numbers: NDArray[np.int64] = (channels > 0.1 * max(float(channels.max()), 1e-9)) @ np.array([1, 2, 4])
    return numbers


@cache  # the same for each device
def trace_room(title: str) -> NDArray[np.int64]:
    """The colours (h, w) that rays to all triangles meet."""
    return name_colors(RayTracer(make_room()).draw(make_view(title), _SIZE))


def flag_wrong(image: NDArray[np.uint8], traced: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Flag the pixels (h, w) whose colour none of the rays (h, w) nearby has met."""
    drawn, expected = name_colors(image), np.pad(traced, 1, mode="edge")
    height, width = drawn.shape
    wrong = np.ones(drawn.shape, bool)
    for y in range(3):
        for x in range(3):
            wrong &= drawn != expected[y : y + height, x : x + width]
    return wrong


def measure_meshlets(device: Device) -> CaseResult:
    """Draw the views with meshlets that the device culls, each after another view and three times, and count wrong
    pixels."""
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error, scene = 0.0, make_room()
    for name in _ALGORITHMS:
        if find_missing_feature(name, device) is not None:
            continue
        algorithm = make_visibility(name, scene, device, VisibilitySettings(meshlets=True))
        assert isinstance(algorithm, DeviceCulling)
        with Renderer(device, scene, size=_SIZE, visibility=algorithm, technique="forward") as renderer:
            for title in _VIEWS:
                part = f"{title}, {name}"
                drawn = [renderer.render(make_view(title)).image.read() for _ in range(3)]
                wrong = [flag_wrong(image, trace_room(title)) for image in drawn]
                error = largest_error(error, float(max(flags.sum() for flags in wrong)))
                counts = _count_states(algorithm)
                numbers |= {f"{part}: {cause}": counts[state] for state, cause in _CAUSES.items()}
                holds[f"{part}: some are culled"] = counts[DRAWN] < sum(counts.values())
                holds |= {f"{part}: {text}": value for text, value in shows_something(drawn).items()}
                images |= {part: drawn[0], f"{part}, wrong": wrong[0].astype(np.float64)}
        algorithm.destroy()
    return CaseResult(error, numbers, holds, lambda: images)


def _count_states(algorithm: DeviceCulling) -> Counter[int]:
    if algorithm.meshlets is None or algorithm.meshlets.states is None:
        return Counter()
    return Counter((algorithm.meshlets.states.read() % WAS_VISIBLE).tolist())


MEASURES: Final[Measures] = {94: measure_meshlets}
