"""The number of light evaluations of a frame, counted by the device.

An evaluation is a light that a shader looks at for a surface: an entry of a list that a fragment walks, or a fragment
of a light's volume. Those out of range end at a comparison of distances, all others are the lighting equation.

A frame that is counted has the technique's own passes, and one more, which does what lights the frame once again: the
same fragments, the same lists, the same volumes. Instead of light each evaluation adds 1, to a texture of 32-bit
floats. So what depends on the order of objects is counted, too: the fragments of forward shading that are hidden later.
It holds for visibility algorithms that draw one batch, as frustum culling does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, Final, cast

import numpy as np

from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target, TechniquePass
from renderer.renderer import Renderer
from renderer.scene import Camera
from renderer.shaders.pixels import FullScreen, PixelRays, distance_at, nearness_of
from renderer.shaders.structs import SurfacePoint, SurfaceVarying
from renderer.techniques import (
    Clustered,
    ClusteredDeferred,
    Deferred,
    DeferredPlus,
    Forward,
    ForwardMultipass,
    ForwardPlus,
    Inferred,
    LightIndexed,
    LightPrePass,
    Technique,
    TiledDeferred,
)
from renderer.techniques.deferred_cells import TiledLighting, dispatch_tiles
from renderer.techniques.forward_multipass import PointPairs, SpotPairs, draw_pairs
from renderer.techniques.light_indexed import INDICES, LIGHT_BITS, LIGHTS_FULL, next_light
from renderer.techniques.parts.cell_lists import CLUSTERS, CellReader, LightCells, bind_lists
from renderer.techniques.parts.geometry_buffer import SurfaceReader
from renderer.techniques.parts.light_volumes import VolumeShader, VolumeVarying, draw_volumes
from renderer.techniques.parts.resolve import LIGHT_FORMAT
from renderer.techniques.parts.scene_shader import SceneShader
from renderer.techniques.parts.variants import bind, draw_full_screen, list_lamps
from rhi import BlendFunction, DepthFunction, DepthWrite, Format, State
from rhi.shading import (
    Shader,
    Texture2D,
    Uniform,
    dot,
    floor,
    fragment_coordinate,
    ivec2,
    ivec3,
    max,
    uint_bits_to_float,
    uvec4,
    vec3,
    vec4,
)

EVALUATIONS: Final = "light evaluations"
"""The contents with the number of evaluations of each pixel."""

_THOUSAND: Final = 1000.0
_SEEN: Final[tuple[State, ...]] = (DepthFunction.EQUAL, DepthWrite.OFF)
_LEARNS: Final = 4
"""Frames after which lists of cells have room for all lights: one that needs it, one that asks, one that learns."""


class ListLengths(Shader):
    """The base of shaders that count the lights of lists: of the kinds that a frame needs."""

    has_points = False
    has_spots = False

    def count(self, lights: ivec3) -> float:
        """Return the number of lights between three places in the light rows."""
        points = lights.y - lights.x if self.has_points else 0
        spots = lights.z - lights.y if self.has_spots else 0
        return float(points + spots)


class ObjectLights(ListLengths, SceneShader):
    """Counts the lights of the object's list."""

    def fragment(self, v: SurfaceVarying) -> vec4:
        return vec4(self.count(v.lights))


class CellLights(ListLengths, CellReader, SceneShader):
    """Counts the lights of the list of a fragment's cell."""

    rays: Uniform[PixelRays]

    def fragment(self, v: SurfaceVarying) -> vec4:
        return vec4(self.count(self.find_cell_lights(dot(v.position, self.rays.forward))))


class IndexedLights(ListLengths, SceneShader):
    """Counts the lights that are packed for the pixel, or those of the object's list if they are too many."""

    light_indices: Texture2D

    def fragment(self, v: SurfaceVarying) -> vec4:
        indices = self.light_indices.load(ivec2(fragment_coordinate().xy))
        if max(max(indices.x, indices.y), max(indices.z, indices.w)) >= LIGHTS_FULL:
            return vec4(self.count(v.lights))
        packed = uvec4(indices)
        number = 0.0
        while next_light(packed) > 0:
            packed = packed >> uvec4(LIGHT_BITS)
            number += 1.0
        return vec4(number)


