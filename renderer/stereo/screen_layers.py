"""Layers on the screen over the image of two eyes: drawn once, for both.

They have no parallax, so both eyes see the same of them. Where the image of both eyes has each pixel once, and shows
greys and colours as they are, they are drawn onto it. Otherwise they are drawn to a texture of an eye's size, which is
drawn over both halves of the image, or in the colours that an anaglyph gives to what both eyes see.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

import rhi.shading as sl
from renderer.frame import IMAGE_FORMAT, Frame, ScreenLayer
from renderer.frame.mirrors import MirroredValue
from renderer.scene.arrays import Floats
from renderer.stereo.mixing import MIXED_OUTPUTS
from renderer.stereo.outputs import ANAGLYPHS
from renderer.techniques.parts.full_screen import make_triangle
from rhi import BlendFunction, CullMode, DepthTest, DepthWrite, Device, Texture

_TRANSPARENT: Final = (0.0, 0.0, 0.0, 0.0)


class InterfaceConstants(sl.Struct):
    """The colours in which layers are shown, and the `size` of the texture that they were drawn to."""

    colors: sl.mat3
    size: sl.ivec2


class InterfaceShader(sl.FullScreen):
    """Draws layers over an image, again from the texture's right and lower edges on."""

    precision = sl.Precision.FAST
    constants: sl.Uniform[InterfaceConstants]
    interface: sl.Texture2D

    def fragment(self) -> sl.vec4:
        texel = self.interface.load(sl.ivec2(sl.fragment_coordinate().xy) % self.constants.size)
        return sl.vec4(self.constants.colors @ texel.rgb, texel.a)


class ScreenLayers:
    """Draws layers over the image of two eyes."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._triangle = make_triangle(device)
        self._constants = MirroredValue(device, InterfaceConstants(colors=np.eye(3), size=(0, 0)))
        self._texture: Texture | None = None

    def draw(self, layers: Sequence[ScreenLayer], output: str, left: Frame, image: Texture) -> None:
        """Draw layers over the image of both eyes."""
        device, colors = self._device, compute_interface_colors(output)
        if output in MIXED_OUTPUTS and np.allclose(colors, np.eye(3)):
            for layer in layers:
                layer.draw(device, left, image)
            return
        texture, program = self._fit(left.targets.image.size), self._device.program(InterfaceShader)
        for number, layer in enumerate(layers):
            layer.draw(device, left, texture, None if number else _TRANSPARENT)
        states = (CullMode.NONE, DepthTest.OFF, DepthWrite.OFF, BlendFunction.PREMULTIPLIED)
        self._constants.write(InterfaceConstants(colors=colors, size=texture.size))
        bindings: dict[str, Any] = {"constants": self._constants.buffer, "interface": texture}
        with device.render_pass(image), device.states(*states):
            device.draw(program, self._triangle, **bindings)

    def _fit(self, size: tuple[int, int]) -> Texture:
        """The texture for layers of this size, created when it is first needed."""
        if self._texture is None or self._texture.size != size:
            self._destroy_texture()
            self._texture = self._device.texture(size, IMAGE_FORMAT, label="interface")
        return self._texture

    def _destroy_texture(self) -> None:
        if self._texture is not None:
            self._texture.destroy()
            self._texture = None

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._triangle.destroy()
        self._constants.destroy()
        self._destroy_texture()


def compute_interface_colors(output: str) -> Floats:
    """The matrix (3, 3) from a colour that both eyes see to that of the image which shows both."""
    matrices = ANAGLYPHS.get(output)
    return np.eye(3) if matrices is None else np.asarray(matrices.sum(axis=0))
