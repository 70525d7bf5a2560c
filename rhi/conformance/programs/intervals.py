"""Intervals of float64: the smallest and the largest number that a device may store."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Interval:
    """Arrays of lower and upper bounds; an unknown number is −∞ to ∞, which includes NaN."""

    low: Float
    high: Float

    @staticmethod
    def of(value: ArrayLike) -> Interval:
        """Return exact numbers."""
        array = np.asarray(value, np.float64)
        return Interval(array, array)

    def __getitem__(self, key: Any) -> Interval:
        return Interval(self.low[key], self.high[key])

    def __add__(self, other: Interval) -> Interval:
        with np.errstate(all="ignore"):
            return _ordered(self.low + other.low, self.high + other.high)

    def __sub__(self, other: Interval) -> Interval:
        with np.errstate(all="ignore"):
            return _ordered(self.low - other.high, self.high - other.low)

    def __mul__(self, other: Interval) -> Interval:
        with np.errstate(all="ignore"):
            ends = [a * b for a in (self.low, self.high) for b in (other.low, other.high)]
            return _ordered(np.minimum.reduce(ends), np.maximum.reduce(ends))

    def minimum(self, other: Interval) -> Interval:
        return Interval(np.minimum(self.low, other.low), np.minimum(self.high, other.high))

    def maximum(self, other: Interval) -> Interval:
        return Interval(np.maximum(self.low, other.low), np.maximum(self.high, other.high))

    def clip(self, low: float, high: float) -> Interval:
        return Interval(np.clip(self.low, low, high), np.clip(self.high, low, high))

    def widen(self, error: float | Float) -> Interval:
        return Interval(self.low - error, self.high + error)

    @property
    def size(self) -> Float:
        """The largest magnitude."""
        return np.asarray(np.maximum(np.abs(self.low), np.abs(self.high)))

    def unite(self, possible: Mask, other: Interval, other_possible: Mask) -> Interval:
        """Union of two outcomes of which one happens."""
        low = np.where(
            possible, np.where(other_possible, np.minimum(self.low, other.low), self.low), other.low
        )
        high = np.where(
            possible, np.where(other_possible, np.maximum(self.high, other.high), self.high), other.high
        )
        return Interval(low, high)


def _ordered(low: Float, high: Float) -> Interval:
    unknown = np.isnan(low) | np.isnan(high)
    return Interval(np.where(unknown, -np.inf, low), np.where(unknown, np.inf, high))


def join(*parts: Interval) -> Interval:
    return Interval(
        np.concatenate([p.low for p in parts], axis=-1), np.concatenate([p.high for p in parts], axis=-1)
    )


@dataclass(slots=True)
class MaskBounds:
    """The samples that certainly pass, and those that possibly do."""

    must: Mask
    may: Mask

    def __and__(self, other: MaskBounds) -> MaskBounds:
        return MaskBounds(self.must & other.must, self.may & other.may)


def compare(function: Any, new: Interval, stored: Interval) -> MaskBounds:
    """Where `new OP stored` must hold, and where it may."""
    name = function.value
    shape = np.broadcast(new.low, stored.low).shape
    both = new.low == new.high
    equal_must = both & (stored.low == stored.high) & (new.low == stored.low)
    equal_may = (new.low <= stored.high) & (new.high >= stored.low)
    less = MaskBounds(new.high < stored.low, new.low < stored.high)
    greater = MaskBounds(new.low > stored.high, new.high > stored.low)
    outcomes = {
        "never": MaskBounds(np.zeros(shape, bool), np.zeros(shape, bool)),
        "always": MaskBounds(np.ones(shape, bool), np.ones(shape, bool)),
        "less": less,
        "greater": greater,
        "equal": MaskBounds(equal_must, equal_may),
        "not_equal": MaskBounds(~equal_may, ~equal_must),
        "less_equal": MaskBounds(~greater.may, ~greater.must),
        "greater_equal": MaskBounds(~less.may, ~less.must),
    }
    return outcomes[name]
