"""The registry of knobs: every choice of the renderer that trades accuracy for time.

A knob sets nothing by itself: it names a setting of `RenderSettings` by its path, and some of its values in order, the
least accurate first. With that go the truth that it is judged by, the unit of its error, and what it needs to matter:
other settings (`within`) and something in the scene (`demand`). Another knob is one entry of `KNOBS`; the sweep, the
table, the choice of settings and the tests find it there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import partial
from typing import Any, Final

from renderer import rules
from renderer.content.fountains import DROPS
from renderer.frame import Blending, GlowSettings, TextureSettings
from renderer.scene import Depth
from renderer.scene.cloth.sheets import INTERVAL, SUB_STEPS
from renderer.settings import RenderSettings
from renderer.shadows import ShadowFilter
from renderer.techniques.parts.geometry_buffer import NORMAL_BITS
from rhi import Filter
from rhi.shading import Precision


class Unit(Enum):
    """The unit of an error."""

    LEVELS = "levels of 255"
    """The distance of a pixel from that of the truth: its worst channel, in sRGB."""
    DEPTH = "millionths of the distance"
    """The distance of the place that a pixel's depth leads back to, in that of the surface."""
    LIGHTS = "lights too many"
    """The lights that a pixel's shaders look at beside those that reach its surface: a mean over the picture."""
    OVERDRAW = "% too many triangles"
    """The share by which more triangles are drawn than the objects have of which a pixel is seen."""
    DEGREES = "degrees"
    """The angle between a vector and what is read of it."""
    PERCENT = "%"
    """The length of the difference between a vector and what is read of it, in that of the vector."""

    @property
    def is_per_pixel(self) -> bool:
        """Whether each pixel has an error."""
        return self in (Unit.LEVELS, Unit.DEPTH)


class Demand(Enum):
    """The part of a scene without which a knob doesn't matter."""

    SHADOWS = "a light that may cast shadows"
    TRANSPARENCY = "a transparent object"
    IMAGES = "an image"
    LAMPS = "a point or spot light"
    GLOW = "an object that emits more light than a white surface reflects"
    STEREO = "a second eye"
    MOTION = "something that moves by itself"
    HISTORY = "something that an absence would change"
    CLOTH = "a cloth"
    FOUNTAINS = "a fountain"
    HEIGHT_FIELDS = "a height field whose limit holds all of its triangles"
    RIDGES = "a height field that may cast shadows, and whose limit holds all of its triangles"


@dataclass(frozen=True, slots=True)
class Truth:
    """The reference that a value is judged by: a picture of other settings, or what is found in another way.

    Attributes:
        name: what it is, in a few words. changes: settings that its picture has instead of the value's.
        scale: how many times as wide and high its picture is, from whose light the mean of each pixel is taken.
        rays: along each side of a pixel by which the judge draws it; 0 if a renderer does. `changes` and `scale` are
            then what a renderer has that comes nearest: combined knobs, which are compared in many views, have that.
        is_float64: whether it is computed in float64 from the triangles that were drawn.
    """

    name: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    scale: int = 1
    is_float64: bool = False
    rays: int = 0


