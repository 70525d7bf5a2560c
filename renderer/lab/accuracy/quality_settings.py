"""The registry of quality settings: every choice of the renderer that trades accuracy for time.

An entry sets nothing by itself: it names a setting of `RenderSettings` by its path, and some of its values in
order, the least accurate first. With them go the reference that values are compared with, the unit of the
error, and what the setting needs to matter: other settings (`base_settings`) and something in the scene
(`requirement`). A new quality setting is one entry of `QUALITY_SETTINGS`; the sweep, the table, the choice of
settings and the tests find it there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

from renderer import rules
from renderer.content.fountains import DROPS
from renderer.frame import Blending, BloomSettings, TemporalSettings, TextureSettings
from renderer.scene import Compression, Depth
from renderer.scene.cloth.cloth_grid import INTERVAL, SUB_STEPS
from renderer.settings import RenderSettings
from renderer.shadows import ShadowFilter
from renderer.techniques.parts.geometry_buffer import NORMAL_BITS
from rhi import Filter
from rhi.errors.choices import Choice
from rhi.shading import Precision


class ErrorUnit(Choice):
    """The unit of an error."""

    LEVELS = "levels of 255"
    """The difference of a pixel to the reference's: its worst channel, in sRGB."""
    DEPTH = "millionths of the distance"
    """The error of the distance computed back from a pixel's depth, relative to the distance."""
    LIGHTS = "lights too many"
    """Lights that a pixel's shader evaluates although they don't reach its surface: the mean over the
    image."""
    OVERDRAW = "% too many triangles"
    """How many more triangles are drawn than the visible objects have, in percent of these."""
    DEGREES = "degrees"
    """The angle between a vector and its decoded value."""
    PERCENT = "%"
    """The length of the difference between a vector and its decoded value, in percent of the vector's
    length."""

    @property
    def is_per_pixel(self) -> bool:
        """True if each pixel has an error."""
        return self in (ErrorUnit.LEVELS, ErrorUnit.DEPTH)


class Requirement(Choice):
    """The part of a scene that a quality setting needs to matter."""

    SHADOWS = "a light that may cast shadows"
    PENUMBRAS = "a light that may cast shadows, and whose source may have a size"
    TRANSPARENCY = "a transparent object"
    IMAGES = "an image"
    LOCAL_LIGHTS = "a point or spot light"
    BLOOM = "an object that emits more light than a white surface reflects"
    AMBIENT_LIGHT = "ambient light and a surface"
    FOCUS = "a surface out of focus"
    HISTORY = "frames that follow each other"
    ENVIRONMENT = "an environment and a surface"
    STEREO = "a second eye"
    MOTION = "something that moves by itself"
    DIVERGING_SIMULATIONS = "a simulation that depends on its history"
    CLOTH = "a cloth"
    FOUNTAINS = "a fountain"
    LEVELS_OF_DETAIL = "a mesh with levels of detail"
    TESSELLATION = "a tessellated surface whose limit holds all of its triangles"
    SHADOW_CASTING_TESSELLATION = (
        "a tessellated surface that may cast shadows, and whose limit holds all of its triangles"
    )


@dataclass(frozen=True, slots=True)
class Reference:
    """The reference that a value is compared with: an image with other settings, or a value computed in
    another way.

    Attributes:
        name: what it is, in a few words.
        changes: settings of its image that differ from the value's.
        scale: how many times as wide and high its image is. Pixels are averaged as light.
        rays: rays along each side of a pixel, if it is ray-traced; 0 if a renderer draws it. `changes` and
            `scale` are then the nearest that a renderer can draw; combined quality settings, compared in many
            views, use that.
        is_float64: whether it is computed in float64 from the triangles that were drawn.
    """

    name: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    scale: int = 1
    is_float64: bool = False
    rays: int = 0


@dataclass(frozen=True, slots=True)
class QualitySetting:
    """A choice between accuracy and time.

    Attributes:
        description: what it decides.
        path: the setting, as `RenderSettings.get` finds it; empty for an encoding, which shaders have for
            good, and for an option of generated scenes.
        values: by how tables call them, the least accurate first.
        reason: why we chose the default.
        unit: of the error.
        reference: what values are compared with.
        base_settings: other settings that it needs to matter.
        requirement: what it needs in the scene.
        history_frames: the number of earlier frames that a frame depends on, drawn before the first that
            counts; 0 if frames needn't follow each other.
        non_monotonic_reason: why errors needn't fall from each value to the next; empty where they must.
        option: of a generated scene. Each value has a scene of its own, and that of the last one is the
            reference.
    """

    name: str
    description: str
    path: str
    values: Mapping[str, Any]
    reason: str
    unit: ErrorUnit
    reference: Reference
    base_settings: Mapping[str, Any] = field(default_factory=dict)
    requirement: Requirement | None = None
    history_frames: int = 0
    non_monotonic_reason: str = ""
    option: str = ""

    @property
    def is_encoding(self) -> bool:
        """True if values are encodings, which are part of the shaders."""
        return not (self.path or self.option)

    @property
    def default(self) -> str | None:
        """The name of the default value; None if the default isn't among the values."""
        if not self.path:
            return next(
                (
                    name
                    for name, candidate in self.values.items()
                    if candidate == _FIXED_DEFAULTS.get(self.name)
                ),
                None,
            )
        value = RenderSettings().get(self.path)
        return next((name for name, candidate in self.values.items() if candidate == value), None)

    def set(self, settings: RenderSettings, value: str) -> RenderSettings:
        """Settings with a value, by its name in tables, and with what makes the quality setting matter."""
        settings = settings.change_all(self.base_settings)
        return settings.change(self.path, self.values[value]) if self.path else settings


