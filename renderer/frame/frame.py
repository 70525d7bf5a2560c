"""The state of one frame that its passes are given."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from renderer.frame.needs import Effect, Needs
from renderer.frame.passes import Drawn, TechniquePass
from renderer.frame.resources import SceneResources
from renderer.frame.targets import Targets
from renderer.frame.tones import find_light
from renderer.frame.view import View
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Rows
from renderer.visibility import VisibilityAlgorithm, VisibilityStatistics
from rhi import Device, Program, Texture
from rhi.math import is_parallel
from rhi.shading import Precision, Shader


@dataclass(eq=False, slots=True)
class ViewRecord:
    """The record of a view in one frame: the objects drawn, and the cost of finding them."""

    drawn: Drawn
    statistics: VisibilityStatistics


@dataclass(eq=False, slots=True)
class Frame:
    """A frame, to be drawn once.

    Attributes:
        view: what the image is seen from. resources: the scene on the device, up to date for this view.
        targets: the textures that the passes draw to. needs: the effects that are needed.
        first: the frame of the left eye, drawn before, if this is the right eye's.
        precision: that of the shaders which are FAST by themselves.
    """

    device: Device
    view: View
    resources: SceneResources
    targets: Targets
    needs: Needs
    first: Frame | None = None
    precision: Precision = Precision.FAST
    _seen: dict[View, ViewRecord] = field(default_factory=dict)

    @property
    def camera(self) -> Camera:
        """The camera of the image; its projection gives the direction of depth."""
        return self.view.camera

    @property
    def image(self) -> Texture:
        """The texture that the technique draws to: the contents `needs.image`."""
        return self.targets[self.needs.image.name]

    @property
    def background(self) -> tuple[float, float, float, float]:
        """The value that `image` is cleared to, as a colour or as light."""
        color = self.resources.scene.background
        return (*find_light(color), 1.0) if Effect.GLOW in self.needs.effects else (*color, 1.0)

    @property
    def visibility(self) -> VisibilityAlgorithm:
        """The algorithm that decides which objects are in the image."""
        return self.view.visibility

    @property
    def drawn(self) -> Drawn:
        """The objects in the image, once they have been drawn."""
        seen = self._seen.get(self.view)
        return Drawn(self.resources) if seen is None else seen.drawn

    @property
    def statistics(self) -> VisibilityStatistics | None:
        """The cost of finding the objects in the image; None before they were drawn."""
        seen = self._seen.get(self.view)
        return None if seen is None else seen.statistics

    def program(self, shader: type[Shader]) -> Program[...]:
        """Return the program of a technique's shader, in the precision of the frame."""
        return self.device.program(with_precision(shader, self.precision))

    def draw_transparent(self, scene_pass: TechniquePass, view: View | None = None, *, in_order: bool = True) -> None:
        """Draw the transparent objects that a view sees, which `draw_visible` has found. If there are none, nothing is
        issued.

        Args:
            in_order: whether they are drawn back to front, by the distances of their boxes' centres. Otherwise it is in
                as few calls as there are groups.
        """
        view = view or self.view
        seen = self._seen.get(view)
        if seen is None or not len(rows := seen.drawn.transparent):
            return
        if in_order:
            rows = sort_back_to_front(self.resources.scene, view.camera, rows)
        else:
            rows = rows[np.argsort(self.resources.group[rows], kind="stable")]
        with scene_pass:
            scene_pass.draw_in_order(rows)

    def draw_visible(self, scene_pass: TechniquePass, view: View | None = None) -> None:
        """Draw what a view sees in a pass: the main view, unless another one is given.

        The first pass of a view finds the visible objects, in as many batches as its algorithm likes, which issues its
        own commands there. It must be the first to write the view's depth. Later passes draw the same objects again,
        and so does the right eye if the left one's were found by the frustum around both.
        """
        view = view or self.view
        seen = self._seen.get(view) or self._find_shared(view)
        with scene_pass:
            if seen is not None:
                seen.drawn.draw_again(scene_pass)
                return
            if not view.visibility.opens_pass:
                scene_pass.open()
            statistics = view.visibility.render(view.camera, scene_pass)
            if not scene_pass.was_opened:  # nothing was drawn: the targets are cleared all the same
                scene_pass.open()
        self._seen[view] = ViewRecord(scene_pass.drawn, statistics)

    def _find_shared(self, view: View) -> ViewRecord | None:
        """Return what the left eye has found for both, if it has: objects in the frustum around them."""
        if self.first is None or view is not self.view:
            return None
        seen = self.first._seen.get(self.first.view)
        if seen is None or not seen.statistics.by_frustum:
            return None
        self._seen[view] = seen
        return seen


@cache
def _make_exact(shader: Any) -> type[Shader]:
    return type(f"Exact{shader.__name__}", (shader,), {"__module__": __name__, "precision": Precision.EXACT})


def with_precision(shader: type[Shader], precision: Precision) -> type[Shader]:
    """Return a shader in another precision. One that asks for EXACT itself keeps it."""
    if precision is Precision.FAST or shader.precision is Precision.EXACT:
        return shader
    key: Any = shader
    return _make_exact(key)


def sort_back_to_front(scene: Scene, camera: Camera, rows: Rows) -> Rows:
    """Return objects in the order of the distances of their boxes' centres from the eye, the farthest first; with a
    parallel lens, from the plane of the eye. Objects at the same distance keep their order."""
    objects = scene.objects
    away = 0.5 * (objects.lower[rows] + objects.upper[rows]) - camera.position
    distances = away @ camera.forward if is_parallel(camera.projection) else np.einsum("ij,ij->i", away, away)
    return np.asarray(rows[np.argsort(-distances, kind="stable")])
