"""A generator of scenes with something that changes nothing: it walks over the fields of lights, materials,
transforms, the air and the settings, and sets each to values at which it is neutral, and to extreme ones.

A field that the tables below lack, or that no longer exists, fails `test_each_field_has_values`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from renderer.content import BUILT_IN
from renderer.content.fountains import BOUNDS, FountainSimulation, make_drops
from renderer.frame import Blending
from renderer.light_kinds.table import LIGHT_KINDS
from renderer.scene import (
    AlphaMode,
    AmbientOcclusion,
    Bloom,
    Compression,
    DepthOfField,
    Fog,
    Scene,
    SceneBuilder,
    make_height_field,
    scaling,
    translation,
)
from renderer.scene.cloth import ClothSimulation, Wind, make_cloth_grid
from renderer.scene.water import WaterPool, WaterSimulation
from renderer.shadows import ShadowFilter
from rhi import Filter

Values = dict[str, Any]
Add = Callable[[SceneBuilder], object]

BACKGROUND = (0.02, 0.03, 0.05)
CHECKS = np.zeros((8, 8, 4), np.uint8)
CHECKS[..., :3] = np.random.default_rng(3).integers(0, 256, (8, 8, 3))
CHECKS[..., 3] = 255
BUMPS = np.maximum(CHECKS, 140)
BUMPS[..., 3] = 255
CLEAR = CHECKS * np.array((1, 1, 1, 0), np.uint8)
WHITE = np.full((8, 8, 4), 255, np.uint8)
ROUGH = WHITE * np.array((0, 1, 1, 0), np.uint8)
"""White in the channels of metallic-roughness textures alone."""
IMAGES = {"checks": CHECKS, "bumps": BUMPS, "clear": CLEAR, "white": WHITE, "rough": ROUGH}

LIGHT_FIELDS: dict[str, tuple[Any, ...]] = {
    "position": ((0.0, 2.0, 1.0), (0.0, -0.1, 0.0), (1e6, 0.0, 0.0)),
    "range": (5.0, 1e-3, 1e7),
    "color": ((1.0, 1.0, 1.0), (1e4, 0.0, 0.0)),
    "intensity": (1.0, 1e6),
    "casts_shadow": (True, False),
    "source_radius": (0.0, 1e-3, 1e-12),
    "source_right": ((0.0, 0.0, 0.0), (0.4, 0.0, 0.0)),
    "source_up": ((0.0, 0.0, 0.0), (0.0, 0.3, 0.0)),
    "angular_diameter": (0.0, 1e-3, np.pi / 2, 1e-12),
    "direction": ((-0.3, -1.0, -0.5), (0.0, 1.0, 0.0)),
    "inner": (0.2, 0.0),
    "outer": (0.5, np.pi),
}
"""Of each field of any kind of lights an ordinary value, and extreme ones."""

DARK: tuple[Values, ...] = (
    {"intensity": 0.0},
    {"intensity": 1e-40},
    {"intensity": 1e-12},
    {"color": (0.0, 0.0, 0.0)},
    {"range": 0.0, "source_radius": 0.0},
    {"inner": 0.0, "outer": 0.0},
)
"""Values with which a light lights nothing, whatever else it is; those of fields that a kind lacks don't
concern it."""

MATERIAL_FIELDS: dict[str, tuple[Any, ...]] = {
    "base_color": ((0.6, 0.5, 0.4, 1.0), (1e3, 1e3, 1e3, 1.0), (0.0, 0.0, 0.0, 1.0)),
    "specular_color": (None, (1.0, 1.0, 1.0)),
    "shininess": (None, 1.0, 1e5),
    "rim_strength": (None, 10.0),
    "rim_power": (None, 0.1, 100.0),
    "texture": (None, "checks"),
    "emission": (None, 1e5),
    "emissive": (None, (1e5, 0.0, 0.0)),
    "emissive_texture": (None, "checks"),
    "metallic": (None, 1.0, 0.0),
    "roughness": (None, 0.0, 1.0),
    "metallic_roughness_texture": (None, "checks"),
    "normal_texture": (None, "bumps"),
    "normal_scale": (None, -1e4, 1e4),
    "occlusion_texture": (None, "checks"),
    "occlusion_strength": (None, 1.0),
    "alpha_mode": (AlphaMode.OPAQUE, AlphaMode.MASK, AlphaMode.BLEND),
    "alpha_cutoff": (None, 1.0, 0.0),
    "double_sided": (None, True),
    "light_map_color": (None, (1e5, 0.0, 0.0)),
    "light_map_texture": (None, "checks"),
}
"""Of each field of materials an ordinary value, and extreme ones; None is the default."""

FOLLOWING_FIELDS = {"model", "shader"}
"""Fields of materials that follow from others: what isn't in `make_material`'s arguments."""

_SPECULAR = ("specular_color", "shininess", "rim_strength", "rim_power", "emission")
_METALLIC = ("metallic", "roughness", "metallic_roughness_texture")

_FAINT = 1e-11
UNSEEN: tuple[Values, ...] = (
    {"alpha_mode": AlphaMode.BLEND, "base_color": (0.6, 0.5, 0.4, 0.0)},
    {"alpha_mode": AlphaMode.BLEND, "base_color": (0.6, 0.5, 0.4, _FAINT)},
    {"alpha_mode": AlphaMode.MASK, "base_color": (0.6, 0.5, 0.4, 0.2), "alpha_cutoff": 0.9},
    {"alpha_mode": AlphaMode.BLEND, "texture": "clear"},
    {"alpha_mode": AlphaMode.MASK, "texture": "clear", "alpha_cutoff": 0.1},
)
"""Values with which a material covers nothing, whatever else it is."""

PLACES: dict[str, Any] = {
    "of scale 0": np.zeros(3),
    "a point that is far away": np.zeros(3),
    "a line": np.array((0.0, 1.0, 0.0)),
}

EQUAL: tuple[tuple[Values, Values], ...] = (
    ({"alpha_mode": AlphaMode.BLEND}, {"alpha_mode": AlphaMode.OPAQUE}),
    ({"alpha_mode": AlphaMode.MASK, "alpha_cutoff": 0.0}, {"alpha_mode": AlphaMode.OPAQUE}),
    ({"alpha_mode": AlphaMode.MASK, "alpha_cutoff": 0.9}, {"alpha_mode": AlphaMode.OPAQUE}),
    ({"normal_texture": "bumps", "normal_scale": 0.0}, {"normal_texture": None}),
    ({"occlusion_texture": "checks", "occlusion_strength": 0.0}, {"occlusion_texture": None}),
    (
        {"emissive_texture": "checks", "emissive": (0.0, 0.0, 0.0)},
        {"emissive_texture": None, "emissive": (0.0, 0.0, 0.0)},
    ),
    ({"emissive": (1e-9, 0.0, 0.0), "emissive_texture": None}, {"emissive": None, "emissive_texture": None}),
    ({"emission": 1e-9, "base_color": (0.6, 0.5, 0.4, 1.0)}, {"emission": None}),
    (
        {"emission": 1.0, "base_color": (0.0, 0.0, 0.0, 1.0)},
        {"emission": None, "base_color": (0.0, 0.0, 0.0, 1.0)},
    ),
    (
        {"metallic": 0.0, "roughness": 0.0, "metallic_roughness_texture": "checks"},
        {"metallic": 0.0, "roughness": 0.0, "metallic_roughness_texture": None},
    ),
    ({"rim_strength": 0.0}, {"rim_strength": None}),
    (
        {"light_map_texture": None, "light_map_color": (1e5, 0.0, 0.0)},
        {"light_map_texture": None, "light_map_color": None},
    ),
    ({"texture": "white"}, {"texture": None}),
    ({"emissive_texture": "white"}, {"emissive_texture": None}),
    ({"occlusion_texture": "white", "occlusion_strength": 1.0}, {"occlusion_texture": None}),
    (
        {"metallic_roughness_texture": "rough", "metallic": 1.0, "roughness": 0.5},
        {"metallic_roughness_texture": None, "metallic": 1.0, "roughness": 0.5},
    ),
    (
        {"texture": "checks", "base_color": (0.0, 0.0, 0.0, 1.0)},
        {"texture": None, "base_color": (0.0, 0.0, 0.0, 1.0)},
    ),
)
"""Pairs of values with which a material looks the same, whatever else it is: the first costs what the second
does."""

FOG_FIELDS: dict[str, tuple[Any, ...]] = {
    "density": (0.02, 1e3),
    "color": ((0.5, 0.55, 0.6), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)),
    "falloff": (0.0, 1e-3, 1e3),
    "base": (0.0, -1e4),
}
CLEAR_AIR: tuple[Values, ...] = (
    {"density": 1e-300, "color": BACKGROUND},
    {"density": 1e-12, "color": BACKGROUND, "base": 0.0},
    {"falloff": 1.0, "base": -1e6, "color": BACKGROUND},
)
"""Values with which fog changes nothing, whatever else it is."""

BLOOM_FIELDS: dict[str, tuple[Any, ...]] = {"strength": (0.3, 1e-6, 1.0)}

SCENE_PARTS: dict[str, str] = {
    "materials": "MATERIAL_FIELDS",
    "lights": "LIGHT_FIELDS",
    "fog": "FOG_FIELDS",
    "bloom": "BLOOM_FIELDS",
    "ambient_occlusion": "`spread_air`: a radius of less than a pixel",
    "environment": "`test_environments`: light in place of the sky's and the ground's",
    "depth_of_field": "`spread_air`: discs of less than a pixel",
    "haze": "HAZES",
    "nodes": "`spread_objects`: transforms, hidden and moving nodes",
    "objects": "`spread_objects`",
    "meshes": "`spread_meshes`: colors, unused meshes",
    "images": "textures of MATERIAL_FIELDS",
    "textures": "textures of MATERIAL_FIELDS",
    "samplers": "textures of MATERIAL_FIELDS",
    "tessellated": "`spread_objects`",
    "reserved": "`spread_objects`",
    "background": "is seen wherever nothing else is",
    "name": "is a text",
    "decals": "`spread_decals`: no strength, no size, hidden",
    "attachments": "move lights and views, which are in the world when a frame begins",
    "views": "choose a camera, and aren't drawn",
    "paths": "choose a camera, and aren't drawn",
    "omissions": "are a report",
    "clips": "move nodes only while they are played",
    "simulated": "`spread_objects`, and tests/renderer/visibility/test_skipped_simulation.py",
    "table": "is how materials are made",
    "parameters": "are read by shaders of materials alone, of which nothing is known",
}
"""Of each argument of `Scene` what sets it here, or why nothing does."""

HAZES = (0.0, 1e-12)


@dataclass(frozen=True)
class Neutral:
    """A scene with something that changes nothing, and the scene that it equals."""

    name: str
    add: Add
    equal: Add = bool

    def __str__(self) -> str:
        return self.name


def make_scene(add: Add) -> Scene:
    """Make a floor, a box, and what `add` adds."""
    builder = SceneBuilder("neutral")
    builder.background = BACKGROUND
    builder.lights.sky, builder.lights.ground = (0.3, 0.34, 0.42), (0.16, 0.14, 0.12)
    builder.add_mesh(BUILT_IN["box"]())
    grey = builder.add_material(base_color=(0.62, 0.6, 0.56))
    for at, size in (((0, -0.15, 0), (7, 0.3, 5)), ((-0.9, 0.6, -0.5), (1.2, 1.2, 1.2))):
        builder.add_objects(builder.add_node(translation(at) @ scaling(size)), 0, grey)
    add(builder)
    return builder.build()


def one_at_a_time(table: Mapping[str, tuple[Any, ...]], seed: int = 0) -> Iterator[Values]:
    """Yield ordinary values, each with another extreme value of one field, and at last several at random."""
    ordinary = {name: values[0] for name, values in table.items()}
    yield dict(ordinary)
    for name, values in table.items():
        for value in values[1:]:
            yield {**ordinary, name: value}
    random = np.random.default_rng(seed)
    for _ in range(6):
        yield {name: values[int(random.integers(len(values)))] for name, values in table.items()}


def light_fields(kind: Any) -> dict[str, tuple[Any, ...]]:
    return {name: LIGHT_FIELDS[name] for name in kind.dtype.names}


def spread_lights() -> Iterator[Neutral]:
    """Lights of each kind that light nothing."""
    for kind in LIGHT_KINDS:
        table = light_fields(kind)
        for number, dark in enumerate(DARK):
            if not set(dark) & set(table) or ("range" in dark and "range" not in table):
                continue
            off = {name: value for name, value in dark.items() if name in table}
            if "outer" in dark and "outer" not in table:
                continue
            for turn, values in enumerate(one_at_a_time(table, number)):
                set_to = {**values, **off}
                if set_to.get("intensity") == 1e-12 and ("position" in set_to or max(set_to["color"]) > 1.0):
                    continue  # bright next to the light
                if set_to.get("source_radius", 0.0) > set_to.get("range", np.inf):
                    continue
                if np.any(set_to.get("source_up", 0.0)) and not np.any(set_to["source_right"]):
                    set_to["source_right"] = (0.4, 0.0, 0.0)
                if np.linalg.norm(set_to.get("source_right", 0.0)) > set_to.get("range", np.inf):
                    continue
                if set_to.get("inner", 0.0) > set_to.get("outer", np.inf):
                    continue
                yield Neutral(f"a dark {kind.name} light: {off}, {turn}", _add_light(kind, set_to))
    for direction, outer in (((0.0, 1.0, 0.0), 0.5), ((0.0, 1.0, 0.0), 1e-3), ((0.6, 0.8, 0.0), 1.0)):
        yield Neutral(f"a spot {direction}, {outer}", partial(_aim_spot, direction=direction, outer=outer))


def spread_small_lights() -> Iterator[Neutral]:
    """Lights of each kind that are so small that they look like points."""
    for kind in LIGHT_KINDS:
        values = {name: values[0] for name, values in light_fields(kind).items()}
        size = "source_radius" if "source_radius" in values else "angular_diameter"
        for smallest, casts_shadow in itertools.product((1e-12, 4e-10), (True, False)):
            lights = ({**values, "casts_shadow": casts_shadow, size: radius} for radius in (smallest, 0.0))
            name = f"a {kind.name} light of size {smallest}, {casts_shadow}"
            yield Neutral(name, *(_add_light(kind, light) for light in lights))


def _aim_spot(builder: SceneBuilder, direction: tuple[float, float, float], outer: float) -> None:
    """Add a spot light beside the box that shines into the air."""
    builder.lights.add_spot((1.5, 3.0, 1.0), direction, 5.0, 0.0, outer, casts_shadow=True)


def _add_light(kind: Any, values: Values) -> Add:
    def add(builder: SceneBuilder) -> None:
        getattr(builder.lights, f"add_{kind.name}")(**values)

    return add


def material_arguments(builder: SceneBuilder, values: Values) -> Values:
    """The arguments of `add_material`: of one model only, with ids of images."""
    arguments = {name: value for name, value in values.items() if value is not None}
    if any(name in arguments for name in _METALLIC):
        arguments = {name: value for name, value in arguments.items() if name not in _SPECULAR}
    for name, value in arguments.items():
        if isinstance(value, str):
            arguments[name] = builder.add_image(IMAGES[value])
    return arguments


def add_box(
    builder: SceneBuilder,
    values: Values,
    at: Any = None,
    size: Any = (0.7, 0.7, 0.7),
    *,
    dynamic: bool = False,
) -> int:
    """Add a box of a material of its own, and return its node."""
    transform = translation((0.5, 0.8, 0.5) if at is None else at) @ scaling(size)
    node = builder.add_node(transform, dynamic=dynamic)
    builder.add_objects(node, 0, builder.add_material(**material_arguments(builder, values)))
    return node


def material_values(seed: int = 0) -> Iterator[Values]:
    yield from one_at_a_time(MATERIAL_FIELDS, seed)


def spread_materials() -> Iterator[Neutral]:
    """Materials that cover nothing, objects of no size, and materials that nothing has."""
    for number, off in enumerate(UNSEEN):
        for turn, values in enumerate(material_values(number)):
            if off.get("base_color", (0.0,))[-1] == _FAINT and _is_bright(values):
                continue  # little of it is seen
            yield Neutral(f"unseen {off}: {turn}", partial(add_box, values={**values, **off}))
    for turn, values in enumerate(material_values(7)):
        for dynamic, (name, size) in itertools.product((False, True), PLACES.items()):
            at = (1e6, 1e6, 0.0) if "far" in name else None
            add = partial(_add_blooming, values=values, at=at, size=size, dynamic=dynamic)
            yield Neutral(f"{'moving' if dynamic else 'fixed'}, {name}: {turn}", add)
        yield Neutral(f"an unused material: {turn}", partial(_leave_unused, values=values))


def _is_bright(values: Values) -> bool:
    """Return whether a material may send much more light than arrives."""
    names = ("emission", "emissive", "rim_strength", "shininess", *_METALLIC)
    return max(values["base_color"]) > 1.0 or any(values[name] is not None for name in names)


def _add_blooming(builder: SceneBuilder, **box: Any) -> None:
    builder.bloom = Bloom(0.3)
    add_box(builder, **box)


def _leave_unused(builder: SceneBuilder, values: Values) -> None:
    builder.add_material(**material_arguments(builder, values))


def spread_equal_materials() -> Iterator[Neutral]:
    """Materials that look like others."""
    for number, (first, second) in enumerate(EQUAL):
        for turn, values in enumerate(material_values(20 + number)):
            base = {**values}
            if "alpha_mode" not in first:
                base["alpha_mode"] = AlphaMode.OPAQUE
            if any(name in first for name in _SPECULAR):
                base |= dict.fromkeys(_METALLIC)
            if "emissive" in first and first["emissive"] == (1e-9, 0.0, 0.0):
                base["emissive"] = None
            if "emission" in first:
                base["base_color"] = first["base_color"]
            pair = {**base, **first}, {**base, **second}
            yield Neutral(
                f"{first} is {second}: {turn}",
                *(partial(add_box, values=values) for values in pair),
            )


def _add_cloth(builder: SceneBuilder, size: tuple[float, float, float]) -> None:
    x, y = np.meshgrid(np.linspace(0.0, 1.3, 11), np.linspace(0.0, -0.9, 8))
    pinned = np.zeros(x.shape, bool)
    pinned[:, 0] = True
    cloth_grid = make_cloth_grid(np.stack([x, y, np.zeros_like(y)], 2), pinned)
    mesh = builder.add_mesh(cloth_grid.make_mesh(), "flag", cloth_grid.bounds)
    cloth = builder.add_objects(
        builder.add_node(scaling(size)), mesh, builder.add_material(double_sided=True)
    )
    builder.simulate(cloth, ClothSimulation(1, cloth_grid, Wind((3.0, 0.0, 0.6))))


def _add_pool(builder: SceneBuilder, size: tuple[float, float, float]) -> None:
    pool = WaterPool(size=(2.6, 1.4), cells=(24, 12), depth=0.06, damping=0.6, rain=5.0)
    mesh = builder.add_mesh(pool.make_mesh(), bounds=pool.bounds)
    builder.simulate(
        builder.add_objects(builder.add_node(scaling(size)), mesh, 0), WaterSimulation(1, pool, seed=3)
    )


def _add_fountain(builder: SceneBuilder, size: tuple[float, float, float]) -> None:
    mesh = builder.add_mesh(make_drops(), "spray", BOUNDS)
    builder.simulate(builder.add_objects(builder.add_node(scaling(size)), mesh, 0), FountainSimulation(1, 5))


SIMULATED: dict[str, Callable[..., None]] = {
    "cloth": _add_cloth,
    "pool": _add_pool,
    "fountain": _add_fountain,
}


def spread_objects() -> Iterator[Neutral]:
    """Objects that are hidden or reserved, and terrain and simulated meshes of no size."""

    def hide(builder: SceneBuilder) -> None:
        builder.hide(add_box(builder, {"alpha_mode": AlphaMode.BLEND, "base_color": (1, 1, 1, 0.5)}))

    def reserve(builder: SceneBuilder) -> None:
        glass = {"emission": 3.0, "alpha_mode": AlphaMode.BLEND, "base_color": (1, 1, 1, 0.5)}
        builder.reserve(5, 0, builder.add_material(**glass))

    def flatten(builder: SceneBuilder) -> None:
        x, z = np.meshgrid(np.linspace(-1, 1, 17), np.linspace(-1, 1, 17))
        mesh = builder.add_height_field(make_height_field(np.cos(4 * x) + np.sin(3 * z), 16.0))
        builder.add_objects(builder.add_node(scaling((0, 0, 0))), mesh, 0)

    for name, add in (("hidden", hide), ("reserved", reserve), ("terrain of no size", flatten)):
        yield Neutral(name, add)
    for name, simulate in SIMULATED.items():
        for size in ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
            yield Neutral(f"{name} of size {size}", partial(simulate, size=size))


def spread_air() -> Iterator[Neutral]:
    """Fog and haze that aren't seen, and bloom of nothing."""
    for number, off in enumerate(CLEAR_AIR):
        for turn, values in enumerate(one_at_a_time(FOG_FIELDS, number)):
            if values["falloff"] > 1.0 and off.get("base", values["base"]) >= 0.0:
                continue  # as dense as a wall below its base
            yield Neutral(f"fog {off}: {turn}", partial(_set, name="fog", value=Fog(**{**values, **off})))
    for haze in HAZES:
        yield Neutral(f"haze: {haze}", partial(_set, name="haze", value=haze))
    for values in one_at_a_time(BLOOM_FIELDS):
        yield Neutral(f"bloom: {values}", partial(_set, name="bloom", value=Bloom(**values)))
    yield Neutral("occlusion", partial(_set, name="ambient_occlusion", value=AmbientOcclusion(1e-9)))
    yield Neutral("focus", partial(_set, name="depth_of_field", value=DepthOfField(5.0, 1e-12)))


