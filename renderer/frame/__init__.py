"""A frame: the scene on a device, its views, the plan of its passes, and the textures that they draw to."""

from renderer.frame.frame import Frame
from renderer.frame.images import AS_GIVEN, TextureSettings
from renderer.frame.layer import Layer
from renderer.frame.mirrors import MirroredArray
from renderer.frame.needs import (
    EXACT_GLOW,
    LAMPS,
    SHADOW_EFFECTS,
    Blending,
    Effect,
    GlowSettings,
    Needs,
    find_needs,
)
from renderer.frame.passes import Drawn, TechniquePass
from renderer.frame.plan import OUTPUTS, DroppedPass, Pass, Plan, SharedTexture, Target, find_last, make_plan
from renderer.frame.resources import SceneResources
from renderer.frame.targets import DEPTH_FORMAT, IMAGE_FORMAT, Targets
from renderer.frame.view import View

__all__ = [
    "AS_GIVEN",
    "DEPTH_FORMAT",
    "EXACT_GLOW",
    "IMAGE_FORMAT",
    "LAMPS",
    "OUTPUTS",
    "SHADOW_EFFECTS",
    "Blending",
    "Drawn",
    "DroppedPass",
    "Effect",
    "Frame",
    "GlowSettings",
    "Layer",
    "MirroredArray",
    "Needs",
    "Pass",
    "Plan",
    "SceneResources",
    "SharedTexture",
    "Target",
    "Targets",
    "TechniquePass",
    "TextureSettings",
    "View",
    "find_last",
    "find_needs",
    "make_plan",
]
