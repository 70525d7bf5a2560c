"""Forward shading in several passes: a base pass, then a light at a time, added by blending (Wilks).

- The base pass draws depth, and all light that isn't a lamp's: ambient, emission, directional lights.
- A light's pass draws the objects that it reaches once more, where they are visible (depth equal), and adds its light.
- The light is added up in linear 16-bit floats; a last pass maps it to colours.

An object that k lights reach is transformed k + 1 times, and each of its pixels is shaded as often: the cost grows with
objects × lights. What a light doesn't reach it doesn't draw, and all point lights are one `draw_many`, in the order of
the lights, in which an instance is a pair of an object and a light; so are all spot lights.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target, TechniquePass
from renderer.frame.passes import WINDINGS
from renderer.scene.arrays import Rows
from renderer.techniques.forward import Forward, bind_forward
from renderer.techniques.forward_shader import Pair
from renderer.techniques.resolve import LIGHT_FORMAT, declare_resolve
from rhi import BlendFunction, CullMode, DepthFunction, DepthTest, DepthWrite, State

LAMPS: Final = {Effect.POINT_LIGHTS: "point lights", Effect.SPOT_LIGHTS: "spot lights"}
"""The lights that have a range, and the names of their passes."""

_ADDED: Final[tuple[State, ...]] = (
    CullMode.BACK,
    DepthTest.ON,
    DepthWrite.OFF,
    DepthFunction.EQUAL,
    BlendFunction.ADDITIVE,
)


class ForwardMultipass:
    """Draws the scene with a base pass, and once more for each light; without lamps in view, as `Forward` does."""

    name: Final = "forward_multipass"

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return a base pass, one for each kind of lamp in view, and one that maps their sum to colours."""
        lamps = [effect for effect in LAMPS if effect in needs.effects]
        if not lamps:
            return Forward().declare(needs)
        base = Pass(
            "base",
            _draw_base,
            "draws the visible objects with the light that isn't a lamp's",
            writes=(Target("light", LIGHT_FORMAT), Target("depth", DEPTH_FORMAT)),
        )
        passes, light = [base], "light"
        for effect in lamps:
            result = f"light with {LAMPS[effect]}"
            passes.append(
                Pass(
                    LAMPS[effect],
                    _add_points if effect is Effect.POINT_LIGHTS else _add_spots,
                    f"adds a light at a time; {needs.explain(effect)}",
                    reads=("depth",),
                    changes={light: result},
                )
            )
            light = result
        return *passes, declare_resolve(needs, light)


def _draw_base(frame: Frame) -> None:
    program, bindings = bind_forward(
        frame, "unmapped", "ambient", effects=frame.needs.effects - {*LAMPS, Effect.HAZE}
    )
    frame.draw_visible(
        TechniquePass(
            frame.device,
            frame.resources,
            frame.view,
            program,
            bindings,
            color=frame.targets["light"],
            depth=frame.targets["depth"],
            clear=(0.0, 0.0, 0.0, 0.0),
        )
    )


def _add_points(frame: Frame) -> None:
    _add_lamps(frame, Effect.POINT_LIGHTS, "point_pairs", frame.needs.point_rows)


def _add_spots(frame: Frame) -> None:
    _add_lamps(frame, Effect.SPOT_LIGHTS, "spot_pairs", frame.needs.spot_rows)


def _add_lamps(frame: Frame, effect: Effect, part: str, lights: Rows) -> None:
    """Draw every pair of a visible object and a light that reaches it, adding up the light."""
    device, resources, targets = frame.device, frame.resources, frame.targets
    rows = _list_visible(frame)
    objects, entries = resources.pair_lights(rows, lights, spots=effect is Effect.SPOT_LIGHTS)
    if not len(objects):
        return
    pairs: Any = np.zeros(len(objects), Pair.dtype)
    pairs["object"], pairs["entry"] = objects, entries
    draws = resources.draws[objects]
    draws["base_instance"] = np.arange(len(objects))
    program, bindings = bind_forward(
        frame,
        "unmapped",
        part,
        effects={effect, Effect.IMAGES} & frame.needs.effects,
        pairs=device.transient.storage(Pair, pairs),
    )
    with device.render_pass(targets["light"], targets["depth"]), device.states(*_ADDED):
        for mirrored, winding in WINDINGS:
            part_of = draws[resources.find_winding(objects, mirrored=mirrored)]
            if part_of.size:
                with device.states(winding):
                    device.draw_many(program, resources.mesh, part_of, **bindings)


def _list_visible(frame: Frame) -> Rows:
    """Return the objects drawn. Where only the device knows them, return all in view: those that are hidden fail the
    depth test."""
    if frame.drawn.is_known:
        return frame.drawn.rows
    resources = frame.resources
    return resources.find_in_view(frame.camera, np.arange(len(resources.draws)))
