"""Costs of 7,000 boxes that the device culls and lists: as instances of few draws, and as a draw each.

The scene is a layer of equal boxes, or a block of layers, drawn by `two_pass`, whose lists the device makes
(Deferred+, 1.3.1). In one variant all visible boxes are instances of one draw in each list, in the other each box is
a draw. Draws are those of both lists of the last frame. Of the layer all boxes are visible; those of the block hide
each other. The variants take turns, round by round, in one process; times are medians over the rounds, from the
frame's begin until the device is finished.

    python benchmarks/instances.py [--backend gl] [--objects 7000] [--rounds 15] [--json]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import BUILT_IN
from renderer.lab.comparison import Column, Record, Subject, average, compare, ratio, time
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder, translation
from renderer.techniques import Forward
from renderer.visibility.gpu.two_pass import TwoPassCulling

SPACING = 2.0
COLUMNS: dict[str, Column] = {
    "objects": average(0),
    "draws": average(0),
    "milliseconds": time(),
    "ratio": ratio(),
}
"""The columns of a frame's cost; the ratio is to a draw for each box."""


def make_scene(count: int, side: int) -> Scene:
    """Make `count` boxes in layers of `side` by `side`."""
    builder = SceneBuilder("boxes")
    number = np.arange(count)
    positions = np.stack([number % side, number // side**2, number // side % side], axis=1) - 0.5 * side
    nodes = builder.add_nodes(translation(SPACING * positions))
    builder.add_objects(nodes, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
    builder.lights.add_directional((0.3, -1.0, -0.5))
    return builder.build()


def make_camera(side: int) -> Camera:
    """Return a camera that sees all layers from above."""
    size = SPACING * side
    return Camera.look_at((0.4 * size, 0.9 * size, 0.9 * size), np.zeros(3))


class SingleDraws(TwoPassCulling):
    """Culling whose lists have a draw for each object."""

    has_instances = False


class Variant:
    """A renderer whose lists an algorithm makes."""

    def __init__(self, device: rhi.Device, scene: Scene, camera: Camera, algorithm: TwoPassCulling) -> None:
        self.device, self.camera, self.algorithm = device, camera, algorithm
        self.renderer = Renderer(device, scene, visibility=algorithm, size=(320, 180), technique=Forward())

    def draw(self, _: int) -> None:
        """Draw a frame."""
        self.result = self.renderer.render(self.camera)
        self.device.finish()

    def count(self) -> Mapping[str, int]:
        lists = (self.algorithm.first, self.algorithm.second)
        return {
            "objects": sum(len(draws.read_object_indices()) for draws in lists),
            "draws": sum(int(draws.totals.read()[:-1].sum()) for draws in lists),
        }

    def destroy(self) -> None:
        self.renderer.destroy()
        self.algorithm.destroy()


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the cost of each scene and variant."""
    count = arguments.objects
    sides = {"layer": math.ceil(count**0.5), "block": math.ceil(count ** (1 / 3))}
    with rhi.create_device(arguments.backend) as device:
        for name, side in sides.items():
            scene, camera, variants = make_scene(count, side), make_camera(side), []
            for kind in (SingleDraws, TwoPassCulling):
                variants.append(Variant(device, scene, camera, kind(scene, device)))
            subjects = [
                Subject({"boxes": name, "drawn": drawn}, variant.draw, count=variant.count, device=device)
                for drawn, variant in zip(("one by one", "as instances"), variants, strict=True)
            ]
            yield from compare(subjects, COLUMNS, range(arguments.rounds), warm_ups=3)
            for variant in variants:
                variant.destroy()


OPTIONS = (
    options.option("--backend", "the device", "gl"),
    options.count("--objects", "boxes", 7000),
    options.rounds("rounds", 15),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
