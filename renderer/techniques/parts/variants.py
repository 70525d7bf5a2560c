"""Variants of shaders: what a frame needs decides their switches, and what they read is bound by its name.

A name means one thing in a frame: `SOURCES` says what, or it is that of contents of the frame's plan. So a technique
composes shaders, and lists no bindings but those that are its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any, Final

from renderer.frame import (
    DEPTH_FORMAT,
    LAMPS,
    SHADOW_EFFECTS,
    BoundProgram,
    Effect,
    Frame,
    Needs,
    Pass,
    Target,
    TechniquePass,
)
from renderer.frame.air import bind_fog, bind_haze
from renderer.frame.images import MOST_ARRAYS, SceneImages
from renderer.shadows import FILTERS, ShadowMaps, ShadowReceiver
from renderer.techniques.parts.full_screen import BEHIND, Color, bind_rays, make_triangle
from renderer.techniques.parts.scene_shader import ForwardShader, SceneShader
from rhi import BlendFunction, CullMode, DepthTest, DepthWrite, Program, State, Texture


@dataclass(frozen=True, slots=True)
class Lighting:
    """The way in which a technique lights the surfaces that it draws: the bases of a `ForwardShader`'s variant, its
    switches, what it binds besides what a frame has by name, and the contents that it reads."""

    bases: tuple[type[Any], ...] = (ForwardShader,)
    switches: Mapping[str, Any] = field(default_factory=dict)
    bind: Callable[[Frame], Mapping[str, Any]] = lambda frame: {}
    reads: tuple[str, ...] = ()


NO_LAMPS: Final = {"has_point_lights": False, "has_spot_lights": False}


def list_lamps(needs: Needs) -> list[Effect]:
    """Return the kinds of lights with a range that a frame needs."""
    return [effect for effect in LAMPS if effect in needs.effects]


def explain_lamps(needs: Needs) -> str:
    """Return why a frame needs a pass about lamps."""
    return "; ".join(map(needs.explain, list_lamps(needs)))


FORWARD: Final = Lighting()
"""Lights surfaces by the lists of their objects."""
SWITCHES: Final = {effect: f"has_{effect.name.lower()}" for effect in Effect}
"""The switch of shaders that each effect turns on."""
COVERAGE: Final[Mapping[str, bool]] = {"has_normal_maps": False, "has_two_sides": False}
"""Switches of shaders that draw where surfaces are, and nothing else of them."""


@cache
def combine(bases: tuple[type[Any], ...], constants: tuple[tuple[str, Any], ...] = ()) -> type[Any]:
    """Return the shader with these bases and constants."""
    return type(bases[-1].__name__, bases, {"__module__": bases[-1].__module__, **dict(constants)})


def find_variant(frame: Frame, *bases: type[Any], **fixed: Any) -> type[Any]:
    """Return the shader with these bases for what the frame needs; switches that are `fixed` don't depend on it."""
    needs, images = frame.needs, frame.resources.images
    is_own = any(base in needs.shaders for base in bases)
    if not needs.effects.isdisjoint(SHADOW_EFFECTS) and any(issubclass(base, ShadowReceiver) for base in bases):
        bases = (FILTERS[frame.resources.workspace(ShadowMaps).settings.filter], *bases)
    sizes = None
    if images is not None:
        sizes = len(images.colors), len(images.data), images.table is not None, images.footprint
    facts = (needs.effects, needs.has_sun, needs.has_both_models, needs.has_planes, is_own, sizes)
    return choose_variant(bases, *facts, **fixed)


@cache
def choose_variant(
    bases: tuple[type[Any], ...],
    effects: frozenset[Effect],
    sun: bool,
    both_models: bool,
    planes: bool,
    is_own: bool,
    images: tuple[int, int, bool, float] | None,
    /,
    **fixed: Any,
) -> type[Any]:
    """Return the variant of `find_variant` for these facts about a frame; each is chosen once."""
    switches: dict[str, Any] = {name: effect in effects for effect, name in SWITCHES.items()}
    switches |= {"has_sun": sun, "has_both_models": both_models, "has_planes": planes}
    if images is not None:
        switches |= dict(zip(("image_arrays", "map_arrays", "has_table", "footprint"), images, strict=True))
    needs_changes = images is not None and (images[2] or images[3] != 1.0)
    switches |= {"is_own": is_own, "has_changes": is_own or needs_changes}
    switches |= fixed
    switches["has_second_uvs"] = switches["has_second_uvs"] and switches.get("has_table", False)
    return combine(bases, tuple((name, switches[name]) for name in _find_known(bases, tuple(switches))))


