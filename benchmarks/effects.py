"""What fog and glow add to a frame: processor time and time, as ratios to the same frame without them.

The frames with nothing, fog, glow and both take turns in one process, of the same view, after all shaders are built.
Figures are medians over the rounds.

    python benchmarks/effects.py [--backend gl] [--size 960x540] [--technique forward] [--rounds 15] [--json]
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from contextlib import ExitStack

import rhi
from renderer.content import load_scene, parse_camera
from renderer.measure import alternate
from renderer.renderer import Renderer
from renderer.scene import Camera
from renderer.techniques import TECHNIQUES
from renderer.visibility import FrustumCulling

AIRS = {"nothing": "", "fog": ",fog=0.015", "glow": ",glow=0.1", "both": ",fog=0.015,glow=0.1"}
VIEWS = {"night:lights=256": ("ground", 900), "hall:lights=96": ("overview", 0)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--backend", default="gl")
    parser.add_argument("--size", default="960x540")
    parser.add_argument("--technique", default="forward", choices=list(TECHNIQUES))
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    rows = []
    with rhi.create_device(given.backend) as device:
        for text, (view, frame) in VIEWS.items():
            with ExitStack() as opened:
                work: dict[str, Callable[[int], object]] = {}
                for name, air in AIRS.items():
                    scene = load_scene(text + air)
                    renderer = opened.enter_context(
                        Renderer(
                            device, scene, technique=TECHNIQUES[given.technique](),
                            visibility=FrustumCulling(scene), size=(width, height),
                        )
                    )  # fmt: skip
                    camera = parse_camera(view, scene, frame)

                    def draw(_: int, renderer: Renderer = renderer, camera: Camera = camera) -> None:
                        renderer.render(camera)
                        device.finish()

                    work[name] = draw
                times = alternate(work, range(given.rounds), warm_ups=2)
            plain = times["nothing"]
            for name, one in times.items():
                rows.append(
                    {
                        "scene": text,
                        "air": name,
                        "milliseconds": round(1e3 * one.median, 2),
                        "time": round(one.ratio_to(plain), 3),
                        "processor time": round(one.processor_ratio_to(plain), 3),
                        "interval": [round(limit, 3) for limit in one.processor_ratio_interval(plain)],
                    }
                )
    for row in rows:
        print(json.dumps(row) if given.json else "  ".join(f"{key}: {value}" for key, value in row.items()))


if __name__ == "__main__":
    main()