def spread_decals() -> Iterator[Neutral]:
    """Decals that project nothing."""

    def project(builder: SceneBuilder, transform: Any, is_hidden: bool = False, **values: Any) -> None:
        node = builder.add_node(transform)
        builder.add_decal(node, builder.add_image(np.full((4, 4, 4), 255, np.uint8)), (9, 9, 9), **values)
        if is_hidden:
            builder.hide([node])

    yield Neutral("a decal of no strength", partial(project, transform=np.eye(4), strength=0.0))
    yield Neutral("a decal of no size", partial(project, transform=scaling((1, 0, 1))))
    yield Neutral("a hidden decal", partial(project, transform=np.eye(4), is_hidden=True))


def _set(builder: SceneBuilder, name: str, value: Any) -> None:
    setattr(builder, name, value)


def spread_all() -> list[Neutral]:
    return [
        *spread_lights(),
        *spread_small_lights(),
        *spread_materials(),
        *spread_equal_materials(),
        *spread_objects(),
        *spread_air(),
        *spread_decals(),
    ]


UNNEEDED_SETTINGS: dict[str, tuple[Any, ...]] = {
    "technique.tiles.tile": (8, 32),
    "technique.tiles.slices": (4,),
    "technique.tiles.sphere_test": ("planes",),
    "technique.clusters.tile": (32, 128),
    "technique.clusters.slices": (1, 64),
    "technique.clusters.sphere_test": ("planes",),
    "technique.scale": (0.3, 1.0),
    "technique.stippled": (False,),
    "technique.specular_channels": (1,),
    "technique.light_bits": (16,),
    "technique.normal_bits": (8,),
    "technique.all_lights": (True,),
    "technique.lights_per_draw": (4, 1000),
    "technique.light_volumes": (True,),
    "technique.stencil": (True,),
    "technique.tiled_transparency": (True,),
    "technique.depth_first": (True,),
    "technique.multi_pass": (True,),
    "technique.object_rectangles": (True,),
    "technique.binned": (True,),
    "technique.tiled": (True,),
    "visibility.batch": (1, 1000),
    "visibility.persistence": (1, 1000),
    "visibility.leaf_size": (16,),
    "visibility.threshold": (1000,),
    "visibility.emulated": (True,),
    "visibility.occluders": (1, 1000),
    "visibility.occluder_pixels": (100,),
    "visibility.pyramid_texels": (64,),
    "visibility.meshlets": (False,),
    "visibility.proxy_planes": (14, 18, 26),
    "shadows.filter": tuple(ShadowFilter),
    "shadows.cascades": (1, 6),
    "shadows.cascade_size": (16, 2048),
    "shadows.distance": (1e-3, 1e6),
    "shadows.split": (0.0, 1.0),
    "shadows.min_size": (512,),
    "shadows.max_size": (2048,),
    "shadows.max_atlas_size": (2048, 8192),
    "shadows.budget": (1, 100),
    "shadows.blocker_samples": (1, 1024),
    "shadows.penumbra_samples": (1, 1024),
    "shadows.contact_length": (0.0, 0.2, 1.0),
    "shadows.contact_steps": (1, 16, 64),
    "shadows.contact_rays": (1, 8, 64),
    "shadows.contact_thickness": (0.01, 0.1, 1.0),
    "shadows.far_size": (16, 512),
    "shadows.bias": (0.0, 10.0),
    "shadows.back_faces": (True,),
    "textures.filter": (Filter.NEAREST,),
    "textures.mip": (None, Filter.NEAREST),
    "textures.anisotropy": (16.0,),
    "textures.mip_bias": (-2.0, 2.0),
    "textures.compression": tuple(Compression),
    "textures.memory": (0.5, 100.0),
    "textures.memory_per_frame": (0.5,),
    "tessellation.edge_pixels": (1.0, 100.0),
    "tessellation.out_of_view_scale": (1.0, 100.0),
    "blending": tuple(Blending),
    "bloom.levels": (1, 12),
    "bloom.karis_average": (True,),
    "bloom.bits": (11, 32),
    "occlusion.slices": (1, 32),
    "occlusion.steps": (1, 64),
    "occlusion.is_smooth": (False,),
    "occlusion.bits": (16,),
    "depth_of_field.samples": (8, 1024),
    "depth_of_field.max_radius": (0.001, 0.5),
    "depth_of_field.bits": (32,),
    "temporal.frames": (2, 1024),
    "temporal.still_frames": (2, 1024),
    "temporal.deviations": (0.0, 10.0),
    "temporal.bits": (32,),
    "environment.size": (64, 512),
    "environment.samples": (8, 4096),
    "animation_step": (0.1, 1e3),
    "animation_lag": (0.0, 100.0),
    "light_cutoff": (1e-3, 1e3),
    "detail_error": (0.0, 100.0),
    "simulates_hidden": (True,),
    "reprojects": (True,),
    "far_error": (1e-3, 100.0),
}
"""Settings that change nothing in a scene of one box with `forward` and `frustum`: values at and beside their
bounds."""

CALLED_FOR_SETTINGS = {
    "technique.name",
    "technique.samples",
    "technique.fxaa",
    "temporal.is_on",
    "algorithm",
    "precision",
    "depth",
    "scale",
}
"""Settings that any scene calls for."""


@dataclass(frozen=True)
class NeutralSetting:
    """A setting that a scene doesn't call for, at a value beside its default."""

    path: str
    value: Any

    def __str__(self) -> str:
        return f"{self.path} = {self.value}"


def spread_settings() -> Iterator[NeutralSetting]:
    """Yield each value of each setting that a box doesn't call for."""
    for path, values in UNNEEDED_SETTINGS.items():
        yield from (NeutralSetting(path, value) for value in values)
