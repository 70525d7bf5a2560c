"""Pictures of what a frame is made of, instead of its light: techniques for looking.

- `normals`: the direction of each surface, from -1…1 to 0…1 along the axes of the world.
- `depth`: the distance from the eye, from 0.1 m (white) to 1 km (black), equal steps for equal ratios.
- `lights`: the number of point and spot lights whose range holds each surface, in Thatcher's seven colours (table 4):
  black 0, blue 1 to 7, cyan to 15, green to 31, yellow to 63, red to 127, white 128 and more.
- `overdraw`: the number of fragments that were drawn to each pixel, one on top of the other, in the same colours: black
  0, blue 1, cyan 2 and 3, green to 7, yellow to 15, red to 31, white 32 and more.
- `tiles`: the number of lights in the list of each tile of `forward_plus`, in the colours of `lights`.
- `tessellation`: the lit scene, and the edges of the triangles of its height fields, or of all if it has none.
- `volumes`: the lit scene, and the volumes of its lights, each in a colour of its own, in front of what they reach.

Other pictures are those of a technique's own buffers (`watched`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any, Final

from renderer import rules
from renderer.frame import DEPTH_FORMAT, IMAGE_FORMAT, Frame, Needs, Pass, Target, TechniquePass, find_last
from renderer.frame.passes import NEARER
from renderer.lights.culling.cells import CellGrid, cell_index
from renderer.shaders.lighting import in_range
from renderer.shaders.pixels import FullScreen, distance_at, nearness_of, place_pixel
from renderer.shaders.structs import SurfacePoint, SurfaceVarying, Vertex
from renderer.techniques.cell_lists import TILES, bind_lists, list_pass
from renderer.techniques.depth import draw_depth
from renderer.techniques.forward import Forward, bind_plain_lamps, list_lamps
from renderer.techniques.forward_shader import LampShader, WithPointLights, WithSpotLights
from renderer.techniques.full_screen import bind_rays, draw_full_screen
from renderer.techniques.light_volumes import VolumeShader, VolumeVarying, draw_volumes, lit_variant
from renderer.techniques.scene_shader import SceneShader
from renderer.techniques.surfaces import Aspect, MaterialShader, bind_surfaces, surface_variant
from rhi import BlendFunction, CullMode, DepthWrite, Format, PolygonMode, State, Texture, refuse
from rhi.shading import (
    Storage,
    Texture2D,
    Uniform,
    cos,
    fragment_coordinate,
    function,
    ivec2,
    length,
    log2,
    max,
    mix,
    saturate,
    vec2,
    vec3,
    vec4,
)

_DECADES: Final = 13.28771  # log2 of 10,000: from 0.1 m to 1 km


@function
def heat_color(count: float, first: float) -> vec3:
    """Return the colour of a count: 0 black, below `first` blue, then another one each time it doubles."""
    if count < 0.5:
        return vec3(0.0)
    if count < first - 0.5:
        return vec3(0.0, 0.0, 1.0)
    if count < 2.0 * first - 0.5:
        return vec3(0.0, 1.0, 1.0)
    if count < 4.0 * first - 0.5:
        return vec3(0.0, 1.0, 0.0)
    if count < 8.0 * first - 0.5:
        return vec3(1.0, 1.0, 0.0)
    if count < 16.0 * first - 0.5:
        return vec3(1.0, 0.0, 0.0)
    return vec3(1.0)


class NormalColors(SceneShader):
    """Shows normals."""

    def fragment(self, v: SurfaceVarying) -> vec4:
        _ = self.find_texel(v)  # which leaves out what isn't drawn
        return vec4(self.find_normal(v) * 0.5 + 0.5, 1.0)


class EdgeColors(SceneShader):
    """Shows the edges of triangles, a thousandth nearer than they are."""

    def transform(self, v: Vertex, uv2: vec2, tangent: vec4, color: vec4) -> SurfaceVarying:
        result = super().transform(v, uv2, tangent, color)
        result.clip = self.view.relative_view_projection @ vec4(0.999 * result.position, 1.0)
        return result

    def fragment(self, v: SurfaceVarying) -> vec4:
        _ = self.find_texel(v)  # which leaves out what isn't drawn
        return vec4(0.0, 0.0, 0.0, 1.0)


class CountedLamps(MaterialShader, LampShader):
    """Shows the number of lights in range."""

    def fragment(self, v: SurfaceVarying) -> vec4:
        surface = self.find_surface(v, self.materials[v.material])
        return vec4(heat_color(self.lamplight(surface, v.lights).x, 8.0), 1.0)


class CountedPoints(WithPointLights):
    """Counts point lights instead of adding up their light."""

    def pointlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        count = 0.0
        for i in range(begin, end):
            row = self.light_rows[i]
            if in_range(surface, self.point_lights[row].position, self.point_lights[row].range):
                count += 1.0
        return vec3(count)


class CountedSpots(WithSpotLights):
    """Counts spot lights instead of adding up their light."""

    def spotlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        count = 0.0
        for i in range(begin, end):
            row = self.light_rows[i]
            if in_range(surface, self.spot_lights[row].position, self.spot_lights[row].range):
                count += 1.0
        return vec3(count)


class OneFragment(SceneShader):
    """Adds 1 for each fragment."""

    def fragment(self, v: SurfaceVarying) -> vec4:
        _ = self.find_texel(v)  # which leaves out what isn't drawn
        return vec4(1.0)


class FragmentCounts(FullScreen):
    """Shows the number of fragments."""

    fragments: Texture2D

    def fragment(self) -> vec4:
        count = self.fragments.load(ivec2(fragment_coordinate().xy)).x
        return vec4(heat_color(count, 2.0), 1.0)


class Distances(FullScreen):
    """Shows the distance from the eye."""

    depth: Texture2D

    def fragment(self) -> vec4:
        place = fragment_coordinate().xy
        nearness = nearness_of(self.rays, self.depth.load(ivec2(place)).x)
        if nearness == 0.0:
            return vec4(0.0, 0.0, 0.0, 1.0)
        away = length(place_pixel(self.rays, place, distance_at(self.rays, nearness)))
        shade = saturate(1.0 - log2(max(away, 0.1) * 10.0) / _DECADES)
        return vec4(vec3(shade * shade), 1.0)  # about even to the eye


class TileCounts(FullScreen):
    """Shows the number of lights in each tile's list."""

    grid: Uniform[CellGrid]
    light_rows: Storage[int]

    def fragment(self) -> vec4:
        pixel = ivec2(fragment_coordinate().xy)
        cell = cell_index(self.grid, pixel, 0.0)
        color = heat_color(float(self.light_rows[2 * cell + 2] - self.light_rows[2 * cell]), 8.0)
        if pixel.x % self.grid.tile == 0 or pixel.y % self.grid.tile == 0:
            color = mix(color, vec3(0.2), 0.5)
        return vec4(color, 1.0)


