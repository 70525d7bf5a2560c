"""Pictures of what a frame is made of, instead of its light: techniques for looking.

- `normals`: the direction of each surface, from -1…1 to 0…1 along the axes of the world.
- `depth`: the distance from the eye, from 0.1 m (white) to 1 km (black), equal steps for equal ratios.
- `lights`: the number of point and spot lights whose range holds each surface, in Thatcher's seven colours (table 4):
  black 0, blue 1 to 7, cyan to 15, green to 31, yellow to 63, red to 127, white 128 and more.
- `overdraw`: the number of fragments that were drawn to each pixel, one on top of the other, in the same colours: black
  0, blue 1, cyan 2 and 3, green to 7, yellow to 15, red to 31, white 32 and more.
- `tiles`, `clusters`: the number of lights in the list of each tile of `forward_plus`, or of the cluster of `clustered`
  that each surface is in, in the colours of `lights`, with lines between tiles, over the lit scene, which shows
  through. They are those of the settings.
- `tessellation`: the lit scene, and the edges of the triangles of its height fields, or of all if it has none.
- `volumes`: the lit scene, and the volumes of its lights, each in a colour of its own, in front of what they reach.
  Their colours are added up in floats, and their mean is laid over the scene, which is so seen through hundreds.

Other pictures are those of a technique's own buffers (`watched`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

import rhi.shading as sl
from renderer import rules
from renderer.frame import DEPTH_FORMAT, IMAGE_FORMAT, Frame, Needs, Pass, Target, find_last
from renderer.frame.passes import NEARER
from renderer.lights.culling.cells import CellGrid, cell_index
from renderer.shaders.lighting import in_range
from renderer.shaders.pixels import BackgroundScreen, distance_at, nearness_of, place_pixel
from renderer.shaders.structs import SurfacePoint, SurfaceVarying, Vertex
from renderer.techniques.parts.cell_lists import CLUSTERS, TILES, LightCells, bind_lists, list_pass
from renderer.techniques.parts.depth import depth_pass
from renderer.techniques.parts.finish import forward_passes
from renderer.techniques.parts.light_volumes import VolumeShader, VolumeVarying, draw_volumes
from renderer.techniques.parts.resolve import EXACT_BITS, SUM_FORMATS
from renderer.techniques.parts.scene_shader import LampShader, SceneShader, SurfaceShader
from renderer.techniques.parts.variants import COVERAGE, draw_full_screen, list_lamps, scene_pass
from rhi import BlendFunction, CullMode, DepthWrite, Format, PolygonMode, State, refuse

CELLS: Final = {"tiles": TILES, "clusters": CLUSTERS}
"""The cells of the pictures that show some, settings of techniques by the same names."""
_DECADES: Final = 13.28771  # log2 of 10,000: from 0.1 m to 1 km
_OPACITY: Final = 0.3  # of cells
_VOLUME_OPACITY, _MOST_OPAQUE = 0.06, 0.6  # of a volume, and of as many as there may be


@sl.function
def heat_color(count: float, first: float) -> sl.vec3:
    """Return the colour of a count: 0 black, below `first` blue, then another one each time it doubles."""
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
        return sl.vec4(self.see(self.take(v)).normal * 0.5 + 0.5, 1.0)


class EdgeColors(SceneShader):
    """Shows the edges of triangles, a thousandth nearer than they are."""

    is_coverage = True

    def transform(self, v: Vertex, uv2: sl.vec2, tangent: sl.vec4, color: sl.vec4) -> SurfaceVarying:
        result = super().transform(v, uv2, tangent, color)
        result.clip = self.view.relative_view_projection @ sl.vec4(0.999 * result.position, 1.0)
        return result

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        self.cut(self.take(v))
        return sl.vec4(0.0, 0.0, 0.0, 1.0)


class CountedLamps(SurfaceShader, LampShader):
    """Shows the number of lights in range: counts them instead of adding up their light."""

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        surface = self.find_surface(v, self.materials[v.material])
        return sl.vec4(heat_color(self.lamplight(surface, v.lights).x, 8.0), 1.0)

    def pointlight(self, surface: SurfacePoint, row: int) -> sl.vec3:
        light = self.point_lights[row]
        return sl.vec3(1.0) if in_range(surface, light.position, light.range) else sl.vec3(0.0)

    def spotlight(self, surface: SurfacePoint, row: int) -> sl.vec3:
        light = self.spot_lights[row]
        return sl.vec3(1.0) if in_range(surface, light.position, light.range) else sl.vec3(0.0)


class OneFragment(SceneShader):
    """Adds 1 for each fragment."""

    is_coverage = True

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        self.cut(self.take(v))
        return sl.vec4(1.0)


class FragmentCounts(BackgroundScreen):
    """Shows the number of fragments."""

    fragments: sl.Texture2D

    def fragment(self) -> sl.vec4:
        count = self.fragments.load(sl.ivec2(sl.fragment_coordinate().xy)).x
        return sl.vec4(heat_color(count, 2.0), 1.0)


class Distances(BackgroundScreen):
    """Shows the distance from the eye."""

    depth: sl.Texture2D

    def fragment(self) -> sl.vec4:
        place = sl.fragment_coordinate().xy
        nearness = nearness_of(self.rays, self.depth.load(sl.ivec2(place)).x)
        if nearness == 0.0:
            return sl.vec4(0.0, 0.0, 0.0, 1.0)
        away = sl.length(place_pixel(self.rays, place, distance_at(self.rays, nearness)))
        shade = sl.saturate(1.0 - sl.log2(sl.max(away, 0.1) * 10.0) / _DECADES)
        return sl.vec4(sl.vec3(shade * shade), 1.0)  # about even to the eye


class CellCounts(BackgroundScreen):
    """Shows the number of lights in the list of each surface's cell. With one slice, a cell has a tile's background as
    well."""

    grid: sl.Uniform[CellGrid]
    light_rows: sl.Storage[int]
    depth: sl.Texture2D

    def fragment(self) -> sl.vec4:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        distance = 0.0
        if self.grid.count.z > 1:
            nearness = nearness_of(self.rays, self.depth.load(pixel).x)
            if nearness == 0.0:
                return sl.vec4(0.0)
            distance = distance_at(self.rays, nearness)
        cell = cell_index(self.grid, pixel, distance)
        color = heat_color(float(self.light_rows[2 * cell + 2] - self.light_rows[2 * cell]), 8.0)
        if pixel.x % self.grid.tile == 0 or pixel.y % self.grid.tile == 0:
            color = sl.mix(color, sl.vec3(0.2), 0.5)
        return sl.vec4(color, _OPACITY)


class VolumeColors(VolumeShader):
    """Adds up the colours of the volumes of lights, and their number."""

    def fragment(self, v: VolumeVarying) -> sl.vec4:
        turns = 6.2831853 * (0.61803399 * float(v.light) + sl.vec3(0.0, 1.0 / 3.0, 2.0 / 3.0))
        return sl.vec4(0.5 + 0.4 * sl.cos(turns), 1.0)


class MeanVolume(BackgroundScreen):
    """Lays the mean of `VolumeColors` over the picture."""

    volumes: sl.Texture2D

    def fragment(self) -> sl.vec4:
        added = self.volumes.load(sl.ivec2(sl.fragment_coordinate().xy))
        opacity = _MOST_OPAQUE * (1.0 - sl.exp(-added.w * (_VOLUME_OPACITY / _MOST_OPAQUE)))
        return sl.vec4(added.rgb / sl.max(added.w, 1.0), opacity)


class Inspection:
    """Draws one of `INSPECTIONS` instead of the lit scene."""

    def __init__(self, shown: str, cells: LightCells | None = None) -> None:
        """Choose one of `INSPECTIONS`; for `tiles` and `clusters` also the cells, if they aren't `CELLS`."""
        self.name = shown
        self.cells = cells or CELLS.get(shown, TILES)

    @property
    def is_lit(self) -> bool:
        """Whether the picture shows the lit scene, too, so that shadow maps must be up to date."""
        return self.name in _LIT

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes of the picture."""
        return INSPECTIONS[self.name](needs, self.cells)


def _draw(
    frame: Frame,
    shader: type[SceneShader],
    contents: str = "image",
    *states: State,
    switches: Mapping[str, bool] = {},
) -> None:
    """Draw the visible objects before black."""
    color, clear = frame.targets[contents], (0.0, 0.0, 0.0, 1.0)
    frame.draw_visible(scene_pass(frame, shader, switches=switches, color=color, clear=clear, states=states))


def _draw_fragments(frame: Frame) -> None:
    _draw(frame, OneFragment, "fragments", BlendFunction.ADDITIVE, switches=COVERAGE)


def _show(frame: Frame, shader: type[BackgroundScreen]) -> None:
    draw_full_screen(frame, shader, frame.targets["image"])


def _lay_over(frame: Frame, shader: type[BackgroundScreen], own: Mapping[str, Any] = {}) -> None:
    """Draw what is as opaque as the shader says over the image."""
    draw_full_screen(frame, shader, frame.targets["image"], own, states=(BlendFunction.ALPHA,))


_IMAGE: Final = Target("image", IMAGE_FORMAT)
_DEPTH: Final = Target("depth", DEPTH_FORMAT)
_BECAUSE: Final = "was asked for"

_PLAIN: Final[dict[str, tuple[Pass[Frame], ...]]] = {
    "normals": (Pass("normals", partial(_draw, shader=NormalColors), _BECAUSE, writes=(_IMAGE, _DEPTH)),),
    "depth": (
        depth_pass("finds the nearest surfaces"),
        Pass("distances", partial(_show, shader=Distances), _BECAUSE, reads=("depth",), writes=(_IMAGE,)),
    ),
    "lights": (Pass("lights", partial(_draw, shader=CountedLamps), _BECAUSE, writes=(_IMAGE, _DEPTH)),),
    "overdraw": (
        Pass(
            "fragments",
            _draw_fragments,
            "counts fragments",
            writes=(Target("fragments", Format.R16F), _DEPTH),
        ),
        Pass("overdraw", partial(_show, shader=FragmentCounts), _BECAUSE, reads=("fragments",), writes=(_IMAGE,)),
    ),
}


def _declare_plain(name: str, needs: Needs, cells: LightCells) -> tuple[Pass[Frame], ...]:
    return _PLAIN[name]


def _declare_cells(needs: Needs, cells: LightCells) -> tuple[Pass[Frame], ...]:
    passes = forward_passes(needs)
    if not list_lamps(needs):
        return passes
    # As the techniques that have them: tiles end at surfaces, clusters are made without.
    lists = list_pass(needs, cells, depth="depth" if cells.slices == 1 else None)
    show, last = partial(_show_cells, cells=cells), find_last(passes, "image")
    return *passes, lists, Pass("cells", show, _BECAUSE, ("light lists", "depth"), changes={last: "image with cells"})


def _show_cells(frame: Frame, *, cells: LightCells) -> None:
    _lay_over(frame, CellCounts, bind_lists(frame, cells))


def _declare_volumes(needs: Needs, cells: LightCells) -> tuple[Pass[Frame], ...]:
    passes = forward_passes(needs)
    if not list_lamps(needs):
        return passes
    sums = Target("volumes", SUM_FORMATS[EXACT_BITS])
    added = Pass("volumes", _add_volumes, _BECAUSE, ("depth",), (sums,))
    show, last = partial(_lay_over, shader=MeanVolume), find_last(passes, "image")
    return *passes, added, Pass("mean volume", show, _BECAUSE, ("volumes",), changes={last: "image with volumes"})


def _add_volumes(frame: Frame) -> None:
    nearer = NEARER[frame.camera.projection.depth]
    states = (CullMode.NONE, DepthWrite.OFF, nearer, BlendFunction.ADDITIVE)
    for number, effect in enumerate(list_lamps(frame.needs)):
        draw_volumes(frame, effect, VolumeColors, ["volumes"], clears=number == 0, states=states)


def _declare_edges(needs: Needs, cells: LightCells) -> tuple[Pass[Frame], ...]:
    passes = forward_passes(needs)
    last, depth = find_last(passes, "image"), find_last(passes, "depth")
    changes = {last: "image with edges", depth: "depth with edges"}
    return *passes, Pass("edges", _draw_edges, _BECAUSE, changes=changes)


def _draw_edges(frame: Frame) -> None:
    if not frame.device.capabilities.wireframe:
        refuse(rules.NO_WIREFRAME, "Inspection('tessellation')", f"a {frame.device.backend_name} device")
    states, color = (PolygonMode.LINE, DepthWrite.OFF), frame.targets["image"]
    edges = scene_pass(frame, EdgeColors, color=color, clears=False, states=states, switches=COVERAGE)
    fields = frame.resources.tessellated_rows
    if len(fields):
        with edges:
            edges.draw(frame.resources.find_in_view(frame.camera, fields))
    else:
        frame.draw_visible(edges)


INSPECTIONS: Final[dict[str, Callable[[Needs, LightCells], tuple[Pass[Frame], ...]]]] = {
    **{name: partial(_declare_plain, name) for name in _PLAIN},
    "tessellation": _declare_edges,
    **dict.fromkeys(CELLS, _declare_cells),
    "volumes": _declare_volumes,
}
"""The passes of each picture, by what a frame needs and the cells of lights."""

_LIT: Final = ("tessellation", "volumes", *CELLS)
