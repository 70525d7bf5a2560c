"""Profiles: the null device with the capabilities of another, and the features that a frame lacks there."""

import dataclasses

import numpy as np
import pytest
from null_kit import hand_made_program

import rhi
from rhi.backends.null import PROFILES, SimulatedBackend, Simulation, get_profile
from rhi.contract.descriptors import Binding, BindingKind


def refused(profile, call):
    """Return the rule that a call violates on a profile, and check that it violates none on `everything`."""
    with rhi.create_device("null", profile="everything") as device:
        call(device)
    with rhi.create_device("null", profile=profile) as device:
        try:
            call(device)
        except rhi.ValidationError as error:
            return error.rule.id
    return None


def compute_program(device):
    stages = frozenset({rhi.Stage.COMPUTE})
    device.program(dataclasses.replace(hand_made_program(), stages=stages, attributes=(), outputs=()))


def scope(*states):
    def call(device):
        with device.states(*states):
            pass

    return call


def targets(count):
    def call(device):
        images = [device.texture((4, 4), rhi.Format.RGBA8) for _ in range(count)]
        with device.render_pass(images):
            pass

    return call


def target(*forms):
    def call(device):
        with device.render_pass([device.texture((4, 4), form) for form in forms]):
            pass

    return call


def copy(offset, target_offset, size):
    def call(device):
        with device.buffer(16, np.dtype("u1")) as source, device.buffer(16, np.dtype("u1")) as into:
            source.copy_to(into, offset=offset, target_offset=target_offset, size=size)

    return call


def slots(kind, count):
    def call(device):
        bindings = [Binding(f"b{i}", kind, i) for i in range(count)]
        device.program(hand_made_program("many", *bindings))

    return call


@pytest.mark.parametrize(
    ("profile", "call", "rule"),
    [
        ("gl-3.3", lambda d: d.texture((1024, 1024), rhi.Format.R8), None),
        ("gl-3.3", lambda d: d.texture((1025, 4), rhi.Format.R8), "texture-size"),
        ("gles-3", lambda d: d.texture((2048, 4), rhi.Format.R8), None),
        ("gles-3", lambda d: d.texture((2049, 4), rhi.Format.R8), "texture-size"),
        ("gles-3", targets(4), None),
        ("gles-3", targets(5), "device-capability"),
        ("gl-4.5", targets(8), None),
        ("gl-4.5", compute_program, None),
        ("gl-3.3", compute_program, "device-capability"),
        ("gl-4.5", slots(BindingKind.STORAGE, 8), None),
        ("gl-3.3", slots(BindingKind.STORAGE, 1), "device-capability"),
        ("gl-3.3", slots(BindingKind.IMAGE, 1), "device-capability"),
        ("gl-3.3", slots(BindingKind.UNIFORM, 12), None),
        ("gles-3", lambda d: d.texture((4, 4), rhi.Format.R16), "device-capability"),
        ("gles-3", target(rhi.Format.RGBA16F), "pass-target"),
        ("gl-3.3", target(rhi.Format.RGBA16F), None),
        ("gl-4.5", target(rhi.Format.RGBA8_SNORM), "pass-target"),
        ("gles-3", lambda d: d.occlusion_query(), "device-capability"),
        ("gl-3.3", lambda d: d.occlusion_query(), None),
        ("gl-3.3", lambda d: d.occlusion_query(emulated=True), "device-capability"),
        ("opencl-cpu", lambda d: d.texture((4, 4), rhi.Format.RGBA8, samples=4), "texture-samples"),
        ("gl-3.3", lambda d: d.texture((4, 4), rhi.Format.RGBA8, samples=4), None),
        ("webgpu", lambda d: d.texture((4, 4), rhi.Format.RGBA8, samples=2), "texture-samples"),
        ("webgpu", lambda d: d.texture((4, 4), rhi.Format.RGBA8, samples=4), None),
        ("webgpu", lambda d: d.sampler(rhi.SamplerDescriptor(wrap_w=rhi.Wrap.BORDER)), "device-capability"),
        ("webgpu", lambda d: d.sampler(rhi.SamplerDescriptor(border=(1, 1, 1, 1))), None),
        ("gl-3.3", lambda d: d.sampler(rhi.SamplerDescriptor(wrap_w=rhi.Wrap.BORDER)), None),
        ("webgpu", scope(rhi.StencilReference(1)), "state-capability"),
        ("webgpu", scope(rhi.StencilReference(1, 1)), None),
        ("webgpu", scope(rhi.StencilReadMask(1)), "state-capability"),
        ("webgpu", scope(rhi.StencilReadMask(1, 1)), None),
        ("webgpu", scope(rhi.StencilWriteMask(1)), "state-capability"),
        ("webgpu", scope(rhi.StencilWriteMask(1, 1)), None),
        ("gl-3.3", scope(rhi.StencilReference(1), rhi.StencilReadMask(1), rhi.StencilWriteMask(1)), None),
        ("webgpu", copy(0, 4, 8), None),
        ("webgpu", copy(0, 4, 6), "buffer-alignment"),
        ("webgpu", copy(2, 4, 8), "buffer-alignment"),
        ("webgpu", copy(0, 2, 8), "buffer-alignment"),
        ("gl-3.3", copy(1, 3, 5), None),
        ("gl-3.3", scope(rhi.AlphaTest.ON), "state-capability"),
        ("opencl-cpu", scope(rhi.AlphaToCoverage.ON), "state-capability"),
        ("gl-3.3", scope(rhi.BlendFunction.ALPHA), None),
        ("gl-3.3", scope(rhi.BlendFunction.ALPHA.at(1)), "state-capability"),
        ("gl-4.5", scope(rhi.BlendFunction.ALPHA.at(1)), None),
        (
            "webgpu",
            target(rhi.Format.RGBA32F, rhi.Format.R8, rhi.Format.RGBA8, rhi.Format.R8),
            None,
        ),  # 16 + 1 + 8 + 1 bytes
        (
            "webgpu",
            target(rhi.Format.RGBA8, rhi.Format.RGB10A2, rhi.Format.RGBA16F, rhi.Format.RGBA8UI),
            None,
        ),  # 28
        (
            "webgpu",
            target(rhi.Format.RGBA8, rhi.Format.R8, rhi.Format.RGBA32F, rhi.Format.R32F, rhi.Format.R8),
            "device-capability",
        ),  # 33
        ("webgpu", target(*[rhi.Format.RGBA8] * 5), "device-capability"),  # 40
        ("gl-4.5", target(*[rhi.Format.RGBA32F] * 8), None),
        ("webgpu", scope(rhi.LineWidth(1.5)), "state-capability"),
        ("webgpu", scope(rhi.LineWidth(1.0)), None),
        ("webgpu", scope(rhi.PolygonMode.LINE), "state-capability"),
        ("webgpu", scope(rhi.PolygonMode.FILL), None),
        ("gl-3.3", scope(rhi.PolygonOffset(slope=2.0)), None),
        ("gl-3.3", scope(rhi.PolygonOffset(slope=2.0, clamp=1.0)), "state-capability"),
    ],
)
def test_limits_and_features_of_a_profile_hold(profile, call, rule):
    assert refused(profile, call) == rule


