"""Two pictures made into one, pixel by pixel: bits are chosen from both, or the colours of both are mixed.

Pixels are words of four bytes that kernels read from buffers, so that no texture is sampled and no target blended.
`MixColors` decodes colours by a table of the 256 levels, and encodes them by a table of the level that is nearest to
each of 8,192 steps of light. Where levels are nearest to each other, in the dark, a step is 0.4 of them. So a mixed
colour is at most one level from that of exact arithmetic, and a grey keeps its level.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, Final

import numpy as np

import rhi.shading as sl
from renderer.stereo.outputs import ANAGLYPHS
from renderer.stereo.words import Words, find_pitch
from renderer.visibility.repeated import RepeatedCommands, copy
from rhi import Device, Encoder, Texture, from_srgb, to_srgb

_GROUP: Final = 64
_STEPS: Final = 8192

_RED: Final = 0xFF0000FF  # the first byte, and alpha
_CHOICES: Final = {"color": (_RED, _RED), "interlaced": (0xFFFFFFFF, 0)}
"""The outputs that only choose bits of both pictures: those of the left one's pixels in even and in odd rows."""

MIXED: Final = frozenset({*ANAGLYPHS, *_CHOICES})
"""The outputs whose image is made pixel by pixel."""


class Mixture(sl.Struct):
    """The way in which two pictures of `size`, of rows that are `pitch` pixels apart, are mixed: the bits of each pixel
    that are the left one's, in even and in odd rows; or the matrices of both."""

    size: sl.ivec2
    pitch: int
    even: sl.uint
    odd: sl.uint
    left: sl.mat3
    right: sl.mat3


class Mixing(sl.Shader):
    """Makes one pixel of both pictures' at each place, in place of the right one's."""

    work_group = (_GROUP,)
    mixture: sl.Uniform[Mixture]
    left: sl.Storage[sl.uint]
    right: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        x = sl.global_id().x
        y = sl.global_id().y
        if x < self.mixture.size.x:
            i = y * self.mixture.pitch + x
            self.right[i] = self.mix(self.left[i], self.right[i], y)

    def mix(self, left: sl.uint, right: sl.uint, row: int) -> sl.uint:
        """Return the pixel of two in a row."""
        return right


class ChooseBits(Mixing):
    """Takes some bits of each pixel from one picture, and the others from a second one."""

    def mix(self, left: sl.uint, right: sl.uint, row: int) -> sl.uint:
        chosen = self.mixture.odd if row % 2 == 1 else self.mixture.even
        return (left & chosen) | (right & ~chosen)


class MixColors(Mixing):
    """Mixes the colours of two pictures in linear light."""

    light: sl.Storage[float]
    levels: sl.Storage[sl.uint]

    def mix(self, left: sl.uint, right: sl.uint, row: int) -> sl.uint:
        color = self.mixture.left @ self.decode(left) + self.mixture.right @ self.decode(right)
        step = sl.clamp(color * float(_STEPS - 1) + 0.5, 0.5, float(_STEPS) - 0.5)
        red = self.levels[int(step.x)]
        green = self.levels[int(step.y)]
        blue = self.levels[int(step.z)]
        return red | green << 8 | blue << 16 | sl.uint(0xFF000000)

    def decode(self, pixel: sl.uint) -> sl.vec3:
        red = int(pixel & sl.uint(255))
        green = int(pixel >> 8 & sl.uint(255))
        blue = int(pixel >> 16 & sl.uint(255))
        return sl.vec3(self.light[red], self.light[green], self.light[blue])


class Mixer:
    """Makes an image of two pictures, pixel by pixel."""

    def __init__(self, device: Device) -> None:
        zeros = np.zeros((3, 3))
        with ExitStack() as made:
            nothing = Mixture(size=(0, 0), pitch=0, even=0, odd=0, left=zeros, right=zeros)
            self._mixture = made.enter_context(device.uniform(nothing))
            decoded = from_srgb(np.arange(256) / 255.0)
            levels = 255.0 * to_srgb(np.arange(_STEPS) / (_STEPS - 1.0))
            self._light = made.enter_context(device.storage(float, decoded.astype(np.float32), label="light"))
            self._levels = made.enter_context(
                device.storage(sl.uint, np.round(levels).astype(np.uint32), label="levels")
            )
            self._left, self._right = Words(device, sl.uint), Words(device, sl.uint)
            made.callback(self._left.destroy)
            made.callback(self._right.destroy)
            self._commands = RepeatedCommands(device, "")
            self._device = device
            self._mixed: tuple[str, tuple[int, int]] | None = None  # what the mixture is of
            self._made = made.pop_all()

    def mix(self, output: str, left: Texture, right: Texture, image: Texture) -> None:
        """Write both pictures to `image`, as one of the `MIXED` outputs shows them."""
        size = image.size
        if self._mixed != (output, size):
            even, odd = _CHOICES.get(output, (0, 0))
            of_left, of_right = ANAGLYPHS.get(output, np.zeros((2, 3, 3)))
            pitch = find_pitch(self._device, size[0])
            self._mixture.write(Mixture(size=size, pitch=pitch, even=even, odd=odd, left=of_left, right=of_right))
            self._mixed = output, size
        given: dict[str, Any] = {
            "mixture": self._mixture,
            "left": self._left.fit(size),
            "right": self._right.fit(size),
        }
        shader: type[sl.Shader] = ChooseBits
        if output not in _CHOICES:
            shader = MixColors
            given |= {"light": self._light, "levels": self._levels}
        program: Any = self._device.program(shader)

        def issue(encoder: Encoder) -> None:
            copy(encoder, left, given["left"])
            copy(encoder, right, given["right"])
            encoder.dispatch(program, (-(-size[0] // _GROUP), size[1]), **given)
            copy(encoder, given["right"], image)

        self._commands.execute((program, left, right, image, *given.values()), issue)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._commands.forget()
        self._made.close()
