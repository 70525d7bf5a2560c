"""The protocol of techniques."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from renderer.frame import Frame, FrameEffects, FramePass


class Technique(Protocol):
    """A way to draw a frame: its passes and their shaders.

    A technique keeps no state of a scene or a device. So one object can serve several renderers, and can be
    exchanged between two frames.
    """

    @property
    def name(self) -> str:
        """The name on the command line."""
        ...

    def declare(self, effects: FrameEffects) -> Sequence[FramePass[Frame]]:
        """The passes of a frame with these effects.

        They write the resources `image` and `depth`, and draw the scene with `Frame.draw_visible`. The result
        is cached while `effects.key` stays the same, so it depends on nothing else; passes find all else in
        their `Frame`.
        """
        ...


class WrappedTechnique:
    """Base of techniques that add passes to those of another one."""

    def __init__(self, technique: Technique) -> None:
        self._technique = technique

    @property
    def name(self) -> str:
        """The name of the technique that draws the image."""
        return self._technique.name
