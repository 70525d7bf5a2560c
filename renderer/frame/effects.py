"""The needs of a frame: the effects that its scene has and its view shows.

A technique declares only the passes and shaders of these effects, so what a scene lacks costs nothing. Each
effect comes with the reason why it is needed or not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.frame.depth_of_field import DEFAULT_FOCUS, DepthOfFieldSettings, is_blur_seen
from renderer.frame.environment import DEFAULT_ENVIRONMENT, EnvironmentSettings
from renderer.frame.light_components import LightComponent
from renderer.frame.occlusion import (
    CONTACTS,
    DEFAULT_OCCLUSION,
    OCCLUSION,
    OcclusionSettings,
    is_occlusion_seen,
)
from renderer.frame.plan import Target
from renderer.frame.targets import IMAGE_FORMAT
from renderer.frame.temporal import NO_HISTORY, TemporalSettings
from renderer.frame.thin_air import THIN_HAZE, is_fog_seen, is_haze_seen, is_sky_fogged
from renderer.frame.transparent_layers import TransparentLayers
from renderer.frame.visible_features import VisibleFeatures
from renderer.light_kinds.kind import LocalLightKind
from renderer.light_kinds.shapes import flag_areas, flag_discs, flag_spheres
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.lights.frustum_culling import LightSpheres, select_lights_in_view
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats, Indices
from renderer.scene.lights import Lights
from renderer.scene.negligible import LEAST_LIGHT
from renderer.visibility.boxes.volumes import select_in_view
from rhi import Format, refuse
from rhi.errors.choices import Choice
from rhi.shading import find_element


class Effect(Choice):
    """An effect that a scene may call for. Each kind of lights with a position has three: `…_LIGHTS`,
    `…_SPHERES` (such lights with a radius) and `…_SHADOWS`; kinds with shapes have `…_AREAS`, too."""

    _ignore_ = "kind sphere_kind area_kind shadow_kind"

    DIRECTIONAL_LIGHTS = "directional lights"
    for kind in LOCAL_LIGHT_KINDS:
        vars()[f"{kind.name.upper()}_LIGHTS"] = f"{kind.noun}s"
    for sphere_kind in LOCAL_LIGHT_KINDS:
        vars()[f"{sphere_kind.name.upper()}_SPHERES"] = f"{sphere_kind.noun}s with a radius"
    for area_kind in LOCAL_LIGHT_KINDS:
        if area_kind.has_shapes:
            vars()[f"{area_kind.name.upper()}_AREAS"] = f"{area_kind.noun}s that are rectangles or tubes"
    IMAGES = "images"
    DECALS = "decals"
    EMISSION = "emission"
    HAZE = "haze"
    FOG = "fog"
    DEPTH_OF_FIELD = "depth of field"
    BLOOM = "bloom"
    AMBIENT_OCCLUSION = "ambient occlusion"
    ENVIRONMENT = "environment"
    SKY_BOX = "sky box"
    METALS = "metals"
    EMISSIVE_COLORS = "emissive colors"
    NORMAL_MAPS = "normal maps"
    ROUGHNESS_MAPS = "roughness maps"
    OCCLUSION_MAPS = "occlusion maps"
    EMISSIVE_MAPS = "emissive maps"
    LIGHT_MAPS = "light maps"
    MASKS = "masks"
    TWO_SIDES = "two sides"
    VERTEX_COLORS = "vertex colors"
    SECOND_UVS = "second uvs"
    TEXTURE_TRANSFORMS = "texture transforms"
    MIXED_COORDINATES = "mixed coordinates"
    MATERIAL_SHADERS = "material shaders"
    DIRECTIONAL_SHADOWS = "shadows of directional lights"
    for shadow_kind in LOCAL_LIGHT_KINDS:
        vars()[f"{shadow_kind.name.upper()}_SHADOWS"] = f"shadows of {shadow_kind.noun}s"
    DIRECTIONAL_PENUMBRAS = "penumbras of directional lights"
    LOCAL_PENUMBRAS = "penumbras of local lights"
    CONTACT_SHADOWS = "contact shadows"
    TRANSPARENCY = "transparency"
    TESSELLATION = "tessellation"

    __hash__ = object.__hash__


_EFFECTS: Final = {effect.value: effect for effect in Effect}
"""Effects by their values, for each frame: asking the class takes longer."""


class LocalLightEffects(NamedTuple):
    """The effects of a kind of lights with a position besides the lights themselves: their shadows, those that
    are spheres, and those that are rectangles or tubes, if any may be."""

    kind: LocalLightKind
    shadows: Effect
    spheres: Effect
    areas: Effect | None


LOCAL_LIGHTS: Final = {
    Effect[f"{kind.name.upper()}_LIGHTS"]: LocalLightEffects(
        kind,
        Effect[f"{kind.name.upper()}_SHADOWS"],
        Effect[f"{kind.name.upper()}_SPHERES"],
        Effect[f"{kind.name.upper()}_AREAS"] if kind.has_shapes else None,
    )
    for kind in LOCAL_LIGHT_KINDS
}
"""The effects of the lights with a position, in the order of the table of kinds."""
SHADOW_EFFECTS: Final = (Effect.DIRECTIONAL_SHADOWS, *(row.shadows for row in LOCAL_LIGHTS.values()))
"""The shadows of each kind of light."""

PENUMBRA_EFFECTS: Final = (Effect.DIRECTIONAL_PENUMBRAS, Effect.LOCAL_PENUMBRAS)
"""The shadows of lights whose sources have a size, where the filter is `ShadowFilter.PCSS`."""


CAMERA_EFFECTS: Final = (Effect.DEPTH_OF_FIELD, Effect.BLOOM)
"""The effects of the camera, which move light of the image before its tones are mapped."""


class Blending(Choice):
    """The way in which transparent surfaces that cover each other are put together."""

    SORTED = "sorted"
    """Objects are drawn back to front, each over what is behind it."""
    WEIGHTED = "weighted"
    """Surfaces are averaged, near ones with more weight, in any order (McGuire and Bavoil 2013)."""


_SURROUNDINGS: Final = frozenset((Effect.HAZE, Effect.FOG, Effect.SKY_BOX))
_AMBIENT: Final = frozenset(
    (Effect.AMBIENT_OCCLUSION, Effect.ENVIRONMENT, Effect.OCCLUSION_MAPS, Effect.LIGHT_MAPS)
)
_EMITTED: Final = frozenset((Effect.EMISSION, Effect.EMISSIVE_COLORS, Effect.EMISSIVE_MAPS))
_OF_THE_SUN: Final = frozenset(
    (
        Effect.DIRECTIONAL_LIGHTS,
        Effect.DIRECTIONAL_SHADOWS,
        Effect.DIRECTIONAL_PENUMBRAS,
        Effect.CONTACT_SHADOWS,
    )
)
_OF_LOCAL_LIGHTS: Final = frozenset(
    (
        *LOCAL_LIGHTS,
        *(effect for _, *effects in LOCAL_LIGHTS.values() for effect in effects if effect is not None),
        Effect.LOCAL_PENUMBRAS,
    )
)


def _list_left_out(component: LightComponent) -> frozenset[Effect]:
    """The effects that a component of light leaves out."""
    if component is LightComponent.ALL:
        return frozenset()
    left_out = _SURROUNDINGS
    if not component.has_directional_lights:
        left_out |= _OF_THE_SUN
    if not component.has_local_lights:
        left_out |= _OF_LOCAL_LIGHTS
    if component is not LightComponent.AMBIENT:
        left_out |= _AMBIENT
    if component is not LightComponent.EMISSIVE:
        left_out |= _EMITTED
    if component is LightComponent.ALBEDO:
        left_out |= {*CAMERA_EFFECTS}
    return left_out


_LEFT_OUT: Final = {component: _list_left_out(component) for component in LightComponent}

LIGHT_FORMATS: Final = {11: Format.R11G11B10F, 16: Format.RGBA16F, 32: Format.RGBA32F}
"""Formats of linear light by the bits of a channel."""


@dataclass(frozen=True, slots=True)
class BloomSettings:
    """Settings of the accuracy of bloom.

    Attributes:
        levels: how often the light is halved in size; each level spreads it twice as far.
        karis_average: whether single bright pixels count less (Karis 2013), which may flicker as things move.
            Otherwise all light counts the same, and bloom has exactly as much light as is scattered.
        bits: those of a channel of the image and of its levels while they hold light: 11 (10 of blue), 16 or
            32.
    """

    levels: int = 6
    karis_average: bool = False
    bits: int = 16

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_BLOOM)
        if not 1 <= self.levels <= _MAX_LEVELS:
            refuse(
                rules.BAD_BLOOM,
                "BloomSettings(levels=...)",
                self.levels,
                f"a whole number from 1 to {_MAX_LEVELS}",
            )
        if self.bits not in LIGHT_FORMATS:
            refuse(
                rules.BAD_BLOOM,
                "BloomSettings(bits=...)",
                self.bits,
                f"one of {', '.join(map(str, LIGHT_FORMATS))}",
            )


_MAX_LEVELS: Final = 12
_MAX_BOUND_MODELS: Final = 2
"""The lighting models with parameters that a pass over a geometry buffer binds: with its other buffers, as many as each
device of WebGPU binds (8)."""
_NONE: Final[Indices] = np.zeros(0, np.int64)
EXACT_BLOOM: Final = BloomSettings()
"""Bloom that has all of the light that is scattered."""

_PLAIN_IMAGE: Final = Target("image", IMAGE_FORMAT)
_BRIGHT_IMAGES: Final = {bits: Target("bright_image", format) for bits, format in LIGHT_FORMATS.items()}

_NOUNS: Final = {
    Effect.DIRECTIONAL_LIGHTS: ("directional light", "directional lights"),
    Effect.IMAGES: ("image", "images"),
    Effect.DECALS: ("decal", "decals"),
    Effect.EMISSION: ("material that emits light", "materials that emit light"),
    Effect.METALS: ("metallic-roughness material", "metallic-roughness materials"),
    Effect.EMISSIVE_COLORS: ("material with an emissive color", "materials with an emissive color"),
    Effect.NORMAL_MAPS: ("material with a normal map", "materials with a normal map"),
    Effect.ROUGHNESS_MAPS: (
        "material with a metallic-roughness map",
        "materials with a metallic-roughness map",
    ),
    Effect.OCCLUSION_MAPS: ("material with an occlusion map", "materials with an occlusion map"),
    Effect.EMISSIVE_MAPS: ("material with an emissive map", "materials with an emissive map"),
    Effect.LIGHT_MAPS: ("material with a light map", "materials with a light map"),
    Effect.MASKS: ("material with a mask", "materials with a mask"),
    Effect.TWO_SIDES: ("material with two sides", "materials with two sides"),
    Effect.VERTEX_COLORS: ("mesh with colors", "meshes with colors"),
    Effect.SECOND_UVS: ("texture with a second uv", "textures with a second uv"),
    Effect.TEXTURE_TRANSFORMS: (
        "texture that is transformed or clamped",
        "textures that are transformed or clamped",
    ),
    Effect.MIXED_COORDINATES: (
        "material with unlike texture coordinates",
        "materials with unlike texture coordinates",
    ),
    Effect.MATERIAL_SHADERS: ("material with a shader of its own", "materials with shaders of their own"),
    Effect.TRANSPARENCY: ("transparent object", "transparent objects"),
    Effect.TESSELLATION: ("tessellated surface", "tessellated surfaces"),
    Effect.DIRECTIONAL_SHADOWS: (
        "directional light that casts shadows",
        "directional lights that cast shadows",
    ),
    Effect.DIRECTIONAL_PENUMBRAS: (
        "directional light with a size that casts shadows",
        "directional lights with a size that cast shadows",
    ),
    Effect.CONTACT_SHADOWS: (
        "directional light that casts shadows",
        "directional lights that cast shadows",
    ),
    Effect.LOCAL_PENUMBRAS: (
        "local light with a radius that casts shadows",
        "local lights with a radius that cast shadows",
    ),
}
for _effect, _row in LOCAL_LIGHTS.items():
    _noun = _row.kind.noun
    _NOUNS[_effect] = (_noun, f"{_noun}s")
    _NOUNS[_row.spheres] = (f"{_noun} with a radius", f"{_noun}s with a radius")
    if _row.areas is not None:
        _NOUNS[_row.areas] = (
            f"{_noun} that is a rectangle or tube",
            f"{_noun}s that are rectangles or tubes",
        )
    _NOUNS[_row.shadows] = (f"{_noun} that casts shadows", f"{_noun}s that cast shadows")


@dataclass(frozen=True, eq=False, slots=True)
class EffectSources:
    """Possible sources of effects in a scene, seen from anywhere; it is kept while the scene is in the same
    `state`.

    Attributes:
        counts: of each effect, how many causes there are.
        features: the names of those that materials and meshes have.
        local_lights: the spheres around what the point and the spot lights may light: centres (k, 3), radii (k,).
        tessellated: the object indices of the surfaces whose triangles are chosen for each view.
        shaders: those that materials have of their own.
        layers: those of transparent objects.
        contact_light: the index of the first directional light that casts shadows; 0 without any.
    """

    state: tuple[object, ...]
    counts: dict[Effect, int]
    features: tuple[str, ...]
    local_lights: tuple[tuple[Floats, Floats], ...]
    tessellated: Indices
    shaders: tuple[type[Any], ...]
    layers: TransparentLayers
    contact_light: int


@dataclass(frozen=True, eq=False)
class FrameEffects:
    """The effects that one frame needs, with their reasons.

    Attributes:
        enabled: the effects that are needed.
        counts: of each effect, how many of its causes the scene has.
        material_count: the number of materials.
        in_view: the rows of the point and of the spot lights whose light may reach something in view; as
            their shadows, the rows of those of them that cast some, none if no object does; as spheres, those
            that have a radius; and of the transparent objects and of the tessellated surfaces in view, or that cast
            shadows.
        blending: how transparent objects are put together.
        bloom: how bloom is made.
        has_bloom: whether the scene has bloom, whatever shines in it.
        occlusion: how exactly ambient occlusion is computed.
        depth_of_field: how exactly depth of field is computed.
        temporal: how samples of many frames are put together; `NO_HISTORY` if each frame is on its own.
        has_movable_objects: whether the motion of objects is needed for that.
        environment: how exactly light from an environment is computed.
        component: the part of the light that is drawn.
        filters_penumbras: whether shadows are as soft as the sizes of sources make them.
        follows_contacts: whether rays are followed in the depth buffer towards the sun.
        shaders: those that the scene's materials have of their own.
        layers_format: the format that transparent objects are added up in; None if they are blended to the
            image itself.
        unseen: haze, fog, ambient occlusion and depth of field that change nothing in the view.
        has_fogged_sky: whether fog changes the background.
        shows_objects: whether there may be an object in view.
        sources: what of this doesn't depend on the view.
        visible_features: those of surfaces that shaders have.
    """

    enabled: frozenset[Effect]
    counts: dict[Effect, int]
    material_count: int
    in_view: Mapping[Effect, Indices]
    blending: Blending
    bloom: BloomSettings
    has_bloom: bool
    occlusion: OcclusionSettings
    depth_of_field: DepthOfFieldSettings
    temporal: TemporalSettings
    has_movable_objects: bool
    environment: EnvironmentSettings
    component: LightComponent
    filters_penumbras: bool
    follows_contacts: bool
    shaders: tuple[type[Any], ...]
    sources: EffectSources
    visible_features: frozenset[str]
    unseen: frozenset[Effect]
    has_fogged_sky: bool
    shows_objects: bool
    layers_format: Format | None

    @property
    def image(self) -> Target:
        """The target of a technique: the image itself, or where there are effects of the camera, linear light of
        any strength."""
        bits = _count_light_bits(self.enabled, self.bloom, self.depth_of_field)
        return _BRIGHT_IMAGES[bits] if bits else _PLAIN_IMAGE

    @property
    def keeps_light(self) -> bool:
        """True if the target of a technique is linear light, whose tones are mapped after all else."""
        return not self.enabled.isdisjoint(CAMERA_EFFECTS)

    @property
    def shading_reads(self) -> tuple[str, ...]:
        """The resources that a pass reads which shades opaque surfaces, whatever the technique."""
        occlusion = (OCCLUSION,) if Effect.AMBIENT_OCCLUSION in self.enabled else ()
        return (*occlusion, CONTACTS) if Effect.CONTACT_SHADOWS in self.enabled else occlusion

    @property
    def depth_reason(self) -> str:
        """Why depth is drawn before what has `shading_reads` is shaded."""
        has_occlusion = Effect.AMBIENT_OCCLUSION in self.enabled
        return f"{'ambient occlusion is' if has_occlusion else 'contact shadows are'} found from depth"

    @property
    def contact_light(self) -> int:
        """The index of the directional light whose contact shadows are drawn; 0 without any."""
        return self.sources.contact_light if Effect.CONTACT_SHADOWS in self.enabled else 0

    @property
    def local_lights_in_view(self) -> int:
        """The number of point and spot lights whose light may reach something in view."""
        return sum(len(self.in_view[effect]) for effect in LOCAL_LIGHTS)

    @property
    def has_single_directional_light(self) -> bool:
        """True if there is exactly one directional light."""
        return self.counts[Effect.DIRECTIONAL_LIGHTS] == 1 and Effect.DIRECTIONAL_LIGHTS in self.enabled

    @property
    def has_both_models(self) -> bool:
        """True if some materials are of the metallic-roughness model, and others of the specular one."""
        return Effect.METALS in self.enabled and self.counts[Effect.METALS] < self.material_count

    @property
    def has_anisotropy(self) -> bool:
        """True if a material may draw out highlights, which needs directions that geometry buffers don't store."""
        return Effect.MATERIAL_SHADERS in self.enabled and any(
            shader.has_anisotropy for shader in self.shaders
        )

    @cached_property
    def lighting_models(self) -> tuple[tuple[int, type[Any]], ...]:
        """The shaders of materials with lighting models of their own, by number."""
        if Effect.MATERIAL_SHADERS not in self.enabled:
            return ()
        return tuple(
            (number, shader)
            for number, shader in enumerate(self.shaders, 1)
            if getattr(shader, "lighting_model", None) is not None
        )

    @property
    def needs_forward(self) -> bool:
        """True if a material needs what geometry buffers don't store, or what a pass over one has no room for."""
        bound = sum(find_element(shader, "parameters") is not None for _, shader in self.lighting_models)
        return self.has_anisotropy or bound > _MAX_BOUND_MODELS

    @property
    def has_geometric_normals(self) -> bool:
        """True if geometric normals differ from shading normals and are needed: maps bend the latter, and shadows
        fall on the former."""
        bends = not self.enabled.isdisjoint((Effect.NORMAL_MAPS, Effect.MATERIAL_SHADERS))
        return bends and not self.enabled.isdisjoint(SHADOW_EFFECTS)

    @property
    def has_shadow_casters(self) -> bool:
        """True if the scene has lights that cast shadows, in view or not: their maps are kept."""
        return any(self.counts[effect] for effect in SHADOW_EFFECTS)

    @cached_property
    def key(self) -> tuple[object, ...]:
        """All that a technique's declaration depends on."""
        return (
            self.enabled,
            self.has_single_directional_light,
            self.has_both_models,
            self.has_shadow_casters,
            self.blending,
            self.bloom,
            self.occlusion,
            self.depth_of_field,
            self.temporal,
            self.has_movable_objects,
            self.environment,
            self.component,
            self.has_fogged_sky,
            self.layers_format,
            self.has_anisotropy,
            self.lighting_models,
        )

    def explain(self, effect: Effect) -> str:
        """Return why the effect is needed or not, such as `3 of 13 point lights reach what is in view`."""
        count = self.counts[effect]
        if count and effect in _LEFT_OUT[self.component]:
            return f"only the {self.component.value} component of light is drawn"
        if effect in (Effect.HAZE, Effect.FOG):
            unseen = ", too thin to be seen" if effect in self.unseen else ""
            return f"the scene has {effect.value if count else f'no {effect.value}'}{unseen}"
        if effect is Effect.BLOOM:
            return self._explain_bloom(count)
        if effect is Effect.AMBIENT_OCCLUSION:
            return self._explain_occlusion(count)
        if effect in (Effect.ENVIRONMENT, Effect.SKY_BOX):
            return self._explain_environment(effect, count)
        if effect is Effect.DEPTH_OF_FIELD:
            return self._explain_depth_of_field(count)
        if effect is Effect.CONTACT_SHADOWS and not self.follows_contacts:
            return "the length of contact shadows is 0"
        if effect in PENUMBRA_EFFECTS and not self.filters_penumbras:
            return "the filter of shadows isn't PCSS"
        noun, plural = _NOUNS[effect]
        if not count:
            return f"the scene has no {noun}"
        nouns = f"{count} {plural if count > 1 else noun}"
        if effect not in self.in_view:
            return (
                f"the scene has {nouns}" if effect in self.enabled else f"the scene has {nouns}, none in view"
            )
        count_in_view = len(self.in_view[effect])
        if effect in (Effect.TRANSPARENCY, Effect.TESSELLATION, Effect.DECALS):
            return f"{count_in_view or 'none'} of {nouns} {'is' if count_in_view == 1 else 'are'} in view"
        if count == 1 and not count_in_view:
            return f"the only {noun} doesn't reach what is in view"
        verb = "reaches" if count_in_view == 1 else "reach"
        return f"{count_in_view or 'none'} of {nouns} {verb} what is in view"

    def _explain_occlusion(self, count: int) -> str:
        if not count:
            return "the scene has no ambient occlusion"
        if not self.shows_objects:
            return "the scene has ambient occlusion, and no object in view"
        if Effect.AMBIENT_OCCLUSION in self.unseen:
            return "the scene has ambient occlusion, within less than a pixel"
        return "surfaces take ambient light away from each other"

    def _explain_environment(self, effect: Effect, count: int) -> str:
        if not count:
            return f"the scene has no {effect.value}"
        if effect is Effect.SKY_BOX:
            return "the environment is the background"
        if not self.shows_objects:
            return "the scene has an environment, and no object in view"
        return "the environment gives light"

    def _explain_depth_of_field(self, count: int) -> str:
        if not count:
            return "the scene has no depth of field"
        if Effect.DEPTH_OF_FIELD in self.unseen:
            return "the scene has depth of field, with discs of less than a pixel"
        if Effect.DEPTH_OF_FIELD not in self.enabled:
            return "the scene has depth of field, and the view shows one color"
        return "what is out of focus is seen as discs"

    def _explain_bloom(self, count: int) -> str:
        if not self.has_bloom:
            return "the scene has no bloom"
        if not count:
            return "no object emits more light than a white surface reflects"
        out_of_view = "" if Effect.BLOOM in self.enabled else ", out of view"
        objects = "objects emit" if count > 1 else "object emits"
        return f"{count} {objects} more light than a white surface reflects{out_of_view}"


