"""The number of light evaluations of a frame, counted by the device.

An evaluation is a light that a shader evaluates for a surface: an entry of a fragment's light list, or a
fragment of a light's volume. If the light is out of range, it ends at a comparison of distances; otherwise it
is the whole lighting equation.

A counted frame has the technique's own passes and one more, which repeats the lighting: the same fragments,
the same lists, the same volumes. Instead of light each evaluation adds 1 to a texture of 32-bit floats. So
the order of objects counts, too: forward shading evaluates fragments that are hidden later. Counts are right
for visibility algorithms that draw one batch, as frustum culling does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import numpy as np

from renderer import techniques
from renderer.frame import DEPTH_FORMAT, Frame, FrameEffects, FramePass, Target
from renderer.light_kinds.generation import define, for_each_kind
from renderer.renderer import Renderer
from renderer.scene import Camera
from renderer.shaders.pixels import BackgroundScreen, depth_to_nearness, nearness_to_distance
from renderer.shaders.structs import Material, SurfacePoint
from renderer.techniques.deferred_by_cells import TiledLighting, dispatch_tiles
from renderer.techniques.forward_multipass import LightPairs, draw_pairs
from renderer.techniques.light_indexed import LIT_BY_INDICES
from renderer.techniques.parts.deferred_lighting import LitByLists
from renderer.techniques.parts.geometry_buffer import geometry_buffer_switches
from renderer.techniques.parts.light_list_reader import (
    CLUSTERS,
    LightListReader,
    LightListsFactory,
    bind_light_lists,
    lit_by_cells,
)
from renderer.techniques.parts.light_volumes import VolumeShader, VolumeVarying, draw_volumes
from renderer.techniques.parts.resolve import LIGHT_FORMAT
from renderer.techniques.parts.variants import (
    Lighting,
    draw_full_screen,
    local_light_effects,
    make_scene_drawer,
)
from renderer.techniques.technique import WrappedTechnique
from rhi import BlendFunction, DepthFunction, DepthWrite, Format, State
from rhi.shading import Shader, Texture2D, floor, fragment_coordinate, ivec2, vec3, vec4

EVALUATIONS: Final = "light evaluations"
"""The resource with the number of evaluations of each pixel."""

_THOUSAND: Final = 1000.0
_VISIBLE_ONLY: Final[tuple[State, ...]] = (DepthFunction.EQUAL, DepthWrite.OFF)
_NONE: Final = (0.0, 0.0, 0.0, 0.0)
_WARM_UP_FRAMES: Final = 4
"""Frames after which light lists have room for all lights: one that needs it, one that requests it, one that
gets it."""


LightCounterBase: Final[type[Shader]] = define(
    "class LightCounterBase(Shader):"
    + for_each_kind(
        """
    def shade_${kind}_light(self, surface: SurfacePoint, light_index: int) -> vec3:
        return vec3(1.0)
"""
    ),
    "LightCounterBase",
    __name__,
    Shader=Shader,
    SurfacePoint=SurfacePoint,
    vec3=vec3,
)
"""Counts each light that a shader evaluates as 1."""


class LightCounter(LightCounterBase):  # type: ignore[misc, valid-type]
    """Makes a technique's shader count the lights that it evaluates: each adds 1, and nothing else is output.
    As the first base of a variant it leaves the light lists to the technique."""

    lean = True

    def shade(self, surface: SurfacePoint, material: Material) -> vec3:
        return vec3(0.0)

    def finish(self, color: vec3, position: vec3) -> vec4:
        return vec4(color, 1.0)

    def linear_to_srgb_color(self, color: vec3) -> vec4:
        """A count as a colour of half floats: the remainder of thousands, and the thousands."""
        thousands = floor((color.x + 0.5) / _THOUSAND)
        return vec4(color.x - thousands * _THOUSAND, thousands, 0.0, 0.0)


class CellCounter(LightListReader, BackgroundScreen):
    """The base of `ClusterLightCounter`."""

    depth: Texture2D


ClusterLightCounter: Final[type[CellCounter]] = define(
    """
class ClusterLightCounter(CellCounter):
    def fragment(self) -> vec4:
        nearness = depth_to_nearness(self.rays, self.depth.load(ivec2(fragment_coordinate().xy)).x)
        if nearness == 0.0:
            return vec4(0.0)
        lights = self.cell_light_range(self.cell_index_at(nearness_to_distance(self.rays, nearness)))
        count = 0
"""
    + for_each_kind(
        """
        if self.has_${kind}_lights:
            count += lights.$end - lights.$begin
"""
    )
    + "        return vec4(float(count))\n",
    "ClusterLightCounter",
    __name__,
    CellCounter=CellCounter,
    depth_to_nearness=depth_to_nearness,
    fragment_coordinate=fragment_coordinate,
    ivec2=ivec2,
    nearness_to_distance=nearness_to_distance,
    vec4=vec4,
)
"""Counts the lights of the list of a pixel's cell, whose bounds follow from its depth."""


