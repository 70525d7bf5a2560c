"""Gain of Deferred+ on clustered forward shading where triangles are small (GPU Zen 2017, Deferred+, Table
1.2).

A rough ground with textures and a normal map, 256 lights above it. Its triangles are chosen for the view,
with edges of 32 pixels to 1; the techniques take turns. "gain" is the median ratio of the processor times of
clustered forward shading and of the technique in the same round. A fragment stage runs in blocks of pixels,
for those beside the triangle too; the smaller triangles are, the more of them.

    python benchmarks/small_triangles.py [--backend cl] [--size 640x360] [--rounds 5] [--json | --markdown]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import rhi
from renderer.cli.comparison import run_benchmark
from renderer.cli.options import option, rounds, size
from renderer.lab.comparison import Frames, Record, Subject, compare, ratio, time
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder, make_height_field
from renderer.techniques import TECHNIQUES, DeferredPlus, Technique
from renderer.tessellation import TessellationSettings
from renderer.visibility import FrustumCulling

EDGES: Final = (32.0, 8.0, 4.0, 2.0, 1.0)
"""Lengths of triangles' edges in pixels."""
COMPARED_TECHNIQUES: Final[dict[str, Callable[[], Technique]]] = {
    "clustered": TECHNIQUES["clustered"],
    "deferred_plus": DeferredPlus,
    "deferred_plus, multi-pass": lambda: DeferredPlus(multi_pass=True),
    "deferred_plus, binned": lambda: DeferredPlus(binned=True),
    "clustered_deferred": TECHNIQUES["clustered_deferred"],
}


def make_ground() -> Scene:
    """Return the ground: 300 m wide, of at most 2²⁰ triangles."""
    random, along = np.random.default_rng(0), np.linspace(0.0, 30.0, 1025)
    hills = 6.0 * np.sin(along)[:, None] * np.sin(1.4 * along)
    field = make_height_field(hills + random.normal(0.0, 0.05, hills.shape), 300.0, limit=1 << 20)
    colors = random.integers(60, 255, (256, 256, 4)).astype(np.uint8)
    colors[..., 3] = 255
    bumps = random.normal((128.0, 128.0, 238.0, 128.0), 20.0, (256, 256, 4))
    builder = SceneBuilder("rough ground")
    material = builder.add_material(
        roughness=0.5,
        metallic=0.1,
        texture=builder.add_image(colors),
        normal_texture=builder.add_image(np.clip(bumps, 0, 255).astype(np.uint8)),
    )
    builder.add_objects(builder.add_node(), builder.add_height_field(field), material)
    positions = random.uniform((-60.0, 2.0, -60.0), (60.0, 8.0, 60.0), (256, 3))
    builder.lights.add_points(positions, 18.0, intensity=10.0)
    return builder.build()


OPTIONS: Final = (
    option("--backend", "a backend that draws", "cl", metavar="NAME"),
    size((640, 360)),
    rounds("frames that are timed of each"),
)


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield a row for each technique and length of edges."""
    scene = make_ground()
    camera = Camera.look_at((0, 14, 50), (0, 0, 0)).with_aspect(arguments.size[0] / arguments.size[1])
    columns = {"ms": time(processor=True), "gain": ratio(2, processor=True, inverse=True)}
    with rhi.create_device(arguments.backend) as device:
        renderers = {name: Renderer(device, scene, size=arguments.size) for name in COMPARED_TECHNIQUES}
        for name, renderer in renderers.items():
            renderer.technique, renderer.visibility = COMPARED_TECHNIQUES[name](), FrustumCulling(scene)
        for edge in EDGES:
            subjects = []
            for name, renderer in renderers.items():
                renderer.tessellator.settings = TessellationSettings(edge_pixels=edge)
                frames = Frames(renderer, camera)
                frames(0)
                labels = {"edges": edge, "triangles": frames.result.statistics.triangles, "technique": name}
                subjects.append(Subject(labels, frames))
            yield from compare(subjects, columns, range(arguments.rounds), warm_ups=2)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
