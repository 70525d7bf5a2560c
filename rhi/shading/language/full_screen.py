"""The vertex stage of shaders that cover a whole target."""

from __future__ import annotations

from rhi.shading.language.functions import vertex_index
from rhi.shading.language.shader import Shader
from rhi.shading.language.types import LANGUAGE_NAMES
from rhi.shading.language.vectors import vec4

LANGUAGE_NAMES.add("FullScreen")


class FullScreen(Shader):
    """The base of shaders that cover a whole target with one triangle, drawn with `device.mesh(3)`.

    `fragment_coordinate()` is the pixel. The triangle lies at the far end of reversed depth, just above the 0
    to which depth is cleared, so that everything else in the same depth target covers it, whether drawn
    before or after it. A derived shader may have another `screen_depth`.
    """

    def vertex(self) -> vec4:
        """Return the clip position of one of the three corners."""
        corner = vertex_index()
        x = float(corner % 2) * 4.0 - 1.0
        y = float(corner // 2) * 4.0 - 1.0
        return vec4(x, y, self.screen_depth(), 1.0)

    def screen_depth(self) -> float:
        """Return the depth of all fragments."""
        return 1e-30
