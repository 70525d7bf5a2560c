"""Forward shading in several passes: a base pass, then a light at a time, or several, added by blending (Thatcher 2014,
algorithms 2 and 3).

- The base pass draws depth, and all light that isn't a local light's: ambient, emission, directional lights.
- A light's pass draws the objects that it reaches once more, where they are visible (depth equal), and adds
  its light. Of objects in one place only the one that the base pass shows is lit: that pass notes which one
  it is.
- The light is added up in linear 32-bit floats; a last pass maps it to colours.

An object that k lights reach is transformed k + 1 times, and each of its pixels is shaded as often: the cost
grows with objects × lights. What a light doesn't reach it doesn't draw, and all point lights are one
`draw_many`, in the order of the lights, in which an instance is a pair of an object and a light; so are all
spot lights. With `lights_per_draw`, an instance is an object and up to so many lights that follow each other in its
list: k lights are ⌈k / lights_per_draw⌉ draws of it.

With `light_volumes`, lights are added as deferred shading does, interlaced with the forward renderer (Malan, 2009): the
pass before the base pass stores the geometry buffer, not depth alone, and the volumes of lights are drawn over the lit
image. So no light draws an object again, and all but local lights sees materials as they are, unrounded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np

import rhi.shading as sl
from renderer import rules
from renderer.frame import (
    DEPTH_FORMAT,
    LOCAL_LIGHTS,
    Effect,
    Frame,
    FrameEffects,
    FramePass,
    Target,
    choose_program,
    draw_group_states,
)
from renderer.light_kinds.bounds import KIND_COUNT, LightBounds
from renderer.light_kinds.generation import define
from renderer.light_kinds.kind import LocalLightKind
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.scene.arrays import Indices
from renderer.shaders.structs import Object, SurfaceVarying
from renderer.techniques.parts.deferred_lighting import LightingShader, light_geometry
from renderer.techniques.parts.depth import DEPTH_SHADERS, depth_pass
from renderer.techniques.parts.finish import FINISH_SHADERS, finish_image, forward_passes
from renderer.techniques.parts.geometry_buffer import (
    DEFAULT_NORMAL_BITS,
    GEOMETRY_SHADERS,
    geometry_buffer_names,
    geometry_pass,
)
from renderer.techniques.parts.light_volumes import VolumeShader, declare_lights
from renderer.techniques.parts.resolve import DEFAULT_LIGHT_BITS, SUM_FORMATS, LightSum, check_bits, sum_pass
from renderer.techniques.parts.scene_shader import ForwardShader, LocalLightShader, SurfaceShader
from renderer.techniques.parts.variants import (
    FORWARD,
    NO_LOCAL_LIGHTS,
    bind_programs,
    local_light_effects,
    make_scene_drawer,
)
from rhi import BlendFunction, CullMode, DepthFunction, DepthTest, DepthWrite, Format, State, Texture

_ADDED: Final[tuple[State, ...]] = (
    DepthTest.ON,
    DepthWrite.OFF,
    DepthFunction.EQUAL,
    BlendFunction.ADDITIVE,
)


class BaseTexels(sl.Struct):
    """Output of `BasePassShader`: light, and the index of the object plus 1."""

    light: sl.vec4
    visible_objects: sl.uvec4


class LinearForward(ForwardShader):
    """Writes linear light of any strength."""

    def finish(self, color: sl.vec3, position: sl.vec3) -> sl.vec4:
        return sl.vec4(color, 1.0)


class BasePassShader(LinearForward):
    """Writes linear light of any strength without that of local lights, and the index of the visible
    object. Light lists aren't used here: their varyings carry the object index."""

    def list_lights(self, object_data: Object) -> LightBounds:
        return LightBounds(self.object_positions[self.get_object_index()].object_index)

    def fragment(self, v: SurfaceVarying) -> BaseTexels:  # type: ignore[override]  # more targets
        return BaseTexels(
            light=self.light(v, self.materials[v.material]), visible_objects=sl.uvec4(sl.uint(v.lights.x + 1))
        )


class LightPair(sl.Struct):
    """An object and one of its lights: the index of the object, and the entry of the light in the light
    list."""

    object: int
    entry: int


