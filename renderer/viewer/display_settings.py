"""The display settings of a viewer: one value that says how frames are drawn, and the `Configurator` that
applies it.

They change as a whole. If the device refuses to draw them, the viewer returns to the last ones that were
drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame import COMPONENTS, Blending, Frame, Layer, LightComponent
from renderer.inspection.texture_images import texture_to_image
from renderer.layers.ground_grid import GroundGrid
from renderer.layers.overlay import Overlay
from renderer.layers.particles import Particles
from renderer.light_kinds import LIGHT_KINDS
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.settings import RenderSettings
from renderer.stereo import Stereo, compute_rig
from renderer.techniques import AutoTechnique, Forward, ResourceCapture, Technique, TechniqueSettings
from renderer.techniques.inspection import INSPECTIONS, Inspection
from renderer.techniques.resource_capture import list_resources
from renderer.visibility import VisibilityAlgorithm, check_algorithm, make_visibility
from rhi import Device

LIT_IMAGE: Final = "image"
"""The name of the lit image, among what can be shown."""
SHADOWS: Final = ("scene", "all", "off")
"""The lights that cast shadows: as the scene says, all, or none."""

PLAIN: Final = RenderSettings(technique=TechniqueSettings(Forward.name), algorithm="frustum")
"""The first settings of a viewer: they build the fewest kernels, so that the first frame comes soon."""

_SETTINGS: Final = {
    "technique": "technique.name",
    "samples": "technique.samples",
    "fxaa": "technique.fxaa",
    "temporal": "temporal.is_on",
    "visibility": "algorithm",
    "blending": "blending",
}
"""The paths of the `RenderSettings` that are entries of the display settings."""

_SCENE_LAYERS: Final[dict[str, Callable[[Device], Layer]]] = {"particles": Particles, "grid": GroundGrid}
"""Constructors of the scene's layers, by the entries of the display settings."""


