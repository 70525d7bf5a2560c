"""Forward shading: one pass, in which each fragment is lit by all lights that reach its object.

Objects are drawn front to back, so that early depth tests avoid the shading of hidden fragments.
"""

from __future__ import annotations

from typing import Any, Final

from renderer.frame import DEPTH_FORMAT, IMAGE_FORMAT, Effect, Frame, Needs, Pass, Target, TechniquePass
from renderer.techniques.forward_shader import forward_variant
from rhi import Program


class Forward:
    """Draws the scene lit in one pass; the shader handles only the effects that the frame needs."""

    name: Final = "forward"

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the only pass."""
        return (
            Pass(
                "forward",
                draw_lit,
                "draws the visible objects, lit",
                writes=(Target("image", IMAGE_FORMAT), Target("depth", DEPTH_FORMAT)),
            ),
        )


def draw_lit(frame: Frame) -> None:
    """Draw the visible objects, lit by all lights that reach them."""
    targets = frame.targets
    program, bindings = bind_forward(frame)
    frame.draw_visible(
        TechniquePass(
            frame.device,
            frame.resources,
            frame.view,
            program,
            bindings,
            color=targets.image,
            depth=targets.depth,
            clear=(*frame.resources.scene.background, 1.0),
        )
    )


def bind_forward(frame: Frame) -> tuple[Program[Any], dict[str, Any]]:
    """Return the forward program for the effects that the frame needs, and its bindings."""
    resources, effects = frame.resources, frame.needs.effects
    optional = {
        Effect.IMAGES: ("images", resources.images),
        Effect.DIRECTIONAL_LIGHTS: ("directional_lights", resources.directional.buffer),
        Effect.POINT_LIGHTS: ("point_lights", resources.point.buffer),
        Effect.SPOT_LIGHTS: ("spot_lights", resources.spot.buffer),
        Effect.HAZE: ("haze", resources.haze.buffer),
    }
    present: dict[str, Any] = dict(binding for effect, binding in optional.items() if effect in effects)
    features = [*present, *(["emission"] if Effect.EMISSION in effects else [])]
    program: Program[Any] = frame.device.program(forward_variant(*features, has_sun=frame.needs.has_sun))
    if "point_lights" in present or "spot_lights" in present:
        present["light_rows"] = resources.light_rows.buffer
    return program, present | {
        "view": frame.view.buffer,
        "ambient": resources.ambient.buffer,
        "objects": resources.objects.buffer,
        "places": resources.places.buffer,
        "materials": resources.materials.buffer,
    }
