"""Scenes of extreme sizes, normals and scales look as float64 says, or are refused."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from frames import open_renderer
from lighting_reference import encode
from nightly_reasons import FEWER_CASES
from numpy.typing import NDArray
from tested_devices import open_device

import rhi
from renderer.scene import (
    VERTEX,
    Camera,
    MeshGeometry,
    Orthographic,
    Perspective,
    Scene,
    SceneBuilder,
    scaling,
)
from renderer.techniques import TECHNIQUES

SIZE = 12
VIEW = 4.0
"""The height of the view, in sizes of the world."""
EXACT = [name for name in TECHNIQUES if name != "inferred"]
"""The techniques that light each pixel: `inferred` interpolates light."""
NORMAL_LENGTHS = (1e-40, 1e-30, 1e-20, 1e-10, 1e-3, 1.0, 1e3, 1e10, 1e20, 1e38)
WORLDS = (1e-9, 1e-3, 1.0, 1e6, 0.99e9, 1e10, 1e12, 1e15)


@pytest.fixture(scope="module", params=["gl", "cl", "wgpu"])
def any_device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    with open_device(request.param) as device:
        yield device


def make_square(size: float = 4.0, normal: float = 1.0) -> MeshGeometry:
    """Return a square that faces z, with normals of any length."""
    vertices = np.zeros(4, VERTEX)
    vertices["position"] = np.array(((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0))) * size
    vertices["normal"] = (0, 0, normal)
    return MeshGeometry(vertices, np.array((0, 1, 2, 0, 2, 3), np.uint32))


def make_scene(mesh: MeshGeometry, scale: float, world: float = 1.0) -> Scene:
    """Return a scene of one mesh, lit by a point light that is a size of the world in front of it."""
    builder = SceneBuilder("extreme")
    grey = builder.add_material(base_color=(0.5, 0.5, 0.5), specular_color=(0, 0, 0))
    builder.add_objects(builder.add_node(scaling((scale,) * 3)), builder.add_mesh(mesh), grey)
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
    builder.lights.add_point((0, 0, world), 5.0 * world, intensity=world * world)
    return builder.build()


def draw(device: rhi.Device, scene: Scene, technique: str, camera: Camera) -> NDArray[np.float64]:
    with open_renderer(device, scene, TECHNIQUES[technique](), size=(SIZE, SIZE)) as renderer:
        return np.asarray(renderer.render(camera).image.read()[..., :3], np.float64)


def look(world: float = 1.0) -> Camera:
    view = Orthographic(height=VIEW * world, aspect=1.0, near=0.1 * world, far=20.0 * world)
    return Camera.look_at((0, 0, 5 * world), (0, 0, 0), (0, 1, 0), view)


def expected_levels() -> NDArray[np.float64]:
    """Return the levels (h, w, 1) of the square, in float64 and in sizes of the world."""
    at = ((np.arange(SIZE) + 0.5) / SIZE - 0.5) * VIEW
    square = 1.0 + at[:, None] ** 2 + at**2
    light = 0.5 * (1.0 - (square / 25.0) ** 2) ** 2 / square**1.5
    x = 0.6 * light
    return encode(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14))[..., None]


def largest_error(image: NDArray[Any]) -> float:
    return float(np.abs(image - expected_levels()).max())


@pytest.mark.nightly_cases("wgpu-*", reason=FEWER_CASES)
@pytest.mark.parametrize("technique", ["forward", "clustered"])
def test_normals_of_any_length_are_directions(any_device: rhi.Device, technique: str) -> None:
    wrong = {
        length: largest_error(
            draw(any_device, make_scene(make_square(normal=length), 1.0), technique, look())
        )
        for length in NORMAL_LENGTHS
    }
    assert max(wrong.values()) <= 1.0, wrong


def test_normals_of_usual_lengths_stay_as_they_are() -> None:
    """Control: only what float32 can't square is changed, and what has no direction."""
    for length in (0.01, 1.0, 3.0):
        scene = make_scene(make_square(normal=length), 1.0)
        assert (scene.meshes.vertices["normal"] == np.array((0, 0, length), np.float32)).all()


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=FEWER_CASES)
@pytest.mark.parametrize("technique", EXACT)
def test_missing_normals_are_those_of_triangles(any_device: rhi.Device, technique: str) -> None:
    """With each technique: a vector of length 0 was black with some, and towards z with others."""
    bent = make_square()
    bent.vertices["normal"][1:3] = 0.0
    for mesh in (make_square(normal=0.0), bent):
        assert largest_error(draw(any_device, make_scene(mesh, 1.0), technique, look())) <= 1.0


