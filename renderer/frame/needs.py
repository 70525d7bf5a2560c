"""The needs of a frame: the effects that its scene has and its view shows.

A technique declares only the passes and shaders of these effects, so what a scene lacks costs nothing. Each effect
comes with the reason why it is needed or not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from operator import attrgetter
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.frame.plan import Target
from renderer.frame.seen import SeenFeatures
from renderer.frame.targets import IMAGE_FORMAT
from renderer.lights.in_view import find_lights_in_view
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats, Rows
from renderer.scene.lights import Lights
from renderer.visibility.boxes.volumes import find_in_view
from rhi import Format, refuse


class Effect(Enum):
    """An effect that a scene may call for."""

    DIRECTIONAL_LIGHTS = "directional lights"
    POINT_LIGHTS = "point lights"
    SPOT_LIGHTS = "spot lights"
    POINT_SPHERES = "point lights with a radius"
    SPOT_SPHERES = "spot lights with a radius"
    IMAGES = "images"
    EMISSION = "emission"
    HAZE = "haze"
    FOG = "fog"
    GLOW = "glow"
    METALS = "metals"
    EMISSIVE_COLORS = "emissive colors"
    NORMAL_MAPS = "normal maps"
    ROUGHNESS_MAPS = "roughness maps"
    OCCLUSION_MAPS = "occlusion maps"
    EMISSIVE_MAPS = "emissive maps"
    MASKS = "masks"
    TWO_SIDES = "two sides"
    VERTEX_COLORS = "vertex colors"
    SECOND_UVS = "second uvs"
    TEXTURE_TRANSFORMS = "texture transforms"
    MIXED_COORDINATES = "mixed coordinates"
    MATERIAL_SHADERS = "material shaders"
    SUN_SHADOWS = "shadows of directional lights"
    POINT_SHADOWS = "shadows of point lights"
    SPOT_SHADOWS = "shadows of spot lights"
    TRANSPARENCY = "transparency"
    HEIGHT_FIELDS = "height fields"

    __hash__ = object.__hash__


_EFFECTS: Final = {effect.value: effect for effect in Effect}
"""Effects by their values, for each frame: asking the class takes longer."""
SHADOW_EFFECTS: Final = (Effect.SUN_SHADOWS, Effect.POINT_SHADOWS, Effect.SPOT_SHADOWS)
"""The shadows of each kind of light."""


class LampKind(NamedTuple):
    """A kind of lights that have a range: their rows in a scene's lights, their shadows, and those that are spheres."""

    find_rows: Callable[[Lights], NDArray[Any]]
    shadows: Effect
    spheres: Effect


LAMPS: Final = {
    Effect.POINT_LIGHTS: LampKind(attrgetter("point"), Effect.POINT_SHADOWS, Effect.POINT_SPHERES),
    Effect.SPOT_LIGHTS: LampKind(attrgetter("spot"), Effect.SPOT_SHADOWS, Effect.SPOT_SPHERES),
}
"""The lights that have a range, point lights first."""


class Blending(Enum):
    """The way in which transparent surfaces that cover each other are put together."""

    SORTED = "sorted"
    """Objects are drawn back to front, each over what is behind it."""
    WEIGHTED = "weighted"
    """Surfaces are averaged, near ones with more weight, in any order (McGuire and Bavoil 2013)."""


LIGHT_FORMATS: Final = {11: Format.R11G11B10F, 16: Format.RGBA16F, 32: Format.RGBA32F}
"""Formats of linear light by the bits of a channel."""


@dataclass(frozen=True, slots=True)
class GlowSettings:
    """Settings of the accuracy of glow.

    Attributes:
        levels: how often the light is halved in size; each level spreads it twice as far.
        tames_sparks: whether single bright pixels count less (Karis 2013), which may flicker as things move. Otherwise
            all light counts the same, and glow has exactly as much as is scattered.
        bits: those of a channel of the image and of its levels while they hold light: 11 (10 of blue), 16 or 32.
    """

    levels: int = 6
    tames_sparks: bool = False
    bits: int = 16

    def __post_init__(self) -> None:
        rules.check_kinds(self, rules.BAD_GLOW)
        if not 1 <= self.levels <= _MOST_LEVELS:
            refuse(rules.BAD_GLOW, "GlowSettings(levels=...)", self.levels, f"a whole number from 1 to {_MOST_LEVELS}")
        if self.bits not in LIGHT_FORMATS:
            refuse(rules.BAD_GLOW, "GlowSettings(bits=...)", self.bits, f"one of {', '.join(map(str, LIGHT_FORMATS))}")


