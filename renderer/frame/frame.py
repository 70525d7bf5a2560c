"""The state of one frame that its passes are given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from renderer.frame.drawing import DrawResult, TechniqueDrawer
from renderer.frame.effects import FrameEffects
from renderer.frame.light_components import LightComponent
from renderer.frame.resources import SceneResources
from renderer.frame.targets import Targets
from renderer.frame.view import View
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Indices
from renderer.shaders.tone_mapping import inverse_tone_map
from renderer.visibility import VisibilityAlgorithm, VisibilityStatistics
from rhi import Device, Program, Texture
from rhi.errors.shared_caches import cache_once
from rhi.math import is_parallel
from rhi.shading import Precision, Shader

_BLACK: Final = (0.0, 0.0, 0.0, 1.0)


@dataclass(eq=False, slots=True)
class ViewRecord:
    """The objects that a view has drawn in a frame, and the cost of culling."""

    draw_result: DrawResult
    statistics: VisibilityStatistics


@dataclass(eq=False, slots=True)
class Frame:
    """One frame, drawn once.

    Attributes:
        view: what the image is seen from.
        resources: the scene on the device, up to date for this view.
        targets: the textures that the passes draw to.
        effects: the effects of this frame.
        first: the frame of the left eye, drawn before, if this is the right eye's.
        precision: that of the shaders which are FAST by themselves.
        values: what passes derive from the scene, settings, targets and effects alone; frames in which only
            the camera moves share it.
        scene_layers: what draws the layers that belong to the scene, for a pass that comes after them.
    """

    device: Device
    view: View
    resources: SceneResources
    targets: Targets
    effects: FrameEffects
    first: Frame | None = None
    precision: Precision = Precision.FAST
    values: dict[object, Any] = field(default_factory=dict)
    scene_layers: Sequence[Callable[[Device, Frame], None]] = ()
    _seen: dict[View, ViewRecord] = field(default_factory=dict)

    @property
    def camera(self) -> Camera:
        """The camera of the image; its projection determines the direction of depth."""
        return self.view.camera

    @property
    def image(self) -> Texture:
        """The texture that the technique draws to: the resource `effects.image`."""
        return self.targets[self.effects.image.name]

    @property
    def background(self) -> tuple[float, float, float, float]:
        """The clear value of `image`, as a colour, or with effects of the camera as light; black if only a component
        of light is drawn."""
        if self.effects.component is not LightComponent.ALL:
            return _BLACK
        color = self.resources.scene.background
        return (*inverse_tone_map(color), 1.0) if self.effects.keeps_light else (*color, 1.0)

    @property
    def visibility(self) -> VisibilityAlgorithm:
        """The algorithm that decides which objects are in the image."""
        return self.view.visibility

    @property
    def draw_result(self) -> DrawResult:
        """The objects in the image, after they were drawn."""
        seen = self._seen.get(self.view)
        return DrawResult(self.resources) if seen is None else seen.draw_result

    @property
    def statistics(self) -> VisibilityStatistics | None:
        """The cost of finding the objects in the image; None before they are drawn."""
        seen = self._seen.get(self.view)
        return None if seen is None else seen.statistics

    def program(self, shader: type[Shader]) -> Program[...]:
        """The program of a technique's shader, in the frame's precision."""
        program: Program[...] | None = self.values.get(shader)
        if program is None or program.destroyed:
            program = self.values[shader] = self.device.program(with_precision(shader, self.precision))
        return program

    def draw_transparent(
        self, scene_drawer: TechniqueDrawer, view: View | None = None, *, in_order: bool = True
    ) -> None:
        """Draw the transparent objects that a view sees, as `draw_visible` recorded them. Without any,
        nothing is issued.

        Args:
            in_order: whether they are drawn back to front, by the distances of their boxes' centres, and far
                sides before near ones. Otherwise it is in as few calls as there are groups.
        """
        view = view or self.view
        seen = self._seen.get(view)
        if seen is None or not len(object_indices := seen.draw_result.transparent):
            return
        if in_order:
            object_indices = sort_back_to_front(self.resources.scene, view.camera, object_indices)
        else:
            object_indices = object_indices[np.argsort(self.resources.group[object_indices], kind="stable")]
        with scene_drawer:
            scene_drawer.draw_in_order(object_indices, far_sides_first=in_order)

    def draw_visible(self, scene_drawer: TechniqueDrawer, view: View | None = None) -> None:
        """Draw what a view sees in a pass: the main view by default.

        The first pass of a view finds the visible objects, in as many batches as its algorithm likes, which
        issues its own commands there. It must be the first to write the view's depth. Later passes draw the
        same objects again, and so does the right eye if the left one's were found by the frustum around both.
        """
        view = view or self.view
        seen = self._seen.get(view)
        if seen is None and self.first is not None:
            seen = self._shared_record(view)
        with scene_drawer:
            if seen is not None:
                seen.draw_result.draw_again(scene_drawer)
                return
            if not view.visibility.opens_pass:
                scene_drawer.open()
            statistics = view.visibility.render(view.camera, scene_drawer)
            if not scene_drawer.was_opened:  # nothing was drawn: the targets are cleared all the same
                scene_drawer.open()
        self._seen[view] = ViewRecord(scene_drawer.draw_result, statistics)

    def _shared_record(self, view: View) -> ViewRecord | None:
        """The left eye's record, if its objects are in the frustum around both eyes; else None."""
        if self.first is None or view is not self.view:
            return None
        seen = self.first._seen.get(self.first.view)
        if seen is None or not seen.statistics.is_frustum_only:
            return None
        self._seen[view] = seen
        return seen


@cache_once
def _exact_variant(shader: Any) -> type[Shader]:
    return type(f"Exact{shader.__name__}", (shader,), {"__module__": __name__, "precision": Precision.EXACT})


def with_precision(shader: type[Shader], precision: Precision) -> type[Shader]:
    """A shader in another precision. Shaders that ask for EXACT themselves stay as they are."""
    if precision is Precision.FAST or shader.precision is Precision.EXACT:
        return shader
    key: Any = shader
    return _exact_variant(key)


def sort_back_to_front(scene: Scene, camera: Camera, object_indices: Indices) -> Indices:
    """The objects sorted by the distances of their boxes' centres from the eye, farthest first; with a
    parallel projection, from the plane of the eye. Objects at the same distance keep their order."""
    objects = scene.objects
    away = 0.5 * (objects.lower[object_indices] + objects.upper[object_indices]) - camera.position
    distances = away @ camera.forward if is_parallel(camera.projection) else np.einsum("ij,ij->i", away, away)
    return np.asarray(object_indices[np.argsort(-distances, kind="stable")])