def _same(*values: Any) -> dict[str, Any]:
    return {(str(value).lower() if not isinstance(value, Choice) else value.value): value for value in values}


FLOAT64: Final = Reference("float64", is_float64=True)
RAY_TRACED: Final = Reference("rays in float64, 16 a pixel", rays=4)
SUPER_SAMPLED: Final = replace(
    RAY_TRACED,
    changes={
        "technique.samples": 1,
        "technique.fxaa": False,
        "temporal.is_on": False,
        "textures": TextureSettings(anisotropy=16.0),
    },
    scale=4,
)
FORWARD_SHADING: Final = replace(RAY_TRACED, changes={"technique.name": "forward"})
NO_CULLING: Final = Reference("no culling", {"algorithm": "none"})
PIXEL_CENTRE_RAY: Final = Reference("a ray in float64 through the middle of each pixel", rays=1)
"""The reference of settings that move edges: with one sample a pixel, coarse maps and moved pixels blur edges
as more samples would."""
FINE_SHADOW_MAPS: Final = replace(
    PIXEL_CENTRE_RAY,
    changes={
        "shadows.max_atlas_size": 8192,
        "shadows.cascade_size": 2048,
        "shadows.cascades": 6,
        "shadows.max_size": 2048,
        "shadows.filter": ShadowFilter.SMOOTH,
        "shadows.bias": 1.0,
        "shadows.budget": 512,
    },
)
PENUMBRAS: Final = replace(
    FINE_SHADOW_MAPS,
    name="rays in float64 through the middle of each pixel, and from there to 288 points of each source",
    changes={
        **FINE_SHADOW_MAPS.changes,
        "shadows.filter": ShadowFilter.PCSS,
        "shadows.blocker_samples": 64,
        "shadows.penumbra_samples": 256,
    },
)
LIGHTS_IN_RANGE: Final = Reference("the lights that reach each pixel, in float64")
VISIBLE_OBJECTS: Final = Reference("the objects of which a pixel is seen")
FILTERED_SHADOWS: Final = replace(FINE_SHADOW_MAPS, name=RAY_TRACED.name, rays=4)
FAR_SHADOWS: Final = replace(
    FINE_SHADOW_MAPS, changes={**FINE_SHADOW_MAPS.changes, "shadows.distance": 1000.0}
)
SORTED_BLENDING: Final = replace(RAY_TRACED, changes={"blending": Blending.SORTED})
WIDE_BLOOM: Final = Reference("all scattered light, spread over 8 levels", {"bloom": BloomSettings(levels=8)})
UNCOMPRESSED: Final = Reference("uncompressed images", {"textures.compression": Compression.NONE})
ALL_LEVELS: Final = Reference("all levels of all images", {"textures.memory": 0.0})
FULL_MESHES: Final = Reference("full meshes", {"detail_error": 0.0})
FINEST_TESSELLATION: Final = replace(RAY_TRACED, changes={"tessellation.edge_pixels": 0.01})
EVERY_FRAME_ANIMATED: Final = Reference("motion in each frame", {"animation_step": 0.0, "animation_lag": 0.0})
DISTANCES: Final = Reference("the distances in float64")
RENDERED_SECOND_EYE: Final = replace(PIXEL_CENTRE_RAY, changes={"reprojects": False})
ALL_FOR_EACH_EYE: Final = Reference("all drawn for each eye", {"reprojects": False, "far_error": 0.0})
VECTORS: Final = Reference("the vectors in float64")
ALL_SIMULATED: Final = Reference("everything simulated in each frame", {"simulates_hidden": True})
LAST_VALUE: Final = Reference("the scene with the last value")

_FORWARD: Final = {"technique.name": "forward", "algorithm": "frustum"}
_LARGE_ATLAS: Final = {**_FORWARD, "shadows.max_atlas_size": 8192}
_RANDOM_QUERIES: Final = (
    "CHC++ picks at random when an object is queried again, so neighbouring settings may swap ranks"
)
_CHC: Final = {**_FORWARD, "algorithm": "chc_plus_plus"}
_QUERY_HISTORY: Final = 24
"""Frames after which CHC++ has queried everything visible in the first frame, if all in view is drawn."""
_SOFTWARE: Final = {**_FORWARD, "algorithm": "software_depth"}

