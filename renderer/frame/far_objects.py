"""Objects that are far from both eyes of a frame, drawn once.

Beyond a distance all surfaces have nearly the same parallax, a whole number of pixels. So the left eye's pass draws
what is far first, its targets are copied to the right eye's, that many pixels farther right, and each eye draws what
is near over it. The depth test finds what hides what, as in any pass. An object is far if its whole box is.

The columns at the left edge of the right eye's image aren't in the left one's. There the right eye draws what is far
itself: only the objects that reach into these columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from renderer.frame.targets import Targets
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats
from renderer.visibility.command_cache import copy
from rhi import Encoder, Region, Scissor, Texture


@dataclass(eq=False, slots=True)
class FarObjects:
    """The far objects of a frame, and the way in which its eyes share them.

    Attributes:
        distance: along the view, in metres, from which on objects are far.
        shift: the pixels by which they are farther right in the right eye's image.
        right: the right eye.
        left_targets, right_targets: those of both eyes.
        are_copied: whether the left eye's pass has drawn any of them, and copied them to the right one's targets.
    """

    distance: float
    shift: int
    right: Camera
    left_targets: Targets
    right_targets: Targets
    are_copied: bool = False

    def is_right(self, depth: Texture) -> bool:
        """True if this is the right eye's depth."""
        return depth is self.right_targets.depth

    def select_far(self, scene: Scene, object_indices: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell which of these objects (k,) are far, as a mask (k,)."""
        forward = self.right.forward
        nearest = _compute_least(scene, object_indices, forward) - float(forward @ self.right.position)
        return np.asarray(nearest >= self.distance)

    def select_edge(self, scene: Scene, object_indices: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell which of these far objects (k,) may reach into the columns that the left eye doesn't see, as a mask
        (k,)."""
        if not self.shift:
            return np.zeros(len(object_indices), np.bool_)
        edge = 2.0 * self.shift / self.right_targets.size[0] - 1.0
        matrix = self.right.projection.matrix
        row = matrix[0] - edge * matrix[3]
        normal = row[:3] @ self.right.rotation
        offset = float(row[3]) - float(normal @ self.right.position)
        return np.asarray(_compute_least(scene, object_indices, normal) + offset <= 0.0)

    @property
    def edge(self) -> Scissor:
        """The columns that the left eye doesn't see."""
        return Scissor(0, 0, self.shift, self.right_targets.size[1])

    def list_right(self, textures: Sequence[Texture]) -> list[Texture]:
        """The right eye's textures for these of the left one."""
        return [self.right_targets[self.left_targets.name(texture)] for texture in textures]

    def copy(self, encoder: Encoder, textures: Sequence[Texture]) -> None:
        """Copy the left eye's textures to those of the right one, shifted."""
        width, height = self.right_targets.size
        if self.shift < width:
            region = Region(0, 0, width - self.shift, height)
            for source, target in zip(textures, self.list_right(textures), strict=True):
                copy(encoder, source, target, region=region, x=self.shift)


def _compute_least(scene: Scene, object_indices: NDArray[np.int64], normal: Floats) -> Floats:
    """The least product of `normal` (3,) with any point of the boxes of objects (k,)."""
    objects = scene.objects
    x, y, z = normal.tolist()
    least: Floats = (objects.lower if x > 0.0 else objects.upper)[:, 0][object_indices] * x
    least += (objects.lower if y > 0.0 else objects.upper)[:, 1][object_indices] * y
    least += (objects.lower if z > 0.0 else objects.upper)[:, 2][object_indices] * z
    return least
