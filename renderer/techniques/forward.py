"""Forward shading: one pass, in which each fragment is lit by all lights that reach its object.

Objects are drawn front to back, so that early depth tests avoid the shading of hidden fragments.
"""

from __future__ import annotations

from typing import Any, Final

from renderer.frame import Frame, SceneResources, TechniquePass
from renderer.techniques.forward_shader import forward_variant
from rhi import Device, Program


class Forward:
    """Draws the scene lit in one pass; the shader handles only the kinds of lights and textures that the scene
    has."""

    name: Final = "forward"

    def render(self, device: Device, frame: Frame) -> None:
        """Draw the visible objects in one pass, lit."""
        resources, targets = frame.resources, frame.targets
        program, bindings = bind_forward(device, resources)
        with device.event("forward"):
            frame.draw_visible(
                TechniquePass(
                    device,
                    resources,
                    frame.camera,
                    program,
                    bindings,
                    color=targets.color,
                    depth=targets.depth,
                    clear=(*resources.scene.background, 1.0),
                )
            )


def bind_forward(device: Device, resources: SceneResources) -> tuple[Program[Any], dict[str, Any]]:
    """Return the forward program for the features that the scene has, and its bindings."""
    optional = {
        "images": resources.images,
        "directional_lights": resources.directional.buffer,
        "point_lights": resources.point.buffer,
        "spot_lights": resources.spot.buffer,
        "haze": resources.haze.buffer if resources.scene.haze > 0.0 else None,
    }
    present: dict[str, Any] = {name: value for name, value in optional.items() if value is not None}
    program: Program[Any] = device.program(forward_variant(*present, has_sun=len(resources.directional) == 1))
    if resources.light_rows.buffer is not None:
        present["light_rows"] = resources.light_rows.buffer
    return program, present | {
        "view": resources.view.buffer,
        "ambient": resources.ambient.buffer,
        "objects": resources.objects.buffer,
        "places": resources.places.buffer,
        "materials": resources.materials.buffer,
    }
