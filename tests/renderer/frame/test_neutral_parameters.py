"""Parameters that change nothing cost nothing: a scene with them has the commands and the image of one
without.

`neutral_parameters` makes the scenes. The ray tracer, which knows nothing of the rule, says that both scenes
of a pair look the same; null that they have the same commands, and each device that it draws the same.
"""

from __future__ import annotations

import inspect
from collections import Counter
from typing import Any

import numpy as np
import pytest
from frames import open_renderer
from neutral_parameters import (
    BLOOM_FIELDS,
    CALLED_FOR_SETTINGS,
    FOG_FIELDS,
    FOLLOWING_FIELDS,
    LIGHT_FIELDS,
    MATERIAL_FIELDS,
    SCENE_PARTS,
    UNNEEDED_SETTINGS,
    Neutral,
    add_box,
    make_scene,
    spread_air,
    spread_all,
    spread_equal_materials,
    spread_lights,
    spread_materials,
    spread_objects,
    spread_settings,
    spread_small_lights,
)
from nightly_reasons import FEWER_CASES
from nights import rotate_seed
from tested_devices import open_device

import rhi
from renderer.frame import Blending, Effect
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.light_kinds.table import LIGHT_KINDS
from renderer.scene import (
    AlphaMode,
    Bloom,
    Camera,
    Fog,
    Scene,
    ShadingModel,
    make_height_field,
    scaling,
    translation,
)
from renderer.scene.materials import MATERIAL
from renderer.settings import RenderSettings
from renderer.techniques import TECHNIQUES
from rhi import Op

SIZE = (24, 16)
EYE = Camera.look_at((0.0, 1.7, 6.0), (0.0, 0.8, 0.0))
SKY = Camera.look_at((0.0, 30.0, 6.0), (0.0, 60.0, 5.0))
SPREADS = {
    "lights": spread_lights,
    "small lights": spread_small_lights,
    "materials": spread_materials,
    "equal materials": spread_equal_materials,
    "objects": spread_objects,
    "air": spread_air,
}
BY_DAY = 10
"""Pairs of each spread that are compared in the default run."""

OF_IMAGES = (Op.CREATE_TEXTURE, Op.CREATE_BUFFER, Op.WRITE_BUFFER, Op.BIND_STORAGE)
"""Commands of a scene's images and their table, which are on the device whether a material reads them or not."""
UNCOUNTED = {
    Op.CREATE_SAMPLER,
    Op.GENERATE_MIPMAPS,
    Op.WRITE_TEXTURE,
    Op.DESTROY,
    Op.CREATE_PROGRAM,
    Op.SET_STATES,
}
"""Commands of a scene's images, and those of which a device in use needs fewer."""


def list_work(
    device: rhi.Device, scene: Scene, camera: Camera = EYE, technique: str = "forward"
) -> tuple[Any, ...]:
    """The commands of three frames, by what they do, the effects, the passes of the last one, and how many
    objects it shows."""
    device.stream.clear()
    with open_renderer(device, scene, TECHNIQUES[technique](), visibility="frustum", size=SIZE) as renderer:
        visible = [len(renderer.render(camera, float(seconds)).visible) for seconds in range(3)]
        effects, plan = renderer.plan(camera)
        commands = Counter(command.op for command in device.stream if command.op not in UNCOUNTED)
        return commands, effects.enabled, [frame_pass.name for frame_pass in plan.passes], visible[-1]


def select(pairs: list[Neutral], count: int, seed: int) -> list[Neutral]:
    random = np.random.default_rng(seed)
    return [pairs[index] for index in random.permutation(len(pairs))[:count]]


def test_each_field_has_values() -> None:
    """A new field of lights, materials, fog, bloom or scenes must say at which values it changes nothing."""
    assert set(LIGHT_FIELDS) == {name for kind in LIGHT_KINDS for name in kind.dtype.names or ()}
    assert set(MATERIAL_FIELDS) | FOLLOWING_FIELDS == set(MATERIAL.names or ())
    assert set(FOG_FIELDS) == set(inspect.signature(Fog).parameters)
    assert set(BLOOM_FIELDS) == set(inspect.signature(Bloom).parameters)
    assert set(SCENE_PARTS) == {
        *inspect.signature(Scene).parameters,
        "fog",
        "bloom",
        "ambient_occlusion",
        "depth_of_field",
        "environment",
    }
    assert len(spread_all()) > 500


def check(device: rhi.Device, pairs: list[Neutral]) -> None:
    """The equal scene comes first, since a new device makes buffers that later scenes share."""
    different = []
    for pair in pairs:
        scenes = make_scene(pair.equal), make_scene(pair.add), make_scene(pair.equal)
        works = [list_work(device, scene) for scene in scenes]
        if any(scene.images for scene in scenes):
            for work in works:
                for op in OF_IMAGES:
                    del work[0][op]
        if works[1] != works[2]:
            different.append(str(pair))
    assert not different


