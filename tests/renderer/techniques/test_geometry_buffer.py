"""What a geometry buffer stores: texels and positions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.techniques.parts.geometry_buffer import decode_texel, encode_texel
from rhi.shading import evaluate

Floats = NDArray[Any]


def test_a_texel_is_stored_finer_than_images_have_it() -> None:
    levels = np.linspace(0, 1, 4001)
    linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    given = np.stack([linear, linear[::-1], np.full_like(linear, 0.5)], 1)
    read = np.asarray(evaluate(decode_texel, evaluate(encode_texel, given.astype(np.float32))))
    back = np.where(read <= 0.0031308, read * 12.92, 1.055 * np.maximum(read, 1e-9) ** (1 / 2.4) - 0.055)
    off = np.abs(back[:, 0] - levels) * 255
    assert off.max() < 0.25
    assert np.abs(back[:, 1] - levels[::-1]).max() * 255 < 0.25
    assert evaluate(decode_texel, evaluate(encode_texel, np.array([1.0, 0.0, 1.0], np.float32))).tolist() == [1, 0, 1]
