"""The effect steps: a series of scenes, each with one effect more than the one before.

A step is a value: what it adds to a scene, how the effect is switched on and off at run time, and the pattern
that recognises its commands in a stream. A new effect declares its cost by an entry in `EFFECT_STEPS`, and is
then counted, timed, drawn and tested as all others are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np

from renderer.content import BUILT_IN
from renderer.content.fountains import BOUNDS, FountainSimulation, make_drops
from renderer.content.material_shaders import Marble, Toon
from renderer.content.shapes import bumpy_sphere
from renderer.content.skies import paint_sky
from renderer.frame import TemporalSettings
from renderer.layers.overlay import Overlay
from renderer.layers.particles import Particles
from renderer.renderer import Renderer
from renderer.scene import (
    AlphaMode,
    AmbientOcclusion,
    Bloom,
    Camera,
    DepthOfField,
    Environment,
    Fog,
    Scene,
    SceneBuilder,
    StereoRig,
    make_height_field,
    make_material,
    translation,
)
from renderer.scene.cloth import ClothSimulation, Gust, Wind, make_cloth_grid
from renderer.scene.particles import Emitter, EmitterSimulation, make_quad
from renderer.shadows import ShadowFilter
from renderer.stereo import Stereo
from renderer.techniques import Forward, FxaaTechnique
from rhi import BlendFunction, Op
from rhi.testing import EffectPattern

EffectSwitch = Callable[[Renderer, int, bool], None]
"""Switches an effect on or off, given the index of the material that its step has added, -1 if it has added
none."""


@dataclass(frozen=True, slots=True)
class EffectStep:
    """One step of the series of scenes.

    Attributes:
        description: what the scene has more than the one before, in a few words.
        markers: the pattern that recognises the effect's commands in a stream; None if the step adds no
            effect.
        add_to_scene: adds what the effect needs to a scene; returns the index of its own material, or -1.
        switch: switches the effect on and off at run time; None for what is a part of a scene and removed by
            leaving it out.
        modules: prefixes of the names of modules in which nothing runs in a frame without the effect.
    """

    name: str
    description: str
    markers: EffectPattern | None = None
    add_to_scene: Callable[[SceneBuilder], int] = lambda _: -1
    switch: EffectSwitch | None = None
    modules: tuple[str, ...] = ()


def _add_hidden_box(builder: SceneBuilder) -> int:
    """Add an object behind the eye: a scene has at least one."""
    builder.lights.sky, builder.lights.ground = (0.30, 0.34, 0.42), (0.16, 0.14, 0.12)
    builder.background = (0.05, 0.07, 0.11)
    material = builder.add_material(base_color=(0.5, 0.5, 0.5))
    _add_box(builder, material, (0.0, -40.0, 60.0), (1.0, 1.0, 1.0))
    return material


def _add_boxes(builder: SceneBuilder) -> int:
    material = builder.add_material(base_color=(0.62, 0.60, 0.56))
    _add_box(builder, material, (0.0, -0.15, 0.0), (7.0, 0.3, 5.0))
    _add_box(builder, material, (-0.9, 0.6, -0.5), (1.2, 1.2, 1.2))
    return material


def _add_box(
    builder: SceneBuilder, material: int, at: tuple[float, float, float], size: tuple[float, float, float]
) -> None:
    transform = translation(at) @ np.diag([*size, 1.0])
    builder.add_objects(builder.add_node(transform), builder.add_mesh(BUILT_IN["box"]()), material)


def _switch_light(kind: str, values: tuple[Any, ...], renderer: Renderer, _: int, is_on: bool) -> None:
    lights = renderer.scene.lights
    setattr(lights, kind, getattr(lights, kind)[:0])
    if is_on:
        getattr(lights, f"add_{kind}")(*values)


def _switch_light_field(
    kinds: tuple[str, ...], name: str, value: float, renderer: Renderer, _: int, is_on: bool
) -> None:
    """Set a field of all lights of these kinds to a value, or to 0."""
    for kind in kinds:
        getattr(renderer.scene.lights, kind)[name] = value if is_on else 0.0


def _switch_contacts(renderer: Renderer, _: int, is_on: bool) -> None:
    length = 0.2 if is_on else 0.0
    renderer.shadows.settings = replace(renderer.shadows.settings, contact_length=length)


def _switch_penumbras(renderer: Renderer, _: int, is_on: bool) -> None:
    shadow_filter = ShadowFilter.PCSS if is_on else ShadowFilter.SMOOTH
    renderer.shadows.settings = replace(renderer.shadows.settings, filter=shadow_filter)
    renderer.scene.lights.directional["angular_diameter"] = 0.05 if is_on else 0.0


def _switch_rectangle(renderer: Renderer, _: int, is_on: bool) -> None:
    points = renderer.scene.lights.point
    points["source_right"] = (0.3, 0.0, 0.0) if is_on else 0.0
    points["source_up"] = (0.0, 0.0, 0.2) if is_on else 0.0


def _add_textured(builder: SceneBuilder) -> int:
    rows, columns = np.indices((64, 64)) // 8
    image = np.full((64, 64, 4), 255, np.uint8)
    image[..., :3] = np.where(((rows + columns) % 2)[..., None], (196, 92, 60), (232, 214, 180))
    material = builder.add_material(texture=builder.add_image(image))
    _add_box(builder, material, (0.45, 0.35, 0.9), (0.7, 0.7, 0.7))
    return material


def _add_poster(builder: SceneBuilder) -> int:
    rows, columns = np.indices((64, 64)) - 31.5
    image = np.full((64, 64, 4), (20, 60, 150, 255), np.uint8)
    image[..., 3] = np.where(np.hypot(rows, columns) < 30.0, 255, 0)
    image[np.abs(np.hypot(rows, columns) - 15.0) < 5.0, :3] = 240
    builder.add_decal(
        builder.add_node(translation((-0.7, 0.7, 0.1))), builder.add_image(image), (0.7, 0.7, 0.5)
    )
    return -1


def _switch_poster(renderer: Renderer, _: int, is_on: bool) -> None:
    renderer.scene.decals.array["strength"] = float(is_on)


def _add_ball(at: tuple[float, float, float], material_values: dict[str, Any], builder: SceneBuilder) -> int:
    material = builder.add_material(**material_values)
    node = builder.add_node(translation(at) @ np.diag([0.45, 0.45, 0.45, 1.0]))
    builder.add_objects(node, builder.add_mesh(BUILT_IN["sphere"]()), material)
    return material


def _switch_metal(renderer: Renderer, material: int, is_on: bool) -> None:
    materials = renderer.scene.materials
    color = materials["base_color"][material].tolist()
    materials[material] = make_material(color, metallic=1.0, roughness=0.3) if is_on else make_material(color)


def _add_tube(builder: SceneBuilder) -> int:
    material = builder.add_material(base_color=(0.3, 0.95, 0.75))
    _add_box(builder, material, (-2.5, 0.7, -1.2), (0.16, 1.4, 0.16))
    return material


def _add_screen(builder: SceneBuilder) -> int:
    light = np.zeros((16, 16, 3), np.float16)
    light[::4], light[2::4] = (6.0, 0.5, 0.2), (0.2, 0.5, 6.0)
    material = builder.add_material(
        base_color=(0.1, 0.1, 0.1), emissive=(1.0, 1.0, 1.0), emissive_texture=builder.add_image(light)
    )
    _add_box(builder, material, (-2.5, 0.3, 0.9), (0.5, 0.5, 0.08))
    return material


def _add_lit_box(builder: SceneBuilder) -> int:
    rows, columns = np.indices((16, 16)) / 15.0
    light = np.stack([0.2 + rows, 0.3 + 0.5 * columns, 1.0 - 0.8 * rows], axis=-1).astype(np.float16)
    material = builder.add_material(base_color=(0.8, 0.8, 0.8), light_map_texture=builder.add_image(light))
    _add_box(builder, material, (-1.55, 0.25, 2.0), (0.5, 0.5, 0.5))
    return material


def _switch_emission(renderer: Renderer, material: int, is_on: bool) -> None:
    renderer.scene.materials[material]["emission"] = 2.5 if is_on else 0.0


def _add_pane(builder: SceneBuilder) -> int:
    material = builder.add_material(base_color=(0.35, 0.75, 0.55, 0.4))
    _add_box(builder, material, (1.15, 0.8, -0.2), (0.06, 1.6, 1.8))
    return material


def _switch_glass(renderer: Renderer, material: int, is_on: bool) -> None:
    renderer.scene.materials[material]["alpha_mode"] = AlphaMode.BLEND if is_on else AlphaMode.OPAQUE


def _switch_air(name: str, value: object, nothing: object, renderer: Renderer, _: int, is_on: bool) -> None:
    setattr(renderer.scene, name, value if is_on else nothing)


def _add_terrain(builder: SceneBuilder) -> int:
    x, z = np.meshgrid(np.linspace(-1.0, 1.0, 33), np.linspace(-1.0, 1.0, 33))
    heights = 3.0 * np.maximum(-z - 0.1, 0.0) * (0.6 + 0.4 * np.cos(4.0 * x + 1.0)) - 0.35
    material = builder.add_material(base_color=(0.34, 0.42, 0.24))
    node = builder.add_node(translation((0.0, 0.0, -1.0)))
    builder.add_objects(node, builder.add_height_field(make_height_field(heights, 16.0)), material)
    return material


def _add_levels(builder: SceneBuilder) -> int:
    material = builder.add_material(base_color=(0.55, 0.36, 0.24))
    node = builder.add_node(translation((-2.6, 0.4, 0.2)) @ np.diag([0.4, 0.4, 0.4, 1.0]))
    builder.add_objects(node, builder.add_mesh(bumpy_sphere(16), levels=3), material)
    return material


def _add_fountain(builder: SceneBuilder) -> int:
    material = builder.add_material(base_color=(0.55, 0.72, 0.85))
    mesh = builder.add_mesh(make_drops(), "spray", BOUNDS)
    node = builder.add_node(translation((2.0, 0.0, 0.6)))
    builder.simulate(builder.add_objects(node, mesh, material), FountainSimulation(1, 5))
    return material


def _add_leaves(builder: SceneBuilder) -> int:
    material = builder.add_material(base_color=(0.65, 0.4, 0.12), double_sided=True)
    emitter = Emitter(
        particles=40,
        box=(1.0, 0.0, 1.0),
        velocity=(0.0, -0.6, 0.0),
        spread=0.1,
        acceleration=(0.0, 0.0, 0.0),
        spin=3.0,
    )
    simulation = EmitterSimulation(1, emitter, make_quad(0.09, 0.06))
    mesh = builder.add_mesh(simulation.make_mesh(), "leaves", simulation.bounds)
    node = builder.add_node(translation((0.6, 1.4, -1.2)))
    builder.simulate(builder.add_objects(node, mesh, material), simulation)
    return material


def _add_flag(builder: SceneBuilder) -> int:
    columns, rows = np.meshgrid(np.linspace(0.0, 1.3, 11), np.linspace(0.0, -0.9, 8))
    pinned = np.zeros(columns.shape, bool)
    pinned[:, 0] = True
    cloth_grid = make_cloth_grid(np.stack([columns, rows, np.zeros_like(rows)], 2), pinned)
    material = builder.add_material(base_color=(0.75, 0.12, 0.14), double_sided=True)
    _add_box(builder, material, (-2.1, 1.0, -1.6), (0.07, 2.0, 0.07))
    mesh = builder.add_mesh(cloth_grid.make_mesh(), "flag", cloth_grid.bounds)
    flag = builder.add_objects(builder.add_node(translation((-2.06, 1.95, -1.6))), mesh, material)
    wind = Wind((3.0, 0.0, 0.6), (Gust((0.5, 0.0, 2.5), (1.2, 0.2, 0.0), 1.3),))
    builder.simulate(flag, ClothSimulation(1, cloth_grid, wind))
    return material


def _switch_layer(kind: type[Any], renderer: Renderer, _: int, is_on: bool) -> None:
    if is_on:
        renderer.layers.append(kind(renderer.device))
        return
    for layer in [candidate for candidate in renderer.layers if isinstance(candidate, kind)]:
        renderer.layers.remove(layer)
        layer.destroy()


def _switch_fxaa(renderer: Renderer, _: int, is_on: bool) -> None:
    renderer.technique = FxaaTechnique(Forward()) if is_on else Forward()


def _switch_temporal(renderer: Renderer, _: int, is_on: bool) -> None:
    renderer.temporal = TemporalSettings(is_on=is_on)


def _switch_samples(renderer: Renderer, _: int, is_on: bool) -> None:
    renderer.technique = Forward(samples=4) if is_on else FxaaTechnique(Forward())


def _switch_stereo(renderer: Renderer, _: int, is_on: bool) -> None:
    renderer.stereo = Stereo(StereoRig(0.063, 7.0), "dubois") if is_on else None


_ENVIRONMENT: Final = Environment(paint_sky(height=32), intensity=0.4)
_SPOT: Final = ((2.6, 3.2, 1.0), (-0.1, -1.0, -0.1), 6.0, 0.15, 0.35, (0.35, 0.55, 1.0), 20.0)
EFFECT_STEPS: Final = (
    EffectStep("empty", "an object behind the eye, no light but the sky's", add_to_scene=_add_hidden_box),
    EffectStep("box", "a box on a ground", add_to_scene=_add_boxes),
    EffectStep(
        "sun",
        "a directional light",
        EffectPattern(
            "sun", words=("DirectionalLight",), bindings=("directional*",), resources=("directional lights",)
        ),
        switch=partial(_switch_light, "directional", ((0.8, -1.0, 0.3), (1.0, 0.93, 0.82), 0.8)),
    ),
    EffectStep(
        "point light",
        "a point light",
        EffectPattern(
            "point light",
            words=("PointLight",),
            bindings=("point_lights", "light_list"),
            resources=("point lights", "light rows"),
        ),
        switch=partial(_switch_light, "point", ((1.3, 1.3, 1.1), 5.0, (1.0, 0.55, 0.2), 3.5)),
    ),
    EffectStep(
        "spot",
        "a spot light",
        EffectPattern("spot", words=("SpotLight",), bindings=("spot_lights",), resources=("spot lights",)),
        switch=partial(_switch_light, "spot", _SPOT),
    ),
    EffectStep(
        "shadow",
        "the sun casts shadows",
        EffectPattern(
            "shadow",
            programs=("DepthOnly",),
            bindings=("cascade_table", "shadow_[ac]*"),
            resources=("shadow atlas", "CascadeTable"),
            events=("shadow maps",),
        ),
        switch=partial(_switch_light_field, ("directional",), "casts_shadow", True),
        modules=("renderer.shadows",),
    ),
    EffectStep(
        "local shadows",
        "both local lights cast shadows",
        EffectPattern(
            "local shadows",
            bindings=("local_shadow_table", "shadow_slots", "local_shadow_maps"),
            resources=("LocalShadowTable", "shadow slots", "local shadow maps"),
        ),
        switch=partial(_switch_light_field, ("point", "spot"), "casts_shadow", True),
    ),
    EffectStep(
        "sphere",
        "the point light is a sphere",
        EffectPattern(
            "sphere light", words=("sphere_cosine",), bindings=("source_radii",), resources=("source radii",)
        ),
        switch=partial(_switch_light_field, ("point",), "source_radius", 0.25),
    ),
    EffectStep(
        "penumbras",
        "shadows as soft as lights are large",
        EffectPattern(
            "penumbras", words=("weigh_blocker",), bindings=("shadow_sources",), resources=("shadow sources",)
        ),
        switch=_switch_penumbras,
    ),
    EffectStep(
        "rectangle",
        "the point light is a rectangle",
        EffectPattern(
            "rectangle light",
            words=("gather_rectangle",),
            bindings=("source_shapes", "lobe_fits"),
            resources=("source shapes", "lobe fits"),
        ),
        switch=_switch_rectangle,
        modules=("renderer.frame.lobe_fits",),
    ),
    EffectStep(
        "texture",
        "a box with an image",
        EffectPattern("texture", words=("sampler2DArray",), bindings=("images*",), resources=("images*",)),
        _add_textured,
    ),
    EffectStep(
        "decal",
        "an image that a box projects",
        EffectPattern(
            "decal",
            words=("project_decal",),
            bindings=("decals", "decal_*"),
            resources=("decals", "decal cells", "DecalGrid"),
        ),
        _add_poster,
        _switch_poster,
    ),
    EffectStep(
        "metal",
        "a ball of metal",
        EffectPattern("metal", words=("metallic_surface",)),
        partial(_add_ball, (-1.7, 0.45, 1.2), {"base_color": (0.9, 0.72, 0.35)}),
        _switch_metal,
    ),
    EffectStep(
        "marble",
        "a ball whose material has a shader of its own",
        EffectPattern(
            "marble", words=("value_noise",), bindings=("parameters",), resources=("parameters of Marble",)
        ),
        partial(
            _add_ball,
            (-0.55, 0.45, 1.9),
            {"shader": Marble, "base_color": (0.8, 0.82, 0.9), "frequency": 3.0},
        ),
    ),
    EffectStep(
        "lighting model",
        "a ball whose material has a lighting model of its own",
        EffectPattern("lighting model", words=("toon",), resources=("parameters of Toon",)),
        partial(_add_ball, (0.35, 0.45, 2.2), {"shader": Toon, "base_color": (0.2, 0.45, 0.8)}),
        modules=("renderer.techniques.parts.own_lighting",),
    ),
    EffectStep(
        "emission",
        "a tube that emits light",
        EffectPattern("emission", words=(".emission",)),
        _add_tube,
        _switch_emission,
    ),
    EffectStep(
        "screen",
        "a box that emits an image of high range",
        EffectPattern("screen", words=(".emissive_texture",)),
        _add_screen,
    ),
    EffectStep(
        "light map",
        "a box with baked light",
        EffectPattern("light map", words=(".light_map_texture",), bindings=("maps",), resources=("maps",)),
        _add_lit_box,
    ),
    EffectStep(
        "bloom",
        "what is brighter than white blooms",
        EffectPattern(
            "bloom",
            words=("finite_light",),
            bindings=("smaller_level", "bloom"),
            events=("bloom", "tone mapping"),
        ),
        switch=partial(_switch_air, "bloom", Bloom(0.1), None),
        modules=("renderer.techniques.parts.bloom",),
    ),
    EffectStep(
        "occlusion",
        "surfaces nearby shade each other",
        EffectPattern(
            "occlusion",
            words=("measure_occluder",),
            bindings=("occlusion", "ambient_occlusion", "turned_occlusion"),
            events=("ambient occlusion", "smooth ambient occlusion"),
        ),
        switch=partial(_switch_air, "ambient_occlusion", AmbientOcclusion(), None),
        modules=("renderer.techniques.parts.ambient_occlusion",),
    ),
    EffectStep(
        "contact shadows",
        "rays to the sun are followed over the image",
        EffectPattern(
            "contact shadows",
            words=("contact_shadows",),
            programs=("FollowContacts",),
            bindings=("contact", "contact_shadows"),
            events=("contact shadows",),
        ),
        switch=_switch_contacts,
        modules=("renderer.techniques.parts.contact_shadows",),
    ),
    EffectStep(
        "depth of field",
        "what is out of focus is seen as discs",
        EffectPattern(
            "depth of field",
            words=("measure_share",),
            bindings=("circles", "block_discs", "near_discs", "aperture"),
            events=("circles of confusion", "near discs", "depth of field"),
        ),
        switch=partial(_switch_air, "depth_of_field", DepthOfField(5.0, 0.05), None),
        modules=("renderer.techniques.parts.depth_of_field",),
    ),
    EffectStep(
        "glass",
        "a transparent pane",
        EffectPattern("glass", events=("transparency",), states=(BlendFunction.PREMULTIPLIED,)),
        _add_pane,
        _switch_glass,
        modules=("renderer.techniques.parts.transparency",),
    ),
    EffectStep(
        "haze",
        "haze in the air",
        EffectPattern("haze", words=("apply_haze",), bindings=("haze",), resources=("Haze",)),
        switch=partial(_switch_air, "haze", 0.05, 0.0),
    ),
    EffectStep(
        "fog",
        "fog that lies on the ground",
        EffectPattern(
            "fog", words=("apply_fog_to_background", "FogConstants"), bindings=("fog",), events=("sky",)
        ),
        switch=partial(_switch_air, "fog", Fog(0.25, falloff=1.2), None),
    ),
    EffectStep(
        "environment",
        "light from an image of all directions",
        EffectPattern(
            "environment",
            words=("EnvironmentConstants",),
            bindings=("environment*",),
            resources=("environment*",),
            events=("environment",),
        ),
        switch=partial(_switch_air, "environment", _ENVIRONMENT, None),
        modules=("renderer.frame.environment", "renderer.techniques.parts.environment"),
    ),
    EffectStep(
        "terrain",
        "hills whose triangles are chosen for the view",
        EffectPattern(
            "terrain",
            programs=("BeginBisection", "Bisect", "FinishBisection"),
            resources=("tessellated*",),
            events=("tessellation",),
        ),
        _add_terrain,
        modules=("renderer.tessellation",),
    ),
    EffectStep(
        "levels",
        "a ball with levels of detail",
        add_to_scene=_add_levels,
        modules=("renderer.visibility.detail", "renderer.frame.detail"),
    ),
    EffectStep(
        "fountain",
        "a simulated fountain",
        add_to_scene=_add_fountain,
        modules=("renderer.content.fountains",),
    ),
    EffectStep(
        "particles",
        "the fountain's drops as sprites",
        EffectPattern(
            "particles",
            programs=("*Particle*",),
            bindings=("particles",),
            events=("particles",),
        ),
        switch=partial(_switch_layer, Particles),
        modules=("renderer.layers.particles",),
    ),
    EffectStep(
        "leaves",
        "particles with a material",
        EffectPattern("leaves", programs=("WriteCopies",), resources=("mesh of particles",)),
        _add_leaves,
        modules=("renderer.scene.particles",),
    ),
    EffectStep(
        "cloth",
        "a flag in the wind",
        EffectPattern("cloth", programs=("StepCloths",), resources=("cloth *",)),
        _add_flag,
        modules=("renderer.scene.cloth",),
    ),
    EffectStep(
        "fxaa",
        "edges of the image smoothed",
        EffectPattern("fxaa", programs=("Fxaa",), events=("fxaa",)),
        switch=_switch_fxaa,
        modules=("renderer.techniques.parts.fxaa",),
    ),
    EffectStep(
        "temporal",
        "edges smoothed by the samples of many frames",
        EffectPattern(
            "temporal",
            programs=("TemporalResolve", "TemporalImage", "MotionShader"),
            bindings=("movement", "blending", "last_distances", "moved", "last_vertices"),
            resources=("last vertices", "MotionConstants", "BlendConstants", "temporal*"),
            events=("motion", "temporal anti-aliasing", "temporal image"),
        ),
        switch=_switch_temporal,
        modules=("renderer.techniques.parts.temporal", "renderer.frame.motion"),
    ),
    EffectStep(
        "msaa",
        "four samples per pixel instead",
        EffectPattern("msaa", resources=("*_samples*",), ops=(Op.RESOLVE_TEXTURE,), events=("resolve",)),
        switch=_switch_samples,
    ),
    EffectStep(
        "stereo",
        "two eyes in one image",
        EffectPattern("stereo", resources=("both eyes",), events=("right eye", "both eyes")),
        switch=_switch_stereo,
        modules=("renderer.stereo.pair", "renderer.stereo.mixing"),
    ),
    EffectStep(
        "overlay",
        "the debug overlay",
        EffectPattern(
            "overlay",
            programs=("Canvas*", "InterfaceShader"),
            resources=("interface", "InterfaceConstants"),
            events=("overlay",),
        ),
        switch=partial(_switch_layer, Overlay),
        modules=("renderer.layers.overlay", "renderer.layers.canvas", "renderer.stereo.screen_layers"),
    ),
)
"""The steps, each with all that those before it have."""


def build_scene(count: int) -> tuple[Scene, list[int]]:
    """Make the scene of the first `count` steps with no effect switched on; return it, and the material index
    of each step."""
    builder = SceneBuilder(EFFECT_STEPS[count - 1].name)
    rows = [step.add_to_scene(builder) for step in EFFECT_STEPS[:count]]
    builder.views["effects"] = EYE
    return builder.build(), rows


_TARGET: Final = (-0.1, 0.55, 0.0)
EYE: Final = Camera.look_at((1.7, 2.0, 5.0), _TARGET)
"""The camera of all steps, before it moves."""


def move_eye(frame: int) -> Camera:
    """The camera of a frame, which moves to the right by a centimetre in each."""
    return Camera.look_at(EYE.position + np.array([0.01 * frame, 0.0, 0.0]), _TARGET)
