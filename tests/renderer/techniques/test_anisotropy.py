"""Anisotropic materials: highlights compared with float64 along explicit tangents and bitangents, alike in all
techniques, and round where the anisotropy is 0."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frames import first_view_camera
from nightly_reasons import FEWER_CASES, ONLY_KERNELS

import rhi
from renderer.content import BUILT_IN
from renderer.content.material_shaders import Brushed, Marble
from renderer.frame import DepthOfFieldSettings, LightComponent
from renderer.renderer import Renderer
from renderer.scene import AlphaMode, Camera, DepthOfField, Scene, SceneBuilder, make_geometry, translation
from renderer.scene.arrays import Floats
from renderer.techniques import TECHNIQUES, ResourceCapture
from tests.renderer.techniques.lighting_reference import compute_pixel_rays

SIZE = (48, 32)
LIGHT = np.array([0.4, 0.7, 1.2])
"""Where a light is, before the plane z = 0."""
RANGE = 20.0
METAL: dict[str, Any] = {"base_color": (0.9, 0.7, 0.4), "metallic": 1.0, "roughness": 0.35}


def make_plane(shader: type[Any] | None = Brushed, **material: Any) -> Scene:
    """Make a plane at z = 0 that fills the view, whose u grows along x and v along -y, and a light before it."""
    builder = SceneBuilder("plane")
    corners = np.array([[-9, -9, 0], [9, -9, 0], [-9, 9, 0], [9, 9, 0]], np.float32)
    uv = np.array([[0, 1], [1, 1], [0, 0], [1, 0]], np.float32)
    geometry = make_geometry(corners, np.array([0, 1, 2, 2, 1, 3]), np.tile([0.0, 0.0, 1.0], (4, 1)), uv)
    own = {} if shader is None else {"shader": shader}
    row = builder.add_material(**METAL | own | material)
    builder.add_objects(builder.add_node(), builder.add_mesh(geometry), row)
    builder.lights.add_point(LIGHT, RANGE, (1.0, 0.9, 0.8), 1.5)
    builder.lights.sky = builder.lights.ground = builder.background = (0.0, 0.0, 0.0)
    builder.views["eye"] = Camera.look_at((0.5, -1.0, 2.5), (0.0, 0.2, 0.0)).with_aspect(SIZE[0] / SIZE[1])
    return builder.build()


def make_balls(**changes: Any) -> Scene:
    """Make balls of brushed metal, of marble and of glass that is brushed, lit by lights of several kinds."""
    builder = SceneBuilder("balls")
    ball = builder.add_mesh(BUILT_IN["sphere"]())
    for number, values in enumerate(
        (
            METAL | (changes or {"shader": Brushed, "anisotropy": 0.9}),
            METAL | (changes or {"shader": Brushed, "anisotropy_rotation": 1.5}),
            METAL,
            {"shader": Marble, "roughness": 0.4},
            {"base_color": (0.3, 0.6, 0.9, 0.4), "alpha_mode": AlphaMode.BLEND, "roughness": 0.2}
            | (changes or {"shader": Brushed}),
        )
    ):
        position = translation((1.2 * (number % 3 - 1), 0.6 - 1.2 * (number // 3), 0.0))
        builder.add_objects(builder.add_node(position), ball, builder.add_material(**values))
    builder.lights.add_directional((-0.4, -0.6, -1.0))
    builder.lights.add_point((-1.0, 1.0, 2.0), 8.0, intensity=2.0)
    builder.lights.add_spot((1.0, 2.0, 2.0), (-0.3, -0.7, -0.7), 8.0, 0.5, 0.9, intensity=3.0)
    builder.lights.sky = builder.lights.ground = (0.1, 0.1, 0.12)
    builder.views["eye"] = Camera.look_at((0.0, 0.2, 5.0), (0.0, 0.0, 0.0))
    return builder.build()


def measure_light(device: rhi.Device, scene: Scene, technique: str = "forward") -> Floats:
    """Draw a frame out of focus; return its light (h, w, 3) before it is blurred and its tones are mapped."""
    scene.depth_of_field = DepthOfField(1.0, 0.5)
    capture = ResourceCapture(TECHNIQUES[technique](), "bright_image")
    focus = DepthOfFieldSettings(bits=32)
    with Renderer(
        device, scene, technique=capture, visibility="none", size=SIZE, depth_of_field=focus
    ) as renderer:
        renderer.render(first_view_camera(scene))
    assert capture.texels is not None
    return capture.texels[..., :3].astype(np.float64)


def draw(device: rhi.Device, scene: Scene, technique: str = "forward", **options: Any) -> Floats:
    """Draw a frame; return its levels (h, w, 3)."""
    with Renderer(
        device, scene, technique=technique, visibility="frustum", size=(96, 64), **options
    ) as renderer:
        return renderer.render(first_view_camera(scene)).image.read()[..., :3].astype(np.float64)


def compute_light(
    camera: Camera, anisotropy: float, rotation: float, roughness: float = 0.35, metallic: float = 1.0
) -> Floats:
    """The light (h, w, 3) of the plane by glTF's KHR_materials_anisotropy, with separable masking."""
    rays = compute_pixel_rays(camera, SIZE)
    hit = camera.position + rays * (-camera.position[2] / rays[..., 2])[..., None]

    def unit(v: Floats) -> Floats:
        return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))

    normal = np.array([0.0, 0.0, 1.0])
    t = np.array([np.cos(rotation), np.sin(rotation), 0.0])
    b = np.cross(normal, t)
    to_eye, to_light = unit(camera.position - hit), unit(LIGHT - hit)
    h = unit(to_eye + to_light)
    at = roughness**2 + (1.0 - roughness**2) * anisotropy**2
    ab = roughness**2
    d = 1.0 / (at * ab * ((h @ t / at) ** 2 + (h @ b / ab) ** 2 + (h @ normal) ** 2) ** 2)  # times π

    def mask(w: Floats) -> Floats:
        return np.asarray(w @ normal + np.sqrt((at * (w @ t)) ** 2 + (ab * (w @ b)) ** 2 + (w @ normal) ** 2))

    distance = np.linalg.norm(LIGHT - hit, axis=-1)
    window = np.clip(1.0 - (distance / RANGE) ** 4, 0.0, 1.0) ** 2
    received = (1.5 * window / distance**2 * (to_light @ normal))[..., None] * np.array([1.0, 0.9, 0.8])
    base = np.array(METAL["base_color"])
    f0 = 0.04 + (base - 0.04) * metallic
    fresnel = f0 + (1.0 - f0) * ((1.0 - (to_eye * h).sum(-1)) ** 5)[..., None]
    diffuse = base * (1.0 - metallic) * (1.0 - f0) * (1.0 - ((1.0 - (to_eye * h).sum(-1)) ** 5)[..., None])
    return np.asarray(received * (fresnel * (d / (mask(to_eye) * mask(to_light)))[..., None] + diffuse))


