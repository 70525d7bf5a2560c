"""State scopes: the states inside, the states restored after, and the two counters. No shader runs."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest

import rhi
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.contract.states import DEFAULTS, PlatformState

pytestmark = pytest.mark.requires("draws")


def states_of_draws(device: rhi.Device, *draws: object) -> list[dict[type, object]]:
    """Return the states in effect at the draws that a callable of `draws` issues."""
    before = len(device.stream)
    with device.texture((4, 4), rhi.Format.RGBA8) as image, device.mesh(rectangle()) as mesh:
        program = device.program(Colored)

        def draw() -> None:
            device.draw(program, mesh)

        with device.render_pass(image):
            for draw_index in draws:
                draw_index(draw)  # type: ignore[operator]
    return [command.states for command in device.stream[before:].draws()]


def test_outside_of_scopes_the_defaults_hold(recording: rhi.Device) -> None:
    (states,) = states_of_draws(recording, lambda draw: draw())
    assert states.pop(PlatformState) == ()
    assert set(states) == set(DEFAULTS)
    for state_type in DEFAULTS:
        value = states[state_type]
        default = DEFAULTS[state_type]
        assert value == (default if not isinstance(value, tuple) else (default,) * 8)


def test_a_scope_sets_and_restores(recording: rhi.Device) -> None:
    def act(draw: object) -> None:
        with recording.states(rhi.CullMode.NONE, rhi.DepthWrite.OFF):
            draw()  # type: ignore[operator]
        draw()  # type: ignore[operator]

    inside, after = states_of_draws(recording, act)
    assert (inside[rhi.CullMode], inside[rhi.DepthWrite]) == (rhi.CullMode.NONE, rhi.DepthWrite.OFF)
    assert (after[rhi.CullMode], after[rhi.DepthWrite]) == (rhi.CullMode.BACK, rhi.DepthWrite.ON)


def test_inner_scopes_win_and_outer_ones_come_back(recording: rhi.Device) -> None:
    def act(draw: object) -> None:
        with recording.states(rhi.CullMode.NONE, rhi.DepthTest.OFF):
            with recording.states(rhi.CullMode.FRONT):
                draw()  # type: ignore[operator]
            draw()  # type: ignore[operator]

    inner, outer = states_of_draws(recording, act)
    assert (inner[rhi.CullMode], inner[rhi.DepthTest]) == (rhi.CullMode.FRONT, rhi.DepthTest.OFF)
    assert (outer[rhi.CullMode], outer[rhi.DepthTest]) == (rhi.CullMode.NONE, rhi.DepthTest.OFF)


def test_an_exception_restores_too(recording: rhi.Device) -> None:
    with (
        pytest.raises(ZeroDivisionError),
        recording.states(rhi.CullMode.NONE),
        recording.states(rhi.DepthWrite.OFF),
    ):
        raise ZeroDivisionError
    (states,) = states_of_draws(recording, lambda draw: draw())
    assert (states[rhi.CullMode], states[rhi.DepthWrite]) == (rhi.CullMode.BACK, rhi.DepthWrite.ON)


class InterruptionError(Exception):
    """Raised inside the scopes of a frame."""


@pytest.mark.parametrize("depth", range(1, 6))
def test_the_frame_after_an_exception_in_scopes_is_right(device: rhi.Device, depth: int) -> None:
    """An event, states, a pass, states and an event, left by an exception inside the scope of this number."""
    with device.texture((8, 8), rhi.Format.R8) as image, device.mesh(rectangle()) as mesh:
        program, scopes = device.program(Colored), contextlib.ExitStack()
        openings = (
            lambda: device.event("frame"),
            lambda: device.states(rhi.Scissor(0, 0, 3, 3), rhi.DepthTest.OFF),
            lambda: device.render_pass(image, clear=(0, 0, 0, 0)),
            lambda: device.states(rhi.ColorWrite.OFF, rhi.CullMode.FRONT),
            lambda: device.event("draws"),
        )
        with pytest.raises(InterruptionError), scopes:
            for number, opening in enumerate(openings[:depth], 1):
                scopes.enter_context(opening())
                if number >= 3:
                    device.draw(program, mesh)
            raise InterruptionError
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, mesh)
        if device.capabilities.renders:
            assert_same(image.read(), 255)
        device.present()


@pytest.mark.parametrize("kind", ["pass", "states", "event"])
def test_a_refused_call_leaves_the_scopes_around_it(device: rhi.Device, kind: str) -> None:
    """A call that is refused in a pass, states or an event ends none of them, and draws go on there."""
    with device.texture((8, 8), rhi.Format.R8) as image, device.mesh(rectangle()) as mesh:
        program = device.program(Colored)
        with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(rhi.Scissor(0, 0, 4, 8)):
            with device.event("draws"), pytest.raises(rhi.ValidationError):
                if kind == "pass":
                    device.render_pass(image).__enter__()
                elif kind == "states":
                    device.states(rhi.CullMode.NONE, rhi.CullMode.BACK).__enter__()
                else:
                    device.event("\ud800").__enter__()
            device.draw(program, mesh)
        expected = np.zeros((8, 8), np.uint8)
        expected[:, :4] = 255
        if device.capabilities.renders:
            assert_same(image.read(), expected)


def test_a_scope_may_be_kept_and_entered_inside_itself(recording: rhi.Device) -> None:
    scope = recording.states(rhi.CullMode.NONE)

    def act(draw: object) -> None:
        with scope, recording.states(rhi.CullMode.FRONT):
            with scope:
                draw()  # type: ignore[operator]
            draw()  # type: ignore[operator]
        draw()  # type: ignore[operator]

    first, second, third = states_of_draws(recording, act)
    assert [s[rhi.CullMode] for s in (first, second, third)] == [
        rhi.CullMode.NONE,
        rhi.CullMode.FRONT,
        rhi.CullMode.BACK,
    ]


def test_states_hold_across_passes(recording: rhi.Device) -> None:
    with recording.states(rhi.DepthFunction.LESS):
        (states,) = states_of_draws(recording, lambda draw: draw())
    assert states[rhi.DepthFunction] is rhi.DepthFunction.LESS


def test_states_of_one_target_leave_the_others(recording: rhi.Device) -> None:
    def act(draw: object) -> None:
        with (
            recording.states(rhi.BlendFunction.ALPHA),
            recording.states(rhi.BlendFunction.ADDITIVE.at(2), rhi.ColorWrite.OFF.at(1)),
        ):
            draw()  # type: ignore[operator]

    (states,) = states_of_draws(recording, act)
    blends, writes = states[rhi.BlendFunction], states[rhi.ColorWrite]
    assert isinstance(blends, tuple)
    assert isinstance(writes, tuple)
    assert (
        blends
        == (rhi.BlendFunction.ALPHA,) * 2 + (rhi.BlendFunction.ADDITIVE,) + (rhi.BlendFunction.ALPHA,) * 5
    )
    assert writes == (rhi.ColorWrite.ON, rhi.ColorWrite.OFF) + (rhi.ColorWrite.ON,) * 6


def test_equal_values_of_different_states_stay_apart(recording: rhi.Device) -> None:
    def act(draw: object) -> None:
        with recording.states(rhi.Viewport(0, 0, 1, 1), rhi.Scissor(0, 0, 1, 1)):
            draw()  # type: ignore[operator]

    (states,) = states_of_draws(recording, act)
    assert states[rhi.Viewport] == rhi.Viewport(0, 0, 1, 1)
    assert states[rhi.Scissor] == rhi.Scissor(0, 0, 1, 1)


def sent(device: rhi.Device, since: int) -> list[type]:
    return [
        change.type
        for command in device.stream[since:].filter(rhi.Op.SET_STATES)
        for change in command["changes"]
    ]


def test_only_differences_are_sent(recording: rhi.Device) -> None:
    states_of_draws(recording, lambda draw: draw())
    since = len(recording.stream)
    with recording.states(rhi.CullMode.NONE, rhi.DepthTest.ON, rhi.DepthWrite.ON):
        states_of_draws(recording, lambda draw: draw(), lambda draw: draw())
    assert sent(recording, since) == [rhi.CullMode]


def test_states_that_no_draw_uses_are_never_sent(recording: rhi.Device) -> None:
    states_of_draws(recording, lambda draw: draw())
    since = len(recording.stream)
    with recording.states(rhi.CullMode.NONE):
        pass
    states_of_draws(recording, lambda draw: draw())
    assert sent(recording, since) == []


def test_software_changes_count_states_set_by_scopes(recording: rhi.Device) -> None:
    recording.reset_statistics()
    for _ in range(3):
        with recording.states(rhi.CullMode.NONE, rhi.DepthWrite.OFF):
            pass
    assert recording.statistics.software_state_changes == 6
    assert recording.statistics.hardware_state_changes == 0


def test_hardware_changes_count_values_sent(recording: rhi.Device) -> None:
    states_of_draws(recording, lambda draw: draw())
    recording.reset_statistics()
    with recording.states(rhi.CullMode.NONE, rhi.DepthWrite.OFF, rhi.DepthTest.ON):
        states_of_draws(recording, lambda draw: draw())
    assert recording.statistics.hardware_state_changes == 2
    states_of_draws(recording, lambda draw: draw())
    assert recording.statistics.hardware_state_changes == 4
    assert recording.statistics.software_state_changes == 3


def test_scopes_nest_deeply(recording: rhi.Device) -> None:
    """The thesis's stack holds more than 200 states."""
    from contextlib import ExitStack

    with ExitStack() as stack:
        for index in range(200):
            stack.enter_context(recording.states(rhi.Scissor(0, 0, index, index)))
        (states,) = states_of_draws(recording, lambda draw: draw())
        assert states[rhi.Scissor] == rhi.Scissor(0, 0, 199, 199)
    (states,) = states_of_draws(recording, lambda draw: draw())
    assert states[rhi.Scissor] == rhi.Scissor.OFF


def test_more_combinations_than_are_remembered_stay_right(recording: rhi.Device) -> None:
    """Vectors of states are interned in a pool of limited size, but scissors can have any value."""
    program = recording.program(Colored)
    since = len(recording.stream)
    with recording.texture((4, 4), rhi.Format.RGBA8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image), recording.states(rhi.DepthWrite.OFF):
            for number in range(20_000):
                with recording.states(rhi.Scissor(0, 0, number, 1)):
                    if number % 1000 == 0:
                        recording.draw(program, mesh)
            recording.draw(program, mesh)
    draws = [command.states for command in recording.stream[since:].draws()]
    assert [states[rhi.Scissor] for states in draws[:-1]] == [
        rhi.Scissor(0, 0, n, 1) for n in range(0, 20_000, 1000)
    ]
    assert draws[-1][rhi.Scissor] == rhi.Scissor.OFF
    assert all(states[rhi.DepthWrite] is rhi.DepthWrite.OFF for states in draws)
