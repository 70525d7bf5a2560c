"""The city with this renderer as its commands have it: technique and visibility are the fastest that it
finds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from serving import Job, serve

import rhi
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective
from renderer.techniques import AutoTechnique


def load(job: Job) -> tuple[str, Callable[[], Any]]:
    device = rhi.create_device(job["engine"])
    size = job["width"], job["height"]
    scene = load_scene(job["path"])
    renderer = Renderer(device, scene, technique=AutoTechnique(scene, device), size=size)
    eye = np.array(job["eye"])
    perspective = Perspective(np.radians(job["fov"]), size[0] / size[1], job["near"])
    camera = Camera.look_at(eye, eye + job["ahead"], projection=perspective)
    return device.capabilities.device, lambda: renderer.render(camera).image.read()


if __name__ == "__main__":
    serve(load)