@pytest.mark.parametrize("spread", SPREADS)
def test_neutral_parameters_cost_no_command(null: rhi.Device, spread: str) -> None:
    check(null, select(list(SPREADS[spread]()), BY_DAY, 5))


@pytest.mark.nightly_cases(reason=FEWER_CASES)
@pytest.mark.parametrize("spread", SPREADS)
def test_no_pair_of_the_generator_costs_a_command(null: rhi.Device, spread: str) -> None:
    check(null, list(SPREADS[spread]()))


@pytest.mark.nightly_cases(reason=FEWER_CASES)
@pytest.mark.parametrize("spread", ["lights", "materials", "equal materials", "air"])
def test_rays_say_that_it_changes_nothing(spread: str) -> None:
    """The rule is right: images in float64 differ by half a level at most."""
    for pair in select(list(SPREADS[spread]()), 40, rotate_seed(8)):
        scenes = [make_scene(pair.add), make_scene(pair.equal)]
        for scene in scenes:
            scene.bloom = None
        first, second = (RayTracer(scene, has_shadows=False).draw(EYE, SIZE) for scene in scenes)
        assert np.abs(first - second).max() <= 0.5, pair


@pytest.mark.nightly_cases("wgpu*", "cl*", reason=FEWER_CASES)
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
def test_neutral_parameters_do_not_change_the_image(backend: str) -> None:
    pairs = [pair for spread in SPREADS.values() for pair in select(list(spread()), 2, 11)]
    with open_device(backend) as device:
        for pair in pairs:
            images = []
            for add in (pair.add, pair.equal):
                with open_renderer(device, make_scene(add), size=SIZE) as renderer:
                    images.append(renderer.render(EYE).image.read())
            assert np.array_equal(*images), pair


SEEN: dict[str, Any] = {
    "a faint light": lambda builder: builder.lights.add_point((0, 2, 1), 5.0, intensity=0.5),
    "a faint sun": lambda builder: builder.lights.add_directional((-0.3, -1, -0.5), intensity=0.01),
    "a narrow spot": lambda builder: builder.lights.add_spot((0, 2, 1), (0, -1, 0), 5.0, 0.0, 0.01),
    "a thin slab": lambda builder: add_box(builder, {}, size=(0.7, 0.7, 0)),
    "a moving slab": lambda builder: add_box(builder, {}, size=(0.7, 0.7, 0), dynamic=True),
    "little alpha": lambda builder: add_box(
        builder, {"base_color": (1, 1, 1, 0.05), "alpha_mode": AlphaMode.BLEND}
    ),
    "nearly all alpha": lambda builder: add_box(
        builder, {"base_color": (1, 1, 1, 0.99), "alpha_mode": AlphaMode.BLEND}
    ),
    "thin haze": lambda builder: setattr(builder, "haze", 0.02),
    "thin fog": lambda builder: setattr(builder, "fog", Fog(0.02)),
    "fog that ends below the eye": lambda builder: setattr(builder, "fog", Fog(0.5, falloff=3.0, base=-1.0)),
}
"""Controls: what changes a scene."""


@pytest.mark.parametrize("name", SEEN)
def test_effective_parameters_change_the_commands(null: rhi.Device, name: str) -> None:
    assert list_work(null, make_scene(SEEN[name])) != list_work(null, make_scene(bool))


@pytest.mark.parametrize("technique", [name for name in TECHNIQUES if name != "auto"])
def test_dark_lights_cost_nothing_with_any_technique(null: rhi.Device, technique: str) -> None:
    def add_dark(builder: Any) -> None:
        for pair in spread_lights():
            pair.add(builder)

    dark = list_work(null, make_scene(add_dark), technique=technique)
    assert dark == list_work(null, make_scene(bool), technique=technique)


def add_lights(builder: Any) -> None:
    builder.lights.add_directional((-0.3, -1.0, -0.5), casts_shadow=True)
    builder.lights.add_point((0.0, 2.0, 1.0), 5.0, casts_shadow=True)
    builder.lights.add_spot((0.0, 2.0, 1.0), (0.0, -1.0, 0.0), 5.0, 0.2, 0.5)


def make_black_scene(add: Any, specular: float = 0.0) -> Scene:
    """A scene whose surfaces only emit light."""
    emits = {"base_color": (0.0, 0.0, 0.0, 1.0), "emissive": (0.3, 0.2, 0.1)}
    scene = make_scene(lambda builder: (add_box(builder, emits), add(builder)))
    scene.materials["base_color"][:, :3], scene.materials["specular_color"] = 0.0, specular
    scene.materials["model"] = ShadingModel.SPECULAR
    return scene