def collect_frame_effects(
    scene: Scene,
    camera: Camera,
    *,
    reaches: Sequence[bool] = (True,) * len(LOCAL_LIGHT_KINDS),
    blending: Blending = Blending.SORTED,
    bloom: BloomSettings = EXACT_BLOOM,
    occlusion: OcclusionSettings = DEFAULT_OCCLUSION,
    depth_of_field: DepthOfFieldSettings = DEFAULT_FOCUS,
    temporal: TemporalSettings = NO_HISTORY,
    environment: EnvironmentSettings = DEFAULT_ENVIRONMENT,
    component: LightComponent = LightComponent.ALL,
    filters_penumbras: bool = False,
    follows_contacts: bool = False,
    visible_features: frozenset[str] | None = None,
    shows_objects: bool | None = None,
    lights: Lights | None = None,
    widest: Format = Format.RGBA32F,
    last: FrameEffects | None = None,
) -> FrameEffects:
    """Find what `scene` needs as `camera` sees it.

    Args:
        reaches: whether any light reaches an object, for each kind of lights with a position.
        blending: how transparent surfaces are to be put together.
        bloom: how bloom is to be made.
        occlusion: how ambient occlusion is to be computed.
        depth_of_field: how depth of field is to be computed.
        temporal: how samples of many frames are to be put together.
        environment: how light from an environment is to be computed.
        component: the part of the light that is to be drawn.
        filters_penumbras: whether shadows are to be as soft as the sizes of sources make them.
        follows_contacts: whether rays are to be followed in the depth buffer towards the sun.
        visible_features: those of surfaces that shaders have (`VisibleFeatures`); by default those that are
            in view.
        shows_objects: whether any object is in view, on which shadows of the sun could fall; None to look.
        lights: the scene's that shine, with the ranges that count; by default those that shine, as they are.
        widest: the color format with the most bits that the device blends.
        last: what the last frame of the scene needed: it is returned again if nothing has changed.
    """
    if lights is None:
        scene.lights.refresh()
        lights = scene.lights.without_dark(scene.strongest_response())
    sources = _collect_effect_sources(scene, lights, None if last is None else last.sources)
    if visible_features is None:
        visible_features = VisibleFeatures(scene).collect(camera)
    if shows_objects is None:
        shows_objects = bool(len(select_in_view(scene, camera, np.arange(len(scene.objects)))))
    in_view, air, has_fogged_sky = _look(scene, camera, sources, reaches)
    if not (temporal.is_on and (shows_objects or has_fogged_sky)):
        temporal = NO_HISTORY  # all samples are of one color
    if (
        last is not None
        and (
            sources,
            blending,
            bloom,
            occlusion,
            depth_of_field,
            temporal,
            environment,
            component,
            filters_penumbras,
            follows_contacts,
            visible_features,
            shows_objects,
        )
        == (
            last.sources,
            last.blending,
            last.bloom,
            last.occlusion,
            last.depth_of_field,
            last.temporal,
            last.environment,
            last.component,
            last.filters_penumbras,
            last.follows_contacts,
            last.visible_features,
            last.shows_objects,
        )
        and _shows_same(last, in_view, air, has_fogged_sky)
    ):
        return last
    penumbras = []
    for effect, row in LOCAL_LIGHTS.items():
        lights_of_kind, light_indices = lights.of_kind(row.kind), in_view[effect]
        wide = in_view[row.spheres] = light_indices[flag_spheres(lights_of_kind)[light_indices]]
        if row.areas is not None:
            in_view[row.areas] = _NONE
            if sources.counts[row.areas]:
                areas = flag_areas(lights_of_kind)
                in_view[row.areas] = light_indices[areas[light_indices]]
                in_view[row.spheres] = wide[~areas[wide]]
        in_view[row.shadows] = (
            light_indices[lights_of_kind["casts_shadow"][light_indices]]
            if sources.counts[row.shadows] and component.has_local_lights
            else _NONE
        )
        penumbras.append(np.intersect1d(in_view[row.shadows], wide, assume_unique=True))
    in_view[Effect.LOCAL_PENUMBRAS] = np.concatenate(penumbras)
    hidden = {effect for effect, object_indices in in_view.items() if not len(object_indices)} | air
    hidden |= _LEFT_OUT[component]
    if not filters_penumbras:
        hidden |= {*PENUMBRA_EFFECTS}
    if not follows_contacts:
        hidden |= {Effect.CONTACT_SHADOWS}
    if not shows_objects:
        hidden |= {Effect.DIRECTIONAL_SHADOWS, Effect.DIRECTIONAL_PENUMBRAS, Effect.AMBIENT_OCCLUSION}
        hidden |= {Effect.ENVIRONMENT, Effect.CONTACT_SHADOWS, Effect.DECALS}
    if not (shows_objects or has_fogged_sky or sources.counts[Effect.SKY_BOX]):
        hidden |= {Effect.DEPTH_OF_FIELD}
    hidden |= {
        _EFFECTS[name]
        for name in (*sources.features, "bloom")
        if name not in visible_features and name != "vertex colors"
    }
    enabled = frozenset(effect for effect, count in sources.counts.items() if count and effect not in hidden)
    has_fogged_sky = has_fogged_sky and Effect.FOG in enabled
    bits = _count_light_bits(enabled, bloom, depth_of_field)
    image = LIGHT_FORMATS[bits] if bits else IMAGE_FORMAT
    return FrameEffects(
        enabled,
        sources.counts,
        len(scene.materials),
        in_view,
        blending,
        bloom,
        scene.bloom is not None,
        occlusion,
        depth_of_field,
        temporal,
        temporal.is_on and bool(len(scene.objects.following_indices) or scene.simulated),
        environment,
        component,
        filters_penumbras,
        follows_contacts,
        sources.shaders,
        sources,
        visible_features,
        air,
        has_fogged_sky,
        shows_objects,
        _layers_format(sources, in_view[Effect.TRANSPARENCY], blending, image, widest),
    )