def test_missing_normals_of_a_cube_face_outwards() -> None:
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6)]
    faces += [(0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    vertices = np.zeros(8, VERTEX)
    vertices["position"] = corners
    builder = SceneBuilder("cube")
    mesh = builder.add_mesh(MeshGeometry(vertices, np.array(faces, np.uint32).reshape(-1)))
    builder.add_objects(builder.add_node(), mesh, builder.add_material())
    normals = builder.build().meshes.vertices["normal"]
    assert (normals * corners > 0.0).all()
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert not vertices["normal"].any(), "the user's array stays as it was"


RANGES = (10.0, 1e6, 1e9, 1e12, 1e18, 1e20, 1e30, 3e38)
ANGLES = (0.0, 0.01, 0.5, 1.0, 3.0)
"""Outer half angles of spot lights; 0 is a point light."""


def make_far_light(reach: float, angle: float) -> Scene:
    """Return a square in front of a light of this range."""
    builder = SceneBuilder("far light")
    grey = builder.add_material(base_color=(0.5, 0.5, 0.5), specular_color=(0, 0, 0))
    builder.add_objects(builder.add_node(), builder.add_mesh(make_square()), grey)
    builder.lights.sky = builder.lights.ground = (0.02, 0.02, 0.02)
    if angle:
        builder.lights.add_spot((0.2, 0, 1.0), (0.1, 0.2, -1), reach, 0.5 * angle, angle, intensity=2.0)
    else:
        builder.lights.add_point((0.2, 0, 1.0), reach, intensity=2.0)
    return builder.build()


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=FEWER_CASES)
@pytest.mark.parametrize("technique", ["deferred", "light_pre_pass", "clustered", "tiled_deferred"])
def test_lights_of_any_range_light_alike(any_device: rhi.Device, technique: str) -> None:
    """Volumes of lights are no larger than the view, or than float32 projects: parallel ones had lost pixels of
    cones of 10⁹ m, and perspective ones all of lights of 10³⁷ m."""
    perspective = Camera.look_at((0.3, 0.2, 3.0), (0, 0, 0), (0, 1, 0), Perspective(0.8, 1.0, 0.1))
    behind = Camera.look_at((0.5, 0.3, 1), (0, 0, 0), (0, 1, 0), Orthographic(VIEW, 1.0, -50.0, 50.0))
    for camera in (look(), perspective, behind):
        for angle in ANGLES:
            for reach in RANGES[1::2]:
                scene = make_far_light(reach, angle)
                forward, image = (draw(any_device, scene, name, camera) for name in ("forward", technique))
                assert np.abs(forward - image).max() <= 2.0, (angle, reach)
            assert np.ptp(forward) > 20.0 or angle == ANGLES[1], "control: the light shows"


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=FEWER_CASES)
@pytest.mark.parametrize("technique", EXACT)
def test_worlds_of_any_size_are_lit_alike(any_device: rhi.Device, technique: str) -> None:
    wrong = {
        size: largest_error(draw(any_device, make_scene(make_square(), size, size), technique, look(size)))
        for size in WORLDS
    }
    assert max(wrong.values()) <= 1.0, wrong


def test_clusters_of_other_backends_hold_large_worlds(any_device: rhi.Device) -> None:
    image = draw(any_device, make_scene(make_square(), 1e12, 1e12), "clustered", look(1e12))
    assert largest_error(image) <= 1.0


@pytest.mark.nightly_cases("cl", "wgpu", reason=FEWER_CASES)
def test_a_view_without_end_holds_large_worlds(any_device: rhi.Device) -> None:
    scene = make_scene(make_square(), 1e12, 1e12)
    camera = Camera.look_at((0, 0, 5e12), (0, 0, 0), (0, 1, 0), Perspective(0.6, 1.0, near=0.1))
    images = [
        draw(any_device, scene, technique, camera) for technique in ("forward", "clustered", "forward_plus")
    ]
    assert images[0].max() > 100
    assert np.abs(images[0] - images[1]).max() <= 1.0
    assert np.abs(images[0] - images[2]).max() <= 1.0


@pytest.mark.parametrize("technique", ["forward", "deferred"])
def test_tiny_meshes_at_huge_scales_are_as_others(any_device: rhi.Device, technique: str) -> None:
    for size in (1e-30, 1e-20, 1e-10, 1e10, 1e20, 1e37):
        mesh = make_square(4.0 * size)
        wrong = largest_error(
            draw(any_device, make_scene(mesh, 1.0 / float(np.float32(size))), technique, look())
        )
        assert wrong <= 1.0, (size, wrong)


@pytest.mark.parametrize("scale", [1.1e30, 1e38, 1e39, 1e150, -1e31])
def test_a_scale_that_single_floats_lose_is_refused(scale: float) -> None:
    with pytest.raises(rhi.ValidationError, match="scene-bad-transform"):
        make_scene(make_square(1.0 / abs(scale)), scale)
    make_scene(make_square(), np.copysign(1e30, scale))  # control


def test_scales_that_multiply_to_too_much_are_refused() -> None:
    for scale, is_refused in ((1e16, True), (1e14, False)):
        builder = SceneBuilder("product")
        upper = builder.add_node(scaling((scale,) * 3))
        lower = builder.add_node(scaling((scale,) * 3), upper)
        builder.add_objects(lower, builder.add_mesh(make_square()), builder.add_material())
        if is_refused:
            with pytest.raises(rhi.ValidationError, match="scene-bad-transform"):
                builder.build()
        else:
            builder.build()
