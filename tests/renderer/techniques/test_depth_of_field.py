"""Depth of field: compared with rays through an aperture, alike in all techniques, and for nothing where nothing needs
it."""

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
from renderer.frame import BloomSettings, DepthOfFieldSettings, Effect
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.lab.measure.ray_tracer.tracer import inverse_tone_map
from renderer.renderer import Renderer
from renderer.scene import (
    AlphaMode,
    Bloom,
    Camera,
    Depth,
    DepthOfField,
    Fog,
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

SIZE = (192, 96)
FINE = DepthOfFieldSettings(samples=1024, max_radius=0.5, bits=32)
APERTURE = DepthOfField(focus_distance=5.0, aperture_radius=0.2)
GREY = {"base_color": (0.5, 0.5, 0.5, 1.0), "specular_color": (0.0, 0.0, 0.0), "rim_strength": 0.0}
EYE = Camera.look_at((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), projection=Perspective(1.0, 2.0, 0.1))
"""The camera of all tests, whose focus is at z = 0."""
PASSES = ["circles of confusion", "near discs", "depth of field"]


def make_plate(x: float, z: float, width: float, height: float = 2.0) -> Floats:
    """The transform of a thin plate that faces the eye."""
    plate: Floats = translation((x, 0.0, z)) @ scaling((width, height, 0.01))
    return plate


NEAR = make_plate(-0.6, 2.5, 0.5)
SHARP = make_plate(0.8, 0.0, 1.4)
FAR = make_plate(0.0, -8.0, 6.0, 4.0)


def make_scene(
    *transforms: Any, aperture: DepthOfField | None = APERTURE, at: tuple[float, float, float] = (0, 0, 0)
) -> Scene:
    """Make grey plates in the sky's light."""
    builder = make_boxes(*(translation(at) @ transform for transform in transforms), **GREY)
    builder.lights.sky = builder.lights.ground = (1.0, 1.0, 1.0)
    builder.background = (0.0, 0.0, 0.0)
    builder.depth_of_field = aperture
    return builder.build()


def draw(device: rhi.Device, scene: Scene, camera: Camera = EYE, **options: Any) -> Floats:
    """Draw a frame; return its red levels (h, w)."""
    options.setdefault("depth_of_field", FINE)
    with Renderer(device, scene, visibility="frustum", size=SIZE, **options) as renderer:
        return renderer.render(camera).image.read()[..., 0].astype(np.float64)


def list_passes(scene: Scene, camera: Camera = EYE, technique: Any = None) -> list[str]:
    with (
        rhi.create_device("null") as device,
        Renderer(device, scene, technique=technique, visibility="frustum", size=SIZE) as renderer,
    ):
        return [frame_pass.name for frame_pass in renderer.plan(camera)[1].passes]


@cache
def trace_row(z: float, camera: Camera = EYE) -> Floats:
    """The middle row of a plate's image by rays, (w,)."""
    pixels = np.stack([np.arange(SIZE[0]) + 0.5, np.full(SIZE[0], 0.5 * SIZE[1])], axis=1)
    tracer = RayTracer(make_scene(make_plate(0.0, z, 0.2 * (5.0 - z), 9.0)))
    return tracer.trace(camera, SIZE, pixels)[:, 0]


def measure_width(row: Floats) -> float:
    """The width in pixels of the edges of a row: the integral of 6 s (1 - s) of a rise s, which is that of a ramp."""
    share = row / row.max()
    return float(6.0 * (share * (1.0 - share)).sum() / 2.0)


def decode(levels: Floats) -> Floats:
    share = levels / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


@pytest.fixture(params=["gl", "cl", "wgpu"])
def device(request: pytest.FixtureRequest) -> Any:
    with open_device(request.param) as opened:
        yield opened


@pytest.mark.nightly_cases("cl", "wgpu", reason=ONLY_KERNELS)
@pytest.mark.parametrize("z", [3.5, 2.0, -5.0, -30.0])
def test_edges_are_as_wide_as_rays_through_the_aperture_make_them(device: rhi.Device, z: float) -> None:
    scene = make_scene(make_plate(0.0, z, 0.2 * (5.0 - z), 9.0))
    width, traced = (measure_width(row) for row in (decode(draw(device, scene)[SIZE[1] // 2]), trace_row(z)))
    assert traced > 2.0, "the control: there is an edge to measure"
    assert abs(width - traced) < 0.06 * traced + 0.4


def test_backends_draw_alike() -> None:
    images = []
    for name in ("gl", "cl", "wgpu"):
        with open_device(name) as opened:
            images.append(draw(opened, make_scene(NEAR, SHARP, FAR), depth_of_field=DepthOfFieldSettings()))
    for image in images[1:]:
        difference = np.abs(image - images[0])
        assert difference.mean() < 0.05
        assert np.percentile(difference, 99.5) <= 1.0  # a sample that rounds to another pixel


def test_near_plates_spill_over_the_background_beside_sharp_ones() -> None:
    with open_device("gl") as gl:
        image = draw(gl, make_scene(make_plate(-1.4, 0.0, 2.0), make_plate(0.5, 2.5, 0.5)))
        bare = draw(gl, make_scene(make_plate(-1.4, 0.0, 2.0), make_plate(0.5, 2.5, 0.5), aperture=None))
    row, bare_row = image[SIZE[1] // 2], bare[SIZE[1] // 2]
    first = int(np.flatnonzero(bare_row[96:] > 0)[0]) + 96  # the plate's left edge
    assert bare_row[first - 2] == 0.0, "the control: the pixel is beside the plate"
    assert row[first - 2] > 20.0
    assert row[first + 2] < bare_row[first + 2]


def test_sharp_plates_take_no_light_from_blurred_lights_behind_them() -> None:
    def build(aperture: DepthOfField | None) -> Scene:
        builder = make_boxes(SHARP, **GREY)
        bulb = builder.add_material(base_color=(1.0, 1.0, 1.0), emission=50.0)
        builder.add_objects(builder.add_node(FAR), builder.add_mesh(BUILT_IN["box"]()), bulb)
        builder.lights.sky = builder.lights.ground = (0.2, 0.2, 0.2)
        builder.depth_of_field = aperture
        return builder.build()

    with open_device("gl") as gl:
        image, bare = draw(gl, build(APERTURE)), draw(gl, build(None))
    is_plate = bare < 200.0
    is_plate[:, : SIZE[0] // 2] = False
    is_plate[:24] = is_plate[-24:] = False
    columns = np.flatnonzero(is_plate[SIZE[1] // 2])
    assert len(columns) > 20
    assert np.abs(image - bare)[SIZE[1] // 2, columns[0] : columns[-1] + 1].max() <= 1.0


def test_light_far_out_of_focus_keeps_its_sum() -> None:
    """A small bright box becomes a disc with as much light."""

    def build(aperture: DepthOfField | None) -> Scene:
        builder = make_boxes(**GREY)
        bulb = builder.add_material(base_color=(1.0, 1.0, 1.0), emission=1.0)
        builder.add_objects(
            builder.add_node(translation((0.0, 0.0, -5.0)) @ scaling((0.6, 0.6, 0.6))),
            builder.add_mesh(BUILT_IN["box"]()),
            bulb,
        )
        builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
        builder.background, builder.depth_of_field = (0.0, 0.0, 0.0), aperture
        return builder.build()

    with open_device("gl") as gl:
        sharp, disc = (
            inverse_tone_map(decode(draw(gl, build(aperture)))) for aperture in (None, DepthOfField(5.0, 0.6))
        )
    assert disc.max() < 0.5 * sharp.max(), "the control: the bulb is a larger disc"
    assert disc.sum() == pytest.approx(sharp.sum(), rel=0.03)


@pytest.mark.parametrize("name", TECHNIQUES)
def test_every_technique_has_the_same_blur(name: str) -> None:
    scene = make_scene(NEAR, SHARP, FAR)
    scene.lights.add_point((0.0, 1.0, 3.0), 6.0, intensity=2.0)
    with open_device("gl") as gl:
        expected, image = draw(gl, scene), draw(gl, scene, technique=TECHNIQUES[name]())
        scene.depth_of_field = None
        bare = draw(gl, scene, technique=TECHNIQUES[name]())
    assert np.abs(bare - image).mean() > 2.0, "the control: it is in the image"
    assert np.abs(image - expected).mean() < 0.5
    assert np.abs(image - expected).max() < 8.0  # techniques store normals and light with few bits


@pytest.mark.parametrize("name", ["forward", "tiled_deferred", "deferred_plus"])
def test_samples_of_a_pixel_are_blurred_together(name: str) -> None:
    with open_device("gl") as gl:
        single, multiple = (
            draw(gl, make_scene(NEAR, SHARP, FAR), technique=technique.make_technique(name))
            for technique in (TechniqueSettings(name, samples=samples) for samples in (1, 4))
        )
    assert np.median(np.abs(single - multiple)) <= 1.0
    assert np.abs(single - multiple).mean() < 1.5  # edges differ


@pytest.mark.parametrize(
    "change",
    [
        lambda camera: camera.with_projection(replace(camera.projection, depth=Depth.STANDARD)),
        lambda camera: camera.with_projection(replace(camera.projection, far=np.inf)),
        lambda camera: camera.with_projection(replace(camera.projection, near=1.0)),
    ],
    ids=["standard depth", "endless", "far near plane"],
)
def test_the_way_in_which_depth_is_stored_changes_nothing(change: Callable[[Camera], Camera]) -> None:
    camera = EYE.with_projection(Perspective(1.0, 2.0, 0.1, far=1000.0))
    scene = make_scene(NEAR, SHARP, FAR)
    with open_device("gl") as gl:
        expected, image = draw(gl, scene, camera), draw(gl, scene, change(camera))
    assert np.abs(expected - image).mean() < 0.05


@pytest.mark.parametrize("offset", [1e5, 1e7])
def test_blur_is_the_same_far_from_the_origin(offset: float) -> None:
    moved = (offset, 0.0, -offset)
    camera = Camera(EYE.position + np.array(moved), EYE.rotation, EYE.projection)
    with open_device("gl") as gl:
        expected = draw(gl, make_scene(NEAR, SHARP, FAR))
        image = draw(gl, make_scene(NEAR, SHARP, FAR, at=moved), camera)
    assert np.abs(expected - image).mean() < 0.1


@pytest.mark.parametrize("output", ["side_by_side", "over_under", "interlaced"])
def test_eyes_have_the_blur_of_their_own_cameras(output: str) -> None:
    """Also where pixels aren't square: a disc is as wide as high on the screen."""
    scene = make_scene(NEAR, SHARP, FAR)
    rig = StereoRig(eye_distance=1e-4, convergence=5.0)
    with open_device("gl") as gl:
        mono = draw(gl, scene)
        with Renderer(gl, scene, visibility="frustum", size=SIZE, depth_of_field=FINE) as renderer:
            renderer.stereo = Stereo(rig, output)
            eyes = [image.read()[..., 0].astype(np.float64) for image in renderer.render(EYE).eye_images]
    height, width = eyes[0].shape
    mono = mono.reshape(height, SIZE[1] // height, width, SIZE[0] // width).mean(axis=(1, 3))
    for eye in eyes:
        assert np.abs(eye - mono).mean() < 2.0
        assert np.median(np.abs(eye - mono)) <= 1.0


def test_glass_is_blurred_with_the_surface_behind_it() -> None:
    builder = make_boxes(NEAR, FAR, **GREY)
    builder.lights.sky = builder.lights.ground = (1.0, 1.0, 1.0)
    glass = builder.add_material(base_color=(0.9, 0.9, 0.9, 0.5), alpha_mode=AlphaMode.BLEND)
    builder.add_objects(builder.add_node(SHARP), builder.add_mesh(BUILT_IN["box"]()), glass)
    builder.depth_of_field = APERTURE
    assert list_passes(builder.build()) == ["forward", "transparency", *PASSES]


def test_a_scene_without_it_has_none_of_its_passes() -> None:
    assert list_passes(make_scene(NEAR, aperture=None)) == ["forward"]
    assert list_passes(make_scene(NEAR)) == ["forward", *PASSES]


def test_bloom_is_of_the_blurred_light() -> None:
    builder = make_boxes(NEAR, **{**GREY, "emission": 20.0})
    builder.bloom, builder.depth_of_field = Bloom(0.3), APERTURE
    scene = builder.build()
    assert list_passes(scene) == ["forward", *PASSES, "bloom", "tone mapping"]
    with open_device("gl") as gl:
        both = draw(gl, scene)
        scene.bloom = None
        blurred = draw(gl, scene)
        scene.bloom, scene.depth_of_field = Bloom(1e-9), APERTURE
        faint = draw(gl, scene, bloom=BloomSettings(bits=32))
    assert np.abs(faint - blurred).max() <= 1.0, "bloom without strength changes nothing"
    assert (both - blurred).max() > 5.0


@pytest.mark.parametrize("reason", ["an aperture of less than a pixel", "a view of the sky"])
def test_blur_that_changes_nothing_isnt_computed(reason: str) -> None:
    scene, camera = make_scene(NEAR), EYE
    if reason == "a view of the sky":
        camera = Camera.look_at((0.0, 0.0, 5.0), (0.0, 0.0, 9.0), projection=EYE.projection)
    else:
        scene.depth_of_field = DepthOfField(5.0, 1e-9)
    assert list_passes(scene, camera) == ["forward"]
    scene.fog = Fog(0.1)
    assert (list_passes(scene, camera) == ["forward", "sky", *PASSES]) == (reason == "a view of the sky")


def test_a_frame_without_it_has_as_many_commands_and_bytes_as_if_it_had_never_been() -> None:
    def count(aperture: DepthOfField | None) -> tuple[int, int, int]:
        with (
            rhi.create_device("null") as device,
            Renderer(
                device,
                make_scene(NEAR, aperture=aperture),
                technique=Forward(),
                visibility="frustum",
                size=SIZE,
            ) as renderer,
        ):
            renderer.render(EYE)
            device.reset_statistics()
            renderer.render(EYE)
            plan = renderer.plan(EYE)[1]
            return device.statistics.draws, len(plan.passes), plan.count_bytes(SIZE)

    (draws, passes, size), unseen, blurred = count(None), count(DepthOfField(5.0, 1e-9)), count(APERTURE)
    assert unseen == (draws, passes, size)
    assert blurred[:2] == (draws + 4, passes + 3)
    pixels, blocks = SIZE[0] * SIZE[1], 12 * 6
    assert (
        blurred[2] - size == (8 + 8) * pixels + 2 * 2 * blocks
    )  # light, circles, and two discs for each block


def test_the_reason_is_part_of_the_plan() -> None:
    with (
        rhi.create_device("null") as device,
        Renderer(device, make_scene(NEAR), visibility="frustum", size=SIZE) as renderer,
    ):
        effects, _ = renderer.plan(EYE)
        assert effects.explain(Effect.DEPTH_OF_FIELD) == "what is out of focus is seen as discs"
        renderer.scene.depth_of_field = DepthOfField(5.0, 1e-9)
        assert "less than a pixel" in renderer.plan(EYE)[0].explain(Effect.DEPTH_OF_FIELD)


def test_the_aperture_may_be_exchanged_between_frames() -> None:
    scene = make_scene(NEAR, SHARP, FAR)
    with open_device("gl") as gl, Renderer(gl, scene, visibility="frustum", size=SIZE) as renderer:

        def render() -> Floats:
            return renderer.render(EYE).image.read()[..., 0].astype(np.float64)

        middle = render()
        scene.depth_of_field = DepthOfField(2.5, 0.2)
        near = render()
        scene.depth_of_field = None
        bare = render()
        scene.depth_of_field = APERTURE
        assert np.array_equal(render(), middle)
    images = [middle, near, bare]
    assert all(np.abs(images[i] - images[i - 1]).mean() > 1.0 for i in range(3))


def test_errors_fall_with_samples() -> None:
    scene = make_scene(NEAR, SHARP, FAR)
    with open_device("gl") as gl:
        best = draw(gl, scene)
        errors = [
            np.abs(draw(gl, scene, depth_of_field=replace(FINE, samples=samples)) - best).mean()
            for samples in (8, 32, 128, 512)
        ]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 2.0 * errors[-1]


@pytest.mark.parametrize("name", ["focus_distance", "aperture_radius"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf"), 1.1e6])
def test_an_aperture_out_of_range_is_refused(name: str, value: float) -> None:
    with pytest.raises(ValidationError, match="scene-bad-effect"):
        replace(APERTURE, **{name: value})


@pytest.mark.parametrize(
    "aperture", [DepthOfField(1e-6, 1e6), DepthOfField(1e6, 1e-3), DepthOfField(1e6, 1e6)]
)
@pytest.mark.parametrize("is_parallel", [False, True])
def test_the_largest_and_the_smallest_aperture_are_drawn(aperture: DepthOfField, is_parallel: bool) -> None:
    camera = EYE.with_projection(Orthographic(4.0, 2.0, 0.1, 50.0)) if is_parallel else EYE
    with open_device("gl") as gl:
        image = draw(
            gl, make_scene(NEAR, SHARP, FAR, aperture=aperture), camera, depth_of_field=DepthOfFieldSettings()
        )
    assert image.max() > 10.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("samples", 7),
        ("samples", 1025),
        ("samples", 8.0),
        ("max_radius", 0.0),
        ("max_radius", 0.51),
        ("bits", 11),
    ],
)
def test_settings_out_of_range_are_refused(name: str, value: Any) -> None:
    with pytest.raises(ValidationError, match="focus-bad-settings"):
        replace(DepthOfFieldSettings(), **{name: value})


def test_settings_are_kept_in_files(tmp_path: Any) -> None:
    settings = RenderSettings(depth_of_field=DepthOfFieldSettings(32, 0.1, 32))
    settings.save(tmp_path / "settings.json")
    assert RenderSettings.load(tmp_path / "settings.json") == settings
