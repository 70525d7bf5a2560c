"""The features of the surfaces that a view shows: what a shader reads of materials, and bright light.

Each set of features has its own shaders, which take long to build. So a renderer begins with all that its
scene has, and then nothing is built when the eye turns to what wasn't in view. When the view has shown fewer
for a while, shaders for these alone take their place. A view without any object has no features at once: bloom
and shadows of the sun would take passes there, and no shader draws a surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Indices
from renderer.visibility.boxes.volumes import select_in_view

PATIENCE: Final = 60
"""The number of frames that show the same, fewer features before shaders for these alone are built."""
_STRIDE: Final = 10
"""While shaders have all features, only each frame of so many is looked at."""
_MAX_SETS: Final = 8
"""So many sets of features get shaders, at most."""
_MAX_OBJECTS: Final = 4096
"""A feature that more objects have counts as seen: looking for one of them would cost more than it saves."""

_NO_FEATURES: Final = frozenset[str]()


class VisibleFeatures:
    """Finds the features of `Scene.list_by_feature` that a view of a scene shows.

    Attributes:
        shows_objects: whether there may be an object in the view of the last `choose_shader_features`.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.shows_objects = True
        self._object_in_view = 0  # the one seen last
        self._version = -1
        self._object_indices: Mapping[str, Indices] = {}
        self._witness: dict[str, int] = {}  # an object of each feature, the one seen last
        self._feature_sets: list[frozenset[str]] = [frozenset()]
        self._shader_features: frozenset[str] = frozenset()
        self._last: frozenset[str] | None = None
        self._frame = self._changed = 0

    def _refresh(self) -> None:
        """List the objects of each feature again if materials have changed."""
        if self._version == self._scene.material_version:
            return
        self._version = self._scene.material_version
        object_indices = {
            name: object_indices
            for name, object_indices in self._scene.list_by_feature().items()
            if len(object_indices)
        }
        if object_indices.keys() != self._object_indices.keys() or not all(
            np.array_equal(object_indices[name], self._object_indices[name]) for name in object_indices
        ):
            self._object_indices = object_indices
            self._witness = {name: int(indices[0]) for name, indices in object_indices.items()}
            self._shader_features = frozenset(object_indices)
            self._feature_sets = [self._shader_features]
            self._last = None
            self._frame = 0

    def collect(self, camera: Camera) -> frozenset[str]:
        """The features of the objects in view."""
        self._refresh()
        return self._collect(camera)

    def _collect(self, camera: Camera) -> frozenset[str]:
        scene = self._scene
        witnesses = np.array(sorted({*self._witness.values()}), np.int64)
        in_view = set(select_in_view(scene, camera, witnesses).tolist())
        unseen = []
        for name, object_index in self._witness.items():
            if object_index in in_view or len(self._object_indices[name]) > _MAX_OBJECTS:
                continue
            visible = select_in_view(scene, camera, self._object_indices[name])
            if len(visible):
                self._witness[name] = int(visible[0])
            else:
                unseen.append(name)
        return frozenset(self._object_indices).difference(unseen)

    def reconsider(self) -> None:
        """Take back a `choose_shader_features`, which the same frame calls again."""
        self._frame -= 1

    def _look_for_objects(self, camera: Camera) -> bool:
        """Return whether any object is in view."""
        witness = np.array([self._object_in_view] if len(self._scene.objects) else [], np.int64)
        if len(select_in_view(self._scene, camera, witness)):
            return True
        visible = select_in_view(self._scene, camera, np.arange(len(self._scene.objects)))
        if len(visible):
            self._object_in_view = int(visible[0])
        return bool(len(visible))

    def choose_shader_features(self, camera: Camera, *, is_unchanged: bool = False) -> frozenset[str]:
        """The features that a frame's shaders have: those of `collect`, or for a while more.

        Args:
            is_unchanged: whether the scene's materials are those of the last call.
        """
        if not is_unchanged:
            self._refresh()
        self._frame += 1
        if not self.shows_objects or self._frame % _STRIDE == 1:
            self.shows_objects = self._look_for_objects(camera)
        if not self.shows_objects:
            return _NO_FEATURES
        if self._shader_features == self._feature_sets[0] and self._frame % _STRIDE != 1:
            return self._shader_features
        seen = self._collect(camera)
        if seen != self._last:
            self._last, self._changed = seen, self._frame
        if (
            seen not in self._feature_sets
            and self._frame - self._changed >= PATIENCE
            and len(self._feature_sets) < _MAX_SETS
        ):
            self._feature_sets.append(seen)
        fitting = [features for features in self._feature_sets if features >= seen]
        self._shader_features = min(fitting, key=len)
        return self._shader_features
