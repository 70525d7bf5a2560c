"""Images of any texture of a frame, so that people can look at it.

- Colours and light are shown unchanged; light beyond 1 is tone-mapped like the frame.
- One or two channels of numbers are grey: the smallest of the texture is black, the greatest white. If the
  greatest is more than 100 times the smallest above 0, the scale is logarithmic.
- Normals are decoded and shown as `render --show normals` does.
- Integers have false colours: equal numbers have the same one.

Where no surface was drawn, the texture's earlier content remains, and is shown, too.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats
from renderer.shaders.encodings import decode_normal
from renderer.shaders.tone_mapping import tone_map
from rhi import to_srgb
from rhi.math.indexing import repeat_each
from rhi.shading import evaluate

Pixels = NDArray[np.uint8]


def texture_to_image(name: str, texels: NDArray[Any]) -> Pixels:
    """The sRGB image (h, w, 3) of a texture; its name tells what it stores.

    Args:
        texels: (h, w) or (h, w, channels), as `Texture.read` returns them.
    """
    channels = texels.reshape(*texels.shape[:2], -1)
    if name == "surface" and channels.shape[2] == 1:  # a distance alone
        return _shade(channels[..., 0].view(np.float32))
    if texels.dtype == np.uint32 and name.split()[-1] in ("surface", "packed"):
        return _encode(0.5 + 0.5 * evaluate(decode_normal, channels[..., 0 if name == "packed" else 1]))
    if texels.dtype == np.uint8 and channels.shape[2] >= 3:
        return np.ascontiguousarray(channels[..., :3])
    if texels.dtype.kind in "ui":
        return np.asarray(255.0 * color_indices(channels[..., 0].astype(np.int64)) + 0.5, np.uint8)
    values = np.nan_to_num(channels.astype(np.float32), posinf=65504.0)
    if channels.shape[2] >= 3:
        light = values[..., :3]
        return _encode(evaluate(tone_map, light) if light.max(initial=0.0) > 1.0 else light)
    return _shade(values[..., 0])


def _shade(values: NDArray[np.float32]) -> Pixels:
    """Numbers as shades of grey that look evenly spaced."""
    positive = values[values > 0.0]
    low, high = float(values.min()), float(values.max())
    if low >= 0.0 and len(positive) and high > 100.0 * positive.min():
        values = np.log2(np.maximum(values, positive.min()))
        low, high = float(values.min()), float(values.max())
    grey = (255.0 * (values - low) / max(high - low, 1e-30) + 0.5).astype(np.uint8)
    return repeat_each(grey[..., None], 3, axis=2)


def color_indices(indices: NDArray[np.int64]) -> Floats:
    """A colour (…, 3) for each index; neighbouring indices differ clearly."""
    hues = indices[..., None] * 0.61803 + np.array([0.0, 1.0 / 3.0, 2.0 / 3.0])
    colors: Floats = 0.25 + 0.7 * (0.5 + 0.5 * np.cos(2.0 * np.pi * hues))
    return colors


def _encode(linear: NDArray[Any]) -> Pixels:
    """Encode linear colours as sRGB."""
    encoded = to_srgb(np.clip(np.nan_to_num(np.asarray(linear, np.float64)), 0.0, 1.0))
    return np.asarray(255.0 * encoded + 0.5, np.uint8)
