"""Animations of nodes: keys on tracks, evaluated all at once, and how far they move what hangs on them.

A track animates the translation, the rotation or the scale of one node in a clip. The keys of all tracks lie
in one array in which each track begins after the end of the one before, so that one binary search finds the
keys of every track. Between two keys a track is constant, linear (rotations follow the great circle) or a
cubic Hermite curve, as in glTF. What several clips move is the mean by their weights; of rotations, that of
quaternions on the same side.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices, list_ranges
from renderer.scene.catch_up import Recompute
from renderer.scene.clips import Clips
from rhi.math.indexing import reduce_runs, repeat_each

STEP, LINEAR, CUBIC = range(3)
"""The ways of interpolating between two keys."""

TRANSLATION, ROTATION, SCALE, WEIGHTS = range(4)
"""The properties that a track may animate."""

_ARC: Final = np.pi / 32.0  # a turn is divided into parts of at most this angle, whose error is bounded
_PIECES: Final = 8  # into which a segment of a cubic rotation is divided
_WIDEST: Final = np.cos(1.0)  # of the half angle between quaternions that are still treated as one direction
_BLENDED: Final = np.cos(0.24 * np.pi)  # the same where signs are chosen: any two in the cone have the same


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """The keys of one track.

    Attributes:
        target: TRANSLATION, ROTATION, SCALE or WEIGHTS.
        kind: STEP, LINEAR or CUBIC.
        times: (k,) seconds, ascending.
        values: (k, size); of a cubic track (k, 3, size): the tangent before each key, its value, the tangent
            after it.
        clip: the row of the clip that it belongs to.
    """

    target: int
    kind: int
    times: Floats
    values: Floats
    clip: int

    @property
    def keys(self) -> Floats:
        """The values (k, size) at the keys."""
        return self.values[:, 1] if self.kind == CUBIC else self.values


class PropertyTracks:
    """A property of k owners and its tracks, each owner's together; quaternions are x, y, z, w.

    Attributes:
        rest: (k, size), the values where no clip is played.
    """

    def __init__(self, tracks: Sequence[Track], owners: Indices, rest: Floats, clips: Clips) -> None:
        order = np.argsort(owners, kind="stable")
        self._tracks = tracks = [tracks[number] for number in order.tolist()]
        self.rest, self._clips = rest, clips
        self._firsts = np.searchsorted(owners[order], np.arange(len(rest) + 1))  # the tracks of each owner
        self._is_single = bool((np.diff(self._firsts) <= 1).all())
        counts = np.array([len(track.times) for track in tracks], np.int64)
        self._ends = np.cumsum(counts)
        self._starts = self._ends - counts
        begins = np.array([track.times[0] for track in tracks])
        lengths = np.array([track.times[-1] for track in tracks]) - begins
        self._kind = np.array([track.kind for track in tracks])
        self._is_rotation = any(track.target == ROTATION for track in tracks)
        self._clip = np.array([track.clip for track in tracks], np.int64)
        self._begin, self._end = begins, begins + lengths
        shift = np.concatenate([[0.0], np.cumsum(lengths + 1.0)])[: len(tracks)] - begins
        self._times = np.concatenate([np.zeros(0), *(track.times for track in tracks)])
        self._search = self._times + repeat_each(shift, counts)
        self._shift = shift
        keys = [_unit(t.keys) if t.target == ROTATION and t.kind != CUBIC else t.keys for t in tracks]
        none = np.zeros((0, rest.shape[1]))
        self._values = np.concatenate([none, *keys])
        self._before, self._after = (
            np.concatenate(
                [none, *(t.values[:, side] if t.kind == CUBIC else 0.0 * t.values for t in tracks)]
            )
            for side in (0, 2)
        )

    def evaluate(self, owners: Indices, seconds: float) -> Floats:
        """Return the values (j, size) of `owners` (j,) at the scene's time."""
        values = self.rest[owners]
        if not self._tracks:
            return values
        first = self._firsts[owners]
        counts = self._firsts[owners + 1] - first
        if self._is_single:
            owner_index = np.flatnonzero(counts)
            rows = first[owner_index]
        else:
            owner_index = repeat_each(np.arange(len(owners)), counts)
            rows = list_ranges(first, counts)
        times, weights = (of_clips[self._clip[rows]] for of_clips in self._clips.evaluate(seconds))
        played = weights > 0.0
        if not played.all():
            rows = rows[played]
            owner_index = owner_index[played]
            times = times[played]
            weights = weights[played]
        sampled = self._interpolate(rows, times)
        starts = None if self._is_single else np.flatnonzero(np.diff(owner_index, prepend=-1))
        if starts is None or len(starts) == len(rows):  # one for each
            values[owner_index] = sampled
            return values
        counts = np.diff(starts, append=len(rows))
        if self._is_rotation:
            first = repeat_each(starts, counts)
            sampled *= np.where((sampled * sampled[first]).sum(1) < 0.0, -1.0, 1.0)[:, None]
        share = weights / repeat_each(reduce_runs(np.add, weights, starts), counts)
        blended = reduce_runs(np.add, share[:, None] * sampled, starts)
        several = counts > 1
        if self._is_rotation:
            blended[several] = _unit(blended[several])
        values[owner_index[starts]] = blended
        return values

    def _interpolate(self, tracks: Indices, local: Floats) -> Floats:
        """Return the values (j, size) of `tracks` (j,), each at a time `local` (j,) of its clip."""
        local = np.clip(local, self._begin[tracks], self._end[tracks])
        first = np.searchsorted(self._search, local + self._shift[tracks], "right") - 1
        first = np.clip(first, self._starts[tracks], self._ends[tracks] - 1)
        second = np.minimum(first + 1, self._ends[tracks] - 1)
        length = self._times[second] - self._times[first]
        share = np.clip((local - self._times[first]) / np.where(length > 0.0, length, 1.0), 0.0, 1.0)[:, None]
        a, b = self._values[first], self._values[second]
        kind = self._kind[tracks]
        linear = (1.0 - share) * a + share * b
        result: Floats = np.where((kind == STEP)[:, None], np.where(share < 1.0, a, b), linear)
        if self._is_rotation and (great := kind == LINEAR).any():
            result[great] = slerp(a[great], b[great], share[great, 0])
        if (cubic := kind == CUBIC).any():
            curve = _hermite(
                a[cubic],
                self._after[first[cubic]],
                b[cubic],
                self._before[second[cubic]],
                share[cubic],
                length[cubic, None],
            )
            result[cubic] = _unit(curve) if self._is_rotation else curve
        return result

    def list_tracks(self, owner: int) -> list[Track]:
        """Return the tracks of an owner."""
        return self._tracks[self._firsts[owner] : self._firsts[owner + 1]]

    def value_bounds(self, owner: int) -> tuple[Floats, Floats]:
        """Return bounds (size,) of all values that an owner can have, unless they are rotations: of keys and
        control points, and the rest."""
        points = [self.rest[owner][None]]
        for track in self.list_tracks(owner):
            points.append(track.keys)
            if track.kind == CUBIC:
                points.append(_controls(track).reshape(-1, points[0].shape[1]))
        all_points = np.concatenate(points)
        return all_points.min(0), all_points.max(0)