@cache
def _find_known(bases: tuple[type[Any], ...], names: tuple[str, ...]) -> list[str]:
    """Return the names that are attributes of any of the bases."""
    return [name for name in names if any(hasattr(base, name) for base in bases)]


SOURCES: Final[dict[str, Callable[[Frame], Any]]] = {
    "view": lambda frame: frame.view.buffer,
    "rays": bind_rays,
    "objects": lambda frame: frame.resources.objects.buffer,
    "places": lambda frame: frame.resources.places.buffer,
    "materials": lambda frame: frame.resources.materials.buffer,
    "ambient": lambda frame: frame.resources.ambient.buffer,
    "directional_lights": lambda frame: frame.resources.directional.buffer,
    "point_lights": lambda frame: frame.resources.point.buffer,
    "spot_lights": lambda frame: frame.resources.spot.buffer,
    "source_radii": lambda frame: frame.resources.source_radii.texture,
    "light_rows": lambda frame: frame.resources.light_rows.buffer,
    "textures": lambda frame: _images_of(frame).table,
    "fog": bind_fog,
    "haze": bind_haze,
}
"""The sources of what shaders bind by these names."""
_SHADOWS: Final = ("suns", "lamps", "lamp_slots", "lamp_maps", "shadow_compare", "shadow_atlas")
_IMAGES: Final = {f"{kind}_{i}" if i else kind: (kind, i) for kind in ("images", "maps") for i in range(MOST_ARRAYS)}


def find_binding(frame: Frame, name: str) -> Any:
    """Return what a name stands for in a frame."""
    if name in SOURCES:
        return SOURCES[name](frame)
    if name in _SHADOWS:
        return frame.resources.workspace(ShadowMaps).find(name)
    if name in _IMAGES:
        kind, number = _IMAGES[name]
        images = _images_of(frame)
        return (images.colors if kind == "images" else images.data)[number]
    return frame.targets[name.replace("_samples", " samples")]  # see `name_samples`


def _images_of(frame: Frame) -> SceneImages:
    images = frame.resources.images
    assert images is not None, "images are bound where the scene has some"
    return images


def bind(frame: Frame, program: Program[...], own: Mapping[str, Any]) -> dict[str, Any]:
    """Return the bindings of a program: those of its `own` that it has, and what its other names stand for."""
    names = [binding.name for binding in program.descriptor.bindings]
    return {name: own[name] if name in own else find_binding(frame, name) for name in names}


def bind_programs(
    frame: Frame, *bases: type[Any], own: Mapping[str, Any] = {}, switches: Mapping[str, Any] = {}
) -> list[BoundProgram]:
    """Return the programs that draw the scene's geometry by the variant of a shader with these bases: one, or where
    materials have shaders of their own, the renderer's and one for each of these."""
    program: Program[...] = frame.program(find_variant(frame, *bases, **switches))
    bound = [BoundProgram(program, bind(frame, program, own))]
    effects = frame.needs.effects
    reads_materials = any(issubclass(base, SceneShader) and not base.is_coverage for base in bases)
    cuts = issubclass(bases[-1], SceneShader) and switches.get("has_masks", Effect.MASKS in effects)
    if not switches.get("has_material_shaders", Effect.MATERIAL_SHADERS in effects) or not (reads_materials or cuts):
        return bound
    bound *= 1 + len(frame.needs.shaders)
    for number, shader, parameters in list_shaders(frame)[1:]:
        program = frame.program(find_variant(frame, *shader, *bases, **switches))
        bound[number] = BoundProgram(program, bind(frame, program, {**own, **parameters}))
    return bound


def list_shaders(frame: Frame) -> list[tuple[int, tuple[type[Any], ...], dict[str, Any]]]:
    """Return the shaders of materials that objects have: their numbers, further bases of a variant, and bindings. The
    renderer's is the first, whether or not any object has it."""
    resources = frame.resources
    listed: list[tuple[int, tuple[type[Any], ...], dict[str, Any]]] = [(0, (), {})]
    for number, (one, values) in enumerate(zip(resources.scene.shaders, resources.parameters, strict=True), 1):
        if resources.has_shader(number):
            listed.append((number, (one.shader,), {"parameters": values.buffer}))
    return listed


