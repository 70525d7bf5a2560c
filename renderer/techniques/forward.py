"""Forward shading: one pass, in which each fragment is lit by all lights that reach its object.

One `draw_many` draws all visible objects, front to back, so that early depth tests spare the shading of what
is hidden; a second one draws those whose transform mirrors them, if there are any.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame import Frame, SceneResources
from renderer.scene import Depth
from renderer.shaders import forward_variant
from rhi import CullMode, DepthFunction, DepthTest, DepthWrite, Device, FrontFace, Program

_DEPTH: Final = {Depth.REVERSED: (0.0, DepthFunction.GREATER), Depth.STANDARD: (1.0, DepthFunction.LESS)}
"""What depth is cleared to, and the test that the nearer fragment passes."""


class Forward:
    """Lit in one pass; the shader has only the kinds of lights and textures that the scene has."""

    name: Final = "forward"

    def render(self, device: Device, frame: Frame) -> None:
        """One pass: what the algorithm lets through, front to back, lit as it is drawn."""
        resources, targets = frame.resources, frame.targets
        far, nearer = _DEPTH[frame.camera.projection.depth]
        background = (*resources.scene.background, 1.0)
        program, bindings = bind_forward(device, resources)

        def draw(rows: NDArray[np.int64]) -> None:
            mirrored = resources.mirrored[rows]
            for part, winding in (
                (rows[~mirrored], FrontFace.COUNTER_CLOCKWISE),
                (rows[mirrored], FrontFace.CLOCKWISE),
            ):
                if part.size:
                    with device.states(winding):
                        device.draw_many(program, resources.mesh, resources.draws[part], **bindings)

        with (
            device.event("forward"),
            device.render_pass(targets.color, targets.depth, clear=background, clear_depth=far),
            device.states(CullMode.BACK, DepthTest.ON, DepthWrite.ON, nearer),
        ):
            frame.draw_visible(draw)


def bind_forward(device: Device, resources: SceneResources) -> tuple[Program[Any], dict[str, Any]]:
    """The forward program for what the scene has, and what it reads."""
    optional = {
        "images": resources.images,
        "directional_lights": resources.directional.buffer,
        "point_lights": resources.point.buffer,
        "spot_lights": resources.spot.buffer,
        "haze": resources.haze.buffer if resources.scene.haze > 0.0 else None,
    }
    present: dict[str, Any] = {name: value for name, value in optional.items() if value is not None}
    program: Program[Any] = device.program(forward_variant(*present))
    if resources.light_rows.buffer is not None:
        present["light_rows"] = resources.light_rows.buffer
    return program, present | {
        "view": resources.view.buffer,
        "ambient": resources.ambient.buffer,
        "objects": resources.objects.buffer,
        "positions": resources.positions.buffer,
        "materials": resources.materials.buffer,
    }
