"""Costs of shadows: processor times of frames without and with them, with each filter, while the eye rests
and moves.

    python benchmarks/shadows.py [--backend gl] [--rounds 9] [--json]

In each round all variants draw the same frame, in turn. While the eye rests all maps are kept; while it
moves, the cascades are drawn again, and maps of lights are kept unless their width changes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from typing import Final

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import load_scene
from renderer.lab.comparison import Frames, Record, Subject, compare, ratio, time
from renderer.settings import RenderSettings
from renderer.shadows import ShadowFilter

SCENES = {"city:blocks=8": "street", "night:blocks=6,lights=64": "crossing"}
COLUMNS = {
    "processor_milliseconds": time(digits=1, processor=True),
    "processor_ratio": ratio(2, processor=True),
}


OPTIONS: Final = (options.BACKEND, options.size((480, 270)), options.rounds("rounds", 9))


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    settings = RenderSettings().change_all({"technique.name": "forward", "algorithm": "frustum"})
    variants = {
        "no shadows": ("", None),
        **{shadow_filter.value: (",shadows=1", shadow_filter) for shadow_filter in ShadowFilter},
    }
    with rhi.create_device(arguments.backend) as device:
        for name, view in SCENES.items():
            with ExitStack() as opened:
                resting, moving = [], []
                for variant, (option, kind) in variants.items():
                    kind_settings = settings if kind is None else settings.change("shadows.filter", kind)
                    scene = load_scene(name + option)
                    renderer = opened.enter_context(kind_settings.open(device, scene, arguments.size))
                    eye = kind_settings.adapt_camera(scene.views[view])
                    positions = (
                        eye.position
                        + np.arange(1, arguments.rounds + 1)[:, None] * (0.4, 0.0, 0.0)
                        + (0.0, 0.0, 0.1)
                    )
                    rest = Frames(renderer, eye)
                    move = Frames(
                        renderer, *(replace(eye, position=eye_position) for eye_position in positions)
                    )
                    labels = {"scene": name, "shadows": variant}
                    resting.append(Subject(labels | {"eye": "rests"}, rest))
                    moving.append(Subject(labels | {"eye": "moves"}, move, before=lambda rest=rest: rest(0)))
                for subjects in (resting, moving):
                    yield from compare(subjects, COLUMNS, range(arguments.rounds), warm_ups=4)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
