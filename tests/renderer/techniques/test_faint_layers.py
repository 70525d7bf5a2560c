"""Many faint layers of transparency are what compositing in float64 makes of them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from frames import open_renderer
from lighting_reference import encode
from nightly_reasons import FEWER_CASES
from numpy.typing import NDArray
from tested_devices import open_device

import rhi
from renderer.content import BUILT_IN
from renderer.frame import Blending, Effect
from renderer.frame.transparent_layers import TransparentLayers
from renderer.renderer import Renderer
from renderer.scene import (
    VERTEX,
    AlphaMode,
    Bloom,
    Camera,
    MeshGeometry,
    Orthographic,
    Scene,
    SceneBuilder,
    translation,
)
from renderer.techniques import TECHNIQUES

SIZE = (8, 6)
EYE = Camera.look_at(
    (0, 0, 10), (0, 0, 0), (0, 1, 0), Orthographic(height=2.0, aspect=SIZE[0] / SIZE[1], near=1.0, far=30.0)
)
BACKGROUND = (0.6, 0.2, 0.05)
LAYERS = [(3, 0.5), (16, 0.3), (64, 0.1), (64, 0.02), (300, 0.01), (1000, 0.01), (2000, 5e-4)]
FAINTEST = [(20_000, 1e-4), (100_000, 1e-4)]
EMISSION = 2.0
"""What each layer emits, which is all of its light."""


def stack(count: int) -> MeshGeometry:
    """Return panes one before the other, drawn from the farthest to the nearest: from z = 0 to z = 1."""
    corners = np.array(((-2, -2), (2, -2), (2, 2), (-2, 2)), float)
    vertices = np.zeros(4 * count, VERTEX)
    vertices["position"][:, :2] = np.tile(corners, (count, 1))
    vertices["position"][:, 2] = np.repeat(np.linspace(0.0, 1.0, count), 4)
    vertices["normal"] = (0, 0, 1)
    indices = np.array((0, 1, 2, 0, 2, 3), np.uint32) + 4 * np.arange(count, dtype=np.uint32)[:, None]
    return MeshGeometry(vertices, indices.reshape(-1))


def make_scene(count: int, alpha: float, *, as_objects: bool = False, emission: float = EMISSION) -> Scene:
    builder = SceneBuilder("faint layers")
    color = (0.3, 0.5, 0.9, alpha)
    pane = builder.add_material(
        base_color=color, specular_color=(0, 0, 0), emission=emission, alpha_mode=AlphaMode.BLEND
    )
    mesh = builder.add_mesh(stack(1 if as_objects else count))
    for number in range(count if as_objects else 1):
        builder.add_objects(builder.add_node(translation((0, 0, number / max(count - 1, 1)))), mesh, pane)
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
    builder.background = BACKGROUND
    return builder.build()


def mapped_color() -> NDArray[np.float64]:
    """Return the color (3,) of one opaque layer in linear light, in float64 and not rounded."""
    x = 0.6 * EMISSION * np.array((0.3, 0.5, 0.9), np.float32).astype(float)
    return np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)


def composite(count: int, alpha: float, color: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the levels (3,) of equal layers over the background: their order doesn't matter."""
    left = (1.0 - float(np.float32(alpha))) ** count
    return encode((1.0 - left) * color + left * np.array(BACKGROUND))


@pytest.fixture(scope="module", params=["gl", "cl", "wgpu"])
def any_device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    with open_device(request.param) as device:
        yield device


BRIGHT = [(1, 0.9, 2.0), (20, 0.9, 6.0), (60, 0.5, 10.0), (60, 0.9, 90.0), (30, 0.3, 40.0)]
"""Counts, alphas and emissions of layers whose sums of weighted light are up to 5e6."""


@pytest.mark.nightly_cases("wgpu-*", reason=FEWER_CASES)
@pytest.mark.parametrize("blending", Blending)
def test_bright_layers_in_bloom_are_within_two_levels_of_compositing(
    any_device: rhi.Device, blending: Blending
) -> None:
    """Light that blooms isn't mapped to tones before it is blended, so sums may be beyond half floats."""
    wrong = {}
    for count, alpha, emission in BRIGHT:
        scene = make_scene(count, alpha, as_objects=True, emission=emission)
        scene.background, scene.bloom = (0.0, 0.0, 0.0), Bloom(1e-9)
        covered = 1.0 - (1.0 - float(np.float32(alpha))) ** count
        x = 0.6 * emission * covered * np.array((0.3, 0.5, 0.9), np.float32).astype(float)
        want = encode(np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1))
        wrong[count, alpha, emission] = float(np.abs(draw(any_device, scene, blending) - want).max())
    assert max(wrong.values()) <= 2.0, wrong


def draw(
    device: rhi.Device, scene: Scene, blending: Blending, technique: str = "forward"
) -> NDArray[np.float64]:
    with open_renderer(device, scene, TECHNIQUES[technique](), size=SIZE) as renderer:
        renderer.blending = blending
        return np.asarray(renderer.render(EYE).image.read()[..., :3], np.float64)


