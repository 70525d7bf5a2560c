"""Keeps frames within a time budget: each is drawn with the most accurate settings that are fast enough.

The settings are those of a front, as `accuracy --output` finds it: each is slower and more accurate than the
one before. Its times are those of the views that it was found with. So what frames take now scales all of
them, and what settings were found to take here counts more than what the front says of them.

One slow frame changes nothing: the median of some frames does. More accurate settings are chosen only with
room to spare, so that they don't alternate with those that were too slow for them.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

from renderer import rules
from renderer.scene.file_versions import KEY, FileVersions
from renderer.scene.files import read_json
from renderer.scene.settings_versions import rename_settings
from renderer.settings import RenderSettings, from_json, to_json
from rhi.errors import RhiError, refuse

_FRAMES: Final = 9
"""The budget is compared with the median of this many frames."""
_SETTLING: Final = 3
"""Frames ignored after a change: they create what the new settings need."""
_ROOM: Final = 0.85
"""The fraction of the budget that more accurate settings must be expected to stay within."""


@dataclass(frozen=True, slots=True)
class BudgetStep:
    """Settings of a Pareto front, with the milliseconds of a frame when they were measured, and their error
    in levels of 255."""

    settings: RenderSettings
    milliseconds: float
    error: float


def save_steps(path: Path, steps: Sequence[BudgetStep]) -> None:
    """Write a Pareto front as JSON."""
    content = {KEY: VERSIONS.current, "steps": [to_json(step) for step in steps]}
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def load_steps(path: Path) -> list[BudgetStep]:
    """Read the JSON of `save_steps`.

    Raises:
        ValidationError: `visibility-bad-settings` if the file holds something else, `file-version` for a newer
            version.
        OSError: the file can't be read.
    """
    call, default = f"load_steps({str(path)!r})", BudgetStep(RenderSettings(), 1.0, 0.0)
    try:
        content = read_json(path)
        fields = VERSIONS.migrate({"steps": content} if isinstance(content, list) else dict(content), call)
        steps = [from_json(BudgetStep, values, call, default) for values in fields["steps"]]
    except RhiError:
        raise
    except (ValueError, TypeError, KeyError):
        steps = []
    if not steps or not all(step.milliseconds > 0.0 for step in steps):
        refuse(
            rules.BAD_SETTINGS,
            call,
            "a file without a Pareto front",
            "pareto_front.json, as `accuracy --output` writes it",
        )
    return steps


def _migrate_1(content: dict[str, Any]) -> dict[str, Any]:
    """Rename settings; files of version 1 were the list of steps alone."""
    for step in content.get("steps", ()):
        rename_settings(step.get("settings") if isinstance(step, dict) else None)
    return content


VERSIONS: Final = FileVersions("Pareto fronts", (_migrate_1,))
"""The versions of files of Pareto fronts."""


class FrameBudget:
    """Selects one of the settings of a Pareto front, frame after frame.

    Attributes:
        steps: the fastest first. place: the one that frames are drawn with.
        milliseconds: the most that a frame may take.
        frames, over: how many were drawn, and took more.
    """

    def __init__(self, steps: Sequence[BudgetStep], milliseconds: float) -> None:
        self.steps = sorted(steps, key=lambda step: step.milliseconds)
        self.milliseconds = milliseconds
        self.frames = self.over = 0
        self._expected = np.array([step.milliseconds for step in self.steps])
        self._times: deque[float] = deque(maxlen=_FRAMES)
        self._settling = _SETTLING
        self._is_new = False
        self.step_index = self._choose(len(self.steps))

    @property
    def settings(self) -> RenderSettings:
        """The settings that frames are to be drawn with."""
        return self.steps[self.step_index].settings

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
        now, step_index, expected = median(self._times), self.step_index, self._expected
        if self._is_new:  # what others take here was found out before
            expected[:step_index] = np.minimum(expected[:step_index], now)
            expected[step_index:] = np.maximum(expected[step_index:], now)
            expected[step_index] = now
            self._is_new = False
        else:
            expected *= now / expected[step_index]
        self.step_index = self._choose(step_index)
        if self.step_index == step_index:
            return False
        self._times.clear()
        self._settling, self._is_new = _SETTLING, True
        return True

    def _choose(self, step_index: int) -> int:
        """Return the most accurate settings that are expected to be fast enough; those beyond `step_index`
        with room."""
        bounds = np.where(np.arange(len(self.steps)) > step_index, _ROOM, 1.0) * self.milliseconds
        return int(np.flatnonzero(self._expected <= bounds)[-1:].sum())

    def describe(self) -> str:
        """Return the budget, the settings' place and error, and the share of frames that took more."""
        share = self.over / max(self.frames, 1)
        return (
            f"budget {self.milliseconds:g} ms: {self.step_index + 1} of {len(self.steps)}, "
            f"{self.steps[self.step_index].error:.2g} levels off, {share:.0%} over"
        )
