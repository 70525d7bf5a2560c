"""Arguments that are numbers, flags and choices, and the texts of refusals."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from rhi import Access, Format, Scissor, ValidationError
from rhi.errors.arguments import ArgumentChecker

CHECK = ArgumentChecker("a call")


@pytest.mark.parametrize("value", [3, np.int8(3), np.uint64(3), np.array(3)], ids=repr)
def test_a_whole_number_becomes_an_int(value: Any) -> None:
    assert type(CHECK.integer("n", value, 3, 3)) is int


@pytest.mark.parametrize(
    "value", [3.0, True, np.bool_(True), "3", None, np.array([3]), np.float64(3), 2, 4], ids=repr
)
def test_anything_else_is_no_whole_number(value: Any) -> None:
    with pytest.raises(ValidationError) as caught:
        CHECK.integer("n", value, 3, 3)
    assert caught.value.given.startswith("n=")


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0.5, 0.5), (np.float32(0.5), 0.5), (1, 1), (np.int16(1), 1), (Fraction(1, 2), 0.5)],
    ids=repr,
)
def test_a_number_becomes_a_float_or_stays_an_int(value: Any, expected: float) -> None:
    converted = CHECK.number("n", value, 0, 1)
    assert (converted, type(converted)) == (expected, type(expected))


@pytest.mark.parametrize(
    "value",
    [True, "0.5", 1j, None, float("nan"), float("inf"), 1e39, 10**400, -0.1, 1.1],
    ids=lambda v: repr(v)[:8],
)
def test_anything_else_is_no_number(value: Any) -> None:
    with pytest.raises(ValidationError):
        CHECK.number("n", value, 0, 1)


def test_a_color_keeps_ints_for_targets_of_integers() -> None:
    assert CHECK.color("c", (1, np.uint32(2**32 - 1), 0.5, np.float32(2))) == (1, 2**32 - 1, 0.5, 2.0)
    assert CHECK.color("c", np.zeros(4)) == (0, 0, 0, 0)
    for wrong in ((0, 0, 0), "0000", (0, 0, 0, True), (0, 0, 0, None), {0, 1, 2, 3}, 0):
        with pytest.raises(ValidationError):
            CHECK.color("c", wrong)


def test_a_refusal_names_the_argument_and_the_allowed_values() -> None:
    with pytest.raises(ValidationError) as caught:
        CHECK.choice("access", "read", Access)
    error = caught.value
    assert (error.rule.id, error.call, error.given) == ("device-argument", "a call", "access='read'")
    assert error.allowed == "Access.READ, Access.WRITE, Access.READ_WRITE"


def test_of_many_choices_a_refusal_shows_the_first() -> None:
    with pytest.raises(ValidationError, match=rf"one of the {len(Format)} members of Format: Format\.R8, "):
        CHECK.choice("format", 1, Format)


def test_a_long_value_is_cut() -> None:
    with pytest.raises(ValidationError) as caught:
        CHECK.integer("n", "x" * 1000)
    assert len(caught.value.given) < 150
    assert caught.value.given.endswith("(str)")


def test_a_float_for_a_whole_number_gets_a_tip() -> None:
    with pytest.raises(ValidationError) as caught:
        Scissor(0, 0, 8 / 2, 8)
    assert "//" in caught.value.tip
    with pytest.raises(ValidationError) as caught:
        Scissor(0, 0, "8", 8)  # type: ignore[arg-type]
    assert "//" not in caught.value.tip
