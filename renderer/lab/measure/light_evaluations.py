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
from functools import partial
from typing import Final

import numpy as np

from renderer import techniques
from renderer.frame import DEPTH_FORMAT, Frame, Needs, Pass, Target
from renderer.renderer import Renderer
from renderer.scene import Camera
from renderer.shaders.pixels import BackgroundScreen, distance_at, nearness_of
from renderer.shaders.structs import Material, SurfacePoint
from renderer.techniques.deferred_cells import TiledLighting, dispatch_tiles
from renderer.techniques.forward_multipass import LampPairs, draw_pairs
from renderer.techniques.light_indexed import BY_INDICES
from renderer.techniques.parts.cell_lists import CLUSTERS, CellReader, bind_lists, by_cells
from renderer.techniques.parts.deferred_lighting import LitByLists
from renderer.techniques.parts.geometry_buffer import find_contents
from renderer.techniques.parts.light_volumes import VolumeShader, VolumeVarying, draw_volumes
from renderer.techniques.parts.resolve import LIGHT_FORMAT
from renderer.techniques.parts.variants import Lighting, draw_full_screen, list_lamps, scene_pass
from renderer.techniques.technique import WrappedTechnique
from rhi import BlendFunction, DepthFunction, DepthWrite, Format, State
from rhi.shading import Shader, Texture2D, floor, fragment_coordinate, ivec2, vec3, vec4

EVALUATIONS: Final = "light evaluations"
"""The contents with the number of evaluations of each pixel."""

_THOUSAND: Final = 1000.0
_SEEN: Final[tuple[State, ...]] = (DepthFunction.EQUAL, DepthWrite.OFF)
_NONE: Final = (0.0, 0.0, 0.0, 0.0)
_LEARNS: Final = 4
"""Frames after which lists of cells have room for all lights: one that needs it, one that asks, one that learns."""


class CountedLights(Shader):
    """Makes a technique's shader count the lights that it looks at: each of them adds 1, and nothing else is seen. As
    the first base of a variant it leaves the lists that are walked to the technique."""

    lean = True

    def shade(self, surface: SurfacePoint, material: Material) -> vec3:
        return vec3(0.0)

    def pointlight(self, surface: SurfacePoint, row: int) -> vec3:
        return vec3(1.0)

    def spotlight(self, surface: SurfacePoint, row: int) -> vec3:
        return vec3(1.0)

    def finish(self, color: vec3, position: vec3) -> vec4:
        return vec4(color, 1.0)

    def encode_light(self, color: vec3) -> vec4:
        """Return a number for an image of half floats: what is left of thousands, and thousands."""
        thousands = floor((color.x + 0.5) / _THOUSAND)
        return vec4(color.x - thousands * _THOUSAND, thousands, 0.0, 0.0)


class PlacedLights(CellReader, BackgroundScreen):
    """Counts the lights of the list of a pixel's cell, whose place follows from its depth."""

    depth: Texture2D

    def fragment(self) -> vec4:
        nearness = nearness_of(self.rays, self.depth.load(ivec2(fragment_coordinate().xy)).x)
        if nearness == 0.0:
            return vec4(0.0)
        lights = self.find_cell_lights(self.find_cell(distance_at(self.rays, nearness)))
        points = lights.y - lights.x if self.has_point_lights else 0
        spots = lights.z - lights.y if self.has_spot_lights else 0
        return vec4(float(points + spots))


class VolumeFragments(VolumeShader):
    """Counts the fragments of lights' volumes."""

    def fragment(self, v: VolumeVarying) -> vec4:
        return vec4(1.0)


class Counted(WrappedTechnique):
    """The passes of another technique, and one that counts light evaluations."""

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


def find_count(technique: techniques.Technique) -> Pass[Frame] | None:
    """Return the pass that counts the evaluations of a technique with lamps in view; None for an unknown technique."""
    match technique:
        case techniques.Forward(samples=1):
            return _declare_fragments(technique.lighting)
        case techniques.Clustered(samples=1):
            return _declare_fragments(by_cells(technique.cells))
        case techniques.ForwardPlus(samples=1):
            return _declare_fragments(by_cells(technique.cells), after_depth=True)
        case techniques.LightIndexed():
            return _declare_fragments(BY_INDICES, after_depth=True)
        case techniques.ClusteredDeferred(samples=1):
            return _declare(_count_pixels, "light lists", "surface", "material", "depth")
        case techniques.DeferredPlus(samples=1):
            return _declare(_count_places, "light lists", "depth")
        case techniques.TiledDeferred(samples=1):
            return _declare(_count_tiles, "surface", "material", "depth", format=LIGHT_FORMAT)
        case techniques.Deferred() | techniques.LightPrePass():
            return _declare(partial(_count_volumes, stencil=technique.stencil, depth="depth"), "depth")
        case techniques.Inferred():
            depth = "small depth"
            return _declare(partial(_count_volumes, stencil=False, depth=depth), depth, scale=technique.scale)
        case techniques.ForwardMultipass():
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


def _declare_fragments(lighting: Lighting, *, after_depth: bool = False) -> Pass[Frame]:
    run = partial(_count_fragments, lighting=lighting, after_depth=after_depth)
    if after_depth:
        return _declare(run, *lighting.reads, "depth")
    return _declare(run, *lighting.reads, targets=(Target("counted depth", DEPTH_FORMAT),))


def _count_fragments(frame: Frame, *, lighting: Lighting, after_depth: bool) -> None:
    """Draw the visible objects with a shader that counts: those that are seen, or all as if they were lit at once."""
    counting = scene_pass(
        frame,
        CountedLights,
        *lighting.bases,
        own=lighting.bind(frame),
        switches=lighting.switches,
        color=frame.targets[EVALUATIONS],
        depth=frame.targets["depth" if after_depth else "counted depth"],
        clear=_NONE,
        states=(BlendFunction.ADDITIVE, *(_SEEN if after_depth else ())),
        clears=not after_depth,
    )
    frame.draw_visible(counting)


def _count_pixels(frame: Frame) -> None:
    targets, shader = frame.targets, (CountedLights, LitByLists)
    own, switches = bind_lists(frame, CLUSTERS), find_contents(frame)
    depth = targets["depth"]
    draw_full_screen(frame, shader, targets[EVALUATIONS], own, depth=depth, clear=_NONE, switches=switches)


def _count_places(frame: Frame) -> None:
    draw_full_screen(frame, PlacedLights, frame.targets[EVALUATIONS], bind_lists(frame, CLUSTERS))


def _count_tiles(frame: Frame) -> None:
    dispatch_tiles(frame, frame.targets[EVALUATIONS], CountedLights, TiledLighting)


def _count_volumes(frame: Frame, *, stencil: bool, depth: str) -> None:
    for number, effect in enumerate(list_lamps(frame.needs)):
        draw_volumes(frame, effect, VolumeFragments, [EVALUATIONS], depth=depth, clears=not number, is_masked=stencil)


def _count_pairs(frame: Frame) -> None:
    target = frame.targets[EVALUATIONS]
    with frame.device.render_pass(target, clear=_NONE):
        pass
    for effect in list_lamps(frame.needs):
        draw_pairs(frame, effect, target, CountedLights, LampPairs)
