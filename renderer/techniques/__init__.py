"""Techniques: ways to draw a frame. Each is one object, and can be exchanged at run time."""

from collections.abc import Callable
from typing import Final

from renderer.techniques.auto import AutoTechnique
from renderer.techniques.deferred import Deferred
from renderer.techniques.deferred_cells import ClusteredDeferred, TiledDeferred
from renderer.techniques.deferred_plus import DeferredPlus
from renderer.techniques.forward import Forward
from renderer.techniques.forward_multipass import ForwardMultipass
from renderer.techniques.forward_plus import Clustered, ForwardPlus
from renderer.techniques.fxaa import Smoothed
from renderer.techniques.inferred import Inferred
from renderer.techniques.light_indexed import LightIndexed
from renderer.techniques.light_pre_pass import LightPrePass
from renderer.techniques.particles import Particles
from renderer.techniques.technique import Technique
from renderer.techniques.watched import Watched

TECHNIQUES: Final[dict[str, Callable[[], Technique]]] = {
    one.name: one
    for one in (
        Forward,
        ForwardMultipass,
        Deferred,
        LightPrePass,
        Inferred,
        LightIndexed,
        ForwardPlus,
        Clustered,
        TiledDeferred,
        ClusteredDeferred,
        DeferredPlus,
    )
}
"""Constructors of all techniques, by name."""

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
    "Particles",
    "Smoothed",
    "Technique",
    "TiledDeferred",
    "Watched",
]
