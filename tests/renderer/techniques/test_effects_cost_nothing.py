"""An effect that a scene lacks issues no command, with each technique: no pass, no part of a program, no
binding, no buffer. All other effects are there, and the scene with all of them shows that the traces would be
found."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from frames import EYE, open_renderer

import rhi
from renderer.content import BUILT_IN
from renderer.frame import Effect
from renderer.renderer import Renderer
from renderer.scene import AlphaMode, Bloom, Fog, Scene, SceneBuilder
from renderer.techniques import TECHNIQUES
from rhi import Op

SIZE = (64, 32)


@dataclass(frozen=True)
class Trace:
    """The traces of an effect: patterns of the labels of buffers and textures, of the programs' text,
    and of the names of bindings."""

    labels: str
    text: str
    bindings: str


TRACES = {
    Effect.DIRECTIONAL_LIGHTS: Trace("directional lights", r"\bDirectionalLight\b", "directional"),
    Effect.POINT_LIGHTS: Trace("point lights|light spheres", r"\bPointLight\b", "point"),
    Effect.SPOT_LIGHTS: Trace("spot lights|cones", r"\bSpotLight\b", "spot"),
    Effect.IMAGES: Trace("images|texture", r"\bsampler2DArray\b|\bdecode_texel\b|\bencode_texel\b", "images"),
    Effect.EMISSION: Trace("^$", r"\.emission\b", "^$"),
    Effect.HAZE: Trace("[Hh]aze", r"\bapply_haze\b|\bHaze\b", "haze"),
    Effect.FOG: Trace(
        "[Ff]og", r"\bfog_transmittance\b|\bapply_fog_to_background\b|\bFogConstants\b", "^fog$|^air$"
    ),
    Effect.BLOOM: Trace(
        "bloom|bright", r"\bBloomConstants\b|\bread_upsampled\b|\bfinite_light\b", "smaller_level|bloom"
    ),
}
"""The traces of each effect but shadows."""


def make(effects: set[Effect]) -> Scene:
    """Make a box with these effects and no others."""
    builder = SceneBuilder("box")
    emission = 2.0 if Effect.BLOOM in effects else 1.0 if Effect.EMISSION in effects else 0.0
    image = builder.add_image(np.zeros((4, 4, 4), np.uint8)) if Effect.IMAGES in effects else -1
    material = builder.add_material(emission=emission, texture=image)
    builder.add_objects(builder.add_node(), builder.add_mesh(BUILT_IN["box"]()), material)
    if Effect.DIRECTIONAL_LIGHTS in effects:
        builder.lights.add_directional((0, -1, 0))
    if Effect.POINT_LIGHTS in effects:
        builder.lights.add_point((0, 2, 0), 4.0)
    if Effect.SPOT_LIGHTS in effects:
        builder.lights.add_spot((0, 2, 0), (0, -1, 0), 4.0, 0.3, 0.5)
    if Effect.HAZE in effects:
        builder.haze = 0.1
    if Effect.FOG in effects:
        builder.fog = Fog(0.1)
    if Effect.BLOOM in effects:
        builder.bloom = Bloom()
    return builder.build()


@contextmanager
def open_technique(scene: Scene, name: str) -> Iterator[Renderer]:
    """A renderer that draws with this technique on a null device."""
    with (
        rhi.create_device("null") as device,
        open_renderer(device, scene, TECHNIQUES[name](), size=SIZE) as renderer,
    ):
        yield renderer


def list_traces(scene: Scene, name: str, trace: Trace) -> set[str]:
    """Return which kinds of traces a frame of this technique has."""
    traces = set()
    with open_technique(scene, name) as renderer:
        renderer.render(EYE)
        stream = renderer.device.stream
        for command in stream.filter((Op.CREATE_BUFFER, Op.CREATE_TEXTURE)):
            if re.search(trace.labels, command["descriptor"].label):
                traces.add(f"label {command['descriptor'].label}")
        for command in stream.filter(Op.CREATE_PROGRAM):
            program = command["descriptor"]
            for stage in program.stages:
                traces.update(
                    f"text {match}" for match in re.findall(trace.text, program.emit("glsl", stage).text)
                )
            traces.update(
                f"binding {binding.name}"
                for binding in program.bindings
                if re.search(trace.bindings, binding.name)
            )
    return traces


@pytest.mark.parametrize("name", TECHNIQUES)
@pytest.mark.parametrize("effect", TRACES, ids=lambda effect: effect.value)
def test_an_effect_that_a_scene_lacks_leaves_no_trace_in_the_commands(effect: Effect, name: str) -> None:
    trace, every = TRACES[effect], set(TRACES)
    without = every - {effect, Effect.BLOOM} if effect is Effect.EMISSION else every - {effect}
    assert not list_traces(make(without), name, trace)
    kinds = {found_trace.partition(" ")[0] for found_trace in list_traces(make(every), name, trace)}
    assert kinds >= ({"text"} if effect is Effect.EMISSION else {"label", "text", "binding"})


MATERIAL_TRACES = {
    Effect.METALS: r"\bmetallic_surface\b",
    Effect.NORMAL_MAPS: r"\.normal_texture\b",
    Effect.ROUGHNESS_MAPS: r"\.metallic_roughness_texture\b",
    Effect.OCCLUSION_MAPS: r"\.occlusion_texture\b",
    Effect.EMISSIVE_MAPS: r"\.emissive_texture\b",
    Effect.LIGHT_MAPS: r"\.light_map_texture\b",
    Effect.MASKS: r"\bdiscard\b|\.alpha_cutoff\b",
    Effect.TWO_SIDES: r"\bgl_FrontFacing\b",
}
"""What programs say that have what materials may have, which bind nothing but the materials and their
images."""


def make_material(effects: set[Effect]) -> Scene:
    """Make a box of a material with these effects, and with a base map."""
    builder = SceneBuilder("box")
    texels = np.full((4, 4, 4), 250, np.uint8)
    texels[:2, :, 3] = 0  # what masks cut
    image = builder.add_image(texels)
    values: dict[Effect, dict[str, object]] = {
        Effect.METALS: {"roughness": 0.5},
        Effect.NORMAL_MAPS: {"normal_texture": image},
        Effect.ROUGHNESS_MAPS: {"metallic_roughness_texture": image},
        Effect.OCCLUSION_MAPS: {"occlusion_texture": image},
        Effect.EMISSIVE_MAPS: {"emissive": (1.0, 1.0, 1.0), "emissive_texture": image},
        Effect.LIGHT_MAPS: {"light_map_texture": image},
        Effect.MASKS: {"alpha_mode": AlphaMode.MASK},
        Effect.TWO_SIDES: {"double_sided": True},
    }
    parameters = {name: value for effect in effects for name, value in values[effect].items()}
    material = builder.add_material(texture=image, **parameters)
    builder.add_objects(builder.add_node(), builder.add_mesh(BUILT_IN["box"]()), material)
    builder.lights.add_directional((0, -1, 0))
    return builder.build()


@cache
def write_programs(effects: frozenset[Effect], name: str) -> str:
    """Return the text of all programs of a frame."""
    with open_technique(make_material(set(effects)), name) as renderer:
        renderer.render(EYE)
        programs = [command["descriptor"] for command in renderer.device.stream.filter(Op.CREATE_PROGRAM)]
        return "\n".join(
            shader_program.emit("glsl", stage).text
            for shader_program in programs
            for stage in shader_program.stages
        )


@pytest.mark.parametrize("name", ["forward", "deferred_plus"])
@pytest.mark.parametrize("effect", MATERIAL_TRACES, ids=lambda effect: effect.value)
def test_a_feature_that_no_material_has_is_in_no_program(effect: Effect, name: str) -> None:
    every = frozenset(MATERIAL_TRACES)
    lacking = every - {effect, Effect.ROUGHNESS_MAPS} if effect is Effect.METALS else every - {effect}
    assert not re.findall(MATERIAL_TRACES[effect], write_programs(lacking, name))
    assert re.findall(MATERIAL_TRACES[effect], write_programs(every, name))


LIGHTS = "light rows|light grid|light volume|light spheres|light cones|whole target|light indices"


@pytest.mark.parametrize(
    "name", ["forward", "forward_multipass", "light_indexed", "forward_plus", "clustered"]
)
def test_without_local_lights_no_light_lists_are_created(name: str) -> None:
    lights = {Effect.POINT_LIGHTS, Effect.SPOT_LIGHTS}
    trace = Trace(LIGHTS, r"\blight_list\b|\bin_range\b|\bClusterGrid\b", "light|grid")
    assert not list_traces(make(set()), name, trace)
    assert len(list_traces(make(lights), name, trace)) > 3


NO_PASSES: tuple[list[str], list[str]] = ([], [])
ADDED: dict[str, tuple[list[str], list[str]]] = {
    "forward": NO_PASSES,
    "forward_multipass": (["base", "{}", "resolve"], ["forward"]),
    "deferred": (["{}"], []),
    "light_pre_pass": (["normals", "{}", "materials"], ["forward"]),
    "inferred": (["normals", "downscale", "{}", "materials"], ["forward"]),
    "light_indexed": (["depth", "light indices"], []),
    "forward_plus": (["depth", "light lists"], []),
    "clustered": (["light lists"], []),
    "tiled_deferred": (["tiles"], []),
    "clustered_deferred": (["light lists"], []),
}
"""The passes that a first local light adds, and those that they replace; `{}` is the kind of the local
light."""


def list_passes(scene: Scene, name: str) -> list[str]:
    with open_technique(scene, name) as renderer:
        renderer.render(EYE)
        events = [command["text"] for command in renderer.device.stream.filter(Op.PUSH_LABEL)]
        _, plan = renderer.plan(EYE)
    assert events == [frame_pass.name for frame_pass in plan.passes]
    return events


@pytest.mark.parametrize("name", ADDED)
@pytest.mark.parametrize("effect", [Effect.POINT_LIGHTS, Effect.SPOT_LIGHTS], ids=lambda effect: effect.value)
def test_one_local_light_adds_exactly_its_passes(effect: Effect, name: str) -> None:
    added, replaced = (
        [name_of_pass.format(effect.value) for name_of_pass in pass_names] for pass_names in ADDED[name]
    )
    without, lit = list_passes(make(set()), name), list_passes(make({effect}), name)
    assert [name_of_pass for name_of_pass in lit if name_of_pass not in without] == added
    assert [name_of_pass for name_of_pass in without if name_of_pass not in lit] == replaced
    both = list_passes(make({Effect.POINT_LIGHTS, Effect.SPOT_LIGHTS}), name)
    other = {"point lights", "spot lights"} - {effect.value}
    assert [name_of_pass for name_of_pass in both if name_of_pass not in lit] == [
        name_of_pass for name_of_pass in both if name_of_pass in other
    ]


@pytest.mark.parametrize("name", TECHNIQUES)
@pytest.mark.parametrize(
    "effect",
    [Effect.DIRECTIONAL_LIGHTS, Effect.IMAGES, Effect.EMISSION, Effect.HAZE],
    ids=lambda effect: effect.value,
)
def test_effects_other_than_local_lights_add_no_pass(effect: Effect, name: str) -> None:
    lights = {Effect.POINT_LIGHTS, Effect.SPOT_LIGHTS}
    assert list_passes(make({effect}), name) == list_passes(make(set()), name)
    assert list_passes(make({effect} | lights), name) == list_passes(make(lights), name)


@pytest.mark.parametrize("name", TECHNIQUES)
def test_fog_adds_one_pass_of_one_draw_and_no_bytes(name: str) -> None:
    lights = {Effect.POINT_LIGHTS, Effect.SPOT_LIGHTS}
    for others in (set(), lights):
        clear, foggy = (measure(make(others | more), name) for more in (set(), {Effect.FOG}))
        assert [pass_name for pass_name in foggy.passes if pass_name not in clear.passes] == ["sky"]
        assert [pass_name for pass_name in foggy.passes if pass_name != "sky"] == clear.passes
        assert (foggy.draws - clear.draws, foggy.bytes - clear.bytes) == (1, 0)


@pytest.mark.parametrize("name", TECHNIQUES)
def test_bloom_adds_two_passes_of_twelve_draws_and_its_images(name: str) -> None:
    lights = {Effect.POINT_LIGHTS, Effect.SPOT_LIGHTS}
    width, height = SIZE
    halves = sum((width >> i) * max(height >> i, 1) for i in range(1, 7))
    for others in (set(), lights):
        # What only emits has no bloom, so that the technique's own passes are the same.
        dull, blooming = (
            measure(make(others | {effect}), name) for effect in (Effect.EMISSION, Effect.BLOOM)
        )
        assert blooming.passes == [*dull.passes, "bloom", "tone mapping"]
        assert blooming.draws - dull.draws == 6 + 5 + 1
        # Linear light in half floats may share the texture of the technique's own light.
        assert blooming.bytes - dull.bytes in {8 * halves, 8 * halves + 8 * width * height}


def test_bloom_needs_something_that_is_brighter_than_white() -> None:
    scene = make({Effect.BLOOM})
    assert "tone mapping" in list_passes(scene, "forward")
    scene.materials["emission"] = 1.0
    scene.refresh()
    assert list_passes(scene, "forward") == list_passes(make({Effect.EMISSION}), "forward")
    scene.materials["emissive"] = (0.0, 0.5, 0.0)  # beside what the base colour emits
    scene.refresh()
    assert "tone mapping" in list_passes(scene, "forward")


@pytest.mark.parametrize("name", TECHNIQUES)
@pytest.mark.parametrize("kind", ["point", "spot"])
def test_local_lights_that_are_points_leave_no_trace_of_spheres_and_spheres_add_no_draw(
    name: str, kind: str
) -> None:
    trace = Trace("source radii", r"\bsphere_cosine\b", "source_radii")
    points, spheres = (make({Effect.POINT_LIGHTS, Effect.SPOT_LIGHTS}) for _ in range(2))
    getattr(spheres.lights, kind)["source_radius"] = 0.1
    assert not list_traces(points, name, trace)
    assert {found_trace.partition(" ")[0] for found_trace in list_traces(spheres, name, trace)} == {
        "text",
        "label",
        "binding",
    }
    assert measure(spheres, name) == measure(points, name)


@pytest.mark.parametrize("name", TECHNIQUES)
def test_local_lights_that_are_points_leave_no_trace_of_areas_and_areas_add_no_draw(name: str) -> None:
    trace = Trace("source shapes|lobe fits", r"\bgather_rectangle\b", "source_shapes|lobe_fits")
    points, areas = (make({Effect.POINT_LIGHTS, Effect.SPOT_LIGHTS}) for _ in range(2))
    areas.lights.point["source_right"] = (0.1, 0.0, 0.0)
    assert not list_traces(points, name, trace)
    assert {found_trace.partition(" ")[0] for found_trace in list_traces(areas, name, trace)} == {
        "text",
        "label",
        "binding",
    }
    assert measure(areas, name) == measure(points, name)


@dataclass(frozen=True)
class Measured:
    """The passes of a frame, its draws and the bytes of its textures."""

    passes: list[str]
    draws: int
    bytes: int


def measure(scene: Scene, name: str) -> Measured:
    with open_technique(scene, name) as renderer:
        renderer.render(EYE)
        _, plan = renderer.plan(EYE)
        draws = len(renderer.device.stream.draws())
    return Measured([frame_pass.name for frame_pass in plan.passes], draws, plan.count_bytes(SIZE))