_INFERRED: Final = {**_FORWARD, "technique.name": "inferred"}
_CLUSTERED: Final = {**_FORWARD, "technique.name": "clustered"}

# Quality settings by their reference and by where they matter.
_image_quality: Final = partial(QualitySetting, unit=ErrorUnit.LEVELS, base_settings=_FORWARD)
_shadows: Final = partial(
    QualitySetting,
    unit=ErrorUnit.LEVELS,
    reference=FINE_SHADOW_MAPS,
    base_settings=_LARGE_ATLAS,
    requirement=Requirement.SHADOWS,
)
_penumbras: Final = partial(
    QualitySetting,
    unit=ErrorUnit.LEVELS,
    reference=PENUMBRAS,
    base_settings={**_LARGE_ATLAS, "shadows.filter": ShadowFilter.PCSS},
    requirement=Requirement.PENUMBRAS,
)
_occlusion: Final = partial(_image_quality, reference=PIXEL_CENTRE_RAY, requirement=Requirement.AMBIENT_LIGHT)
_environment: Final = partial(
    _image_quality,
    reference=Reference(
        "4,096 directions, 512 texels", {"environment.samples": 4096, "environment.size": 512}
    ),
    requirement=Requirement.ENVIRONMENT,
)
_inferred: Final = partial(
    QualitySetting, unit=ErrorUnit.LEVELS, reference=FORWARD_SHADING, base_settings=_INFERRED
)
_lists: Final = partial(
    QualitySetting,
    unit=ErrorUnit.LIGHTS,
    reference=LIGHTS_IN_RANGE,
    base_settings=_CLUSTERED,
    requirement=Requirement.LOCAL_LIGHTS,
)
_queries: Final = partial(
    QualitySetting, unit=ErrorUnit.OVERDRAW, reference=VISIBLE_OBJECTS, base_settings=_CHC
)
_CHAOTIC_CLOTH: Final = "the smallest change makes cloth fall into other folds, all of them equally wrong"
_cloth: Final = partial(
    _image_quality,
    path="",
    reference=LAST_VALUE,
    requirement=Requirement.CLOTH,
    history_frames=20,
    non_monotonic_reason=_CHAOTIC_CLOTH,
)
_HIDDEN_FROM_IMAGE: Final = (
    "rays through an aperture see around edges, and the image doesn't: a finer mean of it may be farther off"
)
_encoding: Final = partial(QualitySetting, unit=ErrorUnit.DEGREES, reference=VECTORS)

