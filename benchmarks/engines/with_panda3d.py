"""The city with Panda3D's fixed pipeline, on OpenGL or on its own software renderer: lit at vertices, by
eight lights.

The shaders of simplepbr, by which it would light pixels, end the process in llvmpipe 22.3.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gltf
import numpy as np
from direct.showbase.ShowBase import ShowBase
from panda3d.core import AmbientLight, GraphicsOutput, NodePath, PerspectiveLens, Texture, loadPrcFileData
from serving import Job, encode, serve


def load(job: Job) -> tuple[str, Callable[[], Any]]:
    is_software = job["engine"].endswith("software")
    size = f"{job['width']} {job['height']}"
    display = "p3tinydisplay" if is_software else "p3headlessgl"
    options = f"load-display {display}\nwindow-type offscreen\nwin-size {size}\naudio-library-name null\n"
    loadPrcFileData("", f"{options}sync-video 0\n")
    base = ShowBase()
    base.disableMouse()
    settings = gltf.GltfSettings(legacy_materials=True, no_srgb=True)
    city = NodePath(gltf.load_model(job["path"], settings))
    city.reparentTo(base.render)
    for light in city.findAllMatches(
        "**/+DirectionalLight"
    ):  # its loader has taken a lux for the 683rd part of a unit
        light.node().setColor((*job["sun"], 1.0))
    ambient = AmbientLight("ambient")
    ambient.setColor((*encode(job["ambient"]), 1.0))
    base.render.setLight(base.render.attachNewNode(ambient))
    base.setBackgroundColor(*encode(job["background"]))
    projection = PerspectiveLens()
    projection.setAspectRatio(job["width"] / job["height"])
    projection.setMinFov(job["fov"])
    projection.setNearFar(job["near"], job["far"])
    base.cam.node().setLens(projection)
    (x, y, z), (u, v, w) = job["eye"], job["ahead"]
    base.camera.setPos(x, -z, y)  # z is upwards
    base.camera.lookAt(x + u, -z - w, y + v)
    texture = Texture()
    base.win.addRenderTexture(texture, GraphicsOutput.RTMCopyRam)

    def draw() -> Any:
        base.taskMgr.step()
        texels = np.frombuffer(texture.getRamImageAs("RGB"), np.uint8)
        return texels.reshape(job["height"], job["width"], 3)[::-1]

    return base.win.getGsg().getDriverRenderer() or "its own rasteriser", draw


if __name__ == "__main__":
    serve(load)
