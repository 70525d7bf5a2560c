"""Costs that fog and glow add to a frame: processor time and time, as ratios to the same frame without them.

The frames with nothing, fog, glow and both take turns in one process, of the same view, after all shaders are built.
Figures are medians over the rounds.

    python benchmarks/effects.py [--backend gl] [--size 960x540] [--technique forward] [--rounds 15] [--json]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Final

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import load_scene, parse_camera
from renderer.lab.comparison import Frames, Record, Subject, compare, interval, ratio, time
from renderer.settings import RenderSettings
from renderer.techniques import TECHNIQUES

AIRS = {"nothing": "", "fog": ",fog=0.015", "glow": ",glow=0.1", "both": ",fog=0.015,glow=0.1"}
VIEWS = {"night:lights=256": ("ground", 900), "hall:lights=96": ("overview", 0)}
COLUMNS = {
    "milliseconds": time(digits=2), "time": ratio(), "processor time": ratio(processor=True), "interval": interval()
}  # fmt: skip


OPTIONS: Final = (
    options.BACKEND,
    options.size(),
    options.choice("--technique", "how the scene is drawn", TECHNIQUES, "forward"),
    options.rounds("rounds", 15),
)


def measure(given: argparse.Namespace) -> Iterator[Record]:
    settings = RenderSettings().change_all({"technique.name": given.technique, "algorithm": "frustum"})
    with rhi.create_device(given.backend) as device:
        for text, (view, frame) in VIEWS.items():
            with ExitStack() as opened:
                subjects = []
                for name, air in AIRS.items():
                    scene = load_scene(text + air)
                    renderer = opened.enter_context(settings.open(device, scene, given.size))
                    camera = settings.aim(parse_camera(view, scene, frame))
                    subjects.append(Subject({"scene": text, "air": name}, Frames(renderer, camera)))
                yield from compare(subjects, COLUMNS, range(given.rounds), warm_ups=2)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
