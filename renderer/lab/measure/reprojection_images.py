"""Images of the depth that `two_pass` begins a frame with: the last frame's, moved to this frame's camera (Deferred+,
Figure 1.2).

Three images have one scale of grey: the depth of this frame, reduced like the moved one; the moved depth, whose holes
are magenta; and the same with its holes filled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.inspection.texture_images import texture_to_image
from renderer.renderer import Renderer
from renderer.scene import Depth, PathFrame
from renderer.scene.arrays import Floats
from renderer.visibility.gpu.farthest_depth import FAR, SCALE
from renderer.visibility.gpu.reprojection import ReprojectedDepth

_MAGENTA: Final = (255, 0, 255)
_NEARER: Final = 0.05
"""The part of its distance by which a texel counts as nearer than it should be. On a floor seen at a low angle,
neighbouring texels differ by less."""


@dataclass(frozen=True, eq=False, slots=True)
class ReprojectedDepths:
    """Depths (h, w) float32 of a frame at a quarter of its size.

    Attributes:
        exact: the farthest depth of each 4 × 4 pixels of the frame itself.
        moved: the last frame's depth as this frame's camera sees it; far where no point landed.
        filled: the same, with holes filled.
        far: the depth of what is infinitely far.
    """

    exact: NDArray[np.float32]
    moved: NDArray[np.float32]
    filled: NDArray[np.float32]
    far: float

    @property
    def holes(self) -> NDArray[np.bool_]:
        """Where no point landed though one was in the last frame, or is in this one."""
        is_known = (self.filled != self.far) | (self.exact != self.far)
        return np.asarray((self.moved == self.far) & is_known)

    @property
    def hides_too_much(self) -> NDArray[np.bool_]:
        """Where the filled depth is nearer than this frame's: what it hides there, the second pass draws."""
        exact, filled = (np.abs(depths.astype(np.float64) - self.far) for depths in (self.exact, self.filled))
        return np.asarray(filled > exact * (1.0 + _NEARER))

    def draw(self) -> NDArray[np.uint8]:
        """The three depths side by side (h, 3 w, 3) in sRGB: near is bright, holes are magenta."""
        nearness = [np.abs(depths - self.far) for depths in (self.exact, self.moved, self.filled)]
        image = texture_to_image("depth", np.concatenate(nearness, axis=1)).copy()
        width = self.moved.shape[1]
        image[:, width : 2 * width][self.holes] = _MAGENTA
        return image


def reproject_depth(renderer: Renderer, last: PathFrame, frame: PathFrame) -> ReprojectedDepths:
    """Draw two frames, and move the depth of the first to the camera of the second, without filling holes and with."""
    device, size = renderer.device, renderer.size
    direction = frame.camera.projection.depth
    both = [ReprojectedDepth(device, fills_holes=fills) for fills in (False, True)]
    depths = list[NDArray[np.float32]]()
    try:
        result = renderer.render(last.camera, last.seconds)
        aspect = size[0] / size[1]
        for reprojected in both:
            reprojected.aim(last.camera.with_aspect(aspect), size)
            reprojected.store(device, result.depth, direction)
        result = renderer.render(frame.camera, frame.seconds)
        for reprojected in both:
            reprojected.aim(frame.camera.with_aspect(aspect), size)
            with reprojected.render_pass(device, direction):
                pass
            depths.append(reprojected.read())
    finally:
        for reprojected in both:
            reprojected.destroy()
    moved, filled = depths
    return ReprojectedDepths(_reduce(result.depth.read(), direction), moved, filled, FAR[direction])


def _reduce(depths: Floats, direction: Depth) -> NDArray[np.float32]:
    """The farthest of each 4 × 4 depths (h, w); the last ones may have fewer."""
    farthest = np.minimum if direction is Depth.REVERSED else np.maximum
    rows, columns = (np.arange(0, length, SCALE) for length in depths.shape)
    return np.asarray(farthest.reduceat(farthest.reduceat(depths, rows, axis=0), columns, axis=1), np.float32)
