"""Clips: the animations of a model, each played, looped, sought, and blended with others by weights.

What a clip shows is a function of the scene's time: `Clip.play` says from when on, and a fade changes the weight over
the seconds that follow. So a simulation that reads clips needs no history, and what wasn't drawn misses nothing.

Where several clips move the same property of a node, it is the mean of their values by their weights; a clip that is
alone there is shown whatever its weight, and without any the property is at rest. Bounds that hold at all times
follow from that: they hold each clip, the rest, and means of what is moved by several.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.scene.arrays import Floats, Rows
from renderer.scene.finite import check_finite

_CLIP: Final = np.dtype(
    [
        ("duration", "f8"), ("loops", "?"), ("speed", "f8"), ("since", "f8"), ("at", "f8"),
        ("weight", "f8"), ("before", "f8"), ("faded", "f8"), ("fade", "f8"),
    ]
)  # fmt: skip
"""A clip is at the second `at` at the scene's time `since`; its weight was `before` at `faded`, and is `weight` after
`fade` seconds more."""


class Clips:
    """The clips of a scene, as arrays with a row for each.

    Attributes:
        version: how often a clip was told something; what is computed from clips is out of date when it has changed.
        names: the row of each clip by its name.
        nodes: of each clip the nodes that it moves, or whose meshes it deforms.
    """

    def __init__(self) -> None:
        self.version = 0
        self.names: dict[str, int] = {}
        self.nodes: list[list[int]] = []
        self._rows = np.zeros(0, _CLIP)
        self._asked: tuple[float, int, int] | None = None  # what `_found` answers: one time for many tracks
        self._found: tuple[Floats, Floats] = (np.zeros(0), np.zeros(0))

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, name: str, duration: float, *, is_played: bool) -> int:
        """Add a clip that loops from the scene's time 0 on, or isn't played yet; return its row. A name that is taken
        gets an apostrophe."""
        while name in self.names:
            name += "'"
        self.names[name] = len(self)
        self.nodes.append([])
        self._rows = np.append(self._rows, np.zeros(1, _CLIP))
        self._rows[-1]["duration"], self._rows[-1]["loops"], self._rows[-1]["speed"] = duration, True, 1.0
        self._rows[-1]["weight"] = float(is_played)
        return len(self._rows) - 1

    def evaluate(self, seconds: float) -> tuple[Floats, Floats]:
        """Return how far into each clip (n,) the scene's time is, in seconds, and the weight (n,) that it has then."""
        asked = (seconds, self.version, len(self))
        if asked != self._asked:
            rows = self._rows
            times = rows["at"] + (seconds - rows["since"]) * rows["speed"]
            duration, fade = rows["duration"], rows["fade"]
            looped = np.mod(times, np.where(duration > 0.0, duration, 1.0))
            times = np.where(rows["loops"] & (duration > 0.0), looped, np.clip(times, 0.0, duration))
            share = np.clip((seconds - rows["faded"]) / np.where(fade > 0.0, fade, 1.0), 0.0, 1.0)
            faded = rows["before"] + share * (rows["weight"] - rows["before"])
            self._asked, self._found = asked, (times, np.where(fade > 0.0, faded, rows["weight"]))
        return self._found

    def change(self, row: int, **values: float) -> None:
        """Set fields of a clip."""
        for name, value in values.items():
            self._rows[row][name] = value
        self.version += 1

    def fade(self, row: int, now: float, weight: float, fade: float) -> None:
        """Let the weight of a clip go from that of the scene's time `now` to another one in `fade` seconds."""
        self.change(row, before=self.evaluate(now)[1][row], weight=weight, faded=now, fade=fade)

    def find_rivals(self, row: int) -> list[int]:
        """Return the other clips that move any of a clip's nodes."""
        mine = set(self.nodes[row])
        return [other for other, nodes in enumerate(self.nodes) if other != row and not mine.isdisjoint(nodes)]


@dataclass(frozen=True, slots=True)
class Clip:
    """A clip of a scene, which `Scene.clips` has by name."""

    clips: Clips
    row: int

    @property
    def name(self) -> str:
        """The name of the animation in its file, with apostrophes if others have it too."""
        return list(self.clips.names)[self.row]

    @property
    def duration(self) -> float:
        """Its length in seconds."""
        return float(self.clips._rows["duration"][self.row])

    @property
    def nodes(self) -> Rows:
        """The rows (k,) of the scene's nodes that it moves, or whose meshes it deforms."""
        return np.array(self.clips.nodes[self.row], np.int64)

    def find_time(self, now: float) -> float:
        """Return how many seconds into the clip the scene's time `now` is."""
        return float(self.clips.evaluate(now)[0][self.row])

    def find_weight(self, now: float) -> float:
        """Return its weight at the scene's time `now`."""
        return float(self.clips.evaluate(now)[1][self.row])

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
        self.clips.fade(self.row, now, weight, fade)
        self.clips.change(self.row, since=now, at=at, speed=speed, loops=loops)
        for other in self.clips.find_rivals(self.row) if alone else ():
            self.clips.fade(other, now, 0.0, fade)

    def seek(self, now: float, at: float) -> None:
        """Be `at` seconds into the clip at the scene's time `now`; speed and weight stay."""
        check_finite("Clip.seek", now=now, at=at)
        self.clips.change(self.row, since=now, at=at)

    def stop(self, now: float, fade: float = 0.0) -> None:
        """Stop playing at the scene's time `now`, or `fade` seconds later."""
        check_finite("Clip.stop", now=now)
        self._check("Clip.stop", fade=fade)
        self.clips.fade(self.row, now, 0.0, fade)

    def _check(self, call: str, **values: float) -> None:
        for name, value in values.items():
            rules.check_amount(rules.BAD_CLIP, f"{call}({name}=...)", value)


def make_clips(clips: Clips, rows: NDArray[np.int64]) -> dict[str, Clip]:
    """Return the clips of a scene by name; `rows` are the scene's nodes by the ids that `Clips.nodes` has."""
    clips.nodes = [rows[ids].tolist() for ids in clips.nodes]
    return {name: Clip(clips, row) for name, row in clips.names.items()}
