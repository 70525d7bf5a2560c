"""The look of a viewer: what draws its frames, as one value, and the renderer that is made to follow it.

A look is changed as a whole. If the device refuses to draw it, the viewer goes back to the last one that was drawn.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame import Blending, Frame, Layer
from renderer.measure.contents import picture_contents
from renderer.overlay import Overlay
from renderer.renderer import Renderer
from renderer.scene import Camera
from renderer.stereo import Stereo, find_rig
from renderer.techniques import AutoTechnique, Forward, Particles, Technique, TechniqueSettings, Watched
from renderer.techniques.inspection import INSPECTIONS, Inspection
from renderer.techniques.watched import list_contents
from renderer.visibility import VisibilityAlgorithm, check_algorithm, make_visibility
from rhi import Device

__rhi_internal__ = True

LIT: Final = "image"
"""The name of what a frame is for: the lit image."""
SHADOWS: Final = ("scene", "all", "off")
"""The lights that cast shadows: those of which the scene says so, all, or none."""

_DRAWN_BY: Final = ("technique", "samples", "fxaa", "show")


@dataclass(frozen=True, slots=True)
class Look:
    """What draws the frames.

    Attributes:
        technique, visibility: names, as on the command line.
        show: `LIT`, one of `INSPECTIONS`, or contents of the plan.
        samples: per pixel. fxaa: whether edges are smoothed. shadows: one of `SHADOWS`.
        blending: the name of a `Blending`. stereo: one of `OUTPUTS`, or None for one eye.
        overlay, particles: whether these layers are drawn.
    """

    technique: str = Forward.name
    visibility: str = "frustum"
    show: str = LIT
    samples: int = 1
    fxaa: bool = False
    shadows: str = "scene"
    blending: str = Blending.SORTED.value
    stereo: str | None = None
    overlay: bool = False
    particles: bool = False

    def describe(self) -> str:
        """Return what differs from the plain look, in a line."""
        words = [self.technique, self.visibility]
        for entry in fields(self):
            value = getattr(self, entry.name)
            if entry.name not in ("technique", "visibility") and value != entry.default:
                words.append(entry.name if value is True else f"{entry.name} {value}")
        return ", ".join(words)


class WatchedPicture:
    """A layer that shows the buffer that a `Watched` technique has read, instead of the image."""

    def __init__(self, technique: Watched, name: str) -> None:
        self._technique = technique
        self._name = name

    def render(self, device: Device, frame: Frame) -> None:
        """Write the picture of the buffer to the frame's image."""
        if self._technique.texels is None:
            return
        colors = picture_contents(self._name, self._technique.texels)
        image = frame.targets.image
        if (colors.shape[1], colors.shape[0]) != image.size:  # such as a shadow atlas: its nearest texels
            width, height = image.size
            rows = np.arange(height) * colors.shape[0] // height
            colors = colors[rows[:, None], np.arange(width) * colors.shape[1] // width]
        image.write(np.concatenate([colors, np.full((*colors.shape[:2], 1), 255, np.uint8)], axis=2))

    def destroy(self) -> None:
        """Do nothing: there are no resources on the device."""


class Dresser:
    """Makes a renderer follow a look.

    Attributes:
        look: the one that the renderer follows.
    """

    def __init__(self, renderer: Renderer, look: Look, always: Iterable[Layer] = ()) -> None:
        """Follow `look`, which has one eye. The layers `always` are drawn last, in every look."""
        self._renderer = renderer
        self._always = list(always)
        self._timing = renderer.device.timing
        self._shadows = [lights["casts_shadow"].copy() for lights in self._lights]
        self._layers: dict[str, Layer] = {}
        self._visibility: VisibilityAlgorithm | None = None
        self.look = replace(look, technique="", visibility="")
        self.wear(look, next(iter(renderer.scene.views.values())))

    @property
    def _lights(self) -> tuple[NDArray[Any], ...]:
        lights = self._renderer.scene.lights
        return lights.directional, lights.point, lights.spot

    def wear(self, look: Look, camera: Camera) -> None:
        """Make the renderer follow `look`; two eyes are set for what `camera` sees. If anything refuses it, all stays.

        Raises:
            ValidationError: what a name, an algorithm or a technique refuses.
        """
        renderer, before = self._renderer, self.look
        technique, stereo, blending = renderer.technique, renderer.stereo, Blending(look.blending)
        if any(getattr(look, name) != getattr(before, name) for name in _DRAWN_BY):
            technique = self._make_technique(look)
        layers: list[Layer] = [WatchedPicture(technique, look.show)] if isinstance(technique, Watched) else []
        layers += [self._find_layer(name) for name in ("particles", "overlay") if getattr(look, name)]
        if look.stereo != before.stereo:
            stereo = None
            if look.stereo is not None:
                fitted = camera.with_aspect(renderer.size[0] / renderer.size[1])
                stereo = Stereo(find_rig(renderer.scene, fitted), look.stereo)
        with ExitStack() as undo:
            visibility = self._visibility
            if look.visibility != before.visibility:
                check_algorithm(look.visibility, renderer.device, "visibility")
                visibility = make_visibility(look.visibility, renderer.scene, renderer.device)
                undo.callback(visibility.destroy)
            if stereo is not renderer.stereo:
                renderer.stereo = stereo
            undo.pop_all()
        assert visibility is not None
        renderer.technique, renderer.blending, renderer.visibility = technique, blending, visibility
        if self._visibility not in (None, visibility):
            self._visibility.destroy()
        self._visibility = visibility
        for lights, casts in zip(self._lights, self._shadows, strict=True):
            lights["casts_shadow"] = {"scene": casts, "all": True, "off": False}[look.shadows]
        renderer.layers[:] = [*layers, *self._always]
        renderer.device.timing = self._timing or (look.overlay and renderer.device.capabilities.timestamps)
        self.look = look

    def list_contents(self, camera: Camera) -> list[str]:
        """Return what can be shown: the image, `INSPECTIONS`, and the textures of the technique's plan."""
        needs, _ = self._renderer.plan(camera)
        contents = list_contents(self._make_plain(self.look).declare(needs))
        return list(dict.fromkeys([LIT, *INSPECTIONS, *contents]))

    def destroy(self) -> None:
        """Destroy what was made for looks."""
        for layer in self._layers.values():
            layer.destroy()
        if self._visibility is not None:
            self._visibility.destroy()

    def _find_layer(self, name: str) -> Layer:
        if name not in self._layers:
            device = self._renderer.device
            scale = max(1, self._renderer.size[1] // 720)
            self._layers[name] = Particles(device) if name == "particles" else Overlay(device, scale=scale)
        return self._layers[name]

    def _make_plain(self, look: Look) -> Technique:
        """Return the technique of a look; buffers are those of one that doesn't change."""
        renderer, name = self._renderer, look.technique
        if name == AutoTechnique.name and look.show != LIT:
            name = Forward.name
        settings = TechniqueSettings(name, samples=look.samples, fxaa=look.fxaa)
        return settings.make(renderer.scene, renderer.device)

    def _make_technique(self, look: Look) -> Technique:
        plain = self._make_plain(look)  # which refuses samples that it lacks, also where a picture hides that
        if look.show in INSPECTIONS:
            return Inspection(look.show)
        return plain if look.show == LIT else Watched(plain, look.show)
