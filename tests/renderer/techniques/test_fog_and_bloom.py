"""Fog and bloom in frames: what they show with each technique, and the order of their passes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bloom_reference import add_bloom
from fog_reference import integrate_fog
from frames import SIZE, draw, open_renderer, read_colors
from lighting_reference import compute_pixel_rays, encode, tone_map
from numpy.typing import NDArray

import rhi
from renderer import scene as scenes
from renderer.content import BUILT_IN
from renderer.frame import Blending, BloomSettings
from renderer.layers.overlay import Overlay
from renderer.shaders.tone_mapping import inverse_tone_map
from renderer.stereo import Stereo
from renderer.techniques import TECHNIQUES, Forward, FxaaTechnique, Technique
from rhi import Format, Op

EYE = scenes.Camera.look_at((0, 3, 9), (0, 2, 0), projection=scenes.Perspective(aspect=SIZE[0] / SIZE[1]))
FOG = scenes.Fog(0.08, (0.3, 0.5, 0.4), 0.15, base=1.0)
GROUND = scenes.make_geometry([(-1, 0, -1), (-1, 0, 1), (1, 0, 1), (1, 0, -1)], [(0, 1, 2), (0, 2, 3)])
PANE = scenes.make_geometry([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2), (0, 2, 3)])


def stage(*, panes: bool = False, lights: bool = False, emission: float = 1.0) -> scenes.SceneBuilder:
    """Make a ground and a box that shine, before a sky."""
    builder = scenes.SceneBuilder("stage")
    builder.background = (0.1, 0.2, 0.6)
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
    plain = builder.add_material(base_color=(0.5, 0.4, 0.3), specular_color=(0, 0, 0), emission=1.0)
    bright = builder.add_material(base_color=(1.0, 0.6, 0.2), specular_color=(0, 0, 0), emission=emission)
    builder.add_objects(builder.add_node(scenes.scaling((40, 1, 40))), builder.add_mesh(GROUND), plain)
    position = scenes.translation((-2.0, 2.2, 0.0))
    builder.add_objects(builder.add_node(position), builder.add_mesh(BUILT_IN["box"]()), bright)
    if panes:
        for z, color in ((2.0, (0.9, 0.1, 0.1, 0.5)), (4.0, (0.1, 0.2, 0.9, 0.4))):
            glass = builder.add_material(
                base_color=color, specular_color=(0, 0, 0), emission=1.0, alpha_mode=scenes.AlphaMode.BLEND
            )
            builder.add_objects(
                builder.add_node(scenes.translation((1.5, 2.5, z))), builder.add_mesh(PANE), glass
            )
    if lights:
        builder.lights.add_point((1.0, 1.5, 1.0), 8.0, (1.0, 0.7, 0.3), 6.0)
        builder.lights.add_spot((-2.0, 5.0, 2.0), (0.0, -1.0, 0.0), 9.0, 0.4, 0.7, (0.4, 0.6, 1.0), 20.0)
    builder.views["eye"] = EYE
    return builder


def pixel_directions(camera: scenes.Camera) -> NDArray[np.float64]:
    """Return the unit direction (h, w, 3) of each pixel."""
    rays = compute_pixel_rays(camera, SIZE)
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def look_at_ground(
    fog: scenes.Fog, background: tuple[float, float, float], camera: scenes.Camera
) -> NDArray[np.float64]:
    """Return the light (h, w, 3) of an endless ground of the light (0.5, 0.4, 0.3) at a height of 0, in fog
    that is added up along each ray."""
    rays, eye, thinnest = pixel_directions(camera), camera.position[1], 1e-4
    light = np.zeros((*rays.shape[:2], 3))
    for pixel in np.ndindex(rays.shape[:2]):
        ray = rays[pixel]
        below = ray[1] < 0.0
        away = -eye / ray[1] if below else -np.log(thinnest) / max(fog.falloff * ray[1], 1e-9) * 3.0
        passing = integrate_fog(fog, eye, away * ray)
        seen = np.array((0.5, 0.4, 0.3) if below else inverse_tone_map(background))
        light[pixel] = passing * seen + (1.0 - passing) * np.array(inverse_tone_map(fog.color))
    return light


def plain(height: float, pitch: float, fog: scenes.Fog) -> tuple[scenes.Scene, scenes.Camera]:
    """Make a ground that reaches the horizon, and an eye above it."""
    builder = scenes.SceneBuilder("plain")
    builder.background, builder.fog = (0.1, 0.2, 0.6), fog
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
    material = builder.add_material(base_color=(0.5, 0.4, 0.3), specular_color=(0, 0, 0), emission=1.0)
    builder.add_objects(builder.add_node(scenes.scaling((2e4, 1, 2e4))), builder.add_mesh(GROUND), material)
    eye = np.array((0.0, height, 0.0))
    return builder.build(), scenes.Camera.look_at(
        eye, eye + np.array((0.0, np.tan(pitch), -1.0)), projection=EYE.projection
    )


PLAINS = {
    "inside": (3.0, 0.01, FOG),
    "above": (90.0, -0.5, FOG),
    "below the base": (3.0, 0.2, scenes.Fog(0.01, (0.3, 0.5, 0.4), 0.2, base=8.0)),
    "even": (3.0, -0.3, scenes.Fog(0.02, (0.3, 0.5, 0.4))),
}


@pytest.mark.parametrize("name", PLAINS)
def test_ground_and_sky_in_fog_are_within_a_level_of_float64(gl: rhi.Device, name: str) -> None:
    scene, camera = plain(*PLAINS[name])
    expected = encode(tone_map(look_at_ground(PLAINS[name][2], scene.background, camera)))
    assert np.ptp(expected, axis=(0, 1)).max() > 20
    # An 8-bit image is rounded, so half of a level is its own; float32 and the fast exp take less than the
    # other.
    assert np.abs(draw(gl, scene, camera=camera) - expected).max() <= 1.0


def test_gl_and_cl_show_the_same_fog_and_bloom(gl: rhi.Device) -> None:
    builder = stage(emission=12.0)
    builder.fog, builder.bloom = FOG, scenes.Bloom(0.2)
    scene = builder.build()
    with rhi.create_device("cl") as cl:
        assert np.abs(draw(gl, scene) - draw(cl, scene)).max() <= 1.0


SOME = ("forward_multipass", "deferred", "deferred_plus")
"""The techniques whose last passes differ; the others have one of these."""


@pytest.mark.parametrize(
    ("bloom", "techniques"),
    [
        pytest.param(scenes.Bloom(0.2), SOME, id="fog and bloom"),
        pytest.param(
            scenes.Bloom(0.2),
            tuple(TECHNIQUES),
            id="fog and bloom, all techniques",
            marks=pytest.mark.nightly,
        ),
        pytest.param(None, tuple(TECHNIQUES), id="fog, all techniques", marks=pytest.mark.nightly),
    ],
)
def test_each_technique_shows_the_fog_and_bloom_of_forward_shading(
    gl: rhi.Device, bloom: scenes.Bloom | None, techniques: tuple[str, ...]
) -> None:
    builder = stage(panes=True, lights=True, emission=12.0)
    builder.fog, builder.bloom, builder.haze = FOG, bloom, 0.01
    scene = builder.build()
    expected = draw(gl, scene)
    assert np.abs(expected - draw(gl, stage(panes=True, lights=True).build())).max() > 40
    for name in techniques:
        off = np.abs(draw(gl, scene, TECHNIQUES[name]()) - expected)
        # Inferred lighting filters the light of local lights, which is then elsewhere in the same air.
        assert off.mean() <= 3.0 if name == "inferred" else off.max() <= 2.0, name


@pytest.mark.nightly
@pytest.mark.parametrize("bloom", [None, scenes.Bloom(0.2)], ids=["fog", "fog and bloom"])
def test_each_technique_shows_the_same_on_cl(gl: rhi.Device, bloom: scenes.Bloom | None) -> None:
    builder = stage(panes=True, lights=True, emission=12.0)
    builder.fog, builder.bloom, builder.haze = FOG, bloom, 0.01
    scene = builder.build()
    with rhi.create_device("cl") as cl:
        for name, make in TECHNIQUES.items():
            assert np.abs(draw(gl, scene, make()) - draw(cl, scene, make())).max() <= 2.0, name


def test_bloom_of_a_scene_is_that_of_its_light_in_float64(gl: rhi.Device) -> None:
    builder = stage(emission=12.0)
    builder.bloom = scenes.Bloom(0.3)
    scene = builder.build()
    with open_renderer(gl, scene) as renderer:
        result = renderer.render(EYE)
        light = result.targets["bright_image"].read()[..., :3].astype(float)
        image = read_colors(result)
    assert light.max() == 12.0
    assert light[0, 0] == pytest.approx(inverse_tone_map(scene.background), rel=1e-3)
    assert np.abs(image - encode(tone_map(add_bloom(light, 0.3, 6)))).max() <= 1.0


def test_bloom_with_fewer_bits_is_off_by_their_rounding(gl: rhi.Device) -> None:
    builder = stage(emission=12.0)
    builder.bloom = scenes.Bloom(0.3)
    with open_renderer(gl, builder.build()) as renderer:
        images = {}
        for bits, format in ((11, Format.R11G11B10F), (16, Format.RGBA16F), (32, Format.RGBA32F)):
            renderer.bloom = BloomSettings(bits=bits)
            result = renderer.render(EYE)
            assert {result.targets[name].format for name in ("bright_image", "bloom 1", "bloom 6")} == {
                format
            }
            images[bits] = read_colors(result)
    errors = {bits: np.abs(images[bits] - images[32]).max() for bits in (11, 16)}
    assert 1.0 < errors[11] <= 8.0  # blue has 5 bits after the point, and levels add up
    assert errors[16] <= 1.0


def test_without_a_share_light_is_shown_as_it_is_without_bloom(gl: rhi.Device) -> None:
    builder = stage(lights=True, emission=12.0)
    builder.haze = 0.02
    plain_image = draw(gl, builder.build())
    builder = stage(lights=True, emission=12.0)
    builder.bloom = scenes.Bloom(1e-9)
    assert (
        np.abs(draw(gl, builder.build()) - draw(gl, stage(lights=True, emission=12.0).build())).max() <= 1.0
    )
    builder = stage(lights=True, emission=12.0)
    builder.haze, builder.bloom = 0.02, scenes.Bloom(1e-9)
    # Haze fades light instead of colours there.
    assert np.abs(draw(gl, builder.build()) - plain_image).max() <= 40.0


@pytest.mark.parametrize("blending", Blending)
def test_transparent_surfaces_have_the_fog_before_them(gl: rhi.Device, blending: Blending) -> None:
    """In even fog, all at one distance: fog before what is blended is what fog before each part makes of
    it."""
    builder = scenes.SceneBuilder("pane")
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
    glass = builder.add_material(
        base_color=(0.9, 0.5, 0.1, 0.6),
        specular_color=(0, 0, 0),
        emission=1.0,
        alpha_mode=scenes.AlphaMode.BLEND,
    )
    wall = builder.add_material(base_color=(0.1, 0.3, 0.9), specular_color=(0, 0, 0), emission=1.0)
    for z, material in ((0.0, wall), (1.0, glass)):
        node = builder.add_node(scenes.translation((0, 2, z)) @ scenes.scaling((40, 40, 1)))
        builder.add_objects(node, builder.add_mesh(PANE), material)
    builder.fog = scenes.Fog(0.05, (0.3, 0.5, 0.4))
    camera = scenes.Camera.look_at((0, 2, 9), (0, 2, 0), projection=EYE.projection)
    rays, through = pixel_directions(camera), []
    for away, color in ((9.0, (0.1, 0.3, 0.9)), (8.0, (0.9, 0.5, 0.1))):
        passing = np.exp(-0.05 * away / -rays[..., 2:])
        through.append(
            tone_map(passing * color + (1 - passing) * np.array(inverse_tone_map(builder.fog.color)))
        )
    expected = encode(0.6 * through[1] + 0.4 * through[0])
    assert np.abs(draw(gl, builder.build(), camera=camera, blending=blending) - expected).max() <= 2.0


CAMERAS = {
    "standard depth": EYE.with_projection(scenes.Perspective(depth=scenes.Depth.STANDARD)),
    "a far plane": EYE.with_projection(scenes.Perspective(far=30.0)),
    "parallel": EYE.with_projection(scenes.Orthographic(9.0, near=0.0, far=40.0)),
}


@pytest.mark.parametrize("projection", CAMERAS)
def test_any_projection_shows_the_fog_of_its_pixels(gl: rhi.Device, projection: str) -> None:
    builder = stage()
    builder.fog = FOG
    scene, camera = builder.build(), CAMERAS[projection].with_aspect(SIZE[0] / SIZE[1])
    image, deferred = draw(gl, scene, camera=camera), draw(gl, scene, TECHNIQUES["deferred"](), camera)
    assert np.abs(image - deferred).max() <= 2.0
    covered = draw(gl, stage().build(), camera=camera)
    sky = (covered == encode(np.array(scene.background)).round()).all(axis=2)
    assert sky.any()
    directions = (
        np.broadcast_to(camera.forward, (*SIZE[::-1], 3))
        if projection == "parallel"
        else pixel_directions(camera)
    )
    up = np.maximum(directions[sky][:, 1], 0.0)
    density = FOG.density * np.exp(-FOG.falloff * (3.0 - FOG.base))
    with np.errstate(divide="ignore"):
        passing = np.exp(-density / (FOG.falloff * up))[:, None]
    light = passing * inverse_tone_map(scene.background) + (1 - passing) * np.array(
        inverse_tone_map(FOG.color)
    )
    assert np.abs(image[sky] - encode(tone_map(light))).max() <= 1.0


def list_events(device: rhi.Device) -> list[str]:
    return [command["text"] for command in device.stream.filter(Op.PUSH_LABEL)]


ORDERS: dict[str, tuple[Callable[[], Technique], Blending, list[str]]] = {
    "forward": (Forward, Blending.SORTED, ["forward", "sky", "transparency", "bloom", "tone mapping"]),
    "weighted": (
        Forward,
        Blending.WEIGHTED,
        ["forward", "sky", "transparency", "blend", "bloom", "tone mapping"],
    ),
    "samples": (
        lambda: Forward(4),
        Blending.SORTED,
        ["depth", "forward", "sky", "transparency", "resolve", "bloom", "tone mapping"],
    ),
    "samples, weighted": (
        lambda: Forward(4),
        Blending.WEIGHTED,
        ["depth", "forward", "sky", "resolve", "transparency", "blend", "bloom", "tone mapping"],
    ),
    "fxaa": (
        lambda: FxaaTechnique(Forward()),
        Blending.SORTED,
        ["forward", "sky", "transparency", "bloom", "tone mapping", "fxaa"],
    ),
}


@pytest.mark.parametrize("name", ORDERS)
def test_the_sky_is_drawn_before_transparency_and_bloom_before_antialiasing(
    null: rhi.Device, name: str
) -> None:
    make, blending, expected = ORDERS[name]
    builder = stage(panes=True, emission=12.0)
    builder.fog, builder.bloom = FOG, scenes.Bloom()
    draw(null, builder.build(), make(), blending=blending)
    events = list_events(null)
    # Weighted surfaces may be drawn before the sky, over which they are blended.
    moved = (
        [event for event in events if event != "transparency"] if blending is Blending.WEIGHTED else events
    )
    assert moved == [event for event in expected if blending is Blending.SORTED or event != "transparency"]
    assert sorted(events) == sorted(expected)


def test_both_eyes_have_their_own_fog_and_bloom_and_layers_come_last(null: rhi.Device) -> None:
    builder = stage(emission=12.0)
    builder.fog, builder.bloom = FOG, scenes.Bloom()
    scene = builder.build()
    rolled = replace(EYE, rotation=np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]]) @ EYE.rotation)
    with open_renderer(null, scene) as renderer:
        renderer.stereo = Stereo(scenes.StereoRig(0.06, 10.0), "side_by_side")
        renderer.layers.append(Overlay(null))
        heights = [frame.camera.position[1] for frame in renderer.render(rolled).frames]
        events = list_events(null)
        eye_events = ["forward", "sky", "bloom", "tone mapping"]
        assert events[:9] == [*eye_events, "right eye", *eye_events]
        assert "overlay" in events[9:11]
        fogs = [command for command in null.stream.draws() if "fog" in command.bindings]
        assert len({command.bindings["fog"] for command in fogs}) == 2
        renderer.stereo = Stereo(scenes.StereoRig(0.06, 10.0), "side_by_side", is_reprojected=True)
        null.stream.clear()
        renderer.render(EYE)
        assert list_events(null)[:6] == [*eye_events, "right eye", "reprojection"]
    assert heights[0] != heights[1]


def test_samples_at_edges_of_the_sky_are_fogged(gl: rhi.Device) -> None:
    builder = stage()
    builder.fog = scenes.Fog(0.3, (1.0, 1.0, 1.0), 0.0)
    builder.background = (0.0, 0.0, 0.0)
    image = draw(gl, builder.build(), Forward(4))
    # The sky is white, and all else nearly so: a sample of the black background would show.
    box = draw(gl, builder.build())
    assert image.min() >= box.min() - 2.0


def test_settings_of_air_are_exchanged_between_frames(null: rhi.Device) -> None:
    builder = stage(emission=12.0)
    scene = builder.build()
    with open_renderer(null, scene) as renderer:
        renderer.render(EYE)
        null.stream.clear()
        for renderer.bloom in (BloomSettings(levels=2), BloomSettings(levels=4)):
            scene.fog, scene.bloom = FOG, scenes.Bloom(0.1)
            renderer.render(EYE)
            assert len(null.stream.draws()) == 2 + 2 * renderer.bloom.levels
            null.stream.clear()
        renderer.render(EYE)
        uploads = null.stream.filter(Op.WRITE_BUFFER)
        assert len(uploads) == 0  # nothing has moved
        scene.bloom = scenes.Bloom(0.2)
        renderer.render(EYE)
        assert len(null.stream.filter(Op.WRITE_BUFFER)) == 1


BAD = {
    "density": [0.0, -1.0, float("nan"), float("inf")],
    "falloff": [-1.0, float("nan"), float("inf")],
    "base": [float("nan"), float("inf")],
    "color": [(0.0, 0.0, float("nan")), (0.0, 0.0, 1.1), (0.0, 0.0)],
}


@pytest.mark.parametrize("name", BAD)
def test_fog_with_values_that_are_not_numbers_is_refused(name: str) -> None:
    for value in BAD[name]:
        with pytest.raises(rhi.ValidationError) as error:
            scenes.Fog(**({"density": 0.1} | {name: value}))  # type: ignore[arg-type]
        assert (error.value.rule.id, error.value.call) == ("scene-bad-effect", f"Fog({name}=...)")