@pytest.mark.nightly_cases("cl*", "wgpu*", reason=ONLY_KERNELS)
@pytest.mark.parametrize(
    ("anisotropy", "rotation", "metallic"),
    [(0.8, 0.0, 1.0), (0.5, 0.7, 1.0), (1.0, -1.2, 0.3), (0.0, 0.4, 1.0)],
)
def test_highlights_are_those_of_float64(
    drawing_device: rhi.Device, anisotropy: float, rotation: float, metallic: float
) -> None:
    scene = make_plane(anisotropy=anisotropy, anisotropy_rotation=rotation, metallic=metallic)
    expected = compute_light(first_view_camera(scene), anisotropy, rotation, metallic=metallic)
    drawn = measure_light(drawing_device, scene)
    assert expected.max() > 0.3
    np.testing.assert_allclose(drawn, expected, rtol=2e-3, atol=2e-4 * expected.max())


def test_a_mirrored_or_wrong_tangent_would_be_noticed() -> None:
    # The control: the tolerance above is far below what another direction changes.
    camera = first_view_camera(make_plane())
    right, mirrored = (compute_light(camera, 0.5, rotation) for rotation in (0.7, -0.7))
    assert np.abs(right - mirrored).max() > 0.2 * right.max()


def test_the_texture_turns_and_weakens_anisotropy(gl: rhi.Device) -> None:
    builder = SceneBuilder("texture")
    angle, strength = 0.6, 0.5
    texel = [127.5 + 127.5 * np.cos(angle), 127.5 + 127.5 * np.sin(angle), 255 * strength, 255]
    image = builder.add_image(np.tile(np.round(texel).astype(np.uint8), (4, 4, 1)))
    corners = np.array([[-9, -9, 0], [9, -9, 0], [-9, 9, 0], [9, 9, 0]], np.float32)
    uv = np.array([[0, 1], [1, 1], [0, 0], [1, 0]], np.float32)
    geometry = make_geometry(corners, np.array([0, 1, 2, 2, 1, 3]), np.tile([0.0, 0.0, 1.0], (4, 1)), uv)
    row = builder.add_material(
        **METAL, shader=Brushed, anisotropy=0.8, anisotropy_rotation=0.3, anisotropy_texture=image
    )
    builder.add_objects(builder.add_node(), builder.add_mesh(geometry), row)
    builder.lights.add_point(LIGHT, RANGE, (1.0, 0.9, 0.8), 1.5)
    builder.lights.sky = builder.lights.ground = builder.background = (0.0, 0.0, 0.0)
    builder.views["eye"] = first_view_camera(make_plane())
    expected = compute_light(builder.views["eye"], 0.8 * round(255 * strength) / 255, angle + 0.3)
    drawn = measure_light(gl, builder.build())
    np.testing.assert_allclose(drawn, expected, rtol=2e-2, atol=5e-3 * expected.max())


