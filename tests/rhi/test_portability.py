"""One frame against many devices that aren't there."""

import dataclasses
import inspect

import numpy as np
import pytest
from null_kit import Camera, Object, hand_made_program

from rhi import BlendFunction, Format, Stage, ValidationError
from rhi.backends.null import find_profile
from rhi.portability import check_portability


def deferred_frame(device):
    """Wants large, blended, floating-point targets and a compute program."""
    size = 512 if device.capabilities.device == "opencl-cpu" else 1500
    image = device.texture((size, size), Format.RGBA16F)
    mesh = device.mesh({"position": np.array([[-1, -1], [1, -1], [0, 1]], np.float32)})
    program = device.program(hand_made_program())
    camera, objects = device.uniform(Camera(tint=(1, 1, 1, 1))), device.uniform_array(Object, 2)
    with device.render_pass(image, clear=(0, 0, 0, 1)), device.states(BlendFunction.ADDITIVE.at(0)):
        device.draw(program, mesh, camera=camera, object=objects[1])
    if device.capabilities.compute:
        compute = dataclasses.replace(
            hand_made_program(), stages=frozenset({Stage.COMPUTE}), attributes=(), outputs=()
        )
        device.program(compute)


def test_a_frame_is_told_everything_that_stops_it_with_lines():
    report = check_portability(deferred_frame)
    first = inspect.getsourcelines(deferred_frame)[1]
    found = {
        name: [(obstacle.capability, obstacle.error.rule.id, obstacle.error.site.line - first) for obstacle in each]
        for name, each in report.obstacles.items()
    }
    assert found == {
        "everything": [],
        "gl-4.5": [],
        "gl-3.3": [("max_texture_size", "texture-size", 3), ("blend_per_target", "state-capability", 7)],
        "gles-3": [("unrenderable_formats", "pass-target", 7), ("blend_per_target", "state-capability", 7)],
        "opencl-cpu": [("blend_per_target", "state-capability", 7)],
    }
    assert report.runs_on == ["everything", "gl-4.5"]


def test_the_report_prints_the_call_what_was_given_and_what_is_allowed():
    text = str(check_portability(deferred_frame, {"small": find_profile("gl-3.3"), "all": find_profile("everything")}))
    assert text.splitlines()[0] == "small: stopped by 2"
    assert "max_texture_size" in text
    assert "1500" in text
    assert __file__ in text
    assert text.splitlines()[-1] == "all: runs"


def test_what_breaks_everywhere_is_raised():
    def broken(device):
        device.texture((0, 4), Format.R8)

    with pytest.raises(ValidationError) as caught:
        check_portability(broken)
    assert caught.value.rule.id == "texture-size"


def test_other_errors_of_a_frame_come_through():
    def broken(device):
        raise KeyError("mine")

    with pytest.raises(KeyError):
        check_portability(broken)
