"""Techniques: ways to draw a frame. Each is one object, and can be exchanged at run time."""

from renderer.techniques.auto import AutoTechnique
from renderer.techniques.deferred import Deferred
from renderer.techniques.deferred_cells import ClusteredDeferred, TiledDeferred
from renderer.techniques.deferred_plus import DeferredPlus
from renderer.techniques.forward import Forward
from renderer.techniques.forward_multipass import ForwardMultipass
from renderer.techniques.forward_plus import Clustered, ForwardPlus
from renderer.techniques.inferred import Inferred
from renderer.techniques.light_indexed import LightIndexed
from renderer.techniques.light_pre_pass import LightPrePass
from renderer.techniques.parts.fxaa import Smoothed
from renderer.techniques.settings import TechniqueSettings
from renderer.techniques.table import TECHNIQUES
from renderer.techniques.technique import Technique
from renderer.techniques.watched import Watched

__all__ = [
    "TECHNIQUES",
    "AutoTechnique",
    "Clustered",
    "ClusteredDeferred",
    "Deferred",
    "DeferredPlus",
    "Forward",
    "ForwardMultipass",
    "ForwardPlus",
    "Inferred",
    "LightIndexed",
    "LightPrePass",
    "Smoothed",
    "Technique",
    "TechniqueSettings",
    "TiledDeferred",
    "Watched",
]
