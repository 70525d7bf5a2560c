"""Forward shading: one pass, in which each fragment is lit by all lights that reach its object.

Objects are drawn front to back, so that early depth tests avoid the shading of hidden fragments.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

from renderer.frame import (
    DEPTH_FORMAT,
    Effect,
    Frame,
    Needs,
    Pass,
    Target,
    TechniquePass,
)
from renderer.shadows import ShadowMaps
from renderer.techniques.air import bind_air
from renderer.techniques.depth import draw_depth
from renderer.techniques.finish import finish_image, name_samples
from renderer.techniques.forward_shader import ForwardShader, forward_variant
from renderer.techniques.surfaces import bind_surfaces, list_models
from rhi import Program, Texture

LAMPS: Final = {Effect.POINT_LIGHTS: "point lights", Effect.SPOT_LIGHTS: "spot lights"}
"""The lights that have a range, and the names of their passes."""


def list_lamps(needs: Needs) -> list[Effect]:
    """Return the kinds of lights with a range that a frame needs."""
    return [effect for effect in LAMPS if effect in needs.effects]


def explain_lamps(needs: Needs) -> str:
    """Return why a frame needs a pass about lamps."""
    return "; ".join(map(needs.explain, list_lamps(needs)))


class Forward:
    """Draws the scene lit in one pass; the shader handles only the effects that the frame needs.

    With several samples per pixel, edges are smooth. Depth of several samples can't be read, but layers and visibility
    algorithms read it: so a pass of its own draws depth first, and finds the visible objects.
    """

    name: Final = "forward"

    def __init__(self, samples: int = 1) -> None:
        """Choose the number of samples per pixel, one of the device's `capabilities.sample_counts`."""
        self.samples = samples

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the pass `forward`; with several samples, one that draws depth before it, and one that resolves them;
        and those of transparent surfaces."""
        image, depth = needs.image, Target("depth", DEPTH_FORMAT)
        because = "draws the visible objects, lit"
        if self.samples == 1:
            return (
                Pass("forward", draw_lit, because, writes=(image, depth)),
                *finish_image(needs, find_forward),
            )
        return (
            Pass("depth", draw_depth, "layers and culling can't read depth of several samples", writes=(depth,)),
            Pass(
                "forward",
                _draw_samples,
                f"{because}, {self.samples} samples per pixel",
                reads=("depth",),
                writes=(
                    Target(name_samples(image.name), image.format, samples=self.samples),
                    Target(name_samples("depth"), DEPTH_FORMAT, samples=self.samples),
                ),
            ),
            *finish_image(needs, find_forward, samples=self.samples),
        )


def draw_lit(frame: Frame) -> None:
    """Draw the visible objects to `image` and `depth`, lit by all lights that reach them."""
    _draw_to(frame, frame.image, frame.targets["depth"])


def _draw_samples(frame: Frame) -> None:
    targets = frame.targets
    _draw_to(frame, targets[name_samples(frame.needs.image.name)], targets[name_samples("depth")])


def _draw_to(frame: Frame, image: Texture, depth: Texture) -> None:
    program, bindings = bind_forward(frame)
    frame.draw_visible(
        TechniquePass(
            frame.device,
            frame.resources,
            frame.view,
            program,
            bindings,
            color=image,
            depth=depth,
            clear=frame.background,
        )
    )


def find_forward(frame: Frame) -> tuple[type[ForwardShader], dict[str, Any]]:
    """Return the forward shader for the effects that the frame needs, and its bindings."""
    (features, bindings), (more, lamps) = bind_materials(frame), bind_lamps(frame)
    return forward_variant(*features, *more, has_sun=frame.needs.has_sun), bindings | lamps


def bind_forward(frame: Frame) -> tuple[Program[Any], dict[str, Any]]:
    """Return the forward program for the effects that the frame needs, and its bindings."""
    shader, bindings = find_forward(frame)
    return frame.program(shader), bindings


def bind_lamps(frame: Frame, effects: Iterable[Effect] = LAMPS) -> tuple[list[str], dict[str, Any]]:
    """Return the names of the parts that a `LampShader` needs for those of the point and spot lights that the frame
    needs, with their shadows, and its bindings."""
    (parts, bindings), (more, maps) = bind_plain_lamps(frame, effects), bind_lamp_shadows(frame, effects)
    return [*parts, *more], bindings | maps


def bind_plain_lamps(frame: Frame, effects: Iterable[Effect] = LAMPS) -> tuple[list[str], dict[str, Any]]:
    """Return the names of the parts of lamps without shadows, and their bindings."""
    resources = frame.resources
    optional = {
        Effect.POINT_LIGHTS: ("point_lights", resources.point.buffer),
        Effect.SPOT_LIGHTS: ("spot_lights", resources.spot.buffer),
    }
    present: dict[str, Any] = dict(optional[effect] for effect in effects if effect in frame.needs.effects)
    parts = list(present)
    if present:
        present["light_rows"] = resources.light_rows.buffer
    return parts, present


def bind_lamp_shadows(frame: Frame, effects: Iterable[Effect] = LAMPS) -> tuple[list[str], dict[str, Any]]:
    """Return the names of the parts of the shadows of those lights that the frame needs, and their bindings."""
    shadows = {Effect.POINT_LIGHTS: Effect.POINT_SHADOWS, Effect.SPOT_LIGHTS: Effect.SPOT_SHADOWS}
    names = {Effect.POINT_LIGHTS: "point", Effect.SPOT_LIGHTS: "spot"}
    kinds = [names[effect] for effect in effects if shadows[effect] in frame.needs.effects]
    return frame.resources.workspace(ShadowMaps).bind_lamps(kinds) if kinds else ([], {})


def bind_materials(frame: Frame, *, is_finished: bool = True) -> tuple[list[str], dict[str, Any]]:
    """Return the names of the parts that a `ForwardShader` needs for the frame's effects, without those of point and
    spot lights, and its bindings. See `bind_shading`."""
    (features, bindings), (more, surfaces) = bind_shading(frame, is_finished=is_finished), bind_surfaces(frame)
    return [*features, *more], bindings | surfaces


def bind_shading(frame: Frame, *, is_finished: bool = True) -> tuple[list[str], dict[str, Any]]:
    """Return the names of the parts that a `ShadingShader` needs for the frame's effects, and its bindings.

    Args:
        is_finished: whether it makes pixels of light; otherwise it needs nothing for the air.
    """
    resources, effects = frame.resources, frame.needs.effects
    present: dict[str, Any] = {}
    if Effect.DIRECTIONAL_LIGHTS in effects:
        present["directional_lights"] = resources.directional.buffer
    air, more = bind_air(frame) if is_finished else ([], {})
    emitting = {Effect.EMISSION: "emission", Effect.EMISSIVE_COLORS: "emissive_colors"}
    features = [*present, *air, *(name for effect, name in emitting.items() if effect in effects)]
    if Effect.SUN_SHADOWS in effects:
        parts, maps = resources.workspace(ShadowMaps).bind_sun()
        features, present = [*features, *parts], present | maps
    return [*features, *list_models(frame.needs)], present | more | {"ambient": resources.ambient.buffer}