@pytest.mark.nightly_cases("wgpu-*", "*-layers1", "cl-*WEIGHTED*", reason=FEWER_CASES)
@pytest.mark.parametrize("layers", [LAYERS, FAINTEST])
@pytest.mark.parametrize("blending", Blending)
def test_layers_of_one_mesh_are_within_two_levels_of_compositing(
    any_device: rhi.Device, blending: Blending, layers: list[tuple[int, float]]
) -> None:
    color = mapped_color()
    wrong = {}
    for count, alpha in layers:
        image = draw(any_device, make_scene(count, alpha), blending)
        wrong[count, alpha] = float(np.abs(image - composite(count, alpha, color)).max())
    assert max(wrong.values()) <= 2.0, wrong


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=FEWER_CASES)
@pytest.mark.parametrize("blending", Blending)
def test_layers_of_many_objects_are_within_two_levels_of_compositing(
    any_device: rhi.Device, blending: Blending
) -> None:
    color = mapped_color()
    for count, alpha in ((64, 0.1), (200, 0.01)):
        image = draw(any_device, make_scene(count, alpha, as_objects=True), blending)
        assert np.abs(image - composite(count, alpha, color)).max() <= 2.0


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=FEWER_CASES)
@pytest.mark.parametrize("technique", [name for name in TECHNIQUES if name not in ("auto", "inferred")])
def test_each_technique_shows_faint_layers(any_device: rhi.Device, technique: str) -> None:
    image = draw(any_device, make_scene(64, 0.1), Blending.SORTED, technique)
    assert np.abs(image - composite(64, 0.1, mapped_color())).max() <= 2.0


def list_passes(device: rhi.Device, scene: Scene, **settings: object) -> list[str]:
    with open_renderer(device, scene, TECHNIQUES["forward"](), size=SIZE) as renderer:
        for name, value in settings.items():
            setattr(renderer, name, value)
        renderer.render(EYE)
        return [frame_pass.name for frame_pass in renderer.plan(EYE)[1].passes]


def test_few_layers_and_dense_ones_are_drawn_to_the_image_itself(null: rhi.Device) -> None:
    """Control: only layers that the image would round away have a target of their own."""
    assert "blend" not in list_passes(null, make_scene(1, 0.01))
    assert "blend" not in list_passes(null, make_scene(500, 0.5))
    assert "blend" in list_passes(null, make_scene(500, 0.01))


def test_layers_in_an_image_of_half_floats_may_be_fainter(null: rhi.Device) -> None:
    scenes = [make_scene(200, alpha) for alpha in (0.1, 0.005)]
    for scene in scenes:
        scene.bloom = Bloom(0.2)
    assert ["blend" in list_passes(null, scene) for scene in scenes] == [False, True]


def layers_of(builder: SceneBuilder) -> TransparentLayers:
    return TransparentLayers.count(builder.build())


@pytest.mark.parametrize(("name", "layers"), [("box", 1), ("sphere", None)])
def test_a_convex_mesh_is_one_layer(name: str, layers: int | None) -> None:
    """Meshes of many triangles aren't examined: each may be a layer."""
    builder = SceneBuilder("one mesh")
    mesh = builder.add_mesh(BUILT_IN[name]())
    builder.add_objects(
        builder.add_node(), mesh, builder.add_material(base_color=(1, 1, 1, 0.1), alpha_mode=AlphaMode.BLEND)
    )
    triangles = builder.build().triangle_count
    assert layers_of(builder).counts.tolist() == [layers or triangles]


def test_the_error_of_layers_is_that_of_float_steps() -> None:
    """The bound holds for random layers that are rounded one by one, and isn't more than four times too
    large."""
    random = np.random.default_rng(3)
    for _ in range(50):
        alphas = random.choice((0.02, 0.1, 0.3, 0.8), random.integers(1, 60))
        counted = TransparentLayers(alphas, np.ones(len(alphas)))
        bound = 0.5 * counted.rounding(np.arange(len(alphas)))
        worst = 0.0
        for order in (np.sort(alphas)[::-1], np.sort(alphas)):
            exact = rounded = random.uniform(0, 255, 400)
            for alpha, color in zip(order, random.uniform(0, 255, (len(alphas), 400)), strict=True):
                exact = alpha * color + (1 - alpha) * exact
                rounded = np.round(alpha * color + (1 - alpha) * rounded)
            worst = max(worst, float(np.abs(exact - rounded).max()))
        assert worst <= bound + 1e-9


def test_the_format_follows_the_view(null: rhi.Device) -> None:
    scene = make_scene(500, 0.01)
    with Renderer(null, scene, size=SIZE, technique=TECHNIQUES["forward"]()) as renderer:
        away = Camera.look_at((0, 0, 10), (0, 0, 20))
        assert renderer.plan(EYE)[0].layers_format is not None
        effects = renderer.plan(away)[0]
        assert effects.layers_format is None
        assert Effect.TRANSPARENCY not in effects.enabled
