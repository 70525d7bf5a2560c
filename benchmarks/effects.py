"""Costs that effects add to a frame: processor time and time, as ratios to the same frame without them.

The frames with nothing, fog, bloom and both take turns in one process, of the same view, after all shaders
are built. So do those of a box on the ground, with and without an object behind the eye that has an effect
(`--behind`), after the shaders have become those of what is in view. Figures are medians over the rounds.

    python benchmarks/effects.py [--behind] [--backend gl] [--size 960x540] [--technique forward] [--rounds
    15] [--json]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import BUILT_IN, load_scene, parse_camera
from renderer.frame.visible_features import PATIENCE
from renderer.lab.comparison import Frames, Record, Subject, compare, interval, ratio, time
from renderer.scene import AlphaMode, Bloom, Camera, Scene, SceneBuilder, make_height_field, translation
from renderer.settings import RenderSettings
from renderer.techniques import TECHNIQUES

EFFECTS = {"nothing": "", "fog": ",fog=0.015", "bloom": ",bloom=0.1", "both": ",fog=0.015,bloom=0.1"}
VIEWS = {"night:lights=256": ("ground", 900), "hall:lights=96": ("overview", 0)}
COLUMNS = {
    "milliseconds": time(digits=2),
    "time": ratio(),
    "processor time": ratio(processor=True),
    "interval": interval(),
}


DISTANT_OBJECTS: Final = (
    "nothing",
    "images",
    "normal map",
    "mask",
    "metal",
    "all of these",
    "bloom",
    "terrain",
)

OPTIONS: Final = (
    options.BACKEND,
    options.switch("--behind", "effects behind the eye instead"),
    options.size(),
    options.choice("--technique", "how the scene is drawn", TECHNIQUES, "forward"),
    options.rounds("rounds", 15),
)


def make_distant_object(name: str) -> Scene:
    """Make a box on the ground in the sun, and something with an effect 200 m behind the eye."""
    builder = SceneBuilder(name)
    builder.lights.add_directional((0.8, -1.0, 0.3))
    mesh, is_all = builder.add_mesh(BUILT_IN["box"]()), name == "all of these"
    placed: list[tuple[NDArray[np.float64], Any]] = [
        (np.diag([7.0, 0.3, 5.0, 1.0]), {"base_color": (0.6, 0.6, 0.6)})
    ]
    placed += [(translation((-0.9, 0.6, -0.5)), {"base_color": (0.6, 0.5, 0.4)})]
    image = builder.add_image(np.full((64, 64, 4), (128, 128, 255, 255), np.uint8))
    features: dict[str, Any] = {
        "images": {"texture": image},
        "normal map": {"normal_texture": image},
        "mask": {"texture": image, "alpha_mode": AlphaMode.MASK, "double_sided": True},
        "metal": {"metallic": 1.0, "roughness": 0.3, "metallic_roughness_texture": image},
        "bloom": {"emission": 2.5, "base_color": (1.0, 1.0, 1.0)},
    }
    placed += [
        (translation((0, 1, 200)), options)
        for kind, options in features.items()
        if name == kind or (is_all and kind != "bloom")
    ]
    for transform, material in placed:
        builder.add_objects(builder.add_node(transform), mesh, builder.add_material(**material))
    if name == "terrain":
        field = builder.add_height_field(make_height_field(np.sin(np.indices((33, 33)).sum(0) / 4.0), 16.0))
        builder.add_objects(builder.add_node(translation((0, 0, 200))), field, builder.add_material())
    builder.bloom = Bloom(0.1) if name == "bloom" else None
    return builder.build()


def measure_distant_object(arguments: argparse.Namespace, settings: RenderSettings) -> Iterator[Record]:
    with rhi.create_device(arguments.backend) as device, ExitStack() as opened:
        subjects = []
        for name in DISTANT_OBJECTS:
            renderer = opened.enter_context(settings.open(device, make_distant_object(name), arguments.size))
            eyes = [Camera.look_at((0.3 + 0.001 * step, 1.2, 1.5), (-0.6, 0.2, -0.6)) for step in range(16)]
            subjects.append(Subject({"behind the eye": name}, Frames(renderer, *eyes)))
        yield from compare(subjects, COLUMNS, range(arguments.rounds), warm_ups=PATIENCE + 2)


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    settings = RenderSettings().change_all({"technique.name": arguments.technique, "algorithm": "frustum"})
    if arguments.behind:
        yield from measure_distant_object(arguments, settings)
        return
    with rhi.create_device(arguments.backend) as device:
        for text, (view, frame) in VIEWS.items():
            with ExitStack() as opened:
                subjects = []
                for name, air in EFFECTS.items():
                    scene = load_scene(text + air)
                    renderer = opened.enter_context(settings.open(device, scene, arguments.size))
                    camera = settings.adapt_camera(parse_camera(view, scene, frame))
                    subjects.append(Subject({"scene": text, "air": name}, Frames(renderer, camera)))
                yield from compare(subjects, COLUMNS, range(arguments.rounds), warm_ups=2)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
