"""The number of light evaluations of a frame, in scenes in which it is known."""

from __future__ import annotations

import pytest
from frames import make_boxes
from nightly_reasons import FEWER_CASES, ONLY_KERNELS

from renderer import techniques
from renderer.lab.measure.light_evaluations import (
    CountingTechnique,
    count_light_evaluations,
    find_counting_pass,
)
from renderer.renderer import Renderer
from renderer.scene import AlphaMode, Camera, Scene, scaling, translation
from renderer.visibility import NoCulling
from rhi import Device

SIZE = (64, 48)
PIXELS = SIZE[0] * SIZE[1]
SHRUNK = 39 * 29  # 0.6 of each side, rounded up
COUNTED = [name for name, make in techniques.TECHNIQUES.items() if find_counting_pass(make()) is not None]


def walls(*distances: float, points: int = 0, spots: int = 0, reach: float = 100.0) -> Scene:
    """Make walls that fill the image, at these distances from the eye, and lights a metre before the first
    one."""
    builder = make_boxes(*(translation((0, 0, -distance)) @ scaling((40, 40, 0.1)) for distance in distances))
    for number in range(points):
        builder.lights.add_point((0.01 * number, 0, 1 - min(distances)), reach)
    for number in range(spots):
        builder.lights.add_spot((0.01 * number, 0, 1 - min(distances)), (0, 0, -1), reach, 1.5, 1.57)
    builder.views["eye"] = Camera.look_at((0, 0, 0), (0, 0, -1))
    return builder.build()


def count(
    device: Device, scene: Scene, technique: techniques.Technique, size: tuple[int, int] = SIZE
) -> int | None:
    with Renderer(device, scene, technique=technique, visibility=NoCulling(scene), size=size) as renderer:
        return count_light_evaluations(renderer, scene.views["eye"])


def test_the_techniques_of_the_papers_can_be_counted() -> None:
    assert {"forward", "forward_multipass", "deferred", "light_pre_pass", "inferred", "light_indexed"} <= set(
        COUNTED
    )
    assert {"forward_plus", "clustered", "tiled_deferred", "clustered_deferred", "deferred_plus"} <= set(
        COUNTED
    )


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.nightly_cases(
    "gl-clustered_deferred",
    "gl-deferred_plus",
    "gl-forward_multipass",
    "gl-inferred",
    "gl-light_indexed",
    "gl-tiled_deferred",
    reason=FEWER_CASES,
)
@pytest.mark.parametrize("name", COUNTED)
def test_each_pixel_looks_at_each_light_that_reaches_all_of_them(drawing_device: Device, name: str) -> None:
    pixels = SHRUNK if name == "inferred" else PIXELS
    assert count(drawing_device, walls(5.0, points=3), techniques.TECHNIQUES[name]()) == 3 * pixels
    assert count(drawing_device, walls(5.0, points=2, spots=3), techniques.TECHNIQUES[name]()) == 5 * pixels
    assert count(drawing_device, walls(5.0), techniques.TECHNIQUES[name]()) == 0


@pytest.mark.parametrize("name", COUNTED)
def test_a_small_light_is_looked_at_where_it_may_reach_and_by_forward_shading_everywhere(
    gl: Device, name: str
) -> None:
    size = (256, 192)  # of 4 × 3 tiles of clusters
    number = count(gl, walls(5.0, points=1, reach=1.2), techniques.TECHNIQUES[name](), size)
    assert number is not None
    if name in ("forward", "forward_multipass"):
        assert number == size[0] * size[1]
    else:
        assert 0 < number < size[0] * size[1]