def scene_pass(
    frame: Frame,
    *bases: type[Any],
    color: Texture | list[Texture] | None,
    own: Mapping[str, Any] = {},
    depth: Texture | None = None,
    switches: Mapping[str, Any] = {},
    **options: Any,
) -> TechniquePass:
    """Return the pass that draws the scene's geometry by the variant of a shader with these bases. `options` are those
    of a `TechniquePass`."""
    programs, depth = bind_programs(frame, *bases, own=own, switches=switches), depth or frame.targets["depth"]
    return TechniquePass(frame.device, frame.resources, frame.view, programs, color=color, depth=depth, **options)


def draw_full_screen(
    frame: Frame,
    shader: type[Any] | tuple[type[Any], ...],
    color: Texture | list[Texture],
    own: Mapping[str, Any] = {},
    *,
    depth: Texture | None = None,
    clear: Color | None = None,
    states: tuple[State, ...] = (),
    switches: Mapping[str, Any] = {},
) -> None:
    """Run the variant of a `BackgroundScreen` shader, or of one with these bases, for each pixel of the targets, in a
    pass of its own.

    Args:
        own: bindings that `find_binding` doesn't know, or that are others here.
        depth: the depth that geometry was drawn to. Then the shader runs only for pixels with a surface. It can't be
            among the bindings.
        clear: the colour of pixels for which the shader isn't run, or that it discards; None keeps what the targets
            hold.
        states: states besides no culling, no blending, and the depth test that `depth` asks for.
    """
    device = frame.device
    defaults: tuple[State, ...] = (CullMode.NONE, DepthWrite.OFF, BlendFunction.OFF)
    if depth is None:
        defaults += (DepthTest.OFF,)
    else:
        defaults += (DepthTest.ON, BEHIND[frame.camera.projection.depth])
    chosen = {type(state): state for state in (*defaults, *states)}
    bases = shader if isinstance(shader, tuple) else (shader,)
    program: Any = frame.program(find_variant(frame, *bases, **switches))
    triangle = frame.view.workspace(make_triangle)
    with device.render_pass(color, depth, clear=clear), device.states(*chosen.values()):
        device.draw(program, triangle, **bind(frame, program, own))


def name_samples(contents: str, samples: int) -> str:
    """Return the name of contents with so many samples per pixel."""
    return contents if samples == 1 else f"{contents} samples"


def lit_pass(
    needs: Needs, lighting: Lighting, because: str,
    *, after_depth: bool = False, name: str = "forward", samples: int = 1,
) -> Pass[Frame]:  # fmt: skip
    """Return the pass that draws the visible objects lit, to `needs.image` and `depth`, or with several samples to
    contents that `name_samples` names; where depth was drawn before, only what is seen."""
    depth = Target(name_samples("depth", samples), DEPTH_FORMAT, samples=samples)
    image = replace(needs.image, name=name_samples(needs.image.name, samples), samples=samples)
    return Pass(
        name,
        partial(draw_lit, lighting=lighting, after_depth=after_depth, samples=samples),
        because if samples == 1 else f"{because}, {samples} samples per pixel",
        reads=(*([depth.name] if after_depth else []), *(["depth"] if samples > 1 else []), *lighting.reads),
        writes=(image,) if after_depth else (image, depth),
    )


def draw_lit(frame: Frame, lighting: Lighting = FORWARD, *, after_depth: bool = False, samples: int = 1) -> None:
    """Draw the visible objects lit; see `lit_pass`."""
    lit = scene_pass(
        frame,
        *lighting.bases,
        own=lighting.bind(frame),
        switches=lighting.switches,
        color=frame.targets[name_samples(frame.needs.image.name, samples)],
        depth=frame.targets[name_samples("depth", samples)],
        clear=frame.background,
        # Not EQUAL: nothing is nearer than what was drawn, and a test of order lets rasterisers skip what is hidden.
        states=(DepthWrite.OFF,) if after_depth else (),
        clears=not after_depth,
    )
    frame.draw_visible(lit)