@dataclass(frozen=True, slots=True)
class Knob:
    """A choice between accuracy and time.

    Attributes:
        about: what it decides. path: the setting, as `RenderSettings.get` finds it; empty for an encoding, which
            shaders have for good, and for an option of generated scenes. values: by how tables call them, the least
            accurate first.
        because: why we chose the default.
        unit: of the error. truth: what values are judged by.
        within: settings under which it matters. demand: what it needs in the scene.
        remembers: the number of earlier frames that a frame depends on, which are drawn before the first that counts; 0
            if frames needn't follow each other.
        exception: why errors needn't fall from each value to the next; empty where they must.
        option: of a generated scene. Each value has a scene of its own, and that of the last one is the truth.
    """

    name: str
    about: str
    path: str
    values: Mapping[str, Any]
    because: str
    unit: Unit
    truth: Truth
    within: Mapping[str, Any] = field(default_factory=dict)
    demand: Demand | None = None
    remembers: int = 0
    exception: str = ""
    option: str = ""

    @property
    def is_encoding(self) -> bool:
        """Whether values are encodings, which shaders have for good."""
        return not (self.path or self.option)

    @property
    def default(self) -> str | None:
        """The name of the value that settings have by default; None if it isn't among the values."""
        if not self.path:
            return next((name for name, chosen in self.values.items() if chosen == _CHOSEN.get(self.name)), None)
        value = RenderSettings().get(self.path)
        return next((name for name, one in self.values.items() if one == value), None)

    def set(self, settings: RenderSettings, value: str) -> RenderSettings:
        """Return settings with a value, by its name in tables, and with what makes the knob matter."""
        settings = settings.change_all(self.within)
        return settings.change(self.path, self.values[value]) if self.path else settings


def _same(*values: Any) -> dict[str, Any]:
    return {(str(value).lower() if not isinstance(value, Enum) else value.value): value for value in values}


FLOAT64: Final = Truth("float64", is_float64=True)
TRACED: Final = Truth("rays in float64, 16 a pixel", rays=4)
SUPER_SAMPLED: Final = replace(
    TRACED,
    changes={"technique.samples": 1, "technique.fxaa": False, "textures": TextureSettings(anisotropy=16.0)},
    scale=4,
)
FORWARD: Final = replace(TRACED, changes={"technique.name": "forward"})
EVERYTHING: Final = Truth("no culling", {"algorithm": "none"})
CENTRED: Final = Truth("a ray in float64 through the middle of each pixel", rays=1)
"""Of what moves edges: with one sample a pixel, coarse maps and moved pixels blur edges as more samples would."""
FINE_MAPS: Final = replace(
    CENTRED,
    changes={
        "shadows.largest_atlas": 8192,
        "shadows.cascade_size": 2048,
        "shadows.cascades": 6,
        "shadows.largest": 2048,
        "shadows.filter": ShadowFilter.SMOOTH,
        "shadows.bias": 1.0,
        "shadows.budget": 512,
    },
)
IN_RANGE: Final = Truth("the lights that reach each pixel, in float64")
SEEN: Final = Truth("the objects of which a pixel is seen")
FILTERED: Final = replace(FINE_MAPS, name=TRACED.name, rays=4)
FAR_SHADOWS: Final = replace(FINE_MAPS, changes={**FINE_MAPS.changes, "shadows.distance": 1000.0})
SORTED: Final = replace(TRACED, changes={"blending": Blending.SORTED})
FAR_GLOW: Final = Truth("all scattered light, spread over 8 levels", {"glow": GlowSettings(levels=8)})
FINEST: Final = replace(TRACED, changes={"tessellation.edge_pixels": 0.01})
EACH_FRAME: Final = Truth("motion in each frame", {"animation_step": 0.0, "animation_lag": 0.0})
DISTANCES: Final = Truth("the distances in float64")
SECOND_EYE: Final = replace(CENTRED, changes={"reprojects": False})
VECTORS: Final = Truth("the vectors in float64")
UNSEEN: Final = Truth("everything simulated in each frame", {"simulates_unseen": True})
FINEST_STEPS: Final = Truth("the scene with the last value")

_FORWARD: Final = {"technique.name": "forward", "algorithm": "frustum"}
_ROOM: Final = {**_FORWARD, "shadows.largest_atlas": 8192}
_LOTS: Final = "CHC++ draws lots for when an object is asked about again, so neighbours may change places"
_CHC: Final = {**_FORWARD, "algorithm": "chc_plus_plus"}
_ASKED: Final = 24
"""Frames after which CHC++ has asked about all that was visible in the first, when everything in view is drawn."""
_SOFTWARE: Final = {**_FORWARD, "algorithm": "software_depth"}