class LightBatch(sl.Struct):
    """An object and some of its lights: the index of the object, and where they begin and end in the light list."""

    object: int
    begin: int
    end: int


class PairReader(SurfaceShader, LocalLightShader):
    """Base of shaders that draw one instance per pair of an object and a light that reaches it."""

    pairs: sl.Storage[LightPair]

    def get_object_index(self) -> int:
        return self.pairs[sl.instance_index()].object


def _list_bounds(kinds: Sequence[LocalLightKind], begin: str = "entry", end: str = "entry + 1") -> str:
    """The source of the bounds of a light list from `begin` to `end`, whose lights are of the kind that is enabled."""
    bounds = [begin]
    for number in range(1, len(kinds)):
        is_before = " or ".join(f"self.has_{kind.name}_lights" for kind in kinds[:number])
        bounds.append(f"{end} if {is_before} else {begin}")
    return f"LightBounds({', '.join(bounds)}, {end})"


LightPairs: Final[type[PairReader]] = define(
    f"""
class LightPairs(PairReader):
    def list_lights(self, object_data: Object) -> LightBounds:
        entry = self.pairs[sl.instance_index()].entry
        return {_list_bounds(LOCAL_LIGHT_KINDS)}

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        return sl.vec4(
            self.shade_local_lights(self.evaluate_surface(v, self.materials[v.material]), v.lights), 0.0
        )
""",
    "LightPairs",
    __name__,
    PairReader=PairReader,
    LightBounds=LightBounds,
    Object=Object,
    SurfaceVarying=SurfaceVarying,
    sl=sl,
)
"""Adds the light of pairs of an object and one light of a kind that reaches it."""


class VisiblePairReader(PairReader):
    """Base of `VisibleLightPairs`."""

    visible_objects: sl.UintTexture2D


class VisibleBatchReader(SurfaceShader, LocalLightShader):
    """Base of `VisibleLightBatches`."""

    visible_objects: sl.UintTexture2D
    batches: sl.Storage[LightBatch]

    def get_object_index(self) -> int:
        return self.batches[sl.instance_index()].object


VisibleLightPairs: Final[type[VisiblePairReader]] = define(
    f"""
class VisibleLightPairs(VisiblePairReader):
    def list_lights(self, object_data: Object) -> LightBounds:
        return LightBounds(
            self.pairs[sl.instance_index()].entry, self.get_object_index(){", 0" * (KIND_COUNT - 1)}
        )

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        if self.visible_objects.load(sl.ivec2(sl.fragment_coordinate().xy)).x != sl.uint(v.lights.y + 1):
            return sl.vec4(0.0)
        entry = v.lights.x
        lights = {_list_bounds(LOCAL_LIGHT_KINDS)}
        return sl.vec4(
            self.shade_local_lights(self.evaluate_surface(v, self.materials[v.material]), lights), 0.0
        )
""",
    "VisibleLightPairs",
    __name__,
    VisiblePairReader=VisiblePairReader,
    LightBounds=LightBounds,
    Object=Object,
    SurfaceVarying=SurfaceVarying,
    sl=sl,
)
"""Adds the light of pairs where their object is visible. The place of the bounds in the varyings has the
light's entry and the object's index."""


VisibleLightBatches: Final[type[VisibleBatchReader]] = define(
    f"""
class VisibleLightBatches(VisibleBatchReader):
    def list_lights(self, object_data: Object) -> LightBounds:
        batch = self.batches[sl.instance_index()]
        return LightBounds(batch.begin, batch.end, batch.object{", 0" * (KIND_COUNT - 2)})

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        if self.visible_objects.load(sl.ivec2(sl.fragment_coordinate().xy)).x != sl.uint(v.lights.z + 1):
            return sl.vec4(0.0)
        lights = {_list_bounds(LOCAL_LIGHT_KINDS, "v.lights.x", "v.lights.y")}
        return sl.vec4(
            self.shade_local_lights(self.evaluate_surface(v, self.materials[v.material]), lights), 0.0
        )
""",
    "VisibleLightBatches",
    __name__,
    VisibleBatchReader=VisibleBatchReader,
    LightBounds=LightBounds,
    Object=Object,
    SurfaceVarying=SurfaceVarying,
    sl=sl,
)
"""The same of batches. The place of the bounds has those of the batch, and the object's index."""


