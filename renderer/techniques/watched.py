"""A technique of which one buffer is read back while a frame is made, for pictures of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from numpy.typing import NDArray

from renderer import rules
from renderer.frame import Frame, Needs, Pass, Target
from renderer.techniques.technique import Technique, WrappedTechnique


class Watched(WrappedTechnique):
    """A technique whose passes are followed by one that reads contents of the plan, as the pass that writes them leaves
    them: a later pass may draw over them, and textures are shared. It waits for the device.

    Attributes:
        texels: the contents (height, width) or (height, width, channels) of the last frame; None before the first.
    """

    def __init__(self, technique: Technique, contents: str) -> None:
        """Choose contents by their name in the plan, such as `surface` of a geometry buffer."""
        super().__init__(technique)
        self.texels: NDArray[Any] | None = None
        self._contents = contents

    def declare(self, needs: Needs) -> Sequence[Pass[Frame]]:
        """Return the technique's passes, and one that reads the contents.

        Raises:
            ValidationError: no texture of the plan has these contents (`plan-unknown-contents`).
        """
        passes = self._technique.declare(needs)
        known = list_contents(passes)
        if self._contents not in known:
            rules.refuse_name(rules.UNKNOWN_CONTENTS, f"Watched(contents={self._contents!r})", self._contents, known)
        read = Pass("read back", self._read, "was asked for", reads=(self._contents,), has_side_effects=True)
        return *passes, read

    def _read(self, frame: Frame) -> None:
        self.texels = frame.targets[self._contents].read()


def list_contents(passes: Iterable[Pass[Frame]]) -> list[str]:
    """Return the names of the contents of textures with one sample per pixel, in the order in which passes write
    them."""
    known: list[str] = []
    for one in passes:
        known += [target.name for target in one.writes if isinstance(target, Target) and target.samples == 1]
        known += [new for old, new in one.changes.items() if old in known]
    return known
