"""Frame statistics: how many frames the last second had, the time from one to the next, and that of
processors."""

from __future__ import annotations

from collections import deque
from typing import Final

_MAX_FRAMES: Final = 1000


class FrameCounter:
    """Counts frames by the times at which they begin.

    Attributes:
        frames: all that were counted.
    """

    def __init__(self) -> None:
        self.frames = 0
        self._times: deque[float] = deque(maxlen=_MAX_FRAMES)
        self._processor: deque[float] = deque(maxlen=_MAX_FRAMES)

    def add(self, time: float, processor: float = 0.0) -> None:
        """Count a frame that begins at a time, and the seconds that processors have worked until then; frames
        of more than a second ago are forgotten."""
        self.frames += 1
        self._times.append(time)
        self._processor.append(processor)
        while time - self._times[0] > 1.0:
            self._times.popleft()
            self._processor.popleft()

    @property
    def rate(self) -> float:
        """Frames a second over the last second; 0 of less than two."""
        took = self._times[-1] - self._times[0] if self._times else 0.0
        return (len(self._times) - 1) / took if took > 0.0 else 0.0

    @property
    def processor(self) -> float:
        """Seconds that processors have worked for a frame over the last second, the mean."""
        return (
            (self._processor[-1] - self._processor[0]) / max(len(self._processor) - 1, 1)
            if self._processor
            else 0.0
        )

    def describe(self) -> str:
        """Return the rate and the mean time of a frame as text."""
        rate = self.rate
        return f"{rate:.0f} frames/s   {1e3 / rate:.1f} ms" if rate else "- frames/s"
