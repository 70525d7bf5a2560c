"""Inspections: techniques that show what a frame is made of instead of its light.

- `normals`: the direction of each surface, from -1…1 to 0…1 along the axes of the world.
- `depth`: the distance from the eye, from 0.1 m (white) to 1 km (black), equal steps for equal ratios.
- `lights`: the number of point and spot lights whose range holds each surface, in Thatcher's seven colours
  (table 4): black 0, blue 1 to 7, cyan to 15, green to 31, yellow to 63, red to 127, white 128 and more.
- `overdraw`: the number of fragments that were drawn to each pixel, one on top of the other, in the same
  colours: black 0, blue 1, cyan 2 and 3, green to 7, yellow to 15, red to 31, white 32 and more.
- `tiles`, `clusters`: the number of lights in the list of each tile of `forward_plus`, or of the cluster of
  `clustered` that each surface is in, in the colours of `lights`, with lines between tiles, over the lit
  scene, which shows through. They are those of the settings.
- `tessellation`: the lit scene, and the edges of the triangles of its tessellated surfaces, or of all if it has
  none.
- `volumes`: the lit scene, and the volumes of its lights, each in a colour of its own, in front of what they
  reach. Their colours are added up in floats, and their mean is laid over the scene, which is so seen through
  hundreds.

Other images are those of a technique's own buffers (`ResourceCapture`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

import rhi.shading as sl
from renderer import rules
from renderer.frame import DEPTH_FORMAT, IMAGE_FORMAT, Frame, FrameEffects, FramePass, Target, last_version
from renderer.frame.drawing import NEARER
from renderer.light_kinds.generation import define, for_each_kind
from renderer.lights.culling.cells import ClusterGrid, cell_index
from renderer.shaders.lighting import in_range
from renderer.shaders.pixels import BackgroundScreen, depth_to_nearness, nearness_to_distance, pixel_position
from renderer.shaders.structs import SurfacePoint, SurfaceVarying, Vertex
from renderer.techniques.parts.depth import depth_pass
from renderer.techniques.parts.finish import forward_passes
from renderer.techniques.parts.light_list_reader import (
    CLUSTERS,
    TILES,
    ClusterSettings,
    bind_light_lists,
    light_list_pass,
)
from renderer.techniques.parts.light_volumes import VolumeShader, VolumeVarying, draw_volumes
from renderer.techniques.parts.resolve import DEFAULT_LIGHT_BITS, SUM_FORMATS
from renderer.techniques.parts.scene_shader import LocalLightShader, SceneShader, SurfaceShader
from renderer.techniques.parts.variants import (
    COVERAGE,
    draw_full_screen,
    local_light_effects,
    make_scene_drawer,
)
from rhi import BlendFunction, CullMode, DepthWrite, Format, PolygonMode, State, refuse

CELLS: Final = {"tiles": TILES, "clusters": CLUSTERS}
"""The tiles and clusters of the inspections of these names, which are settings of techniques, too."""
_DECADES: Final = 13.28771  # log2 of 10,000: from 0.1 m to 1 km
_OPACITY: Final = 0.3  # of cells
_VOLUME_OPACITY, _MAX_OPACITY = 0.06, 0.6  # of a volume, and of as many as there may be


@sl.function
def heat_color(count: float, first: float) -> sl.vec3:
    """Colour of a count: 0 is black, below `first` blue, then another colour each time the count doubles."""
    if count < 0.5:
        return sl.vec3(0.0)
    if count < first - 0.5:
        return sl.vec3(0.0, 0.0, 1.0)
    if count < 2.0 * first - 0.5:
        return sl.vec3(0.0, 1.0, 1.0)
    if count < 4.0 * first - 0.5:
        return sl.vec3(0.0, 1.0, 0.0)
    if count < 8.0 * first - 0.5:
        return sl.vec3(1.0, 1.0, 0.0)
    if count < 16.0 * first - 0.5:
        return sl.vec3(1.0, 0.0, 0.0)
    return sl.vec3(1.0)


class NormalColors(SceneShader):
    """Shows normals."""

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        return sl.vec4(self.evaluate(self.surface_input(v)).normal * 0.5 + 0.5, 1.0)


class EdgeColors(SceneShader):
    """Shows the edges of triangles, moved 0.1 % towards the eye."""

    is_coverage = True

    def transform(self, v: Vertex, uv2: sl.vec2, tangent: sl.vec4, color: sl.vec4) -> SurfaceVarying:
        result = super().transform(v, uv2, tangent, color)
        result.clip = self.view.relative_view_projection @ sl.vec4(0.999 * result.position, 1.0)
        return result

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        self.discard_masked(self.surface_input(v))
        return sl.vec4(0.0, 0.0, 0.0, 1.0)


class LightCountSurface(SurfaceShader, LocalLightShader):
    """Shows the number of lights in range, counted by `LightCountColors`."""

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        surface = self.evaluate_surface(v, self.materials[v.material])
        return sl.vec4(heat_color(self.shade_local_lights(surface, v.lights).x, 8.0), 1.0)


LightCountColors: Final = define(
    "class LightCountColors(LightCountSurface):"
    + for_each_kind(
        """
    def shade_${kind}_light(self, surface: SurfacePoint, light_index: int) -> sl.vec3:
        light = self.${kind}_lights[light_index]
        return sl.vec3(1.0) if in_range(surface, light.position, light.range) else sl.vec3(0.0)
