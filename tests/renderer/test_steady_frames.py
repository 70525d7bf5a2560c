"""The work of the processor for a frame in which only the camera has moved: calls of Python functions, counted
on null. Unlike times, counts are the same on every machine."""

import gc
import sys
from dataclasses import replace
from statistics import median

import numpy as np
import pytest

from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.techniques import TECHNIQUES

CALLS = {
    ("forward", "frustum"): 123,
    ("forward", "depth_pyramid"): 155,
    ("forward", "two_pass"): 205,
    ("clustered", "frustum"): 321,
}
"""The largest numbers of calls of a frame of the city with a technique and a visibility algorithm, some 3 % above
what was counted with Python 3.11."""
FRAMES_UNTIL_STEADY = 80
"""After so many frames, shaders have the features that are in view alone."""


def count_calls(action):
    """Return the number of Python functions that an action calls, itself included."""
    count = 0

    def note(frame, event, argument):
        nonlocal count
        count += event == "call"

    gc.collect()
    gc.disable()  # whose callbacks, such as hypothesis's, are calls too
    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(None)
        gc.enable()
    return count


@pytest.mark.parametrize(("technique", "visibility"), CALLS)
def test_a_frame_of_the_city_in_which_only_the_camera_moves_takes_few_calls(null, technique, visibility):
    scene = load_scene("city:blocks=4,detail=2")
    camera = next(iter(scene.views.values()))

    def moved(step):
        return replace(camera, position=camera.position + np.array([0.01 * step, 0.0, 0.0]))

    with Renderer(
        null, scene, technique=TECHNIQUES[technique](), visibility=visibility, size=(320, 180)
    ) as renderer:
        for step in range(FRAMES_UNTIL_STEADY):
            renderer.render(moved(step))
        renderer.render(moved(FRAMES_UNTIL_STEADY))
        draws = sum(draw["draws"] for draw in null.stream.draws()[-1:])
        calls = median(
            count_calls(lambda step=step: renderer.render(moved(FRAMES_UNTIL_STEADY + step)))
            for step in range(1, 4)  # one in ten looks for effects; some find that a fence was reached
        )
    assert draws > (30 if visibility == "frustum" else 10)  # a list has a draw for each mesh
    assert calls <= CALLS[technique, visibility]
