"""Variants of shaders: a frame's effects set their switches, and their bindings are looked up by name.

`shader_variant` combines the parts that a technique names with two that all techniques share: the filter of
shadows, and the shader of a material. `bind` takes bindings from `FrameBindings`, where a name means one
thing in a frame; a technique passes only the bindings that are its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any, Final

from renderer.frame import (
    CAMERA_EFFECTS,
    DEPTH_FORMAT,
    LOCAL_LIGHTS,
    PENUMBRA_EFFECTS,
    SHADOW_EFFECTS,
    BoundProgram,
    Effect,
    Frame,
    FrameEffects,
    FramePass,
    LightComponent,
    Target,
    TechniqueDrawer,
)
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.shaders.materials import IN_TABLE
from renderer.shadows import ShadowMaps, ShadowReceiver, filter_shader
from renderer.techniques.parts.frame_bindings import FOLLOW_CAMERA, FrameBindings
from renderer.techniques.parts.full_screen import BEHIND, Color, make_triangle
from renderer.techniques.parts.own_lighting import with_lighting_models
from renderer.techniques.parts.scene_shader import ForwardShader, SceneShader
from rhi import BlendFunction, CullMode, DepthTest, DepthWrite, Program, State, Texture
from rhi.errors.shared_caches import cache_once
from rhi.math import is_parallel


@dataclass(frozen=True, slots=True)
class Lighting:
    """The lighting of the surfaces that a technique draws: the bases of a `ForwardShader` variant, its
    switches, its own bindings, and the resources that it reads."""

    bases: tuple[type[Any], ...] = (ForwardShader,)
    switches: Mapping[str, Any] = field(default_factory=dict)
    bind: Callable[[Frame], Mapping[str, Any]] = lambda frame: {}
    reads: tuple[str, ...] = ()


NO_LOCAL_LIGHTS: Final = {f"has_{kind.name}_lights": False for kind in LOCAL_LIGHT_KINDS}


def local_light_effects(effects: FrameEffects) -> list[Effect]:
    """The kinds of local lights that a frame has in view."""
    return [effect for effect in LOCAL_LIGHTS if effect in effects.enabled]


def explain_local_lights(effects: FrameEffects) -> str:
    """Why a frame needs a pass about local lights."""
    return "; ".join(map(effects.explain, local_light_effects(effects)))


FORWARD: Final = Lighting()
"""Lights surfaces by the lists of their objects."""
SWITCHES: Final = {effect: f"has_{effect.name.lower()}" for effect in Effect}
"""The switch of shaders that each effect turns on."""
COVERAGE: Final[Mapping[str, bool]] = {"has_normal_maps": False, "has_two_sides": False}
"""Switches of shaders that draw where surfaces are, and nothing else of them."""


@cache_once
def combine(bases: tuple[type[Any], ...], constants: tuple[tuple[str, Any], ...] = ()) -> type[Any]:
    """The shader class with these bases and constants."""
    return type(bases[-1].__name__, bases, {"__module__": bases[-1].__module__, **dict(constants)})


def shader_variant(frame: Frame, *bases: type[Any], **fixed: Any) -> type[Any]:
    """The shader with these bases and the switches of the frame's effects; `fixed` switches don't depend
    on the frame."""
    key = (shader_variant, bases, *fixed.items())
    variant = frame.values.get(key)
    if variant is None:
        variant = frame.values[key] = _make_variant(frame, bases, fixed)
    return variant


def _make_variant(frame: Frame, bases: tuple[type[Any], ...], fixed: Mapping[str, Any]) -> type[Any]:
    effects, images = frame.effects, frame.resources.images
    is_own = any(base in effects.shaders for base in bases)
    if not effects.enabled.isdisjoint(SHADOW_EFFECTS) and any(
        issubclass(base, ShadowReceiver) for base in bases
    ):
        settings = frame.resources.workspace(ShadowMaps).settings
        has_penumbras = not effects.enabled.isdisjoint(PENUMBRA_EFFECTS)
        bases = (filter_shader(settings, has_penumbras=has_penumbras), *bases)
    if effects.lighting_models:
        bases = with_lighting_models(bases, effects.lighting_models)
    sizes = None
    if images is not None:
        arrays = (len(images.colors), len(images.data)) if images.tables is None else (IN_TABLE, IN_TABLE)
        sizes = (
            *arrays,
            images.table is not None,
            images.gradient_scale,
            images.has_bright_texels,
            images.has_two_channels,
        )
    facts = (
        effects.enabled,
        effects.has_single_directional_light,
        effects.has_both_models,
        effects.has_geometric_normals,
        is_own,
        is_parallel(frame.camera.projection),
        sizes,
        effects.component,
        effects.contact_light,
    )
    return cached_shader_variant(bases, *facts, **fixed)


@cache_once
def cached_shader_variant(
    bases: tuple[type[Any], ...],
    enabled: frozenset[Effect],
    sun: bool,
    both_models: bool,
    planes: bool,
    is_own: bool,
    parallel: bool,
    images: tuple[int, int, bool, float, bool, bool] | None,
    component: LightComponent,
    contact_light: int,
    /,
    **fixed: Any,
) -> type[Any]:
    """The variant of `shader_variant` for these properties of a frame, created once."""
    switches: dict[str, Any] = {name: effect in enabled for effect, name in SWITCHES.items()}
    switches |= {
        "has_single_directional_light": sun,
        "has_both_models": both_models,
        "has_geometric_normals": planes,
        "has_parallel_rays": parallel,
        "contact_light": contact_light,
        "keeps_light": not enabled.isdisjoint(CAMERA_EFFECTS),
    }
    if images is not None:
        names = (
            "image_arrays",
            "map_arrays",
            "has_table",
            "gradient_scale",
            "has_bright_texels",
            "has_two_channels",
        )
        switches |= dict(zip(names, images, strict=True))
    else:
        switches["map_arrays"] = 0
    needs_changes = images is not None and (images[2] or images[3] != 1.0)
    switches |= {"is_own": is_own, "has_gradients": is_own or needs_changes}
    switches |= component.switches | fixed
    switches["has_second_uvs"] = switches["has_second_uvs"] and switches.get("has_table", False)
    return combine(bases, tuple((name, switches[name]) for name in _list_switches(bases, tuple(switches))))


@cache
def _list_switches(bases: tuple[type[Any], ...], names: tuple[str, ...]) -> list[str]:
    """The names that are attributes of any of the bases."""
    return [name for name in names if any(hasattr(base, name) for base in bases)]


def bind(frame: Frame, program: Program[...], shader_bindings: Mapping[str, Any]) -> dict[str, Any]:
    """Bindings of a program: its `shader_bindings`, and for all other names those of `FrameBindings`."""
    key, descriptor = (bind, program, *shader_bindings), program.descriptor
    last: tuple[object, list[str], dict[str, Any]] | None = frame.values.get(key)
    if last is None or last[0] is not descriptor:
        bindings = FrameBindings(frame)
        names = [binding.name for binding in descriptor.bindings if not binding.table]
        moving = [name for name in names if name in FOLLOW_CAMERA and name not in shader_bindings]
        bound: dict[str, Any] = {
            name: shader_bindings[name] if name in shader_bindings else bindings[name] for name in names
        }
        frame.values[key] = descriptor, moving, bound
        return bound
    _, moving, bound = last
    if moving:
        bindings = FrameBindings(frame)
        for name in moving:
            bindings[name]
    if shader_bindings:
        bound = bound.copy()
        for name, resource in shader_bindings.items():
            if name in bound:
                bound[name] = resource
    return bound


def bind_programs(
    frame: Frame, *bases: type[Any], shader_bindings: Mapping[str, Any] = {}, switches: Mapping[str, Any] = {}
) -> list[BoundProgram]:
    """Programs that draw the scene's geometry with these bases: one, and one more for each shader of
    materials, if there are any."""
    program: Program[...] = frame.program(shader_variant(frame, *bases, **switches))
    bound = [BoundProgram(program, bind(frame, program, shader_bindings))]
    enabled = frame.effects.enabled
    if not switches.get("has_material_shaders", Effect.MATERIAL_SHADERS in enabled):
        return bound
    reads_materials = any(issubclass(base, SceneShader) and not base.is_coverage for base in bases)
    cuts = issubclass(bases[-1], SceneShader) and switches.get("has_masks", Effect.MASKS in enabled)
    if not (reads_materials or cuts):
        return bound
    bound *= 1 + len(frame.effects.shaders)
    for number, shader, parameters in list_shaders(frame)[1:]:
        program = frame.program(shader_variant(frame, *shader, *bases, **switches))
        bound[number] = BoundProgram(program, bind(frame, program, {**shader_bindings, **parameters}))
    return bound


def list_shaders(frame: Frame) -> list[tuple[int, tuple[type[Any], ...], dict[str, Any]]]:
    """Shaders of materials in use: number, further bases of a variant, and bindings. The renderer's own
    comes first, even if no object has it."""
    resources = frame.resources
    listed: list[tuple[int, tuple[type[Any], ...], dict[str, Any]]] = [(0, (), {})]
    for number, (material_shader, values) in enumerate(
        zip(resources.scene.shaders, resources.parameters, strict=True), 1
    ):
        if resources.has_shader(number):
            listed.append((number, (material_shader.shader,), {"parameters": values.buffer}))
    return listed


def make_scene_drawer(
    frame: Frame,
    *bases: type[Any],
    color: Texture | list[Texture] | None,
    shader_bindings: Mapping[str, Any] = {},
    depth: Texture | None = None,
    switches: Mapping[str, Any] = {},
    **options: Any,
) -> TechniqueDrawer:
    """The drawer of the scene's geometry with these bases; `options` are those of `TechniqueDrawer`."""
    programs, depth = (
        bind_programs(frame, *bases, shader_bindings=shader_bindings, switches=switches),
        depth or frame.targets["depth"],
    )
    return TechniqueDrawer(
        frame.device, frame.resources, frame.view, programs, color=color, depth=depth, **options
    )