@pytest.mark.nightly_cases(
    *(name for name in TECHNIQUES if name not in ("deferred", "deferred_plus", "light_pre_pass")),
    "cl*",
    "wgpu*",
    reason=FEWER_CASES,
)
@pytest.mark.parametrize("name", TECHNIQUES)
def test_all_techniques_draw_anisotropic_materials_alike(drawing_device: rhi.Device, name: str) -> None:
    scene = make_balls()
    forward, other = draw(drawing_device, scene), draw(drawing_device, scene, name)
    assert forward.max() > 100
    # `deferred_plus` stores tangents in 32 bits with the normal.
    assert np.abs(forward - other).max() <= (8 if name == "deferred_plus" else 2)
    assert np.abs(forward - other).mean() <= 0.05


def test_anisotropy_of_0_is_a_round_highlight(gl: rhi.Device) -> None:
    plain, neutral = make_plane(None), make_plane(anisotropy=0.0, anisotropy_rotation=0.7)
    np.testing.assert_allclose(measure_light(gl, neutral), measure_light(gl, plain), rtol=1e-4, atol=1e-6)
    drawn = measure_light(gl, make_plane(anisotropy=0.7))
    assert np.abs(drawn - measure_light(gl, plain)).max() > 0.1  # the control


def test_the_specular_model_stays_round(gl: rhi.Device) -> None:
    specular = {"metallic": None, "roughness": None, "specular_color": (0.5, 0.5, 0.5), "shininess": 20.0}
    plain, brushed = make_plane(None, **specular), make_plane(**specular, anisotropy=0.8)
    np.testing.assert_allclose(measure_light(gl, brushed), measure_light(gl, plain), atol=1e-6)


def test_components_of_anisotropic_light_add_up(gl: rhi.Device) -> None:
    scene = make_plane(anisotropy=0.8, metallic=0.5)
    scene.depth_of_field = DepthOfField(1.0, 0.5)
    parts = []
    for component in (LightComponent.DIFFUSE, LightComponent.SPECULAR, LightComponent.ALL):
        capture = ResourceCapture(TECHNIQUES["forward"](), "bright_image")
        with Renderer(
            gl,
            scene,
            technique=capture,
            visibility="none",
            size=SIZE,
            depth_of_field=DepthOfFieldSettings(bits=32),
            light_component=component,
        ) as renderer:
            renderer.render(first_view_camera(scene))
        assert capture.texels is not None
        parts.append(capture.texels[..., :3].astype(np.float64))
    assert min(part.max() for part in parts) > 0.01
    np.testing.assert_allclose(parts[0] + parts[1], parts[2], rtol=1e-5, atol=1e-6)


BUFFERED = ("deferred", "light_pre_pass", "inferred", "tiled_deferred", "clustered_deferred")
"""The techniques whose buffers hold no directions of highlights."""


@pytest.mark.parametrize("name", TECHNIQUES)
def test_only_techniques_with_buffers_draw_anisotropic_scenes_by_clusters(
    null: rhi.Device, name: str
) -> None:
    def list_passes(scene: Scene, technique: str) -> list[str]:
        with Renderer(null, scene, technique=technique, visibility="frustum", size=SIZE) as renderer:
            renderer.render(first_view_camera(scene))
            return [part.name for part in renderer.plan(first_view_camera(scene))[1].passes]

    brushed, marble = make_balls(), make_balls(shader=Marble)
    passes = list_passes(brushed, name)
    assert (passes == list_passes(marble, name)) is (name not in BUFFERED)
    if name in BUFFERED:
        assert passes == list_passes(brushed, "clustered")


def test_a_scene_whose_brushed_objects_are_out_of_view_is_drawn_by_its_technique(null: rhi.Device) -> None:
    scene = make_balls()
    away = Camera.look_at((0.0, 0.0, 5.0), (0.0, 0.0, 10.0))
    with Renderer(null, scene, technique="deferred", visibility="frustum", size=SIZE) as renderer:
        for _ in range(200):  # shaders keep what was in view lately
            renderer.render(away)
        assert not renderer.plan(away)[0].has_anisotropy
        renderer.render(first_view_camera(scene))
        assert renderer.plan(first_view_camera(scene))[0].has_anisotropy
