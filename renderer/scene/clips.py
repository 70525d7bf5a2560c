"""Clips: the animations of a model, each played, looped, sought, and blended with others by weights.

What a clip shows is a function of the scene's time: `Clip.play` says from when on, and a fade changes the
weight over the seconds that follow. So a simulation that reads clips needs no history, and what wasn't drawn
misses nothing.

Where several clips move the same property of a node, it is the mean of their values by their weights; a clip
that is alone there is shown whatever its weight, and without any the property has its rest pose. Bounds that
hold at all times follow from that: they hold each clip, the rest pose, and blends of several clips.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.scene.arrays import Floats, Indices
from renderer.scene.finite import check_finite
from renderer.scene.unique_names import UniqueNames

_CLIP: Final = np.dtype(
    [
        ("duration", "f8"),
        ("loops", "?"),
        ("speed", "f8"),
        ("start_time", "f8"),
        ("start_offset", "f8"),
        ("weight", "f8"),
        ("previous_weight", "f8"),
        ("fade_start", "f8"),
        ("fade_duration", "f8"),
    ]
)
"""A clip is at the second `start_offset` at the scene's time `start_time`; its weight was `previous_weight`
at `fade_start`, and is `weight` after `fade_duration` seconds more."""


class Clips:
    """The clips of a scene, as arrays with a row for each.

    Attributes:
        version: how often a clip was told something; what is computed from clips is out of date when it has
            changed.
        names: the row of each clip by its name.
        nodes: of each clip the nodes that it moves, or whose meshes it deforms.
    """

    def __init__(self) -> None:
        self.version = 0
        self.names: dict[str, int] = {}
        self._unique_names = UniqueNames()
        self.nodes: list[list[int]] = []
        self._rows = np.zeros(0, _CLIP)
        self._cache_key: tuple[float, int, int] | None = (
            None  # what `_cached` answers: one time for many tracks
        )
        self._cached: tuple[Floats, Floats] = (np.zeros(0), np.zeros(0))

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, name: str, duration: float, *, is_played: bool) -> int:
        """Add a clip that loops from the scene's time 0 on, or isn't played yet; return its row. A name that
        is taken gets an apostrophe, and a number from the third on."""
        name = self._unique_names.choose(name, self.names)
        self.names[name] = len(self)
        self.nodes.append([])
        self._rows = np.append(self._rows, np.zeros(1, _CLIP))
        self._rows[-1]["duration"], self._rows[-1]["loops"], self._rows[-1]["speed"] = duration, True, 1.0
        self._rows[-1]["weight"] = float(is_played)
        return len(self._rows) - 1

    def evaluate(self, seconds: float) -> tuple[Floats, Floats]:
        """Return the scene's time in each clip (n,), in seconds, and the weight (n,) that it has
        then."""
        asked = (seconds, self.version, len(self))
        if asked != self._cache_key:
            rows = self._rows
            times = rows["start_offset"] + (seconds - rows["start_time"]) * rows["speed"]
            duration, fade = rows["duration"], rows["fade_duration"]
            looped = np.mod(times, np.where(duration > 0.0, duration, 1.0))
            times = np.where(rows["loops"] & (duration > 0.0), looped, np.clip(times, 0.0, duration))
            share = np.clip((seconds - rows["fade_start"]) / np.where(fade > 0.0, fade, 1.0), 0.0, 1.0)
            faded = rows["previous_weight"] + share * (rows["weight"] - rows["previous_weight"])
            self._cache_key, self._cached = asked, (times, np.where(fade > 0.0, faded, rows["weight"]))
        return self._cached

    def change(self, index: int, **values: float) -> None:
        """Set fields of a clip."""
        for name, value in values.items():
            self._rows[index][name] = value
        self.version += 1

    def fade(self, index: int, now: float, weight: float, fade: float) -> None:
        """Fade the weight of a clip from its value at the scene's time `now` to `weight` in `fade`
        seconds."""
        self.change(
            index,
            previous_weight=self.evaluate(now)[1][index],
            weight=weight,
            fade_start=now,
            fade_duration=fade,
        )

    def list_overlapping(self, index: int) -> list[int]:
        """Return the other clips that move any of a clip's nodes."""
        mine = set(self.nodes[index])
        return [
            other for other, nodes in enumerate(self.nodes) if other != index and not mine.isdisjoint(nodes)
        ]


@dataclass(frozen=True, slots=True)
class Clip:
    """A clip of a scene, which `Scene.clips` has by name."""

    clips: Clips
    index: int

    @property
    def name(self) -> str:
        """The name of the animation in its file, with apostrophes if others have it too."""
        return list(self.clips.names)[self.index]

    @property
    def duration(self) -> float:
        """Its length in seconds."""
        return float(self.clips._rows["duration"][self.index])

    @property
    def nodes(self) -> Indices:
        """The rows (k,) of the scene's nodes that it moves, or whose meshes it deforms."""
        return np.array(self.clips.nodes[self.index], np.int64)

    def time_at(self, now: float) -> float:
        """Return the time in the clip, in seconds, at the scene's time `now`."""
        return float(self.clips.evaluate(now)[0][self.index])

    def weight_at(self, now: float) -> float:
        """Return its weight at the scene's time `now`."""
        return float(self.clips.evaluate(now)[1][self.index])

    def play(
        self,
        now: float,
        *,
        at: float = 0.0,
        speed: float = 1.0,
        loops: bool = True,
        weight: float = 1.0,
        fade: float = 0.0,
        alone: bool = False,
    ) -> None:
        """Play the clip from the scene's time `now` on.

        Args:
            at: where in the clip it begins, in seconds.
            speed: seconds of the clip in one of the scene: 0 holds it, below 0 it runs backwards.
            loops: whether it begins again at its end, else it stays there.
            weight: its share where several clips move the same.
            fade: the seconds in which its weight goes from the present one to `weight`.
            alone: whether the clips that move any of the same nodes are stopped, in as many seconds.
        """
        check_finite("Clip.play", now=now, at=at, speed=speed)
        self._check("Clip.play", weight=weight, fade=fade)
        self.clips.fade(self.index, now, weight, fade)
        self.clips.change(self.index, start_time=now, start_offset=at, speed=speed, loops=loops)
        for other in self.clips.list_overlapping(self.index) if alone else ():
            self.clips.fade(other, now, 0.0, fade)

    def seek(self, now: float, at: float) -> None:
        """Be `at` seconds into the clip at the scene's time `now`; speed and weight stay."""
        check_finite("Clip.seek", now=now, at=at)
        self.clips.change(self.index, start_time=now, start_offset=at)

    def stop(self, now: float, fade: float = 0.0) -> None:
        """Stop playing at the scene's time `now`, or `fade` seconds later."""
        check_finite("Clip.stop", now=now)
        self._check("Clip.stop", fade=fade)
        self.clips.fade(self.index, now, 0.0, fade)

    def _check(self, call: str, **values: float) -> None:
        for name, value in values.items():
            rules.check_non_negative(rules.BAD_CLIP, f"{call}({name}=...)", value)


def make_clips(clips: Clips, rows: NDArray[np.int64]) -> dict[str, Clip]:
    """Return the clips of a scene by name; `rows` are the scene's nodes by the ids that `Clips.nodes` has."""
    clips.nodes = [rows[ids].tolist() for ids in clips.nodes]
    return {name: Clip(clips, index) for name, index in clips.names.items()}
