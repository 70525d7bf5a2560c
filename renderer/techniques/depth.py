"""A pass that draws depth alone: the first of techniques that shade only what is visible."""

from __future__ import annotations

from renderer.frame import Frame, TechniquePass
from renderer.shaders.depth import DepthOnly

__rhi_internal__ = True


def draw_depth(frame: Frame) -> None:
    """Draw the depth of the visible objects to `depth`."""
    resources = frame.resources
    bindings = {
        "view": frame.view.buffer,
        "objects": resources.objects.buffer,
        "places": resources.places.buffer,
    }
    program = frame.device.program(DepthOnly)
    frame.draw_visible(
        TechniquePass(
            frame.device, resources, frame.view, program, bindings, color=None, depth=frame.targets["depth"]
        )
    )
