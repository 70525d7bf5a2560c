"""Forward shading: one pass, in which each fragment is lit by all lights that reach its object, or by all of the scene.

Objects are drawn front to back, so that early depth tests avoid the shading of hidden fragments.
"""

from __future__ import annotations

from functools import partial
from typing import Final

from renderer.frame import DEPTH_FORMAT, Frame, Needs, Pass, Target
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.parts.depth import depth_pass
from renderer.techniques.parts.finish import finish_image, name_samples
from renderer.techniques.parts.scene_shader import ForwardShader
from renderer.techniques.parts.variants import FORWARD, Lighting, draw_lit, lit_pass
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
        if self.samples == 1:
            return lit_pass(needs, self.lighting, "draws the visible objects, lit"), *finish_image(needs, FORWARD)
        return (
            depth_pass("layers and culling can't read depth of several samples"),
            Pass(
                "forward",
                partial(_draw_samples, lighting=self.lighting),
                f"draws the visible objects, lit, {self.samples} samples per pixel",
                reads=("depth",),
                writes=(
                    Target(name_samples(needs.image.name), needs.image.format, samples=self.samples),
                    Target(name_samples("depth"), DEPTH_FORMAT, samples=self.samples),
                ),
            ),
            *finish_image(needs, FORWARD, samples=self.samples),
        )


def _draw_samples(frame: Frame, *, lighting: Lighting) -> None:
    image, depth = (frame.targets[name_samples(name)] for name in (frame.needs.image.name, "depth"))
    draw_lit(frame, lighting, image=image, depth=depth)
