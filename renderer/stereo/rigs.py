"""The rig for a scene as a camera sees it."""

from __future__ import annotations

from typing import Final

from renderer.scene import Camera, Scene, StereoRig
from renderer.visibility.boxes.depth_range import find_depth_range

_LEAST: Final = 1e-3  # of the farthest depth: a parallel lens may see what is behind the eye


def find_rig(
    scene: Scene,
    camera: Camera,
    *,
    eye_distance: float | None = None,
    convergence: float | None = None,
    is_toed_in: bool = False,
) -> StereoRig:
    """Return the rig that is comfortable for what `camera` sees of `scene`, with what is given instead."""
    depths = find_depth_range(scene, camera)
    rig = StereoRig()
    if depths is not None and depths[1] > 0.0:
        nearest, farthest = depths
        rig = StereoRig.comfortable(camera.projection, max(nearest, _LEAST * farthest), farthest)
    return StereoRig(
        rig.eye_distance if eye_distance is None else eye_distance,
        rig.convergence if convergence is None else convergence,
        is_toed_in,
    )
