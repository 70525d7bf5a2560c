"""A budget that frames keep while a viewer runs: each is drawn with the most accurate settings that are fast enough.

The settings are those of a front, as `accuracy --output` finds it: each is slower and more accurate than the one
before. Its times are those of the views that it was found with. So what frames take now scales all of them, and what
settings were found to take here counts more than what the front says of them.

One slow frame changes nothing: the median of some frames does. More accurate settings are chosen only with room to
spare, so that they don't alternate with those that were too slow for them.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Final

import numpy as np

from renderer import rules
from renderer.scene.files import read_json
from renderer.settings import RenderSettings, from_plain, to_plain
from rhi.errors import refuse

_FRAMES: Final = 9
"""Frames of which the median is compared with the budget."""
_SETTLING: Final = 3
"""Frames after a change that say nothing: they make what the new settings need."""
_ROOM: Final = 0.85
"""The share of the budget that more accurate settings must be expected to take at most."""


@dataclass(frozen=True, slots=True)
class BudgetStep:
    """Settings, the milliseconds of a frame that they took when they were found, and their error in levels of 255."""

    settings: RenderSettings
    milliseconds: float
    error: float


def save_steps(path: Path, steps: Sequence[BudgetStep]) -> None:
    """Write a front as JSON."""
    path.write_text(json.dumps([to_plain(step) for step in steps], indent=2) + "\n")


def load_steps(path: Path) -> list[BudgetStep]:
    """Read what `save_steps` has written.

    Raises:
        ValidationError: `visibility-bad-settings` if the file holds something else.
        OSError: the file can't be read.
    """
    call, default = f"load_steps({str(path)!r})", BudgetStep(RenderSettings(), 1.0, 0.0)
    try:
        steps = [from_plain(BudgetStep, one, call, default) for one in read_json(path)]
    except (ValueError, TypeError):
        steps = []
    if not steps or not all(step.milliseconds > 0.0 for step in steps):
        refuse(rules.BAD_SETTINGS, call, "no front", "front.json, as `accuracy --output` writes it")
    return steps


class FrameBudget:
    """Chooses among the steps of a front, frame after frame.

    Attributes:
        steps: the fastest first. place: the one that frames are drawn with.
        milliseconds: the most that a frame may take. frames, over: how many were drawn, and took more.
    """

    def __init__(self, steps: Sequence[BudgetStep], milliseconds: float) -> None:
        self.steps = sorted(steps, key=lambda step: step.milliseconds)
        self.milliseconds = milliseconds
        self.frames = self.over = 0
        self._expected = np.array([step.milliseconds for step in self.steps])
        self._times: deque[float] = deque(maxlen=_FRAMES)
        self._settling = _SETTLING
        self._is_new = False
        self.place = self._choose(len(self.steps))

    @property
    def settings(self) -> RenderSettings:
        """The settings that frames are to be drawn with."""
        return self.steps[self.place].settings

    def note(self, milliseconds: float) -> bool:
        """Note what a frame took; return whether `settings` are others now."""
        self.frames += 1
        self.over += milliseconds > self.milliseconds
        if self._settling:
            self._settling -= 1
            return False
        self._times.append(milliseconds)
        if len(self._times) < _FRAMES:
            return False
        now, place, expected = median(self._times), self.place, self._expected
        if self._is_new:  # what others take here was found out before
            expected[:place] = np.minimum(expected[:place], now)
            expected[place:] = np.maximum(expected[place:], now)
            expected[place] = now
            self._is_new = False
        else:
            expected *= now / expected[place]
        self.place = self._choose(place)
        if self.place == place:
            return False
        self._times.clear()
        self._settling, self._is_new = _SETTLING, True
        return True

    def _choose(self, place: int) -> int:
        """Return the most accurate settings that are expected to be fast enough; those beyond `place` with room."""
        bounds = np.where(np.arange(len(self.steps)) > place, _ROOM, 1.0) * self.milliseconds
        return int(np.flatnonzero(self._expected <= bounds)[-1:].sum())

    def describe(self) -> str:
        """Return the budget, the settings' place and error, and the share of frames that took more."""
        share = self.over / max(self.frames, 1)
        return (
            f"budget {self.milliseconds:g} ms: {self.place + 1} of {len(self.steps)}, "
            f"{self.steps[self.place].error:.2g} levels off, {share:.0%} over"
        )