class VolumeColors(VolumeShader):
    """Shows the volumes of lights."""

    def fragment(self, v: VolumeVarying) -> vec4:
        turns = 6.2831853 * (0.61803399 * float(v.light) + vec3(0.0, 1.0 / 3.0, 2.0 / 3.0))
        return vec4(0.03 + 0.025 * cos(turns), 0.0)


class Inspection:
    """Draws one of `INSPECTIONS` instead of the lit scene."""

    def __init__(self, shown: str) -> None:
        """Choose one of `INSPECTIONS`."""
        self.name = shown

    @property
    def is_lit(self) -> bool:
        """Whether the picture shows the lit scene, too, so that shadow maps must be up to date."""
        return self.name in _LIT

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes of the picture."""
        return INSPECTIONS[self.name](needs)


@cache
def _count_lights(parts: tuple[str, ...]) -> type[SceneShader]:
    counted = {"point_lights": CountedPoints, "spot_lights": CountedSpots}
    return type("Counts", (*(counted[part] for part in parts), CountedLamps), {"__module__": __name__})


def _draw(
    frame: Frame,
    base: type[SceneShader],
    color: Texture,
    *states: State,
    aspects: tuple[Aspect, ...] = (Aspect.COVERAGE,),
    **bindings: Any,
) -> None:
    """Draw the visible objects before black, by a shader that reads these aspects of surfaces."""
    parts, scene = bind_surfaces(frame, aspects, has_materials=issubclass(base, MaterialShader))
    frame.draw_visible(
        TechniquePass(
            frame.device,
            frame.resources,
            frame.view,
            frame.program(surface_variant(base, parts)),
            scene | bindings,
            color=color,
            depth=frame.targets["depth"],
            clear=(0.0, 0.0, 0.0, 1.0),
            states=states,
        )
    )


def _draw_normals(frame: Frame) -> None:
    _draw(frame, NormalColors, frame.targets["image"], aspects=(Aspect.COVERAGE, Aspect.NORMAL))


def _draw_lights(frame: Frame) -> None:
    parts, lamps = bind_plain_lamps(frame)
    _draw(frame, _count_lights(tuple(parts)), frame.targets["image"], **lamps)


def _draw_fragments(frame: Frame) -> None:
    _draw(frame, OneFragment, frame.targets["fragments"], BlendFunction.ADDITIVE)


def _show_fragments(frame: Frame) -> None:
    targets = frame.targets
    draw_full_screen(frame, FragmentCounts, targets["image"], {"fragments": targets["fragments"]})


def _show_depth(frame: Frame) -> None:
    targets = frame.targets
    draw_full_screen(frame, Distances, targets["image"], {"depth": targets["depth"]})


_IMAGE: Final = Target("image", IMAGE_FORMAT)
_DEPTH: Final = Target("depth", DEPTH_FORMAT)
_BECAUSE: Final = "was asked for"

_PLAIN: Final[dict[str, tuple[Pass[Frame], ...]]] = {
    "normals": (Pass("normals", _draw_normals, _BECAUSE, writes=(_IMAGE, _DEPTH)),),
    "depth": (
        Pass("depth", draw_depth, "finds the nearest surfaces", writes=(_DEPTH,)),
        Pass("distances", _show_depth, _BECAUSE, reads=("depth",), writes=(_IMAGE,)),
    ),
    "lights": (Pass("lights", _draw_lights, _BECAUSE, writes=(_IMAGE, _DEPTH)),),
    "overdraw": (
        Pass(
            "fragments",
            _draw_fragments,
            "counts fragments",
            writes=(Target("fragments", Format.R16F), _DEPTH),
        ),
        Pass("overdraw", _show_fragments, _BECAUSE, reads=("fragments",), writes=(_IMAGE,)),
    ),
}


def _declare_plain(name: str, needs: Needs) -> tuple[Pass[Frame], ...]:
    return _PLAIN[name]


def _declare_tiles(needs: Needs) -> tuple[Pass[Frame], ...]:
    depth = Pass("depth", draw_depth, "finds the nearest surfaces", writes=(_DEPTH,))
    if not list_lamps(needs):
        return depth, Pass("tiles", _clear_image, "no light is in view", writes=(_IMAGE,))
    lists = list_pass(needs, TILES, depth="depth")
    return depth, lists, Pass("tiles", _show_tiles, _BECAUSE, reads=("light lists",), writes=(_IMAGE,))


def _clear_image(frame: Frame) -> None:
    with frame.device.render_pass(frame.targets["image"], clear=(0.0, 0.0, 0.0, 1.0)):
        pass


def _show_tiles(frame: Frame) -> None:
    draw_full_screen(frame, TileCounts, frame.targets["image"], bind_lists(frame, TILES))


def _declare_volumes(needs: Needs) -> tuple[Pass[Frame], ...]:
    passes = Forward().declare(needs)
    if not list_lamps(needs):
        return passes
    last = find_last(passes, "image")
    shown = Pass("volumes", _show_volumes, _BECAUSE, reads=("depth",), changes={last: "image with volumes"})
    return *passes, shown


def _show_volumes(frame: Frame) -> None:
    nearer = NEARER[frame.camera.projection.depth]
    states = (CullMode.NONE, DepthWrite.OFF, nearer, BlendFunction.ADDITIVE)
    for effect in list_lamps(frame.needs):
        shader = lit_variant(VolumeColors, effect)
        draw_volumes(frame, effect, shader, bind_rays(frame), ["image"], clears=False, states=states)


def _declare_edges(needs: Needs) -> tuple[Pass[Frame], ...]:
    passes = Forward().declare(needs)
    last, depth = find_last(passes, "image"), find_last(passes, "depth")
    changes = {last: "image with edges", depth: "depth with edges"}
    return *passes, Pass("edges", _draw_edges, _BECAUSE, changes=changes)


def _draw_edges(frame: Frame) -> None:
    if not frame.device.capabilities.wireframe:
        refuse(rules.NO_WIREFRAME, "Inspection('tessellation')", f"a {frame.device.backend_name} device")
    parts, bindings = bind_surfaces(frame, (Aspect.COVERAGE,), has_materials=False)
    scene_pass = TechniquePass(
        frame.device,
        frame.resources,
        frame.view,
        frame.device.program(surface_variant(EdgeColors, parts)),
        bindings,
        color=frame.targets["image"],
        depth=frame.targets["depth"],
        clears=False,
        states=(PolygonMode.LINE, DepthWrite.OFF),
    )
    fields = frame.resources.tessellated_rows
    if len(fields):
        with scene_pass:
            scene_pass.draw(frame.resources.find_in_view(frame.camera, fields))
    else:
        frame.draw_visible(scene_pass)


INSPECTIONS: Final[dict[str, Callable[[Needs], tuple[Pass[Frame], ...]]]] = {
    **{name: partial(_declare_plain, name) for name in _PLAIN},
    "tessellation": _declare_edges,
    "tiles": _declare_tiles,
    "volumes": _declare_volumes,
}
"""The passes of each picture, by what a frame needs."""

_LIT: Final = ("tessellation", "volumes")