QUALITY_SETTINGS: Final[dict[str, QualitySetting]] = {
    setting.name: setting
    for setting in (
        _image_quality(
            "precision",
            "how exact functions such as pow are in shaders (OpenCL; GL has one way)",
            "precision",
            _same(Precision.FAST, Precision.EXACT),
            "an image of 8 bits does not show the difference",
            reference=FLOAT64,
        ),
        _image_quality(
            "samples",
            "samples a pixel",
            "technique.samples",
            _same(1, 2, 4, 8),
            "only forward, forward_plus, clustered and the deferred ones with lists have more than one",
            reference=SUPER_SAMPLED,
        ),
        _image_quality(
            "scale",
            "the size at which frames are drawn, in that of the image",
            "scale",
            _same(0.25, 0.5, 0.75, 1.0, 2.0),
            "what is smaller than a pixel that is drawn can't be shown",
            reference=SUPER_SAMPLED,
        ),
        _image_quality(
            "fxaa",
            "whether edges are smoothed in the image",
            "technique.fxaa",
            {"off": False, "on": True},
            "it also blurs what isn't an edge",
            reference=SUPER_SAMPLED,
            non_monotonic_reason="edges come nearer to the reference, "
            "and texels as bright as an edge go away from it",
        ),
        _image_quality(
            "temporal",
            "the frames whose samples a pixel is the mean of (temporal anti-aliasing)",
            "temporal",
            {
                "off": TemporalSettings(),
                "2": TemporalSettings(True, 2),
                "4": TemporalSettings(True, 4),
                "8": TemporalSettings(True, 8),
                "16": TemporalSettings(True, 16),
            },
            "moving textures blur, and films refuse it",
            reference=SUPER_SAMPLED,
            requirement=Requirement.HISTORY,
            history_frames=16,
            non_monotonic_reason="means of more frames flicker less, and blur what moves",
        ),
        _image_quality(
            "temporal_deviations",
            "how many standard deviations of its neighbours a pixel's history may be away",
            "temporal.deviations",
            _same(4.0, 2.0, 1.25, 0.75),
            "less flickers more, and more leaves ghosts",
            reference=SUPER_SAMPLED,
            base_settings={**_FORWARD, "temporal.is_on": True},
            requirement=Requirement.HISTORY,
            history_frames=16,
            non_monotonic_reason="clipped histories have fewer ghosts, and more of each frame's noise",
        ),
        _image_quality(
            "temporal_bits",
            "bits of a channel of the history of pixels",
            "temporal.bits",
            _same(16, 32),
            "half floats are less than a level off",
            reference=Reference("a history of 32 bits", {"temporal.bits": 32}),
            base_settings={**_FORWARD, "temporal.is_on": True},
            requirement=Requirement.HISTORY,
            history_frames=16,
        ),
        _image_quality(
            "texture_filter",
            "how many texels a pixel is made of",
            "textures",
            {
                "nearest texel": TextureSettings(Filter.NEAREST, None),
                "bilinear, no mip levels": TextureSettings(mip=None),
                "bilinear, nearest level": TextureSettings(mip=Filter.NEAREST),
                "trilinear": TextureSettings(),
                "anisotropic, 4": TextureSettings(anisotropy=4.0),
                "anisotropic, 16": TextureSettings(anisotropy=16.0),
            },
            "a sample a pixel; anisotropy shows more at an angle, for up to 16",
            reference=SUPER_SAMPLED,
            requirement=Requirement.IMAGES,
            non_monotonic_reason="mip levels blur what lies at an angle more than the largest one flickers, "
            "which single images don't show",
        ),
        _image_quality(
            "mip_bias",
            "levels that are added to the mip level of textures",
            "textures.mip_bias",
            _same(2.0, 1.0, 0.5, 0.0, -0.5, -1.0),
            "images' own samplers ask for it; from -1 on, what is sharper flickers more",
            reference=SUPER_SAMPLED,
            requirement=Requirement.IMAGES,
        ),
        _image_quality(
            "compression",
            "the format in which images are compressed",
            "textures.compression",
            _same(Compression.BC1, Compression.BC7, Compression.NONE),
            "it needs a package, and time at the start; BC7 takes a quarter of the memory",
            reference=UNCOMPRESSED,
            requirement=Requirement.IMAGES,
        ),
        _image_quality(
            "texture_memory",
            "MiB of images, 0 for all levels of all",
            "textures.memory",
            _same(0.015625, 0.0625, 0.25, 1.0, 4.0, 0.0),
            "it limits memory: what a view reads is there if it fits",
            reference=ALL_LEVELS,
            requirement=Requirement.IMAGES,
        ),
        _image_quality(
            "edge_pixels",
            "length of the edges of a ground's triangles in pixels",
            "tessellation.edge_pixels",
            _same(32.0, 16.0, 8.0, 4.0, 2.0),
            "outlines are off by less than a pixel nearly everywhere",
            reference=FINEST_TESSELLATION,
            requirement=Requirement.TESSELLATION,
        ),
        _image_quality(
            "offscreen_edges",
            "length of the edges of a ground's triangles out of view, in that of those in view",
            "tessellation.out_of_view_scale",
            _same(64.0, 16.0, 8.0, 4.0, 1.0),
            "only their shadows are seen",
            reference=FINEST_TESSELLATION,
            base_settings=_LARGE_ATLAS,
            requirement=Requirement.SHADOW_CASTING_TESSELLATION,
        ),
        _shadows(
            "shadow_size",
            "width of the sun's maps in texels",
            "shadows.cascade_size",
            _same(128, 256, 512, 1024, 2048),
            "finer maps are drawn in more time whenever the eye moves",
        ),
        _shadows(
            "shadow_cascades",
            "number of the sun's maps along the view",
            "shadows.cascades",
            _same(1, 2, 3, 4, 6),
            "from four on the nearest map is as fine as the image",
        ),
        _shadows(
            "shadow_distance",
            "how far from the eye there are shadows, in metres",
            "shadows.distance",
            _same(50.0, 125.0, 250.0, 500.0),
            "beyond it a shadow is a few pixels, and near ones would be coarser",
            reference=FAR_SHADOWS,
            non_monotonic_reason="the same texels are spread over more, so near shadows are coarser; "
            "far ones are few pixels",
        ),
        _shadows(
            "shadow_filter",
            "texels of a map that a pixel is compared with: 1, 4, 12, 16",
            "shadows.filter",
            _same(ShadowFilter.HARD, ShadowFilter.HARDWARE, ShadowFilter.POISSON, ShadowFilter.SMOOTH),
            "no steps, and no noise that moves with the eye",
            reference=FILTERED_SHADOWS,
            non_monotonic_reason="the reference has sharp edges, and a filter trades steps for blur: "
            "of these the eye sees steps",
        ),
        _penumbras(
            "blocker_samples",
            "texels of a map that are searched for what stands before a source",
            "shadows.blocker_samples",
            _same(4, 8, 16, 32),
            "more of them change less than what one mean of all heights is off by",
            non_monotonic_reason="beside thin casters a coarse search may come nearer by chance",
        ),
        _penumbras(
            "penumbra_samples",
            "texels of a map that a pixel in a penumbra is compared with",
            "shadows.penumbra_samples",
            _same(8, 16, 32, 64),
            "steps are less than a level up to penumbras of some 30 texels",
        ),
        _shadows(
            "contact_steps",
            "samples of depth of a ray that is followed towards the sun",
            "shadows.contact_steps",
            _same(4, 8, 16, 32, 64),
            "more of them change less than what the image doesn't show",
            reference=PIXEL_CENTRE_RAY,
            base_settings={**_FORWARD, "shadows.contact_length": 0.5},
        ),
        _shadows(
            "contact_rays",
            "rays that are followed towards a sun with a size, from each pixel",
            "shadows.contact_rays",
            _same(1, 4, 8, 16, 32),
            "a penumbra on the screen is a few pixels wide, and so are eight steps",
            reference=PENUMBRAS,
            base_settings={**_FORWARD, "shadows.filter": ShadowFilter.PCSS, "shadows.contact_length": 0.5},
            requirement=Requirement.PENUMBRAS,
        ),
        _shadows(
            "shadow_bias",
            "what keeps surfaces from shading themselves, in what texels and angles call for",
            "shadows.bias",
            _same(0.0, 0.5, 1.0),
            "without it surfaces shade themselves, and it costs nothing",
        ),
        _shadows(
            "local_shadow_size",
            "largest width of a local light's map in texels",
            "shadows.max_size",
            _same(32, 64, 128, 256, 512, 1024),
            "a map is drawn once, and as wide as the lit part of the screen",
        ),
        _shadows(
            "shadow_budget",
            "maps of far lights that are drawn again in a frame",
            "shadows.budget",
            _same(1, 2, 8, 32),
            "distant casters may be late by some frames",
            history_frames=6,
        ),
        _inferred(
            "inferred_scale",
            "size of the light buffers of inferred lighting, in that of the image",
            "technique.scale",
            _same(0.3, 0.4, 0.6, 0.8, 1.0),
            "a third of the pixels, and edges that are seldom seen to be wrong",
            requirement=Requirement.LOCAL_LIGHTS,
            non_monotonic_reason="0.8 may lose to 0.6, since its texels lie differently between the image's",
        ),
        _inferred(
            "inferred_transparency",
            "whether transparent surfaces are lit in stippled light buffers, or by their objects' lights",
            "technique.stippled",
            {"stippled": True, "by lists": False},
            "it is what the technique is for",
            requirement=Requirement.TRANSPARENCY,
        ),
        _image_quality(
            "specular_channels",
            "channels of highlights in a light pre-pass",
            "technique.specular_channels",
            _same(1, 3),
            "coloured lights have coloured highlights",
            reference=FORWARD_SHADING,
            base_settings={**_FORWARD, "technique.name": "light_pre_pass"},
            requirement=Requirement.LOCAL_LIGHTS,
        ),
        _image_quality(
            "light_bits",
            "bits of a channel of light that is added up by blending",
            "technique.light_bits",
            _same(16, 32),
            "half floats are off by more than a level from about 64 lights on a surface",
            reference=FORWARD_SHADING,
            base_settings={**_FORWARD, "technique.name": "deferred"},
            requirement=Requirement.LOCAL_LIGHTS,
        ),
        _image_quality(
            "geometry_normals",
            "bits of each of the two numbers of a normal in a geometry buffer",
            "technique.normal_bits",
            _same(*NORMAL_BITS),
            "8 shift a highlight by a third of a degree, for a word of four to six less",
            reference=PIXEL_CENTRE_RAY,
            base_settings={**_FORWARD, "technique.name": "deferred"},
        ),
        _image_quality(
            "light_cutoff",
            "light of a local light that is too faint to matter, relative to a directional light of "
            "intensity 1",
            "light_cutoff",
            _same(1.0, 0.3, 0.1, 0.03, 0.01, 0.0),
            "lights end where the scene says",
            reference=RAY_TRACED,
            requirement=Requirement.LOCAL_LIGHTS,
        ),
        _image_quality(
            "blending",
            "how transparent surfaces are put together",
            "blending",
            _same(Blending.WEIGHTED, Blending.SORTED),
            "there are seldom enough of them for sorting to matter",
            reference=SORTED_BLENDING,
            requirement=Requirement.TRANSPARENCY,
        ),
        _image_quality(
            "bloom_levels",
            "how often the image is halved for bloom",
            "bloom.levels",
            _same(1, 2, 4, 6, 8),
            "six reach 64 pixels around what shines, and further ones are the cheapest",
            reference=WIDE_BLOOM,
            requirement=Requirement.BLOOM,
        ),
        _image_quality(
            "bloom_karis_average",
            "whether single bright pixels bloom as much as they shine",
            "bloom.karis_average",
            {"on": True, "off": False},
            "far lights are single pixels, which would bloom a quarter as much",
            reference=Reference("all scattered light", {"bloom.karis_average": False}),
            requirement=Requirement.BLOOM,
        ),
        _image_quality(
            "bloom_bits",
            "bits of a channel of light, where some of it blooms",
            "bloom.bits",
            _same(11, 16, 32),
            "half floats are a level off in one pixel of thirty",
            reference=Reference("light of 32 bits", {"bloom.bits": 32}),
            requirement=Requirement.BLOOM,
        ),
        _occlusion(
            "occlusion_slices",
            "slices in which a pixel looks for what takes ambient light",
            "occlusion.slices",
            _same(1, 2, 3, 4, 8),
            "more of them change less than what the screen doesn't show",
        ),
        _occlusion(
            "occlusion_steps",
            "samples of depth on each side of a slice",
            "occlusion.steps",
            _same(1, 2, 4, 6, 8, 16),
            "thin occluders are between the samples if there are fewer",
        ),
        _occlusion(
            "occlusion_smoothing",
            "whether a pixel takes the mean of what 4 × 4 pixels of its surface have found",
            "occlusion.is_smooth",
            {"off": False, "on": True},
            "16 pixels together look along 16 times as many slices",
        ),
        _occlusion(
            "occlusion_bits",
            "bits of the share of ambient light that is left",
            "occlusion.bits",
            _same(8, 16),
            "a level of it is at most a level of the image",
        ),
        _environment(
            "environment_samples",
            "directions that a texel of narrow mirrored lobes is the mean of",
            "environment.samples",
            _same(16, 32, 64, 128, 256, 512),
            "with fewer, the highlights of small bright things have spots",
        ),
        _environment(
            "environment_size",
            "width of the map of mirrored light in texels",
            "environment.size",
            _same(64, 128, 256, 512),
            "a texel of 256 is as wide as the narrowest lobe",
        ),
        _image_quality(
            "focus_samples",
            "pixels that a disc out of focus is the mean of",
            "depth_of_field.samples",
            _same(8, 16, 32, 64, 128, 256),
            "more of them change less than what the image doesn't show",
            reference=PIXEL_CENTRE_RAY,
            requirement=Requirement.FOCUS,
            non_monotonic_reason=_HIDDEN_FROM_IMAGE,
        ),
        _image_quality(
            "focus_radius",
            "the radius of the largest disc out of focus, in heights of the image",
            "depth_of_field.max_radius",
            _same(0.01, 0.02, 0.05, 0.1),
            "larger discs are rare, and take more samples",
            reference=PIXEL_CENTRE_RAY,
            requirement=Requirement.FOCUS,
            non_monotonic_reason=_HIDDEN_FROM_IMAGE,
        ),
        _image_quality(
            "focus_bits",
            "bits of a channel of light, where some of it is out of focus",
            "depth_of_field.bits",
            _same(16, 32),
            "half floats are less than a level off",
            reference=Reference("light of 32 bits", {"depth_of_field.bits": 32}),
            requirement=Requirement.FOCUS,
        ),
        _image_quality(
            "detail_error",
            "pixels by which levels of detail may be off",
            "detail_error",
            _same(8.0, 4.0, 2.0, 1.0, 0.5, 0.0),
            "a bound: in the exam, edges move by a sixth of it",
            reference=FULL_MESHES,
            requirement=Requirement.LEVELS_OF_DETAIL,
        ),
        _image_quality(
            "depth",
            "direction of depth in 32-bit floats",
            "depth",
            _same(Depth.STANDARD, Depth.REVERSED),
            "it costs nothing",
            unit=ErrorUnit.DEPTH,
            reference=FLOAT64,
        ),
        _encoding(
            "depth_format",
            "what holds depth, from 0.1 m to 10 km",
            "",
            {
                "16 bits": "position by a ray, D16",
                "24 bits": "position by a ray, D24",
                "32-bit float": "position by a ray, D32F",
                "32-bit float, reversed": "position by a ray, D32F reversed",
            },
            "it takes as much memory as 24 bits",
            unit=ErrorUnit.DEPTH,
            reference=DISTANCES,
        ),
        _image_quality(
            "animation_step",
            "step of animations in seconds",
            "animation_step",
            {"each 8th frame": 8 / 60, "each 4th": 4 / 60, "each 2nd": 2 / 60, "each frame": 0.0},
            "with half as many steps, motion looks uneven",
            reference=EVERY_FRAME_ANIMATED,
            requirement=Requirement.MOTION,
            history_frames=8,
        ),
        _image_quality(
            "animation_lag",
            "lag allowed for small objects, in pixels",
            "animation_lag",
            _same(8.0, 2.0, 0.5, 0.0),
            "a lag of half a pixel isn't visible",
            reference=EVERY_FRAME_ANIMATED,
            requirement=Requirement.MOTION,
            history_frames=8,
        ),
        _image_quality(
            "hidden_simulations",
            "whether simulations that depend on their history run while hidden",
            "simulates_hidden",
            {"paused": False, "simulated": True},
            "the folds of a cloth that was hidden can't be predicted",
            reference=ALL_SIMULATED,
            base_settings=_SOFTWARE,
            requirement=Requirement.DIVERGING_SIMULATIONS,
            history_frames=60,
        ),
        _cloth(
            "cloth_sub_steps",
            "sub-steps of a step of cloth",
            values=_same(1, 2, 4, 8, 16, 32),
            reason="the period of a swing is exact to 1 %",
            option="sub_steps",
        ),
        _cloth(
            "cloth_rate",
            "steps of cloth a second",
            values=_same(15, 30, 60, 120),
            reason="one step for each frame; sub-steps divide it further",
            option="cloth_rate",
        ),
        _cloth(
            "cloth_detail",
            "parts of a banner between two of its rings",
            values=_same(1, 2, 4, 8),
            reason="finer folds are hardly visible",
            option="cloth_detail",
        ),
        _image_quality(
            "drops",
            "drops of a fountain, one of which is thrown in each step",
            path="",
            reference=LAST_VALUE,
            values=_same(15, 30, 45, 90),
            reason="each drop moves in each frame",
            requirement=Requirement.FOUNTAINS,
            history_frames=96,
            option="drops",
        ),
        _image_quality(
            "second_eye",
            "whether the second eye's image is drawn, or reprojected from the first one's",
            "reprojects",
            {"reprojected": True, "drawn": False},
            "holes show beside everything that is near",
            reference=RENDERED_SECOND_EYE,
            requirement=Requirement.STEREO,
        ),
        _image_quality(
            "far_objects",
            "largest error in pixels of the parallax of objects that are drawn once for both eyes",
            "far_error",
            {"1": 1.0, "0.5": 0.5, "0.25": 0.25, "0.125": 0.125, "none": 0.0},
            "each eye's image is that of its camera, to the bit",
            reference=ALL_FOR_EACH_EYE,
            requirement=Requirement.STEREO,
            non_monotonic_reason="all parallax changes by half a pixel at most, whatever the error is",
        ),
        _lists(
            "tile",
            "width of the tiles of forward+ in pixels",
            "technique.tiles.tile",
            _same(64, 32, 16, 8),
            "smaller tiles take longer to list than they save",
            base_settings={**_FORWARD, "technique.name": "forward_plus"},
        ),
        _lists(
            "cluster_tile",
            "width of clusters in pixels",
            "technique.clusters.tile",
            _same(256, 128, 64, 32),
            "smaller clusters take longer to list than they save",
        ),
        _lists(
            "depth_slices",
            "parts into which clusters divide depth",
            "technique.clusters.slices",
            _same(1, 4, 12, 24, 48),
            "more parts take longer to list than they save",
        ),
        _lists(
            "light_test",
            "the test of lights against clusters",
            "technique.clusters.sphere_test",
            _same("planes", "vertices", "hybrid", "exact"),
            "a fifth more time for the shortest lists",
        ),
        _queries(
            "query_batch",
            "b of CHC++: hidden nodes that one query tests together",
            "visibility.batch",
            _same(200, 50, 20, 5, 1),
            "queries cost more than drawing hidden objects",
            history_frames=_QUERY_HISTORY,
            non_monotonic_reason=_RANDOM_QUERIES,
        ),
        _queries(
            "query_persistence",
            "n of CHC++: frames for which a visible object isn't queried again",
            "visibility.persistence",
            _same(60, 20, 5, 1),
            "visible objects nearly always stay visible",
            history_frames=64,
            non_monotonic_reason=_RANDOM_QUERIES,
        ),
        _queries(
            "leaf_size",
            "objects that are queried and drawn together",
            "visibility.leaf_size",
            _same(32, 16, 4, 1),
            "objects of our scenes are large enough for a query each",
            history_frames=_QUERY_HISTORY,
            non_monotonic_reason="CHC++ draws lots for when nodes are asked about again, "
            "and larger nodes are fewer lots",
        ),
        _image_quality(
            "query_threshold",
            "samples that a box may pass and count as hidden",
            "visibility.threshold",
            _same(1000, 100, 10, 1, 0),
            "no visible object may be missing",
            reference=NO_CULLING,
            base_settings=_CHC,
            history_frames=_QUERY_HISTORY,
        ),
        _queries(
            "occluders",
            "objects that software occlusion draws",
            "visibility.occluders",
            _same(4, 16, 64, 256),
            "smaller objects hide almost nothing",
            base_settings=_SOFTWARE,
        ),
        _image_quality(
            "occluder_pixels",
            "pixels of the image in each direction that are one of software occlusion",
            "visibility.occluder_pixels",
            _same(16, 8, 4, 2, 1),
            "no visible object may be missing",
            reference=NO_CULLING,
            base_settings=_SOFTWARE,
            non_monotonic_reason="a gap stays open if a sample falls into it, which is chance",
        ),
        _queries(
            "pyramid_texels",
            "texels of a depth pyramid in each direction that a box is compared with",
            "visibility.pyramid_texels",
            _same(1, 2, 4, 8, 16),
            "twice as many hide hardly more",
            base_settings={**_FORWARD, "algorithm": "depth_pyramid"},
            history_frames=6,
        ),
        _encoding(
            "normal_bits",
            "bits of each of the two numbers of an octahedral normal",
            "",
            {str(bits): f"octahedral 2 × {bits}, rounded" for bits in (8, 10, 11, 12, 16)},
            "a highlight of 8 bits shows rings",
        ),
        _encoding(
            "normal_rounding",
            "rounding of an octahedral normal of 2 × 12 bits",
            "",
            {name: f"octahedral 2 × 12, {name}" for name in ("truncated", "rounded", "best of 4")},
            "the best of 4 takes longer for less than a bit, and there are bits",
        ),
        _encoding(
            "tangent_packing",
            "the angle of a tangent in 8 bits",
            "",
            {
                "by its cosine": "tangent by the cosine of its angle (Listing 1.6)",
                "around a square": "tangent by its way around a square",
            },
            "equal steps all around",
        ),
        _encoding(
            "derivative_packing",
            "the derivatives of texture coordinates in 48 bits",
            "",
            {
                "by cosines": "derivatives by cosines, halves (Listing 1.5)",
                "around a square": "derivatives by their ways around a square",
            },
            "equal steps all around",
            unit=ErrorUnit.PERCENT,
        ),
    )
}
"""All quality settings by name, in the order of the table."""

