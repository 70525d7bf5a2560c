"""Costs and gains of proxies: what the device draws if it tests polytopes in place of boxes.

The bazaar is seen from above and the hall from its aisle. In the field, balls and rods along the diagonals of their
boxes are behind rows of pillars: their boxes are loose. `two_pass` tests boxes (0 planes), or polytopes of 14, 18 or
26 planes. Variants take turns, round by round, in one process, and the eye moves on a little in each round; times are
from the begin of a frame until the device is finished.

Counts are those of the last frame. *Tested* are objects whose box or polytope is drawn in either pass, counted once for
each; of those in the first pass, *polytopes* are tested as such. *Listed* are what both lists draw. *Different* pixels
aren't equal to the bit to those with boxes.

    python benchmarks/proxies.py [--backend gl] [--objects 2000] [--side 24] [--rounds 5] [--json]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import load_scene
from renderer.content.shapes import BUILT_IN, bumpy_sphere
from renderer.lab.comparison import Column, Record, Subject, average, compare, ratio
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Scene, SceneBuilder, translation
from renderer.visibility import VisibilitySettings, make_visibility
from renderer.visibility.boxes.polytopes import PLANE_COUNTS
from renderer.visibility.gpu.device_culling import DeviceCulling
from rhi.math import multiply, rotation, scaling

SIZE: Final = (640, 360)
COLUMNS: Final[dict[str, Column]] = {
    "objects": average(0),
    "polytopes": average(0),
    "tested": average(0),
    "listed": average(0),
    "different": average(0),
    "ratio": ratio(2),
}


def make_field(count: int, side: int) -> tuple[Scene, Camera]:
    """Make so many balls, of about `side`² triangles each, and rods behind pillars, and a camera before them."""
    rng, builder = np.random.default_rng(1), SceneBuilder("field")
    along_diagonal = multiply(rotation((0.0, 0.0, 1.0), 0.785), rotation((0.0, 1.0, 0.0), 0.615))
    box = BUILT_IN["box"]()
    rod = box.transformed(multiply(along_diagonal, scaling(np.array([3.0, 0.4, 0.4]))))
    positions = rng.uniform((-30.0, 0.0, -80.0), (30.0, 6.0, -5.0), (count, 3))
    nodes = builder.add_nodes(translation(positions))
    builder.add_objects(nodes[::2], builder.add_mesh(bumpy_sphere(side, 0.02)), builder.add_material())
    builder.add_objects(nodes[1::2], builder.add_mesh(rod), builder.add_material(base_color=(1.0, 0.5, 0.2)))
    x, z = np.meshgrid(np.arange(-36.0, 37.0, 3.0), np.arange(-80.0, 0.0, 15.0))
    pillars = np.stack([x + 0.1 * z, np.full_like(x, 3.0), z], axis=2).reshape(-1, 3)
    local = np.asarray(multiply(translation(pillars), scaling(np.array([2.0, 10.0, 0.5]))))
    builder.add_objects(builder.add_nodes(local), builder.add_mesh(box), builder.add_material())
    builder.lights.add_directional((0.3, -1.0, -0.5))
    return builder.build(), Camera.look_at((0.0, 3.0, 12.0), (0.0, 2.5, -40.0))


class Variant:
    """A renderer whose objects are tested as boxes or as polytopes."""

    result: FrameResult
    number: int

    def __init__(
        self, device: rhi.Device, view: tuple[Scene, Camera], planes: int, boxes: Variant | None
    ) -> None:
        self.scene, camera = view
        self.camera, self.device, self.boxes = camera.with_aspect(SIZE[0] / SIZE[1]), device, boxes or self
        algorithm = make_visibility("two_pass", self.scene, device, VisibilitySettings(proxy_planes=planes))
        assert isinstance(algorithm, DeviceCulling)
        self.algorithm = algorithm
        self.renderer = Renderer(device, self.scene, visibility=algorithm, size=SIZE, technique="forward")

    def draw(self, number: int) -> None:
        """Draw a frame from an eye that moves on a little."""
        self.number = number
        eye = self.camera
        moved = Camera(eye.position + 0.02 * number * eye.forward, eye.rotation, eye.projection)
        self.result = self.renderer.render(moved)
        self.device.finish()

    def read(self) -> NDArray[np.uint8]:
        return self.result.image.read()

    def count(self) -> Mapping[str, float]:
        if self.boxes.number != self.number:  # variants take turns in any order
            self.boxes.draw(self.number)
        algorithm = self.algorithm
        hidden = int(algorithm.first.totals.read()[-1])
        return {
            "objects": len(self.scene.objects),
            "polytopes": algorithm.count_polytopes(),
            "tested": len(self.scene.objects) + hidden,
            "listed": sum(len(part.read_object_indices()) for part in (algorithm.first, algorithm.second)),
            "different": int((self.read() != self.boxes.read()).any(axis=2).sum()),
        }

    def destroy(self) -> None:
        self.renderer.destroy()
        self.algorithm.destroy()


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the cost of each scene and number of planes."""
    bazaar, hall = load_scene("bazaar"), load_scene("hall")
    views = {
        "bazaar": (bazaar, bazaar.views["overview"]),
        "hall": (hall, hall.views["aisle"]),
        "field": make_field(arguments.objects, arguments.side),
    }
    with rhi.create_device(arguments.backend) as device:
        for title, view in views.items():
            variants: list[Variant] = []
            for planes in (0, *PLANE_COUNTS):
                variants.append(Variant(device, view, planes, variants[0] if variants else None))
            subjects = [
                Subject({"scene": title, "planes": planes}, variant.draw, count=variant.count, device=device)
                for planes, variant in zip((0, *PLANE_COUNTS), variants, strict=True)
            ]
            yield from compare(subjects, COLUMNS, range(arguments.rounds), warm_ups=3)
            for variant in variants:
                variant.destroy()


OPTIONS = (
    options.option("--backend", "the device", "gl"),
    options.count("--objects", "objects of the field", 2000),
    options.count("--side", "the root of the triangles of each ball", 24),
    options.rounds("rounds", 5),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
