"""One frame checked against the profiles of many devices."""

import dataclasses
import functools
import inspect

import numpy as np
import pytest
from null_kit import Camera, Object, hand_made_program

from rhi import BlendFunction, Format, PolygonOffset, SamplerDescriptor, Stage, ValidationError, create_device
from rhi.backends.null import get_profile
from rhi.shading import Shader, StorageRW, compile_shader, local_index, shared
from rhi.testing.portability import check_portability


def deferred_frame(device):
    """A frame with large, blended, floating-point targets and a compute program."""
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


def test_a_portability_report_lists_every_obstacle_with_its_line():
    report = check_portability(deferred_frame)
    first = inspect.getsourcelines(deferred_frame)[1]
    features = {
        name: [
            (obstacle.capability, obstacle.error.rule.id, obstacle.error.site.line - first)
            for obstacle in reported
        ]
        for name, reported in report.obstacles.items()
    }
    assert features == {
        "everything": [],
        "gl-4.5": [],
        "gl-3.3": [("max_texture_size", "texture-size", 3), ("blend_per_target", "state-capability", 7)],
        "gles-3": [("unrenderable_formats", "pass-target", 7), ("blend_per_target", "state-capability", 7)],
        "webgpu": [],
        "opencl-cpu": [("blend_per_target", "state-capability", 7)],
    }
    assert report.runs_on == ["everything", "gl-4.5", "webgpu"]


def scattered_frame(device, changed=frozenset()):
    """A frame that lacks the same capabilities at several lines each, except at the `changed` ones."""
    device.sampler(SamplerDescriptor(max_anisotropy=1 if 2 in changed else 8))
    for size in (4000, 5000):  # one line
        device.texture((4 if 4 in changed else size, 4), Format.R8)
    image = device.texture((4, 4), Format.R8)
    with device.render_pass(image), device.states(PolygonOffset(1, 0 if 6 in changed else 0.5)):
        pass
    device.texture((4, 4 if 8 in changed else 4000), Format.R8)
    image.sampled(SamplerDescriptor(max_anisotropy=1 if 9 in changed else 8))
    with device.record() as commands, commands.render_pass(image):
        outer = PolygonOffset(1, 0 if 12 in changed else 0.5)
        with commands.states(outer), commands.states(PolygonOffset(1, 0)):
            pass
        with commands.states(PolygonOffset(1, 0 if 14 in changed else 0.5)):
            pass
    device.submit(commands)


def test_each_capability_is_named_at_the_first_line_that_lacks_it_and_then_at_the_next():
    first = inspect.getsourcelines(scattered_frame)[1]
    changed, rounds = set(), []
    while not rounds or rounds[-1]:
        frame = functools.partial(scattered_frame, changed=frozenset(changed))
        features = check_portability(frame, {"gl-3.3": get_profile("gl-3.3")}).obstacles["gl-3.3"]
        rounds.append([(feature.capability, feature.error.site.line - first) for feature in features])
        assert not changed & {line for _, line in rounds[-1]}, "a changed line lacks it again"
        changed |= {line for _, line in rounds[-1]}
    assert rounds == [
        [("max_anisotropy", 2), ("max_texture_size", 4), ("depth_bias_clamp", 6)],
        [("max_texture_size", 8), ("max_anisotropy", 9), ("depth_bias_clamp", 12)],
        [("depth_bias_clamp", 14)],
        [],
    ]


def test_timestamps_are_granted_as_other_capabilities_are():
    def frame(device):
        device.timing = True
        device.texture((4000, 4), Format.R8)

    features = check_portability(frame, {"gles": get_profile("gles-3")}).obstacles["gles"]
    assert [feature.capability for feature in features] == ["timestamps", "max_texture_size"]


def test_a_frame_sees_the_profile_as_it_is_whatever_was_granted():
    asked = []

    def frame(device):
        device.sampler(SamplerDescriptor(max_anisotropy=8))
        asked.append(device.capabilities.max_anisotropy)

    check_portability(frame, {"gles": get_profile("gles-3")})
    assert asked[0] == 16.0
    assert set(asked[1:]) == {1.0}


class TooMuch(Shader):
    """A shader with more shared memory than most devices allow."""

    work_group = (64,)
    results: StorageRW[float]
    numbers = shared(float, 10_000)

    def compute(self) -> None:
        self.numbers[local_index()] = 1.0
        self.results[local_index()] = self.numbers[local_index()]


@pytest.mark.parametrize(("limit", "fits"), [(40_000, True), (39_999, False)])
def test_shared_memory_is_a_limit_of_a_profile(limit, fits):
    profile = dataclasses.replace(get_profile("gl-4.5"), max_shared_bytes=limit)
    report = check_portability(lambda device: device.program(TooMuch), {"own": profile})
    assert [features.capability for features in report.obstacles["own"]] == (
        [] if fits else ["max_shared_bytes"]
    )
    assert compile_shader(TooMuch).shared_bytes == 40_000


@pytest.mark.parametrize(("anisotropy", "fits"), [(1.0, True), (4.0, True), (4.5, False)])
def test_anisotropy_is_a_limit_of_a_profile(anisotropy, fits):
    profile = dataclasses.replace(get_profile("gl-4.5"), max_anisotropy=4.0)
    with create_device("null", profile=profile) as device:
        descriptor = SamplerDescriptor(max_anisotropy=anisotropy)
        if fits:
            device.sampler(descriptor)
        else:
            with pytest.raises(ValidationError, match=r"^\[device-capability\]"):
                device.sampler(descriptor)


def test_the_report_prints_the_call_its_argument_and_the_allowed_value():
    text = str(
        check_portability(deferred_frame, {"small": get_profile("gl-3.3"), "all": get_profile("everything")})
    )
    assert text.splitlines()[0] == "small: stopped by 2"
    assert "max_texture_size" in text
    assert "1500" in text
    assert __file__ in text
    assert text.splitlines()[-1] == "all: runs"


def test_a_call_that_every_device_refuses_is_raised():
    def broken(device):
        device.texture((0, 4), Format.R8)

    with pytest.raises(ValidationError, match=r"^\[texture-size\]"):
        check_portability(broken)


def test_other_errors_of_a_frame_come_through():
    def broken(device):
        raise KeyError("mine")

    with pytest.raises(KeyError):
        check_portability(broken)
