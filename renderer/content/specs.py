"""Scene text: the grammar of generators, `name:key=value,key=value`.

A generator lists its options with defaults and ranges. The text is parsed by that list, so that error
messages, the output of `scenes` and the arguments of a generator come from one table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from renderer import rules
from renderer.scene.ambient_occlusion import AmbientOcclusion
from renderer.scene.depth_of_field import DepthOfField
from renderer.scene.fog_and_bloom import Bloom, Fog
from renderer.scene.scene import Scene
from renderer.scene.scene_builder import SceneBuilder
from rhi.errors import refuse

OptionValue = int | float | str


@dataclass(frozen=True, slots=True)
class Option:
    """An option of a generator. Its type is that of `default`; numbers must be from `low` to `high`."""

    name: str
    default: OptionValue
    meaning: str
    low: float = 0.0
    high: float = 0.0

    @property
    def allowed(self) -> str:
        """The allowed values, as text."""
        if isinstance(self.default, str):
            return self.meaning
        kind = "a whole number" if isinstance(self.default, int) else "a number"
        low, high = (f"{int(end):,}" if end == int(end) else f"{end:g}" for end in (self.low, self.high))
        return f"{kind} from {low} to {high}"

    def parse(self, call: str, text: str) -> OptionValue:
        """Convert `text` to this option's type; refuse values that aren't allowed."""
        if isinstance(self.default, str):
            if not text:
                refuse(rules.BAD_VALUE, call, f"{self.name}=", self.allowed)
            return text
        try:
            value = type(self.default)(text)
        except ValueError:
            refuse(rules.BAD_VALUE, call, f"{self.name}={text}", self.allowed)
        if not self.low <= value <= self.high:
            refuse(rules.BAD_VALUE, call, f"{self.name}={text}", self.allowed)
        return value


@dataclass(frozen=True, slots=True)
class Generator:
    """A function that makes a scene: `build` takes every option by name."""

    name: str
    summary: str
    options: tuple[Option, ...]
    build: Callable[..., Scene]

    def parse(self, text: str) -> dict[str, OptionValue]:
        """Parse `key=value,key=value`; return the values of all options, defaults included."""
        call = f"{self.name}:{text}"
        options = {option.name: option for option in self.options}
        values: dict[str, OptionValue] = {option.name: option.default for option in self.options}
        seen: set[str] = set()
        for part in text.split(",") if text else []:
            key, equals, value = (piece.strip() for piece in part.partition("="))
            if not equals:
                refuse(rules.SPEC_SYNTAX, call, part or "an empty option", f"{self.name}:key=value,key=value")
            if key not in options:
                rules.refuse_name(rules.UNKNOWN_KEY, call, key, options)
            if key in seen:
                refuse(rules.SPEC_SYNTAX, call, f"{key} twice", "each key once")
            seen.add(key)
            values[key] = options[key].parse(call, value)
        return values


SEED: Final = Option("seed", 0, "another seed gives another scene of the same kind", 0, 2**31 - 1)

SHADOWS: Final = Option("shadows", 0, "1: all lights cast shadows", 0, 1)


def cast_shadows(builder: SceneBuilder) -> None:
    """Make all lights of a scene cast shadows, and add that to its name."""
    builder.lights.cast_shadows()
    builder.name += ",shadows=1"


FOG: Final = Option("fog", 0.0, "density of the fog per metre, at the ground", 0.0, 10.0)
BLOOM: Final = Option("bloom", 0.0, "share of all light that is scattered in the eye", 0.0, 1.0)

OCCLUSION: Final = Option(
    "occlusion", 0.0, "metres within which surfaces take ambient light from each other", 0.0, 100.0
)

FOCUS: Final = Option("focus", 0.0, "metres away that are sharp, all if 0", 0.0, 1e6)
APERTURE: Final = Option("aperture", 0.05, "radius of the aperture in metres, with a focus", 1e-6, 100.0)

ENVIRONMENT: Final = Option("environment", 0.0, "strength of the light of a sky all around", 0.0, 100.0)

SUN_DEGREES: Final = Option("sun_degrees", 0.0, "angle that the sun or the moon fills, in degrees", 0.0, 90.0)


def widen_sun(builder: SceneBuilder, degrees: float) -> None:
    """Give a scene's directional lights sources of this size unless it is 0; its name then says so."""
    if degrees:
        builder.lights.directional["angular_diameter"] = np.radians(degrees)
        builder.name += f",sun_degrees={degrees:g}"


def add_occlusion(builder: SceneBuilder, radius: float) -> None:
    """Add ambient occlusion of this radius to a scene unless it is 0; its name then says so."""
    if radius:
        builder.ambient_occlusion = AmbientOcclusion(radius)
        builder.name += f",occlusion={radius:g}"


def add_depth_of_field(builder: SceneBuilder, focus: float, aperture: float) -> None:
    """Add a focus at this distance and an aperture of this radius to a scene unless the distance is 0; its name then
    says so."""
    if focus:
        builder.depth_of_field = DepthOfField(focus, aperture)
        builder.name += f",focus={focus:g},aperture={aperture:g}"


def add_fog_and_bloom(
    builder: SceneBuilder, fog: float, bloom: float, color: tuple[float, float, float], falloff: float
) -> None:
    """Add fog and bloom to a scene unless they are 0; its name then says so. The fog is of this colour, and
    thins with the height."""
    if fog:
        builder.fog = Fog(fog, color, falloff)
        builder.name += f",fog={fog:g}"
    if bloom:
        builder.bloom = Bloom(bloom)
        builder.name += f",bloom={bloom:g}"
