"""A frame: the scene on a device, what is drawn to, and what a technique is given."""

from renderer.frame.frame import Frame, Targets
from renderer.frame.passes import Drawn, TechniquePass
from renderer.frame.resources import MirroredArray, SceneResources

__all__ = ["Drawn", "Frame", "MirroredArray", "SceneResources", "Targets", "TechniquePass"]
