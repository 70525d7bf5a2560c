"""The city with pygfx, one sample a pixel, as sharp as ours: by default it draws four times as many."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pygfx
from rendercanvas.offscreen import RenderCanvas
from serving import Job, encode, serve


def load(job: Job) -> tuple[str, Callable[[], Any]]:
    canvas = RenderCanvas(size=(job["width"], job["height"]), pixel_ratio=1)
    renderer = pygfx.WgpuRenderer(canvas)
    renderer.pixel_ratio, renderer.ppaa = 1.0, "none"
    scene = pygfx.Scene()
    scene.add(pygfx.Background.from_color(tuple(encode(job["background"]))))
    scene.add(pygfx.load_gltf(job["path"], quiet=True).scene)
    scene.add(pygfx.AmbientLight(tuple(encode(job["ambient"]))))
    aspect = job["width"] / job["height"]
    tangent = (
        math.tan(math.radians(0.5 * job["fov"])) * 0.5 * (1.0 + aspect)
    )  # of the mean of width and height
    camera = pygfx.PerspectiveCamera(
        math.degrees(2.0 * math.atan(tangent)), aspect, depth_range=(job["near"], job["far"])
    )
    camera.local.position = job["eye"]
    camera.look_at(np.array(job["eye"]) + job["ahead"])

    def draw() -> Any:
        canvas.request_draw(lambda: renderer.render(scene, camera))
        return np.asarray(canvas.draw())

    return renderer.device.adapter.info["device"], draw


if __name__ == "__main__":
    serve(load)