_MOST_LEVELS: Final = 12
_NONE: Final[Rows] = np.zeros(0, np.int64)
EXACT_GLOW: Final = GlowSettings()
"""Glow that has all of the light that is scattered."""

_PLAIN_IMAGE: Final = Target("image", IMAGE_FORMAT)
_BRIGHT_IMAGES: Final = {bits: Target("bright image", format) for bits, format in LIGHT_FORMATS.items()}

_NOUNS: Final = {
    Effect.DIRECTIONAL_LIGHTS: ("directional light", "directional lights"),
    Effect.POINT_LIGHTS: ("point light", "point lights"),
    Effect.SPOT_LIGHTS: ("spot light", "spot lights"),
    Effect.POINT_SPHERES: ("point light with a radius", "point lights with a radius"),
    Effect.SPOT_SPHERES: ("spot light with a radius", "spot lights with a radius"),
    Effect.IMAGES: ("image", "images"),
    Effect.EMISSION: ("material that emits light", "materials that emit light"),
    Effect.METALS: ("metallic-roughness material", "metallic-roughness materials"),
    Effect.EMISSIVE_COLORS: ("material with an emissive color", "materials with an emissive color"),
    Effect.NORMAL_MAPS: ("material with a normal map", "materials with a normal map"),
    Effect.ROUGHNESS_MAPS: ("material with a metallic-roughness map", "materials with a metallic-roughness map"),
    Effect.OCCLUSION_MAPS: ("material with an occlusion map", "materials with an occlusion map"),
    Effect.EMISSIVE_MAPS: ("material with an emissive map", "materials with an emissive map"),
    Effect.MASKS: ("material with a mask", "materials with a mask"),
    Effect.TWO_SIDES: ("material with two sides", "materials with two sides"),
    Effect.VERTEX_COLORS: ("mesh with colors", "meshes with colors"),
    Effect.SECOND_UVS: ("texture with a second uv", "textures with a second uv"),
    Effect.TEXTURE_TRANSFORMS: ("texture that is transformed or clamped", "textures that are transformed or clamped"),
    Effect.MIXED_COORDINATES: (
        "material with unlike texture coordinates",
        "materials with unlike texture coordinates",
    ),
    Effect.MATERIAL_SHADERS: ("material with a shader of its own", "materials with shaders of their own"),
    Effect.TRANSPARENCY: ("transparent object", "transparent objects"),
    Effect.HEIGHT_FIELDS: ("height field", "height fields"),
    Effect.SUN_SHADOWS: ("directional light that casts shadows", "directional lights that cast shadows"),
    Effect.POINT_SHADOWS: ("point light that casts shadows", "point lights that cast shadows"),
    Effect.SPOT_SHADOWS: ("spot light that casts shadows", "spot lights that cast shadows"),
}


@dataclass(frozen=True, eq=False, slots=True)
class SceneCauses:
    """What may cause effects in a scene, seen from anywhere; it is kept while the scene is in the same `state`.

    Attributes:
        counts: of each effect, how many causes there are. features: the names of those that materials and meshes have.
        lamps: the positions (k, 3) and ranges (k,) of the point and of the spot lights.
        fields: the rows of the height fields. shaders: those that materials have of their own.
    """

    state: tuple[object, ...]
    counts: dict[Effect, int]
    features: tuple[str, ...]
    lamps: tuple[tuple[Floats, Floats], ...]
    fields: Rows
    shaders: tuple[type[Any], ...]


