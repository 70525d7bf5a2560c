"""Costs and gains of meshlets: what the device draws and culls of meshes that are cut.

There are two scenes. In the field, dense spheres with bumps lead away from the eye: most triangles that are not seen
are on backs, or hidden by nearer spheres. The objects of the hall are joined, one for each material, so that each is
seen from nearly everywhere: without meshlets, all of them are drawn. Each is drawn with whole meshes, and with meshlets
of several sizes, by both algorithms that run on the device. Variants take turns, round by round, in one process, and
the eye moves on a little in each round; times are from the begin of a frame until the device is finished.

Triangles and meshlets are those of the last frame: *listed* meshlets are those of objects in view, and each of them is
drawn or culled for one reason. *Different* pixels are those that aren't equal to the bit to the first variant's.

    python benchmarks/meshlets.py [--backend gl] [--objects 256] [--side 64] [--rounds 5] [--json]
"""

from __future__ import annotations

import argparse
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import load_scene
from renderer.content.shapes import bumpy_sphere
from renderer.lab.comparison import Column, Record, Subject, average, compare, ratio
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Scene, SceneBuilder, translation
from renderer.scene.meshes import MeshGeometry, join
from renderer.visibility import VisibilitySettings, make_visibility
from renderer.visibility.gpu.device_culling import DeviceCulling
from renderer.visibility.gpu.meshlet_culling import TURNED_AWAY, WAS_VISIBLE
from renderer.visibility.gpu.occludees import DRAWN, HIDDEN, OUTSIDE

SIZE: Final = (640, 360)
SPACING: Final = 3.0
MESHLET_SIZES: Final = (0, 64, 128)
ALGORITHMS: Final = ("two_pass", "depth_pyramid")
CAUSES: Final = {"drawn": DRAWN, "outside": OUTSIDE, "turned away": TURNED_AWAY, "hidden": HIDDEN}
COLUMNS: Final[dict[str, Column]] = {
    "triangles": average(0),
    "draws": average(0),
    "listed": average(0),
    **{cause: average(0) for cause in CAUSES},
    "different": average(0),
    "ratio": ratio(2),
}


def make_field(count: int, side: int, meshlet_size: int) -> tuple[Scene, Camera]:
    """Make so many spheres of about `side`² triangles each, and a camera before them."""
    builder, row_length = SceneBuilder("field"), math.ceil(count**0.5)
    column, row = np.arange(count) % row_length, np.arange(count) // row_length
    positions = np.stack([SPACING * (column - 0.5 * row_length), 0.0 * row, -SPACING * row], axis=1)
    mesh = builder.add_mesh(bumpy_sphere(side, 0.08), meshlet_size=meshlet_size)
    builder.add_objects(builder.add_nodes(translation(positions)), mesh, builder.add_material())
    builder.lights.add_directional((0.3, -1.0, -0.5))
    return builder.build(), Camera.look_at((0.0, 2.0, 6.0), (0.0, 0.0, -26.0))


def make_hall(meshlet_size: int) -> tuple[Scene, Camera]:
    """Make the hall of one object for each material, and a camera in its aisle."""
    hall = load_scene("hall")
    builder, parts = SceneBuilder("joined hall"), defaultdict[int, list[MeshGeometry]](list)
    world = hall.nodes.world[hall.objects.node]
    for row, (mesh, material) in enumerate(zip(hall.objects.mesh, hall.objects.material, strict=True)):
        parts[int(material)].append(hall.meshes.geometry(int(mesh)).transformed(world[row]))
    for material, geometries in parts.items():
        color = hall.materials["base_color"][material].tolist()[:3]
        mesh = builder.add_mesh(join(geometries), meshlet_size=meshlet_size)
        builder.add_objects(builder.add_node(), mesh, builder.add_material(base_color=color))
    builder.lights.add_directional((0.3, -1.0, -0.5))
    return builder.build(), hall.views["aisle"]


class Variant:
    """A renderer whose meshes are whole or cut."""

    result: FrameResult
    number: int

    def __init__(
        self, device: rhi.Device, view: tuple[Scene, Camera], name: str, whole: Variant | None
    ) -> None:
        scene, camera = view
        self.camera, self.device, self.whole = camera.with_aspect(SIZE[0] / SIZE[1]), device, whole or self
        algorithm = make_visibility(name, scene, device, VisibilitySettings())
        assert isinstance(algorithm, DeviceCulling)
        self.algorithm = algorithm
        self.renderer = Renderer(device, scene, visibility=algorithm, size=SIZE, technique="forward")

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
        if self.whole.number != self.number:  # variants take turns in any order
            self.whole.draw(self.number)
        draws = np.concatenate([_read_draws(self.algorithm, number) for number in (0, 1)])
        counts = {
            "triangles": int((draws["count"].astype(np.int64) * draws["instances"]).sum()) // 3,
            "draws": len(draws),
            "different": int((self.read() != self.whole.read()).any(axis=2).sum()),
        }
        return counts | self._count_states()

    def _count_states(self) -> dict[str, int]:
        meshlets = self.algorithm.meshlets
        states = np.zeros(0, np.uint32)
        if meshlets is not None and meshlets.states is not None:
            states = meshlets.states.read() % WAS_VISIBLE
        by_cause = {cause: int((states == state).sum()) for cause, state in CAUSES.items()}
        return {"listed": sum(by_cause.values()), **by_cause}

    def destroy(self) -> None:
        self.renderer.destroy()
        self.algorithm.destroy()


def _read_draws(algorithm: DeviceCulling, number: int) -> NDArray[np.void]:
    """Return the draws of one of both lists."""
    listed = (algorithm.first, algorithm.second)[number]
    totals, rows = listed.totals.read()[:-1].tolist(), listed.draws.read()
    room = len(rows) // listed.parts
    return np.concatenate([rows[room * part : room * part + total] for part, total in enumerate(totals)])


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the cost of each scene, algorithm and size of meshlets."""
    with rhi.create_device(arguments.backend) as device:
        for title in ("field", "joined hall"):
            for name in ALGORITHMS:
                variants: list[Variant] = []
                for size in MESHLET_SIZES:
                    view = make_hall(size)
                    if title == "field":
                        view = make_field(arguments.objects, arguments.side, size)
                    variants.append(Variant(device, view, name, variants[0] if variants else None))
                subjects = [
                    Subject(
                        {"scene": title, "algorithm": name, "meshlet size": size},
                        variant.draw,
                        count=variant.count,
                        device=device,
                    )
                    for size, variant in zip(MESHLET_SIZES, variants, strict=True)
                ]
                yield from compare(subjects, COLUMNS, range(arguments.rounds), warm_ups=3)
                for variant in variants:
                    variant.destroy()


OPTIONS = (
    options.option("--backend", "the device", "gl"),
    options.count("--objects", "objects of the field", 256),
    options.count("--side", "the root of the triangles of each of them", 64),
    options.rounds("rounds", 5),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
