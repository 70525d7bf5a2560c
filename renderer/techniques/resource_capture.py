"""A technique that reads one resource of its plan back while the frame is drawn, to show it as an image."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from numpy.typing import NDArray

from renderer import rules
from renderer.frame import Frame, FrameEffects, FramePass, Target
from renderer.techniques.technique import Technique, WrappedTechnique


class ResourceCapture(WrappedTechnique):
    """A technique with one pass more, which reads a resource of the plan back before later passes draw
    over it. Waits for the device.

    Attributes:
        texels: the resource (height, width) or (height, width, channels) of the last frame; None before the
            first.
    """

    def __init__(self, technique: Technique, resource: str) -> None:
        """`resource` is a name of the plan, such as `surface` of a geometry buffer."""
        super().__init__(technique)
        self.texels: NDArray[Any] | None = None
        self._resource = resource

    def declare(self, effects: FrameEffects) -> Sequence[FramePass[Frame]]:
        """The technique's passes, and one that reads the resource.

        Raises:
            ValidationError: no texture of the plan has this name (`plan-unknown-resource`).
        """
        passes = self._technique.declare(effects)
        names = list_resources(passes)
        if self._resource not in names:
            rules.refuse_name(
                rules.UNKNOWN_RESOURCE, f"ResourceCapture(resource={self._resource!r})", self._resource, names
            )
        read = FramePass(
            "read back", self._read, "was asked for", reads=(self._resource,), has_side_effects=True
        )
        return *passes, read

    def _read(self, frame: Frame) -> None:
        self.texels = frame.targets[self._resource].read()


def list_resources(passes: Iterable[FramePass[Frame]]) -> list[str]:
    """Names of the textures of a plan with one sample per pixel, in the order in which passes write them."""
    names: list[str] = []
    for frame_pass in passes:
        names += [
            target.name for target in frame_pass.writes if isinstance(target, Target) and target.samples == 1
        ]
        names += [new for old, new in frame_pass.changes.items() if old in names]
    return names