class ForwardMultipass:
    """Draws the scene with a base pass, then each object once more for each light that reaches it, or for each
    `lights_per_draw`; or the volumes of lights. Without local lights in view, as `Forward`."""

    name: Final = "forward_multipass"
    shaders: Final[tuple[type[sl.Shader], ...]] = (
        LinearForward,
        BasePassShader,
        VisibleLightPairs,
        VisibleLightBatches,
        *GEOMETRY_SHADERS,
        LightingShader,
        VolumeShader,
        LightSum,
        *DEPTH_SHADERS,
        *FINISH_SHADERS,
    )
    """The shaders of its passes: a draw's shader is one of them, or several combined."""

    def __init__(
        self, *, light_bits: int = DEFAULT_LIGHT_BITS, lights_per_draw: int = 1, light_volumes: bool = False
    ) -> None:
        """`light_bits` (16 or 32) are the bits per channel of the accumulated light. Each draw of an object adds the
        light of at most `lights_per_draw` lights. With `light_volumes` the volumes of lights are drawn instead, but
        not in views of materials that no geometry buffer has room for."""
        check_bits(light_bits, SUM_FORMATS, "ForwardMultipass(light_bits=...)")
        self.light_bits, self.light_volumes = light_bits, light_volumes
        self.lights_per_draw = rules.check_count(
            rules.BAD_TECHNIQUE, "ForwardMultipass(lights_per_draw=...)", lights_per_draw
        )

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The base pass, one pass per kind of local lights in view, one that tone-maps their sum, and
        those of transparent surfaces."""
        if not local_light_effects(effects):
            return forward_passes(effects)
        if self.light_volumes and not effects.needs_forward:
            return self._declare_volumes(effects)
        before = (depth_pass(effects.depth_reason),) if effects.shading_reads else ()
        written = Target("light", SUM_FORMATS[self.light_bits]), Target("visible_objects", Format.R32UI)
        base = FramePass(
            "base",
            partial(_draw_base, after_depth=bool(before)),
            "draws the visible objects with all light but that of local lights",
            reads=("depth", *effects.shading_reads) if before else (),
            writes=written if before else (*written, Target("depth", DEPTH_FORMAT)),
        )
        passes, (light,) = declare_lights(
            effects,
            ["light"],
            ("visible_objects", "depth"),
            partial(_add_lights, lights_per_draw=self.lights_per_draw),
            are_written=True,
            reason="adds a light at a time; "
            if self.lights_per_draw == 1
            else f"adds {self.lights_per_draw} lights at a time; ",
        )
        return *before, base, *passes, sum_pass(effects, light), *finish_image(effects, FORWARD)

    def _declare_volumes(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The geometry buffer, the base pass, and the passes that add the volumes of lights and map their sum."""
        reads = geometry_buffer_names(effects)
        base = FramePass(
            "base",
            partial(_draw_base, after_depth=True, shader=LinearForward, targets=("light",)),
            "draws the visible objects with all light but that of local lights",
            reads=("depth", *effects.shading_reads),
            writes=(Target("light", SUM_FORMATS[self.light_bits]),),
        )
        passes, (light,) = declare_lights(
            effects,
            ["light"],
            reads,
            partial(light_geometry, stencil=False),
            are_written=True,
            reason="adds lights by their volumes; ",
        )
        geometry = geometry_pass(effects, normal_bits=DEFAULT_NORMAL_BITS)
        return geometry, base, *passes, sum_pass(effects, light), *finish_image(effects, FORWARD)


def _draw_base(
    frame: Frame,
    *,
    after_depth: bool,
    shader: type[LinearForward] = BasePassShader,
    targets: tuple[str, ...] = ("light", "visible_objects"),
) -> None:
    switches = {**NO_LOCAL_LIGHTS, "has_haze": False, "has_fog": False}
    base = make_scene_drawer(
        frame,
        shader,
        switches=switches,
        color=[frame.targets[target] for target in targets],
        states=(DepthWrite.OFF,) if after_depth else (),
        clears=not after_depth,
    )
    frame.draw_visible(base)


