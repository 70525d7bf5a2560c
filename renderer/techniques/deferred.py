"""Deferred shading: the scene's geometry is drawn once, without light; then each light lights the pixels that it
reaches (Hargreaves and Harris, 2004).

1. `geometry` stores the nearest surface of each pixel (`geometry_buffer`).
2. `point lights` and `spot lights` draw the lights' volumes and add what the surfaces in them reflect
   (`light_volumes`).
3. `resolve` adds the light that reaches everything (ambient, directional, emitted), maps tones and adds haze.

So the cost of a light doesn't depend on the number of objects. A scene without point and spot lights has no light
buffer and only the passes 1 and 3.
"""

from __future__ import annotations

from typing import Final

from renderer.frame import Frame, Needs, Pass
from renderer.techniques.parts.deferred_lighting import volume_passes
from renderer.techniques.parts.geometry_buffer import EXACT_NORMAL, NORMAL_BITS
from renderer.techniques.parts.resolve import EXACT_BITS, SUM_FORMATS, check_bits


class Deferred:
    """Draws the scene to a geometry buffer, lights that by volumes, and makes the image from both."""

    name: Final = "deferred"

    def __init__(self, *, stencil: bool = False, light_bits: int = EXACT_BITS, normal_bits: int = EXACT_NORMAL) -> None:
        """With `stencil`, each light is masked in a stencil buffer, which takes two draws for each. `light_bits` is 16
        or 32: those of a channel of the light that is added up. `normal_bits` is 8 or 16: those of each of the two
        numbers that are stored of a normal. With 8, a scene may have 65,536 materials (`technique-many-materials`)."""
        check_bits(light_bits, SUM_FORMATS, "Deferred(light_bits=...)")
        check_bits(normal_bits, NORMAL_BITS, "Deferred(normal_bits=...)")
        self.stencil = stencil
        self.light_bits, self.normal_bits = light_bits, normal_bits

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `geometry`, `point lights` and `spot lights` if there are any in view, and `resolve`, and
        those of transparent surfaces."""
        return volume_passes(needs, stencil=self.stencil, light_bits=self.light_bits, normal_bits=self.normal_bits)