@dataclass(frozen=True, slots=True)
class DisplaySettings:
    """The settings of drawn frames: technique, samples, filters, eyes.

    Attributes:
        settings: how the scene is drawn.
        show: `LIT_IMAGE`, one of `COMPONENTS` of light, one of `INSPECTIONS`, or a resource of the plan.
        shadows: one of `SHADOWS`.
        stereo: one of `OUTPUTS`, or None for one eye.
        overlay, particles, grid: whether these layers are drawn.
    """

    settings: RenderSettings = PLAIN
    show: str = LIT_IMAGE
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
        """True if edges are smoothed."""
        return self.settings.technique.fxaa

    @property
    def temporal(self) -> bool:
        """True if samples of many frames are put together."""
        return self.settings.temporal.is_on

    @property
    def blending(self) -> str:
        """The blending of transparent surfaces: the value of a `Blending`."""
        return self.settings.blending.value

    def change(self, **entries: Any) -> DisplaySettings:
        """Display settings with other entries: attributes, or settings by the name of a property.

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
        """A line with what differs from the plain settings."""
        words, plain = [self.technique, self.visibility], DisplaySettings()
        for name in (
            "show",
            "samples",
            "fxaa",
            "temporal",
            "shadows",
            "blending",
            "stereo",
            "overlay",
            "particles",
            "grid",
        ):
            value = getattr(self, name)
            if value != getattr(plain, name):
                words.append(name if value is True else f"{name} {value}")
        return ", ".join(words)


class TextureViewLayer:
    """A layer that shows the texture that a `ResourceCapture` technique has read, instead of the image."""

    def __init__(self, technique: ResourceCapture, name: str) -> None:
        self._technique = technique
        self._name = name

    def render(self, device: Device, frame: Frame) -> None:
        """Write the image of the texture to the frame's image."""
        if self._technique.texels is None:
            return
        colors = texture_to_image(self._name, self._technique.texels)
        image = frame.targets.image
        if (colors.shape[1], colors.shape[0]) != image.size:  # such as a shadow atlas: its nearest texels
            width, height = image.size
            rows = np.arange(height) * colors.shape[0] // height
            colors = colors[rows[:, None], np.arange(width) * colors.shape[1] // width]
        image.write(np.concatenate([colors, np.full((*colors.shape[:2], 1), 255, np.uint8)], axis=2))

    def destroy(self) -> None:
        """Do nothing: there are no resources on the device."""


class OriginalState:
    """The state of a device and a scene before display settings changed them.

    Attributes:
        timing: whether the device took times.
        is_timed: whether times are taken with all display settings, where the device can.
        shadows: the lights that cast shadows, of each kind.
    """

    def __init__(self, device: Device, scene: Scene) -> None:
        self.timing = device.timing
        self.is_timed = False
        self.shadows = [lights["casts_shadow"].copy() for lights in _list_lights(scene)]


class Configurator:
    """Configures a renderer as display settings say.

    Attributes:
        display: the current display settings.
    """

    def __init__(
        self,
        renderer: Renderer,
        display: DisplaySettings,
        original: OriginalState,
        always: Iterable[Layer] = (),
    ) -> None:
        """Configure for `display`. The layers `always` are drawn last, with all settings."""
        self._renderer = renderer
        self._original = original
        self._always = list(always)
        self._layers: dict[str, Layer] = {}
        self._visibility: VisibilityAlgorithm | None = None
        self._applied: dict[str, object] = {}
        self.display = display
        self.apply(display, next(iter(renderer.scene.views.values())))

    def apply(self, display: DisplaySettings, camera: Camera) -> None:
        """Configure the renderer for `display`, whose texture settings are the renderer's; stereo is set for
        what `camera` sees. If anything refuses it, all stays as it was.

        Raises:
            ValidationError: what a name, an algorithm or a technique refuses.
        """
        renderer, settings = self._renderer, display.settings
        made_for: dict[str, object] = {
            "technique": (display.show, settings.technique),
            "stereo": (display.stereo, settings.reprojects, settings.far_error),
            "visibility": (settings.algorithm, settings.visibility),
        }
        changed = {name for name, value in made_for.items() if value != self._applied.get(name)}
        technique = renderer.technique
        stereo = renderer.stereo
        visibility = self._visibility
        if "technique" in changed:
            technique = self._make_technique(display)
        layers: list[Layer] = (
            [TextureViewLayer(technique, display.show)] if isinstance(technique, ResourceCapture) else []
        )
        layers += [self._get_layer(name) for name in (*_SCENE_LAYERS, "overlay") if getattr(display, name)]
        if "stereo" in changed:
            stereo = None
            if display.stereo is not None:
                fitted = settings.adapt_camera(camera.with_aspect(renderer.size[0] / renderer.size[1]))
                rig = compute_rig(renderer.scene, fitted)
                stereo = Stereo(
                    rig,
                    display.stereo,
                    is_reprojected=settings.reprojects,
                    far_error=settings.far_error,
                )
        with ExitStack() as undo:
            if "visibility" in changed:
                check_algorithm(settings.algorithm, renderer.device, "visibility")
                visibility = make_visibility(
                    settings.algorithm, renderer.scene, renderer.device, settings.visibility
                )
                undo.callback(visibility.destroy)
            if stereo is not renderer.stereo:
                renderer.stereo = stereo
            undo.pop_all()
        assert visibility is not None
        settings.apply_to(renderer, technique)
        renderer.light_component = COMPONENTS.get(display.show, LightComponent.ALL)
        renderer.visibility = visibility
        if self._visibility not in (None, visibility):
            self._visibility.destroy()
        self._visibility = visibility
        for lights, casts in zip(_list_lights(renderer.scene), self._original.shadows, strict=True):
            lights["casts_shadow"] = {"scene": casts, "all": True, "off": False}[display.shadows]
        renderer.layers[:] = [*layers, *self._always]
        self.display, self._applied = display, made_for
        self.update_timing()

    def update_timing(self) -> None:
        """Take times of the device's work if the overlay or a panel shows them."""
        device = self._renderer.device
        shows_times = self.display.overlay or self._original.is_timed
        device.timing = self._original.timing or (shows_times and device.capabilities.timestamps)

    def list_show_choices(self, camera: Camera) -> list[str]:
        """The names that can be shown: the image, `COMPONENTS` of light, `INSPECTIONS`, and textures of the plan."""
        effects, _ = self._renderer.plan(camera)
        resource = list_resources(self._make_plain(self.display).declare(effects))
        return list(dict.fromkeys([LIT_IMAGE, *COMPONENTS, *INSPECTIONS, *resource]))

    def destroy(self) -> None:
        """Destroy the layers that were created for display settings."""
        for layer in self._layers.values():
            layer.destroy()
        if self._visibility is not None:
            self._visibility.destroy()

    def _get_layer(self, name: str) -> Layer:
        if name not in self._layers:
            device = self._renderer.device
            scale = max(1, self._renderer.size[1] // 720)
            layer = _SCENE_LAYERS[name](device) if name in _SCENE_LAYERS else Overlay(device, scale=scale)
            self._layers[name] = layer
        return self._layers[name]

    def _make_plain(self, display: DisplaySettings) -> Technique:
        """The technique of display settings; buffers are shown with a technique that stays the same."""
        settings = display.settings.technique
        if settings.name == AutoTechnique.name and display.show not in (LIT_IMAGE, *COMPONENTS):
            settings = replace(settings, name=Forward.name)
        return settings.make(self._renderer.scene, self._renderer.device)

    def _make_technique(self, display: DisplaySettings) -> Technique:
        plain = self._make_plain(
            display
        )  # refuses samples that it lacks, also if a shown texture would hide that
        if display.show in INSPECTIONS:
            return Inspection(display.show, display.settings.technique.get_cluster_settings(display.show))
        return plain if display.show in (LIT_IMAGE, *COMPONENTS) else ResourceCapture(plain, display.show)


def _list_lights(scene: Scene) -> tuple[NDArray[Any], ...]:
    return tuple(scene.lights.of_kind(kind) for kind in LIGHT_KINDS)
