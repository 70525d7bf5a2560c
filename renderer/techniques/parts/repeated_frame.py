"""A frame of one batch as one function, while only the camera moves.

Such a frame passes through a dozen objects, each of which finds what it found in the frame before: the passes of the
plan, textures, the program and its bindings. `repeat_frame` looks all of that up once. It returns a function that only
culls, writes constants and draws, and submits what was recorded. Its commands are those of the ordinary frame, to which
it leaves whatever needs more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager

from renderer.frame import Frame, LightWatch, Plan, SceneResources, View, VisibleFeatures
from renderer.frame.frame import ViewRecord
from renderer.scene import Camera
from renderer.techniques.parts.variants import select_repeated_pass
from renderer.visibility.algorithm import to_selecting

RepeatedDraw = Callable[[Camera], ViewRecord | None]
"""Draws a frame of a camera, and returns its record; or None, before any command, if the frame needs more."""


def repeat_frame(
    plan: Plan[Frame],
    values: Mapping[object, object],
    event: AbstractContextManager[None],
    view: View,
    resources: SceneResources,
    features: VisibleFeatures,
    watch: LightWatch,
) -> RepeatedDraw | None:
    """Return a function that draws the frames after one, as long as the scene and all settings stay the same; None if
    frames have more than one batch of objects that the CPU culls, or a pass or an algorithm
    that isn't the renderer's own.

    Args:
        values: the `Frame.values` of that frame.
        event: the label of its pass.
        watch: tells whether a frame has its effects.
    """
    repeated = select_repeated_pass(plan.passes[0], values) if len(plan.passes) == 1 else None
    culling = to_selecting(view.visibility)
    if repeated is None or culling is None or not repeated.drawer.is_repeatable:
        return None
    drawer, select = repeated.drawer, culling.select

    def draw(camera: Camera) -> ViewRecord | None:
        if not repeated.is_current:
            return None
        shader_features = features.choose_shader_features(camera, is_unchanged=True)
        is_same = watch.shows_same(camera, shader_features, features.shows_objects)
        selected = select(camera) if is_same else None
        if selected is None or not len(selected[0]):
            features.reconsider()
            return None
        visible, statistics = selected
        view.aim(camera)
        resources.follow(view)
        drawer.begin_frame()
        with event:
            drawer.repeat_alone(visible)
        return ViewRecord(drawer.draw_result, statistics)

    return draw
