"""A frame: the scene on a device, the targets, and the pass in which a technique draws the scene."""

from renderer.frame.frame import Frame, Targets
from renderer.frame.layer import Layer
from renderer.frame.passes import Drawn, TechniquePass
from renderer.frame.resources import MirroredArray, SceneResources

__all__ = ["Drawn", "Frame", "Layer", "MirroredArray", "SceneResources", "Targets", "TechniquePass"]