_INFERRED: Final = {**_FORWARD, "technique.name": "inferred"}
_CLUSTERED: Final = {**_FORWARD, "technique.name": "clustered"}

# Knobs by what they are judged by and where they matter.
_picture: Final = partial(Knob, unit=Unit.LEVELS, within=_FORWARD)
_shadows: Final = partial(Knob, unit=Unit.LEVELS, truth=FINE_MAPS, within=_ROOM, demand=Demand.SHADOWS)
_inferred: Final = partial(Knob, unit=Unit.LEVELS, truth=FORWARD, within=_INFERRED)
_lists: Final = partial(Knob, unit=Unit.LIGHTS, truth=IN_RANGE, within=_CLUSTERED, demand=Demand.LAMPS)
_queries: Final = partial(Knob, unit=Unit.OVERDRAW, truth=SEEN, within=_CHC)
_FOLDS: Final = "cloth falls into other folds after the least of changes, and then all are as wrong"
_cloth: Final = partial(_picture, path="", truth=FINEST_STEPS, demand=Demand.CLOTH, remembers=20, exception=_FOLDS)
_encoding: Final = partial(Knob, unit=Unit.DEGREES, truth=VECTORS)

KNOBS: Final[dict[str, Knob]] = {
    knob.name: knob
    for knob in (
        _picture(
            "precision",
            "how exact functions such as pow are in shaders (OpenCL; GL has one way)",
            "precision",
            _same(Precision.FAST, Precision.EXACT),
            "a picture of 8 bits shows nothing of what EXACT adds",
            truth=FLOAT64,
        ),
        _picture(
            "samples",
            "samples a pixel",
            "technique.samples",
            _same(1, 2, 4, 8),
            "only forward, forward_plus, clustered and the deferred ones with lists have more than one",
            truth=SUPER_SAMPLED,
        ),
        _picture(
            "scale",
            "the size at which frames are drawn, in that of the image",
            "scale",
            _same(0.25, 0.5, 0.75, 1.0, 2.0),
            "what is smaller than a pixel that is drawn can't be shown",
            truth=SUPER_SAMPLED,
        ),
        _picture(
            "fxaa",
            "whether edges are smoothed in the image",
            "technique.fxaa",
            {"off": False, "on": True},
            "it also blurs what isn't an edge",
            truth=SUPER_SAMPLED,
            exception="edges come nearer to the truth, and texels as bright as an edge go away from it",
        ),
        _picture(
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
            truth=SUPER_SAMPLED,
            demand=Demand.IMAGES,
            exception="mip levels blur what lies at an angle more than the largest one flickers, "
            "which single pictures don't show",
        ),
        _picture(
            "mip_bias",
            "levels that are added to the mip level of textures",
            "textures.mip_bias",
            _same(2.0, 1.0, 0.5, 0.0, -0.5, -1.0),
            "images' own samplers ask for it; from -1 on, what is sharper flickers more",
            truth=SUPER_SAMPLED,
            demand=Demand.IMAGES,
        ),
        _picture(
            "edge_pixels",
            "length of the edges of a ground's triangles in pixels",
            "tessellation.edge_pixels",
            _same(32.0, 16.0, 8.0, 4.0, 2.0),
            "outlines are off by less than a pixel nearly everywhere",
            truth=FINEST,
            demand=Demand.HEIGHT_FIELDS,
        ),
        _picture(
            "unseen_edges",
            "length of the edges of a ground's triangles out of view, in that of those in view",
            "tessellation.unseen",
            _same(64.0, 16.0, 8.0, 4.0, 1.0),
            "only their shadows are seen",
            truth=FINEST,
            within=_ROOM,
            demand=Demand.RIDGES,
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
            "from four on the nearest map is as fine as the picture",
        ),
        _shadows(
            "shadow_distance",
            "how far from the eye there are shadows, in metres",
            "shadows.distance",
            _same(50.0, 125.0, 250.0, 500.0),
            "beyond it a shadow is a few pixels, and near ones would be coarser",
            truth=FAR_SHADOWS,
            exception="the same texels are spread over more, so near shadows are coarser; far ones are few pixels",
        ),
        _shadows(
            "shadow_filter",
            "texels of a map that a pixel is compared with: 1, 4, 12, 16",
            "shadows.filter",
            _same(ShadowFilter.HARD, ShadowFilter.HARDWARE, ShadowFilter.POISSON, ShadowFilter.SMOOTH),
            "no steps, and no noise that moves with the eye",
            truth=FILTERED,
            exception="the truth has sharp edges, and a filter trades steps for blur: of these the eye sees steps",
        ),
        _shadows(
            "shadow_bias",
            "what keeps surfaces from shading themselves, in what texels and angles call for",
            "shadows.bias",
            _same(0.0, 0.5, 1.0),
            "without it surfaces shade themselves, and it costs nothing",
        ),
        _shadows(
            "lamp_shadow_size",
            "largest width of a lamp's map in texels",
            "shadows.largest",
            _same(32, 64, 128, 256, 512, 1024),
            "a map is drawn once, and as wide as what it lights on the screen",
        ),
        _shadows(
            "shadow_budget",
            "maps of far lamps that are drawn again in a frame",
            "shadows.budget",
            _same(1, 2, 8, 32),
            "what moves far away may be late by some frames",
            remembers=6,
        ),
        _inferred(
            "inferred_scale",
            "size of the light buffers of inferred lighting, in that of the image",
            "technique.scale",
            _same(0.3, 0.4, 0.6, 0.8, 1.0),
            "a third of the pixels, and edges that are seldom seen to be wrong",
            demand=Demand.LAMPS,
            exception="0.8 may lose to 0.6, since its texels lie differently between the picture's",
        ),
        _inferred(
            "inferred_transparency",
            "whether transparent surfaces are lit in stippled light buffers, or by their objects' lights",
            "technique.stippled",
            {"stippled": True, "by lists": False},
            "it is what the technique is for",
            demand=Demand.TRANSPARENCY,
        ),
        _picture(
            "specular_channels",
            "channels of highlights in a light pre-pass",
            "technique.specular_channels",
            _same(1, 3),
            "coloured lamps have coloured highlights",
            truth=FORWARD,
            within={**_FORWARD, "technique.name": "light_pre_pass"},
            demand=Demand.LAMPS,
        ),
        _picture(
            "light_bits",
            "bits of a channel of light that is added up by blending",
            "technique.light_bits",
            _same(16, 32),
            "half floats are off by more than a level from about 64 lights on a surface",
            truth=FORWARD,
            within={**_FORWARD, "technique.name": "deferred"},
            demand=Demand.LAMPS,
        ),
        _picture(
            "geometry_normals",
            "bits of each of the two numbers of a normal in a geometry buffer",
            "technique.normal_bits",
            _same(*NORMAL_BITS),
            "8 shift a highlight by a third of a degree, for a word of four to six less",
            truth=CENTRED,
            within={**_FORWARD, "technique.name": "deferred"},
        ),
        _picture(
            "light_cutoff",
            "light of a lamp that is too faint to matter, in that of a directional light of intensity 1",
            "light_cutoff",
            _same(1.0, 0.3, 0.1, 0.03, 0.01, 0.0),
            "lamps end where the scene says",
            truth=TRACED,
            demand=Demand.LAMPS,
        ),
        _picture(
            "blending",
            "how transparent surfaces are put together",
            "blending",
            _same(Blending.WEIGHTED, Blending.SORTED),
            "there are seldom enough of them for sorting to matter",
            truth=SORTED,
            demand=Demand.TRANSPARENCY,
        ),
        _picture(
            "glow_levels",
            "how often the image is halved to spread glow",
            "glow.levels",
            _same(1, 2, 4, 6, 8),
            "six reach 64 pixels around what shines, and further ones are the cheapest",
            truth=FAR_GLOW,
            demand=Demand.GLOW,
        ),
        _picture(
            "glow_sparks",
            "whether single bright pixels glow as much as they shine",
            "glow.tames_sparks",
            {"tamed": True, "as they are": False},
            "far lamps are single pixels, which would glow a quarter as much",
            truth=Truth("all scattered light", {"glow.tames_sparks": False}),
            demand=Demand.GLOW,
        ),
        _picture(
            "glow_bits",
            "bits of a channel of light, where some of it glows",
            "glow.bits",
            _same(11, 16, 32),
            "half floats are a level off in one pixel of thirty",
            truth=Truth("light of 32 bits", {"glow.bits": 32}),
            demand=Demand.GLOW,
        ),
        _picture(
            "depth",
            "direction of depth in 32-bit floats",
            "depth",
            _same(Depth.STANDARD, Depth.REVERSED),
            "it costs nothing",
            unit=Unit.DEPTH,
            truth=FLOAT64,
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
            unit=Unit.DEPTH,
            truth=DISTANCES,
        ),
        _picture(
            "animation_step",
            "seconds after which what moves by itself moves on",
            "animation_step",
            {"each 8th frame": 8 / 60, "each 4th": 4 / 60, "each 2nd": 2 / 60, "each frame": 0.0},
            "half as many steps are seen to be uneven",
            truth=EACH_FRAME,
            demand=Demand.MOTION,
            remembers=8,
        ),
        _picture(
            "animation_lag",
            "pixels by which what is small on the screen may be late",
            "animation_lag",
            _same(8.0, 2.0, 0.5, 0.0),
            "what is late by half a pixel isn't seen to be",
            truth=EACH_FRAME,
            demand=Demand.MOTION,
            remembers=8,
        ),
        _picture(
            "unseen",
            "whether what an absence would change is simulated where it isn't drawn",
            "simulates_unseen",
            {"at rest": False, "simulated": True},
            "nobody knows in which folds a cloth would have come back",
            truth=UNSEEN,
            within=_SOFTWARE,
            demand=Demand.HISTORY,
            remembers=60,
        ),
        _cloth(
            "cloth_sub_steps",
            "sub-steps of a step of cloth",
            values=_same(1, 2, 4, 8, 16, 32),
            because="a period is right to a hundredth",
            option="sub_steps",
        ),
        _cloth(
            "cloth_step",
            "steps of cloth a second",
            values=_same(15, 30, 60, 120),
            because="one for each frame; smaller parts of it are sub-steps",
            option="cloth_rate",
        ),
        _cloth(
            "cloth_grid",
            "parts of a banner between two of its rings",
            values=_same(1, 2, 4, 8),
            because="finer folds are hardly seen",
            option="cloth_detail",
        ),
        _picture(
            "drops",
            "drops of a fountain, one of which is thrown in each step",
            path="",
            truth=FINEST_STEPS,
            values=_same(15, 30, 45, 90),
            because="a drop moves on in each frame",
            demand=Demand.FOUNTAINS,
            remembers=96,
            option="drops",
        ),
        _picture(
            "second_eye",
            "whether the second eye's picture is drawn, or made of the first one's",
            "reprojects",
            {"reprojected": True, "drawn": False},
            "holes show beside everything that is near",
            truth=SECOND_EYE,
            demand=Demand.STEREO,
        ),
        _lists(
            "tile",
            "width of the tiles of forward+ in pixels",
            "technique.tiles.tile",
            _same(64, 32, 16, 8),
            "smaller tiles take longer to list than they save",
            within={**_FORWARD, "technique.name": "forward_plus"},
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
            "b of CHC++: hidden nodes that one query asks about together",
            "visibility.batch",
            _same(200, 50, 20, 5, 1),
            "queries cost more than what is drawn for nothing",
            remembers=_ASKED,
            exception=_LOTS,
        ),
        _queries(
            "query_persistence",
            "n of CHC++: frames for which a visible object isn't asked about",
            "visibility.persistence",
            _same(60, 20, 5, 1),
            "what was visible nearly always still is",
            remembers=64,
            exception=_LOTS,
        ),
        _queries(
            "leaf_size",
            "objects that are queried and drawn together",
            "visibility.leaf_size",
            _same(32, 16, 4, 1),
            "objects of our scenes are large enough for a query each",
            remembers=_ASKED,
            exception="CHC++ draws lots for when nodes are asked about again, and larger nodes are fewer lots",
        ),
        _picture(
            "query_threshold",
            "samples that a box may pass and count as hidden",
            "visibility.threshold",
            _same(1000, 100, 10, 1, 0),
            "nothing that is seen may be missing",
            truth=EVERYTHING,
            within=_CHC,
            remembers=_ASKED,
        ),
        _queries(
            "occluders",
            "objects that software occlusion draws",
            "visibility.occluders",
            _same(4, 16, 64, 256),
            "what is smaller hides next to nothing",
            within=_SOFTWARE,
        ),
        _picture(
            "occluder_pixels",
            "pixels of the image in each direction that are one of software occlusion",
            "visibility.occluder_pixels",
            _same(16, 8, 4, 2, 1),
            "nothing that is seen may be missing",
            truth=EVERYTHING,
            within=_SOFTWARE,
            exception="a gap stays open if a sample falls into it, which is chance",
        ),
        _queries(
            "pyramid_texels",
            "texels of a depth pyramid in each direction that a box is compared with",
            "visibility.pyramid_texels",
            _same(1, 2, 4, 8, 16),
            "twice as many hide hardly more",
            within={**_FORWARD, "algorithm": "depth_pyramid"},
            remembers=6,
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
            unit=Unit.PERCENT,
        ),
    )
}
"""All knobs by name, in the order of the table."""

