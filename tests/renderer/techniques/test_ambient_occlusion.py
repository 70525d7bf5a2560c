"""Ambient occlusion: compared with rays, alike in all techniques, and for nothing where nothing needs it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from frames import make_boxes
from nightly_reasons import ONLY_KERNELS

import rhi
from renderer.content import BUILT_IN
from renderer.frame import Effect, OcclusionSettings
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.renderer import Renderer
from renderer.scene import (
    AlphaMode,
    AmbientOcclusion,
    Camera,
    Depth,
    Orthographic,
    Perspective,
    Scene,
    StereoRig,
    scaling,
    translation,
)
from renderer.scene.arrays import Floats
from renderer.settings import RenderSettings
from renderer.stereo import Stereo
from renderer.techniques import TECHNIQUES, Forward, TechniqueSettings
from rhi import ValidationError
from tests.renderer.conftest import open_device

SIZE = (128, 64)
RADIUS = 1.5
FINE = OcclusionSettings(slices=16, steps=32, is_smooth=False, bits=16)
WHITE = {"base_color": (1.0, 1.0, 1.0, 1.0), "specular_color": (0.0, 0.0, 0.0), "rim_strength": 0.0}
FLOOR = translation((0.0, -0.5, 0.0)) @ scaling((40.0, 1.0, 40.0))
WALL = translation((-10.0, 5.0, 0.0)) @ scaling((20.0, 10.0, 40.0))
BLOCK = translation((1.6, 0.3, 0.4)) @ scaling((0.8, 0.6, 0.9))
EYE = Camera.look_at((3.0, 4.0, 0.0), (1.0, 0.0, 0.0)).with_aspect(2.0)


def make_scene(
    *transforms: Any, radius: float | None = RADIUS, at: tuple[float, float, float] = (0, 0, 0)
) -> Scene:
    """Make white boxes in white ambient light."""
    builder = make_boxes(*(translation(at) @ transform for transform in transforms), **WHITE)
    builder.lights.sky = builder.lights.ground = (1.0, 1.0, 1.0)
    builder.ambient_occlusion = None if radius is None else AmbientOcclusion(radius)
    return builder.build()


def make_corner() -> Scene:
    return make_scene(FLOOR, WALL, BLOCK)


@cache
def trace_corner() -> Floats:
    """The image of the corner by rays, (h, w)."""
    return RayTracer(make_corner()).draw(EYE, SIZE)[..., 0]


def draw(device: rhi.Device, scene: Scene, camera: Camera = EYE, **options: Any) -> Floats:
    """Draw a frame; return its red levels (h, w)."""
    occlusion = options.pop("occlusion", OcclusionSettings())
    with Renderer(device, scene, visibility="frustum", size=SIZE, **options) as renderer:
        renderer.occlusion = occlusion
        return renderer.render(camera).image.read()[..., 0].astype(np.float64)


def list_passes(scene: Scene, camera: Camera = EYE, technique: Any = None) -> list[str]:
    with (
        rhi.create_device("null") as device,
        Renderer(device, scene, technique=technique, visibility="frustum", size=SIZE) as renderer,
    ):
        return [frame_pass.name for frame_pass in renderer.plan(camera)[1].passes]


@pytest.fixture(params=["gl", "cl", "wgpu"])
def device(request: pytest.FixtureRequest) -> Any:
    with open_device(request.param) as opened:
        yield opened


@pytest.mark.nightly_cases("cl", "wgpu", reason=ONLY_KERNELS)
def test_fine_settings_approach_rays(device: rhi.Device) -> None:
    """Up to what the screen doesn't show: errors remain beside edges, which hide what is behind them."""
    traced, open_image = trace_corner(), draw(device, make_scene(FLOOR, WALL, BLOCK, radius=None))
    error = np.abs(draw(device, make_corner(), occlusion=FINE) - traced)
    assert np.abs(open_image - traced).mean() > 3.0, "the control: there is much to find"
    assert error.mean() < 1.0
    assert np.percentile(error, 90) < 1.5


def test_errors_fall_with_slices_and_steps() -> None:
    with open_device("gl") as gl:
        errors = [
            np.abs(draw(gl, make_corner(), occlusion=settings) - trace_corner()).mean()
            for settings in (OcclusionSettings(1, 2), OcclusionSettings(2, 6), OcclusionSettings(8, 16), FINE)
        ]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 1.5 * errors[-1]


@pytest.mark.nightly_cases("cl", "wgpu", reason=ONLY_KERNELS)
@pytest.mark.parametrize(
    "camera",
    [
        EYE,
        Camera.look_at((9.0, 0.2, 3.0), (8.0, 0.1, 0.0)).with_aspect(2.0),
        Camera.look_at((8.0, 3.0, 0.0), (8.0, 0.0, -0.5), projection=Orthographic(4.0, 2.0, 0.1, 50.0)),
    ],
    ids=["from above", "grazing", "parallel"],
)
def test_an_open_plane_keeps_all_of_its_light(device: rhi.Device, camera: Camera) -> None:
    plane, bare = make_scene(FLOOR), make_scene(FLOOR, radius=None)
    for settings in (OcclusionSettings(1, 1), OcclusionSettings(), FINE):
        difference = draw(device, plane, camera, occlusion=settings) - draw(device, bare, camera)
        assert np.abs(difference).max() <= 1.0, settings


