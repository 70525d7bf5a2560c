"""What a technique is."""

from __future__ import annotations

from typing import Protocol

from renderer.frame import Frame
from rhi import Device


class Technique(Protocol):
    """A way to draw a frame: which passes, with which shaders.

    It keeps no state of a scene or a device: one object can serve several renderers, and be exchanged between
    two frames.
    """

    @property
    def name(self) -> str:
        """What the command line calls it."""
        ...

    def render(self, device: Device, frame: Frame) -> None:
        """Draw what `frame.draw_visible` finds into `frame.targets`, which hold nothing of use before."""
        ...
