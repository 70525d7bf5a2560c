"""Costs and errors of levels of detail in a field of dense meshes.

Each object is a sphere with bumps, of some thousand triangles, with up to 6 levels; the field leads away from the eye.
Frames have a shadow map of the sun. The variants draw with other limits of the error in pixels, 0 for full meshes, and
take turns, round by round, in one process. Times are medians over the rounds, from the frame's begin until the device
is finished; *different* is the share of pixels, in percent, that differ from the full meshes' by more than 8 levels of
255.

    python benchmarks/detail.py [--backend gl] [--objects 1024] [--rounds 7] [--json]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Column, Record, Subject, average, compare, ratio, time
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Scene, SceneBuilder, translation
from renderer.scene.meshes import MeshGeometry, make_geometry

LIMITS: Final = (0.0, 0.5, 1.0, 2.0, 4.0)
SIZE: Final = (960, 540)
SPACING: Final = 3.0
COLUMNS: Final[dict[str, Column]] = {
    "triangles": average(0),
    "different": average(3),
    "milliseconds": time(),
    "ratio": ratio(),
}
"""The columns of a frame's cost; the ratio is to full meshes."""


def make_sphere(side: int = 64) -> MeshGeometry:
    """Make a unit sphere with bumps, of about side² triangles, without a seam."""
    rings = side // 2 - 1
    around = 2.0 * np.pi * np.arange(side) / side
    down = np.pi * np.arange(1, rings + 1)[:, None] / (rings + 1)
    ring = np.broadcast_arrays(np.sin(down) * np.cos(around), np.cos(down), -np.sin(down) * np.sin(around))
    points = np.concatenate([[[0.0, 1.0, 0.0]], np.stack(ring).reshape(3, -1).T, [[0.0, -1.0, 0.0]]])
    points *= 1.0 + 0.08 * np.sin(points * (5.0, 4.0, 6.0) + (0.0, 1.0, 1.6)).prod(axis=1, keepdims=True)
    number = 1 + np.arange(rings * side).reshape(rings, side)
    ahead = np.roll(number, -1, axis=1)
    a, b, c, d = (part.reshape(-1) for part in (number[:-1], ahead[:-1], number[1:], ahead[1:]))
    caps = [
        np.stack(np.broadcast_arrays(0, number[0], ahead[0]), axis=1),
        np.stack(np.broadcast_arrays(rings * side + 1, ahead[-1], number[-1]), axis=1),
    ]
    return make_geometry(points, np.concatenate([*caps, np.stack([a, c, d], 1), np.stack([a, d, b], 1)]))


def make_field(count: int) -> Scene:
    """Make so many objects on the ground."""
    builder, side = SceneBuilder("field"), math.ceil(count**0.5)
    column, row = np.arange(count) % side, np.arange(count) // side
    positions = np.stack([SPACING * (column - 0.5 * side), 0.0 * row, -SPACING * row], axis=1)
    nodes = builder.add_nodes(translation(positions))
    builder.add_objects(nodes, builder.add_mesh(make_sphere(), levels=6), builder.add_material())
    reach = 2.0 * SPACING * side
    corners = [(-reach, -1.2, -reach), (-reach, -1.2, reach), (reach, -1.2, reach), (reach, -1.2, -reach)]
    builder.add_objects(
        builder.add_node(),
        builder.add_mesh(make_geometry(corners, [0, 1, 2, 0, 2, 3])),
        builder.add_material(),
    )
    builder.lights.add_directional((0.3, -1.0, -0.5), casts_shadow=True)
    return builder.build()


class Variant:
    """A renderer with one limit of the error."""

    result: FrameResult

    def __init__(self, device: rhi.Device, scene: Scene, pixels: float, full: Variant | None) -> None:
        self.device, self.full = device, full or self
        self.renderer = Renderer(device, scene, visibility="frustum", size=SIZE, technique="forward")
        self.renderer.detail_error = pixels

    def draw(self, number: int) -> None:
        """Draw a frame from an eye that moves on a little."""
        camera = Camera.look_at((0.0, 4.0, 8.0 - 0.01 * number), (0.0, 0.0, -26.0))
        self.result = self.renderer.render(camera)
        self.device.finish()

    def read(self) -> NDArray[np.int64]:
        return self.result.image.read()[..., :3].astype(np.int64)

    def count(self) -> Mapping[str, float]:
        differs = np.abs(self.read() - self.full.read()).max(axis=2) > 8
        return {"triangles": self.result.statistics.triangles, "different": 100.0 * float(differs.mean())}


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the cost of each limit."""
    scene = make_field(arguments.objects)
    with rhi.create_device(arguments.backend) as device:
        variants: list[Variant] = []
        for pixels in LIMITS:
            variants.append(Variant(device, scene, pixels, variants[0] if variants else None))
        subjects = [
            Subject({"pixels": pixels}, variant.draw, count=variant.count, device=device)
            for pixels, variant in zip(LIMITS, variants, strict=True)
        ]
        yield from compare(subjects, COLUMNS, range(arguments.rounds), warm_ups=2)
        for variant in variants:
            variant.renderer.destroy()


OPTIONS = (
    options.option("--backend", "the device", "gl"),
    options.count("--objects", "objects", 1024),
    options.rounds("rounds", 7),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