_FIXED_DEFAULTS: Final = {
    "depth_format": "position by a ray, D32F reversed",
    "normal_bits": "octahedral 2 × 16, rounded",
    "normal_rounding": "octahedral 2 × 12, rounded",
    "tangent_packing": "tangent by its way around a square",
    "derivative_packing": "derivatives by their ways around a square",
    "cloth_sub_steps": SUB_STEPS,
    "cloth_rate": round(1.0 / INTERVAL),
    "cloth_detail": 4,
    "drops": DROPS,
}
"""Defaults that aren't in `RenderSettings`: encodings of the renderer's shaders, and options of scenes."""

NOT_QUALITY_SETTINGS: Final[Mapping[str, str]] = {
    "technique.name": "images differ by rounding; `compare techniques`",
    "technique.all_lights": "the same light, found without lists",
    "technique.lights_per_draw": "the same light, added up in another order",
    "technique.light_volumes": "the same lights, of surfaces that `deferred` stores: `compare techniques`",
    "technique.stencil": "the same lights at the same pixels in another way",
    "technique.tiled_transparency": "the same lights, found by tiles instead of objects",
    "technique.depth_first": "the same pixels without what is hidden",
    "technique.multi_pass": "the same pixels in another order",
    "technique.object_rectangles": "the same pixels in another order",
    "technique.binned": "the same pixels in another order",
    "technique.tiled": "the same lights, found by tiles instead of clusters",
    "algorithm": "images are the same; `compare visibility`",
    "technique.tiles.slices": "tiles end at the surfaces that they show",
    "technique.tiles.sphere_test": "as that of clusters, which is a quality setting",
    "visibility.emulated": "the same query results in another way",
    "visibility.meshlets": "the same pixels without triangles that aren't seen",
    "visibility.proxy_planes": "the same pixels, of objects that are tested as other polytopes",
    "shadows.split": "divides the same texels between near and far",
    "shadows.min_size": "maps that small are of lights that light a few pixels",
    "shadows.max_atlas_size": "a limit of memory, which shrinks maps beyond it",
    "shadows.far_size": "what counts as far for `shadow_budget`",
    "shadows.contact_length": "rays that are too long cross what is hidden",
    "shadows.contact_thickness": "that of the scene's small things, which an image doesn't show",
    "shadows.back_faces": "moves what isn't exact from lit faces to dark ones",
}
"""The settings that aren't quality settings, and why: no order of their values is one of accuracy and of
time."""


def lookup_quality_setting(name: str, call: str) -> QualitySetting:
    """Look up a quality setting by name; refuses others by `accuracy-unknown-setting`."""
    if name not in QUALITY_SETTINGS:
        rules.refuse_name(rules.UNKNOWN_QUALITY_SETTING, call, name, QUALITY_SETTINGS)
    return QUALITY_SETTINGS[name]
