"""The techniques, compared with forward shading and with each other, and what `auto` chooses of them.

Scenes: those of the library as they are, such as `hall`, `city` or `night:lights=1024`; `grid:16` to
`grid:128`, 64 objects with so many point lights, each object with its own list; and `floor:16` to
`floor:512`, one object, whose list has all of them. `@` and the name of a view or `@path#frame` choose
another camera than the path `ground`'s.

The columns are those of `compare techniques`, the ratios of times to forward shading's, the point and spot
lights in view, and how often a light is looked at for each pixel with geometry. With `--auto` there is one
row for a scene: what `auto` has chosen, what is the fastest, how long the choice takes in the time of the
fastest, and how long `auto` takes in that of its choice.

    python benchmarks/techniques.py [--backend gl] [--rounds 5] [--size 480x270] [--scenes
    hall,night@crossing,…] python benchmarks/techniques.py --auto [--backend cl] [--size 960x540]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import BUILT_IN, load_scene, parse_camera
from renderer.inspection import settle
from renderer.lab.comparison import Record, compare, ratio
from renderer.lab.comparisons import technique_comparison as lab
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder, scaling
from renderer.techniques import TECHNIQUES, AutoTechnique, Deferred, LightPrePass, Technique
from rhi import Device

SCENES: Final = "hall,city,grid:16,grid:128,floor:16,floor:128,floor:512"
AUTO_SCENES: Final = (
    "hall@overview,hall@ground#600,city@overview,city@ground#600,night:lights=64@crossing,night:lights=64@ground#600,"
    "night:lights=1024@crossing,night:lights=1024@ground#600,night:lights=4096@crossing,night:lights=4096@overview,"
    "grid@overview,grid:count=256,lights=128@field"
)
VARIANTS: Final[dict[str, Technique]] = {
    "deferred, stencil": Deferred(stencil=True),
    "light_pre_pass, 1 channel": LightPrePass(specular_channels=1),
}
RIVALS: Final = (
    "forward",
    "deferred",
    "forward_plus",
    "clustered",
    "tiled_deferred",
    "clustered_deferred",
    "deferred_plus",
)
"""The techniques that `auto` is compared with: each other one draws more than one of these for the same
light."""
COLUMNS: Final = {**lab.COLUMNS, "ratio": ratio(), "processor_ratio": ratio(processor=True)}


def load(text: str) -> tuple[Scene, Camera]:
    """Return a scene and a camera in it."""
    spec, _, view = text.partition("@")
    name, _, lights = spec.partition(":")
    random = np.random.default_rng(1)
    if name == "floor":
        builder = SceneBuilder("floor")
        node = builder.add_node(scaling((60, 1, 60)))
        builder.add_objects(node, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
        scene, camera, half = builder.build(), Camera.look_at((0, 14, 26), (0, 0, 0)), 25.0
    else:
        is_own = name == "grid" and lights.isdigit()
        scene, half = load_scene("grid:count=64" if is_own else spec), 6.0
        path, _, frame = (view or f"ground#{100 if is_own else 300}").partition("#")
        camera = parse_camera(path, scene, int(frame or 0))
    for _ in range(int(lights) if lights.isdigit() else 0):
        x, z = random.uniform(-half, half, 2)
        scene.lights.add_point((x, 1.0, z), 2.5, random.uniform(0.2, 1.0, 3), 1.5)
    return scene, camera


def split_scenes(text: str) -> list[str]:
    """Split names of scenes at commas, but not at those between options: `grid:count=4,lights=8,hall`."""
    scenes: list[str] = []
    for part in text.split(","):
        if "=" in part.partition("@")[0] and ":" not in part and scenes:
            scenes[-1] += f",{part}"
        else:
            scenes.append(part)
    return scenes


def list_techniques(device: Device, *, is_rival: bool) -> dict[str, Technique]:
    """Return the techniques to compare: all and their other ways, or those that `auto` is compared with."""
    if not is_rival:
        return {name: make() for name, make in TECHNIQUES.items()} | VARIANTS
    is_slow = "llvmpipe" in device.capabilities.device
    return {name: TECHNIQUES[name]() for name in RIVALS if not (is_slow and name == "tiled_deferred")}


def measure_scene(device: Device, text: str, arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the rows of a scene: ratios are to forward shading, or to what `auto` has chosen."""
    scene, camera = load(text)
    techniques = list_techniques(device, is_rival=arguments.auto)
    with Renderer(device, scene, visibility="frustum", size=arguments.size) as renderer:
        renderer.technique = auto = AutoTechnique(scene, device)
        settle(renderer, camera)
        base = auto.current_name if arguments.auto else "forward"
        techniques = {base: techniques[base]} | techniques | {"auto": auto}
        subjects = [
            lab.make_subject(renderer, name, technique, camera) for name, technique in techniques.items()
        ]
        if arguments.auto:
            subjects = [replace(technique, summarize=dict) for technique in subjects]
        rows = compare(subjects, COLUMNS, range(arguments.rounds), warm_ups=3)
        light_count = renderer.plan(camera)[0].local_lights_in_view
        pixels = (
            max(int(np.count_nonzero(renderer.render(camera).depth.read())), 1)
            if device.capabilities.renders
            else 1
        )
    if not arguments.auto:
        for row in rows:
            lights = row["light_evaluations"]
            seen = {
                "lights in view": light_count,
                "lights a pixel": None if lights is None else lights / pixels,
            }
            yield {
                "scene": text,
                **row,
                **seen,
                "auto": auto.current_name if row["technique"] == "auto" else None,
            }
        return
    *others, last = rows
    fastest, thriftiest = (min(others, key=lambda row: row[name]) for name in ("ratio", "processor_ratio"))
    yield {
        "scene": text,
        "auto": base,
        "fastest": fastest["technique"],
        "auto / fastest": 1 / fastest["ratio"],
        "by the processor": 1 / thriftiest["processor_ratio"],
        "auto / its technique": last["processor_ratio"],
    }


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the rows of all scenes."""
    with rhi.create_device(arguments.backend) as device:
        for text in split_scenes(arguments.scenes or (AUTO_SCENES if arguments.auto else SCENES)):
            yield from measure_scene(device, text, arguments)


OPTIONS: Final = (
    options.option("--backend", "the device", "gl"),
    options.rounds("frames of each technique"),
    options.size((480, 270)),
    options.option("--scenes", "scenes between commas, each with its view"),
    options.switch("--auto", "compare what `auto` chooses with the fastest"),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