@pytest.mark.parametrize("name", TECHNIQUES)
def test_every_technique_has_the_same_occlusion(name: str) -> None:
    scene = make_corner()
    scene.lights.add_point((2.0, 3.0, 0.5), 6.0, intensity=2.0)
    with open_device("gl") as gl:
        expected, image = draw(gl, scene), draw(gl, scene, technique=TECHNIQUES[name]())
        scene.ambient_occlusion = None
        bare = draw(gl, scene, technique=TECHNIQUES[name]())
    assert np.abs(bare - image).mean() > 0.5, "the control: it is in the image"
    assert np.abs(image - expected).mean() < 0.5
    assert np.abs(image - expected).max() < 8.0  # techniques store normals and light with few bits


@pytest.mark.parametrize(
    "name", ["forward", "clustered", "tiled_deferred", "clustered_deferred", "deferred_plus"]
)
def test_samples_of_a_pixel_have_its_occlusion(name: str) -> None:
    scene = make_corner()
    scene.lights.add_point((2.0, 3.0, 0.5), 6.0, intensity=2.0)
    with open_device("gl") as gl:
        single, multiple = (
            draw(gl, scene, technique=TechniqueSettings(name, samples=samples).make_technique(name))
            for samples in (1, 4)
        )
    assert np.median(np.abs(single - multiple)) <= 1.0
    assert np.abs(single - multiple).mean() < 1.5  # edges differ


@pytest.mark.parametrize(
    ("change", "limit"),
    [
        (lambda camera: camera.with_projection(replace(camera.projection, depth=Depth.STANDARD)), 1.5),
        (lambda camera: camera.with_projection(replace(camera.projection, far=np.inf)), 0.5),
        (lambda camera: camera.with_projection(replace(camera.projection, near=1.0)), 0.5),
    ],
    ids=["standard depth", "endless", "far near plane"],
)
def test_the_way_in_which_depth_is_stored_changes_little(
    change: Callable[[Camera], Camera], limit: float
) -> None:
    camera = EYE.with_projection(Perspective(aspect=2.0, near=0.1, far=1000.0))
    with open_device("gl") as gl:
        expected, image = draw(gl, make_corner(), camera), draw(gl, make_corner(), change(camera))
    assert np.abs(expected - image).mean() < limit


@pytest.mark.parametrize("offset", [0.0, 1e5, 1e7])
def test_occlusion_is_the_same_far_from_the_origin(offset: float) -> None:
    moved = (offset, 0.0, -offset)
    camera = Camera.look_at(np.add((3.0, 4.0, 0.0), moved), np.add((1.0, 0.0, 0.0), moved)).with_aspect(2.0)
    with open_device("gl") as gl:
        expected = draw(gl, make_corner())
        image = draw(gl, make_scene(FLOOR, WALL, BLOCK, at=moved), camera)
    assert np.abs(expected - image).mean() < 0.1


def test_each_eye_of_a_pair_has_the_occlusion_of_its_view() -> None:
    """Eyes have skewed projections; with no distance between them they see what one eye sees."""

    def draw_eyes(distance: float, radius: float | None) -> list[Floats]:
        scene = make_scene(FLOOR, WALL, BLOCK, radius=radius)
        with Renderer(gl, scene, visibility="frustum", size=SIZE) as renderer:
            renderer.stereo = Stereo(StereoRig(distance, 4.0), "color")
            eyes = renderer.render(EYE).eye_images
            return [eye.read()[..., 0].astype(np.float64) for eye in eyes]

    with open_device("gl") as gl:
        expected = draw(gl, make_corner())
        close, apart, bare = draw_eyes(0.0, RADIUS), draw_eyes(0.3, RADIUS), draw_eyes(0.3, None)
    assert [float(np.abs(eye - expected).mean()) < 0.1 for eye in close] == [True, True]
    assert [float((open_eye - eye).mean()) > 2.0 for eye, open_eye in zip(apart, bare, strict=True)] == [
        True,
        True,
    ]


def test_transparent_surfaces_dont_take_the_occlusion_of_surfaces_behind_them() -> None:
    def make(radius: float | None) -> Scene:
        builder = make_boxes(FLOOR, WALL, BLOCK, **WHITE)
        builder.lights.sky = builder.lights.ground = (1.0, 1.0, 1.0)
        glass = builder.add_material(**{**WHITE, "base_color": (0.2, 0.9, 0.2, 1.0 - 1e-3)},
                                     alpha_mode=AlphaMode.BLEND)  # fmt: skip
        pane = builder.add_node(translation((2.0, 2.0, 0.0)) @ scaling((4.0, 0.01, 8.0)))
        builder.add_objects(pane, builder.add_mesh(BUILT_IN["box"]()), glass)
        builder.ambient_occlusion = None if radius is None else AmbientOcclusion(radius)
        return builder.build()

    with open_device("gl") as gl:
        difference = np.abs(draw(gl, make(RADIUS)) - draw(gl, make(None)))
    assert difference.max() <= 1.0


