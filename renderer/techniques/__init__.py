"""Techniques: ways to draw a frame. Each is one object, and can be exchanged at run time."""

from collections.abc import Callable
from functools import partial
from typing import Final

from renderer import rules
from renderer.scene import Scene
from renderer.techniques.auto import CANDIDATES, AutoTechnique
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
from rhi import Device, refuse

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


def make_technique(
    name: str, scene: Scene, device: Device, *, samples: int = 1, is_smooth: bool = False
) -> Technique:
    """Create the technique of this name, or `auto`, for a scene and a device.

    Args:
        samples: per pixel; with more than one, `auto` is `forward`, and others refuse them.
        is_smooth: whether the edges of the image are smoothed by FXAA.
    """

    def make(name: str) -> Technique:
        technique = Forward(samples) if samples > 1 else TECHNIQUES[name]()
        return Smoothed(technique) if is_smooth else technique

    if name != AutoTechnique.name and name not in TECHNIQUES:
        known = [AutoTechnique.name, *TECHNIQUES]
        rules.refuse_name(rules.UNKNOWN_TECHNIQUE, f"make_technique({name!r})", name, known)
    if samples > 1 and name not in (AutoTechnique.name, Forward.name):
        refuse(rules.ONE_SAMPLE, "make_technique", f"{name} with {samples} samples")
    if name != AutoTechnique.name or samples > 1:
        return make(name)
    return AutoTechnique(scene, device, {one: partial(make, one) for one in CANDIDATES})


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
    "make_technique",
]