def draw_full_screen(
    frame: Frame,
    shader: type[Any] | tuple[type[Any], ...],
    color: Texture | list[Texture],
    shader_bindings: Mapping[str, Any] = {},
    *,
    depth: Texture | None = None,
    clear: Color | None = None,
    states: tuple[State, ...] = (),
    switches: Mapping[str, Any] = {},
) -> None:
    """Run the variant of a `BackgroundScreen` shader, or of several bases, for each pixel of the targets,
    in a pass of its own.

    Args:
        shader_bindings: those that `FrameBindings` doesn't have, or that are others here.
        depth: the depth that geometry was drawn to. Then the shader runs only for pixels with a surface. It
            can't be among the bindings.
        clear: the colour of pixels for which the shader isn't run, or that it discards; None keeps what the
            targets hold.
        states: states besides no culling, no blending, and the depth test that `depth` asks for.
    """
    device = frame.device
    defaults: tuple[State, ...] = (CullMode.NONE, DepthWrite.OFF, BlendFunction.OFF)
    if depth is None:
        defaults += (DepthTest.OFF,)
    else:
        defaults += (DepthTest.ON, BEHIND[frame.camera.projection.depth])
    states_by_kind = {type(state): state for state in (*defaults, *states)}
    bases = shader if isinstance(shader, tuple) else (shader,)
    program: Any = frame.program(shader_variant(frame, *bases, **switches))
    triangle = frame.view.workspace(make_triangle)
    with device.render_pass(color, depth, clear=clear), device.states(*states_by_kind.values()):
        device.draw(program, triangle, **bind(frame, program, shader_bindings))


