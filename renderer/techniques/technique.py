"""The protocol of techniques."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from renderer.frame import Frame, Needs, Pass


class Technique(Protocol):
    """A way to draw a frame: its passes and their shaders.

    A technique keeps no state of a scene or a device. So one object can serve several renderers, and can be exchanged
    between two frames.
    """

    @property
    def name(self) -> str:
        """The name on the command line."""
        ...

    def declare(self, needs: Needs) -> Sequence[Pass[Frame]]:
        """Return the passes of a frame with these needs.

        They write the contents `image` and `depth`, and draw the scene with `Frame.draw_visible`. The result is kept
        while `needs.key` stays the same, so it depends on nothing else; passes find all else in their `Frame`.
        """
        ...


class WrappedTechnique:
    """The base of techniques that have the passes of another one, and more."""

    def __init__(self, technique: Technique) -> None:
        self._technique = technique

    @property
    def name(self) -> str:
        """The name of the technique that draws the image."""
        return self._technique.name
