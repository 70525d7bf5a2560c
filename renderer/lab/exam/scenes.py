"""Scenes of boxes, cameras, and frames without culling to compare with: the parts of visibility cases.

`CULLING_SCENARIOS` are scenes and cameras in which a visibility algorithm goes wrong easily. Every algorithm
takes them all, and so does the next one that is registered.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.content import load_scene
from renderer.content.shapes import box, sphere
from renderer.lab.exam.case import check_early
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Orthographic, Perspective, Projection, Scene, SceneBuilder
from renderer.scene.arrays import Floats
from renderer.scene.cloth import ClothSimulation, Gust, Wind, make_cloth_grid
from renderer.visibility import NoCulling, VisibilityAlgorithm, VisibilitySettings, make_visibility
from rhi import Device
from rhi.math import multiply, scaling, translation

SIZE: Final = (97, 55)
ORIGIN: Final = (0.0, 0.0, 0.0)
WALL_POSITION: Final = (0.0, 0.0, -5.0)

Shots = list[tuple[Camera, float]]
"""Cameras and times, frame by frame."""


def make_boxes(
    positions: ArrayLike,
    sizes: ArrayLike,
    motion: Callable[[float], ArrayLike] | None = None,
    moving: Collection[int] = (),
    name: str = "boxes",
    rotations: Floats | None = None,
) -> Scene:
    """Make boxes and spheres in turn, each of a different colour, at `positions` (k, 3) with `sizes` (k, 3).

    `moving` ones go along `motion`: seconds to an offset (3,). `rotations` are rotations (k, 4, 4).
    """
    positions, sizes = (np.asarray(values, float).reshape(-1, 3) for values in (positions, sizes))
    builder = SceneBuilder(name)
    meshes = [builder.add_mesh(box()), builder.add_mesh(sphere(8))]
    stretched = scaling(sizes) if rotations is None else multiply(rotations, scaling(sizes))
    local = multiply(translation(positions), stretched)
    dynamic = np.isin(np.arange(len(positions)), list(moving))
    nodes = builder.add_nodes(local, dynamic=dynamic)
    colors = np.random.default_rng(3).uniform(0.1, 1.0, (len(positions), 4))
    materials = [builder.add_material(base_color=tuple(color)) for color in colors]
    builder.add_objects(nodes, [meshes[row % 2] for row in range(len(positions))], materials)
    if motion is not None:
        rows, where = np.flatnonzero(dynamic), motion

        def move(seconds: float) -> Floats:
            return multiply(translation(positions[rows] + np.asarray(where(seconds))), stretched[rows])

        builder.animate(nodes[rows], move)
    builder.lights.add_directional((-0.4, -1.0, -0.3), (1.0, 1.0, 1.0), 1.5)
    return builder.build()


def make_flag() -> Scene:
    """Make a flag in gusts, and beside it a wall that hides it from (6, 0, 0)."""
    builder = SceneBuilder("flag")
    x, y = np.meshgrid(np.linspace(0.0, 1.3, 9), np.linspace(0.0, -0.9, 7))
    cloth_grid = make_cloth_grid(np.stack([x, y, 0.0 * x], 2), x == 0.0, sub_steps=4)
    mesh = builder.add_mesh(cloth_grid.make_mesh(), "flag", cloth_grid.bounds)
    red = builder.add_material(base_color=(0.8, 0.1, 0.1), double_sided=True)
    flag = builder.add_objects(builder.add_node(translation((0.0, 0.4, -5.0))), mesh, red)
    builder.simulate(
        flag,
        ClothSimulation(1, cloth_grid, Wind((3.0, 0.0, 0.6), (Gust((0.5, 0.0, 2.5), (1.2, 0.2, 0.0), 1.3),))),
    )
    wall = builder.add_node(multiply(translation((4.0, 0.0, -3.0)), scaling((7.9, 14.0, 0.2))))
    builder.add_objects(wall, builder.add_mesh(box()), builder.add_material(base_color=(0.3, 0.4, 0.3)))
    builder.lights.add_directional((-0.4, -1.0, -0.3), (1.0, 1.0, 1.0), 1.5)
    return builder.build()


def make_camera(eye: ArrayLike, aim: ArrayLike, **projection: Any) -> Camera:
    """Create a perspective camera."""
    return Camera.look_at(eye, aim, projection=Perspective(**projection))


def walk(scene: Scene, path: str, frames: Iterable[int]) -> Shots:
    """The cameras and times of these frames of a path."""
    return [(scene.paths[path].camera(frame), frame / 60) for frame in frames]


def draw_with(
    renderer: Renderer, algorithm: VisibilityAlgorithm, camera: Camera, seconds: float = 0.0
) -> FrameResult:
    """Render one frame with this algorithm."""
    renderer.visibility = algorithm
    return renderer.render(camera, seconds)


def shows_something(frames: Iterable[NDArray[np.uint8]]) -> dict[str, bool]:
    """The condition that frames (height, width, 4) show something, unlike those of a device that draws
    nothing or one colour: two colours at least, and more than a two-thousandth of all pixels differ from the
    most frequent one."""
    pixels = np.concatenate([frame.reshape(-1, 4) for frame in frames])
    counts = np.unique(pixels.astype("u1").view("<u4"), return_counts=True)[1]
    is_seen = len(counts) >= 2 and bool(counts.max() < (1.0 - 5e-4) * len(pixels))
    holds = {"frames show something": is_seen}
    check_early(holds)
    return holds


class UnculledFrames:
    """The frames of a scene without culling, drawn once, with which any number of algorithms are compared.

    Its resources on the device last until the end of its `with` statement.

    Attributes:
        frames: one for each camera.
        holds: conditions without which no comparison says anything.
    """

    def __init__(self, device: Device, scene: Scene, shots: Shots, size: tuple[int, int] = SIZE) -> None:
        self.scene, self.shots = scene, shots
        self._renderer = Renderer(device, scene, size=size)
        self._renderer.simulates_hidden = True  # otherwise objects that were culled return in another state
        self.frames = self.draw(NoCulling(scene))
        self.holds = shows_something(self.frames)

    def draw(self, algorithm: VisibilityAlgorithm) -> list[NDArray[np.uint8]]:
        """The frames with a visibility algorithm."""
        return [draw_with(self._renderer, algorithm, *shot).image.read() for shot in self.shots]

    def count_wrong_pixels(self, algorithm: VisibilityAlgorithm) -> list[int]:
        """Count the pixels of each frame that differ."""
        pairs = zip(self.draw(algorithm), self.frames, strict=True)
        return [int((image != expected).any(2).sum()) for image, expected in pairs]

    def try_algorithm(self, name: str, **settings: Any) -> list[int]:
        """Make an algorithm, and count the pixels of each frame that differ with it."""
        algorithm = make_visibility(name, self.scene, self._renderer.device, VisibilitySettings(**settings))
        wrong = self.count_wrong_pixels(algorithm)
        algorithm.destroy()
        return wrong

    def __enter__(self) -> UnculledFrames:
        return self

    def __exit__(self, *_: object) -> None:
        self._renderer.destroy()


def count_wrong_pixels(
    device: Device,
    scene: Scene,
    algorithm: VisibilityAlgorithm,
    shots: Shots,
    size: tuple[int, int] = SIZE,
) -> list[int]:
    """Count the pixels of each frame that differ from no culling."""
    with UnculledFrames(device, scene, shots, size) as uncut:
        return uncut.count_wrong_pixels(algorithm)


def _make_grey_boxes(object_positions: ArrayLike, sizes: ArrayLike) -> Scene:
    scene = make_boxes(object_positions, sizes)
    scene.materials["base_color"] = 0.5
    scene.objects.mesh[:] = 0
    return scene


_TANGENT_RADII: Final = [0.25 * (1.0 + ulps * 2.0**-52) for ulps in (-1, 0, 1)]


def make_views() -> dict[str, tuple[Scene, Camera]]:
    """Make scenes of a few boxes, each with the camera that looks at it."""
    return {
        "camera 1.5 near from a corner, at 60°": (
            make_boxes([(0.0, 0.0, 0.0), (0.0, 0.0, -6.0)], [(2.0, 2.0, 2.0), (1.0, 1.0, 1.0)]),
            make_camera((1.1, 1.1, 1.05), (-2.0, -2.0, -1.0), near=0.1),
        ),
        "camera inside a box": (
            make_boxes([ORIGIN, (0.0, 0.0, -0.5)], [(4.0, 4.0, 4.0), (0.5, 0.5, 0.5)]),
            make_camera((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), near=0.1),
        ),
        "everything visible": (
            make_boxes([(x, y, -9.0) for x in (-2, 0, 2) for y in (-2, 0, 2)], [(0.9, 0.9, 0.9)] * 9),
            make_camera(ORIGIN, WALL_POSITION),
        ),
        "everything hidden but a wall": (
            make_boxes(
                [WALL_POSITION, *((x, y, -9.0) for x in (-1, 0, 1) for y in (-1, 0, 1))],
                [(30.0, 30.0, 0.1)] + [(0.5, 0.5, 0.5)] * 9,
            ),
            make_camera(ORIGIN, WALL_POSITION),
        ),
        "boxes without thickness": (
            make_boxes(
                [WALL_POSITION, (1.0, 0.0, -6.0), (0.0, 3.0, -5.5)],
                [(3.0, 3.0, 0.0), (3.0, 0.0, 3.0), (0.0, 3.0, 3.0)],
            ),
            make_camera(ORIGIN, WALL_POSITION),
        ),
        "one object": (
            make_boxes([WALL_POSITION], [(1.0, 1.0, 1.0)]),
            make_camera(ORIGIN, WALL_POSITION),
        ),
        "corner where w is 0": (
            make_boxes([(2.0, 0.0, 0.0), (0.0, 0.0, -4.0)], [(2.0, 2.0, 0.0), (1.0, 1.0, 1.0)]),
            make_camera(ORIGIN, WALL_POSITION, fov=2.2, near=0.1),
        ),
        "corners where w is negative": (
            make_boxes([(3.0, 0.0, 0.0), (2.5, 0.0, -6.0)], [(2.0, 2.0, 30.0), (3.0, 1.0, 1.0)]),
            make_camera(ORIGIN, WALL_POSITION, fov=2.2, near=0.1),
        ),
        "spheres that touch the near plane, to an ulp": (
            make_boxes(
                [(9.0, 9.0, -9.0)]
                + [(0.5 * (x - 1), 0.0, -0.1 - r) for x, r in enumerate(_TANGENT_RADII)]
                + [(0.0, 0.0, -4.0)],
                [(1.0, 1.0, 1.0)] + [(2.0 * r,) * 3 for r in _TANGENT_RADII] + [(9.0, 9.0, 1.0)],
            ),
            make_camera(ORIGIN, WALL_POSITION, fov=2.0, near=0.1),
        ),
        "slit of a pixel": (
            make_boxes(
                [(-5.03, 0.0, -5.0), (5.03, 0.0, -5.0), (0.0, 0.0, -20.0)],
                [(10.0, 9.0, 1.0), (10.0, 9.0, 1.0), (6.0, 6.0, 6.0)],
            ),
            make_camera(ORIGIN, WALL_POSITION),
        ),
        "two faces in one plane": (
            # Of one colour: where both are, the order of draws decides which one shows.
            _make_grey_boxes([WALL_POSITION, WALL_POSITION], [(1.0, 1.0, 1.0), (4.0, 0.5, 1.0)]),
            make_camera(ORIGIN, WALL_POSITION),
        ),
        "far from the world's origin": (
            make_boxes([(1e6, 0.0, -1e6), (1e6 + 0.3, 0.0, -1e6 - 3.0)], [(1.0, 1.0, 1.0), (1.0, 1.0, 1.0)]),
            make_camera((1e6, 0.0, 5.0 - 1e6), (1e6, 0.0, -1e6)),
        ),
        "a parallel projection whose near plane cuts boxes": (
            make_boxes(
                [(0.0, 0.0, 0.5), (1.0, 0.2, -4.0), (1.0, 0.0, -9.0)],
                [(1.0, 1.0, 2.0), (1.5, 1.5, 1.0), (1.2, 1.2, 1.0)],
            ),
            Camera.look_at(ORIGIN, WALL_POSITION, projection=Orthographic(6.0, near=0.0, far=40.0)),
        ),
    }


def make_projection(
    unit: float, aspect: float, height: float, *, is_parallel: bool, fov: float = Perspective.fov
) -> Projection:
    """The projection of a camera in a world whose metre has `unit` metres: parallel, of a view this many of them
    high, or in perspective."""
    if is_parallel:
        return Orthographic(height * unit, aspect, 0.0, 16.0 * unit)
    return Perspective(fov, aspect, 0.05 * unit)


@dataclass(frozen=True, eq=False)
class CullingScenario:
    """A scene and the cameras that look at it, frame by frame; `number` is that of its case."""

    number: int
    scene: Callable[[], Scene]
    shots: Callable[[Scene], Shots]
    size: tuple[int, int] = SIZE


def make_city() -> Scene:
    """Make a small city. Each case has a scene of its own: threads may run others."""
    return load_scene("city:blocks=8,detail=2")


def along(path: str, *frames: int) -> Callable[[Scene], Shots]:
    """A function that returns the cameras of these frames of a path."""
    return lambda scene: walk(scene, path, frames)


def teleport(scene: Scene) -> Shots:
    """Jump to and fro between two paths."""
    return [
        (scene.paths[path].camera(frame), 0.0)
        for frame in (0, 900, 1799)
        for path in ("ground", "sky", "ground")
    ]


def _stay(title: str) -> Callable[[Scene], Shots]:
    """A function that returns this view, the opposite one, and this one again."""

    def list_shots(_: Scene) -> Shots:
        camera = make_views()[title][1]
        behind = Camera.look_at(
            camera.position, camera.position - camera.forward, projection=camera.projection
        )
        return [(view, 0.0) for view in (camera, camera, behind, camera, camera)]

    return list_shots


def leave(_: Scene) -> Shots:
    """See the flag, go behind the wall, turn away from it and come back, for longer than a frame can catch
    up."""
    seen, hidden = (make_camera((x, 0.0, 0.0), (0.4, 0.0, -5.0)) for x in (-1.0, 6.0))
    away = make_camera((6.0, 0.0, 0.0), (6.0, 0.0, 5.0))
    cameras = [*[seen] * 3, *[hidden] * 12, *[away] * 12, *[seen] * 3]
    return [(camera, 0.5 * number) for number, camera in enumerate(cameras)]


def _fly_past(_: Scene) -> Shots:
    """Move forward past what was in view, so that it is behind the eye in the next frame."""
    return [
        (make_camera((0.0, 0.0, z), (0.0, 0.0, z - 1.0), near=0.1), 0.0)
        for z in (8.0, 6.0, 1.0, -1.5, -6.0, 8.0)
    ]


def _slide(_: Scene) -> Shots:
    """Move sideways a little in each frame, so that hidden objects appear at an edge."""
    return [
        (make_camera((x, 0.0, 0.0), (x, 0.0, -1.0), near=0.1), 0.0)
        for x in np.linspace(-0.4, 0.4, 9).tolist()
    ]


def _make_wall_with_hole() -> Scene:
    object_positions = [
        *((x, 0.0, -5.0) for x in (-5.2, 5.2)),
        *((0.0, y, -6.2) for y in (-5.2, 5.2)),
        (0.1, 0.15, -40.0),
        (9.0, 9.0, -60.0),
    ]
    walls = [(10.0, 20.0, 1.0)] * 2 + [(10.0, 10.0, 1.0)] * 2
    return make_boxes(object_positions, [*walls, (1.0, 1.0, 1.0), (9.0, 9.0, 9.0)])


def _make_subpixel_box() -> Scene:
    return make_boxes(
        [(0.01, 0.01, -30.0), (3.0, 0.0, -40.0), (0.4, 0.0, -8.0)],
        [(0.3, 0.3, 0.3), (0.2, 9.0, 0.2), (0.05, 0.05, 0.05)],
    )


def _make_scene_behind() -> Scene:
    return make_boxes(
        [(0.8, 0.0, 4.0), (-1.0, 0.0, 0.0), (0.5, 0.0, -3.0), (0.0, 0.0, -12.0)],
        [*[(1.0, 1.0, 1.0)] * 3, (8.0, 8.0, 1.0)],
    )


def _make_scenario(number: int, title: str) -> CullingScenario:
    return CullingScenario(number, lambda: make_views()[title][0], _stay(title))


_NUMBERS: Final = {
    "camera 1.5 near from a corner, at 60°": 2,
    "camera inside a box": 3,
    "everything visible": 7,
    "everything hidden but a wall": 7,
    "boxes without thickness": 10,
    "one object": 11,
    "corner where w is 0": 13,
    "corners where w is negative": 13,
    "spheres that touch the near plane, to an ulp": 14,
    "slit of a pixel": 16,
    "two faces in one plane": 21,
    "far from the world's origin": 52,
    "a parallel projection whose near plane cuts boxes": 53,
}

CULLING_SCENARIOS: Final[dict[str, CullingScenario]] = {
    title: _make_scenario(number, title) for title, number in _NUMBERS.items()
} | {
    "teleports": CullingScenario(4, make_city, teleport),
    "1023 by 767 pixels": CullingScenario(15, make_city, along("ground", 600, 606), (1023, 767)),
    "sky through a hole in a wall": CullingScenario(17, _make_wall_with_hole, _slide),
    "box under a pixel": CullingScenario(18, _make_subpixel_box, _slide),
    "objects that were visible are behind the camera": CullingScenario(19, _make_scene_behind, _fly_past),
    "one pixel": CullingScenario(20, make_city, along("ground", 600, 608, 616), (1, 1)),
    "17 by 9 pixels": CullingScenario(20, make_city, along("ground", 600, 608, 616), (17, 9)),
    "flag that comes back": CullingScenario(77, make_flag, leave),
    "130 by 67 pixels": CullingScenario(20, make_city, along("sky", 600, 608, 616), (130, 67)),
}
"""Scenes, cameras and sizes in which culling must not show."""
