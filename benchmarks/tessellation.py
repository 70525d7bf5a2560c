"""Costs and errors of the length of edges: triangles, time, and how far they are from the full height field.

For each length, frames along a path of the terrain are drawn. The lengths take turns in one process; each
round starts with another one. "choose" is the time of choosing the triangles, "draw" that of a frame without
it, both in milliseconds of processor time, all threads together (medians). The error of a vertex of the full
field is its distance on screen from the chosen triangles, of those in the frustum and above the sea, hidden
ones included.

    python benchmarks/tessellation.py [--backend cl] [--scene terrain] [--rounds 5] [--json]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import load_scene, parse_camera
from renderer.frame import SceneResources
from renderer.lab.comparison import Record, Subject, compare, time
from renderer.renderer import Renderer
from renderer.scene import Camera, HeightField
from renderer.scene.tessellated_surfaces import bisect
from renderer.tessellation import TessellationSettings

Floats = NDArray[np.float64]
EDGES: Final = (32.0, 16.0, 8.0, 4.0, 2.0)
SIZE: Final = (960, 540)
FRAMES: Final = range(0, 1800, 300)


def interpolate_heights(field: HeightField, triangles: NDArray[np.int64]) -> Floats:
    """Return the heights of triangles at all vertices of the full field: where they don't use a vertex, it
    lies on the edge between the two that it is the middle of."""
    side = len(field.heights)
    heights = field.heights.reshape(-1).astype(np.float64)
    is_used = np.zeros(side * side, bool)
    is_used[triangles] = True
    for depth in range(field.levels):
        left, _, right = bisect(side, depth).T
        median_of = (left + right) // 2
        lies = ~is_used[median_of]
        heights[median_of[lies]] = 0.5 * (heights[left[lies]] + heights[right[lies]])
    return heights


def compute_errors(field: HeightField, triangles: NDArray[np.int64], camera: Camera) -> Floats:
    """Return the errors in pixels of the vertices that are in the frustum and above the sea."""
    exact = field.positions().reshape(-1, 3)
    approximate = exact.copy()
    approximate[:, 1] = interpolate_heights(field, triangles)
    planes = camera.frustum.planes
    seen = (exact @ planes[:, :3].T + planes[:, 3] > 0.0).all(1) & (exact[:, 1] > 0.0)
    pixels = []
    for points in (exact[seen], approximate[seen]):
        clip = np.append(points, np.ones((len(points), 1)), axis=1) @ camera.view_projection.T
        pixels.append(0.5 * clip[:, :2] / clip[:, 3:] * SIZE)
    return np.asarray(np.linalg.norm(pixels[0] - pixels[1], axis=1))


def read_triangles(resources: SceneResources, index: int, count: int) -> NDArray[np.int64]:
    """Return the triangles (count, 3) that were chosen of a field."""
    first = int(resources.scene.meshes.ranges["first_index"][resources.scene.objects.mesh[index]])
    return np.asarray(resources.indices.read(first, 3 * count).astype(np.int64).reshape(-1, 3))


class Edge:
    """A length of edges: its triangles and its frame, as `camera` sees them."""

    def __init__(self, renderer: Renderer, edge: float, camera: Camera) -> None:
        self.renderer, self.settings, self.camera = renderer, TessellationSettings(edge), camera
        self.tessellator, self.resources = renderer.tessellator, renderer.resources

    def choose(self, _: int = 0) -> None:
        """Choose the triangles."""
        self.tessellator.settings = self.settings
        self.tessellator.update(self.resources, self.camera, SIZE[1])
        self.renderer.device.finish()

    def draw(self, _: int) -> None:
        """Draw the frame, whose triangles were chosen before."""
        self.renderer.render(self.camera)
        self.renderer.device.finish()

    def measure_views(self, cameras: Iterable[Camera]) -> Record:
        """Return the numbers of triangles and the errors of all views, which are the same in each round."""
        counts, errors = [], []
        row, field = next(iter(self.resources.scene.tessellated.items()))
        for self.camera in cameras:
            self.choose()
            counts.append(self.tessellator.surfaces[0].read_count())
            errors.append(compute_errors(field, read_triangles(self.resources, row, counts[-1]), self.camera))
        every = np.concatenate(errors)
        return {
            "triangles": int(np.median(counts)),
            "mean error": round(float(every.mean()), 3),
            "99 %": round(float(np.percentile(every, 99)), 2),
            "largest": round(float(every.max()), 1),
        }


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the row of each length."""
    scene = load_scene(arguments.scene)
    cameras = [parse_camera("sky", scene, frame).with_aspect(SIZE[0] / SIZE[1]) for frame in FRAMES]
    with (
        rhi.create_device(arguments.backend) as device,
        Renderer(device, scene, size=SIZE, visibility="frustum") as renderer,
    ):
        edges = [Edge(renderer, edge, cameras[0]) for edge in EDGES]

        def rounds() -> Iterator[int]:
            for number in range(arguments.rounds * len(cameras)):
                for terrain in edges:
                    terrain.camera = cameras[number % len(cameras)]
                yield number

        subjects = [Subject({}, terrain.choose) for terrain in edges]
        subjects += [Subject({}, terrain.draw, terrain.choose, device=device) for terrain in edges]
        rows = compare(subjects, {"ms": time(digits=1, processor=True)}, rounds())
        for terrain, choosing, drawing in zip(edges, rows, rows[len(edges) :], strict=False):
            labels = {"backend": arguments.backend, "edge": terrain.settings.edge_pixels}
            figures = {"choose": choosing["ms"], "draw": drawing["ms"], "kernels": drawing["kernels"]}
            yield {**labels, **terrain.measure_views(cameras), **figures}


OPTIONS: Final = (
    options.option("--backend", "the device", "cl"),
    options.option("--scene", "a scene with a height field and a path `sky`", "terrain"),
    options.rounds("rounds over all views"),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
