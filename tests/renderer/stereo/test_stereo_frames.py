"""Frames of two eyes: the images of each, and what they share."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np
import pytest
from frames import open_renderer as open_any
from frames import require_algorithm
from numpy.typing import NDArray

import rhi
from renderer import scene as scenes
from renderer.content import load_scene
from renderer.content.shapes import box
from renderer.layers.particles import Particles
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Depth, Orthographic, Perspective, Scene, StereoRig, scaling, translation
from renderer.shaders import PointLight, ViewConstants
from renderer.stereo import Stereo
from renderer.techniques import TECHNIQUES
from renderer.visibility import FrustumCulling, VisibilityAlgorithm
from rhi import Op
from rhi.math import multiply

SIZE: Final = (96, 54)
RIG: Final = StereoRig(0.3, 6.0)
open_renderer = partial(open_any, size=SIZE, visibility="frustum")


@pytest.fixture(scope="module")
def hall() -> Scene:
    return load_scene("hall:columns=6,flags=4,fountains=1")


def draw(
    renderer: Renderer, camera: Camera, stereo: Stereo | None, seconds: float = 10.0
) -> tuple[FrameResult, list[NDArray[Any]]]:
    renderer.stereo = stereo
    result = renderer.render(camera, seconds)
    return result, [image.read() for image in result.eye_images]


def check_eyes(renderer: Renderer, camera: Camera, rig: StereoRig = RIG) -> None:
    """Check that the eyes' images are those of their cameras, to the bit."""
    _, pair = draw(renderer, camera, Stereo(rig, "color"))
    alone = [draw(renderer, eye, None)[1][0] for eye in rig.place_eyes(camera)]
    assert not np.array_equal(*pair)
    for name, together, single in zip(("left", "right"), pair, alone, strict=True):
        assert np.array_equal(together, single), f"{name}: {(together != single).any(-1).sum()} pixels"


def test_each_image_is_that_of_its_eye_with_queries(drawing_device: rhi.Device, city: Scene) -> None:
    with open_renderer(drawing_device, city, visibility="chc_plus_plus") as renderer:
        for frame in (600, 610):
            check_eyes(renderer, city.paths["ground"].camera(frame))


@pytest.mark.parametrize("algorithm", ["frustum", "chc"])
def test_each_eye_sees_through_glass(gl: rhi.Device, algorithm: str) -> None:
    scene = load_scene("glass:panes=9,lights=2")
    with open_renderer(gl, scene, visibility=algorithm) as renderer:
        check_eyes(renderer, scene.views["along"])


@pytest.mark.nightly
@pytest.mark.parametrize("scene_name", ["city", "hall"])
@pytest.mark.parametrize("name", TECHNIQUES)
def test_each_image_of_each_technique_is_that_of_its_eye(
    drawing_device: rhi.Device, request: pytest.FixtureRequest, scene_name: str, name: str
) -> None:
    scene: Scene = request.getfixturevalue(scene_name)
    with open_renderer(drawing_device, scene, TECHNIQUES[name]()) as renderer:
        camera = scene.paths["ground"].camera(600)
        check_eyes(renderer, camera)
        check_eyes(renderer, camera, replace(RIG, is_toed_in=True))


@pytest.mark.nightly
@pytest.mark.parametrize("scene_name", ["city", "hall"])
@pytest.mark.parametrize(
    "name", ["none", "stop_and_wait", "conditional", "depth_pyramid", "two_pass", "auto"]
)
def test_each_image_with_each_algorithm_is_that_of_its_eye(
    drawing_device: rhi.Device, request: pytest.FixtureRequest, scene_name: str, name: str
) -> None:
    require_algorithm(drawing_device, name)
    scene: Scene = request.getfixturevalue(scene_name)
    with open_renderer(drawing_device, scene, visibility=name) as renderer:
        for frame in range(600, 660, 6):
            check_eyes(renderer, scene.paths["ground"].camera(frame))


@pytest.mark.parametrize("name", ["depth_pyramid", "two_pass"])
def test_the_visible_objects_of_both_eyes_are_reported_by_algorithms_with_device_lists(
    gl: rhi.Device, hall: Scene, name: str
) -> None:
    """The right eye's lists replace the left one's, which were read before."""
    require_algorithm(gl, name)
    with open_renderer(gl, hall, visibility=name) as renderer:
        camera = hall.paths["ground"].camera(600)
        alone = set(renderer.render(camera).visible.tolist())
        renderer.stereo = Stereo(RIG, "side_by_side")
        both = set(renderer.render(camera).visible.tolist())
    assert alone
    assert len(alone - both) <= 0.1 * len(alone)


PROJECTIONS: Final = {
    "parallel": Orthographic(30.0, near=-5.0, far=300.0),
    "parallel, standard depth": Orthographic(30.0, near=-5.0, far=300.0, depth=Depth.STANDARD),
    "with an end": Perspective(near=0.2, far=60.0, depth=Depth.STANDARD),
}


