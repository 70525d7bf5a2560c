"""The protocol of techniques."""

from __future__ import annotations

from typing import Protocol

from renderer.frame import Frame
from rhi import Device


class Technique(Protocol):
    """A way to draw a frame: its passes and their shaders.

    A technique keeps no state of a scene or a device. So one object can serve several renderers, and can be exchanged
    between two frames.
    """

    @property
    def name(self) -> str:
        """The name on the command line."""
        ...

    def render(self, device: Device, frame: Frame) -> None:
        """Draw the frame to `frame.targets`, whose contents are undefined. Draw the scene with
        `frame.draw_visible`."""
        ...
