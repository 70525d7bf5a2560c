"""The protocol of layers: what is drawn over a frame that a technique has finished, such as a debug
overlay."""

from __future__ import annotations

from typing import Protocol

from renderer.frame.frame import Frame
from rhi import Device, Texture

ClearColor = tuple[float, float, float, float]


class Layer(Protocol):
    """Draws over a finished frame, before it is presented."""

    def render(self, device: Device, frame: Frame) -> None:
        """Draw to `frame.targets`, which hold the finished frame and its depth."""
        ...

    def destroy(self) -> None:
        """Destroy the layer's resources on the device."""
        ...


class ScreenLayer:
    """Base of layers that look the same to each eye, such as an interface: they are drawn after all other layers, and
    only once for two eyes."""

    def render(self, device: Device, frame: Frame) -> None:
        """Draw to the frame's image."""
        self.draw(device, frame, frame.targets.image)

    def draw(self, device: Device, frame: Frame, image: Texture, clear: ClearColor | None = None) -> None:
        """Draw to `image`, premultiplied, which is cleared before unless `clear` is None. With two eyes, `frame` is the
        left one's."""
        raise NotImplementedError

    def destroy(self) -> None:
        """Destroy the layer's resources on the device."""


class SceneLayer:
    """Base of layers that belong to the scene: they draw to the resource `image` with depth, before the
    image is scaled to the output's size."""