"""
    ),
    "LightCountColors",
    __name__,
    LightCountSurface=LightCountSurface,
    SurfacePoint=SurfacePoint,
    in_range=in_range,
    sl=sl,
)
"""Shows the number of lights in range: counts them instead of adding up their light."""


class OneFragment(SceneShader):
    """Adds 1 for each fragment."""

    is_coverage = True

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        self.discard_masked(self.surface_input(v))
        return sl.vec4(1.0)


class FragmentCounts(BackgroundScreen):
    """Shows the number of fragments per pixel."""

    fragments: sl.Texture2D

    def fragment(self) -> sl.vec4:
        count = self.fragments.load(sl.ivec2(sl.fragment_coordinate().xy)).x
        return sl.vec4(heat_color(count, 2.0), 1.0)


class Distances(BackgroundScreen):
    """Shows the distance from the eye."""

    depth: sl.Texture2D

    def fragment(self) -> sl.vec4:
        pixel = sl.fragment_coordinate().xy
        nearness = depth_to_nearness(self.rays, self.depth.load(sl.ivec2(pixel)).x)
        if nearness == 0.0:
            return sl.vec4(0.0, 0.0, 0.0, 1.0)
        away = sl.length(pixel_position(self.rays, pixel, nearness_to_distance(self.rays, nearness)))
        shade = sl.saturate(1.0 - sl.log2(sl.max(away, 0.1) * 10.0) / _DECADES)
        return sl.vec4(sl.vec3(shade * shade), 1.0)  # about even to the eye


class CellCounts(BackgroundScreen):
    """Shows the length of the light list of each surface's tile or cluster. With one slice, the background
    belongs to its tile."""

    grid: sl.Uniform[ClusterGrid]
    light_list: sl.Storage[int]
    depth: sl.Texture2D

    def fragment(self) -> sl.vec4:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        distance = 0.0
        if self.grid.count.z > 1:
            nearness = depth_to_nearness(self.rays, self.depth.load(pixel).x)
            if nearness == 0.0:
                return sl.vec4(0.0)
            distance = nearness_to_distance(self.rays, nearness)
        cell = cell_index(self.grid, pixel, distance)
        color = heat_color(float(self.light_list[2 * cell + 2] - self.light_list[2 * cell]), 8.0)
        if pixel.x % self.grid.tile == 0 or pixel.y % self.grid.tile == 0:
            color = sl.mix(color, sl.vec3(0.2), 0.5)
        return sl.vec4(color, _OPACITY)


class VolumeColors(VolumeShader):
    """Adds up the colours of the volumes of lights, and their number."""

    def fragment(self, v: VolumeVarying) -> sl.vec4:
        turns = 6.2831853 * (0.61803399 * float(v.light) + sl.vec3(0.0, 1.0 / 3.0, 2.0 / 3.0))
        return sl.vec4(0.5 + 0.4 * sl.cos(turns), 1.0)


class MeanVolume(BackgroundScreen):
    """Blends the mean of `VolumeColors` over the image."""

    volumes: sl.Texture2D

    def fragment(self) -> sl.vec4:
        added = self.volumes.load(sl.ivec2(sl.fragment_coordinate().xy))
        opacity = _MAX_OPACITY * (1.0 - sl.exp(-added.w * (_VOLUME_OPACITY / _MAX_OPACITY)))
        return sl.vec4(added.rgb / sl.max(added.w, 1.0), opacity)


class Inspection:
    """Draws one of `INSPECTIONS` instead of the lit scene."""

    def __init__(self, name: str, cells: ClusterSettings | None = None) -> None:
        """`name` is one of `INSPECTIONS`; `cells` are the tiles or clusters of `tiles` and `clusters`, by
        default those of `CELLS`."""
        self.name = name
        self.cells = cells or CELLS.get(name, TILES)

    @property
    def is_lit(self) -> bool:
        """True if the lit scene is visible as well, so that shadow maps must be up to date."""
        return self.name in _LIT

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The passes that draw the inspection."""
        return INSPECTIONS[self.name](effects, self.cells)


def _draw(
    frame: Frame,
    shader: type[SceneShader],
    resource: str = "image",
    *states: State,
    switches: Mapping[str, bool] = {},
) -> None:
    """Draw the visible objects over black."""
    color, clear = frame.targets[resource], (0.0, 0.0, 0.0, 1.0)
    frame.draw_visible(
        make_scene_drawer(frame, shader, switches=switches, color=color, clear=clear, states=states)
    )


def _draw_fragments(frame: Frame) -> None:
    _draw(frame, OneFragment, "fragments", BlendFunction.ADDITIVE, switches=COVERAGE)


