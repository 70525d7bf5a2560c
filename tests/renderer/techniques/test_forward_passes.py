"""Forward techniques of several passes, and smooth edges: pixels against the forward technique, and
commands."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from frames import draw as draw_any
from frames import list_passes, make_boxes, max_difference, open_renderer, read_colors, record
from nightly_reasons import ONLY_KERNELS

import rhi
from renderer.content import load_scene
from renderer.light_kinds import LOCAL_LIGHT_KINDS
from renderer.scene import Camera, Scene, SceneBuilder, scaling, translation
from renderer.techniques import (
    Forward,
    ForwardMultipass,
    ForwardPlus,
    FxaaTechnique,
    LightIndexed,
    Technique,
    light_indexed,
)
from rhi import Op

SIZE = (64, 48)
draw = partial(draw_any, size=SIZE)
TECHNIQUES = [ForwardMultipass, LightIndexed]


def local_lights(points: int, spots: int = 0, *, haze: float = 0.0, mirrored: bool = False) -> SceneBuilder:
    """Make boxes on a floor, lit by local lights that reach a part of them each."""
    rng = np.random.default_rng(8)
    grid = [(x, z) for x in range(-2, 3) for z in range(-2, 3)]
    transforms = [
        translation((2.0 * x, 0, 2.0 * z)) @ scaling((-1 if mirrored and x == z else 1, 1, 1))
        for x, z in grid
    ]
    floor = translation((0, -0.6, 0)) @ scaling((14, 0.1, 14))
    look = {"base_color": (0.8, 0.7, 0.6), "specular_color": (0.2, 0.2, 0.2), "shininess": 20.0}
    builder = make_boxes(*transforms, floor, **look)
    for _ in range(points):
        position = rng.uniform((-4, 0.8, -4), (4, 2.0, 4))
        builder.lights.add_point(position, 3.0, rng.uniform(0.2, 1, 3), 1.5)
    for _ in range(spots):
        position, way = rng.uniform((-4, 2.0, -4), (4, 4.0, 4)), rng.uniform((-0.4, -1, -0.4), (0.4, -1, 0.4))
        builder.lights.add_spot(position, way, 6.0, 0.2, 0.6, rng.uniform(0.2, 1, 3), 9.0)
    builder.haze, builder.background = haze, (0.3, 0.5, 0.7)
    builder.views["eye"] = Camera.look_at((4, 5, 7), (0, 0, 0))
    return builder


SCENES = ("city:blocks=6", "hall:columns=6,flags=2", "grid:count=9")


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("technique", [*TECHNIQUES, lambda: Forward(all_lights=True)])
@pytest.mark.parametrize("text", SCENES)
def test_a_scene_looks_as_in_one_pass(
    drawing_device: rhi.Device, technique: Callable[[], Technique], text: str
) -> None:
    scene = load_scene(text)
    camera = scene.paths["ground"].camera(500)
    expected = draw(drawing_device, scene, Forward(), camera)
    assert expected.std() > 5.0
    assert max_difference(draw(drawing_device, scene, technique(), camera), expected) <= 2


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("technique", TECHNIQUES)
def test_local_lights_around_and_beside_the_eye_look_as_in_one_pass(
    drawing_device: rhi.Device, technique: Callable[[], Technique]
) -> None:
    builder = local_lights(0)
    for position in ((1.0, 1.0, 1.0), (0.2, 1.4, 1.9), (-1.5, 1.2, 2.2)):
        builder.lights.add_point(position, 2.5, (0.5, 0.7, 0.9), 2.0)
    builder.lights.add_spot((1.0, 1.6, 1.4), (0, -1, -0.5), 4.0, 0.3, 1.3, (1, 0.5, 0.2), 3.0)
    scene = builder.build()
    camera = Camera.look_at((0.9, 1.1, 1.2), (0, 0, -1))
    dark = draw(drawing_device, local_lights(0).build(), Forward(), camera)
    expected = draw(drawing_device, scene, Forward(), camera)
    assert max_difference(expected, dark) > 50
    assert max_difference(draw(drawing_device, scene, technique(), camera), expected) <= 2


@pytest.mark.parametrize("technique", [*TECHNIQUES, lambda: Forward(4), lambda: ForwardPlus(4)])
@pytest.mark.parametrize("visibility", ["chc_plus_plus", "conditional", "two_pass"])
def test_every_way_to_find_the_visible_objects_gives_the_same_image(
    gl: rhi.Device, technique: Callable[[], Technique], visibility: str
) -> None:
    scene = local_lights(4, 2, mirrored=True).build()
    expected = draw(gl, scene, technique())
    assert max_difference(draw(gl, scene, technique(), visibility=visibility, frames=2), expected) == 0


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_a_pixel_with_too_many_lights_is_counted_and_lit_by_all_of_them(drawing_device: rhi.Device) -> None:
    few, many = (local_lights(0), local_lights(0))
    for builder, count in ((few, light_indexed.LIGHTS_PER_PIXEL), (many, light_indexed.LIGHTS_PER_PIXEL + 1)):
        for i in range(count):
            builder.lights.add_point((0.05 * i, 2.0, 0.1 * i), 9.0, (1, 1 - 0.1 * i, 0.1 * i), 0.7)
    counts = []
    for builder in (few, many):
        scene = builder.build()
        expected = draw(drawing_device, scene, Forward())
        with open_renderer(drawing_device, scene, LightIndexed(), size=SIZE) as renderer:
            result = renderer.render(scene.views["eye"])
            assert max_difference(read_colors(result), expected) <= 2
            indices = result.targets["light_indices"].read()
            assert (indices[..., 0] > 0.0).any()
            counts.append(light_indexed.count_overflowing(result.targets))
    assert counts[0] == 0
    assert counts[1] is not None
    assert counts[1] > 500


def test_a_technique_without_light_indices_counts_no_overflow(null: rhi.Device) -> None:
    scene = local_lights(1).build()
    with open_renderer(null, scene) as renderer:
        assert light_indexed.count_overflowing(renderer.render(scene.views["eye"]).targets) is None


def test_packed_numbers_are_exact_up_to_the_last_light_and_fill_a_pixel_beyond() -> None:
    numbers = np.arange(1, light_indexed.MAX_INDEXED_LIGHTS + 3)
    packed = light_indexed.pack_numbers(numbers)
    assert ((packed[:-2] << 3 * np.arange(4)).sum(1) == numbers[:-2]).all()
    assert (packed[:-2].max(1) > 0).all()  # no number is nothing
    assert (packed[-2:] == light_indexed.OVERFLOW_VALUE).all()
    # Blended as the device does, in float32: eight lights stay below the mark, the ninth passes it.
    rng = np.random.default_rng(2)
    for _ in range(200):
        pixel = np.zeros(4, np.float32)
        for count, number in enumerate(rng.choice(packed[:-2], 9), 1):
            pixel = pixel * np.float32(8) + number.astype(np.float32)
            assert bool((pixel >= light_indexed.OVERFLOW_VALUE).any()) == (
                count > light_indexed.LIGHTS_PER_PIXEL
            )


@pytest.mark.parametrize(
    ("points", "spots", "multipass", "indexed"),
    [
        (0, 0, ["forward"], ["forward"]),
        (1, 0, ["base", "point lights", "resolve"], ["depth", "light indices", "forward"]),
        (0, 1, ["base", "spot lights", "resolve"], ["depth", "light indices", "forward"]),
        (3, 1, ["base", "point lights", "spot lights", "resolve"], ["depth", "light indices", "forward"]),
    ],
)
def test_only_local_lights_in_view_have_passes(
    null: rhi.Device, points: int, spots: int, multipass: list[str], indexed: list[str]
) -> None:
    builder = local_lights(points, spots)
    builder.lights.add_point((500, 1, 0), 2.0)  # reaches nothing
    scene = builder.build()
    assert list_passes(null, scene, ForwardMultipass()) == multipass
    assert list_passes(null, scene, LightIndexed()) == indexed


def round_up(count: int) -> int:
    """Return the number of draws of a batch of objects: the last ones draw nothing."""
    return -(-count // 32) * 32


def test_all_pairs_of_objects_and_point_lights_are_one_call(null: rhi.Device) -> None:
    scene = local_lights(6).build()
    base, added, _ = record(null, scene, ForwardMultipass(), visibility="frustum").draws()
    lists, lights = scene.objects, scene.lights.point
    away = lights["position"] - np.clip(lights["position"], lists.lower[:, None], lists.upper[:, None])
    reached = (away**2).sum(-1) < lights["range"].astype(float) ** 2
    assert base["draws"] == round_up(len(lists))
    assert added["draws"] == reached.sum()
    assert added.states[rhi.DepthFunction] is rhi.DepthFunction.EQUAL
    assert added.states[rhi.BlendFunction][0] == rhi.BlendFunction.ADDITIVE


def test_a_lights_objects_are_drawn_together(null: rhi.Device) -> None:
    scene = local_lights(6, 3).build()
    with open_renderer(null, scene) as renderer:
        renderer.render(scene.views["eye"])
        resources, rows = renderer._resources, np.arange(len(scene.objects))
        for kind in LOCAL_LIGHT_KINDS:
            lights = scene.lights.of_kind(kind)
            objects, entries = resources.pair_objects_with_lights(rows, np.arange(len(lights)), kind)
            lit = resources._listed[entries]
            assert (np.diff(lit) >= 0).all()
            assert len({*zip(objects.tolist(), lit.tolist(), strict=True)}) == len(objects) > len(lights)
            fewer, light_entries = resources.pair_objects_with_lights(rows[::2], np.array([1]), kind)
            assert (resources._listed[light_entries] == 1).all()
            assert fewer.tolist() == [row for row in objects[lit == 1].tolist() if row % 2 == 0]


def test_all_lights_are_packed_by_one_draw(null: rhi.Device) -> None:
    depth, packed, lit = record(
        null, local_lights(6, 3).build(), LightIndexed(), visibility="frustum"
    ).draws()
    assert packed["instances"] == 9
    assert depth["draws"] == lit["draws"] == round_up(26)
    assert lit.states[rhi.DepthFunction] is rhi.DepthFunction.GREATER_EQUAL


def test_one_sample_per_pixel_takes_one_pass(null: rhi.Device) -> None:
    scene = local_lights(1).build()
    assert list_passes(null, scene, Forward()) == ["forward"]
    assert list_passes(null, scene, Forward(samples=4)) == ["depth", "forward", "resolve"]
    stream = record(null, scene, Forward(), visibility="frustum")
    assert len(stream.filter(Op.BEGIN_PASS)) == 1


def edge() -> Scene:
    """Make a bright box whose sides are slanted in the image, before a dark background."""
    builder = make_boxes((0, 0, 0), base_color=(1, 1, 1), specular_color=(0, 0, 0), emission=1.0)
    builder.views["eye"] = Camera.look_at((0.25, 0.1, 2.1), (0, 0, 0), up=(0.17, 1, 0))
    return builder.build()


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("smooth", [lambda: Forward(samples=4), lambda: FxaaTechnique(Forward())])
def test_edges_are_nearer_to_those_of_many_samples(
    drawing_device: rhi.Device, smooth: Callable[[], Technique]
) -> None:
    scene, n = edge(), 8
    large = draw(drawing_device, scene, Forward(), size=(n * SIZE[0], n * SIZE[1]))
    expected = large.reshape(SIZE[1], n, SIZE[0], n, 3).mean((1, 3))
    before = np.square(draw(drawing_device, scene, Forward()) - expected).mean() ** 0.5
    after = np.square(draw(drawing_device, scene, smooth()) - expected).mean() ** 0.5
    assert before > 3.0
    assert after < 0.7 * before


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_fxaa_changes_only_pixels_at_edges(drawing_device: rhi.Device) -> None:
    scene = edge()
    plain, smooth = (
        draw(drawing_device, scene, technique) for technique in (Forward(), FxaaTechnique(Forward()))
    )
    changed = np.abs(plain - smooth).max(-1) > 0
    neighbours = np.stack([np.roll(plain, (y, x), (0, 1)) for y in (-1, 0, 1) for x in (-1, 0, 1)])
    flat = (neighbours == plain).all((0, -1))
    assert changed.any()
    assert flat.mean() > 0.5
    assert not (changed & flat)[1:-1, 1:-1].any()


@pytest.mark.parametrize("technique", [Forward, *TECHNIQUES])
def test_fxaa_is_one_pass_after_any_technique(null: rhi.Device, technique: Callable[[], Technique]) -> None:
    scene = local_lights(2).build()
    assert list_passes(null, scene, FxaaTechnique(technique())) == [
        *list_passes(null, scene, technique()),
        "fxaa",
    ]
