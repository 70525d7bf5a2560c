"""Penumbras of sources with a size, compared with rays in float64.

A plate hides the source from a part of a floor, and its straight edge has a penumbra. The light along a line of the
floor across the edge, in that of the floor beyond, rises from 0 to 1. The width of a rise s(x) is the integral of
6 s (1 - s): that of the ramp with the same integral.
"""

from __future__ import annotations

from functools import cache, partial
from typing import Final, NamedTuple

import numpy as np

from renderer.content import BUILT_IN
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.lab.exam.ray_traced_cases import draw
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.lab.measure.ray_tracer.surfaces import decode_srgb, encode_srgb
from renderer.lab.measure.ray_tracer.tracer import inverse_tone_map
from renderer.scene import Camera, Orthographic, Scene, SceneBuilder
from renderer.scene.arrays import Floats
from renderer.shadows import ShadowFilter
from rhi import Device
from rhi.math import multiply, scaling, translation

_SIZE: Final = (128, 4)
_LENGTH: Final = 3.0  # of the line, in metres
_MAPS: Final[dict[str, object]] = {
    "shadows.filter": ShadowFilter.PCSS,
    "shadows.cascades": 1,
    "shadows.distance": 8.0,
    "shadows.max_size": 1024,
    "shadows.min_size": 1024,
}


class EdgeSource(NamedTuple):
    """A light above the left end of the line: its kind, its radius in metres or the angle that it fills in
    radians, and the heights in metres of the plates that hide it."""

    kind: str
    size: float
    heights: tuple[float, ...]


def make_edge(source: EdgeSource, height: float, offset: float) -> Scene:
    """Make a floor and a plate at a height, at `offset` metres from the origin along x and z, whose edge is above
    the left end of the line."""
    builder = SceneBuilder("edge")
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
    box = builder.add_mesh(BUILT_IN["box"]())
    grey = builder.add_material(base_color=(0.5, 0.5, 0.5), specular_color=(0.0, 0.0, 0.0))
    for position, size in (((0.0, -0.25, 0.0), (14.0, 0.5, 14.0)), ((-2.5, height, 0.0), (5.0, 1e-3, 6.0))):
        placed = multiply(translation(np.add(position, (offset, 0.0, offset))), scaling(size))
        builder.add_objects(builder.add_node(placed), box, grey)
    lights, at = builder.lights, (offset - 3.2, 4.0, offset)
    if source.kind == "sun":
        lights.add_directional((1.0, -1.0, 0.1), casts_shadow=True, angular_diameter=source.size)
    elif source.kind == "spot":
        lights.add_spot(
            at,
            (1.0, -1.0, 0.0),
            20.0,
            0.35,
            0.45,
            intensity=25.0,
            casts_shadow=True,
            source_radius=source.size,
        )
    else:
        lights.add_point(at, 20.0, intensity=25.0, casts_shadow=True, source_radius=source.size)
    return builder.build()


def make_line_camera(offset: float) -> Camera:
    """The camera that looks straight down at the line, which is in the middle of its image."""
    middle = offset + 0.5 * _LENGTH
    projection = Orthographic(_LENGTH * _SIZE[1] / _SIZE[0], _SIZE[0] / _SIZE[1], 0.0, 20.0)
    return Camera.look_at((middle, 8.0, offset), (middle, 0.0, offset), (0, 0, -1), projection)


def _measure_width(levels: Floats, lit: Floats) -> float:
    """The width in metres of a penumbra, from the levels (w,) of a line with shadows and without."""
    light, all_light = (inverse_tone_map(decode_srgb(line / 255.0)) for line in (levels, lit))
    share = np.clip(light / all_light, 0.0, 1.0)
    return float(6.0 * (share * (1.0 - share)).sum() * _LENGTH / _SIZE[0])


@cache  # the same for each device
def trace_width(source: EdgeSource, height: float) -> float:
    """The ray-traced width of a penumbra in metres."""
    scene, camera = make_edge(source, height, 0.0), make_line_camera(0.0)
    pixels = np.stack([np.arange(_SIZE[0]) + 0.5, np.full(_SIZE[0], 0.5 * _SIZE[1])], axis=1)
    lines = [
        RayTracer(scene, has_shadows=has_shadows, has_penumbras=True).trace(camera, _SIZE, pixels)
        for has_shadows in (True, False)
    ]
    return _measure_width(*(255.0 * _encode(line) for line in lines))


def _encode(colors: Floats) -> Floats:
    return encode_srgb(colors)[:, 0]


def measure_penumbras(sources: tuple[EdgeSource, ...], offset: float, device: Device) -> CaseResult:
    """Draw shadows of plates, and measure by which part of its width a penumbra is too wide or too narrow."""
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error, camera = 0.0, make_line_camera(offset)
    for source in sources:
        widths = []
        for height in source.heights:
            scene = make_edge(source, height, offset)
            image = draw(device, scene, camera, _SIZE, changes=_MAPS)
            scene.lights.cast_shadows(False)
            lit = draw(device, scene, camera, _SIZE)
            line, lit_line = (pixels[_SIZE[1] // 2, :, 0].astype(np.float64) for pixels in (image, lit))
            width, traced = _measure_width(line, lit_line), trace_width(source, height)
            title = f"{source.kind}, {source.size:g} wide, edge at {height:g} m"
            numbers[f"{title}: metres"] = round(width, 4)
            numbers[f"{title}: metres by rays"] = round(traced, 4)
            error = largest_error(error, abs(width - traced) / traced)
            images[title] = image
            widths.append(width)
            holds[f"{title}: the shadow has a dark and a lit end"] = bool(
                line[2:6].max() < 8.0 and abs(line[-6:] - lit_line[-6:]).max() < 1.5
            )
        holds[f"{source.kind}: penumbras widen with the height"] = widths == sorted(widths)
    return CaseResult(error, numbers, holds, lambda: images)


_SEAM: Final = 0.8  # the height in metres of the plate whose shadow ends where two faces of a cube meet
_SUN_AND_SPOT: Final = (EdgeSource("sun", 0.2, (0.3, 0.8, 1.8)), EdgeSource("spot", 0.3, (0.4, 0.8, 1.6)))
_POINT: Final = (EdgeSource("point", 0.3, (0.4, _SEAM, 1.6)),)

MEASURES: Final[Measures] = {
    83: partial(measure_penumbras, _SUN_AND_SPOT, 0.0),
    84: partial(measure_penumbras, _POINT, 2.0**20),
}
