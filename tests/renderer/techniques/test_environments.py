"""Light from environments: compared with float64 sums, alike in all techniques, finite with a strong sun, and for
nothing where a scene has none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from frames import make_boxes
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.content import BUILT_IN
from renderer.content.skies import paint_sky
from renderer.frame import Effect, EnvironmentMaps, EnvironmentSettings
from renderer.frame.environment import compute_response, count_levels, make_levels, map_directions
from renderer.renderer import Renderer
from renderer.scene import (
    AlphaMode,
    Bloom,
    Camera,
    DepthOfField,
    Environment,
    Fog,
    Scene,
    SceneBuilder,
    scaling,
    translation,
)
from renderer.scene.arrays import Floats
from renderer.scene.environment import row_weights, texel_directions
from renderer.settings import RenderSettings
from renderer.techniques import TECHNIQUES, TechniqueSettings
from rhi import ValidationError
from tests.renderer.conftest import open_device

SIZE = (96, 54)
EYE = Camera.look_at((0.0, 1.6, 4.0), (0.0, 0.6, 0.0)).with_aspect(16 / 9)
SMALL = EnvironmentSettings(size=64, samples=64)


def make_sunny(strength: float, height: int = 64, radius: float = 0.02) -> NDArray[Any]:
    """Paint a sky with a disc of so much light."""
    sun = np.array([0.5, 0.7, -0.4]) / np.linalg.norm([0.5, 0.7, -0.4])
    is_sun = texel_directions(height, 2 * height) @ sun > np.cos(max(radius, np.pi / height))
    return np.where(is_sun[..., None], np.float32(strength), paint_sky(height=height))


def make_scene(environment: Environment | None, **changes: Any) -> Scene:
    """Make balls of three materials, and a pane of glass."""
    builder = SceneBuilder("balls")
    ball, box = builder.add_mesh(BUILT_IN["sphere"]()), builder.add_mesh(BUILT_IN["box"]())
    for number, material in enumerate(
        (
            {"base_color": (0.9, 0.7, 0.3), "metallic": 1.0, "roughness": 0.25},
            {"base_color": (0.6, 0.1, 0.1), "metallic": 0.0, "roughness": 0.6},
            {"base_color": (0.1, 0.1, 0.3), "specular_color": (0.4, 0.4, 0.4), "shininess": 40.0},
        )
    ):
        node = builder.add_node(translation((1.2 * number - 1.2, 0.6, 0.0)))
        builder.add_objects(node, ball, builder.add_material(**material))
    floor = builder.add_material(base_color=(0.5, 0.5, 0.5), specular_color=(0.0, 0.0, 0.0))
    builder.add_objects(
        builder.add_node(translation((0.0, -0.2, 0.0)) @ scaling((5.0, 0.2, 5.0))), box, floor
    )
    glass = builder.add_material(base_color=(0.2, 0.8, 0.3, 0.4), alpha_mode=AlphaMode.BLEND)
    builder.add_objects(
        builder.add_node(translation((0.9, 0.7, 1.0)) @ scaling((0.8, 0.8, 0.02))), box, glass
    )
    builder.lights.add_point((0.0, 2.0, 1.0), 4.0)
    builder.environment = environment
    for name, value in changes.items():
        setattr(builder, name, value)
    return builder.build()


def draw(device: rhi.Device, scene: Scene, camera: Camera = EYE, **options: Any) -> Floats:
    """Draw a frame; return its levels (h, w, 3)."""
    options = {"environment": SMALL, "visibility": "frustum", "size": SIZE} | options
    with Renderer(device, scene, **options) as renderer:
        return renderer.render(camera).image.read()[..., :3].astype(np.float64)


def list_passes(scene: Scene, camera: Camera = EYE, technique: Any = None) -> list[str]:
    with (
        rhi.create_device("null") as device,
        Renderer(device, scene, technique=technique, visibility="frustum", size=SIZE) as renderer,
    ):
        return [frame_pass.name for frame_pass in renderer.plan(camera)[1].passes]


def sum_lobe(image: NDArray[Any], normals: Floats, alpha: float) -> Floats:
    """The mean light (k, 3) of lobes of GGX along normals (k, 3), from texels of a quarter of the size."""
    fine = image.repeat(2, axis=0).repeat(2, axis=1).astype(np.float64)
    height, width = fine.shape[:2]
    directions, ring = texel_directions(height, width).reshape(-1, 3), np.repeat(row_weights(height), width)
    lit = np.maximum(normals @ directions.T, 0.0)
    half_sine = 0.5 - 0.5 * lit
    weight = lit * ring / (half_sine + alpha**2 * (1.0 - half_sine)) ** 2
    return (weight @ fine.reshape(-1, 3)) / weight.sum(axis=1, keepdims=True)


@pytest.fixture(params=["gl", "cl", "wgpu"])
def device(request: pytest.FixtureRequest) -> Any:
    with open_device(request.param) as opened:
        yield opened


@pytest.mark.nightly_cases("cl", "wgpu", reason=ONLY_KERNELS)
@pytest.mark.parametrize(("sun", "limit"), [(0.0, 0.03), (1e5, 0.35)])
def test_mirrored_light_is_the_mean_of_lobes(device: rhi.Device, sun: float, limit: float) -> None:
    """Relative to the brightest channel; a sun of two texels is spread by the map's own texels in the sharpest
    level, which is left out."""
    image, settings = make_sunny(sun) if sun else paint_sky(height=64), EnvironmentSettings(128, 256)
    maps = EnvironmentMaps(device)
    maps.update(Environment(image), settings)
    rng, count = np.random.default_rng(5), count_levels(128)
    scale = 2.0 ** np.ceil(np.log2(max(sun, 1.0) / 32768.0)) if sun > 32768.0 else 1.0
    for level in range(1, count):
        size = 128 >> level
        roughness = 0.1 * 10.0 ** (level / (count - 1))
        texels = maps.textures[1].read(level=level)[..., :3].astype(float)
        rows, columns = rng.integers(0, size, (2, 40))
        expected = sum_lobe(image, map_directions(size)[rows, columns], roughness**2)
        error = np.abs(texels[rows, columns] * scale - expected).max(axis=1) / expected.max(axis=1)
        assert np.isfinite(texels).all()
        assert error.max() < limit, (level, error.max())
        assert np.median(error) < 0.1 * limit + 0.004, (level, np.median(error))
    maps.destroy()


def test_scattered_light_is_a_sum_over_the_image() -> None:
    image = make_sunny(1e5, 32)
    with open_device("gl") as gl:
        maps = EnvironmentMaps(gl)
        maps.update(Environment(image), SMALL)
        texels = maps.textures[1].read(level=1, layer=1)[..., :3].astype(float) * 4.0
        maps.destroy()
    directions = texel_directions(32, 64).reshape(-1, 3)
    weights = np.repeat(row_weights(32) / 64.0, 64)
    for row, column in ((5, 7), (16, 16), (0, 0), (31, 14), (20, 28)):
        normal = map_directions(32)[row, column]
        light = np.maximum(directions @ normal, 0.0) * weights
        expected = light @ image.reshape(-1, 3).astype(np.float64) / np.pi
        assert texels[row, column] == pytest.approx(expected, rel=2e-3, abs=2e-4)


def test_the_borders_of_a_map_repeat_texels_of_the_same_edge() -> None:
    directions = map_directions(16)
    assert np.linalg.norm(directions, axis=2) == pytest.approx(np.ones((16, 16)))
    for row in range(1, 15):  # beyond an edge is the inside of the same edge, from the other end
        assert directions[row, 0] == pytest.approx(directions[15 - row, 1], abs=1e-12)
        assert directions[15, row] == pytest.approx(directions[14, 15 - row], abs=1e-12)


@pytest.mark.parametrize("shape", [(64, 128), (31, 67), (2, 2), (5, 300)])
def test_levels_of_an_image_have_all_of_its_light(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(2).random((*shape, 3), np.float32)
    levels = make_levels(image, 1024)
    sums = [np.einsum("h,hwc->c", row_weights(level.shape[0]) / level.shape[1], level) for level in levels]
    assert levels[-1].shape == (1, 1, 3)
    assert all(np.allclose(total, sums[0], rtol=0.02 if shape[0] % 2 else 1e-5) for total in sums)


def test_an_image_larger_than_textures_is_halved() -> None:
    levels = make_levels(np.ones((64, 128, 3), np.float32), 100)
    assert levels[0].shape == (32, 64, 3)
    assert levels[0] == pytest.approx(np.ones((32, 64, 3)))


def test_smooth_surfaces_respond_as_fresnel_says() -> None:
    """Straight on, a narrow lobe mirrors the specular colour and nothing else."""
    response = compute_response()
    assert response[0, -1] == pytest.approx((1.0, 0.0), abs=0.01)
    assert response[:, -1].sum(axis=1).max() <= 1.0
    assert (np.diff(response[:, -1, 0]) < 0.0).all(), "rough surfaces hide some of their lobe"


@pytest.mark.nightly_cases("cl", "wgpu", reason=ONLY_KERNELS)
def test_an_even_environment_lights_all_sides_alike(device: rhi.Device) -> None:
    builder = make_boxes(translation((0.0, 0.5, 0.0)), base_color=(0.5, 0.5, 0.5), specular_color=(0, 0, 0))
    image = np.full((4, 8, 3), 0.5, np.float32)
    builder.environment = Environment(image, intensity=2.0)
    levels = draw(device, builder.build())
    inside = levels[27:32, 44:52]
    assert np.ptp(inside) <= 1.0
    builder.environment = None
    builder.lights.sky = builder.lights.ground = (1.0, 1.0, 1.0)
    assert np.abs(inside - draw(device, builder.build())[27:32, 44:52]).max() <= 1.0


@pytest.mark.parametrize("name", TECHNIQUES)
def test_every_technique_has_the_same_light_and_sky(name: str) -> None:
    scene = make_scene(Environment(make_sunny(100.0), turn=0.4))
    with open_device("gl") as gl:
        expected = draw(gl, scene)
        image = draw(gl, scene, technique=TECHNIQUES[name]())
        scene.environment = None
        bare = draw(gl, scene, technique=TECHNIQUES[name]())
    assert np.abs(bare - image).mean() > 20.0, "the control: it is in the image"
    assert np.abs(image - expected).mean() < 0.5
    assert np.percentile(np.abs(image - expected), 99.5) <= (5.0 if name == "inferred" else 2.0)


@pytest.mark.parametrize("name", ["forward", "tiled_deferred", "clustered_deferred", "deferred_plus"])
def test_samples_of_a_pixel_have_the_sky_behind_them(name: str) -> None:
    scene = make_scene(Environment(make_sunny(100.0)))
    with open_device("gl") as gl:
        single, multiple = (
            draw(gl, scene, technique=TechniqueSettings(name, samples=samples).make_technique(name))
            for samples in (1, 4)
        )
    assert np.median(np.abs(single - multiple)) <= 1.0
    assert np.abs(single - multiple).mean() < 4.0  # edges differ


@pytest.mark.nightly_cases("cl", "wgpu", reason=ONLY_KERNELS)
@pytest.mark.parametrize("effects", [{}, {"bloom": Bloom(0.1), "depth_of_field": DepthOfField(4.0, 0.1)}])
def test_a_sun_of_a_hundred_millions_is_finite(device: rhi.Device, effects: dict[str, Any]) -> None:
    """Also as light that the camera spreads, which is kept in half floats."""
    plain = draw(device, make_scene(Environment(paint_sky(height=64)), **effects))
    for strength in (1e5, 1e8):
        levels = draw(device, make_scene(Environment(make_sunny(strength)), **effects))
        assert (levels >= plain - 3.0).mean() > 0.99, "light only adds"
        assert (levels.max(axis=2) > 0.0).mean() > 0.999, "no pixel is black, as one that isn't finite"


def test_the_sky_is_behind_everything_and_turns() -> None:
    """The middle of the image is seen along -z, and a quarter turn moves it to -x."""
    image = np.full((16, 32, 3), 0.02, np.float32)
    image[6:10, 14:18] = (1.0, 0.0, 0.0)
    scene = make_boxes(translation((0.0, -50.0, 0.0)))
    with open_device("gl") as gl:
        for turn, toward in ((0.0, (0, 0, -1)), (0.5 * np.pi, (-1, 0, 0)), (np.pi, (0, 0, 1))):
            scene.environment = Environment(image, turn=turn)
            camera = Camera.look_at((0, 0, 0), toward).with_aspect(16 / 9)
            middle = draw(gl, scene.build(), camera)[27, 48]
            assert middle[0] > 100.0, turn
            assert middle[1] < 60.0, turn


def test_fog_covers_the_sky_and_haze_does_not() -> None:
    environment = Environment(np.full((4, 8, 3), 0.8, np.float32))
    up = Camera.look_at((0, 2, 3), (0, 2.2, 0)).with_aspect(16 / 9)
    with open_device("gl") as gl:
        clear, hazy, fogged = (
            draw(gl, make_scene(environment, **air), up)[2, 48]
            for air in ({}, {"haze": 0.5}, {"fog": Fog(0.5, (0.1, 0.1, 0.5), 0.0)})
        )
    assert np.abs(clear - hazy).max() <= 1.0
    assert clear[0] - fogged[0] > 60.0


def test_a_hidden_environment_lights_and_is_not_seen() -> None:
    environment = Environment(paint_sky(height=64), is_visible=False)
    assert list_passes(make_scene(environment)) == ["environment", "forward", "transparency"]
    with open_device("gl") as gl:
        hidden, seen = (
            draw(gl, make_scene(each)) for each in (environment, replace(environment, is_visible=True))
        )
    assert np.abs(hidden[2, 5] - seen[2, 5]).max() > 60.0
    assert np.abs(hidden[50, 48] - seen[50, 48]).max() <= 1.0, "the floor is lit alike"


def test_a_scene_without_one_has_none_of_its_passes() -> None:
    assert list_passes(make_scene(None)) == ["forward", "transparency"]
    with_sky = ["environment", "forward", "sky box", "transparency"]
    assert list_passes(make_scene(Environment(paint_sky(height=64)))) == with_sky


def test_a_black_environment_leaves_no_ambient_light() -> None:
    scene = make_scene(Environment(np.zeros((4, 8, 3), np.float32), is_visible=False))
    scene.lights.sky = scene.lights.ground = (1.0, 1.0, 1.0)
    assert list_passes(scene) == ["forward", "transparency"]
    with open_device("gl") as gl:
        assert draw(gl, scene)[50, 20].max() < 90.0, "the point light alone"
        scene.environment = None
        assert draw(gl, scene)[50, 20].min() > 120.0


def test_a_view_of_nothing_has_the_sky_alone() -> None:
    scene = make_scene(Environment(paint_sky(height=64)))
    away = Camera.look_at((0, 40, 0), (0, 80, 1)).with_aspect(16 / 9)
    assert list_passes(scene, away) == ["environment", "forward", "sky box"]
    scene.environment = replace(scene.environment or Environment(paint_sky()), is_visible=False)
    assert list_passes(scene, away) == ["forward"]


def test_maps_are_made_once_and_again_for_another_image() -> None:
    image = paint_sky(height=32)
    with (
        rhi.create_device("null") as device,
        Renderer(
            device, make_scene(Environment(image)), visibility="frustum", size=SIZE, environment=SMALL
        ) as renderer,
    ):

        def count_draws() -> int:
            device.stream.clear()
            renderer.render(EYE)
            return len(device.stream.draws())

        first, steady = count_draws(), count_draws()
        assert first - steady == count_levels(SMALL.size), "a draw for each level"
        assert count_draws() == steady
        renderer.scene.environment = Environment(image, 0.5, 1.0)
        assert count_draws() == first
        renderer.environment = EnvironmentSettings(128, 64)
        assert count_draws() == steady + count_levels(128)
        renderer.scene.environment = None
        assert count_draws() < steady


def test_it_may_be_exchanged_between_frames() -> None:
    scene = make_scene(Environment(paint_sky(height=64)))
    with (
        open_device("gl") as gl,
        Renderer(gl, scene, visibility="frustum", size=SIZE, environment=SMALL) as renderer,
    ):
        first = renderer.render(EYE).image.read()
        scene.environment = replace(scene.environment or Environment(paint_sky()), intensity=2.0)
        brighter = renderer.render(EYE).image.read()
        scene.environment = None
        renderer.render(EYE)
        scene.environment = Environment(paint_sky(height=64))
        assert np.array_equal(renderer.render(EYE).image.read(), first)
    assert brighter.mean() > first.mean() + 10.0


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((4, 8, 3), np.uint8),
        np.zeros((4, 8, 3)),
        np.zeros((4, 8), np.float32),
        np.zeros((4, 8, 2), np.float32),
        np.zeros((1, 8, 3), np.float32),
        np.full((4, 8, 3), -1e-3, np.float32),
        np.full((4, 8, 3), np.nan, np.float32),
        np.full((4, 8, 3), np.inf, np.float16),
        np.full((4, 8, 3), 2e8, np.float32),
        None,
    ],
    ids=["uint8", "float64", "flat", "two channels", "a row", "negative", "nan", "inf", "too bright", "none"],
)
def test_images_that_arent_light_are_refused(image: Any) -> None:
    with pytest.raises(ValidationError, match="scene-bad-environment"):
        Environment(image)


@pytest.mark.parametrize("name", ["intensity", "turn"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1.1e6, "1", None, True])
def test_values_out_of_range_are_refused(name: str, value: Any) -> None:
    image = np.ones((2, 2, 4), np.float16)
    with pytest.raises(ValidationError, match="scene-bad-environment"):
        Environment(image, **{name: value})
    assert Environment(image, **{name: 1e6}).image.shape == (2, 2, 3)


@pytest.mark.parametrize(
    "change", [{"size": 100}, {"size": 32}, {"samples": 7}, {"samples": 4097}, {"samples": 8.0}]
)
def test_settings_out_of_range_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match="environment-bad-settings"):
        EnvironmentSettings(**change)


def test_settings_are_kept_in_files(tmp_path: Any) -> None:
    settings = RenderSettings(environment=EnvironmentSettings(512, 4096))
    settings.save(tmp_path / "settings.json")
    assert RenderSettings.load(tmp_path / "settings.json") == settings


def test_reasons_are_said() -> None:
    with (
        rhi.create_device("null") as device,
        Renderer(device, make_scene(Environment(paint_sky(height=32))), size=SIZE) as renderer,
    ):
        effects, _ = renderer.plan(EYE)
        renderer.scene.environment = None
        bare, _ = renderer.plan(EYE)
    assert effects.explain(Effect.ENVIRONMENT) == "the environment gives light"
    assert effects.explain(Effect.SKY_BOX) == "the environment is the background"
    assert bare.explain(Effect.SKY_BOX) == "the scene has no sky box"
