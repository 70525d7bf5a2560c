"""What the air does to light, in every technique: haze and fog, for surfaces and for the background.

All shaders that make pixels end in `FinishShader.finish`, those of transparent surfaces before they are multiplied by
their opacity. Light goes through the fog there, so opaque surfaces need no pass, and a transparent one has the fog in
front of it while what is behind it has its own: `a · (T c + (1 - T) F) + (1 - a) · behind` is what fog in front of both
makes of `a · c + (1 - a) · b`. What no surface covers is fogged by the pass `sky`, to infinity.

Haze fades to the colour of the background, after tones have been mapped. Where there is glow, tones are mapped last,
and haze fades to the light that is seen as that colour.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from renderer.frame import Effect, Frame, Needs, Pass
from renderer.frame.mirrors import MirroredValue
from renderer.frame.tones import Color, find_light
from renderer.scene import Camera, Scene
from renderer.shaders.fog import FogConstants, through_all_fog
from renderer.shaders.pixels import FullScreen, place_pixel
from renderer.shaders.structs import Haze
from renderer.techniques.full_screen import draw_full_screen
from renderer.techniques.scene_shader import SHADING_PARTS, FinishShader
from rhi import DepthFunction, Device, UniformBuffer
from rhi.shading import Shader, Struct, Uniform, fragment_coordinate, vec3, vec4

__rhi_internal__ = True


class Background(Struct):
    """The light of what is behind everything."""

    light: vec3


class SkyShader(FullScreen, FinishShader):
    """Draws the background as it is seen through all of the fog."""

    background: Uniform[Background]
    air: Uniform[FogConstants]

    def fragment(self) -> vec4:
        place = fragment_coordinate().xy
        direction = place_pixel(self.rays, place, 1.0) - place_pixel(self.rays, place, 0.0)
        return self.finish(through_all_fog(self.background.light, direction, self.air), direction)


class ViewFog:
    """The fog as a view sees it, on the device."""

    def __init__(self, device: Device) -> None:
        self._fog = MirroredValue(device, FogConstants(color=(0, 0, 0), density=0.0, falloff=0.0, height=0.0))

    def aim(self, camera: Camera, scene: Scene) -> UniformBuffer[FogConstants]:
        """Return the scene's fog as the camera sees it; it is uploaded if it has changed."""
        fog = scene.fog
        assert fog is not None, "fog is bound where the scene has some"
        height = fog.falloff * (float(camera.position[1]) - fog.base)
        self._fog.write(
            FogConstants(color=find_light(fog.color), density=fog.density, falloff=fog.falloff, height=height)
        )
        return self._fog.buffer

    def destroy(self) -> None:
        """Destroy the buffer."""
        self._fog.destroy()


class BrightAir:
    """What the air and the sky need of the background, as light."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._haze: MirroredValue[Haze] | None = None
        self._background: MirroredValue[Background] | None = None
        self._known: tuple[Color, Color] | None = None

    def _find_light(self, color: Color) -> Color:
        if self._known is None or self._known[0] != color:
            self._known = color, find_light(color)
        return self._known[1]

    def bind_haze(self, scene: Scene) -> UniformBuffer[Haze]:
        """Return the scene's haze, whose colour is light."""
        haze = Haze(color=self._find_light(scene.background), density=scene.haze)
        if self._haze is None:
            self._haze = MirroredValue(self._device, haze)
        self._haze.write(haze)
        return self._haze.buffer

    def bind_background(self, scene: Scene) -> UniformBuffer[Background]:
        """Return the light of the scene's background."""
        background = Background(light=self._find_light(scene.background))
        if self._background is None:
            self._background = MirroredValue(self._device, background)
        self._background.write(background)
        return self._background.buffer

    def destroy(self) -> None:
        """Destroy the buffers."""
        for one in (self._haze, self._background):
            if one is not None:
                one.destroy()


def bind_air(frame: Frame) -> tuple[list[str], dict[str, Any]]:
    """Return the names of the parts that a `FinishShader` needs for the frame's effects, and their bindings."""
    effects, resources = frame.needs.effects, frame.resources
    present: dict[str, Any] = {}
    if Effect.HAZE in effects:
        if Effect.GLOW in effects:
            present["haze"] = resources.workspace(BrightAir).bind_haze(resources.scene)
        else:
            present["haze"] = resources.haze.buffer
    if Effect.FOG in effects:
        present["fog"] = frame.view.workspace(ViewFog).aim(frame.camera, resources.scene)
    return [*present, *(["bright"] if Effect.GLOW in effects else [])], present


@cache
def sky_variant(*, is_bright: bool) -> type[FullScreen]:
    """Return the shader of the background."""
    parts: tuple[type[Shader], ...] = (SHADING_PARTS["bright"],) if is_bright else ()
    return type("Sky", (*parts, SkyShader), {"__module__": __name__})


def sky_passes(needs: Needs, image: str, depth: str) -> tuple[Pass[Frame], ...]:
    """Return the pass that draws the fog before the background over the contents `image`: none without fog."""
    if Effect.FOG not in needs.effects:
        return ()

    def draw(frame: Frame) -> None:
        resources = frame.resources
        draw_full_screen(
            frame,
            sky_variant(is_bright=Effect.GLOW in frame.needs.effects),
            frame.targets[image],
            {
                "background": resources.workspace(BrightAir).bind_background(resources.scene),
                "air": frame.view.workspace(ViewFog).aim(frame.camera, resources.scene),
            },
            depth=frame.targets[depth],
            states=(DepthFunction.EQUAL,),  # to the farthest depth, at which the triangle is
        )

    because = f"shows fog before the background; {needs.explain(Effect.FOG)}"
    return (Pass("sky", draw, because, reads=(depth,), changes={image: f"{image} with sky"}),)
