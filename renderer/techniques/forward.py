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
    features, bindings = bind_materials(frame)
    optional = {
        Effect.POINT_LIGHTS: ("point_lights", resources.point.buffer),
        Effect.SPOT_LIGHTS: ("spot_lights", resources.spot.buffer),
    }
    present: dict[str, Any] = dict(binding for effect, binding in optional.items() if effect in effects)
    shader = forward_variant(*features, *present, has_sun=frame.needs.has_sun)
    if present:
        present["light_rows"] = resources.light_rows.buffer
    return frame.device.program(shader), bindings | present


def bind_materials(frame: Frame) -> tuple[list[str], dict[str, Any]]:
    """Return the names of the parts that a `ForwardShader` needs for the frame's effects, without those of point and
    spot lights, and its bindings."""
    resources = frame.resources
    features, bindings = bind_shading(frame)
    if Effect.IMAGES in frame.needs.effects:
        features.append("images")
        bindings["images"] = resources.images
    return features, bindings | {
        "view": frame.view.buffer,
        "objects": resources.objects.buffer,
        "places": resources.places.buffer,
        "materials": resources.materials.buffer,
    }


def bind_shading(frame: Frame) -> tuple[list[str], dict[str, Any]]:
    """Return the names of the parts that a `ShadingShader` needs for the frame's effects, and its bindings."""
    resources, effects = frame.resources, frame.needs.effects
    optional = {
        Effect.DIRECTIONAL_LIGHTS: ("directional_lights", resources.directional.buffer),
        Effect.HAZE: ("haze", resources.haze.buffer),
    }
    present: dict[str, Any] = dict(binding for effect, binding in optional.items() if effect in effects)
    features = [*present, *(["emission"] if Effect.EMISSION in effects else [])]
    return features, present | {"ambient": resources.ambient.buffer}
