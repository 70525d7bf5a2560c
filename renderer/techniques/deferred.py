"""Deferred shading: the scene's geometry is drawn once, without light; then each light lights the pixels that
it reaches (Hargreaves and Harris, 2004).

1. `geometry` stores the nearest surface of each pixel (`geometry_buffer`).
2. `point lights` and `spot lights` draw the lights' volumes and add what the surfaces in them reflect
   (`light_volumes`).
3. `resolve` adds the light that reaches everything (ambient, directional, emitted), maps tones and adds haze.

So the cost of a light doesn't depend on the number of objects. A scene without point and spot lights has no
light buffer and only the passes 1 and 3.
"""

from __future__ import annotations

from typing import Final

from renderer.frame import Frame, FrameEffects, FramePass
from renderer.techniques.parts.deferred_lighting import GeometryResolve, LightingShader, volume_passes
from renderer.techniques.parts.depth import DEPTH_SHADERS
from renderer.techniques.parts.finish import FINISH_SHADERS
from renderer.techniques.parts.geometry_buffer import DEFAULT_NORMAL_BITS, GEOMETRY_SHADERS, NORMAL_BITS
from renderer.techniques.parts.light_list_reader import ForwardByCells
from renderer.techniques.parts.light_volumes import VolumeShader
from renderer.techniques.parts.resolve import DEFAULT_LIGHT_BITS, SUM_FORMATS, check_bits
from rhi.shading import Shader


class Deferred:
    """Draws the scene to a geometry buffer, lights the buffer by light volumes, and resolves both to the
    image."""

    name: Final = "deferred"
    shaders: Final[tuple[type[Shader], ...]] = (
        *GEOMETRY_SHADERS,
        LightingShader,
        VolumeShader,
        GeometryResolve,
        ForwardByCells,
        *DEPTH_SHADERS,
        *FINISH_SHADERS,
    )
    """The shaders of its passes: a draw's shader is one of them, or several combined."""

    def __init__(
        self,
        *,
        stencil: bool = False,
        light_bits: int = DEFAULT_LIGHT_BITS,
        normal_bits: int = DEFAULT_NORMAL_BITS,
    ) -> None:
        """`stencil` masks each light in the stencil buffer, with two draws per light. `light_bits` (16 or
        32) are the bits per channel of the accumulated light. `normal_bits` (8 or 16) are the bits per
        component of a stored normal; 8 leaves room for 65,536 materials (`technique-too-many-materials`)."""
        check_bits(light_bits, SUM_FORMATS, "Deferred(light_bits=...)")
        check_bits(normal_bits, NORMAL_BITS, "Deferred(normal_bits=...)")
        self.stencil = stencil
        self.light_bits, self.normal_bits = light_bits, normal_bits

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The passes `geometry`, one per kind of local lights in view, `resolve`, and those of transparent
        surfaces."""
        return volume_passes(
            effects, stencil=self.stencil, light_bits=self.light_bits, normal_bits=self.normal_bits
        )
