"""The second eye of a frame, and the image in which both are shown.

A frame of two eyes is the frame of the left one, then that of the right one, each with its view and its targets, and
all else shared: the simulation, the transforms, the light lists, the needs and the plan, and the objects found where
only a frustum decides. Passes know nothing of this. So every technique works, and each eye's picture is that of its
camera, bit for bit.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from renderer.frame import IMAGE_FORMAT, Frame, Targets, View
from renderer.frame.resources import MirroredValue
from renderer.scene import StereoRig
from renderer.shaders.pixels import FullScreen
from renderer.stereo.outputs import ANAGLYPHS, check_output, fit_picture
from renderer.techniques.full_screen import draw_full_screen
from rhi import Device, Region, Texture
from rhi.shading import Struct, Texture2D, Uniform, fragment_coordinate, ivec2, mat3, saturate, vec4

__rhi_internal__ = True


@dataclass(frozen=True, slots=True)
class Stereo:
    """How a renderer draws two eyes and shows them.

    Attributes:
        rig: where the eyes are. output: one of `OUTPUTS`.
        is_swapped: whether the left eye's picture is shown to the right eye and the other way round.
    """

    rig: StereoRig
    output: str = "dubois"
    is_swapped: bool = False

    def __post_init__(self) -> None:
        check_output(self.output, "Stereo(output=...)")


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