@pytest.mark.parametrize("technique", ["forward", "deferred", "clustered"])
def test_lights_cost_nothing_where_surfaces_reflect_nothing(null: rhi.Device, technique: str) -> None:
    unlit = list_work(null, make_black_scene(bool), technique=technique)
    assert list_work(null, make_black_scene(add_lights), technique=technique) == unlit
    glossy = [list_work(null, make_black_scene(add, 1.0), technique=technique) for add in (add_lights, bool)]
    assert glossy[0] != glossy[1], "control"


def test_rims_of_black_surfaces_reflect_ambient_light() -> None:
    scene = make_black_scene(bool)
    assert scene.strongest_response() == 0.0
    scene.materials["rim_strength"] = 3.0
    assert scene.strongest_response() == 3.0


def test_the_sky_pass_is_left_out_where_fog_is_the_background(null: rhi.Device) -> None:
    def passes(color: tuple[float, float, float]) -> list[str]:
        scene = make_scene(lambda builder: setattr(builder, "fog", Fog(0.05, color)))
        return list_work(null, scene)[2]

    background = make_scene(bool).background
    assert "sky" not in passes(background)
    assert "sky" in passes((0.3, 0.3, 0.3)), "control"


def test_haze_and_fog_that_dark_surfaces_show_count() -> None:
    """A share of 1/600 of white is six levels on black: sRGB raises dark colors."""
    with open_device("gl") as device:

        def draw(haze: float) -> Any:
            scene = make_scene(lambda builder: add_box(builder, {"base_color": (0, 0, 0)}, size=(9, 9, 0.1)))
            scene.background, scene.haze = (1.0, 1.0, 1.0), haze
            scene.lights.sky = scene.lights.ground = (0.0, 0.0, 0.0)
            with open_renderer(device, scene, size=SIZE) as renderer:
                return renderer.render(EYE).image.read()[8, 12, 0]

        assert draw(0.0) == 0
        assert draw(0.0016 / 5.3) > 3


def add_terrain(builder: Any) -> None:
    x, z = np.meshgrid(np.linspace(-1, 1, 17), np.linspace(-1, 1, 17))
    mesh = builder.add_height_field(make_height_field(np.cos(4 * x) + np.sin(3 * z), 16.0))
    builder.add_objects(builder.add_node(translation((0, -8, 0))), mesh, 0)


def add_sun(builder: Any) -> None:
    builder.lights.add_directional((-0.3, -1, -0.5), casts_shadow=True)


def test_terrain_that_casts_shadows_isnt_tessellated_for_a_view_of_the_sky(null: rhi.Device) -> None:
    both = make_scene(lambda builder: (add_terrain(builder), add_sun(builder)))
    sunny = make_scene(add_sun)
    assert list_work(null, both, SKY)[0][Op.DISPATCH] == list_work(null, sunny, SKY)[0][Op.DISPATCH]
    assert list_work(null, both)[0][Op.DISPATCH] > 0, "control: the view of the ground tessellates it"


def test_fog_far_below_the_eye_isnt_in_a_view_of_the_sky(null: rhi.Device) -> None:
    low, high = (
        make_scene(lambda builder, fog=fog: setattr(builder, "fog", fog))
        for fog in (Fog(0.02, falloff=1.0, base=-1e4), Fog(0.02, falloff=0.01, base=30.0))
    )
    assert list_work(null, low, SKY) == list_work(null, make_scene(bool), SKY)
    assert list_work(null, high, SKY) != list_work(null, make_scene(bool), SKY), "control: fog around the eye"


def test_an_object_or_light_that_becomes_visible_is_drawn_in_the_next_frame(null: rhi.Device) -> None:
    clear = {"base_color": (1, 1, 1, 0.0), "alpha_mode": AlphaMode.BLEND}
    scene = make_scene(
        lambda builder: (add_box(builder, clear), builder.lights.add_point((0, 2, 1), 5.0, intensity=0.0))
    )
    with open_renderer(null, scene, size=SIZE) as renderer:
        assert len(renderer.render(EYE).visible) == 2
        assert Effect["POINT_LIGHTS"] not in renderer.plan(EYE)[0].enabled
        for alpha, effect in ((0.5, True), (1.0, False)):
            scene.materials["base_color"][-1, 3] = alpha
            scene.lights.point["intensity"] = 1.0
            assert len(renderer.render(EYE).visible) == 3
            assert Effect["POINT_LIGHTS"] in renderer.plan(EYE)[0].enabled
            assert (Effect.TRANSPARENCY in renderer.plan(EYE)[0].enabled) is effect


