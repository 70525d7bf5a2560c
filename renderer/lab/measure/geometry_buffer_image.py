"""An image of the buffers that Deferred+ writes for a frame, read back and decoded on the CPU."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from renderer.frame.drawing import FARTHEST
from renderer.inspection.texture_images import color_indices
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats
from renderer.shaders.encodings import decode_gradient, decode_normal, decode_uv
from renderer.techniques import DeferredPlus
from renderer.techniques.parts.material_rectangles import MaterialRectangles
from rhi import Device
from rhi.shading import evaluate

Pixels = NDArray[np.uint8]

_LEVELS = 14.0
"""Octaves of derivatives between black and white."""


def render_geometry_buffer_image(
    device: Device, scene: Scene, camera: Camera, size: tuple[int, int]
) -> Pixels:
    """Render a frame and the buffers of its Deferred+ geometry pass as one image (2 h, 3 w, 4).

    Above: the image, normals, materials. Below: texture coordinates, the logarithm of their derivatives
    (bright where a texture is far away), and the rectangles of materials. Without textures the texture
    coordinates are black.
    """
    with Renderer(
        device, scene, technique=DeferredPlus(multi_pass=True), visibility="frustum", size=size
    ) as renderer:
        targets = renderer.render(camera).targets
        image = targets["image"].read()
        depth = targets["depth"].read()
        words = targets["packed"].read()
        rectangles = renderer.view.workspace(MaterialRectangles).read()
    seen = (depth != FARTHEST[camera.projection.depth])[..., None]
    normals = np.asarray(evaluate(decode_normal, words[..., 0])) * 0.5 + 0.5
    materials = color_indices((words[..., 1] & 0xFFFF).astype(np.int64))
    uv, levels = np.zeros_like(normals), np.zeros_like(normals)
    if words.shape[-1] == 4:
        uv[..., :2] = evaluate(decode_uv, words[..., 2])
        change = np.asarray(evaluate(decode_gradient, words[..., 3] & 0xFFFFFF))
        length = np.maximum(np.linalg.norm(change, axis=-1), 2.0**-_LEVELS)
        levels[:] = np.clip(1.0 + np.log2(length)[..., None] / _LEVELS, 0.0, 1.0)
    framed = materials * 0.35
    for material, x, y, width, height in rectangles.tolist():
        color = color_indices(np.array(material))
        framed[[y, y + height - 1], x : x + width] = color
        framed[y : y + height, [x, x + width - 1]] = color
    parts = [np.where(seen, part, 0.0) for part in (normals, materials, uv, levels, framed)]
    images = [image, *(_to_pixels(part) for part in parts)]
    return np.concatenate([np.concatenate(images[:3], 1), np.concatenate(images[3:], 1)])


def _to_pixels(colors: Floats) -> Pixels:
    pixels = np.full((*colors.shape[:2], 4), 255, np.uint8)
    pixels[..., :3] = np.round(np.clip(colors, 0.0, 1.0) * 255.0)
    return pixels
