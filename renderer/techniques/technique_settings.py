"""The choice of a technique, with the parameters of all."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, partial
from inspect import signature

from renderer import rules
from renderer.scene import Scene
from renderer.techniques.auto import CANDIDATES, AutoTechnique
from renderer.techniques.deferred_plus import DeferredPlus, check_passes
from renderer.techniques.forward import Forward
from renderer.techniques.inferred import check_scale
from renderer.techniques.light_pre_pass import check_channels
from renderer.techniques.parts.fxaa import FxaaTechnique
from renderer.techniques.parts.geometry_buffer import DEFAULT_NORMAL_BITS, NORMAL_BITS
from renderer.techniques.parts.light_list_reader import CLUSTERS, TILES, ClusterSettings
from renderer.techniques.parts.resolve import DEFAULT_LIGHT_BITS, SUM_FORMATS, check_bits
from renderer.techniques.table import TECHNIQUES
from renderer.techniques.technique import Technique
from rhi import Device, refuse


@dataclass(frozen=True, slots=True)
class TechniqueSettings:
    """The technique that draws, and the parameters of the techniques; each uses those that it has.

    Attributes:
        name: of `TECHNIQUES`, or `auto`.
        samples: samples per pixel, of `forward`, `light_indexed`, `forward_plus`, `clustered`, `tiled_deferred`,
            `clustered_deferred` and `deferred_plus`; more than one is refused for others. `auto` is then
            `forward`.
        fxaa: whether the edges of the image are smoothed.
        tiles: the tiles of `forward_plus`, and of `deferred_plus` if it is `tiled`.
        tiled_transparency: whether `forward_plus` lights transparent surfaces by lists of tiles of their own
            instead of those of their objects.
        clusters: those of `clustered`.
        scale: the size of the light buffers of `inferred`, in that of the image.
        stippled: whether it draws transparent surfaces to them, too.
        specular_channels: 1 or 3, of `light_pre_pass`.
        light_bits: 16 or 32, the bits of a channel of light that `forward_multipass`, `deferred`,
            `light_pre_pass` and `inferred` add up; 16 on devices that can't blend 32.
        normal_bits: 8 or 16, the bits of each of the two numbers that `deferred`, `tiled_deferred` and
            `clustered_deferred` store of a normal.
        lights_per_draw: the lights that each draw of an object adds in `forward_multipass`.
        light_volumes: whether it draws the volumes of lights instead, over the lit image.
        all_lights: whether `forward` looks at all lights of the scene for each fragment, instead of its
            object's list.
        stencil: whether `deferred` and `light_pre_pass` mask each light in a stencil buffer.
        depth_first: whether `clustered` draws depth before.
        multi_pass: whether `deferred_plus` shades each material by draws of its own.
        object_rectangles: whether it does so in a rectangle for each material, around the boxes of its objects.
        binned: whether it lists pixels by material, and shades the lists. Images are the same.
        tiled: whether it lights pixels by the lists of tiles instead of those of clusters.
    """

    name: str = AutoTechnique.name
    samples: int = 1
    fxaa: bool = False
    tiles: ClusterSettings = TILES
    tiled_transparency: bool = False
    clusters: ClusterSettings = CLUSTERS
    scale: float = 0.6
    stippled: bool = True
    specular_channels: int = 3
    light_bits: int = DEFAULT_LIGHT_BITS
    normal_bits: int = DEFAULT_NORMAL_BITS
    lights_per_draw: int = 1
    light_volumes: bool = False
    all_lights: bool = False
    stencil: bool = False
    depth_first: bool = False
    multi_pass: bool = False
    object_rectangles: bool = False
    binned: bool = False
    tiled: bool = False

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_TECHNIQUE)
        if self.name not in (AutoTechnique.name, *TECHNIQUES):
            rules.refuse_name(
                rules.BAD_TECHNIQUE,
                "TechniqueSettings(name=...)",
                self.name,
                [AutoTechnique.name, *TECHNIQUES],
            )
        if self.samples < 1:
            refuse(
                rules.BAD_TECHNIQUE,
                "TechniqueSettings(samples=...)",
                self.samples,
                "a whole number of 1 or more",
            )
        if (
            self.samples > 1
            and self.name != AutoTechnique.name
            and "samples" not in _list_parameters(self.name)
        ):
            refuse(rules.ONE_SAMPLE, "TechniqueSettings", f"{self.name} with samples={self.samples}")
        rules.check_count(rules.BAD_TECHNIQUE, "TechniqueSettings(lights_per_draw=...)", self.lights_per_draw)
        check_scale(self.scale, "TechniqueSettings")
        check_channels(self.specular_channels, "TechniqueSettings")
        check_bits(self.light_bits, SUM_FORMATS, "TechniqueSettings(light_bits=...)")
        check_bits(self.normal_bits, NORMAL_BITS, "TechniqueSettings(normal_bits=...)")
        samples = self.samples if self.name == DeferredPlus.name else 1
        check_passes(self.multi_pass or self.object_rectangles, self.binned, samples, "TechniqueSettings")

    def get_cluster_settings(self, name: str) -> ClusterSettings | None:
        """The cluster settings of the setting of this name; None for all but `tiles` and `clusters`."""
        return {"tiles": self.tiles, "clusters": self.clusters}.get(name)

    def make(self, scene: Scene, device: Device) -> Technique:
        """The technique for a scene and a device. Light is accumulated in 16 bits if the device can't
        blend 32."""
        if self.light_bits > 16 and SUM_FORMATS[self.light_bits] in device.capabilities.unblendable_formats:
            return replace(self, light_bits=16).make(scene, device)
        if self.samples == 1 and self.name == AutoTechnique.name:
            return AutoTechnique(
                scene, device, {name: partial(self.make_technique, name) for name in CANDIDATES}
            )
        return self.make_technique(Forward.name if self.name == AutoTechnique.name else self.name)

    def make_technique(self, name: str) -> Technique:
        """The technique of this name in `TECHNIQUES`, with the settings that it has as parameters."""
        technique = TECHNIQUES[name](
            **{parameter: getattr(self, parameter) for parameter in _list_parameters(name)}
        )
        return FxaaTechnique(technique) if self.fxaa else technique


def to_technique(call: str, value: Technique | str | None, scene: Scene, device: Device) -> Technique:
    """Return a technique, or that of a name for a scene and a device; None is forward shading. Refuses
    anything else."""
    if value is None:
        return Forward()
    if isinstance(value, str):
        names = [AutoTechnique.name, *TECHNIQUES]
        if value not in names:
            rules.refuse_name(rules.BAD_TECHNIQUE, call, value, names)
        return TechniqueSettings(value).make(scene, device)
    if isinstance(value, type) or not callable(getattr(value, "declare", None)):
        rules.refuse_object(call, value, "a technique, such as Forward(), or the name of one")
    return value


@cache
def _list_parameters(name: str) -> tuple[str, ...]:
    """Names of a technique's parameters, which are settings of the same names."""
    return tuple(signature(TECHNIQUES[name]).parameters)
