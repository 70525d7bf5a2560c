"""State values: each its own type, checked when made."""

import dataclasses
import math

import pytest

from rhi.contract.states import (
    DEFAULTS,
    MAX_TARGETS,
    PER_TARGET,
    STATE_TYPES,
    AlphaReference,
    BlendColor,
    BlendFactor,
    BlendFunction,
    BlendOperation,
    ColorWrite,
    DepthBias,
    LineWidth,
    PlatformState,
    PolygonOffset,
    Scissor,
    StencilReadMask,
    StencilReference,
    StencilWriteMask,
    Viewport,
    default_values,
)
from rhi.errors import ValidationError

BAD = [
    (AlphaReference, (-0.01,), (0.0,)),
    (AlphaReference, (1.01,), (1.0,)),
    (AlphaReference, (math.nan,), (0.5,)),
    (BlendColor, (math.nan,), (-3.0,)),
    (BlendColor, (0.0, 0.0, 0.0, math.inf), (0.0, 0.0, 0.0, 1e9)),
    (Viewport, (0, 0, -1, 4), (0, 0, 0, 4)),
    (Viewport, (0, 0, 4, -0.5), (0, 0, 4, 0.5)),
    (Viewport, (math.nan, 0, 4, 4), (-5, 0, 4, 4)),
    (Viewport, (0, 0, 4, 4, -0.1, 1), (0, 0, 4, 4, 0, 1)),
    (Viewport, (0, 0, 4, 4, 0, 1.1), (0, 0, 4, 4, 1, 0)),
    (Scissor, (0, 0, -1, 4), (0, 0, 0, 4)),
    (Scissor, (0, 0, 4, -1), (0, 0, 4, 0)),
    (Scissor, ((1 << 30) + 1, 0, 1, 1), (1 << 30, 0, 1, 1)),
    (Scissor, (0, -(1 << 30) - 1, 1, 1), (0, -(1 << 30), 1, 1)),
    (DepthBias, (math.inf,), (-1e6,)),
    (LineWidth, (0.99,), (1.0,)),
    (LineWidth, (math.inf,), (1e6,)),
    (PolygonOffset, (math.nan,), (1.0,)),
    (PolygonOffset, (0.0, -math.inf), (0.0, -1.0)),
    (StencilReference, (256,), (255,)),
    (StencilReference, (0, -1), (0, 0)),
    (StencilReadMask, (-1,), (0,)),
    (StencilWriteMask, (0, 256), (0, 255)),
    (ColorWrite, (True, True, True, True, MAX_TARGETS), (True, True, True, True, MAX_TARGETS - 1)),
    (ColorWrite, (True, True, True, True, -1), (True, True, True, True, 0)),
]


@pytest.mark.parametrize(("state", "bad", "good"), BAD)
def test_a_number_out_of_range_is_refused_and_the_last_one_in_range_is_not(state, bad, good):
    with pytest.raises(ValidationError, match=r"^\[state-value\]") as caught:
        state(*bad)
    assert caught.value.call == state.__name__
    assert dataclasses.astuple(state(*good))[: len(good)] == good


def test_a_blend_function_is_for_one_of_the_targets():
    assert BlendFunction.ALPHA.at(MAX_TARGETS - 1).target == MAX_TARGETS - 1
    with pytest.raises(ValidationError, match=r"^\[state-value\]"):
        BlendFunction.ALPHA.at(MAX_TARGETS)


def test_equal_numbers_in_different_states_are_different_states():
    assert Viewport(0, 0, 1, 1) != Scissor(0, 0, 1, 1)
    assert StencilReadMask(1, 2) != StencilWriteMask(1, 2)
    assert Viewport(0, 0, 1, 1) == Viewport(0.0, 0.0, 1.0, 1.0)


def test_a_vector_has_an_entry_for_each_state_and_one_for_those_of_platforms():
    assert (*DEFAULTS, PlatformState) == STATE_TYPES
    assert default_values()[-1] == ()


@pytest.mark.parametrize("state_type", DEFAULTS, ids=lambda t: t.__name__)
def test_every_state_has_a_default_of_its_own_type(state_type):
    assert type(DEFAULTS[state_type]) is state_type


VALUE_TYPES = [state_type for state_type in STATE_TYPES if dataclasses.is_dataclass(state_type)]


@pytest.mark.parametrize("state_type", VALUE_TYPES, ids=lambda t: t.__name__)
def test_a_state_value_cannot_be_changed(state_type):
    default = DEFAULTS[state_type]
    field = dataclasses.fields(default)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(default, field, 0)


def test_choosing_a_target_leaves_the_rest_as_it_was():
    one = ColorWrite.OFF.at(2)
    assert one == ColorWrite(False, False, False, False, target=2)
    assert ColorWrite.OFF.target is None
    assert set(PER_TARGET) == {ColorWrite, BlendFunction}


@pytest.mark.parametrize(
    ("function", "off"),
    [
        (BlendFunction.OFF, True),
        (BlendFunction(BlendFactor.ONE, BlendFactor.ZERO, source_alpha=BlendFactor.ONE), True),
        (BlendFunction(BlendFactor.ONE, BlendFactor.ONE), False),
        (BlendFunction(BlendFactor.ZERO, BlendFactor.ZERO), False),
        (BlendFunction(operation=BlendOperation.SUBTRACT), False),
        (BlendFunction(source_alpha=BlendFactor.ZERO), False),
        (BlendFunction(destination_alpha=BlendFactor.ONE), False),
        (BlendFunction(operation_alpha=BlendOperation.MINIMUM), False),
    ],
)
def test_blending_is_off_only_where_it_replaces_all_four_channels(function, off):
    assert function.is_off == off
