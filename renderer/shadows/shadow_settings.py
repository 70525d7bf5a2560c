"""Settings of shadow maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from renderer import rules
from rhi import refuse
from rhi.errors.choices import Choice

MAX_SAMPLES: Final = 1024
"""The largest number of texels that `PCSS` searches, or compares."""
MAX_CONTACT_RAYS: Final = 64
MAX_CONTACT_STEPS: Final = 256
"""The largest number of samples of depth of a contact shadow's ray."""


class ShadowFilter(Choice):
    """The filter of shadow maps: the texels that a point is compared with, and their weights."""

    HARD = "hard"
    """The texel that holds the point: edges are texels."""
    HARDWARE = "hardware"
    """2 × 2 texels by a sampler that compares, weighted by the point's position between them."""
    SMOOTH = "smooth"
    """3 × 3 texels around the point, weighted by the area that they share with a square of that size."""
    POISSON = "poisson"
    """12 texels of a Poisson disc, turned by another angle at each position: edges are noise instead of
    texels."""
    PCSS = "pcss"
    """As many texels as the penumbra is wide, at least those of `SMOOTH`: percentage-closer soft shadows, for
    lights whose sources have a size (`angular_diameter`, `source_radius`)."""


@dataclass(frozen=True, slots=True)
class ShadowSettings:
    """Settings of shadow maps: their sizes, their filter and their bias.

    Attributes:
        filter: how edges are smoothed.
        cascades: the number of maps of a directional light, one behind the other along the view.
        cascade_size: the width and height of each of them in texels.
        distance: how far from the eye, in metres, directional lights cast shadows.
        split: where cascades end: 0 divides the distance evenly, 1 by equal ratios, the practical split is
            between.
        min_size, max_size: bounds of the width of a local light's map in texels, powers of two.
        max_atlas_size: the greatest width of the texture that holds all maps, a power of two.
        budget: how many maps of far local lights, those of at most `far_size` texels, are drawn again in a
            frame.
        far_size: the greatest width in texels of the maps of far lights, which `budget` limits.
        bias: 1 moves compared points by what texel size and angle call for; 0 shows what that is for.
        blocker_samples: texels of `PCSS` that are searched for what is between a point and the source.
        penumbra_samples: texels of `PCSS` that a point in a penumbra is compared with.
        back_faces: whether the casters' back faces are drawn instead of their front faces.
        contact_length: how far in metres rays are followed in the depth buffer towards the first directional light
            that casts shadows; 0 follows none.
        contact_steps: samples of depth of each of these rays.
        contact_rays: how many of them go to a light with an `angular_diameter`, all over its disc; 1 goes to others.
        contact_thickness: how deep in metres, along the view, what a ray passes behind is taken to be.
    """

    filter: ShadowFilter = ShadowFilter.SMOOTH
    cascades: int = 4
    cascade_size: int = 1024
    distance: float = 250.0
    split: float = 0.7
    min_size: int = 16
    max_size: int = 512
    max_atlas_size: int = 4096
    budget: int = 8
    far_size: int = 64
    bias: float = 1.0
    back_faces: bool = False
    blocker_samples: int = 16
    penumbra_samples: int = 32
    contact_length: float = 0.0
    contact_steps: int = 16
    contact_rays: int = 8
    contact_thickness: float = 0.1

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_SHADOWS)
        for name, fine, allowed in (
            ("cascades", 1 <= self.cascades <= 8, "1 to 8"),
            ("cascade_size", _is_power(self.cascade_size), "a power of two"),
            (
                "max_atlas_size",
                self.cascades * self.cascade_size**2 <= self.max_atlas_size**2,
                f"room for {self.cascades} maps of {self.cascade_size} texels",
            ),
            ("distance", 0.0 < self.distance < float("inf"), "above 0, finite"),
            ("split", 0.0 <= self.split <= 1.0, "0 to 1"),
            ("min_size", _is_power(self.min_size), "a power of two"),
            (
                "max_size",
                _is_power(self.max_size) and self.max_size >= self.min_size,
                "a power of two, at least min_size",
            ),
            (
                "max_atlas_size",
                _is_power(self.max_atlas_size)
                and self.max_atlas_size >= max(self.max_size, self.cascade_size),
                "a power of two, at least as large as each map",
            ),
            ("budget", self.budget >= 1, "1 or more"),
            ("far_size", self.far_size >= 0, "0 or more"),
            ("blocker_samples", 1 <= self.blocker_samples <= MAX_SAMPLES, f"1 to {MAX_SAMPLES}"),
            ("penumbra_samples", 1 <= self.penumbra_samples <= MAX_SAMPLES, f"1 to {MAX_SAMPLES}"),
            ("bias", 0.0 <= self.bias < float("inf"), "0 or more, finite"),
            ("contact_length", 0.0 <= self.contact_length < float("inf"), "0 or more, finite"),
            ("contact_steps", 1 <= self.contact_steps <= MAX_CONTACT_STEPS, f"1 to {MAX_CONTACT_STEPS}"),
            ("contact_rays", 1 <= self.contact_rays <= MAX_CONTACT_RAYS, f"1 to {MAX_CONTACT_RAYS}"),
            ("contact_thickness", 0.0 < self.contact_thickness < float("inf"), "above 0, finite"),
        ):
            if not fine:
                refuse(rules.BAD_SHADOWS, f"ShadowSettings({name}=...)", getattr(self, name), allowed)


def _is_power(number: int) -> bool:
    return number >= 1 and number & (number - 1) == 0
