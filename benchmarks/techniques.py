"""The techniques, compared with forward shading: processor time and light evaluations.

Scenes: those of the library as they are, such as `hall`, `city` or `night:lights=1024`; a grid of 64 objects, each with
its own list of lights, and a floor that is one object, whose list has all of them, with 16 to 512 point lights. All
techniques render the same frame in each round. A time is that of the processor, over all threads, from the frame's
update until the device is finished; figures are medians, "x forward" those of the rounds' ratios. "lit", of techniques
that draw light volumes, is how often a light is evaluated for each pixel with geometry: the samples that pass the tests
of a light pass.

    python benchmarks/techniques.py [--backend gl] [--rounds 5] [--size 480x270] [--scenes hall,floor:512,…]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

os.environ.setdefault("RHI_KERNELS", "optimised")  # what is measured is the speed of a long run

import rhi
from renderer.content import BUILT_IN, load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder, scaling
from renderer.techniques import (
    Clustered,
    ClusteredDeferred,
    Deferred,
    Forward,
    ForwardMultipass,
    ForwardPlus,
    Inferred,
    LightIndexed,
    LightPrePass,
    Technique,
    TiledDeferred,
)
from renderer.visibility import FrustumCulling
from rhi import BlendFunction, DepthTest, Device

SCENES: Final = "hall,city,grid:16,grid:128,floor:16,floor:128,floor:512"
TECHNIQUES: Final[dict[str, Technique]] = {
    "forward": Forward(),
    "deferred": Deferred(),
    "deferred, stencil": Deferred(stencil=True),
    "light_pre_pass": LightPrePass(),
    "light_pre_pass, 1 channel": LightPrePass(specular_channels=1),
    "inferred": Inferred(),
    "forward_multipass": ForwardMultipass(),
    "light_indexed": LightIndexed(),
    "forward_plus": ForwardPlus(),
    "clustered": Clustered(),
    "tiled_deferred": TiledDeferred(),
    "clustered_deferred": ClusteredDeferred(),
}


def load(text: str) -> tuple[Scene, Camera]:
    """Return a scene and a camera in it."""
    name, _, lights = text.partition(":")
    random = np.random.default_rng(1)
    if name == "floor":
        builder = SceneBuilder("floor")
        node = builder.add_node(scaling((60, 1, 60)))
        builder.add_objects(node, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
        scene, camera, half = builder.build(), Camera.look_at((0, 14, 26), (0, 0, 0)), 25.0
    else:
        scene = load_scene("grid:count=64" if name == "grid" else text)
        camera, half = scene.paths["ground"].camera(100 if name == "grid" else 300), 6.0
    for _ in range(int(lights) if lights.isdigit() else 0):
        x, z = random.uniform(-half, half, 2)
        scene.lights.add_point((x, 1.0, z), 2.5, random.uniform(0.2, 1.0, 3), 1.5)
    return scene, camera


def count_lit(renderer: Renderer, camera: Camera) -> float:
    """Return how often a light is evaluated, for each pixel with geometry."""
    device, queries, stencil = renderer.device, [], getattr(renderer.technique, "stencil", False)
    states = device.states

    @contextmanager
    def counted(*given: Any) -> Iterator[None]:
        with states(*given):
            if (DepthTest.OFF if stencil else BlendFunction.ADDITIVE) in given:
                queries.append(device.occlusion_query())
                with queries[-1]:
                    yield
            else:
                yield

    class Counting:
        def __getattr__(self, name: str) -> Any:
            return counted if name == "states" else getattr(device, name)

    renderer.device = Counting()  # type: ignore[assignment]
    try:
        depth = renderer.render(camera).depth.read()
    finally:
        renderer.device = device
    return sum(query.wait() for query in queries) / np.count_nonzero(depth)


def measure(device: Device, text: str, size: tuple[int, int], rounds: int) -> None:
    """Print the rows of one scene."""
    scene, camera = load(text)
    times: dict[str, list[float]] = {name: [] for name in TECHNIQUES}
    with Renderer(device, scene, visibility=FrustumCulling(scene), size=size) as renderer:
        for number in range(rounds + 3):
            for name, renderer.technique in TECHNIQUES.items():
                renderer.render(camera)
                device.finish()
                began = time.process_time()
                renderer.render(camera)
                device.finish()
                if number >= 3:
                    times[name].append(time.process_time() - began)
        needs, _ = renderer.plan(camera)
        print(f"{text}: {len(needs.point_rows)} point and {len(needs.spot_rows)} spot lights in view")
        for name, renderer.technique in TECHNIQUES.items():
            _, plan = renderer.plan(camera)
            has_volumes = isinstance(renderer.technique, Deferred | LightPrePass | Inferred)
            lit = f"{count_lit(renderer, camera):8.2f} lit" if has_volumes else ""
            ratio = median(a / b for a, b in zip(times[name], times["forward"], strict=True))
            print(
                f"  {name:26}{1e3 * median(times[name]):8.2f} ms{ratio:8.2f} x forward"
                f"{plan.count_bytes(size) / (size[0] * size[1]):6.0f} bytes a pixel{lit}",
                flush=True,
            )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", default="gl")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--size", default="480x270")
    parser.add_argument("--scenes", default=SCENES)
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    with rhi.create_device(given.backend) as device:
        for text in given.scenes.split(","):
            measure(device, text, (width, height), given.rounds)


if __name__ == "__main__":
    main()
