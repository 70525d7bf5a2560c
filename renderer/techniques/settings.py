"""The choice of a technique, with the parameters of all."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

from renderer import rules
from renderer.scene import Scene
from renderer.techniques.auto import CANDIDATES, AutoTechnique
from renderer.techniques.deferred import Deferred
from renderer.techniques.deferred_plus import DeferredPlus
from renderer.techniques.forward import Forward
from renderer.techniques.forward_plus import Clustered, ForwardPlus
from renderer.techniques.inferred import Inferred, check_scale
from renderer.techniques.light_pre_pass import LightPrePass, check_channels
from renderer.techniques.parts.cell_lists import CLUSTERS, TILES, LightCells
from renderer.techniques.parts.fxaa import Smoothed
from renderer.techniques.table import TECHNIQUES
from renderer.techniques.technique import Technique
from rhi import Device, refuse


@dataclass(frozen=True, slots=True)
class TechniqueSettings:
    """The technique that draws, and the parameters of the techniques; each uses those that it has.

    Attributes:
        name: of `TECHNIQUES`, or `auto`.
        samples: samples per pixel. With more than one, only `forward` draws, and `auto` is `forward`.
        fxaa: whether the edges of the image are smoothed.
        tiles: the tiles of `forward_plus`. clusters: those of `clustered`.
        scale: the size of the light buffers of `inferred`, in that of the image. stippled: whether it draws transparent
            surfaces to them, too.
        specular_channels: 1 or 3, of `light_pre_pass`.
        stencil: whether `deferred` and `light_pre_pass` mask each light in a stencil buffer. depth_first: whether
            `clustered` draws depth before. multi_pass: whether `deferred_plus` shades each material by draws of its
            own. Pictures are the same.
    """

    name: str = AutoTechnique.name
    samples: int = 1
    fxaa: bool = False
    tiles: LightCells = TILES
    clusters: LightCells = CLUSTERS
    scale: float = 0.6
    stippled: bool = True
    specular_channels: int = 3
    stencil: bool = False
    depth_first: bool = False
    multi_pass: bool = False

    def __post_init__(self) -> None:
        if self.name not in (AutoTechnique.name, *TECHNIQUES):
            rules.refuse_name(
                rules.BAD_TECHNIQUE, "TechniqueSettings(name=...)", self.name, [AutoTechnique.name, *TECHNIQUES]
            )
        if type(self.samples) is not int or self.samples < 1:
            refuse(rules.BAD_TECHNIQUE, "TechniqueSettings(samples=...)", self.samples, "a whole number of 1 or more")
        if self.samples > 1 and self.name not in (AutoTechnique.name, Forward.name):
            refuse(rules.ONE_SAMPLE, "TechniqueSettings", f"{self.name} with samples={self.samples}")
        check_scale(self.scale, "TechniqueSettings")
        check_channels(self.specular_channels, "TechniqueSettings")

    def make(self, scene: Scene, device: Device) -> Technique:
        """Return the technique for a scene and a device."""
        if self.samples == 1 and self.name == AutoTechnique.name:
            return AutoTechnique(scene, device, {name: partial(self.make_one, name) for name in CANDIDATES})
        return self.make_one(Forward.name if self.samples > 1 else self.name)

    def make_one(self, name: str) -> Technique:
        """Return a technique of `TECHNIQUES` with those of the parameters that it has."""
        make = _MAKERS.get(name)
        technique = TECHNIQUES[name]() if make is None else make(self)
        return Smoothed(technique) if self.fxaa else technique


_MAKERS: Final[Mapping[str, Callable[[TechniqueSettings], Technique]]] = {
    Forward.name: lambda given: Forward(given.samples),
    ForwardPlus.name: lambda given: ForwardPlus(cells=given.tiles),
    Clustered.name: lambda given: Clustered(depth_first=given.depth_first, cells=given.clusters),
    Deferred.name: lambda given: Deferred(stencil=given.stencil),
    DeferredPlus.name: lambda given: DeferredPlus(multi_pass=given.multi_pass),
    Inferred.name: lambda given: Inferred(scale=given.scale, stippled=given.stippled),
    LightPrePass.name: lambda given: LightPrePass(specular_channels=given.specular_channels, stencil=given.stencil),
}
"""What makes the techniques that have parameters."""
