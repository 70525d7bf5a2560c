"""Forward shading: one pass, in which each fragment is lit by all lights that reach its object, or by all of the scene.

Objects are drawn front to back, so that early depth tests avoid the shading of hidden fragments.
"""

from __future__ import annotations

from typing import Final

from renderer.frame import Frame, Needs, Pass
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.parts.finish import forward_passes
from renderer.techniques.parts.scene_shader import ForwardShader
from renderer.techniques.parts.variants import FORWARD, Lighting
from rhi.shading import ivec3, vec3


class LitByAll(ForwardShader):
    """Lights a fragment by all lamps of the scene, whether they reach its object or not."""

    def lamplight(self, surface: SurfacePoint, lights: ivec3) -> vec3:
        color = vec3(0.0)
        if self.has_point_lights:
            for row in range(len(self.point_lights)):
                color += self.pointlight(surface, row)
        if self.has_spot_lights:
            for row in range(len(self.spot_lights)):
                color += self.spotlight(surface, row)
        return color


BY_ALL: Final = Lighting((LitByAll,))


class Forward:
    """Draws the scene lit in one pass; the shader handles only the effects that the frame needs.

    With several samples per pixel, edges are smooth. Depth of several samples can't be read, but layers and visibility
    algorithms read it: so a pass of its own draws depth first, and finds the visible objects.
    """

    name: Final = "forward"

    def __init__(self, samples: int = 1, *, all_lights: bool = False) -> None:
        """Choose the number of samples per pixel, one of the device's `capabilities.sample_counts`. With `all_lights`,
        opaque surfaces have no lists: each fragment looks at each lamp, as in Wilks's forward shading."""
        self.samples = samples
        self.all_lights = all_lights

    @property
    def lighting(self) -> Lighting:
        """The way in which opaque surfaces are lit."""
        return BY_ALL if self.all_lights else FORWARD

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the pass `forward`; with several samples, one that draws depth before it, and one that resolves them;
        and those of transparent surfaces."""
        return forward_passes(needs, self.lighting, samples=self.samples)