def name_samples(resource: str, samples: int) -> str:
    """Name of a resource with this number of samples per pixel; shaders bind it by this name."""
    return resource if samples == 1 else f"{resource}_samples"


def lit_pass(
    effects: FrameEffects,
    lighting: Lighting,
    reason: str,
    *,
    after_depth: bool = False,
    name: str = "forward",
    samples: int = 1,
) -> FramePass[Frame]:
    """The pass that draws the visible objects lit, to `effects.image` and `depth`, or with several samples
    to the resources that `name_samples` names; after a depth pass, only visible surfaces."""
    depth = Target(name_samples("depth", samples), DEPTH_FORMAT, samples=samples)
    image = replace(effects.image, name=name_samples(effects.image.name, samples), samples=samples)
    return FramePass(
        name,
        partial(draw_lit, lighting=lighting, after_depth=after_depth, samples=samples),
        reason if samples == 1 else f"{reason}, {samples} samples per pixel",
        reads=(
            *([depth.name] if after_depth else []),
            *(["depth"] if samples > 1 else []),
            *lighting.reads,
            *effects.shading_reads,
        ),
        writes=(image,) if after_depth else (image, depth),
        draws_objects=True,
    )


@dataclass(frozen=True, slots=True)
class RepeatedPass:
    """A pass that draws the visible objects, of which nothing but the objects changes with the camera."""

    drawer: TechniqueDrawer
    program: Program[...]
    descriptor: object

    @property
    def is_current(self) -> bool:
        """True unless the program was exchanged or destroyed."""
        return self.program.descriptor is self.descriptor and not self.program.destroyed


def select_repeated_pass(
    frame_pass: FramePass[Frame], values: Mapping[object, object]
) -> RepeatedPass | None:
    """Return the record that `draw_lit` has left of a pass in `Frame.values`; None if the pass runs anything else,
    too."""
    if not (isinstance(frame_pass.run, partial) and frame_pass.run.func is draw_lit):
        return None
    passes = [value for value in values.values() if isinstance(value, RepeatedPass)]
    return passes[0] if len(passes) == 1 else None


def draw_lit(
    frame: Frame, lighting: Lighting = FORWARD, *, after_depth: bool = False, samples: int = 1
) -> None:
    """Draw the visible objects lit; see `lit_pass`."""
    key = draw_lit, samples, after_depth, id(lighting)  # the plan holds it
    last: RepeatedPass | None = frame.values.get(key)
    if last is not None and last.is_current:
        last.drawer.begin_frame()
        frame.draw_visible(last.drawer)
        return
    color, depth = name_samples(frame.effects.image.name, samples), name_samples("depth", samples)
    shader_bindings = lighting.bind(frame)
    programs = bind_programs(
        frame, *lighting.bases, shader_bindings=shader_bindings, switches=lighting.switches
    )
    lit = TechniqueDrawer(
        frame.device,
        frame.resources,
        frame.view,
        programs,
        color=frame.targets[color],
        depth=frame.targets[depth],
        clear=frame.background,
        # Not EQUAL: nothing is nearer than what was drawn, and a test of order lets rasterisers skip what is
        # hidden.
        states=(DepthWrite.OFF,) if after_depth else (),
        clears=not after_depth,
    )
    program, bindings = programs[0]
    if len(programs) == 1 and not shader_bindings and FOLLOW_CAMERA.isdisjoint(bindings):
        frame.values[key] = RepeatedPass(lit, program, program.descriptor)
    frame.draw_visible(lit)
