"""Draws a floor lit by a point light, a spot light and two tube lights, by a copy of the renderer that has
such a kind.

Run as `draw_tubes.py BACKEND OUT TECHNIQUE…`: writes the image of each technique (h, w, 3), 0 to 255, to the
file OUT, and the passes of each as text.
"""

from __future__ import annotations

import sys

import numpy as np
from tube_scene import EYE, SIZE, add_lights, make_floor

import rhi
from renderer.renderer import Renderer
from renderer.techniques import TECHNIQUES, Inferred

if __name__ == "__main__":
    backend, out, *names = sys.argv[1:]
    scene = make_floor()
    add_lights(scene)
    scene = scene.build()
    images = {}
    with rhi.create_device(backend) as device:
        with Renderer(device, scene, size=SIZE) as renderer:
            for name in names:
                renderer.technique = Inferred(scale=1.0) if name == "inferred" else TECHNIQUES[name]()
                images[name] = renderer.render(EYE).image.read()[..., :3].astype(float)
    np.savez(out, **images)
