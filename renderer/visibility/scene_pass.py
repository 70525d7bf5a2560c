"""What an algorithm that runs on the device gets from a renderer: the scene's arrays, and the pass it is drawn in.

An algorithm of the CPU needs no more than a function that draws rows. One of the device lists draws itself, works
between them outside of passes, and looks at the depth that is there; so it opens and closes the pass as it needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.shaders import MeshPart, Object, ObjectPosition, View
from renderer.visibility.algorithm import DrawObjects
from rhi import IndirectDraws, Texture, refuse
from rhi.shading import StorageRange, UniformRange

__rhi_internal__ = True


@dataclass(frozen=True, slots=True)
class SceneArrays:
    """A scene on a device, as its shaders read it.

    An object is a row of `objects` and `places`, and the base instance of its draw; a mesh is a row of `parts`.
    """

    view: UniformRange[View]
    objects: StorageRange[Object]
    places: StorageRange[ObjectPosition]
    parts: StorageRange[MeshPart]


class DeviceList(Protocol):
    """Draws that the device has listed.

    Attributes:
        generation: how often it was made; another number is another list.
    """

    generation: int

    def arguments(self, *, mirrored: bool) -> IndirectDraws:
        """Those of one winding."""
        ...

    def read_rows(self) -> NDArray[np.int64]:
        """The objects' rows, once the list is made; waits for the device."""
        ...


class ScenePass(Protocol):
    """A pass in which a technique draws the scene."""

    @property
    def arrays(self) -> SceneArrays:
        """The scene, up to date."""
        ...

    @property
    def depth(self) -> Texture:
        """What is drawn to, in depth; to be read, or used in another pass, while this one is closed."""
        ...

    def close(self) -> None:
        """End the pass, if it is open; what was drawn is kept. The next draw opens it again."""
        ...

    def __call__(self, rows: NDArray[np.int64]) -> None:
        """Draw the objects with these rows, now."""
        ...

    def draw_list(self, draws: DeviceList) -> None:
        """Draw what the device has listed."""
        ...


def as_scene_pass(draw: DrawObjects, call: str) -> ScenePass:
    """What a renderer gives an algorithm to draw with, as what it is; refuses a mere function."""
    if not hasattr(draw, "draw_list"):
        refuse(rules.NO_SCENE_PASS, call, f"{draw!r}", "what `Renderer.render` draws with")
    return cast("ScenePass", draw)