def _add_lights(
    frame: Frame, *, effect: Effect, targets: Sequence[str], clears: bool, lights_per_draw: int
) -> None:
    light = frame.targets[targets[0]]
    if lights_per_draw == 1:
        draw_pairs(frame, effect, light, VisibleLightPairs)
    else:
        draw_batches(frame, effect, light, lights_per_draw)


def draw_pairs(frame: Frame, effect: Effect, color: Texture, *bases: type[Any]) -> None:
    """Draw every pair of a visible object and a light of one kind that reaches it, and add what the
    variant of `LightPairs` with these bases returns."""
    objects, entries = _pair_visible(frame, effect)
    if not len(objects):
        return
    pairs: Any = np.zeros(len(objects), LightPair.dtype)
    pairs["object"], pairs["entry"] = objects, entries
    _draw_instances(
        frame, effect, color, bases, objects, {"pairs": frame.device.transient.storage(LightPair, pairs)}
    )


def draw_batches(frame: Frame, effect: Effect, color: Texture, lights_per_draw: int) -> None:
    """Draw every visible object once for each batch of its lights of one kind, and add their light."""
    objects, begins, ends = batch_lights(*_pair_visible(frame, effect), lights_per_draw)
    if not len(objects):
        return
    batches: Any = np.zeros(len(objects), LightBatch.dtype)
    batches["object"], batches["begin"], batches["end"] = objects, begins, ends
    bindings = {"batches": frame.device.transient.storage(LightBatch, batches)}
    _draw_instances(frame, effect, color, (VisibleLightBatches,), objects, bindings)


def batch_lights(objects: Indices, entries: Indices, most: int) -> tuple[Indices, Indices, Indices]:
    """Join pairs of an object and an entry of the light list to batches of at most `most` entries that follow each
    other. Returns the object of each batch, and where its entries begin and end, ordered by both."""
    order = np.lexsort((entries, objects))
    objects, entries = objects[order], entries[order]
    numbers = np.arange(len(order))
    is_new = np.ones(len(order), bool)
    is_new[1:] = (np.diff(objects) != 0) | (np.diff(entries) != 1)
    in_run = numbers - np.maximum.accumulate(np.where(is_new, numbers, 0))
    starts = np.flatnonzero(in_run % most == 0)
    sizes = np.diff(starts, append=len(order))
    return objects[starts], entries[starts], entries[starts] + sizes


def _pair_visible(frame: Frame, effect: Effect) -> tuple[Indices, Indices]:
    """The pairs of a visible object and a light of one kind in view: object indices, and entries of the light list."""
    kind = LOCAL_LIGHTS[effect].kind
    return frame.resources.pair_objects_with_lights(_list_visible(frame), frame.effects.in_view[effect], kind)


def _draw_instances(
    frame: Frame,
    effect: Effect,
    color: Texture,
    bases: tuple[type[Any], ...],
    objects: Indices,
    bindings_of_lights: Mapping[str, Any],
) -> None:
    """Add the light of one kind that instances of objects reflect, each by the lights that the bindings name for it."""
    device, resources = frame.device, frame.resources
    draws = resources.get_draws(objects, resources.detail_limit)
    draws["base_instance"] = np.arange(len(objects))
    kinds = {**NO_LOCAL_LIGHTS, f"has_{LOCAL_LIGHTS[effect].kind.name}_lights": True}
    programs = bind_programs(frame, *bases, shader_bindings=bindings_of_lights, switches=kinds)
    with device.render_pass(color, frame.targets["depth"]), device.states(CullMode.BACK, *_ADDED):
        for group in resources.groups:
            group_draws = draws[resources.select_group(objects, group)]
            if group_draws.size:
                program, bindings = choose_program(programs, group)
                with device.states(*draw_group_states(group)):
                    device.draw_many(program, resources.mesh, group_draws, **bindings)


def _list_visible(frame: Frame) -> Indices:
    """The opaque objects drawn. If only the device knows them, all opaque objects in view: hidden ones
    fail the depth test."""
    if frame.draw_result.is_on_cpu:
        return frame.draw_result.opaque
    resources = frame.resources
    object_indices = resources.select_in_view(frame.camera, np.arange(len(resources.scene.objects)))
    return object_indices[~resources.is_transparent[object_indices]]