class PixelLights(ListLengths, CellReader, FullScreen, SurfaceReader):
    """Counts the lights of the list of a pixel's cell."""

    def fragment(self) -> vec4:
        texel = self.surface.load(ivec2(fragment_coordinate().xy))
        return vec4(self.count(self.find_cell_lights(uint_bits_to_float(texel.y))))


class PlacedLights(ListLengths, CellReader, FullScreen):
    """Counts the lights of the list of a pixel's cell, whose place follows from its depth."""

    depth: Texture2D

    def fragment(self) -> vec4:
        nearness = nearness_of(self.rays, self.depth.load(ivec2(fragment_coordinate().xy)).x)
        if nearness == 0.0:
            return vec4(0.0)
        return vec4(self.count(self.find_cell_lights(distance_at(self.rays, nearness))))


class TileLights(TiledLighting):
    """Counts the lights that a tile keeps, for an image of half floats: what is left of thousands, and thousands."""

    def light_of(self, surface: SurfacePoint, light: int) -> vec3:
        return vec3(1.0)

    def encode_light(self, color: vec3) -> vec4:
        thousands = floor((color.x + 0.5) / _THOUSAND)
        return vec4(color.x - thousands * _THOUSAND, thousands, 0.0, 0.0)


class VolumeFragments(VolumeShader):
    """Counts the fragments of lights' volumes."""

    def fragment(self, v: VolumeVarying) -> vec4:
        return vec4(1.0)


class PointPairFragments(PointPairs):
    """Counts the fragments of pairs of an object and a point light."""

    def fragment(self, v: SurfaceVarying) -> vec4:
        return vec4(1.0)


class SpotPairFragments(SpotPairs):
    """Counts the fragments of pairs of an object and a spot light."""

    def fragment(self, v: SurfaceVarying) -> vec4:
        return vec4(1.0)


class Counted:
    """The passes of another technique, and one that counts light evaluations."""

    def __init__(self, technique: Technique) -> None:
        self._technique = technique

    @property
    def name(self) -> str:
        """The name of the technique that draws the image."""
        return self._technique.name

    def declare(self, needs: Needs) -> Sequence[Pass[Frame]]:
        """Return the technique's passes, and one that writes `light evaluations` if there are lamps to evaluate."""
        own, count = self._technique.declare(needs), find_count(self._technique)
        return (*own, count) if count is not None and list_lamps(needs) else own


def count_light_evaluations(renderer: Renderer, camera: Camera) -> int | None:
    """Return the number of light evaluations of a frame with the renderer's technique, by drawing some.

    None if the device runs no shaders, or it isn't known how to count for this technique.
    """
    technique = renderer.technique
    if not renderer.device.capabilities.renders or find_count(technique) is None:
        return None
    renderer.technique = Counted(technique)
    try:
        for _ in range(_LEARNS):
            targets = renderer.render(camera).targets
            renderer.device.finish()
        counts = targets.find(EVALUATIONS)
        if counts is None:
            return 0
        sums = counts.read().reshape(-1, counts.format.components).sum(0, dtype=np.float64)
        return int(sums[0] + (_THOUSAND * sums[1] if len(sums) > 1 else 0.0))
    finally:
        renderer.technique = technique


def find_count(technique: Technique) -> Pass[Frame] | None:
    """Return the pass that counts the evaluations of a technique with lamps in view; None for an unknown technique."""
    match technique:
        case Forward(samples=1):
            return _declare(_count_objects, targets=(Target("counted depth", DEPTH_FORMAT),))
        case Clustered():
            run = partial(_count_cells, cells=technique.cells, after_depth=False)
            return _declare(run, "light lists", targets=(Target("counted depth", DEPTH_FORMAT),))
        case ForwardPlus():
            return _declare(partial(_count_cells, cells=technique.cells, after_depth=True), "light lists", "depth")
        case LightIndexed():
            return _declare(_count_indices, INDICES, "depth")
        case ClusteredDeferred():
            return _declare(_count_pixels, "light lists", "surface", "depth")
        case DeferredPlus():
            return _declare(_count_places, "light lists", "depth")
        case TiledDeferred():
            return _declare(_count_tiles, "surface", "material", "depth", format=LIGHT_FORMAT)
        case Deferred() | LightPrePass():
            return _declare(partial(_count_volumes, stencil=technique.stencil, depth="depth"), "depth")
        case Inferred():
            depth = "small depth"
            return _declare(partial(_count_volumes, stencil=False, depth=depth), depth, scale=technique.scale)
        case ForwardMultipass():
            return _declare(_count_pairs, "depth")
    return None


