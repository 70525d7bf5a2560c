"""Views of a plane that fills the image, before a light: the point of each pixel is where its ray meets the plane.

So a case's equations are evaluated at the points of all pixels, in float64, and compared with what a device draws.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from renderer.lab.exam.case import CaseImage, CaseResult, largest_error
from renderer.lab.exam.ray_traced_cases import draw
from renderer.lab.exam.scenes import shows_something
from renderer.scene import Camera, Perspective, Scene
from renderer.scene.arrays import Floats
from rhi import Device

FIELD_OF_VIEW: Final = 0.9
"""Of all views, in radians from top to bottom."""


class LitPlane(Protocol):
    """A view of the plane."""

    @property
    def technique(self) -> str:
        """The technique that draws it."""
        ...


V = TypeVar("V", bound=LitPlane)


def intersect_plane(size: tuple[int, int], eye: Floats, target: Floats) -> Floats:
    """The points (h, w, 3) at z = 0 that the pixels of a view from `eye` to `target` show."""
    width, height = size
    camera = Camera.look_at(eye, target, projection=Perspective(FIELD_OF_VIEW, width / height))
    slope = np.tan(0.5 * FIELD_OF_VIEW)
    x = ((np.arange(width) + 0.5) / width * 2.0 - 1.0) * slope * width / height
    y = (1.0 - (np.arange(height) + 0.5) / height * 2.0) * slope
    rays = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1) @ camera.rotation
    return np.asarray(eye + rays * (-eye[2] / rays[..., 2])[..., None])


def normalize(vectors: Floats) -> Floats:
    """Vectors (..., 3) of length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def measure_views(
    device: Device,
    size: tuple[int, int],
    views: Mapping[str, V],
    make_scene: Callable[[V], tuple[Scene, Camera]],
    compute_levels: Callable[[V], Floats],
    ignored: NDArray[np.bool_] | None = None,
) -> CaseResult:
    """Draw the views, and measure by how many levels they are off; `ignored` pixels (h, w) don't count."""
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error = 0.0
    for title, view in views.items():
        scene, camera = make_scene(view)
        image = draw(device, scene, camera, size, technique=view.technique)
        off = np.abs(image[..., :3].astype(np.float64) - compute_levels(view)).max(axis=2)
        if ignored is not None:
            off[ignored] = 0.0
        numbers[f"{title}: levels off"] = round(float(off.max()), 3)
        error = largest_error(error, float(off.max()))
        for description, is_true in shows_something([image]).items():
            holds[f"{title}: {description}"] = is_true
        images |= {title: image, f"{title}, off": off}
    return CaseResult(error, numbers, holds, lambda: images)