def test_timing_needs_timestamps():
    with rhi.create_device("null", profile="gles-3", timing=True) as device:
        assert not device.timing
        with pytest.raises(rhi.ValidationError):
            device.timing = True


def test_a_profile_of_ones_own_stays_a_null_device():
    profile = rhi.Capabilities("gl", "Toaster", "1.0", max_texture_size=16)
    with rhi.create_device("null", profile=profile) as device:
        assert (device.backend_name, device.capabilities.device) == ("null", "Toaster")
        assert not device.capabilities.shading
        assert len(device.stream) == 0
        with pytest.raises(rhi.ValidationError):
            device.texture((17, 1), rhi.Format.R8)


def test_profiles_are_named_as_they_are_asked_for():
    for name, profile in PROFILES.items():
        assert get_profile(name) is profile
        assert profile.backend == "null"
        assert profile.device == ("null" if name == "everything" else name)


@pytest.mark.parametrize(
    ("feature", "expected"),
    [
        ("shading", set()),
        ("indirect_count", {"everything", "webgpu"}),
        ("depth_bias_clamp", {"everything", "webgpu"}),
        ("blend_per_target", {"everything", "gl-4.5", "webgpu"}),
    ],
)
def test_profiles_have_the_features_of_their_devices(feature: str, expected: set[str]):
    assert {name for name, profile in PROFILES.items() if getattr(profile, feature)} == expected


@pytest.mark.parametrize("profile", ["gl-3.4", 33, None])
def test_an_unknown_profile_is_refused_with_those_there_are(profile):
    with pytest.raises(rhi.ValidationError, match=r"^\[device-argument\]") as caught:
        rhi.create_device("null", profile=profile)
    assert "gles-3" in caught.value.allowed


def test_a_profile_and_a_simulation_go_together():
    with rhi.create_device("null", profile="gles-3", simulation=Simulation()) as device:
        assert device.capabilities.device == "gles-3"
        assert device.backend_as(SimulatedBackend)
