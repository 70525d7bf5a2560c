"""What tests ask of a frame: its picture, its commands, its passes."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

import rhi
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Scene
from renderer.techniques import Technique
from renderer.visibility import NoCulling, make_visibility

SIZE = (48, 32)


def render(
    device: rhi.Device, scene: Scene, technique: Technique | None = None, camera: Camera | None = None,
    *, visibility: str = "none", frames: int = 1, size: tuple[int, int] = SIZE, **options: Any,
) -> tuple[Renderer, FrameResult]:
    """Render the scene's first view, or another; of a null device the stream is that of the last frame."""
    culling = NoCulling(scene) if visibility == "none" else make_visibility(visibility, scene, device)
    renderer = Renderer(device, scene, technique=technique, visibility=culling, size=size, **options)
    for _ in range(frames):
        if not device.capabilities.renders:
            device.stream.clear()
        result = renderer.render(camera or next(iter(scene.views.values())))
    return renderer, result


def draw(device: rhi.Device, scene: Scene, *given: Any, **options: Any) -> NDArray[Any]:
    """Return the picture (height, width, 3)."""
    renderer, result = render(device, scene, *given, **options)
    with renderer:
        return result.image.read()[..., :3].astype(int)


def record(device: rhi.Device, scene: Scene, *given: Any, **options: Any) -> rhi.CommandStream:
    """Return the commands of the second of two frames."""
    render(device, scene, *given, **{"frames": 2, **options})
    return device.stream


def list_passes(device: rhi.Device, scene: Scene, technique: Technique, **options: Any) -> list[str]:
    """Return the names of a frame's passes."""
    renderer, _ = render(device, scene, technique, **options)
    with renderer:
        return [one.name for one in renderer.plan(next(iter(scene.views.values())))[1].passes]


def count(device: rhi.Device, scene: Scene, *given: Any, **options: Any) -> tuple[int, int]:
    """Return the number of render passes and of draw calls in a frame."""
    stream = record(device, scene, *given, **options)
    return len(stream.filter(rhi.Op.BEGIN_PASS)), len(stream.draws())