def are_effects_same(
    last: FrameEffects,
    scene: Scene,
    camera: Camera,
    visible_features: frozenset[str],
    shows_objects: bool,
    reaches: Sequence[bool],
) -> bool:
    """Return whether a frame of `camera` needs what the `last` one needed, if scene and settings are as they
    were then; see `collect_frame_effects`."""
    if (visible_features, shows_objects) != (last.visible_features, last.shows_objects):
        return False
    return _shows_same(last, *_look(scene, camera, last.sources, reaches))


class LightWatch:
    """Tells whether frames show the same effects as an earlier one, where of all effects only local lights
    depend on the view: nothing is transparent, and the air is clear, or so dense that every view shows it."""

    def __init__(self, effects: FrameEffects, reaches: Sequence[bool]) -> None:
        """`reaches`: for each kind of local lights, whether any reaches an object, when the `effects` were
        collected."""
        self._features = effects.visible_features, effects.shows_objects
        self._effects, self._reaches = effects, reaches
        self._spheres: LightSpheres | None = (
            None  # made for the next frame, since many frames have none after them
        )
        self._seen = b""  # which of them are in view

    def _list_spheres(self) -> LightSpheres:
        """Return the spheres of all lights that reach an object, and note which of them are in view."""
        positions, ranges, seen = [np.zeros((0, 3))], [np.zeros(0)], [np.zeros(0, bool)]
        for effect, spheres, reached in zip(
            LOCAL_LIGHTS, self._effects.sources.local_lights, self._reaches, strict=True
        ):
            if reached:
                positions.append(spheres[0])
                ranges.append(spheres[1])
                seen.append(np.isin(np.arange(len(spheres[1])), self._effects.in_view[effect]))
        self._seen = np.concatenate(seen).tobytes()
        return LightSpheres(np.concatenate(positions), np.concatenate(ranges))

    def shows_same(self, camera: Camera, visible_features: frozenset[str], shows_objects: bool) -> bool:
        """Return whether a frame of the same scene and settings needs the same effects, as `are_effects_same`."""
        if (visible_features, shows_objects) != self._features:
            return False
        if self._spheres is None:
            self._spheres = self._list_spheres()
        return not self._seen or self._spheres.flag_in_view(camera.frustum.planes).tobytes() == self._seen


