"""Clip space: +Y is up, and depth runs from 0 to 1 with any projection's sign.

Most renderers use reversed depth, 1 at the near plane and 0 at the far one: float depth is then equally exact
at all distances. Matrices from OpenGL's libraries (PyGLM, pyrr, transforms3d) map depth to -1…1 instead, -1
at the near plane.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rhi.errors import refuse
from rhi.errors.rules import DEVICE_ARGUMENT


def convert_projection(projection: ArrayLike, *, reverse: bool = True) -> NDArray[np.float64]:
    """Convert projections with a clip depth of -1…1, as OpenGL's libraries make them, to this interface's
    0…1.

    Args:
        projection: (…, 4, 4), row-major, applied as `matrix @ column`. Transpose those of libraries that
            multiply rows by matrices (pyrr) first.
        reverse: map the near plane to 1 and the far plane to 0, as the default depth function (GREATER) and a
            `clear_depth` of 0 expect; otherwise near to 0 and far to 1.

    Returns:
        (…, 4, 4): the same in x, y and w; z becomes (w - z) / 2, or (w + z) / 2. Computed in float64. A
        float32 input has already lost depth: its far plane is right to about far / near * 1e-7 of itself. So
        make projections in float64 where far / near is large.

    Raises:
        ValidationError: `device-argument` for another shape or numbers that aren't finite.

    Examples:
        >>> opengl = np.diag([1.0, 1.0, -1.0, 1.0])  # depth from -1 to 1, near at z = 1
        >>> (rhi.convert_projection(opengl) @ (0, 0, 1, 1)).tolist()
        [0.0, 0.0, 1.0, 1.0]
    """
    matrix = np.array(projection, np.float64)
    call = "rhi.convert_projection"
    if matrix.shape[-2:] != (4, 4):
        refuse(DEVICE_ARGUMENT, call, f"shape {matrix.shape}", "(…, 4, 4)")
    if not np.isfinite(matrix).all():
        refuse(DEVICE_ARGUMENT, call, "NaN or infinity", "finite numbers")
    z, w = matrix[..., 2, :].copy(), matrix[..., 3, :]
    matrix[..., 2, :] = (w - z) / 2 if reverse else (w + z) / 2
    return matrix
