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
from renderer.stereo.words import Words
from renderer.techniques.full_screen import draw_full_screen
from rhi import Device, Region, Texture, refuse
from rhi.shading import (
    Shader,
    Storage,
    StorageRW,
    Struct,
    Texture2D,
    Uniform,
    fragment_coordinate,
    global_id,
    ivec2,
    mat3,
    saturate,
    uint,
    vec4,
)

__rhi_internal__ = True

_GROUP: Final = 256


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


class Choice(Struct):
    """The bits of each pixel that are the left picture's, in even and in odd rows. `count` is the number of pixels,
    `width` that of a row."""

    even: uint
    odd: uint
    count: int
    width: int


class ChooseBits(Shader):
    """Takes some bits of each pixel from one picture, and the others from a second one."""

    work_group = (_GROUP,)
    choice: Uniform[Choice]
    left: Storage[uint]
    right: StorageRW[uint]

    def compute(self) -> None:
        i = global_id().x
        if i < self.choice.count:
            chosen = self.choice.odd if i // self.choice.width % 2 == 1 else self.choice.even
            self.right[i] = (self.left[i] & chosen) | (self.right[i] & ~chosen)


_CHOICES: Final = {"color": (0xFF0000FF, 0xFF0000FF), "interlaced": (0xFFFFFFFF, 0)}
"""The outputs that only choose bits: of the left picture's pixels in even and in odd rows. Red is the first byte."""


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
        self._device = device
        with ExitStack() as made:
            self.image: Texture = made.enter_context(device.texture(size, IMAGE_FORMAT, label="both eyes"))
            self.targets = Targets(device, fit_picture(stereo.output, size))
            made.callback(self.targets.destroy)
            self.view = View(device, "right eye", left.visibility, left.batch)
            made.callback(self.view.destroy)
            zeros = np.zeros((3, 3))
            self._weights = MirroredValue(device, AnaglyphWeights(left=zeros, right=zeros))
            made.callback(self._weights.destroy)
            self._choice = MirroredValue(device, Choice(even=0, odd=0, count=0, width=1))
            made.callback(self._choice.destroy)
            self._words = Words(device, uint), Words(device, uint)
            for words in self._words:
                made.callback(words.destroy)
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
        if output in _CHOICES:
            self._choose(first, second, *_CHOICES[output])
        elif output in ANAGLYPHS:
            of_left, of_right = ANAGLYPHS[output]
            self._weights.write(AnaglyphWeights(left=of_left, right=of_right))
            pictures = {"left": first, "right": second, "weights": self._weights.buffer}
            draw_full_screen(left, Anaglyph, image, pictures)
        else:
            x, y = (first.size[0], 0) if output == "side_by_side" else (0, first.size[1])
            first.copy_to(image)
            if x < width and y < height:
                second.copy_to(image, region=Region(0, 0, width - x, height - y), x=x, y=y)
        return image

    def _choose(self, first: Texture, second: Texture, even: int, odd: int) -> None:
        """Draw the bits of two pictures: pixels are four bytes, of which no colour is decoded."""
        size, device = self.image.size, self._device
        count = size[0] * size[1]
        left, right = (words.fit(size) for words in self._words)
        first.copy_to_buffer(left)
        second.copy_to_buffer(right)
        self._choice.write(Choice(even=even, odd=odd, count=count, width=size[0]))
        program = device.program(ChooseBits)
        device.dispatch(program, -(-count // _GROUP), choice=self._choice.buffer, left=left, right=right)
        self.image.copy_from_buffer(right)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._made.close()