def _show(frame: Frame, shader: type[BackgroundScreen]) -> None:
    draw_full_screen(frame, shader, frame.targets["image"])


def _blend_over(
    frame: Frame, shader: type[BackgroundScreen], shader_bindings: Mapping[str, Any] = {}
) -> None:
    """Blend the shader's colour over the image, by its alpha."""
    draw_full_screen(frame, shader, frame.targets["image"], shader_bindings, states=(BlendFunction.ALPHA,))


_IMAGE: Final = Target("image", IMAGE_FORMAT)
_DEPTH: Final = Target("depth", DEPTH_FORMAT)
_REASON: Final = "was asked for"

_PLAIN: Final[dict[str, tuple[FramePass[Frame], ...]]] = {
    "normals": (FramePass("normals", partial(_draw, shader=NormalColors), _REASON, writes=(_IMAGE, _DEPTH)),),
    "depth": (
        depth_pass("finds the nearest surfaces"),
        FramePass("distances", partial(_show, shader=Distances), _REASON, reads=("depth",), writes=(_IMAGE,)),
    ),
    "lights": (
        FramePass("lights", partial(_draw, shader=LightCountColors), _REASON, writes=(_IMAGE, _DEPTH)),
    ),
    "overdraw": (
        FramePass(
            "fragments",
            _draw_fragments,
            "counts fragments",
            writes=(Target("fragments", Format.R16F), _DEPTH),
        ),
        FramePass(
            "overdraw", partial(_show, shader=FragmentCounts), _REASON, reads=("fragments",), writes=(_IMAGE,)
        ),
    ),
}


def _declare_plain(name: str, effects: FrameEffects, cells: ClusterSettings) -> tuple[FramePass[Frame], ...]:
    return _PLAIN[name]


def _declare_cells(effects: FrameEffects, cells: ClusterSettings) -> tuple[FramePass[Frame], ...]:
    passes = forward_passes(effects)
    if not local_light_effects(effects):
        return passes
    # As the techniques that have them: tiles end at surfaces, clusters are made without.
    lists = light_list_pass(effects, cells, depth="depth" if cells.slices == 1 else None)
    show, last = partial(_show_cells, cells=cells), last_version(passes, "image")
    return (
        *passes,
        lists,
        FramePass("cells", show, _REASON, ("light lists", "depth"), changes={last: "image with cells"}),
    )


def _show_cells(frame: Frame, *, cells: ClusterSettings) -> None:
    _blend_over(frame, CellCounts, bind_light_lists(frame, cells))


def _declare_volumes(effects: FrameEffects, cells: ClusterSettings) -> tuple[FramePass[Frame], ...]:
    passes = forward_passes(effects)
    if not local_light_effects(effects):
        return passes
    sums = Target("volumes", SUM_FORMATS[DEFAULT_LIGHT_BITS])
    added = FramePass("volumes", _add_volumes, _REASON, ("depth",), (sums,))
    show, last = partial(_blend_over, shader=MeanVolume), last_version(passes, "image")
    return (
        *passes,
        added,
        FramePass("mean volume", show, _REASON, ("volumes",), changes={last: "image with volumes"}),
    )


def _add_volumes(frame: Frame) -> None:
    nearer = NEARER[frame.camera.projection.depth]
    states = (CullMode.NONE, DepthWrite.OFF, nearer, BlendFunction.ADDITIVE)
    for number, effect in enumerate(local_light_effects(frame.effects)):
        draw_volumes(frame, effect, VolumeColors, ["volumes"], clears=number == 0, states=states)


def _declare_edges(effects: FrameEffects, cells: ClusterSettings) -> tuple[FramePass[Frame], ...]:
    passes = forward_passes(effects)
    last, depth = last_version(passes, "image"), last_version(passes, "depth")
    changes = {last: "image with edges", depth: "depth with edges"}
    return *passes, FramePass("edges", _draw_edges, _REASON, changes=changes)


def _draw_edges(frame: Frame) -> None:
    if not frame.device.capabilities.wireframe:
        refuse(rules.NO_WIREFRAME, "Inspection('tessellation')", f"a {frame.device.backend_name} device")
    states, color = (PolygonMode.LINE, DepthWrite.OFF), frame.targets["image"]
    edges = make_scene_drawer(frame, EdgeColors, color=color, clears=False, states=states, switches=COVERAGE)
    fields = frame.resources.tessellated_indices
    if len(fields):
        with edges:
            edges.draw(frame.resources.select_in_view(frame.camera, fields))
    else:
        frame.draw_visible(edges)


INSPECTIONS: Final[dict[str, Callable[[FrameEffects, ClusterSettings], tuple[FramePass[Frame], ...]]]] = {
    **{name: partial(_declare_plain, name) for name in _PLAIN},
    "tessellation": _declare_edges,
    **dict.fromkeys(CELLS, _declare_cells),
    "volumes": _declare_volumes,
}
"""The function that declares the passes of each inspection, from a frame's effects and the tiles or
clusters."""

_LIT: Final = ("tessellation", "volumes", *CELLS)