class NodeMotion:
    """The motion of k nodes: a simulation for `SceneBuilder.animate`.

    Attributes:
        tracks: all tracks.
        owners: (t,) the member that each animates.
        rest: the translations (k, 3), rotations (k, 4) and scales (k, 3) where no clip is played.
    """

    catch_up: Final = Recompute()

    def __init__(
        self, tracks: Sequence[Track], owners: Indices, rest: tuple[Floats, Floats, Floats], clips: Clips
    ) -> None:
        self.tracks = tuple(tracks)
        self.owners = owners
        self.rest = rest
        self._clips = clips
        self._now = tuple(values.copy() for values in rest)
        targets = np.array([track.target for track in tracks])
        self._properties = [
            PropertyTracks([tracks[row] for row in rows.tolist()], owners[rows], rest[target], clips)
            for target in (TRANSLATION, ROTATION, SCALE)
            for rows in (np.flatnonzero(targets == target),)
        ]

    @property
    def version(self) -> int:
        """The version of the clips."""
        return self._clips.version

    def __deepcopy__(self, memo: object) -> NodeMotion:
        """Return a copy with a state of its own; the keys never change, and the clips are the scene's."""
        duplicate = copy(self)
        duplicate._now = tuple(values.copy() for values in self._now)
        return duplicate

    def set_time(self, members: Indices, seconds: float) -> None:
        """Compute the parts of the transforms of `members` (j,) at a time."""
        for values, part in zip(self._now, self._properties, strict=True):
            values[members] = part.evaluate(members, seconds)

    def transforms(self, members: Indices) -> Floats:
        """Return the present transforms (j, 4, 4) of `members` (j,)."""
        translation, rotation, scale = self._now
        return compose(translation[members], rotation[members], scale[members])

    def reach(self, member: int, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        """Return a box in the space of the member's parent that holds the box `lower` to `upper` (3,) at all
        times, whatever clips are played."""
        moved, turned, scaled = self._properties
        (moved_low, moved_high), (scale_low, scale_high) = (
            moved.value_bounds(member),
            scaled.value_bounds(member),
        )
        products = np.stack([lower * scale_low, lower * scale_high, upper * scale_low, upper * scale_high])
        lower, upper = products.min(0), products.max(0)
        lower, upper = _rotated_bounds(*_cover(turned.list_tracks(member), turned.rest[member]), lower, upper)
        size = max(float(np.abs([lower, upper, moved_low, moved_high]).max()), 1e-30)
        slack = 1e-8 * size  # of rounding, here and where the motion is evaluated
        return lower + moved_low - slack, upper + moved_high + slack


def compose(translation: Floats, rotation: Floats, scale: Floats) -> Floats:
    """Return transforms (..., 4, 4) of translations (..., 3), quaternions x, y, z, w (..., 4) and scales
    (..., 3)."""
    x, y, z, w = np.moveaxis(rotation, -1, 0)
    matrix = np.zeros((*translation.shape[:-1], 4, 4))
    matrix[..., 0, 0], matrix[..., 1, 1] = 1.0 - 2.0 * (y * y + z * z), 1.0 - 2.0 * (x * x + z * z)
    matrix[..., 2, 2] = 1.0 - 2.0 * (x * x + y * y)
    matrix[..., 0, 1], matrix[..., 1, 0] = 2.0 * (x * y - z * w), 2.0 * (x * y + z * w)
    matrix[..., 0, 2], matrix[..., 2, 0] = 2.0 * (x * z + y * w), 2.0 * (x * z - y * w)
    matrix[..., 1, 2], matrix[..., 2, 1] = 2.0 * (y * z - x * w), 2.0 * (y * z + x * w)
    matrix[..., :3, :3] *= scale[..., None, :]
    matrix[..., :3, 3] = translation
    matrix[..., 3, 3] = 1.0
    return matrix


def slerp(a: Floats, b: Floats, fraction: Floats) -> Floats:
    """Return rotations (j, 4) on the shorter great circles from `a` to `b` (j, 4), at `fraction` (j,) of the
    way."""
    cosine = (a * b).sum(-1)
    b = np.where(cosine[:, None] < 0.0, -b, b)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    sine = np.sin(angle)
    near = sine < 1e-6
    safe = np.where(near, 1.0, sine)
    first = np.where(near, 1.0 - fraction, np.sin((1.0 - fraction) * angle) / safe)
    second = np.where(near, fraction, np.sin(fraction * angle) / safe)
    return _unit(first[:, None] * a + second[:, None] * b)


def _hermite(
    a: Floats, leaving: Floats, b: Floats, arriving: Floats, fraction: Floats, length: Floats
) -> Floats:
    """Return points of cubic curves from `a` to `b` with the tangents `leaving` and `arriving`, per
    second."""
    s, s2, s3 = fraction, fraction**2, fraction**3
    return (
        (2.0 * s3 - 3.0 * s2 + 1.0) * a
        + length * (s3 - 2.0 * s2 + s) * leaving
        + (3.0 * s2 - 2.0 * s3) * b
        + length * (s3 - s2) * arriving
    )


def _unit(quaternions: Floats) -> Floats:
    length = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    return np.where(length > 1e-12, quaternions / np.where(length > 1e-12, length, 1.0), (0.0, 0.0, 0.0, 1.0))


def _controls(track: Track) -> Floats:
    """Return the four control points (k - 1, 4, size) of each segment of a cubic track, as a Bézier curve."""
    third = np.diff(track.times)[:, None] / 3.0
    before, keys, after = track.values[:, 0], track.values[:, 1], track.values[:, 2]
    return np.stack(
        [keys[:-1], keys[:-1] + third * after[:-1], keys[1:] - third * before[1:], keys[1:]], axis=1
    )


def _cover(tracks: Sequence[Track], rest: Floats) -> tuple[Floats, NDArray[np.float64]]:
    """Cover the rotations that tracks of one node ever give, and its rest: return rotations (j, 4), and
    angles (j,) by which each of them differs from one of these."""
    if len(tracks) < 2:
        covered = [(rest[None], np.zeros(1)), *map(_arcs, tracks)]
        return np.concatenate([turns for turns, _ in covered]), np.concatenate(
            [angles for _, angles in covered]
        )
    # Means of several are in the cone that holds the middles of all arcs, widened by these.
    turns, angles = (np.concatenate(parts) for parts in zip(*map(_arcs, tracks), strict=True))
    turns = np.where((turns @ turns[0] < 0.0)[:, None], -turns, turns)
    middle = _unit(turns.mean(0))
    half = float((np.arccos(np.clip(turns @ middle, -1.0, 1.0)) + 0.5 * angles).max()) + 1e-7  # of rounding
    return np.stack([rest, middle]), np.array([0.0, 2.0 * half if np.cos(half) > _BLENDED else np.pi])


def _arcs(track: Track) -> tuple[Floats, NDArray[np.float64]]:
    """Cover a track of rotations: return rotations (j, 4), and angles (j,) by which it differs from one of
    them."""
    keys = _unit(track.keys)
    if track.kind == STEP or len(keys) == 1:
        return keys, np.zeros(len(keys))
    if track.kind == LINEAR:
        a, b = keys[:-1], keys[1:]
        angle = 2.0 * np.arccos(np.clip(np.abs((a * b).sum(1)), 0.0, 1.0))
        parts = np.maximum(np.ceil(angle / _ARC), 1.0).astype(np.int64)
        segment = repeat_each(np.arange(len(parts)), parts)
        part = list_ranges(np.zeros_like(parts), parts)
        middles = slerp(a[segment], b[segment], (part + 0.5) / parts[segment])
        return middles, (0.5 * angle / parts)[segment]
    points = _controls(track)
    points = np.concatenate(
        [_cut(points, piece / _PIECES, (piece + 1) / _PIECES) for piece in range(_PIECES)]
    )
    middle = _unit(points.mean(1))
    length = np.linalg.norm(points, axis=-1)
    cosine = ((points * middle[:, None]).sum(-1) / np.maximum(length, 1e-300)).min(1)
    # Points in a cone around the middle: what is between them is in the cone, too, so its direction is near.
    near = (cosine > _WIDEST) & (length.min(1) > 1e-6)
    return middle, np.where(near, 2.0 * np.arccos(np.clip(cosine, -1.0, 1.0)), np.pi)


def _cut(points: Floats, start: float, end: float) -> Floats:
    """Return the control points (k, 4, size) of a part of Bézier curves, by blossoming."""

    def blossom(first: float, second: float, third: float) -> Floats:
        level = points
        for share in (first, second, third):
            level = (1.0 - share) * level[:, :-1] + share * level[:, 1:]
        return level[:, 0]

    corners = ((start, start, start), (start, start, end), (start, end, end), (end, end, end))
    return np.stack([blossom(*corner) for corner in corners], axis=1)


def _rotated_bounds(rotations: Floats, angles: Floats, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """Return a box that holds the box `lower` to `upper` under rotations that are at most `angles` (j,) from
    one of `rotations` (j, 4).

    A rotation by an angle moves a point at the distance r by at most 2 r sin(angle / 2), and never farther
    out than r.
    """
    linear = compose(np.zeros((len(rotations), 3)), rotations, np.ones((len(rotations), 3)))[:, :3, :3]
    centre, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    farthest = float(np.linalg.norm(np.maximum(np.abs(lower), np.abs(upper))))
    middle, reach = linear @ centre, np.abs(linear) @ half
    reach = reach + (2.0 * farthest * np.sin(0.5 * np.minimum(angles, np.pi)))[:, None]
    farthest *= 1.0 + 1e-12
    low, high = (middle - reach).min(0), (middle + reach).max(0)
    return np.maximum(low, -farthest), np.minimum(high, farthest)
