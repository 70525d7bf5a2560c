"""Forward shading: one pass, in which each fragment is lit by all lights that reach its object.

Objects are drawn front to back, so that early depth tests avoid the shading of hidden fragments.
"""

from __future__ import annotations

from typing import Final

from renderer.frame import DEPTH_FORMAT, Frame, Needs, Pass, Target
from renderer.techniques.parts.depth import depth_pass
from renderer.techniques.parts.finish import finish_image, forward_passes, name_samples
from renderer.techniques.parts.variants import FORWARD, draw_lit


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
        if self.samples == 1:
            return forward_passes(needs)
        return (
            depth_pass("layers and culling can't read depth of several samples"),
            Pass(
                "forward",
                _draw_samples,
                f"draws the visible objects, lit, {self.samples} samples per pixel",
                reads=("depth",),
                writes=(
                    Target(name_samples(needs.image.name), needs.image.format, samples=self.samples),
                    Target(name_samples("depth"), DEPTH_FORMAT, samples=self.samples),
                ),
            ),
            *finish_image(needs, FORWARD, samples=self.samples),
        )


def _draw_samples(frame: Frame) -> None:
    image, depth = (frame.targets[name_samples(name)] for name in (frame.needs.image.name, "depth"))
    draw_lit(frame, image=image, depth=depth)
