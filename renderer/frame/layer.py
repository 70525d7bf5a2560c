"""The protocol of layers: what is drawn over a frame that a technique has finished, such as a debug
overlay."""

from __future__ import annotations

from typing import Protocol

from renderer.frame.frame import Frame
from rhi import Device


class Layer(Protocol):
    """Draws over a finished frame, before it is presented."""

    def render(self, device: Device, frame: Frame) -> None:
        """Draw to `frame.targets`, which hold the finished frame and its depth."""
        ...

    def destroy(self) -> None:
        """Destroy the layer's resources on the device."""
        ...


class SceneLayer:
    """Base of layers that belong to the scene: they draw to the resource `image` with depth, before the
    image is scaled to the output's size."""
