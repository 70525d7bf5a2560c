"""Temporal anti-aliasing: its settings, the offsets of samples in pixels, and the state of a view between frames.

In each frame the projection is shifted by a part of a pixel, so that a pixel's sample is elsewhere in the pixel; the
frames of a while have samples all over it. The offsets are those of Halton's sequence in bases 2 and 3, of which any
run of frames is spread evenly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from renderer import rules
from renderer.scene import Camera, Depth, Projection, Scene
from renderer.scene.arrays import Floats
from rhi import Device, refuse
from rhi.math import is_parallel

_MAX_FRAMES: Final = 1024
_PERIOD: Final = 1024
"""The frames after which offsets repeat."""
_CUT_COSINE: Final = 0.87
"""The view is cut where it turns by more than 30° from one frame to the next."""
_CUT_SHARE: Final = 1.0 / 16.0
"""The view is cut where it moves by more than this share of the scene's diagonal from one frame to the next."""
STILL_AFTER: Final = 4
"""The frames without a change after which a view counts as still."""


@dataclass(frozen=True, slots=True)
class TemporalSettings:
    """Settings of temporal anti-aliasing.

    Attributes:
        is_on: whether there is any.
        frames: the frames that a pixel is the mean of while anything moves, 2 to 1024; older ones fade.
        still_frames: the same while nothing at all changes, 2 to 1024.
        deviations: how far the history of a pixel may be from the mean of its 3 × 3 neighbours, in their standard
            deviations, 0 to 10; less leaves fewer ghosts and more flicker.
        bits: those of a channel of the history, 16 or 32.
    """

    is_on: bool = False
    frames: int = 8
    still_frames: int = 64
    deviations: float = 1.25
    bits: int = 16

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_TEMPORAL)
        for name in ("frames", "still_frames"):
            value = getattr(self, name)
            if not 2 <= value <= _MAX_FRAMES:
                allowed = f"a whole number from 2 to {_MAX_FRAMES}"
                refuse(rules.BAD_TEMPORAL, f"TemporalSettings({name}=...)", value, allowed)
        if not 0.0 <= self.deviations <= 10.0:
            refuse(rules.BAD_TEMPORAL, "TemporalSettings(deviations=...)", self.deviations, "from 0 to 10")
        if self.bits not in (16, 32):
            refuse(rules.BAD_TEMPORAL, "TemporalSettings(bits=...)", self.bits, "16 or 32")


NO_HISTORY: Final = TemporalSettings()
"""Frames of their own, as they are unless told otherwise."""


@dataclass(frozen=True)
class ShiftedProjection:
    """A projection whose image is shifted on the screen, by `x` to the right and `y` upwards in clip space."""

    projection: Projection
    x: float
    y: float

    @property
    def depth(self) -> Depth:
        """The direction of depth."""
        return self.projection.depth

    @cached_property
    def matrix(self) -> Floats:
        """The matrix (4, 4) float64 from view space to clip space."""
        m = self.projection.matrix.copy()
        m[0] += self.x * m[3]
        m[1] += self.y * m[3]
        m.setflags(write=False)
        return m

    def with_aspect(self, aspect: float) -> ShiftedProjection:
        """Return the same projection for an image of width / height = `aspect`."""
        return replace(self, projection=self.projection.with_aspect(aspect))


def compute_offset(index: int, samples: int = 1) -> tuple[float, float]:
    """The offset (x, y) of a frame's samples from the middle of their pixels: -0.5 to 0.5, y downwards (Halton 1960,
    bases 2 and 3). With several samples per pixel it is as small as the part of a pixel that each stands for."""
    number, side = index % _PERIOD + 1, samples**-0.5
    return side * (_invert_radix(number, 2) - 0.5), side * (_invert_radix(number, 3) - 0.5)


def _invert_radix(number: int, base: int) -> float:
    """The fraction whose digits in a base are those of a number, mirrored at the point."""
    fraction, share = 0.0, 1.0 / base
    while number:
        number, digit = divmod(number, base)
        fraction += digit * share
        share /= base
    return fraction


def shift_samples(camera: Camera, offset: tuple[float, float], size: tuple[int, int]) -> Camera:
    """The camera that samples each pixel of an image of `size` at this offset (x, y) from its middle."""
    (x, y), (width, height) = offset, size
    return camera.with_projection(ShiftedProjection(camera.projection, -2.0 * x / width, 2.0 * y / height))


def is_cut(scene: Scene, last: Camera, camera: Camera) -> bool:
    """Return whether a view shows something else than in the last frame, so that its history is of no use."""
    if (is_parallel(last.projection), last.projection.depth) != (
        is_parallel(camera.projection),
        camera.projection.depth,
    ):
        return True
    lower, upper = scene.bounds
    moved = float(np.linalg.norm(camera.position - last.position))
    farthest = _CUT_SHARE * float(np.linalg.norm(upper - lower))
    return float(last.forward @ camera.forward) < _CUT_COSINE or moved > farthest


class TemporalHistory:
    """The cameras of a view's frame and of the frame in its history, and the frame's offset.

    Attributes:
        camera: that of this frame, whose samples are in the middles of pixels.
        previous: the same of the frame that the history holds; None if that is of no use.
        offset: that of this frame's samples from the middles of their pixels, in pixels.
        is_still: whether this frame shows what the last ones showed, but for the offset.
        has_motion: whether this frame has stored how objects have moved.
    """

    def __init__(self, device: Device) -> None:
        self.camera: Camera | None = None
        self.previous: Camera | None = None
        self.offset = (0.0, 0.0)
        self.is_still = self.has_motion = False
        self._is_resolved = False

    def begin_frame(
        self, scene: Scene, camera: Camera, offset: tuple[float, float], *, is_still: bool, forgets: bool
    ) -> None:
        """Begin a frame of `camera`; `forgets` the history if it is of no use."""
        last = self.camera if self._is_resolved and not forgets else None
        self.previous = None if last is None or is_cut(scene, last, camera) else last
        self.camera, self.offset, self.is_still = camera, offset, is_still
        self._is_resolved = self.has_motion = False

    def end_frame(self) -> None:
        """Note that this frame is in the history."""
        self._is_resolved = True

    def destroy(self) -> None:
        """Do nothing: there is nothing on the device."""
