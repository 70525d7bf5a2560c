"""The features of the surfaces that a view shows: what a shader reads of materials, and light that glows.

Each set of features has its own shaders, which take long to build. So a renderer begins with all that its scene has,
and then nothing is built when the eye turns to what wasn't in view. When the view has shown fewer for a while, shaders
for these alone take their place.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Rows
from renderer.visibility.boxes.volumes import find_in_view

PATIENCE: Final = 60
"""The number of frames that show the same, fewer features before shaders for these alone are built."""
_STRIDE: Final = 10
"""While shaders have all features, only each frame of so many is looked at."""
_MOST_SETS: Final = 8
"""So many sets of features get shaders, at most."""
_MOST_ROWS: Final = 4096
"""A feature that more objects have counts as seen: looking for one of them would cost more than it saves."""


class SeenFeatures:
    """Finds the features, by their names in `Scene.find_featured`, that a view of a scene shows."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._version = -1
        self._rows: Mapping[str, Rows] = {}
        self._witness: dict[str, int] = {}  # an object of each feature, the one seen last
        self._known: list[frozenset[str]] = [frozenset()]
        self._chosen: frozenset[str] = frozenset()
        self._last: frozenset[str] | None = None
        self._frame = self._changed = 0

    def _refresh(self) -> None:
        """Find the objects of each feature again where materials have changed."""
        if self._version == self._scene.material_version:
            return
        self._version = self._scene.material_version
        rows = {name: rows for name, rows in self._scene.find_featured().items() if len(rows)}
        if rows.keys() != self._rows.keys() or not all(np.array_equal(rows[name], self._rows[name]) for name in rows):
            self._rows, self._witness = rows, {name: int(some[0]) for name, some in rows.items()}
            self._chosen = frozenset(rows)
            self._known, self._last, self._frame = [self._chosen], None, 0

    def find(self, camera: Camera) -> frozenset[str]:
        """Return the features of the objects whose bounds aren't outside the view."""
        scene = self._scene
        self._refresh()
        asked = np.fromiter(self._witness.values(), np.int64)
        in_view = set(find_in_view(scene, camera, np.unique(asked)).tolist())
        unseen = []
        for name, row in self._witness.items():
            if row in in_view or len(self._rows[name]) > _MOST_ROWS:
                continue
            found = find_in_view(scene, camera, self._rows[name])
            if len(found):
                self._witness[name] = int(found[0])
            else:
                unseen.append(name)
        return frozenset(self._rows).difference(unseen)

    def settle(self, camera: Camera) -> frozenset[str]:
        """Return the features that a frame's shaders have: those of `find`, or for a while more of them."""
        self._refresh()
        self._frame += 1
        if self._chosen == self._known[0] and self._frame % _STRIDE != 1:
            return self._chosen
        seen = self.find(camera)
        if seen != self._last:
            self._last, self._changed = seen, self._frame
        if seen not in self._known and self._frame - self._changed >= PATIENCE and len(self._known) < _MOST_SETS:
            self._known.append(seen)
        self._chosen = min((known for known in self._known if known >= seen), key=len)
        return self._chosen