@dataclass(frozen=True, eq=False, slots=True)
class Needs:
    """The effects that one frame needs, with their reasons.

    Attributes:
        effects: those that are needed. counts: of each effect, how many of its causes the scene has.
        material_count: the number of materials.
        in_view: the rows of the point and of the spot lights whose light may reach something in view; as their shadows,
            the rows of those of them that cast some, none if no object does; as spheres, those that have a radius; and
            of the transparent objects and of the height fields in view, or that cast shadows.
        blending: how transparent objects are put together. glow: how glow is made.
        has_glow: whether the scene has glow, whatever shines in it.
        shaders: those that the scene's materials have of their own.
        causes: what of this doesn't depend on the view. seen: the features of surfaces that shaders have.
    """

    effects: frozenset[Effect]
    counts: dict[Effect, int]
    material_count: int
    in_view: Mapping[Effect, Rows]
    blending: Blending
    glow: GlowSettings
    has_glow: bool
    shaders: tuple[type[Any], ...]
    causes: SceneCauses
    seen: frozenset[str]

    @property
    def image(self) -> Target:
        """The target of a technique: the image itself, or where there is glow, linear light of any strength."""
        return _BRIGHT_IMAGES[self.glow.bits] if Effect.GLOW in self.effects else _PLAIN_IMAGE

    @property
    def lamps_in_view(self) -> int:
        """The number of point and spot lights whose light may reach something in view."""
        return sum(len(self.in_view[effect]) for effect in LAMPS)

    @property
    def has_sun(self) -> bool:
        """Whether there is exactly one directional light."""
        return self.counts[Effect.DIRECTIONAL_LIGHTS] == 1

    @property
    def has_both_models(self) -> bool:
        """Whether some materials are of the metallic-roughness model, and others of the specular one."""
        return Effect.METALS in self.effects and self.counts[Effect.METALS] < self.material_count

    @property
    def has_planes(self) -> bool:
        """Whether surfaces are told from their normals: maps bend these, and shadows fall on those."""
        bends = not self.effects.isdisjoint((Effect.NORMAL_MAPS, Effect.MATERIAL_SHADERS))
        return bends and not self.effects.isdisjoint(SHADOW_EFFECTS)

    @property
    def casts_shadows(self) -> bool:
        """Whether the scene has lights that cast shadows, in view or not: their maps are kept."""
        return any(self.counts[effect] for effect in SHADOW_EFFECTS)

    @property
    def key(self) -> tuple[object, ...]:
        """All that a technique's declaration depends on."""
        return self.effects, self.has_sun, self.has_both_models, self.casts_shadows, self.blending, self.glow

    def explain(self, effect: Effect) -> str:
        """Return why the effect is needed or not, such as `3 of 13 point lights reach what is in view`."""
        count = self.counts[effect]
        if effect in (Effect.HAZE, Effect.FOG):
            return f"the scene has {effect.value if count else f'no {effect.value}'}"
        if effect is Effect.GLOW:
            return self._explain_glow(count)
        noun, plural = _NOUNS[effect]
        if not count:
            return f"the scene has no {noun}"
        nouns = f"{count} {plural if count > 1 else noun}"
        if effect not in self.in_view:
            return f"the scene has {nouns}" if effect in self.effects else f"the scene has {nouns}, none in view"
        seen = len(self.in_view[effect])
        if effect in (Effect.TRANSPARENCY, Effect.HEIGHT_FIELDS):
            return f"{seen or 'none'} of {nouns} {'is' if seen == 1 else 'are'} in view"
        if count == 1 and not seen:
            return f"the only {noun} doesn't reach what is in view"
        return f"{seen or 'none'} of {nouns} {'reaches' if seen == 1 else 'reach'} what is in view"

    def _explain_glow(self, count: int) -> str:
        if not self.has_glow:
            return "the scene has no glow"
        if not count:
            return "no object emits more light than a white surface reflects"
        seen = "" if Effect.GLOW in self.effects else ", out of view"
        return (
            f"{count} {'objects emit' if count > 1 else 'object emits'} more light than a white surface reflects{seen}"
        )


