"""The constants that lead from pixels to positions: the rays of a frame's view."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from renderer.frame.drawing import FARTHEST
from renderer.frame.frame import Frame
from renderer.scene import Camera, Depth
from renderer.shaders.pixels import PixelRays
from rhi import UniformBuffer
from rhi.math import distance_at_depth


@lru_cache(maxsize=4)
def compute_pixel_rays(camera: Camera, size: tuple[int, int]) -> PixelRays:
    """Rays through the pixels of an image of `size`, computed in float64."""
    (width, height), matrix = size, camera.projection.matrix
    # A projection maps (x, y, -d) to clip coordinates. Its rows are solved for x and y, as functions of the
    # pixel and of d: matrix[0, 0] * x = pixel_x * w + matrix[0, 2] * d - matrix[0, 3], where w = by_distance
    # * d + constant.
    by_distance, constant = -matrix[3, 2], matrix[3, 3]
    scale = np.array([matrix[0, 0], matrix[1, 1], 1.0])
    across = np.array([[2.0 / width, 0.0, -1.0], [0.0, -2.0 / height, 1.0], [0.0, 0.0, 0.0]]) / scale[:, None]
    along = np.array([matrix[0, 2], matrix[1, 2], -1.0]) / scale
    start = np.array([-matrix[0, 3], -matrix[1, 3], 0.0]) / scale
    depth = camera.projection.depth
    # Nearness is z / w, or 1 - z / w for standard depth; that is solved for the distance.
    near = matrix[2] if depth is Depth.REVERSED else matrix[3] - matrix[2]
    return PixelRays(
        across=camera.rotation.T @ across,
        along=camera.rotation.T @ along,
        start=camera.rotation.T @ start,
        size=size,
        forward=camera.forward,
        far=far_distance(camera),
        farthest=FARTHEST[depth],
        projection=(near[3], constant, near[2], -by_distance),
    )


def far_distance(camera: Camera) -> float:
    """Distance of the far plane; the largest float if there is none."""
    far = distance_at_depth(camera.projection.matrix, FARTHEST[camera.projection.depth])
    return min(far, float(np.finfo(np.float32).max))


def bind_rays(frame: Frame) -> UniformBuffer[PixelRays]:
    """Rays through the pixels of the frame's view."""
    return frame.view.mirror(compute_pixel_rays(frame.camera, frame.targets.size))
