"""Haze and fog, in every technique: the effect of the air on the light of surfaces and of the background.

All shaders that make pixels end in `FinishShader.finish`, those of transparent surfaces before they are
multiplied by their opacity. Light goes through the fog there, so opaque surfaces need no pass, and a
transparent one has the fog in front of it while what is behind it has its own: `a · (T c + (1 - T) F) + (1 -
a) · behind` is what fog in front of both makes of `a · c + (1 - a) · b`. What no surface covers is fogged by
the pass `sky`, to infinity.

Haze fades to the colour of the background, after tones have been mapped. Where the camera has effects, such as bloom,
tones are mapped last, and haze fades to the light that is seen as that colour.
"""

from __future__ import annotations

from renderer.frame.frame import Frame
from renderer.shaders.fog import FogConstants
from renderer.shaders.structs import Haze
from renderer.shaders.tone_mapping import inverse_tone_map
from rhi import UniformBuffer


def bind_fog(frame: Frame) -> UniformBuffer[FogConstants]:
    """The scene's fog, with heights relative to the eye of the frame's view."""
    fog = frame.resources.scene.fog
    assert fog is not None, "fog can be bound only if the scene has fog"
    height = fog.falloff * (float(frame.camera.position[1]) - fog.base)
    return frame.view.mirror(
        FogConstants(
            color=inverse_tone_map(fog.color), density=fog.density, falloff=fog.falloff, height=height
        )
    )


def bind_haze(frame: Frame) -> UniformBuffer[Haze]:
    """The scene's haze."""
    scene = frame.resources.scene
    color = inverse_tone_map(scene.background) if frame.effects.keeps_light else scene.background
    return frame.resources.mirror(Haze(color=color, density=scene.haze))