def watch_lights(effects: FrameEffects, scene: Scene, reaches: Sequence[bool]) -> LightWatch | None:
    """Return a watch for the frames after one with these `effects`; None if more than local lights depends on
    the view."""
    counts = effects.sources.counts
    if (
        len(scene.list_transparent())
        or len(effects.sources.tessellated)
        or counts[Effect.FOG]
        or counts[Effect.AMBIENT_OCCLUSION]
        or counts[Effect.DEPTH_OF_FIELD]
        or counts[Effect.DECALS]
        or (counts[Effect.HAZE] and scene.haze < THIN_HAZE)
    ):
        return None
    return LightWatch(effects, reaches)


def _look(
    scene: Scene, camera: Camera, sources: EffectSources, reaches: Sequence[bool]
) -> tuple[dict[Effect, Indices], frozenset[Effect], bool]:
    """Return the effects of the view: the rows of each that are in it, what of them can't be seen, and whether
    fog changes the background."""
    in_view = {Effect.TRANSPARENCY: select_in_view(scene, camera, scene.list_transparent())}
    decals = scene.decals
    in_view[Effect.DECALS] = select_lights_in_view(camera.frustum.planes, decals.centers, decals.radii)
    planes, counts = camera.frustum.planes, sources.counts
    for effect, spheres, reached in zip(LOCAL_LIGHTS, sources.local_lights, reaches, strict=True):
        in_view[effect] = select_lights_in_view(planes, *spheres) if reached and len(spheres[0]) else _NONE
    tessellated = sources.tessellated
    if len(tessellated):
        casts = scene.objects.casts_shadow[tessellated] & any(counts[effect] for effect in SHADOW_EFFECTS)
        if casts.any():  # shadows fall on something in view, or there are no maps
            casts &= bool(len(select_in_view(scene, camera, np.arange(len(scene.objects)))))
        tessellated = np.union1d(tessellated[casts], select_in_view(scene, camera, tessellated))
    in_view[Effect.TESSELLATION] = tessellated
    unseen = set()
    if counts[Effect.HAZE] and not is_haze_seen(scene, camera):
        unseen.add(Effect.HAZE)
    if counts[Effect.FOG] and not is_fog_seen(scene, camera):
        unseen.add(Effect.FOG)
    if counts[Effect.AMBIENT_OCCLUSION] and not is_occlusion_seen(scene, camera):
        unseen.add(Effect.AMBIENT_OCCLUSION)
    if counts[Effect.DEPTH_OF_FIELD] and not is_blur_seen(scene, camera):
        unseen.add(Effect.DEPTH_OF_FIELD)
    has_fogged_sky = counts[Effect.FOG] > 0 and Effect.FOG not in unseen and is_sky_fogged(scene, camera)
    return in_view, frozenset(unseen), has_fogged_sky


