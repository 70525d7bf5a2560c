"""The second eye of a frame, and the image in which both are shown.

A frame of two eyes is the frame of the left one, then that of the right one, each with its view and its targets, and
all else shared: the simulation, the transforms, the light lists, the needs and the plan, and the objects found where
only a frustum decides. Passes know nothing of this. So every technique works, and each eye's picture is that of its
camera, bit for bit.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from typing import Final

import numpy as np

from renderer import rules
from renderer.frame import IMAGE_FORMAT, Frame, Plan, Targets, View, make_plan
from renderer.frame.resources import MirroredValue
from renderer.scene import StereoRig
from renderer.shaders.pixels import FullScreen
from renderer.stereo.outputs import ANAGLYPHS, check_output, fit_picture
from renderer.stereo.reprojection import REPROJECTION
from renderer.techniques.full_screen import draw_full_screen
from rhi import Device, Region, Texture, refuse
from rhi.shading import Struct, Texture2D, Uniform, fragment_coordinate, ivec2, mat3, saturate, vec4

__rhi_internal__ = True


@dataclass(frozen=True, slots=True)
class Stereo:
    """How a renderer draws two eyes and shows them.

    Attributes:
        rig: where the eyes are. output: one of `OUTPUTS`.
        is_swapped: whether the left eye's picture is shown to the right eye and the other way round.
        is_reprojected: whether the right eye's picture is made from the left one's instead of being drawn.
    """

    rig: StereoRig
    output: str = "dubois"
    is_swapped: bool = False
    is_reprojected: bool = False

    def __post_init__(self) -> None:
        check_output(self.output, "Stereo(output=...)")
        if self.is_reprojected and self.rig.is_toed_in:
            refuse(rules.BAD_STEREO, "Stereo(is_reprojected=...)", True, "eyes that aren't toed in")


class AnaglyphWeights(Struct):
    """The matrices of both pictures."""

    left: mat3
    right: mat3


class Anaglyph(FullScreen):
    """Mixes the colours of two pictures."""

    left: Texture2D
    right: Texture2D
    weights: Uniform[AnaglyphWeights]

    def fragment(self) -> vec4:
        place = ivec2(fragment_coordinate().xy)
        color = self.weights.left @ self.left.load(place).rgb + self.weights.right @ self.right.load(place).rgb
        return vec4(saturate(color), 1.0)


class Interlaced(FullScreen):
    """Takes even rows from the left picture and odd ones from the right one."""

    left: Texture2D
    right: Texture2D

    def fragment(self) -> vec4:
        place = ivec2(fragment_coordinate().xy)
        return self.right.load(place) if place.y % 2 == 1 else self.left.load(place)


PICTURE: Final = make_plan(REPROJECTION, ("image",))
"""The plan of a right eye's frame whose picture is reprojected."""
PICTURE_AND_DEPTH: Final = make_plan(REPROJECTION)
"""The same with depth, for layers."""


class EyePair:
    """The right eye beside the view of the left one, and the image of both.

    Attributes:
        stereo: how the eyes are shown; it may be exchanged for one whose pictures have the same size.
        view, targets: those of the right eye. image: what is shown.
    """

    def __init__(self, device: Device, stereo: Stereo, size: tuple[int, int], left: View) -> None:
        self.stereo = stereo
        with ExitStack() as made:
            self.image: Texture = made.enter_context(device.texture(size, IMAGE_FORMAT, label="both eyes"))
            self.targets = Targets(device, fit_picture(stereo.output, size))
            made.callback(self.targets.destroy)
            self.view = View(device, "right eye", left.visibility, left.batch)
            made.callback(self.view.destroy)
            zeros = np.zeros((3, 3))
            self._weights = MirroredValue(device, AnaglyphWeights(left=zeros, right=zeros))
            made.callback(self._weights.destroy)
            self._made = made.pop_all()

    def plan(self, *, has_layers: bool) -> Plan[Frame] | None:
        """Return the plan of the right eye's frame, None if it is that of the left one."""
        if not self.stereo.is_reprojected:
            return None
        return PICTURE_AND_DEPTH if has_layers else PICTURE

    def show(self, left: Frame, right: Frame) -> Texture:
        """Draw the pictures of both frames to `image`, and return it."""
        output, image = self.stereo.output, self.image
        first, second = left.targets.image, right.targets.image
        if self.stereo.is_swapped:
            first, second = second, first
        width, height = image.size
        pictures = {"left": first, "right": second}
        if output in ANAGLYPHS:
            of_left, of_right = ANAGLYPHS[output]
            self._weights.write(AnaglyphWeights(left=of_left, right=of_right))
            draw_full_screen(left, Anaglyph, image, pictures | {"weights": self._weights.buffer})
        elif output == "interlaced":
            draw_full_screen(left, Interlaced, image, pictures)
        else:
            x, y = (first.size[0], 0) if output == "side_by_side" else (0, first.size[1])
            first.copy_to(image)
            if x < width and y < height:
                second.copy_to(image, region=Region(0, 0, width - x, height - y), x=x, y=y)
        return image

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._made.close()
