"""The look of a viewer: what draws its frames, as one value, and the renderer that is made to follow it.

A look is changed as a whole. If the device refuses to draw it, the viewer goes back to the last one that was drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame import Blending, Frame, Layer
from renderer.lab.measure.contents import picture_contents
from renderer.layers.ground_grid import GroundGrid
from renderer.layers.overlay import Overlay
from renderer.layers.particles import Particles
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.settings import RenderSettings
from renderer.stereo import Stereo, find_rig
from renderer.techniques import AutoTechnique, Forward, Technique, TechniqueSettings, Watched
from renderer.techniques.inspection import INSPECTIONS, Inspection
from renderer.techniques.watched import list_contents
from renderer.visibility import VisibilityAlgorithm, check_algorithm, make_visibility
from rhi import Device

LIT: Final = "image"
"""The name of what a frame is for: the lit image."""
SHADOWS: Final = ("scene", "all", "off")
"""The lights that cast shadows: those of which the scene says so, all, or none."""

PLAIN: Final = RenderSettings(technique=TechniqueSettings(Forward.name), algorithm="frustum")
"""The look that a viewer begins with: the one that builds the fewest kernels, so that the first picture comes soon."""

_SETTINGS: Final = {
    "technique": "technique.name",
    "samples": "technique.samples",
    "fxaa": "technique.fxaa",
    "visibility": "algorithm",
    "blending": "blending",
}
"""The settings that entries of a look are, by their paths."""

_SCENE_LAYERS: Final[dict[str, Callable[[Device], Layer]]] = {"particles": Particles, "grid": GroundGrid}
"""What makes the layers of the scene, by the entries of a look."""


@dataclass(frozen=True, slots=True)
class Look:
    """The drawing of frames: technique, samples, filters, eyes.

    Attributes:
        settings: how the scene is drawn.
        show: `LIT`, one of `INSPECTIONS`, or contents of the plan.
        shadows: one of `SHADOWS`. stereo: one of `OUTPUTS`, or None for one eye.
        overlay, particles, grid: whether these layers are drawn.
    """

    settings: RenderSettings = PLAIN
    show: str = LIT
    shadows: str = SHADOWS[0]
    stereo: str | None = None
    overlay: bool = False
    particles: bool = False
    grid: bool = False

    @property
    def technique(self) -> str:
        """The name of the technique, as on the command line."""
        return self.settings.technique.name

    @property
    def visibility(self) -> str:
        """The name of the visibility algorithm, as on the command line."""
        return self.settings.algorithm

    @property
    def samples(self) -> int:
        """Samples per pixel."""
        return self.settings.technique.samples

    @property
    def fxaa(self) -> bool:
        """Whether edges are smoothed."""
        return self.settings.technique.fxaa

    @property
    def blending(self) -> str:
        """The way in which transparent surfaces are put together: the value of a `Blending`."""
        return self.settings.blending.value

    def change(self, **entries: Any) -> Look:
        """Return a look with other entries: attributes, or settings by the name of a property.

        Raises:
            ValidationError: what settings refuse.
        """
        settings = entries.pop("settings", self.settings)
        changes = {_SETTINGS[name]: entries.pop(name) for name in _SETTINGS if name in entries}
        if "blending" in changes:
            changes["blending"] = Blending(changes["blending"])
        if changes:
            settings = settings.change_all(changes)
        return replace(self, settings=settings, **entries)

    def describe(self) -> str:
        """Return what differs from the plain look, in a line."""
        words, plain = [self.technique, self.visibility], Look()
        for name in ("show", "samples", "fxaa", "shadows", "blending", "stereo", "overlay", "particles", "grid"):
            value = getattr(self, name)
            if value != getattr(plain, name):
                words.append(name if value is True else f"{name} {value}")
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


class OriginalState:
    """The state of a device and a scene before a look changed them."""

    def __init__(self, device: Device, scene: Scene) -> None:
        self.timing = device.timing
        self.shadows = [lights["casts_shadow"].copy() for lights in _list_lights(scene)]


class Configurator:
    """Makes a renderer follow a look.

    Attributes:
        look: the one that the renderer follows.
    """

    def __init__(self, renderer: Renderer, look: Look, original: OriginalState, always: Iterable[Layer] = ()) -> None:
        """Follow `look`. The layers `always` are drawn last, in every look."""
        self._renderer = renderer
        self._original = original
        self._always = list(always)
        self._layers: dict[str, Layer] = {}
        self._visibility: VisibilityAlgorithm | None = None
        self._made_for: dict[str, object] = {}
        self.look = look
        self.apply(look, next(iter(renderer.scene.views.values())))

    def apply(self, look: Look, camera: Camera) -> None:
        """Make the renderer follow `look`, whose texture settings are the renderer's; two eyes are set for what
        `camera` sees. If anything refuses it, all stays.

        Raises:
            ValidationError: what a name, an algorithm or a technique refuses.
        """
        renderer, settings = self._renderer, look.settings
        made_for: dict[str, object] = {
            "technique": (look.show, settings.technique),
            "stereo": (look.stereo, settings.reprojects),
            "visibility": (settings.algorithm, settings.visibility),
        }
        changed = {name for name, value in made_for.items() if value != self._made_for.get(name)}
        technique, stereo, visibility = renderer.technique, renderer.stereo, self._visibility
        if "technique" in changed:
            technique = self._make_technique(look)
        layers: list[Layer] = [WatchedPicture(technique, look.show)] if isinstance(technique, Watched) else []
        layers += [self._find_layer(name) for name in (*_SCENE_LAYERS, "overlay") if getattr(look, name)]
        if "stereo" in changed:
            stereo = None
            if look.stereo is not None:
                fitted = settings.aim(camera.with_aspect(renderer.size[0] / renderer.size[1]))
                rig = find_rig(renderer.scene, fitted)
                stereo = Stereo(rig, look.stereo, is_reprojected=settings.reprojects)
        with ExitStack() as undo:
            if "visibility" in changed:
                check_algorithm(settings.algorithm, renderer.device, "visibility")
                visibility = make_visibility(settings.algorithm, renderer.scene, renderer.device, settings.visibility)
                undo.callback(visibility.destroy)
            if stereo is not renderer.stereo:
                renderer.stereo = stereo
            undo.pop_all()
        assert visibility is not None
        settings.exchange(renderer, technique)
        renderer.visibility = visibility
        if self._visibility not in (None, visibility):
            self._visibility.destroy()
        self._visibility = visibility
        for lights, casts in zip(_list_lights(renderer.scene), self._original.shadows, strict=True):
            lights["casts_shadow"] = {"scene": casts, "all": True, "off": False}[look.shadows]
        renderer.layers[:] = [*layers, *self._always]
        shows_times = look.overlay and renderer.device.capabilities.timestamps
        renderer.device.timing = self._original.timing or shows_times
        self.look, self._made_for = look, made_for

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
            made = _SCENE_LAYERS[name](device) if name in _SCENE_LAYERS else Overlay(device, scale=scale)
            self._layers[name] = made
        return self._layers[name]

    def _make_plain(self, look: Look) -> Technique:
        """Return the technique of a look; buffers are those of one that doesn't change."""
        settings = look.settings.technique
        if settings.name == AutoTechnique.name and look.show != LIT:
            settings = replace(settings, name=Forward.name)
        return settings.make(self._renderer.scene, self._renderer.device)

    def _make_technique(self, look: Look) -> Technique:
        plain = self._make_plain(look)  # which refuses samples that it lacks, also where a picture hides that
        if look.show in INSPECTIONS:
            return Inspection(look.show, look.settings.technique.find_cells(look.show))
        return plain if look.show == LIT else Watched(plain, look.show)


def _list_lights(scene: Scene) -> tuple[NDArray[Any], ...]:
    return scene.lights.directional, scene.lights.point, scene.lights.spot