def test_a_scene_without_it_has_none_of_its_passes() -> None:
    assert list_passes(make_scene(FLOOR, WALL, radius=None)) == ["forward"]
    with_occlusion = ["depth", "ambient occlusion", "smooth ambient occlusion", "forward"]
    assert list_passes(make_scene(FLOOR, WALL)) == with_occlusion


def test_techniques_that_draw_depth_anyway_draw_no_more() -> None:
    names = list_passes(make_corner(), technique=TECHNIQUES["deferred"]())
    assert names == ["geometry", "ambient occlusion", "smooth ambient occlusion", "resolve"]


@pytest.mark.parametrize(
    "reason",
    ["no ambient light", "faint ambient light", "a radius of less than a pixel", "a view of the sky"],
)
def test_occlusion_that_changes_nothing_isnt_computed(reason: str) -> None:
    scene, camera = make_scene(FLOOR, WALL), EYE
    if reason == "a view of the sky":
        camera = Camera.look_at((3.0, 4.0, 0.0), (3.0, 9.0, 0.1)).with_aspect(2.0)
        camera = camera.with_projection(replace(camera.projection, fov=0.2))
    elif reason == "a radius of less than a pixel":
        scene.ambient_occlusion = AmbientOcclusion(1e-7)
    else:
        light = 0.0 if reason == "no ambient light" else 1e-5
        scene.lights.sky = scene.lights.ground = (light, light, light)
    assert list_passes(scene, camera) == ["forward"]


def test_without_smoothing_one_pass_less_runs() -> None:
    with (
        rhi.create_device("null") as device,
        Renderer(device, make_corner(), visibility="frustum", size=SIZE) as renderer,
    ):
        renderer.occlusion = OcclusionSettings(is_smooth=False)
        effects, plan = renderer.plan(EYE)
    assert [frame_pass.name for frame_pass in plan.passes] == ["depth", "ambient occlusion", "forward"]
    assert "take ambient light away" in effects.explain(Effect.AMBIENT_OCCLUSION)


def test_it_may_be_exchanged_between_frames() -> None:
    scene = make_corner()
    with open_device("gl") as gl, Renderer(gl, scene, visibility="frustum", size=SIZE) as renderer:

        def render() -> Floats:
            return renderer.render(EYE).image.read()[..., 0].astype(np.float64)

        near = render()
        scene.ambient_occlusion = AmbientOcclusion(4.0)
        far = render()
        scene.ambient_occlusion = None
        bare = render()
        scene.ambient_occlusion = AmbientOcclusion(RADIUS)
        assert np.array_equal(render(), near)
    assert far.mean() < near.mean() < bare.mean()


@pytest.mark.parametrize("radius", [0.0, -1.0, float("nan"), float("inf"), 1.1e6])
def test_a_radius_out_of_range_is_refused(radius: float) -> None:
    with pytest.raises(ValidationError, match="scene-bad-effect"):
        AmbientOcclusion(radius)


def test_the_largest_radius_is_drawn() -> None:
    with open_device("gl") as gl:
        image = draw(gl, make_scene(FLOOR, WALL, radius=1e6))
    assert np.isfinite(image).all()
    assert image.min() > 0.0


@pytest.mark.parametrize("name", ["slices", "steps", "bits"])
@pytest.mark.parametrize("value", [0, -1, 65, 2.5, "4"])
def test_settings_out_of_range_are_refused(name: str, value: Any) -> None:
    with pytest.raises(ValidationError, match="occlusion-bad-settings"):
        replace(OcclusionSettings(), **{name: value})


def test_settings_are_kept_in_files(tmp_path: Any) -> None:
    settings = RenderSettings(occlusion=OcclusionSettings(3, 7, False, 16))
    settings.save(tmp_path / "settings.json")
    assert RenderSettings.load(tmp_path / "settings.json") == settings


def test_forward_shading_with_occlusion_draws_each_object_twice() -> None:
    """Depth first, and then the surfaces that are seen; full-screen passes are a draw each."""
    counts = []
    for radius in (None, RADIUS):
        with (
            rhi.create_device("null") as device,
            Renderer(device, make_scene(FLOOR, WALL, radius=radius), technique=Forward(), visibility="frustum",
                     size=SIZE) as renderer,
        ):  # fmt: skip
            renderer.render(EYE)
            device.reset_statistics()
            renderer.render(EYE)
            counts.append(device.statistics.draws)
    assert counts[1] == 2 * counts[0] + 2
