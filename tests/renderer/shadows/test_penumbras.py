"""Penumbras: lights whose sources have a size cast soft shadows, and all others those of `SMOOTH`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from frames import make_boxes, open_renderer, read_colors
from numpy.typing import NDArray

import rhi
from renderer.frame import Effect
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic, Scene, scaling, translation
from renderer.shadows import ShadowFilter, ShadowSettings
from renderer.techniques import TECHNIQUES
from rhi.testing import assert_same

SMOOTH = ShadowSettings(cascades=1, cascade_size=512, distance=12.0, min_size=512)
PCSS = replace(SMOOTH, filter=ShadowFilter.PCSS)
ABOVE = Camera.look_at((0, 8, 0), (0, 0, 0), (0, 0, -1), Orthographic(8.0, 1.0, 0.0, 20.0))
KINDS = ("sun", "point", "spot")


def make_block(kind: str, size: float, height: float = 0.5, slant: float = 0.7) -> Scene:
    """Make a floor and a block of a metre at a height, in the light of one source of this size."""
    builder = make_boxes((0, height, 0), name="block", specular_color=(0, 0, 0))
    floor = builder.add_node(translation((0, -0.5, 0)) @ scaling((40, 1, 40)))
    builder.add_objects(floor, 0, builder.add_material(specular_color=(0, 0, 0)))
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
    sources = {"casts_shadow": True, "source_radius": size}
    if kind == "sun":
        builder.lights.add_directional((slant, -1, 0), casts_shadow=True, angular_diameter=size)
    elif kind == "point":
        builder.lights.add_point((-4 * slant, 4, 0), 30.0, intensity=20.0, **sources)
    else:
        builder.lights.add_spot((-4 * slant, 4, 0), (slant, -1, 0), 30.0, 0.7, 0.9, intensity=20.0, **sources)
    return builder.build()


def render(
    device: rhi.Device, scene: Scene, settings: ShadowSettings, technique: str = "forward", size: int = 64
) -> NDArray[np.int64]:
    """Return the image (h, w, 3), seen from above."""
    with open_renderer(device, scene, TECHNIQUES[technique](), size=(size, size)) as renderer:
        renderer.shadows.settings = settings
        return read_colors(renderer.render(ABOVE))


def count_grey(image: NDArray[np.int64], lit: NDArray[np.int64]) -> int:
    """Return the number of pixels that are neither lit in full nor dark."""
    return int(((image > 12) & (image < lit - 3)).any(-1).sum())


def record(device: rhi.Device, scene: Scene, settings: ShadowSettings) -> Any:
    """Return the commands of the second frame."""
    with Renderer(device, scene, size=(64, 64)) as renderer:
        renderer.shadows.settings = settings
        renderer.render(ABOVE)
        before = len(device.stream)
        renderer.render(ABOVE)
        return device.stream[before:]


@pytest.mark.parametrize("kind", KINDS)
def test_without_sizes_the_commands_are_those_of_smooth_shadows(kind: str) -> None:
    streams = []
    for settings in (SMOOTH, PCSS):
        with rhi.create_device("null") as device:
            streams.append(record(device, make_block(kind, 0.0), settings))
    assert_same(*streams)


@pytest.mark.parametrize("kind", KINDS)
def test_the_frame_says_why_it_has_penumbras_or_not(null_device: rhi.Device, kind: str) -> None:
    effect = Effect.DIRECTIONAL_PENUMBRAS if kind == "sun" else Effect.LOCAL_PENUMBRAS
    for size, settings, reason in (
        (0.2, PCSS, "1 "),
        (0.0, PCSS, "the scene has no "),
        (0.2, SMOOTH, "the filter of shadows isn't PCSS"),
    ):
        with Renderer(null_device, make_block(kind, size), size=(8, 8)) as renderer:
            renderer.shadows.settings = settings
            renderer.render(ABOVE)
            effects, _ = renderer.plan(ABOVE)
            assert (effect in effects.enabled) is (size > 0.0 and settings is PCSS)
            assert reason in effects.explain(effect)


@pytest.mark.parametrize("kind", KINDS)
def test_penumbras_widen_with_the_source(drawing_device: rhi.Device, kind: str) -> None:
    scenes = [make_block(kind, size, height=1.5) for size in (0.05, 0.3, 0.8)]
    lit = make_block(kind, 0.0, height=1.5)
    lit.lights.cast_shadows(False)
    bright = render(drawing_device, lit, SMOOTH)
    grey = [count_grey(render(drawing_device, scene, PCSS), bright) for scene in scenes]
    assert grey[0] + 40 < grey[1] < grey[2] - 40


@pytest.mark.parametrize("kind", KINDS)
def test_a_shadow_is_dark_where_its_block_touches_the_floor(gl: rhi.Device, kind: str) -> None:
    image = render(gl, make_block(kind, 0.3), PCSS)
    foot = image[31:33, 37]  # 19 cm behind the block
    assert foot.max() < 12


@pytest.mark.parametrize("size", [1e-6, 1e-3])
@pytest.mark.parametrize("kind", KINDS)
def test_tiny_sources_cast_the_shadows_of_points(gl: rhi.Device, kind: str, size: float) -> None:
    soft, smooth = (render(gl, make_block(kind, size), settings) for settings in (PCSS, SMOOTH))
    assert np.abs(soft - smooth).mean() < 0.5  # their maps have other texels


@pytest.mark.parametrize("kind", KINDS)
def test_huge_sources_leave_a_lit_floor_lit(gl: rhi.Device, kind: str) -> None:
    scene = make_block(kind, {"sun": 1.5, "point": 3.0, "spot": 3.0}[kind])
    scene.objects.casts_shadow[0] = False
    lit = make_block(kind, {"sun": 1.5, "point": 3.0, "spot": 3.0}[kind])
    lit.lights.cast_shadows(False)
    assert np.abs(render(gl, scene, PCSS) - render(gl, lit, PCSS)).max() <= 1


@pytest.mark.parametrize("slant", [1.0, 3.0, 20.0])
@pytest.mark.parametrize("kind", ["sun", "point"])
def test_grazing_light_leaves_a_lit_floor_lit(gl: rhi.Device, kind: str, slant: float) -> None:
    scene, lit = (make_block(kind, 0.1, slant=slant) for _ in range(2))
    scene.objects.casts_shadow[0] = False
    lit.lights.cast_shadows(False)
    scene.lights.point["range"] = lit.lights.point["range"] = 1e4
    for lights in (scene.lights, lit.lights):
        for array in (lights.directional, lights.point):
            array["intensity"] *= slant**2
    image, expected = (render(gl, drawn_scene, PCSS) for drawn_scene in (scene, lit))
    assert expected.max() > 30
    assert np.abs(image - expected).max() <= 1


def test_a_light_within_a_block_lights_nothing_outside(gl: rhi.Device) -> None:
    """The block is two-sided: its inside casts shadows."""
    scene = make_block("point", 0.05)
    scene.set_material(int(scene.objects.material[0]), double_sided=True)
    scene.lights.point["position"] = (0.2, 0.5, 0.1)
    assert render(gl, scene, PCSS).max() == 0
    scene.lights.cast_shadows(False)
    assert render(gl, scene, PCSS).max() > 50


@pytest.mark.parametrize("technique", ["deferred", "clustered", "light_pre_pass", "forward_plus"])
def test_techniques_share_penumbras(gl: rhi.Device, technique: str) -> None:
    scene = make_block("point", 0.4, height=1.5)
    forward, other = (render(gl, scene, PCSS, name) for name in ("forward", technique))
    assert np.abs(forward - other).mean() < 0.5


def test_penumbras_go_on_where_cascades_meet(gl: rhi.Device) -> None:
    """A wall's shadow runs through four maps, and its penumbra is as wide in each."""
    builder = make_boxes((0, 3.0, 0), name="beam", specular_color=(0, 0, 0))
    builder.add_objects(
        builder.add_node(translation((0, -0.5, 0)) @ scaling((80, 1, 80))),
        0,
        builder.add_material(specular_color=(0, 0, 0)),
    )
    beam = builder.add_node(translation((0, 3.0, 0)) @ scaling((1, 0.1, 60)))
    builder.add_objects(beam, 0, builder.add_material(specular_color=(0, 0, 0)))
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
    builder.lights.add_directional((0.8, -1, 0), casts_shadow=True, angular_diameter=0.1)
    scene = builder.build()
    along = Camera.look_at((2.4, 9.0, 8.0), (2.4, 0.0, 0.0))
    images = []
    for cascades in (4, 1):
        with open_renderer(gl, scene, TECHNIQUES["forward"](), size=(96, 96)) as renderer:
            renderer.shadows.settings = replace(PCSS, cascades=cascades, cascade_size=1024, distance=30.0)
            images.append(read_colors(renderer.render(along)))
    assert count_grey(images[1], np.full_like(images[1], images[1].max())) > 100
    assert np.abs(images[0] - images[1]).mean() < 1.0


def test_counts_of_samples_are_refused_below_one() -> None:
    for name in ("blocker_samples", "penumbra_samples"):
        counts: dict[str, Any] = {name: 0}
        with pytest.raises(rhi.ValidationError, match="1 to 1024"):
            replace(PCSS, **counts)
    assert replace(PCSS, blocker_samples=1, penumbra_samples=1024).penumbra_samples == 1024
