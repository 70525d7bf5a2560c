"""Ambient occlusion, compared with rays in float64.

The scenes are roofs side by side: nothing that takes light is hidden from the eye, so what the depth buffer
doesn't know plays no part. Left out are pixels within a radius of the image's edges, and those whose
neighbours differ by more than `_EDGE` levels in the reference. What remains is the error of slices, steps and
pixels, given as its mean.
"""

from __future__ import annotations

from functools import cache, partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.content import BUILT_IN
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.lab.exam.ray_traced_cases import draw
from renderer.lab.exam.scenes import shows_something
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.scene import AlphaMode, AmbientOcclusion, Camera, Orthographic, Perspective, Scene, SceneBuilder
from renderer.scene.arrays import Floats
from rhi import Device
from rhi.math import multiply, rotation, scaling, translation

_SIZE: Final = (64, 36)
_FINER: Final = 5
"""Frames have as many times the pixels of the reference along each axis; the middle of each block is
compared."""
_ASPECT: Final = _SIZE[0] / _SIZE[1]
_EDGE: Final = 12.0
_MARGIN: Final = 7  # pixels, in which roofs beyond the image take light
_FAR: Final = 2.0**23
_SETTINGS: Final = {
    "default": {},
    "fine": {"occlusion.slices": 16, "occlusion.steps": 32, "occlusion.is_smooth": False},
}
_ROOFS: Final = (
    *(((0.8 * row - 2.8, 0.0, 0.0), (0.8, 0.8, 8.0), (0, 0, 1), np.pi / 4) for row in range(8)),
    ((0.0, 0.1, 0.0), (8.0, 0.5, 0.5), (1, 0, 0), np.pi / 4),
)
"""Boxes half sunk into the floor: position and size in units of the scene, axis and angle in radians. They go
on beyond the image."""


def make_roofs(unit: float, offset: float, radius: float, *, has_pane: bool) -> Scene:
    """Make roofs in ambient light alone.

    Args:
        unit: metres of the scene's unit.
        offset: metres from the origin, along each axis.
        radius: the radius of ambient occlusion, in units.
        has_pane: whether a clear pane is above the roofs.
    """
    builder = SceneBuilder("roofs")
    builder.lights.sky, builder.lights.ground = (0.9, 0.95, 1.0), (0.5, 0.45, 0.4)
    builder.ambient_occlusion = AmbientOcclusion(radius * unit)
    box = builder.add_mesh(BUILT_IN["box"]())
    grey = builder.add_material(base_color=(0.25, 0.2, 0.15), specular_color=(0.0, 0.0, 0.0))
    for position, size, axis, angle in _ROOFS:
        turned = multiply(rotation(axis, angle), scaling(np.multiply(size, unit)))
        node = builder.add_node(multiply(translation(np.multiply(position, unit) + offset), turned))
        builder.add_objects(node, box, grey)
    if has_pane:
        clear = builder.add_material(
            base_color=(1.0, 1.0, 1.0, 0.1), alpha_mode=AlphaMode.BLEND, specular_color=(0.0, 0.0, 0.0)
        )
        pane = multiply(
            translation(np.multiply((0.0, 1.2, 0.0), unit) + offset),
            scaling(np.multiply((6.0, 0.01, 6.0), unit)),
        )
        builder.add_objects(builder.add_node(pane), box, clear)
    return builder.build()


def make_aerial_camera(unit: float, offset: float) -> Camera:
    """The camera that looks straight down at the roofs."""
    eye, aim = np.multiply((0.0, 4.0, 0.0), unit) + offset, np.full(3, offset)
    return Camera.look_at(eye, aim, (0, 0, -1), Orthographic(3.0 * unit, _ASPECT, 0.0, 8.0 * unit))


def make_street_camera(unit: float) -> Camera:
    """The camera that looks at the roofs from the side."""
    projection = Perspective(aspect=_ASPECT, near=0.05 * unit)
    return Camera.look_at(np.multiply((0.0, 3.2, 2.5), unit), (0.0, 0.0, 0.0), projection=projection)


@cache  # the same for each device
def trace_views() -> dict[str, tuple[Scene, Camera, Floats]]:
    """Scenes by title, each with a camera and its ray-traced image in levels (h, w, 3)."""
    views = {
        "from the side, in a world of 1 mm": (
            make_roofs(1e-3, 0.0, 0.6, has_pane=False),
            make_street_camera(1e-3),
        ),
        "from above, far from the origin, under a pane": (
            make_roofs(1.0, _FAR, 0.6, has_pane=True),
            make_aerial_camera(1.0, _FAR),
        ),
    }
    return {
        title: (scene, camera, RayTracer(scene).draw(camera, _SIZE))
        for title, (scene, camera) in views.items()
    }


def _select_smooth(levels: Floats) -> NDArray[np.bool_]:
    """Return the pixels (h, w) that differ little from their four neighbours, and aren't near the image's
    edges."""
    across = np.abs(np.diff(levels, axis=1)).max(axis=2) > _EDGE
    down = np.abs(np.diff(levels, axis=0)).max(axis=2) > _EDGE
    has_edge = np.ones(levels.shape[:2], bool)
    has_edge[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN] = False
    has_edge[:, 1:] |= across
    has_edge[:, :-1] |= across
    has_edge[1:] |= down
    has_edge[:-1] |= down
    return ~has_edge


def _take_middles(image: NDArray[np.uint8]) -> Floats:
    """Return the colours (h, w, 3) in the middle of each block of pixels."""
    return image[_FINER // 2 :: _FINER, _FINER // 2 :: _FINER, :3].astype(np.float64)


def measure_occlusion(settings: str, technique: str, device: Device) -> CaseResult:
    """Draw roofs with ambient occlusion, and measure by how many levels pixels are off in the mean."""
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error = 0.0
    for title, (scene, camera, traced) in trace_views().items():
        size = (_SIZE[0] * _FINER, _SIZE[1] * _FINER)
        image = draw(device, scene, camera, size, technique, _SETTINGS[settings])
        occlusion, scene.ambient_occlusion = scene.ambient_occlusion, None
        open_image = draw(device, scene, camera, size, technique)
        scene.ambient_occlusion = occlusion
        smooth = _select_smooth(traced)
        off, effect = (
            np.where(smooth, np.abs(_take_middles(levels) - traced).max(axis=2), 0.0)
            for levels in (image, open_image)
        )
        mean, lost = (float(array[smooth].mean()) for array in (off, effect))
        numbers |= {
            f"{title}: levels off in the mean": round(mean, 3),
            f"{title}: without occlusion": round(lost, 3),
            f"{title}: pixels compared": int(smooth.sum()),
        }
        error = largest_error(error, mean)
        holds |= {f"{title}: {condition}": value for condition, value in shows_something([image]).items()}
        holds[f"{title}: a fifth of all pixels is compared"] = bool(smooth.mean() > 0.2)
        holds[f"{title}: occlusion changes four levels in the mean"] = lost > 4.0
        holds[f"{title}: no pixel is 20 levels off"] = bool(off.max() < 20.0)
        images |= {title: image, f"{title}, off": off}
    return CaseResult(error, numbers, holds, lambda: images)


MEASURES: Final[Measures] = {
    80: partial(measure_occlusion, "fine", "forward"),
    81: partial(measure_occlusion, "default", "tiled_deferred"),
}
