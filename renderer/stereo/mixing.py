"""Combines two images into one, pixel by pixel: selects bits from both, or mixes their colours.

Pixels are words of four bytes that kernels read from buffers, so that no texture is sampled and no target
blended. `MixColors` decodes colours by a table of the 256 levels, and encodes them by a table of the level
that is nearest to each of 8,192 steps of light. Where levels are nearest to each other, in the dark, a step
is 0.4 of them. So a mixed colour is at most one level from that of exact arithmetic, and a grey keeps its
level.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, Final

import numpy as np

import rhi.shading as sl
from renderer.stereo.outputs import ANAGLYPHS
from renderer.stereo.pixel_buffer import PixelBuffer, row_pitch
from renderer.visibility.command_cache import CommandCache, copy
from rhi import Device, Encoder, Texture, from_srgb, to_srgb

_GROUP: Final = 64
_STEPS: Final = 8192

_RED: Final = 0xFF0000FF  # the first byte, and alpha
_BIT_MASKS: Final = {"color": (_RED, _RED), "interlaced": (0xFFFFFFFF, 0)}
"""The outputs that only choose bits of both images: those of the left one's pixels in even and in odd
rows."""

MIXED_OUTPUTS: Final = frozenset({*ANAGLYPHS, *_BIT_MASKS})
"""The outputs whose image is made pixel by pixel."""


class MixConstants(sl.Struct):
    """The way in which two images of `size`, of rows that are `pitch` pixels apart, are mixed: the bits of
    each pixel that are the left one's, in even and in odd rows; or the matrices of both."""

    size: sl.ivec2
    pitch: int
    even_mask: sl.uint
    odd_mask: sl.uint
    left: sl.mat3
    right: sl.mat3


class MixShader(sl.Shader):
    """Combines the pixels of both images, and writes the result over the right image."""

    work_group = (_GROUP,)
    constants: sl.Uniform[MixConstants]
    left: sl.Storage[sl.uint]
    right: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        x = sl.global_id().x
        y = sl.global_id().y
        if x < self.constants.size.x:
            i = y * self.constants.pitch + x
            self.right[i] = self.mix(self.left[i], self.right[i], y)

    def mix(self, left: sl.uint, right: sl.uint, row: int) -> sl.uint:
        """Return the combined pixel of two in this row of the image."""
        return right


class SelectBits(MixShader):
    """Takes some bits of each pixel from one image, and the others from a second one."""

    def mix(self, left: sl.uint, right: sl.uint, row: int) -> sl.uint:
        mask = self.constants.odd_mask if row % 2 == 1 else self.constants.even_mask
        return (left & mask) | (right & ~mask)


class MixColors(MixShader):
    """Mixes the colours of two images in linear light."""

    light: sl.Storage[float]
    levels: sl.Storage[sl.uint]

    def mix(self, left: sl.uint, right: sl.uint, row: int) -> sl.uint:
        color = self.constants.left @ self.decode(left) + self.constants.right @ self.decode(right)
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
    """Combines two images into one, pixel by pixel."""

    def __init__(self, device: Device) -> None:
        zeros = np.zeros((3, 3))
        with ExitStack() as created:
            nothing = MixConstants(size=(0, 0), pitch=0, even_mask=0, odd_mask=0, left=zeros, right=zeros)
            self._constants = created.enter_context(device.uniform(nothing))
            decoded = from_srgb(np.arange(256) / 255.0)
            levels = 255.0 * to_srgb(np.arange(_STEPS) / (_STEPS - 1.0))
            self._light = created.enter_context(
                device.storage(float, decoded.astype(np.float32), label="light")
            )
            self._levels = created.enter_context(
                device.storage(sl.uint, np.round(levels).astype(np.uint32), label="levels")
            )
            self._left, self._right = PixelBuffer(device, sl.uint), PixelBuffer(device, sl.uint)
            created.callback(self._left.destroy)
            created.callback(self._right.destroy)
            self._commands = CommandCache(device, "")
            self._device = device
            self._current: tuple[str, tuple[int, int]] | None = None  # what the mixture is of
            self._resources = created.pop_all()

    def mix(self, output: str, left: Texture, right: Texture, image: Texture) -> None:
        """Write both images to `image`, as one of the `MIXED_OUTPUTS` outputs shows them."""
        size = image.size
        if self._current != (output, size):
            even_mask, odd_mask = _BIT_MASKS.get(output, (0, 0))
            of_left, of_right = ANAGLYPHS.get(output, np.zeros((2, 3, 3)))
            pitch = row_pitch(self._device, size[0])
            self._constants.write(
                MixConstants(
                    size=size,
                    pitch=pitch,
                    even_mask=even_mask,
                    odd_mask=odd_mask,
                    left=of_left,
                    right=of_right,
                )
            )
            self._current = output, size
        bindings: dict[str, Any] = {
            "constants": self._constants,
            "left": self._left.fit(size),
            "right": self._right.fit(size),
        }
        shader: type[sl.Shader] = SelectBits
        if output not in _BIT_MASKS:
            shader = MixColors
            bindings |= {"light": self._light, "levels": self._levels}
        program: Any = self._device.program(shader)

        def issue(encoder: Encoder) -> None:
            copy(encoder, left, bindings["left"])
            copy(encoder, right, bindings["right"])
            encoder.dispatch(program, (-(-size[0] // _GROUP), size[1]), **bindings)
            copy(encoder, bindings["right"], image)

        self._commands.execute((program, left, right, image, *bindings.values()), issue)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._commands.forget()
        self._resources.close()
