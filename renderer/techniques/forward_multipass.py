"""Forward shading in several passes: a base pass, then a light at a time, added by blending (Thatcher 2014,
algorithm 2).

- The base pass draws depth, and all light that isn't a lamp's: ambient, emission, directional lights.
- A light's pass draws the objects that it reaches once more, where they are visible (depth equal), and adds its light.
  Of objects in one place only the one that the base pass shows is lit: that pass notes which one it is.
- The light is added up in linear 32-bit floats; a last pass maps it to colours.

An object that k lights reach is transformed k + 1 times, and each of its pixels is shaded as often: the cost grows with
objects × lights. What a light doesn't reach it doesn't draw, and all point lights are one `draw_many`, in the order of
the lights, in which an instance is a pair of an object and a light; so are all spot lights.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

import rhi.shading as sl
from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target, choose_program, find_states
from renderer.scene.arrays import Rows
from renderer.shaders.structs import Object, SurfaceVarying
from renderer.techniques.parts.finish import finish_image, forward_passes
from renderer.techniques.parts.light_volumes import declare_lights
from renderer.techniques.parts.resolve import EXACT_BITS, SUM_FORMATS, check_bits, sum_pass
from renderer.techniques.parts.scene_shader import ForwardShader, LampShader, SurfaceShader
from renderer.techniques.parts.variants import (
    FORWARD,
    NO_LAMPS,
    bind_programs,
    list_lamps,
    scene_pass,
)
from rhi import BlendFunction, CullMode, DepthFunction, DepthTest, DepthWrite, Format, State, Texture

_ADDED: Final[tuple[State, ...]] = (
    DepthTest.ON,
    DepthWrite.OFF,
    DepthFunction.EQUAL,
    BlendFunction.ADDITIVE,
)


class BaseTexels(sl.Struct):
    """The texels that `Unmapped` writes: light, and 1 more than the row of the object."""

    light: sl.vec4
    shown: sl.uvec4


class Unmapped(ForwardShader):
    """Leaves light linear and of any strength, to be added to other light, and tells which object is shown. The lists
    of its lights aren't used; their place in the varyings has the object's row."""

    def list_lights(self, thing: Object) -> sl.ivec3:
        return sl.ivec3(self.find_object())

    def fragment(self, v: SurfaceVarying) -> BaseTexels:  # type: ignore[override]  # more targets
        return BaseTexels(light=self.light(v, self.materials[v.material]), shown=sl.uvec4(sl.uint(v.lights.x + 1)))

    def finish(self, color: sl.vec3, position: sl.vec3) -> sl.vec4:
        return sl.vec4(color, 1.0)


class Pair(sl.Struct):
    """An object and one of its lights: the rows `object` of the objects, and `entry` of the light rows."""

    object: int
    entry: int


class LampPairs(SurfaceShader, LampShader):
    """Adds the light of pairs of an object and one lamp of a kind that reaches it; a pair is an instance."""

    pairs: sl.Storage[Pair]

    def find_object(self) -> int:
        return self.pairs[sl.instance_index()].object

    def list_lights(self, thing: Object) -> sl.ivec3:
        entry = self.pairs[sl.instance_index()].entry
        return sl.ivec3(entry, entry + 1 if self.has_point_lights else entry, entry + 1)

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        return sl.vec4(self.lamplight(self.find_surface(v, self.materials[v.material]), v.lights), 0.0)


class ShownPairs(LampPairs):
    """Adds the light of pairs where their object is shown. The place of the lists in the varyings has the light's entry
    and the object's row."""

    shown: sl.UintTexture2D

    def list_lights(self, thing: Object) -> sl.ivec3:
        return sl.ivec3(self.pairs[sl.instance_index()].entry, self.find_object(), 0)

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        if self.shown.load(sl.ivec2(sl.fragment_coordinate().xy)).x != sl.uint(v.lights.y + 1):
            return sl.vec4(0.0)
        entry = v.lights.x
        lights = sl.ivec3(entry, entry + 1 if self.has_point_lights else entry, entry + 1)
        return sl.vec4(self.lamplight(self.find_surface(v, self.materials[v.material]), lights), 0.0)


class ForwardMultipass:
    """Draws the scene with a base pass, and once more for each light; without lamps in view, as `Forward` does."""

    name: Final = "forward_multipass"

    def __init__(self, *, light_bits: int = EXACT_BITS) -> None:
        """`light_bits` is 16 or 32: those of a channel of the light that is added up."""
        check_bits(light_bits, SUM_FORMATS, "ForwardMultipass(light_bits=...)")
        self.light_bits = light_bits

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return a base pass, one for each kind of lamp in view, and one that maps their sum to colours."""
        if not list_lamps(needs):
            return forward_passes(needs)
        base = Pass(
            "base",
            _draw_base,
            "draws the visible objects with the light that isn't a lamp's",
            writes=(
                Target("light", SUM_FORMATS[self.light_bits]),
                Target("shown", Format.R32UI),
                Target("depth", DEPTH_FORMAT),
            ),
        )
        passes, (light,) = declare_lights(
            needs, ["light"], ("shown", "depth"), _add_lamps, are_written=True, because="adds a light at a time; "
        )
        return base, *passes, sum_pass(needs, light), *finish_image(needs, FORWARD)


def _draw_base(frame: Frame) -> None:
    switches = {**NO_LAMPS, "has_haze": False, "has_fog": False}
    color = [frame.targets["light"], frame.targets["shown"]]
    base = scene_pass(frame, Unmapped, switches=switches, color=color)
    frame.draw_visible(base)


def _add_lamps(frame: Frame, *, effect: Effect, targets: Sequence[str], clears: bool) -> None:
    draw_pairs(frame, effect, frame.targets[targets[0]], ShownPairs)


def draw_pairs(frame: Frame, effect: Effect, color: Texture, *bases: type[Any]) -> None:
    """Draw every pair of a visible object and a light of a kind that reaches it, adding up what the variant of
    `LampPairs` with these bases returns."""
    device, resources = frame.device, frame.resources
    is_spot = effect is Effect.SPOT_LIGHTS
    lights = frame.needs.in_view[effect]
    objects, entries = resources.pair_lights(_list_visible(frame), lights, spots=is_spot)
    if not len(objects):
        return
    pairs: Any = np.zeros(len(objects), Pair.dtype)
    pairs["object"], pairs["entry"] = objects, entries
    draws = resources.draws[objects]
    draws["base_instance"] = np.arange(len(objects))
    kinds = {"has_point_lights": not is_spot, "has_spot_lights": is_spot}
    programs = bind_programs(frame, *bases, own={"pairs": device.transient.storage(Pair, pairs)}, switches=kinds)
    with device.render_pass(color, frame.targets["depth"]), device.states(CullMode.BACK, *_ADDED):
        for group in resources.groups:
            chosen = draws[resources.find_group(objects, group)]
            if chosen.size:
                program, bindings = choose_program(programs, group)
                with device.states(*find_states(group)):
                    device.draw_many(program, resources.mesh, chosen, **bindings)


def _list_visible(frame: Frame) -> Rows:
    """Return the objects drawn, but for transparent ones. Where only the device knows them, return all in view: those
    that are hidden fail the depth test."""
    if frame.drawn.is_known:
        return frame.drawn.opaque
    resources = frame.resources
    rows = resources.find_in_view(frame.camera, np.arange(len(resources.draws)))
    return rows[~resources.is_transparent[rows]]
