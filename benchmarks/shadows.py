"""What shadows cost: processor times of frames without and with them, with each filter, while the eye rests and moves.

    python benchmarks/shadows.py [gl|cl] [rounds]

In each round all variants draw the same frame, in turn. While the eye rests all maps are kept; while it moves, the
cascades are drawn again, and maps of lamps are kept unless their width changes.
"""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import rhi
from renderer.content import load_scene
from renderer.measure import alternate
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
        eye = shaded.views[view]

        def draw(variant: str, camera: Camera) -> None:
            renderers[variant].render(camera)
            device.finish()

        def rest(variant: str, number: int = 0) -> None:
            draw(variant, eye)

        def move(variant: str, number: int) -> None:
            step = np.array((0.4 * number + 0.4, 0.0, 0.1))
            draw(variant, replace(eye, position=eye.position + step))

        resting = alternate({one: partial(rest, one) for one in variants}, range(rounds), WARM_UP)
        moving = alternate({one: partial(move, one) for one in variants}, range(rounds), WARM_UP, before=rest)
    for variant in variants:
        row = []
        for times in (resting, moving):
            time = times[variant]
            ratio = time.processor_ratio_to(times["no shadows"])
            row.append(f"{1e3 * time.processor_median:7.1f} ms {ratio:5.2f} x")
        print(f"{backend}  {name:26}{variant:12}", *row)


if __name__ == "__main__":
    backend = sys.argv[1] if len(sys.argv) > 1 else "gl"
    with rhi.create_device(backend) as device:
        for name, view in SCENES.items():
            measure(backend, device, name, view, int(sys.argv[2]) if len(sys.argv) > 2 else 9)
