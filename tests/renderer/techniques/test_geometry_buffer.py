"""The contents of a geometry buffer: texels and positions."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from frames import draw, make_boxes
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.scene import Camera, Perspective, rotation, scaling
from renderer.techniques import ClusteredDeferred, Deferred, TiledDeferred
from renderer.techniques.parts.geometry_buffer import NORMAL_BITS, decode_texel, encode_texel
from rhi.shading import evaluate

Floats = NDArray[Any]


def test_a_texel_is_stored_finer_than_images_have_it() -> None:
    levels = np.linspace(0, 1, 4001)
    linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    colors = np.stack([linear, linear[::-1], np.full_like(linear, 0.5)], 1)
    read = np.asarray(evaluate(decode_texel, evaluate(encode_texel, colors.astype(np.float32))))
    back = np.where(read <= 0.0031308, read * 12.92, 1.055 * np.maximum(read, 1e-9) ** (1 / 2.4) - 0.055)
    off = np.abs(back[:, 0] - levels) * 255
    assert off.max() < 0.25
    assert np.abs(back[:, 1] - levels[::-1]).max() * 255 < 0.25
    assert evaluate(decode_texel, evaluate(encode_texel, np.array([1.0, 0.0, 1.0], np.float32))).tolist() == [
        1,
        0,
        1,
    ]


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("make", [Deferred, TiledDeferred, ClusteredDeferred, partial(TiledDeferred, 4)])
@pytest.mark.parametrize("bends", [False, True])
def test_normals_of_8_bits_are_seen_to_be_rounded_and_those_of_16_are_those_of_rays(
    drawing_device: rhi.Device, make: Any, bends: bool
) -> None:
    """A highlight on a face that fills the image, with shadows and without: a map may bend its normal."""
    builder = make_boxes()
    image = builder.add_image(np.full((1, 1, 4), (134, 126, 254, 255), np.uint8))
    material = builder.add_material(
        normal_texture=image if bends else -1, specular_color=(1, 1, 1), shininess=400.0
    )
    builder.add_objects(builder.add_node(rotation((1, 2, 0), 0.4) @ scaling((60, 60, 9))), 0, material)
    builder.lights.add_point((5.8, -2.9, 11.2), 90.0, intensity=3.0, casts_shadow=bends)
    scene, eye, size = (
        builder.build(),
        Camera.look_at((0, 0, 14), (0, 0, 0), projection=Perspective(0.5)),
        (64, 36),
    )
    exact = RayTracer(scene).draw(eye, size)
    rendered_images = (
        draw(drawing_device, scene, make(normal_bits=bits), eye, size=size) for bits in NORMAL_BITS
    )
    small, usual = (np.abs(rendered - exact).max() for rendered in rendered_images)
    assert usual < 1.0
    assert 3.0 < small < 20.0
