"""Forward shading: one pass, in which each fragment is lit by all lights that reach its object.

Objects are drawn front to back, so that early depth tests avoid the shading of hidden fragments.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, Final

from renderer.frame import DEPTH_FORMAT, IMAGE_FORMAT, Effect, Frame, Needs, Pass, Target, TechniquePass
from renderer.techniques.depth import draw_depth
from renderer.techniques.forward_shader import forward_variant
from rhi import Program, Texture


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
        """Return the only pass; with several samples, one that draws depth before it, and one that resolves them."""
        image, depth = Target("image", IMAGE_FORMAT), Target("depth", DEPTH_FORMAT)
        because = "draws the visible objects, lit"
        if self.samples == 1:
            return (Pass("forward", _draw_lit, because, writes=(image, depth)),)
        return (
            Pass(
                "depth", draw_depth, "layers and culling can't read depth of several samples", writes=(depth,)
            ),
            Pass(
                "forward",
                _draw_samples,
                f"{because}, {self.samples} samples per pixel",
                reads=("depth",),
                writes=(
                    Target("image samples", IMAGE_FORMAT, samples=self.samples),
                    Target("depth samples", DEPTH_FORMAT, samples=self.samples),
                ),
            ),
            Pass(
                "resolve",
                _resolve_samples,
                "a pixel is the mean of its samples",
                reads=("image samples",),
                writes=(image,),
            ),
        )


def _draw_lit(frame: Frame) -> None:
    draw_lit(frame, frame.targets["image"], frame.targets["depth"])


def _draw_samples(frame: Frame) -> None:
    draw_lit(frame, frame.targets["image samples"], frame.targets["depth samples"])


def _resolve_samples(frame: Frame) -> None:
    frame.targets["image samples"].resolve_to(frame.targets["image"])


def draw_lit(frame: Frame, image: Texture, depth: Texture) -> None:
    """Draw the visible objects, lit by all lights that reach them."""
    program, bindings = bind_forward(frame, "ambient")
    frame.draw_visible(
        TechniquePass(
            frame.device,
            frame.resources,
            frame.view,
            program,
            bindings,
            color=image,
            depth=depth,
            clear=(*frame.resources.scene.background, 1.0),
        )
    )


def bind_forward(
    frame: Frame, *parts: str, effects: Collection[Effect] | None = None, **more: Any
) -> tuple[Program[Any], dict[str, Any]]:
    """Return the forward program for effects, by default all that the frame needs, and its bindings.

    Args:
        parts: further `PARTS` of the shader. more: their bindings.
    """
    resources, needed = frame.resources, frame.needs.effects if effects is None else effects
    optional = {
        Effect.IMAGES: ("images", resources.images),
        Effect.DIRECTIONAL_LIGHTS: ("directional_lights", resources.directional.buffer),
        Effect.POINT_LIGHTS: ("point_lights", resources.point.buffer),
        Effect.SPOT_LIGHTS: ("spot_lights", resources.spot.buffer),
        Effect.HAZE: ("haze", resources.haze.buffer),
    }
    present: dict[str, Any] = dict(binding for effect, binding in optional.items() if effect in needed)
    features = [*parts, *present, *(["emission"] if Effect.EMISSION in needed else [])]
    program: Program[Any] = frame.device.program(forward_variant(*features, has_sun=frame.needs.has_sun))
    if "point_lights" in present or "spot_lights" in present:
        present["light_rows"] = resources.light_rows.buffer
    if "ambient" in parts:
        present["ambient"] = resources.ambient.buffer
    return program, present | more | {
        "view": frame.view.buffer,
        "objects": resources.objects.buffer,
        "places": resources.places.buffer,
        "materials": resources.materials.buffer,
    }
