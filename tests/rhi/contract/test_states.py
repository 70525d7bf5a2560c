"""State values: each its own type, checked when made."""

import dataclasses
import math

import pytest

from rhi.contract import states
from rhi.errors import ValidationError

BAD = [
    (states.AlphaReference, (-0.01,), (0.0,)),
    (states.AlphaReference, (1.01,), (1.0,)),
    (states.AlphaReference, (math.nan,), (0.5,)),
    (states.BlendColor, (math.nan,), (-3.0,)),
    (states.BlendColor, (0.0, 0.0, 0.0, math.inf), (0.0, 0.0, 0.0, 1e9)),
    (states.Viewport, (0, 0, -1, 4), (0, 0, 0, 4)),
    (states.Viewport, (0, 0, 4, -0.5), (0, 0, 4, 0.5)),
    (states.Viewport, (math.nan, 0, 4, 4), (-5, 0, 4, 4)),
    (states.Viewport, (0, 0, 4, 4, -0.1, 1), (0, 0, 4, 4, 0, 1)),
    (states.Viewport, (0, 0, 4, 4, 0, 1.1), (0, 0, 4, 4, 1, 0)),
    (states.Scissor, (0, 0, -1, 4), (0, 0, 0, 4)),
    (states.Scissor, (0, 0, 4, -1), (0, 0, 4, 0)),
    (states.Scissor, ((1 << 30) + 1, 0, 1, 1), (1 << 30, 0, 1, 1)),
    (states.Scissor, (0, -(1 << 30) - 1, 1, 1), (0, -(1 << 30), 1, 1)),
    (states.DepthBias, (math.inf,), (-1e6,)),
    (states.LineWidth, (0.99,), (1.0,)),
    (states.LineWidth, (math.inf,), (1e6,)),
    (states.PolygonOffset, (math.nan,), (1.0,)),
    (states.PolygonOffset, (0.0, -math.inf), (0.0, -1.0)),
    (states.StencilReference, (256,), (255,)),
    (states.StencilReference, (0, -1), (0, 0)),
    (states.StencilReadMask, (-1,), (0,)),
    (states.StencilWriteMask, (0, 256), (0, 255)),
    (
        states.ColorWrite,
        (True, True, True, True, states.MAX_TARGETS),
        (True, True, True, True, states.MAX_TARGETS - 1),
    ),
    (states.ColorWrite, (True, True, True, True, -1), (True, True, True, True, 0)),
]


@pytest.mark.parametrize(("state", "bad", "good"), BAD)
def test_a_number_out_of_range_is_refused_and_the_last_one_in_range_is_not(state, bad, good):
    with pytest.raises(ValidationError, match=r"^\[state-value\]") as caught:
        state(*bad)
    assert caught.value.call == state.__name__
    assert dataclasses.astuple(state(*good))[: len(good)] == good


def test_a_blend_function_is_for_one_of_the_targets():
    assert states.BlendFunction.ALPHA.at(states.MAX_TARGETS - 1).target == states.MAX_TARGETS - 1
    with pytest.raises(ValidationError, match=r"^\[state-value\]"):
        states.BlendFunction.ALPHA.at(states.MAX_TARGETS)


def test_equal_numbers_in_different_states_are_different_states():
    assert states.Viewport(0, 0, 1, 1) != states.Scissor(0, 0, 1, 1)
    assert states.StencilReadMask(1, 2) != states.StencilWriteMask(1, 2)
    assert states.Viewport(0, 0, 1, 1) == states.Viewport(0.0, 0.0, 1.0, 1.0)


def test_a_vector_has_an_entry_for_each_state_and_one_for_those_of_platforms():
    assert (*states.DEFAULTS, states.PlatformState) == states.STATE_TYPES
    assert states.default_values()[-1] == ()


@pytest.mark.parametrize("state_type", states.DEFAULTS, ids=lambda t: t.__name__)
def test_every_state_has_a_default_of_its_own_type(state_type):
    assert type(states.DEFAULTS[state_type]) is state_type


VALUE_TYPES = [state_type for state_type in states.STATE_TYPES if dataclasses.is_dataclass(state_type)]


@pytest.mark.parametrize("state_type", VALUE_TYPES, ids=lambda t: t.__name__)
def test_a_state_value_cannot_be_changed(state_type):
    default = states.DEFAULTS[state_type]
    field = dataclasses.fields(default)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(default, field, 0)


def test_choosing_a_target_leaves_the_rest_as_it_was():
    state = states.ColorWrite.OFF.at(2)
    assert state == states.ColorWrite(False, False, False, False, target=2)
    assert states.ColorWrite.OFF.target is None
    assert set(states.PER_TARGET) == {states.ColorWrite, states.BlendFunction}


@pytest.mark.parametrize(
    ("function", "off"),
    [
        (states.BlendFunction.OFF, True),
        (
            states.BlendFunction(
                states.BlendFactor.ONE, states.BlendFactor.ZERO, source_alpha=states.BlendFactor.ONE
            ),
            True,
        ),
        (states.BlendFunction(states.BlendFactor.ONE, states.BlendFactor.ONE), False),
        (states.BlendFunction(states.BlendFactor.ZERO, states.BlendFactor.ZERO), False),
        (states.BlendFunction(operation=states.BlendOperation.SUBTRACT), False),
        (states.BlendFunction(source_alpha=states.BlendFactor.ZERO), False),
        (states.BlendFunction(destination_alpha=states.BlendFactor.ONE), False),
        (states.BlendFunction(operation_alpha=states.BlendOperation.MINIMUM), False),
    ],
)
def test_blending_is_off_only_where_it_replaces_all_four_channels(function, off):
    assert function.is_off == off
