"""What a geometry buffer stores: texels and positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from renderer.scene import Camera, Depth, Orthographic, Perspective, Projection
from renderer.techniques.geometry_buffer import (
    decode_texel,
    encode_texel,
    find_rays,
)
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


@dataclass(frozen=True)
class OffAxis:
    """A perspective lens whose middle isn't the middle of the image, as that of one eye of two."""

    depth: Depth = Depth.REVERSED

    @property
    def matrix(self) -> Floats:
        matrix = Perspective(aspect=1.5).matrix.copy()
        matrix[0, 2], matrix[1, 2] = 0.3, -0.2
        return matrix

    def with_aspect(self, aspect: float) -> OffAxis:
        return self


LENSES: dict[str, Projection] = {
    "perspective": Perspective(aspect=1.5),
    "far plane": Perspective(near=0.5, far=900.0, aspect=1.5),
    "standard depth": Perspective(aspect=1.5, depth=Depth.STANDARD),
    "off-axis": OffAxis(),
    "parallel": Orthographic(30.0, aspect=1.5, near=-5.0, far=400.0),
    "parallel, standard depth": Orthographic(30.0, aspect=1.5, depth=Depth.STANDARD),
}


@pytest.mark.parametrize("lens", LENSES)
def test_a_position_follows_from_the_pixel_and_the_distance(lens: str) -> None:
    size = (60, 40)
    camera = Camera.look_at((1e6, 50, -2e6), (1e6 + 3, 48, -2e6 + 5), projection=LENSES[lens])
    rays = find_rays(camera, size)
    random = np.random.default_rng(2)
    pixels = np.concatenate([random.uniform(0, size, (500, 2)), np.ones((500, 1))], 1)
    distances = random.uniform(1.0, 300.0, 500)
    places = (pixels @ np.array(rays.direction).T) * distances[:, None] + pixels @ np.array(rays.origin).T
    assert places @ np.array(rays.forward) == pytest.approx(distances, rel=1e-6)
    matrix = camera.projection.matrix @ np.block([[camera.rotation, np.zeros((3, 1))], [np.zeros((1, 3)), 1.0]])
    clip = np.concatenate([places, np.ones((500, 1))], 1) @ matrix.T
    x, y = clip[:, 0] / clip[:, 3], clip[:, 1] / clip[:, 3]
    assert (0.5 + 0.5 * x) * size[0] == pytest.approx(pixels[:, 0], abs=2e-4)
    assert (0.5 - 0.5 * y) * size[1] == pytest.approx(pixels[:, 1], abs=2e-4)


@pytest.mark.parametrize(("lens", "far"), [("perspective", 3.4e38), ("far plane", 900.0), ("parallel", 400.0)])
def test_the_far_plane_is_as_far_as_the_lens_says(lens: str, far: float) -> None:
    camera = Camera.look_at((1e6, 50, -2e6), (1e6 + 3, 48, -2e6 + 5), projection=LENSES[lens])
    assert find_rays(camera, (60, 40)).far == pytest.approx(far, rel=1e-3)