def _declare(
    run: Callable[[Frame], None],
    *reads: str,
    targets: tuple[Target, ...] = (),
    scale: float = 1.0,
    format: Format = Format.R32F,
) -> Pass[Frame]:
    counts = Target(EVALUATIONS, format, scale)
    return Pass(EVALUATIONS, run, "was asked for", reads, (counts, *targets), has_side_effects=True)


@cache
def counting_variant(bases: tuple[type[Shader], ...], *, has_points: bool, has_spots: bool) -> type[Shader]:
    """Return a shader that counts the lights of lists of these kinds."""
    kinds = {"has_points": has_points, "has_spots": has_spots}
    return type("Counting", bases, {"__module__": __name__, **kinds})


def _count_kinds(frame: Frame, base: type[Shader]) -> type[Shader]:
    effects = frame.needs.effects
    return counting_variant(
        (base,), has_points=Effect.POINT_LIGHTS in effects, has_spots=Effect.SPOT_LIGHTS in effects
    )


def _count_fragments(frame: Frame, base: type[Shader], *, after_depth: bool, **bindings: Any) -> None:
    """Draw the visible objects with a shader that counts: those that are seen, or all as if they were lit at once."""
    resources = frame.resources
    program = frame.program(_count_kinds(frame, base))
    frame.draw_visible(
        TechniquePass(
            frame.device,
            resources,
            frame.view,
            program,
            bind(frame, program, bindings),
            color=frame.targets[EVALUATIONS],
            depth=frame.targets["depth" if after_depth else "counted depth"],
            clear=(0.0, 0.0, 0.0, 0.0),
            states=(BlendFunction.ADDITIVE, *(_SEEN if after_depth else ())),
            clears=not after_depth,
        )
    )


def _count_objects(frame: Frame) -> None:
    _count_fragments(frame, ObjectLights, after_depth=False)


def _count_cells(frame: Frame, *, cells: LightCells, after_depth: bool) -> None:
    bindings = bind_lists(frame, cells)
    _count_fragments(frame, CellLights, after_depth=after_depth, **bindings)


def _count_indices(frame: Frame) -> None:
    _count_fragments(frame, IndexedLights, after_depth=True, light_indices=frame.targets[INDICES])


def _count_pixels(frame: Frame) -> None:
    targets, shader = frame.targets, cast("type[FullScreen]", _count_kinds(frame, PixelLights))
    bindings = bind_lists(frame, CLUSTERS)
    draw_full_screen(
        frame, shader, targets[EVALUATIONS], bindings, depth=targets["depth"], clear=(0.0, 0.0, 0.0, 0.0)
    )


def _count_places(frame: Frame) -> None:
    targets, shader = frame.targets, cast("type[FullScreen]", _count_kinds(frame, PlacedLights))
    bindings = {"depth": targets["depth"]} | bind_lists(frame, CLUSTERS)
    draw_full_screen(frame, shader, targets[EVALUATIONS], bindings)


def _count_tiles(frame: Frame) -> None:
    dispatch_tiles(frame, frame.targets[EVALUATIONS], TileLights)


def _count_volumes(frame: Frame, *, stencil: bool, depth: str) -> None:
    for number, effect in enumerate(list_lamps(frame.needs)):
        draw_volumes(
            frame, effect, VolumeFragments, [EVALUATIONS], depth=depth, clears=not number, is_masked=stencil
        )


def _count_pairs(frame: Frame) -> None:
    targets = frame.targets
    with frame.device.render_pass(targets[EVALUATIONS], clear=(0.0, 0.0, 0.0, 0.0)):
        pass
    for effect in list_lamps(frame.needs):
        shader = PointPairFragments if effect is Effect.POINT_LIGHTS else SpotPairFragments
        draw_pairs(frame, effect, shader, targets[EVALUATIONS])
