"""Costs of animations with nothing, half or all of the scene drawn: run everywhere, or only where they are
drawn.

The scene is a row of boxes that turn, each on a node of its own. In one variant their animation has no
bounds, so it runs in every frame and its objects' bounds follow; in the other it has, so it runs for what is
drawn. The camera sees none of the boxes, half of them, or all; they are culled by the frustum, and the image
is small. The variants take turns, round by round, in one process; times are medians over the rounds, from the
frame's begin until the device is finished.

    python benchmarks/animation.py [--backend null] [--objects 2000] [--rounds 25] [--json]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import BUILT_IN
from renderer.lab.comparison import Column, Record, Subject, average, compare, ratio, time
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic, Recompute, Scene, SceneBuilder, rotation, translation

SPACING = 3.0
VIEWS = {"nothing": 0.0, "half": 0.5, "everything": 1.0}
"""The share of the boxes that each view sees."""
COLUMNS: dict[str, Column] = {
    "calls": average(1),
    "computed": average(1),
    "bytes": average(1),
    "milliseconds": time(),
    "ratio": ratio(),
}
"""The columns of a frame's cost; the ratio is to running everywhere."""


class RotatingBoxes:
    """Boxes that turn; `calls` and `computed` count what was asked for."""

    catch_up = Recompute()
    calls = 0
    computed = 0

    def __init__(self, positions: np.ndarray) -> None:
        self.positions = translation(positions)
        self.angle = np.zeros(len(positions))

    def set_time(self, members: np.ndarray, seconds: float) -> None:
        self.angle[members] = seconds + members

    def transforms(self, members: np.ndarray) -> np.ndarray:
        RotatingBoxes.calls += 1
        RotatingBoxes.computed += len(members)
        return self.positions[members] @ rotation((0, 1, 0), self.angle[members])


def make_scene(count: int, *, bounded: bool) -> Scene:
    """Make `count` boxes in a row along x."""
    builder = SceneBuilder("row")
    positions = np.zeros((count, 3))
    positions[:, 0] = SPACING * np.arange(count)
    nodes = builder.add_nodes(translation(positions), dynamic=True)
    builder.add_objects(nodes, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
    half = np.array([0.75, 0.5, 0.75])
    builder.animate(
        nodes, RotatingBoxes(positions), (positions - half, positions + half) if bounded else None
    )
    return builder.build()


def make_camera(count: int, fraction: float) -> Camera:
    """Return a camera that sees the first `fraction` of the boxes."""
    width = SPACING * max(count * fraction, 1.0)
    aim = np.array([0.5 * (width - SPACING), 0.0 if fraction else 1e6, 0.0])
    return Camera.look_at(aim + np.array([0.0, 0.0, 50.0]), aim, projection=Orthographic(width, aspect=1.0))


class Variant:
    """A scene and its renderer."""

    def __init__(self, device: rhi.Device, scene: Scene) -> None:
        self.device = device
        self.renderer = Renderer(device, scene, visibility="frustum", size=(64, 64))
        self.camera = make_camera(1, 0.0)
        self.frames = 0

    def prepare(self) -> None:
        RotatingBoxes.calls = RotatingBoxes.computed = 0

    def draw(self, _: int) -> None:
        """Draw the next frame."""
        self.frames += 1
        self.result = self.renderer.render(self.camera, self.frames / 60)
        self.device.finish()

    def count(self) -> Mapping[str, int]:
        bytes = self.result.statistics.upload_bytes
        return {"calls": RotatingBoxes.calls, "computed": RotatingBoxes.computed, "bytes": bytes}


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the cost of each view and variant."""
    with rhi.create_device(arguments.backend) as device:
        variants = {
            "everywhere": Variant(device, make_scene(arguments.objects, bounded=False)),
            "where drawn": Variant(device, make_scene(arguments.objects, bounded=True)),
        }
        for view, share in VIEWS.items():
            subjects = []
            for name, variant in variants.items():
                variant.camera = make_camera(arguments.objects, share)
                subjects.append(
                    Subject(
                        {"drawn": view, "run": name}, variant.draw, variant.prepare, variant.count, device
                    )
                )
            yield from compare(
                subjects, COLUMNS, range(arguments.rounds), warm_ups=2
            )  # these upload what was left
        for variant in variants.values():
            variant.renderer.destroy()


OPTIONS = (
    options.option("--backend", "the device", "null"),
    options.count("--objects", "animated boxes", 2000),
    options.rounds("rounds", 25),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
