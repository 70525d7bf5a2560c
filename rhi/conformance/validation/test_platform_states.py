"""States that only one platform has: accepted where the device names them, refused by name elsewhere."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Any

import pytest

import rhi
from rhi import CullMode, DepthTest, Device, Format, Op, trace
from rhi.backends.gl import DepthClamp
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import refuses
from rhi.contract.states import PlatformState
from rhi.errors import rules

pytestmark = pytest.mark.requires("draws")


class Elsewhere(PlatformState):
    """A state that no backend has."""

    PLAIN = enum.auto()
    FANCY = enum.auto()

    @classmethod
    def platform(cls) -> str:
        return "nowhere"


def beyond() -> Any:
    """Return vertices that cover the view, beyond the far plane."""
    vertices = rectangle()
    vertices["position"][:, 2] = -0.5
    return vertices


def owns(device: Device, state: type[PlatformState]) -> bool:
    return state in device.capabilities.platform_states


def test_a_state_of_another_platform_is_refused_by_name(recording: Device) -> None:
    states = recording._core.states
    before = states.requested
    with refuses(rules.PLATFORM_STATE, recording) as refusal, recording.states(Elsewhere.FANCY):
        pass
    assert "Elsewhere.FANCY" in refusal.error.given
    assert "'nowhere'" in refusal.error.given
    assert states.requested is before
    if not owns(recording, DepthClamp):
        with refuses(rules.PLATFORM_STATE, recording), recording.states(CullMode.NONE, DepthClamp.ON):
            pass


def test_each_platform_has_states_of_its_own_name(device: Device) -> None:
    for state in device.capabilities.platform_states:
        assert state.platform() == device.backend_name
        assert state.default() is next(iter(state))


def test_a_scope_sets_and_restores_each_of_them(recording: Device) -> None:
    states = recording._core.states
    for state in recording.capabilities.platform_states:
        default, other, *_ = state
        with recording.states(other):
            assert states.requested[PlatformState] == (other,)
            with recording.states(default):
                assert states.requested[PlatformState] == ()
            assert states.requested[PlatformState] == (other,)
        assert states.requested[PlatformState] == ()
        with refuses(rules.STATE_DUPLICATE, recording), recording.states(other, default):
            pass


def test_depth_is_clamped_where_the_platform_can(recording: Device) -> None:
    """A triangle beyond the far plane is clipped, and drawn at the far plane's depth if depth is clamped."""
    if not owns(recording, DepthClamp):
        pytest.skip("the device declares no platform_states with DepthClamp")
    program, since = recording.program(Colored), len(recording.stream)
    with recording.texture((4, 4), Format.R8) as image, recording.mesh(beyond()) as mesh:
        maxima = []
        for states in ((), (DepthClamp.OFF,), (DepthClamp.ON,), ()):
            with recording.render_pass(image, clear=(0, 0, 0, 0)), recording.states(DepthTest.OFF, *states):
                recording.draw(program, mesh)
            maxima.append(image.read().max())
        assert maxima == [0, 0, 255, 0]
        recording.make_current()  # sets it anew
        with recording.render_pass(image, clear=(0, 0, 0, 0)), recording.states(DepthTest.OFF, DepthClamp.ON):
            recording.draw(program, mesh)
            recording.make_current()
            recording.draw(program, mesh)
        assert_same(image.read(), 255)
    sent = [change for c in recording.stream[since:].filter(Op.SET_STATES) for change in c["changes"]]
    assert [change.value for change in sent if change.type is PlatformState] == [
        (DepthClamp.ON,),
        (),
        (DepthClamp.ON,),
    ]
    assert "DepthClamp.ON" in str(recording.stream[since:].filter(Op.SET_STATES))


def test_a_trace_of_it_replays_only_where_it_is_declared(backend: str, tmp_path: Path) -> None:
    with rhi.create_device(backend, record=True) as device:
        if not owns(device, DepthClamp):
            pytest.skip("the device declares no platform_states with DepthClamp")
        image, mesh = device.texture((4, 4), Format.R8), device.mesh(beyond())
        with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(DepthTest.OFF, DepthClamp.ON):
            device.draw(device.program(Colored), mesh)
        device.present(image)
        trace.save(device, tmp_path / "clamped.zip")
    loaded = trace.load(tmp_path / "clamped.zip", trusted=True)
    with rhi.create_device(backend) as device:
        replayed = trace.replay(loaded, on=device).image
        assert replayed is not None
        assert replayed.max() == 255
    with rhi.create_device("null") as device, pytest.raises(rhi.ValidationError) as caught:
        trace.replay(loaded, on=device)
    assert caught.value.rule.id == "trace-capability"
    assert "gl.DepthClamp.ON" in str(caught.value)