def find_needs(
    scene: Scene,
    camera: Camera,
    *,
    reaches: tuple[bool, bool] = (True, True),
    blending: Blending = Blending.SORTED,
    glow: GlowSettings = EXACT_GLOW,
    seen: frozenset[str] | None = None,
    lights: Lights | None = None,
    last: Needs | None = None,
) -> Needs:
    """Find what `scene` needs as `camera` sees it.

    Args:
        reaches: whether any point light reaches an object, and whether any spot light does.
        blending: how transparent surfaces are to be put together. glow: how glow is to be made.
        seen: the features of surfaces that shaders have (`SeenFeatures`); by default those that are in view.
        lights: the scene's, with the ranges that count; by default as they are.
        last: what the last frame of the scene needed: it is returned again if nothing has changed.
    """
    causes = _find_causes(scene, scene.lights if lights is None else lights, None if last is None else last.causes)
    in_view = {Effect.TRANSPARENCY: find_in_view(scene, camera, scene.find_transparent())}
    in_view |= {
        effect: find_lights_in_view(camera.frustum.planes, *spheres) if reached and len(spheres[0]) else _NONE
        for effect, spheres, reached in zip(LAMPS, causes.lamps, reaches, strict=True)
    }
    fields = causes.fields
    if len(fields):
        casts = scene.objects.casts_shadow[fields] & any(causes.counts[effect] for effect in SHADOW_EFFECTS)
        fields = np.union1d(fields[casts], find_in_view(scene, camera, fields))
    in_view[Effect.HEIGHT_FIELDS] = fields
    seen = SeenFeatures(scene).find(camera) if seen is None else seen
    same = (causes, blending, glow, seen)
    if (
        last is not None
        and same == (last.causes, last.blending, last.glow, last.seen)
        and all(rows.tobytes() == last.in_view[effect].tobytes() for effect, rows in in_view.items())
    ):
        return last
    for effect, kind in LAMPS.items():
        some, rows = kind.find_rows(scene.lights), in_view[effect]
        in_view[kind.spheres] = rows[some["source_radius"][rows] > 0.0]
        in_view[kind.shadows] = rows[some["casts_shadow"][rows]] if causes.counts[kind.shadows] else _NONE
    hidden = {effect for effect, rows in in_view.items() if not len(rows)}
    hidden |= {_EFFECTS[name] for name in (*causes.features, "glow") if name not in seen and name != "vertex colors"}
    effects = frozenset(effect for effect, count in causes.counts.items() if count and effect not in hidden)
    return Needs(
        effects, causes.counts, len(scene.materials), in_view, blending, glow, scene.glow is not None, causes.shaders,
        causes, seen,
    )  # fmt: skip


def _find_causes(scene: Scene, lights: Lights, last: SceneCauses | None) -> SceneCauses:
    """Find what may cause effects, or return what was found last if the scene is as it was."""
    lights.refresh()
    state = (
        scene.material_version, len(scene.materials), lights.contents, scene.haze > 0.0, scene.fog is None,
        scene.glow is None, bool(scene.objects.casts_shadow.any()), tuple(scene.height_fields),
    )  # fmt: skip
    if last is not None and last.state == state:
        return last
    features = scene.count_features()
    fields = np.array([*scene.height_fields], np.int64)
    counts = {
        Effect.DIRECTIONAL_LIGHTS: len(lights.directional),
        Effect.HAZE: int(scene.haze > 0.0),
        Effect.FOG: int(scene.fog is not None),
        Effect.GLOW: 0 if scene.glow is None else len(scene.find_glowing()),
        Effect.TRANSPARENCY: len(scene.find_transparent()),
        Effect.HEIGHT_FIELDS: len(fields),
        Effect.SUN_SHADOWS: _count_casting(scene, lights.directional),
        **{_EFFECTS[name]: count for name, count in features.items()},
    }
    lamps = []
    for effect, kind in LAMPS.items():
        some = kind.find_rows(lights)
        counts[effect], counts[kind.shadows] = len(some), _count_casting(scene, some)
        counts[kind.spheres] = int(np.count_nonzero(some["source_radius"]))
        lamps.append((some["position"].copy(), some["range"].astype(np.float64)))
    shaders = tuple(one.shader for one in scene.shaders)
    return SceneCauses(state, counts, tuple(features), tuple(lamps), fields, shaders)


def _count_casting(scene: Scene, lights: NDArray[Any]) -> int:
    """Return the number of lights that cast shadows: none if no object does."""
    count = int(np.count_nonzero(lights["casts_shadow"]))
    return count if count and scene.objects.casts_shadow.any() else 0