class VolumeFragmentCounter(VolumeShader):
    """Counts the fragments of light volumes."""

    def fragment(self, v: VolumeVarying) -> vec4:
        return vec4(1.0)


class CountingTechnique(WrappedTechnique):
    """Another technique's passes, and one that counts light evaluations."""

    def declare(self, effects: FrameEffects) -> Sequence[FramePass[Frame]]:
        """The technique's passes, and one that writes `light evaluations` if there are local lights."""
        passes, count = self._technique.declare(effects), find_counting_pass(self._technique)
        return (*passes, count) if count is not None and local_light_effects(effects) else passes


def count_light_evaluations(renderer: Renderer, camera: Camera) -> int | None:
    """Count the light evaluations of a frame with the renderer's technique, by rendering a few frames.

    None if the device runs no shaders, or if this technique can't be counted.
    """
    technique = renderer.technique
    if not renderer.device.capabilities.renders or find_counting_pass(technique) is None:
        return None
    renderer.technique = CountingTechnique(technique)
    try:
        for _ in range(_WARM_UP_FRAMES):
            targets = renderer.render(camera).targets
            renderer.device.finish()
        counts = targets.get(EVALUATIONS)
        if counts is None:
            return 0
        sums = counts.read().reshape(-1, counts.format.components).sum(0, dtype=np.float64)
        return int(sums[0] + (_THOUSAND * sums[1] if len(sums) > 1 else 0.0))
    finally:
        renderer.technique = technique


def find_counting_pass(technique: techniques.Technique) -> FramePass[Frame] | None:
    """The pass that counts the evaluations of a technique with local lights in view; None for an unknown
    technique."""
    match technique:
        case techniques.Forward(samples=1):
            return _declare_fragments(technique.lighting)
        case techniques.Clustered(samples=1):
            return _declare_fragments(lit_by_cells(technique.cells))
        case techniques.ForwardPlus(samples=1):
            return _declare_fragments(lit_by_cells(technique.cells), after_depth=True)
        case techniques.LightIndexed():
            return _declare_fragments(LIT_BY_INDICES, after_depth=True)
        case techniques.ClusteredDeferred(samples=1):
            return _declare(_count_pixels, "light lists", "surface", "material", "depth")
        case techniques.DeferredPlus(samples=1):
            return _declare(partial(_count_cells, cells=technique.cells), "light lists", "depth")
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
) -> FramePass[Frame]:
    counts = Target(EVALUATIONS, format, scale)
    return FramePass(EVALUATIONS, run, "was asked for", reads, (counts, *targets), has_side_effects=True)


def _declare_fragments(lighting: Lighting, *, after_depth: bool = False) -> FramePass[Frame]:
    run = partial(_count_fragments, lighting=lighting, after_depth=after_depth)
    if after_depth:
        return _declare(run, *lighting.reads, "depth")
    return _declare(run, *lighting.reads, targets=(Target("counted depth", DEPTH_FORMAT),))


def _count_fragments(frame: Frame, *, lighting: Lighting, after_depth: bool) -> None:
    """Draw the visible objects with a counting shader: only visible fragments, or all as if they were lit
    when drawn."""
    counting = make_scene_drawer(
        frame,
        LightCounter,
        *lighting.bases,
        shader_bindings=lighting.bind(frame),
        switches=lighting.switches,
        color=frame.targets[EVALUATIONS],
        depth=frame.targets["depth" if after_depth else "counted depth"],
        clear=_NONE,
        states=(BlendFunction.ADDITIVE, *(_VISIBLE_ONLY if after_depth else ())),
        clears=not after_depth,
    )
    frame.draw_visible(counting)


def _count_pixels(frame: Frame) -> None:
    targets, shader = frame.targets, (LightCounter, LitByLists)
    bindings, switches = bind_light_lists(frame, CLUSTERS), geometry_buffer_switches(frame)
    depth = targets["depth"]
    draw_full_screen(
        frame, shader, targets[EVALUATIONS], bindings, depth=depth, clear=_NONE, switches=switches
    )


def _count_cells(frame: Frame, *, cells: LightListsFactory) -> None:
    draw_full_screen(frame, ClusterLightCounter, frame.targets[EVALUATIONS], bind_light_lists(frame, cells))


def _count_tiles(frame: Frame) -> None:
    dispatch_tiles(frame, frame.targets[EVALUATIONS], LightCounter, TiledLighting)


def _count_volumes(frame: Frame, *, stencil: bool, depth: str) -> None:
    for number, effect in enumerate(local_light_effects(frame.effects)):
        draw_volumes(
            frame,
            effect,
            VolumeFragmentCounter,
            [EVALUATIONS],
            depth=depth,
            clears=not number,
            is_masked=stencil,
        )


def _count_pairs(frame: Frame) -> None:
    target = frame.targets[EVALUATIONS]
    with frame.device.render_pass(target, clear=_NONE):
        pass
    for effect in local_light_effects(frame.effects):
        draw_pairs(frame, effect, target, LightCounter, LightPairs)