@pytest.mark.parametrize("forward", [-1, 1])
def test_a_light_of_an_object_behind_is_looked_at_if_it_is_drawn_first(gl: Device, forward: int) -> None:
    """Objects are drawn front to back by their farthest corners: that of the near, thick wall is the farther
    one."""
    thick, thin = (
        translation((0, 0, 10 * forward)) @ scaling((40, 40, 10)),
        translation((0, 0, 8 * forward)) @ scaling((40, 40, 0.1)),
    )
    builder = make_boxes(thick, thin)
    builder.lights.add_point((0, 0, forward), 100.0)
    builder.views["eye"] = Camera.look_at((0, 0, 0), (0, 0, forward))
    scene = builder.build()
    assert count(gl, scene, techniques.Forward()) == count(gl, scene, techniques.Clustered()) == 2 * PIXELS
    assert (
        count(gl, scene, techniques.Deferred()) == count(gl, scene, techniques.ForwardMultipass()) == PIXELS
    )


@pytest.mark.parametrize("make", [techniques.Forward, techniques.Clustered, techniques.ForwardMultipass])
@pytest.mark.parametrize(("alpha", "evaluations"), [(0.0, 0), (1.0, 1)])
def test_masked_fragments_evaluate_no_light(
    gl: Device, make: type[techniques.Forward], alpha: float, evaluations: int
) -> None:
    scene = walls(5.0, points=1)
    scene.materials["alpha_mode"], scene.materials["base_color"][:, 3] = AlphaMode.MASK, alpha
    assert count(gl, scene, make()) == evaluations * PIXELS


@pytest.mark.parametrize(("points", "evaluations"), [(8, 8), (9, 10)])
def test_a_pixel_with_more_indices_than_fit_looks_at_its_objects_list(
    gl: Device, points: int, evaluations: int
) -> None:
    """One more light reaches the wall at a single place, so it is on the list of the object."""
    scene = walls(5.0, points=points)
    scene.lights.add_point((15.0, 0.0, -4.9), 1.0)
    assert count(gl, scene, techniques.LightIndexed()) == evaluations * PIXELS


def test_more_than_a_half_float_can_count_are_counted(gl: Device) -> None:
    assert count(gl, walls(5.0, points=2501), techniques.TiledDeferred()) == 2501 * PIXELS


@pytest.mark.parametrize("make", [techniques.Deferred, techniques.LightPrePass])
def test_stencil_masks_skip_pixels_in_front_of_a_light_volume(
    gl: Device, make: type[techniques.Deferred]
) -> None:
    scene = walls(5.0)
    scene.lights.add_point((0, 0, -6.0), 1.2)  # behind the wall's face, which it touches
    scene.lights.add_point((0, 0, -6.5), 1.2)  # behind it
    assert 0 < (count(gl, scene, make(stencil=True)) or 0) < (count(gl, scene, make()) or 0)


@pytest.mark.parametrize(
    "technique", [techniques.Forward(samples=4), techniques.FxaaTechnique(techniques.Forward())]
)
def test_evaluations_of_multisampled_and_wrapped_techniques_are_not_counted(
    gl: Device, technique: techniques.Technique
) -> None:
    assert count(gl, walls(5.0, points=1), technique) is None


def test_a_device_that_draws_nothing_counts_nothing(null: Device) -> None:
    assert count(null, walls(5.0, points=1), techniques.Forward()) is None


def test_counting_leaves_the_renderer_as_it_was(gl: Device) -> None:
    scene, technique = walls(5.0, points=1), techniques.Deferred()
    with Renderer(gl, scene, technique=technique, visibility=NoCulling(scene), size=SIZE) as renderer:
        before = renderer.render(scene.views["eye"]).image.read()
        count_light_evaluations(renderer, scene.views["eye"])
        assert renderer.technique is technique
        assert (renderer.render(scene.views["eye"]).image.read() == before).all()


def test_a_counted_technique_has_its_own_passes_and_one_more(null: Device) -> None:
    scene = walls(5.0, points=1)
    with Renderer(
        null,
        scene,
        technique=CountingTechnique(techniques.Deferred()),
        visibility=NoCulling(scene),
        size=SIZE,
    ) as renderer:
        renderer.render(scene.views["eye"])
        _, plan = renderer.plan(scene.views["eye"])
        assert renderer.technique.name == "deferred"
    assert [frame_pass.name for frame_pass in plan.passes] == [
        "geometry",
        "point lights",
        "resolve",
        "light evaluations",
    ]
