"""Temporal anti-aliasing, compared with 64 rays a pixel in float64.

A fence of thin bars stands on a striped floor, before it a wheel turns, and a block slides. Nothing moves in one case;
in the other the wheel, the block and the camera do, and the last frame is compared. The error is the mean over all
pixels.
"""

from __future__ import annotations

from functools import cache, partial
from typing import Final

import numpy as np

from renderer.content import BUILT_IN
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.lab.exam.scenes import make_projection, shows_something
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.scene import Camera, Scene, SceneBuilder
from renderer.scene.arrays import Floats
from renderer.settings import RenderSettings
from rhi import Device
from rhi.math import multiply, rotation, scaling, translation

_SIZE: Final = (56, 32)
_RAYS: Final = 8  # along each side of a pixel
_ASPECT: Final = _SIZE[0] / _SIZE[1]
_FAR: Final = 2.0**21
_FRAMES: Final = {"still": 64, "moving": 24}
_SETTINGS: Final[dict[str, dict[str, object]]] = {
    "still": {"temporal.is_on": True, "temporal.bits": 32},
    "moving": {"temporal.is_on": True},
}


class BarFence:
    """A scene of a fence, a wheel and a block, in a world of its own scale.

    Attributes:
        scene: the scene, at its last frame.
        unit: metres of the scene's unit.
        offset: metres from the origin, along each axis.
        is_parallel: whether the camera's projection is parallel.
    """

    def __init__(self, unit: float, offset: float, *, is_parallel: bool) -> None:
        self.unit, self.offset, self.is_parallel = unit, offset, is_parallel
        builder = SceneBuilder("fence")
        builder.background = (0.02, 0.05, 0.12)
        builder.lights.sky, builder.lights.ground = (0.7, 0.75, 0.8), (0.3, 0.25, 0.2)
        builder.lights.add_directional((-0.4, -1.0, -0.6), intensity=1.2)
        box = builder.add_mesh(BUILT_IN["box"]())
        colors = ((0.6, 0.55, 0.5), (0.15, 0.18, 0.2), (0.8, 0.75, 0.7), (0.8, 0.2, 0.1), (0.2, 0.6, 0.25))
        materials = [
            builder.add_material(base_color=color, specular_color=(0.0, 0.0, 0.0)) for color in colors
        ]
        for number in range(12):
            at = self._transform_box((0.0, -0.05, 3.5 - number), (14.0, 0.1, 1.0))
            builder.add_objects(builder.add_node(at), box, materials[number % 2])
        for number in range(16):
            at = self._transform_box((0.3 * number - 2.4, 0.6, -1.0), (0.12, 1.2, 0.05), 0.2)
            builder.add_objects(builder.add_node(at), box, materials[2])
        self._wheel, self._block = (
            int(builder.add_node(local, dynamic=True)) for local in self._pose_movers(0)
        )
        for number in range(3):
            spoke = multiply(rotation((0, 0, 1), np.pi / 3.0 * number), scaling((1.0, 0.08, 0.08)))
            builder.add_objects(builder.add_node(spoke, self._wheel), box, materials[3])
        builder.add_objects(self._block, box, materials[4])
        self.scene: Scene = builder.build()

    def _transform_box(
        self, position: tuple[float, float, float], size: tuple[float, float, float], angle: float = 0.0
    ) -> Floats:
        """The transform of a box at a position, turned around z; lengths are in units."""
        turned = multiply(rotation((0, 0, 1), angle), scaling(np.multiply(size, self.unit)))
        return multiply(translation(np.multiply(position, self.unit) + self.offset), turned)

    def _pose_movers(self, frame: int) -> tuple[Floats, Floats]:
        """The transforms of the wheel and of the block, so many frames before the last one."""
        return (
            self._transform_box((-0.7, 0.6, 0.3), (1.0, 1.0, 1.0), 0.03 * frame),
            self._transform_box((0.9 - 0.03 * frame, 0.25, 0.5), (0.5, 0.5, 0.5)),
        )

    def move(self, frame: int) -> Camera:
        """Move to so many frames before the last one; return the camera."""
        self.scene.nodes.set_local([self._wheel, self._block], np.stack(self._pose_movers(frame)))
        aside = 0.01 * frame
        eye, aim = (
            np.multiply(point, self.unit) + self.offset
            for point in ((0.3 + aside, 1.1, 4.0), (0.5 * aside, 0.5, 0.0))
        )
        projection = make_projection(self.unit, _ASPECT, 2.6, is_parallel=self.is_parallel, fov=0.7)
        return Camera.look_at(eye, aim, projection=projection)


@cache  # the same for each device
def trace_fences() -> dict[str, tuple[BarFence, Floats]]:
    """Fences by title, each with the ray-traced levels (h, w, 3) of its last frame."""
    fences = {
        "in a world of 1 mm": BarFence(1e-3, 0.0, is_parallel=False),
        "parallel, far from the origin": BarFence(1.0, _FAR, is_parallel=True),
    }
    traced = dict[str, tuple[BarFence, Floats]]()
    for title, fence in fences.items():
        camera = fence.move(0)
        fence.scene.update()
        traced[title] = fence, RayTracer(fence.scene).draw(camera, _SIZE, _RAYS)
    return traced


def draw_last_frame(
    device: Device, fence: BarFence, technique: str, changes: dict[str, object], *, frames: int, moves: bool
) -> CaseImage:
    """Draw some frames of a fence; return the last one."""
    settings = RenderSettings().change_all({"technique.name": technique, "algorithm": "none", **changes})
    with settings.open(device, fence.scene, _SIZE) as renderer:
        camera = fence.move(frames - 1 if moves else 0)
        for frame in range(frames - 1, -1, -1):
            if moves:
                camera = fence.move(frame)
            result = renderer.render(settings.adapt_camera(camera), 0.0)
        return result.image.read()


def measure_temporal(kind: str, technique: str, device: Device) -> CaseResult:
    """Draw fences with temporal anti-aliasing, and measure by how many levels pixels are off in the mean."""
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error, moves = 0.0, kind == "moving"
    for title, (fence, traced) in trace_fences().items():
        image = draw_last_frame(device, fence, technique, _SETTINGS[kind], frames=_FRAMES[kind], moves=moves)
        single = draw_last_frame(device, fence, technique, {}, frames=1, moves=False)
        off, single_off = (
            np.abs(levels[..., :3].astype(np.float64) - traced).max(axis=2) for levels in (image, single)
        )
        numbers |= {
            f"{title}: levels off in the mean": round(float(off.mean()), 3),
            f"{title}: of a frame alone": round(float(single_off.mean()), 3),
        }
        error = largest_error(error, float(off.mean()))
        holds |= {f"{title}: {condition}": value for condition, value in shows_something([image]).items()}
        holds[f"{title}: a frame alone is five levels off in the mean"] = bool(single_off.mean() > 5.0)
        images |= {title: image, f"{title}, off": off}
    return CaseResult(error, numbers, holds, lambda: images)


MEASURES: Final[Measures] = {
    87: partial(measure_temporal, "still", "forward"),
    88: partial(measure_temporal, "moving", "tiled_deferred"),
}
