"""Rows of factors that contain each pair of values at least once: a covering array of strength two.

Faults of two effects that don't get along show in some row, and a few dozen rows do for the millions of
combinations.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Row = dict[str, Any]
Pair = tuple[int, int, int, int]

_CANDIDATES = 30
"""Rows that are tried at random for each row that is taken."""


def cover_pairs(factors: Mapping[str, Sequence[Any]], seed: int) -> list[Row]:
    """Return rows with a value of each factor, so that each pair of values of two factors is in one of them.

    The most new pairs of some random rows win, each of which begins with a pair that is missing (as AETG does:
    Cohen and others, The AETG System, 1997).
    """
    names, values = list(factors), list(factors.values())
    random = np.random.default_rng(seed)
    missing = {
        (first, first_value, second, second_value)
        for first, second in itertools.combinations(range(len(names)), 2)
        for first_value in range(len(values[first]))
        for second_value in range(len(values[second]))
    }
    rows = []
    while missing:
        ordered = sorted(missing)
        candidates = []
        for _ in range(_CANDIDATES):
            choice = [int(random.integers(len(of_factor))) for of_factor in values]
            first, choice_of_first, second, choice_of_second = ordered[int(random.integers(len(ordered)))]
            choice[first], choice[second] = choice_of_first, choice_of_second
            candidates.append(choice)
        best = max(candidates, key=lambda choice: len(list_pairs(choice) & missing))
        missing -= list_pairs(best)
        rows.append({name: values[number][best[number]] for number, name in enumerate(names)})
    return rows


def list_pairs(choice: Sequence[int]) -> set[Pair]:
    """The pairs of values in a row, by the numbers of their factors and of their values."""
    return {
        (first, choice[first], second, choice[second])
        for first, second in itertools.combinations(range(len(choice)), 2)
    }
