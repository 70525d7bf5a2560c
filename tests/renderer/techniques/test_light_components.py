"""Components of light: they add up to all light, each is what a scene with nothing else shows, and none costs frames
that draw all of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frames import first_view_camera, make_boxes
from material_scene import build_materials
from nightly_reasons import FEWER_CASES, ONLY_KERNELS

import rhi
from renderer.cli import main
from renderer.content.skies import paint_sky
from renderer.frame import COMPONENTS, DepthOfFieldSettings, Effect, LightComponent
from renderer.renderer import Renderer
from renderer.scene import AlphaMode, AmbientOcclusion, Bloom, Camera, DepthOfField, Environment, Fog, Scene
from renderer.scene.arrays import Floats
from renderer.techniques import TECHNIQUES, LightPrePass, ResourceCapture, Technique
from renderer.viewer.display_settings import DisplaySettings

SIZE = (72, 48)
PARTS = (LightComponent.DIFFUSE, LightComponent.SPECULAR, LightComponent.AMBIENT, LightComponent.EMISSIVE)
"""The components that add up to all light."""
EYE = Camera.look_at((0, 0, 10), (0, 0, 0))


def make_scene() -> Scene:
    """Make spheres of both models with all maps, before a black background, lit by lights of all kinds."""
    scene = build_materials()
    scene.lights.point["source_radius"][:3] = 0.15
    scene.lights.directional["casts_shadow"] = True
    scene.lights.spot["casts_shadow"][:1] = True
    scene.lights.add_rectangle((0.0, 2.0, 2.0), (0.0, -0.7, -0.7), 6.0, 1.0, 0.5, (0.3, 0.5, 1.0), 2.0)
    scene.background = (0.0, 0.0, 0.0)
    scene.refresh()
    return scene


def measure_light(
    device: rhi.Device,
    scene: Scene,
    component: LightComponent = LightComponent.ALL,
    technique: Technique | None = None,
) -> Floats:
    """Draw a frame out of focus; return its light (h, w, 3) before it is blurred and its tones are mapped."""
    scene.depth_of_field = DepthOfField(5.0, 0.5)
    capture = ResourceCapture(technique or TECHNIQUES["forward"](), "bright_image")
    with Renderer(
        device,
        scene,
        technique=capture,
        visibility="none",
        size=SIZE,
        depth_of_field=DepthOfFieldSettings(bits=32),
        light_component=component,
    ) as renderer:
        renderer.render(first_view_camera(scene))
    assert capture.texels is not None
    return capture.texels[..., :3].astype(np.float64)


def draw(device: rhi.Device, scene: Scene, **options: Any) -> Floats:
    """Draw a frame; return its levels (h, w, 3)."""
    with Renderer(device, scene, visibility="frustum", size=SIZE, **options) as renderer:
        return renderer.render(first_view_camera(scene)).image.read()[..., :3].astype(np.float64)


@pytest.mark.nightly_cases(
    *(name for name in TECHNIQUES if name not in ("forward", "deferred", "inferred")), reason=FEWER_CASES
)
@pytest.mark.parametrize("name", TECHNIQUES)
def test_diffuse_specular_ambient_and_emitted_light_are_all_light(gl: rhi.Device, name: str) -> None:
    scene = make_scene()
    whole = measure_light(gl, scene, technique=TECHNIQUES[name]())
    parts = [measure_light(gl, scene, part, TECHNIQUES[name]()) for part in PARTS]
    assert min(part.sum() for part in parts) > 0.005 * whole.sum()  # the control: none of them is empty
    rounding = 1e-3 if name == "tiled_deferred" else 1e-5  # whose light is half floats
    np.testing.assert_allclose(sum(parts), whole, rtol=rounding, atol=rounding)


@pytest.mark.nightly_cases("cl", "wgpu", reason=ONLY_KERNELS)
def test_components_add_up_on_each_backend(drawing_device: rhi.Device) -> None:
    scene = make_scene()
    whole = measure_light(drawing_device, scene)
    parts = [measure_light(drawing_device, scene, part) for part in PARTS]
    np.testing.assert_allclose(sum(parts), whole, rtol=1e-4, atol=1e-4)


def test_packed_terms_add_up_too(gl: rhi.Device) -> None:
    # Their specular light has the hue of the diffuse, which must be drawn for it though it isn't shown.
    scene = make_scene()
    technique = LightPrePass(specular_channels=1)
    whole = measure_light(gl, scene, technique=technique)
    parts = [measure_light(gl, scene, part, technique) for part in PARTS]
    assert parts[1].sum() > 0.05 * whole.sum()
    np.testing.assert_allclose(sum(parts), whole, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", ["forward", "deferred", "inferred"])
def test_the_sun_alone_is_a_scene_without_other_light(gl: rhi.Device, name: str) -> None:
    scene, sunny = make_scene(), build_materials(lights=False)
    sunny.lights.directional["casts_shadow"] = True
    sunny.lights.sky = sunny.lights.ground = sunny.background = (0.0, 0.0, 0.0)
    sunny.materials["emissive"] = sunny.materials["emission"] = 0.0
    sunny.refresh()
    alone = measure_light(gl, scene, LightComponent.SUN, TECHNIQUES[name]())
    np.testing.assert_allclose(alone, measure_light(gl, sunny, technique=TECHNIQUES[name]()), atol=1e-6)
    assert alone.max() > 0.1


def test_diffuse_light_is_that_of_a_scene_that_mirrors_nothing(gl: rhi.Device) -> None:
    def make(specular: float, sky: float) -> Scene:
        builder = make_boxes(
            (0, 0, 0), base_color=(0.5, 0.3, 0.2), specular_color=(specular,) * 3, shininess=9.0
        )
        builder.lights.add_point((1.0, 2.0, 3.0), 9.0)
        builder.lights.add_directional((-0.3, -0.5, -1.0))
        builder.lights.sky = builder.lights.ground = (sky,) * 3
        builder.background = (0.0, 0.0, 0.0)
        return builder.build()

    shiny, matt = make(0.6, 0.3), make(0.0, 0.0)
    diffuse = measure_light(gl, shiny, LightComponent.DIFFUSE)
    np.testing.assert_allclose(diffuse, measure_light(gl, matt), atol=1e-6)
    mirrored = measure_light(gl, shiny, LightComponent.SPECULAR)
    shiny.materials["base_color"][:, :3] = 0.0
    shiny.lights.sky = shiny.lights.ground = (0.0, 0.0, 0.0)
    shiny.refresh()
    np.testing.assert_allclose(mirrored, measure_light(gl, shiny), atol=1e-6)


def test_ambient_light_is_that_of_an_environment_with_its_occlusion(gl: rhi.Device) -> None:
    scene, dark = make_scene(), build_materials(lights=False)
    for changed in (scene, dark):
        changed.environment = Environment(paint_sky(height=16), is_visible=False)
        changed.ambient_occlusion = AmbientOcclusion(0.5)
        changed.background = (0.0, 0.0, 0.0)
    dark.lights.directional["intensity"] = 0.0
    dark.materials["emissive"] = dark.materials["emission"] = 0.0
    dark.refresh()
    ambient = measure_light(gl, scene, LightComponent.AMBIENT)
    np.testing.assert_allclose(ambient, measure_light(gl, dark), atol=1e-6)
    assert ambient.max() > 0.1


@pytest.mark.parametrize("name", TECHNIQUES)
def test_albedo_is_the_base_color_without_light_or_tones(gl: rhi.Device, name: str) -> None:
    builder = make_boxes((0, 0, 0), base_color=(0.25, 0.5, 0.75), metallic=0.8, roughness=0.4)
    builder.lights.add_point((1.0, 2.0, 3.0), 9.0)
    pixels = draw(gl, builder.build(), technique=name, light_component=LightComponent.ALBEDO)
    linear = np.array([0.25, 0.5, 0.75])
    encoded = 255.0 * (1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(pixels[SIZE[1] // 2, SIZE[0] // 2] - encoded).max() <= 1.0
    assert not pixels[0, 0].any()  # the background


@pytest.mark.parametrize("component", COMPONENTS.values())
def test_a_component_has_neither_air_nor_background(gl: rhi.Device, component: LightComponent) -> None:
    def make(**air: Any) -> Scene:
        builder = make_boxes((0, 0, 0), base_color=(0.5, 0.3, 0.2), emission=0.2)
        pane = builder.add_material(base_color=(0.2, 0.8, 0.3, 0.4), alpha_mode=AlphaMode.BLEND)
        builder.add_objects(builder.add_node(np.diag([3.0, 0.3, 0.1, 1.0])), 0, pane)
        builder.lights.add_directional((-0.3, -0.5, -1.0))
        for name, value in air.items():
            setattr(builder, name, value)
        return builder.build()

    hazy = make(haze=0.1, fog=Fog(0.1), background=(0.4, 0.5, 0.6))
    clear = make(background=(0.0, 0.0, 0.0))
    pixels = draw(gl, hazy, light_component=component)
    np.testing.assert_array_equal(pixels, draw(gl, clear, light_component=component))
    assert not np.array_equal(draw(gl, hazy), draw(gl, clear))  # the control
    assert not pixels[0, 0].any()


@pytest.mark.parametrize("name", TECHNIQUES)
def test_a_component_draws_the_same_objects_without_passes_of_light_that_it_lacks(
    null: rhi.Device, name: str
) -> None:
    scene = make_scene()
    passes, drawn = {}, {}
    for component in LightComponent:
        with Renderer(
            null, scene, technique=name, visibility="frustum", size=SIZE, light_component=component
        ) as renderer:
            drawn[component] = renderer.render(first_view_camera(scene)).statistics.draws
            passes[component] = [part.name for part in renderer.plan(first_view_camera(scene))[1].passes]
    assert len({*drawn.values()}) == 1
    assert passes[LightComponent.DIFFUSE] == passes[LightComponent.SPECULAR] == passes[LightComponent.ALL]
    assert "shadow maps" in passes[LightComponent.SUN]
    assert "shadow maps" not in passes[LightComponent.AMBIENT]
    assert len(passes[LightComponent.AMBIENT]) < len(passes[LightComponent.ALL])


def test_a_component_may_be_exchanged_between_frames(gl: rhi.Device) -> None:
    scene = make_scene()
    camera = first_view_camera(scene)
    with Renderer(gl, scene, visibility="frustum", size=SIZE) as renderer:
        whole = renderer.render(camera).image.read()
        renderer.light_component = LightComponent.SPECULAR
        specular = renderer.render(camera).image.read()
        renderer.light_component = LightComponent.ALL
        np.testing.assert_array_equal(renderer.render(camera).image.read(), whole)
    assert (specular < whole).any()
    np.testing.assert_array_equal(specular[..., :3], draw(gl, scene, light_component=LightComponent.SPECULAR))


def test_an_effect_that_a_component_lacks_is_explained(null: rhi.Device) -> None:
    scene = make_scene()
    scene.bloom = Bloom(0.1)
    with Renderer(null, scene, visibility="frustum", size=SIZE) as renderer:
        effects = renderer.plan(first_view_camera(scene))[0]
        assert effects.explain(Effect.DIRECTIONAL_LIGHTS) == "the scene has 1 directional light"
        renderer.light_component = LightComponent.AMBIENT
        effects = renderer.plan(first_view_camera(scene))[0]
        assert Effect.DIRECTIONAL_LIGHTS not in effects.enabled
        assert effects.explain(Effect.DIRECTIONAL_LIGHTS) == "only the ambient component of light is drawn"


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("name", COMPONENTS)
def test_render_shows_each_of_them(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = str(tmp_path / "component.png")
    common = ["--size", "40x30", "--backend", "gl", "--visibility", "frustum", "--output", output]
    assert main(["render", "hall:columns=4,flags=2", "--technique", "deferred", "--show", name, *common]) == 0
    assert "component.png" in capsys.readouterr().out


def test_a_viewer_offers_each_of_them() -> None:
    assert DisplaySettings(show="specular").describe() == "forward, frustum, show specular"