@pytest.mark.parametrize("name", PROJECTIONS)
def test_each_projection_has_two_eyes(drawing_device: rhi.Device, city: Scene, name: str) -> None:
    camera = city.paths["ground"].camera(600).with_projection(PROJECTIONS[name])
    with open_renderer(drawing_device, city) as renderer:
        check_eyes(renderer, camera, StereoRig(2.0, 20.0))


def make_pillars(x: float) -> Scene:
    """Pillars in sunlight, all at `x` metres from the world's origin."""
    builder = scenes.SceneBuilder("pillars")
    mesh = builder.add_mesh(box())
    rng = np.random.default_rng(5)
    positions = rng.integers(-64, 64, (40, 3)) / 16.0 + (x, 0.0, -8.0)
    nodes = builder.add_nodes(multiply(translation(positions), scaling((0.25, 1.0, 0.25))))
    colors = rng.uniform(0.1, 1.0, (40, 4))
    builder.add_objects(nodes, mesh, [builder.add_material(base_color=tuple(color)) for color in colors])
    builder.lights.add_directional((-0.4, -1.0, -0.3), (1.0, 1.0, 1.0), 1.5)
    return builder.build()


def test_eyes_far_from_the_origin_see_the_same(drawing_device: rhi.Device) -> None:
    eye_images = []
    for x in (0.0, 131072.0):
        scene = make_pillars(x)
        camera = Camera.look_at((x, 1.0, 2.0), (x, 0.5, -8.0), projection=Perspective())
        with open_renderer(drawing_device, scene) as renderer:
            eye_images.append(draw(renderer, camera, Stereo(StereoRig(0.125, 8.0), "color"))[1])
    here, there = eye_images
    assert not np.array_equal(*here)
    assert np.array_equal(here, there)


class CountingCulling(FrustumCulling):
    """Frustum culling that counts how often it is asked."""

    render_calls = 0

    def render(self, camera: Camera, scene_drawer: Any) -> Any:
        self.render_calls += 1
        return super().render(camera, scene_drawer)


def count(
    null: rhi.Device, scene: Scene, stereo: Stereo | None, technique: str = "forward"
) -> dict[str, Any]:
    """The cost of a walk's frames, after the first ones."""
    algorithm = CountingCulling(scene)
    with Renderer(
        null, scene, technique=TECHNIQUES[technique](), size=SIZE, visibility=algorithm
    ) as renderer:
        renderer.stereo = stereo
        path = scene.paths["ground"]
        renderer.render(path.camera(599), 10.0)
        algorithm.render_calls = 0
        begin = len(null.stream)
        results = [renderer.render(path.camera(600 + i), 10.0 + i / 60) for i in range(4)]
        stream = null.stream[begin:]
    return {
        "asked": algorithm.render_calls,
        "bytes": sum(result.statistics.upload_bytes for result in results),
        "draws": sum(result.statistics.draws for result in results),
        "steps": sum(result.statistics.simulation_steps for result in results),
        "passes": len(stream.filter(Op.BEGIN_PASS)),
        "visible": [result.visible for result in results],
    }


def test_both_eyes_are_culled_once_and_upload_once(null: rhi.Device, city: Scene) -> None:
    mono, two = (count(null, city, stereo) for stereo in (None, Stereo(StereoRig(0.065, 3.0), "grey")))
    assert mono["asked"] == two["asked"] == 4
    assert two["passes"] == 2 * mono["passes"], "each eye; no pass shows both"
    for alone, both in zip(mono["visible"], two["visible"], strict=True):
        assert np.isin(alone, both).all()
        assert len(both) <= 1.1 * len(alone)
    assert two["draws"] == 2 * sum(map(len, two["visible"]))


def test_the_second_eye_uploads_its_camera_and_no_lights(null: rhi.Device) -> None:
    for scene in (load_scene("grid:count=9"), load_scene("grid:count=9,lights=16")):
        camera = next(iter(scene.views.values()))
        path = [replace(camera, position=np.add(camera.position, (0.1 * i, 0.0, 0.0))) for i in range(4)]
        uploads = []
        for stereo in (None, Stereo(StereoRig(0.065, 3.0), "color")):
            with open_renderer(null, scene) as renderer:
                renderer.stereo = stereo
                uploads.append([renderer.render(camera).statistics.upload_bytes for camera in path][1:])
        mono, two = uploads
        light_count, view = len(scene.lights.point), ViewConstants.dtype.itemsize
        assert mono == [view + light_count * PointLight.dtype.itemsize] * 3
        assert two == [2 * view] * 3


def test_swapped_eyes_see_lights_at_their_positions(gl: rhi.Device) -> None:
    scene = load_scene("grid:count=9,lights=16")
    camera = next(iter(scene.views.values()))
    moved = replace(camera, position=camera.position + 0.5)
    with open_renderer(gl, scene) as renderer, open_renderer(gl, scene) as fresh:
        draw(renderer, camera, Stereo(RIG, "color"))
        exchanged = draw(renderer, moved, Stereo(RIG, "side_by_side"))[
            1
        ]  # another size has another right eye
        assert np.array_equal(exchanged, draw(fresh, moved, Stereo(RIG, "side_by_side"))[1])