_CHOSEN: Final = {
    "depth_format": "position by a ray, D32F reversed",
    "normal_bits": "octahedral 2 × 16, rounded",
    "normal_rounding": "octahedral 2 × 12, rounded",
    "tangent_packing": "tangent by its way around a square",
    "derivative_packing": "derivatives by their ways around a square",
    "cloth_sub_steps": SUB_STEPS,
    "cloth_step": round(1.0 / INTERVAL),
    "cloth_grid": 4,
    "drops": DROPS,
}
"""The encodings that the renderer's shaders have, or the kind of rounding; and the options that scenes have."""

NEUTRAL: Final[Mapping[str, str]] = {
    "technique.name": "pictures differ by rounding; `compare techniques`",
    "technique.all_lights": "the same light, found without lists",
    "technique.stencil": "the same lights at the same pixels in another way",
    "technique.depth_first": "the same pixels without what is hidden",
    "technique.multi_pass": "the same pixels in another order",
    "technique.binned": "the same pixels in another order",
    "algorithm": "pictures are the same; `compare visibility`",
    "technique.tiles.slices": "tiles end at the surfaces that they show",
    "technique.tiles.sphere_test": "as that of clusters, which is a knob",
    "visibility.emulated": "the same answers in another way",
    "shadows.split": "divides the same texels between near and far",
    "shadows.smallest": "maps that small are of lamps that light a few pixels",
    "shadows.largest_atlas": "a limit of memory, which shrinks maps beyond it",
    "shadows.far_size": "what counts as far for `shadow_budget`",
    "shadows.back_faces": "moves what isn't exact from lit faces to dark ones",
}
"""The settings that are no knobs, and why: no order of their values is one of accuracy and of time."""


def find_knob(name: str, call: str) -> Knob:
    """Return a knob by its name, or refuse it: `accuracy-unknown-knob`."""
    if name not in KNOBS:
        rules.refuse_name(rules.UNKNOWN_KNOB, call, name, KNOBS)
    return KNOBS[name]
