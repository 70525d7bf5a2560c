"""The growth of the cost of techniques with lights and objects, as counters: light evaluations and instances
drawn."""

from __future__ import annotations

import numpy as np
import pytest
from frames import make_boxes
from nightly_reasons import FEWER_CASES

import rhi
from renderer.content import load_scene
from renderer.lab.measure.light_evaluations import count_light_evaluations
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, scaling, translation
from renderer.techniques import TECHNIQUES, Deferred, Forward, ForwardMultipass, Technique
from renderer.visibility import FrustumCulling, NoCulling

SIZE = (96, 64)
ABOVE = Camera.look_at((0.0, 40.0, 0.1), (0.0, 0.0, 0.0))
"""A view of the middle of the city from above, in which the next streets are out of view."""
EYE = Camera.look_at((0, 0, 0), (0, 0, -1))


def count(device: rhi.Device, scene: Scene, technique: Technique, camera: Camera) -> int:
    visibility = FrustumCulling(scene)
    with Renderer(device, scene, technique=technique, visibility=visibility, size=SIZE) as renderer:
        number = count_light_evaluations(renderer, camera)
    assert number is not None
    return number


def wall(side: int, lights: int, reach: float) -> Scene:
    """Make a wall of `side` × `side` boxes that fills the image, and lights that are spread before it."""
    width = 20.0 / side
    middles = width * (np.arange(side) + 0.5) - 10.0
    size = scaling((width, width, 0.1))
    builder = make_boxes(*(translation((x, y, -5.0)) @ size for x in middles for y in middles))
    for number in range(lights):
        builder.lights.add_point((3.0 * ((number + 0.5) / lights - 0.5), 0.1, -4.5), reach)
    return builder.build()


@pytest.fixture(scope="module")
def cities() -> dict[int, Scene]:
    return {lights: load_scene(f"night:blocks=10,detail=2,lights={lights}") for lights in (12, 300, 1200)}


@pytest.mark.nightly_cases("deferred", "forward_plus", "tiled_deferred", "clustered", reason=FEWER_CASES)
@pytest.mark.parametrize(
    "name", ["forward", "clustered_deferred", "deferred", "forward_plus", "clustered", "tiled_deferred"]
)
def test_at_the_same_density_only_visible_lights_add_evaluations(
    gl: rhi.Device, cities: dict[int, Scene], name: str
) -> None:
    few, more, most = (count(gl, city, TECHNIQUES[name](), ABOVE) for city in cities.values())
    assert few < 0.5 * more
    assert most == pytest.approx(more, rel=0.01)  # clusters end a little farther where lights do


@pytest.mark.parametrize("name", ["deferred", "tiled_deferred", "clustered_deferred"])
def test_deferred_techniques_evaluate_as_many_lights_for_any_number_of_objects(
    gl: rhi.Device, name: str
) -> None:
    counts = {count(gl, wall(side, 8, 1.0), TECHNIQUES[name](), EYE) for side in (1, 4, 16)}
    assert len(counts) == 1
    assert counts.pop() > 0


def test_forward_shading_looks_at_all_lights_of_an_object_and_at_fewer_of_each_of_many(
    gl: rhi.Device,
) -> None:
    of_one, of_four, of_sixteen = (count(gl, wall(side, 8, 1.0), Forward(), EYE) for side in (1, 4, 16))
    assert of_one == 8 * SIZE[0] * SIZE[1]
    assert of_one > of_four > of_sixteen > 0


def test_forward_shading_by_all_lights_looks_at_all_of_them_however_many_objects_there_are(
    gl: rhi.Device,
) -> None:
    counts = [count(gl, wall(side, 8, 1.0), Forward(all_lights=True), EYE) for side in (1, 4, 16)]
    pixels = 8 * SIZE[0] * SIZE[1]
    assert counts[0] == pixels
    assert max(counts) <= 1.05 * pixels  # sides of boxes are hidden by what is drawn later
    assert min(counts) == pixels


@pytest.mark.parametrize(("side", "lights"), [(1, 1), (1, 8), (4, 1), (4, 8)])
def test_a_light_at_a_time_draws_objects_times_lights_and_volumes_are_as_many_as_lights(
    null: rhi.Device, side: int, lights: int
) -> None:
    scene = wall(side, lights, 100.0)
    drawn = []
    for technique in (ForwardMultipass(), Deferred()):
        with Renderer(null, scene, technique=technique, visibility=NoCulling(scene), size=SIZE) as renderer:
            null.stream.clear()
            renderer.render(EYE)
            (light_draws,) = (draws for draws in null.stream.draws() if draws.labels == ("point lights",))
            drawn.append(
                light_draws["draws"] if technique.name == "forward_multipass" else light_draws["instances"]
            )
    assert drawn == [side * side * lights, lights]
