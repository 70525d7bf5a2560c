"""A ladder of scenes, in which each rung has one effect more than the one before.

A rung is a value: what it adds to a scene, how the effect is switched on and off in a renderer that runs, and its
footprint, which says what of a stream belongs to it. A new effect declares its need by an entry in `LADDER`, and is
then counted, timed, pictured and tested as all others are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np

from renderer.content import BUILT_IN
from renderer.content.fountains import BOUNDS, Fountains, make_drops
from renderer.content.material_shaders import Marble
from renderer.layers.overlay import Overlay
from renderer.layers.particles import Particles
from renderer.renderer import Renderer
from renderer.scene import (
    AlphaMode,
    Camera,
    Fog,
    Glow,
    Scene,
    SceneBuilder,
    StereoRig,
    make_height_field,
    make_material,
    translation,
)
from renderer.scene.cloth import Cloths, Gust, Wind, make_sheet
from renderer.stereo import Stereo
from renderer.techniques import Forward, Smoothed
from rhi import BlendFunction, Op
from rhi.testing import Footprint

Switch = Callable[[Renderer, int, bool], None]
"""Switches an effect on or off, given the row of the material that its rung has added, -1 if it has added none."""


@dataclass(frozen=True, slots=True)
class Rung:
    """A step of the ladder.

    Attributes:
        adds: what the scene has more than the one before, in a few words.
        footprint: what of a stream belongs to the effect; None if what the rung adds is no effect of its own.
        place: adds what the effect needs to a scene; returns the row of a material of its own, or -1.
        switch: switches the effect on and off at run time; None for what is a part of a scene and removed by leaving it
            out.
        modules: the beginnings of the names of those modules of which nothing runs in a frame without the effect.
    """

    name: str
    adds: str
    footprint: Footprint | None = None
    place: Callable[[SceneBuilder], int] = lambda _: -1
    switch: Switch | None = None
    modules: tuple[str, ...] = ()


def _place_hidden(builder: SceneBuilder) -> int:
    """Add an object behind the eye: a scene has at least one."""
    builder.lights.sky, builder.lights.ground = (0.30, 0.34, 0.42), (0.16, 0.14, 0.12)
    builder.background = (0.05, 0.07, 0.11)
    material = builder.add_material(base_color=(0.5, 0.5, 0.5))
    _add_box(builder, material, (0.0, -40.0, 60.0), (1.0, 1.0, 1.0))
    return material


def _place_box(builder: SceneBuilder) -> int:
    material = builder.add_material(base_color=(0.62, 0.60, 0.56))
    _add_box(builder, material, (0.0, -0.15, 0.0), (7.0, 0.3, 5.0))
    _add_box(builder, material, (-0.9, 0.6, -0.5), (1.2, 1.2, 1.2))
    return material


def _add_box(
    builder: SceneBuilder, material: int, at: tuple[float, float, float], size: tuple[float, float, float]
) -> None:
    place = translation(at) @ np.diag([*size, 1.0])
    builder.add_objects(builder.add_node(place), builder.add_mesh(BUILT_IN["box"]()), material)


def _switch_light(kind: str, values: tuple[Any, ...], renderer: Renderer, _: int, is_on: bool) -> None:
    lights = renderer.scene.lights
    setattr(lights, kind, getattr(lights, kind)[:0])
    if is_on:
        getattr(lights, f"add_{kind}")(*values)


def _switch_rows(kinds: tuple[str, ...], name: str, value: float, renderer: Renderer, _: int, is_on: bool) -> None:
    """Give a field of all lights of these kinds a value, or 0."""
    for kind in kinds:
        getattr(renderer.scene.lights, kind)[name] = value if is_on else 0.0


def _place_textured(builder: SceneBuilder) -> int:
    rows, columns = np.indices((64, 64)) // 8
    image = np.full((64, 64, 4), 255, np.uint8)
    image[..., :3] = np.where(((rows + columns) % 2)[..., None], (196, 92, 60), (232, 214, 180))
    material = builder.add_material(texture=builder.add_image(image))
    _add_box(builder, material, (0.45, 0.35, 0.9), (0.7, 0.7, 0.7))
    return material


def _place_ball(at: tuple[float, float, float], given: dict[str, Any], builder: SceneBuilder) -> int:
    material = builder.add_material(**given)
    node = builder.add_node(translation(at) @ np.diag([0.45, 0.45, 0.45, 1.0]))
    builder.add_objects(node, builder.add_mesh(BUILT_IN["sphere"]()), material)
    return material


def _switch_metal(renderer: Renderer, material: int, is_on: bool) -> None:
    materials = renderer.scene.materials
    color = materials["base_color"][material].tolist()
    materials[material] = make_material(color, metallic=1.0, roughness=0.3) if is_on else make_material(color)


def _place_tube(builder: SceneBuilder) -> int:
    material = builder.add_material(base_color=(0.3, 0.95, 0.75))
    _add_box(builder, material, (-2.5, 0.7, -1.2), (0.16, 1.4, 0.16))
    return material


def _switch_emission(renderer: Renderer, material: int, is_on: bool) -> None:
    renderer.scene.materials[material]["emission"] = 2.5 if is_on else 0.0


def _place_pane(builder: SceneBuilder) -> int:
    material = builder.add_material(base_color=(0.35, 0.75, 0.55, 0.4))
    _add_box(builder, material, (1.15, 0.8, -0.2), (0.06, 1.6, 1.8))
    return material


def _switch_glass(renderer: Renderer, material: int, is_on: bool) -> None:
    renderer.scene.materials[material]["alpha_mode"] = AlphaMode.BLEND if is_on else AlphaMode.OPAQUE


def _switch_air(name: str, value: object, nothing: object, renderer: Renderer, _: int, is_on: bool) -> None:
    setattr(renderer.scene, name, value if is_on else nothing)


def _place_terrain(builder: SceneBuilder) -> int:
    x, z = np.meshgrid(np.linspace(-1.0, 1.0, 33), np.linspace(-1.0, 1.0, 33))
    heights = 3.0 * np.maximum(-z - 0.1, 0.0) * (0.6 + 0.4 * np.cos(4.0 * x + 1.0)) - 0.35
    material = builder.add_material(base_color=(0.34, 0.42, 0.24))
    node = builder.add_node(translation((0.0, 0.0, -1.0)))
    builder.add_objects(node, builder.add_height_field(make_height_field(heights, 16.0)), material)
    return material


def _place_fountain(builder: SceneBuilder) -> int:
    material = builder.add_material(base_color=(0.55, 0.72, 0.85))
    mesh = builder.add_mesh(make_drops(), "spray", BOUNDS)
    node = builder.add_node(translation((2.0, 0.0, 0.6)))
    builder.simulate(builder.add_objects(node, mesh, material), Fountains(1, 5))
    return material


def _place_flag(builder: SceneBuilder) -> int:
    columns, rows = np.meshgrid(np.linspace(0.0, 1.3, 11), np.linspace(0.0, -0.9, 8))
    pinned = np.zeros(columns.shape, bool)
    pinned[:, 0] = True
    sheet = make_sheet(np.stack([columns, rows, np.zeros_like(rows)], 2), pinned)
    material = builder.add_material(base_color=(0.75, 0.12, 0.14), double_sided=True)
    _add_box(builder, material, (-2.1, 1.0, -1.6), (0.07, 2.0, 0.07))
    mesh = builder.add_mesh(sheet.make_mesh(), "flag", sheet.bounds)
    flag = builder.add_objects(builder.add_node(translation((-2.06, 1.95, -1.6))), mesh, material)
    wind = Wind((3.0, 0.0, 0.6), (Gust((0.5, 0.0, 2.5), (1.2, 0.2, 0.0), 1.3),))
    builder.simulate(flag, Cloths(1, sheet, wind))
    return material


def _switch_layer(kind: type[Any], renderer: Renderer, _: int, is_on: bool) -> None:
    if is_on:
        renderer.layers.append(kind(renderer.device))
        return
    for layer in [one for one in renderer.layers if isinstance(one, kind)]:
        renderer.layers.remove(layer)
        layer.destroy()


def _switch_fxaa(renderer: Renderer, _: int, is_on: bool) -> None:
    renderer.technique = Smoothed(Forward()) if is_on else Forward()


def _switch_samples(renderer: Renderer, _: int, is_on: bool) -> None:
    renderer.technique = Forward(samples=4) if is_on else Smoothed(Forward())


def _switch_stereo(renderer: Renderer, _: int, is_on: bool) -> None:
    renderer.stereo = Stereo(StereoRig(0.063, 7.0), "dubois") if is_on else None


_SPOT: Final = ((2.6, 3.2, 1.0), (-0.1, -1.0, -0.1), 6.0, 0.15, 0.35, (0.35, 0.55, 1.0), 20.0)
LADDER: Final = (
    Rung("empty", "an object behind the eye, no light but the sky's", place=_place_hidden),
    Rung("box", "a box on a ground", place=_place_box),
    Rung(
        "sun",
        "a directional light",
        Footprint(
            "sun", words=("DirectionalLight",), bindings=("directional*",), resources=("directional lights",)
        ),
        switch=partial(_switch_light, "directional", ((0.8, -1.0, 0.3), (1.0, 0.93, 0.82), 0.8)),
    ),
    Rung(
        "lamp",
        "a point light",
        Footprint(
            "lamp", words=("PointLight",), bindings=("point_lights", "light_rows"),
            resources=("point lights", "light rows"),
        ),
        switch=partial(_switch_light, "point", ((1.3, 1.3, 1.1), 5.0, (1.0, 0.55, 0.2), 3.5)),
    ),
    Rung(
        "spot",
        "a spot light",
        Footprint("spot", words=("SpotLight",), bindings=("spot_lights",), resources=("spot lights",)),
        switch=partial(_switch_light, "spot", _SPOT),
    ),
    Rung(
        "shadow",
        "the sun casts shadows",
        Footprint(
            "shadow", programs=("DepthOnly",), bindings=("suns", "shadow_*"),
            resources=("shadow atlas", "SunTable"), events=("shadow maps",),
        ),
        switch=partial(_switch_rows, ("directional",), "casts_shadow", True),
        modules=("renderer.shadows",),
    ),
    Rung(
        "lamp shadows",
        "both lamps cast shadows",
        Footprint("lamp shadows", bindings=("lamps", "lamp_*"), resources=("LampTable", "lamp slots", "lamp maps")),
        switch=partial(_switch_rows, ("point", "spot"), "casts_shadow", True),
    ),
    Rung(
        "sphere",
        "the point light is a sphere",
        Footprint("sphere", words=("sphere_cosine",), bindings=("source_radii",), resources=("source radii",)),
        switch=partial(_switch_rows, ("point",), "source_radius", 0.25),
    ),
    Rung(
        "texture",
        "a box with an image",
        Footprint("texture", words=("sampler2DArray",), bindings=("images*",), resources=("images*",)),
        _place_textured,
    ),
    Rung(
        "metal",
        "a ball of metal",
        Footprint("metal", words=("metal_surface",)),
        partial(_place_ball, (-1.7, 0.45, 1.2), {"base_color": (0.9, 0.72, 0.35)}),
        _switch_metal,
    ),
    Rung(
        "marble",
        "a ball whose material has a shader of its own",
        Footprint(
            "marble", words=("find_noise",), bindings=("parameters",), resources=("parameters of Marble",)
        ),
        partial(_place_ball, (-0.55, 0.45, 1.9), {"shader": Marble, "base_color": (0.8, 0.82, 0.9), "frequency": 3.0}),
    ),
    Rung(
        "emission",
        "a tube that emits light",
        Footprint("emission", words=(".emission",)),
        _place_tube,
        _switch_emission,
    ),
    Rung(
        "glow",
        "what is brighter than white glows",
        Footprint(
            "glow", words=("keep_light",), bindings=("spread", "mixture"),
            events=("glow", "tones"),
        ),
        switch=partial(_switch_air, "glow", Glow(0.1), None),
        modules=("renderer.techniques.parts.glow",),
    ),
    Rung(
        "glass",
        "a transparent pane",
        Footprint("glass", events=("transparency",), states=(BlendFunction.PREMULTIPLIED,)),
        _place_pane,
        _switch_glass,
        modules=("renderer.techniques.parts.transparency",),
    ),
    Rung(
        "haze",
        "haze in the air",
        Footprint("haze", words=("through_haze",), bindings=("haze",), resources=("Haze",)),
        switch=partial(_switch_air, "haze", 0.05, 0.0),
    ),
    Rung(
        "fog",
        "fog that lies on the ground",
        Footprint("fog", words=("through_all_fog", "FogConstants"), bindings=("fog",), events=("sky",)),
        switch=partial(_switch_air, "fog", Fog(0.25, falloff=1.2), None),
    ),
    Rung(
        "terrain",
        "hills whose triangles are chosen for the view",
        Footprint(
            "terrain", programs=("Begin", "Bisect", "Finish"), resources=("height field*",),
            events=("tessellation",),
        ),
        _place_terrain,
        modules=("renderer.tessellation",),
    ),
    Rung(
        "fountain",
        "a simulated fountain",
        place=_place_fountain,
        modules=("renderer.content.fountains",),
    ),
    Rung(
        "particles",
        "the fountain's drops as sprites",
        Footprint(
            "particles", programs=("*Particle*",), bindings=("particles",), events=("particles",),
        ),
        switch=partial(_switch_layer, Particles),
        modules=("renderer.layers.particles",),
    ),
    Rung(
        "cloth",
        "a flag in the wind",
        Footprint("cloth", programs=("StepCloths",), resources=("cloth *",)),
        _place_flag,
        modules=("renderer.scene.cloth",),
    ),
    Rung(
        "fxaa",
        "edges of the image smoothed",
        Footprint("fxaa", programs=("Fxaa",), events=("fxaa",)),
        switch=_switch_fxaa,
        modules=("renderer.techniques.parts.fxaa",),
    ),
    Rung(
        "msaa",
        "four samples per pixel instead",
        Footprint("msaa", resources=("* samples*",), ops=(Op.RESOLVE_TEXTURE,), events=("resolve",)),
        switch=_switch_samples,
    ),
    Rung(
        "stereo",
        "two eyes in one image",
        Footprint("stereo", resources=("both eyes",), events=("right eye", "both eyes")),
        switch=_switch_stereo,
        modules=("renderer.stereo.pair", "renderer.stereo.mixing"),
    ),
    Rung(
        "overlay",
        "the debug overlay",
        Footprint("overlay", programs=("Canvas*",), events=("overlay",)),
        switch=partial(_switch_layer, Overlay),
        modules=("renderer.layers.overlay", "renderer.layers.canvas"),
    ),
)  # fmt: skip
"""The rungs, each with all that those before it have."""


def build_scene(count: int) -> tuple[Scene, list[int]]:
    """Make the scene of the first `count` rungs with no effect switched on; return it and what each has placed."""
    builder = SceneBuilder(LADDER[count - 1].name)
    rows = [rung.place(builder) for rung in LADDER[:count]]
    builder.views["ladder"] = EYE
    return builder.build(), rows


_LOOKED_AT: Final = (-0.1, 0.55, 0.0)
EYE: Final = Camera.look_at((1.7, 2.0, 5.0), _LOOKED_AT)
"""The camera of all rungs, before it moves."""


def move_eye(frame: int) -> Camera:
    """Return the camera of a frame, which goes to the right by a centimetre in each."""
    return Camera.look_at(EYE.position + np.array([0.01 * frame, 0.0, 0.0]), _LOOKED_AT)
