"""The pixels of the forward technique, compared with float64 and with each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frames import SIZE, draw
from lighting_reference import shade_plane
from numpy.typing import NDArray

import rhi
from renderer.content import load_scene
from renderer.frame import resources
from renderer.renderer import Renderer
from renderer.scene import Camera, Depth, Perspective, SceneBuilder, make_geometry, scaling, translation

PROJECTION = Perspective(fov=0.9, aspect=SIZE[0] / SIZE[1])
MIDDLE = np.array([10_000_000.3, 20.2, -30_000_000.3])
"""Far from the origin, where a step of float32 is a metre and more."""

SLOPE = make_geometry(
    [(-1, 1, -1), (1, -1, -1), (1, -1, 1), (-1, 1, 1)],
    [(0, 2, 1), (0, 3, 2)],
    np.full((4, 3), (0.5**0.5, 0.5**0.5, 0.0)),
    [(0, 0), (1, 0), (1, 1), (0, 1)],
)
STRETCH = np.array([30.0, 10.0, 20.0])
NORMAL = np.array([1.0, 3.0, 0.0]) / 10**0.5
"""Of the slope stretched: across, not along."""


def slope(*, texture: NDArray[np.uint8] | None = None, mirror: bool = False, **material: Any) -> SceneBuilder:
    """Make one tilted plane that fills the image, scaled differently along each axis."""
    builder = SceneBuilder("slope")
    image = -1 if texture is None else builder.add_image(texture)
    material_index = builder.add_material(texture=image, **{"base_color": (0.7, 0.5, 0.3), **material})
    stretch = STRETCH * (1, 1, -1) if mirror else STRETCH
    node = builder.add_node(translation(MIDDLE) @ scaling(stretch))
    builder.add_objects(node, builder.add_mesh(SLOPE), material_index)
    builder.views["eye"] = Camera.look_at(MIDDLE + np.array([3.4, 4.0, 1.0]), MIDDLE, projection=PROJECTION)
    return builder


def add_sun(builder: SceneBuilder) -> None:
    builder.lights.add_directional((-0.3, -0.9, 0.2), (1.0, 0.9, 0.8), 1.4)


def add_light(builder: SceneBuilder) -> None:
    builder.lights.add_point(MIDDLE + np.array([1.0, 2.0, -0.5]), 4.5, (0.5, 0.8, 1.0), 3.0)


def add_spot(builder: SceneBuilder) -> None:
    builder.lights.add_spot(
        MIDDLE + np.array([0.5, 2.5, 0.5]), (0.1, -1.0, -0.2), 9.0, 0.2, 0.7, (1.0, 0.6, 0.4), 9.0
    )


def add_haze(builder: SceneBuilder) -> None:
    builder.haze, builder.background = 0.08, (0.3, 0.5, 0.7)


@pytest.mark.parametrize(
    "parts",
    [
        (),
        (add_sun,),
        (add_light,),
        (add_spot,),
        (add_haze,),
        (add_sun, add_sun, add_light, add_spot, add_haze),
    ],
    ids=["ambient", "sun", "point", "spot", "haze", "all"],
)
def test_a_lit_plane_is_within_one_level_of_a_float64_evaluation(gl: rhi.Device, parts: Any) -> None:
    builder = slope(
        specular_color=(0.3, 0.4, 0.5), shininess=20.0, rim_strength=0.6, rim_power=3.0, emission=0.05
    )
    for add in parts:
        add(builder)
    scene = builder.build()
    albedo = scene.materials[0]["base_color"][:3].astype(float)
    expected = shade_plane(scene, scene.views["eye"], SIZE, MIDDLE, NORMAL, albedo)
    assert expected.std() > 1.0  # an image, not one colour
    assert np.abs(draw(gl, scene) - expected).max() <= 1.0


def test_a_normal_stretched_along_with_the_object_would_be_noticed(gl: rhi.Device) -> None:
    builder = slope()
    add_sun(builder)
    scene = builder.build()
    along = STRETCH * (1.0, 1.0, 0.0)
    albedo = scene.materials[0]["base_color"][:3].astype(float)
    wrong = shade_plane(
        scene, scene.views["eye"], SIZE, MIDDLE, NORMAL, albedo, along / np.linalg.norm(along)
    )
    assert np.abs(draw(gl, scene) - wrong).max() > 20.0


def test_textures_multiply_the_base_colour_in_linear_light(gl: rhi.Device) -> None:
    texture = np.full((4, 4, 4), (200, 100, 50, 255), np.uint8)
    scene = slope(texture=texture).build()
    linear = ((np.array([200, 100, 50]) / 255 + 0.055) / 1.055) ** 2.4
    albedo = scene.materials[0]["base_color"][:3] * linear
    expected = shade_plane(scene, scene.views["eye"], SIZE, MIDDLE, NORMAL, albedo)
    assert np.abs(draw(gl, scene) - expected).max() <= 1.0


def test_a_texture_shows_its_first_row_at_v_0_and_its_first_column_at_u_0(gl: rhi.Device) -> None:
    texture = np.zeros((8, 8, 4), np.uint8)
    texture[..., 3] = 255
    texture[:4, :4], texture[:4, 4:] = (255, 0, 0, 255), (0, 255, 0, 255)
    texture[4:, :4], texture[4:, 4:] = (0, 0, 255, 255), (255, 255, 255, 255)
    builder = slope(texture=texture, base_color=(1, 1, 1), specular_color=(0, 0, 0))
    builder.lights.sky = builder.lights.ground = (0.5, 0.5, 0.5)
    scene = builder.build()
    # From above, up is -z (v = 0) and right is +x (u = 1).
    above = Camera.look_at(MIDDLE + np.array([0, 60, 0]), MIDDLE, up=(0, 0, -1), projection=PROJECTION)
    height, width = SIZE[1], SIZE[0]
    image = draw(gl, scene, camera=above)
    corners = {
        "top left": image[height // 2 - 6, width // 2 - 6],
        "top right": image[height // 2 - 6, width // 2 + 5],
        "bottom left": image[height // 2 + 5, width // 2 - 6],
        "bottom right": image[height // 2 + 5, width // 2 + 5],
    }
    bright = {name: tuple(bool(c > 100) for c in color) for name, color in corners.items()}
    assert bright == {
        "top left": (True, False, False),
        "top right": (False, True, False),
        "bottom left": (False, False, True),
        "bottom right": (True, True, True),
    }


def test_images_of_several_sizes_are_layers_of_one_texture(gl: rhi.Device) -> None:
    builder = slope(texture=np.full((4, 4, 4), (255, 0, 0, 255), np.uint8), specular_color=(0, 0, 0))
    wide = builder.add_image(np.full((2, 16, 4), (0, 255, 0, 255), np.uint8))
    other = builder.add_material(texture=wide, base_color=(1, 1, 1), specular_color=(0, 0, 0))
    node = builder.add_node(translation(MIDDLE + np.array([0, 0.5, 0])) @ scaling((0.5, 0.5, 0.5)))
    builder.add_objects(node, 0, other)
    image = draw(gl, builder.build())
    middle, edge = image[SIZE[1] // 2, SIZE[0] // 2], image[1, 1]
    assert middle[1] > 4 * middle[0] + 40
    assert edge[0] > 4 * edge[1] + 40


@pytest.mark.parametrize("mirror", [False, True])
def test_an_object_is_seen_from_its_front_mirrored_or_not(gl: rhi.Device, mirror: bool) -> None:
    # The slope is symmetric about z = 0, so that its mirror image is itself.
    builder = slope(mirror=mirror)
    add_sun(builder)
    scene = builder.build()
    assert Renderer(gl, scene)._resources.mirrored.tolist() == [mirror]
    albedo = scene.materials[0]["base_color"][:3].astype(float)
    expected = shade_plane(scene, scene.views["eye"], SIZE, MIDDLE, NORMAL, albedo)
    assert np.abs(draw(gl, scene) - expected).max() <= 1.0


def test_an_object_is_not_seen_from_behind(gl: rhi.Device) -> None:
    scene = slope().build()
    behind = Camera.look_at(MIDDLE - np.array([3.4, 4.0, 1.0]), MIDDLE, projection=PROJECTION)
    image = draw(gl, scene, camera=behind)
    assert (image == image[0, 0]).all()


@pytest.mark.parametrize("depth", list(Depth))
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_near_surface_hides_a_far_surface(gl: rhi.Device, depth: Depth, order: tuple[int, int]) -> None:
    builder = slope(base_color=(1, 0, 0), specular_color=(0, 0, 0))
    green = builder.add_material(base_color=(0, 1, 0), specular_color=(0, 0, 0))
    raised = builder.add_node(translation(MIDDLE + np.array([0, 0.01, 0])) @ scaling(STRETCH))
    builder.add_objects(raised, 0, green)
    scene = builder.build()
    scene.objects.material[:] = scene.objects.material[list(order)]
    eye = scene.views["eye"]
    camera = eye.with_projection(Perspective(PROJECTION.fov, PROJECTION.aspect, depth=depth))
    image = draw(gl, scene, camera=camera)
    near = 1 if order == (0, 1) else 0
    assert (image[..., near] > 4 * image[..., 1 - near] + 20).all()


@pytest.mark.parametrize("text", ["city:blocks=8", "hall:columns=8,flags=4"])
def test_lights_that_do_not_reach_an_object_are_left_out_without_a_trace(
    gl: rhi.Device, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    scene = load_scene(text)
    cameras = [scene.paths[path].camera(frame) for path in ("ground", "sky") for frame in (200, 900)]
    assert len(scene.lights.point)
    assert len(scene.lights.spot)
    listed = [draw(gl, scene, camera=camera) for camera in cameras]

    def list_all(lower: Any, upper: Any, positions: Any, ranges: Any) -> Any:
        objects, lights = len(lower), len(positions)
        return np.arange(objects + 1) * lights, np.tile(np.arange(lights), objects)

    monkeypatch.setattr(resources, "list_lights", list_all)
    everything = [draw(gl, scene, camera=camera) for camera in cameras]
    assert np.array_equal(listed, everything)
    monkeypatch.setattr(
        resources, "list_lights", lambda lower, *_: (np.zeros(len(lower) + 1, int), np.zeros(0, int))
    )
    nothing = [draw(gl, scene, camera=camera) for camera in cameras]
    assert not np.array_equal(listed, nothing)  # the control: lights are seen
