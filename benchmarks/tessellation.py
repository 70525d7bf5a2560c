"""What the length of edges costs and loses: triangles, time, and how far they are from the full height field.

For each length, frames along a path of the terrain are drawn. The lengths take turns in one process; each round starts
with another one. "choose" is the time of choosing the triangles, "draw" that of a frame without it, both in
milliseconds of processor time, all threads together (medians). The error of a vertex of the full field is its distance
on screen from the chosen triangles, of those in the frustum and above the sea, hidden ones included.

    python benchmarks/tessellation.py [--backend cl] [--scene terrain] [--rounds 5] [--json]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))

os.environ.setdefault("RHI_KERNELS", "optimised")  # what is measured is the speed of a long run

import rhi
from renderer.content import load_scene, parse_camera
from renderer.frame import SceneResources
from renderer.lab.measure import format_records
from renderer.renderer import Renderer
from renderer.scene import Camera, HeightField
from renderer.scene.height_fields import bisect
from renderer.tessellation import TessellationSettings
from renderer.visibility import make_visibility

Floats = NDArray[np.float64]
EDGES: Final = (32.0, 16.0, 8.0, 4.0, 2.0)
SIZE: Final = (960, 540)
FRAMES: Final = range(0, 1800, 300)


def find_heights(field: HeightField, triangles: NDArray[np.int64]) -> Floats:
    """Return the heights of triangles at all vertices of the full field: where they don't use a vertex, it lies on the
    edge between the two that it is the middle of."""
    side = len(field.heights)
    heights = field.heights.reshape(-1).astype(np.float64)
    is_used = np.zeros(side * side, bool)
    is_used[triangles] = True
    for depth in range(field.levels):
        left, _, right = bisect(side, depth).T
        middle = (left + right) // 2
        lies = ~is_used[middle]
        heights[middle[lies]] = 0.5 * (heights[left[lies]] + heights[right[lies]])
    return heights


def find_errors(field: HeightField, triangles: NDArray[np.int64], camera: Camera) -> Floats:
    """Return the errors in pixels of the vertices that are in the frustum and above the sea."""
    exact = field.positions().reshape(-1, 3)
    chosen = exact.copy()
    chosen[:, 1] = find_heights(field, triangles)
    planes = camera.frustum.planes
    seen = (exact @ planes[:, :3].T + planes[:, 3] > 0.0).all(1) & (exact[:, 1] > 0.0)
    places = []
    for points in (exact[seen], chosen[seen]):
        clip = np.append(points, np.ones((len(points), 1)), axis=1) @ camera.view_projection.T
        places.append(0.5 * clip[:, :2] / clip[:, 3:] * SIZE)
    return np.asarray(np.linalg.norm(places[0] - places[1], axis=1))


def read_triangles(resources: SceneResources, row: int, count: int) -> NDArray[np.int64]:
    """Return the triangles (count, 3) that were chosen of a field."""
    first = int(resources.scene.meshes.ranges["first_index"][resources.scene.objects.mesh[row]])
    return np.asarray(resources.indices.read(first, 3 * count).astype(np.int64).reshape(-1, 3))


def measure(backend: str, spec: str, rounds: int) -> list[dict[str, Any]]:
    """Measure all lengths on a scene."""
    scene = load_scene(spec)
    row, field = next(iter(scene.height_fields.items()))
    cameras = [parse_camera("sky", scene, frame).with_aspect(SIZE[0] / SIZE[1]) for frame in FRAMES]
    found: dict[float, dict[str, list[Any]]] = {
        edge: {"triangles": [], "errors": [], "choose": [], "draw": []} for edge in EDGES
    }
    with rhi.create_device(backend) as device:
        visibility = make_visibility("frustum", scene, device)
        with Renderer(device, scene, size=SIZE, visibility=visibility) as renderer:
            tessellator, resources = renderer.tessellator, renderer.resources
            for turn in range(rounds + 1):
                start = turn % len(EDGES)
                for edge in EDGES[start:] + EDGES[:start]:
                    one = found[edge]
                    for camera in cameras:
                        tessellator.settings = TessellationSettings(edge)
                        device.finish()
                        began = time.process_time()
                        tessellator.update(resources, camera, SIZE[1])
                        device.finish()
                        chosen = time.process_time()
                        renderer.render(camera)
                        device.finish()
                        drawn = time.process_time()
                        if turn:
                            one["choose"].append(chosen - began)
                            one["draw"].append(drawn - chosen)
                        else:  # and kernels are built
                            count = tessellator.fields[0].read_count()
                            one["triangles"].append(count)
                            triangles = read_triangles(resources, row, count)
                            one["errors"].append(find_errors(field, triangles, camera))
        visibility.destroy()
    rows = []
    for edge, one in found.items():
        errors = np.concatenate(one["errors"])
        rows.append(
            {
                "backend": backend,
                "edge": edge,
                "triangles": int(np.median(one["triangles"])),
                "mean error": round(float(errors.mean()), 3),
                "99 %": round(float(np.percentile(errors, 99)), 2),
                "largest": round(float(errors.max()), 1),
                "choose": round(1e3 * float(np.median(one["choose"])), 1),
                "draw": round(1e3 * float(np.median(one["draw"])), 1),
            }
        )
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", default="cl")
    parser.add_argument("--scene", default="terrain")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    print(format_records(measure(given.backend, given.scene, given.rounds), as_json=given.json))


if __name__ == "__main__":
    main()
