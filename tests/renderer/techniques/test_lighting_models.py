"""Lighting models of materials' own: light compared with float64, alike in all techniques, refused where they aren't
models, and without cost where no material has them."""

from __future__ import annotations

from typing import Any, ClassVar

import frames
import numpy as np
import pytest
from nightly_reasons import FEWER_CASES, ONLY_KERNELS

import rhi
import rhi.shading as sl
from renderer.content import BUILT_IN
from renderer.content.material_shaders import (
    Cloth,
    ClothParameters,
    Marble,
    Skin,
    SkinParameters,
    Toon,
    ToonParameters,
)
from renderer.frame import DepthOfFieldSettings, LightComponent
from renderer.lab.accuracy.float64 import shade_in_float64
from renderer.renderer import Renderer
from renderer.rules import BAD_LIGHTING_MODEL
from renderer.scene import AlphaMode, Camera, DepthOfField, Scene, SceneBuilder, make_geometry, translation
from renderer.scene.arrays import Floats
from renderer.shaders import Incidence, MaterialShader, SurfaceInput, SurfaceParameters, SurfacePoint
from renderer.techniques import (
    TECHNIQUES,
    ClusteredDeferred,
    DeferredPlus,
    Forward,
    ResourceCapture,
    TiledDeferred,
)
from renderer.techniques.technique import Technique
from rhi import Op, ShaderError, ValidationError
from rhi.shading import run_compute
from tests.renderer.conftest import open_device
from tests.renderer.techniques.lighting_reference import compute_pixel_rays

SIZE = (48, 32)
LIGHT = np.array([0.4, 0.7, 1.2])
RANGE = 20.0
BASE = np.array([0.8, 0.5, 0.3])
MODELS: dict[str, dict[str, Any]] = {
    "toon": {"shader": Toon, "steps": 3.0, "softness": 0.4},
    "cloth": {"shader": Cloth, "sheen_color": (0.5, 0.6, 0.9), "metallic": 0.0, "roughness": 0.5},
    "skin": {"shader": Skin, "wrap": (0.6, 0.3, 0.1)},
}


@sl.function
def invert(surface: SurfacePoint, light: Incidence) -> sl.vec3:
    """Return light where the surface faces away."""
    return surface.base_color * light.irradiance * sl.max(-sl.dot(surface.normal, light.direction), 0.0)


class Turned(MaterialShader):
    """Is lit from behind, by a model without parameters."""

    lighting_model: ClassVar = invert


def make_plane(light: Floats = LIGHT, *, radius: float = 0.0, **material: Any) -> Scene:
    """Make a plane at z = 0 that fills the view, lit by a point light."""
    builder = SceneBuilder("plane")
    corners = np.array([[-9, -9, 0], [9, -9, 0], [-9, 9, 0], [9, 9, 0]], np.float32)
    geometry = make_geometry(corners, np.array([0, 1, 2, 2, 1, 3]), np.tile([0.0, 0.0, 1.0], (4, 1)))
    row = builder.add_material(base_color=tuple(BASE), **material)
    builder.add_objects(builder.add_node(), builder.add_mesh(geometry), row)
    builder.lights.add_point(light, RANGE, (1.0, 0.9, 0.8), 1.5, source_radius=radius)
    builder.lights.sky = builder.lights.ground = builder.background = (0.0, 0.0, 0.0)
    builder.views["eye"] = Camera.look_at((0.5, -1.0, 2.5), (0.0, 0.2, 0.0)).with_aspect(SIZE[0] / SIZE[1])
    return builder.build()