def test_an_object_that_grows_from_nothing_is_drawn_at_once(null: rhi.Device) -> None:
    """One that shrinks to nothing is drawn for some frames more: lists aren't made again in each."""
    scene = make_scene(lambda builder: add_box(builder, {}, size=(0, 0, 0), dynamic=True))
    node = len(scene.nodes) - 1
    large, none = translation((0.5, 0.8, 0.5)), translation((0.5, 0.8, 0.5)) @ scaling(np.zeros(3))
    with open_renderer(null, scene, size=SIZE) as renderer:
        counts, versions = [], []
        for frame in range(400):
            scene.nodes.set_local(node, large if frame % 200 < 3 and frame else none)
            counts.append(len(renderer.render(EYE).visible))
            versions.append(scene.material_version)
    assert counts[0] == 2
    assert counts[1:3] == [3, 3]
    assert counts[199] == 2
    assert counts[200:203] == [3, 3, 3]
    assert len(set(versions)) <= 5


def test_shadows_of_the_sun_write_nothing_while_the_eye_turns_in_the_sky(null: rhi.Device) -> None:
    def bytes_written(add: Any, aim: tuple[float, float, float]) -> int:
        with open_renderer(null, make_scene(add), visibility="frustum", size=SIZE) as renderer:
            for turn in range(6):
                camera = Camera.look_at((0.0, 1.7, 6.0), np.add(aim, (0.05 * turn, 0.0, 0.0)))
                written = renderer.render(camera).statistics.upload_bytes
            return written

    up, down = (0.0, 60.0, 5.0), (0.0, 0.8, 0.0)
    assert bytes_written(add_sun, up) == bytes_written(bool, up)
    assert bytes_written(add_sun, down) > bytes_written(bool, down), "control: shadows are in view"


BOX_SETTINGS = RenderSettings().change_all({"technique.name": "forward", "algorithm": "frustum"})


def list_settings_work(device: rhi.Device, scene: Scene, settings: RenderSettings) -> tuple[Any, ...]:
    """The commands of three frames, by what they do, and the passes of the last one."""
    device.stream.clear()
    with settings.open(device, scene, SIZE) as renderer:
        for seconds in range(3):
            renderer.render(settings.adapt_camera(EYE), float(seconds))
        passes = [frame_pass.name for frame_pass in renderer.plan(EYE)[1].passes]
        commands = Counter(command.op for command in device.stream if command.op not in UNCOUNTED)
        return commands, passes


def test_each_setting_is_called_for_or_has_values() -> None:
    assert set(UNNEEDED_SETTINGS) | CALLED_FOR_SETTINGS == set(RenderSettings().list_paths())
    assert not set(UNNEEDED_SETTINGS) & CALLED_FOR_SETTINGS


def test_settings_of_effects_that_a_scene_lacks_cost_no_command(null: rhi.Device) -> None:
    usual = list_settings_work(null, make_scene(bool), BOX_SETTINGS)
    different = []
    for setting in spread_settings():
        settings = BOX_SETTINGS.change(setting.path, setting.value)
        if list_settings_work(null, make_scene(bool), settings) != usual:
            different.append(str(setting))
    assert not different


@pytest.mark.nightly_cases("wgpu*", "cl*", reason=FEWER_CASES)
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
def test_settings_of_effects_that_a_scene_lacks_do_not_change_the_image(backend: str) -> None:
    """Rays in float64, which know no settings, say the same of all of them."""
    scene = make_scene(bool)
    traced = RayTracer(scene).draw(EYE.with_aspect(SIZE[0] / SIZE[1]), SIZE)
    random = np.random.default_rng(rotate_seed(4))
    settings_list = [*spread_settings()]
    with open_device(backend) as device:
        images = []
        for changed in (None, *random.permutation(len(settings_list))[:12].tolist()):
            settings = BOX_SETTINGS
            if changed is not None:
                setting = settings_list[changed]
                settings = settings.change(setting.path, setting.value)
            with settings.open(device, scene, SIZE) as renderer:
                images.append(renderer.render(EYE).image.read())
            assert np.array_equal(images[0], images[-1]), settings_list[changed or 0]
    assert np.median(np.abs(images[0][..., :3] - traced).max(axis=2)) <= 1.0


CALLING: dict[str, tuple[Any, Any]] = {
    "shadows.cascades": (add_sun, 1),
    "bloom.levels": (
        lambda builder: (add_box(builder, {"emission": 9.0}), setattr(builder, "bloom", Bloom(0.1))),
        2,
    ),
    "blending": (
        lambda builder: add_box(builder, {"base_color": (1, 1, 1, 0.5), "alpha_mode": AlphaMode.BLEND}),
        Blending.WEIGHTED,
    ),
}
"""Controls: scenes that call for a setting."""


@pytest.mark.parametrize("path", CALLING)
def test_settings_of_effects_that_a_scene_has_change_the_commands(null: rhi.Device, path: str) -> None:
    add, value = CALLING[path]
    usual, changed = (
        list_settings_work(null, make_scene(add), settings)
        for settings in (BOX_SETTINGS, BOX_SETTINGS.change(path, value))
    )
    assert usual != changed
