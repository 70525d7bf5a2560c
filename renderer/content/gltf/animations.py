"""Animations of a glTF file as clips of tracks, and the motion of the nodes that they move.

All animations of a file are played together, each from its beginning when it has ended, unless an earlier one
that is played moves the same part of the same node: many exporters write an animation for each object. Others
wait until someone plays them (`renderer.scene.clips`).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.content.gltf.accessors import Accessors
from renderer.content.gltf.document import JsonObject
from renderer.content.gltf.nodes import GltfNode
from renderer.content.gltf.tracks import (
    CUBIC,
    LINEAR,
    ROTATION,
    SCALE,
    STEP,
    TRANSLATION,
    WEIGHTS,
    NodeMotion,
    Track,
)
from renderer.scene.arrays import Floats, Indices
from renderer.scene.clips import Clips
from renderer.scene.omissions import Omissions
from rhi.math.indexing import repeat_each

TARGETS: Final = {"translation": TRANSLATION, "rotation": ROTATION, "scale": SCALE, "weights": WEIGHTS}
KINDS: Final = {"LINEAR": LINEAR, "STEP": STEP, "CUBICSPLINE": CUBIC}

_LARGEST: Final = 1e30  # of a key: products of a few don't overflow


Tracks = dict[tuple[int, int], list[Track]]
"""The tracks of a file by the number of their node and their target."""


def read_tracks(root: JsonObject, accessors: Accessors, omissions: Omissions, clips: Clips) -> Tracks:
    """Add the animations to `clips`, and return their tracks."""
    tracks: Tracks = {}
    played: set[tuple[int, int]] = set()
    count = root.length("nodes")
    for order, animation in enumerate(root.children("animations")):
        samplers = animation.children("samplers")
        channels = animation.children("channels")
        used = [channel.index("sampler", len(samplers), required=True) for channel in channels]
        times = {
            n: accessors.times(samplers[n].index("input", len(accessors), required=True)) for n in set(used)
        }
        moved: dict[tuple[int, int], Track] = {}
        for channel, number in zip(channels, used, strict=True):
            target = channel.child("target")
            if "node" not in target:
                omissions.add("animations of something else than a node", channel.where)
                continue
            node = target.index("node", count, required=True)
            path = target.text("path")
            if path not in TARGETS:
                omissions.add(f"animations of {path!r}", channel.where)
                continue
            key = (node, TARGETS[path])
            if key in moved:
                channel.refuse("target", f"{path} of nodes[{node}] again", "each once in an animation")
            moved[key] = _read_track(samplers[number], accessors, TARGETS[path], times[number], len(clips))
        duration = float(max((seconds[-1] for seconds in times.values()), default=0.0))
        name = animation.text("name", "") or f"animation {order}"
        is_played = played.isdisjoint(moved)
        clips.add(name, duration, is_played=is_played)
        played |= moved.keys() if is_played else set()
        for key, track in moved.items():
            tracks.setdefault(key, []).append(track)
    return tracks


def make_motion(
    nodes: list[GltfNode], tracks: Tracks, omissions: Omissions, clips: Clips
) -> tuple[Indices, NodeMotion] | None:
    """Return the rows of the animated nodes and their motion, or None if none is animated."""
    row_of = {node.number: row for row, node in enumerate(nodes)}
    tracks_of_rows: dict[int, list[Track]] = {}
    for (number, target), several in tracks.items():
        if target == WEIGHTS or number not in row_of:
            continue
        row = row_of[number]
        if nodes[row].parts is None:
            omissions.add("animations of nodes with a matrix", nodes[row].fields.where)
        else:
            tracks_of_rows.setdefault(row, []).extend(several)
    if not tracks_of_rows:
        return None
    rows = sorted(tracks_of_rows)
    parts = [nodes[row].parts or () for row in rows]
    rest = tuple(np.array([part[at] for part in parts]) for at in range(3))
    owners = repeat_each(np.arange(len(rows)), [len(tracks_of_rows[row]) for row in rows])
    listed = [track for row in rows for track in tracks_of_rows[row]]
    return np.array(rows), NodeMotion(listed, owners, (rest[0], rest[1], rest[2]), clips)


def _read_track(sampler: JsonObject, accessors: Accessors, target: int, times: Floats, clip: int) -> Track:
    kind = KINDS[sampler.choice("interpolation", KINDS, "LINEAR")]
    number = sampler.index("output", len(accessors), required=True)
    types = {ROTATION: "VEC4", WEIGHTS: "SCALAR"}.get(target, "VEC3")
    values = accessors.floats(number, types).astype(np.float64)
    if not (np.abs(values) <= _LARGEST).all():
        accessors.fields[number].refuse("", "values that aren't finite", f"numbers up to {_LARGEST:g}")
    parts = 3 if kind == CUBIC else 1
    keys = len(times)
    per_key = len(values) // (keys * parts) if target == WEIGHTS else 1
    if len(values) != keys * parts * max(per_key, 1):
        accessors.fields[number].refuse("count", len(values), f"{keys * parts}, for {keys} keys")
    size = per_key if target == WEIGHTS else values.shape[1]
    return Track(
        target, kind, times, values.reshape((keys, 3, size) if kind == CUBIC else (keys, size)), clip
    )
