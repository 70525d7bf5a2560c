"""Highlights, haze and fog of parallel projections are those of parallel rays, with every technique: as rays
traced in float64 show them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest
from frames import open_renderer
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from numpy.typing import NDArray
from tested_devices import open_device

import rhi
from renderer.content import BUILT_IN
from renderer.frame import Effect
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.scene import (
    AlphaMode,
    Camera,
    Depth,
    Fog,
    Orthographic,
    Perspective,
    Scene,
    SceneBuilder,
    scaling,
    translation,
)
from renderer.techniques import TECHNIQUES

SIZE = (40, 30)
NAMES = [name for name in TECHNIQUES if name != "auto"]
EYE = Camera.look_at((3.0, 6.0, 7.0), (0.0, 0.0, 0.0))
PROJECTIONS = {
    "ahead of the eye": Orthographic(7.0, 4 / 3, 0.5, 40.0),
    "behind the eye": Orthographic(7.0, 4 / 3, -60.0, 60.0, Depth.STANDARD),
    "perspective": Perspective(0.8, 4 / 3, 0.1),
}
SHINY = {"base_color": (0.3, 0.25, 0.2), "specular_color": (0.5, 0.5, 0.5), "shininess": 7.0}
Change = Callable[[SceneBuilder], object]


def make_scene(*changes: Change, height: float = -0.5, **material: Any) -> Scene:
    """A plane at a height in metres under a sun, a point light and a spot light."""
    builder = SceneBuilder("parallel rays")
    builder.background = (0.1, 0.2, 0.35)
    builder.lights.sky, builder.lights.ground = (0.5, 0.3, 0.1), (0.05, 0.1, 0.3)
    builder.add_mesh(BUILT_IN["box"]())
    for at in changes or (put_floor,):
        at(builder)
    if "metallic" not in material:
        material = {**SHINY, **material}
    row = builder.add_material(**material)
    builder.add_objects(builder.add_node(translation((0, height, 0)) @ scaling((60, 1, 60))), 0, row)
    builder.lights.add_directional((-0.5, -1.0, 0.6), intensity=0.4)
    builder.lights.add_point((1.5, 1.4, -1.0), 9.0, intensity=1.5)
    builder.lights.add_spot((-2.0, 2.5, 1.0), (0.2, -1, 0), 9.0, 0.3, 0.9, intensity=3.0)
    return builder.build()


def put_floor(builder: SceneBuilder) -> None:
    """Change nothing: the plane is all there is."""


def put_pane(builder: SceneBuilder) -> None:
    glass = builder.add_material(
        base_color=(0.2, 0.4, 0.3, 0.4), specular_color=(0.6, 0.6, 0.6), shininess=9.0,
        alpha_mode=AlphaMode.BLEND,
    )  # fmt: skip
    builder.add_objects(builder.add_node(translation((0, 0.6, 0)) @ scaling((3, 0.02, 3))), 0, glass)


def set_value(name: str, value: Any) -> Change:
    return lambda builder: setattr(builder, name, value)


SCENES: dict[str, Scene] = {
    "highlights": make_scene(),
    "rims": make_scene(rim_strength=0.8, rim_power=2.0),
    "metals": make_scene(base_color=(0.7, 0.6, 0.5), metallic=0.7, roughness=0.4),
    "a pane": make_scene(put_pane),
    "haze": make_scene(set_value("haze", 0.06)),
    "fog": make_scene(set_value("fog", Fog(0.12, (0.1, 0.15, 0.3), 0.4, 0.0))),
    "level fog": make_scene(set_value("fog", Fog(0.05, (0.1, 0.15, 0.3), 0.0, 0.0))),
}


@pytest.fixture(scope="module", params=["gl", "cl", "wgpu"])
def device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    with open_device(request.param) as opened:
        yield opened


@cache
def trace(name: str, projection: str) -> NDArray[np.float64]:
    return RayTracer(SCENES[name]).draw(EYE.with_projection(PROJECTIONS[projection]), SIZE)


def difference(device: rhi.Device, name: str, projection: str, technique: str = "forward") -> float:
    """The greatest difference from rays in float64, in levels of 255, but for the hundredth of pixels that
    differ most: those of edges."""
    scene, camera = SCENES[name], EYE.with_projection(PROJECTIONS[projection])
    exact = trace(name, projection)
    with open_renderer(device, scene, TECHNIQUES[technique](), size=SIZE) as renderer:
        image = renderer.render(camera).image.read()[..., :3].astype(float)
    assert np.ptp(exact[..., 0]) > 20.0, "control: light changes over the image"
    share = 0.75 if technique == "inferred" else 0.99  # it blurs the light of fewer pixels
    return float(np.quantile(np.abs(image - exact).max(-1), share))


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=FEWER_CASES)
@pytest.mark.parametrize("projection", PROJECTIONS)
@pytest.mark.parametrize("name", SCENES)
def test_light_is_that_of_traced_rays(device: rhi.Device, name: str, projection: str) -> None:
    assert difference(device, name, projection) <= 1.6


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("technique", NAMES)
def test_each_technique_shows_parallel_rays(device: rhi.Device, technique: str) -> None:
    worst = {
        name: difference(device, name, "ahead of the eye", technique) for name in ("rims", "metals", "fog")
    }
    assert max(worst.values()) <= 1.6, worst


def test_each_device_shows_parallel_rays(device: rhi.Device) -> None:
    worst = {(name, technique): difference(device, name, "behind the eye", technique)
             for name, technique in (("rims", "forward"), ("fog", "deferred"))}  # fmt: skip
    assert max(worst.values()) <= 1.6, worst


def test_a_camera_may_change_its_projection(device: rhi.Device) -> None:
    """A renderer that has drawn one kind of projection draws the other as a new one does."""
    scene = SCENES["fog"]
    cameras = [EYE.with_projection(projection) for projection in PROJECTIONS.values()]
    with open_renderer(device, scene, size=SIZE) as renderer:
        images = [renderer.render(camera).image.read() for camera in (*cameras, *cameras)]
    for number, camera in enumerate(cameras):
        with open_renderer(device, scene, size=SIZE) as renderer:
            expected = renderer.render(camera).image.read()
        assert np.array_equal(images[number], expected)
        assert np.array_equal(images[number + len(cameras)], expected)


def test_only_parallel_projections_bind_rays_for_it(null: rhi.Device) -> None:
    with open_renderer(null, SCENES["haze"], size=SIZE) as renderer:
        for projection in PROJECTIONS.values():
            null.stream.clear()
            renderer.render(EYE.with_projection(projection))
            bound = {name for draw in null.stream.draws() for name in draw.bindings}
            assert ("rays" in bound) is isinstance(projection, Orthographic)


def test_fog_below_the_eye_is_seen_where_parallel_rays_begin_in_it(null: rhi.Device) -> None:
    """The eye is above the fog, and the lower edge of the image in it."""
    fog = Fog(0.05, (0.9, 0.2, 0.1), 1.0, -10.0)
    scene = make_scene(set_value("fog", fog), height=40.0)
    up = Camera.look_at((0.0, 12.0, 0.0), (0.0, 12.5, -1.0))
    with open_renderer(null, scene, size=SIZE) as renderer:
        for height, is_seen in ((40.0, True), (0.01, False)):
            camera = up.with_projection(Orthographic(height, 4 / 3, 0.0, 30.0))
            assert (Effect.FOG in renderer.plan(camera)[0].enabled) is is_seen
