"""Parameters that change nothing cost nothing: a scene with them has the commands and the image of one
without."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import open_device
from frames import open_renderer
from nightly_reasons import FEWER_CASES

import rhi
from renderer.content import BUILT_IN
from renderer.frame import Effect
from renderer.scene import (
    AlphaMode,
    Bloom,
    Camera,
    Fog,
    Scene,
    SceneBuilder,
    make_height_field,
    scaling,
    translation,
)
from renderer.techniques import TECHNIQUES
from rhi import Op

SIZE = (48, 32)
EYE = Camera.look_at((0.0, 1.7, 6.0), (0.0, 0.8, 0.0))
SKY = Camera.look_at((0.0, 30.0, 6.0), (0.0, 60.0, 5.0))
Add = Callable[[SceneBuilder], object]
BLEND, MASK = AlphaMode.BLEND, AlphaMode.MASK


def nothing(builder: SceneBuilder) -> None:
    """Add nothing."""


def add_box(
    builder: SceneBuilder, at: Any = (0.5, 0.8, 0.5), size: Any = (0.7, 0.7, 0.7), **material: Any
) -> None:
    """Add a box of a material of its own."""
    node = builder.add_node(translation(at) @ scaling(size))
    builder.add_objects(node, 0, builder.add_material(**material))


def box(**values: Any) -> Add:
    return lambda builder: add_box(builder, **values)


def light(kind: str, *values: Any, **parameters: Any) -> Add:
    return lambda builder: getattr(builder.lights, f"add_{kind}")(*values, **parameters)


def setting(name: str, value: object, add: Add = nothing) -> Add:
    def apply(builder: SceneBuilder) -> None:
        add(builder)
        setattr(builder, name, value)

    return apply


def terrain(builder: SceneBuilder) -> None:
    x, z = np.meshgrid(np.linspace(-1, 1, 17), np.linspace(-1, 1, 17))
    node = builder.add_node(translation((0, -8, 0)))
    builder.add_objects(
        node, builder.add_height_field(make_height_field(np.cos(4 * x) + np.sin(3 * z), 16.0)), 0
    )


def both(*adds: Add) -> Add:
    def apply(builder: SceneBuilder) -> None:
        for add in adds:
            add(builder)

    return apply


SUN = light("directional", (-0.3, -1, -0.5), casts_shadow=True)
DARK: tuple[dict[str, Any], ...] = (
    {"intensity": 0.0},
    {"color": (0, 0, 0)},
    {"intensity": 1e-40},
    {"intensity": 1e30, "color": (0, 0, 0)},
)
CLEAR = {"base_color": (1, 1, 1, 0.0), "alpha_mode": BLEND}
CUT = {"base_color": (1, 1, 1, 0.2), "alpha_mode": MASK, "alpha_cutoff": 0.9}
ORDINARY = Bloom(0.3)

LIGHTS: dict[str, tuple[Any, ...]] = {
    "directional": ((-0.3, -1, -0.5),),
    "point": ((0, 2, 1), 5.0),
    "spot": ((0, 2, 1), (0, -1, 0), 5.0, 0.3, 0.6),
}
"""What adds a light of each kind."""

NEUTRAL: dict[str, tuple[Add, Add]] = {
    **{
        f"a dark {kind} light, {number}": (
            light(kind, *values, casts_shadow=True, **dark),
            nothing,
        )
        for kind, values in LIGHTS.items()
        for number, dark in enumerate(DARK)
    },
    "a sphere light without strength": (
        light("point", (0, 2, 1), 5.0, intensity=0.0, source_radius=0.5),
        nothing,
    ),
    "a light of no range": (light("point", (0, 2, 1), 0.0, casts_shadow=True), nothing),
    "a dark sun beside a bright one": (
        both(light("directional", (1, -1, 0), intensity=0.0, casts_shadow=True), SUN),
        SUN,
    ),
    "a dark light before a bright one": (
        both(light("point", (0, 2, 1), 5.0, intensity=0.0), light("point", (1, 2, 1), 5.0)),
        light("point", (1, 2, 1), 5.0),
    ),
    "a box of scale 0": (box(size=(0, 0, 0)), nothing),
    "a box that is a line": (box(size=(0, 1, 0)), nothing),
    "a transparent box of scale 0": (
        box(size=(0, 0, 0), base_color=(1, 1, 1, 0.5), alpha_mode=BLEND),
        nothing,
    ),
    "a metal of scale 0": (box(size=(0, 0, 0), metallic=1.0, roughness=0.3), nothing),
    "a box of alpha 0": (box(**CLEAR), nothing),
    "a mask that is never passed": (box(**CUT), nothing),
    "an emitter of scale 0 in bloom": (
        setting("bloom", ORDINARY, box(size=(0, 0, 0), emission=2.5)),
        nothing,
    ),
    "an emitter of alpha 0 in bloom": (setting("bloom", ORDINARY, box(emission=2.5, **CLEAR)), nothing),
    "bloom without an emitter": (setting("bloom", ORDINARY), nothing),
    "a black emitter in bloom": (
        setting("bloom", ORDINARY, box(base_color=(0, 0, 0), emission=2.5)),
        box(base_color=(0, 0, 0), emission=2.5),
    ),
    "haze of nearly no density": (setting("haze", 1e-12), nothing),
    "haze of no density": (setting("haze", 0.0), nothing),
    "fog of the background's color and nearly no density": (
        setting("fog", Fog(1e-12, (0.02, 0.03, 0.05))),
        nothing,
    ),
    "a shadow of nothing": (both(box(at=(0, 2, 1), size=(0, 0, 0)), SUN), SUN),
}
"""Of each what is added to a scene, and to the one that it must equal."""

SEEN: dict[str, tuple[Add, Add]] = {
    "a faint light": (light("point", (0, 2, 1), 5.0, intensity=0.5), nothing),
    "a thin slab": (box(size=(0.7, 0.7, 0)), nothing),
    "a box of little alpha": (box(base_color=(1, 1, 1, 0.05), alpha_mode=BLEND), nothing),
    "a mask that is passed": (box(**CUT | {"alpha_cutoff": 0.1}), nothing),
    "an emitter in bloom": (setting("bloom", ORDINARY, box(emission=2.5)), box(emission=2.5)),
    "thin haze": (setting("haze", 0.02), nothing),
    "thin fog": (setting("fog", Fog(0.02)), nothing),
    "fog that ends below the eye": (setting("fog", Fog(0.5, falloff=3.0, base=-1.0)), nothing),
}
"""Controls: what is added to a scene, and changes it."""


def make(add: Add) -> Scene:
    builder = SceneBuilder("neutral")
    builder.background = (0.02, 0.03, 0.05)
    builder.lights.sky, builder.lights.ground = (0.3, 0.34, 0.42), (0.16, 0.14, 0.12)
    builder.add_mesh(BUILT_IN["box"]())
    grey = builder.add_material(base_color=(0.62, 0.6, 0.56))
    for at, size in (((0, -0.15, 0), (7, 0.3, 5)), ((-0.9, 0.6, -0.5), (1.2, 1.2, 1.2))):
        builder.add_objects(builder.add_node(translation(at) @ scaling(size)), 0, grey)
    add(builder)
    return builder.build()


def list_work(
    scene: Scene, camera: Camera = EYE, technique: str = "forward"
) -> tuple[Counter[Op], list[str], int]:
    """The commands of three frames, by what they do, the passes of the last one, and how many objects it
    shows."""
    with (
        rhi.create_device("null") as device,
        open_renderer(device, scene, TECHNIQUES[technique](), visibility="frustum", size=SIZE) as renderer,
    ):
        visible = [len(renderer.render(camera, float(seconds)).visible) for seconds in range(3)]
        commands = Counter(command.op for command in device.stream)
        return commands, [frame_pass.name for frame_pass in renderer.plan(camera)[1].passes], visible[-1]


@pytest.mark.parametrize("name", NEUTRAL)
def test_what_changes_nothing_costs_no_command(name: str) -> None:
    neutral, plain = NEUTRAL[name]
    assert list_work(make(neutral)) == list_work(make(plain))


@pytest.mark.parametrize("name", SEEN)
def test_what_changes_something_is_drawn(name: str) -> None:
    """Control: the comparison finds what is there."""
    seen, plain = SEEN[name]
    assert list_work(make(seen)) != list_work(make(plain))


@pytest.mark.parametrize("technique", [name for name in TECHNIQUES if name != "auto"])
def test_lights_without_strength_cost_nothing_with_any_technique(technique: str) -> None:
    dark = both(
        *(
            NEUTRAL[name][0]
            for name in NEUTRAL
            if "light" in name and "beside" not in name and "before" not in name
        )
    )
    assert list_work(make(dark), technique=technique) == list_work(make(nothing), technique=technique)


def test_terrain_that_casts_shadows_isnt_tessellated_for_a_view_of_the_sky() -> None:
    assert (
        list_work(make(both(terrain, SUN)), SKY)[0][Op.DISPATCH] == list_work(make(SUN), SKY)[0][Op.DISPATCH]
    )
    assert list_work(make(both(terrain, SUN)))[0][Op.DISPATCH] > 0, (
        "control: the view of the ground tessellates it"
    )


def test_fog_far_below_the_eye_isnt_in_a_view_of_the_sky() -> None:
    low = setting("fog", Fog(0.02, falloff=1.0, base=-1e4))
    assert list_work(make(low), SKY) == list_work(make(nothing), SKY)
    high = setting("fog", Fog(0.02, falloff=0.01, base=30.0))
    assert list_work(make(high), SKY) != list_work(make(nothing), SKY), "control: fog around the eye"


@pytest.mark.nightly_cases("wgpu", reason=FEWER_CASES)
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
def test_what_changes_nothing_leaves_the_image(backend: str) -> None:
    """And what is seen changes it."""
    with open_device(backend) as device:

        def draw(add: Add) -> Any:
            with open_renderer(device, make(add), size=SIZE) as renderer:
                return renderer.render(EYE).image.read().astype(int)

        for neutral, plain in NEUTRAL.values():
            assert np.array_equal(draw(neutral), draw(plain))
        for seen, plain in SEEN.values():
            assert np.abs(draw(seen) - draw(plain)).max() > 1


def test_what_becomes_seen_is_drawn_at_once(null: rhi.Device) -> None:
    scene = make(both(NEUTRAL["a box of alpha 0"][0], light("point", (0, 2, 1), 5.0, intensity=0.0)))
    with open_renderer(null, scene, size=SIZE) as renderer:
        assert len(renderer.render(EYE).visible) == 2
        assert Effect["POINT_LIGHTS"] not in renderer.plan(EYE)[0].enabled
        scene.materials["base_color"][-1, 3] = 0.5
        scene.lights.point["intensity"] = 1.0
        assert len(renderer.render(EYE).visible) == 3
        assert Effect["POINT_LIGHTS"] in renderer.plan(EYE)[0].enabled