def _shows_same(
    last: FrameEffects, in_view: Mapping[Effect, Indices], air: frozenset[Effect], has_fogged_sky: bool
) -> bool:
    """Return whether what depends on the view is the same as in the last frame."""
    if (air, has_fogged_sky) != (last.unseen, last.has_fogged_sky):
        return False
    return [indices.tobytes() for indices in in_view.values()] == [
        last.in_view[effect].tobytes() for effect in in_view
    ]


def _count_light_bits(
    enabled: frozenset[Effect], bloom: BloomSettings, depth_of_field: DepthOfFieldSettings
) -> int:
    """Return the bits of a channel of a technique's target while it holds light; 0 if it never does."""
    bits = {Effect.BLOOM: bloom.bits, Effect.DEPTH_OF_FIELD: depth_of_field.bits}
    return max((bits[effect] for effect in CAMERA_EFFECTS if effect in enabled), default=0)


def _layers_format(
    sources: EffectSources, in_view: Indices, blending: Blending, image: Format, widest: Format
) -> Format | None:
    """Return the format that transparent objects in view are added up in."""
    if not len(in_view):
        return None
    if blending is Blending.WEIGHTED:
        return sources.layers.weighted_target(in_view, image, widest)
    return sources.layers.sorted_target(in_view, image, widest)


