"""What shadows cost: processor times of frames without and with them, with each filter, while the eye rests and moves.

    python benchmarks/shadows.py [gl|cl] [rounds]

In each round all variants draw the same frame, in turn. While the eye rests all maps are kept; while it moves, the
cascades are drawn again, and maps of lamps are kept unless their width changes.
"""

from __future__ import annotations

import statistics
import sys
import time
from contextlib import ExitStack
from dataclasses import replace

import numpy as np

import rhi
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.shadows import ShadowFilter, ShadowSettings
from renderer.visibility import make_visibility

SIZE = (480, 270)
SCENES = {"city:blocks=8": "street", "night:blocks=6,lights=64": "crossing"}
WARM_UP = 4


def measure(backend: str, device: rhi.Device, name: str, view: str, rounds: int) -> None:
    """Print a row for each variant: medians in milliseconds, and of the ratios to the frame without shadows."""
    plain, shaded = load_scene(name), load_scene(f"{name},shadows=1")
    variants: dict[str, tuple[Scene, ShadowSettings]] = {"no shadows": (plain, ShadowSettings())}
    variants |= {one.value: (shaded, ShadowSettings(filter=one)) for one in ShadowFilter}
    with ExitStack() as scopes:
        renderers = {}
        for variant, (scene, settings) in variants.items():
            visibility = make_visibility("frustum", scene, device)
            scopes.callback(visibility.destroy)
            renderer = scopes.enter_context(Renderer(device, scene, visibility=visibility, size=SIZE))
            renderer.shadows.settings = settings
            renderers[variant] = renderer
        rest: dict[str, list[float]] = {variant: [] for variant in variants}
        moves: dict[str, list[float]] = {variant: [] for variant in variants}
        eye = shaded.views[view]
        for number in range(-WARM_UP, rounds):
            moved = replace(eye, position=eye.position + np.array((0.4 * number + 0.4, 0.0, 0.1)))
            for camera, times in ((eye, rest), (moved, moves), (eye, None)):
                for variant, renderer in renderers.items():
                    took = draw(device, renderer, camera)
                    if times is not None and number >= 0:
                        times[variant].append(took)
    for variant in variants:
        row = []
        for times in (rest, moves):
            ratios = [a / b for a, b in zip(times[variant], times["no shadows"], strict=True)]
            row.append(f"{1e3 * statistics.median(times[variant]):7.1f} ms {statistics.median(ratios):5.2f} x")
        print(f"{backend}  {name:26}{variant:12}", *row)


def draw(device: rhi.Device, renderer: Renderer, camera: Camera) -> float:
    """Draw a frame; return the processor time of all threads."""
    device.finish()
    began = time.process_time()
    renderer.render(camera)
    device.finish()
    return time.process_time() - began


if __name__ == "__main__":
    backend = sys.argv[1] if len(sys.argv) > 1 else "gl"
    with rhi.create_device(backend) as device:
        for name, view in SCENES.items():
            measure(backend, device, name, view, int(sys.argv[2]) if len(sys.argv) > 2 else 9)