def make_balls(*materials: dict[str, Any]) -> Scene:
    """Make a ball of each material, lit by lights of all kinds."""
    builder = SceneBuilder("balls")
    ball = builder.add_mesh(BUILT_IN["sphere"]())
    for number, values in enumerate(materials):
        position = translation((1.2 * (number % 3 - 1), 0.6 - 1.2 * (number // 3), 0.0))
        builder.add_objects(builder.add_node(position), ball, builder.add_material(**values))
    builder.lights.add_directional((-0.4, -0.6, -1.0), (0.5, 0.5, 0.5), casts_shadow=True)
    builder.lights.add_point((-1.0, 1.0, 2.0), 8.0, intensity=1.0)
    builder.lights.add_point((1.0, 1.0, 2.0), 8.0, intensity=1.0, source_radius=0.3)
    builder.lights.add_spot((1.0, 2.0, 2.0), (-0.3, -0.7, -0.7), 8.0, 0.5, 0.9, intensity=3.0)
    builder.lights.sky = builder.lights.ground = (0.1, 0.1, 0.12)
    builder.views["eye"] = Camera.look_at((0.0, 0.2, 4.0), (0.0, 0.0, 0.0))
    return builder.build()


PLAIN: dict[str, Any] = {"base_color": (0.9, 0.7, 0.4), "metallic": 1.0, "roughness": 0.35}
GLASS: dict[str, Any] = {"base_color": (0.5, 0.9, 0.5, 0.5), "alpha_mode": AlphaMode.BLEND}
TWO: tuple[dict[str, Any], ...] = (
    MODELS["toon"],
    MODELS["skin"],
    PLAIN,
    {"shader": Marble},
    {},
    MODELS["toon"] | GLASS,
)
THREE: tuple[dict[str, Any], ...] = (*TWO[:4], MODELS["cloth"], TWO[5])


def measure_light(
    device: rhi.Device,
    scene: Scene,
    technique: str = "forward",
    component: LightComponent = LightComponent.ALL,
) -> Floats:
    """Draw a frame out of focus; return its light (h, w, 3) before it is blurred and its tones are mapped."""
    scene.depth_of_field = DepthOfField(1.0, 0.5)
    capture = ResourceCapture(TECHNIQUES[technique](), "bright_image")
    with Renderer(
        device,
        scene,
        technique=capture,
        visibility="none",
        size=SIZE,
        depth_of_field=DepthOfFieldSettings(bits=32),
        light_component=component,
    ) as renderer:
        renderer.render(frames.first_view_camera(scene))
    assert capture.texels is not None
    return capture.texels[..., :3].astype(np.float64)


def compute_light(name: str, camera: Camera, light: Floats = LIGHT) -> Floats:
    """The light (h, w, 3) of the plane with a model, by its equation."""
    rays = compute_pixel_rays(camera, SIZE)
    hit = camera.position + rays * (-camera.position[2] / rays[..., 2])[..., None]

    def unit(v: Floats) -> Floats:
        return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))

    to_eye, to_light = unit(camera.position - hit), unit(light - hit)
    distance = np.linalg.norm(light - hit, axis=-1)
    window = np.clip(1.0 - (distance / RANGE) ** 4, 0.0, 1.0) ** 2
    arriving = (1.5 * window / distance**2)[..., None] * np.array([1.0, 0.9, 0.8])
    cosine = to_light[..., 2:]
    if name == "toon":
        steps = 3.0 * np.maximum(cosine, 0.0)
        t = np.clip((steps % 1.0 - 0.6) / 0.4, 0.0, 1.0)
        return np.asarray(arriving * BASE * (np.floor(steps) + 3.0 * t**2 - 2.0 * t**3) / 3.0)
    if name == "skin":
        wrap = np.array([0.6, 0.3, 0.1])
        return np.asarray(arriving * BASE * np.maximum(cosine + wrap, 0.0) / (1.0 + wrap) ** 2)
    angle = np.arccos(np.clip(unit(to_eye + to_light)[..., 2:], -1.0, 1.0))
    charlie = (2.0 + 4.0) * np.sin(angle) ** 4.0 / 2.0  # α = 0.25, times π
    masked = 4.0 * (cosine + to_eye[..., 2:] - cosine * to_eye[..., 2:])
    sheen = np.array([0.5, 0.6, 0.9]) * charlie / masked
    return np.asarray(np.where(cosine > 0.0, arriving * cosine * (0.96 * BASE + sheen), 0.0))


def list_passes(device: rhi.Device, scene: Scene, technique: str) -> list[str]:
    with Renderer(device, scene, technique=technique, visibility="frustum", size=SIZE) as renderer:
        return [part.name for part in renderer.plan(frames.first_view_camera(scene))[1].passes]


@pytest.mark.nightly_cases("cl*", "wgpu*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("technique", ["forward", "deferred", "deferred_plus"])
@pytest.mark.parametrize("name", MODELS)
def test_light_is_that_of_float64(drawing_device: rhi.Device, name: str, technique: str) -> None:
    scene = make_plane(**MODELS[name])
    expected = compute_light(name, frames.first_view_camera(scene))
    drawn = measure_light(drawing_device, scene, technique)
    assert expected.max() > 0.3
    # Stored normals have 2 × 16 bits, texels 3 × 10 bits.
    np.testing.assert_allclose(drawn, expected, rtol=2e-3, atol=1e-3 * expected.max())


def test_the_models_differ_by_more_than_the_tolerance() -> None:
    camera = frames.first_view_camera(make_plane())
    toon, cloth, skin = (compute_light(name, camera) for name in MODELS)
    assert (
        min(np.abs(a - b).max() for a, b in ((toon, cloth), (cloth, skin), (skin, toon))) > 0.05 * toon.max()
    )


@pytest.mark.parametrize("technique", ["forward", "deferred"])
def test_a_model_is_asked_about_light_from_behind(gl: rhi.Device, technique: str) -> None:
    behind = np.array([0.4, 0.7, -0.3])
    camera = frames.first_view_camera(make_plane())
    for name, reaches in (("toon", False), ("cloth", False), ("skin", True)):
        expected = compute_light(name, camera, behind)
        assert bool(expected.max() > 0.01) is reaches
        drawn = measure_light(gl, make_plane(behind, **MODELS[name]), technique)
        np.testing.assert_allclose(drawn, expected, rtol=2e-3, atol=1e-4)
    assert measure_light(gl, make_plane(behind, shader=Turned), technique).max() > 0.1
    assert measure_light(gl, make_plane(shader=Turned), technique).max() == 0.0


SAMPLED: dict[str, Technique] = {
    "clustered_deferred, 4 samples": ClusteredDeferred(samples=4),
    "tiled_deferred, 4 samples": TiledDeferred(samples=4),
    "deferred_plus, 4 samples": DeferredPlus(samples=4),
}
OTHERS: dict[str, Technique] = {
    "multi-pass": DeferredPlus(multi_pass=True),
    "binned": DeferredPlus(binned=True),
}


def draw(device: rhi.Device, scene: Scene, technique: str | Technique) -> Floats:
    """Draw a frame; return its levels (h, w, 3)."""
    with Renderer(device, scene, technique=technique, visibility="frustum", size=(96, 64)) as renderer:
        return renderer.render(frames.first_view_camera(scene)).image.read()[..., :3].astype(np.float64)


@pytest.mark.nightly_cases(
    *(name for name in TECHNIQUES if name not in ("deferred", "tiled_deferred", "deferred_plus")),
    "cl*",
    "wgpu*",
    reason=FEWER_CASES,
)
@pytest.mark.parametrize("name", TECHNIQUES)
def test_all_techniques_draw_the_models_alike(drawing_device: rhi.Device, name: str) -> None:
    for materials in (TWO, THREE):
        scene = make_balls(*materials)
        forward, other = draw(drawing_device, scene, "forward"), draw(drawing_device, scene, name)
        assert forward.max() > 100
        assert np.abs(forward - other).max() <= 2


@pytest.mark.parametrize("name", OTHERS)
def test_the_ways_of_deferred_plus_draw_the_models_alike(gl: rhi.Device, name: str) -> None:
    scene = make_balls(*TWO)
    assert np.abs(draw(gl, scene, "forward") - draw(gl, scene, OTHERS[name])).max() <= 2


@pytest.mark.parametrize("name", SAMPLED)
def test_several_samples_draw_the_models_alike(gl: rhi.Device, name: str) -> None:
    scene = make_balls(*TWO[:5])
    expected = draw(gl, scene, Forward(samples=4))
    off = np.abs(expected - draw(gl, scene, SAMPLED[name])).max(axis=2)
    assert np.quantile(off, 0.99) <= 2, "only edges are put together otherwise"


def test_images_are_those_of_float64_by_numpy(gl: rhi.Device) -> None:
    """NumPy runs the lane code that OpenCL C is written from."""
    scene = make_balls(*THREE[:5])
    scene.lights.directional["casts_shadow"] = False
    with frames.open_renderer(gl, scene, size=(60, 40)) as renderer:
        exact = shade_in_float64(renderer, frames.first_view_camera(scene))
        drawn = frames.read_colors(renderer.render(frames.first_view_camera(scene)))
    is_covered = exact.objects >= 0
    assert is_covered.mean() > 0.1
    off = np.abs(exact.levels - drawn).max(axis=2)[is_covered]
    assert np.quantile(off, 0.99) <= 1.0


@pytest.mark.parametrize("technique", ["forward", "deferred", "deferred_plus"])
def test_each_material_has_its_own_parameters(gl: rhi.Device, technique: str) -> None:
    # Those of the first material change; all other balls, a transparent one among them, stay as they are.
    few, many = (
        draw(gl, make_balls(MODELS["toon"] | {"steps": steps}, *TWO[1:5], TWO[5] | {"steps": 1.0}), technique)
        for steps in (1.0, 5.0)
    )
    changed = np.abs(few - many).max(axis=2) > 2
    assert changed[:32, :40].sum() > 30
    changed[:32, :40] = False
    assert not changed.any()


def test_a_model_changes_the_image(gl: rhi.Device) -> None:
    # The control: with the renderer's model, the image is another one.
    plain = draw(gl, make_balls({}, {}, *TWO[2:5]), "deferred")
    assert np.abs(draw(gl, make_balls(*TWO[:5]), "deferred") - plain).max() > 30


@pytest.mark.parametrize("technique", ["forward", "deferred"])
def test_a_sphere_light_counts_as_a_light_at_its_middle(gl: rhi.Device, technique: str) -> None:
    wide, point = (make_plane(radius=radius, **MODELS["skin"]) for radius in (0.5, 0.0))
    np.testing.assert_allclose(
        measure_light(gl, wide, technique), measure_light(gl, point, technique), rtol=1e-5
    )


@pytest.mark.parametrize("technique", ["forward", "deferred"])
def test_a_rectangle_counts_as_a_light_at_its_middle(gl: rhi.Device, technique: str) -> None:
    wide, point = make_plane(**MODELS["toon"]), make_plane(**MODELS["toon"])
    wide.lights.point["source_right"], wide.lights.point["source_up"] = (0.3, 0.0, 0.0), (0.0, 0.2, 0.0)
    np.testing.assert_allclose(
        measure_light(gl, wide, technique), measure_light(gl, point, technique), rtol=1e-5
    )


@pytest.mark.parametrize("technique", ["forward", "deferred", "clustered_deferred", "deferred_plus"])
def test_the_light_of_models_counts_as_diffuse(gl: rhi.Device, technique: str) -> None:
    scene = make_plane(**MODELS["cloth"])
    whole, diffuse, specular = (
        measure_light(gl, scene, technique, component)
        for component in (LightComponent.ALL, LightComponent.DIFFUSE, LightComponent.SPECULAR)
    )
    assert whole.max() > 0.1
    np.testing.assert_allclose(diffuse, whole, rtol=1e-6)
    assert specular.max() == 0.0


def test_shadows_fall_on_surfaces_with_models(gl: rhi.Device) -> None:
    scene = make_balls(*TWO[:5])
    lit = make_balls(*TWO[:5])
    lit.lights.directional["casts_shadow"] = False
    for technique in ("forward", "deferred"):
        assert (draw(gl, lit, technique) - draw(gl, scene, technique)).max() > 20


BUFFERED = ("deferred", "tiled_deferred", "clustered_deferred")
COLLECTING = ("light_pre_pass", "inferred")


@pytest.mark.parametrize("name", TECHNIQUES)
def test_two_models_with_parameters_keep_a_technique_and_three_do_not(null: rhi.Device, name: str) -> None:
    plain = make_balls({"shader": Marble}, PLAIN, {}, {"shader": Marble} | GLASS)
    passes, clustered = list_passes(null, plain, name), list_passes(null, plain, "clustered")
    assert list_passes(null, make_balls(*TWO), name) == (clustered if name in COLLECTING else passes)
    by_clusters = name in (*BUFFERED, *COLLECTING)
    assert list_passes(null, make_balls(*THREE), name) == (clustered if by_clusters else passes)


def test_models_without_parameters_do_not_count(null: rhi.Device) -> None:
    scene = make_balls(*TWO, {"shader": Turned})
    assert list_passes(null, scene, "deferred") == list_passes(null, make_balls(*TWO), "deferred")


@pytest.mark.parametrize(
    "name", ["forward", "deferred", "clustered_deferred", "tiled_deferred", "deferred_plus"]
)
def test_a_model_adds_no_draw_no_pass_and_no_byte(name: str) -> None:
    def count(shader: type[MaterialShader]) -> tuple[list[Op], list[tuple[Any, ...]]]:
        scene = make_balls({"shader": shader}, {})
        with open_device("null") as device:
            stream = frames.record(device, scene, TECHNIQUES[name](), frames=1)
            textures = [command["descriptor"] for command in stream if command.op is Op.CREATE_TEXTURE]
            return [command.op for command in stream], [
                (texture.size, texture.format) for texture in textures
            ]

    ops, textures = count(Turned)
    assert (ops, textures) == count(SurfaceOnly)
    assert ops


class SurfaceOnly(MaterialShader):
    """Describes surfaces as the renderer does, and has no model."""

    def describe(self, at: SurfaceInput) -> SurfaceParameters:
        return super().describe(at)


def test_a_scene_without_models_in_view_has_the_shaders_of_one_without_any(null: rhi.Device) -> None:
    def list_programs(*materials: dict[str, Any]) -> set[str]:
        stream = frames.record(null, make_balls(*materials), TECHNIQUES["deferred"](), frames=1)
        programs = [command["descriptor"] for command in stream if command.op is Op.CREATE_PROGRAM]
        return {program.emit("glsl", stage).text for program in programs for stage in program.stages}

    plain = list_programs({"shader": SurfaceOnly}, {})
    assert not any("invert" in text for text in plain)
    assert any("invert" in text for text in list_programs({"shader": Turned}, {}))


# -- what isn't a model


@sl.function
def only_surface(surface: SurfacePoint) -> sl.vec3:
    return surface.base_color


@sl.function
def swapped(light: Incidence, surface: SurfacePoint) -> sl.vec3:
    return surface.base_color * light.irradiance


@sl.function
def grey(surface: SurfacePoint, light: Incidence) -> float:
    return light.irradiance.x


@sl.function
def with_parameters(surface: SurfacePoint, light: Incidence, own: ToonParameters) -> sl.vec3:
    return surface.base_color * own.steps


def plain_python(surface: SurfacePoint, light: Incidence) -> sl.vec3:
    return surface.base_color


@pytest.mark.parametrize("model", [only_surface, swapped, grey, with_parameters, plain_python, 3])
def test_a_function_that_is_no_model_is_refused_at_the_users_line(model: Any) -> None:
    shader = type("Wrong", (MaterialShader,), {"lighting_model": model, "__module__": __name__})
    with pytest.raises(ValidationError, match=BAD_LIGHTING_MODEL.id) as caught:
        SceneBuilder("wrong").add_material(shader=shader)
    assert "test_lighting_models.py" in str(caught.value)
    assert "Wrong" in str(caught.value)


def test_parameters_that_a_model_does_not_take_are_refused() -> None:
    class Deaf(Toon):
        lighting_model: ClassVar = invert

    with pytest.raises(ValidationError, match=BAD_LIGHTING_MODEL.id):
        SceneBuilder("deaf").add_material(shader=Deaf)


def test_a_model_beside_anisotropy_is_refused() -> None:
    class Both(MaterialShader):
        has_anisotropy = True
        lighting_model: ClassVar = invert

    with pytest.raises(ValidationError, match="has_anisotropy"):
        SceneBuilder("both").add_material(shader=Both)


def test_a_shader_may_set_its_parents_model_aside(null: rhi.Device) -> None:
    class Plain(Toon):
        lighting_model: ClassVar = None

    scene = make_balls({"shader": Plain})
    assert Renderer(null, scene, size=SIZE).plan(frames.first_view_camera(scene))[0].lighting_models == ()


def test_a_fault_in_a_model_names_its_line(null: rhi.Device) -> None:
    @sl.function
    def faulty(surface: SurfacePoint, light: Incidence) -> sl.vec3:
        return surface.unknown * light.irradiance  # type: ignore[attr-defined, no-any-return]

    shader = type("Faulty", (MaterialShader,), {"lighting_model": faulty, "__module__": __name__})
    with pytest.raises(ShaderError, match=r"surface\.unknown") as caught:
        frames.record(null, make_balls({"shader": shader}), TECHNIQUES["deferred"](), frames=1)
    assert "test_lighting_models.py" in str(caught.value)


# -- the models, whatever they are asked


class ModelProbe(sl.Shader):
    """Asks each model about arrays of directions."""

    work_group = (64,)
    asked: sl.Storage[sl.vec4]
    results: sl.StorageRW[sl.vec4]
    toons: sl.Storage[ToonParameters]
    cloths: sl.Storage[ClothParameters]
    skins: sl.Storage[SkinParameters]

    def compute(self) -> None:
        i = sl.global_id().x
        surface = SurfacePoint(
            position=sl.vec3(0.0),
            normal=self.asked[3 * i].xyz,
            geometric_normal=self.asked[3 * i].xyz,
            to_eye=self.asked[3 * i + 1].xyz,
            base_color=sl.vec3(1.0),
            specular_color=sl.vec3(0.04),
            shininess=self.asked[3 * i + 1].w,
            occlusion=1.0,
            emissive=sl.vec3(0.0),
            irradiance=sl.vec3(-1.0),
            stretch=sl.vec3(0.0),
        )
        light = Incidence(direction=self.asked[3 * i + 2].xyz, irradiance=sl.vec3(1.0))
        self.results[3 * i] = sl.vec4(Toon.lighting_model(surface, light, self.toons[0]), 0.0)
        self.results[3 * i + 1] = sl.vec4(Cloth.lighting_model(surface, light, self.cloths[0]), 0.0)
        self.results[3 * i + 2] = sl.vec4(Skin.lighting_model(surface, light, self.skins[0]), 0.0)


def test_models_are_finite_and_never_negative() -> None:
    rng, count = np.random.default_rng(5), 1024
    asked = np.zeros((3 * count, 4), np.float32)
    asked[:, :3] = rng.normal(size=(3 * count, 3))
    asked[: 3 * 512, :3] = rng.integers(
        -1, 2, (3 * 512, 3)
    )  # along axes, against each other, and of length 0
    lengths = np.linalg.norm(asked[:, :3], axis=1, keepdims=True)
    asked[:, :3] /= np.maximum(lengths, 1e-9)
    asked[1::3, 3] = np.where(
        rng.random(count) < 0.5, rng.uniform(1.0, 1e5, count), -rng.uniform(0.1, 1.0, count)
    )
    toons, cloths, skins = (
        np.zeros(1, struct.dtype) for struct in (ToonParameters, ClothParameters, SkinParameters)
    )
    toons["steps"], cloths["sheen_color"], skins["wrap"] = 3.0, 1.0, (0.0, 0.5, 1.0)
    results = run_compute(
        ModelProbe, count // 64, asked=asked, results=3 * count, toons=toons, cloths=cloths, skins=skins
    )["results"]
    assert np.isfinite(results).all()
    assert results.min() >= 0.0
    assert results[::3].max() <= 1.0
    assert results[2::3].max() <= 1.0


def test_wrapped_light_is_as_much_as_diffuse_light() -> None:
    # Over the sphere of normals: π for each channel, however far it wraps.
    cosine = np.linspace(-1.0, 1.0, 100_001)
    for wrap in (0.0, 0.5, 1.0):
        wrapped = np.maximum(cosine + wrap, 0.0) / (1.0 + wrap) ** 2
        assert np.trapezoid(wrapped, cosine) == pytest.approx(0.5, abs=1e-4)