def _collect_effect_sources(scene: Scene, lights: Lights, last: EffectSources | None) -> EffectSources:
    """Find what may cause effects, or return what was found last if the scene is as it was."""
    state = (
        scene.material_version,
        len(scene.materials),
        lights.snapshot,
        scene.haze > 0.0,
        scene.fog is None,
        scene.bloom is None,
        scene.ambient_occlusion is None,
        scene.depth_of_field is None,
        scene.environment,
        _has_ambient_light(scene),
        bool(scene.objects.casts_shadow.any()),
        tuple(scene.tessellated),
        len(scene.decals.seen),
    )
    if last is not None and last.state == state:
        return last
    features = scene.count_features()
    tessellated = np.array([*scene.tessellated], np.int64)
    counts = {
        Effect.DIRECTIONAL_LIGHTS: len(lights.directional),
        Effect.HAZE: int(scene.haze > 0.0),
        Effect.FOG: int(scene.fog is not None),
        Effect.BLOOM: 0 if scene.bloom is None else len(scene.list_emitters()),
        Effect.AMBIENT_OCCLUSION: int(scene.ambient_occlusion is not None and _has_ambient_light(scene)),
        Effect.DEPTH_OF_FIELD: int(scene.depth_of_field is not None),
        Effect.ENVIRONMENT: int(scene.environment is not None and _has_ambient_light(scene)),
        Effect.SKY_BOX: int(scene.environment is not None and scene.environment.is_visible),
        Effect.TRANSPARENCY: len(scene.list_transparent()),
        Effect.TESSELLATION: len(tessellated),
        Effect.DECALS: len(scene.decals.seen),
        Effect.DIRECTIONAL_SHADOWS: _count_casting(scene, lights.directional),
        Effect.DIRECTIONAL_PENUMBRAS: _count_casting(
            scene, lights.directional[flag_discs(lights.directional)]
        ),
        Effect.LOCAL_PENUMBRAS: 0,
        Effect.CONTACT_SHADOWS: _count_casting(scene, lights.directional),
        **{_EFFECTS[name]: count for name, count in features.items()},
    }
    local_lights = []
    for effect, row in LOCAL_LIGHTS.items():
        lights_of_kind = lights.of_kind(row.kind)
        counts[effect] = len(lights_of_kind)
        counts[row.shadows] = _count_casting(scene, lights_of_kind)
        is_wide = flag_spheres(lights_of_kind)
        counts[row.spheres] = int(np.count_nonzero(is_wide))
        counts[Effect.LOCAL_PENUMBRAS] += _count_casting(scene, lights_of_kind[is_wide])
        if row.areas is not None:
            is_area = flag_areas(lights_of_kind)
            counts[row.areas] = int(np.count_nonzero(is_area))
            counts[row.spheres] -= int(np.count_nonzero(is_wide & is_area))
        centers, radii = row.kind.bound_lights(lights_of_kind)
        local_lights.append((centers.copy(), radii))
    shaders = tuple(scene_shader.shader for scene_shader in scene.shaders)
    layers = TransparentLayers.count(scene)
    casts = lights.directional["casts_shadow"]
    contact_light = int(np.argmax(casts)) if len(casts) else 0
    return EffectSources(
        state, counts, tuple(features), tuple(local_lights), tessellated, shaders, layers, contact_light
    )


def _has_ambient_light(scene: Scene) -> bool:
    """Return whether ambient light adds more than half a level to any pixel."""
    environment = scene.environment
    brightest = max(*scene.lights.sky, *scene.lights.ground) if environment is None else environment.brightest
    return brightest * scene.strongest_response() > LEAST_LIGHT


def _count_casting(scene: Scene, lights: NDArray[Any]) -> int:
    """Return the number of lights that cast shadows: none if no object does."""
    count = int(np.count_nonzero(lights["casts_shadow"]))
    return count if count and scene.objects.casts_shadow.any() else 0
