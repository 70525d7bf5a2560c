"""The race of combinations: each is drawn view by view, and ends as soon as another one surely beats it.

All combinations draw the same frames and are compared in the same pixels. So differences of errors are exact,
and those of times are paired: what a frame shows and costs in itself cancels out. Views begin with the worst
one. The error of a combination is that of its worst view, so after the first view it can only grow.

A combination is beaten by a more accurate one unless it may be faster by more than `MIN_GAIN`. Whatever saves
less isn't worth a worse image, and noise of that size doesn't change the result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from renderer.scene.arrays import Floats

MAX_TRIED: Final = 120
"""The most combinations that a search tries."""
MIN_GAIN: Final = 0.03
"""The fraction of the time that a less accurate combination must save."""
_DEVIATIONS: Final = 2.0
"""Standard deviations of a median ratio between what was measured and what is sure."""
_LEAST_NOISE: Final = 0.02
"""The least standard deviation of the logarithm of a frame's time ratio."""
_UNKNOWN_NOISE: Final = 0.1
"""The same of fewer frames than show it."""
_MIN_FRAMES: Final = 3


@dataclass(frozen=True, eq=False, slots=True)
class SettingsTrial:
    """A combination of values in the views that it was drawn in.

    Attributes:
        values: the value of each quality setting.
        errors: of each view, in levels.
        seconds: processor time of each frame.
        is_complete: whether it was drawn in all views.
    """

    values: dict[str, str]
    errors: tuple[float, ...]
    seconds: Floats
    is_complete: bool = True

    @property
    def error(self) -> float:
        """The error in the worst view."""
        return max(self.errors)

    @property
    def rank(self) -> tuple[float, tuple[str, ...]]:
        """The order of trials by accuracy, whatever their times are."""
        return self.error, tuple(self.values.values())

    def beats(self, other: SettingsTrial) -> bool:
        """True if this complete trial is as accurate as the other's views, and the other surely saves less than
        `MIN_GAIN` of its time."""
        if self.rank >= other.rank:
            return False
        return is_surely_slower(other.seconds, self.seconds[: len(other.seconds)])


def is_surely_slower(seconds: Floats, others: Floats) -> bool:
    """True if the median ratio of times of the same frames is surely above 1 − `MIN_GAIN`."""
    ratios = np.log(seconds / others)
    centre = float(np.median(ratios))
    noise = _UNKNOWN_NOISE
    if len(ratios) >= _MIN_FRAMES:
        noise = max(1.4826 * float(np.median(np.abs(ratios - centre))), _LEAST_NOISE)
    return bool(centre - _DEVIATIONS * 1.2533 * noise / np.sqrt(len(ratios)) >= np.log(1.0 - MIN_GAIN))


def select_front(trials: Iterable[SettingsTrial]) -> list[SettingsTrial]:
    """The complete trials that no more accurate one of them beats, the most accurate first."""
    front: list[SettingsTrial] = []
    complete = [trial for trial in trials if trial.is_complete]
    for trial in sorted(complete, key=lambda trial: trial.rank):
        if not any(other.beats(trial) for other in front):
            front.append(trial)
    return front


def search(
    values_by_setting: Mapping[str, Sequence[str]],
    start: Iterable[dict[str, str]],
    measure: Callable[[dict[str, str], Sequence[SettingsTrial]], SettingsTrial],
    max_tried: int = MAX_TRIED,
) -> list[SettingsTrial]:
    """Search the combinations of values that no tried one beats; the most accurate first.

    Args:
        values_by_setting: the values of each quality setting, in order.
        start: combinations to begin with.
        measure: draws a combination, until one of the present front beats it.
        max_tried: the most combinations to try.
    """
    measured: dict[tuple[str, ...], SettingsTrial] = {}
    front: list[SettingsTrial] = []
    untried = [tuple(combination[name] for name in values_by_setting) for combination in start]
    while untried and len(measured) < max_tried:
        for key in untried[: max_tried - len(measured)]:
            measured[key] = measure(dict(zip(values_by_setting, key, strict=True)), front)
            front = select_front(measured.values())
        keys = [tuple(trial.values[name] for name in values_by_setting) for trial in front]
        near = dict.fromkeys(other for key in keys for other in list_neighbours(values_by_setting, key))
        untried = [key for key in near if key not in measured]
    return front


def list_neighbours(
    values_by_setting: Mapping[str, Sequence[str]], key: tuple[str, ...]
) -> Iterator[tuple[str, ...]]:
    """Yield the combinations in which one quality setting has the next value, up or down."""
    for number, values in enumerate(values_by_setting.values()):
        position = values.index(key[number])
        for other in values[max(position - 1, 0) : position + 2]:
            if other != key[number]:
                yield (*key[:number], other, *key[number + 1 :])