def test_eyes_culled_by_queries_are_queried_one_by_one(null: rhi.Device, city: Scene) -> None:
    # The control: what one eye's queries say doesn't hold for the other.
    class Alone(CountingCulling):
        def render(self, camera: Camera, scene_drawer: Any) -> Any:
            return replace(super().render(camera, scene_drawer), is_frustum_only=False)

    algorithm: VisibilityAlgorithm = Alone(city)
    with Renderer(null, city, size=SIZE, visibility=algorithm) as renderer:
        renderer.stereo = Stereo(RIG)
        renderer.render(city.paths["ground"].camera(600))
    assert isinstance(algorithm, CountingCulling)
    assert algorithm.render_calls == 2


@pytest.mark.parametrize("technique", ["forward", "forward_plus", "deferred", "light_pre_pass"])
def test_simulations_run_once_for_both_eyes(null: rhi.Device, hall: Scene, technique: str) -> None:
    mono, two = (count(null, hall, stereo, technique) for stereo in (None, Stereo(RIG, "color")))
    assert mono["asked"] == two["asked"] == 4
    assert two["steps"] == mono["steps"] > 0


@pytest.mark.parametrize("name", ["city:blocks=6", "city:blocks=6,shadows=1"])
def test_a_second_frame_of_eyes_that_stay_uploads_nothing(null: rhi.Device, name: str) -> None:
    city = load_scene(name)
    with open_renderer(null, city) as renderer:
        renderer.stereo = Stereo(RIG)
        camera = city.paths["ground"].camera(600)
        first, second, third = (renderer.render(camera, 10.0).statistics for _ in range(3))
    assert first.upload_bytes > 0
    assert second.upload_bytes == third.upload_bytes == 0


@pytest.mark.parametrize("output", ["side_by_side", "color", "dubois"])
@pytest.mark.parametrize(
    ("visibility", "step"), [("frustum", 0), ("none", 1)], ids=["they stay", "they move"]
)
def test_commands_are_recorded_once_while_the_number_of_objects_is_the_same(
    null: rhi.Device, city: Scene, output: str, visibility: str, step: int
) -> None:
    with open_renderer(null, city, visibility=visibility) as renderer:
        renderer.stereo = Stereo(RIG, output)
        recorded = []
        for frame in range(4):
            before = null.statistics.recorded_commands
            renderer.render(city.paths["ground"].camera(600 + step * frame), 10.0)
            recorded.append(null.statistics.recorded_commands - before)
    assert recorded[1] > recorded[0] == recorded[2] == recorded[3] == 0


def test_one_eye_and_two_alternate(null: rhi.Device, city: Scene) -> None:
    with open_renderer(null, city) as renderer:
        camera = city.paths["ground"].camera(600)
        sizes = []
        for output in (None, "color", "side_by_side", None, "over_under"):
            renderer.stereo = None if output is None else Stereo(RIG, output)
            result = renderer.render(camera)
            sizes.append((result.image.size, [image.size for image in result.eye_images]))
        renderer.size = (31, 21)
        result = renderer.render(camera)
        sizes.append((result.image.size, [image.size for image in result.eye_images]))
    assert sizes == [
        (SIZE, [SIZE]),
        (SIZE, [SIZE, SIZE]),
        (SIZE, [(48, 54), (48, 54)]),
        (SIZE, [SIZE]),
        (SIZE, [(96, 27), (96, 27)]),
        ((31, 21), [(31, 11), (31, 11)]),
    ]


def test_layers_are_drawn_for_both_eyes(null: rhi.Device, hall: Scene) -> None:
    eyes = []

    class Catch(Particles):
        def render(self, device: rhi.Device, frame: Any) -> None:
            eyes.append(frame.camera.position)

    with open_renderer(null, hall) as renderer:
        layer = Catch(null)
        renderer.layers.append(layer)
        renderer.stereo = Stereo(RIG)
        camera = hall.paths["ground"].camera(0)
        renderer.render(camera)
        layer.destroy()
    assert np.array_equal(eyes, [eye.position for eye in RIG.place_eyes(camera)])


def test_shadow_maps_are_drawn_once_for_both_eyes(null: rhi.Device) -> None:
    scene = load_scene("city:blocks=6,shadows=1")
    camera, passes, maps, casters = scene.paths["ground"].camera(600), [], [], []
    for stereo in (None, Stereo(StereoRig(0.065, 6.0), "grey")):
        with open_renderer(null, scene) as renderer:
            renderer.stereo = stereo
            before = len(null.stream)
            renderer.render(camera, 10.0)
            passes.append(len(null.stream[before:].filter(Op.BEGIN_PASS)))
            maps.append(renderer.shadows.count("drawn"))
            casters.append(renderer.shadows.casters_drawn)
    assert passes == [2, 3], "one for the maps; then one for each eye"
    assert maps[0] == maps[1] > 0, "the second eye doesn't ask for maps"
    assert casters[0] <= casters[1] <= 1.1 * casters[0]
