"""Camera paths: a route through the scene as arrays, one row a frame, 30 seconds at 60 Hz.

A route is given by corners. It is walked at constant speed, its corners are rounded by averaging over a
window of the way, and the camera looks at a point of the route ahead of it: turns are smooth, and the
same input gives the same frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from renderer import rules
from renderer.scene.camera import Camera, Projection
from renderer.scene.transforms import Floats
from rhi.errors import refuse

__rhi_internal__ = True

FRAMES_PER_SECOND: Final = 60
FRAME_COUNT: Final = 30 * FRAMES_PER_SECOND
_SAMPLES: Final = 8192  # per route, before it is cut into frames: 22 cm of a 1.8 km route


@dataclass(frozen=True, eq=False, slots=True)
class CameraPath:
    """`positions` and `targets`, (frames, 3) float64; `projection` is the lens."""

    positions: Floats
    targets: Floats
    projection: Projection

    def __len__(self) -> int:
        return len(self.positions)

    def camera(self, frame: int) -> Camera:
        """The camera of one frame, 0 to len - 1."""
        if not 0 <= frame < len(self):
            refuse(rules.FRAME_RANGE, "camera(frame=...)", frame, f"0 to {len(self) - 1}")
        return Camera.look_at(self.positions[frame], self.targets[frame], projection=self.projection)


def make_path(
    corners: ArrayLike,
    projection: Projection,
    rounding: float,
    ahead: float,
    sink: float = 0.0,
    frames: int = FRAME_COUNT,
) -> CameraPath:
    """A path along `corners` (k, 3), k >= 2.

    `rounding` is how many metres of the way a corner is spread over, `ahead` how many metres before the
    camera its target lies, and `sink` how far below the route.
    """
    route = np.asarray(corners, np.float64)
    lengths = np.linalg.norm(np.diff(route, axis=0), axis=1)
    total = float(lengths.sum())
    # Lead-in and lead-out along the end pieces keep the averages centred, and give the last frames a target.
    reach = rounding + ahead
    first, last = (route[1] - route[0]) / lengths[0], (route[-1] - route[-2]) / lengths[-1]
    route = np.concatenate([[route[0] - reach * first], route, [route[-1] + reach * last]])
    way = np.concatenate([[-reach, 0.0], np.cumsum(lengths), [total + reach]])

    samples = np.linspace(-reach, total + reach, _SAMPLES)
    points = np.stack([np.interp(samples, way, route[:, axis]) for axis in range(3)], axis=1)
    spacing = samples[1] - samples[0]
    window = np.hanning(max(int(rounding / spacing) | 1, 3) + 2)
    window /= window.sum()
    margin = len(window) // 2
    padded = np.pad(points, ((margin, margin), (0, 0)), "edge")
    smooth = np.stack([np.convolve(padded[:, axis], window, "valid") for axis in range(3)], axis=1)

    step = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(smooth, axis=0), axis=1))])
    start, end = np.interp([0.0, total], samples, step)
    when = np.linspace(start, end, frames)

    def at(distance: Floats) -> Floats:
        return np.stack([np.interp(distance, step, smooth[:, axis]) for axis in range(3)], axis=1)

    return CameraPath(at(when), at(when + ahead) - (0.0, sink, 0.0), projection)
